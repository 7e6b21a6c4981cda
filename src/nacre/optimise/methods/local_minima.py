"""How a search goes through many valleys: short descents side by side, and hops from the best to those beside it.

Lengths interfere: a coating that is half a wave thicker looks much the same, and no descent gets over the ridge
between. So along each length of a good valley the looks are scanned, and where they have another minimum a descent
begins; it also begins without any one of what may be left out. Valleys count as one where they look the same, wherever
they are: what hardly shows in the looks may have any value.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence

import numpy as np

from nacre.core.arrays import Array
from nacre.core.parallel import in_threads
from nacre.optimise.methods.broyden import Descent, go_down

HOPE = 0.3  # what the first steps down make of the rms
TRIES, GOES_ON = 6, 0.9  # steps a turn; a turn that leaves less of the squares is followed by another
SETTLED = 1e-3  # relative: a step that gains less ends a descent here; what is good is gone down further
ALIKE = 0.2  # of the smaller residuals: a difference of looks that is none
ENDS_A_HOP = 3  # new ends until the best is hopped from
SCANNED = 15  # places along a length: a tenth of a wave or so, for the usual bounds of a coating
BESIDE = 0.1  # of the bounds: what is nearer is the same minimum
STEP = 1e-3  # of the bounds, for slopes


class BasinHopping:
    """All descents of one question.

    Args:
        look: residuals of a place; None where it cannot be computed.
        numbers: which of a place may move.
        low: the least value of each number, of a place's own bounds.
        lengths: which of them interfere.
        others: places that a good one is compared to besides, such as without one of its parts.
        kind: of a place: descents are begun from all kinds, whatever they look like.
    """

    def __init__(
        self,
        look: Callable[[Array], Array | None],
        numbers: Callable[[Array], Sequence[int]],
        low: Array,
        lengths: Sequence[int],
        others: Callable[[Array], Sequence[Array]],
        kind: Callable[[Array], Hashable],
    ) -> None:
        self._look, self._numbers, self._low, self._lengths = look, numbers, low, set(lengths)
        self._others, self._kind = others, kind
        self._begun: Counter[Hashable] = Counter()
        self.open: list[Descent] = []
        self.ends: list[Descent] = []
        self._hopped: list[Descent] = []

    def begin(self, places: Sequence[Array]) -> None:
        """Add places to begin from."""
        looks = in_threads(self._look, places)
        self.open += [Descent(place, seen) for place, seen in zip(places, looks, strict=True) if seen is not None]

    def run(self, until: float) -> Iterator[Descent]:
        """Go down until a time of `time.monotonic`; yield each end that looks like no other so far."""
        since = 0
        while time.monotonic() < until:
            if since >= ENDS_A_HOP or not self.open:
                since = 0
                if not self._hop() and not self.open:
                    return
                continue
            run = self._next()
            before, numbers = run.cost, self._numbers(run.place)
            if numbers:
                go_down(
                    run,
                    self._look,
                    lambda run, numbers=numbers: self._slopes(run, numbers),
                    numbers,
                    TRIES,
                    low=self._low[numbers],
                    settled=SETTLED,
                )
            else:
                run.is_settled = True  # all that was free is left out
            if not self._is_new(run):
                continue
            if not run.is_settled and run.cost < GOES_ON * before:
                self.open.append(run)
                continue
            self.ends.append(run)
            since += 1
            yield run

    def _next(self) -> Descent:
        """Take the descent that promises most; of those to be begun every other one of the kind begun least."""
        run = min(self.open, key=lambda run: run.cost * (1.0 if run.slopes is not None else HOPE**2))
        if run.slopes is None:
            fresh = [other for other in self.open if other.slopes is None]
            if sum(self._begun.values()) % 2:
                run = min(fresh, key=lambda run: (self._begun[self._kind(run.place)], run.cost))
            self._begun[self._kind(run.place)] += 1
        self.open = [other for other in self.open if other is not run]
        return run

    def _is_new(self, run: Descent) -> bool:
        return all(
            np.sum((run.residuals - end.residuals) ** 2) > ALIKE**2 * min(run.cost, end.cost) for end in self.ends
        )

    def _hop(self) -> bool:
        """Add what lies beside the best end that was not hopped from; return whether there was one."""
        new = [end for end in self.ends if not any(end is other for other in self._hopped)]
        if not new:
            return False
        best = min(new, key=lambda end: end.cost)
        self._hopped.append(best)
        line = np.linspace(0.0, 1.0, SCANNED)
        for number in self._numbers(best.place):
            if number not in self._lengths:
                continue
            places = np.repeat(best.place[None], SCANNED, axis=0)
            places[:, number] = np.maximum(line, self._low[number])
            looks = in_threads(self._look, list(places))
            cost = np.array([np.inf if seen is None else float(np.sum(seen**2)) for seen in looks])
            around = np.concatenate([[np.inf], cost, [np.inf]])
            is_least = (cost < around[:-2]) & (cost < around[2:]) & (np.abs(line - best.place[number]) >= BESIDE)
            self.open += [Descent(places[i], seen) for i in np.flatnonzero(is_least) if (seen := looks[i]) is not None]
        self.begin(self._others(best.place))
        return True

    def _slopes(self, run: Descent, numbers: Sequence[int]) -> Array:
        """Return d residual / d place by differences, `[residual, number]`."""
        steps = np.where(run.place > 0.5, -STEP, STEP)

        def column(number: int) -> Array:
            place = run.place.copy()
            place[number] += steps[number]
            seen = self._look(place)
            return np.zeros_like(run.residuals) if seen is None else (seen - run.residuals) / steps[number]

        return np.stack(in_threads(column, numbers), axis=1)


__all__ = ["BasinHopping"]
