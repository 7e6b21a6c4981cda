"""Process and calibration curves from two-column CSV files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import plain, why_unreadable
from nacre.recipe.delimited_text import decoded, headings, rows

_UM_OF_UNIT = {"nm": 1e-3, "um": 1.0, "mm": 1e3}


def read_curve(
    path: Path, noun: str, columns: str, is_second: Callable[[str], bool], unit: str, example: str = ""
) -> tuple[Array, tuple[str, str] | None]:
    """Read pairs of numbers, sorted by the first.

    Cells are parted as `nacre.recipe.delimited_text` knows.
    Headings before the numbers may name the columns in reverse order; a length
    unit in the second heading is converted.

    Args:
        path: the CSV.
        noun: used in messages, such as "calibration curve".
        columns: names of the columns for messages.
        is_second: whether a heading from `headings` belongs to the second column.
        unit: "um" or "nm", for the second column.
        example: added to the column names in messages about invalid lines.

    Returns:
        `[point, 2]`, and the two headings, if there are any.

    Raises:
        NacreError: it cannot be read, a line is not a pair of numbers, or there are fewer than two pairs.
    """
    try:
        text = decoded(plain(path).read_bytes())
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    except UnicodeDecodeError:
        raise NacreError(f"{path}: is not a {noun}: it is not text") from None
    pairs: list[tuple[float, float]] = []
    cells_above: list[str] = []
    for number, cells in rows(text):
        try:
            first, second = (float(cell) for cell in cells)
        except ValueError:
            if not pairs and cells[0][:1].isalpha():
                cells_above = cells
                continue
            shown = " ".join(cells)[:60]
            raise NacreError(f"{path}: line {number}: {shown!r} is not '{columns}'{example}") from None
        pairs.append((first, second))
    if len(pairs) < 2:
        raise NacreError(f"{path}: a {noun} needs at least two lines of {columns}")
    table, words = np.array(pairs), None
    if len(cells_above) == 2:
        words, names = (cells_above[0], cells_above[1]), headings(cells_above)
        if is_second(names[0]) and not is_second(names[1]):
            table, words, names = table[:, ::-1], words[::-1], names[::-1]
        given = names[1].rpartition("_")[2]
        table = table * [1.0, _UM_OF_UNIT.get(given, _UM_OF_UNIT[unit]) / _UM_OF_UNIT[unit]]
    return table[np.lexsort((table[:, 1], table[:, 0]))], words


def is_monotonic(table: Array) -> bool:
    """Whether the first column has distinct values and the second is strictly monotonic."""
    step = np.diff(table[:, 1])
    return bool((np.diff(table[:, 0]) > 0).all() and ((step > 0).all() or (step < 0).all()))


# Calibration of grey-scale lithography: depth over grey value.

LARGEST_GREY = 65535
LARGEST_8_BIT = 255
STRETCH = LARGEST_GREY // LARGEST_8_BIT
PUBLISHED = "published"  # name of the built-in curve
LINEAR = "linear"


@dataclass(frozen=True)
class Calibration:
    """Depth below the resist surface over grey value, linear between the points.

    Attributes:
        grey: ascending, 0..65535.
        depth_um: strictly monotonic.
        name: "linear", "published" or the file's.
        stretched_from_8_bit: whether its grey values were below 256 and were stretched.
    """

    grey: Array
    depth_um: Array
    name: str = "given"
    stretched_from_8_bit: bool = False

    @property
    def nm_per_level(self) -> float:
        """Coarsest depth step between neighbouring grey values."""
        return float(1e3 * np.abs(np.diff(self.depth_um) / np.diff(self.grey)).max())

    @property
    def range_um(self) -> float:
        """Largest possible depth of a relief."""
        return float(self.depth_um.max() - self.depth_um.min())

    def grey_of(self, depth_um: Array) -> NDArray[np.uint16]:
        """Return the nearest grey values.

        Raises:
            NacreError: the curve does not cover the depths.
        """
        low, high = float(self.depth_um.min()), float(self.depth_um.max())
        slack = 0.5e-3 * self.nm_per_level
        if depth_um.min() < low - slack or depth_um.max() > high + slack:
            raise NacreError(
                f"the calibration curve covers depths {low:.3f}-{high:.3f} um, a range of {high - low:.3f} um; "
                f"the relief needs {depth_um.min():.3f}-{depth_um.max():.3f} um: give --calibration, the CSV of "
                f"your process, or design with height_max_um up to {np.floor(1e3 * (high - low)) / 1e3:g}"
            )
        order = np.argsort(self.depth_um)
        grey = np.interp(depth_um, self.depth_um[order], self.grey[order])
        return np.round(grey).astype(np.uint16)

    def depth_of(self, grey: NDArray[np.uint16]) -> Array:
        """Return the depths, um, that grey values expose to."""
        return np.asarray(np.interp(grey.astype(float), self.grey, self.depth_um))


# grey 201 to 989 gives depths 0.376 to 1.185 um: the published process
PUBLISHED_CALIBRATION = Calibration(np.array([201.0, 989.0]), np.array([0.376, 1.185]), PUBLISHED)


def linear_calibration(height_range_um: float) -> Calibration:
    """Return the linear default curve: 65,535 is the top, 0 the deepest point."""
    return Calibration(np.array([0.0, LARGEST_GREY]), np.array([height_range_um, 0.0]), LINEAR)


def find_calibration(name: str | Path, folder: Path = Path()) -> Calibration:
    """Return the built-in curve "published", or a curve from a CSV file.

    Raises:
        NacreError: as `read_calibration`.
    """
    return PUBLISHED_CALIBRATION if str(name) == PUBLISHED else read_calibration(folder / name)


def _is_depth(heading: str) -> bool:
    return heading.startswith("depth")


def read_calibration(path: str | Path) -> Calibration:
    """Read a two-column CSV: grey value (8 or 16 bits) and depth in um.

    Headings may name them in reverse order, and the depth in nm (`depth_nm`, `Depth (nm)`).

    Raises:
        NacreError: not readable, fewer than two points, grey values outside the range, or non-monotonic depths.
    """
    path = Path(path)
    table, _ = read_curve(path, "calibration curve", "grey value, depth in um", _is_depth, "um")
    if table[0, 0] < 0 or table[-1, 0] > LARGEST_GREY or not np.isfinite(table).all():
        raise NacreError(f"{path}: grey values must be from 0 to {LARGEST_GREY}, all numbers finite")
    if not is_monotonic(table):
        raise NacreError(f"{path}: the calibration curve is not monotonic; each grey value needs its own depth")
    is_8_bit = bool(table[-1, 0] <= LARGEST_8_BIT)
    return Calibration(table[:, 0] * (STRETCH if is_8_bit else 1.0), table[:, 1], path.name, is_8_bit)
