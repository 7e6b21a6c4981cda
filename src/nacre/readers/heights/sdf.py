"""ISO 25178-71 surface data files (.sdf), ASCII and binary; the BCR-STM files before them have the same form."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, check_end, check_shape, decoded, height_map, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = tuple(side + name for side in (b"a", b"b") for name in (b"ISO-1.0", b"ISO-2.0", b"BCR-1.0"))
HEAD = "<8s10s12s12s{0}{0}ddddBBB"  # numbers of points and profiles: 16 bits, or 32 in ISO-2.0
TYPES = {0: "u1", 1: "<u2", 2: "<u4", 3: "<f4", 4: "i1", 5: "<i2", 6: "<i4", 7: "<f8"}


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.lstrip().startswith(MAGIC) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; scales are in m."""
    data = path.read_bytes().lstrip()
    values, fields = _binary(data) if data[:1] == b"b" else _ascii(data, path)
    scale = [float(str(fields[name]).replace(",", ".")) for name in ("Xscale", "Yscale", "Zscale")]
    if int(fields.get("Compression", 0)) != 0:
        raise NacreError(f"{path}: is compressed; export it without compression")
    if not scale[2] > 0:
        raise NacreError(f"{path}: gives Zscale = {scale[2]:g}; it should be above 0")
    heights = values.astype(float)
    heights[np.isin(heights, _holes(np.dtype(TYPES[int(fields["DataType"])]), data[1:4] == b"BCR"))] = np.nan
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
    values = array(data, TYPES[kind], (rows, columns), form.size)
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
