"""Delimited colour tables without a head of CGATS.

Headings are x, y, Y, or R, G, B, or L*, a*, b* (L*, C*, h) beside columns of illuminant and observer, or the field
names of CGATS.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.colours.cgats import Table, measurement_of
from nacre.readers.colours.lab import SRGB, colours, illuminant_in
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import LIKELY, FileHead
from nacre.readers.spectra.common import number, read_text

XYY = {"x": "XYY_X", "y": "XYY_Y", "Y": "XYY_CAPY"}
RGB = {"r": "RGB_R", "g": "RGB_G", "b": "RGB_B", "red": "RGB_R", "green": "RGB_G", "blue": "RGB_B"}
NAMES = {"name": "SAMPLE_NAME", "patch": "SAMPLE_NAME", "colour": "SAMPLE_NAME", "color": "SAMPLE_NAME",
         "colourname": "SAMPLE_NAME", "colorname": "SAMPLE_NAME", "samplename": "SAMPLE_NAME", "id": "SAMPLE_ID",
         "no": "SAMPLE_ID", "nr": "SAMPLE_ID", "number": "SAMPLE_ID", "index": "SAMPLE_ID", "sampleid": "SAMPLE_ID",
         "sample": "SAMPLE_ID"}  # fmt: skip
LAB = {"l": "LAB_L", "a": "LAB_A", "b": "LAB_B", "c": "LAB_C", "h": "LAB_H"}
LIGHTS = {"illuminant": "ILLUMINANT", "illum": "ILLUMINANT", "lightsource": "ILLUMINANT", "observer": "OBSERVER",
          "observerangle": "OBSERVER", "obs": "OBSERVER", "illuminantobserver": "BOTH", "illobs": "BOTH"}  # fmt: skip
OBSERVER_BEHIND = re.compile(r"[\s/,]+(?:2|10)\b|19(?:31|64)")
FACTOR_LIMIT = 1.1  # above the Y of any reflecting sample with a white of 1


def sniff_colour_table(head: FileHead) -> float:
    """Return a confidence above that of a text table for headings of one of the three kinds."""
    return LIKELY + 0.1 if head.is_text and _start([line for line in head.lines if line.strip()]) is not None else 0.0


def read_colour_table(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the colours.

    Raises:
        NacreError: a row has other cells than headings, or R, G, B are neither 0 to 1 nor 0 to 255.
    """
    lines = [line for line in read_text(path).lines if line.strip()]
    start = _start(lines)
    fields = None if start is None else _fields(_cells(lines[start]))
    if start is None or fields is None:
        raise NacreError(f"{path}: its headings are no colours")
    rows = [_cells(line) for line in lines[start + 1 :]]
    for row in rows:
        if len(row) != len(fields):
            raise NacreError(f'{path}: the row "{" ".join(row)[:60]}" has {len(row)} cells for {len(fields)} headings')
    light = _light(path, fields, rows)
    kept = [place for place, field in enumerate(fields) if field not in LIGHTS.values()]
    fields, rows = [fields[place] for place in kept], [[row[place] for place in kept] for row in rows]
    found = measurement_of(path, Table(light, fields, rows, ended=True))
    if found is None:
        return [_rgb(path, fields, rows)]
    if "XYY_CAPY" in fields and float(found.data["Y"].max()) <= FACTOR_LIMIT:
        data = {key: values * 100.0 if key in "XYZ" else values for key, values in found.data.items()}
        note = f"Y of white = 1, because no Y is above {FACTOR_LIMIT}"
        found = replace(found, data=data, assumed=(*found.assumed, note))
    return [replace(found, format="colour-table")]


def _start(lines: list[str]) -> int | None:
    """Return the place of the headings: the first line, or names of CGATS below at most 12 lines of remarks."""
    if lines and _fields(_cells(lines[0])):
        return 0
    return next((at for at, line in enumerate(lines[1:13], start=1) if _named_as_cgats(_cells(line))), None)


def _named_as_cgats(cells: list[str]) -> bool:
    upper = {cell.upper() for cell in cells}
    return {"LAB_L", "LAB_A", "LAB_B"} <= upper or {"XYZ_X", "XYZ_Y", "XYZ_Z"} <= upper


def _cells(line: str) -> list[str]:
    mark = next((mark for mark in ("\t", ";", ",") if mark in line), None)
    return [cell.strip().strip('"').strip() for cell in line.split(mark)]


def _fields(cells: list[str]) -> list[str] | None:
    """Return the field names of CGATS for a row of headings, or None if it names no colours."""
    upper = [cell.upper() for cell in cells]
    if _named_as_cgats(cells):
        return upper if len(set(upper)) == len(upper) else None
    words = [re.sub(r"[\W_]", "", cell).lower() for cell in cells]
    named = [NAMES.get(word) for word in words]
    if all(cells.count(letter) == 1 for letter in XYY):
        return [XYY.get(cell) or name or f"OTHER_{cell}" for cell, name in zip(cells, named, strict=True)]
    polar = [LAB.get(word) for word in words]
    is_lab = sorted(filter(None, polar)) in (["LAB_A", "LAB_B", "LAB_L"], ["LAB_C", "LAB_H", "LAB_L"])
    if is_lab and any(word in LIGHTS for word in words):
        known = [a or LIGHTS.get(word) or b for a, word, b in zip(polar, words, named, strict=True)]
        return [field or f"OTHER_{cell}" for field, cell in zip(known, cells, strict=True)]
    colour = [RGB.get(word) for word in words]
    is_rgb = sorted(filter(None, colour)) == ["RGB_B", "RGB_G", "RGB_R"]
    if is_rgb and all(a or b for a, b in zip(colour, named, strict=True)) and len(set(named)) > len(named) - 3:
        return [a or str(b) for a, b in zip(colour, named, strict=True)]
    return None


def _light(path: Path, fields: list[str], rows: list[list[str]]) -> dict[str, str]:
    """Return illuminant and observer from columns that hold the same in every row.

    Raises:
        NacreError: rows have different ones.
    """
    found: dict[str, str] = {}
    for place, field in enumerate(fields):
        if field in LIGHTS.values():
            texts = {row[place] for row in rows}
            if len(texts) > 1:
                shown = ", ".join(sorted(texts)[:4])
                raise NacreError(
                    f"{path}: the rows are for different illuminants or observers: {shown}; split the file"
                )
            text = "".join(texts)
            # "D65/10" in the illuminant column states both
            if field != "OBSERVER" and illuminant_in(text):
                found["ILLUMINANT"] = text
            if field == "OBSERVER" or (OBSERVER_BEHIND.search(text) and "OBSERVER" not in found):
                found["OBSERVER"] = text
    return found


def _rgb(path: Path, fields: list[str], rows: list[list[str]]) -> Measurement:
    values = [[number(row[fields.index(f"RGB_{letter}")]) for letter in "RGB"] for row in rows]
    if any(value is None for row in values for value in row) or not rows:
        raise NacreError(f"{path}: holds red, green, blue that are not numbers")
    srgb = np.array(values, dtype=float)
    is_bytes = srgb.max() > 1.0
    if srgb.min() < 0.0 or srgb.max() > 255.0 or (is_bytes and np.any(srgb != np.round(srgb))):
        raise NacreError(f"{path}: red, green, blue are neither 0 to 1 nor whole numbers of 0 to 255")
    names = next((fields.index(name) for name in ("SAMPLE_NAME", "SAMPLE_ID") if name in fields), None)
    texts = [row[names] if names is not None else str(count) for count, row in enumerate(rows, start=1)]
    return colours(path, "colour-table", texts, {"srgb": srgb / 255.0 if is_bytes else srgb}, assumed=[SRGB])
