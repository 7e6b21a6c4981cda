"""Measured BRDFs of public databases: ALTA, MERL, UTIA."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, angles_deg, from_half_difference
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import (
    COLOURS,
    DEGREES,
    measurement,
    pairs_of,
    pairs_of_half_angles,
    read_bytes,
    read_text,
)
from nacre.readers.bsdf.samples import measurement as as_measurement
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead

# ALTA text (`#DIM`, `#PARAM_IN`, `#PARAM_OUT`): angles in radians, cosines, or unit vectors.

OUTPUTS = {"INV_STERADIAN": None, "RGB_COLOR": "rgb", "XYZ_COLOR": "xyz"}


def sniff_alta(head: FileHead) -> float:
    """Recognise the line of dimensions."""
    return CERTAIN if any(line.startswith(("#DIM", "#PARAM_IN")) for line in head.lines[:200]) else 0.0


def read_alta(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a table with values for single directions or a slice.

    A one-dimensional slice over the half angle has no direction pairs; its columns are `cos_theta_half` and the values.

    Raises:
        NacreError: parameters or values that are not known, or rows that do not fit.
    """
    head: dict[str, list[str]] = {}
    table: list[list[float]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        if words[0].startswith("#"):
            head.setdefault(words[0].lstrip("#").upper(), words[1:])
            continue
        try:
            table.append([float(word) for word in words])
        except ValueError:
            raise NacreError(f'{path}: line {number}: "{line.strip()[:40]}" is not a row of numbers') from None
    parameters, output = (head.get(key, ["?"])[0].upper() for key in ("PARAM_IN", "PARAM_OUT"))
    try:
        inputs, outputs = (int(word) for word in head["DIM"][:2])
    except (KeyError, ValueError):
        raise NacreError(f"{path}: has no line #DIM with two numbers") from None
    if not table or any(len(row) < inputs + outputs for row in table):
        raise NacreError(f"{path}: rows should hold {inputs} + {outputs} numbers, as #DIM says")
    if output not in OUTPUTS:
        raise NacreError(f"{path}: PARAM_OUT = {output} is not one of {', '.join(OUTPUTS)}")
    numbers = np.array([row[: inputs + outputs] for row in table])
    x, values = numbers[:, :inputs], numbers[:, inputs:]
    metadata = {"parameters": parameters, "output": output}
    if parameters in ("COS_TH", "RUSIN_TH"):
        cosine = x[:, 0] if parameters == "COS_TH" else np.cos(x[:, 0])
        data = {"cos_theta_half": cosine}
        data |= {"bsdf_rgb": values} if values.shape[1] == 3 else {"bsdf": values[:, 0]}
        lost = "a one-dimensional slice over the half angle: it determines no BRDF by itself"
        return [Measurement(path, "alta", "bsdf", data, "", metadata | {"scatter": "brdf"}, (), (lost,))]
    colour = OUTPUTS[output]
    if (3 if colour else 1) != outputs:
        raise NacreError(f"{path}: PARAM_OUT = {output} does not fit the {outputs} values of #DIM")
    assumed = ["the file names no wavelength; one value stands for all"] if colour is None else []
    return [as_measurement(path, "alta", _angles(path, parameters, x), None, values, metadata, colour=colour,
                           assumed=assumed)]  # fmt: skip


def _angles(path: Path, parameters: str, x: Array) -> Array:
    """Return direction pairs in degrees."""
    zero = np.zeros(len(x))
    if parameters == "CARTESIAN" and x.shape[1] == 6:
        light, viewer = angles_deg(x[:, :3]), angles_deg(x[:, 3:])
        return pairs_of(light[:, 0], light[:, 1], viewer[:, 0], viewer[:, 1])
    if parameters == "SPHERICAL_TL_PL_TV_PV" and x.shape[1] == 4:
        return np.degrees(x) % 360.0
    if parameters == "ISOTROPIC_TV_TL_DPHI" and x.shape[1] == 3:
        return pairs_of(np.degrees(x[:, 1]), zero, np.degrees(x[:, 0]), np.degrees(x[:, 2]) % 360.0)
    if parameters == "ISOTROPIC_TV_TL" and x.shape[1] == 2:
        return pairs_of(np.degrees(x[:, 1]), zero, np.degrees(np.abs(x[:, 0])), np.where(x[:, 0] < 0, 0.0, 180.0))
    if parameters == "RUSIN_TH_PH_TD_PD" and x.shape[1] == 4:
        return pairs_of_half_angles(*x.T)
    if parameters == "RUSIN_TH_TD_PD" and x.shape[1] == 3:
        return pairs_of_half_angles(x[:, 0], zero, x[:, 1], x[:, 2])
    raise NacreError(f"{path}: PARAM_IN = {parameters} with {x.shape[1]} numbers does not give direction pairs")


# MERL binary files: isotropic RGB reflectance in half and difference angles (Matusik et al. 2003).
#
# Three int32 sizes (90, 90, 180), then three planes of float64: red, green, blue, scaled by 1/1500, 1.15/1500 and
# 1.66/1500. Bins are uniform in the square root of theta_half, in theta_diff and in phi_diff (mod pi, by reciprocity).
# A bin that is -1 in all channels is invalid.

SHAPE = (90, 90, 180)
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
MERL_SIZE = 12 + 8 * 3 * SHAPE[0] * SHAPE[1] * SHAPE[2]


def sniff_merl(head: FileHead) -> float:
    """Recognise the three sizes, or the file's size."""
    if len(head.data) < 12:
        return 0.0
    is_shape = tuple(np.frombuffer(head.data, "<i4", 3)) == SHAPE
    return CERTAIN if is_shape else 0.5 if head.path.suffix.lower() == ".binary" else 0.0


def bin_angles() -> tuple[Array, Array, Array]:
    """Return theta_half, theta_diff and phi_diff (radians) at the bin centres, each `[half, diff, phi]`."""
    half = ((np.arange(SHAPE[0]) + 0.5) / SHAPE[0]) ** 2 * (np.pi / 2)
    diff = (np.arange(SHAPE[1]) + 0.5) / SHAPE[1] * (np.pi / 2)
    phi = (np.arange(SHAPE[2]) + 0.5) / SHAPE[2] * np.pi
    first, second, third = np.meshgrid(half, diff, phi, indexing="ij")
    return first, second, third


def read_raw(path: str | Path) -> Array:
    """Read linear RGB reflectance `[90, 90, 180, 3]`; invalid bins become NaN, other values are kept.

    Raises:
        NacreError: not a MERL file, or damaged.
    """
    path = Path(path)
    data = read_bytes(path)
    if len(data) != MERL_SIZE:
        raise NacreError(f"{path}: has {len(data)} bytes; a MERL file of 90 x 90 x 180 bins has {MERL_SIZE}")
    shape = tuple(int(n) for n in np.frombuffer(data, "<i4", 3))
    if shape != SHAPE:
        raise NacreError(f"{path}: has {shape} bins; only the standard {SHAPE} is known")
    planes = np.frombuffer(data, "<f8", offset=12).reshape(3, *SHAPE)
    if not np.all(np.isfinite(planes)):
        raise NacreError(f"{path}: holds {int(np.sum(~np.isfinite(planes)))} values that are not finite")
    table = np.moveaxis(planes * SCALE[:, None, None, None], 0, -1)
    # -1 is stored raw, or after the scale was divided out
    invalid = np.all(planes <= -0.999, axis=0) | np.all(np.abs(table + 1.0) < 1e-6, axis=-1)
    return np.where(invalid[..., None], np.nan, table)


def is_up() -> NDArray[np.bool_]:
    """Whether both directions of a bin lie above the surface, `[half, diff, phi]`."""
    wi, wo = from_half_difference(*bin_angles())
    return np.asarray((wi[..., 2] > 0) & (wo[..., 2] > 0))


def bin_remarks(table: Array) -> list[str]:
    """Return remarks on invalid and negative bins of `read_raw`'s table."""
    invalid = np.isnan(table).all(axis=-1)
    above = int(np.sum(invalid & is_up()))
    remarks = [f"{above} of {int(is_up().sum())} bins above the surface are invalid (-1)"] if above else []
    for channel, colour in enumerate(("red", "green", "blue")):
        below = table[..., channel] < 0
        if np.any(below):
            remarks.append(
                f"{int(below.sum())} bins are negative in {colour}, down to {np.nanmin(table[..., channel]):.3g}"
            )
    return remarks


def read_merl(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all bins; directions below the surface and invalid bins are left out."""
    table = read_raw(path)
    up = is_up() & ~np.isnan(table).any(axis=-1)
    half, diff, phi = (a[up] for a in bin_angles())
    angles = pairs_of_half_angles(half, np.zeros_like(half), diff, phi)
    data = {name: angles[:, i] for i, name in enumerate(DEGREES)} | {COLOURS["rgb"]: table[up]}
    metadata = {"scatter": "brdf", "pairs": len(angles), "shape": SHAPE}
    below = int(np.sum(~is_up()))
    left = [f"{below} of {up.size} bins lie below the surface", *bin_remarks(table)]
    return [Measurement(path, "merl", "bsdf", data, "", metadata, (), tuple(left))]


# UTIA BRDF files: float64 planes of RGB on a uniform grid, without a head (Filip and Vavra 2014).
#
# 288 incident by 288 exit directions: theta 0 to 75 in steps of 15 degrees, phi 0 to 352.5 in steps of 7.5. The order
# is channel, theta_i, phi_i, theta_v, phi_v. Values are BRDF times pi or reflectance factors by the data set; they are
# read as the BRDF that the data set's own viewer uses.

THETA = np.arange(6) * 15.0
PHI = np.arange(48) * 7.5
UTIA_SIZE = 8 * 3 * (len(THETA) * len(PHI)) ** 2


def sniff_utia(head: FileHead) -> float:
    """Recognise the file's size and numbers in its head; the format has no magic."""
    if head.size != UTIA_SIZE or b"nacre" in head.data[:16]:
        return 0.0
    values = np.frombuffer(head.data[: len(head.data) // 8 * 8], "<f8")
    return LIKELY if np.all(np.isfinite(values)) and np.all(np.abs(values) < 1e6) else 0.0


def read_utia(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all direction pairs.

    Raises:
        NacreError: the size or the numbers do not fit.
    """
    data = read_bytes(path, 8.0)
    if len(data) != UTIA_SIZE:
        raise NacreError(f"{path}: has {len(data)} bytes; a UTIA file of 288 x 288 directions has {UTIA_SIZE}")
    planes = np.frombuffer(data, "<f8").reshape(3, -1)
    if not np.all(np.isfinite(planes)):
        raise NacreError(f"{path}: holds values that are not finite")
    grids = np.meshgrid(THETA, PHI, THETA, PHI, indexing="ij")
    metadata = {"scatter": "brdf", "shape": (len(THETA), len(PHI), len(THETA), len(PHI))}
    assumed = ["the file has no head; the standard grid of the UTIA database is assumed"]
    return [
        measurement(path, "utia", pairs_of(*grids), None, planes.T, metadata, colour="rgb", assumed=assumed,
                    left_out=["nothing was measured above 75 degrees"])
    ]  # fmt: skip
