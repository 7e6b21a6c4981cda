"""Sloping and rounded walls by slices, against a profile that is solved without them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.matter.periodic.slices import Wall, inset, sliced
from nacre.matter.periodic.structure import Rectangle, Region


@pytest.mark.parametrize("n", [1.5, 2.5])
def test_a_sloping_line_is_a_trapezoid(n: float) -> None:
    medium, flank = {"n": n}, 300 / np.tan(np.radians(70))
    line = {"shape": "line", "material": medium, "width_nm": 300, "sidewall_deg": 70}
    made: dict[str, Any] = {"family": "grating", "substrate": medium, "lattice": {"period_nm": 800}}
    steps = made | {"layers": [{"thickness_nm": 300, "material": "air", "shapes": [line]}]}
    profile = {"shape": "trapezoid", "depth_nm": 300, "top": (300 - flank) / 800, "bottom": (500 - flank) / 800}
    found, exact = (nacre.orders(r, 21.0, 30.0, [600.0]) for r in (steps, made | {"profile": profile}))
    error = float(found.error.max())
    assert 0.0 < error <= 2e-3
    for side in ("reflected", "transmitted"):
        assert getattr(found, side) == pytest.approx(getattr(exact, side), abs=error + 5e-5, nan_ok=True)


def test_slices_have_the_volume_of_the_wall() -> None:
    line = Rectangle(-100.0, 100.0)
    slope = sliced(120.0, 1.0, [(line, 4.0, Wall(75.0))], 12)
    widths = [box.x_1 - box.x_0 for layer in slope for box, _ in layer.shapes if isinstance(box, Rectangle)]
    assert np.all(np.diff(widths) > 0) and np.mean(widths) == pytest.approx(200.0)
    assert widths[-1] - widths[0] == pytest.approx(2 * 110 / np.tan(np.radians(75.0)))
    # a quarter of a circle on each side leaves (1 - pi / 4) r^2 out
    edge = sliced(120.0, 1.0, [(line, 4.0, Wall(rounding_nm=40.0))], 200)
    area = sum(
        layer.thickness_nm * (box.x_1 - box.x_0) for layer in edge for box, _ in layer.shapes
        if isinstance(box, Rectangle)
    )  # fmt: skip
    assert area == pytest.approx(200 * 120 - 2 * (1 - np.pi / 4) * 40**2, rel=1e-4)


def test_an_inset_moves_the_wall() -> None:
    disc = Region(lambda x, y: np.hypot(x, y) - 70.0, ("disc", 0.0, 0.0, 70.0))
    smaller = inset(disc, 10.0)
    assert isinstance(smaller, Region) and smaller.distance(np.array([60.0]), np.array([0.0])) == pytest.approx(0.0)
    assert inset(Rectangle(-5.0, 5.0), 6.0) is None


@pytest.mark.full
@pytest.mark.parametrize("changes", [{"sidewall_deg": 80.0}, {"rounding_nm": 40.0}])
def test_sloping_pillars_keep_energy(changes: dict[str, float]) -> None:
    shape = {"shape": "rectangle", "material": {"n": 2.2}, "width_nm": 180, "corner_radius_nm": 20} | changes
    made = {"family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 420}, "model": {"tolerance": 0.05},
            "layers": [{"thickness_nm": 120, "material": "air", "shapes": [shape]}]}  # fmt: skip
    found = nacre.orders(made, 0.0, 0.0, [550.0])
    total = np.nansum(found.reflected, axis=2) + np.nansum(found.transmitted, axis=2)
    assert total == pytest.approx(np.ones((1, 1, 2)), abs=1e-8)


def test_slices_of_a_wall_round_all_over_fill_its_height_closest_at_the_top() -> None:
    from nacre.matter.periodic.slices import _edges

    depths = _edges(100.0, 100.0, 4)
    np.testing.assert_allclose(depths, 100.0 * (1.0 - np.cos(np.linspace(0.0, 0.5 * np.pi, 5))), atol=1e-12)
    assert depths[-1] == pytest.approx(100.0) and np.all(np.diff(depths, 2) > 0.0)
