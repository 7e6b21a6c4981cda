"""Paint of photonic balls against balls that stand in a box, light traced in space on both scales at once.

The referee (`tests/glass/two_scale.py`) shares no transport with the product: balls of radius 1 are placed one by one,
rays meet their faces and walk inside them. The product solves a medium of such balls, each met at random. Asked: how
far off it is where balls stand close, with and without a binder's face, and whether the reason is that balls are whole:
none has its centre within a radius of a face, so that light turned back near a face leaves unhindered. The referee is
also run with balls cut by the faces, which are as dense there as elsewhere.
"""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import nacre
from nacre.families.glass.radiative_transfer import Slab
from validation._film import canvas
from validation._rows import finish, row

FIGURE = "glass_balls.png"
FRACTIONS, FACES = (0.05, 0.1, 0.2, 0.3), (1.0, 1.5)
SIDE, DEPTH, HIGHER = 20.0, 20.0, 32.0  # of the box, in radii
BOXES, WALKS = 4, 6000
RADIUS_NM, BINDER = 4000.0, 1.5
LAM = np.array([430.0])
THROUGH, BACK, CUT = 0.02, 0.12, 0.03  # what the page on glass states: of the light, and of reflectance


def referee() -> Any:
    """The tests' own tracer."""
    path = Path(__file__).resolve().parents[1] / "tests" / "glass" / "two_scale.py"
    spec = importlib.util.spec_from_file_location("two_scale", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def paint(fraction: float) -> Any:
    """Balls of polystyrene spheres in a clear binder."""
    return nacre.material(
        {
            "family": "glass",
            "thickness_um": DEPTH * RADIUS_NM / 1e3,
            "spheres": {"material": {"n": 1.59}, "radius_nm": 125, "volume_fraction": 0.55},
            "absorber": {"k": 0.001},
            "balls": {"binder": {"n": BINDER}, "radius_um": RADIUS_NM / 1e3, "volume_fraction": fraction},
        }
    ).model.composite


def traced(module: Any, fraction: float, face: float) -> Any:
    """R and T of balls in boxes; the ratio of the indices of ball and binder is kept, whatever the face has."""
    glass = paint(fraction).glass.medium(LAM)
    generator = np.random.default_rng(3)
    found = [
        module.trace(
            7 * i, WALKS, module.place_balls(fraction, SIDE, DEPTH, generator), SIDE, DEPTH, 1.0, face,
            float(glass.index[0]) * face / BINDER, glass.scattering[0] * RADIUS_NM, glass.absorption[0] * RADIUS_NM,
            glass.quantiles()[0],
        )
        for i in range(BOXES)
    ]  # fmt: skip
    return np.mean(found, axis=0)


def cut(module: Any, fraction: float) -> Any:
    """R and its standard error of balls cut by faces without a step of the index."""
    glass = paint(fraction).glass.medium(LAM)
    generator = np.random.default_rng(3)
    found = []
    for i in range(2 * BOXES):
        # centres fill all but a radius at each end of a higher box
        balls = module.place_balls(fraction * (HIGHER - 2) / HIGHER, SIDE, HIGHER, generator)
        balls[:, 2] -= 0.5 * (HIGHER - DEPTH)
        found.append(
            module.trace(
                7 * i, WALKS, balls, SIDE, DEPTH, 1.0, 1.0, float(glass.index[0]) / BINDER,
                glass.scattering[0] * RADIUS_NM, glass.absorption[0] * RADIUS_NM, glass.quantiles()[0], True,
            )[0]
        )  # fmt: skip
    return np.mean(found), np.std(found, ddof=1) / np.sqrt(len(found))


def solved(fraction: float, face: float) -> Any:
    """R and T of the product."""
    medium = replace(paint(fraction).medium(LAM), index=np.full(1, face))
    parts = np.array(Slab.solve(medium, 0, DEPTH * RADIUS_NM, None).powers(np.ones(1)))[:, 0]
    return parts[[0, 1]] + parts[[2, 3]]


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    module, rows = referee(), []
    figure, axes = canvas(1, 2, 9.0, 3.6)
    for axis, face in zip(axes.flat, FACES):
        ours = np.array([solved(f, face) for f in FRACTIONS])
        theirs = np.array([traced(module, f, face) for f in FRACTIONS])
        for part, name in enumerate(("R", "T")):
            axis.plot(FRACTIONS, theirs[:, part], "o", color=f"C{part}", label=f"{name}, traced in a box")
            axis.plot(FRACTIONS, ours[:, part], color=f"C{part}", label=f"{name}, nacre")
        axis.set(xlabel="volume fraction of balls", ylabel="share of the light", title=f"faces of index {face:g}")
        axis.legend(fontsize=6, frameon=False)
        noise = np.sqrt(theirs * (1 - theirs) / (BOXES * WALKS))
        off = float(np.max(np.abs(ours[:, 1] - theirs[:, 1]) - 2 * noise[:, 1]))
        claim = f"balls at 5 to 30 %, faces of index {face:g}: transmittance against balls traced in a box"
        rows.append(row(claim, f"within {THROUGH:g}", f"{max(off, 0.0):.3f}", off <= THROUGH, FIGURE))
        low = ours[:, 0] / theirs[:, 0] - 1
        said = ", ".join(f"{100 * value:+.0f} %" for value in low)
        holds = bool(np.all(np.abs(low) - 2 * noise[:, 0] / theirs[:, 0] <= BACK))
        claim = f"reflectance at {', '.join(f'{100 * f:g}' for f in FRACTIONS)} %, faces of index {face:g}"
        rows.append(row(claim, f"up to {100 * BACK:g} % too low", said, holds, FIGURE))
    whole = [cut(module, f) for f in FRACTIONS[1:]]
    low = [solved(f, 1.0)[0] / found - 1 for f, (found, _) in zip(FRACTIONS[1:], whole, strict=True)]
    holds = all(abs(off) <= CUT + 2 * error / found for off, (found, error) in zip(low, whole, strict=True))
    claim = "reflectance of balls cut by the faces, at 10, 20, 30 %"
    rows.append(row(claim, f"within {100 * CUT:g} %", ", ".join(f"{100 * off:+.0f} %" for off in low), holds, FIGURE))
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
