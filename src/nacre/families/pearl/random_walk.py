# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
# mypy: disable-error-code="no-untyped-def"
"""Random walks in one platelet stratum over a base: one analog walk with three estimators.

`walk` traces light through the stratum. It tallies exiting light in a table (for the tables of `quality = "fast"`), and
connects every platelet and the base with given viewers (next-event estimation, for the surrogate's correction). With d
the flight inside, e the exit inside, t the interface transmittances and n the index,

    f = 1/n^2 < t_i t_o sum over collisions R D(h) / (4 sigma(d)) exp(-tau(e) depth) / e_z >.

Single scattering by a platelet is excluded from both and integrated without a walk: over lattice points rather than
random ones, with the depth in closed form. `energy_defect` estimates the light that the "published" energy balance
loses at platelets with any orientation, also over an open or a metallic base.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.lobes.platelet_layer import flake_lobe, masking, place
from nacre.bsdf.random_walk import (
    ABSORBED,
    MAX_EVENTS,
    REFLECTED,
    TRANSMITTED,
    choose_kind,
    collision_rates,
    fly,
    interpolate_row,
    lattice_point,
    normal_density,
    projected_area,
    reflect_inside,
    refract,
    sample_diffuse,
    sample_facet,
    sample_inner_facet,
    sample_normal,
    scatter,
    share_light,
    survives,
    weight,
)
from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.core.machine import in_threads
from nacre.families.pearl.platelet import lost_share

CHUNKS = 8  # sums of walks, added in fixed order for any thread count
ANY_ANGLE = np.array([0.0, 0.0, 0.0])  # stratified over the polar angle, at azimuth 0
FROM_BASE = np.array([0.0, 0.0, -1.0])  # diffuse light that starts at the base
DEFECT_WALKS = 32_768  # standard error 0.002
BASES = {"none": 0, "diffuse": 1, "specular": 2}
NO_VIEWERS = np.zeros((0, 3))


class Medium(NamedTuple):
    """One stratum with isotropic platelets, as input to the compiled loops.

    Attributes:
        n: resin index.
        alpha: GGX roughness, upper interface.
        number: `[kind]`, platelets met along the normal.
        sigma: `[kind]`, semi-axis of their SGGX normals.
        reflect, transmit: `[kind, cos, wavelength]`, float32, on sqrt(cos) nodes.
        extinct: `[kind, z, wavelength]`, float32, mean 1 - T over visible normals, on sqrt(z) nodes.
        absorb: `[wavelength]`, resin optical thickness; empty for clear resin.
    """

    n: float
    alpha: float
    number: Array
    sigma: Array
    reflect: NDArray[np.float32]
    transmit: NDArray[np.float32]
    extinct: NDArray[np.float32]
    absorb: Array

    @classmethod
    def of(cls, lobe: Layered) -> Medium:
        """Return the medium for a layered lobe with one stratum."""
        count = len(lobe.wavelengths_nm)
        response = np.ascontiguousarray(np.moveaxis(lobe.flake_response, -1, 0), dtype=np.float32)
        extinct = np.ascontiguousarray(lobe.flake_extinction[:, 0], dtype=np.float32)
        if not lobe.kinds:
            response, extinct = np.zeros((2, 0, 2, count), np.float32), np.zeros((0, 2, count), np.float32)
        number, sigma = (np.ascontiguousarray(v, dtype=float) for v in (lobe.flake_number, lobe.flake_axes[:, 0]))
        index, alpha = float(lobe.index[0]), float(lobe.alpha[0, 0])
        return cls(index, alpha, number, sigma, response[0], response[1], extinct, _absorption(lobe))


class Tally(NamedTuple):
    """Histogram for light that leaves after more than one reflection.

    Attributes:
        spread: coordinate scale for `nacre.bsdf.lobes.platelet_layer.place`.
        shape: node counts for hat functions, or bin counts over length and azimuth of q for the check.
        table: `[cell, wavelength]`; if empty, this light is not recorded.
        base: `[cos, wavelength]`, light that reaches an absorbing base, for each incidence cosine.
    """

    spread: float
    shape: NDArray[np.int64]
    table: Array
    base: Array


def no_tally(bands: int) -> Tally:
    """Return an empty tally."""
    return Tally(1.0, np.ones(3, dtype=np.int64), np.zeros((0, bands)), np.zeros((1, bands)))


def _absorption(lobe: Layered) -> Array:
    return np.zeros(0) if lobe.dye is None else np.ascontiguousarray(lobe.dye[0, :, 0])


@compiled(nogil=True)
def _corners(x, shape, cells, weights):
    """Write flat indices and weights for the eight nodes around a point."""
    for corner in range(8):
        cell, part = 0, 1.0
        for axis in range(3):
            at = x[axis] * (shape[axis] - 1)
            low = min(int(at), shape[axis] - 2)
            up = (corner >> axis) & 1
            cell = cell * shape[axis] + low + up
            part *= at - low if up else 1.0 - at + low
        cells[corner], weights[corner] = cell, part


@compiled(nogil=True)
def _find_cells(wx, ox, oy, spread, shape, found):
    """Write the cells and weights for an exit, with light from azimuth 0; return their number."""
    cells, weights, point = found
    if shape.size == 2:
        qx = wx + ox
        u = math.asinh(math.sqrt(qx * qx + oy * oy) / spread) / math.asinh(2.0 / spread)
        turn = min(int(math.atan2(abs(oy), qx) / math.pi * shape[1]), shape[1] - 1)
        cells[0], weights[0] = min(int(u * shape[0]), shape[0] - 1) * shape[1] + turn, 1.0
        return 1
    place(wx, 0.0, ox, oy, spread, point)
    _corners(point, shape, cells, weights)
    return 8


@compiled(nogil=True, fastmath=True)
def _add(table, cell, part, f):
    for l in range(f.size):
        table[cell, l] += part * f[l]


@compiled(nogil=True)
def _start(light, path, count, index, alpha):
    """Return light's lateral and normal components outside, the flight inside, the depth and the transmitted share."""
    if light[2] < 0.0:
        z = math.sqrt((path + np.random.random()) / count)
        return 0.0, z, math.sqrt(max(0.0, 1.0 - z * z)), 0.0, max(z, 1e-6), 1.0, 1.0
    wx, wy, wz = light[0], light[1], light[2]
    if wz == 0.0:
        theta = 0.5 * math.pi * (path + np.random.random()) / count
        wx, wz = math.sin(theta), max(math.cos(theta), 1e-6)
    dx, dy, dz, share = refract(wx, wy, wz, index, alpha, np.random.random(), np.random.random())
    return wx, wz, dx, dy, dz, 0.0, share


@compiled(nogil=True, fastmath=True)
def _depths(z, medium, e, out):
    """Write the stratum's optical thickness along a cosine; `e` is scratch."""
    for l in range(out.size):
        out[l] = medium.absorb[l] / z if medium.absorb.size else 0.0
    for k in range(medium.number.size):
        interpolate_row(medium.extinct[k], math.sqrt(min(z, 1.0)) * (medium.extinct.shape[1] - 1), e)
        scale = np.float32(medium.number[k] * projected_area(z, medium.sigma[k]) / z)
        for l in range(out.size):
            out[l] += scale * e[l]


@compiled(nogil=True, fastmath=True)
def _aim(viewers, carried, medium, view, e):
    """Draw a facet for each viewer: the exit inside, its light share and the optical thickness towards it.

    `view` holds these three, `[viewer, ...]`; `e` is scratch.
    """
    exits, shares, tau = view
    for v in range(viewers.shape[0]):
        x, y, z, leaves = refract(
            viewers[v, 0], viewers[v, 1], viewers[v, 2], medium.n, medium.alpha, np.random.random(),
            np.random.random(),
        )  # fmt: skip
        exits[v, 0], exits[v, 1], exits[v, 2] = -x, -y, -z
        shares[v] = carried * leaves / (medium.n * medium.n)
        if leaves > 0.0:
            _depths(-z, medium, e, tau[v])


@compiled(nogil=True, fastmath=True)
def _connect_base(f, shares, tau, out):
    """Send diffuse light from the base to the viewers."""
    for v in range(shares.size):
        scale = np.float32(shares[v] / math.pi)
        if scale > 0.0:
            for l in range(f.size):
                out[v, l] += scale * f[l] * math.exp(-tau[v, l])


@compiled(nogil=True, fastmath=True)
def _connect_platelet(dx, dy, dz, depth, reach, sigma, reflect, f, r, view, out):
    """Send light reflected by a platelet to the viewers; `reach` is its number over 4 times the area that it shows."""
    exits, shares, tau = view
    by = np.float32(depth)
    for v in range(shares.size):
        if shares[v] <= 0.0:
            continue
        hx, hy, hz = exits[v, 0] - dx, exits[v, 1] - dy, exits[v, 2] - dz
        length = math.sqrt(hx * hx + hy * hy + hz * hz)
        if length < 1e-9:
            continue
        hx, hy, hz = hx / length, hy / length, hz / length
        cos = min(abs(dx * hx + dy * hy + dz * hz), 1.0)
        worth = np.float32(shares[v] * normal_density(hx, hy, hz, sigma) * reach / exits[v, 2])
        interpolate_row(reflect, math.sqrt(cos) * (reflect.shape[0] - 1), r)
        for l in range(f.size):
            out[v, l] += worth * f[l] * r[l] * math.exp(-tau[v, l] * by)


@compiled(nogil=True, fastmath=True)
def _tally_exit(wx, dx, dy, dz, facet, start, medium, tally, f, found):
    """Tally light refracted out by the facet from `sample_inner_facet`; return 1 for an entry, else 0."""
    mx, my, mz, cos, share, cos_t = facet
    a = cos * medium.n - cos_t
    ox, oy, oz = a * mx + dx * medium.n, a * my + dy * medium.n, dz * medium.n - a * mz
    if oz <= 1e-6:
        return 0
    worth = start * (1.0 - share)
    if medium.alpha > 0.0:
        worth *= masking(oz, medium.alpha)
    for corner in range(_find_cells(wx, ox, oy, tally.spread, tally.shape, found)):
        _add(tally.table, found[0][corner], worth * found[1][corner], f)
    return 1


@compiled(nogil=True, fastmath=True)
def _arrive(wz, start, f, base):
    """Tally light on an absorbing base by incidence cosine."""
    if base.shape[0] == 1:
        _add(base, 0, 1.0, f)
        return
    at = wz * (base.shape[0] - 1)
    low = min(int(at), base.shape[0] - 2)
    _add(base, low, start * (low + 1 - at), f)
    _add(base, low + 1, start * (at - low), f)


@compiled(nogil=True, fastmath=True)
def walk(seed, count, light, medium, albedo, tally, viewers, out):
    """Follow light until it leaves, is absorbed or arrives at an absorbing base.

    Args:
        seed, count: for the walks.
        light: `[3]`, unit vector to the light, ANY_ANGLE or FROM_BASE.
        medium: a `Medium`.
        albedo: `[wavelength]`, diffuse base; empty: absorbing.
        tally: a `Tally`; a given light direction has azimuth 0.
        viewers: `[viewer, 3]`, unit vectors, above the surface; may be empty.
        out: `[viewer, wavelength]`, gets the BRDF without the interface's own reflection and single scattering.

    Returns:
        the tally's number of entries.
    """
    np.random.seed(seed)
    index, alpha, number, sigma, reflect, transmit, _, absorb = medium
    bands, entries = reflect.shape[2], 0
    f, r, t = np.empty(bands, np.float32), np.empty(bands, np.float32), np.empty(bands, np.float32)
    areas, found = np.zeros(number.size), (np.empty(8, np.int64), np.empty(8), np.empty(3))
    many = viewers.shape[0]
    view = (np.empty((many, 3)), np.empty(many), np.empty((many, bands), np.float32))
    for path in range(count):
        wx, wz, dx, dy, dz, depth, start = _start(light, path, count, index, alpha)
        if start == 0.0:
            continue
        _aim(viewers, start / count, medium, view, r)
        f[:] = 1.0
        order = 0
        for _event in range(MAX_EVENTS):
            total = collision_rates(dx, dy, dz, number, sigma, areas)
            depth = fly(depth, dz, total, absorb, f)
            if depth >= 1.0:
                if albedo.size == 0:
                    _arrive(wz, start, f, tally.base)
                    break
                carried, back = weight(f, albedo)
                _connect_base(f, view[1], view[2], out)
                if not survives(f, carried, back):
                    break
                depth, order = 1.0, order + 2
                dx, dy, dz = sample_diffuse()
            elif depth <= 0.0:
                facet = sample_inner_facet(dx, dy, dz, index, alpha)
                if facet[4] < 1.0 and order > 1 and tally.table.shape[0] > 0:
                    entries += _tally_exit(wx, dx, dy, dz, facet, start, medium, tally, f, found)
                mx, my, mz, cos, share, _ = facet
                dx, dy, dz = reflect_inside(dx, dy, dz, mx, my, mz, cos, share, alpha)
                if dz == 0.0:
                    break
                depth, order = 0.0, order + 1
            else:
                k = choose_kind(areas, total)
                if order > 0 and many > 0:
                    reach = number[k] / (4.0 * areas[k])
                    _connect_platelet(dx, dy, dz, depth, reach, sigma[k], reflect[k], f, r, view, out)
                event, dx, dy, dz = scatter(dx, dy, dz, sigma[k], reflect[k], transmit[k], f, r, t)
                if event == ABSORBED:
                    break
                if event == REFLECTED:
                    order += 1
    return entries


@compiled(nogil=True, fastmath=True)
def _hit(depth):
    """Return (1 - exp(-depth)) / depth."""
    return (1.0 - math.exp(-depth)) / depth if depth > 1e-3 else 1.0 - 0.5 * depth


@compiled(nogil=True, fastmath=True)
def single_scattering_at(wi, wo, points, shift, medium, out):
    """Add the single-scattering BRDF, `out[viewer, wavelength]`: a mean over facet pairs.

    Args:
        wi: `[3]`, to the light.
        wo: `[viewer, 3]`.
        points: lattice points.
        shift: `[4]`, lattice shift.
        medium: a `Medium`.
    """
    bands = out.shape[1]
    r, e = np.empty(bands, np.float32), np.empty(bands, np.float32)
    down, up = np.empty(bands, np.float32), np.empty(bands, np.float32)
    index, alpha = medium.n, medium.alpha
    u = np.empty(4)
    for point in range(points):
        lattice_point(point, shift, u)
        dx, dy, dz, enters = refract(wi[0], wi[1], wi[2], index, alpha, u[0], u[1])
        if enters == 0.0:
            continue
        _depths(-dz, medium, e, down)
        for v in range(wo.shape[0]):
            ex, ey, ez, leaves = refract(wo[v, 0], wo[v, 1], wo[v, 2], index, alpha, u[2], u[3])
            if leaves == 0.0:
                continue
            _depths(-ez, medium, e, up)
            # both flights point inward: the normal is minus their sum
            hx, hy, hz = -dx - ex, -dy - ey, -dz - ez
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            hx, hy, hz = hx / length, hy / length, hz / length
            cos = min(abs(dx * hx + dy * hy + dz * hz), 1.0)
            share = enters * leaves / (index * index * 4.0 * dz * ez * points)
            for k in range(medium.number.size):
                interpolate_row(medium.reflect[k], math.sqrt(cos) * (medium.reflect.shape[1] - 1), r)
                scale = np.float32(share * medium.number[k] * normal_density(hx, hy, hz, medium.sigma[k]))
                for l in range(bands):
                    out[v, l] += scale * r[l] * _hit(down[l] + up[l])


@compiled(nogil=True)
def _kind_of(areas, total, part):
    """Return the kind chosen by a number in [0, 1), and that number stretched over its own interval."""
    for k in range(areas.size):
        chance = areas[k] / total
        if part < chance or k == areas.size - 1:
            return k, min(part / chance, 1.0)
        part -= chance
    return 0, part


@compiled(nogil=True, fastmath=True)
def tally_single_scattering(first, count, shift, light, medium, spread, shape, table):
    """Tally single scattering by a platelet over the lattice points `first` to `first + count`.

    Args:
        shift: `[7]`, lattice shift.
        light: `[3]`, unit vector to the light at azimuth 0, or ANY_ANGLE.
        medium: a `Medium`.
        spread, shape, table: see `Tally`.
    """
    bands = medium.reflect.shape[2]
    index, alpha = medium.n, medium.alpha
    value, r, e = np.empty(bands, np.float32), np.empty(bands, np.float32), np.empty(bands, np.float32)
    down, up = np.empty(bands, np.float32), np.empty(bands, np.float32)
    areas, u = np.zeros(medium.number.size), np.empty(7)
    found = (np.empty(8, np.int64), np.empty(8), np.empty(3))
    for point in range(first, first + count):
        lattice_point(point, shift, u)
        wx, wz = light[0], light[2]
        if wz == 0.0:
            wx, wz = math.sin(0.5 * math.pi * u[0]), max(math.cos(0.5 * math.pi * u[0]), 1e-6)
        dx, dy, dz, start = refract(wx, 0.0, wz, index, alpha, u[1], u[2])
        if start == 0.0:
            continue
        total = collision_rates(dx, dy, dz, medium.number, medium.sigma, areas)
        kind, part = _kind_of(areas, total, u[3])
        mx, my, mz = sample_normal(-dx, -dy, -dz, medium.sigma[kind], part, u[4])
        cos = -(dx * mx + dy * my + dz * mz)
        ex, ey, ez = dx + 2.0 * cos * mx, dy + 2.0 * cos * my, dz + 2.0 * cos * mz
        if ez <= 1e-6:
            continue
        ox, oy, _, passed = refract(-ex, -ey, ez, 1.0 / index, alpha, u[5], u[6])
        if passed == 0.0:
            continue
        at = math.sqrt(min(abs(cos), 1.0)) * (medium.reflect.shape[1] - 1)
        interpolate_row(medium.reflect[kind], at, r)
        _depths(-dz, medium, e, down)
        _depths(ez, medium, e, up)
        scale = np.float32(start * passed * total / -dz)
        for l in range(bands):
            value[l] = scale * r[l] * _hit(down[l] + up[l])
        for corner in range(_find_cells(wx, ox, oy, spread, shape, found)):
            _add(table, found[0][corner], found[1][corner], value)


@compiled(nogil=True)
def _lobe_widths(cos, medium, out):
    """Write the two GGX widths, narrow and wide, that match the platelets' lobes about the outer half vector."""
    inner = medium.n * math.sqrt(1.0 - (1.0 - cos * cos) / (medium.n * medium.n))
    bend = ((inner - cos) * medium.alpha) ** 2 / (2.0 * inner * inner)
    out[0] = min(inner / cos * math.sqrt(medium.sigma.min() ** 2 + bend), 2.0)
    out[1] = min(inner / cos * math.sqrt(medium.sigma.max() ** 2 + bend), 2.0)


@compiled(nogil=True)
def _sample_exit(wx, wz, alphas, u1, u2, choice):
    """Draw an exit for light from azimuth 0, from two facet lobes and a cosine: direction and density (0: invalid)."""
    if choice < 0.7:
        mx, my, mz = sample_facet(wx, 0.0, wz, alphas[0] if choice < 0.35 else alphas[1], u1, u2)
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
def _add_products(worth, cells, weights, table):
    """Add products between the eight hat functions around a point, by the step from one to the other."""
    for one in range(8):
        for two in range(8):
            step = 0
            for axis in range(3):
                step = 3 * step + ((two >> axis) & 1) - ((one >> axis) & 1) + 1
            table[cells[one], step] += worth * weights[one] * weights[two]


@compiled(nogil=True)
def hat_products(first, count, shift, medium, spread, entry, shape, table):
    """Integrate K t_i t_o cos_o times hat function pairs over the walks' measure.

    Args:
        entry: `[cos]`, transmittance on sqrt(cos) nodes.
        table: `[cell, 27]`, neighbours ordered by their steps (-1, 0, 1) along the three axes.
    """
    point, u, cells, weights = np.empty(3), np.empty(4), np.empty(8, np.int64), np.empty(8)
    alphas = np.empty(2)
    for number in range(first, first + count):
        lattice_point(number, shift, u)
        angle = 0.5 * math.pi * u[0]
        wx, wz = math.sin(angle), max(math.cos(angle), 1e-6)
        _lobe_widths(wz, medium, alphas)
        ox, oy, oz, density = _sample_exit(wx, wz, alphas, u[1], u[2], u[3])
        if density == 0.0:
            continue
        passes = oz
        for cos in (wz, oz):
            at = math.sqrt(min(cos, 1.0)) * (entry.size - 1)
            i = min(int(at), entry.size - 2)
            passes *= entry[i] + (at - i) * (entry[i + 1] - entry[i])
        lobe = flake_lobe(wx, 0.0, wz, ox, oy, oz, medium.n, medium.alpha, medium.number, medium.sigma)
        place(wx, 0.0, ox, oy, spread, point)
        _corners(point, shape, cells, weights)
        _add_products(passes * lobe / density, cells, weights, table)


def energy_defect(lobe: Layered, published: Array, wi: Array, walks: int = DEFECT_WALKS, seed: int = 0) -> Array:
    """Return the light share from `wi[3]` lost by the "published" energy balance, `[wavelength]`.

    1 - R - T - A, apart from the small loss between interface facets.

    Args:
        lobe: with one stratum; tables hold R (1 - T) for pigments with the published balance.
        published: `[kind]`, bool: the kinds with that balance.
        wi: unit vector to the light, above the surface.
        walks: their number, shared by all wavelengths.
        seed: another seed gives independent noise.
    """
    reflect, transmit = np.ascontiguousarray(lobe.flake_response[..., 0]), lobe.flake_response[..., 1]
    lose = lost_share(reflect, transmit) * np.asarray(published, dtype=float)[:, None, None]
    tables = (reflect, np.ascontiguousarray(transmit), np.ascontiguousarray(lose), _absorption(lobe))
    flakes = (lobe.flake_number, np.ascontiguousarray(lobe.flake_axes), np.ascontiguousarray(lobe.flake_frame))
    base = (BASES[lobe.base], np.ascontiguousarray(lobe.base_reflectance))
    faces = (float(lobe.index[0]), np.ascontiguousarray(lobe.alpha[:, 0]))

    def chunk(i: int) -> Array:
        out = np.zeros(len(lobe.wavelengths_nm))
        _defect((seed * 7919 + i) % (1 << 31), walks // CHUNKS, wi, faces, flakes, tables, base, out)
        return out

    return np.asarray(np.mean(in_threads(chunk, range(CHUNKS)), axis=0))


@compiled(nogil=True)
def _oriented_rates(d, flakes, areas):
    """Do the same as `collision_rates` for any platelet orientation."""
    number, axes, frame = flakes
    total = 0.0
    for k in range(number.size):
        square = 0.0
        for a in range(3):
            along = (frame[k, 0, a] * d[0] + frame[k, 1, a] * d[1] + frame[k, 2, a] * d[2]) * axes[k, a]
            square += along * along
        areas[k] = number[k] * math.sqrt(square)
        total += areas[k]
    return total


@compiled(nogil=True)
def _oriented_normal(d, axes, frame, local, m):
    """Draw a visible normal `m` for any platelet orientation: a cosine-distributed vector mapped by S^(1/2)."""
    length = 0.0
    for a in range(3):
        local[a] = (frame[0, a] * d[0] + frame[1, a] * d[1] + frame[2, a] * d[2]) * axes[a]
        length += local[a] * local[a]
    length = math.sqrt(length)
    z, phi = 2.0 * np.random.random() - 1.0, 2.0 * math.pi * np.random.random()
    side = math.sqrt(1.0 - z * z)
    local[0] = axes[0] * (local[0] * (1.0 + 1e-9) / length + side * math.cos(phi))
    local[1] = axes[1] * (local[1] * (1.0 + 1e-9) / length + side * math.sin(phi))
    local[2] = axes[2] * (local[2] * (1.0 + 1e-9) / length + z)
    length, cos = math.sqrt(local[0] ** 2 + local[1] ** 2 + local[2] ** 2), 0.0
    for a in range(3):
        m[a] = (frame[a, 0] * local[0] + frame[a, 1] * local[1] + frame[a, 2] * local[2]) / length
        cos += m[a] * d[a]
    return cos


@compiled(nogil=True)
def _reflect_at_face(d, index, alpha, down):
    """Reflect light internally at the upper (`down` = 1) or lower (-1) interface; return whether it remains inside."""
    z = d[2] * down
    mx, my, mz, cos, share, _ = sample_inner_facet(d[0], d[1], z, index, alpha)
    d[0], d[1], z = reflect_inside(d[0], d[1], z, mx, my, mz, cos, share, alpha)
    d[2] = z * down
    return z != 0.0


@compiled(nogil=True)
def _meet_base(d, kind, table, index, alpha, f, share):
    """Reflect light at the base; return whether the path continues."""
    if kind == 0:
        return _reflect_at_face(d, index, alpha, -1.0)
    if kind == 1:
        carried, back = weight(f, table[0])
        d[0], d[1], d[2] = sample_diffuse() if survives(f, carried, back) else (0.0, 0.0, 0.0)
        return d[2] != 0.0
    mx, my, mz = sample_facet(-d[0], -d[1], -d[2], alpha, np.random.random(), np.random.random())
    cos = -(d[0] * mx + d[1] * my + d[2] * mz)
    interpolate_row(table, min(cos, 1.0) * (table.shape[0] - 1), share)
    d[0], d[1], d[2] = d[0] + 2.0 * cos * mx, d[1] + 2.0 * cos * my, d[2] + 2.0 * cos * mz
    if d[2] <= 1e-6 or (alpha > 0.0 and np.random.random() >= masking(d[2], alpha)):
        return False
    carried, back = weight(f, share)
    return survives(f, carried, back)


@compiled(nogil=True)
def _meet_oriented(d, k, flakes, tables, f, scratch, out):
    """Scatter or absorb light at platelet `k`, and add lost energy to `out`; return whether the path continues."""
    _, axes, frame = flakes
    reflect, transmit, lose, _ = tables
    r, t, local, m = scratch
    cos = _oriented_normal(d, axes[k], frame[k], local, m)
    at = math.sqrt(min(abs(cos), 1.0)) * (reflect.shape[1] - 1)
    interpolate_row(reflect[k], at, r)
    interpolate_row(transmit[k], at, t)
    event, carried, back, on = share_light(f, r, t)
    if event == REFLECTED:
        for a in range(3):
            d[a] -= 2.0 * cos * m[a]
        if abs(d[2]) < 1e-9:
            d[2] = 1e-9
    elif event != TRANSMITTED:  # counted at the path's end, with less variance than at each collision
        interpolate_row(lose[k], at, r)
        for l in range(out.size):
            out[l] += f[l] * r[l] * carried / (carried - back - on)
        return False
    return True


@compiled(nogil=True)
def _defect(seed, count, wi, faces, flakes, tables, base, out):
    """Add the light lost at platelets, `out[wavelength]`: a mean over `count` walks."""
    np.random.seed(seed)
    index, alpha = faces
    kind, table = base
    f, share = np.empty(out.size), np.empty(out.size)
    areas, d = np.zeros(flakes[0].size), np.empty(3)
    scratch = (np.empty(out.size), np.empty(out.size), np.empty(3), np.empty(3))
    for _walk in range(count):
        d[0], d[1], d[2], start = refract(wi[0], wi[1], wi[2], index, alpha[0], np.random.random(), np.random.random())
        if start == 0.0:
            continue
        f[:] = start / count
        depth, lives = 0.0, True
        for _event in range(MAX_EVENTS):
            total = _oriented_rates(d, flakes, areas)
            depth = min(max(fly(depth, d[2], total, tables[3], f), 0.0), 1.0)
            if depth <= 0.0:
                lives = _reflect_at_face(d, index, alpha[0], 1.0)
            elif depth >= 1.0:
                lives = _meet_base(d, kind, table, index, alpha[1], f, share)
            else:
                lives = _meet_oriented(d, choose_kind(areas, total), flakes, tables, f, scratch, out)
            if not lives:
                break
