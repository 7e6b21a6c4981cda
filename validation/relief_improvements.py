"""Cheap improvements of scalar diffraction, each tried on the gratings of `relief_rcwa`: none halves the error.

- small slope: the kernels of first-order perturbation in s and in p (S. O. Rice, Commun. Pure Appl. Math. 4, 351, 1951)
  before the same integral over the heights, which is the first order of the small-slope approximation (A. Voronovich,
  Wave Scattering from Rough Surfaces, 1994): right for shallow reliefs of any slope of light, polarisation included;
- energy: what a perfect mirror would send out is scaled to 1 in each incidence, so that orders that cannot leave give
  their light to the others;
- grooves: in s light runs in a groove of metal as in a waveguide, sqrt(1 - (wavelength / 2 width)^2) slower in phase.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from validation._film import canvas
from validation._relief_cases import KINDS, profile, read_groups, read_orders
from validation._rows import finish, row
from validation.relief_rcwa import (
    AGREED_COLOUR,
    SAMPLES,
    colour_errors,
    scalar_orders,
    spectra_of,
    strong_errors,
)

FIGURE = "relief_improvements.png"
HALF = 0.5
WAYS = ("as it is", "small slope, s and p", "energy", "small slope and energy", "small slope, energy, grooves")


def orders_of(way: str, group: dict[str, Any], at: int, orders: Any) -> Any:
    """Efficiencies of orders, light unpolarised, in one of the ways."""
    if way == WAYS[0]:
        return scalar_orders(group, at, orders)
    place = _place(group, at, orders)
    mirror_s, mirror_p = place["share"], place["share"] * place["bend"] ** 2
    if way == "energy":
        flat = 0.25 * (1 + place["bend"]) ** 2 * place["share"]  # the scalar obliquity is the mean of the two kernels
        return scalar_orders(group, at, orders) / flat.sum()
    s, p = _small_slope(group, at, place)
    if "grooves" in way and group["kind"] == "lamellar" and group["material"] != "SiO2":
        s = s * _groove_power(group, at, orders, place["xi"]) / np.maximum(place["power"], 1e-12)
    if "energy" in way:
        s, p = s / mirror_s.sum(), p / mirror_p.sum()
    return 0.5 * (s + p)


def _place(group: dict[str, Any], at: int, orders: Any) -> dict[str, Any]:
    """What all ways need: in-plane and normal wavenumbers over the vacuum's, and the heights' part."""
    wavelength, angle = group["wavelengths_um"][at], np.radians(group["angle_deg"])
    m = np.asarray(orders, dtype=float)
    k_in = np.sin(angle)
    k = k_in + m * wavelength / group["period_um"]
    q_in, q = float(np.cos(angle)), np.sqrt(np.maximum(1 - k**2, 1e-12))
    xi = q + q_in
    power = _powers(profile(group, SAMPLES)[0], m, xi / wavelength)
    share = 4 * q * q_in / xi**2 * power
    return {"k": k, "k_in": k_in, "q": q, "q_in": q_in, "xi": xi, "power": power, "share": share,
            "bend": (1 - k * k_in) / (q * q_in)}  # fmt: skip


def _powers(heights: Any, orders: Any, kappa: Any, slowness: float = 1.0) -> Any:
    turns = np.outer(orders, np.arange(heights.size) / heights.size)
    return np.abs(np.mean(np.exp(-2j * np.pi * (slowness * np.outer(kappa, heights) + turns)), axis=1)) ** 2


def _small_slope(group: dict[str, Any], at: int, place: dict[str, Any]) -> tuple[Any, Any]:
    epsilon = complex(group["n"][at]) ** 2
    k, k_in, q, q_in = (place[name] for name in ("k", "k_in", "q", "q_in"))
    inner, inner_in = np.sqrt(epsilon - k**2), np.sqrt(epsilon - k_in**2)
    kernel_s = (epsilon - 1) / ((q + inner) * (q_in + inner_in))
    kernel_p = (epsilon - 1) * (inner * inner_in - epsilon * k * k_in)
    kernel_p = kernel_p / ((epsilon * q + inner) * (epsilon * q_in + inner_in))
    return np.abs(kernel_s) ** 2 * place["share"], np.abs(kernel_p) ** 2 * place["share"]


def _groove_power(group: dict[str, Any], at: int, orders: Any, xi: Any) -> Any:
    """The heights' part where light in the grooves runs as in a waveguide of their width."""
    wavelength, n = group["wavelengths_um"][at], complex(group["n"][at])
    skin = wavelength / (2 * np.pi * abs(n))
    width = (1 - group["share"]) * group["period_um"] + 2 * skin
    beta = np.sqrt(complex(1 - (wavelength / (2 * width)) ** 2))
    heights = profile(group, SAMPLES)[0] - group["depth_um"]  # from the tops, down: light there runs as it does outside
    return _powers(heights, np.asarray(orders, dtype=float), xi / wavelength, float(beta.real))


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    orders = read_orders()
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    for group in read_groups():
        cases = orders.get(group["name"])
        if group["kind"] not in KINDS or cases is None or colour_errors(group, cases)[0] > AGREED_COLOUR:
            continue
        for way in WAYS:
            spectra = spectra_of(group, cases, partial(orders_of, way, group))
            found[way].append(float(strong_errors(group, cases, spectra).mean()))
    before = np.array(found[WAYS[0]])
    _draw(found, out_dir)
    rows = []
    for way in WAYS[1:]:
        after = np.array(found[way])
        matters = before > 2.0
        ratio = float(np.median(after[matters] / before[matters]))
        note = f"mean dE00 {before.mean():.1f} to {after.mean():.1f}; median ratio where it was above 2: {ratio:.2f}"
        rows.append(row(f"{way}: does it halve the error?", "taken if it does", f"{note}: not taken",
                        ratio > HALF, FIGURE))  # fmt: skip
    return rows


def _draw(found: dict[str, list[float]], out_dir: str | Path) -> None:
    figure, axes = canvas(1, 1, 4.6, 4.2)
    plot = axes.flat[0]
    for way, marker in zip(WAYS[1:], "os^v"):
        plot.loglog(np.maximum(found[WAYS[0]], 0.1), np.maximum(found[way], 0.1), marker, ms=4, mfc="none", label=way)
    ends = np.array([0.1, 100.0])
    plot.plot(ends, ends, "k", lw=0.8)
    plot.plot(ends, HALF * ends, "k--", lw=0.8, label="half")
    plot.set(xlabel="mean dE00 of scalar diffraction", ylabel="mean dE00 so changed")
    plot.legend(fontsize=7, frameon=False)
    finish(figure, out_dir, FIGURE)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
