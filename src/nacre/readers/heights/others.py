"""Text files of other programs that hold heights, which are recognised in order to be refused by name."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

PROGRAMS = {
    "Shimadzu SPM": re.compile(r"\s*Shimadzu SPM File Format"),
    "Esri (ASCII grid)": re.compile(r"(?i)\s*ncols\s+\d+\s+nrows\s+\d+"),
}


def sniff(head: FileHead) -> float:
    """Return 1 for the first lines of one of the programs."""
    return CERTAIN if _program(head.text[:4000]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the file.

    Raises:
        NacreError: always.
    """
    program = _program(path.read_bytes()[:4000].decode("latin-1")) or "unknown"
    raise NacreError(
        f"{path}: is a height map of {program}, which is not read; export ISO 25178 .sdf, or Gwyddion's ASCII matrix"
    )


def _program(text: str) -> str | None:
    return next((name for name, pattern in PROGRAMS.items() if pattern.match(text.lstrip("\ufeff"))), None)
