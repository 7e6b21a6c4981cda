"""Films from wanted colours: one colour, one held over angles, flops, two lamps, yield.

Every answer is evaluated by `tmm` and colour-science (`reference_films.py`) in steps of 1 nm, in a process; materials,
thicknesses and the number of layers are checked too. By default a tenth of the targets, at least 5 of each kind, where
a search ends within three quarters of its bar and one for yield has 10 s; with `--all` all of them, to a fifth of the
bar and 30 s, stored in a file as they are done, so that a run that was cut short goes on.

Bars: see the rows. Floor: a step of descent of 6 layers at 5 angles x 24 wavelengths is 6 x 24 x (9 x 80 + 5 x 45)
operations, 136,000, some 10 us; 10 layers at normal incidence x 35 wavelengths 44,000, 3 us.
Prediction (before the first run): 3 us x 20 steps x 10 starts and as much again for everything else, 2 ms for one
colour, all < 1; 10 us x 30 steps = 3,000 descents a second and thread, so 300,000 stacks in 60 s, of which the earlier
trial saw some hundred: 85 % < 2. Flops in seconds, most of it the start. Two lamps: 10 layers have 4 numbers more than
needed, so most. Yield: a choice among many answers, 1.5 x.
Outcome: one colour 6 ms, nearly all below 0.2; on 5 nm the reference was up to 0.5 dE00 off the search, for
bright colours of high finesse, on 2 nm 0.02. Held colours: better than predicted. Flops: a second of CPU. Two lamps:
missed, and out of reach: a second row says for how many targets any reflectance at all, whatever made it, has the same
CIELAB under both; the stacks come as far. Yield: the range is wide, from nothing gained to six times.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from common import Row, StoredResults, Worker, report, run_clock_by_cpu, searcher, within_of

from nacre.light import SRGB_WHITE_XYZ, srgb_decode, srgb_linear_to_xyz, xyz_to_lab
from nacre.matter.indices.library import index
from nacre.optimise.merit import MeritFunction, Operand, default_wavelengths_nm
from nacre.optimise.thin_film.search import Medium, StackProblem, StackSolution, many, search

GRID = default_wavelengths_nm()
COATINGS = ("SiO2", "MgF2", "TiO2", "Si", "Ge", "Cr", "Ti", "W")
BASES = ("Al", "Ag", "Au", "Cu", "W", "Cr", "Si")
HELD_DEG = [0.0, 15.0, 30.0, 45.0, 60.0]
FLOP_DEG = [0.0, 60.0]
HELD_NM, PLAIN_NM = (2.0, 300.0), (5.0, 300.0)
HUE_DEG, CHROMA = 5.0, (40.0, 30.0)
SECONDS = {"held": 60.0, "flop": 15.0, "lamps": 15.0, "yield": 30.0}
SHORT_YIELD_S = 10.0  # of a run that is not of all targets
NUMBERS = {"colour": (1000, 100), "held": (100, 10), "flop": (100, 10), "lamps": (100, 10), "yield": (30, 5)}
SPREAD, TOLERANCE, MADE_DRAWS = 0.02, 2.0, 200


def medium(name: str) -> Medium:
    """A material on the searched wavelengths."""
    return Medium(name, index(name).n_complex(GRID))


def random_labs(seed: int, count: int) -> np.ndarray:
    """Uniform random sRGB, as CIELAB by D65 and 2 degrees."""
    rgb = np.random.default_rng(seed).uniform(size=(count, 3))
    return xyz_to_lab(srgb_linear_to_xyz(srgb_decode(rgb)), SRGB_WHITE_XYZ)


def oxides(goals: MeritFunction) -> StackProblem:
    """Up to 10 layers of TiO2 and SiO2 on N-BK7."""
    bounds = {"TiO2": PLAIN_NM, "SiO2": PLAIN_NM}
    return StackProblem(goals, (medium("TiO2"), medium("SiO2")), (medium("BK7"),), max_layers=10, bounds_nm=bounds)


def metals(goals: MeritFunction, angles_deg: list[float], spread: float = 0.0) -> StackProblem:
    """Up to 6 layers of eight materials on seven substrates."""
    return StackProblem(
        goals,
        tuple(map(medium, COATINGS)),
        tuple(map(medium, BASES)),
        tuple(np.radians(angles_deg)),
        ("reflected",) * len(angles_deg),
        max_layers=6,
        bounds_nm=dict.fromkeys(COATINGS, HELD_NM),
        relative_tolerance=spread,
    )


def wanted(lab: Iterable[float], rows: int, lamps: tuple[str, ...] = ("D65",), tolerance: float = 1.0) -> MeritFunction:
    """One colour in every row."""
    l, a, b = (float(v) for v in lab)
    return MeritFunction([Operand(row, "colour", lab=(l, a, b), tolerance=tolerance) for row in range(rows)], lamps)


def stack_of(found: StackSolution, problem: StackProblem) -> dict[str, Any]:
    """An answer as the reference takes it; materials, bounds and count are checked first."""
    assert len(found.materials) <= problem.max_layers and found.substrate in [m.name for m in problem.substrates]
    for name, d in zip(found.materials, found.thicknesses_nm):
        low, high = problem.bounds_of(name)  # raises for a material that is not of the palette
        assert low <= d <= high, (name, d)
    return {
        "materials": list(found.materials),
        "substrate": found.substrate,
        "thicknesses_nm": [float(d) for d in found.thicknesses_nm],
    }


def timed_search(problem: StackProblem, seconds: float, seed: int) -> tuple[StackSolution, float, float]:
    """The best answer, seconds by the clock and of CPU."""
    wall, cpu = time.monotonic(), time.process_time()
    best = search(problem, seconds, 1, seed)[0]
    return best, time.monotonic() - wall, time.process_time() - cpu


def held(i: int, seed: int, is_all: bool, referee: Worker) -> dict[str, Any]:
    """One colour at five angles."""
    lab = random_labs(seed + 1, i + 1)[i]
    problem = metals(wanted(lab, len(HELD_DEG), tolerance=within_of(TOLERANCE, is_all)), HELD_DEG)
    best, wall, cpu = timed_search(problem, SECONDS["held"], seed)
    d = referee.ask("differences", stack=stack_of(best, problem), angles_deg=HELD_DEG, lamps=["D65"], lab=lab.tolist())
    return {"worst": max(d), "own": float(best.d.max()), "wall": wall, "cpu": cpu}


def flop(i: int, seed: int, is_all: bool, referee: Worker) -> dict[str, Any]:
    """Two hues at two angles."""
    hues = np.random.default_rng(seed + 2).uniform(0.0, 360.0, (i + 1, 2))[i]
    goals = [
        Operand(r, "hue", low=float(h) - HUE_DEG, high=float(h) + HUE_DEG, tolerance=1.0) for r, h in enumerate(hues)
    ]
    goals += [Operand(r, "chroma", low=c, tolerance=1.0) for r, c in enumerate(CHROMA)]
    problem = metals(MeritFunction(goals), FLOP_DEG)
    best, wall, cpu = timed_search(problem, SECONDS["flop"], seed)
    labs = referee.ask("labs", stack=stack_of(best, problem), angles_deg=FLOP_DEG, lamps=["D65"])
    off = [
        abs((np.degrees(np.arctan2(lab[0][2], lab[0][1])) - h + 180.0) % 360.0 - 180.0) for lab, h in zip(labs, hues)
    ]
    chroma = [float(np.hypot(lab[0][1], lab[0][2])) for lab in labs]
    met = max(off) <= HUE_DEG and all(c >= least for c, least in zip(chroma, CHROMA))
    return {"met": bool(met), "off_deg": max(off), "chroma": chroma, "wall": wall, "cpu": cpu}


def lamps(i: int, seed: int, is_all: bool, referee: Worker) -> dict[str, Any]:
    """One colour under D65 and A, where any reflectance has it at all: see `reach_lamps`."""
    lab = random_labs(seed + 3, i + 1)[i]
    limit = referee.ask("reach", lab=lab.tolist(), lamps=["D65", "A"])
    if limit["is_impossible"]:
        return {"worst": np.inf, "own": np.inf, "wall": 0.0, "cpu": 0.0, **limit}
    problem = oxides(wanted(lab, 1, ("D65", "A"), within_of(1.0, is_all)))
    best, wall, cpu = timed_search(problem, SECONDS["lamps"], seed)
    d = referee.ask(
        "differences", stack=stack_of(best, problem), angles_deg=[0.0], lamps=["D65", "A"], lab=lab.tolist()
    )
    return {"worst": max(d), "own": float(best.d.max()), "wall": wall, "cpu": cpu, **limit}


def yields(i: int, seed: int, is_all: bool, referee: Worker) -> dict[str, Any]:
    """The yield of an answer found for it, and of one found without; a target out of reach counts as none."""
    lab = random_labs(seed + 4, i + 1)[i]
    plain_problem = metals(wanted(lab, len(HELD_DEG)), HELD_DEG)
    seconds = SECONDS["yield"] if is_all else SHORT_YIELD_S
    plain, _, _ = timed_search(plain_problem, seconds, seed)
    if plain.d.max() >= 1.0:
        return {"skipped": float(plain.d.max())}
    robust_problem = metals(wanted(lab, len(HELD_DEG), tolerance=TOLERANCE), HELD_DEG, SPREAD)
    robust, wall, cpu = timed_search(robust_problem, seconds, seed)
    shares = [
        referee.ask(
            "made",
            stack=stack_of(one, plain_problem),
            angles_deg=HELD_DEG,
            lab=lab.tolist(),
            relative=SPREAD,
            tolerance=TOLERANCE,
            draws=MADE_DRAWS,
            seed=seed,
        )
        for one in (plain, robust)
    ]
    return {"plain": shares[0], "robust": shares[1], "own": robust.yield_share, "wall": wall, "cpu": cpu}


def colours(count: int, seed: int, referee: Worker) -> list[dict[str, Any]]:
    """One colour each, all in one call."""
    targets = random_labs(seed, count)
    goals = [wanted(lab, 1) for lab in targets]
    problem = oxides(goals[0])
    many(problem, goals[:1])  # compiles
    wall, cpu = time.monotonic(), time.process_time()
    found = many(problem, goals, seed)
    wall, cpu = time.monotonic() - wall, time.process_time() - cpu
    return [
        {
            "worst": referee.ask(
                "differences", stack=stack_of(one, problem), angles_deg=[0.0], lamps=["D65"], lab=lab.tolist()
            )[0],
            "own": float(one.d.max()),
            "wall": wall / count,
            "cpu": cpu / count,
        }
        for one, lab in zip(found, targets)
    ]


EACH: dict[str, Callable[[int, int, bool, Worker], dict[str, Any]]] = {
    "held": held,
    "flop": flop,
    "lamps": lamps,
    "yield": yields,
}


def measure(
    kind: str, count: int, seed: int, keep: bool, referee: Worker, clock: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Do the targets of a kind, stored results left out."""
    stored = StoredResults(
        "design_films", keep, kind=kind, seed=seed, **({"count": count} if kind == "colour" else {}), **clock
    )
    if kind == "colour":  # all in one call
        found = cache(lambda: colours(count, seed, referee))
        return [stored.result(number, lambda number=number: found()[number]) for number in range(count)]
    results: list[dict[str, Any]] = []
    while sum("skipped" not in r for r in results) < count:
        number = len(results)
        results.append(stored.result(number, partial(EACH[kind], number, seed, keep, referee)))
    return results


def rows_of(kind: str, results: list[dict[str, Any]]) -> list[Row]:
    """The claims of a kind."""
    done = [r for r in results if "skipped" not in r]
    n = len(done)
    wall, cpu = (float(np.max([r[key] for r in done])) for key in ("wall", "cpu"))
    clock = f"longest {wall:.1f} s by the clock, {cpu:.1f} s of CPU"
    worst = np.array([r.get("worst", np.nan) for r in done])
    apart = [abs(r["worst"] - r["own"]) for r in done if np.isfinite(r.get("worst", np.nan))]
    own = float(np.max(apart)) if apart else 0.0
    agreement = f"reference and search differ by {own:.3f} dE00 at most"
    if kind == "colour":
        mean_ms = 1e3 * float(np.mean([r["cpu"] for r in done]))
        return [
            Row(f"one colour: share below dE00 1, of {n}", float(np.mean(worst < 1.0)), "", 0.98, note=agreement),
            Row(
                "one colour: share below 0.2", float(np.mean(worst < 0.2)), "", 0.95, note=f"largest {worst.max():.2f}"
            ),
            Row("one colour: CPU each", mean_ms, "ms", 50.0, higher_is_better=False),
        ]
    if kind == "held":
        return [
            Row(
                f"held at five angles: share below 2, of {n}",
                float(np.mean(worst < 2.0)),
                "",
                0.8,
                note=f"median {np.median(worst):.2f}, largest {worst.max():.2f}; {agreement}",
            ),
            Row("held at five angles: share below 4", float(np.mean(worst < 4.0)), "", 0.92),
            Row("held at five angles: longest", wall, "s", 60.0, higher_is_better=False, note=f"{cpu:.0f} s of CPU"),
        ]
    if kind == "flop":
        return [
            Row(f"flop: share of {n} pairs met", float(np.mean([r["met"] for r in done])), "", 0.98),
            Row("flop: longest", wall, "s", 15.0, higher_is_better=False, note=f"{cpu:.1f} s of CPU"),
        ]
    if kind == "lamps":
        is_possible = np.array([not r["is_impossible"] for r in done])
        shown, met = float(np.mean([r["is_possible"] for r in done])), worst < 1.0
        median = float(np.median(worst[is_possible])) if is_possible.any() else np.nan
        return [
            Row(
                f"D65 and A: share of {n} below 1 under both",
                float(np.mean(met)),
                "",
                0.6,
                note=f"of no more than {np.mean(is_possible):.2f} that any reflectance has, by a linear program; "
                f"{shown:.2f} are shown to be had",
            ),
            Row(
                f"D65 and A: share of the {is_possible.sum()} that a reflectance has",
                float(np.mean(met[is_possible])) if is_possible.any() else np.nan,
                "",
                0.6,
                note=f"median of the worse {median:.2f}; {agreement}; {clock}",
            ),
        ]
    plain, robust = (np.median([r[key] for r in done]) for key in ("plain", "robust"))
    gain = 1.5 if robust >= 0.95 else float(robust / max(plain, 1e-3))
    note = f"medians {plain:.3f} and {robust:.3f}; {len(results) - n} targets out of reach; {clock}"
    return [Row(f"yield with spreads over without, {n} targets", gain, "x", 1.5, note=note)]


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = searcher(__doc__)
    options.add_argument("--seed", type=int, default=17)
    options.add_argument("--count", type=int, help="targets of each kind")
    options.add_argument("kinds", nargs="*", choices=[*NUMBERS, []], help="default: every kind")
    chosen = options.parse_args(arguments)
    clock = run_clock_by_cpu(chosen.cores)
    rows: list[Row] = []
    with Worker("reference_films.py", Path(sys.executable)) as referee:
        for kind in chosen.kinds or NUMBERS:
            count = chosen.count or NUMBERS[kind][0 if chosen.all else 1]
            rows += rows_of(kind, measure(kind, count, chosen.seed, chosen.all, referee, clock))
    notes = {**clock, "seed": chosen.seed, "load": f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores at the end"}
    return report("design_films: films from wanted colours", rows, chosen.json, notes)


if __name__ == "__main__":
    sys.exit(main())
