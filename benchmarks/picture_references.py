"""The pictures that bench_pictures evaluates, and their references: `python benchmarks/picture_references.py`.

Ten pictures of the gallery and two more lights, each rendered long and without a denoiser at 512 x 512 pixels with
1,024 samples a pixel. Pixels of a box filter add up: that is the picture of 256 x 256 with 4,096 samples a pixel, and
its middle is the reference for pictures of 512 x 512. Both lie in `benchmarks/references`, in half floats, with how far
two independent halves of the samples lie from their mean, to a tenth, which gives the rest of a reference's own
noise. They are part of the repository and made again only where scenes, lights or examples change what is seen, by

    python benchmarks/picture_references.py --anew NAME ...

in 3 to 16 CPU minutes a picture. A run with more samples, or one after a stopped run, adds to what is there.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.files import atomic_path
from nacre.material.examples import examples_folder
from nacre.material.material import load
from nacre.picture import picture as pictures
from nacre.picture.camera import Framing
from nacre.picture.emitters import read_lamps
from nacre.picture.options import Subject
from nacre.picture.passes import Frame, RenderSettings, Until, render_passes
from nacre.picture.scenes import scene as find_scene

FOLDER = Path(__file__).resolve().parent / "references"
SIDE = 256
SPP, PART_SPP = 4096, 512  # a pixel of that side
FINER = 2  # times the side, of the picture that is rendered
FIRST_SEED = 1000  # beyond those of the evaluated pictures
SMALLEST, STEP = 2.0**-24, 2.0**0.25  # of what is kept of a difference: its sign, and its logarithm in such steps


@dataclass(frozen=True)
class Case:
    """A picture: its recipe among the examples, where it stands, and the samples a pixel of commit a3558d7."""

    name: str
    recipe: str
    scene: str
    light: str | None = None
    quality: str | None = None
    before_spp: int = 64
    in_gallery: bool = True

    def bsdf(self) -> Any:
        """Return the material as its picture has it."""
        return pictures.resolve_material(load(examples_folder() / self.recipe), self.quality, "sum")[0]

    @property
    def look(self) -> dict[str, Any]:
        """The arguments of `nacre.render`."""
        return {"scene": self.scene, "light": self.light}


CASES = (
    Case("soap", "soap.toml", "sphere"),
    Case("morpho", "morpho.toml", "butterfly"),
    Case("oil-slick", "oil-slick.toml", "speedshape"),
    Case("anodised-titanium", "anodised-titanium.toml", "panel", before_spp=196),
    Case("bragg-mirror", "bragg-mirror.toml", "knob"),
    Case("silver_halo", "metasurface/silver_halo.toml", "probe"),
    Case("silver_on_oxide", "metasurface/silver_on_oxide.toml", "speedshape", "sky"),
    Case("silver_on_oxide-car", "metasurface/silver_on_oxide.toml", "body", "street"),
    Case("bottle3", "pearl/bottle3.toml", "bottle", quality="fast"),
    Case("car_front", "pearl/car_front.toml", "body"),
    # lights that the gallery leaves out: evaluated for fireflies and bias alone
    Case("gold-sun", "gold.toml", "knob", "sun", in_gallery=False),
    Case("copper-interior", "copper.toml", "knob", "interior", in_gallery=False),
)


@dataclass(frozen=True, eq=False)
class Reference:
    """A long render: XYZ `[row, column, 3]`, by how much one half of its samples lies above it, and samples a pixel."""

    xyz: NDArray[np.float64]
    half: NDArray[np.float64]
    spp: int

    @property
    def halves(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The pictures that either half of the samples gives."""
        return self.xyz + self.half, self.xyz - self.half

    @property
    def variance(self) -> NDArray[np.float64]:
        """Of the picture, in one pixel and channel; good in the mean over many."""
        return np.asarray(self.half**2)


def take(case: Case, bsdf: Any, side: int, spp: int, seed: int) -> Frame:
    """Render a case as it is, through the box filter."""
    lamps = read_lamps(case.light or find_scene(case.scene).light)
    clear = bool(getattr(bsdf, "transmits", False))
    set_up = pictures._SetUp(case.scene, Subject(), 0.0, "D65", 0.0, clear, is_plain=False)
    built = set_up.cached(lamps)
    built.set_material(bsdf)
    size = find_scene(case.scene).size
    is_framed = size[0] != size[1]  # as `nacre.render` sees past the backdrop's edges
    settings = RenderSettings(built.view(Framing()), (side, side), Until(spp), seed, boxed=True, is_framed=is_framed)
    return render_passes(built, settings, lambda *_: None)


def path_of(case: Case) -> Path:
    """Where a case's references are kept."""
    return FOLDER / f"{case.name}.npz"


def reference(case: Case, of_middle: bool = False) -> Reference:
    """Return the reference of a case at 256 x 256, or of the middle of it at 512 x 512.

    Raises:
        SystemExit: it is not there.
    """
    path = path_of(case)
    if not path.exists():
        raise SystemExit(f"{path.name} is missing: run `python benchmarks/picture_references.py {case.name}` first")
    with np.load(path) as file:
        name, spp = ("middle", int(file["spp"]) // FINER**2) if of_middle else ("whole", int(file["spp"]))
        return Reference(unpacked_halfs(file[name]), unpacked_signs(file[f"{name}_half"]), spp)


def packed_halfs(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return half floats `[row, column, 3]` as steps along the rows, low and high bytes apart: a third less to keep."""
    words = np.clip(values, 0.0, 65504.0).astype(np.float16).view(np.uint16)
    steps = np.diff(words, axis=1, prepend=np.zeros_like(words[:, :1]))
    return np.stack([steps & 0xFF, steps >> 8]).astype(np.uint8)


def unpacked_halfs(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Undo `packed_halfs`."""
    steps = packed[0].astype(np.uint16) | (packed[1].astype(np.uint16) << 8)
    return np.cumsum(steps, axis=1, dtype=np.uint16).view(np.float16).astype(np.float64)


def packed_signs(values: NDArray[np.float64]) -> NDArray[np.int8]:
    """Return numbers in a byte each: their sign, and the logarithm of their size in steps of a quarter of an octave."""
    size = np.round(np.log(np.maximum(np.abs(values), SMALLEST) / SMALLEST) / np.log(STEP))
    return np.asarray(np.sign(values) * np.clip(size, 0, 127), dtype=np.int8)


def unpacked_signs(packed: NDArray[np.int8]) -> NDArray[np.float64]:
    """Undo `packed_signs`, to 9 %."""
    size = np.abs(packed.astype(np.float64))
    return np.asarray(np.sign(packed) * SMALLEST * STEP**size)


def make(case: Case, spp: int) -> None:
    """Make or lengthen a reference to at least `spp` samples a pixel of 256 x 256."""
    path, pixels = path_of(case), FINER**2
    halves = {False: np.zeros((2, SIDE, SIDE, 3)), True: np.zeros((2, SIDE, SIDE, 3))}
    done = 0  # samples a pixel of the picture that is rendered, both halves together
    if path.exists():
        halves = {of_middle: np.stack(reference(case, of_middle).halves) for of_middle in halves}
        done = reference(case).spp // pixels
    bsdf, seed = None, FIRST_SEED + done
    middle = slice(SIDE * (FINER - 1) // 2, SIDE * (FINER + 1) // 2)
    while done < math.ceil(spp / pixels):
        bsdf = case.bsdf() if bsdf is None else bsdf
        now = min(PART_SPP // pixels, math.ceil((math.ceil(spp / pixels) - done) / 2))  # of one half
        for half in range(2):
            xyz = take(case, bsdf, FINER * SIDE, now, seed + half * now).xyz
            seen = {False: xyz.reshape(SIDE, FINER, SIDE, FINER, 3).mean(axis=(1, 3)), True: xyz[middle, middle]}
            for of_middle, before in halves.items():
                before[half] = (before[half] * done + seen[of_middle] * 2 * now) / (done + 2 * now)
        done, seed = done + 2 * now, seed + 2 * now
        keep(path, halves, done * pixels)
        print(f"{path.name}: {done * pixels} of {spp} samples a pixel", file=sys.stderr, flush=True)


def keep(path: Path, halves: dict[bool, NDArray[np.float64]], spp: int) -> None:
    """Write two halves `[half, row, column, 3]` each of the whole picture and of its middle."""
    arrays: dict[str, Any] = {"spp": np.array(spp)}
    for name, (first, second) in (("whole", halves[False]), ("middle", halves[True])):
        arrays[name] = packed_halfs(0.5 * (first + second))
        arrays[f"{name}_half"] = packed_signs(0.5 * (first - second))
    path.parent.mkdir(exist_ok=True)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="cases; all by default")
    parser.add_argument("--spp", type=int, default=SPP, help="samples a pixel of 256 x 256 (default: %(default)s)")
    parser.add_argument("--anew", action="store_true", help="begin again whatever is there")
    options = parser.parse_args(arguments)
    known = [case.name for case in CASES]
    if unknown := sorted(set(options.names) - set(known)):
        parser.error(f"{', '.join(unknown)}: not a case; choose from {', '.join(known)}")
    for case in CASES:
        if not options.names or case.name in options.names:
            if options.anew:
                path_of(case).unlink(missing_ok=True)
            make(case, options.spp)
    return 0


if __name__ == "__main__":
    sys.exit(main())
