"""Tables of goniometers as text: one row per direction pair, or one row per pair and wavelength.

Accepted forms: angles signed or with azimuths; an azimuth difference; wavelengths in a column or across; BSDF in 1/sr
or reflectance factors (pi times the BSDF); headings after a `#`. In-plane scans without azimuths take the side of the
mirror direction from the data.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array, angles_deg, from_half_difference
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import LIKELY, FileHead
from nacre.readers.text_table import MISSING, load_text, number, rows
from nacre.readers.units import VOCABULARY, spectral_unit, to_nm

NAMES = {name: tuple(words.split()) for name, words in VOCABULARY["goniometer"].items()}
UNITS = {"deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "rad": "rad", "radian": "rad", "radians": "rad"}
WAVE_UNITS = ("nm", "um", "µm", "μm")
LONGEST = 200  # characters of a heading
_BRACKET = re.compile(r"[\[(]([^\])]*)[\])]")
_WAVE = re.compile(r"(?:[a-z_]*?[ _]?)?(\d+(?:\.\d+)?)\s*(nm|um|µm|μm)?")
_COLOUR = re.compile(r"bsdf(rgb|xyz)[012]|[rgb]|[xyz]")
QUANTITIES = ("bsdf", "reflectance_factor")


@dataclass
class Heading:
    """Meaning of the columns.

    Attributes:
        place: column by canonical name.
        colour: columns of the channels, by colour space ("rgb", "xyz").
        waves: columns that hold a value at a wavelength, with the wavelengths.
        angle_unit, wave_unit: units in the headings.
        unknown: headings that are not recognised.
        is_btdf: the heading of the values names transmitted scatter.
    """

    place: dict[str, int] = field(default_factory=dict)
    colour: dict[str, list[int]] = field(default_factory=dict)
    waves: dict[int, float] = field(default_factory=dict)
    angle_unit: str | None = None
    wave_unit: str | None = None
    unknown: list[str] = field(default_factory=list)
    is_btdf: bool = False


def sniff_gonio(head: FileHead) -> float:
    """Recognise headings with a polar angle of both directions."""
    for cells in _heading_rows("\n".join(head.lines[:60])):
        known = heading(cells).place
        if "theta_i" in known and "theta_o" in known:
            return 0.9
        names = {_name_and_unit(cell)[0] for cell in cells}
        if names & {"brdf", "bsdf", "btdf"} and any("angle" in name or "theta" in name for name in names):
            return LIKELY + 0.1  # `read` asks for the angles that are missing
    return 0.0


def _heading_rows(text: str) -> list[list[str]]:
    """Return the cells of the lines before the first row of numbers, remark signs removed; nearest first."""
    heads: list[list[str]] = []
    for line in text.splitlines():
        if re.match(r"[-+.]?\d", line.strip()):
            break
        plain = line.strip().lstrip("#%! ").strip()
        mark = next((m for m in (";", "\t", ",") if m in plain), None)
        if plain:
            heads.append([cell.strip().strip('"') for cell in plain.split(mark)])
    return heads[::-1]


def heading(cells: Sequence[str]) -> Heading:
    """Return the meaning of a row of headings.

    Raises:
        NacreError: two columns have the same meaning.
    """
    known = Heading()
    for column, cell in enumerate(cells):
        wide = _WAVE.fullmatch(cell.strip().lower())
        if wide and (wide[2] or float(wide[1]) >= 200.0):
            known.waves[column] = float(wide[1])
            known.wave_unit = wide[2] or known.wave_unit
            continue
        name, unit = _name_and_unit(cell)
        letters = "".join(c for c in cell.lower() if c.isalnum())
        space = _COLOUR.fullmatch(letters)
        if space:
            known.colour.setdefault(space[1] or ("rgb" if letters in "rgb" else "xyz"), []).append(column)
            continue
        meaning = next((key for key, words in NAMES.items() if name in words), None)
        if meaning is None:
            if name:
                known.unknown.append(cell.strip())
            continue
        if meaning in known.place:
            raise NacreError(f'columns {known.place[meaning] + 1} and {column + 1} are both "{meaning}"')
        known.place[meaning] = column
        known.is_btdf |= "btdf" in name
        if unit in UNITS and meaning != "wavelength":
            known.angle_unit = UNITS[unit]
        if meaning == "wavelength" and unit in WAVE_UNITS:
            known.wave_unit = unit
    return known


def _name_and_unit(cell: str) -> tuple[str, str]:
    """Return the letters of a heading without its unit, and the unit."""
    text = cell.strip().lower()[:LONGEST]
    bracket = _BRACKET.search(text)
    unit = bracket[1].strip() if bracket else ""
    text = _BRACKET.sub("", text)
    words = [w for w in re.split(r"[\s_./-]+", text) if w]
    while len(words) > 1 and (words[-1] in UNITS or words[-1] in WAVE_UNITS or words[-1] in ("sr", "1", "per")):
        unit = unit or words[-1]
        words.pop()
    return "".join(c for c in "".join(words) if c.isalnum()), unit


def read_gonio(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a table; missing cells become NaN, negative values are kept.

    Raises:
        NacreError: headings that are not recognised, missing columns, or impossible numbers.
        AmbiguousFileError: a unit or the quantity is not stated.
    """
    known, table = _table(path, options)
    if "theta_i" not in known.place or "theta_o" not in known.place:
        raise NacreError(
            f"{path}: has no column for the polar angle of both directions; name them theta_i, theta_o, "
            "and give a constant one its own column"
        )
    angles, assumed = _angles(path, known, table, options)
    for space, columns in known.colour.items():
        if len(columns) != 3:
            raise NacreError(f"{path}: has {len(columns)} of the three channels {space.upper()}")
        channels = table[:, columns]
        if options.quantity == "reflectance_factor":
            channels = channels / np.pi
            assumed.append("reflectance factors were divided by pi")
        return [measurement(path, angles, None, channels, colour=space, assumed=assumed)]
    values, waves, notes = _values(path, known, table, options)
    assumed += notes
    if known.waves or waves is None:
        return [measurement(path, angles, waves, values, {"form": "wide"} | _side(known), assumed=assumed)]
    return [_long(path, known, table, angles, waves, values, assumed)]


def _side(known: Heading) -> dict[str, object]:
    return {"scatter": "btdf"} if known.is_btdf else {}


def _long(
    path: Path, known: Heading, table: Array, angles: Array, waves: Array, values: Array, assumed: list[str]
) -> Measurement:
    """Return one row per direction pair and wavelength, in the file's order."""
    facts = {"pairs": len(np.unique(angles, axis=0))} | _side(known)
    made = measurement(path, angles, None, values, facts, assumed=assumed)
    data = dict(made.data)
    value = data.pop("bsdf")
    data |= {"wavelength_nm": waves, "bsdf": value}
    if "error" in known.place:
        data["bsdf_error"] = table[:, known.place["error"]]
    return replace(made, data=data)


def _table(path: Path, options: ReadOptions) -> tuple[Heading, Array]:
    """Return the headings' meaning and the numbers `[row, column]`."""
    text = load_text(path)
    heads = _heading_rows(text)
    if not heads:
        raise NacreError(f"{path}: has no headings; a goniometer table names theta_i, theta_o, ...")
    cells = max(
        heads[:10], key=lambda row: len(heading(row).place) + bool(heading(row).waves) + bool(heading(row).colour)
    )
    try:
        known = heading(cells)
    except NacreError as error:
        raise NacreError(f"{path}: {error}") from None
    unknown = [name for name in known.unknown if name not in options.ignore]
    if unknown:
        raise NacreError(
            f"{path}: columns {', '.join(unknown)} are not recognised; name them as in "
            f"theta_i, phi_i, theta_o, phi_o, wavelength, value, or ignore them (--ignore)"
        )
    table = []
    for line, row in rows(re.sub(r"#N/A", "n/a", text)):
        if row and not re.match(r"[-+.]?\d", row[0].strip()) and row[0].strip().lower() not in MISSING:
            continue  # a heading
        row += [""] * (len(cells) - len(row))
        if len(row) != len(cells):
            raise NacreError(f"{path}: line {line} has {len(row)} cells, the headings are {len(cells)}")
        table.append([_number(path, line, cell) for cell in row])
    if not table:
        raise NacreError(f"{path}: holds no rows of numbers")
    return known, np.array(table)


def _number(path: Path, line: int, cell: str) -> float:
    value = number(cell)
    if value is None or np.isinf(value):
        raise NacreError(f'{path}: line {line}: "{cell.strip()[:40]}" is not a finite number')
    return value


def _angles(path: Path, known: Heading, table: Array, options: ReadOptions) -> tuple[Array, list[str]]:
    """Return angles `[row, 4]` in degrees without signs, and assumptions."""
    place, zero = known.place, np.zeros(len(table))
    columns = [table[:, place[name]] if name in place else zero for name in ("theta_i", "phi_i", "theta_o", "phi_o")]
    if "dphi" in place:
        columns[3] = columns[1] + table[:, place["dphi"]]
    raw = np.stack(columns, axis=-1)
    if not np.all(np.isfinite(raw)):
        raise NacreError(f"{path}: an angle is missing in {int(np.sum(~np.isfinite(raw).all(axis=1)))} rows")
    unit = known.angle_unit or (options.unit if options.unit in ("deg", "rad") else None)
    angles, assumed = angles_in_degrees(path, raw, unit), []
    for name, column in (("theta_i", 0), ("theta_o", 2)):
        bad = np.abs(angles[:, column]) > 180
        if np.any(bad):
            raise NacreError(f"{path}: {name} = {angles[bad][0, column]:g} is not within 180 degrees")
    if "dphi" in place:
        assumed.append("a relative azimuth of 0 is taken as the side of the light")
    elif "phi_o" not in place:
        mirror = _mirror_sign(known, table, angles)
        angles[:, 3] = np.where(angles[:, 2] * mirror >= 0, 180.0, 0.0)
        angles[:, 2] = np.abs(angles[:, 2])
        side = "positive" if mirror > 0 else "negative"
        assumed.append(f"no azimuths: a scan in the plane of incidence; {side} angles are the mirror side")
    return unsigned(angles), assumed


def _mirror_sign(known: Heading, table: Array, angles: Array) -> float:
    """Return the sign of theta_o on the mirror side: the side with the larger values near |theta_o| = theta_i."""
    columns = list(known.waves) or [known.place[name] for name in ("bsdf", "factor") if name in known.place]
    if not columns or not np.any(angles[:, 2] < 0):
        return 1.0
    value = np.nan_to_num(table[:, columns]).mean(axis=1)
    near = np.abs(np.abs(angles[:, 2]) - np.abs(angles[:, 0])) <= 6.0
    away = near & (np.abs(angles[:, 0]) > 12.0)
    sums = [float(np.sum(value[away & (np.sign(angles[:, 2]) == sign)])) for sign in (1.0, -1.0)]
    return 1.0 if sums[0] >= sums[1] else -1.0


def _values(path: Path, known: Heading, table: Array, options: ReadOptions) -> tuple[Array, Array | None, list[str]]:
    """Return the BSDF `[row, wavelength]` in 1/sr, the wavelengths (across) or those of the rows, and assumptions."""
    assumed: list[str] = []
    waves: Array | None = None
    if known.waves:
        columns, quantity = list(known.waves), options.quantity
        if quantity not in QUANTITIES:
            raise AmbiguousFileError(
                f"{path}: the columns of wavelengths hold the BRDF in 1/sr or reflectance factors (pi times the BRDF); "
                "state it: --quantity bsdf or --quantity reflectance_factor",
                "quantity",
                QUANTITIES,
            )
        values = table[:, columns]
        waves, notes = wavelengths_in_nm(path, np.array(list(known.waves.values())), known.wave_unit)
        order = np.argsort(waves)
        waves, values = waves[order], values[:, order]
    else:
        quantity = "reflectance_factor" if "factor" in known.place else options.quantity or "bsdf"
        column = known.place.get("bsdf", known.place.get("factor"))
        if column is None:
            raise NacreError(f"{path}: has no column of values (value, bsdf, brf)")
        values, notes = table[:, [column]], ()
        if "wavelength" in known.place:
            unit = known.wave_unit or (options.unit if options.unit in WAVE_UNITS else None)
            waves, notes = wavelengths_in_nm(path, table[:, known.place["wavelength"]], unit)
    assumed += notes
    if quantity == "reflectance_factor":
        values = values / np.pi
        assumed.append("reflectance factors were divided by pi")
    return values, waves, assumed


# Common part of BSDF readers: axes, angles, and the `Measurement` of direction pairs.
#
# Directions point away from the surface; azimuth differences of 0 mean retroreflection, 180 degrees the mirror side.

MAX_AXIS = 100_000
UM_RANGE = (0.15, 25.0)  # wavelengths without a unit that can only be micrometres
DEGREES = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")
COLOURS = {"rgb": "bsdf_rgb", "xyz": "bsdf_xyz"}


def numbers(words: Iterator[str], count: int) -> Array:
    """Return the next `count` words as numbers.

    Raises:
        ValueError: the text ends early, or a word is not a number.
    """
    try:
        return np.array([float(next(words)) for _ in range(count)])
    except StopIteration:
        raise ValueError("ends early") from None


def axis(words: Iterator[str], count: int) -> Array:
    """Return an ascending axis of `count` numbers.

    Raises:
        ValueError: the count is impossible, or the axis does not ascend.
    """
    if not 1 <= count <= MAX_AXIS:
        raise ValueError(f"{count} nodes")
    nodes = numbers(words, count)
    if np.any(np.diff(nodes) <= 0) or not np.all(np.isfinite(nodes)):
        raise ValueError("axis does not ascend")
    return nodes


def pairs_of(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """Broadcast angles in degrees and stack them: `[pair, 4]`."""
    return np.stack([a.ravel() for a in np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)], axis=-1).astype(float)


def pairs_of_half_angles(theta_half: Array, phi_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
    """Return direction pairs `[pair, 4]` in degrees from Rusinkiewicz' angles in radians, `[pair]` each."""
    wi, wo = from_half_difference(theta_half, theta_diff, phi_diff)
    light, viewer = angles_deg(wi), angles_deg(wo)
    turn = np.degrees(phi_half)
    return np.stack([light[:, 0], (light[:, 1] + turn) % 360.0, viewer[:, 0], (viewer[:, 1] + turn) % 360.0], axis=-1)


def unsigned(angles: Array) -> Array:
    """Return pairs `[pair, 4]` with polar angles >= 0, whose sign turns the azimuth, and azimuths in [0, 360)."""
    theta, phi = angles[:, 0::2], angles[:, 1::2]
    return np.stack([np.abs(theta), np.where(theta < 0, phi + 180.0, phi) % 360.0], axis=-1).reshape(-1, 4)


def wavelengths_in_nm(path: Path, values: Array, unit: str | None) -> tuple[Array, tuple[str, ...]]:
    """Convert wavelengths to nm; without a unit, the numbers must allow only one reading.

    Returns:
        wavelengths, and remarks on assumptions.

    Raises:
        NacreError: impossible wavelengths.
    """
    if np.any(values <= 0) or not np.all(np.isfinite(values)):
        raise NacreError(f"{path}: wavelength = {np.min(values):g} is not above 0")
    canonical = spectral_unit(unit or "")
    if canonical is not None:
        return to_nm(values, canonical), ()
    if UM_RANGE[0] <= values.min() and values.max() <= UM_RANGE[1]:
        return np.round(values * 1e3, 6), ("wavelengths have no unit and are below 25; they were read in um",)
    if values.min() < UM_RANGE[1]:
        raise NacreError(
            f"{path}: wavelengths from {values.min():g} to {values.max():g} have no unit; neither nm nor um covers them"
        )
    return values, ()


def angles_in_degrees(path: Path, angles: Array, unit: str | None) -> Array:
    """Convert angles `[row, column]` to degrees.

    Args:
        unit: "deg" or "rad"; None if the file has none.

    Raises:
        AmbiguousFileError: no unit, and all numbers fit radians.
    """
    if unit is not None:
        return np.degrees(angles) if unit == "rad" else angles
    thetas, widest = np.abs(angles[:, [0, 2]]).max(), np.abs(angles[:, [1, 3]]).max()
    if 0.0 < thetas <= np.pi / 2 * (1 + 1e-3) and widest <= 2 * np.pi * (1 + 1e-3):
        raise AmbiguousFileError(
            f"{path}: no polar angle is above {thetas:.4g} and no azimuth above {widest:.4g}: these are radians, or "
            "a narrow scan in degrees; state it: --unit rad or --unit deg",
            "unit",
            ("deg", "rad"),
        )
    return angles


def measurement(
    path: Path,
    angles: Array,
    wavelengths_nm: Array | None,
    values: Array,
    metadata: Mapping[str, Any] | None = None,
    *,
    name: str = "",
    colour: str | None = None,
    assumed: Sequence[str] = (),
    left_out: Sequence[str] = (),
) -> Measurement:
    """Return the measurement of direction pairs as a table, one row per pair and wavelength.

    Args:
        angles: `[pair, 4]` in degrees.
        wavelengths_nm: `[wavelength]`, or None.
        values: `[pair, wavelength or channel]`, 1/sr.
        colour: "rgb" or "xyz" if the channels are colours.
    """
    scatter = str((metadata or {}).get("scatter", "brdf"))
    if colour is not None:
        data = {name_: angles[:, i] for i, name_ in enumerate(DEGREES)} | {COLOURS[colour]: values}
    else:
        waves = values.shape[1]
        data = {name_: np.repeat(angles[:, i], waves) for i, name_ in enumerate(DEGREES)}
        if wavelengths_nm is not None:
            data["wavelength_nm"] = np.tile(wavelengths_nm, len(angles))
        data["bsdf"] = values.reshape(-1)
    missing, negative = int(np.sum(~np.isfinite(values))), int(np.sum(values < 0))
    if negative:
        assumed = [*assumed, f"{negative} of {values.size} values are below 0 and are kept"]
    if missing:
        left_out = [*left_out, f"{missing} of {values.size} values are missing"]
    facts = {"scatter": scatter, "pairs": len(angles)} | dict(metadata or {})
    return Measurement(path, "bsdf", data, name, facts, tuple(assumed), tuple(left_out))
