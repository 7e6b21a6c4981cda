"""Gratings: efficiencies against grcwa, fmmax, torcwa and meent at equal error, materials, candidates, and the plugin.

Efficiencies: R and T of the zero order for s and p light at 15 degrees, 16 wavelengths from 400 to 700 nm, one thread.
Each code takes its smallest size that differs from the truth (the finest size of nacre) by no more than the allowed
error at probe wavelengths; its time there counts, times 16. A code that does not reach the error within its ladder of
sizes is named; so is one that is not installed.
Materials: 16 wavelengths over all directions. The table is compared with solutions at directions between its nodes, by
the colours of the zero order and of the other reflected orders under D65.
Prediction (before the first run): lines of metal 30 x, lines of silicon 10 x, pillars 3 x (products of matrices in
place of eigenvectors took a third of the time there); 15 CPU s for a material of lines, 300 for pillars; 0.6 CPU s for
a candidate along the normal and at 8 degrees; plugin 0.4 x roughconductor.
Prediction for tables from fitted responses: 8 CPU s for lines and 150 for pillars, 90 % within dE00 0.4.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
from typing import Any

import numpy as np
from bench_render_plugins import ALPHA, SIZE, SPP, scene
from common import Row, Worker, interleaved, parser, report, timed

import nacre
from nacre.core.arrays import interpolate
from nacre.core.machine import single_threaded_blas
from nacre.light import spectrum_to_xyz, xyz_to_lab
from nacre.light.colour_spaces import delta_e_2000
from nacre.matter.periodic.order_tables import order_tables, solve_as_table
from nacre.matter.periodic.solve import difference, size_count, solve, solve_coarse, solve_many
from nacre.render import make_bsdf, use_variant

WAVELENGTHS_NM = np.linspace(400.0, 700.0, 16)
PROBES = (1, 8, 14)
THETA_DEG = 15.0
LADDERS = {
    # orders to each side (in two periods: radius of a circle for grcwa and fmmax, side of a square for the others)
    1: (10, 20, 40, 80, 160, 240), 2: (4, 5, 6, 7, 8, 9, 10),
}  # fmt: skip
CASES = {
    # name -> material, height of a pillar, thickness, period, allowed error, bar
    "lines of aluminium": ("Al", None, 100.0, 400.0, 1.5e-3, 20.0),
    "lines of silicon": ("Si", None, 120.0, 400.0, 3e-4, 10.0),
    "pillars of silicon": ("Si", 150.0, 120.0, 300.0, 4e-3, 2.0),
}
PROFILES = {
    "sinusoid of aluminium": {"shape": "sinusoidal", "depth_nm": 100},
    "blazed aluminium": {"shape": "blazed", "depth_nm": 100, "apex": 0.9},
}
SLOPES = {
    # name -> material, substrate
    "trapezoids of aluminium on aluminium": ("Al", "Al"),
    "trapezoids of aluminium on glass": ("Al", {"n": 1.5}),
    "trapezoids of silicon on glass": ("Si", {"n": 1.5}),
}
LONGEST_S = 60.0  # CPU seconds of one solution, above which a code's ladder ends
DIRECTIONS, PILLAR_DIRECTIONS = 60, 20


def recipe(name: str) -> dict[str, Any]:
    """Return the grating of a case."""
    if name in PROFILES:
        return {
            "family": "grating", "substrate": "Al", "lattice": {"period_nm": 400}, "profile": PROFILES[name],
            "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 20},
        }  # fmt: skip
    if name in SLOPES:
        material, substrate = SLOPES[name]
        line = {"shape": "line", "width_nm": 200, "material": material, "sidewall_deg": 80}
        return {
            "family": "grating", "substrate": substrate, "lattice": {"period_nm": 400},
            "layers": [{"thickness_nm": 100, "material": "air", "shapes": [line]}],
            "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 20},
        }  # fmt: skip
    material, height, thickness, period, _, _ = CASES[name]
    shape = {"shape": "line"} if height is None else {"shape": "rectangle", "length_nm": height}
    shape |= {"width_nm": 0.5 * period, "material": material}
    return {
        "family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": period},
        "layers": [{"thickness_nm": thickness, "material": "air", "shapes": [shape]}],
        "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 20},
    }  # fmt: skip


def zero_order(solution: Any) -> np.ndarray:
    """Return R s, T s, R p, T p of the zero order."""
    both = solution.reflected, solution.transmitted
    sides = [side.efficiency[np.all(side.numbers == 0, axis=1)][0] for side in both]
    return np.array([sides[0][0], sides[1][0], sides[0][1], sides[1][1]])


def speed(name: str, worker: Worker | None, codes: list[str]) -> Row:
    """Compare the time at equal error with the fastest code."""
    _, height, thickness, period, allowed, bar = CASES[name]
    stacks = nacre.load(recipe(name)).model.stacks(WAVELENGTHS_NM)
    theta = float(np.radians(THETA_DEG))

    def ours(places: Any, step: int) -> Any:
        return solve_many([(stacks[k], float(WAVELENGTHS_NM[k]), theta, 0.0) for k in places], step)

    with single_threaded_blas():
        finest = [solve(stacks[k], float(WAVELENGTHS_NM[k]), theta, 0.0, 1e-7, is_strict=False) for k in PROBES]
        truth = np.array([zero_order(each) for each in finest])
        step = next(
            s for s in range(size_count(stacks[0]))
            if max(difference(*pair) for pair in zip(ours(PROBES, s), finest, strict=True)) <= allowed
        )  # fmt: skip
        own = min(timed(lambda: ours(range(len(stacks)), step))[1] for _ in range(3))
    cases = [
        {
            "period": period, "width": 0.5 * period, "height": height, "depth": thickness, "substrate": 1.5,
            "theta": theta, "wavelength": float(WAVELENGTHS_NM[k]),
            "epsilon": [stacks[k].layers[0].shapes[0][1].real, stacks[k].layers[0].shapes[0][1].imag],
        }
        for k in PROBES
    ]  # fmt: skip
    times: dict[str, float] = {}
    notes = []
    for code in codes:
        assert worker is not None
        for size in LADDERS[1 if height is None else 2]:
            answer = worker.ask("solve", code=code, cases=cases, size=size)
            error = float(np.abs(np.array(answer["values"]) - truth).max())
            if error <= allowed:
                times[code] = len(WAVELENGTHS_NM) * answer["cpu"]
                notes.append(f"{code} {times[code]:.2f} s with {size}")
                break
            if answer["cpu"] > LONGEST_S:
                break
        if code not in times:
            notes.append(f"{code} {error:.1e} with {size}")
    note = f"nacre {own:.3f} CPU s; {'; '.join(notes)}; error {allowed:g}"
    if not times:
        return Row(f"{name}, 16 wavelengths: no other code reaches the error; nacre", own, "CPU s", note=note)
    fastest = min(times, key=times.__getitem__)
    return Row(f"{name}, 16 wavelengths: faster than {fastest}", times[fastest] / own, "x", bar, note=note)


def table_rows(name: str, count: int, bar: float | None) -> list[Row]:
    """Measure a material and the colours between the nodes of its table."""
    model = nacre.load(recipe(name)).model
    stacks = model.stacks(WAVELENGTHS_NM)
    tables: list[Any] = []
    spent = timed(lambda: tables.append(order_tables(stacks, WAVELENGTHS_NM, None)))[1]
    table = tables[0]
    generator = np.random.default_rng(40)
    theta = np.arccos(np.sqrt(generator.uniform(0.03, 1.0, count)))
    azimuth = generator.uniform(0.0, 2.0 * np.pi, count)
    exact = np.zeros((2, count, len(WAVELENGTHS_NM)))
    with single_threaded_blas():
        for d in range(count):
            for w, wavelength in enumerate(WAVELENGTHS_NM):
                side = solve_as_table(stacks[w], float(wavelength), theta[d], azimuth[d] + np.pi).reflected
                is_zero = np.all(side.numbers == 0, axis=1)
                mean = side.efficiency.mean(axis=1)
                exact[:, d, w] = mean[is_zero].sum(), mean[~is_zero].sum()
    at = theta / (0.5 * np.pi) * (table.mirror.shape[0] - 1), azimuth / (2.0 * np.pi) * (table.mirror.shape[1] - 1)
    found = np.stack([interpolate(table.mirror, at), interpolate(table.reflected.sum(axis=2), at)])
    labs = [xyz_to_lab(spectrum_to_xyz(np.maximum(part, 0.0), WAVELENGTHS_NM)) for part in (exact, found)]
    errors = delta_e_2000(*labs)
    medians, tails, worst = np.median(errors, axis=1), np.quantile(errors, 0.9, axis=1), errors.max(axis=1)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    shape = " x ".join(str(size) for size in table.mirror.shape[:2])
    note = f"table of {shape} directions; this process had {memory:.1f} GB"
    return [
        Row(f"material, {name}, 16 wavelengths", spent, "CPU s", bar, False, note),
        Row(f"material, {name}: dE00 between nodes in nine tenths of the directions, zero order and others",
            float(tails.max()), "dE00", 0.5, False,
            f"{count} directions; zero order: median {medians[0]:.2f}, 90 % {tails[0]:.2f}, worst {worst[0]:.2f}; "
            f"others: {medians[1]:.2f}, {tails[1]:.2f}, {worst[1]:.2f}"),
    ]  # fmt: skip


def candidates() -> list[Row]:
    """Time the zero order of a disc as a search does."""
    disc = {"shape": "disc", "material": "Si", "diameter_nm": 140}
    made = {
        "family": "grating", "substrate": "glass", "lattice": {"period_nm": 300},
        "layers": [
            {"thickness_nm": 130, "material": "air", "shapes": [disc]}, {"thickness_nm": 50, "material": "SiO2"},
        ],
    }  # fmt: skip
    stacks = nacre.load(made).model.stacks(WAVELENGTHS_NM)
    rows = []
    for degrees in (0.0, 8.0):

        def run(theta: float = float(np.radians(degrees))) -> None:
            with single_threaded_blas():
                for w, wavelength in enumerate(WAVELENGTHS_NM):
                    solve_coarse(stacks[w], float(wavelength), theta, 0.0)

        run()
        spent = min(timed(run)[1] for _ in range(3))
        rows.append(Row(f"candidate with a disc at {degrees:g} degrees, 16 wavelengths", spent, "CPU s", 1.0, False))
    return rows


def plugin(repeats: int) -> Row:
    """Compare the plugin with Mitsuba's rough conductor."""
    mi = use_variant("llvm_ad_spectral")
    import drjit as dr

    grooves = {
        "family": "grating", "substrate": "Al", "lattice": {"period_nm": 1600},
        "profile": {"shape": "sinusoidal", "depth_nm": 120},
        "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 50},
    }  # fmt: skip
    bsdfs = {
        "roughconductor": {"type": "roughconductor", "material": "Al", "alpha": ALPHA, "distribution": "ggx"},
        "grating": make_bsdf(nacre.material(grooves).bsdf()),
    }
    scenes = {name: scene(mi, bsdf) for name, bsdf in bsdfs.items()}
    seeds = iter(range(10**6))

    def render(name: str) -> None:
        dr.eval(mi.render(scenes[name], spp=SPP, seed=next(seeds)))
        dr.sync_thread()

    times = interleaved({name: (lambda name=name: timed(lambda: render(name))) for name in scenes}, repeats)
    peer, own = times["roughconductor"], times["grating"]
    note = f"{peer.median_wall / own.median_wall:.2f} x by the clock; sphere, {SIZE}^2, {SPP} samples a pixel"
    return Row("plugin / roughconductor", peer.median_cpu / own.median_cpu, "x", 0.3, note=note)


def peers() -> tuple[Worker | None, dict[str, str], str]:
    """Return the worker, the installed codes with their versions, and a line about those that are missing."""
    try:
        worker = Worker("peer_gratings.py")
    except SystemExit as error:
        return None, {}, f"no other code is timed: {error}"
    found = worker.ask("versions")
    missing = [name for name, version in found.items() if version is None]
    return worker, {k: v for k, v in found.items() if v}, f"not installed: {', '.join(missing)}" if missing else ""


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=5)
    options.add_argument("--only", choices=("speed", "tables", "candidates", "plugin"), help="one part")
    chosen = options.parse_args(arguments)
    parts = (chosen.only,) if chosen.only else ("speed", "tables", "candidates", "plugin")
    rows: list[Row] = []
    notes: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NACRE_CACHE"] = folder  # nothing is taken from an earlier run
        if "speed" in parts:
            worker, codes, missing = peers()
            notes |= {"codes": ", ".join(f"{k} {v}" for k, v in codes.items())}
            notes |= {"missing": missing} if missing else {}
            rows += [speed(name, worker, list(codes)) for name in CASES]
        if "tables" in parts:
            for name in ("lines of aluminium", "lines of silicon", *PROFILES, *SLOPES):
                rows += table_rows(name, DIRECTIONS, 20.0)
            rows += table_rows("pillars of silicon", PILLAR_DIRECTIONS, 1200.0)
        if "candidates" in parts:
            rows += candidates()
        if "plugin" in parts:
            rows.append(plugin(chosen.repeats))
    return report("gratings: efficiencies, materials, candidates, plugin", rows, chosen.json, notes)


if __name__ == "__main__":
    sys.exit(main())
