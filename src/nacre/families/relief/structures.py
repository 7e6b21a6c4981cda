"""Reliefs as structures of the rigorous solver.

`Lines` are heights that vary along one axis, `Blocks` heights that vary along both axes between vertical walls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import erf

from nacre.core.arrays import Array
from nacre.families.relief.surface import FLAT_FROM_PERIODS, Tile
from nacre.matter.periodic.crossed_solver import rectangle_unknowns
from nacre.matter.periodic.solve import MAX_WALLS
from nacre.matter.periodic.structure import Cell, PatternLayer, PeriodicStack, Profile, Rectangle

SAME = 1e-9  # fraction of the range: heights closer than this are equal
STEEPEST = 20.0  # slope of a blurred wall above which it is solved as a vertical one
MOST_LEVELS = 16  # height levels with vertical walls
FINE_NM, FINE_STEP = 50.0, 0.15  # features and steps over the range that are samples of a curve
FINE_BLUR = 0.6  # blur, in features, at which such steps vanish
SMOOTH_BLUR = 0.3  # blur, in features, above which walls do not need a mesh of their own
WALL_WIDTH, NEAREST = 3.0, 0.45  # half width of a wall in blurs, at most in features: elements of its own
SAMPLES = 32  # points per feature at which the surface is searched for its range
MAX_PERIOD_NM = 12_000.0
MAX_SLOPING_WALLS = 12  # walls of lines that are neither vertical nor smooth
REACH = 9.0  # extent of a blurred wall, in its standard deviations


@dataclass(frozen=True, eq=False)
class Lines:
    """One period across the lines.

    Attributes:
        heights_nm: `[feature]`.
        feature_nm, blur_nm: width of a feature and standard deviation of its walls' blur.
        along_x: whether the heights vary along x (the lines lie along y).
    """

    heights_nm: Array
    feature_nm: float
    blur_nm: float
    along_x: bool

    @property
    def period_nm(self) -> float:
        """The smallest period."""
        return len(self.heights_nm) * self.feature_nm

    @property
    def lattice(self) -> Array:
        """Wave vector of the order (1, 0) over 2 pi, in 1/nm, x across the lines; the other is zero."""
        return np.array([[1.0 / self.period_nm, 0.0], [0.0, 0.0]])

    @property
    def jumps(self) -> list[tuple[float, float]]:
        """Place in nm and height in nm of each wall before blur."""
        steps = self.heights_nm - np.roll(self.heights_nm, 1)
        return [(float(i * self.feature_nm), float(steps[i])) for i in np.flatnonzero(steps)]

    @property
    def effective_blur_nm(self) -> float:
        """The blur, at least so large that the samples of a curve are not steps."""
        highest = max((abs(step) for _, step in self.jumps), default=0.0)
        is_curve = self.feature_nm <= FINE_NM and highest <= FINE_STEP * float(np.ptp(self.heights_nm))
        return max(self.blur_nm, FINE_BLUR * self.feature_nm) if is_curve else self.blur_nm

    @property
    def has_steps(self) -> bool:
        """Whether the blur is much narrower than the features."""
        return self.effective_blur_nm < SMOOTH_BLUR * self.feature_nm

    @property
    def steepest(self) -> float:
        """The largest slope of a single blurred wall."""
        return max((abs(step) for _, step in self.jumps), default=0.0) / (np.sqrt(2.0 * np.pi) * self.effective_blur_nm)

    @property
    def has_walls(self) -> bool:
        """Whether walls are so steep that they are solved as vertical ones."""
        return self.steepest > STEEPEST and len(np.unique(self.heights_nm)) <= MOST_LEVELS

    @property
    def noun(self) -> str:
        """Name in messages."""
        return "lines"

    @property
    def obstacle(self) -> str:
        """Why the lines cannot be solved by Maxwell's equations, or nothing."""
        if self.period_nm > MAX_PERIOD_NM:
            return f"the period is {self.period_nm / 1e3:.3g} um"
        if self.has_steps and not self.has_walls and len(self.jumps) > MAX_SLOPING_WALLS:
            return f"a period has {len(self.jumps)} walls, more than {MAX_SLOPING_WALLS}"
        if self.steepest > STEEPEST and not self.has_walls:
            return f"walls of more than {MOST_LEVELS} heights are steeper than {STEEPEST:g}"
        return ""

    def profile(self) -> Profile:
        """Return the blurred surface; elements end at its walls where these are narrower than the features."""
        period, walls, blur = self.period_nm, self.jumps, self.effective_blur_nm
        width = np.sqrt(2.0) * blur
        images = np.arange(-1, 2) * period if REACH * blur < period else _images(blur, period)
        start = float(self.heights_nm[-1])

        def height(t: Array) -> Array:
            x, total = np.asarray(t, dtype=float) * period, np.full(np.shape(t), start)
            for place, step in walls:
                for image in images:
                    total += step * (0.5 + 0.5 * erf((x - place - image) / width) - (image < 0.0))
            return total

        def slope(t: Array) -> Array:
            x, total = np.asarray(t, dtype=float) * period, np.zeros(np.shape(t))
            for place, step in walls:
                for image in images:
                    total += step * np.exp(-(((x - place - image) / width) ** 2))
            return np.asarray(total / (width * np.sqrt(np.pi)))

        x = np.arange(SAMPLES * len(self.heights_nm) + 1) / (SAMPLES * len(self.heights_nm))
        values = height(x)
        top, depth = float(values.max()), float(np.ptp(values))
        corners: tuple[float, ...] = ()
        if self.has_steps:
            aside = min(WALL_WIDTH * blur, NEAREST * self.feature_nm)
            places = {(place + side) / period % 1.0 for place, _ in walls for side in (-aside, 0.0, aside)}
            corners = tuple(sorted(places))
        key = ("blurred", period, blur, *self.heights_nm.tolist())
        if not corners:  # quicker by a spline, to some 1e-6 of the depth
            spline = CubicSpline(x, np.append(values[:-1], values[0]), bc_type="periodic")
            derivative = spline.derivative()
            return Profile(
                depth, (), lambda t: (spline(t) - top) / depth, lambda t: derivative(t) / depth, key
            )  # fmt: skip
        return Profile(
            depth, corners, lambda t: (height(t) - top) / depth, lambda t: slope(t) * (period / depth), key
        )  # fmt: skip

    def layers(self, cover: complex, body: complex) -> tuple[PatternLayer, ...]:
        """Return the steps between vertical walls, from the top down, of two permittivities."""
        levels = np.unique(self.heights_nm)
        count, centre = len(self.heights_nm), 0.5 * self.period_nm
        steps = []
        for low, high in zip(levels[:-1], levels[1:], strict=True):
            inside = self.heights_nm > 0.5 * (low + high)
            starts = np.flatnonzero(inside & ~np.roll(inside, 1))
            shapes = []
            for start in starts:
                length = int(np.argmin(np.roll(inside, -start)))
                x_0 = start * self.feature_nm - centre
                shapes.append((Rectangle(x_0, x_0 + length * self.feature_nm), body))
            assert count > len(starts)
            steps.append(PatternLayer(float(high - low), cover, tuple(shapes)))
        return tuple(reversed(steps))

    def stacks(self, cover: Array, body: NDArray[np.complex128]) -> list[PeriodicStack]:
        """Return the structure for each index `[wavelength]` of the medium above (real) and of the body."""
        cell = Cell(self.period_nm)
        if np.ptp(self.heights_nm) == 0.0:
            return [PeriodicStack(cell, float(n), (), complex(m)) for n, m in zip(cover, body, strict=True)]
        if self.has_walls:
            return [
                PeriodicStack(cell, float(n), self.layers(complex(n) ** 2, complex(m) ** 2), complex(m))
                for n, m in zip(cover, body, strict=True)
            ]
        profile = self.profile()
        return [PeriodicStack(cell, float(n), (), complex(m), profile) for n, m in zip(cover, body, strict=True)]


def lines_of(tile: Tile) -> Lines | None:
    """Return a tile's lines, or None if its heights vary along both axes."""
    heights = tile.heights_nm
    tolerance = SAME * max(float(np.ptp(heights)), 1e-6)
    for axis in (1, 0):
        if np.all(np.ptp(heights, axis=axis) <= tolerance):
            row = np.asarray(heights.take(0, axis=axis))
            row = np.where(np.abs(row - np.roll(row, 1)) <= tolerance, np.roll(row, 1), row)
            divisors = [d for d in range(1, len(row) + 1) if len(row) % d == 0]
            period = next(d for d in divisors if np.allclose(row, np.roll(row, d), 0.0, tolerance))
            row = row[:period] - row.min()
            is_flat = tile.blur_nm > FLAT_FROM_PERIODS * period * tile.feature_nm
            return Lines(np.zeros(1) if is_flat else row, tile.feature_nm, tile.blur_nm, axis == 1)
    return None


def _images(blur: float, period: float) -> Array:
    count = int(np.ceil(REACH * blur / period)) + 1
    return np.asarray(np.arange(-count, count + 1) * period, dtype=float)


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
            index: the body's index, at the shortest wavelength in the medium above.
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
        """Return one layer between neighbouring heights each, from the top down, with two permittivities.

        The origin is in the middle of the highest blocks: a mirror symmetry there saves time.
        """
        values = np.unique(self.heights_nm)
        halves = np.kron(self.heights_nm, np.ones((2, 2)))
        for axis in (0, 1):
            halves = np.roll(halves, _to_middle((halves == values[-1]).any(axis=1 - axis)), axis)
        middle, side = [0.5 * count for count in halves.shape], 0.5 * self.feature_nm
        steps = []
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
            steps.append(PatternLayer(float(high - low), cover, shapes))
        return tuple(reversed(steps))

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
    remaining = mask.copy()
    boxes = []
    while remaining.any():
        x, y = (int(v) for v in np.argwhere(remaining)[0])
        y_1 = y + int(np.argmin(np.append(remaining[x, y:], False)))
        rows = np.append(remaining[x:, y:y_1].all(axis=1), False)
        x_1 = x + int(np.argmin(rows))
        remaining[x:x_1, y:y_1] = False
        boxes.append((x, x_1, y, y_1))
    return boxes


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
