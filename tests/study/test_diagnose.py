"""Diagnosis of a coating run: the cause is found, its width is right, and an ambiguous measurement is called so."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.diagnose import ColourObservation, SpectrumObservation, _Likelihood, diagnose
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.material.material import Material
from nacre.optimise.tolerances import components, draw, read_tolerances
from nacre.recipe.toml import dump_toml

GRID_NM = np.arange(400.0, 781.0, 5.0)
NOISE = 0.002
AR = {
    "family": "film",
    "substrate": {"n": 1.52},
    "layers": [
        {"material": {"n": n}, "thickness_nm": d} for n, d in ((1.38, 95.0), (2.10, 115.0), (1.38, 30.0), (2.10, 14.0))
    ],
}
SYMMETRIC = {
    "family": "film",
    "substrate": "air",
    "layers": [{"material": {"n": n}, "thickness_nm": d} for n, d in ((1.46, 120.0), (2.3, 260.0), (1.46, 120.0))],
}


def coating(recipe: dict[str, Any], percent: float, group: str = "") -> tuple[Material, tuple]:
    material = nacre.material(recipe)
    entry = {"percent": percent} | ({"group": group} if group else {})
    return material, read_tolerances({"layers[*].thickness_nm": entry}, material, "test")


def measured(
    sample: Material, rng: np.random.Generator, angle: float = 0.0, p: str = "both", noise: float = NOISE
) -> SpectrumObservation:
    empty = SpectrumObservation(GRID_NM, np.zeros(len(GRID_NM)), angle, p)
    noisy = empty.model(sample, None, 0) + noise * rng.standard_normal(len(GRID_NM))
    return SpectrumObservation(GRID_NM, noisy, angle, p)


def test_the_layer_that_was_off_is_named_with_its_deviation() -> None:
    material, tolerances = coating(AR, 3.0)
    rng = np.random.default_rng(1)
    path = "layers[1].thickness_nm"
    result = diagnose(material, tolerances, [measured(material.vary({path: 120.0}), rng)], NOISE)
    best = result.suspects[0]
    assert (result.verdict, best.name) == ("one cause", path)
    assert abs(best.changes[path] - 5.0) < 4 * best.errors[path]
    assert result.material.get(path) == pytest.approx(120.0, abs=4 * best.errors[path])


def test_causes_without_effect_on_the_measurement_do_not_count() -> None:
    hidden = [{"material": {"n": 1.0, "k": 6.0}, "thickness_nm": 500.0}, *AR["layers"][:3]]
    material, tolerances = coating(AR | {"layers": [AR["layers"][0], *hidden]}, 3.0)
    path = "layers[0].thickness_nm"
    result = diagnose(material, tolerances, [measured(material.vary({path: 101.0}), np.random.default_rng(5))], NOISE)
    assert (result.verdict, result.suspects[0].name) == ("one cause", path)
    assert result.material.get("layers[3].thickness_nm") == hidden[2]["thickness_nm"]


def test_a_good_run_needs_no_cause() -> None:
    material, tolerances = coating(AR, 3.0)
    result = diagnose(material, tolerances, [measured(material, np.random.default_rng(2))], NOISE)
    assert result.verdict == "within noise"


def test_mirrored_layers_of_a_free_film_cannot_be_distinguished() -> None:
    # a lossless stack reflects the same power from both sides, at every angle and in both polarisations
    material, tolerances = coating(SYMMETRIC, 3.0)
    sample = material.vary({"layers[0].thickness_nm": 126.0})
    rng = np.random.default_rng(3)
    result = diagnose(material, tolerances, [measured(sample, rng), measured(sample, rng, 45.0, "s")], NOISE)
    assert result.verdict == "ambiguous"
    assert {s.name for s in result.suspects[:2]} == {"layers[0].thickness_nm", "layers[2].thickness_nm"}
    assert result.suspects[0].probability == pytest.approx(0.5, abs=0.02)
    assert result.advice == ""


def test_a_wrong_substrate_is_no_deviation() -> None:
    material, tolerances = coating(AR, 0.5)
    sample = nacre.material(AR | {"substrate": {"n": 3.5}})
    result = diagnose(material, tolerances, [measured(sample, np.random.default_rng(4))], NOISE)
    assert result.verdict == "unexplained"


def test_posterior_widths_from_colours_of_tied_layers_are_calibrated() -> None:
    """Two factors (one per material) from L*a*b* at two angles: pulls of 6 runs are standard normal."""
    material, tolerances = coating(AR, 6.0, "material")
    rng = np.random.default_rng(6)
    drawn = draw(tolerances, rng, 6).values
    pulls = []
    for number in range(6):
        values = {path: float(column[number]) for path, column in drawn.items()}
        sample = material.vary(values)
        seen = []
        for geometry in ("specular 5", "specular 45"):
            lab = ColourObservation(geometry, np.zeros(3)).model(sample, None, 0)
            seen.append(ColourObservation(geometry, lab + 0.1 * rng.standard_normal(3)))
        result = diagnose(material, tolerances, seen, 0.1)
        truth = [values[f"layers[{i}].thickness_nm"] / AR["layers"][i]["thickness_nm"] - 1.0 for i in (0, 1)]
        pulls += list((result.factors - np.array(truth) / 0.06) / result.factor_errors)
    # chi-squared of 12 values: 99.9 % below 32.9, 0.1 % below 2.2
    assert 2.2 < np.sum(np.square(pulls)) < 32.9


@pytest.mark.parametrize(("noise", "count"), [(0.0, 1), (0.01, 0)])
def test_a_diagnosis_without_data_or_noise_is_refused(noise: float, count: int) -> None:
    material, tolerances = coating(AR, 3.0)
    with pytest.raises(NacreError):
        diagnose(material, tolerances, [measured(material, np.random.default_rng(0))] * count, noise)


def test_the_command_reads_spectra_and_colours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recipe = AR | {"tolerance": {"layers[*].thickness_nm": {"percent": 3}}}
    (tmp_path / "ar.toml").write_text(dump_toml(recipe))
    path = "layers[1].thickness_nm"
    made = nacre.material(recipe).vary({path: 121.0})
    lab = ColourObservation("specular 5", np.zeros(3)).model(made, None, 0)
    (tmp_path / "m.csv").write_text(
        "wavelength_nm,specular_reflectance\n"
        + "".join(f"{w},{r}\n" for w, r in zip(GRID_NM, made.spectrum(0.0, GRID_NM).specular_reflectance[0]))
    )
    colour = "specular 5=" + ",".join(f"{value:.6f}" for value in lab)
    command = ["diagnose", str(tmp_path / "m.csv"), str(tmp_path / "ar.toml"), "--lab", colour, "--json"]
    assert run([*command, "-o", str(tmp_path / "made.toml")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["verdict"], document["single_causes"][0]["name"]) == ("one cause", path)
    assert nacre.load(tmp_path / "made.toml").get(path) == pytest.approx(121.0, abs=1.0)


@pytest.mark.parametrize("extra", [["--lab", "specular 5=1,2"], ["--lab", "diffuse 0=50,0,0"], ["--noise", "0"], []])
def test_a_bad_command_ends_with_status_2(extra: list[str], tmp_path: Path) -> None:
    recipe = AR | {"tolerance": {"layers[*].thickness_nm": {"percent": 3}}}
    (tmp_path / "ar.toml").write_text(dump_toml(recipe))
    measured_ = ["--lab", "specular 5=50,0,0"] if extra[:1] == ["--noise"] else []
    noise = ["--lab-noise", "0"] if extra[:1] == ["--noise"] else []
    assert run(["diagnose", str(tmp_path / "ar.toml"), *extra, *measured_, *noise]) == 2


@pytest.mark.parametrize(
    "extra", [["--lab-noise", "nan"], ["--noise", "inf"], ["--range-nm", "900:1000"], ["--range-nm", "nan:1000"]]
)
def test_no_noise_and_an_empty_range_are_refused(extra: list[str], tmp_path: Path) -> None:
    (tmp_path / "ar.toml").write_text(dump_toml(AR | {"tolerance": {"layers[*].thickness_nm": {"percent": 3}}}))
    (tmp_path / "m.csv").write_text("wavelength_nm,specular_reflectance\n500,0.02\n550,0.03\n600,0.04\n")
    command = ["diagnose", str(tmp_path / "m.csv"), str(tmp_path / "ar.toml"), "-o", str(tmp_path / "made.toml")]
    assert run([*command, *extra]) == 2
    assert not (tmp_path / "made.toml").exists()


def mirror(percent: float) -> tuple[Material, tuple]:
    """26 quarter-wave layers between equal media: seen from both sides nearly alike."""
    pair = ({"material": {"n": n}, "thickness_nm": 550.0 / 4.0 / n} for n in (2.35, 1.46))
    return coating({"family": "film", "substrate": "air", "layers": list(pair) * 13}, percent)


def runs(seed: int, layers: Sequence[int]) -> list[tuple[Any, Any, str]]:
    """Diagnose mirrors of which a layer is 3 % off, from the normal alone and with s and p at 45 degrees."""
    material, tolerances = mirror(3.0)
    rng = np.random.default_rng(seed)
    found = []
    for layer in layers:
        path = f"layers[{layer}].thickness_nm"
        sample = material.vary({path: material.get(path) * (1.0 + 0.03 * rng.choice([-1, 1]))})
        normal = measured(sample, rng, noise=0.003)
        oblique = [measured(sample, rng, 45.0, p, noise=0.003) for p in "sp"]
        both = (diagnose(material, tolerances, seen, 0.003) for seen in ([normal], [normal, *oblique]))
        found.append((*both, path))
    return found


def test_a_mirror_of_26_layers_needs_oblique_light() -> None:
    """The outermost layers differ by 0.3 standard deviations of the noise from the normal, and by 5 with 45 degrees."""
    for normal, oblique, path in runs(1, [12]):
        assert normal.verdict == "ambiguous"
        assert normal.advice == "Add s and p at 45 degrees."
        assert (oblique.verdict, oblique.suspects[0].name) == ("one cause", path)


@pytest.mark.full
def test_probabilities_of_causes_are_calibrated_for_a_mirror() -> None:
    """The share of right answers is the mean of their stated probabilities, within three standard errors."""
    found = runs(2, np.random.default_rng(3).integers(0, 26, 25))
    for number, least in ((0, 0.0), (1, 0.95)):
        stated = np.array([each[number].suspects[0].probability for each in found])
        right = np.mean([each[number].suspects[0].name == each[2] for each in found])
        error = np.sqrt(np.mean(stated * (1.0 - stated)) / len(found))
        assert abs(right - stated.mean()) <= 3.0 * error + 1.0 / len(found)
        assert right >= least


def test_thicknesses_are_solved_at_once_with_the_same_values() -> None:
    material, tolerances = coating(AR, 3.0, "material")
    seen = [measured(material, np.random.default_rng(0), angle, p) for angle, p in ((0.0, "both"), (45.0, "p"))]
    likelihood = _Likelihood(material, components(tolerances), seen, np.full(2, NOISE), None, 0)
    assert likelihood._batch(seen) is not None
    factors = np.array([[0.7, -1.2], [3.0, 0.1]])
    for row, values in zip(factors, likelihood.predict(factors, seen)):
        exact = np.concatenate([each.model(likelihood.material(row), None, 0) for each in seen])
        assert values == pytest.approx(exact, abs=1e-12)


def test_a_film_whose_index_drifts_is_not_taken_for_thicknesses() -> None:
    material = nacre.material(AR)
    tolerances = read_tolerances({"layers[0].material.n": 0.01}, material, "test")
    seen = [measured(material, np.random.default_rng(0))]
    likelihood = _Likelihood(material, components(tolerances), seen, np.full(1, NOISE), None, 0)
    assert likelihood._batch(seen) is None
    result = diagnose(
        material, tolerances, [measured(material.vary({"layers[0].material.n": 1.40}), np.random.default_rng(0))], NOISE
    )
    best, path = result.suspects[0], "layers[0].material.n"
    assert abs(best.changes[path] - 0.02) < 4.0 * best.errors[path]


def test_a_colour_that_needs_deviations_far_beyond_the_tolerances_is_unexplained() -> None:
    layers = [{"material": name, "thickness_nm": d} for name, d in (("TiO2", 60), ("SiO2", 95)) * 2]
    material, tolerances = coating({"family": "film", "substrate": "BK7", "layers": layers}, 3.0, "material")
    found = diagnose(material, tolerances, [ColourObservation("specular 5", np.array([60.0, -20.0, -30.0]))], 0.2)
    assert found.verdict == "unexplained"
