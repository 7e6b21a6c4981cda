"""Noise that repeats without a seam: for what is drawn on grounds, on paper, in the sky."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nacre.arrays import Array


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
