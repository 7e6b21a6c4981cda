"""Files that other programs wrote: MaterialX's, Mitsuba's and a glTF library's own writers, read by our importers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.analysis.fit import read_measurement
from nacre.analysis.import_export import import_material
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.formats.bsdf_tables import rgl_fields
from nacre.formats.scene_files import read_gltf, read_materialx
from nacre.readers.bsdf.databases import read_tensor

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


def gonio_csv(path: Path, value: float = 0.1, scale: float = 1.0) -> Path:
    """A Lambertian reflector measured every 15 degrees, its angles times `scale`."""
    rows = ["theta_i,phi_i,theta_o,phi_o,wavelength,value"]
    for theta_i in (0.0, 30.0, 60.0, 85.0):
        for theta_o in np.arange(0.0, 90.0, 15.0):
            for phi in np.arange(0.0, 360.0, 45.0):
                for nm in (400, 550, 700):
                    rows.append(f"{theta_i * scale},0,{theta_o * scale},{phi * scale},{nm},{value}")
    path.write_text("\n".join(rows) + "\n")
    return path


IMPOSSIBLE = [
    (-0.1, 1.0, "value = -0.1 is below 0"),
    (1e308, 1.0, "larger than any BSDF"),
    (4.8, 1.0, r"sends out 15(\.\d)? times the light that arrives"),
    (0.1, np.pi / 180.0, "these are radians"),
]


@pytest.mark.parametrize(("value", "scale", "says"), IMPOSSIBLE)
def test_a_measurement_that_cannot_be_is_refused_in_one_line(
    tmp_path: Path, value: float, scale: float, says: str
) -> None:
    source, recipe = gonio_csv(tmp_path / "odd.csv", value, scale), tmp_path / "odd.toml"
    with pytest.raises(NacreError, match=says) as found:
        nacre.import_(source, recipe)
    assert "\n" not in str(found.value) and str(source) in str(found.value)
    assert not recipe.exists() and not recipe.with_suffix(".nacre").exists()


def test_a_measurement_a_little_above_one_is_kept_and_reported(tmp_path: Path) -> None:
    source = gonio_csv(tmp_path / "bright.csv", 1.1 / np.pi)
    assert any("1.1 times the light" in remark for remark in import_material(source, tmp_path / "bright.toml"))


@pytest.mark.parametrize("key", ["iridescenceThicknessMaximum", "iridescenceIor"])
@pytest.mark.parametrize("value", ["NaN", "Infinity", "-3.0"])
def test_a_gltf_that_cannot_be_is_refused_before_a_recipe_is_written(tmp_path: Path, key: str, value: str) -> None:
    path, recipe = tmp_path / "odd.gltf", tmp_path / "odd.toml"
    film = f'{{"{key}": {value}}}'
    path.write_text('{"materials": [{"extensions": {"KHR_materials_iridescence": ' + film + "}}]}")
    with pytest.raises(NacreError, match="odd.gltf") as found:
        nacre.import_(path, recipe)
    assert "\n" not in str(found.value) and not recipe.exists()


@pytest.mark.parametrize(("value", "says"), [(34.2, "name the column specular_reflectance_percent"), (-0.3, "below 0")])
def test_reflectance_in_per_cent_is_refused_by_a_fit(tmp_path: Path, value: float, says: str) -> None:
    path = tmp_path / "wafer.csv"
    path.write_text("wavelength_nm,angle_deg,specular_reflectance\n" + f"500,0,{value}\n600,0,{value}\n")
    with pytest.raises(NacreError, match=says):
        read_measurement(path)


SPECTRUM = [(400.0, 0.2), (500.5, 0.3), (600.0, 0.25)]
WRITTEN = {
    "per cent": ("Wavelength (nm),Specular reflectance (%)", ",", lambda nm, r: (f"{nm}", f"{100 * r}")),
    "decimal commas": (
        "wavelength_nm;specular_reflectance", ";", lambda nm, r: (f"{nm}".replace(".", ","), f"{r}".replace(".", ",")),
    ),
    "um and tabs": ("wavelength_um\tspecular_reflectance", "\t", lambda nm, r: (f"{nm / 1000:.6g}", f"{r}")),
    "other order": ("specular_reflectance,angle_deg,wavelength_nm", ",", lambda nm, r: (f"{r}", "0", f"{nm}")),
}  # fmt: skip


@pytest.mark.parametrize("form", WRITTEN)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_spectrum_is_read_as_its_instrument_wrote_it(tmp_path: Path, form: str, encoding: str) -> None:
    heading, parting, cells = WRITTEN[form]
    lines = [heading, *(parting.join(cells(nm, r)) for nm, r in reversed(SPECTRUM))]
    (tmp_path / "wafer.csv").write_bytes("\r\n".join(lines).encode(encoding))
    found = read_measurement(tmp_path / "wafer.csv")
    np.testing.assert_allclose(found.wavelengths_nm, [nm for nm, _ in SPECTRUM])
    np.testing.assert_allclose(found.values[0, 0], [r for _, r in SPECTRUM])


def test_rows_without_a_measurement_are_left_out_and_holes_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "wafer.csv"
    path.write_text("wavelength_nm,specular_reflectance\n400,0.2\n410,\n420,nan\n430,0.3\n")
    assert list(read_measurement(path).wavelengths_nm) == [400.0, 430.0]
    path.write_text("wavelength_nm,angle_deg,specular_reflectance\n400,0,0.2\n400,45,0.2\n410,0,0.2\n410,45,\n")
    with pytest.raises(NacreError, match="specular_reflectance is missing at 45 degrees and 410 nm"):
        read_measurement(path)
    path.write_text("wavelength_nm,specular_reflectance\n400,0.2\n400,0.3\n")
    with pytest.raises(NacreError, match="given twice"):
        read_measurement(path)
    path.write_text("wavelength_nm,specular_reflectance\n400,\n")
    with pytest.raises(NacreError, match="at least one measured value"):
        read_measurement(path)


def test_materialx_is_known_by_its_content(tmp_path: Path) -> None:
    film = nacre.material({"family": "film", "substrate": {"n": 1.5}, "layers": [{"material": {"n": 1.33},
                           "thickness_nm": 300}]})  # fmt: skip
    nacre.export(film, "materialx", tmp_path / "film.mtlx")
    other = tmp_path / "film.xml"
    other.write_bytes((tmp_path / "film.mtlx").read_bytes())
    assert nacre.import_(other, tmp_path / "film.toml").family == "film"
