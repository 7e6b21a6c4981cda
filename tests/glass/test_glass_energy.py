"""Random photonic glasses: no spectrum sends out more than arrives, and none loses light that nothing absorbs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre

LAM = np.linspace(380.0, 780.0, 9)
ANGLES = np.radians([0.0, 45.0, 80.0, 90.0])
EXCESS = 1e-3  # what spectra keep to


def random_glass(g: np.random.Generator, is_lossless: bool) -> dict[str, Any]:
    """Any glass that a recipe may describe, between smooth faces."""
    radius = float(g.choice([g.uniform(5, 60), g.uniform(60, 200), g.uniform(200, 450)]))
    data: dict[str, Any] = {
        "family": "glass",
        "thickness_um": float(10 ** g.uniform(0.5, 3)) + 0.0062 * radius,
        "matrix": {"n": float(g.uniform(1.0, 1.8))},
        "spheres": {
            "material": {"n": float(g.uniform(1.0, 2.6))},
            "radius_nm": radius,
            "volume_fraction": float(g.choice([1e-4, g.uniform(0.05, 0.64)])),
        },
    }
    if g.random() < 0.4:
        data["spheres"]["deviation_nm"] = float(g.uniform(0, 0.2)) * radius
    if g.random() < 0.3:
        data["spheres"]["shell"] = {
            "material": {"n": float(g.uniform(1.0, 2.4))},
            "thickness_nm": float(g.uniform(1, 40)),
        }
    if not is_lossless:
        data["absorber"] = {"k": float(10 ** g.uniform(-5, -1.3))}
        data["base"] = {"albedo": float(g.uniform(0, 1))} if g.random() < 0.6 else {"none": True}
    else:
        data["base"] = {"albedo": 1.0} if g.random() < 0.5 else {"none": True}
    return data


@pytest.mark.parametrize(
    "seed", [seed if seed < 6 else pytest.param(seed, marks=pytest.mark.full) for seed in range(24)]
)
def test_random_glasses_send_out_no_more_than_arrives(seed: int) -> None:
    is_lossless = seed % 2 == 0
    data = random_glass(np.random.default_rng(seed), is_lossless)
    parts = nacre.material(data).spectrum(ANGLES, LAM).parts()
    for name, part in parts.items():
        assert np.all(np.isfinite(part)) and part.min() >= -1e-9, (name, data)
    total = np.sum(list(parts.values()), axis=0)
    assert total.max() <= 1 + EXCESS, data
    if is_lossless:
        assert total.min() >= 1 - EXCESS, data
