"""Run every benchmark, one process each, and write RESULTS.md with the machine and the versions.

`python -m benchmarks [NAME ...]` runs those whose names contain one of the words; all by default. Each answer is kept
`results/`, so that RESULTS.md after a partial run still holds the others. Options, such as `glass --repeats 9`, go
to the benchmarks named. By default those with many targets take a tenth of them, all in 25 minutes on two free cores;
`--all` gives all targets to those that have more, which go on where they were stopped, are never cut short, and
whose answers are kept beside those of short runs.
"""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
KEPT = HERE / "results"
# searches that may end by CPU time, so these three share two cores in a run of all benchmarks: one ends before others
SIDE_BY_SIDE = ("bench_design_films", "bench_design_metasurfaces", "bench_design_pearls")
SIDE_OPTIONS = ["--cores", "1.4"]  # the cores that a search fills of two that it has alone
PACKAGES = ("numpy", "numba", "jax", "mitsuba", "drjit", "scipy")
TIME_LIMIT_S = 1800


def run_one(script: Path, options: list[str]) -> dict[str, Any]:
    """Run one benchmark and keep what it says; a crash or a time-out is a result of its own."""
    result = {
        **_answer(script, options),
        "script": " ".join([script.name, *options]),
        "on": datetime.date.today().isoformat(),
    }
    KEPT.mkdir(exist_ok=True)
    _kept(script, "--all" in options).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _kept(script: Path, is_all: bool) -> Path:
    return KEPT / f"{script.stem}{'_all' if is_all else ''}.json"


def _takes_all(script: Path) -> bool:
    text = script.read_text(encoding="utf-8")
    return '"--all"' in text or "searcher(" in text


def _answer(script: Path, options: list[str]) -> dict[str, Any]:
    command = [sys.executable, str(script), "--json", *options]
    start = time.monotonic()
    limit_s = None if "--all" in options else TIME_LIMIT_S
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, cwd=HERE.parent)
    except subprocess.TimeoutExpired:
        return {"benchmark": script.stem, "rows": [], "error": f"took more than {TIME_LIMIT_S} s"}
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if not lines:
        return {"benchmark": script.stem, "rows": [], "error": done.stderr.strip().splitlines()[-1:] or "no output"}
    return {**json.loads(lines[-1]), "seconds": round(time.monotonic() - start)}


def write_results(results: list[dict[str, Any]]) -> None:
    """Write RESULTS.md: missed bars first, then a table a benchmark."""
    rows = [(r["benchmark"], row) for r in results for row in r["rows"]]
    missed = [(name, row) for name, row in rows if row.get("passed") is False]
    barred = [row for _, row in rows if row.get("passed") is not None]
    versions = ", ".join(f"{p} {importlib.metadata.version(p)}" for p in PACKAGES)
    machine = next((r["machine"] for r in results if "machine" in r), {})
    machine = {key: value for key, value in machine.items() if key != "load"}
    lines = [
        "# Benchmarks", "",
        f"{len(barred) - len(missed)} of {len(barred)} bars reached. Made by `make bench`: contestants take turns in "
        "one run, figures are medians.", "",
        f"Machine: {machine}. Versions: {versions}.", "", "## Missed bars", "",
    ]  # fmt: skip
    lines += _table([{**row, "claim": f"{name}: {row['claim']}"} for name, row in missed]) if missed else ["None."]
    for result in results:
        of_all = ", all targets" if "--all" in result["script"] else ""
        lines += ["", f"## {result['benchmark']}{of_all}", ""]
        if "error" in result:
            lines.append(f"did not run: {result['error']}")
            continue
        lines += _table(result["rows"])
        lines += [f"- {key}: {value}" for key, value in result.get("notes", {}).items()]
        load = result.get("machine", {}).get("load")
        calm = "" if load is None else f", load {load:.1f} at the end"
        lines += ["", f"`python benchmarks/{result['script']}`, {result['seconds']:.0f} s on {result['on']}{calm}"]
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
    named = [i for i, word in enumerate(sys.argv) if i and word.startswith("-")]
    words, options = (sys.argv[1:], []) if not named else (sys.argv[1 : named[0]], sys.argv[named[0] :])
    if set(options) - {"--all"} and not words:
        raise SystemExit("options but --all go to the benchmarks that are named before them")
    scripts = sorted(HERE.glob("bench_*.py"))
    chosen = [s for s in scripts if not words or any(w in s.stem for w in words)]
    beside = [] if words else [s for s in chosen if s.stem in SIDE_BY_SIDE]
    results = []

    def run(script: Path) -> dict[str, Any]:
        print(f"== [{chosen.index(script) + 1}/{len(chosen)}] {script.stem}", flush=True)
        known = options if words or _takes_all(script) else []
        return run_one(script, [*known, *SIDE_OPTIONS] if script in beside else known)

    with ThreadPoolExecutor(len(SIDE_BY_SIDE)) as pool:
        found = chain(pool.map(run, beside), map(run, [s for s in chosen if s not in beside]))
        for result in found:
            results.append(result)
            # those that are not run now, or not yet, come from their last run
            kept = [path for s in scripts for path in (_kept(s, False), _kept(s, True)) if path.exists()]
            write_results([json.loads(path.read_text(encoding="utf-8")) for path in kept])
    return int(any("error" in result for result in results))


if __name__ == "__main__":
    sys.exit(main())
