"""Mueller matrices of a smooth interface without polarisation conversion, tabulated for the renderer.

In the frame (s, k x s) of each wave such an interface has the matrix

    [[a, b, 0, 0], [b, a, 0, 0], [0, 0, c, -d], [0, 0, d, c]],  a = (S + P) / 2, b = (S - P) / 2, c + i d = s p*,

with the amplitudes s and p (r_p = -r_s at normal incidence) and their powers S and P. The tables hold a, b, c and d;
the renderer uses their ratios to a.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.bsdf.tabulate import StackTables
from nacre.core.arrays import Array, ComplexArray
from nacre.matter.stack import solve as solver

COS_NODES = 1025
TOTAL_NODES = 1025


@dataclass(frozen=True)
class InterfacePolarisation:
    """Numbers a, b, c and d of an interface; see the module.

    The coordinates are those of `InterfaceResponse`: `outside` is the rarer medium.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        reflected: `[cos, wavelength, 4]` over uniform cosines from 0 to 1 in the rarer medium, light from there.
        reflected_inside: the same for light from the denser medium at the conjugate angle; None if opaque.
        total: `[x, wavelength, 4]` beyond the critical angle; None if there is none.
        transmitted: `[cos, wavelength, 4]` relative to an unknown common factor, equal from both sides; None if opaque.
        eta, flipped: as in `InterfaceResponse`.
    """

    wavelengths_nm: Array
    reflected: Array
    reflected_inside: Array | None
    total: Array | None
    transmitted: Array | None
    eta: float
    flipped: bool


def interface_polarisation(tables: StackTables, thicknesses_nm: Array) -> InterfacePolarisation | None:
    """Tabulate a stack's Mueller matrices; None for incoherent layers, which the renderer treats as depolarising.

    Args:
        tables: the stack.
        thicknesses_nm: `[layer]`.
    """
    if any(tables.incoherent):
        return None
    d = np.asarray(thicknesses_nm, dtype=float)
    n, d = (tables.n[::-1], d[::-1]) if tables.flipped else (tables.n, d)
    cos, lam = np.linspace(0.0, 1.0, COS_NODES), tables.wavelengths_nm
    outside = solver.amplitudes(n, d, lam, cos_i=cos)
    reflected = _elements(outside.r_s, outside.r_p)
    behind = total = transmitted = None
    if tables.transmits:
        rare, dense = n[0].real, n[-1].real
        transmitted = _elements(outside.t_s, outside.t_p)
        transmitted[0] = transmitted[1]  # nothing enters at grazing incidence; the ratio is continuous
        back_n, back_d = n[::-1], d[::-1]
        inside = solver.amplitudes(back_n, back_d, lam, kappa=np.sqrt(1.0 - cos * cos)[:, None] * rare)
        behind = _elements(inside.r_s, inside.r_p)
        if tables.eta > 1.0:
            share = np.square(np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, TOTAL_NODES)))[:, None]
            square = rare**2 + np.maximum(dense**2 - rare**2, 0.0) * share
            beyond = solver.amplitudes(back_n, back_d, lam, kappa=np.sqrt(square))
            total = _elements(beyond.r_s, beyond.r_p)
    return InterfacePolarisation(lam, reflected, behind, total, transmitted, tables.eta, tables.flipped)


def _elements(s: ComplexArray, p: ComplexArray) -> Array:
    """Return a, b, c and d `[..., 4]`."""
    cross = s * np.conj(p)
    power_s, power_p = np.abs(s) ** 2, np.abs(p) ** 2
    return np.stack([0.5 * (power_s + power_p), 0.5 * (power_s - power_p), cross.real, cross.imag], axis=-1)
