"""What a museum gives an insect: a pin and a label with where it was found and a bar of ten millimetres."""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.backdrop import tile
from nacre.picture.shapes.mesh import Array, Mesh, merge, revolve

LABEL_WIDTH, LABEL_HEIGHT = 1.5, 0.66
_LABEL_ROWS = 660


def pin(x: float, y: float, height: float) -> Mesh:
    """An insect pin upright on the floor, its head a small ball."""
    radius, head = 0.011, 0.036
    shaft = [(radius, z) for z in np.linspace(0.0, height, 8)]
    ball = [(head * np.sin(a), height + head * (1 - np.cos(a))) for a in np.linspace(0.35, np.pi, 16)]
    return revolve([*shaft, *ball], 32, 120).moved(np.eye(3), (x, y, 0.0))


def label(x: float, y: float) -> Mesh:
    """A label flat on the floor, its middle there; a little thick."""
    sheet = tile(LABEL_WIDTH, LABEL_HEIGHT)
    edge = 0.012
    skirt = merge([_side(a, b, edge) for a, b in _around(0.5 * LABEL_WIDTH, 0.5 * LABEL_HEIGHT)])
    return merge([sheet.moved(np.eye(3), (x, y, edge)), skirt.moved(np.eye(3), (x, y, 0.0))])


def _around(x: float, y: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    return [(corners[i], corners[(i + 1) % 4]) for i in range(4)]


def _side(a: tuple[float, float], b: tuple[float, float], height: float) -> Mesh:
    vertices = np.array([(*a, 0.0), (*b, 0.0), (*b, height), (*a, height)])
    along = vertices[1] - vertices[0]
    normal = np.array([along[1], -along[0], 0.0]) / np.linalg.norm(along)
    return Mesh(vertices, np.tile(normal, (4, 1)), np.zeros((4, 2)), np.array([[0, 1, 2], [0, 2, 3]]))


def label_print(lines: tuple[str, ...], bar: float) -> Array:
    """Reflectance `[row, column]` of the label, first row on top: lines of text and a bar so long, in scene units."""
    from PIL import Image, ImageDraw, ImageFont

    scale = _LABEL_ROWS / LABEL_HEIGHT
    columns = int(LABEL_WIDTH * scale)
    image = Image.new("L", (columns, _LABEL_ROWS), 0)
    draw = ImageDraw.Draw(image)
    for number, line in enumerate(lines):
        size = 96 if number == 0 else 78
        draw.text((70, 44 + 112 * number), line, fill=255, font=ImageFont.load_default(size))
    left, low = 70, _LABEL_ROWS - 84
    right = left + int(bar * scale)
    draw.rectangle((left, low, right, low + 12), fill=255)
    for end in (left, right):
        draw.rectangle((end - 5, low - 22, end + 5, low + 34), fill=255)
    draw.text((right + 40, low - 44), "10 mm", fill=255, font=ImageFont.load_default(78))
    ink = np.asarray(image, dtype=float) / 255.0
    return np.asarray(0.7 * (1.0 - 0.93 * ink))


__all__ = ["LABEL_HEIGHT", "LABEL_WIDTH", "label", "label_print", "pin"]
