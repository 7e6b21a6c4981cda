"""Island-model genetic search of thin-film stacks on a coarse wavelength grid; the best are refined on the full grid.

An island starts from random stacks and evolves until it stagnates; then another starts, and every third is populated by
the best of all before. Materials, order and layer count change by evolution, thicknesses by descent (`genetic`,
`levenberg_marquardt`). Solutions are evaluated by the `MeritFunction` itself.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.core.jit import clock
from nacre.core.machine import available_jobs
from nacre.light import delta_e_2000_components
from nacre.matter.stack.thickness_gradient import StackTables, scratch, spectra_and_gradients, stack_tables
from nacre.optimise.merit import MeritFunction
from nacre.optimise.problem import STOP_TOL, Budget
from nacre.optimise.thin_film import genetic
from nacre.optimise.thin_film.levenberg_marquardt import descend, keep_total, workspace
from nacre.optimise.thin_film.merit_kernel import compile_merit

YIELD_DRAWS = 64  # draws in the search; common random numbers for all stacks
SEARCH_YIELD_SEED = 20
METAL_K = 0.7  # k at the middle wavelength above which layers are drawn thin: 100 nm are opaque
COARSE_NM = (384.0, 731.0)  # wavelengths beyond change colours by less than dE00 0.05
COARSE_STEPS_NM = (15.0, 10.0, 5.0)
COARSE_LIMITS_NM = (1500.0, 4000.0)  # expected optical thickness up to which the first two steps suffice


@dataclass(frozen=True, eq=False)
class Medium:
    """A material: name, and index n + ik `[wavelength]` on the grid of the merit function."""

    name: str
    n: ComplexArray


@dataclass(frozen=True)
class Slot:
    """A layer of a given stack: alternative materials and thickness bounds in nm.

    A single material and equal bounds fix the layer.
    """

    materials: tuple[str, ...]
    low_nm: float
    high_nm: float


@dataclass(frozen=True, eq=False)
class StackProblem:
    """A stack to be designed.

    Attributes:
        merit: merit function; its rows are `angles_rad`.
        palette: layer materials.
        substrates: alternatives below the layers.
        angles_rad: `[row]`, in the ambient.
        sides: `[row]`, "reflected" or "transmitted" (into the substrate), unpolarised.
        ambient: real index above, a number or `[wavelength]`.
        max_layers: largest layer count (open stack).
        bounds_nm: palette name -> (low, high) (open stack).
        slots: a given stack's layers from the top, which replace `max_layers` and `bounds_nm`.
        max_total_nm: largest total thickness.
        prefer_few_layers: whether fewer layers win at equal merit.
        relative_tolerance, absolute_tolerance_nm: thickness standard deviations, as a share and in nm:
            one number or one per slot.

    Raises:
        NacreError: contradictory values.
    """

    merit: MeritFunction
    palette: tuple[Medium, ...]
    substrates: tuple[Medium, ...]
    angles_rad: tuple[float, ...] = (0.0,)
    sides: tuple[str, ...] = ("reflected",)
    ambient: complex | Array = 1.0
    max_layers: int = 6
    bounds_nm: dict[str, tuple[float, float]] | None = None
    slots: tuple[Slot, ...] | None = None
    max_total_nm: float = float("inf")
    prefer_few_layers: bool = False
    relative_tolerance: float | tuple[float, ...] = 0.0
    absolute_tolerance_nm: float | tuple[float, ...] = 0.0

    def __post_init__(self) -> None:
        if not self.substrates:
            raise NacreError("a film needs at least one substrate")
        if self.merit.rows > len(self.angles_rad):
            raise NacreError(f"a target needs row {self.merit.rows - 1}; there are {len(self.angles_rad)} directions")
        names = [m.name for m in self.palette]
        samples = len(self.merit.wavelengths_nm)
        for medium in (*self.palette, *self.substrates):
            if np.shape(medium.n) != (samples,):
                raise NacreError(f'the index of "{medium.name}" needs {samples} values, one per wavelength')
        for name in names if self.slots is None else [n for s in self.slots for n in s.materials]:
            if name not in names:
                raise NacreError(f'"{name}" is not in the palette: {", ".join(names)}')
            low, high = self.bounds_of(name)
            if not 0.0 <= low <= high:
                raise NacreError(f'the bounds of "{name}" cross: {low:g} and {high:g} nm')
        if self.slots is None and (self.max_layers < 1 or not names):
            raise NacreError("an open stack needs a palette and max_layers >= 1")
        for slot in self.slots or ():
            if not slot.materials or not 0.0 <= slot.low_nm <= slot.high_nm:
                raise NacreError(f"a layer needs a material and bounds that do not cross: {slot}")
        if sum(s.low_nm for s in self.slots or ()) > self.max_total_nm:
            raise NacreError(f"the least thicknesses sum to more than max_total_nm = {self.max_total_nm:g}")

    def bounds_of(self, name: str) -> tuple[float, float]:
        """Return the bounds of a material's layers in nm (of an open stack)."""
        if self.slots is not None:
            return 0.0, float("inf")
        if self.bounds_nm is None or name not in self.bounds_nm:
            raise NacreError(f'no bounds for the thickness of "{name}"')
        low, high = self.bounds_nm[name]
        return float(low), float(high)

    @property
    def layers(self) -> int:
        """Largest layer count."""
        return self.max_layers if self.slots is None else len(self.slots)

    @property
    def has_tolerance(self) -> bool:
        """Whether thicknesses vary in manufacture."""
        return bool(
            np.any(np.asarray(self.relative_tolerance) > 0.0) or np.any(np.asarray(self.absolute_tolerance_nm) > 0.0)
        )

    def media(self) -> tuple[Medium, ...]:
        """Return palette and substrates, in the order of the tables after the ambient."""
        return (*self.palette, *self.substrates)

    def tables(self, samples: Any = slice(None)) -> StackTables:
        """Return the tables of all media on selected wavelengths."""
        n = np.empty((1 + len(self.media()), len(self.merit.wavelengths_nm)), dtype=complex)
        n[0] = self.ambient
        for row, medium in zip(n[1:], self.media()):
            row[:] = medium.n
        return stack_tables(
            n[:, samples], self.merit.wavelengths_nm[samples], np.asarray(self.angles_rad, dtype=float), self.sides
        )

    def space(self) -> genetic.Space:
        """Return the allowed stacks as arrays."""
        count, media = self.layers, 1 + len(self.media())
        number = {m.name: i + 1 for i, m in enumerate(self.palette)}
        wide = max([1, *(len(s.materials) for s in self.slots or ())], default=1) if self.slots else len(self.palette)
        choices = np.zeros((count, max(wide, 1)), dtype=np.int64)
        choice_count = np.zeros(count, dtype=np.int64)
        low, high = np.zeros((count, media)), np.zeros((count, media))
        for j in range(count):
            names = tuple(m.name for m in self.palette) if self.slots is None else self.slots[j].materials
            choices[j, : len(names)] = [number[name] for name in names]
            choice_count[j] = len(names)
            for name in names:
                ends = self.bounds_of(name) if self.slots is None else (self.slots[j].low_nm, self.slots[j].high_nm)
                low[j, number[name]], high[j, number[name]] = ends
        middle = len(self.merit.wavelengths_nm) // 2
        return genetic.Space(
            choices,
            choice_count,
            low,
            high,
            np.array([False, *(m.n[middle].imag > METAL_K for m in self.media())]),
            np.arange(1 + len(self.palette), media),
            np.array([self.slots is None]),
            np.array([min(self.max_total_nm, 1e9)]),
            np.array(np.broadcast_to(np.asarray(self.relative_tolerance, dtype=float), (count,))),
            np.array(np.broadcast_to(np.asarray(self.absolute_tolerance_nm, dtype=float), (count,))),
            np.random.default_rng(SEARCH_YIELD_SEED).normal(size=(YIELD_DRAWS if self.has_tolerance else 0, count)),
        )

    def coarse_samples(self) -> Any:
        """Return indices of the coarse wavelengths, as few as the expected thickness allows."""
        grid = self.merit.wavelengths_nm
        space = self.space()
        dense = np.array([1.0, *(float(np.mean(m.n.real)) for m in self.media())])
        expected = 0.0
        for j in range(self.layers):
            names = space.choices[j, : space.choice_count[j]]
            expected += float(np.mean([0.4 * min(space.high[j, m], 1e5) * dense[m] for m in names if m]))
        step = next((s for s, limit in zip(COARSE_STEPS_NM, COARSE_LIMITS_NM) if expected < limit), COARSE_STEPS_NM[-1])
        has_colour = any(goal.kind != "spectrum" for goal in self.merit.operands)
        inside = (grid >= COARSE_NM[0]) & (grid <= COARSE_NM[1]) if has_colour else np.ones(len(grid), dtype=bool)
        numbers = np.flatnonzero(inside)
        stride = max(1, int(round(step / float(np.median(np.diff(grid))))))
        chosen = numbers[::stride]
        return chosen if len(chosen) >= 16 else np.arange(len(grid))


YIELD_SEED, SETTLING_SEED = 21, 22  # the reported yield has draws of its own
SIMILAR = 0.2  # relative thickness difference within which stacks with the same materials are one solution


@dataclass(frozen=True)
class GeneticOptions:
    """Options of `search`.

    Attributes:
        population_size: structures per island.
        offspring: stacks per batch; `batches` batches, each with its own seed, are a generation.
        fresh_share: fraction of the offspring that are random stacks.
        margin: fraction of the tolerance by which target ranges are narrowed.
        search_share, robust_search_share: fraction of the budget before the refinement, without and with tolerances.
        ladder_share: fraction of the search that tries fewer layers than allowed, if few are preferred.
        stall_generations, min_gain: an island ends after so many generations with a smaller relative gain.
        merge_every: each island whose number is a multiple starts with the best stacks of all earlier ones.
        finalists, final_steps: stacks refined on all wavelengths, and steps for each.
        yield_draws: yield samples.
        stop_failure: failing share at which a search for yield ends.
        settling_steps, settling_size: random steps towards a higher yield, their first and smallest relative size.
        equal_objective: objective difference within which fewer layers win.
        shared_draws: stacks drawn for many targets together; `shared_starts` are refined per target, then
            up to `shared_generations` of `shared_offspring` follow.
    """

    population_size: int = 48
    offspring: int = 24
    batches: int = 8
    fresh_share: float = 0.1
    margin: float = 0.15
    search_share: float = 0.95
    robust_search_share: float = 0.9
    ladder_share: float = 0.5
    stall_generations: int = 30
    min_gain: float = 0.02
    merge_every: int = 3
    finalists: int = 24
    final_steps: int = 25
    yield_draws: int = 1000
    stop_failure: float = 0.01
    settling_steps: int = 150
    settling_size: tuple[float, float] = (0.02, 0.002)
    equal_objective: float = 0.1
    shared_draws: int = 60_000
    shared_starts: int = 24
    shared_offspring: int = 48
    shared_generations: int = 30


@dataclass(frozen=True, eq=False)
class StackSolution:
    """One solution.

    Attributes:
        materials: layer names from the top.
        thicknesses_nm: `[layer]`.
        substrate: name.
        d: `[term]`, distances on all wavelengths (`MeritFunction.distances`).
        objective: their `MeritFunction.objective`.
        yield_share: manufactured sample share that meet all targets, or None without tolerances.
    """

    materials: tuple[str, ...]
    thicknesses_nm: Array
    substrate: str
    d: Array
    objective: float
    yield_share: float | None = None


@dataclass
class Stack:
    """A candidate: media numbers and thicknesses, with room for more layers than it has."""

    score: float
    media: Any
    d: Array
    layers: int
    substrate: int

    @property
    def structure(self) -> tuple[int, ...]:
        """Materials, order, layer count and substrate."""
        return (*(int(m) for m in self.media[: self.layers]), -self.substrate)


@dataclass
class _Island:
    """The best stack of each structure."""

    slots: int
    options: GeneticOptions
    stacks: dict[tuple[int, ...], Stack] = field(default_factory=dict)
    stalled: int = 0
    best: float = np.inf

    def add(self, stacks: Iterable[Stack]) -> None:
        """Add stacks and keep the best structures."""
        for one in stacks:
            other = self.stacks.get(one.structure)
            if other is None or one.score < other.score:
                self.stacks[one.structure] = one
        if len(self.stacks) > self.options.population_size:
            self.stacks = {one.structure: one for one in self.ordered()[: self.options.population_size]}
        best = min((one.score for one in self.stacks.values()), default=np.inf)
        self.stalled = 0 if best < (1.0 - self.options.min_gain) * self.best else self.stalled + 1
        self.best = min(best, self.best) if self.stalled else best

    def ordered(self) -> list[Stack]:
        """Return the stacks, best first."""
        return sorted(self.stacks.values(), key=lambda one: one.score)

    def population(self) -> tuple[genetic.Population, int]:
        """Return the stacks as arrays, best first, and their number."""
        stacks = self.ordered()
        arrays = genetic.empty_population(max(len(stacks), 1), self.slots + 3)
        for i, one in enumerate(stacks):
            arrays.score[i], arrays.layers[i], arrays.substrate[i] = one.score, one.layers, one.substrate
            arrays.media[i, : one.layers], arrays.d[i, : one.layers] = one.media[: one.layers], one.d[: one.layers]
        return arrays, len(stacks)


def _stacks(population: genetic.Population, count: int) -> Iterator[Stack]:
    for i in range(count):
        media, d = population.media[i].copy(), population.d[i].copy()
        yield Stack(float(population.score[i]), media, d, int(population.layers[i]), int(population.substrate[i]))


class Engine:
    """A problem in compiled form, on the coarse and on the full grid."""

    def __init__(self, problem: StackProblem, jobs: int | None = None, options: GeneticOptions | None = None) -> None:
        self.problem = problem
        self.options = GeneticOptions() if options is None else options
        self.slots = problem.layers
        self.space = problem.space()
        self.samples = problem.coarse_samples()
        self.tables, self.fine_tables = problem.tables(self.samples), problem.tables()
        self.jobs = available_jobs() if jobs is None else max(1, jobs)
        self.aim(problem.merit)

    def aim(self, merit: MeritFunction) -> None:
        """Replace the merit function by another one on the same rows."""
        self.merit, self.coarse_merit = merit, merit.on(self.samples)
        self.compiled = compile_merit(self.coarse_merit, self.options.margin)
        self.fine_compiled = compile_merit(merit, self.options.margin)
        n = self.slots + 3
        self.workspaces = [workspace(self.tables, self.compiled, n) for _ in range(self.options.batches)]
        self.fine_workspace = workspace(self.fine_tables, self.fine_compiled, n)

    def bounds(self, one: Stack) -> tuple[Array, Array]:
        """Return the layer bounds, with room as the stack."""
        low, high = np.zeros(self.slots + 3), np.zeros(self.slots + 3)
        at = np.arange(one.layers), one.media[: one.layers]
        low[: one.layers], high[: one.layers] = self.space.low[at], self.space.high[at]
        return low, high

    def evolve(
        self, space: genetic.Space, population: genetic.Population, size: int, count: int, target: float, seed: int,
        batch: int, out: genetic.Population,
    ) -> int:  # fmt: skip
        """Fill `out` with improved offspring of a population; return their number."""
        return int(
            genetic.evolve(
                self.tables, self.compiled, space, population, size, count, self.options.fresh_share, target, seed,
                self.workspaces[batch], out,
            )
        )  # fmt: skip

    def refine(self, one: Stack, steps: int = 20) -> Stack:
        """Descend on the coarse grid, in place."""
        low, high = self.bounds(one)
        one.score = float(
            descend(
                self.tables, self.compiled, one.media, one.d, low, high, one.layers, one.substrate,
                float(self.space.total[0]), steps, 2.0, self.workspaces[0],
            )
        )  # fmt: skip
        return one

    def finish(self, one: Stack) -> Stack:
        """Return a stack refined on all wavelengths."""
        media, d, score = one.media.copy(), one.d.copy(), one.score
        low, high = self.bounds(one)
        powers = (2.0, genetic.WORST_POWER, 3.0 * genetic.WORST_POWER) if len(self.fine_compiled.kind) > 1 else (2.0,)
        for p in powers:
            score = descend(
                self.fine_tables, self.fine_compiled, media, d, low, high, one.layers, one.substrate,
                float(self.space.total[0]), self.options.final_steps, p, self.fine_workspace,
            )  # fmt: skip
        return Stack(float(score), media, d, one.layers, one.substrate)

    def spectra(self, one: Stack) -> Array:
        """Return `[row, wavelength]` on all wavelengths."""
        rows, _, samples = self.fine_tables.turns_r.shape
        factors, none = np.zeros((rows, samples)), np.zeros((rows, 1, samples))
        spectra_and_gradients(
            self.fine_tables, one.media, one.d, one.layers, one.substrate, False, scratch(one.layers), factors, none
        )
        return factors

    def solution(self, one: Stack) -> StackSolution:
        """Return a stack with names, evaluated by the merit function itself."""
        names = [m.name for m in self.problem.media()]
        d = self.merit.distances(self.spectra(one))
        return StackSolution(
            tuple(names[m - 1] for m in one.media[: one.layers]),
            one.d[: one.layers].copy(),
            names[one.substrate - 1],
            d,
            float(self.merit.objective(d)),
            self.yield_share(one) if self.problem.has_tolerance else None,
        )

    def settle(self, one: Stack, end_time: float) -> Stack:
        """Change the thicknesses by random steps that increase the yield, until a time of `core.jit.clock`.

        The search ranks by a linear estimate of the yield; here each step is evaluated by samples.
        """
        rng = np.random.default_rng(SETTLING_SEED)
        best, share, n = one, self.yield_share(one, SETTLING_SEED), one.layers
        low, high = (bound[:n] for bound in self.bounds(one))
        size, smallest = self.options.settling_size
        for _ in range(self.options.settling_steps):
            if not 0.0 < share < 1.0 - self.options.stop_failure or clock() > end_time:
                break
            d = best.d.copy()
            d[:n] = np.clip(d[:n] * np.exp(size * rng.normal(size=n)), low, high)
            keep_total(d, low, n, float(self.space.total[0]))
            step = dataclasses.replace(best, d=d)
            trial_share = self.yield_share(step, SETTLING_SEED)
            size = 1.3 * size if trial_share > share else max(0.93 * size, smallest)
            if trial_share > share:
                best, share = step, trial_share
        return best

    def yield_share(self, one: Stack, seed: int = YIELD_SEED) -> float:
        """Return the share of `yield_draws` manufactured samples that meet all targets, on the coarse grid."""
        layers, draws = one.layers, self.options.yield_draws
        sigma = np.hypot(self.space.relative[:layers] * one.d[:layers], self.space.absolute[:layers])
        rng = np.random.default_rng(seed)
        rows, _, samples = self.tables.turns_r.shape
        factors, none, w = np.zeros((draws, rows, samples)), np.zeros((rows, 1, samples)), scratch(layers)
        for out, z in zip(factors, rng.normal(size=(draws, self.slots))):
            d = np.maximum(one.d[:layers] + sigma * z[:layers], 0.0)
            spectra_and_gradients(self.tables, one.media, d, layers, one.substrate, False, w, out, none)
        tolerances = np.array([self.merit.operands[g].tolerance for g, _ in self.merit.terms])
        return float(np.mean(np.all(self.coarse_merit.distances(factors) <= tolerances, axis=-1)))


def is_alike(one: StackSolution, other: StackSolution) -> bool:
    """Whether two solutions count as one: same materials and substrate, and thicknesses within 20 %."""
    if (one.materials, one.substrate) != (other.materials, other.substrate):
        return False
    larger = np.maximum(one.thicknesses_nm, other.thicknesses_nm)
    return bool(np.all(np.abs(one.thicknesses_nm - other.thicknesses_nm) <= SIMILAR * larger))


def search(
    problem: StackProblem,
    budget: Budget | float,
    solutions: int = 5,
    seed: int = 0,
    on_progress: Callable[[float, Callable[[], StackSolution]], None] | None = None,
    stop: Callable[[], bool] | None = None,
    jobs: int | None = None,
    options: GeneticOptions | None = None,
) -> list[StackSolution]:
    """Find stacks that meet the targets, best first.

    Ends if all operands are within a fifth of their tolerances, or with the budget. Solutions differ from each other in
    material, order, layer count or by 20 % in a thickness. A seed gives the same result on any thread count.

    Args:
        budget: evaluations are stacks begun; a number is a time limit in seconds.
        solutions: at most.
        on_progress: called after every generation with the best objective (coarse grid) and a function that returns
            its solution.
        stop: called after every generation; True ends the search with the best so far.
        jobs: threads; default: as many as this process may use.

    Raises:
        NacreError: a budget that is not positive.
    """
    if not isinstance(budget, Budget):
        budget = Budget(default_evaluations(problem), budget)
    if not budget.seconds > 0.0:
        raise NacreError(f"seconds = {budget.seconds:g} is not allowed; it must be above 0")
    engine = Engine(problem, jobs, options)
    stacks = _explore(engine, budget, seed, on_progress, stop)
    return choose(engine, stacks, solutions, budget.start_time + budget.seconds)


def default_evaluations(problem: StackProblem) -> float:
    """Return a number of stacks whose evaluation takes about two minutes of one core, from the problem's size."""
    return float(np.clip(WORK / (problem.layers**1.2 * problem.merit.rows * len(problem.coarse_samples())), 1e4, 1e7))


WORK = 8e8  # layers^1.2 x rows x wavelengths of all stacks


def _explore(engine: Engine, budget: Budget, seed: int, on_progress: Any, stop: Any) -> list[Stack]:
    """Evolve until the targets are met or the budget is spent; return the best stacks of all islands."""
    options, problem = engine.options, engine.problem
    outs = [genetic.empty_population(options.offspring, engine.slots + 3) for _ in range(options.batches)]
    is_robust, done = problem.has_tolerance, list[Stack]()
    end, target = (options.stop_failure, 0.0) if is_robust else (STOP_TOL, 0.9 * STOP_TOL)
    island, islands, generation = _Island(engine.slots, options), 1, 0
    population, size = island.population()
    engine.evolve(engine.space, population, size, 0, target, 0, 0, outs[0])  # compiles the kernels
    # if few layers are preferred, the first island has one layer, the next two, and so on
    is_ladder = problem.prefer_few_layers and problem.slots is None
    space = _shortened(engine.space, 1) if is_ladder else engine.space
    limit = options.robust_search_share if is_robust else options.search_share
    with ThreadPoolExecutor(min(engine.jobs, options.batches)) as threads:
        while True:
            population, size = island.population()
            seeds = np.random.SeedSequence([seed, generation]).generate_state(options.batches)
            arguments = (space, population, size, options.offspring, target)
            futures = [
                threads.submit(engine.evolve, *arguments, int(seeds[k]), k, outs[k]) for k in range(options.batches)
            ]
            counts = [future.result() for future in futures]
            island.add(one for k, count in enumerate(counts) for one in _stacks(outs[k], count))
            generation += 1
            budget.used += options.offspring * options.batches
            best = min([*island.ordered()[:1], *done], key=lambda one: one.score, default=None)
            if on_progress is not None and best is not None:
                on_progress(best.score, functools.partial(engine.solution, best))
            if (spent := budget.share_used) >= limit or (stop is not None and stop()):
                budget.is_late = budget.used < limit * budget.evaluations
                break
            if island.best <= end and (is_robust or engine.finish(island.ordered()[0]).score <= STOP_TOL):
                break
            share = options.ladder_share * islands / engine.slots if is_ladder and islands < engine.slots else 1.0
            if island.stalled >= options.stall_generations or spent >= share * limit:
                done += island.ordered()[: options.finalists]
                islands += 1
                island = _Island(engine.slots, options)
                if is_ladder and islands <= engine.slots:
                    space = _shortened(engine.space, islands)
                elif islands % options.merge_every == 0:
                    island.add(done)
                    island.stalled = 0
    return done + island.ordered()


def _shortened(space: genetic.Space, layers: int) -> genetic.Space:
    return space._replace(
        choices=space.choices[:layers],
        choice_count=space.choice_count[:layers],
        low=space.low[:layers],
        high=space.high[:layers],
        relative=space.relative[:layers],
        absolute=space.absolute[:layers],
        draws=np.ascontiguousarray(space.draws[:, :layers]),
    )


def choose(engine: Engine, stacks: Sequence[Stack], solutions: int, end_time: float) -> list[StackSolution]:
    """Refine the best stacks on all wavelengths and return distinct ones, best first."""
    options, problem = engine.options, engine.problem
    ordered = sorted({id(one): one for one in stacks}.values(), key=lambda one: one.score)
    if problem.has_tolerance:  # a refinement would leave the tolerance region's middle
        first = ordered[: 2 * solutions + 2]
        finished = [engine.solution(one) for one in first]
        if first:
            best = max(range(len(first)), key=lambda i: finished[i].yield_share or 0.0)
            finished.append(engine.solution(engine.settle(first[best], end_time)))
        finished.sort(key=lambda s: (-(s.yield_share or 0.0), s.objective))
    else:
        first = ordered[: max(options.finalists, 4 * solutions)]
        finished = sorted((engine.solution(engine.finish(one)) for one in first), key=lambda s: s.objective)
        if problem.prefer_few_layers and finished:
            equal = max(STOP_TOL, finished[0].objective + options.equal_objective)
            finished.sort(key=lambda s: (max(s.objective, equal), len(s.materials), s.objective))
    chosen: list[StackSolution] = []
    for one in finished:
        if len(chosen) < solutions and not any(is_alike(one, other) for other in chosen):
            chosen.append(one)
    return chosen


def many(
    problem: StackProblem,
    merits: Sequence[MeritFunction],
    seed: int = 0,
    jobs: int | None = None,
    on_progress: Callable[[int, StackSolution], None] | None = None,
    which: Sequence[int] | None = None,
) -> list[StackSolution]:
    """Find a stack for each of many merit functions of the same rows and lamps.

    Random stacks are drawn once; each target starts from the nearest ones and evolves only if their descents fail.
    No time limit: a seed gives the same result everywhere.

    Args:
        merits: for colours as in `problem.merit`, with the same rows and lamps.
        on_progress: called with each merit function's number and its solution, from threads.
        which: merit function numbers to solve, with the same results as if all were; default: all.

    Raises:
        NacreError: merit functions of another shape, or not of colours only.
    """
    engine = Engine(problem, 1, GeneticOptions(batches=1))
    workers = available_jobs() if jobs is None else max(1, jobs)
    terms = len(engine.compiled.kind)
    for merit in merits:
        if any(operand.kind != "colour" for operand in merit.operands) or len(merit.terms) != terms:
            raise NacreError("many designs share one set of draws: each needs the same targets, of colours")
    draws = genetic.empty_population(engine.options.shared_draws, engine.slots + 3)
    labs = np.zeros((engine.options.shared_draws, terms, 3))
    first = int(np.random.SeedSequence([seed, 0]).generate_state(1)[0])
    genetic.draw_many(engine.tables, engine.compiled, engine.space, first, engine.workspaces[0], draws, labs)
    numbers = iter(range(len(merits)) if which is None else which)
    solutions_found: list[StackSolution | None] = [None] * len(merits)

    def work() -> None:
        own = Engine(problem, 1, engine.options)
        for i in numbers:
            own.aim(merits[i])
            solutions_found[i] = one = own.solution(_from_draws(own, draws, labs, seed, i))
            if on_progress is not None:
                on_progress(i, one)

    with ThreadPoolExecutor(workers) as threads:
        futures = [threads.submit(work) for _ in range(workers)]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            for _ in numbers:
                pass  # after an error or an interrupt the rest is not begun
        for future in futures:
            future.result()
    return [one for one in solutions_found if one is not None]


def local_metric(lab: Array) -> Array:
    """Return matrices M `[..., 3, 3]` with |M d| = dE00 for small differences d from `lab` `[..., 3]`."""
    step = 1e-3
    columns = [delta_e_2000_components(lab, lab + step * axis) / step for axis in np.eye(3)]
    return np.stack(columns, axis=-1)


def _from_draws(engine: Engine, draws: genetic.Population, labs: Array, seed: int, number: int) -> Stack:
    compiled, options = engine.compiled, engine.options
    starts = np.zeros(options.shared_starts, dtype=np.int64)
    distances = np.empty(options.shared_starts)
    genetic.nearest(labs, compiled.lab, local_metric(compiled.lab), compiled.scale, distances, starts)
    island = _Island(engine.slots, options)
    target = 0.5 * STOP_TOL
    for k in starts:
        media, d = draws.media[k].copy(), draws.d[k].copy()
        one = engine.refine(Stack(np.inf, media, d, int(draws.layers[k]), int(draws.substrate[k])))
        island.add([one])
        if one.score < target and (done := engine.finish(island.ordered()[0])).score < target:
            return done
    out = genetic.empty_population(options.shared_offspring, engine.slots + 3)
    for turn in range(options.shared_generations):
        population, size = island.population()
        own = int(np.random.SeedSequence([seed, 1 + number, turn]).generate_state(1)[0])
        count = engine.evolve(engine.space, population, size, options.shared_offspring, target, own, 0, out)
        island.add(_stacks(out, count))
        if island.best < target and (done := engine.finish(island.ordered()[0])).score < target:
            return done
    return min((engine.finish(one) for one in island.ordered()[:4]), key=lambda one: one.score)
