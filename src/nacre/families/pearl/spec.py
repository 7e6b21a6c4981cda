"""The recipe of a pearl: strata of resin with platelets and dye over a base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import pydantic

from nacre.bsdf.base_spec import OF_OTHER_FAMILY, BaseSpec, Widths, interface_roughness, nested_strata
from nacre.errors import RecipeError
from nacre.families.pearl.dye import Dye
from nacre.families.pearl.glints import Glints
from nacre.families.pearl.material import Pearl
from nacre.families.pearl.platelet_spec import MAX_FRACTION, NotNegative, PlateletSpec, Positive
from nacre.families.pearl.strata import Stratum
from nacre.families.pearl.thickness import Thickness
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import RecipeContext, RecipeModel

MAX_STRATA = 8
MAX_KINDS = 32


class DyeSpec(RecipeModel):
    """Dye: `material`, or `file` with n and k; with `radius_nm` it is particles that scatter."""

    one_of: ClassVar[tuple[str, ...]] = ("material", "file")
    forms: ClassVar[tuple[str, ...]] = (
        "{material = {n = 1.5, k = 0.02}, volume_fraction = 0.01}",
        '{material = "TiO2", volume_fraction = 0.001, radius_nm = 100, deviation_nm = 10}',
    )

    material: IndexSpec | None = pydantic.Field(default=None, description="optical constant of the dye")
    file: str | None = pydantic.Field(
        default=None, description="in place of material: a table of wavelength in nm, n and k", examples=["dye.csv"]
    )
    volume_fraction: Annotated[float, pydantic.Field(gt=0.0, le=0.3)] = pydantic.Field(
        description="share of the stratum's volume that the dye fills", examples=[0.01]
    )
    radius_nm: Annotated[float, pydantic.Field(gt=0.0, le=2e4)] | None = pydantic.Field(
        default=None,
        description="radius of the dye's particles, which then scatter; without it the dye only absorbs",
        examples=[100],
    )
    deviation_nm: NotNegative = pydantic.Field(
        default=0.0, description="standard deviation of the radius", examples=[10]
    )
    distribution: Literal["gaussian", "lognormal"] = pydantic.Field(
        default="gaussian", description="shape of that spread"
    )

    _index: OpticalConstant = pydantic.PrivateAttr()

    @pydantic.model_validator(mode="after")
    def _read_index(self, info: pydantic.ValidationInfo) -> DyeSpec:
        if (self.material is None) == (self.file is None):
            raise ValueError("give material or file, one of the two")
        spec = self.material or IndexSpec.model_validate({"file": self.file}, context=info.context)
        self._index = spec.build()
        if self.radius_nm is None and self.deviation_nm > 0:
            raise ValueError("deviation_nm needs radius_nm beside it")
        return self

    def build(self) -> Dye:
        """Return the dye."""
        radius = None
        if self.radius_nm is not None:
            radius = Thickness(self.radius_nm, self.deviation_nm, self.distribution)
        return Dye(self._index, self.volume_fraction, radius)


class StratumSpec(RecipeModel):
    """A layer of resin; `roughness` is that of its upper interface."""

    forms: ClassVar[tuple[str, ...]] = (
        "{resin = {n = 1.5}, thickness_um = 50, platelets = [{volume_fraction = 0.01, "
        'substrate = {material = "mica", thickness_nm = 400}, coatings = [{material = "TiO2", thickness_nm = 120}]}]}',
    )

    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = (OF_OTHER_FAMILY,)

    resin: IndexSpec = pydantic.Field(description="the medium in which the flakes lie")
    thickness_nm: float = pydantic.Field(
        json_schema_extra={"exclusiveMinimum": 0, "maximum": 1e8},
        description="thickness of the stratum, usually written with _um",
        examples=[50000],
    )
    roughness: Widths = pydantic.Field(
        default=0.0,
        description="alpha of the stratum's upper interface, or [alpha_x, alpha_y]; 0 is smooth",
        examples=[0.1, [0.05, 0.2]],
    )
    distribution: Literal["ggx", "beckmann"] = pydantic.Field(
        default="ggx", description="distribution of that interface's facet normals"
    )
    compensate: bool = pydantic.Field(
        default=False,
        description="give back the light that facets of the interface scatter among each other",
        examples=[True],
    )
    platelets: tuple[PlateletSpec, ...] = pydantic.Field(
        default=(), max_length=MAX_KINDS, description="the kinds of flakes (pigments) in this stratum"
    )
    dye: DyeSpec | None = pydantic.Field(
        default=None, description="absorbing, or absorbing and scattering, matter in the resin"
    )

    @pydantic.model_validator(mode="after")
    def _check(self) -> StratumSpec:
        if not 0.0 < self.thickness_nm <= 1e8:
            raise ValueError(
                f"thickness_um = {self.thickness_nm / 1e3:g} is not allowed; it should be above 0 and at most 100000"
            )
        total = sum(p.volume_fraction for p in self.platelets)
        if total > MAX_FRACTION:
            raise ValueError(f"platelets fill {total:g} of the volume together; at most {MAX_FRACTION:g} is allowed")
        return self

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
    """Flakes of the uppermost stratum seen one by one; each of its platelets needs `diameter_um`.

    `surface_mm` is the length on the object of one unit of its texture coordinates, or of [u, v].
    """

    forms: ClassVar[tuple[str, ...]] = ("{surface_mm = 20}", "{surface_mm = [20, 10], flatness_deg = 1}")

    surface_mm: Positive | tuple[Positive, Positive] = pydantic.Field(
        description="length on the object of one unit of its texture coordinates, or of [u, v]", examples=[20, [20, 10]]
    )
    diameter_spread: Annotated[float, pydantic.Field(ge=0.0, le=0.6)] = pydantic.Field(
        default=0.3, description="standard deviation of the logarithm of the flakes' diameters"
    )
    flatness_deg: Annotated[float, pydantic.Field(ge=0.05, le=20.0)] = pydantic.Field(
        default=0.5, description="standard deviation of the normal over one flake"
    )
    seed: Annotated[int, pydantic.Field(ge=0, lt=1 << 24)] = pydantic.Field(
        default=0, description="seed of the flakes' places; another one lays them elsewhere"
    )

    def build(self, upper: Stratum, context: RecipeContext) -> Glints:
        """Return the glints of the uppermost stratum.

        Raises:
            RecipeError: it has no platelets, or one without a diameter.
        """
        if not upper.flakes:
            raise context.fail("glints.surface_mm", self.surface_mm, "has no use: strata[0] holds no platelets")
        for k, flakes in enumerate(upper.flakes):
            if flakes.diameter_um is None:
                raise RecipeError(f"{context.source}: strata[0].platelets[{k}].diameter_um is missing; glints need it")
        size = self.surface_mm if isinstance(self.surface_mm, tuple) else (self.surface_mm, self.surface_mm)
        return Glints(size, self.diameter_spread, self.flatness_deg, self.seed)


class PearlSpec(RecipeModel):
    """Strata of resin with flakes (pigments) and dye, over a base."""

    example: ClassVar[Mapping[str, Any]] = {
        "family": "pearl",
        "strata": [
            {
                "resin": {"n": 1.5},
                "thickness_um": 50,
                "platelets": [
                    {
                        "volume_fraction": 0.01,
                        "substrate": {"material": "mica", "thickness_nm": 400, "deviation_nm": 80},
                        "coatings": [{"material": "TiO2", "thickness_nm": 120}],
                    }
                ],
            }
        ],
        "base": {"albedo": 0.05},
    }

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

    family: Literal["pearl"] = pydantic.Field(default="pearl", description="the family's name")
    title: str = pydantic.Field(default="", description="a title for figures", examples=["Silver-white pigment"])
    quality: Literal["reference", "fast"] = pydantic.Field(
        default="reference",
        description="reference: the random walk; fast: noise-free tables with a stated error where they can be made",
    )
    strata: tuple[StratumSpec, ...] = pydantic.Field(
        min_length=1, max_length=MAX_STRATA, description="layers of resin, from the light's side inward"
    )
    base: BaseSpec = pydantic.Field(default=BaseSpec(), description="what lies below the last stratum")
    glints: GlintsSpec | None = pydantic.Field(
        default=None, description="single flakes of the uppermost stratum, seen one by one"
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _other_families(cls, data: Any) -> Any:
        return nested_strata(data, "pearl")

    def build(self, context: RecipeContext) -> Pearl:
        """Return the material.

        Raises:
            RecipeError: a file is missing or holds what it should not.
        """
        strata = tuple(s.build(context, f"strata[{i}]") for i, s in enumerate(self.strata))
        glints = None if self.glints is None else self.glints.build(strata[0], context)
        return Pearl(strata, self.base.build(context, strata[-1].resin), self.quality, glints)
