"""Colours reachable by one or two parameters, as a fine grid: solved at nodes, interpolated by a cubic spline.

The node spacing is halved until the interpolation error, measured at the new nodes, is invisible.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.core.jit import clock
from nacre.light import delta_e_2000, white_xyz, xyz_to_lab
from nacre.material.material import Material
from nacre.matter.periodic.structure import NotConvergedError
from nacre.measure.geometry import Geometry
from nacre.optimise.measurement import evaluation_wavelengths, search_wavelengths, simulate_measurement
from nacre.optimise.merit import smooth_weights
from nacre.optimise.parameters import Parameter, values_at
from nacre.optimise.thin_film.adapter import drawn_factors

logger = logging.getLogger("nacre")

# nodes per parameter, by parameter count
FIRST_NODES = {1: 17, 2: 9}
MAX_NODES = {1: 2049, 2: 257}
DEFAULT_EVALUATIONS = {1: 257, 2: 1089}  # limit for materials that are not computed in batches
FINE = {1: 8192, 2: 512}  # interpolated grid points
SPLINE_ERROR = 0.1  # largest interpolation dE00
SPLINE_PERCENTILE = 99.9  # share within that error
SPLINE_GAIN = 4.0  # conservative; a cubic spline gains 2^4 per halving
BATCH = 8192  # stacks computed at a time


@dataclass(frozen=True, eq=False)
class ColourGrid:
    """Colours over one or two parameters.

    Attributes:
        axes: ascending parameter values, in recipe units.
        xyz: `[value, 3]` or `[value, value, 3]`; white has Y = 1.
        nodes: solved nodes per parameter.
        error: interpolation dE00 (99.9th percentile); 0 if every value is solved.
    """

    axes: tuple[Array, ...]
    xyz: Array
    nodes: int
    error: float

    @property
    def flat_xyz(self) -> Array:
        """`[point, 3]`."""
        return self.xyz.reshape(-1, 3)

    def values(self, points: NDArray[np.int64]) -> Array:
        """Return parameters `[parameter, ...]` at points (indices into `flat_xyz`)."""
        places = np.unravel_index(points, tuple(len(axis) for axis in self.axes))
        return np.stack([axis[place] for axis, place in zip(self.axes, places, strict=True)])


class ColourSampler:
    """Computes many variants' colours at one geometry; thin films are computed in batches.

    Args:
        parameters: free parameters.
        seed: random walk seed.
        is_final: whether to use final evaluation wavelengths.
    """

    def __init__(
        self,
        material: Material,
        parameters: Sequence[Parameter],
        at: Geometry,
        light: tuple[str, str],
        seed: int,
        is_final: bool = False,
    ) -> None:
        self.material, self.parameters, self.at, self.seed = material, parameters, at, seed
        thickest = material.vary(values_at(parameters, np.ones(len(parameters))))
        self.grid = (evaluation_wavelengths if is_final else search_wavelengths)(thickest, [light[0]])
        self.weights = smooth_weights(self.grid, *light)
        self.white = white_xyz(*light)
        self._paths = [parameter.path for parameter in parameters]
        self._make = self.material.parametrise(self._paths)

    @property
    def is_batched(self) -> bool:
        """Whether variants are computed in batches."""
        low = np.array([[parameter.low for parameter in self.parameters]])
        return drawn_factors(self.material, self._paths, low, [self.at], self.grid) is not None

    def xyz(self, points: Array) -> Array:
        """Return XYZ `[point, 3]` at unit cube points `[point, parameter]`.

        Raises:
            NacreError: a material cannot be computed.
        """
        colours = []
        low, high = (np.array([getattr(p, end) for p in self.parameters]) for end in ("low", "high"))
        for start in range(0, len(points), BATCH):
            values = low + (high - low) * points[start : start + BATCH]
            factors = drawn_factors(self.material, self._paths, values, [self.at], self.grid)
            if factors is None:
                factors = np.stack(
                    [self._factors(dict(zip(self._paths, map(float, row), strict=True))) for row in values]
                )
            colours.append(factors[:, 0] @ self.weights)
        return np.concatenate(colours)

    def _factors(self, changes: dict[str, float]) -> Array:
        """Return factors of one variant; without convergence, with the accuracy of a search."""
        variant = self._make(changes)
        try:
            return simulate_measurement(variant, [self.at], self.grid, seed=self.seed).factors
        except NotConvergedError as error:
            logger.warning("%s: %s; it has the accuracy of a search", self.material.context.source, error)
            rough = variant.at_low_fidelity()
            return simulate_measurement(rough, [self.at], self.grid, seed=self.seed).factors


@dataclass
class Palette:
    """Colours of a sampler, computed in a fixed order up to a budget, from which an interrupted design resumes.

    Attributes:
        sampler: gives the colours.
        evaluations: budget; None: chosen by the parameter count.
        solved: XYZ of an earlier run, in the order of evaluation; more are appended. Batches are not stored.
        on_progress: called after each material with the number solved.
        is_interrupted: polled before each material.
        end_time: time by `core.jit.clock` at which the refinement ends.
        is_stopped: whether an interrupt or the time ended the refinement.
    """

    sampler: ColourSampler
    evaluations: float | None = None
    solved: list[list[float]] = field(default_factory=list)
    on_progress: Callable[[int], None] = lambda count: None
    is_interrupted: Callable[[], bool] = lambda: False
    end_time: float = np.inf
    is_stopped: bool = False
    used: int = 0

    @functools.cached_property
    def limit(self) -> float:
        """Budget."""
        count = len(self.sampler.parameters)
        default = MAX_NODES[count] ** count if self.sampler.is_batched else DEFAULT_EVALUATIONS[count]
        return self.evaluations or default

    def first(self, points: Array, key: str) -> Array:
        """Return colours `[point, 3]` without which no picture is possible.

        Raises:
            RecipeError: the budget is too small.
            KeyboardInterrupt: before all are solved.
        """
        if self.evaluations is not None and len(points) > self.evaluations:
            raise RecipeError(
                f"{self.sampler.material.context.source}: search.evaluations = {self.evaluations}: {key} needs "
                f"{len(points)} materials; allowed: at least as many"
            )
        colours = self._xyz(points, self.is_interrupted)
        if colours is None:
            raise KeyboardInterrupt
        return colours

    def more(self, points: Array) -> Array | None:
        """Return further colours; None if the budget does not suffice or the refinement is stopped."""
        if self.used + len(points) > self.limit:
            return None

        def is_over() -> bool:
            return self.is_interrupted() or clock() > self.end_time

        colours = None if is_over() else self._xyz(points, is_over)
        self.is_stopped = colours is None
        return colours

    def _xyz(self, points: Array, is_over: Callable[[], bool]) -> Array | None:
        if self.sampler.is_batched:
            self.used += len(points)
            return self.sampler.xyz(points)
        start = self.used
        for point in points[max(len(self.solved) - start, 0) :]:
            if is_over():
                return None
            self.solved.append(self.sampler.xyz(point[None])[0].tolist())
            self.on_progress(len(self.solved))
        self.used += len(points)
        return np.array(self.solved[start : self.used])


def level_grid(palette: Palette, levels: int) -> ColourGrid:
    """Return the colours for all level combinations.

    Raises:
        RecipeError: their count exceeds the budget.
        NacreError: a material cannot be computed.
    """
    parameters = palette.sampler.parameters
    count, units = len(parameters), np.linspace(0.0, 1.0, levels)
    xyz = palette.first(_points(units, count), f"limits.height_levels = {levels}")
    return ColourGrid(_axes(parameters, units), xyz.reshape(*[levels] * count, 3), levels, 0.0)


def fine_grid(palette: Palette) -> ColourGrid:
    """Return the colours over the full ranges, on a grid so fine that neighbours hardly differ.

    The result depends on the budget in evaluations alone, unless the refinement is stopped.

    Raises:
        RecipeError: the count of first nodes exceeds the budget.
        NacreError: a material cannot be computed.
    """
    from scipy.interpolate import make_interp_spline

    sampler, count = palette.sampler, len(palette.sampler.parameters)
    nodes = FIRST_NODES[count]

    def spline(values: Array, units: Array, at: Array) -> Array:
        for axis in range(count):
            values = make_interp_spline(units, values, k=3, axis=axis)(at)
        return values

    units = np.linspace(0.0, 1.0, nodes)
    xyz = palette.first(_points(units, count), "a picture").reshape(*[nodes] * count, 3)
    error = np.inf
    while error > SPLINE_ERROR and nodes < MAX_NODES[count]:
        finer = np.linspace(0.0, 1.0, 2 * nodes - 1)
        coarse = (slice(None, None, 2),) * count
        is_new = np.ones([len(finer)] * count, dtype=bool)
        is_new[coarse] = False
        solved = palette.more(_points(finer, count)[is_new.ravel()])
        if solved is None:
            break
        guess = spline(xyz, units, finer)
        refined = guess.copy()
        refined[coarse], refined[is_new] = xyz, solved
        off = delta_e_2000(xyz_to_lab(guess[is_new], sampler.white), xyz_to_lab(solved, sampler.white))
        error = float(np.percentile(off, SPLINE_PERCENTILE)) / SPLINE_GAIN
        xyz, units, nodes = refined, finer, len(finer)
    at = np.linspace(0.0, 1.0, FINE[count])
    return ColourGrid(_axes(sampler.parameters, at), np.maximum(spline(xyz, units, at), 0.0), nodes, error)


def _points(units: Array, count: int) -> Array:
    return np.stack(np.meshgrid(*[units] * count, indexing="ij"), axis=-1).reshape(-1, count)


def _axes(parameters: Sequence[Parameter], units: Array) -> tuple[Array, ...]:
    return tuple(p.low + (p.high - p.low) * units for p in parameters)
