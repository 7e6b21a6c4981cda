"""Optical constants of the SOPRA database (.MAT): `DATA1*number*abscissa*n*k*` between `POINTS*` and `EOF*`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.columns import sorted_by_wavelength
from nacre.readers.constants.convert import checked
from nacre.readers.file_head import FileHead
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.text_table import load_text


def sniff(head: FileHead) -> float:
    """Return 1 for `VERSION*` in the first line and rows of DATA1."""
    lines = [line.strip() for line in head.lines[:20] if line.strip()]
    return 1.0 if lines and lines[0].startswith("VERSION*") and any(s.startswith("DATA1*") for s in lines) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read n and k over the wavelength in nm.

    Raises:
        NacreError: a row is damaged, the row count is not POINTS, or the numbers are no wavelengths, n and k.
    """
    rows: list[list[float]] = []
    points = ""
    for count, line in enumerate(load_text(path, 20_000_000).splitlines(), start=1):
        cells = [cell.strip() for cell in line.strip().split("*")]
        if cells[0] == "POINTS" and len(cells) > 1:
            points = cells[1]
        elif cells[0] == "DATA1":
            try:
                rows.append([float(cell) for cell in cells[2:5]])
            except ValueError:
                raise NacreError(f"{path}: line {count} is no row of a wavelength, n and k") from None
    if points.isdigit() and int(points) != len(rows):
        raise NacreError(f"{path}: POINTS = {points}, and {len(rows)} rows are there")
    if not rows or any(len(row) != 3 for row in rows):
        raise NacreError(f"{path}: the rows of DATA1 have no wavelength, n and k")
    table = np.array(rows)
    if table[:, 0].min() < 1.0:
        raise NacreError(f"{path}: an abscissa of {table[:, 0].min():g} is no wavelength in nm")
    nm, given = sorted_by_wavelength(path, table[:, 0], {"n": table[:, 1], "k": table[:, 2]})
    assumed: list[str] = ["the wavelengths are in nm, as in the database of SOPRA"]
    n, k = checked(path, nm, given["n"], given["k"], assumed)
    data = {"wavelength_nm": nm, "n": n, "k": k}
    return [Measurement(path, "sopra", "constants", data, path.stem, {}, tuple(assumed))]
