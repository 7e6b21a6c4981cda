"""A soap film and an oil slick: black film, Newton's colours in their order, fringes that fade with thickness.

References: the sequence of interference colours of a draining soap film as tabulated by Isenberg ("The Science of Soap
Films and Soap Bubbles") and Newton's scale: black, white, yellow, red, then blue, green, yellow, red of the second
order; a film far thinner than the wave is black, because its two reflections cancel. Oil (n = 1.47) on water
(n = 1.33) also loses half a wave at one face only, so it begins dark too.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from nacre.light import spectrum_to_xyz
from nacre.material.material import load
from validation._film import canvas, film, hue_name, picture, show, srgb
from validation._rows import finish, row

FIGURE = "film_soap_and_oil.png"
LAM = np.linspace(380.0, 780.0, 401)
THICKNESSES_NM = np.linspace(0.0, 900.0, 451)
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCALE = (  # optical path n d of the film in nm at which each colour of Newton's scale stands, and its accepted names
    (125.0, ("yellow", "orange", "green", "blue", "white"), "first white"),
    (215.0, ("yellow", "orange"), "first yellow to orange"),
    (275.0, ("red", "purple"), "first red to purple"),
    (330.0, ("blue",), "second blue"),
    (375.0, ("green", "blue"), "second green"),
    (455.0, ("yellow", "orange", "green"), "second yellow"),
    (505.0, ("red", "orange"), "second orange to red"),
    (555.0, ("purple", "red"), "second violet-red"),
)


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    rows = []
    soap = film(substrate="air", layers=[{"material": "soap film", "thickness_nm": 400}])
    oil = film(substrate={"n": 1.333, "k": 2e-3}, layers=[{"material": "oil", "thickness_nm": 400}])
    colours = {}
    for name, made in (("soap", soap), ("oil", oil)):
        data = made.figure_data("colour-map", thicknesses_nm=THICKNESSES_NM, angles_deg=[0.0, 45.0], wavelengths_nm=LAM)
        colours[name] = data["reflectance"]
    brightness = np.asarray(spectrum_to_xyz(colours["soap"][:, 0], LAM))[:, 1]
    at_5 = float(np.interp(5.0, THICKNESSES_NM, brightness))
    rows.append(row("black soap film, 5 nm: luminous reflectance", "below 0.2 %", f"{at_5:.2%}", at_5 < 2e-3, FIGURE))
    peak = float(THICKNESSES_NM[np.argmax(brightness)])
    quarter = 555.0 / 4 / 1.335
    claim = "brightest soap film: a quarter wave of 555 nm"
    rows.append(row(claim, f"{quarter:.0f} nm", f"{peak:.0f} nm", abs(peak - quarter) < 6, FIGURE))
    most = float(brightness.max())
    r = ((1.335 - 1) / (1.335 + 1)) ** 2
    claim = "its luminous reflectance: 4 r / (1 + r)^2 of two faces in step, at 555 nm"
    rows.append(
        row(claim, f"{4 * r / (1 + r) ** 2:.4f}", f"{most:.4f}", abs(most / (4 * r / (1 + r) ** 2) - 1) < 0.03, FIGURE)
    )
    for path, names, label in SCALE:
        thickness = path / 1.335
        i = int(np.argmin(np.abs(THICKNESSES_NM - thickness)))
        got = hue_name(colours["soap"][i, 0], LAM)
        claim = f"Newton's scale at n d = {path:g} nm ({thickness:.0f} nm of soap film): {label}"
        rows.append(row(claim, " or ".join(names), got, got in names, FIGURE))
    thin = float(np.asarray(spectrum_to_xyz(colours["oil"][0, 0], LAM))[1])
    fresh = ((1.333 - 1) / (1.333 + 1)) ** 2
    rows.append(
        row("no oil: the water's own reflectance", f"{fresh:.4f}", f"{thin:.4f}", abs(thin - fresh) < 2e-4, FIGURE)
    )
    contrast = [float(np.ptp(colours[name][150:, 0].mean(axis=1))) for name in ("soap", "oil")]
    claim = "an oil slick is paler than a soap film: its faces differ more (range of mean R)"
    rows.append(
        row(claim, "smaller", f"{contrast[1]:.4f} against {contrast[0]:.4f}", contrast[1] < contrast[0], FIGURE)
    )

    figure, axes = canvas(2, 2, 9.0, 6.0)
    for column, (name, gain) in enumerate((("soap", 4.0), ("oil", 8.0))):
        strip = srgb(np.moveaxis(colours[name], 1, 0), LAM, gain)
        axes[0, column].imshow(strip, aspect="auto", extent=(0, 900, 1.5, -0.5))
        axes[0, column].set_yticks([0, 1], ["0 deg", "45 deg"])
        axes[0, column].set(title=f"{name}, {gain:g} x brighter", xlabel="thickness (nm)")
    show(axes[1, 0], picture(load(EXAMPLES / "soap.toml"), "sphere", 256, 64), "examples/soap.toml")
    show(axes[1, 1], picture(load(EXAMPLES / "oil-slick.toml"), "panel", 256, 64), "examples/oil-slick.toml")
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
