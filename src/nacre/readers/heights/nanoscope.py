"""Bruker, Veeco and Digital Instruments Nanoscope files (.spm, or a number as suffix): text head, integers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, chosen, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGICS = (b"\\*File list", b"\\*EC File list", b"?*File list")
IMAGES = ("ciao image list", "afm image list", "stm image list", "nca image list", "image list")
FOUR_BYTES_FROM = 0x09200000  # version from which integers have four bytes whatever the head says
VALUE = re.compile(r"(?P<kind>[VCS])\s*(?:\[(?P<soft>[^\]]*)\])?\s*(?:\((?P<lsb>[^)]*)\))?\s*(?P<rest>.*)")
NUMBER = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*)")

Section = dict[str, str]


def sniff(head: FileHead) -> float:
    """Return 1 for the first line of the format."""
    return CERTAIN if head.data.startswith(MAGICS) else 0.0


def _sections(data: bytes) -> list[tuple[str, Section]]:
    found: list[tuple[str, Section]] = []
    for line in data.split(b"\x1a")[0].decode("latin-1").splitlines():
        if line.startswith(("\\*", "?*")):
            name = line[2:].strip().lower()
            if name == "file list end":
                break
            found.append((name, {}))
        elif line.startswith("\\") and found:
            key, _, value = line[1:].partition(": ")
            found[-1][1][key.strip().lower()] = value.strip()
    return found


def _scale_um(image: Section, scanner: Mapping[str, str], bits: int) -> float | None:
    """Return um per integer, or None if the channel holds no lengths.

    The full range of the integers is the hard value of the Z scale, times the sensitivity that it names.
    """
    text = image.get("@2:z scale", image.get("@4:z scale"))
    if text is None:
        raise NacreError('has no "@2:Z scale": Nanoscope versions up to 4.2 are not read; save it as .gwy or .sdf')
    scale = VALUE.match(text)
    hard = NUMBER.match(scale["rest"].strip()) if scale else None
    if scale is None or hard is None:
        raise ValueError(f"Z scale is {text[:40]}")
    per_lsb, unit = float(hard[1]) / 2.0**bits, hard[2].strip()
    if scale["soft"]:
        soft = VALUE.match(scanner.get(f"@{scale['soft'].lower()}", ""))
        value = NUMBER.match(soft["rest"].strip()) if soft else None
        if value is None:
            return None
        per_lsb *= float(value[1])
        unit = value[2].split("/")[0].strip() if "/" in value[2] else ""
    factor = length_um(unit) if unit else None
    return None if factor is None else per_lsb * factor


def _size_um(image: Section, scan: Mapping[str, str]) -> tuple[float, float]:
    words = image.get("scan size", scan.get("scan size", "")).split()
    numbers = [float(w) for w in words if NUMBER.fullmatch(w)]
    factor = length_um(words[-1])
    if not numbers or factor is None:
        raise ValueError(f'scan size is "{" ".join(words)}"')
    width, height = numbers[0] * factor, numbers[-1] * factor
    slow = scan.get("slow axis size", "").split()
    if len(slow) == 2 and (unit := length_um(slow[1])) is not None:
        height = float(slow[0]) * unit
    return width, height


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels that are heights; the last line measured is the first of the file.

    Raises:
        NacreError: force curves, or no channel of heights.
    """
    data = path.read_bytes()
    sections = _sections(data)
    merged: dict[str, str] = {}
    for name, fields in sections:
        if name not in IMAGES:
            merged.update(fields)
    if merged.get("start context") == "FOL" or merged.get("operating mode") == "Force":
        raise NacreError(f"{path}: holds force curves, no height map")
    version = int(next((f["version"] for n, f in sections if n.endswith("file list") and "version" in f), "0"), 16)
    maps, others = [], []
    for name, image in sections:
        if name not in IMAGES:
            continue
        title = re.search(r'"([^"]*)"', image.get("@2:image data", image.get("@4:image data", "")))
        channel = title[1] if title else name
        direction = image.get("line direction", "")
        columns, rows = int(image["samps/line"]), int(image["number of lines"])
        size = int(image.get("bytes/pixel", "2"))
        length = int(image["data length"])
        if int(image["data offset"]) + length > len(data):
            raise ValueError(f'channel "{channel}" ends after the file')
        held = 4 if version >= FOUR_BYTES_FROM and length >= 4 * columns * rows else size
        try:
            scale = _scale_um(image, merged, 8 * size)
        except NacreError as error:
            raise NacreError(f"{path}: {error}") from None
        if scale is None:
            others.append(f'"{channel}"')
            continue
        width, height = _size_um(image, merged)
        raw = array(data, "<i4" if held == 4 else "<i2", (rows, columns), int(image["data offset"]))
        label = channel if direction in ("", "Trace") else f"{channel} ({direction})"
        aspect = _aspect(image)
        pitch = width / columns, (height if height != width or aspect == 1.0 else height / aspect) / rows
        maps.append(height_map(path, "nanoscope", raw[::-1] * scale, pitch, label, {"date": merged.get("date", "")}))
    left = tuple(f"channel {name}: no height" for name in others)
    return [_with(one, left) for one in chosen(path, maps, others, options)]


def _aspect(image: Section) -> float:
    """Return width over height of the scan, which one number for its size leaves open."""
    words = image.get("aspect ratio", "1:1").split(":")
    return float(words[0]) / float(words[1]) if len(words) == 2 else 1.0


def _with(one: Measurement, left: tuple[str, ...]) -> Measurement:
    from dataclasses import replace

    return replace(one, left_out=left)
