"""The search of films: islands of stacks that breed, on few wavelengths; the best are finished and judged on all.

An island starts from draws and breeds until it stands still; then another starts, and every third is peopled by the
best of all before. Materials, order and count change by breeding, thicknesses by descent (`stack_breed`,
`stack_descent`). What counts in the end is `MeritFunction` on the full grid.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.parallel import available_jobs
from nacre.matter.stack.thickness_gradient import scratch, spectra_and_gradients
from nacre.optimise.merit import MeritFunction, difference_components
from nacre.optimise.thin_film.genetic import (
    WORST_POWER,
    Population,
    Space,
    draw_many,
    empty_population,
    evolve,
    nearest,
)
from nacre.optimise.thin_film.levenberg_marquardt import descend, keep_total, workspace
from nacre.optimise.thin_film.merit_kernel import compile_merit
from nacre.optimise.thin_film.problem import StackProblem

POOL = 48
LITTER = 96
FRESH = 0.1
MARGIN = 0.15  # of `within`, by which ranges are narrowed
REACHED = 0.2  # of `within`: the end of a search
PLAIN_SHARE, ROBUST_SHARE = 0.95, 0.9  # of the seconds for the search itself; the rest finishes and judges
LADDER_SHARE = 0.5  # of that time: what stacks of fewer layers than are allowed may take, where few are preferred
COMPILED_SHARE = 0.5  # of the seconds that a search keeps where kernels are compiled first, once an installation
YIELD_DRAWS = 1000  # for the yield that is told
YIELD_SEED, SETTLING_SEED = 21, 22  # the yield that is told was not what the last steps were chosen by
SETTLING_STEPS = 150
SETTLING_SIZE = (0.02, 0.002)  # of the thicknesses: the first such step, and the smallest
MADE = 0.01  # share of misses at which a search for yield ends
STILL_LITTERS = 30  # rounds without a gain of `GAIN`, then a new island
GAIN = 0.02
MERGE_EVERY = 3
FINISHED = 24  # candidates that are finished on all wavelengths
FINISH_STEPS = 25
ALIKE = 0.2  # the same materials with all thicknesses this near are one answer
EQUAL_LOOKS = 0.1  # of `within`: nobody chooses between these by their look
SHARED_DRAWS = 60_000
MANY_STARTS = 24
MANY_LITTER = 48
MANY_ROUNDS = 30


@dataclass(frozen=True, eq=False)
class StackSolution:
    """One answer.

    Attributes:
        materials: names of the layers from the top.
        thicknesses_nm: `[layer]`.
        substrate: name of what lies below.
        d: `[term]`, distances of the goals' terms on all wavelengths (`MeritFunction.distances`).
        objective: `MeritFunction.objective` of them.
        yield_share: share of made samples that meet all wants, or None without spreads.
    """

    materials: tuple[str, ...]
    thicknesses_nm: Array
    substrate: str
    d: Array
    objective: float
    yield_share: float | None = None


@dataclass(frozen=True)
class Progress:
    """How far a search is: seconds, stacks begun, the best objective so far (coarse grid), and what names its stack."""

    seconds: float
    children: int
    objective: float
    solution: Callable[[], StackSolution]


@dataclass
class _Candidate:
    score: float
    media: Any
    d: Array
    layers: int
    substrate: int

    @property
    def key(self) -> tuple[int, ...]:
        """Materials, order, count and substrate."""
        return (*(int(m) for m in self.media[: self.layers]), -self.substrate)


@dataclass
class _Island:
    """The best stack of each structure, and the arrays that `breed` reads."""

    slots: int
    items: dict[tuple[int, ...], _Candidate] = field(default_factory=dict)
    still: int = 0
    best: float = np.inf

    def take(self, found: Iterable[_Candidate]) -> None:
        """Add candidates, and keep the best structures."""
        for one in found:
            held = self.items.get(one.key)
            if held is None or one.score < held.score:
                self.items[one.key] = one
        if len(self.items) > POOL:
            ordered = sorted(self.items.values(), key=lambda c: c.score)[:POOL]
            self.items = {c.key: c for c in ordered}
        best = min((c.score for c in self.items.values()), default=np.inf)
        self.still = 0 if best < (1.0 - GAIN) * self.best else self.still + 1
        self.best = min(best, self.best) if self.still else best

    def ordered(self) -> list[_Candidate]:
        """Return the candidates, best first."""
        return sorted(self.items.values(), key=lambda c: c.score)

    def brood(self) -> tuple[Population, int]:
        """Return them as arrays, best first, and how many."""
        return _as_brood(self.ordered(), self.slots)


def _as_brood(candidates: Sequence[_Candidate], slots: int) -> tuple[Population, int]:
    pool = empty_population(max(len(candidates), 1), slots + 3)
    for i, c in enumerate(candidates):
        pool.score[i], pool.layers[i], pool.substrate[i] = c.score, c.layers, c.substrate
        pool.media[i, : c.layers], pool.d[i, : c.layers] = c.media[: c.layers], c.d[: c.layers]
    return pool, len(candidates)


def _candidates(brood: Population, count: int) -> list[_Candidate]:
    return [
        _Candidate(
            float(brood.score[i]),
            brood.media[i].copy(),
            brood.d[i].copy(),
            int(brood.layers[i]),
            int(brood.substrate[i]),
        )
        for i in range(count)
    ]


class _Engine:
    """A problem in compiled form, on the coarse and on the full grid."""

    def __init__(self, problem: StackProblem, jobs: int | None = None) -> None:
        self.problem = problem
        self.slots = problem.layers
        self.space = problem.space()
        self.samples = problem.coarse()
        self.tables, self.fine_tables = problem.tables(self.samples), problem.tables()
        self.jobs = available_jobs() if jobs is None else max(1, jobs)
        self.aim(problem.goals)

    def aim(self, goals: MeritFunction) -> None:
        """Take other goals of the same rows."""
        self.goals = goals
        self.coarse_goals = goals.on(self.samples)
        self.looks, self.fine_looks = compile_merit(self.coarse_goals, MARGIN), compile_merit(goals, MARGIN)
        n = self.slots + 3
        self.spaces = [workspace(self.tables, self.looks, n) for _ in range(self.jobs)]
        self.fine_spaces = [workspace(self.fine_tables, self.fine_looks, n) for _ in range(self.jobs)]

    def finish(self, one: _Candidate, worker: int = 0) -> _Candidate:
        """Descend on all wavelengths; the same stack where nothing is gained."""
        media, d = one.media.copy(), one.d.copy()
        low, high = np.zeros(self.slots + 3), np.zeros(self.slots + 3)
        for j in range(one.layers):
            low[j], high[j] = self.space.low[j, media[j]], self.space.high[j, media[j]]
        score = one.score
        powers = (2.0, WORST_POWER, 3.0 * WORST_POWER) if len(self.fine_looks.kind) > 1 else (2.0,)
        for p in powers:
            score = descend(
                self.fine_tables,
                self.fine_looks,
                media,
                d,
                low,
                high,
                one.layers,
                one.substrate,
                float(self.space.total[0]),
                FINISH_STEPS,
                p,
                self.fine_spaces[worker],
            )
        return _Candidate(float(score), media, d, one.layers, one.substrate)

    def spectra(self, one: _Candidate) -> Array:
        """Return `[row, wavelength]` on all wavelengths."""
        rows, _, samples = self.fine_tables.turns_r.shape
        seen, none = np.zeros((rows, samples)), np.zeros((rows, 1, samples))
        spectra_and_gradients(
            self.fine_tables, one.media, one.d, one.layers, one.substrate, False, scratch(one.layers), seen, none
        )
        return seen

    def solution(self, one: _Candidate) -> StackSolution:
        """Name a candidate and judge it by the goals themselves."""
        names = [m.name for m in self.problem.media()]
        d = self.goals.distances(self.spectra(one))
        made = self.made(one) if self.problem.has_spread else None
        return StackSolution(
            tuple(names[m - 1] for m in one.media[: one.layers]),
            one.d[: one.layers].copy(),
            names[one.substrate - 1],
            d,
            float(self.goals.objective(d)),
            made,
        )

    def settle(self, one: _Candidate, until: float) -> _Candidate:
        """Shift a stack's thicknesses by chance so that more of its made samples meet all wants, to the time `until`.

        The search ranks by the slopes at a stack's own thicknesses; here each step is judged by the samples themselves.
        """
        rng = np.random.default_rng(SETTLING_SEED)
        best, share, n = one, self.made(one, SETTLING_SEED), one.layers
        low, high = (bound[np.arange(n), one.media[:n]] for bound in (self.space.low, self.space.high))
        size, smallest = SETTLING_SIZE
        for _ in range(SETTLING_STEPS):
            if not 0.0 < share < 1.0 - MADE or time.monotonic() > until:
                break
            d = best.d.copy()
            d[:n] = np.clip(d[:n] * np.exp(size * rng.normal(size=n)), low, high)
            keep_total(d, low, n, float(self.space.total[0]))
            step = dataclasses.replace(best, d=d)
            found = self.made(step, SETTLING_SEED)
            size = 1.3 * size if found > share else max(0.93 * size, smallest)
            if found > share:
                best, share = step, found
        return best

    def made(self, one: _Candidate, seed: int = YIELD_SEED) -> float:
        """Return the share of made samples within all tolerances, of `YIELD_DRAWS` on the coarse grid."""
        layers = one.layers
        sigma = np.hypot(self.space.relative[:layers] * one.d[:layers], self.space.absolute[:layers])
        rng = np.random.default_rng(seed)
        rows, _, samples = self.tables.turns_r.shape
        seen, none, w = np.zeros((YIELD_DRAWS, rows, samples)), np.zeros((rows, 1, samples)), scratch(layers)
        for out, z in zip(seen, rng.normal(size=(YIELD_DRAWS, self.slots))):
            d = np.maximum(one.d[:layers] + sigma * z[:layers], 0.0)
            spectra_and_gradients(self.tables, one.media, d, layers, one.substrate, False, w, out, none)
        within = np.array([self.goals.goals[g].tolerance for g, _ in self.goals.terms])
        return float(np.mean(np.all(self.coarse_goals.distances(seen) <= within, axis=-1)))


def is_alike(one: StackSolution, other: StackSolution) -> bool:
    """Whether two answers count as one: same materials and substrate, no thickness off by more than 20 %."""
    if (one.materials, one.substrate) != (other.materials, other.substrate):
        return False
    larger = np.maximum(one.thicknesses_nm, other.thicknesses_nm)
    return bool(np.all(np.abs(one.thicknesses_nm - other.thicknesses_nm) <= ALIKE * larger))


def search(
    problem: StackProblem,
    seconds: float = 60.0,
    solutions: int = 5,
    seed: int = 0,
    on_progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
    jobs: int | None = None,
) -> list[StackSolution]:
    """Find stacks that look as wanted, best first.

    Ends when all goals are within a fifth of `within`, or at `seconds` by the clock. The best is as good as was
    found; the others differ from each other in material, order, count or a thickness by more than 20 %. What a seed
    gives depends on the machine only through how far it comes in the time, and on `jobs`.

    Args:
        solutions: how many at most.
        on_progress: called after every round.
        stop: asked after every round; True ends the search with the best so far.
        jobs: threads; by default as many as this process may use.

    Raises:
        NacreError: seconds that are not positive.
    """
    if not seconds > 0.0:
        raise NacreError(f"seconds = {seconds:g} is not allowed; it must be above 0")
    begun = time.monotonic()
    engine = _Engine(problem, jobs)
    hall = _explore(engine, seconds, seed, on_progress, stop, begun)
    return choose(engine, hall, solutions, begun + seconds)


def _explore(engine: _Engine, seconds: float, seed: int, on_progress: Any, stop: Any, begun: float) -> list[_Candidate]:
    """Breed until the goals are reached or the time is over; return all islands' best."""
    outs = [empty_population(LITTER, engine.slots + 3) for _ in range(engine.jobs)]
    done: list[_Candidate] = []
    island, islands, rounds, children = _Island(engine.slots), 1, 0, 0
    robust = engine.problem.has_spread
    end, target = (MADE, 0.0) if robust else (REACHED, 0.9 * REACHED)
    pool, size = island.brood()
    # no children: what is not compiled yet is compiled here, and the search keeps half of its time all the same
    evolve(engine.tables, engine.looks, engine.space, pool, size, 0, FRESH, target, 0, engine.spaces[0], outs[0])
    begun = max(begun, time.monotonic() - (1.0 - COMPILED_SHARE) * seconds)
    # where few layers are preferred, the first island has one, the next two, and so on
    fewest = engine.problem.fewest and engine.problem.slots is None
    space = _shorter(engine.space, 1) if fewest else engine.space
    end_of_time = (ROBUST_SHARE if robust else PLAIN_SHARE) * seconds
    with ThreadPoolExecutor(engine.jobs) as threads:
        while True:
            pool, size = island.brood()
            seeds = np.random.SeedSequence([seed, rounds]).generate_state(engine.jobs)
            futures = [
                threads.submit(
                    evolve,
                    engine.tables,
                    engine.looks,
                    space,
                    pool,
                    size,
                    LITTER,
                    FRESH,
                    target,
                    int(seeds[k]),
                    engine.spaces[k],
                    outs[k],
                )
                for k in range(engine.jobs)
            ]
            counts = [f.result() for f in futures]
            island.take(c for k, n in enumerate(counts) for c in _candidates(outs[k], n))
            rounds += 1
            children += LITTER * engine.jobs
            spent = time.monotonic() - begun
            best = min(island.best, min((c.score for c in done), default=np.inf))
            if on_progress is not None:
                near = min([*island.ordered()[:1], *done], key=lambda c: c.score)
                on_progress(Progress(spent, children, best, functools.partial(engine.solution, near)))
            if spent >= end_of_time or (stop is not None and stop()):
                break
            if island.best <= end and (robust or _is_reached(engine, island.ordered()[0])):
                break
            share = LADDER_SHARE * islands / engine.slots if fewest and islands < engine.slots else 1.0
            if island.still >= STILL_LITTERS or spent >= share * end_of_time:
                done += island.ordered()[:FINISHED]
                islands += 1
                island = _Island(engine.slots)
                if fewest and islands <= engine.slots:
                    space = _shorter(engine.space, islands)
                elif islands % MERGE_EVERY == 0:
                    island.take(done)
                    island.still = 0
    return done + island.ordered()


def _shorter(space: Space, layers: int) -> Space:
    return space._replace(
        choices=space.choices[:layers],
        choice_count=space.choice_count[:layers],
        low=space.low[:layers],
        high=space.high[:layers],
        relative=space.relative[:layers],
        absolute=space.absolute[:layers],
        draws=np.ascontiguousarray(space.draws[:, :layers]),
    )


def _is_reached(engine: _Engine, one: _Candidate) -> bool:
    return engine.finish(one).score <= REACHED


def choose(engine: _Engine, hall: Sequence[_Candidate], solutions: int, until: float) -> list[StackSolution]:
    """Finish the best candidates on all wavelengths and return those that differ, best first, by the time `until`."""
    ordered = sorted({id(c): c for c in hall}.values(), key=lambda c: c.score)
    robust = engine.problem.has_spread
    # a last descent would leave the middle of what may be made
    first = ordered[: 2 * solutions + 2 if robust else max(FINISHED, 4 * solutions)]
    finished = [engine.solution(c if robust else engine.finish(c)) for c in first]
    if robust:
        most = max(range(len(first)), key=lambda i: finished[i].yield_share or 0.0, default=None)
        if most is not None:
            finished.append(engine.solution(engine.settle(first[most], until)))
        finished.sort(key=lambda s: (-(s.yield_share or 0.0), s.objective))
    elif engine.problem.fewest:
        equal = max(REACHED, min((s.objective for s in finished), default=np.inf) + EQUAL_LOOKS)
        finished.sort(key=lambda s: (max(s.objective, equal), len(s.materials), s.objective))
    else:
        finished.sort(key=lambda s: s.objective)
    chosen: list[StackSolution] = []
    for one in finished:
        if len(chosen) < solutions and not any(is_alike(one, other) for other in chosen):
            chosen.append(one)
    return chosen


def many(
    problem: StackProblem,
    goals_list: Sequence[MeritFunction],
    seed: int = 0,
    jobs: int | None = None,
    on_progress: Callable[[int, StackSolution], None] | None = None,
    which: Sequence[int] | None = None,
) -> list[StackSolution]:
    """Find a stack for each of many goals that look at the same rows under the same lamps, with all else shared.

    Draws are made and looked at once; each goal starts from those nearest to it, and breeds only if their descents
    do not reach it. No clock is asked: a seed gives the same answers everywhere.

    Args:
        goals_list: colours as in `problem.goals`, in the same order of rows and lamps.
        on_progress: called with the number of each goal and its answer, from threads.
        which: numbers of the goals that are asked for, whose answers are as if all were; default: all.

    Raises:
        NacreError: goals that are no colours, or of another shape.
    """
    engine = _Engine(problem, 1)
    workers = available_jobs() if jobs is None else max(1, jobs)
    terms = len(engine.looks.kind)
    for goals in goals_list:
        if any(goal.kind != "colour" for goal in goals.goals) or len(goals.terms) != terms:
            raise NacreError("many designs share one set of draws: each needs the same wants, of colours")
    draws = empty_population(SHARED_DRAWS, engine.slots + 3)
    labs = np.zeros((SHARED_DRAWS, terms, 3))
    first = int(np.random.SeedSequence([seed, 0]).generate_state(1)[0])
    draw_many(engine.tables, engine.looks, engine.space, first, engine.spaces[0], draws, labs)
    numbers = iter(range(len(goals_list)) if which is None else which)
    found: list[StackSolution | None] = [None] * len(goals_list)

    def work() -> None:
        own = _Engine(problem, 1)
        for i in numbers:
            own.aim(goals_list[i])
            found[i] = one = own.solution(_from_draws(own, draws, labs, seed, i))
            if on_progress is not None:
                on_progress(i, one)

    with ThreadPoolExecutor(workers) as threads:
        futures = [threads.submit(work) for _ in range(workers)]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            for _ in numbers:
                pass  # what an error or an interrupt leaves over is not begun
        for future in futures:
            future.result()
    return [one for one in found if one is not None]


def local_metric(lab: Array) -> Array:
    """Return `[..., 3, 3]` whose product with a small difference from `lab` `[..., 3]` has the length of its dE00."""
    step = 1e-3
    columns = [difference_components(lab, lab + step * axis) / step for axis in np.eye(3)]
    return np.stack(columns, axis=-1)


def _from_draws(engine: _Engine, draws: Population, labs: Array, seed: int, number: int) -> _Candidate:
    looks, s = engine.looks, engine.spaces[0]
    best, at = np.empty(MANY_STARTS), np.zeros(MANY_STARTS, dtype=np.int64)
    nearest(labs, looks.lab, local_metric(looks.lab), looks.scale, best, at)
    island = _Island(engine.slots)
    low, high = np.zeros(engine.slots + 3), np.zeros(engine.slots + 3)
    target = 0.5 * REACHED
    total = float(engine.space.total[0])
    for k in at:
        layers, substrate = int(draws.layers[k]), int(draws.substrate[k])
        media, d = draws.media[k].copy(), draws.d[k].copy()
        for j in range(layers):
            low[j], high[j] = engine.space.low[j, media[j]], engine.space.high[j, media[j]]
        score = descend(engine.tables, looks, media, d, low, high, layers, substrate, total, 20, 2.0, s)
        island.take([_Candidate(float(score), media, d, layers, substrate)])
        if score < target and (done := engine.finish(island.ordered()[0])).score < target:
            return done
    out = empty_population(MANY_LITTER, engine.slots + 3)
    for turn in range(MANY_ROUNDS):
        pool, size = island.brood()
        own = int(np.random.SeedSequence([seed, 1 + number, turn]).generate_state(1)[0])
        n = evolve(engine.tables, looks, engine.space, pool, size, MANY_LITTER, FRESH, target, own, s, out)
        island.take(_candidates(out, n))
        if island.best < target and (done := engine.finish(island.ordered()[0])).score < target:
            return done
    return min((engine.finish(c) for c in island.ordered()[:4]), key=lambda c: c.score)
