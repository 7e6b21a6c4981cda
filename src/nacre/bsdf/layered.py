"""Strata of scattering flakes between interfaces: what the position-free walk needs, as arrays.

No physics is left to do here, but the transport itself is: `nacre.render` walks through the strata when it
samples or evaluates the lobe, and `nacre.evaluate` calls it there.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.contract import Lobe, SpecularResponse, register_lobe
from nacre.bsdf.glints import check_glints
from nacre.errors import UnsupportedError

Array = NDArray[np.float64]

# The walk runs where Mitsuba is. It is looked up by name when called: nothing below the renderer imports it.
WALKS = "nacre.render.plugins.layered"
DEFAULT_SAMPLES = 4096

BASES = ("none", "diffuse", "specular", "lobes")


@register_lobe
@dataclass(frozen=True)
class Layered(Lobe):
    """Any number of strata, each a resin with flakes and dye, over a base or open below.

    Depths are counted in units of the stratum, so every extinction is an optical thickness along the normal.
    Interface i lies above stratum i; interface `strata` is the bottom (towards the ambient again, or the base's
    own surface). Power is transported; refraction factors of entry and exit cancel between equal ambients.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        index: `[stratum]`, real refractive index over the ambient's, one for all wavelengths.
        alpha: `[interface, 2]`, roughness along x and y; 0 is smooth.
        is_beckmann: `[interface]`, Beckmann normals instead of GGX.
        loss: `[interface, side, cos]` share of the light lost by single scattering at a rough interface, over
            uniform nodes of sqrt(cos), side 0 above; zeros where it is not given back. None: nowhere.
        flake_stratum: `[kind]`, the stratum each kind of flake lies in, ascending.
        flake_number: `[kind]`, flakes met along their mean normal while crossing the stratum.
        flake_axes: `[kind, 3]`, semi-axes of the SGGX ellipsoid; the third is 1.
        flake_frame: `[kind, 3, 3]`, columns are the ellipsoid's axes in the surface frame.
        flake_response: `[kind, cos, wavelength, 2]`, R and T of a flake over uniform nodes of sqrt|cos|.
        flake_extinction: `[kind, azimuth, elevation, wavelength]`, mean of 1 - T over the normals that a
            direction of the flake frame sees; azimuth uniform over a quarter turn, elevation uniform in
            sqrt|z|; one azimuth where isotropic.
        dye: `[stratum, wavelength, 2]`, extinction and scattering of a dye across the stratum; None: no dye.
        dye_phase: `[stratum, cos, wavelength]`, phase function, 1/sr, uniform nodes of cos in [-1, 1]; None if no
            dye scatters.
        dye_quantile: `[stratum, u, wavelength]`, cos by cumulative share u, uniform nodes in [0, 1]; with `dye_phase`.
        glint_numbers, glint_radii, glint_ratio: of the uppermost stratum's kinds, `[kind, number]`, `[kind, quantile]`,
            `[kind, node]`, see `nacre.bsdf.glints`; None: flakes too small to be seen.
        base: "none" (open), "diffuse", "specular" or "lobes".
        base_reflectance: `[cos, wavelength]`, albedo (one row) or reflectance by the cosine in the last
            resin, uniform nodes in [0, 1]; ignored without base.
        base_lobes: of a base of "lobes": another opaque material, on wavelengths of its own, whose directions are
            those inside the last resin.
    """

    kind: ClassVar[str] = "layered"
    wavelengths_nm: Array
    index: Array
    alpha: Array
    is_beckmann: NDArray[np.int64]
    flake_stratum: NDArray[np.int64]
    flake_number: Array
    flake_axes: Array
    flake_frame: Array
    flake_response: Array
    flake_extinction: Array
    base: str
    base_reflectance: Array
    loss: Array | None = None
    dye: Array | None = None
    dye_phase: Array | None = None
    dye_quantile: Array | None = None
    glint_numbers: Array | None = None
    glint_radii: Array | None = None
    glint_ratio: Array | None = None
    base_lobes: tuple[Lobe, ...] = ()

    AXES: ClassVar[dict[str, str]] = {
        "index": "stratum",
        "alpha": "interface 2",
        "is_beckmann": "interface",
        "loss": "interface side cos",
        "flake_stratum": "kind",
        "flake_number": "kind",
        "flake_axes": "kind axis",
        "flake_frame": "kind component axis",
        "flake_response": "kind cos wavelength channel",
        "flake_extinction": "kind azimuth elevation wavelength",
        "dye": "stratum wavelength channel",
        "dye_phase": "stratum cos wavelength",
        "dye_quantile": "stratum u wavelength",
        "glint_numbers": "kind number",
        "glint_radii": "kind quantile",
        "glint_ratio": "kind node",
        "base_reflectance": "cos wavelength",
    }

    @property
    def strata(self) -> int:
        """Number of strata."""
        return len(self.index)

    @property
    def kinds(self) -> int:
        """Number of flake kinds in all strata."""
        return len(self.flake_number)

    @property
    def transmits(self) -> bool:
        """Whether light passes to the other side."""
        return self.base == "none"

    @property
    def is_stochastic(self) -> bool:
        """Whether values come from the random walk."""
        return True

    @property
    def varying(self) -> tuple[str, ...]:
        """What varies over the base."""
        return tuple(dict.fromkeys(f"base.{name}" for lobe in self.base_lobes for name in lobe.varying))

    def check(self) -> None:
        """Check that the arrays fit together.

        Raises:
            ValueError: saying which does not.
        """
        super().check()
        s, k, count = self.strata, self.kinds, len(self.wavelengths_nm)
        if self.base not in BASES:
            raise ValueError(f'base "{self.base}" is not one of {", ".join(BASES)}')
        if (self.base == "lobes") != bool(self.base_lobes):
            raise ValueError('base_lobes belong to the base "lobes", and only to it')
        for inner in self.base_lobes:
            inner.check()
            if inner.transmits or inner.is_stochastic or inner.kind in ("layered", "flaked"):
                raise ValueError(f'a lobe of kind "{inner.kind}" that is open or a pearl cannot be a base')
        if s < 1 or self.index.shape != (s,) or not np.all(self.index >= 1):
            raise ValueError("index needs one number of at least 1 a stratum")
        shapes = {
            "alpha": (self.alpha, (s + 1, 2)),
            "is_beckmann": (self.is_beckmann, (s + 1,)),
            "flake_stratum": (self.flake_stratum, (k,)),
            "flake_axes": (self.flake_axes, (k, 3)),
            "flake_frame": (self.flake_frame, (k, 3, 3)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise ValueError(f"{name} has the shape {array.shape}, not {shape}")
        if self.flake_response.ndim != 4 or self.flake_response.shape[::2] != (k, count):
            raise ValueError(f"flake_response has the shape {self.flake_response.shape}")
        if self.flake_extinction.ndim != 4 or self.flake_extinction.shape[::3] != (k, count):
            raise ValueError(f"flake_extinction has the shape {self.flake_extinction.shape}")
        if self.base_reflectance.ndim != 2 or self.base_reflectance.shape[1] != count:
            raise ValueError(f"base_reflectance has the shape {self.base_reflectance.shape}")
        if self.dye is not None and self.dye.shape != (s, count, 2):
            raise ValueError(f"dye has the shape {self.dye.shape}")
        if self.loss is not None and (self.loss.ndim != 3 or self.loss.shape[:2] != (s + 1, 2)):
            raise ValueError(f"loss has the shape {self.loss.shape}")
        if self.glint_numbers is not None:
            upper = int(np.count_nonzero(self.flake_stratum == 0))
            check_glints(self.glint_numbers, self.glint_radii, self.glint_ratio, upper)
        if k and (np.any(self.flake_stratum < 0) or np.any(self.flake_stratum >= s)):
            raise ValueError("flake_stratum names a stratum that is not there")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value from the walk, with its noise; `nacre.api.evaluate_with_error` tells how large that is.

        Raises:
            UnsupportedError: no LLVM for the walk.
        """
        values: Array = _walk("evaluate_layered")(self, wi, wo, samples=DEFAULT_SAMPLES, seed=0, uv=uv)[0]
        return values

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64, seed: int = 0) -> tuple[Array, Array]:
        """Return the power that leaves on either side, mirror reflection left out, from `nodes`^2 walks a wavelength.

        Another `seed` gives independent noise.

        Raises:
            UnsupportedError: no LLVM for the walk.
        """
        result: tuple[Array, Array] = _walk("hemispherical_layered")(self, wi, samples=nodes * nodes, seed=seed, uv=uv)
        return result

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return what meets nothing but smooth interfaces, on its way in and out; light lies in the plane y = 0."""
        from nacre.bsdf.layered_mirror import mirror_powers

        cos_i = np.asarray(cos_i, dtype=float)
        places = None if uv is None else np.broadcast_to(uv, (*cos_i.shape, 2)).reshape(-1, 2)
        shape = (*cos_i.shape, len(self.wavelengths_nm))
        reflected, transmitted = mirror_powers(self, cos_i.reshape(-1), places)
        return SpecularResponse(reflected.reshape(shape), transmitted.reshape(shape))


def _walk(name: str) -> Callable[..., Any]:
    try:
        found: Callable[..., Any] = getattr(importlib.import_module(WALKS), name)
        return found
    except ImportError as error:
        raise UnsupportedError(f"a pearl is evaluated by a random walk that needs mitsuba ({error})") from None


def fresnel(cos_i: Array, eta: float) -> Array:
    """Unpolarised reflectance of a bare interface of relative index `eta`, met at `cos_i` in (0, 1]."""
    cos_i = np.asarray(cos_i, dtype=float)
    cos_t = np.sqrt(np.maximum(0.0, 1 - (1 - cos_i**2) / eta**2))
    with np.errstate(divide="ignore", invalid="ignore"):
        r_s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
        r_p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    value = np.where(1 - cos_i**2 >= eta**2, 1.0, (r_s**2 + r_p**2) / 2)
    return np.asarray(np.nan_to_num(value, nan=1.0))
