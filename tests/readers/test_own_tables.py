"""Every table that nacre writes is read back by `nacre.read` with its values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.analysis.fit import read_measurement
from nacre.analysis.fit_data import OrdersData
from nacre.cli import run
from nacre.core.errors import NacreError, UnsupportedError
from nacre.formats.number_maps import NumberMap, write_number_maps
from nacre.optimise.batch import _table

SIX_DIGITS = 1e-6  # of the printed numbers
ORDERS = ["orders", "grating.toml", "--wavelengths-nm", "500,600"]
GRATING = """family = "grating"
substrate = "glass"
layers = [{thickness_nm = 200, material = "air", shapes = [{shape = "line", material = "glass", width_nm = 400}]}]
[lattice]
period_nm = 1000
"""
FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 120}]\n'
ROWS = [
    {
        "name": f"no {i}", "folder": f"no-{i}", "met": True, "total_nm": 100.0 + i,
        "changes": {"layers[0].thickness_nm": i},
        "targets": [{"asked_lab": [50.0, i, -i], "reached": {"lab": [51.0, i, -i]}, "de00": 1.0, "tolerance": 2.0,
                     "geometry": "specular 0", "lamp": "D65"}],
    } for i in range(3)
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "film.toml").write_text(FILM)
    (tmp_path / "grating.toml").write_text(GRATING)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_diffraction_orders_come_back(folder: Path) -> None:
    assert run([*ORDERS, "-o", "orders.csv"]) == 0
    found = nacre.read("orders.csv")
    assert found.kind == "table" and found.metadata["table"] == "diffraction orders"
    zeroth = found.data["m"] == 0
    np.testing.assert_allclose(found.data["wavelength_nm"][zeroth], [500, 600])
    total = sum(np.nansum(found.data[f"{way}_s"]) for way in ("reflected", "transmitted"))
    assert total == pytest.approx(2.0, abs=1e-3)  # glass absorbs nothing: all power of two wavelengths
    measured = read_measurement(Path("orders.csv"))
    assert isinstance(measured, OrdersData)
    with pytest.raises(UnsupportedError):  # efficiencies of orders are no spectrum of a film
        measured.model(nacre.load("film.toml"), None, 0)


def test_a_layer_sheet_comes_back(folder: Path) -> None:
    assert run(["fabricate", "film.toml", "--to", "sheet", "-o", "sheet.csv"]) == 0
    sheet = nacre.read("sheet.csv")
    assert sheet.metadata["material"] == ["air", "SiO2", "Si"]
    np.testing.assert_allclose(sheet.data["thickness_nm"], [np.nan, 120.0, np.nan])


def test_the_table_of_many_designs_comes_back(folder: Path) -> None:
    Path("many.csv").write_text(_table(ROWS))
    many = nacre.read("many.csv")
    assert many.metadata["name"] == ["no 0", "no 1", "no 2"] and many.metadata["lamp"] == ["D65"] * 3
    np.testing.assert_allclose(many.data["layers[0].thickness_nm"], [0, 1, 2])
    np.testing.assert_allclose(many.data["reached_L"], 51.0)


def test_a_map_of_numbers_comes_back(folder: Path) -> None:
    values = np.arange(12.0).reshape(3, 4)
    one = NumberMap("layers[0].thickness_nm", values, 0.0, 11.0, "nm")
    write_number_maps([one], "csv", Path("map.csv"), "film.toml")
    found = nacre.read("map.csv")
    np.testing.assert_array_equal(found.data["value"], values)
    assert found.name == "layers[0].thickness_nm in nm"


@pytest.mark.parametrize("is_described", [True, False])
def test_a_relief_is_the_same_with_the_heights_that_it_wrote(folder: Path, is_described: bool) -> None:
    heights = np.random.default_rng(3).uniform(0.0, 0.3, (16, 16))
    np.save("heights.npy", heights)
    head = 'family = "relief"\nblur_um = 0.2\ncoating = "Al"\n[coherence]\nsigma = 2.0\n'
    Path("a.toml").write_text('heights = "heights.npy"\nfeature_um = 0.8\nperiodic = true\n' + head)
    assert run(["fabricate", "a.toml", "--to", "csv", "-o", "back.csv"]) == 0
    if not is_described:
        text = Path("back.csv").read_text()
        Path("back.csv").write_text(text.replace("; feature_um = 0.8", ""))
        Path("back.csv.json").unlink()
        with pytest.raises(NacreError):
            nacre.read("back.csv")
        assert nacre.read("back.csv", pitch_um=(0.8, 0.8)).metadata["pitch_um"] == (0.8, 0.8)
        return
    measured = nacre.read("back.csv")
    picture = heights.T[::-1] - heights.min()
    np.testing.assert_allclose(measured.data["height_um"], picture, atol=SIX_DIGITS)
    Path("b.toml").write_text('heights = "back.csv"\n' + head)
    direct, back = (nacre.load(name).bsdf(np.array([550.0])) for name in ("a.toml", "b.toml"))
    wi, wo = np.array([[0.0, 0.0, 1.0]]), np.array([[0.1, 0.2, np.sqrt(0.95)], [0.3, -0.1, np.sqrt(0.9)]])
    wanted = direct.evaluate(np.repeat(wi, 2, axis=0), wo)
    np.testing.assert_allclose(back.evaluate(np.repeat(wi, 2, axis=0), wo), wanted, rtol=1e-3)


def test_a_damaged_table_of_our_own_is_one_line(folder: Path) -> None:
    Path("many.csv").write_text(_table(ROWS).replace("no 1,no-1", "no 1"))
    with pytest.raises(NacreError) as caught:
        nacre.read("many.csv")
    assert "\n" not in str(caught.value) and "line 3" in str(caught.value)
    Path("sheet.csv").write_text("position,material,thickness_nm,thickness_min_nm\n")
    with pytest.raises(NacreError):
        nacre.read("sheet.csv")
