"""Relief heights as parameters: target pictures and colours, messages, files, report."""

import json
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import nacre
from nacre.cli.design import _print_solutions
from nacre.core.errors import RecipeError
from nacre.families.relief.material import Relief
from nacre.optimise.relief.search import ReliefSearch
from nacre.optimise.relief.task import read_relief
from nacre.optimise.run import read_target
from nacre.optimise.task import is_relief_task
from nacre.recipe.model import RecipeContext

EXAMPLES = Path(__file__).parents[2] / "examples" / "targets"
RELIEF = {"family": "relief", "feature_um": 0.8, "blur_um": 0.13, "coating": "Al", "coherence": {"sigma": 2.6}}
PICTURE = {
    "kind": "image",
    "image": "star.png",
    "image_scale": 1.5,
    "colour": "white",
    "range": 0.3,
    "resolution": 64,
    "intensity_scale": 0.02,
}
ROUGH = {**RELIEF, "coherence": {"sigma": 1.0}}  # whose window fits a tile of 8 features
COLOUR = {"geometry": "30as15", "colour": "#3060c0", "tolerance": 5}


def _target(*target_tables, **more):
    free = {"heights": [0, 0.8], "features": 32}
    return {
        "recipe": RELIEF,
        "parameters": free,
        "target": list(target_tables),
        "search": {"seconds": 60, "seed": 1},
        **more,
    }


def _read(data):
    return read_relief(data, RecipeContext("wanted.toml", EXAMPLES.resolve(), ""))


def test_both_target_forms_give_the_same_problem(tmp_path):
    text = (EXAMPLES / "star.toml").read_text(encoding="utf-8").replace('spectrum = "published-8"\n', "")
    (tmp_path / "star.toml").write_text(text, encoding="utf-8")
    (tmp_path / "star.png").write_bytes((EXAMPLES / "star.png").read_bytes())
    problem, ours = read_target(tmp_path / "star.toml").problem, _read(_target({"directions": PICTURE})).problem
    assert np.array_equal(problem.target, ours.target)
    for name in (
        "features",
        "feature_nm",
        "blur_nm",
        "height_max_nm",
        "coherence",
        "intensity_scale",
        "prefactor",
        "brightness_floor",
        "noise",
        "levels",
    ):
        assert getattr(problem, name) == getattr(ours, name), name
    assert np.array_equal(problem.views[0].geometry.wi, ours.views[0].geometry.wi)


def test_a_colour_is_a_uniform_view_about_its_directions():
    problem = _read(_target({"directions": PICTURE}, {**COLOUR, "colour": "#ffffff"})).problem
    view = problem.views[1]
    wi = np.array([np.sin(np.radians(30.0)), 0.0, np.cos(np.radians(30.0))])
    # seen 15 degrees from the mirror direction towards the light: at 15 degrees on the other side
    assert np.allclose(view.geometry.wi[0], wi)
    assert abs(view.geometry.psi_x.mean() - (wi[0] - np.sin(np.radians(15.0)))) < 1e-12
    # a white of pi f = 1, at the picture's brightness
    assert np.allclose(view.target, (0.02 / np.pi) ** (1 / 2.2), rtol=1e-3)


def test_another_angle_of_a_colour_is_another_task():
    first, same, other = (_read(_target({**COLOUR, "geometry": at})) for at in ("30as15", "30as15", "30as25"))
    assert first.fingerprint == same.fingerprint != other.fingerprint


def test_targets_with_heights_or_pictures_are_relief_tasks():
    assert is_relief_task(_target(COLOUR)) and is_relief_task({"target": [{"directions": PICTURE}]})
    assert not is_relief_task({"recipe": RELIEF, "parameters": {"blur_um": [0.1, 0.2]}, "target": [COLOUR]})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"parameters": {"heights": [0.1, 0.8]}}, "parameters.heights = [0.1, 0.8] should be [0, h]"),
        ({"parameters": {"heights": [0, "high"]}}, "parameters.heights"),
        ({"parameters": {"heights": [0, 0.8], "features": 1}}, "parameters.features = 1 should be a whole number"),
        ({"parameters": {"heights": [0, 0.8], "blur_um": [0.1, 0.2]}}, 'parameters."blur_um" beside heights'),
        ({"recipe": {**RELIEF, "family": "film"}}, 'recipe.family = "film"'),
        ({"recipe": {**RELIEF, "featur_um": 1}}, "recipe.featur_um is not known"),
        ({"target": [{**COLOUR, "geometry": "specular 0"}]}, 'target[0].geometry = "specular 0" cannot be met'),
        ({"target": [{"geometry": "30as15", "chroma": ">=30"}]}, "target[0]: heights need a target colour"),
        ({"target": [{"directions": {**PICTURE, "image": "none.png"}}]}, "target[0].directions.image"),
        (
            {"target": [{"directions": {**PICTURE, "intensity_scale": "free"}}, COLOUR]},
            'intensity_scale = "free" with',
        ),
        ({"target": [{"directions": PICTURE, "geometry": "30as15"}]}, "has directions and geometry; keep one"),
        ({"target": [{"colour": "#ffffff"}]}, "geometry is missing"),
        ({"tolerance": {"heights": "much"}}, 'tolerance.heights = "much" should be a percentage'),
        ({"limits": {"max_total_nm": 3}}, "[limits]"),
    ],
)
def test_a_bad_relief_target_gives_one_line(changes, said):
    with pytest.raises(RecipeError) as caught:
        _read({**_target({"directions": PICTURE}), **changes})
    assert said in str(caught.value) and "\n" not in str(caught.value) and "wanted.toml" in str(caught.value)


def test_a_picture_of_another_family_is_refused():
    film = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]}
    with pytest.raises(RecipeError, match="are sought of a relief"):
        nacre.design({"recipe": film, "parameters": {}, "target": [{"directions": PICTURE}]})


def test_the_tolerance_of_heights_is_the_process_noise():
    assert _read(_target({"directions": PICTURE}, tolerance={"heights": "2%"})).problem.noise == pytest.approx(0.02)


@pytest.mark.full
def test_a_relief_reaches_its_target_colour_and_writes_all_files(tmp_path):
    target = {**_target(COLOUR), "search": {"seconds": 8}, "parameters": {"heights": [0, 0.8], "features": 16}}
    found = nacre.design(target, tmp_path / "out")
    reported = json.loads((tmp_path / "out" / "design.json").read_text(encoding="utf-8"))
    want = reported["solutions"][0]["targets"][0]
    assert want["geometry"] == "30as15" and want["de00"] < 10.0
    assert found.summary["solutions"] == reported["solutions"]
    assert nacre.load(tmp_path / "out").family == "relief"
    nacre.design(target, tmp_path / "out", resume=True)


def test_the_command_prints_the_distance_of_each_colour(capsys):
    def reached(geometry, lamp, is_met, distance):
        asked = SimpleNamespace(geometry=geometry, tolerance=8.0)
        return SimpleNamespace(target=asked, lamp=lamp, is_met=is_met, distance_text=f"dE00 {distance:.2f}")

    results = [reached("30as20", "D65", False, 35.4), reached("45as10", "A", True, 1.2)]
    solution = SimpleNamespace(targets=results)
    _print_solutions(SimpleNamespace(message="loss", seconds=1, solutions=[solution], summary={"loss_fixed": 0.5}))
    missed, met = capsys.readouterr().out.splitlines()[1:3]
    assert "dE00 35.40 at 30as20 under D65" in missed and "8" in missed
    assert met.strip() == "dE00 1.20 at 45as10 under A"


def test_the_final_evaluation_time_is_reserved(tmp_path, monkeypatch):
    """It is measured before the search; here it takes half a second."""
    limits = []

    def slow(self, wi, wo, wavelengths_nm):
        time.sleep(0.5)
        return np.zeros((len(wi), len(wavelengths_nm)))

    def run(self, budget, *_):
        limits.append(budget.seconds)
        raise KeyboardInterrupt

    monkeypatch.setattr(Relief, "values_at", slow)
    monkeypatch.setattr(ReliefSearch, "run", run)
    with pytest.raises(KeyboardInterrupt):
        nacre.design({**_target(COLOUR), "search": {"seconds": 20}}, tmp_path / "out")
    assert 0.25 * 20 <= limits[0] <= 20 - 3 - 0.5 - 0.5


def test_the_report_shows_target_and_reached_colours(tmp_path):
    free, search = {"heights": [0, 0.4], "features": 8}, {"seconds": 1}
    quick = {**_target({**COLOUR, "tolerance": 0.1}), "recipe": ROUGH, "parameters": free, "search": search}
    found = nacre.design(quick, tmp_path / "out")
    want = found.summary["solutions"][0]["targets"][0]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "30as15, D65" in page and "background:#3060c0" in page
    assert f"background:{want['reached']['colour']}" in page
    assert f"dE00 {want['de00']:.2f} (within 0.1) (missed)" in page
    assert json.loads((tmp_path / "out" / "design.json").read_text())["solutions"] == found.summary["solutions"]
