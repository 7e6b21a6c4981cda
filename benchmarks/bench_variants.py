"""Pictures of every family on the GPU against LLVM: milliseconds and samples a second, same scene, same machine.

Scene: the standard probe, 512 x 512, not denoised. Each picture is rendered once to compile it, then `--repeats` times.
Bar: the mean X, Y and Z of both variants agree to 5 standard errors, from the spread of each pixel over the repeats.
Without a GPU the benchmark reports LLVM alone.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import Row, parser, report

import nacre
import nacre.render
from nacre.core.errors import NacreError

os.environ["NACRE_DENOISE"] = "0"
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SIZE = 512
ERRORS = 5.0
MATERIALS = {
    "film": EXAMPLES / "anodised-titanium.toml",
    "ridges": EXAMPLES / "morpho.toml",
    "pearl": EXAMPLES / "pearl" / "car_front.toml",
    "metasurface": EXAMPLES / "metasurface" / "silver_on_oxide.toml",
    "relief": EXAMPLES / "relief" / "star.toml",
    "glass": EXAMPLES / "glass" / "supraball_paint.toml",
    "grating": EXAMPLES / "grating" / "gold-lines.toml",
    "blend": EXAMPLES / "blend.toml",
}


def render(material: Any, spp: int, seed: int) -> tuple[float, np.ndarray]:
    """Return the seconds of a picture, and its linear XYZ."""
    start = time.perf_counter()
    result = nacre.render.render(material, size=(SIZE, SIZE), spp=spp, seed=seed)
    return time.perf_counter() - start, np.asarray(result.xyz)


def measure(material: Any, spp: int, repeats: int) -> tuple[float, float, np.ndarray]:
    """Return the seconds of the first picture, the least of the others, and the mean XYZ of these others."""
    first, _ = render(material, spp, 0)
    again = [render(material, spp, seed + 1) for seed in range(repeats)]
    return first, min(seconds for seconds, _ in again), np.stack([xyz for _, xyz in again])


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the means agree."""
    read = parser(__doc__, repeats=2)
    read.add_argument("--spp", type=int, default=16, help="samples a pixel")
    read.add_argument("--variants", default="cuda_ad_spectral,llvm_ad_spectral", help="Mitsuba variants, by commas")
    read.add_argument("--only", default=",".join(MATERIALS), help="materials, by commas")
    options = read.parse_args(arguments)
    materials = {name: nacre.load(MATERIALS[name]) for name in options.only.split(",")}
    rows, means = [], {}
    for variant in options.variants.split(","):
        try:
            nacre.render.use_variant(variant)
        except NacreError as error:
            print(error, file=sys.stderr)
            continue
        nacre.render.forget_scenes()
        for name, material in materials.items():
            first, seconds, xyz = measure(material, options.spp, options.repeats)
            rate = SIZE * SIZE * options.spp / seconds / 1e6
            rows.append(
                Row(f"{name}, {variant}", rate, "Msamples/s", note=f"{1e3 * seconds:.0f} ms, first {first:.1f} s")
            )
            means.setdefault(name, []).append(xyz)
    for name, found in means.items():
        if len(found) == 2 and options.repeats > 1:
            rows.append(Row(f"{name}, means", difference(*found), "standard errors", ERRORS, higher_is_better=False))
    return report(f"variants: probe, {SIZE}^2, {options.spp} samples a pixel", rows, options.json)


def difference(one: np.ndarray, two: np.ndarray) -> float:
    """Return the largest difference of two groups of pictures in mean X, Y and Z, in standard errors."""
    # pixels are independent: each one's variance comes from its repeats
    error = sum(each.var(axis=0, ddof=1).sum(axis=(0, 1)) / len(each) for each in (one, two))
    gap = one.mean(axis=0).sum(axis=(0, 1)) - two.mean(axis=0).sum(axis=(0, 1))
    return float(np.max(np.abs(gap) / np.sqrt(error)))


if __name__ == "__main__":
    sys.exit(main())
