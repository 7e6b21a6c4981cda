"""The scenes: the objects in the picture, the camera, and the default light.

Every scene is data; `nacre.picture.built_scene` builds it in Mitsuba. Its other surfaces have flat or measured spectra,
never up-sampled RGB, so that the only colour in the picture is the material's and the light's.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from nacre.arrays import Array
from nacre.device.variant import use_variant
from nacre.errors import NacreError, did_you_mean
from nacre.picture.camera import View
from nacre.picture.shapes import backdrop as stages
from nacre.picture.shapes.mesh import Mesh, rotation

SUBJECT = "nacre"  # parts with this material take the one that is rendered
# half width, front, back, radius and height of `backdrop.sweep`; flat, reach and rise of `backdrop.bowl`; chequers
SWEEP, BOARD, BOWL = (20.0, 16.0, 5.0, 4.5, 5.2), (12.0, 12.0, 12.0, 2.0, 3.0), (1.4, 9.0, 4.2)
SQUARE, BOWL_SQUARE = 0.55, 0.62
RING_DEG = -24.0  # so turned, a film in its ring mirrors the large soft box
Backdrop = Literal["sweep", "bowl", "board", "dark", "none"]


@dataclass(frozen=True)
class Part:
    """A piece of the picture: a surface, or a Mitsuba shape as a dict, and the name of its material."""

    shape: Mesh | dict[str, Any]
    material: str = SUBJECT

    def turned(self, angle_deg: float) -> Part:
        """The same piece turned about the vertical axis through the origin."""
        if isinstance(self.shape, Mesh):
            return Part(self.shape.moved(rotation("z", angle_deg)), self.material)
        mi = use_variant()
        turn = mi.ScalarTransform4f().rotate([0, 0, 1], angle_deg)
        own = self.shape.get("to_world", mi.ScalarTransform4f())
        return Part({**self.shape, "to_world": turn @ own}, self.material)

    def scaled(self, scale: float) -> Part:
        """The same piece in another size, about the origin."""
        if isinstance(self.shape, Mesh):
            return Part(self.shape.moved(np.eye(3) * scale), self.material)
        mi = use_variant()
        own = self.shape.get("to_world", mi.ScalarTransform4f())
        return Part({**self.shape, "to_world": mi.ScalarTransform4f().scale(scale) @ own}, self.material)

    def points(self) -> Array:
        """Points `[N, 3]` whose bounding ball is the piece's: a mesh's corners, a ball's ends, else a box's corners."""
        if isinstance(self.shape, Mesh):
            return self.shape.vertices
        if self.shape["type"] == "sphere":
            ends = self.shape.get("radius", 1.0) * np.concatenate([np.eye(3), -np.eye(3)])
            ends = ends + np.array(self.shape.get("center", (0.0, 0.0, 0.0)), dtype=float).ravel()
            to_world = self.shape.get("to_world")
            matrix = np.eye(4) if to_world is None else np.array(to_world.matrix, dtype=float)
            return np.asarray(ends @ matrix[:3, :3].T + matrix[:3, 3])
        box = use_variant().load_dict(self.shape).bbox()
        sides = np.stack([np.array(box.min, dtype=float).ravel(), np.array(box.max, dtype=float).ravel()])
        return np.stack(np.meshgrid(*sides.T), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class Scene:
    """A scene without its material.

    Attributes:
        name: as on the command line.
        parts: builds subject and its companions; called once for each built stage.
        view: the camera.
        backdrop: what it stands on.
        light: the light that belongs to it.
        max_depth: path length that the scene needs (opaque subjects; transparent ones get more).
        size: width and height of a default picture.
        place_view: the camera where the light is a place to be seen (street, room, sky); None: the same.
    """

    name: str
    parts: Callable[[], list[Part]]
    view: View
    backdrop: Backdrop = "sweep"
    light: str = "studio"
    max_depth: int = 6
    size: tuple[int, int] = (640, 640)
    place_view: View | None = None


# reflectances and simple models of everything that is not the subject
MATERIALS: dict[str, dict[str, Any]] = {
    "board": {"type": "diffuse", "reflectance": 0.14},
    "ground": {"type": "diffuse", "reflectance": 0.16},
    "plain": {"type": "diffuse", "reflectance": 0.16},
    "dark": {"type": "plastic", "int_ior": 1.5, "diffuse_reflectance": 0.015},
    "matt-dark": {"type": "diffuse", "reflectance": 0.02},
    "rubber": {"type": "roughplastic", "int_ior": 1.5, "alpha": 0.35, "diffuse_reflectance": 0.018},
    "glass": {"type": "plastic", "int_ior": 1.45, "diffuse_reflectance": 0.008},
    "lamp": {"type": "plastic", "int_ior": 1.5, "diffuse_reflectance": 0.55},
    "chrome": {"type": "roughconductor", "material": "Cr", "alpha": 0.18},
    "white": {"type": "diffuse", "reflectance": 0.8},
    "paper": {"type": "diffuse", "reflectance": 0.74},
    "black": {"type": "diffuse", "reflectance": 0.012},
}


def plain_material(name: str) -> dict[str, Any]:
    """What is not the subject, by name: one of `MATERIALS`, a printed note, a room's boards with their spectrum."""
    if name == "banknote":
        from nacre.picture.shapes.paper import banknote_print

        return {"type": "diffuse", "reflectance": _grey_bitmap(banknote_print()[::-1])}  # v upward
    if name != "boards":
        return MATERIALS[name]
    from nacre.light import table_wavelengths_nm
    from nacre.picture.lights.environment_plugin import spectrum_texture
    from nacre.picture.lights.places import WOOD

    return {"type": "diffuse", "reflectance": spectrum_texture(table_wavelengths_nm(), WOOD)}


def chessboard(square: float, dark: float = 0.035, bright: float = 0.6) -> dict[str, Any]:
    """A diffuse chessboard for uv in lengths, with squares of side `square`."""
    import mitsuba as mi

    return {
        "type": "diffuse",
        "reflectance": {
            "type": "checkerboard",
            "color0": {"type": "uniform", "value": dark},
            "color1": {"type": "uniform", "value": bright},
            "to_uv": mi.ScalarTransform4f().scale([0.5 / square, 0.5 / square, 1.0]),
        },
    }


def _grey_bitmap(reflectance: Array, **options: Any) -> dict[str, Any]:
    """A texture of reflectances `[row, column]`, equal at all wavelengths; what `options` are, see Mitsuba's bitmap."""
    import mitsuba as mi

    values = np.ascontiguousarray(reflectance[..., None], dtype=np.float32)
    return {"type": "bitmap", "data": mi.TensorXf(values), "raw": True, "wrap_mode": "clamp", **options}


def graded(across: float, along: float, centre: float) -> dict[str, Any]:
    """A matt backdrop for uv in lengths, lightest under the subject and darker towards its edges and up the wall."""
    import mitsuba as mi

    u, v = np.meshgrid((np.arange(128) + 0.5) / 128 * across, (np.arange(128) + 0.5) / 128 * along)
    distance = np.hypot((u - 0.5 * across) / 1.5, v - centre)
    reflectance = 0.035 + 0.14 * np.exp(-((distance / 5.5) ** 2))
    over = mi.ScalarTransform4f().scale([1 / across, 1 / along, 1.0])
    return {"type": "diffuse", "reflectance": _grey_bitmap(reflectance, to_uv=over)}


@functools.cache
def _sphere() -> list[Part]:
    import mitsuba as mi

    # Mitsuba's sphere counts v from its upper pole; reflected, v runs upward as on all our shapes, and u still to the
    # right. The reflection turns the normals inward, which `flip_normals` undoes.
    upright = mi.ScalarTransform4f().translate([0.0, 0.0, 1.0]).scale([1.0, 1.0, -1.0])
    return [Part({"type": "sphere", "to_world": upright, "flip_normals": True})]


@functools.cache
def _speedshape() -> list[Part]:
    from nacre.picture.shapes.speedshape import speedshape

    return [Part(speedshape())]


@functools.cache
def _panel() -> list[Part]:
    flat = stages.sheet(1.7, 1.9).moved(rotation("x", 24.0), (-1.08, 0.0, 0.4))
    bent = stages.rolled(1.7, 0.82, 170.0).moved(np.eye(3), (1.08, 0.0, 0.0))
    return [Part(flat), Part(bent)]


@functools.cache
def _butterfly() -> list[Part]:
    from nacre.picture.shapes import butterfly as b

    lift = (0.0, 0.0, 0.06)
    return [
        Part(b.butterfly_wings().moved(np.eye(3), lift)),
        Part(b.butterfly_margins().moved(np.eye(3), lift), "matt-dark"),
        Part(b.butterfly_veins().moved(np.eye(3), lift), "matt-dark"),
        Part(b.butterfly_body().moved(np.eye(3), lift), "rubber"),
    ]


@functools.cache
def _bottle() -> list[Part]:
    from nacre.picture.shapes.bottle import bottle, bottle_cap

    return [Part(bottle()), Part(bottle_cap(), "dark")]


@functools.cache
def _knob() -> list[Part]:
    from nacre.picture.shapes.knob import knob, knob_core, knob_foot

    return [Part(knob()), Part(knob_core(), "white"), Part(knob_foot(), "dark")]


@functools.cache
def _body() -> list[Part]:
    from nacre.picture.shapes.body import car

    built = car()
    return [
        Part(built.paint),
        Part(built.glass, "glass"),
        Part(built.trim, "rubber"),
        Part(built.lamps, "lamp"),
        Part(built.tyres, "rubber"),
        Part(built.rims, "chrome"),
    ]


@functools.cache
def _beetle() -> list[Part]:
    from nacre.picture.shapes.beetle import beetle_limbs, beetle_shell

    return [Part(beetle_shell()), Part(beetle_limbs(), "dark")]


@functools.cache
def _ring() -> list[Part]:
    from nacre.picture.shapes.ring import film_in_ring, ring_stand, ring_wire

    turn = rotation("z", RING_DEG)
    film, wire, stand = (surface.moved(turn) for surface in (film_in_ring(), ring_wire(), ring_stand()))
    return [Part(film), Part(wire, "dark"), Part(stand, "dark")]


@functools.cache
def _cuff() -> list[Part]:
    from nacre.picture.shapes.cuff import cuff

    return [Part(cuff())]


@functools.cache
def _banknote() -> list[Part]:
    from nacre.picture.shapes.paper import banknote, banknote_foil

    return [Part(banknote_foil()), Part(banknote(), "banknote")]


@functools.cache
def _card() -> list[Part]:
    from nacre.picture.shapes.paper import card_coat, card_paper

    return [Part(card_coat()), Part(card_paper(False), "paper"), Part(card_paper(True), "black")]


SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        Scene("sphere", _sphere, View((0.0, -8.6, 2.7), (0.0, 0.0, 0.93), 19.0)),
        Scene("probe", _sphere, View((0.0, -7.6, 4.2), (0.0, 0.0, 0.85), 24.0), "bowl", "directional"),
        Scene("speedshape", _speedshape, View((-4.6, -7.6, 4.1), (0.0, 0.0, 0.5), 26.0), size=(800, 520)),
        Scene("panel", _panel, View((0.0, -8.2, 4.6), (0.0, 0.1, 0.36), 27.5), light="line", size=(800, 520)),
        Scene("butterfly", _butterfly, View((0.0, -4.4, 9.4), (0.0, 0.12, 0.1), 29.0), "board", size=(800, 600)),
        Scene("bottle", _bottle, View((0.0, -11.5, 3.6), (0.0, 0.0, 1.6), 17.5), max_depth=8, size=(512, 640)),
        Scene("knob", _knob, View((1.3, -8.8, 4.0), (0.0, 0.0, 1.18), 20.5), max_depth=8),
        Scene(
            "body",
            _body,
            View((6.4, -7.6, 2.3), (0.05, 0.0, 0.56), 26.5),
            size=(960, 540),
            place_view=View((6.9, -7.6, 1.35), (0.05, 0.0, 0.86), 30.0),
        ),  # fmt: skip
        Scene("beetle", _beetle, View((0.0, -5.6, 8.6), (0.0, -0.05, 0.2), 25.0), "board", size=(640, 720)),
        Scene("ring", _ring, View((0.0, -9.0, 2.6), (0.0, 0.0, 1.6), 22.5), "dark", size=(640, 720)),
        Scene("cuff", _cuff, View((0.0, -8.0, 4.2), (0.0, 0.0, 0.55), 24.5), size=(800, 600), max_depth=8),
        Scene("banknote", _banknote, View((0.0, -6.4, 5.6), (0.0, 0.0, 0.3), 27.0), size=(800, 520)),
        Scene("card", _card, View((0.0, -8.6, 5.2), (0.0, 0.1, 0.95), 21.0), size=(640, 720)),
    )
}
# shapes that `shape=` knows: the subjects of the scenes above
SHAPES: dict[str, Callable[[], list[Part]]] = {name: scene.parts for name, scene in SCENES.items() if name != "probe"}
SCENE_NAMES = (*SCENES, "screen")


def scene(name: str) -> Scene:
    """Return a scene by its name.

    Raises:
        NacreError: no such scene.
    """
    if name not in SCENES:
        raise NacreError(
            f'scene "{name}" is not known.{did_you_mean(name, SCENE_NAMES)} '
            f"Choose from {', '.join(SCENE_NAMES)} or a Mitsuba .xml file"
        )
    return SCENES[name]


def backdrop_parts(kind: Backdrop, see_through: bool, place_floor: str | None) -> list[tuple[Mesh, dict[str, Any]]]:
    """The stage: a sweep, a chessboard bowl, a board; a plain ground where an environment is to be seen.

    A transparent subject gets a chequered sweep, since glass is seen by its refraction, but for one that is shown by
    what it reflects, before a dark one.
    """
    if kind == "none":
        return []
    if kind == "bowl":
        return [(stages.bowl(*BOWL), chessboard(BOWL_SQUARE))]
    if place_floor is not None:
        # a place paints its own ground beyond the subject's surroundings; a bare sky has none below the horizon
        side = 8000.0 if place_floor == "plain" else 60.0
        return [(stages.tile(side, side), plain_material(place_floor))]
    if kind == "board":
        return [(stages.sweep(*BOARD), MATERIALS["board"])]
    surface = stages.sweep(*SWEEP)
    if kind == "dark":
        return [(surface, MATERIALS["black"])]
    if see_through:  # dark, so that the faint colours of a film on glass stand before it
        return [(surface, chessboard(SQUARE, 0.012, 0.11))]
    return [(surface, graded(40.0, float(surface.uv[:, 1].max()), 16.0))]
