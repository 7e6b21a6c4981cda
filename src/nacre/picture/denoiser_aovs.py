"""What each pixel sees first, which guides the denoiser: albedo, normal, depth.

Through clear surfaces and in mirrors the albedo is that of what is seen beyond or in them, times what the surface lets
on; where that is a lamp or the sky it is their light, at most white. So the guide holds the edges that the picture has.

Ways that a surface offers beside each other are followed both, and beyond the first ones the brighter, in place of one
that is drawn. So all pixels may take the same draws, and most guides have no grain, which would have to be taken out
of them and their edges with it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant
from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, white_xyz, xyz_to_srgb_linear

MOST_SHARP = 3  # surfaces that a guide's ray passes or is mirrored by; 5 take half as long again and tell no more
MOST_SPLIT = 3  # of those that it passes unbent, where it goes both ways
# surfaces whose lobes send on about as much whatever is drawn, and those whose weights make faint lines: the same draws
# in all pixels leave less of these in a guide than its own would leave grain
EVEN, LINED = [("microfacet",), ("diffuse",)], [("ridge",)]


@dataclass(frozen=True)
class Ways:
    """How the guides of a scene take the ways of its light.

    Attributes:
        draws: one way is drawn of those that a surface offers, as random walks do: the draws are the pixels' own.
        own: where light is spread it goes by draws of the pixel's own: weights that depend on the draw would make
            patterns if all pixels took the same.
        has_grain: whether it is to be taken out of the guide before that guides.
    """

    draws: bool
    own: bool
    has_grain: bool


def walks(scene: Any) -> bool:
    """Whether a surface of a scene of Mitsuba answers by random walks."""
    bsdfs = [shape.bsdf() for shape in scene.shapes()]
    return any(not plugin.pdf_is_exact for bsdf in bsdfs for plugin in getattr(bsdf, "plugins", ()))


def ways_of(scene: Any, is_ours: bool) -> Ways:
    """Return how the guides of a scene take its light.

    Args:
        scene: of Mitsuba.
        is_ours: no scene of a user's, whose BSDFs may draw what is not asked for, as `mask` and `blendbsdf` do.
    """
    flags = use_variant().BSDFFlags
    sharp = int(flags.Delta | flags.Null)
    bsdfs = [shape.bsdf() for shape in scene.shapes() if shape.bsdf() is not None]
    others = [bsdf for bsdf in bsdfs if not hasattr(bsdf, "plugins")]
    mixes = not is_ours and any(int(b.flags()) & sharp and b.component_count() > 1 for b in others)
    draws = mixes or walks(scene)
    spread = [_spread(bsdf) for bsdf in bsdfs if hasattr(bsdf, "plugins")]
    own = any(kinds and kinds not in EVEN + LINED for kinds in spread)
    # rough plastic of Mitsuba sends on by its coat or by what lies below it
    lined = any(kinds in LINED for kinds in spread) or any(
        b.component_count() > 1 and not int(b.flags()) & sharp for b in others
    )
    return Ways(draws, own, has_grain=draws or own or lined)


def _spread(bsdf: Any) -> tuple[str, ...]:
    """Return the kinds of the lobes that spread light, once for each of their components that do."""
    smooth = int(use_variant().BSDFFlags.Smooth)
    return tuple(plugin.kind for plugin in bsdf.plugins for word in plugin.components if int(word) & smooth)


def guide_tracer(scene: Any, ways: Ways) -> Any:
    """Return an integrator that sees albedo in place of light, with normal and depth of the first hit beside.

    Args:
        scene: of Mitsuba, whose surfaces it shall know.
        ways: `ways_of` it.
    """
    mi = use_variant()
    flags = [int(shape.bsdf().flags()) for shape in scene.shapes() if shape.bsdf() is not None]
    return _class(mi.variant())(mi.Properties(), functools.reduce(int.__or__, flags, 0), ways)


def first_hits(mean: NDArray[np.float64]) -> dict[str, NDArray[np.float32]]:
    """Return albedo (reflectance) and normal `[row, column, 3]` and depth `[..., 1]` from what the tracer gave.

    Args:
        mean: `[row, column, 7]`: XYZ, normal and depth.
    """
    mean = np.nan_to_num(mean, nan=0.0, posinf=0.0, neginf=0.0)
    # reflectances are seen as under light of equal energy: make its white white
    seen_as = adapt_xyz(mean[..., :3], white_xyz("E"), SRGB_WHITE_XYZ)
    albedo = np.clip(xyz_to_srgb_linear(seen_as), 0.0, 1.0).astype(np.float32)
    normal = np.clip(mean[..., 3:6], -1.0, 1.0).astype(np.float32)
    return {"albedo": albedo, "normal": normal, "depth": np.maximum(mean[..., 6:], 0.0).astype(np.float32)}


@functools.cache
def _class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()

    kinds = mi.BSDFFlags
    sharp = int(kinds.Delta | kinds.Null)
    # kinds of light that surfaces send on: spread, mirrored, straight through or bent
    spread, mirrored, through = int(kinds.Smooth), int(kinds.DeltaReflection), int(kinds.DeltaTransmission | kinds.Null)

    class Guides(mi.SamplingIntegrator):
        """Follows mirror images and straight-through light to the first surface that spreads it."""

        def __init__(self, properties: Any, flags: int, ways: Ways) -> None:
            super().__init__(properties)
            self.flags, self.ways = flags, ways

        def aov_names(self) -> Sequence[str]:
            return ["nx", "ny", "nz", "depth"]

        def one_way(self, si: Any, sampler: Any, active: Any) -> tuple[Any, Any, Any]:
            """Return what is spread of the way that is drawn, its direction, and its weight where it is sharp."""
            if active is False:  # a scalar variant has no surface to ask where nothing is hit
                return mi.Spectrum(0.0), mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(0.0)
            bs, share = si.bsdf().sample(mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), active)
            # the mean weight of a draw is the share of light that is reflected, for matt surfaces exactly
            is_sharp = (bs.sampled_type & sharp) != 0
            return dr.select(is_sharp, 0.0, dr.minimum(share, 1.0)), bs.wo, dr.select(is_sharp, share, 0.0)

        def of_kind(self, kind: int, si: Any, first: Any, second: Any, active: Any) -> tuple[Any, Any]:
            """Return the direction and weight of the light of a kind; weight 0 where there is none."""
            if not self.flags & kind or active is False:  # a scalar variant has no surface to ask where nothing is hit
                return mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(0.0)
            context = mi.BSDFContext()
            context.type_mask = kind
            bsdf = si.bsdf()
            asked = active & ((bsdf.flags() & kind) != 0)
            bs, share = bsdf.sample(context, si, first, second, asked)
            return bs.wo, dr.select(asked, share, 0.0)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            first = scene.ray_intersect(ray, mi.RayFlags.All, True, active)
            hit = active & first.is_valid()
            normal = dr.select(hit, first.sh_frame.n, 0.0)
            depth = dr.select(hit, first.t, 0.0)

            def body(
                ray: Any, seen: Any, weight: Any, count: Any, is_first: Any, kept: Any, kept_weight: Any, splits: Any,
                active: Any, sampler: Any,
            ) -> Any:  # fmt: skip
                si = scene.ray_intersect(ray, mi.RayFlags.All, count == 0, active)
                lamp = si.emitter(scene)
                # a scalar variant says so where there is none
                light = mi.Spectrum(0.0) if lamp is None else dr.minimum(lamp.eval(si, active), 1.0)
                seen = dr.select(active, dr.fma(weight, light, seen), seen)
                active = active & si.is_valid()
                if self.ways.draws:
                    matt, way, share = self.one_way(si, sampler, active)
                else:
                    one, two = sampler.next_1d(active), sampler.next_2d(active)
                    own = (one, two)
                    if self.ways.own and hasattr(sampler, "own_key"):
                        own = (sampler.next_1d(active, of_pixel=True), sampler.next_2d(active, of_pixel=True))
                    matt = dr.minimum(self.of_kind(spread, si, *own, active)[1], 1.0)
                    way, share = self.of_kind(mirrored, si, one, two, active)
                    on, passed = self.of_kind(through, si, one, two, active)
                    is_both = is_first & (splits > 0) & (dr.max(share) > 0.0) & (dr.max(passed) > 0.0)
                    goes_on = (dr.mean(passed) > dr.mean(share)) & (is_both ^ True)
                    kept = dr.select(is_both, si.spawn_ray(si.to_world(on)), kept)
                    kept_weight = dr.select(is_both, weight * passed, kept_weight)
                    splits = dr.select(is_both, splits - 1, splits)
                    way, share = dr.select(goes_on, on, way), dr.select(goes_on, passed, share)
                    is_first = is_first & goes_on
                seen = dr.select(active, dr.fma(weight, matt, seen), seen)
                active = active & (count < MOST_SHARP)
                weight = weight * share
                active = active & (dr.max(weight) > 0.0)
                ray, count = si.spawn_ray(si.to_world(way)), count + 1
                if not self.ways.draws:  # the other way, once this one has ended
                    turns = (active ^ True) & (dr.max(kept_weight) > 0.0)
                    ray, weight = dr.select(turns, kept, ray), dr.select(turns, kept_weight, weight)
                    count, kept_weight = dr.select(turns, 1, count), dr.select(turns, 0.0, kept_weight)
                    active, is_first = active | turns, is_first | turns
                return ray, seen, weight, count, is_first, kept, kept_weight, splits, active, sampler

            state = (
                mi.Ray3f(ray), mi.Spectrum(0.0), mi.Spectrum(1.0), mi.UInt32(0), mi.Bool(True), mi.Ray3f(ray),
                mi.Spectrum(0.0), mi.UInt32(MOST_SPLIT), mi.Bool(active), sampler,
            )  # fmt: skip
            done = dr.while_loop(
                state, lambda *state: state[-2], body,
                ("ray", "seen", "weight", "count", "is_first", "kept", "kept_weight", "splits", "active", "sampler"),
                label="guides",
            )  # fmt: skip
            return done[1], mi.Bool(True), [normal.x, normal.y, normal.z, depth]

    return Guides
