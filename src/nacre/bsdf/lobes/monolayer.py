"""What the lobes of monolayers have in common: a grid of polar angles on each side, and where light passes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.bsdf.lobe import Lobe
from nacre.core.arrays import Array, SingleArray
from nacre.core.jit import compiled


@dataclass(frozen=True)
class PolarGrid:
    """Polar angles of one side of a surface, uniform in a coordinate x = 0..count-1.

    Above, and below down to the critical angle, x is uniform in the angle of the rarer medium; beyond, the root
    of the distance to the critical angle takes over. Fields have a square-root kink there, which this resolves.

    Attributes:
        count: nodes below the critical angle (all of them above).
        beyond: nodes beyond the critical angle; 0 above.
        eta: index of this side over the other's; 1 above.
    """

    count: int
    beyond: int = 0
    eta: float = 1.0

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.count + self.beyond

    @property
    def critical_rad(self) -> float:
        """The critical angle; pi/2 where there is none."""
        return float(np.arcsin(min(1.0, 1.0 / self.eta)))

    def theta(self, x: ArrayLike) -> Array:
        """Return the angle against the normal, in this side's medium, rad, at coordinates x >= 0."""
        x = np.asarray(x, dtype=float)
        edge = self.count - 0.5
        outer = np.sin(np.clip(x / edge, 0.0, 1.0) * np.pi / 2)
        inner = np.arcsin(np.clip(outer / self.eta, 0.0, 1.0))
        if self.beyond == 0:
            return inner
        u = np.clip((x - edge) / self.beyond, 0.0, 1.0)
        return np.where(x <= edge, inner, self.critical_rad + u**2 * (np.pi / 2 - self.critical_rad))

    @property
    def nodes(self) -> Array:
        """Angles of the nodes, rad, `[node]`."""
        return self.theta(np.arange(self.size))

    @property
    def weights(self) -> Array:
        """Solid-angle weights dmu of the cells round the nodes, `[node]`; they sum to 1."""
        edges = np.cos(self.theta(np.concatenate([[0.0], np.arange(self.size - 1) + 0.5, [self.size - 0.5]])))
        edges[0], edges[-1] = 1.0, 0.0
        return edges[:-1] - edges[1:]


@compiled(nogil=True)
def coordinate(sine, cosine, count, beyond, eta):  # type: ignore[no-untyped-def]  # numba
    edge = count - 0.5
    outer = eta * sine
    if outer < 1.0 or beyond == 0:
        x = np.arctan2(sine, cosine) if eta == 1.0 else np.arcsin(min(outer, 1.0))
        x = x * (2.0 / np.pi) * edge
    else:
        critical = np.arcsin(1.0 / eta)
        x = edge + beyond * np.sqrt(max(np.arctan2(sine, cosine) - critical, 0.0) / (0.5 * np.pi - critical))
    return min(max(x, 0.0), count + beyond - 1.0)


class MonolayerLobe(Lobe):
    """Diffuse light of a monolayer, tabulated over the polar angles of both directions.

    Attributes:
        count_above, count_below, count_beyond: nodes of `PolarGrid` above, and below; 0 below what is opaque.
        eta: index of the substrate over the ambient's, one number, as for the specular lobe.
        wavenumbers: `[wavelength]`, k of the ambient, 1/nm.
        index_below: `[wavelength]`, index of the substrate over the ambient's; ones where nothing is transmitted.
        q_step: step of `structure` in 1/nm, from 0.
        structure: `[q]`, the structure factor; 1 beyond the table.
    """

    count_above: int
    count_below: int
    count_beyond: int
    eta: float
    wavenumbers: Array
    index_below: Array
    q_step: float
    structure: Array

    @property
    def transmits(self) -> bool:
        """Whether light is transmitted to the other side."""
        return self.count_below > 0

    @property
    def grid_below(self) -> PolarGrid:
        """Polar angles below."""
        return PolarGrid(self.count_below, self.count_beyond, self.eta)

    @property
    def grids(self) -> NDArray[np.int64]:
        """Nodes up to the critical angle and beyond, `[side, 2]`, as the kernels read them."""
        return np.array([[self.count_above, 0], [self.count_below, self.count_beyond]])

    @property
    def last_cosines(self) -> Array:
        """Cosines of the last nodes above and below, from where f falls to zero as the cosine does, `[2]`."""
        sides = (PolarGrid(self.count_above), self.grid_below)
        return np.array([np.cos(side.nodes[-1]) if side.size else 1.0 for side in sides])

    def check_grids(self, wavelengths: int) -> None:
        """Check what both kinds of tables stand on.

        Args:
            wavelengths: of the tables.

        Raises:
            ValueError: saying what does not fit.
        """
        below = self.count_below + self.count_beyond
        if self.count_above < 2 or (below and self.count_below < 2) or self.count_beyond < 0 or not self.eta >= 1.0:
            raise ValueError(f"the {self.kind} lobe needs two angles a side and eta >= 1")
        if wavelengths != len(self.wavelengths_nm) or not self.q_step > 0 or len(self.structure) < 2:
            raise ValueError("wavelengths or structure do not fit")
        if self.wavenumbers.shape != self.wavelengths_nm.shape or self.index_below.shape != self.wavelengths_nm.shape:
            raise ValueError("wavenumbers or index_below do not fit")


# Diffuse light of a disordered monolayer: harmonics over the azimuth, times the sharp structure factor.


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


# Diffuse light of a disordered monolayer whose particles all point one way: a double Fourier series, times S.

HIGHEST_ORDER = 64


@compiled(nogil=True)
def _evaluate_aligned(wi, wo, table, orders, grids, last_cos, eta, rotation, wavenumbers, index, step, s, out):  # type: ignore[no-untyped-def]  # numba
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
        _evaluate_aligned(
            *flat, self.table, np.asarray(self.orders, dtype=float), self.grids, self.last_cosines, float(self.eta),
            float(self.rotation), self.wavenumbers, self.index_below, float(self.q_step), self.structure, out,
        )  # fmt: skip
        return out.reshape(*wi.shape[:-1], -1)
