"""Batch design: arguments, refusals, limits."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers
from nacre.optimise.run import read_target

TARGET: dict[str, Any] = {
    "recipe": {"family": "film", "substrate": "BK7", "layers": []},
    "layers": {"palette": ["TiO2", "SiO2"], "max_layers": 5, "thickness_nm": [5, 300]},
    "target": [{"geometry": "specular 0", "lab": [50, 20, -30], "tolerance": 4.0}],
    "search": {"seconds": 2, "solutions": 1},
}
RELIEF: dict[str, Any] = {
    "recipe": {"family": "relief", "feature_um": 1, "blur_um": 0.2, "coherence": {"sigma": 1.2}},
    "parameters": {"heights": [0, 0.5], "features": 8},
    "target": [{"geometry": "45as15", "lab": [40, 10, -20], "tolerance": 5}],
    "search": {"evaluations": 60, "seconds": 600, "seed": 2},
}


@pytest.mark.parametrize("none", [[], np.zeros((0, 3)), np.zeros((0, 1, 3))])
def test_an_empty_list_has_no_solutions(none: Any) -> None:
    assert nacre.design.many(TARGET, none) == []


@pytest.mark.parametrize(
    ("labs", "says"),
    [
        ([(50, 0, 0), (40, float("nan"), 2)], r"labs\[1\] = \[40.0, nan, 2.0\] should hold finite numbers"),
        ([(50, 0)], r"should be \[n, 3\]"),
        ([(-1, 0, 0)], r"labs\[0\] .* is not a colour"),
    ],
)
def test_bad_colours_are_named(labs: Any, says: str) -> None:
    with pytest.raises(NacreError, match=says):
        nacre.design.many(TARGET, labs)


def test_unsuitable_batch_targets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NacreError, match="relief heights"):  # are files, which need a folder
        nacre.design.many(RELIEF, [(50, 0, 0)])
    for heights in (
        {"target": {"kind": "uniform"}, "feature_um": 1, "blur_um": 0.2, "coherence": {"sigma": 1.2}},
        {**RELIEF, "target": [{"directions": {"kind": "uniform", "range": 0.2, "resolution": 8}}]},
    ):
        with pytest.raises(NacreError, match="target"):
            nacre.design.many(heights, [(50, 0, 0)], tmp_path / "o")
    assert not (tmp_path / "o").exists()


@pytest.mark.full
def test_reliefs_are_designed_for_each_colour_of_a_list(tmp_path: Path) -> None:
    labs = [(40.0, 10.0, -20.0), (50.0, 0.0, 0.0)]
    found = nacre.design.many(RELIEF, labs, tmp_path / "o", workers=Workers(1))
    rows = json.loads((tmp_path / "o" / "many.json").read_text())["rows"]
    for lab, one, row in zip(labs, found, rows, strict=True):
        alone = nacre.design(
            {**RELIEF, "target": [{**RELIEF["target"][0], "lab": list(lab)}]}, tmp_path / row["folder"]
        )
        heights = [np.load(place / "height.npy") for place in (tmp_path / row["folder"], one.recipe.parent)]
        np.testing.assert_array_equal(*heights)
        assert one.worst.distance == alone.best.worst.distance == row["targets"][0]["de00"]
        assert nacre.load(one.recipe).family == "relief"
    # a second run keeps finished rows, and designs a changed one again
    kept = (tmp_path / "o" / "1" / "height.npy").stat().st_mtime_ns
    again = nacre.design.many(RELIEF, [labs[0], (30.0, 0.0, 0.0)], tmp_path / "o", resume=True, workers=Workers(1))
    assert (tmp_path / "o" / "1" / "height.npy").stat().st_mtime_ns == kept
    assert again[0].worst.distance == found[0].worst.distance and again[1].worst.distance != found[1].worst.distance
    # heights that are not those of the summary are designed again
    path = tmp_path / "o" / "1" / "height.npy"
    made = np.load(path)
    np.save(path, made[::-1] + 0.01)
    nacre.design.many(RELIEF, [labs[0], (30.0, 0.0, 0.0)], tmp_path / "o", resume=True, workers=Workers(1))
    np.testing.assert_array_equal(np.load(path), made)


def test_a_relief_task_goes_to_worker_processes() -> None:
    task = read_target(RELIEF)
    assert pickle.loads(pickle.dumps(task)).fingerprint == task.fingerprint


@pytest.mark.full
def test_a_batch_obeys_fewest_layers_and_tolerances() -> None:
    labs = [(58, 2, 8)]  # of some 100 nm of titania on glass, a little off
    plain = nacre.design.many(TARGET, labs)[0]
    fewest = nacre.design.many({**TARGET, "limits": {"max_layers": "fewest"}}, labs)[0]
    assert fewest.is_met and len(fewest.changes["layers"]) < len(plain.changes["layers"])
    spread = nacre.design.many({**TARGET, "tolerance": {"layers[*].thickness_nm": "2%"}}, labs)[0]
    assert plain.yield_share is None and spread.yield_share is not None
