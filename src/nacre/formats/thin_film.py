"""One film on a base, as in real-time renderers: the numbers that glTF and OpenPBR materials hold."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ThinFilm:
    """A single thin film over a base.

    Attributes:
        thickness_nm: of the film.
        film_ior: its real index.
        base_rgb: linear sRGB reflectance of the metal base at normal incidence, white for a dielectric one.
        base_ior: index of a dielectric base.
        is_metal: whether the base is a metal.
        roughness: GGX alpha of the surface.
        transmits: whether the (dielectric) base transmits.
        not_read: names of what a file says of the material beyond this.
    """

    thickness_nm: float
    film_ior: float
    base_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    base_ior: float = 1.5
    is_metal: bool = True
    roughness: float = 0.0
    transmits: bool = False
    not_read: tuple[str, ...] = ()
