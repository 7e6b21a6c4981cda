"""Gratings on flat objects: a compact disc, gift paper, a security patch in both positions, silicon pixels, a moth-eye.

    python examples/foils.py [FOLDER] [--quick]

Writes disc.obj and card.obj, whose uv is their place in the plane, and the six pictures. The silicon pixels take some
five minutes of processor time, once.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

RECIPES = Path(__file__).resolve().parent / "grating"
TABLE = ("--scene", "butterfly", "--light", "interior")  # on a table, in a room by day
BLACK = ("--scene", "cuff", "--light", "studio", "--view", "0,60", "--zoom", "1.05")  # black acrylic, soft boxes
PICTURES = {
    # name -> recipe, mesh, further options
    "compact-disc": ("compact-disc", "disc", (*TABLE, "--view", "15,38", "--zoom", "1.35")),
    "gift-paper": ("gift-paper", "card", (*TABLE, "--view", "15,40", "--zoom", "1.6")),
    "two-channel-patch": ("two-channel-patch", "card", (*TABLE, "--view", "0,40", "--zoom", "1.45")),
    "two-channel-patch-turned": (
        "two-channel-patch", "card", (*TABLE, "--view", "0,40", "--zoom", "1.45", "--turn", "90")
    ),
    "silicon-painting": ("silicon-painting", "card", BLACK),
    "moth-eye": ("moth-eye-pane", "card", BLACK),
}  # fmt: skip


def write_ring(path: Path, inner: float, sides: int) -> None:
    """Write a flat ring of outer radius 1, facing z; four sides without a hole make a square card."""
    turns = 2.0 * np.pi * (np.arange(sides + 1) + (0.5 if sides == 4 else 0.0)) / sides
    lines = []
    for radius in (inner, 1.0):
        for x, y in radius * np.stack([np.cos(turns), np.sin(turns)], axis=-1):
            scale = np.sqrt(0.5) if sides == 4 else 1.0
            lines += [f"v {x:.6f} {y:.6f} 0", f"vt {0.5 + 0.5 * x / scale:.6f} {0.5 + 0.5 * y / scale:.6f}", "vn 0 0 1"]
    for k in range(1, sides + 1):
        a, b, c, d = k, k + 1, k + sides + 2, k + sides + 1
        lines += [f"f {a}/{a}/{a} {d}/{d}/{d} {c}/{c}/{c}", f"f {a}/{a}/{a} {c}/{c}/{c} {b}/{b}/{b}"]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def main(arguments: list[str] | None = None) -> None:
    """Write the meshes and render the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("foils"))
    parser.add_argument("--quick", action="store_true", help="small and grainy")
    options = parser.parse_args(arguments)
    options.folder.mkdir(exist_ok=True)
    write_ring(options.folder / "disc.obj", 0.25, 128)
    write_ring(options.folder / "card.obj", 1e-4, 4)
    size, spp = ("96x72", "4") if options.quick else ("384x288", "64")
    for name, (recipe, mesh, further) in PICTURES.items():
        command = [
            sys.executable, "-m", "nacre", "render", str(RECIPES / f"{recipe}.toml"), "--shape",
            str(options.folder / f"{mesh}.obj"), "--up", "z", "--size", size, "--spp", spp, *further,
            "-o", str(options.folder / f"{name}.png"),
        ]  # fmt: skip
        subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
