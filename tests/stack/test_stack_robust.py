"""The cases in which other codes overflow or divide by zero, against 60-digit arithmetic."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.material.material import material
from nacre.matter import Layer, Stack, amplitudes, powers, solve
from nacre.matter.stack.field import field_profile
from nacre.matter.stack.incoherent import incoherent_powers

_spec = importlib.util.spec_from_file_location("helpers_stack", Path(__file__).with_name("helpers_stack.py"))
assert _spec is not None and _spec.loader is not None
helpers = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(helpers)

ROBUST = 1e-9  # the bar of the film issue
SILVER = 0.06 + 3.6j


def worst(n: list[complex], d: list[float], lam: float, cos_i: float, kz0: object = None) -> float:
    """Largest error of r, t, R, T over both polarisations."""
    ours = solve(np.array(n)[:, None], d, [lam], cos_i=cos_i)
    kz0 = n[0].real * mp.mpf(cos_i) if kz0 is None else kz0
    error = 0.0
    for pol in "sp":
        for key, value in zip("rtRT", helpers.exact(n, d, lam, kz0, pol)):
            seen = getattr(ours, f"{key}_{pol}")[0]
            assert np.isfinite(seen)
            error = max(error, abs(seen - value))
    return error


@pytest.mark.parametrize("n", [[1.0, 1.5], [1.0, 1.4, SILVER], [1.5, 1.0, 1.5], [1.5, 1.2]])
def test_everything_is_reflected_at_exactly_90_degrees(n: list[complex]) -> None:
    seen = solve(np.array(n)[:, None], [100.0] * (len(n) - 2), [550.0], np.pi / 2)
    for R, T in ((seen.R_s, seen.T_s), (seen.R_p, seen.T_p)):
        assert abs(R - 1).max() <= ROBUST and T.max() == 0


def test_a_matched_stack_lets_grazing_light_pass() -> None:
    seen = solve([[1.5], [1.5], [1.5]], [100.0], [550.0], np.pi / 2)
    assert seen.R_s[0] == seen.R_p[0] == 0 and seen.T_s[0] == seen.T_p[0] == 1


@pytest.mark.parametrize("cos_i", [1e-11, 1e-9, 1e-6, 1e-3])
def test_angles_near_90_degrees_are_right(cos_i: float) -> None:
    assert worst([1.0, 1.4, SILVER, 1.5], [80.0, 20.0], 550.0, cos_i) <= ROBUST


@pytest.mark.parametrize("cos_i", [1.0, 0.5, 0.05])
def test_100_um_of_metal_are_opaque(cos_i: float) -> None:
    assert worst([1.0, 1.5, SILVER, 1.5], [300.0, 1e5], 550.0, cos_i) <= ROBUST


def test_light_does_not_cross_a_200_um_gap_beyond_the_critical_angle() -> None:
    for cos_i in (0.7, 0.5, 0.1):
        assert worst([1.5, 1.0, 1.5], [2e5], 550.0, cos_i) <= ROBUST


def test_light_tunnels_through_a_thin_gap() -> None:
    for d in (10.0, 200.0, 3000.0):
        assert worst([1.5, 1.0, 1.5], [d], 550.0, 0.5) <= ROBUST


@pytest.mark.parametrize("film", [1.0, 1.5, 2.3, SILVER])
def test_a_layer_of_no_thickness_changes_nothing(film: complex) -> None:
    angles, lam = np.linspace(0, np.pi / 2, 19), [400.0, 550.0, 800.0]
    bare = powers([[1.0] * 3, [1.5 + 0.01j] * 3], [], lam, angles)
    coated = powers([[1.0] * 3, [film] * 3, [1.5 + 0.01j] * 3], [0.0], lam, angles)
    for key in ("R_s", "R_p", "T_s", "T_p"):
        assert abs(getattr(bare, key) - getattr(coated, key)).max() <= 1e-15


# distances of kz^2 from zero in the film, down to beyond rounding
@pytest.mark.parametrize("offset", [0.0, 1e-16, -1e-16, 1e-13, 1e-9, -1e-9, 1e-6, -1e-4, 9.9e-4, 1.1e-3, -1.1e-3])
@pytest.mark.parametrize("d", [0.0, 1e-3, 200.0, 5000.0])
def test_a_film_in_which_kz_vanishes_is_right(offset: float, d: float) -> None:
    # n0 = 2, n1 = 1: kz1^2 = 1 - 4 + 4 cos^2, exactly 0 at cos^2 = 3/4
    cos_i = float(np.sqrt(0.75 + offset / 4))
    assert worst([2.0, 1.0, 1.5, 2.0], [d, 70.0], 550.0, cos_i) <= ROBUST


@pytest.mark.parametrize("film", [1.2, 1.7, 1.2 + 1e-5j])
@pytest.mark.parametrize("offset", [0.0, 1e-13, -1e-9, 1e-6, 9e-4, -9e-4])
def test_a_critical_film_of_any_index_is_right(film: complex, offset: float) -> None:
    # where n = 1 the weight n^2 of p cannot be seen
    cos_i = float(np.sqrt(1.0 - (film.real / 2.0) ** 2 + offset / 4))
    assert worst([2.0, film, 1.5, 2.0], [200.0, 70.0], 550.0, cos_i) <= ROBUST


def test_kz_vanishes_exactly_at_a_representable_wavevector() -> None:
    # kappa = n1 = 1 exactly, given directly
    seen = amplitudes([[2.0], [1.0], [2.0]], [200.0], [550.0], kappa=[1.0])
    with mp.workdps(60):
        kz0 = mp.sqrt(3)
    for pol in "sp":
        r, t, _, _ = helpers.exact([2.0, 1.0, 2.0], [200.0], 550.0, kz0, pol)
        assert abs(getattr(seen, f"r_{pol}")[0, 0] - r) <= ROBUST
        assert abs(getattr(seen, f"t_{pol}")[0, 0] - t) <= ROBUST


def test_the_critical_film_of_the_physics_note() -> None:
    seen = solve([[1.5], [1.0], [1.5]], [200.0], [550.0], np.arcsin(1 / 1.5))
    assert seen.R_p[0] == pytest.approx(0.2437, abs=5e-5) and seen.T_p[0] == pytest.approx(0.7563, abs=5e-5)


@pytest.mark.parametrize("cos_i", [1.0, 0.6, 0.2])
def test_a_thousand_layers_are_right(cos_i: float) -> None:
    n = [1.0, *[2.4, 1.46] * 500, 1.5]
    d = [57.0, 94.0] * 500
    for lam in (550.0, 700.0, 431.0):
        assert worst(n, d, lam, cos_i) <= ROBUST
    lossy = [1.0, *[2.4 + 0.001j, 1.46] * 500, 1.5]
    assert worst(lossy, d, 550.0, cos_i) <= ROBUST


def test_ten_thousand_layers_of_strong_contrast_stay_finite() -> None:
    seen = powers(np.array([1.0, *[4.0, 1.0] * 5000, 1.5])[:, None], [34.0, 137.0] * 5000, [550.0], [0.0, 0.7])
    assert abs(seen.R_s - 1).max() <= ROBUST and np.all(np.isfinite(seen.T_p))


def test_complex_wavevectors_agree_with_60_digits() -> None:
    # the metasurface's path w = 1 + i t over a film on silver and on glass
    t = np.array([0.0, 0.01, 1.0, 7.0, 40.0])
    for substrate in (SILVER, 1.5, 3.9 + 0.02j):
        n = [1.0, 1.46, 2.3 + 0.1j, substrate]
        seen = amplitudes(np.array(n)[:, None], [150.0, 30.0], [450.0], kz=1 + 1j * t)
        for i, value in enumerate(1 + 1j * t):
            for pol in "sp":
                r, tr, _, _ = helpers.exact(n, [150.0, 30.0], 450.0, complex(value), pol)
                assert abs(getattr(seen, f"r_{pol}")[i, 0] - r) <= 1e-11
                assert abs(getattr(seen, f"t_{pol}")[i, 0] - tr) <= 1e-11 * max(1.0, abs(tr))


def test_kappa_and_kz_name_the_same_wave() -> None:
    kappa = np.array([0.3, 0.99, 1.2, 5.0 + 0.2j])
    kz = np.sqrt(1 - kappa.astype(complex) ** 2)
    kz = np.where(kz.imag < 0, -kz, kz)
    n, lam = [[1.0] * 2, [1.5] * 2, [SILVER] * 2], [450.0, 600.0]
    a, b = amplitudes(n, [90.0], lam, kappa=kappa), amplitudes(n, [90.0], lam, kz=kz)
    assert abs(a.r_s - b.r_s).max() <= 1e-12 and abs(a.r_p - b.r_p).max() <= 1e-12


def test_light_entering_glass_from_an_absorbing_medium_takes_the_right_branch() -> None:
    # kz^2 of the ambient's partner is real up to rounding of either sign
    for k in np.linspace(1e-9, 1e-3, 50):
        seen = amplitudes([[2.877 + 1j * k], [1.2]], [], [500.0], theta_rad=[0.05, 0.1381])
        assert abs(seen.r_s).max() < 0.54 and abs(seen.r_p).max() < 0.54


def test_a_trace_of_loss_before_a_stack_changes_what_happens_inside_by_a_trace() -> None:
    """An imaginary part of kz^2 that is mere rounding, of either sign, must not turn the transmitted wave round."""
    trace = np.concatenate([[0.0], np.geomspace(1e-12, 1e-8, 60)])
    lam, angles = np.full(len(trace), 500.0), [0.05, 0.14, 0.3]
    n = np.stack([2.877 + 1j * trace, *np.multiply.outer([1.6 + 0.3j, 1.9, 1.2], np.ones(len(trace)))])
    inside = solve(n, [60.0, 80.0], lam, angles, absorption=True)
    field = field_profile(n, [60.0, 80.0], lam, angles, [30.0, 100.0, 400.0])
    passed = incoherent_powers(n, [60.0, 3e3], [False, True], lam, angles)
    for values in (inside.A_s, inside.A_p, inside.T_s, inside.T_p, field.s, field.p, passed.T_s, passed.R_p):
        assert values is not None
        assert np.abs(values - values[..., :1]).max() <= 1e-6 * np.abs(values).max()


BAD = [
    ({"n": [[1.0], [1.5 - 0.1j]], "thicknesses_nm": []}, "k < 0"),
    ({"n": [[1.0], [1.5], [1.0]], "thicknesses_nm": [-3.0]}, "thickness -3 nm"),
    ({"n": [[1.0], [np.nan]], "thicknesses_nm": []}, "finite"),
    ({"n": [[1.0], [0.0]], "thicknesses_nm": []}, "not zero"),
    ({"n": [[1.0], [1.5]], "thicknesses_nm": [100.0]}, "shape"),
    ({"n": [1.0, 1.5], "thicknesses_nm": []}, "shape"),
    ({"n": [[1.0], [1.5]], "thicknesses_nm": [], "theta_rad": 2.0}, "theta_rad"),
    ({"n": [[1.0], [1.5]], "thicknesses_nm": [], "theta_rad": -0.1}, "theta_rad"),
    ({"n": [[1.0], [1.5]], "thicknesses_nm": [], "wavelengths_nm": [-5.0]}, "wavelengths_nm"),
    ({"n": np.ones((3, 2, 1)), "thicknesses_nm": np.zeros((2, 0))}, "differ"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_bad_arrays_get_one_clear_line(arguments: dict, message: str) -> None:
    with pytest.raises(NacreError, match=message) as caught:
        solve(**{"wavelengths_nm": [550.0], "theta_rad": 0.0, **arguments})
    assert "\n" not in str(caught.value)


def test_bad_layers_get_one_clear_line() -> None:
    with pytest.raises(NacreError, match="thickness"):
        Layer(1.5, -1.0)
    with pytest.raises(NacreError, match="3 wavelengths|values for"):
        Stack(1.0, [Layer(np.array([1.5, 1.6]), 10.0)], 1.5).solve(0.0, [400.0, 500.0, 600.0])


@pytest.mark.parametrize("k", [1e-3, 0.5, 3.0])
@pytest.mark.parametrize("layers", [[], [Layer(1.5, 1e5, incoherent=True)]])
def test_an_absorbing_ambient_is_refused_where_r_and_t_have_no_meaning(k: float, layers: list) -> None:
    stack = Stack(1.5 + 1j * k, layers, 1.0)
    with pytest.raises(NacreError, match="ambient absorbs"):
        stack.powers([0.3], [550.0])


def test_amplitudes_keep_their_meaning_in_an_absorbing_ambient() -> None:
    seen = amplitudes([[1.5 + 0.1j], [1.0]], [], [550.0], theta_rad=[0.0])
    assert seen.r_s[0, 0] == pytest.approx((0.5 + 0.1j) / (2.5 + 0.1j))


def test_an_ambient_that_hardly_absorbs_keeps_the_energy() -> None:
    for theta in np.radians([0.0, 60.0, 89.9]):
        seen = powers([[1.5 + 9e-5j], [1.0 + 0j]], [], [550.0], [theta])
        assert seen.R_s + seen.T_s == pytest.approx(1.0, abs=1e-12)


def test_a_recipe_with_an_absorbing_ambient_is_refused_in_one_line() -> None:
    with pytest.raises(NacreError, match="ambient.*absorbs") as found:
        material({"family": "film", "substrate": "Si", "ambient": {"n": 1.5, "k": 0.01}})
    assert "\n" not in str(found.value)
