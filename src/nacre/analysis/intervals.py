"""Confidence intervals of a least-squares fit: linear, by profile likelihood, or by resampling of the residuals.

The linear interval follows from the Gauss-Newton covariance. The profile interval of a number holds all values at which
the sum of squares, minimised over the other numbers, rises by no more than the F quantile (Bates and Watts, Nonlinear
Regression Analysis, 1988, ch. 6). Resampling refines the fit to simulated data whose residuals are drawn from those of
the fit (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 9).
"""

from collections.abc import Callable

import numpy as np

from nacre.core.arrays import Array
from nacre.optimise.methods.least_squares import LocalMinimum, minimise_residuals

METHODS = ("auto", "linear", "profile", "resampling")
NONLINEAR = 0.3  # relative deviation of the loss at the linear interval's ends from a quadratic
BRACKETS = 12  # steps of the search for an interval's end
END_TOL = 0.02  # of an interval's end, relative to its half width
DRAWS = 100  # of resampling

Residuals = Callable[[Array], Array]


def covariance(end: LocalMinimum, count: int) -> tuple[Array, float]:
    """Return the Gauss-Newton covariance `[p, p]` (infinite where undetermined) and the residual variance."""
    freedom = max(1, count - len(end.point))
    variance = end.loss / freedom
    _, singular, rotation = np.linalg.svd(end.jacobian, full_matrices=False)
    floor = np.finfo(float).eps * end.jacobian.shape[0] * (singular.max() if singular.size else 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(singular > floor, 1.0 / np.maximum(singular, 1e-300) ** 2, np.inf)
        found = variance * np.einsum("ki,k,kj->ij", rotation, inverse, rotation)
    return np.where(np.isfinite(found), found, np.inf), variance


def correlation(end: LocalMinimum, count: int) -> Array:
    """Return the correlations of the numbers `[p, p]`; NaN where undetermined."""
    found, _ = covariance(end, count)
    scale = np.sqrt(np.diag(found))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = found / np.outer(scale, scale)
    return np.where(np.isfinite(ratio), np.clip(ratio, -1.0, 1.0), np.nan)


def is_nonlinear(residuals: Residuals, end: LocalMinimum, half_widths: Array) -> bool:
    """Whether the sum of squares at the ends of the linear intervals differs from a quadratic, or they pass a bound."""
    from scipy.stats import t

    count = len(residuals(end.point))
    found, variance = covariance(end, count)
    if not np.isfinite(found).all() or variance == 0.0:
        return False
    quantile = float(t.ppf(0.975, max(1, count - len(end.point))))
    for i, half in enumerate(half_widths):
        if not half > 0:
            continue
        step = found[:, i] / np.sqrt(found[i, i]) * quantile
        for sign in (-1.0, 1.0):
            there = end.point + sign * step
            if np.any(there < 0.0) or np.any(there > 1.0):
                return True
            rise = float(np.sum(residuals(there) ** 2)) - end.loss
            if abs(rise / (variance * quantile**2) - 1.0) > NONLINEAR:
                return True
    return False


def profile_interval(residuals: Residuals, end: LocalMinimum, index: int, half_width: float) -> tuple[float, float]:
    """Return the ends of a number's 95 % profile interval, in the unit cube; at most its bounds."""
    from scipy.stats import f

    count = len(residuals(end.point))
    freedom = max(1, count - len(end.point))
    limit = end.loss * (1.0 + float(f.ppf(0.95, 1, freedom)) / freedom)
    others = [i for i in range(len(end.point)) if i != index]
    ends = []
    for sign in (-1.0, 1.0):
        state = {"point": end.point}

        def loss(value: float, state: dict[str, Array] = state) -> float:
            point = state["point"].copy()
            point[index] = value
            if not others:
                return float(np.sum(residuals(point) ** 2))

            def reduced(x: Array) -> Array:
                full = point.copy()
                full[others] = x
                return residuals(full)

            found = minimise_residuals(reduced, point[others], max_nfev=15)
            state["point"] = point
            state["point"][others] = found.point
            return found.loss

        ends.append(_crossing(loss, float(end.point[index]), sign, half_width, limit))
    return ends[0], ends[1]


def _crossing(loss: Callable[[float], float], centre: float, sign: float, half_width: float, limit: float) -> float:
    """Return the point on one side of the minimum at which the loss reaches its limit, at most the bound."""
    bound = 1.0 if sign > 0 else 0.0
    inside, outside = centre, None
    step = min(max(half_width, 1e-6), 0.5)
    for _ in range(BRACKETS):
        trial = centre + sign * step if outside is None else 0.5 * (inside + outside)
        if outside is None and sign * (trial - bound) >= 0.0:
            trial = bound
        if loss(trial) > limit:
            outside = trial
        elif trial == bound:
            return bound
        else:
            inside = trial
            step *= 1.5
        if outside is not None and abs(outside - inside) <= END_TOL * max(half_width, abs(inside - centre)):
            break
    return inside if outside is None else 0.5 * (inside + outside)


def resampled_intervals(residuals: Residuals, end: LocalMinimum, seed: int, draws: int = DRAWS) -> Array:
    """Return the 95 % intervals `[p, 2]` of refits to data with resampled residuals, in the unit cube."""
    generator = np.random.default_rng([seed, 7])
    own = residuals(end.point)
    centred = (own - own.mean()) * np.sqrt(len(own) / max(1, len(own) - len(end.point)))
    found = []
    for _ in range(draws):
        shift = generator.choice(centred, len(own)) - own

        def shifted(point: Array, shift: Array = shift) -> Array:
            return np.asarray(residuals(point) + shift)

        found.append(minimise_residuals(shifted, end.point, max_nfev=8).point)
    return np.quantile(np.array(found), [0.025, 0.975], axis=0).T
