"""The recipe of a pearl: strata of resin with platelets and dye over a base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from nacre.bsdf.substrate import OF_OTHER_FAMILY, SubstrateSpec, Widths, interface_roughness, nested_strata
from nacre.core.errors import NacreError, RecipeError
from nacre.families.pearl.flake_texture import Glints
from nacre.families.pearl.material import MIN_DEVIATION, Pearl
from nacre.families.pearl.platelet import Coating, FlakeNormals, Platelet, rotation_matrix
from nacre.families.pearl.strata import Dye, Flakes, Stratum
from nacre.families.pearl.thickness import Thickness
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.readers.curves import SHARE, THICKNESS_NM, FileSpec, recipe_curve
from nacre.recipe.model import NotNegative, Positive, RecipeContext, RecipeModel, show_value

MAX_STRATA = 8
MAX_KINDS = 32
MAX_COATINGS = 20
MAX_FRACTION = 0.3  # denser flakes are not independent of each other

NotNegative = NotNegative


def _deviation(value: Any) -> Any:
    numbers = value if isinstance(value, list | tuple) else [value]
    if len(numbers) not in (1, 2) or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
        raise ValueError(f"= {show_value(value)} is not a deviation; write one number or [x, y]")
    if not all(MIN_DEVIATION <= v <= 1.0 for v in numbers):
        raise ValueError(f"= {show_value(value)} is not allowed; it should be in [{MIN_DEVIATION:g}, 1]")
    return value


DeviationNumber = Annotated[float, Field(ge=MIN_DEVIATION, le=1.0)]
Deviation = Annotated[
    DeviationNumber | Annotated[tuple[DeviationNumber, ...], Field(min_length=1, max_length=2)],
    pydantic.BeforeValidator(_deviation),
]


class ThicknessKeys(RecipeModel):
    """A thickness and its distribution over the flakes."""

    one_of: ClassVar[tuple[str, ...]] = ("thickness_nm", "histogram")

    thickness_nm: Annotated[float, Field(ge=0.0, le=1e5)] | None = Field(
        default=None, description="geometric thickness, the mean over the flakes", examples=[120]
    )
    deviation_nm: Annotated[float, Field(ge=0.0, le=1e5)] = Field(
        default=0.0, description="standard deviation of the thickness over the flakes", examples=[10]
    )
    distribution: Literal["gaussian", "truncated", "lognormal"] = Field(
        default="gaussian", description="shape of that spread"
    )
    min_nm: NotNegative = Field(default=0.0, description="lower bound of a truncated spread", examples=[80])
    max_nm: Positive | None = Field(default=None, description="upper bound of a truncated spread", examples=[160])
    histogram: FileSpec | None = Field(
        default=None,
        description="instead of thickness_nm: a file of two columns: thickness in nm; fraction, per cent or count",
        examples=["thickness.csv"],
    )

    def model_post_init(self, _: Any) -> None:
        if (self.histogram is None) == (self.thickness_nm is None):
            raise ValueError("give thickness_nm (with deviation_nm), or histogram, a file of two columns")
        if self.histogram is not None and self.deviation_nm > 0:
            raise ValueError("deviation_nm and histogram exclude each other; remove one of the two")
        if self.distribution != "truncated" and (self.min_nm > 0 or self.max_nm is not None):
            raise ValueError('min_nm and max_nm belong to distribution = "truncated"')

    def thickness(self, context: RecipeContext, key: str) -> Thickness:
        """Return the distribution.

        Raises:
            RecipeError: the histogram cannot be read or does not sum to 1, or the bounds are empty.
        """
        try:
            if self.histogram is not None:
                table = recipe_curve(context, f"{key}.histogram", self.histogram, (THICKNESS_NM, SHARE))
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
    """Return fractions from a column of fractions, per cent or counts; any other column is returned for refusal."""
    total = float(column.sum())
    is_percent = abs(total - 100.0) <= 0.1
    is_count = total > 1.5 and bool(np.all(column == np.round(column)))
    return column / total if is_percent or is_count else column


class LayerSpec(ThicknessKeys):
    """A layer of a flake."""

    material: IndexSpec = Field(description="material of the layer")


class PlateletSpec(RecipeModel):
    """One pigment. A free platelet has a single layer: `substrate` without `coatings`, or one coating alone."""

    volume_fraction: float = Field(
        json_schema_extra={"exclusiveMinimum": 0, "maximum": MAX_FRACTION},
        description="volume fraction of these flakes in the stratum",
        examples=[0.01],
    )
    substrate: LayerSpec | None = Field(default=None, description="the core of the flake")
    coatings: tuple[LayerSpec, ...] = Field(
        default=(),
        max_length=MAX_COATINGS,
        description="coatings from the outermost inward, on both faces of the flake",
    )
    lower_coatings: tuple[LayerSpec, ...] | None = Field(
        default=None,
        max_length=MAX_COATINGS,
        description="other coatings for the lower face, from the outermost inward",
    )
    normal_deviation: Deviation = Field(
        default=0.1,
        description="SGGX roughness of the flakes' normals, or [x, y]; 0 would be all flat",
        examples=[0.1, [0.05, 0.2]],
    )
    rotation_deg: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0),
        description="rotation of the flakes' mean normal about x, y and z",
        examples=[[0, 20, 0]],
    )
    diameter_um: Positive | None = Field(
        default=None, description="median diameter of a flake's face; glints need it", examples=[20]
    )
    energy_balance: Literal["conserving", "published"] = Field(
        default="conserving",
        description="reflectance of a flake: conserving is R; published is R (1 - T), which reproduces the colours of "
        "tables fitted that way (Guillen et al. 2020) and loses light",
    )

    def model_post_init(self, _: Any) -> None:
        if not 0.0 < self.volume_fraction <= MAX_FRACTION:
            raise ValueError(
                f"volume_fraction = {self.volume_fraction:g} is not allowed; it should be above 0 and at most "
                f"{MAX_FRACTION:g}"
            )
        if self.substrate is None and (len(self.coatings) != 1 or self.lower_coatings is not None):
            raise ValueError("substrate is missing; only a free platelet of a single coating has none")

    def build(self, context: RecipeContext, key: str) -> Flakes:
        """Return the flakes."""
        if self.substrate is None:
            core, place, coatings = self.coatings[0], "coatings[0]", self.coatings[1:]
        else:
            core, place, coatings = self.substrate, "substrate", self.coatings
        upper = _coatings(coatings, context, f"{key}.coatings")
        below = self.lower_coatings
        lower = None if below is None else _coatings(below, context, f"{key}.lower_coatings")
        thickness = core.thickness(context, f"{key}.{place}")
        platelet = Platelet(core.material.build(context), thickness, upper, lower, self.energy_balance)
        if platelet.height_nm <= 0:
            raise context.fail(key, 0.0, "is a flake without thickness; give one of its layers a thickness")
        spread = self.normal_deviation if isinstance(self.normal_deviation, tuple) else (self.normal_deviation,)
        normals = FlakeNormals(
            np.array([spread[0], spread[-1]], dtype=float), rotation_matrix(np.deg2rad(np.array(self.rotation_deg)))
        )
        return Flakes(platelet, self.volume_fraction, normals, self.diameter_um)


def _coatings(specs: tuple[LayerSpec, ...], context: RecipeContext, key: str) -> tuple[Coating, ...]:
    return tuple(
        Coating(spec.material.build(context), spec.thickness(context, f"{key}[{i}]")) for i, spec in enumerate(specs)
    )


class DyeSpec(RecipeModel):
    """Dye: `material`, or `file` with n and k; with `radius_nm` it consists of scattering particles."""

    one_of: ClassVar[tuple[str, ...]] = ("material", "file")

    material: IndexSpec | None = Field(default=None, description="optical constant of the dye")
    file: str | None = Field(
        default=None, description="instead of material: a table of wavelength in nm, n and k", examples=["dye.csv"]
    )
    volume_fraction: Annotated[float, Field(gt=0.0, le=0.3)] = Field(
        description="volume fraction of the dye in the stratum", examples=[0.01]
    )
    radius_nm: Annotated[float, Field(gt=0.0, le=2e4)] | None = Field(
        default=None,
        description="radius of the dye's particles, which then scatter; without it the dye only absorbs",
        examples=[100],
    )
    deviation_nm: NotNegative = Field(default=0.0, description="standard deviation of the radius", examples=[10])
    distribution: Literal["gaussian", "lognormal"] = Field(default="gaussian", description="shape of that spread")

    _index: OpticalConstant = pydantic.PrivateAttr()

    def model_post_init(self, context: Any) -> None:
        if (self.material is None) == (self.file is None):
            raise ValueError("give material or file, one of the two")
        spec = self.material or IndexSpec.model_validate({"file": self.file}, context=context)
        self._index = spec.build()
        if self.radius_nm is None and self.deviation_nm > 0:
            raise ValueError("deviation_nm needs radius_nm beside it")

    def build(self) -> Dye:
        """Return the dye."""
        radius = None
        if self.radius_nm is not None:
            radius = Thickness(self.radius_nm, self.deviation_nm, self.distribution)
        return Dye(self._index, self.volume_fraction, radius)


class StratumSpec(RecipeModel):
    """A layer of resin; `roughness` belongs to its upper interface."""

    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = (OF_OTHER_FAMILY,)

    resin: IndexSpec = Field(description="medium around the flakes")
    thickness_nm: float = Field(
        json_schema_extra={"exclusiveMinimum": 0, "maximum": 1e8},
        description="thickness of the stratum, usually written with _um",
        examples=[50000],
    )
    roughness: Widths = Field(
        default=0.0,
        description="alpha of the upper interface, or [alpha_x, alpha_y]; 0 is smooth",
        examples=[0.1, [0.05, 0.2]],
    )
    distribution: Literal["ggx", "beckmann"] = Field(
        default="ggx", description="distribution of the interface's facet normals"
    )
    compensate: bool = Field(
        default=False,
        description="restore the light lost by multiple scattering between facets of the interface",
        examples=[True],
    )
    platelets: tuple[PlateletSpec, ...] = Field(
        default=(), max_length=MAX_KINDS, description="pigments (types of flakes) in this stratum"
    )
    dye: DyeSpec | None = Field(default=None, description="absorbing or scattering matter in the resin")

    def model_post_init(self, _: Any) -> None:
        if not 0.0 < self.thickness_nm <= 1e8:
            raise ValueError(
                f"thickness_um = {self.thickness_nm / 1e3:g} is not allowed; it should be above 0 and at most 100000"
            )
        total = sum(p.volume_fraction for p in self.platelets)
        if total > MAX_FRACTION:
            raise ValueError(f"platelets fill {total:g} of the volume together; at most {MAX_FRACTION:g} is allowed")

    def build(self, context: RecipeContext, key: str) -> Stratum:
        """Return the stratum."""
        return Stratum(
            self.resin.build(context),
            self.thickness_nm,
            interface_roughness(self.roughness, self.distribution, self.compensate),
            tuple(p.build(context, f"{key}.platelets[{j}]") for j, p in enumerate(self.platelets)),
            None if self.dye is None else self.dye.build(),
        )


class GlintsSpec(RecipeModel):
    """Resolved flakes of the uppermost stratum; each of its pigments needs `diameter_um`.

    `surface_mm` is the length on the object of one unit of its texture coordinates, or of [u, v].
    """

    forms: ClassVar[tuple[str, ...]] = ("{surface_mm = 20}", "{surface_mm = [20, 10], flatness_deg = 1}")

    surface_mm: Positive | tuple[Positive, Positive] = Field(
        description="length on the object of one unit of its texture coordinates, or of [u, v]", examples=[20, [20, 10]]
    )
    diameter_spread: Annotated[float, Field(ge=0.0, le=0.6)] = Field(
        default=0.3, description="standard deviation of the logarithm of the flakes' diameters"
    )
    flatness_deg: Annotated[float, Field(ge=0.05, le=20.0)] = Field(
        default=0.5, description="standard deviation of the normal over one flake"
    )
    seed: Annotated[int, Field(ge=0, lt=1 << 24)] = Field(default=0, description="seed of the flakes' positions")

    def build(self, upper: Stratum, context: RecipeContext) -> Glints:
        """Return the glints of the uppermost stratum.

        Raises:
            RecipeError: the stratum lacks platelets, or a pigment lacks a diameter.
        """
        if not upper.flakes:
            raise context.fail("glints.surface_mm", self.surface_mm, "has no effect: strata[0] has no platelets")
        for k, flakes in enumerate(upper.flakes):
            if flakes.diameter_um is None:
                raise RecipeError(f"{context.source}: strata[0].platelets[{k}].diameter_um is missing; glints need it")
        size = self.surface_mm if isinstance(self.surface_mm, tuple) else (self.surface_mm, self.surface_mm)
        return Glints(size, self.diameter_spread, self.flatness_deg, self.seed)


class PearlSpec(RecipeModel):
    """Strata of resin with flakes (pigments) and dye, over a base."""

    varies_by_nodes: ClassVar[tuple[str, ...]] = (
        "strata[].thickness_nm",
        "strata[].roughness",
        "strata[].platelets[].volume_fraction",
        "strata[].platelets[].normal_deviation",
        "strata[].platelets[].substrate.thickness_nm",
        "strata[].platelets[].coatings[].thickness_nm",
        "strata[].platelets[].rotation_deg[]",
        "strata[].dye.volume_fraction",
        "base.albedo",
        "base.roughness",
    )

    zero_drops: ClassVar[tuple[str, ...]] = ("strata[].platelets[].volume_fraction", "strata[].dye.volume_fraction")

    family: Literal["pearl"] = Field(default="pearl", description="the family's name")
    title: str = Field(default="", description="a title for figures", examples=["Silver-white pigment"])
    quality: Literal["reference", "fast"] = Field(
        default="reference",
        description="reference: the random walk; fast: noise-free tables with a stated error if they apply",
    )
    strata: tuple[StratumSpec, ...] = Field(
        min_length=1, max_length=MAX_STRATA, description="layers of resin, from the light inward"
    )
    base: SubstrateSpec = Field(default=SubstrateSpec(), description="base below the last stratum")
    glints: GlintsSpec | None = Field(default=None, description="resolved flakes of the uppermost stratum")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _other_families(cls, data: Any) -> Any:
        return nested_strata(data, "pearl")

    def build(self, context: RecipeContext) -> Pearl:
        """Return the material.

        Raises:
            RecipeError: a file is missing or invalid.
        """
        strata = tuple(s.build(context, f"strata[{i}]") for i, s in enumerate(self.strata))
        glints = None if self.glints is None else self.glints.build(strata[0], context)
        return Pearl(strata, self.base.build(context, strata[-1].resin), self.quality, glints)
