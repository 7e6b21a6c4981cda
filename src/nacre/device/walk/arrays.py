"""The random walk on arrays: a layered lobe's values with standard errors, and its albedo."""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.layered import Layered
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.device.bsdf import make_plugin
from nacre.device.plugin import device_array
from nacre.device.variant import use_variant
from nacre.device.walk.strata import TOGETHER, Strata
from nacre.device.walk.walk import eval_walk, make_rng, sample_walk

LANES = 1 << 20  # walks per launch
MIDDLE = np.array([0.5, 0.5])


def evaluate_layered(
    lobe: Layered, wi: Array, wo: Array, samples: int = 4096, seed: int = 0, uv: Array | None = None
) -> tuple[Array, Array]:
    """Estimate the non-delta values and their standard errors.

    Args:
        lobe: the material.
        wi, wo: unit vectors `[..., 3]`.
        samples: walks for each pair and wavelength.
        seed: random seed.
        uv: `[..., 2]`, surface coordinates for glints and a varying base; default: the mean over glints, and the
            middle of the base.

    Returns:
        `(f, f_std)`, each `[..., wavelength]`, 1/sr, without the cosine.

    Raises:
        UnsupportedError: LLVM (or a GPU) is missing.
    """
    wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
    shape = wi.shape[:-1]
    count = len(lobe.wavelengths_nm)
    pairs_i, pairs_o = wi.reshape(-1, 3), wo.reshape(-1, 3)
    places = np.broadcast_to(MIDDLE if uv is None else np.asarray(uv, dtype=float), (*shape, 2)).reshape(-1, 2)
    strata = _strata(lobe, uv)
    jobs = _wavelength_jobs(count)

    def walk(job: NDArray[np.int64], lanes: _Lanes) -> Any:
        pair = device_index(job[:, 0])
        start, end = lanes.vector(pairs_i, pair), lanes.vector(pairs_o, pair)
        wavelengths = lanes.wavelengths(lobe.wavelengths_nm, jobs, device_index(job[:, 1]))
        rng = make_rng(mi.Float(lanes.index), mi.Float(seed), wavelengths[0], start.x, end.x, end.y)
        where = strata.locate(_site(wavelengths, lanes.vector(places, pair)), mi.Bool(True))
        value = eval_walk(strata, rng, start, end, where, mi.Bool(True))
        return [value / dr.maximum(dr.abs(end.z), 1e-6)]

    (mean,), (error,) = _run(walk, len(pairs_i), jobs, count, samples)
    return mean.reshape(*shape, count), error.reshape(*shape, count)


def hemispherical_layered(
    lobe: Layered, wi: Array, samples: int = 4096, seed: int = 0, uv: Array | None = None
) -> tuple[Array, Array]:
    """Estimate the power leaving on the side of one `wi[3]` and on the other, `[wavelength]`, without delta parts.

    Raises:
        UnsupportedError: LLVM (or a GPU) is missing.
    """
    count = len(lobe.wavelengths_nm)
    strata = _strata(lobe, uv)
    jobs = _wavelength_jobs(count)
    direction = np.asarray(wi, dtype=float).reshape(1, 3)
    place = mi.Point2f(*(MIDDLE if uv is None else np.asarray(uv, dtype=float).reshape(2)).tolist())

    def walk(job: NDArray[np.int64], lanes: _Lanes) -> Any:
        start = lanes.vector(direction, device_index(job[:, 0]))
        wavelengths = lanes.wavelengths(lobe.wavelengths_nm, jobs, device_index(job[:, 1]))
        rng = make_rng(mi.Float(lanes.index), mi.Float(seed), wavelengths[0], start.x, start.y)
        where = strata.locate(_site(wavelengths, place), mi.Bool(True))
        out, weight, mirror = sample_walk(strata, rng, start, where, mi.Bool(True))
        same = (out.z > 0) == (start.z > 0)
        spread = dr.select(mirror, 0.0, weight)
        return [dr.select(same, spread, 0.0), dr.select(same, 0.0, spread)]

    mean, _ = _run(walk, 1, jobs, count, samples)
    return mean[0][0], mean[1][0]


class _Lanes:
    """Lanes of one launch: job j has lanes j samples ... (j + 1) samples - 1."""

    def __init__(self, first: int, jobs: int, samples: int) -> None:
        lane = dr.arange(mi.UInt32, jobs * samples)
        # data rather than literals: other sample counts reuse the kernel
        self.job = lane // dr.opaque(mi.UInt32, samples)
        self.index = lane + dr.opaque(mi.UInt32, first * samples % (1 << 24))

    def vector(self, values: Array, row: Any) -> Any:
        """Return each lane's row from `[row, 3]` or `[row, 2]`."""
        row = dr.gather(mi.UInt32, row, self.job)
        flat = device_array(values)
        parts = [dr.gather(mi.Float, flat, values.shape[1] * row + i) for i in range(values.shape[1])]
        return mi.Vector3f(*parts) if len(parts) == 3 else mi.Point2f(*parts)

    def wavelengths(self, grid: Array, jobs: NDArray[np.int64], row: Any) -> Any:
        row = dr.gather(mi.UInt32, row, self.job)
        flat = device_array(grid[jobs])
        return mi.UnpolarizedSpectrum(*[dr.gather(mi.Float, flat, TOGETHER * row + k) for k in range(TOGETHER)])


def _site(wavelengths: Any, uv: Any) -> Any:
    """Return an interaction with wavelengths and surface coordinates."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wavelengths, si.uv = wavelengths, uv
    return si


def device_index(values: NDArray[np.int64]) -> Any:
    """Copy indices to the device."""
    return mi.UInt32(np.ascontiguousarray(values, dtype=np.uint32))


def _strata(lobe: Layered, uv: Array | None) -> Strata:
    use_variant()
    if not dr.is_jit_v(mi.Float):
        raise UnsupportedError(
            "a pearl is evaluated by a random walk that needs LLVM, which was not found; see `nacre doctor`"
        )
    return Strata(lobe if uv is not None else dataclasses.replace(lobe, glint_numbers=None), make_plugin)


def _wavelength_jobs(count: int) -> NDArray[np.int64]:
    """Group distant wavelengths by four, since neighbours would be almost identical."""
    groups = -(-count // TOGETHER)
    return np.minimum(np.arange(groups)[:, None] + groups * np.arange(TOGETHER), count - 1)


def _run(walk: Any, pairs: int, jobs: NDArray[np.int64], count: int, samples: int) -> tuple[list[Array], list[Array]]:
    """Run `walk` for all (pair, wavelength group) jobs; return means and standard errors `[pair, wavelength]`."""
    samples = max(2, int(samples))
    all_jobs = np.stack(np.meshgrid(np.arange(pairs), np.arange(len(jobs)), indexing="ij"), axis=-1).reshape(-1, 2)
    share = min(samples, LANES)
    rounds = -(-samples // share)
    at_once = max(1, LANES // share)
    sums: list[Array] = []
    squares: list[Array] = []
    for turn in range(rounds):
        for first in range(0, len(all_jobs), at_once):
            job = all_jobs[first : first + at_once]
            lanes = _Lanes(turn * len(all_jobs) + first, len(job), share)
            results = walk(job, lanes)
            dr.eval(*results)  # one walk for all wavelengths: otherwise each sum would repeat the walk
            for i, value in enumerate(results):
                if len(sums) <= i:
                    sums.append(np.zeros((pairs, count)))
                    squares.append(np.zeros((pairs, count)))
                one = [dr.block_sum(value[k], share) for k in range(TOGETHER)]
                two = [dr.block_sum(dr.square(value[k]), share) for k in range(TOGETHER)]
                dr.eval(*one, *two)
                for k in range(TOGETHER):
                    column = job[:, 1] + len(jobs) * k
                    fresh = column < count  # the last group may be padded with the last wavelength
                    where = (job[fresh, 0], column[fresh])
                    np.add.at(sums[i], where, np.asarray(one[k], dtype=float)[fresh])
                    np.add.at(squares[i], where, np.asarray(two[k], dtype=float)[fresh])
    total = rounds * share
    means = [s / total for s in sums]
    errors = [np.sqrt(np.maximum(q / total - m**2, 0.0) / (total - 1)) for q, m in zip(squares, means, strict=True)]
    return means, errors
