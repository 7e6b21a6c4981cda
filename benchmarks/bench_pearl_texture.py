"""Sparkle and graininess of three effect paints: CPU time of the statistics of their flakes, and of a drawn patch.

Bars: 10 CPU s for the statistics and 60 for the patch, each for the slowest paint. `python -m validation pearl_texture`
compares the values of both for 30 paints. Prediction (from that run): 1.2 and 5 CPU s, up to 3 and 27.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import statistics
import sys
from typing import Any

from common import Row, parser, report, timed

import nacre

BARS = {"statistics": 10.0, "patch": 60.0}  # CPU seconds
MICA = {"material": "mica", "thickness_nm": 400, "deviation_nm": 80}
ALUMINIUM = {"substrate": {"material": "Al", "thickness_nm": 300}, "volume_fraction": 0.02}
PEARL = {"substrate": MICA, "coatings": [{"material": "TiO2", "thickness_nm": 80}], "volume_fraction": 0.05}
COAT = {"resin": {"n": 1.5}, "thickness_um": 40}


def paint(flakes: dict[str, Any], diameter_um: float, *above: dict[str, Any]) -> dict[str, Any]:
    """Return a recipe of one pigment."""
    pigment = {"normal_deviation": 0.12, "diameter_um": diameter_um, **flakes}
    stratum = {"resin": {"n": 1.5}, "thickness_um": 20, "platelets": [pigment]}
    return {"family": "pearl", "strata": [*above, stratum], "base": {"albedo": 0.1}}


PAINTS = {
    "coarse aluminium under a clear coat": paint(ALUMINIUM, 40.0, COAT),
    "fine aluminium": paint(ALUMINIUM, 12.0) | {"glints": {"surface_mm": 20, "flatness_deg": 0.5}},
    "pearl under a clear coat": paint(PEARL, 20.0, COAT),
}


def seconds(data: dict[str, Any], method: str, repeats: int) -> float:
    """Return the median CPU time over seeds."""
    return statistics.median(
        timed(lambda seed=seed: nacre.texture(data, method=method, seed=seed))[1]  # type: ignore[misc]
        for seed in range(repeats)
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    chosen = parser(__doc__, repeats=3).parse_args(arguments)
    rows = []
    nacre.texture(PAINTS["fine aluminium"], method="statistics")  # compiles
    for method, bar in BARS.items():
        spent = {name: seconds(data, method, chosen.repeats) for name, data in PAINTS.items()}
        claim = f"sparkle and graininess by {method}, the slowest paint"
        note = ", ".join(f"{name} {value:.3g}" for name, value in spent.items())
        rows.append(Row(claim, max(spent.values()), "CPU s", bar, False, note))
    return report("pearl_texture: sparkle and graininess", rows, chosen.json)


if __name__ == "__main__":
    sys.exit(main())
