"""The parts of a pearl: flakes in strata of resin, their interfaces, and the base below."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from nacre.arrays import Array
from nacre.bsdf.contract import Lobe
from nacre.bsdf.roughness import Roughness
from nacre.errors import NacreError, UnsupportedError
from nacre.families.pearl.dye import Dye
from nacre.families.pearl.medium import (
    FlakeNormals,
)
from nacre.families.pearl.platelet import Platelet
from nacre.matter.indices.constant import OpticalConstant


@dataclass(frozen=True)
class Flakes:
    """One kind of flake in a stratum.

    Attributes:
        platelet: its layers.
        volume_fraction: of the stratum's volume.
        normals: distribution of the normals in the surface frame.
        diameter_um: median diameter, for glints; None: the flakes are too small to be resolved.
    """

    platelet: Platelet
    volume_fraction: float
    normals: FlakeNormals
    diameter_um: float | None = None


@dataclass(frozen=True)
class Stratum:
    """A layer of resin with what is in it; `surface` is its upper interface."""

    resin: OpticalConstant
    thickness_nm: float
    surface: Roughness = Roughness()
    flakes: tuple[Flakes, ...] = ()
    dye: Dye | None = None


@dataclass(frozen=True)
class Base:
    """What lies below.

    Attributes:
        kind: "none", "diffuse", "specular" or "lobes".
        albedo: of a diffuse base: a number, or (wavelengths_nm, albedo) of a coloured one.
        metal: material of a specular base.
        film: a solved opaque film as base: (wavelengths_nm, cos, reflectance[cos, wavelength]).
        surface: roughness of a specular base, or of the lower interface of an open stack.
        other: of "lobes", an opaque material of any family, built with the last resin as its ambient.
        refuse: makes the error of an `other` that cannot be a base, from the reason.
    """

    kind: str = "diffuse"
    albedo: float | tuple[Array, Array] = 0.0
    metal: OpticalConstant | None = None
    film: tuple[Array, Array, Array] | None = None
    surface: Roughness = Roughness()
    other: Any = None
    refuse: Callable[[str], NacreError] = UnsupportedError

    @cached_property
    def default_lobes(self) -> tuple[Lobe, ...]:
        """The other material's lobes on wavelengths of its own choice."""
        return self.lobes(None)

    def lobes(self, wavelengths_nm: Array | None) -> tuple[Lobe, ...]:
        """Return the other material's lobes at given wavelengths.

        Raises:
            NacreError: it transmits, or is a random walk itself.
        """
        if self.other is None:
            return ()
        lobes: tuple[Lobe, ...] = self.other.bsdf(wavelengths_nm).lobes
        if any(is_pearl(lobe) for lobe in lobes):
            raise self.refuse("holds a pearl; a pearl cannot be a base: write its strata below these ones instead")
        if any(lobe.transmits for lobe in lobes):
            raise self.refuse("lets light through; a base should be opaque, on a metal or with a base of its own")
        return lobes


def is_pearl(lobe: Lobe) -> bool:
    """Tell whether a lobe is a pearl's, masked or not."""
    inner = getattr(lobe, "inner", None)
    return lobe.kind in ("layered", "flaked") or (inner is not None and is_pearl(inner))
