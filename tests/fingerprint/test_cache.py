"""Solved optics on disk: the same numbers, private, bounded, safe to share, and never a wrong answer."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.core import disk_cache as cache
from nacre.material.material import Material

CACHED = {"family": "film", "substrate": "Si", "surface": {"roughness": 0.2}}
GRID = [400.0, 500.0, 600.0, 700.0]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a cache that keeps everything, however fast it was solved."""
    monkeypatch.setenv("NACRE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "MIN_SOLVE_S", -1.0)
    return tmp_path / "cache" / "solved"


def count_solves(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    made: list[int] = []
    model = type(nacre.material(CACHED).model)
    real = model.bsdf

    def counting(self: object, *arguments: object) -> object:
        made.append(1)
        return real(self, *arguments)

    monkeypatch.setattr(model, "bsdf", counting)
    return made


def numbers(material: Material) -> str:
    return material.bsdf(GRID).fingerprint


def test_a_material_is_solved_once_and_comes_back_to_the_bit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = count_solves(monkeypatch)
    first, second = numbers(nacre.material(CACHED)), numbers(nacre.material(CACHED))
    assert len(made) == 1 and first == second
    numbers(nacre.material({**CACHED, "substrate": "Ag"}))
    nacre.material(CACHED).bsdf([400.0, 500.0])
    assert len(made) == 3


def test_another_file_or_other_optics_are_solved_anew(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = count_solves(monkeypatch)
    recipe = {**CACHED, "substrate": {"file": "glass.csv"}}
    (tmp_path / "glass.csv").write_text("300,1.5\n900,1.5\n")
    first = numbers(nacre.material(recipe, tmp_path))
    (tmp_path / "glass.csv").write_text("300,1.7\n900,1.7\n")
    assert numbers(nacre.material(recipe, tmp_path)) != first
    monkeypatch.setattr("nacre.recipe.fingerprint.OPTICS_VERSION", 999)
    numbers(nacre.material(recipe, tmp_path))
    assert len(made) == 3


def test_mueller_matrices_of_an_anisotropic_film_are_solved_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plate = {"material": {"ordinary": 1.5, "extraordinary": 1.7, "axis_polar_deg": 90}, "thickness_nm": 300}
    recipe = {"family": "film", "substrate": {"n": 0.2, "k": 3.0}, "layers": [plate]}
    model = type(nacre.material(recipe).model)
    made, real = [], model.polarisation

    def counting(self: object, *arguments: object) -> object:
        made.append(1)
        return real(self, *arguments)

    monkeypatch.setattr(model, "polarisation", counting)
    first, second = (nacre.material(recipe).bsdf([500.0, 600.0]).polarisation() for _ in range(2))
    assert len(made) == 1
    np.testing.assert_array_equal(first.reflected, second.reflected)
    assert second.transmitted is None and (second.eta, second.flipped) == (first.eta, first.flipped)
    (entry,) = folder.glob("*.npz")
    entry.write_bytes(entry.read_bytes()[:-200])
    nacre.material(recipe).bsdf([500.0, 600.0]).polarisation()
    assert len(made) == 2


def test_a_damaged_entry_is_solved_anew_and_replaced(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = count_solves(monkeypatch)
    expected = numbers(nacre.material(CACHED))
    (entry,) = folder.iterdir()
    good = entry.read_bytes()
    generator = np.random.default_rng(3)
    for trial in range(30):
        bad = bytearray(good)
        bad[int(generator.integers(len(bad)))] ^= int(generator.integers(1, 256))
        entry.write_bytes(bad[: len(bad) // 2] if trial % 3 == 0 else bad)
        assert numbers(nacre.material(CACHED)) == expected
    assert len(made) > 10
    numbers(nacre.material(CACHED))
    solves = len(made)
    numbers(nacre.material(CACHED))
    assert len(made) == solves


def test_the_folder_is_private_and_another_ones_is_not_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = count_solves(monkeypatch)
    numbers(nacre.material(CACHED))
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o770)  # now others may write into it
    numbers(nacre.material(CACHED))
    assert len(made) == 2


def test_the_longest_unused_goes_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    thin, thick, last = ({**CACHED, "layers": [{"material": "SiO2", "thickness_nm": t}]} for t in (100, 200, 300))
    numbers(nacre.material(thin))
    (oldest,) = folder.iterdir()
    numbers(nacre.material(thick))
    (other,) = set(folder.iterdir()) - {oldest}
    os.utime(oldest, (1, 1))
    os.utime(other, (2, 2))
    numbers(nacre.material(thin))  # used: no longer the oldest
    monkeypatch.setattr(cache, "MAX_BYTES", int(2.5 * oldest.stat().st_size))
    numbers(nacre.material(last))
    assert len(list(folder.iterdir())) == 2 and oldest.exists() and not other.exists()


def test_what_is_solved_at_once_is_not_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "MIN_SOLVE_S", 60.0)
    numbers(nacre.material(CACHED))
    assert list(folder.iterdir()) == []


def test_eight_processes_share_a_cache(folder: Path) -> None:
    code = (
        "import nacre\nfrom nacre.core import disk_cache as cache\ncache.MIN_SOLVE_S = -1.0\n"
        f"cache.MAX_BYTES = 40_000\nrecipe = {CACHED!r}\n"
        "for turn in range(12):\n"
        "    layers = [{'material': 'SiO2', 'thickness_nm': 100 + turn % 4}]\n"
        f"    print(nacre.material(dict(recipe, layers=layers)).bsdf({GRID}).fingerprint)\n"
    )
    command = [sys.executable, "-c", code]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(8)]
    answers = [process.communicate(timeout=240) for process in processes]
    assert [process.returncode for process in processes] == [0] * 8, answers
    assert len({out for out, _ in answers}) == 1
    assert all(path.suffix == ".nacre" and not path.name.startswith(".") for path in folder.iterdir())


def test_the_command_shows_and_clears(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    from nacre.cli import run

    numbers(nacre.material(CACHED))
    assert run(["cache", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["folder"] == str(folder) and shown["entries"] == 1 and shown["bytes"] > 0
    assert run(["cache", "--clear"]) == 0
    reported = capsys.readouterr().out
    assert ": 0 materials, " in reported and "removed: 1 material\n" in reported and list(folder.iterdir()) == []


def test_the_command_counts_parts_of_materials_apart(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    from nacre.cli import run
    from nacre.core.disk_cache import cache_arrays

    numbers(nacre.material(CACHED))
    for number in range(3):  # as the patterns of an ensemble are
        cache_arrays(f"ensemble-{number}", {"a": np.ones(2)})
    assert run(["cache", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["materials"], shown["parts"], shown["entries"]) == (1, 3, 4)
    assert run(["cache"]) == 0
    assert ": 1 material and 3 parts of materials, " in capsys.readouterr().out


def test_no_cache_neither_takes_nor_keeps(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.cli import run

    monkeypatch.chdir(tmp_path)
    Path("film.toml").write_text('family = "film"\nsubstrate = "Si"\n')
    assert run(["compile", "film.toml", "--no-cache"]) == 0
    assert not folder.exists()
    monkeypatch.setenv("NACRE_CACHE", str(folder.parent))
    assert run(["compile", "film.toml"]) == 0
    assert len(list(folder.iterdir())) == 1


@pytest.mark.full
@pytest.mark.render
def test_a_second_picture_of_a_metasurface_solves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it costs in seconds is the business of `benchmarks/bench_study_speed.py`."""
    from nacre.cli import run

    monkeypatch.setenv("NACRE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("nacre.core.disk_cache.MIN_SOLVE_S", 0.0)  # a quick machine solves it in less
    silver = Path(__file__).resolve().parents[2] / "examples" / "metasurface" / "silver_on_oxide.toml"
    words = ["render", str(silver), "--size", "32x32", "--spp", "2", "--no-denoise", "-o"]
    assert run([*words, str(tmp_path / "a.png")]) == 0

    def solve(*_: object) -> None:
        raise AssertionError("a second picture solves the material again")

    monkeypatch.setattr(type(nacre.load(silver).model), "bsdf", solve)
    assert run([*words, str(tmp_path / "b.png")]) == 0
    first, second = (np.asarray(Image.open(tmp_path / name)) for name in ("a.png", "b.png"))
    assert np.array_equal(first, second)
