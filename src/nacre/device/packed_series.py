"""Tables of short cosine series on the device, in as few bits as their size asks for.

A look-up is bound by the memory that it touches, and then by what it takes to unpack it. So the numbers of a series
share 32-bit words, the larger ones with more bits. A field is read by shifting it to the top of its word and taking
the whole word as one signed number: what lies below it is then a fraction of its last bit, known when it was written,
and the field was chosen so that both together come nearest to the number. No mask is needed, and no bit is lost.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.device.base import aligned, device_array, opaque, read2
from nacre.errors import UnsupportedError

PACKET = 8  # numbers of a series in one load
WORD = 32
LEAST_BITS = 3
# numbers that share a word, where two or four words hold a packet: a large one beside small ones
SHARED = {2: ((0, 3, 5, 7), (1, 2, 4, 6)), 4: ((0, 7), (1, 6), (2, 5), (3, 4))}
ROUNDING = 4e-5  # of the largest value, all numbers of a series together: up to here two words do


class PackedSeries:
    """A table `[row, number, wavelength]` as words `[row, wavelength, packet, word]`.

    Attributes:
        words: 32-bit words of a packet.
        units: of each number, to be multiplied by what it multiplies; the higher ones are small.
        scales: of the two ends of each interval of wavelengths.
    """

    def __init__(self, tables: list[NDArray[np.float32]], packets: int) -> None:
        rows = np.concatenate([t for t in tables if t.shape[0]])
        if rows.shape[2] == 1:
            rows = np.repeat(rows, 2, axis=2)
        count, kept, wavelengths = rows.shape
        largest = np.maximum(np.abs(rows).max(axis=0), np.float32(1e-30)).astype(float)
        sizes = np.zeros(packets * PACKET)
        sizes[:kept] = (largest / largest[0]).max(axis=1)
        self.words = next((w for w in SHARED if _rounding(sizes, w) <= ROUNDING), max(SHARED))
        shape = (count, wavelengths, packets, self.words)
        if math.prod(shape) >= 2**32:
            raise UnsupportedError("the harmonic table is too large to be rendered; give fewer wavelengths")
        packed = np.zeros(shape, dtype=np.uint32)
        units, shifts = [], []
        for j in range(packets):
            part = slice(PACKET * j, PACKET * (j + 1))
            fields = _fields(sizes[part], self.words)
            for word, members in enumerate(fields):
                for number, low, bits in members:
                    k = PACKET * j + number
                    if k < kept:
                        wanted = rows[:, k] * (_top(bits) / (max(sizes[k], 1e-30) * largest[0]))
                        _write(packed[:, :, j, word], wanted, low, bits)
            places = {number: (low, bits) for members in fields for number, low, bits in members}
            for number in range(PACKET):
                low, bits = places[number]
                shifts.append(WORD - low - bits)
                units.append(sizes[part][number] / _top(bits) * 2.0 ** (bits - WORD))
        self.packets = packets
        self.units = [opaque(unit) for unit in units]
        self.scales = device_array(np.stack([largest[0][:-1], largest[0][1:]], axis=1))
        self.on_device = dr.is_jit_v(mi.Float)
        flat = packed.reshape(-1, self.words)
        self.shifts = [dr.opaque(mi.UInt32, s) if self.on_device else s for s in shifts]
        self.values = mi.UInt32(aligned(flat, np.uint32)) if self.on_device else flat

    def read(self, index: Any, packet: int, active: Any) -> list[Any]:
        """Return the numbers of a packet, which `units` and `scales` make true to size.

        Args:
            index: (row * wavelengths + wavelength) * packets + packet.
            packet: which of the series' packets it is.
            active: mask.
        """
        shifts = self.shifts[PACKET * packet : PACKET * (packet + 1)]
        if not self.on_device:
            if not active:
                return [0.0] * PACKET
            words = [int(word) for word in self.values[int(index)]]
            return [_signed((words[at] << shift) & 0xFFFFFFFF) for at, shift in zip(self._word_of, shifts)]
        words = dr.gather(mi.ArrayXu, self.values, index, active, shape=(self.words, dr.width(index)))
        return [mi.Float(mi.Int32(words[at] << shift)) for at, shift in zip(self._word_of, shifts, strict=True)]

    @property
    def _word_of(self) -> list[int]:
        return [next(w for w, members in enumerate(SHARED[self.words]) if n in members) for n in range(PACKET)]

    def sum(self, row: Any, low: Any, count: Any, harmonics: list[Any], active: Any) -> tuple[Any, Any]:
        """Return the series of a row at a wavelength's lower node and the next, without `scales`.

        Args:
            row: of the table.
            low: the lower node.
            count: wavelengths of the table.
            harmonics: what the numbers multiply, times `units`.
            active: mask.
        """
        at = (row * count + low) * self.packets
        ends = []
        for end in range(2):
            total = mi.Float(0.0)
            for j in range(self.packets):
                numbers = self.read(at + (end * self.packets + j), j, active)
                for number, harmonic in zip(numbers, harmonics[PACKET * j : PACKET * (j + 1)], strict=True):
                    total = dr.fma(number, harmonic, total)
            ends.append(total)
        return ends[0], ends[1]

    def between(self, near: Any, far: Any, low: Any, part: Any, active: Any) -> Any:
        """Interpolate between the two ends of an interval of wavelengths, to size."""
        ends = read2(self.scales, low, active)
        return dr.lerp(near * ends[0], far * ends[1], part)


def _top(bits: int) -> float:
    """The largest whole number of a field."""
    return 2.0 ** (bits - 1) - 1.0


def _signed(word: int) -> float:
    return float(word - 2**WORD if word >= 2 ** (WORD - 1) else word)


def _fields(sizes: Array, words: int) -> list[list[tuple[int, int, int]]]:
    """Share out the bits of each word: (number, lowest bit, bits), from the lowest field up."""
    out = []
    for members in SHARED[words]:
        bits = _shared_bits(sizes[list(members)])
        low, fields = 0, []
        for number, count in list(zip(members, bits, strict=True))[::-1]:
            fields.append((number, low, count))
            low += count
        out.append(fields)
    return out


def _shared_bits(sizes: Array) -> list[int]:
    """Return bits for numbers of these sizes in one word, one more for each factor of two."""
    wish = np.log2(np.maximum(sizes, 1e-9))
    bits = np.full(len(sizes), LEAST_BITS)
    for _ in range(WORD - LEAST_BITS * len(sizes)):
        bits[int(np.argmax(wish - bits))] += 1  # to the one that rounds coarsest
    return [int(b) for b in bits]


def _rounding(sizes: Array, words: int) -> float:
    """The largest error of a series of numbers of these sizes, over that of the first."""
    total = 0.0
    for start in range(0, len(sizes), PACKET):
        part = sizes[start : start + PACKET]
        for members in _fields(part, words):
            total += sum(0.5 * part[number] / _top(bits) for number, _, bits in members)
    return total


def _write(word: NDArray[np.uint32], wanted: Array, low: int, bits: int) -> None:
    """Put a field above those that a word holds already, so that it and they together come nearest to `wanted`."""
    below = word.astype(np.float64) / 2.0**low if low else 0.0
    top = int(_top(bits))
    field = np.clip(np.rint(wanted - below), -top - 1, top).astype(np.int64)
    word |= ((field & ((1 << bits) - 1)) << low).astype(np.uint32)
