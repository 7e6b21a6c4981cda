"""Checks, units and the convention of Delta that all ellipsometer formats share.

Psi and Delta: r_p / r_s = tan(Psi) exp(i Delta). In the convention `positive` the fields are exp(+i w t) and r_p = -r_s
at normal incidence, as in the programs of all makers read here: a bare metal or wafer has Delta between 0 and 180
degrees. `negative` has the opposite sign. In the two `shifted` conventions r_p = r_s at normal incidence: Delta is
larger by 180 degrees.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers import units
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.text_table import load_text
from nacre.readers.units import spectral_unit

CONVENTIONS = {
    "positive": (1, 0.0),
    "negative": (-1, 0.0),
    "positive-shifted": (1, 180.0),
    "negative-shifted": (-1, 180.0),
}
ALLOWED_UNITS = "nm, um, angstrom, eV, 1/cm"
MIN_NM, MAX_NM = 100.0, 60_000.0  # range of ellipsometers: far ultraviolet to infrared
MOST_MUELLER = 1.05  # |m_ij| / m11 of a passive sample is at most 1, here with noise
SIGN_FLOOR = 0.02  # |sin 2Psi sin Delta| below which the Delta sign has no effect within the noise
AGREEMENT = 0.05  # relative difference between pseudo-dielectric functions of a bare surface at several angles


def text_lines(path: Path) -> list[str]:
    """Return the lines of a text file; see `text_table.load_text`."""
    return load_text(path).splitlines()


def numbers(text: str) -> list[float] | None:
    """Return the numbers of a line separated by blanks, tabs, commas or semicolons; None if a cell is not a number.

    A comma is a decimal comma beside another separator and without points.
    """
    text = text.replace(";", " ").strip()
    is_decimal = "," in text and "." not in text and len(text.split()) > 1
    cells = text.replace(",", "." if is_decimal else " ").split()
    try:
        return [float(cell) for cell in cells] or None
    except ValueError:
        return None


def row_of(path: Path, number: int, line: str, text: str | None = None) -> list[float]:
    """Return the numbers of a numbered line.

    Args:
        text: its part that holds the numbers; default: all.

    Raises:
        NacreError: a cell is not a number.
    """
    values = numbers(line if text is None else text)
    if values is None:
        raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
    return values


def to_nm(values: Array, unit: str, where: str) -> Array:
    """Return wavelengths in nm.

    Raises:
        NacreError: an unknown unit, or a value outside 100 nm to 60 um, which indicates a wrong unit.
    """
    canonical = spectral_unit(unit)
    if canonical is None:
        raise NacreError(f"{where}: the unit {unit!r} of the wavelength is not known; allowed: {ALLOWED_UNITS}")
    nm = units.to_nm(values, canonical)
    outside = nm[~((nm >= MIN_NM) & (nm <= MAX_NM))]
    if outside.size:
        raise NacreError(
            f"{where}: wavelength = {outside[0]:g} nm is not a wavelength of an ellipsometer; allowed: {MIN_NM:g} to "
            f"{MAX_NM:g} nm; the unit {unit} may be wrong"
        )
    return nm


def folded(delta_deg: Array) -> Array:
    """Return angles in (-180, 180]."""
    return 180.0 - np.mod(180.0 - delta_deg, 360.0)


def standard_delta(delta_deg: Array, convention: str) -> Array:
    """Return Delta of a convention in the convention `positive`, in degrees."""
    sign, offset = CONVENTIONS[convention]
    return sign * (np.asarray(delta_deg, dtype=float) - offset)


def pseudo_epsilon(psi_deg: Array, delta_deg: Array, angle_deg: Array) -> NDArray[np.complex128]:
    """Return the pseudo-dielectric function of a bare surface in air, n + ik with k >= 0, Delta in `positive`.

    <eps> = sin^2(t) (1 + tan^2(t) ((1 - rho) / (1 + rho))^2) (Azzam and Bashara, 1977), conjugated to exp(-i w t).
    """
    rho = np.tan(np.radians(psi_deg)) * np.exp(1j * np.radians(delta_deg))
    t = np.radians(angle_deg)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.conj(np.sin(t) ** 2 * (1.0 + np.tan(t) ** 2 * ((1.0 - rho) / (1.0 + rho)) ** 2)))


def delta_convention(
    path: Path, wavelength: Array, angle: Array, psi: Array, delta: Array
) -> tuple[str, tuple[str, ...]]:
    """Return the convention of Delta in a file without a maker's name, and a sentence with the assumption and reason.

    Raises:
        AmbiguousFileError: the data agree with both signs.
    """
    s = np.sin(2 * np.radians(psi)) * np.sin(np.radians(delta))
    above, below = bool(np.any(s > SIGN_FLOOR)), bool(np.any(s < -SIGN_FLOOR))
    if not below:
        flat = "has no visible sign" if not above else "is between 0 and 180 degrees"
        low = angle < 45.0  # below the Brewster angle of any solid in air
        if not above and np.any(low) and np.all(np.cos(np.radians(delta[low])) > 0):
            return "positive-shifted", (
                "Delta is taken as positive-shifted: it is near 0 below the Brewster angle, so r_p = r_s at normal "
                "incidence",
            )
        return "positive", (f"Delta is taken as positive (exp(+i w t)): it {flat}, as of a bare metal or wafer",)
    if not above and _is_bare_surface(wavelength, angle, psi, delta):
        return "negative", (
            "Delta is taken as negative (exp(-i w t)): the pseudo-dielectric function is equal at all angles, as of a "
            "bare surface, which absorbs only with this sign",
        )
    raise AmbiguousFileError(
        f"{path}: the sign of Delta cannot be decided from the data; state --delta-convention positive (bare metals "
        "and wafers have Delta between 0 and 180 degrees) or negative",
        "delta_convention",
        tuple(CONVENTIONS),
    )


def _is_bare_surface(wavelength: Array, angle: Array, psi: Array, delta: Array) -> bool:
    """Whether the pseudo-dielectric functions agree at two or more angles."""
    eps = pseudo_epsilon(psi, delta, angle)
    angles = np.unique(angle)
    if len(angles) < 2 or not np.all(np.isfinite(eps)):
        return False
    first = angle == angles[0]
    for other in angles[1:]:
        here = angle == other
        common, i, j = np.intersect1d(wavelength[first], wavelength[here], return_indices=True)
        if not len(common):
            return False
        a, b = eps[first][i], eps[here][j]
        if np.max(np.abs(a - b) / np.abs(a)) > AGREEMENT:
            return False
    return True


def ellipsometry(
    path: Path,
    columns: Mapping[str, Any],
    options: ReadOptions,
    *,
    maker: str = "",
    name: str = "",
    metadata: Mapping[str, Any] | None = None,
    assumed: Sequence[str] = (),
    left_out: Sequence[str] = (),
    is_binary: bool = False,
) -> Measurement:
    """Check the columns of one data set and return it.

    Args:
        columns: `wavelength_nm`, `angle_of_incidence_deg` (absent: `options.angle_deg`), and `psi_deg` with
            `delta_deg`, or `tan_psi` with `cos_delta`, or `ncs_c`, `ncs_s` (and `ncs_n`), or `m11` to `m44`; errors.
        maker: name of the program whose convention of Delta holds; empty: decided from the data.

    Raises:
        NacreError: values that the quantity cannot have.
        AmbiguousFileError: no angle, or an undecided Delta sign.
    """
    data = {key: np.asarray(value, dtype=float) for key, value in columns.items()}
    notes = [*assumed]
    if not is_binary and path.read_bytes().rstrip(b" \t\x00\x1a")[-1:] not in (b"\n", b"\r", b""):
        notes.append("the last line has no line end; its last number may be cut")
    wavelength = data["wavelength_nm"]
    if not len(wavelength):
        raise NacreError(f"{path}: contains no rows of data")
    if "angle_of_incidence_deg" not in data:
        if options.angle_deg is None:
            raise AmbiguousFileError(f"{path}: the angle of incidence is missing; state --angle-deg", "angle_deg")
        data["angle_of_incidence_deg"] = np.full(len(wavelength), float(options.angle_deg))
        notes.append(f"the angle of incidence is {options.angle_deg:g} degrees, as given")
    angle = data["angle_of_incidence_deg"]
    within(path, "angle_of_incidence_deg", angle, 0.0, 90.0)
    extra = dict(metadata or {})
    _complete(path, data, extra)
    if "delta_deg" in data:
        within(path, "psi_deg", data["psi_deg"], 0.0, 90.0)
        within(path, "delta_deg", data["delta_deg"], -180.0, 360.0)
    if "delta_deg" in data and "delta_sign" not in extra:
        extra["delta_convention"], reasons = _convention(path, data, options, maker)
        notes += reasons
    notes += _unequal_blocks(wavelength, angle, data.get("time_s", data.get("time")))
    order = {key: data[key] for key in ("wavelength_nm", "angle_of_incidence_deg")}
    return Measurement(path, "ellipsometry", {**order, **data}, name, extra, tuple(notes), tuple(left_out))


def _convention(path: Path, data: Mapping[str, Array], options: ReadOptions, maker: str) -> tuple[str, Sequence[str]]:
    if options.delta_convention is not None:
        if options.delta_convention not in CONVENTIONS:
            raise NacreError(
                f"{path}: delta_convention = {options.delta_convention!r} is not known; allowed: "
                f"{', '.join(CONVENTIONS)}"
            )
        return options.delta_convention, ()
    if maker:
        return "positive", (f"Delta is positive (exp(+i w t)), the convention of {maker}",)
    ok = np.isfinite(data["psi_deg"]) & np.isfinite(data["delta_deg"])
    wavelength, angle = data["wavelength_nm"][ok], data["angle_of_incidence_deg"][ok]
    return delta_convention(path, wavelength, angle, data["psi_deg"][ok], data["delta_deg"][ok])


def _complete(path: Path, data: dict[str, Array], extra: dict[str, Any]) -> None:
    """Add Psi and Delta to tan Psi and cos Delta or to N, C, S."""
    if "tan_psi" in data:
        within(path, "tan_psi", data["tan_psi"], 0.0, np.inf)
        within(path, "cos_delta", data["cos_delta"], -1.05, 1.05)
        data["psi_deg"] = np.degrees(np.arctan(data["tan_psi"]))
        data["delta_deg"] = np.degrees(np.arccos(np.clip(data["cos_delta"], -1.0, 1.0)))
        extra["delta_sign"] = "unknown: the file holds cos Delta"
    elif "ncs_c" in data and "psi_deg" not in data:
        c, s = data["ncs_c"], data["ncs_s"]
        within(path, "ncs_c", c, -1.1, 1.1)
        within(path, "ncs_s", s, -1.1, 1.1)
        if "ncs_n" in data:
            within(path, "ncs_n", data["ncs_n"], -1.1, 1.1)
            data["psi_deg"] = np.degrees(0.5 * np.arccos(np.clip(data["ncs_n"], -1.0, 1.0)))
            data["delta_deg"] = np.degrees(np.arctan2(s, c))
    for name in [f"m{i}{j}" for i in range(1, 5) for j in range(1, 5) if f"m{i}{j}" in data]:
        largest = np.nanmedian(np.abs(data[name])) / np.nanmedian(data.get("m11", np.ones(1)))
        if not largest <= MOST_MUELLER:
            raise NacreError(
                f"{path}: {name} is {largest:.3g} times m11; no element exceeds m11: the columns may be mixed up"
            )


def within(path: Path, name: str, values: Array, low: float, high: float) -> None:
    """Refuse values outside their range; NaN passes.

    Raises:
        NacreError: naming the value and its row.
    """
    wrong = np.flatnonzero((values < low) | (values > high))
    if len(wrong):
        raise NacreError(
            f"{path}: {name} = {values[wrong[0]]:g} in row {wrong[0] + 1} is not possible; allowed: {low:g} to {high:g}"
        )


def _unequal_blocks(wavelength: Array, angle: Array, time: Array | None) -> list[str]:
    """Return a sentence if the angles have different numbers of wavelengths, as in a truncated file."""
    if time is not None:
        return []
    angles, counts = np.unique(angle, return_counts=True)
    if len(angles) < 2 or counts.min() == counts.max() or len(np.unique(wavelength)) < 2:
        return []
    rows = ", ".join(f"{count} at {each:g}" for each, count in zip(angles, counts))
    return [f"the angles have different numbers of rows ({rows} degrees): the file may be incomplete"]


def same_length(path: Path, rows: Sequence[tuple[int, list[float]]]) -> Array:
    """Return numbered rows as a table `[row, column]`.

    Raises:
        NacreError: a row has another column count than the first, as the last row of a truncated file.
    """
    if not rows:
        raise NacreError(f"{path}: contains no rows of data")
    count = len(rows[0][1])
    for line, row in rows:
        if len(row) != count:
            raise NacreError(f"{path}: line {line} has {len(row)} numbers; the first row has {count}")
    return np.array([row for _, row in rows], dtype=float)
