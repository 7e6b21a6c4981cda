"""Stated errors of gratings against finer solutions or a second method; energy and reciprocity of each solver.

Random gratings of each class (`_grating_draws.py`) are solved as `nacre orders` does. The truth is the finest solution
of that method or of a second one, whichever changes less with its last size: elements across the plane for lines and
profiles, elements with curved sides for clear discs, larger bases for shapes of metal in two periods. A stated error
holds if the true one does not exceed it by more than that change. Gratings whose truth changes by more than the stated
error decide nothing. Light on shapes in two periods comes along the normal or in a plane of symmetry.

Outcomes are stored in the cache of solved optics (unless `NACRE_CACHE=off`), so that an interrupted run resumes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import nacre
from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.machine import single_threaded_blas
from nacre.matter.periodic import structure
from nacre.matter.periodic.crossed_solver import RECTANGLE_STEPS, solve_rectangles
from nacre.matter.periodic.element_solver import ELEMENT_STEPS, ovals, solve_ovals
from nacre.matter.periodic.line_elements import solve_elements
from nacre.matter.periodic.line_solver import solve_lines, solve_profile
from nacre.matter.periodic.orders import case_key
from nacre.matter.periodic.solve import difference, method_of, solve, solve_coarse, total
from nacre.matter.periodic.structure import NotConvergedError, OrderSolution, PeriodicStack
from nacre.matter.periodic.types import Array
from validation._film import canvas
from validation._grating_draws import draw
from validation._rows import finish, row

FIGURE = "stated_errors.png"
SEED = 2027
SHARE = 0.95
CLASSES = {
    # class of the report -> kinds of the draw, and how many of each
    "lines of dielectrics": {"lines of dielectric": 10},
    "lines of metal": {"lines of metal": 10},
    "sloping lines of metal": {"sloping lines of metal": 6},
    "profiles of dielectrics with corners": {"profiles of dielectric": 10},
    "profiles of metal with corners": {"profiles of metal": 10},
    "sinusoids of metal": {"smooth profiles of metal": 10},
    "rectangles of dielectrics": {"rectangles of dielectric": 8},
    "discs of dielectrics": {"discs of dielectric": 10},
    "metal discs, ellipses and rings": {"discs of metal": 8, "ellipses of metal": 3, "rings of metal": 3},
}
GRADED = (0.15, 0.0225, 0.0034, 0.0005, 0.00008, 0.000012)
FINER_OVALS = {1: ((6, 4, GRADED[:5]), (7, 4, GRADED)), 2: ((6, 4, GRADED[:4]), (7, 4, GRADED[:5]))}
CLEAR_OVALS = (5, 3, GRADED[:3]), (6, 4, GRADED[:4])  # Fourier series of discs are compared with these
MOST_UNKNOWNS = 4000  # of the truth
CONSERVATION = {
    # solver -> count, kinds without loss, and kinds with loss for reciprocity
    "modes of lines": (100, ("lines of dielectric",), ("lines of metal",)),
    "profiles by coordinates": (
        100, ("profiles of dielectric", "smooth profiles of dielectric"),
        ("profiles of metal", "smooth profiles of metal"),
    ),
    "elements across the plane": (
        100, ("profiles of dielectric", "sloping lines of dielectric"), ("profiles of metal", "sloping lines of metal"),
    ),
    "elements along rectangles": (100, ("rectangles of dielectric",), ("rectangles of metal",)),
    "Fourier series": (
        70, ("discs of dielectric", "rings of dielectric"), ("ellipses of dielectric", "rings of dielectric"),
    ),
    "elements with curved sides": (30, ("discs of dielectric",), ("discs of metal", "ellipses of metal")),
}  # fmt: skip
ROUNDING = 1e-8


@dataclass(frozen=True)
class Outcome:
    """A grating: error stated, error found, and change of the truth with its last size."""

    kind: str
    stated: float
    found: float
    change: float

    @property
    def decides(self) -> bool:
        """Whether the truth is sure enough."""
        return self.change <= self.stated

    @property
    def holds(self) -> bool:
        """Whether the stated error is not exceeded."""
        return self.found <= self.stated + self.change


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Return the report's rows."""
    rng, rows, every = np.random.default_rng(SEED), [], []
    with single_threaded_blas():
        for name, kinds in CLASSES.items():
            outcomes, refused = measured(kinds, rng)
            rows.append(_row(name, outcomes, refused))
            every += outcomes
        rows += _conservation(rng)
    _draw(out_dir, every)
    return rows


def measured(kinds: dict[str, int], rng: np.random.Generator) -> tuple[list[Outcome], int]:
    """Return the outcomes of random gratings, and how many the solver refused."""
    outcomes, refused = [], 0
    for kind, count in kinds.items():
        for _ in range(count):
            values = _stored_errors(*_drawn(kind, rng))
            if len(values):
                outcomes.append(Outcome(kind, *values.tolist()))
                print(outcomes[-1], flush=True)
            else:
                refused += 1
    return outcomes, refused


def _stored_errors(stack: PeriodicStack, case: tuple[float, float, float]) -> Array:
    """Return `_errors`, from the cache if it has them."""
    key = case_key(stack, *case, str([sizes for _, sizes in _references(stack)]))
    stored = cached_arrays(key)
    if stored is None:
        stored = {"errors": _errors(stack, case)}
        cache_arrays(key, stored)
    return stored["errors"]


def _errors(stack: PeriodicStack, case: tuple[float, float, float]) -> Array:
    """Return the error stated, the error found and the change of the truth; empty if the solver refuses."""
    try:
        found = solve(stack, *case)
    except NotConvergedError:
        return np.zeros(0)
    truth, change = reference(stack, case)
    apart = difference(found, truth)
    # a solution that is the truth itself decides nothing
    return np.array([found.error, apart, change if apart else np.inf])


def _drawn(kind: str, rng: np.random.Generator) -> tuple[PeriodicStack, tuple[float, float, float]]:
    recipe, wavelength, angle, azimuth = draw(kind, rng)
    stack = nacre.load(recipe).model.stacks(np.array([wavelength]))[0]
    return stack, (wavelength, float(np.radians(angle)), float(np.radians(azimuth)))


def reference(stack: PeriodicStack, case: tuple[float, float, float]) -> tuple[OrderSolution, float]:
    """Return the most certain solution, and its change with its last size."""
    wave = 2.0 * np.pi / case[0], case[1], case[2]
    found: list[tuple[OrderSolution, float]] = []
    for run, sizes in _references(stack):
        with mock.patch.object(structure, "MAX_UNKNOWNS", MOST_UNKNOWNS):
            coarse, fine = (run(*wave, size) for size in sizes)
        found.append((fine, difference(coarse, fine)))
    return min(found, key=lambda each: each[1])


def _references(stack: PeriodicStack) -> list[tuple[Callable[..., OrderSolution], Sequence[Any]]]:
    method = method_of(stack)
    if stack.tilted is not None:
        return [(partial(solve_elements, stack), (3, 4))]
    if method == "lines":
        vertical = tuple((layer, (0.0,) * len(layer.shapes)) for layer in stack.layers)
        return [
            (partial(solve_lines, stack), (3, 4)),
            (partial(solve_elements, replace(stack, tilted=vertical)), (1, 2)),
        ]
    if method == "profile":
        return [(partial(solve_profile, stack), (4, 5)), (partial(solve_elements, stack), (2, 3))]
    if method == "rectangles":
        return [(partial(solve_rectangles, stack), (14, 18))]
    if method == "ovals":
        return [(partial(solve_ovals, stack), FINER_OVALS[len(ovals(stack))])]
    return [(partial(solve_ovals, stack), CLEAR_OVALS)]


def _row(name: str, outcomes: list[Outcome], refused: int) -> dict[str, Any]:
    decided = [each for each in outcomes if each.decides]
    held = sum(each.holds for each in decided)
    ours = f"{held} of {len(decided)}, largest true error {max(each.found for each in decided):.0e}"
    above = [f"{each.found:.1e} with {each.stated:.1e} stated" for each in decided if not each.holds]
    ours += f"; above: {', '.join(above)}" * bool(above)
    ours += f"; {len(outcomes) - len(decided)} undecided" * (len(outcomes) > len(decided))
    ours += f"; {refused} refused" * bool(refused)
    return row(f"{name}: stated error not exceeded", f">= {SHARE:.0%}", ours, held >= SHARE * len(decided), FIGURE)


def _conservation(rng: np.random.Generator) -> list[dict[str, Any]]:
    rows = []
    for name, (count, clear, lossy) in CONSERVATION.items():
        run = _elements if name.startswith("elements") else _coarse
        energy = [float(np.abs(total(run(*_lossless(clear, rng))) - 1.0).max()) for _ in range(count)]
        apart = [_reciprocity(run, *_drawn(str(rng.choice(lossy)), rng), rng) for _ in range(count)]
        rows += [
            row(f"{name}, {what}: of {count}", f"within {ROUNDING:.0e}", f"{max(values):.1e}",
                max(values) <= ROUNDING, FIGURE)
            for what, values in (("energy without loss", energy), ("reciprocity of orders", apart))
        ]  # fmt: skip
    return rows


def _lossless(
    kinds: tuple[str, ...], rng: np.random.Generator
) -> tuple[PeriodicStack, tuple[float, float, float]]:  # fmt: skip
    stack, case = _drawn(str(rng.choice(kinds)), rng)
    layers = tuple(_clear(layer) for layer in stack.layers)
    tilted = None if stack.tilted is None else tuple((_clear(layer), insets) for layer, insets in stack.tilted)
    return replace(stack, layers=layers, tilted=tilted, substrate=stack.substrate.real + 0j), case


def _clear(layer: Any) -> Any:
    shapes = tuple((shape, complex(epsilon).real) for shape, epsilon in layer.shapes)
    return replace(layer, epsilon=complex(layer.epsilon).real, shapes=shapes)


def _coarse(stack: PeriodicStack, case: tuple[float, float, float]) -> OrderSolution:
    return solve_coarse(stack, *case)


def _elements(stack: PeriodicStack, case: tuple[float, float, float]) -> OrderSolution:
    wave = 2.0 * np.pi / case[0], case[1], case[2]
    if stack.cell.period_y is None:
        return solve_elements(stack, *wave, 0)
    return (
        solve_ovals(stack, *wave, ELEMENT_STEPS[0])
        if ovals(stack)
        else solve_rectangles(stack, *wave, RECTANGLE_STEPS[0])
    )


def _reciprocity(
    run: Callable[..., OrderSolution], stack: PeriodicStack, case: tuple[float, float, float], rng: np.random.Generator
) -> float:
    """Return the change of an order's efficiency when it is exchanged with the incident wave."""
    one = run(stack, case).reflected
    at = int(rng.integers(len(one.numbers)))
    back = -one.direction[at]
    other = run(stack, (case[0], float(np.arccos(-back[2])), float(np.arctan2(back[1], back[0])))).reflected
    to = int(np.flatnonzero((other.numbers == one.numbers[at]).all(axis=1))[0])
    return float(abs(other.efficiency[to].sum() - one.efficiency[at].sum()))


def _draw(out_dir: str | Path, outcomes: list[Outcome]) -> None:
    figure, ((axes,),) = canvas(1, 1)
    for kind, mark in zip(dict.fromkeys(each.kind for each in outcomes), "osD^v<>P*Xh", strict=True):
        here = [each for each in outcomes if each.kind == kind and each.decides]
        axes.loglog([each.stated for each in here], [max(each.found, 1e-8) for each in here], mark, ms=4, label=kind)
    axes.loglog([1e-6, 2e-2], [1e-6, 2e-2], "k-", lw=0.8)
    axes.set_xlabel("stated error")
    axes.set_ylabel("true error")
    axes.legend(fontsize=7)
    finish(figure, out_dir, FIGURE)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out")
