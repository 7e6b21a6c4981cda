"""A plastic card as passes and bank cards are, with a domed seal of foil; it leans on a block.

u runs to the right and v upward over the seal.
"""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array
from nacre.picture.shapes.mesh import Mesh, merge, parametric, rotation

WIDTH, HEIGHT = 3.4, 2.14
_THICK, _CORNER = 0.035, 16.0  # power of the outline: how square its corners are
_SEAL, _RADIUS, _BULGE = (0.86, 0.02), 0.66, 0.075
_CHIP, _CHIP_SIZE = (-1.1, 0.2), (0.26, 0.2)
# so leant back and turned, the dome mirrors the lamp of a beam to the camera and the flat card does not
_LEAN_DEG, _TURN_DEG, _FOOT = 33.0, -12.0, 0.02


def _placed(surface: Mesh) -> Mesh:
    leant = surface.moved(rotation("x", _LEAN_DEG))
    low = 0.5 * HEIGHT * np.sin(np.radians(_LEAN_DEG)) + _FOOT
    return leant.moved(rotation("z", _TURN_DEG), (0.0, 0.0, low))


def _sheet(half: tuple[float, float], power: float, cells: tuple[int, int]) -> Mesh:
    """A rectangle with round corners about the origin in x and y, facing up; uv over it."""

    def position(u: Array, v: Array) -> Array:
        c, s = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
        reach = (np.abs(c / half[0]) ** power + np.abs(s / half[1]) ** power) ** (-1 / power)
        return np.stack([v * reach * c, v * reach * s, 0 * u], axis=-1)

    flat = parametric(position, *cells)
    uv = 0.5 + 0.5 * flat.vertices[:, :2] / np.asarray(half)
    up = np.tile([0.0, 0.0, 1.0], (len(flat.vertices), 1))
    return Mesh(flat.vertices, up, uv, flat.faces if flat.normals[:, 2].mean() > 0 else flat.faces[:, ::-1])


def card_face() -> Mesh:
    """The printed face."""
    return _placed(_sheet((0.5 * WIDTH, 0.5 * HEIGHT), _CORNER, (360, 12)))


def card_rim() -> Mesh:
    """The card's edge and its back."""
    half = (0.5 * WIDTH, 0.5 * HEIGHT)

    def position(u: Array, v: Array) -> Array:
        c, s = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
        reach = (np.abs(c / half[0]) ** _CORNER + np.abs(s / half[1]) ** _CORNER) ** (-1 / _CORNER)
        return np.stack([reach * c, reach * s, -_THICK * (1 - v)], axis=-1)

    back = _sheet(half, _CORNER, (360, 4)).moved(np.eye(3), (0.0, 0.0, -_THICK)).turned()
    return _placed(merge([parametric(position, 360, 2), back]))


def seal() -> Mesh:
    """The seal: what takes the material."""

    def position(u: Array, v: Array) -> Array:
        radius, phi = _RADIUS * v, 2 * np.pi * u
        return np.stack([radius * np.cos(phi), radius * np.sin(phi), _BULGE * (1 - v * v) + 0.004], axis=-1)

    dome = parametric(position, 192, 64)
    if dome.normals[:, 2].mean() < 0:
        dome = dome.turned()
    uv = 0.5 + 0.5 * dome.vertices[:, :2] / _RADIUS
    return _placed(Mesh(dome.vertices, dome.normals, uv, dome.faces).moved(np.eye(3), (*_SEAL, 0.0)))


def chip() -> Mesh:
    """The contacts, gilt."""
    plates = []
    for column in (-1, 1):
        for row in (-1, 0, 1):
            plate = _sheet((0.47 * _CHIP_SIZE[0], 0.3 * _CHIP_SIZE[1]), 8.0, (64, 4))
            offset = (_CHIP[0] + 0.5 * column * _CHIP_SIZE[0], _CHIP[1] + 0.66 * row * _CHIP_SIZE[1], 0.006)
            plates.append(plate.moved(np.eye(3), offset))
    return _placed(merge(plates))


def block() -> Mesh:
    """The wedge that it leans on, behind it."""
    half, high = 0.75, HEIGHT * np.sin(np.radians(_LEAN_DEG)) * 0.72
    foot = 0.5 * HEIGHT * np.cos(np.radians(_LEAN_DEG))
    slope = np.tan(np.radians(_LEAN_DEG))
    front, back, gap = -foot + 0.3, -foot + high / slope, 0.06
    corners = np.array([
        (-half, front + gap, 0.0), (half, front + gap, 0.0), (half, back + gap, high), (-half, back + gap, high),
        (-half, back + gap + 0.3, 0.0), (half, back + gap + 0.3, 0.0), (half, back + gap + 0.3, high),
        (-half, back + gap + 0.3, high),
    ])  # fmt: skip
    sides = [(0, 1, 2, 3), (3, 2, 6, 7), (5, 4, 7, 6), (0, 3, 7, 4), (1, 5, 6, 2)]
    parts = []
    for side in sides:
        place = corners[list(side)]
        normal = np.cross(place[1] - place[0], place[2] - place[0])
        normal /= np.linalg.norm(normal)
        parts.append(Mesh(place, np.tile(normal, (4, 1)), np.zeros((4, 2)), np.array([[0, 1, 2], [0, 2, 3]])))
    return merge(parts).moved(rotation("z", _TURN_DEG))


def card_print(rows: int = 900) -> tuple[Array, Array]:
    """Return how light the ground is, and the share of white ink, `[row, column]`, first row on top."""
    from PIL import Image, ImageDraw, ImageFont

    columns = int(rows * WIDTH / HEIGHT)
    x, y = np.meshgrid((np.arange(columns) + 0.5) / rows, 1.0 - (np.arange(rows) + 0.5) / rows)
    image = Image.new("L", (columns, rows), 0)
    draw = ImageDraw.Draw(image)
    for text, place, size in (
        ("nacre", (0.115, 0.085), 0.17), ("5500 0400 0700 0550", (0.115, 0.63), 0.072),
        ("VALID THRU 05/50", (0.115, 0.77), 0.05), ("A. OPTICIAN", (0.115, 0.85), 0.066),
    ):  # fmt: skip
        draw.text((place[0] * rows, place[1] * rows), text, fill=255, font=ImageFont.load_default(size * rows))
    waves = 26 * (y + 0.09 * np.sin(3.1 * x + 0.6) + 0.03 * np.sin(7 * x - 4 * y))
    thin = np.clip((0.12 - np.abs(np.mod(waves, 1.0) - 0.5)) * 26, 0.0, 1.0)
    ground = np.clip(0.12 + 0.75 * (0.5 * x + 0.3 * y), 0.0, 1.0)
    return ground, np.maximum(np.asarray(image, dtype=float) / 255.0, 0.13 * thin)


__all__ = ["block", "card_face", "card_print", "card_rim", "chip", "seal"]
