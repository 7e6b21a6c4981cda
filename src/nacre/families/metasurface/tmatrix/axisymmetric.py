"""T-matrices for axisymmetric particles, and particles whose T-matrices come from a file.

In the `special_functions` basis such a matrix is one block for each azimuthal order m >= 0, `[m, n, n']` with
n = (tau, l); blocks for -m follow from the mirror plane through the axis, which changes the sign between different tau.
The orthonormal basis with Condon-Shortley phases (tmat.h5 files, treams) differs by factors that depend only on m, so
the blocks are the same in both.

A tabulated sphere takes the sphere multipole order rather than all orders in the file. Beyond the file, Mie
coefficients extend it if the file states radius and index and agrees with Mie theory.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import MaterialRangeError, UnsupportedError
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter.mie import mie_coefficients

SAME_WAVELENGTH = 1e-6  # relative; files hold wavenumbers with few digits


def multipole_order(t_matrix: ComplexArray) -> int:
    """Return the highest l in a T-matrix: diagonal, `[n]`, or blocks, `[m, n, n']`."""
    return int(t_matrix.shape[-1] // 2)


def truncated(t_matrix: ComplexArray, lmax: int) -> ComplexArray:
    """Return a T-matrix, `[n]` or `[m, n, n']`, with multipoles up to `lmax`."""
    top = multipole_order(t_matrix)
    if lmax >= top:
        return t_matrix
    selected = np.concatenate([np.arange(lmax), top + np.arange(lmax)])
    if t_matrix.ndim == 1:
        return np.asarray(t_matrix[selected])
    return np.asarray(t_matrix[: lmax + 1, selected[:, None], selected])


def as_blocks(t_matrix: ComplexArray, mmax: int | None = None) -> ComplexArray:
    """Return a diagonal T `[n]` as blocks `[m, n, n']`, zero for l < m; blocks are returned unchanged."""
    if t_matrix.ndim == 3:
        return t_matrix if mmax is None else t_matrix[: mmax + 1]
    lmax = multipole_order(t_matrix)
    l = np.tile(np.arange(1, lmax + 1), 2)
    m = np.arange((lmax if mmax is None else mmax) + 1)
    return np.asarray(np.where(l >= m[:, None], t_matrix, 0.0)[:, :, None] * np.eye(2 * lmax))


def mirror_signs(lmax: int) -> Array:
    """Return the signs between the blocks m and -m, `[n, n']`; they also relate T to its transpose."""
    tau = np.repeat([1.0, -1.0], lmax)
    return np.asarray(tau[:, None] * tau)


def reciprocal(blocks: ComplexArray) -> ComplexArray:
    """Return the reciprocal part of T, `[..., n, n']`: T_nn' = (-1)^(tau + tau') T_n'n."""
    signs = mirror_signs(blocks.shape[-1] // 2)
    return np.asarray(0.5 * (blocks + signs * np.swapaxes(blocks, -1, -2)))


def gain(blocks: ComplexArray) -> float:
    """Return the maximum radiated excess over incident power for T `[..., n, n']`; 0 for passive particles.

    The largest eigenvalue in (T + T^+)/2 + T^+ T, which is 0 for lossless and negative for absorbing particles.
    """
    turned = np.conj(np.swapaxes(blocks, -1, -2))
    return max(0.0, float(np.linalg.eigvalsh(0.5 * (blocks + turned) + turned @ blocks).max()))


@dataclass(frozen=True)
class AxialTMatrices:
    """T-matrices for one particle over the wavelength.

    Attributes:
        wavelengths_nm: `[wavelength]`, in vacuum, ascending.
        blocks: `[wavelength, m, n, n']`, m from 0 to the highest order.
        ambient_index: `[wavelength]`, surrounding medium.
        name: particle description.
        radius_nm: largest distance from the axis; unknown by default.
        height_nm: full height along the axis, centred; unknown by default.
        circumscribing_nm: largest distance from the centre; unknown by default.
        material_index: `[wavelength]`, particle; None if unknown or for several materials.
        turn_loss: scattered power share that depends on the rotation about the axis and is not in the blocks.
        shape: "sphere", "spheroid" or "cylinder", "" for others.
        full: full T over all m, `[wavelength, n, n']`, see `full_tmatrix`, for aligned particles without rotational
            symmetry, whose rotational average the blocks are; else None.
    """

    wavelengths_nm: Array
    blocks: ComplexArray
    ambient_index: Array
    name: str = "particle"
    radius_nm: float | None = None
    height_nm: float | None = None
    circumscribing_nm: float | None = None
    material_index: ComplexArray | None = None
    turn_loss: float = 0.0
    shape: str = ""
    full: ComplexArray | None = None

    @property
    def lmax(self) -> int:
        """Highest multipole order."""
        return multipole_order(self.blocks)

    def at(self, wavelength_nm: float, hold_ends: bool = False, is_full: bool = False) -> ComplexArray:
        """Return T at a wavelength, `[m, n, n']`, or `[n, n']` over all m, linear between the tabulated wavelengths.

        Averages of passive T-matrices are passive (scattering matrices with norm <= 1 form a convex set). Interpolation
        with higher order could violate energy conservation.

        Raises:
            MaterialRangeError: outside the range, unless `hold_ends`.
        """
        known = self.wavelengths_nm
        low, high = float(known[0]), float(known[-1])
        slack = SAME_WAVELENGTH * wavelength_nm
        if not hold_ends and not low - slack <= wavelength_nm <= high + slack:
            where = f"at {low:.6g} nm only" if len(known) == 1 else f"from {low:.6g} to {high:.6g} nm"
            raise MaterialRangeError(
                f'the T-matrix of {self.name} is known {where}, not at {wavelength_nm:g} nm; extrapolate = "edge" '
                "holds the end values"
            )
        x = float(np.interp(wavelength_nm, known, np.arange(len(known))))
        start = min(int(x), len(known) - 1)
        end = min(start + 1, len(known) - 1)
        known_t = self.full if is_full and self.full is not None else self.blocks
        return np.asarray(known_t[start] + (x - start) * (known_t[end] - known_t[start]))


class Body(abc.ABC):
    """A non-spherical particle.

    Attributes:
        name: description.
        radius_nm: largest distance from the axis, used for coverage and drawings.
        height_nm: full height, centred.
        circumscribing_nm: largest distance from the centre.
        source: recipe key and value, for messages.
        shape: "cylinder", "spheroid" or "sphere", or "" if only the T-matrix is known.
        lmax: highest multipole order.
        method: T-matrix origin, in words.
    """

    method: ClassVar[str] = "from a file"
    name: str
    radius_nm: float
    height_nm: float
    circumscribing_nm: float
    source: str
    shape: str
    lmax: int

    @abc.abstractmethod
    def t_matrix(self, wavelength_nm: float) -> ComplexArray:
        """Return T at a wavelength, `[m, n, n']`, to the azimuthal order that monolayers need.

        Raises:
            MaterialRangeError: outside the tabulated wavelengths.
            UnsupportedError: it cannot be computed.
        """

    @abc.abstractmethod
    def index(self, wavelength_nm: float) -> complex | None:
        """Return the particle index, or None if unknown."""

    def with_radius(self, radius_nm: float) -> Body:
        """Return the same particle with another width and the same height.

        Raises:
            UnsupportedError: only one size is known.
        """
        raise UnsupportedError(f"{self.source}: its T-matrix is of one size, so sizes cannot spread")

    @property
    def estimated_error(self) -> float | None:
        """Largest estimated relative error in the computed T-matrices; None without an estimate."""
        return None

    @property
    def turn_loss(self) -> float:
        """Scattered power share that depends on the rotation about the axis and is left out; 0 if symmetric."""
        return 0.0

    @property
    def is_aligned(self) -> bool:
        """Whether the particle is not axisymmetric and has one fixed orientation."""
        return False

    @abc.abstractmethod
    def exported_t_matrices(self, wavelengths_nm: Array) -> AxialTMatrices:
        """Return the T-matrices for export: the tabulated ones, or those at the given wavelengths."""

    def check_order(self, order: int) -> None:
        """Refuse a multipole order above `lmax`.

        Raises:
            UnsupportedError: the order is higher.
        """
        if order > self.lmax:
            raise UnsupportedError(
                f"model.multipole_order = {order} is higher than what {self.source} holds: l up to {self.lmax}"
            )


@dataclass(frozen=True)
class TabulatedBody(Body):
    """A particle whose T-matrices come from a file. See `Body`.

    Attributes:
        hold_ends: whether the end values hold beyond the tabulated wavelengths.
        turn_rad: rotation about the normal, from x towards y, if aligned.
    """

    known: AxialTMatrices
    radius_nm: float
    height_nm: float
    circumscribing_nm: float
    source: str
    hold_ends: bool = False
    shape: str = ""
    turn_rad: float = 0.0

    @property
    def is_aligned(self) -> bool:
        """Whether the full T-matrix is used and not its rotational average."""
        return self.known.full is not None

    @property
    def name(self) -> str:  # type: ignore[override]  # read only, as all of a frozen dataclass
        """Name from the file."""
        return self.known.name

    @property
    def lmax(self) -> int:  # type: ignore[override]
        """Highest multipole order in the file."""
        return self.known.lmax

    @property
    def turn_loss(self) -> float:
        """Scattered power share that depends on the rotation about the axis and is left out."""
        return self.known.turn_loss

    def t_matrix(self, wavelength_nm: float) -> ComplexArray:
        """Return T at a wavelength, `[m, n, n']`.

        Raises:
            MaterialRangeError: outside the tabulated wavelengths.
        """
        return self.known.at(wavelength_nm, self.hold_ends)

    def index(self, wavelength_nm: float) -> complex | None:
        """Return the particle index if the file states it."""
        if self.known.material_index is None:
            return None
        nearest = int(np.argmin(np.abs(self.known.wavelengths_nm - wavelength_nm)))
        return complex(self.known.material_index[nearest])

    def exported_t_matrices(self, wavelengths_nm: Array) -> AxialTMatrices:
        """Return the tabulated T-matrices with the recipe's dimensions."""
        return replace(
            self.known, radius_nm=self.radius_nm, height_nm=self.height_nm, circumscribing_nm=self.circumscribing_nm
        )


SAME_T = 1e-9  # relative norm: above rounding, far below any mesh error
SAME_SIZE = 1e-9
SPHERE = "sphere"


def is_spherical(known: AxialTMatrices) -> bool:
    """Return whether the T-matrices belong to spheres at all wavelengths."""
    return all(
        np.linalg.norm(as_blocks(np.diagonal(blocks[1])) - blocks) <= SAME_T * np.linalg.norm(blocks)
        for blocks in known.blocks
    )


@dataclass(frozen=True)
class TabulatedSphere(TabulatedBody):
    """A sphere whose T-matrices come from a file. See `Body`."""

    def coefficients(self, lmax: int, surface: Substrate) -> ComplexArray:
        """Return the diagonal T, `[n]`: from the file, and beyond its order from Mie theory, or zeros.

        Raises:
            MaterialRangeError: outside the tabulated wavelengths.
        """
        available = np.diagonal(self.t_matrix(surface.wavelength_nm)[1])
        out = np.zeros(2 * lmax, dtype=complex)
        if self.is_extended_by_mie and lmax > self.lmax:
            stated, known = self.known.material_index, self.known.wavelengths_nm
            assert stated is not None
            index = complex(np.interp(surface.wavelength_nm, known, stated))
            out = self._mie(lmax, surface.inner_wavenumber, index / surface.inner_index)
        count = min(lmax, self.lmax)
        for tau in range(2):
            out[tau * lmax : tau * lmax + count] = available[tau * self.lmax : tau * self.lmax + count]
        return out

    @cached_property
    def is_extended_by_mie(self) -> bool:
        """Whether Mie theory extends the file: it states the sphere, and its coefficients agree."""
        known = self.known
        if known.material_index is None:
            return False
        around = known.ambient_index
        return all(
            np.linalg.norm(self._mie(self.lmax, 2 * np.pi * n / w, m / n) - np.diagonal(blocks[1]))
            <= SAME_T * np.linalg.norm(np.diagonal(blocks[1]))
            for w, n, m, blocks in zip(known.wavelengths_nm, around, known.material_index, known.blocks)
        )

    def _mie(self, lmax: int, wavenumber: float, index: complex) -> ComplexArray:
        a, b = mie_coefficients(lmax, np.array([wavenumber * self.radius_nm]), np.array([index]))
        return np.concatenate([-b, -a])


# Full T-matrices, which couple azimuthal orders: particles without rotational symmetry about the normal.
#
# Multipoles are n = (m, tau, l) with m from -L to L, in `multipole_index` order and with the phases in
# `special_functions`: as in tmat.h5 files without the Condon-Shortley sign, (-1)^m for m > 0.

IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class MultipoleIndex:
    """Flat multipole index up to order L: arrays `[n]` for m, tau and l."""

    order: int
    m: IntArray
    tau: IntArray
    l: IntArray

    @property
    def block(self) -> IntArray:
        """Position on the (tau, l) axis in `plane_wave_vectors`."""
        return self.tau * self.order + self.l - 1


@lru_cache(maxsize=8)
def multipole_index(order: int) -> MultipoleIndex:
    """Return the index for all (m, tau, l) with |m| <= l <= order."""
    rows = [(m, tau, l) for m in range(-order, order + 1) for tau in range(2) for l in range(max(1, abs(m)), order + 1)]
    m, tau, l = np.array(rows, dtype=np.intp).T
    return MultipoleIndex(order, m, tau, l)


def with_negative_orders(vectors: ComplexArray, index: MultipoleIndex) -> ComplexArray:
    """Expand `[m >= 0, pol, (tau, l), ...]` to all m: `[pol, n, ...]`.

    m -> -m changes the sign in the m pi functions, those with tau != pol.
    """
    picked = vectors[np.abs(index.m), :, index.block]  # advanced indices lead: [n, pol, ...]
    flips = (index.m[:, None] < 0) & (index.tau[:, None] != np.arange(2))
    sign = np.where(flips, -1.0, 1.0).reshape(len(index.m), 2, *([1] * (vectors.ndim - 3)))
    return np.moveaxis(picked * sign, 0, 1)


def azimuthal_blocks(matrix: ComplexArray, lmax: int, mmax: int) -> ComplexArray:
    """Return the blocks `[m, (tau, l), (tau, l)']` of an `[n, n']`, zero beyond its order; see `spread_blocks`."""
    order = full_order(matrix)
    index = multipole_index(order)
    rows = index.tau * lmax + index.l - 1
    out = np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    for m in range(min(order, mmax) + 1):
        here = index.m == m
        out[m, rows[here][:, None], rows[here]] = matrix[here][:, here]
    return out


@lru_cache(maxsize=32)
def truncated_index(lmax: int, mmax: int) -> tuple[MultipoleIndex, IntArray]:
    """Return the multipoles up to `lmax` with |m| <= `mmax`, and their places among all up to `lmax`."""
    every = multipole_index(lmax)
    selected = np.nonzero(np.abs(every.m) <= mmax)[0]
    return MultipoleIndex(lmax, every.m[selected], every.tau[selected], every.l[selected]), selected


def full_order(matrix: ComplexArray) -> int:
    """Return the highest l in matrices over all m, `[..., n, n']`, with 2 L (L + 2) multipoles."""
    return round(np.sqrt(matrix.shape[-1] / 2 + 1)) - 1


def truncated_full(matrix: ComplexArray, lmax: int) -> ComplexArray:
    """Return a full T, `[n, n']`, with multipoles up to `lmax`."""
    selected = np.nonzero(multipole_index(full_order(matrix)).l <= lmax)[0]
    return np.asarray(matrix[selected[:, None], selected])


def spread_blocks(blocks: ComplexArray, index: MultipoleIndex) -> ComplexArray:
    """Return blocks `[m >= 0, (tau, l), (tau, l)']` for an axisymmetric operator over the `index` multipoles."""
    rows = index.tau * (blocks.shape[1] // 2) + index.l - 1
    sign = np.where((index.m[:, None] < 0) & (index.tau[:, None] != index.tau), -1.0, 1.0)
    same = index.m[:, None] == index.m
    return np.asarray(np.where(same, blocks[np.abs(index.m)[:, None], rows[:, None], rows] * sign, 0.0))


def condon_shortley_signs(index: MultipoleIndex) -> NDArray[np.float64]:
    """Return the Condon-Shortley sign per multipole, `[n]`."""
    return np.where((index.m > 0) & (index.m % 2 == 1), -1.0, 1.0)


def reversed_full(matrix: ComplexArray) -> ComplexArray:
    """Return T for reversed light, `[..., n, n']`; equal to T for a reciprocal particle.

    T_(m tau l),(m' tau' l') becomes T_(-m' tau' l'),(-m tau l) times the tau and tau' signs: a reversed wave rotates
    the other way about the axis, and B becomes its adjoint.
    """
    index = multipole_index(full_order(matrix))
    places = {key: i for i, key in enumerate(zip(index.m.tolist(), index.tau.tolist(), index.l.tolist(), strict=True))}
    partner = [places[(-m, tau, l)] for (m, tau, l) in places]
    return np.asarray(np.swapaxes(matrix, -1, -2)[..., partner, :][..., :, partner])
