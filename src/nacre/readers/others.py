"""Text files of other programs, which are recognised in order to be refused by name."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

LENGTH = 8000  # characters that hold a head
_BSDF = "export ASTM E1392 or the tabular BSDF of Zemax"
_HEIGHTS = "export ISO 25178 .sdf, or Gwyddion's ASCII matrix"
# pattern, what the file is, cure
PROGRAMS = (
    (r"(?m)^[^\S\n]*SphereMesh:\s*\d", "a BSDF of LightTools (mesh of intensity)", _BSDF),
    (r"(?m)^ABGF(?:_NAME)?\s+\S", "a list of ABg parameters of Zemax, without sampled values", _BSDF),
    (r"(?m)\A\s*IESNA|^TILT=(?:NONE|INCLUDE)\b", "a luminaire (IES LM-63), not a material",
     "a lamp's spectrum is read as a table"),
    (r"\A\s*Shimadzu SPM File Format", "a height map of Shimadzu SPM", _HEIGHTS),
    (r"(?i)\A\s*ncols\s+\d+\s+nrows\s+\d+", "a height map of Esri (ASCII grid)", _HEIGHTS),
    (r"\ADSAA\s", "a height map of Surfer (DSAA grid)", _HEIGHTS),
    (r"\A(?:ply\s+format|solid\b[^\n]*\n\s*facet)", "a mesh", "nacre render takes it with --shape"),
    (r"(?m)\A(?:CC[^\n]*\n)*NM .*\n(?:.*\n)*?CD [-+\d.]",
     "a glass catalogue of Zemax (.agf) with coefficients", "nacre indices search GLASS finds tabulated glasses"),
    (r"(?i)\A(?:.*\n){0,3}\s*energy\s*\(eV\)\W+delta\W+beta\s*\n", "delta and beta of X-rays (n = 1 - delta + i beta)",
     "constants of light are needed"),
    (r"\A.{0,60} vs\. Position\s*\n\s*X \(", "a map over a wafer by CompleteEASE, not of heights",
     "the data of one point are read"),
)  # fmt: skip


def sniff(head: FileHead) -> float:
    """Return 1 for the first lines that one of these programs writes."""
    return CERTAIN if _program(head.text[:LENGTH]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the file.

    Raises:
        NacreError: always.
    """
    what, cure = _program(path.read_bytes()[:LENGTH].decode("latin-1")) or ("of another program", _HEIGHTS)
    raise NacreError(f"{path}: is {what}, which is not read; {cure}")


def _program(text: str) -> tuple[str, str] | None:
    text = text.lstrip("\ufeff").removeprefix("ï»¿").replace("\r\n", "\n")
    return next(((what, cure) for pattern, what, cure in PROGRAMS if re.search(pattern, text)), None)
