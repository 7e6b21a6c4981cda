"""Azimuth and polarisation of the light on films that mix polarisations: anisotropic and twisted ones."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.families import contract
from nacre.material.material import Material
from nacre.studio.folder import read_choice, read_number

POLARISATIONS = ("both", "s", "p", "left", "right")
MAX_AZIMUTH_DEG = 360.0


@dataclass(frozen=True)
class Incidence:
    """The light on the material.

    Attributes:
        azimuth_deg: azimuth of the direction towards the light, from u; of all colours and spectra.
        polarisation: of the spectra in the chart; colours are those of unpolarised light.
    """

    azimuth_deg: float = 0.0
    polarisation: str = "both"


UNPOLARISED = Incidence()


def read_incidence(body: Mapping[str, Any]) -> Incidence:
    """Return the light that a request selects by `azimuth_deg` and `polarisation`.

    Raises:
        NacreError: a value is not allowed.
    """
    azimuth = read_number(body.get("azimuth_deg", 0.0), "azimuth_deg", -MAX_AZIMUTH_DEG, MAX_AZIMUTH_DEG)
    return Incidence(azimuth, read_choice(body, "polarisation", "both", POLARISATIONS) or "both")


def mixes_polarisations(material: Material) -> bool:
    """Whether azimuth and polarisation of the light can be selected for a material."""
    return isinstance(material.model, contract.Polarised) and material.model.mixes_polarisations


def spectrum_from(
    material: Material, theta_rad: Array, wavelengths_nm: Array | None, incidence: Incidence
) -> Spectrum | None:
    """Return the model's spectra, or None if its Bsdf has to be integrated.

    Args:
        theta_rad: `[angle]`.
        wavelengths_nm: `[wavelength]`; default: those of the model.
        incidence: applies to materials that mix polarisations; others are seen by unpolarised light from u.
    """
    model = material.model
    if incidence == UNPOLARISED or not (isinstance(model, contract.Polarised) and model.mixes_polarisations):
        return model.spectrum(theta_rad, wavelengths_nm, "both", 0)
    azimuth = math.radians(incidence.azimuth_deg)
    return model.polarised_spectrum(theta_rad, wavelengths_nm, incidence.polarisation, azimuth)
