"""How a recipe may write a material: every form, its values, and one clear line for every fault."""

import subprocess
import sys

import numpy as np
import pytest

from nacre.core.errors import NacreError, RecipeError
from nacre.matter.indices.library import index
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import RecipeContext, RecipeModel, validate


class OneLayer(RecipeModel):
    material: IndexSpec


class Film(RecipeModel):
    layers: tuple[OneLayer, ...]


def check(material, folder="."):
    from pathlib import Path

    context = RecipeContext(source="morpho.toml", folder=Path(folder))
    film = validate(Film, {"layers": [{"material": "Ag"}, {"material": "Si"}, {"material": material}]}, context)
    return film.layers[2].material.build(context)


@pytest.mark.parametrize("material, nm, expected", [
    ("SiO2", 587.6, 1.4585),
    (1.5, 400, 1.5),
    ({"n": 1.5}, 400, 1.5),
    ({"n": 1.5, "k": 0.1}, 400, 1.5 + 0.1j),
    ({"n": 0, "k": 3}, 400, 3j),
    ({"name": "SiO2"}, 587.6, 1.4585),
    ({"cauchy": [1.5, 0.005, 0.0001]}, 500, 1.5 + 0.005 / 0.25 + 0.0001 / 0.0625),
    # fused silica, Malitson 1965, as its published Sellmeier coefficients b, c with c = squares of the resonances
    ({"sellmeier": [0.6961663, 0.0684043**2, 0.4079426, 0.1162414**2, 0.8974794, 9.896161**2]}, 587.6, 1.4585),
    ({"n_d": 1.5168, "abbe": 64.17}, 486.1, 1.5224),
    ({"drude": {"plasma_ev": 9.0}}, 400, 1j * np.sqrt(81 / 3.0996049607**2 - 1)),
    ({"rii": "main/Ag/Johnson"}, 616.8, 0.06 + 4.152j),
])  # fmt: skip
def test_every_form_gives_its_index(material, nm, expected):
    assert check(material).n_complex([nm])[0] == pytest.approx(expected, abs=2e-4)


def test_drude_and_lorentz_absorb_and_add():
    drude = {"plasma_ev": 8.0, "damping_ev": 0.1, "eps_inf": 4.0}
    lorentz = {"oscillators": [{"strength": 2.0, "resonance_ev": 3.5, "damping_ev": 0.4}]}
    nm = np.linspace(360, 830, 100)
    energy = 1239.8419843320026 / nm
    carriers = -64 / (energy**2 + 0.1j * energy)
    bound = 2 * 3.5**2 / (3.5**2 - energy**2 - 0.4j * energy)
    for spec, eps in (({"drude": drude}, 4 + carriers), ({"lorentz": lorentz}, 1 + bound),
                      ({"drude": drude, "lorentz": lorentz}, 4 + carriers + bound)):  # fmt: skip
        values = check(spec).n_complex(nm)
        np.testing.assert_allclose(values**2, eps, rtol=1e-12)
        assert (values.imag > 0).all()


@pytest.mark.parametrize("material, line", [
    ("own.csv", 'layers[2].material = "own.csv" is the name of a file, not of a material; '
                'write {file = "own.csv"} in its place'),
    ("a/b/own.TXT", 'layers[2].material = "a/b/own.TXT" is the name of a file, not of a material; '
                    'write {file = "a/b/own.TXT"} in its place'),
    ("TiO3", 'layers[2].material = "TiO3" is not known. Did you mean "TiO2"? List: nacre indices search Ti'),
    ("GaAs", 'layers[2].material = "GaAs" has no default entry. Choose one for {rii = ...}: nacre indices search GaAs'),
    ({"n": 1.5, "k": -0.1}, "layers[2].material.k = -0.1 is not allowed; nacre takes n + ik with k >= 0"),
    ({"n": -1}, "layers[2].material.n = -1 is not allowed"),
    ({"n": 0}, "n = 0"),
    ({"rii": "main/Ag/Jonson"}, 'layers[2].material.rii = "main/Ag/Jonson": is not in the refractiveindex.info '
                                'database. Did you mean "main/Ag/Johnson"?'),
    ({"file": "none.csv"}, 'layers[2].material.file = "none.csv": does not exist'),
    ({"cauchy": [1.5, 8800]}, "for the wavelength in um"),
    ({"cauchy": []}, "layers[2].material.cauchy = [] is not allowed; it should have at least 1 entry"),
    ({"sellmeier": [1, 2, 3]}, "pairs"),
    ({"sellmeier": [-5, 0.01]}, "no usable refractive index"),
    ({"n_d": 1.5}, "both n_d and abbe"),
    ({"n": 1.5, "name": "Ag"}, "gives name and n"),
    ({}, "gives nothing"),
    ([1, 2], "is not a material"),
    (True, "is not a material"),
    ({"nn": 1.5}, 'Did you mean "n"'),
    ({"n": "x"}, "layers[2].material.n"),
    ({"n": float("nan")}, "finite"),
    ({"drude": {"plasma_ev": -9}}, "layers[2].material.drude.plasma_ev = -9 is not allowed"),
    ({"lorentz": {"oscillators": []}}, "oscillators"),
    ({"name": "Ag", "extrapolate": "edg"}, '"error" or "edge"'),
    ({"k": 0.1}, "exactly one"),
    ({"cauchy": [1.5], "k": 0.1}, ".k = 0.1 needs n"),
])  # fmt: skip
def test_every_fault_is_one_line_with_file_and_key(material, line):
    with pytest.raises(RecipeError) as error:
        check(material)
    text = str(error.value)
    assert text.startswith("morpho.toml: ") and line in text and "\n" not in text


EV_NM = 6.62607015e-34 * 299792458 / 1.602176634e-19 * 1e9  # h c / e
CSV = {
    "comma": "wavelength_nm,n,k\n400,1.5,0.1\n800,1.7,0.3\n",
    "um": "# measured\nwavelength_um;n;k\n0.8;1.7;0.3\n0.4;1.5;0.1\n",
    "tabs": "k\twavelength_nm\tn\n0.1\t400\t1.5\n0.3\t800\t1.7\n",
    "bare nm": "400 1.5 0.1\n800 1.7 0.3\n",
    "bare um": "0.4, 1.5, 0.1\n0.8, 1.7, 0.3\n",
    "database export": "wl,n\n0.4,1.5\n0.8,1.7\nwl,k\n0.4,0.1\n0.8,0.3\n",
    "decimal commas": "Wavelength (nm);n;k\n400,0;1,5;0,1\n800,0;1,7;0,3\n",
    "bare decimal commas": "400;1,5;0,1\n800;1,7;0,3\n",
    "decimal commas and blanks": "400 1,5 0,1\n800 1,7 0,3\n",
    "unit apart": "Wavelength [nm] n k\n400 1.5 0.1\n800 1.7 0.3\n",
    "heading parted otherwise": "wavelength_nm n k\n400,1.5,0.1\n800,1.7,0.3\n",
    "unit by size": "Lambda,n,k\n0.4,1.5,0.1\n0.8,1.7,0.3\n",
    "extra column": "nm,n,error,k\n400,1.5,9,0.1\n800,1.7,9,0.3\n",
    "database heading in nm": "wl,n,k\n400,1.5,0.1\n800,1.7,0.3\n",
    "database heading with its unit": "WL (um),n,k\n0.4,1.5,0.1\n0.8,1.7,0.3\n",
    "angstrom": "Wavelength (Å);n;k\n4000;1,5;0,1\n8000;1,7;0,3\n",
    "electron volt": f"E [eV]\tn\tk\n{EV_NM / 800:.17g}\t1.7\t0.3\n{EV_NM / 400:.17g}\t1.5\t0.1\n",
    "energy": f"energy_eV,n,k\n{EV_NM / 800:.17g},1.7,0.3\n{EV_NM / 400:.17g},1.5,0.1\n",
    "remarks of other programs": "% my oxide\n! measured\nwavelength_nm,n,k\n400,1.5,0.1 # first\n800,1.7,0.3\n",
}


@pytest.mark.parametrize("form", CSV)
def test_a_table_is_read_in_every_usual_layout(form, tmp_path):
    (tmp_path / "nk.csv").write_text(CSV[form])
    constant = check({"file": "nk.csv"}, tmp_path)
    np.testing.assert_allclose(constant.n_complex([400, 600, 800]), [1.5 + 0.1j, 1.6 + 0.2j, 1.7 + 0.3j], atol=1e-12)
    assert constant.range_nm == pytest.approx((400, 800))
    with pytest.raises(NacreError, match="nk.csv"):
        constant.n_complex([399])


def test_decimal_commas_of_n_alone_are_no_second_column(tmp_path):
    # read as commas between columns, these were n = 1 and k = 5
    (tmp_path / "nk.csv").write_text("400;1,5\n800;1,5\n")
    assert check({"file": "nk.csv"}, tmp_path).n_complex([600]) == 1.5


def test_a_table_in_the_text_of_windows_is_read(tmp_path):
    text = "Wavelength (µm);n\n0,4;1,5\n0,8;1,7\n"
    for encoding in ("cp1252", "utf-8-sig", "utf-16"):
        (tmp_path / "nk.csv").write_bytes(text.encode(encoding))
        np.testing.assert_allclose(check({"file": "nk.csv"}, tmp_path).n_complex([600]), 1.6)


PAGES = {
    "tabulated nk": ("tabulated nk\n    data: |\n        0.4 1.5 0.1\n        0.8 1.7 0.3\n", 1.6 + 0.2j),
    "tabulated n": ("tabulated n\n    data: |\n        0.4 1.5\n        0.8 1.7\n", 1.6),
    "n and k": (
        "formula 5\n    wavelength_range: 0.3 1.0\n    coefficients: 1.5 0.036 -2\n"
        "  - type: tabulated k\n    data: |\n        0.4 0.1\n        0.8 0.3\n",
        1.6 + 0.2j,
    ),
}


@pytest.mark.parametrize("form", PAGES)
def test_a_page_of_the_database_is_read_as_a_file_of_ones_own(form, tmp_path):
    data, wanted = PAGES[form]
    (tmp_path / "mine.yml").write_text(f'REFERENCES: "mine"\nDATA:\n  - type: {data}')
    np.testing.assert_allclose(check({"file": "mine.yml"}, tmp_path).n_complex([600]), wanted)


def test_a_page_from_the_package_is_the_entry_itself(tmp_path):
    from nacre.matter.indices.database import database_folder, find_page

    key, waves = "specs/SCHOTT-optical/N-BK7", np.linspace(400, 700, 7)
    page = database_folder() / "data" / find_page(key).file
    (tmp_path / "glass.yml").write_bytes(page.read_bytes())
    np.testing.assert_array_equal(
        check({"file": "glass.yml"}, tmp_path).n_complex(waves), check({"rii": key}, tmp_path).n_complex(waves)
    )


@pytest.mark.parametrize("data", [
    "tabulated k\n    data: |\n        0.4 0.1\n        0.8 0.3\n",
    "formula 12\n    range: 0.3 1.0\n    coefficients: 1.5 0 0\n",
    "formula 9\n    range: 0.3 1.0\n    coefficients: 1.5\n",
    "tabulated nk\n    data: |\n        0.4 1.5 x\n",
    "tabulated nk\n    data: {a: 1}\n",
    "[",
])  # fmt: skip
def test_a_broken_page_is_reported_in_a_line(data, tmp_path):
    (tmp_path / "mine.yml").write_text(f"DATA:\n  - type: {data}")
    with pytest.raises(RecipeError, match="mine.yml") as raised:
        check({"file": "mine.yml"}, tmp_path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("text, words", [
    ("", "column n"),
    ("wavelength_nm,n\n", "no rows"),
    ("wavelength_nm,n\n400,-1.5\n", "line 2"),
    ("wavelength_nm,n,k\n400,1.5,-0.1\n", "k = -0.1"),
    ("wavelength_nm,n\n400,1.5\n400,1.6\n", "twice"),
    ("wavelength_nm,n\n400,1.5,3\n", "line 2"),
    ("wavelength_nm,n\n400,nan\n", "not finite"),
    ("wavelength_nm,n\n-400,1.5\n", "positive"),
    ("a,b,c\n400,1.5,3\n", "neither header nor row"),
    ("400\n500\n", "line 1"),
    ("wl,n\n0.4,1.5\nwl,k\n0.5,0.1\n", "different wavelengths"),
    ("\x00\x01", "nk.csv"),
])  # fmt: skip
def test_a_broken_table_is_reported_with_its_line(text, words, tmp_path):
    (tmp_path / "nk.csv").write_text(text)
    with pytest.raises(RecipeError) as error:
        check({"file": "nk.csv"}, tmp_path)
    assert words in str(error.value) and "nk.csv" in str(error.value) and "\n" not in str(error.value)


def test_a_binary_file_and_a_folder_are_no_tables(tmp_path):
    (tmp_path / "nk.csv").write_bytes(b"\xff\xfe\x80\x81")
    (tmp_path / "folder").mkdir()
    for name in ("nk.csv", "folder"):
        with pytest.raises(RecipeError, match=name):
            check({"file": name}, tmp_path)


def test_index_takes_numbers_and_tables_as_well():
    assert index(1.5).n_complex([500]) == 1.5
    assert index(0.2 + 3j).n_complex([500]) == 0.2 + 3j
    assert index({"n": 2, "k": 1}).n_complex([500]) == 2 + 1j
    assert index(index("Ag")) is index("Ag")
    for bad in (-1.5, 1.5 - 0.1j, 0):
        with pytest.raises(NacreError, match="not allowed"):
            index(bad)
    with pytest.raises(RecipeError, match='Did you mean "cauchy"'):
        index({"cauchi": [1.5]})


def test_indices_load_neither_scipy_nor_pandas():
    code = "import sys; from nacre.matter.indices.library import index; index('Ag').n_complex([500.0]);"
    code += "print([m for m in ('scipy', 'pandas', 'matplotlib', 'jax', 'numba') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_a_file_too_large_to_be_a_table_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "nk.csv").open("wb") as file:
        file.truncate(20_000_001)
    with pytest.raises(NacreError, match="is larger than 20 MB"):
        check({"file": "nk.csv"}, tmp_path)
