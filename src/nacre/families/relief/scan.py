"""A measured surface that is neither square nor periodic: mean over coherence windows, or its power spectral density.

The reflected field splits into its mean m, which reflects as a mirror, and the rest, which scatters (Beckmann &
Spizzichino 1963). m is exact for a plane, so that no seam exists. The scatter has one of two sources:

- "scan": the scan itself under overlapping Hann windows (Welch 1967), which gives the orders of a structure and the
  speckle of one sample;
- "random", "isotropic": a surface of normally distributed heights with the scan's autocovariance C, for which
  <R R*> = exp(-(2 pi kappa)^2 (C(0) - C(lag))) (Krywonos, Harvey & Choi 2011, generalised Harvey-Shack theory).

Both are given as power of lines with a period, which `spectrum_map` smooths by the coherence window.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates, spline_filter, zoom

from nacre.core.arrays import Array
from nacre.families.relief.surface import SINUSOID, Validity, expected_de00, mean_feature_nm
from nacre.readers.heights.surface import autocovariance

Statistics = Literal["scan", "random", "isotropic"]
RealArray = NDArray[Any]
WINDOW_WIDTHS = 16.0  # side of a Hann window in coherence widths: it adds 10 % to the variance of an order
LAG_WIDTHS = 6.5  # largest lag: exp(-lag^2 / (4 s^2)) is 3e-5
DENSE_WIDTHS = 12.5  # period above which the order spacing is below the smoothing width
RMS_STEP = 1.0  # rad between neighbouring samples, rms: the Nyquist frequency is three deviations of the spectrum
MAX_UPSAMPLING = 8
SAMPLES_OF_ALL_NODES = 3e8  # limits the window count
MAX_WINDOWS = 64
# a random surface: nearly normal heights, no repetition in the autocovariance, at least so many independent cells
MOST_SKEWNESS, MOST_EXCESS, MOST_REPETITION, LEAST_CELLS = 0.5, 1.0, 0.3, 100
LEAST_ASPECT = 0.6  # shortest over longest correlation length of an isotropic texture
RANDOM_RANGE = 4.0  # height range, in Sq, whose phases set the nodes of exp(-(2 pi kappa Sq)^2)
MAX_POINTS = 1 << 22  # points of the part from which the statistics are chosen
AZIMUTHS = 64
MIDDLE_NM = 550.0


@dataclass(frozen=True)
class ScanLines:
    """Power of lines of a scan, for one coherence window.

    Attributes:
        period_nm: reciprocal distance of the lines.
        highest: number of the highest line.
        power: kappa in 1/nm -> mirror share |m|^2, and powers `[2 highest + 1, 2 highest + 1]` of the scatter.
        windows: window count.
        noise: relative standard deviation of the scatter in one direction, from the number of independent windows.
        upsampling: samples per point along each axis.
        bytes_per_node: memory of one evaluation.
    """

    period_nm: float
    highest: int
    power: Callable[[float], tuple[float, RealArray]]
    windows: int
    noise: float
    upsampling: int
    bytes_per_node: float


@dataclass(frozen=True, eq=False)
class Scan:
    """Heights of an instrument on a square lattice.

    Attributes:
        heights_nm: `[x, y]`, without holes and without the least-squares plane.
        pitch_nm: point distance.
        tilt: slopes (x, y) of the plane; 0 if it is not part of the optical surface.
        statistics: "scan", "random", "isotropic", or None for the choice by `suggested`.
        figures: Sq and others, for reports.
        remarks: corrections applied to the heights.
    """

    heights_nm: Array
    pitch_nm: float
    tilt: tuple[float, float] = (0.0, 0.0)
    statistics: Statistics | None = None
    figures: tuple[tuple[str, float], ...] = ()
    remarks: tuple[str, ...] = ()

    @functools.cached_property
    def sq_nm(self) -> float:
        """Root mean square height."""
        return float(self.heights_nm.std())

    @functools.cached_property
    def slopes(self) -> tuple[float, float]:
        """Root mean square slopes along x and y."""
        slopes = [float(np.sqrt(np.mean(np.diff(self.heights_nm, axis=k) ** 2))) / self.pitch_nm for k in (0, 1)]
        return slopes[0], slopes[1]

    @functools.cached_property
    def kind(self) -> Statistics:
        """The statistics as given, or those suggested by the heights."""
        return self.statistics or suggested(self.heights_nm)

    @functools.cached_property
    def height_range_nm(self) -> float:
        """Height difference that sets the node count over kappa."""
        span = float(np.ptp(self.heights_nm))
        return span if self.kind == "scan" else min(span, RANDOM_RANGE * self.sq_nm)

    def ranges_nm(self, width_nm: float) -> tuple[float, float]:
        """Return the height ranges that set the nodes over kappa and those of the spline over xi.

        Within a coherence window a kept tilt spans a normal distribution of heights with the deviation
        sqrt(2) s slope: nine deviations for an expansion that converges, three for a spline of its Gaussian.
        """
        deviation = float(np.sqrt(2.0) * width_nm * np.hypot(*self.tilt))
        return self.height_range_nm + 9.0 * deviation, self.height_range_nm + 3.0 * deviation

    def lines(self, width_nm: float, kappa_max: float, highest_per_nm: float, nodes: int) -> ScanLines:
        """Return the powers for coherence windows up to `width_nm`.

        Args:
            width_nm: largest standard deviation s of the coherence window.
            kappa_max: largest xi / lambda, 1/nm.
            highest_per_nm: highest spatial frequency.
            nodes: number of kappa values that will be requested, which limits the window count.
        """
        step = 2.0 * np.pi * kappa_max * max(self.slopes) * self.pitch_nm
        upsampling = int(np.clip(np.ceil(step / RMS_STEP), 1, MAX_UPSAMPLING))
        make = self._windows if self.kind == "scan" else self._covariance
        return make(width_nm, highest_per_nm, nodes, upsampling)

    def _windows(self, width_nm: float, highest_per_nm: float, nodes: int, upsampling: int) -> ScanLines:
        side = min(*self.heights_nm.shape, max(8, int(np.ceil(WINDOW_WIDTHS * width_nm / self.pitch_nm))))
        is_dense = side * self.pitch_nm >= DENSE_WIDTHS * width_nm
        samples = side * upsampling
        period = scipy.fft.next_fast_len(samples if is_dense else 2 * samples)
        most = int(np.clip(SAMPLES_OF_ALL_NODES / (nodes * period**2), 1, MAX_WINDOWS))
        corners = _corners(self.heights_nm.shape, side, most)
        taper = np.sin(np.pi * (np.arange(samples) + 0.5) / samples).astype(np.float32) ** 2
        window = taper[:, None] * taper
        norm = float((window.astype(float) ** 2).sum())
        parts = [self._part(corner, side, upsampling) for corner in corners]
        highest = min((period - 1) // 2, int(np.ceil(highest_per_nm * period * self.pitch_nm / upsampling)))
        keep = np.arange(-highest, highest + 1) % period

        def power(kappa: float) -> tuple[float, RealArray]:
            mean = 0.0j
            fields = []
            for heights in parts:
                phase = heights * np.float32(-2.0 * np.pi * kappa)
                field = np.empty(phase.shape, np.complex64)
                np.cos(phase, out=field.real)
                np.sin(phase, out=field.imag)
                mean += np.vdot(window**2, field) / norm
                fields.append(field)
            mean /= len(parts)
            total: RealArray = np.zeros((len(keep), len(keep)), np.float32)
            for field in fields:
                field -= np.complex64(mean)
                field *= window
                # along y first, where samples are contiguous; then along x for the kept columns
                spectrum = scipy.fft.fft(field, period, axis=1)[:, keep]
                spectrum = scipy.fft.fft(spectrum, period, axis=0)[keep]
                total += spectrum.real**2 + spectrum.imag**2
            return abs(mean) ** 2, total * np.float32(1.0 / (norm * len(parts) * float(period) ** 2))

        # a Hann window counts as 0.514 of its side; windows that overlap by half are worth three quarters
        cells = 0.264 * (side * self.pitch_nm) ** 2 / (4.0 * np.pi * width_nm**2)
        worth = 1.0 if len(parts) == 1 else 0.75 * len(parts)
        noise = float(1.0 / np.sqrt(max(1.0, cells * worth)))
        size = 12.0 * len(parts) * samples**2 + 16.0 * samples * period + 16.0 * len(keep) ** 2
        return ScanLines(period * self.pitch_nm / upsampling, highest, power, len(parts), noise, upsampling, size)

    def _part(self, corner: tuple[int, int], side: int, upsampling: int) -> RealArray:
        part = self.heights_nm[corner[0] : corner[0] + side, corner[1] : corner[1] + side]
        if upsampling > 1:
            part = zoom(part, upsampling, order=3, mode="grid-mirror", grid_mode=True)
        return np.ascontiguousarray(part, dtype=np.float32)

    @functools.cached_property
    def _autocovariance(self) -> Array:
        return autocovariance(self.heights_nm)

    def _covariance(self, width_nm: float, highest_per_nm: float, nodes: int, upsampling: int) -> ScanLines:
        reach = min(int(np.ceil(LAG_WIDTHS * width_nm / self.pitch_nm)), (min(self.heights_nm.shape) - 1) // 2)
        covariance = self._autocovariance
        lags = np.arange(-reach, reach + 1)
        near = covariance[lags[:, None], lags]
        if self.kind == "isotropic":
            near = _azimuthal_mean(near)
        if upsampling > 1:
            near = zoom(near, ((2 * reach * upsampling + 1) / (2 * reach + 1)), order=3, mode="nearest")
        reach *= upsampling
        pitch = self.pitch_nm / upsampling
        period = scipy.fft.next_fast_len(2 * reach + 1)
        lag = np.abs(np.arange(-reach, reach + 1))
        is_complete = reach * pitch >= LAG_WIDTHS * width_nm
        edge = np.cos(0.5 * np.pi * lag / (reach + 1)) ** 2 if not is_complete else np.ones(len(lag))
        taper = (edge[:, None] * edge).astype(np.float32)
        variance = float(near[reach, reach])
        missing = (variance - near).astype(np.float32)
        highest = min((period - 1) // 2, int(np.ceil(highest_per_nm * period * pitch)))
        keep = np.arange(-highest, highest + 1) % period

        def power(kappa: float) -> tuple[float, RealArray]:
            square = (2.0 * np.pi * kappa) ** 2
            mirror = float(np.exp(-square * variance))
            retained = (np.exp(missing * np.float32(-square)) - np.float32(mirror)) * taper
            placed = np.zeros((period, period), np.float32)
            placed[: 2 * reach + 1, : 2 * reach + 1] = retained
            placed = np.roll(placed, (-reach, -reach), axis=(0, 1))
            spectrum = scipy.fft.fft2(placed)
            return mirror, np.ascontiguousarray(spectrum.real[np.ix_(keep, keep)]) / np.float32(period**2)

        area = self.heights_nm.size * self.pitch_nm**2
        noise = float(1.0 / np.sqrt(max(1.0, area / (4.0 * np.pi * width_nm**2))))
        return ScanLines(period * pitch, highest, power, 1, noise, upsampling, 32.0 * period**2)

    def validity(self, wavelength_scale: float = 1.0) -> Validity:
        """Return the validity range of a sinusoid with the same Sq and mean distance of crossings."""
        side = int(np.sqrt(MAX_POINTS))
        part = self.heights_nm[:side, :side]
        depth = 2.0 * np.sqrt(2.0) * self.sq_nm
        if depth < 1e-6 * self.pitch_nm:
            return Validity(0.0, float("inf"), 1.0, 0.0)
        feature_nm, axis = mean_feature_nm(part, self.pitch_nm)
        slopes = np.abs(np.diff(part, axis=axis)) / self.pitch_nm
        smoothness = min(1.0, SINUSOID * float(slopes.mean() / np.sqrt(np.mean(slopes**2))))
        slope, feature = depth / feature_nm, feature_nm * wavelength_scale / MIDDLE_NM
        return Validity(slope, feature, smoothness, expected_de00(slope, feature, smoothness=smoothness))

    @property
    def resolved_deg(self) -> float:
        """Largest angle from the normal at which light of 550 nm at normal incidence is resolved by the points."""
        return float(np.degrees(np.arcsin(min(1.0, MIDDLE_NM / (2.0 * self.pitch_nm)))))


def _corners(shape: tuple[int, ...], side: int, most: int) -> list[tuple[int, int]]:
    """Return corners of windows that overlap by half, thinned evenly to `most`."""
    counts = [max(1, int(np.ceil(2.0 * n / side)) - 1) for n in shape]
    places = [np.linspace(0, n - side, count).round().astype(int) for n, count in zip(shape, counts)]
    corners = [(int(x), int(y)) for x in places[0] for y in places[1]]
    chosen = np.linspace(0, len(corners) - 1, min(most, len(corners))).round().astype(int)
    return [corners[k] for k in chosen]


def _azimuthal_mean(near: Array) -> Array:
    """Return a covariance `[lag, lag]` about its middle that depends on the length of the lag only.

    Cubic splines give the mean over azimuths at radii half a point apart. The corners, which lack a whole circle,
    continue the largest one.
    """
    reach = near.shape[0] // 2
    lag = np.arange(-reach, reach + 1)
    radii = np.arange(0.0, reach - 1.0, 0.5) if reach > 4 else np.arange(reach + 1.0)
    coefficients = spline_filter(near, order=3)
    total = np.zeros(len(radii))
    for phi in (np.arange(AZIMUTHS) + 0.5) * (np.pi / AZIMUTHS):  # half a turn: the covariance is even
        places = np.stack([reach + radii * np.cos(phi), reach + radii * np.sin(phi)])
        total += map_coordinates(coefficients, places, order=3, prefilter=False)
    curve = CubicSpline(radii, total / AZIMUTHS, bc_type=((1, 0.0), "not-a-knot"))
    return np.asarray(curve(np.minimum(np.hypot(lag[:, None], lag), radii[-1])))


def suggested(heights_nm: Array) -> Statistics:
    """Return the statistics that a surface supports.

    Random if its heights are nearly normally distributed, nothing repeats in its autocovariance and it holds enough
    independent cells; isotropic if the correlation lengths along all azimuths agree.
    """
    side = int(np.sqrt(MAX_POINTS))
    part = heights_nm[:side, :side]
    part = part - part.mean()
    variance = float(np.mean(part**2))
    if not variance > 0:
        return "random"
    skewness = float(np.mean(part**3)) / variance**1.5
    excess = float(np.mean(part**4)) / variance**2 - 3.0
    if abs(skewness) > MOST_SKEWNESS or abs(excess) > MOST_EXCESS:
        return "scan"
    reach = (min(part.shape) - 1) // 2
    lags = np.arange(-reach, reach + 1)
    ratio = autocovariance(part)[lags[:, None], lags] / variance
    radius = np.hypot(lags[:, None], lags)
    lengths = _decay_lengths(ratio, reach)
    longest = float(lengths.max())
    far = (radius > 3.0 * longest) & (radius <= reach)
    cells = part.size / (np.pi * longest**2)
    if not np.isfinite(longest) or cells < LEAST_CELLS or not far.any():
        return "scan"
    if float(np.abs(ratio[far]).max()) > MOST_REPETITION:
        return "scan"
    return "isotropic" if float(lengths.min()) >= LEAST_ASPECT * longest else "random"


def _decay_lengths(ratio: Array, reach: int) -> Array:
    """Return the lags, in points, at which the autocorrelation falls to 1/e along 12 azimuths; infinite if never."""
    radii = np.arange(0.0, reach, 0.5)
    lags = []
    for phi in np.arange(12) * (np.pi / 12):
        places = np.stack([reach + radii * np.cos(phi), reach + radii * np.sin(phi)])
        below = np.flatnonzero(map_coordinates(ratio, places, order=1) < np.exp(-1.0))
        lags.append(radii[below[0]] if below.size else np.inf)
    return np.array(lags)
