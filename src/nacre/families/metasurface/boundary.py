"""The T-matrix of a body of revolution with a mirror plane, by a boundary integral equation.

PMCHWT: the tangential fields inside and outside, each from the equivalent currents J and M, are equal on the surface.
Galerkin with polynomials on panels of the generating curve, J_t and M_t continuous, the panels graded towards an edge
where the field is singular. The system is symmetric in the bilinear product, and the waves that excite it are those
that it is asked for, so T = v~ S^-1 v has an error of second order in that of the currents. Formulation: Poggio and
Miller, Chang and Harrington, Wu and Tsai; for bodies of revolution Mautz and Harrington, AEU 33, 71 (1979).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import spherical_jn

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface import revolution as rev
from nacre.families.metasurface.angular import angular_functions, legendre


@dataclass(frozen=True)
class Mesh:
    """How finely a body is solved: panels, degree of the polynomials, and nodes."""

    panels: Array
    degree: int = 6
    outer: int = 14
    far: int = 10
    on_itself: int = 14


def _outer_rule(count: int) -> tuple[Array, Array]:
    """Nodes on (-1, 1) that crowd at both ends, where the inner integral has its logarithms."""
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * x * (3 - x**2), 1.5 * w * (1 - x**2)


def block_t_matrix(mesh: Mesh, index: complex, lmax: int, mmax: int | None = None) -> ComplexArray:
    """Return T, `[m, n, n']`, in the basis of `axial`.

    Args:
        mesh: of lengths times the ambient k.
        index: of the body over the ambient's.
    """
    top = lmax if mmax is None else mmax
    panels, degree = np.ascontiguousarray(mesh.panels, dtype=float), mesh.degree
    count, size = len(panels), degree + 1
    s, w = _outer_rule(mesh.outer)
    points = np.array([[*rev.locate(p, x), x] for p in panels for x in s])
    speeds = points[:, 4]
    targets = np.ascontiguousarray(points[:, [0, 1, 2, 3, 5]])
    homes = np.repeat(np.arange(count), len(s))
    rows = np.zeros((len(targets), 2, count, 16, top + 1, size), dtype=complex)
    rev.fill_rows(panels, targets, homes, complex(index), degree, mesh.far, mesh.on_itself, *rev.gauss_table(), rows)
    tests = _tests(mesh, s, w, targets, speeds)
    out = np.zeros((top + 1, 2 * lmax, 2 * lmax), dtype=complex)
    waves = _waves(targets, lmax, top)
    for parity in (1.0, -1.0):
        with_images = tuple(np.asarray(rows[:, 0] + sign * rows[:, 1], dtype=complex) for sign in (parity, -parity))
        for m in range(top + 1):
            matrix = _system(with_images, tests, m, count, parity)
            right, left, kept = _excitations(waves, tests, m, lmax, count, parity)
            if kept.size == 0:
                continue
            found = 2.0 * left.T @ np.linalg.solve(matrix, right)
            out[m, kept[:, None], kept] = found
    return out


@dataclass(frozen=True)
class _Tests:
    """Test functions at the targets, by panel, `[panel, shape, target]`: rho b_t, (rho b_t)', rho b_p, b_p."""

    t: Array
    spread: Array
    p: Array
    plain: Array


def _tests(mesh: Mesh, s: Array, w: Array, targets: Array, speeds: Array) -> _Tests:
    size, count = mesh.degree + 1, len(mesh.panels)
    along, slope, around = (np.empty((size, len(s))) for _ in range(3))
    for n, x in enumerate(s):
        a, b, c = (np.empty(size) for _ in range(3))
        rev.shapes(x, mesh.degree, a, b, c)
        along[:, n], slope[:, n], around[:, n] = a, b, c
    rho = targets[:, 0].reshape(count, 1, -1)
    t_rho, speed = targets[:, 2].reshape(count, 1, -1), speeds.reshape(count, 1, -1)
    return _Tests(
        rho * along * speed * w, (t_rho * speed * along + rho * slope) * w, rho * around * speed * w,
        np.broadcast_to(around * w, (count, *around.shape)) * speed,
    )  # fmt: skip


def _system(with_images: tuple[ComplexArray, ...], tests: _Tests, m: int, count: int, parity: float) -> ComplexArray:
    """Return S of one azimuthal order and one parity: the unknowns are J_t, J_p, M_t, M_p."""
    targets = with_images[0].shape[0] // count

    def of(image: int, kernel: int, test: Array) -> ComplexArray:
        part = with_images[image][:, :, kernel, m].reshape(count, targets, -1)
        return (test @ part).reshape(count * test.shape[1], -1)

    def electric(image: int, first: int) -> tuple[ComplexArray, ...]:
        tt, tp, pt, pp, st, sp = (first + n for n in range(6))
        im = 1j * m
        return (
            of(image, tt, tests.t) - of(image, st, tests.spread),
            of(image, tp, tests.t) - im * of(image, sp, tests.spread),
            of(image, pt, tests.p) + im * of(image, st, tests.plain),
            of(image, pp, tests.p) - m**2 * of(image, sp, tests.plain),
        )

    def crossed(image: int) -> tuple[ComplexArray, ...]:
        return (
            of(image, rev.K_TT, tests.t), of(image, rev.K_TP, tests.t), of(image, rev.K_PT, tests.p),
            of(image, rev.K_PP, tests.p),
        )  # fmt: skip

    def square(parts: tuple[ComplexArray, ...], rows: float, columns: float) -> ComplexArray:
        left, right = _joined(count, tests.t.shape[1], rows), _joined(count, tests.t.shape[1], columns)
        return np.block([[left.T @ parts[0] @ right, left.T @ parts[1]], [parts[2] @ right, parts[3]]])

    # J goes with the parity, M against it; of the t components the odd ones vanish on the equator
    j, mag = parity, -parity
    e_j, h_m = square(electric(0, rev.E_TT), j, j), square(electric(1, rev.H_TT), mag, mag)
    k_m, k_j = square(crossed(1), j, mag), square(crossed(0), mag, j)
    whole = np.block([[1j * e_j, -k_m], [-k_j, -1j * h_m]])
    return whole


def _joined(count: int, size: int, parity: float) -> Array:
    """Return the matrix from continuous functions to the panels' own, `[panel x shape, unknown]`.

    A vector field that goes with the mirror has an odd t component, counted along the curve: none on the equator.
    """
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
    """Tangential components of the regular waves at the targets, `[m, l, target]`, without their factors i."""
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
    waves: dict[str, Array], tests: _Tests, m: int, lmax: int, count: int, parity: float
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Return v and v~, `[unknown, wave]`, of the waves of one parity, and their places n = (tau, l)."""
    l = np.arange(1, lmax + 1)
    even = (-1.0) ** (l + m)
    magnetic = l[(l >= max(m, 1)) & (-even == parity)] - 1
    electric = l[(l >= max(m, 1)) & (even == parity)] - 1
    size = tests.t.shape[1]

    def tested(values: ComplexArray, test: Array) -> ComplexArray:
        cut = values.reshape(len(values), count, -1)
        return np.asarray(np.einsum("qks,nqs->qkn", test, cut).reshape(count * size, len(values)))

    def side(conjugate: float) -> ComplexArray:
        i = 1j * conjugate
        m_t, m_p = i * waves["m_t"][m], waves["m_p"][m] + 0j
        n_t, n_p = waves["n_t"][m] + 0j, i * waves["n_p"][m]
        e_t, e_p = np.concatenate([m_t[magnetic], n_t[electric]]), np.concatenate([m_p[magnetic], n_p[electric]])
        h_t, h_p = (
            -1j * np.concatenate([n_t[magnetic], m_t[electric]]), -1j * np.concatenate([n_p[magnetic], m_p[electric]]),
        )  # fmt: skip
        return np.concatenate(
            [
                -_joined(count, size, parity).T @ tested(e_t, tests.t), -tested(e_p, tests.p),
                _joined(count, size, -parity).T @ tested(h_t, tests.t), tested(h_p, tests.p),
            ]
        )  # fmt: skip

    return side(1.0), side(-1.0), np.concatenate([magnetic, lmax + electric])
