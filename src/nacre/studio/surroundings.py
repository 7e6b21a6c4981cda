"""Surroundings on the page: prefiltered light, light on the stage, a ball's shade, skies.

Preview and rendered picture use the same lights (`nacre.picture.emitters`). Each layer is the
radiance reflected by a rough mirror, averaged over the facet distribution with viewer, normal and reflection in one
direction (B. Karis, "Real shading in Unreal Engine 4", SIGGRAPH course 2013): exact for a smooth surface, approximate
for a rough one. A small bright lamp such as the sun is removed from the layers and drawn analytically. The stage is a
floor that rises behind the object into a wall (`nacre.picture.scenes`); its light is the direct light past
the wall and two bounces between its parts.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.errors import NacreError
from nacre.light import observer, table_wavelengths_nm, xyz_to_srgb_linear
from nacre.picture import environments
from nacre.picture.environments import WOOD, Environment, directions, studio, unit_spectrum
from nacre.picture.mesh import sweep_length
from nacre.picture.scenes import SWEEP
from nacre.recipe.fingerprint import fingerprint
from nacre.studio.appearance import pack

ROWS = 128
ALPHAS = (0.0, 0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0)  # doubled from layer to layer: the page interpolates by log2
LAYERS = len(ALPHAS) + 3
NAMES = ("studio", "interior", "street", "sun", "sky")
SKIES = ("sun", "sky")  # evaluated by Mitsuba
GREY = 0.16  # ground reflectance, as in pictures
LAMP_RATIO, MAX_LAMP_SHARE = 30.0, 0.01  # a lamp exceeds the mean radiance this many times, in this share of the sphere
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

HALF_WIDTH, FRONT, BACK, RADIUS, HEIGHT = SWEEP
FLOOR = FRONT + BACK
LENGTH = sweep_length(*SWEEP)
BALL_ROWS, BALL_COLUMNS, MEDIAN_DISTANCE = 32, 64, 1.5  # shade; half the rows lie within this many radii
STAGE_ROWS, STAGE_COLUMNS = 28, 12  # stage patches
SKY_ROWS = 32  # direction rows seen by a patch
BOUNCES = 2  # each has a tenth of the previous intensity
DARKEST, LIGHTER, SPREAD, WIDER = 0.035, 0.14, 5.5, 1.5  # the stage's reflectance, as in `catalogue.graded`

FINER, FINEST = 4, 32  # directions along each cell side; near the sun, which is one row wide
STEP_NM = 10


@dataclass(frozen=True)
class Lamp:
    """A small and very bright light.

    Attributes:
        towards: direction to its centre `[3]`; irradiance: on a surface facing it, linear sRGB `[3]`.
        radius_rad: radius of a disc with the same variance.
    """

    towards: Array
    irradiance: Array
    radius_rad: float


@dataclass(frozen=True)
class Surroundings:
    """The layers (see `blurred_surroundings`) and the lamp, if there is one."""

    layers: Array
    lamp: Lamp | None = None

    def packed(self) -> bytes:
        """Return the lamp and the layers, packed as an appearance."""
        lamp = self.lamp and {
            "towards": self.lamp.towards.tolist(),
            "irradiance": self.lamp.irradiance.tolist(),
            "radius": self.lamp.radius_rad,
        }
        return pack({"lamp": lamp}, {"room": self.layers})


@functools.cache
def floors() -> dict[str, list[float] | None]:
    """Return floor colours by surroundings, linear sRGB; the studio, which is not drawn, has None."""
    wood = xyz_to_srgb_linear(_xyz(unit_spectrum("D65").at(table_wavelengths_nm()) * WOOD))
    return {"studio": None, "interior": wood.tolist(), "street": [GREY] * 3, "sun": [GREY] * 3, "sky": [GREY] * 3}


def blurred_surroundings(name: str = "studio") -> Surroundings:
    """Return radiance over all directions, float32: one layer for each of `ALPHAS` and one for a matt white surface
    (irradiance over pi), all without the lamp, then, in other coordinates, `ball_shade` and `stage_light` with it.

    Rows run from the zenith down, columns from +x via +y, both at cell centres. The studio, whose light has one
    spectrum, has layers `[layer, row, column]`, the others linear sRGB, `[layer, row, column, 3]`.

    Raises:
        NacreError: unknown surroundings, or a sky, which `sky_job` evaluates.
    """
    if name not in NAMES or name in SKIES:
        raise NacreError(f'surroundings "{name[:40]}" are not known; choose from {", ".join(NAMES)}')
    return _blurred_surroundings(name)


@functools.cache
def _blurred_surroundings(name: str) -> Surroundings:
    """Read the surroundings from the disk cache or compute them (0.3 s for the studio, 1 s for others)."""
    key = fingerprint({"surround": name}, {})
    cached = cached_arrays(key)
    if cached is not None and "layers" in cached:
        lamp = Lamp(cached["towards"], cached["irradiance"], float(cached["radius"])) if "radius" in cached else None
        return Surroundings(cached["layers"].astype(np.float32), lamp)
    made = _computed(name)
    arrays: dict[str, Any] = {"layers": made.layers}
    if made.lamp is not None:
        arrays.update(towards=made.lamp.towards, irradiance=made.lamp.irradiance, radius=np.array(made.lamp.radius_rad))
    cache_arrays(key, arrays)
    return made


def _computed(name: str) -> Surroundings:
    if name == "studio":
        room = studio("D65", ROWS).weights[0]
        return Surroundings(_layers(room, room))
    make: Callable[[], Environment] = getattr(environments, name)
    place = make()
    nm = table_wavelengths_nm()
    colours = np.stack([xyz_to_srgb_linear(_xyz(spectrum.at(nm))) for spectrum in place.spectra])
    return surroundings_of(np.maximum(np.einsum("kij,kc->ijc", place.weights, colours), 0.0))


def surroundings_of(rgb: Array) -> Surroundings:
    """Return surroundings for radiance `[row, column, 3]`; the row count is a multiple of `ROWS`."""
    rest, lamp = without_lamp(rgb)
    rest, room_and_lamp = (_downsampled(each) for each in (rest, rgb))
    return Surroundings(np.stack([_layers(rest[..., c], room_and_lamp[..., c]) for c in range(3)], axis=-1), lamp)


def _downsampled(rgb: Array) -> Array:
    """Average radiance over the page's cells."""
    rows = len(rgb)
    times = rows // ROWS
    area = np.sin((np.arange(rows) + 0.5) * np.pi / rows).reshape(ROWS, times, 1, 1, 1)
    cells = rgb.reshape(ROWS, times, 2 * ROWS, times, 3)
    return np.asarray((area * cells).sum(axis=(1, 3)) / (area.sum(axis=1) * times)[:, 0])


def without_lamp(rgb: Array) -> tuple[Array, Lamp | None]:
    """Split radiance `[row, column, 3]` into its lamp and the rest; without a lamp it is returned unchanged."""
    rows, columns, _ = rgb.shape
    area = (np.sin((np.arange(rows) + 0.5) * np.pi / rows) * (np.pi / rows) ** 2)[:, None] * np.ones(columns)
    luminance = rgb @ LUMINANCE
    bright = luminance > LAMP_RATIO * np.sum(luminance * area) / (4.0 * np.pi)
    if not bright.any() or np.sum(area[bright]) > MAX_LAMP_SHARE * 4.0 * np.pi:
        return rgb, None
    around = [np.roll(bright, (down, right), (0, 1)) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    cells = np.any(around, axis=0)  # includes partly filled cells
    rim = np.any([np.roll(cells, step, axis) for step in (-1, 1) for axis in (0, 1)], axis=0) & ~cells
    rest = rgb.copy()
    rest[cells] = rgb[rim].mean(axis=0)
    sent = (rgb - rest)[cells] * area[cells][:, None]
    towards, power = directions(rows)[cells], sent @ LUMINANCE
    centre = power @ towards / np.linalg.norm(power @ towards)
    off = np.arccos(np.clip(towards @ centre, -1.0, 1.0))
    # mean square distance: half the squared radius in a disc, a sixth of the squared side in a cell
    variance = max(float(power @ off**2 / power.sum()) - (np.pi / rows) ** 2 / 6.0, 0.0)
    radius = max(np.sqrt(2.0 * variance), 0.25 * np.pi / rows)
    return rest, Lamp(centre, np.maximum(sent.sum(axis=0), 0.0), float(radius))


def _xyz(power: Array) -> Array:
    """Return XYZ for a light spectrum; Y is its luminance."""
    y = observer()[:, 1]
    return np.asarray(power @ observer() / np.sum(y))


def _layers(room: Array, lit: Array) -> Array:
    """Return a room's layers; `lit` includes its lamp and lights the floor."""
    layers = [room]
    layers += [_blurred(room, functools.partial(_ggx, alpha=alpha)) for alpha in ALPHAS[1:]]
    layers.append(_blurred(room, lambda cos: np.maximum(cos, 0.0)))
    layers += [ball_shade(lit), stage_light(lit)]
    return np.stack(layers).astype(np.float32)


def _ggx(cos: Array, alpha: float) -> Array:
    """Return the weight at an angle from the mirror direction, which is also the normal."""
    half = 0.5 * (1.0 + cos)  # squared cosine of the half angle
    return np.maximum(cos, 0.0) / (half * (alpha**2 - 1.0) + 1.0) ** 2


def _blurred(room: Array, weight: Callable[[Array], Array]) -> Array:
    """Average over directions with an angular weight, by circular convolution for each row pair."""
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


def ball_shade(room: Array) -> Array:
    """Return the share of the room's light that reaches the floor around a ball.

    Args:
        room: radiance `[row, column]` over all directions, rows from the zenith down.

    Returns:
        `[row, column]` as large as the room: columns are azimuths from +x via +y; at row share s the
        distance from the contact point is `MEDIAN_DISTANCE` s / (1 - s) radii.
    """
    d, power = _patches(room)
    up = d[:, 2] > 0
    d, power = d[up], power[0][up]
    share = (np.arange(BALL_ROWS) + 0.5) / BALL_ROWS
    distances = MEDIAN_DISTANCE * share / (1.0 - share)
    remaining = np.empty((BALL_ROWS, BALL_COLUMNS))
    turns = 2.0 * np.pi * (np.arange(BALL_COLUMNS) + 0.5) / BALL_COLUMNS
    soft = np.pi / (2 * SKY_ROWS)  # half width of a sky patch
    for row, distance in enumerate(distances):
        to_ball = np.stack([-distance * np.cos(turns), -distance * np.sin(turns), np.ones_like(turns)], axis=-1)
        length = np.sqrt(distance**2 + 1.0)
        apart = np.arccos(np.clip(to_ball @ d.T / length, -1.0, 1.0)) - np.arcsin(min(1.0 / length, 1.0))
        visible = np.clip(0.5 + apart / soft, 0.0, 1.0)
        remaining[row] = visible @ (power * d[:, 2]) / (power @ d[:, 2])
    return _upsampled(remaining, room.shape, is_periodic=True)


def stage_light(room: Array) -> Array:
    """Return the radiance from a matt white stage, rows from its front edge to the wall's upper edge.

    Args:
        room: as for `ball_shade`; the camera looks along +y.

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
        indirect = [weight @ _at(sent, where) for where, weight in met]
        lit[bounce] = lit[0] + np.reshape(indirect, lit[0].shape)
    return _upsampled(lit[-1], room.shape, is_periodic=False)


def graded(along: Array, across: Array) -> Array:
    """Return the stage's reflectance at lengths along it from its front edge and across it from its centre line."""
    return np.asarray(DARKEST + LIGHTER * np.exp(-(((across / WIDER) ** 2 + (along - FRONT) ** 2) / SPREAD**2)))


def stage_hit(start: Array, d: Array) -> tuple[Array, Array]:
    """Return which rays `d` `[ray, 3]` from a point `[3]` hit the stage, and where `[ray, (along, across)]`.

    The floor lies at z = 0 up to y = `BACK`, bends with `RADIUS` and rises to `HEIGHT`.
    """
    x, y, z = start
    dx, dy, dz = d.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        down = np.where(dz < 0, -z / dz, np.inf)
        on_floor = y + down * dy < BACK
        # a ray from inside hits the bend at its exit from the circle
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
        is_hit = on_floor | (is_bent & (at_y > BACK)) | (~is_bent & (dy > 0) & (at_z < HEIGHT))
        is_hit &= (np.abs(at_x) < HALF_WIDTH) & (along > 0.0) & np.isfinite(t) & (t > 0)
    return is_hit, np.stack([along, at_x], axis=-1)


def _place(along: float) -> tuple[Array, Array]:
    """Return y and z for a point on the stage, and its normal `[3]`."""
    if along < FLOOR:
        return np.array([along - FRONT, 0.0]), np.array([0.0, 0.0, 1.0])
    turn = min((along - FLOOR) / RADIUS, 0.5 * np.pi)
    beyond = max(along - FLOOR - 0.5 * np.pi * RADIUS, 0.0)
    y, z = BACK + RADIUS * np.sin(turn), RADIUS * (1.0 - np.cos(turn)) + beyond
    return np.array([y, z]), np.array([0.0, -np.sin(turn), np.cos(turn)])


def _patches(room: Array) -> tuple[Array, Array]:
    """Return directions `[patch, 3]`, and radiance times solid angle and solid angle, `[2, patch]`."""
    rows = room.shape[0]
    times = rows // SKY_ROWS
    height = np.sin((np.arange(rows) + 0.5) * np.pi / rows)[:, None]

    def summed(values: Array) -> Array:
        cells = values.reshape(SKY_ROWS, times, 2 * SKY_ROWS, times)
        return np.asarray((cells.sum(axis=(1, 3)) * (np.pi / rows) ** 2).ravel())

    return directions(SKY_ROWS).reshape(-1, 3), np.stack([summed(room * height), summed(0.0 * room + height)])


def _at(values: Array, where: Array) -> Array:
    from scipy.ndimage import map_coordinates  # lazy: usually the disk cache has the result

    rows, columns = values.shape
    places = [where[:, 0] / LENGTH * rows - 0.5, (where[:, 1] / HALF_WIDTH + 1.0) / 2.0 * columns - 0.5]
    return np.asarray(map_coordinates(values, places, order=1, mode="nearest"))


def _upsampled(values: Array, shape: tuple[int, ...], is_periodic: bool) -> Array:
    """Interpolate cell values at smaller cells' centres; columns may be periodic."""
    from scipy.ndimage import map_coordinates

    places = [(np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(shape, values.shape, strict=True)]
    pad = 2
    wide = np.pad(values, ((0, 0), (pad, pad)), mode="wrap" if is_periodic else "edge")
    grid = np.meshgrid(places[0], places[1] + pad, indexing="ij")
    return np.asarray(map_coordinates(wide, grid, order=1, mode="nearest"))


def sky_job(request: Mapping[str, Any], emit: Any = None) -> bytes:
    """Return the surroundings `name`, a sky, as `Surroundings.packed`; runs in a subprocess, as it loads Mitsuba.

    Raises:
        NacreError: Mitsuba is not available on this machine.
    """
    return surroundings_of(with_ground(sky_radiance(request["name"]))).packed()


def sky_radiance(name: str) -> Array:
    """Return the sun or sky radiance over all directions, linear sRGB `[row, column, 3]`, in picture units.

    Raises:
        NacreError: unknown sky, or Mitsuba is not available on this machine.
    """
    if name not in SKIES:
        raise NacreError(f'"{name[:40]}" is not a sky; choose from {", ".join(SKIES)}')
    from nacre.picture.emitters import make_light

    emitter = make_light(name).emitters["sky"]
    rows, columns = np.indices((ROWS, 2 * ROWS)).reshape(2, -1)
    rgb = _mean_radiance(emitter, rows, columns, FINER).reshape(ROWS, 2 * ROWS, 3)
    bright = rgb.max(axis=-1) > LAMP_RATIO * np.mean(rgb)
    bright |= sum(np.roll(bright, step, axis) for step in (-1, 1) for axis in (0, 1)) > 0
    rows, columns = np.nonzero(bright)
    if len(rows):
        rgb[bright] = _mean_radiance(emitter, rows, columns, FINEST)
    return rgb


def with_ground(rgb: Array) -> Array:
    """Return sky radiance `[row, column, 3]` with the lit grey ground below the horizon."""
    theta = (np.arange(ROWS // 2) + 0.5) * np.pi / ROWS
    share = (np.sin(theta) * np.cos(theta))[:, None, None] * (np.pi / ROWS) ** 2
    radiance = rgb.copy()
    radiance[ROWS // 2 :] = GREY / np.pi * np.sum(share * rgb[: ROWS // 2], axis=(0, 1))
    return radiance


def _mean_radiance(emitter: Any, rows: NDArray[np.integer], columns: NDArray[np.integer], finer: int) -> Array:
    """Return mean radiances for table cells, linear sRGB `[cell, 3]`, from finer x finer directions each."""
    within = (np.arange(finer) + 0.5) / finer
    theta = (rows[:, None, None] + within[:, None]) * np.pi / ROWS
    phi = (columns[:, None, None] + within) * np.pi / ROWS
    theta, phi = np.broadcast_arrays(theta, phi)
    towards = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    xyz = _emitter_xyz(emitter, towards.reshape(-1, 3)).reshape(len(rows), -1, 3).mean(axis=1)
    return np.maximum(xyz_to_srgb_linear(xyz), 0.0)


def _emitter_xyz(emitter: Any, towards: Array) -> Array:
    """Return a Mitsuba emitter's radiance in directions `[n, 3]`, as XYZ `[n, 3]`."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = mi.Vector3f(*(-towards.T))
    nm, matching = table_wavelengths_nm()[::STEP_NM], observer()[::STEP_NM]
    xyz = np.zeros((len(towards), 3))
    for first in range(0, len(nm), 4):
        four = nm[first : first + 4]
        interaction.wavelengths = mi.Spectrum(*np.append(four, np.full(4 - len(four), four[-1])).tolist())
        power = np.array(emitter.eval(interaction)).reshape(4, -1)[: len(four)]
        xyz += power.T @ matching[first : first + 4]
    return xyz / matching[:, 1].sum()
