"""The Python verbs of the trade: what the commands do, in one call each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre

RECIPE = """family = "film"
substrate = "Si"
layers = [{material = "SiO2", thickness_nm = 120}]
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "oxide.toml"
    path.write_text(RECIPE)
    return path


def test_report_is_that_of_the_command(recipe: Path) -> None:
    from nacre.study.report import make_report

    seen = nacre.report(recipe)
    assert seen.gloss == make_report(nacre.load(recipe)).gloss
    assert nacre.report(nacre.load(recipe), illuminant="A").illuminant == "A"


def test_tolerance_and_fit_take_the_words_of_the_options(recipe: Path, tmp_path: Path) -> None:
    found = nacre.tolerance(recipe, ["layers[0].thickness_nm=2"], draws=20, seed=1)
    assert found.sensitivities[0][0] == "layers[0].thickness_nm"
    lam = np.arange(400.0, 701.0, 10.0)
    reflected = nacre.spectrum(recipe, 0.0, lam).specular_reflectance[0]
    measured = tmp_path / "measured.csv"
    rows = "\n".join(f"{x:g},0,{value:.9f}" for x, value in zip(lam, reflected))
    measured.write_text(f"wavelength_nm,angle_deg,specular_reflectance\n{rows}\n")
    off = nacre.load(recipe).vary({"layers[0].thickness_nm": 135.0})
    fitted = nacre.fit(measured, off, ["layers[0].thickness_nm=80:200"], starts=1)
    assert fitted.numbers[0].value == pytest.approx(120.0, abs=0.01)


def test_sweep_fabricate_export_and_import_write_their_files(recipe: Path, tmp_path: Path) -> None:
    plan = tmp_path / "s.toml"
    plan.write_text('recipe = "oxide.toml"\nmode = "grid"\n[axes]\n"layers[0].thickness_nm" = [100, 140]\n')
    store = nacre.sweep(plan, tmp_path / "s.zarr", workers=1)
    assert store.is_dir()
    assert nacre.export(recipe, "gltf", tmp_path / "oxide.gltf")["file"].endswith("oxide.gltf")
    assert nacre.import_(tmp_path / "oxide.gltf", tmp_path / "back.toml").family == "film"
    written = nacre.fabricate(nacre.load(Path(__file__).parents[2] / "examples" / "relief" / "star.toml"), "csv",
                              tmp_path / "heights.csv")  # fmt: skip
    assert all(file.exists() for file in written)


def test_verbs_load_nothing_until_used() -> None:
    assert {"report", "fit", "sweep", "tolerance", "export", "import_", "fabricate"} <= set(dir(nacre))
