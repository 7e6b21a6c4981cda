"""Reports as text, JSON and one self-contained HTML page with embedded figures."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.analysis.report import ColourTable, Comparison, Report
from nacre.bsdf.bsdf import Spectrum
from nacre.core.errors import UnsupportedError
from nacre.core.html import render_page
from nacre.light.colour_spaces import DIN_6175
from nacre.material.material import Material
from nacre.measure.colours import colour_spectrum
from nacre.measure.texture import texture_document, texture_rows
from nacre.plot.style import data_uri

if TYPE_CHECKING:
    from nacre.plot import Figure


CURVE_ANGLES_DEG = (0.0, 30.0, 60.0)
RIBBON_ANGLES_DEG = tuple(np.linspace(0.0, 88.0, 45))
COARSE_ANGLES_DEG = tuple(np.linspace(0.0, 80.0, 9))  # if each angle needs a hemisphere of directions
SCREEN_DPI = 200  # sharp on dense screens


def figures(materials: list[Material], reports: list[Report]) -> dict[str, str]:
    """Return a report's figures: caption -> data URI.

    For each material: its spectra and its colour over the incidence angle. For all materials: the path of the
    aspecular colours through a*, b*.

    Raises:
        NacreError: a material cannot be computed.
    """
    from nacre.plot import ribbon_figure, spectrum_figure

    images: dict[str, str] = {}
    for number, (material, report) in enumerate(zip(materials, reports, strict=True)):
        # captions are keys, so recipes of the same name are numbered
        name = report.name if [r.name for r in reports].count(report.name) == 1 else f"{report.name} ({number + 1})"
        curves = _spectrum(material, CURVE_ANGLES_DEG, report.illuminant)
        if curves is None:
            continue
        images[f"{name}: spectra at {', '.join(f'{a:g}' for a in CURVE_ANGLES_DEG)} degrees"] = data_uri(
            spectrum_figure(curves, report.illuminant, name), SCREEN_DPI
        )
        is_plain = "diffuse_reflectance" not in curves.parts()
        over_angle = _spectrum(material, RIBBON_ANGLES_DEG if is_plain else COARSE_ANGLES_DEG, report.illuminant)
        if over_angle is not None:
            images[f"{name}: colour over the angle of incidence"] = data_uri(
                ribbon_figure(over_angle, report.illuminant, name), SCREEN_DPI
            )
    images["colour travel in a*b* over the aspecular angles (or over incidence, for mirrors)"] = data_uri(
        travel_figure(reports), SCREEN_DPI
    )
    return images


def travel_figure(reports: list[Report]) -> Figure:
    """Draw the reports' colours in a*, b* and L*, C*, one marker per report.

    A report with a black aspecular table (a mirror) shows the colours of the mirror direction.
    """
    from nacre.plot import gamut_figure

    tables = [
        r.specular if r.specular is not None and np.all(r.aspecular.xyz[:, 1] < 1e-6) else r.aspecular for r in reports
    ]
    longest = max(len(table.xyz) for table in tables)
    xyz = np.full((len(tables), longest, 3), np.nan)
    for row, table in zip(xyz, tables):
        row[: len(table.xyz)] = table.xyz
    labels = [report.name for report in reports] if len(reports) > 1 else []
    return gamut_figure(xyz, reports[0].illuminant, reports[0].observer, "CIELAB, angle by angle", labels, tracks=True)


def _spectrum(material: Material, angles_deg: tuple[float, ...], illuminant: str) -> Spectrum | None:
    """Return a material's spectrum, or None if its family has none."""
    try:
        return colour_spectrum(material, np.radians(angles_deg), illuminant)
    except UnsupportedError:
        return None


def report_json(reports: list[Report], comparisons: Sequence[Comparison] = ()) -> dict[str, Any]:
    """Return one report, or several with their comparisons with the first, as data for JSON."""
    document: dict[str, Any] = {"reports": [_document(report) for report in reports]}
    if comparisons:
        key = "differences_to_standard" if comparisons[0].standard else "differences_to_first"
        document[key] = [
            {
                "name": comparison.name,
                "formula": comparison.formula,
                **({"geometries": list(comparison.labels["standard"])} if comparison.standard else {}),
                **{name: _clean(values.tolist()) for name, values in comparison.tables.items()},
                "passes": comparison.passes,
            }
            for comparison in comparisons
        ]
    return document


def _document(report: Report) -> dict[str, Any]:
    return {
        "name": report.name,
        "illuminant": report.illuminant,
        "observer": report.observer,
        "aspecular": _table_document(report.aspecular),
        "specular": None if report.specular is None else _table_document(report.specular),
        "geometries": None if report.geometries is None else _table_document(report.geometries),
        "flop_index": _clean(report.flop_index),
        "gloss": _clean(report.gloss),
        "reflection_haze_percent": _clean(report.reflection_haze),
        "transmission_haze_percent": _clean(report.transmission_haze),
        "hemispherical": _clean(report.hemispherical),
        "largest_standard_error": report.noise,
        "selective_reflection": {angle: dict(band.__dict__) for angle, band in report.selective.items()},
        "order_width_deg": report.order_width_deg,
        "dark_geometries": list(report.dark_geometries),
        "texture": None if report.texture is None else _clean(texture_document(report.texture)),
        "provenance": report.provenance,
    }


def _table_document(table: ColourTable) -> dict[str, Any]:
    return {
        "what": table.what,
        "angles_deg": table.angles_deg.tolist(),
        "geometries": list(table.labels),
        "xyz": table.xyz.tolist(),
        "lab": table.lab.tolist(),
        "lch": table.lch.tolist(),
        "travel_ab": table.travel,
        "srgb": list(table.hex),
    }


def _clean(value: Any) -> Any:
    """Return data with None in place of NaN and infinity."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {k: _clean(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_clean(v) for v in value]
    return value


WHITE_L, PER_CENT = 100.0, 100.0
SURFACE_NAMES = {
    "sq_um": "Sq (um)", "sdq": "Sdq", "correlation_length_um": "correlation length (um)", "tilt_deg": "tilt (degrees)",
    "peak_to_valley_um": "peak to valley (um)", "points_x": "points along x", "points_y": "points along y",
    "pitch_x_um": "pitch along x (um)", "pitch_y_um": "pitch along y (um)",
}  # fmt: skip


def report_text(reports: list[Report], comparisons: Sequence[Comparison] = ()) -> str:
    """Return reports as plain text, followed by their comparisons."""
    lines: list[str] = []
    for report in reports:
        lines += [f"{report.name}   ({report.illuminant}, {report.observer} observer)", ""]
        for table in report.tables.values():
            width = max(8, *map(len, table.labels))
            lines += [f"  {table.what}", f"    {'':{width}}    L*       a*       b*       C*       h   sRGB"]
            for label, lab, lch, swatch in zip(table.labels, table.lab, table.lch, table.hex, strict=True):
                numbers = "  ".join(f"{v:7.2f}" for v in (*lab, lch[1]))
                lines.append(f"    {label:{width}}  {numbers}  {lch[2]:6.1f}   {swatch}")
            if np.any(table.lab[:, 0] > WHITE_L):
                lines.append("    L* above 100: brighter than a perfect white diffuser at that angle")
            lines += [f"    travel in a*b*: {table.travel:.1f}", ""]
        lines += [f"  {name:34s} {value}" for name, value in report_numbers(report)] + [""]
    for comparison in comparisons:
        lines.append(f"{comparison.formula} of {comparison.name} to {comparison.standard or reports[0].name}")
        for name, values in comparison.tables.items():
            row = "  ".join(f"{label}: {v:.2f}" for label, v in zip(comparison.labels[name], values, strict=True))
            lines.append(f"  {name:10s} {row}")
            if comparison.formula == DIN_6175:
                lines.append(f"  {'':10s} mean {np.mean(values):.2f}, largest {np.max(values):.2f}")
        lines += [f"  {line}" for line in _verdict(comparison)]
    return "\n".join(lines).rstrip() + "\n"


def _verdict(comparison: Comparison) -> list[str]:
    """Return whether a sample passes, and the geometries at which it fails."""
    failed = [label for label, is_within in comparison.passes.items() if not is_within]
    if not comparison.passes:
        return []
    return [f"fail at {', '.join(failed)}" if failed else f"pass at all {len(comparison.passes)} geometries"]


def report_numbers(report: Report) -> list[tuple[str, str]]:
    """Return a report's single numbers, with their names and units."""
    rows = [("flop index (Alman)", "-" if report.flop_index is None else f"{report.flop_index:.2f}")]
    rows += [(f"gloss {angle} degrees (GU)", f"{value:.1f}") for angle, value in report.gloss.items()]
    if report.reflection_haze is not None:
        is_wide = report.reflection_haze > PER_CENT
        meaning = " (more light 2 degrees off the mirror direction than in it)" if is_wide else ""
        rows.append(("reflection haze 30 degrees (%)", f"{report.reflection_haze:.2f}{meaning}"))
    if report.transmission_haze is not None:
        rows.append(("transmission haze (%)", f"{report.transmission_haze:.2f}"))
    for name, value in report.hemispherical.items():
        words, _, angle = name.rpartition("_")
        rows.append((f"{words.replace('_', ' ')} at {angle} degrees", f"{value:.4f}"))
    for angle, band in report.selective.items():
        rows.append((
            f"selective reflection at {angle} degrees",
            f"{band.hand} circular, {band.low_nm:.0f} to {band.high_nm:.0f} nm: R = {band.reflectance:.3f} at "
            f"{band.peak_nm:.0f} nm, the other hand {band.other_reflectance:.3f}, |g| = {band.dissymmetry:.2f}",
        ))  # fmt: skip
    if report.order_width_deg is not None:
        rows.append(
            ("standard deviation of an order", f"{report.order_width_deg:.3g} degrees; wider apertures average")
        )
    if report.dark_geometries:
        rows.append(("no diffraction order leaves at", ", ".join(report.dark_geometries)))
    if report.noise > 0:
        rows.append(("largest standard error of pi f", f"{report.noise:.2g}"))
    if report.texture is not None:
        rows += texture_rows(report.texture)
    rows += [(SURFACE_NAMES.get(name, name), f"{value:.5g}") for name, value in report.surface.items()]
    return rows


def report_html(
    reports: list[Report], figures: dict[str, str] | None = None, comparisons: Sequence[Comparison] = ()
) -> str:
    """Return one HTML page; `figures` maps captions to data URIs."""
    first = reports[0]
    return render_page(
        "report.html",
        title=" and ".join(report.name for report in reports),
        first=first,
        sections=[(report, list(report.tables.values()), report_numbers(report)) for report in reports],
        comparisons=[(comparison, _verdict(comparison)) for comparison in comparisons],
        figures=figures or {},
    )


def dump_json(reports: list[Report], comparisons: Sequence[Comparison] = ()) -> str:
    """Return the JSON text of `report_json`."""
    return json.dumps(report_json(reports, comparisons), indent=2) + "\n"
