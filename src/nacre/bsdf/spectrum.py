"""What a spectrophotometer would report of a material: the arrays behind `nacre spectrum`."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power ratios `[angle, wavelength]` at angles in the ambient medium; None where a part does not apply.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        angles_deg: `[angle]`, incidence in the ambient medium.
        specular_reflectance, specular_transmittance: the delta part (a rough film: the values of its stack).
        diffuse_reflectance, diffuse_transmittance: directional-hemispherical, everything else.
    """

    wavelengths_nm: NDArray[np.float64]
    angles_deg: NDArray[np.float64]
    specular_reflectance: NDArray[np.float64] | None = None
    specular_transmittance: NDArray[np.float64] | None = None
    diffuse_reflectance: NDArray[np.float64] | None = None
    diffuse_transmittance: NDArray[np.float64] | None = None

    def parts(self) -> dict[str, NDArray[np.float64]]:
        """Return the parts that apply, by name, in the order of the fields."""
        names = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def __eq__(self, other: object) -> bool:
        """Whether all arrays are alike, number by number."""
        if not isinstance(other, Spectrum):
            return NotImplemented
        pairs = [(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)]
        return all(b is None if a is None else b is not None and np.array_equal(a, b) for a, b in pairs)

    __hash__ = None  # type: ignore[assignment]  # arrays can be written to
