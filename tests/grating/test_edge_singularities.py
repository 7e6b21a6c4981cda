"""Exponents of the fields at edges against closed forms, and what follows for stated errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import nacre
from nacre.matter.periodic.edge_singularities import edge_exponent, singular_exponent
from nacre.matter.periodic.element_solver import ELEMENT_STEPS, solve_ovals
from nacre.matter.periodic.line_elements import solve_elements
from nacre.matter.periodic.solve import amplitude_change, difference, solve, solve_coarse
from nacre.matter.periodic.structure import Cell, PatternLayer, PeriodicStack, Rectangle, Region


@pytest.mark.parametrize("angle", [0.5, 0.5 * np.pi, 2.5])
def test_a_perfect_conductor_has_the_exponent_of_its_opening(angle: float) -> None:
    found = edge_exponent(((-1e8 + 0j, angle), (1.0 + 0j, 2.0 * np.pi - angle)))
    assert found == pytest.approx(np.pi / (2.0 * np.pi - angle), abs=1e-3)


@pytest.mark.parametrize("epsilon", [-16.0 + 0.5j, -9.4 + 1.5j, -2.6 + 3.6j])
@pytest.mark.parametrize("angle", [0.6, 0.5 * np.pi])
def test_two_sectors_obey_the_equation_of_even_and_odd_potentials(epsilon: complex, angle: float) -> None:
    found = edge_exponent(((epsilon, angle), (1.0 + 0j, 2.0 * np.pi - angle)))
    inner, outer = np.tan(0.5 * found * angle), np.tan(found * (np.pi - 0.5 * angle))
    assert min(abs(epsilon * inner + outer), abs(epsilon * outer + inner)) < 1e-5


def lines(metal: complex, film: complex | None = None) -> PeriodicStack:
    layers = [PatternLayer(100.0, 1.0, ((Rectangle(-80.0, 90.0), metal),))]
    if film is not None:
        layers.append(PatternLayer(50.0, film))
    return PeriodicStack(Cell(400.0), 1.0, tuple(layers), 1.5 + 0j)


def test_edges_of_lines_discs_and_profiles_are_found() -> None:
    metal, quarter = -12.0 + 0.5j, 0.5 * np.pi
    on_glass = edge_exponent(((metal, quarter), (2.25 + 0j, np.pi), (1.0 + 0j, quarter))).real
    stack = lines(metal)
    assert singular_exponent(stack) == pytest.approx(on_glass, abs=1e-6)
    upright = replace(stack, tilted=((stack.layers[0], (0.0,)),))
    assert singular_exponent(upright) == pytest.approx(on_glass, abs=1e-6)
    disc = Region(lambda x, y: np.hypot(x, y) - 80.0, ("disc", 0.0, 0.0, 80.0))
    round_layer = PatternLayer(100.0, 1.0, ((disc, metal),))
    assert singular_exponent(PeriodicStack(Cell(400.0, 400.0), 1.0, (round_layer,), 1.5)) == pytest.approx(
        on_glass, abs=1e-6
    )
    assert singular_exponent(lines(4.0)) is None
    made = {"family": "grating", "substrate": "Ag", "lattice": {"period_nm": 400},
            "profile": {"shape": "triangle", "depth_nm": 200, "apex": 0.5}}  # fmt: skip
    profile = nacre.load(made).model.stacks(np.array([600.0]))[0]
    silver = complex(profile.substrate) ** 2
    right_angles = [edge_exponent(((1.0 + 0j, 2.0 * np.pi - a), (silver, a))).real for a in (quarter, 3.0 * quarter)]
    assert singular_exponent(profile) == pytest.approx(min(right_angles), abs=1e-4)


def test_errors_fall_by_the_power_of_the_exponent() -> None:
    """Changes of silver lines whose exponent is small barely fall; those of others fall by the power of the grading."""
    for metal, film in ((-8.6 + 0.3j, 4.0), (-7.0 + 0.3j, None)):
        stack = lines(metal, film)
        exponent = singular_exponent(stack)
        assert exponent is not None
        found = [solve_coarse(stack, 470.0, 0.4, 0.5, step) for step in (1, 2, 3, 4)]
        first, last = (amplitude_change(found[k], found[k + 1]) for k in (0, 2))
        assert np.log(last / first) / np.log(0.18**2) == pytest.approx(2.0 * exponent, abs=0.35)


def test_amplitudes_bound_the_change_of_an_efficiency() -> None:
    one, other = (solve_coarse(lines(-9.0 + 0.4j), 600.0, 0.3, 0.6, step) for step in (1, 2))
    assert 0.0 < difference(one, other) <= amplitude_change(one, other) * (1.0 + 1e-9)


def test_the_error_beside_a_steep_side_covers_the_distance_from_elements() -> None:
    """Half the change of an efficiency is 2e-5 at the fourth size; its distance from elements is 4e-5."""
    made = {"family": "grating", "substrate": {"n": 2.09}, "lattice": {"period_nm": 420},
            "profile": {"shape": "triangle", "depth_nm": 370, "apex": 0.9}}  # fmt: skip
    stack, theta = nacre.load(made).model.stacks(np.array([659.0]))[0], float(np.radians(35.5))
    found = solve(stack, 659.0, theta, 0.0, 1.3e-4)
    assert difference(found, solve_elements(stack, 2.0 * np.pi / 659.0, theta, 0.0, 2)) <= found.error <= 1.3e-4


def test_the_error_of_a_clear_disc_covers_the_distance_from_elements() -> None:
    """Two sizes of Fourier series agree within 2e-4 by chance; their distance from elements is 6.6e-4."""
    disc = {"shape": "disc", "diameter_nm": 121, "material": {"n": 2.41}}
    made = {"family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 326},
            "layers": [{"thickness_nm": 113, "material": "air", "shapes": [disc]}]}  # fmt: skip
    stack, theta = nacre.load(made).model.stacks(np.array([491.0]))[0], float(np.radians(28.7))
    found = solve(stack, 491.0, theta, 0.5 * np.pi)
    other = solve_ovals(stack, 2.0 * np.pi / 491.0, theta, 0.5 * np.pi, ELEMENT_STEPS[0])
    assert difference(found, other) <= found.error <= 4e-3
