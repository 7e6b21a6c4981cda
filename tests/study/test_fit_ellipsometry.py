"""Fits of ellipsometer files: synthetic noisy measurements, ties, joint fits, intervals, and the shared real files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.ellipsometry import EllipsometryData
from nacre.analysis.fit import Fit, fit_parameters, read_measurement, read_measurements, run_fit
from nacre.analysis.ties import read_ties
from nacre.cli import run
from nacre.core.errors import NacreError, RecipeError
from nacre.readers.measurement import AmbiguousFileError, ReadOptions

SHARED = Path(__file__).resolve().parents[3] / "shared" / "reference" / "instruments" / "ellipsometry"
NOISE = 0.002  # of N, C, S: a good ellipsometer
WAVES = np.arange(400.0, 801.0, 10.0)
ANGLES = (65.0, 70.0, 75.0)
CAUCHY = {"cauchy": [1.46, 0.0035]}
WAFER: dict[str, Any] = {"family": "film", "substrate": "Si", "layers": [{"material": CAUCHY, "thickness_nm": 100.0}]}
FREE = ("layers[0].thickness_nm=10:1000", "layers[0].material.cauchy[0]=1.35:1.6",
        "layers[0].material.cauchy[1]=0:0.01")  # fmt: skip


def synthetic(recipe: dict[str, Any], seed: int, noise: float = NOISE, is_normalised: bool = False) -> EllipsometryData:
    found = nacre.ellipsometry(recipe, ANGLES, WAVES)
    ncs = np.stack([found.n, found.c, found.s]).reshape(3, -1)
    noisy = ncs + noise * np.random.default_rng(seed).standard_normal(ncs.shape)
    rows = np.tile(WAVES, len(ANGLES)), np.repeat(ANGLES, len(WAVES))
    return EllipsometryData("synthetic", *rows, ("ncs_n", "ncs_c", "ncs_s"), noisy, None, is_normalised)


def with_values(recipe: dict[str, Any], values: dict[str, float]) -> dict[str, Any]:
    return dict(nacre.material(recipe).vary(values).data)


def fitted(recipe: dict[str, Any], data: Any, parameters: tuple[str, ...], **options: Any) -> Fit:
    material = nacre.material(recipe)
    return run_fit(material, data, fit_parameters(material, parameters), **options)


def covered(draws: int) -> tuple[int, int]:
    """Return how many true values lie in their 95 % intervals, of how many; 2 to 4 numbers, 3 angles."""
    inside = count = 0
    extra = "instrument.angle_offset_deg=-0.3:0.3"
    for seed in range(draws):
        generator = np.random.default_rng(1000 + seed)
        paths = (FREE[:2], FREE, (*FREE, extra))[seed % 3]
        truth = {}
        for path in paths:
            name, bounds = path.split("=")
            low, high = (float(part) for part in bounds.split(":"))
            truth[name] = float(generator.uniform(low + 0.15 * (high - low), high - 0.15 * (high - low)))
        fit = fitted(WAFER, synthetic(with_values(WAFER, truth), seed), paths, starts=3)
        for number in fit.numbers:
            inside += number.interval[0] <= truth[number.path] <= number.interval[1]
            count += 1
    return inside, count


def test_the_truth_lies_in_its_intervals() -> None:
    inside, count = covered(6)
    assert inside >= 0.8 * count  # below this with p < 1e-3 at a coverage of 95 %


@pytest.mark.full
def test_a_hundred_synthetic_measurements_are_covered() -> None:
    inside, count = covered(100)
    assert 0.90 * count <= inside <= 0.99 * count


def test_the_order_of_interference_is_found() -> None:
    data = synthetic(with_values(WAFER, {"layers[0].thickness_nm": 4321.0}), 1)
    fit = fitted(WAFER, data, ("layers[0].thickness_nm=100:8000",), starts=1)
    assert fit.numbers[0].value == pytest.approx(4321.0, abs=5.0)


def test_tied_numbers_follow_one() -> None:
    three = {**WAFER, "layers": [{"material": m, "thickness_nm": 80.0} for m in ("SiO2", "TiO2", "SiO2")]}
    truth = {f"layers[{i}].thickness_nm": d for i, d in enumerate((123.0, 56.0, 123.0))}
    data = synthetic(with_values(three, truth), 2)
    material = nacre.material({**three, "ties": {"layers[2].thickness_nm": "layers[0].thickness_nm"}})
    numbers = fit_parameters(material, tuple(f"layers[{i}].thickness_nm=20:200" for i in (0, 1)))
    fit = run_fit(material, data, numbers)
    assert fit.numbers[0].value == pytest.approx(123.0, abs=0.5)
    assert fit.tied["layers[2].thickness_nm"] == fit.numbers[0].value
    assert fit.material.get("layers[2].thickness_nm") == fit.numbers[0].value
    one = nacre.material({**three, "numbers": {"d": 60.0}})
    ties = read_ties(one, ["numbers.d"], ("layers[0].thickness_nm=2*numbers.d + 3", "layers[2].thickness_nm=layers[0].thickness_nm"))  # fmt: skip  # noqa: E501
    assert ties.values({"numbers.d": 60.0})["layers[2].thickness_nm"] == 123.0


@pytest.mark.parametrize(
    "ties",
    [
        ("layers[0].thickness_nm=layers[1].thickness_nm", "layers[1].thickness_nm=layers[0].thickness_nm"),
        ("layers[0].thickness_nm=layers[0].thickness_nm",),
        ("layers[0].thickness_nm=layers[9].thickness_nm",),
        ("layers[9].thickness_nm=layers[0].thickness_nm",),
        ("layers[0].thickness_nm=__import__('os')",),
        ("layers[0].thickness_nm",),
        ("substrate=layers[0].thickness_nm",),
        ("layers[0].thickness_nm=layers[1].thickness_nm / 0",),
    ],
)
def test_wrong_ties_are_refused(ties: tuple[str, ...]) -> None:
    two = nacre.material({**WAFER, "layers": [{"material": "SiO2", "thickness_nm": 80.0}] * 2})
    with pytest.raises(RecipeError):
        read_ties(two, [], ties)


def test_a_free_number_cannot_be_tied() -> None:
    with pytest.raises(RecipeError):
        read_ties(nacre.material(WAFER), ["layers[0].thickness_nm"], ("layers[0].thickness_nm=5",))


def test_spread_and_bandwidth_are_found_from_depolarisation() -> None:
    thick = with_values(WAFER, {"layers[0].thickness_nm": 900.0, "instrument.thickness_spread_percent": 1.5})
    fit = fitted(
        WAFER, synthetic(thick, 3), ("layers[0].thickness_nm=800:1000", "instrument.thickness_spread_percent=0:5")
    )
    assert fit.numbers[0].value == pytest.approx(900.0, abs=1.0)
    assert fit.numbers[1].value == pytest.approx(1.5, abs=0.15)
    assert fit.correlation.shape == (2, 2)


def test_psi_delta_and_reflectance_are_fitted_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = nacre.material(with_values(WAFER, {"layers[0].thickness_nm": 250.0}))
    recipe, fitted_recipe = tmp_path / "wafer.toml", tmp_path / "fitted.toml"
    recipe.write_text(
        'family = "film"\nsubstrate = "Si"\nlayers = [{material = {cauchy = [1.46, 0.0035]}, thickness_nm = 100}]\n'
    )
    found = nacre.ellipsometry(truth, [70.0], WAVES)
    rows = "".join(f"{w}\t70\t{p:.3f}\t{d:.2f}\n" for w, p, d in zip(WAVES, found.psi_deg[0], found.delta_deg[0]))
    (tmp_path / "wafer.txt").write_text(f"nm\taoi\tPsi\tDelta\n{rows}")
    both = np.stack([truth.spectrum([0.5], WAVES, p).specular_reflectance[0] for p in "sp"])  # type: ignore[index]
    lines = "".join(f"{w},{float(np.degrees(0.5))},{s},{p}\n" for w, s, p in zip(WAVES, *both))
    (tmp_path / "r.csv").write_text(f"wavelength_nm,angle_deg,specular_reflectance_s,specular_reflectance_p\n{lines}")
    arguments = ["fit", str(tmp_path / "wafer.txt"), str(tmp_path / "r.csv"), str(recipe), "--parameter", FREE[0],
                 "--json", "--report", str(tmp_path / "fit.html"), "-o", str(fitted_recipe)]  # fmt: skip
    assert run(arguments) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["numbers"][0]["value"] == pytest.approx(250.0, abs=0.05)
    low, high = document["numbers"][0]["interval_95"]
    assert low <= document["numbers"][0]["value"] <= high
    assert [m["kind"] for m in document["measurements"]] == ["ellipsometry", "spectrum"]
    assert document["correlation"] == [[1.0]]
    assert document["numbers"][0]["at_bound"] is False
    assert nacre.load(fitted_recipe).get("layers[0].thickness_nm") == document["numbers"][0]["value"]
    assert "<img" in (tmp_path / "fit.html").read_text()


def test_a_number_at_its_bound_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    thick = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 30.0}]}
    table, recipe = write_table(tmp_path / "t.csv", 1.0, (70.0,), thick), tmp_path / "r.toml"
    recipe.write_text('family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 2}]\n')
    arguments = ["fit", str(table), str(recipe), "--parameter", "layers[0].thickness_nm=0:20", "--json"]
    assert run([*arguments, "-o", str(tmp_path / "f.toml")]) == 0
    assert json.loads(capsys.readouterr().out)["numbers"][0]["at_bound"] is True


def test_the_methods_of_intervals_agree_where_the_problem_is_linear() -> None:
    data = synthetic(WAFER, 5)
    widths = []
    for method in ("linear", "profile", "resampling"):
        number = fitted(WAFER, data, FREE[:1], starts=1, intervals=method).numbers[0]
        assert number.method == method
        widths.append(number.interval[1] - number.interval[0])
    assert widths[1] == pytest.approx(widths[0], rel=0.05)
    assert widths[2] == pytest.approx(widths[0], rel=0.35)  # 100 draws: the quantiles vary by some 10 %


def test_a_nonlinear_problem_gets_profile_intervals() -> None:
    # a film of 1 nm hardly determines its index
    data = synthetic(with_values(WAFER, {"layers[0].thickness_nm": 1.5}), 6)
    fit = fitted(WAFER, data, ("layers[0].thickness_nm=0:20", "layers[0].material.cauchy[0]=1.2:2.4"))
    assert {number.method for number in fit.numbers} == {"profile"}
    for number, true in zip(fit.numbers, (1.5, 1.46)):
        assert number.interval[0] <= true <= number.interval[1]


def write_table(path: Path, sign: float, angles: tuple[float, ...], recipe: dict[str, Any]) -> Path:
    found = nacre.ellipsometry(recipe, angles, WAVES)
    rows = [
        f"{w},{a},{found.psi_deg[i, j]},{180 - (180 - sign * found.delta_deg[i, j]) % 360}"
        for i, a in enumerate(angles)
        for j, w in enumerate(WAVES)
    ]
    path.write_text("wavelength (nm),angle of incidence (deg),Psi (deg),Delta (deg)\n" + "\n".join(rows) + "\n")
    return path


def test_bare_metals_and_wafers_decide_the_sign_of_delta(tmp_path: Path) -> None:
    gold = {"family": "film", "substrate": "Au"}
    data = read_measurement(write_table(tmp_path / "p.csv", 1.0, (65.0, 70.0), gold))
    same = read_measurement(write_table(tmp_path / "n.csv", -1.0, (65.0, 70.0), gold))
    np.testing.assert_allclose(same.values, data.values, atol=1e-12)
    film = write_table(tmp_path / "film.csv", 1.0, (70.0,), with_values(WAFER, {"layers[0].thickness_nm": 300.0}))
    with pytest.raises(AmbiguousFileError) as failure:
        read_measurement(film)
    assert failure.value.option == "delta_convention"
    positive, negative = (read_measurement(film, ReadOptions(delta_convention=c)) for c in ("positive", "negative"))
    np.testing.assert_allclose(positive.values[2], -negative.values[2])


def test_a_missing_angle_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, recipe = tmp_path / "t.csv", tmp_path / "r.toml"
    oxide = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 20.0}]}
    found = nacre.ellipsometry(oxide, [70.0], WAVES)
    rows = (f"{w},{p},{d}\n" for w, p, d in zip(WAVES, found.psi_deg[0], found.delta_deg[0], strict=True))
    table.write_text("wavelength (nm),Psi (deg),Delta (deg)\n" + "".join(rows))
    recipe.write_text('family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 2}]\n')
    arguments = ["fit", str(table), str(recipe), "--parameter", FREE[0], "-o", str(tmp_path / "f.toml")]
    assert run(arguments) == 2
    assert "--angle-deg" in capsys.readouterr().err
    assert not (tmp_path / "f.toml").exists()
    assert run([*arguments, "--angle-deg", "70"]) == 0
    with pytest.raises(NacreError):
        read_measurements([])


SILICA_30 = 'layers = [{material = "SiO2", thickness_nm = 30}, {material = "TiO2-film", thickness_nm = 30}]'
TWISTED = "layers = [{material = {ordinary = 1.5, extraordinary = 1.7, axis_polar_deg = 90}, thickness_nm = 90, %s}]"
SECOND = ("--parameter", "layers[1].thickness_nm=10:50")
TENSOR = "layers = [{material = {principal = [1.5, 1.6, %s], euler_deg = %s}, thickness_nm = 100}]"


@pytest.mark.parametrize(
    ("lines", "options"),
    [
        (SILICA_30, (*SECOND, "--tie", "layers[0].thickness_nm=layers[0].thickness_nm + 1")),
        (f"{SILICA_30}\n[ties]\n'layers[0].thickness_nm' = 'layers[0].thickness_nm'", SECOND),
        (f"{SILICA_30}\n[surface]\ninterface_roughness_nm = 50", ()),
        (TWISTED % "pitch_nm = 0", ()),
        (TWISTED % "pitch_nm = 0.01", ()),
        (TENSOR % ("{n = 1.7, k = -0.1}", "[0, 0, 0]"), ()),
        (TENSOR % ("1.7", "[0, nan, 0]"), ()),
        (TENSOR % ("1.7", "[0, 1]"), ()),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(
    lines: str, options: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_table(tmp_path / "t.csv", 1.0, (70.0,), {"family": "film", "substrate": "Au"})
    recipe, fitted_file = tmp_path / "r.toml", tmp_path / "f.toml"
    recipe.write_text(f'family = "film"\nsubstrate = "Si"\n{lines}\n')
    assert run(["fit", str(table), str(recipe), "-o", str(fitted_file), *options]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1 and "r.toml" in errors[0]
    assert not fitted_file.exists()


SILICON, SILICA = "main/Si/Aspnes", "main/SiO2/Malitson"
VACUUM = {"n": 1.0}
# fits of the same models by pyElli 0.23.1 to N, C and S: thicknesses in nm and mean squared error
BY_PYELLI: dict[str, tuple[dict[str, Any], tuple[float, float], str | None, dict[str, str], list[float], float]] = {
    "ellips.test.nxs": (
        {"substrate": SILICON, "layers": [{"material": SILICA, "thickness_nm": 5.0}]},
        (300.0, 800.0), None, {"layers[0].thickness_nm": "0:50"}, [2.0154], 3.0656,
    ),
    "TiO2_400cycles.txt": (
        {"substrate": SILICON, "layers": [{"material": {"cauchy": [2.2, 0.02, 0.001]}, "thickness_nm": 20.0},
                                          {"material": SILICA, "thickness_nm": 250.0}]},
        (400.0, 800.0), None,
        {"layers[0].thickness_nm": "5:60", "layers[1].thickness_nm": "200:350",
         "layers[0].material.cauchy[0]": "1.8:2.6", "layers[0].material.cauchy[1]": "-0.05:0.1",
         "layers[0].material.cauchy[2]": "-0.01:0.02"}, [23.8902, 278.5117], 3.4742,
    ),
    "Si3N4_on_4inBF33_W02_20240903-150451.ds.dat": (  # its fringes turn in the sense of a negative Delta
        {"substrate": {"cauchy": [1.46, 0.004]},
         "layers": [{"material": {"cauchy": [2.0, 0.02]}, "thickness_nm": 800.0}]},
        (480.0, 1500.0), "negative",
        {"layers[0].thickness_nm": "600:1200", "layers[0].material.cauchy[0]": "1.7:2.3",
         "layers[0].material.cauchy[1]": "0:0.06"}, [780.373], 51.8575,
    ),
    "Wafer_MM_70.txt": (
        {"substrate": SILICON, "layers": [{"material": SILICA, "thickness_nm": 50.0}]},
        (300.0, 800.0), None, {"layers[0].thickness_nm": "0:300"}, [103.9456], 0.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BY_PYELLI)
def test_fits_of_real_files_agree_with_those_of_pyelli(name: str) -> None:
    if not SHARED.exists():
        pytest.skip("the shared reference data are not here")
    recipe, low_high, convention, bounds, thicknesses, mse = BY_PYELLI[name]
    data = read_measurement(SHARED / name, ReadOptions(delta_convention=convention), low_high)
    parameters = tuple(f"{path}={ends}" for path, ends in bounds.items())
    fit = fitted({"family": "film", "ambient": VACUUM, **recipe}, data, parameters)
    for number, expected in zip(fit.numbers, thicknesses):
        assert number.interval[0] <= expected <= number.interval[1]
    part = fit.parts[0]
    assert part.mse is not None
    if mse:  # that of a Mueller file counts more elements than N, C and S
        assert part.mse <= mse * (1 + 1e-3)


def test_the_axes_of_a_biaxial_film_are_found_from_its_mueller_matrices() -> None:
    film = {"principal": [{"n": 1.51}, {"n": 1.55}, {"n": 1.66}], "euler_deg": [30.0, 60.0, 0.0]}
    recipe = {
        "family": "film", "substrate": "Si", "layers": [{"material": film, "thickness_nm": 300.0}],
        "instrument": {"azimuth_deg": 45.0},
    }  # fmt: skip
    waves = WAVES[::4]
    found = nacre.ellipsometry(recipe, ANGLES, waves)
    names = tuple(f"m{i}{j}" for i in range(1, 5) for j in range(1, 5))[1:]
    exact = np.stack([found.relative[..., int(m[1]) - 1, int(m[2]) - 1].ravel() for m in names])
    noisy = exact + NOISE * np.random.default_rng(0).standard_normal(exact.shape)
    rows = np.tile(waves, len(ANGLES)), np.repeat(ANGLES, len(waves))
    data = EllipsometryData("synthetic", *rows, names, noisy, None, False)
    fit = fitted(recipe, data, ("layers[0].material.euler_deg[1]=40:80", "layers[0].thickness_nm=250:350"), starts=1)
    assert fit.numbers[0].value == pytest.approx(60.0, abs=0.3)
    assert fit.numbers[1].value == pytest.approx(300.0, abs=0.3)


def test_one_time_of_a_dynamic_measurement_is_fitted(tmp_path: Path) -> None:
    rows = []
    for time, thickness in ((0.5, 20.0), (1.5, 30.0)):
        found = nacre.ellipsometry(with_values(WAFER, {"layers[0].thickness_nm": thickness}), [70.0], WAVES)
        rows += [
            f"E {w:.3f} 70 {p:.5f} {d:.5f} 0.05 0.2 {time}"
            for w, p, d in zip(WAVES, found.psi_deg[0], found.delta_deg[0], strict=True)
        ]
    path = tmp_path / "growth.dat"
    path.write_text("growth\nVASEmethod[EllipsometerType=7]\nDynamic\nnm\n" + "\n".join(rows) + "\n")
    with pytest.raises(AmbiguousFileError) as failure:
        read_measurement(path)
    assert failure.value.option == "spectrum"
    fit = fitted(WAFER, read_measurement(path, ReadOptions(spectrum="2")), FREE[:1], starts=1)
    assert fit.numbers[0].value == pytest.approx(30.0, abs=0.01)
