"""Path tracer for our own scenes, and integrators that see only the objects.

Next-event estimation and BSDF sampling, combined by the power heuristic, as in Mitsuba's `path`, with four changes
against noise:

- The first non-specular vertex takes several stratified light samples. Paths that continue from matt surfaces undergo
  Russian roulette, because interreflection contributes little.
- Shadow rays pass null interactions and take their colour, as in `volpath` without media; null interactions do not
  count as events.
- If the camera ray passes clear surfaces straight, both transmission and reflection are followed. A soap film mirrors a
  bright lamp by a few per cent, which a random choice would show as grain.
- Caustics, light that reaches a matt surface by specular paths, require a BSDF sample that meets the lamp: one path in
  100,000 for the sun. On such paths the lamp is `SOFT_LAMP_DEG` wide at equal irradiance, which is unbiased in the mean
  with a softer rim. The `directional` lamp is `WITHIN_LAMP_DEG` wide for light scattered by a clear object that
  leaves it by refraction. Next-event estimation omits these paths, which are those by lobes narrower than
  `SOFT_LAMP_DEG`. Direct light, shadows and the sun's mirror images stay sharp.
"""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.picture.plugins import Plugin, WrappedIntegrator, dr, make_plugin, mi

SOFT_LAMP_DEG = 10.0
WITHIN_LAMP_DEG = 40.0
# solid-angle density above which a lobe is narrower than the soft lamp
NARROW = 1.0 / (2.0 * math.pi * (1.0 - math.cos(math.radians(0.5 * SOFT_LAMP_DEG))))
# light samples at the first non-specular vertex on an object, and on the ground, whose grain is even and less visible
# (denoised error times CPU time: 5 to 12 % lower than with four everywhere). Pearls take one, since each
# sample is a random walk
DRAWS, GROUND_DRAWS = 4, 2
# relative MIS weight for light samples on a diffuse floor: they follow radiance and cosine (bubble noise -4 %;
# equal from 2 to 4)
DIFFUSE_LIGHT_SAMPLE_WEIGHT = 3.0
FAINT = 0.3  # throughput below which, on a split path, only one light sample is taken
MAX_PASSED = 64  # clear surfaces on one shadow ray
MAX_SPLITS = 4  # clear surfaces at which a camera ray splits
RAYS_AT_ONCE = 1 << 20  # bounds memory


def make_paths(
    max_depth: int,
    rr_depth: int,
    passes_through: bool,
    soft: Any = None,
    splits: bool = False,
    spread_by: Sequence[Any] = (),
    draws: int = DRAWS,
    glitters: bool = False,
    objects: Sequence[Any] = (),
) -> Any:
    """Return an integrator in the current variant, which must not be scalar.

    Args:
        max_depth, rr_depth: as in Mitsuba's `path`.
        passes_through: whether shadow rays pass null interactions.
        soft: the scene's environment with small lamps `SOFT_LAMP_DEG` wide; None: not used.
        splits: whether camera rays split at clear surfaces; requires `can_split` for all BSDFs.
        spread_by: shapes whose scattered light `soft` illuminates; empty: all.
        draws: light samples at the first non-specular vertex.
        glitters: resolve single flakes, except in light on matt surfaces, which uses their mean; single paths would
            appear there as light grains.
        objects: shapes that take all draws, others at most `GROUND_DRAWS`; empty: all.
    """
    return make_plugin(Paths, max_depth, rr_depth, passes_through, soft, splits, spread_by, draws, glitters, objects)


def can_split(bsdf: Any) -> bool:
    """Return whether a BSDF's null interaction is a separate component that sampling can omit.

    Mitsuba's `mask` samples it despite the type mask, therefore only our own BSDFs qualify.
    """
    null, everything = int(mi.BSDFFlags.Null), int(mi.BSDFFlags.All)
    if int(bsdf.flags()) & null and not hasattr(bsdf, "plugins"):
        return False
    words = [int(bsdf.flags(index)) & everything for index in range(bsdf.component_count())]
    return all(word == null or not word & null for word in words)


@dataclass
class _Path:
    """Path state; all values are variant arrays."""

    ray: Any
    light: Any  # radiance so far
    weight: Any  # throughput
    base: Any  # throughput at the first diffuse event; 0 before
    eta: Any
    depth: Any
    last: Any  # last vertex
    pdf: Any  # density of the last BSDF sample
    lamp_weight: Any  # MIS weight for light samples at the last vertex
    is_delta: Any  # the last event was specular
    has_spread: Any  # a surface has scattered the light
    is_soft: Any  # the ray meets the soft lamp, not the environment
    deferred: Any  # ray transmitted at a split
    deferred_weight: Any
    is_deferred: Any
    splits: Any  # splits left
    is_seen: Any  # the pixel sees a surface or an environment
    active: Any


class Paths(Plugin):
    """Path tracing without media."""

    def set_up(
        self,
        max_depth: int,
        rr_depth: int,
        passes_through: bool,
        soft: Any,
        splits: bool,
        spread_by: Sequence[Any],
        draws: int,
        glitters: bool,
        objects: Sequence[Any],
    ) -> None:
        flags = mi.BSDFFlags
        self.max_depth, self.rr_depth = max_depth, rr_depth
        self.passes_through, self.soft, self.splits = passes_through, soft, splits
        self.spread_by, self.draws, self.glitters = list(spread_by), draws, glitters
        self.objects = list(objects) if draws > GROUND_DRAWS else []
        self.shiny = int(flags.Glossy | flags.Delta | flags.Null)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        context = mi.BSDFContext()
        if self.splits:  # null interactions are followed separately
            context.type_mask = int(mi.BSDFFlags.All) & ~int(mi.BSDFFlags.Null)

        def body(path: _Path, sampler: Any) -> tuple[_Path, Any]:
            path = copy.copy(path)
            si = scene.ray_intersect(path.ray, mi.RayFlags.All, path.depth == 0, path.active)
            self._add_met_emitter(path, scene, si)
            path.active = path.active & si.is_valid() & (path.depth + 1 < self.max_depth)
            bsdf = si.bsdf()
            if self.glitters:
                from nacre.device.facet_distributions import without_glints

                si = without_glints(si, path.base > 0.0)
            self._thin_out(path, bsdf, sampler)
            lamp_weight = self._add_light_samples(path, scene, si, bsdf, context, sampler)
            most = dr.max(path.weight)
            goes_on = self._pass_straight(path, si, bsdf, sampler) if self.splits else mi.Bool(False)
            self._scatter(path, si, bsdf, context, sampler, goes_on, lamp_weight, most)
            self._roulette(path, sampler)
            if self.splits:
                self._resume(path)
            return path, sampler

        start = _Path(
            mi.Ray3f(ray), mi.Spectrum(0.0), mi.Spectrum(1.0), mi.Float(0.0), mi.Float(1.0), mi.UInt32(0),
            mi.Point3f(0.0), mi.Float(1.0), mi.Float(1.0), mi.Bool(True), mi.Bool(False), mi.Bool(False),
            mi.Ray3f(ray), mi.Spectrum(0.0), mi.Bool(False), mi.UInt32(MAX_SPLITS),
            mi.Bool(scene.environment() is not None), mi.Bool(active),
        )  # fmt: skip
        path, _ = dr.while_loop((start, sampler), lambda path, _: path.active, body, ("path", "sampler"), label="paths")
        return dr.select(path.is_seen, path.light, 0.0), path.is_seen, []

    def _add_met_emitter(self, path: _Path, scene: Any, si: Any) -> None:
        before = dr.zeros(mi.Interaction3f)
        before.p, before.time, before.wavelengths = path.last, path.ray.time, path.ray.wavelengths
        ds = mi.DirectionSample3f(scene, si, before)
        by_lamp = path.lamp_weight * scene.pdf_emitter_direction(before, ds, path.active & (path.is_delta ^ True))
        share = dr.select(path.is_delta, 1.0, _power_heuristic(path.pdf, by_lamp))
        shine = ds.emitter.eval(si, path.active)
        if self.soft is not None:
            is_soft = path.active & path.is_soft & (si.is_valid() ^ True)
            shine = dr.select(is_soft, self.soft.eval(si, is_soft), shine)
            share = dr.select(is_soft, 1.0, share)
        path.light = dr.select(path.active, dr.fma(path.weight * share, shine, path.light), path.light)

    def _thin_out(self, path: _Path, bsdf: Any, sampler: Any) -> None:
        """Russian roulette on matt surfaces after a diffuse event, by the square root of the relative throughput.

        Shiny surfaces may throw a lamp onto matt ones and keep all paths: a Bragg mirror had 45 % more error without.
        """
        worth = dr.sqrt(dr.minimum(dr.max(path.weight) / dr.maximum(path.base, 1e-20), 1.0))
        applies = path.active & (path.base > 0.0) & ((bsdf.flags() & self.shiny) == 0)
        lives = sampler.next_1d(path.active) < worth
        path.weight = dr.select(applies, path.weight / dr.maximum(worth, 1e-20), path.weight)
        path.active = path.active & ((applies ^ True) | lives)

    def _add_light_samples(self, path: _Path, scene: Any, si: Any, bsdf: Any, context: Any, sampler: Any) -> Any:
        """Next-event estimation; return their MIS weight."""
        is_broad = path.active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        is_first = path.base == 0.0
        if self.splits:
            is_first = is_first & ((path.is_deferred & (dr.max(path.weight) < FAINT)) ^ True)
        draws = mi.UInt32(self.draws)
        if self.objects:
            draws = dr.select(is_one_of(si, self.objects), draws, GROUND_DRAWS)
        draws = dr.select(is_first, draws, 1)
        # light samples count more on matt surfaces that face upward
        upward = dr.maximum(dr.sign(si.wi.z) * si.sh_frame.n.z, 0.0)
        on_floor = dr.select((bsdf.flags() & self.shiny) == 0, dr.square(upward), 0.0)
        lamp_weight = mi.Float(draws) * dr.fma(DIFFUSE_LIGHT_SAMPLE_WEIGHT - 1.0, on_floor, 1.0)
        places = _light_sample_points(sampler, draws, path.active)

        def body(count: Any, state: Any) -> Any:
            ds, shine = scene.sample_emitter_direction(si, places(count), not self.passes_through, is_broad)
            is_lit = is_broad & (ds.pdf != 0.0)
            if self.passes_through:
                shine = shine * _transmittance(scene, si, ds, is_lit)
            value, by_bsdf = bsdf.eval_pdf(context, si, si.to_local(ds.d), is_lit)
            if self.soft is not None:  # narrow lobes meet the soft lamp instead
                is_far = ds.emitter == mi.EmitterPtr(scene.environment())
                is_lit = is_lit & ((is_far & path.has_spread & (by_bsdf > NARROW)) ^ True)
            share = dr.select(ds.delta, 1.0, _power_heuristic(lamp_weight * ds.pdf, by_bsdf))
            return count + 1, dr.select(is_lit, dr.fma(share, value * shine, state), state)

        state, labels = (mi.UInt32(0), mi.Spectrum(0.0)), ("count", "found")
        loop = dr.while_loop(state, lambda count, current: is_broad & (count < draws), body, labels, label="lamps")
        current = loop[1] / mi.Float(draws)
        path.light = dr.select(is_broad, dr.fma(path.weight, current, path.light), path.light)
        return lamp_weight

    def _pass_straight(self, path: _Path, si: Any, bsdf: Any, sampler: Any) -> Any:
        """Split the camera ray at a clear surface, or choose transmission at random; return the latter."""
        straight = bsdf.eval_null_transmission(si, path.active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null))
        share = dr.clip(dr.mean(straight), 0.0, 1.0)
        is_both = path.active & (share > 0.0) & (path.depth == 0) & (path.splits > 0)
        path.deferred = dr.select(is_both, si.spawn_ray(path.ray.d), path.deferred)
        path.deferred_weight = dr.select(is_both, path.weight * straight, path.deferred_weight)
        path.is_deferred, path.splits = path.is_deferred | is_both, dr.select(is_both, path.splits - 1, path.splits)
        # probability by square roots, because the reflection is often brighter
        root, other = dr.sqrt(share), dr.sqrt(1.0 - share)
        root = dr.select(is_both, 0.0, root / (root + other))
        goes_on = path.active & (sampler.next_1d(path.active) < root)
        passed, reflected = path.weight * straight / dr.maximum(root, 1e-20), path.weight / (1.0 - root)
        path.weight = dr.select(goes_on, passed, reflected)
        return goes_on

    def _scatter(
        self, path: _Path, si: Any, bsdf: Any, context: Any, sampler: Any, goes_on: Any, lamp_weight: Any, most: Any
    ) -> None:
        bs, scattered = bsdf.sample(
            context, si, sampler.next_1d(path.active), sampler.next_2d(path.active), path.active & (goes_on ^ True)
        )
        path.weight = dr.select(goes_on, path.weight, path.weight * scattered)
        path.eta = dr.select(goes_on, path.eta, path.eta * bs.eta)
        is_null = goes_on | mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
        is_event = path.active & (is_null ^ True)
        is_sharp = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        is_narrow = is_sharp | (bs.pdf > NARROW)
        path.last = dr.select(is_event, si.p, path.last)
        path.pdf = dr.select(is_event, bs.pdf, path.pdf)
        path.is_delta = dr.select(is_event, is_sharp, path.is_delta)
        path.is_soft = dr.select(is_event, path.has_spread & is_narrow, path.is_soft)
        spreads = is_event & (is_narrow ^ True)
        if self.spread_by:
            spreads = spreads & is_one_of(si, self.spread_by)
        path.lamp_weight = dr.select(is_event, lamp_weight, path.lamp_weight)
        is_matt = is_event & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Diffuse) & (path.base == 0.0)
        path.base = dr.select(is_matt, most, path.base)
        path.has_spread = path.has_spread | spreads
        path.is_seen = path.is_seen | is_event
        path.depth = dr.select(is_event, path.depth + 1, path.depth)
        path.ray = si.spawn_ray(dr.select(goes_on, path.ray.d, si.to_world(bs.wo)))

    def _roulette(self, path: _Path, sampler: Any) -> None:
        most = dr.max(path.weight)
        path.active = path.active & (most != 0.0)
        survival = dr.minimum(most * dr.square(path.eta), 0.95)
        applies = path.depth >= self.rr_depth
        lives = sampler.next_1d(path.active) < survival
        path.weight = dr.select(applies, path.weight / dr.maximum(survival, 1e-20), path.weight)
        path.active = path.active & ((applies ^ True) | lives)

    def _resume(self, path: _Path) -> None:
        """Continue with the last split's transmitted ray once a path has ended."""
        turns = path.is_deferred & (path.active ^ True)
        path.ray, path.weight = (
            dr.select(turns, path.deferred, path.ray),
            dr.select(turns, path.deferred_weight, path.weight),
        )
        path.eta, path.pdf = dr.select(turns, 1.0, path.eta), dr.select(turns, 1.0, path.pdf)
        path.depth, path.base = dr.select(turns, 0, path.depth), dr.select(turns, 0.0, path.base)
        path.is_delta, path.active = path.is_delta | turns, path.active | turns
        stays = turns ^ True
        path.has_spread, path.is_soft, path.is_deferred = (
            path.has_spread & stays,
            path.is_soft & stays,
            path.is_deferred & stays,
        )


def _power_heuristic(chosen: Any, other: Any) -> Any:
    a, b = chosen * chosen, other * other
    return dr.select(a > 0.0, a / (a + b), 0.0)


def _transmittance(scene: Any, si: Any, ds: Any, active: Any) -> Any:
    """Clear-surface transmittance between `si` and a light sample."""
    straight = si.spawn_ray_to(ds.p)
    # most rays meet no surface, which the cheaper occlusion test finds
    state = (straight, mi.Spectrum(1.0), mi.UInt32(0), active & scene.ray_test(straight, active))

    def body(ray: Any, share: Any, count: Any, going: Any) -> Any:
        hit = scene.ray_intersect(ray, mi.RayFlags.All, False, going)
        going = going & hit.is_valid()
        share = dr.select(going, share * hit.bsdf().eval_null_transmission(hit, going), share)
        going = going & dr.any(share > 0.0) & (count < MAX_PASSED)
        return hit.spawn_ray_to(ds.p), share, count + 1, going

    labels = ("ray", "share", "count", "going")
    loop = dr.while_loop(state, lambda ray, share, count, going: going, body, labels, label="shadow ray")
    return dr.select(loop[3], 0.0, loop[1])  # dark beyond `MAX_PASSED` surfaces


def _light_sample_points(sampler: Any, draws: Any, active: Any) -> Callable[[Any], Any]:
    """Return a function from a number below `draws` to a point in the unit square."""
    if hasattr(sampler, "several_2d"):
        points: Callable[[Any], Any] = sampler.several_2d(draws)
        return points
    place, many = sampler.next_2d(active), mi.Float(draws)

    def point(number: Any) -> Any:
        # a lattice with a random shift
        x, y = place.x + mi.Float(number) / many, place.y + mi.Float(dr.brev(number) >> 8) * (1.0 / (1 << 24))
        return mi.Point2f(x - dr.floor(x), y - dr.floor(y))

    return point


def cut_out(integrator: Any, shapes: Sequence[Any]) -> Any:
    """Return an integrator that sees only these shapes and is transparent elsewhere.

    Light and mirror images from other objects stay. The picture is premultiplied by the film's alpha channel.
    """
    return make_plugin(CutOut, integrator, shapes)


class CutOut(WrappedIntegrator):
    """An integrator that sees some shapes only."""

    def set_up(self, inner: Any, shapes: Sequence[Any]) -> None:
        self.inner, self.shapes = inner, list(shapes)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        is_hit = is_one_of(scene.ray_intersect_preliminary(ray, True, active), self.shapes)
        light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active & is_hit)
        is_hit = is_hit & is_valid & active
        return dr.select(is_hit, light, 0.0), is_hit, rest


def sees_objects(
    scene: Any, sensor: Any, shapes: Sequence[Any], size: tuple[int, int], at_once: int = RAYS_AT_ONCE
) -> NDArray[np.bool_]:
    """Return which pixels `[row, column]` see the shapes at their centre.

    Args:
        scene, sensor: Mitsuba objects.
        shapes: scene shapes.
        size: width and height.
        at_once: rays per batch.
    """
    width, height = size
    sees = np.zeros(width * height, dtype=bool)
    step = 1 if mi.variant().startswith("scalar") else at_once
    for begun in range(0, width * height, step):
        index = np.arange(begun, min(begun + step, width * height))
        x, y = (index % width + 0.5) / width, (index // width + 0.5) / height
        place = mi.Point2f(float(x[0]), float(y[0])) if step == 1 else mi.Point2f(mi.Float(x), mi.Float(y))
        ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
        is_hit = is_one_of(scene.ray_intersect_preliminary(ray, True), shapes)
        sees[index] = np.asarray(is_hit) if step == 1 else np.asarray(is_hit & dr.full(mi.Bool, True, len(index)))
    return sees.reshape(height, width)


def is_one_of(met: Any, shapes: Sequence[Any]) -> Any:
    """Return whether an interaction's shape is among the given ones."""
    is_scalar = mi.variant().startswith("scalar")
    is_hit = mi.Bool(False)
    for shape in shapes:
        is_hit = is_hit | (met.shape == (shape if is_scalar else mi.ShapePtr(shape)))
    return is_hit
