"""Particle arrangements: seeded point patterns on a periodic square, point lists, pictures and measured S(q).

The kernels use the least distance a as the length unit; a grid with cells below a/sqrt(2) holds at most one
point per cell, so each overlap test inspects 24 neighbours.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from nacre.bsdf.texture import opened_image
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import size_of
from nacre.core.jit import compiled
from nacre.core.machine import check_memory
from nacre.families.metasurface.monolayer.structure import RANGE_IN_DIAMETERS, Structure
from nacre.readers.curves import Q_PER_UM, STRUCTURE, X_UM, Y_UM, FileSpec, recipe_curve
from nacre.recipe.model import RecipeContext

RSA_LIMIT = 0.535  # random sequential addition jams at 0.547
POISSON_LIMIT = 0.53
MAX_POINTS = 4_000_000
SWEEPS = 80  # Monte Carlo moves per disk; S(q) is stationary after about 60 at packing 0.5


@dataclass(frozen=True)
class Pattern:
    """Points on a periodic square.

    Attributes:
        xy_nm: `[point, 2]`, in [0, box_nm).
        box_nm: square side.
    """

    xy_nm: Array
    box_nm: float


@compiled(nogil=True)
def _free(grid, wrap, ix, iy, x, y, box):  # type: ignore[no-untyped-def]  # numba
    """Whether no point in another cell is closer than 1; cell side <= 1/sqrt(2), the own cell empty."""
    for dx in range(-2, 3):
        cx = wrap[ix + dx + 2]
        for dy in range(-2, 3):
            if abs(dx * dy) == 4:
                continue  # corners are more than 1 away
            cy = wrap[iy + dy + 2]
            px = grid[cx, cy, 0]
            if px < 0.0:
                continue
            ux, uy = abs(x - px), abs(y - grid[cx, cy, 1])
            if ux > 0.5 * box:
                ux = box - ux
            if uy > 0.5 * box:
                uy = box - uy
            if ux * ux + uy * uy < 1.0:
                return False
    return True


@compiled(nogil=True)
def _add(count, box, cells, seed, start, shrink, tries, xy):  # type: ignore[no-untyped-def]  # numba
    """Place random points that keep a least distance; write them to `xy` and return their count.

    The distance begins at `start` and is multiplied by `shrink`, down to 1, after `tries` failures in a row.
    """
    np.random.seed(seed)  # noqa: NPY002  # numba has its own generator per thread
    side = box / cells
    grid = np.full((cells, cells, 2), -1.0)
    wrap = (np.arange(cells + 4) - 2) % cells
    placed, failed, distance = 0, 0, start
    while placed < count:
        x, y = np.random.random() * box, np.random.random() * box  # noqa: NPY002
        ix, iy = min(int(x / side), cells - 1), min(int(y / side), cells - 1)
        clear = grid[ix, iy, 0] < 0.0 and _free(grid, wrap, ix, iy, x, y, box)
        if clear and distance > 1.0:
            # a larger distance needs more cells
            span = int(distance / side) + 1
            for dx in range(-span, span + 1):
                for dy in range(-span, span + 1):
                    cx, cy = (ix + dx) % cells, (iy + dy) % cells
                    if grid[cx, cy, 0] >= 0.0:
                        ux, uy = abs(x - grid[cx, cy, 0]), abs(y - grid[cx, cy, 1])
                        ux, uy = min(ux, box - ux), min(uy, box - uy)
                        if ux * ux + uy * uy < distance * distance:
                            clear = False
                            break
                if not clear:
                    break
        if clear:
            xy[placed, 0], xy[placed, 1] = x, y
            grid[ix, iy, 0], grid[ix, iy, 1] = x, y
            placed += 1
            failed = 0
        else:
            failed += 1
            if failed > tries:
                if distance <= 1.0:
                    return placed
                distance = max(1.0, distance * shrink)
                failed = 0
    return placed


@compiled(nogil=True)
def _move(xy, box, cells, seed, sweeps, step):  # type: ignore[no-untyped-def]  # numba
    """Sequential Metropolis moves for hard disks with diameter 1; return the accepted share."""
    np.random.seed(seed)  # noqa: NPY002  # numba has its own generator per thread
    side = box / cells
    grid = np.full((cells, cells, 2), -1.0)
    wrap = (np.arange(cells + 4) - 2) % cells
    for j in range(xy.shape[0]):
        ox, oy = min(int(xy[j, 0] / side), cells - 1), min(int(xy[j, 1] / side), cells - 1)
        grid[ox, oy, 0], grid[ox, oy, 1] = xy[j, 0], xy[j, 1]  # a slice would make numba compile its error message
    accepted = 0
    for _ in range(sweeps):
        for j in range(xy.shape[0]):
            x = xy[j, 0] + (2 * np.random.random() - 1) * step  # noqa: NPY002
            y = xy[j, 1] + (2 * np.random.random() - 1) * step  # noqa: NPY002
            x = x + box if x < 0.0 else (x - box if x >= box else x)
            y = y + box if y < 0.0 else (y - box if y >= box else y)
            ix, iy = min(int(x / side), cells - 1), min(int(y / side), cells - 1)
            ox, oy = min(int(xy[j, 0] / side), cells - 1), min(int(xy[j, 1] / side), cells - 1)
            grid[ox, oy, 0] = -1.0
            if grid[ix, iy, 0] < 0.0 and _free(grid, wrap, ix, iy, x, y, box):
                xy[j, 0], xy[j, 1] = x, y
                grid[ix, iy, 0], grid[ix, iy, 1] = x, y
                accepted += 1
            else:
                grid[ox, oy, 0] = xy[j, 0]
    return accepted / (sweeps * xy.shape[0])


def _frame(count: int, packing: float) -> tuple[float, int]:
    if not 1 <= count <= MAX_POINTS:
        raise NacreError(f"a pattern of {count} points is not allowed; it should be 1 to {MAX_POINTS}")
    if packing <= 0:
        raise NacreError(f"packing = {packing:g} is not allowed; it should be over 0")
    box = float(np.sqrt(count * np.pi / (4 * packing)))
    if box < 3.0:
        raise NacreError(f"a pattern of {count} points at packing {packing:g} is too small to repeat")
    cells = int(np.ceil(box * np.sqrt(2.0))) + 1
    check_memory(16.0 * cells**2 + 64.0 * count, f"a pattern of {count} points at packing {packing:g}")
    return box, cells


def _scaled(xy: Array, box: float, density_per_nm2: float, packing: float) -> Pattern:
    a = np.sqrt(4 * packing / (np.pi * density_per_nm2))
    return Pattern(xy * a, float(box * a))


def _check_packing(packing: float, limit: float, name: str = "") -> None:
    if packing > limit:
        raise NacreError(f"packing = {packing:g} is not allowed{name}; it should be at most {limit:g}")


def _throw_darts(
    count: int, packing: float, seed: int, failure: str, start: float = 1.0, shrink: float = 1.0, tries: int = 4_000_000
) -> tuple[Array, float, int]:
    """Return points in units of the least distance, the side of the box, and its number of cells per side.

    `start`, `shrink` and `tries` are those of `_add`; `failure` begins the error message.
    """
    box, cells = _frame(count, packing)
    xy = np.empty((count, 2))
    placed = _add(count, box, cells, seed, start, shrink, tries, xy)
    if placed < count:
        raise NacreError(f"{failure} after {placed} of {count} points at packing {packing:g}")
    return xy, box, cells


def random_sequential(count: int, density_per_nm2: float, packing: float, seed: int = 0) -> Pattern:
    """Random sequential addition: points one after the other in the free area.

    Raises:
        NacreError: a packing above 0.535, where it jams.
    """
    _check_packing(packing, RSA_LIMIT, " for rsa")
    xy, box, _ = _throw_darts(count, packing, seed, "random sequential addition jammed")
    return _scaled(xy, box, density_per_nm2, packing)


def poisson_disk(count: int, density_per_nm2: float, packing: float, seed: int = 0) -> Pattern:
    """Poisson-disk sampling by relaxed dart throwing: the least distance starts large and falls to a.

    McCool & Fiume, Graphics Interface (1992). More uniform than random sequential addition at the same density.

    Raises:
        NacreError: the points do not fit, as above packing 0.53.
    """
    _check_packing(packing, POISSON_LIMIT, " for poisson-disk")
    start = max(1.0, 0.75 * np.sqrt(2 / np.sqrt(3) * np.pi / (4 * packing))) if packing > 0 else 1.0
    failure, tries = "poisson-disk sampling filled up", max(200, 2 * count)
    xy, box, _ = _throw_darts(count, packing, seed, failure, start, 0.98, tries)
    return _scaled(xy, box, density_per_nm2, packing)


def hard_disks(count: int, density_per_nm2: float, packing: float, seed: int = 0, sweeps: int = SWEEPS) -> Pattern:
    """Hard disks in equilibrium, by Monte Carlo moves from a random start (from a lattice above packing 0.5).

    Raises:
        NacreError: a packing above 0.7, where disks freeze.
    """
    _check_packing(packing, 0.7)
    if packing <= 0.5:
        xy, box, cells = _throw_darts(count, packing, seed, "the random start jammed")
    else:
        box, cells = _frame(count, packing)
        xy = _hexagonal(count, box)
    gap = max(np.sqrt(np.pi / (4 * packing)) - 0.95, 0.05)
    # sorted by cell for contiguous memory access
    xy = xy[np.lexsort((xy[:, 1] * cells // box, xy[:, 0] * cells // box))]
    _move(xy, box, cells, seed + 1, sweeps, float(min(gap, 0.5 * box)))
    return _scaled(xy, box, density_per_nm2, packing)


def _hexagonal(count: int, box: float) -> Array:
    """Hexagonal lattice points in the box, with vacancies evenly distributed."""
    rows = int(np.ceil(np.sqrt(count * 2 / np.sqrt(3)) / 2) * 2)
    columns = int(np.ceil(count / rows))
    y, x = np.divmod(np.arange(rows * columns), columns)
    xy = np.stack([(x + 0.5 * (y % 2)) * (box / columns), y * (box / rows)], axis=1)
    return np.ascontiguousarray(xy[np.linspace(0, len(xy) - 1, count).round().astype(int)] % box)


def lattice(count: int, density_per_nm2: float, kind: str = "hexagonal", jitter: float = 0.0, seed: int = 0) -> Pattern:
    """A square or hexagonal lattice with Gaussian displacements of `jitter` lattice constants.

    The point count is rounded to close the lattice on the (nearly) square box.
    """
    rng = np.random.default_rng(seed)
    columns = max(2, round(np.sqrt(count)))
    rows = columns
    if kind == "hexagonal":
        rows = max(2, 2 * round(columns / np.sqrt(3)))
        columns = max(2, round(rows * np.sqrt(3) / 2))
    box = float(np.sqrt(rows * columns / density_per_nm2))
    y, x = np.divmod(np.arange(rows * columns), columns)
    shift = 0.5 * (y % 2) if kind == "hexagonal" else 0.0
    xy = np.stack([(x + shift) * (box / columns), y * (box / rows)], axis=1)
    xy = xy + rng.normal(scale=jitter * box / columns, size=xy.shape)
    return Pattern(xy % box, box)


def nearest_distances(pattern: Pattern) -> Array:
    """Distance from each point to its nearest periodic neighbour in nm, `[point]`."""
    from scipy.spatial import cKDTree

    xy = pattern.xy_nm % pattern.box_nm
    tree: Any = cKDTree(xy, boxsize=np.full(2, pattern.box_nm))
    return np.asarray(tree.query(xy, k=2)[0][:, 1])


def measured_structure_factor(pattern: Pattern, q_edges_per_nm: Array) -> Array:
    """S(q), averaged over the box modes between the edges, `[bin]`.

    Points are spread on a mesh by cubic B-splines and transformed; the spline transform is divided out. A bin
    without a mode is interpolated.
    """
    count = len(pattern.xy_nm)
    q_max = float(q_edges_per_nm[-1])
    mesh = int(2 ** np.ceil(np.log2(max(32.0, 1.6 * q_max * pattern.box_nm / np.pi))))
    if mesh > 8192:
        raise NacreError("q is too large for a pattern of this size; ask for a smaller range")
    density = np.zeros((mesh, mesh))
    _spread(pattern.xy_nm / pattern.box_nm * mesh, density)
    amplitude = np.fft.rfft2(density)
    nx, ny = np.fft.fftfreq(mesh, 1 / mesh), np.arange(mesh // 2 + 1)
    spline = np.sinc(nx / mesh)[:, None] ** 4 * np.sinc(ny / mesh)[None, :] ** 4
    power = np.abs(amplitude / spline) ** 2 / count
    q = 2 * np.pi / pattern.box_nm * np.hypot(nx[:, None], ny[None, :])
    power, q = power.ravel()[1:], q.ravel()[1:]
    which = np.digitize(q, q_edges_per_nm) - 1
    inside = (which >= 0) & (which < len(q_edges_per_nm) - 1)
    total = np.bincount(which[inside], power[inside], len(q_edges_per_nm) - 1)
    modes = np.bincount(which[inside], minlength=len(q_edges_per_nm) - 1)
    centres = (q_edges_per_nm[1:] + q_edges_per_nm[:-1]) / 2
    filled = modes > 0
    return np.interp(centres, centres[filled], total[filled] / modes[filled])


@compiled(nogil=True)
def _spread(u, density):  # type: ignore[no-untyped-def]  # numba
    mesh = len(density)
    for j in range(u.shape[0]):
        ix, iy = int(np.floor(u[j, 0])), int(np.floor(u[j, 1]))
        fx, fy = u[j, 0] - ix, u[j, 1] - iy
        for a in range(-1, 3):
            wx = _spline(fx - a)
            for b in range(-1, 3):
                density[(ix + a) % mesh, (iy + b) % mesh] += wx * _spline(fy - b)


@compiled(nogil=True)
def _spline(t):  # type: ignore[no-untyped-def]  # numba
    t = abs(t)
    if t < 1.0:
        return (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    if t < 2.0:
        return (2.0 - t) ** 3 / 6.0
    return 0.0


@compiled(nogil=True)
def _count_pairs(xy, box, order, starts, cells, reach, bins, counts):  # type: ignore[no-untyped-def]  # numba
    side = box / cells
    for j in range(xy.shape[0]):
        ix, iy = int(xy[j, 0] / side) % cells, int(xy[j, 1] / side) % cells
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                cell = ((ix + dx) % cells) * cells + (iy + dy) % cells
                for n in range(starts[cell], starts[cell + 1]):
                    k = order[n]
                    if k <= j:
                        continue
                    ux, uy = abs(xy[j, 0] - xy[k, 0]), abs(xy[j, 1] - xy[k, 1])
                    ux, uy = min(ux, box - ux), min(uy, box - uy)
                    r = np.sqrt(ux * ux + uy * uy)
                    if r < reach:
                        counts[int(r / reach * bins)] += 2


def measured_pair_correlation(pattern: Pattern, reach_nm: float, bins: int = 300) -> tuple[Array, Array]:
    """r (bin centres, nm) and g(r) up to `reach_nm`, at most a third of the box."""
    box = pattern.box_nm
    if reach_nm > box / 3:
        raise NacreError(f"g(r) to {reach_nm:g} nm needs a box of at least three times that, not {box:g} nm")
    cells = max(3, int(box / reach_nm))
    xy = np.ascontiguousarray(pattern.xy_nm % box)
    cell = (xy[:, 0] / box * cells).astype(int) % cells * cells + (xy[:, 1] / box * cells).astype(int) % cells
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], np.arange(cells * cells + 1))
    counts = np.zeros(bins, dtype=np.int64)
    _count_pairs(xy, box, order, starts, cells, reach_nm, bins, counts)
    edges = np.linspace(0.0, reach_nm, bins + 1)
    ring = np.pi * (edges[1:] ** 2 - edges[:-1] ** 2)
    density = len(xy) / box**2
    return (edges[1:] + edges[:-1]) / 2, counts / (len(xy) * density * ring)


logger = logging.getLogger("nacre")

ARRANGEMENTS = ("hard-disk", "rsa", "poisson-disk", "lattice")
MEASURED_POINTS = 200_000
MAX_FILE_BYTES = 200 << 20
LEAST_POINTS = 50
FARTHEST_UM = 4.0  # largest neighbour distance; beyond, S(q) has more rings than light resolves
BIN_REDUCED = 0.1  # bin width for a measured S, in q a


@dataclass(frozen=True)
class Arrangement:
    """A name from `ARRANGEMENTS`, density, packing and seed, and for a lattice its type and jitter."""

    name: str
    density_per_nm2: float
    packing: float
    seed: int = 0
    lattice: str = "hexagonal"
    jitter: float = 0.1

    def pattern(self, count: int) -> Pattern:
        """Return a pattern with about `count` points.

        Raises:
            NacreError: the packing cannot be reached.
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
    """Measure and tabulate S(q) and g(r) for a pattern."""
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
    """Generate a pattern and measure it.

    Raises:
        RecipeError: it cannot be generated.
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
    """A jittered lattice averaged over all orientations (a polycrystal); the least distance is measured.

    Raises:
        RecipeError: the jitter makes particles overlap.
    """
    pattern = arrangement.pattern(10_000)
    # Gaussian jitter has rare close pairs; one in ten thousand may be separated in fabrication
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


def points_pattern(
    context: RecipeContext, spec: FileSpec | str, diameter_nm: float, width_um: float | None = None
) -> Pattern:
    """Read points as one square period: a list with x and y in um per line, or a picture.

    The middle square is used if the area is not square.

    Args:
        spec: the file, or its name.
        width_um: picture width.

    Raises:
        RecipeError: the file is unusable, or particles overlap.
    """
    spec = FileSpec(file=spec) if isinstance(spec, str) else spec
    key, name = "monolayer.structure.points", spec.file
    if width_um is None:
        xy_um = recipe_curve(context, key, spec, (X_UM, Y_UM))
    else:
        xy_um = _points_in_picture(context, name, width_um)
    _check_count(context, key, name, xy_um, "" if width_um is None else " in its middle square, which is what is taken")
    low, high = xy_um.min(axis=0), xy_um.max(axis=0)
    short, long = sorted(high - low)
    if short <= 0:
        raise context.fail(key, name, "holds points on one line")
    if short < long * (1 - 2 / np.sqrt(len(xy_um))):  # not square to within a particle row
        xy_um = xy_um[np.abs(xy_um - (low + high) / 2).max(axis=1) <= short / 2]
        _check_count(context, key, name, xy_um, " in its middle square")
        low, high = xy_um.min(axis=0), xy_um.max(axis=0)
    # the list has no period; N random points leave a fraction 2/(N+1) per side free
    side = float(np.max(high - low)) * 1e3 * (len(xy_um) + 1) / (len(xy_um) - 1)
    pattern = Pattern((xy_um - low) * 1e3, side)
    # the overlap test ignores the guessed periodic repetition
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
    """Find the particles in a picture's middle square, `[point, 2]`, um.

    Raises:
        RecipeError: no particles, or unreadable.
    """
    key = "monolayer.structure.points"
    levels = grey_levels(context.path(name), f'{context.source}: {key} = "{name}"')
    try:
        blobs = find_particles(levels, width_um)
    except NacreError as error:
        raise context.fail(key, name, str(error)) from None
    logger.log(logging.WARNING if blobs.left_out else logging.INFO, "%s: %s: %s", context.source, name, blobs.summary)
    side = min(blobs.size_um)
    away = np.abs(blobs.xy_um - np.array(blobs.size_um) / 2).max(axis=1)
    return blobs.xy_um[away < side / 2]


def points_structure(pattern: Pattern, q_max_per_nm: float) -> Structure:
    """Measure a point list; the least distance ignores the periodic repetition, see `points_pattern`."""
    nearest = float(nearest_distances(Pattern(pattern.xy_nm, 3 * pattern.box_nm)).min())
    return measured_structure("points", pattern, nearest, q_max_per_nm)


def sq_structure(
    context: RecipeContext, spec: FileSpec, density_per_nm2: float, packing: float, q_max_per_nm: float
) -> Structure:
    """Read S(q): q in 1/um and S, one pair per line; g(r) is its transform outside the least distance.

    Raises:
        RecipeError: the file is unusable.
    """
    key = "monolayer.structure.sq"
    table = recipe_curve(context, key, spec, (Q_PER_UM, STRUCTURE))
    q, s = table[:, 0] * 1e-3, table[:, 1]
    if len(q) < 4 or np.any(np.diff(q) <= 0) or q[0] < 0 or np.any(s < 0):
        raise context.fail(key, spec.file, "must hold at least 4 rows of ascending q >= 0 in 1/um and S >= 0")
    a = float(np.sqrt(4 * packing / (np.pi * density_per_nm2)))
    step = 0.01 / a
    grid = np.asarray(np.arange(int(max(q[-1], q_max_per_nm) / step) + 2) * step, dtype=np.float64)
    values = np.interp(grid, q, s, right=1.0)
    r = np.linspace(a, RANGE_IN_DIAMETERS * a, 385)
    # a soft window suppresses ringing in g from the table end
    window = np.cos(np.clip(grid / q[-1], 0.0, 1.0) * np.pi / 2)
    spectrum = (values - 1) * window * grid * step / (2 * np.pi * density_per_nm2)
    h = np.array([j0(grid * x) @ spectrum for x in r])
    return Structure("sq", density_per_nm2, a, grid, values, r, np.maximum(h, -1.0))


# Particle positions and sizes from a microscope picture.
#
# The smoothed grey levels are split by Otsu's threshold (IEEE Trans. Syst. Man Cybern. 9, 62, 1979); the particles are
# the rarer level, bright or dark. Touching blobs are separated at the distance transform maxima. Particles at the
# border, annotations and a scale banner are left out.

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
MOST_PIXELS = 60_000_000
SMOOTHING = 1.0  # pixels
LEAST_WIDTH = 4.0  # smallest usable particle diameter in pixels
SPECK = 0.25  # blobs below this share relative to the median area are noise
LEVELS = 256
SHADE = 0.1  # relative to the width: slower variation is uneven illumination
BANNER, IN_PICTURE = 0.5, 0.2  # one-level share per row: minimum in a banner, maximum in a picture
LEAST_BANNER = 0.02  # relative to the height
DRAWN = 0.1  # relative to the median noise within particles; less identifies an annotation
LEAST_NOISE = 1e-3  # a quarter of an 8-bit step
SURE = 0.7  # grey-level variance that two levels must explain; 0.64 for pure noise


@dataclass(frozen=True)
class PictureParticles:
    """Particles found in a picture.

    Attributes:
        xy_um: `[particle, 2]`, x to the right, y up, from the lower left corner.
        diameters_nm: `[particle]`, for discs with the blob areas.
        size_um: picture width and height.
        is_bright: whether the particles are the bright parts.
        left_out: banner or annotations, in words; "" without any.
    """

    xy_um: Array
    diameters_nm: Array
    size_um: tuple[float, float]
    is_bright: bool
    left_out: str = ""

    @property
    def summary(self) -> str:
        """Summary in words."""
        mean, spread = float(self.diameters_nm.mean()), float(self.diameters_nm.std())
        return (
            f"{len(self.xy_um)} {'bright' if self.is_bright else 'dark'} particles, {mean:.4g} nm wide (standard "
            f"deviation {spread:.3g} nm), in {self.size_um[0]:.4g} x {self.size_um[1]:.4g} um"
            + (f", without {self.left_out}" if self.left_out else "")
        )


def is_picture(name: str) -> bool:
    """Whether a file name has a picture suffix."""
    return Path(name).suffix.lower() in SUFFIXES


def grey_levels(path: str | Path, where: str = "") -> Array:
    """Return picture grey levels, `[row, column]`, 0 to 1.

    Raises:
        NacreError: unreadable, too large, or of one level; the message begins with `where` or the path.
    """
    path, where = Path(path), where or str(path)
    size_of(path, where, MAX_FILE_BYTES)
    with opened_image(path, where, MOST_PIXELS) as image:
        levels = np.asarray(image if image.mode in ("I", "F", "I;16") else image.convert("L"), dtype=float)
    low, high = float(levels.min()), float(levels.max())
    if not np.isfinite(high - low) or high <= low:
        raise RecipeError(f"{where} is of one grey level: it shows nothing")
    return (levels - low) / (high - low)


def find_particles(levels: Array, width_um: float) -> PictureParticles:
    """Find the particles in grey levels, `[row, column]`, for picture width `width_um`.

    Raises:
        NacreError: no contrast, or too small particles; the message ends a sentence that begins with the file.
    """
    from scipy import ndimage

    above, below = _banner(levels), _banner(levels[::-1])
    levels = levels[above : len(levels) - below]
    rows, columns = levels.shape
    pixel_nm = 1e3 * width_um / columns
    smooth = ndimage.gaussian_filter(levels, SMOOTHING)
    threshold, explained = otsu(smooth)
    if explained < SURE:  # remove uneven illumination, as from charging or an off-axis detector
        smooth = smooth - ndimage.gaussian_filter(levels, SHADE * columns)
        threshold, explained = otsu(smooth)
    if explained < SURE:
        raise NacreError(
            f"has no two levels: they explain {100 * explained:.0f} % of its contrast, {100 * SURE:.0f} % are needed"
        )
    bright = smooth > threshold
    is_bright = bool(bright.mean() < 0.5)
    inside = bright if is_bright else ~bright
    blobs = _split(inside)
    labels = np.arange(1, int(blobs.max()) + 1)
    areas = ndimage.sum_labels(inside, blobs, labels)
    cut = np.unique(np.concatenate([blobs[0], blobs[-1], blobs[:, 0], blobs[:, -1]]))
    uncut = ~np.isin(labels, cut)
    if not np.any(uncut):
        raise NacreError("shows no particle that its border does not cut")
    uncut &= areas >= SPECK * np.median(areas[uncut])
    drawn = uncut & _of_one_level(levels, np.where(ndimage.binary_erosion(inside, iterations=2), blobs, 0), uncut)
    selected = labels[uncut & ~drawn]
    diameters = 2 * np.sqrt(areas[selected - 1] / np.pi)
    if np.median(diameters) < LEAST_WIDTH:
        raise NacreError(
            f"shows particles {np.median(diameters):.2g} pixels wide; {LEAST_WIDTH:g} are needed to tell where they lie"
        )
    at = np.array(ndimage.center_of_mass(inside, blobs, selected)).reshape(-1, 2)
    xy = np.column_stack([at[:, 1] + 0.5, rows - 0.5 - at[:, 0]]) * pixel_nm * 1e-3
    notes = [f"a banner of {above + below} rows"] * (above + below > 0) + ["marks drawn in"] * bool(drawn.any())
    return PictureParticles(
        xy, diameters * pixel_nm, (width_um, rows * pixel_nm * 1e-3), is_bright, " and ".join(notes)
    )


def _banner(levels: Array) -> int:
    """Return the count of banner rows at the top, each mostly one level."""
    share = np.array([np.unique(row, return_counts=True)[1].max() for row in levels]) / levels.shape[1]
    ends = np.flatnonzero(share < BANNER)
    count = int(ends[0]) if ends.size else 0
    is_one = count >= LEAST_BANNER * len(levels) and float(np.median(share[count:])) < IN_PICTURE
    return count if is_one else 0


def _of_one_level(levels: Array, cores: NDArray[np.intp], uncut: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which blobs have one level, `[blob]`: annotations lack noise.

    Args:
        cores: `[row, column]`, blob numbers from 1 away from outlines, else 0.
        uncut: `[blob]`, the blobs that count.
    """
    count, first, second = (
        np.bincount(cores.ravel(), by, len(uncut) + 1)[1:] for by in (None, levels.ravel(), levels.ravel() ** 2)
    )
    there = count > 1
    size = np.maximum(count, 1)
    noise = np.where(there, np.sqrt(np.maximum(second / size - (first / size) ** 2, 0.0)), np.inf)
    usual = noise[uncut & there]
    if not usual.size or np.median(usual) < LEAST_NOISE:  # the picture is a drawing
        return np.zeros_like(there)
    return np.asarray(noise < DRAWN * np.median(usual))


def otsu(levels: Array) -> tuple[float, float]:
    """Return Otsu's threshold for levels in 0 to 1, and the explained variance share."""
    counts, edges = np.histogram(levels, LEVELS)
    middle = (edges[1:] + edges[:-1]) / 2
    weight = np.cumsum(counts) / counts.sum()
    moment = np.cumsum(counts * middle) / counts.sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        between = (moment[-1] * weight - moment) ** 2 / (weight * (1 - weight))
    between = np.nan_to_num(between)
    best = int(np.argmax(between))
    variance = float(np.sum(counts * (middle - moment[-1]) ** 2) / counts.sum())
    return float(edges[best + 1]), float(between[best]) / max(variance, 1e-300)


def _split(inside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Label blobs, `[row, column]`, 0 outside; touching blobs are split at their necks."""
    from scipy import ndimage

    depth = ndimage.gaussian_filter(ndimage.distance_transform_edt(inside), SMOOTHING)
    together, count = ndimage.label(inside)
    if count == 0:
        return np.asarray(together)
    deepest = ndimage.maximum(depth, together, np.arange(1, count + 1))
    radius = max(1.0, float(np.median(deepest)))
    around = ndimage.maximum_filter(depth, size=2 * int(np.ceil(0.7 * radius)) + 1)
    # seeds are at least half as deep as a full particle, unlike outline bumps
    seeds, seeded = ndimage.label((depth == around) & (depth > 0.5 * radius) & inside)
    if seeded == 0:
        return np.asarray(together)
    nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
    parted = np.where(inside, seeds[tuple(nearest)], 0)
    unlabelled = inside & ~np.isin(together, np.unique(together[seeds > 0]))  # blobs without a seed are specks
    return np.where(unlabelled, 0, parted)
