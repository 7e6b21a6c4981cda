"""Relief merit function: loss between simulated pictures and targets, with its gradient.

Linear colours are multiplied by an intensity scale, raised to 1/2.2 and compared with display-referred targets; the
loss is the mean square over pixels and channels (physics/relief.md, "Design").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.families.relief.diffraction_orders import Coherence, Prefactor
from nacre.families.relief.plane_cut import CutGeometry, CutPlan, plan_cut
from nacre.families.relief.surface import Tile, blur_matrix, largest_step_nm

GAMMA = 2.2
# x^(1/2.2) has an infinite slope at 0; this offset bounds the gradient and changes the loss by < 1e-4
GRADIENT_FLOOR = 1e-6
# Weight for the fixed-scale loss. A product would let a free-scale loss near zero outweigh
# a design that is far too dark or too bright at the requested scale.
FIXED_SHARE = 0.7
# interpolation error over kappa: measured 1e-4 relative in the search, 1e-6 in the final measurement
SEARCH_NODE_ERROR, MEASURE_NODE_ERROR = 0.3, 1e-2
CONVERGED_CHANGE = 0.01  # largest relative loss change when the sampling is doubled
MAX_UPSAMPLING = 64
MAX_SAMPLES = 8192

# the published sampling: 8 midpoints between 420 and 680 nm
PUBLISHED_WAVELENGTHS_NM = 420.0 + 260.0 * (np.arange(8) + 0.5) / 8
# published normal-incidence aluminium reflectance
PUBLISHED_ALUMINIUM = np.array([0.92272, 0.92042, 0.91842, 0.91635, 0.91442, 0.91111, 0.90800, 0.90336])
PUBLISHED_XYZ_TO_RGB = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
DEFAULT_WAVELENGTHS_NM = np.linspace(400.0, 700.0, 16)


@dataclass(frozen=True)
class Losses:
    """Picture losses at the given and at the best intensity scale, both scales, and the loss for black.

    If `black` is below `fixed`, the fixed-scale loss rewards dark designs and means little.
    """

    fixed: float
    free: float
    scale_fixed: float
    scale_free: float
    black: float


def exact_losses(rgb: Array, target: Array, intensity_scale: float | None) -> Losses:
    """Return losses for linear `rgb` against `target`, both `[..., 3]`, without the gradient floor.

    Without an intensity scale the fixed loss equals the free one.
    """
    target = np.asarray(target, dtype=float)
    response = np.maximum(np.asarray(rgb, dtype=float), 0.0) ** (1.0 / GAMMA)
    energy = float((response * response).sum())
    best = float((response * target).sum()) / energy if energy > 0 else 0.0
    free = float(np.mean((best * response - target) ** 2))
    scale_free = best**GAMMA
    scale = scale_free if intensity_scale is None else intensity_scale
    fixed = float(np.mean((scale ** (1.0 / GAMMA) * response - target) ** 2))
    return Losses(fixed, free, scale, scale_free, float(np.mean(target**2)))


def objective(
    rgb: Array, target: Array, intensity_scale: float | None, brightness_floor: float = 0.0
) -> tuple[float, Array]:
    """Return the search objective and its gradient with respect to `rgb`.

    Fixed scale: logarithm over a weighted mean between fixed and free loss. Free scale: logarithmic free loss,
    plus a penalty if the brightness (1 / scale) falls below `brightness_floor`; otherwise dark designs would be free.
    """
    reference = intensity_scale if intensity_scale is not None else max(_rough_scale(rgb, target), 1e-30)
    floor = rgb.dtype.type(GRADIENT_FLOOR / reference)
    positive = np.maximum(rgb, 0.0)
    response = (positive + floor) ** rgb.dtype.type(1.0 / GAMMA)
    slope = np.where(rgb > 0, response / (GAMMA * (positive + floor)), 0.0)
    count = target.size
    energy = float(np.vdot(response, response))
    best = float(np.vdot(response, target)) / energy
    residual = best * response - target
    free = float(np.vdot(residual, residual)) / count
    if intensity_scale is not None:
        gain = intensity_scale ** (1.0 / GAMMA)
        fixed_residual = gain * response - target
        total = FIXED_SHARE * float(np.vdot(fixed_residual, fixed_residual)) / count + (1.0 - FIXED_SHARE) * free
        value = float(np.log(total))
        # the best scale is stationary: its derivative does not contribute
        gradient = (2.0 / count / total) * ((1.0 - FIXED_SHARE) * best * residual + FIXED_SHARE * gain * fixed_residual)
        return value, (gradient * slope).astype(rgb.dtype, copy=False)
    value = float(np.log(free))
    gradient = (2.0 * best / count / free) * residual
    if brightness_floor > 0:
        excess = GAMMA * np.log(best) + np.log(brightness_floor)
        if excess > 0:
            value += float(excess**2)
            log_best_gradient = (target - 2.0 * best * response) / energy / best
            gradient = gradient + (2.0 * excess * GAMMA) * log_best_gradient
    return value, (gradient * slope).astype(rgb.dtype, copy=False)


def _rough_scale(rgb: Array, target: Array) -> float:
    response = np.maximum(rgb, 0.0) ** (1.0 / GAMMA)
    energy = float(np.vdot(response, response))
    return (float(np.vdot(response, target)) / energy) ** GAMMA if energy > 0 else 1.0


@dataclass(frozen=True)
class ColourWeights:
    """Conversion from BRDF values to linear sRGB.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        rgb_weights: `[3, wavelength]`; includes the coating's reflectance if `has_fresnel`.
        has_fresnel: whether the coating's reflectance is included.
    """

    wavelengths_nm: Array
    rgb_weights: Array
    has_fresnel: bool


def published_weights(normal_reflectance: Callable[[Array], Array] | None) -> ColourWeights:
    """Return the published 8 wavelengths and weights for equal-energy light.

    Args:
        normal_reflectance: coating reflectance at normal incidence by wavelength; None: the published aluminium.
    """
    from nacre.light import observer, table_wavelengths_nm

    # ties are rounded up, as in the publication
    rows = np.floor(PUBLISHED_WAVELENGTHS_NM + 0.5) - table_wavelengths_nm()[0]
    functions = observer("2deg")[rows.astype(int)]
    functions = functions / functions[:, 1].sum()
    fresnel = PUBLISHED_ALUMINIUM if normal_reflectance is None else normal_reflectance(PUBLISHED_WAVELENGTHS_NM)
    return ColourWeights(PUBLISHED_WAVELENGTHS_NM, PUBLISHED_XYZ_TO_RGB @ functions.T * fresnel, True)


def default_weights() -> ColourWeights:
    """Return D65 and the 2 degree observer on 16 wavelengths from 400 to 700 nm."""
    from nacre.light import spectrum_to_rgb_matrix

    return ColourWeights(DEFAULT_WAVELENGTHS_NM, spectrum_to_rgb_matrix(DEFAULT_WAVELENGTHS_NM).T.copy(), False)


@dataclass(frozen=True)
class View:
    """Target picture over a direction grid, and its colour conversion.

    Attributes:
        geometry: half-vector sums, incidences and wavelengths.
        target: `[incidence, x, y, 3]`, display-referred.
        rgb_weights: `[3, wavelength]`, linear sRGB from BRDF values; a perfect reflector is white.
        reflectance: Fresnel reflectance `[..., wavelength]` at cosines; None if `rgb_weights` includes it.
    """

    geometry: CutGeometry
    target: Array
    rgb_weights: Array
    reflectance: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class Problem:
    """Relief design problem: n x n feature heights, process, optics and target views.

    Attributes:
        features: n.
        feature_nm, blur_nm, height_max_nm: process.
        coherence, prefactor: optics.
        views: target pictures.
        intensity_scale: factor before the gamma; None: the best one.
        brightness_floor: least brightness (1 / scale) without penalty; only used with a free scale.
        noise: relative standard deviation per height.
        blur_error: relative process blur error.
        levels: process heights; 0: continuous.
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
        """Tile side."""
        return self.features * self.feature_nm

    @property
    def target(self) -> Array:
        """All target pixels, `[pixel, 3]`."""
        return np.concatenate([view.target.reshape(-1, 3) for view in self.views])

    def search_upsamplings(self) -> tuple[int, int]:
        """Return samples per feature for exploring and for refining.

        Samples slightly narrower than the blur are the coarsest that still approximate the surface. The highest
        target diffraction order must lie below the highest sampled frequency.
        """
        highest = max(v.geometry.highest_line(self.period_nm, self.coherence, np.float32) for v in self.views)
        ratio = self.feature_nm / self.blur_nm if self.blur_nm > 0 else 4.0
        coarse = max(int(np.ceil((2 * highest + 2) / self.features)), 4, int(np.ceil(1.25 * ratio - 0.25)))
        fine = max(coarse + 2, int(np.ceil(1.75 * ratio - 0.25)))
        return min(coarse, MAX_UPSAMPLING // 2), min(fine, MAX_UPSAMPLING)


@dataclass
class Evaluator:
    """Loss and gradient at one sampling, in single precision.

    Attributes:
        problem: the problem.
        upsampling: samples per feature.
        evaluations: gradient evaluation count.
    """

    problem: Problem
    upsampling: int
    node_error: float = SEARCH_NODE_ERROR
    dtype: Any = np.float32
    workers: int = 1
    evaluations: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        problem, samples = self.problem, self.upsampling * self.problem.features
        self.plans: list[CutPlan] = [
            plan_cut(
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
        """Return the blurred surface in the working precision."""
        matrix = self.blur if blur is None else blur
        return matrix @ heights_nm.astype(self.dtype) @ matrix.T

    def rgb(self, surface: NDArray[Any], keep: bool = False) -> tuple[NDArray[Any], list[list[Any]]]:
        """Return linear colours `[pixel, 3]` for all views and the tapes for `pullback`."""
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
        """Return the objective and its gradient at `x`, relative heights in [0, 1], flat `[n^2]`.

        Args:
            noise: relative height error `[n, n]`.
            blur_factor: process blur error, as a factor.
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
        """Return exact design losses at this sampling."""
        rgb, _ = self.rgb(self.surface(heights_nm))
        return exact_losses(rgb, self._target, self.problem.intensity_scale)


@dataclass(frozen=True)
class ConvergedMeasurement:
    """Design losses and picture at a converged sampling."""

    losses: Losses
    rgb: Array
    upsampling: int
    phase_step_rad: float


def measure_design(problem: Problem, heights_nm: Array, workers: int = 1) -> ConvergedMeasurement:
    """Measure a design by doubling the sampling until both losses change by less than 1 %."""
    tile = Tile(heights_nm, problem.feature_nm, problem.blur_nm)
    # these heights may span far less than the allowed range
    tight = replace(problem, height_max_nm=max(tile.height_range_nm, 1.0))
    upsampling = problem.search_upsamplings()[1]
    previous: Losses | None = None
    kappa_max = max(view.geometry.kappa_range[1] for view in problem.views)
    while True:
        evaluator = Evaluator(tight, upsampling, node_error=MEASURE_NODE_ERROR, workers=workers)
        rgb, _ = evaluator.rgb(evaluator.surface(heights_nm - heights_nm.min()))
        losses = exact_losses(rgb, problem.target, problem.intensity_scale)
        finest = 2 * upsampling > MAX_UPSAMPLING or 2 * upsampling * problem.features > MAX_SAMPLES
        if finest or (previous is not None and _change(previous, losses) < CONVERGED_CHANGE):
            break
        previous = losses
        upsampling *= 2
    step = 2.0 * np.pi * kappa_max * largest_step_nm(tile.surface_nm(upsampling))
    return ConvergedMeasurement(losses, np.asarray(rgb, dtype=float), upsampling, step)


def _change(a: Losses, b: Losses) -> float:
    return max(abs(a.fixed / b.fixed - 1.0), abs(a.free / b.free - 1.0)) if b.fixed > 0 and b.free > 0 else 0.0
