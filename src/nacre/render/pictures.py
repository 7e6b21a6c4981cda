"""Functions in `nacre.render`, which also accept recipes; imported on first use."""

import functools
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

from nacre.device.bsdf import make_bsdf
from nacre.device.variant import report, use_variant
from nacre.material.material import loaded
from nacre.picture import picture
from nacre.picture.images import RenderResult
from nacre.picture.picture import forget_scenes

__all__ = ["RenderResult", "forget_scenes", "make_bsdf", "render", "report", "scene_dict", "use_variant"]

_P = ParamSpec("_P")
_R = TypeVar("_R")


def _loading(function: Callable[Concatenate[Any, _P], _R]) -> Callable[Concatenate[Any, _P], _R]:
    """Load a material given as a path, an example name, or a recipe table."""

    @functools.wraps(function)
    def call(material: Any = None, *arguments: _P.args, **options: _P.kwargs) -> _R:
        return function(loaded(material), *arguments, **options)

    return call


render = _loading(picture.render)
scene_dict = _loading(picture.scene_dict)
