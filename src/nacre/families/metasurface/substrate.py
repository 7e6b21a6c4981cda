"""The planar stack under the particles, at one wavelength, as the particles see it.

All stratified-media work is done by `nacre.matter.stack.case`; this module only asks it at the angles that
multipole fields need, w = kz/k in the ambient medium, which may be complex.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array, ComplexArray
from nacre.matter.stack import solve as solver

LOSSLESS_K = 1e-4  # a substrate with k below this is transparent, as for films


@dataclass(frozen=True)
class Substrate:
    """A stack at one wavelength.

    Attributes:
        wavelength_nm: in vacuum.
        indices: `[medium]`, complex, from the ambient (lossless) through the layers to the substrate.
        thicknesses_nm: `[layer]`.
    """

    wavelength_nm: float
    indices: ComplexArray
    thicknesses_nm: Array

    @property
    def ambient_index(self) -> float:
        """Index of the medium around the particles."""
        return float(self.indices[0].real)

    @property
    def wavenumber(self) -> float:
        """k of the ambient medium, 1/nm."""
        return 2 * np.pi * self.ambient_index / self.wavelength_nm

    @cached_property
    def operators(self) -> dict[float, ComplexArray]:
        """The last reflection operator W_m `[m, n, n']` of each height of a centre, kept by who computes them."""
        return {}

    @property
    def is_transparent(self) -> bool:
        """Whether light propagates in the substrate without loss."""
        return abs(self.indices[-1].imag) < LOSSLESS_K

    @property
    def index_below(self) -> float:
        """Index of the substrate over the ambient's, its real part."""
        return float(self.indices[-1].real) / self.ambient_index

    @property
    def is_absent(self) -> bool:
        """Whether there is nothing below: every medium is the ambient."""
        return bool(np.all(np.abs(self.indices - self.indices[0]) < 1e-12))

    def reflection(self, w: NDArray) -> ComplexArray:
        """Return r_s, r_p, `[pol, angle]`, for light from the ambient at w = kz/k; phase at the stack's top."""
        found = solver.amplitudes(
            self.indices[:, None],
            self.thicknesses_nm,
            [self.wavelength_nm],
            kz=self.ambient_index * np.asarray(w),
            jobs=1,
        )
        return np.stack([found.r_s[:, 0], found.r_p[:, 0]])

    def from_below(self, cos_below: NDArray) -> tuple[ComplexArray, ComplexArray]:
        """Return reflection and transmission amplitudes, `[pol, angle]`, for light from a lossless substrate.

        Args:
            cos_below: cosines in the substrate.
        """
        turned = self.indices[::-1].copy()
        turned[0] = turned[0].real
        found = solver.amplitudes(
            turned[:, None],
            self.thicknesses_nm[::-1],
            [self.wavelength_nm],
            kz=turned[0].real * np.asarray(cos_below, dtype=complex),
            jobs=1,
        )
        return np.stack([found.r_s[:, 0], found.r_p[:, 0]]), np.stack([found.t_s[:, 0], found.t_p[:, 0]])
