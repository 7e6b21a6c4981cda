"""Flat things of paper: a banknote with its security foil, and the card that paints are drawn down on.

On both u runs across and v upward, over the whole sheet.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh, merge, parametric

NOTE_WIDTH, NOTE_HEIGHT = 3.5, 1.7
_ABOVE = 0.004  # foil and paint lie so far above the paper
_STRIPE = (0.66, 0.77)  # of the note's width
_SEAL = (0.5, 0.52, 0.092)  # centre u, v and radius over the width

CARD_WIDTH, CARD_HEIGHT = 2.5, 3.0
_COAT = (0.08, 0.92, 0.06, 0.83)  # u and v of what is painted
_BLACK = (0.62, 1.0)  # v of the black half


def _note(u: Array, v: Array, above: float = 0.0) -> Array:
    """A note that was folded in a purse: it rises to the back, with a wave along it."""
    bend = np.radians(4.0 + 50.0 * v)
    start, radius = np.radians(4.0), NOTE_HEIGHT / np.radians(50.0)
    y = radius * (np.sin(bend) - np.sin(start)) - 0.5 * NOTE_HEIGHT
    z = radius * (np.cos(start) - np.cos(bend))
    wave = 0.045 * np.sin(2 * np.pi * (1.1 * u + 0.15 * v)) + 0.05
    normal = np.stack([0 * bend, -np.sin(bend), np.cos(bend)], axis=-1)
    flat = np.stack([(u - 0.5) * NOTE_WIDTH, y, z], axis=-1)
    return np.asarray(flat + normal * (wave + above)[..., None])


def _patch(sheet: Callable[[Array, Array, float], Array], u: Callable[[Array, Array], Array],
           v: Callable[[Array, Array], Array], cells: tuple[int, int]) -> Mesh:  # fmt: skip
    """A part of a sheet that lies above it, with the sheet's own uv."""
    part = parametric(lambda a, b: sheet(u(a, b), v(a, b), _ABOVE), *cells)
    a, b = part.uv[:, 0], part.uv[:, 1]
    return Mesh(part.vertices, part.normals, np.stack([u(a, b), v(a, b)], axis=1), part.faces)


def banknote() -> Mesh:
    """The paper."""
    return parametric(_note, 160, 80)


def banknote_foil() -> Mesh:
    """The security stripe and the round seal: what takes the material."""
    low, high = _STRIPE
    stripe = _patch(_note, lambda a, b: low + (high - low) * a, lambda a, b: 0.0 * a + b, (24, 120))
    u, v, radius = _SEAL
    share = NOTE_WIDTH / NOTE_HEIGHT
    seal = _patch(
        _note, lambda a, b: u + radius * b * np.cos(2 * np.pi * a),
        lambda a, b: v + share * radius * b * np.sin(2 * np.pi * a), (96, 32),
    )  # fmt: skip
    return merge([_upward(stripe), _upward(seal)])


def _upward(surface: Mesh) -> Mesh:
    """The same surface with its normals upward."""
    return surface if surface.normals[:, 2].mean() > 0 else surface.turned()


def banknote_print(rows: int = 1024) -> Array:
    """Reflectance `[row, column]` of the printed paper as the eye sees it, first row on top."""
    from nacre.picture.shapes.note_print import note_reflectance

    return note_reflectance(rows, NOTE_WIDTH / NOTE_HEIGHT)


def _card(u: Array, v: Array, above: float = 0.0) -> Array:
    """A card bent over a stand, as paints are shown for their flop: upright in front, flat behind."""
    first, last = np.radians(78.0), np.radians(8.0)
    radius = CARD_HEIGHT / (first - last)
    slope = first + (last - first) * v
    y = radius * (np.sin(first) - np.sin(slope))
    z = radius * (np.cos(slope) - np.cos(first))
    normal = np.stack([0 * slope, -np.sin(slope), np.cos(slope)], axis=-1)
    return np.asarray(np.stack([(u - 0.5) * CARD_WIDTH, y - 1.0, z], axis=-1) + above * normal)


def card_coat() -> Mesh:
    """The paint that was drawn down: what takes the material."""
    left, right, low, high = _COAT
    return _upward(
        _patch(_card, lambda a, b: left + (right - left) * a, lambda a, b: low + (high - low) * b, (16, 200))
    )


def card_paper(is_black: bool) -> Mesh:
    """The card's white part, or its black one."""
    low, high = _BLACK if is_black else (0.0, _BLACK[0])
    return _upward(parametric(lambda u, v: _card(u, low + (high - low) * v), 8, 100))


def card_print(is_black: bool, rows: int = 600) -> Array:
    """Reflectance `[row, column]` of the card's white or black part, first row on top: what is printed at its edge."""
    from PIL import Image, ImageDraw, ImageFont

    height = _BLACK[1] - _BLACK[0] if is_black else _BLACK[0]
    columns = int(rows * CARD_WIDTH / (CARD_HEIGHT * height))
    scale = columns / CARD_WIDTH
    image = Image.new("L", (columns, rows), 0)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(0.085 * scale)
    if is_black:
        draw.text((0.2 * scale, 0.2 * scale), "OPACITY CHART   FORM 2A", fill=255, font=font)
    else:
        draw.text((0.2 * scale, rows - 0.135 * scale), "No.  550      film 40 um      drawn", fill=255, font=font)
    ink = np.asarray(image, dtype=float) / 255.0
    return np.asarray(0.012 + 0.5 * ink if is_black else 0.74 * (1.0 - 0.9 * ink))


__all__ = ["banknote", "banknote_foil", "banknote_print", "card_coat", "card_paper", "card_print"]
