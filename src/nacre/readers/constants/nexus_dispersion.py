"""NeXus files (HDF5) of the application definition NXdispersive_material: tables, or the sampled plot of a formula."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers import hdf5
from nacre.readers.columns import sorted_by_wavelength
from nacre.readers.constants.convert import checked
from nacre.readers.file_head import FileHead
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN
from nacre.readers.units import SPECTRAL, UNITS, Floats, parse_unit, to_nm

MAGIC = b"\x89HDF\r\n\x1a\n"
DEFINITION = b"NXdispersive_material"
AXES = ("dispersion_x", "dispersion_y", "dispersion_z")


def sniff(head: FileHead) -> float:
    """Return 1 for HDF5 whose first entry states the definition."""
    if not head.data.startswith(MAGIC):
        return 0.0
    import h5py

    try:
        with h5py.File(head.path, "r") as file:
            names = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
            return CERTAIN if any(_definition(file, name) for name in names) else 0.0
    except (OSError, RuntimeError, hdf5.Hdf5Error):
        return 0.0


def _definition(file: Any, name: str) -> bool:
    found = hdf5.dataset(file, f"{name}/definition")
    return found is not None and found.shape == () and bytes(found[()]) == DEFINITION


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the optical constants along the first axis.

    Raises:
        NacreError: links to other files, no table and no sampled plot, or units that are not stated.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            hdf5.refuse_links(file)
            entry = next(name for name in file if _definition(file, name))
            return [_material(path, file, entry)]
    except hdf5.Hdf5Error as error:
        raise NacreError(f"{path}: {error}") from None


def _material(path: Path, file: Any, entry: str) -> Measurement:
    present = [axis for axis in AXES if hdf5.node(file, f"{entry}/{axis}") is not None]
    if not present:
        raise NacreError(f"{path}: holds no dispersion")
    left_out = [f"{axis} (another axis of the crystal)" for axis in present[1:]]
    group = hdf5.node(file, f"{entry}/{present[0]}")
    tables = [name for name in group if isinstance(name, str) and name.startswith("dispersion_table")]
    places = [f"{entry}/{present[0]}/{name}" for name in (*tables, "plot")]
    for place in places:
        found = _table(path, file, place)
        if found is not None:
            nm, n, k = found
            assumed = ["n and k are the file's own samples of a formula"] if place.endswith("/plot") else []
            nm, given = sorted_by_wavelength(path, nm, {"n": n, "k": k})
            n, k = checked(path, nm, given["n"], given["k"], assumed)
            data = {"wavelength_nm": nm, "n": n, "k": k}
            return Measurement(
                path, "nexus-dispersion", "constants", data, path.stem, {}, tuple(assumed), tuple(left_out)
            )
    raise NacreError(f"{path}: is a NeXus dispersion by a formula without a table; export a table of n and k")


def _table(path: Path, file: Any, place: str) -> tuple[Floats, Floats, Floats] | None:
    wavelength = hdf5.dataset(file, f"{place}/wavelength")
    index = hdf5.dataset(file, f"{place}/refractive_index")
    if wavelength is None or index is None:
        return None
    stated = wavelength.attrs.get("units", wavelength.attrs.get("unit", ""))
    unit = parse_unit(stated.decode() if isinstance(stated, bytes) else str(stated))
    if unit is None or UNITS[unit][0] not in SPECTRAL:
        raise NacreError(f'{path}: the unit "{stated}" of its wavelengths is not known')
    nm, values = to_nm(np.ravel(wavelength[()]), unit), np.ravel(index[()])
    extinction = hdf5.dataset(file, f"{place}/extinction")
    k = np.imag(values) if extinction is None else np.ravel(extinction[()])
    if not (nm.shape == values.shape == k.shape):
        raise NacreError(f"{path}: wavelengths, n and k have different lengths")
    return nm, np.real(values).astype(float), np.asarray(k, dtype=float)
