"""RGL `.bsdf` tensor files, which Mitsuba's `measured` and pbrt's measured material load.

A file holds f cos as `spectra(sample) * ndf(u_m) / (4 sigma(u_i))`, where u_m is the half vector and `sample`
its place in the warp of the visible-normal density. Any positive ndf is exact at the nodes; one that looks
like the lobe leaves `spectra` smooth between them, so it is taken from the retro-reflection of the material
(Dupuy & Jakob 2018). Reflection of the upper side only: deltas and transmission cannot be stored in this format.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.bsdf import Bsdf
from nacre.bsdf.directions import direction
from nacre.errors import NacreError, UnsupportedError
from nacre.exchange.warp import Warp
from nacre.files import atomic_path, plain, why_unreadable
from nacre.recipe.memory import check_memory

MAGIC = b"tensor_file\0"
TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "u8", 8: "i8", 9: "f2", 10: "f4", 11: "f8"}
MAX_FIELD_BYTES = 2 << 30
BYTES_A_BYTE = 3  # of a file: the file itself, and its single precision in double
NDF_FLOOR = 1e-4  # of the peak: directions where the retro-reflection is dark must stay reachable


def write_tensor(path: str | Path, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write named arrays as a tensor file, version 1.0, whole or not at all."""
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
        check_memory(BYTES_A_BYTE * float(plain(path).stat().st_size), f"{path}: read and in double precision, it")
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
    """Return the polar angle of the format's unit coordinate."""
    return np.asarray(u) ** 2 * (np.pi / 2)


def phi_of(u: Array) -> Array:
    """Return the azimuth of the format's unit coordinate."""
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
    """Tabulate the reflecting, non-delta part of a Bsdf in the format's coordinates.

    Args:
        bsdf: any Bsdf with arrays to evaluate (a stochastic lobe has none).
        is_isotropic: whether the response depends on the azimuths' difference only.
        resolution: of the sample grid, an axis.
        theta_nodes, phi_nodes: incident directions.
        wavelengths_nm: to keep; default: at most 48 of the Bsdf's own.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    _refuse(bsdf)
    own = bsdf.wavelengths_nm
    keep = np.unique(np.linspace(0, len(own) - 1, min(len(own), 48)).round().astype(int))
    grid = own[keep] if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
    theta_i = np.linspace(0.0, 1.0, theta_nodes) ** 1.0 * np.radians(89.0)
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


def _refuse(bsdf: Bsdf) -> None:
    if any(lobe.is_stochastic for lobe in bsdf.lobes):
        raise UnsupportedError('the .bsdf tensor needs arrays, not a random walk; set quality = "fast" in the recipe')
    if all(lobe.is_delta for lobe in bsdf.lobes):
        raise UnsupportedError("the .bsdf tensor cannot hold a smooth material: mirror directions are delta functions")


def write_rgl(path: str | Path, bsdf: Bsdf, description: str = "", **options: Any) -> list[str]:
    """Write a `.bsdf` file and return what of the material it cannot hold, in words.

    Raises:
        UnsupportedError: nothing of the material can be held.
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
    """Return f cos at the mirror of wi about m, `[direction, wavelength]`, zero below the horizon."""
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
    """Return sigma `[v, u]`: the integral of D <wi, m> over the half vectors."""
    u = np.linspace(0, 1, 128)
    v = np.linspace(0, 1, 65)[:-1]
    mu, mv = (a.ravel() for a in np.meshgrid(u, v, indexing="xy"))
    m = direction(theta_of(mu), phi_of(mv))
    weight = _bilinear(ndf, ndf_u, ndf_v, mu, mv) * mu * np.sin(theta_of(mu)) * 2 * np.pi**2 / (len(u) * len(v))
    wi = direction(
        np.broadcast_to(theta, (len(phi), len(theta))), np.broadcast_to(phi[:, None], (len(phi), len(theta)))
    )
    return np.maximum(np.maximum(wi @ m.T, 0.0) @ weight, 1e-12)
