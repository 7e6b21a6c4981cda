"""Target colour lists: CSV with L*, a*, b* and optional names, as spreadsheets and instruments write them."""

from __future__ import annotations

import csv
import logging
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array, floats
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import named, size_of
from nacre.light import lch_to_lab
from nacre.optimise.targets import plausible
from nacre.readers.colour_tables import check_scale, named_lab
from nacre.readers.columns import as_float
from nacre.readers.headings import Meaning, light_above, meanings
from nacre.readers.measurement import Measurement
from nacre.readers.registry import POSSIBLE, open_file, recognise
from nacre.readers.table import srgb_of_hex
from nacre.readers.text_table import TextTable, find_delimiter, load_text, parse_tables, split
from nacre.readers.text_table import number as number_of
from nacre.readers.units import UNITS
from nacre.recipe.model import show_value

logger = logging.getLogger("nacre")
MOST_UNIT_Y = 1.1  # up to which XYZ are relative to 1 for white, not 100
MAX_ROWS, MAX_BYTES = 100_000, 64 << 20
DEFAULT_LIGHT = ("D65", "2deg")
MEASURED = ({"L", "a", "b"}, {"L", "C", "hue"}, {"X", "Y", "Z"})
FORMS = (*MEASURED, {"hex"})
COORDINATES = ("L", "a", "b", "C", "hue", "X", "Y", "Z", "hex", "hunter_L", "hunter_a", "hunter_b")


_HEX = re.compile(r"[0-9a-fA-F]{6}|[0-9a-fA-F]{3}")


@dataclass(frozen=True)
class ColourRow:
    """Target colours in one row.

    Attributes:
        name: may be empty.
        lab: `[target, 3]`.
        texture: quantity, such as "sparkle_45", -> number in the column with its name.
    """

    name: str
    lab: Array
    texture: dict[str, float] = field(default_factory=dict)


def read_colours(
    labs: Any,
    targets: int,
    light: tuple[str, str] | None = None,
    geometries: Sequence[str] = (),
    quantities: Sequence[str] = (),
) -> list[ColourRow]:
    """Return target colours from a file, or from an array `[n, 3]` or `[n, target, 3]`.

    Colour lists of other programs (CGATS, CxF, swatches, palettes) and tables of reflectance spectra are recognised by
    their content; their L*a*b* are computed for, or adapted to, `light`, and a warning says how.

    A file row contains L*, a*, b*, optionally after a name; for several targets, one colour for
    all or as many triples. A heading may name the columns: L*, a*, b*, or L, C, h, or X, Y, Z (of white: Y = 100), or
    hex, with lamp and observer (`L*(D50/2deg)`), for several targets with their angles (`L*(15 deg)`) or numbers (`L1`,
    `a1`, ...). An unknown heading is an error. Delimiters are semicolons, tabs, commas or blanks; unless the comma is
    the delimiter, it may be the decimal point.

    Args:
        targets: target count.
        light: illuminant and observer of the targets; other ones in headings are adapted by Bradford's transform, and
            a warning says so. Default: those of the headings.
        geometries: target geometries such as "specular 15", to which colours at several angles are assigned.
        quantities: texture quantities such as "sparkle_45" that column headings may name.

    Raises:
        RecipeError: an entry is not a colour; with its line.
        NacreError: the file cannot be read, or the array has another shape.
    """
    if isinstance(labs, str | Path):
        path = named(labs)
        return _recognised_rows(path, targets, light or DEFAULT_LIGHT) or _file_rows(
            path, targets, light, geometries, quantities
        )
    colours = floats(labs, "labs")
    if colours.size == 0 and colours.shape[:1] == (0,):
        return []
    if colours.ndim == 2 and colours.shape[-1] == 3:
        colours = np.repeat(colours[:, None], targets, axis=1)
    if colours.ndim != 3 or colours.shape[1:] != (targets, 3):
        raise NacreError(f"labs has shape {list(np.shape(labs))}; it should be [n, 3] or [n, {targets}, 3]")
    for number, lab in enumerate(colours.reshape(-1, 3)):
        where = f"labs[{number // targets}]"
        if not np.isfinite(lab).all():
            raise NacreError(f"{where} = {lab.tolist()} should hold finite numbers")
        plausible(lab, where, lab.tolist())
    return [ColourRow("", row) for row in colours]


def _recognised_rows(path: Path, targets: int, light: tuple[str, str]) -> list[ColourRow]:
    """Return the colours of a file that is a known colour list or a table of spectra; empty for plain tables."""
    if size_of(path) == 0:
        return []
    formats = recognise(path)
    if formats and formats[0][1].id == "other":
        open_file(path)  # refuses it by name
    if not formats or formats[0][0] <= POSSIBLE or formats[0][1].kind not in ("colours", "spectrum"):
        return []
    names, lab = _adapted(path, open_file(path), light, is_checked=False)
    return [ColourRow(name, np.repeat(colour[None], targets, axis=0)) for name, colour in zip(names, lab, strict=True)]


def _file_rows(
    path: Path, targets: int, light: tuple[str, str] | None, geometries: Sequence[str], quantities: Sequence[str]
) -> list[ColourRow]:
    text = load_text(path, MAX_BYTES)
    try:
        named_hex = _hex_rows(path, list(cells_of(text)), targets, light or DEFAULT_LIGHT)
        if len(named_hex) > MAX_ROWS:
            raise NacreError(f"{path}: contains {len(named_hex)} rows; at most {MAX_ROWS} are allowed")
        if named_hex:
            return named_hex
        table = _headed(path, text)
        lines = [] if table is not None else list(cells_of(text))
    except csv.Error:
        raise NacreError(f"{path}: is not a CSV of L, a, b") from None
    count = len(lines) if table is None else len(table.rows)
    if count > MAX_ROWS:
        raise NacreError(f"{path}: contains {count} rows; at most {MAX_ROWS} are allowed")
    if table is not None:
        table, numbers = _without_texture(table, quantities)
        colours = _rows_of_table(table, targets, light, geometries)
        return [replace(row, texture=each) for row, each in zip(colours, numbers, strict=True)] if numbers else colours
    if lines and not any(as_float(cell) is not None for cell in lines[0][1]):
        number, heading = lines.pop(0)
        if lines or not _names_colours(heading):
            where = f"{path}: line {number}"
            raise RecipeError(f"{where}: heading {show_value(', '.join(heading))} does not name L, a, b")
    if not lines:
        raise NacreError(f"{path}: contains no colours; write one per line: L, a, b, or name, L, a, b")
    rows = [_row(cells, targets, f"{path}: line {number}") for number, cells in lines]
    lab = np.concatenate([row.lab for row in rows])
    check_scale(lab, path)
    above = light_above([line for line in text.splitlines() if line.lstrip().startswith("#")])
    if light is None or not above:
        return rows
    metadata = {"illuminant": light[0], "observer": light[1]} | above
    columns = {name: lab[:, place] for place, name in enumerate("Lab")}
    _, lab = _adapted(path, [Measurement(path, "colours", columns, "", metadata)], light)
    return [ColourRow(row.name, part) for row, part in zip(rows, np.split(lab, len(rows)), strict=True)]


def _adapted(
    path: Path, measurements: Sequence[Measurement], light: tuple[str, str], is_checked: bool = True
) -> tuple[list[str], Array]:
    """Return names and CIELAB `[colour, 3]` under the light; warn about the conversion."""
    names, lab, remarks = named_lab(path, measurements, *light)
    for number, colour in enumerate(() if is_checked else lab, start=1):
        plausible(colour, f"{path}: colour {number}", colour.round(3).tolist())
    if remarks:
        logger.warning("%s: %s", path, "; ".join(remarks))
    return names, lab


def _hex_rows(path: Path, lines: list[tuple[int, list[str]]], targets: int, light: tuple[str, str]) -> list[ColourRow]:
    """Return the colours in a column "hex", with or without #, three or six digits; empty without one."""
    heading = lines[0][1] if lines else []
    places = [i for i, cell in enumerate(heading) if any(each.quantity == "hex" for each in meanings(cell))]
    if len(places) != 1 or any(len(cells) <= places[0] for _, cells in lines):
        return []
    if any({each.quantity for cell in heading for each in meanings(cell)} >= form for form in MEASURED):
        return []  # beside measured colours, a hex column only shows them
    cells = [row[places[0]].lstrip("#") for _, row in lines[1:]]
    if not cells or not all(_HEX.fullmatch(cell) for cell in cells):
        return []
    name = next((i for i, cell in enumerate(heading) if any(each.quantity == "name" for each in meanings(cell))), None)
    names = [row[name] if name is not None else "" for _, row in lines[1:]]
    data = {"srgb": np.array([srgb_of_hex(path, each) for each in cells])}
    metadata = {"names": names}
    _, lab = _adapted(path, [Measurement(path, "colours", data, "", metadata)], light)
    return [ColourRow(one, np.repeat(each[None], targets, axis=0)) for one, each in zip(names, lab, strict=True)]


def _names_colours(heading: Sequence[str]) -> bool:
    return any(meaning.quantity in COORDINATES for cell in heading for meaning in meanings(cell))


def _headed(path: Path, text: str) -> TextTable | None:
    """Return the table of a list with headings; None without."""
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    if any(as_float(cell) is not None for cell in split(first, find_delimiter(text.splitlines()))):
        return None
    tables = parse_tables(text, path).tables
    return tables[0] if tables and tables[0].headings else None


def _rows_of_table(
    table: TextTable, targets: int, light: tuple[str, str] | None, geometries: Sequence[str]
) -> list[ColourRow]:
    """Return the colours of a table with headings: L*a*b*, LCh, XYZ or hex, once or for each target."""
    name, groups = _groups(table)
    groups = _for_targets(table, groups, targets, geometries)
    names = table.column_text(name) if name is not None else [""] * len(table.rows)
    labs = []
    for group in groups:
        measurement = _measurement(table, group, names, light)
        own = measurement.metadata["illuminant"], measurement.metadata["observer"]
        _, lab = _adapted(table.path, [measurement], light or own)
        if "L" in group.places:
            check_scale(lab, table.path)
        for line, colour in zip(table.lines, lab, strict=True):
            plausible(colour, f"{table.path}: line {line}", colour.round(6).tolist())
        labs.append(lab)
    stacked = np.stack(labs if len(labs) == targets else labs * targets, axis=1)
    return [ColourRow(one, lab) for one, lab in zip(names, stacked, strict=True)]


def _without_texture(table: TextTable, quantities: Sequence[str]) -> tuple[TextTable, list[dict[str, float]]]:
    """Return a table without its columns of texture, and the numbers of each row.

    Raises:
        RecipeError: a quantity occurs twice, or a number is not above 0.
    """
    places = {heading: place for place, heading in enumerate(table.headings) if heading in quantities}
    if not places:
        return table, []
    if len(places) < sum(heading in quantities for heading in table.headings):
        raise RecipeError(f"{table.path}: line {table.heading_line}: a quantity of texture stands twice")
    columns = {name: _column(table, place) for name, place in places.items()}
    for name, column in columns.items():
        for line, value in zip(table.lines, column, strict=True):
            if value <= 0:
                raise RecipeError(f"{table.path}: line {line}: {name} = {value:g} is not above 0")
    others = [place for place in range(len(table.headings)) if place not in places.values()]
    rest = replace(
        table,
        headings=tuple(table.headings[place] for place in others),
        units=tuple(table.units[place] for place in others),
        rows=[[row[place] for place in others] for row in table.rows],
    )
    return rest, [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]


@dataclass(frozen=True)
class _Group:
    """Columns of one colour: index by quantity, properties stated in all headings, and the hue's unit."""

    places: dict[str, int]
    meaning: Meaning
    hue_unit: str = ""


def _groups(table: TextTable) -> tuple[int | None, list[_Group]]:
    """Return the column of names and the columns of each colour.

    Raises:
        RecipeError: headings that are unknown or repeated, or do not name a colour.
    """
    where = f"{table.path}: line {table.heading_line}"
    by_meaning: dict[tuple[float | None, int | None, str], dict[str, tuple[int, Meaning]]] = {}
    name: int | None = None
    unused: list[str] = []
    unknown: list[str] = []
    for place, heading in enumerate(table.headings):
        each = meanings(heading, table.units[place])
        colour = next((meaning for meaning in each if meaning.quantity in COORDINATES), None)
        if colour is None:
            if any(meaning.quantity == "name" for meaning in each) or (place == 0 and not table.is_numeric(0)):
                name = place if name is None else name
            else:
                (unused if each or not heading else unknown).append(heading)
            continue
        group = by_meaning.setdefault((colour.angle_deg, colour.number, colour.mode), {})
        if colour.quantity in group:
            raise RecipeError(f"{where}: {show_value(heading)} stands twice; name the angle of each, as in L*(15 deg)")
        group[colour.quantity] = (place, colour)
    groups = [
        _Group(
            {q: place for q, (place, _) in group.items()},
            next(iter(group.values()))[1],
            group["hue"][1].unit if "hue" in group else "",
        )
        for group in by_meaning.values() if any(form <= set(group) for form in FORMS)
    ]  # fmt: skip
    if not groups or len(groups) < len(by_meaning):
        headings = show_value(", ".join(table.headings))
        more = "; Hunter Lab is not read" if any("hunter" in q for group in by_meaning.values() for q in group) else ""
        raise RecipeError(f"{where}: heading {headings} does not name L, a, b (or L, C, h; X, Y, Z; hex){more}")
    if unknown:
        raise RecipeError(f"{where}: {show_value(', '.join(unknown))} is not a known column; delete it or name it")
    if unused:
        logger.warning("%s: not used: %s", table.path, ", ".join(unused))
    return name, groups


def _for_targets(table: TextTable, groups: list[_Group], targets: int, geometries: Sequence[str]) -> list[_Group]:
    """Return one colour for all targets, or one per target: by their angles, else in the order of the columns."""
    if len(groups) not in (1, targets):
        raise RecipeError(
            f"{table.path}: line {table.heading_line}: holds {len(groups)} colours a row for {targets} targets: "
            f"{show_value(', '.join(table.headings))}"
        )
    angles = [group.meaning.angle_deg for group in groups]
    if len(groups) == 1 or None in angles:
        return groups
    goals_deg = [float(m[0]) if (m := re.search(r"-?\d+(?:\.\d+)?", each)) else math.nan for each in geometries]
    if sorted(goals_deg) == sorted(float(angle) for angle in angles if angle is not None):
        return [groups[angles.index(angle)] for angle in goals_deg]
    logger.warning("%s: the colours at %s degrees are taken for the targets in this order", table.path, angles)
    return groups


def _measurement(table: TextTable, group: _Group, names: list[str], light: tuple[str, str] | None) -> Measurement:
    """Return the colours of one group; lamp and observer are the target's unless the table states others."""
    above = light_above(table.titles)
    lamp, view = light or DEFAULT_LIGHT
    observer = f"{group.meaning.observer}deg" if group.meaning.observer else above.get("observer", view)
    lamp = group.meaning.illuminant or above.get("illuminant", lamp)
    metadata = {"illuminant": lamp, "observer": observer, "names": names}
    data: dict[str, Array] = {}
    if set(group.places) == {"hex"}:
        cells = table.column_text(group.places["hex"])
        data["srgb"] = np.array([srgb_of_hex(table.path, cell) for cell in cells])
        return Measurement(table.path, "colours", data, "", metadata)
    columns = {quantity: _column(table, place) for quantity, place in group.places.items() if quantity != "hex"}
    for line, chroma in zip(table.lines, columns.get("C", ()), strict=False):
        if chroma < 0:
            raise RecipeError(f"{table.path}: line {line}: C = {chroma:g} is a negative chroma; allowed: 0 or more")
    if "C" in columns and "a" not in columns:
        hue = columns["hue"] * (1.0 if group.hue_unit in ("", "deg") else UNITS[group.hue_unit][1])
        lab = np.asarray(lch_to_lab(np.stack([columns["L"], columns["C"], hue], axis=-1)))
        columns = {"L": lab[:, 0], "a": lab[:, 1], "b": lab[:, 2]}
    letters = "Lab" if "a" in columns else "XYZ"
    if letters == "XYZ" and len(columns["Y"]) and 0.0 < columns["Y"].max() <= MOST_UNIT_Y:
        columns = {quantity: 100.0 * values for quantity, values in columns.items()}
        logger.warning("%s: Y of white = 1, because no Y is above %g", table.path, MOST_UNIT_Y)
    return Measurement(table.path, "colours", {letter: columns[letter] for letter in letters}, "", metadata)


def _column(table: TextTable, place: int) -> Array:
    numbers = []
    for row, line in zip(table.rows, table.lines, strict=True):
        value = number_of(row[place], table.grouping)
        if row[place] == "":
            filled = sum(bool(cell) for cell in row)
            cells = show_value(", ".join(cell for cell in row if cell))
            rule = f"has {filled} cells, fewer than the heading needs for L, a, b"
            raise RecipeError(f"{table.path}: line {line}: {cells} {rule}")
        if value is None or not math.isfinite(value):
            raise RecipeError(f"{table.path}: line {line}: {show_value(row[place])} is not a number")
        numbers.append(value)
    return np.array(numbers)


def cells_of(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells for each line that is neither empty nor a comment."""
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and (line[0] != "#" or _is_named_row(line))]
    mark = next((mark for mark in ";\t," if any(mark in line for _, line in lines)), None)
    for number, line in lines:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=mark or " ", skipinitialspace=True))]
        if mark is None:
            cells = _with_name_joined([cell for cell in cells if cell])
        elif mark != ",":
            cells = [_with_point(cell) for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            yield number, cells


def _is_named_row(line: str) -> bool:
    """Whether a line is a colour whose name starts with #, as "#1;52;-30;28", not a remark."""
    cells = [_with_point(cell.strip()) for cell in split(line, find_delimiter([line]))]
    return len(cells) > 3 and line[1:2].strip() != "" and all(as_float(cell) is not None for cell in cells[1:])


def _with_name_joined(cells: list[str]) -> list[str]:
    first = next((place for place, cell in enumerate(cells) if as_float(cell) is not None), 0)
    return [" ".join(cells[:first]), *cells[first:]] if first > 1 else cells


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if as_float(cell.replace(",", ".")) is not None else cell


def _row(cells: Sequence[str], targets: int, where: str) -> ColourRow:
    """Return the colours of a row without headings."""
    text = show_value(", ".join(cells))
    has_name = len(cells) % 3 == 1
    name, words = (cells[0] if has_name else ""), list(cells[has_name:])
    if len(words) not in (3, 3 * targets):
        form = "L, a, b, or name, L, a, b" + ("" if targets == 1 else f", or {targets} such triples")
        raise RecipeError(f"{where}: {text} should hold {form}")
    numbers = [as_float(word) for word in words]
    for word, number in zip(words, numbers, strict=True):
        if number is None or not math.isfinite(number):
            raise RecipeError(f"{where}: {show_value(word)} is not a number; a row is L, a, b, or name, L, a, b")
    lab = np.array(numbers, dtype=float).reshape(-1, 3)
    for triple in lab:
        plausible(triple, where, triple.tolist())
    return ColourRow(name, np.repeat(lab, targets, axis=0) if len(lab) == 1 else lab)
