"""The page in a browser: the structure that is drawn, the report, the files to take away."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers_studio import FILM, SEEN, THICKNESS, Server, ball, picture, settled, slider, toml, until
from playwright.sync_api import Page, expect

NEAR_MESH = 2.0  # of 255: eight bits, and chords of triangles instead of a ball
THIN = '{material = "SiO2", thickness_nm = 0.01}'
STEP = 6  # of 255, from pixel to pixel: more than any curve of a ball has
STRUCTURES = [
    ("bragg-mirror", "20 layers, 1461 nm in total, to scale", 21),
    ("pearl/bottle3", "1 stratum, 150 µm; below a section of its flakes", 5),
    ("metasurface/silver_on_oxide", "spheres of 180 nm, 1 layer, 400 nm in total, to scale", 3),
    ("relief/star", "25.6 µm wide", 1),
    ("glass/polystyrene_black", "part of a layer of 20 µm", 10),
]


@pytest.mark.full
@pytest.mark.parametrize("example, words, parts", STRUCTURES)
def test_the_structure_is_drawn(page: Page, example: str, words: str, parts: int) -> None:
    choose = "(e, name) => { e.value = 'example:' + name; e.dispatchEvent(new Event('change')); }"
    page.locator("#all-examples").evaluate(choose, example)
    expect(page.locator("#structure-text")).to_contain_text(words)
    assert page.locator("#structure .part").count() >= parts
    # in one go: a part that is held while the drawing is made anew has no place any more
    assert page.evaluate("() => document.querySelector('#structure .part').getBBox().height") > 0


@pytest.mark.full
def test_layers_are_drawn_to_scale(page: Page) -> None:
    heights = "() => [...document.querySelectorAll('#structure rect.part')].map((e) => e.getBBox().height)"
    tall = page.evaluate(heights)
    assert tall[0] / tall[1] == pytest.approx(300 / 60, rel=0.02)
    slider(page, THICKNESS).fill("120")
    until(page, lambda: "180 nm in total" in page.locator("#structure-text").inner_text())
    tall = page.evaluate(heights)
    assert tall[0] / tall[1] == pytest.approx(2, rel=0.02)


@pytest.mark.full
def test_the_report_comes_while_the_page_stays_free_and_can_be_cancelled(page: Page) -> None:
    page.get_by_role("button", name="Measure").click()
    page.locator("#report-cancel").click()
    expect(page.locator("#report-state")).to_have_text("Cancelled.")
    page.get_by_role("button", name="Store as B").click()
    slider(page, THICKNESS).fill("200")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 200)
    page.get_by_role("button", name="Measure").click()
    slider(page, THICKNESS).fill("90")  # while it is measured
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 90)
    expect(page.locator("#report-tables caption").last).to_contain_text("CIEDE2000 between A and B")
    expect(page.locator("#report-tables")).to_contain_text("gloss 60 degrees")


PEARL = """family = "pearl"
strata = [{resin = {n = 1.5}, thickness_um = 20, platelets = [{volume_fraction = 0.01, diameter_um = 25, coatings = [{material = "Al", thickness_nm = 60}], normal_deviation = 0.12}]}]
"""  # noqa: E501


@pytest.mark.full
def test_angles_and_texture_follow_the_recipe(page: Page) -> None:
    def sparkle() -> float:
        cell = page.locator("#angles-tables table").nth(1).locator("tbody tr").nth(1).locator("td").last
        return float(cell.inner_text().split()[0])

    page.locator("#angles-box summary").click()
    expect(page.locator("#angles-state")).to_contain_text("mirror direction")
    page.get_by_role("tab", name="TOML").click()
    page.locator("#text").fill(PEARL)
    tables = page.locator("#angles-tables")
    expect(tables.locator("table").first.locator("tbody tr")).to_have_count(10)
    expect(tables).to_contain_text("45as60az-125.3")
    expect(tables.locator("table").last).to_contain_text("\u00b1")  # standard errors, once the recipe rests
    fine = sparkle()
    page.locator("#text").fill(PEARL.replace("diameter_um = 25", "diameter_um = 50"))
    until(page, lambda: sparkle() > 1.5 * fine)
    page.locator("#text").fill(PEARL.replace("diameter_um = 25, ", ""))
    expect(page.locator("#angles-state")).to_contain_text("diameter_um")
    expect(tables.locator("table")).to_have_count(1)


@pytest.mark.full
def test_files_are_made_by_keyboard_and_come_as_downloads(page: Page, server: Server) -> None:
    page.get_by_role("button", name="Create a file").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog", name="Create a file")).to_be_visible()
    expect(page.locator("#file-to option", has_text="sheet")).to_be_attached()
    page.locator("#file-to").focus()
    page.keyboard.type("sheet")
    expect(page.locator("#file-about")).to_contain_text("layers")
    with page.expect_download() as given:
        page.locator("#file-make").focus()
        page.keyboard.press("Enter")
    assert given.value.suggested_filename == "film-sheet.csv"
    assert "TiO2" in given.value.path().read_text()
    page.keyboard.press("Escape")
    expect(page.locator("#files")).to_be_hidden()
    assert [path.name for path in server.folder.iterdir()] == ["film.toml"]


@pytest.mark.full
def test_another_object_is_drawn_turned_by_keys_and_follows_the_slider(page: Page) -> None:
    sphere = picture(page)
    page.locator("#object").select_option("knob")
    expect(page.locator("#view")).to_have_attribute("data-object", "knob")
    knob = picture(page)
    assert np.abs(knob.astype(int) - sphere).mean() > 3 and ball(knob).max() > 20
    slider(page, THICKNESS).fill("110")
    until(page, lambda: bool(np.abs(ball(picture(page)) - ball(knob)).max() > SEEN))
    settled(page)  # and has its light
    before = picture(page)
    page.locator("#view").focus()
    for _ in range(6):
        page.keyboard.press("ArrowRight")
    until(page, lambda: bool(np.abs(picture(page).astype(int) - before).mean() > 1))
    page.get_by_role("button", name="Front view").click()
    until(page, lambda: bool(np.array_equal(picture(page), before)))
    page.get_by_label("lines of u, v").check()
    until(page, lambda: bool(np.abs(picture(page).astype(int) - before).mean() > 0.5))
    page.locator("#object").select_option("sphere")
    expect(page.locator("#view")).to_have_attribute("data-object", "sphere")


@pytest.mark.full
def test_an_own_mesh_is_drawn_and_a_broken_one_is_one_line(page: Page, tmp_path: Path) -> None:
    before = picture(page)
    corners = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv 0 2 0\n"
    (tmp_path / "tent.obj").write_text(corners + "f 1 5 2\nf 2 5 3\nf 3 5 4\nf 4 5 1\nf 1 2 3\nf 1 3 4\n")
    (tmp_path / "broken.stl").write_text("solid nothing")
    page.locator("#object").select_option("own")
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose file").press("Enter")
    chooser.value.set_files(tmp_path / "tent.obj")
    expect(page.locator("#view")).to_have_attribute("data-object", "own")
    tent = picture(page)
    assert np.abs(tent.astype(int) - before).mean() > 3
    page.locator("#own-mesh").set_input_files(tmp_path / "broken.stl")
    expect(page.locator("#object-error")).to_contain_text("broken.stl")
    np.testing.assert_array_equal(picture(page), tent)
    page.locator("#up").select_option("x")  # asks for the last file again
    expect(page.locator("#object-error")).to_contain_text("broken.stl")
    drop = """(stage, text) => { const data = new DataTransfer();
        data.items.add(new File([text], 'flag.obj'));
        stage.dispatchEvent(new DragEvent('drop', {dataTransfer: data, bubbles: true, cancelable: true})); }"""
    page.locator("#stage").evaluate(drop, corners.replace("0 2 0", "3 2 0") + "f 1 5 2\nf 2 5 3\nf 3 5 1\n")
    expect(page.locator("#object option:checked")).to_have_text("flag.obj")
    until(page, lambda: not np.array_equal(picture(page), tent))
    # pictures are asked of the mesh by its own name, or of another scene without it
    expect(page.locator("#scene option:checked")).to_have_text("flag.obj")
    expect(page.locator("#file-scene option:checked")).to_have_text("flag.obj")
    asked = []
    page.on("request", lambda request: asked.append(request.post_data_json) if "api/picture" in request.url else None)
    for scene in ("own", "knob"):
        page.locator("#scene").select_option(scene)
        page.locator("#render").click()
        until(page, lambda: bool(asked))
        page.locator("#cancel").click()
        question = asked.pop()
        assert ("mesh" in question) == (scene == "own")
        assert question["scene"] == ("sphere" if scene == "own" else "knob")
        asked.clear()


@pytest.mark.full
def test_a_ball_of_triangles_has_the_light_of_the_sphere(page: Page, tmp_path: Path) -> None:
    """Rough, so that light is gathered over lobes; with one look-up in a blurred room the rim is dark."""
    page.locator("#text").evaluate(
        "(e, text) => { e.value = text; e.dispatchEvent(new Event('input')); }", FILM + "[surface]\nroughness = 0.3\n"
    )
    until(page, lambda: toml(page).get("surface") == {"roughness": 0.3})
    settled(page)
    wanted = picture(page).astype(int)
    trimesh.creation.icosphere(subdivisions=5).export(tmp_path / "ball.obj")
    page.locator("#object").select_option("own")
    page.locator("#own-mesh").set_input_files(tmp_path / "ball.obj")
    expect(page.locator("#view")).to_have_attribute("data-object", "own")
    settled(page)
    expect(page.locator("#view")).to_have_attribute("data-light", "gathered")
    side = len(wanted)
    y, x = np.mgrid[:side, :side]
    # middle and radius of the sphere in the canvas, as shares of it; inside the edge
    inside = np.hypot(x / side - 0.5, y / side - 0.477) < 0.3
    assert np.abs(picture(page).astype(int) - wanted)[inside].mean() < NEAR_MESH


@pytest.mark.full
def test_another_place_is_seen_around_the_object(page: Page) -> None:
    before = picture(page).astype(int)
    assert np.ptp(before[-20:].mean(axis=(0, 1))) < 2  # the studio's floor is grey
    page.get_by_label("Surroundings").select_option("interior")
    expect(page.locator("#view")).to_have_attribute("data-surround", "interior")
    expect(page.locator("#surround-note")).to_contain_text("its own light")
    room = picture(page).astype(int)
    floor = room[-20:].mean(axis=(0, 1))
    assert floor[0] > floor[2] + 20  # boards of wood
    assert np.abs(ball(room.astype(np.uint8)) - ball(before.astype(np.uint8))).max() > SEEN
    page.get_by_label("Surroundings").select_option("studio")
    until(page, lambda: bool(np.array_equal(picture(page), before)))


@pytest.mark.full
def test_a_stored_version_follows_the_lamp(page: Page) -> None:
    page.get_by_role("button", name="Store as B").click()
    slider(page, THICKNESS).fill("110")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 110)
    settled(page)
    before, ribbon = picture(page), page.locator("#ribbon-b-text").text_content()
    page.get_by_label("Lamp").select_option("F11")
    until(page, lambda: page.locator("#side-b").inner_text() == "B")
    settled(page)
    half = before.shape[1] // 2
    changed = np.abs(picture(page).astype(int) - before)
    assert changed[:, half:].max() > 3 and changed[:, :half].max() > 3
    page.get_by_label("Lamp").select_option("D65")
    until(page, lambda: page.locator("#side-b").inner_text() == "B")
    settled(page)
    until(page, lambda: bool(np.array_equal(picture(page), before)))
    assert page.locator("#ribbon-b-text").text_content() == ribbon


@pytest.mark.full
def test_a_free_film_shows_what_stands_behind_it_and_a_film_on_silicon_does_not(page: Page) -> None:
    """A film so thin that it is hardly there, on a ball and before the print of a note."""
    type_in = "(e, text) => { e.value = text; e.dispatchEvent(new Event('input')); }"
    films = {side: f'family = "film"\nsubstrate = "{side}"\nlayers = [{THIN}]\n' for side in ("air", "Si")}
    steps = {}
    for side, text in films.items():
        page.locator("#text").evaluate(type_in, text)
        until(page, lambda side=side: toml(page)["substrate"] == side)  # type: ignore[misc]
        settled(page)
        shown = picture(page).astype(int).mean(axis=2)
        line = shown[len(shown) // 2, 2 * len(shown) // 5 : 3 * len(shown) // 5]  # through the ball's middle
        steps[side] = int(np.sum(np.abs(np.diff(line)) > STEP))
    assert steps["air"] >= 2 and steps["Si"] == 0  # edges of chequers
    page.locator("#text").evaluate(type_in, films["air"])
    page.locator("#object").select_option("banknote")
    expect(page.locator("#view")).to_have_attribute("data-object", "banknote")
    settled(page)
    bare = picture(page)
    side = len(bare)
    print_ = bare[45 * side // 100 : 58 * side // 100, 10 * side // 100 : 25 * side // 100]  # of the number, left
    foil = bare[45 * side // 100 : 55 * side // 100, 66 * side // 100 : 72 * side // 100]
    assert print_.std() > 10 and foil.mean() > 90  # paper under the foil, which the film on silicon covers
