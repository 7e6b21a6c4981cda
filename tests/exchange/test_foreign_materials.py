"""Films of glTF and MaterialX files: defaults, ranges, units, colour spaces, several materials."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.formats.foreign_materials import read_gltf, read_materialx


def gltf(path: Path, *materials: dict[str, Any]) -> Path:
    """Write materials with `film`, `base` and further keys as .gltf or .glb."""
    made = []
    for number, entry in enumerate(materials):
        film, base, rest = entry.get("film", {}), entry.get("base", {}), entry.get("rest", {})
        more = entry.get("extensions", {})
        made.append(
            {"name": f"m{number}", "pbrMetallicRoughness": base, **rest,
             "extensions": {"KHR_materials_iridescence": film, **more}}
        )  # fmt: skip
    text = json.dumps({"asset": {"version": "2.0"}, "materials": made}).encode()
    if path.suffix == ".glb":
        text += b" " * (-len(text) % 4)
        text = struct.pack("<4sII", b"glTF", 2, 20 + len(text)) + struct.pack("<I4s", len(text), b"JSON") + text
    path.write_bytes(text)
    return path


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_the_thickness_without_a_texture_is_the_maximum_and_with_one_the_middle(tmp_path: Path, suffix: str) -> None:
    film = {"iridescenceFactor": 1.0, "iridescenceThicknessMinimum": 200.0, "iridescenceThicknessMaximum": 500.0}
    path = gltf(tmp_path / f"x{suffix}", {"film": film})
    assert read_gltf(path).thickness_nm == 500.0
    film["iridescenceThicknessTexture"] = {"index": 0}
    found = read_gltf(gltf(path, {"film": film}))
    assert found.thickness_nm == 350.0 and "iridescenceThicknessTexture" in found.not_read


def test_a_material_with_a_factor_comes_first_and_others_are_named(tmp_path: Path) -> None:
    films = [{"film": {"iridescenceThicknessMaximum": t, "iridescenceFactor": f}} for t, f in ((1, 0), (2, 1), (3, 1))]
    path = gltf(tmp_path / "x.gltf", *films)
    found = read_gltf(path)
    assert found.thickness_nm == 2.0 and "m2" in found.remarks[0]
    assert read_gltf(path, "m0").weight == 0.0
    with pytest.raises(NacreError):
        read_gltf(path, "m9")


def test_everything_else_of_a_gltf_material_is_named(tmp_path: Path) -> None:
    entry = {
        "film": {"iridescenceFactor": 1}, "base": {"baseColorFactor": [1, 1, 1, 0.5], "metallicFactor": 0.4},
        "rest": {"emissiveFactor": [0, 1, 0], "alphaMode": "BLEND", "normalTexture": {"index": 0}},
        "extensions": {"KHR_materials_clearcoat": {}, "KHR_materials_transmission": {"transmissionFactor": 0.2}},
    }  # fmt: skip
    found = read_gltf(gltf(tmp_path / "x.gltf", entry))
    assert set(found.not_read) == {"normalTexture", "alpha", "emissiveFactor", "KHR_materials_clearcoat"}
    assert not found.is_metal and found.transmits
    assert any("0.4" in line for line in found.remarks) and any("0.2" in line for line in found.remarks)


@pytest.mark.parametrize(
    ("film", "base"),
    [
        ({"iridescenceFactor": 1.5}, {}), ({"iridescenceFactor": -0.1}, {}),
        ({"iridescenceFactor": 1, "iridescenceThicknessMaximum": -5}, {}),
        ({"iridescenceFactor": 1}, {"metallicFactor": 2}), ({"iridescenceFactor": 1}, {"roughnessFactor": -1}),
        ({"iridescenceFactor": 1}, {"baseColorFactor": [2, 2, 2, 1]}),
    ],
)  # fmt: skip
def test_shares_and_lengths_outside_their_range_are_refused(
    film: dict[str, Any], base: dict[str, Any], tmp_path: Path
) -> None:
    with pytest.raises(NacreError):
        read_gltf(gltf(tmp_path / "x.gltf", {"film": film, "base": base}))


def test_an_index_of_the_body_below_one_is_refused(tmp_path: Path) -> None:
    entry = {"film": {"iridescenceFactor": 1}, "extensions": {"KHR_materials_ior": {"ior": 0.5}}}
    with pytest.raises(NacreError):
        read_gltf(gltf(tmp_path / "x.gltf", entry))


@pytest.mark.parametrize(("albedo", "is_lost"), [(0.0, False), (0.5, True), (1.0, True)])
def test_light_scattered_below_an_opaque_film_is_named_as_lost(albedo: float, is_lost: bool, tmp_path: Path) -> None:
    base = {"baseColorFactor": [albedo] * 3 + [1], "metallicFactor": 0}
    found = read_gltf(gltf(tmp_path / "x.gltf", {"film": {"iridescenceFactor": 1}, "base": base}))
    assert any(key.startswith("baseColorFactor") for key in found.not_read) == is_lost


SHADER = (
    '<materialx version="1.39" colorspace="{space}"><{kind} name="s" type="surfaceshader">{inputs}</{kind}></materialx>'
)


def shader(path: Path, kind: str, space: str = "lin_rec709", **inputs: str) -> Path:
    lines = "".join(f'<input name="{name}" {value}/>' for name, value in inputs.items())
    path.write_text(SHADER.format(space=space, kind=kind, inputs=lines))
    return path


def test_a_document_has_at_most_16_mebibytes(tmp_path: Path) -> None:
    path = shader(tmp_path / "x.mtlx", "standard_surface", thin_film_thickness='value="300"')
    path.write_text(path.read_text().ljust(16 << 20))
    assert read_materialx(path).thickness_nm == pytest.approx(300.0)
    path.write_text(path.read_text() + "\n")
    with pytest.raises(NacreError):
        read_materialx(path)


@pytest.mark.parametrize(
    ("kind", "inputs", "nm"),
    [
        ("open_pbr_surface", {"thin_film_weight": 'value="1"', "thin_film_thickness": 'value="0.3"'}, 300.0),
        ("open_pbr_surface", {"thin_film_weight": 'value="1"'}, 500.0),
        (
            "open_pbr_surface",
            {"thin_film_weight": 'value="1"', "thin_film_thickness": 'value="300" unit="nanometer"'},
            300.0,
        ),
        ("standard_surface", {"thin_film_thickness": 'value="300"'}, 300.0),
        ("standard_surface", {"thin_film_thickness": 'value="0.3" unit="micrometer"'}, 300.0),
        ("standard_surface", {"thin_film_thickness": 'value="0.00001" unit="inch"'}, 254.0),
        ("gltf_pbr", {"iridescence": 'value="1"', "iridescence_thickness": 'value="300"'}, 300.0),
    ],
)
def test_thicknesses_have_the_unit_of_their_shader(
    tmp_path: Path, kind: str, inputs: dict[str, str], nm: float
) -> None:
    assert read_materialx(shader(tmp_path / "x.mtlx", kind, **inputs)).thickness_nm == pytest.approx(nm)


@pytest.mark.parametrize(
    ("space", "expected"),
    [
        ("lin_rec709", (0.5, 0.5, 0.5)), ("srgb_texture", (0.2140, 0.2140, 0.2140)), ("acescg", (0.5, 0.5, 0.5)),
        ("g22_rec709", (0.2176, 0.2176, 0.2176)), ("lin_displayp3", (0.5, 0.5, 0.5)),
    ],
)  # fmt: skip
def test_greys_of_each_colour_space_are_grey(tmp_path: Path, space: str, expected: tuple[float, ...]) -> None:
    inputs = {"thin_film_thickness": 'value="300"', "metalness": 'value="1"', "base_color": 'value="0.5, 0.5, 0.5"'}
    found = read_materialx(shader(tmp_path / "x.mtlx", "standard_surface", space, **inputs))
    np.testing.assert_allclose(found.base_rgb, expected, atol=2e-4)
    assert bool(found.remarks) == (space != "lin_rec709")  # a converted colour is reported


def test_a_share_of_film_becomes_a_blend_of_its_reflectance(tmp_path: Path) -> None:
    nm = np.array([450.0, 550.0, 650.0])
    seen = {}
    for weight in (0.0, 0.25, 1.0):
        entry = {"film": {"iridescenceFactor": weight, "iridescenceIor": 1.5}, "base": {"metallicFactor": 0}}
        path = gltf(tmp_path / f"x{weight}.gltf", entry)
        material = nacre.import_(path, tmp_path / f"x{weight}.toml")
        seen[weight] = material.spectrum([0.0], nm).specular_reflectance[0]
    np.testing.assert_allclose(seen[0.25], 0.25 * seen[1.0] + 0.75 * seen[0.0], rtol=1e-6)
    np.testing.assert_allclose(seen[0.0], 0.04, rtol=1e-3)
