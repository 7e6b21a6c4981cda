"""Are normals, extinction and dye right? Against Monte Carlo, quadrature and miepython."""

from __future__ import annotations

import numpy as np
import pytest
from helpers_pearl import draw_visible

from nacre.families.pearl.platelet import (
    FlakeNormals,
    cos_nodes,
    mean_extinction,
    optical_number,
    rotation_matrix,
    visible_weights,
)
from nacre.families.pearl.strata import Dye, dye_response
from nacre.families.pearl.thickness import Thickness
from nacre.matter.indices.spec import IndexSpec

SHAPES = [((0.2, 0.2), (0.0, 0.0, 0.0)), ((0.1, 0.4), (0.2, -0.1, 0.3)), ((1.0, 1.0), (0.0, 0.0, 0.0))]


def _normals(shape):
    return FlakeNormals(np.array(shape[0]), rotation_matrix(np.array(shape[1])))


def _sphere(count=400):
    x, w = np.polynomial.legendre.leggauss(count)
    phi = (np.arange(2 * count) + 0.5) * np.pi / count
    z, p = np.meshgrid(x, phi, indexing="ij")
    s = np.sqrt(1 - z**2)
    return np.stack([s * np.cos(p), s * np.sin(p), z], axis=-1).reshape(-1, 3), np.repeat(w, 2 * count) * np.pi / count


@pytest.mark.parametrize("shape", SHAPES)
def test_projected_area_is_the_integral_of_the_density(shape):
    normals = _normals(shape)
    m, weight = _sphere()
    for w in (np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]), np.array([0.3, -0.9, 0.316])):
        w = w / np.linalg.norm(w)
        area = np.sum(weight * np.maximum(m @ w, 0) * normals.density(m))
        assert area == pytest.approx(float(normals.projected_area(w)), rel=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_visible_normals_are_drawn_in_proportion_to_what_they_show(shape):
    normals = _normals(shape)
    rng = np.random.default_rng(3)
    w = np.array([0.6, 0.0, 0.8])
    drawn = draw_visible(normals, np.broadcast_to(w, (400_000, 3)), rng.random((400_000, 2)))
    m, weight = _sphere()
    visible = weight * np.maximum(m @ w, 0) * normals.density(m) / normals.projected_area(w)
    for moment in (lambda v: v[:, 2] ** 2, lambda v: v[:, 0] * v[:, 2], lambda v: v[:, 1] ** 2, lambda v: v @ w):
        values = moment(drawn)
        error = values.std() / np.sqrt(len(values))
        assert abs(values.mean() - np.sum(visible * moment(m))) < 4 * error + 1e-5


@pytest.mark.parametrize("shape", SHAPES)
def test_scattering_and_absorption_add_up_to_the_extinction(shape):
    weights = visible_weights(_normals(shape), 65)
    cos = cos_nodes(65)[:, None]
    reflect, transmit = 0.5 - 0.2 * cos, 0.3 + 0.1 * cos
    absorbed = weights @ (1 - reflect - transmit)
    total = weights @ reflect + absorbed
    assert np.abs(total - mean_extinction(weights, transmit)).max() < 1e-7
    assert np.abs(weights.sum(axis=-1) - 1).max() < 1e-12


def test_mean_extinction_equals_an_average_over_drawn_normals():
    normals = FlakeNormals(np.array([0.1, 0.4]))
    table = mean_extinction(visible_weights(normals, 257), np.cos(5 * cos_nodes(257))[:, None])
    rng = np.random.default_rng(0)
    last_a, last_e = table.shape[0] - 1, table.shape[1] - 1
    for a, e in ((0, last_e), (last_a, 10), (last_a // 2, 40)):
        z, phi = (e / last_e) ** 2, a / last_a * np.pi / 2
        w = np.array([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z])
        m = draw_visible(normals, np.broadcast_to(w, (200_000, 3)), rng.random((200_000, 2)))
        values = 1 - np.cos(5 * np.abs(m @ w))
        assert table[a, e, 0] == pytest.approx(values.mean(), abs=4 * values.std() / np.sqrt(200_000) + 1e-4)


def test_flakes_turn_about_x_then_y_then_z_of_the_stratum():
    """By hand: a quarter turn about x lays the normal z along -y; a quarter turn about z then lays -y along +x."""
    quarter = np.pi / 2
    turned = rotation_matrix(np.array([quarter, 0.0, quarter]))
    np.testing.assert_allclose(turned @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    # about x: y to z; about y: z to x
    np.testing.assert_allclose(rotation_matrix(np.array([quarter, quarter, 0.0])) @ [0, 1, 0], [1, 0, 0], atol=1e-12)
    flakes = FlakeNormals(np.array([0.1, 0.1]), turned)
    assert flakes.projected_area(np.array([1.0, 0.0, 0.0])) == pytest.approx(1.0)
    assert flakes.projected_area(np.array([0.0, 0.0, 1.0])) == pytest.approx(0.1)


def test_number_of_flakes_is_the_notes():
    assert optical_number(0.132, 150e3, 560.44 + 280) == pytest.approx(23.6, abs=0.05)
    assert optical_number(0.099, 150e3, 80 + 170) == pytest.approx(59.4, abs=0.05)


def test_spheres_of_dye_scatter_as_miepython_says():
    miepython = pytest.importorskip("miepython")
    lam = np.array([450.0, 550.0, 650.0])
    pigment = IndexSpec.model_validate({"n": 2.4, "k": 0.1}).build()
    found = dye_response(Dye(pigment, 0.001, Thickness(120.0)), np.full(3, 1.5), 1e5, lam)
    for i, wavelength in enumerate(lam):
        q_ext, q_sca, _, g = miepython.efficiencies(complex(2.4, -0.1), 240.0, wavelength, n_env=1.5)
        number = 0.001 / (4 / 3 * 120.0) * 1e5  # C t pi a^2 / volume
        assert found.extinction[i] == pytest.approx(number * q_ext, rel=1e-9)
        assert found.scattering[i] == pytest.approx(number * q_sca, rel=1e-9)
        mu = np.linspace(-1, 1, len(found.phase))
        mean = 2 * np.pi * np.trapezoid(found.phase[:, i] * mu, mu)
        assert mean == pytest.approx(g, abs=2e-3)


@pytest.mark.parametrize("spread", [Thickness(3.0, 1.5, "lognormal"), Thickness(3.0, 0.8)])
def test_small_pigments_absorb_by_their_volume_and_scatter_by_the_square_of_it(spread):
    """Rayleigh's limit: absorption k Im(alpha) goes with a^3, scattering with a^6, each over the mean volume."""
    lam = np.array([600.0])
    pigment = IndexSpec.model_validate({"n": 1.8, "k": 0.4}).build()
    resin, thickness, share = 1.5, 1e5, 0.01
    found = dye_response(Dye(pigment, share, spread), np.full(1, resin), thickness, lam)
    m2 = ((1.8 + 0.4j) / resin) ** 2
    contrast, k = (m2 - 1) / (m2 + 2), 2 * np.pi * resin / 600.0
    absorbed = share * thickness * 3 * k * contrast.imag
    radii, weights = spread.nodes(40)
    mean3, mean6 = weights @ radii**3, weights @ radii**6
    scattered = share * thickness * 2 * k**4 * abs(contrast) ** 2 * mean6 / mean3
    assert found.extinction[0] - found.scattering[0] == pytest.approx(absorbed, rel=1e-2)
    assert found.scattering[0] == pytest.approx(scattered, rel=2e-2)


def test_the_dyes_phase_function_is_normalised_and_its_quantiles_fit():
    lam = np.array([500.0])
    pigment = IndexSpec.model_validate({"n": 2.0}).build()
    found = dye_response(Dye(pigment, 0.01, Thickness(300.0, 60.0, "lognormal")), np.full(1, 1.5), 1e4, lam)
    mu = np.linspace(-1, 1, len(found.phase))
    assert 2 * np.pi * np.trapezoid(found.phase[:, 0], mu) == pytest.approx(1, abs=1e-9)
    mean = 2 * np.pi * np.trapezoid(found.phase[:, 0] * mu, mu)
    assert np.trapezoid(found.quantile[:, 0], dx=1 / (len(found.quantile) - 1)) == pytest.approx(mean, abs=5e-3)
    assert found.scattering[0] == pytest.approx(found.extinction[0], rel=1e-9)


def test_a_dissolved_dye_follows_beer_and_lambert():
    lam = np.array([500.0])
    pigment = IndexSpec.model_validate({"n": 1.5, "k": 0.02}).build()
    found = dye_response(Dye(pigment, 0.01), np.full(1, 1.5), 1e5, lam)
    assert found.extinction[0] == pytest.approx(4 * np.pi * 0.02 * 0.01 * 1e5 / 500)
    assert found.scattering[0] == 0
