"""Spheres in a matrix: materials, structure and effective index (Bruggeman, Maxwell Garnett).

One index n_e represents the whole composite in three places: as the medium around each sphere (Mie), in the scattering
vector, and at the layer's faces (Fresnel, refraction).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.families.glass.medium import Medium, Spheres, solve_medium
from nacre.matter.indices.constant import OpticalConstant

INDEX_NM = 550.0  # random walks refract all wavelengths with the index at this one
MAX_EXTINCTION = 0.1  # Im(n_e), above which light is absorbed within a few wavelengths


@dataclass(frozen=True)
class Composite:
    """Spheres in a matrix, independent of the wavelength.

    Attributes:
        materials: `[layer]`, core and optional shell.
        radii_nm: `[layer]`.
        deviation_nm: standard deviation of the outer radius.
        volume_fraction: filled by whole spheres.
        matrix: material between the spheres.
        matrix_k: added to the matrix's k by an absorber.
        absorber: an absorbing material and its share of the matrix, or None.
        mixing: "bruggeman" or "maxwell-garnett".
        structure: S over q d rather than hard spheres, or None.
    """

    materials: tuple[OpticalConstant, ...]
    radii_nm: tuple[float, ...]
    volume_fraction: float
    matrix: OpticalConstant
    deviation_nm: float = 0.0
    matrix_k: float = 0.0
    absorber: tuple[OpticalConstant, float] | None = None
    mixing: str = "bruggeman"
    structure: Callable[[Array], Array] | None = None

    @property
    def diameter_nm(self) -> float:
        """Mean diameter of whole spheres."""
        return 2.0 * self.radii_nm[-1]

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelength range of all materials."""
        ranges = [m.range_nm for m in (*self.materials, self.matrix)]
        return max(low for low, _ in ranges), min(high for _, high in ranges)

    def matrix_index(self, wavelengths_nm: Array) -> ComplexArray:
        """Index n + ik of matrix and absorber, `[wavelength]`."""
        n = self.matrix.n_complex(wavelengths_nm) + 1j * self.matrix_k
        if self.absorber is not None:
            material, share = self.absorber
            n = n + 1j * share * material.n_complex(wavelengths_nm).imag
        return np.asarray(n)

    def effective_index(self, wavelengths_nm: Array) -> ComplexArray:
        """Effective index n + ik, `[wavelength]`.

        Raises:
            NacreError: it cannot be solved, or absorbs too much for scattering by spheres.
        """
        matrix = self.matrix_index(wavelengths_nm)
        layers = np.stack([m.n_complex(wavelengths_nm) for m in self.materials])
        if self.mixing == "maxwell-garnett":
            n = maxwell_garnett(layers[0], matrix, self.volume_fraction)
        else:
            inner = self.volume_fraction * (self.radii_nm[0] / self.radii_nm[-1]) ** 3
            shares = [self.volume_fraction] if len(layers) == 1 else [inner, self.volume_fraction - inner]
            n = bruggeman(np.vstack([layers, matrix[None]]), np.array([*shares, 1.0 - self.volume_fraction]))
        if np.any(n.imag > MAX_EXTINCTION):
            at = int(np.argmax(n.imag))
            raise NacreError(
                f"the effective index {n[at].real:.3g} + {n[at].imag:.2g}i at {wavelengths_nm[at]:g} nm absorbs too "
                f"much for a photonic glass; its imaginary part should be at most {MAX_EXTINCTION:g}"
            )
        return n

    @property
    def walk_index(self) -> float:
        """Index for the refraction of all wavelengths in random walks."""
        return max(float(np.abs(self.effective_index(np.array([INDEX_NM])))[0]), 1.0)

    def medium(self, wavelengths_nm: Array) -> Medium:
        """Return the turbid medium."""
        return solve_medium(self.spheres(wavelengths_nm))

    def spheres(self, wavelengths_nm: Array) -> Spheres:
        """Return the spheres at given wavelengths."""
        layers = np.stack([m.n_complex(wavelengths_nm) for m in self.materials])
        return Spheres(
            wavelengths_nm, np.array(self.radii_nm), layers, self.effective_index(wavelengths_nm),
            self.volume_fraction, self.deviation_nm, self.structure,
        )  # fmt: skip


class Filling(Protocol):
    """Filling of a stratum: a composite, or balls."""

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelength range of all materials."""

    def effective_index(self, wavelengths_nm: Array) -> ComplexArray:
        """Index n + ik for refraction into the layer, `[wavelength]`."""


@dataclass(frozen=True)
class EffectiveDispersion:
    """Optical constant of a lossless medium with the modulus of the effective index, as the ambient of a base."""

    composite: Filling

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelength range of all materials."""
        return self.composite.range_nm

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return |n + ik| + 0i."""
        flat = np.ravel(wavelengths_nm)
        found = np.abs(self.composite.effective_index(flat)) + 0j
        return np.asarray(found.reshape(np.shape(wavelengths_nm)))


ROOT_TOL = 1e-9  # of a root against its bounds
NEWTON_STEPS = 3


def bruggeman(indices: ComplexArray, fractions: Array) -> ComplexArray:
    """Return the index n of sum_i f_i (e_i - e)/(e_i + 2 e) = 0, with e = n^2 (Bruggeman 1935).

    All phases are treated alike. The physical root has a real part between those of the phases, and no gain.

    Args:
        indices: `[phase, wavelength]`, n + ik.
        fractions: `[phase]`, volume fractions, which sum to one.

    Returns:
        `[wavelength]`.

    Raises:
        NacreError: no physical root, as with metals.

    Example:
        >>> half = np.array([0.5, 0.5])
        >>> round(float(bruggeman(np.array([[1.59 + 0j], [1.0]]), half)[0].real), 5)
        1.28402
    """
    present = fractions > 0
    eps, share = indices[present] ** 2, fractions[present]
    low, high = indices[present].real.min(axis=0), indices[present].real.max(axis=0)
    found = np.empty(indices.shape[1], dtype=complex)
    for i in range(indices.shape[1]):
        roots = np.sqrt(np.roots(_polynomial(eps[:, i], share)).astype(complex))
        roots = np.where(roots.real < 0, -roots, roots)
        fits = (roots.real >= low[i] - ROOT_TOL) & (roots.real <= high[i] + ROOT_TOL) & (roots.imag >= -ROOT_TOL)
        if not np.any(fits):
            raise NacreError(
                "the effective index cannot be solved: no Bruggeman root lies between the indices "
                f"{low[i]:.4g} and {high[i]:.4g} of the phases"
            )
        mean = np.sum(share * np.sqrt(eps[:, i]))
        near = roots[fits][np.argmin(np.abs(roots[fits] - mean))]
        found[i] = _polished(near**2, eps[:, i], share)
    n = np.sqrt(found)
    return np.asarray(n.real + 1j * np.maximum(n.imag, 0.0))


def _polynomial(eps: ComplexArray, share: Array) -> ComplexArray:
    """Return the coefficients in e, highest first, of the sum without denominators."""
    total = np.zeros(len(eps) + 1, dtype=complex)
    for i, f in enumerate(share):
        part = f * np.array([-1.0, eps[i]], dtype=complex)
        for j in range(len(eps)):
            if j != i:
                part = np.polymul(part, np.array([2.0, eps[j]], dtype=complex))
        total += part
    return total


def _polished(e: complex, eps: ComplexArray, share: Array) -> complex:
    """Refine a root by Newton's method on the sum, as polynomial roots lose digits."""
    for _ in range(NEWTON_STEPS):
        value = np.sum(share * (eps - e) / (eps + 2 * e))
        slope = np.sum(-3 * share * eps / (eps + 2 * e) ** 2)
        e = e - value / slope
    return complex(e)


def maxwell_garnett(inclusion: ComplexArray, matrix: ComplexArray, fraction: float) -> ComplexArray:
    """Return the index of inclusions in a host matrix (Maxwell Garnett 1904).

    Args:
        inclusion, matrix: `[wavelength]`, n + ik.
        fraction: volume fraction of the inclusions.

    Example:
        >>> round(float(maxwell_garnett(np.array([1.59 + 0j]), np.array([1.0 + 0j]), 0.5)[0].real), 5)
        1.26845
    """
    p, m = inclusion**2, matrix**2
    e = m * (p + 2 * m + 2 * fraction * (p - m)) / (p + 2 * m - fraction * (p - m))
    return np.asarray(np.sqrt(e))
