"""A Gaussian over a picture, by products of small matrices.

Linear algebra of numpy is there anyway; scipy's filters take 0.1 s and more to import, as long as all that the
denoiser has to smooth in a small picture, and then up to twice as long. The numbers are the same to rounding.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array

Real = TypeVar("Real", np.float32, np.float64)

REACH = 3.0  # standard deviations
BLOCK = 32  # rows or columns that one product gives: of more, most factors would be zeros


def smooth(picture: NDArray[Real], sigma: float) -> NDArray[Real]:
    """Return a picture `[row, column]` or `[row, column, colour]` under a Gaussian of so many pixels, as precise as it.

    Beyond its edges the picture goes on as its last row or column.
    """
    if picture.ndim == 3:
        return np.stack([smooth(colour, sigma) for colour in np.moveaxis(picture, -1, 0)], axis=-1)
    spread = _spread(sigma).astype(picture.dtype, copy=False)
    reach = (spread.shape[1] - BLOCK) // 2
    padded = np.pad(picture, ((reach, reach), (0, 0)), mode="edge")
    along = np.empty_like(picture)
    for start in range(0, len(picture), BLOCK):
        count = min(BLOCK, len(picture) - start)
        seen = padded[start : start + count + 2 * reach]
        np.matmul(spread[:count, : len(seen)], seen, out=along[start : start + count])
    padded = np.pad(along, ((0, 0), (reach, reach)), mode="edge")
    columns = picture.shape[1]
    for start in range(0, columns, BLOCK):
        count = min(BLOCK, columns - start)
        seen = padded[:, start : start + count + 2 * reach]
        np.matmul(seen, spread[:count, : seen.shape[1]].T, out=along[:, start : start + count])
    return along


@functools.lru_cache(maxsize=32)
def _spread(sigma: float) -> NDArray[np.float64]:
    """Return the weights `[block, block + twice the reach]` of what a block sees."""
    reach = int(REACH * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    spread = np.zeros((BLOCK, BLOCK + 2 * reach))
    for row in range(BLOCK):
        spread[row, row : row + len(weights)] = weights / weights.sum()
    return spread


# Noise that repeats without a seam: for what is drawn on grounds, on paper, in the sky.


def noise(shape: tuple[int, int], grain: Sequence[float], seed: int) -> Array:
    """Smooth noise `[row, column]` of mean 0 and variance 1 that repeats without a seam.

    Args:
        grain: standard deviation of the Gaussian that smooths it, along rows and columns, in pixels.
    """
    white = np.random.default_rng(seed).standard_normal(shape)
    frequency = [np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]]
    keep = np.exp(-2 * np.pi**2 * sum((f * g) ** 2 for f, g in zip(frequency, grain, strict=True)))
    smooth = np.fft.irfft2(np.fft.rfft2(white) * keep, s=shape)
    smooth -= smooth.mean()
    return np.asarray(smooth / smooth.std())
