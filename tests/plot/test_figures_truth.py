"""Figures show what was computed: colours, curves and points are read back out of the drawn artists."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.collections import PathCollection, PolyCollection, QuadMesh
from matplotlib.patches import Rectangle

from nacre import light, plot
from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.core.errors import NacreError
from nacre.plot.directions import slice_directions

NM = np.arange(360.0, 831.0, 10.0)
ANGLES = np.linspace(0.0, 80.0, 9)


def fringes(optical_thickness_nm, amplitude=0.3):
    phase = 2 * np.pi * np.asarray(optical_thickness_nm, dtype=float)[..., None] / NM
    return 0.35 + amplitude * np.cos(phase)


def some_spectrum():
    return Spectrum(NM, ANGLES, fringes(900 - 3 * ANGLES), 0.3 * fringes(600 + 2 * ANGLES))


class HalfLambert:
    """A lobe with a known value: f = spectrum / pi, reflection only, brighter along +x."""

    kind = "test"
    wavelengths_nm = NM
    is_stochastic = False
    transmits = False

    def evaluate(self, wi, wo, uv=None):
        strength = np.where(wo[..., 2] > 0, 1.0 + 0.5 * wo[..., 0], 0.0)
        return strength[..., None] * fringes(800) / np.pi

    def specular(self, cos_i, uv=None):
        from nacre.bsdf.lobe import SpecularResponse

        zero = np.zeros((*np.shape(cos_i), len(NM)))
        return SpecularResponse(zero + 0.25, zero)


def test_spectrum_swatches_are_the_spectra_s_own_colours():
    spectrum = some_spectrum()
    figure = plot.spectrum_figure(spectrum, "A")
    tiles = [p for axes in figure.axes for p in axes.patches if isinstance(p, Rectangle)]
    expected = light.spectrum_to_srgb(np.concatenate(list(spectrum.parts().values())), NM, "A")
    np.testing.assert_allclose([tile.get_facecolor()[:3] for tile in tiles], expected, atol=1e-6)
    curves = [line.get_ydata() for axes in figure.axes for line in axes.lines if len(line.get_ydata()) == len(NM)]
    np.testing.assert_array_equal(curves, np.concatenate(list(spectrum.parts().values())))


def test_more_than_twelve_angles_are_thinned_and_keep_both_ends():
    angles = np.linspace(0, 89, 90)
    figure = plot.spectrum_figure(Spectrum(NM, angles, fringes(900 - 3 * angles)))
    texts = [t.get_text() for axes in figure.axes for t in axes.texts]
    assert len(texts) == 12 and texts[0] == "0°" and texts[-1] == "89°"


def test_dark_colours_are_shown_brighter_and_the_factor_is_printed():
    figure = plot.spectrum_figure(Spectrum(NM, ANGLES, 0.05 * fringes(900 - 3 * ANGLES)))
    assert "20× brighter" in figure._supxlabel.get_text()
    tiles = [p for axes in figure.axes for p in axes.patches if isinstance(p, Rectangle)]
    expected = light.spectrum_to_srgb(20 * 0.05 * fringes(900 - 3 * ANGLES), NM)
    np.testing.assert_allclose([tile.get_facecolor()[:3] for tile in tiles], expected, atol=1e-6)


def test_ribbon_and_colour_map_hold_the_colours():
    spectrum = some_spectrum()
    meshes = [c for axes in plot.ribbon_figure(spectrum).axes for c in axes.collections if isinstance(c, QuadMesh)]
    for mesh, values in zip(meshes, spectrum.parts().values(), strict=True):
        np.testing.assert_allclose(np.squeeze(mesh.get_array()), light.spectrum_to_srgb(values, NM), atol=1e-9)
    values = fringes(np.linspace(0, 2000, 30)[:, None] - ANGLES)
    figure = plot.colour_map_figure(ANGLES, np.linspace(0, 1000, 30), values, NM)
    (mesh,) = [c for c in figure.axes[0].collections if isinstance(c, QuadMesh)]
    np.testing.assert_allclose(mesh.get_array(), light.spectrum_to_srgb(values, NM), atol=1e-9)


def test_clipped_colours_are_counted_in_the_small_print():
    narrow = np.exp(-(((NM - np.array([[450.0], [520.0], [640.0]])) / 12) ** 2))
    figure = plot.chromaticity_figure(narrow, NM)
    assert "3 of 3 colours outside sRGB" in figure._supxlabel.get_text()


def test_chromaticity_points_stand_at_their_coordinates():
    values = fringes(np.linspace(300, 1500, 20))
    figure = plot.chromaticity_figure(values, NM, [str(i) for i in range(20)], "D50")
    xyz = light.spectrum_to_xyz(values, NM, "D50")
    points = [next(c for c in axes.collections if isinstance(c, PathCollection)).get_offsets() for axes in figure.axes]
    np.testing.assert_allclose(points[0], light.xyz_to_xyy(xyz)[:, :2])
    np.testing.assert_allclose(points[1], light.xyz_to_lab(xyz, light.white_xyz("D50"))[:, 1:])
    white = figure.axes[0].lines[-2].get_xydata()[0]
    np.testing.assert_allclose(white, light.xyz_to_xyy(light.white_xyz("D50"))[:2])


def test_slice_directions_have_the_angles_they_claim():
    half_deg, difference_deg, (wi, wo) = slice_directions(31)
    np.testing.assert_allclose(np.linalg.norm(wi, axis=-1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(wo, axis=-1), 1.0)
    assert (wi[..., 2] > 0).all() and (wo[..., 2] > 0).all()
    half = wi + wo
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.degrees(np.arccos(half[..., 2].clip(-1, 1))), np.tile(half_deg, (31, 1)), atol=1e-5)
    opening = np.degrees(np.arccos((wi * half).sum(axis=-1).clip(-1, 1)))
    np.testing.assert_allclose(opening, np.tile(difference_deg[:, None], 31), atol=1e-5)


def test_slice_lightness_is_the_logarithm_of_f_and_its_hue_the_spectrum_s():
    half, difference = np.array([1.0, 4.0, 9.0]), np.array([10.0, 20.0])
    strength = np.array([[1.0, 0.1, 0.01], [1e-3, 1e-4, 1e-7]])
    values = strength[..., None] * (0.5 + 0.05 * np.cos(2 * np.pi * 800 / NM))
    figure = plot.slice_figure(values, NM, half, difference)
    (mesh,) = [c for c in figure.axes[0].collections if isinstance(c, QuadMesh)]
    drawn = light.srgb_linear_to_xyz(light.srgb_decode(np.asarray(mesh.get_array())))
    lightness = light.xyz_to_lab(drawn, light.SRGB_WHITE_XYZ)[..., 0]
    np.testing.assert_allclose(lightness, [[100, 80, 60], [40, 20, 0]], atol=0.02)
    expected = light.xyz_to_xyy(light.spectrum_to_xyz(values[0, 1], NM))[:2]
    np.testing.assert_allclose(light.xyz_to_xyy(drawn[0, 1])[:2], expected, atol=1e-3)


def test_lobe_radius_is_the_luminance_of_f_cos():
    figure = plot.lobe_figure(Bsdf((HalfLambert(),)), [0.0, 40.0])
    for axes in figure.axes:
        outline = next(line for line in axes.lines if len(line.get_xdata()) == 721)
        x, y = outline.get_xdata(), outline.get_ydata()
        exits = np.arctan2(x, y)
        expected = (1 + 0.5 * np.sin(exits)) * np.cos(exits)
        np.testing.assert_allclose(np.hypot(x, y), expected / expected.max(), atol=1e-6)
        assert any(isinstance(c, PolyCollection) for c in axes.collections)
        assert "R = 0.25" in [t.get_text() for t in axes.texts]


def test_index_curves_are_n_and_k():
    n = 2.0 + 0.1 * np.cos(NM / 50) + 1j * (0.5 + 0.1 * np.sin(NM / 50))
    figure = plot.index_figure(NM, n, "a metal")
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), n.real)
    twin = next(axes for axes in figure.axes if axes.get_ylabel() == "$k$")
    np.testing.assert_array_equal(twin.lines[0].get_ydata(), n.imag)
    assert not any(axes.get_ylabel() == "$k$" for axes in plot.index_figure(NM, n.real).axes)


def test_field_curves_and_layers_are_where_they_belong():
    z = np.linspace(-200, 600, 81)
    data = {"z_nm": z, "wavelengths_nm": np.array([500.0]), "s": np.cos(z / 100)[:, None] ** 2,
            "p": np.cos(z / 100)[:, None] ** 2, "interfaces_nm": np.array([0.0, 150.0, 400.0]),
            "names": ["air", "SiO2", "TiO2", "Si"]}  # fmt: skip
    axes = plot.data_figure("field", data).axes[0]
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), data["s"][:, 0])
    assert [t.get_text() for t in axes.texts] == data["names"]
    oblique = plot.data_figure("field", {**data, "theta_deg": 45.0, "p": 2 * data["p"]}).axes[0]
    labels = [t.get_text() for t in oblique.get_legend().get_texts()]
    assert labels == ["500 nm s", "500 nm p"]


def test_microscope_exposes_to_white_and_bars_a_round_length():
    rgb = np.zeros((40, 60, 3))
    rgb[10:20, 10:20] = 0.2
    figure = plot.data_figure("microscope", {"rgb": rgb, "extent_um": 18.0})
    image = np.asarray(figure.axes[0].images[0].get_array())
    np.testing.assert_allclose(image[15, 15], 1.0, atol=1e-3)
    assert image[30, 30].max() == 0.0
    assert "2 µm" in [t.get_text() for t in figure.axes[0].texts]


@pytest.mark.parametrize("kind, data, words", [
    ("field", {"z_nm": [0, 1]}, "wavelengths_nm is missing"),
    ("structure", {"q": [0, 1]}, "sq is missing"),
    ("structure", {"q": [0, 1], "sq": [1, np.nan]}, "not finite"),
    ("platelet", {"angles_deg": [0, 1]}, "wavelengths_nm is missing"),
    ("scattering", {"theta_deg": [0, 1], "s": [0, 0], "p": [0, 0]}, "zero everywhere"),
    ("microscope", {"rgb": np.zeros((3, 3)), "extent_um": 1.0}, "should be [y, x, 3]"),
    ("colour-map", {"angles_deg": [0, 1]}, "wavelengths_nm is missing"),
    ("feild", {}, 'Did you mean "field"'),
])  # fmt: skip
def test_a_figure_without_its_arrays_says_which(kind, data, words):
    with pytest.raises(NacreError) as error:
        plot.data_figure(kind, data)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_mirror_has_no_slice():
    with pytest.raises(NacreError, match="delta lobe only"):
        plot.slice_figure(np.zeros((3, 3, len(NM))), NM, np.arange(3.0), np.arange(3.0))


def test_a_ribbon_of_one_angle_is_refused():
    with pytest.raises(NacreError, match="2 angles"):
        plot.ribbon_figure(Spectrum(NM, np.array([0.0]), fringes([900])))


def test_plot_loads_matplotlib_late_and_never_pyplot():
    code = (
        "import sys, nacre.plot; print('matplotlib' in sys.modules);"
        "nacre.plot.new_figure(3, 2); print('matplotlib' in sys.modules, 'matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == ["False", "True", "False"]


def test_names_of_thin_layers_do_not_cover_each_other() -> None:
    from nacre.plot.sheets import apart

    np.testing.assert_allclose(apart(np.array([0.1, 0.5, 0.51]), 0.05), [0.1, 0.5, 0.55])
    crowded = apart(np.array([0.9, 0.95, 0.96, 0.97]), 0.05)
    assert crowded.max() <= 1.0 + 1e-12 and np.diff(crowded).min() >= 0.05 - 1e-12
    assert np.diff(apart(np.full(40, 0.5), 0.05)).min() > 0.02  # more than there is room for


TAPE = {
    "family": "film",
    "substrate": "air",
    "layers": [
        {"material": {"principal": [1.51, 1.498, 1.496], "euler_deg": [20, 0, 0]}, "thickness_nm": 60_000,
         "incoherent": True},
    ],
    "wavelengths": {"step_nm": 20},
}  # fmt: skip


def test_the_michel_levy_chart_marks_the_retardance_of_a_sheet():
    figure = plot.material_figure(TAPE, "michel-levy")
    (mark,) = [line for line in figure.axes[1].lines if line.get_linestyle() == "--"]
    # birefringence times thickness; the step of the search is 1 nm
    assert abs(mark.get_xdata()[0] - 0.012 * 60_000) < 2.0
    own = np.asarray(figure.axes[0].images[0].get_array())[0, 0]
    chart = np.asarray(figure.axes[1].images[0].get_array())[0]
    at = chart[int(round(720.0 / plot.spectra.MICHEL_LEVY_NM * 1000))]
    np.testing.assert_allclose(own, at, atol=0.08)  # the sheet reflects some 8 % of the light


def test_the_michel_levy_chart_is_refused_for_an_opaque_film():
    with pytest.raises(NacreError):
        plot.material_figure({"family": "film", "substrate": "Si", "layers": []}, "michel-levy")


def test_retardances_and_crossed_polarisers_are_those_of_a_retarder():
    from nacre.measure.evaluate import crossed_polarisers, retardance_nm

    delta = 2.0 * np.pi * 1234.0 / NM
    matrices = np.zeros((len(NM), 4, 4))  # fast axis along p
    matrices[:, 0, 0] = matrices[:, 1, 1] = 1.0
    matrices[:, 2, 2] = matrices[:, 3, 3] = np.cos(delta)
    matrices[:, 2, 3], matrices[:, 3, 2] = np.sin(delta), -np.sin(delta)
    assert abs(retardance_nm(0.9 * matrices, NM) - 1234.0) < 1.0
    np.testing.assert_allclose(crossed_polarisers(matrices), np.sin(0.5 * delta) ** 2, atol=1e-3)
    depolarising = np.zeros_like(matrices)
    depolarising[:, 0, 0] = 1.0
    assert retardance_nm(depolarising, NM) is None
