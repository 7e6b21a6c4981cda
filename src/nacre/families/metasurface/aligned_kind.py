"""Particles of a recipe that all point one way: from the recipe's kind to lobes and powers."""

from __future__ import annotations

from collections.abc import Callable

from nacre.arrays import Array
from nacre.bsdf.contract import Lobe
from nacre.families.metasurface.aligned import AlignedLayer
from nacre.families.metasurface.aligned_compile import aligned_grids, aligned_powers, aligned_values, tabulate_aligned
from nacre.families.metasurface.axial import KnownBody
from nacre.families.metasurface.compile import Grids
from nacre.families.metasurface.kinds import Kind
from nacre.families.metasurface.monolayer import Monolayer
from nacre.families.metasurface.structure import Structure

NO_ENSEMBLE = "aligned particles have no ensemble, so the error of their mean field is not measured"


def aligned_lobes(
    kind: Kind, wavelengths_nm: Array, monolayer: Callable[[float], Monolayer], structure: Structure, grids: Grids,
    eta: float,
) -> tuple[tuple[Lobe, ...], float]:  # fmt: skip
    """Solve all wavelengths as `compile.tabulate` does, for particles that all point one way."""
    body = _body(kind)

    def layer(wavelength_nm: float) -> AlignedLayer:
        return AlignedLayer(monolayer(wavelength_nm), body.whole_t_matrix(wavelength_nm))

    return tabulate_aligned(wavelengths_nm, layer, structure, aligned_grids(grids), eta, body.turn_rad)


def powers_of_aligned(kind: Kind, layer: Monolayer, cosines: Array) -> tuple[Array, Array, Array, Array]:
    """Return specular R and T, diffuse R and T for light from above in the plane of x and z, each `[pol, angle]`.

    Args:
        kind: the particles.
        layer: that of their mean over the turn.
        cosines: `[angle]`, of incidence, > 0.
    """
    body = _body(kind)
    whole = AlignedLayer(layer, body.whole_t_matrix(layer.surface.wavelength_nm))
    return aligned_powers(whole, cosines, -body.turn_rad)


def values_of_aligned(kind: Kind, layer: Monolayer, wi: Array, wo: Array) -> Array:
    """Return the diffuse values of a few pairs of directions above, `[pair]`; arguments as of `powers_of_aligned`."""
    body = _body(kind)
    whole = AlignedLayer(layer, body.whole_t_matrix(layer.surface.wavelength_nm))
    return aligned_values(whole, wi, wo, body.turn_rad)


def _body(kind: Kind) -> KnownBody:
    assert isinstance(kind.body, KnownBody)  # which alone is aligned
    return kind.body
