"""The page's design, gamut and cloud of tolerance: what the server answers, against the command's own machinery."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_studio import COMMENTED_FILM as FILM
from helpers_studio import PORT, TOKEN
from starlette.testclient import TestClient

import nacre
from nacre.analysis.tolerance import recipe_tolerances, run_tolerance
from nacre.light import (
    SRGB_WHITE_XYZ,
    delta_e_2000,
    spectrum_to_xyz,
    srgb_decode,
    srgb_linear_to_xyz,
    white_xyz,
    xyz_to_lab,
)
from nacre.measure.geometry import Geometry
from nacre.optimise.targets import Target
from nacre.recipe.toml import parse_toml
from nacre.studio.design_jobs import distance_to
from nacre.studio.folder import OpenedFolder
from nacre.studio.server import make_app

PARAMETERS = [{"path": f"layers[{i}].thickness_nm", "low": 5, "high": high} for i, high in enumerate((600, 120))]
ASKED: dict[str, Any] = {
    "name": "film.toml", "text": FILM, "geometry": "specular", "parameters": PARAMETERS, "seconds": 2, "solutions": 2,
    "targets": [{"angle": 0, "colour": "#2f7f8f", "tolerance": 2}],
}  # fmt: skip


def events(client: TestClient, kind: str, **change: Any) -> list[dict[str, Any]]:
    answer = client.post(f"/api/{kind}", json={**ASKED, **change})
    assert answer.status_code == 200, answer.text
    return [json.loads(line) for line in answer.text.splitlines()]


@pytest.mark.parametrize("place", ["design", "gamut", "tolerance", "parameters", "stop", "picture"])
def test_without_the_token_nothing_begins(folder: Path, place: str) -> None:
    app = make_app(OpenedFolder.of(str(folder)), TOKEN, PORT)
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}") as stranger:
        assert stranger.post(f"/api/{place}", json=ASKED).status_code == 403


NO_DESIGNS: list[tuple[dict[str, Any], str]] = [
    ({"seconds": 601}, "from 2 to 600"),
    ({"seconds": 0.5}, "from 2 to 600"),
    ({"seconds": "long"}, 'seconds = "long"'),
    ({"seconds": None}, "seconds"),
    ({"solutions": 100}, "from 1 to 6"),
    ({"targets": []}, "1 to 24 target colours"),
    ({"targets": [{"angle": 0, "colour": "#12"}] * 25}, "1 to 24"),
    ({"targets": [{"angle": 0, "colour": "red"}]}, "#rrggbb"),
    ({"targets": [{"angle": 90, "colour": "#112233"}]}, "colour 1: angle = 90"),
    ({"targets": [{"angle": None, "colour": "#112233"}]}, "colour 1: angle"),
    ({"targets": [{"angle": 0, "hue": 400}]}, "colour 1: hue = 400"),
    ({"targets": [{"angle": 0, "hue": 40, "chroma": -1}]}, "colour 1: chroma = -1"),
    ({"targets": ["#112233"]}, "colour 1 is not a table"),
    ({"geometry": "sideways"}, 'geometry "sideways" is not known'),
    ({"lamp": "candle"}, "candle"),
    ({"parameters": []}, "tick the ones that may change"),
    ({"parameters": [{"path": "layers[0].thickness_nm", "low": 5}]}, "both bounds should be numbers"),
    ({"parameters": [{"low": 5, "high": 9}]}, "path, low and high"),
    ({"name": "../film.toml"}, "not a recipe in the opened folder"),
]


@pytest.mark.parametrize("change, words", NO_DESIGNS)
def test_a_design_that_cannot_be_is_one_line(client: TestClient, change: dict[str, Any], words: str) -> None:
    for kind in ("design", "gamut"):
        answer = client.post(f"/api/{kind}", json={**ASKED, **change})
        assert answer.status_code == 422
        assert words in answer.json()["error"] and "\n" not in answer.json()["error"]


def test_layers_are_free_from_5_nm_to_twice_their_thickness(client: TestClient) -> None:
    found = client.post("/api/parameters", json={"name": "film.toml", "text": FILM}).json()
    assert found["geometry"] == "specular" and "refused" not in found
    reported = [(n["path"], n["low"], n["high"], n["about"], n["selected"]) for n in found["parameters"]]
    assert reported == [
        ("layers[0].thickness_nm", 5.0, 600.0, "SiO2", True),
        ("layers[1].thickness_nm", 5.0, 120.0, "TiO2", True),
    ]
    rough = FILM + "\n[surface]\nroughness = 0.8\n"  # at most 1: twice as much is not allowed
    found = client.post("/api/parameters", json={"name": "film.toml", "text": rough}).json()
    number = found["parameters"][-1]
    assert number["path"] == "surface.roughness" and not number["selected"] and 0.8 < number["high"] <= 1.0


def test_heights_of_a_relief_are_left_to_the_command(client: TestClient, folder: Path) -> None:
    np.save(folder / "heights.npy", np.eye(4))
    relief = 'family = "relief"\nheights = "heights.npy"\nfeature_um = 2\nblur_um = 0.6\ncoherence = {sigma = 1}\n'
    found = client.post("/api/parameters", json={"name": "r.toml", "text": relief}).json()
    assert "nacre design" in found["refused"] and "\n" not in found["refused"]


def test_a_range_of_hues_may_cross_0_and_asks_for_chroma() -> None:
    want = Target(Geometry("specular", 0.0), {}, 2.0, 1.0, "", ranges={"hue": (350.0, 10.0), "chroma": (20.0, None)})
    labs = [
        [50.0, c * np.cos(np.radians(h)), c * np.sin(np.radians(h))] for c, h in ((30, 5), (30, 355), (15, 0), (30, 40))
    ]
    found = distance_to(want, np.array(labs))
    np.testing.assert_allclose(found[:2], 0.0, atol=1e-9)
    # by formula, of colours near the edge: 5 of chroma 20, and 30 degrees beyond at chroma 30
    assert found[2] == pytest.approx(float(delta_e_2000([50.0, 20.0, 0.0], labs[2])), abs=0.02)
    edge = [50.0, *(30.0 * np.array([np.cos(np.radians(10)), np.sin(np.radians(10))]))]
    assert 0.8 * float(delta_e_2000(edge, labs[3])) < found[3] <= float(delta_e_2000(edge, labs[3]))


def test_a_lightness_that_is_asked_for_counts_on_the_chart_too() -> None:
    want = Target(
        Geometry("specular", 0.0), {}, 2.0, 1.0, "", ranges={"lightness": (70.0, None), "chroma": (10.0, None)}
    )
    dark, light = distance_to(want, np.array([[40.0, 20.0, 0.0], [75.0, 20.0, 0.0]]))
    assert dark == pytest.approx(float(delta_e_2000([70.0, 20.0, 0.0], [40.0, 20.0, 0.0]))) and light == 0.0


def test_the_answer_that_is_loaded_shows_what_is_said_of_it(client: TestClient) -> None:
    reported = events(client, "design")
    kinds = [event["kind"] for event in reported]
    assert kinds[0] == "begun" and kinds[-2:] == ["ended", "done"] and "final" in kinds
    best = next(event for event in reported if event["kind"] == "final")
    assert "# a comment" in best["text"] and "# oxide" in best["text"]
    data = parse_toml(best["text"], "answer")
    assert all(
        5 <= layer["thickness_nm"] <= free["high"] for layer, free in zip(data["layers"], PARAMETERS, strict=True)
    )
    seen = nacre.spectrum(nacre.material(data), [0.0])
    white = white_xyz("D65")
    lab = xyz_to_lab(spectrum_to_xyz(seen.specular_reflectance, seen.wavelengths_nm, "D65"), white)[0]
    rgb = np.array([int("2f7f8f"[i : i + 2], 16) for i in (0, 2, 4)]) / 255.0
    wanted = xyz_to_lab(srgb_linear_to_xyz(srgb_decode(rgb)), SRGB_WHITE_XYZ)
    (reached,) = best["targets"]
    assert reached["de00"] == pytest.approx(float(delta_e_2000(wanted, lab)), abs=0.3)  # other wavelengths
    assert best["worst"] == reached["de00"] and reached["met"] == (reached["de00"] <= 2)


@pytest.mark.full
def test_a_hue_that_is_drawn_is_the_hue_of_the_answer(client: TestClient) -> None:
    reported = events(client, "design", targets=[{"angle": 0, "hue": 290, "span": 15, "chroma": 25}], seconds=4)
    best = next(event for event in reported if event["kind"] == "final")
    seen = nacre.spectrum(nacre.material(parse_toml(best["text"], "answer")), [0.0])
    _, a, b = xyz_to_lab(spectrum_to_xyz(seen.specular_reflectance, seen.wavelengths_nm, "D65"), white_xyz("D65"))[0]
    assert best["targets"][0]["met"]
    # within 2 dE00 of the range is near enough: some degrees at such a chroma
    assert np.degrees(np.arctan2(b, a)) % 360 == pytest.approx(290, abs=20) and np.hypot(a, b) > 20


@pytest.mark.full
def test_a_part_of_a_blend_may_be_free_and_its_answer_holds_the_part(client: TestClient, folder: Path) -> None:
    (folder / "other.toml").write_text(FILM.replace("300", "150"))
    blend = 'family = "blend"\nfirst = {recipe = "film.toml"}\nsecond = {recipe = "other.toml"}\nmask = 0.5\n'
    found = client.post("/api/parameters", json={"name": "b.toml", "text": blend}).json()
    paths = [number["path"] for number in found["parameters"] if number["selected"]]
    assert "first.layers[0].thickness_nm" in paths and found["geometry"] == "specular"
    parameters = [{"path": "first.layers[0].thickness_nm", "low": 5, "high": 600}]
    reported = events(client, "design", name="b.toml", text=blend, parameters=parameters)
    best = next(event for event in reported if event["kind"] == "final")
    wanted = best["changes"]["first.layers[0].thickness_nm"]
    assert parse_toml(best["text"], "answer")["first"]["layers"][0]["thickness_nm"] == wanted


def test_a_recipe_of_a_design_reaches_no_file_outside_the_folder(client: TestClient) -> None:
    text = FILM.replace('substrate = "Si"', 'substrate = {file = "../secret.csv"}')
    (error,) = events(client, "design", text=text)
    assert error["kind"] == "error" and "outside the opened folder" in error["error"] and "\n" not in error["error"]


NO_ANSWERS: list[tuple[dict[str, Any], str]] = [
    ({"parameters": [{"path": "layers[7].thickness_nm", "low": 5, "high": 50}]}, "layers[7]"),
    ({"parameters": [{"path": "layers[0].thickness_nm", "low": 50, "high": 5}]}, "the bounds cross"),
    ({"geometry": "diffuse"}, "no diffuse reflection"),
    ({"text": FILM.replace("TiO2", "TiO3")}, "TiO3"),
]


@pytest.mark.full
@pytest.mark.parametrize("change, words", NO_ANSWERS)
def test_what_cannot_be_answered_is_one_line(client: TestClient, change: dict[str, Any], words: str) -> None:
    error = events(client, "design", **change)[-1]
    assert error["kind"] == "error" and words in error["error"] and "\n" not in error["error"]


@pytest.mark.full
def test_the_gamut_marks_a_colour_of_its_own_inside_and_one_that_no_surface_has_outside(client: TestClient) -> None:
    # the colour of the recipe itself is reached; a saturated pure blue of sRGB lies beyond two layers on silicon
    reported = events(
        client, "gamut", targets=[{"angle": 0, "colour": "#35006a"}, {"angle": 60, "colour": "#00ff00"}], seconds=12
    )
    limits, first, second, done = reported
    assert (limits["kind"], done["kind"]) == ("limits", "done")
    assert first["geometry"] == "specular 0" and first["targets"][0]["inside"]
    assert second["geometry"] == "specular 60" and not second["targets"][0]["inside"]
    nearest = min(float(delta_e_2000(np.array(second["targets"][0]["lab"]), np.array(p[:3]))) for p in second["points"])
    assert second["targets"][0]["distance"] == pytest.approx(nearest, abs=0.5)  # the points are rounded to 0.1


def test_the_cloud_is_that_of_the_tolerance_command(client: TestClient, folder: Path) -> None:
    answer = client.post("/api/tolerance", json={"name": "film.toml", "text": FILM, "percent": 3, "draws": 20})
    cloud = [json.loads(line) for line in answer.text.splitlines() if '"tolerance"' in line][-1]
    material = nacre.load(folder / "film.toml")
    spreads = recipe_tolerances(material, ("layers[0].thickness_nm=3%", "layers[1].thickness_nm=3%"))
    own = run_tolerance(material, spreads, draws=20, observer="2deg")
    angles = [angle for angle in own.angles_deg if angle in cloud["angles"]]
    assert len(angles) >= 3
    rgb = np.array(cloud["rgb"])
    lab = xyz_to_lab(srgb_linear_to_xyz(rgb), srgb_linear_to_xyz(np.ones(3)))
    for angle in angles:
        here, there = cloud["angles"].index(angle), own.angles_deg.tolist().index(angle)
        # its numbers are rounded to 1e-5, and the white of sRGB
        assert np.max(delta_e_2000(lab[:, here], own.lab[:, there])) < 0.5
        percentile = np.percentile(own.delta_e[:, there], 95)
        assert cloud["percentile_95"][here] == pytest.approx(percentile, abs=0.2)


@pytest.mark.parametrize("change", [{"percent": 80}, {"percent": "2%"}, {"draws": 1e6}, {"lamp": 3}, {"text": None}])
def test_a_cloud_that_cannot_be_is_one_line(client: TestClient, change: dict[str, Any]) -> None:
    answer = client.post("/api/tolerance", json={"name": "film.toml", "text": FILM, **change})
    assert answer.status_code == 422 and "\n" not in answer.json()["error"]


@pytest.mark.full
def test_without_a_spread_the_cloud_is_one_colour_and_the_recipes_own_tolerance_wins(client: TestClient) -> None:
    def most(percent: float, text: str) -> float:
        answer = client.post("/api/tolerance", json={"name": "film.toml", "text": text, "percent": percent, "draws": 8})
        return max([json.loads(line) for line in answer.text.splitlines()][-2]["percentile_95"])

    assert most(0, FILM) == 0.0
    assert most(0, FILM + '[tolerance]\n"layers[0].thickness_nm" = 20\n') > 1.0
