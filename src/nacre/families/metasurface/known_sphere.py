"""Spheres whose T-matrices a file gives: they take the multipole order that spheres take, not all that the file holds.

A T-matrix is a sphere's where it is diagonal and the same for every azimuthal order, of a core in a shell too. Where
the file says of what radius and index it is, and Mie's coefficients are the file's, those beyond it are known as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nacre.arrays import ComplexArray
from nacre.families.metasurface.axial import AxialTMatrices, KnownBody, as_blocks
from nacre.families.metasurface.substrate import Substrate
from nacre.matter.mie import mie_coefficients

SAME_T = 1e-9  # relative to the norm: what rounding leaves, and far less than what any mesh does
SAME_SIZE = 1e-9
SPHERE = "sphere"


def is_spherical(known: AxialTMatrices) -> bool:
    """Return whether the T-matrices are those of spheres at all wavelengths."""
    return all(
        np.linalg.norm(as_blocks(np.diagonal(blocks[1])) - blocks) <= SAME_T * np.linalg.norm(blocks)
        for blocks in known.blocks
    )


@dataclass(frozen=True)
class KnownSphere(KnownBody):
    """A sphere whose T-matrices a file gives. See `Body`."""

    def coefficients(self, lmax: int, surface: Substrate) -> ComplexArray:
        """Return the diagonal T, `[n]`: what the file holds, and beyond it Mie's of the sphere it names, or zeros.

        Raises:
            MaterialRangeError: the file says nothing of the wavelength.
        """
        held = np.diagonal(self.t_matrix(surface.wavelength_nm)[1])
        out = np.zeros(2 * lmax, dtype=complex)
        if self.goes_on and lmax > self.lmax:
            told, known = self.known.material_index, self.known.wavelengths_nm
            assert told is not None  # see `goes_on`
            index = complex(np.interp(surface.wavelength_nm, known, told))
            out = self._mie(lmax, surface.inner_wavenumber, index / surface.inner_index)
        count = min(lmax, self.lmax)
        for tau in range(2):
            out[tau * lmax : tau * lmax + count] = held[tau * self.lmax : tau * self.lmax + count]
        return out

    @cached_property
    def goes_on(self) -> bool:
        """Whether multipoles beyond the file's are known: its own are those of the sphere that it names."""
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
