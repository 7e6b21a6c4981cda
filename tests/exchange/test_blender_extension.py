"""The Blender extension: its zip, the jobs it starts, and its use inside bpy where that is installed."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError
from nacre.studio import blender

ROOT = Path(__file__).resolve().parents[2]
OXIDE = """family = "film"
substrate = "Ti"
layers = [{material = "TiO2-film", thickness_nm = 120}]
[surface]
roughness = 0.15
"""
BPY = Path(os.environ.get("NACRE_BPY_PYTHON", ROOT / ".venv-cycles" / "bin" / "python"))


@pytest.fixture
def oxide(tmp_path: Path) -> Path:
    path = tmp_path / "oxide.toml"
    path.write_text(OXIDE)
    return path


def events(function: str, request: dict[str, object]) -> list[dict[str, object]]:
    """Start a job as the extension does: its input stays open until the last event."""
    command = [sys.executable, "-m", "nacre.studio.subprocess_jobs", f"nacre.studio.blender:{function}"]
    reported: list[dict[str, object]] = []
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as job:
        assert job.stdin is not None and job.stdout is not None
        job.stdin.write(json.dumps(request).encode() + b"\n")
        job.stdin.flush()
        for line in job.stdout:
            reported.append(json.loads(line))
            if reported[-1].get("kind") in ("done", "error"):
                break
    return reported


def test_the_zip_has_a_manifest_of_blenders_schema_and_the_solved_recipe(oxide: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.zip", tmp_path / "b.zip"
    for path in (first, second):
        blender.write_extension(path, [str(oxide)])
    held = zipfile.ZipFile(first)
    assert held.testzip() is None
    manifest = tomllib.loads(held.read("blender_manifest.toml").decode())
    assert {"schema_version", "id", "version", "name", "tagline", "maintainer", "type", "license"} <= set(manifest)
    assert manifest["schema_version"] == "1.0.0" and manifest["type"] == "add-on"
    assert tuple(map(int, manifest["blender_version_min"].split("."))) >= (4, 2, 0)
    assert len(manifest["tagline"]) <= 64 and not manifest["tagline"].endswith(".")
    assert nacre.__version__.startswith(manifest["version"])
    assert all(number.isdigit() for number in manifest["version"].split("."))
    ast.parse(held.read("__init__.py"))
    facts = json.loads(held.read("library/oxide/material.json"))
    assert [(n["path"], n["value"], n["is_axis"]) for n in facts["numbers"]] == [
        ("layers[0].thickness_nm", 120.0, True), ("surface.roughness", 0.15, False),
    ]  # fmt: skip
    assert {"library/oxide/table/blender.py", "library/oxide/table/map.exr"} <= set(held.namelist())
    names = [name for name in held.namelist() if not name.endswith(("material.json", ".exr", ".png"))]
    assert names == [n for n in zipfile.ZipFile(second).namelist() if not n.endswith(("material.json", ".exr", ".png"))]


def test_the_axis_of_the_table_holds_the_colour_of_each_value(oxide: Path, tmp_path: Path) -> None:
    """The mean colour of the table's row at a value is that of a material solved at that value."""
    material = nacre.load(oxide)
    numbers = blender.free_numbers(material)
    table, axis = blender.solved_table(material, numbers, "auto", lambda what: None)
    low, high = numbers[0]["low"], numbers[0]["high"]
    assert axis == "layers[0].thickness_nm" and table.parameter is not None
    for value in (60.0, 120.0, 220.0):
        alone, _ = blender.solved_table(material.vary({axis: value}), [], "", lambda what: None)
        x = np.linspace(0.0, 0.9, 19)
        column = (value - low) / (high - low)
        place = table.pictures["map"].at(np.array([column]), np.array([0.5]))[0, 0]
        seen = table.pictures["mirror"].at(x, np.full(x.shape, place))
        wanted = alone.pictures["mirror"].at(x, np.full(x.shape, 0.5))
        assert np.abs(seen - wanted).max() < 0.02  # a tenth of the least difference between two neighbouring hues


def test_a_job_reports_progress_and_writes_numbers_and_thumbnail(oxide: Path, tmp_path: Path) -> None:
    folder = tmp_path / "solved"
    request = {"recipe": str(oxide), "folder": str(folder), "numbers": {"surface.roughness": 0.3}}
    reported = events("solve", request)
    assert reported[0]["kind"] == "progress" and reported[-1] == {"kind": "done"}
    facts = json.loads((folder / "material.json").read_text())
    assert {n["path"]: n["value"] for n in facts["numbers"]}["surface.roughness"] == 0.3
    picture = np.asarray(Image.open(folder / "thumbnail.png"))
    assert picture.shape == (128, 128, 4) and picture[64, 64, 3] == 255 and picture[0, 0, 3] == 0
    assert picture[64, 64, :3].max() > 40


def test_a_job_ends_with_the_error_of_a_bad_number_and_writes_nothing(oxide: Path, tmp_path: Path) -> None:
    folder = tmp_path / "solved"
    reported = events("solve", {"recipe": str(oxide), "folder": str(folder), "numbers": {"surface.roughness": 7.0}})
    assert reported[-1]["kind"] == "error" and "surface.roughness" in str(reported[-1]["error"])
    assert not folder.exists()


def test_a_brushed_film_keeps_its_azimuth_and_has_no_axis() -> None:
    material = nacre.load("morpho-film")
    table, axis = blender.solved_table(material, blender.free_numbers(material), "auto", lambda what: None)
    assert axis == "" and {picture.rows for picture in table.pictures.values()} >= {"azimuth"}


def test_thumbnails_are_written_and_stay_empty_for_what_a_table_cannot_hold(oxide: Path, tmp_path: Path) -> None:
    names = [str(oxide), "relief/star", "no-such-recipe"]
    request = {"recipes": [{"recipe": one, "file": str(tmp_path / "t" / f"{i}.png")} for i, one in enumerate(names)]}
    reported = events("thumbnails", request)
    assert [event["kind"] for event in reported] == ["progress"] * 3 + ["done"]
    assert np.asarray(Image.open(tmp_path / "t" / "0.png")).shape == (128, 128, 4)
    assert [(tmp_path / "t" / f"{i}.png").stat().st_size for i in (1, 2)] == [0, 0]


def test_the_library_lists_examples_and_own_recipes_and_names_broken_ones(oxide: Path, tmp_path: Path) -> None:
    (tmp_path / "broken.toml").write_text("family = ")
    found = json.loads(blender.library({"folders": [str(tmp_path)]}, lambda event: None))
    by_name = {entry["name"]: entry for entry in found}
    assert by_name["soap"]["family"] == "film" and by_name["oxide"]["family"] == "film"
    assert by_name["broken"]["family"] == "" and by_name["broken"]["about"]


def test_an_axis_that_is_no_number_is_refused(oxide: Path, tmp_path: Path) -> None:
    with pytest.raises(RecipeError):
        blender.solve({"recipe": str(oxide), "folder": str(tmp_path / "x"), "axis": "substrate"}, lambda event: None)


def test_a_file_comes_before_the_example_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "copper.toml").write_text(OXIDE)
    monkeypatch.chdir(tmp_path)
    files = blender.write_extension(tmp_path / "a.zip", ["copper.toml"])
    facts = json.loads(zipfile.ZipFile(tmp_path / "a.zip").read(next(f for f in files if f.endswith("material.json"))))
    assert Path(facts["recipe"]) == tmp_path / "copper.toml"


def test_the_command_writes_the_zip_and_refuses_what_a_table_cannot_hold(tmp_path: Path) -> None:
    path = tmp_path / "extension.zip"
    assert run(["blender", "-o", str(path)]) == 0
    assert zipfile.ZipFile(path).namelist() == ["blender_manifest.toml", "__init__.py"]
    other = tmp_path / "other.zip"
    assert run(["blender", "relief/star", "-o", str(other)]) == 2
    assert run(["blender", "no-such-recipe", "-o", str(other)]) == 2
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "oxide.toml").write_text(OXIDE)
    assert run(["blender", *(str(tmp_path / name / "oxide.toml") for name in ("a", "b")), "-o", str(other)]) == 2
    assert not other.exists()
    with pytest.raises(NacreError):
        blender.write_extension(tmp_path / "none" / "a.zip")


@pytest.mark.full
@pytest.mark.skipif(not BPY.exists(), reason="bpy is in an environment of its own: NACRE_BPY_PYTHON or .venv-cycles")
def test_the_extension_installs_assigns_changes_renders_and_bakes_in_blender(oxide: Path, tmp_path: Path) -> None:
    path, folder = tmp_path / "extension.zip", tmp_path / "blender"
    folder.mkdir()
    blender.write_extension(path, [str(oxide)])
    own = tmp_path / "recipes"
    own.mkdir()
    recipe = Path(oxide.rename(own / "oxide.toml"))
    worker = Path(__file__).with_name("blender_worker.py")
    environment = {**os.environ, "NACRE_PYTHON": sys.executable, "NACRE_PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(
        [str(BPY), str(worker), str(path), str(folder), str(recipe)], capture_output=True, text=True, timeout=500,
        env={name: value for name, value in environment.items() if name != "PYTHONPATH"},
    )  # fmt: skip
    line = next((line for line in done.stdout.splitlines() if line.startswith("FOUND ")), None)
    assert line is not None, done.stdout[-1500:] + done.stderr[-3000:]
    found = json.loads(line[6:])
    assert found["assign"] == found["refresh"] == found["assign_own"] == found["solve"] == found["reimport"] == ""
    assert found["group"] == ["ShaderNodeTree", ["layers[0].thickness_nm"]]
    assert np.abs(np.subtract(found["before"], found["after"])).max() > 0.1
    assert found["input"] == found["clamped"] == pytest.approx(300.0)
    assert "nacre" in found["no_recipe"] or found["no_recipe"]
    assert "pip install nacre" in found["absent"]
    assert found["cancel"] == [True, "cancelled", True]
    assert {"soap", "oxide"} <= set(found["listed"])
    assert found["thumbnails"] == ""
    assert [size > 0 for size in found["sizes"]] == [True, True, False]  # the zip's, made here, and a relief
    assert found["items"] == ["oxide", str(recipe), "relief/star"]
    assert found["own_numbers"]["layers[0].thickness_nm"] == [120.0, True]
    assert found["solved"] == pytest.approx(0.4) and found["thumbnail"] and found["kept"]
    assert "surface.roughness" in found["refused"]
    assert found["is_stale"] and found["reimported"] == 80.0
    assert found["unsaved"] and found["bake"] == ""
    assert all(name.startswith("//nacre/") for name in found["images"])
    assert max(found["baked"]) > 0.1 and found["disabled"]
