"""Strata with scattering flakes between interfaces: the arrays of a position-free random walk.

The flake optics is precomputed; the transport is not: the lobe's Mitsuba plugin runs a random walk through the strata
to sample or evaluate the lobe, and `nacre.evaluate` calls the plugin.

The delta part is the light that passes only smooth interfaces. Powers add, since a stratum is too thick for
interference. A rough interface or a scattering base ends the chain, and scattered light does not contribute.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.facet_distributions import fresnel
from nacre.bsdf.glints import check_glints
from nacre.bsdf.lobe import Lobe, SpecularResponse
from nacre.core.arrays import Array, interpolate
from nacre.core.errors import UnsupportedError

MATCHED = 1e-4  # smaller index differences between resins do not form an interface

BY_WALK = "a layered lobe is a random walk that Mitsuba runs: ask nacre.evaluate(material, wi, wo) for its values"
BASES = ("none", "diffuse", "specular", "lobes")


@dataclass(frozen=True)
class Layered(Lobe):
    """Any number of strata, each a resin with flakes and dye, over a base or open below.

    Depths are in units of the stratum, so every extinction is an optical thickness along the normal.
    Interface i is above stratum i; interface `strata` is the bottom (towards the ambient again, or the base's
    own surface). Power is transported; refraction factors at entry and exit cancel between equal ambients.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        index: `[stratum]`, real refractive index over the ambient's, one for all wavelengths.
        alpha: `[interface, 2]`, roughness along x and y; 0 is smooth.
        is_beckmann: `[interface]`, Beckmann normals rather than GGX.
        loss: `[interface, side, cos]` light fraction lost by single scattering at a rough interface, over uniform
            nodes in sqrt(cos), side 0 above; zeros without compensation; unset if all interfaces lack compensation.
        flake_stratum: `[kind]`, the stratum of each flake species, ascending.
        flake_number: `[kind]`, flakes crossed along their mean normal in the stratum.
        flake_axes: `[kind, 3]`, semi-axes of the SGGX ellipsoid; the third is 1.
        flake_frame: `[kind, 3, 3]`, columns are the ellipsoid's axes in the surface frame.
        flake_response: `[kind, cos, wavelength, 2]`, a flake's R and T over uniform nodes in sqrt|cos|.
        flake_extinction: `[kind, azimuth, elevation, wavelength]`, mean of 1 - T over the normals visible from a
            direction in the flake frame; azimuth uniform over a quarter turn, elevation uniform in
            sqrt|z|; one azimuth if isotropic.
        dye: `[stratum, wavelength, 2]`, dye extinction and scattering across the stratum; optional.
        dye_phase: `[stratum, cos, wavelength]`, phase function, 1/sr, uniform nodes in cos over [-1, 1]; only for
            scattering dyes.
        dye_quantile: `[stratum, u, wavelength]`, cos by cumulative probability u, uniform nodes; with `dye_phase`.
        glint_numbers, glint_radii, glint_ratio: for the uppermost stratum's species, `[kind, number]`,
            `[kind, quantile]`, `[kind, node]`, see `nacre.bsdf.glints`; unset without glints.
        base: "none" (open), "diffuse", "specular" or "lobes".
        base_reflectance: `[cos, wavelength]`, albedo (one row) or reflectance over the cosine in the last
            resin, uniform nodes in [0, 1]; ignored without base.
        base_lobes: for the base "lobes": another opaque material, on its own wavelengths, with directions inside the
            last resin.
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
        """Number of flake species in all strata."""
        return len(self.flake_number)

    @property
    def transmits(self) -> bool:
        """Whether light is transmitted to the other side."""
        return self.base == "none"

    @property
    def is_stochastic(self) -> bool:
        """Whether values come from the random walk."""
        return True

    @property
    def varying(self) -> tuple[str, ...]:
        """Names of the base's varying numbers."""
        return tuple(dict.fromkeys(f"base.{name}" for lobe in self.base_lobes for name in lobe.varying))

    def check(self) -> None:
        """Check that the arrays are consistent.

        Raises:
            ValueError: names the inconsistent array.
        """
        super().check()
        s, k, count = self.strata, self.kinds, len(self.wavelengths_nm)
        if self.base not in BASES:
            raise ValueError(f'base "{self.base}" is not one of {", ".join(BASES)}')
        if (self.base == "lobes") != bool(self.base_lobes):
            raise ValueError('base_lobes belong to the base "lobes", and only to it')
        for inner in self.base_lobes:
            inner.check()
            if inner.transmits or inner.is_stochastic or inner.kind in ("layered", "platelet-layer"):
                raise ValueError(f'a lobe of kind "{inner.kind}" that transmits or is a pearl cannot be a base')
        if s < 1 or self.index.shape != (s,) or not np.all(self.index >= 1):
            raise ValueError("index needs one number >= 1 for each stratum")
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
            raise ValueError("flake_stratum is not a stratum's index")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Refuse: values come from a Mitsuba random walk.

        Raises:
            UnsupportedError: always; use `nacre.evaluate`.
        """
        raise UnsupportedError(BY_WALK)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Refuse: integrals come from a Mitsuba random walk.

        Raises:
            UnsupportedError: always; use `Material.spectrum`.
        """
        raise UnsupportedError(BY_WALK)

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return the light that passes only smooth interfaces, in the plane y = 0."""
        cos_i = np.asarray(cos_i, dtype=float)
        places = None if uv is None else np.broadcast_to(uv, (*cos_i.shape, 2)).reshape(-1, 2)
        shape = (*cos_i.shape, len(self.wavelengths_nm))
        reflected, transmitted = _mirror_powers(self, cos_i.reshape(-1), places)
        return SpecularResponse(reflected.reshape(shape), transmitted.reshape(shape))


def _mirror_powers(lobe: Layered, cos_i: Array, uv: Array | None) -> tuple[Array, Array]:
    """Return specular reflectance and transmittance, `[n, wavelength]`, for light in the plane y = 0.

    Args:
        lobe: the strata.
        cos_i: `[n]`, below 0 for light from behind (with a base the result is then 0).
        uv: optional `[n, 2]`, for a varying base.
    """
    count, bands = lobe.strata, len(lobe.wavelengths_nm)
    cos = np.clip(np.abs(cos_i), 1e-9, 1.0)
    n = np.concatenate([[1.0], lobe.index, [1.0]])
    inside = np.sqrt(np.maximum(0.0, 1.0 - (1.0 - cos[:, None] ** 2) / n**2))  # [n, medium]
    below = cos_i < 0
    total_r, total_t = np.zeros((2, len(cos), bands))
    for from_below in (False, True):
        lanes = below == from_below
        if not lanes.any() or (from_below and not lobe.transmits):
            continue
        order = list(range(count))[:: -1 if from_below else 1]
        # from the far end: reflectance and transmittance of everything beyond
        far = count + 1 if not from_below else 0
        beyond_r, beyond_t = _last(lobe, inside[lanes], n, order[-1], far, None if uv is None else uv[lanes])
        for s in reversed(order):
            medium, near = s + 1, (s + 2 if from_below else s)
            fall = np.exp(-_depth(lobe, s, inside[lanes, medium], from_below))
            rise = np.exp(-_depth(lobe, s, inside[lanes, medium], not from_below))
            r, t = _interface(lobe, inside[lanes], n, near, medium)
            r, t = r[:, None], t[:, None]
            echo = 1.0 / (1.0 - r * fall * rise * beyond_r)
            # a bare interface has equal power transmittance in both directions
            beyond_r, beyond_t = r + t * t * fall * rise * beyond_r * echo, t * fall * beyond_t * echo
        total_r[lanes], total_t[lanes] = beyond_r, beyond_t
    return total_r, total_t


def _last(lobe: Layered, inside: Array, n: Array, stratum: int, far: int, uv: Array | None) -> tuple[Array, Array]:
    """Return reflectance and transmittance at the far end of the last stratum, `[n, wavelength]`."""
    lanes, bands = len(inside), len(lobe.wavelengths_nm)
    cos = inside[:, stratum + 1]
    if lobe.transmits:
        r, t = _interface(lobe, inside, n, stratum + 1, far)
        return np.repeat(r[:, None], bands, axis=1), np.repeat(t[:, None], bands, axis=1)
    reflect = np.zeros((lanes, bands))
    if lobe.base == "specular" and np.all(lobe.alpha[-1] == 0):
        table = lobe.base_reflectance
        nodes = np.linspace(0.0, 1.0, len(table))
        reflect = np.stack([np.interp(cos, nodes, table[:, k]) for k in range(bands)], axis=1)
    for inner in lobe.base_lobes:
        specular = inner.specular(cos, uv).reflectance
        reflect += np.stack([np.interp(lobe.wavelengths_nm, inner.wavelengths_nm, row) for row in specular])
    return reflect, np.zeros((lanes, bands))


def _interface(lobe: Layered, inside: Array, n: Array, first: int, second: int) -> tuple[Array, Array]:
    """Return specular reflectance and transmittance, `[n]`, between neighbouring media; 0 for a rough interface."""
    contrast = abs(n[first] - n[second]) > MATCHED
    if contrast and np.any(lobe.alpha[min(first, second)] > 0):
        return np.zeros(len(inside)), np.zeros(len(inside))
    r = fresnel(inside[:, first], n[second] / n[first]) if contrast else np.zeros(len(inside))
    return r, 1.0 - r


def _depth(lobe: Layered, stratum: int, cos: Array, upward: bool) -> Array:
    """Return a stratum's optical thickness along its ray, `[n, wavelength]`."""
    bands = len(lobe.wavelengths_nm)
    depth = np.zeros((len(cos), bands))
    ray = np.stack([np.sqrt(1.0 - cos**2), np.zeros(len(cos)), cos if upward else -cos], axis=-1)
    for k in np.flatnonzero(lobe.flake_stratum == stratum):
        local = ray @ lobe.flake_frame[k]
        area = lobe.flake_number[k] * np.linalg.norm(local * lobe.flake_axes[k], axis=-1)
        azimuths, elevations, _ = lobe.flake_extinction[k].shape
        turn = np.arctan2(np.abs(local[:, 1]), np.maximum(np.abs(local[:, 0]), 1e-12)) * (2 / np.pi * (azimuths - 1))
        place = np.sqrt(np.clip(np.abs(local[:, 2]), 0.0, 1.0)) * (elevations - 1)
        depth += area[:, None] * interpolate(lobe.flake_extinction[k], (turn, place))
    if lobe.dye is not None:
        depth += lobe.dye[stratum, :, 0]
    return depth / np.maximum(cos, 1e-9)[:, None]
