"""Tilt and roughness of height maps: least-squares plane, Sq, Sdq and autocorrelation length (ISO 25178-2)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nacre.core.arrays import Array

MOST_HOLES = 0.1  # share of holes that is filled
DECAY = float(np.exp(-1.0))  # of the autocorrelation at the correlation length of a Gaussian or an exponential
MAX_POINTS = 1 << 22  # of the central part whose autocorrelation is computed
FILL_STEPS = 200


@dataclass(frozen=True)
class Roughness:
    """Roughness parameters of a height map (ISO 25178-2), relative to its least-squares plane.

    Attributes:
        tilt_deg: angle between the plane and the horizontal.
        mean_um: height of the plane at the centre of the map, an offset that depends on the stage.
        sq_um: root mean square height, Sq.
        sdq: root mean square gradient, Sdq, from neighbouring points.
        correlation_length_um: shortest lag at which the azimuthally averaged autocorrelation falls to 1/e; None if it
            stays above 1/e up to half the map.
        peak_to_valley_um: maximum height, Sz.
    """

    tilt_deg: float
    mean_um: float
    sq_um: float
    sdq: float
    correlation_length_um: float | None
    peak_to_valley_um: float

    def as_dict(self) -> dict[str, Any]:
        """Return the parameters by name."""
        return asdict(self)


def plane(heights: NDArray[Any]) -> tuple[float, float, float]:
    """Return mean, slope per row and slope per column of the least-squares plane; holes do not count."""
    rows, columns = heights.shape
    r = np.arange(rows) - 0.5 * (rows - 1)
    c = np.arange(columns) - 0.5 * (columns - 1)
    seen = np.isfinite(heights)
    if seen.all():
        mean = float(heights.mean())
        by_row = float(r @ heights.mean(axis=1) / max(r @ r, 1e-300))
        by_column = float(c @ heights.mean(axis=0) / max(c @ c, 1e-300))
        return mean, by_row, by_column
    row, column = np.nonzero(seen)
    matrix = np.stack([np.ones(len(row)), r[row], c[column]], axis=1)
    solved = np.linalg.lstsq(matrix, heights[seen], rcond=None)[0]
    return float(solved[0]), float(solved[1]), float(solved[2])


def without_plane(heights: NDArray[Any], fitted: tuple[float, float, float]) -> Array:
    """Return heights above a plane fitted by `plane`."""
    rows, columns = heights.shape
    r = np.arange(rows) - 0.5 * (rows - 1)
    c = np.arange(columns) - 0.5 * (columns - 1)
    mean, by_row, by_column = fitted
    return np.asarray(heights - (mean + by_row * r[:, None] + by_column * c[None, :]))


def filled(heights: NDArray[Any]) -> Array:
    """Return heights with holes filled: nearest neighbours, then the mean of neighbours repeatedly (Laplace)."""
    from scipy.ndimage import distance_transform_edt

    holes = ~np.isfinite(heights)
    if not holes.any():
        return np.asarray(heights, dtype=float)
    nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
    result = np.asarray(heights, dtype=float)[tuple(nearest)]
    row, column = np.nonzero(holes)
    last_row, last_column = heights.shape[0] - 1, heights.shape[1] - 1
    around = [
        (np.maximum(row - 1, 0), column), (np.minimum(row + 1, last_row), column),
        (row, np.maximum(column - 1, 0)), (row, np.minimum(column + 1, last_column)),
    ]  # fmt: skip
    for _ in range(FILL_STEPS):
        result[row, column] = sum(result[place] for place in around) / 4.0
    return result


def roughness(heights_um: NDArray[Any], pitch_um: tuple[float, float]) -> Roughness:
    """Return tilt and roughness of a map.

    Args:
        heights_um: `[row, column]`; holes are NaN.
        pitch_um: point distance along a row, and along a column.
    """
    fitted = plane(heights_um)
    flat = without_plane(heights_um, fitted)
    slope = np.hypot(fitted[1] / pitch_um[1], fitted[2] / pitch_um[0])
    square = [np.nanmean(np.diff(flat, axis=k) ** 2) / pitch_um[1 - k] ** 2 for k in (0, 1)]
    span = float(np.nanmax(flat) - np.nanmin(flat))
    return Roughness(
        float(np.degrees(np.arctan(slope))), fitted[0], float(np.sqrt(np.nanmean(flat**2))),
        float(np.sqrt(sum(square))), correlation_length_um(flat, pitch_um), span,
    )  # fmt: skip


def autocovariance(flat: Array) -> Array:
    """Return the unbiased mean of h(x) h(x + lag), `[lag row, lag column]`, lags from 0, negative ones at the end.

    Holes do not count.
    """
    shape = tuple(scipy.fft.next_fast_len(2 * n, real=True) for n in flat.shape)
    seen = np.isfinite(flat)
    spectrum = scipy.fft.rfft2(np.where(seen, flat, 0.0).astype(np.float32), shape)
    total = scipy.fft.irfft2((spectrum * spectrum.conj()).real, shape)
    if seen.all():
        counts = [np.maximum(n - np.abs(np.fft.fftfreq(m, 1.0 / m)), 1.0) for n, m in zip(flat.shape, shape)]
        return np.asarray(total / (counts[0][:, None] * counts[1]).astype(np.float32))
    spectrum = scipy.fft.rfft2(seen.astype(np.float32), shape)
    count = scipy.fft.irfft2((spectrum * spectrum.conj()).real, shape)
    return np.asarray(total / np.maximum(count, 1.0))


def correlation_length_um(flat: Array, pitch_um: tuple[float, float]) -> float | None:
    """Return the lag at which the azimuthally averaged autocorrelation falls to 1/e."""
    side = int(np.sqrt(MAX_POINTS))
    part = flat[: min(flat.shape[0], side), : min(flat.shape[1], side)]
    part = part - np.nanmean(part)
    if not np.nanmean(part**2) > 0:
        return None
    covariance = autocovariance(part)
    if not covariance[0, 0] > 0:  # below single precision
        return None
    half = part.shape[0] // 2, part.shape[1] // 2
    rows = np.abs(np.fft.fftfreq(covariance.shape[0], 1.0 / covariance.shape[0]))
    # columns from 0 are enough: the autocovariance is even
    kept = covariance[rows < max(half[0], 1)][:, : max(half[1], 1)]
    lag = np.hypot(rows[rows < max(half[0], 1)][:, None] * pitch_um[1], np.arange(kept.shape[1]) * pitch_um[0])
    step = min(pitch_um)
    ring = np.round(lag / step).astype(np.int64).ravel()
    count = np.bincount(ring)
    mean = np.bincount(ring, kept.ravel()) / np.maximum(count, 1)
    radius = np.bincount(ring, lag.ravel()) / np.maximum(count, 1)
    used = count > 0
    ratio, radius = (mean / covariance[0, 0])[used], radius[used]
    below = np.flatnonzero(ratio < DECAY)
    if not below.size or below[0] == 0:
        return None
    k = int(below[0])
    share = (ratio[k - 1] - DECAY) / (ratio[k - 1] - ratio[k])
    return float(radius[k - 1] + share * (radius[k] - radius[k - 1]))
