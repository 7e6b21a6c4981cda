"""Which model a metasurface takes by itself: the mean field where it was measured to hold, an ensemble elsewhere.

The table holds every system on which the mean-field model was set against multi-sphere solutions by an independent code
(relative L2 of the diffuse light above, over angles and both polarisations of the light); the rules are read off it.
"""

from __future__ import annotations

from dataclasses import dataclass

HOLDS = 0.12  # relative L2 up to which the mean field is taken
METAL, RESONANT, FAINT = "metal", "high-index", "low-index"
HIGH_INDEX = 2.5  # of the core over the ambient: sharp resonances in the visible
SAME_INDEX = 0.2  # of substrate and ambient, below which nothing is there to speak of


@dataclass(frozen=True)
class Measured:
    """One system and how far the mean-field model was off."""

    system: str
    kind: str
    on_substrate: bool
    coverage: float
    packing: float
    error: float


MEASURED = (
    Measured("silver r 90 nm on glass, 500 nm", METAL, True, 0.10, 0.10, 0.072),
    Measured("silver r 90 nm on 400 nm of oxide on silicon, 500 nm", METAL, True, 0.10, 0.10, 0.076),
    Measured("silver r 75 nm on glass, 450 nm", METAL, True, 0.10, 0.50, 0.089),
    Measured("silver r 90 nm on glass, 450 nm", METAL, True, 0.127, 0.50, 0.082),
    Measured("silver r 90 nm on glass, 500 nm", METAL, True, 0.20, 0.20, 0.108),
    Measured("silicon r 95 nm on 200 nm of oxide on silicon, 550 nm", RESONANT, True, 0.10, 0.30, 0.109),
    Measured("silicon r 75 nm on glass, 600 nm", RESONANT, True, 0.10, 0.10, 0.119),
    Measured("silicon r 75 nm on glass, 600 nm", RESONANT, True, 0.20, 0.20, 0.24),
    Measured("silver r 75 nm alone, 450 nm", METAL, False, 0.10, 0.10, 0.20),
    Measured("silver r 75 nm alone, 450 nm", METAL, False, 0.20, 0.20, 0.24),
)


def kind_of(index: complex) -> str:
    """Return the kind of a core by its index over the ambient's."""
    if index.imag > index.real:
        return METAL
    return RESONANT if index.real > HIGH_INDEX else FAINT


def highest_coverage(kind: str, on_substrate: bool) -> tuple[float, Measured]:
    """Return the coverage up to which the mean field holds, and the measured system that says so.

    The densest system of the kind that is within `HOLDS`; where none is, the error is taken to grow with the coverage
    from nothing, as it does in the table. Cores of low index scatter less than metals do, and take their limit.
    """
    alike = [m for m in MEASURED if m.on_substrate == on_substrate and m.kind == (METAL if kind == FAINT else kind)]
    alike = alike or [m for m in MEASURED if m.on_substrate == on_substrate]
    good = [m for m in alike if m.error <= HOLDS]
    if good:
        best = max(good, key=lambda m: m.coverage)
        return best.coverage, best
    nearest = min(alike, key=lambda m: m.coverage)
    return nearest.coverage * HOLDS / nearest.error, nearest


def mean_field_holds(kind: str, on_substrate: bool, coverage: float, noun: str = "spheres") -> tuple[bool, str]:
    """Tell whether the mean field is taken, and why in words; particles of another shape are judged as spheres are."""
    limit, by = highest_coverage(kind, on_substrate)
    where = "on a substrate" if on_substrate else "with nothing below"
    reason = (
        f"{kind} {noun} {where} at coverage {coverage:.3g}; measured: {by.system}, coverage {by.coverage:g}, "
        f"{100 * by.error:.0f} % off, so the mean field is taken up to {limit:.2g}"
    )
    return coverage <= limit * (1 + 1e-6), reason
