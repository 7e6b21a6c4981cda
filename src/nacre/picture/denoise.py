"""Take the grain out of a finished picture: Intel's Open Image Denoise, by the package `mitsuba-oidn`.

It works on linear XYZ, which has no negative values (the denoiser cuts those), and is guided by what the camera sees
first: the diffuse reflectance and the normal of every pixel. It needs pixels that share no samples, so the picture has
to be made with the box filter; through a wider filter it takes grain for texture.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant

GUIDE_SPP = 16  # of the guides, which only need the first hit
GLINT_KINDS = ("flaked",)  # lobes whose sparkle is their look: a denoiser takes it for noise
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
    return lobe.kind in GLINT_KINDS or (hasattr(lobe, "inner") and _has_glints(lobe.inner))


def guides(scene: Any, sensor: Any, seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return diffuse reflectance and normal `[row, column, 3]` of what each pixel sees first."""
    mi = use_variant()
    integrator = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    seen = np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=GUIDE_SPP, seed=seed))
    seen = np.nan_to_num(seen[..., -6:].astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(seen[..., :3], 0.0, 1.0), np.clip(seen[..., 3:], -1.0, 1.0)


def denoised(xyz: NDArray[np.float64], albedo: NDArray[np.float32], normal: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return a linear XYZ picture `[row, column, 3]` without its grain."""
    import mitsuba_oidn as oidn

    # four wavelengths a path make the guide's colours noisy too: clean it first
    albedo = np.clip(oidn.denoise(np.ascontiguousarray(albedo), filter="RT"), 0.0, 1.0)
    picture = np.ascontiguousarray(xyz, dtype=np.float32)
    clean = oidn.denoise(picture, np.ascontiguousarray(albedo), np.ascontiguousarray(normal), hdr=True)
    return np.maximum(np.asarray(clean, dtype=np.float64), 0.0)
