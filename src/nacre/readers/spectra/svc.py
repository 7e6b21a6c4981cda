"""Spectra Vista `.sig`: keys, `data=`, then wavelength, radiances of reference and target, their ratio in per cent."""

from __future__ import annotations

from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes


def sniff(head: FileHead) -> float:
    """Return 1 for the first line of the format."""
    first = next((line for line in head.lines if line.strip()), "")
    return CERTAIN if "Spectra Vista SIG Data" in first else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the fourth column, target / reference.

    Raises:
        NacreError: no rows of four numbers after `data=`.
    """
    lines = common.read_text(path).lines
    begin = next((place for place, line in enumerate(lines) if line.strip().startswith("data=")), None)
    found = common.blocks(lines[begin + 1 :], least_columns=4) if begin is not None else []
    if not found or found[0].table.shape[1] != 4:
        raise NacreError(f"{path}: has no rows of wavelength, reference, target and ratio after data=")
    table = common.complete(path, found[0])
    metadata = common.key_values(lines[:begin], "=")
    notes = Notes(left_out=["the radiances of reference and target"])
    label = Label("reflectance", 0.01)
    return [
        common.spectrum(
            path, "svc-sig", table[:, 0], table[:, 3], label, options, name=metadata.get("name", ""),
            metadata=metadata, notes=notes,
        )
    ]  # fmt: skip
