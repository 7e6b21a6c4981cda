"""Write benchmarks/MUTANTS.md from what the workers found, and print the score."""

from __future__ import annotations

import json
import math
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

BAR = 0.85


def latest(place: Path) -> dict[str, dict[str, Any]]:
    """Return the last answer for each mutant; one that a test once killed stays killed."""
    found: dict[str, dict[str, Any]] = {}
    files = sorted(place.glob("worker*/results.jsonl"))
    answers = [json.loads(line) for f in files for line in f.read_text(encoding="utf-8").splitlines()]
    for answer in answers:
        if found.get(answer["id"], {}).get("outcome") != "killed":
            found[answer["id"]] = answer
    return found


def wilson(count: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share."""
    z, of = 1.96, max(of, 1)
    middle, scale = (count + 0.5 * z * z) / (of + z * z), z / (of + z * z)
    half = scale * math.sqrt(count * (of - count) / of + 0.25 * z * z)
    return middle - half, middle + half


def write_report(root: Path, place: Path) -> int:
    """Write the score, room by room, and each survivor with a word; return 1 below the bar."""
    draw = json.loads((place / "draw.json").read_text(encoding="utf-8"))
    answers = latest(place)
    notes_file = root / "benchmarks" / "mutants.toml"
    notes = tomllib.loads(notes_file.read_text(encoding="utf-8")) if notes_file.exists() else {}
    tried = [m for m in draw["drawn"] if m["id"] in answers]
    killed = [m for m in tried if answers[m["id"]]["outcome"] == "killed"]
    gone = [m for m in tried if answers[m["id"]].get("why") == "gone"]
    by_time = [m for m in killed if answers[m["id"]]["by"] == "time"]
    new = tuple(notes.get("new_tests", ()))
    first = sum(not any(name in answers[m["id"]]["test"] for name in new) for m in killed)
    count = max(len(tried), 1)
    share = len(killed) / max(count - len(gone), 1)
    rooms, won = (Counter(m["file"].split("/")[2] for m in group) for group in (tried, killed))
    low, high = wilson(first, count)
    lines = [
        "# Mutants", "",
        f"**{first} of {len(tried)} tried mutants killed by the tests as drawn: {first / count:.1%}** (95 % interval "
        f"{low:.0%} to {high:.0%}). **After tests written against the survivors {len(killed)} of {count - len(gone)}: "
        f"{share:.1%}** (bar: {BAR:.0%}); the lines of {len(gone)} more have been simplified away, and count in the "
        "first figure only. Made by `make mutants`: cosmic-ray's operators, "
        f"seed {draw['seed']}, drawn uniformly over the {draw['lines']} lines of six rooms that hold a mutation, "
        "whether a test reaches them or not; equivalents count as survivors. Killed means that a test fails which "
        f"passes without the mutant, or takes three times its time ({len(by_time)} of them), within "
        f"{notes.get('limit', '30 s')} of the processor.",
        "", "| room | killed | tried |", "|---|---|---|",
    ]  # fmt: skip
    lines += [f"| {room} | {won[room]} | {rooms[room]} |" for room in sorted(rooms)]
    if len(tried) < len(draw["drawn"]):
        lines += ["", f"{len(draw['drawn']) - len(tried)} of the {len(draw['drawn'])} drawn were not tried."]
    left = [m for m in tried if m not in killed and m not in gone]
    short = [m for m in left if answers[m["id"]]["why"].endswith("ran out")]
    equal = [m for m in left if notes.get(m["id"], "").startswith(("equivalent", "near equivalent"))]
    lines += [
        "", "## Survivors", "",
        f"{len(equal)} of the {len(left)} are equivalent, or so nearly that no claim parts them from "
        f"the original, by our own reading. For {len(short)} the time ran out before all tests that name it "
        "had run.", "",
    ]  # fmt: skip
    if "note" in notes:
        lines += [notes["note"], ""]
    lines += ["| where | was | became | why it lives |", "|---|---|---|---|"]
    for m in sorted(left, key=lambda m: (m["file"], m["line"])):
        word = notes.get(m["id"], answers[m["id"]]["why"])
        where = f"{m['file'].removeprefix('src/nacre/')}:{m['line']}"
        lines.append(f"| {where} | {_code(m['before'])} | {_code(m['after'])} | {word} |")
    lines += ["", "## Killed by time", "", "| where | became | test | time |", "|---|---|---|---|"]
    for m in by_time:
        where = f"{m['file'].removeprefix('src/nacre/')}:{m['line']}"
        answer = answers[m["id"]]
        lines.append(f"| {where} | {_code(m['after'])} | {_code(answer['test'])} | {answer['reason']} |")
    (root / "benchmarks" / "MUTANTS.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"mutants: {len(killed)} of {len(tried)} killed, {share:.1%}; benchmarks/MUTANTS.md names the survivors")
    return int(share < BAR)


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|").replace("`", "'") + "`"
