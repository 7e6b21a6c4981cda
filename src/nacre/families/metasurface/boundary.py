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
    """How finely a body is solved: panels, of its core too where it is a coat, degree of the polynomials, nodes."""

    panels: Array
    core: Array | None = None
    degree: int = 6
    outer: int = 14
    far: int = 10
    on_itself: int = 14


def _outer_rule(count: int) -> tuple[Array, Array]:
    """Nodes on (-1, 1) that crowd at both ends, where the inner integral has its logarithms."""
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * x * (3 - x**2), 1.5 * w * (1 - x**2)


def block_t_matrix(
    mesh: Mesh, index: complex, lmax: int, mmax: int | None = None, core: complex | None = None
) -> ComplexArray:
    """Return T, `[m, n, n']`, in the basis of `axial`.

    The field in a shell is that of the currents on both its surfaces: on the diagonal stand the operators of the media
    on either side of a surface, off it those of the shell alone, with a minus.

    Args:
        mesh: of lengths times the ambient k.
        index: of the body, or of its shell, over the ambient's.
        core: index of what lies inside the mesh's second surface.
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
        right, left, kept = _excitations(waves, outermost, m, lmax, parity)
        if kept.size == 0:
            continue
        matrix = np.block(blocks)
        unlit = np.zeros((len(matrix) - len(right), right.shape[1]))
        currents = np.linalg.solve(matrix, np.concatenate([right, unlit]))
        out[m, kept[:, None], kept] = 2.0 * left.T @ currents[: len(right)]
    return out


@dataclass(frozen=True)
class _Surface:
    """A surface's panels, its targets (rho, z, t_rho, t_z, s), and test functions there, `[panel, shape, target]`.

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
        """Number of panels."""
        return len(self.panels)

    @property
    def size(self) -> int:
        """Number of shape functions on a panel."""
        return int(self.t.shape[1])

    @classmethod
    def of(cls, mesh: Mesh, panels: Array) -> _Surface:
        """Prepare a surface at the nodes of a mesh."""
        panels = np.ascontiguousarray(panels, dtype=float)
        s, w = _outer_rule(mesh.outer)
        points = np.array([[*rev.locate(p, x), x] for p in panels for x in s])
        targets = np.ascontiguousarray(points[:, [0, 1, 2, 3, 5]])
        size, count = mesh.degree + 1, len(panels)
        along, slope, around = (np.empty((size, len(s))) for _ in range(3))
        for n, x in enumerate(s):
            a, b, c = (np.empty(size) for _ in range(3))
            rev.shapes(x, mesh.degree, a, b, c)
            along[:, n], slope[:, n], around[:, n] = a, b, c
        rho, t_rho, speed = (points[:, k].reshape(count, 1, -1) for k in (0, 2, 4))
        return cls(
            panels, targets, rho * along * speed * w, (t_rho * speed * along + rho * slope) * w,
            rho * around * speed * w, np.broadcast_to(around * w, (count, *around.shape)) * speed,
        )  # fmt: skip


def _rows(mesh: Mesh, at: _Surface, of: _Surface, waves: list[complex], top: int) -> ComplexArray:
    """Return the integrals over one surface's panels at the targets of one, see `revolution.fill_rows`."""
    homes = np.repeat(np.arange(at.count), len(at.targets) // at.count) if at is of else np.full(len(at.targets), -1)
    rows = np.zeros((len(at.targets), 2, of.count, 16, top + 1, of.size), dtype=complex)
    numbers = np.array(waves, dtype=complex)
    rev.fill_rows(
        of.panels, at.targets, homes, numbers, mesh.degree, mesh.far, mesh.on_itself, *rev.gauss_table(), rows
    )
    return rows


def _block(with_images: tuple[ComplexArray, ...], at: _Surface, of: _Surface, m: int, parity: float) -> ComplexArray:
    """Return a block of S of one azimuthal order and one parity: the unknowns are J_t, J_p, M_t, M_p."""

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
            tested(image, rev.K_TT, at.t), tested(image, rev.K_TP, at.t), tested(image, rev.K_PT, at.p),
            tested(image, rev.K_PP, at.p),
        )  # fmt: skip

    def square(parts: tuple[ComplexArray, ...], rows: float, columns: float) -> ComplexArray:
        left, right = _joined(at, rows), _joined(of, columns)
        return np.block([[left.T @ parts[0] @ right, left.T @ parts[1]], [parts[2] @ right, parts[3]]])

    # J goes with the parity, M against it; of the t components the odd ones vanish on the equator
    j, mag = parity, -parity
    e_j, h_m = square(electric(0, rev.E_TT), j, j), square(electric(1, rev.H_TT), mag, mag)
    k_m, k_j = square(crossed(1), j, mag), square(crossed(0), mag, j)
    return np.block([[1j * e_j, -k_m], [-k_j, -1j * h_m]])


def _joined(surface: _Surface, parity: float) -> Array:
    """Return the matrix from continuous functions to the panels' own, `[panel x shape, unknown]`.

    A vector field that goes with the mirror has an odd t component, counted along the curve: none on the equator.
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
    waves: dict[str, Array], surface: _Surface, m: int, lmax: int, parity: float
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Return v and v~, `[unknown, wave]`, of the waves of one parity on a surface, and their places n = (tau, l)."""
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
            -1j * np.concatenate([n_t[magnetic], m_t[electric]]), -1j * np.concatenate([n_p[magnetic], m_p[electric]]),
        )  # fmt: skip
        return np.concatenate(
            [
                -_joined(surface, parity).T @ tested(e_t, surface.t), -tested(e_p, surface.p),
                _joined(surface, -parity).T @ tested(h_t, surface.t), tested(h_p, surface.p),
            ]
        )  # fmt: skip

    return side(1.0), side(-1.0), np.concatenate([magnetic, lmax + electric])
