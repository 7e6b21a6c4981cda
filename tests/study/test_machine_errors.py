"""Errors of a machine: correlation matrices, and contributions of run, layers, position and index in the report."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.tolerance import recipe_tolerances
from nacre.core.errors import NacreError
from nacre.optimise.tolerances import draw

FILM: dict[str, Any] = {
    "family": "film",
    "substrate": {"n": 1.52},
    "layers": [{"material": {"n": n}, "thickness_nm": d} for n, d in ((1.38, 95.0), (2.10, 115.0), (1.38, 60.0))],
    "tolerance": {"layers[*].thickness_nm": {"percent": 2}},
}
MATRIX = [[1.0, 0.8, 0.2], [0.8, 1.0, -0.3], [0.2, -0.3, 1.0]]
ALL = ["layers[*].thickness_nm"]
DRAWS = 4000


def drawn(matrix: Any) -> np.ndarray:
    tolerances = recipe_tolerances(nacre.material(FILM | {"correlation": [{"of": ALL, "matrix": matrix}]}))
    values = draw(tolerances, np.random.default_rng(5), DRAWS).values
    return np.stack([values[f"layers[{i}].thickness_nm"] for i in range(3)])


@pytest.mark.parametrize("matrix", [MATRIX, np.eye(3).tolist(), np.ones((3, 3)).tolist()])
def test_draws_have_the_correlation_and_the_deviations(matrix: list[list[float]]) -> None:
    values = drawn(matrix)
    # standard errors: (1 - rho^2) / sqrt(N) of a correlation, sigma / sqrt(2 N) of a deviation; five of them
    error = (1 - np.square(matrix)) / np.sqrt(DRAWS)
    assert np.all(np.abs(np.corrcoef(values) - matrix) <= 5 * error + 1e-9)
    sigma = 0.02 * np.array([95.0, 115.0, 60.0])
    np.testing.assert_allclose(values.std(axis=1), sigma, rtol=5 / np.sqrt(2 * DRAWS))


def test_full_correlation_is_a_group() -> None:
    """One factor for all layers: by a matrix of ones, or by a group."""
    one = nacre.tolerance(FILM | {"correlation": [{"of": ALL, "matrix": np.ones((3, 3)).tolist()}]}, draws=1)
    group = nacre.tolerance(FILM | {"tolerance": {ALL[0]: {"percent": 2, "group": "run"}}}, draws=1)
    assert [each[1] for each in one.sensitivities] == pytest.approx([group.sensitivities[0][1]], rel=1e-9)


def test_the_report_separates_the_contributions() -> None:
    tolerance = {
        ALL[0]: [
            {"percent": 1, "group": "run", "source": "run to run"},
            {"percent": 0.5, "source": "within a run"},
            {"percent": 1, "group": "place", "distribution": "uniform", "source": "uniformity"},
        ],
        "layers[1].material.n": {"percent": 0.5, "source": "index drift"},
    }
    found = nacre.tolerance(FILM | {"tolerance": tolerance}, draws=2)
    shares = {source: share for source, _, share in found.contributions}
    assert set(shares) == {"run to run", "within a run", "uniformity", "index drift"}
    assert sum(shares.values()) == pytest.approx(1.0)
    # the same deviation by the same factor, gaussian and uniform: variance 1 and 1/3; the differences have other steps
    assert shares["run to run"] == pytest.approx(3 * shares["uniformity"], rel=0.1)
    single = sum(share for name, _, share in found.sensitivities if name.startswith("layers[") and "thickness" in name)
    assert shares["within a run"] == pytest.approx(single)


def test_without_sources_tied_and_independent_are_separate() -> None:
    tolerance = {ALL[0]: [{"percent": 1, "group": "run"}, {"percent": 1}]}
    found = nacre.tolerance(FILM | {"tolerance": tolerance}, draws=1)
    assert {source for source, *_ in found.contributions} == {"tied", "independent"}


BAD: list[Any] = [
    {"of": ALL, "matrix": [[1, 0], [0, 1]]},
    {"of": ALL, "matrix": [[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]]},
    {"of": ALL, "matrix": [[1, 0.5, 0], [0.4, 1, 0], [0, 0, 1]]},
    {"of": ALL, "matrix": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]},
    {"of": ALL, "matrix": "ones"},
    {"of": ["layers[1].material.n"], "matrix": [[1]]},
    {"of": ["layers[0].thickness_nm", "layers[0].thickness_nm"], "matrix": [[1]]},
    {"of": [], "matrix": []},
    {"of": ALL},
]


@pytest.mark.parametrize("entry", BAD)
def test_a_bad_matrix_is_refused(entry: Any) -> None:
    with pytest.raises(NacreError):
        recipe_tolerances(nacre.material(FILM | {"correlation": [entry]}))


def test_a_group_has_one_source() -> None:
    tolerance = {
        f"layers[{i}].thickness_nm": {"percent": 1, "group": "run", "source": s} for i, s in ((0, "a"), (1, "b"))
    }
    with pytest.raises(NacreError):
        recipe_tolerances(nacre.material(FILM | {"tolerance": tolerance}))
