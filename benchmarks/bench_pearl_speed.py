"""Pearls against Mitsuba's own rough conductor: samples a second, same scene, same run; and the time to build one.

Scene: that of bench_render_plugins (a sphere under a constant emitter, path tracer). Floor: a diffuse sphere.
Prediction (before the first run): 0.25 x roughconductor for bottle 2, whose walks are short; less for the dense
ones, since a walk has as many steps as the light meets flakes. Tables: 0.45 s of CPU for mica, from a profile.
Ratios are of CPU time, since the loads of a shared machine disturb the clock more.
Outcome: see RESULTS.md. While the walk met one flight and one boundary a step, bottle 1 stood at 0.037, bottle 5 at
0.059 and bottle 2 at 0.26; with up to eight flights before a boundary at 0.067, 0.114 and 0.36.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from bench_render_plugins import ALPHA, SIZE, SPP, scene
from common import Row, interleaved, parser, report, timed

import nacre
from nacre.render import make_bsdf, use_variant

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "pearl"
BAR = 0.25
TABLES_S = 0.5


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=5).parse_args(arguments)
    mi = use_variant("llvm_ad_spectral")
    import drjit as dr

    bottles = ("bottle1", "bottle2", "bottle5", "car_middle")
    contestants = {"roughconductor": {"type": "roughconductor", "material": "Al", "alpha": ALPHA}}
    rows = []
    for name in bottles:
        material = nacre.load(EXAMPLES / f"{name}.toml")
        material.bsdf()  # compiles the kernels of the optics, once a machine
        start = time.process_time()
        bsdf = material.bsdf()
        rows.append(Row(f"tables of {name}", time.process_time() - start, "s of CPU", TABLES_S, higher_is_better=False))
        contestants[name] = make_bsdf(bsdf)
    scenes = {name: scene(mi, bsdf) for name, bsdf in contestants.items()}
    seeds = iter(range(10**6))

    def render(name: str) -> None:
        dr.eval(mi.render(scenes[name], spp=SPP, seed=next(seeds)))
        dr.sync_thread()

    times = interleaved({name: (lambda name=name: timed(lambda: render(name))) for name in scenes}, options.repeats)
    for name in bottles:
        ratio = times["roughconductor"].median_cpu / times[name].median_cpu
        clock = times["roughconductor"].median_wall / times[name].median_wall
        rows.append(Row(f"{name} / roughconductor", ratio, "x", BAR, note=f"{clock:.2f} x by the clock"))
    samples = SIZE * SIZE * SPP / 1e6
    rows += [Row(name, samples / spent.median_cpu, "Msamples a CPU second") for name, spent in times.items()]
    return report(f"pearl_speed: sphere, {SIZE}^2, {SPP} samples a pixel", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
