"""The trends that Guillen et al. 2020, section 6, state for pearls, over their parameters: figures 9, 10 and 12.

Material C1: flakes of 80 nm silica (C2: 560 +- 179 nm of mica) under titania, in 150 um of PET of roughness 0.01, over
a diffuse base of albedo 0.7. Values are of the noise-free form, baked at a fraction of its effort;
the interface's own mirror light is left out by looking beside it. The figure's caption gives a deviation of the normals
of 0.01, the text 0.1. At 0.1 flakes send light far from the mirror direction too, and most of the statements were seen
to fail there; they are tested at 0.01, and for larger deviations where the source draws those.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot

from nacre.light import xyz_to_xyy
from validation._pearl import (
    Array,
    baked,
    chroma,
    energy_balance,
    hue_distance,
    in_both_balances,
    seen,
    track,
    with_balance,
)
from validation._rows import row

EFFORT = 0.12
SUBSTRATES: dict[str, dict[str, Any]] = {
    "C1": {"material": "SiO2", "thickness_nm": 80},
    "C2": {"material": "mica", "thickness_nm": 560.44, "deviation_nm": 179.32},
}
COATINGS_NM = tuple(range(50, 151, 10))
DENSITIES = (0.01, 0.03, 0.066, 0.1, 0.165)
DEVIATIONS = (0.01, 0.03, 0.1, 0.2)
FLAT = 0.01
GLOSS_DEG, DIFFUSE_DEG = (2.5, 10.0), (40.0, 10.0)  # (theta_h, theta_d)
COMPLEMENTARY_DEG = 60.0  # within which of 180 degrees two hues count as complementary

WHY = {
    "diffuse: saturation rises with density at deviation 0.01, 60 nm (10e)": "false: the body is most saturated at the "
    "lowest density in both balances, and 60 nm is nearly neutral beyond",
    "the deviation has little effect on diffuse luminance, up to 0.1 (10f, 10g)": "false: at 0.1 the flakes' own lobe "
    "reaches the diffuse direction, in either balance by more than twice the 15 %",
}


def pearl(kind: str, coating_nm: float, density: float, deviation: float) -> Any:
    """The baked lobe of a material, its flakes counted as they are now."""
    return _pearl(kind, coating_nm, density, deviation, energy_balance())


@functools.cache
def _pearl(kind: str, coating_nm: float, density: float, deviation: float, _balance: str) -> Any:
    flake = {
        "volume_fraction": density,
        "substrate": SUBSTRATES[kind],
        "coatings": [{"material": "TiO2", "thickness_nm": coating_nm}],
        "normal_deviation": deviation,
    }
    stratum = {"resin": {"n": 1.575}, "thickness_um": 150, "roughness": 0.01, "platelets": [flake]}
    return baked({"family": "pearl", "strata": [stratum], "base": {"albedo": 0.7}}, EFFORT)


def gloss(*key: Any) -> Array:
    """XYZ near the mirror direction, near normal incidence."""
    return seen(pearl(*key), *GLOSS_DEG)


def diffuse(*key: Any) -> Array:
    """XYZ far from the mirror direction."""
    return seen(pearl(*key), *DIFFUSE_DEG)


def falling(values: Array) -> bool:
    """Whether a curve never rises by more than 2 % of its range (the bakes' own noise)."""
    return bool(np.all(np.diff(values) <= 0.02 * (values.max() - values.min())))


def trends(figure: str) -> list[dict[str, Any]]:
    """Test what the source says."""
    rows = []
    for kind in SUBSTRATES:
        apart = np.array([hue_distance(gloss(kind, c, 0.03, FLAT), diffuse(kind, c, 0.03, FLAT)) for c in COATINGS_NM])
        share = float(np.mean(apart > 180.0 - COMPLEMENTARY_DEG))
        rows.append(row(f"{kind}: gloss and diffuse hues are roughly complementary over the coating (10c)",
                        f"within {COMPLEMENTARY_DEG:g} degrees of opposite",
                        f"{share:.0%} of {len(COATINGS_NM)} coatings, {apart.min():.0f}-{apart.max():.0f} degrees",
                        share >= 0.8, figure))  # fmt: skip
    for name, look in (("gloss", gloss), ("diffuse", diffuse)):
        values = np.array([chroma(look("C1", 100, 0.03, s)) for s in DEVIATIONS])
        rows.append(row(f"{name}: less saturated as the normals spread (10d)", "falls",
                        "C* at L* 50: " + ", ".join(f"{v:.0f}" for v in values), falling(values), figure))  # fmt: skip
    for coating in (60, 100):
        values = np.array([chroma(diffuse("C1", coating, c, FLAT)) for c in DENSITIES])
        rows.append(row(f"diffuse: saturation rises with density at deviation 0.01, {coating} nm (10e)", "rises",
                        "C* at L* 50: " + ", ".join(f"{v:.0f}" for v in values), falling(-values), figure))  # fmt: skip
    values = np.array([chroma(gloss("C1", 100, c, FLAT)) for c in DENSITIES])
    others = np.array([chroma(diffuse("C1", 100, c, FLAT)) for c in DENSITIES])
    rows.append(row("density moves the diffuse saturation, hardly the gloss (10e)", "gloss moves at most half as much",
                    f"gloss {np.ptp(values):.0f}, diffuse {np.ptp(others):.0f}", np.ptp(values) <= 0.5 * np.ptp(others),
                    figure))  # fmt: skip
    for deviation in (FLAT, 0.1):
        values = np.array([diffuse("C1", 100, c, deviation)[1] for c in DENSITIES])
        rows.append(row(f"diffuse luminance falls with density, deviation {deviation:g} (10f)", "falls",
                        ", ".join(f"{v:.2f}" for v in values), falling(values), figure))  # fmt: skip
    values = np.array([diffuse("C1", 100, 0.03, s)[1] for s in (FLAT, 0.03, 0.1)])
    change = float(np.ptp(values) / values.mean())
    rows.append(row("the deviation has little effect on diffuse luminance, up to 0.1 (10f, 10g)", "below 15 %",
                    f"{change:.0%}", change < 0.15, figure))  # fmt: skip
    for density in (0.03, 0.1):
        values = np.array([diffuse("C1", c, density, FLAT)[1] for c in COATINGS_NM])
        best = COATINGS_NM[int(np.argmax(values))]
        rows.append(row(f"diffuse luminance is highest at coatings of 100-130 nm, density {density:g} (10g, 10h)",
                        "100-130 nm", f"{best} nm", 100 <= best <= 130, figure))  # fmt: skip
        mirror = np.array([gloss("C1", c, density, FLAT)[1] for c in COATINGS_NM])
        together = float(np.corrcoef(values, mirror)[0, 1])
        rows.append(row(f"gloss luminance behaves complementarily, density {density:g} (10i)", "correlation below -0.8",
                        f"{together:.2f}", together < -0.8, figure))  # fmt: skip
    tracks = [np.array([xyz_to_xyy(look(kind, c, 0.03, FLAT))[:2] for c in COATINGS_NM])
              for kind in SUBSTRATES for look in (gloss, diffuse)]  # fmt: skip
    shift = np.linalg.norm(tracks[0] - tracks[2], axis=-1).max()
    rows.append(row("silica against mica: another manifold of gloss colours (12)", "xy apart by more than 0.05",
                    f"up to {shift:.2f}", shift > 0.05, figure))  # fmt: skip
    return rows


def draw(figure: Path) -> None:
    """Draw the panels of figures 9, 10 and 12."""
    page, axes = pyplot.subplots(3, 4, figsize=(17, 12.5))
    for axis, coating in zip(axes[0, :3], (60, 100, 140)):
        half, difference = np.meshgrid(np.linspace(0.5, 85, 60), np.linspace(0.5, 85, 60))
        lobe = pearl("C1", coating, 0.03, FLAT)
        values = np.concatenate([seen(lobe, h, d)[None] for h, d in zip(half, difference)])
        rgb = np.asarray(spectrum_rgb(values))
        axis.imshow(rgb, origin="lower", extent=(0, 85, 0, 85))
        axis.set(title=f"C1, {coating} nm: image slice", xlabel="theta_h (deg)", ylabel="theta_d (deg)")
    plain = axes[0, 3]
    for kind, style in (("C1", "-"), ("C2", "--")):
        for look, name, colour in ((gloss, "gloss", "0.55"), (diffuse, "diffuse", "black")):
            keys = [(kind, c, 0.03, FLAT) for c in COATINGS_NM]
            track(plain, [look(*key) for key in keys], style, f"{name}, {kind}", colour)
    plain.set_title("coating 50 to 150 nm: 10c, 12")
    fan = axes[1, 0]
    for angle in (10.0, 30.0, 50.0):
        track(
            fan, [seen(pearl("C1", c, 0.03, FLAT), 4.0, angle) for c in COATINGS_NM], "-", f"theta_d {angle:g}", "0.55"
        )
    fan.set_title("gloss over the coating: 10b")
    fan = axes[1, 1]
    for angle in (30.0, 45.0, 60.0):
        track(fan, [seen(pearl("C1", c, 0.03, FLAT), angle, 10.0) for c in COATINGS_NM], "-", f"theta_h {angle:g}", "0")
    fan.set_title("diffuse over the coating: 10a")
    for axis, keys, title in (
        (axes[1, 2], [("C1", 100, 0.03, s) for s in DEVIATIONS], "deviation .01 to .2: 10d"),
        (axes[1, 3], [("C1", 100, c, FLAT) for c in DENSITIES], "density 1 to 16.5 %: 10e"),
    ):
        track(axis, [gloss(*key) for key in keys], "-", "gloss", "0.55")
        track(axis, [diffuse(*key) for key in keys], "-", "diffuse", "black")
        axis.set_title(title)
    for axis, look, title in (
        (axes[2, 0], diffuse, "diffuse luminance: 10f"),
        (axes[2, 3], gloss, "gloss luminance: 10i"),
    ):
        if look is diffuse:
            for deviation in (FLAT, 0.1):
                axis.plot(
                    DENSITIES, [look("C1", 100, c, deviation)[1] for c in DENSITIES], label=f"deviation {deviation:g}"
                )
            axis.set_xlabel("density")
        else:
            for density in (0.03, 0.1):
                axis.plot(
                    COATINGS_NM, [look("C1", c, density, FLAT)[1] for c in COATINGS_NM], label=f"density {density:g}"
                )
            axis.set_xlabel("coating (nm)")
        axis.set_title(title)
        axis.legend(frameon=False)
    for deviation in (FLAT, 0.1):
        values = [diffuse("C1", c, 0.03, deviation)[1] for c in COATINGS_NM[::2]]
        axes[2, 1].plot(COATINGS_NM[::2], values, label=f"deviation {deviation:g}")
    for density in (0.03, 0.1):
        values = [diffuse("C1", c, density, FLAT)[1] for c in COATINGS_NM]
        axes[2, 2].plot(COATINGS_NM, values, label=f"density {density:g}")
    for axis, title in ((axes[2, 1], "diffuse luminance: 10g"), (axes[2, 2], "diffuse luminance: 10h")):
        axis.set(title=title, xlabel="coating (nm)")
        axis.legend(frameon=False)
    page.tight_layout()
    page.savefig(figure, dpi=90)
    pyplot.close(page)


def spectrum_rgb(xyz: Array) -> Array:
    """sRGB of a slice, its brightest hundredth at white."""
    from nacre.light import clip_to_srgb, srgb_encode, xyz_to_srgb_linear

    scale = 1.0 / np.percentile(xyz[..., 1], 92)
    return np.asarray(srgb_encode(np.clip(clip_to_srgb(xyz_to_srgb_linear(xyz * scale)).rgb, 0.0, 1.0)))


def main(out_dir: Path) -> list[dict[str, Any]]:
    """Test the trends, draw the panels, return the rows."""
    out_dir = Path(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    figure = out_dir / "pearl_trends.png"
    rows = in_both_balances(lambda: trends(figure.name), WHY)
    with with_balance("published"):  # the source's figures use its balance
        draw(figure)
    return rows


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
