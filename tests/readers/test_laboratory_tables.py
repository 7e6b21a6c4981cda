"""Text tables: random ones of known contents, the vocabulary of headings in each reader, and what nacre writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from laboratory_tables import VALUES, WAVELENGTHS, as_read, in_unit, is_right, laboratory_table

import nacre
from nacre.analysis.fit import read_measurement
from nacre.bsdf.substrate import SubstrateSpec
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.matter.indices.library import index
from nacre.optimise.task import read_task
from nacre.readers.columns import load_tables
from nacre.readers.curves import Q_PER_UM, SHARE, STRUCTURE, THICKNESS_NM, X_UM, Y_UM, Axis, curve, spectrum
from nacre.readers.headings import ERROR_WORDS, WORDS, meanings
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.readers.registry import open_file
from nacre.readers.text_table import decode, number
from nacre.readers.units import parse_unit, spectral_units
from nacre.recipe.model import RecipeContext, validate
from nacre.recipe.toml import dump_toml

LEAST_READ = 0.6  # of the generated tables; the others lack headings or units, or have unknown columns
NM = np.array([400.0, 500.0, 700.0])


def counts(tables: int, seed: int, folder: Path) -> dict[str, int]:
    found = {"right": 0, "refused": 0, "wrong": 0}
    for number_of in range(tables):
        table = laboratory_table(np.random.default_rng([seed, number_of]))
        try:
            result = as_read(table, folder / "table.csv")
        except NacreError as error:
            assert "\n" not in str(error)
            found["refused"] += 1
            continue
        found["right" if is_right(table, result) else "wrong"] += 1
    return found


def test_random_tables_are_read_rightly_or_refused(tmp_path: Path) -> None:
    found = counts(300, 1, tmp_path)
    assert found["wrong"] == 0 and found["right"] > LEAST_READ * 300, found


@pytest.mark.full
def test_five_thousand_random_tables_are_read_rightly_or_refused(tmp_path: Path) -> None:
    found = counts(5000, 2, tmp_path)
    assert found["wrong"] == 0 and found["right"] > LEAST_READ * 5000, found


def test_every_spelling_of_a_spectral_heading_is_read_by_every_reader_of_spectra(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    for unit, headings in WAVELENGTHS.items():
        for heading in headings:
            rows = [f"{x:.9g};0.2" for x in in_unit(NM, unit)]
            for value, read in (("n", "constants"), ("R", "fit"), ("albedo", "albedo")):
                path.write_text("\n".join([f'"{heading}";{value}', *rows]), encoding="utf-8")
                if read == "constants":
                    found = open_file(path, ReadOptions(expects="constants"))[0].data["wavelength_nm"]
                elif read == "fit":
                    found = read_measurement(path).wavelengths_nm
                else:
                    found = spectrum(path, ("albedo",))[0]
                np.testing.assert_allclose(found, NM, rtol=1e-8, err_msg=f"{heading} {read}")


def test_every_spelling_of_a_value_is_read(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    partners = {"k": "n", "eps1": "eps2", "eps2": "eps1", "alpha": "n"}
    for quantity, headings in VALUES.items():
        for heading in headings:
            if quantity in ("error", "angle"):
                value = "0.01" if quantity == "error" else "45"
                path.write_text(f"nm;R;{heading}\n400;0.2;{value}\n700;0.3;{value}\n", encoding="utf-8")
                found = read_measurement(path)
                if quantity == "error":
                    assert found.errors is not None and found.errors.tolist() == [[[0.01, 0.01]]], heading
                else:
                    assert found.angles_deg is not None and found.angles_deg.tolist() == [45.0], heading
                continue
            if quantity[0] in "RT":
                share = 100 if quantity.endswith("%") else 1
                path.write_text(f"nm;{heading}\n400;{0.2 * share}\n700;{0.3 * share}\n", encoding="utf-8")
                np.testing.assert_allclose(read_measurement(path).values[0, 0], [0.2, 0.3], err_msg=heading)
                continue
            beside = f";{partners[quantity]}" if quantity in partners else ""
            cell = ";1.5" if beside else ""
            path.write_text(f"nm;{heading}{beside}\n400;2{cell}\n700;2{cell}\n", encoding="utf-8")
            data = open_file(path, ReadOptions(expects="constants"))[0].data
            wanted = {
                "n": 2 + 0j, "k": 1.5 + 2j, "eps1": np.sqrt(2 + 1.5j), "eps2": np.sqrt(1.5 + 2j),
                "alpha": 1.5 + 1j * 2 * 400e-7 / (4 * np.pi),
            }[quantity]  # fmt: skip
            assert data["n"][0] + 1j * data["k"][0] == pytest.approx(wanted), heading


def test_every_word_of_the_vocabulary_has_its_meaning() -> None:
    for quantity, words in WORDS.items():
        for word in words.split():
            if len(word) > 1:
                assert quantity in {meaning.quantity for meaning in meanings(word)} | {""}, (quantity, word)
    for word in ERROR_WORDS:
        assert any(meaning.is_error for meaning in meanings(f"R_{word}")), word


HEADINGS = {
    "R_s (60°)": {"quantity": "reflectance", "polarisation": "s", "angle_deg": 60.0},
    "R (%) p-pol": {"quantity": "reflectance", "unit": "%", "polarisation": "p"},
    "TM transmittance": {"quantity": "transmittance", "polarisation": "p"},
    "sigma(R)": {"quantity": "reflectance", "is_error": True},
    "Specular reflectance (%)": {"quantity": "reflectance", "mode": "specular", "unit": "%"},
    "R (SCI)": {"quantity": "reflectance", "mode": "total"},
    "L*(D50/2°)": {"quantity": "L", "illuminant": "D50", "observer": "2"},
    "a*(15°)": {"quantity": "a", "angle_deg": 15.0},
    "L (Hunter)": {"quantity": "hunter_L"},
    "angle (rad)": {"quantity": "angle_of_incidence", "unit": "rad"},
    "ω (rad/s)": {"quantity": "angular_frequency", "unit": "rad/s"},
    "ħω (eV)": {"quantity": "energy", "unit": "eV"},
    "X (px)": {"quantity": "x", "unit": "px"},
    "-k": {"quantity": "k", "is_negated": True},
    "Refractive index (imaginary part)": {"quantity": "k"},
}


@pytest.mark.parametrize("heading", HEADINGS)
def test_a_heading_states_more_than_its_quantity(heading: str) -> None:
    wanted = HEADINGS[heading]
    assert any(all(getattr(m, name) == value for name, value in wanted.items()) for m in meanings(heading))


@pytest.mark.parametrize("heading", ["Batch", "R (sample A)", "rs", "Wavelength (eV)", "n (589 nm)", "", "R (T)"])
def test_what_is_not_in_the_vocabulary_has_no_meaning(heading: str) -> None:
    assert meanings(heading) == ()


UNKNOWN = {
    "unknown": ("nm,n,k,batch\n400,1.5,0,7\n", "ignore"),
    "no heading in a fit": ("400,0.2\n500,0.3\n600,0.1\n", "quantity"),
    "nm under um": ("wavelength_nm,R\n0.4,0.1\n0.7,0.2\n", "unit"),
    "um under nm": ("wavelength_um,R\n400,0.1\n700,0.2\n", "unit"),
    "wavelength without a unit": ("lambda,R\n2000,0.1\n10000,0.2\n", "unit"),
    "radians": ("nm,theta,R\n400,0.785,0.1\n700,0.785,0.2\n", "columns"),
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_what_the_file_does_not_state_is_asked_by_the_option_that_decides(case: str, tmp_path: Path) -> None:
    text, option = UNKNOWN[case]
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(AmbiguousFileError) as asked:
        if ",n," in text:
            open_file(tmp_path / "t.csv", ReadOptions(expects="constants"))
        else:
            read_measurement(tmp_path / "t.csv")
    assert asked.value.option == option and "\n" not in str(asked.value)


def test_an_unknown_column_is_ignored_or_named_by_the_user(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("nm,n,k,batch\n400,1.5,0.1,7\n800,1.5,0.1,7\n")
    for options in (ReadOptions(ignore=("batch",)), ReadOptions(columns=("wavelength_nm", "n", "k", "-"))):
        data = open_file(tmp_path / "t.csv", options)[0].data
        assert data["k"].tolist() == [0.1, 0.1]
    with pytest.raises(NacreError):
        open_file(tmp_path / "t.csv", ReadOptions(ignore=("lot",)))


def test_the_unit_stated_by_the_user_decides(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("0.3 0.5\n6 0.4\n")
    options = ReadOptions(expects="constants", unit="um")
    assert open_file(tmp_path / "t.csv", options)[0].data["wavelength_nm"].tolist() == [300.0, 6000.0]


@pytest.mark.parametrize(
    ("cell", "value"),
    [("1.0D-3", 1e-3), ("1,5", 1.5), ("1'234.5", 1234.5), ("−2", -2.0), (".5", 0.5), ("1.5E+03", 1500.0)],
)
def test_numbers_of_all_countries(cell: str, value: float) -> None:
    assert number(cell) == value


def test_cells_without_a_number() -> None:
    assert all(np.isnan(number(cell) or 0.0) for cell in ("#N/A", "#DIV/0!", "n/a", "NaN", "--", ""))
    assert [number(cell) for cell in ("#1", "#7a3b2c", "x", "1_000", "1.2.3")] == [None] * 5


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_encodings(encoding: str) -> None:
    text = "Wellenlänge (µm);n\r\n0,4;1,5\r\n"
    assert decode(text.encode(encoding)) == text
    assert decode(b"name\0\0\0\0\r\n" + b"400 1.5\r\n" * 20).startswith("name\r\n")
    with pytest.raises(UnicodeDecodeError):
        decode(bytes(range(256)) * 8)


def test_units_and_readings_of_numbers_without_one() -> None:
    words = ["µm", "microns", "Å", "cm⁻¹", "1/cm", "THz", "eV", "%", "deg", "px"]
    assert [parse_unit(w) for w in words] == ["um", "um", "angstrom", "1/cm", "1/cm", "THz", "eV", "%", "deg", "px"]
    assert [parse_unit(word) for word in ("M", "MeV", "foo")] == [None, None, None]
    assert spectral_units(np.array([400.0, 700.0])) == ("nm",)
    assert spectral_units(np.array([0.3, 6.0])) == ("um", "eV")
    assert spectral_units(np.array([0.4, 25.0])) == ("um",)


def test_several_blocks_and_remarks(tmp_path: Path) -> None:
    text = "# first\nwl,n\n0.4,1.5\n0.8,1.7\n\nwl,k\n0.4,0.1\n# remark\n0.8,0.3\n# end\n"
    (tmp_path / "t.csv").write_text(text)
    assert [len(table.rows) for table in load_tables(tmp_path / "t.csv").tables] == [2, 2]


CURVES: dict[str, tuple[tuple[Axis, Axis], list[list[float]]]] = {
    "X (nm);Y (nm)\n1000;2000\n3000;4000\n": ((X_UM, Y_UM), [[1, 2], [3, 4]]),
    "particle,XM,YM\n1,1,2\n2,3,4\n": ((X_UM, Y_UM), [[1, 2], [3, 4]]),
    "x_um,y_um,radius_um\n1,2,0.1\n3,4,0.1\n": ((X_UM, Y_UM), [[1, 2], [3, 4]]),
    "1,2\n3,4\n": ((X_UM, Y_UM), [[1, 2], [3, 4]]),
    "no,q_per_um,S\n0,1,0.5\n1,2,0.6\n": ((Q_PER_UM, STRUCTURE), [[1, 0.5], [2, 0.6]]),
    "q (1/nm),S(q)\n0.001,0.5\n0.002,0.6\n": ((Q_PER_UM, STRUCTURE), [[1, 0.5], [2, 0.6]]),
    "thickness (um),share\n0.3,0.2\n0.4,0.8\n": ((THICKNESS_NM, SHARE), [[300, 0.2], [400, 0.8]]),
    "Dicke [nm];Anteil (%)\n300;20\n400;80\n": ((THICKNESS_NM, SHARE), [[300, 0.2], [400, 0.8]]),
}


@pytest.mark.parametrize("text", CURVES)
def test_curves_by_their_headings(text: str, tmp_path: Path) -> None:
    axes, wanted = CURVES[text]
    (tmp_path / "t.csv").write_text(text)
    np.testing.assert_allclose(curve(tmp_path / "t.csv", axes)[0], wanted)


@pytest.mark.parametrize("text", ["X (px),Y (px)\n1,2\n", "a1,b1\n1,2\n", "x,y,x\n1,2,3\n", "1,2,3\n4,5,6\n"])
def test_curves_that_state_something_else_are_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(NacreError):
        curve(tmp_path / "t.csv", (X_UM, Y_UM))


FILM = {
    "family": "film",
    "substrate": {"n": 3.9, "k": 0.02},
    "layers": [{"material": {"n": 1.46}, "thickness_nm": 333}],
}


@pytest.mark.parametrize("polarisation", ["s", "p", "both"])
@pytest.mark.parametrize("angles", ["0", "60", "0,45"])
def test_a_spectrum_that_nacre_writes_is_fitted_as_what_it_is(polarisation: str, angles: str, tmp_path: Path) -> None:
    (tmp_path / "film.toml").write_text(dump_toml(FILM))
    command = ["spectrum", str(tmp_path / "film.toml"), "--angles-deg", angles, "--polarisation", polarisation]
    assert run([*command, "--wavelengths-nm", "400:700:50", "-o", str(tmp_path / "m.csv")]) == 0
    measured = read_measurement(tmp_path / "m.csv")
    model = measured.model(nacre.load(tmp_path / "film.toml"), None, 0)
    np.testing.assert_allclose(model, measured.values, atol=1e-9)


def test_standard_errors_are_weights(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("nm,R,sigma\n400,0.1,0.01\n500,0.2,0.02\n600,0.3,0.04\n")
    measured = read_measurement(tmp_path / "m.csv")
    scale = measured.noise_scale("equal").ravel()
    np.testing.assert_allclose(scale / scale[0], [1, 2, 4])


def test_what_a_fit_assumes_is_stated(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("nm,R,temperature (K)\n400,0.1,300\n500,0.2,300\n")
    remarks = " ".join(read_measurement(tmp_path / "m.csv").remarks)
    assert "normal incidence" in remarks and "specular" in remarks and "temperature (K)" in remarks


@pytest.mark.parametrize("polarisation", ["s", "both"])
def test_a_tidy_table_states_what_its_measurement_states(polarisation: str, tmp_path: Path) -> None:
    (tmp_path / "film.toml").write_text(dump_toml(FILM))
    command = ["spectrum", str(tmp_path / "film.toml"), "--angles-deg", "60", "--polarisation", polarisation]
    assert run([*command, "--wavelengths-nm", "400:700:50", "-o", str(tmp_path / "m.csv")]) == 0
    assert run(["read", str(tmp_path / "m.csv"), "-o", str(tmp_path / "tidy.csv")]) == 0
    first, again = (read_measurement(tmp_path / name) for name in ("m.csv", "tidy.csv"))
    assert first.parts == again.parts
    np.testing.assert_allclose(again.values, first.values, rtol=1e-8)


def test_ellipsometry_that_nacre_writes_is_read_by_the_fit(tmp_path: Path) -> None:
    (tmp_path / "film.toml").write_text(dump_toml(FILM))
    command = ["ellipsometry", str(tmp_path / "film.toml"), "--angles-deg", "65,75", "--wavelengths-nm", "400:700:50"]
    assert run([*command, "-o", str(tmp_path / "e.csv")]) == 0
    measured = read_measurement(tmp_path / "e.csv")
    model = measured.model(nacre.load(tmp_path / "film.toml"), None, 0)
    np.testing.assert_allclose(model, measured.values, atol=1e-7)


def test_points_that_nacre_writes_come_back(tmp_path: Path) -> None:
    from nacre.formats.layouts import write_points_csv

    xy = np.array([[0.5, 1.25], [2.0, 3.5], [4.0, 0.75]])
    write_points_csv(tmp_path / "p.csv", xy, np.full(3, 0.1))
    np.testing.assert_allclose(curve(tmp_path / "p.csv", (X_UM, Y_UM))[0], xy, atol=1e-4)


def test_a_wrong_unit_of_constants_is_named_and_no_extrapolation_advised(tmp_path: Path) -> None:
    (tmp_path / "nk.csv").write_text("wavelength_nm,n\n40,1.5\n105,1.5\n")
    film = nacre.material({"family": "film", "substrate": {"file": "nk.csv"}, "layers": []}, tmp_path)
    with pytest.raises(NacreError) as error:
        film.spectrum([0.0], [400.0, 700.0])
    assert "edge" not in str(error.value)


def test_the_table_of_a_batch_of_designs_is_a_list_of_its_colours(tmp_path: Path) -> None:
    from nacre.optimise.colour_list import read_colours

    (tmp_path / "many.csv").write_text(
        "name,folder,L,a,b,reached_L,reached_a,reached_b,de00,geometry,lamp,met,total_nm,layers\n"
        "#1,1,52.000,-30.000,28.000,52.008,-29.994,27.991,0.0088,specular 0,D65,yes,246.09,Cr 6.81 | SiO2 83.61\n"
    )
    (row,) = read_colours(tmp_path / "many.csv", 1)
    assert row.name == "#1" and row.lab.tolist() == [[52.0, -30.0, 28.0]]


@pytest.mark.parametrize("template", ["Rs_{0},Rp_{0}", "Rs({0}),Rp({0})", "R_s {0},R_p {0}"])
def test_an_angle_behind_a_polarisation_is_an_angle(tmp_path: Path, template: str) -> None:
    path = tmp_path / "t.csv"
    rows = "400,0.10,0.05\n500,0.11,0.06\n600,0.12,0.07\n"
    path.write_text(f"Wavelength (nm),{template.format(45)}\n{rows}")
    s, p = open_file(path)
    assert [s.metadata["polarisation"], p.metadata["polarisation"]] == ["s", "p"]
    assert s.metadata["angle_of_incidence_deg"] == p.metadata["angle_of_incidence_deg"] == 45.0


@pytest.mark.parametrize("encoding", ["utf-8", "shift_jis", "utf-16"])
def test_japanese_headings_are_read_in_their_encodings(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes("波長(nm),反射率(%)\n400,10\n500,11\n600,12\n700,13\n".encode(encoding))
    (found,) = open_file(path)
    np.testing.assert_allclose(found.data["reflectance"], [0.10, 0.11, 0.12, 0.13])
    path.write_bytes("波長,屈折率,消衰係数\n400,1.5,0.1\n500,1.5,0.1\n600,1.4,0.1\n700,1.3,0.1\n".encode(encoding))
    (found,) = open_file(path)
    assert found.kind == "constants" and found.data["k"][0] == 0.1


def test_a_file_in_a_recipe_may_state_its_unit_and_columns(tmp_path: Path) -> None:
    """A base of a measured albedo: a bare table in um with a column of no use, or with an unknown heading."""
    rows = [(nm, 0.2 + nm / 2000) for nm in range(360, 840, 10)]
    (tmp_path / "um.csv").write_text("".join(f"{nm / 1000},{value},7\n" for nm, value in rows))
    (tmp_path / "named.csv").write_text("nm,albedo,batch\n" + "".join(f"{nm},{value},7\n" for nm, value in rows))
    context, medium = RecipeContext("r.toml", tmp_path), index("glass")

    def albedo(**table: Any) -> Any:
        return validate(SubstrateSpec, {"albedo": table}, context).build(context, medium).albedo

    stated = {"file": "um.csv", "columns": ["wavelength_um", "albedo", "-"]}
    for table in (stated, {"file": "named.csv", "ignore": ["batch"]}):
        np.testing.assert_allclose(np.transpose(albedo(**table)), rows, rtol=1e-6)
    for wrong in ({"file": "named.csv", "ignore": ["other"]}, {"file": "um.csv"}, {"file": "um.csv", "units": "um"}):
        with pytest.raises(NacreError):
            albedo(**wrong)


def test_a_target_spectrum_may_leave_out_a_column(tmp_path: Path) -> None:
    rows = "".join(f"{nm},{nm / 1000},{1 - nm / 1000}\n" for nm in range(400, 710, 10))
    (tmp_path / "card.csv").write_text("wavelength (nm),batch,R\n" + rows)
    recipe = {"family": "film", "substrate": "glass", "layers": [{"material": "TiO2", "thickness_nm": 100}]}
    target = {"geometry": "specular 0", "spectrum": {"file": str(tmp_path / "card.csv"), "ignore": ["batch"]}}
    data = {"recipe": recipe, "parameters": {"layers[0].thickness_nm": [10, 200]}, "target": [target]}
    found = read_task(data).targets[0].spectrum
    assert found is not None
    np.testing.assert_allclose(found[1], 1 - found[0] / 1000, atol=1e-6)
