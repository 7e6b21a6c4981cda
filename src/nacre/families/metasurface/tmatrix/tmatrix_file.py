"""Read and write T-matrix files, `*.tmat.h5`, and check the particle symmetry.

Format: Asadova et al., "T-matrix representation of optical scattering response: suggestion for a data format",
arXiv:2408.10727. HDF5; T over one spectral axis, modes given by l, m and polarization in the parity or the helicity
basis, the surrounding medium by permittivity or index. Waves are orthonormal on the sphere, f = T a, time exp(-i w t);
helicity waves are (N + M)/sqrt(2) (positive) and (N - M)/sqrt(2), with N electric and M magnetic.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices, gain, mirror_signs, reciprocal
from nacre.families.metasurface.tmatrix.full_tmatrix import condon_shortley_signs, multipole_index, reversed_full
from nacre.recipe.fingerprint import file_digest

if TYPE_CHECKING:
    import h5py


AXIS_TOLERANCE = 1e-3  # relative Frobenius norm for symmetry-forbidden couplings left by a mesh
TURN_TOLERANCE = 0.05  # scattered power share lost by the rotational average; the mean-field error is 0.1
GAIN_TOLERANCE = 1e-2  # largest singular value excess in a scattering matrix, 1 if passive


class TMatrixFileError(NacreError):
    """A T-matrix file cannot be used; the message ends a sentence that begins with the file."""


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
    partners = mirror_signs(lmax) * own[:, ::-1]
    uneven = np.linalg.norm((own - partners).reshape(len(own), -1), axis=1) / total
    if np.max(uneven) > AXIS_TOLERANCE:
        raise TMatrixFileError(
            f"is of a handed particle, with no mirror plane through z ({100 * np.max(uneven):.2g} % of T says so); it "
            "would turn the polarisation, which is not modelled"
        )
    half = 0.5 * (own + partners)[:, lmax:]
    even = reciprocal(half)
    if np.linalg.norm(half - even) > AXIS_TOLERANCE * np.linalg.norm(half):
        raise TMatrixFileError("is of a particle that is not reciprocal, or in other waves than the format's")
    _check_passive(even)
    return even, turn_loss if turn_loss > AXIS_TOLERANCE**2 else 0.0


def mean_blocks(blocks: ComplexArray) -> ComplexArray:
    """Return the blocks m >= 0 averaged over rotations and both mirror images."""
    count = blocks.shape[1]
    m = np.arange(count)
    own = blocks[:, m, m]
    return reciprocal(0.5 * (own + mirror_signs(count // 2) * own[:, ::-1])[:, count // 2 :])


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
    index = multipole_index(count // 2)
    row, place, sign = index.m + count // 2, index.block, condon_shortley_signs(index)
    whole = blocks[:, row[:, None], row, place[:, None], place] * sign[:, None] * sign
    even = 0.5 * (whole + reversed_full(whole))
    if np.linalg.norm(whole - even) > AXIS_TOLERANCE * np.linalg.norm(even):
        raise TMatrixFileError("is of a particle that is not reciprocal, or in other waves than the format's")
    _check_passive(even)
    return np.asarray(even)


def _check_passive(matrix: ComplexArray) -> None:
    excess = gain(matrix)
    if excess > GAIN_TOLERANCE:
        raise TMatrixFileError(
            f"is of a particle that radiates more than it gets (by {100 * excess:.2g} %): not passive"
        )


MAX_BYTES = 512 << 20  # matrix size: 100 wavelengths with l = 12
HIGHEST_ORDER = 60
SPEED_OF_LIGHT = 299792458.0
PROBE_TIMEOUT_S = 60.0
PROBE = """
import sys, h5py
def see(name, thing):
    list(thing.attrs.items())
    if isinstance(thing, h5py.Dataset) and not (thing.external or thing.is_virtual) and thing.nbytes < int(sys.argv[2]):
        thing[()]
try:
    with h5py.File(sys.argv[1], "r") as file:
        see("", file)
        file.visititems(see)
except Exception:
    pass
"""
PREFIXES = {
    "y": 1e-24, "z": 1e-21, "a": 1e-18, "f": 1e-15, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3,
    "c": 1e-2, "d": 1e-1, "": 1.0, "da": 1e1, "h": 1e2, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12, "P": 1e15, "E": 1e18,
    "Z": 1e21, "Y": 1e24,
}  # fmt: skip
UNITS = {  # format units, for messages; 1/ forms are read too
    "length": "m with an SI prefix, as nm",
    "inverse length": "m^{-1} with an SI prefix, as nm^{-1} or cm^{-1}",
    "frequency": "Hz or s^{-1} with an SI prefix, as THz or fs^{-1}",
}
SPECTRAL: Mapping[str, tuple[str, Callable[[Array], Array]]] = {  # name -> unit type, and vacuum wavelength in m
    "vacuum_wavelength": ("length", lambda x: x),
    "vacuum_wavenumber": ("inverse length", lambda x: 1.0 / x),
    "angular_vacuum_wavenumber": ("inverse length", lambda x: 2 * np.pi / x),
    "frequency": ("frequency", lambda x: SPEED_OF_LIGHT / x),
    "angular_frequency": ("frequency", lambda x: 2 * np.pi * SPEED_OF_LIGHT / x),
}
SHAPES = ("sphere", "spheroid", "cylinder")  # axisymmetric shapes in the format
REACH, ROUNDED = "circumscribing_radius", 1e-9  # geometry dataset; relative length rounding
ELECTRIC, MAGNETIC = ("electric", "tm", "n"), ("magnetic", "te", "m")
POSITIVE, NEGATIVE = ("positive", "plus"), ("negative", "minus")


def read_tmatrices(path: str | Path, is_aligned: bool = False) -> AxialTMatrices:
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
    import h5py

    try:
        plain(path)
    except OSError as error:
        raise TMatrixFileError(why_unreadable(error)) from None
    _probe_in_subprocess(os.path.abspath(path), file_digest(path))
    try:
        with h5py.File(path, "r") as file:
            return _read(file, is_aligned)
    except TMatrixFileError:
        raise
    except OSError:
        raise TMatrixFileError("is no HDF5 file that can be read") from None
    except (KeyError, ValueError, TypeError, RuntimeError, IndexError, AttributeError, UnicodeError) as error:
        raise TMatrixFileError(f"is damaged: {_shown(str(error), 120)}") from None


@lru_cache(maxsize=64)
def _probe_in_subprocess(path: str, digest: str) -> None:
    """Read a file in a subprocess first: the HDF5 library hangs or crashes on some damaged files.

    Raises:
        TMatrixFileError: it did.
    """
    try:
        # -P: do not import from the working folder
        done = subprocess.run(
            [sys.executable, "-P", "-c", PROBE, path, str(MAX_BYTES)], timeout=PROBE_TIMEOUT_S, capture_output=True
        )
    except subprocess.TimeoutExpired:
        raise TMatrixFileError(f"is damaged: HDF5 is not done with it after {PROBE_TIMEOUT_S:g} s") from None
    if done.returncode < 0:  # ended by a signal; Python errors are reported by `_read`
        raise TMatrixFileError("is damaged: HDF5 crashes on it")


def _read(file: h5py.File, is_aligned: bool) -> AxialTMatrices:
    matrix = _dataset(file, "tmatrix")
    if matrix is None:
        raise TMatrixFileError('holds no dataset "tmatrix"')
    if matrix.ndim not in (2, 3) or matrix.size == 0:
        raise TMatrixFileError(f"holds a tmatrix of shape {matrix.shape}; it should be [wavelength, mode, mode]")
    if matrix.size * 16 > MAX_BYTES:
        raise TMatrixFileError(f"holds a tmatrix of {matrix.size * 16 >> 20} MB; at most {MAX_BYTES >> 20} MB are read")
    values = _complex(matrix[()])
    values = values[None] if values.ndim == 2 else values
    if not np.all(np.isfinite(values)):
        raise TMatrixFileError("holds numbers that are not finite")
    wavelengths = _wavelengths(file)
    if len(wavelengths) != len(values):
        raise TMatrixFileError(f"holds {len(values)} matrices for {len(wavelengths)} wavelengths")
    index = _ambient(file, len(values))
    order = np.argsort(wavelengths)
    if np.any(np.diff(wavelengths[order]) <= 0):
        raise TMatrixFileError("gives a wavelength twice")
    parity = _parity_blocks(file, values[order])
    whole = full_or_none(parity) if is_aligned else None
    blocks, turn_loss = axial(parity) if whole is None else (mean_blocks(parity), 0.0)
    shape, geometry = _geometry(file)
    name = file.attrs.get("name", "")
    name = _shown(name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name), 60)
    return AxialTMatrices(
        wavelengths[order],
        blocks,
        index[order],
        name or Path(file.filename).name,
        **geometry,
        shape=shape,
        whole=whole,
        material_index=_material(file, len(values), order),
        turn_loss=turn_loss,
    )


def _dataset(file: h5py.Group, name: str) -> Any:
    """Return a dataset in the file itself, or None; refuse links to other files."""
    import h5py

    where: Any = file
    for part in name.split("/"):
        if not isinstance(where, h5py.Group) or part not in where.keys():
            return None
        if isinstance(where.get(part, getlink=True), h5py.ExternalLink):
            raise TMatrixFileError(f'leads to another file at "{name}"')
        where = where[part]
    if not isinstance(where, h5py.Dataset):
        return None
    if where.external or where.is_virtual:
        raise TMatrixFileError(f'keeps "{name}" in another file')
    return where


def _shown(text: str, most: int = 20) -> str:
    """Return printable file text on one line."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:most]


def _complex(values: Any) -> ComplexArray:
    """Return complex numbers, also from two fields."""
    found = np.asarray(values)
    if found.dtype.names is not None and len(found.dtype.names) == 2:
        real, imaginary = found.dtype.names
        return np.asarray(found[real] + 1j * found[imaginary], dtype=complex)
    return np.asarray(found, dtype=complex)


def _unit(attributes: Any, kind: str, name: str) -> float:
    """Return a unit in SI."""
    given = attributes.get("unit")
    if given is None:
        raise TMatrixFileError(f"gives {name} without a unit")
    given = given.decode("utf-8", "replace") if isinstance(given, bytes) else str(np.ravel(given)[0])
    text, sign = given.strip(), 1.0
    if name.startswith("angular") and text.startswith("rad"):  # some files write the dimensionless rad
        text = text.removeprefix("rad").strip(" *·")
        text = f"1{text}" if text.startswith("/") else text
    if text.startswith("1/"):
        text, sign = text[2:], -1.0
    for ending in ("^{-1}", "^-1", "-1", "⁻¹"):
        if text.endswith(ending) and sign > 0:
            text, sign = text.removesuffix(ending), -1.0
    symbol, power = {"length": ("m", 1.0), "inverse length": ("m", -1.0), "frequency": ("s", -1.0)}[kind]
    if kind == "frequency" and text.endswith("Hz") and sign > 0:
        prefix, power = text.removesuffix("Hz"), 1.0
    elif text.endswith(symbol) and sign == power:
        prefix = text.removesuffix(symbol)
    else:
        prefix = "?"
    if prefix not in PREFIXES:
        raise TMatrixFileError(
            f'gives {name} in "{_shown(given)}", which is no unit of {kind} in this format; it should be {UNITS[kind]}'
        )
    return float(PREFIXES[prefix] ** power)


def _wavelengths(file: h5py.File) -> Array:
    named = [name for name in SPECTRAL if name in file.keys()]
    if len(named) != 1:
        raise TMatrixFileError(
            f"gives {' and '.join(named) or 'no wavelength'}; it should give one of {', '.join(SPECTRAL)}"
        )
    dataset = _dataset(file, named[0])
    kind, to_wavelength = SPECTRAL[named[0]]
    values = np.atleast_1d(np.asarray(dataset[()], dtype=float)).ravel() * _unit(dataset.attrs, kind, named[0])
    if not np.all(np.isfinite(values) & (values > 0)):
        raise TMatrixFileError(f"gives a {named[0]} that is not above 0")
    return np.asarray(to_wavelength(values) * 1e9)


def _ambient(file: h5py.File, count: int) -> Array:
    """Return the embedding index, `[wavelength]`."""

    def number(name: str, default: float | None) -> ComplexArray | None:
        found = _dataset(file, f"embedding/{name}")
        if found is None:
            return None if default is None else np.full(count, default, dtype=complex)
        return np.asarray(np.broadcast_to(_complex(found[()]).ravel(), (count,)))

    mu, chirality = number("relative_permeability", 1.0), number("chirality", 0.0)
    assert mu is not None and chirality is not None  # both have a default
    epsilon = number("relative_permittivity", None)
    if epsilon is None:
        index = number("refractive_index", 1.0)
    else:
        index = np.sqrt(epsilon)
    assert index is not None
    if np.any(np.abs(mu - 1) > 1e-9) or np.any(np.abs(chirality) > 1e-9):
        raise TMatrixFileError("has a magnetic or chiral medium around the particle")
    if not np.all(np.isfinite(index)) or np.any(np.abs(index.imag) > 1e-9) or np.any(index.real <= 0):
        raise TMatrixFileError("has an absorbing medium around the particle")
    return np.asarray(index.real, dtype=np.float64)


def _modes(file: h5py.File, side: str) -> tuple[NDArray[np.int64], NDArray[np.int64], list[str]]:
    found = []
    for name in ("l", "m", "polarization"):
        dataset = _dataset(file, f"modes/{name}_{side}")
        dataset = _dataset(file, f"modes/{name}") if dataset is None else dataset
        if dataset is None:
            raise TMatrixFileError(f'does not name its modes: "modes/{name}" is missing')
        if dataset.size > 10 * HIGHEST_ORDER**2:
            raise TMatrixFileError(f"names {dataset.size} modes")
        found.append(np.asarray(dataset[()]).ravel())
    l, m = (np.asarray(v, dtype=float) for v in found[:2])
    if np.any(l != np.round(l)) or np.any(m != np.round(m)) or np.any(l < 1) or np.any(np.abs(m) > l):
        raise TMatrixFileError("names modes that are none: it should be l >= 1 and |m| <= l, whole")
    words = [w.decode("utf-8", "replace") if isinstance(w, bytes) else str(w) for w in found[2]]
    return l.astype(np.int64), m.astype(np.int64), [w.strip().lower() for w in words]


def _parity_blocks(file: h5py.File, values: ComplexArray) -> ComplexArray:
    """Return T over all m from -lmax to lmax, `[wavelength, m, m', n, n']`, in the parity basis.

    Raises:
        TMatrixFileError: modes are missing or for several centres.
    """
    for name in ("position_index", "index"):
        several = _dataset(file, f"modes/{name}")
        if several is not None and np.ptp(np.asarray(several[()])) != 0:
            raise TMatrixFileError("is about several centres; one particle has one")
    sides = []
    for side, size in (("scattered", values.shape[1]), ("incident", values.shape[2])):
        l, m, words = _modes(file, side)
        if not len(l) == len(m) == len(words) == size:
            raise TMatrixFileError(f"names {len(l)} modes for {size} {side} ones")
        sides.append((l, m, words))
    lmax = min(int(side[0].max()) for side in sides)
    if lmax > HIGHEST_ORDER:
        raise TMatrixFileError(f"holds multipoles up to l = {lmax}; at most {HIGHEST_ORDER} are read")
    if len(values) * (2 * lmax + 1) ** 2 * (2 * lmax) ** 2 * 16 > 4 * MAX_BYTES:
        raise TMatrixFileError(f"holds multipoles up to l = {lmax} at {len(values)} wavelengths, which is too much")
    helicity = all(w in POSITIVE + NEGATIVE for w in sides[0][2])
    places = [_places(*side, lmax, helicity) for side in sides]
    rows, columns = (place[0] for place in places)
    kept_rows, kept_columns = (place[1] for place in places)
    size = (2 * lmax + 1) * 2 * lmax
    whole = np.zeros((len(values), size, size), dtype=complex)
    whole[:, rows[:, None], columns] = values[:, kept_rows[:, None], kept_columns]
    blocks = whole.reshape(len(values), 2 * lmax + 1, 2 * lmax, 2 * lmax + 1, 2 * lmax).transpose(0, 1, 3, 2, 4)
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
            f'names a polarization "{_shown(odd)}"; it should be electric and magnetic, or positive and negative'
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
    import h5py

    group = file.get("scatterer/geometry")
    if not isinstance(group, h5py.Group):
        return "", {}
    shape = group.attrs.get("shape", "")
    shape = shape.decode("utf-8", "replace") if isinstance(shape, bytes) else str(shape)

    def length(name: str) -> float | None:
        dataset = _dataset(group, name)
        if dataset is None:
            return None
        attributes = dataset.attrs if "unit" in dataset.attrs else group.attrs
        value = float(np.ravel(np.asarray(dataset[()], dtype=float))[0]) * _unit(attributes, "length", name) * 1e9
        if not 0.0 < value < 1e5:
            raise TMatrixFileError(f"gives a {name} of {value:g} nm")
        return value

    for name in ("position", "expansion_center"):
        moved = _dataset(group, name)
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


def _material(file: h5py.File, count: int, order: NDArray[np.intp]) -> ComplexArray | None:
    """Return the particle index, `[wavelength]`, if the file states it."""
    epsilon, index = (_dataset(file, f"scatterer/material/{n}") for n in ("relative_permittivity", "refractive_index"))
    if epsilon is None and index is None:
        return None
    values = np.sqrt(_complex(epsilon[()]).ravel()) if epsilon is not None else _complex(index[()]).ravel()
    if len(values) not in (1, count) or not np.all(np.isfinite(values)):
        return None
    return np.asarray(np.broadcast_to(values, (count,))[order])


def write_tmatrices(
    path: str | Path, known: AxialTMatrices, shape: str = "", method: str = "", description: str = ""
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
    if known.whole is None:
        whole = np.where(m[:, None] == m, known.blocks[:, np.abs(m)[:, None], place[:, None], place] * signs, 0.0)
    else:
        index = multipole_index(lmax)
        ours = np.lexsort((1 - index.tau, index.m, index.l))  # sorted by l, then m, electric before magnetic
        sign = condon_shortley_signs(index)[ours]
        whole = known.whole[:, ours[:, None], ours] * sign[:, None] * sign
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs.update(
            {
                "name": known.name,
                "description": description,
                "storage_format_version": "v1",
                "keywords": "passive, reciprocal" if known.whole is not None else "czinfinity, passive, reciprocal",
            }
        )
        file.create_dataset("tmatrix", data=whole, compression="gzip")
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


def _extents(shape: str, known: AxialTMatrices) -> dict[str, float]:
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
