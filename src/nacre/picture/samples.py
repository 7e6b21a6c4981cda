"""The random numbers of a picture: a low-discrepancy sequence for each pixel that goes on from pass to pass.

Mitsuba's samplers are stratified within one call of `mi.render` alone, and of a large picture a call holds one to four
samples a pixel. Here each pixel and dimension has Sobol's first two dimensions, shuffled and scrambled by hashing
(B. Burley, "Practical hash-based Owen scrambling", JCGT 9(4), 2020, which takes the permutation from S. Laine and
T. Karras, "Stratified sampling for stochastic transparency", 2011), at an index that counts on: the picture is the same
however its samples are divided into passes, and as even as if all had been taken at once.
"""

from __future__ import annotations

import functools
from typing import Any

from nacre.device.variant import use_variant

LAINE_KARRAS = (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)
GOLDEN, OFFSET = 0x9E3779B1, 0x7F4A7C15
AVALANCHE = ((16, 0x85EBCA6B), (13, 0xC2B2AE35), (16, 1))  # shifts and factors of MurmurHash3's end
PARTS = (0x55555555, 0x33333333, 0x0F0F0F0F, 0x00FF00FF, 0x0000FFFF)  # whose bit 0, 1, ... of the place is 0
TILE = 16  # pixels along a side of those that share a sequence


def going_on() -> Any:
    """Return a sampler for the sensors of a picture; `begin` tells it what the next call of `mi.render` takes."""
    mi = use_variant()
    if mi.variant().startswith("scalar"):  # its plugins in C++ alone are quick enough to be of use
        return mi.load_dict({"type": "multijitter"})
    return _class(mi.variant())(mi.Properties())


def begin(sampler: Any, seed: int, first: int, spp: int, total: int = 0, width: int = 0, alike: bool = False) -> int:
    """Let a sampler of `going_on` begin a pass; return the seed for `mi.render`.

    Args:
        seed: of the sequences, 32 bits.
        first: how many samples a pixel of these sequences are taken already.
        spp: samples a pixel of this pass.
        total: how many will be taken in all, where that is known: then neighbouring pixels share a sequence.
        width: of the picture, where `total` is given.
        alike: all pixels take the same numbers: what would be grain is one small error everywhere.
    """
    if not hasattr(sampler, "start"):
        return (seed + first * GOLDEN) & 0xFFFFFFFF
    sampler.start, sampler.key_seed, sampler.spp = first, seed & 0xFFFFFFFF, spp
    sampler.block, sampler.width = total, max(width, 1)  # shares without gaps: a tile's samples are one run of Sobol's
    sampler.alike = alike
    return 0


@functools.cache
def _class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()
    whole = mi.UInt32

    def mixed(a: Any, b: Any) -> Any:
        h = a ^ (b * whole(GOLDEN) + whole(OFFSET))
        for shift, factor in AVALANCHE:
            h = (h ^ (h >> shift)) * whole(factor)
        return h

    def scrambled(digits: Any, seed: Any) -> Any:
        """Owen's scrambling: each binary digit is flipped or not by a hash of those before it.

        The digits come in reversed order, the highest as bit 0.
        """
        x = digits + seed
        for factor in LAINE_KARRAS:
            x = x ^ (x * whole(factor))
        return dr.brev(x)

    def second(index: Any) -> Any:
        """Sobol's second dimension, its 32 binary digits in reversed order: Pascal's triangle modulo 2.

        Its entry for bits b and j is odd where j is a part of b, so five sums over supersets make it.
        """
        for bit, kept in enumerate(PARTS):
            index = index ^ ((index >> (1 << bit)) & whole(kept))
        return index

    def interleaved(column: Any, row: Any) -> Any:
        """A pixel's place in its tile along a Z."""
        found = whole(0)
        for bit in range(TILE.bit_length() - 1):
            found |= (((column >> bit) & 1) << (2 * bit)) | (((row >> bit) & 1) << (2 * bit + 1))
        return found

    def unit(x: Any) -> Any:
        return mi.Float(x >> 8) * (1.0 / (1 << 24))

    class GoingOn(mi.Sampler):
        """A sampler whose sequences do not end with a call of `mi.render`."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.start, self.key_seed, self.spp = 0, 0, 1
            self.block, self.width, self.first_pixel, self.alike = 0, 1, 0, False
            self.index, self.key, self.dimension = whole(0), whole(0), whole(0)
            self.own_key = whole(0)  # of the pixel, where the others take the same numbers

        def fork(self) -> Any:
            other = GoingOn(mi.Properties())
            other.start, other.key_seed, other.spp = self.start, self.key_seed, self.spp
            other.block, other.width, other.first_pixel = self.block, self.width, self.first_pixel
            other.alike = self.alike
            return other

        clone = fork

        def seed(self, seed: Any, wavefront_size: int = 0xFFFFFFFF) -> None:
            super().seed(seed, wavefront_size)
            lane = dr.arange(whole, wavefront_size)
            pixel = lane // dr.opaque(whole, self.spp)
            self.index = dr.opaque(whole, self.start) + (lane - pixel * dr.opaque(whole, self.spp))
            pixel += dr.opaque(whole, self.first_pixel)  # of a band, in the whole picture
            if self.alike:
                pixel = dr.zeros(whole, wavefront_size)
            elif self.block:
                # pixels of a tile along a Z, each with its share of the tile's sequence
                row = pixel // dr.opaque(whole, self.width)
                column = pixel - row * dr.opaque(whole, self.width)
                self.index += dr.opaque(whole, self.block) * interleaved(column, row)
                tiles = dr.opaque(whole, (self.width + TILE - 1) // TILE)
                pixel = (row // TILE) * tiles + column // TILE
            self.key = mixed(pixel, dr.opaque(whole, self.key_seed))
            self.own_key = mixed(dr.opaque(whole, self.first_pixel) + lane // dr.opaque(whole, self.spp), self.key)
            self.dimension = dr.zeros(whole, wavefront_size)

        def schedule_state(self) -> None:
            dr.schedule(self.index, self.key, self.dimension, self.own_key)

        def advance(self) -> None:
            raise NotImplementedError("begin() and another call of mi.render take its place")

        def _next(self, of_pixel: bool = False) -> tuple[Any, Any]:
            key = mixed(self.own_key if of_pixel else self.key, self.dimension)
            self.dimension = self.dimension + 1
            return key, scrambled(dr.brev(self.index), key)  # each dimension has an order of its own

        def next_1d(self, active: Any = True, of_pixel: bool = False) -> Any:
            """Return a number; with `of_pixel` one of the pixel's own even where all pixels take the same numbers."""
            key, index = self._next(of_pixel)
            return unit(scrambled(index, mixed(key, whole(1))))

        def next_2d(self, active: Any = True, of_pixel: bool = False) -> Any:
            """Return a point of the unit square; see `next_1d`."""
            key, index = self._next(of_pixel)
            x = scrambled(index, mixed(key, whole(1)))
            return mi.Point2f(unit(x), unit(scrambled(second(index), mixed(key, whole(2)))))

        def several_2d(self, many: Any) -> Any:
            """Return a function of a number below `many` that gives a point; they take the place of one `next_2d`.

            The points of all samples of a pixel are one run of Sobol's: as even as if each were a sample's own.
            """
            key = mixed(mixed(self.key, self.dimension), many)
            self.dimension = self.dimension + 1
            first = self.index * many

            def point(number: Any) -> Any:
                index = scrambled(dr.brev(first + number), key)
                x = scrambled(index, mixed(key, whole(1)))
                return mi.Point2f(unit(x), unit(scrambled(second(index), mixed(key, whole(2)))))

            return point

    return GoingOn
