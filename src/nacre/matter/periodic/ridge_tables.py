"""Mean reflection of ridge supercells over light and view directions, for a lobe."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.machine import in_threads
from nacre.matter.periodic.supercell import (
    RidgeStatistics,
    array_factor,
    drawn_ridges,
    mean_array_factor,
    reflected_fan,
)
from nacre.matter.periodic.types import Array

VERSION = 2
ALONG = 0.0, 0.5, 0.65, 0.75, 0.85  # components along the ridges that are solved
SINES = 41  # nodes in a and b
STEP_NM = 20.0  # longest step of the solved wavelengths
SHALLOW = 0.1  # least relative depth of layers
BEYOND = 0.05  # relative distance outside the solved range from which a solution loses weight
KEPT = 192  # solutions held in memory
LEAST_DRAWS = 6  # for a regression


@dataclass(frozen=True)
class RidgeCase:
    """Supercells at one wavelength.

    Attributes:
        statistics: distribution of the ridges.
        layers_nm, layer_index: of each ridge, from the light inward.
        cover, substrate: index above and between the ridges, and of the membrane and the pedestals.
        draws: number of supercells.
    """

    statistics: RidgeStatistics
    layers_nm: tuple[float, ...]
    layer_index: tuple[complex, ...]
    cover: float
    substrate: complex
    wavelength_nm: float
    draws: int


def even_wavelengths(low_nm: float, high_nm: float) -> Array:
    """Return a range's ends and the multiples of 20 nm between, which other ranges share."""
    between = STEP_NM * np.arange(np.floor(low_nm / STEP_NM) + 1.0, np.ceil(high_nm / STEP_NM))
    return np.unique(np.concatenate([[low_nm], between, [high_nm]]))


def solved_wavelengths(wavelengths_nm: Array) -> Array:
    """Return the wavelengths that are solved for a grid: `even_wavelengths`, or the grid itself if it has fewer."""
    grid = np.asarray(wavelengths_nm, dtype=float)
    even = even_wavelengths(float(grid[0]), float(grid[-1]))
    return grid if len(grid) <= len(even) else even


@lru_cache(maxsize=KEPT)
def solved_case(case: RidgeCase, along: float) -> tuple[Array, Array]:
    """Return the mean over all draws, and each draw for light from b = 0; stored on disk.

    The interference of the ridges is a control variate (`controlled`): its mean over all supercells is known.

    Args:
        along: component of the light direction along the ridges.

    Returns:
        D `[a, b]` and `[draw, b]`; see `nacre.bsdf.lobes.ridge`.
    """
    key = "ridges-" + hashlib.sha256(repr((VERSION, SINES, case, along)).encode()).hexdigest()
    stored = cached_arrays(key)
    if stored is not None:
        return stored["mean"], stored["rows"]

    wave = 2.0 * np.pi * case.cover / case.wavelength_nm

    def work(draw: int) -> tuple[Array, Array, Array]:
        cell = drawn_ridges(case.statistics, draw)
        fan = reflected_fan(
            cell, np.array(case.layers_nm), np.array(case.layer_index), case.cover, case.substrate,
            case.wavelength_nm, along,
        )  # fmt: skip
        factor = array_factor(cell, fan.sines, along, wave)
        return fan.sines, _on_nodes(fan.power, fan.sines, case, along), _on_nodes(factor, fan.sines, case, along)

    sines, found, factors = zip(*in_threads(work, range(case.draws)), strict=True)
    expected = mean_array_factor(case.statistics, sines[0], along, wave)
    each = controlled(np.array(found), np.array(factors), _on_nodes(expected, sines[0], case, along))
    mean, rows = np.maximum(each.mean(axis=0), 0.0), each[:, SINES // 2]
    cache_arrays(key, {"mean": mean, "rows": rows})
    return mean, rows


def controlled(found: Array, factors: Array, expected: Array) -> Array:
    """Return draws `[draw, ...]` less what their control variate explains, by linear regression over the draws.

    Args:
        found, factors: `[draw, ...]`, quantity and control variate.
        expected: `[...]`, exact mean of the control variate.
    """
    if len(found) < LEAST_DRAWS:
        return found
    spread = factors - factors.mean(axis=0)
    square = np.sum(np.square(spread), axis=0)
    slope = np.sum(spread * found, axis=0) / np.maximum(square, 1e-12 * np.sum(np.square(factors), axis=0) + 1e-300)
    return np.asarray(found + slope * (expected - factors))


def truncation_error(case: RidgeCase) -> float:
    """Return the share of the light along the normal that moves between orders with half as many again solved."""
    cell = drawn_ridges(case.statistics, 0)
    few, many = (
        reflected_fan(
            cell, np.array(case.layers_nm), np.array(case.layer_index), case.cover, case.substrate,
            case.wavelength_nm, 0.0, more,
        ).power
        for more in (1.0, 1.5)
    )  # fmt: skip
    middle = few.shape[0] // 2
    moved = float(np.abs(few[:, middle] - many[:, middle]).sum())
    return moved / max(float(many[:, middle].sum()), 1e-6)


def _on_nodes(power: Array, orders: Array, case: RidgeCase, along: float) -> Array:
    """Interpolate `[out, in]` of one supercell to the nodes in a and b; its mirror image is as likely.

    Args:
        orders: `[order]`, sines across the ridges.
    """
    chord = np.sqrt(1.0 - along**2)
    step = case.wavelength_nm / (case.statistics.period_nm * case.cover * chord)
    sines = orders / chord
    nodes = np.linspace(-1.0, 1.0, SINES)
    place = np.clip(np.interp(nodes, sines, np.arange(len(sines))), 0.0, len(sines) - 1.0)
    low = np.minimum(place.astype(int), max(len(sines) - 2, 0))
    weight = np.zeros((SINES, len(sines)))
    weight[np.arange(SINES), low] = 1.0 - (place - low)
    if len(sines) > 1:
        weight[np.arange(SINES), low + 1] = place - low
    # an order's power falls with both cosines, beyond the last order too
    cosines = np.sqrt(np.maximum(1.0 - sines**2, 0.0))
    weight = np.sqrt(np.maximum(1.0 - nodes**2, 0.0))[:, None] * weight / cosines
    density = weight @ power[:, ::-1] @ weight.T / step
    density = 0.5 * (density + density.T)
    return np.asarray(0.5 * (density + density[::-1, ::-1]))


def ridge_table(solved: Array, cases: Sequence[RidgeCase], nodes: int) -> Array:
    """Return D `[c, a, b, wavelength]` over uniform nodes in c from 0 to 1.

    Directions with equal ratio of `depth` and wavelength have equal phases of the layers. D is interpolated linearly in
    c^2 between solutions at this ratio.

    Args:
        solved: `[along, a, b, wavelength]` at `ALONG`.
        cases: of the wavelengths.
    """
    grid, middle = np.array([case.wavelength_nm for case in cases]), cases[len(cases) // 2]
    own = np.array(ALONG)
    ratios = grid[None] / depth(middle, own)[:, None]  # [along, wavelength]
    flat = solved.reshape(len(own), -1, len(grid))
    table = np.empty((nodes, *solved.shape[1:]))
    for k, c in enumerate(np.linspace(0.0, 1.0, nodes)):
        wanted = grid / depth(middle, np.array(c))
        at = np.interp(c**2, own**2, np.arange(len(own)))
        low = min(int(at), len(own) - 2)
        parts = [_at_ratio(flat[i], ratios[i], wanted) for i in (low, low + 1)]
        # a solution that ends short of the ratio leaves the light to the other
        near, far = (np.exp(-np.square(_beyond(ratios[i], wanted) / BEYOND)) + 1e-12 for i in (low, low + 1))
        lower, upper = (1.0 - (at - low)) * near, (at - low) * far
        table[k] = ((parts[0] * lower + parts[1] * upper) / (lower + upper)).reshape(solved.shape[1:])
    return table


def depth(case: RidgeCase, along: Array) -> Array:
    """Return the optical path down through the layers over that of light along the normal.

    Args:
        along: component of the direction along the ridges.
    """
    index, layers = np.array(case.layer_index).real[:, None], np.array(case.layers_nm)[:, None]
    paths = np.sum(layers * np.sqrt(np.maximum(index**2 - (case.cover * along.ravel()) ** 2, 0.0)), axis=0)
    return np.asarray(np.maximum(paths / np.maximum(np.sum(layers * index), 1e-9), SHALLOW)).reshape(along.shape)


def _beyond(ratios: Array, wanted: Array) -> Array:
    """Return how far ratios lie outside a range, relative."""
    return np.asarray(np.maximum(wanted / ratios[-1], ratios[0] / wanted).clip(1.0) - 1.0)


def _at_ratio(values: Array, ratios: Array, wanted: Array) -> Array:
    place = np.interp(wanted, ratios, np.arange(len(ratios)))
    low = np.minimum(place.astype(int), max(len(ratios) - 2, 0))
    high = np.minimum(low + 1, len(ratios) - 1)
    return np.asarray(values[:, low] * (1.0 - (place - low)) + values[:, high] * (place - low))
