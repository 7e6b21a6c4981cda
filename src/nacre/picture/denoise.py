"""Take the grain out of a finished picture: Intel's Open Image Denoise, by the package `mitsuba-oidn`.

It works on linear Rec. 2020, near the colours that it was trained on and wide enough that little is negative (the
denoiser cuts that), and is guided by what the camera sees first (`nacre.picture.guides`): the diffuse reflectance and
the normal of every pixel. What it takes from the mean colour of a neighbourhood, since it judges grain on a compressive
scale, is given back. It needs pixels that share no samples, so the picture has to be made with the box filter; through
a wider filter it takes grain for texture.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

GUIDE_SPP = 16  # of the guides, which only need the first hit
# XYZ -> linear Rec. 2020 (ITU-R BT.2020, white D65)
TO_RGB = np.array(
    [[1.7166512, -0.3556708, -0.2533663], [-0.6666844, 1.6164812, 0.0157685], [0.0176399, -0.0427706, 0.9421031]]
)
# Standard deviation, in pixels, over which mean colours are kept: in XYZ alone they were off by dE00 0.2 to 0.4 at 64
# samples a pixel, by 0.1 with it; what grain it brings back is a twentieth of the raw picture's, and smooth
KEPT_MEANS = 6.0
# Of a pixel's own light: a firefly is not to come back as a spot. Few wavelengths a path make skewed noise, many pixels
# too dark and few far too bright: with a bound of 1 a blue pearl lost 12 % of its blue and was dE00 3.4 off, at 8 it
# loses 0.3 %, and what comes back of a firefly is 3.5 % of a pixel's light.
LARGEST_RETURN = 8.0
BAND_PIXELS = 1 << 21  # of a large picture at a time: half a gigabyte
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
    import mitsuba_oidn as oidn

    clean = np.empty_like(albedo)
    for seen, kept, inner in bands(*albedo.shape[:2]):
        part = np.asarray(oidn.denoise(np.ascontiguousarray(albedo[seen]), filter="RT"))
        clean[kept] = np.clip(part[inner], 0.0, 1.0)
    return clean


def denoised(xyz: NDArray[np.float64], albedo: NDArray[np.float32], normal: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return a linear XYZ picture `[row, column, 3]` without its grain; `albedo` should be clean already."""
    found = np.empty_like(xyz)
    parts = bands(*xyz.shape[:2])
    scale = None if len(parts) == 1 else exposure(xyz[..., 1])
    for seen, kept, inner in parts:
        found[kept] = _band(xyz[seen], albedo[seen], normal[seen], scale)[inner]
    return found


def _band(
    xyz: NDArray[np.float64], albedo: NDArray[np.float32], normal: NDArray[np.float32], scale: float | None
) -> NDArray[np.float64]:
    import mitsuba_oidn as oidn
    from scipy.ndimage import gaussian_filter

    rgb = np.ascontiguousarray(np.maximum(xyz @ TO_RGB.T, 0.0), dtype=np.float32)
    # guides as clean as these may be trusted: with the denoiser's own doubts the error was 1.3 times as large, at edges
    guides = (np.ascontiguousarray(albedo), np.ascontiguousarray(normal))
    clean = oidn.denoise(rgb, *guides, hdr=True, clean_aux=True, input_scale=scale)
    clean = np.maximum(np.asarray(clean, dtype=np.float64) @ np.linalg.inv(TO_RGB).T, 0.0)
    bound = LARGEST_RETURN * clean.max(axis=-1, keepdims=True)
    lost = np.clip(xyz - clean, -bound, bound)
    return np.maximum(clean + gaussian_filter(lost, (KEPT_MEANS, KEPT_MEANS, 0.0)), 0.0)


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
