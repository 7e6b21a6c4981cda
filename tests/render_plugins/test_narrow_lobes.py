"""Draws follow the density also where lobes are narrow or light grazes, by a chi-square test that adapts to them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from adaptive_chi_square import adaptive_chi_square

LEVEL = 0.01
DOUBT = 0.5  # of a count's standard deviation, at most, in any cell


class Fisher:
    """Directions about a mean: density exp(kappa (cos - 1)), drawn in closed form (Fisher 1953)."""

    def __init__(self, kappa: float, tilt_deg: float) -> None:
        self.kappa = kappa
        t = np.radians(tilt_deg)
        self.mean = np.array([np.sin(t), 0.0, np.cos(t)])
        self.across = np.array([np.cos(t), 0.0, -np.sin(t)])

    def sample(self, count: int, seed: int) -> Any:
        u, v = np.random.default_rng(seed).random((2, count))
        # 1 - cos, kept apart from 1 so that a narrow lobe keeps its digits
        drop = -np.log1p(-u * -np.expm1(-2 * self.kappa)) / self.kappa
        s, phi = np.sqrt(drop * (2.0 - drop)), 2 * np.pi * v
        side = np.array([0.0, 1.0, 0.0])
        wo = (1 - drop)[:, None] * self.mean + (s * np.cos(phi))[:, None] * self.across
        wo = wo + (s * np.sin(phi))[:, None] * side
        return wo, np.ones(count, dtype=bool)

    def density(self, wo: Any) -> Any:
        drop = 0.5 * np.sum((wo - self.mean) ** 2, axis=1)
        return self.kappa / (2 * np.pi * -np.expm1(-2 * self.kappa)) * np.exp(-self.kappa * drop)


@pytest.mark.parametrize("kappa", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("tilt_deg", [0.0, 60.0, 88.0])
def test_a_lobe_from_broad_to_a_twentieth_of_a_degree_agrees_with_its_own_draws(kappa: float, tilt_deg: float) -> None:
    lobe = Fisher(kappa, tilt_deg)
    outcome = adaptive_chi_square(lobe.sample, lobe.density, samples=100_000, cells=200)
    assert outcome.passes(LEVEL, 9) and outcome.doubt < DOUBT, outcome


@pytest.mark.parametrize("kappa", [10.0, 1e5])
def test_five_per_cent_of_error_falls(kappa: float) -> None:
    lobe, other = Fisher(kappa, 40.0), Fisher(1.05 * kappa, 40.0)

    def astray(count: int, seed: int) -> Any:
        wo, meant = lobe.sample(count, seed)
        every = np.arange(count) % 20 == 0
        wo[every] = Fisher(kappa / 4, 40.0).sample(int(every.sum()), seed + 7)[0]
        return wo, meant

    wrong = {
        "narrower density": (lobe.sample, other.density),
        "narrower draws": (other.sample, lobe.density),
        "brighter density": (lobe.sample, lambda wo: 1.05 * lobe.density(wo)),
        "darker density": (lobe.sample, lambda wo: 0.95 * lobe.density(wo)),
        "draws gone astray": (astray, lobe.density),
    }
    for name, (sample, density) in wrong.items():
        assert not adaptive_chi_square(sample, density, samples=100_000, cells=200).passes(1e-6), name
