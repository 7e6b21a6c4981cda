"""Multistart gradient search for relief heights: successive refinement, robust optimisation, perturbed restarts.

Bounded L-BFGS-B on the feature heights (physics/relief.md, "Design"). The budget is a fixed stage list with a
fixed iteration count each; a seed gives the same design on any machine; a time limit only cuts the list
short. Starts run in parallel threads and do not share state, so the thread count does not change the result.

Vector refinement improves the heights of a finished design by Maxwell's equations. The picture is the orders of the
tile, each as wide as the coherence window makes it: f(psi) = sum over orders E G(psi - lambda g), with the efficiency E
for unpolarised light and a Gaussian G of unit integral. Equal heights move together, by a pattern search with falling
steps, since a gradient costs as much as one evaluation for each height.
"""

from __future__ import annotations

import base64
import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.core.jit import clock
from nacre.core.machine import single_threaded_blas
from nacre.families.relief.material import Relief
from nacre.families.relief.structures import Blocks, Lines, blocks_of, lines_of
from nacre.families.relief.surface import Tile
from nacre.families.relief.vector import VectorRelief
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.periodic.structure import MAX_UNKNOWNS
from nacre.optimise.checkpoint import Checkpointer, unreadable
from nacre.optimise.problem import BudgetExhausted, Changes, Search
from nacre.optimise.relief.merit import Evaluator, Losses, Problem, View, exact_losses, objective
from nacre.recipe.model import RecipeContext

logger = logging.getLogger("nacre")

HEIGHTS = "heights"
# random start ranges, relative to the allowed range, about its middle
AMPLITUDES = (0.5, 0.25, 1.0, 0.12)
NOISE_DRAWS = 6
CORRECTIONS = 20  # L-BFGS-B memory
# Relative noise for perturbed restarts. About every second restart finds a lower minimum (measured on designs 3, 12
# and 16: 2 % lower fixed and 7 % lower free loss).
PERTURBATIONS = (0.08, 0.15, 0.05)
PERTURBED_COPIES = 2
LEVELS_SHARE = 0.3  # time limit share reserved for rounding to levels
SCALAR_SHARE = 0.5  # time limit share before a vector refinement
# penalty weights between levels, in turn; the logarithmic objective is about 1
LEVEL_PENALTIES = (0.02, 0.1, 0.5, 2.0)
LEVEL_ITERATIONS = 25
FLIP_PASSES = 12


@dataclass(frozen=True)
class Stage:
    """Search stage: `iterations` for the best `keep` candidates each, at one sampling.

    A perturbing stage starts from noisy best-candidate copies and accepts improvements only.
    """

    name: str
    keep: int
    iterations: int
    fine: bool
    robust: bool = False
    perturbs: bool = False


STAGES = (
    Stage("explore", 0, 30, fine=False),
    Stage("improve", 3, 60, fine=False),
    Stage("refine", 2, 60, fine=True),
    Stage("finish", 2, 240, fine=True),
)
ROBUST_STAGE = Stage("robust", 2, 60, fine=True, robust=True)


def stages(problem: Problem, perturbed_restarts: int = 0) -> tuple[Stage, ...]:
    """Return the search stages: a robust one if the process has errors, then the perturbed restarts."""
    robust = problem.noise > 0 or problem.blur_error > 0
    perturb = Stage("perturb", PERTURBED_COPIES, 80, fine=True, robust=robust, perturbs=True)
    return (*STAGES, *((ROBUST_STAGE,) if robust else ()), *(perturbed_restarts * (perturb,)))


@dataclass
class Candidate:
    """One start's state.

    Attributes:
        x: relative heights, flat.
        value: objective at `x` in the current stage; infinite before the first evaluation.
        stage, done: current stage, and iterations completed in it.
    """

    x: Array
    value: float = np.inf
    stage: int = 0
    done: int = 0

    @property
    def document(self) -> dict[str, Any]:
        """The state as JSON data."""
        return {**vars(self), "x": base64.b64encode(self.x.tobytes()).decode()}


class ReliefSearch(Search):
    """Resumable search for heights; `changes` of a solution are the heights `[x, y]` in um.

    Attributes:
        problem: the problem.
        candidates: starts that were not discarded.
        plan, stage: the stages, and the current index.
        refinement: result of the vector refinement.

    Args:
        coating: refine the heights by Maxwell's equations, with this coating, in the second half of the time.
    """

    default_evaluations = np.inf
    is_met = False  # the stages end the search

    def __init__(
        self,
        problem: Problem,
        starts: int,
        seed: int,
        workers: int = 1,
        perturbed_restarts: int = 0,
        coating: OpticalConstant | None = None,
    ) -> None:
        super().__init__(1)
        self.problem, self.seed, self.workers, self.coating = problem, seed, workers, coating
        self.plan = stages(problem, perturbed_restarts)
        self.stage = self.earlier_evaluations = 0
        self.candidates = [Candidate(_random_start(problem.features, seed, k)) for k in range(starts)]
        self.refinement: Refinement | None = None
        self._final: Array | None = None
        self._stop = threading.Event()
        self._end_time = np.inf

    @property
    def leader(self) -> Candidate:
        """Candidate with the lowest objective; the first among equals, whatever the thread order."""
        return min(self.candidates, key=lambda c: (-c.stage, c.value))

    @property
    def evaluations(self) -> float:
        """Evaluations, those of earlier runs included."""
        return self.earlier_evaluations + self.budget.used

    @property
    def description(self) -> str:
        """Stage and best loss, a weighted mean between fixed and free."""
        stage = min(self.stage, len(self.plan) - 1)
        return f"{self.plan[stage].name} ({stage + 1} of {len(self.plan)}): loss {self.best:.5f}"

    def state(self, solutions: Sequence[Changes]) -> tuple[Sequence[Changes], dict[str, Any]]:
        """Return all candidates, the stage and the evaluations, from which `restore` continues."""
        return [c.document for c in self.candidates], {"stage": self.stage, "evaluations": self.evaluations}

    def restore(self, checkpointer: Checkpointer) -> None:
        """Continue from a checkpoint, if there is one.

        Raises:
            NacreError: it is damaged.
        """
        if not checkpointer.progress:
            return
        try:
            stage, evaluations = (int(checkpointer.progress[key]) for key in ("stage", "evaluations"))
            candidates = [
                Candidate(
                    np.frombuffer(base64.b64decode(c["x"])).copy(), float(c["value"]), int(c["stage"]), int(c["done"])
                )
                for c in checkpointer.solutions
            ]
            counts = np.array([[stage, evaluations], *([c.stage, c.done] for c in candidates)])
            if not candidates or counts.min() < 0 or counts[:, 0].max() > len(self.plan):
                raise ValueError
            for one in candidates:
                if one.x.shape != (self.problem.features**2,) or not np.isfinite(one.x).all() or np.isnan(one.value):
                    raise ValueError
        except (KeyError, TypeError, ValueError, OverflowError):
            raise unreadable(checkpointer.folder) from None
        self.stage, self.earlier_evaluations, self.candidates = stage, evaluations, candidates

    def solutions(self) -> list[tuple[float, Changes]]:
        """Return the best heights, on the levels of the process."""
        leader = self.leader
        x = leader.x.reshape(self.problem.features, -1) if self._final is None else self._final
        if self.problem.levels:
            x = round_to_levels(x, self.problem.levels)
        return [(float(np.exp(leader.value)), {HEIGHTS: x * (self.problem.height_max_nm / 1e3)})]

    def report(self, is_forced: bool = False) -> None:
        """Report the best candidate so far, at intervals unless forced."""
        with self._lock:
            if self.is_report_due(is_forced):
                [(self.best, self.best_changes)] = self.solutions()
                super().report(is_forced=True)

    def _search(self, known: Sequence[Mapping[str, Any]]) -> None:
        self._stop.clear()
        limit = self.budget.seconds * (1.0 if self.coating is None else SCALAR_SHARE)
        begun = clock()
        self._end_time = begun + limit * (1.0 - LEVELS_SHARE if self.problem.levels else 1.0)
        self.report(is_forced=True)
        with single_threaded_blas():
            is_complete = self._run_stages()
            if self.problem.levels:
                self._end_time = begun + limit
                self._final = self._on_levels()
        if self.coating is not None:
            self._refine(self.coating)
        if not is_complete:
            raise BudgetExhausted

    def _run_stages(self) -> bool:
        """Run the stages; return whether the design is complete. Perturbed restarts are optional."""
        while self.stage < len(self.plan):
            stage = self.plan[self.stage]
            # evaluations are counted between stages, so that the thread order does not change the result
            if self.budget.used >= self.budget.evaluations or not self._run_stage(stage):
                return stage.perturbs
            self.report(is_forced=True)
            self.stage += 1
        return True

    def _run_stage(self, stage: Stage) -> bool:
        """Return whether the stage ended before its time."""
        if stage.perturbs and self.leader.stage < self.stage:
            self.candidates = [replace(self.leader, stage=self.stage, done=0) for _ in range(stage.keep)]
        elif stage.keep:
            self.candidates = sorted(self.candidates, key=lambda c: c.value)[: stage.keep]
        waiting = [c for c in self.candidates if c.stage <= self.stage]
        for candidate in waiting:
            if not stage.perturbs and (candidate.stage < self.stage or candidate.done == 0):
                # objectives at different samplings are not comparable
                candidate.stage, candidate.done, candidate.value = self.stage, 0, np.inf
        coarse, fine = self.problem.search_upsamplings()
        with ThreadPoolExecutor(self.workers) as pool:
            tasks = [
                pool.submit(self._descend, c, k, Evaluator(self.problem, fine if stage.fine else coarse), stage)
                for k, c in enumerate(waiting)
                if c.done < stage.iterations
            ]
            try:
                for task in wait(tasks, return_when=FIRST_EXCEPTION).done:
                    task.result()
            except BaseException:
                self._stop.set()
                raise
        return all(c.done >= stage.iterations for c in waiting)

    def _is_over(self) -> bool:
        return self._stop.is_set() or self.budget.is_over(np.inf, self._end_time)

    def _descend(self, candidate: Candidate, number: int, evaluator: Evaluator, stage: Stage) -> None:
        """Continue one candidate, which always stores its best point."""
        evaluate = robust_objective(evaluator, self.seed) if stage.robust else evaluator.value_and_gradient
        best_value, start = np.inf, candidate.x
        if stage.perturbs:
            best_value = candidate.value
            generator = np.random.default_rng([self.seed, 104729, self.stage, number])
            size = PERTURBATIONS[(PERTURBED_COPIES * self.stage + number) % len(PERTURBATIONS)]
            start = np.clip(start + size * generator.standard_normal(start.size), 0.0, 1.0)

        def value_and_gradient(x: Array) -> tuple[float, Array]:
            nonlocal best_value
            if self._is_over():
                raise BudgetExhausted
            value, gradient = evaluate(x)
            with self._lock:
                self.budget.used += 1
            if value < best_value:
                best_value = value
                candidate.x, candidate.value = x.copy(), value
            return value, gradient

        def callback(_: Array) -> None:
            candidate.done += 1
            self.report()

        options = {"maxiter": stage.iterations - candidate.done, "maxcor": CORRECTIONS, "ftol": 1e-7}
        try:
            _minimise(value_and_gradient, start, options, callback)
            candidate.done = stage.iterations
        except BudgetExhausted:
            pass

    def _on_levels(self) -> Array:
        evaluator = Evaluator(self.problem, self.problem.search_upsamplings()[1])
        x = self.leader.x.reshape(self.problem.features, -1)
        optimised = optimise_levels(evaluator, x, self.problem.levels, self._is_over)
        self.budget.used += evaluator.evaluations
        return optimised

    def _refine(self, coating: OpticalConstant) -> None:
        """Refine by Maxwell's equations; if the heights cannot be solved, the scalar design stays."""
        [(_, changes)] = self.solutions()
        try:
            self.refinement = refine(self.problem, 1e3 * changes[HEIGHTS], coating, self.budget.is_over)
        except NacreError as error:
            logger.warning("not refined by Maxwell's equations: %s", error)
            return
        self._final = self.refinement.heights_nm / self.problem.height_max_nm
        if self.refinement.is_interrupted:
            raise KeyboardInterrupt


def _minimise(
    value_and_gradient: Callable[[Array], tuple[float, Array]],
    start: Array,
    options: dict[str, Any],
    callback: Callable[[Array], None] | None = None,
) -> Array:
    """Minimise by L-BFGS-B in the unit cube."""
    bounds = [(0.0, 1.0)] * len(start)
    keywords: dict[str, Any] = {"jac": True, "method": "L-BFGS-B", "bounds": bounds, "callback": callback}
    return np.asarray(minimize(value_and_gradient, start, options=options, **keywords).x)


def _random_start(features: int, seed: int, number: int) -> Array:
    generator = np.random.default_rng([seed, number])
    return 0.5 + AMPLITUDES[number % len(AMPLITUDES)] * (generator.random(features * features) - 0.5)


def robust_objective(evaluator: Evaluator, seed: int) -> Callable[[Array], tuple[float, Array]]:
    """Return the objective averaged over fixed height noise and blur error draws (a smooth function)."""
    problem = evaluator.problem
    generator = np.random.default_rng([seed, 7919])
    shape = (problem.features, problem.features)
    draws = [problem.noise * generator.standard_normal(shape) for _ in range(NOISE_DRAWS)]
    # blur errors at equal steps over +-1 standard deviation
    factors = 1.0 + problem.blur_error * np.linspace(-1.0, 1.0, NOISE_DRAWS)

    def evaluate(x: Array) -> tuple[float, Array]:
        pairs = [evaluator.value_and_gradient(x, noise, float(f)) for noise, f in zip(draws, factors)]
        return float(np.mean([p[0] for p in pairs])), np.mean([p[1] for p in pairs], axis=0)

    return evaluate


def round_to_levels(x: Array, levels: int) -> Array:
    """Round relative heights to `levels` equal steps, including 0 and 1."""
    return np.round(np.clip(x, 0.0, 1.0) * (levels - 1)) / (levels - 1)


def optimise_levels(evaluator: Evaluator, x: Array, levels: int, is_over: Callable[[], bool]) -> Array:
    """Discretise a continuous design: growing penalty between the levels, rounding, then single-feature flips.

    Args:
        x: relative heights, `[n, n]`.
        levels: at least 2.
        is_over: polled between steps; true ends the work early, always on discrete levels.
    """
    steps = levels - 1
    best = round_to_levels(x, levels).ravel()
    best_value = evaluator.value_and_gradient(best)[0]
    current = x.ravel()
    for weight in LEVEL_PENALTIES:
        if is_over():
            break

        def penalised(y: Array, weight: float = weight) -> tuple[float, Array]:
            value, gradient = evaluator.value_and_gradient(y)
            # sin^2(pi k y) vanishes on every level and is smooth between them
            value += weight * float(np.mean(np.sin(np.pi * steps * y) ** 2))
            return value, gradient + weight * np.pi * steps * np.sin(2.0 * np.pi * steps * y) / y.size

        current = _minimise(penalised, current, {"maxiter": LEVEL_ITERATIONS, "maxcor": CORRECTIONS})
        rounded = round_to_levels(current, levels).ravel()
        value = evaluator.value_and_gradient(rounded)[0]
        if value < best_value:
            best, best_value = rounded, value
    return _flip(evaluator, best, best_value, steps, is_over).reshape(x.shape)


def _flip(evaluator: Evaluator, x: Array, value: float, steps: int, is_over: Callable[[], bool]) -> Array:
    """Move feature groups by one level along the gradient while the loss falls; halve the group otherwise."""
    group = max(1, x.size // 16)
    for _ in range(FLIP_PASSES):
        if is_over():
            break
        _, gradient = evaluator.value_and_gradient(x)
        moved = np.clip(x - np.sign(gradient) / steps, 0.0, 1.0)
        gain = np.abs(gradient) * (moved != x)
        chosen = np.argsort(-gain, kind="stable")[:group]
        trial = x.copy()
        trial[chosen] = moved[chosen]
        trial_value = evaluator.value_and_gradient(trial)[0]
        if trial_value < value:
            x, value = trial, trial_value
        elif group == 1:
            break
        else:
            group = max(1, group // 2)
    return x


FIRST_STEP, LAST_STEP = 0.08, 0.01  # fraction of the largest height
TOLERANCE = 2e-2  # error of an efficiency, for candidates


@dataclass(frozen=True)
class Refinement:
    """Heights after the refinement.

    Attributes:
        heights_nm: `[x, y]`.
        before, after: losses of the picture by Maxwell's equations.
        evaluations: solved candidates.
        seconds: its time.
        is_interrupted: whether an interrupt ended it.
    """

    heights_nm: Array
    before: Losses
    after: Losses
    evaluations: int
    seconds: float
    is_interrupted: bool = False

    @property
    def summary(self) -> dict[str, Any]:
        """Its part of `design.json`."""
        return {
            "loss_fixed_before": self.before.fixed, "loss_free_before": self.before.free,
            "loss_fixed": self.after.fixed, "loss_free": self.after.free,
            "evaluations": self.evaluations, "seconds": round(self.seconds, 3),
        }  # fmt: skip


def check_refinable(problem: Problem, coating: OpticalConstant, context: RecipeContext) -> None:
    """Refuse a tile whose vector optics cannot be afforded, before the search.

    Raises:
        RecipeError: the period or the blur is too large, or the colours include the coating's reflectance.
    """
    if any(view.reflectance is None for view in problem.views):
        raise RecipeError(f'{context.source}: search.refine = "vector" needs spectrum = "default"')
    steps = np.add.outer(np.arange(problem.features), np.arange(problem.features)) % 2 * problem.height_max_nm
    tile = Tile(steps + np.eye(problem.features), problem.feature_nm, problem.blur_nm)
    obstacle = _relief(problem, tile, coating).vector_obstacle(MAX_UNKNOWNS)
    if obstacle:
        raise context.fail(
            "search.refine", "vector", f"does not fit: {obstacle}; allowed: few features of a short period, with "
            "vertical walls, or no refine",
        )  # fmt: skip


def refine(
    problem: Problem,
    heights_nm: Array,
    coating: OpticalConstant,
    is_over: Callable[[], bool] = lambda: False,
) -> Refinement:
    """Improve the heights of a design; an interrupt ends it with the best heights so far.

    Args:
        heights_nm: `[x, y]`, in [0, `problem.height_max_nm`].
        is_over: polled between candidates; the picture of the given heights is solved in any case.

    Raises:
        NacreError: the heights cannot be solved.
    """
    start = clock()
    values, groups = np.unique(heights_nm, return_inverse=True)
    groups = groups.reshape(heights_nm.shape)
    top = problem.height_max_nm
    grid = np.linspace(0.0, top, problem.levels) if problem.levels else None

    def merit(candidate: Array) -> tuple[float, Array]:
        rgb = vector_rgb(problem, candidate[groups], coating)
        return objective(rgb, problem.target, problem.intensity_scale, problem.brightness_floor)[0], rgb

    best, rgb = merit(values)
    first = exact_losses(rgb, problem.target, problem.intensity_scale)
    is_interrupted = False
    count, step = 1, FIRST_STEP * top if grid is None else float(grid[1])
    try:
        while grid is not None or step >= LAST_STEP * top:  # on discrete levels it ends when no step improves
            improved = False
            for k, sign in ((k, sign) for k in range(len(values)) for sign in (1.0, -1.0)):
                if is_over():
                    raise BudgetExhausted
                moved = values.copy()
                moved[k] = np.clip(values[k] + sign * step, 0.0, top)
                if grid is not None:
                    moved[k] = grid[np.argmin(np.abs(grid - moved[k]))]
                if moved[k] == values[k]:
                    continue
                try:
                    value, view = merit(moved)
                except NacreError:  # a candidate that cannot be solved
                    continue
                count += 1
                if value < best:
                    best, values, rgb, improved = value, moved, view, True
            if not improved:
                if grid is not None:
                    break
                step *= 0.5
    except BudgetExhausted:
        pass
    except KeyboardInterrupt:
        is_interrupted = True
    last = exact_losses(rgb, problem.target, problem.intensity_scale)
    return Refinement(values[groups], first, last, count, clock() - start, is_interrupted)


def vector_rgb(problem: Problem, heights_nm: Array, coating: OpticalConstant) -> Array:
    """Return linear colours `[pixel, 3]` of all views by Maxwell's equations.

    Raises:
        NacreError: the heights cannot be solved.
    """
    tile = Tile(heights_nm, problem.feature_nm, problem.blur_nm)
    relief = _relief(problem, tile, coating)
    obstacle = relief.vector_obstacle(MAX_UNKNOWNS)
    if obstacle:
        raise NacreError(f"heights that cannot be solved: {obstacle}")
    pattern: Lines | Blocks = lines_of(tile) or blocks_of(tile)
    vector = VectorRelief(relief, pattern, TOLERANCE)
    return np.concatenate([_view_rgb(vector, view, wi) for view in problem.views for wi in view.geometry.wi])


def _relief(problem: Problem, tile: Tile, coating: OpticalConstant) -> Relief:
    return Relief(tile, problem.coherence, coating, problem.prefactor)


def _view_rgb(vector: VectorRelief, view: View, wi: Array) -> Array:
    """Return linear colours `[pixel, 3]` of one view for light from one direction."""
    geometry = view.geometry
    theta, azimuth = float(np.arccos(wi[2])), float(np.arctan2(wi[1], wi[0]))
    orders = vector.diffraction_orders(np.array([theta]), azimuth, geometry.wavelengths_nm)
    power = np.nan_to_num(orders.reflected[0].mean(axis=-1))  # [wavelength, order]
    centres = np.nan_to_num(orders.reflected_direction[0, :, :, :2]) + wi[:2]
    width = vector.order_width_rad
    across, along = (
        np.exp(-0.5 * np.square((psi - centres[..., axis, None]) / width)) / (np.sqrt(2.0 * np.pi) * width)
        for axis, psi in enumerate((geometry.psi_x, geometry.psi_y))
    )
    values = np.einsum("wo,wox,woy->xyw", power, across, along)
    values[~geometry.cos_o[1][_incidence(geometry.wi, wi)]] = 0.0
    return np.asarray(values.reshape(-1, values.shape[-1]) @ view.rgb_weights.T)


def _incidence(directions: Array, wi: Array) -> int:
    return int(np.flatnonzero(np.all(directions == wi, axis=1))[0])
