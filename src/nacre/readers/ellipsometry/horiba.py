"""Text (.spe) of the ellipsometers by Horiba Jobin Yvon (DeltaPsi).

Sections begin with `# NAME:` and end with an empty line: `INCIDENCE ANGLE` holds the angle, `DATA` a heading and rows.
Columns are nm or eV, then Psi and Delta in degrees, or Is = sin 2Psi sin Delta and Ic = sin 2Psi cos Delta.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import UNITS, ellipsometry, numbers, same_length, text_lines, to_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead

MAKER = "DeltaPsi"
SECTION = re.compile(r"^#\s*([^:]+?)\s*:?\s*$")
NAMES = {"psi": "psi_deg", "delta": "delta_deg", "is": "ncs_s", "ic": "ncs_c"}
MUELLER = re.compile(r"m([1-4])([1-4])$")


def sniff(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    found = {match[1].upper() for line in head.lines[:400] if (match := SECTION.match(line))}
    if "DATA" not in found:
        return 0.0
    return CERTAIN if "INCIDENCE ANGLE" in found else LIKELY if head.path.suffix.lower() == ".spe" else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta, or C and S.

    Raises:
        NacreError: no unit, or columns without Psi and Delta.
        AmbiguousFileError: no angle.
    """
    sections: dict[str, list[tuple[int, str]]] = {}
    name = ""
    for number, line in enumerate(text_lines(path), 1):
        match = SECTION.match(line)
        if match:
            name = match[1].upper()
            sections.setdefault(name, [])
        elif line.strip() and name:
            sections[name].append((number, line.strip()))
    body = sections.get("DATA", [])
    if len(body) < 2:
        raise NacreError(f"{path}: the section DATA holds no rows")
    heading = [word.lower() for word in body[0][1].split()]
    if heading[0] not in UNITS:
        raise NacreError(f"{path}: the first column {heading[0]!r} is not a wavelength in a known unit")
    rows = []
    for number, line in body[1:]:
        row = numbers(line)
        if row is None:
            raise NacreError(f"{path}: line {number} is not a row of numbers: {line[:60]!r}")
        rows.append((number, row))
    table = same_length(path, rows)
    if table.shape[1] != len(heading):
        raise NacreError(f"{path}: the heading names {len(heading)} columns, the rows have {table.shape[1]}")
    columns = {"wavelength_nm": to_nm(table[:, 0], options.unit or heading[0], str(path))}
    left_out = []
    for i, word in enumerate(heading[1:], 1):
        key = NAMES.get(word, word if MUELLER.match(word) else None)
        if key is None:
            left_out.append(f"column {word}")
        else:
            columns[key] = table[:, i]
    if not {"psi_deg", "delta_deg"} <= set(columns) and not {"ncs_c", "ncs_s"} <= set(columns) and "m12" not in columns:
        raise NacreError(f"{path}: has neither Psi and Delta nor Is and Ic; its columns are {', '.join(heading)}")
    said = " ".join(line for _, line in sections.get("INCIDENCE ANGLE", []))
    angle = re.search(r"-?\d+(?:[.,]\d+)?", said)
    if angle:
        columns["angle_of_incidence_deg"] = np.full(len(table), float(angle[0].replace(",", ".")))
    metadata = {key.lower(): " ".join(text for _, text in part) for key, part in sections.items() if key != "DATA"}
    return [ellipsometry(path, "horiba", columns, options, maker=MAKER, metadata=metadata, left_out=left_out)]
