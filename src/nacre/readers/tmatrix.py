"""T-matrix files, `*.tmat.h5`: contents in the units of nacre, without the physics of particles.

Format: Asadova et al., arXiv:2408.10727, as Python, R, MATLAB and Julia write it, JCMsuite and COMSOL scripts too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.readers.hdf5 import HDF5_MAGIC, MAX_BYTES, Hdf5Error, attribute, dataset, opened, refuse_links, text_of
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead

if TYPE_CHECKING:
    import h5py

HIGHEST_ORDER = 60
SPEED_OF_LIGHT = 299792458.0
GAIN_TOLERANCE = 1e-2  # largest singular value excess in a scattering matrix, 1 if passive
SAME_INDEX = 1e-4  # relative difference of two statements of the embedding's index
WAVELENGTHS_NM = (1.0, 1e8)  # X rays to 10 cm: particles of this format
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
MODE_NAMES = ("l", "m", "polarization")


class TMatrixFileError(NacreError):
    """A T-matrix file cannot be used; the message ends a sentence that begins with the file."""


def shown(text: str, most: int = 20) -> str:
    """Return printable file text on one line."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:most]


def complex_of(values: Any) -> ComplexArray:
    """Return complex numbers, also from two fields."""
    array = np.asarray(values)
    if array.dtype.names is not None and len(array.dtype.names) == 2:
        real, imaginary = array.dtype.names
        array = array[real] + 1j * array[imaginary]
    return np.asarray(array, dtype=complex)


def si_unit(attributes: Any, kind: str, name: str) -> float:
    """Return a unit in SI."""
    stated = attribute(attributes, "unit", "units", "Unit")
    if not stated.strip():
        raise TMatrixFileError(f"gives {name} without a unit")
    text, sign = stated.strip(), 1.0
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
            f'gives {name} in "{shown(stated)}", which is not a unit of {kind} there; it should be {UNITS[kind]}'
        )
    return float(PREFIXES[prefix] ** power)


def matrices_of(file: h5py.File) -> ComplexArray:
    """Return T, `[wavelength, scattered, incident]`.

    Raises:
        TMatrixFileError: the matrix is missing, too large or not finite.
    """
    matrix = dataset(file, "tmatrix")
    if matrix is None:
        what = "; it holds far fields" if "Far-Field" in file.keys() or "Near-Field" in file.keys() else ""
        raise TMatrixFileError(f'holds no dataset "tmatrix"{what}')
    if matrix.ndim not in (2, 3) or matrix.size == 0:
        raise TMatrixFileError(f"holds a tmatrix of shape {matrix.shape}; it should be [wavelength, mode, mode]")
    if matrix.size * 16 > MAX_BYTES:
        raise TMatrixFileError(f"holds a tmatrix of {matrix.size * 16 >> 20} MB; at most {MAX_BYTES >> 20} MB are read")
    values = complex_of(matrix[()])
    values = values[None] if values.ndim == 2 else values
    if not np.all(np.isfinite(values)):
        raise TMatrixFileError("holds numbers that are not finite")
    return values


def wavelengths_of(file: h5py.File, count: int) -> tuple[Array, str, str]:
    """Return vacuum wavelengths in nm, in the file's order, the name of its axis and its unit.

    Raises:
        TMatrixFileError: none, several, no unit, another number than of matrices, or values that no light has.
    """
    names = [name for name in SPECTRAL if name in file.keys()]
    if len(names) != 1:
        raise TMatrixFileError(
            f"gives {' and '.join(names) or 'no wavelength'}; it should give one of {', '.join(SPECTRAL)}"
        )
    (name,) = names
    stored = dataset(file, name)
    if stored is None:
        raise TMatrixFileError(f"gives no numbers of {name}")
    kind, to_wavelength = SPECTRAL[name]
    raw = np.atleast_1d(np.asarray(stored[()], dtype=float)).ravel()
    unit = attribute(stored.attrs, "unit", "units", "Unit").strip()
    values = raw * si_unit(stored.attrs, kind, name)
    if not np.all(np.isfinite(values) & (values > 0)):
        raise TMatrixFileError(f"gives a {name} that is not above 0")
    wavelengths = np.round(to_wavelength(values) * 1e9, 9)  # rounded, so that 500 nm given in metres is exactly 500
    if not np.all((wavelengths > WAVELENGTHS_NM[0]) & (wavelengths < WAVELENGTHS_NM[1])):
        likely = "; are these nm?" if kind == "length" and 100.0 < raw.min() and raw.max() < 1e5 else ""
        raise TMatrixFileError(f"gives a {name} of {raw[0]:.6g} {shown(unit)}{likely}")
    if len(wavelengths) != count:
        raise TMatrixFileError(f"holds {count} matrices for {len(wavelengths)} wavelengths")
    if len(np.unique(wavelengths)) != count:
        raise TMatrixFileError("gives a wavelength twice")
    return wavelengths, name, unit


def embedding_index(file: h5py.File, count: int) -> Array:
    """Return the embedding's index, `[wavelength]`.

    Raises:
        TMatrixFileError: absorbing, magnetic, chiral, or stated twice with different values.
    """

    def number(name: str) -> ComplexArray | None:
        stored = dataset(file, f"embedding/{name}")
        if stored is None:
            return None
        return np.asarray(np.broadcast_to(complex_of(stored[()]).ravel(), (count,)))

    for name, plain in (("relative_permeability", 1.0), ("chirality", 0.0), ("chirality_parameter", 0.0)):
        value = number(name)
        if value is not None and np.any(np.abs(value - plain) > 1e-9):
            raise TMatrixFileError("has a magnetic or chiral medium around the particle")
    epsilon, stated = number("relative_permittivity"), number("refractive_index")
    index = np.sqrt(epsilon) if epsilon is not None else stated
    if index is None:
        raise TMatrixFileError("does not state the medium around the particle, embedding/relative_permittivity")
    if not np.all(np.isfinite(index)) or np.any(np.abs(index.imag) > 1e-9) or np.any(index.real <= 0):
        raise TMatrixFileError("has an absorbing medium around the particle")
    if epsilon is not None and stated is not None and np.any(np.abs(index - stated) > SAME_INDEX * np.abs(index)):
        raise TMatrixFileError(
            f"states an embedding of permittivity {epsilon[0].real:.5g} and of index {stated[0].real:.5g}, which "
            "contradict each other"
        )
    return np.asarray(index.real, dtype=np.float64)


def modes_of(file: h5py.File, side: str) -> tuple[NDArray[np.int64], NDArray[np.int64], list[str]]:
    """Return l, m and polarisation of the modes of a side, "scattered" or "incident".

    Raises:
        TMatrixFileError: a name is missing, or no multipoles.
    """
    columns = []
    for name in MODE_NAMES:
        values = dataset(file, f"modes/{name}_{side}")
        values = dataset(file, f"modes/{name}") if values is None else values
        if values is None:
            raise TMatrixFileError(f'does not name its modes: "modes/{name}" is missing')
        if values.size > 20 * HIGHEST_ORDER**2 * 16:
            raise TMatrixFileError(f"names {values.size} modes")
        columns.append(np.asarray(values[()]))
    l, m = (np.asarray(v, dtype=float).ravel() for v in columns[:2])
    if np.any(l != np.round(l)) or np.any(m != np.round(m)) or np.any(l < 1) or np.any(np.abs(m) > l):
        raise TMatrixFileError("names modes that do not exist; allowed: whole numbers l >= 1 and |m| <= l")
    words = [text_of(w).strip().lower() for w in _rows_of_text(columns[2], len(l))]
    return l.astype(np.int64), m.astype(np.int64), words


def _rows_of_text(values: NDArray[Any], count: int) -> list[Any]:
    """Return one text per mode; MATLAB stores characters or their codes in two dimensions, in either order."""
    if values.ndim == 2 and 1 not in values.shape:
        return list(values if values.shape[0] == count else values.T)
    return list(values.ravel())


def check_centre(file: h5py.File) -> None:
    """Refuse expansions about several centres, or about a point other than the particle's centre.

    Raises:
        TMatrixFileError: the file contains such an expansion.
    """
    for name in ("position_index", "index"):
        several = dataset(file, f"modes/{name}")
        if several is not None and np.ptp(np.asarray(several[()])) != 0:
            raise TMatrixFileError("is about several centres; one particle has one")
    for name in ("positions", "position"):
        places = dataset(file, f"modes/{name}")
        if places is None:
            continue
        values = np.asarray(places[()], dtype=float).reshape(-1, 3)
        if len(values) > 1:
            raise TMatrixFileError("is about several centres; one particle has one")
        if np.any(values != 0.0):
            unit = shown(attribute(places.attrs, "unit"))
            centre = f"({', '.join(f'{v:.4g}' for v in values[0])}) {unit}".strip()
            raise TMatrixFileError(
                f"expands its waves about {centre}; expand them about the particle's centre, (0, 0, 0)"
            )


def material_epsilon(file: h5py.File, count: int) -> ComplexArray | None:
    """Return the particle's permittivity, `[wavelength]` in the file's order, if the file states one for all."""
    epsilon, index = (dataset(file, f"scatterer/material/{n}") for n in ("relative_permittivity", "refractive_index"))
    if epsilon is None and index is None:
        return None
    values = complex_of(epsilon[()]).ravel() if epsilon is not None else complex_of(index[()]).ravel() ** 2
    if len(values) not in (1, count) or not np.all(np.isfinite(values)):
        return None
    return np.asarray(np.broadcast_to(values, (count,)))


def shape_of(file: h5py.File) -> str:
    """Return the shape's name: an attribute of scatterer/geometry, or a text beside it."""
    stated = dataset(file, "scatterer/geometry/shape")
    group = file.get("scatterer/geometry")
    named = "" if group is None else attribute(group.attrs, "shape")
    return (named or ("" if stated is None else text_of(stated[()]))).strip().lower()


def sniff(head: FileHead) -> float:
    """Return 1 for HDF5 with a dataset tmatrix, a fair confidence for far fields of TERMS beside such files."""
    if not head.data.startswith(HDF5_MAGIC):
        return 0.0
    if b"tmatrix" in head.data and b"modes" in head.data:
        return CERTAIN
    name = head.path.name.lower()
    return LIKELY if b"Far-Field" in head.data or ".tmat" in name else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read T over the wavelength: `tmatrix` `[wavelength, scattered, incident]` as in the file, and mean extinction.

    Raises:
        NacreError: not readable, or not passive.
    """
    try:
        with opened(path) as file:
            refuse_links(file)
            values = matrices_of(file)
            wavelengths, axis, unit = wavelengths_of(file, len(values))
            index = embedding_index(file, len(values))
            sides = [modes_of(file, side) for side in ("scattered", "incident")]
            for (l, _, _), size in zip(sides, values.shape[1:]):
                if len(l) != size:
                    raise TMatrixFileError(f"names {len(l)} modes for {size}")
            check_centre(file)
            shape = shape_of(file)
            name = shown(attribute(file.attrs, "name"), 60)
            computed = (
                shown(attribute(file["computation"].attrs, "software", "method"), 80) if "computation" in file else ""
            )
    except (TMatrixFileError, Hdf5Error) as error:
        raise NacreError(f"{path}: {error}") from None
    except RuntimeError as error:  # from the HDF5 library
        raise NacreError(f"{path}: is damaged: {shown(str(error), 120)}") from None
    size = min(values.shape[1:])
    if values.shape[1] == values.shape[2]:
        excess = max(float(np.linalg.norm(np.eye(size) + 2.0 * t, 2)) for t in values) - 1.0
        if excess > GAIN_TOLERANCE:
            raise NacreError(
                f"{path}: its particle radiates more than it receives (by {100 * excess:.2g} %): not passive"
            )
    order = np.argsort(wavelengths)
    k = 2.0 * np.pi * index[order] / wavelengths[order]
    extinction = -2.0 * np.pi / k**2 * np.trace(values[order], axis1=1, axis2=2).real
    facts = {
        "axis": axis, "unit_in_file": unit, "modes": int(values.shape[1]), "l_max": int(sides[0][0].max()),
        "polarisation": sorted(set(sides[0][2])), "shape": shape, "computed": computed,
    }  # fmt: skip
    data = {
        "wavelength_nm": wavelengths[order], "tmatrix": values[order], "embedding_index": index[order],
        "mean_extinction_nm2": extinction,
    }  # fmt: skip
    return [Measurement(path, "tmatrix", data, name, facts)]
