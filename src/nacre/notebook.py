"""How a material shows itself in a notebook: a small rendered sphere and its colour over the angle."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

import numpy as np

from nacre.errors import NacreError

SIDE, SPP = 160, 48
RIBBON_ANGLES_DEG = np.linspace(0.0, 85.0, 60)
_cache: dict[str, str] = {}
CACHE_SIZE = 32


def material_html(material: Any) -> str:
    """Return the HTML of a material: picture, ribbon, name; a part that cannot be made leaves a line saying why."""
    key = f"{material.context.source}\n{material.context.text}"
    if key not in _cache:
        while len(_cache) >= CACHE_SIZE:
            _cache.pop(next(iter(_cache)))
        _cache[key] = _make(material)
    return _cache[key]


def _make(material: Any) -> str:
    parts = [_attempt(_sphere, material), _attempt(_ribbon, material)]
    title = html.escape(f"{material.name} ({material.family})")
    return f'<div style="display:inline-block"><div>{"".join(parts)}</div><small>{title}</small></div>'


def _attempt(maker: Any, material: Any) -> str:
    try:
        return str(maker(material))
    except NacreError as error:
        return f"<div><small>{html.escape(str(error))}</small></div>"


def _sphere(material: Any) -> str:
    from nacre.render.picture import render

    result = render(material, size=(SIDE, SIDE), spp=SPP, progress=False)
    return _image(result.srgb8, "rendered sphere", SIDE)


def _ribbon(material: Any) -> str:
    from nacre.light import clip_to_srgb, spectrum_to_rgb_linear, srgb_encode

    spectrum = material.spectrum(np.radians(RIBBON_ANGLES_DEG))
    parts = spectrum.parts()
    total = sum((v for name, v in parts.items() if name.endswith("reflectance")), np.zeros(1))
    rgb = srgb_encode(clip_to_srgb(spectrum_to_rgb_linear(total, spectrum.wavelengths_nm)).rgb)
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
