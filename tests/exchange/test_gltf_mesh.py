"""glTF on the user's own mesh, binary or not, with a thickness map: read again by trimesh, pygltflib and nacre."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.recipe.toml import dump_toml

FILM: dict[str, Any] = {
    "family": "film", "substrate": "BK7", "layers": [{"material": {"n": 1.38}, "thickness_nm": 320}],
    "surface": {"roughness": 0.1},
}  # fmt: skip
LOW, HIGH = 200.0, 400.0
VARYING: dict[str, Any] = {
    **FILM, "layers": [{"material": {"n": 1.8}, "thickness_nm": {"formula": "200 + 200*v", "min": LOW, "max": HIGH}}],
    "substrate": {"n": 1.3},
}  # fmt: skip


@pytest.fixture(scope="module")
def varying(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A .gltf with a thickness map, and the facts about it."""
    path = tmp_path_factory.mktemp("varying") / "map.gltf"
    return path, nacre.export(VARYING, "gltf", path)


def box(path: Path) -> Path:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh.export(str(path))
    return path


@pytest.mark.parametrize("suffix", [".obj", ".glb", ".gltf"])
@pytest.mark.parametrize("target", [".glb", ".gltf"])
def test_a_material_goes_on_ones_own_mesh(suffix: str, target: str, tmp_path: Path) -> None:
    import pygltflib

    mesh, out = tmp_path / f"box{suffix}", tmp_path / f"out{target}"
    if suffix == ".gltf":
        (tmp_path / "box").mkdir()
        for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box((1, 2, 3)))).items():
            (tmp_path / "box" / name).write_bytes(content)
        mesh = tmp_path / "box" / "model.gltf"
    else:
        box(mesh)
    facts = nacre.export(FILM, "gltf", out, mesh=mesh)
    read: Any = trimesh.load(str(out), force="mesh")
    np.testing.assert_allclose(read.extents, (1, 2, 3), rtol=1e-6)
    assert read.area == pytest.approx(22) and read.volume == pytest.approx(6)
    theirs = pygltflib.GLTF2().load(str(out)).materials[0].extensions["KHR_materials_iridescence"]
    assert theirs["iridescenceThicknessMaximum"] == pytest.approx(facts["film"]["thickness_nm"])
    ours = nacre.import_(out, tmp_path / "again.toml").data["layers"][0]
    assert ours["thickness_nm"] == pytest.approx(facts["film"]["thickness_nm"])


def test_the_thickness_map_holds_the_recipes_thickness_and_comes_back(
    varying: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    import pygltflib

    path, facts = varying
    held = facts["thickness_map"]
    assert facts["residual_delta_e_2000"] < 1.0  # a clear film on a clear base is what the format describes
    assert held["low_nm"] == pytest.approx(LOW, abs=8) and held["high_nm"] == pytest.approx(HIGH, abs=8)
    document = pygltflib.GLTF2().load(str(path))
    film = document.materials[0].extensions["KHR_materials_iridescence"]
    assert film["iridescenceThicknessTexture"] == {"index": 0}
    view = document.bufferViews[document.images[0].bufferView]
    blob = base64.b64decode(document.buffers[0].uri.partition(",")[2])
    png = blob[view.byteOffset : view.byteOffset + view.byteLength]
    green = np.asarray(Image.open(io.BytesIO(png)))[..., 1] / 255
    nm = film["iridescenceThicknessMinimum"] + green * (
        film["iridescenceThicknessMaximum"] - film["iridescenceThicknessMinimum"]
    )
    rows = (np.arange(len(nm))[::-1] + 0.5) / len(nm)  # the first row is at the top
    assert np.abs(nm[:, 0] - (LOW + (HIGH - LOW) * rows)).max() < 8
    material = nacre.import_(path, tmp_path / "again.toml")
    assert {"texture", "min", "max"} <= set(material.data["layers"][0]["thickness_nm"])
    wi = np.array([[0.3, 0.0, np.sqrt(1 - 0.09)]])
    wo = wi * [-1, 1, 1]
    for v in (0.2, 0.7):
        uv = np.array([[0.5, v]])
        given, back = (nacre.evaluate(m, wi, wo, uv=uv).mean() for m in (nacre.material(VARYING), material))
        assert back == pytest.approx(given, rel=0.1)


@pytest.mark.parametrize("content", [None, b"not a mesh"])
def test_a_bad_mesh_is_one_line_and_writes_nothing(
    content: bytes | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "film.toml").write_text(dump_toml(FILM))
    if content is not None:
        (tmp_path / "x.obj").write_bytes(content)
    args = ["export", str(tmp_path / "film.toml"), "-o", str(tmp_path / "o.glb"), "--mesh", str(tmp_path / "x.obj")]
    assert run([*args, "--to", "gltf"]) == 2
    assert run([*args, "--to", "materialx"]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 2 and not (tmp_path / "o.glb").exists()


@pytest.mark.parametrize("uri", ["absent.png", "../outside.png", "data:image/png;base64,AAAA"])
def test_a_thickness_picture_that_cannot_be_read_becomes_the_middle(
    uri: str, varying: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    document = json.loads(varying[0].read_text())
    document["images"] = [{"uri": uri}]
    (tmp_path / "map.gltf").write_text(json.dumps(document))
    film = document["materials"][0]["extensions"]["KHR_materials_iridescence"]
    middle = 0.5 * (film["iridescenceThicknessMinimum"] + film["iridescenceThicknessMaximum"])
    found = nacre.import_(tmp_path / "map.gltf", tmp_path / "again.toml")
    assert found.data["layers"][0]["thickness_nm"] == pytest.approx(middle)


@pytest.mark.parametrize(("target", "name"), [("gltf", "x.glb"), ("materialx", "x.mtlx")])
def test_a_share_of_film_is_written_as_factor_and_comes_back(target: str, name: str, tmp_path: Path) -> None:
    bare = {**FILM, "layers": []}
    blend = {"family": "blend", "mask": 0.25, "first": FILM, "second": bare}
    facts = nacre.export(blend, target, tmp_path / name)
    assert facts["film"]["weight"] == 0.25 and facts["residual_delta_e_2000"] < 1.0
    again = nacre.import_(tmp_path / name, tmp_path / "again.toml")
    assert again.data["family"] == "blend" and again.data["mask"] == pytest.approx(0.25)
    seen = [m.spectrum([0.0], [450.0, 550.0, 650.0]).specular_reflectance for m in (nacre.material(blend), again)]
    np.testing.assert_allclose(seen[1], seen[0], rtol=0.05)
    other = {**blend, "second": {**bare, "substrate": "Si"}}
    if target == "materialx":  # which has no order of surfaces
        with pytest.raises(NacreError):
            nacre.export(other, target, tmp_path / f"y{name}")


def read_json(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_a_blend_lies_as_two_films_over_each_other_with_its_mask_as_alpha(tmp_path: Path) -> None:
    second = {**FILM, "substrate": "Ti", "surface": {"roughness": 0.3}}
    mask = {"formula": "v", "min": 0, "max": 1}
    facts = nacre.export(
        {"family": "blend", "mask": mask, "first": FILM, "second": second}, "gltf", tmp_path / "b.gltf"
    )
    alone = [nacre.export(part, "gltf", tmp_path / f"{i}.gltf") for i, part in enumerate((FILM, second))]
    document = read_json(tmp_path / "b.gltf")
    under, over = document["materials"]
    assert "alphaMode" not in under and over["alphaMode"] == "BLEND"
    for held, apart in zip(
        (over, under), (read_json(tmp_path / f"{i}.gltf")["materials"][0] for i in (0, 1)), strict=True
    ):
        assert held["extensions"] == apart["extensions"]
        assert held["pbrMetallicRoughness"]["roughnessFactor"] == apart["pbrMetallicRoughness"]["roughnessFactor"]
    first, last = document["meshes"][0]["primitives"]
    assert (first["material"], last["material"]) == (0, 1)
    assert first["attributes"] == last["attributes"] and first["indices"] == last["indices"]
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    blob = base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])
    picture = (
        np.asarray(Image.open(io.BytesIO(blob[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]))) / 255
    )
    rows = (np.arange(len(picture))[::-1] + 0.5) / len(picture)  # the first row is at the top
    assert over["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0} and np.all(picture[..., :3] == 1)
    assert np.abs(picture[..., 3] - rows[:, None]).max() <= 0.5 / 255 + 1e-9
    assert [part["mean_share"] for part in facts["parts"]] == pytest.approx([0.5, 0.5])
    mean = np.mean([one["residual_delta_e_2000"] for one in alone])
    assert facts["residual_delta_e_2000"] == pytest.approx(mean, abs=1e-6) and facts["lost"]


def test_a_constant_share_is_the_alpha_of_the_upper_film_and_a_relief_is_refused(tmp_path: Path) -> None:
    blend = {"family": "blend", "mask": 0.3, "first": FILM, "second": {**FILM, "substrate": "Ti"}}
    nacre.export(blend, "gltf", tmp_path / "b.gltf", mesh=box(tmp_path / "box.obj"))
    document = read_json(tmp_path / "b.gltf")
    assert document["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"][3] == pytest.approx(0.3)
    assert "images" not in document and document["accessors"][0]["max"] == pytest.approx([0.5, 1.0, 1.5])
    with pytest.raises(NacreError):
        nacre.export({**blend, "second": {"family": "blend", **blend}}, "gltf", tmp_path / "nested.gltf")
    assert not (tmp_path / "nested.gltf").exists()
