"""Figures of any material by name, as drawn by `nacre plot`."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike

from nacre import light
from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError, UnsupportedError, did_you_mean
from nacre.material.material import Material, MaterialLike, as_material, recipe_provenance
from nacre.measure.colours import colour_bsdf, colour_grid, colour_spectrum
from nacre.measure.evaluate import evaluate_at_own
from nacre.plot import spectra as polarisation
from nacre.plot import style
from nacre.plot.colours import chromaticity_figure, colour_map_figure, material_tracks
from nacre.plot.directions import SLICE_NODES, bsdf_slice_figure, lobe_figure, scattering_figure
from nacre.plot.spectra import index_figure, parts_of, ribbon_figure, spectrum_figure
from nacre.plot.style import save_figure

KINDS = (
    "spectrum", "ribbon", "colour-map", "slice", "lobe", "chromaticity", "tracks",
    "field", "scattering", "structure", "platelet", "microscope", "ellipsometry", "mueller", "circular",
    "michel-levy",
)  # fmt: skip
SPECTRUM_ANGLES_DEG = (0.0, 30.0, 60.0)
LOBE_ANGLES_DEG = (10.0, 30.0, 60.0)
TRACK_ANGLES_DEG = np.linspace(0.0, 85.0, 35)
WALK_NODES = 46  # pixels along a side of a slice by random walks: 2,000 in total rather than 33,000
RIBBON_ANGLES_DEG = np.linspace(0.0, 89.0, 179)
PLOT_SAMPLES = 1024  # minimum per pair of directions; figures with few pairs take more ...
PLOT_WALKS = 1 << 16  # ... up to this total
MOST_SAMPLES = 1 << 14
MAP_ANGLES_DEG = np.linspace(0.0, 85.0, 35)
OVER_KINDS = ("spectrum", "ribbon", "tracks", "colour-map", "chromaticity")
COLOURED_DATA = ("colour-map", "platelet", "microscope")  # figures of arrays that show colours
DIRECTIONAL_KINDS = ("slice", "lobe", "tracks")
CURVE_FIGURES = {"spectrum": spectrum_figure, "ribbon": ribbon_figure}


def material_figure(
    material: MaterialLike,
    kind: str,
    *,
    angles_deg: ArrayLike | None = None,
    wavelengths_nm: ArrayLike | None = None,
    illuminant: str = "D65",
    over: tuple[str, Sequence[float] | Array] | None = None,
    lightness: float | None = None,
    evaluate: Callable[[Bsdf, Array, Array], Array] | None = None,
) -> Figure:
    """Draw a material figure.

    Args:
        material: any material, its recipe's path, an example's name or a recipe's table.
        kind: a name in `KINDS`.
        angles_deg: incidence angles, for figures with such an axis.
        wavelengths_nm: ascending; default: chosen by the material, with the lines of a narrow-band lamp.
        illuminant: lamp.
        over: for `OVER_KINDS`, a parameter of the recipe by path and its values; default: the angle, for
            a colour-map the family's own choice. All but "colour-map" and "tracks" take one angle then, 0 by default.
        lightness: for "tracks", the L* that a*, b* are scaled to; default: the sample's own values.
        evaluate: evaluates a Bsdf with random walks; its slice is coarser.

    Raises:
        UnsupportedError: unknown kind, or the family lacks this figure.
        NacreError: the material cannot be computed.
    """
    material = as_material(material)
    if kind not in KINDS:
        raise UnsupportedError(
            f'no figure is of kind "{kind}".{did_you_mean(kind, KINDS)} There are {", ".join(KINDS)}'
        )
    if over is not None and kind not in OVER_KINDS:
        raise UnsupportedError(f'only {", ".join(OVER_KINDS)} run over a number; "{kind}" does not')
    if lightness is not None and kind != "tracks":
        raise UnsupportedError(f'only "tracks" are scaled to a lightness; "{kind}" is not')
    angles = None if angles_deg is None else np.atleast_1d(np.asarray(angles_deg, dtype=float))
    requested_nm = None if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
    if kind == "tracks":
        return material_tracks(material, angles, over, wavelengths_nm, illuminant, evaluate, lightness)
    if over is not None:
        return _over_a_number(material, kind, over, angles, wavelengths_nm, illuminant)
    if kind in ("spectrum", "ribbon", "chromaticity"):
        defaults = {"spectrum": SPECTRUM_ANGLES_DEG, "ribbon": RIBBON_ANGLES_DEG, "chromaticity": TRACK_ANGLES_DEG}
        angles = np.asarray(defaults[kind], dtype=float) if angles is None else angles
        spectrum = colour_spectrum(material, np.radians(angles), illuminant, wavelengths_nm=requested_nm)
        return _over_angles(kind, spectrum, illuminant, material.name)
    if kind in polarisation.FIGURES:
        chosen = np.asarray(polarisation.ANGLES_DEG[kind]) if angles is None else angles
        return polarisation.FIGURES[kind](material.spectrum(np.radians(chosen), requested_nm, "mueller"), material.name)
    if kind in ("slice", "lobe"):
        bsdf = colour_bsdf(material, illuminant, requested_nm)
        is_walk = any(lobe.is_stochastic for lobe in bsdf.lobes)
        walk = functools.partial(evaluate, bsdf) if is_walk and evaluate is not None else None
        if kind == "slice":
            nodes = WALK_NODES if is_walk else SLICE_NODES
            return bsdf_slice_figure(bsdf, illuminant, material.name, nodes, evaluate=walk)
        angles = np.asarray(LOBE_ANGLES_DEG) if angles is None else angles
        return lobe_figure(bsdf, angles, illuminant, material.name, nodes=181 if is_walk else 721, evaluate=walk)
    options: dict[str, Any] = {}
    if wavelengths_nm is not None:
        options["wavelengths_nm"] = wavelengths_nm
    elif kind in COLOURED_DATA and (grid := colour_grid(material, illuminant)) is not None:
        options["wavelengths_nm"] = grid
    if angles is not None:
        options.update({"theta_deg": float(angles[0])} if kind == "field" else {"angles_deg": angles})
    return data_figure(kind, _family_data(material, kind, options), illuminant, material.name)


def _over_a_number(
    material: Material,
    kind: str,
    over: tuple[str, Sequence[float] | Array],
    angles_deg: Array | None,
    wavelengths_nm: ArrayLike | None,
    illuminant: str,
) -> Figure:
    """Draw the total reflectance over a parameter, and for a colour map also over the angle."""
    path, steps = over[0], np.asarray(over[1], dtype=float)
    if len(steps) < 2:
        raise NacreError(f"over {path}: give at least two values")
    default = MAP_ANGLES_DEG if kind == "colour-map" else np.zeros(1)
    angles = default if angles_deg is None else angles_deg
    if kind in CURVE_FIGURES and (len(angles) != 1 or np.any(np.diff(steps) <= 0)):
        raise UnsupportedError(f"a {kind} over a number takes one angle and ascending values; over angles, no number")
    material = material.at_low_fidelity()
    made = [material.vary({path: float(step)}) for step in steps]
    spectra = _common_spectra(made, np.radians(angles), wavelengths_nm, illuminant)
    nm = spectra[0].wavelengths_nm
    label = ".".join(path.split(".")[-2:])
    if kind in CURVE_FIGURES:
        zero = np.zeros(len(nm))
        names = {name: None for one in spectra for name in one.parts()}
        parts = {name: np.stack([one.parts().get(name, zero[None])[0] for one in spectra]) for name in names}
        at = f"{material.name}, {angles[0]:g}\u00b0"
        spectrum = Spectrum(nm, steps, **parts)
        return CURVE_FIGURES[kind](spectrum, illuminant, at, label)
    values = np.stack(
        [sum((v for name, v in one.parts().items() if name.endswith("reflectance")), 0.0 * nm) for one in spectra]
    )
    if kind == "chromaticity":
        labels = [f"{step:.4g}" for step in steps]
        return chromaticity_figure(values[:, 0], nm, labels, illuminant, f"{material.name}: {label}")
    return colour_map_figure(angles, steps, values, nm, y_label=label, illuminant=illuminant, title=material.name)


def _common_spectra(
    made: Sequence[Material], theta_rad: Array, wavelengths_nm: ArrayLike | None, illuminant: str
) -> list[Spectrum]:
    """Return spectra of several materials on a common grid: the finer grid of both ends, with the lamp's lines."""
    if wavelengths_nm is not None:
        return [one.spectrum(theta_rad, wavelengths_nm) for one in made]
    finer = max((made[0], made[-1]), key=lambda one: len(one.model.wavelengths_nm))
    grid = colour_grid(finer, illuminant)
    return [one.spectrum(theta_rad, finer.model.wavelengths_nm if grid is None else grid) for one in made]


def _over_angles(kind: str, spectrum: Spectrum, illuminant: str, name: str) -> Figure:
    if kind in CURVE_FIGURES:
        return CURVE_FIGURES[kind](spectrum, illuminant, name)
    values = next(iter(parts_of(spectrum).values()))
    labels = [f"{angle:.3g}\u00b0" for angle in spectrum.angles_deg]
    return chromaticity_figure(values, spectrum.wavelengths_nm, labels, illuminant, name)


def _family_data(material: Material, kind: str, options: dict[str, Any]) -> dict[str, Any]:
    try:
        return dict(material.figure_data(kind, **options))
    except TypeError as error:
        # the family's figure lacks this axis (a structure has no angles)
        refused = [name for name in options if name in str(error)]
        if not refused:
            raise
        words = {"theta_deg": "angles", "angles_deg": "angles", "wavelengths_nm": "wavelengths"}
        raise UnsupportedError(f'the figure of kind "{kind}" takes no {words[refused[0]]} for this material') from None


def data_figure(kind: str, data: Mapping[str, Any], illuminant: str = "D65", title: str = "") -> Figure:
    """Draw plain arrays: "field", "structure", "platelet", "scattering", "microscope", "colour-map".

    `nacre.plot` lists the arrays of each kind.

    Raises:
        NacreError: an array is missing.
        UnsupportedError: unknown kind.
    """
    data = {"title": title, **data}
    if kind == "colour-map":
        return _colour_map(data, illuminant)
    makers = {"field": field_figure, "structure": structure_figure, "scattering": scattering_figure}
    if kind in makers:
        return makers[kind](data)
    coloured = {"platelet": platelet_figure, "microscope": microscope_figure}
    if kind in coloured:
        return coloured[kind](data, illuminant)
    allowed = ["colour-map", *makers, *coloured]
    raise UnsupportedError(f'no figure of arrays is of kind "{kind}".{did_you_mean(kind, allowed)}')


def _colour_map(data: Mapping[str, Any], illuminant: str) -> Figure:
    """Draw reflectance over a first axis (thickness, density ...) and the angle."""
    missing = [name for name in ("angles_deg", "wavelengths_nm", "reflectance") if name not in data]
    if missing:
        raise NacreError(f"figure colour-map: {missing[0]} is missing")
    if "thicknesses_nm" in data:
        y, label = data["thicknesses_nm"], str(data.get("y_label", "Thickness (nm)"))
    else:
        y, label = data["y"], str(data.get("y_label", ""))
    return colour_map_figure(
        data["angles_deg"], y, data["reflectance"], data["wavelengths_nm"], y_label=label, illuminant=illuminant,
        title=str(data["title"]),
    )  # fmt: skip


def save_material(
    material: Material, kind: str, path: str | Path, *, provenance: Mapping[str, Any] | None = None, **options: Any
) -> None:
    """Draw a material figure into a file with its provenance; `options` as in `material_figure`."""
    figure = material_figure(material, kind, **options)
    illuminant = options.get("illuminant", "D65")
    save_figure(figure, path, {"figure": kind, "illuminant": illuminant, **(provenance or {})})


def save_index(constant: Any, path: str | Path, title: str = "") -> None:
    """Draw n and k of an optical constant (`nacre.matter.OpticalConstant`) into a file.

    The range is 360-830 nm as far as tabulated, or the whole range if it lies elsewhere.
    """
    low, high = constant.range_nm
    if low < 830.0 and high > 360.0:
        low, high = max(low, 360.0), min(high, 830.0)
    nm = np.linspace(low, high, 471)
    what = constant.title.partition(" (")[0].partition(";")[0]
    has_name = what.lower().startswith(constant.name.lower())
    heading = what if has_name else ", ".join(t for t in (constant.name, what) if t)
    print_ = "; ".join(text for text in (constant.source, constant.splice) if text)
    figure = index_figure(nm, constant.n_complex(nm), title or heading, print_)
    save_figure(
        figure,
        path,
        {"figure": "index", "material": constant.name, "source": constant.source, "splice": constant.splice},
    )


def plot_material(
    material: MaterialLike,
    kind: str,
    path: str | Path,
    *,
    angles_deg: ArrayLike | None = None,
    wavelengths_nm: ArrayLike | None = None,
    illuminant: str = "D65",
    over: tuple[str, Sequence[float] | Array] | None = None,
    lightness: float | None = None,
) -> None:
    """Draw a material figure into a PNG, PDF or SVG that carries the recipe; kinds: `nacre.plot.KINDS`.

    `over` and `lightness` as in `material_figure`. Figures over directions show the noise-free form
    (`quality = "fast"`) if there is one, unless the recipe names a quality.

    Raises:
        UnsupportedError: the material lacks this figure.
        NacreError: the recipe is wrong, or the file cannot be written.
    """
    material = as_material(material)
    save_material(
        as_drawn(material, kind, over), kind, path, angles_deg=angles_deg, wavelengths_nm=wavelengths_nm,
        illuminant=illuminant, over=over, lightness=lightness, provenance=recipe_provenance(material),
        evaluate=plot_walk,
    )  # fmt: skip


def as_drawn(material: Material, kind: str, over: object = None) -> Material:
    """Return the noise-free form of a material for figures over directions, if its family and recipe allow it.

    Over a parameter each step would need its own tables, so that random walks are cheaper.
    """
    if kind not in DIRECTIONAL_KINDS or over is not None or "quality" in material.data:
        return material
    try:
        return material.vary({"quality": "fast"})
    except RecipeError:  # the family has no quality
        return material


def plot_walk(bsdf: Bsdf, wi: Array, wo: Array) -> Array:
    """Evaluate a Bsdf for a figure, with fewer random-walk samples for more pairs."""
    pairs = max(1, int(np.prod(np.shape(wi)[:-1])))
    return evaluate_at_own(bsdf, wi, wo, samples=int(np.clip(PLOT_WALKS // pairs, PLOT_SAMPLES, MOST_SAMPLES)))


# Structure figures: fields, stacks, flakes, structure factors, microscope images.

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
