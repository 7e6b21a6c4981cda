# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
"""Compiled loops for a few directions of view: random walks of all wavelengths together, connected to each viewer.

Where only six colours are asked for, a table of all directions (`fast.py`) is too much, and the walk of the plugin,
four wavelengths and one viewer at a time, repeats the same steps a hundred times. Here the light of one path is sent
from every flake that it meets to all viewers at once, in all wavelengths. What one flake reflects is left out and added
without a walk (`one_flake`): an even set of facets, depth integrated in closed form.

With d the direction of flight inside, e that of an exit inside, t the shares that the interface passes, n the index,

    f = 1/n^2 < t_i t_o sum over flakes met of R D(h) / (4 sigma(d)) exp(-tau(e) depth) / e_z >.
"""

from __future__ import annotations

import math

import numpy as np

from nacre.bsdf.walk_facets import inner_facet, into, turned_back, upward
from nacre.families.pearl.walk_steps import (
    ENDS,
    MAX_EVENTS,
    TURNS,
    chosen,
    damp,
    flakes_met,
    lattice,
    row,
    scatter,
    weigh,
)
from nacre.matter.jit import compiled


@compiled(nogil=True)
def _area(z, sigma):  # type: ignore[no-untyped-def]  # numba
    return math.sqrt(sigma * sigma * (1.0 - z * z) + z * z)


@compiled(nogil=True)
def _density(hx, hy, hz, sigma):  # type: ignore[no-untyped-def]  # numba
    """SGGX density of flake normals, per steradian on the full sphere."""
    s2 = sigma * sigma
    q = (hx * hx + hy * hy) / s2 + hz * hz
    return 1.0 / (math.pi * s2 * q * q)


@compiled(nogil=True, fastmath=True)
def _depths(z, number, sigma, extinct, absorb, e, out):  # type: ignore[no-untyped-def]  # numba
    """Write the optical depth of the whole stratum along a cosine."""
    for l in range(out.size):
        out[l] = absorb[l] / z if absorb.size else 0.0
    for k in range(number.size):
        row(extinct[k], math.sqrt(min(z, 1.0)) * (extinct.shape[1] - 1), e)
        scale = np.float32(number[k] * _area(z, sigma[k]) / z)
        for l in range(out.size):
            out[l] += scale * e[l]


@compiled(nogil=True, fastmath=True)
def one_flake(wi, wo, first, count, cut, index, alpha, number, sigma, reflect, extinct, absorb, out):  # type: ignore[no-untyped-def]  # numba
    """Add what one flake reflects, `out[viewer, wavelength]`: a mean over `count` pairs of facets of the interface.

    Args:
        wi: `[3]`, to the light; wo: `[viewer, 3]`.
        first, count: points of an even set; cut: `[4]`, its shift.
        index, alpha: of the interface.
        number, sigma: `[kind]`, flakes met along the normal and the semi-axis of their normals.
        reflect: `[kind, cos, wavelength]`, float32, over nodes of sqrt(cos).
        extinct: `[kind, z, wavelength]`, float32, mean of 1 - T over the normals seen, over nodes of sqrt(z).
        absorb: `[wavelength]` optical thickness of the resin itself; empty for none.
    """
    bands = out.shape[1]
    r, e = np.empty(bands, np.float32), np.empty(bands, np.float32)
    down, up = np.empty(bands, np.float32), np.empty(bands, np.float32)
    u = np.empty(4)
    for point in range(first, first + count):
        lattice(point, cut, u)
        dx, dy, dz, enters = into(wi[0], wi[1], wi[2], index, alpha, u[0], u[1])
        if enters == 0.0:
            continue
        _depths(-dz, number, sigma, extinct, absorb, e, down)
        for v in range(wo.shape[0]):
            ex, ey, ez, leaves = into(wo[v, 0], wo[v, 1], wo[v, 2], index, alpha, u[2], u[3])
            if leaves == 0.0:
                continue
            _depths(-ez, number, sigma, extinct, absorb, e, up)
            # both point inward: the normal between the flight reversed and the exit is minus their sum
            hx, hy, hz = -dx - ex, -dy - ey, -dz - ez
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            hx, hy, hz = hx / length, hy / length, hz / length
            cos = min(abs(dx * hx + dy * hy + dz * hz), 1.0)
            share = enters * leaves / (index * index * 4.0 * dz * ez * count)
            for k in range(number.size):
                row(reflect[k], math.sqrt(cos) * (reflect.shape[1] - 1), r)
                scale = np.float32(share * number[k] * _density(hx, hy, hz, sigma[k]))
                for l in range(bands):
                    a = down[l] + up[l]
                    hit = (1.0 - math.exp(-a)) / a if a > 1e-3 else 1.0 - 0.5 * a
                    out[v, l] += scale * r[l] * hit


@compiled(nogil=True, fastmath=True)
def rest(  # type: ignore[no-untyped-def]  # numba
    wi, wo, seed, count, index, alpha, number, sigma, reflect, transmit, extinct, absorb, albedo, out
):
    """Add all that is not the interface's own light nor that of one flake, `out[viewer, wavelength]`: `count` walks.

    Args:
        wi, wo, index, alpha, number, sigma, reflect, extinct, absorb: as of `one_flake`.
        transmit: as `reflect`.
        albedo: `[wavelength]` of the base.
    """
    np.random.seed(seed)
    bands, viewers = out.shape[1], wo.shape[0]
    f, r, t = np.empty(bands, np.float32), np.empty(bands, np.float32), np.empty(bands, np.float32)
    areas = np.zeros(number.size)
    exits, shares = np.empty((viewers, 3)), np.empty(viewers)
    tau = np.empty((viewers, bands), np.float32)
    for _path in range(count):
        dx, dy, dz, start = into(wi[0], wi[1], wi[2], index, alpha, np.random.random(), np.random.random())
        if start == 0.0:
            continue
        for v in range(viewers):
            x, y, z, leaves = into(wo[v, 0], wo[v, 1], wo[v, 2], index, alpha, np.random.random(), np.random.random())
            exits[v, 0], exits[v, 1], exits[v, 2] = -x, -y, -z
            shares[v] = start * leaves / (index * index * count)
            if leaves > 0.0:
                _depths(-z, number, sigma, extinct, absorb, r, tau[v])
        depth, order = 0.0, 0
        f[:] = 1.0
        for _event in range(MAX_EVENTS):
            total = flakes_met(dx, dy, dz, number, sigma, areas)
            flight = -math.log(1.0 - np.random.random()) / max(total, 1e-12)
            new = depth - dz * flight
            if absorb.size:
                damp(f, absorb, abs(min(max(new, 0.0), 1.0) - depth) / max(abs(dz), 1e-6))
            depth = new
            if depth >= 1.0:
                carried, back = weigh(f, albedo)
                for v in range(viewers):
                    scale = np.float32(shares[v] / math.pi)
                    if scale > 0.0:
                        for l in range(bands):
                            out[v, l] += scale * f[l] * math.exp(-tau[v, l])
                if np.random.random() * carried >= back:
                    break
                for l in range(bands):
                    f[l] *= carried / back
                depth = 1.0
                dx, dy, dz = upward()
                order += 2
                continue
            if depth <= 0.0:
                depth = 0.0
                mx, my, mz, cos, share, _ = inner_facet(dx, dy, dz, index, alpha)
                dx, dy, dz = turned_back(dx, dy, dz, mx, my, mz, cos, share, alpha)
                if dz == 0.0:
                    break
                order += 1
                continue
            k = chosen(areas, total)
            if order > 0:  # what one flake alone turns is not walked for
                for v in range(viewers):
                    if shares[v] <= 0.0:
                        continue
                    hx, hy, hz = exits[v, 0] - dx, exits[v, 1] - dy, exits[v, 2] - dz
                    length = math.sqrt(hx * hx + hy * hy + hz * hz)
                    if length < 1e-9:
                        continue
                    hx, hy, hz = hx / length, hy / length, hz / length
                    cos = min(abs(dx * hx + dy * hy + dz * hz), 1.0)
                    worth = np.float32(
                        shares[v] * _density(hx, hy, hz, sigma[k]) * number[k] / (4.0 * areas[k] * exits[v, 2])
                    )
                    row(reflect[k], math.sqrt(cos) * (reflect.shape[1] - 1), r)
                    by = np.float32(depth)
                    for l in range(bands):
                        out[v, l] += worth * f[l] * r[l] * math.exp(-tau[v, l] * by)
            event, dx, dy, dz = scatter(dx, dy, dz, sigma[k], reflect[k], transmit[k], f, r, t)
            if event == ENDS:
                break
            if event == TURNS:
                order += 1
