"""16-bit grey images of heights, PNG and TIFF, written row by row so that a whole wafer never sits in memory.

A wafer is one tile repeated; a row of it is one row of the tile repeated. A 50 mm x 50 mm wafer at 1.6 um has
31 250 x 31 250 pixels, 2 GB; the writers hold a few rows.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from nacre.errors import UnsupportedError
from nacre.files import atomic_path

Grey = NDArray[np.uint16]
MAX_PIXELS_A_SIDE = 1_000_000
TIFF_TILE = 256
CHUNK_BYTES = 1 << 20
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
METADATA_KEY = "nacre"


def repeated_rows(tile: Grey, rows: int, columns: int) -> Iterator[Grey]:
    """Yield `rows` rows of `columns` pixels of the tile repeated over the plane."""
    height, width = tile.shape
    times = -(-columns // width)
    # each distinct row is laid out once per use: a tile has few rows, a wafer many
    for k in range(rows):
        yield np.tile(tile[k % height], times)[:columns]


def check_size(rows: int, columns: int) -> None:
    """Refuse images that no tool opens.

    Raises:
        UnsupportedError: a side is empty or beyond a million pixels.
    """
    if not (0 < rows <= MAX_PIXELS_A_SIDE and 0 < columns <= MAX_PIXELS_A_SIDE):
        raise UnsupportedError(f"an image of {rows} x {columns} pixels; each side may have 1 to {MAX_PIXELS_A_SIDE}")


def write_png16(
    path: str | Path,
    tile: Grey,
    metadata: Mapping[str, Any],
    pitch_um: float,
    rows: int | None = None,
    columns: int | None = None,
) -> None:
    """Write a 16-bit grey PNG of the tile, repeated to `rows` x `columns` pixels; rows run along x.

    The metadata go into a text chunk, the pitch into pHYs (pixels a metre).

    Raises:
        NacreError: the file cannot be written.
        UnsupportedError: the size is out of range.
    """
    rows, columns = rows or tile.shape[0], columns or tile.shape[1]
    write_png16_rows(path, repeated_rows(tile, rows, columns), metadata, pitch_um, rows, columns)


def write_png16_rows(
    path: str | Path, lines: Iterable[Grey], metadata: Mapping[str, Any], pitch_um: float, rows: int, columns: int
) -> None:
    """Write a 16-bit grey PNG from `rows` lines of `columns` pixels, as they come.

    Raises:
        NacreError: the file cannot be written.
        UnsupportedError: the size is out of range.
    """
    check_size(rows, columns)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(PNG_SIGNATURE)
        _chunk(stream, b"IHDR", struct.pack(">IIBBBBB", columns, rows, 16, 0, 0, 0, 0))
        per_metre = min(int(round(1e6 / pitch_um)), 0x7FFFFFFF)
        _chunk(stream, b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1))
        _chunk(stream, b"tEXt", METADATA_KEY.encode() + b"\0" + json.dumps(dict(metadata)).encode("latin-1"))
        # level 1: rows of a repeated tile are long-range copies, which deflate's 32 kB window cannot reach anyway
        packer = zlib.compressobj(1)
        pending = bytearray()
        for row in lines:
            pending += packer.compress(b"\0" + row.astype(">u2").tobytes())
            if len(pending) > CHUNK_BYTES:
                _chunk(stream, b"IDAT", bytes(pending))
                pending.clear()
        _chunk(stream, b"IDAT", bytes(pending) + packer.flush())
        _chunk(stream, b"IEND", b"")


def _chunk(stream: BinaryIO, kind: bytes, data: bytes) -> None:
    stream.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))


def write_tiff16(
    path: str | Path,
    tile: Grey,
    metadata: Mapping[str, Any],
    pitch_um: float,
    rows: int | None = None,
    columns: int | None = None,
) -> None:
    """Write a 16-bit grey TIFF in tiles (BigTIFF beyond 4 GB); metadata in ImageDescription, pitch as resolution.

    Raises:
        NacreError: the file cannot be written.
        UnsupportedError: the size is out of range.
    """
    import tifffile

    rows, columns = rows or tile.shape[0], columns or tile.shape[1]
    check_size(rows, columns)
    side = TIFF_TILE if max(rows, columns) > TIFF_TILE else 16 * -(-max(rows, columns) // 16)

    def tiles() -> Iterator[Grey]:
        band = np.zeros((side, side * -(-columns // side)), dtype=np.uint16)
        source = repeated_rows(tile, rows, columns)
        for first in range(0, rows, side):
            band[:] = 0
            for k in range(min(side, rows - first)):
                band[k, :columns] = next(source)
            for left in range(0, columns, side):
                yield band[:, left : left + side].copy()

    per_cm = 1e4 / pitch_um
    with (
        atomic_path(path) as temporary,
        tifffile.TiffWriter(temporary, bigtiff=rows * columns * 2 > 0xF0000000) as writer,
    ):
        writer.write(
            tiles(),
            shape=(rows, columns),
            dtype=np.uint16,
            photometric="minisblack",
            tile=(side, side),
            compression="zlib",
            compressionargs={"level": 1},
            description=json.dumps(dict(metadata)),
            resolution=(per_cm, per_cm),
            resolutionunit="CENTIMETER",
            metadata=None,
        )
