"""Gratings on flat objects: a compact disc, gift paper, a security patch in both positions, silicon pixels, a moth-eye.

    python examples/foils.py [FOLDER] [--quick]

Writes disc.obj and card.obj, whose uv is their place in the plane, the recipes of the painting and the pane, and six
pictures. The painting's silicon pillars take some five minutes of processor time, once.
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
GRATING = """family = "grating"
substrate = {substrate}
lattice = {{period_nm = {period}}}
wavelengths = {{min_nm = 400, max_nm = 700, step_nm = 30}}
"""
PILLARS = """layers = [{{thickness_nm = 110, material = "air", shapes = [
  {{shape = "rectangle", material = "Si", width_nm = {width}}},
]}}]
"""


def write_painting(path: Path) -> None:
    """Write a picture in square pillars of silicon: their width is 80 nm in the sky, 160 in the sun, 110 in the hills.

    The lake is bare glass, a grating without shapes.
    """
    glass = GRATING.format(substrate='"glass"', period=250)
    sky, sun, hills = (glass + PILLARS.format(width=width) for width in (80, 160, 110))
    path.write_text(
        'family = "blend"\nmask = {formula = "step(0.42 + 0.07*sin(9*u) + 0.05*sin(4 + 17*u), v)"}\n'
        '[first.recipe]\nfamily = "blend"\nmask = {formula = "step(sqrt((u - 0.66)^2 + (v - 0.68)^2), 0.13)"}\n'
        f"[first.recipe.first.recipe]\n{sun}[first.recipe.second.recipe]\n{sky}"
        '[second.recipe]\nfamily = "blend"\nmask = {formula = "step(0.2 + 0.015*sin(30*u), v)"}\n'
        f"[second.recipe.first.recipe]\n{hills}[second.recipe.second.recipe]\n{glass}",
        encoding="utf-8",
    )


def write_pane(path: Path) -> None:
    """Write a glass pane with a disc of moth-eye structure, which reflects hardly any light."""
    path.write_text(
        'family = "blend"\nmask = {formula = "step(sqrt((u - 0.5)^2 + (v - 0.5)^2), 0.3)"}\n'
        f'first = {{recipe = "{(RECIPES / "moth-eye.toml").as_posix()}"}}\n'
        "[second.recipe]\n" + GRATING.format(substrate="{n = 1.5}", period=220),
        encoding="utf-8",
    )


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
    write_painting(options.folder / "silicon-painting.toml")
    write_pane(options.folder / "moth-eye-pane.toml")
    size, spp = ("96x72", "4") if options.quick else ("384x288", "64")
    for name, (recipe, mesh, further) in PICTURES.items():
        made = options.folder / f"{recipe}.toml"
        source = made if made.exists() else RECIPES / made.name
        command = [
            sys.executable, "-m", "nacre", "render", str(source), "--shape",
            str(options.folder / f"{mesh}.obj"), "--up", "z", "--size", size, "--spp", spp, *further,
            "-o", str(options.folder / f"{name}.png"),
        ]  # fmt: skip
        subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
