"""Points x y z of a rectangular grid as text, in any order."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.heights.surface import asked_unit, check_end, decoded, height_map, length_um, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import LIKELY, FileHead

TOLERANCE = 1e-3  # of a step, for positions on a grid
HEADING = re.compile(
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
        are_units = bool(heading) and len(cells) == 3 and all(length_um(cell) is not None for cell in cells)
        # a unit line below the names
        heading = f"{heading} {' '.join(f'({cell})' for cell in cells)}" if are_units else line
    return heading, lines


def sniff(head: FileHead) -> float:
    """Return a fair confidence for three columns with a heading x, y, z or with two columns on a grid."""
    if b"\0" in head.data[:4096]:
        return 0.0
    heading, rows = _parts(decoded(head.data))
    if heading and not HEADING.match(heading):
        return 0.0
    rows = rows[:-1] if len(head.data) < head.size else rows
    try:
        values = numbers("\n".join(rows[:4000]) + "\n", head.path)
    except NacreError:
        return 0.0
    rows = rows[:4000]
    if len(rows) > 4 and len(rows[-1].replace(",", " ").split()) < 3:  # cut; `read` refuses it
        values, rows = values[: 3 * (len(rows) - 1)], rows[:-1]
    if len(rows) < 4 or values.size != 3 * len(rows):
        return 0.0
    if heading:
        return LIKELY
    x, y = values.reshape(-1, 3)[:, :2].T
    repeats = min(len(x) / len(np.unique(x)), len(y) / len(np.unique(y)))
    # on a grid, one coordinate repeats along a row and the other from row to row
    is_line = max(len(x) / len(np.unique(x)), len(y) / len(np.unique(y))) > 1.5 and (
        repeats > 1.5 or len(head.data) < head.size
    )
    return LIKELY if is_line else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read points on a grid; missing ones are holes. Rows run along y, ascending.

    Raises:
        AmbiguousFileError: the file names no unit and none is given.
        NacreError: the points are on no grid.
    """
    text = decoded(path.read_bytes())
    check_end(text, path)
    heading, rows = _parts(text)
    values = numbers("\n".join(rows) + "\n", path)
    if values.size != 3 * len(rows) or not rows:
        raise NacreError(f"{path}: its rows do not all hold x, y and z")
    x, y, z = values.reshape(-1, 3).T
    named = _units(heading)
    missing_units = [axis for axis, unit in zip("xyz", named, strict=True) if unit is None]
    asked = asked_unit(path, options, " and ".join(missing_units)) if missing_units else 1.0
    factors = [asked if unit is None else unit for unit in named]
    column, columns, dx = _places(x, path)
    row, count, dy = _places(y, path)
    heights = np.full((count, columns), np.nan)
    if len(np.unique(row * columns + column)) != len(z):
        raise NacreError(f"{path}: gives a point of its grid twice")
    heights[row, column] = z
    if np.isnan(heights).mean() > 0.5:
        raise NacreError(f"{path}: its points are no grid: {len(z)} of {heights.size} nodes are given")
    missing = int(np.isnan(heights).sum())
    assumed = [f"{missing} of {heights.size} points of the grid are not in the file and are holes"] if missing else []
    pitch = dx * factors[0], dy * factors[1]
    return [height_map(path, "xyz", heights * factors[2], pitch, metadata={"rows": "y ascending"}, assumed=assumed)]


def _units(heading: str) -> list[float | None]:
    """Return the unit of x, y and z in um, None where the heading states none."""
    found = [length_um(unit) for unit in UNIT.findall(heading)]
    cells = [cell for cell in re.split(r"[\t,;]+|\s{2,}", heading.strip()) if cell.strip()]
    if len(found) == 3 or len(cells) != 3:
        return found if len(found) == 3 else [None] * 3
    each = [UNIT.search(cell) for cell in cells]
    return [length_um(match[1]) if match else None for match in each]


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
