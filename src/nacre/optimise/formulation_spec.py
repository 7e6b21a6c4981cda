"""Tables of a formulation: the library of pigments and dyes, and the target file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import pydantic

from nacre.measure.texture import Instrument
from nacre.optimise.spec import InstrumentKey, LightSpec, TargetEntry
from nacre.recipe.model import RecipeModel
from nacre.recipe.path_tables import GeometrySpec

MOST_ANSWERS = 20
Positive = Annotated[float, pydantic.Field(gt=0.0)]
Fraction = Annotated[float, pydantic.Field(ge=0.0, le=0.3)]


class ResinSpec(RecipeModel):
    """Price and density of the resin, dry."""

    forms: ClassVar[tuple[str, ...]] = ("{cost_per_kg = 4, density_kg_l = 1.1}",)

    cost_per_kg: Annotated[float, pydantic.Field(ge=0.0)] = pydantic.Field(default=0.0, description="price of 1 kg")
    density_kg_l: Positive = pydantic.Field(default=1.1, description="density in kg/l")


class IngredientSpec(RecipeModel):
    """Name, bounds, price and density of an ingredient."""

    name: str = pydantic.Field(min_length=1, max_length=80, description="name", examples=["silver fine"])
    volume_fraction: tuple[Fraction, Fraction] = pydantic.Field(
        description="bounds of the volume fraction in the dry stratum", examples=[[0, 0.03]]
    )
    cost_per_kg: Annotated[float, pydantic.Field(ge=0.0)] = pydantic.Field(
        default=0.0, description="price of 1 kg", examples=[45]
    )
    density_kg_l: Positive = pydantic.Field(default=1.0, description="density in kg/l", examples=[3.1])

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

    platelet: dict[str, Any] = pydantic.Field(
        description="the flake, as an entry of [[strata.platelets]] without volume_fraction",
        examples=[{"coatings": [{"material": "Al", "thickness_nm": 60}]}],
    )


class DyeSpec(IngredientSpec):
    """A dissolved dye."""

    forms: ClassVar[tuple[str, ...]] = (
        '{name = "red", volume_fraction = [0, 0.02], cost_per_kg = 30, dye = {material = {n = 1.5, k = 0.02}}}',
    )

    dye: dict[str, Any] = pydantic.Field(
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

    resin: ResinSpec = pydantic.Field(default=ResinSpec(), description="price and density of the resin")
    pigment: Annotated[list[PigmentSpec], pydantic.Field(max_length=64)] = pydantic.Field(
        default=[], description="pigments", examples=[[]]
    )
    dye: Annotated[list[DyeSpec], pydantic.Field(max_length=64)] = pydantic.Field(
        default=[], description="dissolved dyes", examples=[[]]
    )

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

    max_pigments: Annotated[int, pydantic.Field(ge=0, le=5)] = pydantic.Field(
        default=2, description="largest number of pigments of a paint, beside at most one dye"
    )
    solutions: Annotated[int, pydantic.Field(ge=1, le=MOST_ANSWERS)] = pydantic.Field(
        default=3, description="number of answers, of different ingredients"
    )
    seconds: Positive = pydantic.Field(default=120.0, description="time limit")
    evaluations: Positive | None = pydantic.Field(
        default=None,
        description="limit of refined combinations in all stages; default: as many as the stages have. The same seed "
        "and evaluations give the same result on any machine unless `seconds` ends the search first",
        examples=[200],
    )
    seed: Annotated[int, pydantic.Field(ge=0, le=2**32 - 1)] = pydantic.Field(default=0, description="seed")


class FormulationSpec(RecipeModel):
    """Target file of `nacre formulate`: the paint without pigments, the library and the measured colours."""

    example: ClassVar[Mapping[str, Any]] = {
        "library": "pigments.toml",
        "recipe": {
            "family": "pearl", "base": {"albedo": 0.1}, "strata": [{"resin": {"n": 1.5}, "thickness_um": 40}]
        },
        "target": [{"geometry": "45as15", "lab": [62, 30, -12]}, {"geometry": "45as45", "lab": [31, 12, -8]}],
    }  # fmt: skip

    library: str | LibrarySpec = pydantic.Field(
        description="file of the library, or the library as a table", examples=["pigments.toml"]
    )
    recipe: dict[str, Any] = pydantic.Field(
        description="the pearl without pigments and dye: resin, thickness and base",
        examples=[{"family": "pearl", "strata": [{"resin": {"n": 1.5}, "thickness_um": 40}]}],
    )
    target: Annotated[list[TargetEntry], pydantic.Field(min_length=1, max_length=200)] = pydantic.Field(
        description="measured colours at aspecular geometries, and measured texture"
    )
    instrument: InstrumentKey = Instrument()
    geometry: list[GeometrySpec] = pydantic.Field(
        default=[], description="geometries by name", examples=[[{"name": "door", "at": "45as60az125.3"}]]
    )
    light: LightSpec = pydantic.Field(default=LightSpec(), description="lamps and observer")
    search: FormulationSearch = pydantic.Field(default=FormulationSearch(), description="size of the search")
