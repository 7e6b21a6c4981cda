"""The studio in a browser: its server in a process of its own, a fresh visitor's page, and what is seen on it."""

from __future__ import annotations

import base64
import io
import json
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from nacre.recipe.toml import parse_toml

COMMENTED_FILM = """family = "film"  # a comment
substrate = "Si"
layers = [
  {material = "SiO2", thickness_nm = 300},  # oxide
  {material = "TiO2", thickness_nm = 60},
]
"""
PORT, TOKEN = 8124, "a-token-for-the-tests"  # of servers that are asked without a socket
FILM = COMMENTED_FILM.replace("  # oxide", "")
THICKNESS = "layers[0].thickness_nm"
SEEN = 8  # of 255: a change of the mean colour that nobody could miss
# nothing here is about speed: a machine whose cores are all taken draws a page in seconds, and that is no failure
PATIENCE_S = 90.0
expect.set_options(timeout=1e3 * PATIENCE_S)


class Server:
    """`nacre studio` in a process of its own; `restart` kills it and starts another on the same port."""

    def __init__(self, folder: Path, cache: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.folder, self.cache = folder, cache
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "nacre", "studio", str(self.folder), "--no-browser", "--port", str(self.port)]
        environment = {**os.environ, "NACRE_CACHE": str(self.cache)}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()
        assert self.address.startswith("http"), "the server said nothing"

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


@contextmanager
def opened(browser: Browser, server: Server, **options: Any) -> Iterator[Page]:
    """A fresh visitor's page; no error on the console, and nothing asked of anybody but the studio."""
    context = browser.new_context(viewport={"width": 1280, "height": 800}, **options)
    context.set_default_timeout(1e3 * PATIENCE_S)
    page = context.new_page()
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("console", lambda said: troubles.append(said.text) if said.type == "error" else None)
    page.on("request", lambda request: None if is_own(request.url, server) else troubles.append(request.url))
    page.goto(server.address)
    page.wait_for_selector("#view[data-seq]", state="attached")
    page.get_by_role("button", name="Close").click()
    settled(page)
    expect(page.locator("#view")).to_have_attribute("data-measured", "true")  # how many pixels this machine can draw
    yield page
    context.close()
    # while the server is away, was killed in an answer, or refuses what was asked, the browser says so on the console
    expected = ("ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE", "status of 422")
    left = [trouble for trouble in troubles if not any(words in trouble for words in expected)]
    assert left == [], left


def is_own(url: str, server: Server) -> bool:
    return url.startswith((f"http://127.0.0.1:{server.port}/", "blob:", "data:"))


def settled(page: Page) -> None:
    expect(page.locator("#state")).to_have_attribute("data-kind", "settled")
    expect(page.locator("#view[data-light=gathering]")).to_have_count(0)


def picture(page: Page) -> NDArray[np.uint8]:
    """The pixels of the canvas, `[row, column, 3]`."""
    read = "document.getElementById('view').toDataURL('image/png').split(',')[1]"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(page.evaluate(read)))).convert("RGB"))


def ball(pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """The mean colour of the canvas's middle, which the sphere covers."""
    side = len(pixels)
    middle: NDArray[np.float64] = pixels[side // 3 : 2 * side // 3, side // 3 : 2 * side // 3].mean(axis=(0, 1))
    return middle


def field(page: Page, path: str) -> Any:
    return page.locator(f'[id="f-{path}"]')


def slider(page: Page, path: str) -> Any:
    return page.locator(f'[data-path="{path}"] input[type=range]')


def toml(page: Page) -> dict[str, Any]:
    return parse_toml(page.locator("#text").input_value(), "page")


def until(page: Page, true: Callable[[], bool]) -> None:
    last = time.monotonic() + PATIENCE_S
    while not true() and time.monotonic() < last:
        page.wait_for_timeout(30)
    assert true()


def memory_of(server: Server) -> float:
    status = Path(f"/proc/{server.process.pid}/statm")
    return float(status.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if status.exists() else 0.0


def unpack(data: bytes) -> dict[str, Any]:
    """Return the header of a packed appearance with its arrays by name."""
    (length,) = struct.unpack_from("<I", data)
    header: dict[str, Any] = json.loads(data[4 : 4 + length])
    at = 4 + length
    for name, shape in header["arrays"]:
        count = int(np.prod(shape))
        header[name] = np.frombuffer(data, "<f4", count, at).reshape(shape)
        at += 4 * count
    assert at == len(data)
    return header


def ask(socket: Any, seq: int, **question: Any) -> dict[str, Any]:
    """Send a request of a page and return the answer."""
    socket.send_text(json.dumps({"seq": seq, "name": "film.toml", "text": COMMENTED_FILM, **question}))
    return hear(socket)


def hear(socket: Any) -> dict[str, Any]:
    """Return the next answer."""
    message = socket.receive()
    return unpack(message["bytes"]) if message.get("bytes") else json.loads(message["text"])
