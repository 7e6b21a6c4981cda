"""The stage below and behind the object, as light finds it: how bright each place of it is, and the shade of a ball.

Baked once for each surroundings, so that the page reads both from pictures. The stage is that of pictures
(`nacre.picture.scenes.catalogue`): a floor that rises behind the object into a wall. Its light is what the room sends
past the wall, and what one part of the stage sends to another; the ball's shade is the share of the room's light on an
open floor that a black ball leaves. The page multiplies both: near the ball there is no wall, near the wall no shade.
"""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array
from nacre.picture.lights.environments import directions
from nacre.picture.scenes.catalogue import SWEEP
from nacre.picture.shapes.backdrop import sweep_length

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
