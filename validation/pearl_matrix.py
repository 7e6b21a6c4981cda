"""Pictures of pearls over their parameters: density against coating, silica and mica; the spread of thickness.

After figures 5 and 11 of Guillen et al. 2020, by the noise-free form (`nacre.families.pearl.tables`, at a fraction of
its effort), on a knob of our own; nothing is denoised. Figure 5 prints neither density nor spread of the normals;
ours stand below.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from validation._pearl import Array, baked, hue_distance, in_both_balances, lab_at_50, material_of, seen
from validation._pearl_pictures import (
    EFFORT,
    KNOB,
    LARGE,
    SPP,
    SUBSTRATES,
    blocks,
    c1,
    difference,
    picture,
    sheet,
    where,
)
from validation._rows import finish, row

DENSITIES, COATINGS_NM = (0.033, 0.099, 0.165), (60, 85, 110, 130)
SPREAD_EFFORT = 0.15  # where the chroma is small, so that noise does not decide
SHARE = 0.75  # of the cases in which a trend must hold: three of four coatings
SPREADS_NM, FRINGES_NM = (0.0, 50.0, 100.0), np.arange(400.0, 701.0, 2.0)
INCOHERENT_NM = 2000.0  # a deviation that no fringe survives
HALF = 0.5  # fringes that fall below half of what they were are attenuated, not merely not stronger


WHY: dict[str, str] = {}  # claim -> verdict, where neither balance holds and "false" says too little


def body_colour(shot: Any, on: Any) -> Array:
    """Mean XYZ of the object without its brightest tenth, the highlights."""
    found = blocks(shot.xyz)[on]
    return np.asarray(found[found[:, 1] <= np.percentile(found[:, 1], 90)].mean(axis=0))


def along(xyz: Array, gloss: Array) -> float:
    """How much of a colour's chroma at L* 50 lies along the hue of another."""
    one, other = lab_at_50(xyz)[1:], lab_at_50(gloss)[1:]
    return float(one @ other / max(float(np.linalg.norm(other)), 1e-9))


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
    """Mica of 500 nm under 60 nm of titania, thickness deviation 0, 50, 100 nm (figure 5); 6.6 %, deviation 0.05.

    Chroma cannot show the contrast of fringes, which are finer than the eye's curves: R over the wavelengths can.
    """
    figure = "pearl_thickness_spread.png"
    line, curves = [], []
    for deviation in (*SPREADS_NM, INCOHERENT_NM):
        mica = {"material": "mica", "thickness_nm": 500, "deviation_nm": deviation}
        if deviation == INCOHERENT_NM:
            mica = {"material": "mica", "thickness_nm": 1e5, "deviation_nm": deviation}
        recipe = c1(0.066, 60, mica, normal_deviation=0.05)
        data = material_of(recipe).figure_data("platelet", wavelengths_nm=FRINGES_NM, angles_deg=np.zeros(1))
        curves.append(data["reflectance"][0, 0])
        if deviation != INCOHERENT_NM:
            lobe = baked(recipe, SPREAD_EFFORT)
            line.append((f"deviation {deviation:g} nm", picture(Bsdf((lobe,), {}), "knob", KNOB, 4 * SPP)))
    finish(sheet([line], 6.0), out, figure, dpi=120)
    rms = [float(np.sqrt(np.mean((curve - curves[-1]) ** 2))) for curve in curves[:-1]]
    return [row("thickness deviation 0, 50, 100 nm: interference is attenuated (fig. 5)",
                f"fringes of the flake's R about its incoherent one: each rms below {HALF:g} of the last",
                ", ".join(f"{value:.3f}" for value in rms), rms[1] < HALF * rms[0] and rms[2] < HALF * rms[1],
                figure)]  # fmt: skip


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Render both sheets; return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    out = Path(out_dir)
    # the figures left are of the second energy_balance, the source's
    return in_both_balances(lambda: [*matrix(out), *spread(out)], WHY)


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
