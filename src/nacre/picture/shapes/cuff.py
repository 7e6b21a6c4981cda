"""A hammered cuff, as jewellers anodise them: a wide open band, its outside beaten into facets.

u runs to the right and v upward on both the outside, seen in front, and the inside, seen behind.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import qmc

from nacre.picture.shapes.mesh import Array, Mesh, merge, parametric

_RADIUS, _HALF_HEIGHT, _THICKNESS = 1.3, 0.62, 0.07
_GAP_DEG = 38.0  # open at the back
_BLOWS, _DEPTH, _BOWL, _SEED = 300, 0.022, 0.18, 7
_NEAREST, _EDGE = 6, 22.0  # bowls that matter at a place, and how sharp the ridges between them are


@functools.cache
def _blows() -> cKDTree:
    """Where the hammer fell, on the unrolled band: evenly but not regularly, and once more beyond either end."""
    places = qmc.Sobol(2, rng=np.random.default_rng(_SEED)).random(512)[:_BLOWS]
    along, height = 2 * np.pi * _RADIUS * places[:, 0], (2 * places[:, 1] - 1) * _HALF_HEIGHT
    turns = [np.stack([along + 2 * np.pi * _RADIUS * turn, height], axis=1) for turn in (-1, 0, 1)]
    return cKDTree(np.concatenate(turns))


def _hammered(phi: Array, z: Array) -> Array:
    """How far the surface is beaten in: of the shallow bowls about it the deepest, with soft ridges between."""
    along = np.mod(phi, 2 * np.pi) * _RADIUS
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
        radius = _RADIUS + (0.5 * out if is_outside else -0.5 * out)
        if is_outside:
            radius = radius - _hammered(phi, z) * np.clip(4.0 * (1.0 - np.abs(across)), 0.0, 1.0)
        oval = 1.0 + 0.06 * np.cos(2 * phi)
        return np.stack([oval * radius * np.cos(phi), radius * np.sin(phi), _HALF_HEIGHT + z], axis=-1)

    outside = parametric(lambda u, v: place(u, 2 * v - 1, True), 720, 180)
    inside = parametric(lambda u, v: place(1 - u, 2 * v - 1, False), 400, 60)
    return merge([outside, inside])


__all__ = ["cuff"]
