"""The sheet of a picture made of structure: asked beside reached, how far off, and the maps of what varies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.plot.style import SHEET_IN, house_style, new_figure, panel_title, small_print

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAR_DE00 = 10.0  # at least the top of the scale of distances
OUT, IN = "#d55e00", "#f4f4f4"


@dataclass(frozen=True, eq=False)
class PictureSheet:
    """What the sheet shows.

    Attributes:
        title: over it.
        asked, reached: `[row, column, 3]`, encoded sRGB, the first row on top.
        distance: `[row, column]`, dE00.
        is_mapped: `[row, column]`, whether a pixel was out of reach.
        maps: (name, `[row, column]` values) of each number.
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
    with house_style():
        figure = new_figure(SHEET_IN, 0.6 + high * (SHEET_IN / 2.0 + SHEET_IN / 3.2))
        figure.suptitle(sheet.title, fontsize=8.5, x=0.01, ha="left")
        outer = figure.add_gridspec(2, 1, height_ratios=(3.2 / 2.0, 1.0))
        top = outer[0].subgridspec(1, 2)
        _shown(figure.add_subplot(top[0]), sheet.asked, "Asked")
        _shown(figure.add_subplot(top[1]), sheet.reached, "Reached")
        bottom = outer[1].subgridspec(1, 2 + len(sheet.maps))
        far = max(FAR_DE00, float(np.percentile(sheet.distance, 99.0)))
        _scaled(figure, figure.add_subplot(bottom[0]), sheet.distance, "dE00", "magma", 0.0, far)
        axes = figure.add_subplot(bottom[1])
        _shown(axes, np.where(sheet.is_mapped[..., None], _rgb(OUT), _rgb(IN)), "Out of reach (orange)")
        for k, (name, values) in enumerate(sheet.maps):
            low, top_value = float(values.min()), float(values.max())
            _scaled(figure, figure.add_subplot(bottom[2 + k]), values, name, "viridis", low, top_value)
        small_print(figure, sheet.note)
    return figure


def _rgb(name: str) -> Array:
    return np.array([int(name[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


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
    panel_title(axes, title)


__all__ = ["PictureSheet", "picture_figure"]
