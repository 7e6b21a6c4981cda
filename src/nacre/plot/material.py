"""Figures of any material by name, as drawn by `nacre plot`."""

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError, UnsupportedError, did_you_mean
from nacre.material.material import Material, MaterialLike, as_material, recipe_provenance
from nacre.measure.colours import colour_bsdf, colour_grid, colour_spectrum
from nacre.measure.evaluate import evaluate_with_error
from nacre.plot import spectra as polarisation
from nacre.plot.colours import chromaticity_figure, colour_map_figure, material_tracks
from nacre.plot.directions import SLICE_NODES, bsdf_slice_figure, lobe_figure, scattering_figure
from nacre.plot.spectra import index_figure, parts_of, ribbon_figure, spectrum_figure
from nacre.plot.structures import field_figure, microscope_figure, platelet_figure, structure_figure
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
    if kind == "tracks":
        return material_tracks(material, angles, over, wavelengths_nm, illuminant, evaluate, lightness)
    if over is not None:
        return _over_a_number(material, kind, over, angles, wavelengths_nm, illuminant)
    if kind in ("spectrum", "ribbon", "chromaticity"):
        defaults = {"spectrum": SPECTRUM_ANGLES_DEG, "ribbon": RIBBON_ANGLES_DEG, "chromaticity": TRACK_ANGLES_DEG}
        angles = np.atleast_1d(np.asarray(defaults[kind] if angles_deg is None else angles_deg, dtype=float))
        asked = None if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        spectrum = colour_spectrum(material, np.radians(angles), illuminant, wavelengths_nm=asked)
        return _over_angles(kind, spectrum, illuminant, material.name)
    if kind in polarisation.FIGURES:
        asked = None if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        chosen = np.asarray(polarisation.ANGLES_DEG[kind]) if angles is None else angles
        return polarisation.FIGURES[kind](material.spectrum(np.radians(chosen), asked, "mueller"), material.name)
    if kind in ("slice", "lobe"):
        bsdf = colour_bsdf(material, illuminant, None if wavelengths_nm is None else np.asarray(wavelengths_nm))
        is_walk = any(lobe.is_stochastic for lobe in bsdf.lobes)
        walk = None
        if is_walk and evaluate is not None:
            walk = functools.partial(evaluate, bsdf)
        if kind == "slice":
            nodes = WALK_NODES if is_walk else SLICE_NODES
            return bsdf_slice_figure(bsdf, illuminant, material.name, nodes, evaluate=walk)
        angles = np.atleast_1d(np.asarray(LOBE_ANGLES_DEG if angles_deg is None else angles_deg, dtype=float))
        return lobe_figure(bsdf, angles, illuminant, material.name, nodes=181 if is_walk else 721, evaluate=walk)
    options: dict[str, Any] = {}
    if wavelengths_nm is not None:
        options["wavelengths_nm"] = wavelengths_nm
    elif kind in COLOURED_DATA and (grid := colour_grid(material, illuminant)) is not None:
        options["wavelengths_nm"] = grid
    if angles_deg is not None:
        angles = np.atleast_1d(np.asarray(angles_deg, dtype=float))
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
    if kind in ("spectrum", "ribbon") and (len(angles) != 1 or np.any(np.diff(steps) <= 0)):
        raise UnsupportedError(f"a {kind} over a number takes one angle and ascending values; over angles, no number")
    material = material.at_low_fidelity()
    made = [material.vary({path: float(step)}) for step in steps]
    spectra = _common_spectra(made, np.radians(angles), wavelengths_nm, illuminant)
    nm = spectra[0].wavelengths_nm
    label = ".".join(path.split(".")[-2:])
    if kind in ("spectrum", "ribbon"):
        zero = np.zeros(len(nm))
        names = {name: None for one in spectra for name in one.parts()}
        parts = {name: np.stack([one.parts().get(name, zero[None])[0] for one in spectra]) for name in names}
        at = f"{material.name}, {angles[0]:g}\u00b0"
        found = Spectrum(nm, steps, **parts)
        if kind == "spectrum":
            return spectrum_figure(found, illuminant, at, label)
        return ribbon_figure(found, illuminant, at, label)
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
    if kind == "spectrum":
        return spectrum_figure(spectrum, illuminant, name)
    if kind == "ribbon":
        return ribbon_figure(spectrum, illuminant, name)
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
    known = ["colour-map", *makers, *coloured]
    raise UnsupportedError(f'no figure of arrays is of kind "{kind}".{did_you_mean(kind, known)}')


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


def save_index(constant: Any, path: str | Path, title: str = "", wavelengths_nm: ArrayLike | None = None) -> None:
    """Draw n and k of an optical constant (`nacre.matter.OpticalConstant`) into a file.

    The range is 360-830 nm as far as tabulated, or the whole range if it lies elsewhere.
    """
    low, high = constant.range_nm
    if wavelengths_nm is None:
        overlaps = low < 830.0 and high > 360.0
        wavelengths_nm = (
            np.linspace(max(low, 360.0), min(high, 830.0), 471) if overlaps else np.linspace(low, high, 471)
        )
    nm = np.asarray(wavelengths_nm, dtype=float)
    what = constant.title.partition(" (")[0].partition(";")[0]
    heading = (
        what if what.lower().startswith(constant.name.lower()) else ", ".join(t for t in (constant.name, what) if t)
    )
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
    return evaluate_with_error(bsdf, wi, wo, samples=int(np.clip(PLOT_WALKS // pairs, PLOT_SAMPLES, MOST_SAMPLES)))[0]
