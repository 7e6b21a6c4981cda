"""Mixtures: the mean field with one pair correlation for both kinds, against multi-sphere solutions of real mixtures.

The solutions are nacre's own (130 spheres of order 2, 24 patterns), whose pairs at unlike heights are tested against
another code. The distance is that of the physics note, section 10.9: relative L2 over the viewing angle, the mean over
incidences and polarisations, of light sent up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.families.metasurface.arrangement import Arrangement
from nacre.families.metasurface.ensemble import Ensemble, EnsembleSettings, mixed, patches, same_order
from nacre.families.metasurface.monolayer import Monolayer, Particle
from nacre.families.metasurface.patterns import Pattern
from nacre.families.metasurface.structure import hard_disk_structure
from nacre.families.metasurface.substrate import Substrate
from nacre.matter.jobs import in_threads
from nacre.matter.mie import mie_coefficients
from validation._film import canvas
from validation._rows import finish, row

FIGURE = "metasurface_mixtures.png"
BAR = 0.12  # up to which the mean field is taken of one kind
SETTINGS = EnsembleSettings(130, 24)
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
        particles.append(Particle(part, radius, np.concatenate([-b, -a]), kind=number))
    area = sum(p.share * np.pi * p.centre_nm**2 for p in particles)
    density = coverage / area
    packing = density * np.pi * max(p.centre_nm for p in particles) ** 2
    structure = hard_disk_structure(density, packing, 4.5 * surface.wavenumber * 1.5)
    return Monolayer(surface, tuple(particles), structure)


def both(layer: Monolayer, settings: EnsembleSettings = SETTINGS) -> tuple[Any, Any, Any]:
    """Light sent up by the mean field and by the ensemble, `[s, pol_i, i]`, and the angles."""
    density, packing = layer.structure.density_per_nm2, layer.structure.packing

    def pattern(count: int, seed: int) -> Pattern:
        return Arrangement("hard-disk", density, packing, seed).pattern(count)

    cut = patches(pattern, density, layer.structure.diameter_nm, settings, 0)
    one = Ensemble(same_order(layer, 2, *layer.particles), cut, mixed(cut, layer.shares, 0))
    one.prepare()
    truth = one.diffuse(in_threads(one.far_fields, range(settings.realisations))).mean(axis=0)
    theta = np.arccos(one.sides[0][0].cosines)
    up = slice(0, theta.size)
    mean, solved = (v[:, up, :, up].sum(axis=0).mean(axis=-1) for v in (one.model(), truth))
    return mean, solved, theta


def main(out_dir: str | Path = "out/validation") -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    figure, axes = canvas(1, len(SYSTEMS), 9.0, 3.4)
    rows = []
    for each, (name, numbers) in zip(axes.flat, SYSTEMS.items()):
        layer = mixture(*numbers)
        mean, solved, theta = both(layer)
        sine = np.sin(theta)[:, None, None]
        error = np.sqrt((sine * (mean - solved) ** 2).sum(0) / (sine * solved**2).sum(0))
        claim = f"mixture of {name}: relative L2 of the mean field against the real mixture"
        rows.append(row(claim, f"at most {BAR:g}", f"{error.mean():.3f}", bool(error.mean() <= BAR), FIGURE))
        i = int(np.argmin(np.abs(theta - np.radians(30.0))))
        for pol, colour in enumerate(("C0", "C1")):
            each.plot(np.degrees(theta), 1e-6 * solved[:, pol, i], ".", color=colour)
            each.plot(np.degrees(theta), 1e-6 * mean[:, pol, i], color=colour, label="sp"[pol])
        each.set(xlabel="viewing angle (degrees)", title=name)
        each.title.set_fontsize(6)
    axes.flat[0].set_ylabel("diffuse light a particle (um$^2$/sr)")
    axes.flat[0].legend(title="dots: ensemble", fontsize=7, title_fontsize=7, frameon=False)
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main()
