"""Flake thickness distributions, and a platelet's R and T averaged over its substrate thickness.

Natural mica varies by a third of its thickness, synthetic silica by a few nm. With the substrate separated,
r = r_A + C y/(1 - rho y) and |t|^2 = |t_A t_B|^2 |y| / |1 - rho y|^2, y = exp(i p tau) and p = 2 k0 kz_s. For a
lossless substrate below its critical angle (p real) the geometric series turns the average over tau into sums over
Y_m = <y^m>, the characteristic function of the thickness:

    S1 = sum rho^m Y_m,  S2 = sum rho^(m-1) Y_m,  A = (1 + 2 Re S1) / (1 - |rho|^2)
    <R> = |r_A|^2 + 2 Re(conj(r_A) C S2) + |C|^2 A,   <T> = |t_A t_B|^2 A

For complex p the integrand is damped, and a quadrature over tau converges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from math import erfc, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, ComplexArray, gauss_legendre
from nacre.core.errors import NacreError
from nacre.core.jit import compiled

DISTRIBUTIONS = ("gaussian", "truncated", "lognormal", "histogram")
SPREAD = 8.3  # Gaussian half-width in deviations, with less than 1e-16 beyond
MAX_TERMS = 4000
GAUSSIAN, TABULATED = 0, 1
RHO_FLOOR = 1e-15
SHORT_PHASE = 0.7  # rad over the support, near the critical angle: the series converges slowly, the quadrature fast
POINTS_PER_PANEL = 16
SAME_WIDTH = 1e-12
PANEL_PER_DISTANCE = 2.4  # error 1e-11 with 16 Gauss points on a panel


@dataclass(frozen=True)
class Thickness:
    """One layer's thickness distribution over the flakes.

    Attributes:
        mean_nm: the mean, before truncation.
        deviation_nm: standard deviation; 0 is one thickness for all flakes. Ignored for a histogram.
        distribution: "gaussian" (cut at zero), "truncated" (cut at
            `low_nm` and `high_nm`), "lognormal" or "histogram".
        low_nm, high_nm: bounds for "truncated".
        edges_nm, fractions: bins for "histogram": ascending edges `[bin + 1]`, weights `[bin]` that sum to 1;
            the density is constant within a bin.

    Raises:
        NacreError: a number is out-of-range; the message names it.
    """

    mean_nm: float
    deviation_nm: float = 0.0
    distribution: str = "gaussian"
    low_nm: float = 0.0
    high_nm: float = np.inf
    edges_nm: Array | None = None
    fractions: Array | None = None

    def __post_init__(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            raise NacreError(f'distribution = "{self.distribution}" is not known; use {", ".join(DISTRIBUTIONS)}')
        if self.distribution == "histogram":
            _check_histogram(self.edges_nm, self.fractions)
        if not self.mean_nm >= 0 or not np.isfinite(self.mean_nm):
            raise NacreError(f"thickness_nm = {self.mean_nm} is not allowed; it should be at least 0")
        if not self.deviation_nm >= 0 or not np.isfinite(self.deviation_nm):
            raise NacreError(f"deviation_nm = {self.deviation_nm} is not allowed; it should be at least 0")
        if self.deviation_nm > 0 and self.distribution == "lognormal" and self.mean_nm == 0:
            raise NacreError("a lognormal thickness needs a mean above 0")
        if not 0 <= self.low_nm < self.high_nm:
            raise NacreError(f"bounds {self.low_nm}..{self.high_nm} nm are not allowed; they should ascend from 0")
        if self.is_gaussian and self.deviation_nm > 0:
            low, high = self.support
            if not low < high:
                raise NacreError(
                    f"bounds {self.low_nm}..{self.high_nm} nm hold no flake of {self.mean_nm} +- {self.deviation_nm} nm"
                )

    @classmethod
    def from_histogram(cls, thicknesses_nm: Array, fractions: Array) -> Thickness:
        """Build from a measured histogram: bin centres (ascending) and their fractions.

        Bin edges lie half way between centres; the outer bins are as wide as their neighbours.

        Raises:
            NacreError: fractions that are negative or do not sum to 1 within 1e-3, or centres out of order.
        """
        centres = np.asarray(thicknesses_nm, dtype=float)
        weights = np.asarray(fractions, dtype=float)
        if centres.ndim != 1 or centres.shape != weights.shape or len(centres) < 2:
            raise NacreError("a thickness histogram needs two columns of at least two rows: thickness in nm, fraction")
        if not (np.all(np.isfinite(centres)) and np.all(np.diff(centres) > 0) and centres[0] > 0):
            raise NacreError("the thicknesses of a histogram must be positive and ascend")
        inner = (centres[1:] + centres[:-1]) / 2
        edges = np.concatenate([[max(0.0, 2 * centres[0] - inner[0])], inner, [2 * centres[-1] - inner[-1]]])
        _check_histogram(edges, weights)
        weights = weights / weights.sum()
        mean = float(np.sum(weights * (edges[1:] + edges[:-1]) / 2))
        return cls(mean, 0.0, "histogram", edges_nm=edges, fractions=weights)

    @property
    def key(self) -> tuple[object, ...]:
        """Hashable field values."""
        return tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in vars(self).values())

    @property
    def is_fixed(self) -> bool:
        """Whether every flake has the same thickness."""
        return self.distribution != "histogram" and self.deviation_nm == 0

    @property
    def is_gaussian(self) -> bool:
        """Whether the density is a Gaussian, cut or not."""
        return self.distribution in ("gaussian", "truncated")

    @property
    def is_uncut(self) -> bool:
        """Whether bounds cut a Gaussian by less than rounding error."""
        reach = SPREAD * self.deviation_nm
        return self.is_gaussian and self.mean_nm - reach >= self.low_nm and self.mean_nm + reach <= self.high_nm

    @property
    def cut_share(self) -> float:
        """Gaussian share cut off by the bounds."""
        scale = sqrt(2.0) * self.deviation_nm
        return 0.5 * (erfc((self.mean_nm - self.low_nm) / scale) + erfc((self.high_nm - self.mean_nm) / scale))

    @property
    def support(self) -> tuple[float, float]:
        """Interval with all but 1e-16 flakes, in nm."""
        if self.is_fixed:
            return self.mean_nm, self.mean_nm
        if self.distribution == "histogram":
            assert self.edges_nm is not None
            return float(self.edges_nm[0]), float(self.edges_nm[-1])
        if self.distribution == "lognormal":
            location, scale = self._lognormal
            return float(np.exp(location - SPREAD * scale)), float(np.exp(location + SPREAD * scale))
        reach = SPREAD * self.deviation_nm
        return max(self.low_nm, self.mean_nm - reach), min(self.high_nm, self.mean_nm + reach)

    @property
    def average_nm(self) -> float:
        """Mean over the flakes, after truncation."""
        if self.is_fixed or self.is_uncut or self.distribution == "lognormal":
            return self.mean_nm
        nodes, weights = self.nodes(32)
        return float(np.sum(nodes * weights))

    @property
    def _lognormal(self) -> tuple[float, float]:
        scale = np.sqrt(np.log1p((self.deviation_nm / self.mean_nm) ** 2))
        return float(np.log(self.mean_nm) - scale**2 / 2), float(scale)

    def nodes(self, panels: int) -> tuple[Array, Array]:
        """Return quadrature nodes (nm) and weights summing to 1: Gauss-Legendre on `panels` panels or more."""
        if self.is_fixed:
            return np.array([self.mean_nm]), np.array([1.0])
        x, w = gauss_legendre(POINTS_PER_PANEL)
        if self.distribution == "histogram":
            assert self.edges_nm is not None and self.fractions is not None
            split = max(1, -(-panels // len(self.fractions)))
            edges = np.concatenate([np.linspace(a, b, split + 1)[:-1] for a, b in _pairs(self.edges_nm)])
            edges = np.append(edges, self.edges_nm[-1])
            density = np.repeat(self.fractions / np.diff(self.edges_nm), split)
            half = np.diff(edges)[:, None] / 2
            nodes = (edges[:-1, None] + edges[1:, None]) / 2 + half * x
            return nodes.ravel(), (half * w * density[:, None]).ravel()
        low, high = self.support
        if self.distribution == "lognormal":
            location, scale = self._lognormal
            edges = np.linspace(np.log(low), np.log(high), panels + 1)
            half = np.diff(edges)[:, None] / 2
            logs = (edges[:-1, None] + edges[1:, None]) / 2 + half * x
            weights = half * w * np.exp(-(((logs - location) / scale) ** 2) / 2)
            return np.exp(logs).ravel(), (weights / weights.sum()).ravel()
        edges = np.linspace(low, high, panels + 1)
        half = np.diff(edges)[:, None] / 2
        nodes = (edges[:-1, None] + edges[1:, None]) / 2 + half * x
        weights = half * w * np.exp(-(((nodes - self.mean_nm) / self.deviation_nm) ** 2) / 2)
        return nodes.ravel(), (weights / weights.sum()).ravel()

    def characteristic(self, x_max: float) -> tuple[ComplexArray, float, float]:
        """Tabulate <exp(i x (tau - centre))> on a uniform grid x >= 0, for six-point interpolation.

        The centre is the support's middle. The rest oscillates at most with half the support, and the samples per
        oscillation (more for truncated distributions) interpolate to 1e-9.

        Returns:
            values `[x]` (complex), the step in 1/nm, the centre in nm. Beyond the table the average is zero to
            1e-12, or x exceeds `x_max`.
        """
        low, high = self.support
        centre, half = (low + high) / 2, (high - low) / 2
        if self.distribution == "lognormal":
            # the far tail widens the support without weight; the bulk sets the oscillation
            location, scale = self._lognormal
            centre, half = self.mean_nm, float(np.exp(location + 6.5 * scale)) - self.mean_nm
        step = np.pi / half / (8 if self.is_uncut else 24)
        count = int(np.ceil(x_max / step)) + 8
        blocks, size = [], 512
        for start in range(0, count, size):
            x = step * np.arange(start, min(start + size, count), dtype=np.float64)
            block = self._average_phase(np.asarray(x, dtype=np.float64), centre)
            blocks.append(block)
            if np.max(np.abs(block)) < 1e-12:
                break
        return np.concatenate(blocks), step, centre

    def _average_phase(self, x: Array, centre: float) -> ComplexArray:
        if self.distribution == "histogram":
            assert self.edges_nm is not None and self.fractions is not None
            middle, width = (self.edges_nm[1:] + self.edges_nm[:-1]) / 2, np.diff(self.edges_nm)
            envelope = np.sinc(x[:, None] * width / (2 * np.pi))
            return np.asarray(np.sum(self.fractions * envelope * np.exp(1j * x[:, None] * (middle - centre)), axis=1))
        if self.distribution == "lognormal":
            nodes, weights = self.nodes(192)
            return np.asarray(np.exp(1j * x[:, None] * (nodes - centre)) @ weights)
        return self._cut_gaussian_phase(x, centre)

    def _cut_gaussian_phase(self, x: Array, centre: float) -> ComplexArray:
        """Return a cut Gaussian's Fourier integral: two complex error functions (Faddeeva's w)."""
        from scipy.special import erf, wofz

        a = (self.low_nm - self.mean_nm) / self.deviation_nm
        b = (self.high_nm - self.mean_nm) / self.deviation_nm
        total = (erf(b / np.sqrt(2)) - erf(a / np.sqrt(2))) / 2
        z = x * self.deviation_nm
        value = np.exp(1j * x * (self.mean_nm - centre) - z**2 / 2)
        # the part beyond each bound: exp(i x tau) erfc(..)/2 written with w against overflow
        if np.isfinite(b):
            value = value - _tail(b, z, wofz) * np.exp(1j * x * (self.high_nm - centre))
        value = value - _tail(-a, -z, wofz) * np.exp(1j * x * (self.low_nm - centre))
        return np.asarray(value / total)


def _tail(bound: float, z: Array, wofz: object) -> ComplexArray:
    """Return a unit Gaussian's weight times exp(i z t) beyond t = bound > 0, relative to the phase at the bound."""
    argument = (z + 1j * bound) / np.sqrt(2)
    return np.asarray(np.exp(-(bound**2) / 2) * wofz(argument) / 2)  # type: ignore[operator]  # scipy has no stubs


def _pairs(edges: Array) -> Iterator[tuple[float, float]]:
    return zip(edges[:-1], edges[1:], strict=True)


def _check_histogram(edges: Array | None, fractions: Array | None) -> None:
    if edges is None or fractions is None or len(edges) != len(fractions) + 1:
        raise NacreError("a thickness histogram needs one more bin edge than fractions")
    if not (np.all(np.isfinite(edges)) and np.all(np.diff(edges) > 0) and edges[0] >= 0):
        raise NacreError("the bin edges of a thickness histogram must ascend from 0 or above")
    if not np.all(np.asarray(fractions) >= 0):
        raise NacreError("the fractions of a thickness histogram must not be negative")
    total = float(np.sum(fractions))
    if not abs(total - 1) <= 1e-3:
        raise NacreError(f"the fractions of a thickness histogram sum to {total:.6g}; they should sum to 1")


class Distribution(NamedTuple):
    """A thickness distribution for the averaging kernels.

    Attributes:
        is_fixed: all flakes have the thickness `mean`.
        kind: GAUSSIAN (closed form in `mean`, `deviation`) or TABULATED (`table` about `mean`, with step `step`).
        low, high: support, nm.
        nodes, weights, starts: quadrature ladder; number i is starts[i]:starts[i + 1], each twice as long.
    """

    is_fixed: bool
    kind: int
    mean: float
    deviation: float
    table: ComplexArray
    step: float
    low: float
    high: float
    nodes: Array
    weights: Array
    starts: NDArray[np.int64]


@compiled(error_model="numpy")
def _interpolate(table: Any, position: float) -> complex:
    """Six-point Lagrange interpolation on a uniform grid that starts at 0; mirrored (conjugate) below 0."""
    last = table.shape[0] - 1
    if position >= last - 2:
        return 0.0j
    base = int(position)
    f = position - base
    a, b, c, d, e = f + 2.0, f + 1.0, f - 1.0, f - 2.0, f - 3.0
    cde = c * d * e
    low = a * b * f
    first = table[base - 2] if base >= 2 else table[2 - base].conjugate()
    second = table[base - 1] if base >= 1 else table[1 - base].conjugate()
    return (
        (-b * f * cde / 120.0) * first
        + (a * f * cde / 24.0) * second
        + (-a * b * cde / 12.0) * table[base]
        + (low * d * e / 12.0) * table[base + 1]
        + (-low * c * e / 24.0) * table[base + 2]
        + (low * c * d / 120.0) * table[base + 3]
    )


@compiled(error_model="numpy")
def _series(rho: complex, p: float, kind: int, mean: float, deviation: float, table: Any, step: float) -> Any:
    """Return S1, S2. `mean` is the centre about which `table` is stored."""
    size = abs(rho)
    s1, s2 = 0.0j, 0.0j
    power = 1.0 + 0.0j
    rotation = complex(math.cos(p * mean), math.sin(p * mean))
    phase = 1.0 + 0.0j
    magnitude = 1.0
    limit = table.shape[0] * step
    for m in range(1, MAX_TERMS + 1):
        x = m * p
        phase *= rotation
        if kind == GAUSSIAN:
            damping = 0.5 * (x * deviation) ** 2
            if damping > 36.0:
                break
            average = phase * math.exp(-damping)
        else:
            if x > limit:
                break
            average = phase * _interpolate(table, x / step)
        s2 += power * average
        power *= rho
        s1 += power * average
        magnitude *= size
        if magnitude < 1e-17:
            break
    return s1, s2


@compiled(error_model="numpy", inline="always")
def _wave(p: complex, tau: float) -> complex:
    """exp(i p tau)."""
    x = p.real * tau
    return complex(math.cos(x), math.sin(x)) * math.exp(-p.imag * tau)


@compiled(error_model="numpy")
def _point(big_c: complex, r_a: complex, transfer: float, rho: complex, y: complex) -> Any:
    """Return R and T for one thickness."""
    denominator = 1.0 - rho * y
    over = 1.0 / (denominator.real * denominator.real + denominator.imag * denominator.imag)
    r = r_a + big_c * y * complex(denominator.real * over, -denominator.imag * over)
    return r.real * r.real + r.imag * r.imag, transfer * math.sqrt(y.real * y.real + y.imag * y.imag) * over


@compiled(error_model="numpy")
def _pole_distance(rho: complex, p: complex, low: float, high: float) -> float:
    """Return the distance from [low, high] to the nearest complex thickness with rho exp(i p tau) = 1.

    A Gauss rule converges with its panel width over this distance.
    """
    if abs(rho) < 1e-6:
        return high - low
    log = 1j * np.log(rho)
    nearest = high - low
    first = int(math.floor(p.real * low / (2.0 * math.pi))) - 1
    last = int(math.ceil(p.real * high / (2.0 * math.pi))) + 1
    for m in range(first, last + 1):
        pole = (2.0 * math.pi * m + log) / p
        beyond = max(low - pole.real, pole.real - high, 0.0)
        nearest = min(nearest, math.sqrt(beyond * beyond + pole.imag * pole.imag))
    return max(nearest, 1e-6 * (high - low))


@compiled(error_model="numpy", nogil=True)
def _by_series(p: float, amplitudes: Any, i: int, pol: int, flakes: Any) -> Any:
    """Return R and T for a lossless substrate by the series over round trips."""
    r_a, big_c, rho, transfer = amplitudes
    s1, s2 = _series(rho[pol, i], p, flakes.kind, flakes.mean, flakes.deviation, flakes.table, flakes.step)
    size = min(abs(rho[pol, i]), 1.0 - RHO_FLOOR)
    r0, c0 = r_a[pol, i], big_c[pol, i]
    airy = (1.0 + 2.0 * s1.real) / (1.0 - size * size)
    cross = (r0.conjugate() * c0 * s2).real
    uncoated, added = r0.real * r0.real + r0.imag * r0.imag, (c0.real * c0.real + c0.imag * c0.imag) * airy
    return uncoated + 2.0 * cross + added, transfer[pol, i] * airy


@compiled(error_model="numpy", nogil=True)
def _by_quadrature(p: complex, amplitudes: Any, i: int, pol: int, flakes: Any, inside: Any) -> Any:
    """R and T by a quadrature over the thickness, as fine as the nearest pole requires; `inside` is scratch."""
    r_a, big_c, rho, transfer = amplitudes
    nodes, weights, starts = flakes.nodes, flakes.weights, flakes.starts
    distance = _pole_distance(rho[pol, i], p, flakes.low, flakes.high)
    panels = (flakes.high - flakes.low) / (PANEL_PER_DISTANCE * distance) + 8.0
    level = 0
    while level < starts.shape[0] - 2 and starts[level + 1] - starts[level] < POINTS_PER_PANEL * panels:
        level += 1
    total_r, total_t, shared_width = 0.0, 0.0, 0.0
    for panel in range(starts[level], starts[level + 1], POINTS_PER_PANEL):
        # panels with equal width share exp(ip (tau - tau_first)), so that a node costs a product
        width = nodes[panel + POINTS_PER_PANEL - 1] - nodes[panel]
        if panel == starts[level] or abs(width - shared_width) > SAME_WIDTH * width:
            shared_width = width
            for k in range(POINTS_PER_PANEL):
                inside[k] = _wave(p, nodes[panel + k] - nodes[panel])
        first = _wave(p, nodes[panel])
        for k in range(POINTS_PER_PANEL):
            r, t = _point(big_c[pol, i], r_a[pol, i], transfer[pol, i], rho[pol, i], first * inside[k])
            total_r += weights[panel + k] * r
            total_t += weights[panel + k] * t
    return total_r, total_t


@compiled(error_model="numpy", nogil=True)
def average_platelet(p: Any, amplitudes: Any, flakes: Any, out_r: Any, out_t: Any, begin: int, end: int) -> None:
    """Write <R> and <T> for the points begin..end.

    Args:
        p: complex `[point]`, substrate 2 k0 kz, 1/nm; shared by both polarisations.
        amplitudes: r_A, t_A t_A' r_B and r_A' r_B, complex, and |t_A t_B|^2, each `[polarisation, point]`.
        flakes: a `Distribution`.
        out_r, out_t: `[polarisation, point]`.
    """
    r_a, big_c, rho, transfer = amplitudes
    inside = np.empty(POINTS_PER_PANEL, np.complex128)
    for i in range(begin, end):
        for pol in range(r_a.shape[0]):
            if flakes.is_fixed:
                y = _wave(p[i], flakes.mean)
                r, t = _point(big_c[pol, i], r_a[pol, i], transfer[pol, i], rho[pol, i], y)
            elif p[i].imag == 0.0 and p[i].real * (flakes.high - flakes.low) > SHORT_PHASE:
                r, t = _by_series(p[i].real, amplitudes, i, pol, flakes)
            else:
                r, t = _by_quadrature(p[i], amplitudes, i, pol, flakes, inside)
            out_r[pol, i], out_t[pol, i] = r, t
