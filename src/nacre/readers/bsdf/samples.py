"""Common part of BSDF readers: text, axes, angles, and the `Measurement` of direction pairs.

Directions point away from the surface; azimuth differences of 0 mean retroreflection, 180 degrees the mirror side.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array, angles_deg, from_half_difference
from nacre.core.errors import NacreError
from nacre.core.files import plain, why_unreadable
from nacre.core.memory import check_memory
from nacre.readers.measurement import AmbiguousFileError, Measurement
from nacre.readers.text_table import decode

MAX_BYTES = 1 << 30
MEMORY_FACTOR = 8  # memory per byte of a text file: text, lines, cells
MAX_AXIS = 100_000
UM_RANGE = (0.15, 25.0)  # wavelengths without a unit that can only be micrometres
DEGREES = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")
COLOURS = {"rgb": "bsdf_rgb", "xyz": "bsdf_xyz"}


def read_bytes(path: Path, factor: float = 1.0) -> bytes:
    """Return the content of a regular file within the memory limit.

    Raises:
        NacreError: the file cannot be read or is too large.
    """
    try:
        size = plain(path).stat().st_size
        if size > MAX_BYTES:
            raise NacreError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
        check_memory(factor * float(size), f"{path}: read into memory, it")
        return path.read_bytes()
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        NacreError: the file cannot be read, is too large, or is not text.
    """
    try:
        return decode(read_bytes(path, MEMORY_FACTOR))
    except UnicodeDecodeError:
        raise NacreError(f"{path}: is not text") from None


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
    found = numbers(words, count)
    if np.any(np.diff(found) <= 0) or not np.all(np.isfinite(found)):
        raise ValueError("axis does not ascend")
    return found


def pairs_of(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """Broadcast angles in degrees and stack them: `[pair, 4]`."""
    return np.stack([a.ravel() for a in np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)], axis=-1).astype(float)


def pairs_of_half_angles(theta_half: Array, phi_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
    """Return direction pairs `[pair, 4]` in degrees from Rusinkiewicz' angles in radians, `[pair]` each."""
    wi, wo = from_half_difference(theta_half, theta_diff, phi_diff)
    light, viewer = angles_deg(wi), angles_deg(wo)
    turn = np.degrees(phi_half)
    return np.stack([light[:, 0], (light[:, 1] + turn) % 360.0, viewer[:, 0], (viewer[:, 1] + turn) % 360.0], axis=-1)


def unsigned(theta: Array, phi: Array) -> tuple[Array, Array]:
    """Return polar angles >= 0: a negative one turns its azimuth by 180 degrees; azimuths lie in [0, 360)."""
    return np.abs(theta), np.where(theta < 0, phi + 180.0, phi) % 360.0


def wavelengths_in_nm(path: Path, values: Array, unit: str | None) -> tuple[Array, tuple[str, ...]]:
    """Convert wavelengths to nm; without a unit, the numbers must allow only one reading.

    Returns:
        wavelengths, and remarks on assumptions.

    Raises:
        NacreError: impossible wavelengths.
    """
    factors = {"nm": 1.0, "um": 1e3, "µm": 1e3, "μm": 1e3, "m": 1e9, "a": 0.1, "å": 0.1, "angstrom": 0.1}
    if np.any(values <= 0) or not np.all(np.isfinite(values)):
        raise NacreError(f"{path}: wavelength = {np.min(values):g} is not above 0")
    if unit is not None and unit.lower() in factors:
        return values * factors[unit.lower()], ()
    if UM_RANGE[0] <= values.min() and values.max() <= UM_RANGE[1]:
        return np.round(values * 1e3, 6), ("wavelengths have no unit and are below 25; they were read in um",)
    if values.min() < UM_RANGE[1]:
        raise NacreError(
            f"{path}: wavelengths from {values.min():g} to {values.max():g} have no unit; neither nm nor um covers them"
        )
    return values, ()


def angles_in_degrees(path: Path, angles: Array, unit: str | None) -> tuple[Array, tuple[str, ...]]:
    """Convert angles `[row, column]` to degrees.

    Args:
        unit: "deg" or "rad"; None if the file has none.

    Raises:
        AmbiguousFileError: no unit, and all numbers fit radians.
    """
    if unit == "rad":
        return np.degrees(angles), ()
    if unit == "deg":
        return angles, ()
    thetas, widest = np.abs(angles[:, [0, 2]]).max(), np.abs(angles[:, [1, 3]]).max()
    if 0.0 < thetas <= np.pi / 2 * (1 + 1e-3) and widest <= 2 * np.pi * (1 + 1e-3):
        raise AmbiguousFileError(
            f"{path}: no polar angle is above {thetas:.4g} and no azimuth above {widest:.4g}: these are radians, or "
            "a narrow scan in degrees; state it: --unit rad or --unit deg",
            "unit",
            ("deg", "rad"),
        )
    return angles, ()


def measurement(
    path: Path,
    format_id: str,
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
    return Measurement(
        path, format_id, "bsdf", data, name, {"scatter": scatter, "pairs": len(angles)} | dict(metadata or {}),
        (*assumed, *_remarks(values)[0]), (*left_out, *_remarks(values)[1]),
    )  # fmt: skip


def _remarks(values: Array) -> tuple[list[str], list[str]]:
    missing, negative = int(np.sum(~np.isfinite(values))), int(np.sum(values < 0))
    kept = [f"{negative} of {values.size} values are below 0 and are kept"] if negative else []
    return kept, [f"{missing} of {values.size} values are missing"] if missing else []
