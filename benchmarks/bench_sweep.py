"""Sweeps: 10,000 film points from spectrum to Lab at five angles, and two worker processes against one.

Bars: 10,000 points (random thickness, one film, five angles, default wavelengths) in at most 60 s with flat memory;
two single-threaded workers on a Dask scheduler over TCP at least 1.7 times as fast as one.
Floor of a point: 5 angles x 48 wavelengths of one layer's characteristic matrix, some 50 us, and three files of 15
doubles; all else is checking the recipe and choosing its wavelengths.
Prediction: 2.7 ms to compute and 0.3 ms to write, so 30 s by one process on a free core; memory flat since a point
leaves nothing but its files. Two workers: points of 11 ms (a mirror of 24 layers) hide
what the writing process and the scheduler cost, so 1.8 on two free cores; on a busy machine less.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "study"))

from benchmarks.common import ROOT, Row, parser, report
from nacre.core.jobs import Workers

POINTS, POINTS_BAR_S = 10_000, 60.0
MEMORY_BAR_MB = 20.0  # growth from the first tenth to the end
SPEED_UP_BAR = 1.7
FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
PAIR = '{material = "TiO2", thickness_nm = 60}, {material = "SiO2", thickness_nm = 95}'
MIRROR = f'family = "film"\nsubstrate = "Si"\nlayers = [{", ".join([PAIR] * 12)}]\n'


def peak_mb() -> float:
    """Return the peak resident memory of this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def write_sweep(folder: Path, recipe: str, count: int, low: float, high: float) -> Path:
    """Write a sweep of random thicknesses."""
    (folder / "film.toml").write_text(recipe)
    path = folder / "sweep.toml"
    path.write_text(
        f'recipe = "film.toml"\nmode = "random"\ncount = {count}\n[axes]\n'
        f'"layers[0].thickness_nm" = {{low = {low}, high = {high}}}\n'
    )
    return path


def bench_points(count: int) -> list[Row]:
    """Time one process over many points and watch its memory."""
    from nacre.analysis.sweep import run_sweep
    from nacre.analysis.sweep_plan import load_sweep

    marks: list[float] = []

    def watch(done: int, failed: int, total: int) -> None:
        if done in (total // 10, total):
            marks.append(peak_mb())

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sweep = load_sweep(write_sweep(folder, FILM, count, 50.0, 900.0))
        wall, cpu = time.perf_counter(), time.process_time()
        finished, failed = run_sweep(sweep, folder / "s.zarr", workers=Workers(1), progress=watch)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    assert (finished, failed) == (count, 0)
    scale = POINTS / count
    return [
        Row(f"{POINTS} film points, one process", wall * scale, "s", POINTS_BAR_S, False,
            f"{count} run; CPU {cpu * scale:.1f} s, {1e3 * cpu / count:.2f} ms a point"),
        Row("memory grown after the first tenth", marks[-1] - marks[0], "MB", MEMORY_BAR_MB, False,
            f"peak {marks[-1]:.0f} MB"),
    ]  # fmt: skip


def bench_workers(count: int, repeats: int) -> Row:
    """Time two workers against one, interleaved, on the same scheduler over TCP."""
    import statistics

    from helpers_study import dask_over_tcp

    from nacre.analysis.sweep import run_sweep
    from nacre.analysis.sweep_plan import load_sweep

    times: dict[int, list[float]] = {1: [], 2: []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sweep = load_sweep(write_sweep(folder, MIRROR, count, 40.0, 80.0))
        with dask_over_tcp(folder, 1) as one, dask_over_tcp(folder, 2) as two:
            for number in range(repeats + 1):  # the first round starts the workers' imports and is not counted
                for workers, address in ((1, one), (2, two)):
                    start = time.perf_counter()
                    run_sweep(sweep, folder / f"{workers}-{number}.zarr", workers=Workers(cluster=address))
                    if number:
                        times[workers].append(time.perf_counter() - start)
    median = {workers: statistics.median(seconds) for workers, seconds in times.items()}
    return Row(
        "two workers over one, TCP on loopback", median[1] / median[2], "x", SPEED_UP_BAR, True,
        f"{count} points of a mirror of 24 layers; medians {median[1]:.2f} and {median[2]:.2f} s",
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run both parts."""
    options = parser(__doc__, repeats=2)
    options.add_argument("--points", type=int, default=POINTS, help="points of the first part")
    options.add_argument("--worker-points", type=int, default=400, help="points of the second part")
    given = options.parse_args(arguments)
    rows = bench_points(given.points)
    rows.append(bench_workers(given.worker_points, given.repeats))
    return report(Path(__file__).stem, rows, given.json, {"root": ROOT.name})


if __name__ == "__main__":
    sys.exit(main())
