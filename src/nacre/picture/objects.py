"""Manufactured objects: speedshape, knob, bottle, film in a ring, cuff, strip of balls, camera lens."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import qmc

from nacre.core.arrays import Array
from nacre.picture import mesh
from nacre.picture.printed import text_mask

# speedshape, tail to nose: half width, half height, height of the spine
_SECTIONS = [
    (0.7, 0.34, 0.5), (0.8, 0.42, 0.34), (0.94, 0.54, 0.16), (1.02, 0.66, 0.04), (1.06, 0.74, 0.0), (1.06, 0.76, -0.02),
    (1.0, 0.72, -0.08), (0.92, 0.64, -0.16),
]  # fmt: skip
_HALF_LENGTH = 1.9


def speedshape() -> mesh.Mesh:
    """A smooth, doubly curved body with convex and concave regions and no sharp edge, on z = 0, nose towards +x.

    Paint manufacturers evaluate effect colours on such bodies, which show all angles. u runs from tail to nose, v
    around.
    """

    def position(u: Array, v: Array) -> Array:
        phi = -2 * np.pi * v
        along = -np.cos(np.pi * u)  # denser at the ends, which are round
        swell = np.sin(np.pi * u)
        swell = np.sign(swell) * np.abs(swell) ** 0.8  # blunter ends than those of an ellipsoid
        width, height, spine = np.moveaxis(mesh.bspline(_SECTIONS, 0.5 + 0.5 * along), -1, 0)
        c, s = np.cos(phi), np.sin(phi)
        # a concave flank just above the waist, fading towards the ends
        middle = np.exp(-(((along + 0.12) / 0.55) ** 2))
        waist = 1 - 0.36 * middle * np.exp(-(((s - 0.22) / 0.34) ** 2))
        # a soft crest along the back that turns sideways towards the tail
        off_crest = np.angle(np.exp(1j * (phi - np.pi / 2 - 0.35 * along)))
        crest = 1 + 0.16 * np.exp(-((off_crest / 0.5) ** 2)) * middle
        flatness = 0.81 + 0.19 * np.tanh(2.2 * s)  # the belly is flatter than the back
        return np.stack(
            [_HALF_LENGTH * along, width * swell * waist * c, spine + height * swell * crest * flatness * s], axis=-1
        )

    body = mesh.parametric(position, 420, 320)
    return body.shifted(0.0, 0.0, -body.bounds[0][2])


_KNOB_Z = 1.42
_WINDOW = np.array([0.42, -0.72, 0.55]) / np.linalg.norm([0.42, -0.72, 0.55])  # axis of the dish, towards the camera
_KNOB_FOOT = [
    (0.0, 0.0), (0.5, 0.0), (0.86, 0.0), (0.92, 0.0), (0.955, 0.01), (0.96, 0.05), (0.945, 0.1), (0.9, 0.12),
    (0.78, 0.145), (0.64, 0.19), (0.52, 0.27), (0.47, 0.36), (0.46, 0.44), (0.5, 0.5), (0.53, 0.53), (0.54, 0.56),
    (0.5, 0.6), (0.3, 0.62), (0.0, 0.62),
]  # fmt: skip


def knob() -> mesh.Mesh:
    """A ball of radius 1 with a dish facing the camera and a groove round the dish."""

    def body(x: Array, y: Array, z: Array) -> Array:
        z = z - _KNOB_Z
        radius = np.sqrt(x * x + y * y + z * z)
        along = x * _WINDOW[0] + y * _WINDOW[1] + z * _WINDOW[2]
        across = np.sqrt(np.maximum(radius**2 - along**2, 0.0))
        dish = np.sqrt(across**2 + (along - 1.42) ** 2 + 1e-12) - 0.74
        groove = np.hypot(across - 0.9, along - 0.36) - 0.06
        return mesh.smooth_max(mesh.smooth_max(radius - 1.0, -dish, 0.07), -groove, 0.05)

    def uv(points: Array) -> Array:
        d = points - np.array([0.0, 0.0, _KNOB_Z])
        return np.stack([0.5 + np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi), 0.5 + 0.45 * d[:, 2]], axis=1)

    edge = 1.06
    low = np.array([-edge, -edge, _KNOB_Z - edge])
    return mesh.open_seam(mesh.surface_net(body, low, low + 2 * edge, 0.0175, uv))


def knob_core() -> mesh.Mesh:
    """A bead in the dish that shows interreflection."""
    profile = [(0.2 * np.sin(a), -0.2 * np.cos(a)) for a in np.linspace(0, np.pi, 25)]
    return mesh.revolve(profile, 96, 64).shifted(*(_WINDOW * 0.86 + np.array([0.0, 0.0, _KNOB_Z])))


def knob_foot() -> mesh.Mesh:
    """The turned foot."""
    return mesh.revolve(_KNOB_FOOT, 256, 200)


# (radius, z) in units of the largest half width
_BOTTLE = [
    (0.0, 0.05), (0.3, 0.05), (0.62, 0.02), (0.76, 0.0), (0.86, 0.03), (0.93, 0.12), (0.98, 0.36), (1.0, 0.7),
    (0.99, 1.05), (0.94, 1.36), (0.8, 1.6), (0.56, 1.76), (0.4, 1.84), (0.34, 1.93), (0.335, 2.02), (0.335, 2.1),
    (0.33, 2.13), (0.2, 2.14), (0.0, 2.14),
]  # fmt: skip
_CAP = [
    (0.0, 2.09), (0.3, 2.09), (0.43, 2.09), (0.455, 2.09), (0.462, 2.1), (0.462, 2.13), (0.455, 2.3), (0.435, 2.7),
    (0.415, 3.1), (0.405, 3.25), (0.4, 3.3), (0.36, 3.325), (0.2, 3.33), (0.0, 3.33),
]  # fmt: skip


def bottle() -> mesh.Mesh:
    """A bottle with shoulder and neck, standing on z = 0, closed at the neck."""
    return mesh.revolve(_BOTTLE, 320, 320)


def bottle_cap() -> mesh.Mesh:
    """The cap on the bottle's neck."""
    return mesh.revolve(_CAP, 200, 200)


_RING, _WIRE, _RING_LOW = 1.25, 0.03, 0.62  # radii of ring and wire; height of the lowest point
_RING_LEAN_DEG, _RING_TURN_DEG = 23.0, -24.0  # pose in which the film mirrors the large soft box
_FILM_BULGE = 0.05  # relative to the radius
_RING_FOOT = [(0.0, 0.0), (0.3, 0.0), (0.5, 0.0), (0.52, 0.0), (0.53, 0.03), (0.5, 0.06), (0.3, 0.08), (0.1, 0.1),
              (0.05, 0.16), (0.0, 0.2)]  # fmt: skip


def _leaning(surface: mesh.Mesh) -> mesh.Mesh:
    """Lean a surface about the centre of the ring backward and stand it on its lowest point."""
    lift = _RING_LOW + _RING * float(np.cos(np.radians(_RING_LEAN_DEG)))
    return surface.moved(mesh.rotation("x", -_RING_LEAN_DEG)).moved(
        mesh.rotation("z", _RING_TURN_DEG), (0.0, 0.0, lift)
    )


def film_in_ring() -> mesh.Mesh:
    """A slightly bulged film, as soap films are shown; u to the right and v upward over the whole ring."""

    def position(u: Array, v: Array) -> Array:
        return mesh.on_circle(_RING * v, u, _FILM_BULGE * _RING * (1.0 - v * v))[..., [0, 2, 1]] * [1.0, -1.0, 1.0]

    disc = mesh.parametric(position, 192, 64)
    return _leaning(disc.with_uv(0.5 + 0.5 * disc.vertices[:, [0, 2]] / _RING).turned())  # normals towards the camera


def ring_wire() -> mesh.Mesh:
    """The wire round the film."""

    def position(u: Array, v: Array) -> Array:
        turn = 2 * np.pi * v
        return mesh.on_circle(_RING + _WIRE * np.cos(turn), u, _WIRE * np.sin(turn))[..., [0, 2, 1]]

    return _leaning(mesh.parametric(position, 256, 24).turned())


def ring_stand() -> mesh.Mesh:
    """Rod and foot below the ring."""
    rod = mesh.revolve([(0.9 * _WIRE, z) for z in np.linspace(0.05, _RING_LOW, 6)], 32, 8)
    both = mesh.merge([rod, mesh.revolve(_RING_FOOT, 96, 64)]).shifted(
        0.0, -_RING * np.sin(np.radians(_RING_LEAN_DEG)), 0.0
    )
    return both.moved(mesh.rotation("z", _RING_TURN_DEG))


_CUFF, _CUFF_HALF_HEIGHT, _CUFF_THICKNESS, _CUFF_GAP_DEG = 1.3, 0.62, 0.07, 38.0  # gap at the back
_BLOWS, _BLOW_DEPTH, _BLOW_RADIUS, _BLOW_SEED = 300, 0.022, 0.18, 7
_BLOW_SHARPNESS = 22.0  # sharpness of the ridges between blows


@functools.cache
def _blows() -> cKDTree:
    """Centres of the hammer blows on the unrolled band (Sobol points), repeated beyond both ends."""
    places = qmc.Sobol(2, rng=np.random.default_rng(_BLOW_SEED)).random(512)[:_BLOWS]
    along, height = 2 * np.pi * _CUFF * places[:, 0], (2 * places[:, 1] - 1) * _CUFF_HALF_HEIGHT
    turns = [np.stack([along + 2 * np.pi * _CUFF * turn, height], axis=1) for turn in (-1, 0, 1)]
    return cKDTree(np.concatenate(turns))


def _hammered(phi: Array, z: Array) -> Array:
    """Depth of the hammered surface: soft maximum of the nearest shallow bowls."""
    distance, _ = _blows().query(np.stack([np.mod(phi, 2 * np.pi) * _CUFF, z], axis=-1), k=6)
    bowls = np.maximum(1.0 - (distance / _BLOW_RADIUS) ** 2, -1.0)
    return np.asarray(_BLOW_DEPTH * np.logaddexp.reduce(_BLOW_SHARPNESS * bowls, axis=-1) / _BLOW_SHARPNESS)


def cuff() -> mesh.Mesh:
    """A hammered open band, standing on z = 0; u to the right and v upward on outside (front) and inside (back)."""
    half = np.pi - 0.5 * np.radians(_CUFF_GAP_DEG)

    def place(u: Array, across: Array, is_outside: bool) -> Array:
        # the front is at phi = -90 degrees; the band's section is an oval with round edges
        phi = -0.5 * np.pi + (2 * u - 1) * half
        angle = 0.5 * np.pi * np.clip(across, -1.2, 1.2)
        z = _CUFF_HALF_HEIGHT * np.sin(angle)
        out = _CUFF_THICKNESS * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.35
        radius = _CUFF + (0.5 * out if is_outside else -0.5 * out)
        if is_outside:
            radius = radius - _hammered(phi, z) * np.clip(4.0 * (1.0 - np.abs(across)), 0.0, 1.0)
        oval = 1.0 + 0.06 * np.cos(2 * phi)
        return np.stack([oval * radius * np.cos(phi), radius * np.sin(phi), _CUFF_HALF_HEIGHT + z], axis=-1)

    outside = mesh.parametric(lambda u, v: place(u, 2 * v - 1, True), 720, 180)
    inside = mesh.parametric(lambda u, v: place(1 - u, 2 * v - 1, False), 400, 60)
    return mesh.merge([outside, inside])


BALLS, _BALL, _BALL_DISTANCE, _HOLDER_RIM = 7, 0.42, 0.98, 0.09
_HOLDER = [(0.0, 0.0), (0.24, 0.0), (0.26, 0.0), (0.27, 0.01), (0.26, 0.03), (0.19, 0.05), (0.17, 0.08), (0.175, 0.12),
           (0.165, 0.13), (0.12, 0.12), (0.0, 0.12)]  # fmt: skip


def _in_row(one: mesh.Mesh, z: float) -> mesh.Mesh:
    middles = [(number - 0.5 * (BALLS - 1)) * _BALL_DISTANCE for number in range(BALLS)]
    return mesh.merge([one.shifted(x, 0.0, z) for x in middles])


def balls() -> mesh.Mesh:
    """A strip of balls; u runs over the whole strip and v over each ball, therefore a formula of u is a series."""
    low = _HOLDER_RIM + 0.94 * _BALL
    half = 0.5 * (BALLS - 1) * _BALL_DISTANCE + _BALL
    strip = _in_row(mesh.parametric(lambda u, v: _BALL * mesh.on_sphere(u + 0.25, v), 160, 80), low)
    uv = [0.5 + 0.5 * strip.vertices[:, 0] / half, 0.5 + 0.5 * (strip.vertices[:, 2] - low) / _BALL]
    return strip.with_uv(np.stack(uv, axis=1))


def holders() -> mesh.Mesh:
    """A turned foot below each ball."""
    return _in_row(mesh.revolve(_HOLDER, 96, 80), 0.0)


_BARREL_TOP = 1.72
_BARREL = [
    (0.0, 0.0), (0.86, 0.0), (0.92, 0.0), (0.94, 0.02), (0.94, 0.3), (0.95, 0.34), (1.06, 0.38), (1.06, 0.4),
    (1.06, 0.7), (1.06, 1.0), (1.06, 1.02), (1.0, 1.06), (1.0, 1.1), (1.0, 1.5), (1.02, 1.56), (1.02, 1.66),
    (1.02, _BARREL_TOP), (1.02, _BARREL_TOP), (0.985, _BARREL_TOP + 0.01), (0.94, _BARREL_TOP),
    (0.93, _BARREL_TOP - 0.03),
]  # fmt: skip
_MOUTH = [(0.5, 0.6), (0.52, 0.62), (0.6, 0.8), (0.66, 1.1), (0.74, 1.25), (0.78, 1.4), (0.8, 1.5), (0.81, 1.54)]
_GRIP_RIBS, _APERTURE_BLADES = 60, 7


def _element(radius: float, low: float, front: float, back: float) -> mesh.Mesh:
    """A lens about the z axis, its rim at height `low`, with sagittas of the front and the back face."""
    edge = 0.05

    def face(sag: float, height: float) -> mesh.Mesh:
        return mesh.parametric(
            lambda u, v: mesh.on_circle(radius * v, u, height + sag * (1 - v * v)), 160, 48
        ).facing_up()

    rim = mesh.parametric(lambda u, v: mesh.on_circle(radius, u, low + edge * (v - 1)), 160, 2)
    lens = mesh.merge([face(front, low), face(back, low - edge).turned(), rim])
    return lens.with_uv(0.5 + 0.5 * lens.vertices[:, :2] / radius)


def elements() -> mesh.Mesh:
    """Glass elements of the camera lens; u to the right and v upward over each element."""
    return mesh.merge(
        [_element(0.79, 1.52, 0.30, 0.06), _element(0.62, 1.16, 0.10, -0.14), _element(0.5, 0.55, 0.16, -0.1)]
    )


def barrel() -> mesh.Mesh:
    """Camera lens barrel: outside with grip ribs, mouth and floor."""
    rib = mesh.revolve([(0.026, 0.0), (0.026, 0.1), (0.026, 0.5), (0.026, 0.56), (0.0, 0.58)], 12, 12)
    angles = [2 * np.pi * number / _GRIP_RIBS for number in range(_GRIP_RIBS)]
    ribs = [rib.shifted(1.06 * np.cos(angle), 1.06 * np.sin(angle), 0.41) for angle in angles]
    floor = mesh.revolve([(0.0, 0.3), (0.3, 0.3), (0.55, 0.3), (0.56, 0.35)], 64, 24)
    return mesh.merge([mesh.revolve(_BARREL, 256, 320), mesh.revolve(_MOUTH, 192, 160).turned(), floor, *ribs])


def name_ring() -> mesh.Mesh:
    """The ring round the front element, sloping inward; u to the right and v upward over it."""
    ring = mesh.parametric(lambda u, v: mesh.on_circle(0.81 + 0.125 * v, u, 1.55 + 0.14 * v), 192, 8).facing_up()
    return ring.with_uv(0.5 + 0.5 * ring.vertices[:, :2] / 0.94)


def ring_print(rows: int = 1200) -> Array:
    """Reflectance `[row, column]` of the name ring, first row at the top: words along the circle."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("L", (rows, rows), 0)
    size = int(0.052 * rows)
    font = ImageFont.load_default(size)
    letters = 2 * "NACRE OPTICS   NACRINON  1:1.4 / 50 mm   \u00d8 55     "
    radius = 0.5 * rows * 0.871 / 0.94
    for number, letter in enumerate(letters):
        stamp = Image.new("L", (2 * size, 2 * size), 0)
        draw = ImageDraw.Draw(stamp)
        draw.text((size - 0.5 * draw.textlength(letter, font=font), 0.45 * size), letter, fill=255, font=font)
        angle = number * (2 * np.pi / len(letters)) + np.pi  # clockwise from below
        turned = stamp.rotate(-np.degrees(angle), resample=Image.Resampling.BICUBIC)
        left, top = int(0.5 * rows + radius * np.sin(angle)) - size, int(0.5 * rows - radius * np.cos(angle)) - size
        image.paste(255, (left, top, left + 2 * size, top + 2 * size), turned)
    return np.asarray(0.012 + 0.6 * np.asarray(image, dtype=float) / 255.0)


def blades() -> mesh.Mesh:
    """The stopped-down iris: a dark disc with a seven-sided opening."""

    def position(u: Array, v: Array) -> Array:
        side = 2 * np.pi / _APERTURE_BLADES
        along = np.mod(2 * np.pi * u, side)
        inner = 0.24 / np.cos(along - 0.5 * side)
        return mesh.on_circle(inner + (0.56 - inner) * v, u, 0.74 + 0.02 * along / side * v)

    return mesh.parametric(position, 280, 6).facing_up()


# A small coupé, closed and smooth, with glass, wheels, rims and details.
#
# The hull is an implicit body between drawn silhouettes (plan, deck line, roof line: B-splines) with superelliptic
# sections. Wheel arches are subtracted with rounded edges; panes are cut along exact lines. x runs from tail to nose;
# lengths are in metres.

FRONT_AXLE, REAR_AXLE = 1.32, -1.30
WHEEL_RADIUS, WHEEL_WIDTH, TRACK = 0.33, 0.23, 0.80
_ARCH = 0.362
_SILL = 0.17
_SHUT_LINE = 0.0048  # half width

# silhouettes (x, value); `_hull` closes the ends
_DECK = [(-2.3, 0.80), (-2.1, 0.885), (-1.8, 0.915), (-1.3, 0.925), (-0.6, 0.875), (0.1, 0.85), (0.7, 0.845),
         (1.2, 0.845), (1.6, 0.785), (1.95, 0.675), (2.2, 0.585), (2.35, 0.53)]  # fmt: skip
_PLAN = [(-2.3, 0.76), (-2.1, 0.82), (-1.7, 0.905), (-1.3, 0.945), (-0.8, 0.92), (-0.1, 0.885), (0.6, 0.885),
         (1.1, 0.925), (1.45, 0.935), (1.8, 0.885), (2.05, 0.79), (2.3, 0.66)]  # fmt: skip
_ROOF = [(-2.7, 0.2), (-2.3, 0.66), (-2.0, 0.86), (-1.6, 1.00), (-1.1, 1.15), (-0.65, 1.245), (-0.2, 1.275),
         (0.15, 1.25), (0.5, 1.12), (0.85, 0.96), (1.2, 0.81), (1.5, 0.68), (1.95, 0.2)]  # fmt: skip
_CABIN = [(-2.1, 0.42), (-1.7, 0.58), (-1.2, 0.70), (-0.6, 0.765), (0.0, 0.775), (0.5, 0.745), (0.9, 0.68), (1.3, 0.56)]
# shut lines as (x, z) on the flank
_DOOR = [
    (0.70, 0.93), (0.73, 0.82), (0.75, 0.62), (0.72, 0.36), (0.68, 0.27), (0.6, 0.25), (0.2, 0.245), (-0.3, 0.25),
    (-0.52, 0.27), (-0.6, 0.36), (-0.64, 0.55), (-0.66, 0.75), (-0.7, 0.96),
]  # fmt: skip
_FLAP = [(-1.06, 0.80), (-1.06, 0.86), (-1.16, 0.86), (-1.26, 0.86), (-1.26, 0.80), (-1.26, 0.74),
                 (-1.16, 0.74), (-1.06, 0.74), (-1.06, 0.80)]  # fmt: skip
# shut lines as (x, y) seen from above, right half
_BONNET = [(0.98, 0.66), (1.2, 0.685), (1.55, 0.66), (1.85, 0.58), (2.02, 0.44), (2.1, 0.24), (2.12, 0.0)]
_BOOT = [(-1.72, 0.0), (-1.72, 0.3), (-1.73, 0.55), (-1.78, 0.66), (-1.9, 0.71), (-2.08, 0.72)]


def _cabin(x: Array, y: Array, z: Array) -> Array:
    """Greenhouse: walls lean inward by 0.42 of their height; the roof is cambered."""
    roof = mesh.curve(_ROOF, x) - 0.10 * (y / 0.7) ** 2
    wall = mesh.curve(_CABIN, x) - 0.42 * (z - 0.85)
    top = 0.92 * (z - roof)
    side = 0.92 * (np.abs(y) - wall)
    return mesh.smooth_max(mesh.smooth_max(top, side, 0.22), 0.55 - z, 0.05)


def _hull(x: Array, y: Array, z: Array) -> Array:
    deck, plan = mesh.curve(_DECK, x), mesh.curve(_PLAN, x)
    middle, half = 0.5 * (deck + _SILL), 0.5 * (deck - _SILL)
    section = mesh.superellipse(y / plan, (z - middle) / half, 4.0)
    shell = (section - 1) * np.minimum(plan, half)
    shell = shell + 0.05 * np.clip((0.55 - z) / 0.4, 0, 1) ** 2  # flanks taper towards the sill
    # nose and tail: curved in plan, raked in side view
    nose = 0.9 * (x + 0.34 * np.abs(y) ** 2.2 + 0.22 * (z - 0.42) ** 2 / 0.2 - 2.24)
    tail = 0.95 * (-x + 0.16 * np.abs(y) ** 2.2 + 0.18 * (z - 0.80) - 2.12)
    shell = mesh.smooth_max(mesh.smooth_max(shell, nose, 0.30), tail, 0.13)
    # fenders
    for axle, swell in ((FRONT_AXLE, 0.04), (REAR_AXLE, 0.045)):
        over = np.exp(-(((x - axle) / 0.45) ** 2))
        shell = shell - swell * over * np.exp(-(((z - 0.55) / 0.28) ** 2))
        shell = shell - 0.05 * over * np.exp(-(((np.abs(y) - 0.78) / 0.2) ** 2) - ((z - 0.78) / 0.15) ** 2)
    car = mesh.smooth_min(shell, mesh.smooth_max(_cabin(x, y, z), tail + 0.06, 0.1), 0.16)
    for axle in (FRONT_AXLE, REAR_AXLE):
        well = np.hypot(x - axle, z - WHEEL_RADIUS) - _ARCH
        well = mesh.smooth_max(well, 0.56 - np.abs(y), 0.05)
        car = mesh.smooth_max(car, -well, 0.06)
    return car


def _uv(points: Array) -> Array:
    """u along the car, v by the azimuth in its section, therefore tangents run along the body."""
    return np.stack(
        [(points[:, 0] + 2.3) / 4.6, 0.5 + np.arctan2(points[:, 1], points[:, 2] - 0.1) / np.pi * 0.5], axis=1
    )


def car(spacing: float = 0.0225) -> dict[str, mesh.Mesh]:
    """Build the parts, standing on z = 0; the material goes on `paint` and `mirrors`."""
    hull = mesh.surface_net(_hull, np.array([-2.5, -1.08, 0.05]), np.array([2.5, 1.08, 1.42]), spacing, _uv)
    cut = {}
    for name, field in (("glass", _panes), ("lamps", _lamp_field), ("trim", _trim_field)):
        cut[name], hull = mesh.split(hull, field(hull.vertices, hull.normals))
    mirrors = _mirrors()
    return {
        "paint": hull,
        **cut,
        "tyres": _at_wheels(_tyre()),
        "rims": _at_wheels(_rim()),
        "mirrors": mirrors.with_uv(_uv(mirrors.vertices)),
        "seams": _shut_lines(),
        "handles": _handles(),
        "plate": _plate(),
    }


def _at_wheels(part: mesh.Mesh) -> mesh.Mesh:
    """Copy a part, whose wheel axis is z, to the four wheels."""
    places = [(axle, side) for axle in (FRONT_AXLE, REAR_AXLE) for side in (1, -1)]
    return mesh.merge(
        [part.moved(mesh.rotation("x", -90.0 * s)).shifted(axle, s * TRACK, WHEEL_RADIUS) for axle, s in places]
    )


def _panes(p: Array, n: Array) -> Array:
    """Positive on side windows, windscreen and rear window."""
    x, y, z = p.T
    wide = np.abs(y)
    belt = mesh.curve([(-2.0, 0.985), (-1.2, 0.985), (-0.4, 0.955), (0.4, 0.925), (1.2, 0.89)], x)
    rail = mesh.curve(_ROOF, x) - 0.075
    side = -mesh.smooth_max(belt - z, z - rail, 0.03)
    side = -mesh.smooth_max(-side, _pillar(x, z, 0.64, -1.15), 0.05)  # A pillar
    side = -mesh.smooth_max(-side, -_pillar(x, z, -1.22, 0.75), 0.10)  # C pillar
    side = -mesh.smooth_max(-side, 0.45 - wide, 0.02)
    screen = -mesh.smooth_max(wide - (mesh.curve(_CABIN, x) - 0.42 * (z - 0.85) - 0.075), 0.885 - z, 0.05)
    screen = -mesh.smooth_max(-screen, 0.22 + 0.10 * wide**2 - x, 0.05)
    rear = -mesh.smooth_max(wide - (mesh.curve(_CABIN, x) - 0.42 * (z - 0.85) - 0.10), x + 0.86 - 0.10 * wide**2, 0.05)
    rear = -mesh.smooth_max(-rear, -1.62 - x + 0.05 * wide**2, 0.05)
    rear = np.where(n[:, 2] > 0.25, rear, -1.0)
    return np.maximum(np.maximum(side, screen), rear)


def _pillar(x: Array, z: Array, foot: float, lean: float) -> Array:
    """Signed distance in x from a line that starts at `foot` on the belt and shifts by `lean` per metre of height."""
    return (x - foot - lean * (z - 0.9)) * 0.7


def _lamp_field(p: Array, n: Array) -> Array:
    """Positive on head lamps and rear lamps."""
    x, y, z = p.T
    wide = np.abs(y)
    front = 0.026 - np.abs(z - 0.60 - 0.10 * (wide - 0.55)) - 1.2 * np.maximum(np.abs(wide - 0.58) - 0.11, 0) ** 1.5
    front = np.where(x > 1.6, np.minimum(front, 0.5 * (x - 1.74)), -1.0)
    rear = 0.022 - np.abs(z - 0.755) - np.maximum(wide - 0.64, 0)
    return np.maximum(front, np.where((x < -1.9) & (n[:, 0] < -0.3), rear, -1.0))


def _trim_field(p: Array, n: Array) -> Array:
    """Positive on dark trim: underbody, wheel wells, air intake, rear apron."""
    x, y, z = p.T
    wide = np.abs(y)
    under = 0.215 - z
    well = np.full_like(x, -1.0)
    for axle in (FRONT_AXLE, REAR_AXLE):
        well = np.maximum(well, np.where(z < 0.85, _ARCH - 0.004 - np.hypot(x - axle, z - WHEEL_RADIUS), -1.0))
    intake = -mesh.smooth_max(np.abs(z - 0.335) - 0.07, wide - 0.52 + 0.5 * np.abs(z - 0.335), 0.03)
    intake = np.where(x > 1.9, intake, -1.0)
    apron = np.where((x < -1.9) & (n[:, 0] < 0), -mesh.smooth_max(z - 0.40, wide - 0.60, 0.05), -1.0)
    return np.maximum(np.maximum(under, well), np.maximum(intake, apron))


def _tyre() -> mesh.Mesh:
    """A tyre about the z axis, outer face up."""
    w, r = 0.5 * WHEEL_WIDTH, WHEEL_RADIUS
    profile = [
        (0.0, -w), (0.1, -w), (0.235, -w), (0.25, -w), (0.29, -w - 0.008), (r - 0.015, -w + 0.01), (r, -w + 0.04),
        (r, -0.3 * w), (r, 0.3 * w), (r, w - 0.04), (r - 0.015, w - 0.01), (0.29, w + 0.008), (0.256, w),
        (0.25, w - 0.005), (0.246, w - 0.03), (0.24, w - 0.09), (0.1, w - 0.10), (0.0, w - 0.10),
    ]  # fmt: skip
    return mesh.revolve(profile, 128, 160)


def _rim() -> mesh.Mesh:
    """Five twin spokes, a lip and a hub about the z axis, outer face up."""
    top = 0.5 * WHEEL_WIDTH
    lip_angle = np.linspace(0, 2 * np.pi, 17)
    lip = mesh.revolve(
        [(0.248 + 0.011 * np.cos(a), top - 0.004 + 0.011 * np.sin(a)) for a in lip_angle - np.pi], 128, 32
    )
    profile = ((0.0, 0.09), (0.05, 0.09), (0.062, 0.06), (0.058, 0.03), (0.04, 0.02), (0.0, 0.018))
    hub = mesh.revolve([(radius, top - below) for radius, below in profile], 48, 32)
    spokes = [_spoke(lean).moved(mesh.rotation("z", 72.0 * k)) for k in range(5) for lean in (-1, 1)]
    return mesh.merge([lip, hub, *spokes])


def _spoke(lean: int) -> mesh.Mesh:
    top = 0.5 * WHEEL_WIDTH

    def position(u: Array, v: Array) -> Array:
        along = -np.cos(np.pi * v)
        swell = np.abs(np.sin(np.pi * v)) ** 0.25 * np.sign(np.sin(np.pi * v))
        r = 0.145 + 0.108 * along
        c, s = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
        soft = (c**4 + s**4) ** 0.25  # a rounded square section
        side = lean * (0.020 + 0.022 * (along + 1)) + 0.013 * swell * c / soft
        height = top - 0.032 + 0.026 * ((along + 1) / 2) ** 2 + 0.014 * swell * s / soft
        return np.stack([r, side, height], axis=-1)

    return mesh.parametric(position, 32, 40)


def _shut_lines() -> mesh.Mesh:
    """Gaps between doors, bonnet, boot lid and body: dark threads half sunk into the hull."""
    t = np.linspace(0.0, 1.0, 90)
    lines = []
    for points, on_hull in ((_DOOR, _on_flank), (_FLAP, _on_flank), (_BONNET, _on_top), (_BOOT, _on_top)):
        right = on_hull(*np.moveaxis(mesh.bspline(points, t), -1, 0))
        lines += [right] if points is _FLAP else [right, right * [1.0, -1.0, 1.0]]
    return mesh.merge([mesh.tube(path, np.full(len(path), _SHUT_LINE), 10) for path in lines])


def _both_sides(right: mesh.Mesh) -> mesh.Mesh:
    return mesh.merge([right, right.moved(np.diag([1.0, -1.0, 1.0]))])


def _mirrors() -> mesh.Mesh:
    """Housings of the two mirrors with their arms."""
    place = _on_flank(np.array([0.60]), np.array([0.86]))[0]

    def position(u: Array, v: Array) -> Array:
        ball = mesh.on_sphere(u, v)
        soft = np.sign(ball) * np.abs(ball) ** 0.72
        size = np.array([0.075, 0.12, 0.072])
        back = np.where(soft[..., 0] < 0, 0.45, 1.0)[..., None] * np.array([1.0, 0, 0]) + np.array([0, 1.0, 1.0])
        swept = np.array([-0.25, 0.0, 0.0]) * soft[..., 1:2] * 0.12
        return place + np.array([0.0, 0.15, 0.1]) + size * soft * back + swept

    joints = place + np.array([[0.02, -0.03, -0.02], [0.02, 0.05, 0.03], [0.01, 0.12, 0.06]])
    arm = mesh.tube(mesh.bspline(joints, np.linspace(0, 1, 8)), np.linspace(0.028, 0.02, 8), 16)
    return _both_sides(mesh.merge([mesh.parametric(position, 72, 48), arm]))


def _handles() -> mesh.Mesh:
    """Door handles."""
    x = np.linspace(-0.3, -0.5, 12)
    path = _on_flank(x, np.full_like(x, 0.775)) + np.array([0.0, 0.016, 0.0])
    ends = np.clip(6 * np.sin(np.pi * np.linspace(0.0, 1.0, 12)), 0.25, 1.0)
    return _both_sides(mesh.tube(path, 0.013 * ends, 16))


def _plate() -> mesh.Mesh:
    """Front number plate, curved like the nose; u to the right for the reader, v upward."""

    def position(u: Array, v: Array) -> Array:
        y, z = 0.25 * (2 * u - 1), 0.42 + 0.055 * (2 * v - 1)
        return np.stack([2.268 - 0.12 * y**2, y, z], axis=-1)

    return mesh.parametric(position, 12, 2)


def plate_print(rows: int = 128) -> Array:
    """Reflectance `[row, column]` of the number plate, first row at the top."""
    columns = int(rows * 0.25 / 0.055)
    frame = [((3, 3, columns - 4, rows - 4), 3)]
    return 0.03 + 0.62 * text_mask((rows, columns), [("NACRE 550", (None, 0.06 * rows), 0.8 * rows)], frame, paper=255)


def _on_flank(x: Array, z: Array) -> Array:
    """Points `[N, 3]` on the left flank (y > 0) at places in the side view."""
    y = _bisect(lambda y: _hull(x, y, z), np.full_like(x, 0.25), np.full_like(x, 1.2))
    return np.stack([x, y, z], axis=-1)


def _on_top(x: Array, y: Array) -> Array:
    z = _bisect(lambda z: _hull(x, y, z), np.full_like(x, 0.45), np.full_like(x, 1.6))
    return np.stack([x, y, z], axis=-1)


def _bisect(f: Callable[[Array], Array], inside: Array, outside: Array) -> Array:
    for _ in range(30):
        middle = 0.5 * (inside + outside)
        is_out = f(middle) > 0
        inside, outside = np.where(is_out, inside, middle), np.where(is_out, middle, outside)
    return np.asarray(0.5 * (inside + outside))
