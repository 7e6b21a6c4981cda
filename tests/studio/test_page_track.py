"""The labels of the a*, b* track in a browser: none covers another, in both themes and on a tablet."""

from __future__ import annotations

import pytest
from helpers_studio import THICKNESS, Server, opened, settled, slider, toml, until
from playwright.sync_api import Browser, Page, expect

SHARED = 1.0  # pixels that two boxes of text may share: their letters are smaller than their boxes
GREYS = 'family = "film"\nsubstrate = "Ag"\nlayers = []\n'  # one colour at all angles
BOXES = """() => [...document.querySelectorAll('#track text')].map((e) => {
  const { left, top, right, bottom } = e.getBoundingClientRect();
  return [left, top, right, bottom];
})"""
FRAME = """() => {
  const { left, right } = document.getElementById('right').getBoundingClientRect();
  return [left, right];
}"""


def labels(page: Page, count: int) -> list[list[float]]:
    """The boxes of all labels, once there are so many."""
    until(page, lambda: len(page.evaluate(BOXES)) == count)
    boxes: list[list[float]] = page.evaluate(BOXES)
    return boxes


def check(page: Page, count: int) -> None:
    boxes = labels(page, count)
    left, right = page.evaluate(FRAME)
    assert all(box[0] >= left and box[2] <= right for box in boxes)
    for i, one in enumerate(boxes):
        for other in boxes[:i]:
            wide, high = (min(one[k + 2], other[k + 2]) - max(one[k], other[k]) for k in (0, 1))
            assert min(wide, high) <= SHARED, (one, other)


def put(page: Page, text: str) -> None:
    page.locator("#tab-toml").click()
    page.locator("#text").fill(text)
    until(page, lambda: toml(page)["substrate"] == "Ag")
    settled(page)
    page.wait_for_timeout(600)  # what the numbers say is painted when the object rests


@pytest.mark.full
@pytest.mark.parametrize("width, theme", [(1280, "light"), (1280, "dark"), (820, "light")])
def test_labels_of_the_track_stand_apart(browser: Browser, server: Server, width: int, theme: str) -> None:
    """Of one look and of two nearly alike; and where all angles have one colour, at which all points lie."""
    with opened(browser, server, color_scheme=theme) as page:
        page.set_viewport_size({"width": width, "height": 900})
        check(page, 5)
        page.get_by_role("button", name="Store as B").click()
        slider(page, THICKNESS).fill("303")
        until(page, lambda: toml(page)["layers"][0]["thickness_nm"] == 303)
        settled(page)
        expect(page.locator("#track .other").first).to_be_attached()
        check(page, 8)
        put(page, GREYS)
        page.get_by_role("button", name="Replace B").click()
        page.wait_for_timeout(600)
        check(page, 8)
