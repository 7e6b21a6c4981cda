"""Point patterns of a monolayer on a periodic square, seeded, up to a million points; their S(q) and g(r).

Distances are in units of the least distance a inside the kernels; a grid of cells of side below a/sqrt(2) holds at
most one point a cell, so each test of overlap looks at 24 neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.matter.jit import compiled
from nacre.recipe.memory import check_memory

RSA_LIMIT = 0.535  # random sequential addition jams at 0.547
POISSON_LIMIT = 0.53
MAX_POINTS = 4_000_000
SWEEPS = 80  # Monte-Carlo moves a disk; S(q) is stationary within its noise after some 60 at packing 0.5


@dataclass(frozen=True)
class Pattern:
    """Points on a periodic square.

    Attributes:
        xy_nm: `[point, 2]`, in [0, box_nm).
        box_nm: side of the square.
    """

    xy_nm: Array
    box_nm: float


@compiled(nogil=True)
def _free(grid, wrap, ix, iy, x, y, box):  # type: ignore[no-untyped-def]  # numba
    """Whether no point of another cell is closer than 1; cells of side <= 1/sqrt(2), the point's own one empty."""
    for dx in range(-2, 3):
        cx = wrap[ix + dx + 2]
        for dy in range(-2, 3):
            if abs(dx * dy) == 4:
                continue  # the corners are out of reach
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
    """Throw darts; the least distance falls from `start` to 1 by `shrink` each `tries` failures. Points placed."""
    np.random.seed(seed)  # noqa: NPY002  # numba knows the generator of its own thread only
    side = box / cells
    grid = np.full((cells, cells, 2), -1.0)
    wrap = (np.arange(cells + 4) - 2) % cells
    placed, failed, distance = 0, 0, start
    while placed < count:
        x, y = np.random.random() * box, np.random.random() * box  # noqa: NPY002
        ix, iy = min(int(x / side), cells - 1), min(int(y / side), cells - 1)
        clear = grid[ix, iy, 0] < 0.0 and _free(grid, wrap, ix, iy, x, y, box)
        if clear and distance > 1.0:
            # a wider distance needs more cells than the next ones
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
    """Metropolis moves of hard disks of diameter 1, one after the other; returns the share accepted."""
    np.random.seed(seed)  # noqa: NPY002  # numba knows the generator of its own thread only
    side = box / cells
    grid = np.full((cells, cells, 2), -1.0)
    wrap = (np.arange(cells + 4) - 2) % cells
    for j in range(xy.shape[0]):
        ox, oy = min(int(xy[j, 0] / side), cells - 1), min(int(xy[j, 1] / side), cells - 1)
        grid[ox, oy, 0], grid[ox, oy, 1] = xy[j, 0], xy[j, 1]  # of a slice numba would compile the words of its error
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


def random_sequential(count: int, density_per_nm2: float, packing: float, seed: int = 0) -> Pattern:
    """Random sequential addition: points one after the other, where they fit.

    Raises:
        NacreError: a packing above 0.535, where the square jams before it is full.
    """
    if packing > RSA_LIMIT:
        raise NacreError(f"packing = {packing:g} is not allowed for rsa; it should be at most {RSA_LIMIT:g}")
    box, cells = _frame(count, packing)
    xy = np.empty((count, 2))
    placed = _add(count, box, cells, seed, 1.0, 1.0, 4_000_000, xy)
    if placed < count:
        raise NacreError(f"random sequential addition jammed after {placed} of {count} points at packing {packing:g}")
    return _scaled(xy, box, density_per_nm2, packing)


def poisson_disk(count: int, density_per_nm2: float, packing: float, seed: int = 0) -> Pattern:
    """Poisson-disk sampling by relaxed dart throwing: the least distance starts wide and falls to a.

    McCool & Fiume, Graphics Interface (1992). More even than random sequential addition at the same density.

    Raises:
        NacreError: the points do not fit, as above a packing of about 0.53.
    """
    if packing > POISSON_LIMIT:
        raise NacreError(
            f"packing = {packing:g} is not allowed for poisson-disk; it should be at most {POISSON_LIMIT:g}"
        )
    box, cells = _frame(count, packing)
    xy = np.empty((count, 2))
    start = max(1.0, 0.75 * np.sqrt(2 / np.sqrt(3) * np.pi / (4 * packing)))
    placed = _add(count, box, cells, seed, start, 0.98, max(200, 2 * count), xy)
    if placed < count:
        raise NacreError(f"poisson-disk sampling filled up after {placed} of {count} points at packing {packing:g}")
    return _scaled(xy, box, density_per_nm2, packing)


def hard_disks(count: int, density_per_nm2: float, packing: float, seed: int = 0, sweeps: int = SWEEPS) -> Pattern:
    """Hard disks in equilibrium, by Monte-Carlo moves from a random start (from a lattice above packing 0.5).

    Raises:
        NacreError: a packing above 0.7, where disks freeze.
    """
    if packing > 0.7:
        raise NacreError(f"packing = {packing:g} is not allowed; it should be at most 0.7")
    box, cells = _frame(count, packing)
    if packing <= 0.5:
        xy = np.empty((count, 2))
        if _add(count, box, cells, seed, 1.0, 1.0, 4_000_000, xy) < count:
            raise NacreError(f"no start was found for {count} disks at packing {packing:g}")
    else:
        xy = _hexagonal(count, box)
    gap = max(np.sqrt(np.pi / (4 * packing)) - 0.95, 0.05)
    # in the order of their cells, so that a sweep walks through memory
    xy = xy[np.lexsort((xy[:, 1] * cells // box, xy[:, 0] * cells // box))]
    _move(xy, box, cells, seed + 1, sweeps, float(min(gap, 0.5 * box)))
    return _scaled(xy, box, density_per_nm2, packing)


def _hexagonal(count: int, box: float) -> Array:
    """Places of a hexagonal lattice that fit the box; spare ones stay empty, evenly."""
    rows = int(np.ceil(np.sqrt(count * 2 / np.sqrt(3)) / 2) * 2)
    columns = int(np.ceil(count / rows))
    y, x = np.divmod(np.arange(rows * columns), columns)
    xy = np.stack([(x + 0.5 * (y % 2)) * (box / columns), y * (box / rows)], axis=1)
    return np.ascontiguousarray(xy[np.linspace(0, len(xy) - 1, count).round().astype(int)] % box)


def lattice(count: int, density_per_nm2: float, kind: str = "hexagonal", jitter: float = 0.0, seed: int = 0) -> Pattern:
    """A square or hexagonal lattice; each point moved by a Gaussian of `jitter` lattice constants.

    The number of points is rounded so that the lattice closes on the (nearly) square box.
    """
    rng = np.random.default_rng(seed)
    columns = max(2, round(np.sqrt(count)))
    rows = columns
    if kind == "hexagonal":
        rows = max(2, 2 * round(columns / np.sqrt(3) * 2 / 2 * 1.0))
        columns = max(2, round(rows * np.sqrt(3) / 2))
    box = float(np.sqrt(rows * columns / density_per_nm2))
    y, x = np.divmod(np.arange(rows * columns), columns)
    shift = 0.5 * (y % 2) if kind == "hexagonal" else 0.0
    xy = np.stack([(x + shift) * (box / columns), y * (box / rows)], axis=1)
    xy = xy + rng.normal(scale=jitter * box / columns, size=xy.shape)
    return Pattern(xy % box, box)


def nearest_distances(pattern: Pattern) -> Array:
    """The distance of each point to its nearest neighbour, periodic, in nm, `[point]`."""
    from scipy.spatial import cKDTree

    xy = pattern.xy_nm % pattern.box_nm
    tree: Any = cKDTree(xy, boxsize=np.full(2, pattern.box_nm))
    return np.asarray(tree.query(xy, k=2)[0][:, 1])


def measured_structure_factor(pattern: Pattern, q_edges_per_nm: Array) -> Array:
    """S(q) of a pattern, averaged over the modes of its box between the edges, `[bin]`; NaN-free.

    Points are spread on a mesh by cubic B-splines and transformed; the spline's own transform is divided out. A bin
    without a mode takes its neighbours' value.
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
    found = modes > 0
    return np.interp(centres, centres[found], total[found] / modes[found])


@compiled(nogil=True)
def _spread(u, density):  # type: ignore[no-untyped-def]  # numba
    mesh = density.shape[0]
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
    """r (bin centres, nm) and g(r) of a pattern up to `reach_nm`, which must be below a third of the box."""
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
