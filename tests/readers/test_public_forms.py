"""Forms of public files that the other tests of readers do not have, as small generated texts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.readers.registry import open_file

MUELLER = "".join(
    f"E\t{nm}.000000\t65.000000\t30.1\t120.2\t0.01\t0.02\n"
    f"mm11\t{nm}.000000\t65.000000\t1.0\t0.004\n"
    f"mm12\t{nm}.000000\t65.000000\t-0.5\t-0.5\t0.003\t0.003\n"
    for nm in (400, 410, 420)
)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_mueller_element_of_complete_ease_is_given_twice_before_its_errors(tmp_path: Path) -> None:
    head = "\ufeffSample\nVASEmethod[EllipsometerType=10, Mueller]\nOriginal[x.dat]\nnm\n"
    found = open_file(written(tmp_path, "m.dat", head + MUELLER))
    matrix = next(one for one in found if "m12" in one.data)
    np.testing.assert_allclose(matrix.data["m12"], -0.5)
    np.testing.assert_allclose(matrix.data["m12_error"], 0.003)
    np.testing.assert_allclose(matrix.data["m11_error"], 0.004)


def test_radiances_beside_a_reflectance_are_left_out(tmp_path: Path) -> None:
    head = "Comment: x\nMeasurement: REFLECTANCE\nUnits: W/m^2/sr/nm\nColumns [4]:\nData:\n"
    rows = "".join(f"{350 + i}.0\t1.0e-3\t0.5e-3\t{50 + 0.1 * i:.4f}\n" for i in range(12))
    text = head + "Wvl\tRad. (Ref.)\tRad. (Target)\tReflect. %\n" + rows
    (found,) = open_file(written(tmp_path, "s.sed", text))
    np.testing.assert_allclose(found.data["reflectance"][[0, -1]], [0.5, 0.511])
    assert found.left_out


def test_a_quoted_heading_with_a_comma_over_rows_without_k(tmp_path: Path) -> None:
    rows = "".join(f"{0.4 + 0.01 * i:.2f},{1.5 - 0.001 * i:.10f}\n" for i in range(5))
    (found,) = open_file(written(tmp_path, "n.csv", '\ufeff"Wavelength, µm","n","k"\n' + rows))
    np.testing.assert_allclose(found.data["wavelength_nm"][[0, -1]], [400.0, 440.0])
    np.testing.assert_allclose(found.data["n"][[0, -1]], [1.5, 1.496])


def test_names_and_rows_of_cgats_decide_over_number_of_fields(tmp_path: Path) -> None:
    text = (
        "CTI1\n\nNUMBER_OF_FIELDS 9\nBEGIN_DATA_FORMAT\nSAMPLE_ID RGB_R RGB_G RGB_B XYZ_X XYZ_Y XYZ_Z\n"
        "END_DATA_FORMAT\n"
        "NUMBER_OF_SETS 2\nBEGIN_DATA\n1 100 0 0 14.91 22.41 53.72\n2 70 0 0 24.6 32.11 56.56\nEND_DATA\n"
    )
    (found,) = open_file(written(tmp_path, "c.ti1", text))
    np.testing.assert_allclose(found.data["Y"], [22.41, 32.11])


@pytest.mark.parametrize("kind", ['MEAS_TYPE "EMISSION"', "# nothing"])
def test_the_spectrum_of_a_light_is_no_colour(tmp_path: Path, kind: str) -> None:
    text = (
        f'SPECT\n\n{kind}\nSPECTRAL_NORM "1.000000"\nNUMBER_OF_FIELDS 5\nBEGIN_DATA_FORMAT\n'
        "SPEC_400 SPEC_410 SPEC_420 SPEC_430 SPEC_440\nEND_DATA_FORMAT\nNUMBER_OF_SETS 1\nBEGIN_DATA\n"
        "0.1 2.0 46.0 0.3 0.2\nEND_DATA\n"
    )
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "l.sp", text))


def test_jcamp_with_a_step_instead_of_a_last_abscissa(tmp_path: Path) -> None:
    text = (
        "##TITLE=x\n##JCAMP-DX=5.01\n##DATA TYPE=INFRARED SPECTRUM\n##XUNITS=1/CM\n##YUNITS=TRANSMITTANCE\n"
        "##XFACTOR=1\n##YFACTOR=1\n##FIRSTX=4000\n##DELTAX=-1\n##NPOINTS=6\n##XYDATA=(X++(Y..Y))\n"
        "4000 0.10 0.20 0.30\n3997 0.40 0.50 0.60\n##END=\n"
    )
    (found,) = open_file(written(tmp_path, "j.jdx", text))
    np.testing.assert_allclose(found.data["wavelength_nm"][[0, -1]], [2500.0, 1e7 / 3995.0])
    np.testing.assert_allclose(found.data["transmittance"][[0, -1]], [0.1, 0.6])


SOPRA = (
    "VERSION*1*\nFORMAT*1*\nPOINTS*3*\nDATA1*1*4.0e2*4.1*3.0*\nDATA1*2*5.0e2*4.2*2.0*\nDATA1*3*6.0e2*4.3*1.0*\nEOF*\n"
)


def test_a_material_of_the_sopra_database(tmp_path: Path) -> None:
    (found,) = open_file(written(tmp_path, "S.MAT", SOPRA))
    np.testing.assert_allclose(found.data["wavelength_nm"], [400.0, 500.0, 600.0])
    np.testing.assert_allclose(found.data["n"], [4.1, 4.2, 4.3])
    np.testing.assert_allclose(found.data["k"], [3.0, 2.0, 1.0])
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "C.MAT", SOPRA.replace("DATA1*3*6.0e2*4.3*1.0*\n", "")))


@pytest.mark.parametrize(
    ("view", "quantity", "first"),
    [("Absorbance_10-02", "absorbance", 40.0), ("Relative_10-02", "irradiance", 40.0), ("Subt10__0", "counts", 40.0),
     ("a_Transmission_1", "transmittance", 0.4)],
)  # fmt: skip
def test_the_view_of_ocean_view_names_the_quantity(tmp_path: Path, view: str, quantity: str, first: float) -> None:
    rows = "".join(f"{400 + 5 * i}.0\t{40 + 0.1 * i:.2f}\n" for i in range(40))
    head = f"Data from {view}.txt Node\nDate: x\nXAxis mode: Wavelengths\n>>>>>Begin Spectral Data<<<<<\n"
    (found,) = open_file(written(tmp_path, "o.txt", head + rows))
    assert found.data[quantity][0] == pytest.approx(first)


def test_colorburst_without_names_holds_lab_behind_densities(tmp_path: Path) -> None:
    rows = "".join(f"0.1\t0.2\t-0.01\t0.3\t{90 - i}.5\t1.5\t-2.5\n" for i in range(3))
    (found,) = open_file(written(tmp_path, "c.txt", f"ColorBurst\nBEGIN_DATA\n{rows}END_DATA\n"))
    np.testing.assert_allclose(found.data["L"], [90.5, 89.5, 88.5])
    np.testing.assert_allclose(found.data["b"], -2.5)


def test_is_and_ic_of_ellipsometry_are_no_reflectances(tmp_path: Path) -> None:
    rows = "".join(f"{400 + 5 * i}\t{0.5 + 0.01 * i:.3f}\t{-0.3 + 0.01 * i:.3f}\n" for i in range(10))
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "i.txt", "Wavelength (nm)\tIs\tIc\n" + rows))


def test_a_depolarisation_beside_psi_and_delta_is_left_out(tmp_path: Path) -> None:
    rows = "".join(f"{400 + 10 * i},70,{30 + 0.1 * i:.2f},120,0.5\n" for i in range(6))
    head = "Wavelength (nm),Angle (°),Psi (°),Delta (°),% Depolarization\n"
    (found,) = open_file(written(tmp_path, "d.csv", head + rows))
    np.testing.assert_allclose(found.data["psi_deg"][[0, -1]], [30.0, 30.5])
    assert found.left_out


def test_a_signature_of_spectra_vista_is_the_ratio(tmp_path: Path) -> None:
    rows = "".join(f"{340 + 1.5 * i:.1f}  1000.2{i}  52.31  {5.2 + 0.1 * i:.2f}\n" for i in range(20))
    head = "/*** Spectra Vista SIG Data ***/\nname= a.sig\nfactors= 1.000, 0.992, 0.975\nunits= Radiance\ndata= \n"
    (found,) = open_file(written(tmp_path, "a.sig", head + rows))
    np.testing.assert_allclose(found.data["wavelength_nm"][[0, -1]], [340.0, 368.5])
    np.testing.assert_allclose(found.data["reflectance"][[0, -1]], [0.052, 0.071])


def test_rows_that_begin_with_a_tab(tmp_path: Path) -> None:
    text = "\twvl (Å)\tn\tk\n\t4000\t1.5\t0\n\t5000\t1.49\t0.1\n\t6000\t1.48\t0.2\n"
    (found,) = open_file(written(tmp_path, "a.txt", text))
    np.testing.assert_allclose(found.data["wavelength_nm"], [400.0, 500.0, 600.0])
    np.testing.assert_allclose(found.data["k"], [0.0, 0.1, 0.2])


@pytest.mark.parametrize("heading", ["w[nm]", "w (rad/s)"])
def test_the_unit_distinguishes_wavelength_and_angular_frequency(tmp_path: Path, heading: str) -> None:
    rows = "500\t1.5\t0\n600\t1.4\t0\n700\t1.3\t0\n" if "nm" in heading else "2e15\t1.3\t0\n3e15\t1.5\t0\n"
    (found,) = open_file(written(tmp_path, "w.txt", f"# {heading}\tn\tk\n{rows}"))
    nm = found.data["wavelength_nm"]
    np.testing.assert_allclose(nm[0], 500.0 if "nm" in heading else 1.883651567308853e18 / 3e15)
    assert found.data["n"][0] == 1.5


def test_headings_with_wavelengths_of_lamps_stand_above_a_wavelength_column(tmp_path: Path) -> None:
    head = "Wavelength [nm]," + ",".join(f"{1000 + 50 * i}nm" for i in range(9)) + "\n"
    rows = "".join(f"{1014.5 + 4.5 * i:.1f}," + ",".join(f"{0.1 * j:.1f}" for j in range(9)) + "\n" for i in range(20))
    found = open_file(written(tmp_path, "l.csv", head + rows))
    assert len(found) == 9
    np.testing.assert_allclose(found[8].data["wavelength_nm"][[0, -1]], [1014.5, 1100.0])
    np.testing.assert_allclose(found[8].data["reflectance"], 0.8)


def test_repeated_columns_of_avantes_are_spectra_of_their_own(tmp_path: Path) -> None:
    head = "Averaging Nr. [scans]: 2\nWave   ;Sample   ;Sample\n[nm]   ;[counts] ;[counts]\n\n"
    rows = "".join(f"{900 + 5 * i},00;{4500 + i},000;{4600 + i},000\n" for i in range(20))
    found = open_file(written(tmp_path, "a.csv", head + rows))
    assert [one.data["counts"][0] for one in found] == [4500.0, 4600.0]


def test_powers_under_the_head_of_wvase_are_spectra(tmp_path: Path) -> None:
    head = "SiO2(20A)/Si\nVASEmethod[EllipsometerType=0]\nOriginal[a b c d.dat]\nnm\n"
    rows = "".join(f"uR\t{200 + i}.000000\t0.000000\t{0.65 + 0.001 * i:.5f}\t0.0001\n" for i in range(10))
    (found,) = open_file(written(tmp_path, "r.dat", head + rows))
    assert found.kind == "spectrum"
    np.testing.assert_allclose(found.data["reflectance"][[0, -1]], [0.65, 0.659])
    psi = "".join(f"{200 + i}.0\t65.0\t30.5\t120.5\n" for i in range(10))
    both = open_file(written(tmp_path, "b.dat", head + rows + psi))
    assert {"psi_deg", "reflectance"} <= {name for one in both for name in one.data}


def test_psi_and_delta_under_a_heading_without_a_name_of_the_wavelength(tmp_path: Path) -> None:
    rows = "".join(f"{400 + 10 * i}\t70\t30.5\t130.5\n" for i in range(5))
    (found,) = open_file(written(tmp_path, "w.txt", "\taoi\tPsi\tDelta\n\n" + rows))
    np.testing.assert_allclose(found.data["wavelength_nm"][[0, -1]], [400.0, 440.0])
    np.testing.assert_allclose(found.data["delta_deg"], 130.5)


def test_a_row_of_bare_units_belongs_to_the_names_above(tmp_path: Path) -> None:
    rows = "".join(f"{400 + i},0;10,1;20,2;69,7\n" for i in range(12))
    head = "Wavelength;Transmittance;Reflectance;Absorptance\nnm;%;%;%\n"
    found = open_file(written(tmp_path, "w.csv", head + rows))
    values = {name: float(one.data[name][0]) for one in found for name in one.data if name != "wavelength_nm"}
    assert values == pytest.approx({"transmittance": 0.101, "reflectance": 0.202, "absorptance": 0.697})


@pytest.mark.parametrize("second", ["", "Wavenumber,"])
def test_the_technique_names_the_processed_values(tmp_path: Path, second: str) -> None:
    head = f"ENLIGHTEN Version,2.2.7\nTechnique,Transmission\n\nPixel,Wavelength,{second}Processed,Raw,Dark\n"
    more = "0.0," if second else ""
    rows = "".join(f"{i},{400 + 0.5 * i:.2f},{more}{50 + 0.1 * i:.5f},{2000 + i}.0,900.0\n" for i in range(30))
    (found,) = open_file(written(tmp_path, "e.csv", head + rows))
    np.testing.assert_allclose(found.data["transmittance"][[0, -1]], [0.5, 0.529])


def test_radiances_of_asd_are_no_reflectance(tmp_path: Path) -> None:
    head = "Text conversion of header file a.asd\nNew ASD spectrum file\nSpectrum file is radiance data\n\n"
    rows = "".join(f"{350 + i}\t {0.35 + 0.001 * i:.4f} \n" for i in range(60))
    (found,) = open_file(written(tmp_path, "a.txt", head + "Wavelength\ta.asd\n" + rows))
    assert "reflectance" not in found.data
    np.testing.assert_allclose(found.data["irradiance"][0], 0.35)


def test_a_last_abscissa_that_the_rows_contradict_is_refused(tmp_path: Path) -> None:
    text = (
        "##TITLE=x\n##JCAMP-DX=4.24\n##DATA TYPE=UV/VIS SPECTRUM\n##XUNITS=NANOMETERS\n##YUNITS=ABSORBANCE\n"
        "##XFACTOR=1\n##YFACTOR=1\n##FIRSTX=400\n##LASTX={last}\n##XYDATA=(X++(Y..Y))\n"
        "400 .1 .2 .3\n403 .4 .5 .6\n##END=\n"
    )
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "a.jdx", text.format(last=800)))
    (found,) = open_file(written(tmp_path, "b.jdx", text.format(last=405)))
    np.testing.assert_allclose(found.data["absorbance"][[0, -1]], [0.1, 0.6])


def test_tristimulus_values_up_to_one_are_said_to_be_dark(tmp_path: Path) -> None:
    text = (
        "CGATS.17\nBEGIN_DATA_FORMAT\nSAMPLE_ID\tXYZ_X\tXYZ_Y\tXYZ_Z\nEND_DATA_FORMAT\nBEGIN_DATA\n"
        "A\t0.3\t0.33\t0.30\nB\t{y}\t{y}\t0.8\nEND_DATA\n"
    )
    (dark,) = open_file(written(tmp_path, "d.txt", text.format(y=0.95)))
    (usual,) = open_file(written(tmp_path, "u.txt", text.format(y=95)))
    assert len(dark.assumed) == len(usual.assumed) + 1


def test_a_spectrum_without_a_type_is_asked(tmp_path: Path) -> None:
    text = (
        'SPECT\n\nDESCRIPTOR "D50"\nSPECTRAL_NORM "100.0"\nNUMBER_OF_FIELDS 3\nBEGIN_DATA_FORMAT\n'
        "SPEC_400 SPEC_410 SPEC_420\nEND_DATA_FORMAT\nNUMBER_OF_SETS 1\nBEGIN_DATA\n40 50 60\nEND_DATA\n"
    )
    path = written(tmp_path, "d.sp", text)
    with pytest.raises(AmbiguousFileError):
        open_file(path)
    (found,) = open_file(path, ReadOptions(quantity="reflectance"))
    np.testing.assert_allclose(found.data["spectra"], [[0.4, 0.5, 0.6]])
