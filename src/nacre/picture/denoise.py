"""Take the grain out of a finished picture: Intel's Open Image Denoise, by the package `mitsuba-oidn`.

It works on linear Rec. 2020, near the colours that it was trained on and wide enough that little is negative (the
denoiser cuts that), and is guided by what the camera sees first (`nacre.picture.denoiser_aovs`): the diffuse
reflectance and
the normal of every pixel. What it takes from the mean colour of a neighbourhood, since it judges grain on a compressive
scale, is given back, and so is the texture that it took for grain: what lies between the raw picture and the clean one
is split into scales, of each of which the share is given back that noise cannot have made. How much noise there is tell
two halves of the samples; highlights that both hold come back. It needs pixels that share no samples, so the picture
has to be made with the box filter; through a wider filter it takes grain for texture.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.parallel import available_jobs, single_threaded_blas
from nacre.picture.filters import Real, smooth

# of the guides, which only need the first hit: of those with grain and of what an EXR holds of them, and of guides
# without grain, where fewer tell the edges: twice as many make the FLIP of a bubble .0279 -> .0277, and take as long as
# a sample and a half of the picture
GUIDE_SPP, EVEN_GUIDE_SPP = 16, 8
# XYZ -> linear Rec. 2020 (ITU-R BT.2020, white D65)
TO_RGB = np.array(
    [[1.7166512, -0.3556708, -0.2533663], [-0.6666844, 1.6164812, 0.0157685], [0.0176399, -0.0427706, 0.9421031]]
)
# Standard deviations, in pixels, that part the scales. Beyond the last all that was lost is given back: mean colours in
# XYZ alone were off by dE00 0.2 to 0.4 at 64 samples a pixel
SCALES = (1.0, 2.0, 5.0)
ALL_SCALES = math.sqrt(sum(scale**2 for scale in SCALES))  # one Gaussian in place of all, one after another
NEARBY = 2.5  # times the scale: over which noise and loss are averaged before they are compared
# the only scale where the noise is not known: what grain comes back is a twentieth of the raw picture's
KEPT_MEANS = 6.0
# luminance, and two differences from it, in which noise of few wavelengths a path and texture part better than in XYZ
OPPONENT = np.array([[0.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, -1.0, 1.0]])
# Of a pixel's own light: a firefly is not to come back as a spot. Few wavelengths a path make skewed noise, many pixels
# too dark and few far too bright: with a bound of 1 a blue pearl lost 12 % of its blue and was dE00 3.4 off, at 8 it
# loses 0.3 %, and what comes back of a firefly is 3.5 % of a pixel's light.
LARGEST_RETURN = 8.0
DARKEST = 1e-3  # of the neighbourhood's light: below it all counts as black
EVEN = 1.0  # spread of the logarithm of light in a neighbourhood up to which it passes for even
LARGEST_TEXTURE = 1.0  # likewise, of the light of the cleaned pixel: a firefly can be met by both halves
# A highlight is what both halves hold beyond so many times the fourth root of the noise's fourth moment about it: where
# fireflies are many, two halves meet some in the same place
BEYOND_CHANCE, ABOUT = 6.0, 5.0
SURE = 0.5  # shares below this may be chance and count for less: grain would come back where there is no texture
CHANCE = 0.25  # standard errors up to which an excess over the noise is chance; from twice as many it counts in full
# fourth moment over the second squared: of normal noise, whose chance counts as above, that of longer tails for more,
# by their ratio (light that a bubble throws on its floor came back as specks); from where to where texture fades out
NORMAL_TAILS, TAILS = 3.0, (20.0, 40.0)
# times the noise nearby: where the halves lie further apart one path made the pixel, unless that is still little of it
OUTLIER, FAR_LARGER = 2.0, 0.25
BAND_PIXELS = 1 << 21  # of a large picture at a time: half a gigabyte
TILED_FROM, TILED_MB = 3 << 19, 512  # pixels of a picture that bounds the denoiser's memory, and the bound
MARGIN = 128  # rows beyond a band that the denoiser sees, as far as it looks
BLOCK, MIDDLE_GREY = 16, 0.18
OFF = "NACRE_DENOISE"  # "0": never, whatever is asked; for tests and measurements


def why_not(bsdf: Any) -> str:
    """Return the reason why pictures of a BSDF stay raw, in a few words; "" if they can be denoised."""
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
    # flakes that are resolved one by one; the inner lobe of a masked one counts too
    return getattr(lobe, "glint_numbers", None) is not None or (hasattr(lobe, "inner") and _has_glints(lobe.inner))


def clean_albedo(albedo: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the guide `[row, column, 3]` without the noise that few wavelengths a path leave in its colours."""
    clean = np.empty_like(albedo)
    for seen, kept, inner in bands(*albedo.shape[:2]):
        part = _filtered(albedo[seen])
        clean[kept] = np.clip(part[inner], 0.0, 1.0)
    return clean


def denoised(
    xyz: NDArray[np.float64],
    albedo: NDArray[np.float32],
    normal: NDArray[np.float32],
    doubt: NDArray[np.float32] | None = None,
) -> NDArray[np.float64]:
    """Return a linear XYZ picture `[row, column, 3]` without its grain.

    Args:
        xyz: as rendered.
        albedo, normal: what each pixel sees first; the albedo should be clean already.
        doubt: `[row, column, 3]`, a draw of the noise of `xyz` (see `nacre.picture.passes.Frame`); without it mean
            colours are kept, and texture only as far as the denoiser sees it.
    """
    found = np.empty_like(xyz)
    parts = bands(*xyz.shape[:2])
    scale = None if len(parts) == 1 else exposure(xyz[..., 1])
    with single_threaded_blas():  # its products are small, and some are made in threads
        for seen, kept, inner in parts:
            found[kept] = _band(xyz[seen], albedo[seen], normal[seen], scale, None if doubt is None else doubt[seen])[
                inner
            ]
    return found


def _band(
    xyz: NDArray[np.float64],
    albedo: NDArray[np.float32],
    normal: NDArray[np.float32],
    scale: float | None,
    doubt: NDArray[np.float32] | None,
) -> NDArray[np.float64]:
    rgb = np.asarray(np.maximum(xyz @ TO_RGB.T, 0.0), dtype=np.float32)
    # guides as clean as these may be trusted: with the denoiser's own doubts the error was 1.3 times as large, at edges
    # and the smaller network takes .2 CPU s less at 256 x 256 and loses 4 to 10 % of FLIP, more than samples make good
    clean = _filtered(rgb, {"albedo": albedo, "normal": normal}, hdr=True, clean_aux=True, input_scale=scale)
    clean = np.maximum(np.asarray(clean, dtype=np.float64) @ np.linalg.inv(TO_RGB).T, 0.0)
    own = clean.max(axis=-1).astype(np.float32)
    bound = np.float32(LARGEST_RETURN) * own[..., None]
    lost = (xyz - clean).astype(np.float32)  # what is given back of it is added to the clean one: no more is needed
    if doubt is None:
        lost = np.clip(lost, -bound, bound)
        mean, share = means_by_light(lost, own, lambda values: smooth(values, KEPT_MEANS))
        return np.maximum(clean + share * mean * beyond_chance(mean, lost), 0.0)
    # apart from the rest: scale by scale, what is not given back of it in one would lie about it as a glow in another
    sharp = highlights(lost, doubt)
    lost -= sharp
    mean, share = means_by_light(np.clip(lost, -bound, bound), own, means)
    bound *= np.float32(LARGEST_TEXTURE / LARGEST_RETURN)
    texture = beyond_noise(np.clip(lost - mean, -bound, bound), np.clip(doubt, -bound, bound))
    return np.maximum(clean + share * (np.clip(texture, -bound, bound) + mean) + sharp, 0.0)


def highlights(lost: NDArray[Any], doubt: NDArray[np.float32]) -> NDArray[Any]:
    """Return the part of `lost` that both halves of the samples hold beyond all chance: mirrored lamps, no fireflies.

    Args:
        lost: XYZ `[row, column, 3]`, raw picture less clean one.
        doubt: half of what the halves differ by.
    """
    first, second = lost + doubt, lost - doubt
    held = np.where(first * second > 0.0, np.minimum(np.abs(first), np.abs(second)), 0.0)
    chance = BEYOND_CHANCE * np.sqrt(np.sqrt(smooth((doubt**2) ** 2, ABOUT)))
    return np.asarray(np.copysign(np.maximum(held - chance, 0.0), lost))


def _filtered(
    colour: NDArray[np.float32], guides: Mapping[str, NDArray[np.float32]] | None = None, **options: Any
) -> NDArray[np.float32]:
    """Return what the denoiser makes of a picture `[row, column, 3]`; of a large one in tiles of its own.

    It takes a kilobyte a pixel unless it is told a bound, and keeps it for the next picture. In tiles the answer is the
    same; so that its memory comes back, a large picture has a device of its own.
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


def beyond_noise(lost: NDArray[Any], noise: NDArray[Any]) -> NDArray[np.float32]:
    """Return the part of `lost` that noise does not explain, but for the means of neighbourhoods: texture.

    Of each scale and opponent colour the share 1 - (power of the noise) / (power of what was lost) is kept, both
    averaged nearby, which has the least expected error among shares (Wiener's filter, with the powers as found); small
    ones are lowered.

    Args:
        lost: XYZ `[row, column, 3]`, raw picture less clean one.
        noise: another draw of the noise that `lost` contains.
    """
    # in units of its size, since fourth powers of it are to keep within single precision, which takes half the time
    size = max(float(np.mean(np.abs(lost))), float(np.mean(np.abs(noise))), 1e-30)  # nothing is lost of one pixel
    mix = (OPPONENT.T / size).astype(np.float32)
    planes = [np.moveaxis(part.astype(np.float32, copy=False) @ mix, -1, 0) for part in (lost, noise)]
    with ThreadPoolExecutor(min(available_jobs(), len(OPPONENT))) as pool:
        kept = list(pool.map(lambda pair: _texture(*pair), zip(*planes, strict=True)))
    return np.asarray(np.stack(kept, axis=-1) @ (size * np.linalg.inv(OPPONENT).T).astype(np.float32))


def means(lost: NDArray[Real]) -> NDArray[Real]:
    """Return what the scales of `beyond_noise` leave of a picture: the mean of each neighbourhood."""
    return smooth(lost, ALL_SCALES)


def beyond_chance(mean: NDArray[np.float32], lost: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the share of the means of neighbourhoods that the grain in them does not explain, Wiener's again.

    Where halves of the samples do not tell the noise, what was lost is taken for it: a mean over so many pixels has
    that much less. Paint of flakes, walked, came out in blotches as large as the neighbourhoods.

    Args:
        mean: of what was lost, `[row, column, 3]`.
        lost: the same as it is.
    """
    chance = smooth(lost**2, KEPT_MEANS) / np.float32(4.0 * np.pi * KEPT_MEANS**2)
    power = smooth(mean**2, KEPT_MEANS)
    return np.clip(1.0 - chance / np.maximum(power, 1e-20), 0.0, 1.0)


def means_by_light(
    lost: NDArray[Real], own: NDArray[Real], blurred: Callable[[NDArray[Real]], NDArray[Real]]
) -> tuple[NDArray[Real], NDArray[Real]]:
    """Return what each neighbourhood lost as a line over the light of its pixels, and the share that a pixel may take.

    A mean alone took from what lies beside an edge: a red car had a green seam along its roof, a dark card went black
    beside a mirrored sun. The line is the guided filter of He et al. (2010) over the logarithm of the light.

    Args:
        lost: XYZ `[row, column, 3]`.
        own: the cleaned light `[row, column]`.
        blurred: the mean of each neighbourhood of a picture.

    Returns:
        `[row, column, 3]`, and `[row, column, 1]`: 1, or less where a pixel is darker than its neighbours.
    """
    nearby = np.maximum(blurred(own), 1e-20)
    light = np.log(own + DARKEST * nearby)
    middle, mean = blurred(light), blurred(lost)
    spread = np.maximum(blurred(light**2) - middle**2, 0.0)
    slope = (blurred(light[..., None] * lost) - middle[..., None] * mean) / (spread + EVEN**2)[..., None]
    return mean + slope * (light - middle)[..., None], np.minimum(own / nearby, 1.0)[..., None] ** 2


def _texture(lost: NDArray[np.float32], noise: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return `beyond_noise` of one colour `[row, column]`."""
    lost, noise = np.ascontiguousarray(lost), np.ascontiguousarray(noise)
    kept = np.zeros_like(lost)
    before = 1.0
    for scale in SCALES:
        wide, wide_noise = smooth(lost, scale), smooth(noise, scale)
        fine, fine_noise = lost - wide, noise - wide_noise
        reach = NEARBY * before
        power, noise_power = fine**2, fine_noise**2
        fourth = noise_power**2
        found = smooth(power - noise_power, reach)
        share = np.maximum(found / np.maximum(smooth(power, reach), 1e-20), 0.0)
        # by how many standard errors of such a mean the noise is exceeded: near a firefly it says nothing of texture
        blot = 1.0 if scale == SCALES[0] else 2.0 * np.pi * before**2  # pixels that are one draw of the noise
        error = np.sqrt(2.0 * smooth(fourth, reach / np.sqrt(2.0)) * blot / (4.0 * np.pi * reach**2))
        # where the noise has long tails two halves of the samples agree by chance on what one path of many brought
        usual_power = smooth(noise_power, 2.0 * reach)
        tails = smooth(fourth, 2.0 * reach) / np.maximum(usual_power**2, 1e-37)
        chance = CHANCE * np.clip(tails / NORMAL_TAILS, 1.0, None)
        sure = np.clip((found / np.maximum(error, 1e-20) - chance) / chance, 0.0, 1.0)
        sure *= np.clip((TAILS[1] - tails) / (TAILS[1] - TAILS[0]), 0.0, 1.0)
        usual = np.maximum(OUTLIER * np.sqrt(usual_power), FAR_LARGER * np.abs(fine))
        calm = np.minimum(usual / np.maximum(np.abs(fine_noise), 1e-20), 1.0) ** 2
        kept += fine * calm * share * np.minimum(share / SURE, 1.0) * sure
        lost, noise, before = wide, wide_noise, scale
    return kept


def bands(rows: int, columns: int) -> list[tuple[slice, slice, slice]]:
    """Split a large picture into bands of rows, which bound the denoiser's memory.

    Returns:
        For each the rows that it sees, those that it decides, and the latter among the former.
    """
    height = max(BAND_PIXELS // columns, 2 * MARGIN)
    if rows <= height + MARGIN:
        return [(slice(0, rows), slice(0, rows), slice(0, rows))]
    found = []
    for first in range(0, rows, height):
        last = min(first + height, rows)
        begun = max(first - MARGIN, 0)
        seen = slice(begun, min(last + MARGIN, rows))
        found.append((seen, slice(first, last), slice(first - begun, last - begun)))
    return found


def exposure(luminance: NDArray[np.float64]) -> float:
    """Return the scale that the denoiser would give a whole picture `[row, column]`, for all of its bands.

    It brings the geometric mean of the luminances of blocks of 16 x 16 pixels to 0.18.
    """
    rows, columns = (side // BLOCK * BLOCK for side in luminance.shape)
    blocks = luminance[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).mean(axis=(1, 3))
    lit = blocks[blocks > 1e-8]
    return float(MIDDLE_GREY / np.exp(np.mean(np.log(lit)))) if lit.size else 1.0
