"""Woollam WVASE and CompleteEASE: data files and text exports."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import UNITS, ellipsometry, numbers, same_length, text_lines, to_nm, within
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

# Data files (.dat) of the programs WVASE and CompleteEASE by J. A. Woollam.
#
# A comment, `VASEmethod[...]`, optional lines such as `Original[...]` or `Dynamic`, the abscissa's unit, then rows of
# wavelength, incidence angle, Psi, Delta and their standard deviations, in CompleteEASE after the letter `E`. Rows
# after another word hold another quantity: `dPolE` depolarisation in per cent, `uR`, `sR`, `pR`, `uT`, `sT`, `pT`
# powers, `mmIJ` elements of the Mueller matrix. A further column is the time of a dynamic measurement.

WOOLLAM_DAT_MAKER = "WVASE and CompleteEASE"
WOOLLAM_DAT_HEAD_LINES = 12
POWERS = {
    "ur": ("reflectance", "both"), "sr": ("reflectance", "s"), "pr": ("reflectance", "p"),
    "ut": ("transmittance", "both"), "st": ("transmittance", "s"), "pt": ("transmittance", "p"),
}  # fmt: skip
DEPOLARISATION = "dpole"
PSI_DELTA = (
    "",
    "e",
    "ane",
)  # AnE: r_pp / r_ss of an anisotropic sample, beside Aps = r_ps / r_pp and Asp = r_sp / r_ss
ROW = re.compile(r"\s*([A-Za-z]\w*)?\s*[-+.\deE]+\s+[-+.\deE]+\s+[-+.\d]")
MUELLER = re.compile(r"mm([1-4])([1-4])$")


def sniff_woollam_dat(head: FileHead) -> float:
    """Return the confidence that a file is a Woollam data file."""
    if not any(line.startswith("VASEmethod[") for line in head.lines[:WOOLLAM_DAT_HEAD_LINES]):
        return 0.0
    words = {(match[1] or "").lower() for line in head.lines if (match := ROW.match(line))}
    return 0.9 if words and words <= set(POWERS) else CERTAIN  # powers alone are spectra


def read_woollam_dat(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta, then each further quantity as a measurement of its own.

    Raises:
        NacreError: no unit or rows, or impossible values.
    """
    lines = text_lines(path)
    start = next(i for i, line in enumerate(lines) if line.startswith("VASEmethod["))
    unit, trig, first = "", False, start + 1
    for i, line in enumerate(lines[start + 1 : start + WOOLLAM_DAT_HEAD_LINES], start + 1):
        words = line.split()
        if words and words[0].lower() in UNITS:
            unit, trig, first = words[0], "TRIG" in line.upper().split(), i + 1
            break
    if not unit:
        raise NacreError(f"{path}: the line with the unit (nm, Angstroms or eV) is missing")
    found = _rows(path, lines, first)
    metadata = {"comment": lines[0].strip() if start else "", "method": lines[start].strip(), "unit_in_file": unit}
    if "TransmissionMeas=1" in lines[start]:
        metadata["light"] = "transmitted (TransmissionMeas=1)"
    left_out = [f"{len(rows)} rows of {word}" for word, rows in found.items() if not _is_known(word)]
    results = []
    for word, rows in found.items():
        if word in PSI_DELTA:
            table = same_length(path, rows)
            columns = psi_delta_columns(path, table, unit, trig)
            results.append(
                ellipsometry(
                    path, "woollam-dat", columns, options, maker=WOOLLAM_DAT_MAKER, metadata=metadata, left_out=left_out
                )
            )
    results += _mueller(path, found, unit, options, metadata)
    for word, rows in found.items():
        if word in POWERS or word == DEPOLARISATION:
            results.append(_other(path, word, same_length(path, rows), unit, metadata))
    if not results:
        raise NacreError(f"{path}: contains no rows of Psi and Delta; it has {', '.join(left_out) or 'no rows'}")
    return results


def _rows(path: Path, lines: Sequence[str], first: int) -> dict[str, list[tuple[int, list[float]]]]:
    """Return numbered rows by their leading word in lower case ("" for none)."""
    found: dict[str, list[tuple[int, list[float]]]] = {}
    for number, line in enumerate(lines[first:], first + 1):
        if not line.strip():
            continue
        match = re.match(r"\s*([A-Za-z]\w*)?\s*(.*)$", line)
        assert match is not None
        values = numbers(match[2])
        if values is None:
            raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
        found.setdefault((match[1] or "").lower(), []).append((number, values))
    return found


def _is_known(word: str) -> bool:
    return word in (*PSI_DELTA, DEPOLARISATION) or word in POWERS or bool(MUELLER.match(word))


def psi_delta_columns(path: Path, table: Array, unit: str, trig: bool) -> dict[str, Array]:
    """Return the named columns of rows of wavelength, angle, Psi, Delta[, deviations[, time]].

    Raises:
        NacreError: too few columns.
    """
    if table.shape[1] not in (4, 6, 7):
        raise NacreError(
            f"{path}: rows have {table.shape[1]} numbers; allowed: 4 (wavelength, angle, Psi, Delta), 6 with their "
            "standard deviations, 7 with the time"
        )
    names = ("tan_psi", "cos_delta") if trig else ("psi_deg", "delta_deg")
    columns = {
        "wavelength_nm": to_nm(table[:, 0], unit, str(path)), "angle_of_incidence_deg": table[:, 1],
        names[0]: table[:, 2], names[1]: table[:, 3],
    }  # fmt: skip
    if table.shape[1] >= 6:
        columns |= {f"{names[0]}_error": table[:, 4], f"{names[1]}_error": table[:, 5]}
    if table.shape[1] == 7:
        columns["time"] = table[:, 6]
    return columns


def _mueller(
    path: Path,
    found: dict[str, list[tuple[int, list[float]]]],
    unit: str,
    options: ReadOptions,
    metadata: dict[str, str],
) -> list[Measurement]:
    """Return the elements of the Mueller matrix, relative to m11, as one measurement."""
    elements = {word: same_length(path, rows) for word, rows in found.items() if MUELLER.match(word)}
    if not elements:
        return []
    first = next(iter(elements.values()))
    columns = {"wavelength_nm": to_nm(first[:, 0], unit, str(path)), "angle_of_incidence_deg": first[:, 1]}
    for word, table in elements.items():
        if table.shape[0] != first.shape[0] or np.any(table[:, :2] != first[:, :2]):
            raise NacreError(f"{path}: {word} is given at other wavelengths or angles than the other elements")
        columns[f"m{word[2:]}"] = table[:, 2]
        if table.shape[1] == 6:  # value twice, then its standard deviation twice
            columns[f"m{word[2:]}_error"] = table[:, 4]
        elif table.shape[1] > 3:
            columns[f"m{word[2:]}_error"] = table[:, 3]
    columns.setdefault("m11", np.ones(len(first)))
    return [ellipsometry(path, "woollam-dat", columns, options, maker=WOOLLAM_DAT_MAKER, metadata=metadata)]


def _other(path: Path, word: str, table: Array, unit: str, metadata: dict[str, str]) -> Measurement:
    """Return a depolarisation or a power."""
    name, polarisation = POWERS.get(word, ("depolarisation", ""))
    scale = 0.01 if word == DEPOLARISATION else 1.0
    if table.shape[1] < 3:
        raise NacreError(f"{path}: rows of {word} have {table.shape[1]} numbers; allowed: 3 or more")
    within(path, "angle_of_incidence_deg", table[:, 1], 0.0, 90.0)
    data = {
        "wavelength_nm": to_nm(table[:, 0], unit, str(path)), "angle_of_incidence_deg": table[:, 1],
        name: scale * table[:, 2],
    }  # fmt: skip
    if table.shape[1] > 3:
        data[f"{name}_error"] = scale * table[:, 3]
    said = {**metadata, "polarisation": polarisation} if polarisation else metadata
    kind = "spectrum" if polarisation else "ellipsometry"
    return Measurement(path, "woollam-dat", kind, data, word, said)  # type: ignore[arg-type]  # both are kinds


# Text exports of WVASE: wavelength, incidence angle, Psi and Delta, with or without a heading.
#
# The heading is a unit and names (`nm aoi Psi Delta`); a blank may stand for a tab, the name of the angle may be
# missing, and `TRIG` says that the columns are tan Psi and cos Delta. Lines before the heading are comments.

WOOLLAM_TEXT_HEAD_LINES = 10
WITH_HEADING, WITHOUT_HEADING = 0.9, 0.5
ANGLES = re.compile(r"^(aoi|angle)$", re.IGNORECASE)


def sniff_woollam_text(head: FileHead) -> float:
    """Return the confidence that a file is such an export."""
    if _heading(head.lines) is not None:
        return WITH_HEADING
    lines = head.lines[:-1] if head.size > len(head.data) else head.lines  # the last line may be cut
    rows = [numbers(line) for line in lines if line.strip()] or [None]
    if any(row is None or len(row) not in (4, 6) for row in rows):
        return 0.0
    table = np.array([row[:4] for row in rows if row], dtype=float)
    return WITHOUT_HEADING if len(table) > 3 and _looks_like_psi_delta(table) else 0.0


def _heading(lines: list[str]) -> tuple[int, str, bool] | None:
    """Return line number, unit, and whether the columns are tan Psi and cos Delta."""
    for i, line in enumerate(lines[:WOOLLAM_TEXT_HEAD_LINES]):
        words = line.split()
        if line[:1] == "\t" and [word.lower() for word in words] in (
            ["aoi", "psi", "delta"],
            ["angle", "psi", "delta"],
        ):
            return i, "", False  # the wavelength has no name
        if not words or words[0].lower() not in UNITS or numbers(line) is not None:
            continue
        rest = [word.lower() for word in words[1:]]
        if "trig" in rest:
            return i, words[0], True
        cells = [cell.strip().lower() for cell in line.split("\t")]
        if len(cells) > 3 and cells[2:4] != ["psi", "delta"]:
            continue  # the columns have another order
        names = [word for word in rest if not ANGLES.match(word)]
        if names[:2] == ["psi", "delta"] and ("\t" in line or len(rest) == 3):
            return i, words[0], False
    return None


def _looks_like_psi_delta(table: np.ndarray) -> bool:
    """Whether four unnamed columns are wavelength, a few incidence angles, Psi and Delta."""
    wavelength, angle, psi, delta = table.T
    if not (np.all((wavelength > 0.1) & (wavelength < 60_000)) and np.all((angle > 10) & (angle < 90))):
        return False
    if not (np.all((psi >= 0) & (psi <= 90)) and np.all((delta >= -180) & (delta <= 360))):
        return False
    pairs = len({(w, a) for w, a in zip(wavelength, angle)})
    return pairs == len(table) and len(np.unique(wavelength)) * len(np.unique(angle)) <= 2 * len(table)


def read_woollam_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta.

    Raises:
        NacreError: rows of different lengths, or impossible values.
    """
    lines = text_lines(path)
    heading = _heading(lines)
    assumed: list[str] = []
    first, unit, trig = (0, "", False) if heading is None else (heading[0] + 1, heading[1], heading[2])
    unit = options.unit or unit
    if not unit:
        values = [row[0] for line in lines if (row := numbers(line))]
        unit = "eV" if values and max(values) < 20 else "nm" if values and max(values) <= 3000 else "angstrom"
        assumed.append(f"the first column has no heading: the wavelength in {unit}")
    if heading is None:
        assumed.append("the file has no heading: the columns are taken as wavelength, angle of incidence, Psi, Delta")
    rows = []
    for number, line in enumerate(lines[first:], first + 1):
        if not line.strip():
            continue
        values_of_line = numbers(line)
        if values_of_line is None:
            raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
        rows.append((number, values_of_line))
    columns = psi_delta_columns(path, same_length(path, rows), unit, trig)
    metadata = {"unit_in_file": unit, "comment": " ".join(lines[: max(first - 1, 0)]).strip()}
    return [ellipsometry(path, "woollam-text", columns, options, maker="WVASE", metadata=metadata, assumed=assumed)]
