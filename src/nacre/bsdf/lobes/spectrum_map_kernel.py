"""The look-up in a spectrum map, compiled: 27 nodes a point, all wavelengths together."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from nacre.matter.jit import compiled

SERIES_UP_TO = 0.75  # of the sine: three terms of the series leave 1e-8 there for nodes 0.06 apart


@compiled(parallel=True)
def interpolate(power: Any, position: Any) -> Any:
    """Return the quadratic spline `[n, wavelength]` at node coordinates `position[n, 3]`; negative values become 0.

    Outside the nodes the outermost coefficients go on; the map is zero there anyway.

    Args:
        power: `[x, y, xi, wavelength]`, float32 coefficients.
        position: node coordinates, float64.
    """
    nx, ny, nz, count = power.shape
    points = position.shape[0]
    result = np.zeros((points, count))
    for k in numba.prange(points):
        weight = np.empty((3, 3))
        index = np.empty((3, 3), dtype=np.int64)
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
        for a in range(3):
            for b in range(3):
                w_ab = weight[0, a] * weight[1, b]
                for c in range(3):
                    w = w_ab * weight[2, c]
                    for m in range(count):
                        result[k, m] += w * power[index[0, a], index[1, b], index[2, c], m]
        for m in range(count):
            if result[k, m] < 0.0:
                result[k, m] = 0.0
    return result


@compiled(parallel=True, error_model="numpy", fastmath={"contract", "reassoc"})
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
    n, _, nz, count = power.shape
    rings = ring_cosines.shape[0]
    shares = np.zeros((rings * azimuths, cosines * azimuths, count), dtype=np.float32)
    last = reflectance.shape[0] - 1
    width = psi_step
    eighth, quarter = azimuths // 8, azimuths // 4
    each = eighth + 1
    for task in numba.prange(rings * each):
        ring, own = task // each, task % each
        cos_i = ring_cosines[ring]
        sin_i = np.sqrt(1.0 - cos_i * cos_i)
        wi_x, wi_y = sin_i * np.cos(2.0 * np.pi * own / azimuths), sin_i * np.sin(2.0 * np.pi * own / azimuths)
        mirrors = 1 if own == 0 or own == eighth else 2  # on an axis of symmetry its mirror image is itself
        factor = np.empty(count, dtype=np.float32)
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
                            shares[row, cell, m] += amount * lower
                            shares[row, cell + azimuths, m] += amount * upper
                        p, q = n - 1 - q, p  # a quarter turn: (u, v) -> (-v, u)
    return shares
