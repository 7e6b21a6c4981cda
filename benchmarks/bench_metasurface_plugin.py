"""Metasurfaces against Mitsuba's own rough conductor and dielectric: samples a second, same scene, same run.

Scene: that of bench_render_plugins (a sphere under a constant emitter, path tracer). Floor: a diffuse sphere.
Prediction (before the first run): 0.5 x roughconductor: 96 packet loads a look-up against its complex Fresnel terms.
It was 0.13 to 0.17. With 12 loads of eight a look-up, 0.3: with all loads from one cached line it was 0.85, so what
remained was memory, 50 MB read at random. With 16-bit numbers and 120 angles, 11 MB, it is 0.53 idle, 0.38 where
others use the cache too. A layout in which neighbouring angles share lines, not wavelengths, was slower (0.5).
An opaque lobe that is nearly matt is drawn by the cosine alone: .66 -> .77 in one run of both. A look-up that returns a
constant gives 1.13 there, so a third of the time is the table's; the cosine leaves the weights a variance up to .09.
Harmonics in 16 bytes a wavelength, not doubled, and draws by the alias method: .50 -> .69 in one run of both, on
glass .19, .16, .12 -> .19, .23, .24 in three (two cores under a load of 5 to 12). With all loads from one cached line a
look-up takes 30 ns for 90, so what remains is memory; on glass the table is 13 MB. A low rank over wavelengths does not
help: 12 terms leave 2-5 % of the largest value.
On glass it is the look-ups, not the paths: these meet the sphere 2.5 times, the dielectric's 2.65 times, and cut off
after the first hit the ratio is .24 (.15 against .60 CPU s for a million samples, under a load of 10).
With 64 angles where 120 and 100 were (a third of the memory), old and new in turn, four times: opaque .60, .81,
.69, .71 -> 1.05, .93, .81, .92; on glass .20, .30, .18, .21 -> .37, .37, .23, .25 (idle, idle, load of 1.4 twice).
Not paid: the same pairs as a square, the view counting slowest (twice the memory: as slow or slower); the share of the
mirror part from one mean over wavelengths (a tenth less time, twice the variance in blue: it passes .5 to .98 of the
light over the spectrum); a branch round the look-up. A gather costs by the word, not by the packet (16 of 1, 2, 4, 8
words: 6, 12, 22, 42 ns a lane, all cached), so words are what is left: with two a series for four, an opaque one
would reach .94 and one on glass .40, but leave .2-.4 % of the largest value.
With a power of two in each packet two words round dark rows as finely as bright ones (at most .3 % in root mean
square, else four are taken); nodes are fitted to the lines between them, so that half of them are as exact; and four
corners of a tetrahedron of both angles and the wavelength are read where six were. Old and new in turn, twice, (ahead):
opaque .91, 1.01 -> 1.06, .98; on glass .36, .38 -> .52, .53. What tetrahedra leave against the truth, which wavelengths
10 nm apart leave most of: .17 % -> .20 % (silver on glass), .57 -> .83 (on oxide), .81 -> 1.19 (silicon on glass).
Ratios are of CPU time, since the loads of a shared machine disturb the clock more.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench_render_plugins import ALPHA, SIZE, SPP, scene
from common import Row, interleaved, parser, report, timed

import nacre
from nacre.render import make_bsdf, use_variant

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "metasurface"
BAR, GLASS_BAR = 0.9, 0.5


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bar is reached."""
    options = parser(__doc__, repeats=7).parse_args(arguments)
    mi = use_variant("llvm_ad_spectral")
    import drjit as dr

    contestants = {
        "roughconductor": {"type": "roughconductor", "material": "Al", "alpha": ALPHA, "distribution": "ggx"},
        "roughdielectric": {
            "type": "roughdielectric",
            "int_ior": "bk7",
            "ext_ior": "air",
            "alpha": ALPHA,
            "distribution": "ggx",
        },
        "opaque metasurface": make_bsdf(nacre.load(EXAMPLES / "silver_on_oxide.toml").bsdf()),
        "metasurface on glass": make_bsdf(nacre.load(EXAMPLES / "silver_halo.toml").bsdf()),
    }
    scenes = {name: scene(mi, bsdf) for name, bsdf in contestants.items()}
    seeds = iter(range(10**6))

    def render(name: str) -> None:
        dr.eval(mi.render(scenes[name], spp=SPP, seed=next(seeds)))
        dr.sync_thread()

    times = interleaved({name: (lambda name=name: timed(lambda: render(name))) for name in scenes}, options.repeats)
    rows = []
    # light goes through the sphere on glass and meets it twice, as it does on the dielectric
    for name, other, bar in (
        ("opaque metasurface", "roughconductor", BAR), ("metasurface on glass", "roughdielectric", GLASS_BAR),
    ):  # fmt: skip
        ratio = times[other].median_cpu / times[name].median_cpu
        clock = times[other].median_wall / times[name].median_wall
        rows.append(Row(f"{name} / {other}", ratio, "x", bar, note=f"{clock:.2f} x by the clock"))
    samples = SIZE * SIZE * SPP / 1e6
    rows += [Row(name, samples / spent.median_cpu, "Msamples a CPU second") for name, spent in times.items()]
    return report(f"metasurface_plugin: sphere, {SIZE}^2, {SPP} samples a pixel", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
