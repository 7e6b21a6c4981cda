"""Example files by their kind, and the files that snippets of the reference name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 350}]\n'


def examples() -> list[Path]:
    """Return all example files."""
    return sorted(EXAMPLES.rglob("*.toml"))


def kind_of(data: dict[str, Any]) -> str:
    """Return which kind of file some data is: a family, a target of either form, or a sweep."""
    if isinstance(data.get("target"), list):
        return "design"
    return "relief-design" if "target" in data else "sweep" if "axes" in data else str(data.get("family", "film"))


def write_companions(folder: Path) -> None:
    """Write every file that a snippet of the reference names."""
    for name in ("film.toml", "other.toml"):
        (folder / name).write_text(FILM)
    for name in ("nk.csv", "dye.csv"):
        (folder / name).write_text("360, 1.5, 0.01\n830, 1.5, 0.02\n")
    (folder / "eps.txt").write_text("1.5 2.25 0.01\n2.5 2.3 0.02\n3.4 2.4 0.03\n")
    (folder / "albedo.csv").write_text("360, 0.2\n830, 0.4\n")
    (folder / "reflectance.csv").write_text("360, 0.2\n830, 0.4\n")
    (folder / "thickness.csv").write_text("380, 0.5\n420, 0.5\n")
    (folder / "xy.csv").write_text("0, 0\n400, 0\n0, 400\n")
    (folder / "s.csv").write_text("0, 0.5\n0.1, 1.0\n")
    for name in ("grey.png", "heights.png", "colours.png"):
        Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(folder / name)
    np.save(folder / "heights.npy", np.zeros((8, 8)))
    np.save(folder / "look.npy", np.zeros((64, 64)))
