"""Noise-free form of a photonic glass (`quality = "fast"`): the face, and a table of the diffuse light.

The table is scaled reciprocally until every incidence has the albedo of radiative transfer. A rough face spreads its
own reflection and changes the transmittance for diffuse light inside by the factors in `RoughInterface`, which are
relative to a smooth interface. The stated error comes from independent random walks through the rough face at three
incidences, in bins of the exit cosine, plus the interpolation error against transfer at pairs of all directions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.angle_nodes import AngleErrors
from nacre.bsdf.compensation import once, reciprocal_scaling, returns
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.interface import Microfacet, Specular
from nacre.bsdf.lobes.table import TableLobe
from nacre.bsdf.response import InterfaceResponse
from nacre.core.arrays import Array, cell, gauss_legendre
from nacre.core.machine import in_threads
from nacre.families.glass.medium import Medium
from nacre.families.glass.radiative_transfer import MATCHED, Slab, brdf_pairs, brdf_table, face
from nacre.families.glass.random_walk import Face, walk

INDEX_DIGITS = 2  # decimal places of the index in the cache; the results are ratios and vary slowly
GRAZING = 2e-3  # cosine, below which both transmittances vanish


@dataclass(frozen=True, eq=False)
class RoughInterface:
    """Transmission and reflection of diffuse light by a rough face.

    Attributes:
        index: refractive index of the medium.
        through: `[cos]`, transmittance from the ambient, on uniform nodes of sqrt(cos).
        loss: `[cos]`, share from the ambient hidden by facets, on the same nodes.
        hidden: mean of `loss` in diffuse light.
        outward: share of hidden light that returns to the ambient.
        escape: diffuse transmittance over that of a smooth face, in both directions by reciprocity.
        lost: share of diffuse light inside lost between facets at each encounter.
    """

    index: float
    through: Array
    loss: Array
    hidden: float
    outward: float
    escape: float
    lost: float

    @classmethod
    def behind(cls, surface: Roughness, medium: Medium) -> RoughInterface | None:
        """Return a medium's interface; None if it is smooth or index-matched."""
        index = round(float(np.median(medium.index)), INDEX_DIGITS)
        return None if surface.is_smooth or index - 1 < MATCHED else _solve(surface, index)

    def entering(self, cos: Array) -> Array:
        """Return the transmittance from the ambient."""
        return np.asarray(np.interp(np.sqrt(cos), np.linspace(0.0, 1.0, len(self.through)), self.through))

    def over_smooth(self, cos: Array) -> Array:
        """Return the transmittance over that of a smooth face."""
        at = np.maximum(cos, GRAZING)
        return self.entering(at) / (1 - face(at, self.index))

    def mirrored(self, cos: Array) -> Array:
        """Return the directional-hemispherical reflectance of the face."""
        lost = self.loss if self.lost > 0 else 0.0
        return np.asarray(np.interp(np.sqrt(cos), np.linspace(0.0, 1.0, len(self.loss)), 1 - self.through - lost))

    def internal_factor(self, slab: Slab) -> float:
        """Return the factor on diffuse light inside by the changed internal reflection.

        With r and r' the internal reflectances of a smooth and this face, and A the layer's albedo inside:
        (1 - A r) / (1 - A r'). A follows from the albedo outside, behind the smooth face.
        """
        at = slab.directions
        weight = 2 * at.outer * at.outer_weight
        outside = float(np.sum(weight * face(at.outer, at.index)))
        inside = 1 - (1 - outside) / at.index**2
        albedo = float(np.sum(weight * slab.powers(at.outer)[2]))
        layer = albedo / ((1 - outside) * (1 - inside) + inside * albedo)
        rough = 1 - self.escape * (1 - inside) - self.lost
        return float((1 - layer * inside) / (1 - layer * rough))


@lru_cache(maxsize=256)
def _solve(surface: Roughness, index: float) -> RoughInterface:
    sides = [once(surface, eta) for eta in (index, 1 / index)]
    loss = np.stack([np.maximum(1 - up - down, 0.0) for up, down in sides])
    mean = returns(loss)[0]
    through, outward = sides[0][1], 0.0
    if surface.compensate:
        outward = float(mean[0] / max(mean[0] + index**2 * mean[1], 1e-12))
        through = through + loss[0] * (1 - outward)
    root = np.linspace(0.0, 1.0, len(through))
    weight = 4 * root**3
    escape = float(np.sum(weight * through) / np.sum(weight * (1 - face(root**2, index))))
    escaping = 0.0 if surface.compensate else float(mean[1])
    return RoughInterface(index, through, loss[0], max(float(mean[0]), 1e-12), outward, escape, escaping)


CELL_NODES = 6


def table_weights(theta: Array) -> Array:
    """Return weights `[theta]` that integrate a table, linear in theta, times cos over the hemisphere."""
    x, w = gauss_legendre(CELL_NODES)
    weights = np.zeros(len(theta))
    for i in range(len(theta) - 1):
        part = (x + 1) / 2
        at = theta[i] + (theta[i + 1] - theta[i]) * part
        light = 0.5 * (theta[i + 1] - theta[i]) * w * np.sin(at) * np.cos(at)
        weights[i] += np.sum(light * (1 - part))
        weights[i + 1] += np.sum(light * part)
    return 2 * np.pi * weights


def balanced(values: Array, theta: Array, albedo: Array) -> Array:
    """Scale f(i, o) by s(i) s(o) to a given albedo.

    Args:
        values: `[theta_i, theta_o, dphi]`, symmetric in the first two.
        theta: `[theta]`, uniform.
        albedo: `[theta]`, at every incidence.
    """
    ends = 0.5 * (values[..., 0] + values[..., -1])
    mean = (values.sum(axis=2) - ends) / (values.shape[2] - 1)
    scale = reciprocal_scaling(mean, albedo, table_weights(theta))
    return np.asarray(values * scale[:, None, None] * scale[None, :, None])


THETA_NODES, AZIMUTH_NODES = 37, 19
FACE_NODES = 257
CHECK_DEG = (10.0, 40.0, 65.0)
CHECK_BINS, CHECK_WALKERS, CHECK_BANDS = 10, 120_000, 8
MIDPOINTS = (8, 24)  # quadrature points in a bin, and over half a turn in azimuth
CHECK_PAIRS = 300
NOISE_SHARE = 0.6  # fraction of the check's noise that is added to the stated error
BETWEEN = np.array([0.25, 0.5, 0.75])  # angles within a cell at which the table over incidence is checked
FACE_DEG = (0.0, 15.0, 30.0, 45.0, 55.0, 65.0, 72.0, 78.0, 83.0, 86.5, 89.0)  # incidences for a rough face


def diffuse_table(medium: Medium, slabs: list[Slab]) -> TableLobe:
    """Tabulate the diffuse light behind a smooth face, with the exact albedo at every incidence."""
    theta, dphi = np.linspace(0, np.pi / 2, THETA_NODES), np.linspace(0, np.pi, AZIMUTH_NODES)
    cos = np.append(np.cos(theta[:-1]), 0.0)

    def tabulate(band: int) -> Array:
        table = brdf_table(medium, band, slabs[band], theta, dphi)
        # exact reciprocity
        table = 0.5 * (table + np.swapaxes(table, 0, 1))
        return balanced(table, theta, slabs[band].powers(cos)[2])

    values = np.stack(in_threads(tabulate, range(len(slabs))), axis=-1)
    return TableLobe(medium.wavelengths_nm, values, np.eye(len(slabs)))


def behind_rough(table: TableLobe, medium: Medium, slabs: list[Slab], surface: Roughness) -> TableLobe:
    """Convert the result of `diffuse_table` to a rough face; see `RoughInterface`.

    At grazing incidence a smooth face transmits nothing, unlike a rough one. The light below the face is therefore
    extrapolated there from the last two nodes.
    """
    interface = RoughInterface.behind(surface, medium)
    if interface is None:
        return table
    cos = np.cos(np.linspace(0, np.pi / 2, THETA_NODES))
    internal = np.array([interface.internal_factor(slab) for slab in slabs])
    entered = np.append(1 - face(cos[:-1], interface.index), 1.0)
    below = table.values / entered[:, None, None, None] / entered[:, None, None]
    below[-1] = np.maximum(2 * below[-2] - below[-3], 0.0)
    below[:, -1] = np.maximum(2 * below[:, -2] - below[:, -3], 0.0)
    share = interface.entering(np.append(cos[:-1], 0.0))
    return replace(table, values=below * internal * share[:, None, None, None] * share[:, None, None])


def face_lobe(medium: Medium, surface: Roughness) -> Lobe:
    """Return the reflection of the upper face."""
    cos = np.linspace(0.0, 1.0, FACE_NODES)
    reflect = np.stack([face(cos, max(float(n), 1.0)) for n in medium.index], axis=1)
    none = np.zeros_like(reflect)
    empty = np.zeros((0, reflect.shape[1]))
    response = InterfaceResponse(medium.wavelengths_nm, cos, reflect, none, none, empty, 1.0, False)
    if surface.is_smooth:
        return Specular(response)
    rough = Microfacet(response, surface.distribution, surface.alpha_x, surface.alpha_y)
    interface = RoughInterface.behind(surface, medium)
    if interface is None or not surface.compensate:
        return rough
    exchange = np.full((1, 1, reflect.shape[1]), interface.outward / (np.pi * interface.hidden))
    return replace(rough, loss=interface.loss[None, :, None, None], exchange=exchange)


def interpolation_error(table: TableLobe, medium: Medium, slabs: list[Slab]) -> Array:
    """Return the relative L2 error of a table's f cos against transfer, over pairs of all directions.

    Args:
        table, medium, slabs: result and arguments of `diffuse_table`.
    """
    bands = _checked(medium)
    draws = np.random.default_rng(7).random((2, CHECK_PAIRS, 2))
    cos, phi = np.sqrt(draws[..., 0]), 2 * np.pi * draws[..., 1]
    sine = np.sqrt(1 - cos**2)
    wi, wo = np.stack([sine * np.cos(phi), sine * np.sin(phi), cos], axis=-1)
    exact = np.stack([brdf_pairs(medium, int(band), slabs[band], wi, wo) for band in bands], axis=-1)
    difference = table.evaluate(wi, wo)[:, bands] - exact
    # exits are drawn by the cosine, which leaves one factor of its square
    weight = wo[:, 2:]
    return np.asarray(np.sqrt(np.sum(weight * difference**2, axis=0) / np.sum(weight * exact**2, axis=0)))


def incidence_error(
    lobes: tuple[Lobe, TableLobe], medium: Medium, slabs: list[Slab], surface: Roughness
) -> AngleErrors:
    """Return the reflectance errors over incidence between the nodes, absolute.

    The table is linear in the incidence angle, the smooth face in its cosine. The exact reflectance is that of
    transfer, behind a rough face with the factors of `RoughInterface`.

    Args:
        lobes: face and table, as in a Bsdf.
        medium, slabs, surface: as for `behind_rough`.
    """
    front, table = lobes
    theta = np.linspace(0, np.pi / 2, THETA_NODES)
    at = ((np.arange(THETA_NODES - 1)[:, None] + BETWEEN) * theta[1]).ravel()
    cos = np.cos(at)
    ends = 0.5 * (table.values[:, :, 0] + table.values[:, :, -1])
    mean = (table.values.sum(axis=2) - ends) / (AZIMUTH_NODES - 1)
    nodes = np.einsum("o,iol->il", table_weights(theta), mean)
    low, share = cell(at / theta[1], THETA_NODES)
    interpolated = nodes[low] * (1 - share)[:, None] + nodes[low + 1] * share[:, None]
    exact = np.stack([slab.powers(cos)[2] for slab in slabs], axis=-1)
    interface = RoughInterface.behind(surface, medium)
    if interface is not None:
        internal = np.array([interface.internal_factor(slab) for slab in slabs])
        exact = exact * (interface.over_smooth(cos) * interface.escape)[:, None] * internal
    return AngleErrors((at[:, None], np.abs(interpolated - exact) + _face_error(front, medium, interface)))


def _face_error(front: Lobe, medium: Medium, interface: RoughInterface | None) -> float:
    """Return the largest error of the face's reflectance over incidence."""
    if interface is None:
        cos = (np.arange(FACE_NODES - 1) + 0.5) / (FACE_NODES - 1)
        exact = np.stack([face(cos, max(float(n), 1.0)) for n in medium.index], axis=1)
        mirrored = front.specular(cos).reflectance if front.is_delta else exact
        return float(np.max(np.abs(mirrored - exact)))
    theta = np.radians(FACE_DEG)
    reflectance = [front.hemispherical(np.array([np.sin(t), 0.0, np.cos(t)]))[0] for t in theta]
    return float(np.max(np.abs(np.stack(reflectance) - interface.mirrored(np.cos(theta))[:, None])))


def _checked(medium: Medium) -> NDArray[np.intp]:
    """Return the wavelengths of the error checks."""
    return np.unique(np.linspace(0, len(medium.wavelengths_nm) - 1, CHECK_BANDS).astype(np.intp))


def walk_error(
    table: TableLobe, medium: Medium, thickness_nm: float, albedo: Array, surface: Roughness, seed: int = 1
) -> Array:
    """Return the relative L2 error of a table over the polar angle against random walks, at a few wavelengths.

    Args:
        table: result of `diffuse_table`.
        medium: at all wavelengths.
        thickness_nm, albedo, surface: slab thickness, base `[wavelength]` and face.
        seed: random-walk seed.
    """
    bands = _checked(medium)
    few = medium.at(bands)
    upper = Face.of(surface, float(np.median(medium.index)))
    error, size = np.zeros(len(bands)), np.zeros(len(bands))
    fine = (np.arange(CHECK_BINS * MIDPOINTS[0]) + 0.5) / (CHECK_BINS * MIDPOINTS[0])
    azimuth = (np.arange(MIDPOINTS[1]) + 0.5) * np.pi / MIDPOINTS[1]
    sine = np.sqrt(1 - fine**2)[:, None]
    wo = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), fine[:, None] + 0 * sine * azimuth], axis=-1)
    for turn, degrees in enumerate(CHECK_DEG):
        theta = np.radians(degrees)
        wi = np.broadcast_to([np.sin(theta), 0.0, np.cos(theta)], wo.shape)
        light = table.evaluate(wi, wo)[..., bands].mean(axis=1) * fine[:, None]
        tabulated = 2 * np.pi * light.reshape(CHECK_BINS, MIDPOINTS[0], -1).sum(axis=1) / len(fine)
        walks = [
            walk(
                few, thickness_nm, albedo[bands], float(np.cos(theta)), walkers=CHECK_WALKERS,
                upper=upper, bins=CHECK_BINS, seed=seed + 2 * turn + i,
            ).reflected
            for i in range(2)
        ]  # fmt: skip
        # the product of two independent differences has no noise in the mean
        first, second = (one - tabulated for one in walks)
        noise = np.sum((walks[0] - walks[1]) ** 2, axis=0) / 4
        error += np.maximum(np.sum(first * second, axis=0), 0.0) + (NOISE_SHARE**2) * noise
        size += np.sum(tabulated**2, axis=0)
    return np.asarray(np.sqrt(error / np.maximum(size, 1e-30)))
