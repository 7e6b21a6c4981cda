"""PerkinElmer UV WinLab ASCII (`PE UV ... PEDS 4.00`) and its CSV with `# DataSet...` remarks."""

from __future__ import annotations

from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Notes

PLACES = {"instrument": 11, "serial_number": 12, "date": 3, "program": 13}  # lines of the preamble


def sniff(head: FileHead) -> float:
    """Return 1 for the first line `PE ... PEDS`, or remarks `# DataSet...`."""
    first = head.lines[0].strip() if head.lines else ""
    is_ascii = first.startswith("PE ") and "PEDS" in first
    return CERTAIN if is_ascii or any(line.startswith("# DataSetXAxisLabel") for line in head.lines[:200]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the rows behind #DATA with the units below #GR, or the rows of the CSV with the labels of its remarks."""
    text = common.read_text(path)
    lines = [line.strip() for line in text.lines]
    if lines[0].startswith("PE "):
        x_label, y_label, stated, begin, metadata = _preamble(path, lines)
    else:
        about = {key.lower(): value for key, value in common.key_values(lines[:300], "=").items()}
        wanted = ("# DataSetXAxisLabel", "# DataSetYAxisLabel", "# DataSetNumPoints")
        x_label, y_label, stated = (
            next((line.partition("=")[2].strip() for line in lines if line.startswith(key)), "") for key in wanted
        )
        begin = max(place for place, line in enumerate(lines) if line.startswith("#")) + 1
        metadata = {key: value for key, value in about.items() if not key.startswith("dataset")}
    found = common.blocks(text.lines[begin:], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of numbers")
    table = common.complete(path, found[0])
    common.check_count(path, stated, len(table), "the preamble")
    unit = common.unit_named(x_label)
    if unit is None:
        raise NacreError(f'{path}: "{x_label}" is no unit of a spectrum')
    notes = Notes()
    label = common.named_quantity(path, options, y_label, common.nanometres(table[:, 0], unit), table[:, 1], notes)
    return [
        common.spectrum(
            path,
            "perkinelmer-text",
            table[:, 0],
            table[:, 1],
            label,
            options,
            unit=unit,
            metadata=metadata,
            notes=notes,
        )
    ]


def _preamble(path: Path, lines: list[str]) -> tuple[str, str, str, int, dict[str, str]]:
    """Return units of x and y, point count, first line of the data, and metadata.

    The lines below #GR are: unit of x, unit of y, scale, offset, first x, interval, point count.
    """
    if "#GR" not in lines or "#DATA" not in lines:
        raise NacreError(f"{path}: PerkinElmer ASCII without #GR or #DATA; the file is cut")
    at, begin = lines.index("#GR"), lines.index("#DATA") + 1
    below = lines[at + 1 : at + 8]
    metadata = {key: lines[place] for key, place in PLACES.items() if place < len(lines) and lines[place]}
    return below[0], below[1], below[6] if len(below) > 6 else "", begin, metadata
