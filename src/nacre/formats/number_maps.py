"""Parameter maps over a surface as fabrication files: grey images, level masks, tables.

A process curve converts values to machine settings (anodising voltage, dose, time).
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, check_writable, write_text
from nacre.formats.calibration import LARGEST_GREY, is_monotonic, read_curve
from nacre.formats.height_fields import write_png16, write_tiff16
from nacre.formats.layouts import MAX_LEVELS, write_levels

DEFAULT_PIXEL_UM = 100.0
FORMATS = ("png16", "tiff16", "npy", "csv", "gds", "oas")
SUFFIXES = {"png16": ".png", "tiff16": ".tif", "npy": ".npy", "csv": ".csv", "gds": ".gds", "oas": ".oas"}
DEFAULT_LEVELS = 16
# units in a heading that are not lengths
NO_LENGTHS = ("v", "volt", "volts", "a", "s", "min", "kg", "g", "mg", "deg", "percent", "%", "ev", "roughness")
SAME_LEVEL = 2.0 / LARGEST_GREY  # rounding of a level in a 16-bit map, relative to the range
MAX_ASPECT_ERROR = 0.01  # relative difference of the sides of a pixel


@dataclass(frozen=True, eq=False)
class NumberMap:
    """A parameter over the surface.

    Attributes:
        path: in the recipe.
        values: `[row, column]`, first row at the top, from the light's side; lengths in nm.
        low, high: values for black and white.
        unit: "nm" for lengths, else "".
    """

    path: str
    values: Array
    low: float
    high: float
    unit: str

    @property
    def slug(self) -> str:
        """The path as part of a file name."""
        return re.sub(r"[^A-Za-z0-9_]+", "-", self.path).strip("-")


@dataclass(frozen=True, eq=False)
class ProcessCurve:
    """Process settings over values, linear between the points.

    Attributes:
        settings: ascending.
        values: strictly monotonic; lengths in nm.
        name: file name.
        words: headings of the two columns.
    """

    settings: Array
    values: Array
    name: str
    words: tuple[str, str]

    def settings_of(self, wanted: NumberMap) -> Array:
        """Return the settings for a map.

        Raises:
            NacreError: the curve does not cover the values.
        """
        given = re.split(r"[_(\[\s]+", self.words[1].rstrip(")] ").lower())[-1]
        if wanted.unit == "nm" and given in NO_LENGTHS:
            raise NacreError(f'{self.name}: "{self.words[1]}" is no length; {wanted.path} is one, in nm, um or mm')
        low, high = float(self.values.min()), float(self.values.max())
        slack = SAME_LEVEL * (wanted.high - wanted.low)
        least, most = float(wanted.values.min()), float(wanted.values.max())
        if least < low - slack or most > high + slack:
            unit = f" {wanted.unit}" if wanted.unit else ""
            raise NacreError(
                f"{self.name}: covers {low:g} to {high:g}{unit}; {wanted.path} needs {least:g} to {most:g}{unit}: "
                "measure more points, or design within what the process makes"
            )
        order = np.argsort(self.values)
        return np.asarray(np.interp(wanted.values, self.values[order], self.settings[order]))


def read_process(path: str | Path) -> ProcessCurve:
    """Read a two-column CSV with settings and values; lengths in nm.

    Headings may include a length unit (`thickness_um`, `Oxide (nm)`); if only the first is a length, the columns are
    swapped. Lines that start with # are ignored.

    Raises:
        NacreError: it cannot be read, has fewer than two points, or is not monotonic.
    """
    path = Path(path)
    table, words = read_curve(path, "process curve", "nm")
    if not np.isfinite(table).all():
        raise NacreError(f"{path}: all numbers must be finite")
    if not is_monotonic(table):
        raise NacreError(f"{path}: the process curve is not monotonic; each value needs one setting")
    return ProcessCurve(table[:, 0], table[:, 1], str(path), words or ("setting", "value"))


def write_number_maps(
    maps: Sequence[NumberMap],
    to: str,
    path: Path,
    source: str,
    *,
    size_mm: tuple[float, float] | None = None,
    calibration: str | Path | Mapping[str, str | Path] | None = None,
    levels: int | None = None,
) -> tuple[Path, ...]:
    """Write each map, and a JSON file with its scale and orientation.

    Args:
        maps: file names of several maps contain the parameter's path.
        to: a name in `FORMATS`.
        path: output file.
        source: recipe name.
        size_mm: width and height; default: 0.1 mm per pixel.
        calibration: a CSV of settings and values; for several maps a mapping from path to file.
        levels: levels of a mask; default: those of the map, or 16.

    Raises:
        UnsupportedError: unsuitable suffix, size or levels.
        NacreError: unsuitable curve, or a file cannot be written.
    """
    if path.suffix.lower() != SUFFIXES[to]:
        raise UnsupportedError(f"{path}: --to {to} needs a name that ends in {SUFFIXES[to]}")
    if levels is not None and to not in ("gds", "oas"):
        raise UnsupportedError(f"--to {to} takes no --levels here: only the masks of gds and oas have them")
    curves = _curves(maps, calibration)
    prepared = []
    for one in maps:
        place = path if len(maps) == 1 else path.with_name(f"{path.stem}-{one.slug}{path.suffix}")
        check_writable(place)
        curve = curves.get(one.path)
        settings = None if curve is None else curve.settings_of(one)
        prepared.append((one, place, curve, settings, _pitch_um(one, size_mm)))
    written: list[Path] = []
    for one, place, curve, settings, pitch_um in prepared:
        rows, columns = one.values.shape
        facts: dict[str, Any] = {
            "format": to, "source": source, "nacre": __version__, "path": one.path, "unit": one.unit or None,
            "pixels": [rows, columns], "pixel_um": pitch_um,
            "seen": "from the light's side; " + ("x to the right, y upward" if to in ("gds", "oas") else
                                                 "the first row on top"),
        }  # fmt: skip
        if curve is not None:
            facts |= {
                "calibration": Path(curve.name).name,
                "setting": curve.words[0],
                "curve": np.stack([curve.settings, curve.values], axis=-1).tolist(),
            }
        _write(one, to, place, settings, pitch_um, levels, facts)
        beside = place.with_name(place.name + ".json")
        write_text(beside, json.dumps(facts, indent=2) + "\n")
        written += [place, beside]
    return tuple(written)


def _curves(
    maps: Sequence[NumberMap], calibration: str | Path | Mapping[str, str | Path] | None
) -> dict[str, ProcessCurve]:
    """Return process curves by parameter path."""
    if calibration is None:
        return {}
    paths = [one.path for one in maps]
    if isinstance(calibration, Mapping):
        unknown = [name for name in calibration if name not in paths]
        if unknown:
            raise NacreError(f'--calibration: "{unknown[0]}" does not vary by an image; that do: {", ".join(paths)}')
        return {name: read_process(file) for name, file in calibration.items()}
    if len(maps) > 1:
        raise NacreError(
            f"--calibration {calibration}: {len(maps)} numbers vary; say which it is of, such as "
            f"--calibration {paths[0]}={calibration}"
        )
    return {paths[0]: read_process(calibration)}


def _pitch_um(one: NumberMap, size_mm: tuple[float, float] | None) -> float:
    if size_mm is None:
        return DEFAULT_PIXEL_UM
    rows, columns = one.values.shape
    wide, high = 1e3 * size_mm[0] / columns, 1e3 * size_mm[1] / rows
    if abs(wide - high) > MAX_ASPECT_ERROR * wide:
        raise UnsupportedError(
            f"--size-mm {size_mm[0]:g}x{size_mm[1]:g} stretches the picture of {columns} x {rows} pixels; "
            f"{size_mm[0]:g}x{size_mm[0] * rows / columns:.4g} does not"
        )
    return wide


def _write(
    one: NumberMap, to: str, path: Path, settings: Array | None, pitch_um: float, levels: int | None,
    facts: dict[str, Any],
) -> None:  # fmt: skip
    values = one.values if settings is None else settings
    if to in ("gds", "oas"):
        _write_mask(one, path, settings, pitch_um, levels, facts)
    elif to == "npy":
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.save(stream, values, allow_pickle=False)
    elif to == "csv":
        with atomic_path(path) as temporary:
            np.savetxt(temporary, values, delimiter=",", fmt="%.6g", header=_heading(one, facts))
    else:
        low, high = (one.low, one.high) if settings is None else (float(settings.min()), float(settings.max()))
        unit = (values - low) / (high - low) if high > low else np.zeros_like(values)
        grey = np.round(LARGEST_GREY * np.clip(unit, 0.0, 1.0)).astype(np.uint16)
        facts |= {"black": low, "white": high, "is": f"black + (white - black) * grey / {LARGEST_GREY}"}
        (write_png16 if to == "png16" else write_tiff16)(path, grey, facts, pitch_um)


def _heading(one: NumberMap, facts: dict[str, Any]) -> str:
    what = facts["setting"] if "setting" in facts else f"{one.path}{f' in {one.unit}' if one.unit else ''}"
    return f"{what}; a line is a row of the picture, the first on top"


def _write_mask(
    one: NumberMap, path: Path, settings: Array | None, pitch_um: float, levels: int | None, facts: dict[str, Any]
) -> None:
    """Write a mask whose layer k contains the pixels with level k; few distinct values are levels."""
    steps = _distinct(one)
    if levels is not None or len(steps) > MAX_LEVELS:
        steps = np.linspace(one.low, one.high, levels or DEFAULT_LEVELS)
    index = np.abs(one.values[..., None] - steps).argmin(axis=-1).astype(np.int64)
    write_levels(path, index[::-1].T, pitch_um, notes=f"nacre {__version__}: {one.path}, {len(steps)} levels")
    facts |= {
        "level_values": steps.tolist(),
        "largest_rounding": float(np.abs(one.values - steps[index]).max()),
        "layer": "layer k holds the pixels whose value is level_values[k]",
    }
    if settings is not None:
        made = [float(np.mean(settings[index == k])) if (index == k).any() else None for k in range(len(steps))]
        facts["level_settings"] = made


def _distinct(one: NumberMap) -> Array:
    """Return a map's distinct values, merging those that differ only by rounding."""
    values = np.unique(one.values)
    if len(values) < 2:
        return values
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values) > SAME_LEVEL * (one.high - one.low)) + 1])
    return np.array([part.mean() for part in np.split(values, starts[1:])])
