"""Files that other programs wrote: MaterialX's, Mitsuba's and a glTF library's own writers, read by our importers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.exchange.gltf import read_gltf
from nacre.exchange.materialx import read_materialx
from nacre.exchange.rgl_tensor import read_tensor, rgl_fields

ROUGH = {"family": "film", "substrate": "Ti", "surface": {"roughness": 0.3}}


def test_we_read_what_materialx_writes(tmp_path: Path) -> None:
    import MaterialX

    document = MaterialX.createDocument()
    MaterialX.loadLibraries(MaterialX.getDefaultDataLibraryFolders(), MaterialX.getDefaultDataSearchPath(), document)
    own = MaterialX.createDocument()
    own.setDataLibrary(document)
    shader = own.addNode("open_pbr_surface", "bubble", "surfaceshader")
    values = {"thin_film_weight": 1.0, "thin_film_thickness": 0.42, "thin_film_ior": 1.33, "base_metalness": 1.0}
    for name, value in values.items():
        shader.addInputFromNodeDef(name).setValue(value)
    shader.addInputFromNodeDef("base_color").setValue(MaterialX.Color3(0.2, 0.4, 0.6))
    own.addMaterialNode("skin", shader)
    path = tmp_path / "theirs.mtlx"
    MaterialX.writeToXmlFile(own, str(path))
    found = read_materialx(path)
    assert (found.thickness_nm, found.film_ior) == pytest.approx((420.0, 1.33))
    assert found.is_metal
    assert found.base_rgb == pytest.approx((0.2, 0.4, 0.6))
    assert run(["import", str(path), "-o", str(tmp_path / "film.toml")]) == 0
    assert nacre.load(tmp_path / "film.toml").family == "film"


def test_we_read_what_a_gltf_library_writes(tmp_path: Path) -> None:
    import pygltflib

    extension = {
        "iridescenceFactor": 1.0,
        "iridescenceIor": 1.6,
        "iridescenceThicknessMinimum": 310.0,
        "iridescenceThicknessMaximum": 310.0,
    }
    file = pygltflib.GLTF2(asset=pygltflib.Asset(version="2.0"))
    file.extensionsUsed = ["KHR_materials_iridescence"]
    pbr = pygltflib.PbrMetallicRoughness(metallicFactor=1.0, roughnessFactor=0.5)
    file.materials = [pygltflib.Material(pbrMetallicRoughness=pbr)]
    file.materials[0].extensions = {"KHR_materials_iridescence": extension}
    path = tmp_path / "theirs.gltf"
    file.save(str(path))
    found = read_gltf(path)
    assert (found.thickness_nm, found.film_ior) == pytest.approx((310.0, 1.6))
    assert found.is_metal
    assert found.roughness == pytest.approx(0.25)
    assert run(["import", str(path), "-o", str(tmp_path / "film.toml")]) == 0
    assert nacre.load(tmp_path / "film.toml").family == "film"


@pytest.mark.render
def test_we_read_what_mitsubas_tensor_writer_writes(tmp_path: Path) -> None:
    from nacre.device.variant import use_variant

    use_variant()
    from mitsuba.python.tensor_io import write

    fields = rgl_fields(nacre.material(ROUGH).bsdf(np.linspace(400, 700, 4)), "rough titanium")
    path = tmp_path / "theirs.bsdf"
    write(str(path), **fields)
    again = read_tensor(path)
    assert set(again) == set(fields)
    for name, array in fields.items():
        np.testing.assert_array_equal(again[name], array)
    assert run(["import", str(path), "-o", str(tmp_path / "measured.toml")]) == 0
    wi = wo = np.array([0.0, 0.0, 1.0])
    value = nacre.evaluate(nacre.load(tmp_path / "measured.toml"), wi, wo)
    assert np.all(value > 0.1)
