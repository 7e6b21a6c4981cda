"""Sloping and rounded walls by slices, against a profile that is solved without them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.machine import single_threaded_blas
from nacre.matter.periodic import line_elements
from nacre.matter.periodic import solve as solve_module
from nacre.matter.periodic.lamellar_solver import solve_lamellar
from nacre.matter.periodic.line_elements import solve_elements
from nacre.matter.periodic.line_solver import solve_profile
from nacre.matter.periodic.solve import TOLERANCE, _finest, difference, solve, total
from nacre.matter.periodic.structure import (
    Cell,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Rectangle,
    Region,
    Wall,
    inset,
    sliced,
)


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


@pytest.mark.parametrize(("wavelength_nm", "angle_deg", "azimuth_deg"), [(569.0, 19.0, 76.0), (497.0, 48.0, 0.0)])
def test_a_sloping_metal_line_is_a_trapezoid(wavelength_nm: float, angle_deg: float, azimuth_deg: float) -> None:
    flank = 400 / np.tan(np.radians(78))
    line = {"shape": "line", "material": "Al", "width_nm": 320, "sidewall_deg": 78}
    made: dict[str, Any] = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 700}}
    steps = made | {"layers": [{"thickness_nm": 400, "material": "air", "shapes": [line]}]}
    profile = {"shape": "trapezoid", "depth_nm": 400, "top": (320 - flank) / 700, "bottom": (380 - flank) / 700}
    case = angle_deg, azimuth_deg, [wavelength_nm]
    found, exact = (nacre.orders(r, *case) for r in (steps, made | {"profile": profile}))
    error = float(found.error.max())
    assert 0.0 < error <= 1.5e-3
    assert found.reflected == pytest.approx(exact.reflected, abs=error + float(exact.error.max()), nan_ok=True)


def test_elements_continue_walls_through_layers() -> None:
    """Walls that lie elsewhere in each layer, with films, against slices whose number extrapolates to the walls."""
    box, other = Rectangle(-150.0, 90.0), Rectangle(-60.0, 170.0)
    tilted = (
        (PatternLayer(40.0, 2.1), ()), (PatternLayer(180.0, 1.0, ((box, 4.0),)), (20.0,)),
        (PatternLayer(120.0, 1.4, ((other, 3.0),)), (12.0,)), (PatternLayer(70.0, 2.9), ()),
    )  # fmt: skip

    def stack(count: int) -> PeriodicStack:
        layers: list[PatternLayer] = []
        for layer, insets in tilted:
            slope = np.degrees(np.arctan2(0.5 * layer.thickness_nm, insets[0] if insets else 0.0))
            shapes = [(shape, epsilon, Wall(slope)) for shape, epsilon in layer.shapes]
            layers += sliced(layer.thickness_nm, layer.epsilon, shapes, count)
        return PeriodicStack(Cell(620.0), 1.0, tuple(layers), 1.5 + 0j, None, None, tilted)

    case = 2.0 * np.pi / 560.0, 0.4, 0.7
    with single_threaded_blas():
        found = solve_elements(stack(1), *case, 1)
        coarse, fine = (solve_lamellar([(stack(n), *case)])[0] for n in (6, 12))
    assert total(found) == pytest.approx(np.ones(2), abs=1e-10)
    for side in ("reflected", "transmitted"):
        a, b = getattr(coarse, side).jones, getattr(fine, side).jones
        assert getattr(found, side).jones == pytest.approx(2.0 * b - a, abs=2e-3)


def test_walls_that_meet_are_solved_by_slices() -> None:
    line = {"shape": "line", "material": {"n": 1.5}, "width_nm": 200, "sidewall_deg": 43}
    made = {"family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 600}, "model": {"tolerance": 0.02}}
    found = nacre.orders(
        made | {"layers": [{"thickness_nm": 200, "material": "air", "shapes": [line]}]}, 0.0, 0.0, [700.0]
    )  # fmt: skip
    assert 0.0 < float(found.error.max()) <= 0.02


def test_walls_of_too_many_elements_are_solved_by_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_elements, "MAX_ELEMENTS", 10)
    line = {"shape": "line", "material": {"n": 1.5}, "width_nm": 200, "sidewall_deg": 80}
    layer = {"thickness_nm": 100, "material": "air", "shapes": [line]}
    made = {"family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 600}, "layers": [layer]}
    stack = nacre.load(made).model.stacks(np.array([700.0]))[0]
    found = solve(stack, 700.0, 0.0, 0.0, 0.02)
    assert found.method == "lines" and 0.0 < found.error <= 0.02


@pytest.mark.full
def test_solvers_that_disagree_at_a_sharp_corner_state_their_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    made = {"family": "grating", "substrate": "Ag", "lattice": {"period_nm": 401},
            "profile": {"shape": "triangle", "depth_nm": 354, "apex": 0.07}}  # fmt: skip
    stack = nacre.load(made).model.stacks(np.array([502.0]))[0]
    case = 502.0, float(np.radians(20.0)), 0.0

    def both() -> list[OrderSolution]:
        return [_finest(method, stack, case, TOLERANCE["profile"]) for method in ("profile", "elements")]

    with single_threaded_blas():
        singular = both()
        monkeypatch.setattr(solve_module, "singular_exponent", lambda _: None)  # estimates of smooth fields
        monkeypatch.setattr(solve_module, "_is_steep", lambda _: False)
        smooth, found = both(), solve(stack, *case, is_strict=False)
    assert difference(*singular) <= sum(each.error for each in singular)
    apart = difference(*smooth)
    assert apart > sum(each.error for each in smooth)
    assert found.error == pytest.approx(apart)


@pytest.mark.full
def test_a_small_error_at_a_sharp_metal_corner_is_checked() -> None:
    made = {"family": "grating", "substrate": "Au", "lattice": {"period_nm": 380},
            "profile": {"shape": "triangle", "depth_nm": 280, "apex": 0.95}}  # fmt: skip
    stack = nacre.load(made).model.stacks(np.array([560.0]))[0]
    case = 560.0, 0.5, 0.6
    with single_threaded_blas():
        found = solve(stack, *case, is_strict=False)
        other = _finest("elements", stack, case, 1e-9, 3)
    assert difference(found, other) <= found.error + other.error


@pytest.mark.parametrize("phi_deg", [0.0, 35.0])
def test_elements_agree_with_coordinates_on_a_profile(phi_deg: float) -> None:
    made = {"family": "grating", "substrate": "Ag", "lattice": {"period_nm": 900},
            "profile": {"shape": "sinusoidal", "depth_nm": 600}}  # fmt: skip
    stack = nacre.load(made).model.stacks(np.array([520.0]))[0]
    case = 2.0 * np.pi / 520.0, 0.6, float(np.radians(phi_deg))
    with single_threaded_blas():
        found, exact = solve_elements(stack, *case, 2), solve_profile(stack, *case, 3)
    assert found.reflected.jones == pytest.approx(exact.reflected.jones, abs=1e-4)


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
    from nacre.matter.periodic.structure import _edges

    depths = _edges(100.0, 100.0, 4)
    np.testing.assert_allclose(depths, 100.0 * (1.0 - np.cos(np.linspace(0.0, 0.5 * np.pi, 5))), atol=1e-12)
    assert depths[-1] == pytest.approx(100.0) and np.all(np.diff(depths, 2) > 0.0)
