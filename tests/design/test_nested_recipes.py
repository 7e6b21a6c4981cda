"""Designs of nested recipes."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError
from nacre.optimise.run import with_method_overrides
from nacre.optimise.solutions import write_recipe
from nacre.optimise.task import read_task

GOLD = 'family = "film"\nsubstrate = "BK7"\nlayers = [{material = "Au", thickness_nm = 400}]\n'
OXIDE = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = {file = "own.csv"}, thickness_nm = 100}]\n'
BLEND = 'family = "blend"\nfirst = {recipe = "gold.toml"}\nsecond = {recipe = "under/oxide.toml"}\nmask = 0.25\n'


@pytest.fixture
def blend(tmp_path):
    (tmp_path / "under").mkdir()
    (tmp_path / "gold.toml").write_text(GOLD, encoding="utf-8")
    (tmp_path / "under" / "oxide.toml").write_text(OXIDE, encoding="utf-8")
    (tmp_path / "under" / "own.csv").write_text("nm,n,k\n300,1.48,0\n900,1.45,0\n", encoding="utf-8")
    (tmp_path / "blend.toml").write_text(BLEND, encoding="utf-8")
    return tmp_path


def _target(folder, **free):
    return {
        "recipe": str(folder / "blend.toml"),
        "parameters": free,
        "target": [{"geometry": "specular 0", "colour": "#605040", "tolerance": 5}],
        "search": {"seconds": 2, "solutions": 1},
    }


def test_a_part_given_as_a_table_is_the_part_of_its_file(blend):
    (blend / "table.toml").write_text(
        BLEND.replace('{recipe = "gold.toml"}', "{" + GOLD.strip().replace("\n", ", ") + "}"), encoding="utf-8"
    )
    one, other = (nacre.load(blend / name).spectrum([0.3], [500.0, 600.0]) for name in ("blend.toml", "table.toml"))
    assert (one.specular_reflectance == other.specular_reflectance).all()


def test_nested_recipes_are_written_as_files(blend):
    target = read_task(_target(blend, **{"second.layers[0].thickness_nm": [20, 200]}))
    changes = {"second.layers[0].thickness_nm": 150.0}
    recipe, files = write_recipe(blend / "out", target.material, changes, {})
    assert sorted(files) == ["gold.toml", "own.csv", "recipe.toml", "second.toml"]
    made = nacre.load(blend / "out")
    assert made.data["second"] == {"recipe": "second.toml"}
    assert nacre.load(blend / "out" / "second.toml").get("layers[0].thickness_nm") == 150.0
    wanted, found = target.material.vary(changes).spectrum([0.0]), made.spectrum([0.0])
    assert (wanted.specular_reflectance == found.specular_reflectance).all()
    assert recipe == blend / "out" / "recipe.toml"


def test_an_unknown_path_in_a_nested_recipe_is_refused(blend):
    with pytest.raises(RecipeError, match=r'parameters."second.layers\[4\].thickness_nm"'):
        read_task(_target(blend, **{"second.layers[4].thickness_nm": [20, 200]}))


@pytest.mark.full
def test_a_design_of_a_blend_varies_its_part(blend):
    found = nacre.design(_target(blend, **{"second.layers[0].thickness_nm": [20, 200]}), blend / "out")
    assert nacre.load(found.folder).get("second.recipe") == "second.toml"
    assert nacre.load(found.folder).spectrum([0.0]).specular_reflectance.shape[0] == 1


def test_a_solution_names_the_method_of_its_evaluation(tmp_path: Path) -> None:
    """Loaded alone it would otherwise take an ensemble of minutes, and show other colours than its report."""
    dense = {
        "family": "metasurface",
        "substrate": "glass",
        "particle": {"material": "Si", "radius_nm": 70.0, "gap_nm": 3.0},
        "monolayer": {"coverage": 0.1, "packing": 0.3},
    }
    start = nacre.material(dense)
    assert start.model.expensive_method
    many = start.at_low_fidelity()
    recipe, _ = write_recipe(tmp_path / "dense", many, with_method_overrides(many, {"particle.radius_nm": 60.0}), {})
    assert (
        not nacre.load(recipe).model.expensive_method and nacre.load(recipe).get("model.correction") == "qca-balanced"
    )
    recipe, _ = write_recipe(tmp_path / "thin", many, with_method_overrides(many, {"monolayer.coverage": 0.02}), {})
    assert "model" not in nacre.load(recipe).data


def test_every_verb_reaches_into_the_parts_of_a_blend(blend):
    """What a design may free, and writes as [tolerance] of its answer, is a number for the other commands too."""
    path = "second.layers[0].thickness_nm"
    material = nacre.load(blend / "blend.toml")
    assert material.get(path) == 100
    thin, thick = (each.spectrum([0.0], [500.0]) for each in (material, material.vary({path: 150.0})))
    assert thick.specular_reflectance != thin.specular_reflectance
    found = nacre.gamut(material, ["second.layers[*].thickness_nm=20:200"], points=8)
    assert {*found.structures[0]} == {path}
    spread = '[tolerance]\n"second.layers[*].thickness_nm" = "5%"\n'
    (blend / "spread.toml").write_text(BLEND + spread, encoding="utf-8")
    assert np.ptp(nacre.tolerance(blend / "spread.toml", draws=3).lab[:, 0, 0]) > 0.0
    (blend / "axes.toml").write_text(f'recipe = "blend.toml"\naxes = {{"{path}" = [20, 200]}}\n', encoding="utf-8")
    store = nacre.sweep(blend / "axes.toml", blend / "axes.zarr", jobs=1)
    assert not store.with_suffix(".errors.jsonl").exists()


def test_a_fit_of_a_part_writes_a_recipe_that_holds_it(blend):
    path = "second.layers[0].thickness_nm"
    truth = nacre.load(blend / "blend.toml").vary({path: 130.0}).spectrum(np.radians([0.0]))
    rows = zip(truth.wavelengths_nm, truth.specular_reflectance[0])
    lines = ["wavelength_nm,angle_deg,specular_reflectance", *(f"{nm},0,{value}" for nm, value in rows)]
    (blend / "seen.csv").write_text("\n".join(lines), encoding="utf-8")
    arguments = ["fit", str(blend / "seen.csv"), str(blend / "blend.toml"), "--parameter", f"{path}=20:200"]
    assert run([*arguments, "--starts", "1", "-o", str(blend / "fitted.toml")]) == 0
    assert nacre.load(blend / "fitted.toml").get(path) == pytest.approx(130.0, abs=0.1)


def test_the_time_of_an_animation_runs_in_the_parts_of_a_blend(blend):
    """Animated over the time, a blend was said to have no formula with t, since it stands in the part's own file."""
    formula = '{formula = "drain*(1 + t)", min = 1, max = 300}'
    moving = GOLD.replace("thickness_nm = 400", f"thickness_nm = {formula}") + "[numbers]\ndrain = 40\n"
    (blend / "gold.toml").write_text(moving, encoding="utf-8")
    made = nacre.render.animate(
        blend / "blend.toml", "time", blend / "t.gif", frames=2, size=(8, 8), spp=1, denoise=False, progress=False
    )
    first, last = (np.asarray(Image.open(frame)) for frame in made.frames)
    assert (first != last).any()


def test_a_named_number_that_is_not_there_is_no_new_one():
    """`--set numbers.drian=2` changed nothing, and said nothing."""
    moving = {
        "family": "film",
        "substrate": "Si",
        "numbers": {"drain": 100.0},
        "layers": [{"material": "SiO2", "thickness_nm": {"formula": "drain*(1 + u)", "min": 1, "max": 300}}],
    }
    material = nacre.material(moving)
    material.vary({"numbers.drain": 90.0, "numbers.t": 1.0})
    with pytest.raises(RecipeError, match=r'"numbers.drian" does not exist in the recipe. Did you mean "drain"\?'):
        material.vary({"numbers.drian": 90.0})


@pytest.mark.parametrize(
    ("labs", "words"),
    [("red", "red: does not exist"), ({"L": 50}, "labs should be"), ([[50, 0, 0], [700, 0, 0]], r"labs\[1\]")],
)
def test_many_colours_that_are_none_are_refused(labs, words):
    one = {"recipe": {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 90}]}}
    one |= {
        "parameters": {"layers[0].thickness_nm": [20, 200]},
        "target": [{"geometry": "specular 0", "colour": "#605040"}],
    }
    with pytest.raises(NacreError, match=words):
        nacre.design.many(one, labs)


def test_a_tone_curve_is_refused_where_the_file_holds_the_light_itself(tmp_path, capfd):
    out = tmp_path / "soap.exr"
    assert run(["render", "soap", "--tone", "filmic", "--size", "8x8", "--spp", "1", "-o", str(out)]) == 2
    assert "--tone is for pictures in sRGB" in capfd.readouterr().err and not out.exists()
