"""The position-free walk through the strata: four wavelengths go together, and their weights stay near 1.

Each wavelength of a walk lies on one of the two nodes of the tables beside it, drawn for the whole walk.

From flake to flake (`step.py`), free paths follow the flakes' projected area, the same for all wavelengths; at a
flake the light is reflected, transmitted or absorbed, with probabilities from R and T weighted by the throughputs of
the four wavelengths. Their sum then never changes, so no single wavelength can exceed four times the mean and there
are no fireflies. Where most flakes transmit the light, free paths run on through them (`far.py`).
At a base of lobes the weight is that of the lobes' own sampling. Where it is above 1 the sum may rise, as far as that
sampling is inexact; Russian roulette at the base undoes such a rise, so that it does not build up.

`sample_walk` follows the light until it leaves. `eval_walk` connects each vertex to the wanted exit, and
`joint_walk` does both at once, as a path tracer asks for both. The exit direction is refracted inward once, and its
importance in each stratum, up- and downward, includes all mirror reflections between smooth interfaces, solved like
a one-dimensional layer stack.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.device.tables import Located
from nacre.device.walk.exit import Exit, exit_importance, rough_one
from nacre.device.walk.flake import BY_FLAKE, Walker, select
from nacre.device.walk.interface import interface_event, interface_value, refract
from nacre.device.walk.step import TURN, Stepper, connect_interface, first_light
from nacre.device.walk.strata import Strata

MAX_EVENTS = 20_000  # a lane that is still inside after so many events is given up; its share is below 1e-6


def make_rng(*numbers: Any) -> Any:
    """Seed a generator by a hash of the bits of floats (tiny encryption algorithm)."""
    a, b = mi.UInt32(0x9E3779B9), mi.UInt32(0x7F4A7C15)
    bits = [dr.reinterpret_array(mi.UInt32, mi.Float(x)) for x in numbers]
    if len(bits) % 2:
        bits.append(mi.UInt32(0))
    for first, second in zip(bits[::2], bits[1::2], strict=True):
        a, b = mi.sample_tea_32(a ^ first, b ^ second, 4)
    return mi.PCG32(size=1, initstate=mi.UInt64(a), initseq=mi.UInt64(b))


def sample_walk(strata: Strata, rng: Any, wi: Any, where: Located, active: Any) -> tuple[Any, Any, Any]:
    """Follow light from `wi` until it leaves.

    Returns:
        the exit direction, the weight of each wavelength (0 if absorbed), whether only mirrors were met.
    """
    where = where.on_nodes(rng.next_float32())
    entry = dr.select(wi.z > 0, mi.UInt32(0), mi.UInt32(strata.count))
    active = mi.Bool(active) & (mi.Bool(strata.base == "none") | (wi.z > 0))
    w, alive = interface_event(strata, rng, wi, entry, active)
    alive &= active
    light = first_light(strata, w, dr.select(alive, mi.Spectrum(1.0), 0.0))
    inside = alive & ((w.z > 0) != (wi.z > 0))
    nothing, seen = mi.Spectrum(0.0), rough_one(strata, entry)
    d, weight, mirror, _, turn = _follow(strata, Stepper(strata, where), rng, light, inside, seen, nothing)
    return d, _with_glint(strata, turn, weight, where, active), mirror


def _with_glint(strata: Strata, turn: tuple[Any, ...], weight: Any, where: Located, active: Any) -> Any:
    """Return the weight times the factor of the flake that alone turned the light, where glints are seen."""
    if strata.glints is None:
        return weight
    turned, x, y, z, slot = turn
    by_flake = active & (turned == BY_FLAKE) & (dr.max(weight) > 0)
    axes = strata.flake_axes(slot, by_flake)
    return weight * strata.glints.factor_of(slot, axes, mi.Vector3f(x, y, z), where.site, by_flake)


def eval_walk(strata: Strata, rng: Any, wi: Any, wo: Any, where: Located, active: Any) -> Any:
    """Estimate f |cos_o| of the non-delta part for each wavelength."""
    where = where.on_nodes(rng.next_float32())
    active = _connectable(strata, wi, wo, active)
    entry = dr.select(wi.z > 0, mi.UInt32(0), mi.UInt32(strata.count))
    stepper, total = _connected(strata, rng, wi, wo, entry, where, active)
    w, weight = refract(strata, rng, wi, entry, active)
    inside = active & (weight > 0)
    light = first_light(strata, w, dr.select(inside, mi.Spectrum(weight), 0.0))
    _, _, _, got, _ = _follow(strata, stepper, rng, light, inside, rough_one(strata, entry), total)
    return dr.select(active & dr.isfinite(got), got, 0.0)


def joint_walk(strata: Strata, rng: Any, wi: Any, wo: Any, where: Located, active: Any, wanted: Any) -> Any:
    """Estimate f |cos_o| towards `wo` where `wanted`, and draw an exit where `active`, by one walk.

    Light that the entry reflects does not reach the inside: for the value alone `eval_walk` has less noise, at the cost
    of another walk.

    Returns:
        the value, and what `sample_walk` returns.
    """
    where = where.on_nodes(rng.next_float32())
    entry = dr.select(wi.z > 0, mi.UInt32(0), mi.UInt32(strata.count))
    wanted = _connectable(strata, wi, wo, wanted)
    stepper, total = _connected(strata, rng, wi, wo, entry, where, wanted)
    active = mi.Bool(active) & (mi.Bool(strata.base == "none") | (wi.z > 0))
    w, alive = interface_event(strata, rng, wi, entry, active)
    alive &= active
    light = first_light(strata, w, dr.select(alive, mi.Spectrum(1.0), 0.0))
    inside = alive & ((w.z > 0) != (wi.z > 0))
    d, weight, mirror, got, turn = _follow(strata, stepper, rng, light, inside, rough_one(strata, entry), total)
    weight = _with_glint(strata, turn, weight, where, active)
    return dr.select(wanted & dr.isfinite(got), got, 0.0), d, weight, mirror


def _connectable(strata: Strata, wi: Any, wo: Any, active: Any) -> Any:
    active = mi.Bool(active) & (dr.abs(wo.z) > 1e-4) & (dr.abs(wi.z) > 1e-4)
    return active if strata.base == "none" else active & (wi.z > 0) & (wo.z > 0)


def _connected(
    strata: Strata, rng: Any, wi: Any, wo: Any, entry: Any, where: Located, active: Any
) -> tuple[Stepper, Any]:
    """Return a stepper that is connected to `wo`, and what the entry itself sends there."""
    connection = Exit(strata, exit_importance(strata, rng, wo, where, active))
    total = mi.Spectrum(0.0)
    if strata.any_rough:
        direct = interface_value(strata, wi, wo, entry, active)
        total += mi.Spectrum(dr.select(((wi.z > 0) == (wo.z > 0)) & active, direct, 0.0))
    stepper = Stepper(strata, where, connection, wo)
    if stepper.inner_vertices:
        total += connect_interface(strata, connection, wi, entry, active, mi.Bool(True), wo.z > 0)
    return stepper, total


def _follow(
    strata: Strata, stepper: Stepper, rng: Any, light: Walker, inside: Any, seen: Any, total: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """Follow light until it leaves or is absorbed.

    Returns:
        its last direction, what it carries, whether it met only mirrors, what the exit got, what turned it.
    """

    def body(*state: Any) -> tuple[Any, ...]:
        d, stratum, depth, f, rng, inside, got, seen, events, *turn = state
        now = Walker(d, stratum, depth, f, tuple(turn))
        moved, still, _, gained, seen_now = stepper.step(now, rng, inside, seen)
        if stepper.exit is not None:
            got = got + dr.select(inside, gained, 0.0)
        return (
            dr.select(inside, moved.d, d), dr.select(inside, moved.stratum, stratum),
            dr.select(inside, moved.depth, depth), dr.select(inside, moved.f, f), rng,
            still & (events < MAX_EVENTS), got, seen_now, events + 1, *select(inside, moved.turn, now.turn),
        )  # fmt: skip

    state = (light.d, light.stratum, light.depth, light.f, rng, inside, total, seen, mi.UInt32(0), *light.turn)
    names = ("d", "stratum", "depth", "f", "rng", "inside", "got", "seen", "events", *TURN[: len(light.turn)])
    result = dr.while_loop(state, lambda *s: s[5], body, names, label="pearl walk")
    weight = dr.select(result[8] < MAX_EVENTS, result[3], 0.0)
    return result[0], weight, ~result[7], result[6], result[9:]
