"""Stored state that was cut short, exchanged or replaced by a pipe: the right answer or one line with status 2."""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from helpers_crash import Forker, forker
from test_killed_commands import MANY, METASURFACE, SMOOTH, SWEEP

pytestmark = pytest.mark.full

MOST_S = 60.0  # a damaged file may cost the time to compute its content again, and never a hang
ENSEMBLE = METASURFACE.replace("coverage = 0.05", "coverage = 0.1") + (
    'correction = "ensemble"\nensemble = {spheres = 24, realisations = 4}\n'
)
COLOURS = "name,L,a,b\nx,60,10,20\ny,50,-10,5\n"


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def foreign(path: Path) -> None:
    path.write_bytes(b'{"rows": [1], "solutions": [[]]}\n')


def other_list(path: Path) -> None:
    path.write_bytes(b"[]\n")


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def folder_in_place(path: Path) -> None:
    path.unlink()
    path.mkdir()


DAMAGES: tuple[Callable[[Path], None], ...] = (cut, empty, foreign, other_list, pipe, folder_in_place)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def warm(cache: Path) -> Iterator[Forker]:
    with forker(cache) as made:
        yield made


def is_refused_in_one_line(warm: Forker, arguments: list[str], folder: Path) -> bool:
    """Run a command that may refuse; fail unless it ends well or in one line with status 2."""
    pid = warm.start(arguments, folder)
    stdout = warm._process.stdout
    if not select.select([stdout], [], [], MOST_S)[0]:
        os.kill(pid, signal.SIGKILL)
    status, said = warm.finish()
    assert status in (0, 2), said
    if status == 2:
        assert len(said.strip().splitlines()) == 1 and "Traceback" not in said, said
    return status == 2


def remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def test_a_damaged_sweep_is_completed_or_refused(warm: Forker, tmp_path: Path) -> None:
    """Each file in turn; a sweep that ends well has all values, axes and labels of an undamaged one."""
    import zarr

    (tmp_path / "smooth.toml").write_text(SMOOTH)
    (tmp_path / "sweep.toml").write_text(SWEEP.replace("600", "2"))
    arguments = ["sweep", "sweep.toml", "-o", "out.zarr", "--jobs", "1"]
    warm.run(arguments, tmp_path)
    whole = tmp_path / "whole.zarr"
    shutil.copytree(tmp_path / "out.zarr", whole)
    found: dict[str, np.ndarray] = {}
    expected = {name: np.asarray(array) for name, array in zarr.open_group(str(whole), mode="r").arrays()}
    files = sorted(file.relative_to(whole) for file in whole.rglob("*") if file.is_file())
    for number, file in enumerate(files):
        DAMAGES[number % len(DAMAGES)](tmp_path / "out.zarr" / file)
        if not is_refused_in_one_line(warm, arguments, tmp_path):
            group = zarr.open_group(str(tmp_path / "out.zarr"), mode="r")
            found = {name: np.asarray(array) for name, array in group.arrays()}
            assert found.keys() == expected.keys()
            for name, values in expected.items():
                np.testing.assert_array_equal(found[name], values, err_msg=f"{file}: {name}")
        shutil.rmtree(tmp_path / "out.zarr")
        shutil.copytree(whole, tmp_path / "out.zarr")
    assert found


def test_damaged_designs_of_many_colours_are_completed_or_refused(warm: Forker, tmp_path: Path) -> None:
    (tmp_path / "smooth.toml").write_text(SMOOTH)
    (tmp_path / "many.toml").write_text(MANY)
    (tmp_path / "colours.csv").write_text(COLOURS)
    arguments = ["design", "many.toml", "--many", "colours.csv", "-o", "out", "--resume"]
    warm.run(arguments, tmp_path)
    whole = tmp_path / "whole"
    shutil.copytree(tmp_path / "out", whole)
    recipe = (whole / "x" / "recipe.toml").read_bytes()
    for number, damage in enumerate(DAMAGES):
        name = ("many.json", "x/recipe.toml")[number % 2]
        damage(tmp_path / "out" / name)
        if not is_refused_in_one_line(warm, arguments, tmp_path):
            assert (tmp_path / "out" / "x" / "recipe.toml").read_bytes() == recipe
        shutil.rmtree(tmp_path / "out")
        shutil.copytree(whole, tmp_path / "out")


def test_damaged_results_of_an_ensemble_are_solved_again(warm: Forker, cache: Path, tmp_path: Path) -> None:
    """Each stored entry damaged, or exchanged for another entry, or for arrays of another kind: the same spectrum."""
    (tmp_path / "ensemble.toml").write_text(ENSEMBLE)
    shutil.rmtree(cache / "solved", ignore_errors=True)
    arguments = ["spectrum", "ensemble.toml", "--wavelengths-nm", "450,600", "--angles-deg", "0", "-o", "out.csv"]
    warm.run(arguments, tmp_path)
    expected = (tmp_path / "out.csv").read_bytes()
    entries = sorted((cache / "solved").iterdir())
    assert [entry for entry in entries if entry.name.startswith("ensemble-")]
    stored = {entry: entry.read_bytes() for entry in entries}

    def exchange(path: Path) -> None:
        alike = [each for each in entries if each != path and each.suffix == path.suffix]
        path.write_bytes(stored[alike[0]] if alike else b"")

    def other_arrays(path: Path) -> None:
        with path.open("wb") as file:
            np.savez(file, entry=np.array(path.stem), errors=np.zeros(3), more=np.ones(2))

    for damage in (cut, pipe, folder_in_place, exchange, other_arrays):
        for entry in entries:
            damage(entry)
            (tmp_path / "out.csv").unlink()
            assert not is_refused_in_one_line(warm, arguments, tmp_path)
            assert (tmp_path / "out.csv").read_bytes() == expected, (damage.__name__, entry.name[:20])
            remove(entry)
            entry.write_bytes(stored[entry])


@pytest.mark.render
def test_damaged_frames_of_an_animation_are_made_again_or_refused(warm: Forker, tmp_path: Path) -> None:
    from PIL import Image

    (tmp_path / "smooth.toml").write_text(SMOOTH)
    arguments = ["render", "smooth.toml", "--size", "24x24", "--spp", "2", "--animate", "light", "--frames", "2"]
    arguments += ["-o", "out.gif"]
    warm.run(arguments, tmp_path)
    names = [tmp_path / "out_frames" / f"frame_000{number}.png" for number in range(2)]
    stored = [name.read_bytes() for name in names]
    expected = [np.asarray(Image.open(name)) for name in names]

    def exchange(path: Path) -> None:
        path.write_bytes(stored[1 - names.index(path)])

    for damage, is_refused in (
        (cut, False),
        (foreign, False),
        (exchange, False),
        (pipe, True),
        (folder_in_place, True),
    ):
        damage(names[1])
        assert is_refused_in_one_line(warm, arguments, tmp_path) == is_refused
        if not is_refused:
            np.testing.assert_array_equal(np.asarray(Image.open(names[1])), expected[1])
        remove(names[1])
        names[1].write_bytes(stored[1])
