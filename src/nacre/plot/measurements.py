"""Figures: measured data (spectra, ellipsometric angles, constants, height maps, colours) and fits to them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.light import srgb_encode
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
                axes.set(xlabel="x (um)", ylabel="y (um)")
                return figure
        scans = [scan for measurement in measurements for scan in _scans(measurement)]
        if scans:
            for label, x, y in scans[:MAX_SCANS]:
                axes.semilogy(x, y, linewidth=0.8, marker=".", markersize=2, label=label)
            axes.set(xlabel="exit angle (degrees, mirror side positive)", ylabel="BSDF (1/sr)")
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
    scans = []
    for incidence in np.unique(data["theta_i_deg"][flat]):
        rows = flat & (data["theta_i_deg"] == incidence) & np.isfinite(values) & (values > 0)
        angles, place = np.unique(np.round(out[rows], 6), return_inverse=True)
        if len(angles) > 1:
            mean = np.bincount(np.ravel(place), values[rows]) / np.bincount(np.ravel(place))
            own = f"{measurement.name}: " if measurement.name else ""
            scans.append((f"{own}{incidence:.4g} degrees", angles, mean))
    return scans[:: max(1, len(scans) // MAX_SCANS)]


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


MAX_COLUMNS = 3
HALF_TURN = 180.0  # degrees; a line is broken where an angle passes 360


@dataclass(frozen=True, eq=False)
class FitPanel:
    """One measured quantity over wavelength or angle.

    Attributes:
        title, x_label, y_label: with units.
        curves: (label, x, measured, fitted).
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple[tuple[str, Array, Array, Array], ...]


def fit_panels_figure(panels: Sequence[FitPanel], title: str) -> Figure:
    """Draw each quantity with measured points, fitted lines, and fitted less measured below."""
    columns = min(MAX_COLUMNS, len(panels))
    blocks = -(-len(panels) // columns)
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 3.0 * blocks + 0.3)
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        heights = [3.0, 1.0] * blocks
        axes = figure.subplots(2 * blocks, columns, squeeze=False, gridspec_kw={"height_ratios": heights})
        for place in range(blocks * columns):
            first, column = 2 * (place // columns), place % columns
            upper, lower = axes[first : first + 2, column]
            if place >= len(panels):
                upper.set_axis_off()
                lower.set_axis_off()
                continue
            panel = panels[place]
            for k, (label, x, measured, fitted) in enumerate(panel.curves):
                ink = style.LINES[k % len(style.LINES)]
                order = np.argsort(x)
                upper.plot(x, measured, ".", markersize=2, color=ink, label=label)
                jumps = np.flatnonzero(np.abs(np.diff(fitted[order])) > HALF_TURN) + 1
                along, line = (np.insert(np.asarray(v, dtype=float)[order], jumps, np.nan) for v in (x, fitted))
                upper.plot(along, line, color=ink, linewidth=0.8)
                lower.plot(x, fitted - measured, ".", markersize=1.5, color=ink)
            lower.axhline(0.0, color=style.INK, linewidth=0.6)
            upper.set(ylabel=panel.y_label)
            lower.set(xlabel=panel.x_label, ylabel="residual")
            style.panel_title(upper, panel.title)
            if 1 < len(panel.curves) <= 8:
                upper.legend(loc="best", fontsize=6, handlelength=1.0)
    return figure


# Pictures of the texture of effect coatings, as the camera of an instrument sees them.

CROP_MM = 5.0
EXPOSURE = 4.0  # luminance of white over the mean under a lamp, beside which most sparkles are white
DIFFUSE_EXPOSURE = 2.0


def texture_figure(coatings: Sequence[tuple[str, Mapping[str, tuple[Array, float]]]]) -> Figure:
    """Draw the centre of the images of each coating, one row for each.

    Args:
        coatings: name, and for each light ("15", "45", "75" degrees, "diffuse") the luminance factors `[row, column]`
            and the image's side in mm. White is four times the mean, under diffuse light twice the mean.
    """
    with style.house_style():
        columns = max(len(images) for _, images in coatings)
        width = style.SHEET_IN / columns
        figure = style.new_figure(style.SHEET_IN, (width + 0.25) * len(coatings))
        axes = figure.subplots(len(coatings), columns, squeeze=False)
        for row, (name, images) in zip(axes, coatings, strict=True):
            for axis, (light, (image, side_mm)) in zip(row, images.items(), strict=False):
                side = min(CROP_MM, side_mm)
                count = max(1, round(len(image) * side / side_mm))
                exposure = DIFFUSE_EXPOSURE if light == "diffuse" else EXPOSURE
                crop = image[:count, :count] / max(exposure * float(image.mean()), 1e-12)
                axis.imshow(
                    srgb_encode(np.clip(crop, 0.0, 1.0)), cmap="gray", vmin=0.0, vmax=1.0, extent=(0, side, 0, side)
                )
                axis.set_title("diffuse light" if light == "diffuse" else f"lamp at {light} degrees")
                axis.set_xticks([0, side], ["0", f"{side:g} mm"])
                axis.set_yticks([])
            row[0].set_ylabel(name)
        return figure
