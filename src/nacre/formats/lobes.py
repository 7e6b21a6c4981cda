"""Conversion of lobes to and from other formats: grids, tables, colour bases, losses."""

from __future__ import annotations

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.grids import take_uniform
from nacre.bsdf.lobes.table import TableLobe, directions_of
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.formats.export_formats import refuse_unsuitable
from nacre.formats.gonio_csv import GonioData
from nacre.formats.half_angle_tables import SHAPE
from nacre.formats.zemax import ZemaxBsdf
from nacre.light import default_wavelengths, spectrum_to_rgb_matrix

TABLE_NODES = (46, 46, 37)  # theta_i, theta_o, dphi for scattered measurements


def is_isotropic(bsdf: Bsdf) -> bool:
    """Whether the values are invariant under rotation about the normal, tested at a few pairs."""
    from nacre.bsdf.grids import direction

    theta_i, theta_o, dphi = (np.radians(v) for v in ([20.0, 50.0, 70.0], [35.0, 45.0, 60.0], [180.0, 150.0, 90.0]))
    values = [
        bsdf.evaluate(direction(theta_i, turn), direction(theta_o, dphi + turn)) for turn in np.radians([0, 31, 77, 90])
    ]
    scale = max(float(np.max(values)), 1e-30)
    return bool(np.ptp(np.stack(values), axis=0).max() <= 1e-4 * scale)


def lost_parts(bsdf: Bsdf) -> list[str]:
    return delta_lost(bsdf) + (["transmission and the lower side"] if bsdf.transmits else [])


def delta_lost(bsdf: Bsdf) -> list[str]:
    delta = bsdf.specular(np.radians([0.0, 45.0, 80.0]))
    has = max(float(delta.reflectance.max()), float(delta.transmittance.max())) > 1e-6
    return ["the mirror-like (delta) part"] if has else []


def gonio_grid(bsdf: Bsdf, step_deg: float) -> GonioData:
    """Evaluate a Bsdf on a regular grid of directions, on both sides if it transmits.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    refuse_unsuitable(bsdf, "a gonio table")
    theta = np.arange(0.0, 90.0, step_deg)
    theta_out = np.concatenate([theta, 180.0 - theta[::-1]]) if bsdf.transmits else theta
    phi_i = np.zeros(1) if is_isotropic(bsdf) else np.arange(0.0, 180.0, max(step_deg, 15.0))
    phi_o = np.arange(0.0, 360.0, step_deg)
    grids = np.meshgrid(theta, phi_i, theta_out, phi_o, indexing="ij")
    data = GonioData(np.stack([g.ravel() for g in grids], axis=-1), bsdf.wavelengths_nm, np.zeros((0, 0)))
    return GonioData(data.angles_deg, bsdf.wavelengths_nm, bsdf.evaluate(data.wi, data.wo))


def rgb_basis(wavelengths_nm: Array) -> Array:
    """Return the three smoothest spectra with linear sRGB colours (1,0,0), (0,1,0), (0,0,1) under D65.

    They minimise the summed squared first differences and are therefore flat outside the visible range (with second
    differences the spectrum of gold reached 1.26 at 830 nm). They sum to one; the evaluation of a table clips negative
    values.
    """
    matrix = np.asarray(spectrum_to_rgb_matrix(wavelengths_nm))
    matrix = matrix if matrix.shape[0] == 3 else matrix.T
    count = len(wavelengths_nm)
    first = np.diff(np.eye(count), 1, axis=0)
    stiffness = first.T @ first + 1e-9 * np.eye(count)  # regularises the constant spectrum
    inverse = np.linalg.inv(stiffness)
    return np.asarray((inverse @ matrix.T @ np.linalg.inv(matrix @ inverse @ matrix.T)).T)


def merl_lobe(rgb: Array) -> TableLobe:
    """Return the table of a MERL measurement; bins are samples at their centres."""
    wavelengths = default_wavelengths()
    half, diff, phi = (np.linspace(0, 1, n) for n in SHAPE)
    values = rgb
    for axis, nodes in enumerate((half, diff, phi)):
        n = SHAPE[axis]
        place = np.clip(nodes * n - 0.5, 0, n - 1)
        values = take_uniform(values, place / (n - 1), axis)
    return TableLobe(wavelengths, values, rgb_basis(wavelengths), "half")


def gonio_table(data: GonioData, name: str) -> tuple[TableLobe, list[str]]:
    """Return the table of a measurement, and remarks.

    Regular grids are interpolated linearly in theta_i, theta_o and |dphi|; scattered points by nearest neighbours with
    inverse-square distance weights.

    Raises:
        NacreError: fewer than four pairs lie above the surface.
    """
    theta_i, phi_i, theta_o, phi_o = data.angles_deg.T
    up = (theta_i < 90) & (theta_o < 90)
    remarks = [] if np.all(up) else [f"{int(np.sum(~up))} pairs of the other side were left out"]
    if np.sum(up) < 4:
        raise NacreError(f"{name}: holds {int(np.sum(up))} direction pairs above the surface; at least 4 are needed")
    dphi = np.abs((phi_o - phi_i + 180.0) % 360.0 - 180.0)
    points = np.stack([theta_i, theta_o, dphi], axis=-1)[up]
    axes = [np.unique(np.round(points[:, i], 6)) for i in range(3)]
    values = data.values[up]
    grid = [np.linspace(0, limit, n) for limit, n in zip((90.0, 90.0, 180.0), TABLE_NODES, strict=True)]
    if np.prod([len(a) for a in axes]) <= len(points) and min(len(a) for a in axes) > 1:
        table = _regular(points, axes, values, grid)
    else:
        remarks.append("the directions form no grid; values between them are interpolated from nearest neighbours")
        table = _scattered(points, values, grid)
    return TableLobe(data.wavelengths_nm, table, np.eye(values.shape[1])), remarks


def _regular(points: Array, axes: list[Array], values: Array, grid: list[Array]) -> Array:
    from scipy.interpolate import RegularGridInterpolator

    total = np.zeros((*(len(a) for a in axes), values.shape[1]))
    count = np.zeros(total.shape[:3])
    place = tuple(np.searchsorted(a, np.round(points[:, i], 6)) for i, a in enumerate(axes))
    np.add.at(total, place, values)  # average mirror-symmetric pairs
    np.add.at(count, place, 1)
    interpolate = RegularGridInterpolator(axes, total / np.maximum(count, 1)[..., None])
    inside = [np.clip(g, a[0], a[-1]) for g, a in zip(grid, axes, strict=True)]
    return np.asarray(interpolate(np.stack(np.meshgrid(*inside, indexing="ij"), axis=-1)))


def _scattered(points: Array, values: Array, grid: list[Array]) -> Array:
    from scipy.spatial import cKDTree

    nodes = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    found = cKDTree(points).query(nodes, k=min(8, len(points)))
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    weight = 1.0 / (distance**2 + 1e-6)
    weight = weight / weight.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nk,nkw->nw", weight, values[index]).reshape(*(len(g) for g in grid), -1))


ZEMAX_NODES = (46, 91, 37)


def zemax_lobe(table: ZemaxBsdf) -> TableLobe:
    """Resample a reflection table; XYZ is converted to smooth spectra, monochrome to constant ones.

    Raises:
        UnsupportedError: the table has transmitted scatter.
    """
    if table.scatter_type != "BRDF":
        raise UnsupportedError(f"a Zemax {table.scatter_type} is not imported; only BRDF is")
    from scipy.interpolate import RegularGridInterpolator

    wi, wo = directions_of("direction", ZEMAX_NODES)
    theta = np.arccos(np.clip(wi[..., 2], -1, 1))
    specular = np.stack([-np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    to_normal = np.stack([np.cos(theta), np.zeros_like(theta), np.sin(theta)], axis=-1)
    radial = np.degrees(np.arccos(np.clip(np.sum(specular * wo, axis=-1), -1, 1)))
    azimuth = np.degrees(np.abs(np.arctan2(wo[..., 1], np.sum(to_normal * wo, axis=-1))))
    axes = (table.incidence_deg, table.azimuth_deg, table.radial_deg)
    points = np.stack([np.degrees(theta), azimuth, radial], axis=-1)
    clipped = np.stack([np.clip(points[..., i], a[0], a[-1]) for i, a in enumerate(axes)], axis=-1)
    grown, known = _with_slope(axes, np.moveaxis(table.values, 0, -1))
    values = np.asarray(RegularGridInterpolator(grown, known)(clipped))
    wavelengths = default_wavelengths()
    if values.shape[-1] == 1:
        return TableLobe(wavelengths, values, np.ones((1, len(wavelengths))))
    from nacre.light import xyz_to_srgb_linear

    return TableLobe(wavelengths, np.asarray(xyz_to_srgb_linear(values)), rgb_basis(wavelengths))


def _with_slope(axes: tuple[Array, ...], values: Array) -> tuple[tuple[Array, ...], Array]:
    """Duplicate single-node axes, as interpolation needs two nodes."""
    grown, table = [], values
    for i, axis in enumerate(axes):
        if len(axis) == 1:
            table = np.repeat(table, 2, axis=i)
            axis = np.array([axis[0], axis[0] + 1e-6])
        grown.append(axis)
    return tuple(grown), table
