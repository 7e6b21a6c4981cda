"""The path tracer of our own scenes, where Mitsuba's would leave noise: matt and rough surfaces under several lamps,
films that light goes straight through, and small lamps that mirrors throw on matt surfaces.

All are handled in one loop after Mitsuba's `path` (next-event estimation and scattering, joined by the power
heuristic). The first surface on a way that is no mirror draws several places of lamps, evenly among themselves, since
that is where most of the noise comes from; what matt surfaces send each other is little and gets fewer paths. Shadow
rays pass null interactions and take their colour; these do not count as events either. `volpath` does the same at the
price of media, which our scenes do not have.

Where the camera looks straight through clear surfaces, what passes and what the surface sends are both followed: the
few per cent of a bright lamp that a soap film mirrors would otherwise be seen by as few of the samples, as grain.

Light that a matt surface gets by way of a mirror (its caustics) can only be found by chance: a path has to leave the
matt surface just so that the mirror sends it to the lamp. For the sun one path in 100,000 does, and is then a firefly.
On such paths the lamp is taken `SOFT_LAMP_DEG` wide with the same irradiance: the light falls about where it did, with
a softer rim, and none is lost in the mean. So is the lamp of `directional`, `WITHIN_LAMP_DEG` wide, for light that a
clear object has spread itself and that leaves it by refraction. Next-event estimation leaves these paths out, which are
those by lobes narrower than a lamp of `SOFT_LAMP_DEG`. The sun as the camera sees it, in mirrors too, and the light and
shadows that it throws directly are as sharp as it is.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant

SOFT_LAMP_DEG = 10.0
WITHIN_LAMP_DEG = 40.0
# density of directions above which a lobe is narrower than that lamp
NARROW = 1.0 / (2.0 * math.pi * (1.0 - math.cos(math.radians(0.5 * SOFT_LAMP_DEG))))
# places of lamps that the first surface draws which is no mirror: of an object, and of what it stands on, whose even
# grain goes for less (errors of denoised pictures times their CPU time: 5 to 12 % lower than with four on all). Of
# pearls one: each takes a walk
DRAWS, BEHIND = 4, 2
# how many times what a matt floor sees by a drawn lamp counts beside what it meets by chance: lamps are drawn by their
# light and height, which is nearly what a floor sees of them (a bubble's noise 4 % lower; from 2 to 4 it is the same)
TRUST = 3.0
FAINT = 0.3  # share of the light of a way beside the straight one that one draw does for
MOST_PASSED = 64  # clear surfaces that one shadow ray passes
MOST_SPLIT = 4  # clear surfaces at which a camera's ray goes both ways


def make_paths(
    max_depth: int, rr_depth: int, passes_through: bool, soft: Any = None, splits: bool = False, spread_by: Any = (),
    draws: int = DRAWS, glitters: bool = False, objects: Any = (),
) -> Any:  # fmt: skip
    """Return an integrator of the current variant, which must not be a scalar one.

    Args:
        max_depth, rr_depth: as those of Mitsuba's `path`.
        passes_through: whether shadow rays pass null interactions.
        soft: the scene's environment with its small lamps `SOFT_LAMP_DEG` wide; None: it has none.
        splits: whether camera rays go both ways at clear surfaces; then every BSDF must be able to leave its null
            interaction out when asked to (`can_split`).
        spread_by: shapes; only light that one of these has spread is lit by `soft`; none: by whatever spread it.
        draws: places of lamps that the first surface draws which is no mirror.
        glitters: flakes are seen one by one, but for the light that they throw on matt surfaces, which takes the mean
            over them: it was grains of light on the ground, each by one path of many.
        objects: shapes; all others draw `BEHIND` places at most; none: all draw alike.
    """
    mi = use_variant()
    given = (max_depth, rr_depth, passes_through, soft, splits, spread_by, draws, glitters, objects)
    return _class(mi.variant())(mi.Properties(), *given)


def can_split(bsdf: Any) -> bool:
    """Whether what a BSDF lets straight through is a component of its own, which its draws can leave out.

    Of those that let light straight through only nacre's are known to: Mitsuba's `mask` draws it whatever is asked for.
    """
    mi = use_variant()
    if int(bsdf.flags()) & int(mi.BSDFFlags.Null) and not hasattr(bsdf, "plugins"):
        return False
    null, kinds = int(mi.BSDFFlags.Null), int(mi.BSDFFlags.All)
    words = [int(bsdf.flags(index)) & kinds for index in range(bsdf.component_count())]
    return all(word == null or not word & null for word in words)


@functools.cache
def _class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    from nacre.device.glints import without_glints

    mi: Any = use_variant()
    shiny = int(mi.BSDFFlags.Glossy | mi.BSDFFlags.Delta | mi.BSDFFlags.Null)

    def weigh(chosen: Any, other: Any) -> Any:
        """Power heuristic of a density against another."""
        a, b = chosen * chosen, other * other
        return dr.select(a > 0.0, a / (a + b), 0.0)

    def passed(scene: Any, si: Any, ds: Any, active: Any) -> Any:
        """Share of the light that reaches `si` from the sampled place of a lamp through clear surfaces."""
        straight = si.spawn_ray_to(ds.p)
        # most meet nothing, which is told for less than what the others meet
        state = (straight, mi.Spectrum(1.0), mi.UInt32(0), active & scene.ray_test(straight, active))

        def body(ray: Any, share: Any, count: Any, going: Any) -> Any:
            hit = scene.ray_intersect(ray, mi.RayFlags.All, False, going)
            going = going & hit.is_valid()
            share = dr.select(going, share * hit.bsdf().eval_null_transmission(hit, going), share)
            going = going & dr.any(share > 0.0) & (count < MOST_PASSED)
            return hit.spawn_ray_to(ds.p), share, count + 1, going

        labels = ("ray", "share", "count", "going")
        loop = dr.while_loop(state, lambda ray, share, count, going: going, body, labels, label="shadow ray")
        # one that is still going met too many surfaces: dark, as an opaque one would be
        return dr.select(loop[3], 0.0, loop[1])

    def drawn_light(
        paths: Any, scene: Any, si: Any, bsdf: Any, places: Any, draws: Any, trust: Any, has_spread: Any, active: Any
    ) -> Any:
        """Light of so many drawn places of lamps that `si` sends on, the mean of the draws.

        Their densities count `trust` times, beside that of the surface's own choice.
        """
        context = paths.scatters()

        def body(count: Any, found: Any) -> Any:
            ds, shine = scene.sample_emitter_direction(si, places(count), not paths.passes_through, active)
            is_lit = active & (ds.pdf != 0.0)
            if paths.passes_through:
                shine = shine * passed(scene, si, ds, is_lit)
            value, by_bsdf = bsdf.eval_pdf(context, si, si.to_local(ds.d), is_lit)
            if paths.soft is not None:  # found by the lobe alone, as the soft lamp
                is_far = ds.emitter == mi.EmitterPtr(scene.environment())
                is_lit = is_lit & ((is_far & has_spread & (by_bsdf > NARROW)) ^ True)
            share = dr.select(ds.delta, 1.0, weigh(trust * ds.pdf, by_bsdf))
            return count + 1, dr.select(is_lit, dr.fma(share, value * shine, found), found)

        state = (mi.UInt32(0), mi.Spectrum(0.0))
        labels = ("count", "found")
        loop = dr.while_loop(state, lambda count, found: active & (count < draws), body, labels, label="lamps")
        return loop[1] / mi.Float(draws)

    def trust_in_lamps(si: Any, bsdf: Any) -> Any:
        """How many times a drawn lamp counts: `TRUST` on a matt floor, 1 on all that shines, stands or hangs."""
        upward = dr.maximum(dr.sign(si.wi.z) * si.sh_frame.n.z, 0.0)
        return dr.fma(TRUST - 1.0, dr.select((bsdf.flags() & shiny) == 0, dr.square(upward), 0.0), 1.0)

    def places_of(sampler: Any, draws: Any, active: Any) -> Any:
        """Return a function of a number below `draws` that gives a point of the unit square."""
        if hasattr(sampler, "several_2d"):
            return sampler.several_2d(draws)
        place, many = sampler.next_2d(active), mi.Float(draws)

        def point(number: Any) -> Any:
            # a lattice, turned by the sample's own draw
            x, y = place.x + mi.Float(number) / many, place.y + mi.Float(dr.brev(number) >> 8) * (1.0 / (1 << 24))
            return mi.Point2f(x - dr.floor(x), y - dr.floor(y))

        return point

    class Paths(mi.SamplingIntegrator):
        """Path tracing without media."""

        def __init__(
            self, properties: Any, max_depth: int, rr_depth: int, passes_through: bool, soft: Any, splits: bool,
            spread_by: Any, draws: int, glitters: bool, objects: Any,
        ) -> None:  # fmt: skip
            super().__init__(properties)
            self.max_depth, self.rr_depth = max_depth, rr_depth
            self.passes_through, self.soft, self.splits = passes_through, soft, splits
            self.spread_by, self.draws, self.glitters = list(spread_by), draws, glitters
            self.objects = list(objects) if draws > BEHIND else []

        def scatters(self) -> Any:
            """Return what surfaces are asked for: all, or all but what goes straight through."""
            context = mi.BSDFContext()
            if self.splits:
                context.type_mask = int(mi.BSDFFlags.All) & ~int(mi.BSDFFlags.Null)
            return context

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            scatters = self.scatters()
            has_environment = scene.environment() is not None

            def body(
                ray: Any, light: Any, weight: Any, base: Any, eta: Any, depth: Any, last: Any, pdf: Any, trust: Any,
                is_delta: Any, has_spread: Any, is_led: Any, kept: Any, kept_weight: Any, is_kept: Any, splits: Any,
                is_seen: Any, active: Any, sampler: Any,
            ) -> Any:  # fmt: skip
                si = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)
                before = dr.zeros(mi.Interaction3f)
                before.p, before.time, before.wavelengths = last, ray.time, ray.wavelengths

                # a lamp that is met
                ds = mi.DirectionSample3f(scene, si, before)
                by_lamp = trust * scene.pdf_emitter_direction(before, ds, active & (is_delta ^ True))
                share = dr.select(is_delta, 1.0, weigh(pdf, by_lamp))
                shine = ds.emitter.eval(si, active)
                if self.soft is not None:
                    is_soft = active & is_led & (si.is_valid() ^ True)
                    shine = dr.select(is_soft, self.soft.eval(si, is_soft), shine)
                    share = dr.select(is_soft, 1.0, share)
                light = dr.select(active, dr.fma(weight * share, shine, light), light)

                # what comes by way of several matt surfaces is little: fewer paths look for it, by the root of what
                # they bring, since its noise counts beside their time. What shines may throw a lamp there, of which
                # all paths are wanted: without those a Bragg mirror had 45 % more error at the same samples
                active = active & si.is_valid() & (depth + 1 < self.max_depth)
                bsdf = si.bsdf()
                if self.glitters:
                    si = without_glints(si, base > 0.0)
                worth = dr.sqrt(dr.minimum(dr.max(weight) / dr.maximum(base, 1e-20), 1.0))
                is_judged = active & (base > 0.0) & ((bsdf.flags() & shiny) == 0)
                lives = sampler.next_1d(active) < worth
                weight = dr.select(is_judged, weight / dr.maximum(worth, 1e-20), weight)
                active = active & ((is_judged ^ True) | lives)

                # light from lamps that are drawn
                is_broad = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
                is_first = base == 0.0
                if self.splits:
                    is_first = is_first & ((is_kept & (dr.max(weight) < FAINT)) ^ True)
                here = mi.UInt32(self.draws)
                if self.objects:
                    here = dr.select(is_one_of(si, self.objects), here, BEHIND)
                here = dr.select(is_first, here, 1)
                trusted = mi.Float(here) * trust_in_lamps(si, bsdf)
                places = places_of(sampler, here, active)
                found = drawn_light(self, scene, si, bsdf, places, here, trusted, has_spread, is_broad)
                light = dr.select(is_broad, dr.fma(weight, found, light), light)

                # on
                most_before = dr.max(weight)
                goes_on = mi.Bool(False)
                if self.splits:
                    straight = bsdf.eval_null_transmission(si, active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null))
                    share = dr.clip(dr.mean(straight), 0.0, 1.0)
                    is_both = active & (share > 0.0) & (depth == 0) & (splits > 0)
                    kept = dr.select(is_both, si.spawn_ray(ray.d), kept)
                    kept_weight = dr.select(is_both, weight * straight, kept_weight)
                    is_kept, splits = is_kept | is_both, dr.select(is_both, splits - 1, splits)
                    # elsewhere one way is drawn: roots, since what is mirrored is often the brighter
                    root, other = dr.sqrt(share), dr.sqrt(1.0 - share)
                    root = dr.select(is_both, 0.0, root / (root + other))
                    goes_on = active & (sampler.next_1d(active) < root)
                    weight = dr.select(goes_on, weight * straight / dr.maximum(root, 1e-20), weight / (1.0 - root))
                bs, scattered = bsdf.sample(
                    scatters, si, sampler.next_1d(active), sampler.next_2d(active), active & (goes_on ^ True)
                )
                weight = dr.select(goes_on, weight, weight * scattered)
                eta = dr.select(goes_on, eta, eta * bs.eta)
                is_null = goes_on | mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
                is_event = active & (is_null ^ True)
                is_sharp = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
                is_narrow = is_sharp | (bs.pdf > NARROW)
                last = dr.select(is_event, si.p, last)
                pdf = dr.select(is_event, bs.pdf, pdf)
                is_delta = dr.select(is_event, is_sharp, is_delta)
                is_led = dr.select(is_event, has_spread & is_narrow, is_led)
                spreads = is_event & (is_narrow ^ True)
                if self.spread_by:
                    spreads = spreads & is_one_of(si, self.spread_by)
                trust = dr.select(is_event, trusted, trust)
                is_matt = is_event & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Diffuse) & (base == 0.0)
                base = dr.select(is_matt, most_before, base)
                has_spread = has_spread | spreads
                is_seen = is_seen | is_event
                depth = dr.select(is_event, depth + 1, depth)
                ray = si.spawn_ray(dr.select(goes_on, ray.d, si.to_world(bs.wo)))

                most = dr.max(weight)
                active = active & (most != 0.0)
                survival = dr.minimum(most * dr.square(eta), 0.95)
                is_judged = depth >= self.rr_depth
                lives = sampler.next_1d(active) < survival
                weight = dr.select(is_judged, weight / dr.maximum(survival, 1e-20), weight)
                active = active & ((is_judged ^ True) | lives)

                # what was kept, once the other way has ended: as the camera's own ray beyond the surface
                if self.splits:
                    turns = is_kept & (active ^ True)
                    ray, weight = dr.select(turns, kept, ray), dr.select(turns, kept_weight, weight)
                    eta, pdf = dr.select(turns, 1.0, eta), dr.select(turns, 1.0, pdf)
                    depth, base = dr.select(turns, 0, depth), dr.select(turns, 0.0, base)
                    is_delta, active = is_delta | turns, active | turns
                    stays = turns ^ True
                    has_spread, is_led, is_kept = has_spread & stays, is_led & stays, is_kept & stays
                return (
                    ray, light, weight, base, eta, depth, last, pdf, trust, is_delta, has_spread, is_led, kept,
                    kept_weight, is_kept, splits, is_seen, active, sampler,
                )  # fmt: skip

            state = (
                mi.Ray3f(ray), mi.Spectrum(0.0), mi.Spectrum(1.0), mi.Float(0.0), mi.Float(1.0), mi.UInt32(0),
                mi.Point3f(0.0), mi.Float(1.0), mi.Float(1.0), mi.Bool(True), mi.Bool(False), mi.Bool(False),
                mi.Ray3f(ray), mi.Spectrum(0.0), mi.Bool(False), mi.UInt32(MOST_SPLIT), mi.Bool(has_environment),
                mi.Bool(active), sampler,
            )  # fmt: skip
            done = dr.while_loop(
                state, lambda *state: state[-2], body,
                ("ray", "light", "weight", "base", "eta", "depth", "last", "pdf", "trust", "is_delta", "has_spread",
                 "is_led", "kept", "kept_weight", "is_kept", "splits", "is_seen", "active", "sampler"), label="paths",
            )  # fmt: skip
            light, is_seen = done[1], done[-3]
            return dr.select(is_seen, light, 0.0), is_seen, []

    return Paths


# Objects apart from their scene: cut out, so that camera rays that meet anything else are clear while the scene

RAYS_AT_ONCE = 1 << 20  # bounds memory


def cut_out(integrator: Any, shapes: Sequence[Any]) -> Any:
    """Return an integrator that sees these shapes alone, as `integrator` sees them, and is clear elsewhere.

    What the shapes mirror and what shines on them stays. With a film that has an alpha channel the picture is
    premultiplied by it.
    """
    mi = use_variant()
    return _class_cut_out(mi.variant())(mi.Properties(), integrator, shapes)


def sees_objects(
    scene: Any, sensor: Any, shapes: Sequence[Any], size: tuple[int, int], at_once: int = RAYS_AT_ONCE
) -> NDArray[np.bool_]:
    """Return which pixels `[row, column]` see one of the shapes in their middle.

    Args:
        scene, sensor: of Mitsuba.
        shapes: of the scene.
        size: width and height.
        at_once: rays that are traced together.
    """
    import drjit as dr

    mi = use_variant()
    width, height = size
    found = np.zeros(width * height, dtype=bool)
    # a scalar variant knows one ray at a time
    step = 1 if mi.variant().startswith("scalar") else at_once
    for begun in range(0, width * height, step):
        index = np.arange(begun, min(begun + step, width * height))
        x, y = (index % width + 0.5) / width, (index // width + 0.5) / height
        place = mi.Point2f(float(x[0]), float(y[0])) if step == 1 else mi.Point2f(mi.Float(x), mi.Float(y))
        ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
        first = scene.ray_intersect_preliminary(ray, True)
        is_seen = is_one_of(first, shapes)
        found[index] = np.asarray(is_seen) if step == 1 else np.asarray(is_seen & dr.full(mi.Bool, True, len(index)))
    return found.reshape(height, width)


def is_one_of(met: Any, shapes: Sequence[Any]) -> Any:
    """Whether what rays met, an interaction of Mitsuba, belongs to one of the shapes."""
    mi = use_variant()
    is_scalar = mi.variant().startswith("scalar")
    is_seen = mi.Bool(False)
    for shape in shapes:
        is_seen = is_seen | (met.shape == (shape if is_scalar else mi.ShapePtr(shape)))
    return is_seen


@functools.cache
def _class_cut_out(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()

    class CutOut(mi.SamplingIntegrator):
        """An integrator that is told which shapes to see."""

        def __init__(self, properties: Any, inner: Any, shapes: Sequence[Any]) -> None:
            super().__init__(properties)
            self.inner, self.shapes = inner, list(shapes)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            is_seen = is_one_of(scene.ray_intersect_preliminary(ray, True, active), self.shapes)
            light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active & is_seen)
            is_seen = is_seen & is_valid & active
            return dr.select(is_seen, light, 0.0), is_seen, rest

        def aov_names(self) -> list[str]:
            return list(self.inner.aov_names())

    return CutOut
