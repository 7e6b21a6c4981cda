"""Files of ellipsometers: Accurion, Film Sense, Horiba, regress-pro, SpectraRay, Woollam, NeXus, nacre's CSV."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.ellipsometry_units import (
    ellipsometry,
    folded,
    numbers,
    row_of,
    same_length,
    text_lines,
    to_nm,
    within,
)
from nacre.readers.hdf5 import HDF5_MAGIC, text_of
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.units import spectral_unit

# Text of the imaging ellipsometers EP3 and EP4 by Accurion (Park Systems).
#
# A heading and a unit line, both after `#`; columns by name, Delta before Psi. Zones 1 to 4 repeat a measurement and
# are averaged, zone 0 is the instrument's own mean, zone 5 a spread. Regions of interest, places and times are data
# sets of their own.

NEEDED = {"lambda", "aoi", "delta", "psi"}
PLACE_MM = 0.25  # stage drift while the angle changes is below this distance
REPEATS, OWN_MEAN = (1, 2, 3, 4), 0


def sniff_accurion(head: FileHead) -> float:
    """Return the confidence that a file has this format."""
    return CERTAIN if _heading_accurion(head.lines[:3]) is not None else 0.0


def _heading_accurion(lines: Sequence[str]) -> int | None:
    """Return the place of the line that names the columns."""
    places = (place for place, line in enumerate(lines) if line.startswith("#"))
    return next((place for place in places if set(_names_accurion(lines[place])) >= NEEDED), None)


def _names_accurion(line: str) -> list[str]:
    return [name.strip().lower() for name in line.lstrip("#").split("\t" if "\t" in line else None)]


def read_accurion(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return one measurement per place and region of interest; repeats in zones are averaged.

    Raises:
        NacreError: rows are missing or have different lengths.
    """
    lines = text_lines(path)
    start = _heading_accurion(lines) or 0
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
    return [
        _data_set(path, {key: column[index] for key, column in table.items()}, name, options)
        for name, index in _data_sets(table)
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
    sets = []
    for p, r in sorted(set(zip(place.tolist(), region.tolist()))):
        name = [f"region {r:g}"] if len(set(region.tolist())) > 1 else []
        name += [f"x = {centres[p][0]:g} mm, y = {centres[p][1]:g} mm"] if len(centres) > 1 else []
        sets.append((", ".join(name), np.flatnonzero((region == r) & (place == p))))
    return sets


def _data_set(path: Path, table: dict[str, Array], name: str, options: ReadOptions) -> Measurement:
    keys: list[tuple[float, ...]] = list(zip(table["lambda"].tolist(), table["aoi"].tolist()))
    zone = table.get("zone")
    metadata: dict[str, object] = {}
    if "bandwidth" in table and np.isfinite(table["bandwidth"]).any():
        metadata["bandwidth_nm"] = float(np.nanmedian(table["bandwidth"]))
    notes, left_out = [], []
    used = np.isfinite(table["psi"]) & np.isfinite(table["delta"])
    if zone is not None:
        repeats = np.isin(zone, REPEATS)
        used &= repeats if repeats.any() else zone == OWN_MEAN
        if repeats.any():
            notes.append("Psi and Delta are means over the zones 1 to 4")
        others = sorted(set(zone.tolist()) - set(REPEATS if repeats.any() else (OWN_MEAN,)))
        left_out += [f"zone {each:g} ({np.sum(zone == each)} rows)" for each in others]
        metadata["zones"] = int(len(set(zone[repeats].tolist()))) if repeats.any() else 1
    time = table.get("time")
    is_dynamic = time is not None and zone is None and len(set(zip(keys, time.tolist()))) > len(set(keys))
    if is_dynamic and time is not None:
        keys = [(*key, t) for key, t in zip(keys, time.tolist())]
    groups: dict[tuple[float, ...], list[int]] = {}
    for i in np.flatnonzero(used):
        groups.setdefault(keys[i], []).append(int(i))
    if not groups:
        raise NacreError(f"{path}: contains no finite Psi and Delta")
    most = max(len(rows) for rows in groups.values())
    fewer = sum(len(rows) < most for rows in groups.values())
    if zone is not None and fewer:
        notes.append(f"{fewer} of {len(groups)} angles have fewer than {most} zones")
    deltas = [table["delta"][i] for i in groups.values()]
    columns: dict[str, object] = {
        "wavelength_nm": [key[0] for key in groups], "angle_of_incidence_deg": [key[1] for key in groups],
        "psi_deg": [np.mean(table["psi"][i]) for i in groups.values()],
        "delta_deg": [delta[0] + np.mean(folded(delta - delta[0])) for delta in deltas],
    }  # fmt: skip
    if is_dynamic:
        columns["time_s"] = [key[2] for key in groups]
    if most > 1:
        columns["repeats"] = [len(i) for i in groups.values()]
        if zone is None:
            notes.append("rows of one wavelength and angle are averaged")
    return ellipsometry(
        path, columns, options, maker="Accurion", name=name, metadata=metadata, assumed=notes, left_out=left_out
    )


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
    """Return the confidence that a file has this format."""
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
    leds = [row for line in lines[2 : 2 + many] if (row := numbers(line))]
    if len(leds) < many:
        raise NacreError(f"{path}: line 2 announces {many} wavelengths; fewer rows follow")
    wavelengths = to_nm(np.array([row[0] for row in leds]), "nm", str(path))
    angles = [-value for value in counts[1:] if MIN_ANGLE <= -value < MAX_ANGLE]
    if lines[0].strip() == DYNAMIC:
        return [_dynamic(path, lines[2 + many :], wavelengths, angles, options)]
    rows = [row[:5] for line in lines[2 + many : 2 + 2 * many] if len(row := numbers(line) or []) > 3]
    if len(rows) < many:
        raise NacreError(f"{path}: {many} rows of N, C, S and P must follow the wavelengths")
    table = np.array(rows)
    columns = {"wavelength_nm": wavelengths, "ncs_n": table[:, 0], "ncs_c": table[:, 1], "ncs_s": table[:, 2]}
    columns |= {"degree_of_polarisation": table[:, 3]}
    if table.shape[1] > 4:
        columns["intensity"] = table[:, 4]
    if angles:
        columns["angle_of_incidence_deg"] = np.full(many, angles[0])
    left_out = [f"{len(lines) - 2 - 2 * many} lines after the data"] if len(lines) > 2 + 2 * many else []
    notes = ["the angle of incidence is the absolute value of the angle in the file"] if angles else []
    return [ellipsometry(path, columns, options, maker="Film Sense", assumed=notes, left_out=left_out)]


def _dynamic(
    path: Path, lines: list[str], wavelengths: np.ndarray, angles: list[float], options: ReadOptions
) -> Measurement:
    names = [name.strip() for name in lines[0].split("\t" if "\t" in lines[0] else None)] if lines else []
    if not names or not names[0].lower().startswith("time"):
        raise NacreError(f"{path}: the heading of the table over time is missing")
    leds = list(dict.fromkeys(match[1] for name in names if (match := COLUMN.match(name))))
    if len(leds) != len(wavelengths):
        raise NacreError(f"{path}: columns of {len(leds)} LEDs for {len(wavelengths)} wavelengths")
    rows = _rows_of(path, lines[1:], len(wavelengths) + 4, len(names))
    table = dict(zip(names, rows.T))
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
        path, columns, options, maker="Film Sense", metadata=metadata, assumed=assumed, left_out=left_out
    )


def _rows_of(path: Path, lines: Sequence[str], first: int, count: int) -> Array:
    """Return rows of `count` numbers; the first line has the number `first`, and empty lines are left out."""
    rows = [(number, numbers(line) or []) for number, line in enumerate(lines, first) if line.strip()]
    for number, row in rows:
        if len(row) != count:
            raise NacreError(f"{path}: line {number} does not hold {count} numbers")
    return same_length(path, rows)


# Text (.spe) of the ellipsometers by Horiba Jobin Yvon (DeltaPsi).
#
# Sections begin with `# NAME:` and end with an empty line: `INCIDENCE ANGLE` holds the angle, `DATA` a heading and
# rows. Columns are nm or eV, then Psi and Delta in degrees, or Is = sin 2Psi sin Delta and Ic = sin 2Psi cos Delta.

SECTION = re.compile(r"^#\s*([^:]+?)\s*:?\s*$")
NAMES = {"psi": "psi_deg", "delta": "delta_deg", "is": "ncs_s", "ic": "ncs_c"}
MUELLER = [f"m{i}{j}" for i in range(1, 5) for j in range(1, 5)]


def sniff_horiba(head: FileHead) -> float:
    """Return the confidence that a file has this format."""
    names = {match[1].upper() for line in head.lines[:400] if (match := SECTION.match(line))}
    if "DATA" not in names:
        return 0.0
    return CERTAIN if "INCIDENCE ANGLE" in names else LIKELY if head.path.suffix.lower() == ".spe" else 0.0


def read_horiba(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta, or C and S.

    Raises:
        NacreError: the unit is missing, or the columns lack Psi and Delta.
        AmbiguousFileError: the angle is missing.
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
    if spectral_unit(heading[0]) is None:
        raise NacreError(f"{path}: the first column {heading[0]!r} is not a wavelength in a known unit")
    table = same_length(path, [(number, row_of(path, number, line)) for number, line in body[1:]])
    if table.shape[1] != len(heading):
        raise NacreError(f"{path}: the heading names {len(heading)} columns, the rows have {table.shape[1]}")
    columns = {"wavelength_nm": to_nm(table[:, 0], options.unit or heading[0], str(path))}
    left_out = []
    for i, word in enumerate(heading[1:], 1):
        key = NAMES.get(word, word if word in MUELLER else None)
        if key is None:
            left_out.append(f"column {word}")
        else:
            columns[key] = table[:, i]
    if not {"psi_deg", "delta_deg"} <= set(columns) and not {"ncs_c", "ncs_s"} <= set(columns) and "m12" not in columns:
        raise NacreError(f"{path}: has neither Psi and Delta nor Is and Ic; its columns are {', '.join(heading)}")
    del sections["DATA"]
    metadata = {key.lower(): " ".join(text for _, text in part) for key, part in sections.items()}
    angle = re.search(r"-?\d+(?:[.,]\d+)?", metadata.get("incidence angle", ""))
    if angle:
        columns["angle_of_incidence_deg"] = np.full(len(table), float(angle[0].replace(",", ".")))
    return [ellipsometry(path, columns, options, maker="DeltaPsi", metadata=metadata, left_out=left_out)]


# Text of in-line tools and of regress-pro: rows after `SE`.
#
# `SE PSI DELTA` with a line `AOI 75.7`: the numbers are tan Psi and cos Delta. `SE ALPHA BETA` with a line `A 33`:
# Fourier coefficients of a rotating element with the other one at that azimuth: alpha = (t^2 - a^2) / (t^2 + a^2) and
# beta = 2 t a cos Delta / (t^2 + a^2), with t = tan Psi and a = tan A.

MAX_DEGREES = 5.0  # cos Delta stays within -1 .. 1; Delta in degrees does not


def sniff_regress_pro(head: FileHead) -> float:
    """Return the confidence that a file has this format."""
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
        values = row_of(path, number, line, text)
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
        tangent = np.abs(np.tan(np.radians(stated["A"])))
        tan_psi = tangent * np.sqrt((1 + alpha) / np.maximum(1 - alpha, 1e-300))
        columns |= {"alpha": alpha, "beta": beta, "tan_psi": tan_psi, "cos_delta": beta / root}
        notes.append(f"alpha and beta are converted with the azimuth A = {stated['A']:g} degrees")
    elif np.max(np.abs(table[:, 2])) > MAX_DEGREES:
        columns |= {"psi_deg": table[:, 1], "delta_deg": table[:, 2]}
        notes.append("the numbers exceed those of tan Psi and cos Delta: they are taken as degrees")
    else:
        columns |= {"tan_psi": table[:, 1], "cos_delta": table[:, 2]}
        notes.append("the columns PSI and DELTA hold tan Psi and cos Delta: no cosine exceeds 1")
    metadata = {"unit_in_file": "nm", **{key.lower(): value for key, value in stated.items()}}
    return [ellipsometry(path, columns, options, metadata=metadata, assumed=notes)]


# Text of SpectraRay by Sentech: Psi and Delta of several angles side by side, or Mueller matrices.
#
# `; WAVELENGTH 70.06 70.06` names the angle of each column after the wavelength in nm: an angle twice is Psi and Delta,
# sixteen times the Mueller matrix, row by row. Other programs write the same without the word and the semicolon.

HEAD_LINES = 10
HEADING = re.compile(r"^\s*;\s*(WAVELENGTH|ENERGY|WAVENUMBER)\b(.*)$", re.IGNORECASE)
ANGLES_ONLY = re.compile(r"[ \t]*[\t,;]([\d.\t,; ]+)$")  # an empty cell, then the angles
MOST_PER_CENT, MOST_PSI_DEG = 110.0, 90.0
UNIT = {"WAVELENGTH": "nm", "ENERGY": "eV", "WAVENUMBER": "1/cm"}


def sniff_spectraray(head: FileHead) -> float:
    """Return the confidence that a file has this format."""
    for line in head.lines[:HEAD_LINES]:
        match = HEADING.match(line)
        if match and numbers(match[2]):
            return CERTAIN
    return LIKELY if _unnamed_angles(head.lines) else 0.0


def _unnamed_angles(lines: list[str]) -> list[float]:
    """Return the angles in a first line that holds each twice or sixteen times behind an empty cell."""
    match = ANGLES_ONLY.match(lines[0].rstrip("\t,; ")) if len(lines) > 2 else None
    angles = (numbers(match[1]) or []) if match else []
    sizes = {len(list(same)) for _, same in groupby(angles)}
    below = (numbers(lines[1].rstrip("\t,; ")) or []) if angles else []
    is_repeated = len(sizes) == 1 and sizes <= {2, 16}
    return angles if is_repeated and 0.0 < min(angles) <= max(angles) < 90.0 and len(below) == len(angles) + 1 else []


def read_spectraray(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta angle by angle, or the Mueller matrices.

    Raises:
        NacreError: columns that are neither pairs nor sixteen per angle.
    """
    lines = text_lines(path)
    unnamed = _unnamed_angles(lines)
    start = 0 if unnamed else next((i for i, line in enumerate(lines) if HEADING.match(line)), None)
    if start is None:
        raise NacreError(f"{path}: has no heading of SpectraRay, such as ; WAVELENGTH 70 70")
    match = HEADING.match(lines[start])
    angles = unnamed or numbers(match[2] if match else "") or []
    rows = [
        (number, row_of(path, number, line, line.rstrip("\t,; ") if unnamed else line))
        for number, line in enumerate(lines[start + 1 :], start + 2)
        if line.strip() and not line.lstrip().startswith(";")
    ]
    table = same_length(path, rows)
    if table.shape[1] != len(angles) + 1:
        raise NacreError(f"{path}: the heading names {len(angles)} columns, the rows have {table.shape[1] - 1}")
    unit = UNIT[match[1].upper()] if match else options.unit or "nm"
    wavelength = to_nm(table[:, 0], unit, str(path))
    groups = [(angle, len(list(same))) for angle, same in groupby(angles)]
    sizes = {size for _, size in groups}
    count = sizes.pop() if len(sizes) == 1 else 0
    if count not in (2, 16):
        counts = ", ".join(f"{size} x {angle:g}" for angle, size in groups)
        raise NacreError(f"{path}: columns {counts}: allowed: 2 per angle (Psi, Delta) or 16 (Mueller matrix)")
    assumed = ["the wavelengths are in nm"] if unnamed and options.unit is None else []
    if unnamed and count == 2:
        psi, delta = table[:, 1::2], table[:, 2::2]
        if options.quantity is None and (delta.min() >= 0.0 and delta.max() <= MOST_PER_CENT):
            problem = "two columns of each angle without names may be Psi and Delta or two reflectances"
            raise AmbiguousFileError(f"{path}: {problem}", "quantity", ("psi",))
        if psi.max() > MOST_PSI_DEG or psi.min() < 0.0:
            raise NacreError(f"{path}: the first column of an angle reaches {psi.max():g}; Psi is 0 to 90")
        assumed.append("of each angle the first column is Psi and the second Delta, in degrees")
    names = ["psi_deg", "delta_deg"] if count == 2 else MUELLER
    cube = table[:, 1:].reshape(len(table), len(groups), count)
    columns = {
        "wavelength_nm": np.tile(wavelength, len(groups)),
        "angle_of_incidence_deg": np.repeat([angle for angle, _ in groups], len(table)),
        **{name: cube[:, :, i].T.ravel() for i, name in enumerate(names)},
    }
    maker = "" if unnamed else "SpectraRay"
    return [ellipsometry(path, columns, options, maker=maker, metadata={"unit_in_file": unit}, assumed=assumed)]


# CSV that `nacre ellipsometry -o` writes: canonical names as headings.

START = ("wavelength_nm", "angle_of_incidence_deg", "psi_deg", "delta_deg", "ncs_n")
DERIVED = ("pseudo_eps1", "pseudo_eps2", "reflectance")


def sniff_nacre_ellipsometry(head: FileHead) -> float:
    """Return 1 for headings that nacre writes."""
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
    table = _rows_of(path, lines[1:], 2, len(names))
    columns = {name: np.asarray(table[:, i]) for i, name in enumerate(names) if name not in DERIVED}
    left_out = [f"column {name}" for name in names if name in DERIVED]
    return [ellipsometry(path, columns, options, maker="nacre", left_out=left_out)]


# NeXus files (HDF5) of the application definition NXellipsometry, in its two drafts.
#
# Older draft: `sample/measured_data` [1, 1, angle, psi or delta, wavelength]; later: `data_collection/measured_data`
# [angle, psi or delta, wavelength]. Units come from the attribute `units`; a wavelength without one is in angstrom.

DATA = ("sample/measured_data", "data_collection/measured_data")
TYPES = ("sample/data_type", "data_collection/data_type")
WAVELENGTHS = (
    "instrument/spectrometer/wavelength", "data_collection/wavelength_spectrum", "data_collection/wavelength",
)  # fmt: skip
ANGLES = ("instrument/angle_of_incidence", "data_collection/angle_of_incidence")
ERRORS = ("sample/data_error", "data_collection/data_error")
NEXUS_NAMES = (
    "sample/sample_name", "sample/name", "sample/layer_structure", "instrument/company", "instrument/model",
    "start_time",
)  # fmt: skip
COLUMNS = ("sample/column_names", "data_collection/column_names")


def sniff_nexus_ellipsometry(head: FileHead) -> float:
    """Return the confidence that a file has this format."""
    if not head.data.startswith(HDF5_MAGIC):
        return 0.0
    import h5py

    try:
        with h5py.File(head.path, "r") as file:
            return CERTAIN if any(_is_ellipsometry(entry) for entry in file.values()) else 0.0
    except OSError:
        return 0.0


def _is_ellipsometry(entry: Any) -> bool:
    return hasattr(entry, "get") and any(path in entry for path in DATA) and any(path in entry for path in ANGLES)


def read_nexus_ellipsometry(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return one measurement per entry, angle by angle.

    Raises:
        NacreError: another data type than Psi and Delta or Mueller matrices, or shapes that do not agree.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            entries = [(name, entry) for name, entry in file.items() if _is_ellipsometry(entry)]
            return [_entry(path, entry, name if len(entries) > 1 else "", options) for name, entry in entries]
    except OSError as error:
        raise NacreError(f"{path}: cannot be read as HDF5: {error}") from None


def _first(entry: Any, paths: tuple[str, ...]) -> Any:
    return next((entry[each] for each in paths if each in entry), None)


def _entry(path: Path, entry: Any, name: str, options: ReadOptions) -> Measurement:
    data, wavelength, angle = (_first(entry, each) for each in (DATA, WAVELENGTHS, ANGLES))
    if wavelength is None:
        raise NacreError(f"{path}: the wavelengths are missing; known places: {', '.join(WAVELENGTHS)}")
    texts = {each: text_of(entry[each][()]) for each in (*TYPES, *NEXUS_NAMES) if each in entry}
    kind = next(filter(None, map(texts.get, TYPES)), "").lower().replace(" ", "")
    unit = str(wavelength.attrs.get("units", "")).lower()
    notes = []
    if spectral_unit(unit) is None:
        unit = options.unit or "angstrom"
        notes.append(f"the wavelength is in {unit}: the file names no unit")
    waves = to_nm(np.atleast_1d(wavelength[()]), unit, str(path))
    angles = np.atleast_1d(np.asarray(angle[()], dtype=float))
    names = {
        "psi/delta": ["psi_deg", "delta_deg"], "tan(psi)/cos(delta)": ["tan_psi", "cos_delta"],
        "muellermatrix": MUELLER, "mueller": MUELLER,
    }.get(kind)  # fmt: skip
    if names is None:
        raise NacreError(
            f"{path}: data_type = {kind!r} is not known; allowed: psi/delta, tan(psi)/cos(delta), Mueller matrix"
        )
    columns_of = _first(entry, COLUMNS)
    if columns_of is not None and kind == "psi/delta":
        words = [text_of(each).lower() for each in np.ravel(columns_of[()])]
        if sorted(words) == ["delta", "psi"]:
            names = [f"{word}_deg" for word in words]
    table = np.asarray(data[()], dtype=float)
    shape = (len(angles), len(names), len(waves))
    if table.size != np.prod(shape) or table.shape[-1] != len(waves):
        raise NacreError(
            f"{path}: measured_data has the shape {table.shape}; expected {shape} (angle, quantity, wavelength)"
        )
    table = table.reshape(shape)
    columns = {
        "wavelength_nm": np.tile(waves, len(angles)), "angle_of_incidence_deg": np.repeat(angles, len(waves)),
        **{key: table[:, i].ravel() for i, key in enumerate(names)},
    }  # fmt: skip
    errors = _first(entry, ERRORS)
    if errors is not None and getattr(errors, "shape", ()) == data.shape:
        spread = np.asarray(errors[()], dtype=float).reshape(shape)
        columns |= {f"{key}_error": spread[:, i].ravel() for i, key in enumerate(names)}
    stated = {each: text for each in NEXUS_NAMES if (text := texts.get(each, "")) not in ("", "NOT_PROVIDED")}
    metadata = {each.rpartition("/")[2]: text for each, text in stated.items()}
    metadata["unit_in_file"] = unit
    maker = metadata.get("company", "NXellipsometry")
    return ellipsometry(
        path, columns, options, maker=maker, name=name, metadata=metadata, assumed=notes, is_binary=True
    )


# Woollam WVASE and CompleteEASE: data files and text exports.

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
# AnE: r_pp / r_ss of an anisotropic sample, beside Aps = r_ps / r_pp and Asp = r_sp / r_ss
PSI_DELTA = ("", "e", "ane")
ROW = re.compile(r"\s*([A-Za-z]\w*)?\s*[-+.\deE]+\s+[-+.\deE]+\s+[-+.\d]")
WOOLLAM_MUELLER = re.compile(r"mm([1-4])([1-4])$")


def sniff_woollam_dat(head: FileHead) -> float:
    """Return the confidence that a file is a Woollam data file."""
    if not any(line.startswith("VASEmethod[") for line in head.lines[:WOOLLAM_DAT_HEAD_LINES]):
        return 0.0
    words = {(match[1] or "").lower() for line in head.lines if (match := ROW.match(line))}
    return 0.9 if words and words <= set(POWERS) else CERTAIN  # powers alone are spectra


def read_woollam_dat(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta, then each further quantity as a measurement of its own.

    Raises:
        NacreError: unit or rows are missing, or values are impossible.
    """
    lines = text_lines(path)
    start = next(i for i, line in enumerate(lines) if line.startswith("VASEmethod["))
    unit, trig, first = "", False, start + 1
    for i, line in enumerate(lines[start + 1 : start + WOOLLAM_DAT_HEAD_LINES], start + 1):
        words = line.split()
        if words and spectral_unit(words[0]):
            unit, trig, first = words[0], "TRIG" in line.upper().split(), i + 1
            break
    if not unit:
        raise NacreError(f"{path}: the line with the unit (nm, Angstroms or eV) is missing")
    rows_of = _rows(path, lines, first)
    metadata = {"comment": lines[0].strip() if start else "", "method": lines[start].strip(), "unit_in_file": unit}
    if "TransmissionMeas=1" in lines[start]:
        metadata["light"] = "transmitted (TransmissionMeas=1)"
    readable = {*PSI_DELTA, DEPOLARISATION, *POWERS}
    left_out = [
        f"{len(rows)} rows of {word}"
        for word, rows in rows_of.items()
        if word not in readable and not WOOLLAM_MUELLER.match(word)
    ]
    results = []
    for word, rows in rows_of.items():
        if word in PSI_DELTA:
            columns = psi_delta_columns(path, same_length(path, rows), unit, trig)
            results.append(
                ellipsometry(path, columns, options, maker=WOOLLAM_DAT_MAKER, metadata=metadata, left_out=left_out)
            )
    results += _mueller(path, rows_of, unit, options, metadata)
    for word, rows in rows_of.items():
        if word in POWERS or word == DEPOLARISATION:
            results.append(_other(path, word, same_length(path, rows), unit, metadata))
    if not results:
        raise NacreError(f"{path}: contains no rows of Psi and Delta; it has {', '.join(left_out) or 'no rows'}")
    return results


def _rows(path: Path, lines: Sequence[str], first: int) -> dict[str, list[tuple[int, list[float]]]]:
    """Return numbered rows by their leading word in lower case ("" for none)."""
    rows: dict[str, list[tuple[int, list[float]]]] = {}
    for number, line in enumerate(lines[first:], first + 1):
        match = re.match(r"\s*([A-Za-z]\w*)?\s*(.*)$", line)
        if match and line.strip():
            rows.setdefault((match[1] or "").lower(), []).append((number, row_of(path, number, line, match[2])))
    return rows


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
    rows_of: dict[str, list[tuple[int, list[float]]]],
    unit: str,
    options: ReadOptions,
    metadata: dict[str, str],
) -> list[Measurement]:
    """Return the elements of the Mueller matrix, relative to m11, as one measurement."""
    elements = {word: same_length(path, rows) for word, rows in rows_of.items() if WOOLLAM_MUELLER.match(word)}
    if not elements:
        return []
    first = next(iter(elements.values()))
    columns = {"wavelength_nm": to_nm(first[:, 0], unit, str(path)), "angle_of_incidence_deg": first[:, 1]}
    for word, table in elements.items():
        if table.shape[0] != first.shape[0] or np.any(table[:, :2] != first[:, :2]):
            raise NacreError(f"{path}: {word} is given at other wavelengths or angles than the other elements")
        columns[f"m{word[2:]}"] = table[:, 2]
        if table.shape[1] == 6:  # two values, then their standard deviations
            columns[f"m{word[2:]}_error"] = table[:, 4]
        elif table.shape[1] > 3:
            columns[f"m{word[2:]}_error"] = table[:, 3]
    columns.setdefault("m11", np.ones(len(first)))
    return [ellipsometry(path, columns, options, maker=WOOLLAM_DAT_MAKER, metadata=metadata)]


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
    if not polarisation:
        return Measurement(path, "ellipsometry", data, word, metadata)
    return Measurement(path, "spectrum", data, word, {**metadata, "polarisation": polarisation})


# Text exports of WVASE: wavelength, incidence angle, Psi and Delta, with or without a heading.
#
# The heading is a unit and names (`nm aoi Psi Delta`); a blank may stand for a tab, the name of the angle may be
# missing, and `TRIG` says that the columns are tan Psi and cos Delta. Lines before the heading are comments.

WOOLLAM_TEXT_HEAD_LINES = 10
WITH_HEADING, WITHOUT_HEADING = 0.9, 0.5
WOOLLAM_ANGLES = re.compile(r"^(aoi|angle)$", re.IGNORECASE)


def sniff_woollam_text(head: FileHead) -> float:
    """Return the confidence that a file has this format."""
    if _heading(head.lines) is not None:
        return WITH_HEADING
    lines = head.lines[:-1] if head.size > len(head.data) else head.lines  # the last line may be cut
    rows = [numbers(line) for line in lines if line.strip()] or [None]
    if any(row is None or len(row) not in (4, 6) for row in rows):
        return 0.0
    table = np.array([row[:4] for row in rows if row], dtype=float)
    return WITHOUT_HEADING if len(table) > 3 and _may_be_psi_delta(table) else 0.0


def _heading(lines: list[str]) -> tuple[int, str, bool] | None:
    """Return line number, unit, and whether the columns are tan Psi and cos Delta."""
    for i, line in enumerate(lines[:WOOLLAM_TEXT_HEAD_LINES]):
        words = line.split()
        if re.fullmatch(r"\t\s*(aoi|angle)\s+psi\s+delta\s*", line, re.IGNORECASE):
            return i, "", False  # the wavelength has no name
        if not words or spectral_unit(words[0]) is None or numbers(line) is not None:
            continue
        rest = [word.lower() for word in words[1:]]
        if "trig" in rest:
            return i, words[0], True
        cells = [cell.strip().lower() for cell in line.split("\t")]
        if len(cells) > 3 and cells[2:4] != ["psi", "delta"]:
            continue  # the columns have another order
        names = [word for word in rest if not WOOLLAM_ANGLES.match(word)]
        if names[:2] == ["psi", "delta"] and ("\t" in line or len(rest) == 3):
            return i, words[0], False
    return None


def _may_be_psi_delta(table: np.ndarray) -> bool:
    """Whether four unnamed columns are wavelength, a few incidence angles, Psi and Delta."""
    wavelength, angle, psi, delta = table.T
    in_range = (wavelength > 0.1) & (wavelength < 60_000) & (angle > 10) & (angle < 90)
    in_range &= (psi >= 0) & (psi <= 90) & (delta >= -180) & (delta <= 360)
    pairs = len(np.unique(table[:, :2], axis=0))
    is_grid = pairs == len(table) and len(np.unique(wavelength)) * len(np.unique(angle)) <= 2 * len(table)
    return is_grid and bool(in_range.all())


def read_woollam_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta.

    Raises:
        NacreError: rows of different lengths, or impossible values.
    """
    lines = text_lines(path)
    heading = _heading(lines)
    assumed: list[str] = []
    line, unit, trig = heading or (-1, "", False)
    first, unit = line + 1, options.unit or unit
    if not unit:
        values = [row[0] for text in lines if (row := numbers(text))]
        unit = "eV" if values and max(values) < 20 else "nm" if values and max(values) <= 3000 else "angstrom"
        assumed.append(f"the first column has no heading: the wavelength in {unit}")
    if heading is None:
        assumed.append("the file has no heading: the columns are taken as wavelength, angle of incidence, Psi, Delta")
    numbered = enumerate(lines[first:], first + 1)
    rows = [(number, row_of(path, number, text)) for number, text in numbered if text.strip()]
    columns = psi_delta_columns(path, same_length(path, rows), unit, trig)
    metadata = {"unit_in_file": unit, "comment": " ".join(lines[: max(first - 1, 0)]).strip()}
    return [ellipsometry(path, columns, options, maker="WVASE", metadata=metadata, assumed=assumed)]
