"""Fits: synthetic data with 1 % noise give the truth back, with honest intervals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.analysis.fit import Measured, fit_parameters, read_measurement, run_fit
from nacre.core.errors import NacreError

NOISE = 0.01
THICKNESS_BAR = 0.01  # half width of the 95 % interval, relative
FILM = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 333.0}],
    "fit": {"layers[0].thickness_nm": {"min": 100.0, "max": 700.0}},
}
WAVES = np.arange(400.0, 751.0, 10.0)
ANGLES = np.array([0.0, 45.0])


def synthetic(truth: float, seed: int) -> Measured:
    material = nacre.material(FILM).vary({"layers[0].thickness_nm": truth})
    values = material.spectrum(np.radians(ANGLES), WAVES).specular_reflectance
    assert values is not None
    noisy = values * (1 + NOISE * np.random.default_rng(seed).standard_normal(values.shape))
    return Measured("spectrum", WAVES, noisy[None], ("specular_reflectance",), ANGLES)


def covered(draws: int) -> int:
    material = nacre.material(FILM)
    count = 0
    for seed in range(draws):
        truth = float(np.random.default_rng(100 + seed).uniform(150, 600))
        fit = run_fit(material, synthetic(truth, seed), fit_parameters(material), starts=3)
        number = fit.numbers[0]
        assert number.is_determined
        assert number.half_width <= THICKNESS_BAR * truth
        count += abs(number.value - truth) <= number.half_width
    return count


def test_a_films_thickness_is_found_within_its_interval() -> None:
    assert covered(3) >= 2


@pytest.mark.full
def test_the_interval_covers_the_truth_in_seventeen_of_twenty() -> None:
    assert covered(20) >= 17


def test_a_number_that_the_data_cannot_fix_is_reported_so() -> None:
    # behind 300 nm of silver nothing of the inner layer can be seen
    data = FILM | {"layers": [{"material": "Ag", "thickness_nm": 300.0}, {"material": "SiO2", "thickness_nm": 300.0}]}
    data = data | {"fit": {"layers[1].thickness_nm": {"min": 100.0, "max": 700.0}}}
    material = nacre.material(data)
    values = material.spectrum(np.radians(ANGLES), WAVES).specular_reflectance
    assert values is not None
    noisy = values * (1 + NOISE * np.random.default_rng(0).standard_normal(values.shape))
    measured = Measured("spectrum", WAVES, noisy[None], ("specular_reflectance",), ANGLES)
    fit = run_fit(material, measured, fit_parameters(material), starts=1)
    assert not fit.numbers[0].is_determined


def test_a_spectrum_csv_of_our_own_reads_back(tmp_path: Path) -> None:
    from nacre.cli import run

    recipe = tmp_path / "film.toml"
    from nacre.recipe.toml import dump_toml

    recipe.write_text(dump_toml(FILM))
    table = tmp_path / "film.csv"
    assert (
        run(["spectrum", str(recipe), "--angles-deg", "0,45", "--wavelengths-nm", "400:700:50", "-o", str(table)]) == 0
    )
    measured = read_measurement(table)
    assert measured.values.shape == (1, 2, 7)
    fitted = tmp_path / "fitted.toml"
    assert run(["fit", str(table), str(recipe), "--starts", "1", "-o", str(fitted)]) == 0
    assert nacre.load(fitted).get("layers[0].thickness_nm") == pytest.approx(333.0, abs=0.01)


def test_values_above_one_are_used_as_measured_and_per_cent_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text(
        "wavelength_nm,specular_reflectance\n" + "".join(f"{nm},{nm / 400}\n" for nm in range(400, 700, 50))
    )
    measured = read_measurement(path)
    assert measured.values.max() == pytest.approx(650 / 400) and len(measured.remarks) == 2
    path.write_text("wavelength_nm,specular_reflectance\n" + "".join(f"{nm},{nm / 10}\n" for nm in range(400, 700, 50)))
    with pytest.raises(NacreError):
        read_measurement(path)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "no data"),
        ("a,b\n1,2\n", "heading"),
        ("wavelength_nm,specular_reflectance\n500,x\n", "not a finite"),
        ("wavelength_nm,specular_reflectance\n500\n", "measured value"),
        ("wavelength_nm,specular_reflectance\n500,0.5,0.5\n", "3 cells, the header has 2"),
    ],
)
def test_a_bad_measurement_is_refused_in_one_line(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "m.csv"
    path.write_text(text)
    with pytest.raises(NacreError, match=what):
        read_measurement(path)


@pytest.mark.parametrize("option", ["x", "layers[0].thickness_nm=5", "layers[0].thickness_nm=9:1", "nowhere[3].x=1:2"])
def test_a_bad_free_number_is_refused(option: str) -> None:
    with pytest.raises(NacreError):
        fit_parameters(nacre.material({k: v for k, v in FILM.items() if k != "fit"}), (option,))


def test_swapped_files_are_refused(tmp_path: Path) -> None:
    recipe = tmp_path / "film.toml"
    recipe.write_text('family = "film"\nsubstrate = "Si"\n', encoding="utf-8")
    with pytest.raises(NacreError, match="film.toml: is a recipe"):
        read_measurement(recipe)


def test_spectra_are_equal_where_their_numbers_are() -> None:
    material = nacre.material(FILM)
    once, again = (material.spectrum(np.radians(ANGLES), WAVES) for _ in range(2))
    assert once == again
    assert once != material.vary({"layers[0].thickness_nm": 334.0}).spectrum(np.radians(ANGLES), WAVES)
    assert once != material.spectrum(np.radians(ANGLES[:1]), WAVES)
    assert once != "a spectrum"
