"""Metasurfaces: the harmonic table, the whole material, its file, and random look-ups.

Floor: the table's product u M v is 0.17 GFlop a wavelength at lmax 15, 8 GFlop in all, about 1 s on one core here.
Prediction (before the first run): table 2 s, material 10 s, file 0.3 s, 3e7 look-ups a second.
The peer SMUTHI is not installed: on these machines it took 0.3-0.75 s per (wavelength, angle, polarisation) at its
inaccurate default, 2-4 s at an accurate one; the table is 47 x 180 x 2 of those. The ratio is by these figures.
CPU time over two cores stands for the clock of two free cores; the clock of a shared machine is in the note.
The materials of 16 wavelengths are by the mean field, on an opaque stack and on glass, whose light is of both sides.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
from common import Row, interleaved, parser, report, timed

import nacre
from nacre.bsdf import Bsdf
from nacre.core.machine import single_threaded_blas
from nacre.families.metasurface.tmatrix.particle_on_stack import ParticleOnStack
from nacre.material.material import load, material
from nacre.matter.mie import mie_coefficients

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "metasurface" / "silver_on_oxide.toml"
CORES = 2
FEW = np.linspace(400.0, 700.0, 16)
ON_GLASS = {
    "family": "metasurface",
    "substrate": "glass",
    "particle": {"material": "Ag", "radius_nm": 90},
    "monolayer": {"coverage": 0.1},
    "model": {"correction": "qca-balanced", "tolerance": 0.01},
}
SMUTHI_SECONDS = 0.3  # the fastest of its figures


def harmonic_table(made: object, wavelengths_nm: np.ndarray) -> float:
    """Compute F's harmonics for 180 x 180 angles and 4 polarisation pairs at lmax 15; return their norm."""
    cosines = np.cos(np.radians(np.arange(180) * 0.5))
    total = 0.0
    for wavelength in wavelengths_nm:
        surface = made.surface(wavelength)  # type: ignore[attr-defined]  # a Metasurface
        n = complex(made.core.n_complex(np.array([wavelength]))[0])  # type: ignore[attr-defined]
        a, b = mie_coefficients(15, [surface.wavenumber * 90.0], [n])
        sphere = ParticleOnStack(surface, 90.0, np.concatenate([-b, -a]))
        directions = sphere.directions(cosines)
        total += float(np.abs(sphere.harmonics(directions, directions)[0, 0, 0, 0, 0]))
    return total


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=3).parse_args(arguments)
    os.environ["NACRE_CACHE"] = "off"
    wavelengths = np.linspace(360.0, 830.0, 47)
    example = load(EXAMPLE).model
    bsdf = load(EXAMPLE).bsdf(wavelengths)
    lobe = bsdf.lobes[1]
    rng = np.random.default_rng(0)
    wi, wo = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in np.abs(rng.normal(size=(2, 20_000, 3))))

    def alone() -> float:
        with single_threaded_blas():  # as the product calls it: BLAS spins beside other work
            return harmonic_table(example, wavelengths)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.nacre"
        bsdf.save(path)
        times = interleaved(
            {
                "table": lambda: timed(alone),
                "material": lambda: timed(lambda: load(EXAMPLE).bsdf(wavelengths)),
                "few opaque": lambda: timed(lambda: load(EXAMPLE).bsdf(FEW)),
                "few on glass": lambda: timed(lambda: material(ON_GLASS).bsdf(FEW)),
                "file": lambda: timed(lambda: Bsdf.load(path)),
                "look-ups": lambda: timed(lambda: lobe.evaluate(wi, wo)),
            },
            options.repeats,
        )
    size = sum(getattr(lobe, n).nbytes for n in ("above", "below", "across")) / 1e6

    def row(claim: str, name: str, bar: float, cores: int = CORES) -> Row:
        spent = times[name]
        return Row(claim, spent.median_cpu / cores, "s", bar, False, f"{spent.median_wall:.2f} s by the clock")

    table = times["table"].median_cpu
    rows = [
        row("harmonic table 47 x 180 x 180 x 4, lmax 15", "table", 5.0, 1),
        row("whole material at 47 wavelengths", "material", 30.0),
        row("mean-field material of 16 wavelengths, silver on oxide on silicon, CPU", "few opaque", 1.0, 1),
        row("mean-field material of 16 wavelengths, silver on glass, CPU", "few on glass", 1.0, 1),
        row("material from its file", "file", 1.0, 1),
        Row("memory of its tables", size, "MB", 100.0, False),
        Row("random look-ups", len(wi) * len(wavelengths) / times["look-ups"].median_cpu, "values/s", 1e6),
        Row("table against SMUTHI's own figures", 47 * 180 * 2 * SMUTHI_SECONDS / table, "x", 1000.0),
    ]
    return report(f"metasurface_tables: nacre {nacre.__version__}", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
