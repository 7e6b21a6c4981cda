"""BSDFs as tables of other programs: requirements of an export, MERL, Zemax and RGL files, and lobes of them.

Three int32 sizes (90, 90, 180), then three planes of float64: red, green, blue, scaled by 1/1500, 1.15/1500 and
1.66/1500. Bins are uniform in the square root of theta_half, in theta_diff and in phi_diff (mod pi, by reciprocity).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import is_isotropic as is_isotropic
from nacre.bsdf.lobes.orders import narrowest_nm, order_lobes
from nacre.bsdf.lobes.table import TableLobe, from_half_difference
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, reraise_as_oserror
from nacre.formats.measured_lobes import ANISOTROPIC, GonioData, periodic_turns, rgb_basis
from nacre.light import default_wavelengths, spectrum_to_rgb_linear, spectrum_to_xyz, xyz_to_srgb_linear
from nacre.readers.bsdf import databases
from nacre.readers.bsdf.databases import SHAPE, RglBsdf, Warp
from nacre.readers.bsdf.ray_tracers import CHANNELS, ZemaxBsdf, scatter_direction

SPECTRAL = ("rgl", "csv", "astm", "brdf-json", "speos", "exr")  # formats with samples over wavelength
MIN_COS = 1e-4  # bins below the horizon are 0
PAIRS_AT_ONCE = 1 << 16


Colours = Callable[[Array, Array], Array]  # XYZ under D65 of direction pairs, finer over wavelength than the Bsdf


def merl_table(bsdf: Bsdf, colours: Colours | None) -> Array:
    """Return the linear sRGB reflectance (white under D65 is 1, 1, 1) in MERL's bins, `[half, diff, phi, 3]`.

    Args:
        colours: for narrow orders.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    refuse_unsuitable(bsdf, "a MERL file")
    wi, wo = (a.reshape(-1, 3) for a in from_half_difference(*databases.bin_angles()))
    up = np.flatnonzero((wi[:, 2] > MIN_COS) & (wo[:, 2] > MIN_COS))
    table = np.zeros((len(wi), 3))
    for start in range(0, len(up), PAIRS_AT_ONCE):
        some = up[start : start + PAIRS_AT_ONCE]
        if colours is not None:
            table[some] = xyz_to_srgb_linear(colours(wi[some], wo[some]))
        else:
            table[some] = spectrum_to_rgb_linear(bsdf.evaluate(wi[some], wo[some]), bsdf.wavelengths_nm)
    return table.reshape(*SHAPE, 3)


def write_merl(path: str | Path, table: Array) -> None:
    """Write linear RGB reflectance `[90, 90, 180, 3]` as a MERL file.

    Raises:
        NacreError: the file cannot be written.
    """
    planes = np.moveaxis(np.asarray(table, dtype=float), -1, 0) / databases.SCALE[:, None, None, None]
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(np.array(SHAPE, "<i4").tobytes())
        file.write(planes.astype("<f8").tobytes())


def read_merl_filled(path: str | Path) -> tuple[Array, list[str]]:
    """Read a MERL file as linear RGB reflectance `[90, 90, 180, 3]`, and remarks.

    Invalid bins above the surface take the value of the nearest valid bin; bins below it become 0. Negative channels
    are kept: the sum of the channels' spectra is cut at 0 when the material is evaluated.

    Raises:
        NacreError: not a MERL file, damaged, or without valid bins.
    """
    table = databases.read_raw(path)
    remarks = databases.bin_remarks(table)
    up, invalid = databases.is_up(), np.isnan(table).any(axis=-1)
    if not np.any(up & ~invalid):
        raise NacreError(f"{path}: holds no valid bin above the surface")
    if np.any(invalid & up):
        from scipy.ndimage import distance_transform_edt

        nearest = distance_transform_edt(invalid | ~up, return_distances=False, return_indices=True)
        table = table[tuple(nearest)]
        remarks[0] += "; they take the value of the nearest valid bin"
    return np.where((up | ~invalid)[..., None], table, 0.0), remarks


# BRDF image slice as EXR: theta_half across, theta_diff down, phi_diff = 90 degrees (Burley 2012).

SIZE = 90


def _slice_pairs(size: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the directions of the slice's pixels, and whether they lie above the surface."""
    angle = (np.arange(size) + 0.5) / size * (np.pi / 2)
    half, diff = np.meshgrid(angle, angle)
    wi, wo = from_half_difference(half, diff, np.full_like(half, np.pi / 2))
    return wi, wo, (wi[..., 2] > 0) & (wo[..., 2] > 0)


def slice_values(bsdf: Bsdf, size: int = SIZE) -> Array:
    """Return f over (theta_diff, theta_half), `[size, size, wavelength]`, theta_half by column, at cell centres.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    refuse_unsuitable(bsdf, "an EXR slice")
    wi, wo, up = _slice_pairs(size)
    values = np.zeros((size, size, len(bsdf.wavelengths_nm)))
    values[up] = bsdf.evaluate(wi[up], wo[up])
    return values


def write_slice(path: str | Path, bsdf: Bsdf, comment: str = "", colours: Colours | None = None) -> None:
    """Write the slice as float32 EXR.

    Args:
        colours: for narrow orders.

    Raises:
        UnsupportedError: as `slice_values`.
        NacreError: the file cannot be written.
    """
    import OpenEXR

    values = slice_values(bsdf)
    rgb = np.asarray(spectrum_to_rgb_linear(values, bsdf.wavelengths_nm))
    if colours is not None:
        wi, wo, up = _slice_pairs(len(values))
        rgb[up] = xyz_to_srgb_linear(colours(wi[up], wo[up]))
    channels = {name: np.ascontiguousarray(rgb[..., i], np.float32) for i, name in enumerate("RGB")}
    for i, wavelength in enumerate(bsdf.wavelengths_nm):
        name = f"S0.{wavelength:.6f}nm".replace(".", ",").replace("S0,", "S0.")
        channels[name] = np.ascontiguousarray(values[..., i], np.float32)
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "spectralLayoutVersion": "1.0",
        "emissiveUnits": "sr^-1",
        "nacre": comment,
        "slice": "columns: theta_half, rows: theta_diff, both 0 to 90 degrees at cell centres; phi_diff = 90 degrees",
    }
    with atomic_path(path) as temporary, reraise_as_oserror():
        OpenEXR.File(header, channels).write(str(temporary))


# Zemax tabular BSDF files: scatter about the specular direction, monochrome or XYZ.
#
# `AngleOfIncidence` is the angle of the specular ray; radial angles are counted from it, azimuth 0 points from it
# towards the surface normal and grows counter-clockwise (Radiant's BSDF data interchange format). Files written here
# are plane-symmetrical: azimuths 0 to 180 degrees, one sample rotation.


def zemax_table(
    bsdf: Bsdf, wavelength_nm: float | None = None, step_deg: float = 5.0, colours: Colours | None = None
) -> ZemaxBsdf:
    """Tabulate the reflected, non-delta part of a Bsdf.

    Args:
        wavelength_nm: one wavelength for a monochrome file; default: XYZ under D65.
        step_deg: step for incidence and azimuth; radial angles are finer near the specular direction.
        colours: for narrow orders.

    Raises:
        UnsupportedError: nothing but deltas, a stochastic lobe, or a wavelength outside the Bsdf's grid.
    """
    refuse_unsuitable(bsdf, "a Zemax table")
    incidence = np.arange(0.0, 85.0 + step_deg / 2, step_deg)
    azimuth = np.arange(0.0, 180.0 + step_deg / 2, step_deg)
    radial = np.concatenate([np.arange(0, 5, 0.5), np.arange(5, 20, 1), np.arange(20, 90, 2.5), np.arange(90, 176, 5)])
    i, a, r = np.meshgrid(incidence, azimuth, radial, indexing="ij")
    wo = scatter_direction(i, a, r)
    wi = np.broadcast_to(direction(np.radians(i)), wo.shape)
    up = wo[..., 2] > 1e-4
    if wavelength_nm is None and colours is not None:
        channels = colours(wi[up], wo[up])
    elif wavelength_nm is None:
        channels = np.asarray(spectrum_to_xyz(bsdf.evaluate(wi[up], wo[up]), bsdf.wavelengths_nm))
    else:
        f = bsdf.evaluate(wi[up], wo[up])
        grid = bsdf.wavelengths_nm
        if not grid[0] <= wavelength_nm <= grid[-1]:
            raise UnsupportedError(f"wavelength {wavelength_nm:g} nm is outside {grid[0]:g} to {grid[-1]:g} nm")
        at = min(int(np.searchsorted(grid, wavelength_nm)), len(grid) - 1)
        share = 0.0 if at == 0 else (wavelength_nm - grid[at - 1]) / (grid[at] - grid[at - 1])
        channels = (f[:, at - 1] * (1 - share) + f[:, at] * share if at else f[:, 0])[:, None]
    values = np.zeros((channels.shape[1], *up.shape))
    values[:, up] = channels.T
    return ZemaxBsdf(incidence, azimuth, radial, values, _total(values, wo[..., 2], azimuth, radial))


def _total(values: Array, cos_o: Array, azimuth_deg: Array, radial_deg: Array) -> Array:
    """Integrate f cos over half the azimuths and double it."""
    from scipy.integrate import trapezoid

    rho = np.radians(radial_deg)
    rings = trapezoid(values * np.maximum(cos_o, 0.0) * np.sin(rho), rho, axis=-1)
    return np.asarray(2 * trapezoid(rings, np.radians(azimuth_deg), axis=-1))


def write_zemax(path: str | Path, table: ZemaxBsdf, comment: str = "") -> None:
    """Write the table as text, atomically.

    Raises:
        NacreError: the file cannot be written.
    """
    with atomic_path(path) as temporary, open(temporary, "w", encoding="ascii", errors="replace") as file:
        for line in comment.splitlines():
            file.write(f"# {line}\n")
        file.write(f"Source  Measured\nSymmetry  PlaneSymmetrical\nSpectralContent  {table.spectral_content}\n")
        file.write(f"ScatterType  {table.scatter_type}\nSampleRotation  1\n0\n")
        for name, angles in (
            ("AngleOfIncidence", table.incidence_deg),
            ("ScatterAzimuth", table.azimuth_deg),
            ("ScatterRadial", table.radial_deg),
        ):
            file.write(f"{name}  {len(angles)}\n" + "\t".join(f"{a:g}" for a in angles) + "\n")
        for channel, name in enumerate(CHANNELS[table.spectral_content]):
            file.write(f"\n{name}\nDataBegin\n")
            for i in range(len(table.incidence_deg)):
                file.write(f"TIS {table.tis[channel, i]:.6g}\n")
                for row in table.values[channel, i]:
                    file.write("\t".join(f"{v:.7e}" for v in row) + "\n")
            file.write("DataEnd\n")


# Conversion of lobes to and from other formats: grids, tables, colour bases, losses.

RGL_TURNS, RGL_INCIDENCES, RGL_RADIALS, RGL_AZIMUTHS, RGL_WAVELENGTHS = 24, 18, 48, 33, 48
MAX_COMPARED = 20_000


def lost_parts(bsdf: Bsdf) -> list[str]:
    return unresolved_lost(bsdf) + (["transmission and the lower side"] if bsdf.transmits else [])


def narrow_lost(bsdf: Bsdf) -> list[str]:
    """Return the remark on diffraction orders, whose width a grid of directions does not resolve."""
    widths = [np.degrees(lobe.width) for lobe in order_lobes(bsdf.lobes)]
    return [f"orders {min(widths):.2g} degrees wide between the directions of the file's grid"] if widths else []


def lines_lost(bsdf: Bsdf, target: str) -> list[str]:
    """Return the remark on lines of orders between the wavelengths of a spectral file."""
    if target not in SPECTRAL:
        return []
    line = narrowest_nm(bsdf.lobes)
    step = float(np.diff(bsdf.wavelengths_nm).max(initial=0.0))
    return [f"lines of orders, {line:.2g} nm wide, between wavelengths {step:g} nm apart"] if step > line else []


def unresolved_lost(bsdf: Bsdf) -> list[str]:
    delta = bsdf.specular(np.radians([0.0, 45.0, 80.0]))
    has = max(float(delta.reflectance.max()), float(delta.transmittance.max())) > 1e-6
    return (["the mirror-like (delta) part"] if has else []) + narrow_lost(bsdf)


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
    interpolated = lobe.evaluate(wi, wo)
    if table.wavelengths_nm is None:
        values = np.maximum(values @ lobe.basis, 0.0)
    light = np.unique(np.round(angles[:, :2], 6), axis=0, return_inverse=True)[1].ravel()
    peak = np.zeros(light.max() + 1)
    np.maximum.at(peak, light, values.max(axis=1))
    off = np.abs(interpolated - values).max(axis=1) / np.maximum(peak[light], 1e-30)
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


# RGL tensor files (`.bsdf`) of Mitsuba's `measured` and pbrt: writing; `nacre.readers.bsdf.databases` reads them.

NDF_FLOOR = 1e-4  # relative to the peak; dark directions must remain sampled


def write_tensor(path: str | Path, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write named arrays as a tensor file, version 1.0, atomically."""
    codes = {np.dtype(text): code for code, text in databases.TYPES.items()}
    arrays = {name: np.ascontiguousarray(value) for name, value in fields.items()}
    header = databases.MAGIC + struct.pack("<BBI", 1, 0, len(arrays))
    size = len(header) + sum(2 + len(n.encode()) + 2 + 1 + 8 + 8 * a.ndim for n, a in arrays.items())
    parts, offset = [header], size
    for name, array in arrays.items():
        offset = -(-offset // 8) * 8
        label = name.encode()
        parts.append(
            struct.pack("<H", len(label)) + label + struct.pack("<HBQ", array.ndim, codes[array.dtype], offset)
        )
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
    grid_u, grid_v = np.meshgrid(np.linspace(0, 1, vndf_columns), np.linspace(0, 1, vndf_rows), indexing="xy")
    grid_theta = theta_of(grid_u)
    grid_m, grid_ndf = direction(grid_theta, phi_of(grid_v)), _bilinear(ndf, ndf_u, ndf_v, grid_u, grid_v)
    grid_sine = np.sin(grid_theta)
    vndf = np.zeros((len(phi_i), theta_nodes, vndf_rows, vndf_columns), np.float32)
    spectra = np.zeros((len(phi_i), theta_nodes, len(grid), resolution, resolution), np.float32)
    luminance = np.zeros((len(phi_i), theta_nodes, resolution, resolution), np.float32)
    s = np.linspace(0, 1, resolution)
    sx, sy = (a.ravel() for a in np.meshgrid(s, s, indexing="xy"))
    for p, phi in enumerate(phi_i):
        for t, theta in enumerate(theta_i):
            wi = direction(np.array(theta), np.array(phi))
            # D <wi, m> times the format's Jacobian, positive everywhere
            density = grid_ndf * np.maximum(grid_m @ wi, 0.0) * grid_u * grid_sine
            warp = Warp.of(density + 1e-7 * density.max())
            vndf[p, t] = warp.density
            mu, mv = warp.sample(sx, sy)
            values = _f_cos(bsdf, grid, wi, direction(theta_of(mu), phi_of(mv)))
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
    lost = ["transmission and the lower side are left out"] if bsdf.transmits else []
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


def _projected_area(ndf: Array, ndf_u: Array, ndf_v: Array, theta: Array, phi: Array) -> Array:
    """Return sigma `[v, u]`: the integral of D <wi, m> over half vectors."""
    u = np.linspace(0, 1, 128)
    v = np.linspace(0, 1, 65)[:-1]
    mu, mv = (a.ravel() for a in np.meshgrid(u, v, indexing="xy"))
    m = direction(theta_of(mu), phi_of(mv))
    weight = _bilinear(ndf, ndf_u, ndf_v, mu, mv) * mu * np.sin(theta_of(mu)) * 2 * np.pi**2 / (len(u) * len(v))
    area = np.empty((len(phi), len(theta)))
    for row, turn in zip(area, phi, strict=True):
        cosines = direction(theta, turn) @ m.T
        row[:] = np.maximum(cosines, 0.0, out=cosines) @ weight
    return np.maximum(area, 1e-12)


# Export formats of materials, their requirements, and remarks on an exported file.

# suffix of the file or folder
EXPORTS = {
    "rgl": ".bsdf", "merl": ".binary", "csv": ".csv", "zemax": ".bsdf", "gltf": ".gltf", "materialx": ".mtlx",
    "exr": ".exr", "nacre": ".nacre", "lut": "-lut", "tmat": ".tmat.h5", "astm": ".astm", "brdf-json": ".json",
    "speos": ".brdf", "three": "-three", "usd": ".usda",
}  # fmt: skip
FOLDERS = ("lut", "three")  # these formats are folders, with colours of one lamp
FAMILY_FORMATS = ("tmat",)  # only some families write these (`OwnFormats`)


def refuse_unsuitable(bsdf: Bsdf, noun: str) -> None:
    """Refuse to tabulate random walks and pure mirrors.

    Raises:
        UnsupportedError: a lobe is stochastic, or all lobes are deltas.
    """
    if any(lobe.is_stochastic for lobe in bsdf.lobes):
        raise UnsupportedError(f'{noun} needs arrays, not a random walk; set quality = "fast" in the recipe')
    if all(lobe.is_delta for lobe in bsdf.lobes):
        raise UnsupportedError(f"{noun} cannot store a smooth material: mirror directions are delta functions")


def export_remarks(facts: Mapping[str, Any]) -> list[str]:
    """Return remarks on an export: its colour error, and properties that the format cannot store.

    Args:
        facts: from `nacre.analysis.import_export.export_material`.
    """
    lines = [
        f"{part['name']}, {100 * part['mean_share']:.0f} % of the surface: one film of "
        f"{part['film']['thickness_nm']:.1f} nm, n = {part['film']['film_ior']:.3f}; "
        f"dE00 {part['residual_delta_e_2000']:.2f} on the mean of the angles"
        for part in facts.get("parts", ())
    ]
    if "film" in facts:
        film, varied = facts["film"], facts.get("thickness_map")
        size = f"{film['thickness_nm']:.1f}" if varied is None else f"{varied['low_nm']:.1f} to {varied['high_nm']:.1f}"
        over = "the angles" if varied is None else "the angles and the thickness map"
        lines.append(
            f"one film of {size} nm, n = {film['film_ior']:.3f}; "
            f"dE00 {facts['residual_delta_e_2000']:.2f} on the mean of {over}"
        )
    lines += [
        f"{name}: dE00 {error['mean']:.2f} mean, {error['max']:.2f} maximum; PNG {error['mean_png']:.2f}, "
        f"{error['max_png']:.2f}"
        for name, error in facts.get("errors_dE00", {}).items()
    ]
    return lines + [f"not stored: {part}" for part in facts["lost"]]
