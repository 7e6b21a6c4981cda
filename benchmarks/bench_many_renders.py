"""Fifty renders in one process, over all families: time and memory stay flat.

Ten materials in five rounds, each render with another seed, so every round does the same work. The first round
compiles kernels and builds tables; the last is compared to the second, by CPU seconds and by resident memory.
Floor: 1. Prediction (before the first run): 1.00 in time within the noise of 3 %, memory within 2 %.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import gc
import sys
import time

from common import ROOT, Row, parser, report, resident_mb

import nacre

GROWTH_BAR = 1.05
ROUNDS = 3
RECIPES = (
    "soap.toml", "gold.toml", "morpho.toml", "coated-glass-600.toml", "metasurface/silver_halo.toml",
    "metasurface/silicon_on_glass.toml", "pearl/bottle1.toml", "pearl/bottle3.toml", "pearl/car_front.toml",
    "relief/star.toml",
)  # fmt: skip


def one_round(index: int, bsdfs: dict[str, nacre.bsdf.Bsdf]) -> tuple[float, float]:
    """Render every material once; CPU seconds and the memory that is left in use."""
    start = time.process_time()
    for number, bsdf in enumerate(bsdfs.values()):
        nacre.render(bsdf, size=(64, 64), spp=16, seed=100 * index + number, exposure=0.0)
    spent = time.process_time() - start
    gc.collect()
    return spent, resident_mb()


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=ROUNDS).parse_args(arguments)
    bsdfs = {name: nacre.load(ROOT / "examples" / name).bsdf() for name in RECIPES}
    rounds = [one_round(index, bsdfs) for index in range(max(options.repeats, 3))]
    seconds, memory = zip(*rounds)
    rows = [
        Row("time of the last round / the second", seconds[-1] / seconds[1], "x", GROWTH_BAR, higher_is_better=False,
            note=f"rounds {', '.join(f'{s:.1f}' for s in seconds)} s of CPU"),
        Row("memory after the last round / the second", memory[-1] / memory[1], "x", GROWTH_BAR,
            higher_is_better=False, note=f"rounds {', '.join(f'{m:.0f}' for m in memory)} MB"),
    ]  # fmt: skip
    return report(f"many_renders: {len(rounds) * len(RECIPES)} renders of four families", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
