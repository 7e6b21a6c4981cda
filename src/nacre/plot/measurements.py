"""Figures of measured data: spectra, ellipsometric angles, constants, height maps, colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from nacre.core.errors import UnsupportedError
from nacre.plot import style
from nacre.readers.measurement import Measurement

MAX_CURVES = 60
MAX_SCANS = 8
IN_PLANE = 1e-4  # sine of the azimuth difference


def measurement_figure(measurements: Sequence[Measurement]) -> Figure:
    """Return a figure of measurements: a height map, or the curves of all tables over wavelength.

    BSDFs are drawn in the plane of incidence, one curve an incidence, as means over wavelength or channel.

    Raises:
        UnsupportedError: no measurement has a height map, a wavelength, or directions in the plane of incidence.
    """
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 2.75)
        axes = figure.add_subplot()
        for measurement in measurements:
            if "height_um" in measurement.data:
                x, y = measurement.metadata.get("pitch_um", (1.0, 1.0))
                heights = np.asarray(measurement.data["height_um"])
                extent = (0.0, heights.shape[1] * x, heights.shape[0] * y, 0.0)
                image = axes.imshow(heights, extent=extent, cmap="viridis")
                figure.colorbar(image, ax=axes, label="height (um)")
                axes.set_xlabel("x (um)")
                axes.set_ylabel("y (um)")
                return figure
        scans = [scan for measurement in measurements for scan in _scans(measurement)]
        if scans:
            for label, x, y in scans[:MAX_SCANS]:
                axes.semilogy(x, y, linewidth=0.8, marker=".", markersize=2, label=label)
            axes.set_xlabel("exit angle (degrees, mirror side positive)")
            axes.set_ylabel("BSDF (1/sr)")
            axes.legend(fontsize=6)
            return figure
        curves = [curve for measurement in measurements for curve in _curves(measurement)]
        if not curves:
            raise UnsupportedError(
                "--plot draws height maps, tables over wavelength, and BSDFs in the plane of incidence"
            )
        for label, x, y in curves[:MAX_CURVES]:
            axes.plot(x, y, linewidth=0.8, label=label)
        axes.set_xlabel("wavelength (nm)")
        if len(curves) <= 8:
            axes.legend(fontsize=6)
        else:
            axes.set_ylabel(curves[0][0].split(": ")[-1])
        return figure


def _scans(measurement: Measurement) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return values over the signed exit angle in the plane of incidence, for each incidence."""
    data = measurement.data
    values = next((data[name] for name in ("bsdf", "bsdf_rgb", "bsdf_xyz") if name in data), None)
    if values is None or "phi_o_deg" not in data:
        return []
    values = values if values.ndim == 1 else values.mean(axis=1)
    turn = np.radians(data["phi_o_deg"] - data["phi_i_deg"])
    flat = (np.abs(np.sin(turn)) < IN_PLANE) & (data["phi_i_deg"] == data["phi_i_deg"][0])
    out = np.where(np.cos(turn) < 0, data["theta_o_deg"], -data["theta_o_deg"])
    found = []
    for incidence in np.unique(data["theta_i_deg"][flat]):
        rows = flat & (data["theta_i_deg"] == incidence) & np.isfinite(values) & (values > 0)
        angles, place = np.unique(np.round(out[rows], 6), return_inverse=True)
        if len(angles) > 1:
            mean = np.bincount(np.ravel(place), values[rows]) / np.bincount(np.ravel(place))
            own = f"{measurement.name}: " if measurement.name else ""
            found.append((f"{own}{incidence:.4g} degrees", angles, mean))
    return found[:: max(1, len(found) // MAX_SCANS)]


def _curves(measurement: Measurement) -> list[tuple[str, np.ndarray, np.ndarray]]:
    grid = measurement.data.get("wavelength_nm")
    if grid is None:
        return []
    if "spectra" in measurement.data:
        names = measurement.metadata.get("names") or [str(row) for row in range(len(measurement.data["spectra"]))]
        return [
            (f"{name}: reflectance", grid, row) for name, row in zip(names, measurement.data["spectra"], strict=False)
        ]
    own = f"{measurement.name}: " if measurement.name else ""
    skipped = ("wavelength_nm", "angle_of_incidence_deg", "time_s")
    return [
        (f"{own}{name}", grid, values) for name, values in measurement.data.items()
        if name not in skipped and not name.endswith("_error") and np.shape(values) == np.shape(grid)
    ]  # fmt: skip
