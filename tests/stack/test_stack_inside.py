"""Absorption, fields, incoherent layers and ellipsometric angles, against `tmm` and against conservation."""

from __future__ import annotations

import numpy as np
import pytest
import tmm

from nacre.core.errors import NacreError
from nacre.matter import Layer, Stack, powers, solve
from nacre.matter.stack.field import field_profile
from nacre.matter.stack.incoherent import incoherent_powers
from nacre.matter.stack.solve import ellipsometry, jones_reflection, jones_transmission, mueller

ENERGY = 1e-12  # the bar of the film issue
AGAINST_TMM = 1e-11
LAM = 500.0


def stacks(count: int, seed: int, loss: float) -> list[tuple[np.ndarray, np.ndarray, float]]:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        layers = int(rng.integers(1, 6))
        n = rng.uniform(1.2, 3, layers + 2) + 1j * rng.uniform(0, loss, layers + 2) * (rng.random(layers + 2) < 0.6)
        n[0] = 1.2
        found.append((n, rng.uniform(0, 300, layers), float(rng.uniform(0, 1.5))))
    return found


def test_layers_absorb_what_is_neither_reflected_nor_transmitted() -> None:
    for n, d, theta in stacks(150, seed=3, loss=2.0):
        r = solve(n[:, None], d, [LAM], theta, absorption=True)
        for R, T, A in ((r.R_s, r.T_s, r.A_s), (r.R_p, r.T_p, r.A_p)):
            assert A is not None
            assert abs(R + T + A.sum(axis=0) - 1).max() <= ENERGY
            assert A.min() >= -ENERGY


def test_unpolarised_light_that_is_lost_is_absorbed() -> None:
    case = ([[1.0], [1.5 + 0.2j], [2.0 + 1j], [1.5]], [50.0, 80.0], [LAM], [0.0, 0.5])
    r = solve(*case, absorption=True)
    np.testing.assert_allclose(r.absorptance, 1.0 - 0.5 * (r.R_s + r.R_p + r.T_s + r.T_p), atol=ENERGY)
    with pytest.raises(NacreError):
        _ = solve(*case).absorptance


def test_layers_absorb_nothing_of_light_that_runs_along_them() -> None:
    r = solve([[1.0], [1.5 + 0.2j], [2.0 + 1j], [1.5]], [50.0, 80.0], [LAM], [0.5, np.pi / 2], absorption=True)
    for A in (r.A_s, r.A_p):
        assert A is not None and np.all(A[:, 0] > 0) and np.all(A[:, 1] == 0)


def test_absorption_is_the_loss_that_the_field_makes_in_each_layer() -> None:
    # dA/dz = k0 Im(n^2) |E|^2 / (n_0 cos): an integral over the field, not a flux
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for n, d, theta in stacks(20, seed=4, loss=1.0):
        r = solve(n[:, None], d, [LAM], theta, absorption=True)
        assert r.A_s is not None and r.A_p is not None
        tops = np.concatenate([[0], np.cumsum(d)])
        for j, thickness in enumerate(d):
            f = field_profile(n[:, None], d, [LAM], theta, tops[j] + thickness * (nodes + 1) / 2)
            factor = 2 * np.pi / LAM * (n[j + 1] ** 2).imag / (n[0].real * np.cos(theta)) * thickness / 2
            assert abs(factor * weights @ f.s[:, 0] - r.A_s[j, 0]) <= 1e-10
            assert abs(factor * weights @ f.p[:, 0] - r.A_p[j, 0]) <= 1e-10


def test_absorption_field_and_ellipsometry_agree_with_tmm() -> None:
    for n, d, theta in stacks(40, seed=5, loss=1.0):
        r = solve(n[:, None], d, [LAM], theta, absorption=True)
        z = np.linspace(-200, d.sum() + 200, 15)
        field = field_profile(n[:, None], d, [LAM], theta, z)
        thick = [np.inf, *d, np.inf]
        for pol in "sp":
            data = tmm.coh_tmm(pol, n, thick, theta, LAM)
            theirs = tmm.absorp_in_each_layer(data)[1:-1]
            assert np.abs(theirs - getattr(r, f"A_{pol}")[:, 0]).max() <= AGAINST_TMM
            for i, depth in enumerate(z):
                where = (0, depth) if depth < 0 else tmm.find_in_structure_with_inf(thick, depth)
                e = tmm.position_resolved(*where, data)
                size = sum(abs(e[key]) ** 2 for key in ("Ex", "Ey", "Ez"))
                assert abs(size - getattr(field, pol)[i, 0]) <= AGAINST_TMM
        theirs = tmm.ellips(n, thick, theta, LAM)
        ours = ellipsometry(r)
        assert abs(theirs["psi"] - ours.psi_rad[0]) <= AGAINST_TMM
        assert abs(np.exp(1j * theirs["Delta"]) - np.exp(1j * (np.pi - ours.delta_rad[0]))) <= AGAINST_TMM


def test_incoherent_layers_agree_with_tmm() -> None:
    rng = np.random.default_rng(6)
    for _ in range(100):
        layers = int(rng.integers(1, 6))
        # kept so transparent that tmm's transfer matrices do not underflow
        n = rng.uniform(1.2, 3, layers + 2) + 3e-4j * rng.random(layers + 2) * (rng.random(layers + 2) < 0.6)
        n[0] = 1.2
        flags = rng.random(layers) < 0.5
        d = np.where(flags, rng.uniform(1e4, 1e5, layers), rng.uniform(10, 400, layers))
        theta = float(rng.uniform(0, 1.5))
        ours = incoherent_powers(n[:, None], d, list(flags), [LAM], theta)
        kinds = ["i", *np.where(flags, "i", "c"), "i"]
        for pol in "sp":
            theirs = tmm.inc_tmm(pol, n, [np.inf, *d, np.inf], kinds, theta, LAM)
            assert abs(theirs["R"] - getattr(ours, f"R_{pol}")[0]) <= AGAINST_TMM
            assert abs(theirs["T"] - getattr(ours, f"T_{pol}")[0]) <= AGAINST_TMM


def test_absorption_beside_incoherent_layers_agrees_with_tmm() -> None:
    rng = np.random.default_rng(16)
    for trial in range(60):
        layers = int(rng.integers(1, 7))
        flags = rng.random(layers) < 0.5
        # thin layers absorb like metals, thick ones little over a wavelength or not at all
        thick_k = 3e-4 * (trial % 2)
        k = np.where(flags, thick_k, 1.0) * rng.random(layers) * (rng.random(layers) < 0.7)
        n = np.array([1.2, *(rng.uniform(1.2, 3, layers) + 1j * k), 1.5])
        d = np.where(flags, rng.uniform(1e4, 1e5, layers), rng.uniform(10, 60, layers))
        theta = float(rng.uniform(0, 1.5))
        stack = Stack(n[0], [Layer(n[j + 1], d[j], incoherent=bool(flags[j])) for j in range(layers)], n[-1])
        ours = dict(zip("sp", stack.absorption([theta], [LAM])))
        seen = stack.powers([theta], [LAM])
        kinds = ["i", *np.where(flags, "i", "c"), "i"]
        for pol in "sp":
            data = tmm.inc_tmm(pol, n, [np.inf, *d, np.inf], kinds, theta, LAM)
            theirs = np.array(tmm.inc_absorp_in_each_layer(data))[1:-1]
            # tmm counts the mixed terms of a wave that enters from an absorbing medium, of the size of its k / n
            assert np.abs(theirs - ours[pol][:, 0, 0]).max() <= 10 * AGAINST_TMM + thick_k
            total = getattr(seen, f"R_{pol}") + getattr(seen, f"T_{pol}") + ours[pol].sum(axis=0)
            assert abs(total[0, 0] - 1.0) <= ENERGY + thick_k


def test_absorption_of_a_coated_window_closes_the_energy() -> None:
    window = Stack(1.0, [Layer(0.06 + 3.6j, 12.0), Layer(1.52, 4e6, incoherent=True), Layer(2 + 0.1j, 50.0)], 1.0)
    theta = [0.0, 0.7, 1.4]
    seen, (absorbed_s, absorbed_p) = window.powers(theta, [450.0, LAM]), window.absorption(theta, [450.0, LAM])
    assert absorbed_s.shape == (3, 3, 2)
    assert absorbed_s[1].max() <= ENERGY and absorbed_p[1].max() <= ENERGY  # the clear pane takes nothing
    assert np.abs(seen.R_s + seen.T_s + absorbed_s.sum(axis=0) - 1).max() <= ENERGY
    assert np.abs(seen.R_p + seen.T_p + absorbed_p.sum(axis=0) - 1).max() <= ENERGY


def test_an_opaque_incoherent_layer_and_total_reflection_stay_finite() -> None:
    pane = Stack(1.0, [Layer(1.5 + 0.1j, 1e7, incoherent=True)], 1.0)
    seen = pane.powers([0.0, 1.0, np.pi / 2], [LAM])
    assert np.all(seen.T_s == 0) and np.allclose(seen.R_s[2], 1)
    gap = Stack(2.0, [Layer(1.0, 1e6, incoherent=True), Layer(1.5, 100.0), Layer(2.0, 1e6, incoherent=True)], 2.0)
    seen = gap.powers([1.2], [LAM])
    assert abs(seen.R_s - 1).max() <= ENERGY and seen.T_s.max() == 0


def test_a_window_pane_reflects_the_textbook_sum() -> None:
    seen = Stack(1.0, [Layer(1.5, 4e6, incoherent=True)], 1.0).powers(0.0, [LAM])
    once = 0.04
    assert abs(seen.reflectance[0] - 2 * once / (1 + once)) <= 1e-12


def test_mueller_matrices_conserve_energy_and_know_circular_light() -> None:
    n, d = np.array([1.0, 1.45, 2.3, 1.5])[:, None], [120.0, 60.0]
    r = solve(n, d, [LAM], [0.0, 0.6, 1.2])
    reflected, transmitted = mueller(jones_reflection(r)), mueller(jones_transmission(r))
    assert np.abs(reflected[..., 0, 0] + transmitted[..., 0, 0] - 1).max() <= ENERGY
    assert np.abs(reflected[..., 0, 0] - r.reflectance).max() <= ENERGY
    assert np.abs(reflected[..., 0, 1] - 0.5 * (r.R_p - r.R_s)).max() <= ENERGY
    # at normal incidence: handedness turns, and U with it, because the p axis is mirrored
    m = reflected[0, 0] / reflected[0, 0, 0, 0]
    assert np.abs(m - np.diag([1, 1, -1, -1])).max() <= 1e-12
    # no depolarisation: tr(M^T M) = 4 M00^2
    trace = np.einsum("...ij,...ij->...", reflected, reflected)
    assert np.abs(trace - 4 * reflected[..., 0, 0] ** 2).max() <= 1e-12


def test_gold_has_the_ellipsometric_angles_that_instruments_print() -> None:
    seen = ellipsometry(solve([[1.0], [0.18 + 3.43j]], [], [632.8], np.radians([0.0, 70.0])))
    assert np.degrees(seen.delta_rad[0, 0]) == pytest.approx(180)
    assert 100 < np.degrees(seen.delta_rad[1, 0]) < 115 and 42 < np.degrees(seen.psi_rad[1, 0]) < 45


def test_a_stack_with_an_incoherent_layer_refuses_amplitudes() -> None:
    with pytest.raises(NacreError, match="incoherent"):
        Stack(1.0, [Layer(1.5, 1e6, incoherent=True)], 1.0).solve(0.0, [LAM])


def test_batches_and_in_plane_wavevectors_of_incoherent_stacks_are_those_of_single_ones() -> None:
    lam = np.array([450.0, 600.0])
    n = np.array([[1.5, 1.48], [2.2, 2.1], [1.5 + 1e-5j, 1.48 + 1e-5j], [1.0, 1.0]])
    d = np.array([[80.0, 2e4], [130.0, 5e4], [0.0, 1e5]])
    kappa = np.array([[0.0, 0.0], [0.7, 0.71], [1.2, 1.2]])
    whole = incoherent_powers(n, d, [False, True], lam, kappa=kappa)
    assert whole.R_s.shape == (3, 3, 2)
    for i, j, l in ((0, 1, 0), (1, 2, 1), (2, 0, 0)):
        angle = np.arcsin(kappa[j, l] / n[0, l].real)
        one = incoherent_powers(n[:, [l]], d[i], [False, True], lam[[l]], angle)
        assert abs(one.R_p[0] - whole.R_p[i, j, l]) <= ENERGY
        assert abs(one.T_s[0] - whole.T_s[i, j, l]) <= ENERGY


def test_powers_need_a_wave_that_arrives() -> None:
    with pytest.raises(NacreError, match="kappa"):
        powers([[1.0], [1.5]], [], [LAM], kappa=[1.1])
    with pytest.raises(NacreError, match="kappa"):  # 1.2 travels at the second wavelength only
        powers([[1.0, 1.5], [1.5, 1.5]], [], [400.0, 700.0], kappa=[0.9, 1.2])
    assert powers([[1.0], [1.5]], [], [LAM], kappa=[1.0]).R_s[0, 0] == pytest.approx(1.0)


def test_the_field_of_an_absorbing_ambient_decays_along_the_wave() -> None:
    found = field_profile([[1.5 + 0.1j], [1.5 + 0.1j]], [], [500.0], 0.0, [-50.0, 50.0]).s.squeeze()
    assert found[1] / found[0] == pytest.approx(np.exp(-4.0 * np.pi * 0.1 * 100.0 / 500.0))
