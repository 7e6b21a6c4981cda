"""The fast solver of lines: reference gratings, exact laws, resonances, and batches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from helpers_grating import recipe, reference

import nacre
from nacre.core.arrays import interpolate
from nacre.core.machine import single_threaded_blas
from nacre.matter.periodic import lamellar_states
from nacre.matter.periodic.lamellar_solver import solve_lamellar
from nacre.matter.periodic.order_tables import order_tables
from nacre.matter.periodic.scattering_matrix import tangent_over_root
from nacre.matter.periodic.solve import difference, solve_coarse, solve_many
from nacre.matter.periodic.structure import Cell, OrderSolution, PatternLayer, PeriodicStack, Rectangle

Wave = tuple[PeriodicStack, float, float, float]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Solve as the product does: matrices are too small for several threads."""
    with single_threaded_blas():
        yield


def wave(made: dict[str, Any], wavelength_nm: float, theta_deg: float, phi_deg: float) -> Wave:
    model: Any = nacre.load(made).model
    stack = model.stacks(np.array([wavelength_nm]))[0]
    return stack, wavelength_nm, float(np.radians(theta_deg)), float(np.radians(phi_deg))


def lines(*layers: tuple[float, complex, float], period: float = 420.0, substrate: complex = 1.5) -> PeriodicStack:
    """Return ridges of a thickness, a permittivity and a width, in air."""
    made = [
        PatternLayer(d, 1.0, ((Rectangle(-0.5 * width, 0.5 * width), epsilon),)) for d, epsilon, width in layers
    ]  # fmt: skip
    return PeriodicStack(Cell(period), 1.0, tuple(made), substrate)


def total(found: OrderSolution) -> np.ndarray:
    return found.reflected.efficiency.sum(axis=0) + found.transmitted.efficiency.sum(axis=0)


def test_one_small_size_reaches_the_bars_of_the_reference() -> None:
    z = reference()
    worst = {False: 0.0, True: 0.0}
    chosen = [i for i in range(len(z["shape"])) if str(z["shape"][i]) == "lamellar"]
    waves = [
        wave(recipe(i), 1e3 * float(z["wavelength"][i]), float(z["theta_deg"][i]), float(z["phi_deg"][i]))
        for i in chosen
    ]  # fmt: skip
    for i, found in zip(chosen, solve_many(waves), strict=True):
        sides = found.reflected, found.transmitted
        values = [dict(zip(s.numbers[:, 0].tolist(), s.efficiency, strict=True)) for s in sides]
        for k in range(int(z["order_start"][i]), int(z["order_stop"][i])):
            change = values[int(z["order_side"][k])][int(z["order_m"][k])] - z["order_efficiency"][k]
            worst[bool(z["is_metal"][i])] = max(worst[bool(z["is_metal"][i])], float(np.abs(change).max()))
    assert worst[False] <= 3e-4 and worst[True] <= 1.5e-3  # the bars of converged solutions


@pytest.mark.parametrize("phi", [0.0, 0.6])
def test_energy_holds_at_the_smallest_size(phi: float) -> None:
    # two ridges that do not align, deep against the wavelength
    stack = lines((900.0, 6.0, 130.0), (40.0, 2.1, 250.0))
    found = solve_lamellar([(stack, 2.0 * np.pi / w, 0.5, phi) for w in np.linspace(380.0, 800.0, 12)])
    assert max(np.abs(total(each) - 1.0).max() for each in found) <= 1e-8


def test_orders_are_reciprocal_at_the_smallest_size() -> None:
    stack = lines((150.0, complex(-30.0, 8.0), 500.0), period=1100.0, substrate=complex(1.0, 6.0))
    k0 = 2.0 * np.pi / 550.0
    there = solve_lamellar([(stack, k0, 0.4, 0.7)])[0].reflected
    back = [(stack, k0, float(np.arccos(d[2])), float(np.arctan2(-d[1], -d[0]))) for d in there.direction]
    for number, jones, found in zip(there.numbers, there.efficiency, solve_lamellar(back), strict=True):
        again = found.reflected.efficiency[np.all(found.reflected.numbers == number, axis=1)][0]
        assert again.mean() == pytest.approx(jones.mean(), abs=1e-8)


@pytest.mark.parametrize("phi", [0.0, np.pi, 0.8])
def test_amplitudes_approach_those_of_the_finer_solver(phi: float) -> None:
    stack = lines((110.0, 5.0, 170.0), (60.0, 2.25, 300.0))
    coarse, fine = (solve_coarse(stack, 530.0, 0.4, phi, step) for step in (0, 2))
    assert difference(coarse, fine) <= 3e-4
    for a, b in ((coarse.reflected, fine.reflected), (coarse.transmitted, fine.transmitted)):
        assert np.array_equal(a.numbers, b.numbers)
        assert np.abs(a.direction - b.direction).max() <= 1e-12
        assert np.abs(a.jones - b.jones).max() <= 3e-3  # of amplitudes; the smallest efficiencies are their squares


def test_a_half_wave_film_is_no_pole() -> None:
    # a film of half a wave between two patterns: the tangent of its uniform mode is infinite
    grating = PatternLayer(80.0, 1.0, ((Rectangle(-90.0, 90.0), 4.0),))
    film = PatternLayer(125.0, 4.0)
    stack = lines((80.0, 4.0, 180.0))
    full = PeriodicStack(stack.cell, 1.0, (grating, film), 1.5)
    found = solve_lamellar([(full, 2.0 * np.pi / 500.0, 0.0, 0.0)])[0]
    assert np.abs(total(found) - 1.0).max() <= 1e-8
    assert difference(found, solve_coarse(full, 500.0, 0.0, 0.0, 2)) <= 3e-4


def test_a_grazing_order_is_finite() -> None:
    stack = lines((100.0, complex(-40.0, 9.0), 200.0), period=400.0)
    found = solve_many([(stack, w, 0.0, 0.0) for w in (400.0, 400.001)])
    assert all(np.all(np.isfinite(f.reflected.jones)) for f in found)
    assert all(np.all(total(f) <= 1.0) for f in found)


def test_a_batch_equals_its_cases() -> None:
    stacks = [lines((120.0, complex(e, 0.1), 200.0)) for e in (4.0, 12.0, 30.0)] + [PeriodicStack(
        lines().cell, 1.0, (PatternLayer(90.0, 2.0),), 1.5
    )]  # fmt: skip
    waves = [(s, w, t, p) for s in stacks for w in (420.0, 700.0) for t, p in ((0.0, 0.0), (0.9, 0.0), (0.9, 2.0))]
    for one, many in zip([solve_many([w])[0] for w in waves], solve_many(waves), strict=True):
        assert np.array_equal(one.reflected.numbers, many.reflected.numbers)
        assert difference(one, many) <= 1e-10


@pytest.mark.parametrize("phi", [0.0, 0.7])
def test_poles_and_fractions_are_one_tangent(phi: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thin, thick and absorbing layers over one another."""
    case = lines((900.0, 6.0, 130.0), (40.0, complex(17.0, 3.0), 250.0)), 2.0 * np.pi / 520.0, 0.4, phi
    by_poles = solve_lamellar([case])[0]
    monkeypatch.setattr(lamellar_states, "_from_poles", lamellar_states._from_fraction)
    assert difference(by_poles, solve_lamellar([case])[0]) <= 1e-6


def test_poles_give_the_tangent_between_them_and_beyond() -> None:
    poles, residues = lamellar_states.tangent_poles(6, 8)
    x = np.concatenate(
        [np.linspace(0.1, 9.0, 40), 1j * np.geomspace(0.1, 256.0, 60), np.linspace(1, 9, 9) * (1 + 0.3j)]
    )
    found = (residues / (poles - x[:, None] ** 2)).sum(axis=1)
    assert found == pytest.approx(np.tan(x) / x, abs=1e-7)
    assert found[40:100] == pytest.approx(np.tan(x[40:100]) / x[40:100], rel=1e-6)


def test_tangents_of_a_wide_spectrum() -> None:
    g = np.random.default_rng(3)
    vectors = np.linalg.qr(g.normal(size=(30, 30)))[0]
    values = np.concatenate([g.uniform(-5.0, 40.0, 8), -np.logspace(1.0, 7.0, 22)])
    u = (vectors * values) @ vectors.T
    root = np.sqrt(values.astype(complex))
    expected = (vectors * (np.tan(root) / root)) @ vectors.T
    # the rounding of u itself moves its small eigenvalues by 1e-9
    assert np.abs(tangent_over_root(u) - expected).max() <= 1e-5 * np.abs(expected).max()


def test_a_table_states_the_error_near_plasmons(monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest difference found between nodes is at least that of the ninth of ten directions."""
    monkeypatch.setenv("NACRE_CACHE", "off")
    silver, wavelength = complex(0.16, 3.4) ** 2, 650.0
    stack = lines((40.0, silver, 300.0), period=800.0, substrate=complex(0.16, 3.4))
    table = order_tables([stack], np.array([wavelength]), None)
    generator = np.random.default_rng(5)
    theta, azimuth = np.arccos(generator.uniform(0.2, 1.0, 60)), 2.0 * np.pi * generator.random(60)
    thetas, azimuths = (size - 1 for size in table.mirror.shape[:2])
    seen = interpolate(table.mirror, (theta / (0.5 * np.pi) * thetas, azimuth / (2.0 * np.pi) * azimuths))[:, 0]
    solved = solve_many([(stack, wavelength, float(t), float(a) + np.pi) for t, a in zip(theta, azimuth, strict=True)])
    exact = [float(s.reflected.efficiency[np.all(s.reflected.numbers == 0, axis=1)].mean()) for s in solved]
    assert table.between > np.quantile(np.abs(seen - exact), 0.9)


def test_a_table_states_the_error_of_transmitted_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest difference found between nodes covers transmission, whose errors are larger for lines of glass."""
    monkeypatch.setenv("NACRE_CACHE", "off")
    wavelength = 600.0
    stack = lines((400.0, 2.25, 400.0), period=800.0, substrate=1.5)
    table = order_tables([stack], np.array([wavelength]), None)
    generator = np.random.default_rng(6)
    theta, azimuth = np.arccos(generator.uniform(0.3, 1.0, 40)), 2.0 * np.pi * generator.random(40)
    thetas, azimuths = (size - 1 for size in table.passed.shape[:2])
    seen = interpolate(table.passed, (theta / (0.5 * np.pi) * thetas, azimuth / (2.0 * np.pi) * azimuths))[:, 0]
    solved = solve_many([(stack, wavelength, float(t), float(a) + np.pi) for t, a in zip(theta, azimuth, strict=True)])
    exact = [float(s.transmitted.efficiency[np.all(s.transmitted.numbers == 0, axis=1)].mean()) for s in solved]
    assert table.between > np.quantile(np.abs(seen - exact), 0.9)


@pytest.mark.parametrize("step", [0, 1, 2])
def test_conical_light_loses_no_digits_where_a_mode_has_no_wave_number(step: int) -> None:
    """Ridges of glass, one wavelength wide inside, have a mode with kappa = 0 at this direction, in which E_x and E_y
    cancel to all digits. Energy stays within 1e-7, and efficiencies are continuous in the permittivity."""
    direction = (600.0, np.radians(45.0), np.radians(225.0))
    near, at = (
        solve_many([(lines((400.0, epsilon, 400.0), period=800.0, substrate=1.5), *direction)], step)[0]
        for epsilon in (2.25 + 1e-4, 2.25)
    )
    assert np.abs(total(at) - 1.0).max() <= 1e-7
    assert np.abs(at.transmitted.efficiency - near.transmitted.efficiency).max() <= 1e-3
