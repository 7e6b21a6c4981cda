"""Text of the imaging ellipsometers EP3 and EP4 by Accurion (Park Systems).

A heading and a unit line, both after `#`; columns by name, Delta before Psi. Zones 1 to 4 repeat a measurement and
are averaged, zone 0 is the instrument's own mean, zone 5 a spread. Regions of interest, places and times are data
sets of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import ellipsometry, text_lines, to_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAKER = "Accurion"
NEEDED = {"lambda", "aoi", "delta", "psi"}
PLACE_MM = 0.25  # stage drift while the angle changes is below this distance
REPEATS, OWN_MEAN = (1, 2, 3, 4), 0


def sniff(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    for line in head.lines[:3]:
        if line.startswith("#") and set(_names(line)) >= NEEDED:
            return CERTAIN
    return 0.0


def _names(line: str) -> list[str]:
    return [name.strip().lower() for name in line.lstrip("#").split("\t" if "\t" in line else None)]


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return one measurement per place and region of interest; repeats in zones are averaged.

    Raises:
        NacreError: no rows, or rows of different lengths.
    """
    lines = text_lines(path)
    start = next(i for i, line in enumerate(lines) if line.startswith("#") and set(_names(line)) >= NEEDED)
    names = _names(lines[start])
    units: dict[str, str] = {}
    rows = []
    for number, line in enumerate(lines[start + 1 :], start + 2):
        if line.startswith("#"):
            units = units or dict(zip(names, (unit.strip() for unit in _names(line))))
        elif line.strip():
            cells = line.split("\t") if "\t" in line else line.split()
            if len(cells) < len(names):
                raise NacreError(f"{path}: line {number} has {len(cells)} cells; the heading has {len(names)}")
            rows.append([_number(cell) for cell in cells[: len(names)]])
    if not rows:
        raise NacreError(f"{path}: contains no rows of data")
    table = dict(zip(names, np.array(rows).T))
    for angle in ("aoi", "delta", "psi"):
        if units.get(angle, "deg") not in ("deg", "\u00b0"):
            raise NacreError(f"{path}: {angle} is in {units[angle]!r}; allowed: deg")
    table["lambda"] = to_nm(table["lambda"], units.get("lambda", "nm"), str(path))
    left_out: list[str] = []
    rows_of = _data_sets(table)
    return [
        _data_set(path, {key: column[index] for key, column in table.items()}, name, options, left_out)
        for name, index in rows_of
    ]


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", "."))  # German exports have decimal commas
    except ValueError:
        return np.nan


def _data_sets(table: dict[str, Array]) -> list[tuple[str, NDArray[np.intp]]]:
    """Return name and row indices of each place and region of interest."""
    count = len(table["psi"])
    region = table.get("roiidx", np.zeros(count))
    place = np.zeros(count, dtype=int)
    centres: list[Array] = []
    if "x_pos" in table and "y_pos" in table:
        for i, at in enumerate(np.stack([table["x_pos"], table["y_pos"]], axis=1)):
            near = [j for j, centre in enumerate(centres) if np.max(np.abs(at - centre)) <= PLACE_MM]
            if not near:
                centres.append(at)
            place[i] = near[0] if near else len(centres) - 1
    found = []
    for r, p in sorted({(r, p) for r, p in zip(region.tolist(), place.tolist())}, key=lambda pair: (pair[1], pair[0])):
        name = [f"region {r:g}"] if len(set(region.tolist())) > 1 else []
        name += [f"x = {centres[p][0]:g} mm, y = {centres[p][1]:g} mm"] if len(centres) > 1 else []
        found.append((", ".join(name), np.flatnonzero((region == r) & (place == p))))
    return found


def _data_set(
    path: Path, table: dict[str, Array], name: str, options: ReadOptions, left_out: Sequence[str]
) -> Measurement:
    keys = list(zip(table["lambda"].tolist(), table["aoi"].tolist()))
    zone = table.get("zone")
    metadata: dict[str, object] = {}
    if "bandwidth" in table and np.isfinite(table["bandwidth"]).any():
        metadata["bandwidth_nm"] = float(np.nanmedian(table["bandwidth"]))
    notes, out = [], list(left_out)
    used = np.isfinite(table["psi"]) & np.isfinite(table["delta"])
    if zone is not None:
        repeats = np.isin(zone, REPEATS)
        used &= repeats if repeats.any() else zone == OWN_MEAN
        if repeats.any():
            notes.append("Psi and Delta are means over the zones 1 to 4")
        others = sorted(set(zone.tolist()) - set(REPEATS if repeats.any() else (OWN_MEAN,)))
        out += [f"zone {each:g} ({np.sum(zone == each)} rows)" for each in others]
        metadata["zones"] = int(len(set(zone[repeats].tolist()))) if repeats.any() else 1
    time = table.get("time")
    is_dynamic = time is not None and zone is None and len(set(zip(keys, time.tolist()))) > len(set(keys))
    if is_dynamic and time is not None:
        keys = [(w, a, t) for (w, a), t in zip(keys, time.tolist())]  # type: ignore[misc]  # a longer key
    groups: dict[tuple[float, ...], list[int]] = {}
    for i in np.flatnonzero(used):
        groups.setdefault(keys[i], []).append(int(i))
    if not groups:
        raise NacreError(f"{path}: contains no finite Psi and Delta")
    most = max(len(rows) for rows in groups.values())
    fewer = sum(len(rows) < most for rows in groups.values())
    if zone is not None and fewer:
        notes.append(f"{fewer} of {len(groups)} angles have fewer than {most} zones")
    psi, delta = table["psi"], table["delta"]
    means = [(np.mean(psi[i]), _mean_angle(delta[i])) for i in groups.values()]
    columns: dict[str, object] = {
        "wavelength_nm": [key[0] for key in groups], "angle_of_incidence_deg": [key[1] for key in groups],
        "psi_deg": [mean[0] for mean in means], "delta_deg": [mean[1] for mean in means],
    }  # fmt: skip
    if is_dynamic:
        columns["time_s"] = [key[2] for key in groups]
    if max(len(i) for i in groups.values()) > 1:
        columns["repeats"] = [len(i) for i in groups.values()]
        if zone is None:
            notes.append("rows of one wavelength and angle are averaged")
    return ellipsometry(
        path, "accurion", columns, options, maker=MAKER, name=name, metadata=metadata, assumed=notes, left_out=out
    )


def _mean_angle(values: Array) -> float:
    """Return the mean of angles in degrees near the first of them."""
    return float(values[0] + np.mean(180.0 - np.mod(180.0 - (values - values[0]), 360.0)))
