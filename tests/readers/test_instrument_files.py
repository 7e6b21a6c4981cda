"""Files as instruments write them, against independent readings of them.

The files are not part of the project; where their folder is absent, these tests skip. Each has `FILE.reading.json`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement
from nacre.readers.registry import open_file

FILES = Path(__file__).parents[2] / ".." / "shared" / "reference" / "instruments"
VALUES = {
    "spectra": ("reflectance", "transmittance", "absorbance"),
    "ellipsometry": ("psi_deg",),
    "nk": ("n",),
}
PER_CENT = ("%", "%T", "%R")
DIGITS = 2e-6  # the readings have eight digits, some files five
REFUSAL = ("refuse", "ask")
FIELDS = {"LAB_L": "L", "LAB_A": "a", "LAB_B": "b", "XYZ_X": "X", "XYZ_Y": "Y", "XYZ_Z": "Z"}


def entries(kind: str) -> list[Any]:
    index = FILES / kind / "index.json"
    if not index.exists():
        return [pytest.param(None, marks=pytest.mark.skip(reason="../shared/reference/instruments is absent"))]
    return [pytest.param(entry, id=entry["file"]) for entry in json.loads(index.read_text(encoding="utf-8"))]


def read(kind: str, entry: dict[str, Any]) -> list[Measurement]:
    """Read a file; a refusal passes only where the reading allows one."""
    path = FILES / kind / entry["file"]
    try:
        return open_file(path)
    except NacreError as error:
        is_asked = isinstance(error, AmbiguousFileError) and kind == "nk"
        assert is_asked or any(word in entry["front_door"] for word in REFUSAL), error
        assert str(path) in str(error)
        pytest.skip("refused, as the reading allows")


def matching(found: list[Measurement], rows: int | None) -> Measurement:
    return next((each for each in found if len(next(iter(each.data.values()))) == rows), found[0])


@pytest.mark.parametrize("entry", entries("spectra"))
def test_spectra_agree_with_independent_readings(entry: dict[str, Any]) -> None:
    reading = entry["right_reading"]
    reading = reading.get("second_or_first", reading)
    measurement = matching(read("spectra", entry), reading["rows"])
    nm = measurement.data["wavelength_nm"]
    quantity = next(name for name in VALUES["spectra"] if name in measurement.data)
    values = measurement.data[quantity]
    assert measurement.kind == "spectrum"
    assert len(nm) == reading["rows"]
    assert np.all(np.diff(nm) >= 0)
    for sample in reading["samples"]:
        wanted = {key: value for key, value in sample.items() if key not in ("row", "x") and "counts" not in key}
        ((key, value),) = wanted.items()
        unit = reading.get("y", {}).get(key, {}).get("unit", "")
        factor = 0.01 if unit in PER_CENT or "percent" in key else 1.0
        places = np.flatnonzero(np.abs(nm - sample["x"]) <= 0.006 + 1e-6 * sample["x"])
        assert len(places), sample
        if value is None:
            assert np.isnan(values[places]).any()
        else:
            np.testing.assert_allclose(
                np.min(np.abs(values[places] - factor * value)), 0.0, atol=DIGITS * (1 + abs(value))
            )
    if "in_400_700_nm" in reading and "unit" in str(reading.get("y")):
        is_visible = (nm >= 400) & (nm <= 700)
        unit = next(iter(reading["y"].values()))["unit"]
        factor = 0.01 if unit in PER_CENT else 1.0
        assert np.mean(values[is_visible]) == pytest.approx(factor * reading["in_400_700_nm"]["mean"], rel=2e-4)


@pytest.mark.parametrize("entry", [*entries("ellipsometry"), *entries("nk")])
def test_tables_agree_with_independent_readings(entry: dict[str, Any]) -> None:
    kind = entry["class"]
    if "samples" not in entry["right_reading"]:
        assert read(kind, entry)[0].data
        return
    reading = entry["right_reading"]
    measurement = matching(read(kind, entry), reading["rows"])
    nm = measurement.data["wavelength_nm"]
    assert len(nm) == reading["rows"]
    for sample in reading["samples"]:
        is_row = np.abs(nm - sample["x"]) <= 1e-6 * sample["x"] + 1e-3
        if "aoi_deg" in sample and "angle_of_incidence_deg" in measurement.data:
            is_row &= np.abs(measurement.data["angle_of_incidence_deg"] - sample["aoi_deg"]) < 1e-3
        for name, value in sample.items():
            if name in measurement.data and value is not None:
                apart = np.abs(measurement.data[name][is_row] - value)
                if name == "delta_deg":
                    apart = np.minimum(apart % 360, -apart % 360)
                assert np.min(apart, initial=np.inf) <= 2e-5 * (1 + abs(value)), (name, sample)


@pytest.mark.parametrize("entry", entries("colours"))
def test_colours_agree_with_independent_readings(entry: dict[str, Any]) -> None:
    reading = entry["right_reading"]
    found = read("colours", entry)
    data = found[0].data
    count = reading.get("sets") or reading.get("swatches") or reading.get("objects") or reading.get("samples")
    if count:
        assert len(found[0].metadata.get("names", found)) == count
    for row in reading["rows"] if isinstance(reading.get("rows"), list) else []:
        if isinstance(row, dict):
            for key, name in FIELDS.items():
                if key in row:
                    assert data[name][row["row"]] == pytest.approx(row[key], rel=1e-6)
        else:
            place = reading["rows"].index(row)
            np.testing.assert_allclose([data[name][place] for name in "Lab"], row, rtol=1e-6)
    for swatch in reading.get("some", []):
        names = found[0].metadata["names"]
        assert swatch["name"] in names
        wanted = swatch.get("values") or [value / 255 for value in swatch["srgb8"]]
        wanted = wanted * 3 if len(wanted) == 1 else wanted
        np.testing.assert_allclose(data["srgb"][names.index(swatch["name"])], wanted, atol=2e-5)
    if "spectrum" in reading:
        low, high, bands = reading["spectrum"]["nm"]
        np.testing.assert_allclose(data["wavelength_nm"], np.linspace(low, high, bands))
        first, last = reading["spectrum"]["first_row"][0], reading["spectrum"]["first_row"][-1]
        np.testing.assert_allclose(data["spectra"][0][[0, -1]], [first, last], rtol=1e-6)
    if "first_sample" in reading:
        for measurement, name in ((found[0], "first_sample"), (found[-1], "last_sample")):
            values = measurement.data["reflectance"]
            assert values[0] == pytest.approx(reading[name][0]) and values[-1] == pytest.approx(reading[name][-1])


@pytest.mark.parametrize("entry", entries("heights"))
def test_heights_agree_with_independent_readings(entry: dict[str, Any]) -> None:
    reading = entry["right_reading"]
    found = read("heights", entry)
    assert found[0].kind == "heights"
    if "height_um" not in reading:
        return
    heights = found[0].data["height_um"]
    wanted = reading["height_um"]
    assert list(heights.shape) == reading["shape_rows_columns"]
    assert np.ptp(heights) == pytest.approx(wanted["peak_to_valley"], rel=1e-5)
    np.testing.assert_allclose(found[0].metadata["pitch_um"], reading["pixel_um"], rtol=1e-5)


@pytest.mark.parametrize("kind", ["bsdf", "tmatrix"])
def test_other_files_are_read_or_refused_by_name(kind: str) -> None:
    index = FILES / kind / "index.json"
    if not index.exists():
        pytest.skip("../shared/reference/instruments is absent")
    for entry in json.loads(index.read_text(encoding="utf-8")):
        path = FILES / kind / entry["file"]
        try:
            assert open_file(path)[0].kind == kind, entry["file"]
        except NacreError as error:
            assert str(path) in str(error)
