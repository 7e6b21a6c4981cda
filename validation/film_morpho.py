"""The Morpho wing: three cuticle thicknesses in two views, blue over a wide fan, and the grating of level ridges.

Claims of Wu and Zheng 2015 (cuticle n = 1.56, air gaps of 90 nm, 350-730 nm): with growing cuticle thickness the wing
turns from blue to purple, from yellow to green and from red to yellow between a steep and a flat view. The
thicknesses and the views are not printed there: here each thickness is the one whose first order, 2 (1.56 d + 90) nm,
stands in the middle of the first colour named, seen at normal incidence, and the second colour must be the next one to
appear while the view turns flatter, before 60 degrees. Fan and peak: Kinoshita et al. 2002; Vukusic et al. 1999.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import direction
from validation._film import canvas, film, hue_name, picture, reflectance, show, srgb
from validation._rows import finish, row

FIGURE = "film_morpho.png"
LAM = np.arange(350.0, 731.0, 2.0)
CLAIMS = ((465.0, "blue", "purple"), (572.0, "yellow", "green"), (665.0, "red", "yellow"))
AIR_NM, PAIRS = 90.0, 5
VIEWS_DEG = np.arange(0.0, 61.0, 2.5)
BETWEEN = {("red", "yellow"): "orange"}  # a name that lies between two claimed ones is passed over


def published(thickness_nm: float, exponent: Any, distribution: str) -> Any:
    """The film-only wing of the source: cuticle and air under a rough surface."""
    pair = [{"material": {"n": 1.56}, "thickness_nm": thickness_nm}, {"material": "air", "thickness_nm": AIR_NM}]
    surface = {"distribution": distribution, "exponent": exponent}
    return film(substrate={"n": 1.56, "k": 0.06}, layers=pair * PAIRS, surface=surface)


def fan_width_deg(bsdf: Any, azimuth: float, at: int) -> float:
    """Full width at half maximum of f cos_o at normal incidence, degrees."""
    theta = np.radians(np.linspace(0, 85, 3401))
    wo = direction(theta, azimuth)
    value = bsdf.evaluate(np.array([0.0, 0.0, 1.0]), wo)[:, at] * wo[:, 2]
    return 2 * float(np.degrees(theta[np.flatnonzero(value > 0.5 * value.max())[-1]]))


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    rows = []
    figure, axes = canvas(3, 4, 12.0, 9.0)
    for column, (centre, steep, flat) in enumerate(CLAIMS):
        thickness = (centre / 2 - AIR_NM) / 1.56
        made = published(thickness, [5, 200], "ashikhmin-shirley")
        values = reflectance(made, VIEWS_DEG, LAM)
        names = [hue_name(v, LAM) for v in values]
        rows.append(row(f"cuticle {thickness:.0f} nm, normal view", steep, names[0], names[0] == steep, FIGURE))
        passing = BETWEEN.get((steep, flat))
        later = [i for i, name in enumerate(names) if name not in (names[0], passing)]
        shown = [0, later[0]] if later else [0]
        got = f"{names[later[0]]} from {VIEWS_DEG[later[0]]:g} degrees" if later else "none before 60 degrees"
        rows.append(row(f"cuticle {thickness:.0f} nm, flatter view", flat, got, got.startswith(flat), FIGURE))
        for i in shown:
            color = srgb(values[i], LAM)
            axes[0, column].plot(LAM, values[i], color=color, lw=2, label=f"{VIEWS_DEG[i]:g} deg")
        axes[0, column].set(title=f"cuticle {thickness:.0f} nm", xlabel="wavelength (nm)", ylim=(0, 1))
        axes[0, column].legend(fontsize=7, frameon=False)
        show(axes[1, column], picture(made, "butterfly", 160), "film only, anisotropic")
    blue = (CLAIMS[0][0] / 2 - AIR_NM) / 1.56
    show(axes[1, 3], picture(published(blue, 30, "blinn"), "butterfly", 160), "film only, isotropic Blinn")
    anisotropic = published(blue, [5, 200], "ashikhmin-shirley").bsdf(LAM)
    isotropic = published(blue, 30, "blinn").bsdf(LAM)
    at = int(np.argmin(np.abs(LAM - 465)))
    ratios = [fan_width_deg(b, 0.0, at) / fan_width_deg(b, np.pi / 2, at) for b in (anisotropic, isotropic)]
    rows.append(row("anisotropic lobe: width across over along", "above 2", f"{ratios[0]:.1f}", ratios[0] > 2, FIGURE))
    rows.append(
        row("isotropic lobe: width across over along", "1", f"{ratios[1]:.2f}", abs(ratios[1] - 1) < 0.02, FIGURE)
    )

    wing = film(preset="morpho")
    bsdf = wing.bsdf(LAM)
    total = wing.spectrum(np.radians([0.0, 30.0, 60.0]), LAM).diffuse_reflectance
    peak = float(LAM[np.argmax(total[0])])
    rows.append(row("preset: peak of the light sent back at normal incidence", "450-480 nm", f"{peak:.0f} nm",
                    450 <= peak <= 480, FIGURE))  # fmt: skip
    rows.append(row("its height (Vukusic: about 0.7-0.8)", "0.6-0.9", f"{total[0].max():.2f}",
                    0.6 <= total[0].max() <= 0.9, FIGURE))  # fmt: skip
    across, along = fan_width_deg(bsdf, 0.0, at), fan_width_deg(bsdf, np.pi / 2, at)
    rows.append(row("preset: fan across over along the ridges", "above 5", f"{across:.0f} / {along:.1f} deg = "
                    f"{across / along:.1f}", across / along > 5, FIGURE))  # fmt: skip
    angles = np.radians([0.0, 15.0, 30.0, 45.0, 60.0])
    fan = bsdf.evaluate(np.array([0.0, 0.0, 1.0]), direction(angles))
    peaks = LAM[np.argmax(fan, axis=1)]
    rows.append(row("preset: peak of the fan at 0 to 60 degrees stays blue", "440-495 nm", peaks.astype(int),
                    bool(np.all((peaks >= 440) & (peaks <= 495))), FIGURE))  # fmt: skip

    pitch, lam, incidence = 1500.0, 500.0, 20.0
    ridges = {"pitch_nm": pitch, "width_nm": 200, "height_deviation_nm": 0, "count": 60}
    grating = film(substrate="Al", ridges=ridges).bsdf(np.array([lam]))
    theta = np.radians(np.linspace(-75, 75, 30001))
    value = grating.evaluate(direction(np.radians(incidence)), direction(np.abs(theta), np.where(theta < 0, np.pi, 0)))
    worst, orders = 0.0, 0
    for m in range(-5, 6):
        sine = -np.sin(np.radians(incidence)) + m * lam / pitch
        if abs(sine) < 0.9:
            near = np.abs(np.degrees(theta) - np.degrees(np.arcsin(sine))) < 3
            found = np.degrees(theta[near][np.argmax(value[near, 0])])
            worst, orders = max(worst, abs(found - np.degrees(np.arcsin(sine)))), orders + 1
    claim = f"level ridges: {orders} grating orders at sin_o = -sin_i + m lambda/pitch"
    rows.append(row(claim, "within 0.1 deg", f"{worst:.3f} deg", worst <= 0.1, FIGURE))

    for k, angle in enumerate((0, 30, 60)):
        axes[2, 0].plot(LAM, total[k], color=srgb(total[k], LAM), lw=2, label=f"{angle} deg")
    axes[2, 0].set(title="preset: all light sent back", xlabel="wavelength (nm)", ylim=(0, 1))
    axes[2, 0].legend(fontsize=7, frameon=False)
    span = np.radians(np.linspace(0, 85, 400))
    for azimuth, label in ((0.0, "across"), (np.pi / 2, "along")):
        axes[2, 1].plot(
            np.degrees(span), bsdf.evaluate(np.array([0.0, 0, 1]), direction(span, azimuth))[:, at], label=label
        )
    axes[2, 1].set(title="f at 464 nm, normal light", xlabel="angle (deg)")
    axes[2, 1].legend(fontsize=7, frameon=False)
    axes[2, 2].semilogy(np.degrees(theta), value[:, 0] + 1e-4, lw=0.6)
    axes[2, 2].set(title="level ridges, 1500 nm pitch", xlabel="angle (deg)")
    show(axes[2, 3], picture(wing, "butterfly", 160), "preset")
    axes[0, 3].axis("off")
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
