"""Pictures of pearls: the nine bottles and three cars, the parameter matrix, the spread of thickness.

After figures 1, 5, 11 and 14 of Guillen et al. 2020, on shapes and under lights of our own, so that statements are
compared, not pictures. One stratum of upright flakes over a diffuse base is shown by its noise-free form
(`nacre.pearl.fast`, at a fraction of its effort), the cars by the walk; nothing is denoised. Colours of objects are
means over blocks of their pixels. Figure 5 prints neither density nor spread of the normals; ours stand below.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import nacre
from nacre.bsdf import Bsdf
from nacre.light import delta_e_2000, xyz_to_lab
from validation._pearl import EXAMPLES, GRID_NM, Array, baked, hue_distance, lab_at_50, seen
from validation._rows import finish, row

EFFORT = 0.06
SPREAD_EFFORT = 0.15  # where the chroma is small, so that noise does not decide
KNOB, LARGE_KNOB, BOTTLE, CAR = (128, 128), (208, 208), (144, 180), (240, 136)
SPP, WALK_SPP = 49, 144
BLOCK = 6
DENSITIES, COATINGS_NM = (0.033, 0.099, 0.165), (60, 85, 110, 130)
SUBSTRATES: dict[str, dict[str, Any]] = {
    "silica": {"material": "SiO2", "thickness_nm": 80},
    "mica": {"material": "mica", "thickness_nm": 560.44, "deviation_nm": 179.32},
}
# bounds of the rows, set from the words before any value was seen
LARGE = 5.0  # CIEDE2000 of a change that is called large, or vast
SHARE = 0.8  # of the cases in which a trend must hold


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


def still(recipe: Any) -> Bsdf:
    """The noise-free form as a Bsdf."""
    return Bsdf((baked(recipe, EFFORT),), {})


def walked(recipe: Any) -> Bsdf:
    """The walk's Bsdf, at 10 nm."""
    material = nacre.load(recipe) if isinstance(recipe, Path) else nacre.material(recipe)
    return material.bsdf(GRID_NM)


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
    """Median CIEDE2000 of two pictures over the object's blocks."""
    return float(np.median(delta_e_2000(xyz_to_lab(blocks(a.xyz)[on]), xyz_to_lab(blocks(b.xyz)[on]))))


def body_colour(shot: Any, on: Any) -> Array:
    """Mean XYZ of the object without its brightest tenth, the highlights."""
    found = blocks(shot.xyz)[on]
    return np.asarray(found[found[:, 1] <= np.percentile(found[:, 1], 90)].mean(axis=0))


def along(xyz: Array, gloss: Array) -> float:
    """How much of a colour's chroma at L* 50 lies along the hue of another."""
    one, other = lab_at_50(xyz)[1:], lab_at_50(gloss)[1:]
    return float(one @ other / max(float(np.linalg.norm(other)), 1e-9))


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


def contact_sheet(out: Path) -> list[dict[str, Any]]:
    """The nine bottles and three cars, and three of the pearls on the knob."""
    figure = "pearl_bottles_and_cars.png"
    shots, knobs = [], []
    for number in range(1, 10):
        bsdf = still(EXAMPLES / f"bottle{number}.toml")
        shots.append((f"bottle {number}", picture(bsdf, "bottle", BOTTLE)))
        if number in (3, 5, 9):
            knobs.append((f"bottle {number}'s pearl", picture(bsdf, "knob", LARGE_KNOB)))
    cars = []
    for name in ("front", "middle", "back"):
        shot = picture(walked(EXAMPLES / f"car_{name}.toml"), "body", CAR, WALK_SPP, exposure=0.8)
        cars.append((f"{name} car", shot))
    finish(sheet([shots, cars, knobs], 14.0), out, figure, dpi=110)
    on = where("bottle", BOTTLE)
    rows = []
    for what, a in (("density", 1), ("substrate", 3), ("deviation of the normals", 5), ("spread of thickness", 7)):
        change = difference(shots[a - 1][1], shots[a][1], on)
        rows.append(row(f"bottles {a} and {a + 1}: one parameter, {what}, changes the look a lot (fig. 1)",
                        f"median dE00 above {LARGE:g}", f"{change:.1f}", change > LARGE, figure))  # fmt: skip
    return rows


def matrix(out: Path) -> list[dict[str, Any]]:
    """Density against coating, silica and mica (figure 11)."""
    figure = "pearl_matrix.png"
    tiles: dict[tuple[str, float, int], Any] = {}
    gloss: dict[tuple[str, int], Array] = {}
    for kind, substrate in SUBSTRATES.items():
        for density in DENSITIES:
            for coating in COATINGS_NM:
                lobe = baked(c1(density, coating, substrate), EFFORT)
                tiles[kind, density, coating] = picture(Bsdf((lobe,), {}), "knob", KNOB)
                gloss[kind, coating] = seen(lobe, 4.0, 10.0)
    page = sheet(
        [[(f"{kind}, {density:.1%}, {coating} nm", tiles[kind, density, coating]) for coating in COATINGS_NM]
         for kind in SUBSTRATES for density in reversed(DENSITIES)], 7.0)  # fmt: skip
    finish(page, out, figure, dpi=110)
    on = where("knob", KNOB)
    mean = {key: body_colour(shot, on) for key, shot in tiles.items()}
    rows = []
    for kind in SUBSTRATES:
        ab = np.array([lab_at_50(mean[kind, DENSITIES[0], coating])[1:] for coating in COATINGS_NM])
        far = float(np.linalg.norm(ab[:, None] - ab[None], axis=-1).max())
        rows.append(row(f"{kind}: the coating's thickness changes the chromaticity strongly (fig. 11)",
                        "mean a*b* at L* 50 apart by more than 10", f"up to {far:.0f}", far > 10, figure))  # fmt: skip
        low, high = DENSITIES[0], DENSITIES[-1]
        darker = [mean[kind, high, c][1] < mean[kind, low, c][1] for c in COATINGS_NM]
        rows.append(row(f"{kind}: the body gets darker with density (sec. 6.3)", f"in {SHARE:.0%} of the coatings",
                        f"{sum(darker)} of {len(darker)}; Y at {low:.1%} and {high:.1%}: " + ", ".join(
                            f"{mean[kind, low, c][1]:.2f} {mean[kind, high, c][1]:.2f}" for c in COATINGS_NM),
                        np.mean(darker) >= SHARE, figure))  # fmt: skip
        nearer = [hue_distance(mean[kind, high, c], gloss[kind, c]) < hue_distance(mean[kind, low, c], gloss[kind, c])
                  for c in COATINGS_NM]  # fmt: skip
        rows.append(row(f"{kind}: the gloss's hue takes over as density rises (sec. 6.3)",
                        f"hue nearer to the gloss's in {SHARE:.0%} of the coatings",
                        f"{sum(nearer)} of {len(nearer)}; C* along the gloss's hue: " + ", ".join(
                            f"{along(mean[kind, low, c], gloss[kind, c]):.0f} -> "
                            f"{along(mean[kind, high, c], gloss[kind, c]):.0f}" for c in COATINGS_NM),
                        np.mean(nearer) >= SHARE, figure))  # fmt: skip
    apart = [difference(tiles["silica", d, c], tiles["mica", d, c], on) for d in DENSITIES for c in COATINGS_NM]
    rows.append(row("silica against mica: vastly different looks (figs. 11, 12)",
                    f"median dE00 above {LARGE:g} in {SHARE:.0%} of the pairs",
                    f"{np.mean(np.array(apart) > LARGE):.0%}, median {np.median(apart):.1f}",
                    float(np.mean(np.array(apart) > LARGE)) >= SHARE, figure))  # fmt: skip
    return rows


def spread(out: Path) -> list[dict[str, Any]]:
    """Mica of 500 nm under 60 nm of titania, thickness deviation 0, 50, 100 nm (figure 5); 6.6 %, deviation 0.05."""
    figure = "pearl_thickness_spread.png"
    line, colours = [], []
    on = where("knob", KNOB)
    for deviation in (0, 50, 100):
        mica = {"material": "mica", "thickness_nm": 500, "deviation_nm": deviation}
        lobe = baked(c1(0.066, 60, mica, normal_deviation=0.05), SPREAD_EFFORT)
        shot = picture(Bsdf((lobe,), {}), "knob", KNOB, 4 * SPP)
        line.append((f"deviation {deviation} nm", shot))
        lab = lab_at_50(np.maximum(blocks(shot.xyz)[on], 1e-6))
        colours.append(float(np.median(np.hypot(lab[:, 1], lab[:, 2]))))
    finish(sheet([line], 6.0), out, figure, dpi=120)
    return [row("thickness deviation 0, 50, 100 nm: interference is attenuated (fig. 5)", "chroma falls",
                "median C* at L* 50: " + ", ".join(f"{c:.2f}" for c in colours),
                colours[0] > colours[1] > colours[2], figure)]  # fmt: skip


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Render all sheets; return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    out = Path(out_dir)
    return [line for part in (contact_sheet, matrix, spread) for line in part(out)]


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
