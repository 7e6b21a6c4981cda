"""Vector refinement of relief designs: the picture by Maxwell's equations, and the search over heights."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nacre.core.errors import RecipeError
from nacre.families.relief.diffraction_orders import Coherence, coating_reflectance
from nacre.families.relief.plane_cut import CutGeometry
from nacre.matter.indices.constant import named_constant
from nacre.optimise.relief import search as refinement
from nacre.optimise.relief.merit import Evaluator, Problem, View
from nacre.optimise.run import run

LAM = np.array([450.0, 600.0])
SHALLOW = 0.1  # of the brightest pixel: edges and polarisation at a period of eight wavelengths
TARGET = """family = "relief"
features = {features}
feature_um = {feature}
blur_um = 0.002
height_max_um = 0.2
coherence = {{sigma = {sigma}}}
[target]
kind = "uniform"
range = 0.5
resolution = 8
[search]
seconds = 2
starts = 2
levels = 2
refine = "vector"
"""


def problem(features: int = 4, feature_nm: float = 1000.0, levels: int = 0) -> Problem:
    al = named_constant("Al")
    axis = np.linspace(-0.25, 0.25, 21)
    geometry = CutGeometry(axis, axis, np.array([[0.0, 0.0, 1.0]]), LAM)
    weights = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]])
    view = View(geometry, np.full((1, 21, 21, 3), 0.5), weights, coating_reflectance(al.n_complex(LAM)))
    return Problem(features, feature_nm, 2.0, 100.0, Coherence(2.5), (view,), None, levels=levels)


def test_a_shallow_relief_looks_the_same_by_both_theories() -> None:
    asked = problem()
    heights = np.repeat([0.0, 0.0, 40.0, 40.0], 4).reshape(4, 4)
    found = refinement.vector_rgb(asked, heights, named_constant("Al"))
    evaluator = Evaluator(asked, 16)
    scalar, _ = evaluator.rgb(evaluator.surface(heights))
    assert found.shape == scalar.shape
    assert found == pytest.approx(scalar, abs=SHALLOW * float(scalar.max()))
    assert found == pytest.approx(found.reshape(21, 21, 3)[:, ::-1].reshape(-1, 3), abs=1e-9)


@pytest.mark.parametrize("levels", [0, 6, 126])
def test_heights_move_towards_the_target(levels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The picture of this stand-in is that of the target at heights of 60 and 20."""
    asked = problem(2, levels=levels)

    def picture(each: Problem, heights: Any, coating: Any) -> Any:
        away = np.abs(heights - [[60.0, 20.0], [20.0, 60.0]]).sum()
        bright = np.linspace(0.5, 1.0, len(each.target))[:, None]
        return 0.5**2.2 * (1.0 + (bright - 0.5) * away / 100.0) * np.ones(3)

    monkeypatch.setattr(refinement, "vector_rgb", picture)
    given = np.array([[100.0, 0.0], [0.0, 100.0]])
    found = refinement.refine(asked, given, named_constant("Al"))
    assert found.after.free < 0.1 * found.before.free and found.evaluations > 4
    assert found.heights_nm[0, 0] == found.heights_nm[1, 1]
    assert np.abs(found.heights_nm - [[60.0, 20.0], [20.0, 60.0]]).max() < 4.0
    if levels:
        assert np.all(np.isin(found.heights_nm.round(9), np.linspace(0.0, 100.0, levels)))


@pytest.mark.parametrize(
    "changes", [{"features": 32, "feature": 1.0, "sigma": 2.0}, {"features": 4, "feature": 2.0, "sigma": 2.0}]
)
def test_a_tile_that_cannot_be_afforded_is_refused_before_the_search(changes: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "target.toml"
    path.write_text(TARGET.format(**changes))
    with pytest.raises(RecipeError) as caught:
        run(path, tmp_path / "out")
    assert "search.refine" in str(caught.value) and len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.full
def test_a_design_ends_with_heights_by_vectors(tmp_path: Path) -> None:
    path = tmp_path / "target.toml"
    path.write_text(TARGET.format(features=2, feature=0.35, sigma=0.2))
    found = run(path, tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "design.json").read_text())
    assert summary["vector"]["evaluations"] >= 1
    assert summary["vector"]["loss_free"] <= summary["vector"]["loss_free_before"]
    assert np.load(tmp_path / "out" / "height.npy") == pytest.approx(found.best.changes["heights"])
    assert 'optics = "vector"' in (tmp_path / "out" / "recipe.toml").read_text()
