"""Single platelets: the seven of Guillen et al. 2020, figures 3 to 5; their equations are not used."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot

from nacre.core.arrays import Array
from nacre.families.pearl.platelet import Coating, Platelet, platelet_response
from nacre.families.pearl.thickness import Thickness
from nacre.light import spectrum_to_srgb, spectrum_to_xyz, xyz_to_lab
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec

LAM = np.arange(360.0, 831.0, 5.0)
ANGLES = np.linspace(0.0, 90.0, 91)
COATINGS_NM = (60.0, 100.0, 140.0)


def constant(n: float, k: float = 0.0) -> OpticalConstant:
    """An index without dispersion, as the source gives for absorbers and resins."""
    return IndexSpec.model_validate({"n": n, "k": k}).build()


def abbe(n_d: float, number: float) -> OpticalConstant:
    """An index with the source's Abbe number."""
    return IndexSpec.model_validate({"n_d": n_d, "abbe": number}).build()


MICA, SIO2, TIO2 = abbe(1.6137, 54.56), abbe(1.4585, 67.82), abbe(2.6142, 9.87)
IRON, ALUMINIUM = constant(3.3206, 0.2192), constant(1.1978, 7.0488)
AIR, PET, POLYURETHANE = constant(1.0), constant(1.575), abbe(1.565, 24.37)


def seven(coating_nm: float) -> dict[str, tuple[Platelet, OpticalConstant]]:
    """The source's platelets at one thickness of titania."""
    titania = Coating(TIO2, Thickness(coating_nm))
    iron = Coating(IRON, Thickness(20.0))
    return {
        "TiO2, air": (Platelet(TIO2, Thickness(coating_nm)), AIR),
        "TiO2/mica, air": (Platelet(MICA, Thickness(500.0), (titania,)), AIR),
        "TiO2/mica, PET": (Platelet(MICA, Thickness(500.0), (titania,)), PET),
        "TiO2/SiO2, air": (Platelet(SIO2, Thickness(80.0), (titania,)), AIR),
        "TiO2/SiO2, PET": (Platelet(SIO2, Thickness(80.0), (titania,)), PET),
        "TiO2/Al, PU": (Platelet(ALUMINIUM, Thickness(80.0), (titania,)), POLYURETHANE),
        "TiO2/Fe2O3/mica, PET": (Platelet(MICA, Thickness(500.0), (titania, iron)), PET),
    }


def solve(platelet: Platelet, resin: OpticalConstant) -> tuple[Array, Array]:
    """R and T over (angle, wavelength)."""
    cos = np.cos(np.radians(ANGLES))
    cos[-1] = 0.0
    return platelet_response(platelet, resin.n_complex(LAM).real, cos, LAM).unpolarised()


def lab(values: Array) -> Array:
    """CIELAB of spectra under D65."""
    return np.asarray(xyz_to_lab(spectrum_to_xyz(values, LAM)))


def row(claim: str, claimed: str, ours: str, holds: bool, figure: str) -> dict[str, Any]:
    """One line of the report."""
    verdict = "holds" if holds else "DOES NOT HOLD"
    print(f"{claim}: {claimed} | {ours} | {verdict}", flush=True)
    return {"claim": claim, "claimed": claimed, "ours": ours, "verdict": verdict, "figure": figure}


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Solve all platelets, draw curves and ribbons, and compare them with the statements of the source."""
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    figure = "pearl_platelets.png"
    solved = {t: {name: solve(*pair) for name, pair in seven(t).items()} for t in COATINGS_NM}
    rows = []
    clear = [n for n in solved[60.0] if "Al" not in n and "Fe" not in n]
    worst = max(float(np.abs(1 - r - t).max()) for t_nm in COATINGS_NM for r, t in (solved[t_nm][n] for n in clear))
    rows.append(row("transparent platelets: T mirrors R (R + T = 1)", "0", f"{worst:.1e}", worst < 1e-9, figure))
    opaque = max(float(solved[t]["TiO2/Al, PU"][1].max()) for t in COATINGS_NM)
    rows.append(row("aluminium platelets are opaque, largest T", "0", f"{opaque:.1e}", opaque < 1e-3, figure))
    iron_name = "TiO2/Fe2O3/mica, PET"
    lost = float(max((1 - r - t)[:60].max() for r, t in (solved[x][iron_name] for x in COATINGS_NM)))
    rows.append(row("iron oxide breaks the symmetry of R and T (largest A)", "> 0", f"{lost:.2f}", lost > 0.05, figure))
    for name in ("TiO2/mica, PET", "TiO2/SiO2, PET"):
        colours = [lab(solved[t][name][0][0]) for t in COATINGS_NM]
        distance = float(min(np.linalg.norm(a[1:] - b[1:]) for a, b in zip(colours[:-1], colours[1:], strict=True)))
        claim = f"{name}: the coating's thickness changes the colour (least step in a*b*)"
        rows.append(row(claim, "large", f"{distance:.0f}", distance > 10, figure))
    in_air, in_pet = (lab(solved[60.0][n][0][0]) for n in ("TiO2/mica, air", "TiO2/mica, PET"))
    shift = float(np.linalg.norm(in_air - in_pet))
    rows.append(
        row("the resin changes the colour of the same platelet (dE76)", "visible", f"{shift:.0f}", shift > 2, figure)
    )
    substrate = {}
    for tau in (400.0, 500.0, 600.0):
        substrate[tau] = solve(Platelet(MICA, Thickness(tau), (Coating(TIO2, Thickness(60.0)),)), PET)
    step = float(
        min(np.linalg.norm(lab(substrate[a][0][0]) - lab(substrate[b][0][0])) for a, b in ((400, 500), (500, 600)))
    )
    rows.append(
        row("mica of 400, 500, 600 nm looks different (least dE76)", "visible", f"{step:.0f}", step > 2, figure)
    )
    chroma = []
    for deviation in (0.0, 50.0, 100.0):
        flake = Platelet(MICA, Thickness(500.0, deviation), (Coating(TIO2, Thickness(60.0)),))
        chroma.append(float(np.linalg.norm(lab(solve(flake, PET)[0][0])[1:])))
    falls = max(chroma[1:]) < chroma[0]
    text = " -> ".join(f"{c:.0f}" for c in chroma)
    rows.append(
        row("thickness spread 50 and 100 nm lower the chroma of one thickness (0)", "falls", text, falls, figure)
    )

    fig, axes = pyplot.subplots(9, 7, figsize=(12, 10), constrained_layout=True, height_ratios=[3, 1, 1] * 3)
    ten = np.linspace(0, len(LAM) - 1, 10).astype(int)
    for i, thickness in enumerate(COATINGS_NM):
        for j, name in enumerate(solved[thickness]):
            reflect, transmit = solved[thickness][name]
            axis = axes[3 * i, j]
            for k in ten:
                axis.plot(ANGLES, reflect[:, k], lw=0.6, color=pyplot.colormaps["rainbow"](k / len(LAM)))
            axis.set(ylim=(0, 1), xlim=(0, 90), xticks=[], yticks=[0, 1] if j == 0 else [])
            axis.set_title(f"{name}\n{thickness:.0f} nm", fontsize=6)
            for offset, values, label in ((1, reflect, "R"), (2, transmit, "T")):
                ribbon = axes[3 * i + offset, j]
                ribbon.imshow(np.asarray(spectrum_to_srgb(values, LAM))[None], aspect="auto", extent=(0, 90, 0, 1))
                ribbon.set(yticks=[], xticks=[])
                if j == 0:
                    ribbon.set_ylabel(label, fontsize=7, rotation=0)
    fig.savefig(out / figure, dpi=130)
    pyplot.close(fig)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
