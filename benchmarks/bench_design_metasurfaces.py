"""Metasurfaces from wanted colours: hidden recipes found again from what they show.

Each hidden recipe (spheres of one of four materials on an oxide over one of three substrates) gives six colours:
mirror and diffuse, for light from 0, 30 and 60 degrees. They are computed, and the answer is evaluated, in a process
from the tables of the Bsdf (`reference_metasurfaces.py`), which no search builds. By default 5 recipes, each search
ending where all six colours are within three quarters of the bar; with `--all` ten and to a fifth of it, saved
as they are done, so that a run that was cut short goes on.

Bars: dE00 <= 1.5 at all six for 9 of 10, <= 180 s each; <= 0.25 CPU s for a candidate of 16 wavelengths at 6
directions.
Floor: a sphere on a stack at one wavelength takes blocks of 16 x 16 for 5 azimuths and neighbour sums of 400 x 80
points, some 3 ms; 16 wavelengths 50 ms.
Prediction (before the first run): 0.15 s a candidate, 2,000 in the time; five numbers and a material with 18 residuals
are well determined, so 9 of 10.
Outcome: see RESULTS.md; the fringes of the oxide leave many valleys, and rough first draws without the neighbours' near
fields (a fifth of the time, dE00 3 to 20 off) find the right ones.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import Row, StoredResults, Worker, report, run_clock_by_cpu, searcher, within_of

import nacre
from nacre.core.errors import NacreError
from nacre.measure.geometry import Geometry
from nacre.optimise.measurement import simulate_measurement

GEOMETRIES = [f"{kind} {angle}" for kind in ("specular", "diffuse") for angle in (0, 30, 60)]
FREE = {
    "particle.radius_nm": (40.0, 100.0),
    "particle.gap_nm": (2.0, 10.0),
    "layers[0].thickness_nm": (50.0, 600.0),
    "monolayer.coverage": (0.03, 0.13),
    "monolayer.packing": (0.13, 0.5),
}
MATERIALS = ["Ag", "Au", "Si", "TiO2"]
SUBSTRATES = ["Si", "glass", "Al"]
SECONDS, WITHIN = 170.0, 1.5
START = {
    "family": "metasurface",
    "layers": [{"material": "SiO2", "thickness_nm": 200.0}],
    "particle": {"material": "Ag", "radius_nm": 70.0, "gap_nm": 3.0},
    "monolayer": {"coverage": 0.08, "packing": 0.25},
}


def hidden(number: int, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """The recipe that the search starts from, and what is changed in the hidden one."""
    rng = np.random.default_rng([seed, number])
    values: dict[str, Any] = {path: float(rng.uniform(*bounds)) for path, bounds in FREE.items()}
    values["particle.material"] = MATERIALS[int(rng.integers(len(MATERIALS)))]
    return {**START, "substrate": SUBSTRATES[int(rng.integers(len(SUBSTRATES)))]}, values


def one(number: int, seed: int, seconds: float, within: float, referee: Worker) -> dict[str, Any]:
    """Design one hidden recipe again, each colour `within` so much, and evaluate the answer."""
    start, values = hidden(number, seed)
    labs = referee.ask("labs", data=start, changes=values, geometries=GEOMETRIES)
    if labs is None:
        return {"skipped": "a sphere whose series does not converge"}
    target = {
        "recipe": start,
        "parameters": {
            **{path: list(bounds) for path, bounds in FREE.items()},
            "particle.material": {"choices": MATERIALS},
        },
        "target": [{"geometry": at, "lab": lab, "tolerance": within} for at, lab in zip(GEOMETRIES, labs)],
        "search": {"seconds": seconds, "solutions": 1, "seed": seed},
    }
    with tempfile.TemporaryDirectory() as folder:
        wall, cpu = time.monotonic(), time.process_time()
        found = nacre.design(target, folder)
        wall, cpu = time.monotonic() - wall, time.process_time() - cpu
        for path, (low, high) in FREE.items():
            assert low <= found.best.material.get(path) <= high, path
        assert found.best.material.get("particle.material") in MATERIALS
        d = referee.ask("differences", recipe=str(Path(folder) / "recipe.toml"), geometries=GEOMETRIES, labs=labs)
    own = max(reached.distance for reached in found.best.targets)
    right = found.best.material.get("particle.material") == values["particle.material"]
    return {"worst": max(d), "own": own, "wall": wall, "cpu": cpu, "same_material": right}


def candidate_seconds(seed: int, count: int = 20) -> float:
    """CPU seconds of one candidate at 16 wavelengths and 6 directions, as in a search; the median."""
    grid, memory, spent = np.linspace(400.0, 700.0, 16), {}, []
    for number in range(2 * count):
        start, values = hidden(number, seed + 1)
        made = nacre.material(start).vary(values)
        begun = time.process_time()
        try:
            simulate_measurement(made, [Geometry.read(at, "target") for at in GEOMETRIES], grid, memory=memory)
        except NacreError:
            continue
        spent.append(time.process_time() - begun)
    return float(np.median(spent[-count:]))


def measure(count: int, seed: int, seconds: float, keep: bool, clock: Mapping[str, float]) -> list[dict[str, Any]]:
    """Do the recipes, stored results left out."""
    stored = StoredResults("design_metasurfaces", keep, seed=seed, seconds=seconds, **clock)

    def design(number: int) -> dict[str, Any]:
        with Worker("reference_metasurfaces.py", Path(sys.executable)) as referee:
            return one(number, seed, seconds, within_of(WITHIN, keep), referee)

    results: list[dict[str, Any]] = []
    while sum("skipped" not in r for r in results) < count:
        results.append(stored.result(len(results), partial(design, len(results))))
    return [r for r in results if "skipped" not in r]


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = searcher(__doc__)
    options.add_argument("--seed", type=int, default=17)
    options.add_argument("--count", type=int, help="hidden recipes")
    options.add_argument("--seconds", type=float, default=SECONDS, help="of each search; more where others share cores")
    chosen = options.parse_args(arguments)
    clock = run_clock_by_cpu(chosen.cores)
    spent = candidate_seconds(chosen.seed)
    done = measure(chosen.count or (10 if chosen.all else 5), chosen.seed, chosen.seconds, chosen.all, clock)
    worst = np.array([r["worst"] for r in done])
    off = float(np.max(np.abs(worst - [r["own"] for r in done])))
    share = float(np.mean(worst <= WITHIN))
    right = sum(r["same_material"] for r in done)
    wall, cpu = (float(np.max([r[key] for r in done])) for key in ("wall", "cpu"))
    rows = [
        Row(
            f"hidden metasurfaces: share with dE00 <= 1.5 at all six, of {len(done)}",
            share,
            "",
            0.9,
            note=f"median of the worst {np.median(worst):.2f}, largest {worst.max():.2f}; reference and search differ "
            f"{off:.2f} at most; the same material in {right}",
        ),
        Row("hidden metasurfaces: longest", wall, "s", 180.0, higher_is_better=False, note=f"{cpu:.0f} s of CPU"),
        Row("candidate at 16 wavelengths and 6 directions, CPU", spent, "s", 0.25, higher_is_better=False),
    ]
    notes = {**clock, "seed": chosen.seed, "load": f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores at the end"}
    return report("design_metasurfaces: metasurfaces from wanted colours", rows, chosen.json, notes)


if __name__ == "__main__":
    sys.exit(main())
