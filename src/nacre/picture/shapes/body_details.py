"""What makes the body a car that could be bought: shut lines, door handles, mirrors, a number plate, wipers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from nacre.picture.shapes.butterfly import tube
from nacre.picture.shapes.implicit import Implicit
from nacre.picture.shapes.mesh import Array, Mesh, bspline, merge, parametric

_GAP = 0.0048  # half width of a shut line
_HALVINGS = 30
Points = Sequence[tuple[float, float]]

# shut lines as (x, z) on the flank; a doubled point bends tighter
_DOOR: Points = [
    (0.70, 0.93), (0.73, 0.82), (0.75, 0.62), (0.72, 0.36), (0.68, 0.27), (0.6, 0.25), (0.2, 0.245), (-0.3, 0.25),
    (-0.52, 0.27), (-0.6, 0.36), (-0.64, 0.55), (-0.66, 0.75), (-0.7, 0.96),
]  # fmt: skip
_FLAP: Points = [(-1.06, 0.80), (-1.06, 0.86), (-1.16, 0.86), (-1.26, 0.86), (-1.26, 0.80), (-1.26, 0.74),
                 (-1.16, 0.74), (-1.06, 0.74), (-1.06, 0.80)]  # fmt: skip
# and as (x, y) from above, on the right half
_BONNET: Points = [(0.98, 0.66), (1.2, 0.685), (1.55, 0.66), (1.85, 0.58), (2.02, 0.44), (2.1, 0.24), (2.12, 0.0)]
_BOOT: Points = [(-1.72, 0.0), (-1.72, 0.3), (-1.73, 0.55), (-1.78, 0.66), (-1.9, 0.71), (-2.08, 0.72)]


def shut_lines(hull: Implicit) -> Mesh:
    """Gaps between doors, bonnet, boot lid and body, as dark threads half sunk into the hull."""
    t = np.linspace(0.0, 1.0, 90)
    lines = []
    for points in (_DOOR, _FLAP):
        x, z = np.moveaxis(bspline(points, t), -1, 0)
        right = _on_flank(hull, x, z)
        lines += [right, right * [1.0, -1.0, 1.0]] if points is _DOOR else [right]
    for points in (_BONNET, _BOOT):
        x, y = np.moveaxis(bspline(points, t), -1, 0)
        right = _on_top(hull, x, y)
        lines += [right, right * [1.0, -1.0, 1.0]]
    return merge([tube(path, np.full(len(path), _GAP), 10) for path in lines])


def mirrors(hull: Implicit) -> Mesh:
    """Housings of the two mirrors with their arms."""
    place = _on_flank(hull, np.array([0.60]), np.array([0.86]))[0]

    def position(u: Array, v: Array) -> Array:
        phi, theta = 2 * np.pi * u, np.pi * (1 - v)
        ball = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        soft = np.sign(ball) * np.abs(ball) ** 0.72
        size = np.array([0.075, 0.12, 0.072])
        back = np.where(soft[..., 0] < 0, 0.45, 1.0)[..., None] * np.array([1.0, 0, 0]) + np.array([0, 1.0, 1.0])
        swept = np.array([-0.25, 0.0, 0.0]) * soft[..., 1:2] * 0.12
        return place + np.array([0.0, 0.15, 0.1]) + size * soft * back + swept

    housing = parametric(position, 72, 48)
    joints = place + np.array([[0.02, -0.03, -0.02], [0.02, 0.05, 0.03], [0.01, 0.12, 0.06]])
    arm = tube(bspline(joints, np.linspace(0, 1, 8)), np.linspace(0.028, 0.02, 8), 16)
    one = merge([housing, arm])
    return merge([one, one.moved(np.diag([1.0, -1.0, 1.0]))])


def handles(hull: Implicit) -> Mesh:
    """A bar to pull on each door."""
    x = np.linspace(-0.3, -0.5, 12)
    path = _on_flank(hull, x, np.full_like(x, 0.775)) + np.array([0.0, 0.016, 0.0])
    ends = np.clip(6 * np.sin(np.pi * np.linspace(0.0, 1.0, 12)), 0.25, 1.0)
    one = tube(path, 0.013 * ends, 16)
    return merge([one, one.moved(np.diag([1.0, -1.0, 1.0]))])


def plate(hull: Implicit) -> Mesh:
    """The number plate in front, bowed as the nose is; u to the right as one reads it, v upward."""

    def position(u: Array, v: Array) -> Array:
        y, z = 0.25 * (2 * u - 1), 0.42 + 0.055 * (2 * v - 1)
        return np.stack([2.268 - 0.12 * y**2 + 0.02 * (2 * v - 1) * 0, y, z], axis=-1)

    return parametric(position, 12, 2)


def plate_print(rows: int = 128) -> Array:
    """Reflectance `[row, column]` of the plate, first row on top."""
    from PIL import Image, ImageDraw, ImageFont

    columns = int(rows * 0.25 / 0.055)
    image = Image.new("L", (columns, rows), 255)
    draw = ImageDraw.Draw(image)
    draw.rectangle((3, 3, columns - 4, rows - 4), outline=0, width=3)
    font = ImageFont.load_default(0.8 * rows)
    width = draw.textlength("NACRE 550", font=font)
    draw.text((0.5 * (columns - width), 0.06 * rows), "NACRE 550", fill=0, font=font)
    return np.asarray(0.03 + 0.62 * np.asarray(image, dtype=float) / 255.0)


def _on_flank(hull: Implicit, x: Array, z: Array) -> Array:
    """Points `[N, 3]` of the left flank (y > 0) at these places of the side view."""
    y = _root(lambda y: hull(x, y, z), np.full_like(x, 0.25), np.full_like(x, 1.2))
    return np.stack([x, y, z], axis=-1)


def _on_top(hull: Implicit, x: Array, y: Array) -> Array:
    z = _root(lambda z: hull(x, y, z), np.full_like(x, 0.45), np.full_like(x, 1.6))
    return np.stack([x, y, z], axis=-1)


def _root(f: Callable[[Array], Array], inside: Array, outside: Array) -> Array:
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        is_out = f(middle) > 0
        inside, outside = np.where(is_out, inside, middle), np.where(is_out, middle, outside)
    return np.asarray(0.5 * (inside + outside))


__all__ = ["handles", "mirrors", "plate", "plate_print", "shut_lines"]
