"""Exact sampling of bilinearly interpolated densities on unit squares, with one table read.

A density that is bilinear between nodes is a sum of tent functions. The alias method (Walker 1977, Vose 1991) chooses
a node, then a point is drawn from its tent; tents at an edge are folded inwards.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.device.plugin import device_array, larger, read4, smaller

CHANCES = 65535  # the largest 16-bit probability


class BilinearDensity:
    """Densities on the unit squares of several faces, tabulated for several rows and mixed between rows.

    Args:
        weights: node values, `[row, face, y, x]`, > 0, with any normalisation.
    """

    def __init__(self, weights: Array) -> None:
        rows, faces, height, width = weights.shape
        share = _edge_halves(height)[:, None] * _edge_halves(width)  # part of each tent inside
        chance = weights * share
        total = chance.sum(axis=(1, 2, 3), keepdims=True)
        density = weights / total * (height - 1) * (width - 1)
        near_far = [density[:, :, y : height - 1 + y, x : width - 1 + x] for y in (0, 1) for x in (0, 1)]
        self.cells = device_array(np.stack(near_far, axis=-1))
        self.columns = _columns((chance / total).reshape(rows, -1))
        self.rows, self.size = rows, (faces, height, width)

    def sample(self, row: Any, part: Any, number: Any, square: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Draw a unit square and a point in it.

        Returns the index of the square, x and y in [0, 1], and a uniform number that is made from the unused bits of
        `number`, with lower precision.

        Args:
            row: the lower of the two mixed rows, at most `rows - 2`.
            part: weight of the upper row, in [0, 1].
            number: uniform in [0, 1), for the square and the node.
            square: two uniform numbers, for the point about the node.
            active: mask.
        """
        faces, height, width = self.size
        nodes = faces * height * width
        upper = number < part
        number = dr.select(upper, number / larger(part, 1e-6), (number - part) / larger(1.0 - part, 1e-6))
        at = larger(smaller(number * nodes, nodes - 0.01), 0.0)
        column = mi.UInt32(at)
        number = at - mi.Float(column)
        word = self._column((row + dr.select(upper, mi.UInt32(1), 0)) * nodes + column, active)
        chance = mi.Float(word & CHANCES) * (1.0 / CHANCES)
        is_column = number < chance
        number = dr.select(is_column, number / larger(chance, 1e-6), (number - chance) / larger(1.0 - chance, 1e-6))
        node = dr.select(is_column, column, word >> 16)
        face, rest = node // (height * width), node % (height * width)
        x = _folded(mi.Float(rest % width) + _tent(square.x), width - 1)
        y = _folded(mi.Float(rest // width) + _tent(square.y), height - 1)
        return face, x, y, number

    def density(self, row: Any, part: Any, face: Any, x: Any, y: Any, active: Any) -> Any:
        """Return the density, whose integral over all faces is one."""
        faces, height, width = self.size
        u, v = x * (width - 1), y * (height - 1)
        i = larger(smaller(dr.floor(u), width - 2.0), 0.0)
        j = larger(smaller(dr.floor(v), height - 2.0), 0.0)
        cells = (height - 1) * (width - 1)
        cell = (row * faces + face) * cells + mi.UInt32(j) * (width - 1) + mi.UInt32(i)
        u, v = u - i, v - j
        found = []
        for step in (0, faces * cells):
            c = read4(self.cells, cell + step, active)
            found.append(dr.lerp(dr.lerp(c[0], c[1], u), dr.lerp(c[2], c[3], u), v))
        return dr.lerp(found[0], found[1], part)

    def _column(self, index: Any, active: Any) -> Any:
        if dr.is_jit_v(mi.Float):
            return dr.gather(mi.UInt32, self.columns, index, active)
        return int(self.columns[int(index)]) if active else 0


def _edge_halves(count: int) -> Array:
    share = np.ones(count)
    share[[0, -1]] = 0.5
    return share


def _tent(number: Any) -> Any:
    """Return a number in (-1, 1) with a tent density."""
    low = dr.sqrt(2.0 * number) - 1.0
    return dr.select(number < 0.5, low, 1.0 - dr.sqrt(larger(2.0 - 2.0 * number, 0.0)))


def _folded(x: Any, top: float) -> Any:
    """Fold numbers beyond either end back, and map [0, top] to [0, 1]."""
    x = dr.abs(x)
    return smaller(x, 2.0 * top - x) * (1.0 / top)


def _columns(chances: Array) -> Any:
    """Return each row's alias table, `[row, column]`: the column's probability in 16 bits, the alias above."""
    rows, count = chances.shape
    words = np.empty((rows, count), dtype=np.uint32)
    for row in range(rows):
        words[row] = _alias(chances[row] * count)
    flat = words.ravel()
    return mi.UInt32(flat) if dr.is_jit_v(mi.Float) else flat


def _alias(heights: Array) -> NDArray[np.uint32]:
    """Return Vose's alias table for probabilities times their number."""
    heights = heights.copy()
    keep, other = np.ones(len(heights)), np.arange(len(heights))
    small, large = list(np.nonzero(heights < 1.0)[0]), list(np.nonzero(heights >= 1.0)[0])
    while small and large:
        low, high = small.pop(), large[-1]
        keep[low], other[low] = heights[low], high
        heights[high] -= 1.0 - heights[low]
        if heights[high] < 1.0:
            small.append(large.pop())
    return np.asarray(np.rint(keep * CHANCES).astype(np.uint32) | (other.astype(np.uint32) << 16), dtype=np.uint32)
