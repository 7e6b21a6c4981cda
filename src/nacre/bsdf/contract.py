"""The contract between optics and everything that shows, stores or renders a material.

A `Bsdf` is a sum of lobes. A lobe is a frozen bundle of arrays with named axes and holds no physics left to
do: `evaluate` interpolates, the Mitsuba plugins of `nacre.render` do the same on the device.

Local frame: z is the surface normal, `wi` points to the light, `wo` to the eye, both away from the surface.
Values are unpolarised, in 1/sr, without the cosine; wavelength is the last axis.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.texture import Texture

Array = NDArray[np.float64]
LobeT = TypeVar("LobeT", bound="type[Lobe]")

LOBE_KINDS: dict[str, str] = {
    # kind -> module that defines it, so that a stored Bsdf loads without importing every lobe
    "specular": "nacre.bsdf.specular",
    "microfacet": "nacre.bsdf.microfacet",
    "diffuse": "nacre.bsdf.diffuse",
    "ridge": "nacre.bsdf.ridge",
    "table": "nacre.bsdf.table",
    "harmonic": "nacre.bsdf.harmonic",
    "spectrum-map": "nacre.bsdf.spectrum_map",
    "layered": "nacre.bsdf.layered",
    "flaked": "nacre.bsdf.flaked",
    "masked": "nacre.bsdf.masked",
}
_LOBES: dict[str, type[Lobe]] = {}


def register_lobe(cls: LobeT) -> LobeT:
    """Class decorator: make a lobe known to the file format under its `kind`."""
    _LOBES[cls.kind] = cls
    return cls


def lobe_class(kind: str) -> type[Lobe]:
    """Return the class of a lobe kind, importing its module.

    Raises:
        KeyError: no such kind.
    """
    if kind not in _LOBES:
        import importlib

        importlib.import_module(LOBE_KINDS[kind])
    return _LOBES[kind]


@dataclass(frozen=True)
class ParameterAxis:
    """One material number that varies over the surface: its tabulated values and the texture that drives it.

    Attributes:
        name: what varies, as users know it, such as "layers[0].thickness_nm".
        values: `[node]`, ascending and uniform; tables are interpolated linearly between them.
        texture: gives the number at uv, within [values[0], values[-1]].
    """

    name: str
    values: Array
    texture: Texture

    def coordinate(self, value: Array) -> Array:
        """Return the node coordinate of `value`: 0 at the first node, clamped to the axis."""
        first, last = float(self.values[0]), float(self.values[-1])
        if last <= first:
            return np.zeros_like(np.asarray(value, dtype=float))
        unit = (np.asarray(value, dtype=float) - first) / (last - first)
        return np.clip(unit, 0.0, 1.0) * (len(self.values) - 1)


@dataclass(frozen=True)
class SpecularResponse:
    """The delta part: reflectance and transmittance, each `[..., wavelength]`, power ratios."""

    reflectance: Array
    transmittance: Array


class Lobe(abc.ABC):
    """One term of a Bsdf: a frozen dataclass of arrays, strings and numbers.

    Subclasses are dataclasses decorated with `register_lobe`; every field is an ndarray, a number, a bool, a
    string, None, a `Texture`, a tuple of `ParameterAxis` or a frozen dataclass of such fields, so that one generic
    writer (`nacre.bsdf.file`) stores them all.
    """

    kind: ClassVar[str]
    wavelengths_nm: Array

    @property
    def is_delta(self) -> bool:
        """Whether the lobe is a delta distribution only (then `evaluate` is zero)."""
        return False

    @property
    def transmits(self) -> bool:
        """Whether light passes to the other side."""
        return False

    @property
    def is_stochastic(self) -> bool:
        """Whether values come from a random walk on the renderer's side (the layered lobe)."""
        return False

    @property
    def varying(self) -> tuple[str, ...]:
        """Names of the numbers a texture drives."""
        return tuple(axis.name for axis in getattr(self, "parameters", ()))

    @abc.abstractmethod
    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the non-delta part, `[..., wavelength]`, for unit vectors `wi`, `wo` of shape `[..., 3]`."""

    def check(self) -> None:
        """Check that the arrays fit together; a stored file may hold anything.

        Raises:
            ValueError: saying which array does not fit.
        """
        if self.wavelengths_nm.ndim != 1 or np.any(np.diff(self.wavelengths_nm) <= 0):
            raise ValueError("wavelengths_nm must ascend along one axis")

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate the non-delta part over all exits, for light along one `wi[3]`.

        A product rule by default; a lobe that is narrow or has many peaks brings its own.

        Returns:
            power `(to the side of wi, to the other side)`, each `[wavelength]`.
        """
        from nacre.bsdf.hemisphere import product_rule

        return product_rule(lambda wo: self.evaluate(np.broadcast_to(wi, wo.shape), wo, uv), wi, nodes, self.transmits)

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return the delta part for light arriving at `cos_i` (> 0 from the ambient, < 0 from behind)."""
        cos_i = np.asarray(cos_i, dtype=float)
        zero = np.zeros((*cos_i.shape, len(self.wavelengths_nm)))
        return SpecularResponse(zero, zero)


@dataclass(frozen=True)
class Bsdf:
    """A material's answer to light: a sum of lobes on one wavelength grid.

    Attributes:
        lobes: the terms of the sum, all on the same wavelengths.
        provenance: recipe text, nacre version, seed, notes; stored with every output.
    """

    lobes: tuple[Lobe, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def wavelengths_nm(self) -> Array:
        """The wavelength grid of all lobes, ascending."""
        return self.lobes[0].wavelengths_nm

    @property
    def transmits(self) -> bool:
        """Whether any lobe lets light through."""
        return any(lobe.transmits for lobe in self.lobes)

    def save(self, path: str | Path) -> None:
        """Write one `.nacre` file, whole or not at all.

        Raises:
            NacreError: the file cannot be written.
        """
        from nacre.bsdf.file import save_bsdf

        save_bsdf(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Bsdf:
        """Read a `.nacre` file.

        Raises:
            NacreError: in one line, if it is missing, damaged, too large or of a newer format.
        """
        from nacre.bsdf.file import load_bsdf

        return load_bsdf(path)

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Sum the lobes' non-delta values: `[..., wavelength]`, 1/sr, without the cosine, never NaN."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        total = self.lobes[0].evaluate(wi, wo, uv)
        for lobe in self.lobes[1:]:
            total = total + lobe.evaluate(wi, wo, uv)
        return total

    def specular(self, theta_rad: Array | float, uv: Array | None = None) -> SpecularResponse:
        """Sum the lobes' delta parts at incidence `theta_rad` (beyond pi/2: light from behind)."""
        cos_i = np.cos(np.asarray(theta_rad, dtype=float))
        parts = [lobe.specular(cos_i, uv) for lobe in self.lobes]
        return SpecularResponse(
            np.sum([p.reflectance for p in parts], axis=0), np.sum([p.transmittance for p in parts], axis=0)
        )
