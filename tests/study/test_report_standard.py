"""A list of colours as the standard of a report: differences, pass or fail, and batches of many colours from CGATS."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.light import delta_e_2000
from nacre.recipe.toml import dump_toml

FILM = {
    "family": "film",
    "substrate": "Al",
    "layers": [{"material": "SiO2", "thickness_nm": 300}],
    "surface": {"roughness": 0.15},
}
ROWS = {
    "45as15": (60.0, 5.0, -5.0),
    "45as45": (30.0, 0.0, 0.0),
    "45as25az90": (50.0, 1.0, 1.0),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "film.toml").write_text(dump_toml(FILM))
    lines = [f"{name},{lab[0]},{lab[1]},{lab[2]}" for name, lab in ROWS.items()]
    (tmp_path / "standard.csv").write_text("geometry,L*,a*,b*\n" + "\n".join(lines) + "\n")
    return tmp_path


def test_a_report_is_compared_with_a_list(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["report", str(folder / "film.toml"), "--standard", str(folder / "standard.csv"), "--json"]
    assert run([*command, "--tolerance", "1", "--tolerance", "45as15=200"]) == 0
    document = json.loads(capsys.readouterr().out)
    (found,) = document["differences_to_standard"]
    assert found["geometries"] == list(ROWS)
    report = nacre.report(FILM, geometries=["45as25az90"])
    seen = {label: lab for table in report.tables.values() for label, lab in zip(table.labels, table.lab)}
    expected = [float(delta_e_2000(np.array(lab, dtype=float), seen[name])) for name, lab in ROWS.items()]
    assert found["standard"] == pytest.approx(expected, abs=1e-6)
    assert found["passes"] == {name: d <= (200 if name == "45as15" else 1) for name, d in zip(ROWS, expected)}
    assert run([*command[:-1], "-o", str(folder / "report.html")]) == 0


def test_lists_in_other_forms_and_lights_are_converted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """LCh under the report's light is the same colour; L*a*b* of D50 is another one and is adapted."""
    lab = np.array(ROWS["45as15"])
    chroma, hue = np.hypot(lab[1], lab[2]), np.degrees(np.arctan2(lab[2], lab[1])) % 360
    texts = {
        "lab": "name,L*,a*,b*\n45as15,60,5,-5\n",
        "lch": f"name,L*,C*,h\n45as15,60,{chroma:.12f},{hue:.12f}\n",
        "d50": "name,L*(D50/2deg),a*(D50/2deg),b*(D50/2deg)\n45as15,60,5,-5\n",
    }
    seen = {}
    for name, text in texts.items():
        (folder / f"{name}.csv").write_text(text)
        assert run(["report", str(folder / "film.toml"), "--standard", str(folder / f"{name}.csv"), "--json"]) == 0
        seen[name] = json.loads(capsys.readouterr().out)["differences_to_standard"][0]["standard"][0]
    assert seen["lch"] == pytest.approx(seen["lab"], abs=1e-6)
    assert abs(seen["d50"] - seen["lab"]) > 1e-3


@pytest.mark.parametrize(
    "text", ["name,L*,a*,b*\nroof,60,5,-5\n", "name,L*,a*,b*\n45as15,60,5,-5\n45as15,60,5,-5\n", "60,5,-5\n", "", "x"]
)
def test_a_bad_standard_ends_with_status_2(text: str, folder: Path) -> None:
    (folder / "bad.csv").write_text(text)
    assert run(["report", str(folder / "film.toml"), "--standard", str(folder / "bad.csv")]) == 2


def test_a_standard_takes_one_recipe(folder: Path) -> None:
    recipe = str(folder / "film.toml")
    assert run(["report", recipe, recipe, "--standard", str(folder / "standard.csv")]) == 2


TARGET = {
    "recipe": {"family": "film", "substrate": "Al", "layers": []},
    "layers": {"palette": ["TiO2", "SiO2", "Cr"], "thickness_nm": {"Cr": [3, 20], "other": [5, 300]}},
    "target": [{"geometry": "specular 0", "lab": [50, 0, 0], "tolerance": 2.0}],
}


def cgats(rows: list[str]) -> str:
    head = "CGATS.17\nNUMBER_OF_FIELDS 4\nBEGIN_DATA_FORMAT\nSAMPLE_NAME LAB_L LAB_A LAB_B\nEND_DATA_FORMAT\n"
    return f"{head}NUMBER_OF_SETS {len(rows)}\nBEGIN_DATA\n" + "\n".join(rows) + "\nEND_DATA\n"


@pytest.mark.full
def test_many_colours_of_a_cgats_file_are_designed_and_resumed(tmp_path: Path) -> None:
    colours = [(60.0, 10.0, -10.0), (45.0, -10.0, 5.0), (55.0, 0.0, 20.0)]
    rows = [f"c{i} {lab[0]} {lab[1]} {lab[2]}" for i, lab in enumerate(colours)]
    (tmp_path / "any.toml").write_text(dump_toml(TARGET))
    (tmp_path / "few.txt").write_text(cgats(rows[:2]))
    command = ["design", str(tmp_path / "any.toml"), "--many", str(tmp_path / "few.txt"), "-o", str(tmp_path / "out")]
    assert run(command) == 0
    first = (tmp_path / "out" / "c0" / "recipe.toml").stat().st_mtime_ns
    (tmp_path / "few.txt").write_text(cgats(rows))
    assert run([*command, "--resume"]) == 0
    summary = json.loads((tmp_path / "out" / "many.json").read_text())
    assert (summary["count"], summary["done"]) == (3, 3)
    assert (tmp_path / "out" / "c0" / "recipe.toml").stat().st_mtime_ns == first  # not designed again
    (tmp_path / "few.txt").write_text(cgats([*rows[:1], "c1 45 red 5"]))
    assert run([*command, "--resume"]) == 2
