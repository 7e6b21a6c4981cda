"""The smallest ball about points: where an object's own space begins, and its unit."""

from __future__ import annotations

import itertools

import numpy as np

from nacre.arrays import Array

SLACK = 1e-9  # of the radius: rounding


def bounding_ball(points: Array) -> tuple[Array, float]:
    """Return centre `[3]` and radius of the smallest ball about points `[N, 3]`.

    The ball of a few points grows by the farthest point outside until none is; each step keeps the points on the
    ball's surface, at most four of them, so that its exact ball is found by trying all (an LP-type problem: Sharir and
    Welzl 1992). The radius rises at each step, so there is an end.
    """
    held = points[:1]
    while True:
        centre, radius, held = _ball_of_few(held)
        away = np.linalg.norm(points - centre, axis=1)
        farthest = int(np.argmax(away))
        if away[farthest] <= radius * (1 + SLACK) or (held == points[farthest]).all(axis=1).any():
            return centre, radius
        held = np.concatenate([held, points[farthest : farthest + 1]])


def _ball_of_few(points: Array) -> tuple[Array, float, Array]:
    """The smallest ball about at most five points, and those of them that span it."""
    best: tuple[Array, float, Array] | None = None
    for count in range(1, min(len(points), 4) + 1):
        for chosen in itertools.combinations(range(len(points)), count):
            span = points[list(chosen)]
            # the point of their plane (line, space) that is as far from all of them
            sides = span[1:] - span[0]
            weights = np.linalg.lstsq(2 * sides @ sides.T, (sides**2).sum(axis=1), rcond=None)[0]
            centre = span[0] + weights @ sides
            radius = float(np.linalg.norm(span[0] - centre))
            holds_all = np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + SLACK) + 1e-300
            if holds_all and (best is None or radius < best[1]):
                best = centre, radius, span
    if best is None:  # points so close to one plane that rounding decides: a ball that holds them
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        return centre, float(np.linalg.norm(points - centre, axis=1).max()), points[:4]
    return best
