"""Datacolor QTX (.qtx): reflectances of standards and batches as `STD_R=` or `BAT_R=` with their first wavelength."""

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

_SECTION = re.compile(r"^\[(?:STANDARD|BATCH)_DATA[^\]]*\]", re.IGNORECASE)


def sniff_qtx(head: FileHead) -> float:
    """Return 1 if a first section is named as in QTX."""
    return CERTAIN if any(_SECTION.match(line.strip()) for line in head.lines[:5]) else 0.0


def read_qtx(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one spectrum per standard and batch, in per cent.

    Raises:
        NacreError: a section without wavelengths, or another number of values than it states.
        AmbiguousFileError: transmittance or reflectance is not stated.
    """
    sections: list[dict[str, str]] = []
    for line in common.read_text(path).lines:
        if _SECTION.match(line.strip()):
            sections.append({})
        elif sections and (pair := re.match(r"\s*(?:STD|BAT)_(\w+)\s*=\s*(.*?)\s*$", line, re.IGNORECASE)):
            sections[-1][pair[1].upper()] = pair[2]
    found = []
    for place, section in enumerate(sections, start=1):
        name = section.get("NAME") or str(place)
        key = next((key for key in ("R", "T") if key in section), None)
        if key is None:
            raise AmbiguousFileError(f'{path}: "{name}" lacks R or T, a spectrum in per cent', "spectrum")
        values = [common.number(cell) for cell in re.split(r"[,;\s]+", section[key]) if cell]
        start, step = (common.number(section.get(word, "")) for word in ("REFLLOW", "REFLINTERVAL"))
        if start is None or not step or None in values:
            raise NacreError(f'{path}: "{name}" lacks REFLLOW or REFLINTERVAL, or {key} holds text')
        common.check_count(path, section.get("REFLPOINTS"), len(values), f'"{name}"')
        label = Label("reflectance" if key == "R" else "transmittance", 0.01)
        metadata = {word.lower(): section[word] for word in ("VIEWING", "DATETIME", "GLOSS") if section.get(word)}
        found.append(
            common.spectrum(
                path, "qtx", start + step * np.arange(len(values)), np.array(values, dtype=float), label, options,
                name=name, metadata=metadata, notes=Notes(),
            )
        )  # fmt: skip
    return common.choose(path, found, options)
