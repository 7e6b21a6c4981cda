"""Formulation: the ingredients and concentrations of a hidden paint, its cost and hiding power, and a batch's drift."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError
from nacre.families.contract import surrogate_radiance
from nacre.measure.geometry import aspecular_pairs
from nacre.optimise.formulation import (
    Formula,
    Formulation,
    Task,
    check_answers,
    formulate,
    read_formulation,
    rematch,
    write_formulation,
)
from nacre.recipe.toml import dump_toml

MICA = {"material": "mica", "thickness_nm": 400, "deviation_nm": 80}
LIBRARY: dict[str, Any] = {
    "resin": {"cost_per_kg": 4, "density_kg_l": 1.0},
    "pigment": [
        {
            "name": "silver",
            "volume_fraction": [0, 0.03],
            "cost_per_kg": 45,
            "density_kg_l": 2.5,
            "platelet": {"coatings": [{"material": "Al", "thickness_nm": 60}]},
        },
        {
            "name": "blue",
            "volume_fraction": [0, 0.05],
            "cost_per_kg": 80,
            "density_kg_l": 3.0,
            "platelet": {
                "substrate": MICA,
                "coatings": [{"material": "TiO2", "thickness_nm": 120, "deviation_nm": 5}],
            },
        },
    ],
    "dye": [
        {
            "name": "red",
            "volume_fraction": [0, 0.02],
            "cost_per_kg": 40,
            "density_kg_l": 1.5,
            "dye": {"material": "Fe2O3"},
        }
    ],
}
PAINT = {"family": "pearl", "base": {"albedo": 0.1}, "strata": [{"resin": {"n": 1.5}, "thickness_um": 40}]}
GEOMETRIES = ("45as15", "45as25", "45as45", "45as110")
TRUE = {"silver": 0.004, "blue": 0.02, "red": 0.004}


def target(labs: Any = ((50, 0, 0),) * 4) -> dict[str, Any]:
    rows = [{"geometry": at, "lab": list(map(float, lab)), "tolerance": 0.3} for at, lab in zip(GEOMETRIES, labs)]
    return {"library": LIBRARY, "recipe": PAINT, "target": rows, "search": {"solutions": 1}}


def colours(amounts: dict[str, float]) -> np.ndarray:
    """Colours of the noise-free model of a paint, without the search's code."""
    platelets = [
        entry["platelet"] | {"volume_fraction": amounts[entry["name"]]}
        for entry in LIBRARY["pigment"]
        if entry["name"] in amounts
    ]
    dye = LIBRARY["dye"][0]["dye"] | {"volume_fraction": amounts["red"]}
    made = nacre.material(PAINT | {"strata": [PAINT["strata"][0] | {"platelets": platelets, "dye": dye}]})
    task: Task = read_formulation(target())
    found = surrogate_radiance(made.model, *aspecular_pairs(task.geometries), task.merit.wavelengths_nm, True)
    assert found is not None
    return np.asarray(task.merit.labs(np.pi * (found[0] + found[1])))[:, 0]


@pytest.mark.full
def test_a_hidden_paint_is_found_with_its_cost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pigments.toml").write_text(dump_toml(LIBRARY))
    (tmp_path / "door.toml").write_text(dump_toml(target(colours(TRUE)) | {"library": "pigments.toml"}))
    assert run(["formulate", str(tmp_path / "door.toml"), "-o", str(tmp_path / "door"), "--json"]) == 0
    (best,) = json.loads(capsys.readouterr().out)["formulas"]
    assert best["volume_fractions"] == pytest.approx(TRUE, rel=0.1)
    assert best["mean_de00"] < 1.0
    masses = {"silver": 2.5 * 0.004, "blue": 3.0 * 0.02, "red": 1.5 * 0.004, "resin": 1.0 * (1 - 0.028)}
    prices = {"silver": 45, "blue": 80, "red": 40, "resin": 4}
    mass = sum(masses.values())
    cost = sum(prices[name] * masses[name] for name in masses) / mass
    assert best["cost_per_kg"] == pytest.approx(cost, rel=0.1)
    assert best["cost_per_m2"] == pytest.approx(cost * mass * 0.04, rel=0.1)  # 40 um: 0.04 l on each m2
    assert 0.0 < best["contrast_ratio"] < 1.0
    assert nacre.load(tmp_path / "door" / "recipe.toml").get("strata[0].dye.volume_fraction") == pytest.approx(
        best["volume_fractions"]["red"]
    )
    assert run(["formulate", str(tmp_path / "door.toml"), "-o", str(tmp_path / "door")]) == 0  # a second time


def test_a_weak_batch_is_corrected_by_additions() -> None:
    batch = {"silver": 0.004, "blue": 0.016, "red": 0.004}
    found = rematch(target(colours(TRUE)), TRUE, dict(zip(GEOMETRIES, colours(batch))))
    assert found.batch == pytest.approx(batch, rel=0.05)
    assert found.de00_after.mean() < 0.25 * found.de00_before.mean()
    assert found.additions["blue"] == pytest.approx(0.004, rel=0.3)
    assert min(found.additions.values()) >= 0.0


def without(*path: Any) -> dict[str, Any]:
    """Return a target with one bad value: (keys..., value)."""
    changed: Any = json.loads(json.dumps(target()))
    *keys, last, value = path
    inner = changed
    for key in keys:
        inner = inner[key]
    inner[last] = value
    return changed


BAD = [
    ("library", "pigment", 0, "platelet", {}),
    ("library", "pigment", 0, "volume_fraction", [0.03, 0.01]),
    ("library", "pigment", 1, "name", "silver"),
    ("library", "dye", 0, "dye", {"material": "TiO2", "radius_nm": 100}),
    (
        "library",
        "pigment",
        0,
        "platelet",
        {"coatings": [{"material": "Al", "thickness_nm": 60}], "volume_fraction": 0.5},
    ),
    ("library", "dye", 0, "dye", {"material": "Fe2O3", "volume_fraction": 0.5}),
    ("library", {}),
    ("library", "nowhere.toml"),
    ("recipe", {"family": "film", "substrate": "Al"}),
    ("recipe", "strata", 0, "dye", {"material": "TiO2", "volume_fraction": 0.01}),
    ("target", 0, "geometry", "specular 0"),
]


@pytest.mark.parametrize("path", BAD)
def test_a_bad_file_is_refused(path: tuple[Any, ...]) -> None:
    with pytest.raises(NacreError):
        read_formulation(without(*path))


def test_a_batch_needs_known_ingredients_and_all_colours() -> None:
    labs = dict(zip(GEOMETRIES, colours(TRUE)))
    with pytest.raises(NacreError):
        rematch(target(), {"gold": 0.01}, labs)
    with pytest.raises(NacreError):
        rematch(target(), TRUE, {"45as15": labs["45as15"]})


@pytest.mark.parametrize("extra", [["--batch", "x.csv"], ["--made", "x"], ["--batch", "x.csv", "--made", "nowhere"]])
def test_a_bad_command_ends_with_status_2(extra: list[str], tmp_path: Path) -> None:
    (tmp_path / "door.toml").write_text(dump_toml(target()))
    assert run(["formulate", str(tmp_path / "door.toml"), *extra]) == 2


def answers(count: int) -> Formulation:
    """Return a result with `count` answers, without a search."""
    made = nacre.material(PAINT)
    one = Formula(made, {"red": 0.01}, {"red": 0.01}, 4.0, 0.2, np.zeros(4), np.zeros((4, 3)), 0.5, True)
    return Formulation((one,) * count, GEOMETRIES, count, "done", 1.0)


def test_fewer_answers_replace_more(tmp_path: Path) -> None:
    write_formulation(answers(3), tmp_path / "door")
    (tmp_path / "door" / "3" / "note.txt").write_text("of the user")
    write_formulation(answers(1), tmp_path / "door")
    files = {str(path.relative_to(tmp_path / "door")) for path in (tmp_path / "door").rglob("*")}
    assert files == {"recipe.toml", "formulation.json", "3", "3/note.txt"}


@pytest.mark.parametrize("taken", ["recipe.toml", "2/recipe.toml"])
def test_a_folder_with_a_foreign_recipe_is_refused_before_the_search(
    taken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def search(*_: Any) -> None:
        raise AssertionError("the search began")

    monkeypatch.setattr("nacre.optimise.formulation.formulate", search)
    (tmp_path / "door.toml").write_text(dump_toml(target()))
    own = tmp_path / "own" / taken
    own.parent.mkdir(parents=True)
    own.write_text("mine")
    assert run(["formulate", str(tmp_path / "door.toml"), "-o", str(tmp_path / "own")]) == 2
    assert own.read_text() == "mine"
    assert not (tmp_path / "own" / "formulation.json").exists()
    with pytest.raises(NacreError):
        check_answers(tmp_path / "door.toml")  # a file


def few(**search: Any) -> dict[str, Any]:
    """A small search: three combinations, two geometries."""
    data = target([[60, 4, -20], [30, 2, -8]])
    data["library"] = {**LIBRARY, "pigment": LIBRARY["pigment"][1:]}
    return data | {"search": {"solutions": 1, "max_pigments": 1, "seconds": 600, **search}}


@pytest.mark.full
def test_a_stopped_formulation_resumes_to_the_same_answer(tmp_path: Path) -> None:
    whole: list[int] = []
    reference = formulate(few(), tmp_path / "whole", lambda done, *_: whole.append(done))

    def stop(done: int, *_: Any) -> None:
        if done == 2:
            raise KeyboardInterrupt

    stopped = formulate(few(), tmp_path / "door", stop)
    assert stopped.status == "interrupted" and (tmp_path / "door" / "recipe.toml").is_file()
    known = json.loads((tmp_path / "door" / "search.json").read_text())["solutions"]
    assert len(known) == 2
    resumed = formulate(few(), tmp_path / "door", resume=True)
    assert resumed.status == reference.status == "done"
    assert resumed.formulas[0].amounts == reference.formulas[0].amounts
    state = [json.loads((tmp_path / name / "search.json").read_text())["solutions"] for name in ("door", "whole")]
    assert state[0] == state[1] and len(state[1]) == len(whole) and state[0][:2] == known
    assert json.loads((tmp_path / "door" / "formulation.json").read_text())["status"] == "done"


@pytest.mark.full
def test_evaluations_limit_a_formulation(tmp_path: Path) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    formulate(few(evaluations=4), tmp_path / "door", stop)  # one refinement, which counts after --resume too
    found = [formulate(few(evaluations=4)), formulate(few(evaluations=4), tmp_path / "door", resume=True)]
    assert {each.status for each in found} == {"evaluations"} and {each.combinations for each in found} == {2}
    assert found[0].formulas[0].amounts == found[1].formulas[0].amounts


def test_the_state_of_another_formulation_is_refused(tmp_path: Path) -> None:
    (tmp_path / "door").mkdir()
    state = {"target": "another", "runs": 1, "solutions": []}
    (tmp_path / "door" / "search.json").write_text(json.dumps(state))
    with pytest.raises(RecipeError, match="another target"):
        formulate(few(), tmp_path / "door", resume=True)
    state |= {"target": read_formulation(few()).fingerprint, "solutions": [{"stage": 0}]}
    (tmp_path / "door" / "search.json").write_text(json.dumps(state))
    with pytest.raises(NacreError, match="cannot be read"):
        formulate(few(), tmp_path / "door", resume=True)
    (tmp_path / "door.toml").write_text(dump_toml(few()))
    assert run(["formulate", str(tmp_path / "door.toml"), "-o", str(tmp_path / "door"), "--resume"]) == 2
