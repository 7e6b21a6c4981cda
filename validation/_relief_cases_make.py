"""Solve the groups of `_relief_cases.py`, each by two solvers; hours on two cores, and a second run goes on.

Run as `.venv-validate/bin/python -m validation._relief_cases_make`, in the environment that `tools/validate_env.py`
builds: `fmmax` is not among nacre's packages. Solvers, by kind:

- lamellar: `fmmax` and our own modes with the inverse rule;
- sinusoidal: our own method of coordinates, and finite elements (slices do not converge for metals in p: neither
  `fmmax`'s, which know no tilted normal, nor ours that did, 20 to 40 % off where these two agree to 0.3 %);
- bump, random: `fmmax` with some 200 and some 400 orders.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from validation._gratings import lamellar, smooth
from validation._relief_cases import DATA, ORDERS, STEEP, profile, read_groups, read_orders, relief_heights

SAMPLES = 2048
TRUNCATION = 90  # orders to each side of 0: the oblique ones of the longest period end at 38
STEEP_ELEMENTS = 1.5  # how much finer elements are where a dielectric is steep: weak orders ask for it
TERMS = (200, 400)


def solve_case(group: dict[str, Any], at: int) -> dict[str, Any]:
    """Both solvers' efficiencies of one wavelength: `orders`, and for "s" and "p" two lists of efficiencies."""
    place = group["wavelengths_um"][at], group["angle_deg"]
    n = group["n"][at]
    if group["kind"] in ("bump", "random"):
        return _relief(group, n, *place)
    return _lamellar(group, n, *place) if group["kind"] == "lamellar" else _sinusoidal(group, n, *place)


def solve_ours(group: dict[str, Any], at: int) -> dict[str, Any]:
    """The solver of our own of a grating that is quick, first of the pair, at one wavelength: "s" and "p"."""
    place = group["wavelengths_um"][at], group["angle_deg"]
    n = group["n"][at]
    if group["kind"] == "lamellar":
        return {
            which: lamellar(group["period_um"], group["depth_um"], group["share"], n, *place, which == "p", 80)[1]
            for which in "sp"
        }
    heights, slopes = profile(group, SAMPLES)
    return {
        which: smooth(group["period_um"], heights, slopes, n, *place, which == "p", 14)[1] for which in "sp"
    }  # fmt: skip


def _lamellar(group: dict[str, Any], n: complex, wavelength: float, angle_deg: float) -> dict[str, Any]:
    from validation._fmmax_orders import GRID, grating_orders

    args = group["period_um"], group["depth_um"], group["share"], n, wavelength, angle_deg
    inside = np.abs((np.arange(GRID) + 0.5) / GRID - 0.5) < 0.5 * group["share"]
    period = group["period_um"]
    orders, theirs = grating_orders(
        period, inside.astype(float), group["depth_um"], 1, n, wavelength, angle_deg, TRUNCATION
    )  # fmt: skip
    found: dict[str, Any] = {"orders": orders.tolist()}
    for which in "sp":
        numbers, ours = lamellar(*args, which == "p", 80)
        assert numbers.tolist() == orders.tolist()
        found[which] = [_short(ours), _short(theirs[which])]
    return found


def _sinusoidal(group: dict[str, Any], n: complex, wavelength: float, angle_deg: float) -> dict[str, Any]:
    from validation._grating_elements import elements

    heights, slopes = profile(group, SAMPLES)
    is_fine = n.imag == 0 and group["depth_um"] > STEEP * group["period_um"]
    found: dict[str, Any] = {}
    for which in "sp":
        is_p = which == "p"
        numbers, first = smooth(group["period_um"], heights, slopes, n, wavelength, angle_deg, is_p, 14)
        of_second, second = elements(
            group["period_um"], group["depth_um"], n, wavelength, angle_deg, is_p, STEEP_ELEMENTS if is_fine else 1.0
        )
        assert of_second.tolist() == numbers.tolist()
        found |= {"orders": numbers.tolist(), which: [_short(first), _short(second)]}
    return found


def _relief(group: dict[str, Any], n: complex, wavelength: float, angle_deg: float) -> dict[str, Any]:
    from validation._fmmax_orders import relief_orders

    shape = relief_heights(group)
    slices = 3 if group["kind"] == "bump" else 1
    args = group["period_um"], group["depth_um"] * shape, slices, n, wavelength, angle_deg
    results = [relief_orders(*args, terms) for terms in reversed(TERMS)]
    orders = results[0][0].tolist()
    coarse = [results[1][0].tolist().index(order) for order in orders]
    return {"orders": orders} | {
        which: [_short(results[0][1][which]), _short(results[1][1][which][coarse])] for which in "sp"
    }  # fmt: skip


def _short(values: Any) -> list[float]:
    return [round(float(value), 6) for value in values]


def main() -> None:
    """Solve what is not solved yet, a line a group."""
    words = sys.argv[1:]
    groups = [group for group in read_groups() if not words or any(word in group["name"] for word in words)]
    known = read_orders()
    DATA.mkdir(exist_ok=True)
    with ORDERS.open("a", encoding="utf-8") as out:
        for group in groups:
            if group["name"] in known:
                continue
            start = time.monotonic()
            cases = [solve_case(group, at) for at in range(len(group["wavelengths_um"]))]
            out.write(json.dumps({"name": group["name"], "cases": cases}) + "\n")
            out.flush()
            print(f"{group['name']}: {time.monotonic() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
