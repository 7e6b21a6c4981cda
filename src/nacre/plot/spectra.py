"""Figures over wavelength and angle: spectra with their colours, colour ribbons, optical constants."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike

from nacre import light
from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_CURVES = 12
PART_TITLES = {
    "specular_reflectance": "Specular reflectance",
    "specular_transmittance": "Specular transmittance",
    "diffuse_reflectance": "Diffuse reflectance",
    "diffuse_transmittance": "Diffuse transmittance",
}


def parts_of(spectrum: Spectrum) -> dict[str, Array]:
    """Return the non-zero parts of a spectrum, at least one."""
    parts = spectrum.parts()
    if not parts:
        raise NacreError("the spectrum has neither reflectance nor transmittance")
    nonzero = {name: values for name, values in parts.items() if np.max(values) > 1e-9}
    return nonzero or dict(list(parts.items())[:1])


def spectrum_figure(spectrum: Spectrum, illuminant: str = "D65", title: str = "", step_label: str = "") -> Figure:
    """Draw reflectance and transmittance over wavelength, one curve an angle, each with its colour beside it.

    Args:
        spectrum: at most 12 angles are drawn as curves, evenly spaced among more.
        illuminant: lamp of the swatches.
        title: over the first panel.
        step_label: name of the parameter if `angles_deg` has values other than angles.
    """
    parts = parts_of(spectrum)
    nm = spectrum.wavelengths_nm
    count = len(spectrum.angles_deg)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MAX_CURVES)).round().astype(int))
    exposure = _common_exposure(parts, nm, illuminant)
    clipped = 0
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 0.35 + 1.65 * len(parts))
        grid = figure.add_gridspec(len(parts), 2, width_ratios=(1.0, 0.2))
        for row, (name, values) in enumerate(parts.items()):
            axes = figure.add_subplot(grid[row, 0])
            colours, _, count_clipped = style.shown_colours(values[chosen], nm, illuminant, exposure)
            clipped += count_clipped
            inks = style.angle_colours(len(chosen))
            for ink, curve in zip(inks, values[chosen]):
                axes.plot(nm, curve, color=ink)
            _frame(axes, nm, float(values[chosen].max()), last=row == len(parts) - 1)
            style.panel_title(axes, PART_TITLES[name] + (f", {title}" if title and row == 0 else ""))
            key = figure.add_subplot(grid[row, 1])
            _swatches(key, inks, colours, spectrum.angles_deg[chosen], step_label)
        style.small_print(figure, style.remark(illuminant, exposure, clipped, len(chosen) * len(parts)))
    return figure


def _common_exposure(parts: dict[str, Array], nm: Array, illuminant: str) -> float:
    return style.exposure_of(np.concatenate([light.spectrum_to_xyz(v, nm, illuminant) for v in parts.values()]))


def _frame(axes: Axes, nm: Array, highest: float, last: bool) -> None:
    axes.set_xlim(nm[0], nm[-1])
    top = 1.0 if highest > 0.5 else highest * 1.12
    axes.set_ylim(-0.03 * top, top * 1.01 if top > 0 else 1.0)
    axes.grid(axis="y")
    style.spectral_strip(axes, nm[0], nm[-1])
    if last:
        axes.set_xlabel("Wavelength (nm)")
    else:
        axes.tick_params(labelbottom=False)


def _swatches(axes: Axes, inks: list[Any], colours: Array, angles_deg: Array, step_label: str = "") -> None:
    """Draw the key: a stroke in the curve's ink, its colour as a tile, its angle."""
    rows = max(len(colours), 5)
    axes.set_xlim(0, 1)
    axes.set_ylim(rows, -0.1)
    for i, (ink, colour, angle) in enumerate(zip(inks, colours, angles_deg)):
        axes.plot([0.0, 0.16], [i + 0.45, i + 0.45], color=ink, solid_capstyle="butt", linewidth=1.6)
        axes.add_patch(Rectangle((0.24, i + 0.05), 0.3, 0.8, facecolor=colour, edgecolor=style.INK, linewidth=0.4))
        axes.text(0.62, i + 0.45, f"{angle:.4g}" if step_label else f"{angle:.3g}\u00b0", va="center", fontsize=6.5)
    if step_label:
        axes.text(
            0.0,
            rows + 0.1,
            step_label if len(step_label) < 14 else step_label.replace(".", ".\n"),
            va="top",
            fontsize=5.5,
        )
    axes.axis("off")


def ribbon_figure(
    spectrum: Spectrum, illuminant: str = "D65", title: str = "", step_label: str = "Angle of incidence (degrees)"
) -> Figure:
    """Draw colour over the incidence angle as a ribbon, with lightness and chroma below.

    Args:
        spectrum: at 2 angles or more, ascending; a degree apart looks smooth.
        illuminant: lamp.
        title: over the first ribbon.
        step_label: name of the parameter if `angles_deg` has values other than angles.
    """
    parts = parts_of(spectrum)
    nm, angles = spectrum.wavelengths_nm, spectrum.angles_deg
    if len(angles) < 2:
        raise NacreError("a ribbon needs 2 angles at least")
    exposure = _common_exposure(parts, nm, illuminant)
    white = light.white_xyz(illuminant)
    clipped = 0
    edges = style.cell_edges(angles)
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 1.55 + 0.62 * len(parts))
        grid = figure.add_gridspec(len(parts) + 1, 1, height_ratios=[*([0.42] * len(parts)), 1.0])
        below = figure.add_subplot(grid[-1])
        for row, (name, values) in enumerate(parts.items()):
            axes = figure.add_subplot(grid[row], sharex=below)
            colours, _, count = style.shown_colours(values, nm, illuminant, exposure)
            clipped += count
            axes.pcolormesh(edges, [0, 1], colours[None], rasterized=True)
            axes.set_yticks([])
            axes.tick_params(labelbottom=False)
            axes.spines[["left", "bottom"]].set_visible(False)
            style.panel_title(axes, PART_TITLES[name] + (f", {title}" if title and row == 0 else ""))
            lch = light.lab_to_lch(light.xyz_to_lab(light.spectrum_to_xyz(values, nm, illuminant), white))
            line_style = ("-", "--", ":", "-.")[row]
            suffix = f" {name.split('_')[1][0].upper()}" if len(parts) > 1 else ""
            below.plot(angles, lch[:, 0], line_style, color=style.LINES[6], label=f"L*{suffix}")
            below.plot(angles, lch[:, 1], line_style, color=style.LINES[0], label=f"C*{suffix}")
        below.set_xlim(angles[0], angles[-1])
        below.set_ylim(bottom=0)
        below.set_xlabel(step_label)
        below.set_ylabel("L*, C*")
        below.grid(axis="y")
        below.legend(
            ncols=2 * len(parts), loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, handlelength=1.6,
            columnspacing=1.0,
        )  # fmt: skip
        style.small_print(figure, style.remark(illuminant, exposure, clipped, len(angles) * len(parts)))
    return figure


def index_figure(
    wavelengths_nm: ArrayLike, n_complex: ArrayLike, title: str = "", source: str = "", splice_nm: float | None = None
) -> Figure:
    """Draw the optical constants n and k over wavelength.

    Args:
        wavelengths_nm: `[wavelength]`.
        n_complex: `[wavelength]`, n + ik; k has a second axis unless it is zero.
        title: the material; source: reference, in small print.
        splice_nm: end of the published data, drawn as a thin line.
    """
    nm, values = np.asarray(wavelengths_nm, dtype=float), np.asarray(n_complex, dtype=complex)
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 2.1)
        axes = figure.add_subplot()
        axes.plot(nm, values.real, color=style.LINES[0])
        axes.set_ylabel("$n$", color=style.LINES[0])
        axes.set_xlabel("Wavelength (nm)")
        axes.set_xlim(nm[0], nm[-1])
        _room(axes, values.real)
        axes.grid(axis="y")
        if values.imag.max() > 0.0:
            other = axes.twinx()
            other.plot(nm, values.imag, color=style.LINES[1], linestyle="--")
            other.set_ylabel("$k$", color=style.LINES[1])
            other.spines["right"].set_visible(True)
            low, high = float(values.imag.min()), float(values.imag.max())
            if low > 0.0 and high / low > 100.0:
                other.set_yscale("log")
            else:
                _room(other, values.imag)
                other.set_ylim(bottom=0.0)
        if splice_nm is not None and nm[0] < splice_nm < nm[-1]:
            axes.axvline(splice_nm, color=style.INK, linewidth=0.5, linestyle=":")
        style.spectral_strip(axes, nm[0], nm[-1])
        style.panel_title(axes, title)
        style.small_print(figure, "\n".join(textwrap.wrap(source, 84)[:3]))
    return figure


def _room(axes: Axes, values: Array) -> None:
    """Set axis limits with a margin; constants are not magnified."""
    low, high = float(values.min()), float(values.max())
    air = max(0.08 * (high - low), 0.01 * max(abs(high), 0.1))
    axes.set_ylim(low - air, high + air)
