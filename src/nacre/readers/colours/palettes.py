"""Palettes of sRGB: GIMP `.gpl`, LibreOffice `.soc`, JASC-PAL, and lists of hexadecimal colours."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.colours.common import SRGB, colours
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.spectra.common import read_text

_ROW = re.compile(r"\s*(\d{1,3})\s+(\d{1,3})\s+(\d{1,3})(?:\s+(.*\S))?\s*$")
_ALPHA = re.compile(r"\s*(\d{1,3}\s+\d{1,3}\s+\d{1,3})\s+(\d{1,3})(?=\s|$)")
_HEX = re.compile(
    r"\s*(?:(?P<name>[^#;,\t]*?)[\s,;:\t]+)?(?P<mark>#|0x)?(?P<hex>[0-9A-Fa-f]{6}|[0-9A-Fa-f]{8})(?:[\s,;:]+(?P<after>\S.*))?\s*$"
)
LONGEST = 300  # characters of a line
_SOC = re.compile(r"<draw:color\b([^>]*)/?>")
_ATTRIBUTE = re.compile(r'draw:(name|color)\s*=\s*"([^"]*)"')


def sniff(head: FileHead) -> float:
    """Return 1 for the first lines of .gpl and JASC-PAL and the elements of .soc, 0.6 for hexadecimal lines."""
    first = head.text.lstrip()[:20]
    if first.startswith(("GIMP Palette", "JASC-PAL")) or "<draw:color " in head.text:
        return CERTAIN
    lines = [line for line in head.lines[:200] if line.strip() and not _is_remark(line)]
    if not head.is_text or not lines or head.size > 1 << 22 or max(map(len, lines)) > LONGEST:
        return 0.0  # the search for a name is cubic in a line's blanks
    whole = lines[:-1] if head.size > len(head.data) else lines
    matches = [_HEX.fullmatch(line) for line in whole]
    is_hex = all(matches) and any(match["mark"] or re.search("[A-Fa-f]", match["hex"]) for match in matches if match)
    return LIKELY if is_hex else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the colours and their names.

    Raises:
        NacreError: a line is not a colour, or a number is above 255.
    """
    text = read_text(path)
    joined = "\n".join(text.lines)
    name = ""
    if "<draw:color " in joined:
        found = [_hex_entry(path, dict(_ATTRIBUTE.findall(entry))) for entry in _SOC.findall(joined)]
        format_id = "soc"
    elif joined.lstrip().startswith(("GIMP Palette", "JASC-PAL")):
        found, name = _rows(path, text.lines)
        format_id = "gpl"
    else:
        lines = [line for line in text.lines if line.strip() and not _is_remark(line)]
        matches = [_HEX.fullmatch(line) if len(line) <= LONGEST else None for line in lines]
        if not all(matches):
            bad = next(line for line, match in zip(lines, matches, strict=True) if not match)
            raise NacreError(f'{path}: "{bad.strip()[:40]}" is no hexadecimal colour')
        found = [(_rgb(match["hex"]), (match["name"] or match["after"] or "").strip()) for match in matches if match]
        format_id = "hex"
    names = [own or str(place) for place, (_, own) in enumerate(found, start=1)]
    srgb = [rgb for rgb, _ in found]
    return [colours(path, "palette", names, {"srgb": srgb}, name=name, metadata={"form": format_id}, assumed=[SRGB])]


def _is_remark(line: str) -> bool:
    text = line.strip()
    return text.startswith((";", "//")) or (text.startswith("#") and not re.match(r"#[0-9A-Fa-f]{6}", text))


def _rows(path: Path, lines: list[str]) -> tuple[list[tuple[list[float], str]], str]:
    """Return the colours of .gpl or JASC-PAL (version, count, then rows) and the palette's name."""
    found: list[tuple[list[float], str]] = []
    name, stated = "", None
    has_alpha = any(re.match(r"\s*Channels\s*:\s*RGBA\s*$", line) for line in lines[:20])  # Aseprite
    is_jasc = lines[0].strip().startswith("JASC-PAL")
    for number, line in enumerate(lines):
        text = line.strip()
        if is_jasc and number in (1, 2):
            stated = int(text) if number == 2 else stated
            continue
        if not text or number == 0 or text.startswith("#") or re.match(r"(Name|Columns|Channels)\s*:", text):
            name = text.partition(":")[2].strip() if text.startswith("Name") else name
            continue
        match = _ROW.match(_ALPHA.sub(r"\1 ", line) if has_alpha else line)
        if match is None or any(int(match[place]) > 255 for place in (1, 2, 3)):
            raise NacreError(
                f'{path}: line {number + 1}: "{text[:40]}" is no colour: red, green, blue (0 to 255), name'
            )
        found.append(([int(match[place]) / 255.0 for place in (1, 2, 3)], match[4] or ""))
    if stated is not None and stated != len(found):
        raise NacreError(f"{path}: states {stated} colours, and {len(found)} are there; the file is cut")
    return found, name


def _hex_entry(path: Path, attributes: dict[str, str]) -> tuple[list[float], str]:
    value = attributes.get("color", "").lstrip("#")
    if not re.fullmatch("[0-9A-Fa-f]{6}", value):
        raise NacreError(f'{path}: draw:color = "{value}" is no hexadecimal colour')
    return _rgb(value), unescape(attributes.get("name", ""))


def _rgb(value: str) -> list[float]:
    """Return red, green, blue of RRGGBB, or of AARRGGBB as Paint.NET writes it."""
    return [int(value[-6:][place : place + 2], 16) / 255.0 for place in (0, 2, 4)]
