"""The exchange formats of ISO 25178: surface data (part 71, .sdf) and X3P (part 72)."""

import struct
import zipfile
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, check_end, check_shape, decoded, height_map, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

# ISO 25178-71 surface data files (.sdf), ASCII and binary; the BCR-STM files before them have the same form.

MAGIC = tuple(side + name for side in (b"a", b"b") for name in (b"ISO-1.0", b"ISO-2.0", b"BCR-1.0"))
HEAD = "<8s10s12s12s{0}{0}ddddBBB"  # numbers of points and profiles: 16 bits, or 32 in ISO-2.0
SDF_TYPES = {0: "u1", 1: "<u2", 2: "<u4", 3: "<f4", 4: "i1", 5: "<i2", 6: "<i4", 7: "<f8"}


def sniff_sdf(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.lstrip().startswith(MAGIC) else 0.0


@reads
def read_sdf(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; scales are in m."""
    data = path.read_bytes().lstrip()
    values, fields = _binary(data) if data[:1] == b"b" else _ascii(data, path)
    scale = [float(str(fields[name]).replace(",", ".")) for name in ("Xscale", "Yscale", "Zscale")]
    if int(fields.get("Compression", 0)) != 0:
        raise NacreError(f"{path}: is compressed; export it without compression")
    if not scale[2] > 0:
        raise NacreError(f"{path}: gives Zscale = {scale[2]:g}; it should be above 0")
    heights = values.astype(float)
    heights[np.isin(heights, _holes(np.dtype(SDF_TYPES[int(fields["DataType"])]), data[1:4] == b"BCR"))] = np.nan
    kept = {k: str(v) for k, v in fields.items() if k in ("ManufacID", "CreateDate", "ModDate")}
    return [height_map(path, "sdf", heights * scale[2] * 1e6, (scale[0] * 1e6, scale[1] * 1e6), metadata=kept)]


def _holes(kind: np.dtype[Any], is_bcr: bool) -> list[float]:
    """Return a hole's values: the type's least in ISO 25178-71, the largest in BCR-STM, which some mix."""
    if kind.kind == "f":
        return [float(np.finfo(kind).min), float(np.finfo(kind).max)]
    limits = np.iinfo(kind)
    least = [float(limits.min)] if kind.kind == "i" else []
    return [*least, float(limits.max)] if is_bcr or kind.kind == "u" else least


def _binary(data: bytes) -> tuple[NDArray[Any], dict[str, Any]]:
    form = struct.Struct(HEAD.format("I" if data.startswith(b"bISO-2.0") else "H"))
    _, maker, made, changed, columns, rows, x, y, z, _, compression, kind, _ = form.unpack_from(data)
    texts = (v.decode("latin-1").strip(" \0") for v in (maker, made, changed))
    fields = dict(zip(("ManufacID", "CreateDate", "ModDate"), texts))
    more = {"Xscale": x, "Yscale": y, "Zscale": z, "Compression": compression, "DataType": kind}
    values = array(data, SDF_TYPES[kind], (rows, columns), form.size)
    return values, {**fields, **more}


def _ascii(data: bytes, path: Path) -> tuple[NDArray[Any], dict[str, Any]]:
    head, star, rest = decoded(data).partition("*")
    if not star:
        raise ValueError("the end of its head is missing")
    fields: dict[str, Any] = {}
    for line in head.splitlines()[1:]:
        name, equals, value = line.partition("=")
        if equals:
            fields[name.strip()] = value.strip()
    shape = int(fields["NumProfiles"]), int(fields["NumPoints"])
    check_shape(shape)
    body, end, _ = rest.partition("*")
    if not end:
        check_end(body, path)
    values = numbers(body, path)
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"its head states {shape[0]} x {shape[1]} heights, and {values.size} follow")
    return values.reshape(shape), fields


# X3P files, ISO 25178-72 (ISO 5436-2): a zip with an XML head and a binary matrix, in m.

X3P_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
MAX_BYTES = 4 << 30


def sniff_x3p(head: FileHead) -> float:
    """Return 1 for a zip that holds main.xml."""
    if not head.data.startswith(b"PK\x03\x04"):
        return 0.0
    try:
        with zipfile.ZipFile(head.path) as archive:
            return CERTAIN if "main.xml" in archive.namelist() else 0.0
    except (zipfile.BadZipFile, OSError, ValueError):
        return 0.0


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    if archive.getinfo(name).file_size > MAX_BYTES:
        raise ValueError(f"{name} is larger than {MAX_BYTES >> 30} GiB")
    return archive.read(name)


@reads
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
            found = root.find(place)
            if found is None or found.text is None:
                if default is None:
                    raise ValueError(f"its head lacks {place}")
                return default
            return found.text.strip()

        if value("Record1/FeatureType") not in ("SUR",):
            raise NacreError(f"{path}: is a {value('Record1/FeatureType')}, no surface; heights are a map")
        columns, rows = (int(value(f"Record3/MatrixDimension/Size{axis}")) for axis in "XY")
        check_shape((rows, columns))
        steps = [float(value(f"Record1/Axes/C{axis}/Increment", "1" if axis == "Z" else None)) for axis in "XYZ"]
        offset = float(value("Record1/Axes/CZ/Offset", "0"))
        if root.find("Record3/DataList") is not None:
            words = "\n".join(d.text or "nan" for d in root.iterfind("Record3/DataList/Datum"))
            cells = numbers(words.replace(";", " ") + "\n", path).reshape(rows, columns, -1)[..., -1]
        else:
            kind = X3P_TYPES[value("Record1/Axes/CZ/DataType")]
            cells = array(_member(archive, _inside(value("Record3/DataLink/PointDataLink"))), kind, (rows, columns))
        heights = cells.astype(float) * steps[2] + offset
        mask = value("Record3/DataLink/ValidPointsLink", "")
        if mask:
            bits = np.unpackbits(np.frombuffer(_member(archive, _inside(mask)), "u1"), bitorder="little")
            heights[bits[: rows * columns].reshape(rows, columns) == 0] = np.nan
    facts = {"date": value("Record2/Date", ""), "instrument": value("Record2/Instrument/Model", "")}
    return [height_map(path, "x3p", heights * 1e6, (steps[0] * 1e6, steps[1] * 1e6), metadata=facts)]


def _inside(name: str) -> str:
    return str(PurePosixPath(name.replace("\\", "/"))).lstrip("./")
