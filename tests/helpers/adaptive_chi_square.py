"""A chi-square test of draws against their density whose cells and quadrature follow the lobe, however narrow.

Mitsuba's own test has cells of one size over the sphere and a fixed rule in each: a lobe of a degree at grazing light
falls into a few of them, and the rule misses it. Here pilot draws cut the sphere into cells of equal probability, and
the density's integral over each is refined until it is known much better than the counts are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from nacre.core.arrays import Array

Sample = Callable[[int, int], tuple[Array, Array]]  # (count, seed) -> directions [n, 3], which of them are meant [n]
Density = Callable[[Array], Array]  # directions [n, 3] -> [n], 1/sr

NODES = 5  # Gauss nodes along each side of a piece
LEAST, DEEPEST = 3, 14  # halvings of a piece; fewer miss a narrow part of a cell that runs round the whole circle
CROPPED = 0.25  # of a box's width: an empty part wider than this is cut off
ROUNDING = 2e-6  # of single precision in sums of densities, relative
QUADRATURE = 0.05  # of a count's standard deviation: what the integrals may add, a four hundredth of its variance
FULL = 1.002  # the density may integrate to no more: single precision and the horizon's last sliver


@dataclass(frozen=True)
class Outcome:
    """What came out: the p-value, the density's integral, the number of cells, and the largest doubt of an integral.

    `doubt` is in standard deviations of the cell's count.
    """

    p_value: float
    total: float
    cells: int
    doubt: float

    def passes(self, level: float, tests: int = 1) -> bool:
        """Whether draws and density agree at `level`, shared among `tests` trials (Sidak)."""
        return self.total <= FULL and self.p_value >= 1.0 - (1.0 - level) ** (1.0 / tests)


def adaptive_chi_square(
    sample: Sample, density: Density, *, samples: int = 400_000, cells: int = 400, seed: int = 1
) -> Outcome:
    """Compare draws with a density over the sphere.

    Args:
        sample: draws; those that are not meant (absorbed, a delta) count as lost.
        density: of the draws that are meant.
        samples: draws counted; a fourth as many are drawn before to place the cells.
        cells: about how many.
    """
    pilot, kept = sample(samples // 4, seed + 1000)
    boxes = _cells(_flat(pilot[kept]), cells)
    directions, kept = sample(samples, seed)
    counts = _count(_flat(directions[kept]), boxes)
    share, error = _integrals(density, boxes, samples)
    total = float(share.sum())
    expected = np.append(share, max(1.0 - total, 0.0)) * samples
    seen = np.append(counts, samples - counts.sum()).astype(float)
    few = expected < 5.0  # too few for a normal law: taken together
    if few.any():
        expected = np.append(expected[~few], expected[few].sum())
        seen = np.append(seen[~few], seen[few].sum())
        if expected[-1] < 5.0:  # still too few: with the smallest other cell
            least = int(np.argmin(expected[:-1]))
            expected[least] += expected[-1]
            seen[least] += seen[-1]
            expected, seen = expected[:-1], seen[:-1]
    statistic = float(np.sum((seen - expected) ** 2 / np.maximum(expected, 1e-9)))
    doubt = float(np.max(error * samples / np.sqrt(np.maximum(share * samples, 1.0))))
    return Outcome(float(chi2.sf(statistic, len(expected) - 1)), total, len(boxes), doubt)


def _flat(directions: Array) -> Array:
    """Return (z, phi) `[n, 2]`, in which the sphere's area is flat."""
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    return np.stack([np.clip(directions[:, 2], -1.0, 1.0), phi], axis=-1)


def _cells(points: Array, count: int) -> Array:
    """Cut the sphere into boxes `[cell, (z0, z1, phi0, phi1)]` of equal numbers of points, split at the horizon."""
    done: list[tuple[float, float, float, float]] = []
    work = []
    for bottom, top in ((-1.0, 0.0), (0.0, 1.0)):
        inside = points[(points[:, 0] >= bottom) & (points[:, 0] <= top)]
        work.append((inside, [bottom, top, -np.pi, np.pi]))
    least = max(len(points) // count, 8)
    while work:
        inside, box = work.pop()
        if len(inside) < 2 * least:
            done.append((box[0], box[1], box[2], box[3]))
            continue
        if (cropped := _crop(inside, box)) is not None:
            axis, cut, is_upper = cropped
            lower, upper = list(box), list(box)
            lower[2 * axis + 1] = upper[2 * axis] = cut
            empty, full = (upper, lower) if is_upper else (lower, upper)
            done.append((empty[0], empty[1], empty[2], empty[3]))
            work.append((inside, full))
            continue
        # along the axis in which the points spread more of the box
        middle = np.median(inside, axis=0)
        low, high = np.quantile(inside, [0.1, 0.9], axis=0)
        spread = [(high[a] - low[a]) / (box[2 * a + 1] - box[2 * a]) for a in (0, 1)]
        axis = int(np.argmin(spread))  # the narrower side separates cells most: cut the lobe out first
        if not box[2 * axis] < middle[axis] < box[2 * axis + 1]:
            axis = 1 - axis
        cut = float(middle[axis])
        if not box[2 * axis] < cut < box[2 * axis + 1]:
            done.append((box[0], box[1], box[2], box[3]))
            continue
        lower, upper = list(box), list(box)
        lower[2 * axis + 1] = upper[2 * axis] = cut
        below = inside[:, axis] < cut
        work += [(inside[below], lower), (inside[~below], upper)]
    return np.array(done)


def _crop(points: Array, box: list[float]) -> tuple[int, float, bool] | None:
    """Return where to cut off a wide empty part of a box: axis, cut, and whether the upper part is the empty one.

    A rule of a few nodes over a box much wider than the lobe in it sees nothing, however it is halved.
    """
    for axis in (0, 1):
        low, high = float(points[:, axis].min()), float(points[:, axis].max())
        room = max(high - low, 1e-12)
        extent = box[2 * axis + 1] - box[2 * axis]
        if box[2 * axis + 1] - (high + room) > CROPPED * extent:
            return axis, high + room, True
        if low - room - box[2 * axis] > CROPPED * extent:
            return axis, low - room, False
    return None


def _count(points: Array, boxes: Array) -> Array:
    """Count the points in each box; sorted by z, those of its height alone are compared."""
    z, phi = points[np.argsort(points[:, 0])].T
    counts = np.zeros(len(boxes), dtype=np.int64)
    for i, (z0, z1, p0, p1) in enumerate(boxes):
        turn = phi[np.searchsorted(z, z0) : np.searchsorted(z, z1, "right" if z1 == 1.0 else "left")]
        counts[i] = np.count_nonzero((turn >= p0) & ((turn <= p1) if p1 == np.pi else (turn < p1)))
    return counts


def _integrals(density: Density, boxes: Array, samples: int) -> tuple[Array, Array]:
    """Return the density's integral over each box, and what its last refinement still changed."""
    total, error = np.zeros(len(boxes)), np.zeros(len(boxes))
    owner, pieces = np.arange(len(boxes)), boxes
    coarse = _gauss(density, pieces)
    known = coarse.copy()
    for depth in range(DEEPEST):
        quarters = _quartered(pieces)
        fine = _gauss(density, quarters).reshape(-1, 4)
        change = np.abs(fine.sum(axis=1) - coarse)
        known = np.maximum(known, np.bincount(owner, fine.sum(axis=1), len(boxes)))
        # a piece may add its share of what the whole cell is allowed; pieces of a cell add up like a walk
        allowed = QUADRATURE * np.sqrt(np.maximum(known[owner] * samples, 1.0)) / samples / 8.0
        open_ = (change > np.maximum(allowed, ROUNDING * np.abs(coarse))) | (depth < LEAST)
        total += np.bincount(owner[~open_], fine[~open_].sum(axis=1), len(boxes))
        error += np.bincount(owner[~open_], change[~open_], len(boxes))
        if not open_.any():
            return total, error
        pieces = quarters.reshape(-1, 4, 4)[open_].reshape(-1, 4)
        owner = np.repeat(owner[open_], 4)
        coarse = fine[open_].ravel()
    total += np.bincount(owner, coarse, len(boxes))
    error += np.bincount(owner, np.abs(coarse), len(boxes))
    return total, error


def _quartered(pieces: Array) -> Array:
    z0, z1, p0, p1 = pieces.T
    z, p = 0.5 * (z0 + z1), 0.5 * (p0 + p1)
    parts = [(z0, z, p0, p), (z0, z, p, p1), (z, z1, p0, p), (z, z1, p, p1)]
    return np.stack([np.stack(part, axis=-1) for part in parts], axis=1).reshape(-1, 4)


def _gauss(density: Density, pieces: Array) -> Array:
    x, weight = np.polynomial.legendre.leggauss(NODES)
    u, v = (g.ravel() for g in np.meshgrid(x, x, indexing="ij"))
    both = np.outer(weight, weight).ravel()
    half_z, half_p = (pieces[:, 1] - pieces[:, 0]) / 2, (pieces[:, 3] - pieces[:, 2]) / 2
    z = (pieces[:, 0] + half_z)[:, None] + half_z[:, None] * u
    phi = (pieces[:, 2] + half_p)[:, None] + half_p[:, None] * v
    s = np.sqrt(np.maximum((1 - z) * (1 + z), 0.0))
    directions = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)
    values = np.asarray(density(directions.reshape(-1, 3)), dtype=float).reshape(z.shape)
    return np.asarray((values @ both) * half_z * half_p)


def lobe_chi_square(
    bsdf: object, theta_deg: float, phi_deg: float, *, samples: int = 400_000, cells: int = 400, seed: int = 1,
    uv: tuple[float, float] = (0.5, 0.5),
) -> Outcome:  # fmt: skip
    """Put the `nacre` plugin of a Bsdf through it for one direction of view (theta > 90: from below)."""
    import drjit as dr
    import mitsuba as mi
    from lobe_trials import context, direction, draw, interaction

    from nacre.bsdf.bsdf import Bsdf
    from nacre.device.bsdf import make_bsdf

    plugin = make_bsdf(bsdf) if isinstance(bsdf, Bsdf) else bsdf
    wi = direction(theta_deg, phi_deg)

    def sample(count: int, number: int) -> tuple[Array, Array]:
        draws = draw(plugin, wi, count, seed=number, uv=np.array(uv))
        return draws.wo, (draws.pdf > 0.0) & ~draws.is_delta

    def density(wo: Array) -> Array:
        si = interaction(np.broadcast_to(wi, wo.shape), uv=np.array(uv))
        found = plugin.pdf(context(), si, mi.Vector3f(wo.T.astype(np.float32)), mi.Bool(True))  # type: ignore[attr-defined]
        dr.eval(found)
        return np.broadcast_to(np.array(found, dtype=float), (len(wo),))

    return adaptive_chi_square(sample, density, samples=samples, cells=cells, seed=seed)
