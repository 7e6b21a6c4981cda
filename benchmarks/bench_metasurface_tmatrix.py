"""The T-matrix of a disc: 16 wavelengths, l and m up to 6, solved anew and then from the cache; bare and coated.

Floor: about 34,000 pairs of points a wavelength, some 27 azimuths each, two media and seven orders: 0.15 s in numba.
A coat adds a surface of as many points: up to four times the pairs.
Prediction: twice the floor with the solutions and the coarser mesh of the estimated error, 5 CPU s in all.
CPU time over two cores stands for the clock of two free cores; the clock of a shared machine is in the note.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import os
import sys
import tempfile

import numpy as np
from common import Row, parser, report, timed

import nacre
from nacre.core.machine import in_threads
from nacre.families.metasurface.tmatrix.particle_shapes import Shell, SolvedBody
from nacre.matter.indices.spec import IndexSpec

CORES = 2
GRID = np.linspace(400.0, 700.0, 16)
ORDER = 6


def body(material: str, coat_nm: float = 0.0) -> SolvedBody:
    """Return a disc of 120 x 80 nm, solved up to `ORDER`, in a coat of silica."""
    core, silica, air = (IndexSpec.model_validate(name).build() for name in (material, "SiO2", "air"))
    shell = Shell(silica, coat_nm) if coat_nm else None
    made = SolvedBody("cylinder", 60.0 + coat_nm, 80.0 + 2 * coat_nm, core, air, "benchmark", shell=shell)
    made.__dict__["lmax"] = ORDER
    return made


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=1).parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NACRE_CACHE"] = folder
        body("SiO2").azimuthal(550.0, ORDER)  # compiles
        rows = []
        bare = 0.0
        for material, coat_nm in (("Si", 0.0), ("Ag", 0.0), ("Si", 10.0)):

            def solve(material: str = material, coat_nm: float = coat_nm) -> None:
                made = body(material, coat_nm)
                in_threads(lambda w: made.azimuthal(float(w), ORDER), GRID)

            wall, cpu = timed(solve)
            again, _ = timed(solve)
            what = f"disc of {material}" + (f" in {coat_nm:g} nm of silica" if coat_nm else "")
            rows.append(Row(f"{what}, 16 wavelengths", cpu / CORES, "s", 20.0, False, f"{wall:.1f} s by the clock"))
            rows.append(Row(f"{what}, from the cache", again, "s", 1.0, False))
            if material == "Si" and not coat_nm:
                bare = cpu
            if coat_nm:
                rows.append(Row(f"{what} / bare, CPU", cpu / bare, "x"))
    return report(f"metasurface_tmatrix: nacre {nacre.__version__}", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
