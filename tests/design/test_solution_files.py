"""Targets that name files of the user: optical constants are copied, and changes are noticed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import RecipeError
from nacre.optimise.task import read_task

CONSTANT = "".join(f"{nm},2.0,0.001\n" for nm in range(300, 901, 50))


def target(folder: Path, **tables: Any) -> dict[str, Any]:
    (folder / "own.csv").write_text("nm,n,k\n" + CONSTANT)
    return {
        "recipe": {"family": "film", "substrate": "Al", "layers": []},
        "target": [{"geometry": "specular 0", "lab": [60, 0, 20], "tolerance": 30.0}],
        "search": {"seconds": 1, "solutions": 1},
        **tables,
    }


def sought(folder: Path) -> dict[str, Any]:
    return target(folder, layers={"palette": [{"file": str(folder / "own.csv")}], "max_layers": 2})


def chosen(folder: Path) -> dict[str, Any]:
    recipe = {"family": "film", "substrate": "Al", "layers": [{"material": "SiO2", "thickness_nm": 90}]}
    own = {"choices": [{"file": str(folder / "own.csv")}]}
    free = {"layers[0].material": own, "layers[0].thickness_nm": [5, 300]}
    return target(folder, recipe=recipe, parameters=free)


@pytest.mark.parametrize("asked", [sought, chosen])
def test_chosen_optical_constants_are_copied(tmp_path: Path, asked: Any) -> None:
    design = nacre.design(asked(tmp_path), tmp_path / "out")
    (tmp_path / "own.csv").unlink()
    (tmp_path / "out").rename(tmp_path / "elsewhere")
    made = nacre.load(tmp_path / "elsewhere")
    assert "own.csv" in design.summary["solutions"][0]["files"]
    assert made.name == "elsewhere" and made.spectrum([0.0])


@pytest.mark.parametrize("asked", [sought, chosen])
def test_changed_optical_constants_prevent_resuming(tmp_path: Path, asked: Any) -> None:
    wanted = asked(tmp_path)
    before = read_task(wanted).fingerprint
    nacre.design(wanted, tmp_path / "out")
    (tmp_path / "own.csv").write_text(CONSTANT.replace("2.0", "1.9"))
    assert read_task(wanted).fingerprint != before
    with pytest.raises(RecipeError, match="a file that it names"):
        nacre.design(wanted, tmp_path / "out", resume=True)


def test_the_sensitivity_of_spectra_is_in_per_cent(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("\n".join(f"{nm},{0.3 + 0.2 * (nm > 550)}" for nm in range(400, 701, 10)))
    film = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100.0}]}
    want = {"geometry": "specular 0", "spectrum": str(tmp_path / "s.csv"), "tolerance": 50.0}
    target = {
        "recipe": film,
        "parameters": {"layers[0].thickness_nm": [50, 300]},
        "target": [want],
        "search": {"seconds": 1, "solutions": 1},
    }
    design = nacre.design(target, tmp_path / "out")
    reported = design.best.facts["sensitivity"][0]
    thickness = design.best.changes["layers[0].thickness_nm"]
    ends = [
        design.best.material.vary({"layers[0].thickness_nm": thickness * (1 + step)})
        .spectrum([0.0], np.arange(400.0, 701.0, 10.0))
        .specular_reflectance
        for step in (-0.01, 0.01)
    ]
    rms = 0.5 * 100.0 * np.sqrt(np.mean((ends[1] - ends[0]) ** 2))
    assert "de00_of_1_percent" not in reported and reported["rms_percent_of_1_percent"] == pytest.approx(rms, rel=0.3)
