"""Temper colours of steel: their order as the oxide grows, against the smiths' table of temperatures.

Published (tables of tempering agree but for ten or twenty degrees): faint yellow 176 C, straw 205, dark straw 226,
brown 260, purple 282, dark blue 310, light blue 337, grey-blue 371. They give no thickness and no reflectance, and time
moves them as much as temperature does, so the order is what can be held against us.
Ours: magnetite (index of Querry) of 0 to 100 nm on iron, D65, normal incidence, named by CIELAB.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from nacre.light import lab_to_lch, spectrum_to_xyz, xyz_to_lab
from validation._film import canvas, film, reflectance, srgb
from validation._rows import finish, row

FIGURE = "film_temper_steel.png"
TABLE = ("yellow", "brown", "purple", "dark blue", "light blue", "grey-blue")
THICKNESS_NM = np.arange(0.0, 101.0, 1.0)
LAM = np.arange(380.0, 781.0, 5.0)
# hue from, hue to (degrees), name; brown is dark yellow and orange; blues differ by lightness and chroma
HUES = ((15.0, 110.0, "yellow"), (315.0, 375.0, "purple"), (225.0, 315.0, "blue"))
BROWN, DARK, GREY = 50.0, 40.0, 18.0
SHORTEST_NM = 3.0  # what lasts less is a border between two colours


def name_of(lch: Any) -> str:
    """Name of a colour of tempered steel; empty for bare metal."""
    lightness, chroma, hue = (float(each) for each in lch)
    found = [name for low, high, name in HUES if low <= hue < high or low <= hue + 360 < high]
    if not found or (found[0] == "yellow" and chroma < 6):
        return ""
    if found[0] != "blue":
        return "brown" if found[0] == "yellow" and lightness < BROWN else found[0]
    return "dark blue" if lightness < DARK else "grey-blue" if chroma < GREY else "light blue"


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    spectra = np.array([
        reflectance(
            film(substrate="Fe", layers=[{"material": {"rii": "main/Fe3O4/Querry"}, "thickness_nm": max(nm, 1e-3)}]),
            0.0, LAM,
        )[0]
        for nm in THICKNESS_NM.tolist()
    ])  # fmt: skip
    lch = np.array([lab_to_lch(xyz_to_lab(spectrum_to_xyz(each, LAM))) for each in spectra])
    spans: list[list[Any]] = []
    for nm, name in zip(THICKNESS_NM, (name_of(each) for each in lch)):
        if spans and spans[-1][0] == name:
            spans[-1][2] = float(nm)
        else:
            spans.append([name, float(nm), float(nm)])
    spans = [span for span in spans if span[0] and span[2] - span[1] >= SHORTEST_NM]
    order = [name for name, _, _ in spans]
    figure, axes = canvas(1, 1, 6.4, 1.8)
    plot = axes.flat[0]
    plot.imshow(srgb(spectra, LAM)[None], aspect="auto", extent=(0, THICKNESS_NM[-1], 0, 1))
    for name, low, high in spans:
        plot.text(0.5 * (low + high), 0.5, name, ha="center", va="center", fontsize=6, rotation=90, color="w")
    plot.set(yticks=[], xlabel="magnetite on iron, nm")
    finish(figure, out_dir, FIGURE)
    note = ", ".join(f"{name} {low:.0f}-{high:.0f} nm" for name, low, high in spans)
    return [row("order of temper colours", ", ".join(TABLE), note, order == list(TABLE), FIGURE)]


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
