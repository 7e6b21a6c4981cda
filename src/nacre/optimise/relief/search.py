"""Multistart gradient search for relief heights: successive refinement, robust optimisation, perturbed restarts.

Bounded L-BFGS-B on the feature heights (physics/relief.md, "Design"). The budget is a fixed stage list with a
fixed iteration count each; a seed gives the same design on any machine; a time limit only cuts the list
short. Starts run in parallel threads and do not share state, so the thread count does not change the result.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from nacre.core.arrays import Array
from nacre.core.parallel import single_threaded_blas
from nacre.optimise.relief.merit import Evaluator, Problem

# random start ranges, relative to the allowed range, about its middle
AMPLITUDES = (0.5, 0.25, 1.0, 0.12)
NOISE_DRAWS = 6
CORRECTIONS = 20  # L-BFGS-B memory
# Relative noise for perturbed restarts. About every second restart finds a lower minimum (measured on designs 3, 12
# and 16: 2 % lower fixed and 7 % lower free loss).
PERTURBATIONS = (0.08, 0.15, 0.05)
PERTURBED_COPIES = 2
LEVELS_SHARE = 0.3  # time limit share reserved for rounding to levels
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


@dataclass(frozen=True)
class Progress:
    """Search progress report.

    Attributes:
        stage, stage_number, stage_count: current stage; numbers from 1.
        best_value: best loss, a weighted mean between fixed and free.
        evaluations, seconds: used so far.
        seconds_left: until the time limit, or None.
        best_x: best relative heights so far, flat.
    """

    stage: str
    stage_number: int
    stage_count: int
    best_value: float
    evaluations: int
    seconds: float
    seconds_left: float | None
    best_x: Array = field(repr=False)


class Stopped(Exception):
    """Raised inside a worker to abort the optimiser; the candidate retains its best point."""


class Search:
    """Resumable search.

    Attributes:
        problem: the problem.
        candidates: starts that were not discarded.
        plan, stage: the stages, and the current index.
        seconds, evaluations: used so far, including earlier runs.
        stop_reason: "time limit" or "interrupted"; "" while running or if all stages before the perturbed restarts
            are complete.
    """

    def __init__(self, problem: Problem, starts: int, seed: int, workers: int = 1, perturbed_restarts: int = 0) -> None:
        self.problem, self.seed, self.workers = problem, seed, workers
        self.plan = stages(problem, perturbed_restarts)
        self.stage = self.evaluations = 0
        self.seconds = 0.0
        self.stop_reason = ""
        self.candidates = [Candidate(_random_start(problem.features, seed, k)) for k in range(starts)]
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._deadline = np.inf
        self._start_time = 0.0
        self._progress: Callable[[Progress], None] | None = None

    @property
    def best(self) -> Candidate:
        """Candidate with the lowest objective; the first among equals, whatever the thread order."""
        return min(self.candidates, key=lambda c: (-c.stage, c.value))

    def stop(self) -> None:
        """Ask the workers to stop; safe from any thread or signal handler."""
        self._stop.set()

    def _is_over(self) -> bool:
        return self._stop.is_set() or time.monotonic() > self._deadline

    def run(self, time_limit_s: float | None = None, progress: Callable[[Progress], None] | None = None) -> Array:
        """Run to the end, the time limit or an interrupt; return the best relative heights `[n, n]`.

        A KeyboardInterrupt stops the workers cleanly.
        """
        self._start_time = time.monotonic() - self.seconds
        reserved_s = LEVELS_SHARE * (time_limit_s or 0.0) if self.problem.levels else 0.0
        self._deadline = np.inf if time_limit_s is None else time.monotonic() + time_limit_s - reserved_s
        self._progress = progress
        with single_threaded_blas():
            while self.stage < len(self.plan):
                self._run_stage(self.plan[self.stage])
                if self._is_over():
                    # a design without its perturbed restarts is complete
                    cut = "" if self.plan[self.stage].perturbs else "time limit"
                    self.stop_reason = self.stop_reason or ("interrupted" if self._stop.is_set() else cut)
                    break
                self.stage += 1
            best = self.best.x.reshape(self.problem.features, -1)
            if self.problem.levels:
                self._deadline += reserved_s
                best = self._round(best)
        self.seconds = time.monotonic() - self._start_time
        return best

    def _run_stage(self, stage: Stage) -> None:
        if stage.perturbs and self.best.stage < self.stage:
            self.candidates = [replace(self.best, stage=self.stage, done=0) for _ in range(stage.keep)]
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
                wait(tasks, return_when=FIRST_EXCEPTION)
            except KeyboardInterrupt:
                self.stop_reason = "interrupted"
                self.stop()
        for task in tasks:
            if not task.cancelled():
                task.result()

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
                raise Stopped
            value, gradient = evaluate(x)
            with self._lock:
                self.evaluations += 1
            if value < best_value:
                best_value = value
                candidate.x, candidate.value = x.copy(), value
            return value, gradient

        def callback(_: Array) -> None:
            candidate.done += 1
            self._report(stage)

        options = {"maxiter": stage.iterations - candidate.done, "maxcor": CORRECTIONS, "ftol": 1e-7}
        try:
            _minimise(value_and_gradient, start, options, callback)
            candidate.done = stage.iterations
        except Stopped:
            pass

    def _report(self, stage: Stage) -> None:
        if self._progress is None:
            return
        now = time.monotonic()
        with self._lock:
            best = self.best
            self.seconds = now - self._start_time
            left = None if not np.isfinite(self._deadline) else max(self._deadline - now, 0.0)
            loss, number = float(np.exp(best.value)), self.stage + 1
            self._progress(
                Progress(stage.name, number, len(self.plan), loss, self.evaluations, self.seconds, left, best.x.copy())
            )

    def _round(self, heights: Array) -> Array:
        levels = self.problem.levels
        if self.stop_reason == "interrupted":
            return round_to_levels(heights, levels)
        evaluator = Evaluator(self.problem, self.problem.search_upsamplings()[1])
        result = optimise_levels(evaluator, heights, levels, self._is_over)
        self.evaluations += evaluator.evaluations
        return result


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
