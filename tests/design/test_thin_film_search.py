"""Thin-film search: kernels against `tmm` and the reference, small searches."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import tmm

from nacre.core.errors import NacreError
from nacre.light import delta_e_2000
from nacre.matter.indices.library import index
from nacre.matter.stack.solve import powers
from nacre.matter.stack.thickness_gradient import scratch, spectra_and_gradients, stack_tables
from nacre.optimise.merit import MeritFunction, Operand, default_wavelengths_nm
from nacre.optimise.problem import Budget
from nacre.optimise.thin_film.levenberg_marquardt import descend, workspace
from nacre.optimise.thin_film.merit_kernel import compile_merit, evaluate, failure_share
from nacre.optimise.thin_film.search import (
    Engine,
    GeneticOptions,
    Medium,
    Slot,
    Stack,
    StackProblem,
    StackSolution,
    is_alike,
    many,
    search,
)

ROUNDING = 1e-11
GRID = default_wavelengths_nm()
NAMES = ("SiO2", "MgF2", "TiO2", "Si", "Cr")
BOUNDS = {name: (2.0, 300.0) for name in NAMES}
REACHED = 0.2  # of `within`, at which a search ends


def medium(name: str) -> Medium:
    return Medium(name, index(name).n_complex(GRID))


PALETTE = tuple(medium(name) for name in NAMES)


def spectra_of(names: list[str], d: list[float], substrate: str, angles: list[float], sides: list[str]) -> np.ndarray:
    """The kernel's spectra of a stack, `[row, wavelength]`."""
    n = np.array([np.ones(len(GRID)), *(index(name).n_complex(GRID) for name in (*names, substrate))])
    tables = stack_tables(n, GRID, np.radians(angles), sides)
    seen = np.zeros((len(angles), len(GRID)))
    media = np.arange(1, len(names) + 1)
    spectra_and_gradients(
        tables, media, np.array(d), len(names), len(names) + 1, False, scratch(len(names)), seen, np.zeros((1, 1, 1))
    )
    return seen


@pytest.mark.parametrize("side", ["reflected", "transmitted"])
def test_the_kernel_agrees_with_tmm(side: str) -> None:
    names, d, angles = ["MgF2", "Cr", "TiO2", "Si"], [90.0, 6.0, 150.0, 12.0], [0.0, 30.0, 60.0]
    ours = spectra_of(names, d, "BK7", angles, [side] * 3)
    key = "R" if side == "reflected" else "T"
    for row, angle in zip(ours, angles):
        for i in range(0, len(GRID), 8):
            n = [1.0, *(index(name).n_complex([GRID[i]])[0] for name in (*names, "BK7"))]
            theirs = [tmm.coh_tmm(p, n, [np.inf, *d, np.inf], np.radians(angle), GRID[i])[key] for p in ("s", "p")]
            assert row[i] == pytest.approx(np.mean(theirs), abs=ROUNDING)


def test_the_kernel_agrees_with_the_general_solver_beyond_one_block_of_wavelengths() -> None:
    wavelengths = np.linspace(400.0, 700.0, 200)
    n = np.array([index(m).n_complex(wavelengths) for m in ("SiO2", "TiO2", "Ag", "MgF2", "Si")])
    angles = np.radians([0.0, 50.0])
    tables = stack_tables(n, wavelengths, angles, ["reflected", "transmitted"])
    d = np.array([120.0, 30.0, 400.0])
    seen = np.zeros((2, 200))
    spectra_and_gradients(tables, np.array([1, 2, 3]), d, 3, 4, False, scratch(3), seen, np.zeros((1, 1, 1)))
    general = powers(n, d, wavelengths, angles)
    assert abs(seen[0] - general.reflectance[0]).max() < ROUNDING
    assert abs(seen[1] - general.transmittance[1]).max() < ROUNDING


def test_a_bare_substrate_reflects_as_fresnel_says() -> None:
    seen = spectra_of([], [], "Si", [0.0], ["reflected"])
    n = index("Si").n_complex(GRID)
    assert abs(seen[0] - abs((n - 1.0) / (n + 1.0)) ** 2).max() < ROUNDING


@pytest.mark.parametrize("thickness", [0.0, 40.0])
def test_gradients_agree_with_finite_differences_also_at_zero_thickness(thickness: float) -> None:
    names = ("TiO2", "Cr", "SiO2", "Al")
    n = np.array([np.ones(len(GRID)), *(index(name).n_complex(GRID) for name in names)])
    tables = stack_tables(n, GRID, np.radians([0.0, 45.0, 45.0]), ["reflected", "reflected", "transmitted"])
    d, step = np.array([70.0, thickness, 120.0]), 1e-3
    media, w = np.array([1, 2, 3]), scratch(3)
    seen, slopes = np.zeros((3, len(GRID))), np.zeros((3, 3, len(GRID)))
    spectra_and_gradients(tables, media, d, 3, 4, True, w, seen, slopes)
    for j in range(3):
        ahead, further = np.zeros_like(seen), np.zeros_like(seen)
        for steps, out in ((1, ahead), (2, further)):
            moved = d.copy()
            moved[j] += steps * step
            spectra_and_gradients(tables, media, moved, 3, 4, False, w, out, slopes.copy())
        forward = (4.0 * ahead - further - 3.0 * seen) / (2.0 * step)  # of second order, from one side
        assert abs(forward - slopes[:, j]).max() < 1e-6 * abs(slopes).max()


def mixed_goals() -> MeritFunction:
    return MeritFunction(
        [
            Operand(0, "colour", lab=(40, 30, -20)),
            Operand(1, "hue", low=200, high=220, tolerance=0.5),
            Operand(0, "chroma", low=80),
            Operand(1, "lightness", high=20, weight=2.0),
            Operand(1, "spectrum", reflectance=np.linspace(0.2, 0.4, len(GRID))),
        ],
        ("D65", "A"),
    )


def test_the_compiled_merit_function_agrees_with_the_reference() -> None:
    """The residuals are the same numbers in another order, and their slopes finite differences."""
    goals = mixed_goals()
    problem = StackProblem(
        goals,
        PALETTE,
        (medium("Al"),),
        tuple(np.radians([0.0, 40.0])),
        ("reflected",) * 2,
        max_layers=3,
        bounds_nm=BOUNDS,
    )
    tables, looks = problem.tables(), compile_merit(goals)
    s = workspace(tables, looks, 3)
    media, d = np.array([2, 5, 3]), np.array([80.0, 10.0, 130.0])

    def residuals(thicknesses: np.ndarray, slopes: bool) -> np.ndarray:
        spectra_and_gradients(tables, media, thicknesses, 3, 6, slopes, s.w, s.spectra, s.slopes)
        evaluate(looks, s.spectra, s.slopes, 3, slopes, s.r, s.jacobian, s.u)
        return s.r.copy()

    ours = residuals(d, True)
    jacobian = s.jacobian.copy()
    evaluated = goals.residuals(s.spectra)
    assert abs(np.sort(ours) - np.sort(evaluated)).max() < 1e-9
    for j in range(3):
        step = np.zeros(3)
        step[j] = 1e-3
        moved = (residuals(d + step, False) - residuals(d - step, False)) / 2e-3
        assert abs(moved - jacobian[:, j]).max() < 1e-3 * abs(jacobian).max()


def test_narrowed_ranges_lie_inside_the_target_ranges() -> None:
    looks = compile_merit(
        MeritFunction(
            [
                Operand(0, "hue", low=355, high=5),
                Operand(0, "chroma", low=40),
                Operand(0, "lightness", low=20, high=20.1),
            ]
        ),
        0.15,
    )
    ends = {kind: (low, high) for kind, low, high in zip(looks.kind, looks.low, looks.high)}
    assert 355 < ends[1][0] < ends[1][1] < 365
    assert 40 < ends[2][0] < 41
    assert 20 < ends[3][0] < ends[3][1] < 20.1


def test_a_descent_keeps_bounds_and_the_total() -> None:
    goals = MeritFunction([Operand(0, "colour", lab=(60, 60, -60))])
    problem = StackProblem(goals, PALETTE, (medium("Al"),), max_layers=3, bounds_nm=BOUNDS)
    tables, looks = problem.tables(), compile_merit(goals)
    d, low, high = np.array([100.0, 30.0, 100.0]), np.array([60.0, 2.0, 60.0]), np.array([120.0, 60.0, 110.0])
    descend(tables, looks, np.array([1, 5, 3]), d, low, high, 3, 6, 190.0, 30, 2.0, workspace(tables, looks, 3))
    assert (d >= low).all() and (d <= high).all()
    assert d.sum() <= 190.0


def wanted_of(names: list[str], d: list[float], substrate: str, angles: list[float]) -> list[Operand]:
    seen = spectra_of(names, d, substrate, angles, ["reflected"] * len(angles))
    labs = MeritFunction([Operand(len(angles) - 1, "lightness", low=0)]).labs(seen)
    return [Operand(row, "colour", lab=tuple(labs[row, 0]), tolerance=1.0) for row in range(len(angles))]


def test_a_search_recovers_the_colours_of_a_known_stack() -> None:
    """Colours at two angles of a stack that the palette can make; another stack will do."""
    angles = [0.0, 50.0]
    goals = MeritFunction(wanted_of(["MgF2", "Si", "TiO2"], [95.0, 22.0, 60.0], "Al", angles))
    problem = StackProblem(
        goals,
        PALETTE,
        (medium("Al"), medium("Si")),
        tuple(np.radians(angles)),
        ("reflected",) * 2,
        max_layers=4,
        bounds_nm=BOUNDS,
    )
    found = search(problem, budget=Budget(evaluations=200_000), solutions=3, seed=1, jobs=1)
    assert found[0].objective < 1.05 * REACHED
    for one in found:
        assert len(one.materials) <= 4
        assert all(2.0 <= d <= 300.0 for d in one.thicknesses_nm)
        assert one.substrate in ("Al", "Si")
        seen = spectra_of(list(one.materials), list(one.thicknesses_nm), one.substrate, angles, ["reflected"] * 2)
        assert one.objective == pytest.approx(float(goals.objective(goals.distances(seen))), abs=1e-9)
    assert not any(is_alike(a, b) for i, a in enumerate(found) for b in found[:i])


def test_given_layers_keep_their_places_and_materials() -> None:
    goals = MeritFunction(wanted_of(["TiO2", "SiO2", "Cr"], [60.0, 150.0, 30.0], "Al", [0.0]))
    slots = (Slot(("TiO2",), 20.0, 120.0), Slot(("SiO2", "MgF2"), 50.0, 250.0), Slot(("Cr",), 30.0, 30.0))
    problem = StackProblem(goals, PALETTE, (medium("Al"),), slots=slots)
    best = search(problem, budget=Budget(evaluations=200_000), solutions=1, seed=1, jobs=1)[0]
    assert best.objective < 1.05 * REACHED
    assert best.materials[0] == "TiO2" and best.materials[1] in ("SiO2", "MgF2") and best.materials[2] == "Cr"
    assert best.thicknesses_nm[2] == 30.0


def test_many_designs_of_one_seed_are_the_same_on_any_number_of_threads() -> None:
    rng = np.random.default_rng(3)
    wanted = [
        MeritFunction([Operand(0, "colour", lab=(50, *rng.uniform(-30, 30, 2)), tolerance=1.0)]) for _ in range(6)
    ]
    bounds = {"TiO2": (5.0, 300.0), "SiO2": (5.0, 300.0)}
    problem = StackProblem(
        wanted[0], (medium("TiO2"), medium("SiO2")), (medium("BK7"),), max_layers=8, bounds_nm=bounds
    )
    one, two = many(problem, wanted, seed=4, jobs=1), many(problem, wanted, seed=4, jobs=2)
    assert all(s.objective < REACHED for s in one)
    assert all((a.thicknesses_nm == b.thicknesses_nm).all() for a, b in zip(one, two))


def test_few_layers_are_preferred_on_request() -> None:
    goals = MeritFunction(wanted_of(["SiO2"], [180.0], "Si", [0.0]))
    problem = StackProblem(goals, PALETTE, (medium("Si"),), max_layers=5, bounds_nm=BOUNDS, prefer_few_layers=True)
    best = search(problem, budget=Budget(evaluations=200_000), solutions=1, seed=1, jobs=1)[0]
    assert best.objective < 1.05 * REACHED
    assert len(best.materials) == 1


def test_short_stacks_leave_budget_for_longer_ones_if_few_layers_are_preferred() -> None:
    """The stacks of one layer had the whole budget, and what two layers can do was called out of reach."""
    endless = GeneticOptions(stall_generations=10**9)
    goals = MeritFunction(wanted_of(["Cr", "SiO2"], [8.0, 180.0], "Al", [0.0]))
    problem = StackProblem(goals, PALETTE, (medium("Al"),), max_layers=2, bounds_nm=BOUNDS, prefer_few_layers=True)
    best = search(problem, Budget(evaluations=20_000), solutions=1, seed=1, jobs=1, options=endless)[0]
    assert len(best.materials) == 2


def test_a_stopped_search_returns_the_best_so_far() -> None:
    goals = MeritFunction([Operand(0, "colour", lab=(20, 80, 60), tolerance=0.01)])
    problem = StackProblem(goals, PALETTE, (medium("Al"),), max_layers=2, bounds_nm=BOUNDS)
    seen: list[float] = []
    found = search(
        problem,
        Budget(),
        2,
        0,
        on_progress=lambda objective, _: seen.append(objective),
        stop=lambda: len(seen) >= 3,
        jobs=1,
    )
    assert found and len(seen) == 3


def test_similar_stacks_have_the_same_materials_and_thicknesses_within_20_percent() -> None:
    one = StackSolution(("SiO2", "Cr"), np.array([100.0, 10.0]), "Al", np.zeros(1), 0.0)
    near = StackSolution(("SiO2", "Cr"), np.array([115.0, 9.0]), "Al", np.zeros(1), 0.0)
    thicker = StackSolution(("SiO2", "Cr"), np.array([130.0, 10.0]), "Al", np.zeros(1), 0.0)
    other = StackSolution(("Cr", "SiO2"), np.array([100.0, 10.0]), "Al", np.zeros(1), 0.0)
    assert is_alike(one, near) and not is_alike(one, thicker) and not is_alike(one, other)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bounds_nm": {"SiO2": (1.0, 2.0)}}, "no bounds"),
        ({"bounds_nm": {**BOUNDS, "Cr": (9.0, 2.0)}}, "cross"),
        ({"substrates": ()}, "substrate"),
        ({"slots": (Slot(("Cu",), 1.0, 2.0),)}, "not in the palette"),
        ({"angles_rad": ()}, "needs row"),
    ],
)
def test_an_invalid_problem_is_refused(changes: dict, words: str) -> None:
    values = {"palette": PALETTE, "substrates": (medium("Al"),), "bounds_nm": BOUNDS, **changes}
    with pytest.raises(NacreError, match=words):
        StackProblem(MeritFunction([Operand(0, "colour", lab=(1, 2, 3))]), **values)


def spread_problem(within: float, spread: float) -> StackProblem:
    angles = [0.0, 45.0]
    wanted = wanted_of(["MgF2", "Si", "TiO2"], [95.0, 22.0, 60.0], "Al", angles)
    goals = MeritFunction([Operand(g.row, g.kind, g.lab, tolerance=within) for g in wanted])
    return StackProblem(
        goals,
        PALETTE,
        (medium("Al"),),
        tuple(np.radians(angles)),
        ("reflected",) * 2,
        max_layers=4,
        bounds_nm=BOUNDS,
        relative_tolerance=spread,
    )


@pytest.mark.full
def test_a_search_with_tolerances_has_a_higher_yield() -> None:
    plain = search(spread_problem(1.0, 0.0), Budget(evaluations=200_000), 5, 2, jobs=1)
    rounds: list[float] = []
    robust_problem = spread_problem(2.0, 0.05)
    robust = search(
        robust_problem,
        Budget(),
        1,
        2,
        on_progress=lambda objective, _: rounds.append(objective),
        stop=lambda: len(rounds) >= 25,
        jobs=1,
    )[0]

    def share_within(one: StackSolution) -> float:
        rng = np.random.default_rng(99)
        draws = one.thicknesses_nm * (1.0 + 0.05 * rng.normal(size=(400, len(one.materials))))
        seen = np.array(
            [spectra_of(list(one.materials), list(d), one.substrate, [0, 45], ["reflected"] * 2) for d in draws]
        )
        return float(np.mean((robust_problem.merit.distances(seen) <= 2.0).all(axis=-1)))

    own = share_within(robust)
    assert plain[0].yield_share is None and robust.yield_share is not None
    # 400 and 1000 draws: a standard deviation of 0.03
    assert own == pytest.approx(robust.yield_share, abs=0.1)
    assert own > np.mean([share_within(one) for one in plain]) + 0.1


def test_settling_increases_the_yield_within_the_bounds() -> None:
    """By draws that its steps were not chosen by, and within bounds, the sum's included."""
    problem = dataclasses.replace(spread_problem(2.0, 0.03), max_total_nm=179.0)
    engine = Engine(problem, 1)
    media, d = np.zeros(engine.slots + 3, dtype=np.int64), np.zeros(engine.slots + 3)
    media[:3], d[:3] = (2, 4, 3), (97.0, 22.5, 58.5)  # some per cent from a stack of the wanted colours
    begun = Stack(0.0, media, d, 3, len(PALETTE) + 1)
    settled = engine.settle(begun, math.inf)
    assert 0.0 < engine.yield_share(begun, 7) + 0.05 < engine.yield_share(settled, 7)
    assert settled.d[:3].sum() <= 179.0 and settled.d[:3].min() >= 2.0 and begun.d[:3].tolist() == [97.0, 22.5, 58.5]
    assert engine.settle(begun, 0.0).d.tolist() == d.tolist()  # no time is left


def test_the_linear_yield_agrees_with_samples() -> None:
    problem = spread_problem(2.0, 0.03)
    tables, looks, space = problem.tables(), compile_merit(problem.merit), problem.space()
    s = workspace(tables, looks, 4)
    media, d, n = np.array([2, 4, 3]), np.array([95.0, 22.0, 60.0]), 3
    low, high = np.full(3, 2.0), np.full(3, 300.0)
    descend(tables, looks, media, d, low, high, n, len(PALETTE) + 1, 1e9, -1, 2.0, s)
    sigma = 0.03 * d
    linear = failure_share(looks, s.r, s.jacobian, n, sigma, space.draws)
    missed = []
    for z in space.draws:
        descend(tables, looks, media, d + sigma * z[:n], low, high, n, len(PALETTE) + 1, 1e9, 0, 2.0, s)
        missed.append(s.u.max() > 1.0)
    assert 0.1 < np.mean(missed) < 0.95
    assert linear == pytest.approx(np.mean(missed), abs=0.1)


def test_the_default_grid_resolves_stacks_of_high_finesse() -> None:
    """Thick mirrors of ten layers have the narrowest fringes that the search may make: the default grid sees them."""
    fine = np.arange(380.0, 781.0)
    n = {name: index(name).n_complex(fine) for name in ("TiO2", "SiO2", "BK7")}
    rng = np.random.default_rng(8)
    worst = 0.0
    for _ in range(50):
        d = rng.uniform(100.0, 300.0, 10)
        seen = powers([np.ones(401), *(n["TiO2"], n["SiO2"]) * 5, n["BK7"]], d, fine, 0.0, jobs=1).reflectance
        exact = MeritFunction([Operand(0, "lightness", low=0)], wavelengths_nm=fine).labs(seen[None])[0, 0]
        own = MeritFunction([Operand(0, "lightness", low=0)]).labs(seen[None, ::2])[0, 0]
        worst = max(worst, float(delta_e_2000(exact, own)))
    assert worst < 0.05
