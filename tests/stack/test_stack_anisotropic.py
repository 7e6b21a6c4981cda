"""Anisotropic and helical stacks: against an independent solver, the isotropic kernel, 400 digits and invariants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.matter.indices.crystal import euler_axes
from nacre.matter.stack.anisotropic import AnisotropicLayer, solve_anisotropic
from nacre.matter.stack.solve import mueller, solve

REFERENCE = Path(__file__).resolve().parents[3] / "shared" / "reference" / "anisotropic" / "anisotropic_open.npz"
REFERENCE_BAR = 1e-9  # the reference agrees with pyElli to 2e-15; its own rounding is far below
HELIX_BAR = 1e-5  # the reference is extrapolated to about 1e-6
ROUNDING = 1e-12  # of powers of order 1
DIGITS_BAR = 1e-10  # phases of up to 1e4 radians keep eleven digits
CIRCULAR = np.array([[1, 1], [-1j, 1j]]) / np.sqrt(2)  # (right, left) -> (p, s): S3 = 2 Im(p s*) is +1, -1


@pytest.fixture(scope="module")
def reference() -> Any:
    if not REFERENCE.exists():
        pytest.skip("the shared reference data are not here")
    return np.load(REFERENCE)


def principal_tensor(indices: Any, euler_deg: Any = (0.0, 0.0, 0.0)) -> Any:
    """Return R diag(n^2) R^T with the principal axes as the columns of Rz(a) Rx(b) Rz(c)."""
    axes = euler_axes((euler_deg[0], euler_deg[1], euler_deg[2]))
    return np.einsum("ij,...j,kj->...ik", axes, np.asarray(indices, dtype=complex) ** 2, axes)


def test_the_stacks_of_an_independent_solver_are_reproduced(reference: Any) -> None:
    for i in range(len(reference["stack_layers"])):
        layers = [
            AnisotropicLayer(
                principal_tensor(reference["stack_layer_n"][i, j], reference["stack_layer_euler_deg"][i, j]),
                float(reference["stack_layer_thickness_nm"][i, j]),
            )
            for j in range(int(reference["stack_layers"][i]))
        ]
        found = solve_anisotropic(
            float(np.real(reference["stack_n_ambient"][i])),
            layers,
            principal_tensor(reference["stack_substrate_n"][i], reference["stack_substrate_euler_deg"][i]),
            float(reference["stack_wavelength_nm"][i]),
            np.radians(float(reference["stack_theta_deg"][i])),
            absorption=True,
        )
        for ours, theirs in (
            (found.jones_reflected, "stack_jones_reflected"),
            (found.R, "stack_R"),
            (found.T_in, "stack_T_in"),
            (found.mueller_reflected, "stack_mueller_reflected"),
        ):
            np.testing.assert_allclose(
                ours[0, 0], reference[theirs][i], atol=REFERENCE_BAR, rtol=0, err_msg=f"{theirs} {i}"
            )
        assert found.absorbed is not None
        absorbed = np.diagonal(found.absorbed.sum(axis=0), axis1=-2, axis2=-1).real
        np.testing.assert_allclose(found.R.sum(axis=-2) + found.T_in + absorbed, 1.0, atol=1e-11)


def test_the_cholesterics_of_an_independent_solver_are_reproduced(reference: Any) -> None:
    for i in range(len(reference["cholesteric_n_o"])):
        n_o, n_e, pitch = (float(reference[f"cholesteric_{k}"][i]) for k in ("n_o", "n_e", "pitch_nm"))
        layer = AnisotropicLayer(
            principal_tensor([n_e, n_o, n_o], [float(reference["cholesteric_azimuth_deg"][i]), 0, 0]),
            pitch * float(reference["cholesteric_half_turns"][i]) / 2,
            pitch,
            int(reference["cholesteric_handedness"][i]),
        )
        found = solve_anisotropic(
            1.0,
            [layer],
            np.asarray(complex(reference["cholesteric_n_substrate"][i]) ** 2),
            reference["wavelengths_nm"],
            np.radians(float(reference["cholesteric_theta_deg"][i])),
        )
        np.testing.assert_allclose(found.R[0], reference["cholesteric_R"][i], atol=HELIX_BAR, rtol=0)
        np.testing.assert_allclose(found.T_in[0], reference["cholesteric_T_in"][i], atol=HELIX_BAR, rtol=0)
        circular = np.abs(CIRCULAR.conj().T @ found.jones_reflected[0] @ CIRCULAR) ** 2
        np.testing.assert_allclose(circular, reference["cholesteric_R_circular"][i], atol=HELIX_BAR, rtol=0)


def test_a_cholesteric_reflects_one_hand_between_the_edges_n_o_p_and_n_e_p() -> None:
    """n 1.5/1.7, pitch 650 nm, 7.5 turns: coupled-mode theory gives tanh^2(pi dn/n turns) at the centre."""
    layer = AnisotropicLayer(principal_tensor([1.7, 1.5, 1.5]), 7.5 * 650.0, 650.0)
    waves = np.array([940.0, 980.0, 1010.0, 1040.0, 1070.0, 1100.0, 1145.0])
    found = solve_anisotropic(1.55, [layer], np.asarray(1.55**2 + 0j), waves, 0.0)
    power = (np.abs(CIRCULAR.conj().T @ found.jones_reflected[0] @ CIRCULAR) ** 2).sum(axis=-2)
    right, left = power[:, 0], power[:, 1]
    assert right[3] == pytest.approx(np.tanh(np.pi * 0.2 / 1.6 * 7.5) ** 2, abs=0.002)  # to first order in dn/n
    assert np.all(right[1:-1] > 0.8) and right[0] < 0.5 and right[-1] < 0.5
    assert np.all(left < 0.01)  # Fresnel reflection between 1.55 and 1.6 is 0.001


def test_isotropic_layers_give_the_answer_of_the_isotropic_kernel() -> None:
    g = np.random.default_rng(1)
    waves, angles = np.array([450.0, 633.0]), np.array([0.0, 0.5, 1.2, 1.55])
    for _ in range(60):
        count = int(g.integers(1, 7))
        n = [1.0, *(complex(g.uniform(1.3, 3.5), g.choice([0, 0, g.uniform(0, 4)])) for _ in range(count))]
        n.append(complex(g.uniform(1.3, 3), g.choice([0, 1.0])))
        thicknesses = g.uniform(0, 600, count)
        expected = solve(np.stack([np.full(2, v, complex) for v in n]), thicknesses, waves, angles)
        layers = [AnisotropicLayer(np.eye(3) * v**2, d) for v, d in zip(n[1:-1], thicknesses)]
        found = solve_anisotropic(1.0, layers, np.asarray(n[-1] ** 2), waves, angles)
        np.testing.assert_allclose(found.R[..., 0, 0], expected.R_p, atol=ROUNDING)
        np.testing.assert_allclose(found.jones_reflected[..., 1, 1], expected.r_s, atol=ROUNDING)
        np.testing.assert_allclose(found.T_in[..., 0], expected.T_p, atol=ROUNDING)
        np.testing.assert_allclose(found.T_in[..., 1], expected.T_s, atol=ROUNDING)
        assert np.abs(found.jones_reflected[..., 0, 1]).max() < ROUNDING


def random_case(g: np.random.Generator) -> tuple[float, list[AnisotropicLayer], Any, float, float, float]:
    layers = []
    for _ in range(int(g.integers(1, 7))):
        pitch = float(g.uniform(200, 800)) if g.random() < 0.2 else None
        indices, angles = g.uniform(1.3, 2.6, 3), g.uniform(0, 180, 3)
        layers.append(AnisotropicLayer(principal_tensor(indices, angles), float(g.uniform(0, 900)), pitch, 1, 16))
    substrate = np.asarray(complex(g.uniform(1, 2)) ** 2)
    if g.random() < 0.5:
        substrate = principal_tensor(g.uniform(1.3, 2, 3), g.uniform(0, 180, 3))
    return (
        float(g.uniform(1, 1.8)), layers, substrate, float(g.uniform(350, 900)), float(g.uniform(0, 1.5)),
        float(g.uniform(0, 6.28)),
    )  # fmt: skip


def test_lossless_stacks_conserve_energy_and_are_reciprocal() -> None:
    """R + T = 1 for every incident state; the reversed path has the transposed matrix with p reversed."""
    g = np.random.default_rng(2)
    flip = np.diag([1.0, -1.0])
    for _ in range(300):
        ambient, layers, substrate, wave, theta, azimuth = random_case(g)
        there = solve_anisotropic(ambient, layers, substrate, wave, theta, azimuth)
        jones = there.jones_reflected[0, 0]
        np.testing.assert_allclose(jones.conj().T @ jones + there.transmitted[0, 0], np.eye(2), atol=ROUNDING)
        back = solve_anisotropic(ambient, layers, substrate, wave, theta, azimuth + np.pi)
        np.testing.assert_allclose(mueller(back.jones_reflected[0, 0]), mueller(flip @ jones.T @ flip), atol=ROUNDING)


def exact_jones(n0: float, layers: list[tuple[Any, float]], substrate: Any, wave: float, theta: float) -> Any:
    """Return the reflected Jones matrix by transfer matrices of 400 digits, given tensors as nested lists."""
    with mpmath.workdps(400):
        kx, k0 = n0 * mpmath.sin(theta), 2 * mpmath.pi / wave
        d = _exact_berreman(substrate, kx)
        values, vectors = mpmath.eig(d)
        down = [i for i in range(4) if mpmath.im(values[i]) > mpmath.mpf(10) ** -100]
        if len(down) != 2:
            flux = [
                mpmath.re(vectors[0, i] * mpmath.conj(vectors[1, i]) + vectors[2, i] * mpmath.conj(vectors[3, i]))
                for i in range(4)
            ]
            clear = [i for i in range(4) if abs(mpmath.im(values[i])) <= mpmath.mpf(10) ** -100]
            down += sorted(clear, key=lambda i: -flux[i])[: 2 - len(down)]
        psi = mpmath.matrix(4, 2)
        for column, i in enumerate(down):
            for row in range(4):
                psi[row, column] = vectors[row, i]
        for tensor, thickness in reversed(layers):
            step = -1j * k0 * thickness * _exact_berreman(tensor, kx)
            psi = mpmath.expm(step, method="taylor") * psi if mpmath.mnorm(step) < 200 else _exact_exp(step) * psi
        c = mpmath.cos(theta)
        incoming = mpmath.matrix([[c, 0], [n0, 0], [0, 1], [0, n0 * c]])
        outgoing = mpmath.matrix([[-c, 0], [n0, 0], [0, 1], [0, -n0 * c]])
        # incoming e + outgoing r = psi x
        system = mpmath.matrix(4, 4)
        for row in range(4):
            for column in range(2):
                system[row, column], system[row, 2 + column] = outgoing[row, column], -psi[row, column]
        answer = mpmath.lu_solve(system, -incoming[:, 0]), mpmath.lu_solve(system, -incoming[:, 1])
        return np.array([[complex(answer[j][i]) for j in range(2)] for i in range(2)])


def _exact_exp(m: Any) -> Any:
    halvings = int(mpmath.log(mpmath.mnorm(m), 2)) + 8
    result = mpmath.expm(m / mpmath.mpf(2) ** halvings, method="taylor")
    for _ in range(halvings):
        result = result * result
    return result


def _exact_berreman(e: Any, kx: Any) -> Any:
    e = [[mpmath.mpmathify(complex(v)) for v in row] for row in np.asarray(e)]
    d, over = mpmath.matrix(4, 4), 1 / e[2][2]
    d[0, 0], d[0, 1], d[0, 2] = -kx * e[2][0] * over, 1 - kx**2 * over, -kx * e[2][1] * over
    d[1, 0], d[1, 1] = e[0][0] - e[0][2] * e[2][0] * over, -kx * e[0][2] * over
    d[1, 2], d[2, 3] = e[0][1] - e[0][2] * e[2][1] * over, 1
    d[3, 0], d[3, 1] = e[1][0] - e[1][2] * e[2][0] * over, -kx * e[1][2] * over
    d[3, 2] = e[1][1] - e[1][2] * e[2][1] * over - kx**2
    return d


TILTED = principal_tensor([1.5, 1.6, 1.8], [20, 40, 60])
METAL = principal_tensor([0.2 + 3.4j, 0.25 + 3.2j, 0.2 + 3.0j], [10, 30, 0])
NEARLY_ISOTROPIC = principal_tensor([1.6, 1.6 + 1e-9, 1.6 - 1e-9], [13, 29, 71])
RARE = principal_tensor([1.3, 1.4, 1.45], [30, 50, 10])
# both waves along z are one: e_xy = +-i (e_xx - e_yy) / 2, without a second eigenvector (Voigt 1902)
VOIGT = np.array([[2.556316 + 0.44j, 0.143j, 0], [0.143j, 2.270316 + 0.44j, 0], [0, 0, 2.5 + 0.3j]])
EXTREMES = {
    "1 mm": (1.0, [(TILTED, 1e6)], np.eye(3) * 2.3, 0.6),
    "opaque metal": (1.0, [(TILTED, 300.0), (METAL, 5000.0)], np.eye(3) * 2.3, 0.9),
    "evanescent gap": (1.8, [(np.eye(3) * 1.0, 3000.0), (TILTED, 200.0)], np.eye(3) * 3.2, 1.2),
    "axis along k": (1.0, [(principal_tensor([1.5, 1.5, 1.7]), 700.0)], np.eye(3) * 2.25, 0.0),
    "equal indices": (1.0, [(principal_tensor([1.6, 1.6, 1.6], [13, 29, 71]), 700.0)], np.eye(3) * 2.25, 0.7),
    "nearly equal indices": (1.0, [(NEARLY_ISOTROPIC, 700.0)], np.eye(3) * 2.25, 0.7),
    "cut-off in a layer": (1.5, [(np.eye(3) * 1.44, 900.0)], np.eye(3) * 2.25, float(np.arcsin(1.2 / 1.5))),
    "near cut-off in a layer": (1.5, [(principal_tensor([1.2, 1.2, 1.3], [0, 50, 0]), 900.0)], np.eye(3) * 2.25, 0.93),
    "total reflection at a tilted substrate": (1.8, [(TILTED, 150.0)], RARE, 1.3),
    "one evanescent mode in the substrate": (2.0, [(TILTED, 150.0)], principal_tensor([1.4, 1.4, 1.6]), 0.8),
    "Voigt wave in a layer": (1.0, [(VOIGT, 900.0)], np.eye(3) * 2.3, 0.0),
    "Voigt wave in the substrate": (1.0, [(TILTED, 150.0)], VOIGT, 0.0),
    "nearly a Voigt wave in the substrate": (1.0, [(VOIGT, 150.0)], VOIGT, 1e-6),
    "zero thickness": (1.0, [(TILTED, 0.0)], np.eye(3) * 2.3, 1.0),
}  # fmt: skip


@pytest.mark.parametrize("name", EXTREMES)
def test_extreme_layers_are_finite_and_agree_with_400_digits(name: str) -> None:
    ambient, layers, substrate, theta = EXTREMES[name]
    ours = solve_anisotropic(ambient, [AnisotropicLayer(t, d) for t, d in layers], substrate, 550.0, theta)
    assert np.all(np.isfinite(ours.jones_reflected)) and np.all(np.isfinite(ours.transmitted))
    expected = exact_jones(ambient, layers, substrate, 550.0, theta)
    np.testing.assert_allclose(ours.jones_reflected[0, 0], expected, atol=DIGITS_BAR, rtol=0)


def test_a_layer_split_in_two_is_the_same_layer() -> None:
    whole = solve_anisotropic(1.0, [AnisotropicLayer(TILTED, 700.0)], METAL, [450.0, 600.0], [0.0, 1.0], 0.4)
    halves = [AnisotropicLayer(TILTED, 300.0), AnisotropicLayer(TILTED, 400.0)]
    parts = solve_anisotropic(1.0, halves, METAL, [450.0, 600.0], [0.0, 1.0], 0.4)
    np.testing.assert_allclose(parts.jones_reflected, whole.jones_reflected, atol=ROUNDING)


@pytest.mark.parametrize(
    "make",
    [
        lambda: AnisotropicLayer(np.array([[1, 2, 0], [0, 1, 0], [0, 0, 1]]), 1.0),
        lambda: AnisotropicLayer(np.eye(3), -1.0),
        lambda: AnisotropicLayer(np.eye(3), 1.0, pitch_nm=0.0),
        lambda: AnisotropicLayer(np.eye(3), 1.0, pitch_nm=1.0, handedness=0),
        lambda: solve_anisotropic(1.0, [], np.asarray(2.25), 500.0, np.pi / 2),
        lambda: solve_anisotropic(1.0 + 0.1j, [], np.asarray(2.25), 500.0, 0.0),  # type: ignore[arg-type]
    ],
)
def test_bad_layers_and_angles_are_refused(make: Any) -> None:
    with pytest.raises(NacreError):
        make()
