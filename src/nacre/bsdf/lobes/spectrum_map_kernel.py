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


@compiled(parallel=True, error_model="numpy")
def albedo_shares(power: Any, origin: Any, step: Any, reflectance: Any, wi: Any, cosines: int, azimuths: int,
                  is_kirchhoff: bool) -> Any:  # fmt: skip
    """Return how much of the light along each `wi` leaves into each cell of exits, `[wi, cell, wavelength]`, float32.

    Sums f cos_o d(omega) = f du dv over the map's own nodes in psi, whose coefficients hold its integral; so only xi
    is interpolated. 1/cos_o, steep at the horizon, is averaged over the radial width of a node. Exits are given to
    the cells t = sqrt(cos_o) x azimuth of the guard, to the nearest azimuth and linearly in t.

    Args:
        power: `[x, y, xi, wavelength]`.
        origin, step: `[3]`, first node and step of psi_x, psi_y, xi.
        reflectance: `[cosine, wavelength]`.
        wi: directions `[n, 3]`, z > 0.
        cosines, azimuths: nodes of the guard.
    """
    nx, ny, nz, count = power.shape
    shares = np.zeros((wi.shape[0], cosines * azimuths, count), dtype=np.float32)
    last = reflectance.shape[0] - 1
    width = step[0]
    for i in numba.prange(wi.shape[0]):
        value = np.empty(count)
        w = np.empty(3)
        for a in range(nx):
            u = origin[0] + a * step[0]
            x = u - wi[i, 0]
            if abs(x) >= 1.0:
                continue
            for b in range(ny):
                v = origin[1] + b * step[1]
                y = v - wi[i, 1]
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
                xi = wi[i, 2] + cos_o
                z = (xi - origin[2]) / step[2]
                centre = int(np.floor(z + 0.5))
                f = z - centre
                w[0] = 0.5 * (0.5 - f) ** 2
                w[1] = 0.75 - f * f
                w[2] = 0.5 * (0.5 + f) ** 2
                value[:] = 0.0
                for c in range(3):
                    row = min(max(centre + c - 1, 0), nz - 1)
                    for m in range(count):
                        value[m] += w[c] * power[a, b, row, m]
                length = u * u + v * v + xi * xi
                bare = length * length / (xi * xi) if is_kirchhoff else xi * xi
                bare *= width * width * inverse_cosine / (4.0 * wi[i, 2])
                g = min(0.5 * np.sqrt(length), 1.0) * last
                low = min(int(g), last - 1)
                f = g - low
                t = np.sqrt(cos_o) * (cosines - 1)
                t0 = min(int(t), cosines - 2)
                ft = t - t0
                phi = np.arctan2(y, x) / (2.0 * np.pi) * azimuths
                cell = t0 * azimuths + int(np.floor(phi + 0.5)) % azimuths
                for m in range(count):
                    fresnel = reflectance[low, m] * (1.0 - f) + reflectance[low + 1, m] * f
                    amount = max(value[m], 0.0) * bare * fresnel
                    shares[i, cell, m] += amount * (1.0 - ft)
                    shares[i, cell + azimuths, m] += amount * ft
    return shares
