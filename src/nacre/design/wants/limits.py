"""What an answer must keep to, checked against what is free."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence

from nacre.design.wants.free import Free
from nacre.design.wants.spec import WantsSpec
from nacre.errors import NacreError, RecipeError
from nacre.materials.material import Material
from nacre.recipe.measures import LENGTH_UNITS_NM
from nacre.recipe.paths import numbers_of

_THICKNESS = re.compile(r"layers\[\d+\]\.thickness_(nm|um|mm)$")


def total_nm(material: Material) -> float:
    """Return the thickness of all layers of a recipe together; 0 where it has none."""
    found = ((_THICKNESS.match(path), value) for path, value in numbers_of(material.data).items())
    return sum(value * LENGTH_UNITS_NM[match[1]] for match, value in found if match)


def check_limits(spec: WantsSpec, base: Material, free: Sequence[Free], source: str) -> None:
    """Refuse limits that say nothing of this recipe, or that nothing can keep to.

    Raises:
        RecipeError: naming the key.
    """
    if spec.limits.levels is not None:
        raise RecipeError(
            f"{source}: limits.levels = {spec.limits.levels}: levels are of a picture; no want is an image"
        )
    if spec.layers is not None:
        return
    if spec.limits.layers is not None:
        raise RecipeError(f'{source}: limits.layers = "fewest" is of a stack that is sought; add [layers]')
    most = spec.limits.total_nm
    if most is None:
        return
    if not base.data.get("layers"):
        raise RecipeError(f"{source}: limits.total_nm = {most:g}: the recipe has no layers; bound what is in [free]")
    least = 0.0
    with contextlib.suppress(NacreError):  # other numbers may make room for the lowest of all
        least = total_nm(base.vary({number.path: number.low for number in free if not number.choices}))
    if least > most:
        raise RecipeError(f"{source}: limits.total_nm = {most:g}: the least that [free] allows is {least:g} nm")


__all__ = ["check_limits", "total_nm"]
