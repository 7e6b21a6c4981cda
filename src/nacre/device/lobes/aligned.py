"""The diffuse light of aligned particles on the device: a series in both azimuths times the sharp structure factor.

All but the series is as for particles that look the same at any turn, see `harmonic`. Directions are drawn from a table
of exits that knows the azimuths' difference alone, of values averaged over the turn: the density is that of the draws,
and only the weights vary with the turn.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.arrays import Array
from nacre.bsdf.lobes.aligned import Aligned
from nacre.bsdf.series_words import PACKET
from nacre.device.base import larger, opaque, smaller
from nacre.device.lobes.harmonic import MonolayerPlugin, interpolated, tetrahedron, thinned_rows
from nacre.device.packed_series import PackedSeries
from nacre.errors import UnsupportedError

TURNS = 8  # azimuths of the light that the table of exits is averaged over


class AlignedPlugin(MonolayerPlugin[Aligned]):
    """Broad reflection, and transmission if the lobe transmits."""

    kind = "aligned"
    tables = ("table",)
    is_turned = True

    def _set_tables(self, lobe: Aligned) -> None:
        self.orders = np.asarray(np.rint(lobe.orders), dtype=int)
        self.packets = -(-lobe.table.shape[1] // PACKET)
        self.values = PackedSeries(lobe.table, self.packets)
        self.cos_turn, self.sin_turn = opaque(math.cos(lobe.rotation)), opaque(math.sin(lobe.rotation))

    def _thinned(self, lobe: Aligned) -> Aligned:
        return dataclasses.replace(lobe, **thinned_rows(lobe, self.tables))

    def _mean(self, lobe: Aligned, light: Array, eye: Array) -> Array:
        """Return f averaged over wavelengths, turns and mirror images, `[...]`, of directions `[..., 3]`."""
        total = np.zeros(light.shape[:-1])
        for turn in np.arange(TURNS) * (2 * math.pi / TURNS):
            cos, sin = math.cos(turn), math.sin(turn)
            about = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            for mirror in ([1.0, 1.0, 1.0], [1.0, -1.0, 1.0]):
                total += lobe.evaluate(light * mirror @ about.T, eye * mirror @ about.T).mean(axis=-1)
        return total / (2 * TURNS)

    def _waves(self, one: list[tuple[Any, Any]], two: list[tuple[Any, Any]]) -> list[Any]:
        """Return the cosine or the sine of each term, of the powers of both directions' azimuths."""
        found = []
        for a, b, is_sine in self.orders.tolist():
            (cos_a, sin_a), (cos_b, sin_b) = one[abs(a)], two[abs(b)]
            sin_a, sin_b = (sin_a if a >= 0 else -sin_a), (sin_b if b >= 0 else -sin_b)
            if is_sine:
                found.append(dr.fma(sin_a, cos_b, cos_a * sin_b))
            else:
                found.append(dr.fma(cos_a, cos_b, -sin_a * sin_b))
        return found + [mi.Float(0.0)] * (PACKET * self.packets - len(found))

    def _powers(self, w: Any, sine: Any) -> list[tuple[Any, Any]]:
        """Return cosine and sine of the multiples of an azimuth against the particles, from 0 on."""
        inverse = dr.rcp(larger(sine, 1e-12))
        x = dr.select(sine > 1e-12, w.x * inverse, 1.0)
        y = dr.select(sine > 1e-12, w.y * inverse, 0.0)
        cos, sin = dr.fma(x, self.cos_turn, y * self.sin_turn), dr.fma(y, self.cos_turn, -x * self.sin_turn)
        found = [(mi.Float(1.0), mi.Float(0.0)), (cos, sin)]
        for _ in range(2, int(np.abs(self.orders[:, :2]).max()) + 1):
            before, now = found[-2], found[-1]
            found.append((2.0 * cos * now[0] - before[0], 2.0 * cos * now[1] - before[1]))
        return found

    def _look_up(self, si: Any, light: Any, eye: Any, active: Any) -> Any:
        """Interpolate f at the four wavelengths."""
        sin_l = dr.sqrt(light.x * light.x + light.y * light.y)
        sin_e = dr.sqrt(eye.x * eye.x + eye.y * eye.y)
        dot = light.x * eye.x + light.y * eye.y
        low_l, part_l = self._coordinate(light, sin_l)
        low_e, part_e = self._coordinate(eye, sin_e)
        up_l, up_e = light.z > 0.0, eye.z > 0.0
        where = self.axis.locate(si.wavelengths, active)
        # the first direction of a pair is the one with the higher node, in the whole triangle that holds the point
        is_first = (low_l > low_e) | ((low_l == low_e) & (part_l >= part_e))
        powers_l, powers_e = self._powers(light, sin_l), self._powers(eye, sin_e)
        one = [tuple(dr.select(is_first, a, b) for a, b in zip(p, q)) for p, q in zip(powers_l, powers_e)]
        two = [tuple(dr.select(is_first, b, a) for a, b in zip(p, q)) for p, q in zip(powers_l, powers_e)]
        waves = self._waves(one, two)
        high, low = dr.select(is_first, low_l, low_e), dr.select(is_first, low_e, low_l)
        part_h, part_w = dr.select(is_first, part_l, part_e), dr.select(is_first, part_e, part_l)
        first = part_h > part_w
        step_h, step_w = dr.select(first, mi.UInt32(1), mi.UInt32(0)), dr.select(first, mi.UInt32(0), mi.UInt32(1))
        steps = [(0, 0), (step_h, step_w), (1, 1)]
        rows = [_row(high + to_h, low + to_w) * self.nodes for to_h, to_w in steps]
        upper, lower = larger(part_h, part_w), smaller(part_h, part_w)
        series = [wave * unit for wave, unit in zip(waves, self.values.units, strict=True)]
        squares = self._squares(sin_l, sin_e, dot, up_l, up_e)
        result = mi.Spectrum(0.0)
        for k, (node, part) in enumerate(zip(where.low, where.fraction, strict=True)):
            corners = tetrahedron([row + node for row in rows], upper, lower, part)
            value = interpolated(self.values, corners, series, active)
            result[k] = value * self._structure(si.wavelengths[k], node, part, squares, active)
        return result * (self._fall(light, up_l, 1.0) * self._fall(eye, up_e, self.eta * self.eta))

    def update(self, lobe: Aligned) -> None:
        """Take over the numbers of another monolayer.

        Raises:
            UnsupportedError: the shape of its tables, or the terms of its series, differ.
        """
        if not np.array_equal(np.rint(lobe.orders), self.orders):
            raise UnsupportedError("the series over the azimuths changed its terms; build the scene again")
        super().update(lobe)


def _row(a: Any, b: Any) -> Any:
    """Return the row of a pair of nodes, of which the first is the higher."""
    return ((a * (a + 1)) >> 1) + b
