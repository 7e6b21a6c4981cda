"""Fit report as a self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from nacre.analysis.ellipsometry import EllipsometryData
from nacre.analysis.fit import Fit, Measured, is_at_bound
from nacre.analysis.fit_data import ColourData, Data, Joint, OrdersData, TextureData, parts_of
from nacre.analysis.measured import POLARISED
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import write_text
from nacre.core.html import render_page
from nacre.light import delta_e_2000, smooth_weights, spans_colour, swatch_hex, white_xyz, xyz_to_lab
from nacre.optimise.parameters import Parameter
from nacre.plot.style import DPI, data_uri

if TYPE_CHECKING:
    from nacre.plot import DesignSheet, Figure, FitPanel

LIGHT = ("D65", "10deg")
MAX_CURVES = 5  # drawn angles, selected by their residuals
RIBBON_DEG = np.linspace(0.0, 80.0, 41)
LEGEND = ("measured", "fitted")


def write_fit_page(path: str | Path, fit: Fit, measured: Data, free: Sequence[Parameter]) -> None:
    """Write the fit report as HTML: fitted numbers, and measured beside fitted spectra or BSDF values.

    Args:
        fit, measured, free: from `run_fit`, `read_measurement` and `fit_parameters`.

    Raises:
        NacreError: the file cannot be written, or the fitted material cannot be computed.
    """
    page = render_page(
        "fit_report.html",
        title=f"{fit.material.name}, fitted",
        fit=fit,
        numbers=[(number, bounds, is_at_bound(number, bounds)) for number, bounds in zip(fit.numbers, free)],
        count=measured.values.size,
        figure=data_uri(_figure(fit, measured, free), DPI),
    )
    write_text(Path(path), page)


def _needs_panels(measured: Data) -> bool:
    """Whether each quantity has a panel: all but scattering and spectra that have colours."""
    if isinstance(measured, Joint | EllipsometryData | ColourData | TextureData | OrdersData):
        return True
    measured = cast(Measured, measured)
    return measured.kind == "spectrum" and not spans_colour(measured.wavelengths_nm)


def _figure(fit: Fit, measured: Data, free: Sequence[Parameter]) -> Figure:
    if _needs_panels(measured):
        from nacre.plot import fit_panels_figure

        return fit_panels_figure(_panels(fit, measured), f"{fit.material.name}, fitted")
    measured = cast(Measured, measured)
    if measured.kind == "spectrum":
        from nacre.plot import design_figure

        return design_figure(_sheet(fit, measured, free))
    from nacre.plot import agreement_figure

    assert measured.gonio is not None
    away = np.degrees(np.arccos(np.clip(np.abs(measured.gonio.wo[:, 2]), 0.0, 1.0)))
    return agreement_figure(
        measured.values, measured.values + fit.residual, away, measured.wavelengths_nm, f"{fit.material.name}, fitted"
    )


def _panels(fit: Fit, measured: Data) -> list[FitPanel]:
    """Return Psi and Delta, or the other quantities, of each measurement."""
    from nacre.plot import FitPanel

    places = measured.places if isinstance(measured, Joint) else [slice(None)]
    panels = []
    for part, place in zip(parts_of(measured), places):
        fitted = part.values + fit.residual.ravel()[place].reshape(part.values.shape)
        if isinstance(part, EllipsometryData):
            panels += [
                FitPanel(f"{title}: {Path(part.name).name[:24]}", *labels, curves)
                for title, labels, curves in part.curves(fitted)
            ]
        elif isinstance(part, ColourData):
            place_of = np.arange(len(part.labels), dtype=float)
            drawn = tuple((f"{c}*", place_of, part.values[:, i], fitted[:, i]) for i, c in enumerate("Lab"))
            panels.append(FitPanel(", ".join(part.labels)[:60], "Geometry", "CIELAB", drawn))
        elif isinstance(part, TextureData):
            place_of = np.arange(len(part.values), dtype=float)
            drawn = (("texture", place_of, part.values, fitted),)
            panels.append(FitPanel(", ".join(map(str, part.quantities))[:60], "Quantity", "Texture", drawn))
        elif isinstance(part, OrdersData):
            panels.append(FitPanel(Path(part.name).name[:24], "Wavelength (nm)", "Efficiency", part.curves(fitted)))
        elif part.kind == "spectrum":
            spectrum = cast(Measured, part)
            assert spectrum.angles_deg is not None
            drawn = tuple(
                (f"{name.replace('_', ' ')}, {angle:g}\u00b0", spectrum.wavelengths_nm, part.values[i, j], fitted[i, j])
                for i, name in enumerate(spectrum.parts)
                for j, angle in enumerate(spectrum.angles_deg)
            )
            panels.append(FitPanel(Path(spectrum.name).name[:24], "Wavelength (nm)", "Share of the light", drawn))
    return panels


def _sheet(fit: Fit, measured: Measured, free: Sequence[Parameter]) -> DesignSheet:
    """Return the sheet for a fitted spectrum: measured and fitted curves, colours, structure."""
    from nacre.plot import DesignSheet, Swatch

    assert measured.angles_deg is not None
    nm = measured.wavelengths_nm
    curves: dict[str, Array] = {}
    targets: dict[str, Array] = {}
    swatches = []
    off = np.sqrt(np.mean(fit.residual**2, axis=-1))
    far = set(np.argsort(off.ravel())[::-1][:MAX_CURVES].tolist())
    for i, part in enumerate(measured.parts):
        for j, angle in enumerate(measured.angles_deg):
            label = f"{part.replace('_', ' ')}, {angle:g}\u00b0"
            data = measured.values[i, j]
            fitted = data + fit.residual[i, j]
            swatches.append(Swatch(label, *_pair(data, fitted, nm)))
            if i * len(measured.angles_deg) + j in far:
                curves[label], targets[label] = fitted, np.stack([nm, data])
    bars = [
        (n.path, 100.0 * n.half_width / (f.high - f.low))
        for n, f in zip(fit.numbers, free, strict=True)
        if np.isfinite(n.half_width)
    ]
    angles, ribbon, label = _ribbon(fit, measured)
    return DesignSheet(
        f"{fit.material.name}: relative rms {fit.relative_rms:.3g}",
        swatches,
        nm,
        curves,
        targets,
        angles,
        ribbon,
        label,
        *fit.material.layers(),
        [f"{n.path} = {n.value:.5g}" for n in fit.numbers],
        sorted(bars, key=lambda bar: -bar[1]),
        "95 % half width, per cent of the bounds",
        LIGHT[0],
        LEGEND,
    )


def _pair(data: Array, fitted: Array, nm: Array) -> tuple[str, str, str]:
    """Return screen colours for a measured and a fitted spectrum, and their dE00 as text."""
    white = white_xyz(*LIGHT)
    xyz = np.stack([data, fitted]) @ smooth_weights(nm, *LIGHT)
    lab = np.asarray(xyz_to_lab(np.clip(xyz, 0.0, None), white))
    return swatch_hex(xyz[0], white), swatch_hex(xyz[1], white), f"dE00 {float(delta_e_2000(lab[0], lab[1])):.2f}"


def _ribbon(fit: Fit, measured: Measured) -> tuple[Array, Array, str]:
    """Return angles and spectra for the first measured part; slow materials only at the measured angles."""
    part, nm = measured.parts[0], measured.wavelengths_nm
    label = f"Angle of the light, fitted {part.replace('_', ' ')} (degrees)"
    name, polarisation = POLARISED.get(part, (part, "both"))
    assert measured.angles_deg is not None
    if fit.material.model.traits.is_quick:
        try:
            spectra = fit.material.spectrum(np.radians(RIBBON_DEG), nm, polarisation).parts().get(name)
        except NacreError:  # an angle outside the family's range
            spectra = None
        if spectra is not None:
            return RIBBON_DEG, spectra, label
    values = measured.values[0] + fit.residual[0]
    angles = measured.angles_deg
    if len(angles) == 1:  # a ribbon has a width
        angles, values = angles[0] + np.array([-0.5, 0.5]), np.repeat(values, 2, axis=0)
    return angles, values, label
