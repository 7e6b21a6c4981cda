"""One writer for a store: the second waits, a dead one's lock is taken over, another machine's only when asked."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_study_sweep import read_all, write_sweep

from nacre.analysis.sweep import lock_file, run_sweep
from nacre.analysis.sweep_plan import load_sweep
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers

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
    run_sweep(load_sweep(path), tmp_path / "one.zarr", workers=Workers(1))
    command = [*SWEEP, str(path), "-o", str(tmp_path / "two.zarr"), "--jobs", "1"]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    reported = [process.communicate(timeout=120)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], reported
    assert all("120 of 120 points" in text for text in reported)
    expected, found = read_all(tmp_path / "one.zarr"), read_all(tmp_path / "two.zarr")
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def test_the_second_waits_and_says_so(tmp_path: Path) -> None:
    sweep, store, said = load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr", list[str]()
    with hold(store, 1.0) as first:
        assert run_sweep(sweep, store, workers=Workers(1), report=said.append) == (4, 0)
        assert first.wait() == 0
    assert len(said) == 1 and str(store) in said[0]


def test_the_lock_ends_with_a_killed_process(tmp_path: Path) -> None:
    sweep, store, said = load_sweep(write_sweep(tmp_path, 2)), tmp_path / "s.zarr", list[str]()
    with hold(store, 60.0) as first:
        first.send_signal(signal.SIGKILL)
    assert lock_file(store).exists()
    assert run_sweep(sweep, store, workers=Workers(1), report=said.append) == (4, 0)
    assert said == []


def test_a_folder_without_room_for_a_lock_is_refused(tmp_path: Path) -> None:
    sweep = load_sweep(write_sweep(tmp_path, 2))
    with pytest.raises(NacreError, match="does not exist"):
        run_sweep(sweep, tmp_path / "absent" / "s.zarr", workers=Workers(1))
