"""A jay's wing feather as a mesh: a bent vane of barbs either side of a shaft, for `nacre render --shape`.

`python examples/feather.py feather.obj`, then
`nacre render examples/glass/feather_barb.toml --shape feather.obj --quality fast -o feather.png`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

BARBS, ALONG = 150, 9  # on each side; points along a barb
LENGTH, WIDTH = 1.0, 0.17


def outline(t: np.ndarray) -> np.ndarray:
    """Half the width of the vane, from the quill (0) to the tip (1)."""
    return WIDTH * np.sqrt(np.clip(np.minimum(t / 0.12, (1 - t) / 0.35), 0.0, 1.0))


def barb(t: float, side: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One barb as a roof-shaped ribbon: its vertices `[n, 3]` and triangles."""
    s = np.linspace(0.0, 1.0, ALONG)
    reach = float(outline(np.array([t]))[0]) * (1 + 0.02 * rng.standard_normal()) + 0.004
    x = side * (0.006 + reach * s)
    z = LENGTH * (t - 0.5) + 0.55 * reach * s**1.2  # barbs point towards the tip
    y = -0.10 * s**2 - 0.12 * (t - 0.45) ** 2 + 0.002 * rng.standard_normal() * s  # the vane is bent both ways
    half = 0.75 * LENGTH / BARBS * (1 - 0.35 * s)
    rows = [np.stack([x, y - drop, z + shift * half], axis=1) for shift, drop in ((-1, 0.0015), (0, 0.0), (1, 0.0015))]
    faces = []
    for row in (0, 1):
        for i in range(ALONG - 1):
            a, b = row * ALONG + i, (row + 1) * ALONG + i
            quad = (a, b, b + 1, a + 1) if side > 0 else (a, a + 1, b + 1, b)
            faces += [(quad[0], quad[2], quad[1]), (quad[0], quad[3], quad[2])]
    return np.concatenate(rows), np.array(faces)


def feather() -> tuple[np.ndarray, np.ndarray]:
    """The whole feather: vertices `[n, 3]`, z up, seen from -y; triangles `[m, 3]`."""
    rng = np.random.default_rng(4)
    vertices, faces, count = [], [], 0
    for t in np.linspace(0.08, 0.985, BARBS):
        for side in (-1, 1):
            found, triangles = barb(float(t), side, rng)
            vertices.append(found)
            faces.append(triangles + count)
            count += len(found)
    # the shaft: a tapered tube
    turns, rings = 10, 40
    t = np.linspace(-0.12, 0.98, rings)
    angle = 2 * np.pi * np.arange(turns) / turns
    radius = 0.009 * np.sqrt(np.clip(1.02 - t, 0.0, 1.0))
    centre = -0.12 * (t - 0.45) ** 2
    tube = np.stack(
        [
            radius[:, None] * np.cos(angle),
            centre[:, None] + radius[:, None] * np.sin(angle),
            np.repeat(LENGTH * (t[:, None] - 0.5), turns, axis=1),
        ],
        axis=-1,
    )
    ring = np.arange(turns)
    for i in range(rings - 1):
        a, b = count + i * turns + ring, count + i * turns + (ring + 1) % turns
        faces.append(np.concatenate([np.stack([a, b, b + turns], 1), np.stack([a, b + turns, a + turns], 1)]))
    vertices.append(tube.reshape(-1, 3))
    return np.concatenate(vertices), np.concatenate(faces)


def main(path: str = "feather.obj") -> Path:
    """Write the mesh."""
    vertices, faces = feather()
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    file = Path(path)
    file.write_text("\n".join(lines) + "\n")
    return file


if __name__ == "__main__":
    main(*sys.argv[1:2])
