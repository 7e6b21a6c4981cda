"""Read and write T-matrix files, `*.tmat.h5`, and check the particle symmetry.

Format: Asadova et al., "T-matrix representation of optical scattering response: suggestion for a data format",
arXiv:2408.10727. HDF5; T over one spectral axis, modes given by l, m and polarization in the parity or the helicity
basis, the surrounding medium by permittivity or index. Waves are orthonormal on the sphere, f = T a, time exp(-i w t);
helicity waves are (N + M)/sqrt(2) (positive) and (N - M)/sqrt(2), with N electric and M magnetic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array, ComplexArray
from nacre.core.files import atomic_path
from nacre.families.metasurface.tmatrix import axisymmetric
from nacre.matter.mie import mie_coefficients
from nacre.readers import hdf5, tmatrix
from nacre.readers.tmatrix import TMatrixFileError

if TYPE_CHECKING:
    import h5py


AXIS_TOLERANCE = 1e-3  # relative Frobenius norm for symmetry-forbidden couplings left by a mesh
TURN_TOLERANCE = 0.05  # scattered power share lost by the rotational average; the mean-field error is 0.1


def axial(blocks: ComplexArray) -> tuple[ComplexArray, float]:
    """Return the rotational average, `[wavelength, m >= 0, n, n']`, and the power share that it leaves out.

    Raises:
        TMatrixFileError: it depends too much on the rotation, is chiral, not reciprocal, or not passive.
    """
    count = blocks.shape[1]
    lmax = count // 2
    m = np.arange(count)
    own = blocks[:, m, m]  # wavelength, m, n, n'
    total = np.linalg.norm(blocks.reshape(len(blocks), -1), axis=1)
    if np.any(total == 0):
        raise TMatrixFileError("holds a T-matrix of zeros")
    # averaged over incidence, the scattered power is the squared norm
    selected = np.linalg.norm(own.reshape(len(own), -1), axis=1) / total
    turn_loss = float(np.max(np.maximum(1.0 - selected**2, 0.0)))
    if turn_loss > TURN_TOLERANCE:
        raise TMatrixFileError(
            f"is of a particle that is not axisymmetric about z: {100 * turn_loss:.2g} % of what it scatters depends "
            f"on its turn, and a mean over turns, which is what is taken, may leave out {100 * TURN_TOLERANCE:g} %; "
            'orientation = "aligned" takes it whole, of particles that all point one way'
        )
    partners = axisymmetric.mirror_signs(lmax) * own[:, ::-1]
    uneven = np.linalg.norm((own - partners).reshape(len(own), -1), axis=1) / total
    if np.max(uneven) > AXIS_TOLERANCE:
        raise TMatrixFileError(
            f"is of a handed particle, with no mirror plane through z ({100 * np.max(uneven):.2g} % of T says so); it "
            "would turn the polarisation, which is not modelled"
        )
    half = 0.5 * (own + partners)[:, lmax:]
    even = axisymmetric.reciprocal(half)
    if np.linalg.norm(half - even) > AXIS_TOLERANCE * np.linalg.norm(half):
        raise TMatrixFileError("is of a particle that is not reciprocal, or in other waves than the format's")
    _check_passive(even)
    return even, turn_loss if turn_loss > AXIS_TOLERANCE**2 else 0.0


def mean_blocks(blocks: ComplexArray) -> ComplexArray:
    """Return the blocks m >= 0 averaged over rotations and both mirror images."""
    count = blocks.shape[1]
    m = np.arange(count)
    own = blocks[:, m, m]
    return axisymmetric.reciprocal(0.5 * (own + axisymmetric.mirror_signs(count // 2) * own[:, ::-1])[:, count // 2 :])


def full_or_none(blocks: ComplexArray) -> ComplexArray | None:
    """Return the full T, `[wavelength, n, n']`, see `full_tmatrix`; None for an axisymmetric particle.

    Raises:
        TMatrixFileError: it is not reciprocal or not passive.
    """
    count = blocks.shape[1]
    m = np.arange(count)
    total = np.linalg.norm(blocks.reshape(len(blocks), -1), axis=1)
    coupled = blocks.copy()
    coupled[:, m, m] = 0.0
    if np.all(np.linalg.norm(coupled.reshape(len(blocks), -1), axis=1) <= AXIS_TOLERANCE * total):
        return None
    index = axisymmetric.multipole_index(count // 2)
    row, place, sign = index.m + count // 2, index.block, axisymmetric.condon_shortley_signs(index)
    full = blocks[:, row[:, None], row, place[:, None], place] * sign[:, None] * sign
    even = 0.5 * (full + axisymmetric.reversed_full(full))
    if np.linalg.norm(full - even) > AXIS_TOLERANCE * np.linalg.norm(even):
        raise TMatrixFileError("is of a particle that is not reciprocal, or in other waves than the format's")
    _check_passive(even)
    return np.asarray(even)


def _check_passive(matrix: ComplexArray) -> None:
    excess = axisymmetric.gain(matrix)
    if excess > tmatrix.GAIN_TOLERANCE:
        raise TMatrixFileError(
            f"describes a particle that radiates more power than it receives (by {100 * excess:.2g} %): not passive"
        )


SHAPES = ("sphere", "spheroid", "cylinder")  # axisymmetric shapes in the format
# below 0.8 of these index x wavenumber x radius (zeros of j_(l-1)) a sphere has no magnetic resonance of order l
BELOW_RESONANCE = 0.8 * np.array([3.1416, 4.4934, 5.7635])
CLEAR_SHARE = 1e-3  # fraction of the largest element of T: errors of a mesh are smaller
SMALL_SPHEROID = 0.7  # wavenumber times half axis up to which the Gans dipole tells a matrix from its conjugate
REACH, ROUNDED = "circumscribing_radius", 1e-9  # geometry dataset; relative length rounding
ELECTRIC, MAGNETIC = ("electric", "tm", "n"), ("magnetic", "te", "m")
POSITIVE, NEGATIVE = ("positive", "plus"), ("negative", "minus")


def read_tmatrices(path: str | Path, is_aligned: bool = False) -> axisymmetric.AxialTMatrices:
    """Read T-matrices for one particle; without rotational symmetry, its average over rotations about z.

    The average is T without couplings between different m: exactly the mean field scattered by randomly rotated
    particles. It omits the power in rotational fluctuations; see `AxialTMatrices.turn_loss`. Symmetry-forbidden
    couplings up to 1e-3 of the norm are removed.

    Args:
        path: file path.
        is_aligned: also store the full T for a particle without rotational symmetry, which may then be chiral.

    Raises:
        TMatrixFileError: damaged, not passive, not reciprocal, chiral, or far from axisymmetric.
    """
    try:
        with hdf5.opened(path, hdf5.PROBE, hdf5.PROBE_TIMEOUT_S) as file:
            hdf5.refuse_links(file)
            return _read(file, is_aligned)
    except hdf5.Hdf5Error as error:
        raise TMatrixFileError(str(error)) from None
    except (KeyError, ValueError, TypeError, RuntimeError, IndexError, AttributeError, UnicodeError, OSError) as error:
        raise TMatrixFileError(f"is damaged: {tmatrix.shown(str(error), 120)}") from None


def read_several(paths: Sequence[Path], is_aligned: bool = False) -> axisymmetric.AxialTMatrices:
    """Read the T-matrices of one particle from several files, each at other wavelengths.

    Raises:
        TMatrixFileError: a file is unusable, or the particles or media differ; the message names the file.
    """
    if len(paths) == 1:
        return read_tmatrices(paths[0], is_aligned)
    parts = []
    for path in paths:
        try:
            parts.append(read_tmatrices(path, is_aligned))
        except TMatrixFileError as error:
            raise TMatrixFileError(f"holds {path.name}, which {error}") from None
    first = parts[0]
    for path, part in zip(paths, parts):
        if (part.shape, part.radius_nm, part.height_nm) != (first.shape, first.radius_nm, first.height_nm):
            raise TMatrixFileError(f"holds {path.name} and {paths[0].name}, which are of different particles")
        if part.lmax != first.lmax:
            raise TMatrixFileError(f"holds {path.name} and {paths[0].name}, which end at different multipole orders")
        if (part.full is None) != (first.full is None):
            raise TMatrixFileError(f"holds {path.name} and {paths[0].name}, of which one is axisymmetric")
    wavelengths = np.concatenate([part.wavelengths_nm for part in parts])
    order = np.argsort(wavelengths)
    if np.any(np.diff(wavelengths[order]) <= 0):
        raise TMatrixFileError("gives a wavelength twice, in several files")

    def joined(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        return None if any(v is None for v in values) else np.concatenate(values)[order]

    return replace(
        first, wavelengths_nm=wavelengths[order], blocks=joined("blocks"), ambient_index=joined("ambient_index"),
        material_index=joined("material_index"), full=joined("full"), turn_loss=max(p.turn_loss for p in parts),
    )  # fmt: skip


def _read(file: h5py.File, is_aligned: bool) -> axisymmetric.AxialTMatrices:
    values = tmatrix.matrices_of(file)
    wavelengths = tmatrix.wavelengths_of(file, len(values))[0]
    index = tmatrix.embedding_index(file, len(values))
    order = np.argsort(wavelengths)
    parity = _parity_blocks(file, values[order])
    shape, geometry = _geometry(file)
    epsilon = tmatrix.material_epsilon(file, len(values))
    if epsilon is not None:
        epsilon = epsilon[order]
    full = full_or_none(parity) if is_aligned else None
    blocks, turn_loss = axial(parity) if full is None else (mean_blocks(parity), 0.0)
    if epsilon is not None:
        _check_time_sign(parity, wavelengths[order], index[order], epsilon, shape, geometry)
    name = tmatrix.shown(hdf5.attribute(file.attrs, "name"), 60)
    return axisymmetric.AxialTMatrices(
        wavelengths[order],
        blocks,
        index[order],
        name or Path(file.filename).name,
        **geometry,
        shape=shape,
        full=full,
        material_index=None if epsilon is None else np.sqrt(epsilon),
        turn_loss=turn_loss,
    )


def _check_time_sign(
    parity: ComplexArray, wavelengths_nm: Array, index: Array, epsilon: ComplexArray, shape: str, geometry: Any
) -> None:
    """Refuse conjugated matrices, of time exp(+i w t).

    Conjugation keeps passivity and extinction. It shows in a material that amplifies, in the electric dipole of a
    sphere (Mie) or of a small spheroid (Gans, with radiation: 1/T = 1/t - 1, t = i k^3 alpha / (6 pi)), and in the
    magnetic elements at m = 0: below the first resonance their imaginary part has the sign of Re(epsilon) - 1.

    Raises:
        TMatrixFileError: the matrices are nearer to the conjugate than to the expectation.
    """
    if np.any(epsilon.imag < -1e-6 * np.abs(epsilon)):
        raise TMatrixFileError(
            "states a material that amplifies, so that its time is exp(+i w t); conjugate the matrices and the "
            "permittivity: the format has exp(-i w t)"
        )
    if shape not in SHAPES or not geometry:
        return
    conjugate = TMatrixFileError(
        f"holds the conjugate of the T-matrix of its {shape}, of time exp(+i w t); conjugate the matrices: the "
        "format has exp(-i w t)"
    )
    lmax = parity.shape[1] // 2
    k = 2.0 * np.pi * index / wavelengths_nm
    relative = epsilon / index**2
    orders = np.arange(min(lmax, len(BELOW_RESONANCE)))
    magnetic = parity[:, lmax, lmax, orders, orders]  # m = 0; wavelength, l
    reach = (k * float(geometry["circumscribing_nm"]))[:, None]
    inside = np.sqrt(np.where(relative.real > 0, np.abs(relative), 0.0))[:, None]  # metals have no such resonance
    is_clear = (reach * inside < BELOW_RESONANCE[orders]) & (reach < 1.5 * (orders + 1))
    is_clear &= (np.abs(relative.real - 1.0) > np.maximum(0.5, 2.0 * np.abs(relative.imag)))[:, None]
    is_clear &= np.abs(magnetic) > CLEAR_SHARE * np.abs(parity).max(axis=(1, 2, 3, 4))[:, None]
    if np.sum(np.where(is_clear, magnetic.imag * np.sign(relative.real - 1.0)[:, None], 0.0)) < 0.0:
        raise conjugate
    if shape == "cylinder":
        return
    dipole = parity[:, lmax, lmax, lmax, lmax]  # m = 0, electric, l = 1: along the axis
    radius, half = float(geometry["radius_nm"]), 0.5 * float(geometry["height_nm"])
    if shape == "sphere":
        expected = -mie_coefficients(1, (k * radius)[None], np.sqrt(relative)[None])[0][0]
    else:
        is_small = k * max(radius, half) < SMALL_SPHEROID
        dipole, k, relative = dipole[is_small], k[is_small], relative[is_small]
        alpha = 4.0 * np.pi / 3.0 * radius**2 * half * (relative - 1.0)
        static = 1j * k**3 / (6.0 * np.pi) * alpha / (1.0 + _depolarisation(half / radius) * (relative - 1.0))
        expected = static / (1.0 - static)
    if len(dipole) and np.linalg.norm(dipole - expected.conj()) < 0.5 * np.linalg.norm(dipole - expected):
        raise conjugate


def _depolarisation(ratio: float) -> float:
    """Return the depolarisation factor along the axis of a spheroid, axis over diameter `ratio` (Bohren & Huffman)."""
    if abs(ratio - 1.0) < 1e-3:
        return 1.0 / 3.0
    if ratio > 1.0:
        e = float(np.sqrt(1.0 - ratio**-2))
        return float((1.0 - e**2) / e**2 * (np.arctanh(e) / e - 1.0))
    g = float(np.sqrt(ratio**-2 - 1.0))
    return float((1.0 + g**2) / g**3 * (g - np.arctan(g)))


def _parity_blocks(file: h5py.File, values: ComplexArray) -> ComplexArray:
    """Return T over all m from -lmax to lmax, `[wavelength, m, m', n, n']`, in the parity basis.

    Raises:
        TMatrixFileError: modes are missing or for several centres.
    """
    tmatrix.check_centre(file)
    sides = []
    for side, size in (("scattered", values.shape[1]), ("incident", values.shape[2])):
        l, m, words = tmatrix.modes_of(file, side)
        if not len(l) == len(m) == len(words) == size:
            raise TMatrixFileError(f"names {len(l)} modes for {size} {side} ones")
        sides.append((l, m, words))
    lmax = min(int(side[0].max()) for side in sides)
    if lmax > tmatrix.HIGHEST_ORDER:
        raise TMatrixFileError(f"holds multipoles up to l = {lmax}; at most {tmatrix.HIGHEST_ORDER} are read")
    if len(values) * (2 * lmax + 1) ** 2 * (2 * lmax) ** 2 * 16 > 4 * hdf5.MAX_BYTES:
        raise TMatrixFileError(f"holds multipoles up to l = {lmax} at {len(values)} wavelengths, which is too much")
    helicity = all(w in POSITIVE + NEGATIVE for w in sides[0][2])
    places = [_places(*side, lmax, helicity) for side in sides]
    rows, columns = (place[0] for place in places)
    filled_rows, filled_columns = (place[1] for place in places)
    size = (2 * lmax + 1) * 2 * lmax
    full = np.zeros((len(values), size, size), dtype=complex)
    full[:, rows[:, None], columns] = values[:, filled_rows[:, None], filled_columns]
    blocks = full.reshape(len(values), 2 * lmax + 1, 2 * lmax, 2 * lmax + 1, 2 * lmax).transpose(0, 1, 3, 2, 4)
    if helicity:
        turn = np.kron(np.array([[1.0, -1.0], [1.0, 1.0]]), np.eye(lmax)) / np.sqrt(2.0)  # (M, N) of (plus, minus)
        blocks = turn @ blocks @ turn.T
    return blocks


def _places(
    l: NDArray[np.int64], m: NDArray[np.int64], words: list[str], lmax: int, helicity: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the flat places (m, polarisation, l) for the modes up to lmax, and the selected modes.

    The first polarisation is magnetic, or positive.
    """
    first, second = (POSITIVE, NEGATIVE) if helicity else (MAGNETIC, ELECTRIC)
    odd = next((w for w in words if w not in first + second), None)
    if odd is not None:
        raise TMatrixFileError(
            f'names a polarization "{tmatrix.shown(odd)}"; it should be electric and magnetic, or positive and negative'
        )
    kind = np.array([w in second for w in words], dtype=np.int64)
    selected = np.nonzero(l <= lmax)[0]
    place = ((m + lmax) * 2 + kind) * lmax + l - 1
    if len(np.unique(place[selected])) != len(selected) or len(selected) != 2 * lmax * (lmax + 2):
        raise TMatrixFileError(f"does not name every mode up to l = {lmax} once")
    return place[selected], selected


def _geometry(file: h5py.File) -> tuple[str, dict[str, float]]:
    """Return the axisymmetric shape, or "", and radius, height and circumscribing radius in nm.

    nacre also writes the circumscribing radius, and radius and height without a shape, for rounded or coated particles.
    """
    group = hdf5.node(file, "scatterer/geometry")
    if group is None or not hasattr(group, "keys"):
        return "", {}
    shape = tmatrix.shape_of(file)

    def length(name: str) -> float | None:
        stored = hdf5.dataset(group, name)
        if stored is None:
            return None
        attributes = stored.attrs if "unit" in stored.attrs else group.attrs
        value = (
            float(np.ravel(np.asarray(stored[()], dtype=float))[0]) * tmatrix.si_unit(attributes, "length", name) * 1e9
        )
        if not 0.0 < value < 1e5:
            raise TMatrixFileError(f"gives a {name} of {value:g} nm")
        return value

    for name in ("position", "expansion_center"):
        moved = hdf5.dataset(group, name)
        if moved is not None and np.any(np.asarray(moved[()], dtype=float) != 0.0):
            return "", {}  # the expansion centre is not the particle centre
    if shape == "sphere" and (radius := length("radius")):
        return shape, {"radius_nm": radius, "height_nm": 2 * radius, "circumscribing_nm": radius}
    if shape == "spheroid" and (radius := length("radiusxy")) and (axis := length("radiusz")):
        return shape, {"radius_nm": radius, "height_nm": 2 * axis, "circumscribing_nm": max(radius, axis)}
    reach = length(REACH)
    if (shape == "cylinder" or reach) and (radius := length("radius")) and (height := length("height")):
        least, most = max(radius, height / 2), float(np.hypot(radius, height / 2))
        if reach and not least * (1 - ROUNDED) <= reach <= most * (1 + ROUNDED):
            raise TMatrixFileError(
                f"gives a {REACH} of {reach:.5g} nm, and what is {2 * radius:.5g} nm wide and {height:.5g} nm high has "
                f"one from {least:.5g} to {most:.5g} nm"
            )
        named = shape if shape == "cylinder" else ""
        return named, {"radius_nm": radius, "height_nm": height, "circumscribing_nm": reach or most}
    return "", {}


def write_tmatrices(
    path: str | Path, known: axisymmetric.AxialTMatrices, shape: str = "", method: str = "", description: str = ""
) -> None:
    """Write T-matrices in the parity basis, l ascending, m from -l to l, electric before magnetic.

    Args:
        shape: "sphere", "spheroid", "cylinder", or "".
        method: computation method.
        description: for instance the recipe.

    Raises:
        NacreError: the file cannot be written.
    """
    import h5py

    lmax = known.lmax
    l, m, tau = (
        np.array(v)
        for v in zip(*((l, m, t) for l in range(1, lmax + 1) for m in range(-l, l + 1) for t in (1, 0)), strict=True)
    )
    place = tau * lmax + l - 1
    signs = np.where((m[:, None] < 0) & (tau[:, None] != tau), -1.0, 1.0)
    if known.full is None:
        full = np.where(m[:, None] == m, known.blocks[:, np.abs(m)[:, None], place[:, None], place] * signs, 0.0)
    else:
        index = axisymmetric.multipole_index(lmax)
        file_order = np.lexsort((1 - index.tau, index.m, index.l))  # sorted by l, then m, electric before magnetic
        sign = axisymmetric.condon_shortley_signs(index)[file_order]
        full = known.full[:, file_order[:, None], file_order] * sign[:, None] * sign
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs.update(
            {
                "name": known.name,
                "description": description,
                "storage_format_version": "v1",
                "keywords": "passive, reciprocal" if known.full is not None else "czinfinity, passive, reciprocal",
            }
        )
        file.create_dataset("tmatrix", data=full, compression="gzip")
        file["vacuum_wavelength"] = known.wavelengths_nm
        file["vacuum_wavelength"].attrs["unit"] = "nm"
        file["modes/l"], file["modes/m"] = l, m
        file["modes/polarization"] = ["electric" if t else "magnetic" for t in tau]
        file["embedding/relative_permittivity"] = known.ambient_index**2
        file["embedding/relative_permeability"] = 1.0
        file["embedding"].attrs["name"] = "Custom"
        computation = file.create_group("computation")
        computation.attrs.update(
            {"method": method, "software": f"nacre={__version__}", "keywords": "semi-analytical", "name": "nacre"}
        )
        geometry = file.create_group("scatterer/geometry")
        geometry.attrs["unit"] = "nm"
        file["scatterer"].attrs["name"] = known.name
        file.create_group("scatterer/material").attrs["name"] = "Custom"
        if known.material_index is not None:
            file["scatterer/material/relative_permittivity"] = known.material_index**2
            file["scatterer/material/relative_permeability"] = 1.0
        if shape in SHAPES:
            geometry.attrs["shape"] = shape
        for name, value in _extents(shape, known).items():
            geometry[name] = value
            geometry[name].attrs["unit"] = "nm"


def _extents(shape: str, known: axisymmetric.AxialTMatrices) -> dict[str, float]:
    radius_nm, height_nm, reach_nm = known.radius_nm, known.height_nm, known.circumscribing_nm
    if radius_nm is None or height_nm is None:
        return {}
    if shape == "sphere":
        return {"radius": radius_nm}
    if shape == "spheroid":
        return {"radiusxy": radius_nm, "radiusz": height_nm / 2}
    lengths = {"radius": radius_nm, "height": height_nm}
    is_sharp = reach_nm is None or reach_nm > np.hypot(radius_nm, height_nm / 2) * (1 - ROUNDED)
    if shape == "cylinder" and is_sharp:
        return lengths
    return {} if reach_nm is None else {**lengths, REACH: reach_nm}
