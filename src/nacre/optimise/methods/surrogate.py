"""What walks told of a likeness: how far off its guess is, here and at places of much the same light."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.parallel import in_threads, single_threaded_blas
from nacre.families.contract import Surrogate, surrogate_radiance
from nacre.light import delta_e_2000, lamp_lines_nm, with_lamp_lines
from nacre.material.material import Material
from nacre.measure.evaluate import DEFAULT_SAMPLES, evaluate_with_error
from nacre.optimise.evaluation import geometries_of, rank
from nacre.optimise.measurement import Geometry, aspecular_pairs, search_wavelengths
from nacre.optimise.merit import MeritFunction
from nacre.optimise.methods.least_squares import APART, FAR_OFF, MET, QUIET_SHARE, Pool, TimeIsUp, apart, descend
from nacre.optimise.methods.local_minima import BasinHopping
from nacre.optimise.parameters import point_of
from nacre.optimise.sparsify import changes_of, draws, removable_tables, tables_kept, values_of
from nacre.optimise.targets import merit_function
from nacre.optimise.task import DesignTask
from nacre.recipe.paths import is_within

ALIKE = 0.1  # mean difference of the logarithms of two guesses, within which the walks at their places tell the same
MOST_FACTOR = 10.0  # by which a correction is trusted to grow
KNOWN_ERROR = 0.01  # of what a likeness knows: it is computed on coarser tables than the walk


@dataclass(frozen=True, eq=False)
class Correction:
    """What a walk told at one place.

    Attributes:
        rest: `[row, wavelength]`, factors beyond what is known.
        guess: `[row, wavelength]`, what the likeness said of them.
    """

    rest: Array
    guess: Array

    def of(self, known: Array, guess: Array) -> Array:
        """Return the factors of another place."""
        ratio = np.where(self.guess > 1e-9, guess / np.maximum(self.guess, 1e-9), 1.0)
        return np.asarray(known + self.rest * np.clip(ratio, 0.0, MOST_FACTOR))


@dataclass
class Told:
    """All walks of a search.

    Attributes:
        off: by what share the likeness' guess is off, as a standard deviation; None: not known.
        walks: their number, guess, rest and its error at each place.
    """

    off: float | None
    walks: list[tuple[int, Array, Array, Array]] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Places that were walked at."""
        return len(self.walks)

    def told(self, walks: int, known: Array, guess: Array, rest: Array, error: Array) -> tuple[Array, Array]:
        """Take a walk; return the rest at its place and its error, by this and all others and by the guess itself.

        Each had its own seed: together they are quieter than one alone. Walks and guess count each as it is sure of
        itself.

        Args:
            walks: their number.
            known, guess: `[row, wavelength]`, of the likeness there.
            rest, error: `[row, wavelength]`, what the walk says beyond what is known.
        """
        self.walks.append((walks, guess, rest, error))
        found, off = self._pooled(guess)
        if self.off is None:
            return found, off
        own = (self.off * guess) ** 2 + (KNOWN_ERROR * known) ** 2
        share = own / np.maximum(own + off**2, 1e-30)
        return guess + share * (found - guess), np.sqrt(share) * off

    def _pooled(self, guess: Array) -> tuple[Array, Array]:
        """Return what the walks at places of much the same light say of the rest at the last one, and its error."""
        total, rest, square = 0.0, np.zeros_like(guess), np.zeros_like(guess)
        floor = np.maximum(guess, 1e-9)
        for walks, other, found, error in self.walks:
            apart = float(np.mean(np.abs(np.log(floor / np.maximum(other, 1e-9)))))
            weight = walks * np.exp(-((apart / ALIKE) ** 2))
            scale = np.where(other > 1e-9, floor / np.maximum(other, 1e-9), 1.0)
            total += weight
            rest += weight * scale * found
            square += (weight * scale * error) ** 2
        return rest / total, np.sqrt(square) / total


__all__ = ["Correction", "Told"]


# Fewer wavelengths for a search to find its way by, where they tell the colours too.

FEW_NM = np.linspace(400.0, 700.0, 14)  # enough for the colours of flakes of spread thickness, at half the time
CHECKED, OFF = 3, 1.0  # places where they are compared with all wavelengths; of `within`: what they may be off


def tolerances_of(target: DesignTask, rows: Sequence[Geometry]) -> Array:
    """Return `[row]`, the least `within` over weight of the wants at each geometry."""
    return np.array([min(w.tolerance / w.weight for w in target.targets if w.geometry == at) for at in rows])


def wavelength_subset(
    target: DesignTask,
    rows: Sequence[Geometry],
    whole: tuple[Array, MeritFunction],
    places: Sequence[Array],
    spectra: Callable[[Array, Array], Array | None],
) -> tuple[Array, MeritFunction]:
    """Return wavelengths and the goals on them: few where their colours are near those of all.

    Args:
        target: what is wanted.
        rows: its geometries.
        whole: all wavelengths, and the goals on them.
        places: that are looked at to find out, the first of them.
        spectra: of a place on wavelengths, `[row, wavelength]`; None where it cannot be computed.
    """
    grid, goals = whole
    if FEW_NM[0] < grid[0] or FEW_NM[-1] > grid[-1] or any(want.spectrum is not None for want in target.targets):
        return whole  # a wanted spectrum is compared on all of its wavelengths
    few, light = FEW_NM, target.spec.light
    for lamp in light.illuminants:
        few = with_lamp_lines(few, lamp) if len(lamp_lines_nm(lamp)) else few
    if len(few) >= len(grid):
        return whole
    of_few = merit_function(target.targets, rows, light, few)
    for place in places[:CHECKED]:
        here, there = spectra(place, few), spectra(place, grid)
        if here is None or there is None:
            return whole
        if np.any(delta_e_2000(of_few.labs(here), goals.labs(there)).max(axis=-1) > OFF * tolerances_of(target, rows)):
            return whole
    return few, of_few


__all__ = ["tolerances_of", "wavelength_subset"]


# The search of what is a random walk but has a smooth likeness: pearls, in the geometries of the trade.

SCOUT_SHARE, REFINE_SHARE = 0.2, 0.45  # of the time
RANKED = 72  # of the scouts, by the fine likeness
SETTLING_STEPS = 3
FINE_SHARE = 0.75  # of the time, for scouts and descents
STARTS, STARTS_OF_A_SET, KEPT_STARTS = 6, 2, 3
GOOD = 0.5  # rms over `within` of a valley that is settled at once
DESCENTS, SCOUT_WALKS, REACH_OF_START = 2, 8192, 0.35
STEPS, STEP = 10, 1e-3
REACH = 0.2  # of the bounds: how far a walk is trusted to tell how far off the likeness is
TELL_EVERY_S = 0.3
LEAST = 1e-4  # of its bounds: what may be 0 is not nearer to it unless it is 0
FEW_WALKS, MOST_WALKS = 1 << 15, 1 << 17
SETTLINGS = 12
LOUD_SHARE = 0.2  # of the objective: the noise of a place's colours that says enough of it
GAIN, MOST_IDLE = 0.95, 3  # of the objective: so many steps that leave more, and the next valley has its turn
SHORTER = 0.4  # times the reach, after a step that the walk finds worse
WORSE = 1.6  # times the rms of the best start: what is not settled
POOR = 4.0  # an objective beyond which a valley must go down quickly, or is left
UNSEEN = 0.5  # times the best that was walked, where that is poor: what the likeness alone promises is an answer too
HOPELESS = 20.0  # times the best of before
SETTLED = 5e-3  # of the bounds: a step that no longer counts
SMALL = 0.1  # of its bounds: an amount that it is tried to do without
WITHOUT = 0.05  # of `within`: what that may cost
ROUNDS_WITHOUT_GAIN = 6


class SurrogateSearch:
    """The search of one target.

    Args:
        target: of a material that has a likeness, with aspecular wants only.
        seed: of draws and walks.
    """

    def __init__(self, target: DesignTask, seed: int) -> None:
        self.target, self.parameters, self.seed = target, target.parameters, seed
        self.material = target.material
        light = target.spec.light
        self.rows = geometries_of(target.targets)
        self.grid = np.asarray(search_wavelengths(self.material, light.illuminants), dtype=float)
        self.goals: MeritFunction = merit_function(target.targets, self.rows, light, self.grid)
        self.wi, self.wo = aspecular_pairs(self.rows)
        self.drops = removable_tables(self.parameters, self.material)
        self.pool = Pool(4 * target.spec.search.solutions)
        self.best, self.best_changes = np.inf, dict[str, Any]()
        self._best_rank = (np.inf, 0, np.inf)
        self.noise = np.inf  # of the best, over `within`
        self.evaluations = self.walks = 0
        self._correction: Correction | None = None
        self._told = Told(self.material.model.surrogate_error if isinstance(self.material.model, Surrogate) else None)
        self._deadline = np.inf
        self._tell: Callable[[float, dict[str, Any]], None] | None = None
        self._likely = (np.inf, np.zeros(0))  # best by likeness alone, should no walk end there in time
        self._is_fine = False
        self._last_told = -np.inf

    @single_threaded_blas()  # its candidates would each find out anew how many there are
    def run(
        self,
        seconds: float,
        tell: Callable[[float, dict[str, Any]], None] | None = None,
        known: Sequence[Mapping[str, Any]] = (),
    ) -> str:
        """Search; return why it ended: "met", "time" or "interrupted".

        Args:
            seconds: of wall time.
            tell: called with the objective and the changes of every better answer, and now and then.
            known: answers of an earlier run, tried first.
        """
        begun = time.monotonic()
        self._deadline, self._tell = begun + seconds, tell
        try:
            starts = [place for place in map(self._place_of, known) if place is not None]
            own = self._own()
            if starts:
                self._settle(starts[0])
                if self._is_met() and len(self.pool.answers) >= self.target.spec.search.solutions:
                    return "met"
            else:
                self._walk(own, FEW_WALKS)
            generator = np.random.default_rng([self.seed, 4])
            idle = 0
            while idle < ROUNDS_WITHOUT_GAIN:
                turn = time.monotonic()
                places = self._scout(generator, [*starts, self._allowed(own)], turn + SCOUT_SHARE * seconds)
                before = self.best
                is_sure = self._told.off is not None
                share = FINE_SHARE if is_sure else SCOUT_SHARE + REFINE_SHARE
                refined = self._explore(places, turn + share * seconds)
                if self._is_met() and len(self.pool.answers) >= self.target.spec.search.solutions:
                    return "met"
                for rms, place in refined:
                    if rms > WORSE * refined[0][0] + MET:
                        continue
                    self._settle(place)
                    has_all = len(self.pool.answers) >= self.target.spec.search.solutions
                    if self._is_met() and (has_all or time.monotonic() - begun > 0.5 * seconds):
                        return "met"
                idle = 0 if self.best < 0.98 * before else idle + 1
                starts, own = [], generator.random(len(own))  # another round looks elsewhere
        except TimeIsUp:
            pass
        except KeyboardInterrupt:
            return "interrupted"
        return "met" if self._is_met() else "time"

    def _is_met(self) -> bool:
        return self.best <= MET + QUIET_SHARE

    def answers(self) -> list[tuple[float, dict[str, Any]]]:
        """Return answers that differ from one another, the best first: of equal looks, those of the fewest tables."""
        self.pool.offer(self.best, self.best_changes)
        if self._likely[0] < UNSEEN * self.best and self.best > POOR:
            self.pool.offer(self._likely[0], self._changes(self._likely[1]))
        return sorted(self.pool.answers, key=lambda a: rank(a[0], tables_kept(self.material, self.parameters, a[1])))

    def _own(self) -> Array:
        units = []
        for number in self.parameters:
            try:
                unit = number.unit(self.material.get(number.path))
            except (NacreError, KeyError, IndexError):
                unit = None
            units.append(0.5 if unit is None else unit)
        return self._allowed(np.array(units, dtype=float))

    def _place_of(self, changes: Mapping[str, Any]) -> Array | None:
        values = values_of(self.material, self.parameters, changes)
        if values is None:
            return None
        return point_of(
            self.parameters, {number.path: value for number, value in zip(self.parameters, values, strict=True)}
        )

    def _allowed(self, place: Array) -> Array:
        """Return a place where what may be 0 is 0 or well above it."""
        found = place.copy()
        for i, holder in self.drops.items():
            found[i] = 0.0 if found[i] < LEAST else found[i]
            if found[i] == 0.0:  # what is in a table that is gone makes no difference between places
                found[[j for j, n in enumerate(self.parameters) if j != i and is_within(n.path, holder)]] = 0.5
        return found

    def _changes(self, place: Array) -> dict[str, Any]:
        return changes_of(
            self.material, self.parameters, [n.value(u) for n, u in zip(self.parameters, place, strict=True)]
        )

    def _made(self, place: Array) -> Material:
        return self.material.vary(self._changes(place))

    def _check_time(self) -> None:
        if time.monotonic() > self._deadline:
            raise TimeIsUp

    def spectra(self, place: Array, grid: Array | None = None) -> Array | None:
        """Return `[row, wavelength]` of a candidate by its likeness, set right; None where it cannot be computed."""
        self._check_time()
        self.evaluations += 1
        try:
            model = self._made(place).model
            found = surrogate_radiance(model, self.wi, self.wo, self.grid if grid is None else grid, self._is_fine)
        except (NacreError, ArithmeticError):
            return None
        if found is None:
            return None
        known, guess = np.pi * found[0], np.pi * found[1]
        spectra = known + guess if self._correction is None else self._correction.of(known, guess)
        return spectra if np.all(np.isfinite(spectra)) else None

    def _mean(self, place: Array) -> float:
        """Return the rms of weight x distance / within by the likeness: far off it says more than the worst."""
        spectra = self.spectra(place)
        self._report()
        if spectra is None:
            return FAR_OFF
        distances = self.goals.distances(spectra)
        self._likely = min(self._likely, (float(self.goals.objective(distances)), place), key=lambda pair: pair[0])
        return float(np.sqrt(np.mean((distances * self.goals.scale) ** 2)))

    def _likeness(self, place: Array) -> float:
        spectra = self.spectra(place)
        if spectra is None:
            return FAR_OFF
        objective = float(self.goals.objective(self.goals.distances(spectra)))
        self._likely = min(self._likely, (objective, place), key=lambda pair: pair[0])
        self._report()
        return objective

    def _report(self) -> None:
        """Tell how far the search is, now and then."""
        if self._tell is not None and time.monotonic() - self._last_told > TELL_EVERY_S:
            self._last_told = time.monotonic()
            self._tell(self.best, self.best_changes)

    def _walk(self, place: Array, walks: int) -> tuple[float, float]:
        """Walk at a place, keep what that says of the likeness; return the objective and its noise over `within`."""
        self._check_time()
        self._is_fine = True  # what a walk sets right
        self.walks += walks
        try:
            model = self._made(place).model
            seed = self.seed + self._told.count
            assert isinstance(model, Surrogate)
            found = model.estimate_radiance(self.wi, self.wo, self.grid, walks, seed)
            if found is None:
                found = evaluate_with_error(
                    model.bsdf(self.grid), self.wi, self.wo, samples=max(walks // 4, DEFAULT_SAMPLES), seed=seed
                )  # type: ignore[assignment]  # its error is None only of what is no walk
            likeness = surrogate_radiance(model, self.wi, self.wo, self.grid, True)
        except (NacreError, ArithmeticError):
            return FAR_OFF, 0.0
        assert found is not None and likeness is not None
        known, guess = np.pi * likeness[0], np.pi * likeness[1]
        error = np.zeros_like(guess) if found[1] is None else np.pi * found[1]
        rest, error = self._told.told(walks, known, guess, np.pi * found[0] - known, error)
        self._correction = Correction(rest, guess)
        factors = known + rest
        objective = float(self.goals.objective(self.goals.distances(factors)))
        noise = self._noise(factors, error)
        # a lucky draw of few walks is none better than a quiet one
        here = rank(objective + noise, sum(place[i] > 0.0 for i in self.drops))
        if here < self._best_rank:
            self._best_rank = here
            self.best, self.best_changes, self.noise = objective + noise, self._changes(place), noise
        self.pool.offer(objective + noise, self._changes(place))
        if self._tell is not None:
            self._tell(self.best, self.best_changes)
        return objective, noise

    def _noise(self, factors: Array, error: Array) -> float:
        """Return the noise of the colours as dE00, over `within` of their wants, at worst."""
        moved = delta_e_2000(self.goals.labs(factors), self.goals.labs(factors + error)).max(axis=-1)
        return float(np.max(moved / tolerances_of(self.target, self.rows)))

    def _scout(self, generator: np.random.Generator, known: Sequence[Array], until: float) -> list[Array]:
        """Return places, the best first, by the likeness."""
        self._correction, self._is_fine = None, False  # what was told of one place is not true of them all
        judged = [(self._mean(place), place) for place in known]
        for place in draws(generator, self.parameters, self.drops):
            place = self._allowed(place)
            judged.append((self._mean(place), place))
            if time.monotonic() > until:
                break
        judged.sort(key=lambda pair: pair[0])
        return [place for _, place in judged]

    def _explore(self, places: Sequence[Array], until: float) -> list[tuple[float, Array]]:
        """Go down from the best places that are not one; return (rms over `within` by the walk, place), best first.

        How far the likeness is off differs from place to place: each descent has a walk of its own, and does not go far
        on what that told.
        """
        begun: list[Array] = []
        found: list[tuple[float, Array]] = []
        self._is_fine = True
        if self._told.off is not None:
            return self._descend_finely(places, until)
        for place in places:
            alike = [other for other in begun if self._kept(other) == self._kept(place)]
            if not apart(place, begun, APART) or len(alike) >= STARTS_OF_A_SET:
                continue
            begun.append(place)
            here, tried = place, []
            for _ in range(DESCENTS):
                self._walk(here, SCOUT_WALKS)
                tried.append((self._mean(here), here))
                here = self._refine(here, 0, REACH_OF_START)[1]
            self._walk(here, SCOUT_WALKS)
            tried.append((self._mean(here), here))
            found.append(min(tried, key=lambda pair: pair[0]))
            if len(begun) >= STARTS or time.monotonic() > until:
                break
        found.sort(key=lambda pair: pair[0])
        return [
            pair
            for k, pair in enumerate(found)
            if all(np.max(np.abs(pair[1] - other)) >= APART for _, other in found[:k])
        ][:KEPT_STARTS]

    def _descend_finely(self, places: Sequence[Array], until: float) -> list[tuple[float, Array]]:
        """As `_explore`, by a likeness that needs no walk; a good valley is settled before the next one is tried."""
        lengths = [
            j for j, n in enumerate(self.parameters) if n.path.endswith("_nm") and not n.choices and not n.is_whole
        ]
        low = np.array([LEAST if j in self.drops else 0.0 for j in range(len(self.parameters))])
        valleys = BasinHopping(self._residuals, self._numbers, low, lengths, self._with_less, self._kept)
        self._correction = None
        whole = self.grid, self.goals
        best = np.inf
        found: list[tuple[float, Array]] = []
        try:
            self.grid, self.goals = wavelength_subset(self.target, self.rows, whole, places, self.spectra)
            valleys.begin(places[:RANKED])
            for run in valleys.run(until):
                rms = self._mean(run.place)
                found.append((rms, run.place))
                if rms > max(GOOD, min(POOR, GAIN * best)):
                    continue
                best = min(best, rms)
                few, (self.grid, self.goals) = (self.grid, self.goals), whole
                if rms <= GOOD:
                    self._settle(run.place)
                    if self._is_met():
                        break
                else:
                    self._walk(run.place, FEW_WALKS)  # the best so far, should the time end
                self.grid, self.goals = few
                self._correction = None
            found += [(self._mean(run.place), run.place) for run in valleys.open if run.slopes is not None]
        finally:
            self.grid, self.goals = whole
        found.sort(key=lambda pair: pair[0])
        for rms, place in found[1 : self.target.spec.search.solutions]:
            if rms <= POOR and not self._is_met():
                self._walk(place, FEW_WALKS)  # one of the other answers
        return found[:KEPT_STARTS]

    def _residuals(self, place: Array) -> Array | None:
        spectra = self.spectra(place)
        self._report()
        return None if spectra is None else np.asarray(self.goals.residuals(spectra))

    def _with_less(self, place: Array) -> list[Array]:
        """Return a place without any one of what may be left out, as far as anything is left."""
        there = [i for i in self.drops if place[i] > 0.0]
        found = []
        for i in there if len(there) > 1 else []:
            fewer = place.copy()
            fewer[i] = 0.0
            found.append(self._allowed(fewer))
        return found

    def _kept(self, place: Array) -> tuple[bool, ...]:
        return tuple(bool(place[i] > 0.0) for i in self.drops)

    def _numbers(self, place: Array) -> list[int]:
        """Return which numbers may be refined: none of a table that is gone."""
        gone = [holder for i, holder in self.drops.items() if place[i] == 0.0]
        return [
            j
            for j, n in enumerate(self.parameters)
            if not n.choices and not n.is_whole and not any(is_within(n.path, h) for h in gone)
        ]

    def _refine(self, start: Array, weightings: int = 1, reach: float = 1.0, most: int = STEPS) -> tuple[float, Array]:
        """Refine the numbers of a place by the likeness; the last steps weigh what is worst."""
        place, numbers = start.copy(), self._numbers(start)
        best = self._likeness(place)
        if not numbers or best >= FAR_OFF:
            return best, place
        low = np.array([max(LEAST if j in self.drops else 0.0, start[j] - reach) for j in numbers])
        high = np.minimum(np.maximum(start[numbers] + reach, low + 1e-3), 1.0)
        weights = np.ones(len(self.goals.terms))
        sizes = {"colour": 3, "hue": 1, "chroma": 1, "lightness": 1, "spectrum": len(self.grid)}
        blocks = [sizes[self.goals.goals[index].kind] for index, _ in self.goals.terms]
        for turn in range(1 + (weightings if len(weights) > 1 else 0)):
            is_first = turn == 0
            spread = np.repeat(weights, blocks)
            known: dict[bytes, Array] = {}  # where slopes are asked for the descent has just been

            def residuals(
                x: Array, place: Array = place, spread: Array = spread, known: dict[bytes, Array] = known
            ) -> Array:
                found = known.get(x.tobytes())
                if found is None:
                    full = place.copy()
                    full[numbers] = x
                    spectra = self.spectra(full)
                    found = np.full(len(spread), FAR_OFF)
                    if spectra is not None:
                        found = np.asarray(self.goals.residuals(spectra)) * spread
                    known[x.tobytes()] = found
                return found

            def slopes(x: Array, residuals: Callable[[Array], Array] = residuals) -> Array:
                steps = np.where(x > 0.5, -STEP, STEP)
                here, *there = in_threads(residuals, [x, *(x + steps[:, None] * np.eye(len(x)))])
                return np.stack([(r - here) / step for r, step in zip(there, steps, strict=True)], axis=1)

            found = descend(residuals, place[numbers], low=low, high=high, slopes=slopes, most=most, tolerance=1e-5)
            trial = place.copy()
            trial[numbers] = found.place
            objective = self._likeness(trial)
            # the first descent makes all distances small, not the worst one, and is believed; the others are for that
            if objective >= best * 0.999 and not is_first:
                break
            place, best = trial, objective
            spectra = self.spectra(place)
            if spectra is None or best <= MET / 2:
                break
            distances = np.asarray(self.goals.distances(spectra)) * self.goals.scale
            if distances.max() <= 1.05 * distances.mean():
                break
            weights = weights * np.sqrt(np.maximum(distances / distances.max(), 0.05))
            weights /= weights.max()
        return best, place

    def _without(self, objective: float, place: Array, small: float = SMALL) -> tuple[float, Array]:
        """Leave out, one after another, small amounts that the looks do not need."""
        for i in sorted(self.drops, key=lambda i: place[i]):
            if objective > 1.0:
                break  # what is not met may need it yet
            if not 0.0 < place[i] < small:
                continue
            trial = place.copy()
            trial[i] = 0.0
            trial = self._allowed(trial)
            cost, trial = self._refine(trial, 0)
            if cost <= max(objective, MET / 2) + WITHOUT:
                objective, place = cost, trial
        return objective, place

    def _simplify(self, objective: float, place: Array, walks: int) -> None:
        """Try an answer that meets the wants without any one of its pigments, and take what does."""
        _, fewer = self._without(objective, place, 1.0)
        if all((fewer[i] > 0.0) == (place[i] > 0.0) for i in self.drops):
            return
        self._walk(fewer, walks)

    def _settle(self, start: Array) -> None:
        """Let walk and likeness agree about a place: walk there, refine with what that says, walk again.

        A step that the walk finds worse is not taken; the next one from there is shorter. Walks are as quiet as the
        place is good: what is far off needs no more of them.
        """
        place, walks, reach = start, FEW_WALKS, REACH
        most = STEPS if self._told.off is None else SETTLING_STEPS
        objective, noise = self._walk(place, walks)
        told, best, idle = self._correction, self.best, 0
        for turn in range(SETTLINGS):
            if objective <= MET and noise <= QUIET_SHARE:
                self._simplify(objective, place, walks)
                return
            if objective > HOPELESS * max(best, 1.0) or objective >= FAR_OFF:
                return
            quiet = max(QUIET_SHARE, LOUD_SHARE * objective)
            if noise > quiet:
                walks = int(min(walks * np.clip((noise / quiet) ** 2, 1.5, 4.0), MOST_WALKS))
            self._correction = told
            _, moved = self._without(*self._refine(place, reach=reach, most=most))
            if np.max(np.abs(moved - place)) < SETTLED and noise <= quiet:
                return
            found, loud = self._walk(moved, walks)
            if found - noise - loud > objective:
                reach *= SHORTER
                if reach < SETTLED:
                    return
                continue
            if turn >= 3 and found > POOR and found > 0.8 * objective:
                return  # a valley that does not go down far enough
            idle = idle + 1 if found > GAIN * objective else 0
            if idle >= MOST_IDLE and found > 1.0:
                return
            place, objective, noise, told = moved, found, loud, self._correction


def walked_search(target: DesignTask, seed: int) -> SurrogateSearch | None:
    """Return the search for a target that has a likeness everywhere it is asked, or None."""
    if target.spec.layers is not None or any(at.kind != "aspecular" for at in geometries_of(target.targets)):
        return None
    search = SurrogateSearch(target, seed)
    try:
        probe = surrogate_radiance(
            search.material.model, search.wi, search.wo, search.grid[:: max(len(search.grid) // 3, 1)]
        )
    except NacreError:
        return None
    return None if probe is None else search


__all__ = ["SurrogateSearch", "walked_search"]
