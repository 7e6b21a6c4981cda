"""Delta tracking: free paths ("flights") through all transmitting flakes, to the next reflection or absorption.

If most flakes transmit most light, a walk that stops at each flake wastes its time. Here the free path follows the
wavelength-dependent extinction: it is drawn from the mixture of the four wavelengths' distributions, weighted by
throughput, and each wavelength is weighted by its own density over the mixture's, which preserves the sum. At the end a
flake normal is drawn from all visible ones; its 1 - T over the mean is the only weight different from 1. Russian
roulette removes weights below 1. Weights above 1 would grow without bound in a long walk; light with a weight above
`RISEN` therefore continues flake by flake, with unit weights. Extinctions below `LEAST` are raised by null collisions,
since 1 - T of a rare steep normal may be as large as 1, far above the mean.

Each free path is connected to the exit at one point before the next boundary, even if it does not end there.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.device.tables import Located
from nacre.device.walk.exit_importance import Exit
from nacre.device.walk.platelet import (
    FULL,
    TINY,
    Flake,
    Walker,
    flake_gain,
    one_of,
    reflected_by,
    select,
    survival_probability,
    two_numbers,
)
from nacre.device.walk.strata import Strata

# Second moment of bottle 1's power relative to flake-by-flake tracking: 1.05 at a limit of 1.2 (equal time), 1.08 at 2
# (0.62 of its time), 1.11 at 4 (0.58), 1.15 at 8.
RISEN = 8.0
LEAST = 0.1
SMALLEST_RATE = 1e-9


def delta_flight(
    strata: Strata, where: Located, connection: Exit | None, light: Walker, rng: Any, alive: Any, seen: Any
) -> tuple[Walker, Any, Any, Any, Any, Any]:
    """Move along a free path to a reflecting or absorbing flake, or to a boundary.

    Returns:
        the light after the event, survival, contribution to the exit, arrival at the upper and at the lower boundary,
        whether a connected vertex was passed.
    """
    v = -light.d
    carried = dr.sum(light.f)
    is_far = carried < FULL * RISEN
    ways = []
    total = mi.UnpolarizedSpectrum(0.0)
    for slot in range(strata.slots):
        row = strata.flake_row(light.stratum, slot, alive)
        local = strata.into_flake(row, v)
        mean = strata.mean_extinction(strata.kind_at(light.stratum, slot, alive), local, where, alive)
        rate = dr.select(is_far, dr.maximum(mean, LEAST), 1.0)
        share = strata.shown_area(row, local) * rate
        ways.append((row, local, mean, rate, share))
        total += share

    wall = dr.select(light.d.z > 0, light.depth, 1 - light.depth) / dr.maximum(dr.abs(light.d.z), 1e-9)
    passes = dr.exp(-total * wall)
    which, node = two_numbers(rng, alive)
    chosen, p_pass = one_of((total, passes), light.f, which * carried)
    chosen, u = dr.maximum(chosen, SMALLEST_RATE), rng.next_float32(alive)
    inside = alive & (u < 1 - p_pass)
    # the connection point follows the same distribution, even for flights to a boundary
    u = dr.select(inside, u, (1 - p_pass) * dr.clip(1 - (1 - u) / dr.maximum(p_pass, TINY), 0.0, 1.0))
    length = dr.minimum(-dr.log(1 - u) / chosen, wall)
    depth = dr.clip(light.depth - light.d.z * length, 0.0, 1.0)
    shape = light.f * total * dr.exp(-total * length)
    per_met = carried / dr.maximum(dr.sum(shape), TINY)

    row, local, mean, rate, slot, shape = _slot_of(ways, total, shape, rng, alive)
    flake = Flake.of(strata, light.stratum, row, local, slot, alive)
    per_rate = dr.rcp(rate)
    way, choice = two_numbers(rng, alive)
    gained = mi.UnpolarizedSpectrum(0.0)
    if connection is not None:
        per_linked = carried / dr.maximum(dr.sum(shape / dr.maximum(1 - passes, 1e-7)), TINY)
        gain = flake_gain(strata, connection, where, light, depth, flake, node, way, alive)
        gained = dr.select(alive, gain * shape * (per_linked * per_rate), 0.0)

    met = shape * per_met
    m, v_m = flake.normal(rng, inside)
    reflect, transmit = strata.flake_response(flake.kind, dr.abs(v_m), node, where, inside)
    reflected = met * reflect * per_rate
    straight = met * dr.select(is_far, 1 - mean * per_rate, transmit)
    one, two = dr.sum(reflected), dr.sum(straight)
    survival = survival_probability(carried, one + two)
    choice *= one + two
    lives, reflects = choice < survival * (one + two), choice < survival * one
    after = dr.select(reflects, reflected, straight)
    after *= (one + two) / dr.maximum(survival * dr.select(reflects, one, two), TINY)
    passed = light.f * passes
    passed *= carried / dr.maximum(dr.sum(passed), TINY)
    reflects &= inside
    direction = dr.select(reflects, flake.turned(strata, m, v_m), light.d)
    throughput, turn = dr.select(inside, after, passed), reflected_by(light, flake, m, reflects)
    moved = Walker(direction, light.stratum, dr.select(inside, depth, light.depth), throughput, turn)
    leaves = alive & ~inside
    up = light.d.z > 0
    return moved, alive & (~inside | lives), gained, leaves & up, leaves & ~up, seen | reflects


def _slot_of(ways: list[Any], total: Any, shape: Any, rng: Any, active: Any) -> tuple[Any, ...]:
    """Draw the flake species; return its entry in `ways`, its slot, and the shape weighted for the choice."""
    row, local, mean, rate, share = ways[0]
    slot = mi.UInt32(0)
    if len(ways) == 1:
        return row, local, mean, rate, slot, shape
    shape = shape / dr.maximum(total, TINY)
    parts = [dr.sum(shape * way[4]) for way in ways]
    part = parts[0]
    whole = sum(parts[1:], parts[0])
    left = rng.next_float32(active) * whole - part
    for i in range(1, len(ways)):
        take = (left >= 0) & (parts[i] > 0)
        row = list(select(take, tuple(ways[i][0]), tuple(row)))
        new = (*ways[i][1:], parts[i], mi.UInt32(i))
        local, mean, rate, share, part, slot = select(take, new, (local, mean, rate, share, part, slot))
        left -= parts[i]
    return row, local, mean, rate, slot, shape * share * (whole / dr.maximum(part, TINY))
