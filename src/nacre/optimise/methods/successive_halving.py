"""The search of materials that take long to compute, but whose looks change smoothly: metasurfaces, above all.

A candidate costs a tenth of a second and more, so that few may be tried: even draws first, looked at roughly, then
Levenberg-Marquardt from the best of them, a few steps each, of which the worse half is given up again and again. A
slope is taken by differences once and then kept up with Broyden's rank-one updates. All of it on few wavelengths; what
survives is settled on those of the judge, with slopes of the few.
"""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.contract import is_direct
from nacre.light import lamp_lines_nm, with_lamp_lines
from nacre.material.material import Material
from nacre.optimise.measurement import evaluation_wavelengths, simulate_measurement
from nacre.optimise.merit import MeritFunction
from nacre.optimise.methods.broyden import Descent, go_down
from nacre.optimise.methods.least_squares import LAST_TRIES, MET, LeastSquaresSearch, TimeIsUp
from nacre.optimise.parameters import Parameter, nominal_point, point_of, values_at
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import Target, merit_function

FEW_NM = np.linspace(400.0, 700.0, 11)  # the colours of smooth spectra between them are right to some tenths of dE00
ROUGH_NM = np.linspace(400.0, 700.0, 9)
DRAWS, DRAW_SHARE = 512, 0.15  # rough looks of a round, and their share of the time
SECOND_LOOKS, LEAST_LOOKS = 48, 12  # of them that are looked at again; at least, whatever they cost
RUNS = 12  # descents that a round begins with
FAIR_SHARE = 2  # one of so many starts goes to each of the words in turn, whatever it looks like
NEAR = 0.08  # of a free number's range: draws so near each other are one start
STEP = 1e-3  # of a free number's range, for the slopes
TRIES_OF_A_SLICE, TRIES_TO_SETTLE = 3, 10
WEIGHTINGS = 2
ENOUGH = 0.5  # of what ends the search: a descent that is so near goes no further
NEARLY = 0.7  # of `within`: who comes so near on few wavelengths is settled at once
DISTURBANCE = 0.15
REMEMBERED = 5  # looks whose time is remembered: the next one is taken to last as long as their median


@dataclass
class _Eye:
    """Wavelengths, and the goals on them; `took_s`: how long the last looks lasted."""

    grid: Array
    goals: MeritFunction
    is_rough: bool = False
    memory: dict[Any, Any] = field(default_factory=dict)
    took_s: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))


class SuccessiveHalvingSearch(LeastSquaresSearch):
    """The search of one problem whose candidates take long; arguments as of `LeastSquaresSearch`."""

    def __init__(
        self,
        material: Material,
        free: Sequence[Parameter],
        wants: Sequence[Target],
        light: LightSpec,
        seed: int,
        solutions: int,
    ) -> None:
        super().__init__(material, free, wants, light, seed, solutions)
        own = np.asarray(material.model.wavelengths_nm)
        # a wanted spectrum is compared on all of its wavelengths
        is_coarse = bool(own[0] <= FEW_NM[0] and own[-1] >= FEW_NM[-1])
        is_coarse = is_coarse and all(want.spectrum is None for want in self.targets)
        fine = np.asarray(evaluation_wavelengths(material, light.illuminants))

        def eye(grid: Array, is_rough: bool = False) -> _Eye:
            for lamp in light.illuminants:
                if len(lamp_lines_nm(lamp)):
                    grid = with_lamp_lines(grid, lamp)
            return _Eye(grid, merit_function(self.targets, self.rows, light, grid), is_rough)

        self.fine = eye(fine)
        self.few = eye(FEW_NM) if is_coarse else self.fine
        self.rough = eye(ROUGH_NM if is_coarse else fine, True)
        self.is_fine_known = False  # whether `best` is one of the fine wavelengths
        self.kept_s = 0.0  # that whoever judges the answers has of its own

    def run(
        self,
        seconds: float,
        tell: Callable[[float, dict[str, Any]], None] | None = None,
        known: Sequence[Mapping[str, Any]] = (),
    ) -> str:
        """Search; return why it ended; see `LeastSquaresSearch.run`."""
        if not self._numbers:
            return super().run(seconds, tell, known)
        begun = time.monotonic()
        self._deadline, self._tell = begun + seconds, tell
        try:
            turn = 0
            while True:
                turn += 1
                starts = self._draws(turn, time.monotonic() + DRAW_SHARE * seconds, known if turn == 1 else ())
                for run in self._tournament(starts):
                    self._settle(run)
                is_late = time.monotonic() - begun > 0.5 * seconds
                if self.best <= MET and (is_late or len(self.pool.answers) >= self.pool.most // 4):
                    return "met"
        except TimeIsUp:
            return "met" if self.best <= MET else "time"
        except KeyboardInterrupt:
            return "interrupted"

    def _look(self, place: Array, eye: _Eye) -> Array | None:
        """Return the residuals of a place, and note it where it is the best; None where it cannot be computed."""
        if self._is_late(eye) and (np.isfinite(self.best) or self.evaluations >= LAST_TRIES):
            raise TimeIsUp
        self.evaluations += not eye.is_rough
        values = values_at(self.parameters, place)
        begun = time.monotonic()
        try:
            made = self.made(values)
            seen = simulate_measurement(
                made, self.rows, eye.grid, seed=self.seed, memory=eye.memory, is_rough=eye.is_rough
            )
            spectra = seen.factors
            objective = float(eye.goals.objective(eye.goals.distances(spectra)))
            residuals = np.asarray(eye.goals.residuals(spectra))
        except (NacreError, ArithmeticError):
            return None
        eye.took_s.append(time.monotonic() - begun)
        if not (np.isfinite(objective) and np.isfinite(residuals).all()):
            return None
        if eye is self.fine and not self.is_fine_known:
            # what was found on few wavelengths is not comparable, and gives way
            self.is_fine_known, self.best, self.pool.answers = True, np.inf, []
        if eye is self.fine or (eye is self.few and not self.is_fine_known):
            self.pool.offer(objective, values)
            if objective < self.best:
                self.best, self.best_values = objective, values
        if self._tell is not None:
            self._tell(self.best, self.best_values)
        return residuals

    def _is_late(self, eye: _Eye) -> bool:
        """Whether a look would end after the time, or leave too little of it for a judgement of what was found.

        A body that is no sphere costs seconds, each wavelength anew, and who judges looks at all of them.
        """
        times = [(each, float(np.median(each.took_s))) for each in (eye, self.few, self.rough) if each.took_s]
        if not times:
            return time.monotonic() > self._deadline
        known, took = times[0]
        of_one = took / len(known.grid)
        judging = of_one * len(self.fine.grid)
        needed = of_one * len(eye.grid) + max(judging - self.kept_s, 0.0)
        return time.monotonic() + needed > self._deadline

    def _draws(self, turn: int, until: float, known: Sequence[Mapping[str, Any]]) -> list[Descent]:
        """Look at even draws roughly, at the best, the recipe's own place and known answers again; return starts."""
        from scipy.stats import qmc

        begun = time.monotonic()
        places = [place for values in known if (place := point_of(self.parameters, values)) is not None]
        own = nominal_point(self.parameters, self.material)
        if turn == 1 and own is not None:
            places.append(own)
        generator = np.random.default_rng([self.seed, turn])
        if turn > 1:  # near what was found, and anew
            for _, values in self.pool.answers[:4]:
                near = np.array([number.unit(values[number.path]) for number in self.parameters], dtype=float)
                places += [near + DISTURBANCE * generator.standard_normal(len(near)) for _ in range(4)]
        rough = []
        for place in qmc.Sobol(len(self.parameters), scramble=True, rng=generator).random(DRAWS):
            seen = self._look(place, self.rough)
            if seen is not None:
                rough.append(Descent(place, seen))
            if time.monotonic() > until:
                break
        places += [run.place for run in self._fair(rough, SECOND_LOOKS)]
        found = []
        until += until - begun
        for place in places:
            clipped = np.clip(place, 0.0, 1.0)
            seen = self._look(clipped, self.few)
            if seen is not None:
                found.append(Descent(clipped, seen))
            if time.monotonic() > until and len(found) >= LEAST_LOOKS:
                break
        apart: list[Descent] = []
        for run in self._fair(found, len(found)):
            if len(apart) < RUNS and all(np.max(np.abs(run.place - other.place)) > NEAR for other in apart):
                apart.append(run)
        return apart

    def _fair(self, runs: list[Descent], count: int) -> list[Descent]:
        """Return the best runs, after some of each of the words in turn: a rough look may misjudge a material."""
        runs = sorted(runs, key=lambda run: run.cost)
        words: dict[Any, list[Descent]] = {}
        for run in runs:
            chosen = tuple(str(n.value(u)) for n, u in zip(self.parameters, run.place, strict=True) if n.choices)
            words.setdefault(chosen, []).append(run)
        turns = [run for group in itertools.zip_longest(*words.values()) for run in group if run is not None]
        first = turns[: count // FAIR_SHARE] if len(words) > 1 else []
        return [*first, *(run for run in runs if not any(run is other for other in first))][:count]

    def _tournament(self, runs: list[Descent]) -> list[Descent]:
        """Let descents go on side by side, the better half at a time; return the last ones, the best first."""
        while len(runs) > 2:
            for run in runs:
                self._descend(run, self.few, TRIES_OF_A_SLICE)
                if self._distances(run).max() < NEARLY:
                    return [run]
            runs = sorted(runs, key=lambda run: run.cost)[: (len(runs) + 1) // 2]
            if len(runs) <= 2 or all(run.is_settled for run in runs):
                break
        return runs[:2]

    def _settle(self, run: Descent) -> None:
        """Take a descent to its end, on the wavelengths of the judge; then weigh more what is met worst."""
        self._descend(run, self.few, TRIES_TO_SETTLE)
        if self.few is not self.fine:
            seen = self._look(run.place, self.fine)
            if seen is None:
                return
            run.residuals, run.damping, run.is_settled = seen, 1e-2, False
        self._descend(run, self.fine, TRIES_TO_SETTLE)
        for _ in range(WEIGHTINGS):
            distances = self._distances(run)
            if distances.max() <= MET or distances.max() <= 1.05 * distances.mean():
                return
            weights = np.sqrt(np.maximum(distances / distances.max(), 0.05))
            before = np.ones(len(weights)) if run.weights is None else run.weights[self._first_rows()]
            run.weights = np.repeat(before * weights / (before * weights).max(), self._sizes())
            run.is_settled, run.damping = False, 1e-2
            self._descend(run, self.fine, TRIES_OF_A_SLICE)

    def _distances(self, run: Descent) -> Array:
        """Return about how far each term is, scaled: the length of its residuals."""
        parts = np.split(run.residuals, np.cumsum(self._sizes())[:-1])
        return np.array([float(np.linalg.norm(part)) for part in parts])

    def _sizes(self) -> Any:
        sizes = {"colour": 3, "hue": 1, "chroma": 1, "lightness": 1, "spectrum": len(self.fine.grid)}
        return np.array([sizes[self.goals.goals[index].kind] for index, _ in self.goals.terms])

    def _first_rows(self) -> Any:
        return np.concatenate([[0], np.cumsum(self._sizes())[:-1]])

    def _descend(self, run: Descent, eye: _Eye, tries: int) -> None:
        """Go down by damped Gauss-Newton steps, inside the bounds."""
        go_down(
            run,
            lambda place: self._look(place, eye),
            lambda here: self._slopes(here, eye),
            self._numbers,
            tries,
            is_enough=lambda: self.best <= ENOUGH * MET,
        )

    def _slopes(self, run: Descent, eye: _Eye) -> Array:
        """Return d residual / d place by differences, `[residual, number]`, always on the few wavelengths."""
        base = run.residuals
        if eye is not self.few:
            seen = self._look(run.place, self.few)
            base = run.residuals if seen is None else seen
        columns = []
        for number in self._numbers:
            step = STEP if run.place[number] <= 0.5 else -STEP
            place = run.place.copy()
            place[number] += step
            seen = self._look(place, self.few)
            columns.append(np.zeros(len(base)) if seen is None else (seen - base) / step)
        return np.stack(columns, axis=1)


def slow_search(
    material: Material, free: Sequence[Parameter], wants: Sequence[Target], light: LightSpec, seed: int, solutions: int
) -> SuccessiveHalvingSearch | None:
    """Return this search for what answers a few directions without noise; None for what is quick, or walked."""
    if not is_direct(material.model):
        return None
    return SuccessiveHalvingSearch(material, free, wants, light, seed, solutions)


__all__ = ["SuccessiveHalvingSearch", "slow_search"]
