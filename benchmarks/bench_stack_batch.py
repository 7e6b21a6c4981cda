"""10,000 random stacks of 8 layers x 47 wavelengths x 19 angles, R and T of s and p.

Floor: as in bench_stack_grid, 4 ns of CPU per layer and point: 71.4 million of them, 0.29 s.
Prediction (before the first run): 15-20 ns per layer and point, 1.2 s of CPU; tmm_fast some 150 s, pyElli 350 s.
The peers run on a part (tmm_fast on batches of the size that is fastest for it, since all 10,000 at once would take
more than 20 GB) and their times are scaled up; nacre runs all.
Outcome: 2.1 s of CPU at first, 1.4-1.8 s now beside other work (20-25 ns per layer and point; 10 ns for the kernel
alone, the rest is memory for the answers and neighbours); tmm_fast 57-150 x, pyElli 150-290 x slower; 0.61 GB.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from common import Row, Worker, interleaved, parser, report, timed

from nacre.matter import powers

STACKS, LAYERS = 10_000, 8
FLOOR_NS = 4.0
TMM_FAST_PART, ELLI_PART = 100, 10


def stacks(count: int = STACKS) -> dict[str, np.ndarray]:
    """Random layers, half of them absorbing, between air and glass; flat dispersion."""
    rng = np.random.default_rng(20)
    n = rng.uniform(1.3, 3.0, (count, LAYERS + 2)).astype(complex)
    n += 1j * np.where(rng.random(n.shape) < 0.5, rng.uniform(0, 0.5, n.shape), 0)
    n[:, 0], n[:, -1] = 1.0, 1.5
    lam = np.linspace(370.0, 830.0, 47)
    return {
        "n": np.repeat(n[:, :, None], 47, axis=2),
        "thicknesses_nm": rng.uniform(20.0, 300.0, (count, LAYERS)),
        "wavelengths_nm": lam,
        "theta_rad": np.radians(np.linspace(0.0, 85.0, 19)),
    }


def peak_bytes() -> int:
    """Peak memory of a fresh process that solves the whole batch, answers included."""
    code = "import bench_stack_batch as b; c = b.stacks(); b.solve(c); import resource; "
    code += "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    here = Path(__file__).parent
    done = subprocess.run([sys.executable, "-c", code], cwd=here, capture_output=True, text=True, check=True)
    return int(done.stdout) * (1 if sys.platform == "darwin" else 1024)


def solve(case: dict[str, np.ndarray]) -> object:
    """R and T of the whole batch."""
    return powers(case["n"], case["thicknesses_nm"], case["wavelengths_nm"], case["theta_rad"])


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=3).parse_args(arguments)
    memory = peak_bytes()
    case = stacks()
    with tempfile.TemporaryDirectory() as folder, Worker("peer_stack.py") as worker:
        np.savez(
            Path(folder) / "case.npz", **{k: v[:500] if k in ("n", "thicknesses_nm") else v for k, v in case.items()}
        )
        worker.ask("load", path=str(Path(folder) / "case.npz"))
        worst = 0.0
        part = {k: v[:ELLI_PART] if k in ("n", "thicknesses_nm") else v for k, v in case.items()}
        ours = solve(part)
        for peer in ("tmm_fast", "elli"):
            worker.ask(peer, count=ELLI_PART, save=str(Path(folder) / "seen.npz"))
            with np.load(Path(folder) / "seen.npz") as seen:
                worst = max(worst, *(float(abs(getattr(ours, key) - seen[key]).max()) for key in seen.files))
        # the batch at which tmm_fast is fastest per stack
        sizes = {size: worker.ask("tmm_fast", count=size)[0] / size for size in (10, 30, 100, 300)}
        best = min(sizes, key=lambda size: sizes[size])
        times = interleaved(
            {
                "nacre": lambda: timed(lambda: solve(case)),
                "tmm_fast": lambda: worker.ask("tmm_fast", count=best),
                "pyElli": lambda: worker.ask("elli", count=ELLI_PART),
            },
            options.repeats,
        )
    ours_t = times["nacre"]
    rows = []
    for peer, count, bar in (("tmm_fast", best, 30.0), ("pyElli", ELLI_PART, 60.0)):
        scale = STACKS / count
        wall, cpu = times[peer].median_wall * scale, times[peer].median_cpu * scale
        note = f"{cpu / ours_t.median_cpu:.0f} x by CPU time; {wall:.0f} s, scaled from {count} stacks"
        rows.append(Row(f"faster than {peer}", wall / ours_t.median_wall, "x (clock)", bar, note=note))
    per_point = ours_t.median_cpu / (STACKS * LAYERS * 47 * 19) * 1e9
    rows += [
        Row("peak memory of the process", memory / 1e9, "GB", 2.0, higher_is_better=False),
        Row("nacre", ours_t.median_wall, "s", note=f"{ours_t.median_cpu:.2f} s of CPU"),
        Row(
            "per layer and point",
            per_point,
            "ns of CPU",
            note=f"{per_point / FLOOR_NS:.1f} x the floor of {FLOOR_NS} ns",
        ),
        Row("largest difference in R, T", worst, "", 1e-9, higher_is_better=False),
    ]
    return report("stack_batch: 10,000 stacks x 8 layers x 47 wavelengths x 19 angles, s + p", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
