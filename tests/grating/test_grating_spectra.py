"""Spectra of gratings from any azimuth and in any polarisation, and what instruments measure of narrow orders."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.html_report import report_json
from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.lobes.orders import OrdersLobe
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Diffracting
from nacre.light import delta_e_2000, smooth_weights, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.measure.colours import colour_values
from nacre.measure.evaluate import evaluate_for_colours
from nacre.measure.geometry import Geometry, aspecular_pairs
from nacre.optimise.measurement import simulate_measurement
from nacre.plot import lobe_figure

NM = np.arange(380.0, 780.5, 1.0)
THETA, LAM = np.radians([0.0, 35.0]), np.array([450.0, 600.0])
GROOVES: dict[str, Any] = {
    "family": "grating", "substrate": "Al", "profile": {"shape": "sinusoidal", "depth_nm": 130},
    "lattice": {"period_nm": 1100}, "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 100},
}  # fmt: skip


@pytest.mark.parametrize("substrate", ["Si", {"n": 1.5}])
def test_an_unpatterned_grating_has_the_mueller_matrices_of_a_film(substrate: Any) -> None:
    layers = [{"thickness_nm": 120, "material": "TiO2"}]
    film = nacre.material({"family": "film", "substrate": substrate, "layers": layers})
    flat = nacre.material(
        {"family": "grating", "substrate": substrate, "layers": layers, "lattice": {"period_nm": 300}}
    )
    wanted = film.spectrum(THETA, LAM, "mueller", azimuth_deg=40)
    found = flat.spectrum(THETA, LAM, "mueller", azimuth_deg=40)
    assert set(found.matrices()) == set(wanted.matrices())
    for name, matrix in wanted.matrices().items():
        np.testing.assert_allclose(found.matrices()[name], matrix, atol=1e-9)


def test_all_polarisations_of_a_grating_agree() -> None:
    grooves = nacre.material(GROOVES)
    found = {
        kind: grooves.spectrum(THETA, LAM, kind, azimuth_deg=40)
        for kind in ("s", "p", "left", "right", "both", "mueller")
    }
    mean = found["both"]
    for first, second in (("s", "p"), ("left", "right")):
        for name, values in mean.parts().items():
            pair = 0.5 * (found[first].parts()[name] + found[second].parts()[name])
            np.testing.assert_allclose(pair, values, rtol=1e-9)
    matrix = found["mueller"].mueller_reflected
    assert matrix is not None
    assert found["right"].specular_reflectance == pytest.approx(matrix[..., 0, 0] + matrix[..., 0, 3], rel=1e-9)
    assert found["s"].specular_reflectance == pytest.approx(matrix[..., 0, 0] - matrix[..., 0, 1], rel=1e-9)
    # conical incidence mixes s and p, and the two hands differ: Jones matrices pass power on as they are
    rows = nacre.orders(GROOVES, 35.0, 40.0, LAM)
    jones = rows.reflected_jones[0, :, np.flatnonzero(np.all(rows.numbers == 0, axis=1))[0]]
    hand = np.array([-1j, 1.0]) / np.sqrt(2.0)  # (s, p) of right circular light
    assert found["right"].specular_reflectance is not None
    assert found["right"].specular_reflectance[1] == pytest.approx(np.sum(np.abs(jones @ hand) ** 2, axis=-1), abs=1e-6)


def test_a_turned_grating_is_lit_from_the_turned_azimuth() -> None:
    turned = nacre.material(GROOVES | {"orientation": {"turn_deg": 25}}).spectrum(THETA, LAM, "s", azimuth_deg=65)
    straight = nacre.material(GROOVES).spectrum(THETA, LAM, "s", azimuth_deg=40)
    for name, values in straight.parts().items():
        np.testing.assert_allclose(turned.parts()[name], values, atol=1e-9)


def test_a_report_names_the_geometries_without_orders() -> None:
    line = {"shape": "line", "material": "Al", "width_nm": 90}
    fine = {"layers": [{"thickness_nm": 20, "material": "air", "shapes": [line]}], "lattice": {"period_nm": 200}}
    made = {key: value for key, value in GROOVES.items() if key != "profile"} | fine | {"orders": {"spread_deg": 0.7}}
    found = nacre.report(nacre.material(made))
    document = report_json([found])["reports"][0]
    assert document["dark_geometries"] == document["aspecular"]["geometries"]
    assert document["order_width_deg"] == pytest.approx(0.7)
    soap = nacre.report("soap")
    assert soap.dark_geometries == () and soap.order_width_deg is None


def test_an_unknown_polarisation_is_refused() -> None:
    with pytest.raises(UnsupportedError):
        nacre.material(GROOVES).spectrum(THETA, LAM, "z", azimuth_deg=40)


def first_orders(period: float, width: float, power: float) -> Bsdf:
    """Return first orders of equal efficiency, at wavelengths 20 nm apart."""
    grid = np.arange(380.0, 781.0, 20.0)
    lattice = np.array([[1.0 / period, 0.0], [0.0, 0.0]])
    table = np.full((2, 2, 2, len(grid)), power, dtype=np.float32)
    return Bsdf((OrdersLobe(grid, table, lattice, np.array([[-1, 0], [1, 0]]), width),))


def test_a_figure_shows_the_integrals_over_the_lines_of_narrow_orders() -> None:
    """Towards each viewer the luminance follows y(lambda) S(lambda) of its line; single wavelengths are 20 nm apart."""
    period, width = 1000.0, 0.005
    outline = lobe_figure(first_orders(period, width, 0.3), [0.0]).axes[0].lines
    x, y = next(line for line in outline if len(line.get_xdata()) == 721).get_data()
    exits = np.radians(np.linspace(-89.75, 89.75, 721))
    lam = period * np.abs(np.sin(exits))
    luminance = np.interp(lam, NM, smooth_weights(NM, "D65", "2deg")[:, 1], 0.0, 0.0) * np.cos(exits)
    # the weights curve by a few per cent within the 5 nm of a line
    np.testing.assert_allclose(np.hypot(x, y), luminance / luminance.max(), atol=0.05)


def test_values_between_whose_wavelengths_lines_of_orders_lie_are_stated_as_samples(
    caplog: pytest.LogCaptureFixture,
) -> None:
    up = np.array([0.0, 0.0, 1.0])
    evaluate_for_colours(first_orders(700.0, 0.005, 0.3), up[None], up[None])
    nacre.evaluate(first_orders(700.0, 0.2, 0.3), up, up)  # lines of 140 nm
    assert not caplog.records
    nacre.evaluate(first_orders(700.0, 0.005, 0.3), up, up)
    assert [record.levelname for record in caplog.records] == ["WARNING"]


@pytest.mark.full
def test_the_stated_width_of_orders_is_that_of_the_bsdf() -> None:
    """Orders that would overlap are narrower than the recipe asks: at most 0.12 of their distance."""
    line = {"shape": "line", "material": {"n": 1.5}, "width_nm": 700}
    wide = {
        "family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 1500}, "orders": {"spread_deg": 5.0},
        "layers": [{"thickness_nm": 50, "material": "air", "shapes": [line]}], "wavelengths": GROOVES["wavelengths"],
    }  # fmt: skip
    model = nacre.material(wide).model
    assert isinstance(model, Diffracting)
    assert model.order_width_rad == pytest.approx(0.12 * 400.0 / 1500.0)
    assert len(model.warnings) == 1
    assert not nacre.material(GROOVES).model.warnings
    lobes = [lobe for lobe in model.bsdf(np.array([600.0])).lobes if isinstance(lobe, OrdersLobe)]
    assert {lobe.width for lobe in lobes} == {model.order_width_rad}


def test_colours_of_orders_narrower_than_the_wavelength_steps_are_integrals_over_their_lines() -> None:
    width, power, period = 0.005, 0.3, 700.0
    bsdf = first_orders(period, width, power)
    sine = np.array([500.0, 513.0, 612.0]) / period  # the light along the normal, and three viewers
    wo = np.stack([sine, 0.0 * sine, np.sqrt(1.0 - sine**2)], axis=-1)
    values, _, lam = evaluate_for_colours(bsdf, np.broadcast_to([0.0, 0.0, 1.0], wo.shape), wo)
    found = spectrum_to_xyz(values, lam)
    dense = np.arange(380.0, 780.01, 0.1)
    bell = np.exp(-0.5 * ((sine[:, None] - dense / period) / width) ** 2) / (2.0 * np.pi * width**2)
    # linear interpolation at steps h widens a line by h^2 / 6 = 1/24 of its variance: 1e-3 of these colours
    np.testing.assert_allclose(found, spectrum_to_xyz(power * bell, dense), rtol=0.01, atol=0.02)


def test_a_search_measures_the_colour_of_a_narrow_order_as_a_report_does() -> None:
    """A line of 4 nm between wavelengths 20 nm apart; dE00 1 is just noticeable."""
    line = {"shape": "line", "material": "Al", "width_nm": 350}
    layers = [{"thickness_nm": 60, "material": "air", "shapes": [line]}]
    made = {"family": "grating", "substrate": "Al", "layers": layers, "lattice": {"period_nm": 700}}
    made["wavelengths"] = {"step_nm": 20}
    material, viewed = nacre.material(made), Geometry("aspecular", 45.0, 110.0)
    values, lam = colour_values(material, *aspecular_pairs([viewed]), "D65")
    found = simulate_measurement(material, [viewed], np.arange(380.0, 781.0, 20.0), memory={})
    labs = [
        xyz_to_lab(factors @ smooth_weights(grid, "D65", "2deg"), white_xyz("D65", "2deg"))
        for factors, grid in ((np.pi * values, lam), (found.factors, found.wavelengths_nm))
    ]
    assert labs[0][0, 0] > 30.0  # an order leaves there
    assert delta_e_2000(*labs).max() < 1.0


def test_wavelengths_that_miss_a_guided_mode_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    """Lines of n = 2 on a film, 340 nm apart, reflect lines of some 10 nm."""
    line = {"shape": "line", "material": {"n": 2.0}, "width_nm": 170}
    film = {"thickness_nm": 80, "material": {"n": 2.0}}
    layers = [{"thickness_nm": 100, "material": "air", "shapes": [line]}, film]
    made = {"family": "grating", "substrate": "glass", "layers": layers, "lattice": {"period_nm": 340}}
    assert np.diff(nacre.material(made).model.wavelengths_nm).max() == 5.0
    nacre.material({**made, "wavelengths": {"step_nm": 20}}).spectrum(0.0)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
