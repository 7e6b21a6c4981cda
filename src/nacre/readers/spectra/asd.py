"""ASD FieldSpec: ViewSpec text; the binary files are refused by name."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

_BINARY = re.compile(rb"(ASD|as[2-8])\0*", re.DOTALL)


def sniff(head: FileHead) -> float:
    """Return 1 for the prose of ViewSpec or the magic of the binary file."""
    if _BINARY.match(head.data) and not head.is_text:
        return CERTAIN
    prose = "\n".join(head.lines[:60])
    return CERTAIN if "ASD spectrum file" in prose or "Text conversion of header file" in prose else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the columns below the heading `Wavelength  name.asd`; the values are factors.

    Raises:
        NacreError: a binary file, or a file of raw counts or radiance.
    """
    with path.open("rb") as file:
        if _BINARY.match(file.read(8)):
            raise NacreError(f"{path}: is a binary file of ASD; export text (ViewSpec Pro: Process, ASCII export)")
    text = common.read_text(path)
    found = [block for block in common.blocks(text.lines, least_columns=2) if len(block.table) > 20]
    if not found:
        raise NacreError(f"{path}: has no table of a spectrum")
    block = found[0]
    prose = [line for line in text.lines[: block.start] if line.strip()]
    names = [cell for cell in re.split(r"\t", prose[-1]) if cell.strip()] if prose else []
    words = " ".join(prose[:-1]).lower()
    metadata: dict[str, str] = {}
    for key, pattern in (("instrument", r"instrument number was\s+(\S+)"), ("date", r"Spectrum saved:\s*(.+)"),
                         ("white_reference", r"white reference (?:taken )?(.+)")):  # fmt: skip
        match = next((match for line in prose if (match := re.search(pattern, line, re.IGNORECASE))), None)
        if match:
            metadata[key] = match[1].strip()
    kind = re.search(r"spectrum file is (radiance|irradiance) data", words)
    is_raw = "white reference" not in words and bool(re.search(r"raw data|raw dn|radiance", words))
    spectra = []
    for column in range(1, block.table.shape[1]):
        notes = Notes()
        values = common.complete(path, block)[:, column]
        label = Label("counts", 1.0) if is_raw else Label("reflectance", 1.0)
        size = common.typical(block.table[:, 0], values)
        if kind is not None:
            label = Label("irradiance", 1.0)
            notes.assumed.append(f"{kind[1]}, as the preamble states")
        elif size > 20:
            label = Label("counts", 1.0)
            notes.assumed.append(f"counts, because the values are up to {size:.4g}")
        elif not is_raw:
            notes.assumed.append("reflectance as a factor, as ViewSpec exports it")
        name = names[column].strip() if column < len(names) else ""
        spectra.append(
            common.spectrum(
                path, "asd-text", block.table[:, 0], values, label, options, name=name, metadata=metadata, notes=notes
            )
        )
    return common.choose(path, spectra, options)
