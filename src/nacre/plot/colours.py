"""Colour figures: maps over two parameters, tracks in chromaticity diagrams, gamuts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from nacre import light
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LOCUS_LABELS_NM = (460, 480, 500, 520, 540, 560, 580, 600, 620)
SRGB_PRIMARIES = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.64, 0.33]])  # IEC 61966-2-1


def colour_map_figure(
    x: ArrayLike,
    y: ArrayLike,
    values: ArrayLike,
    wavelengths_nm: ArrayLike,
    x_label: str = "Angle of incidence (degrees)",
    y_label: str = "Thickness (nm)",
    illuminant: str = "D65",
    title: str = "",
) -> Figure:
    """Draw spectral colours over two parameters as an image.

    Args:
        x, y: `[x]` and `[y]`, ascending.
        values: `[y, x, wavelength]`, reflectances or transmittances.
        wavelengths_nm: `[wavelength]`.
        x_label, y_label, title: words.
        illuminant: lamp.
    """
    x, y, spectra = (np.asarray(v, dtype=float) for v in (x, y, values))
    if len(x) < 2 or len(y) < 2 or spectra.shape[:2] != (len(y), len(x)):
        raise NacreError(f"a colour map needs values[y, x, wavelength]; got {spectra.shape} for {len(y)} y, {len(x)} x")
    colours, exposure, clipped = style.shown_colours(spectra, wavelengths_nm, illuminant)
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 2.75)
        axes = figure.add_subplot()
        axes.pcolormesh(style.cell_edges(x), style.cell_edges(y), colours, rasterized=True)
        axes.set_xlim(x[0], x[-1])
        axes.set_ylim(y[0], y[-1])
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        for side in ("top", "right"):
            axes.spines[side].set_visible(True)
        style.panel_title(axes, title)
        style.small_print(figure, style.remark(illuminant, exposure, clipped, colours[..., 0].size))
    return figure


def chromaticity_figure(
    values: ArrayLike,
    wavelengths_nm: ArrayLike,
    labels: list[str] | None = None,
    illuminant: str = "D65",
    title: str = "",
) -> Figure:
    """Draw a colour track in CIE xy and in CIELAB a*, b*.

    Args:
        values: `[step, wavelength]`, spectra in order.
        wavelengths_nm: `[wavelength]`.
        labels: `[step]`; the first and the last are written at the track.
        illuminant: lamp; its white is marked.
        title: over the first panel.
    """
    spectra = np.atleast_2d(np.asarray(values, dtype=float))
    xyz = light.spectrum_to_xyz(spectra, wavelengths_nm, illuminant)
    white = light.white_xyz(illuminant)
    colours, exposure, clipped = style.shown_colours(spectra, wavelengths_nm, illuminant)
    lab = light.xyz_to_lab(xyz, white)
    with style.house_style():
        figure = style.new_figure(style.WIDE_IN, 2.75)
        left, right = figure.subplots(1, 2)
        draw_locus(left)
        left.plot(*light.xyz_to_xyy(white)[:2], "+", color=style.INK, markersize=5, markeredgewidth=0.7)
        draw_track(left, light.xyz_to_xyy(xyz)[:, :2], colours, labels)
        style.panel_title(left, title or "CIE 1931 chromaticity")
        extent = 10.0 * np.ceil(max(30.0, 1.12 * float(np.abs(lab[:, 1:]).max())) / 10.0)
        draw_hue_circle(right, extent)
        draw_track(right, lab[:, 1:], colours, labels)
        style.panel_title(right, "CIELAB")
        style.small_print(figure, style.remark(illuminant, exposure, clipped, len(spectra)))
    return figure


def draw_track(axes: Axes, points: Array, colours: Array, labels: list[str] | None, ink: str = style.INK) -> None:
    """Draw coloured points along a line, with the first and the last label."""
    axes.plot(points[:, 0], points[:, 1], color=ink, linewidth=0.6, zorder=2)
    axes.scatter(points[:, 0], points[:, 1], s=13, c=colours, edgecolors=style.INK, linewidths=0.35, zorder=3)
    if labels and len(labels) == len(points):
        apart = points[-1] - points[0]
        out = apart / max(float(np.linalg.norm(apart)), 1e-9) if len(points) > 1 else np.array([1.0, 1.0])
        for i, way in {0: -out, len(points) - 1: out}.items():
            axes.annotate(
                labels[i],
                points[i],
                xytext=(16.0 * float(way[0]), 16.0 * float(way[1]) + 6.0),
                textcoords="offset points",
                fontsize=6.5,
                zorder=4,
                ha="center",
                va="center",
                arrowprops={"arrowstyle": "-", "color": style.INK, "linewidth": 0.4},
                bbox={"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
            )


def draw_locus(axes: Axes) -> None:
    """Draw the spectral locus and the sRGB triangle in xy."""
    nm = np.arange(390, 701)
    matching = light.observer()[nm - 360]
    locus = matching[:, :2] / matching.sum(axis=1, keepdims=True)
    closed = np.concatenate([locus, locus[:1]])
    axes.fill(closed[:, 0], closed[:, 1], color="#f4f4f4", zorder=0)
    axes.plot(closed[:, 0], closed[:, 1], color=style.FAINT, linewidth=0.8, zorder=1)
    axes.plot(
        SRGB_PRIMARIES[:, 0], SRGB_PRIMARIES[:, 1], color=style.FAINT, linewidth=0.6, linestyle=(0, (3, 2)), zorder=1
    )
    axes.annotate("sRGB", (0.405, 0.522), fontsize=5.8, color="#7a7a7a", rotation=-38, ha="center", va="center")
    centre = np.array([1 / 3, 1 / 3])
    for label in LOCUS_LABELS_NM:
        point = locus[label - 390]
        out = (point - centre) / np.linalg.norm(point - centre)
        axes.plot(*zip(point, point + 0.012 * out), color=style.FAINT, linewidth=0.6)
        axes.annotate(str(label), point + 0.05 * out, fontsize=5.5, color="#7a7a7a", ha="center", va="center")
    axes.set(xlim=(-0.09, 0.8), ylim=(-0.03, 0.9), xlabel="$x$", ylabel="$y$", aspect="equal")


def draw_hue_circle(axes: Axes, extent: float) -> None:
    """Draw circles of constant chroma in a*, b* up to `extent`."""
    turn = np.linspace(0, 2 * np.pi, 181)
    for radius in np.arange(20 if extent <= 80 else 40, extent + 1, 20 if extent <= 80 else 40):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="#e0e0e0", linewidth=0.5, zorder=0)
    axes.axhline(0, color="#d0d0d0", linewidth=0.5, zorder=0)
    axes.axvline(0, color="#d0d0d0", linewidth=0.5, zorder=0)
    axes.set(xlim=(-extent, extent), ylim=(-extent, extent), xlabel="a*", ylabel="b*", aspect="equal")


# Gamut charts: a*b*, chromaticity, and lightness over chroma, with the optimal colours.


def gamut_limits_figure(
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
        srgb, optimal: `[n, 3]` CIELAB, surface colours of both solids; their outlines are drawn.
        white: `[3]`, XYZ of the lamp's white.
        title: over the first panel; note: small print.
        wanted: `[target, 3]` CIELAB, marked with crosses.
    """
    points, chroma_xy = np.atleast_2d(np.asarray(lab, float)), np.atleast_2d(np.asarray(xyy, float))
    colours = _shown(points, np.asarray(white, float))
    with style.house_style():
        figure = style.new_figure(style.SHEET_IN, 2.75)
        left, middle, right = figure.subplots(1, 3)
        outlines = {"optimal colours": (np.asarray(optimal, float), "-"), "sRGB": (np.asarray(srgb, float), "--")}
        extent = 10.0 * np.ceil(max(40.0, *(float(np.abs(o[:, 1:]).max()) for o, _ in outlines.values())) / 10.0)
        draw_hue_circle(left, extent)
        draw_locus(middle)
        line_style = {
            "s": 9,
            "c": colours,
            "edgecolors": style.INK,
            "linewidths": 0.2,
            "zorder": 3,
            "rasterized": len(points) > 500,
        }
        for name, (solid, line) in outlines.items():
            hull = _outline(solid[:, 1:])
            left.plot(hull[:, 0], hull[:, 1], line, color=style.FAINT, linewidth=0.8, label=name)
            right.plot(*_lightness_outline(solid), line, color=style.FAINT, linewidth=0.8)
        left.scatter(points[:, 1], points[:, 2], **line_style)
        middle.scatter(chroma_xy[:, 0], chroma_xy[:, 1], **line_style)
        right.scatter(np.hypot(points[:, 1], points[:, 2]), points[:, 0], **line_style)
        if wanted is not None and len(np.atleast_2d(wanted)):
            marks = np.atleast_2d(np.asarray(wanted, float))
            cross = {"marker": "x", "s": 26, "color": style.INK, "linewidths": 0.9, "zorder": 4}
            left.scatter(marks[:, 1], marks[:, 2], label="wanted", **cross)
            right.scatter(np.hypot(marks[:, 1], marks[:, 2]), marks[:, 0], **cross)
            at = light.xyz_to_xyy(light.lab_to_xyz(marks, white))
            middle.scatter(at[:, 0], at[:, 1], **cross)
        left.legend(loc="upper left", fontsize=5.5, handlelength=1.2)
        right.set(xlim=(0, None), ylim=(0, 102), xlabel="C*", ylabel="L*")
        style.panel_title(left, title or "CIELAB")
        style.panel_title(middle, "Chromaticity")
        style.panel_title(right, "Lightness over chroma")
        style.small_print(figure, note)
    return figure


def _shown(lab: Array, white: Array) -> Array:
    xyz = light.adapt_xyz(np.clip(light.lab_to_xyz(lab, white), 0.0, None), white, light.SRGB_WHITE_XYZ)
    return np.asarray(light.srgb_encode(light.clip_to_srgb(light.xyz_to_srgb_linear(np.clip(xyz, 0.0, None))).rgb))


def _outline(points: Array) -> Array:
    """Return the closed outline of plane points: the farthest in each direction."""
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
