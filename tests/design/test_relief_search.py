"""Relief search: gradients, reproducibility, resume, result folder, levels, robustness."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nacre.core.errors import NacreError, RecipeError
from nacre.optimise.checkpoint import STATE
from nacre.optimise.relief.merit import (
    FIXED_SHARE,
    Evaluator,
    Problem,
    default_weights,
    exact_losses,
    measure_design,
    objective,
)
from nacre.optimise.relief.search import ReliefSearch, robust_objective
from nacre.optimise.run import read_target, run

GRADIENT = 1e-5  # the issue's bar against finite differences
TARGET = """
family = "relief"
features = 8
feature_um = 1.5
blur_um = 0.5
height_max_um = 0.6
coating = "Al"
coherence = {sigma = 0.8}
spectrum = "published-8"
[target]
kind = "anti-mirror"
colour = "white"
range = 0.3
resolution = 12
intensity_scale = 0.2
[search]
starts = 3
perturbed_restarts = 4
seed = 4
"""


TARGET_KEYS = ("kind", "colour", "range", "resolution", "intensity_scale", "image")


def write(folder: Path, text: str = TARGET, **changes: str) -> Path:
    """Write a target file with some lines replaced, `key="value"`; `search` lines are appended."""
    floor = changes.pop("brightness_floor", None)
    if floor is not None:
        text = text.replace("[target]", f"[target]\nbrightness_floor = {floor}")
    for key, value in changes.items():
        lines = [line for line in text.splitlines() if not line.startswith(f"{key} =")]
        changed = len(lines) < len(text.splitlines())
        text = "\n".join(lines)
        if changed and not key.startswith(
            ("starts", "perturbed_restarts", "seed", "levels", "noise", "seconds", "blur_error", "incidence")
        ):
            where = "[target]" if key in TARGET_KEYS else "family"
            head, mark, tail = text.partition(where)
            line_end = tail.partition("\n")
            text = f"{head}{mark}{line_end[0]}\n{key} = {value}\n{line_end[2]}"
        else:
            text += f"\n{key} = {value}\n"
    path = folder / "target.toml"
    path.write_text(text)
    return path


def problem_of(folder: Path, **changes: str) -> Problem:
    return read_target(write(folder, **changes)).problem


def both_gradients(evaluate: Any, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient by central differences of every height, and the one that the search gets."""
    step = 1e-5 * np.eye(len(x))
    finite = np.array([(evaluate(x + s)[0] - evaluate(x - s)[0]) / 2e-5 for s in step])
    return finite, evaluate(x)[1]


@pytest.mark.parametrize("scale", ["0.2", '"free"'])
@pytest.mark.parametrize("incidence", ["[[0, 0]]", "[[0, 0], [25, 30]]"])
def test_gradient_of_the_design_loss_agrees_with_finite_differences(tmp_path: Path, scale: str, incidence: str) -> None:
    problem = replace(problem_of(tmp_path, intensity_scale=scale, incidence_deg=incidence), brightness_floor=3.0)
    evaluator = Evaluator(problem, 5, dtype=np.float64)
    generator = np.random.default_rng(1)
    x = generator.random(64)
    noise = 0.05 * generator.standard_normal((8, 8))
    finite, gradient = both_gradients(lambda y: evaluator.value_and_gradient(y, noise, 1.1), x)
    assert np.linalg.norm(finite - gradient) <= GRADIENT * np.linalg.norm(finite)


def test_gradient_of_the_robust_loss_agrees_with_finite_differences(tmp_path: Path) -> None:
    problem = replace(problem_of(tmp_path), noise=0.05, blur_error=0.1)
    evaluate = robust_objective(Evaluator(problem, 4, dtype=np.float64), seed=3)
    finite, gradient = both_gradients(evaluate, np.random.default_rng(1).random(64))
    assert np.linalg.norm(finite - gradient) <= GRADIENT * np.linalg.norm(finite)


def test_a_free_scale_is_the_best_scale() -> None:
    generator = np.random.default_rng(2)
    rgb, target = generator.random((50, 3)) * 5, generator.random((50, 3))
    best = exact_losses(rgb, target, None)
    assert best.fixed == pytest.approx(best.free)
    for factor in (0.9, 1.1):
        assert exact_losses(rgb, target, best.scale_free * factor).fixed > best.free
    assert exact_losses(rgb, target, 0.1).black == pytest.approx(float((target**2).mean()))


def test_the_brightness_floor_makes_a_dark_answer_worse() -> None:
    generator = np.random.default_rng(3)
    rgb, target = generator.random((50, 3)), generator.random((50, 3))
    scale = exact_losses(rgb, target, None).scale_free
    plain = objective(rgb, target, None)[0]
    assert objective(rgb, target, None, brightness_floor=0.5 / scale)[0] == pytest.approx(plain)
    assert objective(rgb, target, None, brightness_floor=2.0 / scale)[0] > plain + 0.1


def test_a_dark_free_scale_design_is_lifted_to_the_floor_and_reported(tmp_path: Path) -> None:
    plain, lifted = (
        run(write(tmp_path, intensity_scale='"free"', brightness_floor=floor, starts="1"), tmp_path / floor).summary
        for floor in ("0.0", "120.0")
    )
    assert plain["brightness"] < lifted["brightness"] and lifted["brightness_floor"] == 120.0
    if lifted["brightness"] < 120.0:
        assert any("dark" in note for note in lifted["warnings"])


def test_the_result_folder_is_complete(tmp_path: Path) -> None:
    seen: list[Any] = []
    result = run(write(tmp_path), tmp_path / "out", progress=seen.append, jobs=2)
    folder = tmp_path / "out"
    summary = json.loads((folder / "design.json").read_text())
    for key in ("loss_fixed", "loss_free", "scale_fixed", "scale_free", "seconds", "evaluations", "loss_black"):
        assert np.isfinite(summary[key])
    assert summary["status"] == "done" and summary["scale_fixed"] == 0.2
    heights = np.load(folder / "height.npy")
    assert heights.shape == (8, 8) and heights.min() >= 0 and heights.max() <= 0.6
    assert np.array_equal(heights, result.best.changes["heights"])
    assert {"recipe.toml", "report.html", "preview.png"} <= {p.name for p in folder.iterdir()}
    assert (
        seen
        and seen[-1].evaluations > 0
        and {p.description.partition(" ")[0] for p in seen} == {"explore", "improve", "refine", "finish", "perturb"}
    )
    assert 0 < summary["efficiency"] <= 1 and 0 < summary["slope_rms_deg"] < summary["slope_max_deg"] < 90
    assert summary["brightness"] == pytest.approx(1 / 0.2) and summary["brightness_floor"] is None
    cost = summary["robustness"]
    assert cost["draws"] >= 3 and cost["loss_fixed"]["percentile_95"] >= cost["loss_fixed"]["mean"] > 0
    assert cost["delta_e"]["mean"] > 0
    page = (folder / "report.html").read_text()
    assert "brightness" in page and f"made {cost['draws']} times" in page
    assert "efficiency" in page and page.count("<img") == 4 and page.count("<svg") == 2

    problem = problem_of(tmp_path)
    again = measure_design(problem, heights * 1e3)
    assert again.losses.fixed == pytest.approx(summary["loss_fixed"], rel=1e-6)
    twice = Evaluator(problem, 2 * again.upsampling, node_error=1e-4).losses(heights * 1e3)
    assert abs(twice.fixed / summary["loss_fixed"] - 1) < 0.01 and abs(twice.free / summary["loss_free"] - 1) < 0.01
    start = ReliefSearch(problem, 3, 4).candidates[0].x.reshape(8, 8)
    assert summary["loss_fixed"] < 0.7 * measure_design(problem, start * 600.0).losses.fixed

    import nacre

    material = nacre.load(folder)
    assert material.family == "relief"
    assert np.allclose(material.model.tile.heights_nm, heights * 1e3)


def test_the_same_seed_gives_the_same_design_on_any_number_of_cores(tmp_path: Path) -> None:
    path = write(tmp_path, starts="2")
    maps = [run(path, tmp_path / f"out{k}", jobs=jobs).best.changes["heights"] for k, jobs in enumerate((1, 2))]
    assert np.array_equal(*maps)
    other = run(write(tmp_path, starts="2", seed="5"), tmp_path / "other").best.changes["heights"]
    assert not np.array_equal(maps[0], other)


def test_perturbed_restarts_lower_the_objective(tmp_path: Path) -> None:
    problem = problem_of(tmp_path)
    plain, perturbed = ReliefSearch(problem, 2, 4), ReliefSearch(problem, 2, 4, perturbed_restarts=12)
    values = []
    for search in (plain, perturbed):
        search.run()
        values.append(search.leader.value)
    assert values[1] < values[0]


def test_a_stopped_search_resumes(tmp_path: Path) -> None:
    path = write(tmp_path)

    def stop_soon(progress: Any) -> None:
        if progress.evaluations > 60:
            raise KeyboardInterrupt

    first = run(path, tmp_path / "out", progress=stop_soon)
    assert first.status == first.summary["status"] == "interrupted"
    assert (tmp_path / "out" / "report.html").exists()
    second = run(path, tmp_path / "out", resume=True)
    assert second.summary["status"] == "done"
    assert second.summary["evaluations"] > first.summary["evaluations"]
    assert second.summary["loss_fixed"] <= first.summary["loss_fixed"] * 1.001
    with pytest.raises(RecipeError, match="another target"):
        run(write(tmp_path, colour='"red"'), tmp_path / "out", resume=True)


def test_a_keyboard_interrupt_stops_cleanly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nacre.optimise.relief.search as module

    calls = threading.Event()

    def interrupted(tasks: Any, **_: Any) -> None:
        calls.set()
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "wait", interrupted)
    result = run(write(tmp_path), tmp_path / "out")
    assert calls.is_set() and result.summary["interrupted"]
    assert np.load(tmp_path / "out" / "height.npy").shape == (8, 8)


def test_files_are_complete_before_the_search_ends(tmp_path: Path) -> None:
    found: list[set[str]] = []

    def look(_: Any) -> None:
        if not found:
            found.append({p.name for p in (tmp_path / "out").iterdir()})
            json.loads((tmp_path / "out" / "design.json").read_text())
            np.load(tmp_path / "out" / "height.npy")

    run(write(tmp_path, starts="1"), tmp_path / "out", progress=look)
    assert {"height.npy", "recipe.toml", "design.json"} <= found[0]


def test_a_time_limit_is_kept(tmp_path: Path) -> None:
    result = run(write(tmp_path, features="24", resolution="48", seconds="0.6"), tmp_path / "out")
    assert result.status == result.summary["status"] == "time limit" and result.summary["ended_by"] == "time"


def test_a_limit_of_evaluations_ends_the_search_after_a_stage(tmp_path: Path) -> None:
    recipe = {"family": "relief", "feature_um": 0.8, "blur_um": 0.13, "coating": "Al", "coherence": {"sigma": 1.0}}
    target = {
        "recipe": recipe,
        "parameters": {"heights": [0, 0.4], "features": 6},
        "target": [{"directions": {"kind": "anti-mirror", "range": 0.3, "resolution": 6}}],
        "search": {"evaluations": 10, "seconds": 600},
    }
    found = [run(target, tmp_path / f"out{jobs}", jobs=jobs) for jobs in (1, 2)]
    assert {design.summary["ended_by"] for design in found} == {"evaluations"}
    assert len({design.summary["evaluations"] for design in found}) == 1
    assert np.array_equal(*(design.best.changes["heights"] for design in found))


@pytest.mark.parametrize("levels", [2, 4, 16])
def test_level_optimisation_beats_plain_rounding(tmp_path: Path, levels: int) -> None:
    free = run(write(tmp_path, starts="2"), tmp_path / "free")
    result = run(write(tmp_path, starts="2", levels=str(levels)), tmp_path / "out")
    steps = result.best.changes["heights"] / 0.6 * (levels - 1)
    assert np.abs(steps - np.round(steps)).max() < 1e-9
    rounded = np.round(free.best.changes["heights"] / 0.6 * (levels - 1)) / (levels - 1)
    plain = measure_design(problem_of(tmp_path), rounded * 600.0).losses
    weights = np.array([FIXED_SHARE, 1.0 - FIXED_SHARE])
    ours = weights @ [result.summary["loss_fixed"], result.summary["loss_free"]]
    assert ours <= 1.001 * (weights @ [plain.fixed, plain.free])


def test_a_robust_design_is_less_sensitive_to_noise(tmp_path: Path) -> None:
    problem = problem_of(tmp_path)
    x = {}
    for name, noise in (("plain", "0.0"), ("robust", "0.3")):
        x[name] = run(write(tmp_path, starts="2", noise=noise), tmp_path / name).best.changes["heights"].ravel() / 0.6
    scorer = Evaluator(replace(problem, noise=0.3), 6)
    draws = [float(np.mean([robust_objective(scorer, seed)(x[name])[0] for seed in range(100, 106)])) for name in x]
    assert draws[1] < draws[0]


def test_a_full_disk_is_one_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(NacreError, match="No space left on device"):
        run(write(tmp_path), tmp_path / "out")


def test_default_spectrum_gives_a_white_mirror_its_white() -> None:
    spectrum = default_weights()
    assert np.abs(spectrum.rgb_weights.sum(axis=1) - 1.0).max() < 5e-3


def test_a_truncated_checkpoint_gives_one_line(tmp_path: Path) -> None:
    run(write(tmp_path, starts="1", perturbed_restarts="0"), tmp_path / "out")
    checkpoint = tmp_path / "out" / STATE
    whole = checkpoint.read_text()
    state = json.loads(whole)
    progress, first = state["progress"], state["solutions"][0]
    damaged = [
        {**state, "runs": -5}, {**state, "runs": float("inf")}, {**state, "progress": {**progress, "stage": "a"}},
        {**state, "progress": {**progress, "stage": 99}}, {**state, "progress": {**progress, "evaluations": None}},
        {**state, "solutions": [{**first, "stage": "z"}]}, {**state, "solutions": [{**first, "value": float("nan")}]},
    ]  # fmt: skip
    for text in [whole[:200], *map(json.dumps, damaged)]:
        checkpoint.write_text(text)
        with pytest.raises(NacreError) as caught:
            run(write(tmp_path, starts="1", perturbed_restarts="0"), tmp_path / "out", resume=True)
        assert str(checkpoint) in str(caught.value) and "\n" not in str(caught.value)
