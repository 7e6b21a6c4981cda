"""`nacre.studio(material)`: the messages to the widget, and its picture in a browser, with a stub of the notebook."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from helpers_studio import PATIENCE_S, SEEN, ball, picture, until
from PIL import Image
from playwright.sync_api import Browser

import nacre
from nacre.light import spectrum_to_rgb_linear
from nacre.studio import notebook
from nacre.studio.appearance import Appearance, appearances
from nacre.studio.notebook import NotebookView, sliders

Messages = list[tuple[dict[str, Any], bytes]]
FILM = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 300}]}
OVER_BASE = {**FILM, "substrate": {"n": 1.5}, "base": {"albedo": 0.3}, "surface": {"roughness": 0.2}}  # drafted first
FIRST = "layers[0].thickness_nm"
# what a notebook's front end gives a module, by the documentation of anywidget; ids for the helpers of the page
STUB = """async ([source, style]) => {
  document.body.innerHTML = `<style>${style}</style><div id="cell"></div>`;
  document.addEventListener('keydown', (e) => {   // JupyterLab: `:focus` matches its shortcuts of the arrow keys
    if (e.target.hasAttribute('data-lm-suppress-shortcuts')) return;
    e.preventDefault();
    e.stopPropagation();
  }, true);
  window.passed = [];                             // VS Code: what reaches the window is a key of the notebook
  window.addEventListener('keydown', (e) => window.passed.push(e.key));
  const heard = new Set(), sent = (window.sent = []);
  const model = { on: (name, f) => name === 'msg:custom' && heard.add(f), off: (name, f) => heard.delete(f),
    send: (content) => sent.push(content) };
  window.deliver = (content, texts) => heard.forEach((f) => f(content, texts.map((text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0)), odd = new Uint8Array(bytes.length + 1);
    odd.set(bytes, 1);
    return new DataView(odd.buffer, 1);
  })));
  const made = await import(URL.createObjectURL(new Blob([source], { type: 'text/javascript' })));
  window.end = await made.default.render({ model, el: document.getElementById('cell') });
  document.querySelector('.view').id = 'view';
}"""


def answers(lamp: str = "D65") -> tuple[NotebookView, Messages]:
    sent: Messages = []
    return NotebookView(lambda content, *buffers: sent.append((content, b"".join(buffers))), lamp), sent


def header(packed: bytes) -> dict[str, Any]:
    (length,) = struct.unpack_from("<I", packed)
    found: dict[str, Any] = json.loads(packed[4 : 4 + length])
    return found


def mirror(packed: bytes) -> Any:
    (length,) = struct.unpack_from("<I", packed)
    return np.frombuffer(packed, "<f4", 91 * 3, 4 + length).reshape(91, 3)


def test_a_film_is_sent_settled_at_once_with_its_colours_and_sliders() -> None:
    asked, sent = answers()
    film = nacre.material(FILM)
    asked.show(film)
    assert asked.worker.wait(PATIENCE_S)
    ((content, packed),) = sent
    assert content == {"kind": "appearance"} and header(packed)["draft"] is False
    assert header(packed)["numbers"] == [{"path": FIRST, "value": 300.0, "max": 600.0}]
    found = nacre.spectrum(film, [0.0, 60.0])
    assert found.specular_reflectance is not None
    wanted = spectrum_to_rgb_linear(found.specular_reflectance, found.wavelengths_nm)
    np.testing.assert_allclose(mirror(packed)[[0, 60]], wanted, atol=1e-4)  # the white of sRGB is rounded


def test_a_slow_material_is_sent_as_a_draft_and_then_settled() -> None:
    asked, sent = answers()
    asked.show(nacre.material(OVER_BASE))
    assert asked.worker.wait(PATIENCE_S)
    assert [header(packed)["draft"] for _, packed in sent] == [True, False]


def test_the_newest_material_is_sent_last_and_nothing_after_it() -> None:
    asked, sent = answers()
    for thickness in (100, 150, 200):
        asked.show(nacre.material({**OVER_BASE, "layers": [{"material": "SiO2", "thickness_nm": thickness}]}))
    assert asked.material.get(FIRST) == 200
    assert asked.worker.wait(PATIENCE_S)
    seen = [header(packed) for _, packed in sent]
    assert [look["seq"] for look in seen] == sorted(look["seq"] for look in seen)
    assert seen[-1]["numbers"][0]["value"] == 200 and seen[-1]["draft"] is False


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_picture_that_is_no_longer_requested_is_not_sent(is_stopped: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    look = next(appearances(nacre.material(FILM), "D65", lambda: False))
    asked, sent = answers()

    def drafted(material: nacre.Material, *_: Any) -> Iterator[Appearance]:
        if material.get(FIRST) == 300:  # while it is solved, another one is shown
            asked.worker.cancel() if is_stopped else asked.show(material.vary({FIRST: 120}))
        for is_draft in (True, False):
            yield dataclasses.replace(look, is_draft=is_draft)

    monkeypatch.setattr("nacre.studio.notebook.appearances", drafted)
    asked.show(nacre.material(FILM))
    assert asked.worker.wait(PATIENCE_S)
    seen = [(header(packed)["seq"], header(packed)["draft"]) for _, packed in sent]
    assert seen == ([] if is_stopped else [(2, True), (2, False)])


def test_a_slider_changes_the_material_and_nonsense_does_not() -> None:
    asked, sent = answers()
    asked.show(nacre.material(FILM))
    for nonsense in ("x", {}, {"kind": "vary", "path": "substrate", "value": 1}, {"kind": "vary", "path": FIRST}):
        asked.receive(nonsense)
    assert asked.material.get(FIRST) == 300
    asked.receive({"kind": "vary", "path": FIRST, "value": 120})
    assert asked.material.get(FIRST) == 120
    asked.receive({"kind": "vary", "path": FIRST, "value": -1})
    assert asked.material.get(FIRST) == 120
    assert asked.worker.wait(PATIENCE_S)
    (said,) = [content["message"] for content, _ in sent if content["kind"] == "error"]
    assert FIRST in said and "\n" not in said
    assert header(sent[-1][1] or sent[-2][1])["numbers"][0] == {"path": FIRST, "value": 120.0, "max": 600.0}


def test_sliders_leave_out_constants_of_media_and_zeros() -> None:
    found = [slider["path"] for slider in sliders(nacre.load("pearl/bottle3"))]
    assert "strata[0].thickness_um" in found and "strata[0].resin.n" not in found and len(found) <= 6


def test_without_anywidget_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "anywidget", None)
    notebook.widget_class.cache_clear()  # another test may have made the class
    with pytest.raises(nacre.NacreError, match=r"pip install 'nacre\[notebook\]'") as sent:
        nacre.studio(nacre.material(FILM))
    assert "\n" not in str(sent.value)


@pytest.mark.parametrize("first", ["import nacre; nacre.studio", "from nacre.studio.notebook import NotebookView"])
def test_the_studio_is_a_function_and_a_package_whichever_is_used_first(first: str) -> None:
    code = f"{first}\nimport nacre\nfrom nacre.studio.folder import OpenedFolder\nassert callable(nacre.studio)"
    code += "\nimport sys; assert 'anywidget' not in sys.modules and nacre.studio.folder.OpenedFolder is OpenedFolder"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr


def test_the_widget_shows_another_material_and_refuses_what_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    widget = nacre.studio(nacre.material(FILM))
    sent: Messages = []
    monkeypatch.setattr(widget, "send", lambda content, buffers: sent.append((content, b"".join(buffers))))
    assert widget.view.worker.wait(PATIENCE_S)
    widget.material = "bragg-mirror"
    assert widget.view.worker.wait(PATIENCE_S)
    assert widget.material.name == "bragg-mirror" and header(sent[-1][1])["name"] == "bragg-mirror"
    for wrong in (3, "no-such-recipe"):
        with pytest.raises(nacre.NacreError):
            widget.material = wrong
    with pytest.raises(nacre.NacreError, match="D56"):
        nacre.studio("bragg-mirror", illuminant="D56")
    assert widget.material.name == "bragg-mirror"
    widget.close()


def test_the_module_reaches_for_no_network_and_leaves_nothing_to_import() -> None:
    text = notebook.bundle("widget.js")
    lines = text.splitlines()
    assert not [line for line in lines if line.startswith("import ")]
    assert [line for line in lines if line.startswith("export ")] == ["export default _widget_js;"]
    for reach in ("WebSocket", "fetch(", "XMLHttpRequest", "location."):
        assert reach not in text


NOT_UNDERSTOOD = [
    'import x from "./page/view.js";',
    'const x = import("./page/view.js");',
    "export default 1;",
    "export { a };",
    'import { Vew } from "./page/view.js";',
    'import { a } from "./entry.js";',
]


@pytest.mark.parametrize("source", NOT_UNDERSTOOD)
def test_what_the_bundler_does_not_understand_is_an_error(
    source: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    folder = tmp_path / "studio"
    shutil.copytree(notebook.files("nacre.studio").joinpath("page"), folder / "page")  # type: ignore[arg-type]
    (folder / "entry.js").write_text(source)
    monkeypatch.setattr(notebook, "files", lambda _: folder)
    with pytest.raises(ValueError):
        notebook.bundle("entry.js")


@pytest.mark.full
def test_the_sphere_is_seen_in_a_cell_and_follows_the_material_and_its_slider(browser: Browser) -> None:
    page = browser.new_page(viewport={"width": 900, "height": 700})
    page.set_default_timeout(1e3 * PATIENCE_S)
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("console", lambda said: troubles.append(said.text) if said.type == "error" else None)
    page.on("request", lambda request: troubles.append(request.url) if request.url.startswith("http") else None)
    style = notebook.files("nacre.studio").joinpath("widget.css").read_text(encoding="utf-8")
    page.evaluate(STUB, [notebook.bundle("widget.js"), style])
    asked, sent = answers()

    def hand_over() -> None:
        for content in page.evaluate("window.sent.splice(0)"):
            asked.receive(content)
        while sent:
            content, packed = sent.pop(0)
            page.evaluate("([c, b]) => window.deliver(c, b)", [content, [base64.b64encode(packed).decode()]])

    def settles(seq: int) -> bool:
        hand_over()
        return bool(
            page.locator(".nacre-studio").get_attribute("data-seq") == str(seq)
            and page.locator("#view").get_attribute("data-seq") == str(seq)
            and page.locator(".nacre-studio").get_attribute("data-state") == "settled"
            and page.locator("#view").get_attribute("data-measured") == "true"
        )

    asked.show(nacre.material(FILM))
    until(page, lambda: settles(1))
    before = picture(page)
    assert before.std() > 10 and ball(before).max() > 20
    ribbon = "[...document.querySelector('.ribbon').getContext('2d').getImageData(0, 0, 182, 1).data].slice(0, 3)"
    assert max(page.evaluate(ribbon)) > 20
    curves = """(canvas) => {
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        return data.filter((value, i) => i % 4 === 3 && value).length; }"""
    assert page.locator(".chart canvas").evaluate(curves) > 200  # pixels: three curves over the width
    page.locator("#view").focus()
    for _ in range(8):
        page.keyboard.press("ArrowRight")
    until(page, lambda: bool(np.abs(picture(page).astype(int) - before).mean() > 1))

    seen = ball(picture(page))
    page.locator(f'[data-path="{FIRST}"]').fill("120")
    until(page, lambda: settles(2))
    assert asked.material.get(FIRST) == 120
    assert np.abs(ball(picture(page)) - seen).max() > SEEN

    page.locator(f'[data-path="{FIRST}"]').press("ArrowRight")
    until(page, lambda: settles(3))
    assert asked.material.get(FIRST) > 120
    page.keyboard.press("Tab")
    assert page.evaluate("window.passed") == ["Tab"]  # arrows have turned the view and moved the slider alone

    seen = ball(picture(page))
    asked.show(nacre.load("jewel-beetle"))
    until(page, lambda: settles(4))
    assert np.abs(ball(picture(page)) - seen).max() > SEEN
    assert page.locator(".sliders label").count() == 6
    asked.receive(
        {"kind": "vary", "path": page.locator(".sliders input").first.get_attribute("data-path"), "value": -1}
    )
    until(page, lambda: not hand_over() and page.locator(".nacre-studio").get_attribute("data-state") == "error")
    page.evaluate("window.end()")
    page.close()
    assert troubles == []


MANY = 18  # a browser has 16 contexts of WebGL
CELLS = """async ([source, style, count]) => {
  document.body.innerHTML = `<style>${style} .cell { margin-bottom: 40px; }</style>`;
  const made = await import(URL.createObjectURL(new Blob([source], { type: 'text/javascript' })));
  window.cells = [];
  for (let i = 0; i < count; i++) {
    const el = Object.assign(document.createElement('div'), { className: 'cell' }), heard = new Set();
    document.body.append(el);
    const model = { on: (name, f) => heard.add(f), off: (name, f) => heard.delete(f), send: () => {} };
    await made.default.render({ model, el });
    window.cells.push((content, text) => heard.forEach((f) => f(content,
      [new DataView(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer)])));
  }
}"""


@pytest.mark.full
def test_a_notebook_of_more_materials_than_a_browser_has_contexts_shows_each_where_it_is_looked_at(
    browser: Browser,
) -> None:
    page = browser.new_page(viewport={"width": 900, "height": 700})
    page.set_default_timeout(1e3 * PATIENCE_S)
    troubles: list[str] = []
    page.on("console", lambda said: troubles.append(said.text) if said.type in ("error", "warning") else None)
    style = notebook.files("nacre.studio").joinpath("widget.css").read_text(encoding="utf-8")
    page.evaluate(CELLS, [notebook.bundle("widget.js"), style, MANY])
    for cell in range(MANY):
        asked, sent = answers()
        asked.show(nacre.material({**FILM, "layers": [{"material": "SiO2", "thickness_nm": 100 + 20 * cell}]}))
        assert asked.worker.wait(PATIENCE_S)
        asked.send_room()
        for content, packed in sent:
            page.evaluate("([i, c, b]) => window.cells[i](c, b)", [cell, content, base64.b64encode(packed).decode()])

    def seen(cell: int) -> float:
        canvas = page.locator(".view").nth(cell)
        canvas.scroll_into_view_if_needed()
        pixels = np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB"))
        return float(pixels.std())

    for cell in (*range(MANY), 0):
        until(page, lambda cell=cell: seen(cell) > 10)  # type: ignore[misc]
    page.close()
    assert [trouble for trouble in troubles if "Too many active WebGL contexts" in trouble] == []
