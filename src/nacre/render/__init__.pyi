from .animation import animate as animate
from .face import RenderResult as RenderResult
from .face import forget_stages as forget_stages
from .face import make_bsdf as make_bsdf
from .face import render as render
from .face import report as report
from .face import scene_dict as scene_dict
from .face import use_variant as use_variant
