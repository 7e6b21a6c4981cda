"""One writer for a store: the second waits, a dead one's lock is taken over, another machine's only when asked."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_study_sweep import read_all, write_sweep

from nacre.analysis.sweep import lock_file, locked, run_sweep
from nacre.analysis.sweep_plan import load_sweep
from nacre.core.errors import NacreError
from nacre.core.files import Process

SWEEP = [sys.executable, "-m", "nacre", "sweep"]
HOLD = """import sys, time
from pathlib import Path
from nacre.analysis.sweep import locked
with locked(Path(sys.argv[1])):
    print(flush=True)
    time.sleep(float(sys.argv[2]))
"""


def hold(store: Path, seconds: float) -> subprocess.Popen[str]:
    """Start a process that holds a store's lock."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(store), str(seconds)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    with process.stdout:
        process.stdout.readline()
    return process


def test_two_sweeps_on_one_store_give_what_one_gives(tmp_path: Path) -> None:
    path = write_sweep(tmp_path, 60)
    run_sweep(load_sweep(path), tmp_path / "one.zarr", workers=1)
    command = [*SWEEP, str(path), "-o", str(tmp_path / "two.zarr"), "--workers", "1"]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    told = [process.communicate(timeout=120)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], told
    assert all("120 of 120 points" in text for text in told)
    expected, found = read_all(tmp_path / "one.zarr"), read_all(tmp_path / "two.zarr")
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)
    assert not lock_file(tmp_path / "two.zarr").exists()


def test_the_second_waits_and_says_for_whom(tmp_path: Path) -> None:
    sweep, store, told = load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr", list[str]()
    with hold(store, 1.0) as first:
        assert run_sweep(sweep, store, workers=1, tell=told.append) == (4, 0)
        assert first.wait() == 0
    assert len(told) == 1 and str(first.pid) in told[0]


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path: Path) -> None:
    sweep, store, told = load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr", list[str]()
    with hold(store, 60.0) as first:
        first.send_signal(signal.SIGKILL)
    assert lock_file(store).exists()
    assert run_sweep(sweep, store, workers=1, tell=told.append) == (4, 0)
    assert told == [] and not lock_file(store).exists()


def test_another_machines_lock_is_broken_only_when_asked(tmp_path: Path) -> None:
    sweep, store = load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr"
    lock_file(store).write_text(json.dumps({"host": "elsewhere", "pid": 7, "started": 1}))
    with pytest.raises(NacreError, match="process 7 of elsewhere.*--break-lock") as caught:
        run_sweep(sweep, store, workers=1)
    assert "\n" not in str(caught.value)
    assert not store.exists()
    assert run_sweep(sweep, store, workers=1, break_lock=True) == (4, 0)
    assert not lock_file(store).exists()


def test_a_lock_cut_short_is_no_lock(tmp_path: Path) -> None:
    lock_file(tmp_path / "s.zarr").write_text('{"host": ')
    with locked(tmp_path / "s.zarr"):
        assert json.loads(lock_file(tmp_path / "s.zarr").read_text())["pid"] == Process.this().pid
