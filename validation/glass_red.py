"""Photonic glasses make little red: where the order of solid spheres peaks in the red, they scatter more in the blue.

Claims: Magkiriadou et al., Phys. Rev. E 90, 062302 (2014): the short-wave rise is that of a single sphere's own
backscatter, not of the order; voids in a denser medium, packed alike, are better off, since their first resonance of
backscatter lies further from the peak.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import nacre
from nacre.families.glass.medium import percus_yevick
from validation._film import canvas
from validation._rows import finish, row

FIGURE = "glass_red.png"
LAM = np.linspace(400.0, 720.0, 65)
FRACTION, BLACK = 0.55, 0.004
BLUE, RED = (LAM >= 400) & (LAM <= 440), (LAM >= 600) & (LAM <= 700)
KINDS = {"polystyrene in air": ({"n": 1.59}, {"n": 1.0}), "voids in polystyrene": ({"n": 1.0}, {"n": 1.59})}
RED_NM = 650.0


def glass(kind: str, radius_nm: float) -> Any:
    """A film of spheres, or of voids, with a trace of black."""
    sphere, matrix = KINDS[kind]
    return nacre.material(
        {
            "family": "glass",
            "thickness_um": 20,
            "matrix": matrix,
            "spheres": {"material": sphere, "radius_nm": radius_nm, "volume_fraction": FRACTION},
            "absorber": {"k": BLACK},
        }
    )


def radius_of(kind: str, peak_nm: float) -> float:
    """The radius at which the order sends light of a wavelength straight back the most."""
    n = float(glass(kind, 100.0).model.composite.effective_index(np.array([peak_nm]))[0].real)
    y = np.linspace(4.0, 10.0, 2001)
    top = float(y[np.argmax(percus_yevick(y, FRACTION))])
    return top * peak_nm / (8 * np.pi * n)


def share_of_blue(reflectance: Any) -> float:
    """Mean reflectance in the blue over the largest in the red."""
    return float(np.mean(reflectance[BLUE]) / np.max(reflectance[RED]))


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    rows = []
    figure, axes = canvas(1, 2, 9.0, 3.6)
    shares = {}
    for kind in KINDS:
        radius = radius_of(kind, RED_NM)
        made = glass(kind, radius)
        seen = made.spectrum([0.0], LAM).diffuse_reflectance[0]
        shares[kind] = share_of_blue(seen)
        axes.flat[0].plot(LAM, seen, label=f"{kind}, radius {radius:.0f} nm")
        # straight back: sphere and order apart
        spheres = made.model.composite.medium(LAM)
        n = made.model.composite.effective_index(LAM).real
        order = percus_yevick(4 * np.pi * n / LAM * 2 * radius, FRACTION)
        back = spheres.phase[:, 0] * spheres.scattering
        alone = back / order
        axes.flat[1].plot(LAM, order / order.max(), "--", label=f"order, {kind}")
        axes.flat[1].plot(LAM, alone / alone[RED].max(), label=f"one sphere, {kind}")
        if kind.startswith("polystyrene"):
            claim = "order alone sends back less at 400-440 nm than at its red peak"
            value = float(np.mean(order[BLUE]) / order.max())
            rows.append(row(claim, "below 0.5", f"{value:.2f}", value < 0.5, FIGURE))
            claim = "one sphere sends back more of the blue than of the red"
            value = float(np.mean(alone[BLUE]) / np.max(alone[RED]))
            rows.append(row(claim, "above 1", f"{value:.2f}", value > 1, FIGURE))
    value = shares["polystyrene in air"]
    # a saturated red would leave little of the blue
    claim = "solid spheres with the peak of order in the red: reflectance in the blue over that in the red"
    rows.append(row(claim, "above 0.5: no saturated red", f"{value:.2f}", value > 0.5, FIGURE))
    other = shares["voids in polystyrene"]
    claim = "voids with the same order: blue over red, against solid spheres"
    rows.append(row(claim, f"below {value:.2f}", f"{other:.2f}", other < value, FIGURE))
    axes.flat[0].set(xlabel="wavelength (nm)", ylabel="diffuse reflectance", title="order peaks at 650 nm")
    axes.flat[1].set(xlabel="wavelength (nm)", title="straight back, over the red", yscale="log")
    for each in axes.flat:
        each.legend(fontsize=6, frameon=False)
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
