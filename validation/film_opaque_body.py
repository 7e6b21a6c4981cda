"""An opaque body of n = 1.25 under films of n = 1.5: colours over thickness, reflectance over angle and wavelength.

Source: Wu and Zheng 2015. The exact Airy formula of one film, written out here, is the reference; the body is opaque
by an absorption (k = 2e-4) that changes what it reflects by less than 1e-4.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from validation._film import canvas, film, picture, reflectance, show, srgb
from validation._rows import finish, row

FIGURE = "film_opaque_body.png"
N_FILM, N_BODY = 1.5, 1.25 + 2e-4j
THICKNESSES_NM = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0)
LAM = np.linspace(380.0, 780.0, 201)


def body(thickness_nm: float) -> Any:
    """The coated body."""
    layer = {"material": {"n": N_FILM}, "thickness_nm": thickness_nm}
    return film(substrate={"n": N_BODY.real, "k": N_BODY.imag}, layers=[layer])


def airy(thickness_nm: float, theta_deg: np.ndarray) -> np.ndarray:
    """Unpolarised reflectance of one film by Airy's formula, `[angle, wavelength]`."""
    sine = np.sin(np.radians(theta_deg))[:, None]
    cosines = [np.sqrt(1.0 - (sine / n) ** 2) for n in (1.0, N_FILM, N_BODY)]
    phase = np.exp(4j * np.pi * N_FILM * thickness_nm * cosines[1] / LAM)
    total = np.zeros((len(theta_deg), len(LAM)))
    for polarisation in "sp":
        powers = (1.0, N_FILM, N_BODY)
        q = [c * n if polarisation == "s" else c / n for c, n in zip(cosines, powers, strict=True)]
        first, second = ((a - b) / (a + b) for a, b in zip(q[:2], q[1:], strict=True))
        total += 0.5 * np.abs((first + second * phase) / (1.0 + first * second * phase)) ** 2
    return total


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    rows = []
    angles = np.linspace(0.0, 89.0, 90)
    figure, axes = canvas(3, len(THICKNESSES_NM), 12.0, 6.0)
    for column, thickness in enumerate(THICKNESSES_NM):
        made = body(thickness)
        values = reflectance(made, angles, LAM)
        error = float(np.max(np.abs(values - airy(thickness, angles))))
        claim = f"{thickness:g} nm: R over 0-89 degrees and 380-780 nm against Airy"
        rows.append(row(claim, "0", f"{error:.1e}", error < 1e-9, FIGURE))
        axes[0, column].imshow(values.T, origin="lower", aspect="auto", extent=(0, 89, 380, 780), vmin=0, vmax=0.2)
        axes[0, column].set_title(f"{thickness:g} nm", fontsize=9)
        axes[1, column].imshow(srgb(values, LAM, 4.0)[None], aspect="auto", extent=(0, 89, 0, 1))
        axes[1, column].set_yticks([])
        axes[1, column].set_xlabel("angle (deg)", fontsize=8)
        show(axes[2, column], picture(made, "sphere", 128), "")
    axes[0, 0].set_ylabel("wavelength (nm)")
    # a thicker film has more fringes: their number in the visible is that of Airy's orders
    for thickness in THICKNESSES_NM[2:]:
        spectrum = reflectance(body(thickness), 0.0, LAM)[0]
        inner = spectrum[1:-1]
        found = int(np.sum((inner > spectrum[:-2]) & (inner > spectrum[2:])))
        orders = [m for m in range(20) if 380 < 2 * N_FILM * thickness / (m + 0.5) < 780]
        rows.append(row(f"{thickness:g} nm: maxima in the visible", len(orders), found, found == len(orders), FIGURE))
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
