"""The keys of a flake: its layers, how thick they are, how many flakes there are and how they lie."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from nacre.errors import NacreError
from nacre.families.pearl.material import NO_SPREAD
from nacre.families.pearl.medium import FlakeNormals, rotation_matrix
from nacre.families.pearl.platelet import Coating, Platelet
from nacre.families.pearl.strata import Flakes
from nacre.families.pearl.thickness import Thickness
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.columns import two_columns
from nacre.recipe.model import RecipeContext, RecipeModel, show_value

MAX_COATINGS = 20
MAX_FRACTION = 0.3  # beyond, flakes no longer lie independently of each other

Positive = Annotated[float, pydantic.Field(gt=0.0)]
NotNegative = Annotated[float, pydantic.Field(ge=0.0)]


def _deviation(value: Any) -> Any:
    numbers = value if isinstance(value, list | tuple) else [value]
    if len(numbers) not in (1, 2) or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
        raise ValueError(f"= {show_value(value)} is not a deviation; write one number or [x, y]")
    if not all(NO_SPREAD <= v <= 1.0 for v in numbers):
        raise ValueError(f"= {show_value(value)} is not allowed; it should be in [{NO_SPREAD:g}, 1]")
    return value


Spread = Annotated[float, pydantic.Field(ge=NO_SPREAD, le=1.0)]
Deviation = Annotated[
    Spread | Annotated[tuple[Spread, ...], pydantic.Field(min_length=1, max_length=2)],
    pydantic.BeforeValidator(_deviation),
]


class ThicknessKeys(RecipeModel):
    """A thickness and how it varies over the flakes."""

    one_of: ClassVar[tuple[str, ...]] = ("thickness_nm", "histogram")

    thickness_nm: Annotated[float, pydantic.Field(ge=0.0, le=1e5)] | None = pydantic.Field(
        default=None, description="geometric thickness, the mean over the flakes", examples=[120]
    )
    deviation_nm: Annotated[float, pydantic.Field(ge=0.0, le=1e5)] = pydantic.Field(
        default=0.0, description="standard deviation of the thickness over the flakes", examples=[10]
    )
    distribution: Literal["gaussian", "truncated", "lognormal"] = pydantic.Field(
        default="gaussian", description="shape of that spread"
    )
    min_nm: NotNegative = pydantic.Field(default=0.0, description="lower bound of a truncated spread", examples=[80])
    max_nm: Positive | None = pydantic.Field(
        default=None, description="upper bound of a truncated spread", examples=[160]
    )
    histogram: str | None = pydantic.Field(
        default=None,
        description="in place of thickness_nm: a file of two columns: thickness in nm; share, per cent or count",
        examples=["thickness.csv"],
    )

    @pydantic.model_validator(mode="after")
    def _one_form(self) -> ThicknessKeys:
        if (self.histogram is None) == (self.thickness_nm is None):
            raise ValueError("give thickness_nm (with deviation_nm), or histogram, a file of two columns")
        if self.histogram is not None and self.deviation_nm > 0:
            raise ValueError("deviation_nm has no meaning beside histogram; keep one of the two")
        if self.distribution != "truncated" and (self.min_nm > 0 or self.max_nm is not None):
            raise ValueError('min_nm and max_nm belong to distribution = "truncated"')
        return self

    def thickness(self, context: RecipeContext, key: str) -> Thickness:
        """Return the distribution.

        Raises:
            RecipeError: the histogram cannot be read or does not sum to 1; bounds that hold nothing.
        """
        try:
            if self.histogram is not None:
                table = two_columns(context, f"{key}.histogram", self.histogram)
                return Thickness.from_histogram(table[:, 0], _shares(table[:, 1]))
            high = np.inf if self.max_nm is None else self.max_nm
            assert self.thickness_nm is not None
            return Thickness(self.thickness_nm, self.deviation_nm, self.distribution, self.min_nm, high)
        except NacreError as error:
            if str(error).startswith(context.source):
                raise
            value, place = (self.histogram, ".histogram") if self.histogram else (self.thickness_nm, "")
            raise context.fail(f"{key}{place}", value, f"is not allowed: {error}") from None


def _shares(column: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shares that a column of shares, of per cent or of counts means; else the column, which is refused."""
    total = float(column.sum())
    is_percent = abs(total - 100.0) <= 0.1
    is_count = total > 1.5 and bool(np.all(column == np.round(column)))
    return column / total if is_percent or is_count else column


class LayerSpec(ThicknessKeys):
    """A layer of a flake."""

    forms: ClassVar[tuple[str, ...]] = (
        '{material = "TiO2", thickness_nm = 120}',
        '{material = "mica", thickness_nm = 400, deviation_nm = 80}',
        '{material = "TiO2", thickness_nm = 120, deviation_nm = 20, distribution = "truncated", max_nm = 160}',
        '{material = "mica", histogram = "thickness.csv"}',
    )

    material: IndexSpec = pydantic.Field(description="what the layer is made of")


class PlateletSpec(RecipeModel):
    """One kind of platelet. Without `coatings` or without `substrate` it is free: a single layer."""

    forms: ClassVar[tuple[str, ...]] = (
        '{volume_fraction = 0.01, substrate = {material = "mica", thickness_nm = 400, deviation_nm = 80}, '
        'coatings = [{material = "TiO2", thickness_nm = 120}]}',
        '{volume_fraction = 0.005, coatings = [{material = "Al", thickness_nm = 60}], normal_deviation = [0.05, 0.2]}',
    )

    volume_fraction: float = pydantic.Field(
        json_schema_extra={"exclusiveMinimum": 0, "maximum": MAX_FRACTION},
        description="share of the stratum's volume that these flakes fill",
        examples=[0.01],
    )
    substrate: LayerSpec | None = pydantic.Field(default=None, description="the core of the flake")
    coatings: tuple[LayerSpec, ...] = pydantic.Field(
        default=(),
        max_length=MAX_COATINGS,
        description="coatings from the outermost inward, on both faces of the flake",
    )
    lower_coatings: tuple[LayerSpec, ...] | None = pydantic.Field(
        default=None,
        max_length=MAX_COATINGS,
        description="other coatings for the lower face, from the outermost inward",
    )
    normal_deviation: Deviation = pydantic.Field(
        default=0.1,
        description="SGGX roughness of the flakes' normals, or [x, y]: 0 would lay all flat",
        examples=[0.1, [0.05, 0.2]],
    )
    rotation_deg: tuple[float, float, float] = pydantic.Field(
        default=(0.0, 0.0, 0.0), description="turns the flakes' mean normal, about x, y and z", examples=[[0, 20, 0]]
    )
    diameter_um: Positive | None = pydantic.Field(
        default=None, description="median diameter of a flake's face; glints need it", examples=[20]
    )
    counting: Literal["physical", "published"] = pydantic.Field(
        default="physical",
        description="how much a flake reflects: physical is R; published is R (1 - T), which gives the looks of tables "
        "fitted that way (Guillen et al. 2020) and loses light",
    )

    @pydantic.model_validator(mode="after")
    def _check(self) -> PlateletSpec:
        if not 0.0 < self.volume_fraction <= MAX_FRACTION:
            raise ValueError(
                f"volume_fraction = {self.volume_fraction:g} is not allowed; it should be above 0 and at most "
                f"{MAX_FRACTION:g}"
            )
        if self.substrate is None and (len(self.coatings) != 1 or self.lower_coatings is not None):
            raise ValueError("substrate is missing; only a free platelet of a single coating goes without")
        return self

    def build(self, context: RecipeContext, key: str) -> Flakes:
        """Return the flakes."""
        if self.substrate is None:
            only = self.coatings[0]
            platelet = Platelet(
                only.material.build(context),
                only.thickness(context, f"{key}.coatings[0]"),
                counting=self.counting,
            )
        else:
            platelet = Platelet(
                self.substrate.material.build(context),
                self.substrate.thickness(context, f"{key}.substrate"),
                _coatings(self.coatings, context, f"{key}.coatings"),
                None
                if self.lower_coatings is None
                else _coatings(self.lower_coatings, context, f"{key}.lower_coatings"),
                self.counting,
            )
        if platelet.height_nm <= 0:
            raise context.fail(key, 0.0, "is a flake without thickness; give one of its layers some")
        spread = self.normal_deviation if isinstance(self.normal_deviation, tuple) else (self.normal_deviation,)
        normals = FlakeNormals(
            np.array([spread[0], spread[-1]], dtype=float), rotation_matrix(np.deg2rad(np.array(self.rotation_deg)))
        )
        return Flakes(platelet, self.volume_fraction, normals, self.diameter_um)


def _coatings(specs: tuple[LayerSpec, ...], context: RecipeContext, key: str) -> tuple[Coating, ...]:
    return tuple(
        Coating(spec.material.build(context), spec.thickness(context, f"{key}[{i}]")) for i, spec in enumerate(specs)
    )
