"""Formats read and written: nothing lost that the format can hold, a clear word for what it cannot."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from read_back import read_slice

import nacre
from nacre.analysis.import_export import export_material
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.lobes.orders import OrdersLobe
from nacre.bsdf.lobes.table import from_half_difference, half_difference
from nacre.bsdf.texture import Texture
from nacre.cli import run
from nacre.core.errors import NacreError, UnsupportedError
from nacre.formats.bsdf_tables import (
    SHAPE,
    Warp,
    gonio_grid,
    merl_lobe,
    read_merl_filled,
    rgl_fields,
    slice_values,
    write_merl,
    write_slice,
    write_tensor,
    write_zemax,
    zemax_table,
)
from nacre.formats.measured_lobes import gonio_data, measured_table, rgb_basis, write_gonio_csv
from nacre.formats.scene_files import ThinFilm, read_gltf, read_materialx, write_gltf, write_materialx
from nacre.readers.bsdf.databases import RglBsdf, read_tensor
from nacre.readers.bsdf.ray_tracers import read_zemax_table, scatter_direction
from nacre.readers.registry import open_file
from nacre.recipe.toml import dump_toml

ROUGH_FILM = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 300}],
    "surface": {"roughness": 0.25},
}
FILM = ThinFilm(412.5, 1.46, (0.9, 0.5, 0.25), 1.5, True, 0.09)


@pytest.fixture(scope="module")
def film() -> nacre.Bsdf:
    return nacre.material(ROUGH_FILM).bsdf()


def random_directions(count: int, seed: int = 0, lowest: float = 0.2) -> np.ndarray:
    generator = np.random.default_rng(seed)
    z = generator.uniform(lowest, 1, count)
    phi = generator.uniform(0, 2 * np.pi, count)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


def test_a_gonio_csv_round_trips_to_single_precision(tmp_path: Path, film: nacre.Bsdf) -> None:
    data = gonio_grid(film, 30.0)
    write_gonio_csv(tmp_path / "g.csv", data, "a comment\nof two lines")
    again, _ = gonio_data(open_file(tmp_path / "g.csv")[0])
    np.testing.assert_allclose(again.values, data.values, rtol=np.finfo(np.float32).eps / 2)
    np.testing.assert_allclose(again.angles_deg, data.angles_deg)
    np.testing.assert_allclose(again.wavelengths_nm, data.wavelengths_nm)


def test_a_tensor_file_round_trips_bit_by_bit(tmp_path: Path, film: nacre.Bsdf) -> None:
    fields = rgl_fields(film, "film", resolution=16, theta_nodes=4)
    write_tensor(tmp_path / "t.bsdf", fields)
    again = read_tensor(tmp_path / "t.bsdf")
    assert again.keys() == fields.keys()
    for name, value in fields.items():
        np.testing.assert_array_equal(again[name], value)
        assert again[name].dtype == value.dtype


def test_a_tensor_file_is_linear_between_the_wavelengths(film: nacre.Bsdf) -> None:
    first, second = film.wavelengths_nm[:2]
    own = rgl_fields(film, resolution=8, theta_nodes=3)["spectra"]
    between = rgl_fields(film, resolution=8, theta_nodes=3, wavelengths_nm=[0.5 * (first + second), second])["spectra"]
    np.testing.assert_allclose(between[:, :, 0], own[:, :, :2].mean(axis=2), rtol=1e-5)
    np.testing.assert_allclose(between[:, :, 1], own[:, :, 1], rtol=1e-5)


@pytest.mark.render
def test_mitsubas_own_reader_reads_our_tensor_file(tmp_path: Path, film: nacre.Bsdf) -> None:
    import nacre.render

    nacre.render.use_variant()
    from mitsuba.python.tensor_io import read

    fields = rgl_fields(film, "film", resolution=16, theta_nodes=4)
    write_tensor(tmp_path / "t.bsdf", fields)
    again = read(str(tmp_path / "t.bsdf"))
    for name, value in fields.items():
        np.testing.assert_array_equal(again[name], value)


@pytest.mark.render
def test_mitsubas_measured_plugin_gives_our_values(tmp_path: Path, film: nacre.Bsdf) -> None:
    import nacre.render

    nacre.render.use_variant()
    import mitsuba as mi

    write_tensor(tmp_path / "t.bsdf", rgl_fields(film, "film"))
    bsdf = mi.load_dict({"type": "measured", "filename": str(tmp_path / "t.bsdf")})
    wi, wo = random_directions(4000, 1), random_directions(4000, 2)
    # the image bar counts energy, so directions are weighed by their value; half of them lie in the lobe
    half = random_directions(4000, 3, 0.9)
    wo[:2000] = (2 * np.sum(wi * half, axis=-1, keepdims=True) * half - wi)[:2000]
    keep = wo[:, 2] > 0.18
    wi, wo = wi[keep], wo[keep]
    waves = np.array([450.0, 550.0, 600.0, 650.0])
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(wi.T.astype(np.float32))
    si.wavelengths = mi.Spectrum(*(mi.Float(float(w)) for w in waves))
    theirs = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.astype(np.float32)))).T
    f = film.evaluate(wi, wo)
    ours = np.stack([f[:, np.argmin(abs(film.wavelengths_nm - w))] for w in waves], -1) * wo[:, 2:]
    error = np.sqrt(np.sum((theirs - ours) ** 2) / np.sum(ours**2))
    assert error < 0.02
    assert abs(theirs.sum() / ours.sum() - 1) < 0.01


def test_our_reader_of_tensors_gives_the_materials_values(tmp_path: Path, film: nacre.Bsdf) -> None:
    write_tensor(tmp_path / "t.bsdf", rgl_fields(film, "film"))
    rgl = RglBsdf.read(tmp_path / "t.bsdf")
    wi, wo = random_directions(2000, 1, 0.3), random_directions(2000, 2, 0.3)
    f = film.evaluate(wi, wo)
    ours = np.stack([np.interp(rgl.wavelengths_nm, film.wavelengths_nm, row) for row in f])
    error = np.sqrt(np.sum((rgl.evaluate(wi, wo) - ours) ** 2) / np.sum(ours**2))
    assert error < 0.03


def test_the_warp_and_its_inverse_are_one() -> None:
    generator = np.random.default_rng(0)
    warp = Warp.of(generator.random((9, 12)) + 0.05)
    x, y = generator.random((2, 500))
    u, v = warp.sample(x, y)
    back = warp.invert(u, v)
    np.testing.assert_allclose(back, (x, y), atol=2e-4)  # segments flatter than 1e-4 count as constant


def test_half_and_difference_angles_invert_each_other() -> None:
    generator = np.random.default_rng(1)
    th, td, pd = generator.uniform(0.05, 1.2, 200), generator.uniform(0.05, 1.2, 200), generator.uniform(0, 3.1, 200)
    wi, wo = from_half_difference(th, td, pd)
    np.testing.assert_allclose(half_difference(wi, wo), (th, td, pd), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(wo, axis=-1), 1)


def test_merl_round_trips_to_its_bins(tmp_path: Path) -> None:
    table = np.random.default_rng(0).random((*SHAPE, 3))
    write_merl(tmp_path / "m.binary", table)
    np.testing.assert_allclose(read_merl_filled(tmp_path / "m.binary")[0], table, rtol=1e-14)
    raw = (tmp_path / "m.binary").read_bytes()
    assert struct.unpack("<3i", raw[:12]) == SHAPE
    # the first value of each plane, scaled as the published reader does (Matusik's BRDFRead.cpp)
    for plane, scale in enumerate((1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0)):
        at = 12 + 8 * plane * 90 * 90 * 180
        assert struct.unpack("<d", raw[at : at + 8])[0] * scale == pytest.approx(table[0, 0, 0, plane])


def test_an_imported_merl_has_its_colours() -> None:
    from nacre.light import spectrum_to_rgb_linear

    grey = np.full((*SHAPE, 3), 0.2) * np.array([1.0, 0.7, 0.4])
    lobe = merl_lobe(grey)
    wi, wo = random_directions(20, 5), random_directions(20, 6)
    rgb = spectrum_to_rgb_linear(lobe.evaluate(wi, wo), lobe.wavelengths_nm)
    np.testing.assert_allclose(rgb, np.broadcast_to(grey[0, 0, 0], rgb.shape), rtol=2e-3)


def test_the_rgb_basis_is_exact_and_smooth() -> None:
    from nacre.light import default_wavelengths, spectrum_to_rgb_linear

    grid = default_wavelengths()
    basis = rgb_basis(grid)
    np.testing.assert_allclose(spectrum_to_rgb_linear(basis, grid), np.eye(3), atol=1e-8)
    np.testing.assert_allclose(basis.sum(axis=0), 1.0, atol=1e-3)


@pytest.mark.parametrize(
    "rgb", [(1.0, 0.77, 0.34), (0.95, 0.64, 0.54), (0.2, 0.5, 0.9), (0.6, 0.25, 0.2), (1.0, 1.0, 1.0)]
)
def test_the_spectrum_of_a_colour_that_reflects_no_more_than_white_does_so_at_every_wavelength(
    rgb: tuple[float, float, float],
) -> None:
    """Gold's was 1.26 at 830 nm, copper's 1.63: an imported MERL sent out more light than arrived."""
    from nacre.light import default_wavelengths

    spectrum = np.array(rgb) @ rgb_basis(default_wavelengths())
    assert spectrum.min() > 0.0 and spectrum.max() < 1.0 + 1e-3


def test_a_zemax_table_round_trips_and_looks_where_its_format_says(tmp_path: Path, film: nacre.Bsdf) -> None:
    table = zemax_table(film, 550.0, step_deg=15.0)
    write_zemax(tmp_path / "z.bsdf", table)
    again = read_zemax_table(tmp_path / "z.bsdf")
    np.testing.assert_allclose(again.values, table.values, rtol=1e-6)
    mirror = scatter_direction(np.array(30.0), np.array(0.0), np.array(0.0))
    np.testing.assert_allclose(mirror, [-0.5, 0, np.sqrt(0.75)], atol=1e-12)
    normal = scatter_direction(np.array(30.0), np.array(0.0), np.array(30.0))
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-12)


def test_a_zemax_table_integrates_to_the_albedo(film: nacre.Bsdf) -> None:
    from nacre.measure.evaluate import directional_hemispherical

    table = zemax_table(film, 550.0, step_deg=5.0)
    at = int(np.argmin(abs(film.wavelengths_nm - 550.0)))
    wi = np.array([np.sin(np.radians(30)), 0, np.cos(np.radians(30))])
    albedo = directional_hemispherical(film, wi)[0][at]
    assert table.tis[0, 6] == pytest.approx(albedo, rel=0.02)


def test_gltf_is_read_the_same_by_a_foreign_library(tmp_path: Path) -> None:
    import pygltflib

    write_gltf(tmp_path / "f.gltf", FILM, "film")
    foreign = pygltflib.GLTF2().load(str(tmp_path / "f.gltf"))
    material = foreign.materials[0]
    iridescence = material.extensions["KHR_materials_iridescence"]
    assert iridescence["iridescenceThicknessMaximum"] == FILM.thickness_nm
    assert iridescence["iridescenceIor"] == FILM.film_ior
    assert material.pbrMetallicRoughness.baseColorFactor[:3] == list(FILM.base_rgb)
    assert material.pbrMetallicRoughness.roughnessFactor**2 == pytest.approx(FILM.roughness)
    # a metal lets nothing pass; clear glass behind a film lets all pass that is not reflected
    assert "KHR_materials_transmission" not in material.extensions
    clear = ThinFilm(**{**FILM.__dict__, "is_metal": False, "transmits": True})
    write_gltf(tmp_path / "clear.gltf", clear, "clear")
    extensions = pygltflib.GLTF2().load(str(tmp_path / "clear.gltf")).materials[0].extensions
    assert extensions["KHR_materials_transmission"] == {"transmissionFactor": 1.0}
    assert extensions["KHR_materials_ior"] == {"ior": FILM.base_ior}
    assert read_gltf(tmp_path / "f.gltf") == ThinFilm(**{**FILM.__dict__, "roughness": pytest.approx(FILM.roughness)})


def test_materialx_is_read_the_same_by_its_own_library(tmp_path: Path) -> None:
    import MaterialX

    write_materialx(tmp_path / "f.mtlx", FILM, "my film")
    document = MaterialX.createDocument()
    MaterialX.readFromXmlFile(document, str(tmp_path / "f.mtlx"))
    assert document.validate()[0]
    surface = document.getNodes("open_pbr_surface")[0]
    assert surface.getInputValue("thin_film_thickness") == pytest.approx(0.4125)
    assert surface.getInputValue("thin_film_ior") == pytest.approx(1.46)
    again = read_materialx(tmp_path / "f.mtlx")
    assert again.thickness_nm == pytest.approx(FILM.thickness_nm)
    assert again.base_rgb == pytest.approx(FILM.base_rgb)


def test_a_spectral_slice_round_trips_to_single_precision(tmp_path: Path, film: nacre.Bsdf) -> None:
    write_slice(tmp_path / "s.exr", film)
    grid, values = read_slice(tmp_path / "s.exr")
    np.testing.assert_allclose(grid, film.wavelengths_nm, atol=1e-6)
    np.testing.assert_array_equal(values.astype(np.float32), slice_values(film).astype(np.float32))
    # a cell a degree, seen at its centre: column 9 and row 29 are theta_half = 9.5 and theta_diff = 29.5 degrees
    assert values.shape[:2] == (90, 90)
    wi, wo = from_half_difference(*np.radians([9.5, 29.5, 90.0]))
    np.testing.assert_allclose(values[29, 9], film.evaluate(wi, wo), rtol=1e-5)


def test_one_film_on_a_dielectric_is_found_again() -> None:
    from nacre.analysis.thin_film import fit_thin_film

    data = {"family": "film", "substrate": {"n": 1.5}, "layers": [{"material": {"n": 2.0}, "thickness_nm": 350}]}
    fit = fit_thin_film(nacre.material(data))
    assert fit.mean_residual < 0.5
    assert fit.film.thickness_nm == pytest.approx(350, rel=0.02)
    assert fit.film.film_ior == pytest.approx(2.0, rel=0.02)


def test_an_imported_goniometer_table_is_a_material(tmp_path: Path, film: nacre.Bsdf) -> None:
    write_gonio_csv(tmp_path / "m.csv", gonio_grid(film, 10.0))
    assert run(["import", str(tmp_path / "m.csv"), "-o", str(tmp_path / "m.toml")]) == 0
    material = nacre.load(tmp_path / "m.toml")
    data = gonio_grid(film, 20.0)
    keep = (data.angles_deg[:, 0] < 75) & (data.angles_deg[:, 2] < 75)
    ours, theirs = film.evaluate(data.wi[keep], data.wo[keep]), material.bsdf().evaluate(data.wi[keep], data.wo[keep])
    assert np.sqrt(np.sum((ours - theirs) ** 2) / np.sum(ours**2)) < 0.1
    assert run(["report", str(tmp_path / "m.toml"), "-o", str(tmp_path / "r.json")]) == 0


def test_a_stored_material_is_taken_as_measured_and_scaled_only_where_it_is_a_table(
    tmp_path: Path, film: nacre.Bsdf
) -> None:
    film.save(tmp_path / "facets.nacre")
    plain = {"family": "measured", "file": "facets.nacre"}
    wi, wo = random_directions(9, 1), random_directions(9, 2)
    taken = nacre.material(plain, tmp_path).bsdf()
    np.testing.assert_array_equal(taken.evaluate(wi, wo), film.evaluate(wi, wo))
    with pytest.raises(UnsupportedError, match="fixed wavelengths and scale"):
        nacre.material(plain, tmp_path).bsdf(film.wavelengths_nm[::2])
    with pytest.raises(UnsupportedError, match="fixed wavelengths and scale"):
        nacre.material(plain | {"scale": 2.0}, tmp_path).bsdf()


def test_scattered_directions_become_a_table_too(film: nacre.Bsdf) -> None:
    from nacre.formats.measured_lobes import GonioData

    generator = np.random.default_rng(3)
    angles = np.stack([generator.uniform(0, 80, 400), np.zeros(400), generator.uniform(0, 80, 400),
                       generator.uniform(0, 360, 400)], axis=-1)  # fmt: skip
    data = GonioData(angles, film.wavelengths_nm, np.ones((400, len(film.wavelengths_nm))))
    lobe, remarks = measured_table(data, "x")
    assert remarks
    np.testing.assert_allclose(lobe.values, 1.0)


@pytest.mark.parametrize("target", ["rgl", "merl", "csv", "zemax", "exr"])
def test_a_mirror_is_refused_where_deltas_cannot_be_held(tmp_path: Path, target: str) -> None:
    recipe = tmp_path / "mirror.toml"
    recipe.write_text(dump_toml({"family": "film", "substrate": "Ag"}))
    output = tmp_path / "out.x"
    assert run(["export", str(recipe), "--to", target, "-o", str(output)]) == 2
    assert not output.exists()


@pytest.mark.parametrize("target", ["rgl", "merl", "csv", "zemax", "exr", "gltf", "materialx", "nacre"])
def test_every_format_is_written_from_the_command_line(tmp_path: Path, target: str) -> None:
    recipe = tmp_path / "film.toml"
    recipe.write_text(dump_toml(ROUGH_FILM))
    suffix = ".nacre" if target == "nacre" else ".out"
    assert (
        run(["export", str(recipe), "--to", target, "-o", str(tmp_path / f"f{suffix}"), "--angle-step-deg", "30"]) == 0
    )
    assert (tmp_path / f"f{suffix}").stat().st_size > 100


@pytest.mark.parametrize("name", ["x.binary", "x.bsdf", "x.csv", "x.gltf", "x.mtlx", "x.foo", "missing.csv"])
@pytest.mark.parametrize("content", [b"", b"\x00\xff" * 40, b"tensor_file\0\x01\x00\xff\xff\xff\xff", b"{}", b"<a/>"])
def test_what_is_no_such_file_is_refused_in_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    if name != "missing.csv":
        (tmp_path / name).write_bytes(content)
    assert run(["import", str(tmp_path / name), "-o", str(tmp_path / "r.toml")]) == 2
    assert not (tmp_path / "r.toml").exists()


def test_a_walk_cannot_be_tabulated_in_silence() -> None:
    class Walk:
        is_stochastic, is_delta = True, False

    with pytest.raises(UnsupportedError):
        slice_values(nacre.Bsdf((Walk(),)))  # type: ignore[arg-type]
    assert issubclass(UnsupportedError, NacreError)


def test_the_zero_order_of_a_grating_is_not_lost() -> None:
    from nacre.analysis import thin_film

    flat = {"family": "grating", "substrate": "Al", "layers": [], "lattice": {"period_nm": 800}}
    material = nacre.material(flat)
    bsdf = material.bsdf([400.0, 550.0, 700.0])
    assert bsdf.lobes[0].kind == "aligned-specular"
    lost = thin_film._lost(material, bsdf, thin_film.ThinFilm(100.0, 1.5))
    assert not any("aligned" in line for line in lost)


def test_colours_of_narrow_orders_do_not_depend_on_the_wavelength_step(tmp_path: Path) -> None:
    """Lines of 3 nm and more: wavelengths 1 nm apart resolve them, 20 nm do not."""
    lattice, pictures = np.array([[1.0 / 900.0, 0.0], [0.0, 0.0]]), []
    for step in (1.0, 20.0):
        grid = np.arange(380.0, 781.0, step)
        table = np.full((2, 2, 2, len(grid)), 0.1, dtype=np.float32)
        bsdf = nacre.Bsdf((OrdersLobe(grid, table, lattice, np.array([[-1, 0], [1, 0]]), 0.01),))
        bsdf.save(tmp_path / f"{step:g}.nacre")
        found = export_material(nacre.load(tmp_path / f"{step:g}.nacre"), "exr", tmp_path / f"{step:g}.exr")
        assert any("nm apart" in each for each in found["lost"]) == (step == 20.0)
        pictures.append(OpenEXR.File(str(tmp_path / f"{step:g}.exr")).channels()["RGB"].pixels.astype(float))
    bright = pictures[0].max(axis=-1) > 0.1 * pictures[0].max()
    assert bright.sum() > 100
    np.testing.assert_allclose(pictures[1][bright], pictures[0][bright], atol=0.02 * pictures[0].max())


def test_narrow_orders_under_a_mask_have_the_masks_share_of_their_colours(tmp_path: Path) -> None:
    grid, lattice = np.arange(380.0, 781.0, 20.0), np.array([[1.0 / 900.0, 0.0], [0.0, 0.0]])
    table = np.full((2, 2, 2, len(grid)), 0.1, dtype=np.float32)
    orders = OrdersLobe(grid, table, lattice, np.array([[-1, 0], [1, 0]]), 0.01)
    pictures, remarks = [], []
    for name, lobe in (
        ("whole", orders),
        ("half", MaskedLobe(grid, orders, Texture(0.0, 1.0, image=np.full((2, 2), 0.5)))),
    ):
        nacre.Bsdf((lobe,)).save(tmp_path / f"{name}.nacre")
        found = export_material(nacre.load(tmp_path / f"{name}.nacre"), "exr", tmp_path / f"{name}.exr")
        pictures.append(OpenEXR.File(str(tmp_path / f"{name}.exr")).channels()["RGB"].pixels.astype(float))
        remarks.append(found["lost"])
    assert remarks[0] == remarks[1] and any("nm apart" in each for each in remarks[1])
    np.testing.assert_allclose(pictures[1], 0.5 * pictures[0], atol=1e-6 * pictures[0].max())
