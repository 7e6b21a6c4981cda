"""Full-page figures: fits, designs, images, run sheets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LOG_SPAN = 10.0  # larger ratios are drawn on logarithmic axes
MAX_NAMED_WAVES = 5


def agreement_figure(measured: Array, model: Array, angles_deg: Array, wavelengths_nm: Array, title: str) -> Figure:
    """Draw modelled over measured values, and their difference over the view angle.

    Args:
        measured, model: `[pair, wavelength]`, BSDF values in 1/sr.
        angles_deg: `[pair]`, view angle from the normal.
        wavelengths_nm: `[wavelength]`; at most five are named in the key.
    """
    positive = measured[measured > 0.0]
    floor = float(positive.min()) if positive.size else 1e-6
    is_wide = positive.size > 0 and float(measured.max()) > LOG_SPAN * floor
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 3.4)
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        left, right = figure.subplots(1, 2)
        named = np.unique(np.linspace(0, len(wavelengths_nm) - 1, min(MAX_NAMED_WAVES, len(wavelengths_nm))).round())
        inks = [
            style.LINES[k * len(named) // len(wavelengths_nm) % len(style.LINES)] for k in range(len(wavelengths_nm))
        ]
        scale = float(np.sqrt(np.mean(measured**2))) or 1.0
        for k, nm in enumerate(wavelengths_nm):
            label = f"{nm:g} nm" if k in named else None
            left.plot(measured[:, k], model[:, k], ".", markersize=3, color=inks[k], label=label)
            right.plot(angles_deg, 100.0 * (model - measured)[:, k] / scale, ".", markersize=3, color=inks[k])
        ends = np.array([floor if is_wide else 0.0, float(max(measured.max(), model.max(), floor))])
        left.plot(ends, ends, color=style.INK, linewidth=0.6)
        left.set(xlabel="Measured (1/sr)", ylabel="Fitted (1/sr)")
        if is_wide:
            left.set(xscale="log", yscale="log")
        left.legend(loc="best", handlelength=1.0, fontsize=6)
        right.axhline(0.0, color=style.INK, linewidth=0.6)
        right.set(xlabel="Angle of view (degrees)")
        style.panel_title(left, "Values")
        style.panel_title(right, "Fitted less measured, per cent of the rms")
    return figure


# Design sheet: target and result, colour over the angle, spectra, layers.

MAX_SWATCHES, MAX_CURVES, MAX_BARS, MAX_NAMED = 24, 10, 8, 30
LONGEST_NAME = 24
LABEL_HEIGHT = 0.06  # relative to the panel
MIN_LAYER_HEIGHT = 0.035  # relative to the panel; thinner layers are exaggerated
QUIET = "#5a6b7c"


@dataclass(frozen=True)
class Swatch:
    """Two adjacent colours: `label`, sRGB colours `asked` and `reached` as #rrggbb, and a text with their distance."""

    label: str
    asked: str
    reached: str
    distance: str


@dataclass(frozen=True)
class DesignSheet:
    """Contents of the sheet.

    Attributes:
        title: over it.
        swatches: one for each target and lamp.
        wavelengths_nm: `[wavelength]`, for all spectra.
        curves: label -> factor `[wavelength]`.
        wanted: label -> wavelengths and factors `[2, n]` of target spectra.
        ribbon_deg, ribbon: angles `[angle]` and factors `[angle, wavelength]`; ribbon_label: angle name.
        media: names from the light's side, ambient and substrate included; thicknesses_nm: one per layer; empty if
            the material is not a stack.
        numbers: text lines that replace the stack.
        bars: (path, value) pairs, the largest first; bars_title: their meaning.
        illuminant: lamp of the ribbon.
        words: names of the left and the right half of a swatch; the first also names target curves.
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
    rows = (min(len(sheet.swatches), MAX_SWATCHES) + 2) // 3  # spectra lack a swatch
    colours, exposure, clipped = style.shown_colours(sheet.ribbon, sheet.wavelengths_nm, sheet.illuminant)
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 3.9 + 0.42 * rows)
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
        style.small_print(
            figure,
            style.remark(sheet.illuminant, exposure, clipped, len(colours))
            + f"; left {sheet.words[0]}, right {sheet.words[1]}",
        )
    return figure


def _swatches(axes: Axes, swatches: Sequence[Swatch], rows: int) -> None:
    axes.set(xlim=(0, 3), ylim=(rows, 0))
    axes.axis("off")
    for i, swatch in enumerate(swatches[:MAX_SWATCHES]):
        x, y = i % 3, i // 3
        for shift, colour in ((0.0, swatch.asked), (0.2, swatch.reached)):
            axes.add_patch(Rectangle((x + shift, y + 0.1), 0.2, 0.8, facecolor=colour, edgecolor="none"))
        axes.add_patch(Rectangle((x, y + 0.1), 0.4, 0.8, facecolor="none", edgecolor=style.INK, linewidth=0.4))
        axes.text(x + 0.43, y + 0.34, swatch.label, va="center", fontsize=6.5)
        axes.text(x + 0.43, y + 0.68, swatch.distance, va="center", fontsize=6.5, color=QUIET)
    if len(swatches) > MAX_SWATCHES:
        axes.text(3, rows, f"and {len(swatches) - MAX_SWATCHES} more", ha="right", va="bottom", fontsize=6)


def _ribbon(axes: Axes, sheet: DesignSheet, colours: Array) -> None:
    axes.pcolormesh(style.cell_edges(sheet.ribbon_deg), [0, 1], colours[None], rasterized=True)
    axes.set(yticks=[], xlabel=sheet.ribbon_label, xlim=(sheet.ribbon_deg[0], sheet.ribbon_deg[-1]))
    axes.spines["left"].set_visible(False)


def _curves(axes: Axes, sheet: DesignSheet) -> None:
    names = list(sheet.curves)[:MAX_CURVES]
    for ink, name in zip(style.angle_colours(len(names)), names):
        axes.plot(sheet.wavelengths_nm, sheet.curves[name], color=ink, label=name)
    for name, (nm, values) in sheet.wanted.items():
        axes.plot(nm, values, "--", color=style.LINES[1], linewidth=0.9, label=f"{name}, {sheet.words[0]}")
    top = max([float(np.max(c)) for c in sheet.curves.values()] + [float(np.max(v[1])) for v in sheet.wanted.values()])
    top = 1.0 if 0.5 < top <= 1.0 else max(1.1 * top, 1e-3)
    axes.set(
        xlim=(sheet.wavelengths_nm[0], sheet.wavelengths_nm[-1]), ylim=(-0.03 * top, top), xlabel="Wavelength (nm)"
    )
    axes.grid(axis="y")
    style.spectral_strip(axes, float(sheet.wavelengths_nm[0]), float(sheet.wavelengths_nm[-1]))
    axes.legend(loc="best", handlelength=1.4, fontsize=6)
    style.panel_title(axes, "Factor (white is 1)")


def _layers(axes: Axes, sheet: DesignSheet) -> None:
    axes.set(xlim=(0, 1), ylim=(1, 0), xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set_visible(False)
    if not sheet.media:
        for i, line in enumerate(sheet.numbers[:14]):
            axes.text(0.0, 0.04 + 0.07 * i, line, fontsize=6, va="top")
        style.panel_title(axes, "Parameters")
        return
    total = float(np.sum(sheet.thicknesses_nm))
    drawn = np.maximum(np.asarray(sheet.thicknesses_nm, dtype=float) / max(total, 1e-9), MIN_LAYER_HEIGHT)
    drawn = 0.72 * drawn / max(float(drawn.sum()), 1e-9) if len(drawn) else drawn
    edges = np.concatenate([[0.0, 0.12], 0.12 + np.cumsum(drawn), [1.0]])
    kinds = list(dict.fromkeys(sheet.media[1:-1]))
    beside = apart(0.5 * (edges[:-1] + edges[1:]), LABEL_HEIGHT)  # labels of thin layers would overlap
    for i, name in enumerate(sheet.media):
        is_layer = 0 < i < len(sheet.media) - 1
        face = (
            style.LINES[kinds.index(name) % (len(style.LINES) - 1)] if is_layer else ("white" if i == 0 else "#cfcfcf")
        )
        height = float(edges[i + 1] - edges[i])
        axes.add_patch(Rectangle((0, edges[i]), 0.42, height, facecolor=face, alpha=0.55 if is_layer else 1.0,
                                 edgecolor="white", linewidth=0.6))  # fmt: skip
        if len(sheet.media) <= MAX_NAMED:
            name_length = _short(name)
            text = f"{name_length}, {sheet.thicknesses_nm[i - 1]:.4g} nm" if is_layer else name_length
            axes.text(0.46, beside[i], text, va="center", fontsize=min(6.0, 150.0 / len(sheet.media)))
    style.panel_title(axes, f"Layers, {total:.0f} nm in all")


def apart(places: Array, least: float) -> Array:
    """Move ascending positions in [0, 1] to a distance of at least `least`, or space them evenly if they are many.

    Example:
        >>> np.asarray(apart([0.1, 0.5, 0.51], 0.05)).round(6).tolist()
        [0.1, 0.5, 0.55]
    """
    steps = np.arange(len(places)) * min(least, 1.0 / max(len(places) - 1, 1))
    lowered = np.maximum.accumulate(places - steps) + steps
    room = 1.0 - steps[-1] + steps  # limit of each position
    return np.minimum(lowered, room)


def _short(name: str) -> str:
    """Shorten a medium's name to its end."""
    return name if len(name) <= LONGEST_NAME else "\u2026" + name[1 - LONGEST_NAME :]


def _bars(axes: Axes, sheet: DesignSheet) -> None:
    bars = list(sheet.bars)[:MAX_BARS]
    axes.barh(range(len(bars)), [value for _, value in bars], color=style.LINES[0], height=0.3)
    for i, (path, value) in enumerate(bars):
        # above its bar, since paths are long
        axes.text(0.0, i - 0.22, f"{path.removesuffix('.thickness_nm')}: {value:.2g}", fontsize=5.5, va="bottom")
    axes.set(ylim=(max(len(bars), 3) - 0.6, -0.7), xlim=(0, None), yticks=[])
    axes.grid(axis="x")
    style.panel_title(axes, sheet.bars_title)


# Image sheet: target and result, their distance, and the parameter maps.

MIN_SCALE_DE00 = 10.0  # smallest upper end of the distance scale
OUT, IN = "#d55e00", "#f4f4f4"


@dataclass(frozen=True, eq=False)
class PictureSheet:
    """Contents of the sheet.

    Attributes:
        title: over it.
        asked, reached: `[row, column, 3]`, encoded sRGB, the first row on top.
        distance: `[row, column]`, dE00.
        is_mapped: `[row, column]`, whether a pixel was out of gamut.
        maps: name and `[row, column]` values for each parameter.
        note: small print.
    """

    title: str
    asked: Array
    reached: Array
    distance: Array
    is_mapped: NDArray[np.bool_]
    maps: Sequence[tuple[str, Array]]
    note: str


def picture_figure(sheet: PictureSheet) -> Figure:
    """Draw the sheet."""
    rows, columns = sheet.distance.shape
    high = min(max(rows / columns, 0.4), 1.6)
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 0.6 + high * (style.SHEET_IN / 2.0 + style.SHEET_IN / 3.2))
        figure.suptitle(sheet.title, fontsize=8.5, x=0.01, ha="left")
        outer = figure.add_gridspec(2, 1, height_ratios=(3.2 / 2.0, 1.0))
        top = outer[0].subgridspec(1, 2)
        _shown(figure.add_subplot(top[0]), sheet.asked, "Asked")
        _shown(figure.add_subplot(top[1]), sheet.reached, "Reached")
        bottom = outer[1].subgridspec(1, 2 + len(sheet.maps))
        far = max(MIN_SCALE_DE00, float(np.percentile(sheet.distance, 99.0)))
        _scaled(figure, figure.add_subplot(bottom[0]), sheet.distance, "dE00", "magma", 0.0, far)
        axes = figure.add_subplot(bottom[1])
        _shown(axes, np.where(sheet.is_mapped[..., None], to_rgb(OUT), to_rgb(IN)), "Out of reach (orange)")
        for k, (name, values) in enumerate(sheet.maps):
            low, top_value = float(values.min()), float(values.max())
            _scaled(figure, figure.add_subplot(bottom[2 + k]), values, name, "viridis", low, top_value)
        style.small_print(figure, sheet.note)
    return figure


def _shown(axes: Axes, pixels: Array, title: str) -> None:
    axes.imshow(np.clip(pixels, 0.0, 1.0), interpolation="nearest")
    _bare(axes, title)


def _scaled(figure: Figure, axes: Axes, values: Array, title: str, colours: str, low: float, high: float) -> None:
    drawn: Any = axes.imshow(values, cmap=colours, vmin=low, vmax=max(high, low + 1e-9), interpolation="nearest")
    bar = figure.colorbar(drawn, ax=axes, orientation="horizontal", fraction=0.06, pad=0.03)
    bar.ax.tick_params(labelsize=5.5)
    _bare(axes, title)


def _bare(axes: Axes, title: str) -> None:
    axes.set(xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set_visible(False)
    style.panel_title(axes, title)


def run_sheet_figure(curves: Sequence[tuple[str, Array, Array, Array, Array]], y_label: str, title: str) -> Figure:
    """Draw one curve for each layer, one after another, with its turning points and its stop.

    Args:
        curves: (material, grown thickness nm, signal, thickness of the turning points, signal there).
    """
    materials = list(dict.fromkeys(name for name, *_ in curves))
    named: set[str] = set()
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 3.0)
        axes = figure.subplots()
        total = 0.0
        for name, grown, signal, turns, levels in curves:
            ink = style.LINES[materials.index(name) % len(style.LINES)]
            axes.plot(total + grown, 100 * signal, color=ink, linewidth=1.0, label=None if name in named else name)
            axes.plot(total + turns, 100 * levels, "o", color=ink, markersize=2.5)
            total += float(grown[-1])
            axes.axvline(total, color=style.INK, linewidth=0.3)
            named.add(name)
        axes.set(xlim=(0.0, total), xlabel="Deposited thickness (nm)", ylabel=y_label)
        axes.set_title(title, loc="left")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
