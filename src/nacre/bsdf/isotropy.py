"""Test whether a BSDF is isotropic."""

from __future__ import annotations

import numpy as np

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.grids import direction
from nacre.bsdf.lobes.orders import OrdersLobe


def is_isotropic(bsdf: Bsdf) -> bool:
    """Whether the values are invariant under rotation about the normal, tested at a few pairs.

    The lobes of orders of a grating are too narrow for this test and are never invariant.
    """
    if any(isinstance(lobe, OrdersLobe) for lobe in bsdf.lobes):
        return False
    theta_i, theta_o, dphi = (np.radians(v) for v in ([20.0, 50.0, 70.0], [35.0, 45.0, 60.0], [180.0, 150.0, 90.0]))
    values = [
        bsdf.evaluate(direction(theta_i, turn), direction(theta_o, dphi + turn)) for turn in np.radians([0, 31, 77, 90])
    ]
    scale = max(float(np.max(values)), 1e-30)
    return bool(np.ptp(np.stack(values), axis=0).max() <= 1e-4 * scale)
