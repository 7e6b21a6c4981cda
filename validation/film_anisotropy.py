"""Isotropic against anisotropic roughness, 500 nm of n = 1.5: the highlight stretches across the brushing.

Source: Wu and Zheng 2015, who compare both on one film. Theory: at normal incidence a facet of slope s sends light to
the angle 2 atan(s), so the widths of the lobe along x and y are those of the slopes, alpha_x and alpha_y.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import direction
from nacre.measure.evaluate import directional_hemispherical
from validation._film import canvas, film, picture, show
from validation._rows import finish, row

FIGURE = "film_anisotropy.png"
LAM = np.array([450.0, 550.0, 650.0])
CASES = {"isotropic": [0.15, 0.15], "anisotropic": [0.05, 0.3]}


def made(distribution: str, roughness: list[float], compensate: bool = False) -> Any:
    """500 nm of n = 1.5 on aluminium."""
    surface = {"distribution": distribution, "roughness": roughness, "compensate": compensate}
    return film(substrate="Al", layers=[{"material": {"n": 1.5}, "thickness_nm": 500}], surface=surface)


def half_slope(bsdf: Any, azimuth: float) -> float:
    """The slope of the facets at which f cos_o has fallen to half, at normal incidence."""
    theta = np.linspace(0.0, np.radians(88.0), 4001)
    wo = direction(theta, azimuth)
    value = bsdf.evaluate(np.array([0.0, 0.0, 1.0]), wo)[:, 1] * wo[:, 2]
    return float(np.tan(0.5 * theta[np.argmax(value < 0.5 * value[0])]))


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    rows = []
    figure, axes = canvas(2, 3, 9.0, 6.0)
    for line, (name, widths) in enumerate(CASES.items()):
        for distribution in ("ggx", "beckmann", "blinn", "ashikhmin-shirley"):
            bsdf = made(distribution, widths).bsdf(LAM)
            ratio = half_slope(bsdf, np.pi / 2) / half_slope(bsdf, 0.0)
            expected = widths[1] / widths[0]
            holds = abs(ratio / expected - 1.0) < 0.15
            claim = f"{distribution}, {name}: width along y over width along x, in slopes"
            rows.append(row(claim, f"{expected:.2f} within 15 % (masking)", f"{ratio:.2f}", holds, FIGURE))
        bsdf = made("ggx", widths).bsdf(LAM)
        grid = np.linspace(-1, 1, 241)
        x, y = np.meshgrid(grid, grid)
        inside = x * x + y * y < 0.999
        z = np.sqrt(np.where(inside, 1 - x * x - y * y, 1.0))
        wo = np.stack([np.where(inside, x, 0), np.where(inside, y, 0), z], axis=-1)
        value = np.where(inside, bsdf.evaluate(direction(np.radians(30.0), 0.5), wo)[..., 1], 0.0)
        axes[line, 0].imshow(np.log10(value + 1e-3), origin="lower", extent=(-1, 1, -1, 1))
        axes[line, 0].set(title=f"{name}: log f at 550 nm", xlabel="sine along x", ylabel="sine along y")
        show(axes[line, 1], picture(made("ggx", widths), "sphere"), "ggx")
        show(axes[line, 2], picture(made("blinn", widths), "sphere"), "blinn")
    plain = made("ggx", CASES["anisotropic"]).bsdf(LAM)
    full = made("ggx", CASES["anisotropic"], True).bsdf(LAM)
    wi = direction(np.radians([0.0, 30.0, 60.0]), 0.4)
    sent = [directional_hemispherical(b, wi)[0][:, 1] for b in (plain, full)]
    flat = made("ggx", [0.0, 0.0]).spectrum(np.radians([0.0, 30.0, 60.0]), LAM).specular_reflectance[:, 1]
    claim = "compensated albedo at 0, 30, 60 degrees against the smooth film's, within 3 % (facets mix angles)"
    holds = bool(np.all(np.abs(sent[1] / flat - 1.0) < 0.03))
    rows.append(
        row(claim, np.round(flat, 3), f"{np.round(sent[1], 3)} ({np.round(sent[0], 3)} without)", holds, FIGURE)
    )
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
