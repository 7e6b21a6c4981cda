"""Run every validation script and write REPORT.md: what was claimed, what we get, the verdict; the misses first.

`python -m validation [NAME ...]` runs the scripts whose names contain one of the words; all by default. A script is a
module with `main(out_dir) -> rows`; a row has claim, claimed, ours, verdict and figure. Each script's rows are kept
beside its figures, so that the report of a partial run, in any clone, still holds the others.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
import traceback
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
FIGURES = HERE / "figures"
ROWS = "rows.json"
GOOD = ("holds", "ok", "pass", "reached", "agrees", "yes", "true", "reproduced")


def is_good(verdict: object) -> bool:
    """Whether a verdict says that the claim holds."""
    return str(verdict).strip().lower().startswith(GOOD)


def run_script(name: str) -> tuple[list[dict[str, Any]], float]:
    """Run one script; a crash is a row of its own."""
    start = time.monotonic()
    try:
        rows = importlib.import_module(f"validation.{name}").main(FIGURES / name)
    except Exception as error:
        traceback.print_exc()
        rows = [{"claim": "the script runs", "claimed": "", "ours": f"{type(error).__name__}: {error}",
                 "verdict": "fails", "figure": ""}]  # fmt: skip
    return list(rows), time.monotonic() - start


def write_rows(name: str, rows: list[dict[str, Any]], seconds: float) -> None:
    """Keep a script's rows beside its figures."""
    named = [{**row, "figure": Path(str(row.get("figure", ""))).name} for row in rows]  # no folder of this machine
    document = {"seconds": round(seconds), "rows": named}
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
    total = sum(len(rows) for rows, _ in results.values())
    lines = [
        "# Validation", "",
        f"{total - len(misses)} of {total} claims hold. Made by `make validate`; each figure is made by the same run.",
        "", "## Misses", "",
    ]  # fmt: skip
    lines += _table([{**row, "claim": f"{name}: {row['claim']}"} for name, row in misses]) if misses else ["None."]
    for name, (rows, seconds) in results.items():
        doc = (importlib.import_module(f"validation.{name}").__doc__ or "").strip().splitlines()
        lines += ["", f"## {name}", "", doc[0] if doc else "", "", *_table(rows), ""]
        figures = dict.fromkeys(str(row["figure"]) for row in rows if row.get("figure"))
        lines += [f"![{name}](figures/{name}/{Path(figure).name})" for figure in figures]
        lines += ["", f"{seconds:.0f} s"]
    (HERE / "REPORT.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _table(rows: list[dict[str, Any]]) -> list[str]:
    lines = ["| claim | claimed | ours | verdict |", "|---|---|---|---|"]
    for row in rows:
        cells = (
            str(row.get(key, "")).replace("|", "\\|").replace("\n", " ")
            for key in ("claim", "claimed", "ours", "verdict")
        )
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def main() -> int:
    """Run the chosen scripts; the status is 1 if one crashed."""
    words = [word for word in sys.argv[1:] if not word.startswith("-")]
    names = sorted(p.stem for p in HERE.glob("*_*.py") if not p.stem.startswith("_"))
    chosen = [name for name in names if not words or any(word in name for word in words)]
    results: dict[str, tuple[list[dict[str, Any]], float]] = {}
    for number, name in enumerate(chosen):
        print(f"== [{number + 1}/{len(chosen)}] {name}", flush=True)
        (FIGURES / name).mkdir(parents=True, exist_ok=True)
        results[name] = run_script(name)
        write_rows(name, *results[name])
        # the rows of scripts that are not run, or that run in another process, come from their last run
        write_report({n: found for n in names if (found := results.get(n) or read_rows(n)) is not None})
    return int(any(row["verdict"] == "fails" for name in chosen for row in results[name][0]))


if __name__ == "__main__":
    sys.exit(main())
