"""How free numbers are searched, whatever the question: even draws of the bounds, then least squares from the best.

A place is a point of the unit cube of the bounds. A fit asks where the residuals to a measurement are small, a design
where those to wanted looks are; both start and refine here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000
from nacre.material.material import Material
from nacre.measure.evaluate import DEFAULT_SAMPLES
from nacre.optimise.measurement import Geometry, search_wavelengths, simulate_measurement
from nacre.optimise.merit import MeritFunction
from nacre.optimise.parameters import Parameter, nominal_point, point_of, values_at
from nacre.optimise.solutions import are_alike
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import Target, merit_function
from nacre.optimise.task import total_nm

SCOUTS_PER_NUMBER = 24
STEP = 1e-4  # of the bounds: far above rounding, far below an interference fringe
STOCHASTIC_STEP = 1e-2  # where the walk keeps its seed, and jumps all the same as paths go another way
INSIDE = 1e-6  # least squares starts within its bounds


@dataclass(frozen=True, eq=False)
class End:
    """Where a descent ended: place `[number]`, sum of squares, d residual / d place `[residual, number]`."""

    place: Array
    loss: float
    slopes: Array


def draw(numbers: int, count: int, seed: int | Sequence[int]) -> Array:
    """Return an even draw of the unit cube, `[place, number]`: a scrambled Sobol sequence, whole powers of two.

    Args:
        numbers: that are free.
        count: least number of places.
        seed: of the scrambling.
    """
    from scipy.stats import qmc

    sampler = qmc.Sobol(numbers, scramble=True, rng=np.random.default_rng(seed))
    return np.asarray(sampler.random(1 << int(np.ceil(np.log2(max(2, count))))))


def apart(place: Array, others: Sequence[Array], least: float) -> bool:
    """Whether a place differs from all others by some share of the bounds of one number at least."""
    return all(float(np.max(np.abs(place - other))) >= least for other in others)


def descend(
    residuals: Callable[[Array], Array],
    start: Array,
    *,
    step: float = STEP,
    most: int = 60,
    low: ArrayLike = 0.0,
    high: ArrayLike = 1.0,
    slopes: Callable[[Array], Array] | None = None,
    tolerance: float = 1e-8,
) -> End:
    """Refine one start by bounded least squares, a trust region of finite differences.

    Args:
        residuals: of a place `[number]`; flat. One that cannot be computed should be far off, not NaN.
        start: `[number]`, in the unit cube.
        step: of the finite differences, as a share of the bounds.
        most: steps.
        low, high: bounds in the unit cube, where they are not 0 and 1.
        slopes: in place of finite differences.
        tolerance: relative, of places and losses.
    """
    from scipy.optimize import least_squares

    begin = np.clip(start, np.asarray(low) + INSIDE, np.asarray(high) - INSIDE)
    derivative = {"diff_step": np.full(len(begin), step)} if slopes is None else {"jac": slopes}
    found = least_squares(
        residuals,
        begin,
        bounds=(low, high),
        x_scale=1.0,
        xtol=tolerance,
        ftol=tolerance,
        gtol=1e-2 * tolerance,
        max_nfev=most,
        **derivative,
    )
    return End(np.asarray(found.x), float(2.0 * found.cost), np.asarray(found.jac))


__all__ = ["End", "apart", "descend", "draw"]


# The search that knows nothing of the material: any free numbers and words of any recipe.

MET = 0.2  # of `within`: a search that is so near everywhere ends
LEAST_SCOUTS, MOST_SCOUTS = 32, 1024
SCOUT_SHARE = 0.3  # of the time
STEPS_OF_A_START, WEIGHTINGS = 40, 3
FAR_OFF = 1e3  # residual of what cannot be computed
QUIET_SHARE = 0.1  # of `within`: noise that does not disturb
SLOWEST_SHARE = 1 / 150  # of the time, for one candidate
MOST_SAMPLES = 1 << 20
DISTURBANCES = (0.03, 0.1, 0.3)
LAST_TRIES = 32  # for a first answer after the time is over
APART = 0.05  # of the bounds: starts that are not one
POOL = 4  # times the answers asked for


class TimeIsUp(Exception):
    """Raised inside an optimiser to leave it at once; what was best is kept."""


@dataclass
class Pool:
    """Answers that differ from one another, the best first: values by path, and the objective of each."""

    most: int
    answers: list[tuple[float, dict[str, Any]]] = field(default_factory=list)

    def offer(self, objective: float, values: dict[str, Any]) -> None:
        """Take an answer if it is new, or better than the one that it is like."""
        if not np.isfinite(objective) or objective >= FAR_OFF:
            return
        like = [a for a in self.answers if are_alike(a[1], values)]
        if any(a[0] <= objective for a in like):
            return
        kept = [a for a in self.answers if not any(a is other for other in like)]
        self.answers = sorted([*kept, (objective, values)], key=lambda a: a[0])[: self.most]


class LeastSquaresSearch:
    """The search of one problem.

    Args:
        material: the recipe.
        free: what may change.
        wants: what is wanted.
        light: lamps and observer.
        seed: of draws and walks.
        solutions: number of answers that are asked for.
    """

    def __init__(
        self,
        material: Material,
        free: Sequence[Parameter],
        wants: Sequence[Target],
        light: LightSpec,
        seed: int,
        solutions: int,
    ) -> None:
        self.material, self.parameters, self.targets, self.seed = material, tuple(free), tuple(wants), seed
        self.rows: list[Geometry] = list(dict.fromkeys(want.geometry for want in wants))
        widest = material.vary({n.path: n.high for n in free if not n.choices}) if self._widest_works() else material
        self.grid = search_wavelengths(widest, light.illuminants)
        self.goals: MeritFunction = merit_function(self.targets, self.rows, light, self.grid)
        self.pool = Pool(POOL * solutions)
        self.samples: int | None = None
        self.wanted_samples = 0  # with which the noise is small
        self.is_stochastic = False
        self.evaluations = 0
        self.best = np.inf
        self.best_values: dict[str, Any] = {}
        self._deadline = np.inf
        self._tell: Callable[[float, dict[str, Any]], None] | None = None
        self.most_nm: float | None = None  # of all layers together
        self._numbers = [i for i, number in enumerate(self.parameters) if not number.choices and not number.is_whole]

    def _widest_works(self) -> bool:
        try:
            self.material.vary({n.path: n.high for n in self.parameters if not n.choices})
        except NacreError:
            return False
        return True

    def run(
        self,
        seconds: float,
        tell: Callable[[float, dict[str, Any]], None] | None = None,
        known: Sequence[Mapping[str, Any]] = (),
    ) -> str:
        """Search; return why it ended: "met", "time" or "interrupted".

        Args:
            seconds: of wall time.
            tell: called with the objective and the values of every better answer, and now and then.
            known: answers of an earlier run, tried first.
        """
        begun = time.monotonic()
        self._deadline, self._tell = begun + seconds, tell
        try:
            self._settle_samples(seconds)
            if not self._numbers:
                self._rest_of_choices()
            places = self._scout(begun + SCOUT_SHARE * seconds, known) if self._numbers else []
            for start in self._starts(places):
                self._refine(start)
                if self.best <= MET and self._sharpen():
                    continue
                if self.best <= MET and len(self.pool.answers) >= self.pool.most // POOL:
                    return "met"
                if self.best <= MET and time.monotonic() - begun > 0.5 * seconds:
                    return "met"
        except TimeIsUp:
            return "met" if self.best <= MET else "time"
        except KeyboardInterrupt:
            return "interrupted"
        return "met" if self.best <= MET else "exhausted"

    def _sharpen(self) -> bool:
        """Walk four times as often and refine the best anew, until the noise is small; return whether that was done.

        What was found with more noise is no longer comparable, and gives way.
        """
        if self.samples is None or self.samples >= self.wanted_samples:
            return False
        self.samples = min(4 * self.samples, MOST_SAMPLES)
        kept = [values for _, values in self.pool.answers]
        units = [number.unit(self.best_values[number.path]) for number in self.parameters]
        self.best, self.pool.answers = np.inf, []
        for values in kept[1:]:
            place = np.array([number.unit(values[number.path]) for number in self.parameters], dtype=float)
            self.pool.offer(self._judge(place)[0], values)
        self._refine(np.array(units, dtype=float))
        return True

    def answers(self) -> list[tuple[float, dict[str, Any]]]:
        """Return answers that differ from one another, the best first."""
        self.pool.offer(self.best, self.best_values)
        return list(self.pool.answers)

    def made(self, values: Mapping[str, Any]) -> Material:
        """Return a candidate.

        Raises:
            NacreError: it cannot be, or is thicker than it may be.
        """
        made = self.material.vary(values)
        if self.most_nm is not None and total_nm(made) > self.most_nm:
            raise NacreError(f"its layers are thicker than {self.most_nm:g} nm")
        return made

    def spectra(self, place: Array) -> Array:
        """Return `[row, wavelength]` of a candidate.

        Raises:
            NacreError: it cannot be computed.
        """
        made = self.made(values_at(self.parameters, place))
        return simulate_measurement(made, self.rows, self.grid, samples=self.samples, seed=self.seed).factors

    def _judge(self, place: Array) -> tuple[float, Array | None]:
        """Return the objective of a place and its spectra, and note it where it is the best."""
        # one answer is better than none, however long the first one took to compile
        if time.monotonic() > self._deadline and (np.isfinite(self.best) or self.evaluations >= LAST_TRIES):
            raise TimeIsUp
        self.evaluations += 1
        try:
            spectra = self.spectra(place)
            objective = float(self.goals.objective(self.goals.distances(spectra)))
        except (NacreError, ArithmeticError):
            return FAR_OFF, None
        if not np.isfinite(objective):
            return FAR_OFF, None
        if objective < self.best:
            self.best, self.best_values = objective, values_at(self.parameters, place)
        if self._tell is not None:
            self._tell(self.best, self.best_values)
        return objective, spectra

    def _settle_samples(self, seconds: float) -> None:
        """Find how many walks make the noise small beside `within`, as far as the time allows."""
        place = nominal_point(self.parameters, self.material)
        place = np.full(len(self.parameters), 0.5) if place is None else place
        try:
            made = self.material.vary(values_at(self.parameters, place))
            seen = simulate_measurement(made, self.rows, self.grid, seed=self.seed)
            if seen.error is None:
                return
            begun = time.monotonic()
            simulate_measurement(made, self.rows, self.grid, seed=self.seed)
            cost = time.monotonic() - begun
        except NacreError:
            return
        self.is_stochastic = True
        noisy = self.goals.labs(seen.factors + seen.error)
        noise = np.max(delta_e_2000(self.goals.labs(seen.factors), noisy), axis=-1)
        within = np.array([min(w.tolerance / w.weight for w in self.targets if w.geometry == at) for at in self.rows])
        wanted = float(np.max(noise / (QUIET_SHARE * within))) ** 2
        affordable = max(1.0, SLOWEST_SHARE * seconds / max(cost, 1e-6))
        # in steps of four: another number of walks is another kernel, which takes seconds to compile
        steps = int(np.floor(np.log(min(wanted, affordable)) / np.log(4.0))) if min(wanted, affordable) > 0 else 0
        self.wanted_samples = int(np.clip(DEFAULT_SAMPLES * wanted, 0, MOST_SAMPLES))
        self.samples = int(np.clip(DEFAULT_SAMPLES * 4.0 ** max(steps, 0), DEFAULT_SAMPLES, MOST_SAMPLES))

    def _scout(self, until: float, known: Sequence[Mapping[str, Any]]) -> list[tuple[float, Array]]:
        """Judge known answers, the recipe's own place and an even draw; return (objective, place), best first."""
        places = [place for values in known if (place := point_of(self.parameters, values)) is not None]
        own = nominal_point(self.parameters, self.material)
        if own is not None:
            places.append(own)
        count = int(np.clip(SCOUTS_PER_NUMBER * len(self.parameters), LEAST_SCOUTS, MOST_SCOUTS))
        places += list(draw(len(self.parameters), count, [self.seed, 1]))
        judged = []
        for place in places:
            judged.append((self._judge(place)[0], place))
            self.pool.offer(judged[-1][0], values_at(self.parameters, place))
            if time.monotonic() > until:
                break
        return sorted(judged, key=lambda pair: pair[0])

    def _rest_of_choices(self) -> None:
        """Try every combination where only words and whole numbers are free and the combinations are few."""
        counts = [len(n.choices) if n.choices else int(n.high - n.low) + 1 for n in self.parameters]
        total = int(np.prod(counts, dtype=float))
        for index in range(min(total, 1 << 16)):
            picks = np.unravel_index(index, counts)
            place = np.array(
                [
                    (pick + 0.5) / count if n.choices else pick / max(count - 1, 1)
                    for n, pick, count in zip(self.parameters, picks, counts, strict=True)
                ]
            )
            self.pool.offer(self._judge(place)[0], values_at(self.parameters, place))

    def _starts(self, places: list[tuple[float, Array]]) -> Iterator[Array]:
        """Yield where to refine from: the best draws, disturbed answers, and new draws, in turn without end."""
        if not self._numbers:
            return
        generator = np.random.default_rng([self.seed, 2])
        begun: list[Array] = []
        waiting = [place for _, place in places]
        turn = 0
        while True:
            turn += 1
            if waiting and turn % 3:
                place = waiting.pop(0)
                if not apart(place, begun, APART):
                    continue
            elif self.pool.answers and turn % 2:
                values = self.pool.answers[int(generator.integers(min(len(self.pool.answers), 3)))][1]
                units = [number.unit(values[number.path]) for number in self.parameters]
                place = np.array([0.5 if unit is None else unit for unit in units])
                size = DISTURBANCES[turn % len(DISTURBANCES)]
                place = np.clip(place + size * generator.standard_normal(len(place)), 0.0, 1.0)
            else:
                draws = generator.random((8, len(self.parameters)))
                place = min(draws, key=lambda draw: self._judge(draw)[0])
            begun.append(place)
            yield place

    def _refine(self, start: Array) -> None:
        """Refine the numbers of a place; words stay. The last steps weigh what is worst."""
        place = start.copy()
        weights = np.ones(len(self.goals.terms))
        sizes: Any = self._block_sizes()
        last = np.inf
        for _ in range(1 + (WEIGHTINGS if len(weights) > 1 else 0)):
            spread = np.repeat(weights, sizes)

            def residuals(x: Array, place: Array = place, spread: Array = spread) -> Array:
                full = place.copy()
                full[self._numbers] = x
                _, spectra = self._judge(full)
                if spectra is None:
                    return np.full(len(spread), FAR_OFF)
                return np.asarray(self.goals.residuals(spectra)) * spread

            found = descend(
                residuals,
                place[self._numbers],
                step=STOCHASTIC_STEP if self.is_stochastic else STEP,
                most=STEPS_OF_A_START,
                tolerance=1e-7,
            )
            trial = place.copy()
            trial[self._numbers] = found.place
            objective, spectra = self._judge(trial)
            if spectra is None or objective >= last * 0.999:
                break
            place, last = trial, objective
            self.pool.offer(objective, values_at(self.parameters, place))
            distances = np.asarray(self.goals.distances(spectra)) * self.goals.scale
            if objective <= MET or distances.max() <= 1.05 * distances.mean():
                break
            weights = weights * np.sqrt(np.maximum(distances / distances.max(), 0.05))
            weights /= weights.max()

    def _block_sizes(self) -> Array:
        """Return how many residuals each term has."""
        sizes = {"colour": 3, "hue": 1, "chroma": 1, "lightness": 1, "spectrum": len(self.grid)}
        return np.array([sizes[self.goals.goals[index].kind] for index, _ in self.goals.terms])


__all__ = ["LeastSquaresSearch", "Pool"]
