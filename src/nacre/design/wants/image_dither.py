"""A picture from the few levels of a process: neighbouring pixels share what one of them cannot show.

Light adds, so the colours that fields of a few levels show from afar fill the solid that the levels span in XYZ. What
is wanted is first brought into that solid, at its hue; then each pixel takes the level nearest to it, and what is left
over goes to pixels that are not yet decided (Floyd and Steinberg 1976), row by row to and fro.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.design.wants.image_match import even_space, match
from nacre.light import delta_e_2000, lab_to_xyz, xyz_to_lab
from nacre.matter.jit import compiled

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
