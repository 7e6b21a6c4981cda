"""A 10-pair TiO2/SiO2 Bragg mirror against theory: peak, centre and width of its stop band.

Theory (Yeh, Optical Waves in Layered Media, ch. 6): an infinite periodic medium has a stop band where the Bloch
phase K is complex, cos K = cos a cos b - (n_H/n_L + n_L/n_H) sin a sin b / 2 beyond +-1, with a, b the phases of the
two layers. For quarter waves without dispersion its edges lie in frequency at 1 -+ (2/pi) asin((n_H-n_L)/(n_H+n_L))
of the centre. N pairs between half-spaces of n_L reflect R = C^2 / (C^2 + (sin K / sin NK)^2), with
C = (n_H/n_L - n_L/n_H) sin(a) / 2. At an edge R is still C^2 / (C^2 + 1/N^2), so the band of a finite mirror, taken at
half its maximum, is wider than the infinite one, and its closed form is the number to compare. N pairs in air on a
substrate reflect, at the centre, ((n_L^2N - n_s n_H^2N) / (n_L^2N + n_s n_H^2N))^2 for air | (HL)^N | s.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from nacre.matter import index, powers

CENTRE_NM, PAIRS = 550.0, 10


def mirror(
    n_high: Any, n_low: Any, n_substrate: Any, wavelengths_nm: np.ndarray, d: tuple[float, float], pairs: int
) -> np.ndarray:
    """Reflectance at normal incidence of air | (high low)^pairs | substrate."""
    one = np.ones(len(wavelengths_nm))
    n = np.stack([one + 0j, *[x * one for x in (n_high, n_low) * pairs], n_substrate * one])
    return powers(n, list(d) * pairs, wavelengths_nm, 0.0).reflectance


def half_maximum_band(wavelengths_nm: np.ndarray, reflectance: np.ndarray) -> tuple[float, float]:
    """Outermost wavelengths around the centre at which R falls to half its maximum."""
    middle = int(np.argmin(abs(wavelengths_nm - CENTRE_NM)))
    low = middle - np.argmax(reflectance[middle::-1] < reflectance.max() / 2)
    high = middle + np.argmax(reflectance[middle:] < reflectance.max() / 2)
    return float(wavelengths_nm[low]), float(wavelengths_nm[high])


def finite_mirror(
    n_high: Any, n_low: Any, wavelengths_nm: np.ndarray, d: tuple[float, float], pairs: int
) -> np.ndarray:
    """Yeh's closed form: R of `pairs` periods between half-spaces of the low index."""
    n_high, n_low = np.real(n_high), np.real(n_low)
    a, b = (2 * np.pi * n * x / wavelengths_nm for n, x in zip((n_high, n_low), d))
    ratio = n_high / n_low
    cosine = np.cos(a) * np.cos(b) - (ratio + 1 / ratio) / 2 * np.sin(a) * np.sin(b)
    phase = np.arccos(cosine.astype(complex))
    c2 = ((ratio - 1 / ratio) / 2 * np.sin(a)) ** 2
    # sin NK / sin K is a polynomial in cos K: regular at the edges, where both sines vanish
    chebyshev = np.where(abs(abs(cosine) - 1) < 1e-12, pairs, np.sin(pairs * phase) / np.sin(phase + 1e-300)).real
    return c2 * chebyshev**2 / (1 + c2 * chebyshev**2)


def width_and_centre(band: tuple[float, float]) -> tuple[float, float]:
    """Width in units of the design frequency, and the wavelength of the middle frequency."""
    return CENTRE_NM * (1 / band[0] - 1 / band[1]), 2 / (1 / band[0] + 1 / band[1])


def row(claim: str, claimed: float, ours: float, tolerance: float, figure: str, unit: str) -> dict[str, Any]:
    """One line of the table; `tolerance` is relative."""
    good = abs(ours / claimed - 1) <= tolerance
    return {
        "claim": claim,
        "claimed": f"{claimed:.6g} {unit}".strip(),
        "ours": f"{ours:.6g} {unit}".strip(),
        "verdict": f"{'agrees' if good else 'DISAGREES'} within {tolerance:.2g}",
        "figure": figure,
    }


def main(out_dir: str | Path) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    figure = "film_bragg.png"
    lam = np.arange(380.0, 830.0, 0.05)
    at_centre = np.array([CENTRE_NM])
    high, low, glass = (index(name) for name in ("TiO2-film", "SiO2", "BK7"))
    n_h, n_l, n_s = (float(m.n_complex(at_centre)[0].real) for m in (high, low, glass))
    d = (CENTRE_NM / 4 / n_h, CENTRE_NM / 4 / n_l)
    rows = []

    # without dispersion: closed forms
    flat = mirror(n_h, n_l, n_s, lam, d, PAIRS)
    ratio = (n_l / n_h) ** (2 * PAIRS) / n_s
    peak = float(mirror(n_h, n_l, n_s, at_centre, d, PAIRS)[0])
    exact = ((1 - ratio) / (1 + ratio)) ** 2
    rows.append(row("peak reflectance, 10 pairs, no dispersion", exact, peak, 1e-12, figure, ""))
    one = np.ones(len(lam))
    embedded = powers(np.stack([x * one + 0j for x in (n_l, *(n_h, n_l) * PAIRS, n_l)]), list(d) * PAIRS, lam, 0.0)
    worst = float(abs(embedded.reflectance - finite_mirror(n_h, n_l, lam, d, PAIRS)).max())
    rows.append(
        {
            "claim": "spectrum of 10 pairs between half-spaces of SiO2, largest difference to the closed form",
            "claimed": "0",
            "ours": f"{worst:.1e}",
            "verdict": "agrees within 1e-11" if worst <= 1e-11 else "DISAGREES",
            "figure": figure,
        }
    )
    infinite = 4 / np.pi * np.arcsin((n_h - n_l) / (n_h + n_l))
    # with 400 pairs the band is where nothing passes; outside, fringes reach any R, so half a maximum says nothing
    media = np.stack([x * one + 0j for x in (1.0, *(n_h, n_l) * 400, n_s)])
    passed = powers(media, list(d) * 400, lam, 0.0).transmittance
    width, _ = width_and_centre(half_maximum_band(lam, (passed < 1e-6) * 1.0))
    rows.append(row("relative width, 400 pairs (T < 1e-6) against infinitely many", infinite, width, 2e-3, figure, ""))
    # air and glass in the place of SiO2 move the half maximum a little: hence 2 %
    width_1, _ = width_and_centre(half_maximum_band(lam, finite_mirror(n_h, n_l, lam, d, PAIRS)))
    width, centre = width_and_centre(half_maximum_band(lam, flat))
    rows.append(row("relative width at half maximum, 10 pairs", width_1, width, 0.02, figure, ""))
    rows.append(row("centre in frequency, 10 pairs", CENTRE_NM, centre, 1e-3, figure, "nm"))

    # the real materials
    n_h_lam, n_l_lam, n_s_lam = (m.n_complex(lam) for m in (high, low, glass))
    real = mirror(n_h_lam, n_l_lam, n_s_lam, lam, d, PAIRS)
    theory = finite_mirror(n_h_lam, n_l_lam, lam, d, PAIRS)
    edges, ours = half_maximum_band(lam, theory), half_maximum_band(lam, real)
    rows.append(row("short edge, real TiO2 and SiO2, 10 pairs", edges[0], ours[0], 0.01, figure, "nm"))
    rows.append(row("long edge, real TiO2 and SiO2, 10 pairs", edges[1], ours[1], 0.01, figure, "nm"))

    fig, axis = pyplot.subplots(figsize=(6.4, 3.6), constrained_layout=True)
    axis.axvspan(*edges, color="0.9", label="half maximum of the closed form")
    axis.plot(lam, real, color="C0", lw=1.2, label="10 pairs, real materials")
    axis.plot(lam, flat, color="C1", lw=0.8, ls="--", label="10 pairs, no dispersion")
    axis.set(xlabel="wavelength (nm)", ylabel="reflectance", xlim=(380, 830), ylim=(0, 1.02))
    axis.legend(frameon=False, fontsize=8, loc="center", bbox_to_anchor=(0.41, 0.45))
    fig.savefig(out / figure, dpi=160)
    pyplot.close(fig)
    for line in rows:
        print(f"{line['claim']}: {line['claimed']} | {line['ours']} | {line['verdict']}")
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation")
