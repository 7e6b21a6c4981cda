# ruff: noqa: NPY002  # numba compiles the legacy generator only
"""An independent answer: a plain volumetric path tracer of flakes in a slab under a rough dielectric.

It shares no code with the walk and little of its method: double precision; flake normals drawn from D itself
(not from the visible ones) and met with probability |w.m|, so that neither the projected area nor the sampling
of visible normals enters; GGX facets by Heitz's 2018 construction; one wavelength at a time. (Mitsuba's `sggx`
cannot serve as reference: it evaluates rightly and samples wrongly.)
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np


@numba.njit(cache=False)
def _fresnel(cos: float, eta: float) -> tuple[float, float]:
    sin2 = (1 - cos * cos) / (eta * eta)
    if sin2 >= 1:
        return 1.0, 0.0
    cos_t = math.sqrt(1 - sin2)
    s = (cos - eta * cos_t) / (cos + eta * cos_t)
    p = (eta * cos - cos_t) / (eta * cos + cos_t)
    return 0.5 * (s * s + p * p), cos_t


@numba.njit(cache=False)
def _facet(v: Any, ax: float, ay: float) -> Any:
    """A facet normal that v (z > 0) sees."""
    h = np.array([ax * v[0], ay * v[1], v[2]])
    h /= math.sqrt(h[0] ** 2 + h[1] ** 2 + h[2] ** 2)
    flat = h[0] ** 2 + h[1] ** 2
    t1 = np.array([1.0, 0.0, 0.0])
    if flat > 1e-14:
        t1 = np.array([-h[1], h[0], 0.0]) / math.sqrt(flat)
    t2 = np.cross(h, t1)
    r, phi = math.sqrt(np.random.random()), 2 * math.pi * np.random.random()
    p1, p2 = r * math.cos(phi), r * math.sin(phi)
    s = 0.5 * (1 + h[2])
    p2 = (1 - s) * math.sqrt(max(0.0, 1 - p1 * p1)) + s * p2
    n = p1 * t1 + p2 * t2 + math.sqrt(max(0.0, 1 - p1 * p1 - p2 * p2)) * h
    m = np.array([ax * n[0], ay * n[1], max(1e-9, n[2])])
    return m / math.sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)


@numba.njit(cache=False)
def _g1(w: Any, ax: float, ay: float) -> float:
    tan2 = ((ax * w[0]) ** 2 + (ay * w[1]) ** 2) / max(w[2] * w[2], 1e-18)
    return 2 / (1 + math.sqrt(1 + tan2))


@numba.njit(cache=False)
def _interface(v: Any, eta: float, ax: float, ay: float) -> tuple[Any, bool]:
    """Scatter at the interface, v (z > 0) pointing back; eta across. Return the direction, and if it survives."""
    m = np.array([0.0, 0.0, 1.0])
    if ax > 0:
        m = _facet(v, ax, ay)
    cos = v[0] * m[0] + v[1] * m[1] + v[2] * m[2]
    reflectance, cos_t = _fresnel(cos, eta)
    if np.random.random() < reflectance:
        w = 2 * cos * m - v
        good = w[2] > 0
    else:
        w = (cos / eta - cos_t) * m - v / eta
        good = w[2] < 0
    if good and ax > 0:
        good = np.random.random() < _g1(w, ax, ay)
    return w, good


@numba.njit(cache=False)
def trace_slab(
    count: int, seed: int, number: float, root: Any, coefficients: Any, ax: float, ay: float, index: float,
    albedo: float, wi: Any, dye_extinction: float, dye_scattering: float, dye_phase: Any,
) -> Any:  # fmt: skip
    """Trace `count` paths from `wi`.

    Args:
        number: flakes along the mean normal.
        root: A with A A^T = S.
        coefficients: r0, r1, t0, t1 of R = r0 + r1 c, T = t0 + t1 c.
        dye_extinction, dye_scattering: optical thicknesses of a dye along the normal.
        dye_phase: its phase function over uniform nodes of the cosine in [-1, 1], drawn by rejection.

    Returns:
        exit directions `[count, 3]`, zero where absorbed.
    """
    np.random.seed(seed)
    total = 0.0  # integral of D over the sphere: mean of |A n| over uniform n, times 4
    grid = 400
    for i in range(grid):
        for j in range(2 * grid):
            z, phi = -1 + (i + 0.5) * 2 / grid, (j + 0.5) * math.pi / grid
            s = math.sqrt(1 - z * z)
            n = root @ np.array([s * math.cos(phi), s * math.sin(phi), z])
            total += math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    total *= 4 / (2 * grid * grid)
    result = np.zeros((count, 3))
    rate = 0.5 * number * total + dye_extinction
    r0, r1, t0, t1 = coefficients
    for path in range(count):
        w, good = _interface(wi, index, ax, ay)
        if not good:
            continue
        if w[2] > 0:
            result[path] = w
            continue
        z = 0.0
        while True:
            z += w[2] * (-math.log(1 - np.random.random()) / max(rate, 1e-12))
            if z >= 0:
                z = 0.0
                v = np.array([-w[0], -w[1], w[2]])  # mirrored, so that the inside lies above
                out, good = _interface(v, 1 / index, ax, ay)
                if not good:
                    break
                w = np.array([out[0], out[1], -out[2]])
                if w[2] > 0:
                    result[path] = w
                    break
            elif z <= -1:
                z = -1.0
                if np.random.random() >= albedo:
                    break
                r, phi = math.sqrt(np.random.random()), 2 * math.pi * np.random.random()
                w = np.array([r * math.cos(phi), r * math.sin(phi), math.sqrt(max(1e-12, 1 - r * r))])
            elif np.random.random() * rate < dye_extinction:
                if np.random.random() * dye_extinction >= dye_scattering:
                    break
                while True:
                    c = 2 * np.random.random() - 1
                    at = 0.5 * (c + 1) * (len(dye_phase) - 1)
                    low = min(int(at), len(dye_phase) - 2)
                    here = dye_phase[low] + (at - low) * (dye_phase[low + 1] - dye_phase[low])
                    if np.random.random() * dye_phase.max() < here:
                        break
                s, phi = math.sqrt(1 - c * c), 2 * math.pi * np.random.random()
                side = np.array([1.0, 0.0, 0.0]) if abs(w[2]) > 0.5 else np.array([0.0, 0.0, 1.0])
                a = np.cross(w, side)
                a /= math.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
                w = c * w + s * math.cos(phi) * a + s * math.sin(phi) * np.cross(w, a)
                w /= math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
            else:
                while True:  # a normal from D: uniform n, kept in proportion to |A n| (at most 1)
                    c, phi = 2 * np.random.random() - 1, 2 * math.pi * np.random.random()
                    s = math.sqrt(1 - c * c)
                    n = root @ np.array([s * math.cos(phi), s * math.sin(phi), c])
                    length = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
                    if np.random.random() < length:
                        break
                m = n / length
                cos = w[0] * m[0] + w[1] * m[1] + w[2] * m[2]
                if np.random.random() >= abs(cos):
                    continue  # the ray passes this flake's edge
                choice, face = np.random.random(), abs(cos)
                reflect, transmit = r0 + r1 * face, t0 + t1 * face
                if choice < reflect:
                    w = w - 2 * cos * m
                elif choice >= reflect + transmit:
                    break
    return result
