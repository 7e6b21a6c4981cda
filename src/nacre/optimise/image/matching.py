"""Which of the colours that can be made stands for each pixel of a picture.

Nearest by CIEDE2000. A pixel that nothing comes near is mapped at its hue: of the colours whose hue is the pixel's, or
that are too grey to show one, the nearest (CIE 156:2004 recommends this mapping, "hue-angle preserving minimum dE
clipping", to compare others by). Where no such colour is at a fair distance the nearest of all stands.
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


# A picture from the few levels of a process: neighbouring pixels share what one of them cannot show.

LATTICE, MARGIN = 2.0, 8.0  # of CIELAB
BISECTIONS = 12
MOST_MIXED = 12  # levels, of which mixtures are listed
INSIDE = 1e-9  # of XYZ, to which the faces of the solid are known
MOST_LEFT_OVER = 0.5  # of white: what cannot be shown anywhere near is not carried on for ever
SEEN_PIXELS = 2.0  # width of the Gaussian through which a dithered picture is compared, as from afar


def into_solid(wanted: Array, levels_xyz: Array, white: Array, within: float) -> tuple[Array, NDArray[np.bool_]]:
    """Bring colours `[colour, 3]`, CIELAB, into the solid that the levels' XYZ `[level, 3]` span.

    As `match` chooses, among the points of a lattice in the solid, and from there as far towards what was wanted as
    the solid goes.

    Returns:
        the colours `[colour, 3]`, and which of them moved by more than counts as reached.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        planes = ConvexHull(levels_xyz).equations
    except (QhullError, ValueError):  # levels on a line or in a plane: their mixtures are all there is
        mixtures = np.asarray(xyz_to_lab(_mixtures(levels_xyz), white))
        flat = mixtures[match(wanted, mixtures, within).points]
        return flat, np.asarray(delta_e_2000(wanted, flat) > within)

    def is_inside(lab: Array) -> Any:
        return np.all(lab_to_xyz(lab, white) @ planes[:, :3].T + planes[:, 3] <= INSIDE, axis=-1)

    outside = np.flatnonzero(~is_inside(wanted))
    corners = np.asarray(xyz_to_lab(levels_xyz, white))
    # mixtures are no more colourful than what is mixed but for the bend of CIELAB, for which the margin is
    low, high = corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN
    axes = [np.arange(np.floor(a / LATTICE), np.ceil(b / LATTICE) + 1.0) * LATTICE for a, b in zip(low, high)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = np.concatenate([lattice[is_inside(lattice)], corners])
    starts = lattice[match(wanted[outside], lattice, within).points]
    good, bad = np.zeros(len(outside)), np.ones(len(outside))
    for _ in range(BISECTIONS):
        middle = 0.5 * (good + bad)
        works = is_inside(starts + middle[:, None] * (wanted[outside] - starts))
        good, bad = np.where(works, middle, good), np.where(works, bad, middle)
    found = wanted.copy()
    found[outside] = starts + good[:, None] * (wanted[outside] - starts)
    return found, np.asarray(delta_e_2000(wanted, found) > within)


def _mixtures(levels: Array) -> Array:
    """Return XYZ of mixtures of up to three levels, in steps of a sixteenth; of many levels, of some of them."""
    some = levels[np.unique(np.linspace(0, len(levels) - 1, MOST_MIXED).astype(int))]
    shares = np.array([(a, b, 16 - a - b) for a in range(17) for b in range(17 - a)]) / 16.0
    ends = itertools.combinations_with_replacement(range(len(some)), 3)
    return np.concatenate([levels, *(shares @ some[list(three)] for three in ends)])


def dither(wanted_xyz: Array, levels_xyz: Array, white: Array) -> NDArray[np.int64]:
    """Return which level each pixel of `[row, column, 3]` takes, so that neighbourhoods have the colour.

    Args:
        levels_xyz: `[level, 3]`.
        white: XYZ of it; levels are compared where a distance is some dE00.
    """
    even = np.ascontiguousarray(even_space(xyz_to_lab(levels_xyz, white)))
    # lightness as the even space has it, over L*; looked up in the loop
    lightness = even_space(np.stack([np.linspace(0.0, 200.0, 2001), *np.zeros((2, 2001))], axis=-1))[:, 0]
    found: NDArray[np.int64] = _diffuse(
        np.array(wanted_xyz, dtype=float), np.ascontiguousarray(levels_xyz), even, np.asarray(white, float), lightness
    )
    return found


@compiled(error_model="numpy")
def _diffuse(wanted: Array, levels: Array, even: Array, white: Array, lightness: Array) -> Any:
    rows, columns = wanted.shape[0], wanted.shape[1]
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
                over = min(max(left[this, column + 1, k], -MOST_LEFT_OVER), MOST_LEFT_OVER)
                here[k] = wanted[row, column, k] + over
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
    """`even_space` of the CIELAB of one XYZ, into `place`; below 0 as at 0."""
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


def seen_from_afar(xyz: Array) -> Array:
    """Return a picture `[row, column, 3]` as an eye has it that does not tell pixels apart."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(xyz, (SEEN_PIXELS, SEEN_PIXELS, 0.0), mode="nearest"))


__all__ = ["dither", "into_solid", "seen_from_afar"]
