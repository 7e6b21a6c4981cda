"""Importance of light inside the strata for a given exit direction.

The exit direction is refracted inward once, through a random facet at rough interfaces. In each stratum it then has
two directions of travel, mirror images connected by the smooth interfaces; their importance follows from a
one-dimensional layer stack.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.device.tables import Located
from nacre.device.walk.strata import Strata

MIN_COS = 1e-4  # smallest cosine of inside connections


@dataclass
class Importance:
    """Importance in each stratum, for the two directions connected by mirror reflections.

    Attributes:
        up_direction, down_direction: per stratum, unit travel direction.
        up, down: per stratum, importance of upward travel at its top, downward travel at its bottom; None if zero.
        up_extinction, down_extinction: per stratum, optical thickness of the stratum along the direction.
    """

    up_direction: list[Any]
    down_direction: list[Any]
    up: list[Any]
    down: list[Any]
    up_extinction: list[Any]
    down_extinction: list[Any]


def uses_both_directions(strata: Strata) -> bool:
    """Whether light may reach the exit by a mirror reflection, or leave below."""
    inner_mirror = any(not rough for rough in strata.is_rough[1 : strata.count])
    return strata.base == "none" or strata.base_mirrors or inner_mirror


def inner_interfaces_scatter(strata: Strata) -> bool:
    """Whether a rough interface must be connected to the exit as a scattering vertex."""
    if any(strata.is_rough[1:]):
        return True
    return strata.is_rough[0] and uses_both_directions(strata)


def rough_one(strata: Strata, interface: Any) -> Any:
    """Return whether an interface is rough."""
    if strata.all_rough:
        return mi.Bool(True)
    is_one = mi.Bool(False)
    for i, is_rough in enumerate(strata.is_rough):
        if is_rough:
            is_one |= interface == i
    return is_one


def exit_importance(strata: Strata, rng: Any, wo: Any, where: Located, active: Any) -> Importance:
    """Refract the exit direction inward and compute its importance in the strata.

    At rough interfaces a facet visible from outside is drawn. The importance refers to f |cos_o| as power transport:
    cos_o / (n^2 |b_z|) times the transmitted fractions.
    """
    from_above = wo.z > 0
    travel_a, passed_a, entered_a = _inward(strata, rng, wo, True, active & from_above)
    if strata.base == "none":
        travel_b, passed_b, entered_b = _inward(strata, rng, wo, False, active & ~from_above)
        travel = [dr.select(from_above, a, b) for a, b in zip(travel_a, travel_b, strict=True)]
        entered = dr.select(from_above, entered_a, entered_b)
    else:
        travel, passed_b, entered = travel_a, passed_a, entered_a
    entered = dr.select(active, entered * dr.abs(wo.z), 0.0)
    chain = _chain(strata, travel, passed_a, passed_b, entered, from_above, where, active)
    for s in range(strata.count):
        cos = chain.up_direction[s].z
        scale = dr.select(cos > MIN_COS, 1 / (dr.square(strata.indices[s + 1]) * cos), 0.0)
        chain.up[s] = None if chain.up[s] is None else chain.up[s] * scale
        chain.down[s] = None if chain.down[s] is None else chain.down[s] * scale
    return chain


def _inward(strata: Strata, rng: Any, wo: Any, downward: bool, active: Any) -> tuple[list[Any], list[Any], Any]:
    """Trace the exit direction inward from the top (or the bottom).

    Returns:
        the travel direction towards the exit in each stratum; the transmitted fraction at each inner interface
        (by interface number); the transmitted fraction at the outer one.
    """
    count = strata.count
    order = list(range(count)) if downward else list(range(count - 1, -1, -1))
    travel: list[Any] = [None] * count
    passed: list[Any] = [None] * (count + 1)
    current, entered = wo, mi.Float(1.0)
    for step, s in enumerate(order):
        interface = s if downward else s + 1
        inner, weight = refract(strata, rng, current, mi.UInt32(interface), active)
        if step == 0:
            entered = weight
        else:
            passed[interface] = weight
        current = -inner
        travel[s] = current
    return travel, passed, entered


def _chain(
    strata: Strata, travel: list[Any], passed_a: list[Any], passed_b: list[Any], entered: Any, exits_above: Any,
    where: Located, active: Any,
) -> Importance:  # fmt: skip
    """Solve for the importance (power) in all strata: mirrors couple the two directions, media attenuate them."""
    count, both = strata.count, uses_both_directions(strata)
    ups, downs, sig_up, sig_down, t_up, t_down, cosines = [], [], [], [], [], [], []
    for s in range(count):
        cos = dr.maximum(dr.abs(travel[s].z), MIN_COS)
        ups.append(mi.Vector3f(travel[s].x, travel[s].y, cos))
        downs.append(mi.Vector3f(travel[s].x, travel[s].y, -cos))
        cosines.append(cos)
        sig_up.append(strata.medium_extinction(s, ups[s], where, active) / cos)
        different = both and not strata.upright
        sig_down.append(strata.medium_extinction(s, downs[s], where, active) / cos if different else sig_up[s])
        t_up.append(dr.exp(-sig_up[s]))
        t_down.append(dr.exp(-sig_down[s]))
    above = mi.UnpolarizedSpectrum(dr.select(exits_above, entered, 0.0))
    below = mi.UnpolarizedSpectrum(dr.select(exits_above, 0.0, entered))
    up: list[Any] = [None] * count
    down: list[Any] = [None] * count
    if not both:
        up[0] = above
        for s in range(1, count):
            up[s] = passed_a[s] * t_up[s - 1] * up[s - 1]
        return Importance(ups, downs, up, down, sig_up, sig_down)
    # for each interface: mirror reflectance, transmitted fraction upward and downward. A rough interface has zero
    # mirror reflectance and is crossed only towards the exit: the other crossing is a separate vertex.
    mirror, rising, sinking = [], [], []
    for i in range(count + 1):
        reflect, rise, sink = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0), mi.Float(0.0)
        if i == count and strata.base != "none":
            if strata.base_mirrors:
                reflect = strata.base_mirror(cosines[-1], where, active)
        elif not strata.is_rough[i]:
            side = min(i, count - 1)
            other = strata.indices[i] if side == i else strata.indices[i + 1]
            fresnel = mi.fresnel(cosines[side], other / strata.indices[side + 1])[0]
            reflect, rise, sink = mi.UnpolarizedSpectrum(fresnel), 1 - fresnel, 1 - fresnel
        elif 0 < i < count:
            rise = dr.select(exits_above, passed_a[i], 0.0)
            if strata.base == "none":
                sink = dr.select(exits_above, 0.0, passed_b[i])
        mirror.append(reflect)
        rising.append(rise)
        sinking.append(sink)
    # from the bottom: down_s = rho_s up_s + kappa_s
    rho, kappa = [mi.UnpolarizedSpectrum(0.0)] * count, [mi.UnpolarizedSpectrum(0.0)] * count
    rho[-1], kappa[-1] = mirror[count] * t_up[-1], below
    for s in range(count - 2, -1, -1):
        lower = s + 1
        inner = 1 / dr.maximum(1 - mirror[lower] * t_down[lower] * rho[lower], 1e-6)
        fall = sinking[lower] * t_down[lower] * inner
        rho[s] = mirror[lower] * t_up[s] + fall * rho[lower] * rising[lower] * t_up[s]
        kappa[s] = fall * kappa[lower]
    up[0] = (mirror[0] * t_down[0] * kappa[0] + above) / dr.maximum(1 - mirror[0] * t_down[0] * rho[0], 1e-6)
    down[0] = rho[0] * up[0] + kappa[0]
    for s in range(1, count):
        inner = 1 / dr.maximum(1 - mirror[s] * t_down[s] * rho[s], 1e-6)
        up[s] = (mirror[s] * t_down[s] * kappa[s] + rising[s] * t_up[s - 1] * up[s - 1]) * inner
        down[s] = rho[s] * up[s] + kappa[s]
    return Importance(ups, downs, up, down, sig_up, sig_down)


class Exit:
    """Connects a vertex, in a lane-dependent stratum, to the exit."""

    def __init__(self, strata: Strata, importance: Importance) -> None:
        self.strata = strata
        self.given = importance
        self.has_down = uses_both_directions(strata)

    def _pick(self, values: list[Any], stratum: Any, zero: Any) -> Any:
        result = zero if values[0] is None else values[0]
        for s in range(1, self.strata.count):
            result = dr.select(stratum == s, zero if values[s] is None else values[s], result)
        return result

    def upward(self, stratum: Any, depth: Any) -> tuple[Any, Any]:
        """Return the upward direction and its importance at `depth` in a stratum."""
        zero = mi.UnpolarizedSpectrum(0.0)
        worth = self._pick(self.given.up, stratum, zero)
        worth = worth * dr.exp(-self._pick(self.given.up_extinction, stratum, zero) * depth)
        return self._pick(self.given.up_direction, stratum, None), worth

    def downward(self, stratum: Any, depth: Any) -> tuple[Any, Any]:
        """Return the downward direction and its importance at `depth` in a stratum."""
        zero = mi.UnpolarizedSpectrum(0.0)
        worth = self._pick(self.given.down, stratum, zero)
        worth = worth * dr.exp(-self._pick(self.given.down_extinction, stratum, zero) * (1 - depth))
        return self._pick(self.given.down_direction, stratum, None), worth


# Random events and values at an interface between resins.
#
# Power is transported: the factors (n_o/n_i)^2 at entry and exit of the whole stack cancel.

TINY = 1e-12


def mirrored(v: Any, w: Any) -> Any:
    """Mirror `w` at the surface if `v` is below it: `v` then counts as above."""
    return mi.Vector3f(w.x, w.y, dr.select(v.z < 0, -w.z, w.z))


def _draw_facet(strata: Strata, rng: Any, v: Any, interface: Any, active: Any) -> tuple[Any, ...]:
    """Draw a facet for light from `v`.

    Returns:
        `v` as from above, the normal, whether the interface is rough, the facet distribution (None if all interfaces
        are smooth), the cosine on the facet, its reflectance, the refracted direction.
    """
    row = strata.interfaces.read(interface, active)
    above = v.z > 0
    vm = mirrored(v, v)
    n_in, n_out = dr.select(above, row[0], row[1]), dr.select(above, row[1], row[0])
    m, facets = mi.Vector3f(0, 0, 1), None
    rough = row[2] + row[3] > 0
    if strata.any_rough:
        facets = strata.facets(row)
        drawn = facets.sample(vm, mi.Point2f(rng.next_float32(active), rng.next_float32(active)))
        m = drawn if strata.all_rough else dr.select(rough, drawn, m)
    cos = dr.maximum(dr.dot(vm, m), TINY)
    reflectance, cos_t, _, eta_ti = mi.fresnel(cos, n_out / n_in)
    return vm, m, rough, facets, cos, reflectance, mi.refract(vm, m, cos_t, eta_ti)


def interface_event(strata: Strata, rng: Any, v: Any, interface: Any, active: Any) -> tuple[Any, Any]:
    """Reflect or refract at random, with weight 1.

    Masked light is lost, or returns by `Strata.back` at a compensated interface.

    Args:
        strata: the material.
        rng: random numbers, advanced.
        v: unit direction away from the interface, towards the light's origin.
        interface: index.
        active: mask.

    Returns:
        the outgoing direction away from the interface, and survival.
    """
    vm, m, rough, facets, cos, reflectance, refracted = _draw_facet(strata, rng, v, interface, active)
    reflects = rng.next_float32(active) < reflectance
    w = dr.select(reflects, mi.reflect(vm, m), refracted)
    survives = dr.select(reflects, w.z > 0, w.z < 0)
    if facets is not None:
        unmasked = facets.weight(vm, w, m, cos, dr.abs(dr.dot(w, m)))
        lucky = rng.next_float32(active) < unmasked
        survives &= lucky if strata.all_rough else (lucky | ~rough)
    w = dr.normalize(mirrored(v, w))
    if strata.compensates:
        back = strata.back.read(interface, active)
        to_above = rng.next_float32(active) < back[0]
        drawn_cos = strata.back_cos(interface, to_above, rng.next_float32(active), active)
        azimuth = dr.two_pi * rng.next_float32(active)
        sine = dr.safe_sqrt(1 - dr.square(drawn_cos))
        returned = mi.Vector3f(
            sine * dr.cos(azimuth), sine * dr.sin(azimuth), dr.select(to_above, drawn_cos, -drawn_cos)
        )
        gives_back = ~survives & (back[3] > 0.5)
        w = dr.select(gives_back, returned, w)
        survives |= gives_back
    return w, survives & (dr.abs(w.z) > 1e-6)


def interface_value(strata: Strata, v: Any, w: Any, interface: Any, active: Any) -> Any:
    """Return a rough interface's value * |cos w| for light from `v` to `w`; zero for a smooth interface."""
    row = strata.interfaces.read(interface, active)
    above = v.z > 0
    vm, wm = mirrored(v, v), mirrored(v, w)
    n_in, n_out = dr.select(above, row[0], row[1]), dr.select(above, row[1], row[0])
    reflects = wm.z > 0
    half = dr.select(reflects, vm + wm, n_in * vm + n_out * wm)
    half = mi.Vector3f(half) * dr.sign(half.z)
    length = dr.norm(half)
    m = half / dr.maximum(length, TINY)
    v_m, w_m = dr.dot(vm, m), dr.dot(wm, m)
    valid = active & (row[2] + row[3] > 0) & (length > 1e-6) & (m.z > 1e-6) & (v_m > 1e-6) & (vm.z > 1e-6)
    valid &= dr.select(reflects, w_m > 0, w_m < 0)
    facets = strata.facets(row)
    spread = facets.spread(vm, m, v_m) * facets.weight(vm, wm, m, v_m, dr.abs(w_m))
    reflectance = mi.fresnel(dr.maximum(v_m, TINY), n_out / n_in)[0]
    stretch = dr.square(n_in * v_m + n_out * w_m)
    refracted = (1 - reflectance) * v_m * dr.abs(w_m) * dr.square(n_out) / dr.maximum(stretch, TINY)
    value = spread * dr.select(reflects, 0.25 * reflectance, refracted)
    value = dr.select(valid, value, 0.0)
    if strata.compensates:
        back = strata.back.read(interface, active)
        w_above = w.z > 0
        share = dr.select(w_above, back[0] * back[1], (1 - back[0]) * back[2])
        compensation = strata.loss_at(interface, above, dr.abs(v.z), active)
        returned = strata.loss_at(interface, w_above, dr.abs(w.z), active) * dr.abs(w.z) * dr.inv_pi
        value += dr.select(active & (row[2] + row[3] > 0) & (back[3] > 0.5), compensation * share * returned, 0.0)
    return value


def refract(strata: Strata, rng: Any, v: Any, interface: Any, active: Any) -> tuple[Any, Any]:
    """Refract light from `v` through a random facet, with the transmitted fraction as weight.

    Less noisy than `interface_event`, if the reflection is treated elsewhere.
    """
    if strata.compensates:
        w, alive = interface_event(strata, rng, v, interface, active)
        return w, dr.select(alive & ((w.z > 0) != (v.z > 0)), mi.Float(1.0), 0.0)
    vm, m, rough, facets, cos, reflectance, w = _draw_facet(strata, rng, v, interface, active)
    passes = active & (w.z < 0) & (reflectance < 1)
    w = dr.select(passes, dr.normalize(w), mi.Vector3f(0, 0, -1))
    weight = 1 - reflectance
    if facets is not None:
        unmasked = facets.weight(vm, w, m, cos, dr.abs(dr.dot(w, m)))
        weight *= unmasked if strata.all_rough else dr.select(rough, unmasked, 1.0)
    return mirrored(v, w), dr.select(passes, weight, 0.0)
