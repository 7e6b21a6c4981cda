"""A camera's lens, its front up: two elements of coated glass in a black barrel with a grip, a name ring and blades.

u runs to the right and v upward over each element as the camera sees it.
"""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh, merge, parametric, revolve

_TOP = 1.72  # of the barrel
_OUTER, _INNER = 1.02, 0.80  # radii of the barrel and of its mouth
_BLADES = 7


def _element(radius: float, low: float, front: float, back: float) -> Mesh:
    """A lens about the z axis, its rim at height `low`: sagittas of its faces, upward."""
    edge = 0.05

    def face(sag: float, height: float, is_front: bool) -> Mesh:
        def position(u: Array, v: Array) -> Array:
            r, phi = radius * v, 2 * np.pi * u
            return np.stack([r * np.cos(phi), r * np.sin(phi), height + sag * (1 - v * v)], axis=-1)

        made = parametric(position, 160, 48)
        return made if (made.normals[:, 2].mean() > 0) == is_front else made.turned()

    def rim(u: Array, v: Array) -> Array:
        phi = 2 * np.pi * u
        return np.stack([radius * np.cos(phi), radius * np.sin(phi), low + edge * (v - 1)], axis=-1)

    whole = merge([face(front, low, True), face(back, low - edge, False), parametric(rim, 160, 2)])
    uv = 0.5 + 0.5 * whole.vertices[:, :2] / radius
    return Mesh(whole.vertices, whole.normals, uv, whole.faces)


def elements() -> Mesh:
    """The glass: what takes the material."""
    return merge([_element(0.79, 1.52, 0.30, 0.06), _element(0.62, 1.16, 0.10, -0.14), _element(0.5, 0.55, 0.16, -0.1)])


def barrel() -> Mesh:
    """The outside with its grip, and the mouth down to the blades."""
    outside = revolve(
        [(0.0, 0.0), (0.86, 0.0), (0.92, 0.0), (0.94, 0.02), (0.94, 0.3), (0.95, 0.34), (1.06, 0.38), (1.06, 0.4),
         (1.06, 0.7), (1.06, 1.0), (1.06, 1.02), (1.0, 1.06), (1.0, 1.1), (1.0, 1.5), (1.02, 1.56), (1.02, 1.66),
         (_OUTER, _TOP), (_OUTER, _TOP), (0.985, _TOP + 0.01), (0.94, _TOP), (0.93, _TOP - 0.03)], 256, 320,
    )  # fmt: skip
    inside = revolve([(0.5, 0.6), (0.52, 0.62), (0.6, 0.8), (0.66, 1.1), (0.74, 1.25), (0.78, 1.4), (0.8, 1.5),
                      (0.81, 1.54)], 192, 160).turned()  # fmt: skip
    ribs = []
    for number in range(60):
        angle = 2 * np.pi * number / 60
        rib = revolve([(0.026, 0.0), (0.026, 0.1), (0.026, 0.5), (0.026, 0.56), (0.0, 0.58)], 12, 12)
        ribs.append(rib.moved(np.eye(3), (1.06 * np.cos(angle), 1.06 * np.sin(angle), 0.41)))
    floor = revolve([(0.0, 0.3), (0.3, 0.3), (0.55, 0.3), (0.56, 0.35)], 64, 24)
    return merge([outside, inside, floor, *ribs])


def name_ring() -> Mesh:
    """The ring round the front element, sloping inward; u to the right and v upward over it."""

    def position(u: Array, v: Array) -> Array:
        r, phi = 0.81 + 0.125 * v, 2 * np.pi * u
        return np.stack([r * np.cos(phi), r * np.sin(phi), 1.55 + 0.14 * v], axis=-1)

    ring = parametric(position, 192, 8)
    ring = ring if ring.normals[:, 2].mean() > 0 else ring.turned()
    return Mesh(ring.vertices, ring.normals, 0.5 + 0.5 * ring.vertices[:, :2] / 0.94, ring.faces)


def ring_print(rows: int = 1200) -> Array:
    """Reflectance `[row, column]` of the name ring, first row on top: words along the circle."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("L", (rows, rows), 0)
    size = int(0.052 * rows)
    font = ImageFont.load_default(size)
    words, radius = "NACRE OPTICS   NACRINON  1:1.4 / 50 mm   \u00d8 55     ", 0.5 * rows * 0.871 / 0.94
    letters = words + words
    step = 2 * np.pi / len(letters)
    for number, letter in enumerate(letters):
        stamp = Image.new("L", (2 * size, 2 * size), 0)
        draw = ImageDraw.Draw(stamp)
        draw.text((size - 0.5 * draw.textlength(letter, font=font), 0.45 * size), letter, fill=255, font=font)
        angle = number * step + np.pi  # clockwise from below
        turned = stamp.rotate(-np.degrees(angle), resample=Image.Resampling.BICUBIC)
        x, y = 0.5 * rows + radius * np.sin(angle), 0.5 * rows - radius * np.cos(angle)
        box = (int(x) - size, int(y) - size)
        image.paste(255, (*box, box[0] + 2 * size, box[1] + 2 * size), turned)
    return np.asarray(0.012 + 0.6 * np.asarray(image, dtype=float) / 255.0)


def blades() -> Mesh:
    """The iris, stopped down: a dark disc with an opening of seven sides."""

    def position(u: Array, v: Array) -> Array:
        phi = 2 * np.pi * u
        side = 2 * np.pi / _BLADES
        inner = 0.24 / np.cos(np.mod(phi, side) - 0.5 * side)
        r = inner + (0.56 - inner) * v
        return np.stack([r * np.cos(phi), r * np.sin(phi), 0.74 + 0.02 * np.mod(phi, side) / side * v], axis=-1)

    disc = parametric(position, 280, 6)
    return disc if disc.normals[:, 2].mean() > 0 else disc.turned()


__all__ = ["barrel", "blades", "elements", "name_ring", "ring_print"]
