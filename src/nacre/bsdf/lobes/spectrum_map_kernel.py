"""The look-up in a spectrum map, compiled: 27 nodes a point, all wavelengths together.

The loops are shared among plain threads: numba's own parallel loops take three times as long to compile, which a first
design or picture of a relief waits for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.matter.jit import compiled
from nacre.matter.jobs import share

WORK_OF_A_VALUE = 4  # of 27 nodes or 4 turns, as `share` counts it
SERIES_UP_TO = 0.75  # of the sine: three terms of the series leave 1e-8 there for nodes 0.06 apart


def interpolate(power: Any, position: Any) -> Any:
    """Return the quadratic spline `[n, wavelength]` at node coordinates `position[n, 3]`; negative values become 0.

    Outside the nodes the outermost coefficients go on; the map is zero there anyway.

    Args:
        power: `[x, y, xi, wavelength]`, float32 coefficients.
        position: node coordinates, float64.
    """
    points, count = len(position), power.shape[-1]
    result = np.zeros((points, count))
    share(
        lambda first, last, *_: _interpolate(power, position, first, last, result), points, 1,
        work=points * count * WORK_OF_A_VALUE, jobs=None,
    )  # fmt: skip
    return result


@compiled(nogil=True)
def _interpolate(power, position, first, last, result):  # type: ignore[no-untyped-def]  # numba
    """Fill the rows of some points."""
    nx, ny, nz, count = power.shape
    weight = np.empty((3, 3))
    index = np.empty((3, 3), dtype=np.int64)
    total = np.empty(count)
    for k in range(first, last):
        for axis in range(3):
            size = nx if axis == 0 else (ny if axis == 1 else nz)
            x = min(max(position[k, axis], -1.0), float(size))
            centre = int(np.floor(x + 0.5))
            f = x - centre
            weight[axis, 0] = 0.5 * (0.5 - f) ** 2
            weight[axis, 1] = 0.75 - f * f
            weight[axis, 2] = 0.5 * (0.5 + f) ** 2
            for j in range(3):
                index[axis, j] = min(max(centre + j - 1, 0), size - 1)
        total[:] = 0.0
        for a in range(3):
            for b in range(3):
                w_ab = weight[0, a] * weight[1, b]
                for c in range(3):
                    w = w_ab * weight[2, c]
                    row = power[index[0, a], index[1, b], index[2, c]]
                    for m in range(count):
                        total[m] += w * row[m]
        for m in range(count):
            result[k, m] = 0.0 if total[m] < 0.0 else total[m]


def albedo_shares(power: Any, psi_step: float, xi_first: float, xi_step: float, reflectance: Any, ring_cosines: Any,
                  cosines: int, azimuths: int, is_kirchhoff: bool) -> Any:  # fmt: skip
    """Return how much light of each incidence leaves into each cell of exits, `[incidence, cell, wavelength]`, float32.

    Incidences lie on rings, those of a ring `azimuths` equal steps from the x axis on. Sums f cos_o d(omega) =
    f du dv over the map's own nodes in psi, whose coefficients hold its integral; so only xi is interpolated. 1/cos_o,
    steep at the horizon, is averaged over the radial width of a node. Exits are given to the cells t = sqrt(cos_o) x
    azimuth of the guard, to the nearest azimuth and linearly in t.

    The nodes are a centred square, so the geometry of an incidence within the first eighth of a turn is that of the
    seven others into which quarter turns and the mirror take it; only the map differs.

    Args:
        power: `[psi, psi, xi, wavelength]`, psi centred on 0.
        psi_step, xi_first, xi_step: of the nodes.
        reflectance: `[cosine, wavelength]`.
        ring_cosines: cosines of incidence of the rings.
        cosines, azimuths: nodes of the guard; azimuths a multiple of 8.
    """
    rings = len(ring_cosines)
    shares = np.zeros((rings * azimuths, cosines * azimuths, power.shape[-1]), dtype=np.float32)
    tasks = rings * (azimuths // 8 + 1)
    one = (power, psi_step, xi_first, xi_step, reflectance, ring_cosines, cosines, azimuths, is_kirchhoff)
    share(
        lambda begin, end, *_: _shares(*one, begin, end, shares), tasks, 1,
        work=tasks * power.size // power.shape[2] * WORK_OF_A_VALUE, jobs=None,
    )  # fmt: skip
    return shares


@compiled(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _shares(power, width, xi_first, xi_step, reflectance, ring_cosines, cosines, azimuths, is_kirchhoff, begin, end, out):  # type: ignore[no-untyped-def]  # numba  # noqa: E501
    """Add what some tasks send out: each a ring and an azimuth, whose rows no other task has."""
    n, _, nz, count = power.shape
    last = reflectance.shape[0] - 1
    eighth, quarter = azimuths // 8, azimuths // 4
    each = eighth + 1
    factor = np.empty(count, dtype=np.float32)
    for task in range(begin, end):
        ring, own = task // each, task % each
        cos_i = ring_cosines[ring]
        sin_i = np.sqrt(1.0 - cos_i * cos_i)
        wi_x, wi_y = sin_i * np.cos(2.0 * np.pi * own / azimuths), sin_i * np.sin(2.0 * np.pi * own / azimuths)
        mirrors = 1 if own == 0 or own == eighth else 2  # on an axis of symmetry its mirror image is itself
        for a in range(n):
            u = (a - 0.5 * (n - 1)) * width
            x = u - wi_x
            if abs(x) >= 1.0:
                continue
            for b in range(n):
                v = (b - 0.5 * (n - 1)) * width
                y = v - wi_y
                radius = np.sqrt(x * x + y * y)
                if radius - 0.5 * width >= 1.0:
                    continue
                inner = max(radius - 0.5 * width, -1.0)
                outer = min(radius + 0.5 * width, 1.0)
                if outer < SERIES_UP_TO:
                    # the same by its series in the width, whose next term is below single precision there
                    square = radius * radius
                    room = 1.0 / (1.0 - square)
                    inverse_cosine = np.sqrt(room) * (1.0 + width * width * room * room * (
                        (1.0 + 2.0 * square) / 24.0
                        + width * width * room * room * (9.0 + 72.0 * square + 24.0 * square * square) / 1920.0
                    ))  # fmt: skip
                else:
                    inverse_cosine = (np.arcsin(outer) - np.arcsin(inner)) / width
                middle = min(0.5 * (inner + outer), 1.0) if outer == 1.0 else radius
                cos_o = np.sqrt(max(1.0 - middle * middle, 1e-12))
                xi = cos_i + cos_o
                z = (xi - xi_first) / xi_step
                centre = int(np.floor(z + 0.5))
                f = z - centre
                w0, w1 = np.float32(0.5 * (0.5 - f) ** 2), np.float32(0.75 - f * f)
                w2 = np.float32(0.5 * (0.5 + f) ** 2)
                z0, z1 = min(max(centre - 1, 0), nz - 1), min(max(centre, 0), nz - 1)
                z2 = min(max(centre + 1, 0), nz - 1)
                length = u * u + v * v + xi * xi
                bare = length * length / (xi * xi) if is_kirchhoff else xi * xi
                bare *= width * width * inverse_cosine / (4.0 * cos_i)
                g = min(0.5 * np.sqrt(length), 1.0) * last
                low = min(int(g), last - 1)
                f = g - low
                for m in range(count):
                    factor[m] = bare * (reflectance[low, m] * (1.0 - f) + reflectance[low + 1, m] * f)
                t = np.sqrt(cos_o) * (cosines - 1)
                t0 = min(int(t), cosines - 2)
                upper = np.float32(t - t0)
                lower = np.float32(1.0) - upper
                azimuth = int(np.floor(np.arctan2(y, x) / (2.0 * np.pi) * azimuths + 0.5))
                for mirror in range(mirrors):
                    p, q = a, (n - 1 - b if mirror else b)
                    sign = -1 if mirror else 1
                    for turn in range(4):
                        row = ring * azimuths + (sign * own + turn * quarter) % azimuths
                        cell = t0 * azimuths + (sign * azimuth + turn * quarter) % azimuths
                        for m in range(count):
                            value = w0 * power[p, q, z0, m] + w1 * power[p, q, z1, m] + w2 * power[p, q, z2, m]
                            amount = max(value, np.float32(0.0)) * factor[m]
                            out[row, cell, m] += amount * lower
                            out[row, cell + azimuths, m] += amount * upper
                        p, q = n - 1 - q, p  # a quarter turn: (u, v) -> (-v, u)
