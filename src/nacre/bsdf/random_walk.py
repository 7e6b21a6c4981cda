"""Compiled steps of a walk at an interface: isotropic GGX facets that refract and reflect, and a diffuse ground."""

from __future__ import annotations

import math

import numpy as np

from nacre.bsdf.lobes.platelet_layer import masking, reflected
from nacre.core.jit import compiled

# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread


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


# Compiled steps that all walks of all wavelengths together are made of: interface, flight, flake, base.

# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread


MAX_EVENTS = 20_000
ENDS, TURNS, PASSES = 0, 1, 2
# additive recurrence with the root of x^8 = x + 1 (a rank-1 lattice that can be cut anywhere)
_ROOT = 1.0969815577985598
LATTICE = np.array([_ROOT ** -(j + 1) % 1.0 for j in range(7)])


@compiled(nogil=True)
def lattice(point, cut, u):  # type: ignore[no-untyped-def]  # numba
    """Write a point of the lattice."""
    for j in range(u.size):
        at = (point + 0.5) * LATTICE[j] + cut[j]
        u[j] = at - math.floor(at)


@compiled(nogil=True)
def flake(x, y, z, sigma, u1, u2):  # type: ignore[no-untyped-def]  # numba
    """Draw a flake normal that a direction sees."""
    hx, hy, hz = sigma * x, sigma * y, z
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    c = 2.0 * u2 - 1.0
    s = math.sqrt(max(0.0, 1.0 - c * c))
    phi = 2.0 * math.pi * u1
    grown = (1.0 + 1e-9) / length
    mx, my, mz = sigma * (hx * grown + s * math.cos(phi)), sigma * (hy * grown + s * math.sin(phi)), hz * grown + c
    length = math.sqrt(mx * mx + my * my + mz * mz)
    return mx / length, my / length, mz / length


@compiled(nogil=True, fastmath=True)
def row(table, position, out):  # type: ignore[no-untyped-def]  # numba
    """Interpolate the rows of a table at a position counted in rows."""
    i = min(int(position), table.shape[0] - 2)
    f = np.float32(position - i)
    for l in range(out.size):
        out[l] = table[i, l] + f * (table[i + 1, l] - table[i, l])


@compiled(nogil=True, fastmath=True)
def damp(f, absorb, path):  # type: ignore[no-untyped-def]  # numba
    """Let the throughputs `f` pass the resin itself: `absorb` is its optical thickness along the normal."""
    for l in range(f.size):
        f[l] *= math.exp(-absorb[l] * path)


@compiled(nogil=True)
def flakes_met(x, y, z, number, sigma, areas):  # type: ignore[no-untyped-def]  # numba
    """Write how many flakes of each kind light along a direction meets in a unit of depth; return their sum."""
    total = 0.0
    for k in range(number.size):
        areas[k] = number[k] * math.sqrt(sigma[k] * sigma[k] * (x * x + y * y) + z * z)
        total += areas[k]
    return total


@compiled(nogil=True)
def chosen(areas, total):  # type: ignore[no-untyped-def]  # numba
    """Draw the kind of the flake that is met."""
    k = 0
    if areas.size > 1:
        left = np.random.random() * total - areas[0]
        while left >= 0.0 and k < areas.size - 1:
            k += 1
            left -= areas[k]
    return k


@compiled(nogil=True, fastmath=True)
def weigh(f, share):  # type: ignore[no-untyped-def]  # numba
    """Multiply the throughputs by shares; return their sums before and after."""
    before, after = np.float32(0.0), np.float32(0.0)
    for l in range(f.size):
        before += f[l]
        f[l] *= share[l]
        after += f[l]
    return before, after


@compiled(nogil=True, fastmath=True)
def scatter(dx, dy, dz, sigma, reflect, transmit, f, r, t):  # type: ignore[no-untyped-def]  # numba
    """Let a flake reflect the light, pass it or absorb it: TURNS, PASSES or ENDS, and the direction.

    Args:
        reflect, transmit: `[cos, wavelength]`, float32, over nodes of sqrt(cos).
        r, t: `[wavelength]`, float32, to work in.
    """
    mx, my, mz = flake(-dx, -dy, -dz, sigma, np.random.random(), np.random.random())
    cos = -(dx * mx + dy * my + dz * mz)
    at = math.sqrt(min(abs(cos), 1.0)) * (reflect.shape[0] - 1)
    row(reflect, at, r)
    row(transmit, at, t)
    carried, back, on = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for l in range(f.size):
        carried += f[l]
        back += f[l] * r[l]
        on += f[l] * t[l]
    choice = np.random.random() * carried
    if choice < back:
        scale = carried / back
        for l in range(f.size):
            f[l] *= r[l] * scale
        dx, dy, dz = dx + 2.0 * cos * mx, dy + 2.0 * cos * my, dz + 2.0 * cos * mz
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / length, dy / length, dz / length
        if abs(dz) < 1e-9:
            dz = 1e-9
        return TURNS, dx, dy, dz
    if choice < back + on:
        scale = carried / on
        for l in range(f.size):
            f[l] *= t[l] * scale
        return PASSES, dx, dy, dz
    return ENDS, dx, dy, dz
