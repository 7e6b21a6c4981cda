"""What a person waits for in studies: a report and a sweep of metasurfaces, a tolerance of a relief.

Each is the command itself in a new process, cold and with `--no-cache`, numba's kernels compiled beforehand by a first
run that is not counted. The figure is CPU seconds, user and system, of the process and its workers: on a shared machine
the clock tells how busy it was. A busy hyper-thread beside it still adds up to a half.

Floor: 2.2 s for the process itself (imports, numba's kernels from disk: `report` of a film), 48 wavelengths of a
metasurface at about 60 ms (lattice sums 20, multipole order 15, 129 + 120 angles 20, pairs of angles 10).
Prediction: report 5 s, sweep 25 s, tolerance 50 s of CPU and 30 s by the clock.
Outcome: before, 20 s, 43 s and, by 24.8 s a table, some 600 s. Most of the report was BLAS threads that waited for each
other by spinning. After: see RESULTS.md.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import ROOT, Row, parser, report

EXAMPLE = ROOT / "examples" / "metasurface" / "silver_on_oxide.toml"
SWEEP = f"""recipe = "{EXAMPLE.as_posix()}"
[measure]
angles_deg = [0]
[axes]
"particle.radius_nm" = {{start = 60, stop = 90, count = 12}}
"""
RELIEF = """family = "relief"
heights = "h.npy"
feature_um = 0.8
blur_um = 0.13
coating = "Al"
[coherence]
sigma = 2.6
[tolerance]
blur_um = "2%"
"""
REPORT_BAR_S, SWEEP_BAR_S, TOLERANCE_BAR_S = 6.0, 40.0, 60.0


def spent(words: list[str], folder: Path) -> tuple[float, float]:
    """Run a command; return its CPU seconds and those by the clock."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    command = [sys.executable, "-m", "nacre", *words, "--no-cache"]
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.perf_counter() - start


def main(arguments: list[str] | None = None) -> int:
    """Run the three; 0 if the bars are reached."""
    options = parser(__doc__, repeats=2).parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "s.toml").write_text(SWEEP)
        (folder / "relief.toml").write_text(RELIEF)
        np.save(folder / "h.npy", np.random.default_rng(0).uniform(0.0, 0.8, (64, 64)))
        spent(["report", str(EXAMPLE)], folder)
        spent(["tolerance", "relief.toml", "--draws", "1"], folder)
        jobs = {
            "report of silver_on_oxide": (["report", str(EXAMPLE)], REPORT_BAR_S),
            "sweep of 12 radii x 1 angle": (["sweep", "s.toml", "-o", "{}.zarr"], SWEEP_BAR_S),
            "tolerance of 20 draws of a 64 x 64 relief": (
                ["tolerance", "relief.toml", "--draws", "20"],
                TOLERANCE_BAR_S,
            ),
        }
        for claim, (words, bar) in jobs.items():
            runs = [spent([w.format(n) for w in words], folder) for n in range(options.repeats)]
            cpu, wall = min(runs)
            rows.append(Row(claim, cpu, "CPU s", bar, False, f"{wall:.0f} s by the clock; least of {len(runs)} runs"))
    return report(Path(__file__).stem, rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
