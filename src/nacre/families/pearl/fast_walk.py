# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
"""Compiled loops that make the tables of `quality = "fast"`: random walks of all wavelengths together.

A tally is a table of hat functions over the coordinates of `nacre.bsdf.lobes.flaked.place`. Light that was reflected by
one flake only, and by nothing else inside, is drawn without a walk (`single`): a lattice of points instead of
random ones, and depth integrated in closed form. `walk` collects the rest.
"""

from __future__ import annotations

import math

import numpy as np

from nacre.bsdf.lobes.flaked import flake_lobe, masking, place
from nacre.bsdf.walk_facets import facet, inner_facet, into, turned_back, upward
from nacre.families.pearl.walk_steps import (
    ENDS,
    MAX_EVENTS,
    TURNS,
    chosen,
    damp,
    flake,
    flakes_met,
    lattice,
    row,
    scatter,
    weigh,
)
from nacre.matter.jit import compiled

ANY_ANGLE, FROM_BASE = -1.0, -2.0


@compiled(nogil=True)
def corners(x, shape, cells, weights):  # type: ignore[no-untyped-def]  # numba
    """Write the flat positions and weights of the eight nodes around a point."""
    for corner in range(8):
        cell, weight = 0, 1.0
        for axis in range(3):
            at = x[axis] * (shape[axis] - 1)
            low = min(int(at), shape[axis] - 2)
            part = at - low
            up = (corner >> axis) & 1
            cell = cell * shape[axis] + low + up
            weight *= part if up else 1.0 - part
        cells[corner], weights[corner] = cell, weight


@compiled(nogil=True, fastmath=True)
def _tally(table, cell, weight, f):  # type: ignore[no-untyped-def]  # numba
    for l in range(f.size):
        table[cell, l] += weight * f[l]


@compiled(nogil=True)
def ring(wx, ox, oy, spread, shape):  # type: ignore[no-untyped-def]  # numba
    """Return the bin of an exit for light from azimuth 0, by size and azimuth of q: the bins of a check."""
    qx = wx + ox
    q = math.sqrt(qx * qx + oy * oy)
    u = min(int(math.asinh(q / spread) / math.asinh(2.0 / spread) * shape[0]), shape[0] - 1)
    return u * shape[1] + min(int(math.atan2(abs(oy), qx) / math.pi * shape[1]), shape[1] - 1)


@compiled(nogil=True)
def find(wx, ox, oy, spread, shape, x3, cells, weights):  # type: ignore[no-untyped-def]  # numba
    """Write where an exit is tallied, return in how many cells: hats of the table, or one bin of a check."""
    if shape.size == 2:
        cells[0], weights[0] = ring(wx, ox, oy, spread, shape), 1.0
        return 1
    place(wx, 0.0, ox, oy, spread, x3)
    corners(x3, shape, cells, weights)
    return 8


@compiled(nogil=True, fastmath=True)
def walk(  # type: ignore[no-untyped-def]  # numba
    seed, count, angle, albedo, index, alpha, number, sigma, reflect, transmit, absorb, spread, shape, table, base
):
    """Follow light until it leaves, is absorbed or arrives at the base.

    Args:
        seed, count: of the walks.
        angle: of the light; ANY_ANGLE: uniform and stratified; FROM_BASE: diffuse light that starts at the base.
        albedo: `[wavelength]` of the base, from which light goes on; empty: it ends there.
        reflect, transmit: `[kind, cos, wavelength]`, float32, over nodes of sqrt(cos).
        absorb: `[wavelength]` optical thickness of the resin itself; empty for none.
        table: `[cell, wavelength]`, gets what leaves after more than a single reflection by a flake.
        base: `[cos, wavelength]`, gets what arrives at the base; one row if `from_base`.

    Returns:
        the number of entries in `table`.
    """
    np.random.seed(seed)
    bands = reflect.shape[2]
    f, r, t = np.empty(bands, np.float32), np.empty(bands, np.float32), np.empty(bands, np.float32)
    areas = np.zeros(number.size)
    x3, cells, weights = np.empty(3), np.empty(8, np.int64), np.empty(8)
    entries = 0
    from_base = angle == FROM_BASE
    for path in range(count):
        wx, wz = 0.0, 1.0
        if from_base:
            wz = math.sqrt((path + np.random.random()) / count)
            dx, dy, dz = math.sqrt(max(0.0, 1.0 - wz * wz)), 0.0, max(wz, 1e-6)
            depth, start = 1.0, 1.0
        else:
            theta = angle if angle >= 0.0 else 0.5 * math.pi * (path + np.random.random()) / count
            wx, wz = math.sin(theta), max(math.cos(theta), 1e-6)
            dx, dy, dz, start = into(wx, 0.0, wz, index, alpha, np.random.random(), np.random.random())
            depth = 0.0
            if start == 0.0:
                continue
        f[:] = 1.0
        order = 0
        for _event in range(MAX_EVENTS):
            total = flakes_met(dx, dy, dz, number, sigma, areas)
            flight = -math.log(1.0 - np.random.random()) / max(total, 1e-12)
            new = depth - dz * flight
            if absorb.size:
                end = min(max(new, 0.0), 1.0)
                damp(f, absorb, abs(end - depth) / max(abs(dz), 1e-6))
            depth = new
            if depth >= 1.0:
                if albedo.size:
                    depth = 1.0
                    carried, back = weigh(f, albedo)
                    if np.random.random() * carried >= back:
                        break
                    for l in range(bands):
                        f[l] *= carried / back
                    dx, dy, dz = upward()
                    order += 2
                    continue
                if from_base:
                    _tally(base, 0, 1.0, f)
                else:
                    at = wz * (base.shape[0] - 1)
                    low = min(int(at), base.shape[0] - 2)
                    _tally(base, low, start * (low + 1 - at), f)
                    _tally(base, low + 1, start * (at - low), f)
                break
            if depth <= 0.0:
                depth = 0.0
                mx, my, mz, cos, share, cos_t = inner_facet(dx, dy, dz, index, alpha)
                if share < 1.0 and order > 1 and not from_base:
                    a = cos * index - cos_t
                    ox, oy, oz = a * mx + dx * index, a * my + dy * index, dz * index - a * mz
                    if oz > 1e-6:
                        worth = start * (1.0 - share)
                        if alpha > 0.0:
                            worth *= masking(oz, alpha)
                        for corner in range(find(wx, ox, oy, spread, shape, x3, cells, weights)):
                            _tally(table, cells[corner], worth * weights[corner], f)
                        entries += 1
                dx, dy, dz = turned_back(dx, dy, dz, mx, my, mz, cos, share, alpha)
                if dz == 0.0:
                    break
                order += 1
                continue
            k = chosen(areas, total)
            event, dx, dy, dz = scatter(dx, dy, dz, sigma[k], reflect[k], transmit[k], f, r, t)
            if event == ENDS:
                break
            if event == TURNS:
                order += 1
    return entries


@compiled(nogil=True, fastmath=True)
def single(first, count, cut, angle, index, alpha, number, sigma, reflect, extinct, absorb, spread, shape, table):  # type: ignore[no-untyped-def]  # numba
    """Draw light that one flake reflects: lattice points `first` to `first + count`, depth in closed form.

    Args:
        cut: `[7]`, shift of the lattice.
        angle: of the light, or ANY_ANGLE.
        extinct: `[kind, z, wavelength]`, float32, mean of 1 - T over the normals seen, over nodes of sqrt(z).
        table: `[cell, wavelength]`, gets the light.
    """
    bands = reflect.shape[2]
    value, r, e = np.empty(bands, np.float32), np.empty(bands, np.float32), np.empty(bands, np.float32)
    depth = np.empty(bands, np.float32)
    areas = np.zeros(number.size)
    x3, u, cells, weights = np.empty(3), np.empty(7), np.empty(8, np.int64), np.empty(8)
    for point in range(first, first + count):
        lattice(point, cut, u)
        theta = angle if angle >= 0.0 else 0.5 * math.pi * u[0]
        wx, wz = math.sin(theta), max(math.cos(theta), 1e-6)
        dx, dy, dz, start = into(wx, 0.0, wz, index, alpha, u[1], u[2])
        if start == 0.0:
            continue
        total = flakes_met(dx, dy, dz, number, sigma, areas)
        kind, part = 0, u[3]
        for k in range(number.size):
            chance = areas[k] / total
            if part < chance or k == number.size - 1:
                kind, part = k, min(part / chance, 1.0)
                break
            part -= chance
        mx, my, mz = flake(-dx, -dy, -dz, sigma[kind], part, u[4])
        cos = -(dx * mx + dy * my + dz * mz)
        ex, ey, ez = dx + 2.0 * cos * mx, dy + 2.0 * cos * my, dz + 2.0 * cos * mz
        if ez <= 1e-6:
            continue
        ox, oy, oz, passed = into(-ex, -ey, ez, 1.0 / index, alpha, u[5], u[6])
        if passed == 0.0:
            continue
        ox, oy, oz = ox, oy, -oz
        row(reflect[kind], math.sqrt(min(abs(cos), 1.0)) * (reflect.shape[1] - 1), r)
        for l in range(bands):
            depth[l] = absorb[l] * (1.0 / -dz + 1.0 / ez) if absorb.size else 0.0
        for k in range(number.size):
            row(extinct[k], math.sqrt(-dz) * (extinct.shape[1] - 1), e)
            scale = np.float32(areas[k] / -dz)
            for l in range(bands):
                depth[l] += scale * e[l]
            row(extinct[k], math.sqrt(min(ez, 1.0)) * (extinct.shape[1] - 1), e)
            area = number[k] * math.sqrt(sigma[k] * sigma[k] * (ex * ex + ey * ey) + ez * ez)
            scale = np.float32(area / ez)
            for l in range(bands):
                depth[l] += scale * e[l]
        scale = np.float32(start * passed * total / -dz)
        for l in range(bands):
            a = depth[l]
            hit = (1.0 - math.exp(-a)) / a if a > 1e-3 else 1.0 - 0.5 * a
            value[l] = scale * r[l] * hit
        for corner in range(find(wx, ox, oy, spread, shape, x3, cells, weights)):
            _tally(table, cells[corner], weights[corner], value)


@compiled(nogil=True)
def widths(cos, index, alpha, sigma, out):  # type: ignore[no-untyped-def]  # numba
    """Write the two GGX widths, narrow and wide, that match the flakes' lobes about the outer half vector."""
    inner = index * math.sqrt(1.0 - (1.0 - cos * cos) / (index * index))
    bend = ((inner - cos) * alpha) ** 2 / (2.0 * inner * inner)
    out[0] = min(inner / cos * math.sqrt(sigma.min() ** 2 + bend), 2.0)
    out[1] = min(inner / cos * math.sqrt(sigma.max() ** 2 + bend), 2.0)


@compiled(nogil=True)
def draw(wx, wz, alphas, u1, u2, choice):  # type: ignore[no-untyped-def]  # numba
    """Draw an exit for light from azimuth 0, from two facet lobes and a cosine: direction and density (0: none)."""
    if choice < 0.7:
        mx, my, mz = facet(wx, 0.0, wz, alphas[0] if choice < 0.35 else alphas[1], u1, u2)
        cos = wx * mx + wz * mz
        ox, oy, oz = 2.0 * cos * mx - wx, 2.0 * cos * my, 2.0 * cos * mz - wz
    else:
        oz, phi = math.sqrt(u1), 2.0 * math.pi * u2
        ox, oy = math.sqrt(1.0 - oz * oz) * math.cos(phi), math.sqrt(1.0 - oz * oz) * math.sin(phi)
    if oz <= 1e-6:
        return ox, oy, oz, 0.0
    density = 0.3 * oz / math.pi
    hx, hy, hz = wx + ox, oy, wz + oz
    length2 = hx * hx + hy * hy + hz * hz
    for a in alphas:
        slope = ((hx * hx + hy * hy) / (a * a) + hz * hz) / length2
        density += 0.35 * masking(wz, a) / (math.pi * a * a * slope * slope * 4.0 * wz)
    return ox, oy, oz, density


@compiled(nogil=True)
def mass(first, count, cut, index, alpha, number, sigma, spread, entry, shape, table):  # type: ignore[no-untyped-def]  # numba
    """Integrate K t_i t_o cos_o times pairs of hat functions over the same measure as the walks.

    Args:
        table: `[cell, 27]`, neighbours in order of their steps (-1, 0, 1) along the three axes.
    """
    x3, u, cells, weights = np.empty(3), np.empty(4), np.empty(8, np.int64), np.empty(8)
    alphas = np.empty(2)
    for point in range(first, first + count):
        lattice(point, cut, u)
        angle = 0.5 * math.pi * u[0]
        wx, wz = math.sin(angle), max(math.cos(angle), 1e-6)
        widths(wz, index, alpha, sigma, alphas)
        ox, oy, oz, density = draw(wx, wz, alphas, u[1], u[2], u[3])
        if density == 0.0:
            continue
        passes = oz
        for cos in (wz, oz):
            at = math.sqrt(min(cos, 1.0)) * (entry.size - 1)
            i = min(int(at), entry.size - 2)
            passes *= entry[i] + (at - i) * (entry[i + 1] - entry[i])
        worth = passes * flake_lobe(wx, 0.0, wz, ox, oy, oz, index, alpha, number, sigma) / density
        place(wx, 0.0, ox, oy, spread, x3)
        corners(x3, shape, cells, weights)
        for one in range(8):
            for two in range(8):
                step = 0
                for axis in range(3):
                    step = 3 * step + ((two >> axis) & 1) - ((one >> axis) & 1) + 1
                table[cells[one], step] += worth * weights[one] * weights[two]
