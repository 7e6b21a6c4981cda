"""What the scripts of pearl pictures share: materials, pictures, means over an object's blocks of pixels, pages."""

from __future__ import annotations

from typing import Any

import numpy as np

import nacre
from nacre.bsdf import Bsdf
from nacre.light import delta_e_2000, xyz_to_lab
from validation._pearl import GRID_NM, Array, baked, material_of

EFFORT = 0.06
SPP, WALK_SPP = 49, 144
KNOB, BOTTLE = (128, 128), (144, 180)
BLOCK = 6
LARGE = 5.0  # CIEDE2000 of a change that is called large, or vast
SUBSTRATES: dict[str, dict[str, Any]] = {
    "silica": {"material": "SiO2", "thickness_nm": 80},
    "mica": {"material": "mica", "thickness_nm": 560.44, "deviation_nm": 179.32},
}


def still(recipe: Any) -> Bsdf:
    """The noise-free form as a Bsdf."""
    return Bsdf((baked(recipe, EFFORT),), {})


def c1(density: float, coating_nm: float, substrate: Any, **flake: Any) -> dict[str, Any]:
    """The source's C1 (silica) or C2 (mica): 150 um of PET, roughness 0.01, base 0.7, deviation 0.1."""
    platelets = {
        "volume_fraction": density,
        "substrate": substrate,
        "coatings": [{"material": "TiO2", "thickness_nm": coating_nm}],
        "normal_deviation": 0.1,
        **flake,
    }
    stratum = {"resin": {"n": 1.575}, "thickness_um": 150, "roughness": 0.01, "platelets": [platelets]}
    return {"family": "pearl", "strata": [stratum], "base": {"albedo": 0.7}}


def traced(recipe: Any) -> Bsdf:
    """The walk's Bsdf, at 10 nm."""
    return material_of(recipe).vary({"quality": "reference"}).bsdf(GRID_NM)


def picture(bsdf: Bsdf, scene: str, size: tuple[int, int], spp: int = SPP, **settings: Any) -> Any:
    """Render at a fixed exposure if none is asked for, so that pictures compare."""
    return nacre.render(bsdf, scene=scene, size=size, spp=spp, seed=3, progress=False, **{"exposure": 0.5, **settings})


def blocks(xyz: Array) -> Array:
    """Means over blocks of pixels, `[block, 3]`."""
    rows, columns = (n // BLOCK for n in xyz.shape[:2])
    cut = np.asarray(xyz[: rows * BLOCK, : columns * BLOCK], dtype=float)
    return np.asarray(cut.reshape(rows, BLOCK, columns, BLOCK, 3).mean(axis=(1, 3)).reshape(-1, 3))


def where(scene: str, size: tuple[int, int]) -> Any:
    """Which blocks the material covers: those that change between a black and a white material."""
    shots = []
    for albedo in (0.0, 1.0):
        paint = {"type": "diffuse", "reflectance": {"type": "uniform", "value": albedo}}
        shots.append(blocks(picture(paint, scene, size, 16).xyz)[:, 1])
    change = shots[1] - shots[0]
    return change > 0.3 * np.percentile(change, 95)


def difference(a: Any, b: Any, on: Any) -> float:
    """Median CIEDE2000 of two pictures over the object's body: its blocks without the brightest tenth of either."""
    one, other = blocks(a.xyz)[on], blocks(b.xyz)[on]
    body = (one[:, 1] <= np.percentile(one[:, 1], 90)) & (other[:, 1] <= np.percentile(other[:, 1], 90))
    return float(np.median(delta_e_2000(xyz_to_lab(one[body]), xyz_to_lab(other[body]))))


def sheet(rows: list[list[tuple[str, Any]]], width: float) -> Any:
    """A page of captioned pictures."""
    from matplotlib import pyplot

    shapes = [max(shot.srgb8.shape[0] / shot.srgb8.shape[1] for _, shot in line) for line in rows]
    heights = [width * shape / len(line) + 0.3 for shape, line in zip(shapes, rows, strict=True)]
    page = pyplot.figure(figsize=(width, sum(heights)), constrained_layout=True)
    for band, line in zip(np.atleast_1d(page.subfigures(len(rows), 1, height_ratios=heights)), rows, strict=True):
        for axis, (title, shot) in zip(np.atleast_1d(band.subplots(1, len(line))), line, strict=True):
            axis.imshow(shot.srgb8)
            axis.set_title(title, fontsize=7)
            axis.set_axis_off()
    return page
