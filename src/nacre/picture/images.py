"""From XYZ to pictures: exposure, white balance, hue-constant clipping, PNG with provenance.

Exposure policy. Lights are scaled so that white paper on the floor has a luminance of about 0.6 (`lights`).
"auto", the default, moves the picture so that luminance percentile 98.5 lies at 0.7, but by no more than
-0.5 to +2.5 stops, so that a dark material stays darker than a bright one. A number fixes it, in stops; 0 shows
the scene as lit, and any two pictures at one number compare. Outputs state the stops used.

White balance: the light's own white becomes the picture's white (Bradford). No tone curve bends the colours:
what is brighter than white is white, what lies outside sRGB keeps hue and lightness and is counted.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.files import atomic_path, told_as_os_error
from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, clip_to_srgb, srgb_encode, white_xyz, xyz_to_srgb_linear

Exposure = float | Literal["auto"]
AUTO_PERCENTILE = 98.5
AUTO_LEVEL = 0.7
AUTO_STOPS = (-0.5, 2.5)
PROVENANCE_KEY = "nacre"


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
    """

    xyz: Array
    rgb: Array
    path: Path | None = None
    stats: Mapping[str, Any] = field(default_factory=dict)
    spectral: NDArray[np.float32] | None = None
    bands_nm: Array | None = None
    raw: Array | None = None

    @property
    def srgb8(self) -> NDArray[np.uint8]:
        """The picture as it is shown: 8-bit sRGB `[row, column, 3]`."""
        return encode(self.rgb)[0]

    def save(self, path: str | Path) -> RenderResult:
        """Write a .png or .exr file, whole or not at all, and return the result with its path.

        Raises:
            NacreError: the folder cannot be written, or the suffix is neither.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix == ".png":
            write_png(path, self.srgb8, self.stats)
        elif suffix == ".exr":
            write_exr(path, self)
        else:
            raise NacreError(f"{path}: pictures are written as .png or .exr")
        return replace(self, path=path)

    def _repr_png_(self) -> bytes:
        """Show the picture in a notebook."""
        import io

        from PIL import Image

        buffer = io.BytesIO()
        Image.fromarray(self.srgb8).save(buffer, format="PNG")
        return buffer.getvalue()


def auto_stops(xyz: Array) -> float:
    """Return the exposure that brings the bright end of a picture just below white, within `AUTO_STOPS`."""
    bright = float(np.percentile(xyz[..., 1], AUTO_PERCENTILE))
    if bright <= 0.0:
        return 0.0
    return float(np.clip(np.log2(AUTO_LEVEL / bright), *AUTO_STOPS))


def develop(xyz: Array, illuminant: str, exposure: Exposure = "auto") -> tuple[Array, float]:
    """Return linear sRGB `[..., 3]`, not clipped, and the stops used."""
    stops = auto_stops(xyz) if exposure == "auto" else float(exposure)
    balanced = adapt_xyz(xyz, white_xyz(illuminant), SRGB_WHITE_XYZ)
    return xyz_to_srgb_linear(balanced) * 2.0**stops, stops


def encode(rgb: Array) -> tuple[NDArray[np.uint8], int]:
    """Return 8-bit sRGB and the number of pixels outside the gamut that had to move."""
    clipped = clip_to_srgb(rgb)
    return np.round(255.0 * srgb_encode(clipped.rgb)).astype(np.uint8), clipped.count


def provenance(stats: Mapping[str, Any]) -> str:
    """Return what an output says about its making, as JSON."""
    return json.dumps({"nacre": __version__, **stats}, default=str, sort_keys=True)


def write_png(path: Path, picture: NDArray[np.uint8], stats: Mapping[str, Any]) -> None:
    """Write a PNG that carries its provenance as text.

    Raises:
        NacreError: the folder cannot be written.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_itxt(PROVENANCE_KEY, provenance(stats))
    info.add_text("Software", f"nacre {__version__}")
    info.add(b"sRGB", b"\x00")
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG", pnginfo=info)


def read_provenance(path: str | Path) -> dict[str, Any]:
    """Return what a PNG of nacre says about its making; empty for other pictures."""
    from PIL import Image

    with Image.open(path) as picture:
        text = getattr(picture, "text", {}).get(PROVENANCE_KEY, "{}")
    loaded = json.loads(text)
    return loaded if isinstance(loaded, dict) else {}


# primaries and white of sRGB, as (x, y) pairs
SRGB_CHROMATICITIES = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)


LAYOUT_VERSION = "1.0"


EMISSIVE_UNITS = "W.m^-2.sr^-1"


def spectral_channel(wavelength_nm: float) -> str:
    """Name of an emissive, unpolarised channel: S0 and the wavelength with a decimal comma.

    Example: `spectral_channel(550)` is "S0.550,000000nm".
    """
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.")


def write_exr(path: str | Path, result: RenderResult) -> None:
    """Write a picture's linear light, unexposed and unclipped: R, G, B, the same of the layer `raw` if it is
    denoised, and a channel for each band if it has spectra.

    R, G, B are linear sRGB balanced to the light's white, so that white paper is grey in any viewer; spectral
    channels hold the radiance as it is, relative units of which the header says so.

    Raises:
        NacreError: the folder cannot be written.
    """
    import OpenEXR

    white = white_xyz(str(result.stats.get("illuminant", "D65")))
    channels: dict[str, Any] = {}
    for layer, xyz in (("", result.xyz), ("raw.", result.raw)):
        if xyz is not None:
            rgb = xyz_to_srgb_linear(adapt_xyz(xyz, white, SRGB_WHITE_XYZ)).astype(np.float32)
            channels |= {f"{layer}{name}": np.ascontiguousarray(rgb[..., i]) for i, name in enumerate("RGB")}
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": SRGB_CHROMATICITIES,
        "nacre": provenance(result.stats),
    }
    if result.spectral is not None and result.bands_nm is not None:
        header |= {"spectralLayoutVersion": LAYOUT_VERSION, "emissiveUnits": EMISSIVE_UNITS}
        for index, wavelength in enumerate(result.bands_nm):
            channels[spectral_channel(float(wavelength))] = np.ascontiguousarray(
                result.spectral[..., index], dtype=np.float32
            )
    with atomic_path(path) as temporary, told_as_os_error():
        OpenEXR.File(header, channels).write(str(temporary))
