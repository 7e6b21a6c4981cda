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

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.device.variant import use_variant
from nacre.picture.camera import View
from nacre.picture.scenes import grounds
from nacre.picture.shapes import backdrop as stages
from nacre.picture.shapes.mesh import Mesh, rotation

SUBJECT = "nacre"  # parts with this material take the one that is rendered
# half width, front, back, radius and height of `backdrop.sweep`; flat, reach and rise of `backdrop.bowl`; chequers
SWEEP, BOARD, BOWL = (20.0, 16.0, 5.0, 4.5, 5.2), (12.0, 12.0, 12.0, 2.0, 3.0), (1.4, 9.0, 4.2)
SQUARE, BOWL_SQUARE = 0.55, 0.62
# by backdrop, where it is a sweep; behind black acrylic the wall is so high that the plate mirrors no edge of it
SWEEPS = {
    "sweep": SWEEP,
    "desk": BOARD,
    "specimen": BOARD,
    "acrylic": (20.0, 16.0, 5.0, 4.5, 10.0),
}
PLATE = (40.0, 26.0)  # of black acrylic: wide and deep
# what stands on the labels of insects, and how long ten millimetres are beside them
LABELS = {
    "label-butterfly": (("Morpho didius", "PERU  Satipo, 700 m", "leg. 12.iv.1987"), 0.436),
    "label-feather": (("Garrulus glandarius", "upper wing covert", "SAXONY  9.x.1991"), 0.86),
    "label-beetle": (("Chrysochroa sp.", "THAILAND  Chiang Mai", "leg. 3.vi.1994"), 0.886),
}
# sizes of soap bubbles, and how far they have drifted from where a ball of that size rests on the floor
BUBBLES = ((1.0, (-0.1, 0.0, 0.03)), (0.3, (1.02, -0.9, 0.05)), (0.17, (0.98, 1.6, 1.9)), (0.12, (-1.25, 2.4, 0.3)))
RING_DEG = -24.0  # so turned, a film in its ring mirrors the large soft box
Backdrop = Literal["sweep", "bowl", "desk", "acrylic", "specimen", "none"]


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
        props: what stands beside the subject on its stage, but not where the light is a place.
    """

    name: str
    parts: Callable[[], list[Part]]
    view: View
    backdrop: Backdrop = "sweep"
    light: str = "studio"
    max_depth: int = 6
    size: tuple[int, int] = (640, 640)
    place_view: View | None = None
    props: Callable[[], list[Part]] = list


# reflectances and simple models of everything that is not the subject; of what is printed as it is on the whole
MATERIALS: dict[str, dict[str, Any]] = {
    "ground": {"type": "diffuse", "reflectance": 0.16},
    "plain": {"type": "diffuse", "reflectance": 0.16},
    "dark": {"type": "plastic", "int_ior": 1.5, "diffuse_reflectance": 0.015},
    "matt-dark": {"type": "diffuse", "reflectance": 0.02},
    "rubber": {"type": "roughplastic", "int_ior": 1.5, "alpha": 0.35, "diffuse_reflectance": 0.018},
    "glass": {"type": "plastic", "int_ior": 1.45, "diffuse_reflectance": 0.008},
    "lamp": {"type": "plastic", "int_ior": 1.5, "diffuse_reflectance": 0.55},
    "chrome": {"type": "roughconductor", "material": "Cr", "alpha": 0.18},
    "white": {"type": "diffuse", "reflectance": 0.8},
    "velvet": {"type": "diffuse", "reflectance": 0.008},
    "fur": {"type": "roughplastic", "int_ior": 1.55, "alpha": 0.3, "diffuse_reflectance": 0.02},
    "horn": {"type": "roughplastic", "int_ior": 1.55, "alpha": 0.16, "diffuse_reflectance": 0.008},
    "enamel": {"type": "roughplastic", "int_ior": 1.5, "alpha": 0.22, "diffuse_reflectance": 0.006},
    "margins": {"type": "diffuse", "reflectance": 0.02},
    "plate": {"type": "diffuse", "reflectance": 0.5},
    "card-white": {"type": "diffuse", "reflectance": 0.74},
    "card-black": {"type": "diffuse", "reflectance": 0.012},
    "name-ring": {"type": "diffuse", "reflectance": 0.03},
    "pass": {"type": "roughplastic", "int_ior": 1.5, "alpha": 0.06, "diffuse_reflectance": 0.06},
    "barbs": {"type": "diffuse", "reflectance": 0.02},
    "quill": {"type": "roughplastic", "int_ior": 1.54, "alpha": 0.2, "diffuse_reflectance": 0.1},
    "down": {"type": "diffuse", "reflectance": 0.3},
    "gilt": {"type": "roughconductor", "material": "Au", "alpha": 0.15},
    "steel": {"type": "roughconductor", "material": "Cr", "alpha": 0.08},
}


def plain_material(name: str) -> dict[str, Any]:
    """What is not the subject, by name: one of `MATERIALS`, a printed note, a room's boards with their spectrum."""
    if name == "banknote":
        return grounds.printed_note()
    if name == "deck":
        return grounds.wood()
    if name in LABELS:
        from nacre.picture.shapes.insects import label_print

        return {"type": "diffuse", "reflectance": grounds.grey_bitmap(label_print(*LABELS[name])[::-1])}
    if name in ("card-white", "card-black"):
        from nacre.picture.shapes.printed import card_print

        return {"type": "diffuse", "reflectance": grounds.grey_bitmap(card_print(name == "card-black")[::-1])}
    if name == "pass":
        return grounds.printed_card()
    if name == "name-ring":
        from nacre.picture.shapes.objects import ring_print

        return {"type": "diffuse", "reflectance": grounds.grey_bitmap(ring_print()[::-1])}
    if name == "plate":
        from nacre.picture.shapes.car import plate_print

        return {"type": "diffuse", "reflectance": grounds.grey_bitmap(plate_print()[::-1])}
    if name == "margins":
        from nacre.picture.shapes.insects import margin_print

        return {"type": "diffuse", "reflectance": grounds.grey_bitmap(margin_print()[::-1])}
    if name != "boards":
        return MATERIALS[name]
    from nacre.picture.lights.environments import WOOD

    return grounds.matt(WOOD)


@functools.cache
def _sphere() -> list[Part]:
    import mitsuba as mi

    # Mitsuba's sphere counts v from its upper pole; reflected, v runs upward as on all our shapes, and u still to the
    # right. The reflection turns the normals inward, which `flip_normals` undoes.
    upright = mi.ScalarTransform4f().translate([0.0, 0.0, 1.0]).scale([1.0, 1.0, -1.0])
    return [Part({"type": "sphere", "to_world": upright, "flip_normals": True})]


@functools.cache
def _bubbles() -> list[Part]:
    return [part for size, place in BUBBLES for part in _at(_sphere(), size, place)]


def _at(parts: list[Part], scale: float, place: tuple[float, float, float]) -> list[Part]:
    """Pieces in another size, moved so far."""
    mi = use_variant()
    moved = []
    for part in (part.scaled(scale) for part in parts):
        assert isinstance(part.shape, dict)
        to_world = mi.ScalarTransform4f().translate(list(place)) @ part.shape["to_world"]
        moved.append(Part({**part.shape, "to_world": to_world}, part.material))
    return moved


@functools.cache
def _speedshape() -> list[Part]:
    from nacre.picture.shapes.objects import speedshape

    return [Part(speedshape())]


@functools.cache
def _panel() -> list[Part]:
    flat = stages.sheet(1.7, 1.9).moved(rotation("x", 24.0), (-1.08, 0.0, 0.4))
    bent = stages.rolled(1.7, 0.82, 170.0).moved(np.eye(3), (1.08, 0.0, 0.0))
    return [Part(flat), Part(bent)]


@functools.cache
def _butterfly() -> list[Part]:
    from nacre.picture.shapes import insects as b

    lift = (0.0, 0.0, 0.06)
    return [
        Part(b.butterfly_wings().moved(np.eye(3), lift)),
        Part(b.butterfly_margins().moved(np.eye(3), lift), "margins"),
        Part(b.butterfly_veins().moved(np.eye(3), lift), "velvet"),
        Part(b.butterfly_body().moved(np.eye(3), lift), "velvet"),
        Part(b.butterfly_fur().moved(np.eye(3), lift), "fur"),
    ]


@functools.cache
def _butterfly_props() -> list[Part]:
    from nacre.picture.shapes.insects import label, pin

    return [Part(pin(0.0, 0.3, 1.0), "steel"), Part(label(1.85, -1.8), "label-butterfly")]


@functools.cache
def _beetle_props() -> list[Part]:
    from nacre.picture.shapes.insects import label, pin

    return [Part(pin(0.24, 0.28, 1.25), "steel"), Part(label(1.3, -2.0), "label-beetle")]


@functools.cache
def _bottle() -> list[Part]:
    from nacre.picture.shapes.objects import bottle, bottle_cap

    return [Part(bottle()), Part(bottle_cap(), "dark")]


@functools.cache
def _knob() -> list[Part]:
    from nacre.picture.shapes.objects import knob, knob_core, knob_foot

    return [Part(knob()), Part(knob_core(), "white"), Part(knob_foot(), "dark")]


@functools.cache
def _body() -> list[Part]:
    from nacre.picture.shapes.car import car

    built = car()
    return [
        Part(built.paint),
        Part(built.glass, "glass"),
        Part(built.trim, "rubber"),
        Part(built.lamps, "lamp"),
        Part(built.tyres, "rubber"),
        Part(built.rims, "chrome"),
        Part(built.mirrors),
        Part(built.seams, "matt-dark"),
        Part(built.handles, "chrome"),
        Part(built.plate, "plate"),
    ]


@functools.cache
def _beetle() -> list[Part]:
    from nacre.picture.shapes.insects import beetle_limbs, beetle_shell

    return [Part(beetle_shell()), Part(beetle_limbs(), "horn")]


@functools.cache
def _ring() -> list[Part]:
    from nacre.picture.shapes.objects import film_in_ring, ring_stand, ring_wire

    turn = rotation("z", RING_DEG)
    film, wire, stand = (surface.moved(turn) for surface in (film_in_ring(), ring_wire(), ring_stand()))
    return [Part(film), Part(wire, "dark"), Part(stand, "dark")]


@functools.cache
def _cuff() -> list[Part]:
    from nacre.picture.shapes.objects import cuff

    return [Part(cuff())]


@functools.cache
def _banknote() -> list[Part]:
    from nacre.picture.shapes.printed import banknote, banknote_foil

    return [Part(banknote_foil()), Part(banknote(), "banknote")]


@functools.cache
def _feather() -> list[Part]:
    from nacre.picture.shapes import insects as f

    return [
        Part(f.feather_blue()),
        Part(f.feather_dark(), "barbs"),
        Part(f.feather_shaft(), "quill"),
        Part(f.feather_down(), "down"),
    ]


@functools.cache
def _feather_props() -> list[Part]:
    from nacre.picture.shapes.insects import label

    return [Part(label(1.85, -1.9), "label-feather")]


@functools.cache
def _pass() -> list[Part]:
    from nacre.picture.shapes import printed as p

    return [Part(p.seal()), Part(p.card_face(), "pass"), Part(p.card_rim(), "white"), Part(p.chip(), "gilt")]


@functools.cache
def _pass_props() -> list[Part]:
    from nacre.picture.shapes.printed import block

    return [Part(block(), "dark")]


@functools.cache
def _strip() -> list[Part]:
    from nacre.picture.shapes.objects import balls, holders

    return [Part(balls()), Part(holders(), "horn")]


@functools.cache
def _lens() -> list[Part]:
    from nacre.picture.shapes import objects

    return [
        Part(objects.elements()),
        Part(objects.barrel(), "enamel"),
        Part(objects.name_ring(), "name-ring"),
        Part(objects.blades(), "velvet"),
    ]


@functools.cache
def _card() -> list[Part]:
    from nacre.picture.shapes.printed import card_coat, card_paper

    return [Part(card_coat()), Part(card_paper(False), "card-white"), Part(card_paper(True), "card-black")]


SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        Scene("sphere", _sphere, View((0.0, -8.6, 2.7), (0.0, 0.0, 0.93), 19.0)),
        Scene("probe", _sphere, View((0.0, -7.6, 4.2), (0.0, 0.0, 0.85), 24.0), "bowl", "directional"),
        Scene("speedshape", _speedshape, View((-4.6, -7.6, 4.1), (0.0, 0.0, 0.5), 26.0), size=(800, 520)),
        Scene("panel", _panel, View((0.0, -8.2, 4.6), (0.0, 0.1, 0.36), 27.5), light="line", size=(800, 520)),
        Scene(
            "butterfly",
            _butterfly,
            View((0.0, -3.3, 9.9), (0.0, -0.22, 0.1), 31.0, lens=0.05),
            "specimen",
            size=(800, 600),
            props=_butterfly_props,
        ),
        Scene("bottle", _bottle, View((0.0, -11.5, 3.6), (0.0, 0.0, 1.6), 17.5), max_depth=8, size=(512, 640)),
        Scene("knob", _knob, View((1.3, -8.8, 4.0), (0.0, 0.0, 1.18), 20.5), max_depth=8),
        Scene(
            "body",
            _body,
            View((6.4, -7.6, 2.3), (0.05, 0.0, 0.42), 28.0, lens=0.05, nearer=1.2),
            "acrylic",
            size=(960, 540),
            place_view=View((6.9, -7.6, 1.35), (0.05, 0.0, 0.86), 30.0, lens=0.06, nearer=1.2),
        ),  # fmt: skip
        Scene("bubble", _bubbles, View((0.0, -9.0, 0.3), (0.0, 0.0, 1.07), 19.0, lens=0.09), "acrylic", "garden"),
        Scene(
            "beetle",
            _beetle,
            View((0.0, -3.6, 9.6), (0.05, -0.3, 0.35), 25.0, lens=0.1),
            "specimen",
            size=(640, 720),
            props=_beetle_props,
        ),
        Scene("ring", _ring, View((0.0, -9.0, 2.6), (0.0, 0.0, 1.56), 22.5, lens=0.05), "acrylic", size=(640, 720)),
        Scene(
            "cuff",
            _cuff,
            View((0.0, -8.4, 3.0), (0.0, 0.0, 0.46), 24.5, lens=0.06, nearer=1.0),
            "acrylic",
            size=(800, 600),
            max_depth=8,
        ),
        Scene(
            "banknote", _banknote, View((-1.2, -6.4, 4.4), (0.08, -0.02, 0.22), 28.6, lens=0.1), "desk", size=(800, 520)
        ),
        Scene(
            "feather",
            _feather,
            View((0.35, -3.3, 9.9), (0.5, -0.13, 0.1), 27.8, lens=0.06),
            "specimen",
            size=(640, 640),
            props=_feather_props,
        ),
        Scene(
            "pass",
            _pass,
            View((0.0, -6.2, 5.4), (0.0, 0.0, 0.62), 31.0, lens=0.07),
            "desk",
            "directional",
            size=(800, 600),
            props=_pass_props,
        ),
        Scene("strip", _strip, View((0.0, -9.4, 3.0), (0.0, 0.0, 0.3), 40.0, lens=0.07), "acrylic", size=(960, 400)),
        Scene("lens", _lens, View((1.0, -5.2, 6.2), (0.0, 0.0, 1.05), 26.0, lens=0.09, nearer=0.7), "desk"),
        Scene("card", _card, View((-1.6, -8.4, 5.2), (0.0, 0.1, 0.9), 22.0, lens=0.07), "desk", size=(640, 720)),
    )
}
# shapes that `shape=` knows: the subjects of the scenes above that stand, once each
SHAPES: dict[str, Callable[[], list[Part]]] = {
    name: scene.parts for name, scene in SCENES.items() if name not in ("probe", "bubble")
}
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
    """The stage: a sweep, a bowl, a desk, a museum's board, black acrylic; a plain ground where a place is to be seen.

    A transparent subject gets a chequered sweep, since glass is seen by its refraction, but for one that is shown by
    what it reflects, before a dark one.
    """
    if kind == "none":
        return []
    if kind == "bowl":
        return [(stages.bowl(*BOWL), grounds.chessboard(BOWL_SQUARE))]
    if place_floor is not None:
        # a place paints its own ground beyond the subject's surroundings; a bare sky has none below the horizon
        side = 8000.0 if place_floor == "plain" else 60.0
        return [(stages.tile(side, side), plain_material(place_floor))]
    surface = stages.sweep(*SWEEPS[kind])
    if kind == "desk":
        return [(surface, grounds.wood())]
    if kind == "specimen":
        return [(surface, grounds.museum_board())]
    if kind == "acrylic":
        plate = stages.tile(*PLATE).moved(np.eye(3), (0.0, -6.0, 0.001))  # above the matt ground
        return [(surface, grounds.halo(40.0, float(surface.uv[:, 1].max()), 25.5)), (plate, grounds.acrylic())]
    if see_through:  # dark, so that the faint colours of a film on glass stand before it
        return [(surface, grounds.chessboard(SQUARE, 0.012, 0.11))]
    return [(surface, grounds.graded(40.0, float(surface.uv[:, 1].max()), 16.0))]
