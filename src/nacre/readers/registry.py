"""Formats that nacre reads, their recognition by content, and the description of unknown files."""

import difflib
import re
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any, cast
from xml.etree.ElementTree import ParseError

import numpy as np

from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import named, reading, size_of, why_unreadable
from nacre.readers.measurement import AmbiguousFileError, Kind, Measurement, ReadOptions
from nacre.readers.measurement import FileHead as FileHead

HEAD_BYTES = 65536
MAX_BYTES = 2 << 30
CERTAIN = 1.0  # a magic number or an unmistakable first line
LIKELY = 0.6  # typical keys
POSSIBLE = 0.2  # any table of numbers
_MARKUP = re.compile(r"\s*(?:[<{]|\[\s*[\[{\"\d-])")
CUT = "the file ends inside its last line, which may be cut"
_DAMAGE = (
    ValueError, LookupError, ArithmeticError, RuntimeError, EOFError, TypeError, AttributeError, struct.error,
    zlib.error, zipfile.BadZipFile, ParseError,
)  # fmt: skip


@dataclass(frozen=True)
class Format:
    """A readable format, a line of `formats.toml`.

    Its module has `sniff(head) -> float` and `read(path, options) -> list[Measurement]`; in a module of several formats
    both names end in the identifier, as `sniff_gwy`.
    """

    id: str
    title: str
    kind: Kind
    module: str

    @property
    def sniff(self) -> Callable[[FileHead], float]:
        """Return the function that gives the confidence (0 to 1) that a file has this format."""
        return self._function("sniff")

    @property
    def read(self) -> Callable[[Path, ReadOptions], list[Measurement]]:
        """Return the function that reads a file of this format."""
        return self._function("read")

    def _function(self, name: str) -> Callable[..., Any]:
        module = import_module(f"nacre.readers.{self.module}")
        return getattr(module, f"{name}_{self.id.replace('-', '_')}", None) or getattr(module, name)


# the format of the highest confidence reads a file
FORMATS: tuple[Format, ...] = tuple(
    Format(identifier, title, cast(Kind, kind), module)
    for kind, formats in tomllib.loads(files("nacre.readers").joinpath("formats.toml").read_text("utf-8")).items()
    for identifier, (title, module) in formats.items()
)


def head_of(path: str | Path) -> FileHead:
    """Return the beginning of a regular file.

    Raises:
        NacreError: it does not exist, cannot be read, is empty, or is a folder, a device or a pipe.
    """
    path = named(path)
    size = size_of(path, most_bytes=MAX_BYTES)
    with reading(path), path.open("rb") as file:
        head = FileHead(path, file.read(HEAD_BYTES), size)
    if not head.data.strip():
        raise NacreError(f"{path}: is empty, it holds no data")
    return head


def recognise(path: str | Path) -> list[tuple[float, Format]]:
    """Return the formats that a file may have with their confidences, highest first.

    Raises:
        NacreError: as `head_of`.
    """
    head = head_of(path)
    least = 0.0 if head.is_text else POSSIBLE  # binary files need a recognised structure
    candidates = [(confidence, entry) for entry in FORMATS if (confidence := _confidence(entry, head)) > least]
    return sorted(candidates, key=lambda pair: -pair[0])


def _confidence(entry: Format, head: FileHead) -> float:
    """Return a format's confidence; 0 if its recognition fails with an error."""
    try:
        return entry.sniff(head)
    except (NacreError, *_DAMAGE):
        return 0.0


def format_named(name: str) -> Format:
    """Return a format by its identifier.

    Raises:
        NacreError: the name is unknown.
    """
    formats = {entry.id: entry for entry in FORMATS}
    if name not in formats:
        raise NacreError(f'format = "{name}" is not known.{did_you_mean(name, formats)} Allowed: {", ".join(formats)}')
    return formats[name]


def open_file(path: str | Path, options: ReadOptions | None = None) -> list[Measurement]:
    """Read a file of any known format.

    Returns:
        One measurement per spectrum, map, material, or colour list; at least one.

    Raises:
        NacreError: unknown format, or contents that cannot be read correctly; the message states the cause.
        AmbiguousFileError: the file can be read in several ways; `option` names the field that decides.
    """
    path, options = named(path), options or ReadOptions()
    if options.format is not None:
        head_of(path)
        entry = format_named(options.format)
    else:
        ranked = recognise(path)
        if ranked and ranked[0][0] <= POSSIBLE and options.expects is None and _MARKUP.match(head_of(path).text):
            ranked = []  # XML or JSON of another program is not a table
        if not ranked and options.expects is not None and head_of(path).is_text:
            ranked = [(0.0, format_named("table"))]  # its error names what the caller needs
        if not ranked:
            raise NacreError(unknown_file(head_of(path), [entry.title for entry in FORMATS]))
        if options.expects is not None and ranked[0][0] < CERTAIN:  # an uncertain match with another kind is ignored
            of_kind = [pair for pair in ranked if pair[1].kind in (options.expects, "table")]
            ranked = of_kind if of_kind and of_kind[0][0] >= 0.5 * ranked[0][0] else ranked
        best = [entry for confidence, entry in ranked if confidence >= ranked[0][0] - 1e-9]
        if len(best) > 1:
            titles = ", ".join(f"{entry.title} ({entry.id})" for entry in best)
            raise AmbiguousFileError(f"{path}: may be {titles}", "format", tuple(entry.id for entry in best))
        entry = best[0]
        if options.expects is not None and entry.id == "spectrum-table":
            table = format_named("table")
            has_usual_headings = import_module(f"nacre.readers.{table.module}").has_usual_headings
            entry = table if has_usual_headings(head_of(path)) else entry
    if options.wavelengths is not None and entry.id != "usgs-splib":
        raise NacreError(
            f'{path}: wavelengths = "{options.wavelengths}" is for the USGS library; this is {entry.title}'
        )
    try:
        measurements = entry.read(path, options)
    except NacreError:
        raise
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    except _DAMAGE as error:
        raise NacreError(f"{path}: is damaged, or no {entry.title} ({str(error)[:80]})") from error
    if not measurements:
        raise NacreError(f"{path}: {entry.title} without data")
    _check_quantity(path, measurements, options)
    remarks = [CUT] if _is_cut(path) else []
    return [
        replace(each, format=entry.id, assumed=tuple(dict.fromkeys([*each.assumed, *remarks, *_unused(each, options)])))
        for each in measurements
    ]


def _check_quantity(path: Path, measurements: Sequence[Measurement], options: ReadOptions) -> None:
    """Refuse a quantity that all spectra and constants lack."""
    from nacre.readers.spectra.common import label_of

    optical = [each for each in measurements if each.kind in ("spectrum", "constants")]
    label = label_of(options.quantity or "")
    names = {options.quantity, label.quantity if label else None}
    if options.quantity is not None and optical and not any(names & set(each.data) for each in optical):
        in_file = ", ".join(dict.fromkeys(name for each in optical for name in each.data))
        raise NacreError(f'{path}: quantity = "{options.quantity}" is not in the file, which holds {in_file}')


def _unused(measurement: Measurement, options: ReadOptions) -> list[str]:
    """Return remarks on options that the file overrides: incidence angle and pitch."""
    remarks = []
    for key, requested in (("angle_of_incidence_deg", options.angle_deg), ("pitch_um", options.pitch_um)):
        stated = measurement.data.get(key, measurement.metadata.get(key))
        if requested is not None and stated is not None and not np.allclose(stated, requested, rtol=1e-4):
            option = key.replace("of_incidence_", "")
            remarks.append(f"the file states {np.ravel(stated)[0]:g}; {option} = {requested} is not used")
    return remarks


def _is_cut(path: Path) -> bool:
    """Whether a text file ends inside a row of numbers, without the end of a line."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 512))
        last = file.read().replace(b"\0", b"")
    line = re.split(rb"[\r\n]", last)[-1].strip()
    has_digit, is_text = re.search(rb"\d", line), all(32 <= byte < 127 or byte == 9 for byte in line)
    return bool(has_digit) and is_text and not line.endswith((b">", b"}", b"]"))


# first bytes -> file type
_MAGIC: tuple[tuple[bytes | tuple[bytes, ...], str], ...] = (
    (b"PK\x03\x04", "a zip archive"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an OLE file, as Excel 97 and older programs of instruments write"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    ((b"CDF\x01", b"CDF\x02"), "a NetCDF file"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"BM", "a BMP image"),
    ((b"II*\0", b"MM\0*"), "a TIFF image"),
    (b"%PDF", "a PDF document"),
    (b"{\\rtf", "an RTF document"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"7z\xbc\xaf", "a 7z archive"),
    (b"Rar!", "a RAR archive"),
    (b"MATLAB 5.0", "a MATLAB file"),
    (b"\x93NUMPY", "a NumPy array"),
    ((b"\x7fELF", b"MZ"), "a program"),
    (b"SQLite format 3", "an SQLite database"),
)
_HEAD_PARTS = {b"[Content_Types].xml": "a spreadsheet or document of Office", b"xl/": "an Excel spreadsheet",
               b"mimetypeapplication/vnd.oasis.opendocument": "an OpenDocument file"}  # fmt: skip
EXPORT = (
    "export text in the instrument's program (File, Save as or Export: ASCII, TXT, CSV, JCAMP-DX or ISO 25178 SDF), "
    "with headings and units"
)


def appearance(head: FileHead) -> str:
    """Return a description of a file's content."""
    for magic, what in _MAGIC:
        if head.data.startswith(magic):
            inner = next((more for mark, more in _HEAD_PARTS.items() if mark in head.data), None)
            return inner or what
    start = head.text.lstrip()[:200].lower()
    if not head.is_text:
        return f"a binary file that begins with {head.data[:8].hex(' ')}"
    if start.startswith("<!doctype html") or start.startswith("<html"):
        return "a web page"
    if start.startswith("<"):
        return "an XML file"
    if re.match(r"\{|\[\s*[\[{\"\d-]", start):
        return "a JSON file"
    lines = [line for line in head.lines if line.strip()]
    return f'text that begins with "{"".join(lines[:1]).strip()[:60]}"'


def unknown_file(head: FileHead, known: Sequence[str]) -> str:
    """Return the one-line message for a file that no reader recognises; `known`: titles of all formats."""
    words = {head.path.suffix.lstrip(".").lower(), *(w.lower() for w in head.text[:400].split() if w.isalpha())}
    titles = {word.lower().strip("().,"): title for title in known for word in title.split()}
    near = dict.fromkeys(
        titles[close] for word in sorted(words) if len(word) > 3
        for close in difflib.get_close_matches(word, titles, n=1, cutoff=0.9)
    )  # fmt: skip
    nearest = f"; nearest formats: {', '.join(list(near)[:3])}" if near else ""
    return f"{head.path}: unknown format: {appearance(head)}{nearest}; {EXPORT}"
