"""An ensemble material: 16 wavelengths, 24 patterns of 130 spheres of order 2, on glass; its time and memory.

By default two of the 16 wavelengths, whose time counts eight times; with `--all` all of them.

Floor: 384 matrices of 2080 unknowns in single precision, 24 GFlop each to factor: 0.25 s on one core here, 50 s on two.
Prediction (before the first run): twice the floor with right sides, far fields and tables: 100 s.
CPU time over two cores stands for the clock of two free cores; the clock of a shared machine is in the note.
With patterns that repeat, the sum over images (a product of 400 waves with all pairs), more directions and the fit of
single orders take as long as the factors: about 0.9 CPU s a pattern.
Outcome (ahead, on two shared cores): 2.7 min of both cores, 5.4 by the clock, .54 GB.
"""

from __future__ import annotations

import os
import resource
import sys

import numpy as np
from common import Row, parser, report, timed

import nacre
from nacre.material.material import material

CORES = 2
RECIPE = {
    "family": "metasurface",
    "substrate": "glass",
    "particle": {"material": "Ag", "radius_nm": 90},
    "monolayer": {"coverage": 0.1},
    "model": {"correction": "ensemble", "tolerance": 0.01, "ensemble": {"realisations": 24}},
}


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    takes = parser(__doc__, repeats=1)
    takes.add_argument("--all", action="store_true", help="all 16 wavelengths, in about 5 minutes")
    options = takes.parse_args(arguments)
    os.environ["NACRE_CACHE"] = "off"
    grid = np.linspace(400.0, 700.0, 16)
    shown = grid if options.all else grid[4::8]
    wall, cpu = timed(lambda: material(RECIPE).bsdf(shown))
    cpu *= len(grid) / len(shown)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    note = f"{len(shown)} of them took {wall:.0f} s by the clock"
    rows = [
        Row("ensemble material of 16 wavelengths", cpu / CORES / 60, "min", 8.0, False, note),
        Row("its memory", memory, "GB", 6.0, False),
    ]
    return report(f"metasurface_ensemble: nacre {nacre.__version__}", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
