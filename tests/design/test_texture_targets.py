"""Sparkle and graininess as targets: distances, closed form at the speed of a search, designs, formulations."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.fit_data import stated_texture
from nacre.analysis.tolerance import recipe_tolerances, run_tolerance
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError
from nacre.material.material import as_material
from nacre.measure.texture import (
    QUANTITY_NAMES,
    Instrument,
    TextureQuantity,
    _Scene,
    measure_texture,
    read_instrument,
    texture_values,
)
from nacre.optimise.batch import _targets, design_batch
from nacre.optimise.colour_list import read_colours
from nacre.optimise.formulation import _paint, formulate, read_formulation
from nacre.optimise.merit import MeritFunction, Operand
from nacre.optimise.methods.surrogate import SurrogateError
from nacre.optimise.task import read_task
from nacre.optimise.tolerances import Tolerance
from nacre.optimise.yield_analysis import sensitivity, yield_of
from nacre.recipe.toml import dump_toml

SEARCH_ERROR, SCOUT_ERROR = 0.03, 0.15  # far below the tolerance of 10 %, and enough for a ranking
FLAKE = {"coatings": [{"material": "Al", "thickness_nm": 60}], "normal_deviation": 0.12}
PAINT = {
    "family": "pearl",
    "base": {"albedo": 0.05},
    "strata": [{"resin": {"n": 1.5}, "thickness_um": 20,
                "platelets": [FLAKE | {"volume_fraction": 0.01, "diameter_um": 20}]}],
}  # fmt: skip
DESIGN: dict[str, Any] = {
    "recipe": PAINT,
    "parameters": {"strata[0].platelets[0].diameter_um": [8, 60]},
    "target": [{"quantity": "sparkle_45", "value": 1.5}],
    "search": {"seconds": 20, "solutions": 1, "evaluations": 60},
}


def quantities(*names: str) -> list[TextureQuantity]:
    return [TextureQuantity.named(name, "quantity") for name in names]


def test_texture_counts_in_per_cent_of_its_target_beside_colours() -> None:
    grid = np.linspace(380.0, 780.0, 41)
    colour = Operand(0, "colour", lab=(50.0, 0.0, 0.0))
    merit = MeritFunction(
        [colour, Operand(1, "texture", low=2.0, high=2.0, tolerance=10.0), Operand(2, "texture", high=4.0)],
        wavelengths_nm=grid,
    )
    spectra = np.outer([0.184, 2.5, 3.0], np.ones(41))
    np.testing.assert_allclose(merit.distances(spectra)[1:], [25.0, 0.0])
    np.testing.assert_allclose(merit.residuals(spectra)[3:], [2.5, 0.0])
    np.testing.assert_allclose(merit.residuals(np.outer([0.184, 1.0, 5.0], np.ones(41)))[3:], [-5.0, 12.5])


def test_numbers_of_a_search_are_those_of_a_report() -> None:
    made = as_material(PAINT)
    report = measure_texture(made)
    final, errors = texture_values(made, quantities(*QUANTITY_NAMES))
    expected = [getattr(report.sparkle[angle], kind) for kind in ("grade", "intensity", "area") for angle in
                ("15", "45", "75")]  # fmt: skip
    np.testing.assert_allclose(final, [*expected, report.graininess.value], rtol=1e-9)
    assert np.all(errors < 0.03 * final)
    np.testing.assert_allclose(texture_values(made, quantities(*QUANTITY_NAMES), 0, "search")[0], final,
                               rtol=SEARCH_ERROR)  # fmt: skip
    np.testing.assert_allclose(texture_values(made, quantities(*QUANTITY_NAMES), 0, "scout")[0], final,
                               rtol=SCOUT_ERROR)  # fmt: skip


def test_targets_are_on_the_scale_of_the_instrument() -> None:
    made = as_material(PAINT)
    tool = read_instrument({"calibration": {"sparkle_45": [[0, 0], [1, 10]]}})
    plain = texture_values(made, quantities("sparkle_45"))[0]
    calibrated = texture_values(made, [TextureQuantity.named("sparkle_45", "quantity", tool)])[0]
    np.testing.assert_allclose(calibrated, 10.0 * plain)


@pytest.mark.parametrize(
    ("target", "key"),
    [
        ({"quantity": "sparkel_45", "value": 1}, "target[0].quantity"),
        ({"quantity": "sparkle_30", "value": 1}, "target[0].quantity"),
        ({"quantity": "sparkle_45"}, "value"),
        ({"value": 1, "geometry": "45as15", "lab": [50, 0, 0]}, "quantity"),
        ({"quantity": "sparkle_45", "value": 0}, "value"),
        ({"quantity": "sparkle_45", "value": "<=0"}, "value"),
        ({"quantity": "sparkle_45", "value": "about 3"}, "value"),
        ({"quantity": "sparkle_45", "value": [3, 1]}, "value"),
        ({"quantity": "sparkle_45", "value": 1, "geometry": "45as15"}, "geometry"),
        ({"quantity": "sparkle_45", "value": 1, "lab": [50, 0, 0]}, "quantity"),
        ({"quantity": "sparkle_45", "value": 1, "polarisation": "s"}, "polarisation"),
    ],
)
def test_a_bad_texture_target_is_refused_in_one_line(
    target: dict[str, Any], key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "paint.toml"
    path.write_text(dump_toml(DESIGN | {"target": [target]}))
    assert run(["design", str(path), "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err.strip()
    assert key in message and "\n" not in message
    assert not (tmp_path / "out").exists()


def test_materials_without_flakes_or_diameters_have_no_texture_target() -> None:
    bare = copy.deepcopy(PAINT)
    del bare["strata"][0]["platelets"][0]["diameter_um"]  # type: ignore[index]
    fraction = {"strata[0].platelets[0].volume_fraction": [0.001, 0.02]}
    with pytest.raises(NacreError, match="diameter_um"):
        read_task(DESIGN | {"recipe": bare, "parameters": fraction})
    film = {"family": "film", "substrate": "Al", "layers": [{"material": "SiO2", "thickness_nm": 100}]}
    with pytest.raises(NacreError, match="quantity"):
        read_task(DESIGN | {"recipe": film, "parameters": {"layers[0].thickness_nm": [10, 300]}})
    with pytest.raises(NacreError, match="colour"):
        nacre.design.many(DESIGN, [(50, 0, 0)])
    paint = formulation([1.0, 1.0])
    del paint["library"]["pigment"][1]["platelet"]["diameter_um"]
    with pytest.raises(RecipeError, match=r"coarse.*diameter_um"):
        read_formulation(paint)


def test_a_formulation_models_texture_about_a_point() -> None:
    task = read_formulation(formulation([1.0, 2.0]))
    paint = _paint(task, task.library.pigment, None)
    point = np.array([0.3, 0.5])
    model = paint.texture_model(point)
    assert model is not None
    near = paint.fractions(point + 0.02)
    np.testing.assert_allclose(
        model(paint.fractions(point)), paint.texture(paint.made(paint.fractions(point)), "search")
    )
    np.testing.assert_allclose(model(near), paint.texture(paint.made(near), "search"), rtol=0.02)
    exact, rest = paint.factors(near, True)
    np.testing.assert_allclose(exact[-2:], np.outer(paint.texture(paint.made(near), "search"), np.ones(exact.shape[1])))
    assert not np.any(rest[-2:])


def formulation(values: list[float]) -> dict[str, Any]:
    """Return a target of two silvers that differ in their diameter only."""

    def silver(name: str, diameter: float) -> dict[str, Any]:
        return {"name": name, "volume_fraction": [0, 0.03], "platelet": FLAKE | {"diameter_um": diameter}}

    bare = {**PAINT, "strata": [{"resin": {"n": 1.5}, "thickness_um": 20}]}
    names = ("sparkle_15", "graininess")
    rows = [{"geometry": at, "lab": [60, 0, 0]} for at in ("45as15", "45as45", "45as110")]
    rows += [{"quantity": name, "value": value} for name, value in zip(names, values, strict=True)]
    library = {"pigment": [silver("fine", 12), silver("coarse", 34)]}
    return {"library": library, "recipe": bare, "target": rows, "search": {"solutions": 2, "max_pigments": 1}}


@pytest.mark.full
def test_a_formulation_distinguishes_two_silvers_by_their_sparkle() -> None:
    data = formulation([1.0, 1.0])
    task = read_formulation(data)
    paint = _paint(task, task.library.pigment[1:], None)
    hidden = [0.006]
    labs = task.merit.labs(sum(paint.factors(hidden, True)))[:3, 0]
    numbers = paint.texture(paint.made(hidden), "final")
    for row, lab in zip(data["target"], labs, strict=False):
        row["lab"] = lab.tolist()
    for row, number in zip(data["target"][3:], numbers, strict=True):
        row["value"] = float(number)
    found = formulate(data)
    best, other = found.formulas
    assert best.is_met and list(best.amounts) == ["coarse"] and not other.is_met
    assert best.amounts["coarse"] == pytest.approx(0.006, rel=0.05)
    assert max(off for _, off in best.texture.values()) < 10.0
    assert max(off for _, off in other.texture.values()) > 20.0


@pytest.mark.full
def test_a_design_finds_the_diameter_of_a_sparkle(tmp_path: Path) -> None:
    bright = {"geometry": "45as15", "lab": [105, 0, 0], "tolerance": 20}
    found = nacre.design(DESIGN | {"target": [bright, *DESIGN["target"]]}, out=tmp_path / "out")
    result = found.solutions[0].targets[1]
    assert result.is_met and result.number == pytest.approx(1.5, rel=0.1)
    assert found.summary["solutions"][0]["targets"][1]["off_percent"] < 10.0


def test_a_sweep_stores_texture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    zarr = pytest.importorskip("zarr")
    (tmp_path / "paint.toml").write_text(dump_toml(PAINT))
    plan = {
        "recipe": "paint.toml",
        "axes": {"strata[0].platelets[0].diameter_um": [15, 40]},
        "measure": {"angles_deg": [0], "texture": ["sparkle_45", "graininess"]},
    }
    (tmp_path / "sweep.toml").write_text(dump_toml(plan))
    store = tmp_path / "sweep.zarr"
    assert run(["sweep", str(tmp_path / "sweep.toml"), "-o", str(store), "--jobs", "1"]) == 0
    found = zarr.open_group(str(store), mode="r")["texture"][...]
    wide = as_material(PAINT).vary({"strata[0].platelets[0].diameter_um": 40})
    np.testing.assert_allclose(found[1], texture_values(wide, quantities("sparkle_45", "graininess"))[0], rtol=1e-9)
    assert np.all(found[1] > found[0])  # coarser flakes sparkle more and are grainier
    capsys.readouterr()
    (tmp_path / "sweep.toml").write_text(dump_toml(plan | {"measure": {"texture": ["sparkle_50"]}}))
    assert run(["sweep", str(tmp_path / "sweep.toml"), "-o", str(tmp_path / "other.zarr")]) == 2
    assert "measure.texture" in capsys.readouterr().err


def test_means_of_texture_need_no_random_walk() -> None:
    found = _Scene(as_material(PAINT), "D65", "10deg", 0, "scout")
    for angle in (15.0, 45.0, 75.0):
        found.lit(np.radians(angle), 0.02, 0.02)
    assert not found.bsdfs


def test_effects_on_texture_alone_are_in_per_cent_of_it() -> None:
    task = read_task(DESIGN)
    path = "strata[0].platelets[0].diameter_um"
    asked = (task.targets, task.spec.light, 0, 5.0)
    ends = [texture_values(task.material.vary({path: d}), quantities("sparkle_45"))[0][0] for d in (19.8, 20.2)]
    expected = 50.0 * (ends[1] - ends[0]) / np.mean(ends)
    (found,) = sensitivity(task.material, [path], *asked)
    assert found["texture_percent_of_1_percent"] == pytest.approx(expected, rel=0.2)
    result = yield_of(task.material, [Tolerance(path, 20.0, 0.2)], *asked)
    assert result["costs"][0]["moves"] == pytest.approx(expected, rel=0.2)


def test_rows_of_texture_do_not_make_estimates_alike() -> None:
    weights = []
    for rows in (0, 3):
        error = SurrogateError(None)
        for level, rest in ((1.0, 1.0), (1.2, 0.0)):
            one = np.vstack([np.full((1, 4), level), np.zeros((rows, 4))])
            found = error.combine(1000, 0.0 * one, one, rest * one, 0.1 * one)
        weights.append(found[0][0, 0])
    assert weights[0] == pytest.approx(weights[1])


DIAMETER = "strata[0].platelets[0].diameter_um"


def test_a_batch_keeps_texture_targets_and_takes_those_of_its_list(tmp_path: Path) -> None:
    colour = {"geometry": "45as45", "lab": [50, 0, 0], "tolerance": 90}
    target = DESIGN | {"target": [colour, DESIGN["target"][0] | {"tolerance": 60}]}
    target["search"] = {"seconds": 5, "solutions": 1, "evaluations": 2}
    path = tmp_path / "list.csv"
    path.write_text("name,L*,a*,b*,sparkle_45\nfine,60,0,0,1.1\ncoarse,55,0,0,2.2\n")
    batch = design_batch(target, path, tmp_path / "out")
    asked = [solution.targets[1].target.texture for solution in batch.solutions]
    assert asked == [(1.1, 1.1), (2.2, 2.2)]
    assert [row["texture"]["sparkle_45"] for row in batch.rows] == [1.1, 2.2]
    again = design_batch(target, path, tmp_path / "out", resume=True)
    assert [s.targets[1].number for s in again.solutions] == [s.targets[1].number for s in batch.solutions]
    path.write_text("name,L*,a*,b*\nplain,60,0,0\n")
    rows = read_colours(path, 1, ("D65", "10deg"), ["45as45"], ["sparkle_45"])
    assert rows[0].texture == {}
    assert _targets(read_task(target), rows[0])[1].texture == (1.5, 1.5)


@pytest.mark.parametrize("cell", ["0", "-1", "much"])
def test_a_list_with_a_bad_texture_number_is_refused_by_its_line(cell: str, tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text(f"name,L*,a*,b*,sparkle_45\nfine,60,0,0,1.1\ncoarse,55,0,0,{cell}\n")
    with pytest.raises(RecipeError, match="line 3"):
        read_colours(path, 1, ("D65", "10deg"), ["45as45"], ["sparkle_45"])


def test_a_tolerance_states_the_spread_of_texture() -> None:
    spread = as_material(PAINT | {"tolerance": {DIAMETER: {"percent": 5}}})
    found = run_tolerance(
        spread, recipe_tolerances(spread), draws=12, samples=256, geometries=("45as45",),
        texture={"sparkle_45": 10.0, "graininess": 1e-3},
    )  # fmt: skip
    sparkle, grain = found.texture
    assert sparkle.nominal == pytest.approx(measure_texture(spread).sparkle["45"].grade)
    ends = [texture_values(spread.vary({DIAMETER: d}), quantities("sparkle_45"))[0][0] for d in (19.0, 21.0)]
    assert sparkle.sensitivities[DIAMETER] == pytest.approx(50.0 * (ends[1] - ends[0]) / sparkle.nominal, rel=0.1)
    assert np.std(sparkle.off_percent) == pytest.approx(abs(sparkle.sensitivities[DIAMETER]), rel=0.6)
    assert np.max(found.delta_e) < 1e-9  # a diameter does not change colours
    assert found.yield_share == 0.0  # graininess leaves its limit in every draw


@pytest.mark.parametrize("asked", [{"sparkle_45": 0.0}, {"sparkle_45": float("nan")}, {"sparkel": 5.0}])
def test_a_bad_limit_of_texture_is_refused(asked: dict[str, float]) -> None:
    spread = as_material(PAINT | {"tolerance": {DIAMETER: {"percent": 5}}})
    with pytest.raises(RecipeError, match="texture"):
        run_tolerance(spread, recipe_tolerances(spread), draws=2, texture=asked)
    two = {
        TextureQuantity.named(name, "", Instrument(lamp_deg=d)): 5.0 for name, d in (("sparkle_45", 2), ("area_45", 3))
    }
    with pytest.raises(RecipeError, match="texture"):
        run_tolerance(spread, recipe_tolerances(spread), draws=2, texture=two)
    film = as_material({"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]})
    with pytest.raises(RecipeError, match="texture"):
        run_tolerance(film, recipe_tolerances(film, ("layers[0].thickness_nm=2",)), draws=2, texture={"sparkle_45": 5})


def test_a_fit_finds_the_diameter_from_a_file_of_texture(tmp_path: Path) -> None:
    made = as_material(PAINT).vary({DIAMETER: 27.0})
    numbers = texture_values(made, quantities("sparkle_45", "graininess"), 0, "search")[0]
    path = tmp_path / "texture.csv"
    path.write_text(f"quantity;value\nsparkle_45;{numbers[0]:.6f}\ngraininess;{numbers[1]:.6f}\n".replace(".", ","))
    found = nacre.fit(path, PAINT, (f"{DIAMETER}=10:50",), starts=0)
    assert found.numbers[0].value == pytest.approx(27.0, rel=1e-3) and found.numbers[0].is_determined


def test_a_fit_compares_texture_on_the_scale_of_the_instrument() -> None:
    data = stated_texture({"sparkle_45": 10.0}, {"calibration": {"sparkle": [[1, 10]]}})
    plain = stated_texture({"sparkle_45": 1.0})
    made = as_material(PAINT)
    np.testing.assert_allclose(data.model(made, None, 0), 10.0 * plain.model(made, None, 0))
    assert plain.remarks and not data.remarks


@pytest.mark.parametrize(
    "rows",
    [
        "sparkle_45,1.2\nsparkle_45,1.3",
        "sparkle_45,-1",
        "sparkle_45,nan",
        "sparkle_45",
        "sparkle_45,1,2",
        "sparkle_50,1.2",
        "sparkle_45,1.2\n45as15,60,0,0",
    ],
)
def test_a_bad_file_of_texture_is_refused_in_one_line(
    rows: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "texture.csv").write_text(rows)
    (tmp_path / "paint.toml").write_text(dump_toml(PAINT | {"tolerance": {DIAMETER: 2}}))
    files = [str(tmp_path / "texture.csv"), str(tmp_path / "paint.toml")]
    for command in (["fit", *files, "--parameter", f"{DIAMETER}=10:50"], ["diagnose", *files]):
        assert run(command) == 2
        message = capsys.readouterr().err.strip()
        assert "texture.csv" in message and "\n" not in message


@pytest.mark.full
def test_a_diagnosis_names_the_diameter_that_texture_shows() -> None:
    spread = as_material(PAINT | {"tolerance": {DIAMETER: {"percent": 10}, "strata[0].thickness_um": {"percent": 3}}})
    data = stated_texture({"sparkle_45": 1.0, "graininess": 1.0}).quantities
    values = texture_values(spread.vary({DIAMETER: 26.0}), data, 0, "search")[0]
    seen = stated_texture({str(q): float(v) for q, v in zip(data, values, strict=True)})
    found = nacre.diagnose(spread, [seen], [0.02 * seen.values])
    assert found.suspects[0].name == DIAMETER and found.suspects[0].probability > 0.95
    assert found.suspects[0].factor == pytest.approx(3.0, abs=0.5)  # 6 of 20 um, 10 % each
