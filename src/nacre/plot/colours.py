"""Colour figures: maps over two parameters, tracks in chromaticity diagrams, gamuts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from nacre import light
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import from_half_difference
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.measure.colours import colour_bsdf
from nacre.measure.evaluate import evaluate_at_own
from nacre.plot import style
from nacre.plot.style import INK, LINES, house_style, new_figure, panel_title, shown_colours, small_print

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
        axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), xlabel=x_label, ylabel=y_label)
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
        offset = points[-1] - points[0]
        out = offset / max(float(np.linalg.norm(offset)), 1e-9) if len(points) > 1 else np.array([1.0, 1.0])
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


# Colour tracks of gloss and diffuse light, near and far from the mirror direction, over an angle or a parameter.
#
# The reflected and the transmitted colour of its flakes characterise a pearl (Guillen et al. 2020, figures 9, 10, 12).
# Other materials are measured in the same two directions.

Evaluate = Callable[[Bsdf, Array, Array], Array]
WIDTH_IN, HEIGHT_IN = 7.2, 2.7
GLOSS_HALF_DEG = 4.0  # outside a clear coat's reflection, within the flakes' lobe
GLOSS_DEG = np.arange(5.0, 71.0, 5.0)
RADIAL_DEG = np.arange(15.0, 51.0, 5.0)  # half angle = difference angle: away from the mirror direction
# half and difference angle, for tracks over a parameter
STEP_GLOSS_DEG, STEP_DIFFUSE_DEG = (GLOSS_HALF_DEG, 10.0), (40.0, 10.0)
MIDDLE_GREY = 0.1842  # luminance of L* = 50
DARK = 1e-9  # smallest luminance with a defined colour


@dataclass(frozen=True)
class Track:
    """A colour track: axis values `steps[s]`, spectra `values[s, wavelength]` relative to perfect white."""

    steps: Array
    values: Array


def angle_tracks(
    bsdf: Bsdf, angles_deg: Sequence[float] | Array | None = None, evaluate: Evaluate | None = None
) -> dict[str, Track]:
    """Return gloss over the difference angle, and diffuse light away from the mirror direction.

    The gloss of a smooth coloured mirror (a film, a metasurface) is its delta reflectance. Otherwise it is pi f at 4
    degrees half angle, which excludes the reflection of a clear coat.

    Args:
        bsdf: any.
        angles_deg: difference angles, equal to the incidence angle for gloss; default 5 to 70. The diffuse track
            uses those from 15 to 50.
        evaluate: replaces `evaluate_at_own` for random walks.

    Raises:
        NacreError: all reflectances are zero.
    """
    gloss = GLOSS_DEG if angles_deg is None else np.atleast_1d(np.asarray(angles_deg, dtype=float))
    radial = RADIAL_DEG if angles_deg is None else gloss[(gloss >= RADIAL_DEG[0]) & (gloss <= RADIAL_DEG[-1])]
    tracks = {"gloss": Track(gloss, _gloss(bsdf, GLOSS_HALF_DEG, gloss, evaluate))}
    if len(radial):
        tracks["diffuse"] = Track(radial, _scattered(bsdf, radial, radial, evaluate))
    return _bright(tracks, bsdf.wavelengths_nm)


def number_tracks(
    materials: Sequence[Any],
    steps: Sequence[float] | Array,
    evaluate: Evaluate | None = None,
    wavelengths_nm: Array | None = None,
    illuminant: str = "D65",
) -> tuple[dict[str, Track], Array]:
    """Return gloss and diffuse light for a sequence of materials, and their common wavelengths.

    Args:
        materials: one for each step, with `bsdf(wavelengths_nm)`.
        steps: values of the parameter.
        evaluate: as for `angle_tracks`.
        wavelengths_nm: default: the first material's own, with the lines of a narrow-band lamp.
        illuminant: the lamp.
    """
    gloss, diffuse = [], []
    for material in materials:
        bsdf = colour_bsdf(material, illuminant, wavelengths_nm)
        wavelengths_nm = bsdf.wavelengths_nm
        gloss.append(_gloss(bsdf, STEP_GLOSS_DEG[0], np.array([STEP_GLOSS_DEG[1]]), evaluate)[0])
        half, difference = (np.array([angle]) for angle in STEP_DIFFUSE_DEG)
        diffuse.append(_scattered(bsdf, half, difference, evaluate)[0])
    axis = np.asarray(steps, dtype=float)
    nm = np.asarray(wavelengths_nm, dtype=float)
    return _bright({"gloss": Track(axis, np.stack(gloss)), "diffuse": Track(axis, np.stack(diffuse))}, nm), nm


def _gloss(bsdf: Bsdf, half_deg: float, difference_deg: Array, evaluate: Evaluate | None) -> Array:
    if any(lobe.is_delta for lobe in bsdf.lobes):
        return np.asarray(bsdf.specular(np.radians(difference_deg)).reflectance)
    return _scattered(bsdf, np.full(len(difference_deg), half_deg), difference_deg, evaluate)


def _scattered(bsdf: Bsdf, half_deg: Array, difference_deg: Array, evaluate: Evaluate | None) -> Array:
    """Return pi f at phi_d = 90 degrees, with both directions above the surface, `[step, wavelength]`."""
    across = np.full(len(half_deg), 0.5 * np.pi)
    wi, wo = from_half_difference(np.radians(half_deg), np.radians(difference_deg), across)
    return np.pi * np.maximum((evaluate or evaluate_at_own)(bsdf, wi, wo), 0.0)


def _bright(tracks: dict[str, Track], nm: Array) -> dict[str, Track]:
    """Omit tracks with dark points, such as the diffuse track of a mirror."""
    bright = {
        name: track
        for name, track in tracks.items()
        if float(light.spectrum_to_xyz(track.values, nm)[:, 1].min()) > DARK
    }
    if not bright:
        raise NacreError("figure tracks: no light leaves towards the gloss or the diffuse direction")
    return bright


def tracks_figure(
    tracks: Mapping[str, Track],
    wavelengths_nm: Array,
    step_label: str = "Difference angle (degrees)",
    illuminant: str = "D65",
    title: str = "",
    lightness: float | None = None,
) -> Figure:
    """Draw tracks through CIE xy and a*, b*, and their luminance over the axis values.

    The axes show the actual values; the points are coloured at L* 50 to show their hues.

    Args:
        tracks: by name, usually "gloss" and "diffuse".
        wavelengths_nm: `[wavelength]`.
        step_label: name of the axis.
        illuminant: lamp; its white is marked.
        title: over the first panel.
        lightness: scale a*, b* to this L*, to compare hues; by default unscaled.

    Raises:
        NacreError: lightness outside (0, 100].
    """
    if lightness is not None and not 0.0 < lightness <= 100.0:
        raise NacreError(f"lightness = {lightness:g} is not allowed; it should be over 0 and at most 100")
    white = light.white_xyz(illuminant)
    nm = np.asarray(wavelengths_nm, dtype=float)
    lab = {}
    with house_style():
        figure = new_figure(WIDTH_IN, HEIGHT_IN)
        left, middle, right = figure.subplots(1, 3)
        draw_locus(left)
        left.plot(*light.xyz_to_xyy(white)[:2], "+", color=INK, markersize=5, markeredgewidth=0.7)
        for number, (name, track) in enumerate(tracks.items()):
            xyz = track.values @ light.smooth_weights(nm, illuminant, "2deg")
            even = MIDDLE_GREY / xyz[:, 1:2]
            colours = shown_colours(track.values * even, nm, illuminant, 1.0)[0]
            lab[name] = light.xyz_to_lab(xyz if lightness is None else xyz * _luminance(lightness) / xyz[:, 1:2], white)
            ends = [f"{track.steps[0]:g}", *[""] * (len(colours) - 2), f"{track.steps[-1]:g}"][: len(colours)]
            draw_track(left, light.xyz_to_xyy(xyz)[:, :2], colours, None, LINES[number])
            draw_track(middle, lab[name][:, 1:], colours, ends, LINES[number])
            right.plot(track.steps, xyz[:, 1], color=LINES[number], linewidth=0.8, zorder=2)
            right.scatter(track.steps, xyz[:, 1], s=13, c=colours, edgecolors=INK, linewidths=0.35, zorder=3)
            right.annotate(name, (track.steps[-1], xyz[-1, 1]), xytext=(-2, 5), textcoords="offset points",
                           fontsize=6.5, ha="right", color=LINES[number])  # fmt: skip
        panel_title(left, title or "CIE 1931 chromaticity")
        far = max(float(np.abs(values[:, 1:]).max()) for values in lab.values())
        draw_hue_circle(middle, 10.0 * np.ceil(max(30.0, 1.12 * far) / 10.0))
        panel_title(middle, "CIELAB" if lightness is None else f"CIELAB scaled to L* {lightness:g}")
        right.set(xlabel=step_label, ylabel="Luminance (perfect white: 1)", yscale="log")
        panel_title(right, "Luminance")
        small_print(figure, f"illuminant {illuminant}; colours of the points at L* 50")
    return figure


def _luminance(lightness: float) -> float:
    return float(light.lab_to_xyz(np.array([lightness, 0.0, 0.0]), light.white_xyz())[1])


def material_tracks(
    material: Any,
    angles_deg: Array | None,
    over: tuple[str, Sequence[float] | Array] | None,
    wavelengths_nm: Any,
    illuminant: str,
    evaluate: Evaluate | None,
    lightness: float | None = None,
) -> Figure:
    """Draw material tracks over the angle, or over a parameter; `lightness` scales a*, b*."""
    if over is None:
        bsdf = colour_bsdf(material, illuminant, wavelengths_nm)
        tracks = angle_tracks(bsdf, angles_deg, evaluate)
        return tracks_figure(
            tracks, bsdf.wavelengths_nm, illuminant=illuminant, title=material.name, lightness=lightness
        )
    if angles_deg is not None:
        raise UnsupportedError("tracks run over the angle or over a number; give angles or a number, not both")
    path, steps = over
    if len(steps) < 2:
        raise NacreError(f"over {path}: give at least two values")
    if not hasattr(material, "vary"):
        raise UnsupportedError("tracks over a number need a recipe; this material has none")
    material = material.at_low_fidelity()
    made = [material.vary({path: float(step)}) for step in steps]
    grid = None if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
    tracks, nm = number_tracks(made, steps, evaluate, grid, illuminant)
    return tracks_figure(tracks, nm, ".".join(path.split(".")[-2:]), illuminant, material.name, lightness)
