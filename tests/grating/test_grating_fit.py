"""Fits of gratings to measured efficiencies of their orders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.analysis.fit import read_measurement
from nacre.cli import run
from nacre.core.errors import NacreError, UnsupportedError

RECIPE = """family = "grating"
substrate = "Si"
layers = [{thickness_nm = 150, material = "air", shapes = [{shape = "line", material = "Al", width_nm = 300}]}]
lattice = {period_nm = 700}
"""
DEPTH = "layers[0].thickness_nm"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "line.toml").write_text(RECIPE)
    asked = ["--angles-deg", "8", "--azimuth-deg", "30", "--wavelengths-nm", "450:650:50"]
    assert run(["orders", str(tmp_path / "line.toml"), *asked, "-o", str(tmp_path / "orders.csv")]) == 0
    return tmp_path


def test_orders_are_fitted(folder: Path) -> None:
    (folder / "start.toml").write_text(RECIPE.replace("150", "135"))
    measured = read_measurement(folder / "orders.csv")
    assert measured.kind == "orders"
    exact = nacre.orders(nacre.load(folder / "line.toml"), 8.0, 30.0, [450.0, 500.0, 550.0, 600.0, 650.0])
    assert np.sort(measured.values) == pytest.approx(np.sort(exact.reflected[~np.isnan(exact.reflected)]), abs=1e-8)
    page, out = folder / "fit.html", folder / "fit.toml"
    words = [str(folder / "orders.csv"), str(folder / "start.toml"), "--parameter", f"{DEPTH}=100:200", "--starts", "1"]
    assert run(["fit", *words, "-o", str(out), "--report", str(page)]) == 0
    # 1e-3 nm change efficiencies by 1e-5, the least error that lines state; coarse solutions alone are off by 0.03 nm
    assert nacre.load(out).get(DEPTH) == pytest.approx(150.0, abs=1e-3)
    assert page.stat().st_size > 10_000


def test_orders_that_do_not_propagate_are_dark(folder: Path) -> None:
    text = (folder / "orders.csv").read_text().splitlines()
    rows = [row.split(",") for row in text]
    (folder / "more.csv").write_text("\n".join([text[0], ",".join(["450", "8", "7", "0", "0.1", "", "", "", "30"])]))
    assert rows[0][-1] == "azimuth_deg"
    assert read_measurement(folder / "more.csv").model(nacre.load(folder / "line.toml"), None, 0).tolist() == [0.0]


@pytest.mark.parametrize(
    "old, new",
    [
        ("reflected_p", "reflected_q"), ("azimuth_deg", "tilt_deg"), ("reflected_s,reflected_p", "a,b"),
        ("\n450,8,0,0,", "\n450,8,0,0,7"), ("\n450,8,0,", "\n450,95,0,"),
    ],
)  # fmt: skip
def test_wrong_tables_of_orders_are_refused(folder: Path, old: str, new: str) -> None:
    text = (folder / "orders.csv").read_text()
    assert old in text
    (folder / "wrong.csv").write_text(text.replace(old, new))
    with pytest.raises(NacreError):
        read_measurement(folder / "wrong.csv")


def test_other_families_have_no_orders_to_fit(folder: Path) -> None:
    with pytest.raises(UnsupportedError):
        read_measurement(folder / "orders.csv").model(nacre.material({"family": "film", "substrate": "Si"}), None, 0)
