"""Packed cosine series (`nacre.bsdf.packed_series`) on the device."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.packed_series import DARKEST, PACKET, SHARED, WORD, encode
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import aligned, opaque


class PackedSeries:
    """Series coefficients `[row, number, wavelength]`, packed in integers `[row, wavelength, packet, word]`.

    Attributes:
        words: 32-bit words per packet.
        units: quantisation step of each coefficient; its harmonic is multiplied by it.
    """

    def __init__(self, rows: NDArray[np.float32], packets: int) -> None:
        if rows.shape[2] == 1:
            rows = np.repeat(rows, 2, axis=2)
        if math.prod((rows.shape[0], rows.shape[2], packets, 4)) >= 2**32:
            raise UnsupportedError("the harmonic table is too large for rendering; use fewer wavelengths")
        made = encode(rows, packets)
        self.words = made.words.shape[3]
        self.packets = packets
        self.units = [opaque(unit) for unit in made.units]
        self.places = [word for word, _, _ in made.fields]
        self.on_device = dr.is_jit_v(mi.Float)
        shifts = [WORD - low - bits for _, low, bits in made.fields]
        # fields at the top of a word, known from the layout, need no shift
        tops = [members[0] for members in SHARED[self.words]]
        self.shifts: list[Any] = [
            None if k % PACKET in tops else dr.opaque(mi.UInt32, s) if self.on_device else s
            for k, s in enumerate(shifts)
        ]
        flat = made.words.reshape(-1, self.words)
        self.values = mi.UInt32(aligned(flat, np.uint32)) if self.on_device else flat

    def read(self, index: Any, packet: int, active: Any) -> tuple[list[Any], Any]:
        """Return a packet's numbers, in `units`, and their common factor.

        Args:
            index: (row * wavelengths + wavelength) * packets + packet.
            packet: number of the packet within the series.
            active: mask.
        """
        here = slice(PACKET * packet, PACKET * (packet + 1))
        fields = list(zip(self.places[here], self.shifts[here], strict=True))
        if not self.on_device:
            if not active:
                return [0.0] * PACKET, 1.0
            words = [int(word) for word in self.values[int(index)]]
            numbers = [_signed((words[at] << (shift or 0)) & 0xFFFFFFFF) for at, shift in fields]
            return numbers, 2.0 ** -(words[0] & DARKEST)
        words = dr.gather(mi.ArrayXu, self.values, index, active, shape=(self.words, dr.width(index)))
        factor = dr.reinterpret_array(mi.Float, (127 - (words[0] & DARKEST)) << 23)  # a power of two from its bits
        return [mi.Float(mi.Int32(words[at] if shift is None else words[at] << shift)) for at, shift in fields], factor

    def sum(self, place: Any, harmonics: list[Any], active: Any) -> Any:
        """Return the sum of a series.

        Args:
            place: row * wavelengths + wavelength.
            harmonics: the harmonics, times `units`.
            active: mask.
        """
        total = mi.Float(0.0)
        for j in range(self.packets):
            numbers, factor = self.read(place * self.packets + j, j, active)
            part = mi.Float(0.0)
            for number, harmonic in zip(numbers, harmonics[PACKET * j : PACKET * (j + 1)], strict=True):
                part = dr.fma(number, harmonic, part)
            total = dr.fma(part, factor, total)
        return total


def _signed(word: int) -> float:
    return float(word - 2**WORD if word >= 2 ** (WORD - 1) else word)
