"""Solve the groups of `_relief_cases.py`, each by two solvers; hours on two cores, and a second run goes on.

Run as `.venv-validate/bin/python -m validation._relief_cases_make`, in the environment that `tools/validate_env.py`
builds: `fmmax` is not among nacre's packages. Solvers, by kind:

- lamellar: `fmmax` and our own modes with the inverse rule;
- sinusoidal: our own method of coordinates, and finite elements (slices do not converge for metals in p: neither
  `fmmax`'s, which know no tilted normal, nor ours that did, 20 to 40 % off where these two agree to 0.3 %);
- bump, random: `fmmax` with some 200 and some 400 orders;
- hill, swell, which are smooth: our own method of coordinates with some 150 and half as many orders (`fmmax` does not
  converge on metals); where slopes are gentle enough, one wavelength by plane waves as well, which share no step with
  it: `python -m validation._relief_cases_make planes` keeps these in `relief_planes.json`.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from validation._crossed import by_coordinates, by_plane_waves
from validation._gratings import lamellar, smooth
from validation._relief_cases import (
    DATA,
    ORDERS,
    SMOOTH_KINDS,
    STEEP,
    profile,
    read_groups,
    read_orders,
    relief_heights,
    relief_slopes,
)

SAMPLES = 2048
TRUNCATION = 90  # orders to each side of 0: the oblique ones of the longest period end at 38
STEEP_ELEMENTS = 1.5  # how much finer elements are where a dielectric is steep: weak orders ask for it
TERMS = (200, 400)
MORE = (4.8, 2.9)  # the circle of a smooth relief's orders reaches so far beyond those that propagate
PLANES = DATA / "relief_planes.json"
PLANES_MORE, PLANES_SLOPE = 7.5, 0.45  # plane waves converge later; Rayleigh's assumption
PLANES_AT = 1  # which wavelength


def solve_case(group: dict[str, Any], at: int) -> dict[str, Any]:
    """Both solvers' efficiencies of one wavelength: `orders`, and for "s" and "p" two lists of efficiencies."""
    place = group["wavelengths_um"][at], group["angle_deg"]
    n = group["n"][at]
    if group["kind"] in SMOOTH_KINDS:
        return _smooth_relief(group, n, *place)
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
    if group["kind"] in SMOOTH_KINDS:
        return _by_coordinates(group, n, *place, MORE[0])[1]
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


def _by_coordinates(
    group: dict[str, Any], n: complex, wavelength: float, angle_deg: float, more: float
) -> tuple[Any, dict[str, Any]]:
    heights, period = group["depth_um"] * relief_heights(group), group["period_um"]
    return by_coordinates(
        period, heights, relief_slopes(group), n, wavelength, angle_deg, period / wavelength + more
    )  # fmt: skip


def _smooth_relief(group: dict[str, Any], n: complex, wavelength: float, angle_deg: float) -> dict[str, Any]:
    (orders, fine), (others, coarse) = (_by_coordinates(group, n, wavelength, angle_deg, more) for more in MORE)
    assert orders.tolist() == others.tolist()
    return {"orders": orders.tolist()} | {which: [_short(fine[which]), _short(coarse[which])] for which in "sp"}


def solve_by_planes(group: dict[str, Any]) -> dict[str, Any] | None:
    """One wavelength of a smooth relief by plane waves, or None where slopes are too steep for them."""
    slopes = relief_slopes(group)
    if np.hypot(*slopes).max() > PLANES_SLOPE:
        return None
    wavelength, period = group["wavelengths_um"][PLANES_AT], group["period_um"]
    few = slice(None, None, 2)  # equations are three times as many as waves all the same
    orders, found = by_plane_waves(
        period, group["depth_um"] * relief_heights(group)[few, few], slopes[:, few, few], group["n"][PLANES_AT],
        wavelength, group["angle_deg"], period / wavelength + PLANES_MORE,
    )  # fmt: skip
    return {"orders": orders.tolist()} | {which: _short(found[which]) for which in "sp"}


def read_planes() -> dict[str, dict[str, Any]]:
    """What plane waves gave, by relief."""
    document: dict[str, dict[str, Any]] = json.loads(PLANES.read_text(encoding="utf-8")) if PLANES.exists() else {}
    return document


def _write_planes(groups: list[dict[str, Any]]) -> None:
    solved = {g["name"]: solve_by_planes(g) for g in groups if g["kind"] in SMOOTH_KINDS}
    PLANES.write_text(json.dumps({k: v for k, v in solved.items() if v is not None}) + "\n", encoding="utf-8")


def _short(values: Any) -> list[float]:
    return [round(float(value), 6) for value in values]


def main() -> None:
    """Solve what is not solved yet, a line a group."""
    words = sys.argv[1:]
    if words == ["planes"]:
        return _write_planes(read_groups())
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
