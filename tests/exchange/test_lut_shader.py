"""The exported GLSL, run alone in WebGL2, gives the colours that `nacre.spectrum` and `nacre.evaluate` give."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from helpers_browser import FLAGS, find_chromium
from numpy.typing import NDArray
from playwright.sync_api import Page, sync_playwright

import nacre
from nacre.light import delta_e_2000, spectrum_to_rgb_linear, srgb_linear_to_xyz, xyz_to_lab

Values = NDArray[np.float64]
BAR = 0.5  # dE00: the issue's
COUNT = 256
LAYERS = [{"material": "TiO2", "thickness_nm": 90}, {"material": "SiO2", "thickness_nm": 140}]
FILMS: dict[str, dict[str, Any]] = {
    "opaque": {"substrate": "Si", "layers": LAYERS},
    "transmitting": {"substrate": {"n": 1.5168}, "layers": LAYERS * 4},  # a table has one critical angle
    "free and varying": {
        "substrate": "air", "layers": [{"material": {"n": 1.33}, "thickness_nm": {"formula": "100 + 600*u", "min": 100,
                                                                                  "max": 700}}],
    },
    "rough and varying": {
        "substrate": "Ti", "layers": [{"material": "TiO2-film", "thickness_nm": {"formula": "20 + 220*u", "min": 20,
                                                                                 "max": 240}}],
        "surface": {"roughness": [0.1, 0.3], "compensate": True},
    },
    "beckmann": {"substrate": "Si", "layers": LAYERS, "surface": {"roughness": 0.3, "distribution": "beckmann"}},
    "blinn": {"substrate": "Si", "layers": LAYERS, "surface": {"roughness": 0.3, "distribution": "blinn"}},
    "ashikhmin-shirley": {
        "substrate": "Si", "layers": LAYERS, "surface": {"exponent": [5, 200], "distribution": "ashikhmin-shirley"},
    },
    "rough and transmitting": {"substrate": "BK7", "layers": LAYERS, "surface": {"roughness": 0.35}},
    "over a base": {
        "substrate": {"n": 1.5}, "layers": [{"material": "TiO2", "thickness_nm": 60}], "surface": {"roughness": 0.2},
        "base": {"albedo": 0.5},
    },
}  # fmt: skip
METASURFACE = {
    "family": "metasurface", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 400}],
    "particle": {"material": "Ag", "radius_nm": 60}, "monolayer": {"coverage": 0.1, "packing": 0.3},
}  # fmt: skip
RUN = """([source, count, pictures, pairs]) => {
  const canvas = document.createElement('canvas'), gl = canvas.getContext('webgl2');
  if (!gl || !gl.getExtension('EXT_color_buffer_float')) throw new Error('no WebGL2 with float buffers');
  const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const program = gl.createProgram();
  const vertex = `#version 300 es
    void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, source]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  const upload = (unit, name, width, height, values, inner, filter) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, gl.RGBA, gl.FLOAT, values);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, filter);
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
    gl.uniform1i(gl.getUniformLocation(program, name), unit);
  };
  pictures.forEach(([name, width, height, data], i) =>
    upload(i, name, width, height, floats(data), gl.RGBA16F, gl.LINEAR));
  upload(pictures.length, 'pairs', 2, count, floats(pairs), gl.RGBA32F, gl.NEAREST);
  gl.activeTexture(gl.TEXTURE8);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  const target = gl.getParameter(gl.TEXTURE_BINDING_2D);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 3, count, 0, gl.RGBA, gl.FLOAT, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, 3, count);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const out = new Float32Array(3 * count * 4);
  gl.readPixels(0, 0, 3, count, gl.RGBA, gl.FLOAT, out);
  return Array.from(out);
}"""
MAIN = """
uniform highp sampler2D pairs;
out vec4 colour;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 i = texelFetch(pairs, ivec2(0, at.y), 0), o = texelFetch(pairs, ivec2(1, at.y), 0);
  vec3 reflected = vec3(0.0), passed = vec3(0.0);
#ifdef NACRE_FACET
  nacreMirror(i.xyz, i.w, reflected, passed);
#endif
  colour = vec4(at.x == 0 ? nacreBrdf(i.xyz, o.xyz, i.w) : at.x == 1 ? reflected : passed, 1.0);
}
"""


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    path = find_chromium()
    with sync_playwright() as play:
        running = play.chromium.launch(executable_path=path, args=FLAGS)
        yield running.new_page()
        running.close()


def run_shader(page: Page, folder: Path, wi: Values, wo: Values, p: Values) -> tuple[Values, Values, Values]:
    """Run `shader.glsl` with the folder's EXR pictures; return f, what mirrors reflect, and pass, `[pair, 3]` each."""
    reported = json.loads((folder / "table.json").read_text())
    pictures = []
    for name in ("facet", "loss", "exchange", "lobe"):
        if name in reported["pictures"]:
            channels = OpenEXR.File(str(folder / f"{name}.exr"), separate_channels=True).channels()
            rows = np.stack([channels[key].pixels for key in "RGB"] + [np.ones_like(channels["R"].pixels)], axis=-1)
            pictures.append([f"nacre{name.capitalize()}", rows.shape[1], rows.shape[0], encoded(rows[::-1])])
    pairs = np.stack([np.concatenate([wi, p[:, None]], axis=1), np.concatenate([wo, p[:, None]], axis=1)], axis=1)
    source = "#version 300 es\n" + (folder / "shader.glsl").read_text() + MAIN
    out = np.array(page.evaluate(RUN, [source, len(wi), pictures, encoded(pairs)])).reshape(len(wi), 3, 4)[..., :3]
    assert np.all(np.isfinite(out))
    return out[:, 0], out[:, 1], out[:, 2]


def encoded(values: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()


def directions(seed: int, lowest: float = 0.17) -> Values:
    random = np.random.default_rng(seed)
    z, phi = random.uniform(lowest, 1, COUNT), random.uniform(0, 2 * np.pi, COUNT)
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(phi), flat * np.sin(phi), z], axis=-1)


def difference(rgb: Values, wanted: Values) -> Values:
    labs = [np.asarray(xyz_to_lab(srgb_linear_to_xyz(c))) for c in (rgb, wanted)]
    return np.asarray(delta_e_2000(*labs))


def near(wi: Values, seed: int) -> Values:
    """Directions about the mirror ones, where lobes are."""
    mirror = wi * np.array([-1.0, -1.0, 1.0])
    turned = mirror + 0.3 * np.random.default_rng(seed).normal(size=wi.shape)
    turned[:, 2] = np.maximum(np.abs(turned[:, 2]), 0.2)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def films() -> list[Any]:
    slow = ("free and varying", "blinn", "ashikhmin-shirley")
    return [pytest.param(name, marks=[pytest.mark.full] if name in slow else []) for name in FILMS]


@pytest.mark.parametrize("name", films())
def test_films_have_the_colours_of_nacre(name: str, page: Page, tmp_path: Path) -> None:
    material = nacre.material({"family": "film", "ambient": "air", **FILMS[name]})
    nacre.export(material, "lut", tmp_path / "t")
    p = np.random.default_rng(5).uniform(size=COUNT)
    wi = directions(1)
    wo = near(wi, 2)
    through = wo * np.array([1.0, 1.0, -1.0])
    uv = np.stack([p, 0 * p + 0.3], axis=-1)
    grid = material.bsdf().wavelengths_nm
    f, reflected, passed = run_shader(page, tmp_path / "t", wi, wo, p)
    wanted = spectrum_to_rgb_linear(nacre.evaluate(material, wi, wo, uv=uv), grid)
    scale = np.pi * wi[:, 2:]
    assert difference(scale * f, scale * wanted).max() <= BAR
    f, _, _ = run_shader(page, tmp_path / "t", wi, through, p)
    wanted = spectrum_to_rgb_linear(nacre.evaluate(material, wi, through, uv=uv), grid)
    assert difference(scale * f, scale * wanted).max() <= BAR
    bsdf = material.bsdf()
    for turn in (1.0, -1.0):  # light from above, and from below
        delta = bsdf.specular(np.arccos(turn * wi[:, 2]), uv)
        _, reflected, passed = run_shader(page, tmp_path / "t", wi * np.array([1.0, 1.0, turn]), wo, p)
        for ours, theirs in ((reflected, delta.reflectance), (passed, delta.transmittance)):
            assert difference(ours, spectrum_to_rgb_linear(theirs, grid)).max() <= BAR
    if "surface" not in FILMS[name] and "formula" not in str(FILMS[name]):
        seen = nacre.spectrum(material, np.degrees(np.arccos(wi[:4, 2])), grid)
        _, reflected, _ = run_shader(page, tmp_path / "t", wi, wo, p)
        assert difference(reflected[:4], spectrum_to_rgb_linear(seen.specular_reflectance, grid)).max() <= BAR


def test_a_metasurface_has_the_colours_of_nacre(page: Page, tmp_path: Path) -> None:
    check_scatter(nacre.material(METASURFACE), page, tmp_path / "t")


@pytest.mark.full
@pytest.mark.render
def test_a_pearl_has_the_colours_of_nacre(page: Page, tmp_path: Path) -> None:
    """In the form without noise, which is what the picture is filled with."""
    check_scatter(nacre.load("pearl/bottle3").vary({"quality": "fast"}), page, tmp_path / "t")


def check_scatter(material: Any, page: Page, folder: Path) -> None:
    """All but one pair in twenty: those that meet a ring or a peak between the nodes."""
    nacre.export(material, "lut", folder)
    grid = material.bsdf().wavelengths_nm
    for seed, spread in ((1, False), (2, True)):
        wi = directions(seed)
        wo = directions(seed + 7) if spread else near(wi, seed)
        f, _, _ = run_shader(page, folder, wi, wo, np.zeros(COUNT))
        wanted = spectrum_to_rgb_linear(nacre.evaluate(material, wi, wo), grid)
        scale = np.pi * wi[:, 2:]
        gap = difference(scale * f, scale * wanted)
        assert np.quantile(gap, 0.95) <= BAR
