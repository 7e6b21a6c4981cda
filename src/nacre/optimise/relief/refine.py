"""Vector refinement: the heights of a finished relief design, improved by Maxwell's equations.

The picture is the orders of the tile, each as wide as the coherence window makes it:
f(psi) = sum over orders E G(psi - lambda g), with the efficiency E for unpolarised light and a Gaussian G of unit
integral. Equal heights move together, by a pattern search with falling steps, since a gradient costs as much as one
evaluation for each height.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.families.relief.material import Relief
from nacre.families.relief.structures import Blocks, Lines, blocks_of, lines_of
from nacre.families.relief.surface import Tile
from nacre.families.relief.vector import VectorRelief
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.periodic.structure import MAX_UNKNOWNS
from nacre.optimise.problem import BudgetExhausted
from nacre.optimise.relief.merit import Losses, Problem, View, exact_losses, objective
from nacre.recipe.model import RecipeContext

FIRST_STEP, LAST_STEP = 0.08, 0.01  # of the largest height
TOLERANCE = 2e-2  # of an efficiency, for candidates


@dataclass(frozen=True)
class Refinement:
    """Heights after the refinement.

    Attributes:
        heights_nm: `[x, y]`.
        before, after: losses of the picture by Maxwell's equations.
        evaluations: solved candidates.
        seconds: its time.
        is_interrupted: whether an interrupt ended it.
    """

    heights_nm: Array
    before: Losses
    after: Losses
    evaluations: int
    seconds: float
    is_interrupted: bool = False

    @property
    def summary(self) -> dict[str, Any]:
        """Its part of `design.json`."""
        return {
            "loss_fixed_before": self.before.fixed, "loss_free_before": self.before.free,
            "loss_fixed": self.after.fixed, "loss_free": self.after.free,
            "evaluations": self.evaluations, "seconds": round(self.seconds, 3),
        }  # fmt: skip


def check_refinable(problem: Problem, coating: OpticalConstant, context: RecipeContext) -> None:
    """Refuse a tile whose vector optics cannot be afforded, before the search.

    Raises:
        RecipeError: the period or the blur is too large, or the colours include the coating's reflectance.
    """
    if any(view.reflectance is None for view in problem.views):
        raise RecipeError(f'{context.source}: search.refine = "vector" needs spectrum = "default"')
    steps = np.add.outer(np.arange(problem.features), np.arange(problem.features)) % 2 * problem.height_max_nm
    tile = Tile(steps + np.eye(problem.features), problem.feature_nm, problem.blur_nm)
    obstacle = _relief(problem, tile, coating).vector_obstacle(MAX_UNKNOWNS)
    if obstacle:
        raise context.fail(
            "search.refine", "vector", f"does not fit: {obstacle}; allowed: few features of a short period, with "
            "vertical walls, or no refine",
        )  # fmt: skip


def refine(
    problem: Problem,
    heights_nm: Array,
    coating: OpticalConstant,
    is_over: Callable[[], bool] = lambda: False,
) -> Refinement:
    """Improve the heights of a design; an interrupt ends it with the best heights so far.

    Args:
        heights_nm: `[x, y]`, in [0, `problem.height_max_nm`].
        is_over: polled between candidates; the picture of the given heights is solved in any case.

    Raises:
        NacreError: the heights cannot be solved.
    """
    start = time.monotonic()
    values, groups = np.unique(heights_nm, return_inverse=True)
    groups = groups.reshape(heights_nm.shape)
    top = problem.height_max_nm
    grid = np.linspace(0.0, top, problem.levels) if problem.levels else None

    def merit(candidate: Array) -> tuple[float, Array]:
        rgb = vector_rgb(problem, candidate[groups], coating)
        return objective(rgb, problem.target, problem.intensity_scale, problem.brightness_floor)[0], rgb

    best, rgb = merit(values)
    first = exact_losses(rgb, problem.target, problem.intensity_scale)
    is_interrupted = False
    count, step = 1, FIRST_STEP * top if grid is None else float(grid[1])
    try:
        while grid is not None or step >= LAST_STEP * top:  # on levels it ends when none improves
            improved = False
            for k, sign in ((k, sign) for k in range(len(values)) for sign in (1.0, -1.0)):
                if is_over():
                    raise BudgetExhausted
                moved = values.copy()
                moved[k] = np.clip(values[k] + sign * step, 0.0, top)
                if grid is not None:
                    moved[k] = grid[np.argmin(np.abs(grid - moved[k]))]
                if moved[k] == values[k]:
                    continue
                try:
                    value, seen = merit(moved)
                except NacreError:  # a candidate that cannot be solved
                    continue
                count += 1
                if value < best:
                    best, values, rgb, improved = value, moved, seen, True
            if not improved:
                if grid is not None:
                    break
                step *= 0.5
    except BudgetExhausted:
        pass
    except KeyboardInterrupt:
        is_interrupted = True
    last = exact_losses(rgb, problem.target, problem.intensity_scale)
    return Refinement(values[groups], first, last, count, time.monotonic() - start, is_interrupted)


def vector_rgb(problem: Problem, heights_nm: Array, coating: OpticalConstant) -> Array:
    """Return linear colours `[pixel, 3]` of all views by Maxwell's equations.

    Raises:
        NacreError: the heights cannot be solved.
    """
    tile = Tile(heights_nm, problem.feature_nm, problem.blur_nm)
    relief = _relief(problem, tile, coating)
    obstacle = relief.vector_obstacle(MAX_UNKNOWNS)
    if obstacle:
        raise NacreError(f"heights that cannot be solved: {obstacle}")
    pattern: Lines | Blocks = lines_of(tile) or blocks_of(tile)
    vector = VectorRelief(relief, pattern, TOLERANCE)
    return np.concatenate([_view_rgb(vector, view, wi) for view in problem.views for wi in view.geometry.wi])


def _relief(problem: Problem, tile: Tile, coating: OpticalConstant) -> Relief:
    return Relief(tile, problem.coherence, coating, problem.prefactor)


def _view_rgb(vector: VectorRelief, view: View, wi: Array) -> Array:
    """Return linear colours `[pixel, 3]` of one view for light from one direction."""
    geometry = view.geometry
    theta, azimuth = float(np.arccos(wi[2])), float(np.arctan2(wi[1], wi[0]))
    found = vector.diffraction_orders(np.array([theta]), azimuth, geometry.wavelengths_nm)
    power = np.nan_to_num(found.reflected[0].mean(axis=-1))  # [wavelength, order]
    centres = np.nan_to_num(found.reflected_direction[0, :, :, :2]) + wi[:2]
    width = vector.order_width_rad
    across, along = (
        np.exp(-0.5 * np.square((psi - centres[..., axis, None]) / width)) / (np.sqrt(2.0 * np.pi) * width)
        for axis, psi in enumerate((geometry.psi_x, geometry.psi_y))
    )
    values = np.einsum("wo,wox,woy->xyw", power, across, along)
    values[~geometry.cos_o[1][_incidence(geometry.wi, wi)]] = 0.0
    return np.asarray(values.reshape(-1, values.shape[-1]) @ view.rgb_weights.T)


def _incidence(directions: Array, wi: Array) -> int:
    return int(np.flatnonzero(np.all(directions == wi, axis=1))[0])
