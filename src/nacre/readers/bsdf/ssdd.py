"""SSDD (surface scattering distribution data, version 0.2): up to four blocks of BRDF, BTDF and specular data.

Parameter 0 varies fastest. Source: the format's specification in the documentation of libbsdf.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array, angles_deg
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import measurement as as_measurement
from nacre.readers.bsdf.samples import pairs_of, pairs_of_half_angles, read_bytes
from nacre.readers.bsdf.zemax import scatter_direction
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

TYPES = ("brdf", "btdf", "specular_reflectance", "specular_transmittance")
CHANNELS = {"monochrome": 1, "rgb": 3, "xyz": 3}
FLOAT_BYTES = 4


def sniff(head: FileHead) -> float:
    """Recognise the version line followed by a data type."""
    lines = [line for line in head.lines if line.strip() and not line.startswith("#")]
    is_headed = bool(lines) and re.match(r"VERSION\s+\d", lines[0]) is not None
    return CERTAIN if is_headed and any(line.startswith("DATA_TYPE") for line in lines) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all blocks.

    Raises:
        NacreError: a block is incomplete or unknown.
    """
    data, place = read_bytes(path, 8.0), 0
    found: list[Measurement] = []
    entries: dict[str, str] = {}
    while place < len(data):
        end = data.find(b"\n", place)
        end = len(data) if end < 0 else end
        line = data[place:end].decode("utf-8", "replace").partition("# ")[0].strip()
        place = end + 1
        name, _, value = line.partition(" ")
        if not name or name.startswith("#"):
            continue
        entries[name] = value.strip()
        if name == "DATA":
            try:
                measured, place = _block(path, entries, data, place)
            except (ValueError, KeyError, IndexError):
                kind = entries.get("DATA_TYPE", "?")[:40]
                raise NacreError(f"{path}: block {kind} is incomplete or damaged") from None
            found.append(measured)
            entries = {key: entries[key] for key in ("VERSION", "SOFTWARE", "DATE") if key in entries}
    if not found:
        raise NacreError(f"{path}: holds no data block")
    return found


def _block(path: Path, entries: dict[str, str], data: bytes, place: int) -> tuple[Measurement, int]:
    kind, model = entries["DATA_TYPE"].lower(), entries["COLOR_MODEL"].lower()
    if kind not in TYPES:
        raise ValueError(kind)
    waves = np.array([float(w) for w in entries["WAVELENGTH_LIST"].split()]) if model == "spectrum" else None
    channels = len(waves) if waves is not None else CHANNELS[model]
    axes = [np.array([float(w) for w in entries.get(f"PARAM{i}_LIST", "0").split()]) for i in range(4)]
    if kind.startswith("specular"):
        axes[2:] = [np.zeros(1), np.zeros(1)]
    count = int(np.prod([len(a) for a in axes])) * channels
    values, place = _values(entries["DATA"].lower(), data, place, count)
    # parameter 0 varies fastest: [param3, param2, param1, param0, channel]
    values = values.reshape(*(len(a) for a in axes[::-1]), channels)
    grids = list(np.meshgrid(*axes[::-1], indexing="ij"))[::-1]
    values = values.reshape(-1, channels)
    metadata = {"scatter": "btdf" if kind in ("btdf", "specular_transmittance") else "brdf", "colour_model": model,
                "data_type": kind, "reduction": entries.get("REDUCTION_TYPE", ""),
                "shape": tuple(len(a) for a in axes)}  # fmt: skip
    metadata |= {key.lower(): entries[key] for key in ("SOURCE_TYPE", "DEVICE", "MEASUREMENT_DATE") if key in entries}
    name, colour = entries.get("NAME", ""), model if model in ("rgb", "xyz") else None
    if kind.startswith("specular"):
        quantity = "reflectance" if kind.endswith("reflectance") else "transmittance"
        table = {"theta_i_deg": np.repeat(grids[0].ravel(), channels)}
        if waves is not None:
            table["wavelength_nm"] = np.tile(waves, grids[0].size)
        table[f"specular_{quantity}"] = values.ravel()
        return Measurement(path, "ssdd", "bsdf", table, name, metadata), place
    angles = _angles(entries.get("PARAM_TYPE", "").lower(), grids, entries, axes[0])
    return as_measurement(path, "ssdd", angles, waves, values, metadata, name=name, colour=colour), place


def _values(mode: str, data: bytes, place: int, count: int) -> tuple[Array, int]:
    """Return the block's numbers and the place after them."""
    if mode == "binary":
        return np.frombuffer(data, "<f4", count, place).astype(float), place + FLOAT_BYTES * count
    if mode != "ascii":
        raise ValueError(mode)
    numbers: list[float] = []
    while len(numbers) < count and place < len(data):
        end = data.find(b"\n", place)
        end = len(data) if end < 0 else end
        numbers += [float(w) for w in data[place:end].partition(b"#")[0].split()]
        place = end + 1
    if len(numbers) != count:
        raise ValueError("count")
    return np.array(numbers), place


def _angles(kind: str, grids: list[Array], entries: dict[str, str], incidence: Array) -> Array:
    """Return direction pairs in degrees."""
    first, second, third, fourth = grids
    if kind == "spherical_coordinate_system":
        return pairs_of(first, second, third, fourth % 360.0)
    if kind == "half_difference_coordinate_system":
        return pairs_of_half_angles(*(np.radians(g).ravel() for g in grids))
    if kind != "specular_coordinate_system":
        raise ValueError(kind)
    offsets = [float(w) for w in entries.get("PARAM4_LIST", "").split()] or np.zeros(len(incidence))
    mirror = first + np.interp(first, incidence, offsets)
    # spherical coordinates turned to the mirror direction: azimuth 0 points from it towards the normal, 90 to +y
    out = angles_deg(scatter_direction(mirror, -fourth, third))
    return pairs_of(first, second, out[..., 0], (out[..., 1] + second) % 360.0)
