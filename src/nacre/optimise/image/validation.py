"""Picture design restrictions: one or two continuous parameters that may vary over the surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nacre.core.errors import NacreError, RecipeError
from nacre.families.contract import Diffracting, Pixels
from nacre.material.material import Material
from nacre.optimise.parameters import Parameter
from nacre.optimise.spec import DesignSpec
from nacre.optimise.targets import Target

MAX_PARAMETERS = 2
PERIOD, TURN = "lattice.period_nm", "orientation.turn_deg"
HOLOGRAM = f"{PERIOD} and {TURN} together"
MAX_CHANNELS = 2  # pictures in a hologram


def is_hologram(base: Material, parameters: Sequence[Parameter]) -> bool:
    """Whether a picture is to be made of the turn and the grating period."""
    return isinstance(base.model, Diffracting) and {p.path for p in parameters} == {PERIOD, TURN}


def check_hologram(spec: DesignSpec, targets: Sequence[Target], source: str) -> None:
    """Refuse a target file that no hologram can meet.

    Raises:
        RecipeError: with the key.
    """
    for name in ("layers", "tolerance"):
        if getattr(spec, name):
            raise RecipeError(f"{source}: {name} does not apply to a hologram; remove it")
    if spec.limits.height_levels is not None or not spec.limits.dither:
        raise RecipeError(f"{source}: limits.height_levels and limits.dither do not apply to a hologram; remove them")
    if len(targets) > MAX_CHANNELS:
        raise RecipeError(f"{source}: a hologram of {len(targets)} pictures is not made; allowed: one or two")
    first = targets[0].image
    for target in targets[1:]:
        if target.image is None or first is None or target.image.shape != first.shape:
            raise RecipeError(f"{target.key}.image is not of the size of the first picture; allowed: equal sizes")


def check_picture_target(spec: DesignSpec, base: Material, parameters: Sequence[Parameter], source: str) -> None:
    """Refuse targets that a picture design cannot meet.

    Raises:
        RecipeError: with the key.
    """
    for name, reason in (("layers", "the stack is fixed"), ("tolerance", "tolerances are not evaluated")):
        if getattr(spec, name):
            raise RecipeError(f"{source}: {name}: in a picture design {reason}; free one or two numbers that vary")
    for name, value in (("max_total_nm", spec.limits.max_total_nm), ("max_layers", spec.limits.max_layers)):
        if value is not None:
            raise RecipeError(f"{source}: limits.{name} does not apply to a picture; use the bounds of the parameters")
    if not spec.limits.dither and spec.limits.height_levels is None:
        raise RecipeError(f"{source}: limits.dither = false: only with limits.height_levels; add it")
    if len(parameters) > MAX_PARAMETERS:
        paths = ", ".join(parameter.path for parameter in parameters)
        raise RecipeError(f"{source}: parameters: {len(parameters)} numbers ({paths}); a picture takes one or two")
    if isinstance(base.model, Diffracting) and any(p.path == TURN for p in parameters):
        raise RecipeError(f'{source}: parameters."{TURN}" alone makes no picture; allowed: {HOLOGRAM}, for a hologram')
    textures: dict[str, dict[str, Any]] = {}
    for p in parameters:
        where = f'{source}: parameters."{p.path}"'
        if p.choices:
            raise RecipeError(f"{where}: a picture takes numbers that vary over the surface, not choices")
        if p.is_whole:
            raise RecipeError(f"{where}: only whole numbers are allowed there; a picture takes a continuous one")
        if isinstance(base.model, Pixels):
            _try(base, {p.path: p.low}, where)
            _try(base, {p.path: p.high}, where)
            continue
        textures[p.path] = {"formula": f"{p.low!r} + {p.high - p.low!r}*u", "min": p.low, "max": p.high}
        _try(base, {p.path: textures[p.path]}, where)
    if textures:
        _try(base, textures, f"{source}: parameters")


def _try(base: Material, textures: dict[str, Any], where: str) -> None:
    try:
        base.vary(textures)
    except NacreError as error:
        message = str(error).removeprefix(f"{base.context.source}: ").removeprefix("recipe: ")
        raise RecipeError(f"{where}: {message}") from None
