"""Picture denoising by Intel's Open Image Denoise (package `mitsuba-oidn`).

The denoiser works in linear Rec. 2020, close to its training data and wide enough that few values are negative (it
clips these). AOVs guide it (`nacre.picture.denoise`). Afterwards two errors are corrected. Local mean
colours, which it biases because it measures grain on a compressive scale, are restored. Texture that it
mistook for grain is restored scale by scale: by the share that noise cannot explain in the removed signal. Two sample
halves give the noise; highlights present in both are restored. Pixels must not share samples, therefore the
picture needs the box filter; the denoiser takes grain through a wider filter for texture.
"""

import copy
import functools
import math
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.machine import available_jobs, single_threaded_blas
from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, white_xyz, xyz_to_srgb_linear
from nacre.picture.plugins import Plugin, Real, dr, make_plugin, mi, smooth

# samples per pixel for AOVs with grain and AOV layers, and for AOVs without grain (8, not 4, lower a bubble's FLIP
# from 0.0279 to 0.0277 and cost one and a half picture samples)
AOV_SPP, EVEN_AOV_SPP = 16, 8
# XYZ -> linear Rec. 2020 (ITU-R BT.2020, white D65)
TO_RGB = np.array(
    [[1.7166512, -0.3556708, -0.2533663], [-0.6666844, 1.6164812, 0.0157685], [0.0176399, -0.0427706, 0.9421031]]
)
# standard deviations, in pixels, between the scales; beyond the last one the whole loss is restored (otherwise mean
# colours were off by dE00 0.2 to 0.4 at 64 samples per pixel)
SCALES = (1.0, 2.0, 5.0)
ALL_SCALES = math.sqrt(sum(scale**2 for scale in SCALES))  # the Gaussian equivalent to all scales in succession
NEARBY = 2.5  # relative to the scale: averaging width for noise and loss
KEPT_MEANS = 6.0  # the only scale if the noise is unknown; restored grain is 1/20 relative to the raw picture
# luminance and two colour differences, which separate spectral noise and texture better than XYZ
OPPONENT = np.array([[0.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])
# Maximum correction relative to the pixel's light, against fireflies. Spectral noise is skewed (many dark pixels,
# few very bright ones): with 1 a blue pearl lost 12 % blue light (dE00 3.4), with 8 it loses 0.3 %, and a firefly
# returns by 3.5 %.
LARGEST_RETURN = 8.0
DARKEST = 1e-3  # relative to the neighbourhood: black below
DENOISE_EVEN = 1.0  # log-light spread up to which a neighbourhood counts as even
LARGEST_TEXTURE = 1.0  # as LARGEST_RETURN, for texture: both halves may contain a firefly
# Highlights exceed this multiple of the noise (fourth root of its local fourth moment) in both halves: where
# fireflies are frequent, both halves may contain one at the same place
BEYOND_CHANCE, ABOUT = 6.0, 5.0
SURE = 0.5  # smaller shares may be chance and count less
CHANCE = 0.25  # excess over the noise, in standard errors, that counts as chance; twice as much counts in full
# kurtosis of normal noise, and the range over which texture fades out; longer tails scale CHANCE (light from a bubble
# on its floor returned as specks)
NORMAL_TAILS, TAILS = 3.0, (20.0, 40.0)
# relative to the noise nearby: one path made a pixel with a larger difference, unless that is still small
OUTLIER, FAR_LARGER = 2.0, 0.25
# returned texture of a pixel, relative to the rms of the texture nearby that noise does not explain, and the standard
# errors by which this rms is reduced; a uniform distribution reaches 1.73 (without it pixels of narrow grating orders,
# in which both halves agree by chance, were coloured specks: 93 of 2905 even pixels of a compact disc were off by more
# than dE00 3, with it 3)
MOST_TEXTURE, REDUCTION = 2.5, 3.0
STRIP_PIXELS = 1 << 21  # per strip: half a gigabyte
TILED_FROM, TILED_MB = 3 << 19, 512  # pixels above which the denoiser's memory is limited, and the limit
MARGIN = 128  # rows beyond a strip in the denoiser's field of view
BLOCK, MIDDLE_GREY = 16, 0.18
OFF = "NACRE_DENOISE"  # environment variable; "0" turns denoising off


def inapplicable_reason(bsdf: Any) -> str:
    """Return why a BSDF's pictures cannot be denoised; "" if they can."""
    if os.environ.get(OFF) == "0":
        return f"{OFF} = 0"
    if any(_has_glints(lobe) for lobe in getattr(bsdf, "lobes", ())):
        return "glints would be taken for noise"
    try:
        import mitsuba_oidn  # noqa: F401
    except (ImportError, OSError) as error:
        return f"mitsuba-oidn cannot be imported: {' '.join(str(error).split())[:120]}"
    return ""


def _has_glints(lobe: Any) -> bool:
    # resolved flakes, also within a masked lobe
    return getattr(lobe, "glint_numbers", None) is not None or (hasattr(lobe, "inner") and _has_glints(lobe.inner))


def clean_albedo(albedo: NDArray[np.float32]) -> NDArray[np.float32]:
    """Denoise the albedo `[row, column, 3]`, whose colours have spectral noise."""
    clean = np.empty_like(albedo)
    for rows, inner_rows, inner in strips(*albedo.shape[:2]):
        clean[inner_rows] = np.clip(_filtered(albedo[rows])[inner], 0.0, 1.0)
    return clean


def denoised(
    xyz: NDArray[np.float64],
    albedo: NDArray[np.float32],
    normal: NDArray[np.float32],
    difference: NDArray[np.float32] | None = None,
) -> NDArray[np.float64]:
    """Denoise a linear XYZ picture `[row, column, 3]`.

    Args:
        xyz: as rendered.
        albedo, normal: AOVs; the albedo clean.
        difference: `[row, column, 3]`, a noise sample for `xyz` (see `nacre.picture.passes.Frame`). Without it
            only mean colours are restored.
    """
    result = np.empty_like(xyz)
    parts = strips(*xyz.shape[:2])
    scale = None if len(parts) == 1 else exposure(xyz[..., 1])
    with single_threaded_blas():  # small products, some in threads
        for rows, inner_rows, inner in parts:
            noise = None if difference is None else difference[rows]
            result[inner_rows] = _strip(xyz[rows], albedo[rows], normal[rows], scale, noise)[inner]
    return result


def _strip(
    xyz: NDArray[np.float64],
    albedo: NDArray[np.float32],
    normal: NDArray[np.float32],
    scale: float | None,
    difference: NDArray[np.float32] | None,
) -> NDArray[np.float64]:
    rgb = np.asarray(np.maximum(xyz @ TO_RGB.T, 0.0), dtype=np.float32)
    # `clean_aux`: without it the error at edges was 1.3 times as large. The smaller network saves 0.2 CPU s at 256 x
    # 256 and loses 4 to 10 % FLIP, more than samples recover
    clean = _filtered(rgb, {"albedo": albedo, "normal": normal}, hdr=True, clean_aux=True, input_scale=scale)
    clean = np.maximum(np.asarray(clean, dtype=np.float64) @ np.linalg.inv(TO_RGB).T, 0.0)
    own = clean.max(axis=-1).astype(np.float32)
    bound = np.float32(LARGEST_RETURN) * own[..., None]
    removed = (xyz - clean).astype(np.float32)
    if difference is None:
        removed = np.clip(removed, -bound, bound)
        mean, share = means_by_light(removed, own, lambda values: smooth(values, KEPT_MEANS))
        return np.maximum(clean + share * mean * beyond_chance(mean, removed), 0.0)
    # separate from the scales, in which a highlight's rest would glow
    sharp = highlights(removed, difference)
    removed -= sharp
    mean, share = means_by_light(np.clip(removed, -bound, bound), own, means)
    bound *= np.float32(LARGEST_TEXTURE / LARGEST_RETURN)
    texture = beyond_noise(np.clip(removed - mean, -bound, bound), np.clip(difference, -bound, bound))
    return np.maximum(clean + share * (np.clip(texture, -bound, bound) + mean) + sharp, 0.0)


def highlights(removed: NDArray[Any], difference: NDArray[np.float32]) -> NDArray[Any]:
    """Return the signal in `removed` that both halves contain beyond chance: mirrored lamps, not fireflies.

    Args:
        removed: XYZ `[row, column, 3]`, raw minus clean picture.
        difference: half the difference between the halves.
    """
    first, second = removed + difference, removed - difference
    common = np.where(first * second > 0.0, np.minimum(np.abs(first), np.abs(second)), 0.0)
    chance = BEYOND_CHANCE * np.sqrt(np.sqrt(smooth((difference**2) ** 2, ABOUT)))
    return np.asarray(np.copysign(np.maximum(common - chance, 0.0), removed))


def _filtered(
    colour: NDArray[np.float32], guides: Mapping[str, NDArray[np.float32]] | None = None, **options: Any
) -> NDArray[np.float32]:
    """Apply the denoiser to a picture `[row, column, 3]`.

    It uses a kilobyte per pixel without a limit and does not release it. A large picture is processed in its tiles,
    with equal results, on a separate device that releases its memory.
    """
    import mitsuba_oidn as oidn

    images = {name: np.ascontiguousarray(values) for name, values in {"color": colour, **(guides or {})}.items()}
    if colour.shape[0] * colour.shape[1] > TILED_FROM:
        device = oidn.Device()
        if all(device.can_share(image) for image in images.values()):
            tiled = device.new_filter("RT")
            made = np.empty_like(images["color"])
            for name, image in {**images, "output": made}.items():
                tiled.set_image(name, image)
            for name, value in {**options, "max_memory_mb": TILED_MB}.items():
                setattr(tiled, name, value)
            tiled.execute()
            return made
    return np.asarray(oidn.denoise(*images.values(), **options))


def beyond_noise(removed: NDArray[Any], noise: NDArray[Any]) -> NDArray[np.float32]:
    """Return the texture in `removed`: the part that noise does not explain, without local means.

    Wiener filter: each scale and opponent colour keeps the share 1 - (noise power) / (loss power), with local
    powers; small shares are reduced.

    Args:
        removed: XYZ `[row, column, 3]`, raw minus clean picture.
        noise: another noise sample for `removed`.
    """
    # normalised, because fourth powers must fit single precision, which halves the time
    size = max(float(np.mean(np.abs(removed))), float(np.mean(np.abs(noise))), 1e-30)
    mix = (OPPONENT.T / size).astype(np.float32)
    planes = [np.moveaxis(part.astype(np.float32, copy=False) @ mix, -1, 0) for part in (removed, noise)]
    with ThreadPoolExecutor(min(available_jobs(), len(OPPONENT))) as pool:
        texture = list(pool.map(lambda pair: _texture(*pair), zip(*planes, strict=True)))
    return np.asarray(np.stack(texture, axis=-1) @ (size * np.linalg.inv(OPPONENT).T).astype(np.float32))


def means(removed: NDArray[Real]) -> NDArray[Real]:
    """Return local means, the complement to the scales in `beyond_noise`."""
    return smooth(removed, ALL_SCALES)


def beyond_chance(mean: NDArray[np.float32], removed: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the Wiener share for local means if the noise is unknown.

    The loss itself is the noise estimate, reduced by the pixel count in the mean. Without it flake paints rendered
    by random walks had blotches.

    Args:
        mean: local mean of `removed`, `[row, column, 3]`.
        removed: raw minus clean picture.
    """
    chance = smooth(removed**2, KEPT_MEANS) / np.float32(4.0 * np.pi * KEPT_MEANS**2)
    power = smooth(mean**2, KEPT_MEANS)
    return np.clip(1.0 - chance / np.maximum(power, 1e-20), 0.0, 1.0)


def means_by_light(
    removed: NDArray[Real], own: NDArray[Real], blurred: Callable[[NDArray[Real]], NDArray[Real]]
) -> tuple[NDArray[Real], NDArray[Real]]:
    """Return the local loss as a linear function of log light, and the share that a pixel may receive.

    The guided filter of He et al. (2010). A plain mean crossed edges: a red car had a green seam along its roof, a dark
    card went black beside a mirrored sun.

    Args:
        removed: XYZ `[row, column, 3]`.
        own: clean light `[row, column]`.
        blurred: local mean.

    Returns:
        `[row, column, 3]`, and `[row, column, 1]`: 1, or less for pixels darker than their neighbours.
    """
    nearby = np.maximum(blurred(own), 1e-20)
    light = np.log(own + DARKEST * nearby)
    middle, mean = blurred(light), blurred(removed)
    spread = np.maximum(blurred(light**2) - middle**2, 0.0)
    slope = (blurred(light[..., None] * removed) - middle[..., None] * mean) / (spread + DENOISE_EVEN**2)[..., None]
    return mean + slope * (light - middle)[..., None], np.minimum(own / nearby, 1.0)[..., None] ** 2


def _texture(removed: NDArray[np.float32], noise: NDArray[np.float32]) -> NDArray[np.float32]:
    """`beyond_noise` for one colour `[row, column]`."""
    removed, noise = np.ascontiguousarray(removed), np.ascontiguousarray(noise)
    texture = np.zeros_like(removed)
    before = 1.0
    for scale in SCALES:
        wide, wide_noise = smooth(removed, scale), smooth(noise, scale)
        fine, fine_noise = removed - wide, noise - wide_noise
        reach = NEARBY * before
        power, noise_power = fine**2, fine_noise**2
        fourth = noise_power**2
        excess = smooth(power - noise_power, reach)
        share = np.maximum(excess / np.maximum(smooth(power, reach), 1e-20), 0.0)
        # excess over the noise in standard errors
        blot = 1.0 if scale == SCALES[0] else 2.0 * np.pi * before**2  # pixels per independent noise sample
        error = np.sqrt(2.0 * smooth(fourth, reach / np.sqrt(2.0)) * blot / (4.0 * np.pi * reach**2))
        # with long tails both halves may agree by chance
        usual_power = smooth(noise_power, 2.0 * reach)
        tails = smooth(fourth, 2.0 * reach) / np.maximum(usual_power**2, 1e-37)
        chance = CHANCE * np.clip(tails / NORMAL_TAILS, 1.0, None)
        sure = np.clip((excess / np.maximum(error, 1e-20) - chance) / chance, 0.0, 1.0)
        sure *= np.clip((TAILS[1] - tails) / (TAILS[1] - TAILS[0]), 0.0, 1.0)
        usual = np.maximum(OUTLIER * np.sqrt(usual_power), FAR_LARGER * np.abs(fine))
        most = MOST_TEXTURE * np.sqrt(np.maximum(excess - REDUCTION * error, 0.0))
        calm = np.minimum(usual / np.maximum(np.abs(fine_noise), 1e-20), 1.0) ** 2
        texture += np.clip(fine, -most, most) * calm * share * np.minimum(share / SURE, 1.0) * sure
        removed, noise, before = wide, wide_noise, scale
    return texture


def strips(rows: int, columns: int) -> list[tuple[slice, slice, slice]]:
    """Split a large picture into row strips, which bounds the denoiser's memory.

    Returns:
        Per strip the visible rows, the contributed rows, and the latter within the former.
    """
    height = max(STRIP_PIXELS // columns, 2 * MARGIN)
    if rows <= height + MARGIN:
        return [(slice(0, rows), slice(0, rows), slice(0, rows))]
    found = []
    for first in range(0, rows, height):
        last = min(first + height, rows)
        begun = max(first - MARGIN, 0)
        span = slice(begun, min(last + MARGIN, rows))
        found.append((span, slice(first, last), slice(first - begun, last - begun)))
    return found


def exposure(luminance: NDArray[np.float64]) -> float:
    """Return the denoiser's own input scale for a whole picture `[row, column]`, to be used in all strips.

    It maps the geometric mean luminance, over blocks with 16 x 16 pixels, to 0.18.
    """
    rows, columns = (side // BLOCK * BLOCK for side in luminance.shape)
    blocks = luminance[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).mean(axis=(1, 3))
    lit = blocks[blocks > 1e-8]
    return float(MIDDLE_GREY / np.exp(np.mean(np.log(lit)))) if lit.size else 1.0


# AOVs that guide the denoiser: albedo, normal and depth at each pixel's first hit.
#
# Through clear surfaces and mirrors the albedo belongs to the surface seen, times the transmittance or reflectance; for
# lamps and sky it is their light, clipped at white. The AOVs therefore contain the picture's edges.
#
# At surfaces that both reflect and transmit, both paths are followed, later only the brighter one, rather than one
# random path. All pixels may then use equal random numbers, and most AOVs lack grain, whose removal would blur edges.

MAX_SHARP = 3  # specular events per path; 5 take half as long again without benefit
MAX_SPLITS = 3  # events at which both paths are followed
# lobes whose BSDF sampling weights are about constant, and lobes whose weights draw faint lines, which disturb less
# than grain
SMOOTH_KINDS, LINED_KINDS = [("microfacet",), ("diffuse",)], [("ridge",), ("ridge-table",)]


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
        is_ours: whether nacre built the scene; BSDFs in user scenes, such as `mask`, may ignore type masks.
    """
    flags = mi.BSDFFlags
    sharp = int(flags.Delta | flags.Null)
    bsdfs = [shape.bsdf() for shape in scene.shapes() if shape.bsdf() is not None]
    # (is specular in part, has several components) for Mitsuba's BSDFs, such as rough plastic with coat and base
    others = [(bool(int(b.flags()) & sharp), b.component_count() > 1) for b in bsdfs if not hasattr(b, "plugins")]
    draws = (not is_ours and (True, True) in others) or has_random_walks(scene)
    spread = [_scattering_lobes(bsdf) for bsdf in bsdfs if hasattr(bsdf, "plugins")]
    own = any(kinds and kinds not in SMOOTH_KINDS + LINED_KINDS for kinds in spread)
    lined = any(kinds in LINED_KINDS for kinds in spread) or (False, True) in others
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
    adapted = adapt_xyz(mean[..., :3], white_xyz("E"), SRGB_WHITE_XYZ)
    albedo = np.clip(xyz_to_srgb_linear(adapted), 0.0, 1.0).astype(np.float32)
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
    deferred: Any  # ray for the second path
    deferred_weight: Any
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
        requested = active & ((bsdf.flags() & kind) != 0)
        bs, share = bsdf.sample(context, si, first, second, requested)
        return bs.wo, dr.select(requested, share, 0.0)

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
        path.deferred = dr.select(is_both, si.spawn_ray(si.to_world(on)), path.deferred)
        path.deferred_weight = dr.select(is_both, path.weight * passed, path.deferred_weight)
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
                turns = (path.active ^ True) & (dr.max(path.deferred_weight) > 0.0)
                path.ray = dr.select(turns, path.deferred, path.ray)
                path.weight = dr.select(turns, path.deferred_weight, path.weight)
                path.count = dr.select(turns, 1, path.count)
                path.deferred_weight = dr.select(turns, 0.0, path.deferred_weight)
                path.active, path.is_first = path.active | turns, path.is_first | turns
            return path, sampler

        start = _Path(
            mi.Ray3f(ray), mi.Spectrum(0.0), mi.Spectrum(1.0), mi.UInt32(0), mi.Bool(True), mi.Ray3f(ray),
            mi.Spectrum(0.0), mi.UInt32(MAX_SPLITS), mi.Bool(active),
        )  # fmt: skip
        path, _ = dr.while_loop((start, sampler), lambda path, _: path.active, body, ("path", "sampler"), label="aovs")
        return path.seen, mi.Bool(True), [normal.x, normal.y, normal.z, depth]
