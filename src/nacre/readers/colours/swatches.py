"""Adobe swatches: `.ase` (Swatch Exchange) and `.aco` (Photoshop)."""

from __future__ import annotations

import colorsys
import struct
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.colours.common import SRGB, colours
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

Swatch = tuple[str, str, list[float]]  # name, space ("srgb", "lab" or that of Adobe), values
ASE_MAGIC = b"ASEF"
_ASE_COLOUR, _ASE_GROUP = 0x0001, 0xC001
_ASE_COUNTS = {b"RGB ": 3, b"LAB ": 3, b"CMYK": 4, b"Gray": 1}
_ACO_RGB, _ACO_HSB, _ACO_CMYK, _ACO_LAB, _ACO_GREY = 0, 1, 2, 7, 8
_ACO_SPACES = {_ACO_CMYK: "CMYK", 3: "Pantone", 4: "Focoltone", 5: "Trumatch", 6: "Toyo", 10: "HKS"}
_UNMANAGED = ("srgb", "lab")


def sniff(head: FileHead) -> float:
    """Return 1 for the magic of .ase, or for the head of .aco with the size that its colour count states."""
    if head.data.startswith(ASE_MAGIC):
        return CERTAIN
    if len(head.data) < 14:
        return 0.0
    version, count = struct.unpack_from(">HH", head.data)
    spaces = {struct.unpack_from(">H", head.data, 4 + 10 * place)[0] for place in range(min(count, 20))
              if 6 + 10 * place <= len(head.data)}  # fmt: skip
    is_first = version == 1 and 0 < count and 4 + 10 * count <= head.size and spaces <= set(range(16))
    if is_first and 4 + 10 * count + 4 <= len(head.data):
        return CERTAIN if struct.unpack_from(">H", head.data, 4 + 10 * count)[0] == 2 else 0.0
    return CERTAIN if is_first and 4 + 10 * count == head.size else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the swatches once, those of RGB and grey as sRGB, those of Lab as L*a*b* (D50); CMYK is left out."""
    data = path.read_bytes()
    is_ase = data.startswith(ASE_MAGIC)
    swatches = _ase(data) if is_ase else _aco(data)
    left = [f"{name} ({space})" for name, space, _ in swatches if space not in _UNMANAGED]
    left_out = [f"{len(left)} swatches without a colour of a surface: {', '.join(left)[:200]}"] if left else []
    found = []
    for space in _UNMANAGED:
        entries = [(name, values) for name, own, values in swatches if own == space]
        if entries:
            names = [name for name, _ in entries]
            table = list(zip(*(values for _, values in entries), strict=True))
            data_of = (
                {"srgb": [values for _, values in entries]} if space == "srgb" else dict(zip("Lab", table, strict=True))
            )
            found.append(
                colours(
                    path, "ase", names, data_of, name=space, left_out=left_out,
                    assumed=[SRGB] if space == "srgb" else [],
                )
            )  # fmt: skip
    if not found:
        raise NacreError(f"{path}: holds no colour of a surface; {left_out[0] if left_out else 'no swatches'}")
    return found


def _ase(data: bytes) -> list[Swatch]:
    """Return the swatches of .ase: big-endian blocks of type, length, name (UTF-16), space and floats; L is 0 to 1."""
    (count,) = struct.unpack_from(">I", data, 8)
    at, found = 12, []
    for _ in range(count):
        kind, size = struct.unpack_from(">HI", data, at)
        body = data[at + 6 : at + 6 + size]
        if len(body) < size:
            raise ValueError("a block ends behind the file")
        at += 6 + size
        if kind != _ASE_COLOUR:
            continue
        (letters,) = struct.unpack_from(">H", body)
        name = body[2 : 2 + 2 * letters].decode("utf-16-be").rstrip("\0")
        space = body[2 + 2 * letters : 6 + 2 * letters]
        values = list(struct.unpack_from(f">{_ASE_COUNTS[space]}f", body, 6 + 2 * letters))
        found.append(_swatch(name, space.decode().strip(), values))
    return found


def _swatch(name: str, space: str, values: list[float]) -> Swatch:
    if space == "RGB":
        return name, "srgb", values
    if space == "Gray":
        return name, "srgb", values * 3
    if space == "LAB":
        return name, "lab", [100.0 * values[0], values[1], values[2]]
    return name, space, values


def _aco(data: bytes) -> list[Swatch]:
    """Return the swatches of .aco: of version 2 with names if there, else of version 1."""
    (count,) = struct.unpack_from(">H", data, 2)
    first = [_aco_colour(data, 4 + 10 * place, str(place + 1)) for place in range(count)]
    at = 4 + 10 * count
    if at + 4 > len(data):
        return first
    version, count = struct.unpack_from(">HH", data, at)
    if version != 2:
        raise ValueError("the second part is not version 2")
    at += 4
    found = []
    for _ in range(count):
        (letters,) = struct.unpack_from(">I", data, at + 10)
        raw = data[at + 14 : at + 14 + 2 * letters]
        if len(raw) < 2 * letters:
            raise ValueError("a name ends behind the file")
        found.append(_aco_colour(data, at, raw.decode("utf-16-be").rstrip("\0")))
        at += 14 + 2 * letters
    return found


def _aco_colour(data: bytes, at: int, name: str) -> Swatch:
    """Return a colour of five 16-bit words: space and four values."""
    space, *words = struct.unpack_from(">5H", data, at)
    unit = [word / 65535.0 for word in words]
    if space == _ACO_RGB:
        return name, "srgb", unit[:3]
    if space == _ACO_HSB:
        return name, "srgb", list(colorsys.hsv_to_rgb(*unit[:3]))
    if space == _ACO_LAB:
        signed = [word - 65536 if word > 32767 else word for word in words]
        return name, "lab", [words[0] / 100.0, signed[1] / 100.0, signed[2] / 100.0]
    if space == _ACO_GREY:
        return name, "srgb", [words[0] / 10000.0] * 3
    return name, _ACO_SPACES.get(space, f"space {space}"), unit
