"""Bad input: one line naming file, key, value and what is allowed; status 2; nothing half-written."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre.analysis.sweep
from nacre.cli import run
from nacre.cli.common import STOPPED, STOPPED_EARLY

GOOD = """family = "film"
substrate = "Si"
layers = [{material = "SiO2", thickness_nm = 300}]
[surface]
roughness = 0.1
"""


def fails(capsys: pytest.CaptureFixture[str], arguments: list[str], *words: str) -> str:
    """Run the command; check status, that stderr is one line with all the words, and return it."""
    assert run(arguments) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if line.strip()]
    assert len(lines) == 1, captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""
    for word in words:
        assert word in lines[0], lines[0]
    return lines[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('"Si"', '"Si"\nsubstrat = "Si"'), ["film.toml", "substrat", 'Did you mean "substrate"']),
        (('"SiO2"', '"SiO3"'), ["film.toml", "layers[0].material", "SiO3", "Did you mean"]),
        (("= 300", "= -3"), ["film.toml", "layers[0].thickness_nm", "-3"]),
        (("= 300", "= inf"), ["film.toml", "layers[0].thickness_nm"]),
        (('"Si"', "{n = 1.5, k = -0.1}"), ["film.toml", "substrate", "k"]),
        (("= 0.1", "= 1.5"), ["film.toml", "surface.roughness", "1.5"]),
        (("= 0.1", "= -0.1"), ["film.toml", "surface.roughness", "-0.1"]),
        (
            ("= 300", '= {texture = "nowhere.png", min = 1, max = 2}'),
            ["film.toml", "layers[0].thickness_nm", "nowhere.png"],
        ),
        (
            ("= 300", '= {texture = "broken.png", min = 1, max = 2}'),
            ["film.toml", "layers[0].thickness_nm", "broken.png"],
        ),
        (("= 300", '= {formula = "__import__(1)"}'), ["film.toml", "layers[0].thickness_nm", "__import__"]),
        (('"film"', '"flim"'), ["film.toml", "family", "flim", 'Did you mean "film"']),
        (('family = "film"', ""), ["film.toml", "family", "missing"]),
        (("[surface]", "[surface"), ["film.toml", "TOML"]),
        (("thickness_nm = 300", "thickness_nm = 300, thickness_um = 1"), ["film.toml", "thickness"]),
    ],
)
def test_a_wrong_recipe_is_refused_with_file_key_and_value(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], words: list[str]
) -> None:
    (tmp_path / "broken.png").write_bytes(b"\x89PNG not really")
    recipe = tmp_path / "film.toml"
    assert change[0] in GOOD
    recipe.write_text(GOOD.replace(*change))
    output = tmp_path / "out.csv"
    fails(capsys, ["spectrum", str(recipe), "-o", str(output)], *words)
    assert not output.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["spectrum", "RECIPE", "--wavelengths-nm", "100:200:10"], ["100"]),
        (["spectrum", "RECIPE", "--wavelengths-nm", "abc"], ["--wavelengths-nm", "abc"]),
        (["spectrum", "RECIPE", "--wavelengths-nm", "700:400:10"], ["--wavelengths-nm"]),
        (["spectrum", "RECIPE", "--angles-deg", "95"], ["--angles-deg", "95"]),
        (["spectrum", "RECIPE", "-o", "FOLDER/x.csv"], ["folder"]),
        (["spectrum", "RECIPE", "-o", "x.doc"], ["x.doc", ".csv"]),
        (["spectrum", "missing.toml"], ["missing.toml"]),
        (["spectrum", "RECIPE", "--set", "layers[7].thickness_nm=3"], ["layers[7].thickness_nm"]),
        (["spectrum", "RECIPE", "--set", "nonsense"], ["nonsense"]),
        (["spectrum", "RECIPE", "--jobs", "0"], ["--jobs"]),
        (["render", "RECIPE", "--size", "0x10"], ["size ="]),
        (["render", "RECIPE", "--size", "1e9x2"], ["size ="]),
        (["render", "RECIPE", "--size", "99999x99999"], ["size ="]),
        (["render", "RECIPE", "--spp", "0"], ["spp"]),
        (["render", "RECIPE", "--spp", "99999999999"], ["spp"]),
        (["render", "RECIPE", "--scene", "spere"], ["spere", "sphere"]),
        (["render", "RECIPE", "--light", "studoi"], ["studoi", "studio"]),
        (["render", "RECIPE", "--illuminant", "D66"], ["D66", "D65"]),
        (["render", "RECIPE", "--shape", "no.ply"], ["no.ply"]),
        (["render", "RECIPE", "-o", "x.bmp"], ["x.bmp", ".png"]),
        (["render", "RECIPE", "--exposure", "bright"], ["--exposure", "bright"]),
        (["render", "RECIPE", "--animate", "lihgt"], ["lihgt"]),
        (["plot", "RECIPE", "--kind", "spectrun"], ["spectrun"]),
        (["plot", "RECIPE", "--kind", "microscope"], ["microscope"]),
        (["evaluate", "RECIPE", "--directions", "none.npz", "-o", "v.npz"], ["none.npz"]),
        (["compile", "RECIPE", "-o", "x.zip"], ["x.zip", ".nacre"]),
        (["rendr", "RECIPE"], ["rendr", "render"]),
        (["indices", "show", "Unobtainium"], ["Unobtainium"]),
    ],
)
def test_wrong_arguments_are_refused_with_option_and_value(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    words: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "film.toml").write_text(GOOD)
    filled = [a.replace("RECIPE", "film.toml").replace("FOLDER", "nowhere") for a in arguments]
    fails(capsys, filled, *words)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["film.toml"]


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"wi": np.eye(3)}, ["wo"]),
        ({"wi": np.zeros((3, 3)), "wo": np.zeros((3, 3))}, ["unit"]),
        ({"wi": np.eye(3), "wo": np.eye(3)[:2]}, ["rows"]),
        ({"wi": np.eye(3)[:, :2], "wo": np.eye(3)}, ["shape"]),
        ({"wi": np.full((1, 3), np.nan), "wo": np.eye(3)[:1]}, ["unit"]),
    ],
)
def test_wrong_directions_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arrays: dict[str, np.ndarray], words: list[str]
) -> None:
    (tmp_path / "film.toml").write_text(GOOD)
    np.savez(tmp_path / "d.npz", **arrays)
    fails(capsys, ["evaluate", str(tmp_path / "film.toml"), "--directions", str(tmp_path / "d.npz"), "-o",
                   str(tmp_path / "v.npz")], "d.npz", *words)  # fmt: skip
    assert not (tmp_path / "v.npz").exists()


def test_pickled_directions_are_never_loaded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "film.toml").write_text(GOOD)
    np.savez(tmp_path / "d.npz", wi=np.array([{"a": 1}], dtype=object), wo=np.eye(3))
    fails(capsys, ["evaluate", str(tmp_path / "film.toml"), "--directions", str(tmp_path / "d.npz"), "-o",
                   str(tmp_path / "v.npz")], "d.npz")  # fmt: skip


def test_recipes_that_hold_each_other_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pearl = 'family = "pearl"\n[[strata]]\nresin = "PET"\nthickness_um = 100\n[base]\nrecipe = "a.toml"\n'
    (tmp_path / "a.toml").write_text(pearl)
    fails(capsys, ["spectrum", str(tmp_path / "a.toml")], "a.toml")


# a job that a shell puts into the background ignores the keyboard's interrupt; this one shall not
AT_A_TERMINAL = """
import signal, runpy
signal.signal(signal.SIGINT, signal.default_int_handler)
runpy.run_module("nacre", run_name="__main__", alter_sys=True)
"""


def stopped_render(folder: Path, after_s: float, stop: signal.Signals, spp: int) -> tuple[int, str]:
    """Start a render far too long to end, stop it after a while; return its exit status and what it said."""
    (folder / "film.toml").write_text(GOOD)
    options = ["--size", "256x256", "--spp", str(spp), "-o", "x.png"]
    command = [sys.executable, "-c", AT_A_TERMINAL, "render", "film.toml", *options]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True) as process:
        try:
            time.sleep(after_s)
            process.send_signal(stop)
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()  # if it did not stop
    return process.returncode, said


@pytest.mark.render
def test_a_killed_render_leaves_nothing_half_written(tmp_path: Path) -> None:
    stopped_render(tmp_path, 4, signal.SIGKILL, 4096)
    assert [p.name for p in tmp_path.iterdir() if not p.name.startswith(".")] == ["film.toml"]


@pytest.mark.render
def test_an_interrupted_render_stops_cleanly(tmp_path: Path) -> None:
    status, said = stopped_render(tmp_path, 8, signal.SIGINT, 60_000)
    assert status in (130, 2)
    assert "Traceback" not in said


def test_an_interrupt_says_whether_results_are_stored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = 'recipe = "film.toml"\n[measure]\nangles_deg = [0]\n[axes]\n"layers[0].thickness_nm" = [100, 200]\n'
    (tmp_path / "film.toml").write_text(GOOD)
    (tmp_path / "sweep.toml").write_text(sweep)
    compute = nacre.analysis.sweep._compute_point
    for left, message in ((0, STOPPED_EARLY), (1, STOPPED)):
        points = [compute] * left

        def stopping(*point: Any, points: list[Any] = points) -> Any:
            if not points:
                raise KeyboardInterrupt
            return points.pop()(*point)

        monkeypatch.setattr(nacre.analysis.sweep, "_compute_point", stopping)
        assert run(["sweep", str(tmp_path / "sweep.toml"), "-o", str(tmp_path / f"{left}"), "--jobs", "1"]) == 130
        assert capsys.readouterr().err.strip() == message


@pytest.mark.parametrize(
    "recipe",
    [
        'family = "film"\nsubstrate = {file = "/dev/zero"}\n',
        GOOD.replace("= 300", '= {texture = "/dev/zero", min = 1, max = 2}'),
        'family = "relief"\nheights = "/dev/zero"\nfeature_um = 1\nblur_um = 0.3\ncoating = "Al"\n'
        "coherence = {sigma = 2}\n",
        'family = "blend"\nmask = 0.5\nfirst = {recipe = "/dev/zero"}\nsecond = {recipe = "/dev/zero"}\n',
    ],
)
def test_an_endless_device_is_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str], recipe: str) -> None:
    (tmp_path / "endless.toml").write_text(recipe)
    fails(capsys, ["spectrum", str(tmp_path / "endless.toml")], "zero")


def test_an_endless_recipe_is_not_read(capsys: pytest.CaptureFixture[str]) -> None:
    fails(capsys, ["spectrum", "/dev/zero"], "/dev/zero")
