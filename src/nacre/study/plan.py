"""What a sweep computes: its recipe, its points, and what is kept of each."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pydantic

from nacre.bsdf.texture import refuse_place
from nacre.errors import NacreError, RecipeError
from nacre.files import read_text
from nacre.materials.material import Material, load
from nacre.recipe.identity import identity
from nacre.recipe.keys import ByPath
from nacre.recipe.model import RecipeContext, RecipeModel, validate
from nacre.recipe.toml import parse_toml
from nacre.study.sweep_points import MODES, AxisSpec, Points, read_points
from nacre.study.sweep_values import PARTS, Measurement


class MeasureSpec(RecipeModel):
    """The `[measure]` table: what is stored of each point."""

    forms: ClassVar[tuple[str, ...]] = ('{angles_deg = [0, 45], illuminant = "A", parts = ["specular_reflectance"]}',)

    angles_deg: list[float] = pydantic.Field(default=[0.0, 15.0, 30.0, 45.0, 60.0], description="angles of incidence")
    illuminant: str = pydantic.Field(default="D65", description="illuminant of the colours, such as D65 or A")
    observer: str = pydantic.Field(
        json_schema_extra={"enum": ["2deg", "10deg"]},
        default="10deg",
        description="observer of the colours: 2deg or 10deg",
    )
    wavelengths_nm: list[float] | None = pydantic.Field(
        default=None,
        description="ascending grid of wavelengths; chosen by the material if not given",
        examples=[[400, 500, 600, 700]],
    )
    parts: list[str] | None = pydantic.Field(
        default=None,
        description="parts of the spectrum to store, such as specular_reflectance; chosen by the material if not given",
        examples=[["specular_reflectance"]],
    )


class SweepSpec(RecipeModel):
    """A sweep file: a recipe, the axes, how to fill them, what to measure."""

    example: ClassVar[Mapping[str, Any]] = {
        "recipe": "film.toml",
        "axes": {"layers[0].thickness_nm": {"start": 100, "stop": 600, "count": 51}},
    }

    recipe: str = pydantic.Field(description="file of the recipe to vary", examples=["film.toml"])
    axes: Annotated[dict[str, Any], ByPath(AxisSpec, ({"type": "array"},))] = pydantic.Field(
        description="path of a number of the recipe -> a list of values, or a table with start, stop and "
        "count (or step), or low and high, and log",
        examples=[{"layers[0].thickness_nm": {"start": 100, "stop": 600, "count": 51}}, {"substrate": ["Si", "Al"]}],
    )
    mode: str = pydantic.Field(
        json_schema_extra={"enum": list(MODES)},
        default="grid",
        description="how the axes are filled: grid, random or sobol",
    )
    count: int = pydantic.Field(default=256, description="number of points of random and sobol sweeps")
    seed: int = pydantic.Field(default=0, description="seed of the points")
    measure: MeasureSpec = pydantic.Field(default=MeasureSpec(), description="what is stored of each point")


@dataclass(frozen=True)
class Sweep:
    """A checked sweep: the material, its points and the measurement of each."""

    material: Material
    points: Points
    measurement: Measurement
    source: str
    files: Mapping[str, str]  # digests of the files that any of the points reaches, by name

    @property
    def identity(self) -> str:
        """A hash of everything that decides the results; a store of another identity is refused."""
        axes = [[a.path, a.values, a.low, a.high, a.is_logarithmic] for a in self.points.axes]
        fractions = (
            None if self.points.fractions is None else hashlib.sha256(self.points.fractions.tobytes()).hexdigest()
        )
        return identity(
            self.material.identity, self.files, axes=axes, fractions=fractions, mode=self.points.mode,
            measurement=asdict(self.measurement),
        )  # fmt: skip


def load_sweep(path: str | Path) -> Sweep:
    """Read and check a sweep file; every axis must exist in the recipe and its first point must build.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
    """
    path = Path(path)
    text = read_text(path, "sweep")
    context = RecipeContext(str(path), path.parent.resolve(), text)
    spec: SweepSpec = validate(SweepSpec, parse_toml(text, str(path)), context)
    material = load(path.parent / spec.recipe).for_many()
    points = read_points(spec.axes, spec.mode, spec.count, spec.seed, str(path))
    measurement = _measurement(spec.measure, material, str(path))
    try:
        first = material.vary(points.changes(0))
    except NacreError as error:
        # a later point may fail and is recorded; when the first one does, the sweep is probably mistyped
        raise RecipeError(f"{path}: the first point cannot be built: {error}") from None
    refuse_place(first.model, f"{path}: sweep")
    return Sweep(material, points, measurement, str(path), _files(material, points))


def _files(material: Material, points: Points) -> dict[str, str]:
    """Return the digests of the recipe's files, and of those that an axis names in its place."""
    files = dict(material.context.files)
    for axis in points.axes:
        for value in axis.values or ():
            if not isinstance(value, int | float):
                # a value that cannot be built is a point that fails, which its own run tells
                with contextlib.suppress(NacreError):
                    files |= material.vary({axis.path: value}).context.files
    return files


def _measurement(spec: MeasureSpec, material: Material, source: str) -> Measurement:
    from nacre.errors import did_you_mean
    from nacre.light import ILLUMINANTS, OBSERVERS

    for key, value, allowed in (("illuminant", spec.illuminant, ILLUMINANTS), ("observer", spec.observer, OBSERVERS)):
        if value not in allowed:
            hint = did_you_mean(value, allowed)
            raise RecipeError(f'{source}: measure.{key} = "{value}" is not known.{hint} Known: {", ".join(allowed)}')
    if not spec.angles_deg or not all(0 <= a <= 90 for a in spec.angles_deg):
        raise RecipeError(f"{source}: measure.angles_deg must hold angles in [0, 90]")
    parts = spec.parts
    if parts is None:
        parts = list(material.model.usual_parts)
    for part in parts:
        if part not in PARTS:
            hint = did_you_mean(part, PARTS)
            raise RecipeError(f'{source}: measure.parts: "{part}" is not known.{hint} Parts: {", ".join(PARTS)}')
    grid = spec.wavelengths_nm
    if grid is not None and (len(grid) < 2 or min(grid) <= 0 or any(b <= a for a, b in zip(grid, grid[1:]))):
        raise RecipeError(f"{source}: measure.wavelengths_nm must be positive and ascending, at least two")
    return Measurement(
        tuple(spec.angles_deg), spec.illuminant, spec.observer, None if grid is None else tuple(grid), tuple(parts)
    )
