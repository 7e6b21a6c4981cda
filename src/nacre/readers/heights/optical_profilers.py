"""Maps of optical profilers and laser microscopes, in formats of makers and of ISO 25178."""

from __future__ import annotations

import csv
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.hdf5 import HDF5_MAGIC, dataset, opened, text_of
from nacre.readers.heights import surface
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

# Alicona Imaging .al3d files: tags in text, then the depth image in m.

AL3D_MAGIC = b"AliconaImaging\0\r\n"
TAG_BYTES, KEY_BYTES = 52, 20
SAME = 1.5e-7  # relative tolerance for the single-precision value that marks holes


def sniff_al3d(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(AL3D_MAGIC) else 0.0


def _tags(data: bytes) -> dict[str, str]:
    tags: dict[str, str] = {}
    position = len(AL3D_MAGIC)
    while len(tags) < int(tags.get("TagCount", 0)) + 2:
        tag = data[position : position + TAG_BYTES]
        if tag[-2:] != b"\r\n":
            raise ValueError("a tag is cut")
        tags[_name(tag[:KEY_BYTES])] = _name(tag[KEY_BYTES:-2])
        position += TAG_BYTES
    return tags


def read_al3d(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the depth image; its rows are padded to multiples of 8 bytes."""
    data = path.read_bytes()
    tags = _tags(data)
    surface.check_unit(path, options, "m")
    columns, rows = int(tags["Cols"]), int(tags["Rows"])
    raw = surface.array(data, "<f4", (rows, columns + columns % 2), int(tags["DepthImageOffset"]))[:, :columns]
    marker = float(tags.get("InvalidPixelValue", "nan"))
    heights = raw.astype(float)
    heights[np.abs(raw - marker) < SAME * abs(marker)] = np.nan
    pitch = float(tags["PixelSizeXMeter"]) * 1e6, float(tags["PixelSizeYMeter"]) * 1e6
    left_out = ["texture image"] if int(tags.get("TextureImageOffset", 0)) else []
    facts = {"instrument": tags.get("CreatingApplication", "")}
    return [surface.height_map(path, heights * 1e6, pitch, metadata=facts, left_out=left_out)]


# Digital Surf .sur files of MountainsMap; compressed ones hold streams of deflate below a table of their sizes.

MAGICS = (b"DIGITAL SURF", b"DSCOMPRESSED")
SUR_HEAD = struct.Struct("<12s4H30s30s5H8xH4iI3f" + "16s" * 9 + "3f3H")
HEAD_BYTES, COMMENT, OFFSET = 512, 334, 474  # head size; places of the comment's length and the height offset


def sniff_sur(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(MAGICS) else 0.0


def read_sur(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; z = raw step + offset, with holes at the lowest raw value less 2."""
    data = path.read_bytes()
    v = SUR_HEAD.unpack_from(data)
    instrument = v[6].decode("latin-1").strip(" \0")
    special, bits, low = v[10], v[12], v[13]
    columns, rows = v[15], v[16]
    step_x, step_y, step_z = v[18:21]
    units = [text.decode("latin-1").strip(" \0") for text in v[24:27]]
    inversion = v[34]
    if bits not in (16, 32):
        raise ValueError(f"points of {bits} bits")
    comment, private = struct.unpack_from("<2H", data, COMMENT)
    (offset,) = struct.unpack_from("<f", data, OFFSET)
    start = HEAD_BYTES + comment + private
    surface.check_shape((rows, columns))
    if data.startswith(MAGICS[1]):
        data, start = _inflated(data, start, rows * columns * bits // 8), 0
    raw = surface.array(data, "<i2" if bits == 16 else "<i4", (rows, columns), start)
    heights = raw.astype(float)
    if special == 1:
        heights[raw == low - 2] = np.nan
    factors = [surface.length_um(unit) for unit in units]
    if None in factors:
        raise NacreError(f"{path}: its axes are in {', '.join(units)}; heights and positions are lengths")
    surface.check_unit(path, options, units[2])
    x, y, z = (float(f or 0.0) for f in factors)
    heights *= step_z * z * (-1.0 if inversion in (1, 2, 3) else 1.0)
    heights = heights[:, ::-1] if inversion == 2 else heights[::-1] if inversion == 3 else heights
    facts = {"instrument": instrument, "height_offset_um": offset * z}
    return [surface.height_map(path, heights, (step_x * x, step_y * y), metadata=facts)]


def _inflated(data: bytes, start: int, expected: int) -> bytes:
    """Return a compressed file's heights: a count, pairs of raw and stored sizes, then the streams.

    Raises:
        ValueError: the sizes do not give the heights of the head.
    """
    (count,) = struct.unpack_from("<I", data, start)
    sizes = struct.unpack_from(f"<{2 * min(count, 65536)}I", data, start + 4)
    if sum(sizes[::2]) != expected:
        raise ValueError(f"its streams hold {sum(sizes[::2])} bytes, and its heights need {expected}")
    at, parts = start + 4 + 8 * count, []
    for raw, stored in zip(sizes[::2], sizes[1::2], strict=True):
        parts.append(zlib.decompressobj().decompress(data[at : at + stored], raw))
        at += stored
    return b"".join(parts)


# Keyence laser microscopes: .vk3, .vk4, .vk6 and .vk7 files, and the CSV export of VK Analyzer.
#
# Lengths of the binary files are in pm per digit and per point. A .vk6 or .vk7 file is a picture and a zip archive with
# the stream of a .vk4 file. Source: the description of the format in OSTI report 1419732.

PLAIN, ZIPPED = (b"VK3_", b"VK4_"), (b"VK6", b"VK7")
MEMBER = "Vk4File"
MAX_BYTES = 2 << 30
OFFSETS = 12  # entries in the table of offsets: settings, then pictures; the 7th to 9th are height maps
LATERAL = 42 * 4  # offset from the settings to pm per point along x and y, and per digit
PALETTE = 28 + 768  # head and palette of a map
CALIBRATION = re.compile(r"xy\s*calibration", re.IGNORECASE)
DATE = re.compile(r'\s*"?Measure(?:ment|d)?\s+(?:date|data)', re.IGNORECASE)


def sniff_keyence(head: FileHead) -> float:
    """Return 1 for the magics, or a CSV head with a date and a calibration."""
    if head.data.startswith(PLAIN + ZIPPED):
        return CERTAIN
    text = head.text[:3000].lstrip("\ufeff")
    return CERTAIN if DATE.match(text) and CALIBRATION.search(text) else 0.0


def read_keyence(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a binary file's maps, or a CSV file's one."""
    data = path.read_bytes()
    if data.startswith(ZIPPED):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            data = _member(archive, MEMBER, MAX_BYTES)
    if not data.startswith(PLAIN):
        return [_csv(path, surface.decoded(data), options)]
    surface.check_unit(path, options, "pm")
    offsets = struct.unpack_from("<9I", data, OFFSETS)
    x, y, z = struct.unpack_from("<3I", data, offsets[0] + LATERAL)
    maps = []
    for number, at in enumerate(offsets[6:9], start=1):
        if at:
            columns, rows, bits = struct.unpack_from("<3I", data, at)
            if bits not in (8, 16, 32):
                raise ValueError(f"heights of {bits} bits")
            raw = surface.array(data, f"<u{bits // 8}", (rows, columns), at + PALETTE)
            maps.append(surface.height_map(path, raw * (z * 1e-6), (x * 1e-6, y * 1e-6), f"height {number}"))
    return surface.chosen(path, maps, [], options)


def _csv(path: Path, text: str, options: ReadOptions) -> Measurement:
    """Read the matrix below its name; the head gives nm per point and the unit."""
    lines = text.lstrip("\ufeff").splitlines()
    mark = next((m for m in ("\t", ";") if m in lines[0]), ",")
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark)]
    keys = {row[0].lower(): row[1:] for row in rows[:60] if len(row) > 1 and not _is_number(row[0])}
    kind = next((value[0] for key, value in keys.items() if key.startswith("output")), "Height")
    if "height" not in kind.lower():
        raise NacreError(f"{path}: is a CSV file of Keyence with {kind[:30]}, no heights")
    calibration = next((value for key, value in keys.items() if CALIBRATION.match(key)), [])
    if not calibration:
        raise ValueError("its head lacks the values of XY Calibration")
    lateral = surface.length_um((calibration[1] if len(calibration) > 1 else "").split("/")[0])
    unit = keys.get("unit", [""])[0]
    vertical = surface.length_um(unit)
    surface.check_unit(path, options, unit)
    if lateral is None or vertical is None:
        raise ValueError("its head lacks the unit of XY Calibration or of the heights")
    cells = [[c for c in row if c] for row in rows if len(row) > 1 and _is_number(row[0])]
    heights = np.array([[float(cell.replace(",", ".")) for cell in row] for row in cells])
    stated = [keys.get(name) for name in ("vertical", "horizontal")]
    if heights.ndim != 2 or any(s and int(s[0]) != n for s, n in zip(stated, heights.shape)):
        raise ValueError(f"its rows do not hold {' x '.join(s[0] for s in stated if s)} heights")
    step = float(calibration[0].replace(",", ".")) * lateral
    return surface.height_map(path, heights * vertical, (step, step))


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?", cell))


# Bruker Vision64 .OPDx files: a tree of typed items.

OPDX_MAGIC = b"VCA DATA\x01\x00\x00\x55"
SCALARS = {1: "<?", 4: "<h", 5: "<H", 6: "<i", 7: "<I", 10: "<q", 11: "<Q", 12: "<f", 13: "<d"}
NESTED, POSITIONS, END = (0x7D, 0x46, 0x47), 0x7C, 0x7F
TIME_BYTES = 9


def sniff_opdx(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(OPDX_MAGIC[:8]) else 0.0


class _Items:
    """A reader of items; matrices are kept as (offset, rows, columns)."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, len(OPDX_MAGIC)
        self.values: dict[str, Any] = {}
        self.readers: dict[int, Callable[[], Any]] = {
            0x00: self.named_matrix, 0x12: self.string, 0x13: self.quantity, 0x0E: self.type_id,
            0x15: lambda: self.skip(TIME_BYTES), 0x18: self.unit, 0x40: self.type_id, 0x42: self.strings,
            0x45: self.matrix, POSITIONS: self.type_id,
        }  # fmt: skip

    def number(self, form: str) -> Any:
        (value,) = struct.unpack_from(form, self.data, self.at)
        self.at += struct.calcsize(form)
        return value

    def skip(self, count: int) -> None:
        if self.at + count > len(self.data):
            raise ValueError("it ends too early")
        self.at += count

    def text(self, length: int) -> str:
        start = self.at
        self.skip(length)
        return self.data[start : self.at].decode("utf-8", "replace")

    def name(self) -> str:
        return self.text(self.number("<I"))

    def length(self) -> int:
        return int(self.number({1: "<B", 2: "<H", 4: "<I"}[self.number("<B")]))

    def string(self) -> str:
        return self.text(self.length())

    def strings(self) -> list[str]:
        self.name()
        end = self.length() + self.at
        strings = []
        while self.at < end:
            strings.append(self.name())
        return strings

    def type_id(self) -> None:
        self.name()
        self.skip(self.length())

    def quantity(self) -> tuple[float, str]:
        end = self.length() + self.at
        value = float(self.number("<d"))
        self.name()
        symbol = self.name()
        self.at = end
        return value, symbol

    def unit(self) -> tuple[float, str]:
        end = self.length() + self.at
        self.name()
        symbol = self.name()
        value = float(self.number("<d"))
        self.at = end
        return value, symbol

    def named_matrix(self) -> tuple[int, int, int]:
        self.name()
        self.number("<I")
        return self.matrix()

    def matrix(self) -> tuple[int, int, int]:
        self.name()
        length = self.length()
        rows, columns = self.number("<I"), self.number("<I")
        start = self.at
        self.skip(length - 8)
        return start, rows, columns

    def item(self, prefix: str, depth: int = 0) -> bool:
        """Read one item; return whether another may follow."""
        if self.at >= len(self.data) or depth > 20:
            return False
        path = f"{prefix}/{self.name()}"
        kind = self.number("<B")
        if kind == END:
            return False
        if kind in NESTED:
            end = self.length() + self.at
            while self.at < end and self.item(path, depth + 1):
                pass
            self.at = end
        elif kind in SCALARS:
            self.values[path] = self.number(SCALARS[kind])
        elif kind in self.readers:
            self.values[path] = self.readers[kind]()
        else:
            raise ValueError(f"an item of type {kind} at byte {self.at}")
        return True


def read_opdx(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the maps; extents reach from the first point to the last."""
    data = path.read_bytes()
    items = _Items(data)
    while items.item(""):
        pass
    values, maps, others = items.values, [], []
    names = [key.split("/")[2] for key in values if key.startswith("/2D_Data/") and key.endswith("/Matrix")]
    if not names and any(key.startswith("/1D_Data/") for key in values):
        raise NacreError(f"{path}: is a line profile; nacre reads maps of heights")
    for name in names:
        prefix = f"/2D_Data/{name}"
        start, rows, columns = values[f"{prefix}/Matrix"]
        scale, unit = values[f"{prefix}/DataScale"]
        factor = surface.length_um(unit)
        if factor is None:
            others.append(f'"{name}" in {unit}')
            continue
        surface.check_unit(path, options, unit)
        pitch = []
        for axis, count in ((2, columns), (1, rows)):
            extent, symbol = values[f"{prefix}/Dimension{axis}Extent"]
            pitch.append(extent * (surface.length_um(symbol) or 0.0) / max(count - 1, 1))
        raw = surface.array(data, "<f4", (rows, columns), start)
        maps.append(surface.height_map(path, raw.astype(float) * scale * factor, (pitch[0], pitch[1]), name))
    return surface.chosen(path, maps, others, options)


# Wyko Vision files: binary .opd with a directory of blocks, and their ASCII export (.asc).
#
# Both store columns from the left, each from the bottom. Heights are raw values times Wavelength / Mult in nm, or nm if
# the second flag of an ASCII file says so; Pixel_size is in mm, and Aspect is the step along y over that along x.

WYKO_MAGIC = b"\x01\x00Directory\x00"
TEXT = re.compile(r"\s*Wyko ASCII Data File Format\s+\d+\s+(\d+)")
BLOCK = struct.Struct("<16shlH")
ARRAY, FORMS = 3, {6: "<h", 7: "<f", 8: "<d", 12: "<i"}
HEIGHTS = ("RAW_DATA", "RAW DATA", "SAMPLE_DATA", "OPD", "Raw")
NUMBERS = {2: "<i2", 4: "<f4"}
HOLES = {2: 32766.0, 4: 1e38}  # values from this one upward are holes


def sniff_wyko(head: FileHead) -> float:
    """Return 1 for a binary file's directory, or an ASCII file's first line."""
    return CERTAIN if head.data.startswith(WYKO_MAGIC) or TEXT.match(head.text[:200]) else 0.0


def read_wyko(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the height maps; other arrays, such as intensities, are left out."""
    data = path.read_bytes()
    if data.startswith(WYKO_MAGIC):
        fields, arrays = _binary(data)
        factor = fields["Wavelength"] / fields.get("Mult", 1.0)
    else:
        text = surface.decoded(data)
        surface.check_end(text, path)
        fields, arrays = _ascii(path, text)
        first_line = TEXT.match(text)
        is_nm = first_line is not None and first_line[1] != "0"
        factor = 1.0 if is_nm else fields["Wavelength"] / fields.get("Mult", 1.0)
    surface.check_unit(path, options, "nm")
    step = fields["Pixel_size"] * 1e3
    pitch = step, step * fields.get("Aspect", 1.0)
    others = [f'"{name}"' for name in arrays if name not in HEIGHTS]
    left_out = [f"array {name}: no height" for name in others]
    maps = [
        surface.height_map(path, values.T[::-1] * factor * 1e-3, pitch, name, left_out=left_out)
        for name, values in arrays.items() if name in HEIGHTS
    ]  # fmt: skip
    return surface.chosen(path, maps, others, options)


def _name(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("latin-1").strip()


def _binary(data: bytes) -> tuple[dict[str, float], dict[str, Array]]:
    """Return the blocks' numbers by name, and the arrays `[column, row from the bottom]`."""
    _, _, size, _ = BLOCK.unpack_from(data, 2)
    at = 2 + size
    fields: dict[str, float] = {}
    arrays: dict[str, Array] = {}
    for place in range(1, size // BLOCK.size):
        raw, kind, length, _ = BLOCK.unpack_from(data, 2 + place * BLOCK.size)
        name = _name(raw)
        if length < 0 or at + length > len(data):
            raise ValueError(f'block "{name}" ends after the file')
        if kind in FORMS and length == struct.calcsize(FORMS[kind]):
            (fields[name],) = struct.unpack_from(FORMS[kind], data, at)
        elif kind == ARRAY and length:
            columns, rows, width = struct.unpack_from("<3H", data, at)
            if width in NUMBERS:
                values = surface.array(data, NUMBERS[width], (columns, rows), at + 6).astype(float)
                values[values >= HOLES[width]] = np.nan
                arrays[name] = values
        at += length
    return fields, arrays


def _ascii(path: Path, text: str) -> tuple[dict[str, float], dict[str, Array]]:
    """Return the same as `_binary` from the ASCII export."""
    lines = text.splitlines()
    fields: dict[str, float] = {}
    arrays: dict[str, Array] = {}
    place = 1
    while place < len(lines):
        cells = [cell.strip() for cell in lines[place].split("\t")]
        place += 1
        if cells[0] in ("X Size", "Y Size") and len(cells) > 1:
            fields[cells[0]] = float(cells[1])
        elif len(cells) > 2 and cells[1] == str(ARRAY):
            shape = int(fields["X Size"]), int(fields["Y Size"])
            rows = lines[place : place + shape[0]]
            values = surface.numbers(re.sub(r"\bBad\b", "nan", "\n".join(rows)) + "\n", path)
            arrays[cells[0]] = surface.shaped(values, shape)
            place += shape[0]
        elif len(cells) > 3 and cells[1].isdigit() and int(cells[1]) in FORMS:
            fields[cells[0]] = float(cells[3].replace(",", "."))
    return fields, arrays


# TrueMap .tmd files, versions 1 and 2: everything in mm.

TMD_MAGIC = b"Binary TrueMap Data File v2.0"
TMD_HEAD = struct.Struct("<2I4f")


def sniff_tmd(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(TMD_MAGIC) else 0.0


def read_tmd(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map after a comment that ends in a zero byte."""
    data = path.read_bytes()
    start = data.index(b"\0", 32) + 1
    columns, rows, width, height, _, _ = TMD_HEAD.unpack_from(data, start)
    surface.check_unit(path, options, "mm")
    raw = surface.array(data, "<f4", (rows, columns), start + TMD_HEAD.size)
    return [surface.height_map(path, raw.astype(float) * 1e3, (width / columns * 1e3, height / rows * 1e3))]


# The exchange formats of ISO 25178: surface data (part 71, .sdf) and X3P (part 72).

# ISO 25178-71 surface data files (.sdf), ASCII and binary; the BCR-STM files before them have the same form.

MAGIC = tuple(side + name for side in (b"a", b"b") for name in (b"ISO-1.0", b"ISO-2.0", b"BCR-1.0"))
HEAD = "<8s10s12s12s{0}{0}ddddBBB"  # numbers of points and profiles: 16 bits, or 32 in ISO-2.0
SDF_TYPES = {0: "u1", 1: "<u2", 2: "<u4", 3: "<f4", 4: "i1", 5: "<i2", 6: "<i4", 7: "<f8"}


def sniff_sdf(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.lstrip().startswith(MAGIC) else 0.0


def read_sdf(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; scales are in m."""
    data = path.read_bytes().lstrip()
    surface.check_unit(path, options, "m")
    values, fields = _sdf_binary(data) if data[:1] == b"b" else _sdf_ascii(data, path)
    scale = [float(str(fields[name]).replace(",", ".")) for name in ("Xscale", "Yscale", "Zscale")]
    if int(fields.get("Compression", 0)) != 0:
        raise NacreError(f"{path}: is compressed; export it without compression")
    if not scale[2] > 0:
        raise NacreError(f"{path}: gives Zscale = {scale[2]:g}; it should be above 0")
    heights = values.astype(float)
    heights[np.isin(heights, _holes(np.dtype(SDF_TYPES[int(fields["DataType"])]), data[1:4] == b"BCR"))] = np.nan
    facts = {k: str(v) for k, v in fields.items() if k in ("ManufacID", "CreateDate", "ModDate")}
    return [surface.height_map(path, heights * scale[2] * 1e6, (scale[0] * 1e6, scale[1] * 1e6), metadata=facts)]


def _holes(kind: np.dtype[Any], is_bcr: bool) -> list[float]:
    """Return a hole's values: the type's least in ISO 25178-71, the largest in BCR-STM, which some mix."""
    if kind.kind == "f":
        return [float(np.finfo(kind).min), float(np.finfo(kind).max)]
    limits = np.iinfo(kind)
    least = [float(limits.min)] if kind.kind == "i" else []
    return [*least, float(limits.max)] if is_bcr or kind.kind == "u" else least


def _sdf_binary(data: bytes) -> tuple[NDArray[Any], dict[str, Any]]:
    form = struct.Struct(HEAD.format("I" if data.startswith(b"bISO-2.0") else "H"))
    _, *texts, columns, rows, x, y, z, _, compression, kind, _ = form.unpack_from(data)
    fields: dict[str, Any] = {"Xscale": x, "Yscale": y, "Zscale": z, "Compression": compression, "DataType": kind}
    fields |= zip(("ManufacID", "CreateDate", "ModDate"), (v.decode("latin-1").strip(" \0") for v in texts))
    return surface.array(data, SDF_TYPES[kind], (rows, columns), form.size), fields


def _sdf_ascii(data: bytes, path: Path) -> tuple[NDArray[Any], dict[str, Any]]:
    head, star, rest = surface.decoded(data).partition("*")
    if not star:
        raise ValueError("the end of its head is missing")
    fields: dict[str, Any] = dict(surface.key_values(head.splitlines()[1:], "=", is_last=True))
    shape = int(fields["NumProfiles"]), int(fields["NumPoints"])
    body, end, _ = rest.partition("*")
    if not end:
        surface.check_end(body, path)
    return surface.shaped(surface.numbers(body, path), shape), fields


# X3P files, ISO 25178-72 (ISO 5436-2): a zip with an XML head and a binary matrix, in m.

X3P_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
X3P_MAX_BYTES = 4 << 30


def sniff_x3p(head: FileHead) -> float:
    """Return 1 for a zip that holds main.xml."""
    if not head.data.startswith(b"PK\x03\x04"):
        return 0.0
    try:
        with zipfile.ZipFile(head.path) as archive:
            return CERTAIN if "main.xml" in archive.namelist() else 0.0
    except (zipfile.BadZipFile, OSError, ValueError):
        return 0.0


def _member(archive: zipfile.ZipFile, name: str, most_bytes: int = X3P_MAX_BYTES) -> bytes:
    if archive.getinfo(name).file_size > most_bytes:
        raise ValueError(f"{name} is larger than {most_bytes >> 30} GiB")
    return archive.read(name)


def read_x3p(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; undefined points are NaN or named in a mask of bits."""
    with zipfile.ZipFile(path) as archive:
        text = _member(archive, "main.xml")
        if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
            raise ValueError("its head defines entities")
        root = ElementTree.fromstring(text)
        for element in root.iter():  # some writers put the records into the namespace of the standard
            element.tag = element.tag.rpartition("}")[2]

        def value(place: str, default: str | None = None) -> str:
            text = root.findtext(place) or default
            if text is None:
                raise ValueError(f"its head lacks {place}")
            return text.strip()

        if value("Record1/FeatureType") != "SUR":
            raise NacreError(f"{path}: is a {value('Record1/FeatureType')}, no surface; heights are a map")
        surface.check_unit(path, options, "m")
        columns, rows = (int(value(f"Record3/MatrixDimension/Size{axis}")) for axis in "XY")
        surface.check_shape((rows, columns))
        steps = [float(value(f"Record1/Axes/C{axis}/Increment", "1" if axis == "Z" else None)) for axis in "XYZ"]
        offset = float(value("Record1/Axes/CZ/Offset", "0"))
        if root.find("Record3/DataList") is not None:
            words = "\n".join(d.text or "nan" for d in root.iterfind("Record3/DataList/Datum"))
            cells = surface.numbers(words.replace(";", " ") + "\n", path).reshape(rows, columns, -1)[..., -1]
        else:
            kind = X3P_TYPES[value("Record1/Axes/CZ/DataType")]
            cells = surface.array(
                _member(archive, _inside(value("Record3/DataLink/PointDataLink"))), kind, (rows, columns)
            )
        heights = cells.astype(float) * steps[2] + offset
        mask = value("Record3/DataLink/ValidPointsLink", "")
        if mask:
            bits = np.unpackbits(np.frombuffer(_member(archive, _inside(mask)), "u1"), bitorder="little")
            heights[bits[: rows * columns].reshape(rows, columns) == 0] = np.nan
    facts = {"date": value("Record2/Date", ""), "instrument": value("Record2/Instrument/Model", "")}
    return [surface.height_map(path, heights * 1e6, (steps[0] * 1e6, steps[1] * 1e6), metadata=facts)]


def _inside(name: str) -> str:
    return str(PurePosixPath(name.replace("\\", "/"))).lstrip("./")


# Zygo's maps: MetroPro binary (.dat) and text, Mx (.datx).

# Zygo MetroPro .dat files: a big-endian head, an intensity image, and the phase.

ZYGO_MAGICS = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
HOLE = 2147483640
PHASES = {0: 4096.0, 1: 32768.0, 2: 131072.0}  # phase units per turn
INTENSITY, PHASE, ZYGO_SCALE, ZYGO_LATERAL, RESOLUTION, SIGN = 48, 64, 164, 184, 218, 232


def sniff_zygo(head: FileHead) -> float:
    """Return 1 for the format's magics."""
    return CERTAIN if head.data.startswith(ZYGO_MAGICS) else 0.0


def read_zygo(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the lateral resolution may be missing."""
    data = path.read_bytes()
    (head_bytes,) = struct.unpack_from(">I", data, 6)
    _, _, width, height, buckets = struct.unpack_from(">hhHHH", data, INTENSITY)
    _, _, columns, rows = struct.unpack_from(">hhHH", data, PHASE)
    factor, wavelength_m, _, obliquity = struct.unpack_from(">4f", data, ZYGO_SCALE)
    (lateral_m,) = struct.unpack_from(">f", data, ZYGO_LATERAL)
    (resolution,) = struct.unpack_from(">h", data, RESOLUTION)
    (sign,) = struct.unpack_from(">h", data, SIGN)
    surface.check_unit(path, options, "m")
    raw = surface.array(data, ">i4", (rows, columns), head_bytes + 2 * width * height * buckets)
    heights = raw.astype(float)
    heights[raw >= HOLE] = np.nan
    heights *= factor * obliquity * wavelength_m / PHASES[resolution] * 1e6 * (-1.0 if sign else 1.0)
    pitch = (lateral_m * 1e6,) * 2 if lateral_m > 0 else surface.requested_pitch(path, options)
    left_out = ["intensity image"] if buckets else []
    return [surface.height_map(path, heights, (pitch[0], pitch[1]), left_out=left_out)]


# Zygo MetroPro text: XYZ data (format 1) and ASCII data (format 2), both with a head of 13 or 14 lines.
#
# Line 4 is the rectangle of the phase (x, y, width, height), line 8 the scale factor, the wavelength and the distance
# of the camera's points in m, line 11 begins with the resolution of the phase.

FIRST = re.compile(r"\s*Zygo (XYZ|ASCII) Data File\b")
PHASE_LINE, OPTICS_LINE, RESOLUTION_LINE = 3, 7, 10
ZYGO_TEXT_SCALE, WAVELENGTH, OBLIQUITY, CAMERA = 1, 2, 4, 6  # places in line 8


def sniff_zygo_text(head: FileHead) -> float:
    """Return 1 for either format's first line."""
    return CERTAIN if FIRST.match(head.text[:100].lstrip("\ufeff")) else 0.0


def read_zygo_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the point distance may be missing.

    Raises:
        AmbiguousFileError: the file states no distance of its points.
        NacreError: the head or the data end early.
    """
    lines = surface.decoded(path.read_bytes()).lstrip("\ufeff").splitlines()
    ends = [place for place, line in enumerate(lines) if line.strip() == "#"]
    is_xyz = "XYZ" in lines[0]
    if len(ends) < (2 if is_xyz else 3) or ends[0] < RESOLUTION_LINE + 1:
        raise ValueError("a line # that ends its head, intensities or heights is missing")
    left, top, columns, rows = (int(float(word)) for word in lines[PHASE_LINE].split()[:4])
    surface.check_shape((rows, columns))
    optics = [float(word) for word in lines[OPTICS_LINE].split()[: CAMERA + 1]]
    assumed, left_out = [], []
    if is_xyz:
        heights = _points(lines[ends[0] + 1 : ends[1]], (rows, columns), (left, top))
        if options.unit is None:
            assumed = ["heights are in um, the unit of Zygo's XYZ format 1"]
        else:
            heights *= surface.requested_unit(path, options)
    else:
        surface.check_unit(path, options, "m")
        turn = PHASES[int(lines[RESOLUTION_LINE].split()[0])]
        scale = optics[ZYGO_TEXT_SCALE] * optics[OBLIQUITY] * optics[WAVELENGTH] / turn * 1e6
        heights = _phase(path, lines[ends[1] + 1 : ends[2]], (rows, columns)) * scale
        left_out = ["intensity image"] if ends[1] > ends[0] + 1 else []
    step = optics[CAMERA] * 1e6
    pitch = (step, step) if step > 0 else surface.requested_pitch(path, options)
    return [surface.height_map(path, heights, pitch, assumed=assumed, left_out=left_out)]


def _points(lines: list[str], shape: tuple[int, int], origin: tuple[int, int]) -> Array:
    """Return the values of lines `column row value`; words such as "No Data" are holes."""
    heights = np.full(shape, np.nan)
    points = list(filter(str.strip, lines))
    for line in points:
        words = re.split(r"[\s,;]+", line.strip(), maxsplit=2)
        column, row = int(words[0]) - origin[0], int(words[1]) - origin[1]
        if not (0 <= column < shape[1] and 0 <= row < shape[0]):
            raise ValueError(f"a point at {words[0]}, {words[1]} lies outside of the map")
        if not words[2].lower().startswith("no"):
            heights[row, column] = float(words[2])
    if len(points) > heights.size:
        raise ValueError(f"{len(points)} points for {shape[0]} x {shape[1]} places")
    return heights


def _phase(path: Path, lines: list[str], shape: tuple[int, int]) -> Array:
    values = np.array(" ".join(lines).split(), dtype=float)
    if values.size != shape[0] * shape[1]:
        raise NacreError(f"{path}: holds {values.size} phases, and its head states {shape[0]} x {shape[1]}")
    values[values >= HOLE] = np.nan
    return values.reshape(shape)


# Zygo Mx .datx files: HDF5 with a surface in nm or fringes, and converters from points to lengths.

GROUPS = ("Data/Surface", "Measurement/Surface")


def sniff_datx(head: FileHead) -> float:
    """Return 1 for HDF5 with a surface that has converters of its axes."""
    is_hdf5 = head.data.startswith(HDF5_MAGIC)
    return CERTAIN if is_hdf5 and b"Surface" in head.data and b"X Converter" in head.data else 0.0


def read_datx(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the surfaces; fringes are multiplied by wavelength, scale factor and obliquity."""
    maps = []
    with opened(path) as file:
        for group in GROUPS:
            for name in sorted(file[group]) if group in file else ():
                stored = dataset(file, f"{group}/{name}")
                if stored is not None and stored.ndim == 2:
                    maps.append(_map(path, stored, name, options))
    return surface.chosen(path, maps, [], options)


def _map(path: Path, stored: Any, name: str, options: ReadOptions) -> Measurement:
    heights = np.asarray(stored[()], dtype=float)

    def scalar(name: str) -> Any:
        return np.ravel(stored.attrs[name])[0]

    if "No Data" in stored.attrs:
        heights[heights == float(scalar("No Data"))] = np.nan
    unit = text_of(scalar("Unit"))
    factors = {"waves": ["Wavelength"], "fringes": ["Wavelength", "Interferometric Scale Factor", "Obliquity Factor"]}
    names = factors.get(unit.lower(), [])
    surface.check_unit(path, options, "m" if names else unit)
    factor = 1e6 * float(np.prod([scalar(name) for name in names])) if names else surface.length_um(unit)
    if factor is None:
        raise NacreError(f"{path}: its surface is in {unit[:20]}; heights are lengths")
    steps = [float(np.ravel(scalar(f"{axis} Converter")[-1])[1]) * 1e6 for axis in "XY"]
    pitch = (steps[0], steps[1]) if min(steps) > 0 else surface.requested_pitch(path, options)
    return surface.height_map(path, heights * factor, pitch, "" if name.startswith("{") else name)
