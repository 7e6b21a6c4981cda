"""Files in the hands of other programs: they read the values that we wrote, and the residual that we state."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.analysis.thin_film import fit_thin_film
from nacre.cli import run
from nacre.formats.bsdf_tables import slice_values, write_slice
from nacre.formats.scene_files import read_gltf, read_materialx
from nacre.recipe.toml import dump_toml

FILM = {
    "family": "film",
    "substrate": {"n": 1.5},
    "layers": [{"material": {"n": 2.0}, "thickness_nm": 350.0}],
    "surface": {"roughness": 0.2},
}


@pytest.fixture(scope="module")
def residual() -> float:
    return fit_thin_film(nacre.material(FILM)).mean_residual


@pytest.mark.render
def test_mitsubas_own_bitmap_reads_our_spectral_exr(tmp_path: Path) -> None:
    from nacre.device.variant import use_variant

    use_variant()
    import mitsuba as mi

    bsdf = nacre.material(FILM).bsdf()
    write_slice(tmp_path / "s.exr", bsdf)
    bitmap = mi.Bitmap(str(tmp_path / "s.exr"))
    names = [bitmap.struct_()[i].name for i in range(len(bitmap.struct_()))]
    pixels, values = np.array(bitmap), slice_values(bsdf).astype(np.float32)
    spectral = {float(n[3:-2].replace(",", ".")): i for i, n in enumerate(names) if n.startswith("S0.")}
    assert len(spectral) == len(bsdf.wavelengths_nm)
    for index, wavelength in enumerate(sorted(spectral)):
        assert wavelength == pytest.approx(bsdf.wavelengths_nm[index], abs=1e-6)
        np.testing.assert_array_equal(pixels[..., spectral[wavelength]], values[..., index])


def test_gltf_states_its_residual_and_foreign_eyes_find_it(
    tmp_path: Path, residual: float, capsys: pytest.CaptureFixture[str]
) -> None:
    import pygltflib

    (tmp_path / "film.toml").write_text(dump_toml(FILM))
    assert run(["export", str(tmp_path / "film.toml"), "--to", "gltf", "-o", str(tmp_path / "f.gltf")]) == 0
    assert f"dE00 {residual:.2f}" in "".join(capsys.readouterr())
    assert f"{residual:.6g}"[:6] in json.dumps(json.loads((tmp_path / "f.gltf").read_text()))
    ours = read_gltf(tmp_path / "f.gltf")
    theirs = pygltflib.GLTF2().load(str(tmp_path / "f.gltf")).materials[0].extensions["KHR_materials_iridescence"]
    assert theirs["iridescenceThicknessMaximum"] == pytest.approx(ours.thickness_nm)
    assert theirs["iridescenceIor"] == pytest.approx(ours.film_ior)


def test_materialx_states_its_residual_and_foreign_eyes_find_it(
    tmp_path: Path, residual: float, capsys: pytest.CaptureFixture[str]
) -> None:
    import MaterialX

    (tmp_path / "film.toml").write_text(dump_toml(FILM))
    assert run(["export", str(tmp_path / "film.toml"), "--to", "materialx", "-o", str(tmp_path / "f.mtlx")]) == 0
    assert f"dE00 {residual:.2f}" in "".join(capsys.readouterr())
    assert f"residual dE00 {residual:.2f}" in (tmp_path / "f.mtlx").read_text()
    document = MaterialX.createDocument()
    MaterialX.readFromXmlFile(document, str(tmp_path / "f.mtlx"))
    surface, ours = document.getNodes("open_pbr_surface")[0], read_materialx(tmp_path / "f.mtlx")
    assert surface.getInputValue("thin_film_thickness") * 1e3 == pytest.approx(ours.thickness_nm, rel=1e-5)
    assert surface.getInputValue("thin_film_ior") == pytest.approx(ours.film_ior, rel=1e-5)
