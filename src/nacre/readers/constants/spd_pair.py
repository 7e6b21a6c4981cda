"""Pairs of spectral files of Mitsuba and PBRT: `Au.eta.spd` with n and `Au.k.spd` with k over nm.

One file without the other is not a material: gold without k is a dielectric.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.columns import load_tables, sorted_by_wavelength
from nacre.readers.constants.convert import checked
from nacre.readers.file_head import FileHead
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.units import Floats

_NAME = re.compile(r"(.+)([._-])(eta|k)(\.spd)", re.IGNORECASE)


def sniff(head: FileHead) -> float:
    """Return 0.95 for text of two columns under a name that ends with eta.spd or k.spd."""
    if not _NAME.fullmatch(head.path.name) or not head.is_text:
        return 0.0
    lines = [line for line in head.lines[:-1] or head.lines if line.strip() and not line.lstrip().startswith("#")]
    return 0.95 if lines and all(len(line.split()) == 2 for line in lines) else 0.0


def other_of_pair(path: Path) -> Path | None:
    """Return the file that belongs to one of a pair, by its name."""
    match = _NAME.fullmatch(path.name)
    if match is None:
        return None
    return path.with_name(f"{match[1]}{match[2]}{'k' if match[3].lower() == 'eta' else 'eta'}{match[4]}")


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return n and k of both files.

    Raises:
        NacreError: the other file is missing, or its wavelengths differ.
    """
    match, other = _NAME.fullmatch(path.name), other_of_pair(path)
    if match is None or other is None:
        raise NacreError(f"{path}: a pair of files is named NAME.eta.spd and NAME.k.spd")
    is_n = match[3].lower() == "eta"
    if not other.is_file():
        has, lacks = ("n", "k") if is_n else ("k", "n")
        raise NacreError(f"{path}: holds {has} alone; {other.name}, with {lacks}, must stand beside it")
    (nm, mine), (other_nm, theirs) = _columns(path), _columns(other)
    if nm.shape != other_nm.shape or not np.allclose(nm, other_nm, rtol=1e-6):
        raise NacreError(f"{path}: {other.name} has other wavelengths; n and k belong to the same ones")
    assumed = ["the wavelengths are in nm, as Mitsuba and PBRT define"]
    n, k = checked(path, nm, *((mine, theirs) if is_n else (theirs, mine)), assumed)
    data = {"wavelength_nm": nm, "n": n, "k": k}
    return [
        Measurement(path, "spd-pair", "constants", data, match[1], {"files": [path.name, other.name]}, tuple(assumed))
    ]


def _columns(path: Path) -> tuple[Floats, Floats]:
    table = load_tables(path).tables[0]
    if table.width != 2:
        raise NacreError(f"{path}: has {table.width} columns; a .spd file has wavelength and value")
    nm, given = sorted_by_wavelength(path, table.column(0), {"value": table.column(1)})
    if not np.isfinite(nm).all() or not np.isfinite(given["value"]).all():
        raise NacreError(f"{path}: holds cells without a number")
    return nm, given["value"]
