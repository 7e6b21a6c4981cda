"""Woollam material files (.mat): WVASE layers with `Begin of array`, and the short form of three lines.

WVASE: `Units=eV,E1E2` states the columns. Short form: a name, the unit, and `NK` or `E1E2`, then the rows.
"""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.columns import interpret, tables_of
from nacre.readers.constants.convert import constants
from nacre.readers.file_head import FileHead
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN
from nacre.readers.text_table import load_text
from nacre.readers.units import SPECTRAL, UNITS, parse_unit

QUANTITIES = {"NK": ("n", "k"), "E1E2": ("eps1", "eps2"), "N": ("n",)}
# layers whose parameters are no table of n and k
LAYERS = frozenset(
    "GENOSC EMA CAUCHY SELLMEIER LORENTZ BSPLINE B-SPLINE TAUC-LORENTZ CODY-LORENTZ GRADED BIAXIAL UNIAXIAL ALLOY "
    "SUPERLATTICE INTERMIX PARAMETRIC".split()
)
_UNITS = re.compile(r"^[^\S\n]*Units\s*=\s*([^,\s]+)\s*,\s*(\w+)", re.IGNORECASE | re.MULTILINE)
_BEGIN = re.compile(r"^[^\S\n]*Begin of array.*$", re.IGNORECASE | re.MULTILINE)


def sniff(head: FileHead) -> float:
    """Return 1 for a layer file with units and an array, the short form, or parameters."""
    is_known = (_UNITS.search(head.text) and _BEGIN.search(head.text)) or _short(head.lines) or _layer(head.lines)
    return CERTAIN if is_known else 0.0


def _layer(lines: list[str]) -> str:
    """Return the layer type in a parameter file: its second line; else ""."""
    word = lines[1].strip() if len(lines) > 2 else ""
    return word if word.upper() in LAYERS else ""


def _short(lines: list[str]) -> tuple[str, str] | None:
    """Return unit and quantities of the short form."""
    if len(lines) < 4 or lines[2].strip().upper() not in QUANTITIES:
        return None
    unit = parse_unit(lines[1].strip())
    return (unit, lines[2].strip().upper()) if unit is not None and UNITS[unit][0] in SPECTRAL else None


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the optical constants of one material.

    Raises:
        NacreError: the units are not known, or the rows have another column count.
    """
    text = load_text(path)
    stated, begin = _UNITS.search(text), _BEGIN.search(text)
    if stated and begin:
        unit, quantities = parse_unit(stated[1]), stated[2].upper()
        found = re.search(r"^\s*Name\s*=\s*(\S.*)$", text, re.MULTILINE)
        name, body = found[1].strip() if found else "", text[begin.end() :]
    else:
        lines = re.split(r"\r\n|\r|\n", text)
        if layer := _layer(lines):
            raise NacreError(
                f"{path}: is a layer of WVASE or CompleteEASE that holds the parameters of {layer}, not n and k; "
                "export its optical constants as a table there"
            )
        short = _short(lines)
        if short is None:
            raise NacreError(f"{path}: is no material file: units and columns are not stated")
        (unit, quantities), name, body = short, lines[0].strip(), "\n".join(lines[3:])
    if unit is None or UNITS[unit][0] not in SPECTRAL or quantities not in QUANTITIES:
        said = f"{stated[1]},{stated[2]}" if stated else quantities
        raise NacreError(f"{path}: Units = {said} is not known; allowed are nm, Angstroms, um or eV with NK or E1E2")
    tables = tables_of(body, path).tables
    names = (_heading(unit), *QUANTITIES[quantities])
    if len(tables) > 1 or tables[0].width < len(names):
        raise NacreError(f"{path}: has {tables[0].width} columns; {quantities} has {len(names)}")
    ignored = ("-",) * (tables[0].width - len(names))
    own = ReadOptions(columns=(*names, *ignored), unit=options.unit)
    columns = interpret(tables[0], (*names, "wavelength", "energy", "wavenumber"), own)
    nm = columns.spectral_nm(own)
    assert nm is not None
    return [constants(columns, own, nm, "woollam-mat", name)]


def _heading(unit: str) -> str:
    words = {"length": "wavelength", "energy": "energy", "wavenumber": "wavenumber"}
    return f"{words.get(UNITS[unit][0], 'frequency')} ({unit})"
