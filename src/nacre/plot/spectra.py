"""Figures over wavelength and angle: spectra with their colours, colour ribbons, optical constants."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike

from nacre import light
from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.measure.evaluate import circular_reflection, crossed_polarisers, ellipsometric_angles, retardance_nm
from nacre.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SPECTRA_MAX_CURVES = 12
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
    chosen = np.unique(np.linspace(0, count - 1, min(count, SPECTRA_MAX_CURVES)).round().astype(int))
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
    axes.set(xlim=(0, 1), ylim=(rows, -0.1))
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
        below.set(xlim=(angles[0], angles[-1]), ylim=(0, None), xlabel=step_label, ylabel="L*, C*")
        below.grid(axis="y")
        below.legend(
            ncols=2 * len(parts), loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, handlelength=1.6,
            columnspacing=1.0,
        )  # fmt: skip
        style.small_print(figure, style.remark(illuminant, exposure, clipped, len(angles) * len(parts)))
    return figure


def index_figure(wavelengths_nm: ArrayLike, n_complex: ArrayLike, title: str = "", source: str = "") -> Figure:
    """Draw the optical constants n and k over wavelength.

    Args:
        wavelengths_nm: `[wavelength]`.
        n_complex: `[wavelength]`, n + ik; k has a second axis unless it is zero.
        title: the material; source: reference, in small print.
    """
    nm, values = np.asarray(wavelengths_nm, dtype=float), np.asarray(n_complex, dtype=complex)
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 2.1)
        axes = figure.add_subplot()
        axes.plot(nm, values.real, color=style.LINES[0])
        axes.set_ylabel("$n$", color=style.LINES[0])
        axes.set(xlabel="Wavelength (nm)", xlim=(nm[0], nm[-1]))
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
        style.spectral_strip(axes, nm[0], nm[-1])
        style.panel_title(axes, title)
        style.small_print(figure, "\n".join(textwrap.wrap(source, 84)[:3]))
    return figure


def _room(axes: Axes, values: Array) -> None:
    """Set axis limits with a margin; constants are not magnified."""
    low, high = float(values.min()), float(values.max())
    air = max(0.08 * (high - low), 0.01 * max(abs(high), 0.1))
    axes.set_ylim(low - air, high + air)


# Figures of polarised light: Psi and Delta, Mueller matrices, circular light, interference colours of retarders.

MAX_ANGLES = 8
CONVENTION = "Delta for exp(+i w t); (p, s, k) right-handed"
MICHEL_LEVY_NM, THICKEST_UM = 2500.0, 50.0  # extent of the chart
BIREFRINGENCES = (0.004, 0.008, 0.012, 0.02, 0.03, 0.05, 0.1, 0.2)
CIRCULAR = "right circular: a right-handed screw in space at one time"


def ellipsometry_figure(spectrum: Spectrum, title: str = "") -> Figure:
    """Draw Psi and Delta over wavelength, one curve per angle of incidence.

    Raises:
        NacreError: the spectrum has no Mueller matrices.
    """
    psi, delta = ellipsometric_angles(_matrices(spectrum))
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 3.4)
        upper, lower = (figure.add_subplot(2, 1, row) for row in (1, 2))
        _curves(upper, spectrum, psi, has_key=True)
        _curves(lower, spectrum, delta)
        upper.set(ylabel="Psi (degrees)")
        lower.set(xlabel="Wavelength (nm)", ylabel="Delta (degrees)")
        upper.tick_params(labelbottom=False)
        style.panel_title(upper, f"Ellipsometry{', ' + title if title else ''}")
        style.small_print(figure, CONVENTION)
    return figure


def mueller_figure(spectrum: Spectrum, title: str = "") -> Figure:
    """Draw the Mueller matrix of reflection over wavelength, elements divided by the first, one curve an angle.

    Raises:
        NacreError: the spectrum has no Mueller matrices.
    """
    matrices = _matrices(spectrum)
    power = matrices[..., :1, :1]
    relative = matrices / np.where(power > 0, power, 1.0)
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 5.4)
        for i in range(4):
            for j in range(4):
                axes = figure.add_subplot(4, 4, 4 * i + j + 1)
                is_first = i == j == 0
                _curves(axes, spectrum, (matrices if is_first else relative)[..., i, j], has_key=is_first)
                axes.set_ylim(*((0.0, 1.0) if is_first else (-1.05, 1.05)))
                axes.tick_params(labelbottom=i == 3, labelleft=j == 0 or 4 * i + j == 1)
                style.panel_title(axes, "R" if is_first else f"m{i + 1}{j + 1}")
                if i == 3:
                    axes.set_xlabel("Wavelength (nm)")
        texts = (title, "(p, s, k) right-handed, S1 = p - s", CIRCULAR)
        style.small_print(figure, "; ".join(text for text in texts if text))
    return figure


def circular_figure(spectrum: Spectrum, title: str = "") -> Figure:
    """Draw the reflectance of right and left circular light and their dissymmetry, one curve an angle.

    Raises:
        NacreError: the spectrum has no Mueller matrices.
    """
    result = circular_reflection(_matrices(spectrum))
    panels = {"Right circular": result.right, "Left circular": result.left, "Dissymmetry g": result.dissymmetry}
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 4.6)
        for row, (name, values) in enumerate(panels.items()):
            axes = figure.add_subplot(3, 1, row + 1)
            _curves(axes, spectrum, values, has_key=row == 0)
            axes.set_ylim(*((-2.1, 2.1) if row == 2 else (0.0, 1.02)))
            axes.tick_params(labelbottom=row == 2)
            style.panel_title(axes, name + (f", {title}" if title and row == 0 else ""))
            style.spectral_strip(axes, spectrum.wavelengths_nm[0], spectrum.wavelengths_nm[-1])
            if row == 2:
                axes.set_xlabel("Wavelength (nm)")
        style.small_print(figure, CIRCULAR)
    return figure


def michel_levy_figure(spectrum: Spectrum, title: str = "") -> Figure:
    """Draw the interference colours of retarders between crossed polarisers, and mark the material's own.

    The chart of Michel-Levy: colours under D65 over the retardance, lines of equal birefringence over the thickness.
    The strip above it is the material's colour in transmitted light, turned to its brightest position; where it is a
    retarder, a line marks its retardance.

    Raises:
        NacreError: the spectrum has no Mueller matrices of transmission, or does not span the visible range.
    """
    if spectrum.mueller_transmitted is None:
        raise NacreError("the Michel-Levy chart is for transmitted light, of which there are no Mueller matrices")
    lam = spectrum.wavelengths_nm
    if not light.spans_colour(lam):
        raise NacreError("the Michel-Levy chart needs wavelengths over the whole visible range")
    matrices = spectrum.mueller_transmitted[0]
    own, retardance = crossed_polarisers(matrices), retardance_nm(matrices, lam)
    last = MICHEL_LEVY_NM if retardance is None else max(MICHEL_LEVY_NM, 1.1 * retardance)
    retardances = np.linspace(0.0, last, 1001)
    colours = light.spectrum_to_srgb(np.sin(np.pi * retardances[:, None] / lam) ** 2, lam)
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 3.4)
        upper, lower = figure.subplots(2, 1, height_ratios=(1, 7))
        upper.imshow(light.spectrum_to_srgb(own, lam)[None, None], aspect="auto")
        upper.set(xticks=[], yticks=[])
        at = "" if retardance is None else f", retardance {retardance:.0f} nm"
        style.panel_title(upper, f"Between crossed polarisers{': ' + title if title else ''}{at}")
        lower.imshow(colours[None], extent=(0.0, last, 0.0, THICKEST_UM), aspect="auto", origin="lower")
        for birefringence in BIREFRINGENCES:
            end = min(last, birefringence * THICKEST_UM * 1000.0)
            height = end / (birefringence * 1000.0)
            lower.plot([0.0, end], [0.0, height], color="0.15", linewidth=0.6)
            place, side = ((end, THICKEST_UM), "bottom") if end < last else ((last, height), "center")
            lower.annotate(
                f" {birefringence:g}", place, fontsize=6, va=side, ha="center" if end < last else "left", clip_on=False
            )
        if retardance is not None:
            lower.axvline(retardance, color="black", linewidth=1.2, linestyle="--")
        lower.set(xlim=(0.0, last), ylim=(0.0, THICKEST_UM), xlabel="Retardance (nm)", ylabel="Thickness (um)")
        style.small_print(figure, "Colours under D65, of equal retardance at all wavelengths; lines: birefringence")
    return figure


FIGURES: Mapping[str, Callable[[Spectrum, str], Figure]] = {
    "ellipsometry": ellipsometry_figure,
    "mueller": mueller_figure,
    "circular": circular_figure,
    "michel-levy": michel_levy_figure,
}
ANGLES_DEG: Mapping[str, tuple[float, ...]] = {
    "ellipsometry": (65.0, 70.0, 75.0),
    "mueller": (0.0, 30.0, 60.0),
    "circular": (0.0, 30.0, 60.0),
    "michel-levy": (0.0,),
}


def _matrices(spectrum: Spectrum) -> Array:
    if spectrum.mueller_reflected is None:
        raise NacreError("the spectrum has no Mueller matrices of reflection")
    return spectrum.mueller_reflected


def _curves(axes: Axes, spectrum: Spectrum, values: Array, has_key: bool = False) -> None:
    count = len(spectrum.angles_deg)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MAX_ANGLES)).round().astype(int))
    for ink, row in zip(style.angle_colours(len(chosen)), chosen):
        axes.plot(spectrum.wavelengths_nm, values[row], color=ink, label=f"{spectrum.angles_deg[row]:.3g}\u00b0")
    axes.set_xlim(spectrum.wavelengths_nm[0], spectrum.wavelengths_nm[-1])
    axes.grid(axis="y")
    if has_key:
        axes.legend(fontsize=6, ncols=min(len(chosen), 4), loc="best", handlelength=1.2, columnspacing=0.8)
