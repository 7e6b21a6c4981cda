"""Goniometric measurements as CSV: theta_i, phi_i, theta_o, phi_o (degrees), wavelength (nm), value (1/sr)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nacre.bsdf.grids import direction
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.core.memory import check_memory
from nacre.recipe.delimited_text import decoded, headings, rows

COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o", "wavelength", "value")
MAX_BYTES = 1 << 30
GAPS = ("", "nan", "-", "--", "n/a", "na")  # cells without a measurement
MEMORY_FACTOR = 8  # memory per byte of a file: text, lines, cells
MAX_VALUE = 1e12  # far above any BSDF
ROUND_TRIP_DIGITS = 9  # preserve float32


@dataclass(frozen=True)
class GonioData:
    """A measurement on a grid of direction pairs.

    Attributes:
        angles_deg: `[pair, 4]`: theta_i, phi_i, theta_o, phi_o; theta above 90 is the other side.
        wavelengths_nm: `[wavelength]`, ascending.
        values: `[pair, wavelength]`, the BSDF in 1/sr, without the cosine.
    """

    angles_deg: Array
    wavelengths_nm: Array
    values: Array

    @property
    def wi(self) -> Array:
        """Unit vectors to the light, `[pair, 3]`."""
        return direction(*np.radians(self.angles_deg[:, :2].T))

    @property
    def wo(self) -> Array:
        """Unit vectors to the viewer, `[pair, 3]`."""
        return direction(*np.radians(self.angles_deg[:, 2:].T))


def write_gonio_csv(path: str | Path, data: GonioData, comment: str = "") -> None:
    """Write the measurement, one row per pair and wavelength; comment lines start with #.

    Raises:
        NacreError: the file cannot be written.
    """
    pairs, waves = data.values.shape
    table = np.empty((pairs * waves, 6))
    table[:, :4] = np.repeat(data.angles_deg, waves, axis=0)
    table[:, 4] = np.tile(data.wavelengths_nm, pairs)
    table[:, 5] = data.values.ravel()
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        for line in comment.splitlines():
            file.write(f"# {line}\n")
        file.write(",".join(COLUMNS) + "\n")
        np.savetxt(file, table, fmt=f"%.{ROUND_TRIP_DIGITS}g", delimiter=",")


def read_gonio_csv(path: str | Path) -> GonioData:
    """Read a measurement; the columns may have any order, additional ones are ignored.

    Every direction pair must be given at the same wavelengths.

    Raises:
        NacreError: the file is invalid; names the line.
    """
    names, table = read_table(path)
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise NacreError(f"{path}: column {missing[0]} is missing; a gonio CSV has {', '.join(COLUMNS)}")
    columns = table[:, [names.index(name) for name in COLUMNS]]
    if np.any(columns[:, 4] <= 0):
        raise NacreError(f"{path}: wavelength = {columns[:, 4].min():g} should be above 0 (nm)")
    for name, index in (("theta_i", 0), ("theta_o", 2)):
        bad = (columns[:, index] < 0) | (columns[:, index] > 180)
        if np.any(bad):
            raise NacreError(f"{path}: {name} = {columns[bad][0, index]:g} should lie in [0, 180] degrees")
    _check_plausible(path, columns)
    waves = np.unique(columns[:, 4])
    pairs, inverse = np.unique(columns[:, :4], axis=0, return_inverse=True)
    values = np.full((len(pairs), len(waves)), np.nan)
    place = (np.ravel(inverse), np.searchsorted(waves, columns[:, 4]))
    values[place] = columns[:, 5]
    if len(columns) != values.size or np.isnan(values).any():
        raise NacreError(
            f"{path}: has {len(columns)} rows for {len(pairs)} direction pairs and {len(waves)} wavelengths; "
            "every pair must be given once at every wavelength"
        )
    first = np.full(len(pairs), len(columns))
    np.minimum.at(first, np.ravel(inverse), np.arange(len(columns)))
    order = np.argsort(first)  # order of the file
    return GonioData(pairs[order], waves, values[order])


def _check_plausible(path: str | Path, columns: Array) -> None:
    """Refuse physically impossible data.

    Raises:
        NacreError: a negative or far too large BSDF, or angles in radians.
    """
    values, thetas, phis = columns[:, 5], columns[:, [0, 2]], columns[:, [1, 3]]
    if values.min() < 0:
        raise NacreError(f"{path}: value = {values.min():g} is below 0, which no BSDF is; set noise about 0 to 0")
    if values.max() > MAX_VALUE:
        raise NacreError(f"{path}: value = {values.max():g} is larger than any BSDF (1/sr)")
    widest = float(thetas.max())
    if 0.0 < widest <= np.pi / 2 * (1 + 1e-3) and np.abs(phis).max() <= 2 * np.pi * (1 + 1e-3):
        raise NacreError(
            f"{path}: no theta is above {widest:.4g} and no phi above {np.abs(phis).max():.4g}: these are radians; "
            "angles are in degrees"
        )


def read_table(path: str | Path, has_gaps: bool = False) -> tuple[list[str], Array]:
    """Read a table of numbers with headings (see `nacre.recipe.delimited_text`); # starts a comment.

    Args:
        has_gaps: whether cells may be empty (NaN).

    Returns:
        The headings in lower case with units after an underscore, and `[row, column]`.

    Raises:
        NacreError: the file is missing, too large, lacks header or rows, or has a cell that is not a finite number.
    """
    path = Path(path)
    try:
        if plain(path).stat().st_size > MAX_BYTES:
            raise NacreError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
        check_memory(MEMORY_FACTOR * float(path.stat().st_size), f"{path}: read as a table, it")
        lines = rows(decoded(path.read_bytes()))
    except UnicodeDecodeError:
        raise NacreError(f"{path}: is not text") from None
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    names = headings(next(lines, (0, [""]))[1])
    table = [_numbers(path, number, cells, len(names), has_gaps) for number, cells in lines]
    if not table:
        raise NacreError(f"{path}: holds no data; a header line and rows of numbers are needed")
    return names, np.array(table)


def _numbers(path: Path, line: int, cells: list[str], width: int, has_gaps: bool) -> list[float]:
    """Return a row's numbers."""
    if has_gaps:
        cells = [cell if cell.strip().lower() not in GAPS else "nan" for cell in cells]
        cells += ["nan"] * (width - len(cells))
    if len(cells) != width:
        raise NacreError(f"{path}: line {line} has {len(cells)} cells, the header has {width}")
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        numbers = []
    if not numbers or not all(math.isfinite(number) or (has_gaps and math.isnan(number)) for number in numbers):
        wrong = next(cell for cell in cells if not _is_finite(cell))
        raise NacreError(f'{path}: line {line}: "{wrong.strip()[:40]}" is not a finite number')
    return numbers


def _is_finite(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False
