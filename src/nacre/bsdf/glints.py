"""Resolved flakes: glints as a factor on the light reflected once by a flake, and flakes in a camera image.

The surface is a grid of cells with K flakes each: discs with random centre, radius and normal from an integer hash of
the cell. With t the slope of the half vector over the flakes' deviation, the factor at a point is

    g(point, t) = sum over discs around the point of exp(-|t - t_j|^2 / 2 w^2)  /  (coverage M(|t|)),

with M the mean of that kernel over the flake slopes. The mean of g over positions is 1 at every t, so a material with
glints equals the smooth one on average, and samples spread over a pixel average over its flakes.
Slopes follow p(t) = 1 / (pi (1 + t^2)^2): SGGX along its axis (and GGX).

In a camera image a flake is a disc with its own normal. Under a small lamp it is luminous if its normal lies near the
half vector: its luminance is `brightness` times the density of the slope between half vector and normal, a Gaussian
that contains the flatness and the flake's diffraction, the angular spread of a rough interface, and the apertures of
lamp and camera. Under diffuse light every flake is luminous, by its own reflectance, and occludes the flakes below.
Luminances are luminance factors: a perfect white diffuser under the same light has 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nacre.core.arrays import Array
from nacre.core.jit import compiled

# mypy: allow-untyped-defs, allow-incomplete-defs


# columns of `numbers`, one row for each flake species
CELLS_U, CELLS_V, COUNT, COVERAGE, WIDTH, SEED = range(6)
NODES = 65  # both tables
CUT = 2.0  # largest deviation of log size, in standard deviations
# hash increments of a flake's numbers: x, y, two for the slope, radius
DRAWS = tuple((0x9E3779B9 * (i + 1)) & 0xFFFFFFFF for i in range(5))
FLAKE_STEP = 0x85EBCA6B


def glint_species(
    uv_mm: tuple[float, float], diameter_um: float, spread: float, visible: float, width: float, seed: int
) -> tuple[Array, Array, Array]:
    """Return `factor`'s tables for one species: numbers `[6]`, radii by quantile `[65]`, ratio of means `[65]`.

    Args:
        uv_mm: surface length of one unit of u and v.
        diameter_um: median disc diameter.
        spread: standard deviation of the log diameter.
        visible: mean number of visible flakes at a point (flake area over surface area).
        width: width of a single flake's lobe, as a slope over the flakes' deviation.
        seed: hash seed, below 2^24.
    """
    from scipy.special import ndtr, ndtri  # slow to import, and most materials lack flakes

    low = float(ndtr(-CUT))
    radii_mm = 0.5e-3 * diameter_um * np.exp(spread * ndtri(np.linspace(low, 1.0 - low, NODES)))
    # mean square of the piecewise linear radius
    square = float(np.mean(radii_mm[:-1] ** 2 + radii_mm[:-1] * radii_mm[1:] + radii_mm[1:] ** 2)) / 3.0
    # discs reach only the neighbouring cells: a cell is as wide as the widest disc
    count = max(1, math.ceil(visible * (2.0 * radii_mm[-1]) ** 2 / (math.pi * square) - 1e-9))
    cell_mm = math.sqrt(count * math.pi * square / visible)
    numbers = np.array([uv_mm[0] / cell_mm, uv_mm[1] / cell_mm, count, visible, width, seed])
    return numbers, radii_mm / cell_mm, mean_ratio(width)


def check_glints(numbers: Array, radii: Array | None, ratio: Array | None, kinds: int) -> None:
    """Check a lobe's glint arrays.

    Raises:
        ValueError: names the inconsistent array.
    """
    if numbers.shape != (kinds, SEED + 1) or np.any(numbers[:, :SEED] <= 0):
        raise ValueError(f"glint_numbers has the shape {numbers.shape} or a number that is not above 0")
    for name, table in (("glint_radii", radii), ("glint_ratio", ratio)):
        if table is None or table.ndim != 2 or len(table) != kinds or table.shape[1] < 2:
            raise ValueError(f"{name} does not fit glint_numbers")


def mean_ratio(width: float) -> Array:
    """Return M over its narrow-kernel limit 2 pi w^2 p(t), `[node]`, on uniform nodes in t / (1 + t)."""
    share = np.linspace(0.0, 1.0, NODES)[:-1]
    t = share / (1.0 - share)
    # Gauss nodes of the other slope within ten widths
    x, weight = np.polynomial.legendre.leggauss(400)
    low, high = np.maximum(t - 10.0 * width, 0.0), t + 10.0 * width
    other = low[:, None] + 0.5 * (high - low)[:, None] * (x + 1.0)
    density = 1.0 / (np.pi * (1.0 + other**2) ** 2)
    from scipy.special import ive

    kernel = np.exp(-0.5 * ((t[:, None] - other) / width) ** 2) * ive(0, t[:, None] * other / width**2)
    mean = 0.5 * (high - low) * np.sum(weight * kernel * density * 2.0 * np.pi * other, axis=1)
    ratio = mean / (2.0 * np.pi * width**2) * np.pi * (1.0 + t**2) ** 2
    return np.append(ratio, 1.0)


@compiled(nogil=True)
def mix(x):
    """Hash a 32-bit number (stored in 64 bits)."""
    x = (x ^ (x >> 16)) * 0x7FEB352D & 0xFFFFFFFF
    x = (x ^ (x >> 15)) * 0x846CA68B & 0xFFFFFFFF
    return x ^ (x >> 16)


@compiled(nogil=True)
def _uniform(key, step):
    return (mix((key + step) & 0xFFFFFFFF) >> 8) * 5.9604644775390625e-08


@compiled(nogil=True)
def _read(table, share):
    at = share * (table.size - 1)
    low = min(int(at), table.size - 2)
    return table[low] + (at - low) * (table[low + 1] - table[low])


@compiled(nogil=True)
def factor(numbers, radii, ratio, u, v, tx, ty):
    """Return g at a surface point for the slope (tx, ty) over the flakes' deviation."""
    x, y = u * numbers[CELLS_U], v * numbers[CELLS_V]
    column, line = int(math.floor(x - 0.5)), int(math.floor(y - 0.5))
    count, width = int(numbers[COUNT]), numbers[WIDTH]
    total = 0.0
    for n in range(4 * count):
        i, j = column + (n & 1), line + ((n >> 1) & 1)
        key = mix((int(numbers[SEED]) + (n >> 2) * FLAKE_STEP) & 0xFFFFFFFF)
        key = mix((key ^ (i & 0xFFFFFFFF)) & 0xFFFFFFFF)
        key = mix((key + (j & 0xFFFFFFFF)) & 0xFFFFFFFF)
        dx, dy = x - i - _uniform(key, DRAWS[0]), y - j - _uniform(key, DRAWS[1])
        if dx * dx + dy * dy > _read(radii, _uniform(key, DRAWS[4])) ** 2:
            continue
        share = _uniform(key, DRAWS[2])
        t = math.sqrt(share / (1.0 - share))
        turn = 6.283185307179586 * _uniform(key, DRAWS[3])
        away = (tx - t * math.cos(turn)) ** 2 + (ty - t * math.sin(turn)) ** 2
        total += math.exp(-0.5 * away / (width * width))
    t2 = tx * tx + ty * ty
    t = math.sqrt(t2)
    mean = _read(ratio, t / (1.0 + t)) * 2.0 * width * width / (1.0 + t2) ** 2
    return total / (numbers[COVERAGE] * mean)


@compiled(nogil=True)
def factors(numbers, radii, ratio, uv, slopes):
    """Return g for points `uv[n, 2]` and slopes `[n, 2]`."""
    out = np.empty(len(uv))
    for n in range(len(uv)):
        out[n] = factor(numbers, radii, ratio, uv[n, 0], uv[n, 1], slopes[n, 0], slopes[n, 1])
    return out


RADIUS_NODES = 65


def radius_quantiles(diameter_um: float, spread: float, nodes: int = RADIUS_NODES) -> Array:
    """Return the radii in um at uniform quantiles of a log-normal diameter cut at two standard deviations, `[node]`."""
    from scipy.special import ndtr, ndtri  # slow to import, and most materials lack flakes

    low = float(ndtr(-CUT))
    return np.asarray(0.5 * diameter_um * np.exp(spread * ndtri(np.linspace(low, 1.0 - low, nodes))))


def mean_square(table: Array) -> float:
    """Return the mean square of a number given by a table over uniform quantiles, linear between the nodes."""
    return float(np.mean(table[:-1] ** 2 + table[:-1] * table[1:] + table[1:] ** 2)) / 3.0


@dataclass(frozen=True)
class LitFlakes:
    """Flakes of one pigment under a small lamp.

    Attributes:
        number: visible discs per mm2 of surface, before shading.
        radii_um: `[quantile]`, on uniform nodes.
        blur_um: standard deviation of the image of a point, on the surface, along one axis.
        half: `[2]`, slope of the half vector in the resin.
        variance: `[2]`, slope variance between half vector and normal, along x and y, without diffraction.
        diffraction_um: standard deviation of that slope by diffraction, times the diameter in um.
        density: density of the flakes' slopes `[..., 2]`, weighted by projected area; integrates to the projected area
            of all flakes over that of the same flakes lying flat.
        brightness: `[depth, crossings]`, luminance times unit slope area, on uniform depth nodes, by the number of
            other flakes that the light crosses on its way in and out.
        crossings: mean number of crossings for a flake at the lower side of its stratum.
    """

    number: float
    radii_um: Array
    blur_um: float
    half: Array
    variance: Array
    diffraction_um: float
    density: Callable[[Array], Array]
    brightness: Array
    crossings: float

    def scaled(self, share: float) -> LitFlakes:
        """Return the flakes with their luminance multiplied by `share`."""
        return replace(self, brightness=self.brightness * share)


@dataclass(frozen=True)
class DiffuseFlakes:
    """Flakes of one pigment under diffuse light, seen along the surface's normal.

    Attributes:
        stratum: index of their stratum, from the light inward.
        coverage: projected area of the discs over the surface's area.
        radii_um: `[quantile]`, on uniform nodes.
        facing: `[quantile]`, cosine between normal and viewer, on uniform nodes.
        luminance: `[depth, cos]`, a flake's luminance on uniform nodes; it includes the light's path to the flake and
            absorption in the resin, but excludes flakes between this one and the viewer.
        transmittance: `[cos]`, a flake's transmittance on uniform nodes.
    """

    stratum: int
    coverage: float
    radii_um: Array
    facing: Array
    luminance: Array
    transmittance: Array
