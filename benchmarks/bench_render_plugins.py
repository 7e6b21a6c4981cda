"""Rough films against Mitsuba's own rough conductor and dielectric: samples a second, same scene, same run.

Scene: a sphere that fills most of the frame under a constant emitter, path tracer, 256 x 256, 32 samples a pixel.
Floor: the same scene with a diffuse sphere; what a BSDF costs is the time above it.
Prediction (before the first run): opaque 1.3 x roughconductor (the prototype had 1.4: a packet load of four numbers
is cheaper than a complex Fresnel term at four wavelengths); glass that absorbs nothing 0.9 x roughdielectric, since
T = 1 - R halves the look-ups of the prototype's 0.47, and one table serves both sides; an absorbing film on glass 0.7.
The loads of a shared machine disturb the clock more than CPU time, so ratios are of CPU time.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from common import Row, interleaved, parser, report, timed

import nacre
from nacre.render import make_bsdf, use_variant

SIZE, SPP = 256, 32
ALPHA = 0.2


def film(substrate: str, layer: str, thickness_nm: float, distribution: str, **surface: Any) -> Any:
    """Return the Mitsuba BSDF of a rough film."""
    recipe = {
        "family": "film",
        "substrate": substrate,
        "layers": [{"material": layer, "thickness_nm": thickness_nm}],
        "surface": {"distribution": distribution, "roughness": ALPHA, **surface},
    }
    return make_bsdf(nacre.material(recipe).bsdf())


def scene(mi: Any, bsdf: Any) -> Any:
    """Put a BSDF on the sphere."""
    film_entry = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "pixel_format": "rgb"}
    view = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "sphere": {"type": "sphere", "bsdf": bsdf},
            "light": {"type": "constant"},
            "sensor": {"type": "perspective", "fov": 40, "to_world": view, "film": film_entry},
        }
    )


def race(mi: Any, contestants: dict[str, Any], spp: int, repeats: int) -> tuple[dict[str, Any], dict[str, float]]:
    """Render the sphere with each BSDF in turn; return the times, and the seconds of each first picture."""
    import drjit as dr

    scenes = {name: scene(mi, bsdf) for name, bsdf in contestants.items()}
    first: dict[str, float] = {}
    seeds = iter(range(10**6))

    def render(name: str) -> None:
        dr.eval(mi.render(scenes[name], spp=spp, seed=next(seeds)))
        dr.sync_thread()

    def run(name: str) -> tuple[float, float]:
        start = time.perf_counter()
        result = timed(lambda: render(name))
        first.setdefault(name, time.perf_counter() - start)
        return result

    return interleaved({name: (lambda name=name: run(name)) for name in scenes}, repeats), first


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=9).parse_args(arguments)
    mi = use_variant("llvm_ad_spectral")
    conductor = {"type": "roughconductor", "material": "Al", "alpha": ALPHA}
    dielectric = {"type": "roughdielectric", "int_ior": "bk7", "ext_ior": "air", "alpha": ALPHA}
    contestants = {
        "diffuse": {"type": "diffuse"},
        "roughconductor ggx": {**conductor, "distribution": "ggx"},
        "film on Al, ggx": film("Al", "SiO2", 300.0, "ggx"),
        "roughconductor beckmann": {**conductor, "distribution": "beckmann"},
        "film on Al, beckmann": film("Al", "SiO2", 300.0, "beckmann"),
        "film on Al, ggx, compensated": film("Al", "SiO2", 300.0, "ggx", compensate=True),
        "roughdielectric ggx": {**dielectric, "distribution": "ggx"},
        "film on glass, ggx": film("BK7", "TiO2", 100.0, "ggx"),
        "absorbing film on glass, ggx": film("BK7", "Ag", 15.0, "ggx"),
        "roughdielectric beckmann": {**dielectric, "distribution": "beckmann"},
        "film on glass, beckmann": film("BK7", "TiO2", 100.0, "beckmann"),
    }
    times, first = race(mi, contestants, SPP, options.repeats)
    rows = []
    for ours, peer, bar in (
        ("film on Al, ggx", "roughconductor ggx", 0.9),
        ("film on Al, beckmann", "roughconductor beckmann", 0.9),
        ("film on Al, ggx, compensated", "roughconductor ggx", None),
        ("film on glass, ggx", "roughdielectric ggx", 0.7),
        ("film on glass, beckmann", "roughdielectric beckmann", 0.7),
        ("absorbing film on glass, ggx", "roughdielectric ggx", 0.7),
    ):
        ratio = times[peer].median_cpu / times[ours].median_cpu
        by_clock = times[peer].median_wall / times[ours].median_wall
        rows.append(Row(f"{ours} / {peer}", ratio, "x", bar, note=f"{by_clock:.2f} x by the clock"))
    samples = SIZE * SIZE * SPP / 1e6
    floor = times["diffuse"].median_cpu
    for name, spent in times.items():
        above = (spent.median_cpu - floor) / samples * 1e3
        note = f"{above:.0f} ns a sample above diffuse; first picture {first[name]:.2f} s"
        rows.append(Row(name, samples / spent.median_cpu, "Msamples a CPU second", note=note))
    return report(f"render_plugins: sphere, {SIZE}^2, {SPP} samples a pixel", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
