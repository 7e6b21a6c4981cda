"""Write the T-matrix file of the tests of aligned particles: two unlike spheres side by side, solved by treams.

    python tools/dimer_t_matrix.py tests/metasurface/dimer.tmat.h5

treams couples the spheres and expands what both send out about their middle; both lie along x.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np

from nacre.families.metasurface.tmatrix.tmatrix_file import read_tmatrices, write_tmatrices

RADII_NM, APART_NM, INDEX = (50.0, 38.0), 100.0, 4.0 + 0.05j  # the larger one lies at -x
WAVELENGTHS_NM, ORDER = (500.0, 600.0), 5
NOISE = 1e-12  # of the largest number: what symmetry forbids and rounding left


def main(path: str) -> None:
    """Write the file."""
    import h5py
    import treams
    import treams.io

    solved = []
    for wavelength in WAVELENGTHS_NM:
        materials = [treams.Material(INDEX**2), treams.Material()]
        pair = [treams.TMatrix.sphere(ORDER + 5, 2 * np.pi / wavelength, r, materials) for r in RADII_NM]
        places = np.array([[-APART_NM / 2, 0.0, 0.0], [APART_NM / 2, 0.0, 0.0]])
        both = treams.TMatrix.cluster(pair, places).interaction.solve()
        solved.append(both.expand(treams.SphericalWaveBasis.default(ORDER)).changepoltype("parity"))
    with tempfile.TemporaryDirectory() as folder:
        theirs = Path(folder) / "theirs.tmat.h5"
        with h5py.File(theirs, "w") as file:
            treams.io.save_hdf5(
                file, solved, name="two unlike spheres side by side along x", scatterers={}, lunit="nm",
                computation={"keywords": "semi-analytical"},
            )  # fmt: skip
        known = read_tmatrices(theirs, is_aligned=True)
    assert known.full is not None  # of what is not axisymmetric
    size = np.abs(known.full)
    known = dataclasses.replace(known, full=np.where(size > NOISE * size.max(), known.full, 0.0))
    note = f"radii {RADII_NM[0]:g} and {RADII_NM[1]:g} nm, n = {INDEX}, centres {APART_NM:g} nm apart, in vacuum"
    write_tmatrices(path, known, "", "treams: two coupled spheres, expanded about their middle", note)


if __name__ == "__main__":
    main(sys.argv[1])
