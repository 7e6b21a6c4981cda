"""Printed things: a banknote with security foil, a drawdown card for paints, a plastic card with a foil seal.

On all sheets u runs across and v upward. Drawings have their first row at the top.
"""

import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from nacre.core.arrays import Array
from nacre.picture.mesh import Mesh, merge, on_circle, parametric, quad, rotation
from nacre.picture.plugins import noise

# banknote: drawing (in heights of the note), then geometry
_SHELL, _SHELL_SIZE = (0.42, 0.47), 0.35  # centre and radius of the nautilus
_GROWTH = 0.178  # d ln(radius) / d angle of its spiral
_ROSETTES = ((0.47, 0.5, 0.47, 11), (1.8, 0.5, 0.2, 7))  # centre, size, lobes
_FIBRES, _SEED = 70, 5
PAPER, INKS = 0.74, {"teal": 0.30, "ochre": 0.42, "violet": 0.13, "blue": 0.08, "red": 0.15}  # luminous reflectance
NOTE_WIDTH, NOTE_HEIGHT, _NOTE_SLOPE_DEG = 3.5, 1.7, (4.0, 54.0)
_GAP = 0.004  # distance of foil and paint from the paper
_STRIPE = (0.66, 0.77)  # u
_NOTE_SEAL = (0.5, 0.52, 0.092)  # centre u, v and radius in u

CARD_WIDTH, CARD_HEIGHT, _CARD_SLOPE_DEG = 2.5, 3.0, (78.0, 8.0)
_COAT = (0.08, 0.92, 0.06, 0.83)  # u and v of the paint
_BLACK = 0.62  # v at the lower edge of the black half

PASS_WIDTH, PASS_HEIGHT = 3.4, 2.14
_THICKNESS, _CORNER = 0.035, 16.0  # _CORNER: superellipse power of the outline
_SEAL, _SEAL_RADIUS, _BULGE = (0.86, 0.02), 0.66, 0.075
_CHIP, _CHIP_SIZE = (-1.1, 0.2), (0.26, 0.2)
# pose in which the dome mirrors the lamp of a beam to the camera and the flat card does not
_LEAN_DEG, _TURN_DEG, _FOOT = 33.0, -12.0, 0.02


def text_mask(
    shape: tuple[int, int],
    texts: Sequence[tuple[str, tuple[float | None, float], float]],
    boxes: Sequence[tuple[tuple[float, float, float, float], int]] = (),
    paper: int = 0,
) -> Array:
    """Draw texts and boxes; 1 is ink on paper 0, and the reverse on paper 255.

    Args:
        shape: rows and columns of the result.
        texts: text, place (x, y) in pixels from the upper left corner (x None: centred), size in pixels.
        boxes: rectangle (left, top, right, bottom) and width of its outline; width 0: filled.
        paper: grey level of the paper, 0 or 255.
    """
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("L", shape[::-1], paper)
    draw = ImageDraw.Draw(image)
    for box, width in boxes:
        draw.rectangle(box, outline=255 - paper, fill=None if width else 255 - paper, width=max(width, 1))
    for text, (x, y), size in texts:
        font = ImageFont.load_default(size)
        x_left = 0.5 * (shape[1] - draw.textlength(text, font=font)) if x is None else x
        draw.text((x_left, y), text, fill=255 - paper, font=font)
    return np.asarray(np.asarray(image, dtype=float) / 255.0)


def pixel_grid(rows: int, columns: int) -> tuple[Array, Array]:
    """Pixel centres x (to the right) and y (upward) `[row, column]`, in units of the height."""
    x, y = np.meshgrid((np.arange(columns) + 0.5) / rows, 1.0 - (np.arange(rows) + 0.5) / rows)
    return x, y


def _lines(field: Array, share: float | Array, sharpness: float = 30.0) -> Array:
    """1 on lines at integer values of a field; the lines cover this share of the area."""
    return np.asarray(np.clip((share - 2 * np.abs(np.mod(field + 0.5, 1.0) - 0.5)) * 0.5 * sharpness, 0.0, 1.0))


def _nautilus(x: Array, y: Array, pixel: float) -> Array:
    """Section of a nautilus shell in engraving lines."""
    dx, dy = x - _SHELL[0], y - _SHELL[1]
    radius, turn = np.hypot(dx, dy) / _SHELL_SIZE, np.arctan2(dy, dx)
    with np.errstate(divide="ignore"):
        # angle behind the end of the spiral (at 0.6 rad), and the number of whorls
        behind = np.mod(0.6 - turn, 2 * np.pi)
        whorls = (-_GROWTH * behind - np.log(np.maximum(radius, 1e-6))) / (2 * np.pi * _GROWTH)
    inside = (whorls > 0.0) & (whorls < 5.0)
    across = np.mod(whorls, 1.0)  # 0 at the outer wall
    along = behind + 2 * np.pi * np.floor(whorls)
    scale = np.exp(-_GROWTH * along)  # relative to the outermost whorl
    thin = np.asarray(np.clip(scale * 6, 0.15, 1.0), dtype=float)
    wall = np.clip((0.028 + 1.5 * pixel / (scale * _SHELL_SIZE) - np.minimum(across, 1 - across)) * 40, 0.0, 1.0)
    # curved walls between chambers
    bow = along - 0.9 * np.sin(np.pi * across)
    septum = _lines(bow / 0.42, 0.1) * (along > 2.3)
    shade = 0.16 + 0.5 * np.mod(bow / 0.42, 1.0) * (along > 2.3) + 0.4 * across * (along <= 2.3)
    hatch = _lines(across * 24 * np.sqrt(thin), 0.9 * shade, 12.0)
    stripes = 0.5 * _lines(along / 0.21 + 0.35 * np.sin(4 * across), np.where(across < 0.5, 0.5, 0.0)) * (along < 2.3)
    drawn = np.maximum(np.maximum(wall, septum), np.maximum(hatch * 0.85, stripes))
    return np.asarray(np.where(inside, drawn, 0.0))


@functools.cache
def note_drawing(rows: int, ratio: float) -> tuple[Array, Mapping[str, Array]]:
    """Draw the banknote: relative brightness of the paper and coverage of each ink, `[row, column]`.

    Args:
        rows: height of the drawing in pixels.
        ratio: width of the note over its height.
    """
    columns = int(rows * ratio)
    x, y = pixel_grid(rows, columns)
    frame = np.minimum(np.minimum(x, ratio - x), np.minimum(y, 1.0 - y))
    printed = np.clip((frame - 0.045) * 100.0, 0.0, 1.0)
    across = np.clip(x / ratio, 0.0, 1.0)
    first = _lines(44 * (y + 0.05 * np.sin(5 * x) + 0.02 * np.sin(13 * x + 6 * y)), 0.3)
    second = _lines(44 * (y + 0.05 * np.sin(5 * x + 2.1) + 0.02 * np.sin(11 * x - 5 * y)), 0.26)
    wash = np.exp(-(((x - 0.5) / 0.55) ** 2) - ((y - 0.5) / 0.4) ** 2)
    rose = np.zeros_like(x)
    for cx, cy, size, lobes in _ROSETTES:
        r, phi = np.hypot(x - cx, y - cy) / size, np.arctan2(y - cy, x - cx)
        inside = np.clip((1.0 + 0.06 * np.cos(lobes * phi) - r) * 150.0, 0.0, 1.0)
        turns = [_lines(11 * r * (1.0 + 0.1 * np.cos(lobes * phi + turn)), 0.14, 60.0) for turn in (0.0, 2.1, 4.2)]
        rose = np.maximum(rose, 0.6 * inside * np.clip(sum(turns), 0.0, 1.0))
    # the background inks change over from left to right
    teal = 0.75 * first * printed * (0.35 + 0.65 * across) + 0.14 * wash
    ochre = 0.7 * second * printed * (1.0 - 0.5 * across)

    def words(*texts: tuple[str, float, float, float]) -> Array:
        return text_mask((rows, columns), [(text, (x * rows, y * rows), size * rows) for text, x, y, size in texts])

    big = words(("550", 1.6, 0.385, 0.21))
    small = words(
        ("550", 0.07, 0.065, 0.1),
        ("550", 1.82, 0.83, 0.1),
        ("NANOMETRES", 0.905, 0.79, 0.062),
        ("FIVE HUNDRED AND FIFTY", 0.905, 0.855, 0.036),
        ("BANK OF NACRE", 0.83, 0.07, 0.058),
    )
    serial = words(("NA 2405 550 7", 0.075, 0.88, 0.055))
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
    """Fine coloured security fibres."""
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


def banknote_print(rows: int = 1024) -> Array:
    """Luminous reflectance `[row, column]` of the printed paper."""
    light, inks = note_drawing(rows, NOTE_WIDTH / NOTE_HEIGHT)
    luminous = PAPER * light
    for name, share in inks.items():
        luminous = luminous * (1.0 - share) + INKS[name] * share
    return np.asarray(luminous)


def _bent(
    u: Array, v: Array, size: tuple[float, float], slope_deg: tuple[float, float], y: float, above: Array
) -> Array:
    """Points on a sheet bent into an arc, its slope at the lower and the upper edge given, front edge at `y`."""
    first, last = np.radians(slope_deg)
    slope = first + (last - first) * v
    radius = size[1] / (last - first)
    normal = np.stack([0 * slope, -np.sin(slope), np.cos(slope)], axis=-1)
    along, up = radius * (np.sin(slope) - np.sin(first)), radius * (np.cos(first) - np.cos(slope))
    return np.asarray(np.stack([(u - 0.5) * size[0], along + y, up], axis=-1) + normal * above[..., None])


def _note(u: Array, v: Array, above: float = 0.0) -> Array:
    """A note that was folded: it rises to the back, with a wave along it."""
    wave = 0.045 * np.sin(2 * np.pi * (1.1 * u + 0.15 * v)) + 0.05
    return _bent(u, v, (NOTE_WIDTH, NOTE_HEIGHT), _NOTE_SLOPE_DEG, -0.5 * NOTE_HEIGHT, wave + above)


def _card(u: Array, v: Array, above: float = 0.0) -> Array:
    """A card bent over a stand to show the flop of a paint: steep in front, flat behind."""
    return _bent(u, v, (CARD_WIDTH, CARD_HEIGHT), _CARD_SLOPE_DEG, -1.0, np.full_like(u, above))


def _patch(
    sheet: Callable[[Array, Array, float], Array],
    place: Callable[[Array, Array], tuple[Array, Array]],
    cells: tuple[int, int],
) -> Mesh:
    """A layer just above part of a sheet; `place` maps the unit square to the sheet's uv."""
    part = parametric(lambda a, b: sheet(*place(a, b), _GAP), *cells)
    return part.with_uv(np.stack(place(*part.uv.T), axis=1)).facing_up()


def banknote() -> Mesh:
    """The paper."""
    return parametric(_note, 160, 80)


def banknote_foil() -> Mesh:
    """Security stripe and round seal, which get the material."""
    low, high = _STRIPE
    u, v, radius = _NOTE_SEAL
    share = NOTE_WIDTH / NOTE_HEIGHT

    def in_seal(a: Array, b: Array) -> tuple[Array, Array]:
        return u + radius * b * np.cos(2 * np.pi * a), v + share * radius * b * np.sin(2 * np.pi * a)

    stripe = _patch(_note, lambda a, b: (low + (high - low) * a, b), (24, 120))
    return merge([stripe, _patch(_note, in_seal, (96, 32))])


def card_coat() -> Mesh:
    """The coated area of the drawdown card, which gets the material."""
    left, right, low, high = _COAT
    return _patch(_card, lambda a, b: (left + (right - left) * a, low + (high - low) * b), (16, 200))


def card_paper(is_black: bool) -> Mesh:
    """The white or the black part of the card."""
    low, high = (_BLACK, 1.0) if is_black else (0.0, _BLACK)
    return parametric(lambda u, v: _card(u, low + (high - low) * v), 8, 100).facing_up()


def card_print(is_black: bool, rows: int = 600) -> Array:
    """Reflectance `[row, column]` of the white or the black part, with the text at its edge."""
    columns = int(rows * CARD_WIDTH / (CARD_HEIGHT * (1.0 - _BLACK if is_black else _BLACK)))
    scale = columns / CARD_WIDTH
    text, y = ("OPACITY CHART   FORM 2A", 0.2 * scale) if is_black else (
        "No.  550      film 40 um      drawn", rows - 0.135 * scale
    )  # fmt: skip
    ink = text_mask((rows, columns), [(text, (0.2 * scale, y), 0.085 * scale)])
    return np.asarray(0.012 + 0.5 * ink if is_black else 0.74 * (1.0 - 0.9 * ink))


def _placed(surface: Mesh) -> Mesh:
    low = 0.5 * PASS_HEIGHT * np.sin(np.radians(_LEAN_DEG)) + _FOOT
    return surface.moved(rotation("x", _LEAN_DEG)).moved(rotation("z", _TURN_DEG), (0.0, 0.0, low))


def _outline(u: Array, half: tuple[float, float], power: float) -> Array:
    """Radius of a rectangle with round corners in the direction u."""
    c, s = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
    return np.asarray((np.abs(c / half[0]) ** power + np.abs(s / half[1]) ** power) ** (-1 / power))


def _rounded(half: tuple[float, float], power: float, cells: tuple[int, int]) -> Mesh:
    """A flat rectangle with round corners about the origin, facing up, with uv over it."""
    flat = parametric(lambda u, v: on_circle(v * _outline(u, half, power), u, 0 * u), *cells).facing_up()
    up = np.tile([0.0, 0.0, 1.0], (len(flat.vertices), 1))
    return Mesh(flat.vertices, up, 0.5 + 0.5 * flat.vertices[:, :2] / np.asarray(half), flat.faces)


def card_face() -> Mesh:
    """The printed face of the plastic card."""
    return _placed(_rounded((0.5 * PASS_WIDTH, 0.5 * PASS_HEIGHT), _CORNER, (360, 12)))


def card_rim() -> Mesh:
    """Edge and back of the plastic card."""
    half = (0.5 * PASS_WIDTH, 0.5 * PASS_HEIGHT)
    rim = parametric(lambda u, v: on_circle(_outline(u, half, _CORNER), u, -_THICKNESS * (1 - v)), 360, 2)
    back = _rounded(half, _CORNER, (360, 4)).shifted(0.0, 0.0, -_THICKNESS).turned()
    return _placed(merge([rim, back]))


def seal() -> Mesh:
    """Domed seal on the plastic card, which gets the material."""
    dome = parametric(lambda u, v: on_circle(_SEAL_RADIUS * v, u, _BULGE * (1 - v * v) + 0.004), 192, 64).facing_up()
    uv = 0.5 + 0.5 * dome.vertices[:, :2] / _SEAL_RADIUS
    return _placed(dome.with_uv(uv).shifted(*_SEAL, 0.0))


def chip() -> Mesh:
    """The gilt contacts."""
    plate = _rounded((0.47 * _CHIP_SIZE[0], 0.3 * _CHIP_SIZE[1]), 8.0, (64, 4))
    places = [
        (_CHIP[0] + 0.5 * column * _CHIP_SIZE[0], _CHIP[1] + 0.66 * row * _CHIP_SIZE[1], 0.006)
        for column in (-1, 1)
        for row in (-1, 0, 1)
    ]
    return _placed(merge([plate.shifted(*place) for place in places]))


def block() -> Mesh:
    """The wedge that supports the plastic card."""
    half, high = 0.75, PASS_HEIGHT * np.sin(np.radians(_LEAN_DEG)) * 0.72
    foot = 0.5 * PASS_HEIGHT * np.cos(np.radians(_LEAN_DEG))
    front, back = -foot + 0.3 + 0.06, -foot + high / np.tan(np.radians(_LEAN_DEG)) + 0.06
    corners = np.array([
        (-half, front, 0.0), (half, front, 0.0), (half, back, high), (-half, back, high), (-half, back + 0.3, 0.0),
        (half, back + 0.3, 0.0), (half, back + 0.3, high), (-half, back + 0.3, high),
    ])  # fmt: skip
    sides = [(0, 1, 2, 3), (3, 2, 6, 7), (5, 4, 7, 6), (0, 3, 7, 4), (1, 5, 6, 2)]
    return merge([quad(corners[list(side)]) for side in sides]).moved(rotation("z", _TURN_DEG))


def pass_print(rows: int = 900) -> tuple[Array, Array]:
    """Brightness of the ground and coverage of white ink on the plastic card, `[row, column]`."""
    columns = int(rows * PASS_WIDTH / PASS_HEIGHT)
    x, y = pixel_grid(rows, columns)
    texts = (
        ("nacre", 0.085, 0.17),
        ("5500 0400 0700 0550", 0.63, 0.072),
        ("VALID THRU 05/50", 0.77, 0.05),
        ("A. OPTICIAN", 0.85, 0.066),
    )
    words = text_mask((rows, columns), [(text, (0.115 * rows, top * rows), size * rows) for text, top, size in texts])
    waves = 26 * (y + 0.09 * np.sin(3.1 * x + 0.6) + 0.03 * np.sin(7 * x - 4 * y))
    thin = np.clip((0.12 - np.abs(np.mod(waves, 1.0) - 0.5)) * 26, 0.0, 1.0)
    ground = np.clip(0.12 + 0.75 * (0.5 * x + 0.3 * y), 0.0, 1.0)
    return ground, np.maximum(words, 0.13 * thin)
