"""Maps of scanning probe microscopes, in the formats of makers, of their programs and of Gwyddion."""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Mapping
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.hdf5 import HDF5_MAGIC, dataset, opened
from nacre.readers.heights import surface
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead

# Bruker, Veeco and Digital Instruments Nanoscope files (.spm, or a number as suffix): text head, integers.

NANOSCOPE_MAGICS = (b"\\*File list", b"\\*EC File list", b"?*File list")
NANOSCOPE_IMAGES = ("ciao image list", "afm image list", "stm image list", "nca image list", "image list")
FOUR_BYTES_FROM = 0x09200000  # version from which integers have four bytes whatever the head says
VALUE = re.compile(r"[VCS]\s*(?:\[(?P<soft>[^\]]*)\])?\s*(?:\([^)]*\))?\s*(?P<rest>.*)")
NUMBER = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*)")

Section = dict[str, str]


def sniff_nanoscope(head: FileHead) -> float:
    """Return 1 for the first line of the format."""
    return CERTAIN if head.data.startswith(NANOSCOPE_MAGICS) else 0.0


def _sections(data: bytes) -> list[tuple[str, Section]]:
    sections: list[tuple[str, Section]] = []
    for line in data.split(b"\x1a")[0].decode("latin-1").splitlines():
        if line.startswith(("\\*", "?*")):
            name = line[2:].strip().lower()
            if name == "file list end":
                break
            sections.append((name, {}))
        elif line.startswith("\\") and sections:
            key, _, value = line[1:].partition(": ")
            sections[-1][1][key.strip().lower()] = value.strip()
    return sections


def _scale_um(image: Section, scanner: Mapping[str, str], bits: int) -> tuple[float, str] | None:
    """Return um per integer and the unit in the file, or None if the channel does not hold lengths.

    The full range of the integers is the hard value of the Z scale, times the sensitivity that it names.
    """
    text = image.get("@2:z scale", image.get("@4:z scale"))
    if text is None:
        raise NacreError('has no "@2:Z scale": Nanoscope versions up to 4.2 are not read; save it as .gwy or .sdf')
    scale = VALUE.match(text)
    hard = NUMBER.match(scale["rest"].strip()) if scale else None
    if scale is None or hard is None:
        raise ValueError(f"Z scale is {text[:40]}")
    per_lsb, unit = float(hard[1]) / 2.0**bits, hard[2].strip()
    if scale["soft"]:
        soft = VALUE.match(scanner.get(f"@{scale['soft'].lower()}", ""))
        value = NUMBER.match(soft["rest"].strip()) if soft else None
        if value is None:
            return None
        per_lsb *= float(value[1])
        unit = value[2].split("/")[0].strip() if "/" in value[2] else ""
    factor = surface.length_um(unit) if unit else None
    return None if factor is None else (per_lsb * factor, unit)


def _size_um(image: Section, scan: Mapping[str, str]) -> tuple[float, float]:
    words = image.get("scan size", scan.get("scan size", "")).split()
    numbers = [float(w) for w in words if NUMBER.fullmatch(w)]
    factor = surface.length_um(words[-1])
    if not numbers or factor is None:
        raise ValueError(f'scan size is "{" ".join(words)}"')
    width, height = numbers[0] * factor, numbers[-1] * factor
    slow = scan.get("slow axis size", "").split()
    if len(slow) == 2 and (unit := surface.length_um(slow[1])) is not None:
        height = float(slow[0]) * unit
    return width, height


def read_nanoscope(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels that are heights; the last line measured is the first of the file.

    Raises:
        NacreError: force curves, or no channel of heights.
    """
    data = path.read_bytes()
    sections = _sections(data)
    merged: dict[str, str] = {}
    for name, fields in sections:
        if name not in NANOSCOPE_IMAGES:
            merged.update(fields)
    if merged.get("start context") == "FOL" or merged.get("operating mode") == "Force":
        raise NacreError(f"{path}: holds force curves, no height map")
    version = int(next((f["version"] for n, f in sections if n.endswith("file list") and "version" in f), "0"), 16)
    maps, others = [], []
    for name, image in sections:
        if name not in NANOSCOPE_IMAGES:
            continue
        title = re.search(r'"([^"]*)"', image.get("@2:image data", image.get("@4:image data", "")))
        channel = title[1] if title else name
        direction = image.get("line direction", "")
        columns, rows = int(image["samps/line"]), int(image["number of lines"])
        size = int(image.get("bytes/pixel", "2"))
        length = int(image["data length"])
        if int(image["data offset"]) + length > len(data):
            raise ValueError(f'channel "{channel}" ends after the file')
        stored_size = 4 if version >= FOUR_BYTES_FROM and length >= 4 * columns * rows else size
        try:
            scale = _scale_um(image, merged, 8 * size)
        except NacreError as error:
            raise NacreError(f"{path}: {error}") from None
        if scale is None:
            others.append(f'"{channel}"')
            continue
        surface.check_unit(path, options, scale[1])
        width, height = _size_um(image, merged)
        raw = surface.array(data, "<i4" if stored_size == 4 else "<i2", (rows, columns), int(image["data offset"]))
        label = channel if direction in ("", "Trace") else f"{channel} ({direction})"
        aspect = _aspect(image)
        pitch = width / columns, (height if height != width or aspect == 1.0 else height / aspect) / rows
        maps.append(surface.height_map(path, raw[::-1] * scale[0], pitch, label, {"date": merged.get("date", "")}))
    left_out = tuple(f"channel {name}: no height" for name in others)
    return [replace(one, left_out=left_out) for one in surface.chosen(path, maps, others, options)]


def _aspect(image: Section) -> float:
    """Return width over height of the scan, which one number for its size leaves open."""
    words = image.get("aspect ratio", "1:1").split(":")
    return float(words[0]) / float(words[1]) if len(words) == 2 else 1.0


# WSxM images (.top, .stp) of Nanotec: text head, then rows of numbers, and their export as an ASCII matrix.

WSXM_TYPES = {"short": "<i2", "integer": "<i4", "float": "<f4", "double": "<f8"}


def sniff_wsxm(head: FileHead) -> float:
    """Return 1 for the first line of the format, except for an export of points x, y, z."""
    is_points = b"ASCII XYZ" in head.data[:200]
    return CERTAIN if head.data.startswith(b"WSxM file copyright") and not is_points else 0.0


def read_wsxm(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the file runs from the lower right point to the upper left one.

    The range of integers is the Z amplitude; other numbers are in its unit.
    """
    data = path.read_bytes()
    if b"ASCII Matrix" in data[:200]:
        return [_matrix(path, surface.decoded(data), options)]
    head_size = re.search(rb"Image header size:\s*(\d+)", data[:400])
    if head_size is None:
        raise ValueError("it does not state the size of its head")
    size = int(head_size[1])
    fields = surface.key_values(data[:size].decode("latin-1").splitlines(), ":")
    kind = fields.get("Image Data Type", "short").lower()
    if kind not in WSXM_TYPES:
        raise ValueError(f'numbers of type "{kind}"')
    rows, columns = int(fields["Number of rows"]), int(fields["Number of columns"])
    raw = surface.array(data, WSXM_TYPES[kind], (rows, columns), size)[::-1, ::-1].astype(float)
    amplitude = fields["Z Amplitude"].split()
    unit = surface.length_um(amplitude[1]) if len(amplitude) > 1 else None
    if unit is None:
        raise NacreError(f"{path}: holds no heights: its Z amplitude is {fields['Z Amplitude']}")
    surface.check_unit(path, options, amplitude[1])
    scale = unit
    if kind in ("short", "integer"):
        span = float(np.ptp(raw))
        scale = float(amplitude[0]) * unit / span if span > 0 else 0.0
    width = surface.quantity_um(fields["X Amplitude"])
    height = surface.quantity_um(fields.get("Y Amplitude", fields["X Amplitude"]))
    name = fields.get("Acquisition channel", "")
    return [surface.height_map(path, raw * scale, (width / columns, height / rows), name)]


def _matrix(path: Path, text: str, options: ReadOptions) -> Measurement:
    """Read an ASCII matrix: lengths of its sides, then rows in the picture's order."""
    surface.check_end(text, path)
    lines = text.splitlines()[2:]
    fields = surface.key_values(lines, ":", is_last=True)
    rows = [line for line in lines if line.strip() and ":" not in line]
    heights = surface.matrix(rows, path)
    amplitude = fields.get("Z Amplitude", "").split()
    unit_in_file = amplitude[1] if len(amplitude) > 1 else ""
    surface.check_unit(path, options, unit_in_file)
    unit = surface.length_um(unit_in_file) or surface.requested_unit(path, options)
    width = surface.quantity_um(fields["X Amplitude"])
    pitch = width / heights.shape[1], surface.quantity_um(fields.get("Y Amplitude", fields["X Amplitude"])) / len(rows)
    return surface.height_map(path, heights * unit, pitch)


# JPK image scans (.jpk, .jpk-qi-image): TIFF files, one page per channel after a thumbnail.

GRID_U, GRID_V, REFLECT = 0x8042, 0x8043, 0x8045
RETRACE, CHANNEL = 0x8051, 0x8052
SLOTS, DEFAULT, JPK_FIRST, STRIDE = 0x8080, 0x8081, 0x8090, 0x30
NAME, UNIT, TYPE, FACTOR, OFFSET = 0x00, 0x12, 0x13, 0x14, 0x15


def sniff_jpk(head: FileHead) -> float:
    """Return 1 for a TIFF whose first page has the tags of a scan grid."""
    if head.data[:4] not in (b"II*\0", b"MM\0*"):
        return 0.0
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # damage ends in one line by nacre
    try:
        with tifffile.TiffFile(head.path) as file:
            tags = file.pages.first.tags
            return CERTAIN if GRID_U in tags and GRID_V in tags else 0.0
    except (tifffile.TiffFileError, OSError, ValueError, IndexError, KeyError):
        return 0.0


def _tag(page: Any, code: int, default: Any = None) -> Any:
    tag = page.tags.get(code)
    value = default if tag is None else tag.value
    return value.decode("latin-1").strip("\0 ") if isinstance(value, bytes) else value


def read_jpk(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels in units of length with a linear scale; the first line of the grid is the lowest."""
    import tifffile

    maps, others = [], []
    try:
        with tifffile.TiffFile(path) as file:
            first = file.pages.first
            size = float(_tag(first, GRID_U)) * 1e6, float(_tag(first, GRID_V)) * 1e6
            for page in file.pages[1:]:
                name = _tag(page, CHANNEL)
                if name is None:
                    continue
                name = f"{name} (retrace)" if _tag(page, RETRACE, 0) else str(name)
                default = _tag(page, DEFAULT, "")
                starts = [JPK_FIRST + k * STRIDE for k in range(int(_tag(page, SLOTS, 0)))]
                slot = next((s for s in starts if _tag(page, s + NAME) == default), None)
                unit = "" if slot is None else str(_tag(page, slot + UNIT, ""))
                factor = surface.length_um(unit)
                if slot is None or factor is None or _tag(page, slot + TYPE) != "LinearScaling":
                    others.append(f'"{name}" in {unit or "no unit"}')
                    continue
                surface.check_unit(path, options, unit)
                raw = page.asarray().astype(float)
                values = (raw * float(_tag(page, slot + FACTOR)) + float(_tag(page, slot + OFFSET, 0.0))) * factor
                values = values if _tag(page, REFLECT, _tag(first, REFLECT, 0)) else values[::-1]
                pitch = size[0] / values.shape[1], size[1] / values.shape[0]
                maps.append(surface.height_map(path, values, pitch, name, left_out=("thumbnail",)))
    except tifffile.TiffFileError as error:
        raise ValueError(str(error)) from None
    return surface.chosen(path, maps, others, options)


# Igor binary waves (.ibw) of version 5, as Asylum Research writes them: one layer per channel.

BIN_BYTES, WAVE_BYTES = 64, 320
IBW_TYPES = {2: "f4", 4: "f8", 8: "i1", 16: "i2", 32: "i4", 0x48: "u1", 0x50: "u2", 0x60: "u4"}
LENGTH_CHANNELS = ("height", "zsensor", "topography", "rawz")


def _order(data: bytes) -> str | None:
    """Return the byte order of a wave of version 5, whose 16-bit sum over both heads is zero."""
    for order in "<>":
        if len(data) >= BIN_BYTES + WAVE_BYTES and struct.unpack_from(order + "h", data)[0] == 5:
            total = np.frombuffer(data, order + "i2", (BIN_BYTES + WAVE_BYTES) // 2).astype(np.int64).sum()
            if total & 0xFFFF == 0:
                return order
    return None


def sniff_ibw(head: FileHead) -> float:
    """Return 1 for version 5 with its checksum."""
    return CERTAIN if _order(head.data) else 0.0


def read_ibw(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels of heights; the first index runs along x, the second upward along y."""
    data = path.read_bytes()
    order = _order(data)
    if order is None:
        raise ValueError("its checksum is wrong")
    _, _, _, formula, note, _, _, _, _, _, *label_sizes = struct.unpack_from(order + "hhiiii" + "4i" + "4i", data)
    start = BIN_BYTES
    (kind,) = struct.unpack_from(order + "h", data, start + 16)
    dims = struct.unpack_from(order + "4i", data, start + 68)
    steps = struct.unpack_from(order + "4d", data, start + 84)
    unit_z, unit_x = (data[at : at + 4].split(b"\0")[0].decode("latin-1") for at in (start + 148, start + 152))
    if kind not in IBW_TYPES:
        raise ValueError(f"numbers of type {kind}")
    if dims[1] == 0:
        raise NacreError(f"{path}: holds a profile of {dims[0]} points; heights are a map")
    layers = max(dims[2], 1)
    surface.check_shape((dims[1], dims[0]))
    count = dims[0] * dims[1] * layers
    values = np.frombuffer(data, order + IBW_TYPES[kind], count, start + WAVE_BYTES).reshape(layers, dims[1], dims[0])
    tail = start + WAVE_BYTES + values.nbytes + formula
    names = _labels(data[tail + note + sum(struct.unpack_from(order + "2i", data, 16)) :], label_sizes, layers)
    lateral = surface.length_um(unit_x)
    pitch = (abs(steps[0]) * lateral, abs(steps[1]) * lateral) if lateral else None
    maps, others = [], []
    for k, name in enumerate(names):
        is_length = layers == 1 or any(word in name.lower() for word in LENGTH_CHANNELS)
        vertical = surface.length_um(unit_z) if unit_z else None
        if not is_length or (unit_z and vertical is None):
            others.append(f'"{name}"')
            continue
        surface.check_unit(path, options, unit_z)
        factor = vertical or surface.requested_unit(path, options)
        heights = values[k][::-1].astype(float) * factor
        maps.append(surface.height_map(path, heights, pitch or surface.requested_pitch(path, options), name))
    return surface.chosen(path, maps, others, options)


def _labels(data: bytes, sizes: list[int], layers: int) -> list[str]:
    """Return the names of the layers: labels of the third dimension, 32 bytes each after one for the dimension."""
    block = data[sum(sizes[:2]) :][: sizes[2]]
    names = [block[32 * k : 32 * k + 32].split(b"\0")[0].decode("latin-1") for k in range(1, layers + 1)]
    return [name or f"channel {k + 1}" for k, name in enumerate(names)]


# TopoStats files (.topostats): HDF5 with the flattened image in nm.

TOPOSTATS_IMAGES = ("image", "image_original")
TOPOSTATS_KEY, MAX_BYTES = b"pixel_to_nm_scaling", 64 << 20


def sniff_topostats(head: FileHead) -> float:
    """Return 1 for HDF5 with `topostats_file_version` or an image and a scale from pixels to nm."""
    if not head.data.startswith(HDF5_MAGIC):
        return 0.0
    # names of later groups follow the traces of grains
    data = head.data if TOPOSTATS_KEY in head.data or head.size > MAX_BYTES else head.path.read_bytes()
    return CERTAIN if TOPOSTATS_KEY in data else 0.0


def read_topostats(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the flattened image, or else the original one."""
    with opened(path) as file:
        scale: Any = dataset(file, "pixel_to_nm_scaling")
        name, image = next(((n, d) for n in TOPOSTATS_IMAGES if (d := dataset(file, n)) is not None), ("", None))
        if scale is None or image is None or image.ndim != 2:
            raise ValueError("it holds no image with pixel_to_nm_scaling")
        surface.check_unit(path, options, "nm")
        pitch = float(np.ravel(scale[()])[0]) * 1e-3
        heights = np.asarray(image[()], dtype=float) * 1e-3
    left_out = [other for other in TOPOSTATS_IMAGES if other != name]
    return [surface.height_map(path, heights, (pitch, pitch), name, left_out=left_out)]


# Classic NetCDF files (.nc) with one two-dimensional variable of heights over x and y, as SurfaceTopography writes.

NETCDF_MAGICS = (b"CDF\x01", b"CDF\x02")


def sniff_netcdf(head: FileHead) -> float:
    """Return 1 for classic NetCDF with heights, a fair confidence for any other."""
    if not head.data.startswith(NETCDF_MAGICS):
        return 0.0
    return CERTAIN if b"height" in head.data else LIKELY


def _unit(variable: Any) -> str:
    value = getattr(variable, "unit", getattr(variable, "units", ""))
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def read_netcdf(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read every variable over two axes; the first axis is x if it has the name x, else the rows."""
    from scipy.io import netcdf_file

    maps, others = [], []
    with netcdf_file(path, "r", mmap=False) as file:
        for name, variable in file.variables.items():
            if len(variable.dimensions) != 2:
                continue
            unit = _unit(variable)
            factor = surface.length_um(unit) if unit else surface.requested_unit(path, options)
            if factor is None:
                others.append(f'"{name}" in {unit}')
                continue
            surface.check_unit(path, options, unit)
            is_x_first = variable.dimensions[0].lower().startswith("x")
            values = np.array(variable[:], dtype=float) * factor
            axes = [variable.dimensions[k] for k in ((0, 1) if is_x_first else (1, 0))]
            values = values.T if is_x_first else values
            x, y = (_pitch_um(file.variables.get(axis), axis, count) for axis, count in zip(axes, values.shape[::-1]))
            pitch = surface.requested_pitch(path, options) if x is None or y is None else (x, y)
            maps.append(surface.height_map(path, values, pitch, name))
    return surface.chosen(path, maps, others, options)


def _pitch_um(axis: Any, name: str, count: int) -> float | None:
    """Return the point distance from the length of the axis or its positions."""
    unit = None if axis is None else surface.length_um(_unit(axis))
    if axis is None or unit is None:
        return None
    length = getattr(axis, "length", None)
    if length is not None:
        return float(np.ravel(length)[0]) * unit / count
    positions = np.array(axis[:], dtype=float)
    steps = np.diff(positions)
    if not np.allclose(steps, steps.mean(), rtol=1e-3):
        raise ValueError(f"its positions along {name} are not equally spaced")
    return abs(float(steps.mean())) * unit


# BCR-STM and BCRF files of Image Metrology SPIP: a text head of fixed size, then integers or floats.

BCR_FIRST = "fileformat"
KINDS = {"bcrstm": "i2", "bcrf": "f4"}
VOID = {"i2": 32767.0, "f4": 1.7e38}  # values from this one upward are holes


def _encoding(data: bytes) -> str:
    return "utf-16-le" if data[:2] == b"\xff\xfe" or data[1:2] == b"\0" else "latin-1"


def sniff_bcr(head: FileHead) -> float:
    """Return 1 for `fileformat = bcrstm` or `bcrf`, in one or two bytes a character."""
    first = head.data[:80].decode(_encoding(head.data), "replace").lstrip("\ufeff").lower()
    key, equals, value = first.partition("=")
    return CERTAIN if equals and key.strip() == BCR_FIRST and value.strip().startswith("bcr") else 0.0


def read_bcr(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map: floats in `zunit`, or integers times `bit2nm`; sides in `xunit` and `yunit`; nm unless stated."""
    data = path.read_bytes()
    encoding = _encoding(data)
    width = 2 if encoding == "utf-16-le" else 1
    head = data[: 8192 * width].decode(encoding, "replace").lstrip("\ufeff")
    lines = [line for line in head.splitlines() if not line.startswith(("%", "#"))]
    keys = surface.key_values(lines, "=", is_lower=True)
    start = int(keys["headersize"]) * width
    kind = next((form for name, form in KINDS.items() if keys[BCR_FIRST].startswith(name)), None)
    if kind is None:
        raise ValueError(f"its format is {keys[BCR_FIRST][:30]}")
    order = ">" if keys.get("intelmode", "1") == "0" else "<"
    shape = int(keys["ypixels"]), int(keys["xpixels"])
    values = surface.array(data, order + kind, shape, start).astype(float)
    values[values >= VOID[kind]] = np.nan
    units = [surface.length_um(keys.get(f"{axis}unit", "nm")) for axis in "xyz"]
    if None in units:
        raise NacreError(f"{path}: its axes are in {', '.join(keys.get(f'{a}unit', 'nm') for a in 'xyz')}, no lengths")
    surface.check_unit(path, options, keys.get("zunit", "nm"))
    x, y, z = (float(unit or 0.0) for unit in units)
    pitch = float(keys["xlength"]) * x / shape[1], float(keys["ylength"]) * y / shape[0]
    scale = float(keys.get("bit2nm", 1.0)) if kind == "i2" else 1.0
    return [surface.height_map(path, values * scale * z, pitch)]


# Text maps with a head of keys: SPIP and Attocube (`x-pixels`, `x-length`), and Nova of NT-MDT (`NX`, `Scale X`).
#
# Lengths of SPIP are in nm unless a key says otherwise. Without `z-unit`, `Bit2nm` gives the heights in nm.

SPIP_FIRST = re.compile(
    r"\s*#?\s*(File Format\s*=\s*ASCII\s*$|Daisy frame view snapshot)", re.IGNORECASE | re.MULTILINE
)
SPIP_KEY = re.compile(r"\s*#?\s*([A-Za-z][\w \-]*?)\s*[=:]\s*(.*?)\s*$")
LONGEST = 400  # characters of a key and its value
START = re.compile(r"\s*#?\s*Start of Data\s*:?\s*$", re.IGNORECASE)


def sniff_spip(head: FileHead) -> float:
    """Return 1 for a first line that one of the programs writes."""
    return CERTAIN if SPIP_FIRST.match(head.text[:200].lstrip("\ufeff")) else 0.0


def read_spip(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map, and the mask for void points that may follow it.

    Raises:
        AmbiguousFileError: the file names no unit of its heights, or no lengths.
        NacreError: the values are not lengths, or their number differs from the head.
    """
    text = surface.whole_text(path)
    keys, rows = _parts(text)
    shape = _count(keys, "y-pixels", "ny"), _count(keys, "x-pixels", "nx")
    surface.check_shape(shape)
    count = shape[0] * shape[1]
    values = surface.numbers("\n".join(rows) + "\n", path)
    void = int(keys.get("voidpixels") or 0)
    if values.size not in (count, 2 * count) or (values.size == 2 * count) != bool(void):
        raise ValueError(f"its head states {shape[0]} x {shape[1]} heights, and {values.size} numbers follow")
    heights = values[:count].reshape(shape) * _factor(path, keys, options)
    if void:
        heights[values[count:].reshape(shape) != 0] = np.nan
    name = keys.get("display", keys.get("channel name", ""))
    return [surface.height_map(path, heights, _pitch(path, keys, shape, options), name)]


def _parts(text: str) -> tuple[dict[str, str], list[str]]:
    """Return the head's keys in lower case, and the number rows."""
    keys: dict[str, str] = {}
    lines = text.lstrip("\ufeff").splitlines()
    for place, line in enumerate(lines):
        if START.match(line):
            return keys, lines[place + 1 :]
        match = SPIP_KEY.match(line[:LONGEST])
        if match:
            keys[match[1].lower()] = match[2]
        elif re.match(r"\s*[-+.\d]", line):
            return keys, lines[place:]
    return keys, []


def _count(keys: dict[str, str], *names: str) -> int:
    text = next((keys[name] for name in names if name in keys), None)
    if text is None:
        raise ValueError(f"its head lacks {names[0]}")
    return int(text)


def _length(path: Path, unit: str) -> float:
    factor = surface.length_um(unit)
    if factor is None:
        raise NacreError(f"{path}: is a map of values in {unit[:20]}; heights are lengths")
    return factor


def _factor(path: Path, keys: dict[str, str], options: ReadOptions) -> float:
    """Return um per value."""
    unit = keys.get("z-unit") or keys.get("unit data")
    surface.check_unit(path, options, unit or ("nm" if "bit2nm" in keys else ""))
    if unit:
        is_scaled = keys.get("datascaleneeded", "no").lower() == "yes"
        return _length(path, unit) * (float(keys.get("scale data", 1.0)) if is_scaled else 1.0)
    if "bit2nm" in keys:
        return float(keys["bit2nm"]) * 1e-3
    return surface.requested_unit(path, options)


def _pitch(path: Path, keys: dict[str, str], shape: tuple[int, int], options: ReadOptions) -> tuple[float, float]:
    units = [keys.get(name) or keys.get(nova) or "" for name, nova in (("x-unit", "unit x"), ("y-unit", "unit y"))]
    units[1] = units[1] or units[0]
    if "x-length" in keys and "y-length" in keys:
        sides = [abs(float(keys[f"{axis}-length"])) * _length(path, unit or "nm") for axis, unit in zip("xy", units)]
        return sides[0] / shape[1], sides[1] / shape[0]
    if "scale x" in keys and units[0]:
        steps = [abs(float(keys.get(f"scale {axis}", keys["scale x"]))) for axis in "xy"]
        return steps[0] * _length(path, units[0]), steps[1] * _length(path, units[1])
    return surface.requested_pitch(path, options)


# Gwyddion's files: native (.gwy), ASCII matrix, and Simple Field (.gsf).

# Gwyddion's own files (.gwy): a tree of named components, little-endian.

GWY_MAGIC = b"GWYP"
NUMBERS = {"b": "<?", "c": "<c", "i": "<i", "q": "<q", "d": "<d"}
ARRAYS = {"C": "S1", "I": "<i4", "Q": "<i8", "D": "<f8"}
DEEPEST = 20


def sniff_gwy(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(GWY_MAGIC) else 0.0


class _Tree:
    """A reader of components."""

    def __init__(self, data: bytes, position: int) -> None:
        self.data, self.position = data, position

    def text(self) -> str:
        raw = self.data[self.position : self.data.index(b"\0", self.position)]
        self.position += len(raw) + 1
        return raw.decode("utf-8", "replace")

    def number(self, form: str) -> Any:
        (value,) = struct.unpack_from(form, self.data, self.position)
        self.position += struct.calcsize(form)
        return value

    def object(self, depth: int = 0) -> dict[str, Any]:
        self.text()
        end = self.number("<I") + self.position
        if end > len(self.data) or depth > DEEPEST:
            raise ValueError("an object is longer than the file")
        components: dict[str, Any] = {}
        while self.position < end:
            name = self.text()
            components[name] = self.component(chr(self.number("<B")), depth)
        return components

    def component(self, kind: str, depth: int) -> Any:
        if kind in NUMBERS:
            return self.number(NUMBERS[kind])
        if kind == "s":
            return self.text()
        if kind == "o":
            return self.object(depth + 1)
        count = self.number("<I")
        if kind in ARRAYS:
            values = np.frombuffer(self.data, ARRAYS[kind], count, self.position)
            self.position += values.nbytes
            return values
        if kind not in "SO" or count > len(self.data):
            raise ValueError(f'the type "{kind}" of a component is not known')
        return [self.text() if kind == "S" else self.object(depth + 1) for _ in range(count)]


def read_gwy(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels that are lengths; masked points are not taken away, since masks mark features too."""
    data = path.read_bytes()
    root = _Tree(data, len(GWY_MAGIC)).object()
    maps, others = [], []
    numbered = ((int(match[1]), match[0]) for key in root if (match := re.fullmatch(r"/(\d+)/data", key)))
    for number, key in sorted(numbered):
        field = root[key]
        name = str(root.get(f"{key}/title", f"channel {number}"))
        units = [str(field.get(f"si_unit_{axis}", {}).get("unitstr", "")) for axis in ("xy", "z")]
        if units[1] and surface.length_um(units[1]) is None:
            others.append(f'"{name}" in {units[1]}')
            continue
        if all(units):
            surface.check_unit(path, options, units[1])
        lateral, vertical = (surface.length_um(u) if u else surface.requested_unit(path, options) for u in units)
        if lateral is None or vertical is None:
            others.append(f'"{name}" over {units[0]}')
            continue
        shape = int(field["yres"]), int(field["xres"])
        surface.check_shape(shape)
        heights = np.asarray(field["data"], dtype=float).reshape(shape) * vertical
        pitch = abs(field["xreal"]) / shape[1] * lateral, abs(field["yreal"]) / shape[0] * lateral
        maps.append(surface.height_map(path, heights, pitch, name))
    return surface.chosen(path, maps, others, options)


# Gwyddion's ASCII matrix, in any language: remarks with the channel, width, height and the unit of the values.

REMARK = re.compile(r"#\s*([^:：]+)[:：]\s*(.*?)\s*$")  # a wide colon in Japanese and Chinese
SIZE = re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?\s*\S{1,3}$")


def _remarks(lines: list[str]) -> list[tuple[str, str]]:
    matches = takewhile(bool, map(REMARK.match, lines))
    return [(match[1].strip(), match[2]) for match in matches if match]


def sniff_gwyddion_text(head: FileHead) -> float:
    """Return 1 for remarks of which two are lengths, the map's size."""
    remarks = _remarks(surface.decoded(head.data).splitlines()[:8])
    return CERTAIN if 3 <= len(remarks) <= 6 and sum(_is_length(v) for _, v in remarks) == 2 else 0.0


def _is_length(text: str) -> bool:
    try:
        return bool(SIZE.match(text)) and surface.quantity_um(text) > 0
    except ValueError:
        return False


def read_gwyddion_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all blocks' maps; remarks are taken by their order, since Gwyddion translates their names.

    Raises:
        AmbiguousFileError: a block names no unit of its values.
        NacreError: rows differ in their length, or no block holds lengths.
    """
    text = surface.whole_text(path)
    maps, others = [], []
    for lines in _blocks(text.splitlines()):
        remarks = _remarks(lines)
        width, height = (surface.quantity_um(v) for _, v in remarks if _is_length(v))
        texts = [v for _, v in remarks if not _is_length(v)]
        name, unit = (texts[0] if texts else ""), (texts[-1] if len(texts) > 1 else "")
        rows = [line for line in lines[len(remarks) :] if line.strip() and not line.startswith("#")]
        values = surface.matrix(rows, path)
        factor = surface.length_um(unit) if unit else surface.requested_unit(path, options)
        if factor is None:
            others.append(f'"{name}" in {unit}')
            continue
        surface.check_unit(path, options, unit)
        pitch = width / values.shape[1], height / len(rows)
        left_out = [f"channel {other}" for other in others]
        maps.append(surface.height_map(path, values * factor, pitch, name, left_out=left_out))
    return surface.chosen(path, maps, others, options)


def _blocks(lines: list[str]) -> list[list[str]]:
    """Split a file with several exports: each begins with a remark below a row of numbers."""
    blocks: list[list[str]] = [[]]
    was_row = False
    for line in lines:
        is_remark = line.startswith("#")
        if is_remark and was_row:
            blocks.append([])
        blocks[-1].append(line)
        was_row = bool(line.strip()) and not is_remark or (was_row and not line.strip())
    return blocks


# Gwyddion Simple Field (.gsf): a text head, NUL bytes up to a multiple of four, floats from the upper left point.

GSF_MAGIC = b"Gwyddion Simple Field 1.0\n"


def sniff_gsf(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(GSF_MAGIC) else 0.0


def read_gsf(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; units missing in the head must be given."""
    data = path.read_bytes()
    end = data.index(b"\0")
    lines = data[len(GSF_MAGIC) : end].decode("utf-8", "replace").splitlines()
    keys = {name.strip(): value.strip() for name, _, value in (line.partition("=") for line in lines)}
    shape = int(keys["YRes"]), int(keys["XRes"])
    units = [keys.get(name, "") for name in ("XYUnits", "ZUnits")]
    lateral, vertical = (surface.length_um(unit) for unit in units)
    if (units[0] and lateral is None) or (units[1] and vertical is None):
        raise NacreError(f"{path}: is a map of {units[1] or '?'} over {units[0] or '?'}; heights are lengths")
    surface.check_unit(path, options, units[1])
    vertical = vertical or surface.requested_unit(path, options)
    sides = [float(keys.get(name, 1.0)) for name in ("XReal", "YReal")]
    if lateral is None:
        pitch = surface.requested_pitch(path, options)
    else:
        pitch = sides[0] * lateral / shape[1], sides[1] * lateral / shape[0]
    heights = surface.array(data, "<f4", shape, end + 4 - end % 4).astype(float) * vertical
    return [surface.height_map(path, heights, pitch, keys.get("Title", ""))]
