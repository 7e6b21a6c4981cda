"""Random text tables as laboratories write them, with the numbers that they hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

EV_NM = 6.62607015e-34 * 299792458 / 1.602176634e-19 * 1e9  # h c / e
LIGHT_NM_THZ = 299792.458
Floats = NDArray[np.float64]

# quantity and unit -> spellings of the heading, complete
WAVELENGTHS = {
    "nm": ["wavelength_nm", "Wavelength (nm)", "Wavelength [nm]", "λ/nm", "λ (nm)", "nm", "Wellenlänge / nm",
           "lambda(nm)", "Wellenlänge [nm]", "Longueur d'onde (nm)",
           "WL_nm", "Wavelength, nm", "wavelength nm", "WAVELENGTH (NM)"],
    "um": ["wavelength_um", "Wavelength (µm)", "Wavelength, µm", "λ [μm]", "Wavelength (microns)", "um", "lambda_um",
           "Wellenlänge in µm", "WL (um)"],
    "angstrom": ["Wavelength (Å)", "Wavelength (A)", "Lambda [Angstroms]", "wavelength_angstrom"],
    "eV": ["Energy (eV)", "energy_eV", "hν (eV)", "Photon energy [eV]", "E (eV)", "eV", "E/eV", "Energie (eV)",
           "hv (eV)"],
    "1/cm": ["wavenumber (cm-1)", "Wavenumber [1/cm]", "cm-1", "Wellenzahl (cm^-1)", "wavenumber (cm⁻¹)", "1/cm"],
    "THz": ["frequency (THz)", "Frequency [THz]", "f (THz)", "Frequenz / THz", "ν (THz)"],
}  # fmt: skip
BARE = ["Wavelength", "wl", "lambda", "λ", "Wellenlänge", "wave"]
VALUES = {
    "n": ["n", "n (-)", "Refractive index", "refractive index n", "Re(n)", "n [1]", "n_real", "Brechungsindex"],
    "k": ["k", "k (-)", "kappa", "κ", "Extinction coefficient", "Im(n)", "extinction", "k [-]",
          "Extinktionskoeffizient"],
    "eps1": ["e1", "eps1", "ε1", "Re(eps)", "ε'", "epsilon_1", "ϵ1", "eps_real"],
    "eps2": ["e2", "eps2", "ε2", "Im(eps)", "ε''", "epsilon_2", "ϵ2", "eps_imag"],
    "alpha": ["alpha (1/cm)", "α [cm-1]", "Absorption coefficient (cm^-1)"],
    "R": ["R", "Reflectance", "specular_reflectance", "Reflectivity", "reflectance", "Reflexionsgrad", "R (-)"],
    "R%": ["R (%)", "%R", "Reflectance (%)", "Reflectance [%]", "R / %", "R%", "Reflexion (%)", "reflectance_percent"],
    "T": ["T", "Transmittance", "specular_transmittance", "Transmission"],
    "T%": ["T (%)", "%T", "Transmission [%]", "Transmittance (%)"],
    "error": ["sigma", "err", "±", "std", "uncertainty"],
    "angle": ["AOI", "angle_deg", "Angle of incidence (deg)", "theta", "incidence_deg", "AOI (°)",
              "Einfallswinkel (°)"],
}  # fmt: skip
UNKNOWN = ["Batch", "operator 7", "QC", "lamp setting", "Kanal B", "xyz1"]
HARMLESS = ["Temperature (K)", "time (s)", "No", "Index"]
ROW_OF_UNITS = {"nm": "Wavelength", "um": "λ", "eV": "Energy", "1/cm": "Wellenzahl", "THz": "Frequency"}
MISTAKEN = {"um": ["nm"], "nm": ["um", "eV"]}  # that the numbers contradict
GAPS = ["", "n/a", "#N/A", "NaN", "#DIV/0!", "--"]
PREAMBLES: list[list[str]] = [
    [], [], [], ["Gold, sputtered"], ["# measured 2024-03-01", "# operator: X"],
    ["Sample: Si wafer 4", "Date: 01.02.2024"], ["% exported", "! 3 scans"],
    ["Instrument: M-2000", "Integration time: 100 ms", "", "Scans: 3"],
    ["Mein Glas Nr. 7", ""],
]  # fmt: skip


@dataclass(frozen=True)
class LabTable:
    """A file, and its contents: wavelengths ascending, values by quantity (n, k, R, T), NaN where not measured."""

    data: bytes
    kind: str
    nm: Floats
    values: dict[str, Floats]
    angle_deg: float
    notes: tuple[str, ...]


def in_unit(nm: Floats, unit: str) -> Floats:
    """Return wavelengths in a unit of a heading."""
    return {
        "nm": nm, "um": nm / 1e3, "angstrom": 10 * nm, "eV": EV_NM / nm, "1/cm": 1e7 / nm, "THz": LIGHT_NM_THZ / nm,
    }[unit]  # fmt: skip


def _choice(rng: np.random.Generator, options: list[Any]) -> Any:
    return options[int(rng.integers(len(options)))]


def _truth(rng: np.random.Generator, kind: str) -> tuple[Floats, dict[str, Floats]]:
    low, high = rng.uniform(190, 420), _choice(rng, [rng.uniform(700, 1100), rng.uniform(1100, 2500)])
    nm = np.unique(np.round(np.linspace(low, high, int(rng.integers(5, 50))), 2))
    x = (nm - nm[0]) / (nm[-1] - nm[0])
    if kind == "constants":
        n = rng.uniform(0.8, 4.0) + rng.uniform(-0.5, 0.5) * np.cos(3 * x)
        k = rng.uniform(0.0, 2.0) * (1.1 + np.sin(4 * x)) if rng.random() < 0.7 else np.zeros_like(nm)
        return nm, {"n": n, "k": k}
    values = {"R": 0.5 + 0.4 * np.sin(rng.uniform(3, 12) * x + 1)}
    if rng.random() < 0.3:
        values["T"] = 0.4 + 0.3 * np.cos(5 * x)
    return nm, values


def _columns(
    rng: np.random.Generator, kind: str, nm: Floats, truth: dict[str, Floats]
) -> list[tuple[str, str, Floats]]:
    """Return quantity, heading and numbers of the columns of values."""
    if kind == "constants":
        n, k = truth["n"], truth["k"]
        forms = {
            "nk": [("n", n), ("k", k)], "eps": [("eps1", n**2 - k**2), ("eps2", 2 * n * k)],
            "nalpha": [("n", n), ("alpha", 4 * np.pi * k / (nm * 1e-7))], "neps2": [("n", n), ("eps2", 2 * n * k)],
        }  # fmt: skip
        form = _choice(rng, ["nk", "nk", "nk", "eps", "nalpha", "neps2"])
        found = forms[form] if k.any() or form != "nk" or rng.random() < 0.5 else [("n", n)]
        return [(name, _choice(rng, VALUES[name]), values) for name, values in found]
    columns = []
    is_per_cent = rng.random() < 0.5
    for name, values in truth.items():
        key = f"{name}%" if is_per_cent else name
        columns.append((name, _choice(rng, VALUES[key]), 100 * values if is_per_cent else values))
        if rng.random() < 0.2:
            columns.append((f"{name}_error", _choice(rng, VALUES["error"]), 0.01 * values))
    return columns


def _cell(value: float, digits: int, style: str, decimal: str) -> str:
    if np.isnan(value):
        return ""
    text = f"{value:.{digits}e}" if style in ("exponent", "fortran") else f"{value:.{digits + 3}g}"
    if style == "fortran":
        text = text.replace("e", "D")
    return text.replace(".", decimal)


def laboratory_table(rng: np.random.Generator, kind: str | None = None) -> LabTable:
    """Return a random table; some are damaged or ambiguous, so that a reader has to refuse them."""
    kind = kind or _choice(rng, ["constants", "spectrum"])
    nm, truth = _truth(rng, kind)
    unit = _choice(rng, ["nm", "nm", "nm", "um", "um", "eV", "eV", "1/cm", "angstrom", "THz"])
    spectral_heading, notes = _choice(rng, WAVELENGTHS[unit]), [unit]
    has_heading = rng.random() < 0.88
    if unit in ("nm", "um", "angstrom") and rng.random() < 0.15:
        spectral_heading = _choice(rng, BARE)
        notes.append("no unit")
    if unit in MISTAKEN and rng.random() < 0.06 and not any(note == "no unit" for note in notes):
        stated = _choice(rng, MISTAKEN[unit])
        spectral_heading = _choice(rng, WAVELENGTHS[stated])
        notes.append(f"stated as {stated}")
    has_unit_row = has_heading and unit in ROW_OF_UNITS and rng.random() < 0.15
    if has_unit_row:
        spectral_heading = ROW_OF_UNITS[unit]
        notes.append("row of units")
    columns = [("x", spectral_heading, in_unit(nm, unit)), *_columns(rng, kind, nm, truth)]
    if not has_heading:
        unit = _choice(rng, ["nm", "um", "eV", "1/cm"])
        columns = [("x", "", in_unit(nm, unit)), *((name, name, values) for name, values in truth.items())][:3]
        notes.append("no heading")
    angle = 0.0
    if kind == "spectrum" and has_heading and rng.random() < 0.3:
        angle = float(_choice(rng, [8.0, 45.0, 60.0]))
        columns.insert(1, ("angle", _choice(rng, VALUES["angle"]), np.full(len(nm), angle)))
    if has_heading and rng.random() < 0.15:
        place = int(rng.integers(1, len(columns) + 1))
        columns.insert(place, ("harmless", _choice(rng, HARMLESS), np.arange(1.0, len(nm) + 1)))
    if has_heading and rng.random() < 0.08:
        columns.append(("unknown", _choice(rng, UNKNOWN), np.round(rng.random(len(nm)), 3)))
        notes.append("unknown column")
    if has_heading and rng.random() < 0.25 and not any(name.endswith("_error") for name, *_ in columns):
        columns = [columns[i] for i in rng.permutation(len(columns))]
    return _written(rng, kind, nm, truth, columns, has_heading, angle, notes)


def _written(
    rng: np.random.Generator, kind: str, nm: Floats, truth: dict[str, Floats], columns: list[tuple[str, str, Floats]],
    has_heading: bool, angle: float, notes: list[str],
) -> LabTable:  # fmt: skip
    delimiter = _choice(rng, [",", ",", ";", ";", "\t", " ", "  ", ", "])
    decimal = "," if delimiter in (";", "\t", " ", "  ") and rng.random() < 0.4 else "."
    style, digits = _choice(rng, ["plain", "plain", "plain", "exponent", "fortran"]), int(rng.integers(5, 9))
    order = _choice(rng, [np.arange(len(nm)), np.arange(len(nm)), np.arange(len(nm))[::-1]])
    if rng.random() < 0.1:
        order = np.append(order, order[-1])  # the last row stands twice
    rows = [[_cell(values[i], digits, style, decimal) for _, _, values in columns] for i in order]
    if has_heading and delimiter.strip() and rng.random() < 0.15:
        row, place = int(rng.integers(len(rows))), int(rng.integers(len(columns)))
        if columns[place][0] not in ("x", "harmless", "unknown", "angle") and len(rows) == len(nm):
            rows[row][place] = _choice(rng, GAPS)
            notes.append("gap")
    headings = [heading for _, heading, _ in columns]
    lines = list(_choice(rng, PREAMBLES))
    if has_heading:
        quote = rng.random() < 0.3 or any(delimiter.strip() and delimiter.strip() in heading for heading in headings)
        needs_quotes = delimiter.strip() == "" and delimiter != "\t" and any(" " in heading for heading in headings)
        cells = [f'"{h}"' if (quote or needs_quotes) and '"' not in h else h for h in headings]
        lines.append(("# " if rng.random() < 0.1 and delimiter != "\t" else "") + delimiter.join(cells))
    if "row of units" in notes:
        stated = {"x": notes[0], "angle": "deg"}
        marks = [stated.get(name, "" if set(h) & set("([/_%") or name == "harmless" else "-") for name, h, _ in columns]
        lines.append(delimiter.join(f"[{mark}]" for mark in marks))
    lines += [delimiter.join(row) for row in rows]
    lines += _choice(rng, [[], [], [], [""], ["", "End of data"], ["# end"]])
    text = _choice(rng, ["\n", "\r\n", "\r"]).join(lines) + _choice(rng, ["\n", ""])
    return LabTable(_encoded(rng, text), kind, nm, truth, angle, tuple(notes))


def _encoded(rng: np.random.Generator, text: str) -> bytes:
    encoding = _choice(rng, ["utf-8", "utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
    try:
        return text.encode(encoding)
    except UnicodeEncodeError:
        return text.encode("utf-8")


def as_read(table: LabTable, path: Any) -> tuple[Floats, dict[str, Floats], float]:
    """Read a table as a recipe or a fit does: wavelengths, values by quantity, and angle.

    Raises:
        NacreError: it is refused.
    """
    from nacre.analysis.fit import read_measurement
    from nacre.readers.measurement import ReadOptions
    from nacre.readers.registry import open_file

    path.write_bytes(table.data)
    if table.kind == "constants":
        (found,) = open_file(path, ReadOptions(expects="constants"))
        return found.data["wavelength_nm"], {name: found.data[name] for name in ("n", "k")}, 0.0
    measured: Any = read_measurement(path)
    short = {"specular_reflectance": "R", "specular_transmittance": "T"}
    values = {short.get(part, part): measured.values[i, 0] for i, part in enumerate(measured.parts)}
    return measured.wavelengths_nm, values, float(measured.angles_deg[0])


def is_right(table: LabTable, found: tuple[Floats, dict[str, Floats], float]) -> bool:
    """Whether what was read is what the table holds; rows with a gap may lack."""
    nm, values, angle = found
    place = np.searchsorted(table.nm, nm)
    place = np.clip(place, 0, len(table.nm) - 1)
    before = np.clip(place - 1, 0, len(table.nm) - 1)
    place = np.where(np.abs(table.nm[before] - nm) < np.abs(table.nm[place] - nm), before, place)
    missing = len(table.nm) - len(nm)
    if missing > ("gap" in table.notes) or not np.allclose(nm, table.nm[place], rtol=2e-4) or angle != table.angle_deg:
        return False
    if set(values) != set(table.values):
        return False
    return all(np.allclose(values[name], table.values[name][place], rtol=1e-3, atol=2e-4) for name in values)
