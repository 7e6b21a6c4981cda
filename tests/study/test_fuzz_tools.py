"""Mutated sweeps, measurements and imports: an answer or one clear line, never a traceback or half a file."""

from __future__ import annotations

import random
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers_fuzz import mutate, mutate_bytes

import nacre
from nacre.analysis.fit import read_measurement
from nacre.analysis.import_export import export_material, import_material
from nacre.analysis.sweep_plan import load_sweep
from nacre.core.errors import NacreError

QUICK, FULL = 300, 2000
RECIPE = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
SWEEPS = (
    'recipe = "film.toml"\n[axes]\nsubstrate = ["Si", "Ag"]\n'
    '"layers[0].thickness_nm" = {start = 1, stop = 9, count = 3}\n'
    "[measure]\nangles_deg = [0, 45]\nwavelengths_nm = [450, 550]\n",
    'recipe = "film.toml"\nmode = "sobol"\ncount = 8\nseed = 1\n[axes]\n'
    '"layers[0].thickness_nm" = {low = 10, high = 400, log = true}\n[measure]\nilluminant = "A"\nobserver = "10deg"\n',
)
SPECTRUM = "wavelength_nm,angle_deg,specular_reflectance\n" + "".join(
    f"{w},{a},{0.1 + w / 1e4}\n" for a in (0, 45) for w in (450, 550, 650)
)


@pytest.fixture(scope="module")
def imports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """One small sound file of every format that can be imported, `file name -> content`."""
    folder = tmp_path_factory.mktemp("sound")
    rough = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 300.0}]}
    material = nacre.material(rough | {"surface": {"roughness": 0.3}})
    smooth = nacre.material(rough)
    for target, name in (("zemax", "zemax.bsdf"), ("csv", "gonio.csv")):
        export_material(material, target, folder / name, angle_step_deg=30.0, wavelength_nm=550.0)
    for target, name in (("gltf", "film.gltf"), ("materialx", "film.mtlx")):
        export_material(smooth, target, folder / name)
    from nacre.formats.bsdf_tables import rgl_fields, write_tensor

    two = material.bsdf(np.array([450.0, 550.0]))
    write_tensor(folder / "rgl.bsdf", rgl_fields(two, "x", resolution=8, theta_nodes=3))
    found = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    found["short.binary"] = np.array([90, 90, 180], dtype="<i4").tobytes() + bytes(4000)  # a MERL file that was cut
    return found


def survives(what: str, folder: Path, action: Callable[[], object]) -> bool:
    """Run a reader; return whether it accepted. Anything but an answer or one line fails the test."""
    before = {path.name for path in folder.iterdir()}
    try:
        action()
        accepted = True
    except NacreError as error:
        accepted = False
        assert "\n" not in str(error), f"{what}: {error!s}"
        assert {path.name for path in folder.iterdir()} == before, f"{what}: left a file behind"
    except Exception as error:
        raise AssertionError(f"{what}: {error!r}") from error
    assert not list(folder.glob(".*")), f"{what}: left a half-written file"
    return accepted


def throw_sweeps(count: int, folder: Path, seed: int) -> None:
    generator = random.Random(seed)
    (folder / "film.toml").write_text(RECIPE)
    path = folder / "self.toml"
    read = [tomllib.loads(text) for text in SWEEPS]
    refused = 0
    for number in range(count):
        text = mutate(generator.choice(read), generator)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        refused += not survives(f"sweep {number} (seed {seed}):\n{text[:2000]}", folder, lambda: load_sweep(path))
    assert 0 < refused < count


def throw_measurements(count: int, folder: Path, seed: int, gonio: bytes) -> None:
    generator = random.Random(seed)
    path = folder / "measurement.csv"
    refused = 0
    for number in range(count):
        path.write_bytes(mutate_bytes(generator.choice([SPECTRUM.encode(), gonio]), generator))
        refused += not survives(f"measurement {number} (seed {seed})", folder, lambda: read_measurement(path))
    assert 0 < refused < count


def throw_imports(count: int, folder: Path, seed: int, sound: dict[str, bytes]) -> None:
    generator = random.Random(seed)
    refused = 0
    names = sorted(sound)
    for number in range(count):
        name = generator.choice(names)
        path = folder / name
        path.write_bytes(mutate_bytes(sound[name], generator))
        what = f"import {number} (seed {seed}, {name})"
        refused += not survives(what, folder, lambda path=path: import_material(path, folder / "out.toml"))  # type: ignore[misc]  # a default binds the loop's value
        for left in list(folder.iterdir()):
            left.unlink()
    assert 0 < refused < count


def test_mutated_sweeps_measurements_and_imports(tmp_path: Path, imports: dict[str, bytes]) -> None:
    for name in "smi":
        (tmp_path / name).mkdir()
    throw_sweeps(QUICK // 3, tmp_path / "s", 1)
    throw_measurements(QUICK // 3, tmp_path / "m", 2, imports["gonio.csv"])
    throw_imports(QUICK // 3, tmp_path / "i", 3, imports)


@pytest.mark.full
def test_two_thousand_mutated_sweeps_measurements_and_imports(tmp_path: Path, imports: dict[str, bytes]) -> None:
    for name in "smi":
        (tmp_path / name).mkdir()
    throw_sweeps(FULL * 2 // 5, tmp_path / "s", 11)
    throw_measurements(FULL * 2 // 5, tmp_path / "m", 12, imports["gonio.csv"])
    throw_imports(FULL // 5, tmp_path / "i", 13, imports)
