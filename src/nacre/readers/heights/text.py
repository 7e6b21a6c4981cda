"""Heights as plain text: matrices, points, grids, and tables of nacre; line profiles are refused."""

from __future__ import annotations

import contextlib
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.heights import surface
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, POSSIBLE, FileHead

# CSV of heights that `nacre fabricate --to csv` writes: one period, a row of the file per x.

START = re.compile(r"# feature heights in um, row = x(?:; feature_um = (\S+))?$")


def sniff_nacre_heights(head: FileHead) -> float:
    """Return 1 for the first line that `nacre fabricate --to csv` writes."""
    return CERTAIN if head.lines and START.match(head.lines[0]) else 0.0


def read_nacre_heights(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the heights as a picture, x to the right and y upward.

    The feature size comes from the first line, from the description beside the file (`FILE.json`) or from the option
    `pitch_um`.

    Raises:
        NacreError: rows of different lengths.
        AmbiguousFileError: the feature size is unknown.
    """
    text = surface.whole_text(path)
    head, *rows = [line for line in text.splitlines() if line.strip()]
    stated = START.match(head)
    surface.check_unit(path, options, "um")
    feature_um: float | None = float(stated[1]) if stated and stated[1] else None
    if feature_um is None:
        with contextlib.suppress(OSError, ValueError, LookupError, TypeError):  # the description may be missing
            with path.with_name(path.name + ".json").open("rb") as file:
                feature_um = float(json.loads(file.read(1 << 20))["feature_um"])
    pitch = (feature_um, feature_um) if feature_um else surface.requested_pitch(path, options)
    return [surface.height_map(path, surface.matrix(rows, path).T[::-1], pitch, metadata={"is_period": True})]


# Text matrices of digital holographic microscopes: phase in radians with a factor to metres in the head.

SIZE = re.compile(r"\s*h\s*=\s*(\d+)\s+w\s*=\s*(\d+)\s*$")
FACTOR = re.compile(r"height conversion factor\s*\(->\s*(\w+)\)\s*=\s*(\S+)")


def sniff_holography(head: FileHead) -> float:
    """Return 1 for a first line with h and w, followed by the pixel size."""
    lines = head.lines[:4]
    return CERTAIN if len(lines) > 1 and SIZE.match(lines[0]) and "pixel size" in lines[1] else 0.0


def read_holography(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; h is the row count, w the column count."""
    text = surface.whole_text(path)
    lines = text.splitlines()
    size = SIZE.match(lines[0])
    assert size is not None
    head = [line for line in lines[1:6] if "=" in line]
    fields = dict(line.split("=", 1) for line in head)
    pitch = surface.quantity_um(fields["pixel size"])
    unit = fields.get("data unit", "").strip()
    factor = surface.length_um(unit)
    surface.check_unit(path, options, unit)
    if factor is None:
        match = next((m for line in head if (m := FACTOR.search(line))), None)
        named = surface.length_um(match[1]) if match else None
        if match is None or named is None:
            raise NacreError(f"{path}: gives heights in {unit or 'no unit'} without a factor to metres")
        factor = float(match[2]) * named
    values = surface.numbers("\n".join(lines[1 + len(head) :]) + "\n", path)
    heights = surface.shaped(values, (int(size[1]), int(size[2]))) * factor
    facts = {"unit_in_file": unit, "um_per_unit": factor}
    return [surface.height_map(path, heights, (pitch, pitch), metadata=facts)]


# Points x y z of a rectangular grid as text, in any order.

TOLERANCE = 1e-3  # deviation of grid positions, in steps
XYZ_HEADING = re.compile(
    r"^\W*x(_\w\w?)?\b[^\n]*?\by(_\w\w?)?\b[^\n]*?\b(z|h|height|höhe)(_\w\w?)?\b[^\n]*$", re.IGNORECASE
)
UNIT = re.compile(r"(?:[\[(/]\s*|_)((?:[nucm]?m)|µm|μm|Å|A)\b")


def _parts(text: str) -> tuple[str, list[str]]:
    """Return the heading, if there is one, and the rows."""
    lines = [line for line in text.splitlines() if line.strip()]
    heading = ""
    while lines and not re.match(r"\s*[-+.\d]", lines[0]):
        line = lines.pop(0)
        cells = re.split(r"[\s,;]+", line.strip(" \t#"))
        are_units = bool(heading) and len(cells) == 3 and all(surface.length_um(cell) is not None for cell in cells)
        # a unit line below the names
        heading = f"{heading} {' '.join(f'({cell})' for cell in cells)}" if are_units else line
    return heading, lines


def sniff_xyz(head: FileHead) -> float:
    """Return a fair confidence for three columns with a heading x, y, z or with two columns on a grid."""
    if b"\0" in head.data[:4096]:
        return 0.0
    heading, rows = _parts(surface.decoded(head.data))
    if heading and not XYZ_HEADING.match(heading):
        return 0.0
    rows = (rows[:-1] if len(head.data) < head.size else rows)[:4000]
    values = surface.numbers("\n".join(rows) + "\n", head.path)
    if len(rows) > 4 and len(rows[-1].replace(",", " ").split()) < 3:  # cut; `read` refuses it
        values, rows = values[: 3 * (len(rows) - 1)], rows[:-1]
    if len(rows) < 4 or values.size != 3 * len(rows):
        return 0.0
    if heading:
        return LIKELY
    # on a grid, one coordinate repeats along a row and the other from row to row
    least, most = sorted(len(x) / len(np.unique(x)) for x in values.reshape(-1, 3)[:, :2].T)
    return LIKELY if most > 1.5 and (least > 1.5 or len(head.data) < head.size) else 0.0


def read_xyz(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read points on a grid; missing ones are holes. Rows run along y, ascending.

    Raises:
        AmbiguousFileError: the file names no unit and none is given.
        NacreError: the points are on no grid.
    """
    text = surface.whole_text(path)
    heading, rows = _parts(text)
    values = surface.numbers("\n".join(rows) + "\n", path)
    if values.size != 3 * len(rows) or not rows:
        raise NacreError(f"{path}: its rows do not all hold x, y and z")
    x, y, z = values.reshape(-1, 3).T
    units = _units(heading)
    missing_units = [axis for axis, unit in zip("xyz", units, strict=True) if unit is None]
    if missing_units:
        requested = surface.requested_unit(path, options, " and ".join(missing_units))
        units = [unit or requested for unit in units]
    else:
        surface.check_unit(path, options, UNIT.findall(heading)[-1])
    column, columns, dx = _places(x, path)
    row, count, dy = _places(y, path)
    heights = np.full((count, columns), np.nan)
    if len(np.unique(row * columns + column)) != len(z):
        raise NacreError(f"{path}: gives a point of its grid twice")
    heights[row, column] = z
    if np.isnan(heights).mean() > 0.5:
        raise NacreError(f"{path}: its points are not grid: {len(z)} of {heights.size} nodes are given")
    missing = int(np.isnan(heights).sum())
    assumed = [f"{missing} of {heights.size} points of the grid are not in the file and are holes"] if missing else []
    x_unit, y_unit, z_unit = (unit or 1.0 for unit in units)
    heights *= z_unit
    return [
        surface.height_map(path, heights, (dx * x_unit, dy * y_unit), metadata={"rows": "y ascending"}, assumed=assumed)
    ]


def _units(heading: str) -> list[float | None]:
    """Return the unit of x, y and z in um, None where the heading states none."""
    units = [surface.length_um(unit) for unit in UNIT.findall(heading)]
    if len(units) == 3:
        return units
    cells = [cell for cell in re.split(r"[\t,;]+|\s{2,}", heading.strip()) if cell.strip()]
    matches = [UNIT.search(cell) for cell in cells] if len(cells) == 3 else [None] * 3
    return [surface.length_um(match[1]) if match else None for match in matches]


def _places(values: Array, path: Path) -> tuple[np.ndarray, int, float]:
    """Return each coordinate's place on a uniform axis, their number, and the step."""
    known = np.unique(values)
    if not np.all(np.isfinite(known)):
        raise NacreError(f"{path}: gives a position that is not finite")
    gaps = np.diff(known)
    step = float(np.median(gaps[gaps > 0.5 * gaps.max()])) if len(gaps) else 0.0
    if step <= 0:
        raise NacreError(f"{path}: holds a profile of {len(values)} points; heights are a map")
    exact = (values - known[0]) / step
    # the step from the whole length, so that rounded positions do not add up
    count = int(round(float(exact.max()))) + 1
    step = float(known[-1] - known[0]) / (count - 1)
    exact = (values - known[0]) / step
    places = np.round(exact).astype(np.int64)
    if np.abs(exact - places).max() > max(TOLERANCE * 50, TOLERANCE * count) or count > 65536:
        raise NacreError(f"{path}: its points are on no rectangular grid")
    return places, count, step


# A bare matrix of heights as text: no unit, no size; its first row and column may be coordinates.

LEAST_SIDE = 4
WIDE = 16  # columns from which a table without headings is more likely a map


def _rows(text: str) -> list[str]:
    rows = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("#", "%", "//"))]
    empty = [row.lstrip(" ")[:1] in ("\t", ",", ";") for row in rows[:2]]
    if empty == [True, False]:
        rows[0] = f"nan{rows[0]}"  # the corner of the coordinates
    return rows


def _coordinate_steps(values: Array) -> tuple[float, float] | None:
    """Return the steps of coordinates in the first row and the first column, or None if they are heights."""
    if min(values.shape) <= LEAST_SIDE:
        return None
    steps = [np.diff(line) for line in (values[0, 1:], values[1:, 0])]
    inner = [np.diff(line) for line in (values[1, 1:], values[1:, 1])]  # even in a plane, which has no coordinates
    is_even = [bool(one[0] != 0 and np.allclose(one, one[0], rtol=1e-3)) for one in (*steps, *inner)]
    return (abs(float(steps[0][0])), abs(float(steps[1][0]))) if is_even == [True, True, False, False] else None


def sniff_matrix(head: FileHead) -> float:
    """Return a low confidence for rows of equally many numbers, lower if the first column rises as an abscissa."""
    if b"\0" in head.data[:4096]:
        return 0.0
    rows = _rows(surface.decoded(head.data))[:9]
    is_cut = len(head.data) < head.size
    rows = rows[:-1] if is_cut and len(rows) < 9 and len(rows) > 1 else rows
    values = [surface.numbers(row + "\n", head.path) for row in rows]
    columns = len(values[0]) if values else 0
    is_long_row = is_cut and columns > 1000
    if columns < LEAST_SIDE or (len(values) < LEAST_SIDE and not is_long_row) or any(len(v) != columns for v in values):
        return 0.0
    first = np.diff([v[0] for v in values])
    rises = len(first) > 2 and bool(np.all(first > 0) or np.all(first < 0))
    rest = np.abs(np.stack(values)[:, 1:])
    is_abscissa = rises and np.ptp(first) < 0.5 * abs(first[0]) and min(v[0] for v in values) > np.nanmax(rest)
    if is_abscissa and columns < WIDE:
        return 0.0
    if columns >= WIDE:
        return 0.5 * POSSIBLE if is_abscissa else 2.0 * POSSIBLE
    # a table over a coordinate would have a monotonic column
    return 0.5 * POSSIBLE if rises else 1.5 * POSSIBLE


def read_matrix(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the matrix with the unit and the pitch of the options.

    Raises:
        AmbiguousFileError: one of them is not given.
    """
    text = surface.whole_text(path)
    rows = _rows(text)
    values = surface.matrix(rows, path)
    steps, factor = _coordinate_steps(values), surface.requested_unit(path, options)
    if steps is None:
        return [surface.height_map(path, values * factor, surface.requested_pitch(path, options))]
    remark = f"the first row and column are coordinates in steps of {steps[0]:g} and {steps[1]:g}"
    if options.pitch_um is None:
        raise AmbiguousFileError(f"{path}: {remark} without a unit; state the steps in um: pitch_um", "pitch_um")
    return [surface.height_map(path, values[1:, 1:] * factor, options.pitch_um, left_out=[remark])]


# Line profiles of stylus instruments, which are not height maps: recognised in order to be refused by name.

PROFILE_HEADING = re.compile(
    r"^\W*(x|lateral|distance|position|scan length|länge)[ _]*[\[(/]*(microns?|u?m|nm|mm|[µμ]m)?\W*[,;\t ]+\W*"
    r"(y\d?|z|height|raw|total profile|höhe|profile)\b[^,;\t]*$",
    re.IGNORECASE,
)
# Dektak, below its scan parameters: "Lateral um,Raw Micrometer,"
DEEPER = re.compile(
    r"^\W*(lateral|scan length)\b[^,;\t]{0,12}[,;\t]\W*(raw|total profile|profile|height)\b", re.IGNORECASE
)
THREE = re.compile(r"\s*[-+.\d]\S*[\s,;]+[-+.\d]\S*[\s,;]+[-+.\dN]\S*\s*$")  # points x y z
LARGEST_M = 0.01  # a length in metres below 1 cm: no abscissa of a spectrum begins at 0 and ends there


def sniff_profile(head: FileHead) -> float:
    """Return a medium confidence for lateral positions and heights under such a heading, or in metres from 0."""
    if b"\0" in head.data[:4096]:
        return 0.0
    lines = [line for line in surface.decoded(head.data).splitlines() if line.strip()]
    if lines and PROFILE_HEADING.match(lines[0]) and not THREE.match(lines[1] if len(lines) > 1 else ""):
        return LIKELY
    if any(DEEPER.match(line) for line in lines[1:100]):
        return LIKELY
    rows = lines[:200]
    values = surface.numbers("\n".join(rows) + "\n", head.path)
    if len(rows) < 10 or values.size != 2 * len(rows):
        return 0.0
    steps = np.diff(values[::2])
    is_even = steps.min() > 0 and np.ptp(steps) < 1e-2 * steps.mean()
    return LIKELY if is_even and values[0] == 0.0 and values[-2] < LARGEST_M else 0.0


def read_profile(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the profile.

    Raises:
        NacreError: always.
    """
    raise NacreError(f"{path}: is a line profile; nacre reads maps of heights: export the area scan, as .sdf or matrix")


# Grids of Surfer (DSAA text, DSBB and DSRB binary) and of Esri (ASCII): nodes, corners, and heights without units.
#
# Surfer's rows run upward from the lower left node, Esri's downward from the upper left cell. The layouts are those of
# the program's help ("Surfer 6 Text Grid", "Surfer 6 Binary Grid", "Surfer 7 Grid File Format").

BLANK = 1.70141e38  # Surfer's mark of a hole
_TEXT = re.compile(r"DSAA\s")
_ESRI = re.compile(r"\s*ncols\s+\d+\s+nrows\s+\d+", re.IGNORECASE)
_ESRI_HEAD = re.compile(r"\s*([A-Za-z_]+)\s+(\S+)[^\S\n]*\n")
_SECTION = struct.Struct("<4si")
_GRID = struct.Struct("<2i8d")


def sniff_grid(head: FileHead) -> float:
    """Return 1 for the four beginnings."""
    is_text = _TEXT.match(head.text) or _ESRI.match(head.text)
    return CERTAIN if is_text or head.data[:4] in (b"DSBB", b"DSRB") else 0.0


def read_grid(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; its unit must be given, and also applies to x and y without `pitch_um`."""
    data = path.read_bytes()
    layout = {b"DSAA": _surfer_text, b"DSBB": _surfer_6, b"DSRB": _surfer_7}.get(data[:4], _esri)
    heights, steps = layout(path, data)
    unit = surface.requested_unit(path, options)
    pitch = options.pitch_um or (steps[0] * unit, steps[1] * unit)
    assumed = () if options.pitch_um else ("x and y have the unit of the heights",)
    return [surface.height_map(path, heights * unit, pitch, assumed=assumed)]


def _steps(shape: tuple[int, int], x: tuple[float, float], y: tuple[float, float]) -> tuple[float, float]:
    return (x[1] - x[0]) / max(shape[1] - 1, 1), (y[1] - y[0]) / max(shape[0] - 1, 1)


def _upright(rows: NDArray[Any], blank: float = BLANK) -> NDArray[Any]:
    heights = rows.astype(float)[::-1]
    heights[heights >= 0.99 * blank if blank == BLANK else heights == blank] = np.nan
    return heights


def _surfer_text(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    values = surface.numbers(surface.decoded(data)[4:], path)
    shape = int(values[1]), int(values[0])
    return _upright(surface.shaped(values[8:], shape)), _steps(shape, (values[2], values[3]), (values[4], values[5]))


def _surfer_6(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    columns, rows, *ends = struct.unpack_from("<2h6d", data, 4)
    return _upright(surface.array(data, "<f4", (rows, columns), 56)), _steps(
        (rows, columns), (ends[0], ends[1]), (ends[2], ends[3])
    )


def _surfer_7(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    at, grid = 0, None
    while at + _SECTION.size <= len(data):
        tag, size = _SECTION.unpack_from(data, at)
        at += _SECTION.size
        if tag == b"GRID":
            grid = _GRID.unpack_from(data, at)
        if tag == b"DATA" and grid is not None:
            rows, columns, _, _, step_x, step_y, _, _, turn, blank = grid
            if turn != 0.0:
                raise NacreError(f"{path}: the grid is turned by {turn:g} degrees, which is not read")
            return _upright(surface.array(data, "<f8", (rows, columns), at), blank), (step_x, step_y)
        if size < 0:
            break
        at += size
    raise ValueError("a section GRID or DATA is missing")


def _esri(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    text, head = surface.decoded(data).replace("\r\n", "\n"), {}
    while line := _ESRI_HEAD.match(text):
        head[line[1].lower()], text = float(line[2]), text[line.end() :]
    heights = surface.shaped(surface.numbers(text, path), (int(head["nrows"]), int(head["ncols"])))
    heights[heights == head.get("nodata_value", -9999.0)] = np.nan
    step = head.get("cellsize")
    if step is None and not {"dx", "dy"} <= head.keys():
        raise ValueError("its head has no cellsize")
    return heights, (head["dx"], head["dy"]) if step is None else (step, step)
