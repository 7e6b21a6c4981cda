"""What a stack sends back to a flat particle whose circumscribing sphere cuts it.

Outgoing multipoles diverge inside that sphere, so the whole Sommerfeld integral of them does too: with the order, not
with the nodes. A field of multipoles up to L says nothing of waves faster than some L / (k r) in the plane, r the
radius of the sphere. The integral is cut in proportion (the rule of Egel et al. for particles that are no spheres), and
where two cuts disagree there is no answer.
"""

from __future__ import annotations

import numpy as np

from nacre.arrays import ComplexArray
from nacre.families.metasurface.angular import plane_wave_vectors
from nacre.families.metasurface.substrate import Substrate

CUT, LOWER_CUT = 0.6, 0.5  # of L / (k r): at L = 10, .1 % to 1 % of finite elements for discs and flat spheroids
DETOUR = 0.3  # below guided modes, in k
NODES = 240


def cut_of(lmax: int, wavenumber: float, circumscribing_nm: float, share: float = CUT) -> float:
    """Return the in-plane wavenumber over k that ends the integral."""
    return max(share * lmax / (wavenumber * circumscribing_nm), 1.2)


def cut_reflection_operator(
    surface: Substrate, centre_nm: float, lmax: int, mmax: int, cut: float, nodes: int = NODES
) -> ComplexArray:
    """Return W_m, `[m, n, n']`, as `sphere.reflection_operator` but of the in-plane wavenumbers up to `cut` k alone.

    4 int_0^cut kap dkap/(k kz) e^(2ikzd) sum_pol Bdag(kz) R B(-kz), on a path below the guided modes.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    angle = np.pi * (x + 1) / 2  # nodes crowd where the path begins and ends, and kz has its root on the way
    kappa = cut * (1 - np.cos(angle)) / 2 - 1j * DETOUR * np.sin(angle)
    slope = (cut * np.sin(angle) / 2 - 1j * DETOUR * np.cos(angle)) * np.pi / 2
    w = np.sqrt((1 - kappa) * (1 + kappa))
    w = np.where(w.imag < 0, -w, w)
    b = plane_wave_vectors(w, lmax, mmax, kappa)
    measure = 4 * weight * slope * kappa / w
    shape = (mmax + 1, 2 * lmax, -1)
    out = np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    for left, right in surface.echo(centre_nm, w).pairs(b):
        rows = (left * measure).transpose(0, 2, 1, 3).reshape(shape)
        out += rows @ right.transpose(0, 2, 1, 3).reshape(shape).transpose(0, 2, 1)
    return out
