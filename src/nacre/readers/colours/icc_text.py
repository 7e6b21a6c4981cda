"""iccDEV apply data: a signature of the colour space, the encoding, and rows of numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.colours.common import colours
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra.common import blocks, read_text

_SIGNATURE = re.compile(r"\s*'(.{4,6})'\s*(?:;.*)?$")
_NAMES = {"Lab ": ("L", "a", "b"), "XYZ ": ("X", "Y", "Z")}


def sniff(head: FileHead) -> float:
    """Return 1 for a quoted signature above a line of the encoding (icEncode...)."""
    lines = [line for line in head.lines[:10] if line.strip()]
    is_signed = len(lines) > 1 and bool(_SIGNATURE.match(lines[0])) and lines[1].strip().startswith("icEncode")
    return CERTAIN if is_signed else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read L*a*b* or XYZ under D50, as ICC defines it.

    Raises:
        NacreError: spectra (the file states no wavelengths), device values, or another encoding.
    """
    lines = [line for line in read_text(path).lines if line.strip()]
    match = _SIGNATURE.match(lines[0])
    signature = match[1] if match else ""
    if re.fullmatch(r"[a-z]{2}[0-9a-fA-F]{4}", signature):
        raise NacreError(
            f"{path}: holds spectra of {int(signature[2:], 16)} samples, but no wavelengths; write a table of them"
        )
    if signature not in _NAMES:
        raise NacreError(f"{path}: holds '{signature}' only; L*a*b*, XYZ or spectra with wavelengths are needed")
    encoding = lines[1].split(";")[0].strip()
    if encoding not in ("icEncodeValue", "icEncodeFloat") or (encoding == "icEncodeFloat" and signature == "Lab "):
        raise NacreError(f"{path}: the encoding {encoding} is not read; allowed: icEncodeValue")
    found = blocks(lines[2:], least_rows=1, least_columns=3)
    if (
        len(found) != 1
        or found[0].table.shape[1] != 3
        or np.isnan(found[0].table).any()
        or found[0].stop < len(lines) - 2
    ):
        raise NacreError(f"{path}: should hold rows of three numbers below its two lines of format")
    scale = 100.0 if encoding == "icEncodeFloat" else 1.0
    data = {name: found[0].table[:, place] * scale for place, name in enumerate(_NAMES[signature])}
    names = [str(place) for place in range(1, len(found[0].table) + 1)]
    return [colours(path, "icc-text", names, data, assumed=["D50 and the observer 2deg, as ICC defines the space"],
                    illuminant="D50", observer="2deg")]  # fmt: skip
