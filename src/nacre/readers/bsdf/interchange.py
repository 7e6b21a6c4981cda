"""Interchange formats of scatter data: ASTM E1392, SSDD, universal BRDF (JSON), WINDOW XML, Speos."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array, angles_deg
from nacre.core.errors import NacreError
from nacre.readers.bsdf import gonio_table
from nacre.readers.bsdf.gonio_table import axis, measurement, numbers, pairs_of
from nacre.readers.bsdf.ray_tracers import scatter_direction
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.text_table import load_bytes, load_text, row_of_numbers

# ASTM E1392 text: `NUM_POINTS`, `VARS=theta_i,phi_i,theta_s,phi_s,...`, then comma-separated rows.
#
# Other variables are values: one, R, G, B, X, Y, Z, or wavelengths such as 550nm. The standard's files hold angles in
# radians; files in degrees exist and are recognised by their range.

ASTM_E1392_ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")
_VARS = re.compile(r"\s*VARS\s*[= ]\s*(.*)", re.IGNORECASE)
_WAVE = re.compile(r"[a-z_ ]*(\d+(?:\.\d+)?)\s*(nm|um)", re.IGNORECASE)


def sniff_astm_e1392(head: FileHead) -> float:
    """Recognise the line of variables."""
    return CERTAIN if any(re.match(r"\s*VARS\s*=?\s*theta_i", line, re.IGNORECASE) for line in head.lines) else 0.0


def read_astm_e1392(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the pairs.

    Raises:
        NacreError: the head or a row is invalid, or the row count contradicts NUM_POINTS.
    """
    lines = load_text(path).splitlines()
    start, match = next(((i, match) for i, line in enumerate(lines) if (match := _VARS.match(line))), (0, None))
    if match is None:
        raise NacreError(f"{path}: has no line VARS=theta_i,phi_i,theta_s,phi_s,...")
    names = [name.strip() for name in match[1].split(",") if name.strip()]
    if tuple(n.lower() for n in names[:4]) != ASTM_E1392_ANGLES or len(names) < 5:
        raise NacreError(f"{path}: VARS = {','.join(names)[:80]} is not theta_i,phi_i,theta_s,phi_s and values")
    table = _rows(path, lines, start + 1, len(names))
    count = next((int(m[1]) for line in lines[:start] if (m := re.match(r"\s*NUM_POINTS\s*=?\s*(\d+)", line))), None)
    if count is not None and count != len(table):
        raise NacreError(f"{path}: NUM_POINTS = {count}, but the file has {len(table)} rows")
    is_degrees = options.unit == "deg" or (
        options.unit != "rad" and float(np.abs(table[:, [0, 2]]).max()) > np.pi / 2 * (1 + 1e-3)
    )
    angles = table[:, :4] if is_degrees else np.degrees(table[:, :4])
    assumed = [f"angles are in {'degrees' if is_degrees else 'radians'} by their range"] if options.unit is None else []
    angles = gonio_table.unsigned(angles)
    colour, waves, notes = _channels(path, names[4:])
    head = [line.strip() for line in lines[:start] if line.strip()]
    scatter = "btdf" if any("btdf" in n.lower() for n in names[4:]) else "brdf"
    metadata = {"scatter": scatter, "vars": names, "head": head}
    return [measurement(path, angles, waves, table[:, 4:], metadata, colour=colour, assumed=[*assumed, *notes])]


def _rows(path: Path, lines: list[str], start: int, width: int) -> Array:
    table = []
    for number, line in enumerate(lines[start:], start=start + 1):
        cells = [cell for cell in re.split(r"[,;\s]+", line.strip()) if cell]
        if not cells or line.lstrip().startswith("#"):
            continue
        row = row_of_numbers(path, number, line, cells)
        if len(row) != width:
            raise NacreError(f"{path}: line {number} has {len(row)} numbers, VARS names {width}")
        table.append(row)
    if not table:
        raise NacreError(f"{path}: holds no rows")
    return np.array(table)


def _channels(path: Path, names: list[str]) -> tuple[str | None, Array | None, list[str]]:
    """Return the colour space, or the wavelengths, of the value columns."""
    upper = [{"RED": "R", "GREEN": "G", "BLUE": "B"}.get(name.upper(), name.upper()) for name in names]
    for colour in ("rgb", "xyz"):
        if upper == list(colour.upper()):
            return colour, None, []
    waves = [_WAVE.fullmatch(name) for name in names]
    if all(waves):
        return None, np.array([float(m[1]) * (1e3 if m[2].lower() == "um" else 1.0) for m in waves if m]), []
    if len(names) == 1:
        return None, None, ["the file names no wavelength; one value stands for all"]
    raise NacreError(
        f"{path}: the columns {', '.join(names)[:80]} are not known; allowed: one value, R,G,B, X,Y,Z, or wavelengths"
    )


# SSDD (surface scattering distribution data, version 0.2): up to four blocks of BRDF, BTDF and specular data.
#
# Parameter 0 varies fastest. Source: the format's specification in the documentation of libbsdf.

TYPES = ("brdf", "btdf", "specular_reflectance", "specular_transmittance")
CHANNELS = {"monochrome": 1, "rgb": 3, "xyz": 3}
FLOAT_BYTES = 4


def sniff_ssdd(head: FileHead) -> float:
    """Recognise the version line followed by a data type."""
    lines = [line for line in head.lines if line.strip() and not line.startswith("#")]
    is_headed = bool(lines) and re.match(r"VERSION\s+\d", lines[0]) is not None
    return CERTAIN if is_headed and any(line.startswith("DATA_TYPE") for line in lines) else 0.0


def read_ssdd(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all blocks.

    Raises:
        NacreError: a block is incomplete or unknown.
    """
    data, place = load_bytes(path, 8.0), 0
    measurements: list[Measurement] = []
    entries: dict[str, str] = {}
    while place < len(data):
        line, place = _line(data, place)
        name, _, value = line.decode("utf-8", "replace").partition("# ")[0].strip().partition(" ")
        if not name or name.startswith("#"):
            continue
        entries[name] = value.strip()
        if name == "DATA":
            try:
                measured, place = _block_ssdd(path, entries, data, place)
            except (ValueError, KeyError, IndexError):
                kind = entries.get("DATA_TYPE", "?")[:40]
                raise NacreError(f"{path}: block {kind} is incomplete or damaged") from None
            measurements.append(measured)
            entries = {key: entries[key] for key in ("VERSION", "SOFTWARE", "DATE") if key in entries}
    if not measurements:
        raise NacreError(f"{path}: holds no data block")
    return measurements


def _line(data: bytes, place: int) -> tuple[bytes, int]:
    """Return the line that begins at a place, and the place of the next one."""
    end = data.find(b"\n", place)
    end = len(data) if end < 0 else end
    return data[place:end], end + 1


def _block_ssdd(path: Path, entries: dict[str, str], data: bytes, place: int) -> tuple[Measurement, int]:
    kind, model = entries["DATA_TYPE"].lower(), entries["COLOR_MODEL"].lower()
    if kind not in TYPES:
        raise ValueError(kind)
    waves = np.array([float(w) for w in entries["WAVELENGTH_LIST"].split()]) if model == "spectrum" else None
    channels = len(waves) if waves is not None else CHANNELS[model]
    axes = [np.array([float(w) for w in entries.get(f"PARAM{i}_LIST", "0").split()]) for i in range(4)]
    if kind.startswith("specular"):
        axes[2:] = [np.zeros(1), np.zeros(1)]
    count = int(np.prod([len(a) for a in axes])) * channels
    values, place = _values(entries["DATA"].lower(), data, place, count)
    # parameter 0 varies fastest: [param3, param2, param1, param0, channel]
    values = values.reshape(*(len(a) for a in axes[::-1]), channels)
    grids = list(np.meshgrid(*axes[::-1], indexing="ij"))[::-1]
    values = values.reshape(-1, channels)
    metadata = {"scatter": "btdf" if kind in ("btdf", "specular_transmittance") else "brdf", "colour_model": model,
                "data_type": kind, "reduction": entries.get("REDUCTION_TYPE", ""),
                "shape": tuple(len(a) for a in axes)}  # fmt: skip
    metadata |= {key.lower(): entries[key] for key in ("SOURCE_TYPE", "DEVICE", "MEASUREMENT_DATE") if key in entries}
    name, colour = entries.get("NAME", ""), model if model in ("rgb", "xyz") else None
    if kind.startswith("specular"):
        quantity = "reflectance" if kind.endswith("reflectance") else "transmittance"
        table = {"theta_i_deg": np.repeat(grids[0].ravel(), channels)}
        if waves is not None:
            table["wavelength_nm"] = np.tile(waves, grids[0].size)
        table[f"specular_{quantity}"] = values.ravel()
        return Measurement(path, "bsdf", table, name, metadata), place
    angles = _angles(entries.get("PARAM_TYPE", "").lower(), grids, entries, axes[0])
    return measurement(path, angles, waves, values, metadata, name=name, colour=colour), place


def _values(mode: str, data: bytes, place: int, count: int) -> tuple[Array, int]:
    """Return the block's numbers and the place after them."""
    if mode == "binary":
        return np.frombuffer(data, "<f4", count, place).astype(float), place + FLOAT_BYTES * count
    if mode != "ascii":
        raise ValueError(mode)
    numbers: list[float] = []
    while len(numbers) < count and place < len(data):
        line, place = _line(data, place)
        numbers += [float(w) for w in line.partition(b"#")[0].split()]
    if len(numbers) != count:
        raise ValueError("count")
    return np.array(numbers), place


def _angles(kind: str, grids: list[Array], entries: dict[str, str], incidence: Array) -> Array:
    """Return direction pairs in degrees."""
    first, second, third, fourth = grids
    if kind == "spherical_coordinate_system":
        return gonio_table.pairs_of(first, second, third, fourth % 360.0)
    if kind == "half_difference_coordinate_system":
        return gonio_table.pairs_of_half_angles(*(np.radians(g).ravel() for g in grids))
    if kind != "specular_coordinate_system":
        raise ValueError(kind)
    offsets = [float(w) for w in entries.get("PARAM4_LIST", "").split()] or np.zeros(len(incidence))
    mirror = first + np.interp(first, incidence, offsets)
    # spherical coordinates turned to the mirror direction: azimuth 0 points from it towards the normal, 90 to +y
    out = angles_deg(scatter_direction(mirror, -fourth, third))
    return gonio_table.pairs_of(first, second, out[..., 0], (out[..., 1] + second) % 360.0)


# Universal BRDF files (JSON of the BiRD and BxDiff projects): `data.variables` name the columns of `data.values`.
#
# Variables are theta_i, phi_i, theta_r, phi_r (deg or rad), BRDF and uBRDF (sr-1), and optionally a wavelength. Source:
# the JSON schema of BiRDview.

BRDF_JSON_ANGLES = (("theta_i",), ("phi_i",), ("theta_r", "theta_s", "theta_o"), ("phi_r", "phi_s", "phi_o"))
WAVES = ("wavelength", "lambda", "wavelength_i", "lambda_i")


def sniff_brdf_json(head: FileHead) -> float:
    """Recognise the keys of the data section."""
    text = head.data[:65536]
    is_json = text.lstrip(b"\xef\xbb\xbf \r\n\t")[:1] == b"{"
    return CERTAIN if is_json and b'"theta_i"' in text and b'"variables"' in text else 0.0


def read_brdf_json(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the values.

    Raises:
        NacreError: not valid JSON, or variables are missing or not numbers.
    """
    try:
        document = json.loads(load_text(path))
        variables = document["data"]["variables"]
        rows, names = document["data"]["values"], [str(v["name"]) for v in variables]
        units = {name: str(v.get("unit", "")) for name, v in zip(names, variables, strict=True)}
        head = document.get("metadata", {})
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise NacreError(f"{path}: is not a universal BRDF file, or is damaged") from None
    place = {name.lower(): i for i, name in enumerate(names)}
    angles = np.stack([_column(path, rows, names, place, units, among) for among in BRDF_JSON_ANGLES], axis=-1)
    value = _column(path, rows, names, place, units, ("brdf", "btdf", "bsdf"))
    scatter = "btdf" if "btdf" in place else "brdf"
    metadata: dict[str, Any] = {"scatter": scatter, "variables": names, "head": head}
    name = str(head.get("name", "")) if isinstance(head, dict) else ""
    made = gonio_table.measurement(path, gonio_table.unsigned(angles), None, value[:, None], metadata, name=name)
    data, assumed = dict(made.data), list(made.assumed)
    wave = next((name for name in WAVES if name in place), None)
    if wave is not None:
        column = _column(path, rows, names, place, units, (wave,))
        data["wavelength_nm"], notes = gonio_table.wavelengths_in_nm(
            path, column, units[names[place[wave]]].lower() or None
        )
        assumed += notes
    else:
        assumed.append("the file names no wavelength; one value stands for all")
    error = next((name for name in ("ubrdf", "ubtdf", "ubsdf") if name in place), None)
    if error is not None:
        data["bsdf_error"] = _column(path, rows, names, place, units, (error,))
    used = {*sum(BRDF_JSON_ANGLES, ()), *WAVES, "brdf", "btdf", "bsdf", "ubrdf", "ubtdf", "ubsdf"}
    left_out = (*made.left_out, *(f"variable {name} was not read" for name in names if name.lower() not in used))
    ordered = {key: data[key] for key in (*gonio_table.DEGREES, "wavelength_nm", "bsdf", "bsdf_error") if key in data}
    return [replace(made, data=ordered, assumed=tuple(assumed), left_out=left_out)]


def _column(
    path: Path, rows: Any, names: list[str], place: dict[str, int], units: dict[str, str], among: tuple[str, ...]
) -> Array:
    """Return a variable's numbers, angles in degrees."""
    name = next((n for n in among if n in place), None)
    if name is None:
        raise NacreError(f"{path}: variable {among[0]} is missing; the file has {', '.join(names)[:80]}")
    try:
        column = np.array([float(row[place[name]]) for row in rows])
    except (ValueError, TypeError, IndexError):
        raise NacreError(f"{path}: variable {name} holds something that is not a number") from None
    if not len(column):
        raise NacreError(f"{path}: holds no values")
    unit = units[names[place[name]]].lower()
    return np.degrees(column) if unit.startswith("rad") else column


# BSDF matrices of WINDOW and Radiance (`<WindowElement>` XML) in a basis of patches such as Klems'.
#
# A block gives a matrix, a row for each outgoing and a column for each incident patch, in 1/sr. Directions are those of
# the patches' centres, with the azimuth convention of the basis.


@dataclass(frozen=True)
class Basis:
    """Centres of a basis' patches in degrees, each `[patch]`."""

    theta: Array
    phi: Array


def sniff_window_xml(head: FileHead) -> float:
    """Recognise the root element, which a line of a log may precede."""
    return CERTAIN if b"<WindowElement" in head.data else 0.0


def read_window_xml(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read every block of every wavelength range.

    Raises:
        NacreError: not valid XML, a basis of another kind (tensor trees), or a matrix that does not fit its basis.
    """
    text = load_text(path)
    text = text[max(text.find("<?xml"), 0) :]
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise NacreError(f"{path}: holds a document type declaration, which this format does not use")
    try:
        # the default namespace differs between versions
        root = ET.fromstring(re.sub(r'\sxmlns="[^"]*"', "", text, count=1))
    except ET.ParseError:
        raise NacreError(f"{path}: is not valid XML, or is damaged") from None
    bases = {_text(node, "AngleBasisName"): _basis(path, node) for node in root.iter("AngleBasis")}
    structure = next((node.text or "" for node in root.iter("IncidentDataStructure")), "Columns").strip()
    if structure not in ("Columns", "Rows") or not bases:
        raise NacreError(
            f"{path}: IncidentDataStructure = {structure or 'none'} is not a matrix of patches; "
            "convert a tensor tree by Radiance's bsdf2klems"
        )
    name = next((node.text or "" for node in root.iter("Name")), "").strip()
    measurements = [
        _block_window_xml(path, name, _text(data, "Wavelength"), block, bases, structure == "Columns")
        for data in root.iter("WavelengthData")
        for block in data.iter("WavelengthDataBlock")
    ]
    if not measurements:
        raise NacreError(f"{path}: holds no block of scattering data")
    return measurements


def _text(node: ET.Element, name: str) -> str:
    return (node.findtext(name) or "").strip()


def _basis(path: Path, node: ET.Element) -> Basis:
    theta, phi = [], []
    try:
        for ring in node.iter("AngleBasisBlock"):
            low, high = (float(ring.findtext(f"ThetaBounds/{end}Theta") or "") for end in ("Lower", "Upper"))
            count = int(ring.findtext("nPhis") or "")
            theta += [0.0 if count == 1 and low == 0 else 0.5 * (low + high)] * count
            phi += [360.0 * k / count for k in range(count)]
    except ValueError:
        raise NacreError(f"{path}: an angle basis is incomplete") from None
    return Basis(np.array(theta), np.array(phi))


def _block_window_xml(
    path: Path, name: str, label: str, block: ET.Element, bases: dict[str, Basis], has_columns: bool
) -> Measurement:
    side = _text(block, "WavelengthDataDirection")
    try:
        columns, rows = (bases[_text(block, f"{end}AngleBasis")] for end in ("Column", "Row"))
        words = re.split(r"[,\s]+", _text(block, "ScatteringData").strip(", \n"))
        matrix = np.array([float(word) for word in words]).reshape(len(rows.theta), len(columns.theta))
    except (KeyError, ValueError):
        raise NacreError(f"{path}: block {label} {side} does not fit its angle basis") from None
    incident, out = (columns, rows) if has_columns else (rows, columns)
    values = matrix if has_columns else matrix.T
    is_through = "transmission" in side.lower()
    theta_o = 180.0 - out.theta if is_through else out.theta
    angles = gonio_table.pairs_of(incident.theta[None], incident.phi[None], theta_o[:, None], out.phi[:, None])
    metadata = {"scatter": "btdf" if is_through else "brdf", "direction": side, "wavelength_range": label,
                "shape": values.shape}  # fmt: skip
    assumed = ["azimuths of incident and outgoing patches are as the basis counts them",
               f"the values are means over the range {label or 'of the file'}"]  # fmt: skip
    title = f"{name} {label} {side}".strip()
    return measurement(path, angles, None, values.reshape(-1, 1), metadata, name=title, assumed=assumed)


# Speos files as text: scattering surfaces (parameters) and measured BSDFs (`.brdf`, `.anisotropicbsdf`).
#
# Scattering surfaces give, for each incidence and wavelength, reflected and transmitted shares in per cent: specular,
# Lambertian, Gaussian, and the Gaussian's two full widths in degrees. Measured BSDFs have their mirror direction at
# azimuth 0. BSDF180 holds two files, for front and back; binary and encrypted files are refused.

ROWS = ("specular", "lambertian", "gaussian", "gaussian_fwhm_x", "gaussian_fwhm_y")
FIRST = "OPTIS - "


def sniff_speos(head: FileHead) -> float:
    """Recognise the first line."""
    line = head.data[:200].lstrip(b"\xef\xbb\xbf").decode("latin-1").split("\n")[0].lower()
    known = ("scattering", "brdf", "bsdf", "coated")
    return CERTAIN if line.startswith("optis") and any(word in line for word in known) else 0.0


def read_speos(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a text file of one of the kinds.

    Raises:
        NacreError: the file is binary, compressed, of another kind, or damaged.
    """
    data = load_bytes(path, 8.0)
    if b"\0" in data:
        raise NacreError(f"{path}: is a binary or encrypted Speos file; save it as text in the BSDF viewer")
    lines = data.decode("latin-1").splitlines()
    title = lines[0].lower()
    try:
        if "bsdf180" in title or "bsdf 180" in title:
            return _both_sides(path, lines)
        return [*_part(path, lines)]
    except (ValueError, IndexError, StopIteration):
        raise NacreError(f"{path}: the Speos file is damaged, or of a version that is not known") from None


def _part(path: Path, lines: list[str]) -> list[Measurement]:
    title = lines[0].lower()
    if "simple" in title and "scattering" in title:
        return [_simple(path, lines)]
    if "anisotropic" in title:
        return _anisotropic(path, lines)
    if "scattering" in title:
        return [_scattering(path, lines)]
    if "brdf" in title:
        return _measured(path, lines)
    raise NacreError(f'{path}: "{lines[0].strip()[:60]}" is a Speos file of a kind that is not read')


def _scattering(path: Path, lines: list[str]) -> Measurement:
    words = iter(" ".join(lines[2:]).split())
    incidences, waves = int(next(words)), int(next(words))
    wavelengths = axis(words, waves)
    theta, table = [], []
    for _ in range(incidences):
        theta.append(float(next(words)))
        table.append(numbers(words, len(ROWS) * waves * 2).reshape(len(ROWS), waves, 2))
    if next(words, None) is not None or np.any(np.diff(theta) <= 0):
        raise ValueError("more numbers than announced")
    return _model(path, "scattering", lines, np.array(theta), wavelengths, np.array(table))


def _simple(path: Path, lines: list[str]) -> Measurement:
    """Read the wavelength-independent form: rows of reflected and transmitted shares as in the full form."""
    shares = [float(word) for word in " ".join(lines[2:]).split()]
    if len(shares) != 2 * len(ROWS):
        raise NacreError(
            f"{path}: a simple scattering file holds {2 * len(ROWS)} numbers below its two lines; this has "
            f"{len(shares)}"
        )
    table = np.reshape(shares, (1, len(ROWS), 1, 2))
    return _model(path, "simple_scattering", lines, np.zeros(1), None, table)


def _model(
    path: Path, form: str, lines: list[str], theta: Array, wavelengths: Array | None, table: Array
) -> Measurement:
    """Return the parameters as a table: one row per incidence and wavelength.

    Args:
        table: `[incidence, row, wavelength, (reflected, transmitted)]`, per cent and degrees.
    """
    waves = table.shape[2]
    data: dict[str, Array] = {"theta_i_deg": np.repeat(theta, waves)}
    if wavelengths is not None:
        data["wavelength_nm"] = np.tile(wavelengths, len(theta))
    for row, name in enumerate(ROWS):
        is_angle = name.startswith("gaussian_fwhm")
        for side, word in enumerate(("reflectance", "transmittance")):
            column = table[:, row, :, side].reshape(-1)
            key = f"{name}_{word}_deg" if is_angle else f"{name}_{word}"
            data[key] = column if is_angle else column / 100.0
    left_out = ("parameters of a model, not samples of a BSDF",)
    metadata = {"scatter": "model", "title": lines[0].strip(), "comment": lines[1].strip(),
                "incidences": len(theta), "wavelengths_nm": wavelengths, "form": form}  # fmt: skip
    return Measurement(path, "bsdf", data, lines[1].strip(), metadata, (), left_out)


def _head(lines: list[str]) -> tuple[list[str], str]:
    """Return the lines after mode, comment and measurement description, and the description."""
    if lines[1].strip() != "0":
        raise ValueError("binary")
    count, place, text = int(lines[3].split()[0]), 4, lines[4] if len(lines) > 4 else ""
    while len(text) < count and place + 1 < len(lines):
        place += 1
        text += "\n" + lines[place]
    return lines[place + 1 :], text


def _blocks(words: Iterator[str]) -> tuple[Array, Array, Array]:
    """Return theta, phi and values `[theta, phi]` of one table."""
    thetas, phis = int(next(words)), int(next(words))
    phi = axis(words, phis)
    rows = numbers(words, thetas * (phis + 1)).reshape(thetas, phis + 1)
    return rows[:, 0], phi, rows[:, 1:]


def _over_cosine(theta: Array, intensity: Array) -> Array:
    """Return the BSDF of an intensity; at grazing directions, where the cosine is 0, no finite BSDF follows: 0."""
    cosine = np.abs(np.cos(np.radians(theta)))
    return np.asarray(np.where(cosine > 1e-6, intensity / np.maximum(cosine, 1e-6), 0.0))


def hemispherical_share(theta_deg: Array, phi_deg: Array, f: Array) -> float:
    """Integrate f cos over a hemisphere by trapezia; azimuths from 0 to 180 degrees represent both sides.

    Args:
        f: `[theta, phi]`, 1/sr.
    """
    from scipy.integrate import trapezoid

    angle = np.radians(theta_deg)
    order = np.argsort(angle)
    weight = np.abs(np.cos(angle)) * np.sin(angle)
    power = trapezoid((f * weight[:, None])[order], angle[order], axis=0)
    if len(phi_deg) == 1:
        return float(power[0] * 2 * np.pi)
    is_half = abs(phi_deg[-1] - 180.0) < 1e-6 and phi_deg[0] == 0
    return float(trapezoid(power, np.radians(phi_deg))) * (2.0 if is_half else 1.0)


def _pairs(rotation: float, incidence: float, block: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Return direction pairs `[pair, 4]` (mirror at 180 degrees) and values `[pair]`."""
    theta, phi, values = block
    t, p = np.meshgrid(theta, phi, indexing="ij")
    return pairs_of(np.full(t.shape, incidence), np.full(t.shape, rotation), t, (p + 180.0 + rotation) % 360.0), (
        values.reshape(-1)
    )


def _measured(path: Path, lines: list[str]) -> list[Measurement]:
    rest, text = _head(lines)
    words = iter(" ".join(rest).split())
    sides, is_bsdf = [int(next(words)), int(next(words))], int(next(words)) == 1
    count, waves = int(next(words)), int(next(words))
    incidence, wavelengths = axis(words, count), axis(words, waves)
    parts = []
    for scatter, has in zip(("brdf", "btdf"), sides, strict=True):
        if not has:
            continue
        angles, values = [], []
        for at in incidence:
            columns = []
            for _ in range(waves):
                percent = float(next(words))
                theta, phi, table = _blocks(words)
                f = table if is_bsdf else _over_cosine(theta[:, None], table)
                total = hemispherical_share(theta, phi, f)
                scaled = f * (percent / 100.0 / total) if total > 0 else f
                columns.append(_pairs(0.0, float(at), (theta, phi, scaled)))
            if any(not np.array_equal(c[0], columns[0][0]) for c in columns):
                raise ValueError("angles differ between wavelengths")
            angles.append(columns[0][0])
            values.append(np.stack([c[1] for c in columns], axis=-1))
        metadata = {"title": lines[0].strip(), "description": text, "scatter": scatter, "form": "brdf"}
        assumed = ["values are scaled to the file's share of reflected or transmitted light"]
        parts.append(measurement(path, np.concatenate(angles), wavelengths, np.concatenate(values), metadata,
                                 assumed=assumed))  # fmt: skip
    return parts


def _anisotropic(path: Path, lines: list[str]) -> list[Measurement]:
    rest, text = _head(lines)
    words = iter(" ".join(rest).split())
    vector = numbers(words, 3)
    sides, is_bsdf = [int(next(words)), int(next(words))], int(next(words)) == 1
    grids: dict[str, list[tuple[float, Array]]] = {}
    for scatter, has in zip(("brdf", "btdf"), sides, strict=True):
        if has:
            rotations = axis(words, int(next(words)))
            grids[scatter] = [(float(turn), axis(words, int(next(words)))) for turn in rotations]
    spectra = {}
    for scatter in grids:
        numbers(words, 2)  # the direction of the spectrum
        spectra[scatter] = numbers_after_text(words).T
    parts = []
    for scatter, turns in grids.items():
        (waves, percent), pairs = spectra[scatter], []
        for turn, incidences in turns:
            pairs += [_pairs(turn, float(at), _blocks(words)) for at in incidences]
        angles, value = (np.concatenate(part) for part in zip(*pairs))
        f = value if is_bsdf else _over_cosine(angles[:, 2], value)
        share = percent / max(float(percent.max()), 1e-300)
        metadata = {"title": lines[0].strip(), "description": text, "anisotropy_vector": vector,
                    "reference_spectrum_percent": percent, "scatter": scatter}  # fmt: skip
        assumed = ["the file's spectrum at one direction, relative to its maximum, multiplies all directions"]
        parts.append(measurement(path, angles, waves, f[:, None] * share, metadata, assumed=assumed))
    return parts


def numbers_after_text(words: Iterator[str]) -> Array:
    """Return a spectrum `[row, 2]`: a description (words), the row count, then wavelength and per cent."""
    word = next(words)
    while not word.isdigit():
        word = next(words)
    return numbers(words, 2 * int(word)).reshape(-1, 2)


def _both_sides(path: Path, lines: list[str]) -> list[Measurement]:
    """Read a BSDF180: the text of the front's file, then that of the back's."""
    starts = [i for i, line in enumerate(lines) if i and line.strip().startswith(FIRST)]
    if len(starts) != 2:
        raise NacreError(f"{path}: the BSDF180 does not hold two text files; it names or compresses them")
    texts = {"front": lines[starts[0] : starts[1]], "back": lines[starts[1] :]}
    return [
        replace(part, name=f"{side} {part.name}".strip(), metadata={**part.metadata, "side": side})
        for side, text in texts.items()
        for part in _part(path, text)
    ]
