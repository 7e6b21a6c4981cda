"""What every benchmark shares: interleaved timing, medians, ratios against bars, one form of report.

A benchmark is a script `bench_<claim>.py` with `main(arguments) -> int`. It times contestants in turn, A B A B, so
that a machine that slows down or warms up does so for all, and compares medians. Peers that need another
environment run as workers (`Worker`): they set up once and then time themselves on request, so neither the start
of Python nor the pipe is counted.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PEER_PYTHON = ROOT / ".venv-bench" / "bin" / "python"


@dataclass
class Times:
    """Seconds of repeated runs: by the clock, and on all cores of the process."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    @property
    def median_wall(self) -> float:
        """Median by the clock."""
        return statistics.median(self.wall)

    @property
    def median_cpu(self) -> float:
        """Median of process time."""
        return statistics.median(self.cpu)


def timed(function: Callable[[], Any]) -> tuple[float, float]:
    """Run once; return (wall, cpu) seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    function()
    return time.perf_counter() - wall, time.process_time() - cpu


def interleaved(contestants: Mapping[str, Callable[[], tuple[float, float]]], repeats: int) -> dict[str, Times]:
    """Run all contestants in turn, `repeats` times after one warm-up; each returns its own (wall, cpu)."""
    times = {name: Times() for name in contestants}
    for name in contestants:
        contestants[name]()
    for _ in range(repeats):
        for name, run in contestants.items():
            wall, cpu = run()
            times[name].wall.append(wall)
            times[name].cpu.append(cpu)
    return times


class Worker:
    """A process in another environment that serves one request a line, in JSON.

    The script reads `{"task": name, ...}` lines and answers each with one line (see `serve`).
    """

    def __init__(self, script: str, python: Path = PEER_PYTHON) -> None:
        if not python.exists():
            raise SystemExit(f"{python.relative_to(ROOT)} is missing: run `python tools/bench_env.py` first")
        self._process = subprocess.Popen(
            [str(python), str(ROOT / "benchmarks" / script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, task: str, **arguments: Any) -> Any:
        """Send one request and wait for the answer.

        Raises:
            RuntimeError: the worker failed; its own message is in the error.
        """
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps({"task": task, **arguments}) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the worker ended during {task}")
        answer = json.loads(line)
        if "error" in answer:
            raise RuntimeError(f"{task}: {answer['error']}")
        return answer["result"]

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(timeout=60)


def serve(tasks: Mapping[str, Callable[..., Any]]) -> None:
    """The worker's side: answer requests until the input ends. Whatever else is printed goes to stderr."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = {"result": tasks[request.pop("task")](**request)}
        except Exception as error:  # whatever it is, the caller shall read it
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


@dataclass(frozen=True)
class Row:
    """One measured claim.

    Attributes:
        claim: what was measured, with sizes.
        value, unit: the figure.
        bar: what it must reach, or None where it only informs.
        higher_is_better: which side of the bar is the good one.
        note: what else is worth knowing (times, subsets, scalings).
    """

    claim: str
    value: float
    unit: str
    bar: float | None = None
    higher_is_better: bool = True
    note: str = ""

    @property
    def passed(self) -> bool | None:
        """Whether the bar is reached; None without one."""
        if self.bar is None:
            return None
        return self.value >= self.bar if self.higher_is_better else self.value <= self.bar


def parser(description: str | None, repeats: int = 7) -> argparse.ArgumentParser:
    """The options that all benchmarks take."""
    result = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    result.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    result.add_argument("--repeats", type=int, default=repeats, help="timed rounds after the warm-up")
    return result


def searcher(description: str | None) -> argparse.ArgumentParser:
    """The options of benchmarks whose searches end by the clock."""
    result = parser(description)
    result.add_argument("--all", action="store_true", help="all targets, resumably")
    result.add_argument(
        "--cores", type=float, help="let the clock run with the CPU time of this process over so many cores: where "
        "others use the machine too",
    )  # fmt: skip
    return result


def within_of(bar: float, is_all: bool) -> float:
    """Return the `within` of targets whose bar is `bar`: a search ends at a fifth of it, so at a fifth of the bar in a
    run of all targets, and at three quarters of the bar in a short one.
    """
    return bar if is_all else 3.75 * bar


def run_clock_by_cpu(cores: float | None) -> dict[str, float]:
    """Let `time.monotonic`, by which searches end, run with this process's CPU time over `cores`; None lets it be.

    Returns the note on it for a stored result and a report.
    """
    if cores is None:
        return {}
    start = time.monotonic()
    time.monotonic = lambda: start + time.process_time() / cores  # type: ignore[assignment]
    return {"cores of the clock": cores}


def report(name: str, rows: list[Row], as_json: bool, notes: Mapping[str, Any] | None = None) -> int:
    """Print the rows; return 0 if every bar is reached and 1 otherwise."""
    passed = all(row.passed is not False for row in rows)
    if as_json:
        table = [{**row.__dict__, "passed": row.passed} for row in rows]
        print(json.dumps({"benchmark": name, "machine": machine(), "notes": dict(notes or {}), "rows": table}))
        return 0 if passed else 1
    print(name)
    for row in rows:
        sign = ">=" if row.higher_is_better else "<="
        bar = "" if row.bar is None else f" (bar {sign} {row.bar:g}: {'reached' if row.passed else 'MISSED'})"
        print(f"  {row.claim}: {row.value:.4g} {row.unit}{bar}{'  ' + row.note if row.note else ''}")
    for key, value in (notes or {}).items():
        print(f"  {key}: {value}")
    return 0 if passed else 1


class StoredResults:
    """Results of a long benchmark, kept as lines of JSON so that a stopped run goes on.

    Only those of the same nacre, to the byte of its source, and of the same `facts` count.

    Args:
        name: of the file in `results`.
        is_used: False neither reads nor writes.
        facts: what else a result depends on, such as seed and seconds.
    """

    def __init__(self, name: str, is_used: bool, **facts: Any) -> None:
        self._path = ROOT / "benchmarks" / "results" / f"{name}.jsonl"
        self._is_used, self._facts = is_used, {**facts, "source": _source_digest()}
        self._found: dict[int, dict[str, Any]] = {}
        if is_used and self._path.exists():
            lines = [json.loads(line) for line in self._path.read_text(encoding="utf-8").splitlines()]
            self._found = {r["number"]: r for r in lines if self._facts.items() <= r.items()}

    def __contains__(self, number: int) -> bool:
        return number in self._found

    def result(self, number: int, measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return a stored result, or measure it; progress goes to stderr."""
        found = self._found.get(number)
        if found is None:
            found = {"number": number, **self._facts, **measure()}
            if self._is_used:
                self._path.parent.mkdir(exist_ok=True)
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(found) + "\n")
        print(json.dumps(found), file=sys.stderr, flush=True)
        return found


def resident_mb() -> float:
    """Memory that this process has in use."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {"processor": platform.machine(), "cores": cores, "python": platform.python_version(), "load": load}


def _source_digest() -> str:
    """Return a hash of nacre's Python files: stored rows belong to one state of the code."""
    import hashlib

    import nacre

    digest = hashlib.sha256()
    for path in sorted(Path(nacre.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
