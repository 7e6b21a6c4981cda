"""Sparkle of an effect coating: luminance of camera pixels, from the statistics of flakes or from a drawn patch.

Luminous flakes are a Poisson process on the surface. The luminance of a pixel is a uniform part plus the sum over the
flakes in it, that is, shot noise: with the measure M of the contributions x of single flakes, its characteristic
function is exp(integral (exp(i w x) - 1) dM) (Campbell's theorem; Rice 1944). `sparkle_statistics` computes M by
quadrature over size, slope, depth and position, and inverts the characteristic function by a Fourier transform.
`sparkle_patch` draws flake after flake.

A pixel sparkles if its luminance L exceeds the mean L0 by a contrast (L - L0) / (L0 + dark) > threshold. Its intensity
is the luminance above the mean, relative to white, and not the contrast: an absorbing clear coat weakens spots and dims
their surroundings even more. Luminous spots on a background, point spread, entrance pupil and diffuseness of the light
are the ingredients of Ferrero et al., Opt. Express 21, 26812 (2013); scales of contrast are proposed by Ferrero et al.,
Opt. Express 29, 7589 (2021). `dark` is the dark light of the generalised Weber law; "Visibility of sparkle in metallic
paints", J. Opt. Soc. Am. A 32, 921 (2015), derives the visibility of sparkle from such thresholds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.glints import DiffuseFlakes, LitFlakes, mean_square
from nacre.core.arrays import Array
from nacre.core.jit import compiled

# mypy: allow-untyped-defs, allow-incomplete-defs


FARTHEST = 12.0  # squared distance from the half vector, in standard deviations, beyond which a flake is not luminous
TURNS = 16
GRID = 1 << 16
RADII, SLOPES, PLACES, LEVELS, DEPTHS = 24, 64, 32, 64, 32  # quadrature
FAINTEST = 1e-4  # share of the largest value, below which values have one common level
MOST_FLAKES = 4_000_000  # drawn in one image
BLOCKS = 8  # squared: blocks of the image that are left out in turn for the standard error
UM2_PER_MM2 = 1e6


@dataclass(frozen=True)
class Pixels:
    """The camera's pixels and the definition of sparkle.

    Attributes:
        pixel_um: side of a pixel on the surface.
        field_mm: field side.
        threshold: least contrast of a sparkling pixel.
        dark: dark light, as luminance factor.
    """

    pixel_um: float
    field_mm: float
    threshold: float
    dark: float


@dataclass(frozen=True)
class Area:
    """A part of the surface with the same flakes everywhere.

    Attributes:
        share: area fraction.
        flakes: its pigments.
        mean: its mean luminance.
    """

    share: float
    flakes: tuple[LitFlakes, ...]
    mean: float


@dataclass(frozen=True)
class Sparkle:
    """Sparkle in one geometry.

    Attributes:
        intensity: mean luminance factor of sparkling pixels above that of the field; 0 without any.
        area: share of sparkling pixels, in per cent.
        grade: intensity times the square root of the sparkling share, the root mean square over the field of equal
            spots; the product of both alone, their light, hardly depends on the size of the flakes.
        intensity_error, area_error, grade_error: standard errors; infinite for the intensity of an image without
            sparkling pixels.
    """

    intensity: float
    area: float
    grade: float
    intensity_error: float
    area_error: float
    grade_error: float


@compiled(nogil=True)
def _half_chord(x, radius):
    return 0.5 * (x * math.sqrt(max(radius * radius - x * x, 0.0)) + radius * radius * math.asin(x / radius))


@compiled(nogil=True)
def _below(x, y, radius):
    """Return the integral from 0 to x of y clipped to the disc, -h(x) <= y <= h(x)."""
    reach = math.sqrt(max(radius * radius - y * y, 0.0)) if abs(y) < radius else 0.0
    away = min(abs(x), radius)
    total = abs(y) * min(away, reach)
    if away > reach:
        total += _half_chord(away, radius) - _half_chord(reach, radius)
    return total if (x >= 0.0) == (y >= 0.0) else -total


@compiled(nogil=True)
def overlap(x0, x1, y0, y1, radius):
    """Return the area of a disc about the origin inside the rectangle x0 < x1, y0 < y1."""
    upper = _below(x1, y1, radius) - _below(x0, y1, radius)
    lower = _below(x1, y0, radius) - _below(x0, y0, radius)
    return max(upper - lower, 0.0)


@compiled(nogil=True)
def _pixel_shares(radius, side, places):
    """Return the pixel area covered by a disc, for positions on a grid over one quadrant, and one position's area."""
    span = 0.5 * side + radius
    out = np.empty(places * places)
    for i in range(places):
        for j in range(places):
            x, y = (i + 0.5) / places * span, (j + 0.5) / places * span
            h = 0.5 * side
            out[i * places + j] = overlap(x - h, x + h, y - h, y + h, radius)
    return out, 4.0 * (span / places) ** 2


@compiled(nogil=True)
def _deposit(first, first_weight, second, second_weight, third, third_weight, step, out):
    """Add the products of three distributions to a grid; each is split onto two nodes, so that its mean is kept."""
    for a in range(first.size):
        for b in range(second.size):
            value, weight = first[a] * second[b] / step, first_weight[a] * second_weight[b]
            for c in range(third.size):
                at = min(value * third[c], out.size - 1.001)
                low = int(at)
                mass = weight * third_weight[c]
                out[low] += mass * (1.0 - at + low)
                out[low + 1] += mass * (at - low)


@compiled(nogil=True)
def _draw_discs(x, y, radius, light, image):
    """Add discs of total light, in pixel units, to a periodic image; a pixel receives its share of each disc."""
    rows, columns = image.shape
    for n in range(x.size):
        r = radius[n]
        density = light[n] / (math.pi * r * r)
        for i in range(int(math.floor(y[n] - r)), int(math.floor(y[n] + r)) + 1):
            for j in range(int(math.floor(x[n] - r)), int(math.floor(x[n] + r)) + 1):
                part = overlap(j - x[n], j + 1 - x[n], i - y[n], i + 1 - y[n], r)
                image[i % rows, j % columns] += density * part


def _levels(values: Array, weights: Array, count: int) -> tuple[Array, Array]:
    """Return a distribution on a few levels, logarithmic bins each at its mean."""
    flat, mass = values.ravel(), weights.ravel()
    largest = float(flat.max())
    if largest <= 0.0:
        return np.zeros(1), np.array([mass.sum()])
    place = np.log(np.maximum(flat, FAINTEST * largest) / (FAINTEST * largest)) / -math.log(FAINTEST)
    bins = np.minimum((place * count).astype(int), count - 1)
    total = np.bincount(bins, mass, count)
    sums = np.bincount(bins, mass * flat, count)
    is_filled = total > 0
    return np.asarray(sums[is_filled] / total[is_filled]), np.asarray(total[is_filled], dtype=float)


def _quantile(table: Array, share: Array) -> Array:
    return np.asarray(np.interp(share, np.linspace(0.0, 1.0, len(table)), table))


def _widths(flakes: LitFlakes, radii: Array) -> Array:
    """Return the standard deviations of the slope `[radius, 2]`."""
    diffraction = (flakes.diffraction_um / (2.0 * radii)) ** 2
    return np.sqrt(flakes.variance + diffraction[:, None])


def _spot_radii(flakes: LitFlakes, radii: Array) -> Array:
    """Return the radii of discs with the second moments of blurred flakes."""
    return np.sqrt(radii**2 + 4.0 * flakes.blur_um**2)


def _brightness_levels(flakes: LitFlakes, effort: float) -> tuple[Array, Array]:
    """Return brightness and probability over depth and crossings."""
    share = (np.arange(round(DEPTHS * effort)) + 0.5) / round(DEPTHS * effort)
    depth, weight = share**3, share**2 / np.sum(share**2)  # dense near the surface, where flakes are seen
    table, crossed = flakes.brightness, np.arange(flakes.brightness.shape[1])
    mean = flakes.crossings * depth[:, None]
    from scipy.special import gammaln, xlogy

    chance = np.exp(xlogy(crossed, mean) - mean - gammaln(crossed + 1.0)) * weight[:, None]
    nodes = np.linspace(0.0, 1.0, len(table))
    bright = np.stack([np.interp(depth, nodes, column) for column in table.T], axis=1)
    return _levels(bright, chance, LEVELS)


def _measure(flakes: LitFlakes, side_um: float, effort: float) -> tuple[list[tuple[Array, ...]], float]:
    """Return the contributions of single flakes as products of three distributions for each size, and their largest."""
    count = round(RADII * effort)
    radii = _quantile(flakes.radii_um, (np.arange(count) + 0.5) / count)
    bright, chance = _brightness_levels(flakes, effort)
    slopes = round(SLOPES * effort)
    q = (np.arange(slopes) + 0.5) / slopes * FARTHEST
    turn = (np.arange(TURNS) + 0.5) * 2 * np.pi / TURNS
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    products: list[tuple[Array, ...]] = []
    largest = 0.0
    for radius, spot, width in zip(radii, _spot_radii(flakes, radii), _widths(flakes, radii), strict=True):
        offset = np.sqrt(q)[:, None, None] * circle * width
        ellipse = math.pi * float(width[0] * width[1]) * FARTHEST / slopes  # slope area of one node
        density = flakes.density(flakes.half + offset).mean(axis=1) * ellipse
        kernel = np.exp(-0.5 * q) / (2.0 * math.pi * width[0] * width[1])
        covered, place = _pixel_shares(float(spot), side_um, round(PLACES * effort))
        share, at = _levels(covered / side_um**2 * (radius / spot) ** 2, np.full(covered.shape, place), LEVELS)
        number = flakes.number / UM2_PER_MM2 / count
        products.append((kernel, density * number, bright, chance, share, at))
        largest = max(largest, float(kernel.max() * bright.max() * share.max()))
    return products, largest


def _moments(parts: Sequence[tuple[Array, ...]]) -> tuple[float, float]:
    """Return the sums of all contributions to a pixel and of their squares: mean and variance of its luminance."""
    first = sum(float(np.prod([v @ w for v, w in zip(p[::2], p[1::2], strict=True)])) for p in parts)
    second = sum(float(np.prod([v**2 @ w for v, w in zip(p[::2], p[1::2], strict=True)])) for p in parts)
    return first, second


def _tail(area: Area, field_mean: float, pixels: Pixels, effort: float) -> tuple[float, float]:
    """Return the probability that a pixel sparkles, and the mean excess of such pixels times that probability."""
    measured = [_measure(flakes, pixels.pixel_um, effort) for flakes in area.flakes]
    parts = [part for products, _ in measured for part in products]
    first, second = _moments(parts)
    uniform = max(area.mean - first, 0.0)
    largest = max((most for _, most in measured), default=0.0)
    limit = field_mean + pixels.threshold * (field_mean + pixels.dark)
    span = max(first + 12.0 * math.sqrt(second) + 2.0 * largest, 2.0 * (limit - uniform), 1e-12)
    step = span / GRID
    measure = np.zeros(GRID)
    for part in parts:
        _deposit(*part, step, measure)
    measure[0] = 0.0
    characteristic = np.exp(np.fft.rfft(measure) - measure.sum())
    chance = np.maximum(np.fft.irfft(characteristic, GRID), 0.0)
    # the probability of a node is spread over one step about it
    low = uniform + (np.arange(GRID) - 0.5) * step
    part_above = np.clip((low + step - limit) / step, 0.0, 1.0)
    middle = np.maximum(low, limit) + 0.5 * part_above * step
    above = chance * part_above
    return float(above.sum()), float(np.sum(above * (middle - field_mean)))


def uniform_part(area: Area, pixels: Pixels) -> float:
    """Return the luminance of an area without its luminous flakes."""
    parts = [part for flakes in area.flakes for part in _measure(flakes, pixels.pixel_um, 1.0)[0]]
    return max(area.mean - _moments(parts)[0], 0.0)


def _numbers(chance: float, excess: float) -> tuple[float, float, float]:
    """Return the intensity, the area in percent and the grade of sparkle.

    Args:
        chance: fraction of pixels that sparkle.
        excess: their mean luminance above the field, times `chance`.
    """
    intensity = excess / chance if chance > 0 else 0.0
    return intensity, 100.0 * chance, intensity * math.sqrt(chance)


def sparkle_statistics(areas: Sequence[Area], pixels: Pixels, is_fine: bool = True) -> Sparkle:
    """Return sparkle from the flake statistics; its standard errors are those of the quadrature.

    Args:
        areas: parts of the surface, whose shares sum to 1.
        pixels: the camera.
        is_fine: False for half the nodes, a quarter of the time, and errors of 0.
    """
    mean = sum(area.share * area.mean for area in areas)
    statistics = []
    for effort in (1.0, 0.5) if is_fine else (0.5,):
        tails = np.array([_tail(area, mean, pixels, effort) for area in areas])
        chance, excess = np.array([area.share for area in areas]) @ tails
        statistics.append(_numbers(float(chance), float(excess)))
    fine, coarse = statistics[0], statistics[-1]
    return Sparkle(*fine, *(abs(a - b) for a, b in zip(fine, coarse, strict=True)))


def _draw(flakes: LitFlakes, pixels: Pixels, image: Array, generator: np.random.Generator) -> None:
    """Add the luminous flakes of one pigment to an image; candidates are thinned to their density."""
    rows, columns = image.shape
    grid = np.linspace(0.0, 1.0, 65)
    radii = _quantile(flakes.radii_um, grid)
    widths = _widths(flakes, radii)
    ellipse = math.pi * FARTHEST * widths[:, 0] * widths[:, 1]
    turn = np.linspace(0.0, 2 * np.pi, TURNS, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    reach = np.sqrt(np.linspace(0.0, FARTHEST, 24))[:, None, None, None] * circle[:, None] * widths
    most = 1.3 * float(flakes.density(flakes.half + reach).max()) * float(ellipse.max())
    surface = rows * columns * pixels.pixel_um**2 / UM2_PER_MM2
    count = generator.poisson(flakes.number * surface * most)
    for begin in range(0, count, MOST_FLAKES // 8):
        size = min(MOST_FLAKES // 8, count - begin)
        radius = _quantile(flakes.radii_um, generator.random(size))
        width = _widths(flakes, radius)
        away = FARTHEST * generator.random(size)
        angle = 2 * np.pi * generator.random(size)
        offset = np.sqrt(away)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1) * width
        area = math.pi * FARTHEST * width[:, 0] * width[:, 1]
        is_accepted = generator.random(size) * most < flakes.density(flakes.half + offset) * area
        radius, width, away = radius[is_accepted], width[is_accepted], away[is_accepted]
        depth = generator.random(len(radius))
        crossed = generator.poisson(flakes.crossings * depth)
        light = _read_brightness(flakes.brightness, depth, crossed)
        light = light * np.exp(-0.5 * away) / (2.0 * math.pi * width[:, 0] * width[:, 1])
        x, y = columns * generator.random(len(radius)), rows * generator.random(len(radius))
        spot = _spot_radii(flakes, radius) / pixels.pixel_um
        _draw_discs(x, y, spot, light * math.pi * (radius / pixels.pixel_um) ** 2, image)


def _read_brightness(table: Array, depth: Array, crossed: NDArray[np.int64]) -> Array:
    at = depth * (len(table) - 1)
    low = np.minimum(at.astype(int), len(table) - 2)
    column = np.minimum(crossed, table.shape[1] - 1)
    value = table[low, column] + (at - low) * (table[low + 1, column] - table[low, column])
    return np.where(crossed < table.shape[1], value, 0.0)


def _candidates(area: Area) -> float:
    """Return an upper estimate of the flakes to draw per mm2."""
    total = 0.0
    for flakes in area.flakes:
        widths = _widths(flakes, flakes.radii_um)
        ellipse = math.pi * FARTHEST * float((widths[:, 0] * widths[:, 1]).max())
        total += 1.3 * flakes.number * ellipse * float(flakes.density(np.zeros(2)))
    return total


def sparkle_patch(areas: Sequence[Area], pixels: Pixels, seed: int) -> tuple[Sparkle, Array]:
    """Return sparkle from an image of drawn flakes, with standard errors over its blocks (jackknife), and the image.

    The areas lie beside each other as stripes of the field. The field is made smaller where more than a few million
    flakes would be drawn, as the size of the image shows.

    Returns:
        sparkle, and luminance factors `[row, column]`.
    """
    generator = np.random.default_rng(seed)
    side = pixels.field_mm
    expected = sum(area.share * _candidates(area) for area in areas)
    side = min(side, math.sqrt(2 * MOST_FLAKES / max(expected, 1e-9)))
    count = max(BLOCKS, round(side * 1e3 / pixels.pixel_um) // BLOCKS * BLOCKS)
    stripes = []
    ends = np.round(np.cumsum([area.share for area in areas]) * count).astype(int)
    for area, begin, end in zip(areas, [0, *ends[:-1]], ends, strict=True):
        if end > begin:
            image = np.full((end - begin, count), uniform_part(area, pixels))
            for flakes in area.flakes:
                _draw(flakes, pixels, image, generator)
            stripes.append(image)
    picture = np.concatenate(stripes)
    return measure_image(picture, pixels), picture


def measure_image(image: Array, pixels: Pixels) -> Sparkle:
    """Return the sparkle of an image of luminance factors `[row, column]`; jackknife over its blocks."""
    block = max(1, min(image.shape) // BLOCKS)
    rows, columns = image.shape[0] // block, image.shape[1] // block
    pieces = image[: rows * block, : columns * block].reshape(rows, block, columns, block).swapaxes(1, 2)
    blocks = pieces.reshape(rows * columns, -1)
    sums = blocks.sum(axis=1)
    candidates = [np.sort(values[values > 0.5 * image.mean()]) for values in blocks]

    def of(omitted: int | None) -> tuple[float, float]:
        used = [k for k in range(len(blocks)) if k != omitted]
        pixels_used = len(used) * blocks.shape[1]
        mean = float(sums[used].sum()) / pixels_used
        limit = mean + pixels.threshold * (mean + pixels.dark)
        number, light = 0, 0.0
        for k in used:
            above = candidates[k][np.searchsorted(candidates[k], limit, side="right") :]
            number, light = number + len(above), light + float(above.sum())
        return number / pixels_used, (light - number * mean) / pixels_used

    estimate = _numbers(*of(None))
    leave_one_out = np.array([_numbers(*of(k)) for k in range(len(blocks))])
    errors = math.sqrt(len(blocks) - 1.0) * leave_one_out.std(axis=0)
    # errors due to one sparkling pixel; without any, the intensity is unknown
    least = (
        0.0 if estimate[1] > 0 else math.inf,
        100.0 / image.size,
        pixels.threshold * image.mean() / math.sqrt(image.size),
    )
    return Sparkle(*estimate, *(float(max(pair)) for pair in zip(errors, least, strict=True)))


# Graininess of an effect coating under diffuse light: the flakes' luminance differences that the eye resolves.
#
# Flakes cover each other. With N the discs over a point, a and T luminance and transmittance of a flake, and both
# points of a pair covered together by the share g of the discs (their covariogram), the second moment C of the
# luminances of two points obeys, upwards through the stratum,
#
#     dm/dz = N (<a> + (<T> - 1) m),
#     dC/dz = N g (<a^2> + 2 <a T> m + (<T^2> - 1) C) + 2 N (1 - g) (<a> m + (<T> - 1) C):
#
# the colour dead-leaves model of Bordenave, Gousseau and Roueff (Adv. Appl. Probab. 38, 31 (2006)), for flakes that
# transmit. `graininess_statistics` integrates this; `graininess_patch` draws the flakes on top of each other. The
# luminance is then filtered by the contrast sensitivity of the eye (Mannos and Sakrison, IEEE Trans. Inf. Theory 20,
# 525 (1974)), held at its maximum below its peak at 8 cycles per degree, as for the visibility of halftones (Mitsa and
# Varkur, ICASSP 1993). Graininess is the standard deviation of the result over the mean, in per cent. Ferrero et al.,
# "Definition of a measurement scale of graininess from reflectance and visual measurements", Opt. Express (2018),
# propose a scale from luminance factors, which differs from the one used here.

# mypy: allow-untyped-defs, allow-incomplete-defs


PEAK_CPD, LAST_CPD = 8.0, 60.0  # cycles per degree
LAGS, FREQUENCIES, STEPS = 65, 241, 64
SIZES = 24
TILES = 16  # periodic pieces of the field
SAMPLES_PER_DIAMETER = 5.0
MOST_SAMPLES = 1600  # along the side of a tile
FINEST_UM = 10.0  # diameter of drawn flakes, far below the eye's resolution
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
        base: luminance below the flakes, as if they were absent; the remaining mean, not reflected by flakes, is a
            uniform veil.
    """

    flakes: tuple[DiffuseFlakes, ...]
    mean: float
    base: float = 0.0


def eye_filter(cycles_per_mm: Array, distance_mm: float) -> Array:
    """Return the relative contrast sensitivity at a viewing distance."""
    cpd = np.asarray(cycles_per_mm) * distance_mm * math.radians(1.0)
    f = np.maximum(cpd, PEAK_CPD)
    sensitivity = (0.0192 + 0.114 * f) * np.exp(-((0.114 * f) ** 1.1))
    peak = (0.0192 + 0.114 * PEAK_CPD) * math.exp(-((0.114 * PEAK_CPD) ** 1.1))
    return np.asarray(np.where(cpd > LAST_CPD, 0.0, sensitivity / peak))


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
    """Return graininess from the flake statistics; its error is that of the integration.

    Args:
        areas: each with the factor on its luminance, whose squares weight the variances.
        distance_mm: viewing distance.
        is_fine: False for half the steps and an error of 0.
    """
    mean = sum(factor * area.mean for factor, area in areas)
    statistics = [
        sum(factor**2 * filtered_variance(area, distance_mm, steps) for factor, area in areas)
        for steps in ((STEPS, STEPS // 2) if is_fine else (STEPS // 2,))
    ]
    fine, coarse = statistics[0], statistics[-1]
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
        seed: flake seed.
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
