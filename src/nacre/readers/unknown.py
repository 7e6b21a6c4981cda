"""Describe a file in an unknown format, and how to export text from an instrument's program."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence

from nacre.readers.file_head import FileHead

# first bytes -> what the file is
_MAGIC: tuple[tuple[bytes, str], ...] = (
    (b"PK\x03\x04", "a zip archive"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an OLE file, as Excel 97 and older programs of instruments write"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    (b"CDF\x01", "a NetCDF file"),
    (b"CDF\x02", "a NetCDF file"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"BM", "a BMP image"),
    (b"II*\0", "a TIFF image"),
    (b"MM\0*", "a TIFF image"),
    (b"%PDF", "a PDF document"),
    (b"{\\rtf", "an RTF document"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"7z\xbc\xaf", "a 7z archive"),
    (b"Rar!", "a RAR archive"),
    (b"MATLAB 5.0", "a MATLAB file"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a program"),
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
    first = lines[0].strip()[:60] if lines else ""
    return f'text that begins with "{first}"'


def unknown_file(head: FileHead, known: Sequence[str]) -> str:
    """Return the one-line message for a file that no reader recognises; `known`: titles of all formats."""
    words = {head.path.suffix.lstrip(".").lower()} | {
        word.lower() for word in head.text[:400].split() if word.isalpha()
    }
    titles = {word.lower().strip("().,"): title for title in known for word in title.split()}
    near = dict.fromkeys(
        titles[close] for word in sorted(words) if len(word) > 3
        for close in difflib.get_close_matches(word, titles, n=1, cutoff=0.9)
    )  # fmt: skip
    nearest = f"; nearest formats: {', '.join(list(near)[:3])}" if near else ""
    return f"{head.path}: unknown format: {appearance(head)}{nearest}; {EXPORT}"
