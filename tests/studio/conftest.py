"""A browser and a server for all tests of the studio's page."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from helpers_browser import FLAGS, find_chromium
from helpers_studio import FILM, PATIENCE_S, Server, opened
from playwright.sync_api import Browser, Page, sync_playwright


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = find_chromium()
    with sync_playwright() as play:
        running = play.chromium.launch(executable_path=path, args=FLAGS, timeout=1e3 * PATIENCE_S)
        yield running
        running.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("recipes")
    (folder / "film.toml").write_text(FILM)
    running = Server(folder, tmp_path_factory.mktemp("cache") / "nacre")
    yield running
    running.kill()


@pytest.fixture
def page(browser: Browser, server: Server) -> Iterator[Page]:
    with opened(browser, server) as fresh:
        yield fresh
