"""Process and calibration curves from two-column CSV files."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.columns import load_tables
from nacre.readers.curves import Axis, curve
from nacre.readers.headings import stated_unit
from nacre.readers.units import UNITS

GREY, DEPTH_UM = Axis("grey value", ("grey",)), Axis("depth (um)", ("depth",), "um")
logger = logging.getLogger("nacre")


def read_curve(
    path: Path, noun: str, second_unit: str, first: Axis | None = None, second: Axis | None = None
) -> tuple[Array, tuple[str, str] | None]:
    """Read pairs of numbers, sorted by the first.

    Headings before the numbers may name the columns in reverse order; a length unit in a heading is converted.

    Args:
        path: the table.
        noun: used in messages, such as "calibration curve".
        second_unit: "um" or "nm", of the second column.
        first, second: columns of the vocabulary; without them any two headings are taken, a length second.

    Returns:
        `[point, 2]`, and the two headings, if there are any.

    Raises:
        NacreError: it cannot be read, a line is not a pair of numbers, or there are fewer than two pairs.
    """
    if first is not None and second is not None:
        table, said = curve(path, (first, second))
        words = None
        for sentence in said:
            logger.warning("%s: %s", path, sentence)
    else:
        table, words = _any_pairs(path, second_unit)
    if len(table) < 2:
        raise NacreError(f"{path}: a {noun} needs at least two lines of two numbers")
    return table[np.lexsort((table[:, 1], table[:, 0]))], words


def _any_pairs(path: Path, second_unit: str) -> tuple[Array, tuple[str, str] | None]:
    """Return two columns of any headings; a column whose heading names a length is the second."""
    table = load_tables(path).tables[0]
    if table.width != 2:
        raise NacreError(f"{path}: line {table.lines[0]} has {table.width} cells; two columns are needed")
    pairs = np.stack([table.column(0), table.column(1)], axis=1)
    if not np.isfinite(pairs).all():
        line = table.lines[int(np.flatnonzero(~np.isfinite(pairs).all(axis=1))[0])]
        raise NacreError(f"{path}: line {line} holds no two finite numbers")
    if not table.headings:
        return pairs, None
    words = (table.headings[0], table.headings[1])
    units = [table.units[i] or (words[i] if words[i] in UNITS else stated_unit(words[i])) for i in (0, 1)]
    is_length = [unit in UNITS and UNITS[unit][0] == "length" for unit in units]
    if is_length[0] and not is_length[1]:
        pairs, words, units = pairs[:, ::-1], (words[1], words[0]), units[::-1]
    if units[1] in UNITS and UNITS[units[1]][0] == "length":
        pairs = pairs * [1.0, UNITS[units[1]][1] / UNITS[second_unit][1]]
    return pairs, words


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


def read_calibration(path: str | Path) -> Calibration:
    """Read a two-column CSV: grey value (8 or 16 bits) and depth in um.

    Headings may name them in reverse order, and the depth in nm (`depth_nm`, `Depth (nm)`).

    Raises:
        NacreError: not readable, fewer than two points, grey values outside the range, or non-monotonic depths.
    """
    path = Path(path)
    table, _ = read_curve(path, "calibration curve", "um", GREY, DEPTH_UM)
    if table[0, 0] < 0 or table[-1, 0] > LARGEST_GREY or not np.isfinite(table).all():
        raise NacreError(f"{path}: grey values must be from 0 to {LARGEST_GREY}, all numbers finite")
    if not is_monotonic(table):
        raise NacreError(f"{path}: the calibration curve is not monotonic; each grey value needs its own depth")
    is_8_bit = bool(table[-1, 0] <= LARGEST_8_BIT)
    return Calibration(table[:, 0] * (STRETCH if is_8_bit else 1.0), table[:, 1], path.name, is_8_bit)
