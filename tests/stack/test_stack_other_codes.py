"""Amplitudes and powers of stratified media against `tmm`, an independent code."""

from __future__ import annotations

import numpy as np
import pytest
import tmm

from nacre.matter import solve

AGAINST_TMM = 1e-11  # absolute; the bar of the film issue


def random_stack(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float, float]:
    """A stack of 0-7 layers, half of the media lossy, and a wavelength and angle for it."""
    layers = int(rng.integers(0, 8))
    n = rng.uniform(1.2, 4.0, layers + 2).astype(complex)
    lossy = rng.random(layers + 2) < 0.5
    lossy[0] = False  # the ambient must be transparent
    n += 1j * np.where(lossy, rng.uniform(0, 5, layers + 2), 0)
    if rng.random() < 0.7:
        n[0] = 1.0
    return n, rng.uniform(0, 500, layers), float(rng.uniform(360, 830)), float(rng.uniform(0, 1.55))


def worst_difference(count: int, seed: int) -> float:
    rng = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(count):
        n, d, lam, theta = random_stack(rng)
        ours = solve(n[:, None], d, [lam], theta)
        for pol in "sp":
            theirs = tmm.coh_tmm(pol, n, [np.inf, *d, np.inf], theta, lam)
            for key in "rtRT":
                worst = max(worst, abs(getattr(ours, f"{key}_{pol}")[0] - theirs[key]))
    return worst


def test_random_stacks_agree_with_tmm() -> None:
    assert worst_difference(300, seed=1) <= AGAINST_TMM


@pytest.mark.full
def test_three_thousand_random_stacks_agree_with_tmm() -> None:
    assert worst_difference(3000, seed=2) <= AGAINST_TMM
