"""Common parts of height map readers: length units, checks, channels, and the returned measurement."""

import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.machine import check_memory
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions, contradiction
from nacre.readers.registry import open_file, recognise

LENGTHS_UM = {
    "m": 1e6, "cm": 1e4, "mm": 1e3, "um": 1.0, "nm": 1e-3, "pm": 1e-6, "fm": 1e-9, "km": 1e9,
    "A": 1e-4, "Å": 1e-4, "angstrom": 1e-4, "angstroms": 1e-4, "ang": 1e-4, "micron": 1.0, "microns": 1.0, "µ": 1.0,
    "мкм": 1.0, "нм": 1e-3, "мм": 1e3, "м": 1e6, "in": 25400.0, "inch": 25400.0,
    "nanometer": 1e-3, "nanometers": 1e-3, "micrometer": 1.0, "micrometers": 1.0,
    "millimeter": 1e3, "millimeters": 1e3, "meter": 1e6, "meters": 1e6, "metre": 1e6, "metres": 1e6,
}  # fmt: skip
UNIT_CHOICES = ("nm", "um", "mm", "m")
MAX_SIDE = 65536
BYTES_PER_POINT = 16
HIGHEST_UM = 1e9
SQUARE = 0.01  # relative difference of the pitches that is stated
BAD = re.compile(r"\b(?:BAD|NA|N/A|null|void)\b|(?<!\S)-{2,}(?!\S)")


def length_um(unit: str) -> float | None:
    """Return a length unit in um, or None if it is not a length; `~m` and both micro signs mean um."""
    text = unit.strip().strip("[]()").strip().replace("μ", "u").replace("µ", "u").replace("~", "u")
    text = "um" if text in ("u", "�m") else text
    return LENGTHS_UM.get(text, LENGTHS_UM.get(text.lower()))


def quantity_um(text: str) -> float:
    """Return a length such as `12.5 nm` or `1,5 um` in um.

    Raises:
        ValueError: not a number with a unit of length.
    """
    match = re.match(r"\s*([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*(\S+)", text)
    factor = length_um(match[2]) if match else None
    if match is None or factor is None:
        raise ValueError(f'"{text.strip()[:30]}" is not a length')
    return float(match[1].replace(",", ".")) * factor


def array(data: bytes, dtype: str, shape: tuple[int, int], offset: int = 0) -> NDArray[Any]:
    """Return `shape` numbers of a binary block.

    Raises:
        ValueError: the block is shorter, or the size is not plausible.
    """
    check_shape(shape)
    need, have = shape[0] * shape[1] * np.dtype(dtype).itemsize, len(data) - offset
    if offset < 0 or have < need:
        raise ValueError(f"{shape[0]} x {shape[1]} heights need {need} bytes, and {max(have, 0)} follow")
    return np.frombuffer(data, dtype, shape[0] * shape[1], offset).reshape(shape)


def matrix(rows: Sequence[str], path: Path) -> Array:
    """Return rows of text as numbers `[row, column]`.

    Raises:
        NacreError: empty, or rows of different lengths.
    """
    columns = len(numbers(rows[0] + "\n" if rows else "", path))
    values = numbers("\n".join(rows) + "\n", path)
    if not columns or values.size != columns * len(rows):
        raise NacreError(f"{path}: its rows hold different numbers of heights")
    return values.reshape(len(rows), columns)


def shaped(values: Array, shape: tuple[int, int]) -> Array:
    """Return numbers as `shape`, which the head of a file states.

    Raises:
        ValueError: the count does not match.
    """
    check_shape(shape)
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"its head states {shape[0]} x {shape[1]} heights, and {values.size} follow")
    return values.reshape(shape)


def check_shape(shape: tuple[int, int]) -> None:
    """Refuse sizes that no instrument writes.

    Raises:
        ValueError: empty, or more than 65536 a side.
    """
    if not (0 < shape[0] <= MAX_SIDE and 0 < shape[1] <= MAX_SIDE):
        raise ValueError(f"a map of {shape[0]} x {shape[1]} points")
    check_memory(BYTES_PER_POINT * float(shape[0]) * shape[1], f"a map of {shape[0]} x {shape[1]} points")


def numbers(text: str, path: Path) -> Array:
    """Return all numbers of a text with blanks, commas or semicolons between them; BAD, NaN and --- are holes.

    Raises:
        NacreError: there is text between the numbers.
    """
    has_words = any(word in text for word in ("BAD", "NA", "N/A", "null", "void", "--"))
    words = BAD.sub("nan", text) if has_words else text
    sample = words[:20000].replace(";", " ").split()
    has_decimal_commas = "," in words and not any("." in cell for cell in sample)
    # 1,5 2,5 has as many commas as cells; 1,2,3 has more
    if has_decimal_commas and len(sample) > 1 and all(cell.count(",") <= 1 for cell in sample):
        words = words.replace(",", ".")
    words = words.replace(",", " ").replace(";", " ")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(words, dtype=float, sep=" ")
        except (DeprecationWarning, ValueError):
            pass
    try:
        return np.array(words.split(), dtype=float)
    except ValueError as error:
        raise NacreError(f"{path}: {' '.join(str(error).split())[:80]} in the matrix of heights") from None


def key_values(lines: Iterable[str], mark: str, *, is_last: bool = False, is_lower: bool = False) -> dict[str, str]:
    """Return the values of lines `key mark value`; of a repeated key the first one, or the last.

    Args:
        is_lower: whether keys are returned in lower case.
    """
    pairs = [line.partition(mark) for line in lines if mark in line]
    return {
        (name.lower() if is_lower else name).strip(): value.strip()
        for name, _, value in (pairs if is_last else pairs[::-1])
    }


def decoded(data: bytes) -> str:
    """Return text in UTF-8, UTF-16 with a mark, or, failing that, Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def whole_text(path: Path) -> str:
    """Return the text of a file that does not end within a number.

    Raises:
        NacreError: it ends within a number.
    """
    text = decoded(path.read_bytes())
    check_end(text, path)
    return text


def check_end(text: str, path: Path) -> None:
    """Refuse a table that ends within a number: its last number has fewer digits than all others of its row.

    Raises:
        NacreError: the table ends within a number.
    """
    if text[-1:].isspace() or not text:
        return
    cells = re.split(r"[\s,;]+", text[text.rfind("\n") + 1 :].strip())
    digits = [len(re.sub(r"\D", "", cell.partition(".")[2])) if "." in cell else 0 for cell in cells]
    if len(cells) > 2 and digits[0] > 0 and len(set(digits[:-1])) == 1 and digits[-1] < digits[0]:
        raise NacreError(f"{path}: ends within a number")


def requested_unit(path: Path, options: ReadOptions, what: str = "heights") -> float:
    """Return the unit of the option `unit` in um.

    Raises:
        AmbiguousFileError: no unit is given.
        NacreError: it is not a length.
    """
    if options.unit is None:
        raise AmbiguousFileError(
            f"{path}: the file states no unit of its {what}; state it: unit = nm, um, mm or m", "unit", UNIT_CHOICES
        )
    factor = length_um(options.unit)
    if factor is None:
        raise NacreError(f'{path}: unit = "{options.unit}" is not a length; allowed: {", ".join(UNIT_CHOICES)}')
    return factor


def check_unit(path: Path, options: ReadOptions, stated: str) -> None:
    """Refuse an option `unit` that differs from the unit of heights in the file, which may be empty or not a length.

    Raises:
        NacreError: the units differ.
    """
    factor = length_um(stated)
    if factor is not None and options.unit is not None and not math.isclose(requested_unit(path, options), factor):
        raise contradiction(path, "unit", options.unit, stated.strip())


def requested_pitch(path: Path, options: ReadOptions) -> tuple[float, float]:
    """Return the option `pitch_um`.

    Raises:
        AmbiguousFileError: the option is missing.
    """
    if options.pitch_um is None:
        raise AmbiguousFileError(
            f"{path}: the file states no distance of its points; state it in um: pitch_um", "pitch_um"
        )
    return options.pitch_um


def height_map(
    path: Path, heights_um: NDArray[Any], pitch_um: tuple[float, float], name: str = "",
    metadata: Mapping[str, Any] | None = None, assumed: Sequence[str] = (), left_out: Sequence[str] = (),
) -> Measurement:  # fmt: skip
    """Return the measurement of one map.

    Args:
        heights_um: `[row, column]`, row 0 at the picture's top; holes are NaN or masked.
        pitch_um: point distance along a row and along a column.
        metadata: further statements of the file; figures of roughness, without the least-squares plane, join them.

    Raises:
        ValueError: the pitch or the heights are not plausible.
    """
    pitch = float(pitch_um[0]), float(pitch_um[1])
    if not all(1e-6 <= p <= 1e6 for p in pitch):  # no instrument has a finer or coarser one
        raise ValueError(f"its points are {pitch[0]:g} x {pitch[1]:g} um apart")
    heights = np.ma.filled(np.ma.asarray(heights_um).astype(float), np.nan)
    check_shape((heights.shape[0], heights.shape[1]))
    if min(heights.shape) == 1:
        raise NacreError(f"{path}: holds a profile of {heights.size} points; a height map is needed")
    heights[~np.isfinite(heights)] = np.nan
    if np.nanmax(np.abs(heights), initial=0.0) > HIGHEST_UM:
        raise ValueError(f"heights of up to {np.nanmax(np.abs(heights)):.3g} um")
    holes = int(np.isnan(heights).sum())
    if holes == heights.size:
        raise NacreError(f"{path}: holds no height; all {holes} points are holes")
    figures = {key: value for key, value in asdict(roughness(heights, pitch)).items() if key != "mean_um"}
    if abs(pitch[0] - pitch[1]) > SQUARE * pitch[0]:
        assumed = (*assumed, f"the points are {pitch[0]:.4g} x {pitch[1]:.4g} um apart, as the file says: not square")
    facts = {"pitch_um": pitch, "holes": holes, **figures, **(metadata or {})}
    return Measurement(path, "heights", {"height_um": heights}, name, facts, tuple(assumed), tuple(left_out))


def chosen(path: Path, maps: Sequence[Measurement], others: Sequence[str], options: ReadOptions) -> list[Measurement]:
    """Return the maps selected by the option `channel` (name, or number from 1), or all maps.

    Raises:
        NacreError: no channel holds heights, or none has the name.
    """
    if not maps:
        raise NacreError(f"{path}: no channel holds heights; it holds {', '.join(others) or 'nothing'}")
    if options.channel is None:
        return list(maps)
    for k, one in enumerate(maps):
        if options.channel in (one.name, str(k + 1)):
            return [one]
    names = ", ".join(f'"{one.name}"' for one in maps)
    raise NacreError(f'{path}: channel = "{options.channel}" is not in the file; allowed: {names}')


# Tilt and roughness of height maps: least-squares plane, Sq, Sdq and autocorrelation length (ISO 25178-2).

MOST_HOLES = 0.1  # share of holes that is filled
DECAY = float(np.exp(-1.0))  # value of a Gaussian or exponential autocorrelation at its correlation length
MAX_POINTS = 1 << 22  # points in the central part whose autocorrelation is computed
FILL_STEPS = 200


@dataclass(frozen=True)
class Roughness:
    """Roughness parameters of a height map (ISO 25178-2), relative to its least-squares plane.

    Attributes:
        tilt_deg: angle between the plane and the horizontal.
        mean_um: height of the plane at the centre of the map, an offset that depends on the stage.
        sq_um: root mean square height, Sq.
        sdq: root mean square gradient, Sdq, from neighbouring points.
        correlation_length_um: shortest lag at which the azimuthally averaged autocorrelation falls to 1/e; None if it
            stays above 1/e up to half the map.
        peak_to_valley_um: maximum height, Sz.
    """

    tilt_deg: float
    mean_um: float
    sq_um: float
    sdq: float
    correlation_length_um: float | None
    peak_to_valley_um: float


def plane(heights: NDArray[Any]) -> tuple[float, float, float]:
    """Return mean, slope per row and slope per column of the least-squares plane; holes do not count."""
    r, c = (np.arange(count) - 0.5 * (count - 1) for count in heights.shape)
    is_known = np.isfinite(heights)
    if is_known.all():
        mean = float(heights.mean())
        by_row = float(r @ heights.mean(axis=1) / max(r @ r, 1e-300))
        by_column = float(c @ heights.mean(axis=0) / max(c @ c, 1e-300))
        return mean, by_row, by_column
    row, column = np.nonzero(is_known)
    matrix = np.stack([np.ones(len(row)), r[row], c[column]], axis=1)
    mean, by_row, by_column = map(float, np.linalg.lstsq(matrix, heights[is_known], rcond=None)[0])
    return mean, by_row, by_column


def without_plane(heights: NDArray[Any], fitted: tuple[float, float, float]) -> Array:
    """Return heights above a plane fitted by `plane`."""
    r, c = (np.arange(count) - 0.5 * (count - 1) for count in heights.shape)
    mean, by_row, by_column = fitted
    return np.asarray(heights - (mean + by_row * r[:, None] + by_column * c[None, :]))


def filled(heights: NDArray[Any]) -> Array:
    """Return heights with holes filled: nearest neighbours, then the mean of neighbours repeatedly (Laplace)."""
    from scipy.ndimage import distance_transform_edt

    holes = ~np.isfinite(heights)
    if not holes.any():
        return np.asarray(heights, dtype=float)
    nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
    result = np.asarray(heights, dtype=float)[tuple(nearest)]
    row, column = np.nonzero(holes)
    last_row, last_column = heights.shape[0] - 1, heights.shape[1] - 1
    around = [
        (np.maximum(row - 1, 0), column), (np.minimum(row + 1, last_row), column),
        (row, np.maximum(column - 1, 0)), (row, np.minimum(column + 1, last_column)),
    ]  # fmt: skip
    for _ in range(FILL_STEPS):
        result[row, column] = sum(result[place] for place in around) / 4.0
    return result


def roughness(heights_um: NDArray[Any], pitch_um: tuple[float, float]) -> Roughness:
    """Return tilt and roughness of a map.

    Args:
        heights_um: `[row, column]`; holes are NaN.
        pitch_um: point distance along a row, and along a column.
    """
    fitted = plane(heights_um)
    flat = without_plane(heights_um, fitted)
    slope = np.hypot(fitted[1] / pitch_um[1], fitted[2] / pitch_um[0])
    square = [np.nanmean(np.diff(flat, axis=k) ** 2) / pitch_um[1 - k] ** 2 for k in (0, 1)]
    span = float(np.nanmax(flat) - np.nanmin(flat))
    return Roughness(
        float(np.degrees(np.arctan(slope))), fitted[0], float(np.sqrt(np.nanmean(flat**2))),
        float(np.sqrt(sum(square))), correlation_length_um(flat, pitch_um), span,
    )  # fmt: skip


def autocovariance(flat: Array) -> Array:
    """Return the unbiased mean of h(x) h(x + lag), `[lag row, lag column]`, lags from 0, negative ones at the end.

    Holes do not count.
    """
    shape = tuple(scipy.fft.next_fast_len(2 * n, real=True) for n in flat.shape)

    def correlated(values: Array) -> Array:
        spectrum = scipy.fft.rfft2(values.astype(np.float32), shape)
        return np.asarray(scipy.fft.irfft2((spectrum * spectrum.conj()).real, shape))

    is_known = np.isfinite(flat)
    total = correlated(np.where(is_known, flat, 0.0))
    if is_known.all():
        counts = [np.maximum(n - np.abs(np.fft.fftfreq(m, 1.0 / m)), 1.0) for n, m in zip(flat.shape, shape)]
        return np.asarray(total / (counts[0][:, None] * counts[1]).astype(np.float32))
    return np.asarray(total / np.maximum(correlated(is_known), 1.0))


def correlation_length_um(flat: Array, pitch_um: tuple[float, float]) -> float | None:
    """Return the lag at which the azimuthally averaged autocorrelation falls to 1/e."""
    side = int(np.sqrt(MAX_POINTS))
    part = flat[: min(flat.shape[0], side), : min(flat.shape[1], side)]
    part = part - np.nanmean(part)
    if not np.nanmean(part**2) > 0:
        return None
    covariance = autocovariance(part)
    if not covariance[0, 0] > 0:  # below single precision
        return None
    half = part.shape[0] // 2, part.shape[1] // 2
    rows = np.abs(np.fft.fftfreq(covariance.shape[0], 1.0 / covariance.shape[0]))
    # columns from 0 are enough: the autocovariance is even
    is_near = rows < max(half[0], 1)
    near = covariance[is_near][:, : max(half[1], 1)]
    lag = np.hypot(rows[is_near][:, None] * pitch_um[1], np.arange(near.shape[1]) * pitch_um[0])
    step = min(pitch_um)
    ring = np.round(lag / step).astype(np.int64).ravel()
    count = np.bincount(ring)
    mean = np.bincount(ring, near.ravel()) / np.maximum(count, 1)
    radius = np.bincount(ring, lag.ravel()) / np.maximum(count, 1)
    used = count > 0
    ratio, radius = (mean / covariance[0, 0])[used], radius[used]
    below = np.flatnonzero(ratio < DECAY)
    if not below.size or below[0] == 0:
        return None
    k = int(below[0])
    share = (ratio[k - 1] - DECAY) / (ratio[k - 1] - ratio[k])
    return float(radius[k - 1] + share * (radius[k] - radius[k - 1]))


# One height map of a file of any format of this folder.


def read_map(path: str | Path, options: ReadOptions | None = None) -> Measurement:
    """Read the one height map of a file; other kinds of files that a text may be are not considered.

    Raises:
        NacreError: no height map, or a damaged one.
        AmbiguousFileError: a unit, the pitch or the channel is not known; `option` names it.
    """
    options = options or ReadOptions()
    candidates = recognise(path)
    maps = [entry for _, entry in candidates if entry.kind == "heights"]
    if candidates and candidates[0][1].id == "other":
        open_file(path, options)  # refuses it by name
    if not maps or (candidates[0][1].kind != "heights" and candidates[0][0] >= 1.0):
        what = f"is {candidates[0][1].title}, " if candidates else "is "
        raise NacreError(f"{path}: {what}no height map that nacre reads; export it as .sdf, .gwy or text matrix")
    measured = open_file(path, replace(options, format=options.format or maps[0].id))
    if len(measured) > 1:
        names = tuple(one.name for one in measured)
        raise AmbiguousFileError(
            f"{path}: holds {len(names)} channels of heights; choose one: channel", "channel", names
        )
    return measured[0]
