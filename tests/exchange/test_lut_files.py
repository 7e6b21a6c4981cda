"""`--to lut` writes a folder whole or not at all: pictures, shaders and scripts that name what is there."""

from __future__ import annotations

import ast
import json
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

import nacre
from nacre.analysis.lut import make_table
from nacre.bsdf.lobes.interface import Specular
from nacre.cli import run
from nacre.core.errors import NacreError, UnsupportedError
from nacre.formats.lut import angle_coordinate
from nacre.light import spectrum_to_rgb_matrix, srgb_decode
from nacre.light.tristimulus import illuminant, weighted_sum
from nacre.measure.colours import colour_bsdf
from nacre.recipe.toml import dump_toml

LAYERS = [{"material": "TiO2", "thickness_nm": 60}]
VARYING = [{"material": "TiO2", "thickness_nm": {"formula": "30 + 60*u + 30*v", "min": 30, "max": 120}}]
FILMS: dict[str, dict[str, Any]] = {
    "opaque": {"family": "film", "substrate": "Si", "layers": LAYERS, "surface": {"roughness": [0.1, 0.3]}},
    "varying": {"family": "film", "substrate": "Si", "layers": VARYING},
    "clear": {"family": "film", "substrate": "BK7", "layers": LAYERS},
    "based": {
        "family": "film", "substrate": {"n": 1.5}, "layers": LAYERS, "surface": {"roughness": 0.2},
        "base": {"albedo": 0.5},
    },
}  # fmt: skip
SHOWN = 0.01  # of white: half of a step of 8-bit sRGB in the middle greys


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("tables")
    for name, recipe in FILMS.items():
        nacre.export(nacre.material(recipe), "lut", root / name)
    return {name: root / name for name in FILMS}


def manifest(folder: Path) -> dict[str, Any]:
    reported: dict[str, Any] = json.loads((folder / "table.json").read_text())
    return reported


def exr(path: Path) -> NDArray[np.float64]:
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return np.stack([channels[key].pixels for key in "RGB"], axis=-1).astype(float)


@pytest.mark.parametrize("name", FILMS)
def test_the_folder_holds_what_its_manifest_and_its_page_say(name: str, folders: dict[str, Path]) -> None:
    folder, reported = folders[name], manifest(folders[name])
    assert {entry.name for entry in folder.iterdir()} == {*reported["files"], "table.json"}
    assert {"shader.glsl", "shader.osl", "blender.py", "material.mtlx", "index.html"} <= set(reported["files"])
    page = (folder / "index.html").read_text()
    for title, picture in reported["pictures"].items():
        assert exr(folder / f"{title}.exr").shape[:2] == (picture["bands"] * picture["rows"], picture["columns"])
        assert f'src="{title}.png"' in page
    assert reported["illuminant"] == "D65" and "D65" in page
    for what, found in reported["errors_dE00"].items():
        assert f"{found['mean']:.2f}" in page and what in page
    assert "http" not in page.replace("http-equiv", "")  # it asks nobody for anything


@pytest.mark.render
def test_the_png_holds_16_bits_of_what_the_exr_holds(folders: dict[str, Path]) -> None:
    import nacre.render

    mi = nacre.render.use_variant()
    for title in ("mirror", "map"):
        picture = manifest(folders["varying"])["pictures"][title]
        read = mi.Bitmap(str(folders["varying"] / f"{title}.png"))
        assert read.component_format() == mi.Struct.Type.UInt16
        unit = np.asarray(read, dtype=float) / 65535
        held = picture["png_scale"] * (unit if picture["is_data"] else srgb_decode(unit))
        wanted = exr(folders["varying"] / f"{title}.exr")
        inside = np.all((wanted >= 0) & (wanted <= 1), axis=-1)
        assert inside.mean() > 0.5
        np.testing.assert_allclose(held[inside], wanted[inside], atol=1e-3)


def test_the_map_runs_as_the_formula_does(folders: dict[str, Path]) -> None:
    """With v = 1 at the top of the file, as engines have it."""
    values = exr(folders["varying"] / "map.exr")[..., 0]
    rows, columns = values.shape
    u, v = (np.arange(columns) + 0.5) / columns, 1 - (np.arange(rows) + 0.5) / rows
    np.testing.assert_allclose(values, (60 * u + 30 * v[:, None]) / 90, atol=1e-6)


def test_blenders_script_compiles_and_loads_what_is_there(folders: dict[str, Path]) -> None:
    """Run with a stand-in for Blender that records what is asked of it."""
    for name, folder in folders.items():
        text = (folder / "blender.py").read_text()
        ast.parse(text)
        bpy = MagicMock()
        module = types.ModuleType("blender")
        module.__file__ = str(folder / "blender.py")
        sys.modules["bpy"] = bpy
        try:
            exec(compile(text, "blender.py", "exec"), module.__dict__)
            module.build()
        finally:
            del sys.modules["bpy"]
        loaded = [call.args[0] for call in bpy.data.images.load.call_args_list]
        kinds = [call.args[0] for call in bpy.data.materials.new.return_value.node_tree.nodes.new.call_args_list]
        assert loaded and all(Path(path).is_file() for path in loaded), name
        closures = [c["kind"] for c in manifest(folder)["closures"]]
        assert ("ShaderNodeBsdfRefraction" in kinds) == ("refract" in closures)
        assert ("ShaderNodeBsdfDiffuse" in kinds) == ("diffuse" in closures)
        assert "ShaderNodeBsdfAnisotropic" in kinds


@pytest.mark.parametrize("name", FILMS)
def test_the_graph_is_valid_materialx_and_becomes_glsl(name: str, folders: dict[str, Path]) -> None:
    import MaterialX
    from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenShader

    libraries = MaterialX.createDocument()
    search = MaterialX.getDefaultDataSearchPath()
    MaterialX.loadLibraries(MaterialX.getDefaultDataLibraryFolders(), search, libraries)
    document = MaterialX.createDocument()
    MaterialX.readFromXmlFile(document, str(folders[name] / "material.mtlx"))
    document.importLibrary(libraries)
    is_valid, said = document.validate()
    assert is_valid, said
    asked = [e for e in ET.parse(folders[name] / "material.mtlx").iter("input") if e.get("name") == "file"]
    assert asked and all((folders[name] / str(element.get("value"))).is_file() for element in asked)
    generator = PyMaterialXGenGlsl.GlslShaderGenerator.create()
    context = PyMaterialXGenShader.GenContext(generator)
    context.registerSourceCodeSearchPath(search)
    element = PyMaterialXGenShader.findRenderableElements(document)[0]
    shader = generator.generate("made", element, context)
    assert "mirror_picture" in shader.getSourceCode("pixel")


def test_a_table_for_another_lamp_says_so_and_differs(tmp_path: Path, folders: dict[str, Path]) -> None:
    (tmp_path / "film.toml").write_text(dump_toml(FILMS["varying"]))
    args = ["export", str(tmp_path / "film.toml"), "--to", "lut", "--illuminant", "A", "-o", str(tmp_path / "t")]
    assert run(args) == 0
    assert manifest(tmp_path / "t")["illuminant"] == "A"
    gap = np.abs(exr(tmp_path / "t" / "mirror.exr") - exr(folders["varying"] / "mirror.exr"))
    assert gap.max() > SHOWN


def test_the_command_and_python_write_the_same_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "film.toml").write_text(dump_toml(FILMS["clear"]))
    reported = nacre.export(tmp_path / "film.toml", "lut", tmp_path / "p")
    assert run(["export", str(tmp_path / "film.toml"), "--to", "lut", "--json", "-o", str(tmp_path / "c")]) == 0
    said = json.loads(capsys.readouterr().out)
    assert {**said, "file": ""} == {**reported, "file": ""}
    for entry in (tmp_path / "p").iterdir():
        assert entry.read_bytes() == (tmp_path / "c" / entry.name).read_bytes(), entry.name


def test_a_second_run_replaces_the_first_and_strangers_files_stay(tmp_path: Path) -> None:
    material, target = nacre.material(FILMS["clear"]), tmp_path / "t"
    nacre.export(material, "lut", target)
    before = exr(target / "mirror.exr")
    nacre.export(material.vary({"layers[0].thickness_nm": 140}), "lut", target)
    assert np.abs(exr(target / "mirror.exr") - before).max() > SHOWN
    (target / "notes.txt").write_text("mine")
    with pytest.raises(NacreError, match="contains other files"):
        nacre.export(material, "lut", target)
    assert (target / "notes.txt").read_text() == "mine"
    assert [entry.name for entry in tmp_path.iterdir()] == ["t"]


BLEND = {"family": "blend", "first": FILMS["clear"], "second": FILMS["opaque"], "mask": {"formula": "u"}}
TWO = [{"material": "TiO2", "thickness_nm": {"formula": "50 + 9*v", "min": 50, "max": 60}}]
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "grooves": ({"family": "film", "preset": "morpho"}, "direction about"),
    "two numbers": ({**FILMS["varying"], "layers": VARYING + TWO}, "vary over the surface, and a table holds one"),
    "varying roughness": (
        {**FILMS["opaque"], "surface": {"roughness": {"formula": "0.1 + 0.2*u", "min": 0.1, "max": 0.3}}},
        "roughness varies",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_no_table_holds_is_refused_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe, said = REFUSED[name]
    (tmp_path / "m.toml").write_text(dump_toml(recipe))
    assert run(["export", str(tmp_path / "m.toml"), "--to", "lut", "-o", str(tmp_path / "t")]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert said in line and "m.toml" in line
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.toml"]


def test_bad_folders_and_lamps_are_refused_before_any_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.toml").write_text(dump_toml(FILMS["clear"]))
    recipe = str(tmp_path / "m.toml")
    cases = [
        (["-o", str(tmp_path / "none" / "t")], "does not exist"),
        (["-o", recipe], "is not a folder"),
        (["-o", str(tmp_path)], "contains other files"),
        (["--illuminant", "D66", "-o", str(tmp_path / "t")], "D66"),
    ]
    for arguments, said in cases:
        assert run(["export", recipe, "--to", "lut", *arguments]) == 2
        assert said in capsys.readouterr().err.strip().splitlines()[-1]
    assert run(["export", recipe, "--to", "gltf", "--illuminant", "A", "-o", str(tmp_path / "m.gltf")]) == 2
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.toml"]


def test_a_blend_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match="export each by itself"):
        nacre.export(nacre.material(BLEND), "lut", tmp_path / "t")


def test_a_grating_is_refused(tmp_path: Path) -> None:
    made = {
        "family": "grating", "substrate": "Al", "profile": {"shape": "sinusoidal", "depth_nm": 80},
        "lattice": {"period_nm": 800}, "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 150},
    }  # fmt: skip
    with pytest.raises(UnsupportedError):
        nacre.export(made, "lut", tmp_path / "t")
    assert not (tmp_path / "t").exists()


def test_a_compiled_film_is_exported_as_its_recipe(tmp_path: Path) -> None:
    film = nacre.material(FILMS["opaque"])
    film.bsdf(np.arange(380.0, 781.0, 20.0)).save(tmp_path / "film.nacre")
    nacre.export(nacre.load(tmp_path / "film.nacre"), "lut", tmp_path / "t")
    assert manifest(tmp_path / "t")


def test_light_that_crosses_a_clear_body_has_the_colour_of_both_films() -> None:
    """<T T> in each channel, not <T> <T>: light inside came through the film; uniform light stays uniform."""
    pairs = [{"material": m, "thickness_nm": d} for m, d in (("TiO2", 51.9), ("SiO2", 94.2))] * 5
    material = nacre.material({"family": "film", "substrate": {"n": 1.5}, "layers": pairs})
    table = make_table(material)
    lamp = illuminant("D65")
    bsdf = colour_bsdf(material, lamp.name)
    passed = next(lobe for lobe in bsdf.lobes if isinstance(lobe, Specular)).response.transmittance[-1]
    matrix = spectrum_to_rgb_matrix(bsdf.wavelengths_nm, lamp)
    through, behind, mirror = (
        table.pictures[n].values[0, 0, 0] for n in ("through", "through-behind", "mirror-behind")
    )
    both = np.asarray(weighted_sum(passed**2, matrix))
    is_inside = both > 0  # colours outside sRGB are clipped
    assert is_inside.any() and np.all(np.abs(both - through * through)[is_inside] > 0.02)
    np.testing.assert_allclose((through * behind)[is_inside], both[is_inside], atol=1e-6)
    lossless = nacre.material(
        {"family": "film", "substrate": {"n": 1.5}, "layers": [{"material": {"n": 2.3}, "thickness_nm": 300}]}
    )
    pictures = make_table(lossless).pictures
    for end in ("", "-behind"):
        total = pictures[f"mirror{end}"].values + (
            pictures[f"through{end}"].values if f"through{end}" in pictures else 0
        )
        np.testing.assert_allclose(total, 1.0, atol=2e-3)


def test_each_side_of_a_refracting_closure_has_the_index_of_the_medium_beyond() -> None:
    from nacre.formats.lut import Closure, _closure_lines

    picture = types.SimpleNamespace(rows="p", values=np.zeros((1, 2, 3, 3)))
    table: Any = types.SimpleNamespace(pictures={"front": picture, "behind": picture})
    front, behind = _closure_lines(table, Closure("refract", "front", "behind", "ggx", (0.2, 0.2), 1.5)).splitlines()
    assert '"front.exr"' in front and float(front.split(", ")[-2]) == 1.5
    assert '"behind.exr"' in behind and float(behind.split(", ")[-2]) == pytest.approx(1 / 1.5)


def test_the_coordinate_of_an_angle_is_its_share_of_a_right_angle() -> None:
    angles = np.array([0.0, 22.5, 60.0, 90.0])
    np.testing.assert_allclose(angle_coordinate(np.cos(np.radians(angles))), angles / 90.0, atol=1e-12)
