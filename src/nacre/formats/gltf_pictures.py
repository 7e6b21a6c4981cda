"""Pictures that a glTF file contains or names."""

import base64
import io
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from nacre.core.arrays import Array
from nacre.core.files import plain

GREEN = 1
MAX_BYTES, MAX_PIXELS = 64 << 20, 1 << 26
DATA = "data:"


def green_channel(path: Path, document: Mapping[str, Any], texture: Mapping[str, Any]) -> Array | None:
    """Return green of a texture `[row, column]`, from 0 to 1, the first row at the top; None if it cannot be read.

    Args:
        path: the .gltf or .glb file.
        document: its JSON.
        texture: the reference of a material, with `index`.
    """
    from PIL import Image

    try:
        image = document["images"][document["textures"][texture["index"]]["source"]]
        with Image.open(io.BytesIO(_content(path, document, image))) as opened:
            if opened.width * opened.height > MAX_PIXELS:
                return None
            if opened.mode.startswith("I"):  # 16 bits, one channel
                return np.asarray(opened, dtype=float) / 65535.0
            return np.asarray(opened.convert("RGB"), dtype=float)[..., GREEN] / 255.0
    except (KeyError, IndexError, TypeError, ValueError, OSError, struct.error, Image.DecompressionBombError):
        return None


def _content(path: Path, document: Mapping[str, Any], image: Mapping[str, Any]) -> bytes:
    if "bufferView" not in image:
        return _resource(path, image["uri"])
    view = document["bufferViews"][image["bufferView"]]
    buffer = document["buffers"][view["buffer"]]
    blob = _resource(path, buffer["uri"]) if "uri" in buffer else _binary(path)
    start = view.get("byteOffset", 0)
    return blob[start : start + view["byteLength"]]


def _resource(path: Path, uri: str) -> bytes:
    """Return the bytes of a data URI or of a file beside the document."""
    if uri.startswith(DATA):
        return base64.b64decode(uri.partition(",")[2])
    name = Path(unquote(uri))
    if name.is_absolute() or ".." in name.parts:
        raise ValueError("outside the folder")
    file = plain(path.parent / name)
    if file.stat().st_size > MAX_BYTES:
        raise ValueError("too large")
    return file.read_bytes()


def _binary(path: Path) -> bytes:
    """Return the binary chunk of a .glb file."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    size, _ = struct.unpack_from("<I4s", content, 20 + length)
    return content[28 + length : 28 + length + size]
