"""One stack of 5 layers on a fine grid: 471 wavelengths x 90 angles, R and T of s and p.

Floor: per layer and point one complex square root, one sine and cosine, one exponential and two steps of 12
multiply-adds. Vectorised for 8 doubles that is about 12 cycles, 4 ns at 3 GHz: 5 x 42,390 points, 0.9 ms of CPU.
Prediction (before the first run): 5 ms of CPU, of which half goes to the scalar end of each point; tmm_fast forms
matrices of 7 x 64 bytes a point and some 60 passes over memory: 0.5 s, so 100 x; pyElli 90 evaluations of 1 ms: 20 x.
Outcome: 7.6 ms of CPU at first; with the ends of each block vectorised too, 2.0 ms alone and 3.4 ms beside other work
(10-16 ns per layer and point). tmm_fast 0.14 s at best (40-60 x) and up to 7 s where its threads wait for a core;
pyElli 0.19 s (55 x).
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from common import Row, Worker, interleaved, parser, report, timed

from nacre.matter import powers

FLOOR_NS = 4.0  # per layer and point


def stack() -> dict[str, np.ndarray]:
    """Two dielectric pairs over an absorbing layer on glass; smooth dispersion."""
    lam = np.linspace(360.0, 830.0, 471)
    x = 550.0 / lam
    rows = [1.0 + 0 * x, 1.45 + 0.01 * x**2, 2.3 + 0.1 * x**2, 1.45 + 0.01 * x**2, 2.3 + 0.1 * x**2, 4.0 + 0.5j * x**4]
    n = np.array([*rows, 1.5 + 0.01 * x**2], dtype=complex)
    d = np.array([95.0, 60.0, 95.0, 60.0, 40.0])
    return {"n": n[None], "thicknesses_nm": d[None], "wavelengths_nm": lam, "theta_rad": np.radians(np.arange(90.0))}


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__).parse_args(arguments)
    case = stack()
    run = lambda: powers(case["n"], case["thicknesses_nm"], case["wavelengths_nm"], case["theta_rad"])
    with tempfile.TemporaryDirectory() as folder, Worker("peer_stack.py") as worker:
        np.savez(Path(folder) / "case.npz", **case)
        worker.ask("load", path=str(Path(folder) / "case.npz"))
        worst = 0.0
        ours = run()
        for peer in ("tmm_fast", "elli"):
            worker.ask(peer, count=1, save=str(Path(folder) / "seen.npz"))
            with np.load(Path(folder) / "seen.npz") as seen:
                worst = max(worst, *(float(abs(getattr(ours, key) - seen[key]).max()) for key in seen.files))
        times = interleaved(
            {
                "nacre": lambda: timed(run),
                "tmm_fast": lambda: worker.ask("tmm_fast", count=1),
                "pyElli": lambda: worker.ask("elli", count=1),
            },
            options.repeats,
        )
    ours_t = times["nacre"]
    points = 5 * 471 * 90
    rows = [
        Row(
            f"faster than {peer}",
            times[peer].median_wall / ours_t.median_wall,
            "x (clock)",
            bar,
            note=f"{times[peer].median_cpu / ours_t.median_cpu:.0f} x by CPU time; {times[peer].median_wall:.3f} s",
        )
        for peer, bar in (("tmm_fast", 40.0), ("pyElli", 9.0))
    ]
    per_point = ours_t.median_cpu / points * 1e9
    rows.append(Row("nacre", ours_t.median_wall * 1e3, "ms", note=f"{ours_t.median_cpu * 1e3:.2f} ms of CPU"))
    rows.append(Row("per layer and point", per_point, "ns of CPU", note=f"floor {FLOOR_NS} ns"))
    rows.append(Row("largest difference in R, T", worst, "", 1e-9, higher_is_better=False))
    return report("stack_grid: 5 layers x 471 wavelengths x 90 angles, s + p", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
