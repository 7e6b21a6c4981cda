"""What other codes give for the same numbers, and the worst difference: stacks, spheres, disks, slabs.

`tmm` runs here; what SMUTHI, miepython, a Monte Carlo of hard disks and a walk through photonic glass gave is kept in
the shared reference data, which none of ours made. Gratings are compared in `relief_rcwa`, patterns of spheres in
`metasurface_ensembles`, colours of reliefs in `relief_published_renders`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import tmm

from nacre.families.glass.composite import bruggeman
from nacre.families.glass.medium import Spheres, solve_medium
from nacre.families.glass.radiative_transfer import Slab
from nacre.families.metasurface.monolayer.structure import baus_colot
from nacre.families.metasurface.tmatrix.particle_on_stack import ParticleOnStack, amplitude
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter import solve
from nacre.matter.mie import default_order, mie_coefficients, mie_efficiencies
from validation._film import canvas
from validation._rows import finish, row

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference"
FIGURE = "tools_other_codes.png"
STACKS = 1000
UNDECIDED_GLASS = (12, 14)  # rough faces, of which the other code has no walk through the right medium


def tmm_difference() -> float:
    """Amplitudes and powers of random stacks of up to 7 layers, half of the media absorbing."""
    rng = np.random.default_rng(20261123)
    worst = 0.0
    for _ in range(STACKS):
        layers = int(rng.integers(0, 8))
        n = rng.uniform(1.2, 4.0, layers + 2) + 1j * rng.uniform(0, 5, layers + 2) * (rng.random(layers + 2) < 0.5)
        n[0] = 1.0
        thickness = rng.uniform(0, 500, layers)
        wavelength, theta = float(rng.uniform(360, 830)), float(rng.uniform(0, 1.55))
        ours = solve(n[:, None], thickness, [wavelength], theta)
        for which in "sp":
            theirs = tmm.coh_tmm(which, n, [np.inf, *thickness, np.inf], theta, wavelength)
            worst = max(worst, *(abs(getattr(ours, f"{key}_{which}")[0] - theirs[key]) for key in "rtRT"))
    return worst


def mie_difference() -> float:
    """Efficiencies of free spheres, relative."""
    data = np.load(REFERENCE / "metasurface" / "mie.npz")
    worst = 0.0
    for i, x in enumerate(data["x"]):
        q = mie_efficiencies(*mie_coefficients(default_order(x), [x], [data["n_sphere"][i]]), x)
        theirs = ((q.extinction, "Qext"), (q.scattering, "Qsca"), (q.backscattering, "Qback"))
        worst = max(worst, *(float(abs(ours / data[name][i] - 1)) for ours, name in theirs))
    return worst


def smuthi_difference() -> float:
    """Differential cross-sections of a sphere on a stack, relative L2 of each case."""
    data = np.load(REFERENCE / "metasurface" / "sphere_on_stack.npz")
    worst = 0.0
    for i, wavelength in enumerate(data["wavelength_nm"]):
        film = float(data["film_h_nm"][i])
        indices = [1.0, *([complex(data["n_film"])] if film > 0 else []), complex(data["n_substrate"][i])]
        below = Substrate(float(wavelength), np.array(indices), np.array([film] if film > 0 else []))
        radius, order = float(data["radius_nm"][i]), int(data["lmax"])
        a, b = mie_coefficients(order, [below.wavenumber * radius], [data["n_sphere"][i]])
        height = radius + float(data["gap_nm"][i])
        ours = ParticleOnStack(below, height, np.concatenate([-b, -a]), int(data["mmax"]))
        arriving = ours.directions([np.cos(np.radians(data["theta_i_deg"][i]))])
        leaving = ours.directions(np.cos(data["theta_s_rad"]))
        f = amplitude(ours.harmonics(leaving, arriving), data["phi_rad"])
        power = np.abs(f[:, :, int(data["pol_in"][i]), 0]) ** 2 * 1e-6
        theirs = data["dsigma_um2_per_sr"][i]
        worst = max(worst, float(np.linalg.norm(power - theirs) / np.linalg.norm(theirs)))
    return worst


def disks_difference() -> float:
    """Structure factor of hard disks, root mean square over q, packings .1, .3 and .5."""
    data = np.load(REFERENCE / "metasurface" / "hard_disk_structure.npz")
    return max(
        float(np.sqrt(np.mean((baus_colot(data[f"q_{packing}"], packing) - data[f"mc_{packing}"]) ** 2)))
        for packing in (0.1, 0.3, 0.5)
    )


def glass_differences() -> tuple[list[float], list[str]]:
    """Reflectance and transmittance of slabs: the greatest difference of each case over 16 wavelengths."""
    data = np.load(REFERENCE / "glass" / "photonic_glass_open.npz")
    worst, names = [], []
    for case in range(len(data["name"])):
        if case in UNDECIDED_GLASS:
            continue
        layers, share = int(data["n_layers"][case]), float(data["volume_fraction"][case])
        radii = data["radius_nm"][case][:layers]
        core = share if layers == 1 else share * float(radii[0] / radii[1]) ** 3
        parts = [core, 1 - share] if layers == 1 else [core, share - core, 1 - share]
        particle = data["n_particle"][case].T[:layers]
        effective = bruggeman(np.vstack([particle, data["n_matrix"][case][None]]), np.array(parts))
        deviation = float(data["pdi"][case]) * float(radii[-1])
        medium = solve_medium(Spheres(data["wavelength_nm"], radii, particle, effective, share, deviation))
        cosine = np.array([np.cos(np.radians(float(data["incidence_deg"][case])))])
        found = np.array([
            [float(part[0]) for part in Slab.solve(medium, band, 1e3 * data["thickness_um"][case], None).powers(cosine)]
            for band in range(len(data["wavelength_nm"]))
        ])  # fmt: skip
        reflected = np.abs(found[:, 0] + found[:, 2] - data["R_walk"][case]).max()
        passed = np.abs(found[:, 1] + found[:, 3] - data["T_walk"][case]).max()
        worst.append(float(max(reflected, passed)))
        names.append(str(data["name"][case]))
    return worst, names


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print what was compared | bar | worst difference, write the figure, return the rows."""
    slabs, names = glass_differences()
    # bars: of the issues that built each part; of disks by the noise of the Monte Carlo, of slabs by three of the walk
    compared = [
        ("film", "tmm", f"amplitudes and powers of {STACKS} random stacks", "1e-11", tmm_difference()),
        ("metasurface", "miepython", "efficiencies of 32 free spheres, relative", "1e-10", mie_difference()),
        ("metasurface", "SMUTHI", "cross-sections of 24 spheres on stacks, relative L2", "2e-5", smuthi_difference()),
        ("metasurface", "Monte Carlo", "structure factor of hard disks, rms", "0.02", disks_difference()),
        ("glass", "walk by another", f"R and T of {len(slabs)} slabs at 16 wavelengths", "0.004", max(slabs)),
    ]
    figure, axes = canvas(1, 1, 6.4, 3.2)
    plot = axes.flat[0]
    plot.barh(names, slabs, color="0.6")
    plot.axvline(0.004, color="k", lw=0.8, ls="--")
    plot.set(xlabel="greatest difference of R and T to a walk by another code")
    plot.tick_params(labelsize=7)
    finish(figure, out_dir, FIGURE)
    return [
        {**row(what, f"within {bar}", f"{worst:.1e}", worst <= float(bar), FIGURE), "family": family, "code": code}
        for family, code, what, bar, worst in compared
    ]


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
