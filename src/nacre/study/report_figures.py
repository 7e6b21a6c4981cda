"""The pictures of an HTML report, as data URIs: the page stays one file that needs nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nacre.bsdf.spectrum import Spectrum
from nacre.errors import UnsupportedError
from nacre.materials.material import Material
from nacre.measure.colour_wavelengths import colour_spectrum
from nacre.plot.page import data_uri
from nacre.study.report import Report

if TYPE_CHECKING:
    from nacre.plot import Figure

CURVE_ANGLES_DEG = (0.0, 30.0, 60.0)
RIBBON_ANGLES_DEG = tuple(np.linspace(0.0, 88.0, 45))
COARSE_ANGLES_DEG = tuple(np.linspace(0.0, 80.0, 9))  # where an angle costs a hemisphere of directions
SCREEN_DPI = 200  # sharp on a dense screen at the page's width


def figures(materials: list[Material], reports: list[Report]) -> dict[str, str]:
    """Return the pictures of a report, `caption -> data URI`.

    For each material: its spectra, and its colour as the angle of incidence grows. For all together: the track
    of the aspecular colours through a*, b*.

    Raises:
        NacreError: a material cannot be computed.
    """
    from nacre.plot import ribbon_figure, spectrum_figure

    found: dict[str, str] = {}
    for number, (material, report) in enumerate(zip(materials, reports, strict=True)):
        # two recipes of one name must not share a caption, since captions are keys
        name = report.name if [r.name for r in reports].count(report.name) == 1 else f"{report.name} ({number + 1})"
        curves = _spectrum(material, CURVE_ANGLES_DEG, report.illuminant)
        if curves is None:
            continue
        found[f"{name}: spectra at {', '.join(f'{a:g}' for a in CURVE_ANGLES_DEG)} degrees"] = data_uri(
            spectrum_figure(curves, report.illuminant, name), SCREEN_DPI
        )
        is_plain = "diffuse_reflectance" not in curves.parts()
        over_angle = _spectrum(material, RIBBON_ANGLES_DEG if is_plain else COARSE_ANGLES_DEG, report.illuminant)
        if over_angle is not None:
            found[f"{name}: colour over the angle of incidence"] = data_uri(
                ribbon_figure(over_angle, report.illuminant, name), SCREEN_DPI
            )
    found["colour travel in a*b* over the aspecular angles (or over incidence, for mirrors)"] = data_uri(
        travel_figure(reports), SCREEN_DPI
    )
    return found


def travel_figure(reports: list[Report]) -> Figure:
    """Draw the colours of the reports in a*, b* and L*, C*, one mark a report.

    A report whose aspecular table is black (a mirror) shows the colours of its mirror direction instead.
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
    """Return the material's spectrum, None where its family has none (the report is then made without it)."""
    try:
        return colour_spectrum(material, np.radians(angles_deg), illuminant)
    except UnsupportedError:
        return None
