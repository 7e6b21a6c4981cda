"""Shapes of a cell in a recipe, and their geometry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from nacre.bsdf.texture import read_grey
from nacre.core.arrays import interpolate_periodic
from nacre.core.errors import RecipeError
from nacre.core.files import plain, why_unreadable
from nacre.matter.indices.spec import IndexSpec
from nacre.matter.periodic.crossed_solver import box, cell_grid
from nacre.matter.periodic.structure import Cell, Rectangle, Region, Shape, Wall, inset
from nacre.matter.periodic.types import Array
from nacre.recipe.model import RecipeContext, RecipeModel

Length = Annotated[float, Field(gt=0.0, le=1e6)]
Place = Annotated[float, Field(ge=-1e6, le=1e6)]
KINDS = ("line", "rectangle", "disc", "ellipse", "ring", "cross", "polygon", "image", "gds")
SIZES = {
    # shape -> keys of its size, all needed
    "line": ("width_nm",),
    "rectangle": ("width_nm",),
    "disc": ("diameter_nm",),
    "ellipse": ("width_nm", "length_nm"),
    "ring": ("diameter_nm", "inner_diameter_nm"),
    "cross": ("width_nm", "length_nm"),
    "polygon": ("points_nm",),
    "image": ("file",),
    "gds": ("gds",),
}
OWN = {
    # key -> shapes that it describes
    "width_nm": ("line", "rectangle", "ellipse", "cross"),
    "length_nm": ("rectangle", "ellipse", "cross"),
    "size_nm": ("rectangle", "ellipse", "cross"),
    "diameter_nm": ("disc", "ring"),
    "inner_diameter_nm": ("ring",),
    "points_nm": ("polygon",),
    "file": ("image",),
    "gds": ("gds",),
    "cell": ("gds",),
    "layer": ("gds",),
}
# key -> new shapes that keep it
LEFT = {"corner_radius_nm": ("rectangle",), "rotation_deg": KINDS[1:7], "center_nm": KINDS[:7]}
NEW_NM = 100.0  # size of a shape that replaces a drawing
MAX_PIXELS = 1024
SAMPLES = 256  # a side, in the search for overlaps
LEAST_EXTENT = 1e-3  # smallest extent of a GDS drawing, in periods


class ShapeSpec(RecipeModel):
    """A shape in the unit cell, one material over the full layer height; coordinates start at the cell's centre."""

    forms: ClassVar[tuple[str, ...]] = (
        '{shape = "line", material = "Ag", width_nm = 120}',
        '{shape = "disc", material = "Si", diameter_nm = 140}',
        '{shape = "rectangle", material = "Si", width_nm = 120, length_nm = 90}',
    )

    shape: Literal["line", "rectangle", "disc", "ellipse", "ring", "cross", "polygon", "image", "gds"] | None = Field(
        default=None, description="kind of shape; a line lies along y", examples=["disc"]
    )
    material: IndexSpec = Field(description="material of the shape", examples=["Si"])
    center_nm: tuple[Place, Place] = Field(
        default=(0.0, 0.0), description="its centre, from the centre of the cell", examples=[[50, 0]]
    )
    width_nm: Length | None = Field(
        default=None, description="size along x; of a cross the width of its arms", examples=[120]
    )
    length_nm: Length | None = Field(
        default=None, description="size along y (rectangle: default the width); of a cross the length of its arms",
        examples=[200],
    )  # fmt: skip
    size_nm: tuple[Length, Length] | None = Field(
        default=None, description="sizes along x and y at once, instead of width_nm and length_nm", examples=[[120, 90]]
    )
    diameter_nm: Length | None = Field(default=None, description="diameter of a disc or a ring", examples=[140])
    inner_diameter_nm: Length | None = Field(default=None, description="inner diameter of a ring", examples=[80])
    rotation_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = Field(
        default=0.0, description="turn about its centre, from x towards y", examples=[30]
    )
    sidewall_deg: Annotated[float, Field(ge=30.0, le=150.0)] = Field(
        default=90.0, description="angle between wall and base inside the shape: 90 vertical, less where it narrows "
        "upward; sizes are those at half the height", examples=[82],
    )  # fmt: skip
    rounding_nm: Annotated[float, Field(ge=0.0, le=1e5)] = Field(
        default=0.0, description="radius that rounds the upper edge", examples=[20]
    )
    corner_radius_nm: Annotated[float, Field(ge=0.0, le=1e5)] = Field(
        default=0.0, description="radius of the corners of a rectangle, seen from above", examples=[15]
    )
    points_nm: tuple[tuple[Place, Place], ...] | None = Field(
        default=None, min_length=3, max_length=1000, description="corners of a polygon, from its centre",
        examples=[[[-60, -50], [60, -50], [0, 70]]],
    )  # fmt: skip
    file: str | None = Field(
        default=None, description="a grey image of the whole cell: the shape is where it is brighter than a half",
        examples=["cell.png"],
    )  # fmt: skip
    gds: str | None = Field(default=None, description="a GDS file: the shape is its polygons", examples=["cell.gds"])
    cell: str | None = Field(default=None, description="name of the GDS cell; default: its only top cell")
    layer: Annotated[int, Field(ge=0, le=65535)] = Field(default=1, description="layer of the GDS file")

    @classmethod
    def with_choice(cls, table: Mapping[str, Any], key: str, value: str) -> dict[str, Any]:
        """Return the table of another shape, as large as the former one."""
        if key != "shape" or value not in SIZES:
            return super().with_choice(table, key, value)
        width, length = _sides(table)
        sizes: dict[str, Any] = {"width_nm": width, "diameter_nm": width, "inner_diameter_nm": 0.5 * width}
        sizes["points_nm"] = [[0.5 * x * width, 0.5 * y * length] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        if value != "rectangle" or length != width:
            sizes["length_nm"] = length
        if value == "cross":
            thin, sizes["length_nm"] = sorted((width, length))
            sizes["width_nm"] = min(thin, 0.4 * sizes["length_nm"])
        others = {k: v for k, v in table.items() if k not in OWN and value in LEFT.get(k, KINDS)}
        added = (*SIZES[value], "length_nm") if value == "rectangle" else SIZES[value]
        return {**others, "shape": value, **{name: sizes[name] for name in added if name in sizes}}

    def model_post_init(self, _: Any) -> None:
        kind = self.kind
        if kind is None:
            raise ValueError(f"shape is missing; allowed: {', '.join(KINDS)}")
        for key in sorted(self.model_fields_set & set(OWN)):
            if getattr(self, key) is not None and kind not in OWN[key]:
                raise ValueError(f'{key} has no meaning for a shape "{kind}"; allowed: {", ".join(OWN[key])}')
        if kind in ("line", "image") and self.rotation_deg != 0.0:
            raise ValueError(f'rotation_deg has no meaning for a shape "{kind}"; allowed: orientation.turn_deg')
        if kind == "image" and self.center_nm != (0.0, 0.0):
            raise ValueError('center_nm has no meaning for a shape "image", which is the whole cell; remove it')
        if self.size_nm is not None and (self.width_nm is not None or self.length_nm is not None):
            raise ValueError("size_nm and width_nm, length_nm exclude each other; keep one")
        for key in SIZES[kind]:
            if getattr(self, key) is None and not (self.size_nm is not None and key in ("width_nm", "length_nm")):
                raise ValueError(f'{key} is missing; a shape "{kind}" needs {", ".join(SIZES[kind])}')
        if kind == "ring" and float(self.inner_diameter_nm or 0) >= float(self.diameter_nm or 0):
            raise ValueError(f"inner_diameter_nm = {self.inner_diameter_nm:g} must be below {self.diameter_nm:g}")
        if kind == "cross" and float(self.length or 0) < float(self.width or 0):
            raise ValueError(f"length_nm = {self.length:g} is below width_nm = {self.width:g}")
        if self.corner_radius_nm > 0.0:
            if kind != "rectangle":
                raise ValueError(f'corner_radius_nm has no meaning for a shape "{kind}"; allowed: a rectangle')
            most = 0.5 * min(float(self.width or 0), float(self.length or 0))
            if self.corner_radius_nm > most:
                raise ValueError(
                    f"corner_radius_nm = {self.corner_radius_nm:g} is more than half a side; allowed: at most {most:g}"
                )

    @property
    def kind(self) -> str | None:
        """The kind; a GDS file needs no word."""
        return self.shape or ("gds" if self.gds is not None else None)

    @property
    def width(self) -> float | None:
        """Size along x."""
        return self.size_nm[0] if self.size_nm is not None else self.width_nm

    @property
    def length(self) -> float | None:
        """Size along y."""
        if self.size_nm is not None:
            return self.size_nm[1]
        return self.width_nm if self.length_nm is None and self.kind == "rectangle" else self.length_nm

    def wall(self, context: RecipeContext, key: str, thickness_nm: float) -> Wall:
        """Return the wall's section.

        Raises:
            RecipeError: the rounding is higher than the layer.
        """
        if self.rounding_nm > thickness_nm:
            raise context.fail(
                f"{key}.rounding_nm", self.rounding_nm, f"is more than the layer; allowed: at most {thickness_nm:g}"
            )
        return Wall(self.sidewall_deg, self.rounding_nm)

    @property
    def _is_vertical(self) -> bool:
        return self.sidewall_deg == 90.0 and self.rounding_nm == 0.0

    def geometry(self, context: RecipeContext, key: str, cell: Cell) -> list[Shape]:
        """Return the shape as rectangles or as a region.

        Raises:
            RecipeError: a file cannot be used.
        """
        x, y = self.center_nm
        kind, turn = self.kind, np.radians(self.rotation_deg)
        w, h = self.width or 0.0, self.length or 0.0
        if kind == "line":
            return [Rectangle(x - 0.5 * w, x + 0.5 * w)]
        if kind == "rectangle" and self.corner_radius_nm > 0.0:
            r = self.corner_radius_nm
            core = box(Rectangle(r - 0.5 * w, 0.5 * w - r, r - 0.5 * h, 0.5 * h - r)).distance
            return [Region(_turned(lambda a, b: core(a, b) - r, x, y, turn), ("rounded", x, y, w, h, r, turn))]
        if kind == "rectangle" and self.rotation_deg == 0.0:
            return [Rectangle(x - 0.5 * w, x + 0.5 * w, y - 0.5 * h, y + 0.5 * h)]
        if kind == "cross" and self.rotation_deg == 0.0 and self._is_vertical:
            arms: list[Shape] = [Rectangle(x - 0.5 * w, x + 0.5 * w, y - 0.5 * h, y + 0.5 * h)]
            if h > w:
                arms += [
                    Rectangle(x - 0.5 * h, x - 0.5 * w, y - 0.5 * w, y + 0.5 * w),
                    Rectangle(x + 0.5 * w, x + 0.5 * h, y - 0.5 * w, y + 0.5 * w),
                ]
            return arms
        if kind == "disc":
            radius = 0.5 * float(self.diameter_nm or 0)
            return [Region(lambda a, b: np.hypot(a - x, b - y) - radius, ("disc", x, y, radius))]
        if kind == "ring":
            outer, inner = 0.5 * float(self.diameter_nm or 0), 0.5 * float(self.inner_diameter_nm or 0)
            mean, half = 0.5 * (outer + inner), 0.5 * (outer - inner)
            return [Region(lambda a, b: np.abs(np.hypot(a - x, b - y) - mean) - half, ("ring", x, y, outer, inner))]
        if kind == "ellipse":
            return [Region(_turned(_ellipse(0.5 * w, 0.5 * h), x, y, turn), ("ellipse", x, y, w, h, turn))]
        if kind == "image":
            return [self._image(context, key, cell)]
        polygons = [self._points(context, key)] if kind == "polygon" else None
        if kind == "rectangle":
            polygons = [0.5 * np.array([[-w, -h], [w, -h], [w, h], [-w, h]])]
        if kind == "cross":
            a, b = [-w, w, w, h, h, w, w, -w, -w, -h, -h, -w], [-h, -h, -w, -w, w, w, h, h, w, w, -w, -w]
            polygons = [0.5 * np.column_stack([a, b])]
        if polygons is None:
            polygons = self._gds(context, key, cell)
        shapes: list[Shape] = []
        for points in polygons:
            corners = points @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + [x, y]
            shapes.append(Region(_polygon(corners), ("polygon", corners.tobytes().hex())))
        return shapes

    def _points(self, context: RecipeContext, key: str) -> Array:
        points = np.array(self.points_nm)
        distance = _polygon(points)
        low, size = points.min(axis=0), np.ptp(points, axis=0)
        at = low[:, None, None] + size[:, None, None] * np.stack(np.meshgrid(*[(np.arange(64) + 0.5) / 64] * 2))
        if not size.all() or not (distance(at[0], at[1]) < 0.0).any():
            raise context.fail(f"{key}.points_nm", points.tolist()[:4], "holds no area; allowed: corners not in a line")
        return points

    def _image(self, context: RecipeContext, key: str, cell: Cell) -> Region:
        from scipy.ndimage import distance_transform_edt

        assert self.file is not None and cell.period_y is not None
        path = context.path(self.file)
        try:
            plain(path)
        except OSError as error:
            raise context.fail(f"{key}.file", self.file, why_unreadable(error)) from None
        grey = read_grey(path, f"{context.source}: {key}.file", MAX_PIXELS)
        inside = np.asarray(grey).T[:, ::-1] > 0.5  # [x, y], the first row on top
        if inside.all() or not inside.any():
            raise context.fail(f"{key}.file", self.file, "holds no shape: all of it is on one side of a half")
        tiled = np.tile(inside, (3, 3))
        n_x, n_y = inside.shape
        step = (cell.period_x / n_x, cell.period_y / n_y)
        signed = distance_transform_edt(~tiled, sampling=step) - distance_transform_edt(tiled, sampling=step)
        values = signed[n_x : 2 * n_x, n_y : 2 * n_y]
        angle, p_x, p_y = cell.angle_rad, cell.period_x, cell.period_y

        def distance(a: Array, b: Array) -> Array:
            v = b / (p_y * np.sin(angle))
            u = (a - v * p_y * np.cos(angle)) / p_x
            # periodic, in lattice coordinates about the origin
            return interpolate_periodic(values.T, (v + 0.5) * n_y - 0.5, (u + 0.5) * n_x - 0.5)

        return Region(distance, ("image", inside.tobytes().hex(), inside.shape))

    def _gds(self, context: RecipeContext, key: str, cell: Cell) -> list[Array]:
        """Return the polygons of a GDS cell, in nm.

        Raises:
            RecipeError: no such cell, no polygons in the layer, or units that do not fit the cell.
        """
        import gdstk

        assert self.gds is not None
        path = context.path(self.gds)
        try:
            plain(path)
            data = path.read_bytes()
        except OSError as error:
            raise context.fail(f"{key}.gds", self.gds, why_unreadable(error)) from None
        try:
            if not _is_gds(data):  # the library prints errors of its own
                raise ValueError
            library = gdstk.read_gds(str(path))
        except Exception:
            raise context.fail(f"{key}.gds", self.gds, "is not a complete GDS file") from None
        names = {cell.name: cell for cell in library.cells}
        if not names:
            raise context.fail(f"{key}.gds", self.gds, "holds no cell")
        if self.cell is not None and self.cell not in names:
            raise context.fail(
                f"{key}.cell", self.cell, f"is not in {self.gds}; allowed: {', '.join(sorted(names)[:20])}"
            )
        top = [names[self.cell]] if self.cell is not None else library.top_level()
        if len(top) != 1:
            raise RecipeError(
                f"{context.source}: {key}.cell is missing; allowed: {', '.join(c.name for c in top[:20])}"
            )
        chosen = top[0]
        polygons = chosen.get_polygons(layer=self.layer, datatype=0) if isinstance(chosen, gdstk.Cell) else []
        if not polygons:
            every = chosen.get_polygons() if isinstance(chosen, gdstk.Cell) else []
            layers = ", ".join(str(n) for n in sorted({p.layer for p in every if p.datatype == 0})) or "none"
            raise context.fail(
                f"{key}.layer", self.layer,
                f"holds no polygons of datatype 0 in cell {top[0].name} of {self.gds}; allowed: {layers}",
            )  # fmt: skip
        merged = gdstk.boolean(polygons, [], "or", precision=1e-3 * library.precision / library.unit)
        drawn = [np.asarray(p.points) * (library.unit / 1e-9) for p in merged]
        size = float(np.ptp(np.concatenate(drawn), axis=0).max()) if drawn else 0.0
        if not LEAST_EXTENT * cell.period_x <= size <= 4.0 * max(cell.period_x, cell.period_y or 0.0):
            raise context.fail(
                f"{key}.gds", self.gds,
                f"spans {size:g} nm in units of {library.unit:g} m; allowed: a drawing of the cell, "
                f"{cell.period_x:g} nm across",
            )  # fmt: skip
        return drawn


def _is_gds(data: bytes) -> bool:
    """Return whether records, each two bytes of length, type and content, lead from HEADER to ENDLIB."""
    if data[2:4] != b"\0\2":
        return False
    at = 0
    while at + 4 <= len(data):
        length = int.from_bytes(data[at : at + 2], "big")
        if data[at + 2] == 4:
            return True
        if length < 4:
            return False
        at += length
    return False


def widest(shape: Shape, wall: Wall, thickness_nm: float) -> Shape:
    """Return the largest section of a shape with a sloping wall."""
    away = float(wall.insets(thickness_nm, np.linspace(0.0, thickness_nm, 65)).min())
    return inset(shape, away) or shape


def _turned(
    distance: Callable[[Array, Array], Array], x: float, y: float, turn: float
) -> Callable[[Array, Array], Array]:
    c, s = np.cos(turn), np.sin(turn)
    return lambda a, b: distance(c * (a - x) + s * (b - y), c * (b - y) - s * (a - x))


def _ellipse(a: float, b: float) -> Callable[[Array, Array], Array]:
    """First-order distance to an ellipse: the level function over its gradient."""

    def distance(x: Array, y: Array) -> Array:
        level = np.hypot(x / a, y / b)
        slope = np.hypot(x / a**2, y / b**2)
        return np.asarray(level * (level - 1.0) / np.maximum(slope, 1e-12 / max(a, b)))

    return distance


def _polygon(corners: Array) -> Callable[[Array, Array], Array]:
    """Signed distance to a polygon (even-odd rule)."""
    ends = np.roll(corners, -1, axis=0)

    def distance(x: Array, y: Array) -> Array:
        squared = np.full(x.shape, np.inf)
        inside = np.zeros(x.shape, dtype=bool)
        for (x_0, y_0), (x_1, y_1) in zip(corners, ends, strict=True):
            e_x, e_y = x_1 - x_0, y_1 - y_0
            t = np.clip(((x - x_0) * e_x + (y - y_0) * e_y) / max(e_x**2 + e_y**2, 1e-300), 0.0, 1.0)
            squared = np.minimum(squared, (x - x_0 - t * e_x) ** 2 + (y - y_0 - t * e_y) ** 2)
            crosses = (y_0 > y) != (y_1 > y)
            at = x_0 + (y - y_0) * e_x / (e_y if e_y else 1.0)
            inside ^= crosses & (x < at)
        return np.where(inside, -1.0, 1.0) * np.sqrt(squared)

    return distance


def _sides(table: Mapping[str, Any]) -> tuple[float, float]:
    """Return the sizes of a shape in a recipe along x and y."""
    if table.get("points_nm"):
        width, length = np.ptp(np.array(table["points_nm"], dtype=float), axis=0).tolist()
        return width, length
    width, length = table.get("size_nm") or (table.get("width_nm", table.get("diameter_nm")), table.get("length_nm"))
    width = float((length if table.get("shape") == "cross" else width) or NEW_NM)
    return width, float(length or width)


def check_shapes(shapes: list[tuple[str, Shape]], cell: Cell) -> str | None:
    """Return the error in one layer's named shapes (outside the cell, or overlapping), or None."""
    for name, shape in shapes:
        if _leaves(shape, cell):
            return f"{name} leaves the cell, which reaches from {_extent(cell)} about its centre"
    for i, (name, shape) in enumerate(shapes):
        for other, second in shapes[:i]:
            if name != other and _overlap(shape, second, cell):
                return f"{name} overlaps {other}"
    return None


def _extent(cell: Cell) -> str:
    size = f"{-0.5 * cell.period_x:g} to {0.5 * cell.period_x:g} nm along x"
    if cell.period_y is None:
        return size
    return f"{size} and {-0.5 * cell.period_y:g} to {0.5 * cell.period_y:g} nm along its second side"


def _leaves(shape: Shape, cell: Cell) -> bool:
    half = 0.5 * cell.period_x * (1.0 + 1e-9)
    if isinstance(shape, Rectangle) and cell.angle_rad == 0.5 * np.pi:
        if max(-shape.x_0, shape.x_1) > half:
            return True
        if cell.period_y is None or not np.isfinite(shape.y_0):
            return False
        return max(-shape.y_0, shape.y_1) > 0.5 * cell.period_y * (1.0 + 1e-9)
    if isinstance(shape, Region) and shape.key[0] == "image":
        return False
    # more than the cell; a copy in a neighbouring cell may touch, but not be met
    x, y = cell_grid(Cell(2.0 * cell.period_x, 2.0 * float(cell.period_y or 0), cell.angle_rad), SAMPLES)
    inside = _is_inside(shape, x, y)
    middle = slice(SAMPLES // 4, 3 * SAMPLES // 4)
    if cell.is_rectangular:
        return bool(inside.sum() > inside[middle, middle].sum())
    edge = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    d_x, d_y = float(cell.period_y or 0) * np.cos(cell.angle_rad), float(cell.period_y or 0) * np.sin(cell.angle_rad)
    copies = [(cell.period_x, 0.0), (d_x, d_y), (d_x - cell.period_x, d_y)]
    return bool(edge.any() or any((inside & _is_inside(shape, x - a, y - b)).any() for a, b in copies))


def _overlap(one: Shape, other: Shape, cell: Cell) -> bool:
    if isinstance(one, Rectangle) and isinstance(other, Rectangle):
        gap = 1e-9 * cell.period_x
        along_x = min(one.x_1, other.x_1) - max(one.x_0, other.x_0) > gap
        return along_x and min(one.y_1, other.y_1) - max(one.y_0, other.y_0) > gap
    x, y = cell_grid(cell, SAMPLES)
    return bool((_is_inside(one, x, y) & _is_inside(other, x, y)).any())


def _is_inside(shape: Shape, x: Array, y: Array) -> Array:
    if isinstance(shape, Region):
        return np.asarray(shape.distance(x, y) < 0.0)
    return np.asarray((x > shape.x_0) & (x < shape.x_1) & (y > shape.y_0) & (y < shape.y_1))
