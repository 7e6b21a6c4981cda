"""Photonic glass: walkers a CPU second, medium and spectrum, one candidate of a design, and pictures.

Slabs: those of the reference data of the issue (thirteen with walks of their own), 16 wavelengths each. structcol made
41,000 walkers a CPU second of them on a machine of this kind. Pictures: as bench_render_plugins, against Mitsuba's own
rough conductor. Prediction: 2 million walkers a second, since that is what another compiled walk reached with the
same tables; 0.8 x roughconductor for the table (eight corners of two wavelengths), 0.2 for the walk.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from bench_render_plugins import ALPHA, SIZE, SPP, scene
from common import Row, interleaved, parser, report, timed

import nacre
from nacre.core.arrays import direction
from nacre.families.glass.composite import bruggeman
from nacre.families.glass.medium import Medium, Spheres, solve_medium
from nacre.families.glass.random_walk import walk
from nacre.render import make_bsdf, use_variant

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT.parent / "shared" / "reference" / "glass" / "photonic_glass_open.npz"
STRUCTCOL = 41_000.0  # walkers a CPU second over the same slabs
WALKERS = 20_000
LAM = np.linspace(400.0, 700.0, 16)
RECIPE: dict[str, Any] = {
    "family": "glass",
    "thickness_um": 20,
    "spheres": {"material": {"n": 1.59}, "radius_nm": 120, "volume_fraction": 0.5},
    "absorber": {"k": 0.002},
}
FAST = {**RECIPE, "quality": "fast"}


def slabs() -> list[tuple[Medium, float, float]]:
    """Return medium, thickness in nm and cosine of the light of every slab of the reference."""
    with np.load(REFERENCE) as data:
        found = []
        for case, source in enumerate(data["walk_source"]):
            if source != "own medium":
                continue
            layers, phi = int(data["n_layers"][case]), float(data["volume_fraction"][case])
            radii = data["radius_nm"][case][:layers]
            inner = phi * float(radii[0] / radii[-1]) ** 3
            indices = np.vstack([data["n_particle"][case].T[:layers], data["n_matrix"][case][None]])
            shares = [phi, 1 - phi] if layers == 1 else [inner, phi - inner, 1 - phi]
            effective = bruggeman(indices, np.array(shares))
            spheres = Spheres(data["wavelength_nm"], radii, indices[:layers], effective, phi)
            cos = float(np.cos(np.radians(data["incidence_deg"][case])))
            found.append((solve_medium(spheres), float(data["thickness_um"][case]) * 1e3, cos))
    return found


def physics(repeats: int) -> list[Row]:
    """Time the walk, the medium, a spectrum and a candidate."""
    every = slabs() if REFERENCE.exists() else [(nacre.material(RECIPE).model.composite.medium(LAM), 20e3, 1.0)]
    radii = iter(np.linspace(90.0, 150.0, 10_000))

    def walks() -> None:
        for number, (medium, thickness, cos) in enumerate(every):
            walk(medium, thickness, None, cos, walkers=WALKERS, seed=number)

    def fresh() -> Any:
        return nacre.material({**FAST, "spheres": {**FAST["spheres"], "radius_nm": next(radii)}}).model

    def candidate() -> None:
        model = fresh()
        model.values_at(direction(np.radians([45.0])), direction(np.radians([0.0])), LAM)
        model.spectrum(np.radians([45.0]), LAM, "both")

    jobs = {
        "walks": walks,
        "medium": lambda: fresh().composite.medium(LAM),
        "spectrum": lambda: fresh().spectrum(np.radians([0.0]), LAM, "both"),
        "candidate": candidate,
    }
    times = interleaved({name: (lambda job=job: timed(job)) for name, job in jobs.items()}, repeats)
    walkers = sum(len(medium.wavelengths_nm) for medium, _, _ in every) * WALKERS / times["walks"].median_cpu
    return [
        Row("walkers a CPU second", walkers / 1e6, "million", 1.0, note=f"{len(every)} slabs"),
        Row("walkers / structcol's", walkers / STRUCTCOL, "x", 25.0, note="its figure, of a machine of this kind"),
        Row("medium at 16 wavelengths", 1e3 * times["medium"].median_cpu, "ms", 20.0, False),
        Row("spectrum at 16 wavelengths, no noise", times["spectrum"].median_cpu, "CPU s", 1.0, False),
        Row("candidate: 16 wavelengths, 45 degrees and diffuse", times["candidate"].median_cpu, "CPU s", 0.3, False),
    ]


def pictures(repeats: int) -> list[Row]:
    """Time the plugins."""
    mi = use_variant("llvm_ad_spectral")
    import drjit as dr

    contestants = {
        "roughconductor": {"type": "roughconductor", "material": "Al", "alpha": ALPHA, "distribution": "ggx"},
        "walk": make_bsdf(nacre.material(RECIPE).bsdf()),
        "fast": make_bsdf(nacre.material(FAST).bsdf()),
    }
    scenes = {name: scene(mi, bsdf) for name, bsdf in contestants.items()}
    seeds = iter(range(10**6))

    def render(name: str) -> None:
        dr.eval(mi.render(scenes[name], spp=SPP, seed=next(seeds)))
        dr.sync_thread()

    times = interleaved({name: (lambda name=name: timed(lambda: render(name))) for name in scenes}, repeats)
    rows = []
    for name, bar in (("walk", 0.2), ("fast", 0.8)):
        ratio = times["roughconductor"].median_cpu / times[name].median_cpu
        clock = times["roughconductor"].median_wall / times[name].median_wall
        rows.append(Row(f"{name} / roughconductor", ratio, "x", bar, note=f"{clock:.2f} x by the clock"))
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if all bars are reached."""
    options = parser(__doc__, repeats=5).parse_args(arguments)
    rows = physics(options.repeats) + pictures(options.repeats)
    return report(f"glass: slabs of the reference; sphere, {SIZE}^2, {SPP} samples a pixel", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
