"""X3P files, ISO 25178-72 (ISO 5436-2): a zip with an XML head and a binary matrix, in m."""

from __future__ import annotations

import zipfile
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, check_shape, height_map, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
MAX_BYTES = 4 << 30


def sniff(head: FileHead) -> float:
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
def read(path: Path, options: ReadOptions) -> list[Measurement]:
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
            kind = TYPES[value("Record1/Axes/CZ/DataType")]
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
