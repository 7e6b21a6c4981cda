"""The adjoint kernel: the gradients of the JAX twin, of finite differences and of the hard cases."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import oracle_jax
import pytest

from nacre.core.errors import NacreError
from nacre.matter import powers
from nacre.matter.stack import gradient as stack_gradient
from nacre.matter.stack.inputs import powers_of, prepare

GRADIENT = 1e-6  # relative to finite differences; the bar of the film issue
TWINS = 1e-9  # adjoint and JAX, relative to the largest entry
LAM = np.linspace(380.0, 780.0, 83)  # more than one block of 64 wavelengths, and not a multiple
WEIGHT = np.sin(LAM / 50.0)


def bars(shape: tuple[int, ...]) -> dict[str, Any]:
    """Derivatives of a loss that every power enters with its own weight."""
    weight = np.broadcast_to(WEIGHT, shape)
    return {"R_s": weight, "R_p": 2 * weight, "T_s": 3 * weight, "T_p": -weight}


def twin(d: Any, n: Any, k: Any, theta: Any) -> Any:
    """The same through JAX."""

    def loss(d: Any, n: Any, k: Any, theta: Any) -> Any:
        seen = oracle_jax.solve(n + 1j * k, d, LAM, jnp.cos(theta))
        return (WEIGHT * (seen.R_s + 2 * seen.R_p + 3 * seen.T_s - seen.T_p)).sum()

    return oracle_jax.value_and_grad(loss, (0, 1, 2, 3))(d, n, k, theta)[1]


def random_stack(rng: np.random.Generator, layers: int, lossy: bool) -> tuple[np.ndarray, np.ndarray]:
    n = rng.uniform(1.3, 3.0, (layers + 2, 1)) * np.ones(len(LAM)) + 5.0 / LAM
    k = rng.uniform(0.0, 2.0, (layers + 2, 1)) * (rng.random((layers + 2, 1)) < 0.5) * np.ones(len(LAM))
    k = k if lossy else 0.0 * k
    k[0] = 0.0
    return n, k


@pytest.mark.parametrize(("layers", "lossy"), [(0, True), (1, False), (6, True), (20, False), (40, True)])
def test_adjoint_equals_the_jax_twin(layers: int, lossy: bool) -> None:
    rng = np.random.default_rng(layers)
    n, k = random_stack(rng, layers, lossy)
    n[-1] = 3.2  # no critical angle: there the true gradient is infinite
    d = rng.uniform(0.0, 200.0, layers)
    d[::5] = 0.0
    theta = np.array([0.0, 0.4, 1.2])
    wanted = twin(d, n, k, theta)
    ours = stack_gradient.pull_back(n + 1j * k, d, LAM, theta, **bars((3, len(LAM))))
    assert ours.n is not None and ours.k is not None and ours.cos_i is not None
    for mine, theirs in (
        (ours.thicknesses_nm, wanted[0]),
        (ours.n, wanted[1]),
        (ours.k[1:], wanted[2][1:]),
        (-np.sin(theta) * ours.cos_i, wanted[3]),
    ):
        assert np.abs(mine - theirs).max(initial=0.0) <= TWINS * np.abs(theirs).max(initial=0.0)
    alone = stack_gradient.pull_back(n + 1j * k, d, LAM, theta, index=False, **bars((3, len(LAM))))
    assert alone.n is None
    np.testing.assert_allclose(alone.thicknesses_nm, ours.thicknesses_nm, rtol=1e-12, atol=1e-14)


def test_adjoint_agrees_with_finite_differences() -> None:
    rng = np.random.default_rng(3)
    n, k = random_stack(rng, 8, True)
    d, theta = rng.uniform(20.0, 200.0, 8), np.array([0.3, 1.0])

    def value(thicknesses: np.ndarray) -> float:
        seen = powers(n + 1j * k, thicknesses, LAM, theta)
        return float((WEIGHT * (seen.R_s + 2 * seen.R_p + 3 * seen.T_s - seen.T_p)).sum())

    wanted = np.array(
        [
            (8 * (value(d + h) - value(d - h)) - value(d + 2 * h) + value(d - 2 * h)) / 0.12
            for h in 0.01 * np.eye(len(d))
        ]
    )
    ours = stack_gradient.pull_back(n + 1j * k, d, LAM, theta, **bars((2, len(LAM)))).thicknesses_nm
    assert np.abs(ours - wanted).max() <= GRADIENT * np.abs(wanted).max()


def test_loss_of_powers_is_differentiated_through_the_stack() -> None:
    rng = np.random.default_rng(8)
    n, k = random_stack(rng, 12, True)
    d, theta = rng.uniform(20.0, 200.0, 12), [0.0, 0.8]
    ours = stack_gradient.value_and_grad(lambda seen: (seen.reflectance**2).sum(), n + 1j * k, LAM, theta)
    twin_of_it = oracle_jax.value_and_grad(
        lambda d: (oracle_jax.solve(n + 1j * k, d, LAM, jnp.cos(jnp.array(theta))).reflectance ** 2).sum()
    )
    (value, gradient), (wanted, wanted_gradient) = ours(d), twin_of_it(d)
    assert value == pytest.approx(wanted, rel=1e-11)
    assert np.abs(gradient - wanted_gradient).max() <= TWINS * np.abs(wanted_gradient).max()
    assert not jax.config.jax_enable_x64  # the global flag stays the user's


def test_hard_cases_agree_with_the_twin() -> None:
    # opaque metal, a wide tunnelling gap, kz = 0 in a layer, 1000 layers, matched media at grazing incidence
    cases: list[tuple[list[complex], list[float], float]] = [
        ([1.0, 1.5, 0.06 + 3.6j, 1.5], [300.0, 1e5], 0.5),
        ([1.5, 1.0, 1.0, 1.5], [2e5, 0.0], 0.5),
        ([2.0, 1.0, 1.5, 2.0], [200.0, 0.0], float(np.sqrt(0.75))),
        ([1.0, *[2.4, 1.46] * 500, 1.5], [57.0, 94.0] * 500, 0.6),
    ]
    for n, d, cos_i in cases:
        index = np.array(n)[:, None] * np.ones(3)
        lam = np.array([450.0, 550.0, 650.0])
        ours = stack_gradient.pull_back(index, d, lam, cos_i=[cos_i], R_s=1.0, R_p=2.0, T_s=3.0, T_p=4.0)

        def loss(d: Any, n: Any, k: Any, c: Any, lam: np.ndarray = lam) -> Any:
            seen = oracle_jax.solve(n + 1j * k, d, lam, c)
            return (seen.R_s + 2 * seen.R_p + 3 * seen.T_s + 4 * seen.T_p).sum()

        arguments = (np.array(d), index.real, index.imag, np.array([cos_i]))
        wanted = oracle_jax.value_and_grad(loss, (0, 1, 2, 3))(*arguments)[1]
        for mine, theirs in zip((ours.thicknesses_nm, ours.n, ours.k, ours.cos_i), wanted):
            assert mine is not None and np.all(np.isfinite(mine))
            start = 1 if mine.ndim == 2 else 0  # the ambient's k is fixed at 0
            assert np.abs(mine[start:] - theirs[start:]).max() <= 1e-8 * max(np.abs(theirs[start:]).max(), 1e-3)


def test_grazing_incidence_pulls_nothing() -> None:
    seen = stack_gradient.pull_back([[1.0], [1.4], [1.5]], [100.0], [550.0], np.pi / 2, R_s=1.0, T_p=1.0)
    assert not seen.thicknesses_nm.any() and seen.n is not None and not seen.n.any()


def test_what_it_cannot_do_is_one_line() -> None:
    with pytest.raises(NacreError, match="single stack"):
        stack_gradient.pull_back(np.ones((2, 3, 1)), [[1.0], [2.0]], [550.0], 0.0)
    with pytest.raises(NacreError, match="ambient absorbs"):
        stack_gradient.pull_back([[1.0 + 0.1j], [1.5]], [], [550.0], 0.0)
    case = prepare([[1.0], [1.4], [1.5]], [100.0], [550.0], theta_rad=0.0)
    assert powers_of(case).R_s.shape == (1,)
