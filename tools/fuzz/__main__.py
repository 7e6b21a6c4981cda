"""Throw inputs from worker processes, each under a limit of memory and watched by the clock; count what comes.

    python -m tools.fuzz --count 20000 --jobs 2      # a second run goes on where one stopped; --again starts anew

Counts stand in `build/fuzz-SEED.json`, every failure with the number that makes it again: `--only NUMBER`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from tools.fuzz.worker import HANG_S, Worker

ROOT = Path(__file__).resolve().parents[2]
SAY_EVERY_S = 15.0


def report(state: dict[str, Any], seconds: float) -> None:
    """Print the counts."""
    counts, failures = state["counts"], state["failures"]
    done = sum(sum(found.values()) for found in counts.values())
    print(f"{done} inputs, {len(failures)} failures, {seconds:.0f} s")
    for kind in sorted(counts):
        found = counts[kind]
        print(
            f"  {kind:14s} " + ", ".join(f"{found.get(what, 0)} {what}" for what in ("answered", "refused", "failed"))
        )
    for words, numbers in sorted(state["by_words"].items(), key=lambda item: -len(item[1])):
        print(f"  {len(numbers)} x {words} (--only {numbers[0]})")


def main() -> int:
    """Run it; return 1 where anything failed."""
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz", description=__doc__.partition("\n\n")[0])
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--again", action="store_true", help="forget what an earlier run found")
    parser.add_argument("--only", type=int, default=None, help="throw one input here, and show its traceback")
    options = parser.parse_args()
    path = ROOT / "build" / f"fuzz-{options.seed}.json"
    path.parent.mkdir(exist_ok=True)
    state: dict[str, Any] = {"next": 0, "counts": {}, "failures": {}, "by_words": {}}
    if path.exists() and not options.again:
        state = json.loads(path.read_text())
    if options.only is not None:
        return throw_one(options.only, options.seed)
    begun, said = time.monotonic(), 0.0
    pending = iter(range(state["next"], options.count))
    workers = [Worker(options.seed) for _ in range(options.jobs)]
    finished = True
    try:
        while workers:
            for channel in wait([worker.channel for worker in workers], timeout=1.0):
                worker = next(w for w in workers if w.channel is channel)
                try:
                    number, kind, found = worker.channel.recv()
                except (EOFError, OSError):
                    number, kind, found = worker.number, "process", f"died with {worker.process.exitcode}"
                    worker.stop()
                    if number is None:
                        raise SystemExit("a worker cannot start; its own words stand above") from None
                    workers[workers.index(worker)] = Worker(options.seed)
                    note(state, int(number), kind, found)
                    continue
                if number != "ready":
                    note(state, int(number), kind, found)
                feed(worker, pending, workers)
            for worker in [w for w in workers if time.monotonic() > w.deadline]:
                if worker.number is not None:
                    note(state, worker.number, "hang", f"no answer after {HANG_S:g} s")
                worker.stop()
                workers[workers.index(worker)] = Worker(options.seed)
            if time.monotonic() - said > SAY_EVERY_S:
                said = time.monotonic()
                path.write_text(json.dumps(state))
                print(f"{state['next']} of {options.count}, {len(state['failures'])} failures", file=sys.stderr)
    except KeyboardInterrupt:
        finished = False
    for worker in workers:
        worker.stop()
    path.write_text(json.dumps(state))
    report(state, time.monotonic() - begun)
    return 1 if state["failures"] or not finished else 0


def feed(worker: Worker, pending: Any, workers: list[Worker]) -> None:
    """Give a worker the next number, or send it home."""
    number = next(pending, None)
    if number is None:
        worker.stop()
        workers.remove(worker)
    else:
        worker.give(number)


def note(state: dict[str, Any], number: int, kind: str, found: str) -> None:
    """Count one input."""
    what = found if found in ("answered", "refused") else "failed"
    kinds = state["counts"].setdefault(kind, {})
    kinds[what] = kinds.get(what, 0) + 1
    state["next"] = max(state["next"], number + 1)
    if what == "failed":
        state["failures"][str(number)] = f"{kind}: {found}"
        state["by_words"].setdefault(f"{kind}: {found}"[:160], []).append(number)


def throw_one(number: int, seed: int) -> int:
    """Throw one input in this process."""
    from tools.fuzz import inputs

    with tempfile.TemporaryDirectory(prefix="nacre-fuzz-") as name:
        folder = Path(name)
        os.chdir(folder)
        kind, found = inputs.throw(number, seed, folder, inputs.Sound(folder))
    print(f"{number}: {kind}: {found}")
    return 0 if found in ("answered", "refused") else 1


if __name__ == "__main__":
    sys.exit(main())
