"""Spheres, cylinders and spheroids, optionally coated: size distributions, meshes and T-matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from typing import ClassVar

import numpy as np
from scipy.special import spherical_jn

from nacre.core.arrays import Array, ComplexArray
from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.errors import UnsupportedError
from nacre.core.jit import compiled
from nacre.core.machine import in_threads, single_threaded_blas
from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices, Body, gain, reciprocal, truncated
from nacre.families.metasurface.tmatrix.particle_on_stack import AZIMUTHAL_ORDERS
from nacre.families.metasurface.tmatrix.special_functions import angular_functions, legendre
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.mie import mie_coefficients
from nacre.recipe.fingerprint import fingerprint

# T-matrix for a body of revolution with a mirror plane by the boundary element method (PMCHWT).
#
# The tangential fields inside and outside, radiated by the equivalent currents J and M, are equal on the surface.
# Galerkin with polynomials on panels along the generating curve; J_t and M_t are continuous, and panels are graded
# towards edges with singular fields. The system is symmetric in the bilinear product and the excitation and test waves
# are the same, so T = v~ S^-1 v has a second-order error in the current error. Poggio and Miller; Chang and Harrington;
# Wu and Tsai; for bodies of revolution Mautz and Harrington, AEU 33, 71 (1979).
#
# The kernels exp(ikR)/(4 pi R) and its gradient are integrated over the azimuth in a variable that resolves the near
# singularity, psi = a sinh u, then over panels: directly for distant panels, split towards the target for near ones,
# and with nodes clustered at a target on the panel itself.
#
# Lengths are times the ambient k. A panel is a row (type, p0, p1, p2, p3, d): type 0 is a line from (rho, z) to (rho,
# z); type 1 a curve at distance d outside a spheroid arc with semi-axes a, c between two parametric angles; type 2 an
# arc with radius d around the ring (rho, z) between two angles from the normal. Panels cover the upper half, z >= 0,
# from the pole to the equator; the lower half is its mirror image.

MOST_AZIMUTHS = 96
CROWDING = 4  # node clustering exponent at a target on the panel
NEAR = 1.0  # maximum unsplit panel length over its distance
DEEPEST = 40

# kernel numbers: the vector kernels in L (tt, tp, pt, pp) and its scalar kernel with the
# divergence (t and p functions), for both equations; then the kernels in K
E_TT, E_TP, E_PT, E_PP, E_ST, E_SP, H_TT, H_TP, H_PT, H_PP, H_ST, H_SP, K_TT, K_TP, K_PT, K_PP = range(16)


@lru_cache(maxsize=2)
def gauss_table(most: int = MOST_AZIMUTHS) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights on [0, 1] for every count up to `most`, `[count, node]`."""
    nodes, weights = np.zeros((most + 1, most)), np.zeros((most + 1, most))
    for n in range(1, most + 1):
        x, w = np.polynomial.legendre.leggauss(n)
        nodes[n, :n], weights[n, :n] = (x + 1) / 2, w / 2
    return nodes, weights


@compiled(nogil=True, error_model="numpy")
def locate(panel, s):  # type: ignore[no-untyped-def]  # numba
    """Return rho, z, t_rho, t_z and the speed dt/ds at s in [-1, 1]."""
    if panel[0] == 0.0:
        h = 0.5 * (1.0 + s)
        dr, dz = 0.5 * (panel[3] - panel[1]), 0.5 * (panel[4] - panel[2])
        speed = np.sqrt(dr * dr + dz * dz)
        return panel[1] + 2.0 * dr * h, panel[2] + 2.0 * dz * h, dr / speed, dz / speed, speed
    middle, half = 0.5 * (panel[3] + panel[4]), 0.5 * (panel[4] - panel[3])
    theta = middle + half * s
    cos, sin, out = np.cos(theta), np.sin(theta), panel[5]
    if panel[0] == 2.0:
        return panel[1] + out * sin, panel[2] + out * cos, cos, -sin, out * half
    a, c = panel[1], panel[2]
    dr, dz = a * cos, -c * sin
    slope = np.sqrt(dr * dr + dz * dz)
    speed = half * (slope + out * a * c / (slope * slope))  # the curvature is a c / slope^3
    return a * sin - out * dz / slope, c * cos + out * dr / slope, dr / slope, dz / slope, speed


@compiled(nogil=True, error_model="numpy")
def _separation(panel, s, step):  # type: ignore[no-untyped-def]  # numba
    """Return rho and z at s + step minus those at s, without cancellation for small steps."""
    if panel[0] == 0.0:
        return 0.5 * (panel[3] - panel[1]) * step, 0.5 * (panel[4] - panel[2]) * step
    half = 0.5 * (panel[4] - panel[3])
    theta, turn = 0.5 * (panel[3] + panel[4]) + half * s, half * step
    chord, mean = 2.0 * np.sin(0.5 * turn), theta + 0.5 * turn
    d_sin, d_cos, out = np.cos(mean) * chord, -np.sin(mean) * chord, panel[5]
    if panel[0] == 2.0:
        return out * d_sin, out * d_cos
    a, c = panel[1], panel[2]
    dr, dz = a * d_sin, c * d_cos
    if out != 0.0:  # the normals are (c sin, a cos) / slope
        sin, cos = np.sin(theta), np.cos(theta)
        slope = np.sqrt((a * cos) ** 2 + (c * sin) ** 2)
        there = np.sqrt((a * (cos + d_cos)) ** 2 + (c * (sin + d_sin)) ** 2)
        steeper = (c - a) * (c + a) * d_sin * (2.0 * sin + d_sin) / (slope + there)
        dr += out * c * (d_sin * slope - sin * steeper) / (slope * there)
        dz += out * a * (d_cos * slope - cos * steeper) / (slope * there)
    return dr, dz


@compiled(nogil=True, error_model="numpy")
def shapes(s, degree, along, slope, around):  # type: ignore[no-untyped-def]  # numba
    """Fill the shape functions at s: t component (ends, then bubbles), its derivative d/ds, and p component."""
    around[0], around[1] = 1.0, s
    for k in range(2, degree + 1):
        around[k] = ((2 * k - 1) * s * around[k - 1] - (k - 1) * around[k - 2]) / k
    along[0], along[1], slope[0], slope[1] = 0.5 * (1.0 - s), 0.5 * (1.0 + s), -0.5, 0.5
    for k in range(2, degree + 1):
        norm = 1.0 / np.sqrt(2.0 * (2 * k - 1))
        along[k] = (around[k] - around[k - 2]) * norm
        slope[k] = (2 * k - 1) * around[k - 1] * norm


@compiled(nogil=True, error_model="numpy")
def _modes(rho, rho_s, plane, waves, nodes, weights, modal):  # type: ignore[no-untyped-def]  # numba
    """Fill `[kind, medium, m]`: int G cos, G cos psi cos, G sin psi sin, h cos, h (1 - cos psi) cos, h sin psi sin."""
    modal[:] = 0.0
    top = modal.shape[2]
    if plane == 0.0:  # coincident to rounding; the weight vanishes
        return
    a = np.sqrt(plane / (rho * rho_s))
    reach = np.arcsinh(np.pi / a)
    turns = np.max(np.abs(waves)) * min(rho, rho_s)
    count = min(int(14 + 0.7 * top + 2.2 * reach + 2.0 * turns), nodes.shape[0] - 1)
    for n in range(count):
        u = reach * nodes[count, n]
        psi = a * np.sinh(u)
        weight = 2.0 * reach * weights[count, n] * a * np.cosh(u) / (4.0 * np.pi)
        half = np.sin(0.5 * psi)
        less = 2.0 * half * half
        distance = np.sqrt(plane + 2.0 * rho * rho_s * less)
        c, s = 1.0 - less, np.sin(psi)
        for medium in range(waves.shape[0]):
            ik = 1j * waves[medium]
            g = np.exp(ik * distance) * (weight / distance)
            h = g * (ik * distance - 1.0) / (distance * distance)
            gc, gs, hl, hs = g * c, g * s, h * less, h * s
            cos_m, sin_m = 1.0, 0.0
            for m in range(top):
                modal[0, medium, m] += g * cos_m
                modal[1, medium, m] += gc * cos_m
                modal[2, medium, m] += gs * sin_m
                modal[3, medium, m] += h * cos_m
                modal[4, medium, m] += hl * cos_m
                modal[5, medium, m] += hs * sin_m
                cos_m, sin_m = cos_m * c - sin_m * s, sin_m * c + cos_m * s


@compiled(nogil=True, error_model="numpy")
def _add(target, panel, s, step, weight, sign, waves, degree, rules, modal, work, row):  # type: ignore[no-untyped-def]  # numba
    """Add one source point to `row`, `[kernel, m, shape]`; `sign` = -1 takes its mirror image.

    `step` is the distance from the target along its own panel; 0 on other panels.
    """
    rho, z, t_rho, t_z = target[0], target[1], target[2], target[3]
    rho_s, z_s, u_rho, u_z, speed = locate(panel, s)
    z_s, u_z = sign * z_s, sign * u_z
    dr, dz = rho - rho_s, z - z_s
    if step != 0.0:  # the normal distance is quadratic in the step, so every digit counts
        dr, dz = _separation(panel, target[4], step)
        dr, dz = -dr, -dz
    _modes(rho, rho_s, dr * dr + dz * dz, waves, rules[0], rules[1], modal)
    shapes(s, degree, work[0], work[1], work[2])
    eps_in, eps_out = waves[0] * waves[0], waves[-1] * waves[-1]
    k_tt = rho * u_rho * t_z - rho_s * u_z * t_rho - dz * t_rho * u_rho
    pt_0, pt_1 = -dr * u_z + dz * u_rho, -(rho_s * u_z + dz * u_rho)
    tp_0, tp_1 = t_z * dr - dz * t_rho, -(rho * t_z - dz * t_rho)
    measure = weight * speed * rho_s
    for m in range(modal.shape[2]):
        i0, i1, i2 = modal[0, 0, m], modal[1, 0, m], modal[2, 0, m]
        g0, g1, g2 = modal[0, 1, m], modal[1, 1, m], modal[2, 1, m]
        h0, hl, hs = modal[3, 0, m] + modal[3, 1, m], modal[4, 0, m] + modal[4, 1, m], modal[5, 0, m] + modal[5, 1, m]
        e0, e1, e2 = g0 + i0, g1 + i1, g2 + i2
        f0, f1, f2 = eps_out * g0 + eps_in * i0, eps_out * g1 + eps_in * i1, eps_out * g2 + eps_in * i2
        e_tt, e_tp, e_pt = t_rho * u_rho * e1 + t_z * u_z * e0, -1j * t_rho * e2, 1j * u_rho * e2
        f_tt, f_tp, f_pt = t_rho * u_rho * f1 + t_z * u_z * f0, -1j * t_rho * f2, 1j * u_rho * f2
        e_s, f_s = g0 / eps_out + i0 / eps_in, g0 + i0
        q_tt, q_pp = 1j * k_tt * hs, -1j * dz * hs
        q_tp, q_pt = tp_0 * h0 + tp_1 * hl, pt_0 * h0 + pt_1 * hl
        for k in range(degree + 1):
            t, p = work[0, k] * measure, work[2, k] * measure
            spread = weight * (u_rho * speed * work[0, k] + rho_s * work[1, k])
            plain = weight * speed * work[2, k]
            row[E_TT, m, k] += e_tt * t
            row[E_TP, m, k] += e_tp * p
            row[E_PT, m, k] += e_pt * t
            row[E_PP, m, k] += e1 * p
            row[E_ST, m, k] += e_s * spread
            row[E_SP, m, k] += e_s * plain
            row[H_TT, m, k] += f_tt * t
            row[H_TP, m, k] += f_tp * p
            row[H_PT, m, k] += f_pt * t
            row[H_PP, m, k] += f1 * p
            row[H_ST, m, k] += f_s * spread
            row[H_SP, m, k] += f_s * plain
            row[K_TT, m, k] += q_tt * t
            row[K_TP, m, k] += q_tp * p
            row[K_PT, m, k] += q_pt * t
            row[K_PP, m, k] += q_pp * p


@compiled(nogil=True, error_model="numpy")
def _nearest(panel, rho, z, sign):  # type: ignore[no-untyped-def]  # numba
    """Return s at the panel point nearest to a target, its distance, and the panel length."""
    best, where, length = 1e300, 0.0, 0.0
    for n in range(33):
        s = -1.0 + n / 16.0
        r, h, _, _, speed = locate(panel, s)
        length += speed * (1.0 / 16.0 if 0 < n < 32 else 1.0 / 32.0)
        d = (rho - r) ** 2 + (z - sign * h) ** 2
        if d < best:
            best, where = d, s
    low, high = max(where - 1.0 / 16.0, -1.0), min(where + 1.0 / 16.0, 1.0)
    for _ in range(40):
        a, b = low + 0.382 * (high - low), low + 0.618 * (high - low)
        ra, za, _, _, _ = locate(panel, a)
        rb, zb, _, _, _ = locate(panel, b)
        if (rho - ra) ** 2 + (z - sign * za) ** 2 < (rho - rb) ** 2 + (z - sign * zb) ** 2:
            high = b
        else:
            low = a
    where = 0.5 * (low + high)
    if where > 1.0 - 1e-6:
        where = 1.0
    elif where < -1.0 + 1e-6:
        where = -1.0
    r, h, _, _, _ = locate(panel, where)
    return where, np.sqrt((rho - r) ** 2 + (z - sign * h) ** 2), length


@compiled(nogil=True, error_model="numpy")
def fill_rows(panels, targets, homes, waves, degree, far, self_count, rules, rows):  # type: ignore[no-untyped-def]  # numba
    """Fill `[target, mirror, panel, kernel, m, shape]` for targets (rho, z, t_rho, t_z, s) on their home panels.

    `waves` holds the wavenumbers, over the ambient one, inside and outside the panels, whose kernels are summed; or
    that in the one medium between the panels and targets on another surface, whose home is -1.
    """
    nodes, weights = rules  # Gauss tables
    orders = rows.shape[4]
    modal = np.zeros((6, 2, orders), dtype=np.complex128)
    work = np.empty((3, degree + 1))
    for i in range(targets.shape[0]):
        target = targets[i]
        for image in range(2):
            sign = 1.0 - 2.0 * image
            for q in range(panels.shape[0]):
                row, panel = rows[i, image, q], panels[q]
                if image == 0 and homes[i] == q:
                    for side in range(2):
                        span = target[4] + 1.0 if side == 0 else 1.0 - target[4]
                        for n in range(self_count):
                            x = nodes[self_count, n]
                            step = (2 * side - 1) * span * x**CROWDING
                            w = weights[self_count, n] * span * CROWDING * x ** (CROWDING - 1)
                            s = target[4] + step
                            _add(target, panel, s, step, w, sign, waves, degree, rules, modal, work, row)
                    continue
                where, distance, length = _nearest(panel, target[0], target[1], sign)
                if length <= NEAR * distance:
                    for n in range(far):
                        s, w = 2.0 * nodes[far, n] - 1.0, 2.0 * weights[far, n]
                        _add(target, panel, s, 0.0, w, sign, waves, degree, rules, modal, work, row)
                    continue
                # bisect towards the nearest point
                least = 2.0 * distance / length
                for side in range(2):
                    span = where + 1.0 if side == 0 else 1.0 - where
                    outer = span
                    for level in range(DEEPEST):
                        if outer <= 0.0:
                            break
                        inner = 0.5 * outer
                        if outer <= least or level == DEEPEST - 1:
                            inner = 0.0
                        for n in range(far):
                            step = inner + (outer - inner) * nodes[far, n]
                            s = where - step if side == 0 else where + step
                            w = (outer - inner) * weights[far, n]
                            _add(target, panel, s, 0.0, w, sign, waves, degree, rules, modal, work, row)
                        outer = inner


@dataclass(frozen=True)
class Mesh:
    """Body resolution: panels (core panels, if coated), polynomial degree, and quadrature nodes."""

    panels: Array
    core: Array | None = None
    degree: int = 6
    outer: int = 14
    far: int = 10
    on_itself: int = 14


def _outer_rule(count: int) -> tuple[Array, Array]:
    """Nodes on (-1, 1), dense at both ends, where the inner integral has its logarithms."""
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * x * (3 - x**2), 1.5 * w * (1 - x**2)


def block_t_matrix(
    mesh: Mesh, index: complex, lmax: int, mmax: int | None = None, core: complex | None = None
) -> ComplexArray:
    """Return T, `[m, n, n']`, as `AxialTMatrices.blocks`.

    The field in a shell comes from the currents on both its surfaces: the diagonal blocks hold the operators for the
    media on both sides, the off-diagonal ones minus the shell operators.

    Args:
        mesh: lengths times the ambient k.
        index: body or shell, over the ambient index.
        core: index inside the second mesh surface.
    """
    top = lmax if mmax is None else mmax
    surfaces = [_Surface.of(mesh, panels) for panels in (mesh.panels, mesh.core) if panels is not None]
    media = [1.0, index] if core is None else [1.0, index, core]
    parities, orders = (1.0, -1.0), range(top + 1)
    parts: dict[tuple[float, int], list[list[ComplexArray]]]
    parts = {(parity, m): [[] for _ in surfaces] for parity in parities for m in orders}
    for i, at in enumerate(surfaces):
        for j, of in enumerate(surfaces):
            between = [media[i + 1], media[i]] if i == j else [media[1]]
            rows = _rows(mesh, at, of, between, top)
            for parity in parities:
                with_images = tuple(np.asarray(rows[:, 0] + sign * rows[:, 1]) for sign in (parity, -parity))
                for m in orders:
                    block = _block(with_images, at, of, m, parity)
                    parts[parity, m][i].append(block if i == j else -block)
    out = np.zeros((top + 1, 2 * lmax, 2 * lmax), dtype=complex)
    outermost = surfaces[0]
    waves = _waves(outermost.targets, lmax, top)
    for (parity, m), blocks in parts.items():
        right, left, selected = _excitations(waves, outermost, m, lmax, parity)
        if selected.size == 0:
            continue
        matrix = np.block(blocks)
        unlit = np.zeros((len(matrix) - len(right), right.shape[1]))
        currents = np.linalg.solve(matrix, np.concatenate([right, unlit]))
        out[m, selected[:, None], selected] = 2.0 * left.T @ currents[: len(right)]
    return out


@dataclass(frozen=True)
class _Surface:
    """Surface panels, targets (rho, z, t_rho, t_z, s), and test functions there, `[panel, shape, target]`.

    The test functions are rho b_t, (rho b_t)', rho b_p and b_p.
    """

    panels: Array
    targets: Array
    t: Array
    spread: Array
    p: Array
    plain: Array

    @property
    def count(self) -> int:
        """Panel count."""
        return len(self.panels)

    @property
    def size(self) -> int:
        """Shape functions per panel."""
        return int(self.t.shape[1])

    @classmethod
    def of(cls, mesh: Mesh, panels: Array) -> _Surface:
        """Prepare a surface at the mesh nodes."""
        panels = np.ascontiguousarray(panels, dtype=float)
        s, w = _outer_rule(mesh.outer)
        points = np.array([[*locate(p, x), x] for p in panels for x in s])
        targets = np.ascontiguousarray(points[:, [0, 1, 2, 3, 5]])
        size, count = mesh.degree + 1, len(panels)
        along, slope, around = (np.empty((size, len(s))) for _ in range(3))
        for n, x in enumerate(s):
            a, b, c = (np.empty(size) for _ in range(3))
            shapes(x, mesh.degree, a, b, c)
            along[:, n], slope[:, n], around[:, n] = a, b, c
        rho, t_rho, speed = (points[:, k].reshape(count, 1, -1) for k in (0, 2, 4))
        return cls(
            panels,
            targets,
            rho * along * speed * w,
            (t_rho * speed * along + rho * slope) * w,
            rho * around * speed * w,
            np.broadcast_to(around * w, (count, *around.shape)) * speed,
        )


def _rows(mesh: Mesh, at: _Surface, of: _Surface, waves: list[complex], top: int) -> ComplexArray:
    """Return the integrals over one surface's panels at another's targets, see `fill_rows`."""
    homes = np.repeat(np.arange(at.count), len(at.targets) // at.count) if at is of else np.full(len(at.targets), -1)
    rows = np.zeros((len(at.targets), 2, of.count, 16, top + 1, of.size), dtype=complex)
    numbers = np.array(waves, dtype=complex)
    fill_rows(of.panels, at.targets, homes, numbers, mesh.degree, mesh.far, mesh.on_itself, gauss_table(), rows)
    return rows


def _block(with_images: tuple[ComplexArray, ...], at: _Surface, of: _Surface, m: int, parity: float) -> ComplexArray:
    """Return a block of S for one azimuthal order and parity; the unknowns are J_t, J_p, M_t, M_p."""

    def tested(image: int, kernel: int, test: Array) -> ComplexArray:
        part = with_images[image][:, :, kernel, m].reshape(at.count, -1, of.count * of.size)
        return (test @ part).reshape(at.count * at.size, -1)

    def electric(image: int, first: int) -> tuple[ComplexArray, ...]:
        tt, tp, pt, pp, st, sp = (first + n for n in range(6))
        im = 1j * m
        return (
            tested(image, tt, at.t) - tested(image, st, at.spread),
            tested(image, tp, at.t) - im * tested(image, sp, at.spread),
            tested(image, pt, at.p) + im * tested(image, st, at.plain),
            tested(image, pp, at.p) - m**2 * tested(image, sp, at.plain),
        )

    def crossed(image: int) -> tuple[ComplexArray, ...]:
        return (
            tested(image, K_TT, at.t),
            tested(image, K_TP, at.t),
            tested(image, K_PT, at.p),
            tested(image, K_PP, at.p),
        )

    def square(parts: tuple[ComplexArray, ...], rows: float, columns: float) -> ComplexArray:
        left, right = _joined(at, rows), _joined(of, columns)
        return np.block([[left.T @ parts[0] @ right, left.T @ parts[1]], [parts[2] @ right, parts[3]]])

    # J has the parity, M the opposite one; odd t components vanish on the equator
    j, mag = parity, -parity
    e_j, h_m = square(electric(0, E_TT), j, j), square(electric(1, H_TT), mag, mag)
    k_m, k_j = square(crossed(1), j, mag), square(crossed(0), mag, j)
    return np.block([[1j * e_j, -k_m], [-k_j, -1j * h_m]])


def _joined(surface: _Surface, parity: float) -> Array:
    """Return the matrix from continuous functions to panel functions, `[panel x shape, unknown]`.

    A vector field even in the mirror has an odd t component along the curve, zero on the equator.
    """
    count, size = surface.count, surface.size
    unknowns = count * (size - 2) + count + (0 if parity > 0 else 1)
    out = np.zeros((count * size, unknowns))
    for q in range(count):
        out[q * size, q] = 1.0
        if q + 1 < count or parity < 0:
            out[q * size + 1, q + 1] = 1.0
        start = count + (0 if parity > 0 else 1) + q * (size - 2)
        out[q * size + 2 : (q + 1) * size, start : start + size - 2] = np.eye(size - 2)
    return out


def _waves(targets: Array, lmax: int, top: int) -> dict[str, Array]:
    """Tangential regular wave components at the targets, `[m, l, target]`, without factors i."""
    rho, z, t_rho, t_z = targets[:, 0], targets[:, 1], targets[:, 2], targets[:, 3]
    x = np.hypot(rho, z)
    cos, sin = z / x, rho / x
    tau, mpi = angular_functions(cos, lmax, top, sin)
    p = legendre(cos, lmax, top)[:, 1:]
    l = np.arange(1, lmax + 1)[:, None]
    j = np.array([spherical_jn(n, x) for n in range(1, lmax + 1)])
    slope = np.array([spherical_jn(n, x, True) for n in range(1, lmax + 1)])
    norm = np.sqrt(l * (l + 1.0))
    radial, inner = j / x, slope + j / x  # z/x, (x z)'/x
    along_r, along_theta = t_rho * sin + t_z * cos, t_rho * cos - t_z * sin
    return {
        "m_t": j * mpi / norm * along_theta,  # times i
        "m_p": -j * tau / norm,
        "n_t": norm * radial * p * along_r + inner * tau / norm * along_theta,
        "n_p": inner * mpi / norm,  # times i
    }


def _excitations(
    waves: dict[str, Array], surface: _Surface, m: int, lmax: int, parity: float
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Return v and v~, `[unknown, wave]`, for the waves with one parity on a surface, and their places n = (tau, l)."""
    l = np.arange(1, lmax + 1)
    even = (-1.0) ** (l + m)
    magnetic = l[(l >= max(m, 1)) & (-even == parity)] - 1
    electric = l[(l >= max(m, 1)) & (even == parity)] - 1

    def tested(values: ComplexArray, test: Array) -> ComplexArray:
        cut = values.reshape(len(values), surface.count, -1)
        return np.asarray(np.einsum("qks,nqs->qkn", test, cut).reshape(-1, len(values)))

    def side(conjugate: float) -> ComplexArray:
        i = 1j * conjugate
        m_t, m_p = i * waves["m_t"][m], waves["m_p"][m] + 0j
        n_t, n_p = waves["n_t"][m] + 0j, i * waves["n_p"][m]
        e_t, e_p = np.concatenate([m_t[magnetic], n_t[electric]]), np.concatenate([m_p[magnetic], n_p[electric]])
        h_t, h_p = (
            -1j * np.concatenate([n_t[magnetic], m_t[electric]]),
            -1j * np.concatenate([n_p[magnetic], m_p[electric]]),
        )
        return np.concatenate(
            [
                -_joined(surface, parity).T @ tested(e_t, surface.t),
                -tested(e_p, surface.p),
                _joined(surface, -parity).T @ tested(h_t, surface.t),
                tested(h_p, surface.p),
            ]
        )

    return side(1.0), side(-1.0), np.concatenate([magnetic, lmax + electric])


# Particles of any shape: their T-matrices by boundary elements, and the shapes.

SIZE_NODES = 5


@dataclass(frozen=True)
class Shell:
    """A coating around the core."""

    material: OpticalConstant
    thickness_nm: float


@dataclass(frozen=True)
class Sizes:
    """Core radii for spheres, or full radii for other particles, and their number fractions."""

    radii_nm: tuple[float, ...]
    shares: tuple[float, ...]

    def larger_by(self, coat_nm: float) -> Sizes:
        """Return the sizes with a coat."""
        return Sizes(tuple(r + coat_nm for r in self.radii_nm), self.shares)

    @classmethod
    def of(cls, radius_nm: float, deviation_nm: float = 0.0, distribution: str = "gaussian") -> Sizes:
        """Quadrature nodes for a size distribution with the given mean and standard deviation."""
        if deviation_nm == 0.0:
            return cls((radius_nm,), (1.0,))
        x, w = np.polynomial.hermite_e.hermegauss(SIZE_NODES)
        if distribution == "lognormal":
            variance = np.log1p((deviation_nm / radius_nm) ** 2)
            radii = radius_nm * np.exp(np.sqrt(variance) * x - variance / 2)
        else:
            radii = radius_nm + deviation_nm * x
        return cls(tuple(float(r) for r in radii), tuple(float(v) for v in w / w.sum()))


def sphere_t_matrix(
    core: OpticalConstant, shell: Shell | None, radius_nm: float, lmax: int, surface: Substrate
) -> ComplexArray:
    """Return the diagonal T for one sphere at the wavelength of `surface`, `[n]`: -b_l, then -a_l (Mie)."""
    lam = np.array([surface.wavelength_nm])
    radii, indices = [radius_nm], [complex(core.n_complex(lam)[0])]
    if shell is not None:
        radii.append(radius_nm + shell.thickness_nm)
        indices.append(complex(shell.material.n_complex(lam)[0]))
    x = surface.inner_wavenumber * np.array(radii)
    a, b = mie_coefficients(lmax, x, np.array(indices) / surface.inner_index)
    return np.concatenate([-b, -a])


LEAST_ORDER, HIGHEST_ORDER = 20, 28  # discs near a stack converge to 1 % at l = 10, to 0.2 % at l = 20
EXPORTED_ORDER = 10  # limits an exported file with 48 wavelengths, 600 MB with all orders
SHORTEST_NM = 360.0
GRADING = 0.15  # panel ratio towards an edge: GRADING^(2 n nu) remains after n levels, nu the field exponent
LADDER, CONTENT = (3, 7, 14), 1e-3  # levels, and the target error: nu is 0.5 to 0.8, but near 0 for silver at 360 nm
SMOOTH_LADDER = (-1, 0, 3)  # additional spheroid panels
LONGEST = 4.0  # panel length times index; degree 6 resolves 2/3 wavelength to 1e-7
LONGEST_OVER_WIDTH = 3.0  # panel length over the smallest extent: the far side's field varies as fast
MOST_PANELS, MOST_WITH_COAT = 40, 60
REFUSED = 1e-2  # largest accepted relative error
CHECKED_ORDER = 3
RIM_PIECES = 2  # panels on a coat rim
CLOSER = 1.5  # refinement for the next coat mesh
COAT_STEPS = 4.0  # grading ratio beyond the coat thickness
COAT_RESOLUTION = (
    0.5  # relative to the coat thickness; closer to the edge the outer surface need not follow the core mesh
)
COARSE = partial(Mesh, degree=4, outer=10, far=8, on_itself=10)


def cylinder_panels(
    radius: float, height: float, index: float, levels: int = LADDER[0], coat: float = 0.0
) -> tuple[Array, Array]:
    """Return panels for the upper half cylinder, and for the outer coat surface, rounded about the edge.

    They run from the axis along the top to the equator, graded towards the edge. Close surfaces are cut at the same
    places, since panel current fields change at the ends.

    Args:
        radius, height: cylinder, times the ambient k.
        index: highest modulus over the ambient index.
        levels: grading levels.
        coat: thickness times the ambient k.
    """
    longest = min(LONGEST / max(1.0, index), LONGEST_OVER_WIDTH * min(2 * radius, height))
    uncoated: list[tuple[float, ...]] = []
    coated: list[tuple[float, ...]] = []
    for is_top, length in ((True, radius), (False, height / 2)):
        marks = [0.0]
        for low, high in pairwise([0.0, *_grading(length, min(radius, height / 2), levels, coat), length]):
            pieces = max(1, int(np.ceil((high - low) / longest)))
            marks += [low + (high - low) * n / pieces for n in range(1, pieces + 1)]
        coat_marks = [0.0, *(m for m in marks[1:-1] if m > COAT_RESOLUTION * coat), length]
        for rows, selected, out in ((uncoated, marks, 0.0), (coated, coat_marks, coat)):
            ends = [length - m for m in selected]  # from the axis or the equator
            if is_top:
                rows += [(0.0, low, height / 2 + out, high, height / 2 + out, 0.0) for high, low in pairwise(ends)][
                    ::-1
                ]
            else:
                rows += [(0.0, radius + out, high, radius + out, low, 0.0) for high, low in pairwise(ends)]
        if is_top:
            turns = _turns(max(RIM_PIECES, int(np.ceil(coat * np.pi / 2 * max(1.0, index) / LONGEST))))
            coated += [(2.0, radius, height / 2, a, b, coat) for a, b in pairwise(turns)]
    return np.array(uncoated), np.array(coated)


def _grading(length: float, width: float, levels: int, coat: float) -> list[float]:
    """Return the cuts on a line from an edge, including coat thickness multiples."""
    first = min(width, length)
    finest = first * GRADING**levels
    if not finest < coat < length / 2:
        return [first * GRADING**n for n in range(levels, 0, -1)]
    inner = [coat * GRADING**n for n in range(1, levels + 1) if coat * GRADING**n >= finest]
    outer = [coat * COAT_STEPS**n for n in range(levels + 9) if coat * COAT_STEPS**n < length / 2]
    return [*inner[::-1], *outer]


def film_mode(core: complex, coat: complex, thickness: float) -> float:
    """Return the wavenumber for the shortest wave guided by a thin coat, over the ambient k, in the quasistatic limit.

    Between two half spaces: e^(2 k t) = (e - e1)(e - e2) / ((e + e1)(e + e2)).
    """
    e, around = coat**2, (1.0 + 0.0j, core**2)
    above, below = (complex(np.prod([e + sign * other for other in around])) for sign in (-1.0, 1.0))
    if abs(above) <= abs(below) or below == 0.0:  # no guided wave, or a surface resonance
        return 0.0
    return float(abs(np.log(above / below))) / (2 * thickness)


def _turns(count: int) -> Array:
    return np.linspace(0.0, np.pi / 2, count + 1)


def spheroid_panels(radius: float, height: float, index: float, coarser: int = 0, coat: float = 0.0) -> Array:
    """Return panels for the upper half spheroid, from the pole to the equator; see `cylinder_panels`.

    With `coat`, they belong to the outer surface; without their last column, to the core.
    """
    a, c = radius, height / 2
    count = 2
    for wide, high in ((a, c), (a + coat, c + coat)):
        longest = min(LONGEST / max(1.0, index), LONGEST_OVER_WIDTH * min(2 * wide, 2 * high))
        count = max(count, int(np.ceil(max(wide, high) * np.pi / 2 / longest)))
    tips = int(np.ceil(np.log2(max(a / c, c / a, 1.0))))
    edges = _turns(max(count + tips - coarser, 1))
    return np.array([(1.0, a, c, low, high, coat) for low, high in zip(edges, edges[1:])])


@dataclass(frozen=True)
class SolvedBody(Body):
    """A cylinder or spheroid with its axis along the normal, whose T-matrix is computed by `bem`. See `Body`.

    Attributes:
        radius_nm, height_nm: with the shell.
        core: core material.
        ambient: the surrounding medium.
        shell: a coat with uniform thickness, rounded about cylinder edges (optional).
        edge_nm: cylinder core edge radius; 0 for sharp edges.
    """

    method: ClassVar[str] = "PMCHWT, Galerkin, body of revolution"

    shape: str
    radius_nm: float
    height_nm: float
    core: OpticalConstant
    ambient: OpticalConstant
    source: str
    shell: Shell | None = None
    edge_nm: float = 0.0
    errors: dict[float, float] = field(default_factory=dict, compare=False)

    @property
    def name(self) -> str:  # type: ignore[override]  # read-only, like all fields of a frozen dataclass
        """Particle description."""
        radius, height = self.core_extents_nm
        coat = "" if self.shell is None else f", in {self.shell.thickness_nm:g} nm of {self.shell.material.name}"
        edge = f", edges of {self.edge_nm:g} nm" if self.edge_nm else ""
        return f"{self.shape} of {self.core.name}, {2 * radius:g} x {height:g} nm{edge}{coat}"

    @property
    def core_extents_nm(self) -> tuple[float, float]:
        """Core radius and height."""
        coat = 0.0 if self.shell is None else self.shell.thickness_nm
        return self.radius_nm - coat, self.height_nm - 2 * coat

    @property
    def circumscribing_nm(self) -> float:  # type: ignore[override]
        """Largest distance from the centre."""
        if self.shape != "cylinder":
            return max(self.radius_nm, self.height_nm / 2)
        radius, height = self.core_extents_nm
        corner = float(np.hypot(radius - self.edge_nm, height / 2 - self.edge_nm))
        return corner + self.edge_nm + self.radius_nm - radius

    def with_radius(self, radius_nm: float) -> SolvedBody:
        """Return the same particle with another width and the same height; both share the error estimates."""
        return replace(self, radius_nm=radius_nm)

    @cached_property
    def lmax(self) -> int:  # type: ignore[override]
        """Highest multipole order: as for Mie series, and at least the order required by a near stack.

        Raises:
            UnsupportedError: the particle is too large.
        """
        lam = max(SHORTEST_NM, self.ambient.range_nm[0])
        x = 2 * np.pi * float(self.ambient.n_complex(np.array([lam]))[0].real) * self.circumscribing_nm / lam
        order = max(LEAST_ORDER, int(np.ceil(x + 4.05 * np.cbrt(x) + 2)))
        if order > HIGHEST_ORDER:
            raise UnsupportedError(
                f"{self.source}: a particle of {2 * self.circumscribing_nm:.4g} nm from end to end needs multipoles "
                f"up to l = {order}; at most {HIGHEST_ORDER} are computed"
            )
        return order

    @property
    def estimated_error(self) -> float | None:
        """The largest relative difference between two meshes over the computed wavelengths."""
        return max(self.errors.values(), default=None)

    @cached_property
    def _solved(self) -> dict[tuple[float, int], ComplexArray]:
        return {}

    def t_matrix(self, wavelength_nm: float) -> ComplexArray:
        """Return T, `[m, n, n']`, with m up to 4.

        Raises:
            MaterialRangeError: an index is not known.
            UnsupportedError: it does not converge.
        """
        return self.azimuthal(float(wavelength_nm), AZIMUTHAL_ORDERS)

    def azimuthal(self, wavelength_nm: float, mmax: int) -> ComplexArray:
        """Return T with m up to `mmax`; see `t_matrix`."""
        key = (wavelength_nm, mmax)
        if key not in self._solved:
            self._solved[key] = self._cached(wavelength_nm, mmax)
        return self._solved[key]

    def reduced(self, wavelength_nm: float) -> tuple[float, float, complex, tuple[float, complex] | None, float]:
        """Return core radius and height, index, (thickness, index) of the shell, and edge radius.

        Lengths are multiplied by the ambient's wavenumber, indices divided by its index.
        """

        def relative(medium: OpticalConstant) -> complex:
            return complex(medium.n_complex(np.array([wavelength_nm]))[0]) / around

        around = float(self.ambient.n_complex(np.array([wavelength_nm]))[0].real)
        k = 2 * np.pi * around / wavelength_nm
        radius, height = (k * length for length in self.core_extents_nm)
        coat = None if self.shell is None else (k * self.shell.thickness_nm, relative(self.shell.material))
        return radius, height, relative(self.core), coat, k * self.edge_nm

    def _cached(self, wavelength_nm: float, mmax: int) -> ComplexArray:
        radius, height, index, coat, edge = self.reduced(wavelength_nm)
        thickness, outside = (0.0, 1.0) if coat is None else coat
        parts = (radius, height, index.real, index.imag, thickness, outside.real, outside.imag)
        numbers = [float(v).hex() for v in (*parts, *([edge] if edge else []))]
        key = "tmatrix-" + fingerprint({"shape": self.shape, "numbers": numbers}, {}, lmax=self.lmax, mmax=mmax)
        stored = cached_arrays(key)
        if stored and {"real", "imaginary", "error"} <= stored.keys():
            t_matrix, error = stored["real"] + 1j * stored["imaginary"], float(stored["error"])
        else:
            with single_threaded_blas():  # the matrices are small, and callers run in threads
                t_matrix, error = self._solve(radius, height, index, mmax, coat, edge)
            cache_arrays(key, {"real": t_matrix.real, "imaginary": t_matrix.imag, "error": np.array(error)})
        self.errors[wavelength_nm] = max(error, self.errors.get(wavelength_nm, 0.0))
        if error > REFUSED:
            raise UnsupportedError(
                f"{self.source}: the T-matrix does not converge at {wavelength_nm:g} nm: two meshes differ by "
                f"{error:.2g}, {REFUSED:g} is allowed{self._remedy}"
            )
        return t_matrix

    @property
    def _remedy(self) -> str:
        if self.shape != "cylinder":
            return ""
        if self.edge_nm:
            return "; a larger edge_radius_nm may help"
        beside = "ambient's" if self.shell is None else "shell's"
        return (
            f" (at a sharp edge a metal whose permittivity is near minus the {beside} has no finite field); give the "
            "edges a radius: edge_radius_nm = 1, say"
        )

    def _solve(
        self,
        radius: float,
        height: float,
        index: complex,
        mmax: int,
        coat: tuple[float, complex] | None = None,
        edge: float = 0.0,
    ) -> tuple[ComplexArray, float]:
        """Return T and its estimated error; `coat` is (thickness, index), `edge` the edge radius."""
        thickness, shell = (0.0, index) if coat is None else coat
        highest = max(abs(index), abs(shell))
        if coat is not None:
            highest = max(highest, film_mode(index, shell, thickness))

        def mesh(fineness: int, closer: float, make: Callable[..., Mesh] = Mesh) -> Mesh:
            if self.shape == "cylinder":
                # a rounded cylinder is the outer coat surface on a smaller sharp one
                sharp = (radius - edge, height - 2 * edge, closer * highest, fineness)
                core, outside = cylinder_panels(*sharp, edge + thickness)
                if edge:
                    core = cylinder_panels(*sharp, edge)[1]
            else:
                outside = spheroid_panels(radius, height, closer * highest, -fineness, thickness)
                core = np.column_stack([outside[:, :-1], np.zeros(len(outside))])
            return make(core) if coat is None else make(outside, core)

        start, *finer = (LADDER[0] - 1, *LADDER) if self.shape == "cylinder" else SMOOTH_LADDER
        before, closer = mesh(start, 1.0, COARSE), 1.0
        for fineness in finer:
            now = mesh(fineness, closer)
            t_matrix, error = self._compared(now, before, index, mmax, coat)
            if error <= CONTENT:
                break
            before = now
            # refine a coat also away from the core edge
            closer *= 1.0 if coat is None and not edge else CLOSER
        return t_matrix, error

    def _compared(
        self, fine: Mesh, coarse: Mesh, index: complex, mmax: int, coat: tuple[float, complex] | None
    ) -> tuple[ComplexArray, float]:
        """Return T and its relative difference from a coarser mesh, an upper error bound."""
        count = len(fine.panels) + (0 if fine.core is None else len(fine.core))
        if count > (MOST_PANELS if coat is None else MOST_WITH_COAT):
            raise UnsupportedError(
                f"{self.source}: a particle {2 * self.radius_nm:g} nm wide and {self.height_nm:g} nm high takes "
                f"{count} panels, too many to be solved; it is too large or too flat"
                + ("" if coat is None else ", or its coat too thin")
            )
        outermost, core = (index, None) if coat is None else (coat[1], index)
        t_matrix = reciprocal(block_t_matrix(fine, outermost, self.lmax, mmax, core))
        again = reciprocal(block_t_matrix(coarse, outermost, CHECKED_ORDER, 1, core))
        selected = np.concatenate([np.arange(CHECKED_ORDER), self.lmax + np.arange(CHECKED_ORDER)])
        change = float(np.linalg.norm(again - t_matrix[:2, selected[:, None], selected]) / np.linalg.norm(again))
        return t_matrix, max(change, gain(t_matrix), 1e-6)

    def index(self, wavelength_nm: float) -> complex | None:
        """Return the particle index."""
        return complex(self.core.n_complex(np.array([wavelength_nm]))[0])

    def exported_t_matrices(self, wavelengths_nm: Array) -> AxialTMatrices:
        """Return the T-matrices at the given wavelengths, with all azimuthal orders, up to degree 10."""

        def whole(wavelength_nm: float) -> ComplexArray:
            return truncated(self.azimuthal(wavelength_nm, EXPORTED_ORDER), EXPORTED_ORDER)

        blocks = in_threads(whole, [float(w) for w in wavelengths_nm])
        around = self.ambient.n_complex(wavelengths_nm).real
        return AxialTMatrices(
            wavelengths_nm,
            np.stack(blocks),
            around,
            self.name,
            self.radius_nm,
            self.height_nm,
            self.circumscribing_nm,
            None if self.shell is not None else self.core.n_complex(wavelengths_nm),
        )
