"""Supercells of ridges: columns of layers, of random heights, widths and places, solved for all directions at once.

Between two neighbouring faces the permittivity depends on x alone (inverse rule: Li, J. Opt. Soc. Am. A 13, 1870
(1996)). With the transverse fields E = (E_x, E_y) and G = (H_y, -H_x) of all orders, lengths in 1/k0 and the wave
number b along the ridges,

    E' = i P G,  G' = i Q E,
    P = [[1 - a h a, -b a h], [-b h a, 1 - b^2 h]],  Q = [[t - b^2, b a], [b a, e - a^2]],

where a holds the wave numbers of the orders, e multiplies by the permittivity, h is its inverse and t the inverse of
1/permittivity. The admittance Y, G = Y E, is carried from the substrate upward by power series of cos and sin of
sqrt(P Q) times the thickness: faces of several ridges lie so close that this is cheaper than eigenmodes. For b = 0 the
x and y components decouple. One solution holds the reflection of all incident orders. `ridge_table` averages it over
supercells, light and view directions, for a lobe.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.machine import in_threads
from nacre.matter.periodic.types import Array

REACH = 1.0  # longest step times the largest wave number
MORE_ORDERS = 1.65, 3  # orders to each side: factor on the period in wavelengths, and constant
GRAZING = 0.03  # orders with a smaller cosine are left out
SAMPLED = 4000  # ridges drawn for the expected interference
STEEPEST = 3.0  # deviations in standard deviations; larger ones are drawn again


@dataclass(frozen=True)
class RidgeStatistics:
    """Ridges along y and the standard deviations of their Gaussian distributions, all in nm.

    Attributes:
        count: ridges in a supercell.
        height_deviation_nm, width_deviation_nm, shift_deviation_nm: for height, width and lateral position.
    """

    pitch_nm: float
    width_nm: float
    count: int
    height_deviation_nm: float = 0.0
    width_deviation_nm: float = 0.0
    shift_deviation_nm: float = 0.0

    @property
    def period_nm(self) -> float:
        """Width of a supercell."""
        return self.count * self.pitch_nm


@dataclass(frozen=True)
class Ridges:
    """The ridges of one supercell.

    Attributes:
        heights_nm: `[ridge]`, pedestal heights above the membrane.
        widths_nm, centres_nm: `[ridge]`, widths and lateral positions.
        period_nm: width of the supercell.
    """

    heights_nm: Array
    widths_nm: Array
    centres_nm: Array
    period_nm: float


def drawn_ridges(statistics: RidgeStatistics, draw: int) -> Ridges:
    """Return the supercell of one draw; widths stay above zero and neighbours apart."""
    count, pitch = statistics.count, statistics.pitch_nm
    random = np.random.default_rng([draw, count])
    height, width, shift = (_normal(random, count) for _ in range(3))
    widths = np.clip(statistics.width_nm + statistics.width_deviation_nm * width, 0.05 * pitch, pitch)
    aside = 0.5 * (pitch - widths)
    places = np.clip(statistics.shift_deviation_nm * shift, -aside, aside)
    return Ridges(
        statistics.height_deviation_nm * (STEEPEST + height).round(3), widths,
        (np.arange(count) + 0.5) * pitch + places, statistics.period_nm,
    )  # fmt: skip


def array_factor(ridges: Ridges, sines: Array, sine_along: float, wave: float) -> Array:
    """Return the interference of identical scatterers at the ridges, over their number squared, `[out, in]`.

    Args:
        sines: `[order]`, sines in a `Fan`.
        wave: wave number in the medium above, 1/nm.
    """
    return np.asarray(np.abs(_mean_phase(ridges.centres_nm, ridges.heights_nm, sines, sine_along, wave)) ** 2)


def mean_array_factor(statistics: RidgeStatistics, sines: Array, sine_along: float, wave: float) -> Array:
    """Return the expected `array_factor` over all supercells, `[out, in]`."""
    count = statistics.count
    many = drawn_ridges(replace(statistics, count=SAMPLED), 0)
    aside = many.centres_nm - (np.arange(SAMPLED) + 0.5) * statistics.pitch_nm
    coherent = np.abs(_mean_phase(aside, many.heights_nm, sines, sine_along, wave)) ** 2
    coherent = 0.5 * (coherent + coherent.T)  # shifts to both sides are equally likely
    order = np.arange(len(sines))
    is_of_pitch = (order[:, None] - order) % count == 0
    return np.asarray((1.0 - coherent) / count + coherent * is_of_pitch)


def _mean_phase(x: Array, z: Array, sines: Array, sine_along: float, wave: float) -> Array:
    cosines = np.sqrt(np.maximum(1.0 - sines**2 - sine_along**2, 0.0))
    across, up = np.multiply.outer(sines, wave * x), np.multiply.outer(cosines, wave * z)
    return np.asarray(np.exp(1j * (up + across)) @ np.exp(1j * (up - across)).T / len(x))


def _normal(random: np.random.Generator, count: int) -> Array:
    """Return `count` normal numbers within three standard deviations."""
    numbers: list[float] = []
    while len(numbers) < count:
        value = float(random.normal())
        if abs(value) < STEEPEST:
            numbers.append(value)
    return np.array(numbers)


def levels(ridges: Ridges, layers_nm: Array) -> tuple[Array, Array]:
    """Return the thicknesses `[level]` in nm, from the membrane up, and the layer in each ridge `[level, ridge]`.

    Args:
        layers_nm: layer thicknesses `[layer]` in each ridge, from the light inward.

    A layer index equal to the layer count denotes the pedestal, -1 the medium above.
    """
    tops = np.concatenate([[0.0], np.cumsum(layers_nm)])
    faces = ridges.heights_nm[:, None] + tops[-1] - tops  # [ridge, face], from the top down
    every = np.unique(np.concatenate([[0.0], faces.ravel()]).round(6))
    every = every[np.append(True, np.diff(every) > 1e-6)]
    middle = 0.5 * (every[1:] + every[:-1])
    above = np.sum(middle[:, None, None] < faces, axis=2)  # faces above this level
    return np.diff(every), above - 1


@dataclass(frozen=True)
class Fan:
    """Reflection of unpolarised light by one supercell.

    Attributes:
        sines: `[order]` of the orders in the medium above, over its index.
        power: `[out, in]`: share of the light along `in` that leaves along `out`, both wave vectors as of outgoing
            light: light arrives from the direction with the sine `-sines[in]`.
    """

    sines: Array
    power: Array


def reflected_fan(
    ridges: Ridges, layers_nm: Array, layer_index: Array, cover: float, substrate: complex, wavelength_nm: float,
    sine_along: float, more: float = 1.0,
) -> Fan:  # fmt: skip
    """Return the reflectance from each diffraction order into each other one.

    Args:
        layers_nm, layer_index: `[layer]`, thicknesses and complex indices of the layers of a ridge, from the light
            inward.
        cover: index of the medium above and between the ridges.
        substrate: complex index of the membrane and the pedestals.
        sine_along: component of the incident direction along the ridges.
        more: factor on the order count.
    """
    most = int(more * (MORE_ORDERS[0] * cover * ridges.period_nm / wavelength_nm + MORE_ORDERS[1]))
    numbers = np.arange(-most, most + 1)
    alpha, beta = numbers * wavelength_nm / ridges.period_nm, cover * sine_along
    depths, filled = levels(ridges, layers_nm)
    epsilon = np.append(np.asarray(layer_index, dtype=complex), substrate) ** 2
    media = _Media(ridges, numbers, epsilon, cover**2)
    parts = [(False,), (True,)] if beta == 0.0 else [(False, True)]
    keep = 1.0 - (alpha / cover) ** 2 - sine_along**2 > GRAZING**2
    amplitudes = np.zeros((2, int(keep.sum()), 2, int(keep.sum())), dtype=complex)
    for part in parts:
        reflection = _reflection(media, depths * (2.0 * np.pi / wavelength_nm), filled, alpha, beta, substrate**2, part)
        size, some = len(alpha), np.flatnonzero(keep)
        for i, out in enumerate(part):
            for j, into in enumerate(part):
                block = reflection[i * size : (i + 1) * size, j * size : (j + 1) * size]
                amplitudes[int(out), :, int(into)] = block[np.ix_(some, some)]
    return Fan(alpha[keep] / cover, _unpolarised(amplitudes, alpha[keep] / cover, sine_along))


class _Media:
    """Matrices of the permittivity in a level."""

    def __init__(self, ridges: Ridges, numbers: Array, epsilon: Array, cover: float) -> None:
        span = np.arange(numbers[0] - numbers[-1], numbers[-1] - numbers[0] + 1)
        share = (ridges.widths_nm / ridges.period_nm)[:, None]
        phase = np.exp(-2j * np.pi * span * (ridges.centres_nm / ridges.period_nm)[:, None])
        self.series = share * np.sinc(span * share) * phase  # [ridge, span], of an indicator of each ridge
        self.size = len(numbers)
        self.at = numbers[:, None] - numbers[None, :] + self.size - 1
        self.epsilon, self.cover = epsilon, cover

    def matrix(self, filled: Array, is_inverse: bool) -> Array:
        """Return the Toeplitz matrix of the permittivity, or of its inverse, for the layer in each ridge."""
        values = np.append(self.epsilon, self.cover)[filled]  # -1: the medium above
        values, outside = (1.0 / values, 1.0 / self.cover) if is_inverse else (values, self.cover)
        series = (values - outside) @ self.series
        series[self.size - 1] += outside
        return np.asarray(series[self.at].astype(np.complex64))


def _uniform(epsilon: complex, alpha: Array, beta: float, part: tuple[bool, ...]) -> Array:
    """Return the admittance of waves that propagate (or decay) upward in a homogeneous medium."""
    gamma = np.sqrt(epsilon - alpha.astype(complex) ** 2 - beta**2)
    gamma = np.where(np.abs(gamma) < 1e-6, 1e-6, np.where(gamma.imag < 0.0, -gamma, gamma))
    xx, xy, yy = (epsilon - beta**2) / gamma, beta * alpha / gamma, (epsilon - alpha**2) / gamma
    if len(part) == 1:
        return np.diag(yy if part[0] else xx)
    return np.block([[np.diag(xx), np.diag(xy)], [np.diag(xy), np.diag(yy)]])


def _reflection(
    media: _Media, depths: Array, filled: Array, alpha: Array, beta: float, substrate: complex, part: tuple[bool, ...]
) -> Array:  # fmt: skip
    """Return the matrix from incident to reflected E; `part`: of E_x (False), of E_y (True), or of both."""
    y = -_uniform(substrate, alpha, beta, part).astype(np.complex64)
    steps: dict[tuple[float, tuple[int, ...]], tuple[tuple[Array, ...], int]] = {}
    for depth, layers in zip(depths.tolist(), filled, strict=True):
        key = (round(depth, 6), tuple(layers.tolist()))
        if key not in steps:
            steps[key] = _step(media, layers, depth, alpha, beta, part)
        (cosine, up, down, other), count = steps[key]
        for _ in range(count):
            y = np.linalg.solve((cosine + up @ y).T, (down + other @ y).T).T
    above = _uniform(media.cover, alpha, beta, part)
    return np.asarray(np.linalg.solve(above - y, above + y))


def _step(
    media: _Media, layers: Array, depth: float, alpha: Array, beta: float, part: tuple[bool, ...]
) -> tuple[tuple[Array, ...], int]:  # fmt: skip
    """Return the matrices of one step: E = cosine E + up G, G = down E + other G; and the number of steps."""
    one = np.eye(media.size, dtype=np.complex64)
    a = alpha.astype(np.float32)
    fastest = float(np.sqrt(np.abs(np.append(media.epsilon, media.cover)[layers]).max() + alpha.max() ** 2))
    count = max(1, int(np.ceil(depth * fastest / REACH)))
    phase = np.float32(depth / count)
    epsilon = media.matrix(layers, False)
    if part == (True,):  # P = 1
        q = epsilon - np.diag(a**2)
        cosine, sine = _series(phase**2 * q)
        return (cosine, 1j * phase * sine, 1j * phase * (q @ sine), cosine), count
    inverse = np.linalg.inv(epsilon)
    across = np.linalg.inv(media.matrix(layers, True))
    p, q = one - a[:, None] * inverse * a, across
    if len(part) == 2:
        b, half = np.float32(beta), np.diag(np.float32(beta) * a).astype(np.complex64)
        p = np.block([[p, -b * (a[:, None] * inverse)], [-b * (inverse * a), one - b**2 * inverse]])
        q = np.block([[across - b**2 * one, half], [half, epsilon - np.diag(a**2)]])
    cosine, sine = _series(phase**2 * (p @ q))
    other, _ = _series(phase**2 * (q @ p))
    return (cosine, 1j * phase * (sine @ p), 1j * phase * (q @ sine), other), count


def _series(x: Array) -> tuple[Array, Array]:
    """Return cos and sin(r) / r of the root r of a matrix, to 3e-6 for roots up to 1."""
    one = np.eye(len(x), dtype=np.complex64)
    square = x @ x
    cube = x @ square
    cosine = one - x / 2 + square / 24 - cube / 720
    return cosine, one - x / 6 + square / 120 - cube / 5040


def _unpolarised(amplitudes: Array, sines: Array, sine_along: float) -> Array:
    """Return the mean over s and p of the reflected power, `[out, in]`.

    Args:
        amplitudes: `[component, out, component, in]` of E_x and E_y.
    """
    cosine = np.sqrt(1.0 - sines**2 - sine_along**2)
    length = np.hypot(sines, sine_along)
    safe = np.where(length < 1e-12, 1.0, length)
    c, s = np.where(length < 1e-12, 1.0, sines / safe), sine_along / safe
    ways_in = np.stack([np.stack([-s, c]), np.stack([c, s]) * cosine])  # [polarisation, component, in], unit E
    ways_out = np.stack([np.stack([-s, c]), np.stack([c, s]) / cosine])
    fields = np.einsum("pam,ambn,qbn->pmqn", ways_out, amplitudes, ways_in)
    return np.asarray(0.5 * np.sum(np.abs(fields) ** 2, axis=(0, 2)) * cosine[:, None] / cosine)


VERSION = 2
ALONG = 0.0, 0.5, 0.65, 0.75, 0.85  # components along the ridges that are solved
SINES = 41  # nodes in a and b
STEP_NM = 20.0  # longest step of the solved wavelengths
SHALLOW = 0.1  # least relative depth of layers
BEYOND = 0.05  # relative distance outside the solved range from which a solution loses weight
MEMORY_ENTRIES = 192  # solutions held in memory
LEAST_DRAWS = 6  # fewest draws for a regression


@dataclass(frozen=True)
class RidgeCase:
    """Supercells at one wavelength.

    Attributes:
        statistics: distribution of the ridges.
        layers_nm, layer_index: the layers in each ridge, from the light inward.
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


@lru_cache(maxsize=MEMORY_ENTRIES)
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

    sines, draws, factors = zip(*in_threads(work, range(case.draws)), strict=True)
    expected = mean_array_factor(case.statistics, sines[0], along, wave)
    each = controlled(np.array(draws), np.array(factors), _on_nodes(expected, sines[0], case, along))
    mean, rows = np.maximum(each.mean(axis=0), 0.0), each[:, SINES // 2]
    cache_arrays(key, {"mean": mean, "rows": rows})
    return mean, rows


def controlled(draws: Array, factors: Array, expected: Array) -> Array:
    """Return draws `[draw, ...]` corrected by their control variate, by linear regression over the draws.

    Args:
        draws, factors: `[draw, ...]`, quantity and control variate.
        expected: `[...]`, exact mean of the control variate.
    """
    if len(draws) < LEAST_DRAWS:
        return draws
    spread = factors - factors.mean(axis=0)
    square = np.sum(np.square(spread), axis=0)
    slope = np.sum(spread * draws, axis=0) / np.maximum(square, 1e-12 * np.sum(np.square(factors), axis=0) + 1e-300)
    return np.asarray(draws + slope * (expected - factors))


def truncation_error(case: RidgeCase) -> float:
    """Return the share of the light along the normal that moves between orders if 1.5 times as many are solved."""
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
    weight = np.stack([np.interp(nodes, sines, row) for row in np.eye(len(sines))], axis=-1)
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
        cases: one for each wavelength.
    """
    grid, middle = np.array([case.wavelength_nm for case in cases]), cases[len(cases) // 2]
    own = np.array(ALONG)
    ratios = grid[None] / depth(middle, own)[:, None]  # [along, wavelength]
    flat = solved.reshape(len(own), -1, len(grid))
    table = np.empty((nodes, *solved.shape[1:]))
    for k, c in enumerate(np.linspace(0.0, 1.0, nodes)):
        wave_ratios = grid / depth(middle, np.array(c))
        at = np.interp(c**2, own**2, np.arange(len(own)))
        low = min(int(at), len(own) - 2)
        parts = [_at_ratio(flat[i], ratios[i], wave_ratios) for i in (low, low + 1)]
        # a solution that ends short of the ratio leaves the light to the other
        near, far = (np.exp(-np.square(_beyond(ratios[i], wave_ratios) / BEYOND)) + 1e-12 for i in (low, low + 1))
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


def _beyond(ratios: Array, at: Array) -> Array:
    """Return how far ratios lie outside a range, relative."""
    return np.asarray(np.maximum(at / ratios[-1], ratios[0] / at).clip(1.0) - 1.0)


def _at_ratio(values: Array, ratios: Array, at: Array) -> Array:
    place = np.interp(at, ratios, np.arange(len(ratios)))
    low = np.minimum(place.astype(int), max(len(ratios) - 2, 0))
    high = np.minimum(low + 1, len(ratios) - 1)
    return np.asarray(values[:, low] * (1.0 - (place - low)) + values[:, high] * (place - low))
