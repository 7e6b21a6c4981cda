"""Measured BRDFs of public databases: ALTA, MERL, UTIA, RGL."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, angles_deg, direction, from_half_difference, interpolate
from nacre.core.errors import NacreError
from nacre.readers.bsdf.gonio_table import COLOURS, DEGREES, measurement, pairs_of, pairs_of_half_angles
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.text_table import load_bytes, load_text, row_of_numbers

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
    for number, line in enumerate(load_text(path).splitlines(), start=1):
        words = line.split()
        if words and words[0].startswith("#"):
            head.setdefault(words[0].lstrip("#").upper(), words[1:])
        elif words:
            table.append(row_of_numbers(path, number, line, words))
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
        return [Measurement(path, "bsdf", data, "", metadata | {"scatter": "brdf"}, (), (lost,))]
    colour = OUTPUTS[output]
    if (3 if colour else 1) != outputs:
        raise NacreError(f"{path}: PARAM_OUT = {output} does not fit the {outputs} values of #DIM")
    assumed = ["the file names no wavelength; one value stands for all"] if colour is None else []
    return [measurement(path, _angles(path, parameters, x), None, values, metadata, colour=colour, assumed=assumed)]


def _angles(path: Path, parameters: str, x: Array) -> Array:
    """Return direction pairs in degrees."""
    zero, degrees = np.zeros(len(x)), np.degrees(x)
    match parameters, x.shape[1]:
        case "CARTESIAN", 6:
            return np.concatenate([angles_deg(x[:, :3]), angles_deg(x[:, 3:])], axis=1)
        case "SPHERICAL_TL_PL_TV_PV", 4:
            return degrees % 360.0
        case "ISOTROPIC_TV_TL_DPHI", 3:
            return pairs_of(degrees[:, 1], zero, degrees[:, 0], degrees[:, 2] % 360.0)
        case "ISOTROPIC_TV_TL", 2:
            return pairs_of(degrees[:, 1], zero, np.abs(degrees[:, 0]), np.where(x[:, 0] < 0, 0.0, 180.0))
        case "RUSIN_TH_PH_TD_PD", 4:
            return pairs_of_half_angles(*x.T)
        case "RUSIN_TH_TD_PD", 3:
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
    half, diff, phi = np.meshgrid(*((np.arange(n) + 0.5) / n for n in SHAPE), indexing="ij")
    return half**2 * (np.pi / 2), diff * (np.pi / 2), phi * np.pi


def read_raw(path: str | Path) -> Array:
    """Read linear RGB reflectance `[90, 90, 180, 3]`; invalid bins become NaN, other values are kept.

    Raises:
        NacreError: not a MERL file, or damaged.
    """
    path = Path(path)
    data = load_bytes(path)
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
        negative = table[..., channel][table[..., channel] < 0]
        if negative.size:
            remarks.append(f"{negative.size} bins are negative in {colour}, down to {negative.min():.3g}")
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
    left_out = (f"{below} of {up.size} bins lie below the surface", *bin_remarks(table))
    return [Measurement(path, "bsdf", data, "", metadata, (), left_out)]


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
    data = load_bytes(path, 8.0)
    if len(data) != UTIA_SIZE:
        raise NacreError(f"{path}: has {len(data)} bytes; a UTIA file of 288 x 288 directions has {UTIA_SIZE}")
    planes = np.frombuffer(data, "<f8").reshape(3, -1)
    if not np.all(np.isfinite(planes)):
        raise NacreError(f"{path}: holds values that are not finite")
    grids = np.meshgrid(THETA, PHI, THETA, PHI, indexing="ij")
    metadata = {"scatter": "brdf", "shape": (len(THETA), len(PHI), len(THETA), len(PHI))}
    assumed = ["the file has no head; the standard grid of the UTIA database is assumed"]
    return [
        measurement(path, pairs_of(*grids), None, planes.T, metadata, colour="rgb", assumed=assumed,
                    left_out=["nothing was measured above 75 degrees"])
    ]  # fmt: skip


# RGL tensor files (`.bsdf`) of Mitsuba's `measured` and pbrt: spectra or RGB, isotropic or anisotropic.
#
# The sampling warp maps the unit square to a bilinear density: the row follows the marginal, the column the conditional
# distribution, both inverted exactly (Dupuy & Jakob 2018, supplement).

FLAT = 1e-4  # segments with smaller relative slope are constant, as in other readers


@dataclass(frozen=True)
class Warp:
    """A normalised density at `[rows, columns]` grid corners.

    Attributes:
        density: `[rows, columns]`, mean 1 over the square.
        conditional: `[rows, columns]`, running integral along a row.
        marginal: `[rows]`, running integral over the rows.
    """

    density: Array
    conditional: Array
    marginal: Array

    @classmethod
    def of(cls, density: Array) -> Warp:
        """Normalise a non-negative density that is positive somewhere."""
        density = np.asarray(density, dtype=float)
        rows, columns = density.shape
        conditional = np.zeros_like(density)
        conditional[:, 1:] = np.cumsum((density[:, 1:] + density[:, :-1]) / 2, axis=1)
        totals = conditional[:, -1]
        marginal = np.concatenate([[0.0], np.cumsum((totals[1:] + totals[:-1]) / 2)])
        total = marginal[-1]
        return cls(density * ((rows - 1) * (columns - 1) / total), conditional / total, marginal / total)

    def sample(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Map uniform (x, y) in [0, 1]^2 to a position; x runs along columns, y along rows."""
        rows, columns = self.density.shape
        x, y = np.clip(x, 0.0, 1 - 1e-12), np.clip(y, 0.0, 1 - 1e-12)
        row = np.clip(np.searchsorted(self.marginal, y, side="right") - 1, 0, rows - 2)
        totals = self.conditional[:, -1]
        v = _solve(totals[row], totals[row + 1], y - self.marginal[row])
        target = x * _blended(self.conditional, row, v, -1)
        column = np.zeros(len(x), dtype=int)
        for step in 2 ** np.arange(columns.bit_length())[::-1]:  # by bisection: the last column that is not beyond
            further = np.minimum(column + step, columns - 2)
            column = np.where(_blended(self.conditional, row, v, further) <= target, further, column)
        left, right = (_blended(self.density, row, v, column + side) * self._unit for side in (0, 1))
        u = _solve(left, right, target - _blended(self.conditional, row, v, column))
        return (column + u) / (columns - 1), (row + v) / (rows - 1)

    def invert(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Map a position back to the uniform (x, y) from which `sample` produces it."""
        rows, columns = self.density.shape
        cu, cv = np.clip(u, 0.0, 1.0) * (columns - 1), np.clip(v, 0.0, 1.0) * (rows - 1)
        column, row = np.minimum(cu.astype(int), columns - 2), np.minimum(cv.astype(int), rows - 2)
        fu, fv = cu - column, cv - row
        totals = self.conditional[:, -1]
        y = self.marginal[row] + fv * (totals[row] + 0.5 * fv * (totals[row + 1] - totals[row]))
        left, right = (_blended(self.density, row, fv, column + side) * self._unit for side in (0, 1))
        below, total = (_blended(self.conditional, row, fv, end) for end in (column, -1))
        x = (below + fu * (left + 0.5 * fu * (right - left))) / np.maximum(total, 1e-300)
        return np.clip(x, 0.0, 1.0), np.clip(y, 0.0, 1.0)

    @property
    def _unit(self) -> float:
        """Scale from density to running integrals."""
        rows, columns = self.density.shape
        return 1.0 / ((rows - 1) * (columns - 1))


def _blended(table: Array, row: Any, v: Array, column: Any) -> Array:
    """Interpolate between two rows of a table."""
    blended: Array = (1 - v) * table[row, column] + v * table[row + 1, column]
    return blended


def _solve(start: Array, end: Array, area: Array) -> Array:
    """Return t in [0, 1] such that the integral of a linear ramp over [0, t] equals `area`."""
    flat = np.abs(start - end) < FLAT * (start + end)
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = 2 * area / (start + end)
        ramp = (start - np.sqrt(np.maximum(start**2 - 2 * area * (start - end), 0.0))) / (start - end)
    return np.clip(np.nan_to_num(np.where(flat, straight, ramp)), 0.0, 1.0)


MAGIC = b"tensor_file\0"
TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "u8", 8: "i8", 9: "f2", 10: "f4", 11: "f8"}
MAX_FIELD_BYTES = 2 << 30
MEMORY_FACTOR = 3  # memory per byte of a file: the file and its arrays in double precision


def read_tensor(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read a tensor file into named arrays.

    Raises:
        NacreError: not a tensor file, damaged, or too large.
    """
    path = Path(path)
    data = load_bytes(path, MEMORY_FACTOR)
    if data[: len(MAGIC)] != MAGIC:
        raise NacreError(f"{path}: is not a tensor file")
    try:
        return _parse_tensor(data)
    except (struct.error, ValueError, KeyError, OverflowError, MemoryError) as error:
        raise NacreError(f"{path}: the tensor file is damaged ({type(error).__name__})") from None


def _parse_tensor(data: bytes) -> dict[str, NDArray[Any]]:
    position = len(MAGIC)
    _, _, count = struct.unpack_from("<BBI", data, position)
    position += 6
    fields: dict[str, NDArray[Any]] = {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, position)
        name = data[position + 2 : position + 2 + length].decode()
        position += 2 + length
        rank, code, offset = struct.unpack_from("<HBQ", data, position)
        position += 11
        shape = struct.unpack_from(f"<{rank}Q", data, position)
        position += 8 * rank
        dtype = np.dtype("<" + TYPES[code])
        number = math.prod(shape)
        if number * dtype.itemsize > MAX_FIELD_BYTES:
            raise ValueError("field too large")
        fields[name] = np.frombuffer(data, dtype, number, offset).reshape(shape)
    return fields


NEEDED = ("theta_i", "phi_i", "ndf", "sigma", "vndf", "jacobian")
MAX_VALUE = 1e12  # larger values occur in damaged files only

SMALLEST = 1e-12
MIN_COS = 1e-4


@dataclass(frozen=True)
class RglBsdf:
    """A measurement in RGL's parameterisation.

    Attributes:
        wavelengths_nm: `[wavelength]`; None for RGB.
        theta_i, phi_i: `[incidence]`, `[azimuth]`, radians.
        ndf, sigma: `[v, u]`.
        warps: one visible-normal warp an azimuth and an incidence.
        values: `[azimuth, incidence, wavelength or channel, row, column]`.
        has_jacobian: whether `values` is to be multiplied by ndf/(4 sigma).
    """

    wavelengths_nm: Array | None
    theta_i: Array
    phi_i: Array
    ndf: Array
    sigma: Array
    warps: tuple[tuple[Warp, ...], ...]
    values: Array
    has_jacobian: bool

    @property
    def is_isotropic(self) -> bool:
        """Whether the values depend on the azimuth difference only."""
        return len(self.phi_i) <= 2

    @classmethod
    def read(cls, path: str | Path) -> RglBsdf:
        """Read a tensor file.

        Raises:
            NacreError: fields are missing or do not fit.
        """
        fields = read_tensor(path)
        missing = [name for name in NEEDED if name not in fields]
        if missing:
            raise NacreError(f"{path}: the tensor file has no field {missing[0]}; it is not a BSDF")
        if "rgb" not in fields and not {"spectra", "wavelengths"} <= set(fields):
            raise NacreError(f"{path}: the tensor file has neither spectra with wavelengths nor rgb; it is not a BSDF")
        try:
            with np.errstate(invalid="ignore"):  # a signalling NaN warns when it is read; _from refuses it
                return cls._from(fields)
        except (ValueError, IndexError):
            raise NacreError(f"{path}: the fields of the tensor file do not fit together or are impossible") from None

    @classmethod
    def _from(cls, fields: dict[str, NDArray[Any]]) -> RglBsdf:
        is_spectral = "spectra" in fields and "wavelengths" in fields
        theta, phi = np.asarray(fields["theta_i"], float), np.asarray(fields["phi_i"], float)
        values = np.asarray(fields["spectra" if is_spectral else "rgb"], float)
        vndf = np.asarray(fields["vndf"], float)
        waves = np.asarray(fields["wavelengths"], float) if is_spectral else np.arange(1.0, 4.0)
        if values.ndim != 5 or vndf.ndim != 4 or values.shape[:3] != (len(phi), len(theta), len(waves)):
            raise ValueError("shapes")
        if vndf.shape[:2] != (len(phi), len(theta)) or fields["ndf"].ndim != 2 or fields["sigma"].ndim != 2:
            raise ValueError("shapes")
        arrays = (theta, phi, values, vndf, waves, fields["ndf"], fields["sigma"])
        if not all(np.isfinite(a).all() and np.max(np.abs(a), initial=0.0) < MAX_VALUE for a in arrays):
            raise ValueError("values")
        if min(*vndf.shape[2:], *values.shape[3:], *fields["ndf"].shape, *fields["sigma"].shape, len(theta)) < 2:
            raise ValueError("nodes")
        if np.any(np.maximum(vndf, 0.0).max(axis=(2, 3)) < SMALLEST) or np.any(np.asarray(fields["sigma"]) < SMALLEST):
            raise ValueError("nothing to divide by")
        if np.any(np.diff(theta) <= 0) or len(waves) < 1 or waves[0] <= 0 or np.any(np.diff(waves) <= 0):
            raise ValueError("axes")
        warps = tuple(tuple(Warp.of(np.maximum(table, 0.0)) for table in row) for row in vndf)
        ndf, sigma = np.asarray(fields["ndf"], float), np.asarray(fields["sigma"], float)
        return cls(waves if is_spectral else None, theta, phi, ndf, sigma, warps, values, bool(fields["jacobian"][0]))

    def evaluate(self, wi: Array, wo: Array) -> Array:
        """Return f (without the cosine), `[..., wavelength or channel]`, zero below the horizon.

        Light azimuths that span a half or a quarter of the circle repeat by rotation or by reflections.
        """
        shape = np.broadcast_shapes(wi.shape, wo.shape)
        wi, wo = (np.broadcast_to(w, shape).reshape(-1, 3) for w in (wi, wo))
        up = (wi[:, 2] > 1e-4) & (wo[:, 2] > 1e-4)
        values = np.zeros((len(wi), self.values.shape[2]))
        values[up] = self._above(wi[up], wo[up])
        return values.reshape(*shape[:-1], -1)

    def _reduced(self, wi: Array, wo: Array) -> tuple[Array, Array]:
        """Turn or reflect both directions so that the light's azimuth lies among the measured ones."""
        repeats = int(round(2 * np.pi / max(float(np.ptp(self.phi_i)), 1e-6)))
        if self.is_isotropic or repeats not in (2, 4):
            return wi, wo
        low = self.phi_i[0] < -1e-6 and self.phi_i[-1] < 1e-6  # measured at negative azimuths
        sides = [np.where(wi[:, k] < 0, -1.0, 1.0) for k in (0, 1)]
        wanted = np.sign(np.cos(self.phi_i.mean())), -1.0 if low else 1.0
        sign_y = sides[1] * wanted[1]
        sign_x = sides[0] * wanted[0] if repeats == 4 else sign_y
        signs = np.stack([sign_x, sign_y, np.ones_like(sign_x)], axis=-1)
        return wi * signs, wo * signs

    def _above(self, wi: Array, wo: Array) -> Array:
        wi, wo = self._reduced(wi, wo)
        m = wi + wo
        m /= np.linalg.norm(m, axis=-1, keepdims=True)
        theta_i, theta_m = np.arccos(np.clip(wi[:, 2], -1, 1)), np.arccos(np.clip(m[:, 2], -1, 1))
        phi_i, phi_m = np.arctan2(wi[:, 1], wi[:, 0]), np.arctan2(m[:, 1], m[:, 0])
        u_m = np.sqrt(theta_m * 2 / np.pi)
        v_m = np.mod((phi_m - (phi_i if self.is_isotropic else 0.0) + np.pi) / (2 * np.pi), 1.0)
        low, share = _place(theta_i, self.theta_i)
        turn, turned = (np.zeros_like(low), np.zeros_like(share)) if self.is_isotropic else self._turn(phi_i)
        total = np.zeros((len(wi), self.values.shape[2]))
        for p, t in np.unique(np.stack([turn, low]), axis=1).T:
            some = (turn == p) & (low == t)
            corners = [
                (a, b, (turned[some] if a > p else 1 - turned[some]) * (share[some] if b > t else 1 - share[some]))
                for a in ((p,) if self.is_isotropic else (p, p + 1))
                for b in (t, t + 1)
            ]
            x = [np.zeros(int(some.sum())), np.zeros(int(some.sum()))]
            for a, b, weight in corners:
                for axis, position in enumerate(self.warps[a][b].invert(u_m[some], v_m[some])):
                    x[axis] += weight * position
            total[some] = sum(weight[:, None] * _fetch(self.values[a, b], x[0], x[1]) for a, b, weight in corners)
        if self.has_jacobian:
            v_i = np.full_like(theta_i, 0.5) if self.is_isotropic else (phi_i + np.pi) / (2 * np.pi)
            u_i = np.sqrt(theta_i * 2 / np.pi)
            scale = _fetch(self.ndf[None], u_m, v_m)[:, 0] / (4 * _fetch(self.sigma[None], u_i, v_i)[:, 0])
            total *= scale[:, None]
        return np.asarray(total / wo[:, 2:3])

    def _turn(self, phi_i: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the measured azimuth below each of the light, and the share of the next one."""
        middle = 0.5 * (self.phi_i[0] + self.phi_i[-1])
        return _place(middle + np.mod(phi_i - middle + np.pi, 2 * np.pi) - np.pi, self.phi_i)

    def samples(self) -> tuple[Array, Array]:
        """Return the measured direction pairs `[pair, 4]` in degrees and their values `[pair, channel]`."""
        rows, columns = self.values.shape[3:]
        x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows)))
        angles, values = [], []
        for (p, phi), (t, theta) in ((a, b) for a in enumerate(self.phi_i) for b in enumerate(self.theta_i)):
            turn = phi if self.is_isotropic else 0.0
            u, v = self.warps[p][t].sample(x, y)
            m = direction(u**2 * (np.pi / 2), (2 * v - 1) * np.pi + turn)
            wi = direction(theta, phi)
            wo = 2 * (m @ wi)[:, None] * m - wi
            up = wo[:, 2] > MIN_COS
            f = self.values[p, t].reshape(self.values.shape[2], -1).T[up] / wo[up, 2:3]
            if self.has_jacobian:
                at = (
                    np.sqrt(np.full(1, theta) * 2 / np.pi),
                    np.array([0.5 if self.is_isotropic else (phi + np.pi) / (2 * np.pi)]),
                )
                f = f * (_fetch(self.ndf[None], u[up], v[up]) / (4 * _fetch(self.sigma[None], *at)))
            pair = np.empty((int(up.sum()), 4))
            pair[:, 0], pair[:, 1] = np.degrees(theta), np.degrees(phi) % 360.0
            pair[:, 2:] = angles_deg(wo[up])
            angles.append(pair)
            values.append(f)
        return np.concatenate(angles), np.concatenate(values)


def _place(x: Array, nodes: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the node below each x, and the share of the next one, clamped beyond the ends."""
    place = np.interp(x, nodes, np.arange(len(nodes)))
    low = np.minimum(place.astype(int), len(nodes) - 2)
    return low, place - low


def _fetch(tables: Array, x: Array, y: Array) -> Array:
    """Interpolate `[channel, row, column]` bilinearly at positions in [0, 1]: `[point, channel]`."""
    rows, columns = tables.shape[1:]
    return interpolate(np.moveaxis(tables, 0, -1), (y * (rows - 1), x * (columns - 1)))


def sniff_rgl(head: FileHead) -> float:
    """Recognise the magic number."""
    return CERTAIN if head.data.startswith(MAGIC) else 0.0


def read_rgl(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the measured direction pairs.

    Raises:
        NacreError: not a BSDF tensor, or damaged.
    """
    table = RglBsdf.read(path)
    angles, values = table.samples()
    metadata = {
        "scatter": "brdf", "is_isotropic": table.is_isotropic, "theta_i_deg": np.degrees(table.theta_i),
        "phi_i_deg": np.degrees(table.phi_i), "shape": table.values.shape,
    }  # fmt: skip
    colour = "rgb" if table.wavelengths_nm is None else None
    left_out = ["samples whose exit direction lies below the surface"]
    return [measurement(path, angles, table.wavelengths_nm, values, metadata, colour=colour, left_out=left_out)]
