"""Connected inputs of MaterialX shaders: constants are followed, one image becomes a thickness map, others named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.core.errors import NacreError
from nacre.formats.foreign_materials import read_materialx

HEAD = '<?xml version="1.0"?><materialx version="{version}" colorspace="lin_rec709">'
METAL = '<input name="base_metalness" type="float" value="1"/><input name="thin_film_weight" type="float" value="1"/>'
OPEN_PBR = '<open_pbr_surface name="S" type="surfaceshader">' + METAL + "{inputs}</open_pbr_surface>"
GRAPH = '<nodegraph name="G">{nodes}<output name="out" type="float" nodename="{last}"/></nodegraph>'
IMAGE = '<image name="i" type="float"><input name="file" type="filename" value="t.png"/></image>'
THICKNESS = '<input name="thin_film_thickness" type="float" nodegraph="G" output="out"/>'
STEP = 65535.0


def written(folder: Path, *parts: str, version: str = "1.39") -> Path:
    path = folder / "x.mtlx"
    path.write_text(HEAD.format(version=version) + "".join(parts) + "</materialx>")
    return path


def picture(folder: Path) -> np.ndarray:
    values = np.linspace(0, STEP, 12).round().astype(np.uint16).reshape(3, 4)
    Image.fromarray(values).save(folder / "t.png")
    return values / STEP


def node(kind: str, **inputs: str) -> str:
    entries = "".join(f'<input name="{name}" type="float" {value}/>' for name, value in inputs.items())
    return f'<{kind} name="n" type="float">{entries}</{kind}>'


AT = 'nodename="i"'


@pytest.mark.parametrize(
    ("nodes", "low", "high"),
    [
        (node("multiply", in1=AT, in2='value="0.4"'), 0.0, 400.0),
        (node("mix", bg='value="0.1"', fg='value="0.6"', mix=AT), 100.0, 600.0),
        (node("remap", in_=AT, outlow='value="0.2"', outhigh='value="0.5"').replace("in_", "in"), 200.0, 500.0),
        (node("add", in1=AT, in2='value="0.25"'), 250.0, 1250.0),
        (node("invert", in_=AT).replace("in_", "in"), 1000.0, 0.0),
    ],
)
def test_arithmetic_of_one_image_becomes_a_thickness_map(nodes: str, low: float, high: float, tmp_path: Path) -> None:
    values = picture(tmp_path)
    path = written(tmp_path, GRAPH.format(nodes=IMAGE + nodes, last="n"), OPEN_PBR.format(inputs=THICKNESS))
    found = read_materialx(path)
    assert found.thickness_map is not None and not found.not_read
    assert found.thickness_map.low_nm == pytest.approx(low) and found.thickness_map.high_nm == pytest.approx(high)
    np.testing.assert_allclose(found.thickness_map.image, values, atol=1e-9)
    material = nacre.import_(path, tmp_path / "x.toml")
    held = material.data["layers"][0]["thickness_nm"]
    assert (held["min"], held["max"]) == pytest.approx((min(low, high), max(low, high)))
    stored = np.asarray(Image.open(tmp_path / held["texture"]), dtype=float) / STEP
    np.testing.assert_allclose(stored, values if high > low else 1 - values, atol=1 / STEP)


def test_constants_and_interfaces_are_followed(tmp_path: Path) -> None:
    interface = '<input name="d" type="float" value="0.3"/>' + node(
        "multiply", in1='interfacename="d"', in2='value="2"'
    )
    path = written(tmp_path, GRAPH.format(nodes=interface, last="n"), OPEN_PBR.format(inputs=THICKNESS))
    found = read_materialx(path)
    assert found.thickness_nm == pytest.approx(600.0) and found.thickness_map is None and not found.not_read


def test_a_roughness_texture_becomes_its_mean(tmp_path: Path) -> None:
    mean = picture(tmp_path).mean()
    rough = '<input name="specular_roughness" type="float" nodename="i"/>'
    path = written(tmp_path, IMAGE, OPEN_PBR.format(inputs=rough))
    assert read_materialx(path).roughness == pytest.approx(mean**2)


@pytest.mark.parametrize(
    "nodes",
    [
        node("noise2d"), node("multiply", in1=AT, in2=AT), node("multiply", in1='nodename="n"', in2='value="2"'),
        node("multiply", in1='nodename="absent"', in2='value="2"'),
    ],
)  # fmt: skip
def test_what_cannot_be_followed_is_named(nodes: str, tmp_path: Path) -> None:
    picture(tmp_path)
    path = written(tmp_path, GRAPH.format(nodes=IMAGE + nodes, last="n"), OPEN_PBR.format(inputs=THICKNESS))
    found = read_materialx(path)
    assert found.not_read == ("thin_film_thickness",) and found.thickness_map is None


@pytest.mark.parametrize("name", ["absent.png", "../t.png", "/t.png"])
def test_images_outside_the_folder_are_not_read(name: str, tmp_path: Path) -> None:
    picture(tmp_path)
    (tmp_path / "in").mkdir()
    image = IMAGE.replace("t.png", name)
    path = written(tmp_path / "in", GRAPH.format(nodes=image, last="i"), OPEN_PBR.format(inputs=THICKNESS))
    assert read_materialx(path).not_read == ("thin_film_thickness",)


def test_a_negative_thickness_map_is_refused_and_writes_nothing(tmp_path: Path) -> None:
    picture(tmp_path)
    nodes = IMAGE + node("subtract", in1=AT, in2='value="0.5"')
    path = written(tmp_path, GRAPH.format(nodes=nodes, last="n"), OPEN_PBR.format(inputs=THICKNESS))
    with pytest.raises(NacreError):
        nacre.import_(path, tmp_path / "x.toml")
    assert {entry.name for entry in tmp_path.iterdir()} == {"x.mtlx", "t.png"}


def test_shader_references_of_old_files_are_read(tmp_path: Path) -> None:
    bound = {
        "specular_IOR": 2.5,
        "thin_film_thickness": 430,
        "thin_film_IOR": 1.5,
        "specular_roughness": 0.1,
        "base": 0,
    }
    entries = "".join(f'<bindinput name="{name}" type="float" value="{value}"/>' for name, value in bound.items())
    shader = f'<material name="M"><shaderref name="R" node="standard_surface">{entries}</shaderref></material>'
    found = read_materialx(written(tmp_path, shader, version="1.37"))
    assert (found.thickness_nm, found.film_ior, found.base_ior) == (430.0, 1.5, 2.5)
    assert found.roughness == pytest.approx(0.01) and not found.is_metal and not found.not_read


def test_the_librarys_own_definitions_hold_no_film_or_are_refused(tmp_path: Path) -> None:
    materialx = pytest.importorskip("MaterialX")
    folder = Path(materialx.__file__).parent / "libraries" / "bxdf"
    files = sorted(folder.rglob("*.mtlx"))
    assert files
    for path in files:
        try:
            read_materialx(path)
        except NacreError as error:
            assert str(path) in str(error)


def test_inputs_without_effect_are_not_called_lost(tmp_path: Path) -> None:
    neutral = (
        '<input name="specular_color" type="color3" value="1, 1, 1"/><input name="coat_weight" type="float" value="0"/>'
    )
    found = read_materialx(written(tmp_path, OPEN_PBR.format(inputs=neutral)))
    assert not found.not_read
    lossy = neutral.replace("1, 1, 1", "1, 0.5, 1").replace('value="0"', 'value="0.2"')
    assert read_materialx(written(tmp_path, OPEN_PBR.format(inputs=lossy))).not_read == (
        "coat_weight",
        "specular_color",
    )


def test_thicknesses_of_early_open_pbr_files_are_nanometres(tmp_path: Path) -> None:
    """The OpenPBR examples of MaterialX 1.38 say 420; the unit has been the micrometre since 1.39."""
    value = '<input name="thin_film_thickness" type="float" value="{}"{}/>'
    early = read_materialx(written(tmp_path, OPEN_PBR.format(inputs=value.format("420", ""))))
    assert early.thickness_nm == pytest.approx(420.0) and len(early.remarks) == 1
    assert read_materialx(
        written(tmp_path, OPEN_PBR.format(inputs=value.format("0.42", "")))
    ).thickness_nm == pytest.approx(420)
    stated = read_materialx(written(tmp_path, OPEN_PBR.format(inputs=value.format("420", ' unit="micrometer"'))))
    assert stated.thickness_nm == pytest.approx(420e3)


@pytest.mark.parametrize(
    ("document", "named"),
    [
        (OPEN_PBR.format(inputs=THICKNESS).replace("thin_film_weight", "coat_weight"), "S"),
        ('<thin_film_bsdf name="film" type="BSDF"/>', "thin_film_bsdf"),
        ('<LamaIridescence name="film" type="BSDF"/>', "LamaIridescence"),
        ('<b name="c" type="BSDF"><input name="thinfilm_thickness" type="float" value="400"/></b>', "c"),
    ],
)  # fmt: skip
def test_a_document_without_a_film_that_can_be_read_names_the_node(document: str, named: str, tmp_path: Path) -> None:
    path = written(tmp_path, document)
    with pytest.raises(NacreError, match=rf"\b{named}\b"):
        read_materialx(path)
