"""Scattering figures: image slices of a BRDF, lobes in the plane of incidence, single particles."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from nacre import light
from nacre.bsdf import Bsdf
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.measure.evaluate import tristimulus_of_pairs
from nacre.plot import style

Evaluate = Callable[[Array, Array], Array]
TOP_DEG = 60.0  # white is the largest f up to this difference angle, since f diverges at grazing
DECADES = 5.0  # range of f that a slice shows, limited by print
TICKS_H_DEG = (0, 5, 15, 30, 45, 60, 90)
SLICE_NODES = 181


def slice_directions(nodes: int = SLICE_NODES, phi_d_deg: float = 90.0) -> tuple[Array, Array, Array]:
    """Return half and difference angles of a slice in degrees, and its pairs `wi, wo` stacked `[2, d, h, 3]`.

    Rusinkiewicz's coordinates with phi_h = 0: theta_h tilts the half vector from the normal, theta_d opens the
    pair about it, phi_d turns it. At phi_d = 90 degrees both directions stay above the surface. The half angle is
    sampled by its square root, as Matusik's tables are, since highlights are narrow.
    """
    half_deg = 89.5 * np.linspace(0.0, 1.0, nodes) ** 2
    difference_deg = np.linspace(0.0, 89.5, nodes)
    theta_h = np.radians(half_deg)[None, :]
    theta_d, phi_d = np.radians(difference_deg)[:, None], np.radians(phi_d_deg)
    pair = []
    for sign in (1.0, -1.0):
        x, y = sign * np.sin(theta_d) * np.cos(phi_d), sign * np.sin(theta_d) * np.sin(phi_d)
        z = np.cos(theta_d)
        pair.append(
            np.stack(
                np.broadcast_arrays(
                    x * np.cos(theta_h) + z * np.sin(theta_h),
                    y + 0.0 * theta_h,
                    z * np.cos(theta_h) - x * np.sin(theta_h),
                ),
                axis=-1,
            )
        )
    return half_deg, difference_deg, np.stack(pair)


def slice_figure(
    values: Array,
    wavelengths_nm: Array,
    theta_h_deg: Array,
    theta_d_deg: Array,
    illuminant: str = "D65",
    title: str = "",
) -> Figure:
    """Draw a BRDF over half and difference angle as an image: hue from the spectrum, lightness from log f.

    Args:
        values: `[theta_d, theta_h, wavelength]`, f in 1/sr.
        wavelengths_nm: `[wavelength]`.
        theta_h_deg, theta_d_deg: the axes, ascending from 0; the half angle is drawn by its square root.
        illuminant: lamp.
        title: over the image.

    Raises:
        NacreError: f is zero everywhere, as for a mirror, whose lobe is a delta.
    """
    xyz = light.spectrum_to_xyz(np.maximum(values, 0.0), wavelengths_nm, illuminant)
    return _slice_figure(xyz, theta_h_deg, theta_d_deg, illuminant, title)


def _slice_figure(xyz: Array, theta_h_deg: Array, theta_d_deg: Array, illuminant: str, title: str) -> Figure:
    """Draw XYZ `[theta_d, theta_h, 3]`."""
    strength = xyz[..., 1]
    steep = strength[np.asarray(theta_d_deg) <= TOP_DEG]
    top = float(steep.max(initial=0.0)) or float(strength.max())
    if top <= 0.0:
        raise NacreError("figure slice: f is zero everywhere; a mirror-smooth material has a delta lobe only")
    level = np.clip(1.0 + np.log10(np.maximum(strength, 1e-30) / top) / DECADES, 0.0, 1.0)
    wanted = light.lab_to_xyz(np.stack([100.0 * level, 0.0 * level, 0.0 * level], axis=-1))[..., 1]
    rgb = _rgb(xyz, illuminant) * (wanted / np.maximum(strength, 1e-30))[..., None]
    clipped = light.clip_to_srgb(rgb)
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 2.75)
        grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 0.045))
        axes, key = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
        x_edges, y_edges = style.cell_edges(np.sqrt(theta_h_deg)), style.cell_edges(theta_d_deg)
        axes.pcolormesh(x_edges, y_edges, light.srgb_encode(clipped.rgb), rasterized=True)
        axes.set_xticks(np.sqrt(TICKS_H_DEG), [str(t) for t in TICKS_H_DEG])
        axes.set_yticks([0, 15, 30, 45, 60, 75, 90])
        axes.set(
            xlim=(0.0, np.sqrt(90.0)),
            ylim=(0.0, 90.0),
            facecolor="#000000",
            xlabel=r"Half angle $\theta_h$ (degrees, square-root axis)",
            ylabel=r"Difference angle $\theta_d$ (degrees)",
        )
        style.panel_title(axes, title)
        ramp = light.lab_to_xyz(np.stack([np.linspace(0, 100, 256), *np.zeros((2, 256))], axis=-1))[:, 1]
        grey = light.srgb_encode(np.repeat(ramp[:, None, None], 3, axis=2))
        high = np.log10(top)
        key.imshow(grey, origin="lower", aspect="auto", extent=(0, 1, high - DECADES, high))
        decades = np.arange(np.ceil(high - DECADES), np.floor(high) + 1)
        key.set_yticks(decades, [f"$10^{{{int(v)}}}$" for v in decades])
        key.set_xticks([])
        key.yaxis.tick_right()
        key.set_title("$f$ (1/sr)", fontsize=6.5, pad=3)
        style.small_print(figure, style.remark(illuminant, 1.0, clipped.count, clipped.is_clipped.size))
    return figure


def bsdf_slice_figure(
    bsdf: Bsdf,
    illuminant: str = "D65",
    title: str = "",
    nodes: int = SLICE_NODES,
    phi_d_deg: float = 90.0,
    evaluate: Evaluate | None = None,
) -> Figure:
    """Draw a slice of a Bsdf without its delta lobes; see `slice_figure`.

    Args:
        bsdf: any; illuminant, title: as for `slice_figure`.
        nodes: pixels along a side; phi_d_deg: azimuth of the pair about the half vector.
        evaluate: replaces `bsdf.evaluate(wi, wo)` for random walks.

    Raises:
        NacreError: all lobes are deltas.
    """
    theta_h, theta_d, (wi, wo) = slice_directions(nodes, phi_d_deg)
    above = (wi[..., 2] > 0) & (wo[..., 2] > 0)
    xyz = np.zeros((*above.shape, 3))
    xyz[above] = _colours(bsdf, wi[above], wo[above], illuminant, evaluate)
    return _slice_figure(xyz, theta_h, theta_d, illuminant, title)


def _colours(bsdf: Bsdf, wi: Array, wo: Array, illuminant: str, evaluate: Evaluate | None) -> Array:
    """Return XYZ `[pair, 3]`, by `evaluate` if given."""
    if evaluate is None:
        return tristimulus_of_pairs(bsdf, wi, wo, illuminant)
    return light.spectrum_to_xyz(np.maximum(evaluate(wi, wo), 0.0), bsdf.wavelengths_nm, illuminant)


def _rgb(xyz: Array, illuminant: str) -> Array:
    """Return linear sRGB of XYZ under a lamp."""
    return light.xyz_to_srgb_linear(light.adapt_xyz(xyz, light.white_xyz(illuminant), light.SRGB_WHITE_XYZ))


def lobe_figure(
    bsdf: Bsdf,
    angles_deg: Sequence[float] | Array = (10.0, 30.0, 60.0),
    illuminant: str = "D65",
    title: str = "",
    azimuth_deg: float = 0.0,
    nodes: int = 721,
    evaluate: Evaluate | None = None,
) -> Figure:
    """Draw scattered light in the plane of incidence, one polar diagram per angle, in its colours.

    The radius is luminance of f cos(theta_o), relative to the diagram's largest; a dashed spoke is the incident
    direction, a solid one with a dot the mirror reflection with its luminous reflectance (and transmittance).

    Args:
        bsdf: any, also with transmission: the circle is then full.
        angles_deg: incidence; at most 6.
        illuminant: lamp.
        title: over the first diagram.
        azimuth_deg: azimuth of the plane of incidence from the x axis.
        nodes: exit angles over a half circle.
        evaluate: replaces `bsdf.evaluate(wi, wo)` for random walks.
    """
    incidence = np.atleast_1d(np.asarray(angles_deg, dtype=float))[:6]
    exits = np.radians(
        np.linspace(-179.875, 180.0, 2 * (nodes - 1)) if bsdf.transmits else np.linspace(-89.75, 89.75, nodes)
    )
    turn = np.radians(azimuth_deg)
    across = np.array([np.cos(turn), np.sin(turn), 0.0])
    wo = np.sin(exits)[:, None] * across + np.cos(exits)[:, None] * np.array([0.0, 0.0, 1.0])
    rows = len(incidence)
    height = (1.95 if bsdf.transmits else 1.25) * rows + 0.25
    clipped = total = 0
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, height)
        for row, angle in enumerate(incidence):
            axes = figure.add_subplot(rows, 1, row + 1)
            theta = np.radians(angle)
            wi = -np.sin(theta) * across + np.array([0.0, 0.0, np.cos(theta)])
            xyz = _colours(bsdf, np.broadcast_to(wi, wo.shape).copy(), wo, illuminant, evaluate) * np.abs(wo[:, 2:])
            specular = bsdf.specular(np.array([theta]), phi_rad=turn + np.pi)
            clipped_here, total_here = _polar(axes, exits, xyz, illuminant)
            clipped, total = clipped + clipped_here, total + total_here
            _spokes(axes, theta, specular, bsdf, illuminant)
            _circle(axes, bsdf.transmits)
            style.panel_title(axes, f"{angle:.3g}\u00b0 incidence" + (f", {title}" if title and row == 0 else ""))
        style.small_print(figure, style.remark(illuminant, 1.0, clipped, total))
    return figure


def _polar(axes: Any, exits: Array, xyz: Array, illuminant: str) -> tuple[int, int]:
    """Fill the diagram with wedges in the direction's colour, with a common lightness scale."""
    top = float(xyz[:, 1].max())
    if top <= 0.0:
        return 0, 0
    radius = xyz[:, 1] / top
    # constant lightness: the radius shows the intensity, the wedge the hue
    clipped = light.clip_to_srgb(_rgb(xyz, illuminant) * (0.4 / np.maximum(xyz[:, 1], 1e-30))[:, None])
    x, y = radius * np.sin(exits), radius * np.cos(exits)
    wedges = [((0, 0), (x[i], y[i]), (x[i + 1], y[i + 1])) for i in range(len(exits) - 1)]
    tiles = light.srgb_encode(0.5 * (clipped.rgb[1:] + clipped.rgb[:-1]))
    axes.add_collection(PolyCollection(wedges, facecolors=tiles, edgecolors=tiles, linewidths=0.25, zorder=2))
    axes.plot(x, y, color=style.INK, linewidth=0.7, zorder=3)
    axes.annotate(
        f"max. $f\\,\\cos\\theta_o$ = {top:.3g} / sr",
        (0.99, 0.98),
        xycoords="axes fraction",
        ha="right",
        va="top",
        fontsize=6,
    )
    visible = radius > 1e-3
    return int(np.count_nonzero(clipped.is_clipped & visible)), int(np.count_nonzero(visible))


def _spokes(axes: Any, theta: float, specular: Any, bsdf: Bsdf, illuminant: str) -> None:
    axes.plot([0, -np.sin(theta)], [0, np.cos(theta)], color=style.INK, linewidth=0.7, linestyle=(0, (3, 2)), zorder=4)
    mirror = light.spectrum_to_xyz(specular.reflectance[0], bsdf.wavelengths_nm, illuminant)[1]
    if mirror > 1e-9:
        _spoke(axes, np.sin(theta), np.cos(theta), f"R = {mirror:.3g}")
    through = light.spectrum_to_xyz(specular.transmittance[0], bsdf.wavelengths_nm, illuminant)[1]
    if through > 1e-9:
        tables = [lobe.response for lobe in bsdf.lobes if hasattr(lobe, "response")]
        eta = float(tables[0].eta) if tables else 1.0
        sine = np.clip(np.sin(theta) / eta, -1.0, 1.0)
        _spoke(axes, sine, -np.sqrt(1 - sine**2), f"T = {through:.3g}")


def _spoke(axes: Any, x: float, y: float, text: str) -> None:
    axes.plot([0, x], [0, y], color=style.LINES[1], linewidth=1.0, zorder=5)
    axes.plot([x], [y], "o", color=style.LINES[1], markersize=2.5, zorder=5)
    side = 1 if x >= 0 else -1
    axes.annotate(text, (x, y), xytext=(4 * side, 0), textcoords="offset points", fontsize=6,
                  ha="left" if side > 0 else "right", va="center")  # fmt: skip


def _circle(axes: Any, is_full: bool) -> None:
    turn = np.linspace(-np.pi, np.pi, 361) if is_full else np.linspace(-np.pi / 2, np.pi / 2, 181)
    for radius in (0.5, 1.0):
        axes.plot(radius * np.sin(turn), radius * np.cos(turn), color="#dddddd", linewidth=0.5, zorder=0)
    for degrees in range(-90, 91, 30):
        spoke = np.radians(degrees)
        for flip in (1, -1) if is_full else (1,):
            axes.plot([0, np.sin(spoke)], [0, flip * np.cos(spoke)], color="#ebebeb", linewidth=0.5, zorder=0)
        lift = 0.07 if abs(degrees) == 90 else 0.0  # clear of the horizon
        place = (1.07 * np.sin(spoke), 1.07 * np.cos(spoke) + lift)
        axes.text(*place, f"{abs(degrees)}\u00b0", fontsize=5.8, color="#7a7a7a", ha="center", va="center")
    axes.plot([-1.02, 1.02], [0, 0], color=style.FAINT, linewidth=0.8, zorder=1)
    axes.set(xlim=(-1.5, 1.5), ylim=(-1.12 if is_full else -0.04, 1.16), aspect="equal")
    axes.axis("off")


def scattering_figure(data: Mapping[str, Any]) -> Figure:
    """Draw one particle's scattering as a polar diagram: s in the upper half, p in the lower, one curve a wavelength.

    Args:
        data: `theta_deg[t]`, 0 (forward) ... 180 (back); `s[..., t]` and `p[..., t]`, intensities, with a leading
            axis `wavelengths_nm[l]` if there are several; optional `title`. The radius is logarithmic over
            `decades` (default 3) below the largest value.

    Raises:
        NacreError: an array is missing.
    """
    theta, s, p = style.need(data, "scattering", "theta_deg", "s", "p")
    decades = float(data.get("decades", 3.0))
    s, p = np.atleast_2d(s), np.atleast_2d(p)
    labels = [f"{float(w):.0f} nm" for w in np.atleast_1d(data["wavelengths_nm"])] if "wavelengths_nm" in data else [""]
    top = max(float(s.max()), float(p.max()))
    if top <= 0.0:
        raise NacreError("figure scattering: the intensities are zero everywhere")
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 2.9)
        axes: Any = figure.add_subplot(projection="polar")  # PolarAxes is missing in the stubs
        for row in range(min(len(s), len(style.LINES))):
            for values, side, line_style in ((s[row], 1.0, "-"), (p[row], -1.0, "-")):
                radius = np.clip(decades + np.log10(np.maximum(values, 1e-300) / top), 0.0, None)
                label = labels[row] if side > 0 and row < len(labels) else None
                axes.plot(side * np.radians(theta), radius, line_style, color=style.LINES[row], label=label or None)
        axes.set_rticks(np.arange(0, decades + 0.5), [""] * len(np.arange(0, decades + 0.5)))
        axes.set_rmax(decades)
        axes.set_xticks(
            np.radians(np.arange(0, 360, 30)), [f"{a if a <= 180 else 360 - a}\u00b0" for a in range(0, 360, 30)]
        )
        axes.spines["polar"].set_color("#cccccc")
        axes.text(np.pi / 2, decades * 0.9, "s", ha="center", fontsize=8)
        axes.text(-np.pi / 2, decades * 0.9, "p", ha="center", va="center", fontsize=8)
        if any(labels):
            figure.legend(loc="outside right upper", handlelength=1.2)
        style.panel_title(axes, str(data.get("title", "")))
        style.small_print(figure, f"radius: log intensity, one decade a ring, {decades:g} in all")
    return figure
