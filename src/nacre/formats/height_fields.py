"""Height fields as binary STL solids and 16-bit images.

STL files lack a unit; the header states um. Images are written row by row, since a wafer may exceed the memory: 50 mm
x 50 mm at 1.6 um are 31,250 x 31,250 pixels, 2 GB. Libraries write PNG only as a whole, hence the own PNG writer.
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

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.files import atomic_path
from nacre.core.memory import check_memory

# distance of a plateau from the edge of its feature; walls connect plateaus
WALL_SHARE = 0.02
MAX_TRIANGLES = 60_000_000
TRIANGLE_BYTES = 300  # memory: corners twice, edges and normal in double precision, record
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(
    path: str | Path, heights_um: Array, pitch_um: float, base_um: float = 1.0, repeat: tuple[int, int] = (1, 1)
) -> None:
    """Write a watertight solid of flat features with steep walls on a base.

    Args:
        heights_um: `[x, y]` feature heights.
        pitch_um: feature width.
        base_um: base thickness below the lowest feature.
        repeat: tiles along x and y.

    Raises:
        UnsupportedError: too many triangles for an STL file.
        NacreError: the file cannot be written.
    """
    nx, ny = heights_um.shape[0] * repeat[0], heights_um.shape[1] * repeat[1]
    triangles = 2 * (2 * (2 * nx - 1) * (2 * ny - 1) + 2 * (2 * nx - 1) + 2 * (2 * ny - 1))
    if triangles > MAX_TRIANGLES:
        raise UnsupportedError(f"{nx} x {ny} features make {triangles} triangles; an STL here holds {MAX_TRIANGLES}")
    check_memory(TRIANGLE_BYTES * float(triangles), f"an STL of {nx} x {ny} features")
    heights = np.tile(heights_um - heights_um.min() + base_um, repeat)
    x, y = (_plateau_edges(n) * pitch_um for n in (nx, ny))
    z = np.repeat(np.repeat(heights, 2, axis=0), 2, axis=1)
    top = np.stack([*np.broadcast_arrays(x[:, None], y[None, :]), z], axis=-1)
    floor = top.copy()
    floor[..., 2] = 0.0
    parts = [_quads(top), _quads(floor)[:, ::-1]]
    # around the border, solid on the left
    for side in (np.s_[:, 0], np.s_[-1], np.s_[::-1, -1], np.s_[0, ::-1]):
        parts.append(_quads(np.stack([floor[side], top[side]], axis=1)))
    corners = np.concatenate(parts)
    records = np.zeros(len(corners), dtype=_RECORD)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    records["normal"] = normal / np.maximum(length, 1e-300)
    records["corners"] = corners
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"nacre relief, unit um".ljust(80))
        stream.write(np.uint32(len(records)).tobytes())
        records.tofile(stream)


def _plateau_edges(features: int) -> Array:
    """Return both edges of each plateau, in features; the outer ones lie on the border."""
    edges = (np.arange(features)[:, None] + np.array([0.5 * WALL_SHARE, 1.0 - 0.5 * WALL_SHARE])).ravel()
    edges[0], edges[-1] = 0.0, features
    return np.asarray(edges)


def _quads(grid: Array) -> Array:
    """Return triangles `[n, corner, 3]` for a vertex grid `[a, b, 3]`, facing a x b."""
    p00, p10, p01, p11 = grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]
    first, second = np.stack([p00, p10, p11], axis=-2), np.stack([p00, p11, p01], axis=-2)
    return np.asarray(np.concatenate([first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)]))


Grey = NDArray[np.uint16]
MAX_PIXELS_A_SIDE = 1_000_000
TIFF_TILE = 256
CHUNK_BYTES = 1 << 20
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
METADATA_KEY = "nacre"
GREY, RGB = 0, 2  # PNG colour types


def repeated_rows(tile: Grey, rows: int, columns: int) -> Iterator[Grey]:
    """Yield `rows` rows with `columns` pixels of the periodic tile."""
    height, width = tile.shape
    times = -(-columns // width)
    for k in range(rows):
        yield np.tile(tile[k % height], times)[:columns]


def check_size(rows: int, columns: int) -> None:
    """Refuse image sizes that other programs cannot open.

    Raises:
        UnsupportedError: a side is empty or above a million pixels.
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
    """Write the tile, repeated to `rows` x `columns` pixels, as 16-bit grey PNG; rows are parallel to x.

    Metadata are stored as text chunk, the pitch as pHYs (pixels per metre).

    Raises:
        NacreError: the file cannot be written.
        UnsupportedError: invalid size.
    """
    rows, columns = rows or tile.shape[0], columns or tile.shape[1]
    write_png16_rows(path, repeated_rows(tile, rows, columns), metadata, pitch_um, rows, columns)


def write_png16_rows(
    path: str | Path, lines: Iterable[Grey], metadata: Mapping[str, Any], pitch_um: float, rows: int, columns: int
) -> None:
    """Write a 16-bit grey PNG from an iterable of rows.

    Raises:
        NacreError: the file cannot be written.
        UnsupportedError: invalid size.
    """
    check_size(rows, columns)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        text = json.dumps(dict(metadata))
        # level 1: copies of a tile are farther apart than deflate's window of 32 kB
        write_png_stream(stream, lines, (columns, rows), GREY, text, level=1, pitch_um=pitch_um)


def write_png_stream(
    stream: BinaryIO, lines: Iterable[Grey], size: tuple[int, int], colour_type: int, text: str, level: int,
    pitch_um: float | None = None,
) -> None:  # fmt: skip
    """Write a 16-bit PNG with colour type `GREY` or `RGB` row by row; `text` is the chunk "nacre"."""
    stream.write(PNG_SIGNATURE)
    _chunk(stream, b"IHDR", struct.pack(">IIBBBBB", *size, 16, colour_type, 0, 0, 0))
    if pitch_um is not None:
        per_metre = min(int(round(1e6 / pitch_um)), 0x7FFFFFFF)
        _chunk(stream, b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1))
    _chunk(stream, b"tEXt", METADATA_KEY.encode() + b"\0" + text.encode("latin-1"))
    packer = zlib.compressobj(level)
    pending = bytearray()
    for row in lines:
        pending += packer.compress(b"\0" + row.astype(">u2").tobytes())
        if len(pending) > CHUNK_BYTES:
            _chunk(stream, b"IDAT", bytes(pending))
            pending.clear()
    _chunk(stream, b"IDAT", bytes(pending) + packer.flush())
    _chunk(stream, b"IEND", b"")


def _chunk(stream: BinaryIO, name: bytes, data: bytes) -> None:
    stream.write(struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)))


def write_tiff16(
    path: str | Path,
    tile: Grey,
    metadata: Mapping[str, Any],
    pitch_um: float,
    rows: int | None = None,
    columns: int | None = None,
) -> None:
    """Write a tiled 16-bit grey TIFF (BigTIFF above 4 GB); metadata in ImageDescription, pitch as resolution.

    Raises:
        NacreError: the file cannot be written.
        UnsupportedError: invalid size.
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
