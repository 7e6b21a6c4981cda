"""AOVs that guide the denoiser: albedo, normal and depth at each pixel's first hit.

Through clear surfaces and mirrors the albedo belongs to the surface seen, times the transmittance or reflectance; for
lamps and sky it is their light, clipped at white. The AOVs therefore contain the picture's edges.

At surfaces that both reflect and transmit, both paths are followed, later only the brighter one, rather than one random
path. All pixels may then use equal random numbers, and most AOVs lack grain, whose removal would blur edges.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, white_xyz, xyz_to_srgb_linear
from nacre.picture.plugin import Plugin, dr, make_plugin, mi

MAX_SHARP = 3  # specular events per path; 5 take half as long again without benefit
MAX_SPLITS = 3  # events at which both paths are followed
# lobes whose BSDF sampling weights are about constant, and lobes whose weights draw faint lines, which disturb less
# than grain
EVEN, LINED = [("microfacet",), ("diffuse",)], [("ridge",), ("ridge-table",)]


@dataclass(frozen=True)
class AovSampling:
    """Sampling method for a scene's AOVs.

    Attributes:
        draws: choose one path at random, as random walks do; pixels use individual numbers.
        own: scatter with individual numbers per pixel, because equal ones would draw patterns.
        has_grain: whether the albedo needs cleaning.
    """

    draws: bool
    own: bool
    has_grain: bool


def has_random_walks(scene: Any) -> bool:
    """Return whether a Mitsuba scene has a BSDF that uses random walks."""
    bsdfs = [shape.bsdf() for shape in scene.shapes()]
    return any(not plugin.pdf_is_exact for bsdf in bsdfs for plugin in getattr(bsdf, "plugins", ()))


def aov_sampling(scene: Any, is_ours: bool) -> AovSampling:
    """Choose the AOV sampling method.

    Args:
        scene: Mitsuba scene.
        is_ours: whether the scene is ours; BSDFs in user scenes, such as `mask` and `blendbsdf`, may ignore type masks.
    """
    flags = mi.BSDFFlags
    sharp = int(flags.Delta | flags.Null)
    bsdfs = [shape.bsdf() for shape in scene.shapes() if shape.bsdf() is not None]
    # (is specular in part, has several components) for Mitsuba's BSDFs, such as rough plastic with coat and base
    others = [(bool(int(b.flags()) & sharp), b.component_count() > 1) for b in bsdfs if not hasattr(b, "plugins")]
    draws = (not is_ours and (True, True) in others) or has_random_walks(scene)
    spread = [_scattering_lobes(bsdf) for bsdf in bsdfs if hasattr(bsdf, "plugins")]
    own = any(kinds and kinds not in EVEN + LINED for kinds in spread)
    lined = any(kinds in LINED for kinds in spread) or (False, True) in others
    return AovSampling(draws, own, has_grain=draws or own or lined)


def _scattering_lobes(bsdf: Any) -> tuple[str, ...]:
    """Return each non-specular component's lobe type."""
    smooth = int(mi.BSDFFlags.Smooth)
    return tuple(plugin.kind for plugin in bsdf.plugins for word in plugin.components if int(word) & smooth)


def aov_integrator(scene: Any, sampling: AovSampling) -> Any:
    """Return an integrator for the albedo, with first-hit normal and depth as AOVs.

    Args:
        scene: Mitsuba scene.
        sampling: from `aov_sampling`.
    """
    flags = [int(shape.bsdf().flags()) for shape in scene.shapes() if shape.bsdf() is not None]
    return make_plugin(AovIntegrator, functools.reduce(int.__or__, flags, 0), sampling)


def first_hits(mean: NDArray[np.float64]) -> dict[str, NDArray[np.float32]]:
    """Return albedo (reflectance) and normal `[row, column, 3]` and depth `[..., 1]` from rendered means.

    Args:
        mean: `[row, column, 7]`: XYZ, normal and depth.
    """
    mean = np.nan_to_num(mean, nan=0.0, posinf=0.0, neginf=0.0)
    # reflectances as XYZ refer to equal-energy light
    seen_as = adapt_xyz(mean[..., :3], white_xyz("E"), SRGB_WHITE_XYZ)
    albedo = np.clip(xyz_to_srgb_linear(seen_as), 0.0, 1.0).astype(np.float32)
    normal = np.clip(mean[..., 3:6], -1.0, 1.0).astype(np.float32)
    return {"albedo": albedo, "normal": normal, "depth": np.maximum(mean[..., 6:], 0.0).astype(np.float32)}


@dataclass
class _Path:
    """Path state; all values are variant arrays."""

    ray: Any
    seen: Any  # albedo so far
    weight: Any
    count: Any
    is_first: Any  # transmission has been followed without interruption
    kept: Any  # ray for the second path
    kept_weight: Any
    splits: Any
    active: Any


class AovIntegrator(Plugin):
    """Follows specular paths to the first surface that scatters."""

    def set_up(self, flags: int, sampling: AovSampling) -> None:
        kinds = mi.BSDFFlags
        self.flags, self.sampling = flags, sampling
        self.sharp = int(kinds.Delta | kinds.Null)
        self.spread, self.mirrored = int(kinds.Smooth), int(kinds.DeltaReflection)
        self.through = int(kinds.DeltaTransmission | kinds.Null)

    def aov_names(self) -> list[str]:
        return ["nx", "ny", "nz", "depth"]

    def _random(self, si: Any, sampler: Any, active: Any) -> tuple[Any, Any, Any]:
        """Sample one path: scattered share, direction, and weight if the event is specular."""
        if active is False:  # a scalar variant without a hit
            return mi.Spectrum(0.0), mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(0.0)
        bs, share = si.bsdf().sample(mi.BSDFContext(), si, sampler.next_1d(active), sampler.next_2d(active), active)
        # the mean sample weight is the reflectance
        is_sharp = (bs.sampled_type & self.sharp) != 0
        return dr.select(is_sharp, 0.0, dr.minimum(share, 1.0)), bs.wo, dr.select(is_sharp, share, 0.0)

    def _of_kind(self, kind: int, si: Any, first: Any, second: Any, active: Any) -> tuple[Any, Any]:
        """Sample one interaction type: direction and weight, 0 if there are none."""
        if not self.flags & kind or active is False:  # a scalar variant without a hit
            return mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(0.0)
        context = mi.BSDFContext()
        context.type_mask = kind
        bsdf = si.bsdf()
        asked = active & ((bsdf.flags() & kind) != 0)
        bs, share = bsdf.sample(context, si, first, second, asked)
        return bs.wo, dr.select(asked, share, 0.0)

    def _split(self, path: _Path, si: Any, sampler: Any) -> tuple[Any, Any, Any]:
        """Follow reflection and transmission; return the current path's scattered share, direction and weight."""
        active = path.active
        one, two = sampler.next_1d(active), sampler.next_2d(active)
        own = (one, two)
        if self.sampling.own and hasattr(sampler, "own_key"):
            own = (sampler.next_1d(active, of_pixel=True), sampler.next_2d(active, of_pixel=True))
        matt = dr.minimum(self._of_kind(self.spread, si, *own, active)[1], 1.0)
        way, share = self._of_kind(self.mirrored, si, one, two, active)
        on, passed = self._of_kind(self.through, si, one, two, active)
        is_both = path.is_first & (path.splits > 0) & (dr.max(share) > 0.0) & (dr.max(passed) > 0.0)
        goes_on = (dr.mean(passed) > dr.mean(share)) & (is_both ^ True)
        path.kept = dr.select(is_both, si.spawn_ray(si.to_world(on)), path.kept)
        path.kept_weight = dr.select(is_both, path.weight * passed, path.kept_weight)
        path.splits = dr.select(is_both, path.splits - 1, path.splits)
        path.is_first = path.is_first & goes_on
        return matt, dr.select(goes_on, on, way), dr.select(goes_on, passed, share)

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        first = scene.ray_intersect(ray, mi.RayFlags.All, True, active)
        hit = active & first.is_valid()
        normal = dr.select(hit, first.sh_frame.n, 0.0)
        depth = dr.select(hit, first.t, 0.0)

        def body(path: _Path, sampler: Any) -> tuple[_Path, Any]:
            path = copy.copy(path)
            si = scene.ray_intersect(path.ray, mi.RayFlags.All, path.count == 0, path.active)
            lamp = si.emitter(scene)
            light = mi.Spectrum(0.0) if lamp is None else dr.minimum(lamp.eval(si, path.active), 1.0)
            path.seen = dr.select(path.active, dr.fma(path.weight, light, path.seen), path.seen)
            path.active = path.active & si.is_valid()
            if self.sampling.draws:
                matt, way, share = self._random(si, sampler, path.active)
            else:
                matt, way, share = self._split(path, si, sampler)
            path.seen = dr.select(path.active, dr.fma(path.weight, matt, path.seen), path.seen)
            path.active = path.active & (path.count < MAX_SHARP)
            path.weight = path.weight * share
            path.active = path.active & (dr.max(path.weight) > 0.0)
            path.ray, path.count = si.spawn_ray(si.to_world(way)), path.count + 1
            if not self.sampling.draws:  # the second path, once the first has ended
                turns = (path.active ^ True) & (dr.max(path.kept_weight) > 0.0)
                path.ray = dr.select(turns, path.kept, path.ray)
                path.weight = dr.select(turns, path.kept_weight, path.weight)
                path.count = dr.select(turns, 1, path.count)
                path.kept_weight = dr.select(turns, 0.0, path.kept_weight)
                path.active, path.is_first = path.active | turns, path.is_first | turns
            return path, sampler

        start = _Path(
            mi.Ray3f(ray), mi.Spectrum(0.0), mi.Spectrum(1.0), mi.UInt32(0), mi.Bool(True), mi.Ray3f(ray),
            mi.Spectrum(0.0), mi.UInt32(MAX_SPLITS), mi.Bool(active),
        )  # fmt: skip
        path, _ = dr.while_loop((start, sampler), lambda path, _: path.active, body, ("path", "sampler"), label="aovs")
        return path.seen, mi.Bool(True), [normal.x, normal.y, normal.z, depth]
