"""Spectra and curves for recipes and targets: the columns that a key needs, from any file that can hold them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import pydantic
from pydantic import Field

from nacre.core.errors import NacreError
from nacre.light import spans_colour
from nacre.readers.columns import Column, Columns, interpret, load_tables
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import open_file
from nacre.readers.text_table import TextTable, number
from nacre.readers.units import UNITS, Floats, parse_unit
from nacre.recipe.model import RecipeContext, RecipeModel, show_value

logger = logging.getLogger("nacre")
Content = TypeVar("Content", bound=tuple[Any, ...])
_AXES = ("wavelength_nm", "angle_of_incidence_deg")


@dataclass(frozen=True)
class Axis:
    """One column that a curve needs.

    Attributes:
        label: for messages, with its unit.
        quantities: accepted quantities from the vocabulary.
        unit: target unit, also assumed for numbers without one; "" for pure numbers, per cent becomes a factor.
    """

    label: str
    quantities: tuple[str, ...]
    unit: str = ""


X_UM, Y_UM = Axis("x (um)", ("x",), "um"), Axis("y (um)", ("y",), "um")
Q_PER_UM, STRUCTURE = Axis("q (1/um)", ("q",), "1/um"), Axis("S", ("structure_factor",))
THICKNESS_NM, SHARE = Axis("thickness (nm)", ("thickness",), "nm"), Axis("share", ("share",))


def curve(path: Path, axes: Sequence[Axis], options: ReadOptions | None = None) -> tuple[Floats, list[str]]:
    """Return `[row, axis]` and one sentence for each assumption and each column that is not used.

    A table without headings has exactly these columns, in their order and units.

    Raises:
        NacreError: unreadable, several blocks, a column that is missing or unknown, a unit of another dimension, or
            cells without a number.
    """
    options = options or ReadOptions()
    try:
        file = load_tables(path)
    except NacreError as error:
        if "no rows" in str(error):
            raise NacreError(f"{path}: must hold two numbers a line") from None
        raise
    table, *others = file.tables
    if others:
        raise NacreError(f"{path}: holds {len(file.tables)} tables; keep one")
    names = tuple(axis.quantities[0] for axis in axes)
    wanted = {quantity for axis in axes for quantity in axis.quantities}
    _check_cells(table)
    columns = interpret(table, wanted, options, {len(axes): names})
    rows = np.stack([_converted(columns, axis, options.unit) for axis in axes], axis=1)
    if not np.isfinite(rows).all():
        line = table.lines[int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])]
        raise NacreError(f"{path}: must hold finite numbers; line {line} does not")
    assumed = columns.assumed if table.headings else []
    return rows, [*assumed, *file.left_out, *(f'"{heading}" is not used' for heading in columns.unused)]


def _check_cells(table: TextTable) -> None:
    """Refuse a row that holds a word or a single cell."""
    if table.width != 2:
        return
    for row, line in zip(table.rows, table.lines):
        values = [number(cell, table.grouping) for cell in row]
        if None in values or row[1] == "":
            text = " ".join(row).strip()[:40]
            raise NacreError(f'{table.path}: holds "{text}" in line {line} where two numbers should stand')


def _converted(columns: Columns, axis: Axis, stated: str | None) -> Floats:
    column = columns.one(*axis.quantities)
    if column is None:
        raise NacreError(f"{columns.path}: no column {axis.label}; the columns are {columns.table.shown_headings}")
    if not axis.unit:
        return column.factors()
    if stated is None or column.unit:
        return in_unit(columns, column, axis.unit)
    unit = parse_unit(stated)
    if unit is None or UNITS[unit][0] != UNITS[axis.unit][0]:
        allowed = [name for name, (kind, _) in UNITS.items() if kind == UNITS[axis.unit][0]]
        name = axis.label.partition(" (")[0]
        raise NacreError(f'{columns.path}: unit = "{stated}" is not a unit of {name}; allowed: {", ".join(allowed)}')
    return in_unit(columns, replace(column, meaning=replace(column.meaning, unit=unit)), axis.unit)


def in_unit(columns: Columns, column: Column, unit: str) -> Floats:
    """Return a column in a unit of its dimension; numbers without a unit are in it.

    Raises:
        NacreError: the column's unit has another dimension, such as pixels.
    """
    if not column.unit:
        if columns.table.headings:
            columns.assumed.append(f'"{column.heading}" is in {unit}')
        return column.values
    if UNITS[column.unit][0] != UNITS[unit][0]:
        kind = UNITS[unit][0].replace("wavenumber", "inverse length")
        raise NacreError(f'{columns.path}: "{column.heading}": {column.unit} is no {kind}; convert it to {unit}')
    return np.asarray(column.values * (UNITS[column.unit][1] / UNITS[unit][1]))


def spectrum(
    path: Path, quantities: Sequence[str], options: ReadOptions | None = None
) -> tuple[Floats, Floats, list[str]]:
    """Read the only spectrum of a quantity in a file: ascending wavelengths in nm, factors, and assumptions.

    Args:
        quantities: names of the quantity in `Measurement.data`; the first one applies to a table without headings.

    Raises:
        NacreError: no such spectrum, or several; the message lists the file's contents.
    """
    options = replace(options or ReadOptions(), expects="spectrum", assumed_quantity=quantities[0])
    try:
        sets = open_file(path, options)
    except AmbiguousFileError as error:
        if error.option != "quantity":
            raise
        sets = open_file(path, replace(options, quantity=quantities[0]))
    spectra = [each for each in sets if each.kind == "spectrum"]
    usable = [(each, quantity) for each in spectra for quantity in quantities if quantity in each.data]
    if not usable:
        names = sorted({name for each in sets for name in each.data if not name.startswith(("wavelength", "angle"))})
        raise NacreError(f"{path}: holds {', '.join(names)[:80]} ({sets[0].kind}), no {quantities[0]}")
    visible = [pair for pair in usable if spans_colour(pair[0].data["wavelength_nm"])]
    if len(usable) > 1 and len(visible) == 1 and options.spectrum is None:
        each, quantity = visible[0]
    elif len(usable) > 1:
        each, quantity = _chosen(path, usable, options)
    else:
        each, quantity = usable[0]
    nm, values = np.asarray(each.data["wavelength_nm"], dtype=float), np.asarray(each.data[quantity], dtype=float)
    if "angle_of_incidence_deg" in each.data and len(np.unique(each.data["angle_of_incidence_deg"])) > 1:
        raise NacreError(f"{path}: holds spectra at several angles; keep one")
    remarks = [f"{name} is not used" for name in each.data if name not in (quantity, f"{quantity}_error", *_AXES)]
    angle = each.data.get("angle_of_incidence_deg", each.metadata.get("angle_of_incidence_deg"))
    if angle is not None:
        remarks.append(f"was measured at {float(np.ravel(angle)[0]):g} degrees")
    if each.metadata.get("polarisation") or each.metadata.get("polarisations"):
        remarks.append("was measured in polarised light")
    keep = np.isfinite(nm) & np.isfinite(values)
    nm, values = nm[keep], values[keep]
    order = np.argsort(nm, kind="stable")
    return nm[order], values[order], [*each.assumed, *each.left_out, *remarks]


def _chosen(path: Path, usable: list[tuple[Measurement, str]], options: ReadOptions) -> tuple[Measurement, str]:
    names = [each.name or str(i + 1) for i, (each, _) in enumerate(usable)]
    if options.spectrum is None:
        raise AmbiguousFileError(
            f"{path}: holds {len(usable)} spectra ({', '.join(names)[:120]}); keep one", "spectrum", tuple(names)
        )
    from nacre.readers.table import chosen_block

    return usable[chosen_block(path, options.spectrum, names)]


def recipe_curve(context: RecipeContext, key: str, spec: FileSpec, axes: Sequence[Axis]) -> Floats:
    """Return `[row, axis]` of a file that a recipe names; assumptions are logged.

    Raises:
        RecipeError: with the key and the file's name.
    """
    table, remarks = _of_recipe(context, key, spec, lambda path: curve(path, axes, spec.options))
    _log(context, spec, remarks)
    return table


def recipe_spectrum(context: RecipeContext, key: str, spec: FileSpec, quantities: Sequence[str]) -> Floats:
    """Read a spectrum file that a recipe names, `[row, (nm, factor)]`, ascending; log all assumptions.

    Raises:
        RecipeError: the file cannot be read; the message contains the key and the file name.
    """
    nm, values, remarks = _of_recipe(context, key, spec, lambda path: spectrum(path, quantities, spec.options))
    _log(context, spec, remarks)
    return np.stack([nm, values], axis=1)


def _of_recipe(context: RecipeContext, key: str, spec: FileSpec, read: Callable[[Path], Content]) -> Content:
    path = context.path(spec.file)
    try:
        return read(path)
    except NacreError as error:
        problem = str(error).removeprefix(f"{path}").lstrip(": ")
        problem = problem if problem.startswith(("holds ", "must ")) else f"is not usable: {problem}"
        raise context.fail(key, spec.file, problem) from None


def _log(context: RecipeContext, spec: FileSpec, remarks: Sequence[str]) -> None:
    if remarks:
        logger.warning("%s: %s: %s", context.source, spec.file, "; ".join(remarks))


# A file of measured data in a recipe or target: its name, or a table with properties that the file lacks.


class FileSpec(RecipeModel):
    """A file of measured data: its name, or a table with properties that the file lacks."""

    noun: ClassVar[str] = "measured file"
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = ({"type": "string"},)

    file: str = Field(description="the file, beside the recipe", examples=["data.csv"])
    columns: tuple[str, ...] = Field(
        default=(),
        description='names of its columns if headings are missing; "-" leaves one out',
        examples=[["wavelength_nm", "reflectance"]],
    )
    ignore: tuple[str, ...] = Field(
        default=(), description="headings of columns that are left out", examples=[["batch"]]
    )
    unit: str | None = Field(
        default=None, description="unit of its wavelengths or energies, if the file lacks it", examples=["um"]
    )
    spectrum: str | None = Field(default=None, description="name or number of one of its spectra", examples=["red"])

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_name(cls, data: Any) -> Any:
        if isinstance(data, str) and cls.shorthands:
            return {"file": data}
        if not isinstance(data, Mapping | FileSpec):
            raise ValueError(f'= {show_value(data)} is not a file; write "data.csv" or {{file = "data.csv", ...}}')
        return data

    @property
    def options(self) -> ReadOptions:
        """The statements for the reader."""
        return ReadOptions(columns=self.columns, ignore=self.ignore, unit=self.unit, spectrum=self.spectrum)
