"""A diffuse base, bare or seen through a film."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.contract import Lobe
from nacre.bsdf.response import check_parameters, check_wavelengths, parameter_coordinates
from nacre.bsdf.texture import ParameterAxis
from nacre.bsdf.uniform import interpolate


@dataclass(frozen=True)
class Diffuse(Lobe):
    """Lambertian reflection, weighted by the transmittance of the film above, in and out; lit from +z only.

    f = scale(p, lambda) entry(p, cos_i, lambda) entry(p, cos_o, lambda) / pi, zero unless both directions have
    z > 0. A bare base has entry = 1 and scale = albedo. Under a film with relative index eta, entry is the
    transmittance by the cosine in the ambient, and scale = albedo / (eta^2 (1 - albedo R_inside)) sums the
    round trips between base and film (R_inside: hemispherical reflectance of the film from below).

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        scale: `[*params, wavelength]`.
        entry: `[*params, cos, wavelength]` over uniform nodes of the ambient's cosine from 0 to 1, linear;
            one node (constant 1) for a bare base.
        parameters: the axes that textures drive.
    """

    kind: ClassVar[str] = "diffuse"
    wavelengths_nm: Array
    scale: Array
    entry: Array
    parameters: tuple[ParameterAxis, ...] = ()

    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "scale": "*params wavelength",
        "entry": "*params cos wavelength",
    }

    def check(self) -> None:
        """Check that the tables fit together.

        Raises:
            ValueError: saying which does not.
        """
        check_wavelengths(self.wavelengths_nm)
        leading, count = check_parameters(self.parameters), len(self.wavelengths_nm)
        if self.scale.shape != (*leading, count):
            raise ValueError(f"scale has the shape {self.scale.shape}, not {(*leading, count)}")
        if self.entry.shape[:-2] != leading or self.entry.shape[-1] != count or self.entry.shape[-2] < 1:
            raise ValueError(f"entry has the shape {self.entry.shape}")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value `[..., wavelength]` in 1/sr."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        cos_i, cos_o = wi[..., 2], wo[..., 2]
        coords = parameter_coordinates(self.parameters, uv, cos_i.shape)
        nodes = self.entry.shape[-2] - 1
        way_in = interpolate(self.entry, (*coords, np.maximum(cos_i, 0) * nodes))
        way_out = interpolate(self.entry, (*coords, np.maximum(cos_o, 0) * nodes))
        scale = interpolate(self.scale, coords) if coords else self.scale
        seen = ((cos_i > 0) & (cos_o > 0))[..., None]
        return np.where(seen, scale * way_in * way_out / np.pi, 0.0)


def bare_base(wavelengths_nm: Array, albedo: Array) -> Diffuse:
    """Return a Lambertian base of the given albedo spectrum, with nothing above it."""
    wavelengths_nm = np.asarray(wavelengths_nm, dtype=float)
    scale = np.broadcast_to(np.asarray(albedo, dtype=float), wavelengths_nm.shape).copy()
    return Diffuse(wavelengths_nm, scale, np.ones((1, len(wavelengths_nm))))
