"""From XYZ to pictures: exposure, white balance, tone, hue-constant clipping, cut-out subjects on a background.

Exposure policy. Lights are scaled so that white paper on the floor has a luminance of about 0.6 (`lights`).
"auto", the default, moves the picture so that luminance percentile 98.5 lies at 0.7, but by no more than
-0.5 to +2.5 stops, so that a dark material stays darker than a bright one. A number fixes it, in stops; 0 shows
the scene as lit, and any two pictures at one number compare. Outputs state the stops used.

White balance: the light's own white becomes the picture's white (Bradford). By default no tone curve bends the
colours: what is brighter than white is white, what lies outside sRGB keeps hue and lightness and is counted. The tone
"filmic" lets highlights roll off instead, as film does: a look, and no measure of colour any more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.light import (
    SRGB_WHITE_XYZ,
    adapt_xyz,
    clip_to_srgb,
    outside_srgb,
    srgb_encode,
    white_xyz,
    xyz_to_srgb_linear,
)
from nacre.picture.image_files import STILL_SUFFIXES, write_exr, write_picture

Exposure = float | Literal["auto"]
AUTO_PERCENTILE = 98.5
AUTO_LEVEL = 0.7
AUTO_STOPS = (-0.5, 2.5)
TONES = ("srgb", "filmic")
SHOWN_AT_ONCE = 1 << 20  # pixels that are shown at a time


@dataclass(frozen=True, eq=False)
class RenderResult:
    """A picture and how it was made.

    Attributes:
        xyz: linear XYZ `[row, column, 3]` under the scene's light, white paper on the floor at Y of about 0.6.
        rgb: linear sRGB `[row, column, 3]`, balanced and exposed, not clipped.
        path: the file written, if any.
        stats: seconds, spp, exposure_stops, clipped_pixels, interrupted and the rest of the provenance.
        spectral: `[row, column, band]` spectral radiance, where it was asked for, and its `bands_nm`.
        raw: XYZ as rendered, where `xyz` is denoised.
        alpha: share of each pixel that the subject covers `[row, column]`, where it is cut out; `xyz`, `raw` and `rgb`
            are premultiplied by it.
        background: linear sRGB of what a cut-out subject is put on; None: nothing.
        tone: "srgb" or "filmic", of the picture as shown.
        lights: XYZ `[row, column, 3]` of each light alone, where it was asked for.
        layers: what each pixel sees first, by name: channel letters and values `[row, column, letter]`.
    """

    xyz: Array
    rgb: Array
    path: Path | None = None
    stats: Mapping[str, Any] = field(default_factory=dict)
    spectral: NDArray[np.float32] | None = None
    bands_nm: Array | None = None
    raw: Array | None = None
    alpha: Array | None = None
    background: tuple[float, float, float] | None = None
    tone: str = "srgb"
    lights: Mapping[str, Array] = field(default_factory=dict)
    layers: Mapping[str, tuple[str, NDArray[np.float32]]] = field(default_factory=dict)

    @property
    def srgb8(self) -> NDArray[np.uint8]:
        """The picture as it is shown: 8-bit sRGB `[row, column, 3]`, with alpha as a fourth where it is clear."""
        return show(self.rgb, self.alpha, self.background, self.tone)[0]

    def save(self, path: str | Path) -> RenderResult:
        """Write a .png, .jpg, .webp or .exr file, whole or not at all, and return the result with its path.

        Raises:
            NacreError: the folder cannot be written, or the suffix is neither.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix not in STILL_SUFFIXES:
            raise NacreError(f"{path}: pictures are written as {', '.join(STILL_SUFFIXES[:-1])} or .exr")
        if suffix == ".exr":
            write_exr(path, self)
        else:
            write_picture(path, self.srgb8, self.stats)
        return replace(self, path=path)

    def _repr_png_(self) -> bytes:
        """Show the picture in a notebook."""
        import io

        from PIL import Image

        buffer = io.BytesIO()
        Image.fromarray(self.srgb8).save(buffer, format="PNG")
        return buffer.getvalue()


def auto_stops(xyz: Array) -> float:
    """Return the exposure that brings the bright end of a picture just below white, within `AUTO_STOPS`.

    In thousandths: threads sum a picture in any order, and frames must know the exposure of one rendered again.
    """
    bright = float(np.percentile(xyz[..., 1], AUTO_PERCENTILE))
    if bright <= 0.0:
        return 0.0
    return round(float(np.clip(np.log2(AUTO_LEVEL / bright), *AUTO_STOPS)), 3)


def develop(xyz: Array, illuminant: str, exposure: Exposure = "auto") -> tuple[Array, float]:
    """Return linear sRGB `[..., 3]`, not clipped, and the stops used."""
    stops = auto_stops(xyz) if exposure == "auto" else float(exposure)
    rgb: Array = np.empty_like(xyz, dtype=float)
    rows = max(SHOWN_AT_ONCE // max(rgb.shape[1], 1), 1) if rgb.ndim == 3 else max(len(rgb), 1)
    for first in range(0, len(rgb), rows):  # as in `show`
        part = slice(first, first + rows)
        balanced = adapt_xyz(xyz[part], white_xyz(illuminant), SRGB_WHITE_XYZ)
        rgb[part] = xyz_to_srgb_linear(balanced) * 2.0**stops
    return rgb, stops


def encode(rgb: Array, tone: str = "srgb") -> tuple[NDArray[np.uint8], int]:
    """Return 8-bit sRGB and the number of pixels outside the gamut that had to move."""
    clipped = clip_to_srgb(toned(rgb, tone))
    return np.round(255.0 * srgb_encode(clipped.rgb)).astype(np.uint8), clipped.count


def toned(rgb: Array, tone: str) -> Array:
    """Bend linear sRGB by a tone: "srgb" not at all, "filmic" by the fit of ACES' display curve, channel by channel.

    The fit is K. Narkowicz's (2015), x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14), with its range bound to 1.

    Raises:
        NacreError: an unknown tone.
    """
    if tone not in TONES:
        raise NacreError(f'tone "{tone}" is not known; choose from {", ".join(TONES)}')
    if tone == "srgb":
        return rgb
    x = np.maximum(rgb, 0.0)
    return np.asarray(np.minimum(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 1.0))


def count_clipped(rgb: Array, alpha: Array | None, tone: str) -> int:
    """Return how many pixels `show` would clip into the gamut, without showing them."""
    rows = max(SHOWN_AT_ONCE // max(rgb.shape[1], 1), 1)
    count = 0
    for first in range(0, len(rgb), rows):
        part = rgb[first : first + rows]
        if alpha is not None:
            part = _uncovered(part, np.clip(alpha[first : first + rows], 0.0, 1.0)[..., None])
        count += int(np.count_nonzero(outside_srgb(toned(part, tone))))
    return count


def _uncovered(rgb: Array, cover: Array) -> Array:
    """Return colours as they are where they cover all, of colours premultiplied by what they cover."""
    return np.where(cover > 0, rgb / np.maximum(cover, 1e-6), 0.0)


def show(
    rgb: Array, alpha: Array | None, background: tuple[float, float, float] | None, tone: str
) -> tuple[NDArray[np.uint8], int]:
    """Return 8-bit sRGB as shown, `[row, column, 3 or 4]`, and the number of pixels clipped into the gamut.

    Args:
        rgb: linear sRGB, exposed; premultiplied where there is an alpha.
        alpha: share of the pixel that is covered, `[row, column]`, or None.
        background: linear sRGB behind a cut-out subject; None: clear, with alpha as the fourth channel.
        tone: see `toned`.
    """
    rows = max(SHOWN_AT_ONCE // max(rgb.shape[1], 1), 1)
    if rgb.ndim == 3 and len(rgb) > rows:  # a large picture: what it takes on the way is several times its size
        parts = [
            show(rgb[first : first + rows], None if alpha is None else alpha[first : first + rows], background, tone)
            for first in range(0, len(rgb), rows)
        ]
        return np.concatenate([shown for shown, _ in parts]), sum(count for _, count in parts)
    if alpha is None:
        return encode(rgb, tone)
    cover = np.clip(alpha, 0.0, 1.0)[..., None]
    clipped = clip_to_srgb(toned(_uncovered(rgb, cover), tone))
    if background is None:
        shown = np.concatenate([srgb_encode(clipped.rgb), cover], axis=-1)
    else:
        shown = srgb_encode(cover * clipped.rgb + (1.0 - cover) * np.array(background))
    return np.round(255.0 * shown).astype(np.uint8), clipped.count
