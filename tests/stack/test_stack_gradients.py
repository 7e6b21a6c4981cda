"""The JAX twin: the same numbers as the numba kernel, and gradients that finite differences confirm."""

from __future__ import annotations

import functools
import importlib.util
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import oracle_jax
import pytest

from nacre.core.errors import MachineError
from nacre.matter import powers, solve
from nacre.matter.stack.gradient import double_precision, value_and_grad

TWINS = 1e-12  # numba and JAX
GRADIENT = 1e-6  # relative; the bar of the film issue
LAM = np.linspace(400.0, 760.0, 9)


@pytest.mark.parametrize("layers", [0, 7])
def test_the_twins_agree(layers: int) -> None:
    rng = np.random.default_rng(layers)
    n = rng.uniform(1.2, 4, (8, layers + 2, 7)) + 1j * rng.uniform(0, 5, (8, layers + 2, 7)) * (
        rng.random((8, layers + 2, 1)) < 0.5
    )
    n[:, 0] = 1.3
    d, lam, cos_i = rng.uniform(0, 500, (8, layers)), np.linspace(380, 780, 7), np.array([0, 1e-4, 0.1, 0.5, 0.9, 1.0])
    ours = solve(n, d, lam, cos_i=cos_i)
    with double_precision():
        twin = jax.jit(oracle_jax.solve)(n, d, lam, cos_i)
    for key in twin._fields:
        assert np.abs(getattr(ours, key) - np.asarray(getattr(twin, key))).max() <= TWINS


def test_the_twins_agree_where_it_is_hard() -> None:
    cases: list[tuple[list[complex], list[float], float]] = [
        ([1.0, 1.5, 0.06 + 3.6j, 1.5], [300.0, 1e5], 0.5),
        ([1.5, 1.0, 1.0, 1.5], [2e5, 0.0], 0.5),
        ([2.0, 1.0, 1.5, 2.0], [200.0, 0.0], float(np.sqrt(0.75))),
        ([1.0, *[2.4, 1.46] * 500, 1.5], [57.0, 94.0] * 500, 0.6),
        ([1.5, 1.5, 1.5, 1.5], [100.0, 0.0], 0.0),
    ]
    for n, d, cos_i in cases:
        ours = solve(np.array(n)[:, None], d, [550.0], cos_i=[cos_i])
        with double_precision():
            twin = jax.jit(oracle_jax.solve)(np.array(n)[:, None], np.array(d), np.array([550.0]), np.array([cos_i]))
        for key in twin._fields:
            assert np.abs(getattr(ours, key) - np.asarray(getattr(twin, key))).max() <= 1e-11


def measure(d: Any, n: Any, k: Any, theta: Any, xp: Any, solver: Any) -> Any:
    """A number that every output enters with its own weight."""
    seen = solver((n + 1j * k)[:, None] * xp.ones((1, len(LAM))), d, LAM, cos_i=xp.cos(theta))
    weight = xp.sin(LAM / 50.0)
    return (weight * (seen.R_s + 2 * seen.R_p + 3 * seen.T_s - seen.T_p)).sum()


@functools.cache
def compiled_measure() -> Any:
    """Value and gradients of `measure` in all four arguments; compiled once a shape."""
    return oracle_jax.value_and_grad(lambda d, n, k, t: measure(d, n, k, t, jnp, oracle_jax.solve), (0, 1, 2, 3))


def differences(arguments: list[np.ndarray], which: int, steps: float, first: int = 0) -> np.ndarray:
    """Central differences of the numba kernel, Richardson-extrapolated: error of fourth order; 0 before `first`."""
    gradient = np.zeros_like(arguments[which])
    for i in range(first, gradient.size):

        def slope(h: float, i: int = i) -> float:
            values = []
            for sign in (1, -1):
                moved = [a.copy() for a in arguments]
                moved[which][i] += sign * h
                values.append(measure(*moved, np, powers))
            return (values[0] - values[1]) / (2 * h)

        gradient[i] = (4 * slope(steps) - slope(2 * steps)) / 3
    return gradient


def test_gradients_agree_with_finite_differences() -> None:
    rng = np.random.default_rng(11)
    compiled = compiled_measure()
    for _ in range(3):
        n = rng.uniform(1.3, 2.5, 8)
        k = rng.uniform(0.01, 0.5, 8)
        k[0] = 0.0
        arguments = [rng.uniform(20, 200, 6), n, k, np.array([0.2, 0.9, 1.4])]
        value, gradients = compiled(*arguments)
        assert value == pytest.approx(measure(*arguments, np, powers), rel=1e-11)
        for which, step in ((0, 1e-2), (1, 1e-4), (2, 1e-4), (3, 1e-4)):
            first = 1 if which == 2 else 0  # the ambient's k is fixed at 0
            wanted = differences(arguments, which, step, first)
            assert np.abs(gradients[which] - wanted)[first:].max() <= GRADIENT * np.abs(wanted).max()


def test_gradients_are_right_at_zero_thickness_normal_incidence_and_equal_indices() -> None:
    # one-sided differences cannot be avoided in thickness (d >= 0): the twin itself takes d < 0 and is even simpler,
    # so the check is a Richardson pair of the JAX value around 0
    compiled = compiled_measure()
    d = np.array([0.0, 100.0, 0.0, 50.0])
    n = np.array([1.0, 1.5, 1.5, 2.0, 1.5, 1.5])
    k = np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    theta = np.array([0.0, 0.7])
    arguments = [d, n, k, theta]
    _, gradients = compiled(*arguments)
    for gradient in gradients:
        assert np.all(np.isfinite(gradient))

    def value(which: int, i: int, h: float) -> float:
        moved = [a.copy() for a in arguments]
        moved[which][i] += h
        return compiled(*moved)[0]

    for which, step in ((0, 1e-1), (1, 1e-4), (3, 1e-3)):
        wanted = np.array(
            [
                (
                    8 * (value(which, i, step) - value(which, i, -step))
                    - value(which, i, 2 * step)
                    + value(which, i, -2 * step)
                )
                / (12 * step)
                for i in range(len(arguments[which]))
            ]
        )
        assert np.abs(gradients[which] - wanted).max() <= GRADIENT * np.abs(wanted).max()


def test_gradients_are_those_of_the_values_at_awkward_points() -> None:
    def total(d: Any, n: Any, c: Any) -> Any:
        seen = oracle_jax.solve(n[:, None] + 0j, d, LAM, c)
        return sum(jnp.sum(jnp.abs(x) ** 2) for x in seen[4:]) + jnp.sum(seen.r_s.real + seen.t_p.imag)

    compiled = oracle_jax.value_and_grad(total, (0, 1, 2))
    # 90 degrees, normal incidence, and kz = 0 in the layers of n = 1 between n = 2
    for cos_i in (0.0, 1.0, float(np.sqrt(0.75))):
        for n in ([2.0, 1.0, 1.0, 2.0], [2.0, 2.0, 2.0, 2.0], [1.0, 1.5, 2.0, 1.5], [1.5, 1.0, 1.0, 1.0]):
            for d in ([0.0, 0.0], [200.0, 0.0], [2e5, 1.0]):
                at = np.array(d), np.array(n), np.array([cos_i])
                value, gradients = compiled(*at)
                for gradient in (np.array(value), *gradients):
                    assert np.all(np.isfinite(gradient)), (cos_i, n, d)
                if max(d) < 1e3:  # else steps small enough for the phase drown in rounding
                    step = 1e-6
                    for which in (0, 1):
                        ends = []
                        for sign in (1, -1):
                            moved = [a.copy() for a in at]
                            moved[which] += sign * step * np.linspace(1.0, 0.4, len(moved[which]))
                            ends.append(float(compiled(*moved)[0]))
                        along = float(gradients[which] @ np.linspace(1.0, 0.4, len(gradients[which])))
                        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(along, rel=1e-4, abs=1e-6)


def test_global_precision_is_left_alone() -> None:
    before = jax.config.jax_enable_x64
    compiled = oracle_jax.value_and_grad(lambda d: oracle_jax.solve(np.ones((3, 9)) + 0j, d, LAM, [1.0]).R_s.sum())
    compiled(np.array([10.0]))
    assert jax.config.jax_enable_x64 == before
    assert jnp.ones(1).dtype == (jnp.float64 if before else jnp.float32)


def test_a_missing_jax_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MachineError, match=r"nacre\[gradient\]"):
        value_and_grad(lambda powers: powers.reflectance.sum(), [[1.0], [1.4], [1.5]], [550.0], [0.0])
