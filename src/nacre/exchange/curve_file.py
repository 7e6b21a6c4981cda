"""Curves of a process as people write them: CSV of two columns, with headings and remarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.files import plain, why_unreadable


def read_curve(path: Path, what: str, columns: str, example: str = "") -> tuple[Array, tuple[str, str] | None]:
    """Read pairs of numbers, ascending by the first.

    Lines that start with a letter are headings, with # remarks; columns are parted by a comma or a semicolon.

    Args:
        path: the CSV.
        what: a noun for messages, such as "calibration curve".
        columns: the names of the columns, for messages.
        example: added to them where a line is none of them.

    Returns:
        `[point, 2]`, and the two words of the first heading before the numbers, or None.

    Raises:
        NacreError: it cannot be read, a line is no pair of numbers, or fewer than two are.
    """
    try:
        lines = plain(path).read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    except UnicodeDecodeError:
        raise NacreError(f"{path}: is not a {what}: it is not text") from None
    rows: list[tuple[float, float]] = []
    words: tuple[str, str] | None = None
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text or text[0] == "#":
            continue
        parts = [part.strip() for part in text.replace(";", ",").split(",")]
        if text[0].isalpha():
            words = (parts[0], parts[1]) if len(parts) == 2 and not rows else words
            continue
        try:
            first, second = (float(part) for part in parts)
        except ValueError:
            raise NacreError(f"{path}: line {number}: {text[:60]!r} is not '{columns}'{example}") from None
        rows.append((first, second))
    if len(rows) < 2:
        raise NacreError(f"{path}: a {what} needs at least two lines of {columns}")
    return np.array(sorted(rows)), words


def is_monotonic(table: Array) -> bool:
    """Whether the second column rises or falls all the way, and no first one stands twice."""
    step = np.diff(table[:, 1])
    return bool((np.diff(table[:, 0]) > 0).all() and ((step > 0).all() or (step < 0).all()))
