"""A bare matrix of heights as text: no unit, no size; its first row and column may be coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.heights.surface import (
    asked_pitch,
    asked_unit,
    check_end,
    check_shape,
    decoded,
    height_map,
    numbers,
    reads,
)
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import POSSIBLE, FileHead

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


def sniff(head: FileHead) -> float:
    """Return a low confidence for rows of equally many numbers, lower if the first column rises as an abscissa."""
    if b"\0" in head.data[:4096]:
        return 0.0
    rows = _rows(decoded(head.data))[:9]
    is_cut = len(head.data) < head.size
    rows = rows[:-1] if is_cut and len(rows) < 9 and len(rows) > 1 else rows
    try:
        values = [numbers(row + "\n", head.path) for row in rows]
    except NacreError:
        return 0.0
    columns = len(values[0]) if values else 0
    is_long_row = is_cut and columns > 1000
    if columns < LEAST_SIDE or (len(values) < LEAST_SIDE and not is_long_row):
        return 0.0
    if any(len(v) != columns for v in values):
        return 0.0
    first = np.diff([v[0] for v in values])
    rises = len(first) > 2 and bool(np.all(first > 0) or np.all(first < 0))
    rest = np.abs(np.stack(values)[:, 1:])
    is_abscissa = rises and np.ptp(first) < 0.5 * abs(first[0]) and min(v[0] for v in values) > np.nanmax(rest)
    if is_abscissa and columns < WIDE:
        return 0.0
    if columns >= WIDE:
        return 0.5 * POSSIBLE if is_abscissa else 2.0 * POSSIBLE
    # without a column that rises or falls the numbers are no table over a coordinate
    return 0.5 * POSSIBLE if rises else 1.5 * POSSIBLE


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the matrix with the unit and the pitch of the options.

    Raises:
        AmbiguousFileError: one of them is not given.
    """
    text = decoded(path.read_bytes())
    check_end(text, path)
    rows = _rows(text)
    columns = len(numbers(rows[0] + "\n" if rows else "", path))
    values = numbers("\n".join(rows) + "\n", path)
    if not columns or values.size != columns * len(rows):
        raise NacreError(f"{path}: its rows hold different numbers of heights")
    check_shape((len(rows), columns))
    values = values.reshape(len(rows), columns)
    steps, factor = _coordinate_steps(values), asked_unit(path, options)
    if steps is None:
        return [height_map(path, "matrix", values * factor, asked_pitch(path, options))]
    said = f"the first row and column are coordinates in steps of {steps[0]:g} and {steps[1]:g}"
    if options.pitch_um is None:
        raise AmbiguousFileError(f"{path}: {said} without a unit; state the steps in um: pitch_um", "pitch_um")
    return [height_map(path, "matrix", values[1:, 1:] * factor, options.pitch_um, left_out=[said])]
