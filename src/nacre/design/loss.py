"""The published loss, at a given intensity scale and at the best one, with gradients.

pred = max(scale rgb, 0)^(1/2.2) against the display-referred target; the loss is the mean square over pixels and
channels (physics/relief.md, sections 7 and 11.8).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
GAMMA = 2.2
# x^(1/2.2) has an infinite slope at 0; this offset keeps the gradient finite and moves the loss by < 1e-4
GRADIENT_FLOOR = 1e-6
# weight of the fixed loss in the search; a sum, not a product of both: a free loss driven to nearly nothing would
# outweigh any fixed one in a product, with a design far too dark or bright at the asked scale
FIXED_SHARE = 0.7


@dataclass(frozen=True)
class Losses:
    """Both losses of a slice, with the scale of each, and that of an all-black slice.

    `black` tells whether the fixed loss means anything: where `black` is lower, a dark design is rewarded.
    """

    fixed: float
    free: float
    scale_fixed: float
    scale_free: float
    black: float


def measure(rgb: Array, target: Array, intensity_scale: float | None) -> Losses:
    """Return the exact losses (no floor) of linear `rgb` against `target`, both `[..., 3]`.

    Without an intensity scale the fixed loss is the free one.
    """
    target = np.asarray(target, dtype=float)
    response = np.maximum(np.asarray(rgb, dtype=float), 0.0) ** (1.0 / GAMMA)
    energy = float((response * response).sum())
    best = float((response * target).sum()) / energy if energy > 0 else 0.0
    free = float(np.mean((best * response - target) ** 2))
    scale_free = best**GAMMA
    scale = scale_free if intensity_scale is None else intensity_scale
    fixed = float(np.mean((scale ** (1.0 / GAMMA) * response - target) ** 2))
    return Losses(fixed, free, scale, scale_free, float(np.mean(target**2)))


def objective(
    rgb: Array, target: Array, intensity_scale: float | None, brightness_floor: float = 0.0
) -> tuple[float, Array]:
    """Return what the search minimises, and its gradient with respect to `rgb`.

    With a fixed scale: the logarithm of a weighted mean of the fixed and the free loss. With a free scale: the
    logarithm of the free loss, plus a penalty once the brightness (1 / scale) falls under `brightness_floor`, since a
    free scale alone would allow a dark design.
    """
    reference = intensity_scale if intensity_scale is not None else max(_rough_scale(rgb, target), 1e-30)
    floor = rgb.dtype.type(GRADIENT_FLOOR / reference)
    positive = np.maximum(rgb, 0.0)
    response = (positive + floor) ** rgb.dtype.type(1.0 / GAMMA)
    slope = np.where(rgb > 0, response / (GAMMA * (positive + floor)), 0.0)
    count = target.size
    energy = float(np.vdot(response, response))
    best = float(np.vdot(response, target)) / energy
    residual = best * response - target
    free = float(np.vdot(residual, residual)) / count
    if intensity_scale is not None:
        gain = intensity_scale ** (1.0 / GAMMA)
        off = gain * response - target
        total = FIXED_SHARE * float(np.vdot(off, off)) / count + (1.0 - FIXED_SHARE) * free
        value = float(np.log(total))
        # the best scale is stationary, so only the direct term remains in the gradient
        gradient = (2.0 / count / total) * ((1.0 - FIXED_SHARE) * best * residual + FIXED_SHARE * gain * off)
        return value, (gradient * slope).astype(rgb.dtype, copy=False)
    value = float(np.log(free))
    gradient = (2.0 * best / count / free) * residual
    if brightness_floor > 0:
        excess = GAMMA * np.log(best) + np.log(brightness_floor)
        if excess > 0:
            value += float(excess**2)
            log_best_gradient = (target - 2.0 * best * response) / energy / best
            gradient = gradient + (2.0 * excess * GAMMA) * log_best_gradient
    return value, (gradient * slope).astype(rgb.dtype, copy=False)


def _rough_scale(rgb: Array, target: Array) -> float:
    response = np.maximum(rgb, 0.0) ** (1.0 / GAMMA)
    energy = float(np.vdot(response, response))
    return (float(np.vdot(response, target)) / energy) ** GAMMA if energy > 0 else 1.0
