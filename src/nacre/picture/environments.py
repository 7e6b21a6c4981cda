"""Spectral environments: studio, beam, room, street and garden.

Each is a small procedural scene, evaluated over all directions, whose surfaces have reflectance spectra and whose
lamps have measured illuminants. It is stored as a few spectra with a weight per direction, therefore metamers are
distinguished as in the real place. Light bounces once, plus a grey share for further bounces. Brick,
wood and leaf reflectances are smooth curves with edges at 570, 550 and 690 nm; daylight is sun, haze and blue sky.
"""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.light import Illuminant, illuminant, observer, table_wavelengths_nm
from nacre.picture.plugins import noise

BEAM_DEG, BEAM_EDGE_DEG = 10.0, 0.7  # width of the lamp of `beam`, and of its soft edge
ROWS = 512
STREET_TURN_DEG = 30.0
SUN_DEG = 4.0  # wider than the sun at equal power, against noise
SUN = (-0.62, -0.30, 0.60)  # sun direction in the garden: behind the camera's left shoulder, above the trees
_SEED = 21
_GRID = table_wavelengths_nm()


@dataclass(frozen=True, eq=False)
class Environment:
    """Radiance over all directions: sum_k weights[k] * spectra[k].

    Attributes:
        weights: `[spectrum, row, column]`; rows from the zenith down, columns from +x towards +y.
        spectra: illuminants with luminance 1 (`unit_spectrum`).
        name: description for outputs.
    """

    weights: Array
    spectra: tuple[Illuminant, ...]
    name: str

    @property
    def luminance(self) -> Array:
        """`[row, column]`."""
        return np.tensordot(np.array([luminance(s) for s in self.spectra]), self.weights, axes=1)

    @property
    def irradiance(self) -> float:
        """Luminous irradiance on a horizontal plane facing up; pi for a uniform sky with luminance 1."""
        _, rows, columns = self.weights.shape
        theta = (np.arange(rows) + 0.5) * np.pi / rows
        share = np.where(theta < np.pi / 2, np.sin(theta) * np.cos(theta), 0.0)[:, None]
        return float((self.luminance * share).sum() * (np.pi / rows) * (2 * np.pi / columns))


def unit_spectrum(light: str | Illuminant) -> Illuminant:
    """Scale an illuminant to luminance 1: as an emitter it gives Y = 1 in Mitsuba's XYZ."""
    source = illuminant(light)
    power = source.at(_GRID)
    return Illuminant(_GRID, power / luminance(Illuminant(_GRID, power)), source.name)


def luminance(light: Illuminant) -> float:
    """Mean power, weighted by the luminous efficiency."""
    y = observer()[:, 1]
    return float(np.sum(light.at(_GRID) * y) / np.sum(y))


def tinted(light: Illuminant, reflectance: Array, name: str) -> Illuminant:
    """Light reflected by a surface, not rescaled."""
    return Illuminant(light.wavelengths_nm, light.power * reflectance, name)


def directions(rows: int) -> Array:
    """Unit vectors `[rows, 2 * rows, 3]` at equirectangular pixel centres."""
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    phi = (np.arange(2 * rows) + 0.5) * np.pi / rows
    t, p = np.meshgrid(theta, phi, indexing="ij")
    return np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)


def smooth_step(x: Array, low: float, high: float) -> Array:
    """Cubic step from 0 to 1."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def soft_box(
    d: Array,
    azimuth_deg: float,
    elevation_deg: float,
    width_deg: float,
    height_deg: float,
    roll_deg: float = 0.0,
    edge: float = 0.12,
    fall: float = 0.5,
) -> Array:
    """Soft-box radiance along `d` `[..., 3]`: 1 at its bright end, decreasing by `fall` along its height."""
    az, el, roll = np.radians([azimuth_deg, elevation_deg, roll_deg])
    forward = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    right = np.array([-np.sin(az), np.cos(az), 0.0])
    up = np.cross(forward, right)
    right, up = np.cos(roll) * right + np.sin(roll) * up, np.cos(roll) * up - np.sin(roll) * right
    along = d @ forward
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (d @ right) / along / np.tan(0.5 * np.radians(width_deg))
        b = (d @ up) / along / np.tan(0.5 * np.radians(height_deg))
    inside = (1 - smooth_step(np.abs(a), 1 - edge, 1.0)) * (1 - smooth_step(np.abs(b), 1 - edge, 1.0))
    glow = (1 - fall * (0.5 - 0.5 * np.clip(b, -1, 1))) * (1 - 0.15 * np.clip(a, -1, 1) ** 2)
    return np.where(along > 1e-3, np.nan_to_num(inside * glow), 0.0)


def studio(light: str | Illuminant = "D65", rows: int = 256) -> Environment:
    """A dark studio with soft boxes: a large key light at the upper left, strips at the sides, one overhead.

    The surround is dim and graded: a specular film shows its colour in large calm areas, each with a dark edge beside.
    """
    d = directions(rows)
    z = d[..., 2]
    surround = 0.05 + 0.2 * smooth_step(z, -0.1, 1.0) + 0.03 * smooth_step(-z, 0.0, 0.8)
    boxes = 1.5 * soft_box(d, 216, 45, 72, 62, roll_deg=-8, fall=0.7)
    boxes += 1.35 * soft_box(d, -26, 26, 20, 84, roll_deg=4, fall=0.7)
    boxes += 1.0 * soft_box(d, 158, 32, 11, 62, roll_deg=-6, fall=0.5)
    boxes += 1.2 * soft_box(d, 62, 64, 66, 30, fall=0.6)
    spectrum = unit_spectrum(light)
    return Environment((surround + boxes)[None], (spectrum,), f"studio, {spectrum.name}")


def beam(light: str | Illuminant = "D65", rows: int = 512, width_deg: float = BEAM_DEG) -> Environment:
    """A distant lamp at the upper left front, and a weak fill light for the shadows.

    At the default width paths find caustics, and a mirror shows the lamp. White paper on the floor has luminance
    0.6 under the lamp; other widths have the same power.
    """
    towards = np.array([-0.5, -0.62, 0.95])
    towards /= np.linalg.norm(towards)
    across = 2.0 * np.arccos(np.clip(directions(rows) @ towards, -1.0, 1.0))

    def lamp_of(width: float) -> Array:
        return np.asarray(0.5 - 0.5 * np.clip((across - np.radians(width)) / np.radians(BEAM_EDGE_DEG), -1.0, 1.0))

    spectrum = unit_spectrum(light)
    level = 0.6 * np.pi / Environment(lamp_of(BEAM_DEG)[None], (spectrum,), "lamp").irradiance
    disc = lamp_of(width_deg)
    if width_deg != BEAM_DEG:
        area = np.sin((np.arange(rows) + 0.5) * np.pi / rows)[:, None]
        level *= float((lamp_of(BEAM_DEG) * area).sum() / (disc * area).sum())
    weights = 0.04 + level * disc
    return Environment(weights[None], (spectrum,), f"beam, {spectrum.name}")


def edge(low: float, high: float, middle_nm: float, width_nm: float) -> Array:
    """A reflectance spectrum that rises smoothly from `low` to `high`."""
    return np.asarray(low + (high - low) / (1 + np.exp(-(_GRID - middle_nm) / width_nm)))


def peak(low: float, high: float, middle_nm: float, width_nm: float) -> Array:
    """A spectrum with one Gaussian peak."""
    return np.asarray(low + (high - low) * np.exp(-(((_GRID - middle_nm) / width_nm) ** 2)))


BRICK = edge(0.07, 0.34, 575.0, 22.0)
PLASTER = edge(0.38, 0.62, 500.0, 60.0)
WOOD = edge(0.12, 0.45, 560.0, 45.0)
CLOTH = edge(0.30, 0.06, 520.0, 25.0)
LEAF = peak(0.04, 0.11, 550.0, 32.0) + edge(0.0, 0.42, 705.0, 9.0)
THROUGH = peak(0.02, 0.24, 555.0, 34.0) + edge(0.0, 0.45, 710.0, 9.0)  # leaf transmittance


def blue_sky() -> Illuminant:
    """Clear zenith light: D65 times (lambda / 550 nm)^-2.2."""
    day = illuminant("D65")
    return unit_spectrum(Illuminant(_GRID, day.at(_GRID) * (_GRID / 550.0) ** -2.2, "clear sky"))


def _hash(*values: Array) -> Array:
    """Repeatable pseudo-random numbers in [0, 1) for integer cells."""
    mix = sum(v * k for v, k in zip(values, (12.9898, 78.233, 37.719)))
    return np.mod(np.sin(mix) * 43758.5453, 1.0)


class Canvas:
    """Collects weights by spectrum."""

    def __init__(self, rows: int) -> None:
        self.spectra: list[Illuminant] = []
        self.weights: list[Array] = []
        self.shape = (rows, 2 * rows)

    def add(self, spectrum: Illuminant, weight: ArrayLike) -> None:
        self.spectra.append(spectrum)
        self.weights.append(np.broadcast_to(np.asarray(weight, dtype=float), self.shape))

    def finish(self, name: str, floor_luminance: float) -> Environment:
        """Scale to this luminance on white floor paper."""
        raw = Environment(np.stack(self.weights), tuple(self.spectra), name)
        return Environment(raw.weights * (floor_luminance * np.pi / raw.irradiance), raw.spectra, name)


@functools.lru_cache(maxsize=2)
def street(rows: int = ROWS, sun_deg: float = SUN_DEG) -> Environment:
    """A street with brick and plaster houses under a clear sky, sun from one side, about along y."""
    # a camera at the front right looks along the street
    turned = directions(rows)
    c, s = np.cos(np.radians(STREET_TURN_DEG)), np.sin(np.radians(STREET_TURN_DEG))
    x, y, z = c * turned[..., 0] + s * turned[..., 1], c * turned[..., 1] - s * turned[..., 0], turned[..., 2]
    d = np.stack([x, y, z], axis=-1)
    half, eye = 8.5, 1.3
    sun_direction = np.array([-0.52, -0.42, 0.74])
    sun_direction /= np.linalg.norm(sun_direction)
    sun, haze, blue = unit_spectrum("D50"), unit_spectrum("D65"), blue_sky()

    # house front in each direction, and height above the road
    reach = half / np.maximum(np.abs(x), 1e-9)
    along, height = y * reach, z * reach + eye
    side = np.sign(x)
    house = np.floor((along + 3.0 * side) / 11.0)
    tall = 11.0 + 8.0 * _hash(house, side) - 2.0
    far = np.abs(along) > 160.0
    is_front = (height < tall) & ~far & (height > 0)
    is_ground = (z < 0) & ~is_front
    is_sky = ~is_front & ~is_ground

    # sky: haze at the horizon, blue above, a glow round the sun
    up = np.clip(z, 0.0, 1.0)
    to_sun = np.arccos(np.clip(d @ sun_direction, -1, 1))
    glow = 0.55 * np.exp(-to_sun / 0.22) + 0.25 * np.exp(-to_sun / 0.7)
    haze_weight = 0.10 + 0.55 * np.exp(-up / 0.12) + glow
    blue_weight = 0.34 * (1 - 0.75 * np.exp(-up / 0.18)) * (1 + 0.4 * np.cos(to_sun) ** 2)
    disc = (to_sun < np.radians(0.5 * sun_deg)) * (SUN_DEG / sun_deg) ** 2  # constant power

    # irradiance: sun on one side, sky by its visible fraction
    lit_side = side * np.sign(sun_direction[0]) < 0
    reaches = (sun_direction[2] / abs(sun_direction[0])) * 2 * half
    shadow_top = np.maximum(tall - reaches, 0.0) + 2.2 * smooth_step(_hash(house, -side), 0.0, 1.0)
    sun_on_front = np.where(lit_side & (height > shadow_top), abs(sun_direction[0]), 0.0)
    depth = np.clip(height / 14.0, 0.0, 1.0)
    sky_on_front = 0.16 + 0.30 * depth
    ground_x, ground_y = (np.where(is_ground, c * eye / np.maximum(-z, 1e-6), 0.0) for c in (x, y))
    sun_on_ground = np.where(ground_x > -2.5, sun_direction[2], 0.0)

    # windows: dark panes that mirror the sky
    storey, column = np.floor(height / 3.1), np.floor(along / 2.2)
    in_storey, in_column = np.mod(height, 3.1) / 3.1, np.mod(along, 2.2) / 2.2
    pane = (np.abs(in_column - 0.5) < 0.27) & (np.abs(in_storey - 0.55) < 0.29) & is_front
    bars = (np.abs(in_column - 0.5) < 0.015) | (np.abs(in_storey - 0.6) < 0.012)
    pane &= ~bars
    course = 1 - 0.12 * (np.mod(height * 9.0, 1.0) < 0.12)
    mottled = (0.9 + 0.2 * _hash(storey, column, side)) * course
    is_brick = is_front & ~pane & (_hash(house, side + 3.0) < 0.5)
    is_plaster = is_front & ~pane & ~is_brick

    canvas = Canvas(rows)
    power_sun, power_sky = 3.0, 1.0  # irradiances relative to the sky luminance
    for wall, reflectance, name in ((is_brick, BRICK, "brick"), (is_plaster, PLASTER, "plaster")):
        canvas.add(tinted(sun, reflectance, f"{name} in sun"), wall * mottled * sun_on_front * power_sun)
        canvas.add(tinted(blue, reflectance, f"{name} in shade"), wall * mottled * sky_on_front * power_sky)
    # trees along one kerb every 13 m, before the houses
    tree_reach = (half - 2.2) / np.maximum(np.abs(x), 1e-9)
    tree_y, tree_z = y * tree_reach, z * tree_reach + eye
    offset = np.mod(tree_y + 6.5, 13.0) - 6.5
    clump = 1.9 + 0.35 * np.sin(5 * tree_y + 3 * tree_z) + 0.25 * np.sin(9 * tree_z - 4 * tree_y)
    is_tree = (np.hypot(offset, tree_z - 4.6) < clump) & (side > 0) & (np.abs(tree_y) > 4.0) & (np.abs(tree_y) < 80.0)
    leaf_light = 0.35 + 0.65 * _hash(np.floor(tree_y * 6), np.floor(tree_z * 6))
    is_open = np.where(is_tree, 0.0, 1.0)
    canvas.weights = [w * is_open for w in canvas.weights]
    canvas.add(tinted(sun, LEAF, "leaves in sun"), is_tree * leaf_light * 0.62 * power_sun)
    canvas.add(tinted(blue, LEAF, "leaves in shade"), is_tree * 0.5 * power_sky)

    mirrored = np.where(pane, 0.12 + 0.25 * (1 - np.abs(x)) ** 2, 0.0) * is_open
    asphalt = np.where(is_ground, np.where(np.abs(ground_x) < 5.5, 0.13, 0.27), 0.0)
    kerb = 1 - 0.5 * (np.abs(np.abs(ground_x) - 5.5) < 0.08)
    grain = 0.94 + 0.12 * _hash(np.floor(ground_x * 8), np.floor(ground_y * 8))
    ground = asphalt * kerb * np.where(np.hypot(ground_x, ground_y) < 25, grain, 1.0)
    canvas.add(sun, is_sky * is_open * disc * 324.0 + ground * sun_on_ground * power_sun * is_open)
    canvas.add(haze, (is_sky * haze_weight + mirrored * 0.5 + ground * 0.2) * is_open)
    canvas.add(blue, (is_sky * blue_weight + mirrored * 0.35 + ground * 0.35) * is_open)
    return canvas.finish("street under a clear sky: D50 sun, D65 haze, blue sky, brick, plaster, leaves", 0.6)


@functools.lru_cache(maxsize=1)
def interior(rows: int = ROWS) -> Environment:
    """A room by day: two windows with D65 daylight, F11 ceiling panels, a standing lamp with illuminant A."""
    d = directions(rows)
    size = np.array([3.6, 4.4, 1.9])  # half width, half depth, ceiling above the eye
    eye = 1.1
    with np.errstate(divide="ignore", invalid="ignore"):
        t_x, t_y = size[0] / np.abs(d[..., 0]), size[1] / np.abs(d[..., 1])
        t_z = np.where(d[..., 2] > 0, size[2], eye) / np.abs(d[..., 2])
    t = np.minimum(np.minimum(t_x, t_y), t_z)
    p = d * t[..., None]
    on_x, on_y = t_x <= np.minimum(t_y, t_z), (t_y < t_x) & (t_y <= t_z)
    on_z = ~on_x & ~on_y
    normal = np.zeros_like(p)
    for axis, on in enumerate((on_x, on_y, on_z)):
        normal[..., axis] = np.where(on, -np.sign(d[..., axis]), 0.0)

    day, lamp, tube = unit_spectrum("D65"), unit_spectrum("A"), unit_spectrum("F11")
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    window = on_x & (x < 0) & (z > -0.35) & (z < 1.35) & ((np.abs(y - 1.6) < 1.05) | (np.abs(y + 1.6) < 1.05))
    frame = (np.abs(np.mod(y, 1.05) - 0.55) < 0.03) | (np.abs(z - 0.5) < 0.03)
    panel = on_z & (z > 0) & (np.abs(np.abs(x) - 1.4) < 0.16) & (np.abs(np.abs(y) - 1.9) < 0.75)
    shade_at = np.array([2.6, 3.2, 0.35])
    # the standing lamp: a warm cylinder in the far corner
    horizontal = np.hypot(d[..., 0], d[..., 1])
    azimuth = np.arctan2(d[..., 1], d[..., 0]) - np.arctan2(shade_at[1], shade_at[0])
    distance = float(np.hypot(shade_at[0], shade_at[1]))
    lamp_z = d[..., 2] / np.maximum(horizontal, 1e-6) * distance
    shade = (np.abs(azimuth) * distance < 0.26 + 0.05 * (0.35 - lamp_z)) & (np.abs(lamp_z - shade_at[2]) < 0.24)
    post = (np.abs(azimuth) * distance < 0.015) & (lamp_z < shade_at[2]) & (lamp_z > -eye)

    day_light = sum(
        _from_panel(p, normal, _grid_x(-size[0], c, 1.05, 0.5, 0.85), np.array([1.0, 0, 0])) for c in (1.6, -1.6)
    )
    tube_points = [(sx * 1.4, sy * 1.9, size[2]) for sx in (-1, 1) for sy in (-1, 1)]
    tube_light = sum(_from_panel(p, normal, _grid_z(c, 0.16, 0.75), np.array([0.0, 0, -1.0])) for c in tube_points)
    to_lamp = shade_at - p
    r2 = np.maximum((to_lamp**2).sum(-1), 0.08)
    lamp_light = 0.35 * np.clip((to_lamp * normal).sum(-1) / np.sqrt(r2), 0, 1) / r2

    is_floor, is_ceiling = on_z & (d[..., 2] < 0), on_z & (d[..., 2] > 0)
    boards = 0.82 + 0.3 * _hash(np.floor(x / 0.14), np.floor(y / 1.3 + 7 * _hash(np.floor(x / 0.14))))
    boards = boards * (1 - 0.5 * (np.mod(x / 0.14, 1.0) < 0.035))
    cloth = on_y & (y > 0) & (np.abs(x + 0.7) < 1.1) & (z < 0.35) & (z > -0.75)  # a teal hanging
    book = on_x & (x > 0) & (np.abs(y - 0.2) < 1.2) & (z < 0.7)
    spine = 0.25 + 0.9 * _hash(np.floor(y / 0.045), np.floor((z + 1.1) / 0.33))
    spine = spine * (np.mod((z + 1.1) / 0.33, 1.0) > 0.12)
    wall = ~is_floor & ~window & ~panel & ~cloth & ~book
    solid = ~shade
    grey = np.where(wall, np.where(is_ceiling, 0.8, 0.66), 0.0) * solid * np.where(post, 0.2, 1.0)
    outside = window & ~frame

    canvas = Canvas(rows)
    sky_line = 0.5 + 0.5 * smooth_step(z + 0.1 * np.sin(4 * y), -0.1, 0.4)
    d_all, t_all, l_all = day_light + 0.14, 0.55 * tube_light + 0.06, lamp_light + 0.015
    canvas.add(day, (outside * 4.0 * sky_line + (window & frame) * 0.2 + grey * d_all) * solid)
    canvas.add(tube, panel * 5.0 + grey * t_all)
    canvas.add(lamp, shade * 4.0 * (0.6 + 0.4 * smooth_step(-np.abs(lamp_z - shade_at[2]), -0.24, 0.0)) + grey * l_all)
    for spectrum, level in ((day, d_all), (tube, t_all), (lamp, l_all)):
        timber = is_floor * boards + book * spine * 0.7
        canvas.add(tinted(spectrum, WOOD, f"wood in {spectrum.name}"), timber * level * solid)
    folds = 0.75 + 0.25 * np.sin(x * 26.0)
    canvas.add(tinted(day, CLOTH, "cloth in daylight"), cloth * folds * (d_all + t_all) * solid)
    return canvas.finish("room: D65 windows, F11 ceiling panels, a lamp of illuminant A, wood, cloth", 0.6)


def _grid_x(x: float, y: float, half_y: float, z: float, half_z: float) -> Array:
    u = np.linspace(-0.75, 0.75, 3)
    return np.array([(x, y + half_y * a, z + half_z * b) for a in u for b in u])


def _grid_z(centre: tuple[float, float, float], half_x: float, half_y: float) -> Array:
    x, y, z = centre
    return np.array([(x + half_x * a, y + half_y * b, z) for a in (-0.5, 0.5) for b in (-0.7, 0.0, 0.7)])


def _from_panel(p: Array, normal: Array, points: Array, facing: Array) -> Array:
    """Irradiance over pi at `p` from a panel with luminance 4, approximated by a few points."""
    total = np.zeros(p.shape[:-1])
    for point in points:
        to = point - p
        r2 = np.maximum((to**2).sum(-1), 0.15)
        cosines = np.clip((to * normal).sum(-1), 0, None) * np.clip(-(to @ facing), 0, None)
        total += cosines / r2**2
    return total * (1.3 / len(points))


@functools.lru_cache(maxsize=2)
def garden(rows: int = ROWS, sun_deg: float = SUN_DEG) -> Environment:
    """A garden by day: trees and hedges round a lawn under a sky with light clouds, sun on the left."""
    d = directions(rows)
    shape, pixel = d.shape[:2], np.pi / rows
    z = d[..., 2]
    azimuth = np.arctan2(d[..., 1], d[..., 0])
    height = np.arcsin(np.clip(z, -1.0, 1.0))
    sun_direction = np.array(SUN) / np.linalg.norm(SUN)
    to_sun = np.arccos(np.clip(d @ sun_direction, -1.0, 1.0))
    sun, haze, blue = unit_spectrum("D50"), unit_spectrum("D65"), blue_sky()

    def grain(degrees: float, seed: int) -> Array:
        return noise(shape, (np.radians(degrees) / pixel, np.radians(degrees) / pixel), _SEED + seed)

    # three tree rows with uneven crests
    crest = [
        np.radians(base)
        + swell * np.interp(azimuth, *_outline(seed))
        + 0.012 * grain(1.2, seed)
        + 0.006 * grain(0.5, seed + 50)
        for base, swell, seed in ((17.0, 0.16, 1), (9.5, 0.10, 2), (3.4, 0.03, 3))
    ]
    trees = [np.asarray(0.5 + 0.5 * np.tanh((top - height) / (0.6 * pixel + 0.004))) for top in crest]
    far, middle, hedge = trees
    is_lawn = smooth_step(-height, 0.0, 0.006)

    # leaf clumps, lit on the sun side, with shaded gaps between
    clump = grain(2.2, 10) + 0.8 * grain(0.8, 11)
    leaf = grain(0.3, 12)
    lit = np.roll(clump, (-int(0.5 / np.degrees(pixel)), -int(0.6 / np.degrees(pixel))), axis=(0, 1)) - clump
    bright = np.clip(0.5 + 0.28 * lit + 0.22 * clump + 0.14 * leaf, 0.06, 1.6)
    canvas = Canvas(rows)
    sky = (1 - far) * (1 - middle) * (1 - hedge) * (1 - is_lawn)
    up = np.clip(z, 0.0, 1.0)
    cloud = smooth_step(
        noise(shape, (np.radians(5) / pixel, np.radians(14) / pixel), _SEED + 30) + 0.4 * grain(2.5, 31), 0.2, 1.9
    )
    cloud = cloud * smooth_step(up, 0.05, 0.3)
    glow = 0.5 * np.exp(-to_sun / 0.2) + 0.2 * np.exp(-to_sun / 0.7)
    rim = (to_sun - np.radians(0.5 * sun_deg)) / pixel  # soft over a texel
    disc = (0.5 - 0.5 * np.clip(rim, -1.0, 1.0)) * (SUN_DEG / sun_deg) ** 2
    canvas.add(sun, sky * (disc * 250.0 + 0.35 * cloud))
    canvas.add(haze, sky * (0.12 + 0.5 * np.exp(-up / 0.14) + glow + 0.45 * cloud))
    canvas.add(blue, sky * (1 - 0.7 * cloud) * 0.34 * (1 - 0.7 * np.exp(-up / 0.2)))
    in_sun = [far * (1 - middle) * 0.75, middle * (1 - hedge) * 0.9, hedge * 1.1]
    # a shaded wood before the camera is the background for bright objects
    dry = (1 - is_lawn) * (1.0 - 0.72 * np.clip(np.sin(azimuth), 0.0, 1.0) ** 2)
    for share, depth in zip(in_sun, (0.8, 1.0, 1.0), strict=True):
        share = share * dry
        canvas.add(tinted(sun, LEAF, "leaves in sun"), share * bright * 2.1 * depth)
        canvas.add(tinted(sun, THROUGH, "light through leaves"), share * np.clip(bright - 0.75, 0.0, 1.0) * 1.5)
        canvas.add(tinted(blue, LEAF, "leaves in shade"), share * 0.5)
        canvas.add(haze, share * (0.035 if depth < 1 else 0.012))  # haze
    # the lawn, striped by tree shade
    away = 1.3 / np.maximum(np.tan(np.clip(-height, 0.0, 1.5)), 1e-3)
    shade = smooth_step(noise(shape, (np.radians(0.5) / pixel, np.radians(9) / pixel), _SEED + 20), -1.2, 0.5)
    shade = 1 - (1 - shade) * smooth_step(away, 6.0, 30.0)
    blades = 1.0 + 0.1 * grain(0.4, 22)
    canvas.add(
        tinted(sun, 1.15 * LEAF, "lawn in sun"), is_lawn * (0.12 + 0.88 * shade) * 2.2 * sun_direction[2] * blades
    )
    canvas.add(tinted(blue, LEAF, "lawn in shade"), is_lawn * 0.9 * blades)
    return canvas.finish("garden under a sky with clouds: D50 sun, D65 haze, blue sky, leaves", 0.6)


def _outline(seed: int) -> tuple[Array, Array]:
    """Azimuth and height of tree crowns round the horizon."""
    rng = np.random.default_rng(_SEED + seed)
    azimuth = np.linspace(-np.pi, np.pi, 1441)
    height = np.full_like(azimuth, -1.0)
    for _ in range(26):
        centre, half, top = rng.uniform(-np.pi, np.pi), rng.uniform(0.10, 0.24), rng.uniform(-0.4, 1.2)
        distance = np.abs(np.angle(np.exp(1j * (azimuth - centre)))) / half
        height = np.maximum(height, top + 1.2 * (np.sqrt(np.clip(1 - distance**2, 0.0, 1.0)) - 1.0))
    return azimuth, height
