"""The state of a random walk, and its events at flakes."""

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
FULL = 4.0  # summed initial throughput of the four wavelengths


@dataclass
class Walker:
    """State of a random walk: travel direction, stratum, depth in it, throughput of each wavelength.

    With glints `turn` describes the scattering so far: unscattered, by one flake of the uppermost stratum (with its
    normal in its own frame and its species), or other; without glints it is empty.
    """

    d: Any
    stratum: Any
    depth: Any
    f: Any
    turn: tuple[Any, ...] = ()

    def fresh(self, active: Any) -> Any:
        """Return the mask of unscattered light in the uppermost stratum, which shows glints; None without glints."""
        return active & (self.turn[0] == BY_NOTHING) & (self.stratum == 0) if self.turn else None


@dataclass
class Flake:
    """A flake event: the flake's row, the backward light direction, axes, their product and its length."""

    row: list[Any]
    v: Any
    axes: Any
    stretched: Any
    area: Any
    kind: Any
    slot: Any

    @staticmethod
    def of(strata: Strata, stratum: Any, row: list[Any], v: Any, slot: Any, active: Any) -> Flake:
        """Return a slot's flake; `v` is the backward light direction in its frame."""
        axes = mi.Vector3f(row[1], row[2], row[3])
        stretched = axes * v
        return Flake(row, v, axes, stretched, dr.norm(stretched), strata.kind_at(stratum, slot, active), slot)

    def normal(self, rng: Any, active: Any) -> tuple[Any, Any]:
        """Draw a normal in proportion to its projected area; return it and its cosine."""
        point = mi.warp.square_to_uniform_sphere(mi.Point2f(rng.next_float32(active), rng.next_float32(active)))
        m = dr.normalize(self.axes * (self.stretched / self.area * (1 + 1e-6) + point))
        return m, dr.dot(self.v, m)

    def half(self, strata: Strata, to: Any) -> tuple[Any, Any]:
        """Return the normal that reflects the light towards `to`, and its density; 0 for the forward direction."""
        half = self.v + strata.into_flake(self.row, to)
        length = dr.norm(half)
        h = half / dr.maximum(length, 1e-6)
        slope = dr.maximum(dr.squared_norm(h * mi.Vector3f(*self.row[PER_AXES])), TINY)
        density = self.row[DENSITY] / dr.square(slope)
        return h, dr.select(length > 1e-6, density, 0.0)

    def turned(self, strata: Strata, m: Any, v_m: Any) -> Any:
        """Return the travel direction after reflection by a normal."""
        return dr.normalize(strata.from_flake(self.row, dr.fma(m, 2 * v_m, -self.v)))


def flake_gain(
    strata: Strata, connection: Exit, where: Located, light: Walker, depth: Any, flake: Flake, node: Any,
    way: Any, active: Any,
) -> Any:  # fmt: skip
    """Return D(h) R(|v.h|) / (4 sigma(v)) times the importance, and times the glint factor.

    If two directions lead to the exit, one is drawn by its contribution, which needs one read of R and of glints.

    Args:
        strata, connection, where: the material, the exit, the wavelengths.
        light, depth: the light, and its depth in the stratum.
        flake: the flake.
        node, way: numbers in [0, 1), to choose a row in the table of R, and the direction.
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
    """Select elementwise between two tuples."""
    return tuple(dr.select(mask, a, b) for a, b in zip(new, old, strict=True))


def scattered_by_other(turn: tuple[Any, ...], by: Any) -> tuple[Any, ...]:
    """Return `Walker.turn` after scattering by anything but a single flake."""
    return (dr.select(by, mi.UInt32(BY_MORE), turn[0]), *turn[1:]) if turn else ()


def reflected_by(light: Walker, flake: Flake, m: Any, turns: Any) -> tuple[Any, ...]:
    """Return `Walker.turn` after reflection by a flake with normal `m`."""
    if not light.turn:
        return ()
    first = (mi.UInt32(BY_FLAKE), m.x, m.y, m.z, flake.slot)
    return select(light.fresh(turns), first, scattered_by_other(light.turn, turns))


def two_numbers(rng: Any, active: Any) -> tuple[Any, Any]:
    """Return two uniform 16-bit numbers from one draw, for discrete choices."""
    bits = rng.next_uint32(active)
    scale = 1.0 / 65536.0
    return (mi.Float(bits >> 16) + 0.5) * scale, (mi.Float(bits & 0xFFFF) + 0.5) * scale


def one_of(values: tuple[Any, ...], weights: Any, left: Any) -> tuple[Any, ...]:
    """Choose one wavelength with probability proportional to its weight; return all values there.

    Args:
        values: quantities at each wavelength.
        weights: one per wavelength.
        left: random number, uniform in [0, sum of weights).
    """
    left = left - weights[0]
    found = tuple(value[0] for value in values)
    for k in range(1, dr.size_v(mi.UnpolarizedSpectrum)):
        found = select(left >= 0, tuple(value[k] for value in values), found)
        left -= weights[k]
    return found


def survival_probability(before: Any, after: Any) -> Any:
    """Return the survival probability from the summed throughput before and after an event.

    This is the retained fraction; a rise above the initial throughput is reversed first.
    """
    return dr.minimum(after / dr.maximum(before, TINY) * dr.maximum(before / FULL, 1.0), 1.0)
