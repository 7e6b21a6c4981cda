"""Text files of ellipsometers: Accurion, Film Sense, Horiba, regress-pro, SpectraRay, nacre's CSV."""

import csv
import re
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import UNITS, ellipsometry, numbers, same_length, text_lines, to_nm, within
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead

# Text of the imaging ellipsometers EP3 and EP4 by Accurion (Park Systems).
#
# A heading and a unit line, both after `#`; columns by name, Delta before Psi. Zones 1 to 4 repeat a measurement and
# are averaged, zone 0 is the instrument's own mean, zone 5 a spread. Regions of interest, places and times are data
# sets of their own.

NEEDED = {"lambda", "aoi", "delta", "psi"}
PLACE_MM = 0.25  # stage drift while the angle changes is below this distance
REPEATS, OWN_MEAN = (1, 2, 3, 4), 0


def sniff_accurion(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    for line in head.lines[:3]:
        if line.startswith("#") and set(_names_accurion(line)) >= NEEDED:
            return CERTAIN
    return 0.0


def _names_accurion(line: str) -> list[str]:
    return [name.strip().lower() for name in line.lstrip("#").split("\t" if "\t" in line else None)]


def read_accurion(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return one measurement per place and region of interest; repeats in zones are averaged.

    Raises:
        NacreError: no rows, or rows of different lengths.
    """
    lines = text_lines(path)
    start = next(i for i, line in enumerate(lines) if line.startswith("#") and set(_names_accurion(line)) >= NEEDED)
    names = _names_accurion(lines[start])
    units: dict[str, str] = {}
    rows = []
    for number, line in enumerate(lines[start + 1 :], start + 2):
        if line.startswith("#"):
            units = units or dict(zip(names, (unit.strip() for unit in _names_accurion(line))))
        elif line.strip():
            cells = line.split("\t") if "\t" in line else line.split()
            if len(cells) < len(names):
                raise NacreError(f"{path}: line {number} has {len(cells)} cells; the heading has {len(names)}")
            rows.append([_number(cell) for cell in cells[: len(names)]])
    if not rows:
        raise NacreError(f"{path}: contains no rows of data")
    table = dict(zip(names, np.array(rows).T))
    for angle in ("aoi", "delta", "psi"):
        if units.get(angle, "deg") not in ("deg", "\u00b0"):
            raise NacreError(f"{path}: {angle} is in {units[angle]!r}; allowed: deg")
    table["lambda"] = to_nm(table["lambda"], units.get("lambda", "nm"), str(path))
    left_out: list[str] = []
    rows_of = _data_sets(table)
    return [
        _data_set(path, {key: column[index] for key, column in table.items()}, name, options, left_out)
        for name, index in rows_of
    ]


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", "."))  # German exports have decimal commas
    except ValueError:
        return np.nan


def _data_sets(table: dict[str, Array]) -> list[tuple[str, NDArray[np.intp]]]:
    """Return name and row indices of each place and region of interest."""
    count = len(table["psi"])
    region = table.get("roiidx", np.zeros(count))
    place = np.zeros(count, dtype=int)
    centres: list[Array] = []
    if "x_pos" in table and "y_pos" in table:
        for i, at in enumerate(np.stack([table["x_pos"], table["y_pos"]], axis=1)):
            near = [j for j, centre in enumerate(centres) if np.max(np.abs(at - centre)) <= PLACE_MM]
            if not near:
                centres.append(at)
            place[i] = near[0] if near else len(centres) - 1
    found = []
    for r, p in sorted({(r, p) for r, p in zip(region.tolist(), place.tolist())}, key=lambda pair: (pair[1], pair[0])):
        name = [f"region {r:g}"] if len(set(region.tolist())) > 1 else []
        name += [f"x = {centres[p][0]:g} mm, y = {centres[p][1]:g} mm"] if len(centres) > 1 else []
        found.append((", ".join(name), np.flatnonzero((region == r) & (place == p))))
    return found


def _data_set(
    path: Path, table: dict[str, Array], name: str, options: ReadOptions, left_out: Sequence[str]
) -> Measurement:
    keys = list(zip(table["lambda"].tolist(), table["aoi"].tolist()))
    zone = table.get("zone")
    metadata: dict[str, object] = {}
    if "bandwidth" in table and np.isfinite(table["bandwidth"]).any():
        metadata["bandwidth_nm"] = float(np.nanmedian(table["bandwidth"]))
    notes, out = [], list(left_out)
    used = np.isfinite(table["psi"]) & np.isfinite(table["delta"])
    if zone is not None:
        repeats = np.isin(zone, REPEATS)
        used &= repeats if repeats.any() else zone == OWN_MEAN
        if repeats.any():
            notes.append("Psi and Delta are means over the zones 1 to 4")
        others = sorted(set(zone.tolist()) - set(REPEATS if repeats.any() else (OWN_MEAN,)))
        out += [f"zone {each:g} ({np.sum(zone == each)} rows)" for each in others]
        metadata["zones"] = int(len(set(zone[repeats].tolist()))) if repeats.any() else 1
    time = table.get("time")
    is_dynamic = time is not None and zone is None and len(set(zip(keys, time.tolist()))) > len(set(keys))
    if is_dynamic and time is not None:
        keys = [(w, a, t) for (w, a), t in zip(keys, time.tolist())]  # type: ignore[misc]  # a longer key
    groups: dict[tuple[float, ...], list[int]] = {}
    for i in np.flatnonzero(used):
        groups.setdefault(keys[i], []).append(int(i))
    if not groups:
        raise NacreError(f"{path}: contains no finite Psi and Delta")
    most = max(len(rows) for rows in groups.values())
    fewer = sum(len(rows) < most for rows in groups.values())
    if zone is not None and fewer:
        notes.append(f"{fewer} of {len(groups)} angles have fewer than {most} zones")
    psi, delta = table["psi"], table["delta"]
    means = [(np.mean(psi[i]), _mean_angle(delta[i])) for i in groups.values()]
    columns: dict[str, object] = {
        "wavelength_nm": [key[0] for key in groups], "angle_of_incidence_deg": [key[1] for key in groups],
        "psi_deg": [mean[0] for mean in means], "delta_deg": [mean[1] for mean in means],
    }  # fmt: skip
    if is_dynamic:
        columns["time_s"] = [key[2] for key in groups]
    if max(len(i) for i in groups.values()) > 1:
        columns["repeats"] = [len(i) for i in groups.values()]
        if zone is None:
            notes.append("rows of one wavelength and angle are averaged")
    return ellipsometry(
        path, "accurion", columns, options, maker="Accurion", name=name, metadata=metadata, assumed=notes, left_out=out
    )


def _mean_angle(values: Array) -> float:
    """Return the mean of angles in degrees near the first of them."""
    return float(values[0] + np.mean(180.0 - np.mod(180.0 - (values - values[0]), 360.0)))


# Text of the multi-wavelength ellipsometers FS-1 to FS-8 by Film Sense.
#
# `Film_Sense_Data`: counts and the incidence angle (negative in the file), one row per LED with its wavelength in nm
# first, then one row per LED of N, C, S, P and intensity. `Film_Sense_Dyn_Data`: the same rows of LEDs, then a table
# over time with columns such as `Blue_N`, `Blue_C`, `Blue_S`. N = cos 2Psi, C = sin 2Psi cos Delta, S = sin 2Psi sin
# Delta.

STATIC, DYNAMIC = "Film_Sense_Data", "Film_Sense_Dyn_Data"
COLUMN = re.compile(r"^(.+)_([NCSP])$")
MIN_ANGLE, MAX_ANGLE = 20.0, 90.0


def sniff_film_sense(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    return CERTAIN if head.lines and head.lines[0].strip() in (STATIC, DYNAMIC) else 0.0


def read_film_sense(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return N, C, S with Psi and Delta; over time for a dynamic file.

    Raises:
        NacreError: rows that the counts announce are missing.
        AmbiguousFileError: a dynamic file without the angle.
    """
    lines = [line for line in text_lines(path) if line.strip()]
    counts = numbers(lines[1]) if len(lines) > 1 else None
    if not counts or counts[0] < 1 or counts[0] != int(counts[0]):
        raise NacreError(f"{path}: line 2 must hold the number of wavelengths")
    many = int(counts[0])
    leds = [numbers(line) for line in lines[2 : 2 + many]]
    if len(leds) < many or any(row is None for row in leds):
        raise NacreError(f"{path}: line 2 announces {many} wavelengths; fewer rows follow")
    wavelengths = to_nm(np.array([row[0] for row in leds if row]), "nm", str(path))
    angles = [abs(value) for value in counts[1:] if value < 0 and MIN_ANGLE <= -value < MAX_ANGLE]
    if lines[0].strip() == DYNAMIC:
        return [_dynamic(path, lines[2 + many :], wavelengths, angles, options)]
    rows = [numbers(line) for line in lines[2 + many : 2 + 2 * many]]
    if len(rows) < many or any(row is None or len(row) < 4 for row in rows):
        raise NacreError(f"{path}: {many} rows of N, C, S and P must follow the wavelengths")
    table = np.array([row[:5] for row in rows if row])
    columns = {"wavelength_nm": wavelengths, "ncs_n": table[:, 0], "ncs_c": table[:, 1], "ncs_s": table[:, 2]}
    columns |= {"degree_of_polarisation": table[:, 3]}
    if table.shape[1] > 4:
        columns["intensity"] = table[:, 4]
    if angles:
        columns["angle_of_incidence_deg"] = np.full(many, angles[0])
    left_out = [f"{len(lines) - 2 - 2 * many} lines after the data"] if len(lines) > 2 + 2 * many else []
    notes = ["the angle of incidence is the absolute value of the angle in the file"] if angles else []
    return [ellipsometry(path, "film-sense", columns, options, maker="Film Sense", assumed=notes, left_out=left_out)]


def _dynamic(
    path: Path, lines: list[str], wavelengths: np.ndarray, angles: list[float], options: ReadOptions
) -> Measurement:
    names = [name.strip() for name in lines[0].split("\t" if "\t" in lines[0] else None)] if lines else []
    if not names or not names[0].lower().startswith("time"):
        raise NacreError(f"{path}: the heading of the table over time is missing")
    leds = list(dict.fromkeys(match[1] for name in names if (match := COLUMN.match(name))))
    if len(leds) != len(wavelengths):
        raise NacreError(f"{path}: columns of {len(leds)} LEDs for {len(wavelengths)} wavelengths")
    rows = []
    for number, line in enumerate(lines[1:], len(wavelengths) + 4):
        row = numbers(line)
        if row is None or len(row) != len(names):
            raise NacreError(f"{path}: line {number} does not hold {len(names)} numbers")
        rows.append(row)
    if not rows:
        raise NacreError(f"{path}: contains no rows of data")
    table = dict(zip(names, np.array(rows).T))
    columns = {"wavelength_nm": np.tile(wavelengths, len(rows)), "time_s": np.repeat(table[names[0]], len(leds))}
    for letter, name in (("N", "ncs_n"), ("C", "ncs_c"), ("S", "ncs_s"), ("P", "degree_of_polarisation")):
        if all(f"{led}_{letter}" in table for led in leds):
            columns[name] = np.stack([table[f"{led}_{letter}"] for led in leds], axis=1).ravel()
    if "ncs_c" not in columns or "ncs_s" not in columns:
        raise NacreError(f"{path}: the table has no columns of C and S; its columns are {', '.join(names)[:80]}")
    if angles:
        columns["angle_of_incidence_deg"] = np.full(len(columns["wavelength_nm"]), angles[0])
    left_out = [f"column {name}" for name in names[1:] if not COLUMN.match(name)]
    metadata = {"leds": dict(zip(leds, wavelengths.tolist())), "times": len(rows)}
    assumed = ["the time is in seconds", "the LEDs have the wavelengths of the head in the same order"]
    return ellipsometry(
        path, "film-sense", columns, options, maker="Film Sense", metadata=metadata, assumed=assumed, left_out=left_out
    )


# Text (.spe) of the ellipsometers by Horiba Jobin Yvon (DeltaPsi).
#
# Sections begin with `# NAME:` and end with an empty line: `INCIDENCE ANGLE` holds the angle, `DATA` a heading and
# rows. Columns are nm or eV, then Psi and Delta in degrees, or Is = sin 2Psi sin Delta and Ic = sin 2Psi cos Delta.

SECTION = re.compile(r"^#\s*([^:]+?)\s*:?\s*$")
NAMES = {"psi": "psi_deg", "delta": "delta_deg", "is": "ncs_s", "ic": "ncs_c"}
MUELLER = re.compile(r"m([1-4])([1-4])$")


def sniff_horiba(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    found = {match[1].upper() for line in head.lines[:400] if (match := SECTION.match(line))}
    if "DATA" not in found:
        return 0.0
    return CERTAIN if "INCIDENCE ANGLE" in found else LIKELY if head.path.suffix.lower() == ".spe" else 0.0


def read_horiba(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta, or C and S.

    Raises:
        NacreError: no unit, or columns without Psi and Delta.
        AmbiguousFileError: no angle.
    """
    sections: dict[str, list[tuple[int, str]]] = {}
    name = ""
    for number, line in enumerate(text_lines(path), 1):
        match = SECTION.match(line)
        if match:
            name = match[1].upper()
            sections.setdefault(name, [])
        elif line.strip() and name:
            sections[name].append((number, line.strip()))
    body = sections.get("DATA", [])
    if len(body) < 2:
        raise NacreError(f"{path}: the section DATA holds no rows")
    heading = [word.lower() for word in body[0][1].split()]
    if heading[0] not in UNITS:
        raise NacreError(f"{path}: the first column {heading[0]!r} is not a wavelength in a known unit")
    rows = []
    for number, line in body[1:]:
        row = numbers(line)
        if row is None:
            raise NacreError(f"{path}: line {number} is not a row of numbers: {line[:60]!r}")
        rows.append((number, row))
    table = same_length(path, rows)
    if table.shape[1] != len(heading):
        raise NacreError(f"{path}: the heading names {len(heading)} columns, the rows have {table.shape[1]}")
    columns = {"wavelength_nm": to_nm(table[:, 0], options.unit or heading[0], str(path))}
    left_out = []
    for i, word in enumerate(heading[1:], 1):
        key = NAMES.get(word, word if MUELLER.match(word) else None)
        if key is None:
            left_out.append(f"column {word}")
        else:
            columns[key] = table[:, i]
    if not {"psi_deg", "delta_deg"} <= set(columns) and not {"ncs_c", "ncs_s"} <= set(columns) and "m12" not in columns:
        raise NacreError(f"{path}: has neither Psi and Delta nor Is and Ic; its columns are {', '.join(heading)}")
    said = " ".join(line for _, line in sections.get("INCIDENCE ANGLE", []))
    angle = re.search(r"-?\d+(?:[.,]\d+)?", said)
    if angle:
        columns["angle_of_incidence_deg"] = np.full(len(table), float(angle[0].replace(",", ".")))
    metadata = {key.lower(): " ".join(text for _, text in part) for key, part in sections.items() if key != "DATA"}
    return [ellipsometry(path, "horiba", columns, options, maker="DeltaPsi", metadata=metadata, left_out=left_out)]


# Text of in-line tools and of regress-pro: rows after `SE`.
#
# `SE PSI DELTA` with a line `AOI 75.7`: the numbers are tan Psi and cos Delta. `SE ALPHA BETA` with a line `A 33`:
# Fourier coefficients of a rotating element with the other one at that azimuth: alpha = (t^2 - a^2) / (t^2 + a^2) and
# beta = 2 t a cos Delta / (t^2 + a^2), with t = tan Psi and a = tan A.

MAX_DEGREES = 5.0  # cos Delta stays within -1 .. 1; Delta in degrees does not


def sniff_regress_pro(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    words = head.lines[0].upper().split() if head.lines else []
    return CERTAIN if words in (["SE", "PSI", "DELTA"], ["SE", "ALPHA", "BETA"]) else 0.0


def read_regress_pro(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return tan Psi and cos Delta with Psi and Delta; the Delta sign is unknown.

    Raises:
        NacreError: rows that are not three numbers, or impossible values.
        AmbiguousFileError: a missing angle or azimuth.
    """
    lines = text_lines(path)
    is_fourier = "ALPHA" in lines[0].upper()
    stated: dict[str, float] = {}
    rows = []
    for number, line in enumerate(lines[1:], 2):
        words = line.split()
        if not words:
            continue
        text = words[1].replace(",", ".") if len(words) == 2 else " ".join(words[1:])
        values = numbers(text)
        if values is None:
            raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
        if words[0].upper() == "SE":
            rows.append((number, values))
        else:
            stated[words[0].upper()] = values[0]
    table = same_length(path, rows)
    if table.shape[1] != 3:
        raise NacreError(f"{path}: rows have {table.shape[1]} numbers; allowed: 3 (wavelength and two quantities)")
    columns = {"wavelength_nm": to_nm(table[:, 0], options.unit or "nm", str(path))}
    if "AOI" in stated:
        columns["angle_of_incidence_deg"] = np.full(len(table), stated["AOI"])
    notes = []
    if is_fourier:
        if "A" not in stated:
            raise AmbiguousFileError(f"{path}: the azimuth A of the analyser is missing; add a line A 45", "angle_deg")
        alpha, beta = table[:, 1], table[:, 2]
        within(path, "alpha", alpha, -1.0, 1.0)
        within(path, "beta", beta, -1.05, 1.05)
        root = np.sqrt(np.maximum(1.0 - alpha**2, 1e-300))
        columns |= {"alpha": alpha, "beta": beta}
        columns["tan_psi"] = np.abs(np.tan(np.radians(stated["A"]))) * np.sqrt(
            (1 + alpha) / np.maximum(1 - alpha, 1e-300)
        )
        columns["cos_delta"] = beta / root
        notes.append(f"alpha and beta are converted with the azimuth A = {stated['A']:g} degrees")
    elif np.max(np.abs(table[:, 2])) > MAX_DEGREES:
        columns |= {"psi_deg": table[:, 1], "delta_deg": table[:, 2]}
        notes.append("the numbers exceed those of tan Psi and cos Delta: they are taken as degrees")
    else:
        columns |= {"tan_psi": table[:, 1], "cos_delta": table[:, 2]}
        notes.append("the columns PSI and DELTA hold tan Psi and cos Delta: no cosine exceeds 1")
    metadata = {"unit_in_file": "nm", **{key.lower(): value for key, value in stated.items()}}
    return [ellipsometry(path, "regress-pro", columns, options, metadata=metadata, assumed=notes)]


# Text of SpectraRay by Sentech: Psi and Delta of several angles side by side, or Mueller matrices.
#
# `; WAVELENGTH 70.06 70.06` names the angle of each column after the wavelength in nm: an angle twice is Psi and Delta,
# sixteen times the Mueller matrix, row by row. Other programs write the same without the word and the semicolon.

HEAD_LINES = 10
HEADING = re.compile(r"^\s*;\s*(WAVELENGTH|ENERGY|WAVENUMBER)\b(.*)$", re.IGNORECASE)
BARE = re.compile(r"[ \t]*[\t,;]([\d.\t,; ]+)$")  # an empty cell, then the angles
MOST_PER_CENT, MOST_PSI_DEG = 110.0, 90.0
UNIT = {"WAVELENGTH": "nm", "ENERGY": "eV", "WAVENUMBER": "1/cm"}


def sniff_spectraray(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    for line in head.lines[:HEAD_LINES]:
        match = HEADING.match(line)
        if match and numbers(match[2]):
            return CERTAIN
    return LIKELY if _bare_angles(head.lines) else 0.0


def _bare_angles(lines: list[str]) -> list[float]:
    """Return the angles in a first line that holds each twice or sixteen times behind an empty cell."""
    match = BARE.match(lines[0].rstrip("\t,; ")) if len(lines) > 2 else None
    found = (numbers(match[1]) or []) if match else []
    sizes = {len(list(same)) for _, same in groupby(found)}
    below = numbers(lines[1].rstrip("\t,; ")) if found else None
    is_angles = len(sizes) == 1 and sizes <= {2, 16} and 0.0 < min(found) and max(found) < 90.0
    return found if is_angles and below is not None and len(below) == len(found) + 1 else []


def read_spectraray(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta angle by angle, or the Mueller matrices.

    Raises:
        NacreError: columns that are neither pairs nor sixteen per angle.
    """
    lines = text_lines(path)
    bare = _bare_angles(lines)
    start = 0 if bare else next((i for i, line in enumerate(lines) if HEADING.match(line)), None)
    if start is None:
        raise NacreError(f"{path}: has no heading of SpectraRay, such as ; WAVELENGTH 70 70")
    match = HEADING.match(lines[start])
    angles = bare or numbers(match[2] if match else "") or []
    rows = []
    for number, line in enumerate(lines[start + 1 :], start + 2):
        if line.strip() and not line.lstrip().startswith(";"):
            values = numbers(line.rstrip("\t,; ") if bare else line)
            if values is None:
                raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
            rows.append((number, values))
    table = same_length(path, rows)
    if table.shape[1] != len(angles) + 1:
        raise NacreError(f"{path}: the heading names {len(angles)} columns, the rows have {table.shape[1] - 1}")
    unit = UNIT[match[1].upper()] if match else options.unit or "nm"
    wavelength = to_nm(table[:, 0], unit, str(path))
    groups = [(angle, len(list(same))) for angle, same in groupby(angles)]
    sizes = {size for _, size in groups}
    count = sizes.pop() if len(sizes) == 1 else 0
    if count not in (2, 16):
        shown = ", ".join(f"{size} x {angle:g}" for angle, size in groups)
        raise NacreError(f"{path}: columns {shown}: allowed: 2 per angle (Psi, Delta) or 16 (Mueller matrix)")
    assumed = ["the wavelengths are in nm"] if bare and options.unit is None else []
    if bare and count == 2:
        second = table[:, 2::2]
        if options.quantity is None and (second.min() >= 0.0 and second.max() <= MOST_PER_CENT):
            said = "two columns of each angle without names may be Psi and Delta or two reflectances"
            raise AmbiguousFileError(f"{path}: {said}", "quantity", ("psi",))
        if table[:, 1::2].max() > MOST_PSI_DEG or table[:, 1::2].min() < 0.0:
            raise NacreError(f"{path}: the first column of an angle reaches {table[:, 1::2].max():g}; Psi is 0 to 90")
        assumed.append("of each angle the first column is Psi and the second Delta, in degrees")
    names = ["psi_deg", "delta_deg"] if count == 2 else [f"m{i}{j}" for i in range(1, 5) for j in range(1, 5)]
    cube = table[:, 1:].reshape(len(table), len(groups), count)
    columns = {
        "wavelength_nm": np.tile(wavelength, len(groups)),
        "angle_of_incidence_deg": np.repeat([angle for angle, _ in groups], len(table)),
        **{name: cube[:, :, i].T.ravel() for i, name in enumerate(names)},
    }
    maker = "" if bare else "SpectraRay"
    about = {"unit_in_file": unit}
    return [ellipsometry(path, "spectraray", columns, options, maker=maker, metadata=about, assumed=assumed)]


# CSV that `nacre ellipsometry -o` writes: canonical names as headings.

START = ("wavelength_nm", "angle_of_incidence_deg", "psi_deg", "delta_deg", "ncs_n")
DERIVED = ("pseudo_eps1", "pseudo_eps2", "reflectance")


def sniff_nacre_ellipsometry(head: FileHead) -> float:
    """Return 1 for the command's headings."""
    return CERTAIN if head.lines and tuple(_names_nacre_ellipsometry(head.lines[0])[: len(START)]) == START else 0.0


def _names_nacre_ellipsometry(line: str) -> list[str]:
    return [name.strip() for name in next(csv.reader([line]), [])]


def read_nacre_ellipsometry(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the quantities; derived ones are left out.

    Raises:
        NacreError: a row that is not as long as the heading.
    """
    lines = text_lines(path)
    names = _names_nacre_ellipsometry(lines[0])
    rows = []
    for number, line in enumerate(lines[1:], 2):
        if line.strip():
            row = numbers(line)
            if row is None or len(row) != len(names):
                raise NacreError(f"{path}: line {number} does not hold {len(names)} numbers")
            rows.append((number, row))
    table = same_length(path, rows)
    columns = {name: np.asarray(table[:, i]) for i, name in enumerate(names) if name not in DERIVED}
    left_out = [f"column {name}" for name in names if name in DERIVED]
    return [ellipsometry(path, "nacre-ellipsometry", columns, options, maker="nacre", left_out=left_out)]
