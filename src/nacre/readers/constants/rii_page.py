"""Pages of the refractiveindex.info database (YAML) with tabulated n and k, in um.

Formulas are read where a material is needed: `material = {file = "page.yml"}`.
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
from nacre.readers.text_table import load_text
from nacre.readers.units import Floats

_TYPE = re.compile(r"^\s*-?\s*type:\s*[\"']?(tabulated (?:nk|n|k)|formula \d+)", re.MULTILINE)


def sniff(head: FileHead) -> float:
    """Return 0.95 for a `DATA:` list with `type: tabulated` or `type: formula`."""
    return 0.95 if re.search(r"^\s*DATA:", head.text, re.MULTILINE) and _TYPE.search(head.text) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return tabulated n and k.

    Raises:
        NacreError: a formula, k without n, or different wavelengths of n and k.
    """
    text = load_text(path, 20_000_000)
    places = [*_TYPE.finditer(text)]
    columns: dict[str, tuple[Floats, Floats]] = {}
    for match, after in zip(places, [*places[1:], None]):
        if match[1].startswith("formula"):
            said = 'use it as a material: {file = "' + path.name + '"}'
            raise NacreError(f"{path}: gives n by {match[1]} of refractiveindex.info, not as a table; {said}")
        rows = _rows(path, text[match.end() : after.start() if after else len(text)])
        for place, name in enumerate(match[1].split()[1], start=1):
            columns[name] = (1e3 * rows[:, 0], rows[:, place])
    if "n" not in columns:
        raise NacreError(f"{path}: holds k without n")
    nm, n = columns["n"]
    k = np.zeros_like(n)
    if "k" in columns:
        if not np.array_equal(columns["k"][0], nm):
            raise NacreError(f"{path}: n and k are for different wavelengths")
        k = columns["k"][1]
    nm, given = sorted_by_wavelength(path, nm, {"n": n, "k": k})
    assumed: list[str] = []
    n, k = checked(path, nm, given["n"], given["k"], assumed)
    data = {"wavelength_nm": nm, "n": n, "k": k}
    return [Measurement(path, "rii-page", "constants", data, path.stem, {}, tuple(assumed))]


def _rows(path: Path, text: str) -> Floats:
    _, mark, body = text.partition("|")
    rows = []
    for line in body.splitlines() if mark else []:
        words = line.split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            break
    if not rows or len({len(row) for row in rows}) != 1:
        raise NacreError(f"{path}: a table of its data has no rows of numbers")
    return np.array(rows)
