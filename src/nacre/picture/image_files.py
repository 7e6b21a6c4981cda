"""Pictures as files: PNG, JPEG and WebP with their provenance, EXR with linear light and layers."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.files import atomic_path, told_as_os_error
from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, white_xyz, xyz_to_srgb_linear

PROVENANCE_KEY = "nacre"
STILL_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".exr")
OPAQUE_SUFFIXES = (".jpg", ".jpeg")
JPEG_QUALITY = 95
WEBP_QUALITY = 95
JPEG_PACKET = 65_502  # bytes of XMP that one segment of a JPEG holds
LEFT_OUT = "left out: too long for a JPEG"
# an XMP packet with one property of our own namespace
_XMP = (
    '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
    'xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmlns:nacre="urn:nacre:provenance:1" '
    'xmp:CreatorTool="nacre {version}"><nacre:provenance>{text}</nacre:provenance></rdf:Description></rdf:RDF>'
    '</x:xmpmeta><?xpacket end="r"?>'
)
_XMP_TEXT = ("<nacre:provenance>", "</nacre:provenance>")


class Linear(Protocol):
    """What an EXR is made from; see `nacre.picture.images.RenderResult`."""

    @property
    def xyz(self) -> Array: ...
    @property
    def raw(self) -> Array | None: ...
    @property
    def alpha(self) -> Array | None: ...
    @property
    def lights(self) -> Mapping[str, Array]: ...
    @property
    def layers(self) -> Mapping[str, tuple[str, NDArray[np.float32]]]: ...
    @property
    def spectral(self) -> NDArray[np.float32] | None: ...
    @property
    def bands_nm(self) -> Array | None: ...
    @property
    def stats(self) -> Mapping[str, Any]: ...


def provenance(stats: Mapping[str, Any]) -> str:
    """Return what an output says about its making, as JSON."""
    return json.dumps({"nacre": __version__, **stats}, default=str, sort_keys=True)


def write_picture(path: Path, picture: NDArray[np.uint8], stats: Mapping[str, Any]) -> None:
    """Write an 8-bit sRGB picture `[row, column, 3 or 4]` that carries its provenance, by its suffix.

    Raises:
        NacreError: the folder cannot be written, or the format knows no transparency.
    """
    suffix = path.suffix.lower()
    if suffix == ".png":
        write_png(path, picture, stats)
        return
    from PIL import Image

    if suffix in OPAQUE_SUFFIXES and picture.shape[-1] == 4:
        raise NacreError(f"{path}: a JPEG knows no transparency; write .png, .webp or .exr")
    packet = _xmp(stats, JPEG_PACKET if suffix in OPAQUE_SUFFIXES else None)
    with atomic_path(path) as temporary:
        if suffix == ".webp":
            Image.fromarray(picture).save(temporary, format="WEBP", quality=WEBP_QUALITY, method=6, xmp=packet)
        else:
            Image.fromarray(picture).save(temporary, format="JPEG", quality=JPEG_QUALITY, subsampling=0, xmp=packet)


def _xmp(stats: Mapping[str, Any], most: int | None) -> bytes:
    """Return the packet of how a picture was made, without its longest texts where it would have more bytes."""
    tree = json.loads(provenance(stats))
    while True:
        text = html.escape(json.dumps(tree, sort_keys=True), quote=False)
        packet = _XMP.format(version=__version__, text=text).encode("utf-8")
        if most is None or len(packet) <= most:
            return packet
        _leave_out_the_longest(tree)


def _leave_out_the_longest(tree: Any) -> None:
    """Replace the longest text in a tree, such as a recipe, by a word that tells of it."""
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
    """Return what a PNG, JPEG or WebP of nacre says about its making; empty for other pictures."""
    from PIL import Image

    with Image.open(path) as picture:
        text = getattr(picture, "text", {}).get(PROVENANCE_KEY, "")
        packet = picture.info.get("xmp", b"")
    if not text:
        words = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else str(packet)
        text = html.unescape(words.partition(_XMP_TEXT[0])[2].partition(_XMP_TEXT[1])[0]) or "{}"
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


def write_exr(path: str | Path, result: Linear) -> None:
    """Write a picture's linear light, unexposed and unclipped, as R, G, B, and its layers.

    Layers: A, where the subject is cut out (the light is then premultiplied by it); `raw` as rendered, where the
    picture is denoised; `albedo`, `normal` and `depth` of what each pixel sees first; `light.NAME`, what one lamp
    gives, where that was asked for; a channel for each band if the picture has spectra.

    R, G, B are linear sRGB balanced to the light's white, so that white paper is grey in any viewer; spectral
    channels hold the radiance as it is, relative units of which the header says so.

    Raises:
        NacreError: the folder cannot be written.
    """
    import OpenEXR

    white = white_xyz(str(result.stats.get("illuminant", "D65")))
    channels: dict[str, Any] = {}

    def add(layer: str, names: str, values: Array | NDArray[np.float32]) -> None:
        for index, name in enumerate(names):
            channels[f"{layer}{name}"] = np.ascontiguousarray(values[..., index], dtype=np.float32)

    # a point would part a layer's name: as in spectral channels, a comma stands for it
    lights = {f"light.{name.replace('.', ',')}.": xyz for name, xyz in result.lights.items()}
    for layer, xyz in {"": result.xyz, "raw.": result.raw, **lights}.items():
        if xyz is not None:
            add(layer, "RGB", xyz_to_srgb_linear(adapt_xyz(xyz, white, SRGB_WHITE_XYZ)))
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
    with atomic_path(path) as temporary, told_as_os_error():
        OpenEXR.File(header, channels).write(str(temporary))
