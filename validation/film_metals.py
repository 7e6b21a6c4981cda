"""Gold and copper films against the bulk: thin leaf is green to look through, thick film is the metal itself.

References: the bulk reflectance by Fresnel's formula from the same index, written out here, and Beer's law for the
thickness at which the film becomes bulk (the evanescent wave falls by exp(-2 pi k d / lambda)).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from nacre.matter import index
from validation._film import canvas, film, hue_name, picture, reflectance, show, srgb
from validation._rows import finish, row

FIGURE = "film_metals.png"
LAM = np.linspace(400.0, 800.0, 201)
THICKNESSES_NM = (10.0, 20.0, 40.0, 80.0, 150.0, 300.0)


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    rows = []
    figure, axes = canvas(2, 4, 12.0, 6.0)
    for line, (metal, name) in enumerate((("Au", "gold"), ("Cu", "copper"))):
        n = index(metal).n_complex(LAM)
        bulk = np.abs((1 - n) / (1 + n)) ** 2
        depth = float(np.max(LAM / (4 * np.pi * n.imag)))
        axes[line, 0].plot(LAM, bulk, "k--", lw=1, label="bulk (Fresnel)", zorder=10)
        last, passed = None, None
        for thickness in THICKNESSES_NM:
            made = film(substrate="BK7", layers=[{"material": metal, "thickness_nm": thickness}])
            spectrum = made.spectrum(np.array([0.0]), LAM)
            last = spectrum.specular_reflectance[0]
            axes[line, 0].plot(LAM, last, color=srgb(last, LAM), lw=1.5)
            axes[line, 1].plot(LAM, spectrum.specular_transmittance[0], lw=1.2, label=f"{thickness:g} nm")
            if thickness == 20.0:
                passed = spectrum.specular_transmittance[0]
        axes[line, 0].set(title=f"{name}: R, 10 to 300 nm on glass", xlabel="wavelength (nm)", ylim=(0, 1))
        axes[line, 0].legend(fontsize=7, frameon=False)
        axes[line, 1].set(title="T", xlabel="wavelength (nm)", ylim=(0, 0.85))
        axes[line, 1].legend(fontsize=6, frameon=False)
        error = float(np.max(np.abs(last - bulk)))
        bound = 4 * float(np.exp(-300.0 / depth))
        claim = f"{name}: 300 nm film against bulk, largest difference of R (penetration depth {depth:.0f} nm)"
        rows.append(row(claim, f"below {bound:.1e}", f"{error:.1e}", error < bound, FIGURE))
        if metal == "Au":
            top = float(LAM[np.argmax(passed)])
            claim = "gold leaf of 20 nm passes green best"
            rows.append(row(claim, "495-570 nm", f"{top:.0f} nm", 495 <= top <= 570, FIGURE))
        hue = hue_name(bulk, LAM)
        rows.append(row(f"{name}: hue of the metal", "yellow or orange", hue, hue in ("yellow", "orange"), FIGURE))
        angles = np.array([0.0, 60.0, 80.0])
        thick = film(substrate="BK7", layers=[{"material": metal, "thickness_nm": 300}])
        cosine, kz = np.cos(np.radians(angles))[:, None], np.sqrt(n**2 - np.sin(np.radians(angles))[:, None] ** 2)
        oblique = 0.5 * np.abs((cosine - kz) / (cosine + kz)) ** 2
        oblique = oblique + 0.5 * np.abs((n**2 * cosine - kz) / (n**2 * cosine + kz)) ** 2
        error = float(np.max(np.abs(reflectance(thick, angles, LAM) - oblique)))
        claim = f"{name}: the same at 0, 60 and 80 degrees"
        rows.append(row(claim, f"below {bound:.1e}", f"{error:.1e}", error < bound, FIGURE))
        surface = {"roughness": 0.15, "compensate": True}
        show(axes[line, 2], picture(film(substrate=metal, surface=surface), "sphere"), f"{name}, rough")
        show(axes[line, 3], picture(film(substrate="BK7", layers=[{"material": metal, "thickness_nm": 20}]), "sphere"),
             f"{name} leaf, 20 nm on glass")  # fmt: skip
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
