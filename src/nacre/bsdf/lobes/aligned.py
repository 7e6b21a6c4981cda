"""Diffuse light of a disordered monolayer whose particles all point one way: a double Fourier series, times S.

f / n_o^2 = S(|q|) sum_t H_t(theta_1, theta_2) cos(a_t phi_1 + b_t phi_2) (or the sine), phi being azimuths of the
directions themselves. As in `harmonic`, H is smooth and tabulated and the sharp S is taken at the exact |q|. Of the two
directions the first is the one below, or the one farther from the normal: so one triangle holds all pairs, and f is
the same with the two exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.arrays import Array, SingleArray
from nacre.bsdf.lobes.monolayer import MonolayerLobe, coordinate
from nacre.matter.jit import compiled

HIGHEST_ORDER = 64


@compiled(nogil=True)
def _evaluate(wi, wo, table, orders, grids, last_cos, eta, rotation, wavenumbers, index, step, s, out):  # type: ignore[no-untyped-def]  # numba
    terms, count = table.shape[1], table.shape[2]
    waves = np.empty(terms)
    smooth = np.empty(count)
    last = s.size - 1
    above = grids[0, 0] + grids[0, 1]
    transmits = grids[1, 0] > 0
    for n in range(wi.shape[0]):
        up_i, up_o = wi[n, 2] > 0.0, wo[n, 2] > 0.0
        if wi[n, 2] == 0.0 or wo[n, 2] == 0.0 or (not transmits and not (up_i and up_o)):
            continue
        sin_i, sin_o = np.sqrt(wi[n, 0] ** 2 + wi[n, 1] ** 2), np.sqrt(wo[n, 0] ** 2 + wo[n, 1] ** 2)
        gi, go = (0 if up_i else 1), (0 if up_o else 1)
        xi = coordinate(sin_i, abs(wi[n, 2]), grids[gi, 0], grids[gi, 1], eta if gi else 1.0)
        xo = coordinate(sin_o, abs(wo[n, 2]), grids[go, 0], grids[go, 1], eta if go else 1.0)
        i0 = min(int(xi), grids[gi, 0] + grids[gi, 1] - 2)
        o0 = min(int(xo), grids[go, 0] + grids[go, 1] - 2)
        fi, fo = xi - i0, xo - o0
        ti, to = i0 + gi * above, o0 + go * above
        phi_i = np.arctan2(wi[n, 1], wi[n, 0]) - rotation
        phi_o = np.arctan2(wo[n, 1], wo[n, 0]) - rotation
        is_first = ti > to or (ti == to and fi >= fo)
        one, two = (phi_i, phi_o) if is_first else (phi_o, phi_i)
        high, low = (ti, to) if is_first else (to, ti)
        fh, fl = (fi, fo) if is_first else (fo, fi)
        for t in range(terms):
            angle = orders[t, 0] * one + orders[t, 1] * two
            waves[t] = np.sin(angle) if orders[t, 2] > 0 else np.cos(angle)
        smooth[:] = 0.0
        for corner in range(3):
            # linear on the triangle of the cell that holds the point, as in `harmonic`
            if corner == 0:
                a, b, weight = high, low, 1.0 - max(fh, fl)
            elif corner == 1:
                a, b, weight = high + 1, low + 1, min(fh, fl)
            else:
                a, b, weight = high + (1 if fh > fl else 0), low + (0 if fh > fl else 1), abs(fh - fl)
            if weight == 0.0:
                continue
            row = a * (a + 1) // 2 + b
            for t in range(terms):
                c = weight * waves[t]
                for l in range(count):
                    smooth[l] += c * table[row, t, l]
        scale = eta * eta if go else 1.0
        # beyond the last node f falls to zero as the cosine
        scale *= min(abs(wi[n, 2]) / last_cos[gi], 1.0) * min(abs(wo[n, 2]) / last_cos[go], 1.0)
        dot = wi[n, 0] * wo[n, 0] + wi[n, 1] * wo[n, 1]
        for l in range(count):
            ni, no = (index[l] if gi else 1.0), (index[l] if go else 1.0)
            q2 = (ni * sin_i) ** 2 + (no * sin_o) ** 2 + 2.0 * ni * no * dot
            x = wavenumbers[l] * np.sqrt(max(q2, 0.0)) / step
            j = int(x)
            factor = 1.0 if j >= last else s[j] + (x - j) * (s[j + 1] - s[j])
            # a cut series may dip below zero where the light is next to nothing
            out[n, l] = scale * max(smooth[l], 0.0) * factor


@dataclass(frozen=True)
class Aligned(MonolayerLobe):
    """Diffuse reflection, and transmission where there are nodes below, of a monolayer of aligned particles.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        table: `[pair, term, wavelength]`, f / n_o^2 in 1/sr; row a (a + 1)/2 + b of the nodes a >= b, those below
            after those above.
        orders: `[term, 3]`: whole numbers a_t, b_t of the azimuths at the nodes a and b, and 0 (cosine) or 1 (sine).
        rotation: angle in rad about the normal, from +x to +y, by which the particles are turned.
        the others: see `MonolayerLobe`.
    """

    kind: ClassVar[str] = "aligned"
    wavelengths_nm: Array
    table: SingleArray
    orders: Array
    count_above: int
    count_below: int
    count_beyond: int
    eta: float
    rotation: float
    wavenumbers: Array
    index_below: Array
    q_step: float
    structure: Array

    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "table": "pair term wavelength",
        "orders": "term order",
        "wavenumbers": "wavelength",
        "index_below": "wavelength",
        "structure": "q",
    }

    def check(self) -> None:
        """Check that the tables fit together.

        Raises:
            ValueError: saying what does not fit.
        """
        self.check_grids(self.table.shape[-1])
        nodes = self.count_above + self.count_below + self.count_beyond
        if self.table.ndim != 3 or len(self.table) != nodes * (nodes + 1) // 2:
            raise ValueError(f"table has the shape {self.table.shape}, for {nodes} angles")
        if self.orders.shape != (self.table.shape[1], 3) or not len(self.orders):
            raise ValueError(f"orders has the shape {self.orders.shape}, for {self.table.shape[1]} terms")
        whole = np.array_equal(self.orders, np.round(self.orders)) and np.abs(self.orders).max() <= HIGHEST_ORDER
        if not whole or not np.isin(self.orders[:, 2], (0, 1)).all() or not np.isfinite(self.rotation):
            raise ValueError(f"orders are not whole, or above {HIGHEST_ORDER}")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f, `[..., wavelength]`, 1/sr, for unit vectors `[..., 3]`; zero where no light can go."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        flat = (np.ascontiguousarray(wi).reshape(-1, 3), np.ascontiguousarray(wo).reshape(-1, 3))
        out = np.zeros((flat[0].shape[0], len(self.wavelengths_nm)))
        _evaluate(
            *flat, self.table, np.asarray(self.orders, dtype=float), self.grids, self.last_cosines, float(self.eta),
            float(self.rotation), self.wavenumbers, self.index_below, float(self.q_step), self.structure, out,
        )  # fmt: skip
        return out.reshape(*wi.shape[:-1], -1)
