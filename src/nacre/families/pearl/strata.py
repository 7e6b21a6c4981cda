"""The parts of a pearl: flakes in strata of resin, and their interfaces."""

from __future__ import annotations

from dataclasses import dataclass

from nacre.bsdf.roughness import Roughness
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
