"""Write the T-matrix file of the example of aligned particles: silver spheroids that lie in a polymer film.

    python tools/lying_rods.py examples/metasurface/silver_rods.tmat.h5

The body of revolution is solved upright, as every spheroid is, and its T-matrix turned until its axis lies along x.
"""

from __future__ import annotations

import sys

import numpy as np

from nacre.families.metasurface.tmatrix.axisymmetric import (
    AxialTMatrices,
    condon_shortley_signs,
    full_order,
    multipole_index,
    spread_blocks,
    truncated,
)
from nacre.families.metasurface.tmatrix.particle_shapes import SolvedBody
from nacre.families.metasurface.tmatrix.tmatrix_file import write_tmatrices
from nacre.matter.indices.spec import IndexSpec

LENGTH_NM, WIDTH_NM, FILM_INDEX = 110.0, 50.0, 1.5
WAVELENGTHS_NM, ORDER = np.arange(360.0, 831.0, 10.0), 4
KEPT = 2.0**-30  # of the largest number: the rest, far below the error of a mesh, would not compress


def tilted_full(matrix: np.ndarray, tilt_rad: float) -> np.ndarray:
    """Return T, `[..., n, n']`, for the particle rotated about y, from z towards x.

    Multipoles with one l and tau mix by d = exp(-i tilt J_y), in Condon-Shortley phases; J_y has
    (m + 1, m) = sqrt(l (l + 1) - m (m + 1)) / 2i.
    """
    index = multipole_index(full_order(matrix))
    turn = np.zeros((len(index.m), len(index.m)))
    for l in range(1, index.order + 1):
        m = np.arange(-l, l)
        raised = np.diag(np.sqrt(l * (l + 1.0) - m * (m + 1)), -1) / 2.0
        values, vectors = np.linalg.eigh((raised - raised.T) / 1j)
        d = ((vectors * np.exp(-1j * tilt_rad * values)) @ vectors.conj().T).real
        for tau in range(2):
            rows = np.nonzero((index.l == l) & (index.tau == tau))[0]  # ascending m
            turn[rows[:, None], rows] = d
    sign = condon_shortley_signs(index)
    turn *= sign[:, None] * sign
    return np.asarray(turn @ matrix @ turn.T)


def lying_spheroid(length_nm: float, width_nm: float, material: str, around: float, wavelengths_nm: np.ndarray,
                   order: int) -> AxialTMatrices:  # fmt: skip
    """Return the T-matrices of a prolate spheroid whose long axis is x, in a medium of a constant index."""
    core, medium = (IndexSpec.model_validate(spec).build() for spec in (material, {"n": around}))
    upright = SolvedBody("spheroid", width_nm / 2, length_nm, core, medium, "lying rod").exported_t_matrices(
        wavelengths_nm
    )
    kept = np.stack([truncated(blocks, order) for blocks in upright.blocks])
    whole = np.stack([tilted_full(spread_blocks(blocks, multipole_index(order)), np.pi / 2) for blocks in kept])
    step = KEPT * np.abs(whole).max()
    whole = np.round(whole / step) * step
    name = f"lying spheroid of {material}, {length_nm:g} x {width_nm:g} nm"
    return AxialTMatrices(
        wavelengths_nm, kept, upright.ambient_index, name, length_nm / 2, width_nm, length_nm / 2,
        upright.material_index, full=whole,
    )  # fmt: skip


def main(path: str) -> None:
    """Write the file."""
    known = lying_spheroid(LENGTH_NM, WIDTH_NM, "Ag", FILM_INDEX, WAVELENGTHS_NM, ORDER)
    write_tmatrices(path, known, "", SolvedBody.method, f"{known.name}, its axis along x, in n = {FILM_INDEX:g}")


if __name__ == "__main__":
    main(sys.argv[1])
