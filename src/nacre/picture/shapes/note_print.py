"""What is printed on the banknote: guilloches, a nautilus in lines, numbers; the paper with its fibres.

Places are in heights of the note, x to the right and y upward; drawings have their first row on top.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from nacre.arrays import Array
from nacre.picture.seamless import noise

_SHELL, _SHELL_SIZE = (0.42, 0.47), 0.35  # the nautilus: centre of its spiral and how far it reaches
_GROWTH = 0.178  # of the spiral, ln(radius) a radian
_ROSETTES = ((0.47, 0.5, 0.47, 11), (1.8, 0.5, 0.2, 7))  # centre, size, lobes
_FIBRES, _SEED = 70, 5
# how much light the paper and each ink give back to the eye, for what knows no colours
PAPER, INKS = 0.74, {"teal": 0.30, "ochre": 0.42, "violet": 0.13, "blue": 0.08, "red": 0.15}


def _lines(field: Array, share: float | Array, sharpness: float = 30.0) -> Array:
    """1 on lines where a field is a whole number, which take this share of the area."""
    return np.asarray(np.clip((share - 2 * np.abs(np.mod(field + 0.5, 1.0) - 0.5)) * 0.5 * sharpness, 0.0, 1.0))


def _nautilus(x: Array, y: Array, pixel: float) -> Array:
    """A shell that is cut open, drawn in lines as steel engravers do."""
    dx, dy = x - _SHELL[0], y - _SHELL[1]
    radius, turn = np.hypot(dx, dy) / _SHELL_SIZE, np.arctan2(dy, dx)
    with np.errstate(divide="ignore"):
        # how far round the spiral whose outermost end lies at angle 0.6 the whorl at a place has come, radians below it
        behind = np.mod(0.6 - turn, 2 * np.pi)
        whorls = (-_GROWTH * behind - np.log(np.maximum(radius, 1e-6))) / (2 * np.pi * _GROWTH)
    inside = (whorls > 0.0) & (whorls < 5.0)
    across = np.mod(whorls, 1.0)  # 0 at a whorl's outer wall
    along = behind + 2 * np.pi * np.floor(whorls)
    scale = np.exp(-_GROWTH * along)  # of this whorl to the outermost
    thin = np.asarray(np.clip(scale * 6, 0.15, 1.0), dtype=float)
    wall = np.clip((0.028 + 1.5 * pixel / (scale * _SHELL_SIZE) - np.minimum(across, 1 - across)) * 40, 0.0, 1.0)
    # chambers behind the living one: bowed walls
    bow = along - 0.9 * np.sin(np.pi * across)
    septum = _lines(bow / 0.42, 0.1) * (along > 2.3)
    shade = 0.16 + 0.5 * np.mod(bow / 0.42, 1.0) * (along > 2.3) + 0.4 * across * (along <= 2.3)
    hatch = _lines(across * 24 * np.sqrt(thin), 0.9 * shade, 12.0)
    stripes = 0.5 * _lines(along / 0.21 + 0.35 * np.sin(4 * across), np.where(across < 0.5, 0.5, 0.0)) * (along < 2.3)
    drawn = np.maximum(np.maximum(wall, septum), np.maximum(hatch * 0.85, stripes))
    return np.asarray(np.where(inside, drawn, 0.0))


def _words(rows: int, columns: int, texts: tuple[tuple[str, tuple[float, float], float], ...]) -> Array:
    """Mask of texts, each at a place (x, y from the top) and in a size in heights of the note."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("L", (columns, rows), 0)
    draw = ImageDraw.Draw(image)
    for text, place, size in texts:
        font = ImageFont.load_default(size * rows)
        draw.text((place[0] * rows, place[1] * rows), text, fill=255, font=font)
    return np.asarray(image, dtype=float) / 255.0


@functools.cache
def note_drawing(rows: int, ratio: float) -> tuple[Array, Mapping[str, Array]]:
    """Return how light the paper is, about 1, and the share of each ink, `[row, column]`.

    Args:
        rows: of the drawing.
        ratio: width of the note over its height.
    """
    columns = int(rows * ratio)
    x, y = np.meshgrid((np.arange(columns) + 0.5) / rows, 1.0 - (np.arange(rows) + 0.5) / rows)
    frame = np.minimum(np.minimum(x, ratio - x), np.minimum(y, 1.0 - y))
    printed = np.clip((frame - 0.045) * 100.0, 0.0, 1.0)
    across = np.clip(x / ratio, 0.0, 1.0)
    first = _lines(44 * (y + 0.05 * np.sin(5 * x) + 0.02 * np.sin(13 * x + 6 * y)), 0.3)
    second = _lines(44 * (y + 0.05 * np.sin(5 * x + 2.1) + 0.02 * np.sin(11 * x - 5 * y)), 0.26)
    # the inks of the background run into each other from left to right
    teal, ochre = 0.75 * first * printed, 0.7 * second * printed
    wash = np.exp(-(((x - 0.5) / 0.55) ** 2) - ((y - 0.5) / 0.4) ** 2)
    rose = np.zeros_like(x)
    for cx, cy, size, lobes in _ROSETTES:
        r, phi = np.hypot(x - cx, y - cy) / size, np.arctan2(y - cy, x - cx)
        inside = np.clip((1.0 + 0.06 * np.cos(lobes * phi) - r) * 150.0, 0.0, 1.0)
        turns = [_lines(11 * r * (1.0 + 0.1 * np.cos(lobes * phi + turn)), 0.14, 60.0) for turn in (0.0, 2.1, 4.2)]
        rose = np.maximum(rose, 0.6 * inside * np.clip(sum(turns), 0.0, 1.0))
    teal, ochre = teal * (0.35 + 0.65 * across) + 0.14 * wash, ochre * (1.0 - 0.5 * across)
    big = _words(rows, columns, (("550", (1.6, 0.385), 0.21),))
    small = _words(rows, columns, (
        ("550", (0.07, 0.065), 0.1), ("550", (1.82, 0.83), 0.1), ("NANOMETRES", (0.905, 0.79), 0.062),
        ("FIVE HUNDRED AND FIFTY", (0.905, 0.855), 0.036), ("BANK OF NACRE", (0.83, 0.07), 0.058),
    ))  # fmt: skip
    serial = _words(rows, columns, (("NA 2405 550 7", (0.075, 0.88), 0.055),))
    shell = _nautilus(x, y, 1.0 / rows)
    rim = np.clip((0.003 - np.abs(frame - 0.045)) * 800, 0.0, 1.0)
    free = 1.0 - 0.85 * np.clip(shell * 4, 0.0, 1.0)
    inks = {
        "ochre": ochre * free,
        "teal": np.clip(teal, 0.0, 1.0) * free,
        "violet": np.clip(np.maximum(rose * free, 0.95 * np.maximum(big, small)), 0.0, 1.0),
        "blue": np.clip(np.maximum(shell * 0.95, rim), 0.0, 1.0),
        "red": np.maximum(0.9 * serial, _fibres(rows, columns)),
    }
    pulp = 0.55 * noise(x.shape, (1.2, 1.2), _SEED) + 0.8 * noise(x.shape, (9.0, 9.0), _SEED + 1)
    return 1.0 + 0.016 * pulp, inks


def _fibres(rows: int, columns: int) -> Array:
    """Fine coloured threads strewn into the paper."""
    from PIL import Image, ImageDraw

    rng = np.random.default_rng(_SEED)
    image = Image.new("L", (2 * columns, 2 * rows), 0)
    draw = ImageDraw.Draw(image)
    for _ in range(_FIBRES):
        start = rng.uniform((0, 0), (2 * columns, 2 * rows))
        angle, bend = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5)
        steps = angle + bend * np.linspace(0, 1, 8)
        path = start + 0.012 * rows * np.cumsum(np.stack([np.cos(steps), np.sin(steps)], axis=1), axis=0) / 4
        draw.line([tuple(p) for p in path], fill=190, width=max(1, rows // 500))
    return np.asarray(image.resize((columns, rows), Image.Resampling.BOX), dtype=float) / 255.0


def note_reflectance(rows: int, ratio: float) -> Array:
    """Reflectance `[row, column]` as the eye sees it."""
    light, inks = note_drawing(rows, ratio)
    seen = PAPER * light
    for name, share in inks.items():
        seen = seen * (1.0 - share) + INKS[name] * share
    return np.asarray(seen)
