"""The calibration of a grey-scale process: which grey value exposes to which depth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.files import plain

LARGEST_GREY = 65535


@dataclass(frozen=True)
class Calibration:
    """Depth under the resist's surface as a function of the grey value, linear between the points.

    Attributes:
        grey: ascending, 0..65535.
        depth_um: strictly monotonic, either way.
    """

    grey: Array
    depth_um: Array

    @property
    def nm_per_level(self) -> float:
        """Coarsest depth step between neighbouring grey values."""
        return float(1e3 * np.abs(np.diff(self.depth_um) / np.diff(self.grey)).max())

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
PUBLISHED_CALIBRATION = Calibration(np.array([201.0, 989.0]), np.array([0.376, 1.185]))


def read_calibration(path: str | Path) -> Calibration:
    """Read a CSV of two columns, grey value and depth in um; lines starting with a letter or # are headings.

    Raises:
        NacreError: not readable, fewer than two points, grey values out of range, or depths that are not monotonic.
    """
    path = Path(path)
    try:
        lines = plain(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise NacreError(f"{path}: cannot be read as a calibration curve: {error}") from None
    rows = []
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text or text[0] == "#" or text[0].isalpha():
            continue
        try:
            grey, depth = (float(part) for part in text.replace(";", ",").split(","))
        except ValueError:
            raise NacreError(f"{path}: line {number}: {text[:60]!r} is not 'grey value, depth in um'") from None
        rows.append((grey, depth))
    if len(rows) < 2:
        raise NacreError(f"{path}: a calibration curve needs at least two lines of grey value, depth in um")
    table = np.array(sorted(rows))
    if not np.isfinite(table).all() or table[0, 0] < 0 or table[-1, 0] > LARGEST_GREY:
        raise NacreError(f"{path}: grey values must be from 0 to {LARGEST_GREY}, all numbers finite")
    step = np.diff(table[:, 1])
    if (np.diff(table[:, 0]) <= 0).any() or not ((step > 0).all() or (step < 0).all()):
        raise NacreError(f"{path}: the calibration curve is not monotonic; each grey value needs its own depth")
    return Calibration(table[:, 0], table[:, 1])
