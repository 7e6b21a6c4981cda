"""Measure what share of small errors in the physics the quick tests notice: `make mutants`.

210 mutants are drawn by cosmic-ray's operators, uniformly over the code lines of the rooms that hold physics, and the
tests that reach each are run against it, in a copy of the tree, `WORKERS` (2) mutants at a time and 60 s each. A mutant
is killed when a test fails that passed before, or takes three times its time. All stays in build/mutants: a run that
was stopped goes on where it was, and `--again` tries the survivors anew, with the tests as they are now. Answers are
printed and written to benchmarks/MUTANTS.md.
"""

from __future__ import annotations

import argparse
import filecmp
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from tools.mutants.report import latest, write_report

ROOT = Path(__file__).resolve().parents[2]
PLACE = ROOT / "build" / "mutants"
BASE = PLACE / "base"
ENVIRONMENT = ROOT / ".venv-mutants"
SEED = 20261126
COUNT = 210
PROCESSES = int(os.environ.get("WORKERS", "2"))
CHOSEN = [
    "-m",
    "not full and not gpu",
    "--continue-on-collection-errors",
]  # what lacks a package fails, and is left out
PYTEST = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *CHOSEN]
IN_PARALLEL = ["-n", str(PROCESSES), "--dist", "worksteal"]
SKIPPED = ("docs", "cli", "render_scenes", "test_packaging.py")  # faces and pictures: slow, and far from the physics


def environment(**variables: Path) -> dict[str, str]:
    """Return the environment of all runs of tests: the copy's package, one thread of BLAS, a libLLVM that works."""
    own = {f"NACRE_MUTANTS_{name}": str(value) for name, value in variables.items()}
    found = sorted((ROOT / ".llvm" / "usr" / "lib").glob("*/libLLVM*.so*"))
    llvm = {"DRJIT_LIBLLVM_PATH": str(found[0])} if found and "DRJIT_LIBLLVM_PATH" not in os.environ else {}
    threads = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    return {**os.environ, **own, **llvm, **threads, "PYTHONPATH": f"{BASE / 'src'}:{ROOT}", "NACRE_PROJECT": str(BASE)}


def freeze() -> set[str]:
    """Copy what git sees of the tree to build/mutants/base, and return the files that changed there."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, capture_output=True, check=True, cwd=ROOT, text=True).stdout.split("\0")
    wanted = {name for name in names if name and (ROOT / name).is_file()}
    changed = set()
    for name in sorted(wanted):
        if not (BASE / name).exists() or not filecmp.cmp(ROOT / name, BASE / name, shallow=False):
            (BASE / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, BASE / name)
            changed.add(name)
    for path in [p for p in BASE.rglob("*") if p.is_file() and "__pycache__" not in p.parts]:
        if str(path.relative_to(BASE)) not in wanted and "build" not in path.relative_to(BASE).parts:
            path.unlink()
    if any(name.startswith("src/") for name in changed):
        for kept in BASE.glob("src/**/__pycache__/*.nb*"):
            kept.unlink()
    return changed


def test_files() -> list[str]:
    """Return the tests' files that a mutant may meet."""
    files = [str(p.relative_to(BASE)) for p in sorted((BASE / "tests").rglob("test_*.py"))]
    return [f for f in files if not any(f.startswith(f"tests/{s}") for s in SKIPPED)]


def measure_baseline(files: list[str]) -> None:
    """Trace which test reaches which line and what it costs, in one run; keep both."""
    log = PLACE / "times.log"
    log.unlink(missing_ok=True)
    _trace([*IN_PARALLEL, "-p", "tools.mutants.plugin", *files], {"LOG": log})
    keep_baseline()


def measure_new_tests(files: list[str]) -> None:
    """Trace and time the tests of these files that the baseline does not know; one that was changed keeps its own."""
    if not files:
        return
    listed = subprocess.run(
        [*PYTEST, "--collect-only", "-p", "no:cov", *files], cwd=BASE, env=environment(), capture_output=True, text=True
    )
    known = json.loads((PLACE / "baseline.json").read_text(encoding="utf-8"))["tests"]
    new = sorted({line for line in listed.stdout.splitlines() if "::" in line} - set(known))
    plan, log = PLACE / "new.plan", PLACE / "times.log"
    plan.write_text(json.dumps(new), encoding="utf-8")
    log.unlink(missing_ok=True)
    _trace(["-p", "tools.mutants.plugin", *files], {"LOG": log, "PLAN": plan})
    keep_baseline()


def _trace(arguments: list[str], variables: dict[str, Path]) -> None:
    config, data = PLACE / "coverage.ini", PLACE / "coverage" / "data"
    shutil.rmtree(data.parent, ignore_errors=True)
    data.parent.mkdir(parents=True)
    config.write_text(f"[run]\nsource = src/nacre\nparallel = true\ndata_file = {data}\n", encoding="utf-8")
    trace = ["--cov", f"--cov-config={config}", "--cov-context=test", "--cov-report=", "-W", "ignore"]
    subprocess.run([*PYTEST, *trace, *arguments], cwd=BASE, env=environment(**variables), check=False)


def keep_baseline() -> None:
    """Put traces and times into baseline.json, over what stood there of the same test files."""
    path = PLACE / "baseline.json"
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    cost, failed = dict(kept.get("cost", {})), set(kept.get("failed", ()))
    log = PLACE / "times.log"
    began: dict[int, float] = {}  # by process; compiling does not count
    compiling: dict[int, float] = {}
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else ():
        event = json.loads(line)
        process = event["pid"]
        if "start" in event:
            began[process] = event["cpu"]
        elif event.get("compile") == "start":
            compiling[process] = event["cpu"]
        elif event.get("compile") == "end" and process in compiling and process in began:
            began[process] += event["cpu"] - compiling[process]
        elif "end" in event and process in began:
            cost[event["end"]] = round(event["cpu"] - began[process], 3)
        elif event.get("outcome") == "failed":
            failed.add(event["test"])
        elif event.get("outcome") == "passed":
            failed.discard(event["test"])
    traced = _traced()
    again = {test for lines in traced.values() for tests in lines.values() for test in tests}
    names = kept.get("tests", [])
    for file, lines in kept.get("lines", {}).items():
        for line, tests in lines.items():
            old = {names[i] for i in tests if names[i] not in again}
            traced.setdefault(file, {}).setdefault(int(line), set()).update(old)
    names = sorted({test for lines in traced.values() for tests in lines.values() for test in tests})
    number = {name: i for i, name in enumerate(names)}
    lines = {
        file: {line: sorted(number[t] for t in tests) for line, tests in found.items() if tests}
        for file, found in traced.items()
    }
    new = sorted(again | set(kept.get("new", ()))) if kept else []
    answer = {"cost": cost, "failed": sorted(failed), "tests": names, "lines": lines, "new": new}
    path.write_text(json.dumps(answer), encoding="utf-8")


def _traced() -> dict[str, dict[int, set[str]]]:
    """Read which tests reach which lines from coverage's files."""
    from coverage import CoverageData

    found: dict[str, dict[int, set[str]]] = {}
    for path in sorted((PLACE / "coverage").glob("data*")):
        data = CoverageData(str(path))
        data.read()
        for measured in data.measured_files():
            if not Path(measured).is_relative_to(BASE):
                continue
            lines = found.setdefault(str(Path(measured).relative_to(BASE)), {})
            for line, contexts in data.contexts_by_lineno(measured).items():
                lines.setdefault(line, set()).update(c.rpartition("|")[0] for c in contexts if "|" in c)
    return found


def draw_mutants() -> dict[str, Any]:
    """Draw the mutants with cosmic-ray, once."""
    path = PLACE / "draw.json"
    if not path.exists():
        python = ENVIRONMENT / "bin" / "python"
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True)
            wanted = ROOT / "tools" / "mutants" / "requirements.txt"
            subprocess.run([str(python), "-m", "pip", "install", "-q", "-r", str(wanted)], check=True)
        command = [str(python), "-m", "tools.mutants.draw", str(BASE), str(SEED), str(COUNT), str(path)]
        subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})
    answer: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return answer


def try_mutants(todo: list[dict[str, Any]], limit_s: float) -> None:
    """Run the workers until all is done."""
    (PLACE / "todo.json").write_text(json.dumps(todo), encoding="utf-8")
    worker = [sys.executable, "-W", "ignore", "-m", "tools.mutants.worker", str(PLACE)]
    running = [
        subprocess.Popen([*worker, str(i), str(PROCESSES), str(limit_s)], cwd=ROOT, env=environment())
        for i in range(PROCESSES)
    ]
    for process in running:
        process.wait()


def main() -> int:
    """Do what is not done yet, and report."""
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__)
    parser.add_argument("--again", action="store_true", help="try the survivors anew, with the tests as they are now")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds a mutant")
    parser.add_argument("--report", action="store_true", help="only write the report")
    options = parser.parse_args()
    if not options.report:
        PLACE.mkdir(parents=True, exist_ok=True)
        begun = (PLACE / "baseline.json").exists()
        if not begun or options.again:
            changed = freeze()
            if begun and any(name.startswith("src/") for name in changed):
                print("mutants: src has changed since the draw; remove build/mutants to begin anew", file=sys.stderr)
                return 2
            if begun:
                measure_new_tests([f for f in test_files() if f in changed])
            else:
                measure_baseline(test_files())
        drawn = draw_mutants()["drawn"]
        known = latest(PLACE)
        try_mutants(
            [m for m in drawn if m["id"] not in known or (options.again and known[m["id"]]["outcome"] == "survived")],
            options.limit,
        )
    return write_report(ROOT, PLACE)


if __name__ == "__main__":
    sys.exit(main())
