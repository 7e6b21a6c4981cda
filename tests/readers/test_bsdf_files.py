"""BSDF files of other programs: shared files against independent readings, and small own files of each format."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.arrays import direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.formats.bsdf_tables import rgl_fields, rgl_lobe, write_tensor
from nacre.formats.measured_lobes import GonioData, gonio_data, measured_table, write_astm, write_brdf_json, write_speos
from nacre.readers.bsdf.databases import RglBsdf
from nacre.readers.bsdf.ray_tracers import read_zemax_table, scatter_direction
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.readers.registry import open_file

FILES = Path(__file__).parents[2] / ".." / "shared" / "reference" / "instruments" / "bsdf"
NAMES = ("test_13_planesymmetric_brdf_zemax.bsdf", "test_brdf_viewer_2D_data.csv", "Black_Paint.scattering",
         "pink-felt-1d.alta", "panel-BRFs.csv")  # fmt: skip
FACTOR = ReadOptions(quantity="reflectance_factor")


def shared(name: str) -> tuple[Path, dict[str, Any]]:
    if not FILES.exists():
        pytest.skip("../shared/reference/instruments is absent")
    return FILES / name, json.loads((FILES / f"{name}.reading.json").read_text(encoding="utf-8"))["right_reading"]


def test_a_zemax_file_agrees_with_its_reading() -> None:
    path, reading = shared(NAMES[0])
    (found,) = open_file(path)
    values = found.data["bsdf"].reshape(reading["shape"])
    assert (values.flat[0], values.max(), values.flat[-1]) == (reading["first"], reading["max"], reading["last"])
    assert np.count_nonzero(values == 0) == reading["zeros"]
    tis = found.metadata["tis"][0]
    assert (tis[0], tis[-1], len(tis)) == tuple(reading["TIS"])
    at = np.unravel_index(values.argmax(), values.shape)
    axes = [found.metadata[k] for k in ("angle_of_incidence_deg", "scatter_azimuth_deg", "scatter_radial_deg")]
    assert [float(axis[i]) for axis, i in zip(axes, at, strict=True)] == reading["at_max"]


def test_a_scan_in_the_plane_asks_for_its_quantity() -> None:
    path, reading = shared(NAMES[1])
    with pytest.raises(AmbiguousFileError) as asked:
        open_file(path)
    assert asked.value.option == "quantity" and "reflectance_factor" in asked.value.choices
    (found,) = open_file(path, FACTOR)
    values = np.pi * found.data["bsdf"].reshape(reading["rows"], -1)
    assert np.unique(found.data["theta_i_deg"]).tolist() == reading["incidences_deg"]
    np.testing.assert_allclose(values[0, :2], reading["first"][2:])
    np.testing.assert_allclose(values[-1, :2], reading["last"][2:])
    assert values.max() == pytest.approx(reading["max"])
    mirror = found.data["phi_o_deg"] == 180.0
    assert found.data["theta_o_deg"][0] == 78.0 and not mirror[0] and mirror[-1]
    with pytest.raises(UnsupportedError):
        measured_table(gonio_data(found)[0], path.name)


def test_models_and_slices_are_read_but_become_no_material(tmp_path: Path) -> None:
    path, reading = shared(NAMES[2])
    (paint,) = open_file(path)
    assert np.unique(paint.data["theta_i_deg"]).size == reading["incidences"]
    assert np.unique(paint.data["wavelength_nm"]).tolist() == reading["wavelengths"]
    assert 100 * paint.data["specular_reflectance"][0] == pytest.approx(reading["at_0_deg"][1])
    felt, slice_reading = shared(NAMES[3])
    (slice_,) = open_file(felt)
    row = [slice_.data["cos_theta_half"], *slice_.data["bsdf_rgb"].T]
    for place, key in ((0, "first"), (-1, "last")):
        np.testing.assert_allclose([c[place] for c in row], slice_reading[key], rtol=1e-6)
    for each in (path, felt):
        with pytest.raises(UnsupportedError):
            nacre.import_(each, tmp_path / "x.toml")
        assert not list(tmp_path.iterdir())


def test_reflectance_factors_behind_a_remark_sign_are_divided_by_pi(tmp_path: Path) -> None:
    path, reading = shared(NAMES[4])
    (found,) = open_file(path)
    assert found.data["bsdf"][0] == pytest.approx(reading["f_of_first"], rel=1e-5)
    assert (found.data["theta_i_deg"][0], found.data["theta_o_deg"][0]) == (22.2, 13.7)
    with pytest.raises(NacreError):
        nacre.import_(path, tmp_path / "x.toml")


def grid(both_sides: bool = False) -> GonioData:
    """Return a reciprocal lobe on a full grid at three wavelengths."""
    out = np.concatenate([np.arange(0.0, 90, 15), np.arange(105.0, 181, 15)]) if both_sides else np.arange(0.0, 90, 15)
    axes = np.meshgrid(np.arange(0.0, 90, 15), [0.0], out, np.arange(0.0, 360, 30), indexing="ij")
    angles = np.stack([a.ravel() for a in axes], axis=-1)
    data = GonioData(angles, np.array([450.0, 550.0, 650.0]), np.zeros((0, 0)))
    half = (data.wi + data.wo)[:, :2]
    values = 0.1 + np.exp(-np.sum(half**2, axis=1) / 0.3)
    return GonioData(angles, data.wavelengths_nm, values[:, None] * [1.0, 0.8, 0.5])


WRITERS = {"x.astm": write_astm, "x.json": lambda path, data: write_brdf_json(path, data, "x"), "x.brdf": write_speos}


@pytest.mark.parametrize("name", WRITERS)
def test_a_written_measurement_is_read_back_and_becomes_a_material_of_its_values(name: str, tmp_path: Path) -> None:
    data = grid()
    WRITERS[name](tmp_path / name, data)
    (found,) = open_file(tmp_path / name)
    np.testing.assert_allclose(np.unique(found.data["wavelength_nm"]), data.wavelengths_nm)
    back = gonio_data(found)[0]
    assert back.values.shape == data.values.shape
    bsdf = nacre.import_(tmp_path / name, tmp_path / "x.toml").bsdf()
    np.testing.assert_allclose(bsdf.evaluate(data.wi, data.wo), data.values, rtol=1e-7)


def test_a_speos_file_holds_both_sides(tmp_path: Path) -> None:
    data = grid(True)
    write_speos(tmp_path / "x.brdf", data)
    found = open_file(tmp_path / "x.brdf")
    assert [m.metadata["scatter"] for m in found] == ["brdf", "btdf"]
    for measured in found:
        back = gonio_data(measured)[0] if measured.metadata["scatter"] == "brdf" else None
        if back is not None:
            assert back.angles_deg[:, 2].max() <= 90.0
        else:
            assert measured.data["theta_o_deg"].min() > 90.0
            np.testing.assert_allclose(measured.data["bsdf"].max(), data.values[data.angles_deg[:, 2] > 90].max())


def test_parameters_of_alta_give_the_directions(tmp_path: Path) -> None:
    path = tmp_path / "x.alta"
    path.write_text("#DIM 4 1\n#PARAM_IN SPHERICAL_TL_PL_TV_PV\n#PARAM_OUT INV_STERADIAN\n0.5 0.1 0.3 3.2 0.25\n")
    (found,) = open_file(path)
    angles = [found.data[k][0] for k in ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")]
    np.testing.assert_allclose(angles, np.degrees([0.5, 0.1, 0.3, 3.2]))
    path.write_text("#DIM 4 3\n#PARAM_IN RUSIN_TH_PH_TD_PD\n#PARAM_OUT RGB_COLOR\n0.2 0.0 0.6 0.0 1 2 3\n")
    (found,) = open_file(path)
    # the half vector 0.2 from the normal, the light 0.6 beyond it in one plane
    np.testing.assert_allclose(
        [found.data["theta_i_deg"][0], found.data["theta_o_deg"][0]], np.degrees([0.8, 0.4]), rtol=1e-9
    )
    assert found.data["bsdf_rgb"].tolist() == [[1, 2, 3]]


SSDD = """VERSION 0.2

DATA_TYPE brdf
COLOR_MODEL spectrum
WAVELENGTH_LIST 500 600
PARAM_TYPE spherical_coordinate_system
PARAM0_LIST 0 45
PARAM2_LIST 10 20 30
PARAM3_LIST 0 180
DATA ascii
"""


def test_ssdd_varies_its_first_parameter_fastest(tmp_path: Path) -> None:
    path = tmp_path / "x.ssdd"
    rows = [(i, i + 100) for i in range(12)]
    path.write_text(SSDD + "\n".join(f"{a} {b}" for a, b in rows) + "\n")
    (found,) = open_file(path)
    assert found.data["theta_i_deg"][::2].tolist() == [0.0, 45.0] * 6
    assert found.data["theta_o_deg"][::4].tolist() == [10.0, 20.0, 30.0] * 2
    assert found.data["bsdf"].tolist() == [v for row in rows for v in row]
    path.write_bytes(SSDD.replace("ascii", "binary").encode() + np.array(rows, "<f4").tobytes())
    np.testing.assert_array_equal(open_file(path)[0].data["bsdf"], found.data["bsdf"])
    path.write_text(SSDD + "1 2\n")
    with pytest.raises(NacreError):
        open_file(path)


def test_tracepro_counts_beta_from_the_mirror_direction(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    head = "Temperature\tWavelength\tIncAngle\tAziAngle\tScatterBeta\tScatterAzimuth\tBRDF\tBTDF\n"
    path.write_text(
        "TracePro Surface Property Data\nName\tpaint\n\nTable_BSDF_Data\n" + head
        + "300\t0.55\t30\t0\t0\t0\t2.5\t0\n300\t0.55\t30\t0\t0.2\t180\t1.5\t0\n300\t0.55\t30\t0\t0.8\t0\t0.1\t0\n"
    )  # fmt: skip
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["theta_o_deg"], [30.0, np.degrees(np.arcsin(0.3))])
    np.testing.assert_allclose(found.data["phi_o_deg"], 180.0)
    assert found.data["wavelength_nm"].tolist() == [550.0, 550.0] and len(found.left_out) == 1


def test_speos_scattering_models_give_shares(tmp_path: Path) -> None:
    rows = "0\t30 20 31 21\n20 10 22 11\n5 4 6 3\n8 7 8 7\n9 6 9 6\n"
    path = tmp_path / "x.scattering"
    path.write_text("OPTIS - Scattering surface file v1.0\nmine\n1 2\n400 700\n" + rows)
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["specular_reflectance"], [0.30, 0.31])
    np.testing.assert_allclose(found.data["lambertian_transmittance"], [0.10, 0.11])
    np.testing.assert_allclose(found.data["gaussian_fwhm_y_transmittance_deg"], [6.0, 6.0])
    path.write_text("OPTIS - Scattering surface file v1.0\nmine\n2 2\n400 700\n" + rows)
    with pytest.raises(NacreError):
        open_file(path)


RING = "<AngleBasisBlock><nPhis>{}</nPhis><ThetaBounds><LowerTheta>{}</LowerTheta><UpperTheta>{}</UpperTheta>"
RINGS = "".join(RING.format(*ring) + "</ThetaBounds></AngleBasisBlock>" for ring in ((1, 0, 10), (2, 10, 90)))
WINDOW = (
    'genBSDF log\n<?xml version="1.0"?><WindowElement xmlns="http://windows.lbl.gov"><Optical><Layer><DataDefinition>'
    "<IncidentDataStructure>Columns</IncidentDataStructure><AngleBasis><AngleBasisName>K</AngleBasisName>{}</AngleBasis>"
    "</DataDefinition><WavelengthData><Wavelength>Visible</Wavelength><WavelengthDataBlock><WavelengthDataDirection>"
    "Reflection Front</WavelengthDataDirection><ColumnAngleBasis>K</ColumnAngleBasis><RowAngleBasis>K</RowAngleBasis>"
    "<ScatteringData>{}</ScatteringData></WavelengthDataBlock></WavelengthData></Layer></Optical></WindowElement>"
)


def test_a_window_matrix_has_a_column_for_each_incident_patch(tmp_path: Path) -> None:
    path = tmp_path / "x.xml"
    path.write_text(WINDOW.format(RINGS, "1,2,3,\n4,5,6,\n7,8,9,\n"))
    (found,) = open_file(path)
    assert found.data["theta_i_deg"].tolist() == [0.0, 50.0, 50.0] * 3
    assert found.data["phi_o_deg"].tolist() == [0.0] * 6 + [180.0] * 3
    assert found.data["bsdf"].tolist() == [float(v) for v in range(1, 10)]
    path.write_text(WINDOW.format(RINGS, "1,2,3"))
    with pytest.raises(NacreError):
        open_file(path)


def test_utia_runs_over_the_viewer_fastest(tmp_path: Path) -> None:
    values = np.zeros((3, 6, 48, 6, 48))
    values[1, 2, 3, 4, 5] = 7.0
    path = tmp_path / "m.bin"
    path.write_bytes(values.astype("<f8").tobytes())
    (found,) = open_file(path)
    at = found.data["bsdf_rgb"][:, 1].argmax()
    angles = [found.data[k][at] for k in ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")]
    assert angles == [30.0, 22.5, 60.0, 37.5]


def test_an_anisotropic_zemax_file_keeps_its_rotations(tmp_path: Path) -> None:
    path = tmp_path / "x.bsdf"
    head = "Source Measured\nSymmetry ASymmetrical4D\nSpectralContent Monochrome\nScatterType BRDF\n"
    head += "SampleRotation 2\n0 90\nAngleOfIncidence 2\n0 40\nScatterAzimuth 2\n0 180\nScatterRadial 2\n0 30\n\n"
    blocks = "".join(f"TIS 0.1\n{v} {v}\n{v} {v}\n" for v in (1, 1, 3, 3))
    path.write_text(head + "Monochrome\nDataBegin\n" + blocks + "DataEnd\n")
    (found,) = open_file(path)
    assert found.data["bsdf"].reshape(2, 2, 2, 2)[1, 0, 0, 0] == 3.0 and set(found.data["phi_i_deg"]) == {0.0, 90.0}
    bsdf = nacre.import_(path, tmp_path / "x.toml").bsdf()
    for phi_i, value in ((0.0, 1.0), (90.0, 3.0), (45.0, 2.0), (270.0, 3.0)):
        wi = direction(np.radians(40.0), np.radians(phi_i))
        assert bsdf.evaluate(wi, wi * [-1, -1, 1])[0] == pytest.approx(value)
    path.write_text((head + "Monochrome\nDataBegin\n" + blocks + "DataEnd\n").replace("BRDF", "BTDF"))
    assert open_file(path)[0].metadata["scatter"] == "btdf"
    with pytest.raises(UnsupportedError):
        nacre.import_(path, tmp_path / "x.toml")


def test_a_zemax_table_has_its_values_at_its_nodes(tmp_path: Path) -> None:
    path = tmp_path / "x.bsdf"
    data = Path(__file__).parents[1] / "exchange" / "data" / "anodised_black_632nm.bsdf"
    path.write_bytes(data.read_bytes())
    table, bsdf = read_zemax_table(path), nacre.import_(path, tmp_path / "x.toml").bsdf()
    i, a, r = np.meshgrid(table.incidence_deg, table.azimuth_deg, table.radial_deg, indexing="ij")
    wo = scatter_direction(i, a, r)
    up = (wo[..., 2] > 1e-6) & (r > 0)
    found = bsdf.evaluate(direction(np.radians(i)), wo)[..., 0]
    np.testing.assert_allclose(found[up], table.values[0][up], rtol=1e-9, atol=1e-14)


def test_a_brushed_metal_comes_back_with_its_values(tmp_path: Path) -> None:
    surface = {"roughness": [0.15, 0.4]}
    metal = nacre.material({"family": "film", "substrate": "Al", "layers": [], "surface": surface})
    nacre.export(metal, "csv", tmp_path / "x.csv", angle_step_deg=30.0)
    bsdf = nacre.import_(tmp_path / "x.csv", tmp_path / "x.toml").bsdf()
    data, _ = gonio_data(open_file(tmp_path / "x.csv")[0])
    away = (data.angles_deg[:, 0] > 0) & (data.angles_deg[:, 2] > 0)
    assert len(np.unique(data.angles_deg[:, 1])) > 3
    np.testing.assert_allclose(bsdf.evaluate(data.wi, data.wo)[away], data.values[away], rtol=1e-6)


def test_an_anisotropic_tensor_keeps_the_azimuth_of_the_light(tmp_path: Path) -> None:
    surface = {"roughness": [0.25, 0.4]}
    metal = nacre.material({"family": "film", "substrate": "Al", "layers": [], "surface": surface})
    nm = np.array([450.0, 650.0])
    fields = rgl_fields(metal.bsdf(nm), is_isotropic=False, resolution=12, theta_nodes=4, phi_nodes=9)
    write_tensor(tmp_path / "a.bsdf", fields)
    tensor = RglBsdf.read(tmp_path / "a.bsdf")
    angles, values = tensor.samples()
    away = (angles[:, 2] > 0.1) & (angles[:, 2] < 80)
    light, viewer = (direction(*np.radians(angles[away, k : k + 2]).T) for k in (0, 2))
    np.testing.assert_allclose(tensor.evaluate(light, viewer), values[away], rtol=1e-4, atol=1e-5)

    # the metal has two mirror planes: a quarter of the azimuths holds all of it
    for share in (2, 4):
        some = fields["phi_i"] <= -np.pi + 2 * np.pi / share + 1e-6
        part = {name: fields[name][some] for name in ("phi_i", "vndf", "spectra", "luminance")}
        write_tensor(tmp_path / "b.bsdf", {**fields, **part})
        off = np.abs(RglBsdf.read(tmp_path / "b.bsdf").evaluate(light, viewer) - values[away])
        assert np.quantile(off, 0.98) < 1e-2 * values.max()

    # the table is linear between dense nodes of a smooth lobe: the median error that it states is small
    stated = [float(word) for word in rgl_lobe(tensor)[1][-1].split() if word.replace(".", "").isdigit()]
    assert 0.0 < stated[0] < 1.0

    bsdf = nacre.import_(tmp_path / "a.bsdf", tmp_path / "x.toml").bsdf(nm)
    theta = float(np.degrees(tensor.theta_i[1]))
    peaks = []
    for turn in (0.0, 90.0):
        wi, wo = direction(np.radians(theta), np.radians(turn)), direction(np.radians(theta), np.radians(turn + 180.0))
        np.testing.assert_allclose(bsdf.evaluate(wi, wo), tensor.evaluate(wi[None], wo[None])[0], rtol=1e-3)
        across = direction(np.radians(theta + 15.0), np.radians(turn + 180.0))
        peaks.append(float(bsdf.evaluate(wi, across)[0] / bsdf.evaluate(wi, wo)[0]))
    assert abs(peaks[0] - peaks[1]) > 0.1  # the lobe is wider along the rougher axis


def test_narrow_angles_ask_for_their_unit(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    rows = [f"{i},0,{o},{p},550,0.1" for i in (0.1, 0.5, 1.0) for o in (0.1, 0.5, 1.0) for p in (0, 1.5, 3)]
    path.write_text("theta_i,phi_i,theta_o,phi_o,wavelength,value\n" + "\n".join(rows))
    with pytest.raises(AmbiguousFileError) as asked:
        open_file(path)
    assert asked.value.option == "unit"
    assert open_file(path, ReadOptions(unit="deg"))[0].data["theta_i_deg"].max() == 1.0
    assert open_file(path, ReadOptions(unit="rad"))[0].data["theta_i_deg"].max() == pytest.approx(np.degrees(1.0))
    path.write_text(path.read_text().replace("theta_i,", "theta_i (deg),"))
    assert open_file(path)[0].data["theta_i_deg"].max() == 1.0
    path.write_text(path.read_text().replace("value", "value,temperature").replace("0.1\n", "0.1,20\n"))
    with pytest.raises(NacreError):
        open_file(path)


def test_a_half_angle_law_extrapolates_a_scan() -> None:
    theta = np.arange(-75.0, 76, 5)
    incidence, out = np.meshgrid([15.0, 30, 45, 60], theta, indexing="ij")
    phi = np.where(out >= 0, 180.0, 0.0)
    angles = np.stack([incidence.ravel(), 0 * phi.ravel(), np.abs(out).ravel(), phi.ravel()], axis=-1)
    half = np.radians(np.abs(out - incidence) / 2).ravel()
    values = 0.1 / np.pi + 5 * np.exp(-((half / np.radians(4)) ** 2))
    data = GonioData(angles, np.array([550.0]), values[:, None])
    with pytest.raises(UnsupportedError):
        measured_table(data, "scan")
    lobe, remarks = measured_table(data, "scan", "half-angle")
    aside = lobe.evaluate(direction(np.radians(45.0)), direction(np.radians(45.0), np.radians(90.0)))
    assert np.pi * aside[0] == pytest.approx(0.1, rel=0.05)
    with pytest.raises(NacreError):
        measured_table(data, "scan", "linear")
    assert any("law" in line for line in remarks)


def test_a_speos_intensity_gives_no_pole_at_grazing_directions(tmp_path: Path) -> None:
    block = "50\n3 3\n\t0\t180\t360\n0\t1\t1\t1\n45\t0.70711\t0.70711\t0.70711\n90\t0.01\t0.01\t0.01\n"
    (tmp_path / "x.brdf").write_text(
        f"OPTIS - brdf surface file v9.0\n0\nSurface\n0\n\n1\t0\n0\n1\t1\n0.0\n550.0\n{block}End of file\n"
    )
    (found,) = open_file(tmp_path / "x.brdf")
    bsdf = found.data["bsdf"].ravel()
    at = found.data["theta_o_deg"]
    np.testing.assert_allclose(bsdf[at == 45.0], bsdf[at == 0.0][0], rtol=1e-4)
    assert not bsdf[at == 90.0].any()


def test_astm_names_of_colours(tmp_path: Path) -> None:
    (tmp_path / "x.astm").write_text(
        "NUM_POINTS 2\nVARS=theta_i,phi_i,theta_s,phi_s,Red,Green,Blue\n10,0,0,0,.1,.2,.3\n10,0,40,180,.1,.2,.3\n"
    )
    (found,) = open_file(tmp_path / "x.astm")
    np.testing.assert_allclose(found.data["bsdf_rgb"], [[0.1, 0.2, 0.3]] * 2)


@pytest.mark.parametrize(
    "text",
    [
        "type bsdf_data\nformat angles=cosines bsdf=value\n10\t0\n0\t0\t.1\n",
        "type bsdf_data\n10\t0\n0\t0\t.1\t2\n",
        "SphereMesh:\t2\t1\t0\t0\t360\t90\n1\t1\n",
        "Symmetry Asymmetric\nSpectralContent Monochrome\nScatterAzimuth 1\n0\nScatterRadial 1\n0\nDataBegin\nAOI 0\n",
    ],
)
def test_files_of_programs_that_are_not_read_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.txt").write_text(text)
    with pytest.raises(NacreError):
        open_file(tmp_path / "x.txt")


@pytest.mark.parametrize("mirror", [0.0, 180.0])
def test_fred_has_its_mirror_direction_on_the_side_of_the_largest_values(tmp_path: Path, mirror: float) -> None:
    rows = [(30, azimuth, 5.0 if azimuth == mirror else 0.1) for azimuth in (0.0, 90.0, 180.0)]
    text = "30 0\n" + "".join(f"{t}\t{p}\t{v}\n" for t, p, v in rows)
    (tmp_path / "a.txt").write_text(f"type bsdf_data\nformat angles=deg bsdf=value scale=2\n{text}")
    (found,) = open_file(tmp_path / "a.txt")
    peak = found.data["bsdf"].argmax()
    assert (found.format, found.metadata["scatter"]) == ("fred", "brdf")
    assert (found.data["phi_o_deg"][peak], found.data["bsdf"][peak]) == (180.0, 10.0)
    turned = np.radians([[float(v) for v in row] for row in ([30, 0], [30, 90])])
    lines = "\n".join(" ".join(f"{v:.9f}" for v in row) for row in turned)
    (tmp_path / "b.txt").write_text(f"type bsdf_data\nformat angles=rad bsdf=value\n{lines} .5\n")
    (found,) = open_file(tmp_path / "b.txt")
    np.testing.assert_allclose([found.data[k][0] for k in ("theta_i_deg", "theta_o_deg", "phi_o_deg")], [30, 30, 90])


def lighttools(channel: str, names: tuple[str, ...], content: str) -> str:
    head = f"# made here\nSymmetry PlaneSymmetrical\nSpectralContent {content}\nScatterAzimuth 2\n90 270\n"
    blocks = []
    for side, scatter in (("Front", "BRDF"), ("Front", "BTDF")):
        for aoi in (0, 30):
            for k, name in enumerate(names):
                rows = [[aoi + 10 * k + 100 * (scatter == "BTDF") + r + c for c in (0.1, 0.2)] for r in (1, 2)]
                body = "\n".join("\t".join(f"{v:.1f}" for v in row) for row in rows)
                blocks.append(
                    f"AOI {aoi}\nPOI 0\nSide {side}\n{channel} {name}\nScatterType {scatter}\nTIS 0.5\n{body}"
                )
    return head + "ScatterRadial 2\n0 40\nDataBegin\n" + "\n".join(blocks) + "\nDataEnd\n"


def test_lighttools_has_a_measurement_for_each_side_and_kind(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(lighttools("Wavelength", ("450", "550"), "Monochrome"))
    reflected, transmitted = open_file(path)
    assert [m.metadata["scatter"] for m in (reflected, transmitted)] == ["brdf", "btdf"]
    data = reflected.data
    at = (data["theta_i_deg"] == 30) & (data["theta_o_deg"] == 40) & (data["wavelength_nm"] == 550)
    assert dict(zip(data["phi_o_deg"][at], data["bsdf"][at], strict=True)) == pytest.approx({0.0: 41.2, 180.0: 42.2})
    assert set(transmitted.data["theta_o_deg"]) == {180.0, 140.0}
    path.write_text(lighttools("TristimulusValue", ("TrisX", "TrisY", "TrisZ"), "XYZ"))
    (colour, _) = open_file(path)
    np.testing.assert_allclose(colour.data["bsdf_xyz"][0], [1.1, 11.1, 21.1])
    for damaged in (
        path.read_text()[:-40],
        path.read_text().replace("TrisZ", "TrisY"),
        path.read_text().replace("Front", "Left"),
    ):
        path.write_text(damaged)
        with pytest.raises(NacreError):
            open_file(path)


def test_a_table_of_transmitted_scatter_says_so(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(
        "theta_i [deg],theta_o [deg],phi_o [deg],BTDF [1/sr],BTDF_std\n0,100,0,.2,.1\n30,150,0,.2,.1\n"
    )
    (found,) = open_file(tmp_path / "x.csv")
    assert found.metadata["scatter"] == "btdf"


def test_a_scan_without_an_incidence_names_the_missing_angle(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("angle_deg,brdf\n-30,.1\n0,.2\n30,.1\n")
    with pytest.raises(NacreError, match="theta_i"):
        open_file(tmp_path / "x.csv")
