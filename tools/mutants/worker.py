"""Run the tests against mutants, one after the other, in a copy of the tree with compile caches of its own.

A worker loads the packages of others once and forks for each mutant, so that a mutant costs its tests and little
more. What the mutant's file changes is compiled anew: its own cache and those of all files above it go first, for
numba does not notice a callee changed in another file.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import shutil
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from tools.mutants.choose import Baseline, import_graph

LIMIT_S = 60.0  # of the processor, the import of the package and compiling included
PATIENCE_S = 1800.0  # on the clock, against a test that waits; all other limits are of the processor
SLOWER = 3.0  # times its own time: a killed mutant
ALLOWANCE_S = 8.0  # of the processor, beside that: imports that another test paid for in the baseline
FOREIGN = (
    "pytest _pytest.assertion.rewrite hypothesis numpy numba.core.event pydantic yaml tomlkit PIL.Image jax colour tmm "
    "scipy.stats scipy.optimize scipy.special scipy.integrate scipy.interpolate scipy.sparse.linalg scipy.ndimage"
).split()
NO_VERDICT = (5, 70)  # no tests found; the machinery itself failed
TICK = os.sysconf("SC_CLK_TCK")


@functools.cache
def importers(root: Path) -> dict[str, set[str]]:
    """For each file, all that import it, however far, and itself."""
    graph = import_graph(root)
    name = {module: str(path.relative_to(root)) for module, path in graph.files.items()}
    found = {file: {file} for file in name.values()}
    grows = True
    while grows:
        before = sum(map(len, found.values()))
        for module, others in graph.arrows.items():
            for other in others:
                found[name[other]] |= found[name[module]]
        grows = sum(map(len, found.values())) > before
    return found


def forget_compiled(path: Path) -> None:
    """Remove what Python and numba kept of a file."""
    for kept in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
        kept.unlink()


class Slot:
    """A copy of the tree that holds one mutant at a time."""

    def __init__(self, base: Path, place: Path) -> None:
        self.base, self.place = base, place
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(base, place, ignore=shutil.ignore_patterns(".git"))

    def fill(self, mutant: dict[str, Any]) -> None:
        """Put a mutant in."""
        source = self.place / "src"
        shutil.rmtree(source)
        shutil.copytree(self.base / "src", source)
        # compiled code of any of these may hold code of the file
        for name in importers(self.base)[mutant["file"]]:
            forget_compiled(self.place / name)
        (self.place / mutant["file"]).write_text(mutant["text"], encoding="utf-8")


def run_tests(place: Path, plan: Path, log: Path, out: Path, files: list[str]) -> None:
    """Become pytest, in a forked child; never returns."""
    status = 70
    try:
        os.setsid()
        sink = os.open(out, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        os.chdir(place)
        os.environ.update(
            PYTHONPATH=f"{place}/src",
            NACRE_MUTANTS_PLAN=str(plan),
            NACRE_MUTANTS_LOG=str(log),
            NACRE_PROJECT=str(place),
        )
        sys.path.insert(0, f"{place}/src")
        # read when the plugin is imported, in this child for the first time
        import pytest

        options = "-x -q -p no:cacheprovider -p no:xdist -p no:cov -p tools.mutants.plugin".split()
        loaded = ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # packages that the worker loaded before
        status = int(pytest.main([*options, *loaded, "-m", "not full and not gpu", *files]))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def spent(pid: int) -> float:
    """Return the processor seconds of a process and of its children that have ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / TICK


class Watch:
    """Reads a run's log and compares each test's time with the baseline."""

    def __init__(self, log: Path, baseline: Baseline) -> None:
        self.log, self.baseline = log, baseline
        self.at = 0
        self.test, self.began, self.compiling, self.compiled = "", 0.0, 0.0, 0.0
        self.compiled_in_all = 0.0
        self.ran = 0
        self.killer: dict[str, Any] | None = None

    def read(self) -> None:
        """Take in the lines that are new."""
        if not self.log.exists():
            return
        with self.log.open(encoding="utf-8") as log:
            log.seek(self.at)
            for line in log.readlines():
                if not line.endswith("\n"):
                    break
                self.at += len(line.encode())
                self._take(json.loads(line))

    def _take(self, event: dict[str, Any]) -> None:
        if "start" in event:
            self.test, self.began, self.compiling, self.compiled = event["start"], event["cpu"], 0.0, 0.0
        elif event.get("compile") == "start":
            self.compiling = event["cpu"]
        elif event.get("compile") == "end":
            self.compiled += event["cpu"] - self.compiling
            self.compiled_in_all += event["cpu"] - self.compiling
            self.compiling = 0.0
        elif event.get("outcome") == "failed":
            self.killer = self.killer or {"by": "failure", "test": event["test"], "reason": event["reason"][-600:]}
        elif "end" in event:
            self.ran += 1
            self.compare(event["cpu"])
            self.test = ""

    def compare(self, cpu: float) -> None:
        """Say that a test takes too long, if it does."""
        if self.test and not self.compiling:
            taken = cpu - self.began - self.compiled
            usual = self.baseline.cost_of(self.test)
            if taken > SLOWER * usual + ALLOWANCE_S:
                reason = f"{taken:.1f} s of the processor; {usual:.1f} s without the mutant"
                self.killer = self.killer or {"by": "time", "test": self.test, "reason": reason}


def try_mutant(slot: Slot, mutant: dict[str, Any], baseline: Baseline, limit_s: float) -> dict[str, Any]:
    """Run the tests against a mutant; answer what came of it."""
    slot.fill(mutant)
    tests = baseline.plan(mutant["file"], mutant["line"])
    plan, log, out = (slot.place.with_suffix(s) for s in (".plan", ".log", ".out"))
    plan.write_text(json.dumps(tests), encoding="utf-8")
    log.unlink(missing_ok=True)
    answer = {"id": mutant["id"], "tests": len(tests)}
    if not tests:
        return {**answer, "outcome": "survived", "why": "no test reaches it", "ran": 0, "seconds": 0.0, "cpu": 0.0}
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        run_tests(slot.place, plan, log, out, files)
    watch = Watch(log, baseline)
    status, taken = None, 0.0
    while status is None:
        time.sleep(0.1)
        ended, code = os.waitpid(child, os.WNOHANG)
        status = os.waitstatus_to_exitcode(code) if ended else None
        watch.read()
        taken = max(taken, spent(child))
        watch.compare(taken)
        late = taken > LIMIT_S or taken - watch.compiled_in_all > limit_s or time.monotonic() - start > PATIENCE_S
        if status is None and (watch.killer or late):
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            break
    answer |= {"seconds": round(time.monotonic() - start, 1), "cpu": round(taken, 1), "ran": watch.ran}
    if watch.killer is None and status not in (None, 0):
        tail = out.read_text(encoding="utf-8", errors="replace")[-600:]
        if status in NO_VERDICT:
            raise RuntimeError(f"{mutant['file']}:{mutant['line']}: no verdict, status {status}: {tail}")
        # no test failed, and yet pytest did: the package cannot be imported, or the process died
        watch.killer = {"by": "failure", "test": watch.test or "(collecting)", "reason": f"status {status}: {tail}"}
    if watch.killer:
        return {**answer, "outcome": "killed", **watch.killer}
    return {**answer, "outcome": "survived", "why": "all passed" if status == 0 else f"{limit_s:.0f} s ran out"}


def main() -> None:
    """Work through the mutants whose place in the list is NUMBER modulo COUNT: worker.py PLACE NUMBER COUNT LIMIT."""
    place, number, count, limit_s = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    mutants = json.loads((place / "todo.json").read_text(encoding="utf-8"))[number::count]
    baseline = Baseline.read(place / "base", place / "baseline.json")
    for name in FOREIGN:
        with contextlib.suppress(ImportError):
            __import__(name)
    slot = Slot(place / "base", place / f"slot{number}")
    for mutant in mutants:
        answer = try_mutant(slot, mutant, baseline, limit_s)
        with (place / "results.jsonl").open("a", encoding="utf-8") as results:
            results.write(json.dumps(answer) + "\n")
        verdict = f"{answer['outcome']} {answer.get('test') or answer.get('why')}"
        print(f"{mutant['file']}:{mutant['line']} {verdict} ({answer['cpu']} s of {answer['seconds']} s)", flush=True)


if __name__ == "__main__":
    main()
