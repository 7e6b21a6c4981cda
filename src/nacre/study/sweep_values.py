"""What a sweep stores of each point: a fixed set of named arrays, the same shape for every point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.spectrum import Spectrum
from nacre.light import spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.materials.material import Material
from nacre.measure.colour_wavelengths import colour_spectrum

PARTS = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")


@dataclass(frozen=True)
class Measurement:
    """What to measure of each material.

    Attributes:
        angles_deg: incidence in the ambient medium.
        illuminant, observer: for the colours.
        wavelengths_nm: the grid on which spectra are stored, or None to store colours only.
        parts: which of the spectrum's parts are measured.
    """

    angles_deg: tuple[float, ...] = (0.0, 15.0, 30.0, 45.0, 60.0)
    illuminant: str = "D65"
    observer: str = "10deg"
    wavelengths_nm: tuple[float, ...] | None = None
    parts: tuple[str, ...] = ("specular_reflectance",)

    def layout(self) -> dict[str, tuple[tuple[str, ...], tuple[int, ...]]]:
        """Return the arrays a point gives: name -> (dimension names, shape)."""
        angles = len(self.angles_deg)
        arrays: dict[str, tuple[tuple[str, ...], tuple[int, ...]]] = {}
        for part in self.parts:
            arrays[f"lab_{part}"] = (("angle_deg", "lab"), (angles, 3))
            arrays[f"xyz_{part}"] = (("angle_deg", "xyz"), (angles, 3))
            if self.wavelengths_nm is not None:
                arrays[part] = (("angle_deg", "wavelength_nm"), (angles, len(self.wavelengths_nm)))
        return arrays

    def take(self, material: Material, seed: int) -> dict[str, Array]:
        """Measure one material; `seed` serves families whose spectrum is a random walk.

        Raises:
            NacreError: the material cannot be computed.
        """
        theta = np.radians(self.angles_deg)
        # on the material's own grid, and a narrow-band lamp's lines: fine enough, and wide enough for a colour
        colours, stored = colour_spectrum(material, theta, self.illuminant, seed), None
        if self.wavelengths_nm is not None:
            stored = material.spectrum(theta, np.asarray(self.wavelengths_nm), seed=seed)
        white = white_xyz(self.illuminant, self.observer)
        arrays: dict[str, Array] = {}
        for part in self.parts:
            xyz = spectrum_to_xyz(_part(colours, part), colours.wavelengths_nm, self.illuminant, self.observer)
            arrays[f"xyz_{part}"] = xyz
            arrays[f"lab_{part}"] = xyz_to_lab(xyz, white)
            if stored is not None:
                arrays[part] = _part(stored, part)
        return arrays


def _part(spectrum: Spectrum, name: str) -> Array:
    """Return a part of a spectrum, zeros where the material has none of it."""
    values = spectrum.parts().get(name)
    return np.zeros((len(spectrum.angles_deg), len(spectrum.wavelengths_nm))) if values is None else values


def measurement_from(data: dict[str, Any]) -> Measurement:
    """Rebuild a measurement from its dictionary (as it travels to a worker)."""
    fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data.items()}
    return Measurement(**fields)
