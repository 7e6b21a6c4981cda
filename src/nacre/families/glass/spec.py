"""The recipe of a photonic glass."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from pydantic import Field

from nacre.bsdf.substrate import OF_OTHER_FAMILY, SubstrateSpec, Widths, interface_roughness, nested_strata
from nacre.core.arrays import Array
from nacre.core.errors import MaterialRangeError, NacreError
from nacre.families.glass.composite import INDEX_NM, MAX_EXTINCTION, Balls, Composite, EffectiveDispersion
from nacre.families.glass.material import FastGlass, Glass, Layer
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.readers.curves import Q_PER_UM, STRUCTURE, FileSpec, recipe_curve
from nacre.recipe.model import NotNegative, Positive, RecipeContext, RecipeModel, show_value

MAX_PACKING = 0.64  # random packing of equal spheres
MIN_LAYERS = 3  # minimum thickness of a layer treated as a continuum, in diameters
MAX_RADIUS_NM = 500.0  # outer radius above which visible light lacks an effective medium
MAX_RELATIVE_DEVIATION = 0.2  # standard deviation of the radius, relative
MAX_BALL_NM = 1e6
MAX_THICKNESS_NM = 1e8
MAX_STRATA = 8
OF_ONE_LAYER = ("thickness_nm", "matrix", "spheres", "absorber", "balls", "surface", "model")

NotNegative = NotNegative


class ShellSpec(RecipeModel):
    """A shell around every sphere; hollow spheres have a core of air."""

    forms: ClassVar[tuple[str, ...]] = ('{material = "SiO2", thickness_nm = 20}',)

    material: IndexSpec = Field(description="material of the shell")
    thickness_nm: Annotated[float, Field(gt=0.0, le=MAX_RADIUS_NM)] = Field(
        description="thickness of the shell outside the core", examples=[20]
    )


class SpheresSpec(RecipeModel):
    """Disordered spheres."""

    material: IndexSpec = Field(description="material of a sphere's core")
    radius_nm: Annotated[float, Field(gt=0.0, le=MAX_RADIUS_NM)] = Field(
        description="mean radius of the core", examples=[125]
    )
    deviation_nm: NotNegative = Field(
        default=0.0,
        description="standard deviation of the outer radius, at most 0.2 of it; core and shell scale together",
        examples=[6],
    )
    volume_fraction: Positive = Field(
        json_schema_extra={"maximum": MAX_PACKING},
        description="volume fraction of whole spheres, at most 0.64, the densest random packing",
        examples=[0.55],
    )
    shell: ShellSpec | None = Field(default=None, description="a coat round the core")

    def model_post_init(self, _: Any) -> None:
        if self.volume_fraction > MAX_PACKING:
            raise ValueError(
                f"volume_fraction = {self.volume_fraction:g} is not allowed; it should be at most {MAX_PACKING:g}, "
                "the densest random packing of spheres"
            )
        if self.outer_nm > MAX_RADIUS_NM:
            raise ValueError(
                f"radius_nm = {self.radius_nm:g} with its shell is not allowed; both together should be at most "
                f"{MAX_RADIUS_NM:g}"
            )
        if self.deviation_nm > MAX_RELATIVE_DEVIATION * self.outer_nm:
            raise ValueError(
                f"deviation_nm = {self.deviation_nm:g} is not allowed; it should be at most "
                f"{MAX_RELATIVE_DEVIATION:g} of the outer radius, {self.outer_nm:g}"
            )

    @property
    def outer_nm(self) -> float:
        """Outer radius."""
        return self.radius_nm + (self.shell.thickness_nm if self.shell else 0.0)


class AbsorberSpec(RecipeModel):
    """Black absorber in the matrix, such as carbon or melanin, which suppresses white light."""

    one_of: ClassVar[tuple[str, ...]] = ("k", "material")
    forms: ClassVar[tuple[str, ...]] = ("{k = 0.002}", "{material = {n = 1.8, k = 0.6}, volume_fraction = 0.003}")

    k: float | None = Field(
        json_schema_extra={"minimum": 0},
        default=None,
        description="extinction coefficient added to the matrix",
        examples=[0.002],
    )
    material: IndexSpec | None = Field(
        default=None, description="instead of k: material of the absorber, of which only k counts"
    )
    volume_fraction: Annotated[float, Field(gt=0.0, le=0.3)] | None = Field(
        default=None, description="with material: its volume fraction in the matrix", examples=[0.003]
    )

    def model_post_init(self, _: Any) -> None:
        if (self.k is None) == (self.material is None):
            raise ValueError("give k or material, one of the two")
        if (self.material is None) != (self.volume_fraction is None):
            raise ValueError("material and volume_fraction belong together; give both, or only k")
        if self.k is not None and self.k < 0:
            raise ValueError(
                f"k = {self.k:g} is not allowed; it should be 0 or more: n + ik with k >= 0 absorbs, and k < 0 would "
                "be gain"
            )


class BallsSpec(RecipeModel):
    """Photonic balls: micrometre-sized balls of packed spheres in a binder."""

    forms: ClassVar[tuple[str, ...]] = ("{binder = {n = 1.5}, radius_um = 5, volume_fraction = 0.3}",)

    binder: IndexSpec = Field(description="material between the balls, possibly absorbing", examples=[{"n": 1.5}])
    radius_nm: Annotated[float, Field(gt=0.0, le=MAX_BALL_NM)] = Field(
        description="radius of a ball, usually written with _um; at least three sphere diameters across",
        examples=[5000],
    )
    volume_fraction: Positive = Field(
        json_schema_extra={"maximum": MAX_PACKING},
        description="volume fraction of the balls, at most 0.64, the densest random packing",
        examples=[0.3],
    )

    def model_post_init(self, _: Any) -> None:
        if self.volume_fraction > MAX_PACKING:
            raise ValueError(
                f"volume_fraction = {self.volume_fraction:g} is not allowed; it should be at most {MAX_PACKING:g}, "
                "the densest random packing of balls"
            )

    def build(self, glass: Composite, context: RecipeContext, extrapolate: str, key: str) -> Balls:
        """Return balls of a glass; `key` is the table's path in the recipe, with a final dot.

        Raises:
            RecipeError: light cannot be traced in the binder.
        """
        binder = self.binder.build(context)
        if extrapolate == "edge":
            binder = binder.with_extrapolation("edge")
        try:
            n = complex(binder.n_complex(np.array([INDEX_NM]))[0])
        except MaterialRangeError:
            n = 1.0 + 0.0j  # reported when that wavelength is computed
        if n.real < 1 or n.imag > MAX_EXTINCTION:
            why = f"has the index {n.real:.4g} + {n.imag:.2g}i; n must be at least 1 and k at most {MAX_EXTINCTION:g}"
            raise context.fail(f"{key}balls.binder", self.binder.name or "...", why)
        return Balls(glass, self.radius_nm, self.volume_fraction, binder)


class SurfaceSpec(RecipeModel):
    """The upper face."""

    forms: ClassVar[tuple[str, ...]] = ("{roughness = 0.1}",)

    roughness: Widths = Field(
        default=0.0, description="alpha of the upper face, or [alpha_x, alpha_y]; 0 is smooth", examples=[0.1]
    )
    distribution: Literal["ggx", "beckmann"] = Field(
        default="ggx", description="distribution of that face's facet normals"
    )
    compensate: bool = Field(
        default=True, description="restore the light lost by multiple scattering between facets", examples=[False]
    )


class StructureSpec(RecipeModel):
    """Order of the spheres: "percus-yevick", or a file with the structure factor."""

    one_of: ClassVar[tuple[str, ...]] = ("name", "sq")
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = ({"enum": ["percus-yevick"]},)
    forms: ClassVar[tuple[str, ...]] = ('"percus-yevick"', '{sq = "s.csv"}')

    name: Literal["percus-yevick"] | None = Field(
        default=None, description="model of the order; a table is not needed for it alone", examples=["percus-yevick"]
    )
    sq: FileSpec | None = Field(
        default=None,
        description="instead of name: a file of two columns, q in 1/um, ascending, and S(q)",
        examples=["s.csv"],
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_name(cls, data: Any) -> Any:
        if isinstance(data, Mapping | StructureSpec):
            return data
        if data != "percus-yevick":
            raise ValueError(f'= {show_value(data)} is not known; write "percus-yevick" or {{sq = "s.csv"}}')
        return {"name": data}

    def model_post_init(self, _: Any) -> None:
        if (self.name is None) == (self.sq is None):
            raise ValueError('needs one of name, sq; write "percus-yevick" or {sq = "s.csv"}')

    def build(self, context: RecipeContext, outer_nm: float, place: str = "") -> Callable[[Array], Array] | None:
        """Return the structure factor S as a function of q d, d: outer diameter; None for hard spheres.

        Below the tabulated range S has its first value, above it 1.

        Raises:
            RecipeError: the file is unusable.
        """
        if self.sq is None:
            return None
        key = f"{place}model.structure.sq"
        table = recipe_curve(context, key, self.sq, (Q_PER_UM, STRUCTURE))
        q, s = table[:, 0] * 1e-3, table[:, 1]
        if len(q) < 4 or np.any(np.diff(q) <= 0) or q[0] < 0 or np.any(s < 0):
            raise context.fail(key, self.sq.file, "must hold at least 4 rows of ascending q >= 0 in 1/um and S >= 0")
        d = 2 * outer_nm
        return lambda y: np.asarray(np.interp(y / d, q, s, right=1.0))


class ModelSpec(RecipeModel):
    """Details of the model."""

    structure: StructureSpec = Field(
        default=StructureSpec(name="percus-yevick"),
        description='order of the spheres: "percus-yevick", or a file with S(q)',
    )
    effective_index: Literal["bruggeman", "maxwell-garnett"] = Field(
        default="bruggeman", description="mixing rule of the effective index"
    )


def _index(spec: IndexSpec, context: RecipeContext, extrapolate: str) -> OpticalConstant:
    made = spec.build(context)
    return made.with_extrapolation("edge") if extrapolate == "edge" else made


def _check_layer(thickness_nm: float, spheres: SpheresSpec, balls: BallsSpec | None, model: ModelSpec) -> None:
    """Check keys of several tables against each other.

    Raises:
        ValueError: inconsistent values.
    """
    across = MIN_LAYERS * 2 * spheres.outer_nm
    least, extent = (across, "spheres") if balls is None else (MIN_LAYERS * 2 * balls.radius_nm, "balls")
    if balls is not None and 2 * balls.radius_nm < across:
        raise ValueError(
            f"balls.radius_um = {balls.radius_nm / 1e3:g} is not allowed; {MIN_LAYERS} spheres should fit across "
            f"a ball, a radius of at least {across / 2e3:g}"
        )
    if thickness_nm < least:
        raise ValueError(
            f"thickness_um = {thickness_nm / 1e3:g} is not allowed; it should hold {MIN_LAYERS} {extent}, "
            f"at least {least / 1e3:g}"
        )
    if model.effective_index == "maxwell-garnett" and spheres.shell is not None:
        raise ValueError(
            'model.effective_index = "maxwell-garnett" is not allowed with a shell; it should be "bruggeman"'
        )


Thickness = Annotated[float, Field(gt=0.0, le=MAX_THICKNESS_NM)]


class StratumSpec(RecipeModel):
    """One of several layers, with the keys of a single-layer recipe."""

    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = (OF_OTHER_FAMILY,)

    thickness_nm: Thickness = Field(
        description="thickness of the stratum, usually written with _um; at least three spheres", examples=[5000]
    )
    matrix: IndexSpec = Field(default=IndexSpec.model_validate("air"), description="material between the spheres")
    spheres: SpheresSpec = Field(description="the spheres")
    absorber: AbsorberSpec | None = Field(default=None, description="black in the matrix")
    balls: BallsSpec | None = Field(
        default=None, description="balls of glass in a binder, as in a paint, instead of a homogeneous layer"
    )
    surface: SurfaceSpec = Field(default=SurfaceSpec(), description="the upper face")
    model: ModelSpec = Field(default=ModelSpec(), description="details of the model")

    @pydantic.model_validator(mode="after")
    def _check(self) -> StratumSpec:
        _check_layer(self.thickness_nm, self.spheres, self.balls, self.model)
        return self

    def build(self, context: RecipeContext, extrapolate: str, key: str = "") -> Layer:
        """Return the stratum; `key` is its path in the recipe, with a final dot.

        Raises:
            RecipeError: a file is not usable, or the effective index cannot be solved.
        """
        spheres, absorber = self.spheres, self.absorber
        layers = [(spheres.material, spheres.radius_nm)]
        if spheres.shell is not None:
            layers.append((spheres.shell.material, spheres.outer_nm))
        black = None
        if absorber is not None and absorber.material is not None and absorber.volume_fraction is not None:
            black = (_index(absorber.material, context, extrapolate), absorber.volume_fraction)
        composite = Composite(
            materials=tuple(_index(material, context, extrapolate) for material, _ in layers),
            radii_nm=tuple(radius for _, radius in layers),
            volume_fraction=spheres.volume_fraction,
            matrix=_index(self.matrix, context, extrapolate),
            deviation_nm=spheres.deviation_nm,
            matrix_k=0.0 if absorber is None or absorber.k is None else absorber.k,
            absorber=black,
            mixing=self.model.effective_index,
            structure=self.model.structure.build(context, spheres.outer_nm, key),
        )
        try:
            composite.effective_index(np.array([INDEX_NM]))
        except MaterialRangeError:
            pass  # reported when that wavelength is computed
        except NacreError as error:
            name = f"{key}model.effective_index"
            raise context.fail(name, self.model.effective_index, f"fails: {error}") from None
        filling: Composite | Balls = composite
        if self.balls is not None:
            filling = self.balls.build(composite, context, extrapolate, key)
        surface = interface_roughness(self.surface.roughness, self.surface.distribution, self.surface.compensate)
        return Layer(filling, self.thickness_nm, surface)


class GlassSpec(RecipeModel):
    """Disordered spheres in a matrix: a colour that hardly changes with the angle."""

    varies_by_nodes: ClassVar[tuple[str, ...]] = (
        "thickness_nm",
        "spheres.radius_nm",
        "spheres.volume_fraction",
        "spheres.shell.thickness_nm",
        "absorber.k",
        "absorber.volume_fraction",
        "balls.radius_nm",
        "balls.volume_fraction",
        "surface.roughness",
        "strata[].thickness_nm",
        "strata[].spheres.radius_nm",
        "strata[].spheres.volume_fraction",
        "strata[].absorber.k",
        "strata[].balls.volume_fraction",
        "base.albedo",
    )

    family: Literal["glass"] = Field(default="glass", description="the family's name")
    title: str = Field(default="", description="a title for figures", examples=["Blue feather"])
    quality: Literal["reference", "fast"] = Field(
        default="reference", description="reference: the random walk; fast: noise-free tables if they apply"
    )
    thickness_nm: Thickness | None = Field(
        default=None,
        description="thickness of the layer, usually written with _um; at least three spheres",
        examples=[20000],
    )
    matrix: IndexSpec = Field(default=IndexSpec.model_validate("air"), description="material between the spheres")
    spheres: SpheresSpec | None = Field(default=None, description="the spheres")
    absorber: AbsorberSpec | None = Field(default=None, description="black in the matrix")
    balls: BallsSpec | None = Field(
        default=None, description="balls of glass in a binder, as in a paint, instead of a homogeneous layer"
    )
    surface: SurfaceSpec = Field(default=SurfaceSpec(), description="the upper face")
    strata: tuple[StratumSpec, ...] = Field(
        default=(),
        max_length=MAX_STRATA,
        description="instead of the keys of one layer: several layers, from the light inward",
    )
    base: SubstrateSpec = Field(default=SubstrateSpec(), description="base below the layer")
    model: ModelSpec = Field(default=ModelSpec(), description="details of the model")
    extrapolate: Literal["error", "edge"] = Field(
        default="error", description="outside the tabulated range of an optical constant: an error, or the end values"
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _other_families(cls, data: Any) -> Any:
        return nested_strata(data, "glass")

    def model_post_init(self, _: Any) -> None:
        layer_keys = [key for key in OF_ONE_LAYER if key in self.model_fields_set]
        if self.strata:
            if layer_keys:
                raise ValueError(f"gives strata and {layer_keys[0].replace('_nm', '_um')}; write every layer in strata")
            return
        for key in ("thickness_nm", "spheres"):
            if getattr(self, key) is None:
                raise ValueError(f"{key.replace('_nm', '_um')} is missing")
        assert self.thickness_nm is not None and self.spheres is not None
        _check_layer(self.thickness_nm, self.spheres, self.balls, self.model)

    def build(self, context: RecipeContext) -> Glass:
        """Return the material.

        Raises:
            RecipeError: a file is not usable, or the effective index cannot be solved.
        """
        if self.strata:
            layers = [s.build(context, self.extrapolate, f"strata[{i}].") for i, s in enumerate(self.strata)]
        else:
            single = StratumSpec.model_construct(**{key: getattr(self, key) for key in OF_ONE_LAYER})
            layers = [single.build(context, self.extrapolate)]
        first, below = layers[0], tuple(layers[1:])
        inside = OpticalConstant(
            "effective medium", EffectiveDispersion(layers[-1].composite), "spheres and matrix together"
        )
        base = self.base.build(context, inside)
        made = Glass(first.composite, first.thickness_nm, first.surface, base, self.quality, below=below)
        if self.quality != "fast" or made.inapplicable_reason() is not None:
            return made
        return FastGlass(first.composite, first.thickness_nm, first.surface, base, self.quality)
