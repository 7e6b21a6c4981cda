"""Short cosine series in two or four words each, for tables that are read at random.

A look-up is bound by the memory that it touches, and then by what it takes to unpack it. So the numbers of a series
share 32-bit words, the larger ones with more bits, and the first word ends with a power of two by which all of them
are smaller than the largest series of their wavelength: what is dark is kept as finely as what is bright. A field is
read by shifting it to the top of its word and taking the whole word as one signed number: what lies below it is then a
fraction of its last bit, known when it was written, and the field was chosen so that both together come nearest to the
number. No mask is needed, and no bit is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array

PACKET = 8  # numbers of a series in one load
WORD = 32
LEAST_BITS = 3
POWER_BITS = 4
DARKEST = 2**POWER_BITS - 1  # the smallest power of two that is kept
# numbers that share a word, where two or four words hold a packet: a large one beside small ones
SHARED = {2: ((0, 3, 5, 7), (1, 2, 4, 6)), 4: ((0, 7), (1, 6), (2, 5), (3, 4))}
DARKEST_SIZE = 1e-7  # of a number over the largest of its series: below, it is left out
RUNGS = 8  # sizes in a factor of two
ROUNDING = 3e-3  # root mean square error over that of the series, at any wavelength: up to here two words do


@dataclass(frozen=True)
class SeriesWords:
    """Tables of series as words.

    Attributes:
        words: `[row, wavelength, packet, word]`.
        units: of each number of a series of the power 0; those of the higher ones are small.
        fields: of each number of a series: its word within the packet, lowest bit and bits.
        rounding: largest root mean square error of a wavelength, over that of its series.
    """

    words: NDArray[np.uint32]
    units: Array
    fields: list[tuple[int, int, int]]
    rounding: float

    def numbers(self) -> Array:
        """Return the numbers that the words stand for, `[row, number, wavelength]`."""
        return _decoded(self.words, self.units, self.fields)


def encode(rows: NDArray, packets: int | None = None) -> SeriesWords:
    """Put series `[row, number, wavelength]` into two words a packet where these are exact enough, else into four."""
    packets = -(-rows.shape[1] // PACKET) if packets is None else packets
    made = _encoded(rows, packets, 2)
    return made if made.rounding <= ROUNDING else _encoded(rows, packets, 4)


def _encoded(rows: NDArray, packets: int, words: int) -> SeriesWords:
    count, kept, wavelengths = rows.shape
    full = np.zeros((count, packets * PACKET, wavelengths))
    full[:, :kept] = rows
    largest = 2.0 ** np.ceil(np.log2(max(float(np.abs(full).max()), 1e-30)))
    full /= largest
    size = np.abs(full).max(axis=1)
    power = np.clip(np.floor(-np.log2(np.maximum(size, 1e-30))), 0, DARKEST).astype(np.uint32)
    wanted, full = full, full * (2.0**power)[:, None]
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
            bits_kept = places[number][2]
            units.append(part[number] / _top(bits_kept) * 2.0 ** (bits_kept - WORD))
    error = _decoded(packed, np.array(units), fields) - wanted
    wrong, whole = (np.sqrt(np.sum(x**2, axis=(0, 1))) for x in (error, wanted))
    rounding = float(np.max(wrong / np.maximum(whole, 1e-30)))
    return SeriesWords(packed, np.array(units) * largest, fields, rounding)


def _decoded(words: NDArray[np.uint32], units: Array, fields: list[tuple[int, int, int]]) -> Array:
    scale = 2.0 ** -(words[:, :, 0, 0] & DARKEST).astype(float)
    out = np.empty((words.shape[0], len(fields), words.shape[1]))
    for k, (word, low, bits) in enumerate(fields):
        shifted = words[:, :, k // PACKET, word] << np.uint32(WORD - low - bits)
        out[:, k] = shifted.view(np.int32) * units[k] * scale
    return out


def _rung(sizes: Array) -> Array:
    """Return sizes, rounded up to the next of a ladder: so they are still the same once their numbers are rounded."""
    rungs = 2.0 ** (np.ceil(RUNGS * np.log2(np.maximum(sizes, 1e-30)) - 1e-6) / RUNGS)
    return np.where(sizes > DARKEST_SIZE, rungs, 0.0)


def _top(bits: int) -> float:
    """The largest whole number of a field."""
    return 2.0 ** (bits - 1) - 1.0


def _shared_bits(sizes: Array, room: int) -> list[int]:
    """Return bits for numbers of these sizes in one word, one more for each factor of two."""
    wish = np.log2(np.maximum(sizes, 1e-9))
    bits = np.full(len(sizes), LEAST_BITS)
    for _ in range(room - LEAST_BITS * len(sizes)):
        bits[int(np.argmax(wish - bits))] += 1  # to the one that rounds coarsest
    return [int(b) for b in bits]


def _write(word: NDArray[np.uint32], wanted: Array, low: int, bits: int) -> None:
    """Put a field above those that a word holds already, so that it and they together come nearest to `wanted`.

    Together they stay within the field's largest number, so that what was rounded is not larger than before.
    """
    below = word.astype(np.float64) / 2.0**low if low else np.zeros(word.shape)
    top = _top(bits)
    field = np.clip(np.rint(wanted - below), -top, np.floor(top - below)).astype(np.int64)
    word |= ((field & ((1 << bits) - 1)) << low).astype(np.uint32)
