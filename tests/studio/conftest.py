"""A browser and a server for all tests of the studio's page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers_browser import FLAGS, find_chromium
from helpers_studio import COMMENTED_FILM, FILM, PATIENCE_S, PORT, TOKEN, Server, opened
from playwright.sync_api import Browser, Page, sync_playwright
from starlette.testclient import TestClient

from nacre.studio.folder import OpenedFolder
from nacre.studio.server import HEADER, make_app


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


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inside = tmp_path / "recipes"
    inside.mkdir()
    (inside / "film.toml").write_text(COMMENTED_FILM)
    (tmp_path / "secret.toml").write_text(COMMENTED_FILM)
    (tmp_path / "secret.csv").write_text("400,1.5,0\n700,1.5,0\n")
    return inside


@pytest.fixture
def client(folder: Path) -> Iterator[TestClient]:
    app = make_app(OpenedFolder.of(str(folder)), TOKEN, PORT)
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}", headers={HEADER: TOKEN}) as client:
        yield client
