"""Avantes AvaSoft text: a heading, a unit line, and cells with semicolons (or tabs)."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

_UNITS = re.compile(r"^\s*\[nm\]\s*[;\t,]")
_PREAMBLE = re.compile(r"averag|spectrometer|smooth|avasoft|spectrom|mittel|moyenn|promed", re.IGNORECASE)
_ROLES = (("sample", r"sampl|scope|mess|échant|muestr|campion"), ("dark", r"dark|dunkel|noir|oscur"),
          ("reference", r"ref(?!l)|réf(?!l)|white"))  # fmt: skip


def sniff(head: FileHead) -> float:
    """Return 1 if a unit line begins with `[nm];` below AvaSoft's own heading or preamble."""
    lines = [line.replace("\0", "") for line in head.lines[:60]]
    place = next((number for number, line in enumerate(lines) if _UNITS.match(line)), None)
    if place is None:
        return 0.0
    is_named = place > 0 and re.match(r"\s*wave\s*[;\t,]", lines[place - 1].lower()) is not None
    return CERTAIN if is_named or any(_PREAMBLE.search(line) for line in lines[:place]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the last column; columns of counts alone give (sample - dark) / (reference - dark)."""
    text = common.read_text(path)
    lines = text.lines
    place = next(number for number, line in enumerate(lines) if _UNITS.match(line))
    mark = ";" if ";" in lines[place] else "\t" if "\t" in lines[place] else ","
    units = [cell.strip() for cell in lines[place].split(mark)]
    names = [cell.strip() for cell in lines[place - 1].split(mark)] if place else []
    found = common.blocks(lines[place + 1 :], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of numbers below {lines[place].strip()[:60]}")
    table = common.complete(path, found[0])
    if len(units) > table.shape[1]:
        raise NacreError(f"{path}: its heading has {len(units)} columns and its rows have {table.shape[1]}")
    names += [""] * (len(units) - len(names))
    notes = Notes()
    if found[0].ragged:
        raise NacreError(
            f"{path}: {found[0].ragged} rows have fewer cells than the heading; the file is cut or damaged"
        )
    metadata = common.key_values([line for line in lines[: place - 1] if line.strip()], ":")
    counts = _counts(names, units, table)
    label = common.option_label(path, options) or _label(path, names[-1], units[-1], table, options, notes)
    values = table[:, len(units) - 1]
    if label.quantity == "counts" and {"sample", "dark", "reference"} <= set(counts) and options.quantity is None:
        values = 100.0 * common.ratio(counts["sample"], counts["dark"], counts["reference"])
        label = Label("reflectance", 0.01)
        notes.assumed.append("reflectance = (sample - dark) / (reference - dark)")
    same = [place for place in range(1, len(units)) if (names[place], units[place]) == (names[-1], units[-1])]
    if len(same) > 1 and names[-1]:  # one column a measurement
        spectra = [
            common.spectrum(
                path, "avantes-text", table[:, 0], table[:, place], label, options, name=f"{names[place]} {count}",
                metadata=metadata, notes=Notes(list(notes.assumed), list(notes.left_out)),
            )
            for count, place in enumerate(same, start=1)
        ]  # fmt: skip
        return common.choose(path, spectra, options)
    more = {f"{role}_counts": column for role, column in counts.items()} if label.quantity != "counts" else None
    return [
        common.spectrum(
            path, "avantes-text", table[:, 0], values, label, options, metadata=metadata, notes=notes, more=more
        )
    ]


def _counts(names: list[str], units: list[str], table: Array) -> dict[str, Array]:
    """Return the columns of counts by role."""
    found: dict[str, Array] = {}
    for place, (name, unit) in enumerate(zip(names, units, strict=False)):
        role = next((role for role, pattern in _ROLES if re.search(pattern, name.lower())), None)
        if role and "%" not in unit and 0 < place < table.shape[1]:
            found.setdefault(role, table[:, place])
    return found


def _label(path: Path, name: str, unit: str, table: Array, options: ReadOptions, notes: Notes) -> Label:
    label = common.label_of(name) or common.label_of(unit.strip("[]"))
    is_per_cent = "%" in unit
    if label is not None and label.quantity in ("reflectance", "transmittance"):
        return Label(label.quantity, 0.01 if is_per_cent else label.factor)
    if label is not None and not is_per_cent:
        return label
    if is_per_cent:
        notes.assumed.append(f'"{name}" in per cent is a reflectance')
        return Label("reflectance", 0.01)
    return common.named_quantity(path, options, name, table[:, 0], table[:, -1], notes)
