"""Conversion of lobes to and from other formats: grids, tables, colour bases, losses."""

from dataclasses import replace

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import is_isotropic as is_isotropic
from nacre.bsdf.lobes.orders import OrdersLobe
from nacre.bsdf.lobes.table import TableLobe
from nacre.core.arrays import Array, direction
from nacre.core.errors import UnsupportedError
from nacre.formats.export_formats import refuse_unsuitable
from nacre.formats.gonio_csv import GonioData
from nacre.formats.half_angle_tables import SHAPE
from nacre.formats.measured_lobes import ANISOTROPIC, periodic_turns, rgb_basis
from nacre.formats.zemax import ZemaxBsdf
from nacre.light import default_wavelengths, xyz_to_srgb_linear
from nacre.readers.bsdf.ray_tracers import scatter_direction
from nacre.readers.bsdf.rgl import RglBsdf

RGL_TURNS, RGL_INCIDENCES, RGL_RADIALS, RGL_AZIMUTHS, RGL_WAVELENGTHS = 24, 18, 48, 33, 48
MAX_COMPARED = 20_000


def lost_parts(bsdf: Bsdf) -> list[str]:
    lost = delta_lost(bsdf) + (["transmission and the lower side"] if bsdf.transmits else [])
    return lost + narrow_lost(bsdf)


def narrow_lost(bsdf: Bsdf) -> list[str]:
    """Return the remark on diffraction orders, whose width a grid of directions does not resolve."""
    widths = [np.degrees(lobe.width) for lobe in bsdf.lobes if isinstance(lobe, OrdersLobe)]
    return [f"orders {min(widths):.2g} degrees wide between the directions of the file's grid"] if widths else []


def delta_lost(bsdf: Bsdf) -> list[str]:
    delta = bsdf.specular(np.radians([0.0, 45.0, 80.0]))
    has = max(float(delta.reflectance.max()), float(delta.transmittance.max())) > 1e-6
    return ["the mirror-like (delta) part"] if has else []


def gonio_grid(bsdf: Bsdf, step_deg: float) -> GonioData:
    """Evaluate a Bsdf on a regular direction grid, on both sides if it transmits.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    refuse_unsuitable(bsdf, "a gonio table")
    theta = np.arange(0.0, 90.0, step_deg)
    theta_out = np.concatenate([theta, 180.0 - theta[::-1]]) if bsdf.transmits else theta
    phi_i = np.zeros(1) if is_isotropic(bsdf) else np.arange(0.0, 180.0, max(step_deg, 15.0))
    phi_o = np.arange(0.0, 360.0, step_deg)
    grids = list(np.meshgrid(theta, phi_i, theta_out, phi_o, indexing="ij"))
    grids[3] = (grids[3] + grids[1]) % 360.0  # the same azimuth differences for each light azimuth
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
        raise UnsupportedError(
            f"a Zemax {table.scatter_type} is transmitted scatter, and a measured material reflects only; "
            'a material that transmits: family = "glass"; the values: nacre read FILE -o scatter.csv'
        )
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


def rgl_lobe(table: RglBsdf) -> tuple[TableLobe, list[str]]:
    """Return the table of an anisotropic RGL measurement about the mirror direction, and remarks on its error.

    The format's samples lie elsewhere at each light azimuth; the table has common nodes: the measured
    incidences, radial angles that are dense near the mirror direction, and at most 48 of the wavelengths.
    """
    repeats = max(1, round(2 * np.pi / max(float(np.ptp(table.phi_i)), 1e-6)))
    turns = np.linspace(0.0, 1.0, min(RGL_TURNS, (len(table.phi_i) - 1) * repeats) + 1)
    some = np.unique(np.round(np.linspace(0, len(table.theta_i) - 1, min(RGL_INCIDENCES, len(table.theta_i)))))
    incidence = table.theta_i[some.astype(int)]
    radial, azimuth = 180.0 * np.linspace(0.0, 1.0, RGL_RADIALS) ** 2, np.linspace(-180.0, 180.0, RGL_AZIMUTHS)
    channel = np.arange(table.values.shape[2])
    channel = channel[:: -(-len(channel) // RGL_WAVELENGTHS)]
    part = replace(table, values=table.values[:, :, channel])
    nodes = np.meshgrid(np.degrees(incidence), radial, azimuth, indexing="ij")
    wo = scatter_direction(nodes[0], nodes[2], nodes[1])
    values = []
    for turn in 2 * np.pi * turns:
        rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
        # a light along the normal keeps the azimuth of its node
        wi = direction(np.maximum(np.radians(nodes[0]), 1e-4), np.full(nodes[0].shape, turn))
        values.append(part.evaluate(wi, wo @ rotation.T).astype(np.float32))
    if table.wavelengths_nm is None:
        wavelengths, basis = default_wavelengths(), rgb_basis(default_wavelengths())
    else:
        wavelengths = table.wavelengths_nm[channel]
        basis = np.eye(len(wavelengths))
    lobe = TableLobe(
        wavelengths, np.stack(values), basis, "specular", np.radians(nodes[0][:, 0, 0]) / (np.pi / 2), radial / 180.0,
        (azimuth + 180.0) / 360.0, True, turns,
    )  # fmt: skip
    return lobe, [f"{len(table.phi_i)} azimuths of the light: the sample is anisotropic", _table_error(lobe, part)]


def _table_error(lobe: TableLobe, table: RglBsdf) -> str:
    """Return a remark on the deviation from the measured samples, as a share of the largest of their incidence."""
    angles, values = table.samples()
    some = slice(None, None, max(1, len(angles) // MAX_COMPARED))
    angles, values = np.radians(angles[some]), values[some]
    wi, wo = direction(angles[:, 0], angles[:, 1]), direction(angles[:, 2], angles[:, 3])
    found = lobe.evaluate(wi, wo)
    if table.wavelengths_nm is None:
        values = np.maximum(values @ lobe.basis, 0.0)
    light = np.unique(np.round(angles[:, :2], 6), axis=0, return_inverse=True)[1].ravel()
    peak = np.zeros(light.max() + 1)
    np.maximum.at(peak, light, values.max(axis=1))
    off = np.abs(found - values).max(axis=1) / np.maximum(peak[light], 1e-30)
    return (
        f"at the measured directions the table differs by {100 * np.median(off):.2g} % (median) and "
        f"{100 * np.quantile(off, 0.99):.2g} % (99 of 100) of the largest value at the same incidence"
    )


def _two_nodes(axes: list[Array], values: Array) -> tuple[list[Array], Array]:
    """Duplicate single nodes of `[turn, a, b, c, channel]`, as interpolation needs two."""
    grown = []
    for i, axis in enumerate(axes):
        if len(axis) == 1:
            values = np.repeat(values, 2, axis=i + 1)
            axis = np.array([axis[0], axis[0] + 1e-3])
        grown.append(axis)
    return grown, values
