"""Tables that conserve energy: a reciprocal BRDF is scaled until every incidence sends out what it should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.bsdf.lobes.specular import Specular
from nacre.bsdf.lobes.table import TableLobe
from nacre.bsdf.reciprocity import reciprocal_scaling
from nacre.bsdf.response import InterfaceResponse
from nacre.core.arrays import Array
from nacre.core.parallel import in_threads
from nacre.families.glass.medium import Medium, gauss_rule
from nacre.families.glass.radiative_transfer import Slab, brdf_pairs, brdf_table, face
from nacre.families.glass.random_walk import Face, walk
from nacre.families.glass.rough_interface import Passing

CELL_NODES = 6


def table_weights(theta: Array) -> Array:
    """Weights `[theta]` that integrate a table, linear in theta, times cos over the half space of its exits."""
    x, w = gauss_rule(CELL_NODES)
    weights = np.zeros(len(theta))
    for i in range(len(theta) - 1):
        part = (x + 1) / 2
        at = theta[i] + (theta[i + 1] - theta[i]) * part
        light = 0.5 * (theta[i + 1] - theta[i]) * w * np.sin(at) * np.cos(at)
        weights[i] += np.sum(light * (1 - part))
        weights[i + 1] += np.sum(light * part)
    return 2 * np.pi * weights


def balanced(values: Array, theta: Array, albedo: Array) -> Array:
    """Scale f(i, o) by s(i) s(o) until its sums over the exits are the albedo wanted.

    Args:
        values: `[theta_i, theta_o, dphi]`, symmetric in the first two.
        theta: `[theta]`, uniform.
        albedo: `[theta]`, at every incidence.
    """
    ends = 0.5 * (values[..., 0] + values[..., -1])
    mean = (values.sum(axis=2) - ends) / (values.shape[2] - 1)
    scale = reciprocal_scaling(mean, albedo, table_weights(theta))
    return np.asarray(values * scale[:, None, None] * scale[None, :, None])


# `quality = "fast"` of a photonic glass: the face, and the diffuse light of transfer as a table, with a stated error.

THETA_NODES, AZIMUTH_NODES = 37, 19
FACE_NODES = 257
CHECK_DEG = (10.0, 40.0, 65.0)
CHECK_BINS, CHECK_WALKERS, CHECK_BANDS = 10, 120_000, 8
MIDPOINTS = (8, 24)  # in a bin, and in the half turn of the azimuth
CHECK_PAIRS = 300
DOUBT = 0.6  # share of the check's noise that the stated error adds


def diffuse_table(medium: Medium, slabs: list[Slab]) -> TableLobe:
    """Tabulate the light that has entered by a smooth face; every incidence sends out exactly what transfer says."""
    theta, dphi = np.linspace(0, np.pi / 2, THETA_NODES), np.linspace(0, np.pi, AZIMUTH_NODES)
    cos = np.append(np.cos(theta[:-1]), 0.0)

    def tabulate(band: int) -> Array:
        table = brdf_table(medium, band, slabs[band], theta, dphi)
        # equal to rounding already: reciprocity then holds to the last digit
        table = 0.5 * (table + np.swapaxes(table, 0, 1))
        return balanced(table, theta, slabs[band].powers(cos)[2])

    values = np.stack(in_threads(tabulate, range(len(slabs))), axis=-1)
    return TableLobe(medium.wavelengths_nm, values, np.eye(len(slabs)))


def behind_rough(table: TableLobe, medium: Medium, slabs: list[Slab], surface: Roughness) -> TableLobe:
    """Put the light of `diffuse_table` behind a rough face; see `Passing`."""
    passing = Passing.behind(surface, medium)
    if passing is None:
        return table
    share = passing.over_smooth(np.cos(np.linspace(0, np.pi / 2, THETA_NODES)))
    kept = np.array([passing.kept(slab) for slab in slabs])
    return replace(table, values=table.values * kept * share[:, None, None, None] * share[:, None, None])


def face_lobe(medium: Medium, surface: Roughness) -> Lobe:
    """The upper face, which only reflects here: what enters is in the table."""
    cos = np.linspace(0.0, 1.0, FACE_NODES)
    reflect = np.stack([face(cos, max(float(n), 1.0)) for n in medium.index], axis=1)
    none = np.zeros_like(reflect)
    empty = np.zeros((0, reflect.shape[1]))
    response = InterfaceResponse(medium.wavelengths_nm, cos, reflect, none, none, empty, 1.0, False)
    if surface.is_smooth:
        return Specular(response)
    rough = Microfacet(response, surface.distribution, surface.alpha_x, surface.alpha_y)
    passing = Passing.behind(surface, medium)
    if passing is None or not surface.compensate:
        return rough
    exchange = np.full((1, 1, reflect.shape[1]), passing.outward / (np.pi * passing.hidden))
    return replace(rough, loss=passing.loss[None, :, None, None], exchange=exchange)


def interpolation_error(table: TableLobe, medium: Medium, slabs: list[Slab]) -> Array:
    """Relative L2 error of a table's f cos against transfer itself, over pairs of all directions, as `walk_error` has.

    Args:
        table, medium, slabs: of `diffuse_table`.
    """
    bands = _checked(medium)
    draws = np.random.default_rng(7).random((2, CHECK_PAIRS, 2))
    cos, phi = np.sqrt(draws[..., 0]), 2 * np.pi * draws[..., 1]
    sine = np.sqrt(1 - cos**2)
    wi, wo = np.stack([sine * np.cos(phi), sine * np.sin(phi), cos], axis=-1)
    exact = np.stack([brdf_pairs(medium, int(band), slabs[band], wi, wo) for band in bands], axis=-1)
    difference = table.evaluate(wi, wo)[:, bands] - exact
    # drawn by the cosine: its square is the weight of squares of f cos, so one factor of it is left
    weight = wo[:, 2:]
    return np.asarray(np.sqrt(np.sum(weight * difference**2, axis=0) / np.sum(weight * exact**2, axis=0)))


def _checked(medium: Medium) -> NDArray[np.intp]:
    """The wavelengths that errors are stated from."""
    return np.unique(np.linspace(0, len(medium.wavelengths_nm) - 1, CHECK_BANDS).astype(np.intp))


def walk_error(
    table: TableLobe, medium: Medium, thickness_nm: float, albedo: Array, surface: Roughness, seed: int = 1
) -> Array:
    """Relative L2 error of a table's light over the polar angle, at a few of its wavelengths, against walks.

    Args:
        table: of `diffuse_table`.
        medium: all of its wavelengths.
        thickness_nm, albedo, surface: of the slab, its base `[wavelength]` and its face.
        seed: of the walks.
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
        ours = 2 * np.pi * light.reshape(CHECK_BINS, MIDPOINTS[0], -1).sum(axis=1) / len(fine)
        walks = [
            walk(
                few, thickness_nm, albedo[bands], float(np.cos(theta)), walkers=CHECK_WALKERS,
                upper=upper, bins=CHECK_BINS, seed=seed + 2 * turn + i,
            ).reflected
            for i in range(2)
        ]  # fmt: skip
        # two independent differences: their product has no noise in the mean
        first, second = (walked - ours for walked in walks)
        noise = np.sum((walks[0] - walks[1]) ** 2, axis=0) / 4
        error += np.maximum(np.sum(first * second, axis=0), 0.0) + (DOUBT**2) * noise
        size += np.sum(ours**2, axis=0)
    return np.asarray(np.sqrt(error / np.maximum(size, 1e-30)))
