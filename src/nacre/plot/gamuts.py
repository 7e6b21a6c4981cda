"""The chart of what can be reached: a*b*, chromaticity, and lightness over chroma, with the limits of any surface."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from nacre import light
from nacre.arrays import Array
from nacre.plot.colours import draw_hue_circle, draw_locus
from nacre.plot.style import FAINT, INK, SHEET_IN, house_style, new_figure, panel_title, small_print


def reach_figure(
    lab: ArrayLike,
    xyy: ArrayLike,
    srgb: ArrayLike,
    optimal: ArrayLike,
    white: ArrayLike,
    title: str = "",
    note: str = "",
    wanted: ArrayLike | None = None,
) -> Figure:
    """Draw reachable colours in a*b*, in xy and as lightness over chroma.

    Args:
        lab, xyy: `[point, 3]`.
        srgb, optimal: `[n, 3]` CIELAB, colours on the surface of both solids, of which the outlines are drawn.
        white: `[3]`, XYZ of the lamp's white.
        title: over the first panel; note: small print.
        wanted: `[want, 3]` CIELAB, marked with crosses.
    """
    points, chroma_xy = np.atleast_2d(np.asarray(lab, float)), np.atleast_2d(np.asarray(xyy, float))
    colours = _shown(points, np.asarray(white, float))
    with house_style():
        figure = new_figure(SHEET_IN, 2.75)
        left, middle, right = figure.subplots(1, 3)
        outlines = {"optimal colours": (np.asarray(optimal, float), "-"), "sRGB": (np.asarray(srgb, float), "--")}
        reach = 10.0 * np.ceil(max(40.0, *(float(np.abs(o[:, 1:]).max()) for o, _ in outlines.values())) / 10.0)
        draw_hue_circle(left, reach)
        draw_locus(middle)
        style = {
            "s": 9,
            "c": colours,
            "edgecolors": INK,
            "linewidths": 0.2,
            "zorder": 3,
            "rasterized": len(points) > 500,
        }
        for name, (solid, line) in outlines.items():
            hull = _outline(solid[:, 1:])
            left.plot(hull[:, 0], hull[:, 1], line, color=FAINT, linewidth=0.8, label=name)
            right.plot(*_lightness_outline(solid), line, color=FAINT, linewidth=0.8)
        left.scatter(points[:, 1], points[:, 2], **style)
        middle.scatter(chroma_xy[:, 0], chroma_xy[:, 1], **style)
        right.scatter(np.hypot(points[:, 1], points[:, 2]), points[:, 0], **style)
        if wanted is not None and len(np.atleast_2d(wanted)):
            marks = np.atleast_2d(np.asarray(wanted, float))
            cross = {"marker": "x", "s": 26, "color": INK, "linewidths": 0.9, "zorder": 4}
            left.scatter(marks[:, 1], marks[:, 2], label="wanted", **cross)
            right.scatter(np.hypot(marks[:, 1], marks[:, 2]), marks[:, 0], **cross)
            at = light.xyz_to_xyy(light.lab_to_xyz(marks, white))
            middle.scatter(at[:, 0], at[:, 1], **cross)
        left.legend(loc="upper left", fontsize=5.5, handlelength=1.2)
        right.set(xlim=(0, None), ylim=(0, 102), xlabel="C*", ylabel="L*")
        panel_title(left, title or "CIELAB")
        panel_title(middle, "Chromaticity")
        panel_title(right, "Lightness over chroma")
        small_print(figure, note)
    return figure


def _shown(lab: Array, white: Array) -> Array:
    xyz = light.adapt_xyz(np.clip(light.lab_to_xyz(lab, white), 0.0, None), white, light.SRGB_WHITE_XYZ)
    return np.asarray(light.srgb_encode(light.clip_to_srgb(light.xyz_to_srgb_linear(np.clip(xyz, 0.0, None))).rgb))


def _outline(points: Array) -> Array:
    """Return the closed outline of points in the plane: the farthest in each of many directions."""
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    ways = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return np.asarray(points[np.argmax(points @ ways.T, axis=0)])


def _lightness_outline(lab: Array) -> tuple[Array, Array]:
    """Return the largest chroma at each lightness, as (chroma, lightness)."""
    edges = np.linspace(0.0, 100.0, 26)
    chroma = np.hypot(lab[:, 1], lab[:, 2])
    bins = np.clip(np.digitize(lab[:, 0], edges) - 1, 0, len(edges) - 2)
    top = np.array([chroma[bins == i].max(initial=0.0) for i in range(len(edges) - 1)])
    return np.concatenate([[0.0], top, [0.0]]), np.concatenate([[0.0], 0.5 * (edges[1:] + edges[:-1]), [100.0]])
