"""The page's design in a browser, by pointer and by keys: wanted colours, answers, the cloud, the passes."""

from __future__ import annotations

import psutil
import pytest
from helpers_studio import THICKNESS, Server, field, settled, slider, toml, until
from playwright.sync_api import Page, Route, expect

OPEN = "(e, name) => { e.value = 'example:' + name; e.dispatchEvent(new Event('change')); }"


def begin(page: Page, seconds: float) -> None:
    page.get_by_role("tab", name="Design").click()
    expect(page.locator("#parameters .parameter-row")).to_have_count(2)
    page.locator("#design-seconds").fill(str(seconds))
    page.get_by_role("button", name="Design", exact=True).click()


def thickness(page: Page) -> float:
    return float(toml(page)["layers"][0]["thickness_nm"])


def test_a_design_comes_and_is_loaded_and_undone(page: Page) -> None:
    page.get_by_role("tab", name="Form").focus()
    page.keyboard.press("ArrowLeft")  # round to the last one
    expect(page.get_by_role("tab", name="Design")).to_be_focused()
    page.get_by_label("Choose colour 1").fill("#2f7f8f")
    begin(page, 2)
    expect(page.get_by_role("button", name="Load solution 1")).to_be_visible()
    expect(page.locator("#solutions")).to_contain_text("worst ΔE")
    expect(page.get_by_role("button", name="Design", exact=True)).to_be_visible()
    assert thickness(page) == 300  # nothing is changed before it is asked for
    page.get_by_role("button", name="Load solution 1").click()
    until(page, lambda: thickness(page) != 300)
    settled(page)
    assert 5 <= thickness(page) <= 600 and "# a comment" in page.locator("#text").input_value()
    page.get_by_role("button", name="Undo").click()
    until(page, lambda: thickness(page) == 300)


def test_hues_are_drawn_by_the_pointer_and_by_keys(page: Page) -> None:
    page.get_by_role("tab", name="Design").click()
    page.get_by_label("Hue over angle").check()
    curve, at_0 = page.locator("#hue-curve"), page.get_by_label("Hue at 0 degrees")
    handles = "() => [...document.querySelectorAll('#hue-curve .handle')].map((e) => Number(e.getAttribute('cy')))"
    before = page.evaluate(handles)
    at_0.focus()
    value = int(at_0.input_value())
    page.keyboard.press("ArrowDown")
    assert int(at_0.input_value()) == value - 1
    box = curve.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.11 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.3 * box["height"], steps=8)
    page.mouse.up()
    after = page.evaluate(handles)
    assert int(at_0.input_value()) == pytest.approx(180, abs=25)  # the middle of 360
    assert after[:3] != before[:3]
    page.get_by_label("15 degrees is a target").uncheck()
    assert len(page.evaluate(handles)) == len(after) - 1


def test_what_cannot_be_designed_is_said_in_the_page(page: Page) -> None:
    page.get_by_role("tab", name="Design").click()
    expect(page.locator("#parameters .parameter-row")).to_have_count(2)
    page.locator("#design-seconds").fill("6000")
    page.get_by_role("button", name="Design", exact=True).click()
    expect(page.locator("#design-error")).to_contain_text("seconds = 6000 is not allowed; it should be from 2 to 600")
    for row in range(2):
        page.locator("#parameters input[type=checkbox]").nth(row).uncheck()
    page.locator("#design-seconds").fill("2")
    page.get_by_role("button", name="Design", exact=True).click()
    expect(page.locator("#design-error")).to_contain_text("tick the ones that may change")


@pytest.mark.full
def test_a_recipe_without_numbers_is_left_to_the_command(page: Page) -> None:
    page.get_by_role("tab", name="Design").click()
    page.locator("#all-examples").evaluate(OPEN, "morpho")  # its numbers are those of a preset
    expect(page.locator("#design-refused")).to_contain_text("has no variable number")
    expect(page.locator("#design-box")).to_be_hidden()
    page.locator("#all-examples").evaluate(OPEN, "blue-oxide")
    expect(page.locator("#design-box")).to_be_visible()


@pytest.mark.full
def test_a_long_design_is_stopped_with_what_it_has_and_the_page_stays_free(page: Page, server: Server) -> None:
    page.get_by_role("tab", name="Design").click()
    page.get_by_label("Choose colour 1").fill("#ff0000")  # out of reach, so that it does not end before
    begin(page, 600)
    expect(page.locator("#solutions")).to_contain_text("Best so far")
    page.get_by_role("tab", name="Form").click()
    slider(page, THICKNESS).fill("110")
    until(page, lambda: thickness(page) == 110)
    settled(page)
    page.get_by_role("tab", name="Design").click()
    page.get_by_role("button", name="Stop").click()
    expect(page.locator("#solutions")).to_contain_text("Solution 1")
    expect(page.locator("#design-state")).to_contain_text("topped")
    expect(page.get_by_role("button", name="Design", exact=True)).to_be_visible()


@pytest.mark.full
def test_a_search_ends_with_its_page_and_with_its_server(page: Page, server: Server) -> None:
    def searching() -> list[psutil.Process]:
        every = psutil.process_iter(["cmdline", "environ"])
        ours = [p for p in every if "nacre.studio.subprocess_jobs" in (p.info["cmdline"] or [])]
        return [p for p in ours if (p.info["environ"] or {}).get("NACRE_CACHE") == str(server.cache)]

    def search(on: Page) -> None:
        on.get_by_role("tab", name="Design").click()
        on.get_by_label("Choose colour 1").fill("#ff0000")
        begin(on, 600)
        until(on, lambda: len(searching()) == 1)

    other = page.context.new_page()
    other.goto(f"http://127.0.0.1:{server.port}/")
    other.get_by_role("button", name="Close").click()
    settled(other)
    search(page)
    page.close()
    until(other, lambda: searching() == [])
    search(other)
    server.kill()
    until(other, lambda: searching() == [])
    expect(other.locator("#design-go")).to_be_visible()
    server.start()


@pytest.mark.full
def test_who_asks_before_the_free_numbers_have_come_is_answered(page: Page) -> None:
    held: list[Route] = []
    page.route("**/api/parameters*", lambda route: held.append(route))
    page.get_by_role("tab", name="Design").click()
    page.locator("#design-seconds").fill("2")
    page.get_by_role("button", name="Show gamut").click()
    until(page, lambda: bool(held))
    held[0].continue_()
    expect(page.locator("#gamut-text")).to_contain_text("specular 0")  # "tick the ones that may change" was said


@pytest.mark.full
def test_the_gamut_is_shown_with_what_is_asked_in_it(page: Page) -> None:
    page.get_by_role("tab", name="Design").click()
    expect(page.locator("#parameters .parameter-row")).to_have_count(2)
    page.locator("#design-seconds").fill("4")  # the gamut takes no longer than a search
    page.get_by_role("button", name="Show gamut").click()
    expect(page.locator("#gamut-text")).to_contain_text("specular 0: #8a4fb0 is")
    expect(page.locator("#gamut .reached").nth(60)).to_be_attached()
    expect(page.locator("#gamut .target")).to_have_count(1)
    page.get_by_label("Angle of colour 1").fill("30")  # another question: what was marked is no answer to it
    expect(page.locator("#gamut-box")).to_be_hidden()


@pytest.mark.full
def test_the_cloud_is_of_the_recipe_as_it_stands(page: Page) -> None:
    page.get_by_label("Tolerance: layers ±").check()
    expect(page.locator("#tolerance-text")).to_contain_text("95 % of 64 draws")
    expect(page.locator("#tolerance-ribbon")).to_be_visible()
    assert page.locator("#track .scatter circle").count() == 3 * 64
    field(page, THICKNESS).fill("120")
    expect(page.locator("#tolerance-ribbon")).to_be_hidden()
    expect(page.locator("#tolerance-ribbon")).to_be_visible()
    said = page.locator("#tolerance-text").inner_text()
    page.locator("#percent").fill("6")
    page.locator("#percent").press("Tab")
    until(page, lambda: page.locator("#tolerance-text").inner_text() not in (said, "Sampling manufactured materials"))
    page.get_by_label("Tolerance: layers ±").uncheck()
    expect(page.locator("#tolerance-ribbon")).to_be_hidden()


@pytest.mark.full
@pytest.mark.render
def test_passes_become_better_and_an_edit_begins_them_anew(page: Page) -> None:
    watch = """() => { window.spp = []; const image = document.getElementById('picture');
        const note = () => window.spp.push(Number(image.dataset.spp));
        new MutationObserver(note).observe(image, {attributeFilter: ['data-spp']}); }"""
    page.evaluate(watch)
    page.locator("#size").select_option("192")
    page.get_by_role("button", name="Render").click()
    expect(page.locator("#picture")).to_be_visible()
    first = page.locator("#picture").get_attribute("src")
    expect(page.locator("#render-state")).to_contain_text("Recipe at the time of the request")
    assert page.evaluate("window.spp") == sorted(page.evaluate("window.spp")) and len(page.evaluate("window.spp")) > 1
    page.locator("#seconds").select_option("90")
    page.get_by_role("button", name="Render").click()
    expect(page.locator("#render-state")).to_contain_text("samples per pixel so far")
    slider(page, THICKNESS).fill("90")
    expect(page.locator("#render-state")).to_contain_text("restarting")
    expect(page.locator("#render-state")).to_contain_text("samples per pixel so far")
    assert page.locator("#picture").get_attribute("src") != first
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#render-state")).to_have_text("Cancelled.")
