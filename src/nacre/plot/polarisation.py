"""Figures of polarised reflection: Psi and Delta, Mueller matrices, circular light."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.measure.polarisation import circular_reflection, ellipsometric_angles
from nacre.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_CURVES = 8
CONVENTION = "Delta for exp(+i w t); (p, s, k) right-handed"
CIRCULAR = "right circular: a right-handed screw in space at one time"


def ellipsometry_figure(spectrum: Spectrum, title: str = "") -> Figure:
    """Draw Psi and Delta over wavelength, one curve an angle of incidence.

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
                axes.tick_params(labelbottom=i == 3, labelleft=j == 0)
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


FIGURES: Mapping[str, Callable[[Spectrum, str], Figure]] = {
    "ellipsometry": ellipsometry_figure,
    "mueller": mueller_figure,
    "circular": circular_figure,
}
ANGLES_DEG: Mapping[str, tuple[float, ...]] = {
    "ellipsometry": (65.0, 70.0, 75.0),
    "mueller": (0.0, 30.0, 60.0),
    "circular": (0.0, 30.0, 60.0),
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
