"""The effect of process errors on a finished design: Monte Carlo over height scale, blur and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.design.loss import GAMMA, measure
from nacre.design.problem import Array, Evaluator, Problem
from nacre.families.relief.surface import blur_matrix
from nacre.light import delta_e_2000, srgb_linear_to_xyz, xyz_to_lab

LIT_SHARE = 0.1  # colour differences count where the target is above this part of its maximum


@dataclass(frozen=True)
class Spread:
    """One quantity over the draws."""

    nominal: float
    mean: float
    percentile_95: float


@dataclass(frozen=True)
class Robustness:
    """Losses and colour differences over the draws.

    Attributes:
        loss_fixed, loss_free: against the target.
        delta_e: mean CIEDE2000, over the target's lit directions, from the design as drawn to the design as made,
            at the scale of the fixed loss; its nominal value is 0.
        draws: number of draws.
    """

    loss_fixed: Spread
    loss_free: Spread
    delta_e: Spread
    draws: int


def robustness(
    problem: Problem,
    heights_nm: Array,
    *,
    height_error: float = 0.03,
    blur_error: float = 0.1,
    noise: float = 0.05,
    draws: int = 100,
    seed: int = 1,
) -> Robustness:
    """Return losses and colour differences under errors of the process.

    Args:
        problem: what the design was made for.
        heights_nm: `[n, n]`.
        height_error: standard deviation of the factor on all heights.
        blur_error: standard deviation of the factor on the process blur.
        noise: standard deviation of the factor on each height by itself.
        draws: random processes.
        seed: of the draws.
    """
    generator = np.random.default_rng(seed)
    judge = Evaluator(problem, problem.search_upsamplings()[1], node_error=0.1)
    target = problem.target
    lit = target.max(axis=-1) > LIT_SHARE * target.max()
    nominal_rgb, _ = judge.rgb(judge.surface(heights_nm))
    nominal = measure(nominal_rgb, target, problem.intensity_scale)
    reference = _lab(nominal_rgb[lit], nominal.scale_fixed)
    rows = np.empty((draws, 3))
    for k in range(draws):
        scale = 1.0 + height_error * generator.standard_normal()
        widen = max(1.0 + blur_error * generator.standard_normal(), 0.1)
        made = heights_nm * scale * (1.0 + noise * generator.standard_normal(heights_nm.shape))
        blur = blur_matrix(problem.features, judge.upsampling, widen * problem.blur_nm / problem.feature_nm)
        rgb, _ = judge.rgb(judge.surface(made, blur.astype(np.float32)))
        losses = measure(rgb, target, problem.intensity_scale)
        difference = delta_e_2000(_lab(rgb[lit], nominal.scale_fixed), reference)
        rows[k] = losses.fixed, losses.free, float(np.mean(difference))
    means, tops = rows.mean(axis=0), np.percentile(rows, 95, axis=0)
    nominals = (nominal.fixed, nominal.free, 0.0)
    fixed, free, delta = (Spread(n, float(m), float(t)) for n, m, t in zip(nominals, means, tops))
    return Robustness(fixed, free, delta, draws)


def _lab(rgb: Array, scale: float) -> Array:
    """Return Lab of the colours as displayed: clipped to [0, 1] after the scale, as the loss's gamma sees them."""
    shown = np.clip(scale * np.asarray(rgb, dtype=float), 0.0, 1.0) ** (1.0 / GAMMA)
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(shown**GAMMA)))
