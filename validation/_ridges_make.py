"""Solve supercells of the Morpho preset's ridges: half an hour on one core, and a second run goes on.

Run as `.venv/bin/python -m validation._ridges_make`; `check` after it solves one cell by `fmmax` too, which lives in
`.venv-validate`. Two wings: *letter*, the lamellae that the preset's numbers describe, and *meant*, those that it says
they stand for: lamellae of 70 nm in ridges that fill about half of the width, each entered as 35 nm of solid cuticle.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from validation._ridges import Ridge, drawn_heights, faces, reflected

DATA = Path(__file__).resolve().parent / "data"
ORDERS, CHECK = DATA / "ridge_orders.jsonl", DATA / "ridge_check.json"
WAVELENGTHS_NM = np.arange(380.0, 701.0, 20.0)
DRAWS = 20
TRUNCATION = 36  # orders to each side; with 64 no strong one of the checked cell changes by 1 %
ANGLES_DEG = (0.0,)
CUTICLE = 1.56 + 0.06j
WINGS = {
    "letter": Ridge(35.0, 190.0, 9, 300.0, 700.0, 120.0, CUTICLE),
    "meant": Ridge(70.0, 155.0, 9, 300.0, 700.0, 120.0, CUTICLE),
}
CHECKED = {"wing": "meant", "draw": 0, "angle_deg": 0.0, "wavelength_nm": 460.0}


def solve(wing: str, draw: int, angle_deg: float, wavelength_nm: float, truncation: int = TRUNCATION) -> dict[str, Any]:
    """Efficiencies of one cell: `orders`, and for "s" and "p" a list."""
    ridge = WINGS[wing]
    found: dict[str, Any] = {}
    for which in "sp":
        heights = drawn_heights(ridge, draw)
        orders, values = reflected(ridge, heights, wavelength_nm, angle_deg, which == "p", truncation)
        found |= {"orders": orders.tolist(), which: [round(float(value), 6) for value in values]}
    return found


def read_cells() -> dict[tuple[str, float, int], list[dict[str, Any]]]:
    """What was found: for each wing, angle and draw a list over `WAVELENGTHS_NM`; `orders` as (first, last)."""
    if not ORDERS.exists():
        return {}
    lines = map(json.loads, ORDERS.read_text(encoding="utf-8").splitlines())
    return {(line["wing"], line["angle_deg"], line["draw"]): line["cases"] for line in lines}


def read_check() -> dict[str, Any]:
    """The checked cell: what we found with two numbers of orders, and `fmmax`."""
    document: dict[str, Any] = json.loads(CHECK.read_text(encoding="utf-8"))
    return document


def solve_by_fmmax(truncation: int) -> dict[str, Any]:
    """The same for the cell of `CHECKED`, by `fmmax`."""
    from validation._fmmax_orders import layered_orders

    ridge = WINGS[CHECKED["wing"]]
    thicknesses, inside = faces(ridge, drawn_heights(ridge, CHECKED["draw"]))
    samples = 2240  # of 2.5 nm, in which pitch and width are whole numbers
    x = (np.arange(samples) + 0.5) * ridge.period_nm / samples
    number, place = np.divmod(x, ridge.pitch_nm)
    in_ridge = np.abs(place - 0.5 * ridge.pitch_nm) < 0.5 * ridge.width_nm
    filled = inside[:, number.astype(int)] & in_ridge
    numbers, values = layered_orders(
        ridge.period_nm, filled[::-1], thicknesses[::-1], ridge.n, CHECKED["wavelength_nm"], CHECKED["angle_deg"],
        truncation,
    )  # fmt: skip
    return {"orders": numbers.tolist()} | {k: [round(float(e), 6) for e in v] for k, v in values.items()}


def main() -> None:
    """Solve what is not solved yet, a line a cell."""
    DATA.mkdir(exist_ok=True)
    if "check" in sys.argv[1:]:
        ours = {str(truncation): solve(**CHECKED, truncation=truncation) for truncation in (TRUNCATION, 64)}
        document = {**CHECKED, "ours": ours, "fmmax": {"64": solve_by_fmmax(64)}}
        CHECK.write_text(json.dumps(document) + "\n", encoding="utf-8")
        return
    known = read_cells()
    with ORDERS.open("a", encoding="utf-8") as out:
        for angle in ANGLES_DEG:
            for draw in range(DRAWS):
                for wing in WINGS:
                    if (wing, angle, draw) in known:
                        continue
                    start = time.monotonic()
                    cases = [solve(wing, draw, angle, wavelength) for wavelength in WAVELENGTHS_NM]
                    for case in cases:
                        case["orders"] = [case["orders"][0], case["orders"][-1]]
                        case |= {which: [round(value, 5) for value in case[which]] for which in "sp"}
                    out.write(json.dumps({"wing": wing, "angle_deg": angle, "draw": draw, "cases": cases}) + "\n")
                    out.flush()
                    print(f"{wing} {angle:g} {draw}: {time.monotonic() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
