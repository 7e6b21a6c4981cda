"""A small coupé, closed and smooth, with glass, wheels, rims and details.

The hull is an implicit body between drawn silhouettes (plan, deck line, roof line: B-splines) with superelliptic
sections. Wheel arches are subtracted with rounded edges; panes are cut along exact lines. x runs from tail to nose;
lengths are in metres.
"""

from collections.abc import Callable

import numpy as np

from nacre.core.arrays import Array
from nacre.picture.shapes import mesh
from nacre.picture.shapes.printed import text_mask

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
    side = -mesh.smooth_max(-side, _leaning(x, z, 0.64, -1.15), 0.05)  # A pillar
    side = -mesh.smooth_max(-side, -_leaning(x, z, -1.22, 0.75), 0.10)  # C pillar
    side = -mesh.smooth_max(-side, 0.45 - wide, 0.02)
    screen = -mesh.smooth_max(wide - (mesh.curve(_CABIN, x) - 0.42 * (z - 0.85) - 0.075), 0.885 - z, 0.05)
    screen = -mesh.smooth_max(-screen, 0.22 + 0.10 * wide**2 - x, 0.05)
    rear = -mesh.smooth_max(wide - (mesh.curve(_CABIN, x) - 0.42 * (z - 0.85) - 0.10), x + 0.86 - 0.10 * wide**2, 0.05)
    rear = -mesh.smooth_max(-rear, -1.62 - x + 0.05 * wide**2, 0.05)
    rear = np.where(n[:, 2] > 0.25, rear, -1.0)
    return np.maximum(np.maximum(side, screen), rear)


def _leaning(x: Array, z: Array, foot: float, lean: float) -> Array:
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
