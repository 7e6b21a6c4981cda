"""Mixtures: the mean field with one pair correlation for both kinds, against multi-sphere solutions of real mixtures.

The mean field has the default energy balance, and for comparison multiple scattering between neighbours (the ladder).

The solutions are nacre's own (periodic patterns of 130 spheres, multipoles to order 2); the coupling of two spheres at
different heights is tested against another code. They are also compared with direct solutions of finite circular
clusters of 130 spheres. The error is the relative L2 error over the viewing angle of the light scattered upward,
averaged over incidences and polarisations.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from nacre.families.metasurface.ensemble import middle_sizes, same_order
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.qca import NAME as LADDER
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter.mie import mie_coefficients
from validation._film import canvas
from validation._rows import finish, row
from validation.metasurface_ensembles import distance, light, of_discs, pattern_correction

FIGURE = "metasurface_mixtures.png"
BAR = 0.12  # up to which the mean field is taken of one kind
DISC_BAR = 0.08  # of the ensemble, as against another code's discs
PATTERNS = 48
THETA = np.radians(np.linspace(3.5, 80.5, 12))
FEW = THETA < np.radians(60.0)  # of the light: beyond, a disc's edge sends out more than an endless layer has
SILVER, SILICON = 0.05 + 3.1j, 4.0 + 0.05j
SYSTEMS = {
    "silver r 90 and 60 nm, half each, f .1 on glass, 500 nm": (500.0, (90.0, SILVER), (60.0, SILVER), 0.5, 0.10),
    "silver r 75 and silicon r 60 nm, .6 and .4, f .08 on glass, 520 nm": (
        520.0, (75.0, SILVER), (60.0, SILICON), 0.4, 0.08,
    ),
}  # fmt: skip


def mixture(wavelength_nm: float, first: Any, second: Any, share: float, coverage: float) -> Monolayer:
    """Two kinds of spheres of order 2 on glass, kept apart by the larger one's diameter."""
    surface = Substrate(wavelength_nm, np.array([1.0, 1.5], complex), np.zeros(0))
    particles = []
    for number, ((radius, index), part) in enumerate(((first, 1 - share), (second, share))):
        a, b = mie_coefficients(2, np.array([surface.wavenumber * radius]), np.array([index]))
        particles.append(Particle(part, radius, np.concatenate([-b, -a]), species=number))
    area = sum(p.share * np.pi * p.centre_nm**2 for p in particles)
    density = coverage / area
    packing = density * np.pi * max(p.centre_nm for p in particles) ** 2
    structure = hard_disk_structure(density, packing, 4.5 * surface.wavenumber * 1.5)
    return Monolayer(surface, tuple(particles), structure)


def main(out_dir: str | Path = "out/validation") -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    figure, axes = canvas(1, len(SYSTEMS), 9.0, 3.4)
    rows = []
    for each, (name, numbers) in zip(axes.flat, SYSTEMS.items()):
        layer = mixture(*numbers)
        alone = same_order(layer, 2, *middle_sizes(layer))
        ratio, _, _ = pattern_correction(layer, 130, PATTERNS)
        solved, mean = light(alone, THETA, THETA, ratio), light(alone, THETA, THETA, None)
        ladder = light(dataclasses.replace(alone, correction=LADDER), THETA, THETA, None)
        discs = of_discs(layer, THETA, THETA, PATTERNS)
        error = distance(mean, solved, THETA)
        claim = f"mixture of {name}: relative L2 of the mean field against the real mixture"
        rows.append(row(claim, f"at most {BAR:g}", f"{error:.3f}", bool(error <= BAR), FIGURE))
        by_ladder = distance(ladder, solved, THETA)
        claim = f"mixture of {name}: relative L2 of the mean field with passed-on light against the real mixture"
        rows.append(row(claim, f"at most {BAR:g}", f"{by_ladder:.3f}", bool(by_ladder <= BAR), FIGURE))
        off, mean_off = (distance(ours[:, FEW], discs[:, FEW], THETA) for ours in (solved, mean))
        claim = f"mixture of {name}: relative L2 of the ensemble against discs of 130 spheres, light to 60 degrees"
        rows.append(
            row(claim, f"at most {DISC_BAR:g}", f"{off:.3f}; mean field {mean_off:.3f}", bool(off <= DISC_BAR), FIGURE)
        )
        i = int(np.argmin(np.abs(THETA - np.radians(30.0))))
        for pol, colour in enumerate(("C0", "C1")):
            each.plot(np.degrees(THETA), 1e-6 * discs[:, i, pol], ".", color=colour)
            each.plot(np.degrees(THETA), 1e-6 * solved[:, i, pol], color=colour, label="sp"[pol])
            each.plot(np.degrees(THETA), 1e-6 * mean[:, i, pol], ":", color=colour)
        each.set(xlabel="viewing angle (degrees)", title=name)
        each.title.set_fontsize(6)
    axes.flat[0].set_ylabel("diffuse light a particle (um$^2$/sr)")
    axes.flat[0].legend(title="dots: discs, dotted: mean field", fontsize=7, title_fontsize=7, frameon=False)
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main()
