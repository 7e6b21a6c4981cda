"""Where a look is seen, and what a material shows there: factors of which a perfect white has 1."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.bsdf.grids import direction
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError, UnsupportedError, did_you_mean
from nacre.families.contract import search_model, values_at
from nacre.light import default_wavelengths, lamp_lines_nm, spans_colour, with_lamp_lines
from nacre.material.material import Material
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.instruments import aspecular_direction
from nacre.measure.spectrum import bsdf_spectrum
from nacre.measure.wavelengths import WALK_NM
from nacre.recipe.model import show_value

KINDS = ("specular", "transmitted", "diffuse", "hemispherical")
FORMS = '"specular 0", "transmitted 30", "diffuse 0", "hemispherical 0" or "45as15"'
JUDGE_STEP_NM = 1.0
_WORD = re.compile(r"([A-Za-z]+)\s+([-+]?[\d.]+)$")
_ASPECULAR = re.compile(r"([\d.]+)as([-+]?[\d.]+)$")


@dataclass(frozen=True)
class Geometry:
    """One geometry.

    Attributes:
        kind: "specular", "transmitted", "diffuse", "hemispherical" or "aspecular".
        theta_deg: of the incident light.
        aspecular_deg: of the viewer, from the mirror direction towards the light.
    """

    kind: str
    theta_deg: float
    aspecular_deg: float = 0.0

    @classmethod
    def read(cls, text: str, where: str) -> Geometry:
        """Read `specular T`, `transmitted T`, `diffuse T`, `hemispherical T` or `IasA`.

        Raises:
            RecipeError: it is none of them, or an angle lies behind the surface.
        """
        said = text.strip()
        word, aspecular = _WORD.match(said), _ASPECULAR.match(said)
        try:
            if aspecular:
                at = cls("aspecular", float(aspecular[1]), float(aspecular[2]))
            elif word and word[1] in KINDS:
                at = cls(word[1], float(word[2]))
            else:
                hint = did_you_mean(word[1], KINDS) if word else ""
                raise RecipeError(f"{where} = {show_value(text)} is not known.{hint} Write {FORMS}")
        except ValueError:
            raise RecipeError(f"{where} = {show_value(text)} holds no angle; write {FORMS}") from None
        if not 0.0 <= at.theta_deg < 90.0:
            raise RecipeError(f"{where} = {show_value(text)}: the light must come from 0 up to 90 degrees")
        if abs(at.view_deg) >= 90.0:
            raise RecipeError(f"{where} = {show_value(text)} is seen from {at.view_deg:g} degrees, behind the surface")
        return at

    @property
    def view_deg(self) -> float:
        """The viewer's angle from the normal, towards the light's side; 0 where there is no one viewer."""
        return self.aspecular_deg - self.theta_deg if self.kind == "aspecular" else 0.0

    def __str__(self) -> str:
        if self.kind == "aspecular":
            return f"{self.theta_deg:g}as{self.aspecular_deg:g}"
        return f"{self.kind} {self.theta_deg:g}"


@dataclass(frozen=True)
class Measurement:
    """What a material shows at geometries.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        factors: `[at, wavelength]`.
        error: standard error of the factors, in their shape; None where nothing is drawn at random.
        missing: the geometries at which the material shows nothing by its nature, such as diffuse light of a mirror.
    """

    wavelengths_nm: Array
    factors: Array
    error: Array | None
    missing: frozenset[Geometry]


def aspecular_pairs(ats: Sequence[Geometry]) -> tuple[Array, Array]:
    """Return to the light and to the eye, `[at, 3]` each, of places of the kind `IasA`."""
    wi = direction(np.radians([at.theta_deg for at in ats]))
    wo = np.array([aspecular_direction(at.theta_deg, at.aspecular_deg) for at in ats]).reshape(-1, 3)
    return wi, wo


def simulate_measurement(
    material: Material,
    ats: Sequence[Geometry],
    wavelengths_nm: Array | None = None,
    *,
    samples: int | None = None,
    seed: int = 0,
    memory: dict[Any, Any] | None = None,
    is_rough: bool = False,
) -> Measurement:
    """Return what a material shows at geometries.

    Specular and transmitted light as `nacre spectrum` has it, aspecular colours as `nacre report`.

    Args:
        wavelengths_nm: ascending, or None for the material's own choice.
        samples, seed: of random walks.
        memory: of a search, whose candidates may share what hardly changes between them, and are looked at in the
            wanted directions alone where the family knows a shorter way there than its Bsdf. None: the reference.
        is_rough: with a memory, whether a ranking is enough.

    Raises:
        NacreError: the material cannot be computed.
    """
    if memory is not None:
        material = replace(material, model=search_model(material.model, memory, is_rough))
    model = material.model
    asked = [at for at in ats if at.kind != "aspecular"]
    rows = [row for row, at in enumerate(ats) if at.kind == "aspecular"]
    wi, wo = aspecular_pairs([ats[row] for row in rows])
    few = None
    if rows and memory is not None and wavelengths_nm is not None:
        few = values_at(model, wi, wo, wavelengths_nm)
    bsdf: Bsdf | None = None
    if rows and few is None:
        bsdf = model.bsdf(wavelengths_nm)
        wavelengths_nm = bsdf.wavelengths_nm
    spectrum, bsdf = _spectrum(material, asked, wavelengths_nm, bsdf, seed) if asked else (None, bsdf)
    grid = spectrum.wavelengths_nm if spectrum is not None else np.asarray(wavelengths_nm)
    factors = np.zeros((len(ats), len(grid)))
    error: Array | None = None
    missing = []
    for row, at in enumerate(ats):
        if at.kind == "aspecular":
            continue
        assert spectrum is not None
        value = _part(spectrum, at)
        if value is None:
            missing.append(at)
        else:
            factors[row] = value
    if few is not None:
        factors[rows] = np.pi * few
    elif rows:
        assert bsdf is not None
        if all(lobe.is_delta for lobe in bsdf.lobes):
            missing += [ats[row] for row in rows]
        values, deviation = evaluate_with_error(bsdf, wi, wo, samples=samples, seed=seed)
        factors[rows] = np.pi * values
        if deviation is not None:
            error = np.zeros_like(factors)
            error[rows] = np.pi * deviation
    return Measurement(grid, factors, error, frozenset(missing))


def _spectrum(
    material: Material, ats: Sequence[Geometry], wavelengths_nm: Array | None, bsdf: Bsdf | None, seed: int
) -> tuple[Spectrum, Bsdf | None]:
    """Return the spectrum at the angles asked for; what is diffuse is integrated only where it is asked for."""
    angles = np.unique([at.theta_deg for at in ats])
    found = material.model.spectrum(np.radians(angles), wavelengths_nm, "both", seed)
    if found is not None:
        return found, bsdf
    bsdf = material.model.bsdf(wavelengths_nm) if bsdf is None else bsdf
    wants_diffuse = any(at.kind in ("diffuse", "hemispherical") for at in ats)
    return bsdf_spectrum(bsdf, np.radians(angles), seed=seed, diffuse=wants_diffuse), bsdf


def _part(spectrum: Spectrum, at: Geometry) -> Array | None:
    row = int(np.argmin(np.abs(spectrum.angles_deg - at.theta_deg)))
    mirror, diffuse = spectrum.specular_reflectance, spectrum.diffuse_reflectance
    if at.kind == "hemispherical":
        parts = [part[row] for part in (mirror, diffuse) if part is not None]
        return np.sum(parts, axis=0) if parts else None
    part = {"specular": mirror, "transmitted": spectrum.specular_transmittance, "diffuse": diffuse}[at.kind]
    return None if part is None else np.asarray(part[row])


def search_wavelengths(material: Material, lamps: Sequence[str]) -> Array:
    """Return the grid on which candidates are compared: the material's own, and the lines of the lamps.

    What takes long is compared on the coarse grid of reports, between whose samples goals run a spline.
    """
    grid = material.model.wavelengths_nm
    if not material.model.traits.is_quick:
        coarse = WALK_NM[(WALK_NM >= grid[0]) & (WALK_NM <= grid[-1])]
        grid = coarse if len(coarse) < len(grid) and spans_colour(coarse) else grid
    return _with_lines(grid, lamps)


def evaluation_wavelengths(material: Material, lamps: Sequence[str]) -> Array:
    """Return the grid on which answers are judged: 1 nm where that is quick, else the material's own."""
    own = _with_lines(material.model.wavelengths_nm, lamps)
    return np.union1d(own, default_wavelengths(step_nm=JUDGE_STEP_NM)) if material.model.traits.is_quick else own


def _with_lines(grid: Array, lamps: Sequence[str]) -> Array:
    for lamp in lamps:
        if len(lamp_lines_nm(lamp)):
            grid = with_lamp_lines(grid, lamp)
    return np.asarray(grid)


def why_missing(material: Material, at: Geometry) -> str:
    """Return why a material answers nothing at a geometry."""
    noun = material.model.traits.noun
    return {
        "specular": f"this {noun} has no mirror-like part",
        "transmitted": f"this {noun} lets no light through straight",
        "diffuse": f"this {noun} sends out no diffuse light",
        "hemispherical": f"this {noun} reflects nothing",
        "aspecular": f"this {noun} sends light into the mirror direction only, none elsewhere",
    }[at.kind]


def check_answers(materials: Sequence[Material], ats: Sequence[Geometry], where: Sequence[str]) -> None:
    """Refuse a geometry at which none of some materials shows anything.

    Args:
        materials: the recipe, and what its free numbers may make of it.
        where: file and key of each geometry, for messages.

    Raises:
        RecipeError: naming the want.
        NacreError: the first material cannot be computed.
    """
    open_: set[Geometry] = set(ats)
    for number, material in enumerate(materials):
        try:
            open_ &= missing_geometries(material, ats)
        except UnsupportedError as error:
            if number == 0:
                raise RecipeError(f"{where[0]}: {error}") from None
        if not open_:
            return
    for at, place in zip(ats, where, strict=True):
        if at in open_:
            raise RecipeError(f'{place} = "{at}" cannot be answered: {why_missing(materials[0], at)}')


def missing_geometries(material: Material, ats: Sequence[Geometry]) -> frozenset[Geometry]:
    """Return the geometries at which a material shows nothing by its nature; nothing is walked for it.

    Raises:
        NacreError: the material cannot be computed.
    """
    probe = _probe(material)
    if material.model.traits.is_quick:
        return simulate_measurement(material, ats, probe).missing
    asked = [at for at in ats if at.kind != "aspecular"]
    angles = np.radians([at.theta_deg for at in asked])
    found = material.model.spectrum(angles, probe, "both", 0) if asked else None
    missing = [at for at in asked if found is not None and _part(found, at) is None]
    if found is None:
        bsdf = material.model.bsdf(probe)
        spreads = any(not lobe.is_delta for lobe in bsdf.lobes)
        missing += [at for at in ats if at.kind in ("aspecular", "diffuse") and not spreads]
        if asked:
            mirror = bsdf_spectrum(bsdf, angles, diffuse=False)
            missing += [at for at in asked if at.kind in ("specular", "transmitted") and _part(mirror, at) is None]
    return frozenset(missing)


def _probe(material: Material) -> Any:
    grid = np.asarray(material.model.wavelengths_nm)
    return grid[:: max(1, len(grid) // 3)]


__all__ = [
    "Geometry",
    "Measurement",
    "aspecular_pairs",
    "check_answers",
    "evaluation_wavelengths",
    "search_wavelengths",
    "simulate_measurement",
]
