"""Woollam text of reflected and transmitted intensity: rows led by uR, uT, pR, sR, pT or sT."""

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

_ROW = re.compile(r"\s*([ups])([RT])(?:b|f)?\s+[-\d.]")
_OTHER_ROW = re.compile(r"\s*(?:(?:E|dPolE|dpolE|Em|AnE|mm[1-4]{2})\s+[-\d.]|[-\d.]+(?:\s+[-+\d.eE]+){3,}\s*$)")
POLARISATIONS = {"u": "unpolarised", "p": "p", "s": "s"}
QUANTITIES = {"R": "reflectance", "T": "transmittance"}


def sniff_woollam_intensity(head: FileHead) -> float:
    """Return 1 if the first rows of data are led by uR, uT, ...; Psi and Delta rows make it another format."""
    lines = [line for line in head.lines if line.strip()]
    if any(_OTHER_ROW.match(line) for line in lines):
        return 0.0
    return CERTAIN if sum(bool(_ROW.match(line)) for line in lines[:20]) >= 2 else 0.0


def read_woollam_intensity(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one spectrum for each quantity, polarisation and angle: wavelength, angle, value, standard error."""
    text = common.read_text(path)
    first = next(place for place, line in enumerate(text.lines) if _ROW.match(line))
    short = [line for line in text.lines[:first] if len(line.strip()) < 16]
    unit = next((unit for line in reversed(short) if (unit := common.unit_named(line))), None)
    groups: dict[tuple[str, str, float], list[list[float]]] = {}
    for line in text.lines[first:]:
        words = line.split()
        if not words:
            continue
        if not _ROW.match(line):
            raise NacreError(f'{path}: "{line.strip()[:40]}" is no row of reflected or transmitted intensity')
        values = [common.number(word) for word in words[1:5]]
        if len(values) < 3 or any(value is None for value in values):
            raise NacreError(f'{path}: "{line.strip()[:60]}" lacks numbers; the file is cut or damaged')
        row = [value for value in values if value is not None]
        groups.setdefault((words[0][1], words[0][0], row[1]), []).append([*row, *[float("nan")] * (4 - len(row))])
    notes = Notes()
    if unit is None:
        unit = common.assumed_unit(path, np.array([row[0] for rows in groups.values() for row in rows]), notes, options)
    found = []
    for (quantity, polarisation, angle), rows in groups.items():
        table = np.array(rows)
        error = table[:, 3] if np.isfinite(table[:, 3]).all() else None
        metadata = {"polarisation": POLARISATIONS[polarisation], "angle_of_incidence_deg": angle}
        own = Notes(list(notes.assumed))
        found.append(
            common.spectrum(
                path, "woollam-intensity", table[:, 0], table[:, 2], Label(QUANTITIES[quantity], 1.0), options,
                unit=unit, name=f"{polarisation}{quantity} {angle:g} deg", metadata=metadata, notes=own, error=error,
                more={"angle_of_incidence_deg": table[:, 1]},
            )
        )  # fmt: skip
    return common.choose(path, found, options)
