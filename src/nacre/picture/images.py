"""Pictures from XYZ: exposure, white balance, tone, gamut clipping, backgrounds; picture files and their provenance.

Exposure. Lights give white paper on the floor a luminance near 0.6 (`lights`). "auto", the default,
moves luminance percentile 98.5 to 0.7, limited to -0.5 to +2.5 stops; dark materials stay darker than bright ones. A
number fixes the stops; 0 shows the scene as lit, and pictures with one number are comparable. Outputs state the stops.

White balance: the light's white becomes the picture's white (Bradford). By default there is no tone curve:
colours brighter than white become white, colours outside sRGB are clipped at constant hue and lightness, and counted.
The tone "filmic" compresses highlights like film; such colours are not measurement.

Files: PNG, JPEG and WebP with provenance; EXR with linear light and layers.
"""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nacre import light
from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, reraise_as_oserror
from nacre.core.html import png_bytes

Exposure = float | Literal["auto"]
AUTO_PERCENTILE = 98.5
AUTO_LEVEL = 0.7
AUTO_STOPS = (-0.5, 2.5)
TONES = ("srgb", "filmic")
SHOWN_AT_ONCE = 1 << 20  # pixels processed at a time


@dataclass(frozen=True, eq=False)
class RenderResult:
    """A picture and its provenance.

    Attributes:
        xyz: linear XYZ `[row, column, 3]`, white paper on the floor has Y near 0.6.
        rgb: linear sRGB `[row, column, 3]`, balanced and exposed, not clipped.
        path: the file written, if any.
        stats: seconds, spp, exposure_stops, clipped_pixels, interrupted and more provenance.
        spectral: `[row, column, band]` spectral radiance, if requested, and its `bands_nm`.
        raw: XYZ as rendered, if `xyz` is denoised.
        alpha: coverage `[row, column]` by a cut-out subject; `xyz`, `raw` and `rgb` are premultiplied by it.
        background: linear sRGB behind a cut-out subject; None: transparent.
        tone: "srgb" or "filmic".
        lights: XYZ `[row, column, 3]` per light, if requested.
        layers: AOVs by name: channel letters and values `[row, column, letter]`.
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
        """The displayed picture: 8-bit sRGB `[row, column, 3]`, or with alpha `[row, column, 4]`."""
        return show(self.rgb, self.alpha, self.background, self.tone)[0]

    def save(self, path: str | Path) -> RenderResult:
        """Write a .png, .jpg, .webp or .exr file atomically; return the result with its path.

        Raises:
            NacreError: the folder cannot be written, or the suffix is unknown.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix not in STILL_SUFFIXES:
            raise NacreError(f"{path}: pictures are written as {spoken_suffixes()}")
        if suffix == ".exr":
            write_exr(path, self)
        else:
            write_picture(path, self.srgb8, self.stats)
        return replace(self, path=path)

    def _repr_png_(self) -> bytes:
        """Show the picture in a notebook."""
        return png_bytes(self.srgb8)


def auto_stops(xyz: Array) -> float:
    """Return the automatic exposure in stops, within `AUTO_STOPS`.

    Rounded to thousandths, because thread timing must not change an animation's exposure.
    """
    bright = float(np.percentile(xyz[..., 1], AUTO_PERCENTILE))
    if bright <= 0.0:
        return 0.0
    return round(float(np.clip(np.log2(AUTO_LEVEL / bright), *AUTO_STOPS)), 3)


def _row_parts(picture: Array) -> list[slice]:
    """Split the rows of a picture into parts, because intermediates need several times its memory."""
    rows = max(SHOWN_AT_ONCE // max(picture.shape[1], 1), 1) if picture.ndim == 3 else max(len(picture), 1)
    return [slice(first, first + rows) for first in range(0, len(picture), rows)]


def develop(xyz: Array, illuminant: str, exposure: Exposure = "auto") -> tuple[Array, float]:
    """Return linear sRGB `[..., 3]`, not clipped, and the stops used."""
    stops = auto_stops(xyz) if exposure == "auto" else float(exposure)
    rgb: Array = np.empty_like(xyz, dtype=float)
    for part in _row_parts(rgb):
        balanced = light.adapt_xyz(xyz[part], light.white_xyz(illuminant), light.SRGB_WHITE_XYZ)
        rgb[part] = light.xyz_to_srgb_linear(balanced) * 2.0**stops
    return rgb, stops


def encode(rgb: Array, tone: str = "srgb") -> tuple[NDArray[np.uint8], int]:
    """Return 8-bit sRGB and the number moved into the gamut."""
    clipped = light.clip_to_srgb(toned(rgb, tone))
    return np.round(255.0 * light.srgb_encode(clipped.rgb)).astype(np.uint8), clipped.count


def toned(rgb: Array, tone: str) -> Array:
    """Apply a tone curve to linear sRGB: "srgb" is the identity, "filmic" the ACES display curve per channel.

    The latter is K. Narkowicz's fit (2015), x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14), limited to 1.

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
    """Count the pixels that `show` would clip into the gamut."""
    count = 0
    for part in _row_parts(rgb):
        colours = rgb[part] if alpha is None else _uncovered(rgb[part], np.clip(alpha[part], 0.0, 1.0)[..., None])
        count += int(np.count_nonzero(light.outside_srgb(toned(colours, tone))))
    return count


def _uncovered(rgb: Array, cover: Array) -> Array:
    """Divide premultiplied colours by their coverage."""
    return np.where(cover > 0, rgb / np.maximum(cover, 1e-6), 0.0)


def show(
    rgb: Array, alpha: Array | None, background: tuple[float, float, float] | None, tone: str
) -> tuple[NDArray[np.uint8], int]:
    """Return 8-bit sRGB `[row, column, 3 or 4]` for display, and the clipped pixel count.

    Args:
        rgb: linear sRGB, exposed, premultiplied by alpha.
        alpha: coverage `[row, column]`, or None.
        background: linear sRGB behind a cut-out subject; None: alpha as the fourth channel.
        tone: see `toned`.
    """
    parts = _row_parts(rgb)
    if len(parts) > 1:
        images = [show(rgb[part], None if alpha is None else alpha[part], background, tone) for part in parts]
        return np.concatenate([each for each, _ in images]), sum(count for _, count in images)
    if alpha is None:
        return encode(rgb, tone)
    cover = np.clip(alpha, 0.0, 1.0)[..., None]
    clipped = light.clip_to_srgb(toned(_uncovered(rgb, cover), tone))
    if background is None:
        pixels = np.concatenate([light.srgb_encode(clipped.rgb), cover], axis=-1)
    else:
        pixels = light.srgb_encode(cover * clipped.rgb + (1.0 - cover) * np.array(background))
    return np.round(255.0 * pixels).astype(np.uint8), clipped.count


PROVENANCE_KEY = "nacre"
STILL_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".exr")
OPAQUE_SUFFIXES = (".jpg", ".jpeg")
JPEG_QUALITY = 95
WEBP_QUALITY = 95
JPEG_PACKET = 65_502  # XMP bytes in one JPEG segment
LEFT_OUT = "left out: too long for a JPEG"
# an XMP packet with one property in our own namespace
_XMP = (
    '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
    'xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmlns:nacre="urn:nacre:provenance:1" '
    'xmp:CreatorTool="nacre {version}"><nacre:provenance>{text}</nacre:provenance></rdf:Description></rdf:RDF>'
    '</x:xmpmeta><?xpacket end="r"?>'
)
_XMP_TEXT = ("<nacre:provenance>", "</nacre:provenance>")
SRGB_CHROMATICITIES = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # primaries and white, as (x, y) pairs
LAYOUT_VERSION = "1.0"
EMISSIVE_UNITS = "W.m^-2.sr^-1"


def spoken_suffixes() -> str:
    """Return the picture-file suffixes for messages."""
    return f"{', '.join(STILL_SUFFIXES[:-1])} or {STILL_SUFFIXES[-1]}"


def provenance(stats: Mapping[str, Any]) -> str:
    """Return the provenance as JSON."""
    return json.dumps({"nacre": __version__, **stats}, default=str, sort_keys=True)


def write_picture(path: Path, picture: NDArray[np.uint8], stats: Mapping[str, Any]) -> None:
    """Write an 8-bit sRGB picture `[row, column, 3 or 4]` with its provenance; the suffix selects the format.

    Raises:
        NacreError: the folder cannot be written, or the format does not support transparency.
    """
    suffix = path.suffix.lower()
    if suffix == ".png":
        write_png(path, picture, stats)
        return
    from PIL import Image

    if suffix in OPAQUE_SUFFIXES and picture.shape[-1] == 4:
        raise NacreError(f"{path}: a JPEG knows no transparency; write .png, .webp or .exr")
    packet = _xmp(stats, JPEG_PACKET if suffix in OPAQUE_SUFFIXES else None)
    options: dict[str, Any] = {"format": "JPEG", "quality": JPEG_QUALITY, "subsampling": 0}
    if suffix == ".webp":
        options = {"format": "WEBP", "quality": WEBP_QUALITY, "method": 6}
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary, xmp=packet, **options)


def _xmp(stats: Mapping[str, Any], most: int | None) -> bytes:
    """Return the provenance as an XMP packet; its longest texts are dropped above `most` bytes."""
    tree = json.loads(provenance(stats))
    while True:
        text = html.escape(json.dumps(tree, sort_keys=True), quote=False)
        packet = _XMP.format(version=__version__, text=text).encode("utf-8")
        if most is None or len(packet) <= most:
            return packet
        _leave_out_the_longest(tree)


def _leave_out_the_longest(tree: Any) -> None:
    """Replace the longest text in a tree, such as a recipe, by a note."""
    longest, holder, key = -1, None, None
    nodes = [tree]
    while nodes:
        node = nodes.pop()
        for name, value in node.items() if isinstance(node, dict) else enumerate(node):
            if isinstance(value, dict | list):
                nodes.append(value)
            size = len(json.dumps(value))
            if not isinstance(value, dict) and size > longest:
                longest, holder, key = size, node, name
    if holder is not None:
        holder[key] = LEFT_OUT


def write_png(path: Path, picture: NDArray[np.uint8], stats: Mapping[str, Any]) -> None:
    """Write a PNG with its provenance as text.

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
    """Return the provenance in a PNG, JPEG or WebP from nacre; empty for other pictures."""
    from PIL import Image

    with Image.open(path) as picture:
        text = getattr(picture, "text", {}).get(PROVENANCE_KEY, "")
        packet = picture.info.get("xmp", b"")
    if not text:
        words = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet)
        text = html.unescape(words.partition(_XMP_TEXT[0])[2].partition(_XMP_TEXT[1])[0]) or "{}"
    loaded = json.loads(text)
    return loaded if isinstance(loaded, dict) else {}


def spectral_channel(wavelength_nm: float) -> str:
    """Name an emissive, unpolarised channel: S0 and the wavelength with a decimal comma.

    Example:
        >>> spectral_channel(550)
        'S0.550,000000nm'
    """
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.")


def write_exr(path: str | Path, result: RenderResult) -> None:
    """Write linear light, unexposed and unclipped, as R, G, B, with layers.

    Layers: A, if the subject is cut out (light is premultiplied by it); `raw` as rendered, if denoised; the AOVs
    `albedo`, `normal` and `depth`; `light.NAME` for each light, if requested; a channel per band for spectra.

    R, G, B are linear sRGB balanced to the light's white. Spectral channels are radiances in relative units, which
    the header states.

    Raises:
        NacreError: the folder cannot be written.
    """
    import OpenEXR

    white = light.white_xyz(str(result.stats.get("illuminant", "D65")))
    channels: dict[str, Any] = {}

    def add(layer: str, names: str, values: Array | NDArray[np.float32]) -> None:
        for index, name in enumerate(names):
            channels[f"{layer}{name}"] = np.ascontiguousarray(values[..., index], dtype=np.float32)

    # points separate layers; names have commas instead, as in spectral channels
    lights = {f"light.{name.replace('.', ',')}.": xyz for name, xyz in result.lights.items()}
    for layer, xyz in {"": result.xyz, "raw.": result.raw, **lights}.items():
        if xyz is not None:
            add(layer, "RGB", light.xyz_to_srgb_linear(light.adapt_xyz(xyz, white, light.SRGB_WHITE_XYZ)))
    if result.alpha is not None:
        add("", "A", result.alpha[..., None])
    for name, (letters, values) in result.layers.items():
        add(f"{name}.", letters, values)
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
    with atomic_path(path) as temporary, reraise_as_oserror():
        OpenEXR.File(header, channels).write(str(temporary))
