"""Pictures of pearls: the source's nine bottles and three cars, on shapes and under lights of our own.

After figures 1 and 14 of Guillen et al. 2020: statements are compared, not pictures. The bottles are shown by their
noise-free form (`nacre.families.pearl.tables`, at a fraction of its effort), the cars by the walk; nothing is denoised.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from validation._pearl import EXAMPLES, in_both_balances
from validation._pearl_pictures import BOTTLE, LARGE, WALK_SPP, difference, picture, sheet, still, traced, where
from validation._rows import finish, row

LARGE_KNOB, CAR = (208, 208), (240, 136)


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
        shot = picture(traced(EXAMPLES / f"car_{name}.toml"), "body", CAR, WALK_SPP, exposure=0.8)
        cars.append((f"{name} car", shot))
    finish(sheet([shots, cars, knobs], 14.0), out, figure, dpi=110)
    on = where("bottle", BOTTLE)
    rows = []
    for what, a in (("density", 1), ("substrate", 3), ("deviation of the normals", 5), ("spread of thickness", 7)):
        change = difference(shots[a - 1][1], shots[a][1], on)
        rows.append(row(f"bottles {a} and {a + 1}: one parameter, {what}, changes the look a lot (fig. 1)",
                        f"median dE00 above {LARGE:g}", f"{change:.1f}", change > LARGE, figure))  # fmt: skip
    return rows


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Render the sheet; return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    # the sheet left is of the second energy_balance, the source's
    return in_both_balances(lambda: contact_sheet(Path(out_dir)))


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
