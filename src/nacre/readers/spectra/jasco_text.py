"""JASCO Spectra Manager text: keys and values, `XYDATA`, rows, and a report in the system's language."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes


def sniff(head: FileHead) -> float:
    """Return 1 if the first line is the key TITLE and a line is XYDATA."""
    lines = [line.strip() for line in head.lines[:80]]
    is_titled = bool(lines) and bool(re.match(r"TITLE(\s|,|;|$)", lines[0]))
    return CERTAIN if is_titled and any(re.match(r"XYDATA\b", line) for line in lines) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the rows behind XYDATA; several columns of values are YUNITS, YUNITS2, ..."""
    text = common.read_text(path)
    begin = next(place for place, line in enumerate(text.lines) if re.match(r"XYDATA\b", line.strip()))
    records: dict[str, str] = {}
    for line in text.lines[:begin]:
        key, *rest = re.split(r"\t|,|;", line, maxsplit=1)
        records[key.strip().upper()] = rest[0].strip().strip('"') if rest else ""
    found = common.blocks(text.lines[begin + 1 :], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of numbers behind XYDATA")
    table = common.complete(path, found[0])
    common.check_count(path, records.get("NPOINTS"), len(table), "NPOINTS")
    unit = common.option_unit(path, options) or common.unit_named(records.get("XUNITS", ""))
    if unit is None:
        raise NacreError(f'{path}: XUNITS = "{records.get("XUNITS", "")}" is no unit of a spectrum')
    keys = ("ORIGIN", "OWNER", "DATE", "TIME", "SPECTROMETER/DATA SYSTEM", "DATA TYPE")
    metadata = {key.lower(): records[key] for key in keys if records.get(key)}
    nm = common.nanometres(table[:, 0], unit)
    spectra = []
    for column in range(1, table.shape[1]):
        units = records.get("YUNITS" if column == 1 else f"YUNITS{column}", "")
        label = common.label_of(units)
        notes = Notes(left_out=["the report below the data"] if begin + 1 + found[0].stop < len(text.lines) - 2 else [])
        if label is not None and label.quantity in ("reflectance", "transmittance") and label.factor is None:
            label = Label(label.quantity, 0.01)
            notes.assumed.append("per cent, as Spectra Manager writes reflectance and transmittance")
        if label is None:
            if column > 1:
                continue  # such as the voltage of the detector
            label = common.named_quantity(path, options, units, nm, table[:, column], notes)
        spectra.append(
            common.spectrum(
                path, "jasco-text", table[:, 0], table[:, column], label, options, unit=unit,
                name=records.get("TITLE", ""), metadata=metadata, notes=notes,
            )
        )  # fmt: skip
    return common.choose(path, spectra, options)
