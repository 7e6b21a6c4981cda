"""Run every benchmark, one process each, and write RESULTS.md with the machine and the versions."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PACKAGES = ("numpy", "numba", "jax", "mitsuba", "drjit", "scipy")
TIME_LIMIT_S = 1800


def run_one(script: Path) -> dict[str, Any]:
    """Run one benchmark; a crash or a time-out is a result of its own."""
    command = [sys.executable, str(script), "--json"]
    start = time.monotonic()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT_S, cwd=HERE.parent)
    except subprocess.TimeoutExpired:
        return {"benchmark": script.stem, "rows": [], "error": f"took more than {TIME_LIMIT_S} s"}
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if not lines:
        return {"benchmark": script.stem, "rows": [], "error": done.stderr.strip().splitlines()[-1:] or "no output"}
    return {**json.loads(lines[-1]), "seconds": time.monotonic() - start, "script": script.name}


def write_results(results: list[dict[str, Any]]) -> None:
    """Write RESULTS.md: missed bars first, then a table a benchmark."""
    rows = [(r["benchmark"], row) for r in results for row in r["rows"]]
    missed = [(name, row) for name, row in rows if row.get("passed") is False]
    barred = [row for _, row in rows if row.get("passed") is not None]
    versions = ", ".join(f"{p} {importlib.metadata.version(p)}" for p in PACKAGES)
    machine = next((r["machine"] for r in results if "machine" in r), {})
    lines = [
        "# Benchmarks", "",
        f"{len(barred) - len(missed)} of {len(barred)} bars reached. Made by `make bench`: contestants take turns in "
        "one run, figures are medians.", "",
        f"Machine: {machine}. Versions: {versions}.", "", "## Missed bars", "",
    ]  # fmt: skip
    lines += _table([{**row, "claim": f"{name}: {row['claim']}"} for name, row in missed]) if missed else ["None."]
    for result in results:
        lines += ["", f"## {result['benchmark']}", ""]
        if "error" in result:
            lines.append(f"did not run: {result['error']}")
            continue
        lines += _table(result["rows"])
        lines += [f"- {key}: {value}" for key, value in result.get("notes", {}).items()]
        lines += ["", f"`python benchmarks/{result['script']}`, {result['seconds']:.0f} s"]
    (HERE / "RESULTS.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _table(rows: list[dict[str, Any]]) -> list[str]:
    lines = ["| what | figure | bar | reached | note |", "|---|---|---|---|---|"]
    for row in rows:
        sign = "&ge;" if row.get("higher_is_better", True) else "&le;"
        bar = "" if row.get("bar") is None else f"{sign} {row['bar']:g}"
        reached = {True: "yes", False: "no", None: ""}[row.get("passed")]
        note = str(row.get("note", "")).replace("|", "\\|")
        lines.append(f"| {row['claim']} | {row['value']:.4g} {row['unit']} | {bar} | {reached} | {note} |")
    return lines


def main() -> int:
    """Run the benchmarks whose names contain one of the words given; all by default."""
    words = sys.argv[1:]
    scripts = [s for s in sorted(HERE.glob("bench_*.py")) if not words or any(w in s.stem for w in words)]
    results = []
    for number, script in enumerate(scripts):
        print(f"== [{number + 1}/{len(scripts)}] {script.stem}", flush=True)
        results.append(run_one(script))
        write_results(results)
    return int(any("error" in result for result in results))


if __name__ == "__main__":
    sys.exit(main())
