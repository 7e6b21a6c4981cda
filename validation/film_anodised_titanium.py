"""Interference colours of anodised titanium against voltage, compared with published voltage-colour charts.

Published (workshop and trade charts; they differ by several volts with electrolyte, alloy and time): as the voltage
rises from 0 to some 120 V the colour runs through yellow (bronze), purple, blue, light blue, silver, yellow (gold),
pink, violet, blue, green, yellow-green, pink; the oxide grows by about 2 nm a volt (figures from 1.6 to 2.5 are given);
often quoted are 15 V bronze, 25-30 V blue, 55 V gold, 110 V green, the one after the second blue. Red is never
reached.
Ours: amorphous TiO2 (`TiO2-film`; anodic oxide is amorphous) of 2 nm a volt on titanium, D65, normal incidence. Each
named colour is a range of CIELAB hue and chroma; a pale green that we see between silver and gold has no name in the
charts.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from nacre.light import lab_to_lch, spectrum_to_srgb, spectrum_to_xyz, xyz_to_lab
from nacre.matter import index, powers

NM_PER_VOLT, NATIVE_NM = 2.0, 2.0
# published rate of growth, nm a volt: what a colour at a charted voltage may be off by
RATES = (1.6, 2.5)
SILVER_CHROMA = 12.0
# CIELAB hue angles, degrees
NAMES = (
    ("yellow", 60.0, 105.0),
    ("green", 105.0, 200.0),
    ("blue", 200.0, 295.0),
    ("purple", 295.0, 345.0),
    ("pink", 345.0, 420.0),
)
SEQUENCE = ["yellow", "purple", "blue", "silver", "yellow", "pink", "purple", "blue", "green", "yellow", "pink"]
CHART = {
    "yellow (bronze)": (15.0, "yellow", 0),
    "blue": (27.0, "blue", 0),
    "yellow (gold)": (55.0, "yellow", 1),
    "green (second order)": (110.0, "green", 1),
}


def name_of(lch: np.ndarray) -> str:
    """Name of a colour; a pale one is silver."""
    if lch[1] < SILVER_CHROMA:
        return "silver"
    for name, low, high in NAMES:
        if low <= lch[2] < high or low <= lch[2] + 360.0 < high:
            return name
    raise AssertionError("the hue ranges leave no gap")


def runs(names: list[str], values: np.ndarray) -> list[tuple[str, float, float]]:
    """Group equal neighbours: (name, first value, last value)."""
    found: list[tuple[str, float, float]] = []
    for name, value in zip(names, values):
        if found and found[-1][0] == name:
            found[-1] = (name, found[-1][1], float(value))
        else:
            found.append((name, float(value), float(value)))
    return found


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    figure = "film_anodised_titanium.png"
    lam = np.arange(380.0, 781.0, 5.0)
    volts = np.arange(0.0, 131.0, 0.5)
    oxide_nm = NATIVE_NM + NM_PER_VOLT * volts
    n = np.stack([np.ones(len(lam)), index("TiO2-film").n_complex(lam), index("Ti").n_complex(lam)])
    reflectance = powers(n, oxide_nm[:, None], lam, 0.0).reflectance
    lch = lab_to_lch(xyz_to_lab(spectrum_to_xyz(reflectance, lam)))
    seen = runs([name_of(c) for c in lch], volts)
    # bare metal counts as no colour; what lasts less than 2 V is a border, not a colour of a chart
    seen = [r for r in seen if r[2] - r[1] >= 2.0]
    order = [r[0] for r in seen]
    order = order[1:] if order[0] == "silver" else order

    def kept(wanted: list[str]) -> bool:
        """Whether `wanted` appears in our order, silver being optional where a chart has only a pale blue."""
        it = iter(order)
        return all(any(name == other for other in it) for name in wanted)

    rows: list[dict[str, Any]] = [
        {
            "claim": "order of colours from 0 to 130 V",
            "claimed": ", ".join(SEQUENCE),
            "ours": ", ".join(order),
            "verdict": "agrees"
            if kept(SEQUENCE)
            else "agrees but for silver"
            if kept([s for s in SEQUENCE if s != "silver"])
            else "DISAGREES",
            "figure": figure,
        }
    ]
    for label, (volt, name, which) in CHART.items():
        low, high = [(a, b) for other, a, b in seen if other == name][which]
        # the thicknesses that the charted voltage stands for, at the published rates
        thin, thick = (NATIVE_NM + volt * rate for rate in RATES)
        ours = (NATIVE_NM + NM_PER_VOLT * low, NATIVE_NM + NM_PER_VOLT * high)
        good = thin <= ours[1] and ours[0] <= thick
        inside = low - 1 <= volt <= high + 1
        rows.append(
            {
                "claim": f"{label}: oxide at the charted {volt:g} V, {RATES[0]}-{RATES[1]} nm a volt",
                "claimed": f"{thin:.0f}-{thick:.0f} nm",
                "ours": f"{ours[0]:.0f}-{ours[1]:.0f} nm, {low:g}-{high:g} V at {NM_PER_VOLT:g} nm a volt",
                "verdict": ("agrees, also at 2 nm a volt" if inside else "agrees at another rate")
                if good
                else "DISAGREES",
                "figure": figure,
            }
        )
    reddest = lch[(lch[:, 2] > 20) & (lch[:, 2] < 50) & (lch[:, 1] > 50)]
    rows.append(
        {
            "claim": "no saturated red at any voltage (hue 20-50 degrees, chroma above 50)",
            "claimed": "none",
            "ours": f"{len(reddest)} of {len(volts)} voltages",
            "verdict": "agrees" if len(reddest) == 0 else "DISAGREES",
            "figure": figure,
        }
    )

    rgb = np.clip(spectrum_to_srgb(reflectance, lam), 0, 1)
    fig, axes = pyplot.subplots(2, 1, figsize=(7.2, 3.6), constrained_layout=True, height_ratios=(1, 2), sharex=True)
    axes[0].imshow(rgb[None], aspect="auto", extent=(volts[0], volts[-1], 0, 1))
    axes[0].set(yticks=[], title="TiO2 on Ti, 2 nm a volt, D65, normal incidence")
    for name, low, high in seen:
        axes[0].text((low + high) / 2, 0.5, name, ha="center", va="center", fontsize=6)
    image = axes[1].pcolormesh(volts, lam, reflectance.T, cmap="gray", vmin=0, vmax=0.7, shading="auto")
    axes[1].set(xlabel="voltage (V)", ylabel="wavelength (nm)")
    fig.colorbar(image, ax=axes[1], label="reflectance")
    fig.savefig(out / figure, dpi=160)
    pyplot.close(fig)
    for line in rows:
        print(f"{line['claim']}: {line['claimed']} | {line['ours']} | {line['verdict']}")
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
