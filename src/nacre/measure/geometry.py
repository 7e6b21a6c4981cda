"""Measurement geometries by name: mirror direction, hemisphere, aspecular angles, gloss and haze apertures.

Light is incident at `theta_i` in the plane phi = 0. Aspecular angles are counted from the mirror direction towards the
light: at 45 degrees incidence, 45 degrees aspecular is the normal, and 110 lies on the light's side.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.facet_distributions import fresnel
from nacre.core.arrays import Array, direction
from nacre.core.errors import RecipeError, did_you_mean
from nacre.recipe.model import show_value

STANDARD_LIGHT = ("C", "2deg")  # for gloss and haze: ISO 2813, ASTM D523, E430 and D1003
FLOP_LIGHT = ("D65", "10deg")  # ASTM E2194, with the angles of Alman's index
ASPECULAR_DEG = (-15.0, 15.0, 25.0, 45.0, 75.0, 110.0)  # ASTM E2194 and E2539, and the sixth angle of newer devices
GLOSS_BLACK_GLASS_INDEX = 1.567  # ISO 2813: refractive index at 587.6 nm
# ISO 2813: full receptor angles in the incidence plane and across it
GLOSS_APERTURES_DEG = {20.0: (1.80, 3.60), 60.0: (4.40, 11.70), 85.0: (4.00, 6.00)}
HAZE_INCIDENCE_DEG = 30.0  # ASTM E430, test method B: reflection haze 2 degrees off the specular direction
HAZE_OFFSET_DEG = 2.0
HAZE_APERTURE_DEG = (0.4, 3.0)
TRANSMISSION_HAZE_CONE_DEG = 2.5  # ASTM D1003


@dataclass(frozen=True)
class Aperture:
    """A receptor's directions and solid-angle weights: `wo[direction, 3]`, `weight[direction]` in sr."""

    wo: Array
    weight: Array


def aspecular_direction(incidence_deg: float, aspecular_deg: float) -> Array:
    """Return the view direction at an aspecular angle for light from +x.

    Example: 45 degree incidence and 45 degrees aspecular is the normal.
    """
    return direction(np.radians(aspecular_deg - incidence_deg))


def rectangular_aperture(centre_deg: float, in_plane_deg: float, across_deg: float, nodes: int = 24) -> Aperture:
    """Return Gauss-Legendre directions of a rectangular receptor about the mirror side's polar angle.

    Args:
        centre_deg: polar angle of the centre, on the side away from the light.
        in_plane_deg, across_deg: full angles.
        nodes: per axis; denser at the centre, for narrow lobes.
    """
    along, along_weight = _graded(np.radians(in_plane_deg) / 2, nodes)
    across, across_weight = _graded(np.radians(across_deg) / 2, nodes)
    a, b = np.meshgrid(along, across, indexing="ij")
    # a rotates in the incidence plane, b out of it along a great circle
    polar = np.radians(centre_deg) + a
    wo = np.stack([-np.sin(polar) * np.cos(b), np.sin(b), np.cos(polar) * np.cos(b)], axis=-1).reshape(-1, 3)
    weight = (along_weight[:, None] * across_weight[None, :] * np.cos(b)).ravel()
    keep = wo[:, 2] > 1e-4
    return Aperture(wo[keep], weight[keep])


def transmission_cone(half_angle_deg: float, nodes: int = 24, turns: int = 12) -> Aperture:
    """Return directions and weights of a cone about the direct transmission.

    Args:
        half_angle_deg: half angle of the cone.
        nodes: polar angles, denser near the axis, for narrow lobes; turns: azimuths.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    t, half = 0.5 * (x + 1.0), np.radians(half_angle_deg)
    theta, step = half * t**3, half * 1.5 * t**2 * weight
    phi = (np.arange(turns) + 0.5) * (2.0 * np.pi / turns)
    theta_all, phi_all = np.meshgrid(theta, phi, indexing="ij")
    wo = direction(theta_all.ravel(), phi_all.ravel()) * np.array([1.0, 1.0, -1.0])
    return Aperture(wo, np.repeat(step * np.sin(theta) * (2.0 * np.pi / turns), turns))


def _graded(half: float, nodes: int) -> tuple[Array, Array]:
    """Return nodes and weights on [-half, half], denser at the centre, for narrow lobes.

    The cubic map of a Gauss rule is some 20 times finer at the centre than at the rim.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    shape = 0.05 * x + 0.95 * x**3
    slope = 0.05 + 2.85 * x**2
    return half * shape, half * w * slope


def black_glass_reflectance(theta_deg: float, n: float = GLOSS_BLACK_GLASS_INDEX) -> float:
    """Return the unpolarised Fresnel reflectance of the gloss standard.

    Example: 0.0491 at 20 degrees, 0.1001 at 60.
    """
    return float(fresnel(np.cos(np.radians(theta_deg)), n))


KINDS = ("specular", "transmitted", "diffuse", "hemispherical")
FORMS = '"specular 0", "transmitted 30", "diffuse 0", "hemispherical 0", "45as15" or "45as25az90"'
IN_PLANE_DEG = 180.0  # azimuth about the mirror direction of a viewer in the plane of incidence, towards the light
_WORD = re.compile(r"([A-Za-z]+)\s+([-+]?[\d.]+)$")
_ASPECULAR = re.compile(r"([\d.]+)as([-+]?[\d.]+)(?:az([-+]?[\d.]+))?$")


@dataclass(frozen=True)
class Geometry:
    """One geometry.

    Attributes:
        kind: "specular", "transmitted", "diffuse", "hemispherical" or "aspecular".
        theta_deg: incidence angle.
        aspecular_deg: angle of the viewer from the mirror direction, towards the light.
        azimuth_deg: viewer azimuth about the mirror direction: 180 in the plane of incidence towards the light, 0 away
            from it. In this notation of 12-angle instruments 45as60az125.3 is a viewer 45 degrees from the normal,
            across the plane of incidence.
        polarisation: incident polarisation: "s", "p", "left", "right" or "both" (unpolarised).
    """

    kind: str
    theta_deg: float
    aspecular_deg: float = 0.0
    azimuth_deg: float = IN_PLANE_DEG
    polarisation: str = "both"

    @classmethod
    def read(cls, text: str, where: str, named: Mapping[str, Geometry] | None = None) -> Geometry:
        """Read `specular T`, `transmitted T`, `diffuse T`, `hemispherical T`, `IasA`, `IasAazZ` or a name.

        Args:
            where: file and key, for messages.
            named: geometries by name.

        Raises:
            RecipeError: another form, or an angle behind the surface.
        """
        stripped = text.strip()
        if named and stripped in named:
            return named[stripped]
        word, aspecular = _WORD.match(stripped), _ASPECULAR.match(stripped)
        try:
            if aspecular:
                incidence, angle, azimuth = aspecular.groups()
                turn = IN_PLANE_DEG if azimuth is None else float(azimuth)
                geometry = cls("aspecular", float(incidence), float(angle), turn)
            elif word and word[1] in KINDS:
                geometry = cls(word[1], float(word[2]))
            else:
                hint = did_you_mean(word[1], KINDS) if word else did_you_mean(stripped, list(named or ()))
                raise RecipeError(f"{where} = {show_value(text)} is not known.{hint} Write {FORMS}")
        except ValueError:
            raise RecipeError(f"{where} = {show_value(text)} holds no angle; write {FORMS}") from None
        if not 0.0 <= geometry.theta_deg < 90.0:
            raise RecipeError(f"{where} = {show_value(text)}: the light must come from 0 up to 90 degrees")
        if geometry.view_deg >= 90.0:
            raise RecipeError(
                f"{where} = {show_value(text)} has a view of {geometry.view_deg:g} degrees, behind the surface"
            )
        return geometry

    @property
    def wo(self) -> Array:
        """Direction towards the viewer `[3]` for light from +x: the mirror direction unless aspecular."""
        if self.azimuth_deg == IN_PLANE_DEG:
            return aspecular_direction(self.theta_deg, self.aspecular_deg)
        theta, angle, turn = np.radians([self.theta_deg, self.aspecular_deg, self.azimuth_deg])
        mirror = np.array([-np.sin(theta), 0.0, np.cos(theta)])
        away = np.array([-np.cos(theta), 0.0, -np.sin(theta)])
        across = np.array([0.0, 1.0, 0.0])
        return np.asarray(np.cos(angle) * mirror + np.sin(angle) * (np.cos(turn) * away + np.sin(turn) * across))

    @property
    def view_deg(self) -> float:
        """Angle of the viewer from the normal; 0 except for aspecular geometries."""
        if self.kind != "aspecular":
            return 0.0
        if self.azimuth_deg == IN_PLANE_DEG:
            return abs(self.aspecular_deg - self.theta_deg)
        return float(np.degrees(np.arccos(np.clip(self.wo[2], -1.0, 1.0))))

    def __str__(self) -> str:
        if self.kind != "aspecular":
            state = "" if self.polarisation == "both" else f" {self.polarisation}"
            return f"{self.kind} {self.theta_deg:g}{state}"
        turn = "" if self.azimuth_deg == IN_PLANE_DEG else f"az{self.azimuth_deg:g}"
        return f"{self.theta_deg:g}as{self.aspecular_deg:g}{turn}"


def named_geometries(entries: Any, where: str) -> dict[str, Geometry]:
    """Return geometries by name from a list of tables with `name` and `at`.

    Raises:
        RecipeError: not such a list, a geometry is not known, or a name occurs twice or is the notation of another
            geometry.
    """
    if not isinstance(entries, Sequence) or isinstance(entries, str):
        raise RecipeError(f"{where} = {show_value(entries)} should be a list of tables: [[geometry]] with name and at")
    geometries: dict[str, Geometry] = {}
    for number, entry in enumerate(entries):
        table = entry if isinstance(entry, Mapping) else {}
        name, at = table.get("name"), table.get("at")
        if set(table) != {"name", "at"} or not isinstance(name, str) or not name.strip() or not isinstance(at, str):
            raise RecipeError(f'{where}[{number}] = {show_value(entry)}: write name = "door" and at = "45as60az125.3"')
        if name.strip() in geometries:
            raise RecipeError(f'{where}[{number}].name = "{name}" occurs twice')
        one = Geometry.read(at, f"{where}[{number}].at")
        if _is_another(name, one):
            raise RecipeError(f'{where}[{number}].name = "{name}" is another geometry than at = "{at}"; choose a word')
        geometries[name.strip()] = one
    return geometries


def _is_another(name: str, geometry: Geometry) -> bool:
    """Return whether a name is the notation of another geometry."""
    try:
        return Geometry.read(name, "name") != geometry
    except RecipeError:
        return False


def spectrum_at(spectrum: Spectrum, geometry: Geometry) -> Array | None:
    """Return the factor `[wavelength]` of a geometry that is not aspecular; None if the material lacks such a part."""
    row = int(np.argmin(np.abs(spectrum.angles_deg - geometry.theta_deg)))
    mirror, diffuse = spectrum.specular_reflectance, spectrum.diffuse_reflectance
    if geometry.kind == "hemispherical":
        parts = [part[row] for part in (mirror, diffuse) if part is not None]
        return np.sum(parts, axis=0) if parts else None
    part = {"specular": mirror, "transmitted": spectrum.specular_transmittance, "diffuse": diffuse}[geometry.kind]
    return None if part is None else np.asarray(part[row])


def aspecular_pairs(geometries: Sequence[Geometry]) -> tuple[Array, Array]:
    """Return directions to light and viewer, `[geometry, 3]` each, of aspecular geometries."""
    wi = direction(np.radians([geometry.theta_deg for geometry in geometries]))
    return wi, np.array([geometry.wo for geometry in geometries]).reshape(-1, 3)
