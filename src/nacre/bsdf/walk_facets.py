# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
"""Compiled steps of a walk at an interface: isotropic GGX facets that refract and reflect, and a diffuse ground."""

from __future__ import annotations

import math

import numpy as np

from nacre.bsdf.lobes.flaked import masking, reflected
from nacre.matter.jit import compiled


@compiled(nogil=True)
def facet(x, y, z, alpha, u1, u2):  # type: ignore[no-untyped-def]  # numba
    """Draw a GGX facet that a direction (z > 0) sees; the normal itself where smooth."""
    if alpha <= 0.0:
        return 0.0, 0.0, 1.0
    hx, hy, hz = alpha * x, alpha * y, z
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / length, hy / length, hz / length
    c = (1.0 - u2) * (1.0 + hz) - hz
    s = math.sqrt(max(0.0, 1.0 - c * c))
    phi = 2.0 * math.pi * u1
    mx, my, mz = alpha * (hx + s * math.cos(phi)), alpha * (hy + s * math.sin(phi)), max(hz + c, 1e-9)
    length = math.sqrt(mx * mx + my * my + mz * mz)
    return mx / length, my / length, mz / length


@compiled(nogil=True)
def into(x, y, z, eta, alpha, u1, u2):  # type: ignore[no-untyped-def]  # numba
    """Refract light from a direction (z > 0) through a facet: the direction beyond (z < 0), the transmitted share."""
    mx, my, mz = facet(x, y, z, alpha, u1, u2)
    cos = x * mx + y * my + z * mz
    share, cos_t = reflected(min(cos, 1.0), eta)
    if share >= 1.0:
        return 0.0, 0.0, -1.0, 0.0
    a = cos / eta - cos_t
    wx, wy, wz = a * mx - x / eta, a * my - y / eta, a * mz - z / eta
    if wz >= -1e-6:
        return 0.0, 0.0, -1.0, 0.0
    passed = 1.0 - share
    if alpha > 0.0:
        passed *= masking(-wz, alpha)
    return wx, wy, wz, passed


@compiled(nogil=True)
def inner_facet(dx, dy, dz, index, alpha):  # type: ignore[no-untyped-def]  # numba
    """Draw the facet that light from inside meets, dz > 0: m, the cosine on it, the reflected share, the other cosine.

    Seen from inside, so mirrored: the inside lies above.
    """
    mx, my, mz = facet(-dx, -dy, dz, alpha, np.random.random(), np.random.random())
    cos = -dx * mx - dy * my + dz * mz
    share, cos_t = reflected(min(cos, 1.0), 1.0 / index)
    return mx, my, mz, cos, share, cos_t


@compiled(nogil=True)
def turned_back(dx, dy, dz, mx, my, mz, cos, share, alpha):  # type: ignore[no-untyped-def]  # numba
    """Reflect light at the facet of `inner_facet`: its direction, back down; z = 0 where it has left or is masked."""
    if np.random.random() >= share:
        return 0.0, 0.0, 0.0
    ex, ey, ez = 2.0 * cos * mx + dx, 2.0 * cos * my + dy, 2.0 * cos * mz - dz
    if ez <= 1e-6 or (alpha > 0.0 and np.random.random() >= masking(ez, alpha)):
        return 0.0, 0.0, 0.0
    return ex, ey, -ez


@compiled(nogil=True)
def upward():  # type: ignore[no-untyped-def]  # numba
    """Draw a direction of diffuse light from the base."""
    z = math.sqrt(max(np.random.random(), 1e-12))
    phi = 2.0 * math.pi * np.random.random()
    side = math.sqrt(1.0 - z * z)
    return side * math.cos(phi), side * math.sin(phi), z
