"""The gamut for the page: which colours the free numbers reach at the wanted angles, and whether those asked are in."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.optimise.evaluation import geometries_of, lab_hex, nearest_in_ranges
from nacre.optimise.gamut import find_gamut, optimal_limits, srgb_limits
from nacre.optimise.measurement import search_wavelengths, simulate_measurement
from nacre.optimise.parameters import point_of, values_at
from nacre.optimise.targets import Target
from nacre.optimise.task import DesignTask
from nacre.studio.design_request import OBSERVER, target_of
from nacre.studio.told import Tell

POINTS, SECONDS = 400, 24.0  # of all angles together
AIMED_SHARE = 0.5  # of the time: steps towards the colours asked for
STEPS = (0.15, 0.08, 0.04, 0.02, 0.01, 0.005)  # of the bounds, about the nearest so far
TRIES = 16  # of each step
RIM_STEPS = 72


def reachable(question: Mapping[str, Any], tell: Tell) -> None:
    """Tell "limits" (the rims of sRGB and of all surface colours in a*b*), then "reach" for each angle.

    Raises:
        NacreError: the recipe, a bound or a want is wrong, or nothing can be computed.
    """
    target, lamp = target_of(question), question["lamp"]
    white = white_xyz(lamp, OBSERVER)
    rims = (srgb_limits(lamp, OBSERVER), np.asarray(xyz_to_lab(optimal_limits(lamp, OBSERVER), white)))
    tell({"kind": "limits", "srgb": _rim(rims[0]), "optimal": _rim(rims[1])})
    rows = geometries_of(target.targets)
    each = min(SECONDS, question["seconds"]) / len(rows)
    for row in rows:
        wants = [want for want in target.targets if want.geometry == row]
        begun = time.monotonic()
        found = find_gamut(
            target.material,
            question["free"],
            str(row),
            points=POINTS,
            seconds=(1.0 - AIMED_SHARE) * each,
            illuminant=lamp,
            observer=OBSERVER,
        )
        look = _looker(target, row, lamp, white)
        labs = list(found.lab)
        asked: list[dict[str, Any]] = []
        for want in wants:
            until = begun + each * (1.0 - AIMED_SHARE + AIMED_SHARE * (len(asked) + 1) / len(wants))
            labs_near, distance = _aim(target, want, found.lab, found.structures, look, until)
            labs += labs_near
            asked.append(
                {
                    "lab": None if want.lab is None else np.round(want.lab, 2).tolist(),
                    "asked": want.asked,
                    "distance": round(distance, 2),
                    "inside": distance <= want.tolerance,
                    "within": want.tolerance,
                }
            )
        points = [[*np.round(lab, 1).tolist(), lab_hex(lab, white)] for lab in labs]
        tell(
            {
                "kind": "reach",
                "at": str(row),
                "points": points,
                "asked": asked,
                "share_of_srgb": found.share_of_srgb,
                "failed": found.failed,
            }
        )


def _rim(solid: Array) -> list[list[float]]:
    turn = np.linspace(0.0, 2.0 * np.pi, RIM_STEPS, endpoint=False)
    outermost = np.argmax(solid[:, 1:] @ np.stack([np.cos(turn), np.sin(turn)]), axis=0)
    return [[round(float(a), 1), round(float(b), 1)] for a, b in solid[outermost, 1:]]


def _looker(target: DesignTask, row: Any, lamp: str, white: Array) -> Callable[[Array], Array | None]:
    grid = search_wavelengths(target.material, [lamp])
    memory: dict[Any, Any] = {}

    def look(place: Array) -> Array | None:
        try:
            made = target.material.vary(values_at(target.parameters, place))
            seen = simulate_measurement(made, [row], grid, memory=memory)
        except NacreError:
            return None
        return np.asarray(xyz_to_lab(spectrum_to_xyz(seen.factors[0], seen.wavelengths_nm, lamp, OBSERVER), white))

    return look


def distance_to(want: Target, labs: Array) -> Array:
    """Return how far colours `[n, 3]` are from what is wanted: dE00, of ranges to the nearest colour in them."""
    if want.lab is not None:
        return np.asarray(delta_e_2000(labs, want.lab))
    ranges = want.ranges or {}
    return np.asarray(delta_e_2000(labs, np.array([nearest_in_ranges(lab, ranges) for lab in labs])))


def _aim(
    target: DesignTask,
    want: Target,
    labs: Array,
    structures: list[dict[str, Any]],
    look: Callable[[Array], Array | None],
    until: float,
) -> tuple[list[Array], float]:
    """Go towards what is wanted from the nearest draw, in steps that become smaller; return what was seen, how near."""
    distances = distance_to(want, labs)
    nearest = int(np.argmin(distances))
    best = float(distances[nearest])
    seen: list[Array] = []
    place = point_of(target.parameters, structures[nearest])
    generator = np.random.default_rng(0)
    for step in STEPS:
        for _ in range(TRIES):
            if place is None or best <= 0.5 * want.tolerance or time.monotonic() > until:
                return seen, best
            tried = np.clip(place + step * generator.standard_normal(len(place)), 0.0, 1.0)
            lab = look(tried)
            if lab is None:
                continue
            distance = float(distance_to(want, lab[None])[0])
            if distance < best:
                best, place = distance, tried
                seen.append(lab)
    return seen, best
