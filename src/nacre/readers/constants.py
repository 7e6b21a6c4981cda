"""Optical constants: n and k from the quantities of a table, and the files of optics programs and databases."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers import hdf5
from nacre.readers.columns import Columns, interpret, load_tables, sorted_by_wavelength, tables_of
from nacre.readers.measurement import AmbiguousFileError, FileHead, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN
from nacre.readers.spectra.common import blocks
from nacre.readers.text_table import load_text, number
from nacre.readers.units import UNITS, Floats, spectral_unit, to_nm

QUANTITIES = ("n", "k", "eps1", "eps2", "alpha")
MAX_INDEX = 100.0  # far above any optical material
NOISE_K = 0.01  # k of a clear film scatters about 0 by less in ellipsometry and photometry


def sampled(
    path: Path, nm: Floats, n: Floats, k: Floats, assumed: Sequence[str] = (), left_out: Sequence[str] = (),
    name: str | None = None, metadata: Mapping[str, Any] | None = None,
) -> Measurement:  # fmt: skip
    """Return n and k at wavelengths as a measurement, ascending in wavelength; its name is that of the file by default.

    Raises:
        NacreError: impossible constants, or two values at a wavelength.
    """
    notes = list(assumed)
    nm, columns = sorted_by_wavelength(path, nm, {"n": n, "k": k})
    n, k = checked(path, nm, columns["n"], columns["k"], notes)
    data = {"wavelength_nm": nm, "n": n, "k": k}
    name = path.stem if name is None else name
    return Measurement(path, "constants", data, name, metadata or {}, tuple(notes), tuple(left_out))


def index_of_permittivity(eps1: Floats, eps2: Floats) -> tuple[Floats, Floats]:
    """Return n and k of a dielectric function: n + ik = sqrt(eps1 + i eps2), with k >= 0 for eps2 >= 0."""
    root = np.sqrt(eps1 + 1j * eps2)
    return np.asarray(root.real), np.asarray(root.imag)


def constants(columns: Columns, options: ReadOptions, nm: Floats, name: str = "") -> Measurement:
    """Return the optical constants of one table as a measurement of kind "constants", ascending in wavelength.

    Raises:
        NacreError: one of n and k without the other, quantities that contradict each other, or impossible numbers.
    """
    path = columns.path
    column_of = {quantity: columns.one(quantity) for quantity in QUANTITIES}
    values = {quantity: column.values for quantity, column in column_of.items() if column is not None}
    assumed = list(columns.assumed)
    alpha = column_of["alpha"]
    if alpha is not None:
        if not alpha.unit:
            raise AmbiguousFileError(
                f'{path}: "{alpha.heading}" has no unit; write "{alpha.heading} (1/cm)"', "columns"
            )
        values["alpha"] = alpha.values * UNITS[alpha.unit][1] * nm / (4.0 * np.pi)
    is_missing = np.isnan([nm, *values.values()]).any(axis=0)
    left_out = [f'"{heading}" is not used' for heading in columns.unused]
    left_out += [f'"{heading}" is ignored' for heading in columns.ignored]
    if is_missing.any():
        if is_missing.all():
            raise NacreError(f"{path}: no row has numbers in all columns: n or k is missing or not finite")
        left_out.append(f"{int(is_missing.sum())} rows with missing cells")
    negative = np.flatnonzero(values["n"] < 0.0) if "n" in values else np.empty(0, int)
    if negative.size:
        line, value = columns.table.lines[int(negative[0])], values["n"][negative[0]]
        raise NacreError(f"{path}: line {line}: n = {value:g} should not be negative; are these eps1 and eps2?")
    nm, values = nm[~is_missing], {quantity: column[~is_missing] for quantity, column in values.items()}
    nm, values = sorted_by_wavelength(path, nm, values)
    n, k = _n_and_k(path, values, columns)
    n, k = checked(path, nm, n, k, assumed, "eps2" in values)
    data: dict[str, Floats] = {"wavelength_nm": nm, "n": n, "k": k}
    data |= {quantity: values[quantity] for quantity in ("eps1", "eps2") if quantity in values}
    return Measurement(path, "constants", data, name, {}, tuple(assumed), tuple(left_out))


def _n_and_k(path: Path, values: dict[str, Floats], columns: Columns) -> tuple[Floats, Floats]:
    n, k, eps1, eps2 = (values.get(quantity) for quantity in ("n", "k", "eps1", "eps2"))
    if k is None:
        k = values.get("alpha")
    if eps1 is not None and eps2 is None or (eps2 is not None and eps1 is None and n is None):
        one, other = ("eps1", "eps2") if eps2 is None else ("eps2", "eps1")
        raise NacreError(
            f"{path}: has {one} without {other}; both are needed; the columns are {columns.table.shown_headings}"
        )
    if eps1 is not None and eps2 is not None:
        from_eps = index_of_permittivity(eps1, eps2)
        for name, stated, computed in (("n", n, from_eps[0]), ("k", k, from_eps[1])):
            if stated is not None and not np.allclose(stated, computed, rtol=0.02, atol=0.02):
                raise NacreError(f"{path}: {name} contradicts eps1 and eps2; ignore one of them")
        return (from_eps[0] if n is None else n), (from_eps[1] if k is None else k)
    if n is not None and eps2 is not None:
        from_eps2 = eps2 / (2.0 * n)
        if k is not None and not np.allclose(k, from_eps2, rtol=0.02, atol=0.02):
            raise NacreError(f"{path}: k contradicts eps2 = 2 n k; ignore one of them")
        return n, from_eps2 if k is None else k
    if n is None:
        what = "k alone" if k is not None else "neither n nor eps1"
        raise NacreError(
            f"{path}: column n is missing or not finite: it has {what}; constants need n, or eps1 and eps2; the "
            f"columns are {columns.table.shown_headings}"
        )
    return n, np.zeros_like(n) if k is None else k


def checked(
    path: Path, nm: Floats, n: Floats, k: Floats, assumed: list[str], is_permittivity: bool = False
) -> tuple[Floats, Floats]:
    """Refuse impossible constants, which may follow from a permittivity; k that scatters about 0 is set to 0.

    Raises:
        NacreError: negative k beyond noise.
    """
    if max(n.max(), k.max()) > MAX_INDEX:
        name, values = ("n", n) if n.max() > MAX_INDEX else ("k", k)
        what = "are these other quantities, such as eps1, eps2 or alpha?"
        raise NacreError(f"{path}: {name} = {values.max():g} is larger than any index; {what}")
    if k.min() >= 0.0:
        return n, k
    at = int(np.argmin(k))
    if -k.min() <= NOISE_K:
        assumed.append(f"k scatters about 0 (least {k.min():g}); negative k are set to 0")
        return n, np.maximum(k, 0.0)
    names = '"wavelength_nm", "eps1", "-eps2"' if is_permittivity else '"wavelength_nm", "n", "-k"'
    form = "eps1 - i eps2" if is_permittivity else "n - ik"
    sign = f"if the file holds {form}, name the columns: columns = [{names}]"
    raise NacreError(f"{path}: k = {k[at]:g} at {nm[at]:.6g} nm should be 0 or positive (n + ik); {sign}")


# Optical constants in the files of optics programs and databases.

# NeXus files (HDF5) of the application definition NXdispersive_material: tables, or the sampled plot of a formula.

MAGIC = b"\x89HDF\r\n\x1a\n"
DEFINITION = b"NXdispersive_material"
AXES = ("dispersion_x", "dispersion_y", "dispersion_z")


def sniff_nexus_dispersion(head: FileHead) -> float:
    """Return 1 for HDF5 whose first entry states the definition."""
    if not head.data.startswith(MAGIC):
        return 0.0
    import h5py

    try:
        with h5py.File(head.path, "r") as file:
            names = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
            return CERTAIN if any(_definition(file, name) for name in names) else 0.0
    except (OSError, RuntimeError, hdf5.Hdf5Error):
        return 0.0


def _definition(file: Any, name: str) -> bool:
    definition = hdf5.dataset(file, f"{name}/definition")
    return definition is not None and definition.shape == () and bytes(definition[()]) == DEFINITION


def read_nexus_dispersion(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the optical constants along the first axis.

    Raises:
        NacreError: links to other files, no table and no sampled plot, or units that are not stated.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            hdf5.refuse_links(file)
            entry = next(name for name in file if _definition(file, name))
            return [_material_nexus_dispersion(path, file, entry)]
    except hdf5.Hdf5Error as error:
        raise NacreError(f"{path}: {error}") from None


def _material_nexus_dispersion(path: Path, file: Any, entry: str) -> Measurement:
    present = [axis for axis in AXES if hdf5.node(file, f"{entry}/{axis}") is not None]
    if not present:
        raise NacreError(f"{path}: holds no dispersion")
    left_out = [f"{axis} (another axis of the crystal)" for axis in present[1:]]
    group = hdf5.node(file, f"{entry}/{present[0]}")
    tables = [name for name in group if isinstance(name, str) and name.startswith("dispersion_table")]
    places = [f"{entry}/{present[0]}/{name}" for name in (*tables, "plot")]
    for place in places:
        if table := _table(path, file, place):
            assumed = ["n and k are the file's own samples of a formula"] if place.endswith("/plot") else []
            return sampled(path, *table, assumed, left_out)
    raise NacreError(f"{path}: is a NeXus dispersion by a formula without a table; export a table of n and k")


def _table(path: Path, file: Any, place: str) -> tuple[Floats, Floats, Floats] | None:
    wavelength = hdf5.dataset(file, f"{place}/wavelength")
    index = hdf5.dataset(file, f"{place}/refractive_index")
    if wavelength is None or index is None:
        return None
    stated = wavelength.attrs.get("units", wavelength.attrs.get("unit", ""))
    unit = spectral_unit(stated.decode() if isinstance(stated, bytes) else str(stated))
    if unit is None:
        raise NacreError(f'{path}: the unit "{stated}" of its wavelengths is not known')
    nm, values = to_nm(np.ravel(wavelength[()]), unit), np.ravel(index[()])
    extinction = hdf5.dataset(file, f"{place}/extinction")
    k = np.imag(values) if extinction is None else np.ravel(extinction[()])
    if not (nm.shape == values.shape == k.shape):
        raise NacreError(f"{path}: wavelengths, n and k have different lengths")
    return nm, np.real(values).astype(float), np.asarray(k, dtype=float)


# Dispersion libraries of regress-pro: oscillator models, which are recognised and refused by name.

_MODEL = re.compile(r'(?:^|\s)(ho|tauc-lorentz|kramers|cauchy|bruggeman|fb|lookup)\s+"([^"]*)"')


def sniff_regress_pro_library(head: FileHead) -> float:
    """Return 0.95 for a library or a single model."""
    first = next((line.strip() for line in head.lines if line.strip()), "")
    return 0.95 if re.match(r"dispers-library\s+\d+", first) or _MODEL.match(first) else 0.0


def read_regress_pro_library(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the models.

    Raises:
        NacreError: always; names the models.
    """
    models = [f"{name} ({kind})" for kind, name in _MODEL.findall(load_text(path, 20_000_000))]
    raise NacreError(
        f"{path}: is a dispersion library of regress-pro with models ({', '.join(models)[:120]}), which are not read; "
        "export a table of n and k (.mat)"
    )


# Pages of the refractiveindex.info database (YAML) with tabulated n and k, in um.
#
# Formulas are read where a material is needed: `material = {file = "page.yml"}`.

_TYPE = re.compile(r"^\s*-?\s*type:\s*[\"']?(tabulated (?:nk|n|k)|formula \d+)", re.MULTILINE)


def sniff_rii_page(head: FileHead) -> float:
    """Return 0.95 for a `DATA:` list with `type: tabulated` or `type: formula`."""
    return 0.95 if re.search(r"^\s*DATA:", head.text, re.MULTILINE) and _TYPE.search(head.text) else 0.0


def read_rii_page(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return tabulated n and k.

    Raises:
        NacreError: a formula, k without n, or different wavelengths of n and k.
    """
    text = load_text(path, 20_000_000)
    places = [*_TYPE.finditer(text)]
    columns: dict[str, tuple[Floats, Floats]] = {}
    for match, after in zip(places, [*places[1:], None]):
        if match[1].startswith("formula"):
            advice = 'use it as a material: {file = "' + path.name + '"}'
            raise NacreError(f"{path}: gives n by {match[1]} of refractiveindex.info, not as a table; {advice}")
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
    return [sampled(path, nm, n, k)]


def _rows(path: Path, text: str) -> Floats:
    tables = blocks(text.partition("|")[2].splitlines(), least_rows=1)
    if not tables or tables[0].ragged:
        raise NacreError(f"{path}: a table of its data has no rows of numbers")
    return tables[0].table


# Optical constants of the SOPRA database (.MAT): `DATA1*number*abscissa*n*k*` between `POINTS*` and `EOF*`.


def sniff_sopra(head: FileHead) -> float:
    """Return 1 for `VERSION*` in the first line and rows of DATA1."""
    lines = [line.strip() for line in head.lines[:20] if line.strip()]
    return 1.0 if lines and lines[0].startswith("VERSION*") and any(s.startswith("DATA1*") for s in lines) else 0.0


def read_sopra(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read n and k over the wavelength in nm.

    Raises:
        NacreError: a row is damaged, the row count is not POINTS, or the numbers are not wavelengths, n and k.
    """
    rows: list[list[float]] = []
    points = ""
    for count, line in enumerate(load_text(path, 20_000_000).splitlines(), start=1):
        cells = [cell.strip() for cell in line.strip().split("*")]
        if cells[0] == "POINTS" and len(cells) > 1:
            points = cells[1]
        elif cells[0] == "DATA1":
            try:
                rows.append([float(cell) for cell in cells[2:5]])
            except ValueError:
                raise NacreError(f"{path}: line {count} is not a row of a wavelength, n and k") from None
    if points.isdigit() and int(points) != len(rows):
        raise NacreError(f"{path}: POINTS = {points}, but the file has {len(rows)} rows")
    if not rows or any(len(row) != 3 for row in rows):
        raise NacreError(f"{path}: the rows of DATA1 should hold wavelength, n and k")
    table = np.array(rows)
    if table[:, 0].min() < 1.0:
        raise NacreError(f"{path}: an abscissa of {table[:, 0].min():g} is not a wavelength in nm")
    assumed = ["the wavelengths are in nm, as in the database of SOPRA"]
    return [sampled(path, table[:, 0], table[:, 1], table[:, 2], assumed)]


# Pairs of spectral files of Mitsuba and PBRT: `Au.eta.spd` with n and `Au.k.spd` with k over nm.
#
# One file without the other is not a material: gold without k is a dielectric.

_NAME = re.compile(r"(.+)([._-])(eta|k)(\.spd)", re.IGNORECASE)


def sniff_spd_pair(head: FileHead) -> float:
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


def read_spd_pair(path: Path, options: ReadOptions) -> list[Measurement]:
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
    (nm, values), (other_nm, other_values) = _columns(path), _columns(other)
    if nm.shape != other_nm.shape or not np.allclose(nm, other_nm, rtol=1e-6):
        raise NacreError(f"{path}: {other.name} has other wavelengths; n and k belong to the same ones")
    n, k = (values, other_values) if is_n else (other_values, values)
    assumed = ["the wavelengths are in nm, as Mitsuba and PBRT define"]
    return [sampled(path, nm, n, k, assumed, name=match[1], metadata={"files": [path.name, other.name]})]


def _columns(path: Path) -> tuple[Floats, Floats]:
    table = load_tables(path).tables[0]
    if table.width != 2:
        raise NacreError(f"{path}: has {table.width} columns; a .spd file has wavelength and value")
    nm, columns = sorted_by_wavelength(path, table.column(0), {"value": table.column(1)})
    if not np.isfinite(nm).all() or not np.isfinite(columns["value"]).all():
        raise NacreError(f"{path}: holds cells without a number")
    return nm, columns["value"]


# Woollam material files (.mat): WVASE layers with `Begin of array`, and the short form of three lines.
#
# WVASE: `Units=eV,E1E2` states the columns. Short form: a name, the unit, and `NK` or `E1E2`, then the rows.

PROGRAM_QUANTITIES = {"NK": ("n", "k"), "E1E2": ("eps1", "eps2"), "N": ("n",)}
# layers whose parameters are not table of n and k
LAYERS = frozenset(
    "GENOSC EMA CAUCHY SELLMEIER LORENTZ BSPLINE B-SPLINE TAUC-LORENTZ CODY-LORENTZ GRADED BIAXIAL UNIAXIAL ALLOY "
    "SUPERLATTICE INTERMIX PARAMETRIC".split()
)
_UNITS = re.compile(r"^[^\S\n]*Units\s*=\s*([^,\s]+)\s*,\s*(\w+)", re.IGNORECASE | re.MULTILINE)
_BEGIN = re.compile(r"^[^\S\n]*Begin of array.*$", re.IGNORECASE | re.MULTILINE)


def sniff_woollam_mat(head: FileHead) -> float:
    """Return 1 for a layer file with units and an array, the short form, or parameters."""
    is_known = (_UNITS.search(head.text) and _BEGIN.search(head.text)) or _short(head.lines) or _layer(head.lines)
    return CERTAIN if is_known else 0.0


def _layer(lines: list[str]) -> str:
    """Return the layer type in a parameter file: its second line; else ""."""
    word = lines[1].strip() if len(lines) > 2 else ""
    return word if word.upper() in LAYERS else ""


def _short(lines: list[str]) -> tuple[str, str] | None:
    """Return unit and quantities of the short form."""
    if len(lines) < 4 or lines[2].strip().upper() not in PROGRAM_QUANTITIES:
        return None
    unit = spectral_unit(lines[1])
    return None if unit is None else (unit, lines[2].strip().upper())


def read_woollam_mat(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the optical constants of one material.

    Raises:
        NacreError: the units are not known, or the rows have another column count.
    """
    text = load_text(path)
    stated, begin = _UNITS.search(text), _BEGIN.search(text)
    if stated and begin:
        unit, quantities = spectral_unit(stated[1]), stated[2].upper()
        name_line = re.search(r"^\s*Name\s*=\s*(\S.*)$", text, re.MULTILINE)
        name, body = name_line[1].strip() if name_line else "", text[begin.end() :]
    else:
        lines = re.split(r"\r\n|\r|\n", text)
        if layer := _layer(lines):
            raise NacreError(
                f"{path}: is a layer of WVASE or CompleteEASE that holds the parameters of {layer}, not n and k; "
                "export its optical constants as a table there"
            )
        short = _short(lines)
        if short is None:
            raise NacreError(f"{path}: is not a material file: units and columns are not stated")
        (unit, quantities), name, body = short, lines[0].strip(), "\n".join(lines[3:])
    if unit is None or quantities not in PROGRAM_QUANTITIES:
        units = f"{stated[1]},{stated[2]}" if stated else quantities
        raise NacreError(f"{path}: Units = {units} is not known; allowed are nm, Angstroms, um or eV with NK or E1E2")
    tables = tables_of(body, path).tables
    names = (_heading(unit), *PROGRAM_QUANTITIES[quantities])
    if len(tables) > 1 or tables[0].width < len(names):
        raise NacreError(f"{path}: has {tables[0].width} columns; {quantities} has {len(names)}")
    ignored = ("-",) * (tables[0].width - len(names))
    own = ReadOptions(columns=(*names, *ignored), unit=options.unit)
    columns = interpret(tables[0], (*names, "wavelength", "energy", "wavenumber"), own)
    nm = columns.spectral_nm(own)
    assert nm is not None
    return [constants(columns, own, nm, name)]


def _heading(unit: str) -> str:
    words = {"length": "wavelength", "energy": "energy", "wavenumber": "wavenumber"}
    return f"{words.get(UNITS[unit][0], 'frequency')} ({unit})"


# Zemax coating files (COATING.DAT): materials as `MATE NAME` and rows of um, n and the imaginary index.
#
# Zemax writes n - ik: absorption is a negative imaginary index. Coatings, tapers and tables of other kinds are listed
# as left out.

KEYWORDS = ("MATE", "COAT", "TAPR", "TABL", "IDEAL", "IDEAL2", "ENCRYPTED", "ANGL", "WAVE")
MAX_BYTES = 100_000_000


def sniff_zemax_coating(head: FileHead) -> float:
    """Return 0.9 for lines `MATE NAME` that rows of two or three numbers follow."""
    lines = [line.strip() for line in head.lines if line.strip() and not line.strip().startswith("!")]
    for line, after in zip(lines, lines[1:]):
        if re.fullmatch(r"(?i)mate\s+\S+.*", line) and all(number(word) is not None for word in after.split()[:2]):
            return 0.9
    return 0.0


def read_zemax_coating(path: Path, options: ReadOptions) -> list[Measurement]:
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
    tables = {name: np.array(rows).T for name, rows in materials.items() if rows}
    if not tables:
        raise NacreError(f"{path}: holds no material (MATE) with rows of wavelength, n and k")
    return [sampled(path, 1e3 * um, n, 0.0 - k, left_out=left_out, name=name) for name, (um, n, k) in tables.items()]
