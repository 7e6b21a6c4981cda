"""nacre's colours against colour-science, an independent implementation, on its own 1 nm integration."""

import functools
import importlib
import warnings

import numpy as np
import pytest

from nacre import light
from nacre.core.errors import NacreError

BAR = 1e-6  # relative, the issue's
# Sharma, Wu, Dalal 2005, table 1: pairs that reach every branch of the formula, and their printed dE00
SHARMA = np.array([
    [50, 2.6772, -79.7751, 50, 0, -82.7485, 2.0425], [50, 3.1571, -77.2803, 50, 0, -82.7485, 2.8615],
    [50, 2.8361, -74.02, 50, 0, -82.7485, 3.4412], [50, -1.3802, -84.2814, 50, 0, -82.7485, 1],
    [50, -1.1848, -84.8006, 50, 0, -82.7485, 1], [50, -0.9009, -85.5211, 50, 0, -82.7485, 1],
    [50, 0, 0, 50, -1, 2, 2.3669], [50, -1, 2, 50, 0, 0, 2.3669],
    [50, 2.49, -0.001, 50, -2.49, 0.0009, 7.1792], [50, 2.49, -0.001, 50, -2.49, 0.001, 7.1792],
    [50, 2.49, -0.001, 50, -2.49, 0.0011, 7.2195], [50, 2.49, -0.001, 50, -2.49, 0.0012, 7.2195],
    [50, -0.001, 2.49, 50, 0.0009, -2.49, 4.8045], [50, -0.001, 2.49, 50, 0.0011, -2.49, 4.7461],
    [50, 2.5, 0, 50, 0, -2.5, 4.3065], [50, 2.5, 0, 73, 25, -18, 27.1492], [50, 2.5, 0, 61, -5, 29, 22.8977],
    [50, 2.5, 0, 56, -27, -3, 31.9030], [50, 2.5, 0, 58, 24, 15, 19.4535], [50, 2.5, 0, 50, 3.1736, 0.5854, 1],
    [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
    [63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630],
    [35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645],
    [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
    [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
    [6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377],
    [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
])  # fmt: skip


@functools.cache
def oracle():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns about its own optional dependencies
        return importlib.import_module("colour")


def spectra(count, seed):
    """Fringe-like reflectances on 1 nm: what films make, and hard for a colour integration."""
    rng = np.random.default_rng(seed)
    nm = light.table_wavelengths_nm()
    phase = rng.uniform(200, 8000, (count, 1)) / nm * 2 * np.pi + rng.uniform(0, 6, (count, 1))
    return np.clip(0.5 + rng.uniform(0.1, 0.5, (count, 1)) * np.cos(phase), 0, 1)


def their_xyz(values, illuminant, observer):
    colour = oracle()
    name = {"F2": "FL2", "F11": "FL11"}.get(illuminant, illuminant)
    observers = {"2deg": "CIE 1931 2 Degree Standard Observer", "10deg": "CIE 1964 10 Degree Standard Observer"}
    shape = colour.SpectralShape(360, 830, 1)
    functions = colour.MSDS_CMFS[observers[observer]].copy().align(shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it announces that it aligns the illuminant
        lamp = colour.SDS_ILLUMINANTS[name]
        return colour.colorimetry.sd_to_XYZ_integration(values, functions, lamp, shape=shape) / 100


@pytest.mark.parametrize("observer", light.OBSERVERS)
@pytest.mark.parametrize("illuminant", light.ILLUMINANTS)
def test_xyz_equals_colour_science(illuminant, observer):
    values = spectra(30, seed=1)
    ours = light.spectrum_to_xyz(values, light.table_wavelengths_nm(), illuminant, observer)
    np.testing.assert_allclose(ours, their_xyz(values, illuminant, observer), rtol=BAR)


def test_lab_lch_and_xyy_equal_colour_science():
    colour = oracle()
    xyz = np.concatenate([light.spectrum_to_xyz(spectra(200, seed=2), light.table_wavelengths_nm()),
                          [[0.0, 0.0, 0.0], [0.001, 0.002, 0.003], [2.0, 1.5, 0.1]]])  # fmt: skip
    white = light.white_xyz()
    lab = colour.XYZ_to_Lab(xyz, colour.XYZ_to_xy(white))
    np.testing.assert_allclose(light.xyz_to_lab(xyz), lab, rtol=BAR, atol=BAR)
    np.testing.assert_allclose(light.lab_to_lch(lab), colour.Lab_to_LCHab(lab), rtol=BAR, atol=BAR)
    np.testing.assert_allclose(light.xyz_to_xyy(xyz[:-3]), colour.XYZ_to_xyY(xyz[:-3]), rtol=BAR)


def test_srgb_equals_colour_science():
    colour = oracle()
    xyz = light.spectrum_to_xyz(spectra(200, seed=3), light.table_wavelengths_nm())
    linear = colour.XYZ_to_sRGB(xyz, apply_cctf_encoding=False)
    np.testing.assert_allclose(light.xyz_to_srgb_linear(xyz), linear, rtol=BAR, atol=BAR)
    inside = np.clip(linear, 0, 1)
    np.testing.assert_allclose(light.srgb_encode(inside), colour.cctf_encoding(inside), rtol=BAR, atol=1e-12)


def test_delta_e_equals_colour_science():
    colour = oracle()
    rng = np.random.default_rng(4)
    lab = rng.uniform([0, -100, -100], [100, 100, 100], (3000, 3))
    near = lab + rng.normal(0, 3, lab.shape)
    for other in (near, rng.permutation(lab)):
        np.testing.assert_allclose(light.delta_e_2000(lab, other), colour.delta_E(lab, other), rtol=BAR)
        np.testing.assert_allclose(
            light.delta_e_76(lab, other), colour.delta_E(lab, other, method="CIE 1976"), rtol=BAR
        )


def test_delta_e_2000_gives_the_published_values():
    ours = light.delta_e_2000(SHARMA[:, :3], SHARMA[:, 3:6])
    np.testing.assert_allclose(ours, SHARMA[:, 6], atol=5.1e-5)  # printed to four digits
    np.testing.assert_allclose(ours, light.delta_e_2000(SHARMA[:, 3:6], SHARMA[:, :3]), rtol=1e-12)


def test_bradford_adaptation_equals_colour_science():
    colour = oracle()
    xyz = light.spectrum_to_xyz(spectra(50, seed=5), light.table_wavelengths_nm(), "A")
    white, target = light.white_xyz("A"), light.white_xyz("D65")
    theirs = colour.adaptation.chromatic_adaptation_VonKries(xyz, white, target, transform="Bradford")
    np.testing.assert_allclose(light.adapt_xyz(xyz, white, target), theirs, rtol=BAR)


def test_shipped_tables_are_colour_sciences_own():
    from pathlib import Path
    from runpy import run_path

    script = Path(__file__).parents[2] / "tools" / "make_light_tables.py"
    oracle()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fresh = run_path(str(script))["tables"]()
    for name in light.ILLUMINANTS:
        np.testing.assert_allclose(light.illuminant(name).power, fresh[f"illuminant {name}"], rtol=1e-12)
    for name in light.OBSERVERS:
        np.testing.assert_allclose(light.observer(name), fresh[f"observer {name}"], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("formula", "method", "options"),
    [
        ("cie94", "CIE 1994", {}),
        ("cie94-textiles", "CIE 1994", {"textiles": True}),
        ("cmc(1:1)", "CMC", {"l": 1, "c": 1}),
        ("cmc(2:1)", "CMC", {"l": 2, "c": 1}),
    ],
)
def test_difference_formulas_agree_with_colour_science(formula: str, method: str, options: dict) -> None:
    colour = oracle()
    rng = np.random.default_rng(4)
    lab = rng.uniform([0, -90, -90], [100, 90, 90], (5000, 3))
    lab[:100] *= [1.0, 0.0, 0.0]  # greys
    other = np.maximum(lab + rng.normal(0.0, 4.0, lab.shape), [0.0, -128.0, -128.0])
    theirs = colour.delta_E(lab, other, method=method, **options)
    np.testing.assert_allclose(light.colour_difference(lab, other, formula), theirs, atol=1e-4)


def test_din99o_has_the_scales_of_the_standard() -> None:
    """DIN 6176: white at 100; near the grey axis, chroma 0.075 / 0.0435 along 26 degrees and 0.83 of it across."""
    white, grey = light.lab_to_din99o([[100.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    np.testing.assert_allclose(white, [100.0, 0.0, 0.0], atol=2e-3)
    along, across = 1e-4 * np.array([[0, np.cos(a), np.sin(a)] for a in np.radians([26.0, 116.0])])
    for step, scale in ((along, 1.0), (across, 0.83)):
        moved = light.lab_to_din99o([50.0, 0.0, 0.0] + step) - grey
        np.testing.assert_allclose(np.hypot(*moved[1:]), scale * 1e-4 * 0.075 / 0.0435, rtol=1e-4)
        assert abs(np.degrees(np.arctan2(moved[2], moved[1]) - np.arctan2(step[2], step[1]))) < 1e-6


def test_din6175_weighs_greys_and_chromatic_colours_by_angle() -> None:
    """At 45 degrees S_L = 0.15 sqrt(L) + 0.7; a and b of greys count with 1 / 0.7."""
    found = light.delta_e_din6175([[64.0, 0.0, 0.0]] * 2, [[64.0, 0.7, 0.0], [64.0, 0.0, 1.4]], 45.0)
    np.testing.assert_allclose(found, [1.0, 2.0], rtol=1e-3)
    step = light.delta_e_din6175([50.0, 0.0, 0.0], [50.0 * 1.0201, 0.0, 0.0], [15.0, 45.0, 110.0])
    weights = 0.15 * np.sqrt(50.0 * 1.01) + 31.5 / np.array([15.0, 45.0, 110.0])
    np.testing.assert_allclose(step, 50.0 * 0.0201 / weights, rtol=1e-6)
    # far from grey, lightness 49 and chroma 64 at 45 degrees: S_C = 3.84 - 2.45 + 0.9333, S_H = 1.12 - 1.4 + 1.1667
    chroma = light.delta_e_din6175([49.0, 63.0, 0.0], [49.0, 65.0, 0.0], 45.0)
    hue = light.delta_e_din6175(*light.lch_to_lab([[49.0, 64.0, 0.0], [49.0, 64.0, 2.0]]), -45.0)
    np.testing.assert_allclose(chroma, 2.0 / (0.48 * (63 * 65) ** 0.25 - 2.45 + 42 / 45), rtol=1e-6)
    np.testing.assert_allclose(hue, 128.0 * np.sin(np.radians(1.0)) / (1.12 - 1.4 + 21 / 45 + 0.7), rtol=1e-6)
    assert light.colour_difference([50, 0, 0], [51, 0, 0], "din6175-2", 45.0) == pytest.approx(
        float(light.delta_e_din6175([51, 0, 0], [50, 0, 0], 45.0))
    )


@pytest.mark.parametrize(("formula", "angle"), [("audi2000", 45.0), ("DIN 6175-1", 45.0), ("din6175-2", None),
                                                ("din6175-2", 0.0)])  # fmt: skip
def test_a_formula_without_a_basis_is_refused(formula: str, angle: float | None) -> None:
    with pytest.raises(NacreError):
        light.colour_difference([50, 0, 0], [51, 0, 0], formula, angle)


def test_an_unknown_difference_formula_is_refused() -> None:
    with pytest.raises(NacreError):
        light.colour_difference([50, 0, 0], [51, 0, 0], "ciede2001")
