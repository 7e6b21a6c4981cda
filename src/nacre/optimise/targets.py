"""Targets with resolved colours, ranges and spectra."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import RecipeError, did_you_mean
from nacre.light import (
    ILLUMINANTS,
    OBSERVERS,
    delta_e_2000,
    hex_to_srgb,
    lch_to_lab,
    srgb_decode,
    srgb_linear_to_xyz,
    white_xyz,
    xyy_to_xyz,
    xyz_to_lab,
)
from nacre.measure.geometry import Geometry
from nacre.measure.texture import Instrument, TextureQuantity, read_instrument
from nacre.optimise.image.files import read_picture
from nacre.optimise.merit import MeritFunction, Operand
from nacre.optimise.spec import COLOURS, RANGES, LightSpec, TargetEntry
from nacre.readers.curves import FileSpec, recipe_spectrum
from nacre.recipe.model import RecipeContext, show_value

GAP_STEPS = 3.0  # largest step between rows, relative to the median step; a larger one is a gap
VISIBLE_NM = (380.0, 780.0)
NOISE_FACTOR = 0.05  # factors down to -0.05 are accepted as noise on a dark sample
MOST_FACTOR = 10.0  # reflectance factor of a mirror beside a matt white; a larger one is in per cent
MOST_LUMINANCE = 2.0  # a mirror or a sum over directions has at most 1: larger values are per cent
LEAST_NM, MOST_NM = 10.0, 1e5  # range of a target spectrum; outside, it has another unit or quantity
MOST_LIGHTNESS, MOST_CHROMA = 500.0, 500.0  # lobes are brighter than white, but not by so much
logger = logging.getLogger("nacre")
_HEX = re.compile(r"#([0-9a-fA-F]{6}|[0-9a-fA-F]{3})$")
_BOUND = re.compile(r"\s*(>=|<=)\s*([-+]?[\d.]+)\s*$")


@dataclass(frozen=True, eq=False)
class Target:
    """One target.

    Attributes:
        geometry: illumination and observation.
        asked: the file's entry as JSON data: {"colour": "#c2185b"}.
        lab: `[3]`, target under every lamp, or None.
        xyz: `[3]`, target under the first lamp, or None.
        ranges: "hue", "chroma", "lightness" -> (low, high), None where open.
        spectrum: wavelengths and target factors, `[2, wavelength]`, or None.
        texture: (low, high) of a `TextureQuantity`, None where open, or None.
        image: a picture's colours `[row, column, 3]`, encoded sRGB in [0, 1], the first row on top, or None.
        tolerance: allowed distance.
        weight: relative to other targets.
        key: its place in the file, for messages.
    """

    geometry: Geometry
    asked: dict[str, Any]
    tolerance: float
    weight: float
    key: str
    lab: Array | None = None
    xyz: Array | None = None
    ranges: dict[str, tuple[float | None, float | None]] | None = None
    spectrum: Array | None = None
    texture: tuple[float | None, float | None] | None = None
    image: Array | None = None

    def with_lab(self, lab: Array) -> Target:
        """Return the target with another colour."""
        request = {"lab": [float(v) for v in lab]}
        return replace(self, asked=request, lab=np.asarray(lab, float), xyz=None, ranges=None, spectrum=None)

    def with_number(self, value: float | None) -> Target:
        """Return the texture target with another value; None keeps its own."""
        if value is None:
            return self
        return replace(self, asked={**self.asked, "value": value}, texture=(value, value))

    def target_lab(self, white: Array) -> Array | None:
        """Return the target colour against a lamp's white; None for a range or a spectrum."""
        if self.xyz is not None:
            return np.asarray(xyz_to_lab(self.xyz, white))
        return self.lab

    def goals(self, row: int, wavelengths_nm: Array) -> list[Operand]:
        """Return the operands of the merit function.

        Args:
            row: index of the spectrum at this target's geometry.
            wavelengths_nm: common to all spectra.
        """
        often: dict[str, Any] = {"tolerance": self.tolerance, "weight": self.weight}
        if self.spectrum is not None:
            nm, values = self.spectrum
            wanted = np.interp(wavelengths_nm, nm, values, left=np.nan, right=np.nan)
            wanted[_in_gaps(nm, wavelengths_nm)] = np.nan
            return [Operand(row, "spectrum", reflectance=wanted, **often)]
        if self.texture is not None:
            return [Operand(row, "texture", low=self.texture[0], high=self.texture[1], **often)]
        if self.ranges is not None:
            return [Operand(row, kind, low=low, high=high, **often) for kind, (low, high) in self.ranges.items()]  # type: ignore[arg-type]  # the kinds are those of `_ranges`
        if self.xyz is not None:
            return [Operand(row, "colour", xyz=tuple(map(float, self.xyz)), **often)]  # type: ignore[arg-type]  # three numbers
        assert self.lab is not None
        return [Operand(row, "colour", lab=tuple(map(float, self.lab)), **often)]  # type: ignore[arg-type]  # three numbers


def _in_gaps(nm: Array, wavelengths_nm: Array) -> Array:
    """Return which wavelengths lie in a band without rows in the table, which is not compared."""
    steps = np.diff(nm)
    after = np.clip(np.searchsorted(nm, wavelengths_nm, side="right") - 1, 0, len(steps) - 1)
    is_between = ~np.isclose(wavelengths_nm, nm[after]) & ~np.isclose(wavelengths_nm, nm[after + 1])
    return np.asarray(is_between & (steps[after] > GAP_STEPS * np.median(steps)))


def srgb_to_lab(text: str, where: str) -> Array:
    """Return CIELAB of `#rrggbb`, for D65 and the 2 degree observer, as sRGB is defined.

    Raises:
        RecipeError: the text has another form.

    Example: "#ffffff" is (100, 0, 0).
    """
    if not _HEX.match(text.strip()):
        raise RecipeError(f'{where} = {show_value(text)} should be written "#rrggbb"')
    rgb = srgb_decode(np.array(hex_to_srgb(text)))
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(rgb), srgb_linear_to_xyz(np.ones(3))))


def read_targets(
    specs: Sequence[TargetEntry],
    light: LightSpec,
    context: RecipeContext,
    named: Mapping[str, Geometry] | None = None,
    instrument: str | Instrument | None = None,
) -> tuple[Target, ...]:
    """Resolve the targets of a file.

    Args:
        named: geometries by name.
        instrument: instrument for texture targets, a file or its keys.

    Raises:
        RecipeError: naming the target and the allowed values; or two incompatible colours for one geometry.
    """
    check_light(light, context)
    tool = read_instrument(context.path(instrument) if isinstance(instrument, str) else instrument)
    targets = tuple(
        _target(spec, f"{context.source}: target[{i}]", context, named)
        if spec.quantity is None
        else _texture_target(spec, f"{context.source}: target[{i}]", tool, (light.illuminants[0], light.observer))
        for i, spec in enumerate(specs)
    )
    _check_agreement(targets, light)
    _check_picture(targets, light, context)
    return targets


def check_light(light: LightSpec, context: RecipeContext) -> None:
    """Refuse unknown lamps and observers.

    Raises:
        RecipeError: with a suggestion.
    """
    for lamp in light.illuminants:
        if lamp not in ILLUMINANTS:
            hint = did_you_mean(lamp, ILLUMINANTS)
            raise RecipeError(
                f'{context.source}: light.illuminants: "{lamp}" is not known.{hint} Known: {", ".join(ILLUMINANTS)}'
            )
    if light.observer not in OBSERVERS:
        raise RecipeError(
            f'{context.source}: light.observer = "{light.observer}" is not known; known: {", ".join(OBSERVERS)}'
        )


def _target(spec: TargetEntry, key: str, context: RecipeContext, named: Mapping[str, Geometry] | None = None) -> Target:
    if spec.geometry is None:
        raise RecipeError(f"{key}.directions: a picture over directions needs heights in [parameters]")
    at = replace(Geometry.read(spec.geometry, f"{key}.geometry", named), polarisation=spec.polarisation)
    if at.polarisation != "both" and at.kind not in ("specular", "transmitted"):
        raise RecipeError(
            f'{key}.polarisation = "{at.polarisation}" has no effect on "{spec.geometry}"; only specular and '
            "transmitted targets have a polarisation"
        )
    request = {name: getattr(spec, name) for name in (*COLOURS, *RANGES) if getattr(spec, name) is not None}
    request = {name: list(value) if isinstance(value, tuple) else value for name, value in request.items()}
    fields: dict[str, Any] = {}
    if spec.colour is not None:
        fields["lab"] = srgb_to_lab(spec.colour, f"{key}.colour")
    elif spec.lab is not None:
        fields["lab"] = plausible(np.array(spec.lab), f"{key}.lab", spec.lab)
    elif spec.lch is not None:
        fields["lab"] = plausible(np.asarray(lch_to_lab(spec.lch)), f"{key}.lch", spec.lch)
    elif spec.xyz is not None or spec.xyy is not None:
        name = "xyz" if spec.xyz is not None else "xyy"
        xyz = spec.xyz or spec.xyy or (0.0, 0.0, 0.0)
        if min(xyz) < 0:
            raise RecipeError(f"{key}.{name} = {show_value(list(xyz))} holds a negative number")
        if name == "xyy" and (xyz[0] + xyz[1] > 1 or (xyz[1] == 0 and xyz[2] > 0)):
            raise RecipeError(f"{key}.xyy = {show_value(list(xyz))} is not a colour: y is above 0, x + y at most 1")
        luminance = xyz[1] if name == "xyz" else xyz[2]
        if at.kind != "aspecular" and luminance > MOST_LUMINANCE:
            where = f"{key}.{name} = {show_value(list(xyz))}"
            raise RecipeError(f"{where}: white has Y = 1, the maximum for {at.kind}; divide by 100")
        fields["xyz"] = np.array(xyz) if name == "xyz" else np.asarray(xyy_to_xyz(xyz))
    elif spec.image is not None:
        fields["image"] = read_picture(context.path(spec.image), f"{key}.image = {show_value(spec.image)}")
    elif spec.spectrum is not None:
        fields["spectrum"] = _spectrum(spec.spectrum, f"{key}.spectrum", at.kind, context)
    else:
        fields["ranges"] = _ranges(spec, key)
    return Target(at, request, spec.tolerance, spec.weight, key, **fields)


def plausible(lab: Array, where: str, value: Any) -> Array:
    """Return a CIELAB colour; refuse an impossible one.

    Raises:
        RecipeError: it is darker than black, or far outside the range of lobes.
    """
    if not 0.0 <= lab[0] <= MOST_LIGHTNESS or float(np.hypot(lab[1], lab[2])) > MOST_CHROMA:
        raise RecipeError(f"{where} = {show_value(list(value))} is not a colour: L* is 0 for black and 100 for white")
    return lab


def _texture_target(spec: TargetEntry, key: str, tool: Instrument, light: tuple[str, str]) -> Target:
    """Return the target for a texture value."""
    assert spec.quantity is not None
    at = TextureQuantity.named(spec.quantity, f"{key}.quantity", tool, light)
    if spec.polarisation != "both":
        raise RecipeError(f'{key}.polarisation = "{spec.polarisation}" has no effect on {at}; remove it')
    value = spec.value
    request = {"quantity": str(at), "value": list(value) if isinstance(value, tuple) else value}
    if isinstance(value, int | float):
        bounds: tuple[float | None, float | None] = (float(value), float(value))
    else:
        assert value is not None
        bounds = _bounds(value, f"{key}.value", '1.5, ">=1.5", "<=3" or [1.5, 3]')
    if not any(bounds) or bounds[1] == 0.0:
        raise RecipeError(f"{key}.value = {show_value(request['value'])} is not above 0; deviations are relative to it")
    return Target(at, request, spec.tolerance, spec.weight, key, texture=bounds)


def _bounds(text: str | tuple[float, float], where: str, forms: str) -> tuple[float | None, float | None]:
    """Return the ends of ">=40", "<=20" or (20, 40).

    Raises:
        RecipeError: another form, or the ends cross.
    """
    if isinstance(text, str):
        match = _BOUND.match(text)
        try:
            bound = float(match[2]) if match else float("nan")
        except ValueError:
            bound = float("nan")
        if match is None or not bound >= 0:
            raise RecipeError(f"{where} = {show_value(text)} cannot be read; write {forms}")
        return (bound, None) if match[1] == ">=" else (None, bound)
    low, high = text
    if not 0 <= low <= high:
        raise RecipeError(f"{where} = {show_value([low, high])} is not two ascending numbers of at least 0")
    return text


def _ranges(spec: TargetEntry, key: str) -> dict[str, tuple[float | None, float | None]]:
    ranges: dict[str, tuple[float | None, float | None]] = {}
    if spec.hue_deg is not None:
        if not all(-360.0 <= h <= 720.0 for h in spec.hue_deg):
            raise RecipeError(f"{key}.hue_deg = {show_value(list(spec.hue_deg))} should hold angles in degrees")
        ranges["hue"] = spec.hue_deg
    for name in ("chroma", "lightness"):
        value = getattr(spec, name)
        if value is not None:
            ranges[name] = _bounds(value, f"{key}.{name}", '">=40", "<=20" or [20, 40]')
    return ranges


def _spectrum(entry: FileSpec, where: str, kind: str, context: RecipeContext) -> Array:
    """Return a target spectrum `[2, wavelength]`: nm and factors.

    Args:
        kind: the geometry's kind; "transmitted" needs a transmittance, others a reflectance.
    """
    path = f"{where} = {show_value(entry.file)}"
    quantities = ("transmittance", "reflectance") if kind == "transmitted" else ("reflectance",)
    table = recipe_spectrum(context, where.removeprefix(f"{context.source}: "), entry, quantities)
    nm, values = np.round(table[:, 0], 3), table[:, 1]  # wavelengths of THz or eV are rounded in files
    low, high = float(nm[0]), float(nm[-1])
    if len(nm) < 2 or not LEAST_NM <= low < high <= MOST_NM:
        raise RecipeError(
            f"{path} holds wavelengths of {low:g} to {high:g} nm, which are not from {LEAST_NM:g} to {MOST_NM:g}; head "
            'the column "um" or "angstrom" if it holds those'
        )
    is_valid = (values >= -NOISE_FACTOR) & (values <= MOST_FACTOR)
    visible = (nm >= VISIBLE_NM[0]) & (nm <= VISIBLE_NM[1])
    if not is_valid.all() and visible.sum() > 1 and is_valid[visible].all():  # instruments are noisy at their ends
        logger.warning("%s: values outside of 0 to 1 beyond %g-%g nm are left out", path, *VISIBLE_NM)
        nm, values, is_valid = nm[visible], values[visible], is_valid[visible]
    if not is_valid.all():
        raise RecipeError(f"{path} should hold factors from 0 to 1; head a column in per cent '%'")
    return np.ascontiguousarray([nm, np.maximum(values, 0.0)])


def _check_agreement(targets: Sequence[Target], light: LightSpec) -> None:
    """Refuse two colours for one geometry that are further apart than their tolerances."""
    white = white_xyz(light.illuminants[0], light.observer)
    for i, target in enumerate(targets):
        for other in targets[:i]:
            own_lab, other_lab = target.target_lab(white), other.target_lab(white)
            if target.geometry != other.geometry or own_lab is None or other_lab is None:
                continue
            difference = float(delta_e_2000(other_lab, own_lab))
            if difference > target.tolerance + other.tolerance:
                raise RecipeError(
                    f'{target.key} and {other.key.rpartition(" ")[2]} give two colours at "{target.geometry}", dE00 '
                    f"{difference:.1f} apart; within {target.tolerance:g} and {other.tolerance:g} no answer has both"
                )


def _check_picture(targets: Sequence[Target], light: LightSpec, context: RecipeContext) -> None:
    """Refuse another target or lamp besides a picture."""
    for target in targets:
        if target.image is None:
            continue
        if len(targets) > 1 and any(other.image is None for other in targets):
            raise RecipeError(f"{target.key}.image: a picture is the only target; remove the other {len(targets) - 1}")
        if len(light.illuminants) > 1:
            lamps = show_value(light.illuminants)
            raise RecipeError(f"{context.source}: light.illuminants = {lamps}: a picture needs a single lamp")


def merit_function(
    targets: Sequence[Target], rows: Sequence[Geometry], light: LightSpec, wavelengths_nm: Array
) -> MeritFunction:
    """Return the merit function of all targets, for spectra `[..., row, wavelength]`."""
    goals = [goal for target in targets for goal in target.goals(rows.index(target.geometry), wavelengths_nm)]
    return MeritFunction(goals, tuple(light.illuminants), light.observer, wavelengths_nm)
