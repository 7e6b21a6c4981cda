"""Inputs of graphics that once gave a wrong result: each gives the right one, or a refusal where that is allowed.

The files are not part of the project; where their folder is absent, these tests skip. Each folder has a README with the
right answer.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.arrays import direction
from nacre.core.errors import NacreError, UnsupportedError

CASES = Path(__file__).parents[2] / ".." / "shared" / "cases"
NM = np.array([450.0, 550.0, 650.0])


@pytest.fixture
def case() -> Callable[[str], Path]:
    def find(name: str) -> Path:
        path = CASES / ("readers" if name.startswith("D") else "graphics") / name
        if not path.exists():
            pytest.skip("../shared/cases is absent")
        return path

    return find


@pytest.fixture
def brought(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[[Path], tuple[Any, str]]:
    """Import a file by the command, and return the material and what was said."""
    from nacre.cli import run

    def bring(path: Path, *options: str) -> tuple[Any, str]:
        assert run(["import", str(path), "-o", str(tmp_path / "r.toml"), *options]) == 0
        return nacre.load(tmp_path / "r.toml"), "".join(capsys.readouterr())

    return bring


def value(material: Any, theta_i: float, theta_o: float, phi_o: float) -> float:
    """Return pi f for light at azimuth 0."""
    wi, wo = direction(np.radians(theta_i)), direction(np.radians(theta_o), np.radians(phi_o))
    return float(np.pi * material.bsdf().evaluate(wi, wo)[0])


def test_asymmetric_scatter_keeps_both_sides(case: Any, brought: Any) -> None:
    from nacre.formats.bsdf_tables import scatter_direction

    material, _ = brought(case("E4-zemax-asym") / "z_as1.bsdf")
    for azimuth, expected in ((60.0, 0.3), (300.0, 0.1)):
        wo = scatter_direction(np.array(30.0), np.array(azimuth), np.array(20.0))
        found = np.pi * material.bsdf().evaluate(direction(np.radians(30.0)), wo)[0]
        assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["z_rot2.bsdf", "z_asym4d.bsdf"])
def test_sample_rotations_are_counted(case: Any, brought: Any, name: str) -> None:
    material, said = brought(case("E4-zemax-rotations") / name)
    assert "2 sample rotations" in said and value(material, 30.0, 30.0, 180.0) > 0


def test_a_brushed_sample_stays_anisotropic(case: Any, brought: Any) -> None:
    material, said = brought(case("E6-brushed") / "e_tooth.csv")
    for phi_i, expected in ((0.0, 0.1), (90.0, 0.3), (180.0, 0.1)):
        wi, wo = direction(np.radians(30.0), np.radians(phi_i)), direction(np.radians(45.0), np.radians(phi_i + 60.0))
        assert np.pi * material.bsdf().evaluate(wi, wo)[0] == pytest.approx(expected, rel=1e-5)
    assert "azimuths of the light" in said


@pytest.mark.parametrize("name", ["e_hole.csv", "e_nan.csv", "e_neg.csv"])
def test_holes_are_filled_and_noise_is_cut(case: Any, brought: Any, name: str) -> None:
    material, said = brought(case("E6-holes-noise") / name)
    assert ("were filled" in said) == (name != "e_neg.csv")
    assert value(material, 30.0, 45.0, 90.0) == pytest.approx(0.3, rel=0.11)
    table = material.bsdf().lobes[0].values
    assert np.isfinite(table).all() and table.min() >= 0


def test_a_scan_in_the_plane_needs_a_law(case: Any, brought: Any, tmp_path: Path) -> None:
    path = case("E6-in-plane") / "e_inplane_pk.csv"
    with pytest.raises(UnsupportedError):
        nacre.import_(path, tmp_path / "r.toml")
    material, said = brought(path, "--law", "half-angle")
    assert "law" in said and value(material, 45.0, 45.0, 90.0) == pytest.approx(0.1, rel=0.1)


def test_micrometres_are_recognised(case: Any, brought: Any) -> None:
    material, said = brought(case("E6-micrometres") / "e_um.csv")
    np.testing.assert_allclose(material.bsdf().wavelengths_nm, NM)
    assert "um" in said


def test_measured_directions_keep_their_values(case: Any, brought: Any) -> None:
    material, _ = brought(case("E6-nodes-kept") / "e_fullpk.csv")
    assert value(material, 45.0, 45.0, 180.0) == pytest.approx(15.808, rel=1e-4)
    assert value(material, 75.0, 55.0, 180.0) / np.pi == pytest.approx(0.0415, rel=1e-3)


def test_own_tables_keep_their_values(tmp_path: Path) -> None:
    gold = nacre.material({"family": "film", "substrate": "Au", "layers": [], "surface": {"roughness": 0.2}})
    nacre.export(gold, "csv", tmp_path / "g.csv", angle_step_deg=15.0)
    again = nacre.import_(tmp_path / "g.csv", tmp_path / "g.toml")
    for angles in ((45.0, 45.0, 180.0), (30.0, 60.0, 45.0), (0.0, 15.0, 0.0)):
        assert value(again, *angles) == pytest.approx(value(gold, *angles), rel=1e-6)


def test_rgb_tensors_get_smooth_spectra(case: Any, brought: Any, tmp_path: Path) -> None:
    from nacre.formats.bsdf_tables import write_tensor
    from nacre.readers.bsdf.databases import read_tensor

    gold = nacre.load(case("E3-rgl-rgb") / "g.toml")
    nacre.export(gold, "rgl", tmp_path / "g.bsdf")
    fields = read_tensor(tmp_path / "g.bsdf")
    waves = fields["wavelengths"]
    keep = [int(np.argmin(abs(waves - nm))) for nm in (600, 550, 450)]
    rgb = {key: table for key, table in fields.items() if key not in ("spectra", "wavelengths")}
    rgb["rgb"] = np.ascontiguousarray(fields["spectra"][:, :, keep])
    write_tensor(tmp_path / "rgb.bsdf", rgb)
    material, said = brought(tmp_path / "rgb.bsdf")
    assert "RGB" in said
    red, blue = (material.bsdf().wavelengths_nm.searchsorted(nm) for nm in (640.0, 440.0))
    seen = material.bsdf().evaluate(direction(np.radians(30.0)), direction(np.radians(30.0), np.pi))
    assert seen[red] > seen[blue] > 0
    turned = dict(fields) | {"phi_i": np.linspace(-np.pi, np.pi, 4).astype("f4")}
    turned |= {key: np.repeat(fields[key], 4, 0) for key in ("vndf", "spectra", "luminance")}
    write_tensor(tmp_path / "aniso.bsdf", turned)
    one, other = (brought(tmp_path / name)[0].bsdf() for name in ("g.bsdf", "aniso.bsdf"))
    pair = direction(np.radians(30.0), 0.7), direction(np.radians(30.0), np.pi + 0.7)
    # every azimuth holds the isotropic tensor; tables of isotropic and anisotropic samples have other nodes
    np.testing.assert_allclose(other.evaluate(*pair), one.evaluate(*pair), rtol=0.05)


@pytest.mark.full
def test_bins_of_merl_are_counted(case: Any, brought: Any, tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(case("E10-merl-negative") / "make.py")], cwd=tmp_path, check=True)
    _, said = brought(tmp_path / "negblue.binary")
    assert re.search(r"\d+ bins are negative in blue", said)
    material, said = brought(tmp_path / "minus_spec.binary")
    assert re.search(r"\d+ of \d+ bins above the surface are invalid", said)
    np.testing.assert_allclose(value(material, 20.0, 20.0, 180.0), 0.2, rtol=1e-2)
    with pytest.raises(NacreError):
        nacre.import_(tmp_path / "nan.binary", tmp_path / "x.toml")


FILMS = {
    "F1-factor-03/f1_factor03.gltf": (0.622, "30 %"),
    "F1-no-factor/f1_nofactor.gltf": (0.642, "no film"),
    "F7-glb/f7.glb": (0.576, ""),
}


@pytest.mark.parametrize("name", FILMS)
def test_the_factor_of_a_gltf_film_is_its_share(case: Any, brought: Any, name: str) -> None:
    folder, file = name.split("/")
    material, said = brought(case(folder) / file)
    reflectance, words = FILMS[name]
    assert words in said
    assert material.spectrum([0.0], NM).specular_reflectance[0, 1] == pytest.approx(reflectance, abs=2e-3)


OPENPBR = {
    "F3-textured/f3_basecolor_tex.mtlx": (400.0, 1.5, "base_color"),
    "F3-textured/f3_rough_tex.mtlx": (400.0, 1.5, "specular_roughness"),
    "F3-textured/f3_thick_tex.mtlx": (500.0, 1.5, "thin_film_thickness"),
    "F4-standard-surface/f4_ss.mtlx": (400.0, 1.5, ""),
}


@pytest.mark.parametrize("name", OPENPBR)
def test_materialx_films_state_what_is_lost(case: Any, brought: Any, name: str) -> None:
    folder, file = name.split("/")
    material, said = brought(case(folder) / file)
    thickness, index, lost = OPENPBR[name]
    (layer,) = material.model.stack.layers
    assert layer.thickness_nm == thickness
    assert layer.material.n_complex(NM)[0].real == index
    assert not lost or f"not carried over: {lost}" in said


def test_colour_spaces_and_weights_of_a_metal_count(case: Any, brought: Any) -> None:
    half, _ = brought(case("F3-colour-and-weight") / "f3_baseweight.mtlx")
    assert half.data["substrate"]["n"] == pytest.approx((1 + 0.4**0.5) / (1 - 0.4**0.5))
    srgb, said = brought(case("F3-colour-and-weight") / "f3_prefix.mtlx")
    f0 = np.dot([0.787, 0.319, 0.0732], [0.2126, 0.7152, 0.0722])
    assert srgb.data["substrate"]["n"] == pytest.approx((1 + f0**0.5) / (1 - f0**0.5), rel=1e-3)
    assert "srgb_texture" in said


@pytest.mark.parametrize(
    ("name", "words"),
    [("f5_metal03", "0.3"), ("f5_metal07", "0.7"), ("f5_trans05", "0.3"), ("x_dielred", "baseColorFactor")],
)
def test_rounded_shares_are_named(case: Any, brought: Any, name: str, words: str) -> None:
    assert words in brought(case("F5-fractions") / f"{name}.gltf")[1]


@pytest.mark.full
def test_a_blend_is_not_exported_as_one_film(case: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(case("P-gltf-blend"))
    for to, named in (("gltf", "second"), ("materialx", "mask")):
        with pytest.raises(UnsupportedError, match=named):
            nacre.export("sticker.toml", to, tmp_path / f"x.{to}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.render
@pytest.mark.parametrize("name", ["ball12.glb", "ball12.obj"])
def test_meshes_keep_their_normals(case: Any, name: str) -> None:
    from nacre.picture.subjects import read_mesh

    mesh = read_mesh(case("F8-gltf-normals") / name)
    radial = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert np.sum(radial * mesh.normals, axis=1).min() > np.cos(np.radians(0.1))


@pytest.mark.render
def test_a_box_without_normals_is_flat(case: Any) -> None:
    from nacre.picture.subjects import read_mesh

    mesh = read_mesh(case("F8-obj-no-vn") / "f8_box_novn.obj")
    assert len(mesh.vertices) == 24
    np.testing.assert_allclose(np.sort(np.abs(mesh.normals), axis=1), [[0.0, 0.0, 1.0]] * 24, atol=1e-9)


@pytest.mark.render
def test_a_flat_object_lies_above_the_floor_in_the_frame(case: Any) -> None:
    from nacre.picture.camera import Framing
    from nacre.picture.scenes import SCENES
    from nacre.picture.subjects import read_mesh, stand_on_floor

    scene = SCENES["sphere"]
    disc = stand_on_floor(read_mesh(case("P-flat-on-floor") / "cd.obj"), scene)
    assert disc.vertices[:, 2].min() > 1e-4
    view = Framing((0.0, 50.0)).of(scene.view, 2.0, disc.vertices, scene.size)
    assert view.holds(disc.vertices, scene.size)


def test_arrays_beyond_two_bytes_are_split(case: Any, tmp_path: Path) -> None:
    gdstk = pytest.importorskip("gdstk")
    from nacre.cli import run

    out = tmp_path / "big.gds"
    recipe = case("D17-array-too-large") / "fab.toml"
    assert run(["fabricate", str(recipe), "--to", "gds", "--size-mm", "100x100", "-o", str(out)]) == 0
    library = gdstk.read_gds(str(out))
    arrays = [r.repetition for c in library.cells for r in c.references if r.repetition.columns]
    assert max(max(a.columns, a.rows) for a in arrays) <= 32767
    assert sum(a.columns * a.rows for a in arrays) == 50463**2 or len(arrays) == 4
    particle = next(c for c in library.cells if c.polygons)
    area = sum(p.area() for p in particle.polygons)
    assert area == pytest.approx(np.pi * 0.005**2, rel=0.01)
