"""Value and gradient of a colour loss in the 20 thicknesses of a stack: 81 wavelengths, 3 angles, CIELAB.

Floor: a reverse sweep costs 3-4 forward ones: 20 x 243 points x 4 x 4 ns = 0.08 ms.
Prediction (before the first run): 2 ms (the arrays of a scan step, 243 points, are too short to hide XLA's overhead
of some 10 us a step); compile 3 s; tmm_fast's autograd 150 ms, so 75 x.
Outcome: 4 ms of CPU and 7 s at first. Taking roots and sines out of the scan and putting s and p in one array gave
0.9 ms; gradients of cos x and sin x / x from their own values, 0.6 ms alone and 1.5 ms beside another process. On an
idle machine tmm_fast needs 15-20 ms, not the 132 ms that the issue saw: the twin alone then stands at 13-30 x. Hence
the adjoint kernel: 0.3 ms, half of it the kernel, the rest the forward solve and what JAX needs to call the colour
part. A turn is a descent of 50 gradients for each contestant, since nobody takes one alone; a single call after 15 ms
of another process finds cold caches and costs 1.2 ms.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from common import Row, Worker, interleaved, parser, report, timed

from nacre.light import illuminant, white_xyz, xyz_weights
from nacre.matter import Powers
from nacre.matter.stack import gradient as stack_gradient

LAYERS = 20
CALLS = 50  # gradients a turn: an optimiser takes hundreds in a row


def problem() -> dict[str, np.ndarray]:
    """Alternating TiO2-like and SiO2-like layers on glass, and the colour wanted at three angles."""
    lam = np.arange(380.0, 781.0, 5.0)
    x = 550.0 / lam
    n = np.empty((LAYERS + 2, len(lam)), dtype=complex)
    n[1:-1:2], n[2:-1:2] = 2.3 + 0.1 * x**2, 1.45 + 0.01 * x**2
    n[0], n[-1] = 1.0, 1.5 + 0.01 * x**2
    light = illuminant("D65")
    return {
        "n": n[None],
        "thicknesses_nm": np.random.default_rng(5).uniform(30.0, 150.0, (1, LAYERS)),
        "wavelengths_nm": lam,
        "theta_rad": np.radians([0.0, 30.0, 60.0]),
        "weights": np.array(xyz_weights(lam, light)),
        "white": np.array(white_xyz(light)),
        "wanted": np.array([[60.0, 20.0, -30.0], [55.0, 25.0, -20.0], [50.0, 30.0, 0.0]]),
    }


def descent(gradient: Callable[[np.ndarray], tuple[float, np.ndarray]], d: np.ndarray) -> tuple[float, float]:
    """Time `CALLS` gradients in a row; seconds a call, by the clock and of CPU."""
    wall, cpu = timed(lambda: [gradient(d) for _ in range(CALLS)])
    return wall / CALLS, cpu / CALLS


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=15).parse_args(arguments)
    case = problem()

    def colour_loss(seen: Powers) -> jnp.ndarray:
        ratio = (seen.reflectance @ case["weights"]) / case["white"]
        f = jnp.where(ratio > (6 / 29) ** 3, jnp.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
        lab = jnp.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=-1)
        return ((lab - case["wanted"]) ** 2).sum()

    compiled = stack_gradient.value_and_grad(colour_loss, case["n"][0], case["wavelengths_nm"], case["theta_rad"])
    d = case["thicknesses_nm"][0]
    with stack_gradient.double_precision():
        jnp.zeros(3).block_until_ready()  # the start of XLA itself is not ours
    start, start_cpu = time.perf_counter(), time.process_time()
    value, gradient = compiled(d)
    compile_s, compile_cpu_s = time.perf_counter() - start, time.process_time() - start_cpu
    with tempfile.TemporaryDirectory() as folder, Worker("peer_stack.py") as worker:
        np.savez(Path(folder) / "case.npz", **case)
        worker.ask("load", path=str(Path(folder) / "case.npz"))
        worker.ask("tmm_fast_gradient", save=str(Path(folder) / "seen.npz"))
        with np.load(Path(folder) / "seen.npz") as seen:
            worst = max(abs(seen["value"] / value - 1), abs(seen["gradient"] - gradient).max() / abs(gradient).max())
        times = interleaved(
            {
                "nacre": lambda: descent(compiled, d),
                "tmm_fast": lambda: worker.ask("tmm_fast_gradient", calls=CALLS),
            },
            options.repeats,
        )
    ours, theirs = times["nacre"], times["tmm_fast"]
    note = f"{theirs.median_cpu / ours.median_cpu:.0f} x by CPU time; {theirs.median_wall * 1e3:.0f} ms"
    rows = [
        Row("faster than tmm_fast's autograd", theirs.median_wall / ours.median_wall, "x (clock)", 40.0, note=note),
        # XLA compiles in one thread: on an idle machine clock and CPU time agree, on a busy one the clock counts others
        Row("compile", compile_cpu_s, "s of CPU", 5.0, higher_is_better=False, note=f"{compile_s:.1f} s by the clock"),
        Row("nacre", ours.median_wall * 1e3, "ms", note=f"{ours.median_cpu * 1e3:.2f} ms of CPU"),
        Row("largest relative difference of value and gradient", float(worst), "", 1e-8, higher_is_better=False),
    ]
    return report("stack_gradient: colour loss, 20 layers x 81 wavelengths x 3 angles", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
