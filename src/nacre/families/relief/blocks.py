"""Reliefs of blocks: heights that vary along both axes between vertical walls, for the rigorous solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.families.relief.lines import MOST_LEVELS, SAME, STEEPEST
from nacre.families.relief.surface import Tile
from nacre.matter.periodic.crossed_solver import rectangle_unknowns
from nacre.matter.periodic.solve import MAX_WALLS
from nacre.matter.periodic.structure import Cell, PatternLayer, PeriodicStack, Rectangle

Mask = NDArray[np.bool_]
NARROW_NM = 5.0  # exp(-(2 pi 5 nm / 400 nm)^2) = 0.994, for the steepest exits of blue light


@dataclass(frozen=True, eq=False)
class Blocks:
    """One period of square features along both axes.

    Attributes:
        heights_nm: `[x, y]`, the smallest period, at least zero.
        feature_nm, blur_nm: width of a feature and standard deviation of its walls' blur.
    """

    heights_nm: Array
    feature_nm: float
    blur_nm: float

    @property
    def periods_nm(self) -> tuple[float, float]:
        """Periods along x and y."""
        x, y = self.heights_nm.shape
        return x * self.feature_nm, y * self.feature_nm

    @property
    def noun(self) -> str:
        """Name in messages."""
        return "blocks"

    @property
    def period_nm(self) -> float:
        """The longer period."""
        return max(self.periods_nm)

    @property
    def lattice(self) -> Array:
        """Wave vectors of the orders (1, 0) and (0, 1) over 2 pi, in 1/nm."""
        return np.diag(1.0 / np.array(self.periods_nm))

    @property
    def is_vertical(self) -> bool:
        """Whether all walls are steep, or so narrow that orders change by less than 1 %."""
        if self.blur_nm <= NARROW_NM:
            return True
        steps = [np.abs(self.heights_nm - np.roll(self.heights_nm, 1, axis=axis)) for axis in (0, 1)]
        least = min(float(step[step > 0.0].min(initial=np.inf)) for step in steps)
        return least > STEEPEST * np.sqrt(2.0 * np.pi) * self.blur_nm

    @property
    def walls(self) -> tuple[int, int]:
        """Number of places along x and along y at which some height changes."""
        changes = [np.any(self.heights_nm != np.roll(self.heights_nm, 1, axis=a), axis=1 - a) for a in (0, 1)]
        return int(changes[0].sum()), int(changes[1].sum())

    def obstacle(self, index: complex, shortest_nm: float, most: int) -> str:
        """Return why the blocks cannot be solved with `most` unknowns, or nothing.

        Args:
            index: of the body, at the shortest wavelength in the medium above.
        """
        if not self.is_vertical:
            return f"walls that a blur of {self.blur_nm:.3g} nm slopes, of heights that vary along x and y"
        if max(self.walls) > MAX_WALLS:
            return f"a period has {max(self.walls)} walls along one axis, more than {MAX_WALLS}"
        if len(np.unique(self.heights_nm)) > MOST_LEVELS:
            return f"the blocks have more than {MOST_LEVELS} heights"
        (stack,) = self.stacks(np.ones(1), np.array([index]))
        # an error is known from two sizes
        unknowns = rectangle_unknowns(stack, shortest_nm, 1)
        if unknowns > most:
            return f"a period of {self.period_nm / 1e3:.3g} um needs {unknowns} unknowns, more than {most}"
        return ""

    def layers(self, cover: complex, body: complex) -> tuple[PatternLayer, ...]:
        """Return the steps between neighbouring heights, from the top down, of two permittivities.

        The origin is in the middle of the highest blocks: a mirror symmetry there saves time.
        """
        values = np.unique(self.heights_nm)
        halves = np.kron(self.heights_nm, np.ones((2, 2)))
        for axis in (0, 1):
            halves = np.roll(halves, _to_middle((halves == values[-1]).any(axis=1 - axis)), axis)
        middle, side = [0.5 * count for count in halves.shape], 0.5 * self.feature_nm
        found = []
        for low, high in zip(values[:-1], values[1:], strict=True):
            shapes = tuple(
                (
                    Rectangle(
                        (x_0 - middle[0]) * side, (x_1 - middle[0]) * side, (y_0 - middle[1]) * side,
                        (y_1 - middle[1]) * side,
                    ),
                    body,
                )
                for x_0, x_1, y_0, y_1 in _rectangles(halves > low)
            )  # fmt: skip
            found.append(PatternLayer(float(high - low), cover, shapes))
        return tuple(reversed(found))

    def stacks(self, cover: Array, body: NDArray[np.complex128]) -> list[PeriodicStack]:
        """Return the structure for each index `[wavelength]` of the medium above (real) and of the body."""
        cell = Cell(*self.periods_nm)
        return [
            PeriodicStack(cell, float(n), self.layers(complex(n) ** 2, complex(m) ** 2), complex(m))
            for n, m in zip(cover, body, strict=True)
        ]


def _to_middle(occupied: Mask) -> int:
    """Return the shift that brings the occupied places of a period to its middle, the longest gap to its ends."""
    count = len(occupied)
    gaps = [int(np.argmax(np.append(np.roll(occupied, -k), True))) for k in range(count)]
    start = int(np.argmax(gaps))
    return -start if gaps[start] == 0 else -(start + gaps[start] // 2)


def _rectangles(mask: Mask) -> list[tuple[int, int, int, int]]:
    """Return boxes (x_0, x_1, y_0, y_1) of features that fill a mask without overlap."""
    left = mask.copy()
    found = []
    while left.any():
        x, y = (int(v) for v in np.argwhere(left)[0])
        y_1 = y + int(np.argmin(np.append(left[x, y:], False)))
        rows = np.append(left[x:, y:y_1].all(axis=1), False)
        x_1 = x + int(np.argmin(rows))
        left[x:x_1, y:y_1] = False
        found.append((x, x_1, y, y_1))
    return found


def blocks_of(tile: Tile) -> Blocks:
    """Return a tile's smallest period."""
    heights = np.asarray(tile.heights_nm, dtype=float)
    heights = heights - heights.min()
    step = SAME * max(float(np.ptp(heights)), 1e-6)
    heights = np.round(heights / step) * step
    for axis in (0, 1):
        count = heights.shape[axis]
        period = next(
            d for d in range(1, count + 1) if count % d == 0 and np.array_equal(heights, np.roll(heights, d, axis))
        )
        heights = heights.take(np.arange(period), axis=axis)
    return Blocks(heights, tile.feature_nm, tile.blur_nm)
