"""Designs: known recipes are recovered, bounds are respected, distances are true, folders are complete."""

from __future__ import annotations

import itertools
import json
import re
import shutil
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core import jit
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.optimise.evaluation import evaluate, geometries_of
from nacre.optimise.methods.least_squares import LeastSquaresSearch
from nacre.optimise.parameters import Parameter
from nacre.optimise.problem import Budget, Problem
from nacre.optimise.run import budget_of, choose_search
from nacre.optimise.solutions import DesignProgress, are_alike
from nacre.optimise.task import read_task
from nacre.optimise.thin_film.adapter import ThinFilmSearch, stack_factors

ROOT = Path(__file__).resolve().parents[2]
JUDGES_AGREE = 0.02  # dE00 of two quadratures of the same spectrum


def lab_of(material: nacre.Material, angle: float, lamp: str = "D65") -> np.ndarray:
    """CIELAB of the mirror direction in steps of 1 nm, by nothing of the design's own."""
    nm = np.arange(380.0, 781.0)
    seen = material.spectrum(np.radians([angle]), nm).specular_reflectance
    assert seen is not None
    return xyz_to_lab(spectrum_to_xyz(seen[0], nm, lamp, "10deg"), white_xyz(lamp, "10deg"))


def film(*thicknesses: float, **more: Any) -> dict[str, Any]:
    materials = ("TiO2", "SiO2", "TiO2", "SiO2")
    layers = [{"material": m, "thickness_nm": d} for m, d in zip(materials, thicknesses)]
    return {"family": "film", "substrate": "Si", "layers": layers, **more}


def asked(*angles: float, hidden: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A target of the colours that a hidden recipe has."""
    made = nacre.material(hidden)
    target_tables = [{"geometry": f"specular {a:g}", "lab": lab_of(made, a).tolist(), "tolerance": 1.0} for a in angles]
    return {"target": target_tables, "search": {"seconds": 8, "solutions": 2}, **more}


@pytest.mark.full
def test_least_squares_recovers_a_known_film() -> None:
    free = {"layers[0].thickness_nm": [20, 90], "layers[1].material": {"choices": ["SiO2", "MgF2", "TiO2"]}}
    target = asked(0.0, 45.0, hidden=film(55, 110), recipe=film(30, 110), parameters=free)
    target["recipe"]["layers"][1]["material"] = "MgF2"
    read = read_task(target)
    result = LeastSquaresSearch(Problem(read, 0)).run()
    assert result.status == "met"
    _, changes = result.solutions[0]
    assert changes["layers[1].material"] == "SiO2" and changes["layers[0].thickness_nm"] == pytest.approx(55, abs=0.3)


def test_reported_distances_are_true_and_bounds_are_respected(tmp_path: Path) -> None:
    target = asked(
        0.0,
        40.0,
        hidden=film(55, 110, 80),
        recipe=film(30, 30, 30),
        parameters={"layers[*].thickness_nm": [20, 130]},
        light={"illuminants": ["D65", "A"]},
    )
    for want in target["target"]:
        want["tolerance"] = 8.0  # the hidden film has these colours under D65, and others under A
    design = nacre.design(target, tmp_path / "out")
    assert design.status == "met" and (tmp_path / "out" / "recipe.toml").is_file()
    for number, solution in enumerate(design.solutions, start=1):
        folder = tmp_path / "out" / (str(number) if number > 1 else "")
        made = nacre.load(folder)
        assert all(20 <= made.get(f"layers[{i}].thickness_nm") <= 130 for i in range(3))
        for r in solution.targets:
            assert r.lamp is not None and r.target.lab is not None
            own = delta_e_2000(r.target.lab, lab_of(made, r.target.geometry.theta_deg, r.lamp))
            assert r.distance == pytest.approx(float(own), abs=JUDGES_AGREE)
    document = json.loads((tmp_path / "out" / "design.json").read_text())
    assert document["status"] == "met" and document["seconds"] > 0
    best = document["solutions"][0]
    assert Path(best["recipe"]) == tmp_path / "out" / "recipe.toml"
    assert {"geometry", "lamp", "asked", "reached", "de00"} <= set(best["targets"][0]) and "yield" in best
    assert len(best["targets"]) == 4  # two angles under two lamps


@pytest.mark.full
def test_a_stack_search_respects_its_palette_and_the_report_is_offline(tmp_path: Path) -> None:
    target = {
        "recipe": {"family": "film", "substrate": "Al", "layers": []},
        "layers": {
            "palette": ["SiO2", "Cr"],
            "max_layers": 4,
            "thickness_nm": {"Cr": [3, 20], "other": [20, 300]},
            "substrate": ["Al", "Ag"],
        },
        "target": [{"geometry": "specular 0", "lab": [45, 30, -20], "tolerance": 2.0}],
        "tolerance": {"layers[*].thickness_nm": "1%"},
        "limits": {"max_total_nm": 700},
        "search": {"seconds": 8, "solutions": 3},
    }
    design = nacre.design(target, tmp_path / "out")
    assert design.status == "met"
    for solution in design.solutions:
        data = tomllib.loads(solution.recipe.read_text())
        assert data["substrate"] in ("Al", "Ag") and len(data["layers"]) <= 4
        bounds = {"Cr": (3, 20), "SiO2": (20, 300)}
        for layer in data["layers"]:
            low, high = bounds[layer["material"]]
            assert low - 1e-6 <= layer["thickness_nm"] <= high + 1e-6
        assert sum(layer["thickness_nm"] for layer in data["layers"]) <= 700 + 1e-6
        assert data["tolerance"]["layers[0].thickness_nm"]["deviation"] == pytest.approx(
            0.01 * data["layers"][0]["thickness_nm"]
        )
        assert solution.yield_share is not None and 0 <= solution.yield_share <= 1
    changes = [s.changes for s in design.solutions]
    assert not any(are_alike(a, b) for i, a in enumerate(changes) for b in changes[:i])
    page = (tmp_path / "out" / "report.html").read_text()
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)""", page) and "<script" not in page
    assert (tmp_path / "out" / "report.png").stat().st_size > 10_000


def test_an_unreachable_target_is_reported_with_its_geometry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "far.toml"
    path.write_text(
        '[recipe]\nfamily = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 100}]\n'
        '[parameters]\n"layers[0].thickness_nm" = [80, 120]\n[[target]]\ngeometry = "specular 0"\ncolour = "#ff0000"\n'
        '[[target]]\ngeometry = "specular 60"\nchroma = "<=60"\n[search]\nseconds = 2\nsolutions = 1\n'
    )
    assert run(["design", str(path), "-o", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    document = json.loads((tmp_path / "out" / "design.json").read_text())
    assert document["status"] == "out of reach" and document["costs_most"]["geometry"] == "specular 0"
    assert document["solutions"][0]["targets"][0]["de00"] > 20


@pytest.mark.full
def test_an_interrupted_design_resumes_from_its_best(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "slow.toml"
    path.write_text(
        '[recipe]\nfamily = "film"\nsubstrate = "Si"\nsurface = {roughness = 0.3}\n'
        'layers = [{material = "SiO2", thickness_nm = 100}]\n'
        '[parameters]\n"layers[0].thickness_nm" = [80, 300]\n"surface.roughness" = [0.2, 0.5]\n'
        '[[target]]\ngeometry = "45as15"\ncolour = "#ff0000"\ntolerance = 0.1\n[search]\nseconds = 60\nsolutions = 1\n'
    )
    out = tmp_path / "out"
    seen = []

    def interrupt(progress: DesignProgress) -> None:
        seen.append(progress.worst)
        if len(seen) == 12:
            raise KeyboardInterrupt

    design = nacre.design(path, out, progress=interrupt)
    assert design.status == "interrupted" and nacre.load(out).name == "out"
    first = json.loads((out / "design.json").read_text())["solutions"][0]["worst"]
    monkeypatch.setattr("nacre.cli.design._Screen.show", lambda self, progress: interrupt(progress))
    seen.clear()
    assert run(["design", str(path), "-o", str(out), "--resume"]) == 130
    document = json.loads((out / "design.json").read_text())
    assert document["solutions"][0]["worst"] <= first * (1 + 1e-9) and document["runs"] == 2
    path.write_text(path.read_text().replace("#ff0000", "#00ff00"))
    assert run(["design", str(path), "-o", str(out), "--resume"]) == 2
    assert "another target" in capsys.readouterr().err


def test_a_foreign_recipe_in_the_folder_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").write_text("# mine\n")
    wanted = asked(0.0, hidden=film(55, 110), recipe=film(30, 110), parameters={"layers[0].thickness_nm": [20, 90]})
    with pytest.raises(NacreError, match="no design wrote"):
        nacre.design(wanted, tmp_path)
    assert (tmp_path / "recipe.toml").read_text() == "# mine\n"


def test_a_solution_folder_is_self_contained(tmp_path: Path) -> None:
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "nk.csv").write_text("360, 1.5, 0\n830, 1.4, 0\n")
    (tmp_path / "start.toml").write_text(
        '# a coating of our own\nfamily = "film"\nsubstrate = "Si"\n'
        'layers = [{material = {file = "tables/nk.csv"}, thickness_nm = 100}]\n'
    )
    target = {
        "recipe": str(tmp_path / "start.toml"),
        "parameters": {"layers[0].thickness_nm": [80, 120]},
        "target": [{"geometry": "specular 0", "lab": [40, 0, 0]}],
        "search": {"seconds": 1, "solutions": 1},
    }
    nacre.design(target, tmp_path / "out")
    shutil.move(tmp_path / "out", tmp_path / "moved")
    shutil.rmtree(tmp_path / "tables")
    assert nacre.load(tmp_path / "moved").spectrum([0.0]).specular_reflectance is not None
    assert (tmp_path / "moved" / "recipe.toml").read_text().startswith("# a coating of our own")


def test_the_start_recipe_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").write_text(
        'family = "film"\nsubstrate = "Si"\nlayers = [{material = 1.5, thickness_nm = 9}]\n'
    )
    target = {
        "recipe": str(tmp_path / "recipe.toml"),
        "parameters": {"layers[0].thickness_nm": [1, 90]},
        "target": [{"geometry": "specular 0", "lab": [40, 0, 0]}],
    }
    with pytest.raises(NacreError, match="starts from"):
        nacre.design(target, tmp_path)


def test_discrete_parameters_are_enumerated() -> None:
    recipe = film(60, substrate="Al", ridges={"pitch_nm": 700, "width_nm": 300, "height_deviation_nm": 120})
    target = {
        "recipe": recipe,
        "parameters": {"ridges.count": [1, 3], "layers[0].material": {"choices": ["SiO2", "TiO2"]}},
        "target": [{"geometry": "30as15", "lab": [50, 0, 0]}],
    }
    read = read_task(target)
    assert Parameter("ridges.count", 1.0, 3.0, (), True) in read.parameters
    result = LeastSquaresSearch(Problem(read, 0)).run()
    assert result.status in ("exhausted", "met")
    assert isinstance(result.solutions[0][1]["ridges.count"], int)


def test_a_batch_preserves_the_order_of_colours() -> None:
    hidden = [film(40, 90), film(80, 140), film(30, 60)]
    labs = [lab_of(nacre.material(h), 0.0) for h in hidden]
    target = {
        "recipe": {"family": "film", "substrate": "Si", "layers": []},
        "layers": {"palette": ["TiO2", "SiO2"], "max_layers": 4, "thickness_nm": [10, 250]},
        "target": [{"geometry": "specular 0", "lab": [50, 0, 0]}],
    }
    found = nacre.design.many(target, labs)
    assert len(found) == 3
    for solution, lab in zip(found, labs):
        assert float(delta_e_2000(lab, lab_of(solution.material, 0.0))) < 0.2 + JUDGES_AGREE


def test_a_batch_refuses_colours_of_another_shape() -> None:
    target = {
        "recipe": film(40),
        "parameters": {"layers[0].thickness_nm": [10, 90]},
        "target": [{"geometry": "specular 0", "lab": [50, 0, 0]}],
    }
    with pytest.raises(NacreError, match=r"\[n, 3\]"):
        nacre.design.many(target, [50, 0, 0])


@pytest.mark.parametrize("has_colour", [False, True])
def test_the_search_and_the_final_evaluation_agree_on_spectra(tmp_path: Path, has_colour: bool) -> None:
    # an edge whose steep part is left out: what lies between 560 and 600 nm counts for neither
    nm = np.r_[430.0:561.0:4.0, 600.0:721.0:4.0]
    csv = tmp_path / "edge.csv"
    csv.write_text("".join(f"{x:g},{float(x > 580.0):g}\n" for x in nm))
    target_tables = [{"geometry": "specular 0", "spectrum": str(csv)}, {"geometry": "specular 30", "colour": "#305080"}]
    target = read_task(
        {
            "recipe": {
                "family": "film",
                "substrate": "BK7",
                "layers": [{"material": ("TiO2", "SiO2")[i % 2], "thickness_nm": (75, 115)[i % 2]} for i in range(9)],
            },
            "parameters": {"layers[*].thickness_nm": [5, 300]},
            "target": target_tables[: 1 + has_colour],
        }
    )
    engine = choose_search(target, 0)
    assert isinstance(engine, ThinFilmSearch)
    goals, rows = engine.problem.merit, geometries_of(target.targets)
    seen = stack_factors(target.material, rows, goals.wavelengths_nm)
    assert seen is not None
    evaluated, _ = evaluate(target.material, target.targets, target.spec.light)
    # to the other quadrature's steps of 1 and 4 nm; with the band between it is 30 % more
    assert goals.distances(seen)[0] == pytest.approx(evaluated[0].distance, rel=0.02)


@pytest.mark.full
def test_a_partial_spectrum_and_a_colour_are_met_together(tmp_path: Path) -> None:
    """An antireflection coating for the middle of the visible that is dark as a whole: nothing is asked elsewhere."""
    (tmp_path / "ar.csv").write_text("nm,R\n" + "".join(f"{nm},0.0\n" for nm in range(480, 621, 10)))
    target = {
        "recipe": {"family": "film", "substrate": "BK7", "layers": []},
        "layers": {"palette": ["MgF2", "TiO2", "SiO2"], "max_layers": 4, "thickness_nm": [5, 200]},
        "target": [
            {"geometry": "specular 0", "spectrum": str(tmp_path / "ar.csv"), "tolerance": 0.3},
            {"geometry": "specular 0", "lightness": "<=20", "tolerance": 2.0},
        ],
        "search": {"seconds": 10, "solutions": 1},
    }
    design = nacre.design(target, tmp_path / "out")
    nm = np.arange(480.0, 621.0, 10.0)
    seen = nacre.load(tmp_path / "out").spectrum([0.0], nm).specular_reflectance
    assert seen is not None
    rms = 100.0 * float(np.sqrt(np.mean(seen[0] ** 2)))
    # bare glass has 4.3 %, one quarter wave of MgF2 1.3 %
    assert design.status == "met" and rms < 0.3
    assert design.best.targets[0].lamp is None and design.best.targets[0].distance == pytest.approx(rms, abs=0.02)


def test_a_budget_of_evaluations_gives_the_same_result_at_any_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = film(60, 80, substrate="Al", surface={"roughness": 0.3})
    target = {
        "recipe": recipe,
        "parameters": {"layers[*].thickness_nm": [20, 130]},
        "target": [{"geometry": "45as15", "colour": "#ff0000", "tolerance": 0.1}],
        "search": {"evaluations": 40},
    }
    task = read_task(target)
    results = []
    for speed in (1.0, 50.0):
        clock = itertools.count(0.0, 1e-4 * speed)
        with monkeypatch.context() as patch:
            patch.setattr(time, "monotonic", lambda clock=clock: next(clock))
            search = choose_search(task, 0)
            results.append(search.run(budget_of(task, search)))
    assert results[0].status == "evaluations" and results[0].evaluations >= 40
    assert results[0].solutions == results[1].solutions


def test_compilation_does_not_use_up_a_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first run, which compiles, has the time of the later ones and so the same answer."""
    budget, begun, compiled = Budget(seconds=60.0), time.monotonic(), jit._seconds_compiled
    monkeypatch.setattr(time, "monotonic", lambda: begun + 100.0)
    monkeypatch.setattr(jit, "_seconds_compiled", compiled + 90.0)
    assert not budget.is_over() and budget.share_used < 0.5
    monkeypatch.setattr(jit, "_seconds_compiled", compiled + 30.0)
    assert budget.is_over() and budget.is_late
