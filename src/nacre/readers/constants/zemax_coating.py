"""Zemax coating files (COATING.DAT): materials as `MATE NAME` and rows of um, n and the imaginary index.

Zemax writes n - ik: absorption is a negative imaginary index. Coatings, tapers and tables of other kinds are listed as
left out.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.columns import sorted_by_wavelength
from nacre.readers.constants.convert import checked
from nacre.readers.file_head import FileHead
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.text_table import load_text, number

KEYWORDS = ("MATE", "COAT", "TAPR", "TABL", "IDEAL", "IDEAL2", "ENCRYPTED", "ANGL", "WAVE")
MAX_BYTES = 100_000_000


def sniff(head: FileHead) -> float:
    """Return 0.9 for lines `MATE NAME` that rows of two or three numbers follow."""
    lines = [line.strip() for line in head.lines if line.strip() and not line.strip().startswith("!")]
    for line, after in zip(lines, lines[1:]):
        if re.fullmatch(r"(?i)mate\s+\S+.*", line) and all(number(word) is not None for word in after.split()[:2]):
            return 0.9
    return 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the optical constants of each material.

    Raises:
        NacreError: a row that is not two or three numbers, or impossible constants.
    """
    materials: dict[str, list[list[float]]] = {}
    others: list[str] = []
    current: list[list[float]] | None = None
    for place, line in enumerate(re.split(r"\r\n|\r|\n", load_text(path, MAX_BYTES)), start=1):
        words = line.partition("!")[0].split()
        if not words:
            continue
        keyword = words[0].upper()
        if keyword in KEYWORDS:
            current = None
            if keyword == "MATE" and len(words) > 1:
                if words[1] in materials:
                    raise NacreError(f'{path}: line {place}: material "{words[1]}" stands twice')
                current = materials.setdefault(words[1], [])
            elif keyword not in ("ANGL", "WAVE"):
                others.append(" ".join(words[:2]))
            continue
        if current is not None:
            row = [number(word) for word in words]
            if len(row) not in (2, 3) or any(value is None or not np.isfinite(value) for value in row):
                raise NacreError(f'{path}: line {place}: "{line.strip()[:40]}" is not wavelength, n and k')
            current.append([value for value in row if value is not None] + [0.0] * (3 - len(row)))
    left_out = (f"no materials: {', '.join(others)[:200]}",) if others else ()
    found = [_material(path, name, np.array(rows), left_out) for name, rows in materials.items() if rows]
    if not found:
        raise NacreError(f"{path}: holds no material (MATE) with rows of wavelength, n and k")
    return found


def _material(path: Path, name: str, table: np.ndarray, left_out: tuple[str, ...]) -> Measurement:
    nm, given = sorted_by_wavelength(path, 1e3 * table[:, 0], {"n": table[:, 1], "k": -table[:, 2]})
    assumed: list[str] = []
    n, k = checked(path, nm, given["n"], given["k"] + 0.0, assumed)
    data = {"wavelength_nm": nm, "n": n, "k": k}
    return Measurement(path, "zemax-coating", "constants", data, name, {}, tuple(assumed), left_out)
