"""Theory and other codes: free spheres, coated spheres and the angular functions."""

from pathlib import Path

import numpy as np
import pytest

from nacre.families.metasurface.tmatrix.special_functions import (
    angular_functions,
    legendre,
    mirrored,
    plane_wave_vectors,
)
from nacre.matter.mie import default_order, mie_amplitudes, mie_coefficients, mie_efficiencies

REFERENCE = Path(__file__).parents[2] / ".." / "shared" / "reference" / "metasurface"
MIE_BAR = 1e-10
ROUNDING = 1e-13


def test_mie_agrees_with_miepython():
    """Amplitudes in relative L2, efficiencies relative, at the truncation of the reference."""
    if not REFERENCE.is_dir():
        pytest.skip("../shared/reference is absent")
    data = np.load(REFERENCE / "mie.npz")
    for i, x in enumerate(data["x"]):
        a, b = mie_coefficients(default_order(x), [x], [data["n_sphere"][i]])
        q = mie_efficiencies(a, b, x)
        for ours, name in ((q.extinction, "Qext"), (q.scattering, "Qsca"), (q.backscattering, "Qback")):
            assert abs(ours / data[name][i] - 1) <= MIE_BAR, (i, name)
        assert abs(q.asymmetry - data["g"][i]) <= MIE_BAR
        for ours, name in zip(mie_amplitudes(a, b, data["mu"]), ("S1", "S2")):
            assert np.linalg.norm(ours - data[name][i]) <= MIE_BAR * np.linalg.norm(data[name][i])


def test_coating_of_the_core_material_changes_nothing():
    a, b = mie_coefficients(10, [1.7], [3.9 + 0.02j])
    for split in (0.2, 0.9, 0.999):
        a2, b2 = mie_coefficients(10, [1.7 * split, 1.7], [3.9 + 0.02j, 3.9 + 0.02j])
        assert np.abs(a2 - a).max() < ROUNDING and np.abs(b2 - b).max() < ROUNDING


def test_coating_of_the_ambient_changes_nothing():
    a, b = mie_coefficients(10, [1.1], [0.05 + 3.1j])
    a2, b2 = mie_coefficients(10, [1.1, 1.7], [0.05 + 3.1j, 1.0])
    assert np.abs(a2 - a).max() < ROUNDING and np.abs(b2 - b).max() < ROUNDING


def test_thick_absorbing_coating_hides_the_core():
    a, b = mie_coefficients(30, [10.0, 20.0], [1.5, 2.0 + 5.0j])
    a2, b2 = mie_coefficients(30, [10.0, 20.0], [0.1 + 3.0j, 2.0 + 5.0j])
    assert np.abs(a2 - a).max() < ROUNDING and np.abs(b2 - b).max() < ROUNDING


def test_core_shell_limit_of_small_spheres_is_the_coated_dipole():
    """Bohren & Huffman eq. 5.36: the static polarisability of a coated sphere."""
    x, ratio, m_core, m_shell = 1e-3, 0.7, 1.9 + 0.1j, 1.4 + 0.0j
    a, _ = mie_coefficients(1, [x * ratio, x], [m_core, m_shell])
    e1, e2, f = m_core**2, m_shell**2, ratio**3
    alpha = ((e2 - 1) * (e1 + 2 * e2) + f * (e1 - e2) * (1 + 2 * e2)) / (
        (e2 + 2) * (e1 + 2 * e2) + f * (2 * e2 - 2) * (e1 - e2)
    )
    assert abs(a[0] / (-2j / 3 * x**3 * alpha) - 1) < 1e-5


def test_lossless_spheres_scatter_all_they_extinguish():
    a, b = mie_coefficients(12, [0.7, 1.4, 1.9], [2.0, 1.5, 3.0])
    q = mie_efficiencies(a, b, 1.9)
    assert abs(q.absorption) < 1e-12


def test_angular_functions_are_derivatives_of_legendre():
    theta, h = np.linspace(0.3, 2.8, 7), 1e-5
    tau, mpi = angular_functions(np.cos(theta), 6, 4)
    derivative = (legendre(np.cos(theta + h), 6, 4) - legendre(np.cos(theta - h), 6, 4)) / (2 * h)
    values = legendre(np.cos(theta), 6, 4)
    m = np.arange(5)[:, None, None]
    assert np.abs(tau - derivative[:, 1:]).max() < 1e-8
    assert np.abs(mpi - m * values[:, 1:] / np.sin(theta)).max() < 1e-12


def test_angular_functions_agree_at_real_and_complex_angles():
    w = np.linspace(-0.99, 0.99, 9)
    real, cplx = angular_functions(w, 8, 4), angular_functions(w.astype(complex), 8, 4)
    assert max(np.abs(r - c).max() for r, c in zip(real, cplx)) < 1e-12


def test_mirrored_vectors_are_those_of_the_opposite_cosine():
    w = np.array([0.3, 0.8 + 0.4j, 1.0 + 3.0j])
    b = plane_wave_vectors(w, 7, 4)
    assert np.abs(mirrored(b) / np.abs(b).max() - plane_wave_vectors(-w, 7, 4) / np.abs(b).max()).max() < ROUNDING
