"""The fast forms of the monolayer's sums give what the plain ones give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.special import hankel1e, hankel2e, jv

from nacre.core.machine import in_threads, single_threaded_blas
from nacre.families.metasurface.monolayer import translation_sums
from nacre.families.metasurface.monolayer.diffuse import pair_powers
from nacre.families.metasurface.monolayer.qca import chebyshev, mean_excitation
from nacre.families.metasurface.monolayer.structure import hard_disk_structure
from nacre.families.metasurface.tmatrix.particle_on_stack import apply_response
from nacre.families.metasurface.tmatrix.special_functions import (
    adjoint,
    bessel_j,
    hankel_scaled,
    mirrored,
    plane_wave_vectors,
)
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.material.material import load

EXAMPLES = Path(__file__).parents[2] / "examples" / "metasurface"
ROUNDING = 1e-10  # at the nodes of the interpolation over the angle, where that adds nothing
HANKEL_DIGITS = 1e-12  # of Hankel's expansion from |z| = 28 on


def _whole_sums(layer, order, kappa, w):
    """Q for every multipole, m < 0 too, as the plain formula has it: no fold, no interpolation."""
    structure, surface, centre = layer.structure, layer.surface, layer.mean_centre_nm
    index, mu = translation_sums.multipole_index(order), translation_sums.pair_orders(order)
    direct = translation_sums._direct_sums(structure, surface.wavenumber, order, kappa)
    table = translation_sums.direct_coefficients(order).reshape(mu.size, -1)
    total = (table @ direct.reshape(table.shape[1], -1)).reshape(*mu.shape, -1)
    total = total + translation_sums._stack_sums(
        translation_sums.NeighbourGeometry(surface, centre, structure, order), kappa, every_row=True
    )
    scale = 2 * np.pi * structure.density_per_nm2 / surface.wavenumber**2
    b = plane_wave_vectors(w, order, order, kappa.astype(complex))
    echo = 4 * scale / w * np.exp(2j * surface.wavenumber * centre * w) * surface.reflection(w)
    left = translation_sums.with_negative_orders(adjoint(b), index) * echo[:, None]
    right = translation_sums.with_negative_orders(mirrored(b), index)
    q = total * scale * ((-1j) ** mu)[:, :, None] + np.einsum("pna,pma->nma", left, right)
    return index, np.moveaxis(q, -1, 0)


@pytest.mark.parametrize("below", [False, True])
def test_the_mean_field_of_one_mirror_half_is_that_of_all_multipoles(below):
    layer = load(EXAMPLES / ("silver_halo.toml" if below else "silver_on_oxide.toml")).model.monolayer(550.0)
    table, dressed = layer.neighbours, layer.mean_dressed
    theta, _ = chebyshev(table.propagating.shape[1], 0.0, np.pi / 2)
    kappa = np.sin(theta)[2::5]
    if below:
        eta, _ = chebyshev(table.evanescent.shape[1], 0.0, table.eta_max)
        kappa = np.concatenate([kappa, np.cosh(eta)[2::5]])
    sines = kappa / (layer.surface.index_below if below else 1.0)
    directions = layer.spheres[0].directions(np.sqrt((1 - sines) * (1 + sines)), below, sines)
    own = apply_response(dressed, directions.excitation)
    lmax, order = dressed.shape[1] // 2, table.geometry.order
    index, q = _whole_sums(layer, order, directions.inner, directions.inner_cosines)
    rows = index.tau * lmax + index.l - 1
    kept = np.concatenate([np.arange(order), lmax + np.arange(order)])
    free = translation_sums.with_negative_orders(own[: order + 1][:, :, kept], index)
    sign = np.where((index.m[:, None] < 0) & (index.tau[:, None] != index.tau), -1.0, 1.0)
    block = np.where(index.m[:, None] == index.m, dressed[np.abs(index.m)[:, None], rows[:, None], rows] * sign, 0.0)
    b = np.linalg.solve(np.eye(len(index.m)) - block @ q, free.transpose(2, 1, 0))
    plain = np.zeros_like(own)
    positive = index.m >= 0
    plain[index.m[positive], :, rows[positive], :] = (q @ b)[:, positive].transpose(1, 2, 0)
    fast = mean_excitation(table.at(directions), order, dressed, own)
    assert np.max(np.abs(fast - plain)) <= ROUNDING * np.max(np.abs(plain))


@pytest.mark.parametrize(("sign", "plain"), [(1, hankel1e), (-1, hankel2e)])
def test_hankel_functions_agree_with_scipy_on_both_sides_of_the_switch(sign, plain):
    radius = np.linspace(0.5, 300.0, 400)
    z = np.concatenate([radius * np.exp(1j * angle) for angle in (-1.5, -0.7, 0.0, 0.7, 1.5)])
    found = hankel_scaled(z, sign)
    for order in range(2):
        np.testing.assert_allclose(found[order], plain(order, z), rtol=HANKEL_DIGITS)


@pytest.mark.parametrize("two_sided", [True, False])
def test_pair_powers_are_the_plain_sums_over_the_azimuth(two_sided):
    rng = np.random.default_rng(3)
    sizes, count, orders = 2, 3, 3
    shape = (sizes, orders, 2, count, 2, count)
    fields = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    s_harmonics = rng.normal(size=(count, count, 14))
    s_harmonics = s_harmonics + s_harmonics.transpose(1, 0, 2)
    shares = np.array([0.3, 0.7])
    found = pair_powers(fields, s_harmonics, shares, two_sided, 4)
    samples = 18
    phi = np.pi * np.arange(samples + 1) / samples
    end = np.where((np.arange(samples + 1) % samples) == 0, 0.5, 1.0)
    k = np.arange(14)[:, None]
    project = end * np.cos(k * phi) * np.where(k == 0, 1.0, 2.0) / samples
    m = np.arange(orders)[:, None] * phi
    for q, p, s, i in np.ndindex(2, 2, count, count):
        basis = np.cos(m) if q == p else np.sin(m)
        forth = np.einsum("zm,mj->zj", fields[:, :, q, s, p, i], basis)
        back = np.einsum("zm,mj->zj", fields[:, :, p, i, q, s], basis)
        mean = [np.abs(shares @ x) ** 2 for x in (forth, back)]
        spread = [np.maximum(shares @ np.abs(x) ** 2 - a, 0.0) for x, a in zip((forth, back), mean, strict=True)]
        coherent = project @ (np.sqrt(mean[0] * mean[1]) if two_sided else mean[0])
        varying = project @ np.sqrt(spread[0] * spread[1])
        np.testing.assert_allclose(found.coherent[s, i, q, p], coherent[:4], rtol=1e-10)
        np.testing.assert_allclose(found.varying[s, i, q, p], varying[:4], rtol=1e-10)
        target = s_harmonics[s, i] @ (project @ mean[0]) + 2 * np.pi * (project @ spread[0])[0]
        np.testing.assert_allclose(found.target[q, s, p, i], target, rtol=1e-9)
        if two_sided:
            kernel = s_harmonics[s, i] @ coherent + 2 * np.pi * varying[0]
            np.testing.assert_allclose(found.kernel[q, s, p, i], kernel, rtol=1e-9)


def test_linear_algebra_has_its_threads_back_after_nested_and_failed_work():
    from threadpoolctl import threadpool_info

    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = threads()
    with single_threaded_blas():
        assert in_threads(lambda x: 2 * x, [1, 2, 3], 2) == [2, 4, 6]
        assert set(threads()) == {1}
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda x: 1 // x, [0], 1)
    assert threads() == before


@pytest.mark.parametrize("top", [0, 1, 8, 40])
def test_bessel_functions_of_many_points_are_scipys(top):
    """By the series, the recurrence and Hankel's expansion, across the seams between them."""
    rng = np.random.default_rng(7)
    z = 10 ** rng.uniform(-8, 1.9, 3000) * np.exp(1j * rng.uniform(-0.6, 0.6, 3000))
    z = np.concatenate([z, rng.uniform(0.0, 80.0, 1000), [0.0, 1e-13, 0.05, 0.0499999, 28.0, 28.0001]])
    expected = jv(np.arange(top + 1)[:, None], z)
    error = np.abs(bessel_j(z, top) - expected) / np.abs(expected).max(axis=0)
    assert np.max(error) < 1e-11
    small = np.abs(z) < 1.0  # there the high orders are small themselves
    size = np.abs(expected[:, small])
    relative = np.abs(bessel_j(z[small], top) - expected[:, small]) / np.where(size > 1e-250, size, np.inf)
    assert np.max(relative) < 1e-11


def test_few_nodes_of_a_search_give_the_sums():
    """Over stacks whose guided modes, mirrors and thick films draw fringes on the contour."""
    kappa = np.sin(np.radians([0.0, 30.0, 60.0]))
    structure = hard_disk_structure(0.1 / (np.pi * 75.0**2), 0.4, 0.05)
    stacks = [
        ([1.0, 1.46, 0.9 + 6.5j], [600.0]),
        ([1.0, 4.1 + 0.05j, 1.52], [220.0]),
        ([1.0, 0.9 + 6.5j, 1.52, 1.46, 0.9 + 6.5j], [20.0, 600.0, 600.0]),
        ([1.0, 1.46, 4.1 + 0.05j], [2.0]),
    ]
    for indices, thicknesses in stacks:
        surface = Substrate(550.0, np.array(indices, dtype=complex), np.array(thicknesses))
        args = (translation_sums.NeighbourGeometry(surface, 78.0, structure, 4), kappa)
        fine, quick = translation_sums._stack_sums(*args), translation_sums._stack_sums(*args, quick=True)
        assert np.max(np.abs(quick - fine)) < 1e-4 * np.max(np.abs(fine))
