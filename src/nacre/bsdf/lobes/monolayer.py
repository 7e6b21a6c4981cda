"""Diffuse light of a disordered monolayer, isotropic (`Harmonic`) or with aligned particles (`Aligned`).

`Harmonic`: f / n_o^2 = S(|q|) sum_k H_k(theta_i, theta_o) cos(k dphi), plus the same sum without S.
`Aligned`: f / n_o^2 = S(|q|) sum_t H_t(theta_1, theta_2) cos(a_t phi_1 + b_t phi_2) (or the sine), with azimuths
phi. The first direction is the one below, or the one farther from the normal: one triangle then holds
all pairs, and f is symmetric in the two directions.

H is smooth and tabulated. The structure factor S has sharp rings and is evaluated at each pair's exact
|q| = |k_par,i - k_par,o|, without interpolation error.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.bsdf.lobe import Lobe
from nacre.core.arrays import Array, SingleArray
from nacre.core.jit import compiled

HIGHEST_ORDER = 64


@dataclass(frozen=True)
class PolarGrid:
    """Polar angles on one side of a surface, uniform in a coordinate x = 0..count-1.

    Above, and below up to the critical angle, x is uniform in the angle in the rarer medium. Beyond the critical angle
    it is uniform in the square root of the distance to it, which resolves the fields' square-root kink.

    Attributes:
        count: nodes up to the critical angle (all nodes above the surface).
        beyond: nodes beyond the critical angle; 0 above.
        eta: index on this side over the index on the other side; 1 above.
    """

    count: int
    beyond: int = 0
    eta: float = 1.0

    @property
    def size(self) -> int:
        """Node count."""
        return self.count + self.beyond

    @property
    def critical_rad(self) -> float:
        """The critical angle; pi/2 for eta = 1."""
        return float(np.arcsin(min(1.0, 1.0 / self.eta)))

    def theta(self, x: ArrayLike) -> Array:
        """Return the polar angle in this side's medium, rad, at coordinates x >= 0."""
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
        """Node angles, rad, `[node]`."""
        return self.theta(np.arange(self.size))

    @property
    def weights(self) -> Array:
        """Solid-angle weights dmu of the node cells, `[node]`; they sum to 1."""
        edges = np.cos(self.theta(np.concatenate([[0.0], np.arange(self.size - 1) + 0.5, [self.size - 0.5]])))
        edges[0], edges[-1] = 1.0, 0.0
        return edges[:-1] - edges[1:]


@compiled(nogil=True)
def coordinate(sine, cosine, count, beyond, eta):
    """Return the coordinate x of `PolarGrid`."""
    edge = count - 0.5
    outer = eta * sine
    if outer < 1.0 or beyond == 0:
        x = np.arctan2(sine, cosine) if eta == 1.0 else np.arcsin(min(outer, 1.0))
        x = x * (2.0 / np.pi) * edge
    else:
        critical = np.arcsin(1.0 / eta)
        x = edge + beyond * np.sqrt(max(np.arctan2(sine, cosine) - critical, 0.0) / (0.5 * np.pi - critical))
    return min(max(x, 0.0), count + beyond - 1.0)


@compiled(nogil=True)
def _locate(w, grids, eta):
    """Return the side (0 above), the sine, the lower node and the fraction above it."""
    side = 0 if w[2] > 0.0 else 1
    sine = np.sqrt(w[0] ** 2 + w[1] ** 2)
    x = coordinate(sine, abs(w[2]), grids[side, 0], grids[side, 1], eta if side else 1.0)
    node = min(int(x), grids[side, 0] + grids[side, 1] - 2)
    return side, sine, node, x - node


@compiled(nogil=True)
def _corner(number, a, b, fraction_a, fraction_b):
    """Return nodes and weight of a corner of the cell's triangle: symmetric, with fewer reads than bilinear."""
    if number == 0:
        return a, b, 1.0 - max(fraction_a, fraction_b)
    if number == 1:
        return a + 1, b + 1, min(fraction_a, fraction_b)
    if fraction_a > fraction_b:
        return a + 1, b, abs(fraction_a - fraction_b)
    return a, b + 1, abs(fraction_a - fraction_b)


@compiled(nogil=True, fastmath=True)
def _accumulate(table, row, weight, harmonics, out):
    for k in range(table.shape[1]):
        c = weight * harmonics[k]  # double precision: single sums would break reciprocity at 1e-7
        for l in range(table.shape[2]):
            out[l] += c * table[row, k, l]


@compiled(nogil=True)
def _combine(wi, wo, smooth, unordered, grid, spectrum, out):
    """Multiply `smooth` by the structure factor, add `unordered`, and scale to f; negative series values count as 0."""
    last_cos, eta = grid
    wavenumbers, index, step, s = spectrum
    gi, go = (0 if wi[2] > 0.0 else 1), (0 if wo[2] > 0.0 else 1)
    sin_i, sin_o = np.sqrt(wi[0] ** 2 + wi[1] ** 2), np.sqrt(wo[0] ** 2 + wo[1] ** 2)
    dot = wi[0] * wo[0] + wi[1] * wo[1]
    scale = eta * eta if go else 1.0
    # beyond the last node f decreases to zero like the cosine
    scale *= min(abs(wi[2]) / last_cos[gi], 1.0) * min(abs(wo[2]) / last_cos[go], 1.0)
    last = s.size - 1
    for l in range(out.size):
        ni, no = (index[l] if gi else 1.0), (index[l] if go else 1.0)
        q2 = (ni * sin_i) ** 2 + (no * sin_o) ** 2 + 2.0 * ni * no * dot
        x = wavenumbers[l] * np.sqrt(max(q2, 0.0)) / step
        j = int(x)
        factor = 1.0 if j >= last else s[j] + (x - j) * (s[j + 1] - s[j])
        out[l] = scale * (max(smooth[l], 0.0) * factor + max(unordered[l], 0.0))


@dataclass(frozen=True)
class MonolayerLobe(Lobe):
    """Diffuse light of a monolayer, tabulated over the polar angles of both directions.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        count_above, count_below, count_beyond: `PolarGrid` nodes above and below; 0 below an opaque surface.
        eta: substrate index over the ambient's, one number, as for the specular lobe.
        wavenumbers: `[wavelength]`, the ambient's k, 1/nm.
        index_below: `[wavelength]`, substrate index over the ambient's; ones for an opaque surface.
        q_step: step of `structure` in 1/nm, from 0.
        structure: `[q]`, the structure factor; 1 beyond the table.
    """

    wavelengths_nm: Array
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
        "wavenumbers": "wavelength",
        "index_below": "wavelength",
        "structure": "q",
    }

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
        """Node counts up to the critical angle and beyond, `[side, 2]`, for the kernels."""
        return np.array([[self.count_above, 0], [self.count_below, self.count_beyond]])

    @property
    def last_cosines(self) -> Array:
        """Cosines of the last nodes above and below, `[2]`; f decreases to zero beyond."""
        sides = (PolarGrid(self.count_above), self.grid_below)
        return np.array([np.cos(side.nodes[-1]) if side.size else 1.0 for side in sides])

    def check_grids(self, wavelengths: int) -> None:
        """Check the data that both lobes share.

        Args:
            wavelengths: wavelength count of the tables.

        Raises:
            ValueError: names the inconsistent part.
        """
        below = self.count_below + self.count_beyond
        if self.count_above < 2 or (below and self.count_below < 2) or self.count_beyond < 0 or not self.eta >= 1.0:
            raise ValueError(f"the {self.kind} lobe needs two angles a side and eta >= 1")
        if wavelengths != len(self.wavelengths_nm) or not self.q_step > 0 or len(self.structure) < 2:
            raise ValueError("wavelengths or structure do not fit")
        if self.wavenumbers.shape != self.wavelengths_nm.shape or self.index_below.shape != self.wavelengths_nm.shape:
            raise ValueError("wavenumbers or index_below do not fit")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f, `[..., wavelength]`, 1/sr, for unit vectors `[..., 3]`; zero below an opaque surface."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        out = np.zeros((wi.size // 3, len(self.wavelengths_nm)))
        flat_i, flat_o = np.ascontiguousarray(wi).reshape(-1, 3), np.ascontiguousarray(wo).reshape(-1, 3)
        self._evaluate(flat_i, flat_o, out)
        return out.reshape(*wi.shape[:-1], -1)

    @abc.abstractmethod
    def _evaluate(self, wi: Array, wo: Array, out: Array) -> None:
        """Fill `out[n, wavelength]` for directions `[n, 3]`."""

    @property
    def _grid(self) -> tuple[Array, float]:
        return self.last_cosines, float(self.eta)

    @property
    def _spectrum(self) -> tuple[Array, Array, float, Array]:
        return self.wavenumbers, self.index_below, float(self.q_step), self.structure


@compiled(nogil=True)
def _evaluate_harmonic(wi, wo, tables, free, grids, grid, spectrum, out):
    """Fill `out`; `tables` and `free` are the pairs above, across and below."""
    harmonics, count, eta = tables[0].shape[1], tables[0].shape[2], grid[1]
    cosines = np.empty(harmonics)
    smooth, unordered = np.empty(count), np.empty(count)
    above = grids[0, 0] + grids[0, 1]
    for n in range(wi.shape[0]):
        is_above = wi[n, 2] > 0.0 and wo[n, 2] > 0.0
        if wi[n, 2] == 0.0 or wo[n, 2] == 0.0 or (tables[1].shape[0] == 0 and not is_above):
            continue
        gi, sin_i, i0, fi = _locate(wi[n], grids, eta)
        go, sin_o, o0, fo = _locate(wo[n], grids, eta)
        dot = wi[n, 0] * wo[n, 0] + wi[n, 1] * wo[n, 1]
        size = sin_i * sin_o
        # dphi is the angle between the in-plane wavevectors, -wi and wo
        c = min(max(-dot / size, -1.0), 1.0) if size > 1e-14 else 1.0
        cosines[0] = 1.0
        if harmonics > 1:
            cosines[1] = c
        for k in range(2, harmonics):
            cosines[k] = 2.0 * c * cosines[k - 1] - cosines[k - 2]
        smooth[:] = 0.0
        unordered[:] = 0.0
        for number in range(3):
            a, b, weight = _corner(number, i0, o0, fi, fo)
            if weight == 0.0:
                continue
            if gi != go:
                row = a * above + b if gi else b * above + a
            else:
                row = max(a, b) * (max(a, b) + 1) // 2 + min(a, b)
            _accumulate(tables[gi + go], row, weight, cosines, smooth)
            if free[gi + go].shape[0]:
                _accumulate(free[gi + go], row, weight, cosines, unordered)
        _combine(wi[n], wo[n], smooth, unordered, grid, spectrum, out[n])


@dataclass(frozen=True)
class Harmonic(MonolayerLobe):
    """Diffuse reflection, and transmission if `across` is not empty, of a monolayer of particles.

    Tables are float32 and hold f / n_o^2, which is symmetric in the two directions: `above` and `below` store one
    triangle (row i (i+1)/2 + j, j <= i), `across` has rows below * count_above + above. The `_free` tables
    hold the light without the factor S (from the particle size distribution); empty for equal particles.

    Attributes:
        above, below, across: `[pair, harmonic, wavelength]`, 1/sr.
        above_free, below_free, across_free: the same, or empty.
        the others: see `MonolayerLobe`.
    """

    kind: ClassVar[str] = "harmonic"
    above: SingleArray
    below: SingleArray
    across: SingleArray
    above_free: SingleArray
    below_free: SingleArray
    across_free: SingleArray

    AXES: ClassVar[dict[str, str]] = MonolayerLobe.AXES | {
        "above": "pair harmonic wavelength",
        "below": "pair harmonic wavelength",
        "across": "pair harmonic wavelength",
    }

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
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

    def _evaluate(self, wi: Array, wo: Array, out: Array) -> None:
        tables = _of_one_type(self.above, self.across, self.below)
        free = _of_one_type(self.above_free, self.across_free, self.below_free)
        _evaluate_harmonic(wi, wo, tables, free, self.grids, self._grid, self._spectrum, out)


def _of_one_type(*tables: NDArray) -> tuple[NDArray, ...]:
    """Return read-only contiguous views with one dtype: numba indexes only tuples of equal types by a variable."""
    dtype = np.result_type(*tables)
    views = tuple(np.ascontiguousarray(table, dtype).view() for table in tables)
    for view in views:
        view.flags.writeable = False
    return views


def pack_triangle(full: NDArray) -> SingleArray:
    """Return the lower triangle of a symmetric `[s, i, ...]` array as `[pair, ...]`, float32."""
    rows, columns = np.tril_indices(full.shape[0])
    return np.ascontiguousarray(full[rows, columns], dtype=np.float32)


@compiled(nogil=True)
def _evaluate_aligned(wi, wo, table, orders, rotation, grids, grid, spectrum, out):
    terms, count, eta = table.shape[1], table.shape[2], grid[1]
    waves = np.empty(terms)
    smooth, unordered = np.empty(count), np.zeros(count)
    above = grids[0, 0] + grids[0, 1]
    for n in range(wi.shape[0]):
        is_above = wi[n, 2] > 0.0 and wo[n, 2] > 0.0
        if wi[n, 2] == 0.0 or wo[n, 2] == 0.0 or (grids[1, 0] == 0 and not is_above):
            continue
        gi, _, i0, fi = _locate(wi[n], grids, eta)
        go, _, o0, fo = _locate(wo[n], grids, eta)
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
        for number in range(3):
            a, b, weight = _corner(number, high, low, fh, fl)
            if weight != 0.0:
                _accumulate(table, a * (a + 1) // 2 + b, weight, waves, smooth)
        _combine(wi[n], wo[n], smooth, unordered, grid, spectrum, out[n])


@dataclass(frozen=True)
class Aligned(MonolayerLobe):
    """Diffuse reflection, and transmission with nodes below, of a monolayer of aligned particles.

    Attributes:
        table: `[pair, term, wavelength]`, f / n_o^2 in 1/sr; row a (a + 1)/2 + b for nodes a >= b, nodes below
            after those above.
        orders: `[term, 3]`: integers a_t, b_t for the azimuths at the nodes a and b, and 0 (cosine) or 1 (sine).
        rotation: the particles' rotation about the normal, rad, from +x to +y.
        the others: see `MonolayerLobe`.
    """

    kind: ClassVar[str] = "aligned"
    table: SingleArray
    orders: Array
    rotation: float

    AXES: ClassVar[dict[str, str]] = MonolayerLobe.AXES | {"table": "pair term wavelength", "orders": "term order"}

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
        """
        self.check_grids(self.table.shape[-1])
        nodes = self.count_above + self.count_below + self.count_beyond
        if self.table.ndim != 3 or len(self.table) != nodes * (nodes + 1) // 2:
            raise ValueError(f"table has the shape {self.table.shape}, for {nodes} angles")
        if self.orders.shape != (self.table.shape[1], 3) or not len(self.orders):
            raise ValueError(f"orders has the shape {self.orders.shape}, for {self.table.shape[1]} terms")
        is_valid = np.array_equal(self.orders, np.round(self.orders)) and np.abs(self.orders).max() <= HIGHEST_ORDER
        if not is_valid or not np.isin(self.orders[:, 2], (0, 1)).all() or not np.isfinite(self.rotation):
            raise ValueError(f"orders are not integers, or above {HIGHEST_ORDER}")

    def _evaluate(self, wi: Array, wo: Array, out: Array) -> None:
        orders, rotation = np.asarray(self.orders, dtype=float), float(self.rotation)
        _evaluate_aligned(wi, wo, self.table, orders, rotation, self.grids, self._grid, self._spectrum, out)


PACKET = 8  # numbers per load
WORD = 32
LEAST_BITS = 3
POWER_BITS = 4
DARKEST = 2**POWER_BITS - 1  # the smallest stored power of two
# numbers that share a word, for packets of two or four words: a large one beside small ones
SHARED = {2: ((0, 3, 5, 7), (1, 2, 4, 6)), 4: ((0, 7), (1, 6), (2, 5), (3, 4))}
DARKEST_SIZE = 1e-7  # relative size below which a number is dropped
RUNGS = 8  # size steps per factor of two
ROUNDING = 3e-3  # largest relative RMS error at any wavelength for two words


@dataclass(frozen=True)
class EncodedSeries:
    """Short cosine series packed in two or four 32-bit words, for random access on the device.

    Look-up time is bound by memory traffic, then by unpacking. The numbers of a series therefore share 32-bit words;
    larger numbers get more bits. The first word ends with a power of two, the series' scale relative to the largest
    series at its wavelength, so dark and bright series have the same relative precision. A field is read by shifting it
    to the top of its word and interpreting the word as a signed integer. The bits below are a known fraction of the
    field's last bit; the encoder chooses the field so that both together approximate the number best. Masks are
    therefore unnecessary.

    Attributes:
        words: `[row, wavelength, packet, word]`.
        units: unit of each number at power 0.
        fields: for each number: its word within the packet, lowest bit and bit count.
        rounding: largest relative RMS error over the wavelengths.
    """

    words: NDArray[np.uint32]
    units: Array
    fields: list[tuple[int, int, int]]
    rounding: float

    def numbers(self) -> Array:
        """Return the decoded numbers, `[row, number, wavelength]`."""
        return _decoded(self.words, self.units, self.fields)


def encode(rows: NDArray, packets: int | None = None) -> EncodedSeries:
    """Encode series `[row, number, wavelength]` with two words per packet if precise enough, else with four."""
    packets = -(-rows.shape[1] // PACKET) if packets is None else packets
    made = _encoded(rows, packets, 2)
    return made if made.rounding <= ROUNDING else _encoded(rows, packets, 4)


def _encoded(rows: NDArray, packets: int, words: int) -> EncodedSeries:
    count, count_numbers, wavelengths = rows.shape
    full = np.zeros((count, packets * PACKET, wavelengths))
    full[:, :count_numbers] = rows
    largest = 2.0 ** np.ceil(np.log2(max(float(np.abs(full).max()), 1e-30)))
    full /= largest
    size = np.abs(full).max(axis=1)
    power = np.clip(np.floor(-np.log2(np.maximum(size, 1e-30))), 0, DARKEST).astype(np.uint32)
    target, full = full, full * (2.0**power)[:, None]
    sizes = _rung(np.abs(full).max(axis=(0, 2)))
    packed = np.zeros((count, wavelengths, packets, words), dtype=np.uint32)
    packed[:, :, :, 0] = power[:, :, None]
    units, fields = [], []
    for j in range(packets):
        part = sizes[PACKET * j : PACKET * (j + 1)]
        places = {}
        for word, members in enumerate(SHARED[words]):
            low = POWER_BITS if word == 0 else 0
            bits = _shared_bits(part[list(members)], WORD - low)
            for number, share in list(zip(members, bits, strict=True))[::-1]:
                steps = full[:, PACKET * j + number] * (_top(share) / part[number] if part[number] else 0.0)
                _write(packed[:, :, j, word], steps, low, share)
                places[number] = (word, low, share)
                low += share
        for number in range(PACKET):
            fields.append(places[number])
            bit_count = places[number][2]
            units.append(part[number] / _top(bit_count) * 2.0 ** (bit_count - WORD))
    error = _decoded(packed, np.array(units), fields) - target
    wrong, total = (np.sqrt(np.sum(x**2, axis=(0, 1))) for x in (error, target))
    rounding = float(np.max(wrong / np.maximum(total, 1e-30)))
    return EncodedSeries(packed, np.array(units) * largest, fields, rounding)


def _decoded(words: NDArray[np.uint32], units: Array, fields: list[tuple[int, int, int]]) -> Array:
    scale = 2.0 ** -(words[:, :, 0, 0] & DARKEST).astype(float)
    out = np.empty((words.shape[0], len(fields), words.shape[1]))
    for k, (word, low, bits) in enumerate(fields):
        shifted = words[:, :, k // PACKET, word] << np.uint32(WORD - low - bits)
        out[:, k] = shifted.view(np.int32) * units[k] * scale
    return out


def _rung(sizes: Array) -> Array:
    """Return sizes rounded up to a geometric ladder, which makes them stable under rounding of the numbers."""
    rungs = 2.0 ** (np.ceil(RUNGS * np.log2(np.maximum(sizes, 1e-30)) - 1e-6) / RUNGS)
    return np.where(sizes > DARKEST_SIZE, rungs, 0.0)


def _top(bits: int) -> float:
    """Return a field's largest integer."""
    return 2.0 ** (bits - 1) - 1.0


def _shared_bits(sizes: Array, room: int) -> list[int]:
    """Return the bit counts of numbers in one word: one more bit for each factor of two in size."""
    needed = np.log2(np.maximum(sizes, 1e-9))
    bits = np.full(len(sizes), LEAST_BITS)
    for _ in range(room - LEAST_BITS * len(sizes)):
        bits[int(np.argmax(needed - bits))] += 1  # give the bit to the coarsest field
    return [int(b) for b in bits]


def _write(word: NDArray[np.uint32], target: Array, low: int, bits: int) -> None:
    """Add a field above the existing ones in a word; the field and the bits below together approximate `target`.

    The sum is limited to the field's largest integer: rounding never increases the size.
    """
    below = word.astype(np.float64) / 2.0**low if low else np.zeros(word.shape)
    top = _top(bits)
    field = np.clip(np.rint(target - below), -top, np.floor(top - below)).astype(np.int64)
    word |= ((field & ((1 << bits) - 1)) << low).astype(np.uint32)
