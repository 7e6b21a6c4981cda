"""The coherent field in closed form: the monolayer as a thin sheet of independent scatterers over the stack.

Garcia-Valenzuela's model with a substrate: each particle is excited by the incident wave, half of the sheet's own
radiated waves and their reflections. With the free T-matrix the 2 x 2 matrix form is the closed form to rounding; with
the dressed one it also includes the near field between particle and stack. It ignores g(r): use it for p = f only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.arrays import ComplexArray
from nacre.families.metasurface.angular import adjoint, mirrored, plane_wave_vectors
from nacre.families.metasurface.sphere import Directions
from nacre.families.metasurface.substrate import Substrate


@dataclass(frozen=True)
class SheetField:
    """Waves at the sheet, `[pol, angle]`: E at the sphere centres, A radiated; `_d` going down, `_u` up."""

    e_d: ComplexArray
    e_u: ComplexArray
    a_d: ComplexArray
    a_u: ComplexArray
    phase: ComplexArray

    def reflection(self, bare: ComplexArray) -> ComplexArray:
        """The specular amplitude for light from above, `[pol, angle]`, given that of the bare stack."""
        return bare * (1 + self.phase * self.a_d) + self.a_u / self.phase


def sheet_field(
    surface: Substrate, centre_nm: float, response: ComplexArray, density_per_nm2: float, directions: Directions
) -> SheetField:
    """Solve the sheet's 2 x 2 system for plane waves from the side of `directions`.

    Args:
        response: `[m, n, n']`, the free T (diagonal blocks) or the dressed M.
    """
    k, w = surface.wavenumber, directions.inner_cosines
    lmax, mmax = response.shape[1] // 2, response.shape[0] - 1
    up = plane_wave_vectors(w, lmax, mmax, directions.transverse.astype(complex))
    down = mirrored(up)
    weight = np.where(np.arange(mmax + 1) == 0, 1.0, 2.0)
    scale = 2 * np.pi * density_per_nm2 / (k**2 * w)
    a = np.empty((2, 2, 2, w.size), dtype=complex)  # s, s', pol, angle with 0 = down
    for j, right in enumerate((down, up)):
        answered = np.matmul(response[:, None], 4 * adjoint(right))
        for i, left in enumerate((down, up)):
            a[i, j] = scale * np.einsum("m,mpna,mpna->pa", weight, left, answered)
    b = np.exp(1j * k * centre_nm * w)
    r = surface.reflection(w) * b**2
    if directions.below:
        assert directions.transmission_up is not None  # set for every direction below
        start = np.stack([np.zeros_like(r), directions.transmission_up * b])
    else:
        start = np.stack([np.broadcast_to(1 / b, r.shape), r / b])
    # E_d = start_d + A_d/2, E_u = start_u + r A_d + A_u/2
    feed = np.zeros((2, 2, *r.shape), dtype=complex)
    feed[0, 0] = feed[1, 1] = 0.5
    feed[1, 0] = r
    system = np.eye(2)[:, :, None, None] - np.einsum("ijpa,jkpa->ikpa", feed, a)
    fields = np.linalg.solve(np.moveaxis(system, (0, 1), (2, 3)), np.moveaxis(start, 0, 2)[..., None])[..., 0]
    e = np.moveaxis(fields, 2, 0)
    radiated = np.einsum("ijpa,jpa->ipa", a, e)
    return SheetField(e[0], e[1], radiated[0], radiated[1], np.broadcast_to(b, r.shape))


def sheet_vectors(field: SheetField, directions: Directions, lmax: int, mmax: int) -> tuple[ComplexArray, ComplexArray]:
    """Excitation and emission vectors with the sheet's mean field in place of the bare waves, `[m, pol, n, angle]`."""
    up = plane_wave_vectors(directions.inner_cosines, lmax, mmax, directions.transverse.astype(complex))
    down = mirrored(up)
    excitation = 4 * (adjoint(down) * field.e_d[None, :, None] + adjoint(up) * field.e_u[None, :, None])
    emission = up * field.e_d[None, :, None] + down * field.e_u[None, :, None]
    return excitation, emission
