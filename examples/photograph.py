"""A photograph that nobody took: a lake in the mountains at dusk, drawn by formulas, for designs of pictures.

    python examples/photograph.py [FILE.png] [--size 450] [--quick]

It has what a photograph has: a sky that fades, edges, grain, dark greens, greys, and a few colours of high chroma.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).resolve().parent
HORIZON = 0.56  # from the top


def ridge(u: np.ndarray, seed: int, height: float) -> np.ndarray:
    """A skyline over u in [0, 1]: a sum of triangle waves of falling size, in [0, height]."""
    rng = np.random.default_rng(seed)
    line = np.zeros_like(u)
    for octave in range(7):
        phase, frequency = rng.uniform(), 1.3 * 1.9**octave
        line += np.abs((u * frequency + phase) % 1.0 - 0.5) * 2.0 / 1.75**octave
    return height * line / line.max()


def soft_noise(shape: tuple[int, int], cells: int, seed: int) -> np.ndarray:
    """Smooth noise in [-1, 1] with so many cells over the picture."""
    grid = np.random.default_rng(seed).uniform(-1.0, 1.0, (cells + 1, cells + 1))
    rows, columns = (np.linspace(0.0, cells - 1e-9, n) for n in shape)
    r, c = rows.astype(int)[:, None], columns.astype(int)[None, :]
    fr, fc = rows[:, None] - r, columns[None, :] - c
    fr, fc = fr * fr * (3.0 - 2.0 * fr), fc * fc * (3.0 - 2.0 * fc)
    top = grid[r, c] * (1.0 - fc) + grid[r, c + 1] * fc
    bottom = grid[r + 1, c] * (1.0 - fc) + grid[r + 1, c + 1] * fc
    return top * (1.0 - fr) + bottom * fr


def landscape(size: int) -> np.ndarray:
    """Return the picture, `[row, column, 3]`, encoded sRGB in [0, 1]."""
    v, u = np.mgrid[0.5 / size : 1.0 : size * 1j, 0.5 / size : 1.0 : size * 1j]
    above = np.where(v < HORIZON, v, 2.0 * HORIZON - v) / HORIZON  # the lake mirrors what is above it
    shift = np.where(v > HORIZON, 0.006 * np.sin(900.0 * np.sqrt(np.maximum(v - HORIZON, 0.0))), 0.0)
    x = np.clip(u + shift, 0.0, 1.0)
    stops = np.array([0.0, 0.45, 0.75, 0.95, 1.3])
    colours = np.array([[38, 62, 118], [104, 122, 170], [214, 150, 142], [246, 196, 120], [250, 214, 150]]) / 255.0
    picture = np.stack([np.interp(above, stops, colours[:, k]) for k in range(3)], axis=-1)
    sun = np.exp(-((((x - 0.68) ** 2 + (above - 0.72) ** 2) / 0.0016) ** 2))
    glow = np.exp(-np.sqrt((x - 0.68) ** 2 + (above - 0.72) ** 2) / 0.16)
    picture += (0.35 * glow + 0.9 * sun)[..., None] * np.array([1.0, 0.72, 0.32])
    cloud = np.clip(soft_noise((size, size), 6, 1) + 0.6 * soft_noise((size, size), 17, 2) - 0.25, 0.0, 1.0)
    picture += (0.35 * cloud * np.exp(-(((above - 0.35) / 0.22) ** 2)))[..., None] * np.array([1.0, 0.62, 0.55])
    for depth, (height, base, colour) in enumerate(
        [(0.42, 0.42, (0.46, 0.44, 0.58)), (0.34, 0.62, (0.25, 0.29, 0.43)), (0.22, 0.82, (0.11, 0.19, 0.19))]
    ):
        line = 1.0 - ridge(x, 11 + depth, height) * (0.55 + 0.45 * np.cos(3.0 * (x - 0.25 * depth)) ** 2) - 0.02
        edge = np.clip((above - np.minimum(line, 1.0 + 0.0 * base)) * size / 1.5, 0.0, 1.0)[..., None]
        grain = 0.05 * soft_noise((size, size), 60, 20 + depth) + 0.03 * soft_noise((size, size), 140, 30 + depth)
        picture = picture * (1.0 - edge) + edge * np.clip(np.array(colour) + grain[..., None], 0.0, 1.0)
    water = (v > HORIZON)[..., None]
    picture = np.where(water, picture * np.array([0.72, 0.82, 0.86]) + np.array([0.0, 0.02, 0.05]), picture)
    shore = v > 0.88 - 0.10 * (1.0 - u) ** 2 - 0.02 * soft_noise((size, size), 9, 40)
    meadow = np.stack([0.16 + 0.10 * u, 0.30 + 0.10 * (1.0 - v), 0.12 + 0.0 * u], axis=-1)
    meadow += 0.08 * soft_noise((size, size), 120, 41)[..., None]
    picture = np.where(shore[..., None], meadow, picture)
    rng = np.random.default_rng(5)
    for _ in range(90):  # flowers on the shore
        row, column = rng.uniform(0.90, 0.995), rng.uniform(0.0, 1.0)
        spot = (u - column) ** 2 + (v - row) ** 2 < rng.uniform(0.003, 0.008) ** 2
        picture[spot] = [(0.80, 0.16, 0.22), (0.95, 0.80, 0.25), (0.62, 0.28, 0.66)][rng.integers(3)]
    boat = (np.abs(u - 0.30) < 0.055 - 1.1 * np.maximum(v - 0.70, 0.0)) & (v > 0.695) & (v < 0.722)
    sail = (u < 0.302) & (u > 0.302 - 0.5 * (v - 0.585)) & (v > 0.585) & (v < 0.690)
    picture[boat], picture[sail] = (0.45, 0.10, 0.09), (0.93, 0.90, 0.84)
    grain = 0.008 * np.random.default_rng(7).normal(size=picture.shape)
    return np.clip(picture + grain, 0.0, 1.0)


def main(quick: bool = False, path: str | Path = HERE / "targets" / "photo.png", size: int = 450) -> Path:
    """Draw the picture into a file; return its path."""
    pixels = landscape(64 if quick else size)
    Image.fromarray(np.round(255.0 * pixels).astype(np.uint8)).save(path, optimize=True)
    return Path(path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", nargs="?", default=str(HERE / "targets" / "photo.png"))
    parser.add_argument("--size", type=int, default=450)
    parser.add_argument("--quick", action="store_true")
    chosen = parser.parse_args()
    print(main(chosen.quick, chosen.path, chosen.size))
