"""Schemas: target files (recipe, parameters, targets, light, tolerances, limits, budget), and paint formulations.

A formulation has a library of pigments and dyes, and a target file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import pydantic
from pydantic import Field

from nacre.measure.texture import QUANTITY_NAMES, Instrument
from nacre.optimise.relief.target import TargetTable
from nacre.readers.curves import FileSpec
from nacre.recipe.keys import ByPath
from nacre.recipe.model import NotNegative, Positive, RecipeModel
from nacre.recipe.path_tables import GeometrySpec, ParameterSpec, ToleranceSpec

Triple = tuple[float, float, float]
InstrumentKey = Annotated[
    str | Instrument,
    Field(
        description="lamp, camera and calibration of texture targets, a file or its keys", examples=["instrument.toml"]
    ),
]
Bounds = tuple[float, float]
# alternatives for the colour of a target; the ranges may be combined
COLOURS = ("colour", "lab", "lch", "xyz", "xyy", "spectrum", "image")
RANGES = ("hue_deg", "chroma", "lightness")
TEXTURE_TOLERANCE_PERCENT = 10.0  # default, about twice the error of a texture instrument
PAIR = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}


class TargetEntry(RecipeModel):
    """One target: a geometry, a colour or spectrum, and its tolerance."""

    one_of: ClassVar[tuple[str, ...]] = (*COLOURS, "|".join(RANGES), "directions", "quantity")
    forms: ClassVar[tuple[str, ...]] = (
        '{geometry = "specular 0", colour = "#c2185b", tolerance = 2.0}',
        '{geometry = "45as15", lab = [62, 30, -12]}',
        '{geometry = "specular 60", hue_deg = [350, 10], chroma = ">=30"}',
        '{geometry = "transmitted 0", spectrum = "filter.csv", tolerance = 1.0}',
        '{directions = {kind = "image", image = "grey.png", range = 0.4}}',
        '{geometry = "specular 0", image = "photo.png"}',
        '{quantity = "sparkle_45", value = 1.2, tolerance = 10}',
    )

    geometry: str | None = Field(
        default=None,
        description="geometry: specular T, transmitted T (into the substrate), diffuse T or hemispherical T, "
        "with T the angle of incidence in degrees; or IasA: light from I, viewer A degrees from the mirror direction "
        "towards the light; or a name of [[geometry]]",
        examples=["specular 0", "45as15"],
    )
    polarisation: Literal["s", "p", "left", "right", "both"] = Field(
        default="both",
        description="of the incident light, for specular and transmitted targets; both: unpolarised",
        examples=["left"],
    )
    colour: str | None = Field(default=None, description="target colour in sRGB, #rrggbb", examples=["#c2185b"])
    lab: Triple | None = Field(default=None, description="L*, a*, b* under every lamp", examples=[[41, 66, 14]])
    lch: Triple | None = Field(
        default=None, description="L*, C*, h in degrees under every lamp", examples=[[41, 67, 12]]
    )
    xyz: Triple | None = Field(
        default=None, description="X, Y, Z under the first lamp, white has Y = 1", examples=[[0.2, 0.12, 0.1]]
    )
    xyy: Triple | None = Field(
        default=None, description="x, y, Y under the first lamp, white has Y = 1", examples=[[0.48, 0.28, 0.12]]
    )
    spectrum: FileSpec | None = Field(
        default=None,
        description="CSV of wavelengths and target factors: nm and 0 to 1, or other units as in "
        "its heading; bands without rows (a step above 3 times the usual one) are not compared",
        examples=["filter.csv"],
    )
    image: str | None = Field(
        default=None,
        description="sRGB picture: each pixel is the target colour of its place on the surface, over which one or two "
        "parameters vary; it is the only target. With period and turn of a grating as parameters it becomes a hologram "
        "of one or two pictures",
        examples=["photo.png"],
    )
    light_azimuth_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = Field(
        default=0.0,
        description="for a hologram: azimuth of lamp and viewer about the normal, from u towards v",
        examples=[90],
    )
    hue_deg: Bounds | None = Field(
        default=None,
        description="range of the hue angle in degrees, upward from the first to the second; may cross 0",
        examples=[[350, 10]],
    )
    chroma: str | Bounds | None = Field(
        default=None, description="least or largest chroma, or both as a pair", examples=[">=40"]
    )
    lightness: str | Bounds | None = Field(
        default=None, description="least or largest lightness, or both as a pair", examples=["<=20"]
    )
    directions: TargetTable | None = Field(
        default=None,
        description="instead of geometry and colour: the picture that a relief shows over the directions",
        examples=[{"kind": "anti-mirror", "range": 0.5}],
    )
    quantity: str | None = Field(
        json_schema_extra={"enum": list(QUANTITY_NAMES)},
        default=None,
        description="instead of geometry and colour: sparkle, its intensity or area at a lamp angle in degrees, or "
        "graininess, of a pearl whose flakes have a diameter",
        examples=["sparkle_45"],
    )
    value: Positive | str | Bounds | None = Field(
        default=None,
        description='with quantity: the number, a bound such as ">=1.5", or both ends of a range',
        examples=[1.2],
    )
    tolerance: Positive = Field(
        default=1.0,
        description="allowed distance: dE00; for a spectrum the rms in per cent; for a quantity the deviation in per "
        f"cent of its value (default {TEXTURE_TOLERANCE_PERCENT:g})",
    )
    weight: Positive = Field(default=1.0, description="weight relative to the other targets")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _texture_tolerance(cls, data: Any) -> Any:
        is_texture = isinstance(data, Mapping) and "quantity" in data and "tolerance" not in data
        return {**data, "tolerance": TEXTURE_TOLERANCE_PERCENT} if is_texture else data

    @pydantic.field_validator("chroma", "lightness", mode="before")
    @classmethod
    def _bound(cls, value: Any) -> Any:
        if isinstance(value, int | float):
            raise ValueError(f'{value} needs a side; write ">={value}", "<={value}" or [low, high]')
        return value

    @pydantic.model_validator(mode="after")
    def _one_colour(self) -> TargetEntry:
        stated = [name for name in (*COLOURS, "directions", "quantity") if getattr(self, name) is not None]
        ranges = [name for name in RANGES if getattr(self, name) is not None]
        if len(stated) + bool(ranges) != 1:
            got = " and ".join([*stated, *ranges]) or "nothing"
            raise ValueError(
                f"gives {got}; a target has exactly one of {', '.join(COLOURS)}, quantity, or some of "
                f"{', '.join(RANGES)}"
            )
        if (self.quantity is None) != (self.value is None):
            raise ValueError(f"{'value' if self.value is None else 'quantity'} is missing; a texture target has both")
        if self.quantity is not None:
            if self.geometry is not None:
                raise ValueError(f"has quantity and geometry; {self.quantity} states the angle, remove geometry")
            return self
        if (self.geometry is None) == (self.directions is None):
            raise ValueError("has directions and geometry; keep one" if self.geometry else "geometry is missing")
        return self


class LightSpec(RecipeModel):
    """Lamps and observer of the target colours."""

    forms: ClassVar[tuple[str, ...]] = ('{illuminants = ["D65", "A"], observer = "10deg"}',)

    illuminants: Annotated[list[str], Field(min_length=1, max_length=16)] = Field(
        default=["D65"], description="lamps; colours are targets under each of them", examples=[["D65", "A"]]
    )
    observer: str = Field(
        json_schema_extra={"enum": ["2deg", "10deg"]}, default="10deg", description="observer of the colours"
    )


class LimitsSpec(RecipeModel):
    """Solution constraints."""

    forms: ClassVar[tuple[str, ...]] = (
        '{max_total_nm = 800, max_layers = "fewest"}',
        "{height_levels = 8, dither = false}",
        "{within_validity = true}",
    )

    max_total_nm: Positive | None = Field(
        default=None, description="largest total thickness of the layers", examples=[800]
    )
    max_layers: Literal["fewest"] | None = Field(
        default=None, description="fewest: of equally good stacks the one with fewest layers", examples=["fewest"]
    )
    height_levels: Annotated[int, Field(ge=2, le=256)] | None = Field(
        default=None,
        description="for a picture: number of values, evenly spaced over its bounds, that the process gives each "
        "parameter; colours between them are dithered",
        examples=[8],
    )
    dither: bool = Field(
        default=True,
        description="for a picture with height_levels: false gives each pixel the level of the nearest colour",
        examples=[False],
    )
    dot_um: Annotated[float, Field(ge=1.0, le=1000.0)] = Field(
        default=10.0, description="for a hologram: side of a dot", examples=[10]
    )
    within_validity: bool = Field(
        default=False,
        description="for a relief: heights stay within the validity of scalar diffraction",
        examples=[True],
    )


class SearchSpec(RecipeModel):
    """Budget of the search, number of solutions and seed."""

    forms: ClassVar[tuple[str, ...]] = (
        "{seconds = 60, solutions = 5, seed = 0}",
        "{evaluations = 2000, seconds = 600}",
    )

    evaluations: Positive | None = Field(
        default=None,
        description="largest number of evaluated candidates; default: set by the method. The same target, seed "
        "and evaluations give the same result on any machine unless `seconds` ends the search first",
        examples=[2000],
    )
    seconds: Positive = Field(
        default=60.0,
        description="time limit of the whole command; of a picture, if given, of the refinement of its palette",
    )
    solutions: Annotated[int, Field(ge=1, le=100)] = Field(default=5, description="largest number of solutions")
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(default=0, description="seed")


class LayersSpec(RecipeModel):
    """Whole-stack search: materials, layer count, thicknesses and substrates."""

    forms: ClassVar[tuple[str, ...]] = (
        '{palette = ["SiO2", "TiO2"], max_layers = 6, thickness_nm = [5, 250]}',
        '{palette = ["Cr", "MgF2"], thickness_nm = {Cr = [3, 20], other = [20, 600]}, substrate = ["Al", "Ag"]}',
    )

    palette: Annotated[list[Any], Field(min_length=1, max_length=64)] = Field(
        description="optical constants that a layer may have", examples=[["SiO2", "TiO2", "Cr"]]
    )
    max_layers: Annotated[int, Field(ge=1, le=200)] = Field(default=6, description="largest layer count")
    thickness_nm: Bounds | dict[str, Bounds] = Field(
        default=(5.0, 250.0),
        description="bounds of every layer, or of each material with `other` for the rest",
        examples=[[5, 250], {"Cr": [3, 20], "other": [20, 250]}],
    )
    substrate: Any = Field(
        default=None, description="substrate, or a list of alternatives; default: the substrate of the recipe"
    )


class DesignSpec(RecipeModel):
    """Target file of `nacre design`: targets, and the parameters or the stack that shall meet them."""

    example: ClassVar[Mapping[str, Any]] = {
        "recipe": {"family": "film", "substrate": "Al", "layers": []},
        "layers": {"palette": ["Cr", "MgF2"], "max_layers": 3, "thickness_nm": {"Cr": [3, 20], "other": [50, 600]}},
        "target": [
            {"geometry": "specular 0", "hue_deg": [320, 350], "chroma": ">=40"},
            {"geometry": "specular 60", "hue_deg": [140, 180], "chroma": ">=20"},
        ],
        "search": {"seconds": 30},
    }

    recipe: str | dict[str, Any] = Field(
        description="recipe to start from: its file, or the recipe as a table",
        examples=["start.toml", {"family": "film", "substrate": "Al", "layers": []}],
    )
    parameters: Annotated[dict[str, Any], ByPath(ParameterSpec, (PAIR,))] = Field(
        default={},
        description="path of a number or word of the recipe, with [*] for any index -> two numbers as bounds, "
        "or a table",
        examples=[{"layers[0].thickness_nm": [3, 15]}, {"layers[1].material": {"choices": ["SiO2", "MgF2"]}}],
    )
    layers: LayersSpec | None = Field(default=None, description="whole-stack search, instead of parameters of layers")
    target: Annotated[list[TargetEntry], Field(min_length=1, max_length=200)] = Field(
        description="targets, a list of tables"
    )
    instrument: InstrumentKey = Instrument()
    geometry: list[GeometrySpec] = Field(
        default=[],
        description="geometries by name for the targets, in addition to those of the recipe",
        examples=[[{"name": "door", "at": "45as60az125.3"}]],
    )
    light: LightSpec = Field(default=LightSpec(), description="lamps and observer")
    tolerance: Annotated[
        dict[str, Any], ByPath(ToleranceSpec, ({"type": "number", "minimum": 0}, {"type": "string", "pattern": "%?$"}))
    ] = Field(
        default={},
        description="manufacturing tolerances, for solutions of high yield: path, with [*] for any index -> a standard "
        "deviation, a percentage, or a table",
        examples=[{"layers[*].thickness_nm": {"percent": 2}}, {"layers[0].thickness_nm": 5}],
    )
    limits: LimitsSpec = Field(default=LimitsSpec(), description="solution constraints")
    search: SearchSpec = Field(default=SearchSpec(), description="budget, number of solutions, seed")


MOST_ANSWERS = 20
Fraction = Annotated[float, Field(ge=0.0, le=0.3)]


class ResinSpec(RecipeModel):
    """Price and density of the resin, dry."""

    forms: ClassVar[tuple[str, ...]] = ("{cost_per_kg = 4, density_kg_l = 1.1}",)

    cost_per_kg: NotNegative = Field(default=0.0, description="price of 1 kg")
    density_kg_l: Positive = Field(default=1.1, description="density in kg/l")


class IngredientSpec(RecipeModel):
    """Name, bounds, price and density of an ingredient."""

    name: str = Field(min_length=1, max_length=80, description="name", examples=["silver fine"])
    volume_fraction: tuple[Fraction, Fraction] = Field(
        description="bounds of the volume fraction in the dry stratum", examples=[[0, 0.03]]
    )
    cost_per_kg: NotNegative = Field(default=0.0, description="price of 1 kg", examples=[45])
    density_kg_l: Positive = Field(default=1.0, description="density in kg/l", examples=[3.1])

    @pydantic.model_validator(mode="after")
    def _ascending(self) -> IngredientSpec:
        low, high = self.volume_fraction
        if not low < high:
            raise ValueError(f"volume_fraction = [{low:g}, {high:g}]: the bounds cross")
        return self


class PigmentSpec(IngredientSpec):
    """A pigment of flakes."""

    forms: ClassVar[tuple[str, ...]] = (
        '{name = "silver", volume_fraction = [0, 0.03], cost_per_kg = 45, density_kg_l = 2.6, '
        'platelet = {coatings = [{material = "Al", thickness_nm = 60}]}}',
    )

    platelet: dict[str, Any] = Field(
        description="the flake, as an entry of [[strata.platelets]] without volume_fraction",
        examples=[{"coatings": [{"material": "Al", "thickness_nm": 60}]}],
    )


class DyeSpec(IngredientSpec):
    """A dissolved dye."""

    forms: ClassVar[tuple[str, ...]] = (
        '{name = "red", volume_fraction = [0, 0.02], cost_per_kg = 30, dye = {material = {n = 1.5, k = 0.02}}}',
    )

    dye: dict[str, Any] = Field(
        description="the dye, as strata.dye of a recipe without volume_fraction and radius_nm",
        examples=[{"material": {"n": 1.5, "k": 0.02}}],
    )


class LibrarySpec(RecipeModel):
    """Library of ingredients."""

    example: ClassVar[Mapping[str, Any]] = {
        "resin": {"cost_per_kg": 4, "density_kg_l": 1.1},
        "pigment": [
            {"name": "silver", "volume_fraction": [0, 0.03], "cost_per_kg": 45, "density_kg_l": 2.6,
             "platelet": {"coatings": [{"material": "Al", "thickness_nm": 60}]}}
        ],
        "dye": [{"name": "red", "volume_fraction": [0, 0.02], "cost_per_kg": 30, "dye": {"material": "Fe2O3"}}],
    }  # fmt: skip

    resin: ResinSpec = Field(default=ResinSpec(), description="price and density of the resin")
    pigment: Annotated[list[PigmentSpec], Field(max_length=64)] = Field(
        default=[], description="pigments", examples=[[]]
    )
    dye: Annotated[list[DyeSpec], Field(max_length=64)] = Field(default=[], description="dissolved dyes", examples=[[]])

    @pydantic.model_validator(mode="after")
    def _names(self) -> LibrarySpec:
        names = [entry.name for entry in (*self.pigment, *self.dye)]
        if not names:
            raise ValueError("the library is empty; add [[pigment]] or [[dye]]")
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f'the name "{name}" occurs twice')
        return self


class FormulationSearch(RecipeModel):
    """Search size."""

    forms: ClassVar[tuple[str, ...]] = ("{solutions = 3, seconds = 60, max_pigments = 2}",)

    max_pigments: Annotated[int, Field(ge=0, le=5)] = Field(
        default=2, description="largest number of pigments of a paint, beside at most one dye"
    )
    solutions: Annotated[int, Field(ge=1, le=MOST_ANSWERS)] = Field(
        default=3, description="number of solutions with different ingredients"
    )
    seconds: Positive = Field(default=120.0, description="time limit")
    evaluations: Positive | None = Field(
        default=None,
        description="limit of refined combinations in all stages; default: as many as the stages have. The same seed "
        "and evaluations give the same result on any machine unless `seconds` ends the search first",
        examples=[200],
    )
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(default=0, description="seed")


class FormulationSpec(RecipeModel):
    """Target file of `nacre formulate`: the paint without pigments, the library and the measured colours."""

    example: ClassVar[Mapping[str, Any]] = {
        "library": "pigments.toml",
        "recipe": {
            "family": "pearl", "base": {"albedo": 0.1}, "strata": [{"resin": {"n": 1.5}, "thickness_um": 40}]
        },
        "target": [{"geometry": "45as15", "lab": [62, 30, -12]}, {"geometry": "45as45", "lab": [31, 12, -8]}],
    }  # fmt: skip

    library: str | LibrarySpec = Field(
        description="file of the library, or the library as a table", examples=["pigments.toml"]
    )
    recipe: dict[str, Any] = Field(
        description="the pearl without pigments and dye: resin, thickness and base",
        examples=[{"family": "pearl", "strata": [{"resin": {"n": 1.5}, "thickness_um": 40}]}],
    )
    target: Annotated[list[TargetEntry], Field(min_length=1, max_length=200)] = Field(
        description="measured colours at aspecular geometries, and measured texture"
    )
    instrument: InstrumentKey = Instrument()
    geometry: list[GeometrySpec] = Field(
        default=[], description="geometries by name", examples=[[{"name": "door", "at": "45as60az125.3"}]]
    )
    light: LightSpec = Field(default=LightSpec(), description="lamps and observer")
    search: FormulationSearch = Field(default=FormulationSearch(), description="size of the search")
