"""LI-COR LI-1800 `.PRN`: quoted lines `FILE:`, `REM:`, `LIMS:`, `INT:`, then wavelength and a factor."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes


def sniff(head: FileHead) -> float:
    """Return 1 if the preamble has the keys FILE, LIMS and INT."""
    keys = {match[1] for line in head.lines[:12] if (match := re.match(r'\s*"?(FILE|REM|LIMS|INT|DATE)\s*:', line))}
    return CERTAIN if {"FILE", "LIMS", "INT"} <= keys else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns between the stated limits.

    Raises:
        NacreError: fewer points than the limits and the interval state.
        AmbiguousFileError: the remark names no quantity.
    """
    text = common.read_text(path)
    found = common.blocks(text.lines, least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of two numbers")
    table = common.complete(path, found[0])
    metadata = {
        key.lower(): value.strip(' "') for key, value in common.key_values(text.lines[: found[0].start], ":").items()
    }
    limits = re.match(r"\s*([\d.]+)\s*-\s*([\d.]+)", metadata.get("lims", ""))
    interval = re.match(r"\s*([\d.]+)", metadata.get("int", ""))
    if limits and interval:
        count = round((float(limits[2]) - float(limits[1])) / float(interval[1])) + 1
        common.check_count(path, count, len(table), "LIMS with INT")
    label = common.option_label(path, options)
    notes = Notes()
    if label is None:
        named = next((label for word in metadata.get("rem", "").split() if (label := common.label_of(word))), None)
        if named is None or named.quantity not in ("reflectance", "transmittance", "absorptance"):
            size = common.typical(table[:, 0], table[:, 1])
            raise AmbiguousFileError(f"{path}: no quantity, values up to {size:.4g}", "quantity", common.QUANTITIES)
        label = Label(named.quantity, 1.0)
        notes.assumed.append(f'{named.quantity} as a factor, from the remark "{metadata["rem"]}"')
    return [
        common.spectrum(
            path, "licor-prn", table[:, 0], table[:, 1], label, options, name=metadata.get("file", ""),
            metadata=metadata, notes=notes,
        )
    ]  # fmt: skip
