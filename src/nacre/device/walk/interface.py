"""Random events and values at an interface between resins.

Power is transported: the factors (n_o/n_i)^2 at entry and exit of the whole stack cancel.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.device.walk.strata import Strata

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
        lost = strata.loss_at(interface, above, dr.abs(v.z), active)
        returned = strata.loss_at(interface, w_above, dr.abs(w.z), active) * dr.abs(w.z) * dr.inv_pi
        value += dr.select(active & (row[2] + row[3] > 0) & (back[3] > 0.5), lost * share * returned, 0.0)
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
