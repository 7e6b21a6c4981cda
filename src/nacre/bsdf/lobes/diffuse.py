"""A diffuse base, bare or below a film."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.response import check_parameters, check_wavelengths, parameter_coordinates
from nacre.bsdf.texture import ParameterAxis
from nacre.core.arrays import Array, interpolate
from nacre.core.errors import UnsupportedError


@dataclass(frozen=True)
class Diffuse(Lobe):
    """Lambertian reflection, weighted by the film's transmittance on the way in and out; lit from +z only.

    f = scale(p, lambda) entry(p, cos_i, lambda) entry(p, cos_o, lambda) / pi, zero unless both directions have
    z > 0. A bare base has entry = 1 and scale = albedo. Below a film with relative index eta, entry is the
    transmittance over the ambient's cosine, and scale = albedo / (eta^2 (1 - albedo R_inside)) sums the
    round trips between base and film (R_inside: the film's hemispherical reflectance from below).

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        scale: `[*params, wavelength]`.
        entry: `[*params, cos, wavelength]` over uniform nodes in the ambient's cosine from 0 to 1, linear;
            one node (constant 1) for a bare base.
        parameters: the texture-driven axes.
        under_smooth: `[*params, cos, wavelength]`, the base's total reflection through the smooth film, over the
            ambient's cosine. Spectra add it to the smooth film's specular values, since `entry` is averaged over the
            facets of a rough film; unset if the two agree.
    """

    kind: ClassVar[str] = "diffuse"
    wavelengths_nm: Array
    scale: Array
    entry: Array
    parameters: tuple[ParameterAxis, ...] = ()
    under_smooth: Array | None = None

    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "scale": "*params wavelength",
        "entry": "*params cos wavelength",
        "under_smooth": "*params cos wavelength",
    }

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
        """
        check_wavelengths(self.wavelengths_nm)
        leading, count = check_parameters(self.parameters), len(self.wavelengths_nm)
        if self.scale.shape != (*leading, count):
            raise ValueError(f"scale has the shape {self.scale.shape}, not {(*leading, count)}")
        if self.entry.shape[:-2] != leading or self.entry.shape[-1] != count or self.entry.shape[-2] < 1:
            raise ValueError(f"entry has the shape {self.entry.shape}")
        smooth = self.under_smooth
        if smooth is not None and (smooth.shape[:-2] != leading or smooth.shape[-1] != count or smooth.shape[-2] < 1):
            raise ValueError(f"under_smooth has the shape {smooth.shape}")

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

    def smooth_albedo(self, cos_i: Array, uv: Array | None = None) -> Array:
        """Return `under_smooth` at cosines `[...]` in the ambient, `[..., wavelength]`.

        Raises:
            UnsupportedError: without a film or with a smooth one, for which `hemispherical` is equal.
        """
        if self.under_smooth is None:
            raise UnsupportedError("a base without a rough film above it has no albedo under the smooth one")
        cos = np.asarray(cos_i, dtype=float)
        coords = parameter_coordinates(self.parameters, uv, cos.shape)
        return interpolate(self.under_smooth, (*coords, np.maximum(cos, 0) * (self.under_smooth.shape[-2] - 1)))


def bare_base(wavelengths_nm: Array, albedo: Array) -> Diffuse:
    """Return a bare Lambertian base with the given albedo spectrum."""
    wavelengths_nm = np.asarray(wavelengths_nm, dtype=float)
    scale = np.broadcast_to(np.asarray(albedo, dtype=float), wavelengths_nm.shape).copy()
    return Diffuse(wavelengths_nm, scale, np.ones((1, len(wavelengths_nm))))
