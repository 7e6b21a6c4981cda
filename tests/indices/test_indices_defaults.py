"""Each named material: known over 360-830 nm, and near values published elsewhere than in its own source."""

import numpy as np
import pytest

from nacre.core.errors import MaterialRangeError, UnknownMaterialError
from nacre.matter.indices.constant import DEFAULTS
from nacre.matter.indices.library import describe, index, search

ISSUE_NAMES = (
    "Ag Al Au Cr Cu Ti Ni W Si Ge SiO2 TiO2 Al2O3 MgF2 ZnS Si3N4 ITO Nb2O5 Ta2O5 HfO2 ZrO2 Fe2O3 mica cuticle water "
    "PET PMMA polyurethane polysilazane BK7 BiOCl air vacuum glass"
).split()

# (name, nm, n, k, tolerance): handbooks and papers other than the entry that the name stands for. Metals and
# semiconductors differ between samples by some per cent; glasses and crystals by parts in a thousand.
PUBLISHED = [
    ("SiO2", 587.6, 1.4585, 0, 5e-4),  # fused silica data sheets, n_d
    ("SiO2", 365.0, 1.4745, 0, 5e-4),  # the same, i line
    ("BK7", 587.6, 1.5168, 0, 1e-4),  # data sheet, n_d
    ("BK7", 486.1, 1.5224, 0, 1e-4),  # data sheet, n_F
    ("BK7", 365.0, 1.5363, 0, 2e-4),  # data sheet, n_i
    ("Al2O3", 589.3, 1.7681, 0, 5e-4),  # sapphire, n_o at the sodium line
    ("MgF2", 589.3, 1.3777, 0, 5e-4),  # n_o at the sodium line
    ("TiO2", 589.3, 2.613, 0, 4e-3),  # rutile, n_o, mineralogy handbooks 2.605-2.616
    ("TiO2", 436.0, 2.853, 0, 1e-2),  # rutile n_o at the mercury line
    ("ZnS", 589.3, 2.368, 0, 4e-3),  # sphalerite at the sodium line
    ("ZrO2", 587.6, 2.16, 0, 1.5e-2),  # cubic zirconia, gem handbooks 2.15-2.18
    ("water", 589.3, 1.3334, 0, 2e-4),  # IAPWS, 20 C, against vacuum
    ("water", 404.7, 1.3432, 0, 2e-4),
    ("PMMA", 589.3, 1.491, 0, 2e-3),  # data sheets, n_D
    ("polystyrene", 589.3, 1.590, 0, 3e-3),
    ("polycarbonate", 589.3, 1.585, 0, 3e-3),
    ("PET", 589.3, 1.575, 0, 1e-2),  # amorphous PET
    ("Si3N4", 632.8, 2.02, 0, 3e-2),  # stoichiometric nitride by ellipsometry, 2.00-2.05
    ("Nb2O5", 550.0, 2.35, 0, 5e-2),  # sputtered films 2.30-2.40
    ("Ta2O5", 550.0, 2.14, 0, 5e-2),  # films 2.09-2.18
    ("HfO2", 550.0, 1.92, 0, 6e-2),  # evaporated films 1.88-2.00
    ("mica", 589.3, 1.61, 0, 1e-2),
    ("ITO", 550.0, 1.87, 0.004, 6e-2),  # sputtered, 1.8-1.95
    ("Si", 632.8, 3.88, 0.019, 1.5e-2),  # ellipsometry's working value at the HeNe line: 3.882 + 0.019i
    ("Si", 413.3, 5.22, 0.27, 6e-2),
    ("Ge", 632.8, 5.5, 0.75, 0.15),
    ("Ag", 632.8, 0.06, 4.2, 0.15),  # handbooks: 0.065 + 3.9i ... 0.056 + 4.28i
    ("Au", 632.8, 0.19, 3.2, 0.25),  # 0.18 + 3.0i ... 0.18 + 3.4i
    ("Au", 450.0, 1.45, 1.9, 0.1),
    ("Cu", 632.8, 0.25, 3.4, 0.15),
    ("Al", 632.8, 1.37, 7.6, 0.15),
    ("Cr", 632.8, 3.14, 3.31, 0.2),
    ("Ti", 632.8, 2.7, 3.7, 0.2),
    ("Ni", 632.8, 1.98, 3.9, 0.3),
    ("W", 632.8, 3.65, 2.9, 0.2),
    ("Pt", 632.8, 2.33, 4.15, 0.3),
    ("Fe", 632.8, 2.88, 3.05, 0.3),
    ("Fe2O3", 587.6, 3.3206, 0.2192, 2e-3),  # Guillen et al. 2020, table A1
    ("Al", 587.6, 1.1978, 7.0488, 3e-3),  # the same table
]
# Normal reflectance of polished or evaporated metals in air, from tables of mirrors
REFLECTANCE = [
    ("Ag", 550, 0.975, 0.02), ("Al", 550, 0.915, 0.01), ("Au", 700, 0.97, 0.015), ("Au", 450, 0.385, 0.03),
    ("Cu", 700, 0.97, 0.02), ("Cr", 550, 0.55, 0.03), ("Ni", 550, 0.62, 0.04), ("W", 550, 0.49, 0.03),
    ("Pt", 550, 0.65, 0.06), ("Si", 550, 0.365, 0.01), ("Ge", 550, 0.52, 0.02), ("Ti", 550, 0.55, 0.06),
]  # fmt: skip


def test_every_name_of_the_issue_is_there():
    for name in ISSUE_NAMES:
        assert index(name).name == name
    assert index("soap film").n_complex([550.0]) == index("water").n_complex([550.0])


@pytest.mark.parametrize("name", [default.name for default in DEFAULTS])
def test_default_is_known_and_sane_from_360_to_830(name):
    values = index(name).n_complex(np.linspace(360.0, 830.0, 471))
    assert np.isfinite(values).all() and (values.imag >= 0).all()
    assert (values.real > 0.02).all() and (values.real < 7).all() and (values.imag < 9).all()
    if describe(name).splice:  # no splice may jump; rutile's own steepest nanometre is 0.011
        assert np.abs(np.diff(values)).max() < 0.012
    described = describe(name)
    assert described.source and described.title and described.is_default


@pytest.mark.parametrize("name, nm, n, k, tolerance", PUBLISHED)
def test_default_agrees_with_published_values(name, nm, n, k, tolerance):
    ours = index(name).n_complex([nm])[0]
    assert abs(ours.real - n) <= tolerance
    assert abs(ours.imag - k) <= tolerance


@pytest.mark.parametrize("name, nm, reflectance, tolerance", REFLECTANCE)
def test_default_gives_the_reflectance_of_the_mirror(name, nm, reflectance, tolerance):
    n = index(name).n_complex([nm])[0]
    assert abs(abs((n - 1) / (n + 1)) ** 2 - reflectance) <= tolerance


@pytest.mark.parametrize("default", [d for d in DEFAULTS if d.splice], ids=lambda d: d.name)
def test_what_was_added_to_published_data_is_said(default):
    assert describe(default.name).splice == default.splice
    published = default.source.split(" ")[0]
    if published.count("/") >= 2 and "k come from" not in default.splice:
        with pytest.raises(MaterialRangeError):  # the bare entry really ends short of 360 nm
            index(published).n_complex([360.0])


def test_splices_keep_to_the_entry_where_it_is_published():
    for name in ("TiO2", "ZnS", "ZrO2", "PET", "PMMA", "polystyrene", "polycarbonate"):
        entry = index(describe(name).source)
        low, high = entry.range_nm
        nm = np.linspace(low, min(high, 830.0), 200)
        np.testing.assert_array_equal(index(name).n_complex(nm), entry.n_complex(nm))


def test_abbe_numbers_come_back_out():
    for name, n_d, abbe in (("mica", 1.6137, 54.56), ("polyurethane", 1.5650, 24.37)):
        d, f, c = index(name).n_complex([587.5618, 486.1327, 656.2725]).real
        assert d == pytest.approx(n_d, abs=1e-9)
        assert (d - 1) / (f - c) == pytest.approx(abbe, rel=1e-9)
    d, f, c = index("TiO2").n_complex([587.5618, 486.1327, 656.2725]).real
    assert (d - 1) / (f - c) == pytest.approx(9.87, abs=0.02)  # Guillen et al., table A1


@pytest.mark.parametrize("alias, name", [("gold", "Au"), ("soap", "soap film"), ("sio2", "SiO2"), ("Aluminum", "Al"),
                                         ("H2O", "water"), ("hematite", "Fe2O3"), (" mica ", "mica")])  # fmt: skip
def test_aliases_and_capitals_reach_the_same_material(alias, name):
    assert index(alias) is not None and index(alias).name == name


def test_an_unknown_name_gets_the_nearest_one_and_the_way_to_more():
    with pytest.raises(UnknownMaterialError) as error:
        index("TiO3")
    assert str(error.value) == 'material "TiO3" is not known. Did you mean "TiO2"? List: nacre indices search Ti'
    with pytest.raises(UnknownMaterialError, match="nacre indices search GaAs"):
        index("GaAs")


def test_search_finds_defaults_first_and_symbols_by_their_capitals():
    names = [found.name for found in search("Ti")]
    assert names[0] == "Ti" and "TiO2" in names[:4] and "main/Ti/Johnson" in names
    assert not any("nitride" in found.title.lower() and "Ti" not in found.title + found.name for found in search("Ti"))
    assert [found.name for found in search("TiO2 Devore-o")] == ["TiO2", "main/TiO2/Devore-o"]
    assert search("gold")[0].name == "Au"
    assert search("no such thing at all") == []
