"""The page in a browser: what is seen changes as it should, by pointer and by keys, and nothing typed is lost."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers_studio import (
    FILM,
    PATIENCE_S,
    SEEN,
    THICKNESS,
    Server,
    ball,
    field,
    memory_of,
    opened,
    picture,
    settled,
    slider,
    toml,
    until,
)
from playwright.sync_api import Browser, Page, expect

from nacre.recipe.toml import parse_toml

PICTURE = re.compile("^data:image/jpeg")
DRAGS = 30  # changes of a number, 100 ms apart
A_CURVE = 20  # pixels of a pen's own colour that a curve has at least: it is some hundred pixels long
PENS = """(id) => {
  const canvas = document.getElementById(id).previousElementSibling, { color, caretColor } = getComputedStyle(canvas);
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  return [color, caretColor].map((pen) => {
    const wanted = pen.match(/\\d+/g).map(Number);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) {
      count += data[i + 3] > 200 && wanted.every((value, c) => Math.abs(data[i + c] - value) < 9);
    }
    return count;
  });
}"""


def drawn_by_pens(page: Page, drawing: str) -> list[int]:
    """Return how many pixels of a drawing's curves have the colour of the recipe's pen, and of B's."""
    page.wait_for_timeout(600)  # what the numbers say is painted when the object rests
    return [int(count) for count in page.evaluate(PENS, drawing)]


def test_the_sphere_is_not_black_and_follows_the_slider(page: Page) -> None:
    before = picture(page)
    assert before.std() > 10 and ball(before).max() > 20
    slider(page, THICKNESS).fill("110")
    expect(field(page, THICKNESS)).to_have_value("110")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 110)
    settled(page)
    assert np.abs(ball(picture(page)) - ball(before)).max() > SEEN
    assert "# a comment" in page.locator("#text").input_value()


def test_the_light_on_the_sphere_is_gathered_anew_for_a_new_view_and_kept_for_a_new_colour(page: Page) -> None:
    light = page.locator("#view")
    expect(light).to_have_attribute("data-light", "gathered")
    before = picture(page)
    slider(page, THICKNESS).fill("110")
    until(page, lambda: bool(np.abs(ball(picture(page)) - ball(before)).max() > SEEN))
    expect(light).to_have_attribute("data-light", "gathered")
    front = picture(page)
    light.focus()
    page.keyboard.press("ArrowUp")
    expect(light).to_have_attribute("data-light", "gathering")
    expect(light).to_have_attribute("data-light", "gathered")
    assert np.abs(picture(page).astype(int) - front).mean() > 1


def test_a_new_colour_drawn_over_the_ball_alone_is_the_picture_drawn_whole(page: Page) -> None:
    """From the front, from above near the canvas's edge, under another exposure, and beside another look."""
    whole = "async () => { const { app } = await import('/page/common.js'); app.view.painted = {}; app.view.draw(); }"

    def check(thickness: str) -> None:
        before = picture(page)
        slider(page, THICKNESS).fill(thickness)
        until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == float(thickness))
        settled(page)
        drawn = picture(page)
        page.evaluate(whole)
        np.testing.assert_array_equal(drawn, picture(page))
        assert np.abs(drawn.astype(int) - before).max() > SEEN

    check("110")
    page.locator("#view").focus()
    for key in ["ArrowUp"] * 9 + ["ArrowRight"] * 3:
        page.keyboard.press(key)
    settled(page)
    check("180")
    page.locator("#exposure").fill("1")
    check("120")
    page.get_by_role("button", name="Store as B").click()
    check("200")


def test_a_page_without_the_token_is_refused(browser: Browser, server: Server) -> None:
    context = browser.new_context()
    answer = context.new_page().goto(f"http://127.0.0.1:{server.port}/")
    assert answer is not None and answer.status == 403
    context.close()


def test_keys_turn_the_object_and_move_a_slider(page: Page) -> None:
    before = picture(page)
    page.locator("#view").focus()
    for _ in range(8):
        page.keyboard.press("ArrowRight")
    until(page, lambda: bool(np.abs(picture(page).astype(int) - before).mean() > 1))
    slider(page, THICKNESS).focus()
    page.keyboard.press("ArrowRight")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] > 300)
    field(page, "substrate").fill("Au")
    page.keyboard.press("Tab")
    until(page, lambda: toml(page)["substrate"] == "Au")


def test_layers_are_added_moved_and_taken_out_and_all_that_is_undone(page: Page) -> None:
    names = lambda: [layer["material"] for layer in toml(page)["layers"]]
    page.get_by_role("button", name="Add a copy of Layer 1").click()
    until(page, lambda: names() == ["SiO2", "SiO2", "TiO2"])
    page.get_by_role("button", name="Move Layer 3 up").click()
    until(page, lambda: names() == ["SiO2", "TiO2", "SiO2"])
    page.get_by_role("button", name="Remove Layer 1").click()
    until(page, lambda: names() == ["TiO2", "SiO2"])
    settled(page)
    for wanted in (["SiO2", "TiO2", "SiO2"], ["SiO2", "SiO2", "TiO2"], ["SiO2", "TiO2"]):
        page.get_by_role("button", name="Undo").click()
        until(page, lambda wanted=wanted: names() == wanted)  # type: ignore[misc]
    page.get_by_role("button", name="Redo").click()
    until(page, lambda: names() == ["SiO2", "SiO2", "TiO2"])


def test_a_broken_recipe_marks_its_line_and_the_last_good_one_stays(page: Page) -> None:
    before = picture(page)
    page.get_by_role("tab", name="TOML").click()
    page.locator("#text").fill(FILM.replace('"TiO2"', '"TiO3"'))
    expect(page.get_by_role("alert").first).to_contain_text('Line 5: film.toml: layers[1].material = "TiO3"')
    expect(page.locator("#lines .bad")).to_have_text("5")
    np.testing.assert_array_equal(picture(page), before)
    page.locator("#text").fill(FILM.replace("300", "150"))
    settled(page)
    expect(page.locator("#error")).to_be_hidden()
    page.get_by_role("tab", name="Form").click()
    expect(field(page, THICKNESS)).to_have_value("150")


def test_a_recipe_that_cannot_be_read_is_opened_as_text_and_nothing_of_the_one_before_passes_for_it(
    browser: Browser, server: Server
) -> None:
    """Its name comes before the good one's, and yet the good one is what a page on the folder begins with."""
    broken = server.folder / "a-broken.toml"
    broken.write_text('family = "film"\nlayers = [\nsubstrate = "Si"\n')
    try:
        with opened(browser, server) as page:
            expect(page.locator("#recipes")).to_have_value("film.toml")
            expect(page.locator("#history img")).to_be_visible()
            page.locator("#recipes").select_option("a-broken.toml")
            expect(page.get_by_role("alert").first).to_contain_text("Line 3")
            expect(page.get_by_label("Recipe as TOML")).to_be_visible()
            expect(page.locator("#state")).to_have_text("The recipe has a mistake; film.toml is still shown")
            expect(page.locator("#history img")).to_be_hidden()
            page.get_by_role("tab", name="Form").click()
            expect(page.locator("#form")).to_contain_text("appears when the TOML is valid")
            expect(page.locator("#form .row")).to_have_count(0)
            page.get_by_role("tab", name="TOML").click()
            page.locator("#text").fill('family = "film"\nlayers = []\nsubstrate = "Ti"\n')
            settled(page)
            page.get_by_role("tab", name="Form").click()
            expect(field(page, "substrate")).to_have_value("Ti")
    finally:
        broken.unlink()


def test_nothing_typed_is_lost_when_the_server_is_killed_and_started_anew(page: Page, server: Server) -> None:
    server.kill()
    expect(page.locator("#state")).to_have_attribute("data-kind", "lost")
    field(page, THICKNESS).fill("123")
    server.start()
    settled(page)
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 123)
    page.reload()
    settled(page)
    expect(field(page, THICKNESS)).to_have_value("123")


def test_a_request_to_a_dead_server_is_reported_and_the_object_that_is_shown_stays_chosen(
    page: Page, server: Server
) -> None:
    server.kill()
    expect(page.locator("#state")).to_have_attribute("data-kind", "lost")
    page.locator("#object").select_option("ring")
    expect(page.locator("#object-error")).to_have_text("nacre studio does not answer; is it still running?")
    expect(page.locator("#object")).to_have_value("sphere")
    server.start()
    settled(page)
    page.locator("#object").select_option("ring")
    expect(page.locator("#view")).to_have_attribute("data-object", "ring")


def test_a_server_with_a_new_token_is_reported_and_its_address_restores_the_text(
    browser: Browser, server: Server
) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(server.address)
    page.get_by_role("button", name="Close").click()
    settled(page)
    server.kill()
    (kept,) = server.cache.parent.rglob(f"studio-{server.port}.token")
    kept.unlink()
    field(page, THICKNESS).fill("123")
    server.start()
    expect(page.locator("#state")).to_contain_text("open the address that it printed")
    page.goto(server.address)
    settled(page)
    expect(field(page, THICKNESS)).to_have_value("123")
    context.close()


def test_two_tabs_hold_two_recipes_and_no_link_holds_the_token(page: Page, server: Server) -> None:
    assert page.url == f"http://127.0.0.1:{server.port}/"
    assert page.evaluate("document.cookie") == ""
    assert server.address.partition("token=")[2] not in page.content()
    other = page.context.new_page()
    other.goto(f"http://127.0.0.1:{server.port}/")
    other.get_by_role("button", name="Close").click()
    settled(other)
    field(page, THICKNESS).fill("200")
    field(other, THICKNESS).fill("77")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 200)
    until(other, lambda: toml(other)["layers"][0]["thickness_nm"] == 77)
    assert toml(page)["layers"][0]["thickness_nm"] == 200


def test_saving_writes_the_file_and_a_starting_point_is_opened(page: Page, server: Server) -> None:
    field(page, THICKNESS).fill("321")
    page.get_by_role("button", name="Save as").click()
    page.get_by_label("File name").fill("mine")
    page.locator("#name-ok").click()
    expect(page.locator("#name-dialog")).to_be_hidden()
    assert parse_toml((server.folder / "mine.toml").read_text(), "mine")["layers"][0]["thickness_nm"] == 321
    (server.folder / "mine.toml").unlink()
    page.locator("#recipes").select_option("")
    page.locator("#starts button", has_text="jewel beetle").click()
    until(page, lambda: toml(page).get("surface") is not None)
    settled(page)
    assert ball(picture(page))[1] > ball(picture(page))[0]  # a green beetle


def test_pictures_of_steps_are_taken_at_rest_and_none_while_a_number_is_dragged(page: Page) -> None:
    """To read a picture back holds the next one up for as long as two take to draw."""
    expect(page.locator("#history img")).to_be_visible()  # of the beginning, before anything changed
    taken = page.evaluate(
        """async (path) => {
          let count = 0;
          const read = HTMLCanvasElement.prototype.toDataURL;
          HTMLCanvasElement.prototype.toDataURL = function (...how) { count += 1; return read.apply(this, how); };
          const turned = document.querySelector(`[data-path="${path}"] input[type=range]`);
          for (let i = 0; i < DRAGS; i++) {
            turned.value = 100 + i;
            turned.dispatchEvent(new Event("input", { bubbles: true }));
            await new Promise((done) => setTimeout(done, 100));
          }
          return count;
        }""".replace("DRAGS", str(DRAGS)),
        THICKNESS,
    )
    assert taken == 0
    expect(page.locator("#history img").last).to_have_attribute("src", PICTURE)


def test_a_stored_version_stands_beside_the_new_one_and_history_is_opened_by_its_pictures(page: Page) -> None:
    before = picture(page)
    half = before.shape[1] // 2
    for drawing in ("spectrum", "track"):
        own, others = drawn_by_pens(page, drawing)
        assert own > A_CURVE and others == 0
    expect(page.locator("#history img")).to_have_attribute("src", PICTURE)
    page.get_by_role("button", name="Store as B").click()
    slider(page, THICKNESS).fill("110")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 110)
    settled(page)
    both = picture(page)
    np.testing.assert_array_equal(both[:, half:], before[:, half:])  # B, on the right, is as it was kept
    assert np.abs(ball(both[:, :half]) - ball(before[:, :half])).max() > SEEN
    expect(page.locator("#swatches b").first).to_contain_text("ΔE")
    assert page.locator("#spectrum .other").count() == 1  # B's name
    for drawing in ("spectrum", "track"):
        assert min(drawn_by_pens(page, drawing)) > A_CURVE
    page.locator("#view").focus()
    page.keyboard.press("b")
    np.testing.assert_array_equal(picture(page), before)
    page.keyboard.press("b")
    assert np.abs(ball(picture(page)) - ball(before)).max() > SEEN
    step = page.get_by_role("button", name="Step 1 of 2: Opened")
    expect(step.locator("img")).to_have_attribute("src", PICTURE)
    page.get_by_role("button", name="Step 2 of 2").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Enter")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 300)
    expect(step).to_have_attribute("aria-current", "step")
    settled(page)
    page.get_by_role("button", name="Drop B").click()
    np.testing.assert_array_equal(picture(page), before)


def test_object_and_sliders_are_seen_together_on_laptops_tablets_and_zoomed_pages(page: Page) -> None:
    for width, height in ((1280, 800), (1024, 768), (768, 1024), (640, 400)):  # the last: a laptop's page at 200 %
        page.set_viewport_size({"width": width, "height": height})
        for part in (page.locator("#view"), slider(page, THICKNESS)):
            place = part.bounding_box()
            assert place is not None, (width, height)
            assert 0 <= place["x"] and place["x"] + place["width"] <= width, (width, height)
            assert 0 <= place["y"] and place["y"] + place["height"] <= height, (width, height)
            middle = [place["x"] + place["width"] / 2, place["y"] + place["height"] / 2]
            assert part.evaluate("(e, [x, y]) => e === document.elementFromPoint(x, y)", middle), (width, height)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    cut = "[...document.querySelectorAll('.row > label')].filter((e) => e.scrollWidth > e.clientWidth + 1).length"
    assert page.evaluate(cut) == 0


def test_every_control_has_a_name_and_without_webgl_the_page_says_so(browser: Browser, server: Server) -> None:
    nameless = """() => [...document.querySelectorAll('button, input, select, textarea, canvas, svg[role]')]
        .filter((e) => !(e.ariaHidden || e.labels?.length || e.getAttribute('aria-label')
            || e.getAttribute('aria-labelledby') || (e.tagName === 'BUTTON' && e.textContent.trim())))
        .map((e) => e.outerHTML)"""
    with opened(browser, server) as page:
        page.locator("details").first.locator("summary").click()
        assert page.evaluate(nameless) == []
        assert page.evaluate("document.documentElement.lang") == "en"
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
    page.goto(server.address)
    expect(page.locator("#no-gl")).to_contain_text("no WebGL2")
    context.close()


@pytest.mark.full
def test_dragging_for_a_while_ends_with_the_last_value(page: Page, server: Server) -> None:
    """Random dragging on three sliders; what is shown at the end is what was dragged last, and memory stays."""
    random = np.random.default_rng(1)
    paths = [THICKNESS, "layers[1].thickness_nm"]

    def drag(times: int) -> None:
        for _ in range(times):
            slider(page, paths[int(random.integers(2))]).fill(str(int(random.integers(10, 190))))

    drag(80)
    resident = memory_of(server)
    drag(200)
    slider(page, THICKNESS).fill("42")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 42)
    settled(page)
    assert memory_of(server) < 1.05 * resident + 8e6


@pytest.mark.full
def test_a_slow_family_is_drafted_and_settles_by_itself(page: Page, server: Server) -> None:
    kinds = """() => { window.kinds = [];
        const state = document.getElementById('state');
        new MutationObserver(() => window.kinds.push(state.dataset.kind)).observe(state, {attributes: true}); }"""
    page.evaluate(kinds)
    page.locator("#all-examples").evaluate(
        "(e) => { e.value = 'example:metasurface/silver_on_oxide'; e.dispatchEvent(new Event('change')); }"
    )
    until(page, lambda: "draft" in page.evaluate("window.kinds"))
    settled(page)
    slider(page, "particle.radius_nm").fill("60")
    slider(page, "particle.radius_nm").fill("70")
    until(page, lambda: toml(page)["particle"]["radius_nm"] == 70)
    settled(page)


@pytest.mark.full
@pytest.mark.render
def test_the_settled_picture_comes_and_the_page_stays_free(page: Page, server: Server) -> None:
    page.locator("#size").select_option("192")
    page.locator("#seconds").select_option("3")
    page.get_by_role("button", name="Render").click()
    slider(page, THICKNESS).fill("90")  # while Mitsuba works
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 90)
    expect(page.locator("#picture")).to_be_visible()
    assert page.evaluate("document.getElementById('picture').naturalWidth") == 192


@pytest.mark.full
@pytest.mark.render
def test_without_webgl_the_servers_picture_stands_in_the_objects_place_and_follows(
    browser: Browser, server: Server
) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    page.add_init_script(
        """const get = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, how) {
          return kind === "webgl2" ? null : get.call(this, kind, how);
        };"""
    )
    page.set_default_timeout(1e3 * PATIENCE_S)
    page.goto(server.address)
    page.get_by_role("button", name="Close").click()
    image = page.locator("#stage #picture")
    expect(image).to_be_visible()
    place = image.bounding_box()
    assert place is not None and place["y"] + place["height"] < 800 and place["width"] > 300
    changes = [
        lambda: slider(page, THICKNESS).fill("90"),
        lambda: page.locator("#lamp").select_option("A"),
        lambda: page.locator("#object").select_option("knob"),
        lambda: page.locator("#surround").select_option("street"),
    ]
    for change in changes:
        expect(page.locator("#cancel")).to_be_hidden()
        before = image.get_attribute("src")
        change()
        until(page, lambda before=before: image.get_attribute("src") != before)  # type: ignore[misc]
    expect(page.locator("#exposure")).to_be_hidden()
    context.close()
