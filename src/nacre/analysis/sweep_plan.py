"""Sweep files: the recipe, the points and their order, and the quantities to store."""

import contextlib
import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nacre.analysis.ties import tied_maker
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.texture import refuse_place
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError, did_you_mean
from nacre.core.files import read_text
from nacre.core.machine import check_memory
from nacre.light import ILLUMINANTS, OBSERVERS, lab_to_xyz, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.material.material import Material, load
from nacre.measure.colours import colour_spectrum, geometry_colours, recipe_geometries
from nacre.measure.geometry import Geometry
from nacre.measure.texture import TextureQuantity, check_texture, texture_values
from nacre.recipe.fingerprint import fingerprint
from nacre.recipe.keys import ByPath
from nacre.recipe.model import RecipeContext, RecipeModel, show_value, validate
from nacre.recipe.path_tables import by_path
from nacre.recipe.toml import parse_toml

MAX_POINTS = 10_000_000
MAX_AXES = 12
BYTES_PER_POINT = 200
AXIS_KEYS = {"values", "start", "stop", "low", "high"}
MODES = ("grid", "random", "sobol")


class AxisSpec(RecipeModel):
    """The values of one number: a list or an interval.

    `read_points` reads and validates an axis; this model serves the key reference.
    """

    values: list[Any] | None = Field(default=None, description="a list of values", examples=[[100, 200, 400]])
    start: float | None = Field(default=None, description="first value of the interval", examples=[100])
    stop: float | None = Field(default=None, description="last value of the interval", examples=[600])
    count: int | None = Field(
        default=None, ge=1, le=MAX_POINTS, description="number of values, both ends included", examples=[51]
    )
    step: float | None = Field(default=None, gt=0.0, description="in place of count: the step", examples=[10])
    low: float | None = Field(
        default=None, description="lower end of a random or sobol sweep's interval", examples=[0.01]
    )
    high: float | None = Field(
        default=None, description="upper end of a random or sobol sweep's interval", examples=[0.3]
    )
    log: bool = Field(default=False, description="spread the values evenly in the logarithm", examples=[True])


@dataclass(frozen=True)
class Axis:
    """One recipe number of a sweep.

    Attributes:
        path: recipe path, such as `layers[0].thickness_nm`.
        values: values of a grid axis (numbers or words), or None for an interval.
        low, high: interval of a random or Sobol axis.
        is_logarithmic: whether the logarithm is distributed evenly.
    """

    path: str
    values: tuple[Any, ...] | None = None
    low: float = 0.0
    high: float = 1.0
    is_logarithmic: bool = False

    def at(self, fraction: float) -> Any:
        """Return the value at a fraction in [0, 1) of the axis."""
        if self.values is not None:
            return self.values[min(int(fraction * len(self.values)), len(self.values) - 1)]
        if self.is_logarithmic:
            return math.exp(math.log(self.low) + fraction * (math.log(self.high) - math.log(self.low)))
        return self.low + fraction * (self.high - self.low)


@dataclass(frozen=True)
class Points:
    """The numbered sweep points; the last axis of a grid varies fastest.

    Attributes:
        axes: the varied numbers.
        mode: "grid", "random" or "sobol".
        count: point count.
        fractions: `[point, axis]` in [0, 1) for random and Sobol points, None for a grid.
    """

    axes: tuple[Axis, ...]
    mode: str
    count: int
    fractions: NDArray[np.float64] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the result: one dimension per axis of a grid, otherwise one for the points."""
        if self.mode == "grid":
            return tuple(len(axis.values or ()) for axis in self.axes)
        return (self.count,)

    def changes(self, number: int) -> dict[str, Any]:
        """Return the recipe changes of one point."""
        if self.fractions is not None:
            return {axis.path: axis.at(float(f)) for axis, f in zip(self.axes, self.fractions[number], strict=True)}
        place = np.unravel_index(number, self.shape)
        return {axis.path: (axis.values or ())[int(i)] for axis, i in zip(self.axes, place, strict=True)}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self.changes(i) for i in range(self.count))


def point_seed(changes: Mapping[str, Any]) -> int:
    """Return a point's seed: a hash of its parameters, independent of order and worker."""
    text = json.dumps(changes, sort_keys=True, default=float)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def read_points(axes: Mapping[str, Any], mode: str, count: int, seed: int, source: str) -> Points:
    """Build the points from the `[axes]` table of a sweep file.

    Each axis is a list of values, or a table: {values = [...]}, {start, stop, count} (both ends included),
    {start, stop, step}, or, for random and Sobol sweeps, {low, high}; `log = true` spaces evenly in the logarithm.

    Raises:
        RecipeError: naming the axis and the allowed values.
    """
    if not isinstance(axes, Mapping) or not axes:
        raise RecipeError(f"{source}: axes is empty; give at least one recipe number to vary")
    if len(axes) > MAX_AXES:
        raise RecipeError(f"{source}: axes has {len(axes)} entries; at most {MAX_AXES} are allowed")
    if mode not in MODES:
        raise RecipeError(f'{source}: mode = "{mode}" is not known; modes: {", ".join(MODES)}')
    named = by_path(axes, AXIS_KEYS, source, "axes")
    parsed = tuple(_read_axis(path, value, mode, source) for path, value in named.items())
    if mode == "grid":
        total = math.prod(len(axis.values or ()) for axis in parsed)
        if total > MAX_POINTS:
            raise RecipeError(f"{source}: the grid has {total} points; at most {MAX_POINTS} are allowed")
        _check_memory(source, total, len(parsed))
        return Points(parsed, mode, total)
    if not 1 <= count <= MAX_POINTS:
        raise RecipeError(f"{source}: count = {count} must lie in [1, {MAX_POINTS}]")
    _check_memory(source, count, len(parsed))
    if mode == "random":
        fractions = np.random.default_rng(seed).random((count, len(parsed)))
    else:
        from scipy.stats import qmc

        power = max(0, math.ceil(math.log2(count)))
        fractions = qmc.Sobol(len(parsed), scramble=True, seed=seed).random_base2(power)[:count]
    return Points(parsed, mode, count, fractions)


def _check_memory(source: str, count: int, axes: int) -> None:
    check_memory(float(BYTES_PER_POINT + 16 * axes) * count, f"{source}: a sweep of {count} points")


def _read_axis(path: str, value: Any, mode: str, source: str) -> Axis:
    key = f'axes."{path}"'
    if isinstance(value, list):
        value = {"values": value}
    if not isinstance(value, Mapping):
        raise RecipeError(f"{source}: {key} = {show_value(value)} should be a list or a table {{start, stop, count}}")
    unknown = set(value) - set(AxisSpec.model_fields)
    if unknown:
        allowed = "values, start, stop, count, step, log"
        raise RecipeError(f"{source}: {key}.{sorted(unknown)[0]} is not known; use {allowed}")
    if "values" in value:
        values = value["values"]
        if not isinstance(values, list) or not values or len(values) > MAX_POINTS:
            raise RecipeError(f"{source}: {key}.values should be a list with at least one value")
        if any(isinstance(v, float) and not math.isfinite(v) for v in values):
            raise RecipeError(f"{source}: {key}.values holds a number that is not finite")
        return Axis(path, tuple(values))
    low, high = value.get("start", value.get("low")), value.get("stop", value.get("high"))
    for name, number in (("start", low), ("stop", high)):
        if not isinstance(number, int | float) or isinstance(number, bool) or not math.isfinite(number):
            raise RecipeError(f"{source}: {key}.{name} = {show_value(number)} should be a finite number")
    assert isinstance(low, int | float) and isinstance(high, int | float)
    logarithmic = bool(value.get("log", False))
    if logarithmic and not (low > 0 and high > 0):
        raise RecipeError(f"{source}: {key} is logarithmic, so start and stop must be above 0")
    if mode != "grid":
        return Axis(path, None, float(low), float(high), logarithmic)
    return Axis(path, _grid_values(float(low), float(high), value, logarithmic, f"{source}: {key}"))


def _grid_values(low: float, high: float, value: Mapping[str, Any], logarithmic: bool, where: str) -> tuple[float, ...]:
    if "count" in value:
        count = value["count"]
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MAX_POINTS:
            raise RecipeError(f"{where}.count = {show_value(count)} should be a whole number in [1, {MAX_POINTS}]")
        grid = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
        return tuple(float(v) for v in grid)
    step = value.get("step")
    if not isinstance(step, int | float) or isinstance(step, bool) or not step > 0 or high < low:
        raise RecipeError(f"{where} needs count, or a step above 0 from start up to stop")
    count = int((high - low) / step + 1e-9) + 1
    if count > MAX_POINTS:
        raise RecipeError(f"{where} has {count} values; at most {MAX_POINTS} are allowed")
    return tuple(low + step * i for i in range(count))


AT_GEOMETRIES = "geometries"  # colours at named geometries, beside the parts of spectra
PARTS = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")


@dataclass(frozen=True)
class Measurement:
    """The quantities that a sweep stores of each point.

    Attributes:
        angles_deg: incidence angles in the ambient medium.
        illuminant, observer: for the colours.
        wavelengths_nm: grid of stored spectra, or None to store colours only.
        parts: parts of the spectrum.
        geometries: (name, geometry) at which colours are stored as well.
        texture: quantities of texture, such as "sparkle_45".
    """

    angles_deg: tuple[float, ...] = (0.0, 15.0, 30.0, 45.0, 60.0)
    illuminant: str = "D65"
    observer: str = "10deg"
    wavelengths_nm: tuple[float, ...] | None = None
    parts: tuple[str, ...] = ("specular_reflectance",)
    geometries: tuple[tuple[str, str], ...] = ()
    texture: tuple[str, ...] = ()

    def layout(self) -> dict[str, tuple[tuple[str, ...], tuple[int, ...]]]:
        """Return a point's arrays: name -> (dimension names, shape)."""
        angles = len(self.angles_deg)
        arrays: dict[str, tuple[tuple[str, ...], tuple[int, ...]]] = {}
        for part in self.parts:
            arrays[f"lab_{part}"] = (("angle_deg", "lab"), (angles, 3))
            arrays[f"xyz_{part}"] = (("angle_deg", "xyz"), (angles, 3))
            if self.wavelengths_nm is not None:
                arrays[part] = (("angle_deg", "wavelength_nm"), (angles, len(self.wavelengths_nm)))
        if self.geometries:
            for space in ("lab", "xyz"):
                arrays[f"{space}_{AT_GEOMETRIES}"] = (("geometry", space), (len(self.geometries), 3))
        if self.texture:
            arrays |= {name: (("quantity",), (len(self.texture),)) for name in ("texture", "texture_error")}
        return arrays

    def take(self, material: Material, seed: int) -> dict[str, Array]:
        """Return the arrays of one material; `seed` is that of random walks.

        Raises:
            NacreError: the material cannot be computed.
        """
        theta = np.radians(self.angles_deg)
        # on the material's grid with the lines of a narrow-band lamp
        colours, stored = colour_spectrum(material, theta, self.illuminant, seed), None
        if self.wavelengths_nm is not None:
            stored = material.spectrum(theta, np.asarray(self.wavelengths_nm), seed=seed)
        white = white_xyz(self.illuminant, self.observer)
        arrays: dict[str, Array] = {}
        for part in self.parts:
            xyz = spectrum_to_xyz(_part(colours, part), colours.wavelengths_nm, self.illuminant, self.observer)
            arrays[f"xyz_{part}"] = xyz
            arrays[f"lab_{part}"] = xyz_to_lab(xyz, white)
            if stored is not None:
                arrays[part] = _part(stored, part)
        if self.geometries:
            rows = [Geometry.read(at, name) for name, at in self.geometries]
            lab = geometry_colours(material, rows, self.illuminant, self.observer, seed=seed)
            arrays[f"lab_{AT_GEOMETRIES}"], arrays[f"xyz_{AT_GEOMETRIES}"] = lab, np.asarray(lab_to_xyz(lab, white))
        if self.texture:
            light = (self.illuminant, self.observer)
            quantities = [TextureQuantity.named(name, "measure.texture", light=light) for name in self.texture]
            arrays["texture"], arrays["texture_error"] = texture_values(material, quantities, seed)
        return arrays


def _part(spectrum: Spectrum, name: str) -> Array:
    """Return a part of a spectrum, or zeros if the material lacks such a part."""
    values = spectrum.parts().get(name)
    return np.zeros((len(spectrum.angles_deg), len(spectrum.wavelengths_nm))) if values is None else values


def measurement_from(data: dict[str, Any]) -> Measurement:
    """Rebuild a measurement from the dictionary sent to a worker."""
    fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data.items()}
    fields["geometries"] = tuple((name, at) for name, at in fields["geometries"])
    return Measurement(**fields)


class MeasureSpec(RecipeModel):
    """The `[measure]` table: the quantities to store of each point."""

    forms: ClassVar[tuple[str, ...]] = ('{angles_deg = [0, 45], illuminant = "A", parts = ["specular_reflectance"]}',)

    angles_deg: list[float] = Field(default=[0.0, 15.0, 30.0, 45.0, 60.0], description="angles of incidence")
    illuminant: str = Field(default="D65", description="illuminant of the colours, such as D65 or A")
    observer: str = Field(
        json_schema_extra={"enum": ["2deg", "10deg"]},
        default="10deg",
        description="observer of the colours: 2deg or 10deg",
    )
    wavelengths_nm: list[float] | None = Field(
        default=None,
        description="ascending grid of wavelengths; chosen by the material if not given",
        examples=[[400, 500, 600, 700]],
    )
    parts: list[str] | None = Field(
        default=None,
        description="parts of the spectrum to store, such as specular_reflectance; chosen by the material if not given",
        examples=[["specular_reflectance"]],
    )
    geometries: list[str] | None = Field(
        default=None,
        description="geometries at which colours are stored as well, or names of the recipe's [[geometry]]; default: "
        "all of these names",
        examples=[["45as15", "45as110", "door"]],
    )
    texture: list[str] = Field(
        default=[],
        description="numbers of texture to store, of a pearl whose flakes have a diameter: sparkle_15, intensity_45, "
        "area_75, graininess",
        examples=[["sparkle_45", "graininess"]],
    )


class SweepSpec(RecipeModel):
    """A sweep file: recipe, axes, sampling and stored quantities."""

    recipe: str = Field(description="file of the recipe to vary", examples=["film.toml"])
    axes: Annotated[dict[str, Any], ByPath(AxisSpec, ({"type": "array"},))] = Field(
        description="path of a number of the recipe -> a list of values, or a table with start, stop and "
        "count (or step), or low and high, and log",
        examples=[{"layers[0].thickness_nm": {"start": 100, "stop": 600, "count": 51}}, {"substrate": ["Si", "Al"]}],
    )
    mode: str = Field(
        json_schema_extra={"enum": list(MODES)},
        default="grid",
        description="how the axes are filled: grid, random or sobol",
    )
    count: int = Field(default=256, description="number of points of random and sobol sweeps")
    seed: int = Field(default=0, description="seed of the points")
    measure: MeasureSpec = Field(default=MeasureSpec(), description="the quantities to store of each point")


@dataclass(frozen=True)
class Sweep:
    """A validated sweep: material, points and measurement."""

    material: Material
    points: Points
    measurement: Measurement
    source: str
    files: Mapping[str, str]  # digests of the dependencies of all points, by name

    @property
    def fingerprint(self) -> str:
        """A hash of everything that determines the results; a store with another fingerprint is refused."""
        axes = [[a.path, a.values, a.low, a.high, a.is_logarithmic] for a in self.points.axes]
        fractions = (
            None if self.points.fractions is None else hashlib.sha256(self.points.fractions.tobytes()).hexdigest()
        )
        ties = self.material.data.get("ties")
        return fingerprint(
            self.material.fingerprint, self.files, axes=axes, fractions=fractions, mode=self.points.mode,
            measurement={key: value for key, value in asdict(self.measurement).items() if key != "texture" or value},
            **({"ties": ties} if ties else {}),
        )  # fmt: skip


def load_sweep(path: str | Path) -> Sweep:
    """Read a sweep file; every axis must exist in the recipe, and the first point must be valid.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
    """
    path = Path(path)
    text = read_text(path, "sweep")
    context = RecipeContext(str(path), path.parent.resolve(), text)
    spec: SweepSpec = validate(SweepSpec, parse_toml(text, str(path)), context)
    material = load(path.parent / spec.recipe).at_low_fidelity()
    points = read_points(spec.axes, spec.mode, spec.count, spec.seed, str(path))
    measurement = _measurement(spec.measure, material, str(path))
    try:
        first = tied_maker(material, [axis.path for axis in points.axes])(points.changes(0))
    except NacreError as error:
        # failures of later points are recorded; a failure of the first one indicates a typing error
        raise RecipeError(f"{path}: the first point cannot be built: {error}") from None
    refuse_place(first.model, f"{path}: sweep")
    return Sweep(material, points, measurement, str(path), _files(material, points))


def _files(material: Material, points: Points) -> dict[str, str]:
    """Return the digests of the recipe's files and of the axes."""
    files = dict(material.context.files)
    for axis in points.axes:
        for value in axis.values or ():
            if not isinstance(value, int | float):
                # an invalid value is reported as a failed point
                with contextlib.suppress(NacreError):
                    files |= material.vary({axis.path: value}).context.files
    return files


def _measurement(spec: MeasureSpec, material: Material, source: str) -> Measurement:
    for key, value, allowed in (("illuminant", spec.illuminant, ILLUMINANTS), ("observer", spec.observer, OBSERVERS)):
        if value not in allowed:
            hint = did_you_mean(value, allowed)
            raise RecipeError(f'{source}: measure.{key} = "{value}" is not known.{hint} Known: {", ".join(allowed)}')
    if not spec.angles_deg or not all(0 <= a <= 90 for a in spec.angles_deg):
        raise RecipeError(f"{source}: measure.angles_deg must hold angles in [0, 90]")
    parts = list(material.model.traits.default_parts) if spec.parts is None else spec.parts
    for part in parts:
        if part not in PARTS:
            hint = did_you_mean(part, PARTS)
            raise RecipeError(f'{source}: measure.parts: "{part}" is not known.{hint} Parts: {", ".join(PARTS)}')
    grid = spec.wavelengths_nm
    if grid is not None and (len(grid) < 2 or min(grid) <= 0 or any(b <= a for a, b in zip(grid, grid[1:]))):
        raise RecipeError(f"{source}: measure.wavelengths_nm must be positive and ascending, at least two")
    named = recipe_geometries(material)
    requested = list(named) if spec.geometries is None else spec.geometries
    geometries = tuple((name, str(Geometry.read(name, f"{source}: measure.geometries", named))) for name in requested)
    for name in spec.texture:
        TextureQuantity.named(name, f"{source}: measure.texture")
    if spec.texture:
        check_texture(material, f"{source}: measure.texture")
    return Measurement(
        tuple(spec.angles_deg), spec.illuminant, spec.observer, None if grid is None else tuple(grid), tuple(parts),
        geometries, tuple(spec.texture),
    )  # fmt: skip
