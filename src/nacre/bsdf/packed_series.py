"""Short cosine series packed in two or four 32-bit words, for random access.

Look-up time is bound by memory traffic, then by unpacking. The numbers of a series therefore share 32-bit words;
larger numbers get more bits. The first word ends with a power of two, the series' scale relative to the largest
series at its wavelength, so dark and bright series have the same relative precision. A field is read by shifting it
to the top of its word and interpreting the word as a signed integer. The bits below are a known fraction of the
field's last bit; the encoder chooses the field so that both together approximate the number best. Masks are therefore
unnecessary.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array

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
    """Encoded tables of series.

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
            bits_kept = places[number][2]
            units.append(part[number] / _top(bits_kept) * 2.0 ** (bits_kept - WORD))
    error = _decoded(packed, np.array(units), fields) - target
    wrong, whole = (np.sqrt(np.sum(x**2, axis=(0, 1))) for x in (error, target))
    rounding = float(np.max(wrong / np.maximum(whole, 1e-30)))
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
    wish = np.log2(np.maximum(sizes, 1e-9))
    bits = np.full(len(sizes), LEAST_BITS)
    for _ in range(room - LEAST_BITS * len(sizes)):
        bits[int(np.argmax(wish - bits))] += 1  # to the coarsest field
    return [int(b) for b in bits]


def _write(word: NDArray[np.uint32], target: Array, low: int, bits: int) -> None:
    """Add a field above the existing ones in a word; the field and the bits below together approximate `target`.

    The sum is limited to the field's largest integer: rounding never increases the size.
    """
    below = word.astype(np.float64) / 2.0**low if low else np.zeros(word.shape)
    top = _top(bits)
    field = np.clip(np.rint(target - below), -top, np.floor(top - below)).astype(np.int64)
    word |= ((field & ((1 << bits) - 1)) << low).astype(np.uint32)
