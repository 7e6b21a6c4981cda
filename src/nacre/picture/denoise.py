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
LARGEST_RETURN = 1.0  # of a pixel's own light: a firefly is not to come back as a spot
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

    return np.ascontiguousarray(np.clip(oidn.denoise(np.ascontiguousarray(albedo), filter="RT"), 0.0, 1.0))


def denoised(xyz: NDArray[np.float64], albedo: NDArray[np.float32], normal: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return a linear XYZ picture `[row, column, 3]` without its grain; `albedo` should be clean already."""
    import mitsuba_oidn as oidn
    from scipy.ndimage import gaussian_filter

    rgb = np.ascontiguousarray(np.maximum(xyz @ TO_RGB.T, 0.0), dtype=np.float32)
    # guides as clean as these may be trusted: with the denoiser's own doubts the error was 1.3 times as large, at edges
    guides = (np.ascontiguousarray(albedo), np.ascontiguousarray(normal))
    clean = oidn.denoise(rgb, *guides, hdr=True, clean_aux=True)
    clean = np.maximum(np.asarray(clean, dtype=np.float64) @ np.linalg.inv(TO_RGB).T, 0.0)
    bound = LARGEST_RETURN * clean.max(axis=-1, keepdims=True)
    lost = np.clip(xyz - clean, -bound, bound)
    return np.maximum(clean + gaussian_filter(lost, (KEPT_MEANS, KEPT_MEANS, 0.0)), 0.0)
