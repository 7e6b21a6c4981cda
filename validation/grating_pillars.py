"""Pillars and holes of clear materials against another code, `fmmax`: orders, s and p, oblique and conical light.

`_pillars_make.py` draws the gratings and solves them with two numbers of Fourier orders, kept in
`validation/data/pillar_orders.jsonl`. Errors of its crossed series fall about as one over their number, so the limit
is extrapolated, and the distance from the larger number to it is the doubt. Gratings that the other code doubts by
more than the bar (high pillars of silicon) decide nothing against the bar.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import nacre
from nacre.matter.periodic.solve import solve
from validation._film import canvas
from validation._pillars_make import read_cases
from validation._rows import finish, row

FIGURE = "grating_pillars.png"
BAR = 4e-3  # of the issue, two periods
NAMES = ("reflected", "transmitted")


def compared(case: dict[str, Any]) -> tuple[float, float, float]:
    """Return the largest difference of an efficiency, the other code's doubt, and our stated error."""
    wavelength, theta, azimuth = case["light"]
    stack = nacre.load(case["recipe"]).model.stacks(np.array([wavelength]))[0]
    found = solve(stack, wavelength, float(np.radians(theta)), float(np.radians(azimuth)))
    few, many = sorted(case["fmmax"], key=int)
    ratio = int(few) / (int(many) - int(few))
    apart, doubt = 0.0, 0.0
    for name in NAMES:
        side = getattr(found, name)
        for number, ours in zip(side.numbers.tolist(), side.efficiency, strict=True):
            key = ",".join(map(str, number))
            coarse, fine = (np.array(case["fmmax"][n][name].get(key, (0.0, 0.0))) for n in (few, many))
            apart = max(apart, float(np.abs(ours - fine - ratio * (fine - coarse)).max()))
            doubt = max(doubt, float(ratio * np.abs(fine - coarse).max()))
    return apart, doubt, found.error


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    cases = read_cases()
    found = np.array([compared(case) for case in cases])
    names = [
        f"{case['number']}: {case['material']}, {case['recipe']['layers'][0]['shapes'][0]['shape']}"
        + " hole" * case["is_hole"]
        for case in cases
    ]
    figure, axes = canvas(1, 1, 6.4, 3.6)
    plot = axes.flat[0]
    for at, label in enumerate(("difference", "doubt of the other code", "stated error")):
        plot.semilogx(np.maximum(found[:, at], 1e-6), names, "o|x"[at], label=label, mfc="none")
    plot.axvline(BAR, color="k", lw=0.8, ls="--")
    plot.set(xlabel="efficiency of an order")
    plot.tick_params(labelsize=7)
    plot.legend(fontsize=7, frameon=False)
    finish(figure, out_dir, FIGURE)
    decided = np.flatnonzero(found[:, 1] <= BAR)
    worst = int(decided[np.argmax(found[decided, 0])])
    beyond = int(np.sum(found[:, 0] > found[:, 1] + found[:, 2]))
    undecided = [f"{names[k]}, doubt {found[k, 1]:.0e}" for k in range(len(cases)) if k not in decided]
    ours = f"{found[worst, 0]:.1e} ({names[worst]}); median {np.median(found[decided, 0]):.1e}"
    ours += f"; {len(undecided)} undecided ({'; '.join(undecided)})" * bool(undecided)
    made = row(
        f"orders of {len(decided)} drawn gratings of two periods, s and p: largest difference", f"within {BAR:g}",
        ours, found[worst, 0] <= BAR, FIGURE,
    )  # fmt: skip
    return [
        made | {"family": "grating", "code": "fmmax"},
        row(f"of all {len(cases)}, differences beyond the sum of both doubts",
            f"at most {0.05 * len(cases):.0f}", beyond, beyond <= round(0.05 * len(cases)), FIGURE),
    ]  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
