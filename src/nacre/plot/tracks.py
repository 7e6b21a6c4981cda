"""Colour tracks of gloss and diffuse light, near and far from the mirror direction, over an angle or a parameter.

The reflected and the transmitted colour of its flakes characterise a pearl (Guillen et al. 2020, figures 9, 10, 12).
Other materials are measured in the same two directions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nacre import light
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import from_half_difference
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.measure.colours import colour_bsdf
from nacre.plot.colours import draw_hue_circle, draw_locus, draw_track
from nacre.plot.style import INK, LINES, house_style, new_figure, panel_title, shown_colours, small_print

Evaluate = Callable[[Bsdf, Array, Array], Array]
WIDTH_IN, HEIGHT_IN = 7.2, 2.7
GLOSS_HALF_DEG = 4.0  # outside a clear coat's reflection, within the flakes' lobe
GLOSS_DEG = np.arange(5.0, 71.0, 5.0)
RADIAL_DEG = np.arange(15.0, 51.0, 5.0)  # half angle = difference angle: away from the mirror direction
STEP_GLOSS_DEG, STEP_DIFFUSE_DEG = (
    (GLOSS_HALF_DEG, 10.0),
    (40.0, 10.0),
)  # half and difference angle, for tracks over a parameter
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
        evaluate: replaces `bsdf.evaluate` for random walks.

    Raises:
        NacreError: all reflectances are zero.
    """
    gloss = GLOSS_DEG if angles_deg is None else np.atleast_1d(np.asarray(angles_deg, dtype=float))
    radial = RADIAL_DEG if angles_deg is None else gloss[(gloss >= RADIAL_DEG[0]) & (gloss <= RADIAL_DEG[-1])]
    found = {"gloss": Track(gloss, _gloss(bsdf, GLOSS_HALF_DEG, gloss, evaluate))}
    if len(radial):
        found["diffuse"] = Track(radial, _scattered(bsdf, radial, radial, evaluate))
    return _bright(found, bsdf.wavelengths_nm)


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
    values = bsdf.evaluate(wi, wo) if evaluate is None else evaluate(bsdf, wi, wo)
    return np.pi * np.maximum(values, 0.0)


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
    """Draw tracks through CIE xy and a*, b*, and their luminance over the step.

    The axes show the actual values; the points are coloured at L* 50 to show their hues.

    Args:
        tracks: by name, "gloss" and "diffuse" as a rule.
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
        found = angle_tracks(bsdf, angles_deg, evaluate)
        return tracks_figure(
            found, bsdf.wavelengths_nm, illuminant=illuminant, title=material.name, lightness=lightness
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
    found, nm = number_tracks(made, steps, evaluate, grid, illuminant)
    return tracks_figure(found, nm, ".".join(path.split(".")[-2:]), illuminant, material.name, lightness)
