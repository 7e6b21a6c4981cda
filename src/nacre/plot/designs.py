"""The sheet of a design: what was asked beside what is reached, over the angle, over wavelength, and of what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from nacre.arrays import Array
from nacre.plot.style import (
    INK,
    LINES,
    SHEET_IN,
    angle_colours,
    cell_edges,
    house_style,
    new_figure,
    panel_title,
    remark,
    shown_colours,
    small_print,
    spectral_strip,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_SWATCHES, MOST_CURVES, MOST_BARS, MOST_NAMED = 24, 10, 8, 30
LONGEST_NAME = 24  # characters that the panel of layers has room for
LINE_OF_NAMES = 0.06  # of the panel's height
THINNEST_DRAWN = 0.035  # of the whole height: a layer of some nanometres is drawn thicker than it is
QUIET = "#5a6b7c"


@dataclass(frozen=True)
class Swatch:
    """Two colours side by side: `label`, screen colours `asked` and `reached` as #rrggbb, and the distance in words."""

    label: str
    asked: str
    reached: str
    distance: str


@dataclass(frozen=True)
class DesignSheet:
    """What the sheet shows.

    Attributes:
        title: over it.
        swatches: one each want and lamp.
        wavelengths_nm: `[wavelength]`, of all spectra.
        curves: label -> factor `[wavelength]`.
        wanted: label -> wavelengths and factors `[2, n]` of wanted spectra.
        ribbon_deg, ribbon: angles `[angle]` and factors `[angle, wavelength]`; ribbon_label: of the angle.
        media: names from the light's side, ambient and substrate included; thicknesses_nm: one each layer; empty where
            the material is no stack.
        numbers: lines of text that stand in place of a stack.
        bars: (path, value) of the sensitivity, the largest first; bars_title: what it is.
        illuminant: of the ribbon.
        words: what the left and the right half of a swatch are called, and the first of them the wanted curves.
    """

    title: str
    swatches: Sequence[Swatch]
    wavelengths_nm: Array
    curves: dict[str, Array]
    wanted: dict[str, Array]
    ribbon_deg: Array
    ribbon: Array
    ribbon_label: str
    media: Sequence[str]
    thicknesses_nm: Sequence[float]
    numbers: Sequence[str]
    bars: Sequence[tuple[str, float]]
    bars_title: str
    illuminant: str = "D65"
    words: tuple[str, str] = ("asked", "reached")


def design_figure(sheet: DesignSheet) -> Figure:
    """Draw a design's sheet: swatches asked and reached, ribbon over the angle, spectra, layers, sensitivity."""
    rows = (min(len(sheet.swatches), MOST_SWATCHES) + 2) // 3  # none of spectra
    colours, exposure, clipped = shown_colours(sheet.ribbon, sheet.wavelengths_nm, sheet.illuminant)
    with house_style():
        figure = new_figure(SHEET_IN, 3.9 + 0.42 * rows)
        figure.suptitle(sheet.title, fontsize=9, x=0.01, ha="left")
        outer = figure.add_gridspec(2, 1, height_ratios=(0.42 * rows + 0.1, 3.6))
        if rows:
            _swatches(figure.add_subplot(outer[0]), sheet.swatches, rows)
        inner = outer[1].subgridspec(2, 2, width_ratios=(1.45, 1.0), height_ratios=(0.3, 1.0))
        _ribbon(figure.add_subplot(inner[0, 0]), sheet, colours)
        _curves(figure.add_subplot(inner[1, 0]), sheet)
        side = inner[:, 1].subgridspec(2, 1, height_ratios=(1.25, 1.0))
        _layers(figure.add_subplot(side[0]), sheet)
        _bars(figure.add_subplot(side[1]), sheet)
        small_print(
            figure,
            remark(sheet.illuminant, exposure, clipped, len(colours))
            + f"; left {sheet.words[0]}, right {sheet.words[1]}",
        )
    return figure


def _swatches(axes: Axes, swatches: Sequence[Swatch], rows: int) -> None:
    axes.set(xlim=(0, 3), ylim=(rows, 0))
    axes.axis("off")
    for i, swatch in enumerate(swatches[:MOST_SWATCHES]):
        x, y = i % 3, i // 3
        for shift, colour in ((0.0, swatch.asked), (0.2, swatch.reached)):
            axes.add_patch(Rectangle((x + shift, y + 0.1), 0.2, 0.8, facecolor=colour, edgecolor="none"))
        axes.add_patch(Rectangle((x, y + 0.1), 0.4, 0.8, facecolor="none", edgecolor=INK, linewidth=0.4))
        axes.text(x + 0.43, y + 0.34, swatch.label, va="center", fontsize=6.5)
        axes.text(x + 0.43, y + 0.68, swatch.distance, va="center", fontsize=6.5, color=QUIET)
    if len(swatches) > MOST_SWATCHES:
        axes.text(3, rows, f"and {len(swatches) - MOST_SWATCHES} more", ha="right", va="bottom", fontsize=6)


def _ribbon(axes: Axes, sheet: DesignSheet, colours: Array) -> None:
    axes.pcolormesh(cell_edges(sheet.ribbon_deg), [0, 1], colours[None], rasterized=True)
    axes.set(yticks=[], xlabel=sheet.ribbon_label, xlim=(sheet.ribbon_deg[0], sheet.ribbon_deg[-1]))
    axes.spines["left"].set_visible(False)


def _curves(axes: Axes, sheet: DesignSheet) -> None:
    names = list(sheet.curves)[:MOST_CURVES]
    for ink, name in zip(angle_colours(len(names)), names):
        axes.plot(sheet.wavelengths_nm, sheet.curves[name], color=ink, label=name)
    for name, (nm, values) in sheet.wanted.items():
        axes.plot(nm, values, "--", color=LINES[1], linewidth=0.9, label=f"{name}, {sheet.words[0]}")
    top = max([float(np.max(c)) for c in sheet.curves.values()] + [float(np.max(v[1])) for v in sheet.wanted.values()])
    top = 1.0 if 0.5 < top <= 1.0 else max(1.1 * top, 1e-3)
    axes.set(
        xlim=(sheet.wavelengths_nm[0], sheet.wavelengths_nm[-1]), ylim=(-0.03 * top, top), xlabel="Wavelength (nm)"
    )
    axes.grid(axis="y")
    spectral_strip(axes, float(sheet.wavelengths_nm[0]), float(sheet.wavelengths_nm[-1]))
    axes.legend(loc="best", handlelength=1.4, fontsize=6)
    panel_title(axes, "Factor (white is 1)")


def _layers(axes: Axes, sheet: DesignSheet) -> None:
    axes.set(xlim=(0, 1), ylim=(1, 0), xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set_visible(False)
    if not sheet.media:
        for i, line in enumerate(sheet.numbers[:14]):
            axes.text(0.0, 0.04 + 0.07 * i, line, fontsize=6, va="top")
        panel_title(axes, "What was chosen")
        return
    total = float(np.sum(sheet.thicknesses_nm))
    drawn = np.maximum(np.asarray(sheet.thicknesses_nm, dtype=float) / max(total, 1e-9), THINNEST_DRAWN)
    drawn = 0.72 * drawn / max(float(drawn.sum()), 1e-9) if len(drawn) else drawn
    edges = np.concatenate([[0.0, 0.12], 0.12 + np.cumsum(drawn), [1.0]])
    kinds = list(dict.fromkeys(sheet.media[1:-1]))
    beside = apart(0.5 * (edges[:-1] + edges[1:]), LINE_OF_NAMES)  # names of thin neighbours would cover each other
    for i, name in enumerate(sheet.media):
        is_layer = 0 < i < len(sheet.media) - 1
        face = LINES[kinds.index(name) % (len(LINES) - 1)] if is_layer else ("white" if i == 0 else "#cfcfcf")
        height = float(edges[i + 1] - edges[i])
        axes.add_patch(Rectangle((0, edges[i]), 0.42, height, facecolor=face, alpha=0.55 if is_layer else 1.0,
                                 edgecolor="white", linewidth=0.6))  # fmt: skip
        if len(sheet.media) <= MOST_NAMED:
            known = _short(name)
            text = f"{known}, {sheet.thicknesses_nm[i - 1]:.4g} nm" if is_layer else known
            axes.text(0.46, beside[i], text, va="center", fontsize=min(6.0, 150.0 / len(sheet.media)))
    panel_title(axes, f"Layers, {total:.0f} nm in all")


def apart(places: Array, least: float) -> Array:
    """Return ascending places in [0, 1] moved so that neighbours are `least` apart, or evenly apart where many are.

    Example: `apart([0.1, 0.5, 0.51], 0.05)` is [0.1, 0.5, 0.55].
    """
    steps = np.arange(len(places)) * min(least, 1.0 / max(len(places) - 1, 1))
    lowered = np.maximum.accumulate(places - steps) + steps
    room = 1.0 - steps[-1] + steps  # the last may have been pushed out
    return np.minimum(lowered, room)


def _short(name: str) -> str:
    """Return a medium's name as it fits beside a layer; of a long path, or an entry of a database, its end."""
    return name if len(name) <= LONGEST_NAME else "\u2026" + name[1 - LONGEST_NAME :]


def _bars(axes: Axes, sheet: DesignSheet) -> None:
    bars = list(sheet.bars)[:MOST_BARS]
    axes.barh(range(len(bars)), [value for _, value in bars], color=LINES[0], height=0.3)
    for i, (path, value) in enumerate(bars):
        # above its bar: a path may be longer than the panel has room for beside it
        axes.text(0.0, i - 0.22, f"{path.removesuffix('.thickness_nm')}: {value:.2g}", fontsize=5.5, va="bottom")
    axes.set(ylim=(max(len(bars), 3) - 0.6, -0.7), xlim=(0, None), yticks=[])
    axes.grid(axis="x")
    panel_title(axes, sheet.bars_title)
