"""What the studio's server does apart, in processes of their own: reports, and files to take away."""

from __future__ import annotations

import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_studio import COMMENTED_FILM as FILM
from helpers_studio import PORT, TOKEN
from PIL import Image
from starlette.testclient import TestClient

import nacre
from nacre.light import delta_e_2000
from nacre.measure.colours import geometry_colours
from nacre.measure.geometry import Geometry
from nacre.studio.folder import OpenedFolder
from nacre.studio.server import make_app


@pytest.mark.parametrize("place", ["/api/report", "/api/angles", "/api/formats", "/api/file", "/api/mesh?name=a.obj"])
def test_without_the_token_nothing_is_made(folder: Path, place: str) -> None:
    app = make_app(OpenedFolder.of(str(folder)), TOKEN, PORT)
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}") as stranger:
        assert stranger.post(place, json={"name": "film.toml", "text": FILM}).status_code == 403


REPORTS: list[dict[str, Any]] = [
    {},
    {"recipes": []},
    {"recipes": [{"text": FILM, "name": "film.toml"}] * 3},
    {"recipes": [{"text": FILM}]},
    {"recipes": [{"text": FILM, "name": "../secret.toml"}]},
    {"recipes": [{"text": FILM, "name": "film.toml"}], "lamp": "candle"},
    {"recipes": [{"text": "#" * 400_000, "name": "film.toml"}]},
]


@pytest.mark.parametrize("body", REPORTS)
def test_a_report_that_cannot_be_is_one_line(client: TestClient, body: dict[str, Any]) -> None:
    answer = client.post("/api/report", json=body)
    assert answer.status_code == 422 and "\n" not in answer.json()["error"]


def test_the_report_is_that_of_the_command_and_distinguishes_two_recipes(client: TestClient, folder: Path) -> None:
    other = FILM.replace("300", "290")
    recipes = [{"text": text, "name": "film.toml"} for text in (FILM, other)]
    reported = client.post("/api/report", json={"recipes": recipes, "lamp": "A"}).json()
    (folder / "other.toml").write_text(other)
    wanted = [nacre.report(folder / name, illuminant="A") for name in ("film.toml", "other.toml")]
    for report, own in zip(reported["reports"], wanted, strict=True):
        mirror = next(table for table in report["colours"] if table["kind"] == "specular")
        assert own.specular is not None
        np.testing.assert_allclose(mirror["lab"], own.specular.lab, atol=1e-9)
        assert [name for name, _ in report["numbers"]][:2] == ["flop index (Alman)", "gloss 20 degrees (GU)"]
    assert wanted[0].specular is not None and wanted[1].specular is not None
    far = delta_e_2000(wanted[0].specular.lab, wanted[1].specular.lab)
    np.testing.assert_allclose(reported["differences"]["specular"], far, atol=1e-9)
    wrong = client.post("/api/report", json={"recipes": [{"text": FILM.replace("Si", "Xx"), "name": "film.toml"}]})
    assert wrong.status_code == 422 and "Xx" in wrong.json()["error"] and "\n" not in wrong.json()["error"]


SHEET = {"name": "film.toml", "text": FILM, "verb": "fabricate", "to": "sheet"}
NO_FILES: list[dict[str, Any]] = [
    {},
    {"verb": "design"},
    {"to": "../sheet"},
    {"to": ["sheet"]},
    {"verb": "picture", "to": ".gif"},
    {"verb": "picture", "to": ".png", "scene": "/etc/passwd"},
    {"verb": "picture", "to": ".png", "options": {"width": 100_000}},
    {"verb": "picture", "to": ".png", "options": {"width": 640.5}},
    {"verb": "picture", "to": ".png", "options": {"width": True}},
    {"verb": "picture", "to": ".png", "light": "../map.exr"},
    {"options": []},
    {"options": {"width_mm": 3}},
    {"options": {"levels": "many"}},
    {"lamp": "candle"},
    {"name": "../secret.toml"},
    {"name": "example:../../x"},
    {"text": None},
]


@pytest.mark.parametrize("change", NO_FILES)
def test_a_file_that_cannot_be_is_one_line(client: TestClient, change: dict[str, Any]) -> None:
    answer = client.post("/api/file", json={**SHEET, **change} if change else {})
    assert answer.status_code == 422 and "\n" not in answer.json()["error"]


def test_the_formats_are_those_of_the_material(client: TestClient, folder: Path) -> None:
    np.save(folder / "heights.npy", np.eye(4))
    relief = 'family = "relief"\nheights = "heights.npy"\nfeature_um = 2\nblur_um = 0.6\ncoherence = {sigma = 1}\n'
    found = client.post("/api/formats", json={"name": "film.toml", "text": FILM}).json()
    assert found["fabricate"] == ["sheet"] and {"lut", "gltf", "nacre"} <= set(found["export"])
    found = client.post("/api/formats", json={"name": "relief.toml", "text": relief}).json()
    assert {"stl", "png16", "gds"} <= set(found["fabricate"])
    outside = client.post(
        "/api/formats", json={"name": "a.toml", "text": relief.replace("heights.npy", "../heights.npy")}
    )
    assert outside.status_code == 422 and "outside the opened folder" in outside.json()["error"]


def test_the_layer_sheet_is_that_of_the_command(client: TestClient, folder: Path, tmp_path: Path) -> None:
    answer = client.post("/api/file", json=SHEET)
    assert "film-sheet.csv" in answer.headers["content-disposition"]
    (own,) = nacre.fabricate(folder / "film.toml", "sheet", tmp_path / "own.csv")
    assert answer.content == own.read_bytes()
    assert sorted(path.name for path in folder.iterdir()) == ["film.toml"]


@pytest.mark.full
def test_a_folder_of_tables_comes_as_a_zip_and_says_its_error(client: TestClient) -> None:
    answer = client.post("/api/file", json={**SHEET, "verb": "export", "to": "lut", "lamp": "A"})
    assert "film-lut.zip" in answer.headers["content-disposition"]
    assert any("dE00" in line for line in json.loads(answer.headers["x-nacre-remarks"]))
    with zipfile.ZipFile(io.BytesIO(answer.content)) as held:
        names = held.namelist()
        assert {"film-lut/shader.glsl", "film-lut/table.json"} <= set(names)
        assert json.loads(held.read("film-lut/table.json"))["illuminant"] == "A"
    refused = client.post("/api/file", json={**SHEET, "verb": "export", "to": "merl"})
    assert refused.status_code == 422 and "MERL" in refused.json()["error"]


@pytest.mark.full
@pytest.mark.render
def test_a_picture_comes_at_its_size(client: TestClient) -> None:
    options = {"width": 96, "height": 64, "noise": 0.3, "azimuth": 30, "elevation": 20}
    answer = client.post(
        "/api/file", json={**SHEET, "verb": "picture", "to": ".png", "scene": "knob", "options": options}
    )
    assert Image.open(io.BytesIO(answer.content)).size == (96, 64)


def test_the_page_offers_every_scene_for_its_pictures() -> None:
    from importlib.resources import files

    from nacre.picture.scenes import SCENE_NAMES

    page = files("nacre.studio").joinpath("page/index.html").read_text(encoding="utf-8")
    choice = page.partition('<select id="file-scene">')[2].partition("</select>")[0]
    assert set(re.findall("<option>([a-z]+)</option>", choice)) == set(SCENE_NAMES)


PEARL = """family = "pearl"
strata = [{resin = {n = 1.5}, thickness_um = 20, platelets = [{volume_fraction = 0.01, diameter_um = 25, coatings = [{material = "Al", thickness_nm = 60}], normal_deviation = 0.12}]}]
[[geometry]]
name = "door"
at = "45as30az90"
"""  # noqa: E501


def test_the_panel_of_angles_has_the_numbers_of_the_commands(client: TestClient, folder: Path) -> None:
    question = {"recipe": {"text": PEARL, "name": "pearl.toml"}, "lamp": "A", "fine": True}
    found = client.post("/api/angles", json=question).json()
    (folder / "pearl.toml").write_text(PEARL)
    pearl = nacre.load(folder / "pearl.toml")
    labs = {row["geometry"]: row["lab"] for row in found["colours"]}
    assert {"45as-15", "45as110", "45as25az90", "45as60az-125.3", "door"} <= set(labs)
    at = [Geometry.read(text, "geometry") for text in ("45as15", "45as60az125.3", "45as30az90")]
    walk = geometry_colours(pearl, at, "A")
    own = [labs[name] for name in ("45as15", "45as60az125.3", "door")]
    assert np.max(delta_e_2000(walk, np.array(own))) < 1.5  # noise of the walk, and the surrogate's error
    texture = nacre.texture(pearl, illuminant="A")
    values = found["texture"]["values"]
    assert values["sparkle_45"] == pytest.approx([texture.sparkle["45"].grade, texture.sparkle["45"].grade_error])
    assert values["graininess"] == pytest.approx([texture.graininess.value, texture.graininess.error])
    draft = client.post("/api/angles", json=question | {"fine": False}).json()
    assert draft["texture"]["values"]["sparkle_45"] == [pytest.approx(values["sparkle_45"][0], rel=0.03), None]


def test_the_panel_of_angles_states_why_it_has_no_numbers(client: TestClient) -> None:
    bare = PEARL.replace(", diameter_um = 25", "")
    found = client.post("/api/angles", json={"recipe": {"text": bare, "name": "pearl.toml"}}).json()
    assert len(found["colours"]) == 11 and "diameter_um" in found["texture"]["reason"]
    over = PEARL + '[base]\nmaterial = "Ti"\n'
    found = client.post("/api/angles", json={"recipe": {"text": over, "name": "pearl.toml"}}).json()
    assert found["colours"] == [] and found["texture"]["reason"]  # the light of the base is not known without walks
    film = client.post("/api/angles", json={"recipe": {"text": FILM, "name": "film.toml"}}).json()
    assert film["colours"] == [] and film["texture"]["reason"]
    for recipe in ({"text": "family = 1", "name": "film.toml"}, {"text": FILM, "name": "../secret.toml"}, None):
        answer = client.post("/api/angles", json={"recipe": recipe})
        assert answer.status_code == 422 and "\n" not in answer.json()["error"]
