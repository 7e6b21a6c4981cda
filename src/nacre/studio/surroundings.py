"""The stage below and behind the object, as light finds it: how bright each place of it is, and the shade of a ball.

Baked once for each surroundings, so that the page reads both from pictures. The stage is that of pictures
(`nacre.picture.scenes.catalogue`): a floor that rises behind the object into a wall. Its light is what the room sends
past the wall, and what one part of the stage sends to another; the ball's shade is the share of the room's light on an
open floor that a black ball leaves. The page multiplies both: near the ball there is no wall, near the wall no shade.
"""

from __future__ import annotations

import functools
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.errors import NacreError
from nacre.light import observer, table_wavelengths_nm, xyz_to_srgb_linear
from nacre.picture.lights.environments import Environment, directions, studio, unit_spectrum
from nacre.picture.scenes.catalogue import SWEEP
from nacre.picture.shapes.backdrop import sweep_length
from nacre.recipe.fingerprint import fingerprint

HALF_WIDTH, FRONT, BACK, RADIUS, HEIGHT = SWEEP
FLOOR = FRONT + BACK
LENGTH = sweep_length(*SWEEP)
BALL_ROWS, BALL_COLUMNS, HALF_WAY = 32, 64, 1.5  # of the shade: distances (half of them below so many radii), azimuths
STAGE_ROWS, STAGE_COLUMNS = 28, 12  # places on the stage that are solved; between them light is smooth
LOOKS = 32  # rows of directions that a place looks into
BOUNCES = 2  # of light between parts of the stage; each is a tenth of the one before
DARKEST, LIGHTER, SPREAD, WIDER = 0.035, 0.14, 5.5, 1.5  # of the stage's reflectance, as `catalogue.graded` has it


def ball_shade(room: Array) -> Array:
    """Return the share of the room's light that reaches a floor past a ball that stands on it.

    Args:
        room: radiance `[row, column]` of the upper and lower directions, rows from the zenith down.

    Returns:
        `[row, column]` as large as the room: columns run round the ball from +x by +y, rows outward from where it
        stands: at share s of the rows the distance is `HALF_WAY` s / (1 - s) radii.
    """
    d, power = _sky(room)
    share = (np.arange(BALL_ROWS) + 0.5) / BALL_ROWS
    far = HALF_WAY * share / (1.0 - share)
    # turning the ball's azimuth is turning the sky: one set of shades for all columns
    left = np.empty((BALL_ROWS, BALL_COLUMNS))
    turns = 2.0 * np.pi * (np.arange(BALL_COLUMNS) + 0.5) / BALL_COLUMNS
    soft = np.pi / (2 * LOOKS)  # a direction stands for a patch of the sky so wide
    for row, distance in enumerate(far):
        to_ball = np.stack([-distance * np.cos(turns), -distance * np.sin(turns), np.ones_like(turns)], axis=-1)
        length = np.sqrt(distance**2 + 1.0)
        apart = np.arccos(np.clip(to_ball @ d.T / length, -1.0, 1.0)) - np.arcsin(min(1.0 / length, 1.0))
        seen = np.clip(0.5 + apart / soft, 0.0, 1.0)
        left[row] = seen @ (power * d[:, 2]) / (power @ d[:, 2])
    return _larger(left, room.shape, is_round=True)


def stage_light(room: Array) -> Array:
    """Return what a matt white patch of the stage would send, rows from the stage's front edge to its wall's upper one.

    Args:
        room: as of `ball_shade`; the camera looks along +y.

    Returns:
        `[row, column]` as large as the room, columns from left to right.
    """
    along = (np.arange(STAGE_ROWS) + 0.5) / STAGE_ROWS * LENGTH
    across = ((np.arange(STAGE_COLUMNS) + 0.5) / STAGE_COLUMNS * 2.0 - 1.0) * HALF_WIDTH
    d, power = _patches(room)
    lit = np.empty((BOUNCES + 1, STAGE_ROWS, STAGE_COLUMNS))
    met = []
    for row, v in enumerate(along):
        place, normal = _place(float(v))
        cos = np.maximum(d @ normal, 0.0)
        for column, u in enumerate(across):
            hits, where = stage_hit(np.array([u, place[0], place[1]]) + 1e-6 * normal, d)
            lit[0, row, column] = np.sum(np.where(hits, 0.0, power[0]) * cos) / np.pi
            met.append((where[hits], (power[1] * cos / np.pi)[hits]))
    reflectance = graded(along[:, None], across[None, :])
    for bounce in range(1, BOUNCES + 1):
        sent = reflectance * lit[bounce - 1]
        between = [weight @ _at(sent, where) for where, weight in met]
        lit[bounce] = lit[0] + np.reshape(between, lit[0].shape)
    return _larger(lit[-1], room.shape, is_round=False)


def graded(along: Array, across: Array) -> Array:
    """Return the reflectance of the stage at lengths along it from its front edge and across it from its middle."""
    return np.asarray(DARKEST + LIGHTER * np.exp(-(((across / WIDER) ** 2 + (along - FRONT) ** 2) / SPREAD**2)))


def stage_hit(start: Array, d: Array) -> tuple[Array, Array]:
    """Return which rays `d` `[ray, 3]` from a place `[3]` before the stage meet it, and where `[ray, (along, across)]`.

    The floor lies at z = 0 up to y = `BACK`, bends with `RADIUS` and stands up to `HEIGHT`.
    """
    x, y, z = start
    dx, dy, dz = d.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        down = np.where(dz < 0, -z / dz, np.inf)
        on_floor = y + down * dy < BACK
        # seen from within, the arc is met where the ray leaves its circle
        a, b = dy**2 + dz**2, (y - BACK) * dy + (z - RADIUS) * dz
        c = (y - BACK) ** 2 + (z - RADIUS) ** 2 - RADIUS**2
        bent = (-b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / a
        upward = np.where(dy > 0, (BACK + RADIUS - y) / dy, np.inf)
        is_bent = z + bent * dz < RADIUS
        t = np.where(on_floor, down, np.where(is_bent, bent, upward))
        at_y, at_z, at_x = y + t * dy, z + t * dz, x + t * dx
        turn = np.arctan2(at_y - BACK, RADIUS - at_z)
        arc = np.where(is_bent, RADIUS * turn, RADIUS * np.pi / 2 + at_z - RADIUS)
        along = np.where(on_floor, at_y + FRONT, FLOOR + arc)
        is_met = on_floor | (is_bent & (at_y > BACK)) | (~is_bent & (dy > 0) & (at_z < HEIGHT))
        is_met &= (np.abs(at_x) < HALF_WIDTH) & (along > 0.0) & np.isfinite(t) & (t > 0)
    return is_met, np.stack([along, at_x], axis=-1)


def _place(along: float) -> tuple[Array, Array]:
    """Return y and z of a place on the stage, and its normal `[3]`."""
    if along < FLOOR:
        return np.array([along - FRONT, 0.0]), np.array([0.0, 0.0, 1.0])
    turn = min((along - FLOOR) / RADIUS, 0.5 * np.pi)
    beyond = max(along - FLOOR - 0.5 * np.pi * RADIUS, 0.0)
    y, z = BACK + RADIUS * np.sin(turn), RADIUS * (1.0 - np.cos(turn)) + beyond
    return np.array([y, z]), np.array([0.0, -np.sin(turn), np.cos(turn)])


def _patches(room: Array) -> tuple[Array, Array]:
    """Return directions `[patch, 3]`, and for each radiance times solid angle, and solid angle, `[2, patch]`."""
    rows = room.shape[0]
    times = rows // LOOKS
    coarse = directions(LOOKS)
    height = np.sin((np.arange(rows) + 0.5) * np.pi / rows)[:, None]
    share = (room * height).reshape(LOOKS, times, 2 * LOOKS, times).sum(axis=(1, 3)) * (np.pi / rows) ** 2
    area = (0.0 * room + height).reshape(LOOKS, times, 2 * LOOKS, times).sum(axis=(1, 3)) * (np.pi / rows) ** 2
    return coarse.reshape(-1, 3), np.stack([share.ravel(), area.ravel()])


def _sky(room: Array) -> tuple[Array, Array]:
    d, power = _patches(room)
    up = d[:, 2] > 0
    return d[up], power[0][up]


def _at(values: Array, where: Array) -> Array:
    from scipy.ndimage import map_coordinates  # here, as what is baked is kept: most pages begin without

    rows, columns = values.shape
    places = [where[:, 0] / LENGTH * rows - 0.5, (where[:, 1] / HALF_WIDTH + 1.0) / 2.0 * columns - 0.5]
    return np.asarray(map_coordinates(values, places, order=1, mode="nearest"))


def _larger(values: Array, shape: tuple[int, ...], is_round: bool) -> Array:
    """Return values at the middles of cells, between those of larger ones; the columns of a round one go on."""
    from scipy.ndimage import map_coordinates

    places = [(np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(shape, values.shape, strict=True)]
    pad = 2
    wide = np.pad(values, ((0, 0), (pad, pad)), mode="wrap" if is_round else "edge")
    grid = np.meshgrid(places[0], places[1] + pad, indexing="ij")
    return np.asarray(map_coordinates(wide, grid, order=1, mode="nearest"))


# The light around the object, blurred once for each roughness, so that the page needs one look-up a pixel.

ROWS = 128
ALPHAS = (0.0, 0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0)  # doubled from layer to layer: the page interpolates by log2
LAYERS = len(ALPHAS) + 3
NAMES = ("studio", "interior", "street", "sun", "sky")
SKIES = ("sun", "sky")  # lights of Mitsuba's own, see `nacre.studio.skies`
GREY = 0.16  # of the ground of a street and under a sky, as in pictures
BRIGHT, SMALL = 30.0, 0.01  # a lamp: so many times the mean radiance, in so small a part of all directions
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Lamp:
    """What of a place is small and very bright.

    Attributes:
        towards: direction to its middle `[3]`; irradiance: on a surface that faces it, linear sRGB `[3]`.
        radius_rad: of a disc that is spread as wide.
    """

    towards: Array
    irradiance: Array
    radius_rad: float

    def matt(self, normal: Array) -> Array:
        """Return the radiance of a matt white surface `[3]` that it lights."""
        return np.asarray(self.irradiance * max(float(normal @ self.towards), 0.0) / np.pi)


@dataclass(frozen=True)
class Surround:
    """A place as the page draws with it: its layers (see `blurred_surround`) and its lamp, if it has one."""

    layers: Array
    lamp: Lamp | None = None

    def packed(self) -> bytes:
        """Return it as looks are packed: length of the header, header as JSON with `lamp`, the layers as float32."""
        lamp: dict[str, Any] | None = None
        if self.lamp is not None:
            lamp = {
                "towards": self.lamp.towards.tolist(),
                "irradiance": self.lamp.irradiance.tolist(),
                "radius": self.lamp.radius_rad,
            }
        text = json.dumps({"lamp": lamp, "arrays": [["room", list(self.layers.shape)]]}).encode()
        text += b" " * (-len(text) % 4)
        return struct.pack("<I", len(text)) + text + self.layers.astype("<f4").tobytes()


@functools.cache
def floors() -> dict[str, list[float] | None]:
    """Return the colour of the floor of every place, linear sRGB; None for the studio, which is no place to be seen."""
    from nacre.picture.lights.environments import WOOD

    nm = table_wavelengths_nm()
    wood = xyz_to_srgb_linear(_xyz(unit_spectrum("D65").at(nm) * WOOD))
    return {"studio": None, "interior": wood.tolist(), "street": [GREY] * 3, "sun": [GREY] * 3, "sky": [GREY] * 3}


def blurred_surround(name: str = "studio") -> Surround:
    """Return radiance over all directions, float32: one layer for each of `ALPHAS`, then one for a matt white surface
    (irradiance over pi), all without the lamp; and then, over other coordinates, `ball_shade` and
    `stage_light`, with it.

    Rows run from the zenith down, columns from +x round by +y, both at the centres of their cells. Of the studio, whose
    light has one spectrum, `[layer, row, column]`; of a place linear sRGB, `[layer, row, column, 3]`.

    Raises:
        NacreError: no such surrounding, or a sky, which only Mitsuba knows (`nacre.studio.skies`).
    """
    if name not in NAMES or name in SKIES:
        raise NacreError(f'surrounding "{name[:40]}" is not known; choose from {", ".join(NAMES)}')
    return _blurred_surround(name)


@functools.cache
def _blurred_surround(name: str) -> Surround:
    """Return a place as it is kept between runs, or make it: the studio takes a third of a second, another one."""
    key = fingerprint({"surround": name}, {})
    kept = cached_arrays(key)
    if kept is not None and "layers" in kept:
        lamp = Lamp(kept["towards"], kept["irradiance"], float(kept["radius"])) if "radius" in kept else None
        return Surround(kept["layers"].astype(np.float32), lamp)
    made = _made(name)
    arrays: dict[str, Any] = {"layers": made.layers}
    if made.lamp is not None:
        arrays.update(towards=made.lamp.towards, irradiance=made.lamp.irradiance, radius=np.array(made.lamp.radius_rad))
    cache_arrays(key, arrays)
    return made


def _made(name: str) -> Surround:
    if name == "studio":
        room = studio("D65", ROWS).weights[0]
        return Surround(_layers(room, room))
    from nacre.picture.lights import environments

    made: Callable[[], Environment] = getattr(environments, name)
    place = made()
    nm = table_wavelengths_nm()
    colours = np.stack([xyz_to_srgb_linear(_xyz(spectrum.at(nm))) for spectrum in place.spectra])
    return surround_of(np.maximum(np.einsum("kij,kc->ijc", place.weights, colours), 0.0))


def surround_of(rgb: Array) -> Surround:
    """Return a place by its radiance `[row, column, 3]`, of so many rows as the page has, or a multiple of them."""
    rest, lamp = without_lamp(rgb)
    rest, whole = (_coarser(each) for each in (rest, rgb))
    return Surround(np.stack([_layers(rest[..., c], whole[..., c]) for c in range(3)], axis=-1), lamp)


def _coarser(rgb: Array) -> Array:
    """Return the mean radiance of the page's cells."""
    rows = len(rgb)
    times = rows // ROWS
    area = np.sin((np.arange(rows) + 0.5) * np.pi / rows).reshape(ROWS, times, 1, 1, 1)
    cells = rgb.reshape(ROWS, times, 2 * ROWS, times, 3)
    return np.asarray((area * cells).sum(axis=(1, 3)) / (area.sum(axis=1) * times)[:, 0])


def without_lamp(rgb: Array) -> tuple[Array, Lamp | None]:
    """Return a place's radiance `[row, column, 3]` without its lamp, and the lamp; as it is, where it has none."""
    rows, columns, _ = rgb.shape
    area = (np.sin((np.arange(rows) + 0.5) * np.pi / rows) * (np.pi / rows) ** 2)[:, None] * np.ones(columns)
    luminance = rgb @ LUMINANCE
    bright = luminance > BRIGHT * np.sum(luminance * area) / (4.0 * np.pi)
    if not bright.any() or np.sum(area[bright]) > SMALL * 4.0 * np.pi:
        return rgb, None
    around = [np.roll(bright, (down, right), (0, 1)) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    cells = np.any(around, axis=0)  # with those that it fills in part
    rim = np.any([np.roll(cells, step, axis) for step in (-1, 1) for axis in (0, 1)], axis=0) & ~cells
    rest = rgb.copy()
    rest[cells] = rgb[rim].mean(axis=0)
    sent = (rgb - rest)[cells] * area[cells][:, None]
    towards, power = directions(rows)[cells], sent @ LUMINANCE
    middle = power @ towards / np.linalg.norm(power @ towards)
    off = np.arccos(np.clip(towards @ middle, -1.0, 1.0))
    # of a disc the mean square of the distance is half of the radius squared; of a cell, a sixth of its side squared
    spread = max(float(power @ off**2 / power.sum()) - (np.pi / rows) ** 2 / 6.0, 0.0)
    radius = max(np.sqrt(2.0 * spread), 0.25 * np.pi / rows)
    return rest, Lamp(middle, np.maximum(sent.sum(axis=0), 0.0), float(radius))


def _xyz(power: Array) -> Array:
    """Return X, Y, Z of a spectrum of light, of which one of luminance 1 has Y = 1."""
    y = observer()[:, 1]
    return np.asarray(power @ observer() / np.sum(y))


def _layers(room: Array, whole: Array) -> Array:
    """Return the layers of a room that has no lamp, and of what lights its floor, lamp and all."""
    layers = [room]
    layers += [_blurred(room, functools.partial(_ggx, alpha=alpha)) for alpha in ALPHAS[1:]]
    layers.append(_blurred(room, lambda cos: np.maximum(cos, 0.0)))
    layers += [ball_shade(whole), stage_light(whole)]
    return np.stack(layers).astype(np.float32)


def _ggx(cos: Array, alpha: float) -> Array:
    """Weight of light that arrives at an angle from the mirror direction, which is also the normal's."""
    half = 0.5 * (1.0 + cos)  # squared cosine of half the angle: the facet stands between
    return np.maximum(cos, 0.0) / (half * (alpha**2 - 1.0) + 1.0) ** 2


def _blurred(room: Array, weight: Callable[[Array], Array]) -> Array:
    """Average over directions with a weight of the angle between; a circular convolution along each pair of rows."""
    rows, columns = room.shape
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    turn = np.cos(2.0 * np.pi * np.arange(columns) / columns)
    sent = np.fft.rfft(room * np.sin(theta)[:, None], axis=1)
    area = np.sin(theta)[:, None] * np.ones(columns)
    blurred = np.empty_like(room)
    for row in range(rows):
        cos = np.sin(theta[row]) * np.sin(theta)[:, None] * turn + np.cos(theta[row]) * np.cos(theta)[:, None]
        kernel = weight(np.clip(cos, -1.0, 1.0))
        total = float((kernel * area).sum())
        blurred[row] = np.fft.irfft((np.fft.rfft(kernel, axis=1) * sent).sum(axis=0), n=columns) / total
    return blurred
