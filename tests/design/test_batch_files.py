"""`nacre design --many`: lists of colours as people write them, folders that every command takes, second runs."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000
from nacre.optimise.batch import folder_names
from nacre.optimise.colour_list import read_colours
from nacre.recipe.toml import dump_toml

TARGET: dict[str, Any] = {
    "recipe": {"family": "film", "substrate": "Ti", "layers": [{"material": "SiO2", "thickness_nm": 100.0}]},
    "parameters": {"layers[0].thickness_nm": [0, 300]},
    "target": [{"geometry": "specular 0", "lab": [50, 0, 0], "tolerance": 2.0}],
    "search": {"seconds": 2, "solutions": 1},
}
LABS = [[50.0, 20.0, -3.5], [40.0, -1.0, 2.0]]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("50,20,-3.5\n40,-1,2\n", ["", ""]),
        ('red,50,20,-3.5\n\n# remark\n"grey, dark",40,-1,2\n', ["red", "grey, dark"]),
        ("L,a,b\n50,20,-3.5\n40,-1,2\n", ["", ""]),
        (
            "Sample;L* (D65/10\u00b0);a* (D65/10\u00b0);b* (D65/10\u00b0);gloss\nred;50,0;20,0;-3,5;80\n"
            "no 2;40;-1;2;9\n",
            ["red", "no 2"],
        ),
        ("Farbe\tb*\ta*\tL*\nred\t-3,5\t20\t50\ngrau\t2\t-1\t40\n", ["red", "grau"]),
        ("dark red 50 20 -3.5\ngrey 40 -1 2\n", ["dark red", "grey"]),
    ],
)
def test_common_list_formats_are_read(tmp_path: Path, text: str, names: list[str]) -> None:
    for encoding in ("utf-8", "utf-16"):
        (tmp_path / "l.csv").write_bytes(text.encode(encoding))
        rows = read_colours(tmp_path / "l.csv", 1)
        assert [row.name for row in rows] == names
        np.testing.assert_array_equal([row.lab[0] for row in rows], LABS)


def test_a_row_may_contain_a_colour_per_target(tmp_path: Path) -> None:
    (tmp_path / "l.csv").write_text("name,L1,a1,b1,L2,a2,b2\nflop,50,1,2,60,3,4\n")
    np.testing.assert_array_equal(read_colours(tmp_path / "l.csv", 2)[0].lab, [[50, 1, 2], [60, 3, 4]])
    (tmp_path / "l.csv").write_text("flop,50,1,2,60,3,4\nplain,50,1,2\n")
    rows = read_colours(tmp_path / "l.csv", 2)
    np.testing.assert_array_equal(rows[0].lab, [[50, 1, 2], [60, 3, 4]])
    np.testing.assert_array_equal(rows[1].lab, [[50, 1, 2], [50, 1, 2]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name,L,a,b\nred,50,20,3\nblue,40,x,2\n", r'l.csv: line 3: "x" is not a number'),
        ("50,20\n", r'l.csv: line 1: "50, 20" should hold L, a, b'),
        ("name,L,a,b\n\n# r\nred,50,20\n", r"l.csv: line 4: .* has 3 cells, fewer"),
        ("red,50,20,nan\n", r'l.csv: line 1: "nan" is not a number'),
        ("red,-5,20,1\n", r"l.csv: line 1 = .* is not a colour"),
        ("U,V,W\n1,2,3\n", r"l.csv: .*U"),
        ("L,a,b\n", r"l.csv: contains no colours"),
        ("", r"l.csv: contains no colours"),
        ("a\0b", r"l.csv: is not a"),
    ],
)
def test_bad_rows_are_refused_with_their_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, says: str
) -> None:
    (tmp_path / "l.csv").write_text(text)
    with pytest.raises(NacreError, match=says):
        nacre.design.many(TARGET, tmp_path / "l.csv")
    (tmp_path / "t.toml").write_text(dump_toml(TARGET))
    assert run(["design", str(tmp_path / "t.toml"), "--many", str(tmp_path / "l.csv"), "-o", str(tmp_path / "o")]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and not (tmp_path / "o").exists()


def test_names_become_unique_folders() -> None:
    names = ["RAL 3020 / matt", "", "RAL 3020, matt", "../up", "many.csv", "3", "RAL-3020-matt", "\u00e4\u00f6"]
    found = folder_names(names)
    assert found[:4] == ["RAL-3020-matt", "2", "RAL-3020-matt-2", "up"]
    assert len({name.lower() for name in found} | {"many.csv"}) == 9 and not any("/" in name for name in found)


def _run(folder: Path, *more: str) -> int:
    return run(["design", str(folder / "t.toml"), "--many", str(folder / "l.csv"), "-o", str(folder / "o"), *more])


def test_a_second_run_reuses_finished_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film = nacre.material(TARGET["recipe"])
    wanted = nacre.gamut(film, ["layers[0].thickness_nm=60:160"], points=8, observer="10deg").lab[:3]
    lines = [f"film {i},{','.join(map(repr, map(float, lab)))}" for i, lab in enumerate(wanted)]
    (tmp_path / "t.toml").write_text(dump_toml(TARGET))
    (tmp_path / "l.csv").write_text("\n".join(["name,L,a,b", *lines, "far,90,60,-60"]))
    assert _run(tmp_path, "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["status"] == "done" and summary["done"] == 4 and summary["met"] == 3
    table = list(csv.DictReader((tmp_path / "o" / "many.csv").read_text().splitlines()))
    assert [row["met"] for row in table] == ["yes", "yes", "yes", "no"]
    for row, reported in zip(summary["rows"], table, strict=True):
        made = nacre.load(tmp_path / "o" / row["folder"])
        assert (
            row["total_nm"]
            == pytest.approx(made.get("layers[0].thickness_nm"))
            == pytest.approx(float(reported["total_nm"]), abs=0.01)
        )
        assert made.get("layers[0].thickness_nm") == pytest.approx(float(reported["layers[0].thickness_nm"]), rel=1e-5)
        seen = nacre.gamut(made, ["layers[0].thickness_nm=60:160"], points=8).lab[0]  # of its own number
        np.testing.assert_allclose(seen, row["targets"][0]["reached"]["lab"], atol=0.3)  # by another grid
        assert row["targets"][0]["de00"] == pytest.approx(delta_e_2000(np.array(row["lab"][0]), seen), abs=0.3)
    # one colour changed, one gone: the others stay as they are
    before = {name: (tmp_path / "o" / name / "recipe.toml").stat().st_mtime_ns for name in ("film-0", "film-1", "far")}
    (tmp_path / "l.csv").write_text("\n".join(["name,L,a,b", *lines[:2], "far,80,60,-60"]))
    assert _run(tmp_path, "--resume") == 0
    after = {name: (tmp_path / "o" / name / "recipe.toml").stat().st_mtime_ns for name in before}
    assert after["film-0"] == before["film-0"] and after["film-1"] == before["film-1"] and after["far"] > before["far"]
    assert not (tmp_path / "o" / "film-2").exists()
    assert "2 of 3 colours are met" in capsys.readouterr().out
    kept = nacre.design.many(TARGET | {"search": {"seconds": 2, "solutions": 1}}, wanted[:1])[0]
    assert kept.worst.distance < 0.1
    # another target's answers are not mixed with these
    (tmp_path / "t.toml").write_text(dump_toml({**TARGET, "parameters": {"layers[0].thickness_nm": [0, 250]}}))
    assert _run(tmp_path, "--resume") == 2
    assert "belongs to another target" in capsys.readouterr().err


def test_reused_solutions_are_unchanged(tmp_path: Path) -> None:
    first = nacre.design.many(TARGET, LABS, tmp_path / "o")
    second = nacre.design.many(TARGET, LABS, tmp_path / "o", resume=True)
    for one, other in zip(first, second, strict=True):
        assert one.changes == other.changes and one.worst.distance == other.worst.distance
        assert one.recipe == other.recipe and one.is_met == other.is_met


@pytest.mark.parametrize(("limit", "ended_by"), [({"seconds": 0.01}, "time"), ({"evaluations": 2}, "evaluations")])
def test_a_row_states_the_limit_that_ended_its_search(tmp_path: Path, limit: dict[str, float], ended_by: str) -> None:
    start = {"family": "film", "substrate": "Ti", "layers": [{"material": {"n": 1.5}, "thickness_nm": 100.0}]}
    free = {"recipe": start, "parameters": {"layers[0].material.n": [1.4, 1.6]}}
    unreachable = [{"geometry": "specular 0", "lab": [95, 90, 0], "tolerance": 0.1}]
    target = {**free, "target": unreachable, "search": {"seconds": 600, **limit}}
    nacre.design.many(target, [(95, 90, 0)], tmp_path / "o")
    assert [row["ended_by"] for row in json.loads((tmp_path / "o" / "many.json").read_text())["rows"]] == [ended_by]


def test_an_interrupt_leaves_finished_rows(tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nacre.design.many(TARGET, [[50, v, 0] for v in range(40)], tmp_path / "o", progress=stop)
    reported = json.loads((tmp_path / "o" / "many.json").read_text())
    assert reported["status"] == "interrupted" and 2 <= reported["done"] < 40 and reported["count"] == 40
    assert all((tmp_path / "o" / row["folder"] / "recipe.toml").is_file() for row in reported["rows"])


def test_a_foreign_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "o" / "1").mkdir(parents=True)
    with pytest.raises(NacreError, match="contains a 1"):
        nacre.design.many(TARGET, LABS, tmp_path / "o")
    (tmp_path / "o" / "1").rmdir()
    (tmp_path / "o" / "many.json").write_text("[]")
    with pytest.raises(NacreError, match="contains a many.json"):
        nacre.design.many(TARGET, LABS, tmp_path / "o")
