"""Reflectance and transmittance of an interface as smooth tables over angle, from both sides.

Both sides are tabulated over the cosine OUTSIDE (in the ambient medium): by the inside cosine the square-root
kink at the critical angle costs up to 655 %. Beyond the critical angle no real outside cosine exists; there
the signed coordinate `-sqrt(sin_o^2 - 1)`, with `sin_o = eta sin_inside > 1`, continues the axis smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.contract import ParameterAxis

Array = NDArray[np.float64]


@dataclass(frozen=True)
class InterfaceResponse:
    """Power tables of one interface; leading axes are the parameter axes, if any.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        cos_outside: `[cos]`, ascending nodes in [0, 1] (node 0 at 0, last at 1), uniform.
        reflectance: `[*params, cos, wavelength]`, light from the ambient, unpolarised power.
        transmittance: same shape, power into the substrate (zeros for an opaque one).
        reflectance_inside: same shape, light from the substrate at the conjugate angle.
        total: `[*params, kappa, wavelength]`, reflectance from the substrate beyond the critical angle, at
            uniform nodes of `sqrt(sin_o^2 - 1)` in [0, sqrt(eta_max^2 - 1)]; empty axis if eta <= 1.
        eta: one relative index n_substrate/n_ambient that bends all directions (dispersion of the bending
            is left out: it would split rays); 1 for a free film.
        transmits: whether light passes to the other side.
        parameters: the axes that textures drive.
    """

    wavelengths_nm: Array
    cos_outside: Array
    reflectance: Array
    transmittance: Array
    reflectance_inside: Array
    total: Array
    eta: float
    transmits: bool
    parameters: tuple[ParameterAxis, ...] = ()
