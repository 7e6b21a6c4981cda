"""The recipe of a film, and its layer table for coating."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from nacre.bsdf.facet_distributions import Roughness, alpha_from_exponent, check_widths
from nacre.bsdf.tabulate import SLICE_SHARE, reflected_lab
from nacre.bsdf.texture import NumberOrTexture, Texture, TextureSpec, angle_texture, texture_or_number
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Fabricable, Figure
from nacre.families.film.layer_spec import (
    MAX_COHERENT_NM,
    MAX_LAYERS,
    AnyLayer,
    LayerBuilder,
    LayerSpec,
    RepeatSpec,
    with_interface_layers,
)
from nacre.families.film.material import COLOUR_COSINES, Film
from nacre.families.film.ridges import Ridges
from nacre.families.film.supercells import SupercellFilm
from nacre.light import delta_e_2000
from nacre.light.tristimulus import REFERENCE_NM
from nacre.matter.drawings import Drawer, LayerSheet
from nacre.matter.indices.anisotropic_spec import AnisotropicSpec, MediumSpec
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.indices.spec import IndexSpec, ambient_in
from nacre.matter.stack import solve as solver
from nacre.matter.stack.incoherent import incoherent_powers
from nacre.recipe.model import RecipeContext, RecipeModel, UnitNumber, show_value

MAP_NM = 1000.0  # thickness range of a clear layer's colours before they fade
OPAQUE_DEPTHS = 3.0  # penetration depths, below which less than e^-6 is reflected
NUDGE = 0.1  # relative thickness change for the comparison of layers


def field(
    film: Film, theta_deg: float = 0.0, wavelengths_nm: ArrayLike | None = None, points: int = 400
) -> dict[str, NDArray[Any]]:
    """Return |E|^2 through the stack: `z_nm[z]`, `wavelengths_nm[l]`, `s[z, l]`, `p[z, l]`, `interfaces_nm`.

    Raises:
        UnsupportedError: a layer is incoherent and has no standing wave.
    """
    from nacre.matter.stack.field import field_profile  # needs numba, which pictures do not

    if not film.stack.is_coherent:
        raise UnsupportedError("a stack with an incoherent layer has no field profile")
    lam = film.wavelengths_nm if wavelengths_nm is None else np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
    d = film.stack.thicknesses_nm
    margin = max(200.0, 0.2 * float(d.sum()))
    z = np.linspace(-margin, float(d.sum()) + margin, points)
    if film.is_anisotropic:
        s, p = film.stack.polarised_field(float(np.radians(theta_deg)), lam, z[::2], slice_share=SLICE_SHARE)
        z = z[::2]
    else:
        profile = field_profile(film.stack.indices(lam), d, lam, np.array([np.radians(theta_deg)]), z)
        s, p = profile.s[:, 0], profile.p[:, 0]
    edges = np.concatenate([[0.0], np.cumsum(d)])
    return {
        "z_nm": z,
        "wavelengths_nm": lam,
        "s": s,
        "p": p,
        "interfaces_nm": edges,
        "names": np.array([medium.name for medium in _media(film)]),
        "theta_deg": np.array(theta_deg),
    }


def colour_map(
    film: Film,
    layer: int | None = None,
    thicknesses_nm: ArrayLike | None = None,
    angles_deg: ArrayLike | None = None,
    wavelengths_nm: ArrayLike | None = None,
) -> dict[str, NDArray[Any]]:
    """Return reflectance over thickness and angle: `thicknesses_nm[t]`, `angles_deg[a]`, `reflectance[t, a, l]`.

    Args:
        layer: varied layer, 0 the outermost; default: the layer with the largest effect on colour.
        thicknesses_nm: default: 0 to 1000 nm or three penetration depths, if shorter; at least twice its own thickness.

    Raises:
        UnsupportedError: the film has no such layer.
    """
    layer = leading_layer(film) if layer is None else layer
    if not 0 <= layer < len(film.layers):
        raise UnsupportedError(f"layer = {layer} does not exist; the film has {len(film.layers)}")
    full_range = np.linspace(0.0, _reach_nm(film, layer), 201)
    runs = full_range if thicknesses_nm is None else np.atleast_1d(np.asarray(thicknesses_nm, float))
    angles = np.linspace(0.0, 85.0, 86) if angles_deg is None else np.atleast_1d(np.asarray(angles_deg, dtype=float))
    lam = film.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
    d = np.broadcast_to(film.stack.thicknesses_nm, (len(runs), len(film.layers))).copy()
    d[:, layer] = runs
    tables = film.tables(lam)
    if film.is_anisotropic:
        if tables.flipped:
            raise UnsupportedError("no colour map of an anisotropic film on a substrate rarer than its ambient")
        reflectance, transmittance = tables.outside(d, np.cos(np.radians(angles)))
    elif any(tables.incoherent):
        solved = [incoherent_powers(tables.n, row, tables.incoherent, lam, np.radians(angles)) for row in d]
        reflectance = np.stack([p.reflectance for p in solved])
        transmittance = np.stack([p.transmittance for p in solved])
    else:
        powers = solver.powers(tables.n, d, lam, np.radians(angles))
        reflectance, transmittance = powers.reflectance, powers.transmittance
    return {
        "thicknesses_nm": runs,
        "angles_deg": angles,
        "wavelengths_nm": lam,
        "reflectance": reflectance,
        "transmittance": transmittance if tables.transmits else np.zeros_like(transmittance),
        "layer": np.array(layer),
        "y_label": np.array(f"Thickness of layers[{layer}] (nm)" if len(film.layers) > 1 else "Thickness (nm)"),
    }


def leading_layer(film: Film) -> int:
    """Return the layer with the largest dE00 between 90 % and 110 % thickness."""
    d = film.stack.thicknesses_nm
    tables = film.tables(film.wavelengths_nm)
    moved = []
    for i in range(len(d)):
        ends = np.stack([d, d])
        ends[:, i] *= [1.0 - NUDGE, 1.0 + NUDGE]
        less, more = reflected_lab(tables.outside(ends, COLOUR_COSINES)[0], tables.wavelengths_nm)
        moved.append(float(np.max(delta_e_2000(less, more))))
    return int(np.argmax(moved)) if moved else 0


def _reach_nm(film: Film, layer: int) -> float:
    """Return the largest thickness in a layer's map."""
    lam = np.linspace(*film.range_nm, 9)
    k = float(np.min(_mean_index(film.layers[layer].material, lam).imag))
    opaque = OPAQUE_DEPTHS * REFERENCE_NM / (4.0 * np.pi * max(k, 1e-9))
    return max(min(MAP_NM, opaque), 2.0 * float(film.stack.thicknesses_nm[layer]))


def structure(film: Film, wavelength_nm: float = 550.0) -> dict[str, NDArray[Any]]:
    """Return the drawn stack: `names[medium]`, `thicknesses_nm[layer]`, `n[medium]`, `k[medium]`."""
    at = np.array([float(np.clip(wavelength_nm, *film.range_nm))])
    media = _media(film)
    index = np.array([_mean_index(medium, at)[0] for medium in media])
    return {
        "names": np.array([medium.name for medium in media]),
        "thicknesses_nm": film.stack.thicknesses_nm,
        "n": index.real,
        "k": index.imag,
        "wavelength_nm": at[0] * np.ones(()),
        "incoherent": np.array([layer.incoherent for layer in film.layers], dtype=bool),
    }


def _media(film: Film) -> list[OpticalConstant | AnisotropicConstant]:
    return [film.ambient, *(layer.material for layer in film.layers), film.substrate]


def _mean_index(medium: OpticalConstant | AnisotropicConstant, wavelengths_nm: Array) -> ComplexArray:
    """Return n + ik; for an anisotropic medium, from its mean permittivity."""
    if isinstance(medium, AnisotropicConstant):
        return medium.mean_index(wavelengths_nm)
    return medium.n_complex(wavelengths_nm)


FIGURES: dict[str, Figure] = {"field": field, "colour-map": colour_map, "structure": structure}


MAX_VARYING = 2

# A scale of Morpho rhetenor: nine lamellae of cuticle, n = 1.56 + 0.06i (Vukusic et al. 1999), air between, in
# ridges above a dark membrane. Pitch, width and a height deviation near a quarter wave follow Kinoshita et al. 2002.
# Lamellae of about 70 nm fill half of the tapered ridge, hence 35 nm of solid cuticle; the full thickness would give a
# cyan band of 150 nm width. The period sets the back-scattered peak to 464 nm.
CUTICLE = {"n": 1.56, "k": 0.06}
MORPHO: dict[str, Any] = {
    "substrate": CUTICLE,
    "layers": [{"material": CUTICLE, "thickness_nm": 35.0}, {"material": "air", "thickness_nm": 190.0}] * 8
    + [{"material": CUTICLE, "thickness_nm": 35.0}],
    "ridges": {"pitch_nm": 700.0, "width_nm": 300.0, "height_deviation_nm": 120.0},
}
# the same wing for supercells, whose ridges cover 300 of 700 nm: lamellae of their full thickness
MORPHO_SUPERCELLS: dict[str, Any] = {
    "layers": [{"material": CUTICLE, "thickness_nm": 70.0}, {"material": "air", "thickness_nm": 155.0}] * 8
    + [{"material": CUTICLE, "thickness_nm": 70.0}],
    "ridges": {"count": 5},
}
MOST_RIDGES = 10  # limit for ridges in a supercell
SUPERCELL_KEYS = "width_deviation_nm", "shift_deviation_nm", "draws"


def _unit(value: Any) -> Any:
    """Check a roughness: one or two numbers in [0, 1], or a texture."""
    if not isinstance(value, Mapping | TextureSpec):
        check_widths(value, 'alpha, [alpha_x, alpha_y] or {texture = "r.png", ...}', show_value(value))
    return value


def _width_form(value: Any) -> str:
    return "Pair" if isinstance(value, list | tuple) else texture_or_number(value)


Exponent = Annotated[float, Field(ge=0.0, le=2e6)]
Depth = Annotated[float, Field(ge=0.0, le=1000.0)]
Width = Annotated[
    Annotated[UnitNumber, pydantic.Tag("Number")]
    | Annotated[tuple[UnitNumber, ...], Field(min_length=1, max_length=2), pydantic.Tag("Pair")]
    | Annotated[TextureSpec, pydantic.Tag("Texture")],
    pydantic.Discriminator(_width_form),
    pydantic.BeforeValidator(_unit),
]


class SurfaceSpec(RecipeModel):
    """Roughness: a distribution and its width, as alpha or as exponents e = 2/alpha^2 - 2."""

    distribution: Literal["ggx", "beckmann", "blinn", "ashikhmin-shirley"] = Field(
        default="ggx", description="distribution of the facet normals"
    )
    roughness: Width = Field(
        default=0.0,
        description="alpha of that distribution, or [alpha_x, alpha_y] for a brushed surface; 0 is smooth",
        examples=[0.1, [0.05, 0.2], {"formula": "0.05 + 0.2*u"}],
    )
    exponent: Exponent | Annotated[tuple[Exponent, ...], Field(min_length=1, max_length=2)] | None = Field(
        default=None,
        description="exponent e of the distribution, or [e_x, e_y], instead of roughness: e = 2/alpha^2 - 2",
        examples=[200, [100, 800]],
    )
    rotation_deg: NumberOrTexture = Field(
        default=0.0,
        description="direction of brushing: angle of alpha_x to the surface's x axis",
        examples=[45, {"formula": "360*u"}],
    )
    compensate: bool = Field(
        default=False, description="restore the light lost by multiple scattering between facets", examples=[True]
    )
    interface_roughness_nm: Depth | tuple[Depth, ...] = Field(
        default=0.0,
        description="thickness of an effective medium at each interface, far finer than the wavelength: one number, or "
        "one for each interface from the light inward; half of it comes from either layer",
        examples=[2, [3, 0, 1]],
    )

    def model_post_init(self, _: Any) -> None:
        if "roughness" in self.model_fields_set and self.exponent is not None:
            raise ValueError("roughness and exponent exclude each other; remove one of the two")

    def build(self, context: RecipeContext) -> Roughness:
        """Return the roughness."""
        texture: Texture | None = None
        if self.exponent is not None:
            exponents = self.exponent if isinstance(self.exponent, tuple) else (self.exponent,)
            widths = tuple(alpha_from_exponent(e) for e in exponents)
        elif isinstance(self.roughness, TextureSpec):
            texture = self.roughness.build(context, "surface.roughness")
            if not 0.001 <= texture.low <= texture.high <= 1.0:
                got = f"{texture.low:g} ... {texture.high:g}"
                raise context.fail("surface.roughness", got, "is not allowed; it should be in [0.001, 1]")
            widths = (1.0,)
        else:
            widths = self.roughness if isinstance(self.roughness, tuple) else (self.roughness,)
        return Roughness(
            distribution=self.distribution,
            alpha_x=widths[0],
            alpha_y=widths[-1],
            alpha_texture=texture,
            rotation=_rotation(self.rotation_deg, context, "surface.rotation_deg"),
            compensate=self.compensate,
        )


def _preset_fills_ridges(schema: dict[str, Any]) -> None:
    schema.pop("required")  # a preset completes the ridges


def _preset_fills_substrate(schema: dict[str, Any]) -> None:
    schema["required"].remove("substrate")
    schema["anyOf"] = [{"required": ["substrate"]}, {"required": ["preset"]}]


class RidgesSpec(RecipeModel):
    """Ridges of lamellae along y, as on a Morpho scale."""

    forms: ClassVar[tuple[str, ...]] = ("{pitch_nm = 700, width_nm = 300, height_deviation_nm = 120}",)

    model_config = pydantic.ConfigDict(json_schema_extra=_preset_fills_ridges)

    pitch_nm: Annotated[float, Field(gt=0.0, le=1e5)] = Field(
        description="distance from ridge to ridge, across them", examples=[700]
    )
    width_nm: Annotated[float, Field(gt=0.0, le=1e5)] = Field(
        description="width of one ridge, at most the pitch", examples=[300]
    )
    height_deviation_nm: Annotated[float, Field(ge=0.0, le=1e4)] = Field(
        description="standard deviation of the ridges' heights: 0 makes a grating, a quarter wave a broad fan",
        examples=[120],
    )
    count: Annotated[int, Field(ge=1, le=200)] = Field(default=7, description="number of coherently illuminated ridges")
    along_deviation_deg: Annotated[float, Field(ge=0.1, le=30.0)] = Field(
        default=4.0, description="standard deviation of the fan of light along the ridges"
    )
    fill: UnitNumber = Field(default=1.0, description="area fraction of the ridges")
    rotation_deg: NumberOrTexture = Field(
        default=0.0, description="rotation of the ridges in the surface", examples=[45, {"formula": "360*u"}]
    )
    optics: Literal["scalar", "vector"] = Field(
        default="scalar",
        description="the stack's reflectance times scalar diffraction; or Maxwell's equations in supercells of `count` "
        "ridges, of isotropic layers on pedestals of the substrate",
    )
    width_deviation_nm: Annotated[float, Field(ge=0.0, le=1e4)] = Field(
        default=0.0, description="for vector optics: standard deviation of the ridges' widths", examples=[30]
    )
    shift_deviation_nm: Annotated[float, Field(ge=0.0, le=1e4)] = Field(
        default=0.0,
        description="for vector optics: standard deviation of the ridges' lateral positions; neighbours never touch",
        examples=[50],
    )
    draws: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=20, description="for vector optics: number of supercells, over which the light is averaged"
    )

    def model_post_init(self, _: Any) -> None:
        if self.width_nm > self.pitch_nm:
            raise ValueError(f"width_nm = {self.width_nm:g} is larger than pitch_nm = {self.pitch_nm:g}")
        if self.optics == "scalar":
            for key in SUPERCELL_KEYS:
                if key in self.model_fields_set:
                    raise ValueError(f'{key} = {getattr(self, key):g} is of optics = "vector"; remove it')
        elif self.count > MOST_RIDGES:
            raise ValueError(
                f'count = {self.count} is too many for optics = "vector"; allowed: 1 to {MOST_RIDGES} ridges'
            )

    def build(self, context: RecipeContext) -> Ridges:
        """Return the ridges."""
        rotation = _rotation(self.rotation_deg, context, "ridges.rotation_deg")
        return Ridges(rotation=rotation, **self.model_dump(exclude={"rotation_deg"}))


class BaseSpec(RecipeModel):
    """A diffuse base below the film, or below the ridges."""

    forms: ClassVar[tuple[str, ...]] = ("{albedo = 0.05}",)

    albedo: UnitNumber = Field(default=0.0, description="albedo of the diffuse base", examples=[0.05])


class WavelengthsSpec(RecipeModel):
    """Wavelength grid."""

    forms: ClassVar[tuple[str, ...]] = ("{min_nm = 400, max_nm = 700, step_nm = 2}",)

    min_nm: Annotated[float, Field(ge=100.0, le=1e5)] = Field(default=360.0, description="first wavelength of the grid")
    max_nm: Annotated[float, Field(ge=100.0, le=1e5)] = Field(default=830.0, description="last wavelength of the grid")
    step_nm: Annotated[float, Field(ge=0.01, le=50.0)] | None = Field(
        default=None, description="step of the grid; default: chosen by the optical thickness", examples=[2]
    )

    def model_post_init(self, _: Any) -> None:
        if self.max_nm <= self.min_nm:
            raise ValueError(f"max_nm = {self.max_nm:g} must be above min_nm = {self.min_nm:g}")
        if self.step_nm is not None and (self.max_nm - self.min_nm) / self.step_nm > 50_000:
            raise ValueError(f"step_nm = {self.step_nm:g} makes more than 50000 wavelengths")


@dataclass(frozen=True)
class FilmModel(Film, Fabricable):
    """A film with its figures and its layer table."""

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Field profile, colour over thickness and angle, structure."""
        return {kind: partial(maker, self) for kind, maker in FIGURES.items()}

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """The layer table."""
        return {"sheet": lambda request: layer_sheet(self)}


@dataclass(frozen=True)
class SupercellModel(SupercellFilm, FilmModel):
    """A film in ridges solved by supercells, with the figures and the layer table of a film."""


class FilmSpec(RecipeModel):
    """Layers on a substrate, smooth, rough or in ridges; `preset = "morpho"` gives default values."""

    varies: ClassVar[str] = "layers[].thickness_nm, surface.roughness, surface.rotation_deg"
    varies_by_nodes: ClassVar[tuple[str, ...]] = ("base.albedo",)

    model_config = pydantic.ConfigDict(json_schema_extra=_preset_fills_substrate)

    family: Literal["film"] = Field(default="film", description="the family's name")
    title: str = Field(default="", description="a title for figures", examples=["Oxide on silicon"])
    preset: Literal["morpho"] | None = Field(
        default=None, description="default values of a Morpho wing", examples=["morpho"]
    )
    ambient: IndexSpec = Field(
        default=IndexSpec.model_validate("air"), description="medium above the film, on the side of the light"
    )
    substrate: MediumSpec = Field(
        description="medium below the layers; transmits if clear; a free film if equal to the ambient"
    )
    layers: tuple[AnyLayer, ...] = Field(
        default=(), max_length=MAX_LAYERS, description="the layers, from the light inward"
    )
    surface: SurfaceSpec = Field(default=SurfaceSpec(), description="roughness of all layers")
    ridges: RidgesSpec | None = Field(default=None, description="ridges of lamellae, instead of roughness")
    base: BaseSpec = Field(default=BaseSpec(), description="a diffuse base below the film")
    wavelengths: WavelengthsSpec = Field(
        default=WavelengthsSpec(), description="wavelength grid, instead of the film's own choice"
    )
    extrapolate: Literal["error", "edge"] = Field(
        default="error", description="outside the tabulated range of an optical constant: an error, or the end values"
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _fill_preset(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and data.get("preset") == "morpho":
            ridges = data.get("ridges")
            is_vector = isinstance(ridges, Mapping) and ridges.get("optics") == "vector"
            preset = {**MORPHO, "layers": MORPHO_SUPERCELLS["layers"]} if is_vector else MORPHO
            filled = {**preset, **data}
            if isinstance(ridges, Mapping):
                own = {**MORPHO["ridges"], **MORPHO_SUPERCELLS["ridges"]} if is_vector else MORPHO["ridges"]
                # a length in any unit replaces the preset's
                stems = {str(key).rpartition("_")[0] or str(key) for key in ridges}
                unset = {k: v for k, v in own.items() if (k.rpartition("_")[0] or k) not in stems}
                filled["ridges"] = {**unset, **ridges}
            return filled
        return data

    def model_post_init(self, _: Any) -> None:
        plain = dict(_plain_layers(self.layers))
        varying = [path for path, layer in plain.items() if isinstance(layer.thickness_nm, TextureSpec)]
        if len(varying) > MAX_VARYING:
            raise ValueError(
                f"layers: {len(varying)} thicknesses vary over the surface; at most {MAX_VARYING} can "
                "(roughness and rotation may vary as well)"
            )
        for path, layer in plain.items():
            thickness = layer.thickness_nm
            if not layer.incoherent and not isinstance(thickness, TextureSpec) and thickness > MAX_COHERENT_NM:
                raise ValueError(
                    f"{path}.thickness_nm = {thickness:g} is too thick to interfere; write incoherent = true"
                )
        if self.ridges is not None and self.surface.roughness != 0.0:
            raise ValueError("surface.roughness has no effect with ridges; remove one of the two")
        media = (self.substrate, *(layer.material for layer in plain.values()))
        if self.ridges is not None and any(isinstance(medium, AnisotropicSpec) for medium in media):
            raise ValueError("ridges hold isotropic layers only; remove the ridges, or give the mean index")
        if self.ridges is not None and self.ridges.optics == "vector":
            for path, layer in plain.items():
                if layer.incoherent or isinstance(layer.thickness_nm, TextureSpec):
                    what = "incoherent = true" if layer.incoherent else "thickness_nm is a texture, which"
                    raise ValueError(f'{path}.{what} is not allowed in ridges with optics = "vector"')

    def build(self, context: RecipeContext) -> FilmModel:
        """Return the material.

        Raises:
            RecipeError: an image is missing or invalid, or a thickness is out of range.
        """
        ambient = self._edge(ambient_in(self.ambient, "ambient" in self.model_fields_set, context))
        substrate = self._index(self.substrate, context)
        layers = list(LayerBuilder(context, lambda spec: self._index(spec, context)).build(self.layers))
        if len(layers) > MAX_LAYERS:
            raise context.fail("layers", f"{len(layers)} layers", f"are too many; at most {MAX_LAYERS}")
        if np.any(self.surface.interface_roughness_nm):
            layers = with_interface_layers(layers, (ambient, substrate), self.surface.interface_roughness_nm, context)
        is_vector = self.ridges is not None and self.ridges.optics == "vector"
        return (SupercellModel if is_vector else FilmModel)(
            ambient=ambient,
            layers=tuple(layers),
            substrate=substrate,
            surface=self.surface.build(context),
            ridges=None if self.ridges is None else self.ridges.build(context),
            base_albedo=self.base.albedo,
            range_nm=(self.wavelengths.min_nm, self.wavelengths.max_nm),
            step_nm=self.wavelengths.step_nm,
        )

    def _index(self, spec: IndexSpec | AnisotropicSpec, context: RecipeContext) -> Any:
        return self._edge(spec.build(context))

    def _edge(self, made: Any) -> Any:
        return made.with_extrapolation("edge") if self.extrapolate == "edge" else made


def _plain_layers(layers: tuple[Any, ...], path: str = "layers") -> Iterator[tuple[str, LayerSpec]]:
    """Yield each layer's path and table, also within groups."""
    for i, layer in enumerate(layers):
        if isinstance(layer, LayerSpec):
            yield f"{path}[{i}]", layer
        elif isinstance(layer, RepeatSpec):
            yield from _plain_layers(layer.layers, f"{path}[{i}].layers")


def _rotation(value: float | TextureSpec, context: RecipeContext, key: str) -> Texture | None:
    return angle_texture(value.build(context, key) if isinstance(value, TextureSpec) else value)


COLUMNS = (
    "position", "material", "thickness_nm", "thickness_min_nm", "thickness_max_nm", f"n_{REFERENCE_NM:.0f}nm",
    f"k_{REFERENCE_NM:.0f}nm", "optical_thickness_nm", "quarter_waves", "incoherent", "source",
)  # fmt: skip


def layer_rows(film: Film) -> list[dict[str, Any]]:
    """Return a row per medium: ambient, layers from the light inward, substrate.

    Varying thicknesses are given at the centre with their range; quarter waves refer to 550 nm.
    """
    uv = np.stack(np.meshgrid(*[np.linspace(0, 1, 33)] * 2), axis=-1).reshape(-1, 2)
    middle = np.array([0.5, 0.5])
    rows = [_row("ambient", film.ambient)]
    for number, layer in enumerate(film.layers, start=1):
        here = float(layer.thickness_at(middle))
        everywhere = [float(layer.thickness_at(place)) for place in uv]
        row = _row(str(number), layer.material)
        optical = row[COLUMNS[5]] * here
        row |= {
            "thickness_nm": here, "thickness_min_nm": min(everywhere), "thickness_max_nm": max(everywhere),
            "optical_thickness_nm": optical, "quarter_waves": 4 * optical / REFERENCE_NM,
            "incoherent": layer.incoherent,
        }  # fmt: skip
        rows.append(row)
    return [*rows, _row("substrate", film.substrate)]


def _row(position: str, material: Any) -> dict[str, Any]:
    low, high = material.range_nm
    at = np.array([min(max(REFERENCE_NM, low), high)])
    is_tensor = isinstance(material, AnisotropicConstant)  # its row holds the mean index
    index = complex((material.mean_index(at) if is_tensor else material.n_complex(at))[0])
    return {
        "position": position, "material": material.name, COLUMNS[5]: index.real, COLUMNS[6]: index.imag,
        "source": material.source,
    }  # fmt: skip


def layer_sheet(film: Film) -> LayerSheet:
    """Return the film's layers as a table."""
    remarks = () if film.ridges is None else ("the film stands in ridges: see the recipe",)
    return LayerSheet(COLUMNS, tuple(layer_rows(film)), remarks)
