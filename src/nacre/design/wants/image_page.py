"""The report of a picture made of structure: one HTML file that needs nothing else, and its sheet as PNG."""

from __future__ import annotations

import html
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nacre.design.wants.answers import Design
from nacre.design.wants.image_picture import Picture, srgb_lab
from nacre.design.wants.page import PICTURE, REPORT
from nacre.design.wants.target import Target
from nacre.files import write_text
from nacre.light import white_xyz, xyz_to_lab
from nacre.plot.page import DPI, data_uri, framed, png_uri

if TYPE_CHECKING:
    from nacre.plot import Figure

POINTS = 4000  # of what can be reached, in the chart
MARKS = 400  # of the picture's colours


def write_page(folder: Path, target: Target, design: Design, picture: Picture, begun: float) -> None:
    """Write report.html and report.png.

    Args:
        begun: when the whole design did, by the monotonic clock; its summary gets the seconds that the page tells.

    Raises:
        NacreError: the folder cannot be written.
    """
    from nacre.plot import save_figure
    from nacre.plot.pictures import PictureSheet, picture_figure

    lamp, observer = target.spec.light.illuminants[0], target.spec.light.observer
    note = f"{lamp}, {observer} observer, {target.wants[0].at}; the first row on top, seen from the light's side"
    maps = [(m.path, m.values) for m in picture.maps]
    title = _wrapped(f"{target.name}: {design.message}")
    sheet = PictureSheet(title, picture.asked, picture.reached, picture.distance, picture.is_mapped, maps, note)

    save_figure(picture_figure(sheet), folder / PICTURE, {"target": target.fingerprint})
    shown = (folder / PICTURE).read_bytes()  # drawn once: pixels of a picture take a second
    chart = data_uri(_chart(picture, lamp, observer), DPI)
    checked = design.best.facts["checked"]
    facts = (
        f"{checked['pixels']} pixels, solved anew, differ from what is told here by dE00 {checked['de00_mean']:.3f} in "
        f"the mean and {checked['de00_largest']:.3f} at most."
    )
    text = html.escape(
        target.context.text or json.dumps(target.spec.model_dump(exclude_none=True), indent=2, default=str)
    )
    took = design.summary["seconds"] = round(time.monotonic() - begun, 3)
    body = [
        f"<h1>{html.escape(target.name)}</h1>",
        f'<p class="{"good" if design.status == "met" else "far"}">{html.escape(design.message)}.</p>',
        f"<p>{took:.1f} s. {html.escape(note)}. {facts}</p>",
        f'<img alt="asked, reached, how far off, and the maps" src="{png_uri(shown)}">',
        "<h2>What can be reached</h2><p>Every colour that the free numbers make (with levels: before they are "
        "dithered); crosses are colours of the picture.</p>",
        f'<img alt="what can be reached" src="{chart}">',
        f"<details><summary>the target</summary><pre>{text}</pre></details>",
        f"<details><summary>design.json</summary><pre>{html.escape(json.dumps(design.summary, indent=2, default=str))}"
        "</pre></details>",
    ]
    write_text(folder / REPORT, framed(target.name, body))


def _wrapped(text: str, width: int = 118) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, width))


def _chart(picture: Picture, lamp: str, observer: str) -> Figure:
    """Draw what can be reached, and colours of the picture in it."""
    from nacre.design.wants.gamut import optimal_limits, srgb_limits
    from nacre.light import xyz_to_xyy
    from nacre.plot import reach_figure

    xyz = picture.sheet.flat_xyz
    xyz = xyz[:: max(1, len(xyz) // POINTS)]
    white = white_xyz(lamp, observer)
    pixels = picture.asked.reshape(-1, 3)
    marks = srgb_lab(pixels[:: max(1, len(pixels) // MARKS)])
    limits = np.asarray(xyz_to_lab(optimal_limits(lamp, observer), white))
    lab = np.asarray(xyz_to_lab(xyz, white))
    note = f"{lamp}, {observer} observer"
    srgb = srgb_limits(lamp, observer)
    return reach_figure(lab, np.asarray(xyz_to_xyy(xyz)), srgb, limits, white, "What can be reached", note, marks)


__all__ = ["write_page"]
