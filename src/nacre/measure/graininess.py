"""Graininess of an effect coating under diffuse light: what the eye resolves of the flakes' unequal luminances.

Flakes cover each other. With N the discs over a point, a and T luminance and transmittance of a flake, and both points
of a pair covered together by the share g of the discs (their covariogram), the second moment C of the luminances of two
points obeys, upwards through the stratum,

    dm/dz = N (<a> + (<T> - 1) m),
    dC/dz = N g (<a^2> + 2 <a T> m + (<T^2> - 1) C) + 2 N (1 - g) (<a> m + (<T> - 1) C):

the colour dead-leaves model of Bordenave, Gousseau and Roueff (Adv. Appl. Probab. 38, 31 (2006)), for flakes that
transmit. `graininess_statistics` integrates this; `graininess_patch` draws the flakes on top of each other. The
luminance is then filtered by the contrast sensitivity of the eye (Mannos and Sakrison, IEEE Trans. Inf. Theory 20, 525
(1974)), held at its maximum below its peak at 8 cycles per degree, as for the visibility of halftones (Mitsa and
Varkur, ICASSP 1993). Graininess is the standard deviation of the result over the mean, in per cent. Ferrero et al.,
"Definition of a measurement scale of graininess from reflectance and visual measurements", Opt. Express (2018), propose
a scale from luminance factors, which differs from the one used here.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nacre.bsdf.glints import DiffuseFlakes, mean_square
from nacre.core.arrays import Array
from nacre.core.jit import compiled

PEAK_CPD, LAST_CPD = 8.0, 60.0  # cycles per degree
LAGS, FREQUENCIES, STEPS = 65, 241, 64
SIZES = 24
TILES = 16  # periodic pieces of the field
SAMPLES_PER_DIAMETER = 5.0
MOST_SAMPLES = 1600  # along the side of a tile
FINEST_UM = 10.0  # diameter of drawn flakes, far below what the eye resolves
HIDDEN = 6.0  # optical thickness of flakes below which nothing is seen


@dataclass(frozen=True)
class Graininess:
    """Graininess.

    Attributes:
        value: standard deviation of the luminance filtered by the eye, over its mean, in per cent.
        error: standard error.
    """

    value: float
    error: float


@dataclass(frozen=True)
class DiffuseArea:
    """A part of the surface under diffuse light.

    Attributes:
        flakes: its pigments.
        mean: its mean luminance.
        base: luminance of what lies below the flakes, as it would be without them; the rest of the mean that the flakes
            do not reflect themselves is a uniform veil.
    """

    flakes: tuple[DiffuseFlakes, ...]
    mean: float
    base: float = 0.0


def eye_filter(cycles_per_mm: Array, distance_mm: float) -> Array:
    """Return the relative contrast sensitivity at a viewing distance."""
    cpd = np.asarray(cycles_per_mm) * distance_mm * math.radians(1.0)
    f = np.maximum(cpd, PEAK_CPD)
    found = (0.0192 + 0.114 * f) * np.exp(-((0.114 * f) ** 1.1))
    peak = (0.0192 + 0.114 * PEAK_CPD) * math.exp(-((0.114 * PEAK_CPD) ** 1.1))
    return np.asarray(np.where(cpd > LAST_CPD, 0.0, found / peak))


def _common_share(flakes: DiffuseFlakes, lag_um: Array) -> Array:
    """Return the share of the discs over a point that also cover a point at a distance `[lag]`."""
    radii = np.interp((np.arange(SIZES) + 0.5) / SIZES, np.linspace(0, 1, len(flakes.radii_um)), flakes.radii_um)
    x = np.minimum(lag_um[:, None] / (2.0 * radii), 1.0)
    both = (np.arccos(x) - x * np.sqrt(1.0 - x * x)) * (2.0 / np.pi)
    return np.asarray(both @ radii**2 / np.sum(radii**2))


def _averages(flakes: DiffuseFlakes, depth: float) -> tuple[float, float, float, float, float]:
    """Return <a>, <a^2>, <T>, <T^2> and <a T> at a relative depth."""
    shares = (np.arange(1024) + 0.5) / 1024
    cos = np.interp(shares, np.linspace(0, 1, len(flakes.facing)), flakes.facing)
    nodes = np.linspace(0.0, 1.0, flakes.luminance.shape[1])
    at = depth * (len(flakes.luminance) - 1)
    low = min(int(at), len(flakes.luminance) - 2)
    row = (low + 1 - at) * flakes.luminance[low] + (at - low) * flakes.luminance[low + 1]
    a, t = np.interp(cos, nodes, row), np.interp(cos, nodes, flakes.transmittance)
    return float(a.mean()), float((a * a).mean()), float(t.mean()), float((t * t).mean()), float((a * t).mean())


def two_point_moments(area: DiffuseArea, lag_um: Array, steps: int = STEPS) -> tuple[float, Array]:
    """Return mean luminance and second moment `[lag]` of the flakes over their base, without the veil."""
    m, c = area.base, np.full(len(lag_um), area.base**2)
    for stratum in sorted({flakes.stratum for flakes in area.flakes}, reverse=True):
        here = [flakes for flakes in area.flakes if flakes.stratum == stratum]
        shares = [_common_share(flakes, lag_um) for flakes in here]
        count = max(steps, math.ceil(2 * steps * sum(f.coverage for f in here) / 8))
        for n in range(count):
            averages = [_averages(flakes, 1.0 - (n + 0.5) / count) for flakes in here]

            def rate(m: float, c: Array, averages=averages, here=here, shares=shares) -> tuple[float, Array]:
                up, both = 0.0, np.zeros(len(lag_um))
                for flakes, g, (a, a2, t, t2, at) in zip(here, shares, averages, strict=True):
                    up += flakes.coverage * (a + (t - 1.0) * m)
                    together = a2 + 2.0 * at * m + (t2 - 1.0) * c
                    both += flakes.coverage * (g * together + 2.0 * (1.0 - g) * (a * m + (t - 1.0) * c))
                return up, both

            first = rate(m, c)
            middle = rate(m + 0.5 * first[0] / count, c + 0.5 * first[1] / count)
            m, c = m + middle[0] / count, c + middle[1] / count
    return m, c


def filtered_variance(area: DiffuseArea, distance_mm: float, steps: int = STEPS) -> float:
    """Return the variance of the luminance filtered by the eye.

    It is the integral of covariance times the filter's autocorrelation over the plane.
    """
    if not area.flakes:
        return 0.0
    from scipy.special import j0

    widest = max(2.0 * float(flakes.radii_um[-1]) for flakes in area.flakes)
    x, w = np.polynomial.legendre.leggauss(LAGS)
    lag_um, weight = 0.5 * widest * (x + 1.0), 0.5 * widest * w
    m, c = two_point_moments(area, lag_um, steps)
    last = LAST_CPD / (distance_mm * math.radians(1.0))
    f = (np.arange(FREQUENCIES) + 0.5) / FREQUENCIES * last
    power = eye_filter(f, distance_mm) ** 2 * f * (last / FREQUENCIES) * 2.0 * np.pi
    response = j0(2.0 * np.pi * np.outer(lag_um * 1e-3, f)) @ power  # 1/mm2
    return float(2.0 * np.pi * np.sum(weight * lag_um * (c - m * m) * response) * 1e-6)


def veiled(area: DiffuseArea) -> float:
    """Return the uniform veil over the flakes."""
    return max(area.mean - two_point_moments(area, np.zeros(1))[0], 0.0)


def graininess_statistics(
    areas: Sequence[tuple[float, DiffuseArea]], distance_mm: float, is_fine: bool = True
) -> Graininess:
    """Return graininess from the statistics of the flakes; its error is that of the integration.

    Args:
        areas: each with the factor on its luminance, whose squares weight the variances.
        distance_mm: viewing distance.
        is_fine: False for half the steps and an error of 0.
    """
    mean = sum(factor * area.mean for factor, area in areas)
    found = [
        sum(factor**2 * filtered_variance(area, distance_mm, steps) for factor, area in areas)
        for steps in ((STEPS, STEPS // 2) if is_fine else (STEPS // 2,))
    ]
    fine, coarse = found[0], found[-1]
    value = 100.0 * math.sqrt(max(fine, 0.0)) / mean if mean > 0 else 0.0
    other = 100.0 * math.sqrt(max(coarse, 0.0)) / mean if mean > 0 else 0.0
    return Graininess(value, abs(value - other))


@compiled(nogil=True)
def _cover(x, y, radius, light, transmit, passed, image):
    """Add discs from the uppermost downwards to a periodic image; `passed` is the transmittance above each sample."""
    rows, columns = image.shape
    for n in range(x.size):
        r = radius[n]
        for i in range(int(math.ceil(y[n] - r)), int(math.floor(y[n] + r)) + 1):
            reach = math.sqrt(max(r * r - (i - y[n]) ** 2, 0.0))
            row = i % rows
            for j in range(int(math.ceil(x[n] - reach)), int(math.floor(x[n] + reach)) + 1):
                column = j % columns
                image[row, column] += passed[row, column] * light[n]
                passed[row, column] *= transmit[n]


def _enlarged(area: DiffuseArea) -> tuple[DiffuseArea, float]:
    """Return an area with flakes of `FINEST_UM` or more, and their enlargement.

    The deviation of light that the eye does not resolve is proportional to the diameter.
    """
    least = min(2.0 * math.sqrt(mean_square(flakes.radii_um)) for flakes in area.flakes)
    factor = max(FINEST_UM / least, 1.0)
    return replace(area, flakes=tuple(replace(f, radii_um=f.radii_um * factor) for f in area.flakes)), factor


def draw_tile(area: DiffuseArea, side_mm: float, generator: np.random.Generator) -> Array:
    """Return a periodic image of one tile, luminance factors `[row, column]`, without the veil."""
    least = min(2.0 * math.sqrt(mean_square(flakes.radii_um)) for flakes in area.flakes)
    count = min(MOST_SAMPLES, max(64, math.ceil(side_mm * 1e3 / least * SAMPLES_PER_DIAMETER)))
    step_um = side_mm * 1e3 / count
    image, passed = np.zeros((count, count)), np.ones((count, count))
    thickness = 0.0
    for stratum in sorted({flakes.stratum for flakes in area.flakes}):
        here = [flakes for flakes in area.flakes if flakes.stratum == stratum]
        blocking = sum(f.coverage * (1.0 - _averages(f, 0.0)[2]) for f in here)
        deepest = min(1.0, max(HIDDEN - thickness, 0.0) / max(blocking, 1e-9))
        thickness += blocking
        discs = [_discs(flakes, deepest, side_mm, generator) for flakes in here]
        depth, x, y, radius, light, transmit = (np.concatenate(columns) for columns in zip(*discs, strict=True))
        order = np.argsort(depth)
        scaled = [np.ascontiguousarray(v[order]) for v in (x / step_um, y / step_um, radius / step_um, light, transmit)]
        _cover(*scaled, passed, image)
    return np.asarray(image + passed * area.base)


def _discs(flakes: DiffuseFlakes, deepest: float, side_mm: float, generator: np.random.Generator) -> tuple[Array, ...]:
    """Return depth, place in um, radius in um, luminance and transmittance of one pigment's discs on a tile."""
    side_um = side_mm * 1e3
    mean_area = math.pi * mean_square(flakes.radii_um)
    count = generator.poisson(flakes.coverage * deepest * side_um**2 / mean_area)
    depth = deepest * generator.random(count)
    radius = np.interp(generator.random(count), np.linspace(0, 1, len(flakes.radii_um)), flakes.radii_um)
    cos = np.interp(generator.random(count), np.linspace(0, 1, len(flakes.facing)), flakes.facing)
    nodes = np.linspace(0.0, 1.0, len(flakes.transmittance))
    at = depth * (len(flakes.luminance) - 1)
    low = np.minimum(at.astype(int), len(flakes.luminance) - 2)
    column = np.minimum((cos * (len(nodes) - 1)).astype(int), len(nodes) - 2)
    part, deep = cos * (len(nodes) - 1) - column, at - low
    table = flakes.luminance
    upper = (1 - part) * table[low, column] + part * table[low, column + 1]
    lower = (1 - part) * table[low + 1, column] + part * table[low + 1, column + 1]
    light = (1 - deep) * upper + deep * lower
    x, y = side_um * generator.random(count), side_um * generator.random(count)
    return depth, x, y, radius, light, np.interp(cos, nodes, flakes.transmittance)


def graininess_patch(
    areas: Sequence[tuple[float, DiffuseArea]], distance_mm: float, field_mm: float, seed: int = 0
) -> tuple[Graininess, Array]:
    """Return graininess from drawn tiles of the field, with the standard error over the tiles, and the first image.

    Flakes finer than 10 um are drawn with 10 um; the deviation is reduced accordingly.

    Args:
        areas: as for `graininess_statistics`.
        distance_mm: viewing distance.
        field_mm: field side, drawn as 16 periodic tiles.
        seed: of the flakes.
    """
    generator = np.random.default_rng(seed)
    side_mm = field_mm / math.sqrt(TILES)
    mean = sum(factor * area.mean for factor, area in areas)
    variances, first = np.zeros(TILES), np.zeros((1, 1))
    for factor, area in areas:
        if not area.flakes:
            continue
        veil = veiled(area)
        drawn, enlarged = _enlarged(area)
        filtered = []
        for tile in range(TILES):
            image = draw_tile(drawn, side_mm, generator) + veil
            if tile == 0 and first.size == 1:
                first = image
            f = np.fft.fftfreq(len(image), side_mm / len(image))
            kernel = eye_filter(np.hypot(f[:, None], f[None, : len(image) // 2 + 1]), distance_mm)
            filtered.append(np.fft.irfft2(np.fft.rfft2(image) * kernel, s=image.shape))
        level = float(np.mean([image.mean() for image in filtered]))
        variances += (factor / enlarged) ** 2 * np.array([np.mean((image - level) ** 2) for image in filtered])
    deviation = math.sqrt(float(variances.mean()))
    if mean <= 0 or deviation == 0:
        return Graininess(0.0, 0.0), first
    error = 0.5 * float(variances.std(ddof=1)) / math.sqrt(TILES) / deviation
    return Graininess(100.0 * deviation / mean, 100.0 * error / mean), first
