"""Light on its way through strata, and the flakes that it meets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.device.tables import Located
from nacre.device.walk.exit_importance import Exit
from nacre.device.walk.strata import DENSITY, PER_AXES, Strata

TINY = 1e-12
BY_NOTHING, BY_FLAKE, BY_MORE = range(3)
FULL = 4.0  # summed throughput of the four wavelengths when light enters


@dataclass
class Walker:
    """A walker: direction of travel, stratum, depth in it, throughput of each wavelength.

    With glints `turn` tells what turned it: nothing yet, one flake of the uppermost stratum (with its normal in its
    own frame and its kind), or anything else; without glints it is empty.
    """

    d: Any
    stratum: Any
    depth: Any
    f: Any
    turn: tuple[Any, ...] = ()

    def fresh(self, active: Any) -> Any:
        """Tell where glints are to be seen: on light that nothing has turned before; None without glints."""
        return active & (self.turn[0] == BY_NOTHING) & (self.stratum == 0) if self.turn else None


@dataclass
class Flake:
    """A flake that is met: its numbers; the light's way back, the axes, their product and its length, in its frame."""

    row: list[Any]
    v: Any
    axes: Any
    stretched: Any
    area: Any
    kind: Any
    slot: Any

    @staticmethod
    def of(strata: Strata, stratum: Any, row: list[Any], v: Any, slot: Any, active: Any) -> Flake:
        """Return the flake of a slot; `v` is the light's way back in its frame."""
        axes = mi.Vector3f(row[1], row[2], row[3])
        stretched = axes * v
        return Flake(row, v, axes, stretched, dr.norm(stretched), strata.kind_at(stratum, slot, active), slot)

    def normal(self, rng: Any, active: Any) -> tuple[Any, Any]:
        """Draw a normal in proportion to the area it shows; return it and its cosine."""
        point = mi.warp.square_to_uniform_sphere(mi.Point2f(rng.next_float32(active), rng.next_float32(active)))
        m = dr.normalize(self.axes * (self.stretched / self.area * (1 + 1e-6) + point))
        return m, dr.dot(self.v, m)

    def half(self, strata: Strata, to: Any) -> tuple[Any, Any]:
        """Return the normal that turns the light towards `to`, and its density; 0 for light that goes straight on."""
        half = self.v + strata.into_flake(self.row, to)
        length = dr.norm(half)
        h = half / dr.maximum(length, 1e-6)
        slope = dr.maximum(dr.squared_norm(h * mi.Vector3f(*self.row[PER_AXES])), TINY)
        density = self.row[DENSITY] / dr.square(slope)
        return h, dr.select(length > 1e-6, density, 0.0)

    def turned(self, strata: Strata, m: Any, v_m: Any) -> Any:
        """Return the direction of travel after reflection by a normal."""
        return dr.normalize(strata.from_flake(self.row, dr.fma(m, 2 * v_m, -self.v)))


def flake_gain(
    strata: Strata, connection: Exit, where: Located, light: Walker, depth: Any, flake: Flake, node: Any,
    way: Any, active: Any,
) -> Any:  # fmt: skip
    """Return D(h) R(|v.h|) / (4 sigma(v)) times what it is worth to the exit, with glints times their factor.

    Where two ways lead to the exit one is drawn by what it brings: R is read, and glints are looked for, once.

    Args:
        strata, connection, where: the material, the wanted exit, the wavelengths.
        light, depth: which light, and where in its stratum.
        flake: which flake.
        node, way: numbers in [0, 1), to choose a row of the table of R, and the way.
        active: mask.
    """
    to, worth = connection.upward(light.stratum, depth)
    h, density = flake.half(strata, to)
    if connection.has_down:
        to, other_worth = connection.downward(light.stratum, depth)
        other_h, other_density = flake.half(strata, to)
        up, down = density * dr.sum(worth), other_density * dr.sum(other_worth)
        p = up / dr.maximum(up + down, TINY)
        take = way < p
        h = dr.select(take, h, other_h)
        density = dr.select(take, density / p, other_density / (1 - p))
        worth = dr.select(take, worth, other_worth)
    reflect = strata.flake_response(flake.kind, dr.abs(dr.dot(flake.v, h)), node, where, active)[0]
    fresh = light.fresh(active)
    if fresh is not None and strata.glints is not None:
        density *= strata.glints.factor_of(flake.slot, flake.axes, h, where.site, fresh)
    return worth * reflect * (0.25 * density / flake.area)


def select(mask: Any, new: tuple[Any, ...], old: tuple[Any, ...]) -> tuple[Any, ...]:
    """Choose between two tuples of numbers."""
    return tuple(dr.select(mask, a, b) for a, b in zip(new, old, strict=True))


def spoilt(turn: tuple[Any, ...], by: Any) -> tuple[Any, ...]:
    """Return `Walker.turn` after something that is no single flake turned the light."""
    return (dr.select(by, mi.UInt32(BY_MORE), turn[0]), *turn[1:]) if turn else ()


def turned_by(light: Walker, flake: Flake, m: Any, turns: Any) -> tuple[Any, ...]:
    """Return `Walker.turn` after a flake with normal `m`, where it turns the light."""
    if not light.turn:
        return ()
    first = (mi.UInt32(BY_FLAKE), m.x, m.y, m.z, flake.slot)
    return select(light.fresh(turns), first, spoilt(light.turn, turns))


def two_numbers(rng: Any, active: Any) -> tuple[Any, Any]:
    """Return two uniform numbers of 16 bits by one draw, for choices that need no more."""
    bits = rng.next_uint32(active)
    scale = 1.0 / 65536.0
    return (mi.Float(bits >> 16) + 0.5) * scale, (mi.Float(bits & 0xFFFF) + 0.5) * scale


def one_of(values: tuple[Any, ...], weights: Any, left: Any) -> tuple[Any, ...]:
    """Return one of the four wavelengths of each value, drawn by weights with `left`, uniform up to their sum."""
    left = left - weights[0]
    found = tuple(value[0] for value in values)
    for k in range(1, dr.size_v(mi.Spectrum)):
        found = select(left >= 0, tuple(value[k] for value in values), found)
        left -= weights[k]
    return found


def kept_share(before: Any, after: Any) -> Any:
    """Return the chance that light lives on, from the sums it carried and will carry.

    That is the share it keeps; a rise above what came in is taken back first.
    """
    return dr.minimum(after / dr.maximum(before, TINY) * dr.maximum(before / FULL, 1.0), 1.0)
