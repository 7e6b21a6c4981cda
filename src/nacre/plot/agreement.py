"""What was measured against what a model gives: all values at once."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from nacre.arrays import Array
from nacre.plot.style import INK, LINES, SHEET_IN, house_style, new_figure, panel_title

DECADE = 10.0  # a span of values above it is drawn in logarithms
MOST_WAVES = 5


def agreement_figure(measured: Array, model: Array, angles_deg: Array, wavelengths_nm: Array, title: str) -> Figure:
    """Draw modelled over measured values with the line of agreement, and their difference over the angle of view.

    Args:
        measured, model: `[pair, wavelength]`, BSDF values in 1/sr.
        angles_deg: `[pair]`, of view, from the normal.
        wavelengths_nm: `[wavelength]`; of more than five, five are named, and all are drawn.
    """
    positive = measured[measured > 0.0]
    floor = float(positive.min()) if positive.size else 1e-6
    is_wide = positive.size > 0 and float(measured.max()) > DECADE * floor
    with house_style():
        figure = new_figure(SHEET_IN, 3.4)
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        left, right = figure.subplots(1, 2)
        named = np.unique(np.linspace(0, len(wavelengths_nm) - 1, min(MOST_WAVES, len(wavelengths_nm))).round())
        inks = [LINES[k * len(named) // len(wavelengths_nm) % len(LINES)] for k in range(len(wavelengths_nm))]
        scale = float(np.sqrt(np.mean(measured**2))) or 1.0
        for k, nm in enumerate(wavelengths_nm):
            label = f"{nm:g} nm" if k in named else None
            left.plot(measured[:, k], model[:, k], ".", markersize=3, color=inks[k], label=label)
            right.plot(angles_deg, 100.0 * (model - measured)[:, k] / scale, ".", markersize=3, color=inks[k])
        ends = np.array([floor if is_wide else 0.0, float(max(measured.max(), model.max(), floor))])
        left.plot(ends, ends, color=INK, linewidth=0.6)
        left.set(xlabel="Measured (1/sr)", ylabel="Fitted (1/sr)")
        if is_wide:
            left.set(xscale="log", yscale="log")
        left.legend(loc="best", handlelength=1.0, fontsize=6)
        right.axhline(0.0, color=INK, linewidth=0.6)
        right.set(xlabel="Angle of view (degrees)")
        panel_title(left, "Values")
        panel_title(right, "Fitted less measured, per cent of the rms")
    return figure
