"""Measured BSDFs: lobes on the measured nodes with remarks on all that was filled, goniometer CSV, other formats."""

from __future__ import annotations

import json
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.table import TableLobe, half_difference
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, write_text
from nacre.light import default_wavelengths, spectrum_to_rgb_matrix, xyz_to_srgb_linear
from nacre.readers.bsdf.gonio_table import COLOURS, DEGREES
from nacre.readers.bsdf.interchange import hemispherical_share
from nacre.readers.measurement import Measurement

LAWS = ("half-angle",)
MIN_PAIRS = 4
SCATTERED_NODES = (46, 46, 37)  # theta_i, theta_o, dphi of directions that form no grid
MIN_FILLED = 0.5  # share of a grid's nodes that must be measured
EQUAL = 1e-6  # relative spread of rounding
ANISOTROPIC = 0.1  # relative spread between light azimuths beyond which data are anisotropic
NOISE = 0.01  # negative values up to this share of the maximum, and of the sum, are noise
DIGITS = 6  # decimal places to which angles in degrees are rounded
HALF_NODES = (60, 60, 5)


def checked(values: Array, name: str) -> tuple[Array, list[str]]:
    """Set small negative noise to 0.

    Raises:
        NacreError: values that are too negative for noise, or too large.
    """
    known = values[np.isfinite(values)]
    if known.size and known.max() > MAX_VALUE:
        raise NacreError(f"{name}: value = {known.max():g} is larger than any BSDF (1/sr)")
    negative = known[known < 0]
    if not len(negative):
        return values, []
    positive = known[known > 0]
    limit, total = (NOISE * float(positive.max()), NOISE * float(positive.sum())) if len(positive) else (0.0, 0.0)
    if -negative.min() > limit or -negative.sum() > total:
        raise NacreError(f"{name}: value = {negative.min():g} is below 0, beyond noise; no BSDF is negative")
    return np.where(values < 0, 0.0, values), [
        f"{len(negative)} of {known.size} values are below 0, down to {negative.min():.3g}; set to 0 as noise"
    ]


def measured_table(data: GonioData, name: str, law: str | None = None) -> tuple[TableLobe, list[str]]:
    """Return the table of a reflection measurement, and remarks.

    A direction grid keeps its nodes and values and is interpolated linearly in theta_i, theta_o and the azimuth
    difference; missing nodes are filled from their neighbours. Other sets of directions are interpolated from nearest
    neighbours on a fixed grid.

    Args:
        law: "half-angle": the BRDF depends on half and difference angle only (a bivariate law), for scans in the plane
            of incidence.

    Raises:
        NacreError: fewer than four pairs lie above the surface, or impossible values.
        UnsupportedError: the pairs lie in the plane of incidence or have one incidence and no law is given, or those
            of an anisotropic sample do not form a grid.
    """
    theta_i, phi_i, theta_o, phi_o = data.angles_deg.T
    up = (theta_i < 90) & (theta_o < 90)
    remarks = [] if np.all(up) else [f"{int(np.sum(~up))} pairs of the other side were left out"]
    if np.sum(up) < MIN_PAIRS:
        raise NacreError(f"{name}: holds {int(np.sum(up))} direction pairs above the surface; at least 4 are needed")
    values, more_remarks = checked(data.values[up], name)
    remarks += more_remarks
    dphi = (phi_o - phi_i + 180.0) % 360.0 - 180.0
    points = np.round(np.stack([theta_i, theta_o, dphi, phi_i], axis=-1)[up], DIGITS)
    points[points[:, 2] == -180.0, 2] = 180.0
    flat = (points[:, 0] == 0) | (points[:, 1] == 0)
    is_in_plane = bool(np.all(flat | (np.abs(np.sin(np.radians(points[:, 2]))) < 1e-6)))
    if law is not None:
        if law not in LAWS:
            raise NacreError(f'law = "{law}" is not known; allowed: {", ".join(LAWS)}')
        return _by_half_angle(points, values, data.wavelengths_nm, remarks)
    if is_in_plane or len(np.unique(points[:, 0])) < 2:
        what = "lies in the plane of incidence" if is_in_plane else f"has one incidence, {points[0, 0]:g} degrees"
        raise UnsupportedError(
            f"{name}: the measurement {what} and determines no BRDF by itself; state a law: --law {LAWS[0]} "
            "(the BRDF depends on half and difference angle only)"
        )
    spread = _spread_over_turns(points, values)
    if spread > ANISOTROPIC:
        return _on_turns(points, values, data.wavelengths_nm, name, [*remarks, _spread_words(points, spread)])
    if spread > EQUAL:
        remarks.append(f"{_spread_words(points, spread)}; they were averaged")
    grid = _Grid.of(points, values)
    if grid is None:
        table, more_remarks = _scattered(points, values)
        lobe = TableLobe(data.wavelengths_nm, table, np.eye(values.shape[1]))
        return lobe, remarks + more_remarks + [_own_error(lobe, data, up, values)]
    return _on_grid(grid, data.wavelengths_nm, remarks)


def _spread_over_turns(points: Array, values: Array) -> float:
    """Return the typical relative difference of values between light azimuths; 0 for one azimuth."""
    if len(np.unique(points[:, 3] % 360.0)) < 2:
        return 0.0
    mean = np.nanmean(values, axis=1)
    # directions off the normal, since the azimuth difference is undefined there
    some = (points[:, 0] > 0) & (points[:, 1] > 0) & np.isfinite(mean)
    _, where = np.unique(points[some, :3], axis=0, return_inverse=True)
    where = np.ravel(where)
    count = np.bincount(where)
    average = np.bincount(where, mean[some]) / count
    spread = np.abs(mean[some] - average[where]) / np.maximum(np.abs(average[where]), 1e-12)
    spread = spread[count[where] > 1]
    return float(np.quantile(spread, 0.9)) if len(spread) else np.inf


def _spread_words(points: Array, spread: float) -> str:
    turns = np.unique(points[:, 3] % 360.0)
    azimuths = f"{len(turns)} azimuths of the light, {turns[0]:g} to {turns[-1]:g} degrees"
    return f"{azimuths}, differ by {100 * spread:.2g} %" if np.isfinite(spread) else f"{azimuths}, share no directions"


def _on_turns(
    points: Array, values: Array, wavelengths_nm: Array, name: str, remarks: list[str]
) -> tuple[TableLobe, list[str]]:
    """Return the table for an anisotropic sample: one direction grid per azimuth of incidence.

    Raises:
        UnsupportedError: the azimuths have different grids of directions.
    """
    turn = points[:, 3] % 360.0
    turns = np.unique(turn)
    grids = [_Grid.of(points[turn == t], values[turn == t], is_folded=False) for t in turns]
    first = grids[0]
    problem = UnsupportedError(
        f"{name}: is anisotropic, {remarks[-1]}, and the directions differ between the azimuths of the light; "
        "a table needs the same theta_i, theta_o and azimuth differences for each"
    )
    lobes = []
    for grid in grids:
        if first is None or grid is None or grid.is_signed != first.is_signed:
            raise problem
        if not all(np.array_equal(a, b) for a, b in zip(grid.axes, first.axes, strict=True)):
            raise problem
        lobe, grid_remarks = _on_grid(grid, wavelengths_nm, [])
        lobes.append(lobe)
        remarks += [line for line in grid_remarks if line not in remarks]
    nodes, which, words = periodic_turns(turns)
    table = np.stack([lobe.values for lobe in lobes])[which]
    return replace(lobes[0], values=table, nodes_turn=nodes), [*remarks, *words]


def periodic_turns(turns_deg: Array) -> tuple[Array, NDArray[np.intp], list[str]]:
    """Return nodes of a periodic table over the light's azimuth, and remarks on the symmetry.

    Azimuths that span less than 180 degrees repeat after 180 degrees, as on a brushed surface.

    Returns:
        nodes over 2 pi, from below 0 to above 1; the measured azimuth of each; remarks.
    """
    period = 360.0 if turns_deg[-1] - turns_deg[0] >= 180.0 else 180.0
    steps = np.arange(-1, int(360 / period) + 2)
    nodes = (turns_deg[None] + period * steps[:, None]).ravel()
    which = np.tile(np.arange(len(turns_deg)), len(steps))
    _, first = np.unique(np.round(nodes, DIGITS), return_index=True)
    words = [] if period == 360.0 else ["azimuths of the light repeat after 180 degrees: the rest was not measured"]
    nodes, which = nodes[first], which[first]
    used = (nodes >= nodes[nodes <= 0.0].max()) & (nodes <= nodes[nodes >= 360.0].min())
    return nodes[used] / 360.0, which[used], words


@dataclass(frozen=True)
class _Grid:
    """Values on the nodes `[theta_i, theta_o, azimuth, channel]`; NaN: missing."""

    theta_i: Array
    theta_o: Array
    azimuth: Array
    values: Array
    is_signed: bool

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """The nodes in degrees."""
        return self.theta_i, self.theta_o, self.azimuth

    @classmethod
    def of(cls, points: Array, values: Array, is_folded: bool = True) -> _Grid | None:
        """Return the grid, or None if the directions form none.

        Args:
            is_folded: keep one side of the plane of incidence if both are equal.
        """
        away = (points[:, 0] > 0) & (points[:, 1] > 0)
        sides = np.unique(points[away, 2])
        is_signed = bool(np.any(sides < 0) and np.any((sides > 0) & (sides < 180)))
        folded = points[:, :3].copy()
        if not is_signed:
            folded[:, 2] = np.abs(folded[:, 2])
        axes = [np.unique(folded[:, 0]), np.unique(folded[:, 1]), np.unique(folded[away, 2])]
        if min(len(a) for a in axes) < 2:
            return None
        # at normal incidence the light is taken at azimuth 0; where only one azimuth was measured, it stands for all,
        # as does each value at the normal exit direction, whose azimuth has no meaning
        several = {out for out in axes[1] if np.sum((folded[:, 0] == 0) & (folded[:, 1] == out)) > 1}
        at_zero = (folded[:, 0] == 0) & (folded[:, 1] > 0) & np.isin(folded[:, 2], axes[2])
        away |= at_zero & np.isin(folded[:, 1], list(several))
        normal = ~away
        rows = [folded[away]] + [
            np.stack([np.full(len(axes[2]), p[0]), np.full(len(axes[2]), p[1]), axes[2]], axis=-1)
            for p in folded[normal]
        ]
        table = np.concatenate([values[away], np.repeat(values[normal], len(axes[2]), axis=0)])
        all_rows = np.concatenate(rows)
        place = tuple(np.searchsorted(a, all_rows[:, i]) for i, a in enumerate(axes))
        shape = (*(len(a) for a in axes), values.shape[1])
        if len(np.unique(np.ravel_multi_index(place, shape[:3]))) < MIN_FILLED * np.prod(shape[:3]):
            return None  # a grid with mostly empty nodes would take gigabytes
        known = np.isfinite(table)
        total, count = np.zeros(shape), np.zeros(shape)
        np.add.at(total, place, np.where(known, table, 0.0))
        np.add.at(count, place, known)
        if np.mean(count > 0) < MIN_FILLED:
            return None
        with np.errstate(invalid="ignore"):
            grid = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        made = cls(axes[0], axes[1], axes[2], grid, is_signed)
        return made._folded() if is_signed and is_folded else made

    def _folded(self) -> _Grid:
        """Return a single side if both sides are equal."""
        positive = self.azimuth >= 0
        angles = self.azimuth[positive]
        inner = (angles > 0) & (angles < 180)
        if not np.array_equal(-self.azimuth[~positive][::-1], angles[inner]):
            return self
        mirrored = np.flatnonzero(positive)
        mirrored[inner] = np.searchsorted(self.azimuth, -angles[inner])
        left, right = self.values[:, :, positive], self.values[:, :, mirrored]
        both = np.where(np.isnan(left), right, left)
        if not np.allclose(both, np.where(np.isnan(right), left, right), rtol=1e-9, atol=0.0, equal_nan=True):
            return self
        return _Grid(self.theta_i, self.theta_o, self.azimuth[positive], both, False)


def _on_grid(grid: _Grid, wavelengths_nm: Array, remarks: list[str]) -> tuple[TableLobe, list[str]]:
    """Return the table on the grid's own nodes."""
    values = grid.values
    missing = int(np.sum(np.isnan(values).any(axis=-1)))
    if missing:
        remarks.append(f"{missing} of {values[..., 0].size} nodes were not measured; they were filled from neighbours")
        values = _filled(values, grid.theta_o)
    azimuth = grid.azimuth
    if grid.is_signed:
        # periodic: repeat the ends beyond +-180 degrees
        values = np.concatenate([values[:, :, -1:], values, values[:, :, :1]], axis=2)
        azimuth = np.concatenate([azimuth[-1:] - 360.0, azimuth, azimuth[:1] + 360.0])
    for name, nodes in (("incidences", grid.theta_i), ("exit angles", grid.theta_o)):
        outside = [f"below {nodes[0]:g}"] if nodes[0] > 0 else []
        outside += [f"above {nodes[-1]:g}"] if nodes[-1] < 80.0 else []
        if outside:
            remarks.append(f"{name} {' and '.join(outside)} degrees were not measured; the nearest value is held")
    c = (azimuth + 180.0) / 360.0 if grid.is_signed else azimuth / 180.0
    return TableLobe(
        wavelengths_nm, values, np.eye(values.shape[3]), "direction", grid.theta_i / 90.0, grid.theta_o / 90.0, c,
        grid.is_signed,
    ), remarks  # fmt: skip


def _filled(values: Array, theta_o: Array) -> Array:
    """Fill missing nodes linearly along theta_o between neighbours, else with the nearest node's value."""
    from scipy.ndimage import distance_transform_edt

    flat = np.moveaxis(values, 1, -1).reshape(-1, len(theta_o)).copy()
    for at in np.flatnonzero(np.isnan(flat).any(axis=1)):
        known = np.flatnonzero(np.isfinite(flat[at]))
        if len(known) > 1:
            inner = np.arange(known[0], known[-1] + 1)
            flat[at, inner] = np.interp(theta_o[inner], theta_o[known], flat[at, known])
    shape = (values.shape[0], values.shape[2], values.shape[3], values.shape[1])
    table = np.moveaxis(flat.reshape(shape), -1, 1)
    for channel in range(values.shape[3]):
        holes = np.isnan(table[..., channel])
        if np.any(holes):
            nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
            table[..., channel] = table[..., channel][tuple(nearest)]
    return table


def _scattered(points: Array, values: Array) -> tuple[Array, list[str]]:
    from scipy.spatial import cKDTree

    known = np.isfinite(values).all(axis=1)
    if known.sum() < MIN_PAIRS:
        raise NacreError(f"only {int(known.sum())} directions have values at all wavelengths")
    axes = [np.linspace(0, limit, n) for limit, n in zip((90.0, 90.0, 180.0), SCATTERED_NODES, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    at = np.concatenate([points[known, :2], np.abs(points[known, 2:3])], axis=-1)
    distance, index = (np.asarray(a) for a in cKDTree(at).query(nodes, k=min(8, len(at))))
    weight = 1.0 / (distance**2 + 1e-6)
    weight = weight / weight.sum(axis=1, keepdims=True)
    table = np.einsum("nk,nkw->nw", weight, values[known][index]).reshape(*SCATTERED_NODES, -1)
    return table, ["the directions form no grid; values between them are interpolated from nearest neighbours"]


def _own_error(lobe: TableLobe, data: GonioData, up: Array, values: Array) -> str:
    """Return a remark on the table's deviation from the measured values."""
    off = np.abs(lobe.evaluate(data.wi[up], data.wo[up]) - values)
    typical, worst = float(np.nanmedian(off)), float(np.nanmax(off))
    return f"at the measured directions the table differs by {typical:.3g} 1/sr (median), {worst:.3g} 1/sr (maximum)"


def _by_half_angle(
    points: Array, values: Array, wavelengths_nm: Array, remarks: list[str]
) -> tuple[TableLobe, list[str]]:
    """Interpolate f over half and difference angle from the measured pairs."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    wi = direction(np.radians(points[:, 0]), np.zeros(len(points)))
    wo = direction(np.radians(points[:, 1]), np.radians(points[:, 2]))
    half, diff, _ = half_difference(wi, wo)
    at = np.stack([np.sqrt(half / (np.pi / 2)), diff / (np.pi / 2)], axis=-1)
    known = np.isfinite(values).all(axis=1)
    at, values = at[known], values[known]
    a, b = np.meshgrid(*(np.linspace(0, 1, n) for n in HALF_NODES[:2]), indexing="ij")
    is_line = np.linalg.matrix_rank(at - at.mean(axis=0), tol=1e-6) < 2 or len(np.unique(points[:, 0])) < 2
    if is_line:
        order = np.argsort(at[:, 0])
        table = np.stack([np.interp(a, at[order, 0], column[order]) for column in values.T], axis=-1)
    else:
        table = np.asarray(LinearNDInterpolator(at, values)(a, b))
        nearest = np.asarray(NearestNDInterpolator(at, values)(a, b))
        table = np.where(np.isnan(table), nearest, table)
    lobe = TableLobe(
        wavelengths_nm, np.repeat(table[:, :, None], HALF_NODES[2], axis=2), np.eye(values.shape[1]), "half"
    )
    law = "the half angle only (one incidence)" if is_line else "half and difference angle only"
    return lobe, [*remarks, f"law: the BRDF depends on {law}; directions outside the plane of incidence follow from it"]


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


def with_spectra(lobe: TableLobe, measured: Measurement) -> tuple[TableLobe, list[str]]:
    """Give colour channels smooth spectra, and a value without a wavelength a constant one."""
    wavelengths = default_wavelengths()
    if any(key in measured.data for key in COLOURS.values()):
        remarks = ["colour channels were given smooth spectra that have their colours under D65"]
        return replace(lobe, wavelengths_nm=wavelengths, basis=rgb_basis(wavelengths)), remarks
    if "wavelength_nm" not in measured.data:
        return replace(lobe, wavelengths_nm=wavelengths, basis=np.ones((1, len(wavelengths)))), []
    return lobe, []


# Goniometric measurements as CSV: theta_i, phi_i, theta_o, phi_o (degrees), wavelength (nm), value (1/sr).

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
    _write_rows(path, [*(f"# {line}" for line in comment.splitlines()), ",".join(COLUMNS)], table)


def _write_rows(path: str | Path, head: Sequence[str], table: Array) -> None:
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.writelines(f"{line}\n" for line in head)
        np.savetxt(file, table, fmt=f"%.{ROUND_TRIP_DIGITS}g", delimiter=",")


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


# Writing of tabulated BSDFs for other programs: ASTM E1392, universal BRDF JSON, Speos text.

SPEOS_HEAD = "OPTIS - brdf surface file v9.0"


def write_astm(path: str | Path, data: GonioData, comment: str = "") -> None:
    """Write ASTM E1392 text: angles in radians, one column a wavelength.

    Raises:
        NacreError: the file cannot be written.
    """
    names = ["theta_i", "phi_i", "theta_s", "phi_s", *(f"{w:.9g}nm" for w in data.wavelengths_nm)]
    table = np.concatenate([np.radians(data.angles_deg), data.values], axis=1)
    comments = [f"COMMENT {line}" for line in comment.splitlines()]
    _write_rows(path, [*comments, f"NUM_POINTS {len(table)}", f"VARS={','.join(names)}"], table)


def write_brdf_json(path: str | Path, data: GonioData, name: str, comment: str = "") -> None:
    """Write the universal BRDF format of the BiRD project, one row per pair and wavelength; uncertainties are 0.

    Raises:
        NacreError: the file cannot be written.
    """
    variables = [
        ("theta_i", "deg", "polar angle of incidence"), ("phi_i", "deg", "azimuth of incidence"),
        ("theta_r", "deg", "polar angle of reflection"), ("phi_r", "deg", "azimuth of reflection"),
        ("wavelength_i", "nm", "wavelength"), ("BRDF", "sr-1", "bidirectional reflectance distribution function"),
        ("uBRDF", "sr-1", "standard uncertainty of BRDF; 0: computed"),
    ]  # fmt: skip
    waves = len(data.wavelengths_nm)
    table = np.column_stack(
        [
            np.repeat(data.angles_deg, waves, axis=0), np.tile(data.wavelengths_nm, len(data.angles_deg)),
            data.values.ravel(), np.zeros(data.values.size),
        ]
    )  # fmt: skip
    empty = {key: "not stated" for key in ("provenance", "system", "environment")}
    metadata: dict[str, Any] = {
        "id": str(uuid.uuid5(uuid.NAMESPACE_URL, comment)), "type": "BRDF", "name": Path(path).name,
        "timestamp": datetime.now(UTC).isoformat(timespec="seconds"), **empty, "simulation": comment, "sample": name,
        "comments": "azimuth differences of 0 are retroreflection, 180 degrees the mirror side",
    }  # fmt: skip
    rows = [[float(f"{v:.{ROUND_TRIP_DIGITS}g}") for v in row] for row in table]
    described = [{"name": n, "type": "number", "unit": u, "description": d} for n, u, d in variables]
    write_text(Path(path), json.dumps({"metadata": metadata, "data": {"variables": described, "values": rows}}))


def write_speos(path: str | Path, data: GonioData, comment: str = "") -> None:
    """Write a Speos complete scattering file (`.brdf`) as text: azimuth 0 is the mirror side.

    Args:
        data: a full grid at one light azimuth.

    Raises:
        UnsupportedError: the directions form no such grid.
        NacreError: the file cannot be written.
    """
    sides = _sides(data)
    incidence = np.unique(data.angles_deg[:, 0])
    title = (comment.splitlines() or ["nacre"])[0]
    lines = [SPEOS_HEAD, "0", title, str(len(title)), title]
    lines += [f"{int('brdf' in sides)}\t{int('btdf' in sides)}", "1", f"{len(incidence)}\t{len(data.wavelengths_nm)}"]
    lines += [_row(incidence), _row(data.wavelengths_nm)]
    for theta, phi, values in sides.values():
        for i in range(len(incidence)):
            for k in range(len(data.wavelengths_nm)):
                table = values[i, ..., k]
                lines.append(f"{100 * hemispherical_share(theta, phi, table):.{ROUND_TRIP_DIGITS}g}")
                lines += [f"{len(theta)}\t{len(phi)}", _row(phi)]
                lines += [_row(np.concatenate([[t], row])) for t, row in zip(theta, table, strict=True)]
    write_text(Path(path), "\n".join(lines) + "\n")


def _row(values: Array) -> str:
    return "\t".join(f"{v:.{ROUND_TRIP_DIGITS}g}" for v in values)


def _sides(data: GonioData) -> dict[str, tuple[Array, Array, Array]]:
    """Return theta, azimuth (0: mirror side, closed at 360) and values `[incidence, theta, azimuth, wavelength]`."""
    theta_i, phi_i, theta_o, phi_o = np.round(data.angles_deg, 6).T
    if len(np.unique(phi_i)) > 1:
        raise UnsupportedError("a Speos .brdf file holds one azimuth of the light")
    incidence, turn = np.unique(theta_i), (phi_o - phi_i + 180.0) % 360.0
    azimuth = np.unique(turn)
    sides = {}
    for name, chosen in (("brdf", theta_o <= 90), ("btdf", theta_o > 90)):
        if not np.any(chosen):
            continue
        theta = np.unique(theta_o[chosen])
        shape = (len(incidence), len(theta), len(azimuth), len(data.wavelengths_nm))
        values = np.full(shape, np.nan)
        at = (theta_i[chosen], theta_o[chosen], turn[chosen])
        place = tuple(np.searchsorted(a, x) for a, x in zip((incidence, theta, azimuth), at, strict=True))
        values[place] = data.values[chosen]
        if np.isnan(values).any():
            raise UnsupportedError("a Speos .brdf file needs a full grid of directions")
        sides[name] = (
            theta,
            np.append(azimuth, azimuth[0] + 360.0),
            np.concatenate([values, values[:, :, :1]], axis=2),
        )
    return sides
