"""What colours must do whatever the numbers: whites, grids, clipping, the wavelength step, clear errors."""

import subprocess
import sys

import numpy as np
import pytest

from nacre import light
from nacre.core.errors import NacreError

ROUND_TRIP = 1e-12
STEP_BAR = 0.5  # dE00, the issue's


@pytest.mark.parametrize("illuminant", light.ILLUMINANTS)
@pytest.mark.parametrize(
    "samples", [(360, 830, 48), (380, 780, 401), (395.5, 705.25, 77), (300, 900, 7), (400, 700, 5000)]
)
def test_a_perfect_white_is_white_on_any_grid(illuminant, samples):
    nm = np.linspace(*samples)
    np.testing.assert_allclose(light.spectrum_to_xyz(np.ones_like(nm), nm, illuminant)[1], 1.0, rtol=1e-12)
    # grids of 1 nm and wider sum the CIE's own points; finer ones also see between them
    tolerance = 1e-12 if samples[2] < 1000 else 1e-3
    ours = light.spectrum_to_xyz(np.ones_like(nm), nm, illuminant)
    np.testing.assert_allclose(ours, light.white_xyz(illuminant), rtol=tolerance)


def test_weights_integrate_the_linear_interpolation_of_the_samples_exactly():
    rng = np.random.default_rng(0)
    nm = np.sort(np.append(rng.uniform(361, 829, 40), [360.0, 399.0, 701.0, 830.0]))
    nm = nm[np.append(True, np.diff(nm) > 1.0)]
    values = rng.uniform(size=(5, len(nm)))
    fine = np.array([np.interp(light.table_wavelengths_nm(), nm, row) for row in values])
    for illuminant in light.ILLUMINANTS:
        expected = light.spectrum_to_xyz(fine, light.table_wavelengths_nm(), illuminant)
        np.testing.assert_allclose(light.spectrum_to_xyz(values, nm, illuminant), expected, rtol=1e-12)


def test_fringes_finer_than_a_nanometre_are_not_skipped():
    nm = light.default_wavelengths(step_nm=0.05)
    fringes = 0.5 + 0.5 * np.cos(2 * np.pi * nm)  # 1 on every integer nanometre, 0.5 on average
    np.testing.assert_allclose(light.spectrum_to_xyz(fringes, nm), 0.5 * light.white_xyz(), rtol=1e-3)


@pytest.mark.parametrize("illuminant", light.ILLUMINANTS)
@pytest.mark.parametrize("observer", light.OBSERVERS)
def test_white_is_displayed_white_under_every_light(illuminant, observer):
    nm = light.default_wavelengths()
    np.testing.assert_allclose(light.spectrum_to_srgb(np.ones_like(nm), nm, illuminant, observer), 1.0, atol=2e-4)
    cast = light.spectrum_to_rgb_linear(np.ones_like(nm), nm, illuminant, observer, adaptation="none")
    unadapted = light.xyz_to_srgb_linear(light.white_xyz(illuminant, observer))
    np.testing.assert_allclose(cast, unadapted, rtol=1e-12)


def test_conversions_return_to_where_they_came_from():
    rng = np.random.default_rng(1)
    rgb = rng.uniform(-0.2, 1.5, (1000, 3))
    xyz = light.srgb_linear_to_xyz(rgb)
    np.testing.assert_allclose(light.xyz_to_srgb_linear(xyz), rgb, atol=ROUND_TRIP)
    np.testing.assert_allclose(light.lab_to_xyz(light.xyz_to_lab(xyz)), xyz, atol=ROUND_TRIP)
    np.testing.assert_allclose(light.xyy_to_xyz(light.xyz_to_xyy(np.abs(xyz))), np.abs(xyz), atol=ROUND_TRIP)
    lab = light.xyz_to_lab(xyz)
    np.testing.assert_allclose(light.lch_to_lab(light.lab_to_lch(lab)), lab, atol=1e-10)
    np.testing.assert_allclose(light.srgb_decode(light.srgb_encode(rgb)), rgb, atol=ROUND_TRIP)


def test_black_has_a_colour_too():
    assert light.xyz_to_xyy([0.0, 0.0, 0.0]).tolist() == [1 / 3, 1 / 3, 0.0]
    assert light.xyz_to_lab([0.0, 0.0, 0.0]) == pytest.approx([0, 0, 0], abs=1e-12)
    assert light.srgb_to_hex(light.srgb_encode([0.0, 0.0, 0.0])) == "#000000"


def test_clipping_keeps_hue_and_lightness_and_reaches_the_gamut_edge():
    rng = np.random.default_rng(2)
    rgb = rng.uniform(-0.5, 1.6, (20000, 3))
    clipped = light.clip_to_srgb(rgb)
    assert clipped.rgb.min() >= 0.0 and clipped.rgb.max() <= 1.0
    before, after = (light.lab_to_lch(light.xyz_to_lab(light.srgb_linear_to_xyz(v), light.SRGB_WHITE_XYZ))
                     for v in (rgb, clipped.rgb))  # fmt: skip
    moved = clipped.is_clipped & (before[:, 0] > 0) & (before[:, 0] < 100)
    assert moved.sum() > 10000
    np.testing.assert_allclose(after[moved, 0], before[moved, 0], atol=1e-4)
    coloured = moved & (after[:, 1] > 0.5)
    turn = (after[coloured, 2] - before[coloured, 2] + 180) % 360 - 180
    assert np.abs(turn).max() < 0.01  # degrees
    assert (after[moved, 1] <= before[moved, 1] + 1e-9).all()
    edge = np.minimum(clipped.rgb[moved].min(axis=1), 1 - clipped.rgb[moved].max(axis=1))
    assert np.abs(edge).max() < 1e-5  # no more chroma is given up than needed


def test_a_colour_is_clipped_alike_alone_and_among_many():
    """Few and many are searched for in different steps; each ends within 2.4e-7 of the chroma."""
    rgb = np.random.default_rng(5).uniform(-0.5, 1.6, (500, 3))
    many = light.clip_to_srgb(rgb).rgb
    alone = np.concatenate([light.clip_to_srgb(few).rgb for few in np.array_split(rgb, 50)])
    apart = np.abs(alone - many).max(axis=1)
    assert np.quantile(apart, 0.99) < 1e-6  # "one line in some thousand leaves the gamut twice"
    assert (apart > 0).any()


def test_clipping_leaves_the_gamut_alone_and_counts_the_rest():
    inside = np.random.default_rng(3).uniform(0, 1, (10, 10, 3))
    clipped = light.clip_to_srgb(inside)
    np.testing.assert_array_equal(clipped.rgb, inside)
    assert clipped.count == 0
    image = inside.copy()
    image[0, :3] = [1.5, -0.2, 0.1]
    image[5, 5] = [3.0, 3.0, 3.0]
    image[6, 6] = [-1.0, -1.0, -1.0]
    clipped = light.clip_to_srgb(image)
    assert clipped.count == 5
    assert clipped.rgb[5, 5].tolist() == [1, 1, 1]
    assert clipped.rgb[6, 6].tolist() == [0, 0, 0]
    np.testing.assert_array_equal(clipped.rgb[1], inside[1])


def test_a_grey_does_not_shift_with_the_light_and_a_narrow_band_does():
    nm = light.default_wavelengths(step_nm=1)
    for illuminant in light.ILLUMINANTS:
        assert light.illuminant_shift(np.full_like(nm, 0.4), nm, "D65", illuminant).delta_e_2000 < 1e-9
    fringes = 0.5 + 0.45 * np.cos(2 * np.pi * 3000 / nm)
    shift = light.illuminant_shift(fringes, nm, "D65", "F11")
    assert shift.delta_e_2000 > 3
    np.testing.assert_allclose(shift.delta_lightness, shift.lab_to[0] - shift.lab_from[0])
    assert light.delta_e_2000(shift.lab_from, shift.lab_to) == shift.delta_e_2000


def test_metamers_part_under_another_light():
    nm = light.default_wavelengths(step_nm=5)
    grey = np.full_like(nm, 0.5)
    weights = light.xyz_weights(nm, "D65")
    wave = 0.3 * np.cos(2 * np.pi * nm / 60)
    # take out what the D65 observer sees of the wave: a metamer of the grey
    metamer = grey + wave - weights @ np.linalg.lstsq(weights.T @ weights, weights.T @ wave, rcond=None)[0]
    np.testing.assert_allclose(light.spectrum_to_xyz(metamer, nm), light.spectrum_to_xyz(grey, nm), atol=1e-12)
    assert light.metamerism(grey, metamer, nm, "D65", "D65") < 1e-6
    assert light.metamerism(grey, metamer, nm, "D65", "F11") > 1
    assert light.metamerism(grey, 0.9 * grey, nm, "D65", "F11") < 1e-6  # a mismatch in lightness alone is taken out


def normal_reflectance(indices, thicknesses_nm, nm):
    """Return the reflectance of a stack at normal incidence, by admittances; written for this test only."""
    admittance = np.full(len(nm), indices[-1], dtype=complex)
    for n, d in zip(indices[-2:0:-1], thicknesses_nm[::-1]):
        tangent = np.tan(2 * np.pi * n * d / nm)
        admittance = (admittance - 1j * n * tangent) / (1 - 1j * tangent * admittance / n)
    return np.abs((indices[0] - admittance) / (indices[0] + admittance)) ** 2


STACKS = {
    "soap": ((1, 1.33, 1), 1.0),
    "titania on glass": ((1, 2.4, 1.5), 1.0),
    "oxide on silicon": ((1, 1.46, 4.1 + 0.03j), 1.0),
    "oxide on silver": ((1, 1.46, 0.05 + 3.2j), 1.0),
}


@pytest.mark.parametrize("name", STACKS)
def test_the_default_step_keeps_the_colour_of_a_film(name):
    indices, finesse = STACKS[name]
    rng = np.random.default_rng(5)
    fine = np.arange(360, 830.001, 0.05)
    for optical_thickness in np.geomspace(50, 30000, 60) * rng.uniform(0.95, 1.05, 60):
        labs = [
            light.xyz_to_lab(
                light.spectrum_to_xyz(normal_reflectance(indices, [optical_thickness / indices[1]], nm), nm)
            )
            for nm in (light.default_wavelengths(optical_thickness, finesse), fine)
        ]
        assert light.delta_e_2000(*labs) < STEP_BAR, optical_thickness


def test_the_default_step_keeps_the_colour_of_a_cavity():
    fine = np.arange(360, 830.001, 0.05)
    for spacer in np.geomspace(100, 20000, 40):
        indices, thicknesses = (1, 0.05 + 3.2j, 1.46, 0.05 + 3.2j, 1.5), (25.0, spacer / 1.46, 100.0)
        labs = [light.xyz_to_lab(light.spectrum_to_xyz(normal_reflectance(indices, thicknesses, nm), nm))
                for nm in (light.default_wavelengths(spacer, finesse=8), fine)]  # fmt: skip
        assert light.delta_e_2000(*labs) < STEP_BAR, spacer


@pytest.mark.parametrize("pairs", [5, 10, 20])
def test_the_default_step_keeps_the_colour_of_a_mirror(pairs):
    fine = np.arange(360, 830.001, 0.05)
    for centre in np.linspace(420, 680, 27):
        indices = (1, *(2.4, 1.46) * pairs, 1.5)
        thicknesses = [centre / 4 / n for n in indices[1:-1]]
        total = sum(n * d for n, d in zip(indices[1:-1], thicknesses))
        labs = [light.xyz_to_lab(light.spectrum_to_xyz(normal_reflectance(indices, thicknesses, nm), nm))
                for nm in (light.default_wavelengths(total, finesse=10), fine)]  # fmt: skip
        assert light.delta_e_2000(*labs) < STEP_BAR


def test_default_grid_spans_360_to_830_in_10_nm():
    np.testing.assert_array_equal(light.default_wavelengths(), np.arange(360.0, 831.0, 10.0))
    for thickness in (0, 500, 2000, 1e4, 1e5):
        nm = light.default_wavelengths(thickness)
        assert nm[0] == 360 and nm[-1] == 830 and np.diff(nm).max() <= light.colour_step_nm(thickness) + 1e-9


@pytest.mark.parametrize("call, words", [
    (lambda: light.illuminant("D56"), 'Did you mean "D65"'),
    (lambda: light.observer("2 deg"), 'Did you mean "2deg"'),
    (lambda: light.spectrum_to_xyz([1, 1, 1], [400, 700]), "last axis"),
    (lambda: light.spectrum_to_xyz([1, 1], [500, 600]), "400-700 nm"),
    (lambda: light.spectrum_to_xyz([1, 1, 1], [400, 700, 600]), "ascend"),
    (lambda: light.spectrum_to_xyz([1, 1], [400, np.nan]), "finite"),
    (lambda: light.clip_to_srgb([[0, np.nan, 1]]), "not finite"),
    (lambda: light.clip_to_srgb([[0, 1]]), "3 values"),
    (lambda: light.default_wavelengths(-1), "not negative"),
    (lambda: light.default_wavelengths(1e12), "incoherent"),
    (lambda: light.default_wavelengths(step_nm=0), "0.001 to 10"),
    (lambda: light.adaptation_matrix([1, 1, 1], [1, 1, 1], "bradfort"), 'Did you mean "bradford"'),
    (lambda: light.Illuminant([400, 500], [1, -1]), "negative"),
    (lambda: light.Illuminant([500, 400], [1, 1]), "ascend"),
])  # fmt: skip
def test_bad_input_gets_one_clear_line(call, words):
    with pytest.raises(NacreError) as error:
        call()
    assert words in str(error.value) and "\n" not in str(error.value)


def test_own_illuminant_is_taken_like_a_standard_one():
    nm, power = light.illuminant("F11")
    own = light.Illuminant(nm, 7.0 * power, "lamp")
    values = np.linspace(0, 1, 48)
    grid = light.default_wavelengths()
    np.testing.assert_allclose(
        light.spectrum_to_xyz(values, grid, own), light.spectrum_to_xyz(values, grid, "F11"), rtol=1e-12
    )


def test_importing_light_loads_neither_scipy_nor_matplotlib_nor_colour():
    names = ("scipy", "matplotlib", "colour", "jax", "pandas")
    code = f"import sys, nacre.light; print([m for m in {names} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_the_examples_of_the_docstrings_hold():
    grid = light.default_wavelengths()
    np.testing.assert_allclose(light.white_xyz("A"), [1.0985, 1, 0.3559], atol=5e-5)
    np.testing.assert_allclose(light.spectrum_to_xyz(np.full(48, 0.5), grid), [0.4752, 0.5, 0.5444], atol=5e-5)
    np.testing.assert_allclose(light.spectrum_to_srgb(np.full(48, 0.5), grid), 0.735, atol=5e-4)
    np.testing.assert_allclose(light.spectrum_to_rgb_matrix(grid, "A").sum(axis=0), 1.0, atol=1e-9)
    cast = light.spectrum_to_rgb_matrix(grid, "A", adaptation="none").sum(axis=0)
    np.testing.assert_allclose(cast, [1.85, 0.83, 0.23], atol=6e-3)
    assert light.xyz_to_lab(0.184 * light.white_xyz())[0] == pytest.approx(49.98, abs=5e-3)
    np.testing.assert_allclose(light.clip_to_srgb([0, 1.1, -0.2]).rgb, [0.617, 0.896, 0.0], atol=6e-4)
    assert (light.colour_step_nm(300 * 1.33), light.colour_step_nm(2000 * 1.5)) == (10.0, 2.0)
    assert (len(light.default_wavelengths()), len(light.default_wavelengths(3000))) == (48, 236)


@pytest.mark.parametrize("illuminant", ["D65", "F2", "F11"])
def test_the_few_wavelengths_of_a_walk_keep_the_colour_of_a_pigment_with_fringes(illuminant):
    from nacre.measure.colours import WALK_NM

    fine = np.arange(380.0, 781.0)
    grid = light.with_lamp_lines(WALK_NM, illuminant)
    white = light.white_xyz(illuminant, "10deg")
    worst = 0.0
    # two waves of path up to 3 um, as of a coated mica flake of 400 nm with 120 nm of titania on each side
    for first, second in ((600.0, 2300.0), (900.0, 2800.0), (1500.0, 3000.0)):
        curve = 0.35 + 0.2 * np.cos(2 * np.pi * first / fine) + 0.1 * np.cos(2 * np.pi * second / fine + 1.0)
        true = light.xyz_to_lab(light.spectrum_to_xyz(curve, fine, illuminant, "10deg"), white)
        xyz = np.interp(grid, fine, curve) @ light.smooth_weights(grid, illuminant, "10deg")
        worst = max(worst, float(light.delta_e_2000(true, light.xyz_to_lab(xyz, white))))
    assert worst <= STEP_BAR


def test_a_swatch_is_black_white_or_the_grey_of_its_luminance() -> None:
    white = light.white_xyz("A")
    grey = round(255 * (1.055 * 0.2 ** (1 / 2.4) - 0.055))  # sRGB, IEC 61966-2-1
    assert [light.swatch_hex(share * white, white) for share in (0.0, 0.2, 1.0)] == [
        "#000000", "#" + 3 * f"{grey:02x}", "#ffffff",
    ]  # fmt: skip
