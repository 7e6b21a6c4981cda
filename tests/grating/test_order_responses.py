"""Responses of periodic structures: equal to the solvers at each direction, smooth between, mirrored."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_grating import check_resumed_table
from numpy.polynomial import chebyshev

import nacre
from nacre.bsdf.lobes.orders import OrdersLobe
from nacre.core.arrays import interpolate
from nacre.core.machine import single_threaded_blas
from nacre.matter.periodic import crossed_solver, order_tables
from nacre.matter.periodic.crossed_solver import solve_fourier
from nacre.matter.periodic.element_solver import solve_ovals
from nacre.matter.periodic.line_elements import solve_elements
from nacre.matter.periodic.line_solver import solve_profile
from nacre.matter.periodic.order_responses import (
    EVEN_NODES,
    LEAST_NODES,
    TAIL,
    Channels,
    Fit,
    channels_of,
    fitted,
    next_counts,
    nodes,
    responses,
    solved_nodes,
)
from nacre.matter.periodic.solve import RUNS, difference, solve_coarse
from nacre.matter.periodic.structure import Cell, OrderSolution, PatternLayer, PeriodicStack, Rectangle

Numbers = dict[tuple[int, int], float]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Solve as the product does: matrices are too small for several threads."""
    with single_threaded_blas():
        yield


def stack_of(shape: dict[str, Any], wavelength_nm: float, substrate: Any, lattice: dict[str, Any]) -> PeriodicStack:
    layer = {"thickness_nm": 110, "material": "air", "shapes": [shape]}
    made = {"family": "grating", "substrate": substrate, "lattice": lattice,
            "layers": [layer, {"thickness_nm": 40, "material": "SiO2"}]}  # fmt: skip
    model: Any = nacre.load(made).model
    return model.stacks(np.array([wavelength_nm]))[0]  # type: ignore[no-any-return]


STRUCTURES: dict[str, tuple[dict[str, Any], float, Any, dict[str, Any], int]] = {
    # shape, wavelength in nm, substrate, lattice, size; tensor products take more plane waves, which moves their error
    "lines": ({"shape": "line", "width_nm": 230, "center_nm": [20, 0]}, 520.0, {"n": 1.5}, {"period_nm": 600}, 0),
    "finer lines": ({"shape": "line", "width_nm": 230}, 520.0, "Al", {"period_nm": 600}, 1),
    "sloping lines": ({"shape": "line", "width_nm": 230, "sidewall_deg": 80}, 520.0, "Al", {"period_nm": 600}, 0),
    # elements end within the film below
    "close sloping lines": ({"shape": "line", "width_nm": 100, "sidewall_deg": 80}, 520.0, {"n": 1.5},
                            {"period_nm": 240}, 0),
    "rectangles": ({"shape": "rectangle", "width_nm": 150, "length_nm": 120}, 650.0, {"n": 1.5}, {"period_nm": 300}, 0),
    "discs": ({"shape": "disc", "diameter_nm": 150}, 650.0, "glass",
              {"period_nm": 320, "kind": "hexagonal"}, 0),
    "metal discs": ({"shape": "disc", "diameter_nm": 150, "material": "Ag"}, 650.0, "glass",
                    {"period_nm": 320, "kind": "hexagonal"}, 0),
}  # fmt: skip


def both_sides(found: OrderSolution) -> list[Numbers]:
    return [
        {(int(m), int(n)): float(v) for (m, n), v in zip(side.numbers, side.efficiency.mean(axis=1), strict=True)}
        for side in (found.reflected, found.transmitted)
    ]


def of_fit(fit: Fit, transverse: np.ndarray) -> list[Numbers]:
    return [
        {(int(m), int(n)): float(v) for (m, n), v in zip(numbers, values[0], strict=True)}
        for numbers, values in fit.orders(transverse[None])
    ]


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_response_gives_the_orders_of_the_solver(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # orders are exact in one and elements in the other: a high degree brings them together
    monkeypatch.setitem(RUNS, "ovals", (solve_ovals, ((6, 5, (0.15,)),)))
    shape, wavelength, substrate, lattice, step = STRUCTURES[name]
    stack = stack_of({"material": "Si"} | shape, wavelength, substrate, lattice)
    theta, phi = 0.9, 2.0  # beyond the cell of the reciprocal lattice for the lines
    channels = channels_of(stack, wavelength)
    transverse = stack.cover * np.sin(theta) * np.array([np.cos(phi), np.sin(phi)])
    inverse = np.linalg.pinv(channels.lattice)
    inside = transverse - np.rint(transverse @ inverse) @ channels.lattice
    fit = Fit(channels, responses(channels, inside[None], step)[None])
    exact = both_sides(solve_coarse(stack, wavelength, theta, phi, step))
    allowed = 1e-8 if name in ("lines", "discs") or "sloping" in name else 3e-4 if name == "metal discs" else 1e-3
    for found, expected in zip(of_fit(fit, transverse), exact, strict=True):
        assert set(found) == {number for number, value in expected.items() if value > 0.0}
        assert all(abs(found[number] - expected[number]) < allowed for number in found)


def test_the_response_of_sloping_metal_lines_is_smooth_along_them() -> None:
    """Errors that grow towards light along the lines make tables ask for up to 24 nodes in place of 8."""
    line = {"shape": "line", "width_nm": 200, "material": "Al", "sidewall_deg": 80}
    made: Any = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 400},
                 "layers": [{"thickness_nm": 100, "material": "air", "shapes": [line]}]}  # fmt: skip
    model: Any = nacre.load(made).model
    stack = model.stacks(np.array([560.0]))[0]
    channels = channels_of(stack, 560.0)
    symmetries = order_tables._symmetries(stack, order_tables._images(stack))
    u = np.stack([nodes(n)[at] for n, at in zip(EVEN_NODES, solved_nodes(channels, EVEN_NODES, symmetries).T)], axis=1)
    fit = fitted(channels, responses(channels, u @ channels.span), EVEN_NODES, symmetries)
    assert next_counts(fit, TAIL[True]) is None


@pytest.mark.parametrize("axis", [0, 1])
def test_mirror_images_of_responses(axis: int) -> None:
    stack = stack_of({"shape": "line", "width_nm": 230, "material": "Al"}, 520.0, {"n": 1.5}, {"period_nm": 600})
    channels = channels_of(stack, 520.0)
    waves = np.array([[0.21, 0.37], [0.21, 0.37]])
    waves[1, axis] *= -1.0
    one, other = responses(channels, waves)
    image = channels.image(np.diag([-1.0, 1.0] if axis == 0 else [1.0, -1.0]))
    assert np.abs(image @ one @ image.T - other).max() < 1e-9 * np.abs(one).max()


@pytest.mark.parametrize("name", ["rectangles", "discs", "metal discs"])
def test_symmetric_nodes_of_two_periods_have_their_own_responses(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(RUNS, "ovals", (solve_ovals, ((3, 2, (0.15,)),)))
    monkeypatch.setitem(RUNS, "fourier", (solve_fourier, (4,)))
    shape, wavelength, substrate, lattice, _ = STRUCTURES[name]
    stack = stack_of({"material": "Si"} | shape, wavelength, substrate, lattice)
    channels, counts = channels_of(stack, wavelength), (4, 4)
    images = order_tables._symmetries(stack, order_tables._images(stack))
    solved = solved_nodes(channels, counts, images)
    assert len(solved) == {"rectangles": 4, "discs": 6, "metal discs": 6}[name]
    u = nodes(4)
    fit = fitted(channels, responses(channels, u[solved] @ channels.span), counts, images)
    at = np.array([3, 1])  # solved in no case
    basis = chebyshev.chebvander(u[at], 3)
    found = np.einsum("i,j,ijab->ab", basis[0], basis[1], fit.coefficients)
    expected = responses(channels, u[at][None] @ channels.span)[0]
    assert np.abs(found - expected).max() < 1e-8 * np.abs(expected).max()


def fitted_lines(channels: Channels, signs: list[tuple[int, int]]) -> Fit:
    images = order_tables._symmetries(channels.stack, signs)
    counts = LEAST_NODES
    while True:
        at = solved_nodes(channels, counts, images)
        u = np.stack([nodes(count)[k] for count, k in zip(counts, at.T, strict=True)], axis=1)
        fit = fitted(channels, responses(channels, u @ channels.span), counts, images)
        more = next_counts(fit, TAIL[False])
        if more is None:
            return fit
        counts = more


def test_plasmons_and_anomalies_lie_between_few_solutions() -> None:
    # silver lines: plasmons of a width below one degree; the last direction is an anomaly, sin(theta) = 650 / 800 - 1
    silver = {"n": 0.16, "k": 3.4}
    line = {"shape": "line", "width_nm": 300, "material": silver}
    made = {"family": "grating", "substrate": silver, "lattice": {"period_nm": 800},
            "layers": [{"thickness_nm": 40, "material": "air", "shapes": [line]}]}  # fmt: skip
    model: Any = nacre.load(made).model
    stack = model.stacks(np.array([650.0]))[0]
    fit = fitted_lines(channels_of(stack, 650.0), [(-1, 1), (1, -1), (-1, -1)])
    assert fit.coefficients.shape[0] * fit.coefficients.shape[1] <= 400  # of 100 or fewer solutions
    generator = np.random.default_rng(7)
    thetas = [*np.arccos(generator.uniform(0.1, 1.0, 40)), *np.radians(np.linspace(9.0, 13.0, 20)), np.arcsin(0.1875)]
    phis = [*(2.0 * np.pi * generator.random(40)), *np.zeros(21)]
    for theta, phi in zip(thetas, phis, strict=True):
        found = of_fit(fit, np.sin(theta) * np.array([np.cos(phi), np.sin(phi)]))[0]
        for number, value in both_sides(solve_coarse(stack, 650.0, float(theta), float(phi)))[0].items():
            assert abs(found.get(number, 0.0) - value) < 2e-3


def test_a_table_of_lines_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order_tables, "FITTED", (12, (24,)))
    lam = np.array([500.0, 600.0])
    stacks = [
        stack_of({"shape": "line", "width_nm": 230, "material": "Al"}, float(w), {"n": 1.5}, {"period_nm": 600})
        for w in lam
    ]  # fmt: skip
    check_resumed_table(monkeypatch, tmp_path, "responses", stacks, lam, 4)


@pytest.mark.parametrize("shape", ["cross", "rectangle"])
def test_the_exchange_of_x_and_y_takes_one_class(shape: str, monkeypatch: pytest.MonkeyPatch) -> None:
    size = {"width_nm": 150, "length_nm": 150} if shape == "rectangle" else {"width_nm": 90, "length_nm": 200}
    stack = stack_of({"shape": shape, "material": "Si"} | size, 650.0, {"n": 1.5}, {"period_nm": 700})
    classes: list[object] = []
    solve_class = crossed_solver._rectangle_class

    def counted(*arguments: Any) -> Any:
        classes.append(arguments)
        return solve_class(*arguments)

    monkeypatch.setattr(crossed_solver, "_rectangle_class", counted)
    found = solve_coarse(stack, 650.0, 0.0, 0.7)
    assert len(classes) == 1
    monkeypatch.setattr(crossed_solver, "box_symmetries", lambda _: (True, True, False))
    both = solve_coarse(stack, 650.0, 0.0, 0.7)
    assert len(classes) == 3
    monkeypatch.setattr(crossed_solver, "box_symmetries", lambda _: (False, False, False))
    whole = solve_coarse(stack, 650.0, 0.0, 0.7)
    assert difference(found, both) < 1e-10 and difference(found, whole) < 1e-6  # parities take another basis
    assert np.abs(found.reflected.jones - both.reflected.jones).max() < 1e-10
    # light goes up from the surface, and down behind it
    assert np.all(both.reflected.direction[:, 2] > 0.0) and np.all(both.transmitted.direction[:, 2] < 0.0)


@pytest.mark.parametrize("far", [700.0, 900.0])
def test_symmetry_is_that_of_the_whole_cell(far: float) -> None:
    """One corner of a square that moves far from the centre takes all mirror images away."""
    points = [[-700, -700], [700, -700], [700, 500], [far, 500], [far, 700], [-700, 700]]
    shape = {"shape": "polygon", "material": {"n": 2.0}, "points_nm": points}
    recipe = {
        "family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 2000.0, "kind": "square"},
        "layers": [{"thickness_nm": 100.0, "material": "air", "shapes": [shape]}],
    }  # fmt: skip
    stack = nacre.load(recipe).model.stacks(np.array([550.0]))[0]
    images = order_tables._images(stack)
    assert images == ([(-1, 1), (1, -1), (-1, -1)] if far == 700.0 else [])
    # reciprocity holds for any structure; the exchange of x and y only for the square
    assert len(order_tables._symmetries(stack, images)) - len(images) == (2 if far == 700.0 else 1)


def test_a_rectangle_that_differs_along_x_and_y_takes_two_classes() -> None:
    stacks = [
        stack_of({"shape": "rectangle", "material": "Si"} | size, 650.0, {"n": 1.5}, {"period_nm": 300})
        for size in ({"width_nm": 150, "length_nm": 120}, {"width_nm": 150, "length_nm": 150, "center_nm": [20, 0]})
    ]  # fmt: skip
    assert [crossed_solver.box_symmetries(stack) for stack in stacks] == [(True, True, False), (False, True, False)]


def test_adjacent_metal_lines_are_solved_by_a_larger_basis() -> None:
    # the small basis is wrong by 1.3e-2 in the worst of 24 such structures
    generator = np.random.default_rng(3)
    metals = [complex(0.2, 3.4) ** 2, complex(0.9, 6.5) ** 2, complex(0.05, 4.0) ** 2]
    for k in range(4):
        widths = generator.uniform(0.3, 0.7, 2) * 500.0
        layers = [
            PatternLayer(80.0, 1.0, ((Rectangle(-0.5 * w, 0.5 * w), metals[(k + j) % 3]),))
            for j, w in enumerate(widths.tolist())
        ]  # fmt: skip
        stack = PeriodicStack(Cell(500.0), 1.0, tuple(layers), 1.5)
        coarse, fine = (solve_coarse(stack, 560.0, 0.5, 0.4, step) for step in (0, 4))
        assert difference(coarse, fine) < 1.5e-3


def test_orders_leave_into_a_dense_ambient_where_they_propagate() -> None:
    layer = {"thickness_nm": 250, "material": {"n": 1.4},
             "shapes": [{"shape": "line", "width_nm": 300, "material": {"n": 1.9}}]}  # fmt: skip
    made = nacre.load({"family": "grating", "ambient": {"n": 1.4}, "substrate": {"n": 1.6}, "layers": [layer],
                       "lattice": {"period_nm": 500}})  # fmt: skip
    lam = np.array([550.0])
    bsdf, found = made.bsdf(lam), nacre.orders(made, 33.0, 17.0, lam)
    theta, azimuth = np.radians([33.0, 17.0])
    wi = np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])
    checked = 0
    for name, eta in (("reflected", 1.0), ("transmitted", 1.6 / 1.4)):
        lobe: Any = next(each for each in bsdf.lobes if each.kind == "orders" and (each.eta > 0.0) == (eta > 1.0))
        peak = eta**2 / (2.0 * np.pi * lobe.width**2)
        sides = getattr(found, name).mean(axis=-1)[0, 0], getattr(found, f"{name}_direction")[0, 0]
        for number, power, way in zip(found.numbers, *sides, strict=True):
            if np.any(number) and np.isfinite(power):
                value = lobe.evaluate(wi, way / np.linalg.norm(way))[0] / peak
                assert value == pytest.approx(power, abs=4e-3)
                checked += power > 0.01
    assert checked > 1


def test_an_error_never_falls_below_what_the_series_of_discs_reaches() -> None:
    """A disc of nearly no contrast: two sizes agree to rounding, which proves nothing about the next."""
    from nacre.matter.periodic.solve import LEAST_ERROR, solve

    stack = stack_of({"shape": "disc", "diameter_nm": 150, "material": {"n": 1.0 + 1e-9}}, 650.0, {"n": 1.5},
                     {"period_nm": 300})  # fmt: skip
    assert solve(stack, 650.0, 0.0, 0.0).error == LEAST_ERROR["fourier"] > 0.0


PROFILES: dict[str, dict[str, Any]] = {
    "blazed metal": {"substrate": "Al", "profile": {"shape": "blazed", "depth_nm": 120}},
    "clear film": {
        "substrate": {"n": 1.5},
        "profile": {"shape": "triangle", "depth_nm": 150, "apex": 0.3},
        "layers": [{"thickness_nm": 60, "material": {"n": 2.2}}],
    },
}


@pytest.mark.parametrize("name", PROFILES)
def test_responses_of_a_profile_give_the_orders_of_the_coordinate_transformation(name: str) -> None:
    """Another solver at directions between the nodes; elements of the smallest size are within 3e-4."""
    made: Any = nacre.material({"family": "grating", "lattice": {"period_nm": 700}, **PROFILES[name]}).model
    stack = made.stacks(np.array([550.0]))[0]
    channels = channels_of(stack, 550.0)
    symmetries = order_tables._symmetries(stack, order_tables._images(stack))
    counts: tuple[int, int] = (12, 16)
    u = np.stack([nodes(n)[at] for n, at in zip(counts, solved_nodes(channels, counts, symmetries).T, strict=True)], 1)
    fit = fitted(channels, responses(channels, u @ channels.span), counts, symmetries)
    for theta_deg, phi_deg in ((5.0, 20.0), (40.0, 200.0), (63.0, 100.0), (80.0, 15.0)):
        theta, phi = np.radians([theta_deg, phi_deg])
        exact = both_sides(solve_profile(stack, 2.0 * np.pi / 550.0, theta, phi, 2))
        found = of_fit(fit, np.sin(theta) * np.array([np.cos(phi), np.sin(phi)]))
        for one, other in zip(exact, found, strict=True):
            assert {k for k, v in other.items() if v > 0.0} == set(one)
            assert max((abs(other[k] - v) for k, v in one.items()), default=0.0) < TAIL[True]


@pytest.mark.full
def test_a_lobe_near_grazing_holds_the_efficiency_of_its_order() -> None:
    """The integral of f cos over a lobe is E for both directions of light, and at most that at the horizon."""
    made = nacre.material({
        "family": "grating", "substrate": "Al", "lattice": {"period_nm": 1000}, "orientation": {"turn_deg": 30},
        "profile": {"shape": "blazed", "depth_nm": 200}, "wavelengths": {"min_nm": 550, "max_nm": 560, "step_nm": 10},
    })  # fmt: skip
    lobe = next(each for each in made.bsdf(np.array([500.0, 550.0])).lobes if isinstance(each, OrdersLobe))
    turn = np.radians(30.0)
    for theta_deg, azimuth_deg in ((7.0, 30.0), (12.0, 70.0)):  # order 2 leaves at 78 and 72 degrees
        theta, azimuth = np.radians([theta_deg, azimuth_deg])
        wi = np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])
        offsets = np.linspace(-8.0, 8.0, 201) * lobe.width
        centre = 2.0 * 0.55 * np.array([np.cos(turn), np.sin(turn)]) - wi[:2]
        across = centre + np.stack(np.meshgrid(offsets, offsets, indexing="ij"), axis=-1).reshape(-1, 2)
        across = across[np.sum(across**2, axis=1) < 1.0]
        wo = np.column_stack([across, np.sqrt(1.0 - np.sum(across**2, axis=1))])
        integral = lobe.evaluate(np.broadcast_to(wi, wo.shape), wo)[:, 1].sum() * (offsets[1] - offsets[0]) ** 2
        orders = nacre.orders(made, theta_deg, azimuth_deg, [550.0])
        efficiency = orders.reflected[0, 0, orders.numbers[:, 0] == 2].mean()
        assert integral == pytest.approx(efficiency, abs=2.0 * TAIL[True])


@pytest.mark.full
def test_a_table_of_a_profile_states_the_error_beside_anomalies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Orders of other directions differ from the interpolated ones by at most the stated error; six midpoints
    between nodes understated it twofold."""
    monkeypatch.setenv("NACRE_CACHE", "off")
    wavelength = 550.0
    grooves = {"family": "grating", "substrate": "Al", "profile": {"shape": "sinusoidal", "depth_nm": 130}}
    model: Any = nacre.material(grooves | {"lattice": {"period_nm": 1100}}).model
    stacks = model.stacks(np.array([wavelength]))
    table = order_tables.order_tables(stacks, np.array([wavelength]), None)
    generator = np.random.default_rng(5)
    theta, azimuth = np.arccos(generator.uniform(0.25, 1.0, 60)), 2.0 * np.pi * generator.random(60)
    thetas, azimuths = (size - 1 for size in table.mirror.shape[:2])
    seen = interpolate(table.mirror, (theta / (0.5 * np.pi) * thetas, azimuth / (2.0 * np.pi) * azimuths))[:, 0]
    exact = []
    for t, a in zip(theta.tolist(), azimuth.tolist(), strict=True):
        solution = solve_elements(stacks[0], 2.0 * np.pi / wavelength, t, a + np.pi, 0).reflected
        exact.append(float(solution.efficiency[np.all(solution.numbers == 0, axis=1)].mean()))
    assert table.between > np.abs(seen - exact).max()


def test_orders_by_fourier_series_are_reciprocal() -> None:
    disc = {"shape": "disc", "material": {"n": 2.2}, "diameter_nm": 300}
    stack, k0 = stack_of(disc, 560.0, {"n": 1.5}, {"period_nm": 620}), 2.0 * np.pi / 560.0
    one = solve_fourier(stack, k0, 0.6, 0.4, 3).reflected
    at = int(np.flatnonzero((one.numbers == [-1, 0]).all(axis=1))[0])
    back = -one.direction[at]
    other = solve_fourier(stack, k0, np.arccos(-back[2]), np.arctan2(back[1], back[0]), 3).reflected
    to = int(np.flatnonzero((other.numbers == [-1, 0]).all(axis=1))[0])
    assert one.efficiency[at].sum() > 1e-3
    assert other.efficiency[to].sum() == pytest.approx(one.efficiency[at].sum(), rel=1e-8)
