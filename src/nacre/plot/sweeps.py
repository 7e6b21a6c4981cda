"""Sweep figures: CIELAB gamut, colour maps over two parameters, parallel coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from nacre import light
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.plot import style
from nacre.plot.colours import draw_hue_circle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_LINES = 4000  # more would overlap and enlarge a PDF
MISSING = (0.93, 0.93, 0.93)
GROUND = "#c4c4c4"  # background of coloured lines, some of them white


@dataclass(frozen=True)
class AxisValues:
    """An axis: label, values, and words if the values are indices of words."""

    label: str
    values: Array
    words: tuple[str, ...] = ()


def _swatches(xyz: Array, illuminant: str, observer: str) -> tuple[Array, str]:
    """Return encoded sRGB for XYZ `[..., 3]` (missing: grey) and its small print."""
    is_there = np.isfinite(xyz).all(axis=-1)
    rgb = np.broadcast_to(np.array(MISSING), xyz.shape).copy()
    exposure, clipped_count = 1.0, 0
    if is_there.any():
        exposure = style.exposure_of(xyz[is_there])
        adapted = light.adapt_xyz(xyz[is_there], light.white_xyz(illuminant, observer), light.SRGB_WHITE_XYZ)
        clipped = light.clip_to_srgb(exposure * light.xyz_to_srgb_linear(np.clip(adapted, 0.0, None)))
        rgb[is_there], clipped_count = light.srgb_encode(clipped.rgb), clipped.count
    text = style.remark(illuminant, exposure, clipped_count, int(is_there.sum()))
    missing = int((~is_there).sum())
    return rgb, text + (f"; {missing} not computed (grey)" if missing else "")


def gamut_figure(
    xyz: ArrayLike,
    illuminant: str = "D65",
    observer: str = "2deg",
    title: str = "",
    labels: Sequence[str] = (),
    tracks: bool = False,
) -> Figure:
    """Draw a sweep's gamut: a* over b*, and lightness over chroma.

    Args:
        xyz: `[group, point, 3]`, Y = 1 for white; missing points are NaN. Each group (an angle) has its marker.
        illuminant, observer: colour conditions.
        title: over the first panel; labels: `[group]`.
        tracks: connect the points in each group.

    Raises:
        NacreError: all colours are missing.
    """
    values = np.asarray(xyz, dtype=float)
    values = values[None] if values.ndim == 2 else values
    if not np.isfinite(values).any():
        raise NacreError("a gamut needs one finished point at least")
    lab = light.xyz_to_lab(values, light.white_xyz(illuminant, observer))
    rgb, text = _swatches(values, illuminant, observer)
    marks = "os^Dv<>p"
    with style.house_style():
        figure = style.new_figure(style.WIDE_IN, 2.75)
        left, right = figure.subplots(1, 2)
        reach = 10.0 * np.ceil(max(30.0, 1.12 * float(np.nanmax(np.abs(lab[..., 1:])))) / 10.0)
        draw_hue_circle(left, reach)
        for number, (colours, points) in enumerate(zip(rgb, lab)):
            is_there = np.isfinite(points).all(axis=-1)
            line_style = {"s": 11, "c": colours[is_there], "marker": marks[number % len(marks)],
                     "edgecolors": style.INK, "linewidths": 0.3, "rasterized": len(points) > 2000}  # fmt: skip
            points = points[is_there]
            if tracks:
                left.plot(points[:, 1], points[:, 2], color=style.FAINT, linewidth=0.6, zorder=0.9)
                right.plot(
                    np.hypot(points[:, 1], points[:, 2]), points[:, 0], color=style.FAINT, linewidth=0.6, zorder=0.9
                )
            left.scatter(points[:, 1], points[:, 2], **line_style)
            right.scatter(np.hypot(points[:, 1], points[:, 2]), points[:, 0], **line_style)
            if number < len(labels):
                right.scatter([], [], s=11, marker=marks[number % len(marks)], facecolors="white", edgecolors=style.INK,
                              linewidths=0.5, label=labels[number])  # fmt: skip
        style.panel_title(left, title or "CIELAB")
        style.panel_title(right, "Lightness over chroma")
        top = 100.0 if float(np.nanmax(lab[..., 0])) <= 100 else None
        right.set(xlabel="C*", ylabel="L*", xlim=(0, None), ylim=(0, top))
        right.grid()
        if labels:
            right.legend(loc="best", handletextpad=0.2)
        style.small_print(figure, text)
    return figure


def sweep_map_figure(
    x: AxisValues,
    y: AxisValues,
    xyz: ArrayLike,
    illuminant: str = "D65",
    observer: str = "2deg",
    titles: Sequence[str] = ("",),
    note: str = "",
) -> Figure:
    """Draw sweep colours over two parameters, one panel for each further value (an angle).

    Args:
        x, y: the axes, `[x]` and `[y]`; words become evenly spaced steps.
        xyz: `[panel, y, x, 3]`; missing points are NaN.
        illuminant, observer: colour conditions.
        titles: `[panel]`; note: values of other parameters, in the small print.

    Raises:
        NacreError: incompatible shapes.
    """
    values = np.asarray(xyz, dtype=float)
    if values.shape[1:] != (len(y.values), len(x.values), 3) or len(titles) != len(values):
        raise NacreError(f"a sweep's map needs xyz[panel, y, x, 3]; got {values.shape} for {len(titles)} panels")
    rgb, text = _swatches(values, illuminant, observer)
    columns = len(values) if len(values) <= 3 else 2
    rows = -(-len(values) // columns)
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN if columns == 1 else style.WIDE_IN, 0.45 + 2.15 * rows)
        panels = np.ravel(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True))
        for number, axes in enumerate(panels):
            if number >= len(values):
                axes.axis("off")
                continue
            x_order, x_edges = _edges(x)
            y_order, y_edges = _edges(y)
            axes.pcolormesh(x_edges, y_edges, rgb[number][y_order][:, x_order], rasterized=True)
            axes.set(xlim=(x_edges[0], x_edges[-1]), ylim=(y_edges[0], y_edges[-1]))
            _name(axes, x, "x", show=number + columns >= len(values))
            _name(axes, y, "y", show=number % columns == 0)
            for side in ("top", "right"):
                axes.spines[side].set_visible(True)
            style.panel_title(axes, titles[number])
        style.small_print(figure, "; ".join(part for part in (note, text) if part))
    return figure


def _edges(axis: AxisValues) -> tuple[NDArray[np.intp], Array]:
    """Return the ascending order of axis values and their cell edges."""
    order = np.asarray(np.argsort(axis.values, kind="stable"), dtype=np.intp)
    ordered = axis.values[order]
    if axis.words or len(ordered) < 2 or np.any(np.diff(ordered) <= 0):
        return order, np.arange(len(ordered) + 1, dtype=float) - 0.5
    return order, style.cell_edges(ordered)


def _name(axes: Axes, axis: AxisValues, which: str, show: bool) -> None:
    words: tuple[str, ...] = axis.words
    if not words and (len(axis.values) < 2 or np.any(np.diff(np.sort(axis.values)) <= 0)):
        words = tuple(f"{v:.4g}" for v in np.sort(axis.values))
    getattr(axes, f"set_{which}label")(axis.label if show else "")
    if words:
        getattr(axes, f"set_{which}ticks")(range(len(words)), words)


def parallel_figure(
    axes_values: Sequence[AxisValues], xyz: ArrayLike, illuminant: str = "D65", observer: str = "2deg", title: str = ""
) -> Figure:
    """Draw sweep points as coloured lines through their parameters and L*, a*, b* (parallel coordinates).

    Args:
        axes_values: the parameters, each `[point]`.
        xyz: `[point, 3]`; points with NaN are left out and counted.
        illuminant, observer: colour conditions.
        title: over the figure.

    Raises:
        NacreError: all colours are missing.
    """
    values = np.asarray(xyz, dtype=float)
    is_there = np.isfinite(values).all(axis=-1)
    if not is_there.any():
        raise NacreError("parallel coordinates need one finished point at least")
    lab = light.xyz_to_lab(values, light.white_xyz(illuminant, observer))
    rgb, text = _swatches(values, illuminant, observer)
    chosen = np.flatnonzero(is_there)
    if len(chosen) > MAX_LINES:
        text += f"; {MAX_LINES} of {len(chosen)} points drawn"
        chosen = chosen[np.linspace(0, len(chosen) - 1, MAX_LINES).astype(int)]
    columns = [*axes_values, *(AxisValues(name, lab[:, i]) for i, name in enumerate(("L*", "a*", "b*")))]
    heights, ranges = [], []
    for column in columns:
        low, high = float(np.nanmin(column.values)), float(np.nanmax(column.values))
        span = high - low
        heights.append((column.values[chosen] - low) / span if span > 0 else np.full(len(chosen), 0.5))
        ranges.append((low, high))
    lines = np.stack([np.tile(np.arange(len(columns)), (len(chosen), 1)), np.stack(heights, axis=1)], axis=-1)
    with style.house_style():
        figure = style.new_figure(max(style.WIDE_IN, 0.9 * len(columns)), 2.6)
        axes = figure.add_subplot(facecolor=GROUND)
        width, alpha = (1.0, 0.9) if len(chosen) < 300 else (0.6, 0.6)
        axes.add_collection(
            LineCollection(list(lines), colors=rgb[chosen], linewidths=width, alpha=alpha, rasterized=len(chosen) > 500)
        )
        for place, (column, (low, high)) in enumerate(zip(columns, ranges)):
            axes.axvline(place, color=style.INK if place < len(axes_values) else style.FAINT, linewidth=0.7, zorder=3)
            span = high - low
            ticks = [(float(i), w) for i, w in enumerate(column.words)] or [
                (v, f"{v:.4g}") for v in sorted({low, high})
            ]
            for value, word in ticks:
                height = (value - low) / span if span > 0 else 0.5
                axes.annotate(
                    word, (place, height), xytext=(3, 0), textcoords="offset points", fontsize=6, va="center", zorder=4,
                    bbox={"boxstyle": "round,pad=0.08", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
                )  # fmt: skip
        axes.set(xlim=(-0.1, len(columns) - 0.6), ylim=(-0.06, 1.06))
        axes.set_xticks(range(len(columns)), [column.label for column in columns], fontsize=6)
        axes.set_yticks([])
        axes.tick_params(length=0)
        axes.spines[["left", "bottom"]].set_visible(False)
        style.panel_title(axes, title)
        style.small_print(figure, text)
    return figure
