"""The material of clear pillars: draws, reciprocity, energy, and powers between the nodes of its table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf.lobes.interface import AlignedSpecular
from nacre.bsdf.lobes.orders import OrdersLobe

WAVELENGTH_NM = 480.0
PILLARS = {
    "family": "grating", "substrate": {"n": 4.0, "k": 0.1}, "lattice": {"period_nm": [420, 380]},
    "orders": {"spread_deg": 1.0},
    "layers": [{
        "thickness_nm": 150, "material": "air",
        "shapes": [{"shape": "rectangle", "width_nm": 200, "length_nm": 170, "material": {"n": 2.4}}],
    }],
}  # fmt: skip
VIEWS = ((30.0, 40.0), (62.0, 200.0))
BAR = 4e-3  # of orders of two periods, at directions that are not beside an anomaly
LEVEL = 0.01  # of the chi-square tests, shared among them


@pytest.mark.full
@pytest.mark.render
def test_a_material_of_pillars_is_drawn_as_its_density_and_has_the_powers_of_its_orders(mi: Any) -> None:
    from lobe_trials import HERO_WAVELENGTHS_NM, chi_square, direction, draw, plugin_values, weight_mismatch

    bsdf = nacre.material(PILLARS).bsdf(np.array([WAVELENGTH_NM - 20.0, WAVELENGTH_NM]))
    mirror, others = bsdf.lobes
    assert isinstance(mirror, AlignedSpecular) and isinstance(others, OrdersLobe)
    for theta, phi in VIEWS:
        assert weight_mismatch(draw(bsdf, direction(theta, phi), 20_000, seed=3)) <= 2e-3
        outcome = chi_square(bsdf, theta, phi, samples=400_000, resolution=200, steps=24)
        assert outcome.passes(LEVEL, len(VIEWS)), outcome.messages
        light = direction(theta, phi)
        found = nacre.orders(PILLARS, theta, phi, [WAVELENGTH_NM])
        power = np.nan_to_num(found.reflected[0, 0].mean(axis=-1))
        back = mirror.specular_at(light[2], np.radians(phi)).reflectance
        efficiency = others.efficiencies(light)[:, -1]
        place = {(m, n): k for k, (m, n) in enumerate(others.orders.tolist())}
        for (m, n), expected in zip(found.numbers.tolist(), power.tolist(), strict=True):
            own = back[-1] if (m, n) == (0, 0) else efficiency[place[m, n]]
            assert own == pytest.approx(expected, abs=BAR)
            if (m, n) == (0, 0) or not expected:
                continue
            # the order's light, sent back
            out = found.reflected_direction[0, 0, found.numbers.tolist().index([m, n])]
            assert others.efficiencies(out)[place[m, n], -1] == pytest.approx(expected, abs=BAR)
            values = [
                plugin_values(bsdf, a[None], b[None], np.array(HERO_WAVELENGTHS_NM))
                for a, b in ((light, out), (out, light))
            ]
            assert values[0] == pytest.approx(values[1], rel=1e-3)
        assert np.all(back + others.hemispherical(light)[0] <= 1.0)
