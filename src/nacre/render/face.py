"""The names that `nacre.render` re-exports from other packages, each imported when first used."""

from nacre.device.bsdf import make_bsdf
from nacre.device.variant import report, use_variant
from nacre.picture.images import RenderResult
from nacre.picture.picture import forget_stages, render, scene_dict

__all__ = ["RenderResult", "forget_stages", "make_bsdf", "render", "report", "scene_dict", "use_variant"]
