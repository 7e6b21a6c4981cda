"""Targets under circular light, and free numbers of anisotropic and repeated layers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import RecipeError
from nacre.measure.colours import geometry_colours
from nacre.measure.evaluate import circular_reflection, ellipsometric_angles, selective_band
from nacre.measure.geometry import Geometry
from nacre.optimise.measurement import simulate_measurement
from nacre.optimise.parameters import read_parameters

MEDIUM = {"ordinary": 1.5, "extraordinary": 1.7, "axis_polar_deg": 90.0}


def cholesteric(**keys: Any) -> Any:
    layer = {"material": MEDIUM, "thickness_nm": 3500.0, "pitch_nm": 350.0, "handedness": "left", **keys}
    return nacre.material({"family": "film", "substrate": 1.5, "layers": [layer]})


def test_a_measurement_under_circular_light_is_that_of_the_spectrum() -> None:
    made, waves = cholesteric(), np.linspace(500, 620, 5)
    rows = [Geometry("specular", 0.0, polarisation=state) for state in ("left", "both", "right")]
    found = simulate_measurement(made, rows, waves)
    for row, state in zip(found.factors, ("left", "both", "right"), strict=True):
        np.testing.assert_array_equal(row, nacre.spectrum(made, 0.0, waves, state).specular_reflectance[0])
    np.testing.assert_allclose(0.5 * (found.factors[0] + found.factors[2]), found.factors[1], atol=1e-12)


def test_the_new_numbers_are_parameters() -> None:
    keys = {
        "layers[0].pitch_nm": [300, 400], "layers[0].material.axis_azimuth_deg": [0, 90],
        "layers[1].repeat": [1, 5], "layers[2].material.volume_fractions[0]": [0.2, 0.8],
    }  # fmt: skip
    pair = [{"material": "TiO2", "thickness_nm": 50}, {"material": "SiO2", "thickness_nm": 90}]
    layers = [
        {"material": MEDIUM, "thickness_nm": 900, "pitch_nm": 350}, {"repeat": 2, "layers": pair},
        {"material": {"mix": ["TiO2", "air"], "volume_fractions": [0.5]}, "thickness_nm": 80},
    ]  # fmt: skip
    made = nacre.material({"family": "film", "substrate": "Si", "layers": layers})
    found = {one.path: one for one in read_parameters(keys, made, "target.toml")}
    assert set(found) == set(keys) and found["layers[1].repeat"].is_whole
    assert len(made.vary({"layers[1].repeat": 5}).model.layers) == 12


def test_a_polarised_target_needs_light_in_the_mirror_direction(tmp_path: Any) -> None:
    (tmp_path / "film.toml").write_text('family = "film"\nsubstrate = "Si"\n')
    target = tmp_path / "target.toml"
    target.write_text(
        'recipe = "film.toml"\nparameters = {"substrate" = {choices = ["Si", "Al"]}}\n'
        '[[target]]\ngeometry = "45as15"\npolarisation = "left"\ncolour = "#ffffff"\n'
    )
    with pytest.raises(RecipeError):
        nacre.design(target, tmp_path / "out")


def test_the_band_of_a_cholesteric_lies_between_n_o_p_and_n_e_p_and_keeps_the_hand() -> None:
    made, waves = cholesteric(), np.arange(450.0, 700.0, 2.0)
    mueller = nacre.spectrum(made, 0.0, waves, "mueller").mueller_reflected
    assert mueller is not None
    found = circular_reflection(mueller[0])
    band = selective_band(found, waves)
    assert band is not None and band.hand == "left" and band.reflectance > 0.9 and band.dissymmetry > 1.7
    assert band.low_nm == pytest.approx(1.5 * 350, abs=8) and band.high_nm == pytest.approx(1.7 * 350, abs=8)
    at = int(np.argmin(np.abs(waves - band.peak_nm)))
    assert found.preserved[at] > 0.9
    mirror = nacre.spectrum(nacre.material({"family": "film", "substrate": "Al"}), 0.0, waves, "mueller")
    reversed_hand = circular_reflection(mirror.mueller_reflected[0])
    assert selective_band(reversed_hand, waves) is None and np.all(reversed_hand.preserved < 1e-9)


def test_psi_and_delta_of_a_bare_wafer_are_those_of_its_fresnel_coefficients() -> None:
    n = complex(nacre.matter.index("Si").n_complex([632.8])[0])
    cos, cos_t = np.cos(np.radians(70.0)), np.sqrt(1 - (np.sin(np.radians(70.0)) / n) ** 2)
    rho = ((n * cos - cos_t) / (n * cos + cos_t)) / ((cos - n * cos_t) / (cos + n * cos_t))
    made = nacre.material({"family": "film", "substrate": "Si"})
    psi, delta = ellipsometric_angles(nacre.spectrum(made, 70.0, [632.8], "mueller").mueller_reflected)
    assert psi[0, 0] == pytest.approx(np.degrees(np.arctan(abs(rho))), abs=1e-9)
    assert delta[0, 0] == pytest.approx(np.degrees(-np.angle(rho)) % 360, abs=1e-9)


PITCH, AXIS = "layers[0].pitch_nm", "layers[0].material.axis_azimuth_deg"
TWISTED = "{material = {ordinary = 1.5, extraordinary = 1.7, axis_polar_deg = 90}, thickness_nm = 1400, pitch_nm = 380}"
TILTED = (
    "{material = {ordinary = 1.5, extraordinary = 1.9, axis_polar_deg = 60, axis_azimuth_deg = 10}, thickness_nm = 400}"
)
GROUP = (
    "{repeat = 2, layers = [{material = {mix = ['TiO2', 'air'], volume_fractions = [0.4]}, thickness_nm = 70}, "
    "{material = 'SiO2', thickness_nm = 95}]}"
)
REPEATS, FRACTION = "layers[0].repeat", "layers[0].layers[0].material.volume_fractions[0]"
ANSWERS = {
    "pitch under circular light": (TWISTED, {PITCH: (345.0, [300, 420], 1.0)}, [(0, "right"), (0, "left")]),
    "axis": (TILTED, {AXIS: (35.0, [0, 90], 0.5)}, [(45, "s"), (45, "left")]),
    "repeats and fraction": (GROUP, {REPEATS: (4, [1, 6], 0), FRACTION: (0.7, [0.2, 0.9], 0.005)}, [(0, "both")]),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("name", ANSWERS)
def test_a_design_finds_the_numbers_behind_a_spectrum(name: str, tmp_path: Any) -> None:
    layers, numbers, rows = ANSWERS[name]
    recipe = tmp_path / "film.toml"
    recipe.write_text(f'family = "film"\nsubstrate = "Si"\nlayers = [{layers}]\nwavelengths = {{step_nm = 20}}\n')
    made, waves = (
        nacre.load(recipe).vary({path: truth for path, (truth, _, _) in numbers.items()}),
        np.arange(400.0, 701.0, 20.0),
    )
    bounds = ", ".join(f'"{path}" = {ends}' for path, (_, ends, _) in numbers.items())
    lines = ['recipe = "film.toml"', f"parameters = {{{bounds}}}", "search = {evaluations = 600, seconds = 600}"]
    for number, (theta, state) in enumerate(rows):
        factors = nacre.spectrum(made, float(theta), waves, state).specular_reflectance[0]
        table = "".join(f"{w:g},{r:.8f}\n" for w, r in zip(waves, factors, strict=True))
        (tmp_path / f"{number}.csv").write_text("wavelength_nm,reflectance\n" + table)
        lines += [
            "[[target]]",
            f'geometry = "specular {theta}"',
            f'polarisation = "{state}"',
            f'spectrum = "{number}.csv"',
        ]
    (tmp_path / "target.toml").write_text("\n".join(lines) + "\n")
    nacre.design(tmp_path / "target.toml", tmp_path / "out")
    best = nacre.load(tmp_path / "out" / "recipe.toml")
    for path, (truth, _, error) in numbers.items():
        assert best.get(path) == pytest.approx(truth, abs=error)


@pytest.mark.full
def test_a_colour_of_circular_light_determines_the_pitch(tmp_path: Any) -> None:
    left = TWISTED.replace("pitch_nm = 380", 'pitch_nm = 380, handedness = "left"')
    (tmp_path / "film.toml").write_text(f'family = "film"\nsubstrate = "Si"\nlayers = [{left}]\n')
    made = nacre.load(tmp_path / "film.toml").vary({PITCH: 345.0})
    row = Geometry("specular", 0.0, polarisation="left")
    lab = [round(float(value), 4) for value in geometry_colours(made, [row])[0]]
    (tmp_path / "target.toml").write_text(
        f'recipe = "film.toml"\nparameters = {{"{PITCH}" = [320, 390]}}\n'
        "search = {evaluations = 80, seconds = 600}\n"
        f'[[target]]\ngeometry = "specular 0"\npolarisation = "left"\nlab = {lab}\n'
    )
    nacre.design(tmp_path / "target.toml", tmp_path / "out")
    assert nacre.load(tmp_path / "out" / "recipe.toml").get(PITCH) == pytest.approx(345.0, abs=1.0)
