"""Files of ellipsometers, written here in the forms of their programs, and the shared real ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import open_file

SHARED = Path(__file__).resolve().parents[3] / "shared" / "reference" / "instruments" / "ellipsometry"
DIGITS = 2e-6  # the readings are printed with 8 digits

WOOLLAM = """wafer 3
VASEmethod[EllipsometerType=4, Isotropic]
Original[w3.dat]
nm
400.0\t65.0\t20.5\t170.25\t0.1\t0.2
500.0\t65.0\t19.5\t-3.5\t0.1\t0.2
dPolE\t400.0\t65.0\t1.5\t0.3
uR\t400.0\t20.0\t0.35\t0.01
pS\t400.0\t20.0\t0.35\t0.01
"""
EASE = "\nVASEmethod[EllipsometerType=7]\nDynamic\nAngstroms\n" + (
    "E 4000 65 20.5 170.25 0.1 0.2 0.5\nE 4000 65 20.6 170.5 0.1 0.2 1.5\n"
)
FILM_SENSE = "Film_Sense_Data\n2\t1\t-65.01\t0\t0\n465\t1\n635\t1\n0.6\t-0.7\t0.3\t0.99\t5\n0.7\t-0.6\t0.2\t1.0\t6\n"
DYNAMIC = "Film_Sense_Dyn_Data\n2\t2\t9.9\n465\t1\n635\t1\nTime\tBlue_N\tBlue_C\tBlue_S\tRed_N\tRed_C\tRed_S\tFit\n" + (
    "0.5\t.6\t-.7\t.3\t.7\t-.6\t.2\t1\n1.5\t.61\t-.7\t.3\t.71\t-.6\t.2\t1\n"
)
ACCURION = """#Lambda\tBandwidth\tAOI\tDelta\tPsi\tZone\tROIidx
#nm\tnm\tdeg\tdeg\tdeg\t-\t-
658.0\t2.0\t50.0\t170.0\t31.0\t1\t0
658.0\t2.0\t50.0\t171.0\t32.0\t2\t0
658.0\t2.0\t50.0\tNaN\tNaN\t3\t0
658.0\t2.0\t50.0\t170.5\t31.5\t0\t0
658.0\t2.0\t50.0\t0.5\t0.5\t5\t0
"""
HORIBA = "# INCIDENCE ANGLE:\n70.00 deg\n\n# DATA:\nnm Psi Delta\n400 20.5 170.25\n500 19.5 171\n\n"


def written(folder: Path, text: str, name: str = "file.dat", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_text(text, encoding=encoding)
    return path


def first(path: Path, **options: Any) -> Measurement:
    return open_file(path, ReadOptions(**options))[0]


def row(measurement: Measurement, index: int, *names: str) -> list[float]:
    return [float(measurement.data[name][index]) for name in names]


BASIC = ("wavelength_nm", "angle_of_incidence_deg", "psi_deg", "delta_deg")


def test_decimal_commas_are_read(tmp_path: Path) -> None:
    points, commas = (first(written(tmp_path, text)) for text in (WOOLLAM, WOOLLAM.replace(".", ",")))
    np.testing.assert_array_equal(points.data["psi_deg"], commas.data["psi_deg"])
    assert (
        first(written(tmp_path, "SE PSI DELTA\nAOI 75,5\nSE 400,5\t0,5\t-0,5\n")).data["angle_of_incidence_deg"][0]
        == 75.5
    )


def test_accurion_with_decimal_commas_and_intensities_of_a_modulator(tmp_path: Path) -> None:
    found = first(written(tmp_path, ACCURION.replace(".", ",")))
    assert row(found, 0, *BASIC) == [658.0, 50.0, 31.5, 170.5]
    found = first(written(tmp_path, "Wavelength (nm);AOI (deg);Is;Ic\n400;70;0,63;-0,11\n500;70;0,6;-0,2\n"))
    assert row(found, 0, "ncs_s", "ncs_c") == [0.63, -0.11]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_woollam_data(tmp_path: Path, encoding: str) -> None:
    found = open_file(written(tmp_path, WOOLLAM, encoding=encoding))
    assert row(found[0], 1, *BASIC, "psi_deg_error", "delta_deg_error") == [500, 65, 19.5, -3.5, 0.1, 0.2]
    assert [m.name for m in found] == ["", "dpole", "ur"]
    assert found[1].data["depolarisation"][0] == pytest.approx(0.015)
    assert row(found[2], 0, "reflectance", "angle_of_incidence_deg") == [0.35, 20.0]
    assert len(found[0].left_out) == 1  # pS


def test_complete_ease_dynamic_data_in_angstrom(tmp_path: Path) -> None:
    found = first(written(tmp_path, EASE))
    assert row(found, 1, *BASIC, "time") == [400.0, 65.0, 20.6, 170.5, 1.5]


@pytest.mark.parametrize("head", ["nm\taoi\tPsi\tDelta\n\n", "nm AOI\tPsi\tDelta\n", ".\\map\nnm\t\tPsi\tDelta\n", ""])
def test_text_exports(tmp_path: Path, head: str) -> None:
    rows = "".join(f"{w}\t{a}\t{30 - a / 10}\t{188 - a}\n" for a in (40, 50) for w in (400, 500))
    found = first(written(tmp_path, head + rows))
    assert row(found, 3, *BASIC) == [500.0, 50.0, 25.0, 138.0]


def test_trig_is_tan_psi_and_cos_delta(tmp_path: Path) -> None:
    found = first(written(tmp_path, "nm TRIG\n400\t65\t0.5\t-0.5\n500\t65\t1.0\t0.25\n"))
    assert row(found, 0, "psi_deg", "delta_deg") == pytest.approx([np.degrees(np.arctan(0.5)), 120.0])
    assert "delta_sign" in found.metadata


def test_spectraray_pairs_stand_angle_by_angle(tmp_path: Path) -> None:
    text = "; WAVELENGTH 50.0 50.0 60.0 60.0\n400 1 2 3 4\n500 5 6 7 8\n"
    found = first(written(tmp_path, text))
    assert found.data["angle_of_incidence_deg"].tolist() == [50, 50, 60, 60]
    assert found.data["psi_deg"].tolist() == [1, 5, 3, 7]


def test_spectraray_sixteen_columns_are_a_mueller_matrix(tmp_path: Path) -> None:
    values = " ".join(f"{1 - i / 32:.5f}" for i in range(16))
    found = first(written(tmp_path, f"; WAVELENGTH {'70 ' * 16}\n400 {values}\n"))
    assert row(found, 0, "m12", "m43") == [1 - 1 / 32, 1 - 14 / 32]
    with pytest.raises(NacreError):
        open_file(written(tmp_path, "; WAVELENGTH 70 70 70\n400 1 2 3\n"))


def test_accurion_averages_the_zones(tmp_path: Path) -> None:
    found = first(written(tmp_path, ACCURION))
    assert row(found, 0, *BASIC) == [658.0, 50.0, 31.5, 170.5]
    assert len(found.data["psi_deg"]) == 1


def test_places_of_accurion_are_data_sets_of_their_own(tmp_path: Path) -> None:
    rows = "".join(
        f"658.0\t{angle}\t{170 - place}\t{30 + place}\t{0.01 * angle}\t{5.0 * place}\n"
        for place in (0, 1)
        for angle in (50, 52)
    )
    found = open_file(written(tmp_path, f"#Lambda\tAOI\tDelta\tPsi\tX_pos\tY_pos\n#nm\tdeg\tdeg\tdeg\tmm\tmm\n{rows}"))
    assert [m.data["psi_deg"].tolist() for m in found] == [[30.0, 30.0], [31.0, 31.0]]
    assert len({m.name for m in found}) == 2


def test_angles_in_the_headings_of_a_table_stand_one_after_another(tmp_path: Path) -> None:
    heading = "Wavelength (nm),Psi (65\u00b0),Delta (65\u00b0),Psi (70\u00b0),Delta (70\u00b0)\n"
    text = heading + "400,20,150,15,140\n500,21,155,16,145\n"
    found = first(written(tmp_path, text, "t.csv"))
    assert row(found, 2, *BASIC) == [400.0, 70.0, 15.0, 140.0]


def test_film_sense(tmp_path: Path) -> None:
    found = first(written(tmp_path, FILM_SENSE))
    assert row(found, 0, "angle_of_incidence_deg", "ncs_n", "ncs_c", "ncs_s") == [65.01, 0.6, -0.7, 0.3]
    with pytest.raises(AmbiguousFileError) as failure:
        open_file(written(tmp_path, DYNAMIC))
    assert failure.value.option == "angle_deg"
    found = first(written(tmp_path, DYNAMIC), angle_deg=65.0)
    assert row(found, 3, "wavelength_nm", "time_s", "ncs_n") == [635.0, 1.5, 0.71]


def test_horiba(tmp_path: Path) -> None:
    found = first(written(tmp_path, HORIBA, "h.spe"))
    assert row(found, 0, *BASIC) == [400.0, 70.0, 20.5, 170.25]


def test_regress_pro(tmp_path: Path) -> None:
    found = first(written(tmp_path, "SE PSI DELTA\nAOI 75\nSE 400 0.5 -0.5\nSE 410 2.0 0.5\n"))
    assert row(found, 1, "psi_deg", "delta_deg") == pytest.approx([np.degrees(np.arctan(2.0)), 60.0])
    psi, delta, a = np.radians(30.0), np.radians(110.0), np.radians(33.0)
    t, u = np.tan(psi) ** 2, np.tan(a) ** 2
    alpha, beta = (t - u) / (t + u), 2 * np.tan(psi) * np.tan(a) * np.cos(delta) / (t + u)
    found = first(written(tmp_path, f"SE ALPHA BETA\nAOI 75\nA 33\nSE 400 {float(alpha)} {float(beta)}\n"))
    assert row(found, 0, "psi_deg", "delta_deg") == pytest.approx([30.0, 110.0])


@pytest.mark.parametrize("draft", ["older", "later"])
def test_nexus(tmp_path: Path, draft: str) -> None:
    path = tmp_path / "file.nxs"
    table = np.arange(12.0).reshape(2, 2, 3)
    with h5py.File(path, "w") as file:
        entry = file.create_group("entry")
        entry["instrument/angle_of_incidence"] = [50, 60]
        group, waves = ("sample", "instrument/spectrometer/wavelength") if draft == "older" else (
            "data_collection", "data_collection/wavelength_spectrum",
        )  # fmt: skip
        entry[waves] = [4000.0, 5000.0, 6000.0]
        entry[f"{group}/data_type"] = "psi/delta" if draft == "older" else "Psi/Delta"
        entry[f"{group}/measured_data"] = table[None, None] if draft == "older" else table
        entry[f"{group}/column_names"] = ["psi", "delta"] if draft == "older" else ["delta", "psi"]
    expected = [500.0, 60.0, 7.0, 10.0]
    assert row(first(path), 4, *BASIC) == (expected if draft == "older" else [*expected[:2], 10.0, 7.0])


@pytest.mark.parametrize(
    "text",
    [
        f"; WAVELENGTH {'70 ' * 16}\n400 0.5 1.0 {'0.1 ' * 14}\n",  # m12 above m11
        WOOLLAM.replace("nm\n", "eV\n"),  # 3 nm
        WOOLLAM.replace("20.5", "120.5"),  # Psi above 90
        WOOLLAM.replace("500.0\t65.0\t19.5\t-3.5\t0.1\t0.2", "500.0\t65.0\t19"),  # truncated
        FILM_SENSE.replace("0.6\t", "1.6\t"),
        ACCURION.replace("#nm\tnm\tdeg", "#nm\tnm\trad"),
        "SE PSI DELTA\nAOI 75\nSE 400 0.5 -1.5\n",
    ],
)
def test_impossible_values_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(NacreError):
        open_file(written(tmp_path, text))


@pytest.mark.parametrize("entry", json.loads((SHARED / "index.json").read_text()) if SHARED.exists() else [{}])
def test_the_shared_files_are_read_rightly(entry: dict[str, Any]) -> None:
    if not entry:
        pytest.skip("the shared reference data are not here")
    found, right = first(SHARED / entry["file"]), entry["right_reading"]
    for sample in right.get("samples", []):
        delta = sample.get("delta_deg", sample.get("delta_deg_up_to_sign"))
        expected = [sample["x"], sample.get("aoi_deg"), sample["psi_deg"], delta]
        got = row(found, sample["row"], *BASIC)
        np.testing.assert_allclose(got, [got[1] if e is None else e for e in expected], rtol=DIGITS)
    for i, sample in enumerate(right.get("mean_of_zones_1_to_4", [])):
        expected = [sample["aoi_deg"], sample["psi_deg"], sample["delta_deg"]]
        np.testing.assert_allclose(row(found, i, *BASIC[1:]), expected, rtol=5e-6)  # 6 digits
    if "elements" in right:
        for name, value in zip(right["elements"], right["middle"]["m"]):
            assert found.data[name][right["middle"]["row"]] == value
    assert len(found.data["wavelength_nm"]) == right.get("rows", right.get("points"))
