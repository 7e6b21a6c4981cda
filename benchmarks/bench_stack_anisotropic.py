"""Anisotropic stacks against pyElli: 10 biaxial layers x 200 wavelengths x 10 angles, a cholesteric of 15 turns.

pyElli batches over wavelengths and is called once an angle. Its `TwistedLayer` multiplies matrices of constant slices,
whose error falls with the square of their number; the number here makes its error that of nacre's coarse answer or
more, so the comparison is at equal error or in favour of pyElli. Contestants alternate; CPU times are compared, since
nacre runs on all cores. Guessed before the first run: 80 x and 150 x.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from common import Row, Worker, interleaved, parser, report, timed

from nacre.matter.indices.crystal import euler_axes
from nacre.matter.stack.anisotropic import AnisotropicLayer, solve_anisotropic

HELIX = (1.5, 1.7, 650.0, 15.0)  # n_o, n_e, pitch in nm, turns
PEER_SLICES = 450  # 15 a half turn
SHARES = (0.2, 0.25, 0.3, 0.4, 0.6, 1.0)  # of nacre's slices


def principal_tensor(
    indices: np.ndarray | list[float], euler_deg: np.ndarray | tuple[float, ...] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Return R diag(n^2) R^T with the principal axes as the columns of Rz(a) Rx(b) Rz(c)."""
    axes = euler_axes((euler_deg[0], euler_deg[1], euler_deg[2]))
    return np.einsum("ij,...j,kj->...ik", axes, np.asarray(indices, dtype=complex) ** 2, axes)


def case() -> dict[str, np.ndarray]:
    """Return the layers of the stack and the grid."""
    g = np.random.default_rng(0)
    return {
        "n": g.uniform(1.3, 2.5, (10, 3)),
        "euler_deg": g.uniform(0, 180, (10, 3)),
        "thicknesses_nm": g.uniform(20, 300, 10),
        "wavelengths_nm": np.linspace(400.0, 800.0, 200),
        "degrees": np.linspace(0.0, 75.0, 10),
        "helix": np.array(HELIX),
        "helix_degrees": np.array([30.0]),
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=3).parse_args(arguments)
    data = case()
    waves, theta, glass = data["wavelengths_nm"], np.radians(data["degrees"]), np.asarray(2.25 + 0j)
    layers = [
        AnisotropicLayer(principal_tensor(n, euler), float(d))
        for n, euler, d in zip(data["n"], data["euler_deg"], data["thicknesses_nm"])
    ]
    n_o, n_e, pitch, turns = HELIX
    helix = [AnisotropicLayer(principal_tensor([n_e, n_o, n_o]), pitch * turns, pitch)]
    exact = [AnisotropicLayer(principal_tensor([n_e, n_o, n_o]), pitch * turns, pitch, 1, 400)]
    angle = np.radians(data["helix_degrees"])
    truth = solve_anisotropic(1.0, exact, glass, waves, angle).R
    with tempfile.TemporaryDirectory() as folder, Worker("peer_anisotropic.py") as worker:
        np.savez(Path(folder) / "case.npz", **data)
        seen = str(Path(folder) / "seen.npz")
        worker.ask("load", path=str(Path(folder) / "case.npz"))
        worker.ask("stack", save=seen)
        with np.load(seen) as file:
            difference = float(np.abs(file["R"] - solve_anisotropic(1.0, layers, glass, waves, theta).R).max())
        worker.ask("helix", slices=PEER_SLICES, save=seen)
        with np.load(seen) as file:
            peer_error = float(np.abs(file["R"] - truth).max())
        share = next(s for s in SHARES if _error(helix, s, waves, angle, glass, truth) <= peer_error or s == 1.0)
        own_error = _error(helix, share, waves, angle, glass, truth)
        times = interleaved(
            {
                "nacre": lambda: timed(lambda: solve_anisotropic(1.0, layers, glass, waves, theta)),
                "pyElli": lambda: worker.ask("stack"),
                "nacre helix": lambda: timed(
                    lambda: solve_anisotropic(1.0, helix, glass, waves, angle, slice_share=share)
                ),
                "pyElli helix": lambda: worker.ask("helix", slices=PEER_SLICES),
            },
            options.repeats,
        )
    rows = [
        Row(
            what,
            times[peer].median_cpu / times[own].median_cpu,
            "x",
            bar,
            note=f"{1e3 * times[own].median_cpu:.1f} ms against {times[peer].median_cpu:.2f} s of CPU time; "
            f"{times[peer].median_wall / times[own].median_wall:.0f} x by the clock; guessed {predicted} x",
        )
        for what, own, peer, bar, predicted in (
            ("faster than pyElli's 4 x 4", "nacre", "pyElli", 60.0, 80),
            ("faster than its TwistedLayer", "nacre helix", "pyElli helix", 100.0, 150),
        )
    ]
    rows.append(Row("largest difference in R, stack", difference, "", 1e-9, higher_is_better=False))
    rows.append(Row("error of the helix", own_error, "", peer_error, higher_is_better=False, note="bar: pyElli's"))
    return report("stack_anisotropic: 10 biaxial layers, 15 turns", rows, options.json)


def _error(
    layers: list[AnisotropicLayer], share: float, waves: np.ndarray, theta: np.ndarray, glass: np.ndarray,
    truth: np.ndarray,
) -> float:  # fmt: skip
    found = solve_anisotropic(1.0, layers, glass, waves, theta, slice_share=share).R
    return float(np.abs(found - truth).max())


if __name__ == "__main__":
    sys.exit(main())
