"""What a person waits for in studies: a report and a sweep of metasurfaces, a tolerance of a relief, a second picture.

Each is the command itself in a new process, cold and with `--no-cache`, numba's kernels compiled beforehand by a first
run that is not counted. The figure is CPU seconds, user and system, of the process and its workers, since on a shared
machine the clock shows how busy it was; for the tolerance, whose bar is a wait, it is the clock.

Floor: 2.2 s for the process itself (imports, numba's kernels from disk: `report` of a film), 48 wavelengths of a
metasurface at about 60 ms (lattice sums 20, multipole order 15, 129 + 120 angles 20, pairs of angles 10).
Prediction: report 5 s, sweep 25 s, tolerance 50 s of CPU and 30 s by the clock.
Outcome: before, 20 s, 43 s and, by 24.8 s a table, some 600 s. Most of the report was BLAS threads that waited for each
other by spinning. Then, on two threads of one old core, 7.5 s (6.0 on one thread), 25 s, and 111 s of CPU, 67 s by the
clock; on two newer cores 3.9 s, 11 s, and 51 s by the clock with other work beside. Of a relief's draw a third are the
lines of its kappa nodes (by FFT, a third of the products' time), a third the energy bound, whose sums wait for memory,
and a fifth the choice of the sampling.
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
REPORT_BAR_S, SWEEP_BAR_S, TOLERANCE_BAR_S, SECOND_BAR_S = 6.0, 40.0, 60.0, 3.0


def spent(words: list[str], folder: Path, is_cold: bool = True) -> tuple[float, float]:
    """Run a command, with the cache of solved materials or without; return CPU seconds and those by the clock."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "NACRE_CACHE": str(folder / "cache")}
    command = [sys.executable, "-m", "nacre", *words, *(["--no-cache"] if is_cold else [])]
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.perf_counter() - start


def _second_picture(folder: Path, repeats: int) -> Row:
    """What a picture of a solved metasurface costs beyond one of a film."""
    picture = ["--size", "256x256", "--spp", "16", "-o", "a.png"]
    silver, soap = (["render", str(path), *picture] for path in (EXAMPLE, ROOT / "examples" / "soap.toml"))
    spent(silver, folder, is_cold=False)
    spent(soap, folder, is_cold=False)
    seconds = [[spent(words, folder, is_cold=False)[0] for words in (silver, soap)] for _ in range(repeats)]
    ours, film = (min(each) for each in zip(*seconds, strict=True))
    note = f"{ours:.1f} against {film:.1f} CPU s"
    return Row("a second picture of silver_on_oxide less one of soap", ours - film, "CPU s", SECOND_BAR_S, False, note)


def main(arguments: list[str] | None = None) -> int:
    """Run the three; 0 if the bars are reached."""
    options = parser(__doc__, repeats=1).parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "s.toml").write_text(SWEEP)
        (folder / "relief.toml").write_text(RELIEF)
        np.save(folder / "h.npy", np.random.default_rng(0).uniform(0.0, 0.8, (64, 64)))
        spent(["report", str(EXAMPLE)], folder)
        spent(["tolerance", "relief.toml", "--draws", "1"], folder)
        jobs = {
            "report of silver_on_oxide": (["report", str(EXAMPLE)], REPORT_BAR_S, "CPU s"),
            "sweep of 12 radii x 1 angle": (["sweep", "s.toml", "-o", "{}.zarr"], SWEEP_BAR_S, "CPU s"),
            "tolerance of 20 draws of a 64 x 64 relief": (
                ["tolerance", "relief.toml", "--draws", "20"],
                TOLERANCE_BAR_S,
                "s",
            ),
        }
        for claim, (words, bar, unit) in jobs.items():
            runs = [spent([w.format(n) for w in words], folder) for n in range(options.repeats)]
            cpu, wall = min(runs)
            note = f"{wall:.0f} s by the clock, {cpu:.0f} of CPU; least of {len(runs)} runs"
            rows.append(Row(claim, wall if unit == "s" else cpu, unit, bar, False, note))
        rows.append(_second_picture(folder, options.repeats))
    return report(Path(__file__).stem, rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
