"""Conversion of lobes to and from other formats: grids, tables, colour bases, losses."""

from __future__ import annotations

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.orders import OrdersLobe
from nacre.bsdf.lobes.table import TableLobe
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.formats.export_formats import refuse_unsuitable
from nacre.formats.gonio_csv import GonioData
from nacre.formats.half_angle_tables import SHAPE
from nacre.formats.measured_lobes import ANISOTROPIC, periodic_turns
from nacre.formats.measured_lobes import measured_table as gonio_table
from nacre.formats.measured_lobes import rgb_basis as rgb_basis
from nacre.formats.zemax import ZemaxBsdf
from nacre.light import default_wavelengths, xyz_to_srgb_linear

__all__ = [
    "delta_lost",
    "gonio_grid",
    "gonio_table",
    "is_isotropic",
    "lost_parts",
    "merl_lobe",
    "rgb_basis",
    "zemax_lobe",
]


def is_isotropic(bsdf: Bsdf) -> bool:
    """Whether the values are invariant under rotation about the normal, tested at a few pairs.

    The lobes of orders of a grating are too narrow for this test and are never invariant.
    """
    from nacre.bsdf.grids import direction

    if any(isinstance(lobe, OrdersLobe) for lobe in bsdf.lobes):
        return False

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
    grids = list(np.meshgrid(theta, phi_i, theta_out, phi_o, indexing="ij"))
    grids[3] = (grids[3] + grids[1]) % 360.0  # the same azimuth differences for each azimuth of the light
    data = GonioData(np.stack([g.ravel() for g in grids], axis=-1), bsdf.wavelengths_nm, np.zeros((0, 0)))
    return GonioData(data.angles_deg, bsdf.wavelengths_nm, bsdf.evaluate(data.wi, data.wo))


def merl_lobe(rgb: Array) -> TableLobe:
    """Return the table of a MERL measurement; its nodes are the bins' centres, periodic in phi_diff."""
    wavelengths = default_wavelengths()
    half, diff, phi = ((np.arange(n) + 0.5) / n for n in SHAPE)
    phi = np.concatenate([[phi[-1] - 1.0], phi, [phi[0] + 1.0]])
    values = np.concatenate([rgb[:, :, -1:], rgb, rgb[:, :, :1]], axis=2)
    return TableLobe(wavelengths, values, rgb_basis(wavelengths), "half", half, diff, phi)


def zemax_lobe(table: ZemaxBsdf) -> TableLobe:
    """Return a reflection table on the file's own nodes about the mirror direction.

    XYZ is converted to smooth spectra, monochrome to constant ones.

    Raises:
        UnsupportedError: the table has transmitted scatter.
    """
    if table.scatter_type != "BRDF":
        raise UnsupportedError(f"a Zemax {table.scatter_type} is not imported; only BRDF is")
    values, turn = table.values[:, None], None
    if table.rotated is not None:
        spread = np.ptp(table.rotated, axis=1).max() / max(float(table.rotated.max()), 1e-30)
        values = table.rotated
        if spread > ANISOTROPIC:
            turn, which, _ = periodic_turns(table.rotation_deg)
            values = values[:, which]
        else:
            values = values.mean(axis=1, keepdims=True)
    values = np.moveaxis(values, (0, 1, 2, 3, 4), (4, 0, 1, 3, 2))
    azimuth, is_signed = table.azimuth_deg, not table.is_plane_symmetrical
    if is_signed:
        turned = (azimuth + 180.0) % 360.0 - 180.0
        turned[turned == -180.0] = 180.0
        azimuth, first = np.unique(turned, return_index=True)
        values = values[..., first, :]
        values = np.concatenate([values[..., -1:, :], values, values[..., :1, :]], axis=3)
        azimuth = np.concatenate([azimuth[-1:] - 360.0, azimuth, azimuth[:1] + 360.0])
    c = (azimuth + 180.0) / 360.0 if is_signed else azimuth / 180.0
    nodes, values = _two_nodes([table.incidence_deg / 90.0, table.radial_deg / 180.0, c], values)
    wavelengths = default_wavelengths()
    values = values[0] if turn is None else values
    is_grey = values.shape[-1] == 1
    return TableLobe(
        wavelengths, values if is_grey else np.asarray(xyz_to_srgb_linear(values)),
        np.ones((1, len(wavelengths))) if is_grey else rgb_basis(wavelengths), "specular",
        nodes[0], nodes[1], nodes[2], is_signed, turn,
    )  # fmt: skip


def _two_nodes(axes: list[Array], values: Array) -> tuple[list[Array], Array]:
    """Duplicate single nodes of `[turn, a, b, c, channel]`, as interpolation needs two."""
    grown = []
    for i, axis in enumerate(axes):
        if len(axis) == 1:
            values = np.repeat(values, 2, axis=i + 1)
            axis = np.array([axis[0], axis[0] + 1e-3])
        grown.append(axis)
    return grown, values
