"""Colour assignment to pixels: nearest colour with hue-preserving clipping, and error diffusion.

Nearest means by CIEDE2000. An unreachable pixel is mapped to the nearest colour with its hue ("hue-angle preserving
minimum dE clipping", CIE 156:2004), unless another colour is much closer. If a process makes only a few
levels, mixtures of neighbouring pixels are additive and span a solid in XYZ: colours are mapped into the solid, then
dithered by error diffusion (Floyd and Steinberg 1976) in serpentine order.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.light import delta_e_2000, lab_to_xyz, xyz_to_lab
from nacre.optimise.thin_film.merit_kernel import components

NEIGHBOURS = 12  # nearest colours in the uniform space, from which the descent starts
CELL = 0.5  # cell side in the uniform space; colours in one cell share their starts
CANDIDATES, BATCH = 256, 4096  # levels compared with each colour, and colours at once
STRIDES = (8, 4, 2, 1)  # descent strides over the grid
HUE_STEP = 1.0  # largest dE00 hue term between colours with equal hue
WEDGES = 180  # hue wedges with common starts
MIN_CHROMA = 2.0  # pixels below count as grey
HUE_COST = 2.0  # largest additional dE00 for preserving the hue
ANY_HUE = -1.0

LATTICE, MARGIN = 2.0, 8.0  # lattice step and margin, CIELAB
BISECTIONS = 12
MAX_MIXED = 12  # largest level count for listed mixtures
PLANE_TOLERANCE = 1e-9  # solid face tolerance, XYZ
MAX_DIFFUSED = 0.5  # relative to white; bounds the error diffused from unreachable colours
BLUR_PIXELS = 2.0  # Gaussian width for comparing dithered pictures

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Match:
    """Reachable colour assigned to every picture colour.

    Attributes:
        points: `[colour]`, assigned index in the flattened grid.
        distance: `[colour]`, dE00 between both.
        nearest: `[colour]`, dE00 to the nearest colour, any hue.
        is_mapped: `[colour]`, whether `nearest` exceeds the tolerance.
        keeps_hue: `[colour]`, whether both have the same hue, or one is grey.
    """

    points: Indices
    distance: Array
    nearest: Array
    is_mapped: NDArray[np.bool_]
    keeps_hue: NDArray[np.bool_]


def match_colours(targets: Array, grid: Array, tolerance: float, keep_hue: bool = True) -> Match:
    """Assign to each target colour `[colour, 3]` a colour from a reachable grid, both CIELAB.

    Args:
        grid: `[value, 3]` or `[value, value, 3]`; smooth, or small enough for a nearest-neighbour search.
        tolerance: dE00 below which a colour counts as reached.
        keep_hue: whether unreachable colours are mapped at constant hue.
    """
    from scipy.spatial import cKDTree

    rows, columns = (*grid.shape[:-1], 1)[:2]
    reachable = np.ascontiguousarray(grid.reshape(-1, 3))
    targets = np.ascontiguousarray(targets)
    even, places = uniform_space(reachable), uniform_space(targets)
    few, _ = _one_per_cell(even)
    representatives, group = _one_per_cell(places)
    starts = _nearest(cKDTree(even[few]), few, places[representatives], NEIGHBOURS)
    points, nearest = _descend(targets, group, starts, reachable, rows, columns, np.full(len(targets), ANY_HUE))
    distance, is_mapped = nearest.copy(), nearest > tolerance
    has_hue = np.hypot(places[:, 1], places[:, 2]) >= MIN_CHROMA
    chosen = np.flatnonzero(is_mapped & has_hue & ~has_same_hue(targets, reachable[points]))
    if keep_hue and len(chosen):
        groups, inverse = np.unique(group[chosen], return_inverse=True)
        starts = _starts_by_hue(places[representatives[groups]], even, few)
        step = np.full(len(chosen), HUE_STEP)
        matched, off = _descend(targets[chosen], inverse, starts, reachable, rows, columns, step)
        good = off <= nearest[chosen] + HUE_COST
        points[chosen[good]], distance[chosen[good]] = matched[good], off[good]
    return Match(points, distance, nearest, is_mapped, has_same_hue(targets, reachable[points]))


def nearest_colours(targets: Array, levels: Array) -> tuple[Indices, Array]:
    """Return for each target `[colour, 3]` the index of the nearest level `[level, 3]`, both CIELAB, and the dE00.

    CIEDE2000 is computed to the `CANDIDATES` levels that are nearest in the uniform space: all of a small palette.
    """
    from scipy.spatial import cKDTree

    even = uniform_space(levels)
    near = _nearest(cKDTree(even), np.arange(len(levels)), uniform_space(targets), CANDIDATES)
    best, distance = np.empty(len(targets), dtype=np.int64), np.empty(len(targets))
    for first in range(0, len(targets), BATCH):
        part = slice(first, first + BATCH)
        off = np.asarray(delta_e_2000(targets[part, None], levels[near[part]]))
        at = off.argmin(axis=1)[:, None]
        best[part], distance[part] = (np.take_along_axis(each, at, axis=1)[:, 0] for each in (near[part], off))
    return best, distance


def _one_per_cell(even: Array) -> tuple[Indices, Indices]:
    """Return one colour per uniform-space cell, and every colour's cell index."""
    cells = np.floor(even / CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    width = cells.max(axis=0) + 1
    keys = (cells[:, 0] * width[1] + cells[:, 1]) * width[2] + cells[:, 2]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)


def _nearest(tree: Any, among: Indices, places: Array, count: int) -> Indices:
    count = min(count, len(among))
    neighbours = tree.query(places, k=count)[1].reshape(len(places), count)
    return np.ascontiguousarray(among[neighbours])


def _starts_by_hue(places: Array, even: Array, few: Indices) -> Indices:
    """Return starts `[place, start]` with approximately each place's hue, by hue circle wedges."""
    from scipy.spatial import cKDTree

    starts = np.full((len(places), NEIGHBOURS), -1, dtype=np.int64)
    wedge = np.round(np.arctan2(places[:, 2], places[:, 1]) / (2.0 * np.pi) * WEDGES).astype(int) % WEDGES
    for k in np.unique(wedge):
        angle = 2.0 * np.pi * k / WEDGES
        along = even[few, 1] * np.cos(angle) + even[few, 2] * np.sin(angle)
        across = np.abs(even[few, 2] * np.cos(angle) - even[few, 1] * np.sin(angle))
        # a wedge is wider than its pixels' hue; `_descend` rejects the excess
        inside = few[(across <= HUE_STEP + np.pi / WEDGES * np.abs(along)) & (along > -HUE_STEP)]
        if len(inside):
            members = np.flatnonzero(wedge == k)
            neighbours = _nearest(cKDTree(even[inside]), inside, places[members], NEIGHBOURS)
            starts[members, : neighbours.shape[1]] = neighbours
    return starts


@compiled(error_model="numpy")
def _descend(
    targets: Array, group: Indices, starts: Indices, reachable: Array, rows: int, columns: int, hue_step: Array
) -> tuple[Indices, Array]:
    """Descend over the grid from each colour group's best start, with decreasing strides.

    Args:
        hue_step: `[colour]`, largest allowed hue term; negative: any.

    Returns:
        points `[colour]` and their dE00, infinite if no start has the hue.
    """
    points, distance = np.zeros(len(targets), dtype=np.int64), np.full(len(targets), np.inf)
    for i in range(len(targets)):
        best, least = -1, np.inf
        for point in starts[group[i]]:
            if point >= 0:
                off = _cost(targets[i], reachable[point], hue_step[i])
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
                            off = _cost(targets[i], reachable[r * columns + c], hue_step[i])
                            if off < least:
                                best, least, moved = r * columns + c, off, True
        points[i], distance[i] = best, least
    return points, distance


@compiled(error_model="numpy")
def _cost(target: Array, colour: Array, hue_step: float) -> float:
    """CIEDE2000; infinite if the hue differs."""
    x, y, z = components(target[0], target[1], target[2], colour[0], colour[1], colour[2])
    off = math.sqrt(x * x + y * y + z * z)
    return off if hue_step < 0.0 or _hue_term(target, colour) <= hue_step else np.inf


@compiled(error_model="numpy")
def _hue_term(lab: Array, other: Array) -> float:
    """dE00 hue term, 2 sqrt(C1 C2) sin(dh / 2) / S_H, without the hue weights in S_H."""
    mean = 0.5 * (math.hypot(lab[1], lab[2]) + math.hypot(other[1], other[2]))
    stretch = 1.5 - 0.5 * math.sqrt(mean**7 / (mean**7 + 6103515625.0))
    a, u = lab[1] * stretch, other[1] * stretch
    c, d = math.hypot(a, lab[2]), math.hypot(u, other[2])
    # (2 sqrt(C1 C2) sin(dh / 2))^2 = 2 (C1 C2 - a . b)
    return math.sqrt(max(2.0 * (c * d - (a * u + lab[2] * other[2])), 0.0)) / (1.0 + 0.0075 * (c + d))


@compiled(error_model="numpy")
def _same_hues(lab: Array, other: Array) -> Any:
    found = np.empty(len(lab), dtype=np.bool_)
    for i in range(len(lab)):
        found[i] = _hue_term(lab[i], other[i]) <= HUE_STEP
    return found


def has_same_hue(lab: Array, other: Array) -> NDArray[np.bool_]:
    """Whether the dE00 hue term between colours `[colour, 3]` is at most one unit; greys match any hue.

    Example: (50, 20, 0) and (50, 5, 0) match; (50, 20, 0) and (50, 0, 20) do not.
    """
    is_same: NDArray[np.bool_] = _same_hues(np.ascontiguousarray(lab), np.ascontiguousarray(other))
    return is_same


def uniform_space(lab: Array) -> Array:
    """Return CIELAB coordinates whose Euclidean distance approximates CIEDE2000.

    Integrates dL / S_L and dC / C-weight and stretches a* near grey (Sharma, Wu and Dalal 2005). The rotation
    in the blue and the hue weights are neglected.
    """
    level = np.linspace(0.0, 200.0, 2001)
    weight = 1.0 + 0.015 * (level - 50.0) ** 2 / np.sqrt(20.0 + (level - 50.0) ** 2)
    steps = 0.5 * (1.0 / weight[1:] + 1.0 / weight[:-1]) * np.diff(level)
    lightness = np.interp(lab[..., 0], level, np.concatenate([[0.0], np.cumsum(steps)]))
    chroma7 = np.hypot(lab[..., 1], lab[..., 2]) ** 7
    a = lab[..., 1] * (1.5 - 0.5 * np.sqrt(chroma7 / (chroma7 + 25.0**7)))
    chroma = np.hypot(a, lab[..., 2])
    share = np.where(chroma > 0.0, np.log1p(0.045 * chroma) / 0.045 / np.maximum(chroma, 1e-12), 1.0)
    return np.stack([lightness, share * a, share * lab[..., 2]], axis=-1)


def map_into_solid(
    targets: Array, levels_xyz: Array, white: Array, tolerance: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Map CIELAB colours `[colour, 3]` into the convex hull around the levels' XYZ `[level, 3]`.

    A colour outside is mapped to the lattice point in the solid that `match_colours` assigns, and from there as far as
    possible towards the target.

    Returns:
        the colours `[colour, 3]`, and whether each moved by more than the tolerance.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        planes = ConvexHull(levels_xyz).equations
    except (QhullError, ValueError):  # levels on a line or in a plane
        mixtures = np.asarray(xyz_to_lab(_mixtures(levels_xyz), white))
        flat = mixtures[match_colours(targets, mixtures, tolerance).points]
        return flat, np.asarray(delta_e_2000(targets, flat) > tolerance)

    def is_inside(lab: Array) -> Any:
        return np.all(lab_to_xyz(lab, white) @ planes[:, :3].T + planes[:, 3] <= PLANE_TOLERANCE, axis=-1)

    outside = np.flatnonzero(~is_inside(targets))
    corners = np.asarray(xyz_to_lab(levels_xyz, white))
    # the margin allows for CIELAB's nonlinearity: mixtures may be slightly more colourful than their components
    low, high = corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN
    axes = [np.arange(np.floor(a / LATTICE), np.ceil(b / LATTICE) + 1.0) * LATTICE for a, b in zip(low, high)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = np.concatenate([lattice[is_inside(lattice)], corners])
    starts = lattice[match_colours(targets[outside], lattice, tolerance).points]
    good, bad = np.zeros(len(outside)), np.ones(len(outside))
    for _ in range(BISECTIONS):
        middle = 0.5 * (good + bad)
        works = is_inside(starts + middle[:, None] * (targets[outside] - starts))
        good, bad = np.where(works, middle, good), np.where(works, bad, middle)
    mapped = targets.copy()
    mapped[outside] = starts + good[:, None] * (targets[outside] - starts)
    return mapped, np.asarray(delta_e_2000(targets, mapped) > tolerance)


def _mixtures(levels: Array) -> Array:
    """Return XYZ for mixtures with up to three (selected) levels, in steps by 1/16."""
    some = levels[np.unique(np.linspace(0, len(levels) - 1, MAX_MIXED).astype(int))]
    shares = np.array([(a, b, 16 - a - b) for a in range(17) for b in range(17 - a)]) / 16.0
    ends = itertools.combinations_with_replacement(range(len(some)), 3)
    return np.concatenate([levels, *(shares @ some[list(three)] for three in ends)])


def dither(targets_xyz: Array, levels_xyz: Array, white: Array) -> Indices:
    """Return each pixel's level for `[row, column, 3]`, by error diffusion.

    Args:
        levels_xyz: `[level, 3]`.
        white: XYZ white point.
    """
    even = np.ascontiguousarray(uniform_space(xyz_to_lab(levels_xyz, white)))
    lightness = uniform_space(np.stack([np.linspace(0.0, 200.0, 2001), *np.zeros((2, 2001))], axis=-1))[:, 0]
    levels = np.ascontiguousarray(levels_xyz)
    levels_used: Indices = _diffuse(np.array(targets_xyz, float), levels, even, np.asarray(white, float), lightness)
    return levels_used


@compiled(error_model="numpy")
def _diffuse(targets: Array, levels: Array, even: Array, white: Array, lightness: Array) -> Any:
    rows, columns = targets.shape[0], targets.shape[1]
    chosen = np.zeros((rows, columns), dtype=np.int64)
    left = np.zeros((2, columns + 2, 3))
    here, place = np.empty(3), np.empty(3)
    for row in range(rows):
        ahead = 1 if row % 2 == 0 else -1
        this, below = row % 2, 1 - row % 2
        left[below] = 0.0
        for step in range(columns):
            column = step if ahead > 0 else columns - 1 - step
            for k in range(3):
                over = min(max(left[this, column + 1, k], -MAX_DIFFUSED), MAX_DIFFUSED)
                here[k] = targets[row, column, k] + over
            _place(here, white, lightness, place)
            best, least = 0, np.inf
            for j in range(len(even)):
                x, y, z = even[j, 0] - place[0], even[j, 1] - place[1], even[j, 2] - place[2]
                off = x * x + y * y + z * z
                if off < least:
                    best, least = j, off
            chosen[row, column] = best
            for k in range(3):
                over = here[k] - levels[best, k]
                left[this, column + 1 + ahead, k] += over * 7.0 / 16.0
                left[below, column + 1 - ahead, k] += over * 3.0 / 16.0
                left[below, column + 1, k] += over * 5.0 / 16.0
                left[below, column + 1 + ahead, k] += over / 16.0
    return chosen


@compiled(error_model="numpy")
def _place(xyz: Array, white: Array, lightness: Array, place: Array) -> None:
    """Write an XYZ colour's `uniform_space` coordinates to `place`; negative values count as 0."""
    f = np.empty(3)
    for k in range(3):
        t = max(xyz[k] / white[k], 0.0)
        f[k] = math.exp(math.log(t) / 3.0) if t > 216.0 / 24389.0 else t * 841.0 / 108.0 + 4.0 / 29.0
    level = min(max(116.0 * f[1] - 16.0, 0.0), 199.99) * 10.0
    low = int(level)
    place[0] = lightness[low] + (level - low) * (lightness[low + 1] - lightness[low])
    a, b = 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])
    chroma7 = math.hypot(a, b) ** 7
    a *= 1.5 - 0.5 * math.sqrt(chroma7 / (chroma7 + 6103515625.0))
    chroma = math.hypot(a, b)
    share = math.log(1.0 + 0.045 * chroma) / 0.045 / chroma if chroma > 1e-12 else 1.0
    place[1], place[2] = share * a, share * b


def blurred(xyz: Array) -> Array:
    """Return a picture `[row, column, 3]` at a distance from which pixels are not resolved."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(xyz, (BLUR_PIXELS, BLUR_PIXELS, 0.0), mode="nearest"))
