"""The speedshape: one smooth, doubly curved body with bulging and hollow regions and no sharp edge.

Paint manufacturers judge effect colours on such bodies, since all angles occur on them and change slowly.
"""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh, bspline, parametric

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
