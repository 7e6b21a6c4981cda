"""Glass coated with 400 nm and 600 nm of n = 2.0: the thicker coat shifts to red, the scene behind is refracted.

Claim of Wu and Zheng 2015: the colour of a dielectric film on transparent glass moves towards red when its thickness
goes from 400 to 600 nm, and the glass distorts the scene behind. Theory for one film of index n above a lower one:
maxima of reflectance at 2 n d cos(theta_2) = (m + 1/2) lambda.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from validation._film import canvas, film, hue_name, picture, reflectance, show, srgb
from validation._rows import finish, row

FIGURE = "film_coated_glass.png"
INDEX = 2.0
LAM = np.linspace(380.0, 780.0, 801)


def glass(thickness_nm: float) -> Any:
    """Glass under one coat."""
    return film(substrate="BK7", layers=[{"material": {"n": INDEX}, "thickness_nm": thickness_nm}])


def longest_peak_nm(spectrum: np.ndarray) -> float:
    """The maximum of reflectance of the longest wavelength within the visible."""
    inner = spectrum[1:-1]
    peaks = LAM[1:-1][(inner > spectrum[:-2]) & (inner > spectrum[2:])]
    return float(peaks[-1])


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    rows = []
    figure, axes = canvas(2, 3, 9.0, 5.6)
    peaks = {}
    for line, thickness in enumerate((400.0, 600.0)):
        made = glass(thickness)
        angles = np.array([0.0, 30.0, 60.0])
        values = reflectance(made, angles, LAM)
        for angle, spectrum in zip(angles, values, strict=True):
            axes[line, 0].plot(LAM, spectrum, color=srgb(spectrum, LAM, 3.0), lw=2, label=f"{angle:g} deg")
        axes[line, 0].set(title=f"{thickness:g} nm", xlabel="wavelength (nm)", ylabel="reflectance", ylim=(0, 0.5))
        axes[line, 0].legend(fontsize=7, frameon=False)
        peaks[thickness] = longest_peak_nm(values[0])
        order = round(2 * INDEX * thickness / peaks[thickness] - 0.5)
        expected = 2 * INDEX * thickness / (order + 0.5)
        holds = abs(peaks[thickness] - expected) < 2.0
        claim = f"{thickness:g} nm: reddest maximum of R at normal incidence, order {order}"
        rows.append(row(claim, f"{expected:.1f} nm", f"{peaks[thickness]:.1f} nm", holds, FIGURE))
        total = made.spectrum(np.radians(angles), LAM)
        balance = float(np.max(np.abs(total.specular_reflectance + total.specular_transmittance - 1.0)))
        rows.append(row(f"{thickness:g} nm: R + T", "1", f"1 within {balance:.1e}", balance < 1e-6, FIGURE))
        show(axes[line, 1], picture(made, "sphere"), f"{thickness:g} nm, studio")
        show(axes[line, 2], picture(made, "probe", light="directional"), f"{thickness:g} nm, directional light")
    rows.append(
        row(
            "the thicker coat is redder: its reddest maximum lies at a longer wavelength",
            f"above {peaks[400.0]:.0f} nm",
            f"{peaks[600.0]:.0f} nm",
            peaks[600.0] > peaks[400.0],
            FIGURE,
        )
    )
    names = {t: [hue_name(s, LAM) for s in reflectance(glass(t), np.array([0.0, 45.0, 60.0]), LAM)] for t in peaks}
    # a film of several orders has no single hue to follow: the visible colour is given, not compared
    print(f"hue of the reflection at 0, 45, 60 degrees: {names}")
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
