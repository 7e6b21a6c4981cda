"""axe-core, which we did not write, checks the page: names, roles, contrast; in light and dark, with all that opens."""

from __future__ import annotations

from typing import Any

import pytest
from helpers_studio import THICKNESS, field, settled, slider, toml, until
from playwright.sync_api import Page, expect


def violations(page: Page) -> list[str]:
    from axe_playwright_python.sync_playwright import Axe

    found: list[dict[str, Any]] = Axe().run(page).response["violations"]
    return [f"{each['id']}: {each['help']}: {node['html'][:120]}" for each in found for node in each["nodes"]]


@pytest.mark.full
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing(page: Page, theme: str) -> None:
    page.get_by_label("Theme").select_option(theme)
    assert violations(page) == []
    page.get_by_role("button", name="Store as B").click()
    slider(page, THICKNESS).fill("90")
    until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 90)
    page.locator("#object").select_option("knob")
    expect(page.locator("#view")).to_have_attribute("data-object", "knob")
    page.get_by_role("button", name="Measure").click()
    expect(page.locator("#report-tables")).to_be_visible()
    page.locator("details").first.locator("summary").click()
    assert violations(page) == []
    field(page, THICKNESS).fill("-3")
    expect(page.get_by_role("alert").first).to_be_visible()
    page.get_by_role("tab", name="TOML").click()
    assert violations(page) == []
    page.get_by_role("button", name="Undo").click()
    settled(page)
    page.get_by_label("Tolerance: layers ±").check()
    expect(page.locator("#tolerance-ribbon")).to_be_visible()
    page.get_by_role("tab", name="Design").click()
    page.locator("#design-seconds").fill("2")
    page.get_by_role("button", name="Show gamut").click()
    expect(page.locator("#gamut-text")).to_contain_text("specular 0")
    page.get_by_role("button", name="Design", exact=True).click()
    expect(page.get_by_role("button", name="Load solution 1")).to_be_visible()
    assert violations(page) == []
    page.get_by_label("Hue over angle").check()
    page.locator("#design-seconds").fill("1")
    page.get_by_role("button", name="Design", exact=True).click()
    expect(page.locator("#design-error")).to_contain_text("seconds = 1")
    assert violations(page) == []
    page.get_by_role("button", name="Create a file").click()
    expect(page.locator("#file-make")).to_be_enabled()
    assert violations(page) == []
    page.keyboard.press("Escape")
    page.locator("#recipes").select_option("")
    assert violations(page) == []


@pytest.mark.full
def test_axe_sees_what_is_wrong(page: Page) -> None:
    """The check can fail: a control without a name, and ink too near its ground."""
    page.evaluate("document.querySelector('header').append(document.createElement('button'))")
    page.evaluate("document.getElementById('ribbon-title').style.color = '#ccc'")
    found = violations(page)
    assert any(each.startswith("button-name") for each in found)
    assert any(each.startswith("color-contrast") for each in found)
