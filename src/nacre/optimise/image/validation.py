"""What may be free where a picture is wanted: one or two numbers that vary over the surface, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence

from nacre.core.errors import NacreError, RecipeError
from nacre.material.material import Material
from nacre.optimise.parameters import Parameter
from nacre.optimise.spec import DesignSpec

MOST_NUMBERS = 2


def check_free(spec: DesignSpec, base: Material, free: Sequence[Parameter], source: str) -> None:
    """Refuse what a picture cannot be made of.

    Raises:
        RecipeError: naming the key.
    """
    for name, what in (("layers", "the stack itself cannot be sought"), ("tolerance", "spreads are not counted")):
        if getattr(spec, name):
            raise RecipeError(f"{source}: {name}: of a picture {what}; free one or two numbers that vary over it")
    for name, value in (("max_total_nm", spec.limits.max_total_nm), ("max_layers", spec.limits.max_layers)):
        if value is not None:
            raise RecipeError(f"{source}: limits.{name} does not hold for a picture; use bounds of what is free")
    if len(free) > MOST_NUMBERS:
        paths = ", ".join(number.path for number in free)
        raise RecipeError(f"{source}: free: {len(free)} numbers ({paths}); a picture is made of one or two")
    textures = {}
    for number in free:
        where = f'{source}: parameters."{number.path}"'
        if number.choices:
            raise RecipeError(f"{where}: a picture is made of numbers that vary over it; choices do not")
        textures[number.path] = {
            "formula": f"{number.low!r} + {number.high - number.low!r}*u", "min": number.low, "max": number.high,
        }  # fmt: skip
        if number.is_whole:
            raise RecipeError(f"{where}: only whole numbers are allowed there; a picture needs one that varies evenly")
        _try(base, {number.path: textures[number.path]}, where)
    _try(base, textures, f"{source}: free")


def _try(base: Material, textures: dict[str, dict[str, object]], where: str) -> None:
    try:
        base.vary(textures)
    except NacreError as error:
        said = str(error).removeprefix(f"{base.context.source}: ").removeprefix("recipe: ")
        raise RecipeError(f"{where}: {said}") from None


__all__ = ["check_free"]
