"""Spheres in a matrix, before a wavelength is chosen: what they are made of and which index stands for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.families.glass.medium import Medium, Spheres, solve_medium
from nacre.matter.indices.constant import OpticalConstant

INDEX_NM = 550.0  # the walk refracts with the index at this wavelength, for all colours alike
MOST_ABSORBING = 0.1  # of Im(n_e): beyond, light dies within a few wavelengths and no sphere scatters as if alone


@dataclass(frozen=True)
class Composite:
    """Spheres in a matrix, before a wavelength is chosen.

    Attributes:
        materials: `[layer]`, of the core, and of the shell if there is one.
        radii_nm: `[layer]`.
        deviation_nm: standard deviation of the outer radius.
        volume_fraction: of whole spheres.
        matrix: what lies between them.
        matrix_k: what an absorber adds to the matrix's k.
        absorber: a material that fills a share of the matrix and only absorbs, with that share; or None.
        mixing: "bruggeman" or "maxwell-garnett".
        structure: S over q d in place of hard spheres, or None.
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
        """Where all its materials are known."""
        ranges = [m.range_nm for m in (*self.materials, self.matrix)]
        return max(low for low, _ in ranges), min(high for _, high in ranges)

    def matrix_index(self, wavelengths_nm: Array) -> ComplexArray:
        """n + ik of the matrix with its absorber, `[wavelength]`."""
        n = self.matrix.n_complex(wavelengths_nm) + 1j * self.matrix_k
        if self.absorber is not None:
            material, share = self.absorber
            n = n + 1j * share * material.n_complex(wavelengths_nm).imag
        return np.asarray(n)

    def effective_index(self, wavelengths_nm: Array) -> ComplexArray:
        """n + ik of the whole, `[wavelength]`.

        Raises:
            NacreError: it cannot be solved, or absorbs so much that spheres in it mean nothing.
        """
        matrix = self.matrix_index(wavelengths_nm)
        layers = np.stack([m.n_complex(wavelengths_nm) for m in self.materials])
        if self.mixing == "maxwell-garnett":
            n = maxwell_garnett(layers[0], matrix, self.volume_fraction)
        else:
            inner = self.volume_fraction * (self.radii_nm[0] / self.radii_nm[-1]) ** 3
            shares = [self.volume_fraction] if len(layers) == 1 else [inner, self.volume_fraction - inner]
            n = bruggeman(np.vstack([layers, matrix[None]]), np.array([*shares, 1.0 - self.volume_fraction]))
        if np.any(n.imag > MOST_ABSORBING):
            at = int(np.argmax(n.imag))
            raise NacreError(
                f"the effective index {n[at].real:.3g} + {n[at].imag:.2g}i at {wavelengths_nm[at]:g} nm absorbs too "
                f"much for a photonic glass; its imaginary part should be at most {MOST_ABSORBING:g}"
            )
        return n

    @property
    def walk_index(self) -> float:
        """The index by which the walk refracts all wavelengths."""
        return max(float(np.abs(self.effective_index(np.array([INDEX_NM])))[0]), 1.0)

    def medium(self, wavelengths_nm: Array) -> Medium:
        """Solve the optics of one layer of it."""
        return solve_medium(self.spheres(wavelengths_nm))

    def spheres(self, wavelengths_nm: Array) -> Spheres:
        """Return the spheres at given wavelengths."""
        layers = np.stack([m.n_complex(wavelengths_nm) for m in self.materials])
        return Spheres(
            wavelengths_nm, np.array(self.radii_nm), layers, self.effective_index(wavelengths_nm),
            self.volume_fraction, self.deviation_nm, self.structure,
        )  # fmt: skip


class Filling(Protocol):
    """What fills a stratum: a composite, or balls of one."""

    @property
    def range_nm(self) -> tuple[float, float]:
        """Where all its materials are known."""

    def effective_index(self, wavelengths_nm: Array) -> ComplexArray:
        """n + ik of what light is refracted into, `[wavelength]`."""


@dataclass(frozen=True)
class EffectiveDispersion:
    """The real part of a composite's index as an optical constant: what a base lies in."""

    composite: Filling

    @property
    def range_nm(self) -> tuple[float, float]:
        """Where all its materials are known."""
        return self.composite.range_nm

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return n + 0i."""
        flat = np.ravel(wavelengths_nm)
        found = np.abs(self.composite.effective_index(flat)) + 0j
        return np.asarray(found.reshape(np.shape(wavelengths_nm)))


# Effective index of a dense packing of spheres in a matrix.

MIXING_RULES = ("bruggeman", "maxwell-garnett")
SLACK = 1e-9  # of a root against its bounds: rounding
NEWTON_STEPS = 3


def bruggeman(indices: ComplexArray, fractions: Array) -> ComplexArray:
    """Return the index n of sum_i f_i (e_i - e)/(e_i + 2 e) = 0, with e = n^2 (Bruggeman 1935).

    All phases count alike. Of the roots that one is taken whose real part lies between those of the phases and that
    does not amplify.

    Args:
        indices: `[phase, wavelength]`, n + ik.
        fractions: `[phase]`, shares of the volume; they sum to one.

    Returns:
        `[wavelength]`.

    Raises:
        NacreError: no root lies between the phases, as with metals.

    Example: half the volume of index 1.59 in air gives 1.28402.
    """
    present = fractions > 0
    eps, share = indices[present] ** 2, fractions[present]
    low, high = indices[present].real.min(axis=0), indices[present].real.max(axis=0)
    found = np.empty(indices.shape[1], dtype=complex)
    for i in range(indices.shape[1]):
        roots = np.sqrt(np.roots(_polynomial(eps[:, i], share)).astype(complex))
        roots = np.where(roots.real < 0, -roots, roots)
        fits = (roots.real >= low[i] - SLACK) & (roots.real <= high[i] + SLACK) & (roots.imag >= -SLACK)
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
    """Coefficients in e, highest first, of the sum with its denominators multiplied away."""
    total = np.zeros(len(eps) + 1, dtype=complex)
    for i, f in enumerate(share):
        part = f * np.array([-1.0, eps[i]], dtype=complex)
        for j in range(len(eps)):
            if j != i:
                part = np.polymul(part, np.array([2.0, eps[j]], dtype=complex))
        total += part
    return total


def _polished(e: complex, eps: ComplexArray, share: Array) -> complex:
    """Newton's steps on the sum itself: roots of a polynomial have lost some digits."""
    for _ in range(NEWTON_STEPS):
        value = np.sum(share * (eps - e) / (eps + 2 * e))
        slope = np.sum(-3 * share * eps / (eps + 2 * e) ** 2)
        e = e - value / slope
    return complex(e)


def maxwell_garnett(inclusion: ComplexArray, matrix: ComplexArray, fraction: float) -> ComplexArray:
    """Return the index of inclusions in a matrix, in which the matrix counts as the host (Maxwell Garnett 1904).

    Args:
        inclusion, matrix: `[wavelength]`, n + ik.
        fraction: share of the volume that the inclusions fill.

    Example: half the volume of index 1.59 in air gives 1.26845.
    """
    p, m = inclusion**2, matrix**2
    e = m * (p + 2 * m + 2 * fraction * (p - m)) / (p + 2 * m - fraction * (p - m))
    return np.asarray(np.sqrt(e))
