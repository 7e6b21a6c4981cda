"""The knob: a ball with a dished window and a groove on a turned foot, with convex and concave regions and edges."""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.implicit import smooth_max, surface_net
from nacre.picture.shapes.mesh import Array, Mesh, open_seam, revolve

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
