"""Sweeps: right numbers, resumable at any moment, nothing doubled, errors recorded."""

from __future__ import annotations

import inspect
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from helpers_study import dask_over_tcp

from nacre.analysis.report import make_report
from nacre.analysis.sweep import Store, run_sweep
from nacre.analysis.sweep_plan import Measurement, load_sweep, point_seed, read_points
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers
from nacre.light import delta_e_2000, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.material.material import load, material
from nacre.measure.colours import colour_bsdf, colour_spectrum

ACROSS_PROCESSES = 1e-12  # the same code on the same machine; a sum may be ordered differently
KILLS = 20
RECIPE = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'


def write_sweep(folder: Path, count: int = 12, extra: str = "") -> Path:
    (folder / "film.toml").write_text(RECIPE)
    path = folder / "sweep.toml"
    path.write_text(
        f'recipe = "film.toml"\n{extra}\n[axes]\n'
        f'"layers[0].thickness_nm" = {{start = 100, stop = 400, count = {count}}}\n'
        'substrate = ["Si", "Ag"]\n[measure]\nangles_deg = [0, 45]\nwavelengths_nm = [450, 550, 650]\n'
    )
    return path


def read_all(path: Path) -> dict[str, np.ndarray]:
    import xarray

    with xarray.open_zarr(path, consolidated=False) as data:
        return {name: data[name].values.copy() for name in data.variables}


def test_a_sweep_holds_what_a_single_run_gives(tmp_path: Path) -> None:
    sweep = load_sweep(write_sweep(tmp_path, 3))
    assert run_sweep(sweep, tmp_path / "s.zarr", workers=Workers(1)) == (6, 0)
    found = read_all(tmp_path / "s.zarr")
    material = sweep.material.vary({"layers[0].thickness_nm": 250.0, "substrate": "Ag"})
    alone = material.spectrum(np.radians([0, 45]), [450, 550, 650]).specular_reflectance
    np.testing.assert_allclose(found["specular_reflectance"][1, 1], alone, rtol=1e-12)
    np.testing.assert_allclose(found["layers.0.thickness_nm"], [100, 250, 400])
    assert np.all(found["status"] == 1)


def test_the_axes_are_labelled_for_xarray(tmp_path: Path) -> None:
    import xarray

    run_sweep(load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr", workers=Workers(1))
    with xarray.open_zarr(tmp_path / "s.zarr", consolidated=False) as data:
        assert data["lab_specular_reflectance"].dims == ("layers.0.thickness_nm", "substrate", "angle_deg", "lab")
        assert data["substrate"].attrs["labels"] == ["Si", "Ag"]
        assert data["angle_deg"].values.tolist() == [0, 45]


def test_a_finished_sweep_computes_nothing_again(tmp_path: Path) -> None:
    sweep = load_sweep(write_sweep(tmp_path, 2))
    run_sweep(sweep, tmp_path / "s.zarr", workers=Workers(1))
    stamps = {p: p.stat().st_mtime_ns for p in (tmp_path / "s.zarr").rglob("*") if p.is_file()}
    assert run_sweep(sweep, tmp_path / "s.zarr", workers=Workers(1)) == (4, 0)
    assert stamps == {p: p.stat().st_mtime_ns for p in (tmp_path / "s.zarr").rglob("*") if p.is_file()}


def test_a_store_of_another_sweep_is_refused(tmp_path: Path) -> None:
    run_sweep(load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr", workers=Workers(1))
    with pytest.raises(NacreError, match="another sweep"):
        run_sweep(load_sweep(write_sweep(tmp_path, 3)), tmp_path / "s.zarr", workers=Workers(1))


def test_a_failed_point_records_its_error_and_stops_nothing(tmp_path: Path) -> None:
    path = write_sweep(tmp_path, 2)
    path.write_text(path.read_text().replace('["Si", "Ag"]', '["Si", "Unobtainium"]'))
    assert run_sweep(load_sweep(path), tmp_path / "s.zarr", workers=Workers(1)) == (2, 2)
    assert "Unobtainium" in (tmp_path / "s.errors.jsonl").read_text()
    assert np.sum(read_all(tmp_path / "s.zarr")["status"] == 2) == 2


@pytest.mark.parametrize("mode", ["random", "sobol"])
def test_random_points_are_the_same_for_the_same_seed(mode: str) -> None:
    axes = {"a": {"low": 1.0, "high": 100.0, "log": True}, "b": {"low": 0.0, "high": 1.0}}
    first, second = (read_points(axes, mode, 20, 7, "s") for _ in range(2))
    assert list(first) == list(second)
    assert list(first) != list(read_points(axes, mode, 20, 8, "s"))
    assert all(1 <= p["a"] <= 100 and 0 <= p["b"] <= 1 for p in first)


def test_a_points_seed_depends_on_its_parameters_alone() -> None:
    assert point_seed({"a": 1.0, "b": 2}) == point_seed({"b": 2, "a": 1.0})
    assert point_seed({"a": 1.0}) != point_seed({"a": 1.0000001})


@pytest.mark.parametrize(
    ("extra", "what"),
    [
        ('mode = "gird"', "gird"),
        ("count = -1\nmode = 'random'", "count"),
        ("speed = 3", "speed"),
        ("[measure]\nangles_deg = [95]", "twice|angles|measure"),
    ],
)
def test_a_wrong_sweep_is_refused_in_one_line(tmp_path: Path, extra: str, what: str) -> None:
    path = write_sweep(tmp_path, 2, extra)
    with pytest.raises(NacreError, match=what) as caught:
        load_sweep(path)
    assert "\n" not in str(caught.value)


def test_an_axis_that_the_recipe_lacks_is_named(tmp_path: Path) -> None:
    path = write_sweep(tmp_path, 2)
    path.write_text(path.read_text().replace("layers[0].thickness", "layers[3].thickness"))
    with pytest.raises(NacreError, match=r"layers\[3\]"):
        load_sweep(path)


def _kill_and_resume(tmp_path: Path, moments: list[float], workers: int) -> None:
    path = write_sweep(tmp_path, 150)
    reference = tmp_path / "reference.zarr"
    run_sweep(load_sweep(path), reference, workers=Workers(1))
    expected = read_all(reference)
    store = tmp_path / "killed.zarr"
    code = (
        "import sys; from nacre.analysis.sweep import load_sweep, run_sweep; from nacre.core.jobs import Workers\n"
        f"run_sweep(load_sweep(sys.argv[1]), sys.argv[2], workers=Workers({workers}))"
    )
    kept: dict[Path, bytes] = {}
    for moment in moments:
        process = subprocess.Popen([sys.executable, "-c", code, str(path), str(store)], start_new_session=True)
        time.sleep(moment)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if store.exists():
            for file, content in kept.items():
                assert file.read_bytes() == content, f"a finished point changed: {file}"
            finished = {p for p in store.glob("status/c.*") if p.suffix != ".partial"}
            kept = {p: p.read_bytes() for p in finished}
    finished_before = len(kept)
    sweep = load_sweep(path)
    assert finished_before == 0 or len(Store.open(store, sweep).missing()) == sweep.points.count - finished_before
    run_sweep(sweep, store, workers=Workers(1))
    found = read_all(store)
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_killed_sweep_loses_no_finished_point(tmp_path: Path) -> None:
    generator = random.Random(4)
    _kill_and_resume(tmp_path, [1.0 + generator.random() for _ in range(3)], workers=1)


@pytest.mark.full
def test_twenty_kills_lose_double_and_change_no_point(tmp_path: Path) -> None:
    generator = random.Random(5)
    _kill_and_resume(tmp_path, [0.9 + 0.8 * generator.random() for _ in range(20)], workers=1)


@pytest.mark.full
def test_a_killed_worker_costs_no_point(tmp_path: Path) -> None:
    import psutil

    path = write_sweep(tmp_path, 600)
    sweep = load_sweep(path)
    run_sweep(sweep, tmp_path / "reference.zarr", workers=Workers(1))
    killed = 0
    generator = random.Random(6)

    def is_worker(process: psutil.Process) -> bool:
        try:
            words = " ".join(process.cmdline())
        except psutil.Error:  # killed before, and not yet buried
            return False
        return "forkserver" not in words and "resource_tracker" not in words

    due = sorted(generator.uniform(0, 0.95 * sweep.points.count) for _ in range(KILLS))

    def progress(done: int, failed: int, total: int) -> None:
        nonlocal killed
        if killed < KILLS and done > due[killed]:
            workers = [c for c in psutil.Process().children(recursive=True) if is_worker(c)]
            if workers:
                generator.choice(workers).kill()
                killed += 1

    finished, failed = run_sweep(sweep, tmp_path / "two.zarr", workers=Workers(2), progress=progress)
    assert (finished, failed) == (sweep.points.count, 0)
    assert killed == KILLS
    expected, found = read_all(tmp_path / "reference.zarr"), read_all(tmp_path / "two.zarr")
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12)


@pytest.mark.full
def test_two_workers_over_tcp_give_what_one_gives(tmp_path: Path) -> None:
    sweep = load_sweep(write_sweep(tmp_path, 100))
    run_sweep(sweep, tmp_path / "one.zarr", workers=Workers(1))
    with dask_over_tcp(tmp_path, 2) as address:
        assert address.startswith("tcp://127.0.0.1:")
        assert run_sweep(sweep, tmp_path / "two.zarr", workers=Workers(cluster=address)) == (200, 0)
    expected, found = read_all(tmp_path / "one.zarr"), read_all(tmp_path / "two.zarr")
    assert expected.keys() == found.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=ACROSS_PROCESSES, atol=ACROSS_PROCESSES)


def test_a_scheduler_that_is_not_there_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nacre.core.jobs.CONNECT_TIMEOUT_S", 1)
    sweep = load_sweep(write_sweep(tmp_path, 2))
    with pytest.raises(NacreError, match="tcp://127.0.0.1:1") as caught:
        run_sweep(sweep, tmp_path / "s.zarr", workers=Workers(cluster="tcp://127.0.0.1:1"))
    assert "\n" not in str(caught.value)


PEARL = (
    'family = "pearl"\nstrata = [{resin = {n = 1.5}, thickness_um = 20, platelets = [{volume_fraction = 0.02, '
    'substrate = {material = "mica", thickness_nm = 400}, coatings = [{material = "TiO2", thickness_nm = 60}]}]}]\n'
    "base = {albedo = 0.2}\n"
)


def write_pearl_sweep(folder: Path) -> Path:
    (folder / "pearl.toml").write_text(PEARL)
    path = folder / "sweep.toml"
    path.write_text(
        'recipe = "pearl.toml"\n[axes]\n"base.albedo" = [0.2, 0.5]\n[measure]\nangles_deg = [30]\n'
        'wavelengths_nm = [450, 650]\nparts = ["diffuse_reflectance"]\n'
    )
    return path


@pytest.mark.render
def test_a_points_seed_reaches_the_random_walk(tmp_path: Path) -> None:
    from nacre.analysis.sweep_plan import point_seed

    sweep = load_sweep(write_pearl_sweep(tmp_path))
    lam = np.array([450.0, 650.0])
    material = sweep.material.vary({"base.albedo": 0.5})
    once, again, other = (material.spectrum([0.5], lam, seed=s).diffuse_reflectance for s in (1, 1, 2))
    np.testing.assert_array_equal(once, again)
    assert np.all(once != other)
    np.testing.assert_allclose(once, other, rtol=0.1)
    found = sweep.measurement.take(material, point_seed({"base.albedo": 0.5}))["diffuse_reflectance"]
    same = material.spectrum([np.radians(30)], lam, seed=point_seed({"base.albedo": 0.5})).diffuse_reflectance
    np.testing.assert_array_equal(found, same)


@pytest.mark.full
@pytest.mark.render
def test_two_workers_over_tcp_walk_a_pearl_as_one_does(tmp_path: Path) -> None:
    sweep = load_sweep(write_pearl_sweep(tmp_path))
    run_sweep(sweep, tmp_path / "one.zarr", workers=Workers(1))
    with dask_over_tcp(tmp_path, 2) as address:
        assert run_sweep(sweep, tmp_path / "two.zarr", workers=Workers(cluster=address)) == (2, 0)
    expected, found = read_all(tmp_path / "one.zarr"), read_all(tmp_path / "two.zarr")
    assert expected.keys() == found.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=ACROSS_PROCESSES, atol=ACROSS_PROCESSES)


@pytest.mark.parametrize("observer", ["2deg", "10deg"])
@pytest.mark.parametrize("lamp", ["D65", "A", "F2", "F11", "LED-B3"])
def test_a_sweeps_colours_are_within_half_a_de_of_a_fine_grid_under_every_lamp(lamp: str, observer: str) -> None:
    """Sixty films; under F11 the default step of 10 nm gave 0.61: its lines need additional wavelengths."""
    g = np.random.default_rng(0)
    fine = np.arange(360.0, 831.0)
    angles = (0.0, 45.0, 60.0)
    white = white_xyz(lamp, observer)
    worst = 0.0
    for _ in range(60):
        layers = [
            {"material": str(g.choice(["SiO2", "TiO2", "MgF2", "Ag"])), "thickness_nm": float(g.uniform(5, 600))}
            for _ in range(g.integers(1, 6))
        ]
        for layer in layers:
            if layer["material"] == "Ag":
                layer["thickness_nm"] = float(g.uniform(5, 40))
        substrate = str(g.choice(["Si", "Au", "glass", "Cr"]))
        film = material({"family": "film", "substrate": substrate, "layers": layers})
        found = Measurement(angles, lamp, observer).take(film, 0)["lab_specular_reflectance"]
        exact = film.spectrum(np.radians(angles), fine).specular_reflectance
        assert exact is not None
        expected = xyz_to_lab(spectrum_to_xyz(exact, fine, lamp, observer), white)
        worst = max(worst, float(np.max(delta_e_2000(found, expected))))
    assert worst <= 0.5


def test_what_keeps_its_wavelengths_is_seen_under_a_narrow_lamp_on_those(tmp_path: Path) -> None:
    nm = np.arange(380.0, 781.0, 10.0)
    material({"family": "film", "substrate": "Au"}).bsdf(nm).save(tmp_path / "gold.nacre")
    stored = load(tmp_path / "gold.nacre")
    assert np.array_equal(colour_spectrum(stored, np.zeros(1), "F11").wavelengths_nm, nm)
    assert len(colour_bsdf(stored, "F11").wavelengths_nm) == len(nm)


def test_colours_are_labelled_and_of_the_reports_observer(tmp_path: Path) -> None:
    import zarr

    run_sweep(load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr", workers=Workers(1))
    group = zarr.open_group(tmp_path / "s.zarr", mode="r")
    assert group["lab"].attrs["labels"] == ["L*", "a*", "b*"]
    assert group["xyz"].attrs["labels"] == ["X", "Y", "Z"]
    assert group.attrs["observer"] == inspect.signature(make_report).parameters["observer"].default == "10deg"
