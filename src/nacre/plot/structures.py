"""Structure figures: fields, stacks, flakes, structure factors, microscope images."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from nacre import light
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.plot import style

BAND = ("#eef3f8", "#dfe8f1")  # two quiet tints that alternate through a stack
MAX_BANDS_NAMED = 8


def field_figure(data: Mapping[str, Any]) -> Figure:
    """Draw |E|^2 through a stack over depth, or over depth and wavelength as an image.

    Args:
        data: `z_nm[z]`, depth below the first interface; `s[z, l]` and `p[z, l]` (or `intensity[z, l]`), relative
            to the incident wave; `wavelengths_nm[l]`; `interfaces_nm[i]`, from the first to the last; optional
            media `names[i + 1]`, `theta_deg`, `title`. Up to 3 wavelengths are drawn as curves.

    Raises:
        NacreError: an array is missing.
    """
    z, nm, interfaces = style.need(data, "field", "z_nm", "wavelengths_nm", "interfaces_nm")
    nm, interfaces = np.atleast_1d(nm), np.atleast_1d(interfaces)
    waves = {"s": "s", "p": "p"} if "s" in data else {"intensity": ""}
    theta = float(np.asarray(data.get("theta_deg", 0.0)))
    fields = {label: style.need(data, "field", key)[0].reshape(len(z), len(nm)) for key, label in waves.items()}
    if theta == 0.0 and len(fields) == 2 and np.allclose(fields["s"], fields["p"], rtol=1e-6):
        fields = {"": fields["s"]}  # equal at normal incidence, but for anisotropic layers
    title = str(data.get("title", ""))
    with style.house_style():
        if len(nm) <= 3:
            figure = style.new_figure(style.COLUMN_IN, 2.2)
            axes = figure.add_subplot()
            for (label, values), line_style in zip(fields.items(), ("-", "--")):
                for column, wavelength in enumerate(nm):
                    name = " ".join(part for part in (f"{wavelength:.0f} nm", label) if part)
                    axes.plot(z, values[:, column], line_style, color=style.LINES[column], label=name)
            axes.set(xlim=(z[0], z[-1]), ylim=(0, None), xlabel="Depth (nm)", ylabel="$|E|^2 / |E_0|^2$")
            _bands(axes, interfaces, data.get("names"))
            axes.legend(loc="upper right", handlelength=1.4)
            style.panel_title(axes, title)
        else:
            figure = style.new_figure(style.COLUMN_IN, 0.5 + 1.9 * len(fields))
            top = max(float(v.max()) for v in fields.values())
            for row, (label, values) in enumerate(fields.items()):
                axes = figure.add_subplot(len(fields), 1, row + 1)
                picture = axes.pcolormesh(z, nm, values.T, cmap="magma", vmin=0.0, vmax=top, rasterized=True)
                for edge in interfaces:
                    axes.axvline(edge, color="white", linewidth=0.5, alpha=0.7)
                axes.set_ylabel("Wavelength (nm)")
                if row == len(fields) - 1:
                    axes.set_xlabel("Depth (nm)")
                bar = figure.colorbar(picture, ax=axes, aspect=18, pad=0.02)
                bar.outline.set_visible(False)
                bar.set_label("$|E|^2 / |E_0|^2$")
                style.panel_title(axes, ", ".join(part for part in (label and f"{label} polarised", title) if part))
        style.small_print(figure, f"incidence {theta:.3g}\u00b0; light comes from the left")
    return figure


def _bands(axes: Any, interfaces: Array, names: Any) -> None:
    """Tint the layers between interfaces and write the media's names above."""
    for i, (start, stop) in enumerate(zip(interfaces[:-1], interfaces[1:])):
        axes.axvspan(start, stop, color=BAND[i % 2], zorder=0, linewidth=0)
    for edge in interfaces:
        axes.axvline(edge, color="#b8c4d0", linewidth=0.5, zorder=0.5)
    if names is None or len(interfaces) + 1 > MAX_BANDS_NAMED:
        return
    low, high = axes.get_xlim()
    bounds = [low, *interfaces, high]
    for name, start, stop in zip(names, bounds[:-1], bounds[1:]):
        axes.text(0.5 * (start + stop), 0.985, str(name), transform=axes.get_xaxis_transform(), ha="center", va="top",
                  fontsize=6, color="#5a6b7c")  # fmt: skip


def structure_figure(data: Mapping[str, Any]) -> Figure:
    """Draw a layer stack, the structure factor of a monolayer, or a height map.

    Args:
        data: for a stack `names[medium]` from the light's side, `thicknesses_nm[layer]`, `n[medium]`, `k[medium]`,
            optional `wavelength_nm`. For a monolayer `q[q]` (dimensionless, or with `q_label`),
            `sq[..., q]` with optional `labels`, and optional points `xy_um[point, 2]` with `radius_um`. For a relief
            `heights_nm[x, y]` and `x_nm[x]`.

    Raises:
        NacreError: an array is missing.
    """
    if "thicknesses_nm" in data:
        return _stack(data)
    if "heights_nm" in data:
        return _heights(data)
    q, sq = style.need(data, "structure", "q", "sq")
    sq = np.atleast_2d(sq)
    labels = list(np.atleast_1d(data.get("labels", [""] * len(sq))))
    has_points = "xy_um" in data
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 4.3 if has_points else 2.1)
        axes = figure.add_subplot(2 if has_points else 1, 1, 1)
        for row in range(min(len(sq), len(style.LINES))):
            axes.plot(q, sq[row], color=style.LINES[row], label=str(labels[row]) or None)
        axes.axhline(1.0, color="#c8c8c8", linewidth=0.6, zorder=0)
        axes.set(xlim=(q[0], q[-1]), ylim=(0, None), xlabel=str(data.get("q_label", "$q a$")), ylabel="$S(q)$")
        if any(str(label) for label in labels):
            axes.legend(handlelength=1.4)
        style.panel_title(axes, str(data.get("title", "Structure factor")))
        if has_points:
            _points(figure.add_subplot(2, 1, 2), data)
    return figure


def _heights(data: Mapping[str, Any]) -> Figure:
    heights, x = style.need(data, "structure", "heights_nm", "x_nm")
    heights = heights - heights.min()
    width = float(x[-1] + x[0]) / 1e3
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, style.COLUMN_IN * 0.85)
        axes = figure.add_subplot()
        picture = axes.imshow(heights.T, origin="lower", extent=(0, width, 0, width), cmap="cividis")
        axes.set(xlabel="$x$ (\u00b5m)", ylabel="$y$ (\u00b5m)")
        bar = figure.colorbar(picture, ax=axes, shrink=0.9)
        bar.set_label("Height (nm)")
        style.panel_title(axes, str(data.get("title", "Relief")))
    return figure


def _points(axes: Any, data: Mapping[str, Any]) -> None:
    (xy,) = style.need(data, "structure", "xy_um")
    radius = float(np.asarray(data.get("radius_um", 0.05)))
    from matplotlib.collections import EllipseCollection

    size = 2 * radius * np.ones(len(xy))
    discs = EllipseCollection(size, size, 0.0 * size, units="xy", offsets=xy, offset_transform=axes.transData)
    discs.set(facecolor=style.INK, linewidth=0)
    axes.add_collection(discs)
    low, high = xy.min(axis=0), xy.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x (\u00b5m)", ylabel="y (\u00b5m)")


def _stack(data: Mapping[str, Any]) -> Figure:
    thicknesses, n, k = (
        style.need(data, "structure", "thicknesses_nm", "n", "k")
        if len(data["thicknesses_nm"])
        else (np.zeros(0), *style.need(data, "structure", "n", "k"))
    )
    names = [str(name) for name in data["names"]]
    total = max(float(thicknesses.sum()), 1.0)
    margin = 0.22 * total
    edges = np.concatenate([[0.0], np.cumsum(thicknesses)])
    bounds = np.concatenate([[-margin], edges, [edges[-1] + margin]])
    span = float(n.max() - n.min()) or 1.0
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 2.6)
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(0.42, 1.0))
        for i, name in enumerate(names):
            tint = 0.97 - 0.42 * (n[i] - n.min()) / span
            face = (tint * 0.93, tint * 0.97, min(tint * 1.02, 1.0))
            left.add_patch(Rectangle((0, bounds[i]), 1, bounds[i + 1] - bounds[i], facecolor=face, edgecolor="none"))
            if len(names) <= MAX_BANDS_NAMED + 2 or i in (0, len(names) - 1):
                text = name if i in (0, len(names) - 1) else f"{name}, {thicknesses[i - 1]:.4g} nm"
                left.text(0.5, 0.5 * (bounds[i] + bounds[i + 1]), text, ha="center", va="center", fontsize=6)
        for edge in edges:
            left.axhline(edge, color="white", linewidth=0.6)
        left.set(xlim=(0, 1), ylim=(bounds[-1], bounds[0]), xticks=[], ylabel="Depth (nm)")
        left.spines["bottom"].set_visible(False)
        depth = np.repeat(bounds, 2)[1:-1]
        right.plot(np.repeat(n, 2), depth, color=style.LINES[0], label="$n$", solid_capstyle="butt")
        if k.max() > 1e-4:
            right.plot(np.repeat(k, 2), depth, "--", color=style.LINES[1], label="$k$", dash_capstyle="butt")
        right.set(xlim=(0, 1.1 * max(float(n.max()), float(k.max()))), xlabel="$n$, $k$")
        right.grid(axis="x")
        right.legend(handlelength=1.6, loc="best")
        style.panel_title(left, str(data.get("title", "")))
        if "wavelength_nm" in data:
            style.small_print(
                figure, f"n, k at {float(np.asarray(data['wavelength_nm'])):.0f} nm; light comes from above"
            )
    return figure


def platelet_figure(data: Mapping[str, Any], illuminant: str = "D65") -> Figure:
    """Draw platelet colours over the incidence angle: a pair of ribbons (reflected, transmitted) each.

    Args:
        data: `angles_deg[a]`; `wavelengths_nm[l]`; `reflectance[..., a, l]` and optional `transmittance[..., a, l]`,
            with a leading axis for several types, named by `names`; optional `title`.
        illuminant: lamp.

    Raises:
        NacreError: an array is missing.
    """
    angles, nm, reflected = style.need(data, "platelet", "angles_deg", "wavelengths_nm", "reflectance")
    reflected = reflected.reshape(-1, len(angles), len(nm))
    parts = [("reflected", reflected)]
    if "transmittance" in data:
        (through,) = style.need(data, "platelet", "transmittance")
        parts.append(("transmitted", through.reshape(reflected.shape)))
    names = [str(name) for name in np.atleast_1d(data.get("names", [""] * len(reflected)))]
    rows = [(name, part, values[i]) for i, name in enumerate(names) for part, values in parts]
    exposure = style.exposure_of(light.spectrum_to_xyz(reflected, nm, illuminant))
    clipped = 0
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, 0.55 + 0.42 * len(rows))
        all_axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, part, values) in zip(all_axes, rows):
            colours, _, count = style.shown_colours(values, nm, illuminant, exposure if part == "reflected" else 1.0)
            clipped += count
            axes.pcolormesh(style.cell_edges(angles), [0, 1], colours[None], rasterized=True)
            axes.set_yticks([])
            axes.spines[["left", "bottom"]].set_visible(False)
            style.panel_title(axes, ", ".join(t for t in (name, part) if t))
        all_axes[-1].set_xlabel("Angle of incidence (degrees)")
        if data.get("title"):
            figure.suptitle(str(data["title"]), fontsize=8)
        brighter = f"; reflected shown {exposure:g}\u00d7 brighter" if exposure != 1.0 else ""
        style.small_print(figure, style.remark(illuminant, 1.0, clipped, len(rows) * len(angles)) + brighter)
    return figure


def microscope_figure(data: Mapping[str, Any], illuminant: str = "D65") -> Figure:
    """Draw a microscope image in its own colours, with a scale bar.

    Args:
        data: `rgb[y, x, 3]`, linear sRGB, or `spectra[y, x, l]` with `wavelengths_nm[l]`, or `intensity[y, x]`;
            `extent_um`, the image width; optional `title`, and `exposure`, by default the factor that maps
            the 99.5th luminance percentile to white.
        illuminant: lamp for spectra.

    Raises:
        NacreError: an array is missing or has another shape.
    """
    if "spectra" in data:
        spectra, nm = style.need(data, "microscope", "spectra", "wavelengths_nm")
        rgb = light.spectrum_to_rgb_linear(spectra, nm, illuminant)
    elif "rgb" in data:
        (rgb,) = style.need(data, "microscope", "rgb")
    else:
        (grey,) = style.need(data, "microscope", "intensity")
        rgb = np.repeat(grey[..., None], 3, axis=-1)
    if rgb.ndim != 3 or rgb.shape[-1] != 3:
        raise NacreError(f"figure microscope: the image has shape {rgb.shape}; it should be [y, x, 3]")
    luminance = light.srgb_linear_to_xyz(rgb)[..., 1]
    level = float(np.percentile(luminance, 99.5)) or 1.0
    exposure = float(data.get("exposure", 1.0 / level if level > 0 else 1.0))
    clipped = light.clip_to_srgb(rgb * exposure)
    (extent,) = style.need(data, "microscope", "extent_um")
    width = float(np.atleast_1d(extent)[0])
    height = width * rgb.shape[0] / rgb.shape[1]
    with style.house_style():
        figure = style.new_figure(style.COLUMN_IN, min(style.COLUMN_IN * rgb.shape[0] / rgb.shape[1], 5.0) + 0.25)
        axes = figure.add_subplot()
        axes.imshow(light.srgb_encode(clipped.rgb), extent=(0, width, 0, height), interpolation="nearest")
        _scale_bar(axes, width, height)
        axes.axis("off")
        style.panel_title(axes, str(data.get("title", "")))
        stated = illuminant if "spectra" in data else None
        text = style.remark(stated, 1.0, clipped.count, luminance.size)
        style.small_print(figure, "; ".join(t for t in (text, f"exposure {exposure:.3g}") if t))
    return figure


def _scale_bar(axes: Any, width: float, height: float) -> None:
    target = 0.25 * width
    decade = 10.0 ** np.floor(np.log10(target))
    length = decade * max(s for s in (1, 2, 5) if s * decade <= target * (1 + 1e-9))
    pad, thick = 0.035 * width, 0.008 * width
    axes.add_patch(
        Rectangle(
            (width - 2 * pad - length, 0.6 * pad), length + 1.4 * pad, 2.5 * pad, color="black", alpha=0.45, linewidth=0
        )
    )
    axes.add_patch(Rectangle((width - 1.3 * pad - length, pad), length, thick, color="white", linewidth=0))
    text = f"{length:g} \u00b5m" if length >= 1 else f"{1000 * length:g} nm"
    axes.text(
        width - 1.3 * pad - 0.5 * length, pad + 1.6 * thick, text, color="white", ha="center", va="bottom", fontsize=6.5
    )
