"""Which of the colours that can be made stands for each pixel of a picture.

Nearest by CIEDE2000. A pixel that nothing comes near is mapped at its hue: of the colours whose hue is the pixel's, or
that are too grey to show one, the nearest (CIE 156:2004 recommends this mapping, "hue-angle preserving minimum dE
clipping", to compare others by). Where no such colour is at a fair distance the nearest of all stands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.design.stack_looks import components
from nacre.matter.jit import compiled

NEIGHBOURS = 12  # nearest in the even space, of which the nearest by dE00 starts the descent
CELL = 0.5  # of the even space: colours that share one are as good as one another to start from
STRIDES = (8, 4, 2, 1)  # of the descent over the sheet
HUE_STEP = 1.0  # of dE00's hue term: less is the same hue to the eye
WEDGES = 180  # of hue, in which pixels are mapped together
LEAST_CHROMA = 2.0  # below it a pixel has no hue to keep
HUE_WORTH = 2.0  # dE00 that keeping the hue may cost above the nearest colour
NO_HUE = -1.0

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Match:
    """A choice for every colour of a picture.

    Attributes:
        points: `[colour]`, index of the colour that was chosen, into the sheet made flat.
        distance: `[colour]`, dE00 between it and what was wanted.
        nearest: `[colour]`, dE00 of the nearest one, which was passed over where the hue was kept.
        is_mapped: `[colour]`, whether the nearest is farther than what counts as reached.
        keeps_hue: `[colour]`, whether the choice has the hue that was wanted, or one of them is grey.
    """

    points: Indices
    distance: Array
    nearest: Array
    is_mapped: NDArray[np.bool_]
    keeps_hue: NDArray[np.bool_]


def match(wanted: Array, sheet: Array, within: float, keep_hue: bool = True) -> Match:
    """Choose for each of the colours `[colour, 3]` one of a sheet of those that can be made, CIELAB both.

    Args:
        sheet: `[value, 3]` or `[value, value, 3]`; neighbours hardly differ, or the nearest is one of a few.
        within: dE00 up to which a colour counts as reached.
        keep_hue: whether what is out of reach is mapped at its hue.
    """
    from scipy.spatial import cKDTree

    rows, columns = (*sheet.shape[:-1], 1)[:2]
    reachable = np.ascontiguousarray(sheet.reshape(-1, 3))
    wanted = np.ascontiguousarray(wanted)
    even, places = even_space(reachable), even_space(wanted)
    few, _ = _one_a_cell(even)
    asked, group = _one_a_cell(places)
    starts = _nearest(cKDTree(even[few]), few, places[asked], NEIGHBOURS)
    none = np.full(len(wanted), NO_HUE)
    points, nearest = _choose(wanted, group, starts, reachable, rows, columns, none)
    distance, is_mapped = nearest.copy(), nearest > within
    has_hue = np.hypot(places[:, 1], places[:, 2]) >= LEAST_CHROMA
    chosen = np.flatnonzero(is_mapped & has_hue & ~has_same_hue(wanted, reachable[points]))
    if keep_hue and len(chosen):
        groups, inverse = np.unique(group[chosen], return_inverse=True)
        starts = _starts_by_hue(places[asked[groups]], even, few)
        step = np.full(len(chosen), HUE_STEP)
        found, off = _choose(wanted[chosen], inverse, starts, reachable, rows, columns, step)
        good = off <= nearest[chosen] + HUE_WORTH
        points[chosen[good]], distance[chosen[good]] = found[good], off[good]
    return Match(points, distance, nearest, is_mapped, has_same_hue(wanted, reachable[points]))


def _one_a_cell(even: Array) -> tuple[Indices, Indices]:
    """Return one colour of each cell of the even space, and of every colour which of them it shares a cell with."""
    cells = np.floor(even / CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    width = cells.max(axis=0) + 1
    keys = (cells[:, 0] * width[1] + cells[:, 1]) * width[2] + cells[:, 2]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)


def _nearest(tree: object, among: Indices, places: Array, count: int) -> Indices:
    count = min(count, len(among))
    found = tree.query(places, k=count)[1].reshape(len(places), count)  # type: ignore[attr-defined]  # scipy's tree
    return np.ascontiguousarray(among[found])


def _starts_by_hue(places: Array, even: Array, few: Indices) -> Indices:
    """Return starts `[place, start]` that have the hue of a place, or nearly: wedge by wedge of the hue circle."""
    from scipy.spatial import cKDTree

    starts = np.full((len(places), NEIGHBOURS), -1, dtype=np.int64)
    wedge = np.round(np.arctan2(places[:, 2], places[:, 1]) / (2.0 * np.pi) * WEDGES).astype(int) % WEDGES
    for k in np.unique(wedge):
        angle = 2.0 * np.pi * k / WEDGES
        along = even[few, 1] * np.cos(angle) + even[few, 2] * np.sin(angle)
        across = np.abs(even[few, 2] * np.cos(angle) - even[few, 1] * np.sin(angle))
        # the wedge is wider than any of its pixels' own; what does not have a pixel's hue is sorted out later
        kept = few[(across <= HUE_STEP + np.pi / WEDGES * np.abs(along)) & (along > -HUE_STEP)]
        if len(kept):
            mine = np.flatnonzero(wedge == k)
            found = _nearest(cKDTree(even[kept]), kept, places[mine], NEIGHBOURS)
            starts[mine, : found.shape[1]] = found
    return starts


@compiled(error_model="numpy")
def _choose(
    wanted: Array, group: Indices, starts: Indices, reachable: Array, rows: int, columns: int, hue_step: Array
) -> tuple[Indices, Array]:
    """Take the best start of each colour's group and go downhill over the sheet, in ever smaller strides.

    Args:
        hue_step: of each colour, the largest hue term that a choice may have; below 0: any.

    Returns:
        the points `[colour]` and their dE00, infinite where no start has the hue.
    """
    points, distance = np.zeros(len(wanted), dtype=np.int64), np.full(len(wanted), np.inf)
    for i in range(len(wanted)):
        best, least = -1, np.inf
        for point in starts[group[i]]:
            if point >= 0:
                off = _cost(wanted[i], reachable[point], hue_step[i])
                if off < least:
                    best, least = point, off
        if best < 0:
            continue
        for stride in STRIDES:
            moved = True
            while moved:
                moved = False
                row, column = best // columns, best % columns
                for r in (row - stride, row, row + stride):
                    for c in (column - stride, column, column + stride):
                        if 0 <= r < rows and 0 <= c < columns:
                            off = _cost(wanted[i], reachable[r * columns + c], hue_step[i])
                            if off < least:
                                best, least, moved = r * columns + c, off, True
        points[i], distance[i] = best, least
    return points, distance


@compiled(error_model="numpy")
def _cost(wanted: Array, seen: Array, hue_step: float) -> float:
    """CIEDE2000, infinite where the hue is not kept."""
    x, y, z = components(wanted[0], wanted[1], wanted[2], seen[0], seen[1], seen[2])
    off = math.sqrt(x * x + y * y + z * z)
    return off if hue_step < 0.0 or _hue_excess(wanted, seen) <= hue_step else np.inf


@compiled(error_model="numpy")
def _hue_excess(lab: Array, other: Array) -> float:
    """The hue term of dE00, 2 sqrt(C1 C2) sin(dh / 2) / S_H, of S_H without its weights of hue."""
    mean = 0.5 * (math.hypot(lab[1], lab[2]) + math.hypot(other[1], other[2]))
    stretch = 1.5 - 0.5 * math.sqrt(mean**7 / (mean**7 + 6103515625.0))
    a, u = lab[1] * stretch, other[1] * stretch
    c, d = math.hypot(a, lab[2]), math.hypot(u, other[2])
    # (2 sqrt(C1 C2) sin(dh / 2))^2 = 2 (C1 C2 - a . b)
    return math.sqrt(max(2.0 * (c * d - (a * u + lab[2] * other[2])), 0.0)) / (1.0 + 0.0075 * (c + d))


def even_space(lab: Array) -> Array:
    """Return CIELAB bent so that plain distances are some dE00: lightness and chroma run as fast as it counts them.

    The integral of dL / S_L, of dC / S_C, and the stretch of a* near grey (Sharma, Wu and Dalal 2005); the turn in
    the blue and the weights of hue are left out, so neighbours are to be judged anew.
    """
    level, slope = _lightness_table()
    lightness = np.interp(lab[..., 0], level, slope)
    chroma7 = np.hypot(lab[..., 1], lab[..., 2]) ** 7
    a = lab[..., 1] * (1.5 - 0.5 * np.sqrt(chroma7 / (chroma7 + 25.0**7)))
    chroma = np.hypot(a, lab[..., 2])
    share = np.where(chroma > 0.0, np.log1p(0.045 * chroma) / 0.045 / np.maximum(chroma, 1e-12), 1.0)
    return np.stack([lightness, share * a, share * lab[..., 2]], axis=-1)


def _lightness_table() -> tuple[Array, Array]:
    level = np.linspace(0.0, 200.0, 2001)
    weight = 1.0 + 0.015 * (level - 50.0) ** 2 / np.sqrt(20.0 + (level - 50.0) ** 2)
    steps = 0.5 * (1.0 / weight[1:] + 1.0 / weight[:-1]) * np.diff(level)
    return level, np.concatenate([[0.0], np.cumsum(steps)])


def has_same_hue(lab: Array, other: Array) -> NDArray[np.bool_]:
    """Whether the hue term of dE00 between colours `[colour, 3]` is one unit or less: greys have any hue.

    Example: (50, 20, 0) and (50, 5, 0) have; (50, 20, 0) and (50, 0, 20) have not.
    """
    found: NDArray[np.bool_] = _same_hues(np.ascontiguousarray(lab), np.ascontiguousarray(other))
    return found


@compiled(error_model="numpy")
def _same_hues(lab: Array, other: Array) -> Any:
    found = np.empty(len(lab), dtype=np.bool_)
    for i in range(len(lab)):
        found[i] = _hue_excess(lab[i], other[i]) <= HUE_STEP
    return found


__all__ = ["Match", "even_space", "has_same_hue", "match"]
