"""The scenes: objects, grounds, camera and default light.

Scenes are data in `scenes.toml`; `nacre.picture.built_scene` builds them in Mitsuba. Surfaces other than the subject
have flat or measured spectra, never up-sampled RGB, therefore all colour comes from the material and the light.
"""

from __future__ import annotations

import functools
import importlib
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.light import table_wavelengths_nm
from nacre.picture import mesh
from nacre.picture.camera import View
from nacre.picture.emitters import spectrum_texture
from nacre.picture.environments import WOOD, edge, peak
from nacre.picture.mesh import Mesh, rotation, sweep_length
from nacre.picture.plugins import WrappedIntegrator, dr, make_plugin, mi, noise

PLANK = 1.5  # plank width on the desk
_TILE = (12.0, 6.0)  # desk period along and across the grain, in scene units
_ROWS = 1024  # drawing resolution
_SEED = 11


def _diffuse(reflectance: dict[str, Any]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}


def _per_length(x: float, y: float) -> dict[str, Any]:
    """Texture scale for uv in lengths: one period over x by y."""
    return {"to_uv": mi.ScalarTransform4f().scale([1 / x, 1 / y, 1.0])}


def chessboard(square: float, dark: float = 0.035, bright: float = 0.6) -> dict[str, Any]:
    """A diffuse chessboard for uv in lengths."""
    colours = {f"color{i}": {"type": "uniform", "value": value} for i, value in enumerate((dark, bright))}
    return _diffuse({"type": "checkerboard", **colours, **_per_length(2 * square, 2 * square)})


def grey_bitmap(values: Array, **options: Any) -> dict[str, Any]:
    """A spectrally flat texture from numbers `[row, column]`; `options` as for Mitsuba's bitmap."""
    data = np.ascontiguousarray(values[..., None], dtype=np.float32)
    return {"type": "bitmap", "data": mi.TensorXf(data), "raw": True, "wrap_mode": "clamp", **options}


def graded(across: float, along: float, centre: float) -> dict[str, Any]:
    """A matt backdrop for uv in lengths, lightest below the subject."""
    u, v = np.meshgrid((np.arange(128) + 0.5) / 128 * across, (np.arange(128) + 0.5) / 128 * along)
    distance = np.hypot((u - 0.5 * across) / 1.5, v - centre)
    return _diffuse(grey_bitmap(0.035 + 0.14 * np.exp(-((distance / 5.5) ** 2)), **_per_length(across, along)))


def halo(across: float, along: float, centre: float) -> dict[str, Any]:
    """A black backdrop for uv in lengths with a soft glow on its wall."""
    u, v = np.meshgrid((np.arange(128) + 0.5) / 128 * across, (np.arange(256) + 0.5) / 256 * along)
    glow = np.exp(-(((u - 0.5 * across) / 6.0) ** 2) - ((v - centre) / 2.6) ** 2)
    return _diffuse(grey_bitmap(0.004 + 0.06 * glow, **_per_length(across, along)))


def matt(reflectance: Array) -> dict[str, Any]:
    """A matt surface with a reflectance spectrum on the light tables' wavelength grid."""
    return _diffuse(spectrum_texture(table_wavelengths_nm(), reflectance))


def mixed(first: dict[str, Any], second: dict[str, Any], share: Array, **options: Any) -> dict[str, Any]:
    """Blend two surfaces; the mask `[row, column]` is the share of the second."""
    weight = grey_bitmap(np.clip(share, 0.0, 1.0), **options)
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


@functools.cache
def _grain() -> tuple[Array, Array]:
    """Brightness of the desk's wood, and its dark pores and gaps; `[row, column]`, grain along rows."""
    shape = (_ROWS, int(_ROWS * _TILE[0] / _TILE[1]))
    unit = _ROWS / _TILE[1]  # pixels

    def grain(across: float, along: float, seed: int) -> Array:
        return noise(shape, (across * unit, along * unit), _SEED + seed)

    y = (np.arange(shape[0]) + 0.5)[:, None] / unit
    plank = np.floor(y / PLANK).astype(int)
    light = np.zeros(shape)
    rng = np.random.default_rng(_SEED)
    for number in range(int(round(_TILE[1] / PLANK))):
        rows = np.flatnonzero(plank[:, 0] == number)
        # growth rings cut nearly along the trunk: long flames in the middle, close lines at the sides
        warp = 0.22 * grain(0.35, 1.6, 7 * number)[rows]
        warp += 0.03 * grain(0.05, 0.5, 7 * number + 1)[rows]
        across = y[rows] - (number + rng.uniform(0.2, 0.8)) * PLANK
        rings = 3.2 * np.sqrt(across**2 + 0.12) + warp
        phase = np.mod(3.0 * rings, 1.0)
        late = np.where(phase < 0.82, phase / 0.82, (1.0 - phase) / 0.18)  # slow spring wood, sharp autumn wood
        light[rows] = 0.62 - 0.42 * late**2 + rng.uniform(-0.07, 0.07)
    light += 0.045 * grain(0.006, 0.5, 100)
    light += 0.05 * grain(0.4, 1.5, 101)
    pores = np.clip(grain(0.004, 0.09, 102) - 1.75, 0.0, 1.0)
    gap = np.abs(np.mod(y / PLANK + 0.5, 1.0) - 0.5) * PLANK
    dark = np.maximum(0.75 * pores, np.exp(-((gap / 0.012) ** 2)) * np.ones(shape))
    return np.clip(light, 0.0, 1.0), np.clip(dark, 0.0, 1.0)


def wood() -> dict[str, Any]:
    """An oiled walnut desk for uv in lengths, planks across the picture."""
    light, dark = _grain()
    repeated = {"wrap_mode": "repeat", **_per_length(*_TILE)}
    heart, sap = edge(0.025, 0.13, 615.0, 50.0), edge(0.07, 0.36, 585.0, 55.0)
    body = mixed(matt(heart), matt(sap), light, **repeated)
    return mixed(body, matt(edge(0.012, 0.03, 620.0, 60.0)), dark, **repeated)


def boards() -> dict[str, Any]:
    """The wooden floor of the room."""
    return matt(WOOD)


def acrylic() -> dict[str, Any]:
    """Polished black acrylic, which mirrors objects on it."""
    return {"type": "plastic", "int_ior": 1.49, "diffuse_reflectance": 0.004}


def museum_board() -> dict[str, Any]:
    """White paper-covered foam board on which insects are pinned, for uv in lengths."""
    shape, side = (512, 512), 3.0
    pulp = 0.6 * noise(shape, (1.0, 1.0), _SEED + 60) + 0.5 * noise(shape, (6.0, 6.0), _SEED + 61)
    pulp += 0.5 * noise(shape, (40.0, 40.0), _SEED + 62)
    white = edge(0.56, 0.72, 440.0, 34.0)
    options = {"wrap_mode": "repeat", **_per_length(side, side)}
    return mixed(matt(0.86 * white), matt(white), 0.6 + 0.22 * pulp, **options)


def printed_note(rows: int = 1024) -> dict[str, Any]:
    """The paper of the banknote with its inks, one over the other."""
    from nacre.picture.printed import NOTE_HEIGHT, NOTE_WIDTH, note_drawing

    light, inks = note_drawing(rows, NOTE_WIDTH / NOTE_HEIGHT)
    spectra = {
        "ochre": edge(0.12, 0.62, 545.0, 28.0),
        "teal": peak(0.06, 0.42, 505.0, 55.0),
        "violet": peak(0.04, 0.22, 430.0, 40.0) + edge(0.0, 0.12, 630.0, 20.0),
        "blue": peak(0.02, 0.13, 455.0, 45.0),
        "red": edge(0.05, 0.6, 605.0, 14.0),
    }
    paper = edge(0.56, 0.8, 430.0, 30.0)
    note = mixed(matt(0.82 * paper), matt(1.0 * paper), 0.5 + 5.0 * (light - 0.95)[::-1])  # v upward
    for name, share in inks.items():
        note = mixed(note, matt(spectra[name]), share[::-1])
    return note


def printed_pass() -> dict[str, Any]:
    """The laminated face of the plastic card: blue that changes to teal, with white ink."""
    from nacre.picture.printed import pass_print

    light, ink = pass_print()
    ground = mixed(_glossy(peak(0.01, 0.10, 455.0, 42.0)), _glossy(peak(0.02, 0.3, 495.0, 50.0)), light[::-1])
    return mixed(ground, _glossy(edge(0.6, 0.8, 430.0, 30.0)), ink[::-1])


def _glossy(reflectance: Array) -> dict[str, Any]:
    """A diffuse spectrum below a smooth clear coat."""
    colour = matt(reflectance)["reflectance"]
    return {"type": "roughplastic", "int_ior": 1.5, "alpha": 0.06, "nonlinear": False, "diffuse_reflectance": colour}


SUBJECT = "nacre"  # parts with this material take the rendered one
# arguments of `backdrop.sweep` and `backdrop.bowl`; chequer sides
SWEEP, BOARD, BOWL = (20.0, 16.0, 5.0, 4.5, 5.2), (12.0, 12.0, 12.0, 2.0, 3.0), (1.4, 9.0, 4.2)
SQUARE, BOWL_SQUARE = 0.55, 0.62
# the wall behind black acrylic is high enough that the plate does not mirror its edge
SWEEPS = {"sweep": SWEEP, "desk": BOARD, "specimen": BOARD, "acrylic": (20.0, 16.0, 5.0, 4.5, 10.0)}
PLATE = (40.0, 26.0)  # width and depth of black acrylic
# each soap bubble's size, and shift from a resting position
BUBBLES = ((1.0, (-0.1, 0.0, 0.03)), (0.3, (1.02, -0.9, 0.05)), (0.17, (0.98, 1.6, 1.9)), (0.12, (-1.25, 2.4, 0.3)))
Backdrop = Literal["sweep", "bowl", "desk", "acrylic", "specimen", "none"]

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf", ".off")


@dataclass(frozen=True)
class Part:
    """A mesh, or a Mitsuba shape as a dict, and its material's name."""

    shape: Mesh | dict[str, Any]
    material: str = SUBJECT

    def turned(self, angle_deg: float) -> Part:
        """Turn the part about the vertical axis through the origin."""
        return self._moved(rotation("z", angle_deg), lambda world: world.rotate([0, 0, 1], angle_deg))

    def scaled(self, scale: float) -> Part:
        """Scale the part about the origin."""
        return self._moved(np.eye(3) * scale, lambda world: world.scale(scale))

    def _moved(self, matrix: Array, transform: Callable[[Any], Any]) -> Part:
        if isinstance(self.shape, Mesh):
            return Part(self.shape.moved(matrix), self.material)
        identity = mi.ScalarTransform4f()
        to_world = transform(identity) @ self.shape.get("to_world", identity)
        return Part({**self.shape, "to_world": to_world}, self.material)

    def points(self) -> Array:
        """Points `[N, 3]` with the part's bounding ball: vertices, sphere poles, else box corners."""
        if isinstance(self.shape, Mesh):
            return self.shape.vertices
        if self.shape["type"] == "sphere":
            ends = self.shape.get("radius", 1.0) * np.concatenate([np.eye(3), -np.eye(3)])
            ends = ends + np.array(self.shape.get("center", (0.0, 0.0, 0.0)), dtype=float).ravel()
            to_world = self.shape.get("to_world")
            matrix = np.eye(4) if to_world is None else np.array(to_world.matrix, dtype=float)
            return np.asarray(ends @ matrix[:3, :3].T + matrix[:3, 3])
        box = mi.load_dict(self.shape).bbox()
        sides = np.stack([np.array(box.min, dtype=float).ravel(), np.array(box.max, dtype=float).ravel()])
        return np.stack(np.meshgrid(*sides.T), axis=-1).reshape(-1, 3)


Parts = Callable[[], list[Part]]


@dataclass(frozen=True)
class Scene:
    """A scene without its material.

    Attributes:
        name: as on the command line.
        parts: builds subject and companions.
        view: the camera.
        backdrop: the ground.
        light: default light.
        max_depth: path length for opaque subjects.
        size: default picture size.
        place_view: camera for a light that is a visible place (street, room, sky); None: `view`.
        props: builds objects beside the subject, omitted in a visible place.
        keeps_whole: whether the camera moves away until the subject is in the frame, from any direction.
    """

    name: str
    parts: Parts
    view: View
    backdrop: Backdrop = "sweep"
    light: str = "studio"
    max_depth: int = 6
    size: tuple[int, int] = (640, 640)
    place_view: View | None = None
    props: Parts = list
    keeps_whole: bool = False


_DATA = tomllib.loads(files(__package__).joinpath("scenes.toml").read_text("utf-8"))
# simple models for all surfaces except the subject; printed ones by their mean reflectance
MATERIALS: dict[str, dict[str, Any]] = _DATA["materials"]
_GROUNDS = {"banknote": printed_note, "deck": wood, "pass": printed_pass, "boards": boards}


def plain_material(name: str) -> dict[str, Any]:
    """Return a material other than the subject as a Mitsuba dict."""
    if name in _GROUNDS:
        return _GROUNDS[name]()
    if name in _DATA["drawings"]:
        module, function, *arguments = _DATA["drawings"][name]
        return {"type": "diffuse", "reflectance": grey_bitmap(_shape(module, function, *arguments)[::-1])}
    return MATERIALS[name]


def _shape(module: str, function: str, *arguments: Any) -> Any:
    """Call a function in `nacre.picture.MODULE`, imported on first use."""
    fixed = (tuple(each) if isinstance(each, list) else each for each in arguments)
    return getattr(importlib.import_module(f"nacre.picture.{module}"), function)(*fixed)


def _parts(module: str, *rows: str | list[Any]) -> Parts:
    """Return a cached builder of parts.

    Args:
        module: module in `nacre.picture`.
        rows: "function" for the subject, "function:material", or [function, material, arguments].
    """
    full = [row if isinstance(row, list) else row.split(":") for row in rows]
    return functools.cache(lambda: [Part(_shape(module, row[0], *row[2:]), *row[1:2]) for row in full])


@functools.cache
def _sphere() -> list[Part]:
    # Mitsuba counts v from the upper pole; the reflection makes v run upward as on all our shapes
    upright = mi.ScalarTransform4f().translate([0.0, 0.0, 1.0]).scale([1.0, 1.0, -1.0])
    return [Part({"type": "sphere", "to_world": upright, "flip_normals": True})]


@functools.cache
def _bubbles() -> list[Part]:
    def moved(part: Part, place: tuple[float, float, float]) -> Part:
        return part._moved(np.eye(3), lambda world: world.translate(list(place)))

    return [moved(part.scaled(size), place) for size, place in BUBBLES for part in _sphere()]


@functools.cache
def _panel() -> list[Part]:
    flat = mesh.sheet(1.7, 1.9).moved(rotation("x", 24.0), (-1.08, 0.0, 0.4))
    return [Part(flat), Part(mesh.rolled(1.7, 0.82, 170.0).shifted(1.08, 0.0, 0.0))]


@functools.cache
def _body() -> list[Part]:
    materials = {
        "paint": SUBJECT, "glass": "glass", "trim": "rubber", "lamps": "lamp", "tyres": "rubber", "rims": "chrome",
        "mirrors": SUBJECT, "seams": "matt-dark", "handles": "chrome", "plate": "plate",
    }  # fmt: skip
    built = _shape("objects", "car")
    return [Part(built[name], material) for name, material in materials.items()]


_BUILT_HERE: dict[str, Parts] = {"sphere": _sphere, "panel": _panel, "bubbles": _bubbles, "body": _body}


def _scene(name: str, data: Mapping[str, Any]) -> Scene:
    """Return a scene of `scenes.toml`."""
    made: dict[str, Any] = dict(data)
    for key in ("parts", "props"):
        if key in made:
            made[key] = _parts(*made[key]) if isinstance(made[key], list) else _BUILT_HERE[made[key]]
    for key in ("view", "place_view"):
        if key in made:
            view = made[key]
            made[key] = View(**{**view, "origin": tuple(view["origin"]), "target": tuple(view["target"])})
    if "size" in made:
        made["size"] = tuple(made["size"])
    return Scene(name, **made)


SCENES: dict[str, Scene] = {name: _scene(name, data) for name, data in _DATA["scenes"].items()}
# names for `shape`: the subjects that stand on the floor, once each
SHAPES: dict[str, Parts] = {name: scene.parts for name, scene in SCENES.items() if name not in ("probe", "bubble")}
SCENE_NAMES = (*SCENES, "screen")


def scene(name: str) -> Scene:
    """Return a scene by its name.

    Raises:
        NacreError: unknown name.
    """
    if name not in SCENES:
        if name.lower().endswith(MESH_SUFFIXES):
            raise NacreError(f'scene "{name}" is a mesh, not a scene; give it as shape (--shape {name})')
        raise NacreError(
            f'scene "{name}" is not known.{did_you_mean(name, SCENE_NAMES)} '
            f"Choose from {', '.join(SCENE_NAMES)} or a Mitsuba .xml file"
        )
    return SCENES[name]


def backdrop_parts(kind: Backdrop, see_through: bool, place_floor: str | None) -> list[tuple[Mesh, dict[str, Any]]]:
    """Return a backdrop's meshes and materials.

    Args:
        kind: scene backdrop.
        see_through: chequers on a plain sweep, because transparent subjects are seen by refraction.
        place_floor: plain floor material that replaces the backdrop in a visible place; None: the backdrop.
    """
    if kind == "none":
        return []
    if kind == "bowl":
        return [(mesh.bowl(*BOWL), chessboard(BOWL_SQUARE))]
    if place_floor is not None:
        # a place paints its own ground at a distance; a bare sky has black below the horizon
        side = 8000.0 if place_floor == "plain" else 60.0
        return [(mesh.tile(side, side), plain_material(place_floor))]
    surface = mesh.sweep(*SWEEPS[kind])
    top = float(surface.uv[:, 1].max())
    if kind == "desk":
        return [(surface, wood())]
    if kind == "specimen":
        return [(surface, museum_board())]
    if kind == "acrylic":
        plate = mesh.tile(*PLATE).shifted(0.0, -6.0, 0.001)  # above the matt ground
        return [(surface, halo(40.0, top, 25.5)), (plate, acrylic())]
    if see_through:  # dark, because a film on glass has faint colours
        return [(surface, chessboard(SQUARE, 0.012, 0.11))]
    return [(surface, graded(40.0, top, 16.0))]


# Infinite backdrops: camera rays that miss the scene see the backdrop continued beyond its edges.
#
# A larger mesh would stand before lamps and change the light. Instead, a missed ray's intersection with an infinite
# backdrop is folded back into the finite one.

START = 0.05  # distance from the matt surface at which a redirected ray starts
RIM = 0.02  # unused margin on the finite backdrop
FAR = 1e4  # distance for rays that do not descend
HALVINGS = 40


@dataclass(frozen=True)
class InfiniteBackdrop:
    """An infinite backdrop.

    Attributes:
        kind: scene backdrop.
        square: side of the chequers; 0: plain.
        turn_deg: turn about the vertical axis.
    """

    kind: Backdrop
    square: float = 0.0
    turn_deg: float = 0.0


def infinite_backdrop(kind: Backdrop, is_chequered: bool, turn_deg: float) -> InfiniteBackdrop | None:
    """Return a backdrop's continuation; None without backdrop."""
    if kind == "none":
        return None
    if kind == "bowl":
        return InfiniteBackdrop(kind, BOWL_SQUARE, turn_deg)
    return InfiniteBackdrop(kind, SQUARE if is_chequered and kind == "sweep" else 0.0, turn_deg)


def with_infinite_backdrop(integrator: Any, backdrop: InfiniteBackdrop) -> Any:
    """Return an integrator whose camera rays see the backdrop beyond its edges."""
    return make_plugin(WithInfiniteBackdrop, integrator, backdrop)


def fold(value: Any, low: Any, high: Any, width: Any) -> Any:
    """Reflect values outside [low, high] back and forth within the outermost `width`."""
    beyond = dr.maximum(dr.maximum(value - high, low - value), 0.0)
    period = beyond - 2.0 * width * dr.floor(beyond / (2.0 * width))
    inward = width - dr.abs(period - width)
    return dr.select(value > high, high - inward, dr.select(value < low, low + inward, value))


def _fold_limits(length: float, square: float) -> tuple[float, float, float]:
    """Limits and width for folding one side; chequers fold at square centres."""
    if square == 0.0:
        return RIM, length - RIM, 1.0
    return 0.5 * square, (int((length - RIM) / square - 0.5) + 0.5) * square, 2.0 * square


class WithInfiniteBackdrop(WrappedIntegrator):
    """An integrator whose camera rays never miss the backdrop."""

    def set_up(self, inner: Any, backdrop: InfiniteBackdrop) -> None:
        self.inner, self.backdrop = inner, backdrop
        turn = mi.ScalarTransform4f().rotate([0, 0, 1], backdrop.turn_deg)
        self.turn, self.back = mi.Transform4f(turn.matrix), mi.Transform4f(turn.inverse().matrix)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        missed = (scene.ray_intersect_preliminary(ray, True, active).is_valid() ^ True) & active
        meet = _on_bowl if self.backdrop.kind == "bowl" else _on_sweep
        place, normal = meet(self.backdrop, self.back @ ray.o, self.back @ ray.d)
        place, normal = self.turn @ place, self.turn @ dr.normalize(normal)
        redirected = mi.RayDifferential3f(ray)
        redirected.o = dr.select(missed, place + START * normal, ray.o)
        redirected.d = dr.select(missed, -normal, ray.d)
        return self.inner.sample(scene, sampler, redirected, medium, active)


def _on_sweep(backdrop: InfiniteBackdrop, o: Any, d: Any) -> Any:
    """Intersect a ray with an infinite floor, cove and wall, folded into `sweep`; return place and normal."""
    half_width, front, back, radius, _ = SWEEPS[backdrop.kind]
    flat, bent = front + back, 0.5 * dr.pi * radius
    t_floor = dr.select(d.z < 0.0, -o.z / dr.minimum(d.z, -1e-9), FAR)
    is_floor = (d.z < 0.0) & (o.y + t_floor * d.y <= back)
    # the cove: a quarter cylinder along x
    a = dr.maximum(d.y * d.y + d.z * d.z, 1e-9)
    b = (o.y - back) * d.y + (o.z - radius) * d.z
    c = dr.square(o.y - back) + dr.square(o.z - radius) - radius * radius
    t_cove = (-b + dr.safe_sqrt(b * b - a * c)) / a
    y, z = o.y + t_cove * d.y - back, radius - o.z - t_cove * d.z
    is_cove = (b * b >= a * c) & (t_cove > 0.0) & (y >= 0.0) & (z >= 0.0)
    t_wall = dr.select(d.y > 0.0, dr.minimum((back + radius - o.y) / dr.maximum(d.y, 1e-9), FAR), FAR)
    along = flat + bent + dr.maximum(o.z + t_wall * d.z - radius, 0.0)
    along = dr.select(is_cove, flat + radius * dr.atan2(y, z), along)
    along = dr.select(is_floor, o.y + t_floor * d.y + front, along)
    across = o.x + dr.select(is_floor, t_floor, dr.select(is_cove, t_cove, t_wall)) * d.x + half_width
    across = fold(across, *_fold_limits(2.0 * half_width, backdrop.square)) - half_width
    along = fold(along, *_fold_limits(sweep_length(*(SWEEPS[backdrop.kind])), backdrop.square))
    angle = dr.clip((along - flat) / radius, 0.0, 0.5 * dr.pi)
    up = radius * (1.0 - dr.cos(angle)) + dr.maximum(along - flat - bent, 0.0)
    place = mi.Point3f(across, dr.minimum(along, flat) - front + radius * dr.sin(angle), up)
    return place, mi.Vector3f(0.0, -dr.sin(angle), dr.cos(angle))


def _on_bowl(backdrop: InfiniteBackdrop, o: Any, d: Any) -> Any:
    """Intersect a ray with an infinite bowl, folded into `bowl`; return place and normal."""
    flat, reach, rise = BOWL

    def height(x: Any, y: Any) -> Any:
        return rise * dr.square(dr.maximum(dr.sqrt(x * x + y * y) - flat, 0.0) / (reach - flat))

    near, far = mi.Float(0.0), mi.Float(FAR)
    for _ in range(HALVINGS):  # a line meets a bowl from above once
        t = 0.5 * (near + far)
        is_above = o.z + t * d.z > height(o.x + t * d.x, o.y + t * d.y)
        near, far = dr.select(is_above, t, near), dr.select(is_above, far, t)
    low, high, width = _fold_limits(reach, backdrop.square)
    x, y = (fold(o[axis] + near * d[axis], -high, high, width) for axis in (0, 1))
    r = dr.maximum(dr.sqrt(x * x + y * y), 1e-6)
    slope = 2.0 * rise * dr.maximum(r - flat, 0.0) / (reach - flat) ** 2 / r
    return mi.Point3f(x, y, height(x, y)), mi.Vector3f(-slope * x, -slope * y, 1.0)
