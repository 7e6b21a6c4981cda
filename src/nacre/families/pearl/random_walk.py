"""Compiled loops that make the tables of `quality = "fast"`: random walks of all wavelengths together.

A tally is a table of hat functions over the coordinates of `nacre.bsdf.lobes.platelet_layer.place`.
Light that was reflected by
one flake only, and by nothing else inside, is drawn without a walk (`single`): a lattice of points instead of
random ones, and depth integrated in closed form. `walk` collects the rest.
"""

from __future__ import annotations

import math

import numpy as np

from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.lobes.platelet_layer import flake_lobe, masking, place
from nacre.bsdf.random_walk import (
    ENDS,
    MAX_EVENTS,
    TURNS,
    chosen,
    damp,
    facet,
    flake,
    flakes_met,
    inner_facet,
    into,
    lattice,
    row,
    scatter,
    turned_back,
    upward,
    weigh,
)
from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.core.parallel import in_threads
from nacre.families.pearl.platelet import lost_share

# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread


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


# Compiled loops for a few directions of view: random walks of all wavelengths together, connected to each viewer.

# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread


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


# Light lost by the "published" energy balance of a platelet: R T of what meets a flake, summed over random walks.

# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread


CHUNKS = 8  # sums are taken in this order, whatever the number of threads
WALKS = 32_768  # a standard error of about 0.002
BASES = {"none": 0, "diffuse": 1, "specular": 2}


def why_not_lost(lobe: Layered) -> str | None:
    """Return why the lost light is not known, or None if it is."""
    if lobe.strata > 1:
        return "it has several strata"
    if lobe.base not in BASES:
        return "its base is another material"
    if lobe.dye_phase is not None:
        return "its dye scatters"
    if lobe.loss is not None:
        return "its interface is compensated"
    if np.any(lobe.alpha[:, 0] != lobe.alpha[:, 1]):
        return "its interface is anisotropic"
    if np.any(lobe.is_beckmann[lobe.alpha[:, 0] > 0]):
        return "its interface is of the Beckmann kind"
    return None


def lost_light(lobe: Layered, published: Array, wi: Array, walks: int = WALKS, seed: int = 0) -> Array:
    """Return the share of the light from `wi[3]` that is lost at flakes, `[wavelength]`.

    Args:
        lobe: one for which `why_not_lost` is None; its tables hold R (1 - T) where flakes are counted so.
        published: `[kind]`, bool: which kinds are.
        wi: unit vector to the light, above the surface.
        walks: their number, of all wavelengths together.
        seed: another one gives independent noise.
    """
    reflect, transmit = np.ascontiguousarray(lobe.flake_response[..., 0]), lobe.flake_response[..., 1]
    lose = lost_share(reflect, transmit) * np.asarray(published, dtype=float)[:, None, None]
    absorb = np.zeros(0) if lobe.dye is None else np.ascontiguousarray(lobe.dye[0, :, 0])
    tables = (reflect, np.ascontiguousarray(transmit), np.ascontiguousarray(lose), absorb)
    flakes = (lobe.flake_number, np.ascontiguousarray(lobe.flake_axes), np.ascontiguousarray(lobe.flake_frame))
    base = (BASES[lobe.base], np.ascontiguousarray(lobe.base_reflectance))
    faces = (float(lobe.index[0]), np.ascontiguousarray(lobe.alpha[:, 0]))

    def chunk(i: int) -> Array:
        out = np.zeros(len(lobe.wavelengths_nm))
        _lose((seed * 7919 + i) % (1 << 31), walks // CHUNKS, wi, *faces, *flakes, *tables, *base, out)
        return out

    return np.asarray(np.mean(in_threads(chunk, range(CHUNKS)), axis=0))


@compiled(nogil=True)
def _nodes(table, position, out):  # type: ignore[no-untyped-def]  # numba
    """Interpolate the rows of a table at a position counted in rows; one row serves everywhere."""
    if table.shape[0] == 1:
        out[:] = table[0]
        return
    low = min(int(position), table.shape[0] - 2)
    part = position - low
    for l in range(out.size):
        out[l] = table[low, l] + part * (table[low + 1, l] - table[low, l])


@compiled(nogil=True)
def _kept(f, share):  # type: ignore[no-untyped-def]  # numba
    """Multiply the throughputs by shares; end the walk by chance, or scale them to the sum they had."""
    before, after = 0.0, 0.0
    for l in range(f.size):
        before += f[l]
        f[l] *= share[l]
        after += f[l]
    if after <= 0.0 or np.random.random() * before >= after:
        return False
    for l in range(f.size):
        f[l] *= before / after
    return True


@compiled(nogil=True)
def _inside(dx, dy, dz, index, alpha):  # type: ignore[no-untyped-def]  # numba
    """Meet the interface above from inside, dz > 0: the direction back down, dz = 0 where light left or was masked."""
    mx, my, mz, cos, share, _ = inner_facet(dx, dy, dz, index, alpha)
    return turned_back(dx, dy, dz, mx, my, mz, cos, share, alpha)


@compiled(nogil=True)
def _lose(  # type: ignore[no-untyped-def]  # numba
    seed, count, wi, index, alpha, number, axes, frame, reflect, transmit, lose, absorb, kind, base, out
):
    """Add the mean over `count` walks of what is lost at the flakes that they meet, `out[wavelength]`.

    A walk carries all wavelengths; it is reflected, goes on or ends in proportion to what all of them together do.
    """
    np.random.seed(seed)
    f, share = np.empty(out.size), np.empty(out.size)
    go, gone = np.empty(out.size), np.empty(out.size)
    areas, local, m, d = np.zeros(number.size), np.empty(3), np.empty(3), np.empty(3)
    for _walk in range(count):
        d[0], d[1], d[2], start = into(wi[0], wi[1], wi[2], index, alpha[0], np.random.random(), np.random.random())
        if start == 0.0:
            continue
        f[:] = start / count
        depth = 0.0
        for _event in range(MAX_EVENTS):
            total = 0.0
            for k in range(number.size):
                square = 0.0
                for a in range(3):
                    along = (frame[k, 0, a] * d[0] + frame[k, 1, a] * d[1] + frame[k, 2, a] * d[2]) * axes[k, a]
                    square += along * along
                areas[k] = number[k] * math.sqrt(square)
                total += areas[k]
            before = depth
            depth = min(max(depth + d[2] * math.log(1.0 - np.random.random()) / max(total, 1e-12), 0.0), 1.0)
            if absorb.size:
                for l in range(out.size):
                    share[l] = math.exp(-absorb[l] * abs(depth - before) / max(abs(d[2]), 1e-6))
                if not _kept(f, share):
                    break
            if depth <= 0.0:
                d[0], d[1], d[2] = _inside(d[0], d[1], d[2], index, alpha[0])
                if d[2] == 0.0:
                    break
            elif depth >= 1.0:
                if kind == 0:
                    d[0], d[1], d[2] = _inside(d[0], d[1], -d[2], index, alpha[1])
                    if d[2] == 0.0:
                        break
                    d[2] = -d[2]
                elif kind == 1:
                    if not _kept(f, base[0]):
                        break
                    d[0], d[1], d[2] = upward()
                else:
                    mx, my, mz = facet(-d[0], -d[1], -d[2], alpha[1], np.random.random(), np.random.random())
                    cos = -(d[0] * mx + d[1] * my + d[2] * mz)
                    _nodes(base, min(cos, 1.0) * (base.shape[0] - 1), share)
                    d[0], d[1], d[2] = d[0] + 2.0 * cos * mx, d[1] + 2.0 * cos * my, d[2] + 2.0 * cos * mz
                    if d[2] <= 1e-6 or (alpha[1] > 0.0 and np.random.random() >= masking(d[2], alpha[1])):
                        break
                    if not _kept(f, share):
                        break
            else:
                k = chosen(areas, total)
                # a normal that the light sees: a cosine-distributed vector about S^(1/2) d, mapped by S^(1/2)
                length = 0.0
                for a in range(3):
                    local[a] = (frame[k, 0, a] * d[0] + frame[k, 1, a] * d[1] + frame[k, 2, a] * d[2]) * axes[k, a]
                    length += local[a] * local[a]
                length = math.sqrt(length)
                z, phi = 2.0 * np.random.random() - 1.0, 2.0 * math.pi * np.random.random()
                side = math.sqrt(1.0 - z * z)
                local[0] = axes[k, 0] * (local[0] * (1.0 + 1e-9) / length + side * math.cos(phi))
                local[1] = axes[k, 1] * (local[1] * (1.0 + 1e-9) / length + side * math.sin(phi))
                local[2] = axes[k, 2] * (local[2] * (1.0 + 1e-9) / length + z)
                length, cos = math.sqrt(local[0] ** 2 + local[1] ** 2 + local[2] ** 2), 0.0
                for a in range(3):
                    m[a] = (frame[k, a, 0] * local[0] + frame[k, a, 1] * local[1] + frame[k, a, 2] * local[2]) / length
                    cos += m[a] * d[a]
                at = math.sqrt(min(abs(cos), 1.0)) * (reflect.shape[1] - 1)
                _nodes(reflect[k], at, share)
                _nodes(transmit[k], at, go)
                _nodes(lose[k], at, gone)
                carried, back, on = 0.0, 0.0, 0.0
                for l in range(out.size):
                    carried += f[l]
                    back += f[l] * share[l]
                    on += f[l] * go[l]
                choice = np.random.random() * carried
                if choice < back:
                    for l in range(out.size):
                        f[l] *= share[l] * carried / back
                    for a in range(3):
                        d[a] -= 2.0 * cos * m[a]
                    if abs(d[2]) < 1e-9:
                        d[2] = 1e-9
                elif choice < back + on:
                    for l in range(out.size):
                        f[l] *= go[l] * carried / on
                else:  # counted where walks end, which varies less than a part of each event
                    for l in range(out.size):
                        out[l] += f[l] * gone[l] * carried / (carried - back - on)
                    break
