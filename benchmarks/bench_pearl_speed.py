"""Pearls against Mitsuba's own rough conductor: samples a second, same scene, same run; noise; the time to build one.

Scene of the speeds: that of bench_render_plugins (a sphere under a constant emitter, path tracer). Floor: a diffuse
sphere. Prediction (before the first run): 0.25 x roughconductor for bottle 2, whose walks are short; less for the
dense ones, since a walk has as many steps as the light meets flakes. Tables: 0.45 s of CPU for mica, from a profile.
Fast route: 0.6 x, since one value reads 16 packets of its table and 8 of the base's where a conductor reads none;
noise 10 to 100 x lower in variance at equal time. Ratios are of CPU time, since the loads of a shared machine
disturb the clock more.

Scene of the noise: our knob in studio light, object pixels, luminance, from the difference of two renders. The time
to the variance of 4,096 samples of the reference is extrapolated: variance falls as 1/samples.
Outcome: see RESULTS.md. While the walk met one flight and one boundary a step, bottle 1 stood at 0.037, bottle 5 at
0.059 and bottle 2 at 0.26; with up to eight flights before a boundary at 0.067, 0.114 and 0.36. One walk for value
and sample, which a path tracer asks for together (prediction: 1.6 x, since both walks are equally long): bottle 2 0.37
-> 0.50, bottle 5 0.128 -> 0.205, alternating in one run at 16 samples, with 6 % more variance a sample. The faster
reference also raises the bar of the fast route's noise at equal time.
Lanes of a packet wait for the longest walk among them: of bottle 1 the mean walk met 42 flakes, the longest of 16
lanes 195. Flights straight on through flakes that let the light pass (prediction: a sixth of the flights, as R is 0.16,
at twice the cost each: 2 to 3 x): mean 10, longest 52; bottle 1 2.09 -> 0.95 to 1.2 s, bottle 5 1.38 -> 0.91 s, bottle
2 0.50 -> 0.43 s of CPU, both versions alternating. Tried without gain: reading the flakes' tables without
interpolation (kept, for it is simpler: 0 to 10 %), a drawn one of two connections, roulette by halves after 32 flights
(17 % faster, 45 % more second moment), smaller tables.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from bench_render_plugins import ALPHA, SIZE, SPP, scene
from common import Row, interleaved, parser, report, timed

import nacre
from nacre.render import make_bsdf, use_variant

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "pearl"
BAR, FAST_BAR = 0.25, 0.6
TABLES_S, BAKE_S, FILE_S = 0.5, 30.0, 1.0
FAST = ("bottle1", "bottle2", "bottle5")
NOISE_RATIO, KNOB_S = 10.0, 600.0
KNOB_SIZE, KNOB_SPP, KNOB_REFERENCE_SPP = 512, 8, 4096


def conserving(name: str) -> nacre.Material:
    """An example with conserved energy; its random walks are longer, and the figures here are of them."""
    return nacre.load(EXAMPLES / f"{name}.toml").vary({"strata[0].platelets[0].energy_balance": "conserving"})


def bake(name: str, rows: list[Row]) -> nacre.Bsdf:
    """Bake a bottle, store it, and note how long each took; return what the file gives."""
    material = conserving(name).vary({"quality": "fast"})
    start, clock = time.process_time(), time.perf_counter()
    bsdf = material.bsdf()
    spent, clock = time.process_time() - start, time.perf_counter() - clock
    note = f"{clock:.1f} s by the clock; {bsdf.provenance['notes'][-1].partition('(')[0].strip()}"
    rows.append(Row(f"baking {name}", clock, "s", BAKE_S, False, note=f"{spent:.1f} s of CPU; {note}"))
    with tempfile.TemporaryDirectory() as folder:
        bsdf.save(Path(folder) / "fast.nacre")
        start = time.perf_counter()
        loaded = nacre.Bsdf.load(Path(folder) / "fast.nacre")
        rows.append(Row(f"{name}, fast, from its file", time.perf_counter() - start, "s", FILE_S, False))
    return loaded


def noise(name: str, fast: nacre.Bsdf) -> list[Row]:
    """Compare luminance variance and time of both routes on the knob."""
    reference = conserving(name).bsdf()
    mask = object_pixels()
    found = {}
    for route, bsdf in (("reference", reference), ("fast", fast)):
        knob(bsdf, KNOB_SPP, 1)  # compiles: another number of samples is another kernel
        start, clock = time.process_time(), time.perf_counter()
        first = knob(bsdf, KNOB_SPP, 2)
        spent, clock = time.process_time() - start, time.perf_counter() - clock
        second = knob(bsdf, KNOB_SPP, 3)
        found[route] = (float(np.mean((first - second)[mask] ** 2)) / 2, spent, clock)
    (variance, cost, _), (smooth, cheap, clock) = found["reference"], found["fast"]
    ratio = variance * cost / (smooth * cheap)
    target = variance * KNOB_SPP / KNOB_REFERENCE_SPP
    seconds = clock * smooth / target
    note = f"variance {smooth / variance:.3g} of the reference's a sample, CPU time {cheap / cost:.3g}"
    return [
        Row(
            f"{name}: variance at equal time, reference / fast, knob in the studio", ratio, "x", NOISE_RATIO, note=note
        ),
        Row(f"{name}: fast to the variance of {KNOB_REFERENCE_SPP} samples", seconds, "s", KNOB_S, False),
    ]


def knob(bsdf: Any, spp: int, seed: int) -> np.ndarray:
    """Return the luminance of the knob in studio light."""
    size = (KNOB_SIZE, KNOB_SIZE)
    picture = nacre.render.render(bsdf, scene="knob", light="studio", size=size, spp=spp, seed=seed, denoise=False)
    return np.asarray(picture.xyz[..., 1], dtype=float)


def object_pixels() -> np.ndarray:
    """Pixels that change when the knob's material does."""
    black, white = (nacre.material({"family": "pearl", "strata": [
        {"resin": {"n": 1.5}, "thickness_um": 1, "roughness": 0.5}], "base": {"albedo": albedo},
    }).bsdf() for albedo in (0.0, 0.95))  # fmt: skip
    return knob(white, 4, 1) > 3.0 * knob(black, 4, 1)


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=3).parse_args(arguments)
    mi = use_variant("llvm_ad_spectral")
    import drjit as dr

    bottles = ("bottle1", "bottle2", "bottle5", "car_middle")
    contestants = {"roughconductor": {"type": "roughconductor", "material": "Al", "alpha": ALPHA}}
    rows = []
    for name in bottles:
        material = conserving(name)
        material.bsdf()  # compiles the kernels of the optics, once a machine
        start = time.process_time()
        bsdf = material.bsdf()
        rows.append(Row(f"tables of {name}", time.process_time() - start, "s of CPU", TABLES_S, higher_is_better=False))
        contestants[name] = make_bsdf(bsdf)
    fast = {name: bake(name, rows) for name in FAST}
    contestants |= {f"{name}, fast": make_bsdf(bsdf) for name, bsdf in fast.items()}
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
    for name in FAST:
        ratio = times["roughconductor"].median_cpu / times[f"{name}, fast"].median_cpu
        clock = times["roughconductor"].median_wall / times[f"{name}, fast"].median_wall
        rows.append(Row(f"{name}, fast / roughconductor", ratio, "x", FAST_BAR, note=f"{clock:.2f} x by the clock"))
    for name in FAST:
        rows += noise(name, fast[name])
    samples = SIZE * SIZE * SPP / 1e6
    rows += [Row(name, samples / spent.median_cpu, "Msamples a CPU second") for name, spent in times.items()]
    return report(f"pearl_speed: sphere, {SIZE}^2, {SPP} samples a pixel; knob {KNOB_SIZE}^2", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
