"""Scenes as Mitsuba objects, with exchangeable material and camera: built scenes and user scenes.

Building a scene anew for each picture increases memory and time (mitsuba3 issue 563). Scenes are therefore cached, and
the object's BSDF is updated or exchanged.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import size_of
from nacre.device.tables import ObjectFrame
from nacre.picture.camera import Framing, View
from nacre.picture.emitters import Light
from nacre.picture.mesh import Mesh, bounding_ball, rotation
from nacre.picture.plugins import mi
from nacre.picture.scenes import (
    SUBJECT,
    Part,
    Parts,
    Scene,
    backdrop_parts,
    infinite_backdrop,
    plain_material,
)

SEE_THROUGH_DEPTH = 16
DEFAULT_DEPTH = 16
# values copied from user cameras, besides angle and position
COPIED_CAMERA_VALUES = (
    "near_clip",
    "far_clip",
    "principal_point_offset_x",
    "principal_point_offset_y",
    "aperture_radius",
    "focus_distance",
)
MAX_POINTS = 20_000  # vertices of a subject tested against the frame
FARTHEST = 1e30  # larger distances squared overflow in single precision


def make_mesh(surface: Mesh, bsdf: Any, name: str = "mesh") -> Any:
    """Return a `mi.Mesh` with vertex normals and uv."""
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    sizes = len(surface.vertices), len(surface.faces)
    mesh = mi.Mesh(name, *sizes, props=properties, has_vertex_normals=True, has_vertex_texcoords=True)
    buffers = mi.traverse(mesh)
    for key, values in (("positions", surface.vertices), ("normals", surface.normals), ("texcoords", surface.uv)):
        buffers[f"vertex_{key}"] = np.ascontiguousarray(values, dtype=np.float32).ravel()
    buffers["faces"] = np.ascontiguousarray(surface.faces, dtype=np.uint32).ravel()
    buffers.update()
    return mesh


class BuiltScene:
    """A scene from our catalogue in Mitsuba.

    Args:
        scene: the scene.
        light: its light.
        see_through: whether the material transmits light, which requires a chequered backdrop and longer paths.
        turn_deg: subject turn about the vertical axis.
        backdrop_deg: backdrop turn, which follows the camera.
        is_plain: a backdrop without chequers, for cut-out subjects.
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
        self.scene, self.light = scene, light
        self.depth = max(scene.max_depth, SEE_THROUGH_DEPTH) if see_through else scene.max_depth
        made: dict[str, Any] = {}

        def shape(part: Part, index: int) -> Any:
            if part.material not in made:
                name = "white" if part.material == SUBJECT else part.material
                made[part.material] = mi.load_dict(plain_material(name))
            if isinstance(part.shape, Mesh):
                return make_mesh(part.shape, made[part.material], f"{part.material}{index}")
            return mi.load_dict({**part.shape, "bsdf": made[part.material]})

        parts = [part.turned(turn_deg) if turn_deg else part for part in scene.parts()]
        self.objects = [shape(part, index) for index, part in enumerate(parts)]
        self.subjects = [each for each, part in zip(self.objects, parts, strict=True) if part.material == SUBJECT]
        content: dict[str, Any] = {"type": "scene"}
        content |= {f"part{index}": each for index, each in enumerate(self.objects)}
        if not light.is_surrounding:
            content |= {f"prop{index}": shape(prop, index) for index, prop in enumerate(scene.props())}
        floor = light.floor if light.is_surrounding else None
        is_chequered = see_through and not is_plain
        has_backdrop = floor is None
        self.infinite_backdrop = infinite_backdrop(scene.backdrop, is_chequered, backdrop_deg) if has_backdrop else None
        for index, (surface, material) in enumerate(backdrop_parts(scene.backdrop, is_chequered, floor)):
            behind = surface.moved(rotation("z", backdrop_deg)) if backdrop_deg else surface
            content[f"backdrop{index}"] = make_mesh(behind, mi.load_dict(material))
        content |= {f"light_{name}": emitter for name, emitter in light.emitters.items()}
        self.content = content
        self.frame = _object_frame(scene, turn_deg)
        self.points = _thinned(np.concatenate([part.points() for part in parts])) if scene.keeps_whole else None
        self.mitsuba_scene = mi.load_dict(content)
        self._material: Any = None
        self._source: Any = None

    def set_material(self, material: Any) -> None:
        """Give the subject a `Bsdf` or a `mi.BSDF`; a `Bsdf` with equal structure needs no new kernel."""
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
                    pass  # another structure
            self._material = make_bsdf(material, two_sided=True, object_frame=self.frame)
        else:
            self._material = material
        for shape in self.subjects:
            shape.set_bsdf(self._material)

    @property
    def radius(self) -> float:
        """Half the longest bounding-box side, over all objects."""
        boxes = [shape.bbox() for shape in self.objects]
        low = np.min([np.array(box.min) for box in boxes], axis=0)
        high = np.max([np.array(box.max) for box in boxes], axis=0)
        return float(0.5 * (high - low).max())

    def view(self, framing: Framing) -> View:
        """Return the scene's camera, or that for a visible place, with a framing.

        Raises:
            NacreError: it would be below the floor.
        """
        place_view = self.scene.place_view if self.light.is_surrounding else None
        return framing.of(place_view or self.scene.view, self.radius, self.points, self.scene.size)

    def sensor(
        self,
        view: View,
        size: tuple[int, int],
        film: dict[str, Any],
        spp: int = 4,
        sampler: Any = None,
        response: Any = None,
        rows: int | None = None,
    ) -> Any:
        """Return a camera with its film; default sampler and response are Mitsuba's; `rows`: central rows only."""
        # wider pictures preserve the scene height, narrower ones its width
        half = np.tan(np.radians(0.5 * view.fov_deg))
        is_wider = size[0] / size[1] > self.scene.size[0] / self.scene.size[1]
        half_x = half * (self.scene.size[1] / self.scene.size[0]) * (size[0] / size[1]) if is_wider else half
        return mi.load_dict(
            {
                "type": "thinlens" if view.lens else "perspective",
                **({"aperture_radius": view.lens, "focus_distance": view.focus} if view.lens else {}),
                "fov": float(2 * np.degrees(np.arctan(half_x))),
                "fov_axis": "x",
                "near_clip": 1e-3,  # depths start here
                "far_clip": 1e4,
                "to_world": mi.ScalarTransform4f().look_at(list(view.origin), list(view.target), list(view.up)),
                "film": {**film, "width": size[0], "height": rows or size[1]},
                **({"srf": response} if response else {}),
                "sampler": sampler or {"type": "multijitter", "sample_count": spp},
            }
        )


def _thinned(points: Array) -> Array:
    """Return at most `MAX_POINTS` of the points `[N, 3]`, with the extremes along many directions."""
    if len(points) <= MAX_POINTS:
        return points
    ends = np.random.default_rng(0).normal(size=(64, 3))
    extremes = np.unique([np.argmax(points @ end) for end in ends])
    return np.concatenate([points[extremes], points[:: -(-len(points) // MAX_POINTS)]])


def _object_frame(scene: Scene, turn_deg: float) -> ObjectFrame:
    """Coordinates for formulas in x, y and z: the subject's bounding ball before its turn."""
    points = np.concatenate([part.points() for part in scene.parts() if part.material == SUBJECT])
    centre, radius = bounding_ball(points)
    return ObjectFrame(tuple(float(value) for value in centre), radius, turn_deg)


def with_subject(scene: Scene, parts: Parts) -> Scene:
    """Return a scene with another subject, which stays whole in the frame, and without props."""
    return replace(scene, parts=parts, props=list, keeps_whole=True)


class UserScene:
    """A Mitsuba .xml scene with the interface of `BuiltScene`; BSDFs with id "nacre" take the material.

    Raises:
        NacreError: missing or unreadable, without a camera, or without a shape whose BSDF has the id "nacre".
    """

    infinite_backdrop = None

    def __init__(self, path: Path) -> None:
        size_of(path, f"scene {path}")  # refuses a missing file
        logger = mi.logger()
        level = logger.log_level()
        logger.set_log_level(mi.LogLevel.Error)  # relevant warnings are errors below
        try:
            scene = mi.load_file(str(path))
        except Exception as error:  # Mitsuba raises several types
            raise NacreError(f"scene {path}: Mitsuba cannot load it: {_last_words(error)}") from None
        finally:
            logger.set_log_level(level)
        if not isinstance(scene, mi.Scene):
            raise NacreError(f"scene {path}: holds no scene")
        if not scene.sensors():
            raise NacreError(f"scene {path}: has no camera (sensor)")
        nodes = _subject_nodes(path)
        # one v direction for all, because Mitsuba merges meshes
        self.v_up = not nodes or not all(map(_runs_down, nodes))
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
        to_world = np.array(scene.sensors()[0].world_transform().matrix, dtype=float).reshape(4, 4)
        self.up = tuple(to_world[:3, 1].tolist())  # upward direction in the picture
        size = scene.sensors()[0].film().size()
        self.size = (int(size[0]), int(size[1]))
        self._source: Any = None

    def set_material(self, material: Any) -> None:
        """Give the subject shapes a `Bsdf` or a `mi.BSDF`."""
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
        """Return the first scene camera with our film; `view` is ignored; `rows`: central rows only.

        Raises:
            NacreError: not a perspective camera.
        """
        camera = self.mitsuba_scene.sensors()[0]
        values = mi.traverse(camera)
        try:
            kind, transform = camera.plugin_name(), values["to_world"]
        except (AttributeError, KeyError):
            kind, transform = "perspective", camera.world_transform()
        settings: dict[str, Any] = {
            "type": "thinlens" if "aperture_radius" in values else "perspective",
            "to_world": mi.ScalarTransform4f(np.array(transform.matrix, dtype=float).reshape(4, 4)),
            "film": {**film, "width": size[0], "height": rows or size[1]},
            "sampler": sampler or {"type": "multijitter"},
        }
        if "x_fov" not in values:
            raise NacreError(f"scene {self.path}: only perspective cameras are supported, not {kind}")
        settings |= {"fov": float(np.ravel(values["x_fov"])[0]), "fov_axis": "x"}
        settings |= {name: float(np.ravel(values[name])[0]) for name in COPIED_CAMERA_VALUES if name in values}
        if rows and "principal_point_offset_y" in settings:  # relative to the film height
            settings["principal_point_offset_y"] *= size[1] / rows
        return mi.load_dict(settings)


def _subject_nodes(path: Path) -> list[Any]:
    """Return the shape nodes whose BSDF is to be exchanged.

    Raises:
        NacreError: Mitsuba cannot exchange a BSDF inside another BSDF or in a shapegroup.
    """
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(path))
    mi.parser.transform_resolve_references(config, state)
    nodes = state.nodes

    def children(node: Any) -> list[Any]:
        held = (value for _, value in node.props.items())
        return [nodes[value.index()] for value in held if isinstance(value, mi.Properties.ResolvedReference)]

    def has_subject(node: Any) -> bool:
        return any(child.type.name == "BSDF" and child.props.id() == SUBJECT for child in children(node))

    for node in nodes:
        kind = node.props.plugin_name()
        if node.type.name == "BSDF" and has_subject(node):
            where, what = f"inside a BSDF of type {kind}", f'give the id "{SUBJECT}" to that one'
        elif kind == "shapegroup" and any(has_subject(shape) for shape in children(node)):
            where, what = "on a shape of a shapegroup", "put the shape into the scene itself"
        else:
            continue
        raise NacreError(
            f'scene {path}: the BSDF of id "{SUBJECT}" stands {where}, where it cannot be exchanged; {what}, or write '
            '<bsdf type="nacre"> with your recipe there and render with Mitsuba after `import nacre.render`'
        )
    return [node for node in nodes if node.type.name == "Shape" and has_subject(node)]


def _runs_down(shape: Any) -> bool:
    """Return whether v runs down on a Mitsuba shape: spheres, and meshes whose reader reverses v."""
    kind = shape.props.plugin_name()
    turned = shape.props.get("flip_tex_coords", kind == "obj")
    return kind == "sphere" or (kind in ("obj", "ply", "serialized") and bool(turned))


def _check_extents(scene: Any, path: Path) -> None:
    """Check shape and camera positions, which Mitsuba would ignore.

    Raises:
        NacreError: a shape without a finite size above 0, or a camera at infinity.
    """
    for shape in scene.shapes():
        box = shape.bbox()
        corners = np.array([np.ravel(box.min), np.ravel(box.max)])
        # an empty box has its corners at the float limits
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
