"""Recipe tables of a film's media: plain, anisotropic, twisted, graded and repeated layers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from pydantic import Field

from nacre.bsdf.texture import Texture, TextureSpec, texture_or_number
from nacre.families.film.material import FilmLayer
from nacre.matter.indices.anisotropic_spec import AnisotropicSpec, MediumSpec
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.indices.laws import Mixture
from nacre.matter.indices.spec import IndexSpec
from nacre.matter.stack.polarised import SPREAD_REACH, Helix
from nacre.matter.stack.solve import powers
from nacre.recipe.model import NotNegative, RecipeContext, RecipeModel, show_value

SLICES_A_TURN = 64  # minimum for a helix; see `nacre.matter.stack.anisotropic`
MAX_LAYERS = 1000
MAX_THICKNESS_NM = 1e8  # ten centimetres, for incoherent panes
MAX_COHERENT_NM = 3e4  # fringes of 30 um need a resolution of 0.1 nm
GRADED_ERROR = 1e-4  # error of the reflectance of a graded layer between vacuum and its end materials
SLICES = (8, 16, 32, 64, 128, 256)
GRADED_PROBE_NM = (400.0, 470.0, 550.0, 630.0, 700.0)

Medium = OpticalConstant | AnisotropicConstant


def _thickness(value: Any) -> Any:
    """Check a thickness: a number, or a texture table."""
    if isinstance(value, bool) or not isinstance(value, int | float | Mapping | TextureSpec):
        raise ValueError(f"= {show_value(value)} is not a thickness; write a number, "
                         '{texture = "t.png", min = 100, max = 700} or {formula = "100 + 600*v"}')  # fmt: skip
    if isinstance(value, int | float) and not 0.0 <= value <= MAX_THICKNESS_NM:
        raise ValueError(f"= {value:g} is not allowed; it should be from 0 to {MAX_THICKNESS_NM:g} nm")
    return value


Thickness = Annotated[
    Annotated[float, Field(ge=0.0, le=MAX_THICKNESS_NM), pydantic.Tag("Number")]
    | Annotated[TextureSpec, pydantic.Tag("Texture")],
    pydantic.Discriminator(texture_or_number),
    pydantic.BeforeValidator(_thickness),
]
# nm; a helix of molecules does not turn within less than one of them
Pitch = Annotated[float, Field(ge=1.0, le=1e6)]


class LayerSpec(RecipeModel):
    """One layer: material, thickness, coherence, and the helix of a twisted one."""

    material: MediumSpec = Field(description="material of the layer")
    thickness_nm: Thickness = Field(
        description="geometric thickness; a texture or formula lets it vary over the surface",
        examples=[350, {"formula": "100 + 600*v"}, {"texture": "grey.png", "min": 100, "max": 700}],
    )
    incoherent: bool = Field(
        default=False,
        description="the layer is too thick for interference, such as a pane or a varnish",
        examples=[True],
    )
    pitch_nm: Pitch | None = Field(
        default=None,
        description="length in which the axes of a twisted layer turn once about the normal; the material's axes are "
        "those at the upper face",
        examples=[350],
    )
    pitch_lower_nm: Pitch | None = Field(
        default=None, description="pitch at the lower face, with a linear course between", examples=[420]
    )
    pitch_deviation_nm: NotNegative = Field(
        default=0.0,
        description="standard deviation of the pitch among domains, whose reflected powers are averaged",
        examples=[12],
    )
    handedness: Literal["right", "left"] = Field(
        default="right", description="a right-handed screw reflects right circular light", examples=["left"]
    )

    def model_post_init(self, _: Any) -> None:
        if self.pitch_nm is None:
            stray = {"pitch_lower_nm", "pitch_deviation_nm", "handedness"} & self.model_fields_set
            if stray:
                raise ValueError(f".{min(stray)} belongs to a twisted layer; give pitch_nm")
            return
        if not isinstance(self.material, AnisotropicSpec):
            raise ValueError(f".pitch_nm = {self.pitch_nm:g} has no effect on an isotropic material")
        if self.incoherent:
            raise ValueError(".pitch_nm and incoherent exclude each other: a twisted layer acts by interference")
        least = min(self.pitch_nm, self.pitch_lower_nm or self.pitch_nm)
        if isinstance(self.thickness_nm, int | float) and 0 < self.thickness_nm < least / SLICES_A_TURN:
            raise ValueError(
                f".thickness_nm = {self.thickness_nm:g} is thinner than a slice of the helix; it should be at least "
                f"pitch_nm / {SLICES_A_TURN} = {least / SLICES_A_TURN:.3g}; else remove pitch_nm"
            )
        if self.pitch_deviation_nm * SPREAD_REACH >= least:
            raise ValueError(
                f".pitch_deviation_nm = {self.pitch_deviation_nm:g} is too wide for a pitch of {least:g} nm; it should "
                f"be below {least / SPREAD_REACH:g}"
            )

    @property
    def helix(self) -> Helix | None:
        """The helix of a twisted layer."""
        if self.pitch_nm is None:
            return None
        hand = 1 if self.handedness == "right" else -1
        return Helix(self.pitch_nm, hand, self.pitch_deviation_nm, self.pitch_lower_nm)


class GradedSpec(RecipeModel):
    """A continuous change from one material to another."""

    forms: ClassVar[tuple[str, ...]] = ('{from = "SiO2", to = "TiO2", profile = "linear"}',)
    model_config = pydantic.ConfigDict(populate_by_name=True)

    start: IndexSpec = Field(alias="from", description="material at the upper face")
    to: IndexSpec = Field(description="material at the lower face")
    profile: Literal["linear", "quintic", "exponential"] = Field(
        default="linear",
        description="course of n + ik over depth: linear, quintic (smooth at both ends), or exponential (n grows by a "
        "constant factor over equal depths)",
    )

    def share(self, depth: float, ratio: float) -> float:
        """Return the share of the lower material at a relative depth, for a ratio of the indices."""
        if self.profile == "quintic":
            return depth**3 * (10.0 - 15.0 * depth + 6.0 * depth**2)
        if self.profile == "exponential" and abs(ratio - 1.0) > 1e-9:
            return float((ratio**depth - 1.0) / (ratio - 1.0))
        return depth


class GradedLayerSpec(RecipeModel):
    """A layer whose material changes with depth, solved as slices."""

    graded: GradedSpec = Field(description="the two materials and the course between them")
    thickness_nm: Annotated[float, Field(ge=0.0, le=MAX_COHERENT_NM)] = Field(
        description="geometric thickness", examples=[300]
    )


def _layer_form(value: Any) -> str:
    if isinstance(value, RepeatSpec) or (isinstance(value, Mapping) and ("repeat" in value or "layers" in value)):
        return "Repeat"
    is_graded = isinstance(value, GradedLayerSpec) or (isinstance(value, Mapping) and "graded" in value)
    return "Graded" if is_graded else "Layer"


class RepeatSpec(RecipeModel):
    """A group of layers, repeated."""

    repeat: Annotated[int, Field(ge=0, le=MAX_LAYERS)] = Field(description="number of times", examples=[10])
    layers: tuple[AnyLayer, ...] = Field(
        min_length=1, max_length=MAX_LAYERS, description="the layers of one group, from the light inward"
    )


AnyLayer = Annotated[
    Annotated[LayerSpec, pydantic.Tag("Layer")]
    | Annotated[GradedLayerSpec, pydantic.Tag("Graded")]
    | Annotated[RepeatSpec, pydantic.Tag("Repeat")],
    pydantic.Discriminator(_layer_form),
]
RepeatSpec.model_rebuild()


@dataclass(frozen=True)
class LayerBuilder:
    """Builds the layers of a recipe.

    Attributes:
        context: recipe context.
        medium: builds a material with the recipe's rule for extrapolation.
    """

    context: RecipeContext
    medium: Callable[[IndexSpec | AnisotropicSpec], Any]

    def build(self, specs: tuple[Any, ...], path: str = "layers", is_repeated: bool = False) -> Iterator[FilmLayer]:
        """Yield the layers; those inside a group are repeated."""
        for i, spec in enumerate(specs):
            here = f"{path}[{i}]"
            if isinstance(spec, RepeatSpec):
                group = list(self.build(spec.layers, f"{here}.layers", True))
                for _ in range(spec.repeat):
                    yield from group
            elif isinstance(spec, GradedLayerSpec):
                yield from self._slices(spec, here)
            else:
                yield self._layer(spec, here, is_repeated)

    def _layer(self, spec: LayerSpec, path: str, is_repeated: bool) -> FilmLayer:
        thickness: float | Texture
        key = f"{path}.thickness_nm"
        if isinstance(spec.thickness_nm, TextureSpec):
            if is_repeated or spec.helix is not None:
                what = "a repeated layer" if is_repeated else "a twisted layer"
                raise self.context.fail(key, "{...}", f"cannot vary over the surface in {what}; give a number")
            thickness = spec.thickness_nm.build(self.context, key)
            limit = MAX_THICKNESS_NM if spec.incoherent else MAX_COHERENT_NM
            if not 0.0 <= thickness.low <= thickness.high <= limit:
                raise self.context.fail(
                    key, f"{thickness.low:g} ... {thickness.high:g}", f"leaves the range 0 ... {limit:g} nm; "
                    "give min and max to clip it",
                )  # fmt: skip
        else:
            thickness = float(spec.thickness_nm)
        return FilmLayer(self.medium(spec.material), thickness, spec.incoherent, spec.helix, path)

    def _slices(self, spec: GradedLayerSpec, path: str) -> Iterator[FilmLayer]:
        upper, lower = self.medium(spec.graded.start), self.medium(spec.graded.to)
        low, high = max(upper.range_nm[0], lower.range_nm[0]), min(upper.range_nm[1], lower.range_nm[1])
        waves = np.unique(np.clip(GRADED_PROBE_NM, low, high))
        ends = np.stack([upper.n_complex(waves), lower.n_complex(waves)])
        ratio = float(np.mean(ends[1].real / ends[0].real))
        shares = None
        before = None  # the error of midpoint slices falls by four: a third of the change remains
        for count in SLICES:
            shares = [spec.graded.share((i + 0.5) / count, ratio) for i in range(count)]
            n = np.stack([np.ones_like(waves), *((1 - s) * ends[0] + s * ends[1] for s in shares), ends[1]])
            spectra = powers(n, [spec.thickness_nm / count] * count, waves, np.radians([0.0, 60.0])).reflectance
            if before is not None and np.max(np.abs(spectra - before)) < 3.0 * GRADED_ERROR:
                break
            before = spectra
        assert shares is not None
        for share in shares:
            model = Mixture((upper, lower), (1.0 - share, share), "linear")
            name = f"{upper.name} to {lower.name}"
            medium = OpticalConstant(name, model, "a slice of a graded layer", extrapolate=upper.extrapolate)
            yield FilmLayer(medium, spec.thickness_nm / len(shares), False, None, path)


def with_interface_layers(
    layers: list[FilmLayer],
    ends: tuple[Medium, Medium],
    roughness_nm: float | tuple[float, ...],
    context: RecipeContext,
) -> list[FilmLayer]:
    """Return layers with an effective medium at each rough interface: Bruggeman's mixture of equal parts.

    It takes half its thickness from each adjacent layer, which preserves the total thickness.

    Args:
        layers: from the light inward.
        ends: ambient and substrate.
        roughness_nm: one roughness, or one for each interface from the light inward.
        context: recipe context, for messages.

    Raises:
        RecipeError: a wrong value count; an anisotropic or varying layer at a rough interface; a layer thinner
            than its interfaces.
    """
    key = "surface.interface_roughness_nm"
    count = len(layers) + 1
    depths_nm = list(roughness_nm) if isinstance(roughness_nm, tuple) else [roughness_nm] * count
    if len(depths_nm) != count:
        raise context.fail(key, depths_nm, f"has {len(depths_nm)} values; the film has {count} interfaces")
    media = [ends[0], *(layer.material for layer in layers), ends[1]]
    same_piece = [0 < i < count - 1 and _is_slice(layers[i - 1], layers[i]) for i in range(count)]
    depths = [0.0 if same or a == b else d for d, same, a, b in zip(depths_nm, same_piece, media[:-1], media[1:])]
    made: list[FilmLayer] = []
    for i in range(count):
        if depths[i] > 0.0:
            pair = media[i], media[i + 1]
            if not all(isinstance(medium, OpticalConstant) for medium in pair):
                raise context.fail(
                    key, depths[i], f"cannot be used at interface {i}: an anisotropic medium has no mixture"
                )
            name = f"{pair[0].name} with {pair[1].name}"
            mixed = OpticalConstant(name, Mixture(pair, (0.5, 0.5)), "a rough interface")  # type: ignore[arg-type]
            made.append(FilmLayer(mixed, depths[i], path=key))
        if i < len(layers):
            made.append(_thinned(layers[i], 0.5 * (depths[i] + depths[i + 1]), roughness_nm, context))
    return made


def _is_slice(one: FilmLayer, other: FilmLayer) -> bool:
    return one.path == other.path and "graded" in one.material.source and "graded" in other.material.source


def _thinned(layer: FilmLayer, loss_nm: float, depth: float | tuple[float, ...], context: RecipeContext) -> FilmLayer:
    if loss_nm == 0.0:
        return layer
    if isinstance(layer.thickness_nm, Texture):
        raise context.fail(
            f"{layer.path}.thickness_nm", "{...}", "cannot vary over the surface beside a rough interface"
        )
    if layer.thickness_nm < loss_nm:
        raise context.fail(
            "surface.interface_roughness_nm", depth, f"is wider than {layer.path} of {layer.thickness_nm:g} nm, "
            "from which the interfaces take half of their thickness",
        )  # fmt: skip
    return FilmLayer(layer.material, layer.thickness_nm - loss_nm, layer.incoherent, layer.helix, layer.path)
