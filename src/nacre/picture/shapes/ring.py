"""A film in a ring of wire on a stand, as soap films are shown: u to the right and v upward over the whole ring."""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh, merge, parametric, revolve, rotation

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
