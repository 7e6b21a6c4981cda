"""RGL tensor files (`.bsdf`) of Mitsuba's `measured` and pbrt: writing; `nacre.readers.bsdf.rgl` reads them."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.core.arrays import Array, direction
from nacre.core.files import atomic_path
from nacre.formats.export_formats import refuse_unsuitable
from nacre.formats.lobes import narrow_lost
from nacre.readers.bsdf.rgl import MAGIC, TYPES, Warp
from nacre.readers.bsdf.rgl import RglBsdf as RglBsdf
from nacre.readers.bsdf.rgl import read_tensor as read_tensor

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
    return lost + narrow_lost(bsdf)


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
