"""Maps of numbers over an area, and height fields, as files for fabrication."""

import json
import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, check_writable, write_text
from nacre.core.machine import check_memory
from nacre.formats.layouts import LARGEST_GREY, MAX_LEVELS, is_monotonic, read_curve, write_levels

# Parameter maps over a surface as fabrication files: grey images, level masks, tables.
#
# A process curve converts values to machine settings (anodising voltage, dose, time).

DEFAULT_PIXEL_UM = 100.0
FORMATS = ("png16", "tiff16", "npy", "csv", "gds", "oas")
SUFFIXES = {"png16": ".png", "tiff16": ".tif", "npy": ".npy", "csv": ".csv", "gds": ".gds", "oas": ".oas"}
DEFAULT_LEVELS = 16
# units in a heading that are not lengths
NO_LENGTHS = ("v", "volt", "volts", "a", "s", "min", "kg", "g", "mg", "deg", "percent", "%", "ev", "roughness")
SAME_LEVEL = 2.0 / LARGEST_GREY  # rounding of a level in a 16-bit map, relative to the range
MAX_ASPECT_ERROR = 0.01  # relative difference of the sides of a pixel


@dataclass(frozen=True, eq=False)
class NumberMap:
    """A parameter over the surface.

    Attributes:
        path: in the recipe.
        values: `[row, column]`, first row at the top, from the light's side; lengths in nm.
        low, high: values for black and white.
        unit: "nm" for lengths, else "".
    """

    path: str
    values: Array
    low: float
    high: float
    unit: str

    @property
    def slug(self) -> str:
        """The path as part of a file name."""
        return re.sub(r"[^A-Za-z0-9_]+", "-", self.path).strip("-")


@dataclass(frozen=True, eq=False)
class ProcessCurve:
    """Process settings over values, linear between the points.

    Attributes:
        settings: ascending.
        values: strictly monotonic; lengths in nm.
        name: file name.
        words: headings of the two columns.
    """

    settings: Array
    values: Array
    name: str
    words: tuple[str, str]

    def settings_of(self, wanted: NumberMap) -> Array:
        """Return the settings for a map.

        Raises:
            NacreError: the curve does not cover the values.
        """
        unit_in_heading = re.split(r"[_(\[\s]+", self.words[1].rstrip(")] ").lower())[-1]
        if wanted.unit == "nm" and unit_in_heading in NO_LENGTHS:
            raise NacreError(f'{self.name}: "{self.words[1]}" is not a length; {wanted.path} is one, in nm, um or mm')
        low, high = float(self.values.min()), float(self.values.max())
        slack = SAME_LEVEL * (wanted.high - wanted.low)
        least, most = float(wanted.values.min()), float(wanted.values.max())
        if least < low - slack or most > high + slack:
            unit = f" {wanted.unit}" if wanted.unit else ""
            raise NacreError(
                f"{self.name}: covers {low:g} to {high:g}{unit}; {wanted.path} needs {least:g} to {most:g}{unit}: "
                "measure more points, or design within what the process makes"
            )
        order = np.argsort(self.values)
        return np.asarray(np.interp(wanted.values, self.values[order], self.settings[order]))


def read_process(path: str | Path) -> ProcessCurve:
    """Read a two-column CSV with settings and values; lengths in nm.

    Headings may include a length unit (`thickness_um`, `Oxide (nm)`); if only the first is a length, the columns are
    swapped. Lines that start with # are ignored.

    Raises:
        NacreError: it cannot be read, has fewer than two points, or is not monotonic.
    """
    path = Path(path)
    table, words = read_curve(path, "process curve", "nm")
    if not np.isfinite(table).all():
        raise NacreError(f"{path}: all numbers must be finite")
    if not is_monotonic(table):
        raise NacreError(f"{path}: the process curve is not monotonic; each value needs one setting")
    return ProcessCurve(table[:, 0], table[:, 1], str(path), words or ("setting", "value"))


def write_number_maps(
    maps: Sequence[NumberMap],
    to: str,
    path: Path,
    source: str,
    *,
    size_mm: tuple[float, float] | None = None,
    calibration: str | Path | Mapping[str, str | Path] | None = None,
    levels: int | None = None,
) -> tuple[Path, ...]:
    """Write each map, and a JSON file with its scale and orientation.

    Args:
        maps: file names of several maps contain the parameter's path.
        to: a name in `FORMATS`.
        path: output file.
        source: recipe name.
        size_mm: width and height; default: 0.1 mm per pixel.
        calibration: a CSV of settings and values; for several maps a mapping from path to file.
        levels: levels of a mask; default: those of the map, or 16.

    Raises:
        UnsupportedError: unsuitable suffix, size or levels.
        NacreError: unsuitable curve, or a file cannot be written.
    """
    if path.suffix.lower() != SUFFIXES[to]:
        raise UnsupportedError(f"{path}: --to {to} needs a name that ends in {SUFFIXES[to]}")
    if levels is not None and to not in ("gds", "oas"):
        raise UnsupportedError(f"--to {to} takes no --levels here: only the masks of gds and oas have them")
    curves = _curves(maps, calibration)
    prepared = []
    for one in maps:
        place = path if len(maps) == 1 else path.with_name(f"{path.stem}-{one.slug}{path.suffix}")
        check_writable(place)
        curve = curves.get(one.path)
        settings = None if curve is None else curve.settings_of(one)
        prepared.append((one, place, curve, settings, _pitch_um(one, size_mm)))
    paths: list[Path] = []
    for one, place, curve, settings, pitch_um in prepared:
        rows, columns = one.values.shape
        facts: dict[str, Any] = {
            "format": to, "source": source, "nacre": __version__, "path": one.path, "unit": one.unit or None,
            "pixels": [rows, columns], "pixel_um": pitch_um,
            "seen": "from the light's side; " + ("x to the right, y upward" if to in ("gds", "oas") else
                                                 "the first row on top"),
        }  # fmt: skip
        if curve is not None:
            facts |= {
                "calibration": Path(curve.name).name,
                "setting": curve.words[0],
                "curve": np.stack([curve.settings, curve.values], axis=-1).tolist(),
            }
        _write(one, to, place, settings, pitch_um, levels, facts)
        beside = place.with_name(place.name + ".json")
        write_text(beside, json.dumps(facts, indent=2) + "\n")
        paths += [place, beside]
    return tuple(paths)


def _curves(
    maps: Sequence[NumberMap], calibration: str | Path | Mapping[str, str | Path] | None
) -> dict[str, ProcessCurve]:
    """Return process curves by parameter path."""
    if calibration is None:
        return {}
    paths = [one.path for one in maps]
    if isinstance(calibration, Mapping):
        unknown = [name for name in calibration if name not in paths]
        if unknown:
            raise NacreError(f'--calibration: "{unknown[0]}" does not vary by an image; that do: {", ".join(paths)}')
        return {name: read_process(file) for name, file in calibration.items()}
    if len(maps) > 1:
        raise NacreError(
            f"--calibration {calibration}: {len(maps)} numbers vary; say which it is of, such as "
            f"--calibration {paths[0]}={calibration}"
        )
    return {paths[0]: read_process(calibration)}


def _pitch_um(one: NumberMap, size_mm: tuple[float, float] | None) -> float:
    if size_mm is None:
        return DEFAULT_PIXEL_UM
    rows, columns = one.values.shape
    wide, high = 1e3 * size_mm[0] / columns, 1e3 * size_mm[1] / rows
    if abs(wide - high) > MAX_ASPECT_ERROR * wide:
        raise UnsupportedError(
            f"--size-mm {size_mm[0]:g}x{size_mm[1]:g} stretches the picture of {columns} x {rows} pixels; "
            f"{size_mm[0]:g}x{size_mm[0] * rows / columns:.4g} does not"
        )
    return wide


def _write(
    one: NumberMap, to: str, path: Path, settings: Array | None, pitch_um: float, levels: int | None,
    facts: dict[str, Any],
) -> None:  # fmt: skip
    values = one.values if settings is None else settings
    if to in ("gds", "oas"):
        _write_mask(one, path, settings, pitch_um, levels, facts)
    elif to == "npy":
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.save(stream, values, allow_pickle=False)
    elif to == "csv":
        what = facts.get("setting", f"{one.path}{f' in {one.unit}' if one.unit else ''}")
        header = f"{what}; a line is a row of the picture, the first on top"
        with atomic_path(path) as temporary:
            np.savetxt(temporary, values, delimiter=",", fmt="%.6g", header=header)
    else:
        low, high = (one.low, one.high) if settings is None else (float(settings.min()), float(settings.max()))
        unit = (values - low) / (high - low) if high > low else np.zeros_like(values)
        grey = np.round(LARGEST_GREY * np.clip(unit, 0.0, 1.0)).astype(np.uint16)
        facts |= {"black": low, "white": high, "is": f"black + (white - black) * grey / {LARGEST_GREY}"}
        (write_png16 if to == "png16" else write_tiff16)(path, grey, facts, pitch_um)


def _write_mask(
    one: NumberMap, path: Path, settings: Array | None, pitch_um: float, levels: int | None, facts: dict[str, Any]
) -> None:
    """Write a mask whose layer k contains the pixels with level k; few distinct values are levels."""
    steps = _distinct(one)
    if levels is not None or len(steps) > MAX_LEVELS:
        steps = np.linspace(one.low, one.high, levels or DEFAULT_LEVELS)
    index = np.abs(one.values[..., None] - steps).argmin(axis=-1).astype(np.int64)
    write_levels(path, index[::-1].T, pitch_um, notes=f"nacre {__version__}: {one.path}, {len(steps)} levels")
    facts |= {
        "level_values": steps.tolist(),
        "largest_rounding": float(np.abs(one.values - steps[index]).max()),
        "layer": "layer k holds the pixels whose value is level_values[k]",
    }
    if settings is not None:
        made = [float(np.mean(settings[index == k])) if (index == k).any() else None for k in range(len(steps))]
        facts["level_settings"] = made


def _distinct(one: NumberMap) -> Array:
    """Return a map's distinct values, merging those that differ only by rounding."""
    values = np.unique(one.values)
    if len(values) < 2:
        return values
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values) > SAME_LEVEL * (one.high - one.low)) + 1])
    return np.array([part.mean() for part in np.split(values, starts[1:])])


# Height fields as binary STL solids and 16-bit images.
#
# STL files lack a unit; the header states um. Images are written row by row, since a wafer may exceed the memory: 50 mm
# x 50 mm at 1.6 um are 31,250 x 31,250 pixels, 2 GB. Libraries write PNG only as a whole, hence the own PNG writer.

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
    sides = (np.s_[:, 0], np.s_[-1], np.s_[::-1, -1], np.s_[0, ::-1])
    parts += [_quads(np.stack([floor[side], top[side]], axis=1)) for side in sides]
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
        for first_row in range(0, rows, side):
            band[:] = 0
            for k in range(min(side, rows - first_row)):
                band[k, :columns] = next(source)
            for first_column in range(0, columns, side):
                yield band[:, first_column : first_column + side].copy()

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
