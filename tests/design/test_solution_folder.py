"""Folder of a design: foreign files stay, resumed searches do not regress, files agree."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

import nacre
from nacre.cli import run as command
from nacre.core.errors import NacreError, RecipeError
from nacre.optimise import run as runs
from nacre.optimise.problem import Result, Search
from nacre.recipe.toml import dump_toml

TARGET: dict[str, Any] = {
    "recipe": {"family": "film", "substrate": "Ti", "layers": [{"material": "SiO2", "thickness_nm": 100.0}]},
    "parameters": {"layers[0].thickness_nm": [5, 300]},
    "target": [{"geometry": "specular 0", "lab": [50, 5, 20], "tolerance": 30.0}],
    "search": {"seconds": 1, "solutions": 3},
}


@pytest.mark.parametrize("name", ["report.html", "report.png", "search.json", "design.json", "3/recipe.toml"])
def test_foreign_files_are_not_overwritten(tmp_path: Path, name: str) -> None:
    mine = tmp_path / "out" / name
    mine.parent.mkdir(parents=True)
    mine.write_text("{}")
    with pytest.raises(RecipeError, match=f"holds a {re.escape(name)} that no design wrote"):
        nacre.design(TARGET, tmp_path / "out")
    assert mine.read_text() == "{}" and len(list((tmp_path / "out").iterdir())) == 1


@pytest.mark.full
def test_a_file_with_the_name_of_a_dependency_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text("nm,n,k\n300,2,0\n900,2,0\n")
    layers = [{"material": {"file": str(tmp_path / "own.csv")}, "thickness_nm": 100.0}]
    target = {**TARGET, "recipe": {**TARGET["recipe"], "layers": layers}}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "own.csv").write_text("mine")
    with pytest.raises(RecipeError, match=r"holds a own.csv that no design wrote"):
        nacre.design(target, tmp_path / "out")
    (tmp_path / "out" / "own.csv").unlink()
    nacre.design(target, tmp_path / "out")
    (tmp_path / "own.csv").write_text("nm,n,k\n300,1.9,0\n900,1.9,0\n")
    nacre.design(target, tmp_path / "out")  # the copy is the first design's own
    assert "1.9" in (tmp_path / "out" / "own.csv").read_text()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(NacreError, match="out: is a file; the answers need a folder"):
        nacre.design(TARGET, tmp_path / "out")
    (tmp_path / "t.toml").write_text('family = "film"\nsubstrate = "Si"\nlayers = []\n')
    assert command(["design", str(tmp_path / "t.toml"), "-o", str(tmp_path / "out")]) == 2
    assert "is a file; the answers need a folder" in capsys.readouterr().err


def _must_not_search(*_: Any) -> None:
    raise AssertionError("the search began")


def test_an_unwritable_folder_is_refused_before_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runs, "choose_search", _must_not_search)
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(NacreError, match=r"note.txt is a file; the answers need a folder$"):
        nacre.design(TARGET, tmp_path / "note.txt" / "deeper" / "out")
    with pytest.raises(NacreError, match=r"out: the folder /proc cannot be written"):  # nobody may, root neither
        nacre.design(TARGET, "/proc/out")
    (tmp_path / "t.toml").write_text(dump_toml(TARGET))
    assert command(["design", str(tmp_path / "t.toml"), "-o", str(tmp_path / "note.txt" / "out")]) == 2
    assert "note.txt is not a folder" in capsys.readouterr().err
    full = type(shutil.disk_usage(tmp_path))(10**9, 10**9 - 1000, 1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: full)
    assert command(["design", str(tmp_path / "t.toml"), "-o", str(tmp_path / "out")]) == 2
    reported = capsys.readouterr().err
    assert "0.0 MB are left on its disk" in reported and reported.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["note.txt", "t.toml"]


class _Fixed(Search):
    """A search that returns a fixed result."""

    default_evaluations = 1.0

    def __init__(self, status: str, solutions: list[tuple[float, dict[str, Any]]]) -> None:
        super().__init__(1)
        self.result = Result(status, solutions, 1.0)

    def run(self, *_: Any) -> Result:
        return self.result

    def _search(self, known: Any) -> None:
        raise NotImplementedError


def test_an_interrupt_before_the_first_solution_does_not_blame_the_recipe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runs, "choose_search", lambda *_: _Fixed("interrupted", []))
    (tmp_path / "t.toml").write_text(dump_toml(TARGET))
    assert command(["design", str(tmp_path / "t.toml"), "-o", str(tmp_path / "out")]) == 130
    assert "cannot be computed" not in capsys.readouterr().err


def test_a_file_at_the_second_solution_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "2").write_text("mine")
    with pytest.raises(RecipeError, match="holds a 2 that no design wrote"):
        nacre.design(TARGET, tmp_path / "out")


def test_a_recipe_is_refused_as_a_target(tmp_path: Path) -> None:
    (tmp_path / "film.toml").write_text('family = "film"\nsubstrate = "Si"\nlayers = []\n')
    with pytest.raises(RecipeError, match='is a recipe; write a target with recipe = "film.toml"'):
        nacre.design(tmp_path / "film.toml", tmp_path / "out")


def test_report_and_summary_agree_on_the_time(tmp_path: Path) -> None:
    design = nacre.design(TARGET, tmp_path / "out")
    reported = json.loads((tmp_path / "out" / "design.json").read_text())["seconds"]
    assert design.seconds == reported
    assert f"answers, {reported:.1f} s." in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.full
@pytest.mark.parametrize("limits", [{}, {"max_layers": "fewest"}])
def test_a_resumed_search_does_not_regress(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limits: dict[str, str]
) -> None:
    """A search compares by its own route: here its best answer is not that of the final evaluation."""
    target: dict[str, Any] = {key: value for key, value in TARGET.items() if key != "parameters"}
    target |= {
        "layers": {"palette": ["SiO2"], "max_layers": 1},
        "limits": limits,
        "search": {"seconds": 1, "solutions": 1},
    }
    first = nacre.design(target, tmp_path / "out")

    misled = _Fixed("time", [(0.0, {"layers": [{"material": "SiO2", "thickness_nm": 5.0}]})])
    monkeypatch.setattr(runs, "choose_search", lambda *_: misled)
    again = nacre.design(target, tmp_path / "out", resume=True)
    assert again.best.worst.distance == first.best.worst.distance
    assert nacre.design(target, tmp_path / "other").best.worst.distance > first.best.worst.distance
    assert len(again.solutions) == 1


def test_a_folder_that_cannot_be_created_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NacreError, match="file is a file; the answers need a folder"):
        nacre.design(TARGET, tmp_path / "file" / "out")
