"""The speedshape: one smooth, doubly curved body with bulging and hollow regions and no sharp edge.

Paint manufacturers judge effect colours on such bodies, since all angles occur on them and change slowly.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import qmc

from nacre.picture.shapes.implicit import smooth_max, surface_net
from nacre.picture.shapes.mesh import Array, Mesh, bspline, merge, open_seam, parametric, revolve, rotation

# along the body, tail to nose: half width, half height, spine height, spine sideways
_WIDTH = [0.7, 0.8, 0.94, 1.02, 1.06, 1.06, 1.0, 0.92]
_HEIGHT = [0.34, 0.42, 0.54, 0.66, 0.74, 0.76, 0.72, 0.64]
_SPINE_Z = [0.5, 0.34, 0.16, 0.04, 0.0, -0.02, -0.08, -0.16]
_HALF_LENGTH = 1.9


def speedshape() -> Mesh:
    """The body, resting on z = 0, its nose towards +x; u runs from tail to nose, v around."""

    def position(u: Array, v: Array) -> Array:
        phi = -2 * np.pi * v
        along = -np.cos(np.pi * u)  # crowds the ends, so that they close round
        swell = np.sin(np.pi * u)
        swell = np.sign(swell) * np.abs(swell) ** 0.8  # blunter ends than an ellipsoid's
        table = bspline(np.stack([_WIDTH, _HEIGHT, _SPINE_Z], axis=1), 0.5 + 0.5 * along)
        width, height, spine = table[..., 0], table[..., 1], table[..., 2]
        c, s = np.cos(phi), np.sin(phi)
        # a hollow flank just above the waist, fading to nothing towards both ends
        middle = np.exp(-(((along + 0.12) / 0.55) ** 2))
        waist = 1 - 0.36 * middle * np.exp(-(((s - 0.22) / 0.34) ** 2))
        # a soft crest runs along the back and sweeps sideways towards the tail
        off_crest = np.angle(np.exp(1j * (phi - np.pi / 2 - 0.35 * along)))
        crest = 1 + 0.16 * np.exp(-((off_crest / 0.5) ** 2)) * middle
        flatness = 0.81 + 0.19 * np.tanh(2.2 * s)  # the belly is flatter than the back
        return np.stack(
            [_HALF_LENGTH * along, width * swell * waist * c, spine + height * swell * crest * flatness * s], axis=-1
        )

    body = parametric(position, 420, 320)
    low, _ = body.bounds
    return body.moved(np.eye(3), (0.0, 0.0, -low[2]))


# The knob: a ball with a dished window and a groove on a turned foot, with convex and concave regions and edges.

_CENTRE_Z = 1.42
_AXIS = np.array([0.42, -0.72, 0.55]) / np.linalg.norm([0.42, -0.72, 0.55])  # the window looks up to the camera
_FOOT = [
    (0.0, 0.0), (0.5, 0.0), (0.86, 0.0), (0.92, 0.0), (0.955, 0.01), (0.96, 0.05), (0.945, 0.1), (0.9, 0.12),
    (0.78, 0.145), (0.64, 0.19), (0.52, 0.27), (0.47, 0.36), (0.46, 0.44), (0.5, 0.5), (0.53, 0.53), (0.54, 0.56),
    (0.5, 0.6), (0.3, 0.62), (0.0, 0.62),
]  # fmt: skip


def knob() -> Mesh:
    """The ball: a sphere of radius 1 with a dish facing the camera and a groove round its waist."""

    def body(x: Array, y: Array, z: Array) -> Array:
        z = z - _CENTRE_Z
        radius = np.sqrt(x * x + y * y + z * z)
        ball = radius - 1.0
        along = x * _AXIS[0] + y * _AXIS[1] + z * _AXIS[2]
        across = np.sqrt(np.maximum(radius**2 - along**2, 0.0))
        # the dish: a shallow larger sphere carved from outside along the axis
        dish = np.sqrt(across**2 + (along - 1.42) ** 2 + 1e-12) - 0.74
        # a groove round the dish, as a collar between the dish and the ball
        groove = np.hypot(across - 0.9, along - 0.36) - 0.06
        return smooth_max(smooth_max(ball, -dish, 0.07), -groove, 0.05)

    def uv(points: Array) -> Array:
        d = points - np.array([0.0, 0.0, _CENTRE_Z])
        return np.stack([0.5 + np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi), 0.5 + 0.45 * d[:, 2]], axis=1)

    edge = 1.06
    low = np.array([-edge, -edge, _CENTRE_Z - edge])
    return open_seam(surface_net(body, low, low + 2 * edge, 0.0175, uv))


def knob_core() -> Mesh:
    """The bead that rests in the dish: it shows interreflection with the carved face."""
    profile = [(0.2 * np.sin(a), -0.2 * np.cos(a)) for a in np.linspace(0, np.pi, 25)]
    return revolve(profile, 96, 64).moved(np.eye(3), _AXIS * 0.86 + np.array([0.0, 0.0, _CENTRE_Z]))


def knob_foot() -> Mesh:
    """The turned foot."""
    return revolve(_FOOT, 256, 200)


# A bottle with shoulder, neck and cap: a surface of revolution, as nail lacquer and perfume are sold in.

# (radius, z) in units of the bottle's greatest half width; doubled points tighten an edge to a small radius
_GLASS = [
    (0.0, 0.05), (0.3, 0.05), (0.62, 0.02), (0.76, 0.0), (0.86, 0.03), (0.93, 0.12), (0.98, 0.36), (1.0, 0.7),
    (0.99, 1.05), (0.94, 1.36), (0.8, 1.6), (0.56, 1.76), (0.4, 1.84), (0.34, 1.93), (0.335, 2.02), (0.335, 2.1),
    (0.33, 2.13), (0.2, 2.14), (0.0, 2.14),
]  # fmt: skip
_CAP = [
    (0.0, 2.09), (0.3, 2.09), (0.43, 2.09), (0.455, 2.09), (0.462, 2.1), (0.462, 2.13), (0.455, 2.3), (0.435, 2.7),
    (0.415, 3.1), (0.405, 3.25), (0.4, 3.3), (0.36, 3.325), (0.2, 3.33), (0.0, 3.33),
]  # fmt: skip


def bottle() -> Mesh:
    """The bottle's body, standing on z = 0, closed at the neck."""
    return revolve(_GLASS, 320, 320)


def bottle_cap() -> Mesh:
    """The cap that sits on the neck."""
    return revolve(_CAP, 200, 200)


# A film in a ring of wire on a stand, as soap films are shown: u to the right and v upward over the whole ring.

_RADIUS, _WIRE, _LOW = 1.25, 0.03, 0.62  # the ring stands on its rod at this height
_LEAN_DEG = 23.0  # backward, so that the film mirrors what is above the camera
_COS = float(np.cos(np.radians(_LEAN_DEG)))
_BULGE = 0.05  # of the radius: a breath of air


def _leaning(surface: Mesh) -> Mesh:
    """A surface about the ring's middle, leant back, standing on its lowest point."""
    return surface.moved(rotation("x", -_LEAN_DEG)).moved(np.eye(3), (0.0, 0.0, _LOW + _RADIUS * _COS))


def film_in_ring() -> Mesh:
    """The film: a disc that faces the camera, a little bulged."""

    def position(u: Array, v: Array) -> Array:
        radius, phi = _RADIUS * v, 2 * np.pi * u
        bulge = -_BULGE * _RADIUS * (1.0 - v * v)
        return np.stack([radius * np.cos(phi), bulge, radius * np.sin(phi)], axis=-1)

    disc = parametric(position, 192, 64)
    uv = 0.5 + 0.5 * disc.vertices[:, [0, 2]] / _RADIUS
    return _leaning(Mesh(disc.vertices, disc.normals, uv, disc.faces).turned())  # its normals to the camera


def ring_wire() -> Mesh:
    """The wire round the film."""

    def position(u: Array, v: Array) -> Array:
        phi, turn = 2 * np.pi * u, 2 * np.pi * v
        radius = _RADIUS + _WIRE * np.cos(turn)
        return np.stack([radius * np.cos(phi), _WIRE * np.sin(turn), radius * np.sin(phi)], axis=-1)

    return _leaning(parametric(position, 256, 24).turned())  # its normals outward


def ring_stand() -> Mesh:
    """The rod that the ring stands on, and its foot."""
    back = _RADIUS * np.sin(np.radians(_LEAN_DEG))
    rod = revolve([(0.9 * _WIRE, z) for z in np.linspace(0.05, _LOW, 6)], 32, 8).moved(np.eye(3), (0.0, -back, 0.0))
    foot = revolve([(0.0, 0.0), (0.3, 0.0), (0.5, 0.0), (0.52, 0.0), (0.53, 0.03), (0.5, 0.06), (0.3, 0.08),
                    (0.1, 0.1), (0.05, 0.16), (0.0, 0.2)], 96, 64)  # fmt: skip
    return merge([rod, foot.moved(np.eye(3), (0.0, -back, 0.0))])


__all__ = ["film_in_ring", "ring_stand", "ring_wire"]


# A hammered cuff, as jewellers anodise them: a wide open band, its outside beaten into facets.

_RADIUS_cuff, _HALF_HEIGHT, _THICKNESS = 1.3, 0.62, 0.07
_GAP_DEG = 38.0  # open at the back
_BLOWS, _DEPTH, _BOWL, _SEED = 300, 0.022, 0.18, 7
_NEAREST, _EDGE = 6, 22.0  # bowls that matter at a place, and how sharp the ridges between them are


@functools.cache
def _blows() -> cKDTree:
    """Where the hammer fell, on the unrolled band: evenly but not regularly, and once more beyond either end."""
    places = qmc.Sobol(2, rng=np.random.default_rng(_SEED)).random(512)[:_BLOWS]
    along, height = 2 * np.pi * _RADIUS_cuff * places[:, 0], (2 * places[:, 1] - 1) * _HALF_HEIGHT
    turns = [np.stack([along + 2 * np.pi * _RADIUS_cuff * turn, height], axis=1) for turn in (-1, 0, 1)]
    return cKDTree(np.concatenate(turns))


def _hammered(phi: Array, z: Array) -> Array:
    """How far the surface is beaten in: of the shallow bowls about it the deepest, with soft ridges between."""
    along = np.mod(phi, 2 * np.pi) * _RADIUS_cuff
    away, _ = _blows().query(np.stack([along, z], axis=-1), k=_NEAREST)
    bowls = np.maximum(1.0 - (away / _BOWL) ** 2, -1.0)
    return np.asarray(_DEPTH * np.logaddexp.reduce(_EDGE * bowls, axis=-1) / _EDGE)


def cuff() -> Mesh:
    """The band, standing on z = 0."""
    half = np.pi - 0.5 * np.radians(_GAP_DEG)

    def place(u: Array, across: Array, is_outside: bool) -> Array:
        # the front lies at phi = -90 degrees; the band's section is an oval, its edges round
        phi = -0.5 * np.pi + (2 * u - 1) * half
        angle = 0.5 * np.pi * np.clip(across, -1.2, 1.2)
        z = _HALF_HEIGHT * np.sin(angle)
        out = _THICKNESS * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.35
        radius = _RADIUS_cuff + (0.5 * out if is_outside else -0.5 * out)
        if is_outside:
            radius = radius - _hammered(phi, z) * np.clip(4.0 * (1.0 - np.abs(across)), 0.0, 1.0)
        oval = 1.0 + 0.06 * np.cos(2 * phi)
        return np.stack([oval * radius * np.cos(phi), radius * np.sin(phi), _HALF_HEIGHT + z], axis=-1)

    outside = parametric(lambda u, v: place(u, 2 * v - 1, True), 720, 180)
    inside = parametric(lambda u, v: place(1 - u, 2 * v - 1, False), 400, 60)
    return merge([outside, inside])


__all__ = ["cuff"]


# A strip of balls in a tray, as makers of pigments and coatings show a series side by side.

BALLS, _RADIUS_strip, _APART = 7, 0.42, 0.98
_RIM = 0.09  # height of the tray's holders


def _middle(number: int) -> float:
    return (number - 0.5 * (BALLS - 1)) * _APART


def balls() -> Mesh:
    """What takes the material."""

    def position(u: Array, v: Array) -> Array:
        phi, theta = 2 * np.pi * (u + 0.25), np.pi * (1 - v)
        ball = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        return np.asarray(_RADIUS_strip * ball)

    one = parametric(position, 160, 80)
    low = _RIM + 0.94 * _RADIUS_strip
    half = 0.5 * (BALLS - 1) * _APART + _RADIUS_strip
    whole = merge([one.moved(np.eye(3), (_middle(number), 0.0, low)) for number in range(BALLS)])
    uv = np.stack(
        [0.5 + 0.5 * whole.vertices[:, 0] / half, 0.5 + 0.5 * (whole.vertices[:, 2] - low) / _RADIUS_strip], axis=1
    )
    return Mesh(whole.vertices, whole.normals, uv, whole.faces)


def holders() -> Mesh:
    """A turned foot below each ball."""
    profile = [(0.0, 0.0), (0.24, 0.0), (0.26, 0.0), (0.27, 0.01), (0.26, 0.03), (0.19, 0.05), (0.17, 0.08),
               (0.175, 0.12), (0.165, 0.13), (0.12, 0.12), (0.0, 0.12)]  # fmt: skip
    foot = revolve(profile, 96, 80)
    return merge([foot.moved(np.eye(3), (_middle(number), 0.0, 0.0)) for number in range(BALLS)])


__all__ = ["balls", "holders"]


# A camera's lens, its front up: two elements of coated glass in a black barrel with a grip, a name ring and blades.

_TOP = 1.72  # of the barrel
_OUTER, _INNER = 1.02, 0.80  # radii of the barrel and of its mouth
_BLADES = 7


def _element(radius: float, low: float, front: float, back: float) -> Mesh:
    """A lens about the z axis, its rim at height `low`: sagittas of its faces, upward."""
    edge = 0.05

    def face(sag: float, height: float, is_front: bool) -> Mesh:
        def position(u: Array, v: Array) -> Array:
            r, phi = radius * v, 2 * np.pi * u
            return np.stack([r * np.cos(phi), r * np.sin(phi), height + sag * (1 - v * v)], axis=-1)

        made = parametric(position, 160, 48)
        return made if (made.normals[:, 2].mean() > 0) == is_front else made.turned()

    def rim(u: Array, v: Array) -> Array:
        phi = 2 * np.pi * u
        return np.stack([radius * np.cos(phi), radius * np.sin(phi), low + edge * (v - 1)], axis=-1)

    whole = merge([face(front, low, True), face(back, low - edge, False), parametric(rim, 160, 2)])
    uv = 0.5 + 0.5 * whole.vertices[:, :2] / radius
    return Mesh(whole.vertices, whole.normals, uv, whole.faces)


def elements() -> Mesh:
    """The glass: what takes the material."""
    return merge([_element(0.79, 1.52, 0.30, 0.06), _element(0.62, 1.16, 0.10, -0.14), _element(0.5, 0.55, 0.16, -0.1)])


def barrel() -> Mesh:
    """The outside with its grip, and the mouth down to the blades."""
    outside = revolve(
        [(0.0, 0.0), (0.86, 0.0), (0.92, 0.0), (0.94, 0.02), (0.94, 0.3), (0.95, 0.34), (1.06, 0.38), (1.06, 0.4),
         (1.06, 0.7), (1.06, 1.0), (1.06, 1.02), (1.0, 1.06), (1.0, 1.1), (1.0, 1.5), (1.02, 1.56), (1.02, 1.66),
         (_OUTER, _TOP), (_OUTER, _TOP), (0.985, _TOP + 0.01), (0.94, _TOP), (0.93, _TOP - 0.03)], 256, 320,
    )  # fmt: skip
    inside = revolve([(0.5, 0.6), (0.52, 0.62), (0.6, 0.8), (0.66, 1.1), (0.74, 1.25), (0.78, 1.4), (0.8, 1.5),
                      (0.81, 1.54)], 192, 160).turned()  # fmt: skip
    ribs = []
    for number in range(60):
        angle = 2 * np.pi * number / 60
        rib = revolve([(0.026, 0.0), (0.026, 0.1), (0.026, 0.5), (0.026, 0.56), (0.0, 0.58)], 12, 12)
        ribs.append(rib.moved(np.eye(3), (1.06 * np.cos(angle), 1.06 * np.sin(angle), 0.41)))
    floor = revolve([(0.0, 0.3), (0.3, 0.3), (0.55, 0.3), (0.56, 0.35)], 64, 24)
    return merge([outside, inside, floor, *ribs])


def name_ring() -> Mesh:
    """The ring round the front element, sloping inward; u to the right and v upward over it."""

    def position(u: Array, v: Array) -> Array:
        r, phi = 0.81 + 0.125 * v, 2 * np.pi * u
        return np.stack([r * np.cos(phi), r * np.sin(phi), 1.55 + 0.14 * v], axis=-1)

    ring = parametric(position, 192, 8)
    ring = ring if ring.normals[:, 2].mean() > 0 else ring.turned()
    return Mesh(ring.vertices, ring.normals, 0.5 + 0.5 * ring.vertices[:, :2] / 0.94, ring.faces)


def ring_print(rows: int = 1200) -> Array:
    """Reflectance `[row, column]` of the name ring, first row on top: words along the circle."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("L", (rows, rows), 0)
    size = int(0.052 * rows)
    font = ImageFont.load_default(size)
    words, radius = "NACRE OPTICS   NACRINON  1:1.4 / 50 mm   \u00d8 55     ", 0.5 * rows * 0.871 / 0.94
    letters = words + words
    step = 2 * np.pi / len(letters)
    for number, letter in enumerate(letters):
        stamp = Image.new("L", (2 * size, 2 * size), 0)
        draw = ImageDraw.Draw(stamp)
        draw.text((size - 0.5 * draw.textlength(letter, font=font), 0.45 * size), letter, fill=255, font=font)
        angle = number * step + np.pi  # clockwise from below
        turned = stamp.rotate(-np.degrees(angle), resample=Image.Resampling.BICUBIC)
        x, y = 0.5 * rows + radius * np.sin(angle), 0.5 * rows - radius * np.cos(angle)
        box = (int(x) - size, int(y) - size)
        image.paste(255, (*box, box[0] + 2 * size, box[1] + 2 * size), turned)
    return np.asarray(0.012 + 0.6 * np.asarray(image, dtype=float) / 255.0)


def blades() -> Mesh:
    """The iris, stopped down: a dark disc with an opening of seven sides."""

    def position(u: Array, v: Array) -> Array:
        phi = 2 * np.pi * u
        side = 2 * np.pi / _BLADES
        inner = 0.24 / np.cos(np.mod(phi, side) - 0.5 * side)
        r = inner + (0.56 - inner) * v
        return np.stack([r * np.cos(phi), r * np.sin(phi), 0.74 + 0.02 * np.mod(phi, side) / side * v], axis=-1)

    disc = parametric(position, 280, 6)
    return disc if disc.normals[:, 2].mean() > 0 else disc.turned()


__all__ = ["barrel", "blades", "elements", "name_ring", "ring_print"]
