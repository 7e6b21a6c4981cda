"""What is printed on the banknote: guilloches, a nautilus in lines, numbers; the paper with its fibres.

Places are in heights of the note, x to the right and y upward; drawings have their first row on top.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import numpy as np

from nacre.core.arrays import Array
from nacre.picture.filters import noise
from nacre.picture.shapes.mesh import Mesh, merge, parametric, rotation

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


# Flat things of paper: a banknote with its security foil, and the card that paints are drawn down on.

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
    pass

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


# A plastic card as passes and bank cards are, with a domed seal of foil; it leans on a block.

WIDTH, HEIGHT = 3.4, 2.14
_THICK, _CORNER = 0.035, 16.0  # power of the outline: how square its corners are
_SEAL_pass_card, _RADIUS, _BULGE = (0.86, 0.02), 0.66, 0.075
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
    return _placed(Mesh(dome.vertices, dome.normals, uv, dome.faces).moved(np.eye(3), (*_SEAL_pass_card, 0.0)))


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


def card_print_pass_card(rows: int = 900) -> tuple[Array, Array]:
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
