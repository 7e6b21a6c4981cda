"""RGL tensor files (`.bsdf`) of Mitsuba's `measured` and pbrt: writing, reading, evaluation, and their sampling warp.

The warp maps the unit square to a bilinear density: the row follows the marginal, the column the conditional
distribution, both inverted exactly (Dupuy & Jakob 2018, supplement).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.grids import direction, interpolate
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.core.memory import check_memory
from nacre.formats.export_formats import refuse_unsuitable

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
        whole = marginal[-1]
        scale = (rows - 1) * (columns - 1) / whole
        return cls(density * scale, conditional / whole, marginal / whole)

    def sample(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Map uniform (x, y) in [0, 1]^2 to a position; x runs along columns, y along rows."""
        rows, columns = self.density.shape
        x, y = np.clip(x, 0.0, 1 - 1e-12), np.clip(y, 0.0, 1 - 1e-12)
        row = np.clip(np.searchsorted(self.marginal, y, side="right") - 1, 0, rows - 2)
        totals = self.conditional[:, -1]
        v = _solve(totals[row], totals[row + 1], y - self.marginal[row])
        blended = (1 - v)[:, None] * self.conditional[row] + v[:, None] * self.conditional[row + 1]
        target = x * blended[:, -1]
        column = np.clip((blended <= target[:, None]).sum(axis=1) - 1, 0, columns - 2)
        everyone = np.arange(len(x))
        left = ((1 - v) * self.density[row, column] + v * self.density[row + 1, column]) * self._unit
        right = ((1 - v) * self.density[row, column + 1] + v * self.density[row + 1, column + 1]) * self._unit
        u = _solve(left, right, target - blended[everyone, column])
        return (column + u) / (columns - 1), (row + v) / (rows - 1)

    def invert(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Map a position back to the uniform (x, y) that `sample` takes there."""
        rows, columns = self.density.shape
        cu, cv = np.clip(u, 0.0, 1.0) * (columns - 1), np.clip(v, 0.0, 1.0) * (rows - 1)
        column, row = np.minimum(cu.astype(int), columns - 2), np.minimum(cv.astype(int), rows - 2)
        fu, fv = cu - column, cv - row
        totals = self.conditional[:, -1]
        y = self.marginal[row] + fv * (totals[row] + 0.5 * fv * (totals[row + 1] - totals[row]))
        left = ((1 - fv) * self.density[row, column] + fv * self.density[row + 1, column]) * self._unit
        right = ((1 - fv) * self.density[row, column + 1] + fv * self.density[row + 1, column + 1]) * self._unit
        below = (1 - fv) * self.conditional[row, column] + fv * self.conditional[row + 1, column]
        whole = (1 - fv) * totals[row] + fv * totals[row + 1]
        x = (below + fu * (left + 0.5 * fu * (right - left))) / np.maximum(whole, 1e-300)
        return np.clip(x, 0.0, 1.0), np.clip(y, 0.0, 1.0)

    @property
    def _unit(self) -> float:
        """Scale from density to running integrals."""
        rows, columns = self.density.shape
        return 1.0 / ((rows - 1) * (columns - 1))


def _solve(start: Array, end: Array, area: Array) -> Array:
    """Return t in [0, 1] such that the integral of a linear ramp over [0, t] equals `area`."""
    flat = np.abs(start - end) < FLAT * (start + end)
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = 2 * area / (start + end)
        ramp = (start - np.sqrt(np.maximum(start**2 - 2 * area * (start - end), 0.0))) / (start - end)
    return np.clip(np.nan_to_num(np.where(flat, straight, ramp)), 0.0, 1.0)


# RGL `.bsdf` tensor files, which Mitsuba's `measured` and pbrt's measured material load.

MAGIC = b"tensor_file\0"
TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "u8", 8: "i8", 9: "f2", 10: "f4", 11: "f8"}
MAX_FIELD_BYTES = 2 << 30
MEMORY_FACTOR = 3  # memory per byte of a file: the file and its arrays in double precision
NDF_FLOOR = 1e-4  # relative to the peak; dark directions must remain sampled


def write_tensor(path: str | Path, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write named arrays as a tensor file, version 1.0, atomically."""
    codes = {np.dtype(text): code for code, text in TYPES.items()}
    arrays = {name: np.ascontiguousarray(value) for name, value in fields.items()}
    header = MAGIC + struct.pack("<BBI", 1, 0, len(arrays))
    size = len(header) + sum(2 + len(n.encode()) + 2 + 1 + 8 + 8 * a.ndim for n, a in arrays.items())
    parts, offset = [header], size
    for name, array in arrays.items():
        offset = -(-offset // 8) * 8
        label = name.encode()
        parts.append(struct.pack("<H", len(label)) + label)
        parts.append(struct.pack("<HBQ", array.ndim, codes[array.dtype], offset))
        parts.append(struct.pack(f"<{array.ndim}Q", *array.shape))
        offset += array.nbytes
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(b"".join(parts))
        for array in arrays.values():
            file.write(b"\0" * (-file.tell() % 8))
            file.write(array.tobytes())


def read_tensor(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read a tensor file into named arrays.

    Raises:
        NacreError: not a tensor file, damaged, or too large.
    """
    path = Path(path)
    try:
        check_memory(MEMORY_FACTOR * float(plain(path).stat().st_size), f"{path}: read and in double precision, it")
        data = path.read_bytes()
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
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
    found: dict[str, NDArray[Any]] = {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, position)
        name = data[position + 2 : position + 2 + length].decode()
        position += 2 + length
        rank, code, offset = struct.unpack_from("<HBQ", data, position)
        position += 11
        shape = struct.unpack_from(f"<{rank}Q", data, position)
        position += 8 * rank
        dtype = np.dtype("<" + TYPES[code])
        number = 1
        for extent in shape:
            number *= extent
        if number * dtype.itemsize > MAX_FIELD_BYTES:
            raise ValueError("field too large")
        found[name] = np.frombuffer(data, dtype, number, offset).reshape(shape)
    return found


def theta_of(u: Array) -> Array:
    """Return the polar angle for a unit coordinate."""
    return np.asarray(u) ** 2 * (np.pi / 2)


def phi_of(u: Array) -> Array:
    """Return the azimuth for a unit coordinate."""
    return (2 * np.asarray(u) - 1) * np.pi


def rgl_fields(
    bsdf: Bsdf,
    description: str = "",
    *,
    is_isotropic: bool = True,
    resolution: int = 64,
    theta_nodes: int = 24,
    phi_nodes: int = 16,
    wavelengths_nm: Array | None = None,
) -> dict[str, NDArray[Any]]:
    """Tabulate the reflected, non-delta part of a Bsdf in the format's coordinates.

    Args:
        bsdf: without stochastic lobes.
        is_isotropic: whether the response depends on the azimuths' difference only.
        resolution: nodes along each axis of the sample grid.
        theta_nodes, phi_nodes: incident directions.
        wavelengths_nm: default: at most 48 of the Bsdf's own.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    refuse_unsuitable(bsdf, "the .bsdf tensor")
    own = bsdf.wavelengths_nm
    keep = np.unique(np.linspace(0, len(own) - 1, min(len(own), 48)).round().astype(int))
    grid = own[keep] if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
    theta_i = np.linspace(0.0, 1.0, theta_nodes) * np.radians(89.0)
    phi_i = np.zeros(1) if is_isotropic else np.linspace(-np.pi, np.pi, phi_nodes)
    ndf_u = np.linspace(0.0, 1.0, 128)
    ndf_v = np.linspace(0.0, 1.0, 2 if is_isotropic else 64)
    ndf = _retro_ndf(bsdf, ndf_u, ndf_v, is_isotropic)
    sigma = _projected_area(ndf, ndf_u, ndf_v, theta_of(ndf_u), phi_of(ndf_v))
    vndf_rows, vndf_columns = 96, 128
    u = np.linspace(0, 1, vndf_columns)
    v = np.linspace(0, 1, vndf_rows)
    vndf = np.zeros((len(phi_i), theta_nodes, vndf_rows, vndf_columns), np.float32)
    spectra = np.zeros((len(phi_i), theta_nodes, len(grid), resolution, resolution), np.float32)
    luminance = np.zeros((len(phi_i), theta_nodes, resolution, resolution), np.float32)
    s = np.linspace(0, 1, resolution)
    sx, sy = (a.ravel() for a in np.meshgrid(s, s, indexing="xy"))
    for p, phi in enumerate(phi_i):
        for t, theta in enumerate(theta_i):
            wi = direction(np.array(theta), np.array(phi))
            turn = phi if is_isotropic else 0.0
            density = _visible(ndf, ndf_u, ndf_v, u, v, wi, turn)
            warp = Warp.of(density)
            vndf[p, t] = warp.density
            mu, mv = warp.sample(sx, sy)
            values = _f_cos(bsdf, grid, wi, direction(theta_of(mu), phi_of(mv) + turn))
            slope = _bilinear(ndf, ndf_u, ndf_v, mu, mv)
            area = _bilinear(sigma, ndf_u, ndf_v, np.sqrt(theta * 2 / np.pi), (phi + np.pi) / (2 * np.pi))
            table = values * (4 * area / slope)[:, None]
            spectra[p, t] = np.moveaxis(table.reshape(resolution, resolution, -1), -1, 0)
            luminance[p, t] = np.maximum(table.mean(axis=1), 1e-12).reshape(resolution, resolution)
    return {
        "description": np.frombuffer((description or "nacre").encode(), np.uint8),
        "theta_i": theta_i.astype(np.float32), "phi_i": phi_i.astype(np.float32),
        "ndf": ndf.astype(np.float32), "sigma": sigma.astype(np.float32), "vndf": vndf,
        "luminance": luminance, "spectra": spectra, "wavelengths": grid.astype(np.float32),
        "jacobian": np.array([1], np.uint8),
    }  # fmt: skip


def write_rgl(path: str | Path, bsdf: Bsdf, description: str = "", **options: Any) -> list[str]:
    """Write a `.bsdf` file and return the properties that it cannot store.

    Raises:
        UnsupportedError: the format cannot store the material.
        NacreError: the file cannot be written.
    """
    write_tensor(path, rgl_fields(bsdf, description, **options))
    lost = []
    if bsdf.transmits:
        lost.append("transmission and the lower side are left out")
    if np.any(bsdf.specular(np.radians([0.0, 45.0, 80.0])).reflectance > 1e-6):
        lost.append("the mirror-like (delta) part is left out")
    return lost


def _f_cos(bsdf: Bsdf, grid: Array, wi: Array, m: Array) -> Array:
    """Return f cos for the reflection of wi at m, `[direction, wavelength]`, zero below the horizon."""
    wo = 2 * (m @ wi)[:, None] * m - wi
    up = wo[:, 2] > 1e-6
    values = np.zeros((len(m), len(grid)))
    if np.any(up):
        f = bsdf.evaluate(np.broadcast_to(wi, wo[up].shape), wo[up])
        own = bsdf.wavelengths_nm
        if not np.array_equal(own, grid):
            index = np.clip(np.searchsorted(own, grid), 1, len(own) - 1)
            share = (grid - own[index - 1]) / (own[index] - own[index - 1])
            f = f[:, index - 1] * (1 - share) + f[:, index] * share
        values[up] = f * wo[up, 2:3]
    return values


def _retro_ndf(bsdf: Bsdf, u: Array, v: Array, is_isotropic: bool) -> Array:
    """Estimate a normal distribution `[v, u]` from the retro-reflection, f(m, m) ~ D(m) / (4 cos^2)."""
    theta = np.minimum(theta_of(u), np.radians(85.0))
    phi = np.zeros(1) if is_isotropic else phi_of(v)
    m = direction(theta[None, :], phi[:, None])
    value = bsdf.evaluate(m, m).mean(axis=-1) * 4 * m[..., 2] ** 2
    value = np.maximum(value, NDF_FLOOR * max(float(value.max()), 1e-12))
    return np.broadcast_to(value, (len(v), len(u))).copy()


def _bilinear(table: Array, u: Array, v: Array, at_u: Array | float, at_v: Array | float) -> Array:
    x = np.clip(np.asarray(at_u) * (len(u) - 1), 0, len(u) - 1 - 1e-9)
    y = np.clip((np.asarray(at_v) % 1.0 if len(v) > 2 else np.asarray(at_v)) * (len(v) - 1), 0, len(v) - 1 - 1e-9)
    i, j = x.astype(int), y.astype(int)
    fx, fy = x - i, y - j
    low = table[j, i] * (1 - fx) + table[j, i + 1] * fx
    high = table[j + 1, i] * (1 - fx) + table[j + 1, i + 1] * fx
    return np.asarray(low * (1 - fy) + high * fy)


def _visible(ndf: Array, ndf_u: Array, ndf_v: Array, u: Array, v: Array, wi: Array, turn: float) -> Array:
    """Return D <wi, m> times the format's Jacobian on the grid `[v, u]`, positive everywhere."""
    mu, mv = np.meshgrid(u, v, indexing="xy")
    theta = theta_of(mu)
    m = direction(theta, phi_of(mv) + turn)
    density = _bilinear(ndf, ndf_u, ndf_v, mu, mv) * np.maximum(m @ wi, 0.0) * mu * np.sin(theta)
    return np.asarray(density + 1e-7 * density.max())


def _projected_area(ndf: Array, ndf_u: Array, ndf_v: Array, theta: Array, phi: Array) -> Array:
    """Return sigma `[v, u]`: the integral of D <wi, m> over half vectors."""
    u = np.linspace(0, 1, 128)
    v = np.linspace(0, 1, 65)[:-1]
    mu, mv = (a.ravel() for a in np.meshgrid(u, v, indexing="xy"))
    m = direction(theta_of(mu), phi_of(mv))
    weight = _bilinear(ndf, ndf_u, ndf_v, mu, mv) * mu * np.sin(theta_of(mu)) * 2 * np.pi**2 / (len(u) * len(v))
    wi = direction(
        np.broadcast_to(theta, (len(phi), len(theta))), np.broadcast_to(phi[:, None], (len(phi), len(theta)))
    )
    return np.maximum(np.maximum(wi @ m.T, 0.0) @ weight, 1e-12)


# Evaluation of RGL `.bsdf` tensors, as in renderers.

NEEDED = ("theta_i", "phi_i", "ndf", "sigma", "vndf", "spectra", "wavelengths", "jacobian")
MAX_VALUE = 1e12  # larger values occur in damaged files only

SMALLEST = 1e-12


@dataclass(frozen=True)
class RglBsdf:
    """An isotropic measurement in RGL's parameterisation.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        theta_i: `[incidence]`, radians.
        ndf, sigma: `[v, u]`.
        warps: one visible-normal warp an incidence.
        spectra: `[incidence, wavelength, row, column]`.
        has_jacobian: whether `spectra` is to be multiplied by ndf/(4 sigma).
    """

    wavelengths_nm: Array
    theta_i: Array
    ndf: Array
    sigma: Array
    warps: tuple[Warp, ...]
    spectra: Array
    has_jacobian: bool

    @classmethod
    def read(cls, path: str | Path) -> RglBsdf:
        """Read an isotropic tensor file.

        Raises:
            NacreError: fields are missing or do not fit, or the material is anisotropic.
        """
        fields = read_tensor(path)
        missing = [name for name in NEEDED if name not in fields]
        if missing:
            raise NacreError(f"{path}: the tensor file has no field {missing[0]}; it is not a BSDF")
        if len(fields["phi_i"]) > 2:
            raise NacreError(f"{path}: is anisotropic; only isotropic tensor files are imported")
        try:
            with np.errstate(invalid="ignore"):  # a signalling NaN warns when it is read; _from refuses it
                return cls._from(fields)
        except (ValueError, IndexError):
            raise NacreError(f"{path}: the fields of the tensor file do not fit together or are impossible") from None

    @classmethod
    def _from(cls, fields: dict[str, NDArray[Any]]) -> RglBsdf:
        theta, spectra = np.asarray(fields["theta_i"], float), np.asarray(fields["spectra"], float)
        vndf = np.asarray(fields["vndf"], float)
        waves = np.asarray(fields["wavelengths"], float)
        if spectra.ndim != 5 or vndf.ndim != 4 or spectra.shape[1:3] != (len(theta), len(waves)):
            raise ValueError("shapes")
        if vndf.shape[1] != len(theta) or fields["ndf"].ndim != 2 or fields["sigma"].ndim != 2 or len(theta) < 2:
            raise ValueError("shapes")
        arrays = (theta, spectra, vndf, waves, fields["ndf"], fields["sigma"])
        if not all(np.isfinite(a).all() and np.max(np.abs(a), initial=0.0) < MAX_VALUE for a in arrays):
            raise ValueError("values")
        if min(*vndf.shape[2:], *spectra.shape[3:], *fields["ndf"].shape, *fields["sigma"].shape) < 2:
            raise ValueError("nodes")
        if np.any(np.maximum(vndf, 0.0).max(axis=(2, 3)) < SMALLEST) or np.any(np.asarray(fields["sigma"]) < SMALLEST):
            raise ValueError("nothing to divide by")
        if np.any(np.diff(theta) <= 0) or len(waves) < 1 or waves[0] <= 0 or np.any(np.diff(waves) <= 0):
            raise ValueError("axes")
        warps = tuple(Warp.of(np.maximum(table, 0.0)) for table in vndf[0])
        ndf, sigma = np.asarray(fields["ndf"], float), np.asarray(fields["sigma"], float)
        return cls(waves, theta, ndf, sigma, warps, spectra[0], bool(fields["jacobian"][0]))

    def evaluate(self, wi: Array, wo: Array) -> Array:
        """Return f (without the cosine), `[..., wavelength]`, zero below the horizon."""
        shape = np.broadcast_shapes(wi.shape, wo.shape)
        wi, wo = (np.broadcast_to(w, shape).reshape(-1, 3) for w in (wi, wo))
        up = (wi[:, 2] > 1e-4) & (wo[:, 2] > 1e-4)
        values = np.zeros((len(wi), len(self.wavelengths_nm)))
        values[up] = self._above(wi[up], wo[up])
        return values.reshape(*shape[:-1], -1)

    def _above(self, wi: Array, wo: Array) -> Array:
        m = wi + wo
        m /= np.linalg.norm(m, axis=-1, keepdims=True)
        theta_i, theta_m = np.arccos(np.clip(wi[:, 2], -1, 1)), np.arccos(np.clip(m[:, 2], -1, 1))
        phi_i, phi_m = np.arctan2(wi[:, 1], wi[:, 0]), np.arctan2(m[:, 1], m[:, 0])
        u_m = np.sqrt(theta_m * 2 / np.pi)
        v_m = np.mod((phi_m - phi_i + np.pi) / (2 * np.pi), 1.0)
        place = np.clip(np.interp(theta_i, self.theta_i, np.arange(len(self.theta_i))), 0, len(self.theta_i) - 1)
        low = np.minimum(place.astype(int), len(self.theta_i) - 2)
        share = place - low
        total = np.zeros((len(wi), len(self.wavelengths_nm)))
        for node in np.unique(low):
            some = low == node
            x = _mix(
                self.warps[node].invert(u_m[some], v_m[some]),
                self.warps[node + 1].invert(u_m[some], v_m[some]),
                share[some],
            )
            here, there = (_fetch(self.spectra[n], *x) for n in (node, node + 1))
            total[some] = here * (1 - share[some])[:, None] + there * share[some][:, None]
        if self.has_jacobian:
            u_i, v_i = np.sqrt(theta_i * 2 / np.pi), np.full_like(theta_i, 0.5)
            scale = _fetch(self.ndf[None], u_m, v_m)[:, 0] / (4 * _fetch(self.sigma[None], u_i, v_i)[:, 0])
            total *= scale[:, None]
        return np.asarray(total / wo[:, 2:3])


def _mix(a: tuple[Array, Array], b: tuple[Array, Array], share: Array) -> tuple[Array, Array]:
    return a[0] * (1 - share) + b[0] * share, a[1] * (1 - share) + b[1] * share


def _fetch(tables: Array, x: Array, y: Array) -> Array:
    """Interpolate `[channel, row, column]` bilinearly at positions in [0, 1]: `[point, channel]`."""
    rows, columns = tables.shape[1:]
    return interpolate(np.moveaxis(tables, 0, -1), (y * (rows - 1), x * (columns - 1)))
