"""`nacre studio` in Debian's chromium with software GL: slider to pixel, first pixel, fifty pages, look, memory.

Floor: a socket's round trip (1 ms), the solution of ten layers at 91 angles (8 ms), a picture of 400 x 400 by
SwiftShader (20-40 ms).
Prediction (before the first run): 60 ms from slider to pixel on two free cores; fifty pages are bound by one Python.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import asyncio
import base64
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import websockets
from common import Row, parser, report
from PIL import Image
from playwright.sync_api import Page, sync_playwright
from scipy.ndimage import gaussian_filter

import nacre
from nacre.light import delta_e_2000, srgb_decode, srgb_encode, srgb_linear_to_xyz, xyz_to_lab
from nacre.light.display import clip_to_srgb
from nacre.studio.appearance import appearances

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
LAYERS = [{"material": ("TiO2", "SiO2")[i % 2], "thickness_nm": (60, 92)[i % 2] + i} for i in range(10)]
SLIDE_BAR_MS, FIRST_BAR_S, PAGES_BAR_MS, LOOK_BAR, GROWTH_BAR = 60.0, 3.0, 500.0, 1.5, 1.05
PAGES, QUESTIONS, PAUSE_S = 50, 16, 0.5
SIDE, BALL = 384, (192, 183, 125)  # of the compared pictures; middle and radius of the sphere in them
FAMILIES = {
    "pearl/bottle3": "strata[0].platelets[0].volume_fraction",
    "metasurface/silver_on_oxide": "monolayer.coverage",
    "relief/star": "coherence.sigma",
}
MEANS_PX = 6.0  # over which a reference has the raw picture's mean colours
DRAFTS, WARM, DRAFT_BAR_MS, SETTLED_BAR_S = 10, 4, 400.0, 6.0
LOOKS = ("jewel-beetle", "copper", "gold", "blue-oxide", "metasurface/silver_on_oxide", "pearl/bottle3")
SLIDE = """async (count) => {
  const s = document.querySelector('[data-path="layers[0].thickness_nm"] input[type=range]');
  const v = document.getElementById('view'), gl = v.getContext('webgl2'), out = [], pixel = new Uint8Array(4);
  for (let i = 0; i < count; i++) {
    const drawn = new Promise((done) => {
      const watch = new MutationObserver(() => { watch.disconnect(); done(); });
      watch.observe(v, {attributes: true, attributeFilter: ['data-seq']});
    });
    const began = performance.now();
    s.value = 20 + (7 * i) % 150;
    s.dispatchEvent(new Event('input', {bubbles: true}));
    await drawn;
    gl.readPixels(v.width / 2, v.height / 2, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    out.push(performance.now() - began);
    await new Promise((done) => setTimeout(done, 60));
  }
  return [v.width, out];
}"""
OPEN = """(name) => { const s = document.getElementById('all-examples'); s.value = 'example:' + name;
  s.dispatchEvent(new Event('change')); }"""


class Studio:
    """The command in a process of its own."""

    def __init__(self, recipe: Path) -> None:
        command = [sys.executable, "-m", "nacre", "studio", str(recipe), "--no-browser", "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()
        self.port, self.token = self.address.split(":")[2].split("/")[0], self.address.partition("token=")[2]

    @property
    def resident_mb(self) -> float:
        """Memory that it has in use."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def end(self) -> None:
        """End it."""
        self.process.kill()
        self.process.communicate()


def settle(page: Page, timeout_s: float = 60.0) -> None:
    """Wait until the page says that it is settled, and stays so, and has gathered its light."""
    page.wait_for_timeout(400)
    page.wait_for_selector("#state[data-kind=settled]", timeout=1e3 * timeout_s)
    page.wait_for_selector("#view:not([data-light=gathering])", timeout=1e3 * timeout_s)


def drafts(name: str, path: str) -> tuple[list[float], float, float]:
    """Return seconds of warm drafts while a number is changed, of the last settled look, and the last draft's dE00."""
    material = nacre.load(name)
    began = material.get(path)
    took: list[float] = []
    for step in range(DRAFTS):
        solving = appearances(material.vary({path: began * (1.0 + 0.01 * step)}), "D65", lambda: False)
        started = time.perf_counter()
        draft = next(solving)
        took.append(time.perf_counter() - started)
    started = time.perf_counter()
    settled = next(solving)
    settling = time.perf_counter() - started
    labs = [np.array(look.swatches[0]["lab"]) for look in (draft, settled)]
    return took[WARM:], settling, float(np.mean(delta_e_2000(*labs)))


async def drag(studio: Studio, text: str, seconds: float) -> tuple[float, int, int]:
    """Change numbers at random without rest; return memory after over before (a tenth warms up), answers, errors."""
    random, here = np.random.default_rng(1), f"127.0.0.1:{studio.port}"
    head = {"cookie": f"nacre_studio_{studio.port}={studio.token}"}
    ends, before, answers, errors = time.monotonic() + seconds, 0.0, 0, 0
    async with websockets.connect(f"ws://{here}/ws", origin=f"http://{here}", additional_headers=head) as socket:  # type: ignore[arg-type]
        while time.monotonic() < ends:
            path = f"layers[{int(random.integers(len(LAYERS)))}].thickness_nm"
            edits = [{"path": path, "value": float(random.uniform(5, 400))}]
            await socket.send(json.dumps({"seq": answers, "name": "ten.toml", "text": text, "edits": edits}))
            errors += isinstance(await socket.recv(), str)
            answers += 1
            if not before and ends - time.monotonic() < 0.9 * seconds:
                before = studio.resident_mb
    return studio.resident_mb / before, answers, errors


async def many_pages(studio: Studio, text: str) -> list[float]:
    """Milliseconds of all answers to many pages, each of which changes a number twice a second."""
    waits: list[float] = []
    random = np.random.default_rng(0)

    async def one(index: int) -> None:
        await asyncio.sleep(PAUSE_S * index / PAGES)
        here, cookie = f"127.0.0.1:{studio.port}", f"nacre_studio_{studio.port}={studio.token}"
        head = {"cookie": cookie}
        async with websockets.connect(f"ws://{here}/ws", origin=f"http://{here}", additional_headers=head) as socket:  # type: ignore[arg-type]
            for seq in range(QUESTIONS):
                edits = [{"path": "layers[0].thickness_nm", "value": float(random.uniform(20, 150))}]
                began = time.perf_counter()
                await socket.send(json.dumps({"seq": seq, "name": "ten.toml", "text": text, "edits": edits}))
                answer = await socket.recv()
                took = time.perf_counter() - began
                assert isinstance(answer, bytes), answer
                if seq:
                    waits.append(1e3 * took)
                await asyncio.sleep(max(0.0, PAUSE_S - took))

    await asyncio.gather(*(one(index) for index in range(PAGES)))
    return waits


def crowd_waits(studio: Studio, text: str) -> list[float]:
    """`many_pages` in a thread of its own: Playwright has a loop of events in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(lambda: asyncio.run(many_pages(studio, text))).result()


def lab(rgb: Any) -> Any:
    return xyz_to_lab(srgb_linear_to_xyz(srgb_decode(rgb)))


def _unbiased(made: Any) -> Any:
    """Return a picture's linear sRGB with the mean colours of the raw one over some pixels.

    The denoiser takes an eighth of a pearl's blue at 48 samples a pixel, and gives back what stays within a bound: a
    reference has to give back all of it.
    """
    to_rgb = np.linalg.lstsq(made.xyz.reshape(-1, 3), made.rgb.reshape(-1, 3), rcond=None)[0]
    lost = 0.0 * made.xyz if made.raw is None else made.raw - made.xyz
    return (made.xyz + gaussian_filter(lost, (MEANS_PX, MEANS_PX, 0.0))) @ to_rgb


def compare(page: Page, name: str) -> float:
    """Mean dE00 of the page's sphere to Mitsuba's in the same light, camera and exposure."""
    page.evaluate(OPEN, name)
    settle(page)
    data = page.evaluate("document.getElementById('view').toDataURL('image/png')").split(",")[1]
    drawn = Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB").resize((SIDE, SIDE), Image.Resampling.LANCZOS)
    made = nacre.render(nacre.load(name), "sphere", light="studio", size=(SIDE, SIDE), spp=48, exposure=0.0)
    wanted = srgb_encode(clip_to_srgb(_unbiased(made)).rgb)
    y, x = np.mgrid[:SIDE, :SIDE]
    inside = (x - BALL[0]) ** 2 + (y - BALL[1]) ** 2 < BALL[2] ** 2
    return float(np.mean(np.asarray(delta_e_2000(lab(np.asarray(drawn) / 255.0), lab(wanted)))[inside]))


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    takes = parser(__doc__, repeats=60)
    takes.add_argument("--drag", type=float, default=25.0, help="seconds of dragging on the socket; 3600 for the hour")
    options = takes.parse_args(arguments)
    chromium = shutil.which("chromium")
    assert chromium, "no chromium; make setup gets it"
    page_folder = Path(nacre.__file__).parent / "studio" / "page"
    weight = sum(path.stat().st_size for path in page_folder.iterdir()) / 1e6
    with tempfile.TemporaryDirectory() as name, sync_playwright() as play:
        recipe = Path(name) / "ten.toml"
        recipe.write_text(nacre.material({"family": "film", "substrate": "Si", "layers": LAYERS}).text)
        crowd = Studio(recipe)
        waits = crowd_waits(crowd, recipe.read_text())
        crowd.end()
        dragged = Studio(recipe)
        with ThreadPoolExecutor(1) as pool:
            flat, answers, errors = pool.submit(
                lambda: asyncio.run(drag(dragged, recipe.read_text(), options.drag))
            ).result()
        dragged.end()
        browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.on("dialog", lambda dialog: dialog.accept())  # changes that are not saved may go
        began = time.perf_counter()
        studio = Studio(recipe)
        page.goto(studio.address)
        page.wait_for_selector("#view[data-seq]")
        first = time.perf_counter() - began
        settle(page)
        side, slides = page.evaluate(SLIDE, options.repeats)
        before = studio.resident_mb
        page.evaluate(SLIDE, 4 * options.repeats)
        growth = studio.resident_mb / before
        looks = {look: compare(page, look) for look in LOOKS}
        browser.close()
        studio.end()
    slow = {look: drafts(look, path) for look, path in FAMILIES.items()}
    listed = ", ".join(f"{look} {value:.1f}" for look, value in looks.items())
    rows = [
        Row(f"slider to changed pixel, film of 10 layers, {side} x {side}, p95", float(np.quantile(slides, 0.95)), "ms",
            SLIDE_BAR_MS, higher_is_better=False, note=f"median {np.median(slides):.0f} ms"),
        Row("nacre studio to first coloured pixel, browser open", first, "s", FIRST_BAR_S, higher_is_better=False),
        Row(f"{PAGES} pages, a change every {PAUSE_S:g} s, p95", float(np.quantile(waits, 0.95)), "ms", PAGES_BAR_MS,
            higher_is_better=False, note=f"{len(waits)} answers, none lost; median {np.median(waits):.0f} ms"),
        Row("server's memory after 300 / after 60 changes", growth, "x", GROWTH_BAR, higher_is_better=False),
        Row(f"server's memory over {options.drag:g} s of random dragging on the socket", flat, "x", GROWTH_BAR,
            higher_is_better=False, note=f"{answers} answers, {errors} errors"),
        Row("sphere against Mitsuba, mean of six materials", float(np.mean(list(looks.values()))), "dE00", LOOK_BAR,
            higher_is_better=False, note=listed),
        *[
            Row(f"{look}: draft, p95", 1e3 * float(np.quantile(took, 0.95)), "ms", DRAFT_BAR_MS, higher_is_better=False,
                note=f"dE00 {apart:.1f} from the settled one, at 0, 30 and 60 degrees")
            for look, (took, _, apart) in slow.items()
        ],
        *[
            Row(f"{look}: settled", settling, "s", SETTLED_BAR_S, higher_is_better=False)
            for look, (_, settling, _) in slow.items()
        ],
        Row("weight of the page", weight, "MB", 1.0, higher_is_better=False),
    ]  # fmt: skip
    return report("studio: the page in chromium with software GL", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
