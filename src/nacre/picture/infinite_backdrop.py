"""Backdrops without an end: what the camera alone would see beyond their edges.

A larger backdrop would stand before the lamps and change the picture. So it stays, and a camera ray that misses the
scene is led to where it would have met a backdrop that goes on for ever, folded back into the one that is there.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from nacre.device.variant import use_variant
from nacre.picture.scenes.catalogue import BOWL, BOWL_SQUARE, SQUARE, SWEEPS, Backdrop
from nacre.picture.shapes.backdrop import sweep_length

START = 0.05  # before the surface, which is matt, a led ray begins: nothing else stands in its way
RIM = 0.02  # the outermost that is led to
FAR = 1e4  # how far a ray goes that never comes down
HALVINGS = 40


@dataclass(frozen=True)
class Endless:
    """A backdrop that goes on for ever.

    Attributes:
        kind: as of its scene.
        square: side of its chequers, 0 without any: they go on evenly.
        turn_deg: about the vertical axis.
    """

    kind: Backdrop
    square: float = 0.0
    turn_deg: float = 0.0


def endless_of(kind: Backdrop, is_chequered: bool, turn_deg: float) -> Endless | None:
    """What goes on beyond a backdrop; None where there is none."""
    if kind == "none":
        return None
    if kind == "bowl":
        return Endless(kind, BOWL_SQUARE, turn_deg)
    return Endless(kind, SQUARE if is_chequered and kind == "sweep" else 0.0, turn_deg)


def without_edges(integrator: Any, backdrop: Endless) -> Any:
    """Return an integrator that sees as `integrator` does, and the backdrop where that sees past its edge."""
    mi = use_variant()
    return _class(mi.variant())(mi.Properties(), integrator, backdrop)


def fold(value: Any, low: Any, high: Any, width: Any) -> Any:
    """Reflect what lies outside [low, high] to and fro in the outermost `width` of it."""
    import drjit as dr

    beyond = dr.maximum(dr.maximum(value - high, low - value), 0.0)
    period = beyond - 2.0 * width * dr.floor(beyond / (2.0 * width))
    inward = width - dr.abs(period - width)
    return dr.select(value > high, high - inward, dr.select(value < low, low + inward, value))


def _ends(length: float, square: float) -> tuple[float, float, float]:
    """Where to fold a side of a length: in the middle of squares, so that they go on evenly; and by how much."""
    if square == 0.0:
        return RIM, length - RIM, 1.0
    return 0.5 * square, (int((length - RIM) / square - 0.5) + 0.5) * square, 2.0 * square


@functools.cache
def _class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()

    class WithoutEdges(mi.SamplingIntegrator):
        """An integrator whose camera rays never miss the backdrop."""

        def __init__(self, properties: Any, inner: Any, backdrop: Endless) -> None:
            super().__init__(properties)
            self.inner, self.backdrop = inner, backdrop
            turn = mi.ScalarTransform4f().rotate([0, 0, 1], backdrop.turn_deg)
            self.turn, self.back = mi.Transform4f(turn.matrix), mi.Transform4f(turn.inverse().matrix)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            missed = (scene.ray_intersect_preliminary(ray, True, active).is_valid() ^ True) & active
            meet = _on_bowl if self.backdrop.kind == "bowl" else _on_sweep
            place, normal = meet(self.backdrop, self.back @ ray.o, self.back @ ray.d)
            place, normal = self.turn @ place, self.turn @ dr.normalize(normal)
            led = mi.RayDifferential3f(ray)
            led.o = dr.select(missed, place + START * normal, ray.o)
            led.d = dr.select(missed, -normal, ray.d)
            return self.inner.sample(scene, sampler, led, medium, active)

        def aov_names(self) -> list[str]:
            return list(self.inner.aov_names())

    def _on_sweep(backdrop: Endless, o: Any, d: Any) -> Any:
        """Where a ray meets an endless floor, cove and wall, folded into those of `sweep`, and the normal there."""
        half_width, front, back, radius, _ = SWEEPS[backdrop.kind]
        flat, bent = front + back, 0.5 * dr.pi * radius
        t_floor = dr.select(d.z < 0.0, -o.z / dr.minimum(d.z, -1e-9), FAR)
        is_floor = (d.z < 0.0) & (o.y + t_floor * d.y <= back)
        # the cove: a quarter of a cylinder along x
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
        across = fold(across, *_ends(2.0 * half_width, backdrop.square)) - half_width
        along = fold(along, *_ends(sweep_length(*(SWEEPS[backdrop.kind])), backdrop.square))
        angle = dr.clip((along - flat) / radius, 0.0, 0.5 * dr.pi)
        up = radius * (1.0 - dr.cos(angle)) + dr.maximum(along - flat - bent, 0.0)
        place = mi.Point3f(across, dr.minimum(along, flat) - front + radius * dr.sin(angle), up)
        return place, mi.Vector3f(0.0, -dr.sin(angle), dr.cos(angle))

    def _on_bowl(backdrop: Endless, o: Any, d: Any) -> Any:
        """Where a ray meets an endless bowl, folded into that of `bowl`, and a normal there."""
        flat, reach, rise = BOWL

        def height(x: Any, y: Any) -> Any:
            return rise * dr.square(dr.maximum(dr.sqrt(x * x + y * y) - flat, 0.0) / (reach - flat))

        near, far = mi.Float(0.0), mi.Float(FAR)
        for _ in range(HALVINGS):  # a line comes down on a bowl once
            t = 0.5 * (near + far)
            is_above = o.z + t * d.z > height(o.x + t * d.x, o.y + t * d.y)
            near, far = dr.select(is_above, t, near), dr.select(is_above, far, t)
        low, high, width = _ends(reach, backdrop.square)
        x, y = (fold(o[axis] + near * d[axis], -high, high, width) for axis in (0, 1))
        r = dr.maximum(dr.sqrt(x * x + y * y), 1e-6)
        slope = 2.0 * rise * dr.maximum(r - flat, 0.0) / (reach - flat) ** 2 / r
        return mi.Point3f(x, y, height(x, y)), mi.Vector3f(-slope * x, -slope * y, 1.0)

    return WithoutEdges
