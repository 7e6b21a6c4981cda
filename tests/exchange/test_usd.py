"""MaterialX and USD as their own libraries see them: valid, code in every language, and the same network."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

import nacre

FILMS: dict[str, dict[str, Any]] = {
    "gold": {"substrate": "Au", "layers": [{"material": "SiO2", "thickness_nm": 150}], "surface": {"roughness": 0.25}},
    "clear": {"substrate": "BK7", "layers": [{"material": "TiO2", "thickness_nm": 60}], "surface": {"roughness": 0.2}},
    "varying": {
        "substrate": "Ti", "layers": [{"material": "TiO2-film", "thickness_nm": {"formula": "20 + 220*u", "min": 20,
                                                                                 "max": 240}}],
        "surface": {"roughness": 0.15},
    },
}  # fmt: skip
GENERATORS = {
    "GenGlsl": "GlslShaderGenerator", "GenOsl": "OslShaderGenerator", "GenMsl": "MslShaderGenerator",
    "GenMdl": "MdlShaderGenerator",
}  # fmt: skip


@pytest.fixture(scope="module")
def library() -> Any:
    materialx = pytest.importorskip("MaterialX")
    document = materialx.createDocument()
    materialx.loadLibraries(materialx.getDefaultDataLibraryFolders(), materialx.getDefaultDataSearchPath(), document)
    return document


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Path]]:
    """Pairs of a MaterialX file and the same as USD: one film, and the graph of a table."""
    folder, found = tmp_path_factory.mktemp("usd"), {}
    for name, film in FILMS.items():
        material = nacre.material({"family": "film", **film})
        if name != "varying":
            nacre.export(material, "materialx", folder / f"{name}.mtlx")
            nacre.export(material, "usd", folder / f"{name}.usda")
            found[f"film {name}"] = (folder / f"{name}.mtlx", folder / f"{name}.usda")
        if name != "gold":
            nacre.export(material, "lut", folder / f"{name}-lut")
            found[f"graph {name}"] = (
                folder / f"{name}-lut" / "material.mtlx",
                folder / f"{name}-lut" / "material.usda",
            )
    return found


NAMES = ("film gold", "film clear", "graph clear", "graph varying")


@pytest.mark.parametrize("name", NAMES)
def test_documents_are_valid_and_become_code_in_four_languages(name: str, files: Any, library: Any) -> None:
    import importlib

    import MaterialX
    from MaterialX import PyMaterialXGenShader

    document = MaterialX.createDocument()
    MaterialX.readFromXmlFile(document, str(files[name][0]))
    document.setDataLibrary(library)
    is_valid, said = document.validate()
    assert is_valid, said
    element = PyMaterialXGenShader.findRenderableElements(document)[0]
    for module, generator in GENERATORS.items():
        made = getattr(importlib.import_module(f"MaterialX.PyMaterialX{module}"), generator).create()
        context = PyMaterialXGenShader.GenContext(made)
        context.registerSourceCodeSearchPath(MaterialX.getDefaultDataSearchPath())
        assert len(made.generate("made", element, context).getSourceCode("pixel")) > 1000


@pytest.mark.parametrize("name", NAMES)
def test_a_stage_holds_the_network_of_the_document(name: str, files: Any, library: Any) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdShade

    document, path = ET.parse(files[name][0]).getroot(), files[name][1]
    stage = Usd.Stage.Open(str(path))
    bound, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/Root/Sphere")).ComputeBoundMaterial()
    surface, *_ = bound.ComputeSurfaceSource("mtlx")
    assert surface
    assert bound.GetPrim().GetAttribute("config:mtlx:version").Get() == document.get("version")
    shaders = [UsdShade.Shader(prim) for prim in stage.Traverse() if prim.IsA(UsdShade.Shader)]
    nodes = [e for e in document.iter() if e.find("input") is not None and e.tag != "surfacematerial"]
    assert {s.GetPrim().GetName() for s in shaders} == {str(e.get("name")) for e in nodes}
    for shader in shaders:
        definition = library.getNodeDef(shader.GetIdAttr().Get())
        assert definition is not None, shader.GetIdAttr().Get()
        node = next(e for e in nodes if e.get("name") == shader.GetPrim().GetName())
        assert {i.GetBaseName() for i in shader.GetInputs()} == {e.get("name") for e in node.findall("input")}
        for entry in node.findall("input"):
            given, defined = shader.GetInput(str(entry.get("name"))), definition.getActiveInput(entry.get("name"))
            assert defined is not None and defined.getType() == entry.get("type")
            if entry.get("nodename") or entry.get("nodegraph"):
                (source,), _ = given.GetConnectedSources()
                assert source.source.GetPrim().IsValid()
            elif entry.get("type") == "float":
                assert given.Get() == pytest.approx(float(str(entry.get("value"))), rel=1e-6)
            elif entry.get("type") == "filename":
                assert (path.parent / given.Get().path).is_file()
                assert given.Get().path.startswith("./")  # without it, a search path
                assert Path(given.Get().resolvedPath) == (path.parent / given.Get().path).resolve()
            elif entry.get("type") == "string":
                assert given.Get() == entry.get("value")  # such as wrap modes
            if not given.HasConnectedSource():
                is_colour = "color3" in (entry.get("type"), node.get("type") if entry.get("type") == "filename" else "")
                assert given.GetAttr().GetColorSpace() == (document.get("colorspace") if is_colour else "")


def test_a_stage_that_refers_to_a_table_finds_its_pictures(files: Any, tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd

    stage = Usd.Stage.CreateNew(str(tmp_path / "scene.usda"))
    stage.OverridePrim("/Thing").GetReferences().AddReference(str(files["graph varying"][1]))
    found = [prim.GetAttribute("inputs:file").Get() for prim in stage.Traverse() if prim.HasAttribute("inputs:file")]
    assert {Path(each.resolvedPath).name for each in found} == {"map.png", "mirror.exr"}
    assert all(Path(each.resolvedPath).is_file() for each in found)


def test_a_binary_name_is_refused(tmp_path: Path) -> None:
    for name in ("gold.usdc", "gold.usdz"):
        with pytest.raises(nacre.NacreError):
            nacre.export({"family": "film", **FILMS["gold"]}, "usd", tmp_path / name)
    assert not list(tmp_path.iterdir())
