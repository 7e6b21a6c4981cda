"""Fit data: several measurements of one sample, CIELAB at several geometries, and numbers of texture."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nacre.analysis.measured import MAX_POWER, MIN_POWER, RELATIVE_FLOOR
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.core.files import plain
from nacre.families.contract import Diffracting, is_direct, surrogate_radiance
from nacre.light import default_wavelengths, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.material.material import Material
from nacre.measure.colours import geometry_colours, recipe_geometries
from nacre.measure.geometry import Geometry, aspecular_pairs
from nacre.measure.texture import Instrument, TextureQuantity, check_texture, read_instrument, texture_values
from nacre.optimise.colour_list import cells_of, read_colours
from nacre.readers.measurement import Measurement
from nacre.readers.text_table import decode
from nacre.recipe.model import show_value


class Data(Protocol):
    """One measurement that a material can simulate."""

    @property
    def kind(self) -> str:
        """`spectrum`, `gonio`, `ellipsometry`, `orders`, `colours` or `joint`."""
        ...

    @property
    def values(self) -> Array:
        """Measured values."""
        ...

    @property
    def wavelengths_nm(self) -> Array:
        """Wavelengths."""
        ...

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return simulated values, shaped as `values`."""
        ...

    def surrogate(self, material: Material) -> Array | None:
        """Return values of a random walk's noise-free surrogate; None without one."""
        ...

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values, scaled so that its rms equals theirs."""
        ...


@dataclass(frozen=True, eq=False)
class Joint:
    """Several measurements of one sample; its values are the flat values of the parts, one after another."""

    parts: tuple[Data, ...]
    kind: str = "joint"

    @property
    def values(self) -> Array:
        """`[value]`."""
        return np.concatenate([part.values.ravel() for part in self.parts])

    @property
    def wavelengths_nm(self) -> Array:
        """Wavelengths of all parts."""
        return np.unique(np.concatenate([part.wavelengths_nm for part in self.parts]))

    @property
    def places(self) -> list[slice]:
        """Position of each part in the values."""
        ends = np.cumsum([0, *(part.values.size for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:])]

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return simulated values `[value]`."""
        return np.concatenate([part.model(material, samples, seed).ravel() for part in self.parts])

    def surrogate(self, material: Material) -> Array | None:
        """Return values of a random walk's noise-free surrogate; None without one."""
        values = [part.surrogate(material) for part in self.parts]
        return (
            None
            if any(each is None for each in values)
            else np.concatenate([np.ravel(each) for each in values if each is not None])
        )

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values: each part relative to its own rms."""
        return np.concatenate([part.noise_scale(weights).ravel() for part in self.parts])


def parts_of(data: Data) -> tuple[Data, ...]:
    """Return the measurements of one or several files."""
    return data.parts if isinstance(data, Joint) else (data,)


def joined(parts: Sequence[Data]) -> Data:
    """Return one measurement as it is, several as a `Joint`.

    Raises:
        NacreError: no measurement.
    """
    if not parts:
        raise NacreError("give at least one measurement")
    return parts[0] if len(parts) == 1 else Joint(tuple(parts))


def checked_range(text: str | None) -> tuple[float, float] | None:
    """Return the wavelengths LOW:HIGH in nm.

    Raises:
        NacreError: it is not two ascending numbers.
    """
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = 1.0, 0.0
    if not 0 < low < high:
        raise NacreError(f'--range-nm "{text}" cannot be read; write it like 400:800')
    return low, high


def name_of(data: Data, path: str | Path) -> str:
    """Return a measurement's file name for tables."""
    return Path(getattr(data, "name", "") or path).name


LIGHT = ("D65", "10deg")
# column of a table of orders -> the side, and weights of s and p
EFFICIENCIES = {
    f"{side}{end}": (side, np.array(weights))
    for side in ("reflected", "transmitted")
    for end, weights in (("_s", (1.0, 0.0)), ("_p", (0.0, 1.0)), ("", (0.5, 0.5)))
}


@dataclass(frozen=True, eq=False)
class ColourData:
    """Measured CIELAB.

    Attributes:
        labels: `[geometry]`, such as "45as15", or names of the recipe's `[[geometry]]`.
        values: `[geometry, 3]`.
        light: illuminant and observer.
        name: file, for reports.
        geometries: geometries for the labels; empty before `resolved`.
    """

    labels: tuple[str, ...]
    values: Array
    light: tuple[str, str] = LIGHT
    name: str = ""
    geometries: tuple[Geometry, ...] = ()
    kind: str = "colours"

    @property
    def wavelengths_nm(self) -> Array:
        """The visible range, over which colours are integrated."""
        return default_wavelengths()

    def resolved(self, material: Material) -> ColourData:
        """Return the data with its geometries.

        Raises:
            RecipeError: a label is neither a geometry nor a name in the recipe.
        """
        named = recipe_geometries(material)
        where = f"{self.name or 'colour'}: geometry"
        return replace(self, geometries=tuple(Geometry.read(label, where, named) for label in self.labels))

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return the material's CIELAB, `[geometry, 3]`."""
        rows = self.geometries or self.resolved(material).geometries
        return geometry_colours(material, rows, *self.light, samples, seed)

    def surrogate(self, material: Material) -> Array | None:
        """Return CIELAB of a random walk's noise-free surrogate; None without one."""
        model = material.model
        if is_direct(model) or any(geometry.kind != "aspecular" for geometry in self.geometries):
            return None
        grid = np.asarray(model.wavelengths_nm)
        radiance = surrogate_radiance(model, *aspecular_pairs(self.geometries), grid, True)
        if radiance is None:
            return None
        xyz = spectrum_to_xyz(np.pi * (radiance[0] + radiance[1]), grid, *self.light)
        return np.asarray(xyz_to_lab(xyz, white_xyz(*self.light)))

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values: equal for L*, a* and b* at all geometries."""
        return np.full(self.values.shape, float(np.sqrt(np.mean(self.values**2))) or 1.0)


@dataclass(frozen=True, eq=False)
class OrdersData:
    """Measured efficiencies of diffraction orders.

    Attributes:
        columns: `[value]`, names of `EFFICIENCIES`.
        cases: `[value, 5]`: wavelength in nm, angle of incidence and azimuth in degrees, m and n.
        values: `[value]`.
        name: file, for reports.
        remarks: columns that are not used.
    """

    columns: tuple[str, ...]
    cases: Array
    values: Array
    name: str = ""
    remarks: tuple[str, ...] = ()
    kind: str = "orders"

    @property
    def wavelengths_nm(self) -> Array:
        """Wavelengths."""
        return np.unique(self.cases[:, 0])

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return a material's efficiencies `[value]`, 0 for an order that does not propagate.

        Raises:
            UnsupportedError: the material has no orders.
        """
        model, lam, angles = material.model, self.wavelengths_nm, np.unique(self.cases[:, 1])
        if not isinstance(model, Diffracting):
            raise UnsupportedError(f"{self.name}: a {model.traits.noun} has no diffraction orders; allowed: a grating")
        efficiencies = np.zeros(len(self.values))
        for azimuth in np.unique(self.cases[:, 2]):
            solved = model.diffraction_orders(np.radians(angles), float(np.radians(azimuth)), lam)
            place = {(int(m), int(n)): k for k, (m, n) in enumerate(solved.numbers)}
            for row in np.flatnonzero(self.cases[:, 2] == azimuth):
                order = place.get((int(self.cases[row, 3]), int(self.cases[row, 4])))
                if order is not None:
                    side, weights = EFFICIENCIES[self.columns[row]]
                    at = np.searchsorted(angles, self.cases[row, 1]), np.searchsorted(lam, self.cases[row, 0]), order
                    efficiencies[row] = np.nan_to_num(getattr(solved, side)[at]) @ weights
        return efficiencies

    def surrogate(self, material: Material) -> Array | None:
        """Return None: orders are free of noise."""
        return None

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values: proportional to them, or equal."""
        rms = float(np.sqrt(np.mean(self.values**2))) or 1.0
        return (
            np.maximum(np.abs(self.values), RELATIVE_FLOOR * rms)
            if weights == "relative"
            else np.full(self.values.shape, rms)
        )

    def curves(self, fitted: Array) -> tuple[tuple[str, Array, Array, Array], ...]:
        """Return for each order, angle and column: label, wavelengths, measured and fitted values."""
        groups: dict[str, list[int]] = {}
        for row, (column, (_, angle, azimuth, m, n)) in enumerate(zip(self.columns, self.cases, strict=True)):
            turned = f", azimuth {azimuth:g}\u00b0" if azimuth else ""
            label = f"{column.replace('_', ' ')} ({m:g}, {n:g}), {angle:g}\u00b0{turned}"
            groups.setdefault(label, []).append(row)
        return tuple((label, self.cases[at, 0], self.values[at], fitted[at]) for label, at in groups.items())


def orders_measurement(path: Path, measurement: Measurement, range_nm: tuple[float, float] | None) -> OrdersData:
    """Return efficiencies of a table as `nacre orders` writes it; the column `azimuth_deg` may be absent.

    Raises:
        NacreError: an unknown column, no efficiency, or one that is impossible.
    """
    data = dict(measurement.data)
    keys = ("wavelength_nm", "angle_deg", "azimuth_deg", "m", "n")
    unknown = [name for name in (*data, *measurement.metadata) if name not in (*keys, *EFFICIENCIES, "table")]
    if unknown:
        raise NacreError(f"{path}: column {unknown[0]} is not known; allowed: {', '.join((*keys, *EFFICIENCIES))}")
    first = data["wavelength_nm"]
    cases = np.stack([data.get(key, np.zeros(len(first))) for key in keys], axis=1)
    used = np.isfinite(cases).all(axis=1)
    if range_nm is not None:
        used &= (first >= range_nm[0]) & (first <= range_nm[1])
    rows = [(name, k) for name in data if name in EFFICIENCIES for k in np.flatnonzero(used & np.isfinite(data[name]))]
    values = np.array([data[name][k] for name, k in rows], dtype=float)
    if not len(values):
        raise NacreError(f"{path}: holds no efficiency of an order; allowed columns: {', '.join(EFFICIENCIES)}")
    wrong = next((k for k, value in enumerate(values) if not MIN_POWER <= value <= MAX_POWER), None)
    if wrong is not None:
        name, row = rows[wrong]
        raise NacreError(f"{path}: {name} = {values[wrong]:g} at {first[row]:g} nm is not possible; allowed: 0 to 1")
    at = cases[[k for _, k in rows]]
    if np.any(at[:, 0] <= 0) or np.any((at[:, 1] < 0) | (at[:, 1] >= 90)):
        raise NacreError(f"{path}: wavelength_nm must be positive and angle_deg in [0, 90)")
    return OrdersData(tuple(name for name, _ in rows), at, values, str(path), measurement.left_out)


def stated_colours(stated: Mapping[str, Sequence[float]]) -> ColourData:
    """Return colours from a table geometry -> L*, a*, b*; D65, 10 degree observer.

    Raises:
        NacreError: a colour is not three finite numbers.
    """
    for label, lab in stated.items():
        if np.shape(lab) != (3,) or not np.isfinite(np.asarray(lab, dtype=float)).all():
            raise NacreError(f'colour at "{label}" = {list(lab)} should hold L*, a*, b*')
    return ColourData(tuple(stated), np.array([list(lab) for lab in stated.values()], dtype=float))


def colour_measurement(path: Path) -> ColourData:
    """Read a colour list whose names are geometries: `geometry, L*, a*, b*`.

    Raises:
        NacreError: a row is not a colour or has no name.
    """
    rows = read_colours(path, 1, LIGHT)
    for number, row in enumerate(rows, start=1):
        if not row.name:
            raise NacreError(f"{path}: colour {number} has no geometry; write 45as15,L*,a*,b* in each row")
    return ColourData(tuple(row.name for row in rows), np.array([row.lab[0] for row in rows]), LIGHT, str(path))


_TEXTURE = re.compile(r"(?:sparkle|intensity|area)_[\d.]+|graininess")
_GEOMETRY = re.compile(r"[\d.]+as[-+\d.]|(?:specular|transmitted|diffuse|hemispherical)\s+[\d.]+$")
MOST_TEXTURE_BYTES = 1 << 14
TEXTURE_NOISE_PERCENT = 5.0  # repeatability of instruments at several places of a panel
LEAST_TEXTURE_RMS = 0.02  # relative residual below which a fit gives texture no more weight
NOT_CALIBRATED = "texture is compared on a relative scale; numbers of an instrument need its calibration (--instrument)"


@dataclass(frozen=True, eq=False)
class TextureData:
    """Measured sparkle and graininess.

    Attributes:
        quantities: `[quantity]`, of one instrument.
        values: `[quantity]`, above 0.
        name: file, for reports.
        remarks: sentences about the data.
    """

    quantities: tuple[TextureQuantity, ...]
    values: Array
    name: str = ""
    remarks: tuple[str, ...] = ()
    kind: str = "texture"
    least_rms: float = LEAST_TEXTURE_RMS

    @property
    def wavelengths_nm(self) -> Array:
        """The visible range, over which luminance is a sum."""
        return default_wavelengths()

    def resolved(self, material: Material) -> TextureData:
        """Return the data itself.

        Raises:
            RecipeError: the material lacks texture.
        """
        check_texture(material, self.name or f'texture "{self.quantities[0]}"')
        return self

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return the material's numbers `[quantity]`."""
        return texture_values(material, self.quantities, seed, "search")[0]

    def surrogate(self, material: Material) -> Array | None:
        """Return the same numbers, which need no random walk."""
        return None if is_direct(material.model) else self.model(material, None, 0)

    def noise_scale(self, weights: str) -> Array:
        """Return the noise, which is relative to each value."""
        return self.values


def stated_texture(stated: Mapping[str, float], instrument: Any = None, name: str = "") -> TextureData:
    """Return texture data from quantity, such as "sparkle_45", -> measured number.

    Args:
        instrument: lamp, camera and calibration, a TOML file or its keys.
        name: file, for messages.

    Raises:
        RecipeError: a quantity is not known, or its number is not finite and above 0.
    """
    tool = instrument if isinstance(instrument, Instrument) else read_instrument(instrument)
    where = name or "texture"
    quantities = tuple(TextureQuantity.named(each, where, tool) for each in stated)
    for label, value in stated.items():
        if not 0.0 < value < np.inf:
            raise RecipeError(f"{where}: {label} = {value:g} is not a measured number; allowed: above 0")
    remarks = () if all(each.is_calibrated for each in quantities) else (NOT_CALIBRATED,)
    return TextureData(quantities, np.array(list(stated.values()), dtype=float), name, remarks)


def _labelled_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return line number and cells of a short text file; no rows of another file."""
    try:
        with plain(path).open("rb") as file:
            return list(cells_of(decode(file.read(MOST_TEXTURE_BYTES))))
    except (OSError, UnicodeDecodeError, csv.Error):
        return []


def is_geometry_list(path: Path) -> bool:
    """Return whether a file without a heading lists geometries with L*, a*, b*: `45as15, 60, 1, 2`."""
    cells = [cells for _, cells in _labelled_rows(path)[:1]]
    return bool(cells) and len(cells[0]) == 4 and _GEOMETRY.match(cells[0][0]) is not None


def texture_measurement(path: Path, instrument: Any = None) -> TextureData | None:
    """Read a table `quantity, value` such as `sparkle_45, 1.2`; None for other files.

    Raises:
        RecipeError: a row is not a quantity and a number above 0, or a quantity occurs twice.
    """
    cells = _labelled_rows(path)
    if len(cells) > 1 and cells[0][1][0].lower() in ("quantity", "name"):
        cells.pop(0)
    if not any(_TEXTURE.fullmatch(row[0]) for _, row in cells):
        return None
    numbers: dict[str, float] = {}
    for number, row in cells:
        where = f"{path}: line {number}"
        if not _TEXTURE.fullmatch(row[0]):
            raise RecipeError(f"{where}: {show_value(row[0])} is not a texture quantity; put colours into another file")
        if row[0] in numbers:
            raise RecipeError(f"{where}: {row[0]} stands twice")
        try:
            (text,) = row[1:]
            numbers[row[0]] = float(text)
        except ValueError:
            line = show_value(", ".join(row))
            raise RecipeError(f"{where}: {line} should be a quantity and a number, such as sparkle_45, 1.2") from None
    return stated_texture(numbers, instrument, str(path))
