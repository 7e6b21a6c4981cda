"""What each pixel sees first, which guides the denoiser: albedo, normal, depth.

Through clear surfaces and in mirrors the albedo is that of what is seen beyond or in them, times what the surface lets
on; where that is a lamp or the sky it is their light, at most white. So the guide holds the edges that the picture has.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant
from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, white_xyz, xyz_to_srgb_linear

MOST_SHARP = 5  # surfaces that a guide's ray passes or is mirrored by


def guide_tracer() -> Any:
    """Return an integrator that sees albedo in place of light, with normal and depth of the first hit beside."""
    mi = use_variant()
    return _class(mi.variant())(mi.Properties())


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

    class Guides(mi.SamplingIntegrator):
        """Follows mirror images and straight-through light to the first surface that spreads it."""

        def aov_names(self) -> Sequence[str]:
            return ["nx", "ny", "nz", "depth"]

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            context = mi.BSDFContext()
            first = scene.ray_intersect(ray, mi.RayFlags.All, True, active)
            hit = active & first.is_valid()
            normal = dr.select(hit, first.sh_frame.n, 0.0)
            depth = dr.select(hit, first.t, 0.0)
            sharp = int(mi.BSDFFlags.Delta | mi.BSDFFlags.Null)

            def body(ray: Any, seen: Any, weight: Any, count: Any, active: Any, sampler: Any) -> Any:
                si = scene.ray_intersect(ray, mi.RayFlags.All, count == 0, active)
                lamp = si.emitter(scene)
                # a scalar variant says so where there is none
                light = mi.Spectrum(0.0) if lamp is None else dr.minimum(lamp.eval(si, active), 1.0)
                seen = dr.select(active, dr.fma(weight, light, seen), seen)
                active = active & si.is_valid()
                bsdf = si.bsdf()
                bs, scattered = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
                # the mean weight of a draw is the share of light that is reflected, for matt surfaces exactly
                is_sharp = (bs.sampled_type & sharp) != 0
                seen = dr.select(active & (is_sharp ^ True), dr.fma(weight, dr.minimum(scattered, 1.0), seen), seen)
                active = active & is_sharp & (count < MOST_SHARP)
                weight = weight * scattered
                active = active & (dr.max(weight) > 0.0)
                return si.spawn_ray(si.to_world(bs.wo)), seen, weight, count + 1, active, sampler

            state = (
                mi.Ray3f(ray), mi.Spectrum(0.0), mi.Spectrum(1.0), mi.UInt32(0), mi.Bool(active), sampler,
            )  # fmt: skip
            done = dr.while_loop(
                state, lambda *state: state[-2], body, ("ray", "seen", "weight", "count", "active", "sampler"),
                label="guides",
            )  # fmt: skip
            return done[1], mi.Bool(True), [normal.x, normal.y, normal.z, depth]

    return Guides
