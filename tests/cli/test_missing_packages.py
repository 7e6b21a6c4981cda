"""Prediction, thin-film design and fits need neither Mitsuba nor an extra; what needs one says so in one line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nacre.core.errors import MachineError
from nacre.core.lazy import SERVES, missing_line, require

# a package that is not installed: `import` and `find_spec` both answer as for an absent one
HIDE = "import sys\nsys.modules.update(dict.fromkeys({names!r}))\n"
RECIPE = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
SWEEP = 'recipe = "film.toml"\n[axes]\n"layers[0].thickness_nm" = [100, 200]\n'
CORE = """
import numpy as np
import nacre
film = nacre.load("film.toml")
assert nacre.spectrum(film, angles_deg=[0]).specular_reflectance.max() > 0.1
wi = np.array([0.6, 0.0, 0.8])
assert np.isfinite(nacre.evaluate(film, wi, wi * [-1, 1, 1])).all()
table = "wavelength_nm,R\\n" + "".join(
    f"{w},{r}\\n" for w, r in zip(range(450, 650, 10),
        nacre.spectrum(film.vary({"layers[0].thickness_nm": 320}), angles_deg=[0],
                       wavelengths_nm=list(range(450, 650, 10))).specular_reflectance[0]))
open("measured.csv", "w").write(table)
from nacre.cli import run
assert run(["fit", "measured.csv", "film.toml", "--parameter", "layers[0].thickness_nm=280:360",
            "--angle-deg", "0", "--intervals", "linear"]) == 0
assert run(["design", "target.toml", "-o", "found"]) == 0
"""
TARGET = """[recipe]
family = "film"
substrate = {n = 1.52}
layers = [{material = "TiO2", thickness_nm = 60}]
[parameters]
"layers[0].thickness_nm" = [20, 120]
[[target]]
geometry = "specular 0"
hue_deg = [200, 300]
[search]
seconds = 1
"""


def run_without(names: list[str], code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "film.toml").write_text(RECIPE)
    (folder / "sweep.toml").write_text(SWEEP)
    (folder / "target.toml").write_text(TARGET)
    return subprocess.run(
        [sys.executable, "-c", HIDE.format(names=names) + code], cwd=folder, env=os.environ, capture_output=True,
        text=True,
    )  # fmt: skip


def test_prediction_fit_and_film_design_import_neither_mitsuba_nor_an_extra(tmp_path: Path) -> None:
    done = run_without(list(SERVES), CORE, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "found").exists() or list(tmp_path.glob("found*"))


@pytest.mark.parametrize(
    "package, argv",
    [
        ("mitsuba", ["render", "film.toml", "--size", "16", "-o", "a.png"]),
        ("drjit", ["render", "film.toml", "--size", "16", "-o", "a.png"]),
        ("uvicorn", ["studio", "film.toml", "--no-browser"]),
        ("zarr", ["sweep", "sweep.toml", "-o", "a.zarr"]),
    ],
)
def test_a_missing_package_is_one_line_and_status_two(package: str, argv: list[str], tmp_path: Path) -> None:
    done = run_without([package], f"from nacre.cli import run\nsys.exit(run({argv!r}))", tmp_path)
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert done.returncode == 2, done.stderr
    assert len(lines) == 1 and package in lines[0] and "pip install" in lines[0]
    assert not (tmp_path / "a.png").exists() and not (tmp_path / "a.zarr").exists()


def test_python_raises_machine_error_for_a_missing_package(tmp_path: Path) -> None:
    code = (
        "import nacre\nfrom nacre.core.errors import MachineError\n"
        "for call in (lambda: nacre.render('film.toml', size=16), lambda: nacre.sweep('sweep.toml', 'a.zarr')):\n"
        "    try:\n        call()\n    except MachineError:\n        continue\n    sys.exit(1)\n"
    )
    done = run_without(["mitsuba", "zarr"], code, tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_line_names_the_extra_and_other_packages_have_none() -> None:
    assert "'nacre[study]'" in missing_line("zarr.storage")
    assert missing_line("numpy") == ""
    require("mitsuba")
    with pytest.raises(MachineError):
        sys.modules["jax"], kept = None, sys.modules.get("jax", "")  # type: ignore[assignment]
        try:
            require("jax")
        finally:
            del sys.modules["jax"]
            if kept:
                sys.modules["jax"] = kept  # type: ignore[assignment]
