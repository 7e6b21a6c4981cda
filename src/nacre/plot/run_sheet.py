"""Figure of a run sheet: the monitor signal over the deposited thickness."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from nacre.core.arrays import Array
from nacre.plot import style


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
        axes.set_xlim(0.0, total)
        axes.set_xlabel("Deposited thickness (nm)")
        axes.set_ylabel(y_label)
        axes.set_title(title, loc="left")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
