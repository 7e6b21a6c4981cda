"""Optical constants from text tables, as exported by spectrometers, ellipsometers and refractiveindex.info."""

from __future__ import annotations

import math
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.core.files import plain, why_unreadable
from nacre.matter.indices.models import EV_NM, Table
from nacre.recipe.delimited_text import decoded, headings, rows

MAX_BYTES = 20_000_000
_UNITS_NM = {"": 0.0, "nm": 1.0, "um": 1000.0, "angstrom": 0.1}  # 0: inferred from the numbers
_WORDS = ("wavelength", "wavelengths", "lambda", "wl")
_WAVELENGTH_NM = {f"{word}_{unit}".strip("_"): nm for word in ("", *_WORDS) for unit, nm in _UNITS_NM.items()}
del _WAVELENGTH_NM[""]
_ENERGY = tuple(f"{word}_ev".strip("_") for word in ("", "e", "energy", "photon_energy"))
_FORM = 'write a header "wavelength_nm,n,k" (or wavelength_um, energy_eV) and one row of numbers per wavelength'
# Without a header the unit follows from the numbers: optical tables stay below 20 um and above 20 nm.
_UM_LIMIT = 20.0


def read_index_csv(path: Path) -> Table:
    """Read wavelength, n and (optionally) k from a text file.

    Columns are separated by commas, semicolons, tabs or spaces; `#` starts a comment. If commas do not separate
    columns, a comma within a number is the decimal point. The header names the columns: `wavelength_nm` (or
    `Wavelength (nm)`, in um or angstrom) or `energy_eV`, `n`, `k` in any order. The database's own export (`wl,n`,
    then a second block `wl,k`, in um) and headerless rows with two or three numbers are also accepted.

    Raises:
        NacreError: unreadable file, a non-numeric row, k < 0, a non-positive or repeated wavelength, or n missing; the
            message names the line.
    """
    blocks = _blocks(path)
    n_block = next((b for b in blocks if "n" in b), None)
    k_block = next((b for b in blocks if "k" in b), None)
    if n_block is None:
        raise NacreError(f"{path.name}: column n is missing; {_FORM}")
    wavelengths, n = n_block["wavelength"], n_block["n"]
    table = Table.sorted(wavelengths, n, n_block.get("k", [0.0] * len(n)))
    if k_block is not None and k_block is not n_block:
        if sorted(k_block["wavelength"]) != sorted(wavelengths):
            raise NacreError(f"{path.name}: the blocks of n and of k are for different wavelengths; join them")
        table = Table(table.wavelengths_nm, table.n, Table.sorted(k_block["wavelength"], k_block["k"], k_block["k"]).k)
    return table


def _read(path: Path) -> str:
    try:
        if plain(path).stat().st_size > MAX_BYTES:
            raise NacreError(f"{path.name}: is larger than {MAX_BYTES // 1_000_000} MB; is it a table of n and k?")
        return decoded(path.read_bytes())
    except OSError as error:
        raise NacreError(f"{path.name}: {why_unreadable(error)}") from None
    except UnicodeDecodeError:
        raise NacreError(f"{path.name}: is not a text file; {_FORM}") from None


def _blocks(path: Path) -> list[dict[str, list[float]]]:
    """Return the file's blocks as columns by name, wavelengths in nm."""
    blocks: list[dict[str, list[float]]] = []
    columns: list[str] = []
    scale = 0.0  # 0: unknown yet; negative: energies
    for number, cells in rows(_read(path)):
        values = _numbers(cells)
        if values is None:
            columns, scale = _header(path, number, cells)
            blocks.append({name: [] for name in columns})
            continue
        if not columns:
            columns = ["wavelength", "n", "k"][: len(values)]
            blocks.append({name: [] for name in columns})
        if len(values) != len(columns) or len(columns) < 2:
            raise NacreError(f"{path.name}: line {number} has {len(values)} numbers; {_FORM}")
        row = dict(zip(columns, values))
        _check_row(path, number, row)
        scale = scale or (1000.0 if row["wavelength"] < _UM_LIMIT else 1.0)
        for name, value in zip(columns, values):
            if name:
                blocks[-1][name].append(_in_nm(value, scale) if name == "wavelength" else value)
    for block in blocks:
        if not block.get("wavelength"):
            raise NacreError(f"{path.name}: holds no rows; {_FORM}")
        if len(set(block["wavelength"])) != len(block["wavelength"]):
            raise NacreError(f"{path.name}: a wavelength is given twice; delete one row")
    return blocks


def _in_nm(value: float, scale: float) -> float:
    return -scale / value if scale < 0.0 else value * scale


def _numbers(cells: list[str]) -> list[float] | None:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None


def _header(path: Path, number: int, cells: list[str]) -> tuple[list[str], float]:
    """Return the column names and the factor from their wavelengths to nm.

    The factor is 0 if the unit must be inferred from the numbers, and -h c/e for energies in eV.
    """
    columns, scale = [], 0.0
    for cell in headings(cells):
        if cell in _WAVELENGTH_NM or cell in _ENERGY:
            columns.append("wavelength")
            scale = -EV_NM if cell in _ENERGY else _WAVELENGTH_NM[cell]
        else:
            columns.append(cell if cell in ("n", "k") else "")
    if columns.count("wavelength") != 1 or not {"n", "k"} & set(columns) or max(map(columns.count, "nk")) > 1:
        raise NacreError(f'{path.name}: line {number}, "{" ".join(cells)[:40]}", is neither header nor row; {_FORM}')
    return columns, scale


def _check_row(path: Path, number: int, row: dict[str, float]) -> None:
    where = f"{path.name}: line {number}"
    if not all(map(math.isfinite, row.values())):
        raise NacreError(f"{where} holds a number that is not finite")
    if row["wavelength"] <= 0.0:
        raise NacreError(f"{where} has a wavelength of {row['wavelength']:g}; it should be positive")
    if row.get("n", 1.0) < 0.0:
        raise NacreError(f"{where} has n = {row['n']:g}; it should not be negative")
    if row.get("k", 0.0) < 0.0:
        raise NacreError(f"{where} has k = {row['k']:g}; it should be 0 or positive (n + ik)")
