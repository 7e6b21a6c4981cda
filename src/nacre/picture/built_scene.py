"""A built scene: Mitsuba objects of one picture, kept and reused while only material, camera or seed change.

Building a scene anew for each picture grows memory and time (mitsuba3 issue 563), so the scene stays and the
object's BSDF is updated or exchanged.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.device.object_space import ObjectFrame
from nacre.device.variant import use_variant
from nacre.errors import UnsupportedError
from nacre.picture.camera import Framing, View
from nacre.picture.endless import endless_of
from nacre.picture.lights.named import Light
from nacre.picture.scenes.catalogue import SUBJECT, Part, Scene, backdrop_parts, plain_material
from nacre.picture.shapes.ball import bounding_ball
from nacre.picture.shapes.mesh import Mesh, rotation

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
