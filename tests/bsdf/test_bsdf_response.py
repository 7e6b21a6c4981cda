"""Tables of an interface: right from both sides, also beyond the critical angle."""

from __future__ import annotations

import numpy as np
import pytest
from helpers_bsdf import WAVELENGTHS, dielectric, fresnel

from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.interface import Specular
from nacre.bsdf.tabulate import StackTables, is_transparent
from nacre.core.arrays import interpolate, take_uniform
from nacre.measure.evaluate import bsdf_spectrum

TABLE_ERROR = 2e-4  # of R and T between nodes; `TABLE_ERROR` of tabulate, with room for the last refinement


def indices(*media: complex) -> np.ndarray:
    return np.array([np.broadcast_to(complex(n), WAVELENGTHS.shape) for n in media])


@pytest.mark.parametrize("degrees", [0.0, 20.0, 41.0, 60.0, 89.0])
def test_reflectance_from_inside_is_fresnels(degrees: float) -> None:
    response = StackTables(indices(1.0, 1.5), [], WAVELENGTHS, True).adaptive(np.zeros(0))
    cos = np.array(np.cos(np.radians(degrees)))
    reflected, passed = response.lookup(cos, np.array(True))
    expected = fresnel(1.5, 1.0, np.array([1.5 * np.sin(np.radians(degrees))]))
    assert reflected[0] == pytest.approx(expected[0], abs=TABLE_ERROR)
    assert passed[0] == pytest.approx(1.0 - expected[0], abs=TABLE_ERROR)


def test_an_absorbing_film_frustrates_total_reflection() -> None:
    film = StackTables(indices(1.0, 1.8 + 0.3j, 1.5), [False], WAVELENGTHS, True).adaptive(np.array([80.0]))
    reflected, passed = film.lookup(np.array(np.cos(np.radians(60.0))), np.array(True))
    assert np.all(passed == 0.0)
    assert np.all((reflected > 0.05) & (reflected < 0.95))


def test_transmittance_is_the_same_from_both_sides_of_an_absorbing_film() -> None:
    n, d = indices(1.0, 1.8 + 0.3j, 1.5), np.array([80.0])
    forward = StackTables(n, [False], WAVELENGTHS, True)
    backward = StackTables(n[::-1], [False], WAVELENGTHS, True)
    assert backward.flipped and not forward.flipped
    cos = np.linspace(0.05, 1.0, 7)
    np.testing.assert_allclose(forward.outside(d, cos)[1], backward.outside(d, cos)[1], atol=1e-12)


def test_a_denser_ambient_flips_the_tables() -> None:
    response = StackTables(indices(1.5, 1.0), [], WAVELENGTHS, True).adaptive(np.zeros(0))
    assert response.flipped and response.eta == pytest.approx(1.5)
    # light in the dense ambient is "inside" now
    reflected, _ = response.lookup(np.array(1.0), np.array(True))
    assert reflected == pytest.approx(0.04, abs=TABLE_ERROR)


def test_hemispherical_means_are_those_of_the_literature() -> None:
    r_out, t_out, r_in, t_in = dielectric(1.5, nodes=513).hemispherical
    # Duntley 1942: 0.0918 outside and 0.5963 inside for n = 1.5
    assert r_out[0] == pytest.approx(0.0918, abs=1e-4)
    assert r_in[0] == pytest.approx(0.5963, abs=1e-4)
    np.testing.assert_allclose(r_out + t_out, 1.0, atol=1e-9)
    np.testing.assert_allclose(r_in + t_in, 1.0, atol=2e-5)


@pytest.mark.parametrize(
    ("n", "transparent"), [(1.5, True), (1.5 + 9e-5j, True), (3.9 + 0.02j, False), (1 + 6j, False)]
)
def test_what_is_clear_and_what_is_opaque(n: complex, transparent: bool) -> None:
    assert is_transparent(indices(n)[0]) is transparent


def test_table_error_stays_below_its_promise_between_nodes() -> None:
    tables = StackTables(indices(1.0, 2.0, 1.5), [False], WAVELENGTHS, True)
    response = tables.adaptive(np.array([600.0]))
    cos = np.linspace(0.0, 1.0, 3001)
    exact = tables.outside(np.array([600.0]), cos)[0]
    got = response.lookup(cos, np.zeros(3001, dtype=bool))[0]
    assert np.max(np.abs(got - exact)) < TABLE_ERROR


def test_incoherent_panes_reflect_what_two_faces_do() -> None:
    response = StackTables(indices(1.0, 1.5, 1.0), [True], WAVELENGTHS, True).adaptive(np.array([1e6]))
    r = 0.04
    expected = r + (1 - r) ** 2 * r / (1 - r * r)
    assert response.reflectance[-1] == pytest.approx(expected, abs=1e-9)
    assert response.reflectance_inside[-1] == pytest.approx(expected, abs=1e-9)


def test_interpolation_is_exact_for_bilinear_tables() -> None:
    a, b = np.meshgrid(np.arange(4.0), np.arange(5.0), indexing="ij")
    table = (1 + 2 * a - b + 0.5 * a * b)[..., None]
    x, y = np.array([0.0, 1.3, 2.9, 3.0]), np.array([4.0, 0.2, 3.7, 0.0])
    np.testing.assert_allclose(interpolate(table, (x, y))[:, 0], 1 + 2 * x - y + 0.5 * x * y)
    np.testing.assert_allclose(take_uniform(table, np.array([0.5]), -2)[:, 0, 0], table[:, 2, 0])


def test_wrong_shapes_are_reported() -> None:
    import dataclasses

    good = dielectric(1.5)
    with pytest.raises(ValueError, match="transmittance"):
        dataclasses.replace(good, transmittance=good.transmittance[:-1]).check()
    with pytest.raises(ValueError, match="eta"):
        dataclasses.replace(good, eta=0.5).check()
    with pytest.raises(ValueError, match="ascend"):
        dataclasses.replace(good, wavelengths_nm=good.wavelengths_nm[::-1]).check()


def test_a_range_of_errors_includes_its_ends_and_is_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    ranges = [
        {"side": "ambient", "from_deg": 30.0, "to_deg": 45.0, "error": 0.1},
        {"side": "substrate", "from_deg": 20.0, "to_deg": 90.0, "error": 0.2},
    ]
    notes = {"angle_table": {"largest_error": 0.2, "ranges": ranges}, "source": "one-of-a-kind.toml"}
    bsdf = Bsdf((Specular(dielectric(1.5)),), notes)
    found = bsdf.angle_error(np.radians([29.9, 30.0, 45.0, 45.1, 135.0, 159.9, 160.1, 180.0]))
    np.testing.assert_allclose(found, [0.005, 0.1, 0.1, 0.005, 0.2, 0.2, 0.005, 0.005])
    bsdf_spectrum(bsdf, np.radians([10.0, 60.0]))
    assert not caplog.records
    for _ in range(3):
        bsdf_spectrum(bsdf, np.radians([10.0, 40.0]))
    assert len(caplog.records) == 1
