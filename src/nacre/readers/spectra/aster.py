"""ASTER and ECOSTRESS spectral libraries: text whose preamble states `X Units:` and `Y Units:`."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Notes

_KEY = re.compile(r"\s*([XY])\s*Units\s*:\s*(.+)", re.IGNORECASE)


def sniff(head: FileHead) -> float:
    """Return 1 if lines `X Units:` and `Y Units:` precede the numbers."""
    keys = {match[1].upper() for line in head.lines[:120] if (match := _KEY.match(line))}
    return CERTAIN if keys == {"X", "Y"} else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns in the stated units."""
    text = common.read_text(path)
    units = {match[1].upper(): match[2].strip() for line in text.lines[:200] if (match := _KEY.match(line))}
    last = max(place for place, line in enumerate(text.lines[:200]) if _KEY.match(line))
    found = common.blocks(text.lines[last + 1 :], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    table = common.complete(path, max(found, key=lambda block: len(block.table)))
    metadata = common.key_values(text.lines[:last], ":")
    stated = next(
        (value for key, value in metadata.items() if key.lower() in ("number of x values", "number of points")), None
    )
    common.check_count(path, stated, len(table), "the preamble")
    notes = Notes()
    unit = common.option_unit(path, options) or common.unit_named(units["X"])
    if unit is None:
        raise NacreError(f'{path}: X Units = "{units["X"]}" is no unit of a spectrum')
    nm = common.nanometres(table[:, 0], unit)
    label = common.named_quantity(path, options, units["Y"], nm, table[:, 1], notes)
    return [
        common.spectrum(
            path, "aster", table[:, 0], table[:, 1], label, options, unit=unit, name=metadata.get("Name", ""),
            metadata=metadata, notes=notes,
        )
    ]  # fmt: skip
