"""Pearls matched from their colours at six trade angles, as a formulator does: hidden recipes of one or two pigments.

A hidden recipe is drawn by seed; the search gets the resin, the film's thickness, three pigments that the
shop has (their materials, how flat they lie), and CIELAB at 45as-15 ... 45as110. Free are coating and substrate
thickness and the amount of each pigment, where 0 drops it, and the albedo of the ground. Targets and answers are
computed by the reference walk in another process (`reference_pearls.py`), each with its own seed, 16 times the samples,
and until the standard error is below 0.1 dE00. By default 5 of the 20 recipes; with `--all` all of them, saved
as they are done, so that a run that was cut short goes on.

Bar: mean dE00 over the six angles <= 1 for 18 of 20, each in <= 120 s on two cores. A loaded machine is measured by its
CPU time against twice that.
Floor: one candidate is three pigments' tables, 65 cosines x 21 wavelengths x 2 polarisations x some 30 ns = 0.1 ms each
were it only the amplitudes; averaging over the substrate costs 15 ms. Prediction (before the first run): 50 ms a
candidate that changes thicknesses, 10 ms one that changes amounts; 10 numbers, so 0.4 s a step; 8 starts of 25 steps:
80 s, 5 walks of 5 s: 25 s; mean dE00 0.3, as the data have 18 numbers for 10.
Outcome (seed 17, `--all --cores 1.4`, beside much other work): with one start after another 16 of 20 within 1, from .07
to .92, and 13, 15, 17, 19, all of two pigments, at 1.07, 1.12, 1.92, 1.37, their searches at the end of the time: their
descents had not met the right orders of interference. With `valleys.py` (14 wavelengths, slopes stored by Broyden's
updates, hops along each length) a descent takes 1.3 s of CPU in place of 1 to 9, and 17 comes to .26 (161 s of CPU).
In a trial of these steps before they were built in, on targets of the likeness itself, which have no noise, the hidden
places of 11, 15, 16, 17, 19 were met in 8 to 37 s of CPU, that of 13 not in 60 (1.0). By the reference all 20 are
within 1, median .15; 13 .95, 19 .77, the others below .5; one pigment 27 to 140 s of CPU.
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
from common import Row, StoredResults, Worker, report, run_clock_by_cpu, searcher

import nacre
from nacre.recipe.toml import dump_toml

NUMBER, FEWER = 20, 5
SECONDS, CORES = 120.0, 2
BAR_DE00, SHARE = 1.0, 0.9
GEOMETRIES = ["45as-15", "45as15", "45as25", "45as45", "45as75", "45as110"]
# coating, substrate, its spread over the flakes as a share, bounds of both thicknesses in nm, how flat the flakes lie
SHOP = (
    ("TiO2", "mica", 0.25, (40.0, 180.0), (250.0, 600.0), 0.06),
    ("TiO2", "SiO2", 0.08, (40.0, 180.0), (150.0, 500.0), 0.08),
    ("Fe2O3", "mica", 0.25, (20.0, 120.0), (250.0, 600.0), 0.06),
)
AMOUNT = (0.004, 0.06)
GROUND = (0.02, 0.7)


def platelet(kind: int, amount: float, coating_nm: float, substrate_nm: float) -> dict[str, Any]:
    """One pigment as a recipe has it; the spread of its substrate is that of the middle of its bounds."""
    coating, substrate, spread, _, bounds, flatness = SHOP[kind]
    return {
        "volume_fraction": amount,
        "substrate": {
            "material": substrate,
            "thickness_nm": substrate_nm,
            "deviation_nm": spread * sum(bounds) / 2,
        },
        "coatings": [{"material": coating, "thickness_nm": coating_nm}],
        "normal_deviation": flatness,
    }


def hidden(number: int, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a hidden recipe and the same paint with the whole shop in it, which the search starts from."""
    rng = np.random.default_rng([seed, number])
    pigments = rng.choice(len(SHOP), size=1 + number % 2, replace=False)
    film = {
        "resin": {"n": float(np.round(rng.uniform(1.48, 1.58), 3))},
        "thickness_um": float(np.round(rng.uniform(30.0, 120.0))),
        "roughness": float(np.round(rng.choice([0.0, 0.02, 0.1]), 3)),
    }
    inside = [
        platelet(
            int(k), float(np.exp(rng.uniform(*np.log(AMOUNT)))), *(float(rng.uniform(*SHOP[k][i])) for i in (3, 4))
        )
        for k in pigments
    ]
    shop = [platelet(k, 0.01, sum(SHOP[k][3]) / 2, sum(SHOP[k][4]) / 2) for k in range(len(SHOP))]
    ground = float(rng.uniform(*GROUND))
    return (
        {"family": "pearl", "strata": [{**film, "platelets": inside}], "base": {"albedo": ground}},
        {"family": "pearl", "strata": [{**film, "platelets": shop}], "base": {"albedo": 0.3}},
    )


def target(start: dict[str, Any], labs: list[list[float]], seconds: float, seed: int) -> dict[str, Any]:
    """Return what `nacre.design` is asked.

    A short run asks for no less: at 2.5 times the `within`, and so of the noise, recipe 3 was met to 1.2 and not to .2.
    """
    free: dict[str, Any] = {"base.albedo": [0.0, 0.9]}
    for k, (_, _, _, coating, substrate, _) in enumerate(SHOP):
        head = f"strata[0].platelets[{k}]"
        free[f"{head}.volume_fraction"] = [0.0, 0.08]
        free[f"{head}.coatings[0].thickness_nm"] = list(coating)
        free[f"{head}.substrate.thickness_nm"] = list(substrate)
    geometries = [{"geometry": at, "lab": lab, "tolerance": BAR_DE00} for at, lab in zip(GEOMETRIES, labs, strict=True)]
    search = {"seconds": seconds, "solutions": 1, "seed": seed}
    return {"recipe": start, "parameters": free, "target": geometries, "search": search}


def one(number: int, seed: int, seconds: float, referee: Worker) -> dict[str, Any]:
    """Hide a recipe, find one of the same colours, and evaluate it."""
    recipe, start = hidden(number, seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "hidden.toml").write_text(dump_toml(recipe), encoding="utf-8")
        wanted = referee.ask("colours", recipe=str(folder / "hidden.toml"), seed=1000 + number)
        wall, cpu = time.monotonic(), time.process_time()
        found = nacre.design(target(start, wanted["labs"], seconds, seed), folder / "out")
        wall, cpu = time.monotonic() - wall, time.process_time() - cpu
        evaluated = referee.ask(
            "differences", recipe=str(folder / "out" / "recipe.toml"), labs=wanted["labs"], seed=500_000 + number
        )
        left = nacre.load(folder / "out" / "recipe.toml").data["strata"][0].get("platelets", [])
    return {
        "mean": float(np.mean(evaluated["de00"])),
        "worst": float(np.max(evaluated["de00"])),
        "de00": evaluated["de00"],
        "own": [r.distance for r in found.best.targets],
        "error": float(np.max([*wanted["error"], *evaluated["error"]])),
        "wall": wall,
        "cpu": cpu,
        "pigments": [len(recipe["strata"][0]["platelets"]), len(left)],
    }


def measure(
    count: int, seed: int, seconds: float, keep: bool, only_kept: bool, referee: Worker, clock: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Do the recipes, stored results left out."""
    stored = StoredResults("design_pearls", keep, seed=seed, seconds=seconds, **clock)
    numbers = [number for number in range(count) if number in stored or not only_kept]
    return [stored.result(number, partial(one, number, seed, seconds, referee)) for number in numbers]


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = searcher(__doc__)
    options.add_argument("--seed", type=int, default=17)
    options.add_argument("--count", type=int, help="recipes")
    options.add_argument("--seconds", type=float, default=SECONDS, help="of each search, by the clock")
    options.add_argument("--stored", action="store_true", help="with --all: what a stopped run has done, and no more")
    chosen = options.parse_args(arguments)
    clock = run_clock_by_cpu(chosen.cores)
    count = chosen.count or (NUMBER if chosen.all else FEWER)
    with Worker("reference_pearls.py", Path(sys.executable)) as referee:
        found = measure(count, chosen.seed, chosen.seconds, chosen.all, chosen.stored, referee, clock)
    if not found:
        raise SystemExit("nothing is stored")
    mean = np.array([r["mean"] for r in found])
    of_all = "" if len(found) == count else f" of the {count}"
    noise = f"noise of the reference at most {max(r['error'] for r in found):.2f} dE00"
    apart = max(float(np.max(np.abs(np.subtract(r["de00"], r["own"])))) for r in found)
    rows = [
        Row(
            f"six angles: share of {len(found)}{of_all} with a mean of 1 or less",
            float(np.mean(mean <= BAR_DE00)),
            "",
            SHARE,
            note=f"median {np.median(mean):.2f}, largest {mean.max():.2f}; {noise}",
        ),
        Row(
            "six angles: largest mean dE00",
            float(mean.max()),
            "",
            note=f"worst angle {max(r['worst'] for r in found):.2f}; reference and design differ by {apart:.2f}",
        ),
        Row(
            "six angles: longest, CPU",
            max(r["cpu"] for r in found),
            "s",
            CORES * SECONDS,
            higher_is_better=False,
            note=f"{max(r['wall'] for r in found):.0f} s by the clock",
        ),
    ]
    notes = {**clock, "seed": chosen.seed, "load": f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores at the end"}
    return report("design_pearls: pearls from their colours at six angles", rows, chosen.json, notes)


if __name__ == "__main__":
    sys.exit(main())
