"""A built scene: Mitsuba objects of one picture, kept and reused while only material, camera or seed change.

Building a scene anew for each picture grows memory and time (mitsuba3 issue 563), so the scene stays and the
object's BSDF is updated or exchanged.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import plain, why_unreadable
from nacre.device.texture import ObjectFrame
from nacre.device.variant import use_variant
from nacre.picture.camera import Framing, View
from nacre.picture.infinite_backdrop import endless_of
from nacre.picture.lights.named import Light
from nacre.picture.scenes.catalogue import SUBJECT, Part, Scene, backdrop_parts, plain_material
from nacre.picture.shapes.mesh import Mesh, bounding_ball, rotation

SEE_THROUGH_DEPTH = 16


def make_mesh(surface: Mesh, bsdf: Any, name: str = "mesh") -> Any:
    """Return a `mi.Mesh` of a surface with vertex normals and uv."""
    mi = use_variant()
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    mesh = mi.Mesh(
        name,
        len(surface.vertices),
        len(surface.faces),
        props=properties,
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    buffers = mi.traverse(mesh)
    buffers["vertex_positions"] = np.ascontiguousarray(surface.vertices, dtype=np.float32).ravel()
    buffers["vertex_normals"] = np.ascontiguousarray(surface.normals, dtype=np.float32).ravel()
    buffers["vertex_texcoords"] = np.ascontiguousarray(surface.uv, dtype=np.float32).ravel()
    buffers["faces"] = np.ascontiguousarray(surface.faces, dtype=np.uint32).ravel()
    buffers.update()
    return mesh


class BuiltScene:
    """A scene in Mitsuba, to be given materials and cameras.

    Args:
        scene: what to build.
        light: its light.
        see_through: whether the material transmits: a chequered backdrop and longer paths.
        turn_deg: how far the subject is turned about the vertical axis.
        backdrop_deg: how far the backdrop is, to stay behind the subject of a camera that goes round.
        is_plain: no chequers, for subjects that are cut out.
    """

    def __init__(
        self,
        scene: Scene,
        light: Light,
        see_through: bool,
        turn_deg: float = 0.0,
        backdrop_deg: float = 0.0,
        is_plain: bool = False,
    ) -> None:
        mi = use_variant()
        self.scene, self.light = scene, light
        self.depth = max(scene.max_depth, SEE_THROUGH_DEPTH) if see_through else scene.max_depth
        made: dict[str, Any] = {}

        def material(name: str) -> Any:
            if name not in made:
                made[name] = mi.load_dict(plain_material(name if name != SUBJECT else "white"))
            return made[name]

        content: dict[str, Any] = {"type": "scene"}
        subjects = []
        parts = [part.turned(turn_deg) if turn_deg else part for part in scene.parts()]
        for index, part in enumerate(parts):
            content[f"part{index}"] = _shape(part, material(part.material), f"{part.material}{index}")
            if part.material == SUBJECT:
                subjects.append(content[f"part{index}"])
        if not light.is_surrounding:
            for index, prop in enumerate(scene.props()):
                content[f"prop{index}"] = _shape(prop, material(prop.material), f"{prop.material}{index}")
        floor = light.floor if light.is_surrounding else None
        is_chequered = see_through and not is_plain
        self.endless = endless_of(scene.backdrop, is_chequered, backdrop_deg) if floor is None else None
        for index, (surface, look) in enumerate(backdrop_parts(scene.backdrop, is_chequered, floor)):
            behind = surface.moved(rotation("z", backdrop_deg)) if backdrop_deg else surface
            content[f"backdrop{index}"] = make_mesh(behind, mi.load_dict(look))
        content.update({f"light_{name}": emitter for name, emitter in light.emitters.items()})
        self.content, self.subjects = content, subjects
        self.frame = _frame(scene, turn_deg)
        self.objects = [content[f"part{index}"] for index in range(len(parts))]
        self.mitsuba_scene = mi.load_dict(content)
        self._material: Any = None
        self._source: Any = None

    def set_material(self, material: Any) -> None:
        """Give the subject a `Bsdf` or a ready `mi.BSDF`; numbers of the same structure need no new kernel."""
        if material is self._source and self._material is not None:
            return
        self._source = material
        if isinstance(material, Bsdf):
            from nacre.device.bsdf import make_bsdf, update_bsdf

            if self._material is not None and hasattr(self._material, "plugins"):
                try:
                    update_bsdf(self._material, material)
                    return
                except UnsupportedError:
                    pass  # another structure: exchange the whole BSDF instead
            self._material = make_bsdf(material, two_sided=True, object_frame=self.frame)
        else:
            self._material = material
        for shape in self.subjects:
            shape.set_bsdf(self._material)

    @property
    def radius(self) -> float:
        """Of the objects: half of the longest side of the box about all of them."""
        boxes = [shape.bbox() for shape in self.objects]
        low = np.min([np.array(box.min) for box in boxes], axis=0)
        high = np.max([np.array(box.max) for box in boxes], axis=0)
        return float(0.5 * (high - low).max())

    def view(self, framing: Framing) -> View:
        """Return the scene's camera, the one for places where its light is a place, framed as asked for.

        Raises:
            NacreError: it would stand below the floor.
        """
        place_view = self.scene.place_view if self.light.is_surrounding else None
        return framing.of(place_view or self.scene.view, self.radius)

    def sensor(
        self, view: View, size: tuple[int, int], film: dict[str, Any], spp: int = 4, sampler: Any = None,
        response: Any = None, rows: int | None = None,
    ) -> Any:  # fmt: skip
        """Return a camera with its film; `sampler`, `response` None: Mitsuba's own; `rows`: so many in the middle."""
        mi = use_variant()
        # a wider picture keeps the scene's height, a narrower one its width: the subject always fits
        half = np.tan(np.radians(0.5 * view.fov_deg))
        is_wider = size[0] / size[1] > self.scene.size[0] / self.scene.size[1]
        half_x = half * (self.scene.size[1] / self.scene.size[0]) * (size[0] / size[1]) if is_wider else half
        return mi.load_dict(
            {
                "type": "thinlens" if view.lens else "perspective",
                **({"aperture_radius": view.lens, "focus_distance": view.focus} if view.lens else {}),
                "fov": float(2 * np.degrees(np.arctan(half_x))),
                "fov_axis": "x",
                "near_clip": 1e-3,  # depths count from there
                "far_clip": 1e4,
                "to_world": mi.ScalarTransform4f().look_at(list(view.origin), list(view.target), list(view.up)),
                "film": {**film, "width": size[0], "height": rows or size[1]},
                **({"srf": response} if response else {}),
                "sampler": sampler or {"type": "multijitter", "sample_count": spp},
            }
        )


def _frame(scene: Scene, turn_deg: float) -> ObjectFrame:
    """The space of formulas of x, y and z: that of the parts which take the material, before they were turned."""
    points = np.concatenate([part.points() for part in scene.parts() if part.material == SUBJECT])
    centre, radius = bounding_ball(points)
    return ObjectFrame(tuple(float(value) for value in centre), radius, turn_deg)


def _shape(part: Part, bsdf: Any, name: str) -> Any:
    if isinstance(part.shape, Mesh):
        return make_mesh(part.shape, bsdf, name)
    mi = use_variant()
    return mi.load_dict({**part.shape, "bsdf": bsdf})


def with_subject(scene: Scene, parts: Any) -> Scene:
    """The same scene around another subject, without what belongs to its own."""
    return replace(scene, parts=parts, props=list)


# A user's own Mitsuba scene: its BSDFs of id "nacre" are replaced by the material.

DEFAULT_DEPTH = 16
# numbers of a perspective camera, and of one with a lens, besides its angle and place
KEPT_OF_CAMERAS = (
    "near_clip", "far_clip", "principal_point_offset_x", "principal_point_offset_y", "aperture_radius",
    "focus_distance",
)  # fmt: skip
FARTHEST = 1e30  # beyond, the square of a distance overflows in single precision


class UserScene:
    """The scene of a Mitsuba .xml file, with the methods of `nacre.picture.built_scene.BuiltScene`.

    Raises:
        NacreError: missing or unreadable, without a camera, or without a shape whose BSDF has the id "nacre".
    """

    def __init__(self, path: Path) -> None:
        try:
            plain(path)
        except OSError as error:
            raise NacreError(f"scene {path}: {why_unreadable(error)}") from None
        mi = use_variant()
        logger = mi.logger()
        level = logger.log_level()
        logger.set_log_level(mi.LogLevel.Error)  # what it warns of and matters is told below
        try:
            scene = mi.load_file(str(path))
        except Exception as error:  # Mitsuba raises several kinds; all mean: this scene cannot be loaded
            raise NacreError(f"scene {path}: Mitsuba cannot load it: {_last_words(error)}") from None
        finally:
            logger.set_log_level(level)
        if not isinstance(scene, mi.Scene):
            raise NacreError(f"scene {path}: holds no scene")
        if not scene.sensors():
            raise NacreError(f"scene {path}: has no camera (sensor)")
        wearers = _wearers(mi, path)
        # images stand upright where all who wear them agree; Mitsuba melts meshes together, and with them their v
        self.v_up = not wearers or not all(map(_runs_down, wearers))
        self.endless = None  # its surroundings are its own
        self.path, self.mitsuba_scene, self.depth = path, scene, DEFAULT_DEPTH
        self.subjects = [s for s in scene.shapes() if s.bsdf() is not None and s.bsdf().id() == SUBJECT]
        if not self.subjects:
            raise NacreError(
                f'scene {path}: no shape has a BSDF with the id "{SUBJECT}"; give the one to replace '
                f'this id, such as <bsdf type="diffuse" id="{SUBJECT}"/>'
            )
        _check_extents(scene, path)
        self.objects = self.subjects
        self.has_media = any(shape.is_medium_transition() for shape in scene.shapes())
        size = scene.sensors()[0].film().size()
        self.size = (int(size[0]), int(size[1]))
        self._source: Any = None

    def set_material(self, material: Any) -> None:
        """Give the named shapes a `Bsdf` or a ready `mi.BSDF`."""
        if material is self._source:
            return
        from nacre.device.bsdf import make_bsdf

        self._source = material
        made = make_bsdf(material, two_sided=True, v_up=self.v_up) if isinstance(material, Bsdf) else material
        for shape in self.subjects:
            shape.set_bsdf(made)

    def sensor(
        self, view: object, size: tuple[int, int], film: dict[str, Any], sampler: Any = None, rows: int | None = None
    ) -> Any:
        """Return the scene's first camera with our film; `view` is ignored; `rows`: as many about the middle alone.

        Raises:
            NacreError: the camera is of a kind that cannot be copied.
        """
        mi = use_variant()
        camera = self.mitsuba_scene.sensors()[0]
        values = mi.traverse(camera)
        try:
            kind, transform = camera.plugin_name(), values["to_world"]
        except (AttributeError, KeyError):
            kind, transform = "perspective", camera.world_transform()
        is_lens = "aperture_radius" in values
        settings: dict[str, Any] = {
            "type": "thinlens" if is_lens else "perspective",
            "to_world": mi.ScalarTransform4f(np.array(transform.matrix, dtype=float).reshape(4, 4)),
            "film": {**film, "width": size[0], "height": rows or size[1]},
            "sampler": sampler or {"type": "multijitter"},
        }
        try:
            settings |= {"fov": float(np.ravel(values["x_fov"])[0]), "fov_axis": "x"}
        except KeyError:
            raise NacreError(f"scene {self.path}: only perspective cameras are supported, not {kind}") from None
        settings |= {name: float(np.ravel(values[name])[0]) for name in KEPT_OF_CAMERAS if name in values}
        if rows and "principal_point_offset_y" in settings:  # in heights of the picture, not of its middle rows
            settings["principal_point_offset_y"] *= size[1] / rows
        return mi.load_dict(settings)


def _wearers(mi: Any, path: Path) -> list[Any]:
    """Return the nodes of the shapes whose BSDF is to be exchanged.

    Raises:
        NacreError: one of them is where Mitsuba lets nobody exchange it, and would stay what it is in silence: inside
            another BSDF, or on a shape of a shapegroup.
    """
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(path))
    mi.parser.transform_resolve_references(config, state)
    nodes = state.nodes

    def children(node: Any) -> list[Any]:
        held = (value for _, value in node.props.items())
        return [nodes[value.index()] for value in held if isinstance(value, mi.Properties.ResolvedReference)]

    def wears_it(node: Any) -> bool:
        return any(child.type.name == "BSDF" and child.props.id() == SUBJECT for child in children(node))

    for node in nodes:
        kind = node.props.plugin_name()
        if node.type.name == "BSDF" and wears_it(node):
            where, what = f"inside a BSDF of type {kind}", f'give the id "{SUBJECT}" to that one'
        elif kind == "shapegroup" and any(wears_it(shape) for shape in children(node)):
            where, what = "on a shape of a shapegroup", "put the shape into the scene itself"
        else:
            continue
        raise NacreError(
            f'scene {path}: the BSDF of id "{SUBJECT}" stands {where}, where it cannot be exchanged; {what}, or write '
            '<bsdf type="nacre"> with your recipe there and render with Mitsuba after `import nacre.render`'
        )
    return [node for node in nodes if node.type.name == "Shape" and wears_it(node)]


def _runs_down(shape: Any) -> bool:
    """Whether v runs down on a shape of Mitsuba: its sphere, and a mesh whose reader turns the file's v about."""
    kind = shape.props.plugin_name()
    turned = shape.props.get("flip_tex_coords", kind == "obj")
    return kind == "sphere" or (kind in ("obj", "ply", "serialized") and bool(turned))


def _check_extents(scene: Any, path: Path) -> None:
    """Refuse shapes and cameras that are nowhere: Mitsuba renders around them in silence.

    Raises:
        NacreError: a shape without a finite size above 0, or a camera whose place is not finite.
    """
    for shape in scene.shapes():
        box = shape.bbox()
        corners = np.array([np.ravel(box.min), np.ravel(box.max)])
        # Mitsuba marks a box of nothing by corners at the ends of what a float holds
        if not (np.abs(corners).max() < FARTHEST and np.ptp(corners, axis=0).max() > 0.0):
            raise NacreError(
                f"scene {path}: a shape of type {shape.class_name()} has no finite size above 0; look at its radius, "
                "its centre and its to_world"
            )
    if not np.isfinite(np.array(scene.sensors()[0].world_transform().matrix)).all():
        raise NacreError(f"scene {path}: the camera's place is not finite; look at its to_world")


def _last_words(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return " ".join(lines[-2:])[:240] if lines else type(error).__name__
