"""Diffuse light of a disordered monolayer: harmonics over the azimuth, times the sharp structure factor.

f / n_o^2 = S(|q|) sum_k H_k(theta_i, theta_o) cos(k dphi), and the same sum without S. H is smooth and tabulated;
S has sharp rings: it is multiplied at the exact |q| = |k_par,i - k_par,o| of each pair, so that no grid blurs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array, SingleArray
from nacre.bsdf.lobes.monolayer import MonolayerLobe, coordinate
from nacre.matter.jit import compiled


@compiled(nogil=True, fastmath=True)
def _accumulate(table, row, weight, cosines, out):  # type: ignore[no-untyped-def]  # numba
    for k in range(table.shape[1]):
        c = weight * cosines[k]  # double: single sums would break reciprocity at 1e-7
        for l in range(table.shape[2]):
            out[l] += c * table[row, k, l]


@compiled(nogil=True)
def _evaluate(wi, wo, above, below, across, free, grids, last_cos, eta, wavenumbers, index, step, s, out):  # type: ignore[no-untyped-def]  # numba
    kept, count = above.shape[1], above.shape[2]
    cosines = np.empty(kept)
    smooth, bare = np.empty(count), np.empty(count)
    last = s.size - 1
    for n in range(wi.shape[0]):
        up_i, up_o = wi[n, 2] > 0.0, wo[n, 2] > 0.0
        if wi[n, 2] == 0.0 or wo[n, 2] == 0.0 or (across.shape[0] == 0 and not (up_i and up_o)):
            continue
        sin_i, sin_o = np.sqrt(wi[n, 0] ** 2 + wi[n, 1] ** 2), np.sqrt(wo[n, 0] ** 2 + wo[n, 1] ** 2)
        dot = wi[n, 0] * wo[n, 0] + wi[n, 1] * wo[n, 1]
        size = sin_i * sin_o
        # dphi lies between the in-plane wavevectors, -wi and wo
        c = min(max(-dot / size, -1.0), 1.0) if size > 1e-14 else 1.0
        cosines[0] = 1.0
        if kept > 1:
            cosines[1] = c
        for k in range(2, kept):
            cosines[k] = 2.0 * c * cosines[k - 1] - cosines[k - 2]
        gi, go = (0 if up_i else 1), (0 if up_o else 1)
        xi = coordinate(sin_i, abs(wi[n, 2]), grids[gi, 0], grids[gi, 1], eta if gi else 1.0)
        xo = coordinate(sin_o, abs(wo[n, 2]), grids[go, 0], grids[go, 1], eta if go else 1.0)
        i0 = min(int(xi), grids[gi, 0] + grids[gi, 1] - 2)
        o0 = min(int(xo), grids[go, 0] + grids[go, 1] - 2)
        fi, fo = xi - i0, xo - o0
        smooth[:] = 0.0
        bare[:] = 0.0
        for corner in range(3):
            # linear on the triangle of the cell that holds the point: one corner less to read, and as symmetric
            if corner == 0:
                a, b, weight = i0, o0, 1.0 - max(fi, fo)
            elif corner == 1:
                a, b, weight = i0 + 1, o0 + 1, min(fi, fo)
            else:
                a, b, weight = i0 + (1 if fi > fo else 0), o0 + (0 if fi > fo else 1), abs(fi - fo)
            if weight == 0.0:
                continue
            if gi == go:
                row = a * (a + 1) // 2 + b if a >= b else b * (b + 1) // 2 + a
            elif gi:
                row = a * (grids[0, 0] + grids[0, 1]) + b
            else:
                row = b * (grids[0, 0] + grids[0, 1]) + a
            if gi != go:
                _accumulate(across, row, weight, cosines, smooth)
                if free[2].shape[0]:
                    _accumulate(free[2], row, weight, cosines, bare)
            elif gi:
                _accumulate(below, row, weight, cosines, smooth)
                if free[1].shape[0]:
                    _accumulate(free[1], row, weight, cosines, bare)
            else:
                _accumulate(above, row, weight, cosines, smooth)
                if free[0].shape[0]:
                    _accumulate(free[0], row, weight, cosines, bare)
        scale = eta * eta if go else 1.0
        # beyond the last node f falls to zero as the cosine
        scale *= min(abs(wi[n, 2]) / last_cos[gi], 1.0) * min(abs(wo[n, 2]) / last_cos[go], 1.0)
        for l in range(count):
            ni, no = (index[l] if gi else 1.0), (index[l] if go else 1.0)
            q2 = (ni * sin_i) ** 2 + (no * sin_o) ** 2 + 2.0 * ni * no * dot
            x = wavenumbers[l] * np.sqrt(max(q2, 0.0)) / step
            j = int(x)
            factor = 1.0 if j >= last else s[j] + (x - j) * (s[j + 1] - s[j])
            # a cut cosine series may dip below zero where the light is next to nothing
            out[n, l] = scale * (max(smooth[l], 0.0) * factor + max(bare[l], 0.0))


@dataclass(frozen=True)
class Harmonic(MonolayerLobe):
    """Diffuse reflection, and transmission where `across` is not empty, of a monolayer of particles.

    Tables are float32 and hold f / n_o^2, which is symmetric in the two directions: `above` and `below` keep one
    triangle (row i (i+1)/2 + j, j <= i), `across` has rows below * count_above + above. The `_free` tables
    hold the light that S does not multiply (from the spread of particle sizes); empty for equal particles.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        above, below, across: `[pair, harmonic, wavelength]`, 1/sr.
        above_free, below_free, across_free: the same, or empty.
        the others: see `MonolayerLobe`.
    """

    kind: ClassVar[str] = "harmonic"
    wavelengths_nm: Array
    above: SingleArray
    below: SingleArray
    across: SingleArray
    above_free: SingleArray
    below_free: SingleArray
    across_free: SingleArray
    count_above: int
    count_below: int
    count_beyond: int
    eta: float
    wavenumbers: Array
    index_below: Array
    q_step: float
    structure: Array

    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "above": "pair harmonic wavelength",
        "below": "pair harmonic wavelength",
        "across": "pair harmonic wavelength",
        "wavenumbers": "wavelength",
        "index_below": "wavelength",
        "structure": "q",
    }

    def check(self) -> None:
        """Check that the tables fit together.

        Raises:
            ValueError: saying what does not fit.
        """
        n = self.count_above
        m = self.count_below + self.count_beyond
        self.check_grids(self.above.shape[-1])
        rows = {"above": n * (n + 1) // 2, "below": m * (m + 1) // 2, "across": n * m}
        for name, count in rows.items():
            for suffix in ("", "_free"):
                table = getattr(self, name + suffix)
                needed = name == "above" or self.transmits
                empty_allowed = suffix == "_free" or not needed
                if table.ndim != 3 or (table.shape[0] != count and not (empty_allowed and table.shape[0] == 0)):
                    raise ValueError(f"{name + suffix} has {table.shape[0]} rows, not {count}")
                if table.shape[0] and table.shape[1:] != self.above.shape[1:]:
                    raise ValueError(f"{name + suffix} has the shape {table.shape}")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f, `[..., wavelength]`, 1/sr, for unit vectors `[..., 3]`; zero where no light can go."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        flat = (np.ascontiguousarray(wi).reshape(-1, 3), np.ascontiguousarray(wo).reshape(-1, 3))
        out = np.zeros((flat[0].shape[0], len(self.wavelengths_nm)))
        _evaluate(
            *flat,
            self.above,
            self.below,
            self.across,
            (self.above_free, self.below_free, self.across_free),
            self.grids,
            self.last_cosines,
            float(self.eta),
            self.wavenumbers,
            self.index_below,
            float(self.q_step),
            self.structure,
            out,
        )
        return out.reshape(*wi.shape[:-1], -1)


def pack_triangle(full: NDArray) -> SingleArray:
    """Return the lower triangle of a symmetric `[s, i, ...]` as `[pair, ...]`, float32."""
    rows, columns = np.tril_indices(full.shape[0])
    return np.ascontiguousarray(full[rows, columns], dtype=np.float32)
