"""The pictures that bench_pictures judges, and their references: `python benchmarks/picture_references.py`.

Ten pictures of the gallery and two more lights, each rendered long and without a denoiser at 256 x 256 pixels, once as
it is and once twice as large (the middle of the same picture at 512 x 512). A reference is two independent halves, in
half floats, in `benchmarks/references` (not in git): how far they lie apart tells what is left of its own noise. It is
made part by part; a run that was stopped goes on, and one with more samples adds to what is there.
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

from nacre.files import atomic_path
from nacre.materials.examples import examples_folder
from nacre.materials.material import load
from nacre.picture import picture as pictures
from nacre.picture.camera import Framing
from nacre.picture.lights.several import read_lamps
from nacre.picture.passes import Frame, Shot, Until, shoot
from nacre.picture.scenes.catalogue import scene as find_scene

FOLDER = Path(__file__).resolve().parent / "references"
SIDE, SPP, PART_SPP = 256, 4096, 256
ZOOMS = (1, 2)
FIRST_SEED = 1000  # beyond those of the pictures that are judged


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
        """What `nacre.render` is told."""
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
    # lights that the gallery leaves out: judged for fireflies and bias alone
    Case("gold-sun", "gold.toml", "knob", "sun", in_gallery=False),
    Case("copper-interior", "copper.toml", "knob", "interior", in_gallery=False),
)


@dataclass(frozen=True, eq=False)
class Reference:
    """A long render: XYZ `[half, row, column, 3]`, samples a pixel of each half."""

    halves: NDArray[np.float64]
    spp: NDArray[np.int64]

    @property
    def xyz(self) -> NDArray[np.float64]:
        """The mean of both."""
        return np.average(self.halves, axis=0, weights=self.spp)

    @property
    def variance(self) -> NDArray[np.float64]:
        """Of that mean, in one pixel and channel; good in the mean over many."""
        share = self.spp / self.spp.sum()
        return np.asarray(share[0] * share[1] * (self.halves[0] - self.halves[1]) ** 2)


def take(case: Case, bsdf: Any, side: int, spp: int, seed: int, zoom: int = 1) -> Frame:
    """Render a case as it is, through the box filter."""
    lamps = read_lamps(case.light or find_scene(case.scene).light)
    clear = bool(getattr(bsdf, "transmits", False))
    set_up = pictures._SetUp(case.scene, None, None, 0.0, 0.0, "D65", 0.0, clear, is_plain=False)
    stage = set_up.stage(lamps)
    stage.set_material(bsdf)
    size = find_scene(case.scene).size
    is_framed = size[0] != size[1]  # as `nacre.render` sees past the backdrop's edges
    view = stage.view(Framing()).zoomed(float(zoom))
    shot = Shot(view, (side, side), Until(spp), seed, boxed=True, is_framed=is_framed)
    return shoot(stage, shot, lambda *_: None)


def path_of(case: Case, zoom: int) -> Path:
    """Where a reference is kept."""
    return FOLDER / f"{case.name}-{SIDE}x{zoom}.npz"


def reference(case: Case, zoom: int = 1) -> Reference:
    """Return what is kept of a case.

    Raises:
        SystemExit: nothing is.
    """
    path = path_of(case, zoom)
    if not path.exists():
        raise SystemExit(f"{path.name} is missing: run `python benchmarks/picture_references.py` first")
    with np.load(path) as file:
        return Reference(file["halves"].astype(np.float64), file["spp"])


def make(case: Case, zoom: int, spp: int) -> None:
    """Make or lengthen a reference to at least `spp` samples a pixel."""
    path = path_of(case, zoom)
    halves, done = np.zeros((2, SIDE, SIDE, 3)), np.zeros(2, dtype=np.int64)
    if path.exists():
        kept = reference(case, zoom)
        halves, done = kept.halves, kept.spp
    bsdf, each = None, math.ceil(spp / 2)
    while done.min() < each:
        bsdf = case.bsdf() if bsdf is None else bsdf
        half = int(np.argmin(done))
        now = min(PART_SPP, each - int(done[half]))
        frame = take(case, bsdf, SIDE, now, FIRST_SEED + int(done.sum()), zoom)
        halves[half] = (halves[half] * done[half] + frame.xyz * now) / (done[half] + now)
        done[half] += now
        path.parent.mkdir(exist_ok=True)
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, halves=np.clip(halves, 0, 65504).astype(np.float16), spp=done)
        print(f"{path.name}: {done.sum()} of {2 * each} samples a pixel", file=sys.stderr, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="cases; all by default")
    parser.add_argument("--spp", type=int, default=SPP, help="samples a pixel (default: %(default)s)")
    parser.add_argument("--zoom", type=int, choices=ZOOMS, action="append", help="1, 2, or both (default)")
    options = parser.parse_args(arguments)
    for zoom in options.zoom or ZOOMS:
        for case in CASES:
            if (not options.names or case.name in options.names) and (zoom == 1 or case.in_gallery):
                make(case, zoom, options.spp)
    return 0


if __name__ == "__main__":
    sys.exit(main())
