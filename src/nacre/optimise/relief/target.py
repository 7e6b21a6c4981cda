"""Relief target file: target pictures, process and search budget.

The keys are public: add keys, do not rename them. Target pictures are display-referred over slice directions, which are
half-vector sums (u, v) = (w_i + w_o)_xy; u runs along array axis 0. Shapes and default widths are the published ones.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from pathlib import Path
from tokenize import TokenError
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic

from nacre.bsdf.texture import LARGEST_16_BIT, MAX_IMAGE_PIXELS, opacity, opened_image, upright
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, RecipeError, did_you_mean
from nacre.core.files import plain, why_unreadable
from nacre.families.relief.diffraction_orders import CoherenceSpec, coating_reflectance, fresnel_reflectance
from nacre.families.relief.plane_cut import CutGeometry
from nacre.formats.layouts import find_calibration
from nacre.light import hex_to_srgb, spectrum_to_rgb_linear
from nacre.matter.indices.spec import IndexSpec
from nacre.optimise.relief.merit import GAMMA, ColourWeights, Problem, View, default_weights, published_weights
from nacre.readers.curves import FileSpec, recipe_spectrum
from nacre.recipe.model import NotNegative, Positive, RecipeContext, RecipeModel, UnitNumber, show_value

if TYPE_CHECKING:
    from PIL.Image import Image


Field = pydantic.Field
KINDS = ("anti-mirror", "anisotropic-anti-mirror", "gaussian", "uniform", "image", "inverted-image", "array")
# the published names are accepted too
KIND_ALIASES = {
    "anti_mirror": "anti-mirror",
    "aniso_anti_mirror": "anisotropic-anti-mirror",
    "diffuse": "gaussian",
    "image_scale": "image",
    "image_inverse": "inverted-image",
}
# default widths, in rad or (anisotropic) in half-vector units
WIDTHS = {"anti-mirror": 0.12, "gaussian": 0.15, "inverted-image": 0.20}
HOLES = {"anti-mirror": 0.05, "anisotropic-anti-mirror": 0.7}
LARGEST_TARGET_VALUES = 64_000_000
LARGEST_TILE_FEATURES = 512
# light share that a free-scale picture must contain; published designs contain 6 % or more
LEAST_LIGHT = 0.05
MAX_REFLECTANCE = 1.1  # allows for an instrument's white error
VISIBLE_THRESHOLD = 1e-3  # target values below this may lie beyond the horizon


class ColourSource(RecipeModel):
    """Colour from a file: an image over the slice, or a reflectance spectrum."""

    one_of: ClassVar[tuple[str, ...]] = ("image", "spectrum")
    forms: ClassVar[tuple[str, ...]] = ('{image = "colours.png"}', '{spectrum = "reflectance.csv"}')

    image: str | None = Field(
        default=None, description="an image of the colours over the slice", examples=["colours.png"]
    )
    spectrum: FileSpec | None = Field(
        default=None,
        description="a reflectance spectrum, as a file or a table with missing properties; its colour under D65",
        examples=["reflectance.csv"],
    )

    @pydantic.model_validator(mode="after")
    def _exactly_one(self) -> ColourSource:
        if (self.image is None) == (self.spectrum is None):
            raise ValueError("target.colour: give exactly one of image and spectrum")
        return self


class TargetTable(RecipeModel):
    """Target picture over slice directions."""

    forms: ClassVar[tuple[str, ...]] = (
        '{kind = "anti-mirror", range = 0.5}',
        '{kind = "image", image = "grey.png", range = 0.4, colour = "#ffcc00"}',
    )

    kind: str = Field(
        json_schema_extra={"enum": [*KINDS, *KIND_ALIASES]}, description="type of picture", examples=["anti-mirror"]
    )
    image: str | None = Field(
        default=None,
        description="image file of the types image and inverted-image; transparent areas are dark",
        examples=["grey.png"],
    )
    image_scale: Positive = Field(default=1.5, description="size of the image over the directions, by its longer side")
    file: str | None = Field(
        default=None, description="a .npy array over the slice, for the type array", examples=["look.npy"]
    )
    colour: str | ColourSource = Field(
        default="white",
        description="a name, #rrggbb, iridescent-half, iridescent-disk, or a table with a file",
        examples=["white", "#ffcc00", "iridescent-disk", {"spectrum": "reflectance.csv"}],
    )
    iridescent_range: Positive = Field(default=0.06, description="radius at which iridescent colours change")
    width: Positive | None = Field(default=None, description="width of the lobe in rad", examples=[0.12])
    hole: Positive | None = Field(default=None, description="width of the dark centre", examples=[0.05])
    cone: Positive | None = Field(default=None, description="radius of a uniform picture", examples=[0.3])
    range: Annotated[float, Field(gt=0.0, le=2.0)] = Field(
        description="half the side of the slice, in components of wi + wo", examples=[0.5]
    )
    resolution: Annotated[int, Field(ge=4, le=1024)] = Field(
        default=64, description="number of directions along a side of the slice"
    )
    intensity_scale: Positive | Literal["free"] = Field(
        default="free", description="brightness of the picture: a fixed scale, or the best one", examples=["free", 2.0]
    )
    brightness_floor: NotNegative | None = Field(
        default=None,
        description="least brightness with a free scale; default: 5 % of the light inside the picture",
        examples=[0.1],
    )
    incidence_deg: tuple[tuple[float, float], ...] | None = Field(
        default=None,
        description="directions of the light, each [theta, phi]; default: those of the search",
        examples=[[[0, 0], [30, 0]]],
    )

    @pydantic.field_validator("kind")
    @classmethod
    def _known_kind(cls, kind: str) -> str:
        name = KIND_ALIASES.get(kind, kind)
        if name not in KINDS:
            raise ValueError(
                f'target.kind = "{kind}" is not known.{did_you_mean(kind, [*KINDS, *KIND_ALIASES])} '
                f"Kinds: {', '.join(KINDS)}"
            )
        return name

    @pydantic.model_validator(mode="after")
    def _has_its_file(self) -> TargetTable:
        if self.kind in ("image", "inverted-image") and self.image is None:
            raise ValueError(f'target.image is missing; kind = "{self.kind}" needs one')
        if self.kind == "array" and self.file is None:
            raise ValueError('target.file is missing; kind = "array" needs a .npy of [x, y] or [x, y, 3] in 0..1')
        return self

    def least_brightness(self, picture: Array) -> float:
        """Return the floor for 1 / scale: as given, or such that the picture contains the light share `LEAST_LIGHT`.

        A perfect reflector's BRDF integrates to 1 over (u, v); therefore a picture with mean m over a slice with
        area A, shown at a scale, contains the share m A / scale.
        """
        if self.brightness_floor is not None:
            return self.brightness_floor
        mean = float(np.mean(np.asarray(picture) ** GAMMA))
        return LEAST_LIGHT / max(mean * (2.0 * self.range) ** 2, 1e-12)

    def build(self, wi: Array, context: RecipeContext) -> Array:
        """Return the display-referred target `[x, y, 3]` for light from `wi`.

        Raises:
            RecipeError: an image, array or colour cannot be used, or the target lies below the horizon.
        """
        axis = slice_axis(self.range, self.resolution)
        u, v = np.broadcast_arrays(axis[:, None], axis[None, :])
        picture = self._shape(u, v, wi, context) * self._colour(u, v, context)
        hidden = (u - wi[0]) ** 2 + (v - wi[1]) ** 2 >= 1.0
        if (picture[hidden] > VISIBLE_THRESHOLD).any():
            theta = float(np.degrees(np.arcsin(np.hypot(wi[0], wi[1]))))
            allowed = f"reaches outside the hemisphere for light at {theta:.3g} degrees; reduce it"
            raise context.fail("target.range", self.range, allowed)
        return np.where(hidden[..., None], 0.0, picture)

    def _shape(self, u: Array, v: Array, wi: Array, context: RecipeContext) -> Array:
        width, hole = self.width or WIDTHS.get(self.kind, 0.0), self.hole or HOLES.get(self.kind, 0.0)
        if self.kind == "anti-mirror":
            return anti_mirror(u, v, wi, hole, width)[..., None]
        if self.kind == "anisotropic-anti-mirror":
            return anisotropic_anti_mirror(u, v, wi, hole)[..., None]
        if self.kind == "uniform":
            inside = np.ones_like(u) if self.cone is None else (np.hypot(u, v) <= self.cone).astype(float)
            return inside[..., None]
        if self.kind == "array":
            return self._array(context)
        lobe = gaussian(mirror_angle(u, v, wi), width)[..., None] if width else np.zeros(1)
        if self.kind == "gaussian":
            return lobe
        assert self.image is not None
        image = load_picture(context.path(self.image), f"{context.source}: target.image")
        shape = picture_on_directions(image, u, v, self.image_scale)
        return shape if self.kind == "image" else lobe * (1.0 - shape)

    def _array(self, context: RecipeContext) -> Array:
        assert self.file is not None
        try:
            values = np.load(plain(context.path(self.file)), allow_pickle=False)
        except OSError as error:
            raise context.fail("target.file", self.file, why_unreadable(error)) from None
        except (ValueError, EOFError, AttributeError, SyntaxError, TokenError, TypeError) as error:
            raise context.fail("target.file", self.file, f"is not a .npy array: {error}") from None
        size = self.resolution
        if values.shape not in ((size, size), (size, size, 3)) or values.dtype.kind not in "fiub":
            allowed = f"contains {values.dtype}{list(values.shape)}; it should be [{size}, {size}(, 3)]"
            raise context.fail("target.file", self.file, allowed)
        values = values.astype(float)
        if not np.isfinite(values).all() or values.min() < 0.0:
            raise context.fail("target.file", self.file, "contains values that are negative or not finite")
        return values if values.ndim == 3 else values[..., None]

    def _colour(self, u: Array, v: Array, context: RecipeContext) -> Array:
        if isinstance(self.colour, str):
            return colour_on_directions(self.colour, u, v, self.iridescent_range, context.source)
        if self.colour.image is not None:
            where = f"{context.source}: target.colour.image"
            image = load_picture(context.path(self.colour.image), where, is_stretched=True)
            return picture_on_directions(image, u, v, self.range / 2.0 / HALF_VECTOR_PER_SCALE)
        assert self.colour.spectrum is not None
        return np.broadcast_to(_spectrum_colour(self.colour.spectrum, context), (*u.shape, 3))


class SearchTable(RecipeModel):
    """Search budget and robustness; all keys are optional."""

    forms: ClassVar[tuple[str, ...]] = (
        "{seconds = 20}",
        "{starts = 16, levels = 8, incidence_deg = [[0, 0], [30, 0]]}",
    )

    starts: Annotated[int, Field(ge=1, le=256)] = Field(default=8, description="number of random starts")
    perturbed_restarts: Annotated[int, Field(ge=0, le=10_000)] = Field(
        default=40, description="restarts from perturbed copies of the best design, while time remains"
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=1, description="seed of the starts")
    seconds: Positive | None = Field(default=60.0, description="time limit; the best design so far is the result")
    noise: UnitNumber = Field(
        default=0.0, description="relative noise of each height, by the process, to be robust against"
    )
    blur_error: Annotated[float, Field(ge=0.0, le=0.9)] = Field(
        default=0.0, description="relative error of the blur to be robust against"
    )
    levels: Annotated[int, Field(ge=0, le=256)] = Field(
        default=0, description="number of heights that the process can make; 0: any"
    )
    incidence_deg: tuple[tuple[float, float], ...] = Field(
        default=((0.0, 0.0),), description="directions of the light, each [theta, phi]"
    )

    refine: Literal["vector"] | None = Field(
        default=None,
        description="improve the found heights by Maxwell's equations, in the second half of the time: for tiles of "
        "few features and a short period",
        examples=["vector"],
    )

    @pydantic.model_validator(mode="after")
    def _levels_are_two_or_more(self) -> SearchTable:
        if self.levels == 1:
            raise ValueError("search.levels = 1 is not allowed; it should be 0 (any height) or at least 2")
        return self


class TargetSpec(RecipeModel):
    """Relief design target."""

    example: ClassVar[Mapping[str, Any]] = {
        "family": "relief",
        "feature_um": 2,
        "blur_um": 0.6,
        "height_max_um": 0.5,
        "coherence": {"sigma": 5},
        "target": {"kind": "anti-mirror", "range": 0.5},
        "search": {"seconds": 20},
    }

    family: Literal["relief"] = Field(default="relief", description="the family that is designed")
    features: Annotated[int, Field(ge=2, le=LARGEST_TILE_FEATURES)] = Field(
        default=32, description="number of features along a side of the tile"
    )
    feature_um: Positive = Field(description="pitch of the features", examples=[2])
    blur_um: Positive = Field(description="standard deviation of the Gaussian blur of the process", examples=[0.6])
    height_max_um: Positive = Field(description="largest height that the process can make", examples=[0.5])
    calibration: str | None = Field(
        default=None,
        description="CSV of grey value and depth of the process, or `published`; a deeper target is refused",
    )
    coating: IndexSpec = Field(
        default_factory=lambda: IndexSpec.model_validate("Al"), description="metal of the surface, opaque"
    )
    coherence: CoherenceSpec = Field(description="coherence of the light (angular size of the lamp)")
    spectrum: Literal["published-8", "default"] = Field(
        default="default", description="wavelengths of the colour: the published eight, or the default grid"
    )
    prefactor: Literal["kirchhoff", "published"] | None = Field(
        default=None,
        description="prefactor of the diffraction integral; default: as published with the published spectrum, else "
        "the one that conserves energy",
    )
    target: TargetTable = Field(description="target picture")
    targets: tuple[TargetTable, ...] = Field(default=(), description="more target pictures of the same relief")
    search: SearchTable = Field(default=SearchTable(), description="budget and robustness of the search")

    @property
    def chosen_prefactor(self) -> Literal["kirchhoff", "published"]:
        """Prefactor as given; default: as published with the published spectrum, else energy-conserving."""
        return self.prefactor or ("published" if self.spectrum == "published-8" else "kirchhoff")

    def build(self, context: RecipeContext) -> Problem:
        """Return the design problem.

        Raises:
            RecipeError: a file, colour, direction or window cannot be used, or the process cannot make such depths.
        """
        self._check_process(context)
        coherence = self.coherence.build()
        spectrum = self._spectrum()
        self._check_window(coherence.width_in_wavelengths, spectrum, context)
        tables = (self.target, *self.targets)
        if sum(t.resolution**2 for t in tables) * len(spectrum.wavelengths_nm) > LARGEST_TARGET_VALUES:
            raise context.fail("target.resolution", self.target.resolution, "asks for too many directions at once")
        scale = self.target.intensity_scale
        views = tuple(self._view(table, spectrum, context) for table in tables)
        return Problem(
            features=self.features,
            feature_nm=1e3 * self.feature_um,
            blur_nm=1e3 * self.blur_um,
            height_max_nm=1e3 * self.height_max_um,
            coherence=coherence,
            views=views,
            intensity_scale=None if scale == "free" else scale,
            prefactor=self.chosen_prefactor,
            brightness_floor=self.target.least_brightness(views[0].target),
            noise=self.search.noise,
            blur_error=self.search.blur_error,
            levels=self.search.levels,
        )

    def _spectrum(self) -> ColourWeights:
        if self.spectrum == "default":
            return default_weights()
        if self.coating.name == "Al":
            return published_weights(None)
        constant = self.coating.build()
        return published_weights(lambda nm: fresnel_reflectance(np.ones(()), constant.n_complex(nm)))

    def _check_process(self, context: RecipeContext) -> None:
        """Refuse heights that the process cannot make."""
        if self.calibration is None:
            return
        try:
            context.path(self.calibration)  # notes the file as a dependency
            curve = find_calibration(self.calibration, context.folder)
        except NacreError as error:
            raise context.fail("calibration", self.calibration, f"cannot be used: {error}") from None
        if self.height_max_um > curve.range_um * (1 + 1e-9):
            allowed = (
                f"is deeper than the process of calibration = {show_value(self.calibration)} makes: "
                f"{curve.range_um:.4g} um; lower it, or name another process"
            )
            raise context.fail("height_max_um", self.height_max_um, allowed)

    def _check_window(self, width: float, spectrum: ColourWeights, context: RecipeContext) -> None:
        window_um = width * float(spectrum.wavelengths_nm.max()) / 1e3
        period_um = self.features * self.feature_um
        if window_um > period_um / 2.0:
            allowed = (
                f"gives a window of {window_um:.3g} um, more than half the tile of {period_um:.3g} um: the tile's "
                "repetition would be visible; take a larger tile or a smaller window"
            )
            raise context.fail("coherence", self.coherence.model_dump(exclude_none=True), allowed)

    def _view(self, table: TargetTable, spectrum: ColourWeights, context: RecipeContext) -> View:
        incidences = table.incidence_deg or self.search.incidence_deg
        directions = [_incidence(theta, phi, context) for theta, phi in incidences]
        axis = slice_axis(table.range, table.resolution)
        geometry = CutGeometry(axis, axis, np.stack(directions), spectrum.wavelengths_nm)
        target = np.stack([table.build(wi, context) for wi in directions])
        if not target.any():
            raise RecipeError(f"{context.source}: the target is black everywhere; give a picture with bright areas")
        reflectance = None
        if not spectrum.has_fresnel:
            reflectance = coating_reflectance(self.coating.build().n_complex(spectrum.wavelengths_nm))
        return View(geometry, target, spectrum.rgb_weights, reflectance)


def _incidence(theta_deg: float, phi_deg: float, context: RecipeContext) -> Array:
    if not 0.0 <= theta_deg < 90.0:
        allowed = "is outside the hemisphere; theta is in [0, 90)"
        raise context.fail("search.incidence_deg", [theta_deg, phi_deg], allowed)
    return direction(math.radians(theta_deg), math.radians(phi_deg))


def _spectrum_colour(entry: FileSpec, context: RecipeContext) -> Array:
    """Return a reflectance spectrum's display-referred colour under D65."""
    key = "target.colour.spectrum"
    table, name = recipe_spectrum(context, key, entry, ("reflectance",)), entry.file
    if len(table) < 2 or (np.diff(table[:, 0]) <= 0).any():
        raise context.fail(key, name, "should contain two columns, ascending nm and reflectance")
    if table[:, 1].min() < 0.0 or table[:, 1].max() > MAX_REFLECTANCE:
        raise context.fail(key, name, "should contain reflectances from 0 to 1; head a column in per cent '%'")
    rgb = spectrum_to_rgb_linear(table[:, 1], table[:, 0])
    return np.clip(rgb, 0.0, 1.0) ** (1.0 / GAMMA)


PUBLISHED_COLOURS: dict[str, tuple[float, float, float]] = {
    # display-referred published triples, which differ from CSS colours with equal names
    "red": (1.0, 0.0, 0.0),
    "orange": (1.0, 0.5, 0.0),
    "yellow": (1.0, 1.0, 0.0),
    "green": (0.0, 1.0, 0.0),
    "cyan": (0.0, 1.0, 1.0),
    "blue": (0.0, 0.0, 1.0),
    "purple": (0.5, 0.0, 1.0),
    "white": (1.0, 1.0, 1.0),
    "black": (0.0, 0.0, 0.0),
}
IRIDESCENT = ("iridescent-half", "iridescent-disk", "inverted-iridescent-disk")
COLOUR_ALIASES = {"iri": "iridescent-half", "disk_iri": "iridescent-disk", "inv_disk_iri": "inverted-iridescent-disk"}
RED, BLUE = np.array(PUBLISHED_COLOURS["red"]), np.array(PUBLISHED_COLOURS["blue"])
IMAGE_PIXELS = 512  # resampled image side, as published
HALF_VECTOR_PER_SCALE = 0.0625  # picture half width, in half-vector units, at image_scale 1


def slice_axis(half_range: float, resolution: int) -> Array:
    """Return `resolution` cell centres in (-half_range, half_range)."""
    return np.asarray(((np.arange(resolution) + 0.5) / resolution * 2.0 - 1.0) * half_range)


def mirror_angle(u: Array, v: Array, wi: Array) -> Array:
    """Return the angle between w_o = (u, v) - w_i and the mirror direction for `wi`; pi/2 below the horizon."""
    ox, oy = u - wi[0], v - wi[1]
    lateral = ox**2 + oy**2
    oz = np.sqrt(np.maximum(1.0 - lateral, 0.0))
    # the chord is accurate at small angles; arccos is not
    chord = np.sqrt(u**2 + v**2 + (oz - wi[2]) ** 2)
    return np.where(lateral <= 1.0, 2.0 * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0)), np.pi / 2)


def gaussian(angle: Array, width: float) -> Array:
    """Return exp(-angle^2 / (2 width^2))."""
    return np.asarray(np.exp(-0.5 * (angle / width) ** 2))


def anti_mirror(u: Array, v: Array, wi: Array, hole: float, width: float) -> Array:
    """Return a bright ring about the mirror direction, with a dark centre."""
    angle = mirror_angle(u, v, wi)
    return (1.0 - gaussian(angle, hole)) * gaussian(angle, width)


def anisotropic_anti_mirror(
    u: Array, v: Array, wi: Array, hole: float, width_x: float = 0.015, width_y: float = 0.06
) -> Array:
    """Return two lobes along y with a dark mirror direction, from the unit half vector."""
    angle = mirror_angle(u, v, wi)
    oz = np.sqrt(np.maximum(1.0 - (u - wi[0]) ** 2 - (v - wi[1]) ** 2, 0.0))
    length = np.sqrt(u**2 + v**2 + (wi[2] + oz) ** 2)
    normal_x = gaussian(u / length, width_x) / (width_x * np.sqrt(2.0 * np.pi))
    normal_y = gaussian(v / length, width_y) / (width_y * np.sqrt(2.0 * np.pi))
    # 1.8 is the published constant; the peak is then 1.028
    return (1.0 - gaussian(angle, hole)) * normal_x * normal_y / 1.8


def load_picture(path: Path, where: str, is_stretched: bool = False) -> Array:
    """Read an image as `[row, column, 3]` in 0..1, resampled to 512 x 512; transparent areas are black.

    The camera's orientation is applied. A rectangular image is padded with black bands.

    Args:
        path: the image.
        where: target file and key, for messages.
        is_stretched: stretch the image to the square; no padding.

    Raises:
        RecipeError: the image is missing, unreadable, too large or uniform.
    """
    from PIL import Image, ImageOps

    named = f'{where} = "{path}"'
    with opened_image(path, named, MAX_IMAGE_PIXELS) as image:
        flat = _on_black(upright(image))
        if np.ptp(np.asarray(flat)) == 0:
            hint = "; transparent areas are black: draw the bright parts" if opacity(image) is not None else ""
            raise RecipeError(f"{named} is blank; all pixels are equal{hint}")
        size = (IMAGE_PIXELS, IMAGE_PIXELS)
        bilinear = Image.Resampling.BILINEAR
        square = flat.resize(size, bilinear) if is_stretched else ImageOps.pad(flat, size, bilinear)
    values = np.asarray(square, dtype=float) / (1.0 if square.mode == "F" else 255.0)
    return np.repeat(values[..., None], 3, axis=-1) if values.ndim == 2 else values


def _on_black(image: Image) -> Image:
    """Return an opaque image: RGB, or 16-bit grey as floats from 0 to 1."""
    from PIL import Image as images

    if image.mode[0] in "IF":
        scale = 1.0 if image.mode == "F" else LARGEST_16_BIT
        return images.fromarray(np.clip(np.asarray(image, dtype=np.float32) / np.float32(scale), 0.0, 1.0))
    if opacity(image) is None:
        return image.convert("RGB")
    ground = images.new("RGBA", image.size, "black")
    ground.alpha_composite(image.convert("RGBA"))
    return ground.convert("RGB")


def picture_on_directions(picture: Array, u: Array, v: Array, image_scale: float) -> Array:
    """Sample a picture bilinearly at half vectors (u, v)/2, `[x, y, 3]`; 0 outside.

    The row index increases with u, the column index with v.
    """
    from scipy.ndimage import map_coordinates

    half_width = HALF_VECTOR_PER_SCALE * image_scale
    size = picture.shape[0]
    row = size / 2 * (1.0 + 0.5 * u / half_width)
    column = size / 2 * (1.0 + 0.5 * v / half_width)
    inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    channels = [map_coordinates(picture[..., c], [row, column], order=1, mode="nearest") for c in range(3)]
    return np.where(inside[..., None], np.stack(channels, axis=-1), 0.0)


def colour_on_directions(colour: str, u: Array, v: Array, iridescent_range: float, source: str) -> Array:
    """Return display-referred RGB `[..., 3]` for a named, hexadecimal or iridescent colour.

    Raises:
        RecipeError: the name is not known.
    """
    name = COLOUR_ALIASES.get(colour, colour)
    shape = np.broadcast_shapes(u.shape, v.shape)
    if name == "iridescent-half":
        is_blue = np.broadcast_to(v > 0, shape)
    elif name == "iridescent-disk":
        is_blue = u**2 + v**2 > iridescent_range**2
    elif name == "inverted-iridescent-disk":
        is_blue = u**2 + v**2 <= iridescent_range**2
    else:
        return np.broadcast_to(parse_colour(name, source), (*shape, 3))
    return np.where(is_blue[..., None], BLUE, RED)


def parse_colour(name: str, source: str) -> Array:
    """Return the display-referred triple in 0..1 for a published name or a hexadecimal value.

    Raises:
        RecipeError: neither a known name nor hexadecimal.
    """
    if name in PUBLISHED_COLOURS:
        return np.array(PUBLISHED_COLOURS[name])
    if name.startswith("#"):
        with contextlib.suppress(ValueError):
            return np.array(hex_to_srgb(name))
    allowed = [*PUBLISHED_COLOURS, *IRIDESCENT]
    raise RecipeError(
        f'{source}: target.colour = "{name}" is not known.{did_you_mean(name, allowed)} '
        f"It may be #rrggbb or one of {', '.join(allowed)}"
    )
