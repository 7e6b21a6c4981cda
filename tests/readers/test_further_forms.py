"""Forms of ellipsometers, spectrometers, colour programs and profilers that were once misread, as generated texts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.material.material import material
from nacre.optimise.colour_list import read_colours
from nacre.readers.headings import light_above
from nacre.readers.heights.surface import read_map
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.readers.registry import open_file

NM = range(400, 701, 20)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def rows(*columns: float, delimiter: str = ",") -> str:
    return "".join(delimiter.join([f"{nm}", *(f"{c + nm / 1e5:.5f}" for c in columns)]) + "\n" for nm in NM)


@pytest.mark.parametrize(
    ("head", "quantity", "first", "nm"),
    [
        ("#Type,transmittance\n#XUnit,nm_vac\n#YUnit,percent\n[Data]\n", "transmittance", 0.3, 400.0),
        ("#AxisUnit[1]=\t1/cm\n#AxisType[0]=\tIntens\n#AxisUnit[0]=\tCnt/sec\n", "counts", 30.0, 1e7 / 400),
        ("X-Axis Unit: nm\nMode: Reflectance\nY-Axis Unit: %\n", "reflectance", 0.3, 400.0),
    ],
)
def test_keys_beside_a_table_state_its_axes(head: str, quantity: str, first: float, nm: float, tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.txt", head + rows(30.0, delimiter="\t")))
    at = int(np.argmin(np.abs(found.data["wavelength_nm"] - nm)))
    np.testing.assert_allclose(found.data["wavelength_nm"][at], nm)
    np.testing.assert_allclose(found.data[quantity][at], first, rtol=1e-3)


def test_text_below_a_table_states_counts(tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.asc", rows(2.0, delimiter="\t") + "\nModel:\tX1\nData Type:\tCounts\n"))
    assert "counts" in found.data


@pytest.mark.parametrize("heading", ["Contrast", "dR/R", "ΔT/T", "EQE (%)", "Emissivity", "Haze (%)"])
def test_another_quantity_is_no_reflectance(heading: str, tmp_path: Path) -> None:
    path = written(tmp_path, "s.csv", f"Wavelength (nm),{heading}\n" + rows(0.3))
    with pytest.raises(AmbiguousFileError):
        open_file(path)
    (found,) = open_file(path, ReadOptions(quantity="reflectance"))
    np.testing.assert_allclose(found.data["reflectance"][0], 0.304)


@pytest.mark.parametrize(
    ("headings", "columns"),
    [
        ("I,I0", (200.0, 1000.0)), ("Sample,White,Dark", (280.0, 1000.0, 100.0)), ("Sample A,Sample B", (400.0, 900.0)),
        ("Sample,Background", (0.2, 0.9)),
    ],
)  # fmt: skip
def test_signals_of_a_detector_are_no_reflectance(headings: str, columns: tuple[float, ...], tmp_path: Path) -> None:
    with pytest.raises(AmbiguousFileError):
        open_file(written(tmp_path, "s.csv", f"Wavelength (nm),{headings}\n" + rows(*columns)))


@pytest.mark.parametrize("heading", ["Absorbance (mAU)", "mOD", "Abs (mAbs)"])
def test_thousandths_of_an_absorbance(heading: str, tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.csv", f"Wavelength (nm),{heading}\n" + rows(700.0)))
    np.testing.assert_allclose(found.data["absorbance"][0], 0.7, rtol=1e-4)


@pytest.mark.parametrize(
    ("line", "key", "value"),
    [
        ("Polarizer angle: 90 deg", "polarisation", "s"), ("Polarisatorwinkel = 0°", "polarisation", "p"),
        ("AOI = 785.398 mrad", "angle_of_incidence_deg", 45.0), ("Polarizer angle: 30", "polarisation", None),
        ("Einfallswinkel: 60 Grad", "angle_of_incidence_deg", 60.0), ("Polarisator: 90 Grad", "polarisation", "s"),
        ("Polarizer angle (deg): 90", "polarisation", "s"), ("Polarizer: p", "polarisation", "p"),
        ("Polarizer angle: 90", "polarisation", None),
    ],
)  # fmt: skip
def test_a_polariser_and_small_units_above_a_table(line: str, key: str, value: object, tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.csv", line + "\nWavelength (nm),R (%)\n" + rows(30.0)))
    stated = found.metadata.get(key)
    assert stated == (pytest.approx(value) if isinstance(value, float) else value)


NAMED = np.array([[0.95, 2.5], [1.05, 3.0], [1.15, 3.5]])  # n and k at 450, 550 and 650 nm


@pytest.mark.parametrize(
    ("head", "scale", "delimiter", "encoding"),
    [
        ("Wellenlänge [nm];Brechzahl n;Extinktionskoeffizient k", "1", ";", "cp1252"),
        ("Longueur d'onde (nm)\tIndice n\tIndice k", "1", "\t", "cp1252"),
        ("Longitud de onda (nm)\tn\tk", "1", "\t", "utf-16"),
        ("Photon energy (meV),n,k", "1239841.984/x", ",", "utf-8"),
        ("omega (rad/fs),n,k", "1883.651567/x", ",", "utf-8"),
        ("Frequency (PHz),n,k", "299.792458/x", ",", "utf-8"),
        ("Wavelength (Å),n,k", "x*10", ",", "utf-8"),
        ("Wavelength/m,n,k", "x*1e-9", ",", "utf-8"),
        ("Wavenumber (cm⁻¹),n,k", "1e7/x", ",", "utf-8"),
        ('"Wavelength, nm","Index, n","Extinction, k"', "1", ",", "utf-8"),
        ("T (K),Wavelength (nm),n,k", "T", ",", "utf-8"),
    ],
)
def test_optical_constants_as_laboratories_write_them(
    head: str, scale: str, delimiter: str, encoding: str, tmp_path: Path
) -> None:
    scales = {"1239841.984/x": 1239841.984, "1883.651567/x": 1883.651567, "299.792458/x": 299.792458, "1e7/x": 1e7}
    factors = {"x*10": 10.0, "x*1e-9": 1e-9}
    lines = [head]
    for nm in NM:
        x = scales[scale] / nm if scale in scales else nm * factors.get(scale, 1.0)
        cells = [f"{x:.10g}", f"{0.5 + nm / 1000:.6g}", f"{3 + (nm - 550) / 200:.6g}"]
        lines.append(delimiter.join(["293", *cells] if scale == "T" else cells))
    path = tmp_path / "nk.csv"
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    film: Any = material({"family": "film", "substrate": {"file": str(path)}, "layers": []}).model
    found = film.stack.indices(np.array([450.0, 550.0, 650.0]))[-1]
    np.testing.assert_allclose(np.stack([found.real, found.imag], axis=-1), NAMED, rtol=4e-3)


def test_padding_behind_a_text_is_no_binary_file(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    path.write_bytes(("Wavelength (nm),R (%)\n" + rows(30.0)).encode() + bytes(60))
    (found,) = open_file(path)
    assert len(found.data["reflectance"]) == len(NM)


def test_ratios_of_kubelka_and_munk_are_named(tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.csv", "Wavelength (nm),K/S\n" + rows(0.3)))
    assert set(found.data) == {"wavelength_nm", "kubelka_munk"}


def test_headings_that_are_angles(tmp_path: Path) -> None:
    path = written(tmp_path, "s.csv", "Wavelength (nm),0°,15°,45 deg\n" + rows(0.3, 0.4, 0.5))
    for options in (ReadOptions(), ReadOptions(expects="spectrum", assumed_quantity="reflectance")):  # of a fit
        found = open_file(path, options)
        assert [each.metadata["angle_of_incidence_deg"] for each in found] == [0.0, 15.0, 45.0]
        np.testing.assert_allclose(found[2].data["reflectance"][0], 0.504)


def test_aspecular_angles_as_headings_are_no_incidence(tmp_path: Path) -> None:
    found = open_file(written(tmp_path, "s.csv", "Wavelength (nm),-15°,15°,110°\n" + rows(0.3, 0.4, 0.5)))
    assert not any("angle_of_incidence_deg" in each.metadata for each in found)


@pytest.mark.parametrize("heading", ["LightIntensity", "RawIntensity", "Lichtintensität", "rel_intensity"])
def test_an_intensity_in_one_word_is_no_reflectance(heading: str, tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.csv", f"Wavelength (nm),{heading}\n" + rows(0.3)))
    assert "counts" in found.data


@pytest.mark.parametrize(
    ("line", "lamp"),
    [("Light source: a halogen lamp", None), ("Illumination: A diffuse sphere", None), ("Illuminant A 2 deg", "A"),
     ("Illuminant: C, observer: 2", "C"), ("Illuminant A and observer 1964", "A"), ("illuminant\td65", "D65")],
)  # fmt: skip
def test_an_article_is_no_illuminant(line: str, lamp: str | None) -> None:
    assert light_above([line]).get("illuminant") == lamp


def test_a_chosen_format_without_its_heading(tmp_path: Path) -> None:
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "s.txt", "a\n" + rows(30.0)), ReadOptions(format="spectraray"))


@pytest.mark.parametrize("heading", ["Wavelength (nm):\tTransmittance (%):", "Wavelength:\tT (%)", "Wavelength:\t%T:"])
def test_headings_that_end_in_a_colon(heading: str, tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.txt", heading + "\n" + rows(30.0, delimiter="\t")))
    np.testing.assert_allclose(found.data["transmittance"][0], 0.30004)


def test_a_tilt_in_a_preamble_is_no_luminaire(tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.csv", "TILT = 0\nWavelength (nm),Reflectance (%)\n" + rows(30.0)))
    assert "reflectance" in found.data
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "l.ies", "[TEST] 1\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 50\n"))


def test_rows_of_heights_that_begin_with_a_tab(tmp_path: Path) -> None:
    z = np.sin(np.outer(np.arange(6.0), np.arange(7.0)) * 1.3)
    text = "".join("\t" + "\t".join(f"{value:.6f}" for value in row) + "\n" for row in z)
    path = written(tmp_path, "m.txt", text)
    (found,) = open_file(path, ReadOptions(format="matrix", unit="um", pitch_um=(0.1, 0.1)))
    np.testing.assert_allclose(found.data["height_um"], z, atol=1e-5)


def test_a_report_of_a_coating_in_two_polarisations(tmp_path: Path) -> None:
    head = "Coating : AR\nAngle of Incidence: 30.000000\n\n "
    head += "Wavelength S-Reflect P-Reflect S-Transmit P-Transmit S-Absorb\n"
    body = "".join(f" {nm / 1000:.6f} 0.2 0.1 0.7 0.85 0.1\n" for nm in NM)
    found = {each.metadata["polarisation"]: each for each in open_file(written(tmp_path, "c.txt", head + body))}
    assert {each.metadata["angle_of_incidence_deg"] for each in found.values()} == {30.0}
    np.testing.assert_allclose(found["s"].data["reflectance"], 0.2)
    np.testing.assert_allclose(found["p"].data["transmittance"], 0.85)
    assert not any("absorbance" in each.data for each in found.values())


def test_spectra_of_qtx(tmp_path: Path) -> None:
    text = (
        "[STANDARD_DATA 0]\r\nSTD_NAME=Blue\r\nSTD_REFLPOINTS=4\r\nSTD_REFLINTERVAL=100\r\nSTD_REFLLOW=400\r\n"
        "STD_R=10,20,30,40\r\n[BATCH_DATA 0 0]\r\nBAT_NAME=B\r\nBAT_REFLPOINTS=4\r\nBAT_REFLINTERVAL=100\r\n"
        "BAT_REFLLOW=400\r\nBAT_R=11,21,31,41\r\n"
    )
    found = open_file(written(tmp_path, "s.qtx", text))
    assert [each.name for each in found] == ["Blue", "B"]
    np.testing.assert_allclose(found[1].data["reflectance"], [0.11, 0.21, 0.31, 0.41])
    np.testing.assert_allclose(found[1].data["wavelength_nm"], [400, 500, 600, 700])
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "cut.qtx", text.replace("10,20,30,40", "10,20,30")))


@pytest.mark.parametrize("layer", ["GENOSC", "ema", "CAUCHY"])
def test_layers_of_parameters_are_refused_by_name(layer: str, tmp_path: Path) -> None:
    with pytest.raises(NacreError, match=layer):
        open_file(written(tmp_path, "l.mat", f"a layer\n{layer}\n1 2 0 0\n6.5 120.7 0.001 0 1.5 0\n 0.7 5.0 0.02\n"))


def test_a_first_row_of_angles_twice_each(tmp_path: Path) -> None:
    def text(delta: float) -> str:
        body = "".join(f"{nm}\t{20 + nm / 100}\t{delta}\t{18 + nm / 100}\t{delta - 2}\t\n" for nm in NM)
        return "\t65\t65\t70\t70\t\n" + body

    (found,) = open_file(written(tmp_path, "e.txt", text(150.0)))
    np.testing.assert_allclose(np.unique(found.data["angle_of_incidence_deg"]), [65, 70])
    np.testing.assert_allclose(found.data["psi_deg"][[0, len(NM)]], [24.0, 22.0])
    np.testing.assert_allclose(found.data["delta_deg"][[0, len(NM)]], [150.0, 148.0])
    with pytest.raises(AmbiguousFileError):  # two reflectances in per cent have such values, too
        open_file(written(tmp_path, "r.txt", text(50.0)))


@pytest.mark.parametrize(
    "head",
    ["Wavelength (nm),Psi_65,Delta_65\n", "Wavelength (nm),Psi 65.0,Delta 65.0\n", "# AOI = 65 deg\nnm,Psi,Delta\n"],
)
def test_the_angle_of_psi_and_delta_in_headings_or_above(head: str, tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "e.csv", head + rows(30.0, 120.0)))
    np.testing.assert_allclose(found.data["angle_of_incidence_deg"], 65.0)
    np.testing.assert_allclose(found.data["psi_deg"][0], 30.004)


def test_constants_headed_by_parts_of_the_index_or_a_single_unit(tmp_path: Path) -> None:
    text = "# wavelength(m) Re(index) Im(index)\n4e-7 1.5 0.01\n5e-7 1.4 0.02\n6e-7 1.3 0.03\n"
    (found,) = open_file(written(tmp_path, "n.txt", text))
    np.testing.assert_allclose([found.data["n"][0], found.data["k"][0]], [1.5, 0.01])
    (found,) = open_file(written(tmp_path, "u.csv", "wl,n,k\nmicrons,,\n0.4,1.47,0\n0.5,1.46,0\n0.7,1.45,0\n"))
    np.testing.assert_allclose(found.data["wavelength_nm"], [400, 500, 700])


@pytest.mark.parametrize("heading", ["H,S,V", "H,S,L", "C,M,Y,K"])
def test_coordinates_of_devices_are_no_cielab(heading: str, tmp_path: Path) -> None:
    values = ",".join(["50"] * len(heading.split(",")))
    path = written(tmp_path, "c.csv", f"name,{heading}\nred,{values}\nblue,{values}\n")
    for read in (open_file, lambda each: read_colours(each, 1)):
        with pytest.raises(NacreError):
            read(path)


@pytest.mark.parametrize("values", ["0.6,0.2,0.1", "34900,53000,50000", "140,170,180"])
def test_colours_of_another_scale(values: str, tmp_path: Path) -> None:
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "c.csv", f"name,L,a,b\none,{values}\ntwo,{values}\n"))


def test_angles_and_lamps_of_colours_in_short_forms(tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "b.csv", "Name;L*(-15);a*(-15);b*(-15)\nred;80,1;20;10\n"))
    assert "L_-15deg" in found.data
    head = "Name,L*(D65/10),a*(D65/10),b*(D65/10),L*(A/10),a*(A/10),b*(A/10)\n"
    path = written(tmp_path, "i.csv", head + "red,50,40,20,55,45,25\n")
    with pytest.raises(NacreError):
        open_file(path)
    (found,) = open_file(path, ReadOptions(ignore=("L*(D65/10)", "a*(D65/10)", "b*(D65/10)")))
    assert (found.metadata["illuminant"], found.metadata["observer"], found.data["L"][0]) == ("A", "10deg", 55.0)
    (found,) = open_file(written(tmp_path, "h.csv", "Name,L*,C*,h°\nred,53.2,104.5,40\n"))
    np.testing.assert_allclose(found.data["hue_deg"], 40.0)


@pytest.mark.parametrize("body", ["No\tName\tX\tY\tZ\n1\tA1\t96.42\t100\t82.49\n2\tA2\t48.21\t50\t41.25\n", None])
def test_the_lamp_above_a_list_of_colours(body: str | None, tmp_path: Path) -> None:
    """White under D50 (its XYZ, or L* = 100) stays white under D65."""
    text = f"ILLUMINANT\tD50\nOBSERVER\t2\n{body}" if body else "# Illuminant: D50, observer 2\n100,0,0\n"
    row = read_colours(written(tmp_path, "w.txt", text), 1, ("D65", "2deg"))[0]
    np.testing.assert_allclose(row.lab, [[100.0, 0.0, 0.0]], atol=0.02)


def test_measured_colours_precede_their_picture(tmp_path: Path) -> None:
    path = written(tmp_path, "n.csv", "Name,L*,a*,b*,HEX\nred,50,60,40,#00FF00\n")
    np.testing.assert_allclose(read_colours(path, 1)[0].lab, [[50.0, 60.0, 40.0]])


def test_colours_beside_words(tmp_path: Path) -> None:
    path = written(tmp_path, "r.csv", "Code;HEX;English\nRAL 1000;#BEBD7F;Green beige\nRAL 1001;#C2B078;Beige\n")
    (found,) = open_file(path, ReadOptions(ignore=("English",)))
    np.testing.assert_allclose(found.data["srgb"][0], np.array([0xBE, 0xBD, 0x7F]) / 255)


@pytest.mark.parametrize("corner", ["", "0"])
def test_coordinates_around_a_matrix_of_heights(corner: str, tmp_path: Path) -> None:
    z = np.sin(np.arange(20)[:, None] / 3) + np.cos(np.arange(18) / 2)
    text = "\n".join(
        [",".join([corner, *(f"{i * 0.5}" for i in range(18))])]
        + [",".join([f"{j * 0.5}", *(f"{value:.4f}" for value in row)]) for j, row in enumerate(z)]
    )
    path = written(tmp_path, "m.csv", text + "\n")
    with pytest.raises(AmbiguousFileError):
        open_file(path, ReadOptions(unit="um"))
    (found,) = open_file(path, ReadOptions(unit="um", pitch_um=(0.5, 0.5)))
    assert found.data["height_um"].shape == (20, 18)
    plane = written(tmp_path, "p.txt", "\n".join(" ".join(f"{i + j}" for i in range(9)) for j in range(9)) + "\n")
    (found,) = open_file(plane, ReadOptions(unit="um", pitch_um=(1.0, 1.0), format="matrix"))
    assert found.data["height_um"].shape == (9, 9)


@pytest.mark.parametrize(
    "text",
    [
        "ABGF BLACK\n 0.001 0.002 1.5\n",
        "IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n",
        "CC GLASSES\nNM N-BK7 2 517642 1.5168 64.17 0 0\nED 7.1 8.3\nCD 1.03961212 6.0E-3 2.3E-1 2E-2\n",
        "SiO2 Density=2.2\n Energy(eV), Delta, Beta\n 100 1e-3 1e-4\n110 1e-3 1e-4\n",
    ],
)
def test_files_of_other_programs_are_refused(text: str, tmp_path: Path) -> None:
    path = written(tmp_path, "f.txt", text)
    said = set()
    for read in (open_file, read_map, lambda each: read_colours(each, 1)):
        with pytest.raises(NacreError) as raised:
            read(path)
        assert not isinstance(raised.value, AmbiguousFileError)
        said.add(str(raised.value))
    assert len(said) == 1  # the same cause wherever the file stands


def test_the_unit_of_z_does_not_change_the_unit_of_x_and_y(tmp_path: Path) -> None:
    points = "".join(f"{i / 1e3}\t{j / 1e3}\t{np.sin(i) + j}\n" for j in range(6) for i in range(6))
    path = written(tmp_path, "p.txt", "X (mm)\tY (mm)\tZ\n" + points)
    with pytest.raises(AmbiguousFileError):
        open_file(path)
    (found,) = open_file(path, ReadOptions(unit="um"))
    np.testing.assert_allclose(found.metadata["pitch_um"], [1.0, 1.0])
    np.testing.assert_allclose(
        np.ptp(found.data["height_um"]), np.ptp([np.sin(i) + j for i in range(6) for j in range(6)])
    )


def test_a_map_over_a_wafer_is_no_height_map(tmp_path: Path) -> None:
    points = "".join(f"{i}\t{j}\t{500 + i}\n" for j in range(6) for i in range(6))
    path = written(tmp_path, "m.txt", "Thickness # 1 in nm vs. Position\nX (cm)\tY (cm)\tZ\n" + points)
    with pytest.raises(NacreError) as raised:
        open_file(path, ReadOptions(unit="nm"))
    assert not isinstance(raised.value, AmbiguousFileError)


def test_ratios_of_anisotropic_samples_in_woollam_files(tmp_path: Path) -> None:
    head = "film\nVASEmethod[EllipsometerType=4, Anisotropic]\nOriginal[x.dat]\nnm\n"
    body = "".join(f"AnE\t{nm}\t55\t40\t120\t0.01\t0.02\nAps\t{nm}\t55\t1\t20\t0.01\t0.02\n" for nm in NM)
    (found,) = open_file(written(tmp_path, "a.dat", head + body))
    np.testing.assert_allclose(found.data["psi_deg"], 40.0)
    np.testing.assert_allclose(found.data["delta_deg"], 120.0)
    assert found.left_out


def test_a_number_below_a_title_ends_the_preamble(tmp_path: Path) -> None:
    text = "Number of Zones\n1\n" + "".join(f"{angle}\t20.5\t170.5\n" for angle in range(50, 60))
    path = written(tmp_path, "z.txt", text)
    with pytest.raises(AmbiguousFileError) as raised:
        open_file(path)
    assert raised.value.option == "columns"


def test_columns_share_the_scale_of_a_stated_quantity(tmp_path: Path) -> None:
    path = written(tmp_path, "s.csv", "Wavelength (nm),black,white\n" + rows(0.8, 80.0))
    black, white = open_file(path, ReadOptions(quantity="reflectance"))
    np.testing.assert_allclose(black.data["reflectance"][0], 0.00804)
    np.testing.assert_allclose(white.data["reflectance"][0], 0.80004)


@pytest.mark.parametrize("heading", ["Wavelength (µm) T", "Wavelength (um) T (%)"])
def test_a_unit_apart_from_its_word_is_no_column(heading: str, tmp_path: Path) -> None:
    scale = 0.01 if "%" in heading else 1.0
    body = "".join(f"{nm / 1000:g} {0.5 / scale:g}\n" for nm in NM)
    (found,) = open_file(written(tmp_path, "s.txt", f"{heading}\n{body}"))
    np.testing.assert_allclose(found.data["transmittance"], 0.5)
    np.testing.assert_allclose(found.data["wavelength_nm"], list(NM))


def test_a_frequency_is_no_wavelength(tmp_path: Path) -> None:
    body = "".join(f"{299792.458 / nm:.6f};0.5\n" for nm in NM)
    (found,) = open_file(written(tmp_path, "s.csv", f'"frequency (THz)";R\n{body}'))
    np.testing.assert_allclose(np.sort(found.data["wavelength_nm"]), list(NM), rtol=1e-8)


def test_decimal_commas_between_blanks(tmp_path: Path) -> None:
    body = "".join(f"{nm},5 123,{nm}\n" for nm in NM)
    (found,) = open_file(written(tmp_path, "s.txt", f"Wavelength (nm)  R (%)\n{body}"))
    np.testing.assert_allclose(found.data["reflectance"], [1.23 + nm / 1e5 for nm in NM])


@pytest.mark.parametrize("row", ["abc", "12.5,0.5"])
def test_a_damaged_row_does_not_end_a_table(row: str, tmp_path: Path) -> None:
    whole = rows(30.0).splitlines()
    whole[12] = whole[12].split(",")[0] + "," + row
    path = written(tmp_path, "s.csv", "Wavelength (nm),R (%)\n" + "\n".join(whole) + "\n")
    with pytest.raises(NacreError, match="line 14"):
        open_file(path)


def test_settings_below_a_table_are_no_rows(tmp_path: Path) -> None:
    path = written(tmp_path, "s.csv", "Wavelength (nm),R (%)\n" + rows(30.0) + "\nStart (nm),400\nScan rate,600\n")
    for options in (ReadOptions(), ReadOptions(format="table")):
        (found,) = open_file(path, options)
        np.testing.assert_allclose(found.data["wavelength_nm"], list(NM))
        assert found.left_out


def test_an_infinite_absorbance_is_missing(tmp_path: Path) -> None:
    text = "Wavelength (nm),Absorbance\n" + rows(1.0).replace("1.00500", "inf")
    (found,) = open_file(written(tmp_path, "s.csv", text))
    np.testing.assert_allclose(found.data["wavelength_nm"], [nm for nm in NM if nm != 500])


def test_a_date_above_numbers_is_no_heading(tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "s.csv", "Sample: wafer\nDate: 01.02.2024\n" + rows(0.3)))
    np.testing.assert_allclose(found.data["reflectance"][0], 0.304)


@pytest.mark.parametrize(("unit", "factor"), [("nm", 1e-3), ("um", 1.0)])
def test_a_unit_that_contradicts_the_numbers_is_asked_for(unit: str, factor: float, tmp_path: Path) -> None:
    body = "".join(f"{nm * factor:g};0.5\n" for nm in NM)
    path = written(tmp_path, "s.csv", f"Wavelength;Transmittance\n[{unit}];[1]\n{body}")
    with pytest.raises(AmbiguousFileError) as caught:
        open_file(path)
    assert caught.value.option == "unit"
