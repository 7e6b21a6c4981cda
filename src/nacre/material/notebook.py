"""HTML of a material in a notebook: a small rendered sphere and its colour over the angle."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

import numpy as np

from nacre.core.errors import NacreError

SIDE, SPP = 160, 48
RIBBON_ANGLES_DEG = np.linspace(0.0, 85.0, 60)
# a random walk costs over a second per angle, and its colour changes slowly with the angle
WALK_STRIDE, WALK_SPP = 8, 24
_cache: dict[str, str] = {}
CACHE_SIZE = 32


def material_html(material: Any) -> str:
    """Return picture, colour ribbon and name of a material as HTML; a failed part is replaced by its error."""
    key = f"{material.context.source}\n{material.text}\n{material.fingerprint}"
    if key not in _cache:
        while len(_cache) >= CACHE_SIZE:
            _cache.pop(next(iter(_cache)))
        _cache[key] = _make(material)
    return _cache[key]


def _make(material: Any) -> str:
    try:
        bsdf = material.bsdf()
    except NacreError as error:
        return f"<div><small>{html.escape(str(error))}</small></div>"
    walks = any(lobe.is_stochastic for lobe in bsdf.lobes)
    parts = [
        _attempt(_sphere, bsdf, WALK_SPP if walks else SPP),
        _attempt(_ribbon, material, WALK_STRIDE if walks else 1),
    ]
    title = html.escape(f"{material.name} ({material.family})")
    return f'<div style="display:inline-block"><div>{"".join(parts)}</div><small>{title}</small></div>'


def _attempt(maker: Any, *arguments: Any) -> str:
    try:
        return str(maker(*arguments))
    except NacreError as error:
        return f"<div><small>{html.escape(str(error))}</small></div>"


def _sphere(bsdf: Any, spp: int) -> str:
    from nacre.picture.picture import render

    result = render(bsdf, size=(SIDE, SIDE), spp=spp, progress=False)
    return _image(result.srgb8, "rendered sphere", SIDE)


def _ribbon(material: Any, stride: int) -> str:
    from nacre.light import clip_to_srgb, spectrum_to_rgb_linear, srgb_encode

    angles = RIBBON_ANGLES_DEG[::stride]
    spectrum = material.spectrum(np.radians(angles))
    parts = spectrum.parts()
    total = sum((v for name, v in parts.items() if name.endswith("reflectance")), np.zeros(1))
    few = spectrum_to_rgb_linear(total, spectrum.wavelengths_nm)
    linear = np.stack([np.interp(RIBBON_ANGLES_DEG, angles, channel) for channel in few.T], axis=-1)
    rgb = srgb_encode(clip_to_srgb(linear).rgb)
    row = np.rint(255 * np.clip(rgb, 0, 1)).astype(np.uint8)
    return _image(np.repeat(np.repeat(row[None], 24, axis=0), 3, axis=1), "reflected colour, 0 to 85 degrees", SIDE)


def _image(pixels: np.ndarray, words: str, width: int) -> str:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.asarray(pixels)).save(buffer, format="PNG")
    data = base64.b64encode(buffer.getvalue()).decode()
    return (
        f'<img alt="{words}" title="{words}" width="{width}" src="data:image/png;base64,{data}" style="display:block">'
    )
