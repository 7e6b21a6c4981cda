"""Gratings: efficiencies against grcwa, fmmax, torcwa and meent at equal error, materials, candidates, and the plugin.

Efficiencies: R and T of the zero order for s and p light at 15 degrees, 16 wavelengths from 400 to 700 nm, one thread.
Each code takes its smallest size that differs from the truth (the finest size of nacre, whose own estimate is a tenth of
that or less) by no more than the allowed error at probe wavelengths; its time there counts, times 16. A code that does
not reach the error within its ladder of sizes is named; so is one that is not installed.
Materials: 16 wavelengths over all directions. The table is compared with solutions at directions between its nodes, by
the colours of the zero order and of the other reflected orders under D65.
Prediction (before the first run): lines of metal 30 x, lines of silicon 10 x, pillars 3 x (products of matrices in
place of eigenvectors took a third of the time there); 15 CPU s for a material of lines, 300 for pillars; 0.6 CPU s for
a candidate along the normal and at 8 degrees; plugin 0.4 x roughconductor.
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
from nacre.core.parallel import single_threaded_blas
from nacre.matter.periodic.solve import difference, size_count, solve, solve_coarse

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
LONGEST_S = 60.0  # CPU seconds of one solution, above which a code's ladder ends
DIRECTIONS = 24


def recipe(name: str) -> dict[str, Any]:
    """Return the grating of a case."""
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
    sides = [side.efficiency[np.all(side.numbers == 0, axis=1)][0] for side in (solution.reflected, solution.transmitted)]
    return np.array([sides[0][0], sides[1][0], sides[0][1], sides[1][1]])


def speed(name: str, worker: Worker | None, codes: list[str]) -> Row:
    """Compare the time at equal error with the fastest code."""
    _, height, thickness, period, allowed, bar = CASES[name]
    stacks = nacre.load(recipe(name)).model.stacks(WAVELENGTHS_NM)
    theta = float(np.radians(THETA_DEG))

    def ours(k: int, step: int) -> Any:
        return solve_coarse(stacks[k], float(WAVELENGTHS_NM[k]), theta, 0.0, step)

    with single_threaded_blas():
        finest = [solve(stacks[k], float(WAVELENGTHS_NM[k]), theta, 0.0, 1e-7, is_strict=False) for k in PROBES]
        truth = np.array([zero_order(each) for each in finest])
        step = next(
            s for s in range(size_count(stacks[0]))
            if max(difference(ours(k, s), each) for k, each in zip(PROBES, finest, strict=True)) <= allowed
        )  # fmt: skip
        own = min(timed(lambda: [ours(k, step) for k in range(len(stacks))])[1] for _ in range(3))
    shape = stacks[0].layers[0].shapes
    cases = [
        {
            "period": period, "width": 0.5 * period, "height": height, "depth": thickness, "substrate": 1.5,
            "theta": theta, "wavelength": float(WAVELENGTHS_NM[k]),
            "epsilon": [stacks[k].layers[0].shapes[0][1].real, stacks[k].layers[0].shapes[0][1].imag],
        }
        for k in PROBES
    ]  # fmt: skip
    assert shape
    times, notes = {}, []
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
    return Row(f"{name}, 16 wavelengths: faster than {min(times, key=times.__getitem__)}", min(times.values()) / own, "x", bar, note=note)


def table_error(model: Any, lam: np.ndarray, tables: Any) -> float:
    """Return the largest dE00 of the zero order and of the sum of other reflected orders between the nodes."""
    from nacre.core.colour import colour_difference  # placeholder

    raise NotImplementedError
