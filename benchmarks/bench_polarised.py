"""Rough films in the polarised variant against Mitsuba's own rough conductor there: the same scene, in one run.

Scene: a sphere that fills most of the frame under a constant emitter, path tracer, 256 x 256, 16 samples a pixel.
Prediction: 0.6 x roughconductor, which computes a complex Fresnel term; the film reads a table of powers and two of
Mueller elements.
"""

from __future__ import annotations

import sys

from bench_render_plugins import ALPHA, film, race
from common import Row, parser, report

from nacre.render import use_variant

SPP = 16
LEAST_RATIO = 0.5


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bar is reached."""
    options = parser(__doc__, repeats=7).parse_args(arguments)
    mi = use_variant("llvm_ad_spectral_polarized")
    contestants = {
        "roughconductor ggx": {"type": "roughconductor", "material": "Al", "alpha": ALPHA, "distribution": "ggx"},
        "film on Al, ggx": film("Al", "SiO2", 300.0, "ggx"),
    }
    times, first = race(mi, contestants, SPP, options.repeats)
    peer, ours = (times[name] for name in contestants)
    ratio, by_clock = peer.median_cpu / ours.median_cpu, peer.median_wall / ours.median_wall
    rows = [Row("film / roughconductor", ratio, "x", LEAST_RATIO, note=f"{by_clock:.2f} x by the clock")]
    for name, spent in times.items():
        note = f"first picture {first[name]:.2f} s"
        rows.append(Row(name, spent.median_cpu, "CPU seconds a picture", note=note))
    return report(f"polarised: sphere, 256^2, {SPP} samples a pixel", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
