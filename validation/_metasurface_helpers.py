"""Cross-sections of one particle, and plane waves at given azimuths, for comparisons with other codes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.families.metasurface.supercells import PlaneWaves
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_index, with_negative_orders
from nacre.families.metasurface.tmatrix.particle_on_stack import (
    Directions,
    ParticleOnStack,
    apply_response,
    beam_extinctions,
    emission_harmonics,
    hemisphere_rule,
)


@dataclass(frozen=True)
class CrossSections:
    """Cross-sections in nm^2 for one incidence, `[pol, ...]`.

    `extinction_reflected` and `extinction_transmitted` are the powers removed from the reflected and the transmitted
    beam per incident irradiance; their sum is the scattered and absorbed power.
    """

    extinction_reflected: Array
    extinction_transmitted: Array
    scattered_up: Array
    scattered_down: Array

    @property
    def extinction(self) -> Array:
        """Power removed from both beams."""
        return self.extinction_reflected + self.extinction_transmitted

    @property
    def absorption(self) -> Array:
        """Extinction minus scattering; includes the power entering an absorbing or guiding stack."""
        return self.extinction - self.scattered_up - self.scattered_down


def _azimuth_integral(harmonics: ComplexArray) -> Array:
    """int_0^2pi |F|^2 dphi from harmonics, `[pol_s, scattered, pol_i, incident]`."""
    power = np.abs(harmonics) ** 2
    same = np.eye(2)[:, None, :, None]
    return 2 * np.pi * power[0] * same + np.pi * np.sum(power[1:], axis=0)


def cross_sections(sphere: ParticleOnStack, cosines: ArrayLike, below: bool = False, nodes: int = 48) -> CrossSections:
    """Return extinction and scattering at `cosines`, each `[pol, angle]`.

    The downward parts are zero for an absorbing substrate. Scattering is integrated by `nodes` Gauss points on each
    side (and on each side of the critical angle).
    """
    incident = sphere.directions(cosines, below)
    k = sphere.surface.inner_wavenumber
    solved = apply_response(sphere.dressed, incident.excitation)
    reflected, transmitted = beam_extinctions(sphere, incident)
    mu, weight = hemisphere_rule(nodes)
    up = _azimuth_integral(emission_harmonics(sphere.directions(mu).emission, solved, k))
    scattered_up = np.einsum("s,qspi->pi", weight, up) / incident.index
    if not sphere.surface.is_transparent:
        return CrossSections(reflected, transmitted, scattered_up, np.zeros_like(scattered_up))
    index = sphere.surface.index_below
    mu, weight = hemisphere_rule(nodes, index)
    down = _azimuth_integral(emission_harmonics(sphere.directions(mu, below=True).emission, solved, k))
    scattered_down = np.einsum("s,qspi->pi", weight, down) * index / incident.index
    return CrossSections(reflected, transmitted, scattered_up, scattered_down)


def plane_waves(
    directions: Directions, azimuths: Array, order: int, wavenumber: float, *others: Directions
) -> PlaneWaves:
    """Rotate the vectors to each azimuth; `others` belong to the other species of a mixture."""
    species = (directions, *others)
    index = multipole_index(order)
    turn = np.exp(1j * index.m[:, None] * azimuths)  # n, azimuth
    parts = []
    for name, phase in (("excitation", turn.conj()), ("emission", turn)):
        spread = np.stack(
            [with_negative_orders(getattr(one, name), index) for one in species]
        )  # species, pol, n, angle
        whole = spread[..., None] * phase[None, None, :, None]
        parts.append(np.moveaxis(whole, 2, 1).reshape(len(species), len(index.m), -1))
    along = np.stack([np.cos(azimuths), np.sin(azimuths)], axis=-1)
    flat = (wavenumber * directions.transverse[:, None, None] * along).reshape(-1, 2)
    return PlaneWaves(parts[0], parts[1], np.concatenate([flat, flat]))
