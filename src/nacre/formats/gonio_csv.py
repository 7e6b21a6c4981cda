"""Goniometric measurements as CSV: theta_i, phi_i, theta_o, phi_o (degrees), wavelength (nm), value (1/sr)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path
from nacre.light import xyz_to_srgb_linear
from nacre.readers.bsdf.gonio_table import read_gonio
from nacre.readers.bsdf.samples import COLOURS, DEGREES
from nacre.readers.measurement import Measurement, ReadOptions

COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o", "wavelength", "value")
MAX_VALUE = 1e12  # far above any BSDF
ROUND_TRIP_DIGITS = 9  # preserve float32
ANGLE_DIGITS = 6  # decimals of angles in degrees that distinguish directions
SAME = 1e-9  # relative difference of equal values
MIN_MEASURED = 0.5  # share of pairs and wavelengths that must have a value


@dataclass(frozen=True)
class GonioData:
    """A measurement on a grid of direction pairs.

    Attributes:
        angles_deg: `[pair, 4]`: theta_i, phi_i, theta_o, phi_o; theta above 90 is the other side.
        wavelengths_nm: `[wavelength]`, ascending.
        values: `[pair, wavelength]`, the BSDF in 1/sr, without the cosine.
    """

    angles_deg: Array
    wavelengths_nm: Array
    values: Array

    @property
    def wi(self) -> Array:
        """Unit vectors to the light, `[pair, 3]`."""
        return direction(*np.radians(self.angles_deg[:, :2].T))

    @property
    def wo(self) -> Array:
        """Unit vectors to the viewer, `[pair, 3]`."""
        return direction(*np.radians(self.angles_deg[:, 2:].T))


def write_gonio_csv(path: str | Path, data: GonioData, comment: str = "") -> None:
    """Write the measurement, one row per pair and wavelength; comment lines start with #.

    Raises:
        NacreError: the file cannot be written.
    """
    pairs, waves = data.values.shape
    table = np.empty((pairs * waves, 6))
    table[:, :4] = np.repeat(data.angles_deg, waves, axis=0)
    table[:, 4] = np.tile(data.wavelengths_nm, pairs)
    table[:, 5] = data.values.ravel()
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        for line in comment.splitlines():
            file.write(f"# {line}\n")
        file.write(",".join(COLUMNS) + "\n")
        np.savetxt(file, table, fmt=f"%.{ROUND_TRIP_DIGITS}g", delimiter=",")


def read_gonio_csv(path: str | Path) -> GonioData:
    """Read a measurement (see `nacre.readers.bsdf.gonio_table`); every direction pair has the same wavelengths.

    Raises:
        NacreError: the file is invalid; names the line or the column.
    """
    data, _ = gonio_data(read_gonio(Path(path), ReadOptions())[0])
    return data


def gonio_data(measured: Measurement) -> tuple[GonioData, list[str]]:
    """Return a measurement as values by direction pair and wavelength (NaN: missing), and remarks.

    Colour channels become smooth spectra; one value without a wavelength stands for all.

    Raises:
        UnsupportedError: the measurement holds no direction pairs.
        NacreError: repeated directions contradict each other.
    """
    data, remarks = measured.data, list(measured.assumed)
    if not set(DEGREES) <= set(data):
        why = measured.left_out[0] if measured.left_out else "it holds no pairs of directions"
        raise UnsupportedError(f"{measured.path}: cannot become a material: {why}")
    if measured.metadata.get("scatter") == "btdf":
        raise UnsupportedError(
            f"{measured.path}: is a BTDF (transmitted scatter), and a measured material reflects only; a material that "
            'transmits: family = "glass" with a rough surface; the values as a table: nacre read FILE -o scatter.csv'
        )
    angles = np.stack([data[name] for name in DEGREES], axis=-1)
    colour = next((key for key in COLOURS.values() if key in data), None)
    if colour is not None:
        rgb = data[colour] if colour == COLOURS["rgb"] else np.asarray(xyz_to_srgb_linear(data[colour]))
        return GonioData(angles, np.arange(1.0, 4.0), rgb), remarks
    if "wavelength_nm" not in data:
        return GonioData(angles, np.ones(1), data["bsdf"][:, None]), remarks
    return _grouped(measured, angles, remarks)


def _grouped(measured: Measurement, angles: Array, remarks: list[str]) -> tuple[GonioData, list[str]]:
    """Sort rows into pairs and wavelengths; repeated rows are averaged."""
    waves, wave_at = np.unique(measured.data["wavelength_nm"], return_inverse=True)
    pairs, first, pair_at = np.unique(np.round(angles, ANGLE_DIGITS), axis=0, return_index=True, return_inverse=True)
    place = (np.ravel(pair_at), np.ravel(wave_at))
    value = measured.data["bsdf"]
    known = np.isfinite(value)
    total, count = np.zeros((len(pairs), len(waves))), np.zeros((len(pairs), len(waves)))
    np.add.at(total, tuple(p[known] for p in place), value[known])
    np.add.at(count, tuple(p[known] for p in place), 1)
    with np.errstate(invalid="ignore"):
        values = np.where(count > 0, total / count, np.nan)
    repeated = int(np.sum(np.maximum(count - 1, 0)))
    if repeated:
        spread = np.max(np.abs(value[known] - values[place][known]) / np.maximum(np.abs(values[place][known]), 1e-12))
        if spread > SAME:
            remarks.append(
                f"{repeated} rows repeat a direction and wavelength (within {spread:.2g}); they were averaged"
            )
    if np.mean(count > 0) < MIN_MEASURED and len(waves) > 1:
        raise NacreError(
            f"{measured.path}: has {int(np.sum(count > 0))} values for {len(pairs)} direction pairs and {len(waves)} "
            "wavelengths; most pairs lack most wavelengths"
        )
    order = np.argsort(first)  # order of the file
    return GonioData(pairs[order], waves, values[order]), remarks
