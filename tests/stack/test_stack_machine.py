"""Behaviour that depends on the machine: no folder for compiled code, a set number of threads."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import nacre
from nacre.core import machine

SOURCE = Path(nacre.__file__).resolve().parent


def test_kernels_work_where_no_cache_can_be_written(tmp_path: Path) -> None:
    # a copy of the package whose __pycache__ cannot be made, and no home: permissions would not stop root, a file
    # in the folder's place does
    copy = tmp_path / "nacre"
    for room in ("core", "matter"):
        (copy / room).mkdir(parents=True)
    shutil.copy(SOURCE / "core" / "jit.py", copy / "core" / "jit.py")
    (copy / "__init__.py").touch()
    (copy / "core" / "__init__.py").touch()
    (copy / "matter" / "__init__.py").touch()
    (copy / "matter" / "kernel.py").write_text(
        "from nacre.core.jit import compiled\n\n@compiled(error_model='numpy')\ndef twice(x):\n    return 2 * x\n"
    )
    (copy / "matter" / "__pycache__").write_text("not a folder")
    blocked = tmp_path / "blocked"
    blocked.write_text("not a folder")
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path),
        "PYTHONDONTWRITEBYTECODE": "1",
        "HOME": str(blocked),
        "XDG_CACHE_HOME": str(blocked),
    }
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "from nacre.matter.kernel import twice; print(twice(21))"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "42"
    assert done.stderr == ""


def test_of_two_processes_one_compiles_a_kernel(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(
        "from nacre.core.jit import compiled\n\n@compiled()\ndef inner(x):\n    return 2 * x\n\n"
        "@compiled()\ndef outer(x):\n    return inner(x) + 1\n"
    )
    code = "from kernel import outer; outer(3); print(sum(outer.stats.cache_misses.values()))"
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{SOURCE.parent}"}
    environment.pop("NUMBA_CACHE_DIR", None)
    both = [
        subprocess.Popen([sys.executable, "-c", code], env=environment, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    assert sorted(process.communicate(timeout=300)[0].strip() for process in both) == ["0", "1"]


def test_kernels_run_as_python_without_compilation(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(
        "from nacre.core.jit import compiled\n\n@compiled()\ndef inner(x):\n    return 2 * x\n\n"
        "@compiled()\ndef outer(x):\n    return inner(x) + 1\n"
    )
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{SOURCE.parent}", "NUMBA_DISABLE_JIT": "1"}
    code = [sys.executable, "-c", "from kernel import outer; print(outer(3))"]
    done = subprocess.run(code, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "7", done.stderr


def test_numba_is_imported_by_the_first_call_of_a_kernel_and_not_before() -> None:
    code = (
        "import sys, nacre; from nacre.bsdf.glints import mix; from nacre.bsdf.lobes.platelet_layer import sparkle\n"
        "nacre.load('soap'); assert 'numba' not in sys.modules\n"
        "import numpy as np; mix(np.uint64(3)); assert 'numba' in sys.modules\n"
        "print(mix.py_func.__name__, sparkle.__doc__ == sparkle.py_func.__doc__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["mix", "True"]


def test_the_number_of_threads_can_be_set_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")
    assert machine.available_jobs() == 3
    monkeypatch.delenv("NUMBA_NUM_THREADS")
    assert machine.available_jobs() >= 1


def test_work_is_shared_without_gaps_or_overlaps() -> None:
    for batch, angles, count in ((7, 2, 3), (1, 11, 4), (1, 1, 8), (5, 5, 1), (0, 3, 2)):
        done: list[tuple[int, int]] = []

        def visit(a: int, b: int, c: int, d: int, done: list[tuple[int, int]] = done) -> None:
            done.extend((i, j) for i in range(a, b) for j in range(c, d))

        machine.parallel_for(visit, batch, angles, 10**9, count)
        assert sorted(done) == [(i, j) for i in range(batch) for j in range(angles)]


@pytest.mark.parametrize(("batch", "angles"), [(9, 2), (2, 9), (8, 1)])
def test_work_is_cut_along_the_longer_side(batch: int, angles: int) -> None:
    pieces: list[tuple[int, int, int, int]] = []
    machine.parallel_for(lambda *piece: pieces.append(piece), batch, angles, 10**9, 4)
    assert len(pieces) >= 4  # each thread has something to do
    assert all((b - a, d - c)[batch >= angles] == min(batch, angles) for a, b, c, d in pieces)


def test_an_error_in_a_thread_reaches_the_caller() -> None:
    def fail(*_: int) -> None:
        raise ValueError("lost")

    with pytest.raises(ValueError, match="lost"):
        machine.parallel_for(fail, 8, 1, 10**9, 2)
