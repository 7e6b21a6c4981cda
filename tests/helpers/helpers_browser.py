"""Debian's chromium for tests: where it is, and how it draws WebGL2 without a graphics card."""

from __future__ import annotations

import shutil

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
# WebGL2 drawn by the CPU
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking"]


def find_chromium() -> str:
    """Return its path, or fail in one line."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.fail("no chromium: what runs in a browser cannot be tested; make setup gets it by apt", pytrace=False)
    return found
