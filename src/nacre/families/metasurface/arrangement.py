"""From an arrangement's name, a file of points or a file of S(q) to the `Structure` that the optics reads."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import j0

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.families.metasurface.micrograph import find_particles, grey_levels
from nacre.families.metasurface.patterns import (
    Pattern,
    hard_disks,
    lattice,
    measured_pair_correlation,
    measured_structure_factor,
    nearest_distances,
    poisson_disk,
    random_sequential,
)
from nacre.families.metasurface.structure import RANGE_IN_DIAMETERS, Structure
from nacre.files import plain, why_unreadable
from nacre.recipe.cells import decoded, headings, rows
from nacre.recipe.measures import LENGTH_UNITS_NM
from nacre.recipe.model import RecipeContext

logger = logging.getLogger("nacre")

ARRANGEMENTS = ("hard-disk", "rsa", "poisson-disk", "lattice")
MEASURED_POINTS = 200_000
MAX_FILE_BYTES = 200 << 20
LEAST_POINTS = 50
FARTHEST_UM = 4.0  # that neighbours are apart: beyond, S(q) has more rings than light can tell, and takes minutes
BIN_REDUCED = 0.1  # width of the bins of a measured S, in q a


@dataclass(frozen=True)
class Arrangement:
    """What to make: a name of `ARRANGEMENTS`, density, packing, seed, and for a lattice its kind and jitter."""

    name: str
    density_per_nm2: float
    packing: float
    seed: int = 0
    lattice: str = "hexagonal"
    jitter: float = 0.1

    def pattern(self, count: int) -> Pattern:
        """Return a pattern of about `count` points.

        Raises:
            NacreError: the packing cannot be reached this way.
        """
        if self.name == "lattice":
            return lattice(count, self.density_per_nm2, self.lattice, self.jitter, self.seed)
        makers: dict[str, Callable[..., Pattern]] = {
            "hard-disk": hard_disks,
            "rsa": random_sequential,
            "poisson-disk": poisson_disk,
        }
        return makers[self.name](count, self.density_per_nm2, self.packing, self.seed)


def measured_structure(name: str, pattern: Pattern, diameter_nm: float, q_max_per_nm: float) -> Structure:
    """Measure S(q) and g(r) of a pattern and tabulate them."""
    density = len(pattern.xy_nm) / pattern.box_nm**2
    top = min(q_max_per_nm, 25.0 / diameter_nm)
    edges = np.arange(0.0, top * diameter_nm + 2 * BIN_REDUCED, BIN_REDUCED) / diameter_nm
    s = measured_structure_factor(pattern, edges)
    centres = (edges[1:] + edges[:-1]) / 2
    step = 0.01 / diameter_nm
    q = np.asarray(np.arange(int(edges[-1] / step) + 1) * step, dtype=np.float64)
    reach = min(RANGE_IN_DIAMETERS * diameter_nm, pattern.box_nm / 3.01)
    r, g = measured_pair_correlation(pattern, reach, int(40 * reach / diameter_nm))
    outside = r >= diameter_nm
    grid = np.linspace(diameter_nm, reach, 385)
    return Structure(
        name,
        float(density),
        float(diameter_nm),
        q,
        np.asarray(np.interp(q, centres, s)),
        grid,
        np.interp(grid, r[outside], g[outside]) - 1.0,
    )


def pattern_structure(context: RecipeContext, arrangement: Arrangement, q_max_per_nm: float) -> Structure:
    """Make a pattern and measure it.

    Raises:
        RecipeError: it cannot be made.
    """
    try:
        pattern = arrangement.pattern(MEASURED_POINTS)
    except NacreError as error:
        raise context.fail("monolayer.packing", arrangement.packing, f"cannot be made: {error}") from None
    a = float(np.sqrt(4 * arrangement.packing / (np.pi * arrangement.density_per_nm2)))
    return measured_structure(arrangement.name, pattern, a, q_max_per_nm)


def jittered_structure(
    context: RecipeContext, arrangement: Arrangement, diameter_nm: float, q_max_per_nm: float
) -> Structure:
    """A jittered lattice in all orientations (a polycrystal): S averaged over them; the least distance is measured.

    Raises:
        RecipeError: the jitter makes particles overlap.
    """
    pattern = arrangement.pattern(10_000)
    # Gaussian jitter has rare close pairs; one in ten thousand may be moved apart in fabrication
    nearest = np.sort(nearest_distances(pattern))
    close = float(np.mean(nearest < diameter_nm))
    if close > 1e-3:
        raise context.fail(
            "monolayer.structure.jitter",
            arrangement.jitter,
            f"makes {100 * close:.2g} % of the particles overlap; take less",
        )
    a = max(float(nearest[len(nearest) // 1000]), diameter_nm)
    return measured_structure("lattice", pattern, a, q_max_per_nm)


def points_pattern(context: RecipeContext, name: str, diameter_nm: float, width_um: float | None = None) -> Pattern:
    """Read points, taken as one period of a square: a list, x and y in um, one a line, or a picture of particles.

    Of what is not square the middle square is taken.

    Args:
        width_um: of the picture.

    Raises:
        RecipeError: the file is unusable, or particles overlap.
    """
    key = "monolayer.structure.points"
    xy_um = read_columns(context, key, name) if width_um is None else _points_in_picture(context, name, width_um)
    _check_count(context, key, name, xy_um, "" if width_um is None else " in its middle square, which is what is taken")
    low, high = xy_um.min(axis=0), xy_um.max(axis=0)
    short, long = sorted(high - low)
    if short <= 0:
        raise context.fail(key, name, "holds points on one line")
    if short < long * (1 - 2 / np.sqrt(len(xy_um))):  # no square to within a row of particles
        xy_um = xy_um[np.abs(xy_um - (low + high) / 2).max(axis=1) <= short / 2]
        _check_count(context, key, name, xy_um, " in its middle square")
        low, high = xy_um.min(axis=0), xy_um.max(axis=0)
    # the period is not in the list; N random points leave 2/(N+1) of a side free at its ends
    side = float(np.max(high - low)) * 1e3 * (len(xy_um) + 1) / (len(xy_um) - 1)
    pattern = Pattern((xy_um - low) * 1e3, side)
    # overlaps are looked for in the list alone: its guessed repetition may bring edges too close
    nearest = float(nearest_distances(Pattern(pattern.xy_nm, 3 * side)).min())
    if nearest > 1e3 * FARTHEST_UM:
        what = "lengths are in um unless a heading says else, as x_nm,y_nm" if width_um is None else "width_um is in um"
        raise context.fail(
            key, name, f"has particles at least {1e-3 * nearest:.3g} um apart, and {FARTHEST_UM:g} is the most; {what}"
        )
    if nearest < diameter_nm * (1 - 1e-6):
        raise context.fail(
            key, name, f"has particles {nearest:.4g} nm apart, which overlap: they are {diameter_nm:.4g} nm wide"
        )
    return pattern


def _check_count(context: RecipeContext, key: str, name: str, xy_um: Array, where: str = "") -> None:
    if len(xy_um) < LEAST_POINTS:
        needed = f"at least {LEAST_POINTS} are needed to have a structure"
        raise context.fail(key, name, f"holds {len(xy_um)} points{where}; {needed}")


def _points_in_picture(context: RecipeContext, name: str, width_um: float) -> Array:
    """Find the particles in the middle square of a picture, `[point, 2]`, um.

    Raises:
        RecipeError: it shows none, or cannot be read.
    """
    path = context.path(name)
    try:
        if plain(path).stat().st_size > MAX_FILE_BYTES:
            raise NacreError(f"is larger than {MAX_FILE_BYTES >> 20} MB")
        found = find_particles(grey_levels(path), width_um)
    except OSError as error:
        raise context.fail("monolayer.structure.points", name, why_unreadable(error)) from None
    except NacreError as error:
        raise context.fail("monolayer.structure.points", name, str(error)) from None
    logger.log(logging.WARNING if found.left_out else logging.INFO, "%s: %s: %s", context.source, name, found.summary)
    side = min(found.size_um)
    away = np.abs(found.xy_um - np.array(found.size_um) / 2).max(axis=1)
    return found.xy_um[away < side / 2]


def points_structure(pattern: Pattern, q_max_per_nm: float) -> Structure:
    """Measure a list of points; its least distance is the one within the list, see `points_pattern`."""
    nearest = float(nearest_distances(Pattern(pattern.xy_nm, 3 * pattern.box_nm)).min())
    return measured_structure("points", pattern, nearest, q_max_per_nm)


def sq_structure(
    context: RecipeContext, name: str, density_per_nm2: float, packing: float, q_max_per_nm: float
) -> Structure:
    """Read S(q): q in 1/um and S, one pair a line; g(r) is its transform outside the least distance.

    Raises:
        RecipeError: the file is unusable.
    """
    key = "monolayer.structure.sq"
    table = read_columns(context, key, name)
    q, s = table[:, 0] * 1e-3, table[:, 1]
    if len(q) < 4 or np.any(np.diff(q) <= 0) or q[0] < 0 or np.any(s < 0):
        raise context.fail(key, name, "must hold at least 4 rows of ascending q >= 0 in 1/um and S >= 0")
    a = float(np.sqrt(4 * packing / (np.pi * density_per_nm2)))
    step = 0.01 / a
    grid = np.asarray(np.arange(int(max(q[-1], q_max_per_nm) / step) + 2) * step, dtype=np.float64)
    values = np.interp(grid, q, s, right=1.0)
    r = np.linspace(a, RANGE_IN_DIAMETERS * a, 385)
    # a soft window keeps the end of the table from ringing in g
    window = np.cos(np.clip(grid / q[-1], 0.0, 1.0) * np.pi / 2)
    spectrum = (values - 1) * window * grid * step / (2 * np.pi * density_per_nm2)
    h = np.array([j0(grid * x) @ spectrum for x in r])
    return Structure("sq", density_per_nm2, a, grid, values, r, np.maximum(h, -1.0))


def read_columns(context: RecipeContext, key: str, name: str) -> Array:
    """Read two columns of numbers, parted as `nacre.recipe.cells` knows, with a heading or not.

    The first two count; of a heading that names x and y (in nm, um or mm) those do, brought to um.

    Raises:
        RecipeError: the file is missing, too large or not numbers.
    """
    path = context.path(name)
    try:
        if plain(path).stat().st_size > MAX_FILE_BYTES:
            raise context.fail(key, name, f"is larger than {MAX_FILE_BYTES >> 20} MB")
        lines = list(rows(decoded(path.read_bytes())))
    except UnicodeDecodeError:
        raise context.fail(key, name, "must hold two numbers a line; it is not text") from None
    except OSError as error:
        raise context.fail(key, name, why_unreadable(error)) from None
    first, second, to_um = 0, 1, 1.0
    if lines and not _is_number(lines[0][1][0]):
        names = headings(lines.pop(0)[1])
        for unit, factor in {"": 1e3, **LENGTH_UNITS_NM}.items():
            x, y = (f"{axis}_{unit}".rstrip("_") for axis in "xy")
            if x in names and y in names:
                first, second, to_um = names.index(x), names.index(y), factor * 1e-3
    found = []
    for number, cells in lines:
        try:
            found.append((float(cells[first]), float(cells[second])))
        except (ValueError, IndexError):
            said = " ".join(cells)[:40]
            raise context.fail(key, name, f'holds "{said}" in line {number} where two numbers should stand') from None
        if not all(map(math.isfinite, found[-1])):
            raise context.fail(key, name, f"must hold finite numbers; line {number} does not")
    if not found:
        raise context.fail(key, name, "must hold two numbers a line")
    table = np.array(found)
    return table * to_um


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
