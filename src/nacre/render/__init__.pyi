from .pictures import RenderResult as RenderResult
from .pictures import animate as animate
from .pictures import forget_scenes as forget_scenes
from .pictures import make_bsdf as make_bsdf
from .pictures import render as render
from .pictures import report as report
from .pictures import scene_dict as scene_dict
from .pictures import use_variant as use_variant
