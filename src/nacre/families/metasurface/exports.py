"""Files that only a metasurface writes: the T-matrix of its particle."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.errors import UnsupportedError
from nacre.families.metasurface.axial import AxialTMatrices, as_blocks
from nacre.families.metasurface.material import Metasurface
from nacre.families.metasurface.tmatrix_file import MAX_BYTES, write_tmatrices

HIGHEST_EXPORTED = 15  # beyond, a file of 48 wavelengths has 500 MB before it is compressed


def particle_t_matrices(material: Metasurface) -> AxialTMatrices:
    """Return the T-matrices of one particle at the material's wavelengths, of spheres with a spread the mean one.

    Spheres get the multipoles that they need over their stack, at most 15; of a file what it holds.

    Raises:
        ConvergenceRefusal, MaterialRangeError: see `Metasurface.monolayer`.
    """
    if material.body is not None:
        return material.body.all_known(material.wavelengths_nm)
    surfaces = [material.surface(w) for w in material.wavelengths_nm]
    lmax = min(max(material.order(s) for s in surfaces), HIGHEST_EXPORTED)
    radius = float(np.dot(material.sizes.radii_nm, material.sizes.shares))
    assert material.core is not None  # of spheres it is known
    blocks = np.stack([as_blocks(material.t_matrix(lmax, s, radius)) for s in surfaces])
    outer = material.outer_radius_nm
    index = None if material.shell is not None else material.core.n_complex(material.wavelengths_nm)
    ambient = np.array([s.inner_index for s in surfaces])
    name = f"sphere of {material.core.name}, radius {outer:g} nm"
    return AxialTMatrices(material.wavelengths_nm, blocks, ambient, name, outer, 2 * outer, outer, index)


def write_particle(material: Metasurface, path: Path, description: str) -> list[str]:
    """Write the particle's T-matrices as `*.tmat.h5`; return in words what of the material is not in the file.

    Raises:
        UnsupportedError: they are too large.
        NacreError: the file cannot be written.
    """
    known = particle_t_matrices(material)
    size = len(known.wavelengths_nm) * (2 * known.lmax * (known.lmax + 2)) ** 2 * 16
    if size > MAX_BYTES:
        raise UnsupportedError(f"{path}: the T-matrices would take {size >> 20} MB; fewer multipoles are needed")
    shape = "sphere" if material.body is None else material.body.shape
    method = "Mie" if material.body is None else material.body.method
    if material.shell is not None:
        shape = ""  # the format's shapes are of one material
    error = None if material.body is None else material.body.stated_error
    if error is not None:
        method += f", estimated relative error {error:.1g}"
    write_tmatrices(path, known, shape, method, description)
    lost = ["the stack, the density and the order: a T-matrix is of one particle alone"]
    if len(material.sizes.radii_nm) > 1:
        lost.append("the spread of sizes: the mean one was taken")
    if material.second is not None:
        lost.append("the second kind of the mixture: the first was taken")
    return lost
