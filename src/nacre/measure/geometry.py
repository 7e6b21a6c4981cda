"""Measurement geometries by name: mirror direction, hemisphere, and the aspecular angles of multi-angle instruments."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array, direction
from nacre.core.errors import RecipeError, did_you_mean
from nacre.measure.instruments import aspecular_direction
from nacre.recipe.model import show_value

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
        azimuth_deg: of the viewer about the mirror direction: 180 in the plane of incidence towards the light, 0 away
            from it. In this notation of 12-angle instruments 45as60az125.3 is a viewer 45 degrees from the normal,
            across the plane of incidence.
        polarisation: of the incident light, "s", "p", "left", "right" or "both" (unpolarised).
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
        said = text.strip()
        if named and said in named:
            return named[said]
        word, aspecular = _WORD.match(said), _ASPECULAR.match(said)
        try:
            if aspecular:
                incidence, angle, azimuth = aspecular.groups()
                turn = IN_PLANE_DEG if azimuth is None else float(azimuth)
                geometry = cls("aspecular", float(incidence), float(angle), turn)
            elif word and word[1] in KINDS:
                geometry = cls(word[1], float(word[2]))
            else:
                hint = did_you_mean(word[1], KINDS) if word else did_you_mean(said, list(named or ()))
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
        """Direction to the viewer `[3]` for light from +x: of the mirror direction unless aspecular."""
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
        RecipeError: it is no such list, a geometry is not known, or a name occurs twice or is the notation of another
            geometry.
    """
    if not isinstance(entries, Sequence) or isinstance(entries, str):
        raise RecipeError(f"{where} = {show_value(entries)} should be a list of tables: [[geometry]] with name and at")
    found: dict[str, Geometry] = {}
    for number, entry in enumerate(entries):
        table = entry if isinstance(entry, Mapping) else {}
        name, at = table.get("name"), table.get("at")
        if set(table) != {"name", "at"} or not isinstance(name, str) or not name.strip() or not isinstance(at, str):
            raise RecipeError(f'{where}[{number}] = {show_value(entry)}: write name = "door" and at = "45as60az125.3"')
        if name.strip() in found:
            raise RecipeError(f'{where}[{number}].name = "{name}" occurs twice')
        one = Geometry.read(at, f"{where}[{number}].at")
        if _is_another(name, one):
            raise RecipeError(f'{where}[{number}].name = "{name}" is another geometry than at = "{at}"; choose a word')
        found[name.strip()] = one
    return found


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
