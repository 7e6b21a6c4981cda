"""Designs for processes that make only a few heights."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from nacre.core.parallel import single_threaded_blas
from nacre.optimise.relief.merit import Array, Evaluator, Problem

# weight of the pull towards the levels, raised in turn; the objective is a logarithm of order 1
PULLS = (0.02, 0.1, 0.5, 2.0)
ITERATIONS = 25
FLIP_PASSES = 12


def round_to_levels(x: Array, levels: int) -> Array:
    """Round heights over the range to `levels` equal steps, 0 and 1 included."""
    return np.round(np.clip(x, 0.0, 1.0) * (levels - 1)) / (levels - 1)


def settle_on_levels(evaluator: Evaluator, x: Array, levels: int, is_over: Callable[[], bool]) -> Array:
    """Move a continuous design onto levels: a growing penalty between them, rounding, then single changes of level.

    Args:
        evaluator: the loss.
        x: heights over the range, `[n, n]`.
        levels: at least 2.
        is_over: asked between steps; true ends the work early, always on whole levels.
    """
    shape = x.shape
    steps = levels - 1
    best = round_to_levels(x, levels).ravel()
    best_value = evaluator.value_and_gradient(best)[0]
    current = x.ravel()
    for pull in PULLS:
        if is_over():
            break

        def pulled(y: Array, weight: float = pull) -> tuple[float, Array]:
            value, gradient = evaluator.value_and_gradient(y)
            # sin^2(pi k y) is zero on every level and smooth between
            value += weight * float(np.mean(np.sin(np.pi * steps * y) ** 2))
            return value, gradient + weight * np.pi * steps * np.sin(2.0 * np.pi * steps * y) / y.size

        bounds = [(0.0, 1.0)] * current.size
        current = minimize(
            pulled, current, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS, "maxcor": 20}
        ).x
        rounded = round_to_levels(current, levels).ravel()
        value = evaluator.value_and_gradient(rounded)[0]
        if value < best_value:
            best, best_value = rounded, value
    return _flip(evaluator, best, best_value, steps, is_over).reshape(shape)


def _flip(evaluator: Evaluator, x: Array, value: float, steps: int, is_over: Callable[[], bool]) -> Array:
    """Move groups of features one level along the gradient while the loss falls; halve the group when it does not."""
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


# The search: several starts, the better ones refined at a finer sampling, made robust, then perturbed ("shaken").

# height spreads of the random starts, in parts of the allowed range about its middle (section 11.9)
AMPLITUDES = (0.5, 0.25, 1.0, 0.12)
NOISE_DRAWS = 6
CORRECTIONS = 20
# a finished descent sits in a shallow minimum: noise of these sizes, in parts of the range, and a new descent find a
# lower one in about half of all tries (measured on designs 3, 12 and 16: 2 % of the fixed, 7 % of the free loss)
SHAKES = (0.08, 0.15, 0.05)
SHAKEN = 2  # copies of the best, shaken side by side
SETTLING_SHARE = 0.3  # of the time limit is kept for settling on levels


@dataclass(frozen=True)
class Stage:
    """One step of the search: the best `keep` candidates, `iterations` more each, at one sampling.

    A stage that shakes goes on from noisy copies of the best candidate and keeps what is better.
    """

    name: str
    keep: int
    iterations: int
    fine: bool
    robust: bool = False
    shakes: bool = False


EXPLORE = Stage("explore", 0, 30, fine=False)
STAGES = (
    EXPLORE,
    Stage("improve", 3, 60, fine=False),
    Stage("refine", 2, 60, fine=True),
    Stage("finish", 2, 240, fine=True),
)
HARDEN = Stage("harden", 2, 60, fine=True, robust=True)


def stages(problem: Problem, shakes: int = 0) -> tuple[Stage, ...]:
    """Return the list of work of a problem; robustness adds a stage, shakes (perturbed restarts) take the time left."""
    robust = problem.noise > 0 or problem.blur_error > 0
    plan = (*STAGES, HARDEN) if robust else STAGES
    shake = Stage("shake", SHAKEN, 80, fine=True, robust=robust, shakes=True)
    return (*plan, *(shakes * (shake,)))


@dataclass
class Candidate:
    """One start and its present state.

    Attributes:
        x: heights over the allowed range, flat.
        value: objective at `x` in the present stage; infinite before its first evaluation.
        stage, done: the stage it is in, and the iterations it has made there.
    """

    x: Array
    value: float = np.inf
    stage: int = 0
    done: int = 0


@dataclass(frozen=True)
class Progress:
    """What a caller is told while the search runs.

    Attributes:
        stage, stage_number, stage_count: what is being done; numbers from 1.
        best_value: the loss that is searched, a weighted mean of the fixed and the free one.
        evaluations, seconds: spent.
        seconds_left: until the time limit, or None.
        best_x: the best heights so far, over the allowed range, flat.
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
    """Raised inside a worker to leave the optimiser at once; the candidate keeps its best point."""


class Search:
    """A resumable search.

    Attributes:
        problem: what is wanted.
        candidates: the starts not yet discarded.
        plan: the stages.
        stage: index into the plan.
        seconds, evaluations: spent so far, earlier runs included.
        stop_reason: "" while running or when all stages before the shakes are done, else "time limit" or
            "interrupted".
    """

    def __init__(self, problem: Problem, starts: int, seed: int, workers: int = 1, shakes: int = 0) -> None:
        self.problem = problem
        self.workers = workers
        self.plan = stages(problem, shakes)
        self.seed = seed
        self.stage = 0
        self.seconds = 0.0
        self.evaluations = 0
        self.stop_reason = ""
        self.candidates = [Candidate(x) for x in starting_points(problem.features, starts, seed)]
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._deadline = np.inf
        self._begun = 0.0
        self._progress: Callable[[Progress], None] | None = None

    @property
    def best(self) -> Candidate:
        """The candidate with the lowest objective."""
        # of equal values the first one, so that threads finishing in another order change nothing
        return min(self.candidates, key=lambda c: (-c.stage, c.value))

    def stop(self) -> None:
        """Ask the workers to leave; safe from any thread or signal handler."""
        self._stop.set()

    def run(self, time_limit_s: float | None = None, progress: Callable[[Progress], None] | None = None) -> Array:
        """Run to the end, the time limit or an interrupt; return the best heights over the range, `[n, n]`.

        A KeyboardInterrupt stops the workers and counts as a clean stop.
        """
        begun = time.monotonic() - self.seconds
        settling = SETTLING_SHARE * (time_limit_s or 0.0) if self.problem.levels else 0.0
        self._deadline = np.inf if time_limit_s is None else time.monotonic() + time_limit_s - settling
        self._begun = begun
        self._progress = progress
        with single_threaded_blas():
            while self.stage < len(self.plan):
                self._run_stage(self.plan[self.stage])
                if self._stop.is_set() or time.monotonic() > self._deadline:
                    # a design that only lacked time for shakes is finished
                    cut = "" if self.plan[self.stage].shakes else "time limit"
                    self.stop_reason = self.stop_reason or ("interrupted" if self._stop.is_set() else cut)
                    break
                self.stage += 1
            best = self.best.x.reshape(self.problem.features, -1)
            if self.problem.levels:
                self._deadline += settling
                best = self._settle(best)
        self.seconds = time.monotonic() - begun
        return best

    def _run_stage(self, stage: Stage) -> None:
        if stage.shakes and self.best.stage < self.stage:
            self.candidates = [replace(self.best, stage=self.stage, done=0) for _ in range(stage.keep)]
        elif stage.keep:
            self.candidates = sorted(self.candidates, key=lambda c: c.value)[: stage.keep]
        waiting = [c for c in self.candidates if c.stage <= self.stage]
        for candidate in waiting:
            if not stage.shakes and (candidate.stage < self.stage or candidate.done == 0):
                # another sampling, another objective: values of the last stage do not compare
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
        """Continue one candidate; it always holds the best point seen in this stage, or before it when shaken."""
        evaluate = robust_objective(evaluator, self.seed) if stage.robust else evaluator.value_and_gradient
        best_value, start = np.inf, candidate.x
        if stage.shakes:
            best_value = candidate.value
            generator = np.random.default_rng([self.seed, 104729, self.stage, number])
            size = SHAKES[(SHAKEN * self.stage + number) % len(SHAKES)]
            start = np.clip(start + size * generator.standard_normal(start.size), 0.0, 1.0)

        def value_and_gradient(x: Array) -> tuple[float, Array]:
            nonlocal best_value
            if self._stop.is_set() or time.monotonic() > self._deadline:
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
            self._tell(stage)

        try:
            descend: Any = minimize  # its stubs know no value-and-gradient with keyword arguments
            descend(
                value_and_gradient,
                start,
                jac=True,
                method="L-BFGS-B",
                bounds=[(0.0, 1.0)] * len(candidate.x),
                callback=callback,
                options={"maxiter": stage.iterations - candidate.done, "maxcor": CORRECTIONS, "ftol": 1e-7},
            )
            candidate.done = stage.iterations
        except Stopped:
            pass

    def _tell(self, stage: Stage) -> None:
        if self._progress is None:
            return
        now = time.monotonic()
        with self._lock:
            best = self.best
            self.seconds = now - self._begun
            left = None if not np.isfinite(self._deadline) else max(self._deadline - now, 0.0)
            report = Progress(
                stage.name,
                self.stage + 1,
                len(self.plan),
                float(np.exp(best.value)),
                self.evaluations,
                self.seconds,
                left,
                best.x.copy(),
            )
            self._progress(report)

    def _settle(self, heights: Array) -> Array:
        levels = self.problem.levels
        if self.stop_reason == "interrupted":
            return round_to_levels(heights, levels)
        evaluator = Evaluator(self.problem, self.problem.search_upsamplings()[1])
        result = settle_on_levels(
            evaluator, heights, levels, lambda: self._stop.is_set() or time.monotonic() > self._deadline
        )
        self.evaluations += evaluator.evaluations
        return result


def starting_points(features: int, starts: int, seed: int) -> Iterator[Array]:
    """Yield random height maps about the middle of the range, with spreads that take turns."""
    for k in range(starts):
        generator = np.random.default_rng([seed, k])
        yield 0.5 + AMPLITUDES[k % len(AMPLITUDES)] * (generator.random(features * features) - 0.5)


def robust_objective(evaluator: Evaluator, seed: int) -> Callable[[Array], tuple[float, Array]]:
    """Return the objective averaged over fixed draws of height noise and blur error.

    The draws are fixed so that the optimiser sees one smooth function.
    """
    problem = evaluator.problem
    generator = np.random.default_rng([seed, 7919])
    shape = (problem.features, problem.features)
    draws = [problem.noise * generator.standard_normal(shape) for _ in range(NOISE_DRAWS)]
    # blur errors at equal steps over +-1 standard deviation, in a fixed order
    factors = 1.0 + problem.blur_error * np.linspace(-1.0, 1.0, NOISE_DRAWS)

    def evaluate(x: Array) -> tuple[float, Array]:
        pairs = [evaluator.value_and_gradient(x, noise, float(f)) for noise, f in zip(draws, factors)]
        return float(np.mean([p[0] for p in pairs])), np.mean([p[1] for p in pairs], axis=0)

    return evaluate
