"""A strip of balls in a tray, as makers of pigments and coatings show a series side by side.

u runs to the right over the whole strip and v upward over each ball, so that a formula of u is a series.
"""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh, merge, parametric, revolve

BALLS, _RADIUS, _APART = 7, 0.42, 0.98
_RIM = 0.09  # height of the tray's holders


def _middle(number: int) -> float:
    return (number - 0.5 * (BALLS - 1)) * _APART


def balls() -> Mesh:
    """What takes the material."""

    def position(u: Array, v: Array) -> Array:
        phi, theta = 2 * np.pi * (u + 0.25), np.pi * (1 - v)
        ball = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        return np.asarray(_RADIUS * ball)

    one = parametric(position, 160, 80)
    low = _RIM + 0.94 * _RADIUS
    half = 0.5 * (BALLS - 1) * _APART + _RADIUS
    whole = merge([one.moved(np.eye(3), (_middle(number), 0.0, low)) for number in range(BALLS)])
    uv = np.stack([0.5 + 0.5 * whole.vertices[:, 0] / half, 0.5 + 0.5 * (whole.vertices[:, 2] - low) / _RADIUS], axis=1)
    return Mesh(whole.vertices, whole.normals, uv, whole.faces)


def holders() -> Mesh:
    """A turned foot below each ball."""
    profile = [(0.0, 0.0), (0.24, 0.0), (0.26, 0.0), (0.27, 0.01), (0.26, 0.03), (0.19, 0.05), (0.17, 0.08),
               (0.175, 0.12), (0.165, 0.13), (0.12, 0.12), (0.0, 0.12)]  # fmt: skip
    foot = revolve(profile, 96, 80)
    return merge([foot.moved(np.eye(3), (_middle(number), 0.0, 0.0)) for number in range(BALLS)])


__all__ = ["balls", "holders"]
