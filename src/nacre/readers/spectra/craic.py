"""CRAIC MicroSpec text: sample, quantity, settings, then wavelength and per cent of the reference."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

_SETTINGS = re.compile(r"SciMode\s*:|\bIT1\s*=.*\bObj\s*=")


def sniff(head: FileHead) -> float:
    """Return 1 if a quantity stands in the second line and the microscope's settings in the third."""
    lines = [line for line in head.lines[:8] if line.strip()]
    return CERTAIN if len(lines) > 3 and any(_SETTINGS.search(line) for line in lines[:4]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns; MicroSpec writes reflectance and transmittance in per cent."""
    text = common.read_text(path)
    found = common.blocks(text.lines, least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    head = [line.strip() for line in text.lines[: found[0].start] if line.strip()]
    label = next((label for line in head[1:3] if (label := common.label_of(line)) is not None), None)
    notes = Notes()
    nm, values = common.complete(path, found[0])[:, :2].T
    if label is None:
        label = common.by_size(path, nm, values, notes, "no quantity")
    elif label.quantity in ("reflectance", "transmittance"):
        label = Label(label.quantity, 0.01)
        notes.assumed.append(f"{label.quantity} in per cent, as the program writes it")
    settings = next((line for line in head if _SETTINGS.search(line)), "")
    metadata = {"settings": settings}
    return [
        common.spectrum(
            path, "craic-text", nm, values, label, options, name=head[0] if head else "", metadata=metadata, notes=notes
        )
    ]
