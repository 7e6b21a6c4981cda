"""Glints on the device: the factor from `nacre.bsdf.glints`, with the same hash."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.bsdf.glints import CELLS_U, CELLS_V, COUNT, COVERAGE, DRAWS, FLAKE_STEP, SEED, WIDTH
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.lobes.platelet_layer import PlateletLayer
from nacre.core.arrays import Array
from nacre.device.plugin import UniformNodes, device_array, opaque, opaque_int, read

WORD = 0xFFFFFFFF
FLATTEST = 1e-4  # lower limit of |z|: the slope of an in-plane normal is infinite
WIDE = 1e3  # uv footprint that marks unresolved flakes


def without_glints(si: Any, where: Any) -> Any:
    """Return a copy of an interaction that uses the mean over the flakes for lanes in `where`.

    Marked by a wide footprint; Mitsuba's default footprint is 0.
    """
    other = mi.SurfaceInteraction3f(si)
    other.duv_dx = dr.select(where, mi.Vector2f(WIDE, 0.0), si.duv_dx)
    return other


def resolves_flakes(si: Any) -> Any:
    """Whether an interaction resolves single flakes; see `without_glints`."""
    return dr.abs(si.duv_dx.x) < WIDE


class DeviceGlints:
    """The resolved flakes of one stratum; all numbers are data."""

    def __init__(self, numbers: Array, radii: Array, ratio: Array) -> None:
        self.kinds = [_Kind(*row) for row in zip(numbers, radii, ratio, strict=True)]

    @staticmethod
    def of(lobe: PlateletLayer | Layered) -> DeviceGlints | None:
        """Return a lobe's glints, if any."""
        if lobe.glint_numbers is None:
            return None
        assert lobe.glint_radii is not None and lobe.glint_ratio is not None
        return DeviceGlints(lobe.glint_numbers, lobe.glint_radii, lobe.glint_ratio)

    def factor(self, kind: int, uv: Any, tx: Any, ty: Any, active: Any) -> Any:
        """Return a species' g at a point for the slope (tx, ty) over the flakes' deviation; see `nacre.bsdf.glints`."""
        return self.answers(kind, uv, tx, ty, active)[0] / self.mean(kind, tx, ty, active)

    def answers(self, kind: int, uv: Any, tx: Any, ty: Any, active: Any) -> tuple[Any, Any]:
        """Return the kernel sum over a species' discs at a point, and the number of these discs."""
        row = self.kinds[kind]

        def body(n: Any, total: Any, count: Any) -> tuple[Any, Any, Any]:
            holds, cx, cy = row.disc(n, uv, active)
            away = dr.square(tx - cx) + dr.square(ty - cy)
            total = total + dr.select(holds, dr.exp(-0.5 * away * row.per_width2), 0.0)
            return n + 1, total, count + dr.select(holds, 1.0, 0.0)

        state = (mi.UInt32(0), mi.Float(0.0), mi.Float(0.0))
        _, total, count = dr.while_loop(
            state, lambda n, total, count: mi.Bool(active) & (n < row.discs), body, ("n", "total", "count"),
            label="glints",
        )  # fmt: skip
        return total, count

    def mean(self, kind: int, tx: Any, ty: Any, active: Any) -> Any:
        """Return the surface mean of that sum."""
        row = self.kinds[kind]
        t2 = tx * tx + ty * ty
        t = dr.sqrt(t2)
        return row.read(row.ratio, t / (1.0 + t), active) * row.area / dr.square(1.0 + t2)

    def one_of(self, uv: Any, sample: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Draw one of the discs at a point.

        Returns:
            its species, the slope (x, y) of its normal over the deviation, and the number of discs at the point.
        """
        found = (mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0), mi.Float(sample))
        for k, row in enumerate(self.kinds):

            def body(
                n: Any, kind: Any, sx: Any, sy: Any, count: Any, left: Any, row: _Kind = row, k: int = k
            ) -> tuple[Any, ...]:
                holds, cx, cy = row.disc(n, uv, active)
                count = count + dr.select(holds, 1.0, 0.0)
                share = dr.rcp(dr.maximum(count, 1.0))  # reservoir sampling
                is_it = left < share
                rest = dr.select(is_it, left / share, (left - share) / dr.maximum(1.0 - share, 1e-6))
                left = dr.select(holds, dr.clip(rest, 0.0, dr.one_minus_epsilon(mi.Float)), left)
                is_it = is_it & holds
                kind = dr.select(is_it, mi.UInt32(k), kind)
                return n + 1, kind, dr.select(is_it, cx, sx), dr.select(is_it, cy, sy), count, left

            state = (mi.UInt32(0), *found)
            found = dr.while_loop(
                state, lambda n, *rest, row=row: mi.Bool(active) & (n < row.discs), body,
                ("n", "kind", "sx", "sy", "count", "left"), label="one glint",
            )[1:]  # fmt: skip
        return found[:4]

    def factor_of(self, slot: Any, axes: Any, m: Any, si: Any, active: Any) -> Any:
        """Return g for a normal in its flake's frame, with the semi-axes `axes` of that species."""
        active = active & resolves_flakes(si)
        z = dr.select(dr.abs(m.z) < FLATTEST, FLATTEST, m.z)
        tx, ty = m.x / (z * axes.x), m.y / (z * axes.y)
        total = mi.Float(1.0)
        for k in range(len(self.kinds)):
            mine = active & (slot == k)
            total = dr.select(mine, self.factor(k, si.uv, tx, ty, mine), total)
        return total


class _Kind:
    def __init__(self, numbers: Array, radii: Array, ratio: Array) -> None:
        self.cells_u, self.cells_v = opaque(numbers[CELLS_U]), opaque(numbers[CELLS_V])
        self.discs, self.seed = opaque_int(4 * int(numbers[COUNT])), opaque_int(int(numbers[SEED]))
        self.per_width2 = opaque(numbers[WIDTH] ** -2)
        self.width = opaque(numbers[WIDTH])
        self.area = opaque(2.0 * numbers[COVERAGE] * numbers[WIDTH] ** 2)
        self.radii, self.ratio = device_array(radii), device_array(ratio)
        self.nodes = UniformNodes(len(radii))

    def disc(self, n: Any, uv: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return whether the n-th disc near a point contains it, and the slope of its normal (x, y)."""
        x, y = uv.x * self.cells_u, uv.y * self.cells_v
        i = mi.Int32(dr.floor(x - 0.5)) + mi.Int32(n & 1)
        j = mi.Int32(dr.floor(y - 0.5)) + mi.Int32((n >> 1) & 1)
        key = mix(self.seed + (n >> 2) * FLAKE_STEP)
        key = mix(mix(key ^ _word(i)) + _word(j))
        dx, dy = x - mi.Float(i) - uniform(key, 0), y - mi.Float(j) - uniform(key, 1)
        share = uniform(key, 2)
        t = dr.sqrt(share / (1.0 - share))
        sine, cosine = dr.sincos(dr.two_pi * uniform(key, 3))
        radius = self.read(self.radii, uniform(key, 4), active)
        return dx * dx + dy * dy <= dr.square(radius), t * cosine, t * sine

    def read(self, table: Any, share: Any, active: Any) -> Any:
        """Interpolate one of the two tables."""
        low, part = self.nodes.cell(share * self.nodes.last)
        return dr.lerp(read(table, low, active), read(table, low + 1, active), part)


def mix(x: Any) -> Any:
    """Hash a number."""
    # the masks are for scalar variants, whose Python integers do not wrap
    x = x & WORD
    x = ((x ^ (x >> 16)) * 0x7FEB352D) & WORD
    x = ((x ^ (x >> 15)) * 0x846CA68B) & WORD
    return x ^ (x >> 16)


def _word(x: Any) -> Any:
    """Return a signed number's bits."""
    return mi.UInt32(x) if dr.is_jit_v(mi.Float) else int(x) & WORD


def uniform(key: Any, draw: int) -> Any:
    """Return one of a flake's random numbers, in [0, 1)."""
    return mi.Float(mix(key + DRAWS[draw]) >> 8) * 5.9604644775390625e-08
