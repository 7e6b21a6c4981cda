"""Basin hopping over interference orders, and wavelength subsets."""

from typing import Any

import numpy as np

from nacre.optimise.methods.local_minima import BasinHopping
from nacre.optimise.methods.surrogate import SUBSET_NM, wavelength_subset
from nacre.optimise.problem import Problem
from nacre.optimise.task import read_task

WAVES, HIDDEN = 3.0, np.array([0.8, 0.3])  # orders over the bounds of a length; an order and an amount


def _seen(place: np.ndarray) -> np.ndarray:
    """Two lines of a film of no dispersion: the orders look alike, and only the second line distinguishes them."""
    phase = 2.0 * np.pi * WAVES * place[0]
    return np.array([np.cos(phase), np.sin(phase), 0.3 * np.cos(phase / 5.0), place[1]])


def _valleys(
    low: Any = (0.0, 0.0), others: Any = lambda place: [], lengths: Any = (0,), unmet: float = 0.0
) -> BasinHopping:
    wanted = _seen(HIDDEN)

    def look(place: np.ndarray) -> np.ndarray:
        return np.append(_seen(place) - wanted, unmet)

    return BasinHopping(look, lambda place: [0, 1], np.array(low), list(lengths), others, lambda place: 0)


def test_a_wrong_interference_order_leads_to_the_right_one() -> None:
    start = np.array([0.45, 0.5])  # an order too low
    for lengths, is_found in ((), False), ((0,), True):
        valleys = _valleys(lengths=lengths)
        valleys.begin([start])
        ends = list(valleys.run())
        assert abs(ends[0].point[0] - (HIDDEN[0] - 1.0 / WAVES)) < 0.05
        assert any(np.allclose(end.point, HIDDEN, atol=1e-2) for end in ends) == is_found


def test_minima_with_equal_residuals_count_once() -> None:
    valleys = _valleys(lengths=(), unmet=0.1)
    valleys.begin([np.array([0.78, u]) for u in (0.1, 0.5, 0.9)])
    assert len(list(valleys.run())) == 1


def test_variants_of_a_good_minimum_are_tried() -> None:
    asked = []

    def others(place: np.ndarray) -> list[np.ndarray]:
        asked.append(place)
        return [np.array([HIDDEN[0], 0.0])]

    valleys = _valleys(others=others, lengths=())
    valleys.begin([np.array([0.45, 0.5])])
    ends = list(valleys.run())
    assert np.array_equal(asked[0], ends[0].point)
    assert any(np.allclose(end.point, HIDDEN, atol=1e-2) for end in ends)


def test_lower_bounds_are_respected() -> None:
    valleys = _valleys(low=(0.0, 0.4), lengths=())
    valleys.begin([np.array([0.78, 0.9])])
    assert next(valleys.run()).point[1] == 0.4


def test_a_wavelength_subset_is_used_for_smooth_spectra_only() -> None:
    data = {
        "recipe": {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]},
        "parameters": {"layers[0].thickness_nm": [50, 200]},
        "target": [{"geometry": "specular 0", "lab": 3 * [50]}],
    }
    for lamp, waves, is_few in (("D65", 1.0, True), ("D65", 9.0, False), ("F11", 1.0, True)):
        target = read_task({**data, "light": {"illuminants": [lamp]}})
        problem, grid = Problem(target, 0), np.arange(380.0, 781.0, 4.0)
        problem.wavelengths_nm, problem.merit = grid, problem.merit_on(grid)

        def spectra(place: np.ndarray, nm: np.ndarray, waves: float = waves) -> np.ndarray:
            return 0.5 + 0.4 * np.sin(2.0 * np.pi * waves * (nm[None] - 380.0) / 400.0 + place[0])

        found, _ = wavelength_subset(problem, [np.array([0.2])], spectra)
        assert (len(found) < len(grid)) == is_few, (lamp, waves)
        assert set(SUBSET_NM) <= set(found) or not is_few


def test_a_point_without_free_parameters_is_a_minimum() -> None:
    valleys = BasinHopping(
        lambda place: place - HIDDEN,
        lambda place: [0] if place[0] > 0.0 else [],
        np.zeros(2),
        [],
        lambda place: [],
        lambda place: 0,
    )
    valleys.begin([np.zeros(2), np.array([0.5, 0.3])])
    ends = list(valleys.run())
    assert sorted(round(float(end.point[0]), 3) for end in ends) == [0.0, 0.8]
