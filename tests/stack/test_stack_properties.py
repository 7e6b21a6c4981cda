"""What must hold for every stack: energy, splitting, reciprocity, and independence of batch and thread shapes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nacre.matter import Layer, Stack, amplitudes, powers, solve

EXACT = 1e-12  # the bar of the film issue
LAM = np.array([400.0, 555.0, 800.0])

indices = st.tuples(st.floats(1.0, 4.0), st.sampled_from([0.0, 0.0, 1e-6, 0.01, 0.5, 4.0])).map(lambda x: complex(*x))
layers = st.lists(st.tuples(indices, st.floats(0, 800)), max_size=6)
angles = st.floats(0, 1.56)


def arrays(ambient: float, films: list, substrate: complex) -> tuple[np.ndarray, np.ndarray]:
    n = np.array([ambient, *[f[0] for f in films], substrate], dtype=complex)
    return np.broadcast_to(n[:, None], (len(n), len(LAM))), np.array([f[1] for f in films], dtype=float)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.floats(1, 2), layers, indices, angles)
def test_no_energy_is_lost_or_made(ambient: float, films: list, substrate: complex, theta: float) -> None:
    n, d = arrays(ambient, films, substrate)
    seen = solve(n, d, LAM, theta, absorption=True)
    for R, T, A in ((seen.R_s, seen.T_s, seen.A_s), (seen.R_p, seen.T_p, seen.A_p)):
        assert A is not None
        assert abs(R + T + A.sum(axis=0) - 1).max() <= EXACT
        assert R.min() >= 0 and T.min() >= 0 and A.min(initial=0) >= -EXACT


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.floats(1, 2), layers.filter(len), indices, angles, st.floats(0, 1), st.integers(0, 5))
def test_splitting_a_layer_changes_nothing(
    ambient: float, films: list, substrate: complex, theta: float, share: float, which: int
) -> None:
    j = which % len(films)
    n, d = arrays(ambient, films, substrate)
    split = [*films[:j], (films[j][0], share * films[j][1]), (films[j][0], (1 - share) * films[j][1]), *films[j + 1 :]]
    n2, d2 = arrays(ambient, split, substrate)
    a, b = solve(n, d, LAM, theta), solve(n2, d2, LAM, theta)
    for key in ("R_s", "R_p", "T_s", "T_p", "r_s", "r_p", "t_s", "t_p"):
        assert abs(getattr(a, key) - getattr(b, key)).max() <= EXACT


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.floats(1, 2), layers, st.floats(1, 3), angles)
def test_transmittance_is_reciprocal(ambient: float, films: list, substrate: float, theta: float) -> None:
    # the same in-plane wavevector from either side; lossless half-spaces, any layers
    kappa = ambient * np.sin(theta)
    if kappa >= substrate * (1 - 1e-6):  # no wave travels there
        return
    n, d = arrays(ambient, films, substrate)
    down = solve(n, d, LAM, theta)
    up = solve(n[::-1], d[::-1], LAM, cos_i=np.sqrt(1 - (kappa / substrate) ** 2))
    assert abs(down.T_s - up.T_s).max() <= EXACT
    assert abs(down.T_p - up.T_p).max() <= EXACT


def test_shapes_and_threads_do_not_change_a_number() -> None:
    rng = np.random.default_rng(7)
    n = rng.uniform(1.2, 3, (4, 1, 5, 70)) + 1j * rng.uniform(0, 1, (4, 1, 5, 70))
    n[:, :, 0] = 1
    d = rng.uniform(0, 300, (6, 3))
    lam, theta = np.linspace(380, 780, 70), np.linspace(0, 1.5, 9)
    whole = powers(n, d, lam, theta, jobs=1)
    assert whole.R_s.shape == (4, 6, 9, 70)
    threaded = powers(n, d, lam, theta, jobs=3)
    assert np.array_equal(whole.R_p, threaded.R_p)
    for i, j in ((0, 0), (3, 5)):
        one = solve(n[i, 0], d[j], lam, theta)
        assert np.array_equal(one.T_s, whole.T_s[i, j])
    few = powers(n[..., 10:13], d, lam[10:13], theta)  # few wavelengths take the joined axes
    assert abs(few.R_s - whole.R_s[..., 10:13]).max() <= EXACT
    single = solve(n[0, 0, :, 12:13], d[0], lam[12:13], theta[4], absorption=True)
    assert single.r_s.shape == (1,) and single.A_s is not None and single.A_s.shape == (3, 1)


def test_read_only_and_strided_arrays_are_taken_as_they_are() -> None:
    n = np.broadcast_to(np.array([1.0, 1.5, 2.0])[:, None], (3, 40))
    lam = np.linspace(380, 780, 80)[::2]
    lam.setflags(write=False)
    before = lam.copy()
    seen = powers(n, np.array([100.0]), lam, 0.3)
    assert np.array_equal(lam, before) and np.all(seen.R_s < 1)


def test_a_stack_is_the_arrays_that_it_stands_for() -> None:
    stack = Stack(1.0, [Layer(1.46, 120.0), Layer(np.array([2.3, 2.2, 2.1]), 60.0)], 3.9 + 0.02j)
    n = np.array([[1.0] * 3, [1.46] * 3, [2.3, 2.2, 2.1], [3.9 + 0.02j] * 3])
    seen, wanted = stack.solve(0.4, LAM), solve(n, [120.0, 60.0], LAM, 0.4)
    assert np.array_equal(seen.r_p, wanted.r_p)
    assert np.array_equal(stack.amplitudes(LAM, kappa=[0.2]).r_s, amplitudes(n, [120.0, 60.0], LAM, kappa=[0.2]).r_s)
    back = stack.reversed()
    assert back.ambient == 3.9 + 0.02j and back.layers[0].thickness_nm == 60.0


def test_amplitudes_have_the_stated_signs() -> None:
    seen = solve([[1.0], [1.5]], [], [550.0], 0.0)
    assert abs(seen.r_s[0] + 0.2) + abs(seen.r_p[0] - 0.2) <= EXACT
    assert abs(seen.t_s[0] - 0.8) + abs(seen.t_p[0] - 0.8) <= EXACT
