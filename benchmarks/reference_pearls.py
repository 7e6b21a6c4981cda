"""The reference of bench_design_pearls: colours of recipes at the trade's angles by random walks, in a fresh process.

It serves requests (`common.serve`) and knows nothing of the search: a recipe comes as a file, is traced by the plugin
with another seed and 16 times the samples, and again until the standard error of every colour is below 0.1 dE00.
"""

from __future__ import annotations

import numpy as np
from common import serve
from scipy.interpolate import CubicSpline

import nacre
from nacre.core.arrays import direction
from nacre.light import delta_e_2000, white_xyz, xyz_to_lab, xyz_weights
from nacre.measure.evaluate import DEFAULT_SAMPLES, evaluate_with_error
from nacre.measure.geometry import ASPECULAR_DEG, aspecular_direction

TIMES, QUARTERS, QUIET_DE00, MOST_ROUNDS = 16, 4, 0.1, 12
# flakes of spread thickness have no fringe finer than a spline over 20 nm: off by 0.1 dE00 at most from steps of 5 nm
GRID_NM = np.arange(380.0, 781.0, 20.0)
FINE_NM = np.arange(380.0, 781.0, 1.0)
INCIDENCE_DEG = 45.0


def colours(recipe: str, seed: int) -> dict[str, list]:
    """CIELAB at the six angles under D65 for 10 degrees, `[angle][3]`, and their standard errors as dE00."""
    bsdf = nacre.load(recipe).bsdf(GRID_NM)
    wi = np.repeat(direction(np.radians([INCIDENCE_DEG])), len(ASPECULAR_DEG), axis=0)
    wo = np.stack([aspecular_direction(INCIDENCE_DEG, a) for a in ASPECULAR_DEG])
    spline = CubicSpline(GRID_NM, np.eye(len(GRID_NM)), bc_type="natural")(FINE_NM)
    weights, white = spline.T @ xyz_weights(FINE_NM, "D65", "10deg"), white_xyz("D65", "10deg")
    samples = TIMES * DEFAULT_SAMPLES // QUARTERS
    draws: list[list[np.ndarray]] = [[] for _ in ASPECULAR_DEG]
    labs, error = np.zeros((len(draws), 3)), np.full(len(draws), np.inf)
    turn = 0
    while turn < MOST_ROUNDS * QUARTERS and np.any(error > QUIET_DE00):
        noisy = np.flatnonzero(error > QUIET_DE00)  # dark angles take more walks than bright ones
        for _ in range(QUARTERS):  # so that their spread gives the error
            f, _ = evaluate_with_error(bsdf, wi[noisy], wo[noisy], samples=samples, seed=seed + turn)
            turn += 1
            for angle, spectrum in zip(noisy, f):
                draws[angle].append(np.pi * spectrum @ weights)
        for angle in noisy:
            mean = np.mean(draws[angle], axis=0)
            labs[angle] = xyz_to_lab(mean, white)
            off = np.asarray(delta_e_2000(labs[angle], np.asarray(xyz_to_lab(np.array(draws[angle]), white))))
            error[angle] = np.sqrt(np.sum(off**2) / (len(off) * (len(off) - 1)))
    return {"labs": labs.tolist(), "error": error.tolist()}


def differences(recipe: str, labs: list[list[float]], seed: int) -> dict[str, list]:
    """dE00 of a recipe to wanted colours at the six angles, and the standard errors."""
    found = colours(recipe, seed)
    return {"de00": np.asarray(delta_e_2000(np.array(labs), np.array(found["labs"]))).tolist(), **found}


if __name__ == "__main__":
    serve({"colours": colours, "differences": differences})
