"""Film the studio in use for the README: the real page in Debian's chromium, driven by Playwright.

`python tools/make_studio_animation.py [OUT]` writes docs/images/studio.webp; half a minute to two. Waiting is cut:
a frame is taken where something has changed.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image, ImageDraw
from playwright.sync_api import Locator, Page, sync_playwright

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "studio.webp"
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
VIEW, SHOWN = (1240, 776), (992, 621)
QUALITY, MOST_BYTES = 82, 1_500_000
KEYS = {"kmin": 3, "kmax": 6}  # whole frames: of changes alone the blocks add up
STEP_MS, REST_MS, END_MS = 90, 900, 2600
PATIENCE_MS = 180_000
POINTER = [(0, 0), (0, 17), (4, 13), (7, 20), (10, 19), (7, 12), (13, 12)]
RECIPE = """family = "film"
substrate = "Al"
layers = [
  {material = "Cr", thickness_nm = 6},
  {material = "SiO2", thickness_nm = 230},
]

[surface]
roughness = 0.1
"""
SPACER = "layers[1].thickness_nm"
WANTED = ((0, "#e878c8"), (50, "#20d283"))


class Film:
    """The frames so far, and where the pointer is."""

    def __init__(self, page: Page) -> None:
        self.page, self.at = page, (700.0, 400.0)
        self.frames: list[Image.Image] = []
        self.durations: list[int] = []

    def take(self, ms: int = STEP_MS) -> None:
        """Take a frame that stands for so long."""
        shot = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        corner = [(self.at[0] + 1.25 * x, self.at[1] + 1.25 * y) for x, y in POINTER]
        ImageDraw.Draw(shot).polygon(corner, fill="white", outline="black", width=2)
        self.frames.append(shot.resize(SHOWN, Image.Resampling.LANCZOS))
        self.durations.append(ms)

    def go(self, target: Locator, share: float = 0.5, steps: int = 4) -> None:
        """Move the pointer to an element, so far along its width."""
        target.scroll_into_view_if_needed()
        box = target.bounding_box()
        assert box is not None
        end = (box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        start = self.at
        for step in range(1, steps + 1):
            part = step / steps
            self.at = (start[0] + part * (end[0] - start[0]), start[1] + part * (end[1] - start[1]))
            self.page.mouse.move(*self.at)
            self.take()

    def click(self, target: Locator, ms: int = STEP_MS) -> None:
        """Go to an element and click it."""
        self.go(target)
        target.click()
        self.take(ms)

    def save(self, out: Path) -> None:
        """Write all frames as one animated WebP."""
        self.frames[0].save(
            out, "WEBP", save_all=True, append_images=self.frames[1:], duration=self.durations, loop=0,
            quality=QUALITY, method=4, **KEYS,
        )  # fmt: skip


@contextmanager
def studio(folder: Path) -> Iterator[str]:
    """Run the server; yield its address."""
    command = [sys.executable, "-m", "nacre", "studio", str(folder), "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def settle(page: Page) -> None:
    """Wait until the newest answer is drawn."""
    page.wait_for_timeout(120)
    page.wait_for_selector("#state[data-kind=settled]")


def slide(film: Film, path: str, values: list[float]) -> None:
    """Drag a slider over some values, a frame each."""
    slider = film.page.locator(f'[data-path="{path}"] input[type=range]')
    box = slider.bounding_box()
    assert box is not None
    low, high = (float(slider.get_attribute(name) or 0) for name in ("min", "max"))
    for value in values:
        film.at = (box["x"] + 8 + (box["width"] - 16) * (value - low) / (high - low), box["y"] + 0.5 * box["height"])
        slider.evaluate("(e, v) => { e.value = v; e.dispatchEvent(new Event('input', {bubbles: true})); }", str(value))
        settle(film.page)
        film.take()


def play(film: Film) -> None:
    """Turn a number, turn the object, ask for two colours, load the answer, look at the settled picture."""
    page = film.page
    film.take(REST_MS)
    film.go(page.locator(f'[data-path="{SPACER}"] input[type=range]'), 0.5)
    slide(film, SPACER, [*range(240, 431, 10), *range(420, 349, -10)])
    film.go(page.locator("#view"), 0.35)
    page.mouse.down()
    for _ in range(8):
        film.at = (film.at[0] + 16, film.at[1] - 5)
        page.mouse.move(*film.at)
        page.wait_for_timeout(60)
        film.take()
    page.mouse.up()
    film.click(page.get_by_role("tab", name="Design"))
    page.wait_for_selector("#parameters .parameter-row")
    page.get_by_role("button", name="Add colour").click()
    for number, (angle, colour) in enumerate(WANTED, start=1):
        page.get_by_label(f"Angle of colour {number}").fill(str(angle))
        film.go(page.get_by_label(f"Choose colour {number}"), steps=3)
        page.get_by_label(f"Choose colour {number}").fill(colour)
        film.take(350)
    film.click(page.get_by_role("button", name="Show gamut"))
    page.wait_for_selector("#gamut-state:empty", state="attached")
    film.take(REST_MS)
    page.locator("#design-seconds").fill("10")
    film.click(page.get_by_role("button", name="Design", exact=True))
    said = ""
    while page.locator("#design-stop").is_visible():
        page.wait_for_timeout(250)
        now = page.locator("#design-state").inner_text()
        if now != said and page.locator("#solutions li").count():
            page.locator("#solutions").scroll_into_view_if_needed()
            film.take(260)
        said = now
    page.locator("#solutions").scroll_into_view_if_needed()
    film.take(REST_MS)
    film.click(page.get_by_role("button", name="Load solution 1"))
    settle(page)
    page.wait_for_timeout(600)
    film.take(1500)
    page.locator("#size").select_option("480")
    film.click(page.get_by_role("button", name="Render"))
    shown = ""
    while page.locator("#cancel").is_visible():
        page.wait_for_timeout(200)
        now = page.locator("#picture").get_attribute("data-spp") or ""
        if now != shown:
            page.wait_for_timeout(150)
            page.locator("#picture").scroll_into_view_if_needed()
            film.take(450)
        shown = now
    film.take(END_MS)


def main(arguments: list[str]) -> int:
    """Film; 0 if the file is small enough."""
    out = Path(arguments[0]) if arguments else OUT
    chromium = shutil.which("chromium")
    if chromium is None:
        print("no chromium; make setup gets it", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name, sync_playwright() as play_wright:
        (Path(name) / "shift.toml").write_text(RECIPE)
        browser = play_wright.chromium.launch(executable_path=chromium, args=FLAGS)
        with studio(Path(name)) as address:
            page = browser.new_page(viewport={"width": VIEW[0], "height": VIEW[1]})
            page.set_default_timeout(PATIENCE_MS)
            page.goto(address)
            page.get_by_role("button", name="Close").click()
            settle(page)
            page.wait_for_selector("#view[data-measured=true]")
            film = Film(page)
            play(film)
        browser.close()
    film.save(out)
    size = out.stat().st_size
    print(f"{out}: {len(film.frames)} frames, {sum(film.durations) / 1e3:.1f} s, {size / 1e6:.2f} MB")
    return 0 if size <= MOST_BYTES else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
