"""A design problem in numbers, and the function that the search minimises: features in, loss and gradient out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.design.loss import Losses, measure, objective
from nacre.families.relief.coherence import Coherence
from nacre.families.relief.geometry import Prefactor
from nacre.families.relief.slice import SliceGeometry, SlicePlan, plan_slice
from nacre.families.relief.surface import Tile, blur_matrix, largest_step_nm

# interpolation error over kappa: measured 1e-4 of the image in the search, 1e-6 in a measurement
SEARCH_NODE_ERROR, MEASURE_NODE_ERROR = 0.3, 1e-2
CHANGE_WHEN_CONVERGED = 0.01  # a loss is trusted once doubling the sampling moves it by less
MAX_UPSAMPLING = 64
MAX_SAMPLES = 8192


@dataclass(frozen=True)
class View:
    """One part of a wanted appearance: directions, the picture wanted there, and how colour is computed.

    Attributes:
        geometry: grid of half-vector sums, incidences and wavelengths.
        target: `[incidence, x, y, 3]`, display-referred.
        rgb_weights: `[3, wavelength]`, linear sRGB from BRDF values of a perfect reflector.
        reflectance: Fresnel reflectance `[..., wavelength]` at cosines, or None when `rgb_weights` holds it.
    """

    geometry: SliceGeometry
    target: Array
    rgb_weights: Array
    reflectance: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class Problem:
    """Everything a design must meet.

    Attributes:
        features: n; the unknowns are n x n heights.
        feature_nm, blur_nm, height_max_nm: the process.
        coherence, prefactor: the optics.
        views: what must be seen where.
        intensity_scale: factor before the gamma, or None for the best one.
        brightness_floor: with a free scale, the least brightness (1 / scale) without a penalty; else unused.
        noise: standard deviation of each height, relative to itself.
        blur_error: relative error of the process blur to be robust against.
        levels: number of heights the process can make; 0 for any.
    """

    features: int
    feature_nm: float
    blur_nm: float
    height_max_nm: float
    coherence: Coherence
    views: tuple[View, ...]
    intensity_scale: float | None
    prefactor: Prefactor = "kirchhoff"
    brightness_floor: float = 0.0
    noise: float = 0.0
    blur_error: float = 0.0
    levels: int = 0

    @property
    def period_nm(self) -> float:
        """Side of the tile."""
        return self.features * self.feature_nm

    @property
    def target(self) -> Array:
        """All targets in one row of pixels, `[pixel, 3]`."""
        return np.concatenate([view.target.reshape(-1, 3) for view in self.views])

    def least_upsampling(self) -> int:
        """Samples per feature that hold every wanted line (below the highest frequency the samples have)."""
        highest = max(v.geometry.highest_line(self.period_nm, self.coherence, np.float32) for v in self.views)
        return int(np.ceil((2 * highest + 2) / self.features))

    def search_upsamplings(self) -> tuple[int, int]:
        """Return samples per feature for exploring and for finishing.

        Samples a little narrower than the blur are the coarsest that still approximate the surface.
        """
        ratio = self.feature_nm / self.blur_nm if self.blur_nm > 0 else 4.0
        least = self.least_upsampling()
        coarse = max(least, 4, int(np.ceil(1.25 * ratio - 0.25)))
        fine = max(coarse + 2, int(np.ceil(1.75 * ratio - 0.25)))
        return min(coarse, MAX_UPSAMPLING // 2), min(fine, MAX_UPSAMPLING)


@dataclass
class Evaluator:
    """Loss and gradient of one problem at one sampling, in single precision.

    Attributes:
        problem: what is wanted.
        upsampling: samples per feature.
        evaluations: how often the loss was computed.
    """

    problem: Problem
    upsampling: int
    node_error: float = SEARCH_NODE_ERROR
    dtype: Any = np.float32
    workers: int = 1
    evaluations: int = 0
    plans: list[SlicePlan] = field(init=False)
    blur: NDArray[Any] = field(init=False)

    def __post_init__(self) -> None:
        problem = self.problem
        samples = problem.features * self.upsampling
        self.plans = [
            plan_slice(
                view.geometry,
                samples=samples,
                period_nm=problem.period_nm,
                height_range_nm=problem.height_max_nm,
                coherence=problem.coherence,
                prefactor=problem.prefactor,
                reflectance=view.reflectance,
                node_error=self.node_error,
                dtype=self.dtype,
                workers=self.workers,
            )
            for view in problem.views
        ]
        self.blur = self._blur(1.0)
        self._weights = [view.rgb_weights.astype(self.dtype) for view in problem.views]
        self._target = problem.target.astype(self.dtype)

    def _blur(self, factor: float) -> NDArray[Any]:
        p = self.problem
        return blur_matrix(p.features, self.upsampling, factor * p.blur_nm / p.feature_nm).astype(self.dtype)

    def surface(self, heights_nm: NDArray[Any], blur: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return the blurred surface, in the working precision."""
        matrix = self.blur if blur is None else blur
        return matrix @ heights_nm.astype(self.dtype) @ matrix.T

    def rgb(self, surface: NDArray[Any], keep: bool = False) -> tuple[NDArray[Any], list[list[Any]]]:
        """Return linear colours `[pixel, 3]` of all views and the tapes for `pullback`."""
        colours, tapes = [], []
        for plan, weights in zip(self.plans, self._weights):
            values, tape = plan.forward(surface, keep)
            flat = values.transpose(0, 2, 3, 1).reshape(-1, values.shape[1])
            colours.append(flat @ weights.T)
            tapes.append(tape)
        return np.concatenate(colours), tapes

    def pullback(self, surface: NDArray[Any], tapes: list[list[Any]], cotangent: NDArray[Any]) -> NDArray[Any]:
        """Return dL/dH for dL/d(rgb)."""
        total = np.zeros_like(surface)
        start = 0
        for plan, weights, tape in zip(self.plans, self._weights, tapes):
            incidences, wavelengths, nx, ny = plan.shape
            part = cotangent[start : start + incidences * nx * ny]
            start += len(part)
            back = (part @ weights).reshape(incidences, nx, ny, wavelengths).transpose(0, 3, 1, 2)
            total += plan.pullback(surface, tape, back)
        return total

    def value_and_gradient(
        self, x: Array, noise: NDArray[Any] | None = None, blur_factor: float = 1.0
    ) -> tuple[float, Array]:
        """Return the objective and its gradient at `x`, heights over the allowed range, flat `[n^2]`.

        Args:
            x: in [0, 1].
            noise: relative height error `[n, n]` to apply, or None.
            blur_factor: the process blur's error, as a factor.
        """
        self.evaluations += 1
        problem = self.problem
        blur = self.blur if blur_factor == 1.0 else self._blur(blur_factor)
        gain = problem.height_max_nm * (1.0 if noise is None else 1.0 + noise)
        surface = self.surface(x.reshape(problem.features, -1) * gain, blur)
        rgb, tapes = self.rgb(surface, keep=True)
        value, colour_gradient = objective(rgb, self._target, problem.intensity_scale, problem.brightness_floor)
        gradient = blur.T @ self.pullback(surface, tapes, colour_gradient) @ blur
        return value, np.asarray(gradient * gain, dtype=float).ravel()

    def losses(self, heights_nm: Array) -> Losses:
        """Return the exact losses of a design at this sampling."""
        rgb, _ = self.rgb(self.surface(heights_nm))
        return measure(rgb, self._target, self.problem.intensity_scale)


@dataclass(frozen=True)
class Measurement:
    """Losses by the plain model at a converged sampling, and the picture seen."""

    losses: Losses
    rgb: Array
    upsampling: int
    phase_step_rad: float


def measure_design(problem: Problem, heights_nm: Array, workers: int = 1) -> Measurement:
    """Measure a design by doubling the sampling until both losses change by less than 1 %."""
    tile = Tile(heights_nm, problem.feature_nm, problem.blur_nm)
    # only the heights' own range matters here, and it may be well under the allowed one
    tight = replace(problem, height_max_nm=max(tile.height_range_nm, 1.0))
    upsampling = problem.search_upsamplings()[1]
    previous: Losses | None = None
    kappa_max = max(view.geometry.kappa_range[1] for view in problem.views)
    target = problem.target
    while True:
        judge = Evaluator(tight, upsampling, node_error=MEASURE_NODE_ERROR, workers=workers)
        rgb, _ = judge.rgb(judge.surface(heights_nm - heights_nm.min()))
        losses = measure(rgb, target, problem.intensity_scale)
        finest = 2 * upsampling > MAX_UPSAMPLING or 2 * upsampling * problem.features > MAX_SAMPLES
        if previous is not None and _change(previous, losses) < CHANGE_WHEN_CONVERGED or finest:
            break
        previous = losses
        upsampling *= 2
    step = 2.0 * np.pi * kappa_max * largest_step_nm(tile.surface_nm(upsampling))
    return Measurement(losses, np.asarray(rgb, dtype=float), upsampling, step)


def _change(a: Losses, b: Losses) -> float:
    return max(abs(a.fixed / b.fixed - 1.0), abs(a.free / b.free - 1.0)) if b.fixed > 0 and b.free > 0 else 0.0
