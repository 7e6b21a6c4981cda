"""Batch design: arguments, refusals, limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError

TARGET: dict[str, Any] = {
    "recipe": {"family": "film", "substrate": "BK7", "layers": []},
    "layers": {"palette": ["TiO2", "SiO2"], "max_layers": 5, "thickness_nm": [5, 300]},
    "target": [{"geometry": "specular 0", "lab": [50, 20, -30], "tolerance": 4.0}],
    "search": {"seconds": 2, "solutions": 1},
}


@pytest.mark.parametrize("none", [[], np.zeros((0, 3)), np.zeros((0, 1, 3))])
def test_an_empty_list_has_no_solutions(none: Any) -> None:
    assert nacre.design.many(TARGET, none) == []


@pytest.mark.parametrize(
    ("labs", "says"),
    [
        ([(50, 0, 0), (40, float("nan"), 2)], r"labs\[1\] = \[40.0, nan, 2.0\] should hold finite numbers"),
        ([(50, 0)], r"should be \[n, 3\]"),
        ([(-1, 0, 0)], r"labs\[0\] .* is no colour"),
    ],
)
def test_bad_colours_are_named(labs: Any, says: str) -> None:
    with pytest.raises(NacreError, match=says):
        nacre.design.many(TARGET, labs)


def test_unsuitable_batch_targets_are_refused() -> None:
    relief = {
        "recipe": {"family": "relief", "feature_um": 1},
        "parameters": {"heights": [0, 1]},
        "target": TARGET["target"],
    }
    with pytest.raises(NacreError, match="relief heights"):
        nacre.design.many(relief, [(50, 0, 0)])
    with pytest.raises(NacreError, match=r"has no \[\[target\]\]"):
        nacre.design.many({"target": {"kind": "uniform"}}, [(50, 0, 0)])


@pytest.mark.full
def test_a_batch_obeys_fewest_layers_and_tolerances() -> None:
    labs = [(58, 2, 8)]  # of some 100 nm of titania on glass, a little off
    plain = nacre.design.many(TARGET, labs)[0]
    fewest = nacre.design.many({**TARGET, "limits": {"max_layers": "fewest"}}, labs)[0]
    assert fewest.is_met and len(fewest.changes["layers"]) < len(plain.changes["layers"])
    spread = nacre.design.many({**TARGET, "tolerance": {"layers[*].thickness_nm": "2%"}}, labs)[0]
    assert plain.yield_share is None and spread.yield_share is not None
