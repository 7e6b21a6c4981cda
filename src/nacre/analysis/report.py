"""Industrial appearance measures: multi-angle colour, flop, colour travel, gloss, haze, hemispherical totals.

Every value states its geometry. Colours are computed from the reflectance factor pi f (a perfect diffuser is 1), as by
multi-angle spectrophotometers. The specular part of a smooth film lies outside their apertures and is listed separately
as colours over the incidence angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.texture import refuse_place
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, RecipeError, did_you_mean
from nacre.families.contract import Diffracting, Polarised, energy_defect
from nacre.light import (
    colour_difference,
    lab_to_lch,
    smooth_weights,
    spectrum_to_xyz,
    swatch_hex,
    white_xyz,
    xyz_to_lab,
)
from nacre.light.colour_spaces import DIN_6175
from nacre.material.material import MaterialLike, as_material
from nacre.measure import geometry
from nacre.measure.colours import colour_bsdf, recipe_geometries
from nacre.measure.evaluate import (
    SelectiveBand,
    circular_reflection,
    evaluate_at_own,
    evaluate_for_colours,
    hemispherical,
    selective_band,
    warn_of_table,
)
from nacre.measure.geometry import Geometry, aspecular_pairs
from nacre.measure.texture import Texture

SPECULAR_ANGLES_DEG = (5.0, 15.0, 30.0, 45.0, 60.0, 75.0)
FLOP_FACTOR, FLOP_POWER, FLOP_BASE = 2.69, 1.11, 0.86  # Alman's flop index
MIRROR_THRESHOLD = 1e-6
DARK = 1e-6  # Y of a geometry without light
APERTURE_WALKS, LEAST_SAMPLES = 1 << 15, 64  # random walks over a gloss meter's aperture, and per node


@dataclass(frozen=True)
class ColourTable:
    """Colours over angles or geometries.

    Attributes:
        what: title.
        angles_deg: `[angle]`: incidence, aspecular angle, or for named geometries the viewer's angle from the normal.
        labels: `[angle]` geometry names, such as "45as15".
        xyz, lab: `[angle, 3]`.
        hex: swatches.
        aspecular_deg: `[angle]`; None for the mirror direction.
    """

    what: str
    angles_deg: Array
    labels: tuple[str, ...]
    xyz: Array
    lab: Array
    hex: tuple[str, ...]
    aspecular_deg: Array | None = None

    @property
    def lch(self) -> Array:
        """L*, C*, h (degrees), `[angle, 3]`."""
        return np.asarray(lab_to_lch(self.lab))

    @property
    def travel(self) -> float:
        """Length of the path through a*, b* over the angles."""
        return float(np.sum(np.linalg.norm(np.diff(self.lab[:, 1:], axis=0), axis=1)))


@dataclass(frozen=True)
class Report:
    """The report of one material.

    Attributes:
        name: recipe name.
        illuminant, observer: for all colours; flop index, gloss and haze use the ones in their standards.
        aspecular: colours at 45 degree incidence, at the standard aspecular angles.
        specular: colours of the mirror direction over incidence; None without a specular part.
        geometries: colours at further requested geometries; None if there are none.
        flop_index: Alman's, from L* at 15, 45 and 110 degrees under D65 with the 10 degree observer; None if L* at
            45 is 0.
        gloss: gloss units at 20, 60 and 85 degrees, under illuminant C with the 2 degree observer as all haze.
        reflection_haze: ASTM E430 at 30 degrees, as a percentage of the specular flux; None for no specular flux.
        hemispherical: `name -> luminous value` at normal incidence and 45 degrees; `energy_defect` if the
            published energy balance of a recipe loses light that is not absorbed.
        transmission_haze: ASTM D1003 percentage, None for an opaque material.
        noise: largest standard error of a reflectance factor, 0 without a random walk.
        surface: roughness of a measured surface, such as `sq_um`.
        texture: sparkle and graininess, if requested.
        selective: band in which one hand of circular light is reflected, at "0" and "45" degrees, if there is one.
        order_width_deg: standard deviation of each order of a grating; None for other materials.
    """

    name: str
    illuminant: str
    observer: str
    aspecular: ColourTable
    specular: ColourTable | None
    geometries: ColourTable | None
    flop_index: float | None
    gloss: dict[str, float]
    reflection_haze: float | None
    hemispherical: dict[str, float]
    transmission_haze: float | None
    noise: float = 0.0
    surface: dict[str, float] = field(default_factory=dict)
    selective: dict[str, SelectiveBand] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    texture: Texture | None = None
    order_width_deg: float | None = None

    @property
    def dark_geometries(self) -> tuple[str, ...]:
        """Geometries outside the mirror direction that no order of a grating reaches."""
        if self.order_width_deg is None:
            return ()
        tables = (self.aspecular, *([] if self.geometries is None else [self.geometries]))
        return tuple(
            label for table in tables for label, xyz in zip(table.labels, table.xyz, strict=True) if xyz[1] < DARK
        )

    @property
    def tables(self) -> dict[str, ColourTable]:
        """The tables with colours, by name."""
        named = {"aspecular": self.aspecular, "specular": self.specular, "geometries": self.geometries}
        return {name: table for name, table in named.items() if table is not None}


def make_report(
    thing: MaterialLike,
    illuminant: str = "D65",
    observer: str = "10deg",
    samples: int | None = None,
    seed: int = 0,
    geometries: Sequence[str] = (),
) -> Report:
    """Measure a material in the standard geometries: Lab at 15 to 110 degrees, flop, gloss, haze, totals.

    Args:
        thing: a material, or a recipe path, `.nacre` file or design folder, an example's name or a recipe's table.
        illuminant, observer: for the colours.
        samples, seed: random-walk settings.
        geometries: further aspecular geometries, "45as25az90" or "NAME=45as25az90", in addition to the aspecular ones
            of the recipe's `[[geometry]]`.

    Raises:
        NacreError: the material cannot be loaded or measured.
        RecipeError: a geometry is not aspecular, or behind the surface.

    Example:
        >>> round(nacre.report("gold").gloss["60"] / 100) >= 1
        True
    """
    material = as_material(thing)
    own = {name: at for name, at in recipe_geometries(material).items() if at.kind == "aspecular"}
    named = own | read_geometries(geometries)
    refuse_place(material.model, f"{material.context.source}: report")
    bsdf = colour_bsdf(material, illuminant)
    light = (illuminant, observer)
    standard = [Geometry("aspecular", 45.0, angle) for angle in geometry.ASPECULAR_DEG]
    wi, wo = aspecular_pairs([*standard, *named.values()])
    factor, error, grid = evaluate_for_colours(bsdf, wi, wo, samples=samples, seed=seed)
    further, factor = factor[len(standard) :], factor[: len(standard)]
    labels = tuple(map(str, standard))
    aspecular = colour_table(
        "aspecular, 45 degree incidence", geometry.ASPECULAR_DEG, np.pi * factor, grid, *light, labels
    )
    aspecular = replace(aspecular, aspecular_deg=aspecular.angles_deg)
    warn_of_table(bsdf, np.radians([*SPECULAR_ANGLES_DEG, *geometry.GLOSS_APERTURES_DEG]))
    mirror = bsdf.specular(np.radians(SPECULAR_ANGLES_DEG)).reflectance
    mixes = isinstance(material.model, Polarised) and material.model.mixes_polarisations
    spectrum = material.spectrum(np.radians([0.0, 45.0]), bsdf.wavelengths_nm, "mueller" if mixes else "both")
    parts = {name: _luminous(value, spectrum.wavelengths_nm, *light) for name, value in spectrum.parts().items()}
    defect = energy_defect(material.model, np.radians([0.0, 45.0]), spectrum.wavelengths_nm, seed)
    if defect is not None:
        parts["energy_defect"] = _luminous(defect, spectrum.wavelengths_nm, *light)
    totals = {
        f"{name}_{angle}": float(v) for name, pair in parts.items() for angle, v in zip((0, 45), pair, strict=True)
    }
    flop_lab = colour_table("flop", geometry.ASPECULAR_DEG, np.pi * factor, grid, *geometry.FLOP_LIGHT).lab
    lightness = {a: lab[0] for a, lab in zip(geometry.ASPECULAR_DEG, flop_lab, strict=True)}
    return Report(
        name=material.name,
        illuminant=illuminant,
        observer=observer,
        aspecular=aspecular,
        specular=colour_table("mirror direction", SPECULAR_ANGLES_DEG, mirror, bsdf.wavelengths_nm, *light)
        if mirror.max() > MIRROR_THRESHOLD
        else None,
        geometries=replace(
            colour_table(
                "further geometries", [g.view_deg for g in named.values()], np.pi * further, grid, *light, tuple(named)
            ),
            aspecular_deg=np.array([g.aspecular_deg for g in named.values()]),
        )
        if named
        else None,
        flop_index=flop_index(lightness[15.0], lightness[45.0], lightness[110.0]),
        gloss={f"{a:g}": gloss(bsdf, a, samples=samples, seed=seed) for a in geometry.GLOSS_APERTURES_DEG},
        reflection_haze=_reflection_haze(bsdf, samples=samples, seed=seed),
        hemispherical=totals,
        transmission_haze=transmission_haze(bsdf, samples=samples, seed=seed) if bsdf.transmits else None,
        noise=0.0 if error is None else float(np.pi * error.max()),
        surface=dict(material.model.surface_figures),
        selective=_selective(spectrum),
        order_width_deg=float(np.degrees(material.model.order_width_rad))
        if isinstance(material.model, Diffracting)
        else None,
        provenance={"nacre": __version__, "recipe": material.text, "seed": seed, "samples": samples},
    )


def colour_table(
    what: str,
    angles_deg: Sequence[float],
    factors: Array,
    wavelengths_nm: Array,
    illuminant: str,
    observer: str,
    labels: tuple[str, ...] = (),
) -> ColourTable:
    """Return the colours of reflectance factors `[angle, wavelength]`; default labels: "specular ANGLE"."""
    # the random-walk spectrum is interpolated smoothly between its few wavelengths
    xyz = np.asarray(factors @ smooth_weights(wavelengths_nm, illuminant, observer))
    lab = xyz_to_lab(xyz, white_xyz(illuminant, observer))
    swatches = tuple(swatch_hex(row, white_xyz(illuminant, observer)) for row in xyz)
    labels = labels or tuple(f"specular {angle:g}" for angle in angles_deg)
    return ColourTable(what, np.asarray(angles_deg), labels, np.asarray(xyz), np.asarray(lab), swatches)


def read_geometries(texts: Sequence[str]) -> dict[str, Geometry]:
    """Return aspecular geometries by name from "45as25az90" or "NAME=45as25az90".

    Raises:
        RecipeError: another form, an angle behind the surface, an empty name, or the same name twice.
    """
    geometries: dict[str, Geometry] = {}
    for text in texts:
        name, separator, value = text.rpartition("=")
        one = Geometry.read(value, "geometry")
        if one.kind != "aspecular":
            raise RecipeError(f'geometry = "{text}" is not aspecular; write such as "45as25az90" or "door=45as25az90"')
        name = name.strip() if separator else str(one)
        if not name:
            raise RecipeError(f'geometry = "{text}" has an empty name; write such as "door=45as25az90"')
        if name in geometries:
            raise RecipeError(f'geometry = "{text}": the name {name} occurs twice')
        geometries[name] = one
    return geometries


def flop_index(lightness_15: float, lightness_45: float, lightness_110: float) -> float | None:
    """Return Alman's flop index 2.69 (L15 - L110)^1.11 / L45^0.86, or None if L45 is 0.

    Example:
        >>> round(flop_index(120.0, 60.0, 30.0), 1)  # a strong metallic
        11.7
    """
    if lightness_45 <= 0 or lightness_15 < lightness_110:
        return None
    return float(FLOP_FACTOR * (lightness_15 - lightness_110) ** FLOP_POWER / lightness_45**FLOP_BASE)


def _selective(spectrum: Spectrum) -> dict[str, SelectiveBand]:
    """Return the bands of selective reflection by incidence angle, of spectra with Mueller matrices."""
    if spectrum.mueller_reflected is None:
        return {}
    lam = spectrum.wavelengths_nm
    bands = [selective_band(circular_reflection(m), lam) for m in spectrum.mueller_reflected]
    return {angle: band for angle, band in zip(("0", "45"), bands, strict=True) if band is not None}


def _luminous(values: Array, wavelengths_nm: Array, illuminant: str, observer: str) -> Array:
    return np.asarray(spectrum_to_xyz(values, wavelengths_nm, illuminant, observer))[..., 1]


def aperture_flux(bsdf: Bsdf, theta_deg: float, aperture: geometry.Aperture, samples: int | None, seed: int) -> Array:
    """Return the share of the incident flux in an aperture `[wavelength]`, without the delta part."""
    wi = np.broadcast_to(direction(np.radians(theta_deg)), aperture.wo.shape)
    # the aperture has many nodes, so that each needs few samples
    fair = max(LEAST_SAMPLES, APERTURE_WALKS // len(aperture.wo)) if samples is None else samples
    values = evaluate_at_own(bsdf, wi, aperture.wo, samples=fair, seed=seed)
    return np.asarray((aperture.weight * np.abs(aperture.wo[:, 2])) @ values)


def gloss(bsdf: Bsdf, theta_deg: float, samples: int | None = None, seed: int = 0) -> float:
    """Return gloss units at 20, 60 or 85 degrees: the receptor's flux over that of black glass, times 100.

    Source: ISO 2813 and ASTM D523 (receptor apertures, illuminant C with the 2 degree observer, black glass of
    n = 1.567), described in NIST Special Publication 250-70; collimated light.
    """
    aperture = geometry.rectangular_aperture(theta_deg, *geometry.GLOSS_APERTURES_DEG[theta_deg])
    flux = aperture_flux(bsdf, theta_deg, aperture, samples, seed)
    flux = flux + bsdf.specular(np.radians(theta_deg)).reflectance
    luminous = float(_luminous(flux, bsdf.wavelengths_nm, *geometry.STANDARD_LIGHT))
    return 100.0 * luminous / geometry.black_glass_reflectance(theta_deg)


def _reflection_haze(bsdf: Bsdf, samples: int | None, seed: int) -> float | None:
    """Return ASTM E430 haze: flux 2 degrees off the mirror direction relative to the flux in it, in per cent.

    Mean of both sides of the mirror direction; illuminant C and the 2 degree observer.
    """
    theta, size = geometry.HAZE_INCIDENCE_DEG, geometry.HAZE_APERTURE_DEG
    at = {}
    for offset in (-geometry.HAZE_OFFSET_DEG, 0.0, geometry.HAZE_OFFSET_DEG):
        aperture = geometry.rectangular_aperture(theta + offset, *size)
        flux = aperture_flux(bsdf, theta, aperture, samples, seed)
        if offset == 0.0:
            flux = flux + bsdf.specular(np.radians(theta)).reflectance
        at[offset] = float(_luminous(flux, bsdf.wavelengths_nm, *geometry.STANDARD_LIGHT))
    if at[0.0] <= MIRROR_THRESHOLD:
        return None
    return 100.0 * (at[-geometry.HAZE_OFFSET_DEG] + at[geometry.HAZE_OFFSET_DEG]) / 2 / at[0.0]


def transmission_haze(bsdf: Bsdf, samples: int | None = None, seed: int = 0) -> float:
    """Return ASTM D1003 haze: the share of transmitted light that deviates by more than 2.5 degrees, in per cent.

    Normal incidence, illuminant C and the 2 degree observer. Transmitted directions are those inside the substrate.
    """
    normal = direction(0.0)
    straight = bsdf.specular(0.0).transmittance
    spread = [hemispherical(lobe, normal, seed=seed)[1] for lobe in bsdf.lobes if not lobe.is_delta]
    total = straight + sum(spread)
    cone = geometry.transmission_cone(geometry.TRANSMISSION_HAZE_CONE_DEG)
    within = straight + aperture_flux(bsdf, 0.0, cone, samples, seed)
    all_light, near = _luminous(np.stack([total, within]), bsdf.wavelengths_nm, *geometry.STANDARD_LIGHT)
    return 100.0 * float(np.clip(1.0 - near / all_light, 0.0, 1.0)) if all_light > 0 else 0.0


@dataclass(frozen=True)
class Comparison:
    """Colour differences of a report from a standard.

    Attributes:
        name: sample name.
        formula: a formula of `nacre.light.colour_difference`.
        tables: table name -> differences `[angle]`.
        labels: table name -> geometry names `[angle]`.
        limits: geometry -> largest accepted difference; geometries without a limit are not evaluated.
        standard: file of the standard; "": the first report.
    """

    name: str
    formula: str
    tables: dict[str, Array]
    labels: dict[str, tuple[str, ...]]
    limits: dict[str, float]
    standard: str = ""

    @property
    def passes(self) -> dict[str, bool]:
        """Whether each geometry with a limit is within it."""
        pairs = ((label, d) for name, row in self.tables.items() for label, d in zip(self.labels[name], row))
        return {label: bool(d <= self.limits[label]) for label, d in pairs if label in self.limits}


def compare(
    report: Report, standard: Report, formula: str = "ciede2000", limits: Mapping[str, float] | None = None
) -> Comparison:
    """Return a report's colour differences from a standard.

    Args:
        formula: from `nacre.light.colour_difference`; the standard is its first colour. "din6175-2" compares aspecular
            geometries only.
        limits: geometry ("45as15", "specular 45", a name) -> largest accepted difference; "" holds for all others.

    Raises:
        NacreError: the formula is unknown, or a limit's geometry is in no table.
    """
    both = {name: (standard.tables[name], table) for name, table in report.tables.items() if name in standard.tables}
    if formula == DIN_6175:
        both = {name: pair for name, pair in both.items() if pair[1].aspecular_deg is not None}
        if not any(np.any(table.xyz > 0) for pair in both.values() for table in pair):
            raise NacreError(f'formula = "{formula}" compares aspecular geometries, at which both surfaces are black')
    tables = {
        name: colour_difference(first.lab, second.lab, formula, second.aspecular_deg)
        for name, (first, second) in both.items()
    }
    labels = {name: second.labels for name, (_, second) in both.items()}
    return Comparison(report.name, formula, tables, labels, _limits_of(labels, limits))


def compare_with_colours(
    report: Report,
    colours: Mapping[str, Array],
    formula: str = "ciede2000",
    limits: Mapping[str, float] | None = None,
    standard: str = "colours",
) -> Comparison:
    """Return a report's colour differences from a colour list.

    Args:
        colours: geometry of the report -> CIELAB `[3]` of the standard, for the report's illuminant and observer.
        formula, limits: as for `compare`.
        standard: list name.

    Raises:
        NacreError: a geometry of the list or of a limit is not in the report, or the formula is unknown.
    """
    seen = {label: lab for table in report.tables.values() for label, lab in zip(table.labels, table.lab, strict=True)}
    angles = {
        label: angle
        for table in report.tables.values()
        if table.aspecular_deg is not None
        for label, angle in zip(table.labels, table.aspecular_deg, strict=True)
    }
    for label in colours:
        if label not in seen:
            hint = did_you_mean(label, list(seen))
            raise NacreError(f'{standard}: "{label}" names no geometry of the report.{hint} It has {", ".join(seen)}')
    first, second = (np.array([table[label] for label in colours], dtype=float) for table in (colours, seen))
    labels = {"standard": tuple(colours)}
    mirror = next((label for label in colours if label not in angles), None)
    if formula == DIN_6175 and mirror is not None:
        raise NacreError(f'{standard}: "{mirror}" is not aspecular, as formula = "{formula}" needs')
    at = np.array([angles[label] for label in colours]) if mirror is None else None
    differences = {"standard": colour_difference(first, second, formula, at)}
    return Comparison(report.name, formula, differences, labels, _limits_of(labels, limits), standard)


def _limits_of(labels: Mapping[str, tuple[str, ...]], limits: Mapping[str, float] | None) -> dict[str, float]:
    """Return the limit for each geometry; "" means all others.

    Raises:
        NacreError: a limit's geometry is in no table.
    """
    known = [label for row in labels.values() for label in row]
    limits = dict(limits or {})
    for name in limits:
        if name and name not in known:
            hint = did_you_mean(name, known)
            raise NacreError(f'tolerance "{name}" names no geometry of the report.{hint} It has {", ".join(known)}')
    general = limits.pop("", None)
    if general is not None:
        limits = dict.fromkeys(known, general) | limits
    return limits
