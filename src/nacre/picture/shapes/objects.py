"""Manufactured objects: speedshape, knob, bottle, film in a ring, cuff, strip of balls, camera lens."""

import functools

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import qmc

from nacre.core.arrays import Array
from nacre.picture.shapes import mesh

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
_BLOW_SHARPNESS = 22.0  # of the ridges between blows


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
    whole = _in_row(mesh.parametric(lambda u, v: _BALL * mesh.on_sphere(u + 0.25, v), 160, 80), low)
    uv = [0.5 + 0.5 * whole.vertices[:, 0] / half, 0.5 + 0.5 * (whole.vertices[:, 2] - low) / _BALL]
    return whole.with_uv(np.stack(uv, axis=1))


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
    whole = mesh.merge([face(front, low), face(back, low - edge).turned(), rim])
    return whole.with_uv(0.5 + 0.5 * whole.vertices[:, :2] / radius)


def elements() -> mesh.Mesh:
    """Glass elements of the camera lens; u to the right and v upward over each element."""
    return mesh.merge(
        [_element(0.79, 1.52, 0.30, 0.06), _element(0.62, 1.16, 0.10, -0.14), _element(0.5, 0.55, 0.16, -0.1)]
    )


def barrel() -> mesh.Mesh:
    """Outside with its grip, mouth and floor of the camera lens."""
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
