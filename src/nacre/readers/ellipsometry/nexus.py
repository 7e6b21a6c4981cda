"""NeXus files (HDF5) of the application definition NXellipsometry, in its two drafts.

Older draft: `sample/measured_data` [1, 1, angle, psi or delta, wavelength]; later: `data_collection/measured_data`
[angle, psi or delta, wavelength]. Units come from the attribute `units`; a wavelength without one is in angstrom.
"""

from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import UNITS, ellipsometry, to_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = b"\x89HDF\r\n\x1a\n"
DATA = ("sample/measured_data", "data_collection/measured_data")
TYPES = ("sample/data_type", "data_collection/data_type")
WAVELENGTHS = (
    "instrument/spectrometer/wavelength", "data_collection/wavelength_spectrum", "data_collection/wavelength",
)  # fmt: skip
ANGLES = ("instrument/angle_of_incidence", "data_collection/angle_of_incidence")
ERRORS = ("sample/data_error", "data_collection/data_error")
NAMES = (
    "sample/sample_name", "sample/name", "sample/layer_structure", "instrument/company", "instrument/model",
    "start_time",
)  # fmt: skip
COLUMNS = ("sample/column_names", "data_collection/column_names")
MUELLER = [f"m{i}{j}" for i in range(1, 5) for j in range(1, 5)]


def sniff_nexus_ellipsometry(head: FileHead) -> float:
    """Return the confidence that a file is such a file."""
    if not head.data.startswith(MAGIC):
        return 0.0
    import h5py

    try:
        with h5py.File(head.path, "r") as file:
            return CERTAIN if any(_is_ellipsometry(entry) for entry in file.values()) else 0.0
    except OSError:
        return 0.0


def _is_ellipsometry(entry: Any) -> bool:
    return hasattr(entry, "get") and any(path in entry for path in DATA) and any(path in entry for path in ANGLES)


def _text(entry: Any, path: str) -> str:
    if path not in entry:
        return ""
    value = entry[path][()]
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def read_nexus_ellipsometry(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return one measurement per entry, angle by angle.

    Raises:
        NacreError: another data type than Psi and Delta or Mueller matrices, or shapes that do not agree.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            entries = [(name, entry) for name, entry in file.items() if _is_ellipsometry(entry)]
            return [_entry(path, entry, name if len(entries) > 1 else "", options) for name, entry in entries]
    except OSError as error:
        raise NacreError(f"{path}: cannot be read as HDF5: {error}") from None


def _first(entry: Any, paths: tuple[str, ...]) -> Any:
    return next((entry[each] for each in paths if each in entry), None)


def _entry(path: Path, entry: Any, name: str, options: ReadOptions) -> Measurement:
    data, wavelength, angle = (_first(entry, each) for each in (DATA, WAVELENGTHS, ANGLES))
    if wavelength is None:
        raise NacreError(f"{path}: the wavelengths are missing; known places: {', '.join(WAVELENGTHS)}")
    kind = next((text for each in TYPES if (text := _text(entry, each))), "").lower().replace(" ", "")
    unit = str(wavelength.attrs.get("units", "")).lower()
    notes = []
    if unit not in UNITS:
        unit = options.unit or "angstrom"
        notes.append(f"the wavelength is in {unit}: the file names no unit")
    waves = to_nm(np.atleast_1d(wavelength[()]), unit, str(path))
    angles = np.atleast_1d(np.asarray(angle[()], dtype=float))
    names = {"psi/delta": ["psi_deg", "delta_deg"], "tan(psi)/cos(delta)": ["tan_psi", "cos_delta"]}.get(kind)
    if names is None and kind in ("muellermatrix", "mueller"):
        names = MUELLER
    if names is None:
        raise NacreError(
            f"{path}: data_type = {kind!r} is not known; allowed: psi/delta, tan(psi)/cos(delta), Mueller matrix"
        )
    columns_of = _first(entry, COLUMNS)
    if columns_of is not None and kind == "psi/delta":
        written = [str(each, "utf-8") if isinstance(each, bytes) else str(each) for each in np.ravel(columns_of[()])]
        if sorted(word.lower() for word in written) == ["delta", "psi"]:
            names = [f"{word.lower()}_deg" for word in written]
    table = np.asarray(data[()], dtype=float)
    shape = (len(angles), len(names), len(waves))
    if table.size != np.prod(shape) or table.shape[-1] != len(waves):
        raise NacreError(
            f"{path}: measured_data has the shape {table.shape}; expected {shape} (angle, quantity, wavelength)"
        )
    table = table.reshape(shape)
    columns = {
        "wavelength_nm": np.tile(waves, len(angles)), "angle_of_incidence_deg": np.repeat(angles, len(waves)),
        **{key: table[:, i].ravel() for i, key in enumerate(names)},
    }  # fmt: skip
    errors = _first(entry, ERRORS)
    if errors is not None and getattr(errors, "shape", ()) == data.shape:
        spread = np.asarray(errors[()], dtype=float).reshape(shape)
        columns |= {f"{key}_error": spread[:, i].ravel() for i, key in enumerate(names)}
    metadata = {
        each.rpartition("/")[2]: text for each in NAMES if (text := _text(entry, each)) not in ("", "NOT_PROVIDED")
    }
    metadata["unit_in_file"] = unit
    maker = metadata.get("company", "NXellipsometry")
    return ellipsometry(
        path,
        "nexus-ellipsometry",
        columns,
        options,
        maker=maker,
        name=name,
        metadata=metadata,
        assumed=notes,
        is_binary=True,
    )
