"""Figures of polarised light: Psi and Delta, Mueller matrices, circular light, interference colours of retarders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from nacre import light
from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.measure.polarisation import circular_reflection, crossed_polarisers, ellipsometric_angles, retardance_nm
from nacre.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_CURVES = 8
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
        upper.set_ylabel("Psi (degrees)")
        lower.set_ylabel("Delta (degrees)")
        upper.tick_params(labelbottom=False)
        lower.set_xlabel("Wavelength (nm)")
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
    found = circular_reflection(_matrices(spectrum))
    panels = {"Right circular": found.right, "Left circular": found.left, "Dissymmetry g": found.dissymmetry}
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
    own, found = crossed_polarisers(matrices), retardance_nm(matrices, lam)
    last = MICHEL_LEVY_NM if found is None else max(MICHEL_LEVY_NM, 1.1 * found)
    retardances = np.linspace(0.0, last, 1001)
    colours = light.spectrum_to_srgb(np.sin(np.pi * retardances[:, None] / lam) ** 2, lam)
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 3.4)
        upper, lower = figure.subplots(2, 1, height_ratios=(1, 7))
        upper.imshow(light.spectrum_to_srgb(own, lam)[None, None], aspect="auto")
        upper.set_xticks([])
        upper.set_yticks([])
        at = "" if found is None else f", retardance {found:.0f} nm"
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
        if found is not None:
            lower.axvline(found, color="black", linewidth=1.2, linestyle="--")
        lower.set_xlim(0.0, last)
        lower.set_ylim(0.0, THICKEST_UM)
        lower.set_xlabel("Retardance (nm)")
        lower.set_ylabel("Thickness (um)")
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
    chosen = np.unique(np.linspace(0, count - 1, min(count, MAX_CURVES)).round().astype(int))
    for ink, row in zip(style.angle_colours(len(chosen)), chosen):
        axes.plot(spectrum.wavelengths_nm, values[row], color=ink, label=f"{spectrum.angles_deg[row]:.3g}\u00b0")
    axes.set_xlim(spectrum.wavelengths_nm[0], spectrum.wavelengths_nm[-1])
    axes.grid(axis="y")
    if has_key:
        axes.legend(fontsize=6, ncols=min(len(chosen), 4), loc="best", handlelength=1.2, columnspacing=0.8)
