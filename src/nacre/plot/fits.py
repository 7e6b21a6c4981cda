"""Figures of fits to several measurements: measured and fitted curves, with their residual below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array
from nacre.plot import style
from nacre.plot.style import Figure

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
            upper, lower = (
                axes[2 * (place // columns), place % columns],
                axes[2 * (place // columns) + 1, place % columns],
            )
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
