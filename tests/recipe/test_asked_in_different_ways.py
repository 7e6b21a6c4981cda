"""Random recipes asked in different ways have one answer: within rounding, or within an error that is stated.

`NACRE_ASKED_RECIPES` sets their number (300 for the full proof) and `NACRE_ASKED_FIRST` the first seed; the counts by
family and question go to `NACRE_ASKED_COUNTS` if it names a file.
"""

from __future__ import annotations

import copy
import csv
import functools
import io
import os
from collections import Counter
from pathlib import Path
from typing import Any

import colour
import numpy as np
import pytest
from random_recipes import random_film, random_metasurface, random_pearl, random_relief
from scipy.interpolate import CubicSpline

import nacre
from nacre.bsdf import Bsdf
from nacre.core.errors import NacreError
from nacre.measure.colours import colour_bsdf
from nacre.recipe.toml import dump_toml

COUNT = int(os.environ.get("NACRE_ASKED_RECIPES", "30"))
FIRST = int(os.environ.get("NACRE_ASKED_FIRST", "400"))  # seed of the first recipe
LAM = np.linspace(420.0, 680.0, 6)
ANGLES_DEG = np.array([0.0, 35.0, 70.0])
PRINTED = 6e-6  # of a power in a table of the command
TABLE = 2e-4  # of R and T of smooth films between nodes, unless the file states more
LAB = 0.02  # CIELAB: colour-science integrates by other rules
SWEPT = 0.5  # CIELAB of a sweep, whose wavelength grid may be coarser: the bar of grids, dE00 0.5
SWEEP_EVERY = 30  # recipes of which one is swept, on one and two workers
SPLIT = 1e-9  # one layer in two
WALK_SPLIT, WALK_MEAN = 0.05, 0.01  # of a glass: noise of the random walk through strata, and of its mean of 18
FAMILIES = (*["film"] * 26, "glass", "metasurface", "relief", "pearl")  # films are quick


def random_glass(g: np.random.Generator) -> dict[str, Any]:
    spheres = {
        "material": {"n": 1.59},
        "radius_nm": float(g.uniform(90, 150)),
        "volume_fraction": float(g.uniform(0.3, 0.5)),
    }
    return {"family": "glass", "thickness_um": float(g.uniform(5, 20)), "spheres": spheres, "absorber": {"k": 0.001}}


def random_recipe(seed: int, folder: Path) -> dict[str, Any]:
    g = np.random.default_rng([37, seed])
    made = {
        "film": lambda: random_film(g), "pearl": lambda: random_pearl(g) | {"quality": "fast"},
        "glass": lambda: random_glass(g), "metasurface": lambda: random_metasurface(g),
        "relief": lambda: random_relief(g, folder),
    }  # fmt: skip
    data: dict[str, Any] = made[FAMILIES[seed % len(FAMILIES)]]()
    if data["family"] == "film" and seed % 2:
        data.pop("surface")
    return data


def in_um(data: Any) -> Any:
    """Return a recipe with its lengths in micrometres."""
    if isinstance(data, dict):
        return {
            (f"{key[:-3]}_um" if key.endswith("_nm") else key): (
                value / 1e3 if key.endswith("_nm") and isinstance(value, float | int) else in_um(value)
            )
            for key, value in data.items()
        }
    return [in_um(each) for each in data] if isinstance(data, list) else data


def values(material: Any) -> dict[str, np.ndarray]:
    return material.spectrum(np.radians(ANGLES_DEG), LAM).parts()


def close(one: dict[str, np.ndarray], other: dict[str, np.ndarray], tolerance: float) -> None:
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=tolerance, err_msg=name)


def from_command(path: Path, capsys: pytest.CaptureFixture[str], jobs: int) -> dict[str, np.ndarray]:
    from nacre.cli import run

    angles, grid = (",".join(f"{x:g}" for x in each) for each in (ANGLES_DEG, LAM))
    arguments = ["spectrum", str(path), "--angles-deg", angles, "--wavelengths-nm", grid, "--jobs", str(jobs)]
    assert run(arguments) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    names = [name for name in rows[0] if name.startswith(("specular_", "diffuse_"))]
    return {name: np.array([float(row[name]) for row in rows]).reshape(len(ANGLES_DEG), len(LAM)) for name in names}


def check(seed: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> Counter[str]:
    """Compare all answers of one random recipe; return how often each question was put."""
    data = random_recipe(seed, folder)
    asked = Counter(dict.fromkeys((data["family"], "again", "um", "jobs 1", "jobs 2", "stored", "colour-science"), 1))
    path = folder / "asked.toml"
    path.write_text(dump_toml(data))
    material = nacre.load(path)
    found = values(material)
    close(found, values(nacre.load(path)), 0.0)
    (folder / "um.toml").write_text(dump_toml(in_um(data)))
    close(found, values(nacre.load(folder / "um.toml")), 1e-9)
    printed = from_command(path, capsys, 1)
    close(found, printed, PRINTED)
    close(printed, from_command(path, capsys, 2), 0.0)
    bsdf = material.bsdf(LAM)
    bsdf.save(folder / "asked.nacre")
    stored = Bsdf.load(folder / "asked.nacre")
    assert stored.fingerprint == bsdf.fingerprint
    if data["family"] == "film":
        check_film(data, material, found, stored)
        asked["split"] += bool(data["layers"])
        if "surface" not in data:
            check_report(material)
            asked["report"] += 1
        if seed % SWEEP_EVERY == 1 and data["layers"]:
            check_sweep(path, folder, data["layers"][0]["thickness_nm"])
            asked["sweep"] += 1
    if data["family"] == "glass":
        halves = {**data, "thickness_um": 0.5 * data["thickness_um"]}
        halves.pop("family")
        split = nacre.material({"family": "glass", "strata": [halves, copy.deepcopy(halves)]})
        for name, value in values(split).items():
            np.testing.assert_allclose(value, found[name], atol=WALK_SPLIT)
            assert abs(np.mean(value - found[name])) <= WALK_MEAN
        asked["split"] += 1
    check_colour(found)
    return asked


def check_film(data: dict[str, Any], material: Any, found: dict[str, np.ndarray], stored: Bsdf) -> None:
    """The compiled table against the solution, and a layer split in two."""
    if "surface" not in data:
        allowed = max(TABLE, stored.provenance["angle_table"]["largest_error"])
        delta = stored.specular(np.radians(ANGLES_DEG))
        assert np.max(np.abs(delta.reflectance - found["specular_reflectance"])) <= allowed
    if data["layers"]:
        split = copy.deepcopy(data)
        half = {**split["layers"][0], "thickness_nm": 0.5 * split["layers"][0]["thickness_nm"]}
        split["layers"][:1] = [half, dict(half)]
        close(found, values(nacre.material(split)), SPLIT)


def check_report(material: Any) -> None:
    """The report's colours at the mirror against colour-science, from splines of its numbers and from 1 nm.

    The report uses the table over the angle; its error (`TABLE`, or what the file states) may change a colour by some
    500 times as much, the slope of CIELAB above L* of 10.
    """
    report = nacre.report(material)
    angles, bsdf = np.radians(np.asarray(report.specular.angles_deg)), colour_bsdf(material, "D65")
    fine = np.arange(380.0, 781.0)
    direct = material.spectrum(angles, fine).specular_reflectance
    stated = 500.0 * max(TABLE, bsdf.provenance["angle_table"]["largest_error"])
    every_nm = np.arange(bsdf.wavelengths_nm[0], bsdf.wavelengths_nm[-1] + 0.5)
    splines = CubicSpline(bsdf.wavelengths_nm, bsdf.specular(angles).reflectance, axis=-1)(every_nm)
    for nm, rows, allowed in ((every_nm, splines, LAB), (fine, direct, SWEPT + stated)):
        for row, lab in zip(rows, report.specular.lab, strict=True):
            assert np.max(np.abs(np.asarray(lab) - lab_of_colour_science(row, nm))) <= allowed


def check_sweep(path: Path, folder: Path, thickness_nm: float) -> None:
    """A sweep of one point on one and on two workers."""
    import xarray

    axes = {"layers[0].thickness_nm": [thickness_nm, thickness_nm + 10.0]}
    sweep = {"recipe": path.name, "axes": axes, "measure": {"angles_deg": [0], "wavelengths_nm": LAM.tolist()}}
    (folder / "sweep.toml").write_text(dump_toml(sweep))
    found = []
    for jobs in (1, 2):
        nacre.sweep(folder / "sweep.toml", folder / f"{jobs}.zarr", jobs=jobs)
        with xarray.open_zarr(folder / f"{jobs}.zarr", consolidated=False) as store:
            found.append({name: np.asarray(store[name])[0, 0] for name in store if name.endswith("reflectance")})
    direct = nacre.load(path).spectrum(np.radians([0.0]), LAM).parts()
    assert found[0].keys() == found[1].keys()
    for name, value in found[0].items():
        np.testing.assert_array_equal(value, found[1][name])
        if name in direct:
            np.testing.assert_allclose(value, direct[name][0], rtol=0.0, atol=1e-9)


@functools.cache
def cie_tables() -> tuple[Any, Any, Any]:
    """Return grid, observer and lamp of colour-science."""
    shape = colour.SpectralShape(360, 830, 1)
    observer = colour.MSDS_CMFS["CIE 1964 10 Degree Standard Observer"].copy().align(shape)
    return shape, observer, colour.SDS_ILLUMINANTS["D65"].copy().align(shape)


def lab_of_colour_science(values: np.ndarray, nm: np.ndarray) -> np.ndarray:
    """CIELAB under D65 at 10 degrees by colour-science, of a spectrum interpolated to 1 nm."""
    fine = np.arange(360.0, 831.0)
    spectrum = np.interp(fine, nm, np.asarray(values))
    shape, observer, lamp = cie_tables()
    sd = colour.SpectralDistribution(dict(zip(fine, spectrum, strict=True)))
    xyz = colour.sd_to_XYZ(sd, observer, lamp, method="Integration")
    white = colour.sd_to_XYZ(colour.sd_ones(shape), observer, lamp, method="Integration")
    return np.asarray(colour.XYZ_to_Lab(xyz / white[1], colour.XYZ_to_xy(white)))


def check_colour(found: dict[str, np.ndarray]) -> None:
    """Colours of the report's integration against colour-science, for this spectrum interpolated to 1 nm."""
    value = sum(np.asarray(part) for name, part in found.items() if name.endswith("reflectance"))
    fine = np.arange(360.0, 831.0)
    spectrum = np.interp(fine, LAM, np.clip(np.asarray(value)[0], 0.0, 1.0))
    ours = nacre.light.xyz_to_lab(
        nacre.light.spectrum_to_xyz(spectrum, fine, "D65", "10deg"), nacre.light.white_xyz("D65", "10deg")
    )
    theirs = lab_of_colour_science(spectrum, fine)
    assert np.max(np.abs(np.asarray(ours) - theirs)) <= LAB


@pytest.mark.parametrize("seed", range(4))
def test_a_random_film_has_one_answer(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(seed, tmp_path, capsys)


@pytest.mark.full
def test_random_recipes_have_one_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    counts: Counter[str] = Counter()
    for seed in range(FIRST, FIRST + COUNT):
        folder = tmp_path / str(seed)
        folder.mkdir()
        try:
            counts += check(seed, folder, capsys)
        except NacreError as error:
            assert "\n" not in str(error)
            counts["refused"] += 1
        if "NACRE_ASKED_COUNTS" in os.environ:
            Path(os.environ["NACRE_ASKED_COUNTS"]).write_text(f"{seed}: {dict(counts)}\n")


@pytest.mark.full
def test_a_sweep_on_one_and_two_workers_and_a_single_answer_agree(tmp_path: Path) -> None:
    film = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100.0}]}
    (tmp_path / "film.toml").write_text(dump_toml(film))
    sweep = {
        "recipe": "film.toml",
        "axes": {"layers[0].thickness_nm": [100.0, 150.0, 200.0]},
        "measure": {"angles_deg": [0, 50]},
    }
    (tmp_path / "sweep.toml").write_text(dump_toml(sweep))
    import xarray

    labs = []
    for jobs in (1, 2):
        nacre.sweep(tmp_path / "sweep.toml", tmp_path / f"{jobs}.zarr", jobs=jobs)
        with xarray.open_zarr(tmp_path / f"{jobs}.zarr", consolidated=False) as store:
            labs.append(np.asarray(store["lab_specular_reflectance"]))
    np.testing.assert_array_equal(labs[0], labs[1])
    light = nacre.light
    for row, thickness in zip(labs[0], (100.0, 150.0, 200.0), strict=True):
        layers = [{"material": "SiO2", "thickness_nm": thickness}]
        one = nacre.material({"family": "film", "substrate": "Si", "layers": layers}).spectrum(np.radians([0.0, 50.0]))
        assert one.specular_reflectance is not None
        xyz = light.spectrum_to_xyz(one.specular_reflectance, one.wavelengths_nm, "D65", "10deg")
        np.testing.assert_allclose(row, light.xyz_to_lab(xyz, light.white_xyz("D65", "10deg")), atol=SWEPT)
