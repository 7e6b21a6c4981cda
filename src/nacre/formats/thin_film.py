"""A single thin film on a base, as in glTF and OpenPBR materials."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ThinFilm:
    """A single thin film over a base.

    Attributes:
        thickness_nm: film thickness.
        film_ior: real film index.
        base_rgb: linear sRGB reflectance of the metal base at normal incidence, white for a dielectric one.
        base_ior: index, for a dielectric base.
        is_metal: whether the base is a metal.
        roughness: GGX alpha.
        transmits: whether the (dielectric) base transmits.
        not_read: names of unsupported properties in the file.
    """

    thickness_nm: float
    film_ior: float
    base_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    base_ior: float = 1.5
    is_metal: bool = True
    roughness: float = 0.0
    transmits: bool = False
    not_read: tuple[str, ...] = ()
