"""The forward model: theory, limits, invariances, and what others computed."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nacre.families.relief.diffraction_orders import (
    Coherence,
    _step_limit,
    brdf_factor,
    choose_sampling,
    coating_reflectance,
    coefficients,
    fresnel_reflectance,
    height_gradient,
    is_fft_cheaper,
    line_basis,
    line_power,
    reflection,
)
from nacre.families.relief.plane_cut import (
    CutGeometry,
    chebyshev_nodes,
    interpolation_weights,
    node_count,
    plan_cut,
)
from nacre.families.relief.surface import Tile, blur_matrix

_spec = importlib.util.spec_from_file_location("helpers_relief", Path(__file__).with_name("helpers_relief.py"))
assert _spec is not None and _spec.loader is not None
helpers = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(helpers)

DOUBLE, SINGLE = 1e-10, 1e-5  # the bars against a direct sum
EXACT = 1e-12  # invariances: rounding only
GRADIENT = 1e-5


def forward(tile: Tile, geometry: CutGeometry, upsampling: int, **options: object) -> np.ndarray:
    settings: dict = {"coherence": Coherence.from_sigma(1.0), "node_error": 1e-13, **options}
    dtype = settings.get("dtype", np.float64)
    plan = plan_cut(
        geometry,
        samples=tile.features * upsampling,
        period_nm=tile.period_nm,
        height_range_nm=tile.height_range_nm,
        **settings,
    )
    return np.asarray(plan.forward(tile.surface_nm(upsampling).astype(dtype))[0], dtype=float)


@pytest.mark.parametrize(("dtype", "bar"), [(np.float64, DOUBLE), (np.float32, SINGLE)])
@pytest.mark.parametrize("seed", range(3))
def test_slice_equals_a_windowed_direct_sum(seed: int, dtype: type, bar: float) -> None:
    tile, geometry = helpers.random_tile(seed, features=4), helpers.random_slice(seed, count=2)
    coherence = Coherence.from_sigma(0.8)
    upsampling = 6
    ours = forward(tile, geometry, upsampling, coherence=coherence, dtype=dtype, prefactor="published")
    truth = np.empty_like(ours)
    cos_o, _ = geometry.cos_o
    surface = tile.surface_nm(upsampling)
    for d, wi in enumerate(geometry.wi):
        for k, nm in enumerate(geometry.wavelengths_nm):
            for i, u in enumerate(geometry.psi_x):
                for j, v in enumerate(geometry.psi_y):
                    xi = wi[2] + cos_o[d, i, j]
                    mean = helpers.direct_sum(surface, tile.feature_nm / upsampling, coherence, u, v, xi, nm)
                    truth[d, k, i, j] = mean * xi**2 / (4 * wi[2] * cos_o[d, i, j])
    assert np.abs(ours - truth).max() <= bar * truth.max()


def test_line_powers_sum_to_one() -> None:
    power = line_power(helpers.random_tile(1).surface_nm(5), 2.0 / 500.0, 100)
    samples = 8 * 5
    full = np.abs(np.fft.fft2(np.exp(-2j * np.pi * 2.0 / 500.0 * helpers.random_tile(1).surface_nm(5)))) ** 2
    # an even number of samples has one line, the highest, that the symmetric set leaves out
    left_out = full[samples // 2].sum() + full[:, samples // 2].sum() - full[samples // 2, samples // 2]
    assert abs(power.sum() + left_out / samples**4 - 1.0) <= EXACT
    assert abs(line_power(helpers.random_tile(1, features=7).surface_nm(5), 2.0 / 500.0, 100).sum() - 1.0) <= EXACT


def test_pruned_products_equal_the_fft() -> None:
    surface = helpers.random_tile(2).surface_nm(16)
    assert is_fft_cheaper(128, 60) and not is_fft_cheaper(128, 23)
    for highest in (23, 60):
        chosen = line_power(surface, 0.0037, highest)
        by_products = line_power(surface, 0.0037, highest, line_basis(128, highest))
        assert chosen.shape == by_products.shape and np.abs(chosen - by_products).max() <= EXACT


@pytest.mark.parametrize("change", ["offset", "shift", "transpose", "conjugate", "repeat"])
def test_invariances(change: str) -> None:
    tile, upsampling = helpers.random_tile(3), 5
    axis = np.linspace(-0.3, 0.3, 7)
    geometry = CutGeometry(axis, axis, np.array([[0.0, 0.0, 1.0]]), np.array([450.0, 600.0]))
    before = forward(tile, geometry, upsampling)
    h = tile.heights_nm
    other = {
        "offset": h + 1234.5,
        "shift": np.roll(h, (2, 3), (0, 1)),
        "transpose": h.T,
        "conjugate": h.max() - h,
        "repeat": np.tile(h, (2, 2)),
    }[change]
    after = forward(replace(tile, heights_nm=other), geometry, upsampling)
    expected = {"transpose": before.swapaxes(2, 3), "conjugate": before[:, :, ::-1, ::-1]}.get(change, before)
    assert np.abs(after - expected).max() <= EXACT * before.max()


def test_a_mirror_has_the_closed_form() -> None:
    tile = Tile(np.zeros((4, 4)), 800.0, 100.0)
    coherence = Coherence.from_sigma(2.6)
    geometry = helpers.random_slice(4, half_range=0.08)
    ours = forward(tile, geometry, 16, coherence=coherence, prefactor="published")
    u, v = geometry.psi_x[:, None], geometry.psi_y[None, :]
    s = coherence.width_in_wavelengths
    power = 4 * np.pi * s**2 * np.exp(-4 * np.pi**2 * s**2 * (u**2 + v**2))
    factor = brdf_factor(u, v, geometry.wi[:, 2, None, None], geometry.cos_o[0], "published")
    assert np.abs(ours - (factor * power)[:, None]).max() <= EXACT * ours.max()


def test_the_coating_reflects_at_the_angle_between_the_light_and_the_half_vector() -> None:
    """cos = w_i . h, drawn from the directions themselves; off the mirror direction it is not half of xi."""
    tile, geometry = helpers.random_tile(5), helpers.random_slice(6, count=4)
    n = np.array([1.4 + 0.2j, 0.4 + 2.5j, 2.0 + 0.0j])
    bare = forward(tile, geometry, 4)
    coated = forward(tile, geometry, 4, reflectance=coating_reflectance(n))
    cos_o, visible = geometry.cos_o
    for i, x, y in np.argwhere(visible):
        wi = geometry.wi[i]
        wo = np.array([geometry.psi_x[x] - wi[0], geometry.psi_y[y] - wi[1], cos_o[i, x, y]])
        half = (wi + wo) / np.linalg.norm(wi + wo)
        expected = fresnel_reflectance(np.array(wi @ half), n) * bare[i, :, x, y]
        assert np.abs(coated[i, :, x, y] - expected).max() <= EXACT * bare.max()


@pytest.mark.parametrize("prefactor", ["kirchhoff", "published"])
def test_swapping_light_and_eye_changes_nothing(prefactor: str) -> None:
    tile = helpers.random_tile(5)
    wi, wo = np.array([0.3, -0.1, 0.0]), np.array([-0.2, 0.25, 0.0])
    wi[2], wo[2] = np.sqrt(1 - wi @ wi), np.sqrt(1 - wo @ wo)
    u, v = (wi + wo)[:1], (wi + wo)[1:2]
    values = [forward(tile, CutGeometry(u, v, w[None], np.array([500.0])), 6, prefactor=prefactor) for w in (wi, wo)]
    assert abs(values[0] / values[1] - 1.0).max() <= EXACT


@pytest.mark.parametrize("error", [1e-2, 1e-4, 1e-8])
def test_kappa_nodes_keep_their_stated_error(error: float, maps: int = 5) -> None:
    missed = 0
    for seed in range(maps):
        generator = np.random.default_rng(seed)
        tile = helpers.random_tile(seed, 6, 900.0, generator.uniform(0.12, 0.4), generator.uniform(100, 1500))
        low, high = generator.uniform(0.1, 1.7) / 700.0, 2.0 / generator.uniform(380.0, 500.0)
        surface = tile.surface_nm(5)
        nodes = chebyshev_nodes(low, high, node_count(tile.height_range_nm, low, high, error))
        points = np.linspace(low, high, 17)
        values = np.stack([line_power(surface, kappa, 14) for kappa in nodes])
        interpolated = np.tensordot(interpolation_weights(nodes, points).T, values, 1)
        truth = np.stack([line_power(surface, kappa, 14) for kappa in points])
        # stated relative to the sum of all powers, which is 1: so for the sum of all deviations at a point
        missed += np.abs(interpolated - truth).sum(axis=(1, 2)).max() > error
    assert missed <= maps // 100


@pytest.mark.full
@pytest.mark.parametrize("error", [1e-2, 1e-4])
def test_kappa_nodes_keep_their_stated_error_on_100_maps(error: float) -> None:
    test_kappa_nodes_keep_their_stated_error(error, maps=100)


@pytest.mark.parametrize("error", [1e-2, 1e-3])
def test_chosen_sampling_keeps_its_stated_error(error: float, maps: int = 20) -> None:
    missed = 0
    for seed in range(maps):
        generator = np.random.default_rng(seed)
        tile = helpers.random_tile(seed, 8, 900.0, generator.uniform(0.12, 0.4), generator.uniform(100, 900))
        sampling = choose_sampling(tile, 2.0 / 430.0, 8, error)
        ours = line_power(tile.surface_nm(sampling.samples_per_feature), 2.0 / 430.0, 8)
        truth = line_power(tile.surface_nm(4 * sampling.samples_per_feature), 2.0 / 430.0, 8)
        missed += np.linalg.norm(ours - truth) > error * np.linalg.norm(truth)
    assert missed <= maps // 100


@pytest.mark.full
@pytest.mark.parametrize("error", [1e-2, 1e-3])
def test_chosen_sampling_keeps_its_stated_error_on_100_maps(error: float) -> None:
    test_chosen_sampling_keeps_its_stated_error(error, maps=100)


def test_a_slice_takes_the_nodes_for_a_thousandth_unasked() -> None:
    """The error is of a sum of all line powers at worst; of a random relief it is far smaller."""
    tile, geometry = helpers.random_tile(3, height=1200.0), helpers.random_slice(3)
    settings = dict(samples=40, period_nm=tile.period_nm, height_range_nm=1200.0, coherence=Coherence.from_sigma(1.0))
    surface = tile.surface_nm(5)
    unasked, exact = (plan_cut(geometry, **settings, **e) for e in ({}, {"node_error": 1e-10}))
    assert len(unasked.kappas) == node_count(1200.0, *geometry.kappa_range, 1e-3)
    values, truth = unasked.forward(surface)[0], exact.forward(surface)[0]
    assert np.linalg.norm(values - truth) <= 1e-3 * np.linalg.norm(truth)


def test_the_first_guess_of_the_sampling_has_the_phase_steps_of_the_note() -> None:
    """Section 11.4: errors of 1e-4, 1e-3 and 1e-2 at steps of about 3, 4.4 and 6 rad, and smaller ones below."""
    errors = np.array([1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2])
    steps = np.array([_step_limit(error) for error in errors])
    np.testing.assert_allclose(steps[[2, 4, 5]], [3.0, 4.4, 6.0])
    assert np.all(np.diff(steps) > 0)


def test_gradient_agrees_with_finite_differences() -> None:
    tile, geometry = helpers.random_tile(7), helpers.random_slice(7)
    plan = plan_cut(
        geometry, samples=40, period_nm=tile.period_nm, height_range_nm=600.0, coherence=Coherence.from_sigma(1.0)
    )
    generator = np.random.default_rng(8)
    surface = tile.surface_nm(5)
    values, tape = plan.forward(surface, keep=True)
    cotangent = generator.standard_normal(values.shape)
    gradient = plan.pullback(surface, tape, cotangent)
    for _ in range(5):
        change = generator.standard_normal(surface.shape)
        step = 1e-3
        up, down = (plan.forward(surface + sign * step * change)[0] for sign in (1, -1))
        finite = float(((up - down) * cotangent).sum()) / (2 * step)
        assert abs(finite - float((gradient * change).sum())) <= GRADIENT * abs(finite)


def test_no_small_relief_changes_the_lines_of_a_mirror_to_first_order() -> None:
    """The mirror's own line is at its largest, the others at zero: whatever the weights, the gradient vanishes."""
    basis = line_basis(12, 4)
    field = reflection(np.zeros((12, 12)), 0.004)
    weights = np.random.default_rng(9).random((9, 9))
    gradient = height_gradient(field, coefficients(field, basis).pullback(weights), basis, 0.004)
    assert np.abs(gradient).max() <= EXACT
    # beside it, the same weights do pull
    rough = reflection(100.0 * np.random.default_rng(10).random((12, 12)), 0.004)
    pulled = height_gradient(rough, coefficients(rough, basis).pullback(weights), basis, 0.004)
    assert np.abs(pulled).max() > 1e-6


def test_threads_change_no_more_than_rounding() -> None:
    tile, geometry = helpers.random_tile(9), helpers.random_slice(9)
    one, two = (forward(tile, geometry, 5, workers=w) for w in (1, 2))
    assert np.abs(one - two).max() <= EXACT * one.max()


def test_blur_rows_sum_to_one_and_widen_a_feature() -> None:
    matrix = blur_matrix(6, 7, 0.4)
    assert np.abs(matrix.sum(axis=1) - 1.0).max() <= EXACT
    x = (np.arange(42) + 0.5) / 7 - 2.5 - 0.0
    distance = (x + 3.0) % 6.0 - 3.0
    column = matrix[:, 2] / matrix[:, 2].sum()
    # a unit box has variance 1/12; the blur adds its own; one period holds the tails to 1e-6
    assert abs((column * distance**2).sum() - (1 / 12 + 0.4**2)) < 2e-3


def test_source_angle_and_sigma_say_the_same() -> None:
    coherence = Coherence.from_sigma(2.6)
    assert abs(np.degrees(coherence.source_angle_rad) - 4.96) < 0.05
    assert abs(coherence.blur - 0.0216) < 1e-4
    assert abs(Coherence.from_source_angle(coherence.source_angle_rad).sigma_um - 2.6) < EXACT


@pytest.mark.parametrize("slope", [0.05, 0.1, 0.2])
def test_gentle_reliefs_conserve_energy(slope: float) -> None:
    """A perfect reflector, normal incidence: the integral of f cos over the hemisphere is 1 within 0.1 %."""
    generator = np.random.default_rng(11)
    samples, period_nm, nm = 256, 40_000.0, 500.0
    lines = np.fft.fftfreq(samples, 1.0 / samples)
    shape = np.exp(-0.5 * (np.hypot.outer(lines, lines) / 3.0) ** 2)
    surface = np.fft.ifft2(np.fft.fft2(generator.standard_normal((samples, samples))) * shape).real
    slopes = np.gradient(np.tile(surface, (2, 2)), period_nm / samples, axis=0)
    surface *= slope / slopes.std()
    coherence = Coherence.from_sigma(2.6)
    axis = np.linspace(-0.999, 0.999, 161)
    geometry = CutGeometry(axis, axis, np.array([[0.0, 0.0, 1.0]]), np.array([nm]))
    plan = plan_cut(
        geometry, samples=samples, period_nm=period_nm, height_range_nm=float(np.ptp(surface)), coherence=coherence,
        node_error=1e-5,
    )  # fmt: skip
    values, _ = plan.forward(surface)
    assert abs(values.sum() * (axis[1] - axis[0]) ** 2 - 1.0) <= 1e-3


@pytest.mark.full
def test_short_waves_give_the_microfacet_brdf_of_the_slopes() -> None:
    """The geometric limit: egg-box slopes, wavelength a hundredth of the period, against p2 / (4 cos^4 ...)."""
    samples, period_nm, nm = 1024, 100_000.0, 50.0
    x = (np.arange(samples) + 0.5) / samples
    amplitude = 600.0
    surface = amplitude * np.add.outer(np.cos(2 * np.pi * x), np.cos(2 * np.pi * x))
    steepest = 2 * np.pi * amplitude / period_nm
    coherence = Coherence.from_sigma(5.2)
    axis = np.linspace(-1.2, 1.2, 25) * steepest
    geometry = CutGeometry(axis, axis, np.array([[0.0, 0.0, 1.0]]), np.array([nm]))
    plan = plan_cut(
        geometry, samples=samples, period_nm=period_nm, height_range_nm=4 * amplitude, coherence=coherence,
        node_error=1e-3,
    )  # fmt: skip
    wave = plan.forward(surface)[0][0, 0]
    # rays: a fine grid of facets, blurred by the same lamp; slope (p, q) sends light to u = 2 p / (1 + p^2 + q^2)
    fine = -steepest * np.sin(2 * np.pi * (np.arange(1000) + 0.5) / 1000)
    normal = 1 + np.add.outer(fine**2, fine**2)
    rays = np.empty_like(wave)
    for i, u in enumerate(axis):
        near = np.exp(-((u - 2 * fine[:, None] / normal) ** 2) / (2 * coherence.blur**2))
        for j, v in enumerate(axis):
            both = near * np.exp(-((v - 2 * fine[None, :] / normal) ** 2) / (2 * coherence.blur**2))
            rays[i, j] = both.mean() / (2 * np.pi * coherence.blur**2)
    # f du dv is what arrives; both are densities over (u, v)
    assert np.linalg.norm(wave - rays) <= 0.02 * np.linalg.norm(rays)


@pytest.mark.parametrize(("dtype", "left_out"), [(np.float64, 0.5 * np.finfo(np.float64).eps), (np.float32, 3e-7)])
def test_lines_that_are_left_out_weigh_less_than_rounding(dtype: type, left_out: float) -> None:
    """The smoothing is exp(-d^2 / 2 blur^2) at the distance d of a line from the farthest direction."""
    coherence, period, nm = Coherence(5.0), 1e6, 500.0
    geometry = CutGeometry(np.array([0.0, 0.4]), np.array([-0.3, 0.0]), np.array([[0.0, 0.0, 1.0]]), np.array([nm]))
    first = geometry.highest_line(period, coherence, dtype) + 1
    assert np.exp(-0.5 * ((first * nm / period - 0.4) / coherence.blur) ** 2) <= left_out
