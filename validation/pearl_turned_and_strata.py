"""Pictures of pearls that only the walk can make: turned and anisotropic flakes, two strata, a foil without base.

Turned flakes after figure 13 of Guillen et al. 2020, which prints neither coating nor density: C1 with 100 nm and 2 %
here. Strata and foil are ours: the source allows several strata and shows none.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import nacre
from nacre.bsdf import Bsdf
from nacre.light import spectrum_to_xyz
from nacre.measure.evaluate import bsdf_spectrum
from validation._pearl import EXAMPLES, GRID_NM, hue_distance
from validation._pearl_pictures import BOTTLE, SUBSTRATES, WALK_SPP, c1, difference, picture, sheet, traced, where
from validation._rows import finish, row

SIZE = (128, 128)
TURNS_DEG = (0, 5, 10)
THIN = 0.02  # density of the turned flakes
OFFSET_DEG = 5.0  # of an angle that is called visible


def turned(out: Path) -> list[dict[str, Any]]:
    """Flakes turned about x, isotropic and anisotropic (figure 13): C1, 100 nm, density 2 %."""
    figure = "pearl_turned_flakes.png"
    lines, peaks = [], []
    for name, deviation in (("isotropic", 0.1), ("anisotropic x", [0.2, 0.03])):
        line = []
        for angle in TURNS_DEG:
            flake = {"normal_deviation": deviation, "rotation_deg": [angle, 0, 0]}
            bsdf = traced(c1(THIN, 100, SUBSTRATES["silica"], **flake))
            line.append((f"{name}, {angle} deg", picture(bsdf, "knob", SIZE, WALK_SPP)))
            if name == "isotropic":
                peaks.append(lobe_peak_deg(bsdf))
        lines.append(line)
    flake = {"normal_deviation": [0.03, 0.2]}
    last = traced(c1(THIN, 100, SUBSTRATES["silica"], **flake))
    lines[0].append(("anisotropic y, 0 deg", picture(last, "knob", SIZE, WALK_SPP)))
    sphere = traced(c1(THIN, 100, SUBSTRATES["silica"], rotation_deg=[10, 0, 0]))
    lines[1].append(("isotropic, 10 deg, sphere", picture(sphere, "sphere", SIZE, WALK_SPP)))
    finish(sheet(lines, 9.5), out, figure, dpi=120)
    moved = [abs(peak - peaks[0]) for peak in peaks]
    text = ", ".join(f"{angle} deg: {shift:.0f}" for angle, shift in zip(TURNS_DEG[1:], moved[1:], strict=True))
    return [row("slight rotations set the flakes' gloss visibly apart from the container's highlight (fig. 13)",
                f"by more than {OFFSET_DEG:g} degrees from a turn of 5 on", text, moved[1] > OFFSET_DEG,
                figure)]  # fmt: skip


def lobe_peak_deg(bsdf: Bsdf) -> float:
    """Exit angle, in the plane of the turn, of most light for incidence along the normal; the mirror is left out."""
    theta = np.radians(np.arange(-80.0, 80.1, 4.0))
    wo = np.stack([0 * theta, np.sin(theta), np.cos(theta)], axis=-1)
    from nacre.device.walk.arrays import evaluate_layered

    lobe = bsdf.lobes[0]
    wi = np.broadcast_to([0.0, 0.0, 1.0], wo.shape)
    luminance = spectrum_to_xyz(evaluate_layered(lobe, wi, wo, samples=512)[0], lobe.wavelengths_nm)[:, 1]
    luminance[np.abs(np.degrees(theta)) < 3.0] = 0.0  # roughness 0.01: the interface's own lobe is here
    return float(np.degrees(theta[np.argmax(luminance)]))


def strata_and_foil(out: Path) -> list[dict[str, Any]]:
    """Two pearlescent strata over each other, each alone, and a foil seen from before and through."""
    figure = "pearl_strata_and_foil.png"
    both = nacre.load(EXAMPLES / "two_strata.toml")
    data = dict(both.data)
    line, on = [], where("knob", SIZE)
    for name, strata in (("both strata", [0, 1]), ("upper alone", [0]), ("lower alone", [1])):
        bsdf = traced({**data, "strata": [data["strata"][i] for i in strata]})
        line.append((name, picture(bsdf, "knob", SIZE, WALK_SPP)))
    foil = nacre.load(EXAMPLES / "foil.toml").bsdf(GRID_NM)
    bottle = picture(foil, "bottle", BOTTLE, WALK_SPP, exposure=1.5)
    finish(sheet([[*line, ("foil as a bottle, no base", bottle)]], 8.0), out, figure, dpi=120)
    change = min(difference(line[0][1], other, on) for _, other in line[1:])
    found = bsdf_spectrum(foil, np.radians([30.0]))
    parts = [getattr(found, f"diffuse_{name}")[0] for name in ("reflectance", "transmittance")]
    xyz = [spectrum_to_xyz(part, foil.wavelengths_nm) for part in parts]
    apart = float(hue_distance(*xyz))
    lost = float(np.abs(1 - parts[0] - parts[1]).mean())  # all interfaces are rough: there is no delta part
    return [
        row("two pearlescent strata look like neither alone", "median dE00 above 2 from each", f"{change:.1f}",
            change > 2, figure),
        row("foil: transmitted light has the complementary hue (clear flakes, sec. 4.2)",
            "within 60 degrees of opposite",
            f"{apart:.0f} degrees apart; R {xyz[0][1]:.2f}, T {xyz[1][1]:.2f}", apart > 120, figure),
        row("foil of clear flakes: light that is not reflected passes", "R + T = 1 within 2 %",
            f"mean |1 - R - T| {lost:.3f} (rough faces uncompensated)", lost < 0.02, figure),
    ]  # fmt: skip


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Render both sheets; return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    out = Path(out_dir)
    return [*turned(out), *strata_and_foil(out)]


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
