"""Azimuth and polarisation of the light on anisotropic films, handedness, and the filter of rendered pictures."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_studio import PORT, ask, hear
from numpy.typing import NDArray
from PIL import Image
from starlette.testclient import TestClient

import nacre
from nacre.light import spectrum_to_rgb_linear
from nacre.studio.edit import family_form

PLATE = """family = "film"
substrate = 1.5
layers = [{material = {ordinary = 1.5, extraordinary = 1.9, axis_polar_deg = 90}, thickness_nm = 300}]
"""
TWISTED = """family = "film"
substrate = {n = 1.55, k = 0.05}
[[layers]]
material = {ordinary = 1.5, extraordinary = 1.7, axis_polar_deg = 90}
thickness_nm = 3000
pitch_nm = 340
handedness = "right"
[wavelengths]
step_nm = 20
"""
SOCKET = f"ws://127.0.0.1:{PORT}/ws"
SHOWN_DEG = [0.0, 30.0, 60.0]
SINGLE = 1e-6  # the page's arrays are in single precision


def answer(client: TestClient, text: str, **question: Any) -> dict[str, Any]:
    with client.websocket_connect(SOCKET) as socket:
        found = ask(socket, 1, text=text, **question)
        while found.get("draft"):
            found = hear(socket)
    return found


def test_colours_and_spectra_are_those_at_the_azimuth(client: TestClient, tmp_path: Path) -> None:
    (tmp_path / "plate.toml").write_text(PLATE)
    seen = {azimuth: answer(client, PLATE, azimuth_deg=azimuth) for azimuth in (0, 90)}
    for azimuth, look in seen.items():
        found = nacre.spectrum(tmp_path / "plate.toml", SHOWN_DEG, azimuth_deg=azimuth)
        assert found.specular_reflectance is not None
        np.testing.assert_allclose(look["total"], found.specular_reflectance, atol=SINGLE)
        wanted = spectrum_to_rgb_linear(found.specular_reflectance, found.wavelengths_nm)
        np.testing.assert_allclose(look["mirror"][[0, 30, 60]], wanted, atol=1e-4)  # the white of sRGB is rounded
        assert look["incidence"] == {"azimuth_deg": azimuth, "polarisation": "both"} and "polarised" not in look
    assert np.abs(seen[0]["total"][2] - seen[90]["total"][2]).max() > 0.01


@pytest.mark.parametrize("polarisation", ["s", "p", "left", "right"])
def test_the_chart_shows_the_selected_polarisation_and_colours_stay(
    client: TestClient, tmp_path: Path, polarisation: str
) -> None:
    (tmp_path / "plate.toml").write_text(PLATE)
    plain, look = (answer(client, PLATE, azimuth_deg=30, polarisation=each) for each in ("both", polarisation))
    found = nacre.spectrum(tmp_path / "plate.toml", SHOWN_DEG, polarisation=polarisation, azimuth_deg=30)
    assert found.specular_reflectance is not None
    np.testing.assert_allclose(look["polarised"], found.specular_reflectance, atol=SINGLE)
    np.testing.assert_array_equal(look["mirror"], plain["mirror"])
    assert look["swatches"] == plain["swatches"]


def test_handedness_is_a_field_with_two_choices_and_exchanges_the_circular_spectra(client: TestClient) -> None:
    keys = {key["name"]: key for key in family_form("film")["tables"]["film.LayerSpec"]["keys"]}
    assert keys["handedness"]["kind"] == "choice" and keys["handedness"]["choices"] == ["right", "left"]
    edit = [{"op": "set", "path": "layers[0].handedness", "value": "left"}]
    right = {each: answer(client, TWISTED, polarisation=each)["polarised"][0] for each in ("left", "right")}
    other = answer(client, TWISTED, edits=edit, polarisation="left")
    assert other["data"]["layers"][0]["handedness"] == "left"
    np.testing.assert_allclose(other["polarised"][0], right["right"], atol=SINGLE)
    assert right["right"].max() > 0.5 > 5 * right["left"].max()  # selective reflection of the screw's own hand


def test_an_isotropic_film_ignores_azimuth_and_polarisation(client: TestClient) -> None:
    with client.websocket_connect(SOCKET) as socket:
        plain, look = ask(socket, 1), ask(socket, 2, azimuth_deg=40, polarisation="left")
    assert look["incidence"] is None and "polarised" not in look
    np.testing.assert_array_equal(plain["mirror"], look["mirror"])


def test_manufactured_materials_are_seen_from_the_same_azimuth(client: TestClient) -> None:
    look = answer(client, PLATE, azimuth_deg=90)
    body = {"text": PLATE, "name": "film.toml", "percent": 0, "draws": 4, "azimuth_deg": 90}
    found = client.post("/api/tolerance", json=body)
    last = next(event for event in map(json.loads, found.text.splitlines()[::-1]) if event["kind"] == "tolerance")
    angles = np.array(last["angles"]).round().astype(int)
    drawn = np.array(last["rgb"])[0]
    np.testing.assert_allclose(drawn[angles < 85], look["mirror"][angles[angles < 85]], atol=1e-3)
    assert client.post("/api/tolerance", json={**body, "azimuth_deg": "x"}).status_code == 422


@pytest.mark.parametrize(
    "wrong",
    [
        *({"azimuth_deg": value} for value in ("north", 361, -1e9, 10**400, float("nan"), True, None, [1])),
        *({"polarisation": value} for value in ("x", "mueller", "", 3, ["s"], "s\np", "l" * 9999)),
    ],
)
def test_a_wrong_azimuth_or_polarisation_is_one_line(client: TestClient, wrong: dict[str, Any]) -> None:
    with client.websocket_connect(SOCKET) as socket:
        found = ask(socket, 1, text=PLATE, **wrong)
        assert next(iter(wrong)) in found["error"] and found["text"] == PLATE
        assert "\n" not in found["error"] and len(found["error"]) < 200 and "Traceback" not in found["error"]
        assert "error" not in ask(socket, 2, text=PLATE)


@pytest.mark.parametrize("wrong", ["up", "", 400, 10**400, float("nan"), True, [], {"left": 1}, "x\ny" * 9999])
@pytest.mark.parametrize("route", ["/api/picture", "/api/file"])
def test_a_wrong_filter_is_one_line(client: TestClient, route: str, wrong: Any) -> None:
    body = {"text": TWISTED, "name": "film.toml", "verb": "picture", "to": ".png", "polariser": wrong}
    found = client.post(route, content=json.dumps(body))
    assert found.status_code == 422
    error = found.json()["error"]
    assert "polariser" in error and "\n" not in error and len(error) < 200


@pytest.mark.full
@pytest.mark.render
def test_a_right_handed_film_is_bright_through_a_right_filter_only(client: TestClient) -> None:
    seen = {each: rendered(client, polariser=each).mean() for each in ("right", "left")}
    assert seen["right"] > 1.3 * seen["left"]


def rendered(client: TestClient, **filtered: Any) -> NDArray[np.float64]:
    """Return the pixels of a small rendered sphere about its highlights."""
    body = {"text": TWISTED, "name": "film.toml", "size": 128, "seconds": 1, **filtered}
    found = client.post("/api/picture", json=body)
    assert found.status_code == 200, found.text
    last = [json.loads(line) for line in found.text.splitlines() if '"png"' in line][-1]
    picture = Image.open(io.BytesIO(base64.b64decode(last["png"].partition(",")[2])))
    return np.asarray(picture, dtype=float)[48:80, 48:80]
