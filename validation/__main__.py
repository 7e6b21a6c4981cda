"""Run every validation script and write REPORT.md: what was claimed, what we get, the verdict; the misses first.

`python -m validation [NAME ...]` runs the scripts whose names contain one of the words; all by default. A script is a
module with `main(out_dir) -> rows`; a row has claim, claimed, ours, verdict and figure. Each script's rows are kept
beside its figures, so that the report of a partial run, in any clone, still holds the others. Scripts run in processes
of their own, two at a time where there are two cores (`--jobs N`), the longest first; those that search or measure by
the clock run alone.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import subprocess
import sys
import threading
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from validation._limits import sources

HERE = Path(__file__).resolve().parent
FIGURES = HERE / "figures"
ROWS = "rows.json"
ONE = "--one"  # of the process that runs a single script
MOST_JOBS = 2
ALONE = ("pearl_equal_time", "relief_ablations", "relief_designs")  # what they find depends on the time they get
GOOD = ("holds", "ok", "pass", "reached", "agrees", "yes", "true", "reproduced")


FAMILIES = ("film", "glass", "grating", "metasurface", "pearl", "relief")
KINDS = ("hold", "hold only as printed", "false", "undecided", "miss")


def is_good(verdict: object) -> bool:
    """Whether a verdict says that the claim holds."""
    return str(verdict).strip().lower().startswith(GOOD)


def kind(verdict: object) -> str:
    """Return which of `KINDS` a verdict is."""
    words = str(verdict).strip().lower()
    if "only as printed" in words:
        return "hold only as printed"
    if is_good(verdict):
        return "hold"
    return "false" if words.startswith("false") else "undecided" if words.startswith("cannot be") else "miss"


def _summary(results: dict[str, tuple[list[dict[str, Any]], float]]) -> list[str]:
    """One line a family: how many claims, and what came of them."""
    families: dict[str, dict[str, int]] = {}
    for name, (rows, _) in results.items():
        family = name.split("_")[0]
        counts = families.setdefault(family if family in FAMILIES else "tools", dict.fromkeys(KINDS, 0))
        for row in rows:
            counts[kind(row["verdict"])] += 1
    lines = ["| family | claims | " + " | ".join(KINDS) + " |", "|---" * (len(KINDS) + 2) + "|"]
    for family, counts in sorted(families.items()):
        cells = [str(sum(counts.values())), *(str(counts[each]) for each in KINDS)]
        lines.append(f"| {family} | " + " | ".join(cells) + " |")
    return lines


def _codes(results: dict[str, tuple[list[dict[str, Any]], float]]) -> list[str]:
    """One line for each comparison with a code that is not ours (rows that name one): the worst difference."""
    lines = ["| family | code | what | bar | worst difference |", "|---|---|---|---|---|"]
    for name, (rows, _) in results.items():
        for row in rows:
            if row.get("code"):
                cells = row.get("family", name.split("_")[0]), row["code"], row["claim"], row["claimed"], row["ours"]
                lines.append("| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |")
    return lines


def run_script(name: str) -> tuple[list[dict[str, Any]], float]:
    """Run one script here; a crash is a row of its own."""
    start = time.monotonic()
    try:
        rows = importlib.import_module(f"validation.{name}").main(FIGURES / name)
    except Exception as error:
        traceback.print_exc()
        rows = _crash(f"{type(error).__name__}: {error}")
    return list(rows), time.monotonic() - start


def _crash(what: str) -> list[dict[str, Any]]:
    return [{"claim": "the script runs", "claimed": "", "ours": what, "verdict": "fails", "figure": ""}]


def run_apart(name: str, jobs: int) -> str:
    """Run one script in a process of its own, which keeps its rows; return what it printed."""
    start = time.monotonic()
    threads = str(max(1, (os.cpu_count() or 1) // jobs))
    environment = {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads, **os.environ}
    command = [sys.executable, "-m", "validation", ONE, name]
    done = subprocess.run(
        command, env=environment, cwd=HERE.parent, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if done.returncode:  # it did not even reach its rows
        write_rows(name, _crash(f"its process ended with status {done.returncode}"), time.monotonic() - start)
    return done.stdout


def cpu_seconds() -> float:
    """Time of all cores that this process and those it waited for have used."""
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def write_rows(name: str, rows: list[dict[str, Any]], seconds: float, cpu: float | None = None) -> None:
    """Keep a script's rows beside its figures."""
    named = [{**row, "figure": Path(str(row.get("figure", ""))).name} for row in rows]  # no folder of this machine
    document: dict[str, Any] = {"seconds": round(seconds)}
    if cpu is not None:
        document["cpu_seconds"] = round(cpu)
    document["rows"] = named
    (FIGURES / name / ROWS).write_text(json.dumps(document, indent=1, default=str) + "\n", encoding="utf-8")


def read_rows(name: str) -> tuple[list[dict[str, Any]], float] | None:
    """Return the rows of a script's last run, or None if it never ran."""
    path = FIGURES / name / ROWS
    if not path.exists():
        return None
    document = json.loads(path.read_text(encoding="utf-8"))
    return document["rows"], document["seconds"]


def write_report(results: dict[str, tuple[list[dict[str, Any]], float]]) -> None:
    """Write REPORT.md: misses of all scripts first, then a section a script."""
    misses = [(name, row) for name, (rows, _) in results.items() for row in rows if not is_good(row["verdict"])]
    lines = [
        "# Validation", "",
        "Claims of the published sources, and of physics, against what nacre computes. *Hold only as printed*: in the "
        "source's own energy balance, which loses light (`energy_balance = \"published\"` of a platelet). *False*: "
        "shown so by a calculation here. *Undecided*: the source gives nothing to decide it by. *Miss*: ours differs. "
        "Made by `make validate`; each figure is made by the same run. Of limits, *bar* marks a number asked before "
        "the work and not derived, *word* a measure of ours for a source's word.", "",
        *_summary(results),
        "", "Against other codes and other people's data:", "",
        *_codes(results),
        "", _whole_time(results),
        "", "## What does not hold", "",
    ]  # fmt: skip
    lines += _table([{**row, "claim": f"{name}: {row['claim']}"} for name, row in misses]) if misses else ["None."]
    for name, (rows, seconds) in results.items():
        doc = (importlib.import_module(f"validation.{name}").__doc__ or "").strip().splitlines()
        lines += ["", f"## {name}", "", doc[0] if doc else "", "", *_table(rows), ""]
        if found := sources(name, rows):
            lines += [f"Limits from: {'; '.join(found)}.", ""]
        figures = dict.fromkeys(str(row["figure"]) for row in rows if row.get("figure"))
        lines += [f"![{name}](figures/{name}/{Path(figure).name})" for figure in figures]
        cpu = _cpu_seconds(name)
        lines += ["", f"{seconds:.0f} s" + ("" if cpu is None else f", {cpu:.0f} s of one core")]
    (HERE / "REPORT.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cpu_seconds(name: str) -> float | None:
    """What the last run of a script took of all cores, if that was kept."""
    path = FIGURES / name / ROWS
    found: float | None = json.loads(path.read_text(encoding="utf-8")).get("cpu_seconds") if path.exists() else None
    return found


def _whole_time(results: dict[str, tuple[list[dict[str, Any]], float]]) -> str:
    """How long the last runs took, one after the other, and the longest of them."""
    longest = max(results, key=lambda name: results[name][1])
    whole = sum(seconds for _, seconds in results.values()) / 60
    return (
        f"The last runs of all {len(results)} scripts took {whole:.0f} minutes together, on whatever else the machine "
        f"did; the longest, `{longest}`, {results[longest][1] / 60:.1f}. `make validate` runs {MOST_JOBS} at a time."
    )


def _table(rows: list[dict[str, Any]]) -> list[str]:
    """A table; where a row was asked with two balances, one column for each."""
    keys = {"claim": "claim", "claimed": "claimed", "ours": "ours", "verdict": "verdict"}
    if any("printed" in row for row in rows):
        keys = {
            "claim": "claim",
            "claimed": "claimed",
            "ours": "physical",
            "printed": "as printed",
            "verdict": "verdict",
        }
    lines = ["| " + " | ".join(keys.values()) + " |", "|" + "---|" * len(keys)]
    for row in rows:
        cells = (str(row.get(key, "")).replace("|", "\\|").replace("\n", " ") for key in keys)
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def main() -> int:
    """Run the chosen scripts; the status is 1 if one crashed."""
    arguments = sys.argv[1:]
    if arguments[:1] == [ONE]:
        name = arguments[1]
        rows, seconds = run_script(name)
        write_rows(name, rows, seconds, cpu_seconds())
        return 0
    jobs = min(MOST_JOBS, os.cpu_count() or 1)
    if "--jobs" in arguments:
        at = arguments.index("--jobs")
        jobs = max(1, int(arguments[at + 1]))
        del arguments[at : at + 2]
    names = sorted(p.stem for p in HERE.glob("*_*.py") if not p.stem.startswith("_"))
    chosen = [name for name in names if not arguments or any(word in name for word in arguments)]
    last = {name: found[1] for name in chosen if (found := read_rows(name)) is not None}
    chosen.sort(key=lambda name: -last.get(name, 0.0))
    done: list[str] = []
    lock = threading.Lock()

    def run(name: str, beside: int) -> None:
        (FIGURES / name).mkdir(parents=True, exist_ok=True)
        note = run_apart(name, beside)
        with lock:
            done.append(name)
            print(f"== [{len(done)}/{len(chosen)}] {name}\n{note}", end="", flush=True)
            # the rows of scripts that are not run come from their last run
            write_report({each: found for each in names if (found := read_rows(each)) is not None})

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(lambda name: run(name, jobs), [name for name in chosen if name not in ALONE]))
    for name in chosen:
        if name in ALONE:
            run(name, 1)
    return int(any(row["verdict"] == "fails" for name in chosen for row in (read_rows(name) or ([], 0))[0]))


if __name__ == "__main__":
    sys.exit(main())
