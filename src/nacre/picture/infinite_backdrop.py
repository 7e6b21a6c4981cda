"""Infinite backdrops: camera rays that miss the scene see the backdrop continued beyond its edges.

A larger mesh would stand before lamps and change the light. Instead, a missed ray's intersection with an
infinite backdrop is folded back into the finite one.
"""

from dataclasses import dataclass
from typing import Any

from nacre.picture.plugin import WrappedIntegrator, dr, make_plugin, mi
from nacre.picture.scenes.catalogue import BOWL, BOWL_SQUARE, SQUARE, SWEEPS, Backdrop
from nacre.picture.shapes.backdrop import sweep_length

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
