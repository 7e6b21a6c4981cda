"""Bruker data point tables `.dpt`: two columns with commas or tabs, without units and quantity."""

from __future__ import annotations

from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import LIKELY, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Notes


def sniff(head: FileHead) -> float:
    """Return 0.6 for two columns without a heading in a file `.dpt`."""
    if head.path.suffix.lower() != ".dpt" or not head.is_text:
        return 0.0
    rows = [common.numeric_row(line, common.delimiter(line)) for line in head.lines[:20] if line.strip()]
    return LIKELY if rows and all(row is not None and len(row) == 2 for row in rows) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns in the unit and quantity that the options state.

    Raises:
        AmbiguousFileError: unit or quantity is not stated; the program writes nm or 1/cm, R, T or absorbance.
    """
    text = common.read_text(path)
    found = common.blocks(text.lines, least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    table = common.complete(path, found[0])
    unit = common.option_unit(path, options)
    reach = f"{table[:, 0].min():g} to {table[:, 0].max():g}"
    if unit is None:
        raise AmbiguousFileError(f"{path}: no unit of the abscissa ({reach}) in a .dpt", "unit", ("nm", "1/cm", "um"))
    label = common.option_label(path, options)
    if label is None:
        size = common.typical(common.nanometres(table[:, 0], unit), table[:, 1])
        choices = ("reflectance", "transmittance", "absorbance", "counts")
        raise AmbiguousFileError(f"{path}: no quantity in a .dpt, values up to {size:.4g}", "quantity", choices)
    notes = Notes()
    return [common.spectrum(path, "bruker-dpt", table[:, 0], table[:, 1], label, options, unit=unit, notes=notes)]
