"""What the studio's server answers, and to whom: token, host, origin, fence, order of answers, bad input."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers_studio import COMMENTED_FILM as FILM
from helpers_studio import ask, hear
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import nacre
from nacre.core.errors import NacreError
from nacre.families.registry import FAMILIES
from nacre.light import delta_e_2000, spectrum_to_rgb_linear, spectrum_to_srgb, srgb_to_hex
from nacre.recipe.toml import parse_toml
from nacre.studio.appearance import appearances
from nacre.studio.edit import edited, family_form, line_of
from nacre.studio.folder import STARTS, OpenedFolder
from nacre.studio.server import HEADER, json_data, make_app
from nacre.studio.subprocess_jobs import SupersededError
from nacre.studio.surroundings import ALPHAS, LAYERS, blurred_surroundings

PORT, TOKEN = 8123, "a-token-for-the-tests"
SOCKET = f"ws://127.0.0.1:{PORT}/ws"
HERE = f"http://127.0.0.1:{PORT}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inside = tmp_path / "recipes"
    inside.mkdir()
    (inside / "film.toml").write_text(FILM)
    (inside / "broken.toml").write_text('family = "film"\nsubstrate = \n')
    (inside / "sweep.toml").write_text('recipe = "film.toml"\n')
    (tmp_path / "secret.toml").write_text(FILM)
    (tmp_path / "secret.csv").write_text("400,1.5,0\n700,1.5,0\n")
    return inside


@pytest.fixture
def page(folder: Path) -> Iterator[TestClient]:
    with TestClient(
        make_app(OpenedFolder.of(str(folder)), TOKEN, PORT), base_url=HERE, headers={HEADER: TOKEN}
    ) as client:
        yield client


@pytest.fixture
def stranger(folder: Path) -> Iterator[TestClient]:
    with TestClient(
        make_app(OpenedFolder.of(str(folder)), TOKEN, PORT), base_url=HERE, follow_redirects=False
    ) as client:
        yield client


PLACES = [
    "/",
    "/page/main.js",
    "/api/state",
    "/api/recipe?name=film.toml",
    "/api/form?family=film",
    "/api/indices?q=Ti",
]


@pytest.mark.parametrize("place", [*PLACES, "/api/surroundings", "/nothing"])
@pytest.mark.parametrize("token", [{}, {HEADER: "wrong"}, {"cookie": f"nacre_studio_{PORT}=wrong"}])
def test_without_the_token_everything_is_refused(stranger: TestClient, place: str, token: dict[str, str]) -> None:
    assert stranger.get(place, headers=token).status_code == 403


def test_the_first_visit_moves_the_token_into_a_cookie_and_out_of_the_address(stranger: TestClient) -> None:
    first = stranger.get(f"/?token={TOKEN}")
    assert first.status_code == 200
    assert TOKEN not in first.text
    assert "url=/" in first.text
    cookie = first.headers["set-cookie"].lower()
    assert "httponly" in cookie and "samesite=strict" in cookie
    again = stranger.get("/")  # the client keeps cookies as a browser does
    assert again.status_code == 200 and TOKEN not in again.text
    assert stranger.get("/?token=wrong", headers={"cookie": ""}).status_code == 403


@pytest.mark.parametrize(
    "headers", [{"host": "evil.example"}, {"host": f"evil.example:{PORT}"}, {"host": "127.0.0.1:1"}, {"host": ""}]
)
def test_a_foreign_host_is_refused_even_with_the_token(page: TestClient, headers: dict[str, str]) -> None:
    assert page.get("/api/state", headers=headers).status_code == 403


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_the_three_names_of_loopback_are_answered(page: TestClient, host: str) -> None:
    own = {"host": f"{host}:{PORT}", "origin": f"http://{host}:{PORT}"}
    assert page.get("/api/state", headers=own).status_code == 200


ORIGINS = ["http://evil.example", "null", f"https://127.0.0.1:{PORT}", "http://127.0.0.1:9", f"http://localhost:{PORT}"]


@pytest.mark.parametrize("origin", ORIGINS)
def test_a_foreign_origin_is_refused_even_with_the_token(page: TestClient, origin: str) -> None:
    assert page.post("/api/save", headers={"origin": origin}, json={}).status_code == 403
    with pytest.raises(WebSocketDisconnect), page.websocket_connect(SOCKET, headers={"origin": origin}):
        pass


@pytest.mark.parametrize("site", ["same-site", "cross-site"])
def test_what_another_servers_page_asks_for_is_refused_even_with_the_token(page: TestClient, site: str) -> None:
    """As an image or a script, which has no origin; a page on another port of this host is sent our cookie."""
    asked = {"sec-fetch-site": site, "sec-fetch-mode": "no-cors", "sec-fetch-dest": "image"}
    assert page.get("/api/surroundings?name=sky", headers=asked).status_code == 403
    assert page.get("/", headers=asked).status_code == 403
    framed = {**asked, "sec-fetch-mode": "navigate", "sec-fetch-dest": "iframe"}
    assert page.get("/", headers=framed).status_code == 403
    led = {**framed, "sec-fetch-dest": "document"}
    assert page.get("/", headers=led).status_code == 200 and page.get("/api/state", headers=led).status_code == 403
    with pytest.raises(WebSocketDisconnect), page.websocket_connect(SOCKET, headers={"origin": HERE, **asked}):
        pass
    for own in ("none", "same-origin"):
        assert page.get("/api/state", headers={"sec-fetch-site": own}).status_code == 200


def test_a_socket_needs_the_token_and_an_origin(stranger: TestClient) -> None:
    for headers in ({}, {"origin": HERE}, {"cookie": f"nacre_studio_{PORT}={TOKEN}"}):
        with pytest.raises(WebSocketDisconnect), stranger.websocket_connect(SOCKET, headers=headers):
            pass
    with stranger.websocket_connect(SOCKET, headers={"origin": HERE, "cookie": f"nacre_studio_{PORT}={TOKEN}"}) as ws:
        assert ask(ws, 1)["seq"] == 1


def test_the_page_may_load_nothing_from_elsewhere(page: TestClient) -> None:
    for place in PLACES:
        policy = page.get(place).headers["content-security-policy"]
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy and "http" not in policy and "*" not in policy
    text = page.get("/").text
    assert "<script>" not in text and " style=" not in text and "//" not in text.replace("<!-- ", "")


OUTSIDE = ["../secret.toml", "/etc/passwd", "../recipes/../secret.toml", "film.toml/../../secret.toml", "", "a\0.toml"]


@pytest.mark.parametrize("name", [*OUTSIDE, "example:../README", "example:/etc/passwd"])
def test_no_name_leads_out_of_the_folder(page: TestClient, name: str) -> None:
    assert page.get("/api/recipe", params={"name": name}).status_code == 422
    assert page.post("/api/save", json={"name": name, "text": "x", "version": ""}).status_code == 422


def test_a_link_in_the_folder_leads_not_out_of_it(page: TestClient, folder: Path) -> None:
    (folder / "link.toml").symlink_to(folder.parent / "secret.toml")
    assert page.get("/api/recipe", params={"name": "link.toml"}).status_code == 422


@pytest.mark.parametrize("name", ["../server.py", "..%2fserver.py", "%2e%2e/server.py", "main.js/../../server.py"])
def test_only_files_of_the_page_are_served(page: TestClient, name: str) -> None:
    assert page.get(f"/page/{name}").status_code == 404


@pytest.mark.parametrize("file", ["../secret.csv", "/etc/passwd"])
def test_a_recipe_reaches_no_file_outside_the_folder(page: TestClient, folder: Path, file: str) -> None:
    text = f'family = "film"\nsubstrate = {{file = "{file}"}}\n'
    nested = 'family = "blend"\nfirst = {recipe = "../secret.toml"}\nsecond = {recipe = "film.toml"}\nmask = 0.5\n'
    with page.websocket_connect(SOCKET) as ws:
        assert "outside the opened folder" in ask(ws, 1, text=text)["error"]
        assert "outside the opened folder" in ask(ws, 2, text=nested)["error"]
    (folder / "inside.csv").write_text((folder.parent / "secret.csv").read_text())
    with page.websocket_connect(SOCKET) as ws:
        reported = ask(ws, 1, text='family = "film"\nsubstrate = {file = "inside.csv"}\n')
    assert "outside" not in reported.get("error", "")


def test_the_table_is_the_colour_of_the_spectrum(page: TestClient, folder: Path) -> None:
    with page.websocket_connect(SOCKET) as ws:
        look = ask(ws, 7)
    assert look["seq"] == 7 and look["draft"] is False
    found = nacre.spectrum(folder / "film.toml", [0.0, 45.0, 60.0])
    assert found.specular_reflectance is not None
    wanted = spectrum_to_rgb_linear(found.specular_reflectance, found.wavelengths_nm)
    np.testing.assert_allclose(look["mirror"][[0, 45, 60]], wanted, atol=1e-4)  # the white of sRGB is rounded
    np.testing.assert_allclose(look["total"][2], found.specular_reflectance[2], atol=1e-6)
    d65 = next(swatch for swatch in look["swatches"] if swatch["lamp"] == "D65")
    assert d65["hex"][0] == srgb_to_hex(spectrum_to_srgb(found.specular_reflectance, found.wavelengths_nm)[0])
    assert not look["spread"].any()


def test_another_lamp_gives_other_swatches_of_the_same_spectrum(page: TestClient) -> None:
    with page.websocket_connect(SOCKET) as ws:
        day, lamp = ask(ws, 1), ask(ws, 2, lamp="F11")
    np.testing.assert_array_equal(day["total"], lamp["total"])
    assert np.abs(day["mirror"] - lamp["mirror"]).max() > 0.01


def test_an_answer_states_the_difference_from_a_stored_version(page: TestClient) -> None:
    with page.websocket_connect(SOCKET) as ws:
        kept = [swatch["lab"] for swatch in ask(ws, 1)["swatches"]]
        assert not np.any(ask(ws, 2, compared_lab=kept)["difference"])
        other = ask(ws, 3, compared_lab=kept, text=FILM.replace("300", "290"))
        far = delta_e_2000(np.array(kept), np.array([swatch["lab"] for swatch in other["swatches"]]))
        np.testing.assert_allclose(other["difference"], far, atol=0.006)  # two digits
        assert far.min() > 1
        for nonsense in ([], "x", [[1, 2]], [[[None] * 3] * 3] * 3, [[[1e300] * 3] * 3] * 3):
            assert "difference" not in ask(ws, 4, compared_lab=nonsense)


def test_changes_are_written_into_the_text_and_its_comments_stay(page: TestClient) -> None:
    change = [{"op": "set", "path": "layers[0].thickness_nm", "value": 123.5}]
    with page.websocket_connect(SOCKET) as ws:
        look = ask(ws, 1, edits=change)
    assert look["data"]["layers"][0]["thickness_nm"] == 123.5
    assert "# oxide" in look["text"] and "# a comment" in look["text"] and "123.5" in look["text"]


def test_layers_are_added_moved_and_taken_out() -> None:
    new = {"material": "Ag", "thickness_nm": 12}
    text = edited(FILM, [{"op": "insert", "path": "layers", "index": 1, "value": new}], "film.toml")
    text = edited(text, [{"op": "move", "path": "layers", "from": 1, "to": 0}], "film.toml")
    text = edited(text, [{"op": "remove", "path": "layers[2]"}], "film.toml")
    assert [layer["material"] for layer in nacre_data(text)["layers"]] == ["Ag", "SiO2"]
    strata = 'family = "pearl"\n[[strata]]\nresin = "PET"\n[[strata]]\nresin = "water"\n[base]\nalbedo = 0.5\n'
    moved = edited(strata, [{"op": "move", "path": "strata", "from": 0, "to": 1}], "p.toml")
    assert [s["resin"] for s in nacre_data(moved)["strata"]] == ["water", "PET"]
    assert nacre_data(moved)["base"] == {"albedo": 0.5}
    added = edited(FILM, [{"op": "set", "path": "surface.roughness", "value": 0.1}], "film.toml")
    assert nacre_data(added)["surface"] == {"roughness": 0.1}


def nacre_data(text: str) -> dict[str, Any]:
    return parse_toml(text, "recipe")


BAD_EDITS = [
    {"path": "nothing[3].x", "op": "set", "value": 1},
    {"path": "layers", "op": "insert", "index": 9, "value": {}},
    {"path": "layers", "op": "dance"},
    {"op": "set"},
    {"path": "substrate", "op": "move", "from": 0, "to": 1},
    {"path": "layers[0].thickness_nm", "op": "set", "value": None},
]


@pytest.mark.parametrize("edit", BAD_EDITS)
def test_an_impossible_change_is_one_line(edit: dict[str, Any]) -> None:
    with pytest.raises(NacreError, match="film.toml"):
        edited(FILM, [edit], "film.toml")


GRATING = """# lines
family = "grating"
substrate = "glass"
lattice = {period_nm = 400}
layers = [{thickness_nm = 80, material = "air", shapes = [SHAPE]}]  # one layer
"""


def test_another_shape_of_a_grating_has_the_size_of_the_former_one() -> None:
    for old in ('shape = "line", width_nm = 120', 'shape = "disc", diameter_um = 0.12',
                'shape = "ellipse", size_nm = [120, 90], rotation_deg = 20',
                'shape = "cross", width_nm = 40, length_nm = 120'):  # fmt: skip
        recipe = GRATING.replace("SHAPE", f'{{material = "Si", {old}}}')
        for new in ("line", "rectangle", "disc", "ellipse", "ring", "cross", "polygon"):
            text = edited(recipe, [{"path": "layers[0].shapes[0].shape", "value": new}], "recipe")
            shape = nacre.material(parse_toml(text, "recipe")).get("layers[0].shapes[0]")
            across = shape.get("diameter_nm", shape["length_nm"] if new == "cross" else shape.get("width_nm", 120.0))
            assert (shape["shape"], across, "# one layer" in text) == (new, pytest.approx(120.0), True)


@pytest.mark.parametrize("new", ["sinusoidal", "triangle", "blazed", "trapezoid"])
def test_another_profile_of_a_grating_keeps_its_depth(new: str) -> None:
    recipe = 'family = "grating"\nsubstrate = "Al"\nlattice = {period_nm = 800}\n[profile]\n'
    for old in (
        'shape = "triangle"\ndepth_nm = 90\napex = 0.3',
        'shape = "trapezoid"\ndepth_nm = 90\ntop = 0.2\nbottom = 0.3',
    ):
        text = edited(f"{recipe}{old}\n", [{"path": "profile.shape", "value": new}], "recipe")
        assert nacre.material(parse_toml(text, "recipe")).get("profile.depth_nm") == 90


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('family = "film"\nsubstrate = \n', 2),
        (FILM.replace('"TiO2"', '"TiO3"'), 5),
        (FILM.replace("thickness_nm = 60", "thickness_nm = -60"), 5),
        (FILM.replace("substrate", "substrat"), 2),
        (FILM.replace('"Si"', '"Sii"'), 2),
    ],
)
def test_a_broken_recipe_is_reported_with_its_line(page: TestClient, text: str, line: int) -> None:
    with page.websocket_connect(SOCKET) as ws:
        reported = ask(ws, 3, text=text)
        assert reported["line"] == line and "\n" not in reported["error"] and reported["seq"] == 3
        assert "Traceback" not in reported["error"] and "bug" not in reported["error"]
        assert ask(ws, 4)["seq"] == 4  # and the session goes on


def test_a_mistaken_number_of_the_form_stays_in_the_text_with_its_line(page: TestClient) -> None:
    edit = {"op": "set", "path": "layers[1].thickness_nm", "value": -60}
    with page.websocket_connect(SOCKET) as ws:
        reported = ask(ws, 1, edits=[edit])
        assert "thickness_nm = -60" in reported["text"] and reported["line"] == 5
        assert reported["data"]["layers"][1]["thickness_nm"] == -60
        mended = ask(ws, 2, text=reported["text"], edits=[{**edit, "value": 61}])
        assert "thickness_nm = 61" in mended["text"] and "error" not in mended


def test_a_message_without_a_key_has_no_line() -> None:
    assert line_of(FILM, "not enough memory") is None


def test_a_newer_question_ends_a_slow_answer() -> None:
    """The slow one stops between its parts: nothing of it may come after the newer one."""
    pearl = nacre.load("pearl/bottle3").vary({"strata[0].platelets[0].volume_fraction": 0.02})
    with pytest.raises(SupersededError):
        list(appearances(pearl, "D65", lambda: True))


def test_answers_come_in_the_order_of_their_questions(page: TestClient) -> None:
    with page.websocket_connect(SOCKET) as ws:
        for seq in range(30):
            edits = [{"path": "layers[0].thickness_nm", "value": 200 + seq}]
            ws.send_text(json.dumps({"seq": seq, "name": "film.toml", "text": FILM, "edits": edits}))
        heard = [hear(ws)["seq"]]
        while heard[-1] != 29:
            heard.append(hear(ws)["seq"])
    assert heard == sorted(set(heard))


def test_two_pages_do_not_hear_each_other(page: TestClient) -> None:
    with page.websocket_connect(SOCKET) as one, page.websocket_connect(SOCKET) as two:
        edits = [{"path": "layers[0].thickness_nm", "value": 500}]
        first, second = ask(one, 1), ask(two, 1, edits=edits)
    assert first["data"]["layers"][0]["thickness_nm"] == 300
    assert second["data"]["layers"][0]["thickness_nm"] == 500


@pytest.mark.parametrize("message", ["no json", "[]", "{}", '{"seq": "1"}', "[" * 100_000, '{"seq": 1' + " " * 700_000])
def test_nonsense_on_the_socket_closes_it(page: TestClient, message: str) -> None:
    with page.websocket_connect(SOCKET) as ws:
        ws.send_text(message)
        assert ws.receive()["type"] == "websocket.close"


def test_a_large_recipe_is_refused_before_it_is_read(page: TestClient) -> None:
    with page.websocket_connect(SOCKET) as ws:
        assert "at most" in ask(ws, 1, text="#" * 400_000)["error"]
    big = {"name": "big.toml", "text": "#" * 400_000, "version": ""}
    assert page.post("/api/save", json=big).status_code == 422
    assert page.post("/api/save", content=b" " * 2_000_000).status_code == 422


def test_saving_never_overwrites_what_the_page_has_not_read(page: TestClient, folder: Path) -> None:
    read = page.get("/api/recipe", params={"name": "film.toml"}).json()
    assert read["text"] == FILM
    saved = page.post("/api/save", json={"name": "film.toml", "text": FILM + "# more\n", "version": read["version"]})
    assert saved.status_code == 200 and (folder / "film.toml").read_text().endswith("# more\n")
    again = page.post("/api/save", json={"name": "film.toml", "text": "x", "version": read["version"]})
    assert again.status_code == 422 and "another program" in again.json()["error"]
    assert page.post("/api/save", json={"name": "new.toml", "text": FILM, "version": ""}).status_code == 200
    assert (folder / "new.toml").read_text() == FILM
    shipped = page.post("/api/save", json={"name": "example:soap", "text": FILM, "version": ""})
    assert shipped.status_code == 422 and "example" in shipped.json()["error"]


def test_the_state_lists_recipes_and_starting_points(page: TestClient) -> None:
    state = page.get("/api/state").json()
    assert state["recipes"] == ["broken.toml", "film.toml"]  # the broken one too, to be mended; not the sweep
    assert [start["title"] for start in state["starts"]] == list(STARTS)
    for start in state["starts"]:
        assert "family" in page.get("/api/recipe", params={"name": start["name"]}).json()["text"]


@pytest.mark.parametrize("family", FAMILIES)
def test_every_number_of_a_family_comes_with_what_a_form_needs(page: TestClient, family: str) -> None:
    form = page.get("/api/form", params={"family": family}).json()
    assert form == family_form(family)
    keys = [key for table in form["tables"].values() for key in table["keys"]]
    assert all(key["meaning"] and key["value"] for key in keys)
    assert all(table in form["tables"] for key in keys for table in key["tables"])
    numbers = [key for key in keys if key["kind"] == "number"]
    assert all("limits" in key for key in numbers)
    if family == "film":
        layer = {key["name"]: key for key in form["tables"]["film.LayerSpec"]["keys"]}
        assert layer["material"]["kind"] == "material"
        assert layer["thickness_nm"]["unit"] == "nm" and layer["thickness_nm"]["limits"]["ge"] == 0
        assert layer["thickness_nm"]["spellings"]["thickness_um"] == 1000


def test_materials_are_found_by_name(page: TestClient) -> None:
    names = [found["name"] for found in page.get("/api/indices", params={"q": "TiO2"}).json()["found"]]
    assert "TiO2" in names
    assert page.get("/api/indices", params={"q": "no such thing at all"}).json()["found"] == []


def test_a_relief_comes_with_a_line_of_its_heights(page: TestClient, folder: Path) -> None:
    heights = np.zeros((8, 8))
    heights[2:5, 3] = 0.4
    np.save(folder / "heights.npy", heights)
    text = 'family = "relief"\nheights = "heights.npy"\nfeature_um = 2\nblur_um = 0.6\ncoherence = {sigma = 1}\n'
    look = next(appearances(OpenedFolder.of(str(folder)).material(text, "relief.toml"), "D65", lambda: False))
    assert look.profile is not None
    assert look.profile["heights_um"] == [0, 0, 0.4, 0.4, 0.4, 0, 0, 0]  # through the step, along x
    assert look.profile["length_um"] == 16 and look.profile["depth_um"] == pytest.approx(0.4)


def test_the_blurred_surround_keeps_a_uniform_room_and_the_key_light() -> None:
    layers = blurred_surroundings().layers
    assert layers.shape[0] == LAYERS
    layers = layers[: len(ALPHAS) + 1]  # the others are no directions
    peaks = [float(layer.max()) for layer in layers]
    assert peaks == sorted(peaks, reverse=True)  # the rougher, the dimmer the brightest spot
    # a matt surface facing up: irradiance over pi, by the environment's own sum
    from nacre.picture.environments import studio

    assert float(layers[-1][0].mean()) == pytest.approx(studio().irradiance / np.pi, rel=0.01)


@pytest.mark.parametrize("alpha", [0.06, 0.15])
def test_the_gloss_of_mitsubas_rough_mirror_is_that_mirror(alpha: float) -> None:
    """Its width, and nearly all of its light, which a plain share of the light would miss where the lobe is narrow."""
    code = f"""
import numpy as np, mitsuba as mi
mi.set_variant("scalar_rgb")
from nacre.measure.colours import fit_gloss
mirror = mi.load_dict({{"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": {alpha}}})
def values(wi, wo):
    found = []
    for i, o in zip(wi.tolist(), wo.tolist()):
        si = mi.SurfaceInteraction3f(); si.wi = i
        found.append([float(mirror.eval(mi.BSDFContext(), si, mi.Vector3f(o))[0]) / o[2]])
    return np.array(found)
theta = np.radians([0.0, 20.0, 40.0, 60.0])
gloss = fit_gloss(values, theta, np.ones((4, 1)))
print(gloss.alpha, *gloss.reflectance[:, 0])
print(fit_gloss(lambda wi, wo: np.full((len(wi), 1), 0.3), theta, np.ones((4, 1))))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    numbers, matt = done.stdout.splitlines()
    found, *reflectance = map(float, numbers.split())
    assert found == pytest.approx(alpha, rel=0.05)
    assert min(reflectance[:3]) > 0.85 and max(reflectance) <= 1.0  # shadowing takes some at grazing light
    assert matt == "None"


def test_a_picture_that_cannot_be_is_one_line(page: TestClient) -> None:
    for body in (
        {},
        {"text": FILM, "name": "film.toml", "size": 9999},
        {"text": "", "name": "", "scene": "/etc/x.xml"},
    ):
        reported = page.post("/api/picture", json=body)
        assert reported.status_code == 422 and "\n" not in reported.json()["error"]


@pytest.mark.full
@pytest.mark.render
def test_the_settled_picture_is_a_picture_of_the_text(page: TestClient) -> None:
    import base64
    import io

    from PIL import Image

    asked = {"text": FILM, "name": "film.toml", "size": 128, "seconds": 1}
    reported = page.post("/api/picture", json=asked)
    assert reported.status_code == 200, reported.text
    last = [json.loads(line) for line in reported.text.splitlines()][-2]
    assert last["kind"] == "picture" and last["is_last"]
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(last["png"].partition(",")[2]))))
    assert picture.shape == (128, 128, 3) and picture.std() > 5


def test_numbers_that_json_lacks_become_null_and_text_is_unchanged() -> None:
    data = {"title": "NaN glass, Infinity edition", "thickness_nm": float("inf"), "list": [float("nan"), 1.5, True]}
    expected = {"title": "NaN glass, Infinity edition", "thickness_nm": None, "list": [None, 1.5, True]}
    assert json_data(data) == expected


@pytest.mark.parametrize(
    "name", ["x" * 300 + ".toml", "a/" * 3000 + "x.toml", "\ud800.toml", "é" * 200 + ".toml", "\0.toml"]
)
def test_long_and_odd_names_are_answered(page: TestClient, name: str) -> None:
    for route, body in (
        ("/api/save", {"name": name, "text": FILM, "version": ""}),
        ("/api/formats", {"name": name, "text": FILM}),
    ):
        answer = page.post(route, content=json.dumps(body))
        assert answer.status_code == 422 and answer.json()["error"].count("\n") == 0


def test_links_that_lead_out_and_pipes_are_neither_listed_nor_read(page: TestClient, folder: Path) -> None:
    (folder / "out.toml").symlink_to(folder.parent / "secret.toml")
    (folder / "in.toml").symlink_to(folder / "film.toml")
    os.mkfifo(folder / "pipe.toml")
    listed = page.get("/api/state").json()["recipes"]
    assert "in.toml" in listed and not {"out.toml", "pipe.toml"} & set(listed)
    for name, status in (("in.toml", 200), ("out.toml", 422), ("pipe.toml", 422)):
        assert page.get("/api/recipe", params={"name": name}).status_code == status
