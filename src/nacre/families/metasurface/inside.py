"""Particles inside a layer of the stack: which layer that is, and whether it holds them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nacre.errors import MaterialRangeError
from nacre.families.metasurface.kinds import Kind
from nacre.families.metasurface.substrate import LOSSLESS_K
from nacre.light import default_wavelengths
from nacre.matter.indices.constant import OpticalConstant
from nacre.recipe.model import RecipeContext

ROOM = 1e-6  # nm, of rounding
Layers = Sequence[tuple[OpticalConstant, float]]


def host_layer(context: RecipeContext, depth_nm: float | None, layers: Layers) -> int:
    """Return the number of the layer, from 1, that a depth below the top of the stack lies in; 0 without a depth.

    Raises:
        RecipeError: no layer reaches so deep, or the one that does absorbs.
    """
    if depth_nm is None:
        return 0
    bottom = 0.0
    for number, (medium, thickness) in enumerate(layers, start=1):
        bottom += thickness
        if depth_nm < bottom - ROOM:
            _check_clear(context, medium, number)
            return number
    raise context.fail(
        "particle.depth_nm", depth_nm, f"is not inside a layer: the layers end {bottom:g} nm below their top"
    )


def _check_clear(context: RecipeContext, medium: OpticalConstant, number: int) -> None:
    grid = default_wavelengths()
    low, high = medium.range_nm
    try:
        loss = medium.n_complex(grid[(grid >= low) & (grid <= high)]).imag
    except MaterialRangeError:
        return  # where it is not known nothing is computed
    if loss.size and loss.max() >= LOSSLESS_K:
        at = grid[(grid >= low) & (grid <= high)][int(np.argmax(loss))]
        raise context.fail(
            f"layers[{number - 1}].material", medium.name,
            f"absorbs (k = {loss.max():.2g} at {at:g} nm), and particles lie in it; k should be below {LOSSLESS_K:g}",
        )  # fmt: skip


def held(context: RecipeContext, kinds: tuple[Kind, ...], host: int, layers: Layers) -> tuple[Kind, ...]:
    """Return the kinds with their gaps over the lower face of the layer, where their bottoms are level.

    Raises:
        RecipeError: the layer does not hold them, or the spheres around them.
    """
    top = sum(thickness for _, thickness in layers[: host - 1])
    bottom = top + layers[host - 1][1]
    out = []
    for kind in kinds:
        assert kind.depth_nm is not None  # of all kinds or of none
        gap = bottom - kind.depth_nm - kind.height_nm
        largest = max(kind.sizes.radii_nm) - kind.mean_radius_nm
        above = 0.0 if kind.body is None else kind.reach_nm - kind.height_nm / 2  # multipoles diverge inside
        over = kind.depth_nm - top - above - (2 * largest if kind.body is None else 0.0)
        if kind.depth_nm >= bottom - ROOM or min(over, gap - above) < -ROOM:
            needs = "" if not above else f", or the sphere of radius {kind.reach_nm:.4g} nm around them"
            raise context.fail(
                f"{kind.key}.depth_nm", kind.depth_nm,
                f"puts particles {kind.height_nm:.4g} nm high{' and higher' if largest else ''} across a face of layer "
                f"{host}, which lies {top:g} to {bottom:g} nm deep; it should hold them whole{needs}",
            )  # fmt: skip
        out.append(replace(kind, gap_nm=max(gap, 0.0)))
    return tuple(out)
