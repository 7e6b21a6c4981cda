"""Elements with curved sides: conservation, known limits, and Fourier series at a size that converges."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.machine import single_threaded_blas
from nacre.matter.periodic import element_solver
from nacre.matter.periodic.crossed_solver import solve_fourier
from nacre.matter.periodic.element_mesh import Oval, edge_count
from nacre.matter.periodic.element_solver import ELEMENT_STEPS, SEVERAL_WALLS, solve_ovals
from nacre.matter.periodic.lamellar_solver import flat_orders
from nacre.matter.periodic.solve import difference, method_of, solve_coarse
from nacre.matter.periodic.structure import (
    MAX_UNKNOWNS,
    Cell,
    NotConvergedError,
    OrderSet,
    PatternLayer,
    PeriodicStack,
    Region,
    Shape,
    incident_wave,
)

SMALL = (3, 3, (0.15,))
K0 = 2.0 * np.pi / 550.0
SQUARE, HEXAGONAL = Cell(300.0, 300.0), Cell(300.0, 300.0, np.pi / 3.0)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Solve as the product does: matrices are too small for several threads."""
    with single_threaded_blas():
        yield


def disc(radius: float, x: float = 0.0, y: float = 0.0) -> Region:
    return Region(lambda a, b: np.hypot(a - x, b - y) - radius, ("disc", x, y, radius))


def on_glass(cell: Cell, shapes: list[tuple[Shape, complex]], ground: complex = 1.0) -> PeriodicStack:
    films = (PatternLayer(20.0, 2.1), PatternLayer(40.0, ground, tuple(shapes)), PatternLayer(60.0, 4.0))
    return PeriodicStack(cell, 1.0, films, 1.5)


def energy(side: OrderSet, other: OrderSet) -> Any:
    return side.efficiency.sum(axis=0) + other.efficiency.sum(axis=0)


@pytest.mark.parametrize("radius", [70.0, 135.0])  # the larger one needs a hexagonal mesh
@pytest.mark.parametrize("cell", [SQUARE, HEXAGONAL, Cell(330.0, 290.0, 1.4)])
def test_metal_without_loss_conserves_energy(cell: Cell, radius: float) -> None:
    stack = on_glass(cell, [(disc(radius), -12.0)])
    assert method_of(stack) == "ovals"
    found = solve_ovals(stack, K0, 0.5, 0.7, SMALL)
    np.testing.assert_allclose(energy(found.reflected, found.transmitted), 1.0, rtol=0.0, atol=1e-8)


def test_thin_rims_conserve_energy_to_rounding() -> None:
    pillar = PatternLayer(200.0, 1.0, ((disc(82.5), 4.75**2 + 0j),))
    found = solve_ovals(PeriodicStack(HEXAGONAL, 1.0, (pillar,), 1.5), 2.0 * np.pi / 444.0, 0.0, 0.0, ELEMENT_STEPS[0])
    # 426 unknowns; matrices up to 1e7 with their rounding of 2e-16 would leave 1e-10 to 1e-8
    np.testing.assert_allclose(energy(found.reflected, found.transmitted), 1.0, rtol=0.0, atol=1e-12)


def test_reciprocity_of_orders() -> None:
    stack = on_glass(Cell(700.0, 650.0), [(disc(120.0, 30.0, 10.0), (0.1 + 3.4j) ** 2)])
    one = solve_ovals(stack, K0, 0.4, 0.3, SMALL).reflected
    at = int(np.flatnonzero((one.numbers == [-1, 0]).all(axis=1))[0])
    back = -one.direction[at]
    other = solve_ovals(stack, K0, np.arccos(-back[2]), np.arctan2(back[1], back[0]), SMALL).reflected
    to = int(np.flatnonzero((other.numbers == [-1, 0]).all(axis=1))[0])
    assert one.efficiency[at].sum() > 1e-3
    assert other.efficiency[to].sum() == pytest.approx(one.efficiency[at].sum(), rel=1e-7)


@pytest.mark.parametrize(
    ("cell", "theta", "phi", "classes"),
    [
        (Cell(500.0, 500.0), 0.0, 0.0, 4),
        (Cell(500.0, 500.0), 0.4, 0.25 * np.pi, 2),
        (Cell(500.0, 500.0, np.pi / 3.0), 0.0, 0.0, 4),
        (Cell(500.0, 450.0, 1.4), 0.0, 0.0, 1),
    ],
)
def test_classes_of_symmetry_have_the_orders_of_the_whole(
    monkeypatch: pytest.MonkeyPatch, cell: Cell, theta: float, phi: float, classes: int
) -> None:
    stack = on_glass(cell, [(disc(120.0, 30.0, 10.0), (0.05 + 3.5j) ** 2)])
    size = (3, 2, (0.15,))
    assert len(element_solver._bases(stack, K0, incident_wave(stack, theta, phi)[0], size)) == classes
    found = solve_ovals(stack, K0, theta, phi, size)
    monkeypatch.setattr(element_solver, "_mirror_axes", lambda *_: ())
    whole = solve_ovals(stack, K0, theta, phi, size)
    for one, other in ((found.reflected, whole.reflected), (found.transmitted, whole.transmitted)):
        np.testing.assert_allclose(one.jones, other.jones, rtol=0.0, atol=1e-9)


def test_equal_materials_are_a_film() -> None:
    patterned, film = on_glass(SQUARE, [(disc(80.0), 2.25 + 1e-9)], 2.25), on_glass(SQUARE, [], 2.25)
    found = solve_ovals(patterned, K0, 0.5, 0.7, SMALL)
    assert difference(found, flat_orders(film, K0, 0.5, 0.7)) < 2e-3  # the elements' own error, degree 3
    finer = solve_ovals(patterned, K0, 0.5, 0.7, (5, 5, (0.15,)))
    assert difference(finer, flat_orders(film, K0, 0.5, 0.7)) < 1e-5


def test_a_place_turns_the_phases_of_orders_only() -> None:
    cell, silver = Cell(700.0, 700.0), (0.05 + 3.5j) ** 2
    one, other = (
        solve_ovals(on_glass(cell, [(disc(120.0, *at), silver)]), K0, 0.4, 0.3, SMALL).reflected
        for at in ((0.0, 0.0), (150.0, -60.0))
    )
    phase = np.exp(-1j * (cell.wave_vectors(one.numbers) @ np.array([150.0, -60.0])))
    assert len(one.numbers) > 3
    np.testing.assert_allclose(other.jones, one.jones * phase[:, None, None], rtol=0.0, atol=1e-7)


def test_a_turned_ellipse_exchanges_x_and_y() -> None:
    silver = (0.05 + 3.5j) ** 2
    one, other = (
        solve_ovals(
            on_glass(SQUARE, [(Region(_ellipse(*axes), ("ellipse", 0.0, 0.0, *axes, 0.0)), silver)]),
            K0,
            0.0,
            0.0,
            SMALL,
        )
        for axes in ((200.0, 120.0), (120.0, 200.0))
    )
    np.testing.assert_allclose(one.reflected.efficiency, other.reflected.efficiency[:, ::-1], rtol=0.0, atol=1e-8)
    assert abs(one.reflected.efficiency[0, 0] - one.reflected.efficiency[0, 1]) > 0.01


def _ellipse(width: float, height: float) -> Any:
    return lambda x, y: np.hypot(2.0 * x / width, 2.0 * y / height) - 1.0


def test_a_ring_with_a_filled_hole_is_a_disc() -> None:
    silver = (0.05 + 3.5j) ** 2
    ring = Region(lambda x, y: np.abs(np.hypot(x, y) - 70.0) - 30.0, ("ring", 0.0, 0.0, 100.0, 40.0))
    filled = on_glass(SQUARE, [(ring, silver), (disc(40.0), silver)])
    found, expected = (
        solve_ovals(stack, K0, 0.2, 0.1, SMALL) for stack in (filled, on_glass(SQUARE, [(disc(100.0), silver)]))
    )
    assert difference(found, expected) < 5e-3
    empty = solve_ovals(on_glass(SQUARE, [(ring, silver)]), K0, 0.2, 0.1, SMALL)
    assert difference(empty, expected) > 0.1


@pytest.mark.parametrize(
    "shapes",
    [
        [disc(70.0, -75.0), disc(60.0, 75.0)],  # two centres
        [disc(149.9)],  # touches its neighbours
        [Region(lambda x, y: np.abs(x) + np.abs(y) - 80.0, ("polygon", "corners"))],
    ],
)
def test_other_shapes_of_metal_take_fourier_series(shapes: list[Region]) -> None:
    assert method_of(on_glass(SQUARE, [(shape, -9.0 + 1.0j) for shape in shapes])) == "fourier"
    assert method_of(on_glass(SQUARE, [(disc(70.0), 12.0)])) == "fourier"  # a clear disc


def test_a_coarse_solution_of_a_lossy_metal_disc() -> None:
    # Fourier series of radius 17, 20 and 23 give R 0.1853, 0.1853, 0.1858 and T 0.4505, 0.4509, 0.4505
    metal = (3.1 + 3.3j) ** 2
    stack = PeriodicStack(SQUARE, 1.0, (PatternLayer(50.0, 1.0, ((disc(80.0), metal),)),), 1.5)
    found = solve_coarse(stack, 550.0, 0.0, 0.0)
    assert found.method == "ovals"
    np.testing.assert_allclose(found.reflected.efficiency, 0.1855, rtol=0.0, atol=2e-3)
    np.testing.assert_allclose(found.transmitted.efficiency, 0.4507, rtol=0.0, atol=4e-3)


@pytest.mark.full
def test_a_lossy_metal_disc_agrees_with_fourier_series() -> None:
    metal = {"n": 3.1, "k": 3.3}
    layer = {"thickness_nm": 50, "material": "air",
             "shapes": [{"shape": "disc", "material": metal, "diameter_nm": 160}]}  # fmt: skip
    made = {"family": "grating", "substrate": {"n": 1.5}, "layers": [layer], "lattice": {"period_nm": 300}}
    found = nacre.orders(made, 0.0, 0.0, [550.0])
    assert float(found.error.max()) <= 4e-3
    stack = PeriodicStack(SQUARE, 1.0, (PatternLayer(50.0, 1.0, ((disc(80.0), (3.1 + 3.3j) ** 2),)),), 1.5)
    series = solve_fourier(stack, K0, 0.0, 0.0, 17)
    assert abs(found.reflected[0, 0, 0] - series.reflected.efficiency[0]).max() < float(found.error.max()) + 1e-3
    assert abs(found.transmitted[0, 0, 0] - series.transmitted.efficiency[0]).max() < float(found.error.max()) + 1e-3


def test_each_size_is_allowed_but_the_largest_of_two_walls_without_symmetry() -> None:
    walls = (Oval(0.0, 0.0, 40.0, 40.0), Oval(0.0, 0.0, 100.0, 100.0))
    assert len(SEVERAL_WALLS) == len(ELEMENT_STEPS)
    assert all(edge_count(SQUARE, walls, size) <= MAX_UNKNOWNS for size in SEVERAL_WALLS[:-1])
    assert MAX_UNKNOWNS < edge_count(SQUARE, walls, SEVERAL_WALLS[-1]) <= 2 * MAX_UNKNOWNS
    ring = Region(lambda x, y: np.abs(np.hypot(x, y) - 70.0) - 30.0, ("ring", 0.0, 0.0, 100.0, 40.0))
    with pytest.raises(NotConvergedError):
        solve_ovals(on_glass(SQUARE, [(ring, -12.0)]), K0, 0.5, 0.7, ELEMENT_STEPS[-1])
    assert all(edge_count(SQUARE, walls[:1], size) <= MAX_UNKNOWNS for size in ELEMENT_STEPS)
