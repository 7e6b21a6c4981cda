"""One measured spectrum, map, material or colour list in canonical names and units, its description and tidy files."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, write_text

Kind = Literal["ellipsometry", "constants", "spectrum", "heights", "colours", "bsdf", "tmatrix", "table"]


@dataclass(frozen=True)
class Measurement:
    """One data set of a file.

    Attributes:
        path: the file.
        kind: class of instrument or data.
        data: arrays by canonical name; the name ends with the unit (`wavelength_nm`, `angle_of_incidence_deg`,
            `psi_deg`, `height_um`); dimensionless quantities lack a unit (`reflectance`, `n`, `k`, `m12`). Arrays of a
            table have equal lengths; a height map is one array [row, column], row 0 at the picture's top.
        name: name of the sample, spectrum, channel or material in the file; empty if there is none.
        metadata: other statements of the file: instrument, date, white reference, illuminant, observer, polarisation,
            `pitch_um`.
        assumed: one sentence for each property that the file does not state.
        left_out: one sentence for each part of the file that was not read.
        format: identifier in `registry.FORMATS`, which `registry.open_file` sets.
    """

    path: Path
    kind: Kind
    data: Mapping[str, NDArray[Any]]
    name: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    format: str = ""


@dataclass(frozen=True)
class ReadOptions:
    """Properties that a user states because a file does not (options of `nacre read`, keys of recipes).

    Attributes:
        quantity: canonical name of the dependent quantity (`reflectance`, `transmittance`, `n`, `eps1`, ...).
        unit: abscissa unit (`nm`, `um`, `eV`, `1/cm`), or height unit.
        angle_deg: incidence angle.
        delta_convention: Delta sign: `positive` or `negative` (see `docs`).
        channel: channel of a file with several (heights, zones).
        spectrum: name or number of one spectrum, material or block.
        pitch_um: lateral distance of height samples, (x, y).
        columns: canonical column names of a table without headings; `-` ignores a column.
        ignore: headings of columns to ignore.
        format: identifier in `registry.FORMATS`; recognised from the content by default.
        wavelengths: wavelength file for a spectrum from the USGS library, which has one column.
        expects: kind that the caller needs; decides the columns of a table without headings.
        assumed_quantity: quantity of a table of two columns without headings, which the caller's key states.
    """

    quantity: str | None = None
    unit: str | None = None
    angle_deg: float | None = None
    delta_convention: str | None = None
    channel: str | None = None
    spectrum: str | None = None
    pitch_um: tuple[float, float] | None = None
    columns: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    format: str | None = None
    wavelengths: str | None = None
    expects: Kind | None = None
    assumed_quantity: str | None = None


class AmbiguousFileError(NacreError):
    """A file can be read in several ways; the command line prompts on a terminal.

    Attributes:
        option: name of the `ReadOptions` field that decides.
        choices: allowed values; empty if any value of the type is.
    """

    def __init__(self, message: str, option: str, choices: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.option = option
        self.choices = choices


def contradiction(path: Path, key: str, requested: str, stated: str) -> NacreError:
    """Return the error for an option that contradicts the file."""
    return NacreError(f'{path}: {key} = "{requested}", but the file states "{stated}"; correct one of them')


# The beginning of a file, from which its format is recognised.

# images, documents and archives whose first bytes may be printable
PRINTABLE_MAGIC = (b"\x89PNG", b"GIF8", b"%PDF", b"PK\x03\x04", b"\xff\xd8\xff", b"Rar!", b"7z\xbc\xaf", b"{\\rtf")
UTF_16_SHARE = 0.3  # fraction of NUL among bytes of one parity, above which text without a mark is UTF-16


def utf_16_order(data: bytes) -> str | None:
    """Return "utf-16-le" or "utf-16-be" for UTF-16 without a byte order mark, or None."""
    sample = data[:4000]
    if len(sample) < 4 or b"\0" not in sample:
        return None
    at_even, at_odd = (sample[i::2].count(0) / max(1, len(sample[i::2])) for i in (0, 1))
    text = sample.replace(b"\0", b"")
    if sum(byte < 9 or 13 < byte < 32 for byte in text) > 0.02 * len(text):
        return None
    if at_odd > UTF_16_SHARE and at_even < 0.1 * at_odd:
        return "utf-16-le"
    return "utf-16-be" if at_even > UTF_16_SHARE and at_odd < 0.1 * at_even else None


@dataclass(frozen=True)
class FileHead:
    """The beginning of a file, from which a format is recognised."""

    path: Path
    data: bytes
    size: int

    @cached_property
    def text(self) -> str:
        """Text of the head; UTF-16 is decoded, other bytes that are not UTF-8 become U+FFFD."""
        encoding = "utf-16" if self.data[:2] in (b"\xff\xfe", b"\xfe\xff") else utf_16_order(self.data) or "utf-8-sig"
        return self.data.decode(encoding, errors="replace")

    @cached_property
    def lines(self) -> list[str]:
        """Lines of the text."""
        return self.text.splitlines()

    @cached_property
    def is_text(self) -> bool:
        """Whether the head is text: few control characters."""
        if self.data[:2] in (b"\xff\xfe", b"\xfe\xff") or utf_16_order(self.data) is not None:
            return True
        sample = self.data[:4096]
        if sample.startswith(PRINTABLE_MAGIC):
            return False
        if self.size <= len(sample):
            sample = sample.rstrip(b"\0")  # padding
        controls = sum(byte < 9 or 13 < byte < 32 for byte in sample.replace(b"\0", b""))
        return sample.count(0) <= 0.1 * len(sample) and controls <= 0.02 * len(sample)


UNITS = {"nm": "nm", "um": "um", "deg": "deg", "s": "s", "ev": "eV"}
_UNIT_OF = {"counts": "counts", "bsdf": "1/sr", **dict.fromkeys("XYZ", "Y of white = 100")}
# long arrays of the metadata are shortened in the description
MAX_ITEMS = 8


def unit_of(name: str) -> str:
    """Return the unit of a canonical name; "1" for dimensionless quantities.

    Example:
        >>> unit_of("wavelength_nm"), unit_of("psi_deg_error"), unit_of("reflectance")
        ('nm', 'deg', '1')
    """
    stem = name.removesuffix("_error")
    return _UNIT_OF.get(stem) or UNITS.get(stem.rpartition("_")[2] if "_" in stem else "", "1")


def describe(measurement: Measurement, show: int = 0) -> dict[str, Any]:
    """Return a measurement's description as JSON values.

    Args:
        show: number of rows of tables to include.
    """
    quantities: dict[str, dict[str, Any]] = {}
    for name, values in measurement.data.items():
        entry: dict[str, Any] = {"unit": unit_of(name), "shape": list(np.shape(values))}
        if np.size(values) and np.asarray(values).dtype.kind in "fiub":
            flat = np.asarray(values, dtype=float).ravel()
            finite = flat[np.isfinite(flat)]
            entry |= {"first": _number(flat[0]), "last": _number(flat[-1]), "missing": int(flat.size - finite.size)}
            if finite.size:
                entry |= {"min": _number(finite.min()), "max": _number(finite.max())}
        quantities[name] = entry
    rows = {} if show <= 0 else {"rows": _rows(measurement, show)}
    return {
        "path": str(measurement.path), "format": measurement.format, "kind": measurement.kind, "name": measurement.name,
        "points": points(measurement), "quantities": quantities, "metadata": _plain(measurement.metadata),
        "assumed": list(measurement.assumed), "left_out": list(measurement.left_out), **rows,
    }  # fmt: skip


def points(measurement: Measurement) -> int:
    """Return a table's row count or a map's sample count."""
    sizes = [np.shape(values) for values in measurement.data.values()]
    if measurement.kind == "heights" and sizes:
        return int(np.prod(sizes[0]))
    return int(sizes[0][0]) if sizes and sizes[0] else 0


def lines(measurement: Measurement, title: str, show: int = 0) -> list[str]:
    """Return a measurement's description as text lines."""
    description = describe(measurement, show)
    name = f' "{measurement.name}"' if measurement.name else ""
    texts = [f"{measurement.path}:{name} {measurement.kind}, {description['points']} points; format: {title}"]
    for key, entry in description["quantities"].items():
        shape = "" if len(entry["shape"]) < 2 else f", {' x '.join(map(str, entry['shape']))}"
        reach = f"  {entry['min']:.6g} to {entry['max']:.6g}" if "min" in entry else ""
        unit = "" if entry["unit"] == "1" or key.endswith(f"_{entry['unit']}") else f" {entry['unit']}"
        gaps = f", {entry['missing']} missing" if entry.get("missing") else ""
        texts.append(f"  {key}:{reach}{unit}{shape}{gaps}")
    for key, value in measurement.metadata.items():
        texts.append(f"  {key} = {_short(value)}")
    texts += [f"  assumed: {text}" for text in measurement.assumed]
    texts += [f"  left out: {text}" for text in measurement.left_out]
    if rows := description.get("rows"):
        texts.append("  " + "  ".join(rows[0]))
        texts += ["  " + "  ".join(_cell(value) for value in row.values()) for row in rows]
    return texts


def write_measurements(path: str | Path, measurements: Sequence[Measurement]) -> None:
    """Write measurements as tidy CSV (units in the headings) or NPZ (arrays by name), by the suffix.

    Several measurements have a first column `sample` in CSV, and a prefix `name/` in NPZ.

    Raises:
        NacreError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix == ".npz":
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **_arrays(measurements))
    elif path.suffix == ".csv":
        write_text(path, _csv(measurements))
    else:
        raise NacreError(f"-o {path}: the suffix must be .csv or .npz")


def _arrays(measurements: Sequence[Measurement]) -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    for label, measurement in zip(_labels(measurements), measurements, strict=True):
        prefix = f"{label}/" if len(measurements) > 1 else ""
        arrays |= {f"{prefix}{name}": values for name, values in measurement.data.items()}
        document = {key: value for key, value in describe(measurement).items() if key != "quantities"}
        arrays[f"{prefix}description"] = np.array(json.dumps(document))
    return arrays


def _labels(measurements: Sequence[Measurement]) -> list[str]:
    labels: list[str] = []
    for number, measurement in enumerate(measurements, start=1):
        label = measurement.name or str(number)
        labels.append(label if label not in labels else f"{label} ({number})")
    return labels


def _csv(measurements: Sequence[Measurement]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    tables = [_stated(measurement, _columns(measurement)) for measurement in measurements]
    heading = list(dict.fromkeys(name for columns in tables for name in columns))
    several = len(measurements) > 1
    writer.writerow(["sample"] * several + heading)
    for label, columns in zip(_labels(measurements), tables, strict=True):
        for row in range(max(map(len, columns.values()), default=0)):
            cells = [_cell(columns[name][row]) if name in columns else "" for name in heading]
            writer.writerow([label] * several + cells)
    return out.getvalue()


def _columns(measurement: Measurement) -> dict[str, Any]:
    """Return the columns of a tidy table: maps as x, y, height; spectra with a column per wavelength."""
    columns: dict[str, Any] = {}
    names = measurement.metadata.get("names")
    if measurement.kind == "colours" and names is not None:
        columns["name"] = list(names)
    for name, values in measurement.data.items():
        array = np.asarray(values)
        if name == "height_um" and array.ndim == 2:
            x, y = measurement.metadata.get("pitch_um", (1.0, 1.0))
            row, column = np.indices(array.shape)
            columns |= {"x_um": column.ravel() * x, "y_um": row.ravel() * y, name: array.ravel()}
        elif name == "spectra":
            grid = measurement.data["wavelength_nm"]
            columns |= {f"reflectance_{nm:g}_nm": array[:, place] for place, nm in enumerate(grid)}
        elif name == "wavelength_nm" and "spectra" in measurement.data:
            continue
        elif array.ndim == 2:
            columns |= {f"{name}_{place}": array[:, place] for place in range(array.shape[1])}
        elif array.ndim == 1:
            columns[name] = array
    return columns


def _stated(measurement: Measurement, columns: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of a spectrum with its angle, polarisation and mode, so that the table states them."""
    if measurement.kind != "spectrum" or not columns:
        return columns
    facts, count = measurement.metadata, max(map(len, columns.values()))
    mode = facts.get("mode")
    if mode in ("specular", "diffuse", "total"):
        columns = {
            f"{mode}_{name}" if name.startswith(("reflectance", "transmittance")) else name: column
            for name, column in columns.items()
        }
    if facts.get("angle_of_incidence_deg") is not None and "angle_of_incidence_deg" not in columns:
        columns["angle_of_incidence_deg"] = np.full(count, float(facts["angle_of_incidence_deg"]))
    if facts.get("polarisations") or facts.get("polarisation"):
        columns["polarisation"] = list(facts.get("polarisations") or [facts["polarisation"]] * count)
    return columns


def _rows(measurement: Measurement, show: int) -> list[dict[str, Any]]:
    columns = _columns(measurement)
    count = min(show, max(map(len, columns.values()), default=0))
    return [
        {name: _plain(column[row]) for name, column in columns.items() if row < len(column)} for row in range(count)
    ]


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _cell(value: Any) -> str:
    return f"{value:.9g}" if isinstance(value, float | np.floating) else str(value)


def _short(value: Any) -> str:
    items = _plain(value)
    if isinstance(items, list) and len(items) > MAX_ITEMS:
        return f"{', '.join(str(item) for item in items[:3])}, ... ({len(items)})"
    return ", ".join(str(item) for item in items) if isinstance(items, list) else str(items)


def _plain(value: Any) -> Any:
    """Return a value in types of JSON."""
    if isinstance(value, np.ndarray | np.generic):
        value = np.asarray(value).tolist()
    if hasattr(value, "items"):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return _number(value)
    return value if value is None or isinstance(value, str | int | bool) else str(value)
