"""Measure what share of small errors in the physics the quick tests notice: `make mutants`.

210 mutants are drawn by cosmic-ray's operators, uniformly over the code lines of the rooms that hold physics, and the
tests that name what each changes are run against it, 30 s of the processor each, in a copy of the tree, `WORKERS` (1)
at a time. A mutant is killed when a test fails that passes without it, or takes three times its time. All stays in
build/mutants: a run that was stopped goes on where it was, and `--again` tries the survivors anew, with the sources
and tests as they are now. Answers are printed and written to benchmarks/MUTANTS.md.
"""

from __future__ import annotations

import argparse
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
WORKERS = int(os.environ.get("WORKERS", "1"))


def freeze() -> None:
    """Copy what git sees of the tree to build/mutants/base, and what numba has compiled of it."""
    shutil.rmtree(BASE, ignore_errors=True)
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, capture_output=True, check=True, cwd=ROOT, text=True).stdout.split("\0")
    kernels = [str(path.relative_to(ROOT)) for path in (ROOT / "src").rglob("__pycache__/*.nb?")]
    for name in [*names, *kernels]:
        if (ROOT / name).is_file():
            (BASE / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, BASE / name)


def draw_mutants() -> list[dict[str, Any]]:
    """Draw the mutants with cosmic-ray, once."""
    path = PLACE / "draw.json"
    if not path.exists():
        freeze()
        python = ENVIRONMENT / "bin" / "python"
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True)
            wanted = ROOT / "tools" / "mutants" / "requirements.txt"
            subprocess.run([str(python), "-m", "pip", "install", "-q", "-r", str(wanted)], check=True)
        command = [str(python), "-m", "tools.mutants.draw", str(BASE), str(SEED), str(COUNT), str(path)]
        subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})
    drawn: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["drawn"]
    return drawn


def renewed(mutant: dict[str, Any]) -> dict[str, Any] | None:
    """Return a mutant of the sources as they are now; None where its line is there no more, or more than once."""
    path = BASE / mutant["file"]
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    if text == mutant["original"]:
        return mutant
    lines = text.splitlines(keepends=True)
    found = [i for i, line in enumerate(lines) if line.strip() == mutant["before"]]
    if len(found) > 1:
        found = [i for i in found if i + 1 == mutant["line"]]
    if len(found) != 1:
        return None
    after = "" if mutant["after"] == "(gone)" else lines[found[0]].replace(mutant["before"], mutant["after"])
    lines[found[0]] = after
    return {**mutant, "line": found[0] + 1, "text": "".join(lines)}


def try_mutants(todo: list[dict[str, Any]], limit_s: float, tests: list[str]) -> None:
    """Run the workers: with the copy's package, one thread of BLAS, a libLLVM that works."""
    (PLACE / "todo.json").write_text(json.dumps({"mutants": todo, "tests": tests}), encoding="utf-8")
    (PLACE / "temporary").mkdir(exist_ok=True)
    found = sorted((ROOT / ".llvm" / "usr" / "lib").glob("*/libLLVM*.so*"))
    llvm = {"DRJIT_LIBLLVM_PATH": str(found[0])} if found and "DRJIT_LIBLLVM_PATH" not in os.environ else {}
    threads = {
        name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    }
    own = {"PYTHONPATH": str(BASE / "src"), "NACRE_PROJECT": str(BASE)}
    own["PYTEST_DEBUG_TEMPROOT"] = str(PLACE / "temporary")
    worker = [sys.executable, "-W", "ignore", "-m", "tools.mutants.worker", str(PLACE)]
    running = [
        subprocess.Popen(
            [*worker, str(i), str(WORKERS), str(limit_s)], cwd=ROOT, env={**os.environ, **llvm, **threads, **own}
        )
        for i in range(WORKERS)
    ]
    for process in running:
        process.wait()


def main() -> int:
    """Do what is not done yet, and report."""
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__)
    parser.add_argument("--again", action="store_true", help="try the survivors anew, with sources and tests of now")
    parser.add_argument("--limit", type=float, default=30.0, help="seconds a mutant")
    parser.add_argument("--only", nargs="+", help="the beginnings of the keys of some mutants")
    parser.add_argument(
        "--tests", nargs="+", default=["tests/"], help="run all tests of the files whose names begin so"
    )
    parser.add_argument("--report", action="store_true", help="only write the report")
    options = parser.parse_args()
    if not options.report:
        PLACE.mkdir(parents=True, exist_ok=True)
        drawn, known = draw_mutants(), latest(PLACE)
        if options.again:
            freeze()
        todo = []
        for mutant in drawn:
            again = options.again and known.get(mutant["id"], {}).get("outcome") == "survived"
            chosen = not options.only or mutant["id"].startswith(tuple(options.only))
            if chosen and (again or mutant["id"] not in known):
                todo += [now] if (now := renewed(mutant)) else []
                if now is None:
                    (PLACE / "worker0").mkdir(exist_ok=True)
                    with (PLACE / "worker0" / "results.jsonl").open("a", encoding="utf-8") as results:
                        results.write(json.dumps({"id": mutant["id"], "outcome": "survived", "why": "gone"}) + "\n")
        try_mutants(todo, options.limit, options.tests)
    return write_report(ROOT, PLACE)


if __name__ == "__main__":
    sys.exit(main())
