"""The recipe of a grating."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from nacre.bsdf.texture import TextureSpec
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.families.grating.material import Grating, GratingLayer, Spread, VaryingPeriod
from nacre.families.grating.profiles import MAX_FLAT_SLOPE, profile_of, read_profile
from nacre.families.grating.shapes import ShapeSpec, check_shapes, widest
from nacre.matter.indices.spec import IndexSpec, ambient_in
from nacre.matter.periodic.solve import LARGEST_TOLERANCE
from nacre.matter.periodic.structure import Cell, Profile
from nacre.recipe.model import RecipeContext, RecipeModel

MAX_LAYERS = 200
MAX_THICKNESS_NM = 100_000.0
MAX_PERIOD_NM = 100_000.0
MAX_CROSSED_NM = 5_000.0
MIN_PERIOD_NM = 10.0
MAX_RATIO = 4.0  # largest over smallest period that varies over the surface
STEP_NM, CROSSED_STEP_NM = 5.0, 10.0  # wavelength steps; guided modes give lines 5 to 20 nm wide
PROFILE_KEYS = {
    # key -> profiles that it describes
    "apex": ("triangle", "blazed"),
    "top": ("trapezoid",),
    "bottom": ("trapezoid",),
    "heights": ("file",),
    "file": ("file",),
}

Period = Annotated[float, Field(ge=MIN_PERIOD_NM, le=MAX_PERIOD_NM)]


class GratingLayerSpec(RecipeModel):
    """A layer, with shapes of other materials in it."""

    forms: ClassVar[tuple[str, ...]] = (
        '{thickness_nm = 130, material = "air", shapes = [{shape = "disc", material = "Si", diameter_nm = 140}]}',
        '{thickness_nm = 50, material = "SiO2"}',
    )

    thickness_nm: Annotated[float, Field(ge=0.0, le=MAX_THICKNESS_NM)] = Field(
        description="thickness; of a film on a profile along the vertical", examples=[130]
    )
    material: IndexSpec = Field(description="material around the shapes", examples=["air"])
    shapes: tuple[ShapeSpec, ...] = Field(
        default=(), max_length=100, description="shapes of other materials; they may not overlap"
    )


class LatticeSpec(RecipeModel):
    """The lattice: lines along y repeat along x, other cells along two directions."""

    forms: ClassVar[tuple[str, ...]] = (
        "{period_nm = 300}",
        "{period_nm = [300, 400]}",
        '{period_nm = {texture = "periods.png", min = 600, max = 1100}}',
        '{kind = "hexagonal", period_nm = 400}',
    )

    period_nm: Period | tuple[Period, Period] | TextureSpec = Field(
        description="period, or both periods of a cell; one that varies over the surface is solved at nodes 12 % apart",
        examples=[300, [300, 400]],
    )
    kind: Literal["line", "square", "hexagonal"] | None = Field(
        default=None, description="default: line if all shapes are lines, else square", examples=["hexagonal"]
    )
    angle_deg: Annotated[float, Field(ge=30.0, le=150.0)] | None = Field(
        default=None, description="angle between the two periods; default: 90, hexagonal 60", examples=[75]
    )

    def model_post_init(self, _: Any) -> None:
        if isinstance(self.period_nm, tuple):
            if self.kind in ("line", "hexagonal"):
                raise ValueError(f'kind = "{self.kind}" has one period; allowed: a single number in period_nm')
        elif self.kind == "line" and self.angle_deg is not None:
            raise ValueError("angle_deg has no meaning for lines; remove it")
        if self.kind == "square" and self.angle_deg not in (None, 90.0):
            raise ValueError(f'angle_deg = {self.angle_deg:g} does not fit kind = "square"; allowed: 90, or no kind')
        if self.kind == "hexagonal" and self.angle_deg not in (None, 60.0, 120.0):
            raise ValueError(f"angle_deg = {self.angle_deg:g} does not fit a hexagonal lattice; allowed: 60, 120")

    def build(self, is_lines: bool, period_nm: float = MIN_PERIOD_NM) -> Cell:
        """Return the cell.

        Args:
            period_nm: the period, where it varies over the surface.
        """
        kind = self.kind
        if isinstance(self.period_nm, tuple):
            return Cell(*self.period_nm, np.radians(90.0 if self.angle_deg is None else self.angle_deg))
        single = period_nm if isinstance(self.period_nm, TextureSpec) else self.period_nm
        if kind == "line" or (kind is None and is_lines and self.angle_deg is None):
            return Cell(single)
        default = 60.0 if kind == "hexagonal" else 90.0
        return Cell(single, single, np.radians(default if self.angle_deg is None else self.angle_deg))


class ProfileSpec(RecipeModel):
    """A continuous profile of the substrate's surface across the lines; films follow it."""

    forms: ClassVar[tuple[str, ...]] = (
        '{shape = "sinusoidal", depth_nm = 150}',
        '{shape = "triangle", depth_nm = 150, apex = 0.8}',
        '{shape = "file", depth_nm = 150, heights = "profile.csv"}',
    )

    shape: Literal["sinusoidal", "triangle", "blazed", "trapezoid", "file"] = Field(
        description="form of one period; it begins in a valley at x = 0, a sinusoid on a crest", examples=["sinusoidal"]
    )
    depth_nm: Annotated[float, Field(gt=0.0, le=MAX_THICKNESS_NM)] | None = Field(
        default=None, description="height of the crests above the valleys; of a file: default its own", examples=[150]
    )
    apex: Annotated[float, Field(ge=0.0, le=1.0)] | None = Field(
        default=None, description="share of the period where a triangle's crest lies; default: 0.5, blazed 0.9",
        examples=[0.8],
    )  # fmt: skip
    top: Annotated[float, Field(gt=0.0, lt=1.0)] | None = Field(
        default=None, description="share of the period of a trapezoid's flat top", examples=[0.3]
    )
    bottom: Annotated[float, Field(gt=0.0, lt=1.0)] | None = Field(
        default=None, description="share of the period of a trapezoid's flat valley", examples=[0.3]
    )
    heights: str | None = Field(
        default=None, description="a table of x and height in nm over one period", examples=["profile.csv"]
    )
    file: str | None = Field(default=None, description="the same as heights", examples=["profile.csv"])

    @classmethod
    def with_choice(cls, table: Mapping[str, Any], key: str, value: str) -> dict[str, Any]:
        """Return the table of another profile."""
        if key != "shape":
            return super().with_choice(table, key, value)
        flats = {"top": 0.3, "bottom": 0.3} if value == "trapezoid" else {}
        depth = {} if value == "file" else {"depth_nm": 100.0}
        others = {k: v for k, v in table.items() if value in PROFILE_KEYS.get(k, (value,))}
        return {**flats, **depth, **others, "shape": value}

    def model_post_init(self, _: Any) -> None:
        is_file = self.shape == "file"
        for key, shapes in PROFILE_KEYS.items():
            if getattr(self, key) is not None and self.shape not in shapes:
                raise ValueError(f'{key} has no meaning for shape = "{self.shape}"; allowed: {", ".join(shapes)}')
        if is_file and (self.heights or self.file) is None:
            raise ValueError('heights is missing; shape = "file" needs heights = "profile.csv"')
        if not is_file and self.depth_nm is None:
            raise ValueError(f'depth_nm is missing; shape = "{self.shape}" needs it')
        if self.shape == "trapezoid":
            if self.top is None or self.bottom is None:
                raise ValueError("top and bottom are missing; a trapezoid needs both shares of the period")
            if self.top + self.bottom >= 1.0:
                raise ValueError(
                    f"top = {self.top:g} and bottom = {self.bottom:g} leave no flanks; allowed: a sum below 1"
                )

    def build(self, context: RecipeContext, period_nm: float) -> Profile:
        """Return the profile.

        Raises:
            RecipeError: the file cannot be used, or a flank is a wall.
        """
        if self.shape == "file":
            name = self.heights or self.file
            assert name is not None
            made = read_profile(context, "profile.heights", name, period_nm, self.depth_nm)
        else:
            assert self.depth_nm is not None
            apex = self.apex if self.apex is not None else (0.9 if self.shape == "blazed" else 0.5)
            flank = {"sinusoidal": 0.3, "trapezoid": 0.5 * (1.0 - (self.top or 0) - (self.bottom or 0))}.get(
                self.shape, min(apex, 1.0 - apex)
            )
            if self.depth_nm > MAX_FLAT_SLOPE * flank * period_nm:
                key, value = (
                    ("profile.apex", apex)
                    if self.shape in ("triangle", "blazed")
                    else ("profile.depth_nm", self.depth_nm)
                )
                raise context.fail(
                    key,
                    value,
                    f"makes a flank steeper than {MAX_FLAT_SLOPE:g}; allowed: flatter ones, or layers of lines",
                )
            made = profile_of(self.shape, self.depth_nm, apex, self.top or 0.0, self.bottom or 0.0)
        return made


class OrdersSpec(RecipeModel):
    """Angular width of the orders, and disorder."""

    forms: ClassVar[tuple[str, ...]] = ("{spread_deg = 0.3}",)

    spread_deg: Annotated[float, Field(ge=0.02, le=10.0)] = Field(
        default=0.3, description="standard deviation of each order's direction (coherence, disorder, size of a patch)",
        examples=[0.3],
    )  # fmt: skip
    period_deviation_nm: Annotated[float, Field(ge=0.0, le=1e4)] = Field(
        default=0.0, description="standard deviation of the places: moves light from the orders to a diffuse part",
        examples=[5],
    )  # fmt: skip
    size_deviation_nm: Annotated[float, Field(ge=0.0, le=1e4)] = Field(
        default=0.0, description="standard deviation of the sizes: moves light from the orders to a diffuse part",
        examples=[4],
    )  # fmt: skip


class OrientationSpec(RecipeModel):
    """Turn of the lattice in the surface."""

    forms: ClassVar[tuple[str, ...]] = (
        "{turn_deg = 30}", '{turn_deg = {texture = "angles.png", min = 0, max = 180}}',
        '{turn_deg = {formula = "90*u"}}',
    )  # fmt: skip

    turn_deg: float | TextureSpec = Field(
        default=0.0, description="azimuth of the direction across the lines, from u towards v", examples=[30]
    )


class ModelSpec(RecipeModel):
    """Accuracy of the solution."""

    forms: ClassVar[tuple[str, ...]] = ("{tolerance = 1e-3}",)

    tolerance: Annotated[float, Field(ge=1e-7, le=LARGEST_TOLERANCE)] | None = Field(
        default=None,
        description="largest estimated error of an order's efficiency; default: lines 2e-4, profiles 5e-5, rectangles "
        "3e-3, other shapes 4e-3",
        examples=[1e-3],
    )


class WavelengthsSpec(RecipeModel):
    """Wavelength grid."""

    forms: ClassVar[tuple[str, ...]] = ("{min_nm = 400, max_nm = 700, step_nm = 20}",)

    min_nm: Annotated[float, Field(ge=100.0, le=1e5)] = Field(default=380.0, description="first wavelength of the grid")
    max_nm: Annotated[float, Field(ge=100.0, le=1e5)] = Field(default=780.0, description="last wavelength of the grid")
    step_nm: Annotated[float, Field(ge=0.5, le=1000.0)] | None = Field(
        default=None, description="step of the grid; default: 5 for lines and profiles, 10 for two periods",
        examples=[20],
    )  # fmt: skip

    def model_post_init(self, _: Any) -> None:
        if self.max_nm <= self.min_nm:
            raise ValueError(f"max_nm = {self.max_nm:g} must be above min_nm = {self.min_nm:g}")

    def grid(self, default_nm: float) -> Array:
        """Return the wavelengths, `default_nm` apart if the recipe states no step."""
        count = max(int(np.ceil((self.max_nm - self.min_nm) / (self.step_nm or default_nm) - 1e-9)), 1)
        return np.linspace(self.min_nm, self.max_nm, count + 1)


class GratingSpec(RecipeModel):
    """Layers with shapes that repeat in one or two directions, or a continuous profile of lines."""

    example: ClassVar[Mapping[str, Any]] = {
        "family": "grating",
        "substrate": "Al",
        "profile": {"shape": "sinusoidal", "depth_nm": 120},
        "lattice": {"period_nm": 800},
        "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 50},
    }

    varies: ClassVar[str] = "orientation.turn_deg, lattice.period_nm"

    family: Literal["grating"] = Field(default="grating", description="the family's name")
    title: str = Field(default="", description="a title for figures", examples=["Silicon pixels"])
    ambient: IndexSpec = Field(
        default=IndexSpec.model_validate("air"), description="medium above, on the side of the light"
    )
    substrate: IndexSpec = Field(description="medium below; a clear one transmits orders", examples=["glass"])
    layers: tuple[GratingLayerSpec, ...] = Field(
        default=(), max_length=MAX_LAYERS, description="the layers, from the light inward"
    )
    profile: ProfileSpec | None = Field(default=None, description="a continuous profile instead of shapes")
    lattice: LatticeSpec = Field(description="periods of the structure")
    orders: OrdersSpec = Field(default=OrdersSpec(), description="width of the orders, and disorder")
    orientation: OrientationSpec = Field(default=OrientationSpec(), description="turn of the lattice in the surface")
    model: ModelSpec = Field(default=ModelSpec(), description="accuracy of the solution")
    wavelengths: WavelengthsSpec = Field(default=WavelengthsSpec(), description="wavelength grid of the material")

    def model_post_init(self, _: Any) -> None:
        if self.profile is not None and any(layer.shapes for layer in self.layers):
            raise ValueError("profile and shapes exclude each other; remove one of the two")
        is_lines = self._is_lines
        cell = self.lattice.build(is_lines)
        if self.profile is not None and cell.period_y is not None:
            raise ValueError("lattice: a profile repeats along x only; allowed: a single period_nm")
        if cell.period_y is None and not is_lines:
            bad = next(s.kind for layer in self.layers for s in layer.shapes if s.kind != "line")
            raise ValueError(f'lattice.kind = "line" does not fit the shape "{bad}"; allowed: shapes of kind line')
        is_oblique = cell.period_y is not None and not cell.is_rectangular
        if is_oblique and any(s.kind == "line" for layer in self.layers for s in layer.shapes):
            raise ValueError(
                'lattice: lines along y do not repeat in an oblique cell; allowed: kind = "line", or a rectangular cell'
            )
        if cell.period_y is not None and max(cell.period_x, cell.period_y) > MAX_CROSSED_NM:
            raise ValueError(
                f"lattice.period_nm = {max(cell.period_x, cell.period_y):g} is too large for two periods; "
                f"allowed: at most {MAX_CROSSED_NM:g}"
            )

    @property
    def _is_lines(self) -> bool:
        return all(shape.kind == "line" for layer in self.layers for shape in layer.shapes)

    def _period(self, context: RecipeContext) -> VaryingPeriod | None:
        """Return the period over the surface, if it varies.

        Raises:
            RecipeError: it leaves the allowed range, or the structure is not periodic.
        """
        period = self.lattice.period_nm
        if not isinstance(period, TextureSpec):
            return None
        texture = period.build(context, "lattice.period_nm")
        most = MAX_PERIOD_NM if self.lattice.build(self._is_lines).period_y is None else MAX_CROSSED_NM
        if not MIN_PERIOD_NM <= texture.low <= texture.high <= most:
            raise RecipeError(
                f"{context.source}: lattice.period_nm varies from {texture.low:g} to {texture.high:g}; "
                f"allowed: {MIN_PERIOD_NM:g} to {most:g}"
            )
        if self.profile is not None and self.profile.shape == "file":
            raise RecipeError(
                f"{context.source}: lattice.period_nm varies, but profile.heights has a period of its own; allowed: "
                "one period, or another shape of the profile"
            )
        if texture.high > MAX_RATIO * texture.low:
            raise RecipeError(
                f"{context.source}: lattice.period_nm varies from {texture.low:g} to {texture.high:g}; allowed: up to "
                f"{MAX_RATIO:g} times the smallest"
            )
        return VaryingPeriod(texture)

    def build(self, context: RecipeContext) -> Grating:
        """Return the material.

        Raises:
            RecipeError: shapes overlap or leave the cell, or a file cannot be used.
        """
        period = self._period(context)
        cells = [self.lattice.build(self._is_lines, p) for p in (period.nodes if period else (MIN_PERIOD_NM,))]
        cell = cells[0]  # the smallest one, in which all shapes must fit
        layers = []
        for i, layer in enumerate(self.layers):
            named, shapes = [], []
            height = layer.thickness_nm
            for k, shape in enumerate(layer.shapes):
                key = f"layers[{i}].shapes[{k}]"
                material = shape.material.build(context)
                wall = shape.wall(context, key, height)
                for part in shape.geometry(context, key, cell):
                    named.append((key, widest(part, wall, height)))
                    shapes.append((part, material, wall))
            if (wrong := check_shapes(named, cell)) is not None:
                raise RecipeError(f"{context.source}: {wrong}; allowed: shapes inside the cell that do not overlap")
            layers.append(GratingLayer(layer.thickness_nm, layer.material.build(context), tuple(shapes)))
        turn = self.orientation.turn_deg
        texture = turn.build(context, "orientation.turn_deg") if isinstance(turn, TextureSpec) else None
        is_flat = self.profile is None and not any(layer.shapes for layer in self.layers)
        if is_flat and (texture is not None or period is not None):
            key = "orientation.turn_deg" if texture is not None else "lattice.period_nm"
            raise RecipeError(
                f"{context.source}: {key} varies, but the layers have no shapes and so no direction; "
                "allowed: a profile, or layers with shapes"
            )
        if period is not None:
            cell = self.lattice.build(self._is_lines, period.texture.middle)
        return Grating(
            ambient=ambient_in(self.ambient, "ambient" in self.model_fields_set, context),
            layers=tuple(layers),
            substrate=self.substrate.build(context),
            cell=cell,
            profile=None if self.profile is None else self.profile.build(context, cell.period_x),
            spread=Spread(
                float(np.radians(self.orders.spread_deg)),
                self.orders.period_deviation_nm,
                self.orders.size_deviation_nm,
            ),
            turn_deg=0.0 if isinstance(turn, TextureSpec) else float(turn),
            turn=texture,
            period=period,
            tolerance=self.model.tolerance,
            grid_nm=tuple(self.wavelengths.grid(STEP_NM if cell.period_y is None else CROSSED_STEP_NM)),
            is_coarse=context.is_low_fidelity and self.model.tolerance is None,
        )
