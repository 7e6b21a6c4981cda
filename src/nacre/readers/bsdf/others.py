"""BSDF files of other programs, which are recognised in order to be refused by name."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

LENGTH = 8000  # characters that hold the angles of a head
PROGRAMS = {"LightTools (mesh of intensity)": re.compile(r"^[^\S\n]*SphereMesh:\s*\d", re.MULTILINE)}


def sniff(head: FileHead) -> float:
    """Return 1 for the first lines of one of the programs."""
    return CERTAIN if _program(head.text[:LENGTH]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the file.

    Raises:
        NacreError: always.
    """
    program = _program(path.read_bytes()[:LENGTH].decode("latin-1")) or "unknown"
    raise NacreError(
        f"{path}: is a BSDF of {program}, which is not read; export ASTM E1392 or the tabular form of Zemax"
    )


def _program(text: str) -> str | None:
    return next((name for name, pattern in PROGRAMS.items() if pattern.search(text)), None)
