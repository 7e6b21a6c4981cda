"""Levenberg-Marquardt on stack thicknesses, compiled: about 10 microseconds per step.

Steps solve (J^T W J + mu diag) step = -J^T W r for the thicknesses that are not at a bound. With the weights
W = u^(p - 2) of each term's distance u the sum of u^p falls: p = 2 finds the minimum, p = 8 lowers the worst term.

Hand-written because a step takes less time than a call of scipy.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.matter.stack.thickness_gradient import StackTables, scratch, spectra_and_gradients
from nacre.optimise.thin_film.merit_kernel import CompiledMerit, evaluate, objective

FIRST_DAMPING = 1e-2
MAX_DAMPING = 1e7
MAX_STEP_NM = 60.0  # a fifth of a fringe in the densest layers, the range of the linear model
STOP_OBJECTIVE = 0.02  # stopping value, in tolerances
MIN_STEP_NM = 1e-7
STALL_GAIN = 3e-3  # relative step gain; two smaller ones in a row end a descent


class Workspace(NamedTuple):
    """Arrays that descents write to, one set per thread; created by `workspace`."""

    w: Array
    spectra: Array
    slopes: Array
    r: Array
    jacobian: Array
    u: Array
    normal: Array
    gradient: Array
    factor: Array
    step: Array
    trial: Array
    fixed: Any
    best_u: Array


def workspace(tables: StackTables, merit: CompiledMerit, layers: int) -> Workspace:
    """Return the arrays for stacks of up to `layers` layers."""
    n = max(layers, 1)
    rows, _, samples = tables.turns_r.shape
    residuals, terms = int(merit.residuals[0]), len(merit.kind)
    return Workspace(
        scratch(n),
        np.zeros((rows, samples)),
        np.zeros((rows, n, samples)),
        np.zeros(residuals),
        np.zeros((residuals, n)),
        np.zeros(terms),
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n, dtype=np.bool_),
        np.zeros(terms),
    )


@compiled(error_model="numpy", fastmath={"contract", "reassoc"})
def _normal_equations(merit: Any, layers: int, p: float, s: Any) -> None:
    """Fill J^T W J and J^T W r from the workspace's residuals."""
    worst = 1e-12
    for t in range(s.u.shape[0]):
        worst = max(worst, s.u[t])
    for j in range(layers):
        s.gradient[j] = 0.0
        for i in range(j + 1):
            s.normal[j, i] = 0.0
    at = 0
    for t in range(s.u.shape[0]):
        kind = merit.kind[t]
        size = 3 if kind == 0 else (merit.wanted.shape[1] if kind == 4 else 1)
        weight = 1.0 if p == 2.0 else max((s.u[t] / worst) ** (p - 2.0), 1e-3)
        for k in range(at, at + size):
            for j in range(layers):
                value = weight * s.jacobian[k, j]
                s.gradient[j] += value * s.r[k]
                for i in range(j + 1):
                    s.normal[j, i] += value * s.jacobian[k, i]
        at += size


@compiled(error_model="numpy")
def _solve(layers: int, damping: float, s: Any) -> bool:
    """Solve for the step by Cholesky decomposition; False if the matrix is singular."""
    a = s.factor
    for j in range(layers):
        for i in range(j + 1):
            a[j, i] = 0.0 if s.fixed[j] or s.fixed[i] else s.normal[j, i]
        a[j, j] = 1.0 if s.fixed[j] else s.normal[j, j] * (1.0 + damping) + 1e-10
        s.step[j] = 0.0 if s.fixed[j] else -s.gradient[j]
    for j in range(layers):
        for k in range(j):
            a[j, j] -= a[j, k] * a[j, k]
        if not a[j, j] > 0.0:
            return False
        a[j, j] = math.sqrt(a[j, j])
        for i in range(j + 1, layers):
            for k in range(j):
                a[i, j] -= a[i, k] * a[j, k]
            a[i, j] /= a[j, j]
    for j in range(layers):
        for k in range(j):
            s.step[j] -= a[j, k] * s.step[k]
        s.step[j] /= a[j, j]
    for j in range(layers - 1, -1, -1):
        for k in range(j + 1, layers):
            s.step[j] -= a[k, j] * s.step[k]
        s.step[j] /= a[j, j]
    return True


@compiled(error_model="numpy", nogil=True)
def keep_total(d: Any, low: Any, layers: int, total: float) -> None:
    """Scale the excess over the lower bounds until the thicknesses sum to `total` at most."""
    above, least = 0.0, 0.0
    for j in range(layers):
        above += d[j] - low[j]
        least += low[j]
    if above + least > total and above > 0.0:
        share = max(total - least, 0.0) / above * (1.0 - 1e-12)
        for j in range(layers):
            d[j] = low[j] + (d[j] - low[j]) * share


@compiled(error_model="numpy")
def _try_step(d: Any, low: Any, high: Any, layers: int, total: float, damping: float, s: Any) -> float:
    """Fill `s.trial` with the next step; return its largest change in nm, -1 if there is none."""
    for j in range(layers):
        s.fixed[j] = (d[j] <= low[j] and s.gradient[j] > 0.0) or (d[j] >= high[j] and s.gradient[j] < 0.0)
    if not _solve(layers, damping, s):
        return -1.0
    for j in range(layers):
        step = min(max(s.step[j], -MAX_STEP_NM), MAX_STEP_NM)
        s.trial[j] = min(max(d[j] + step, low[j]), high[j])
    keep_total(s.trial, low, layers, total)
    moved = 0.0
    for j in range(layers):
        moved = max(moved, abs(s.trial[j] - d[j]))
    return moved


@compiled(error_model="numpy", nogil=True)
def descend(
    tables: Any, merit: Any, media: Any, d: Any, low: Any, high: Any, layers: int, substrate: int, total: float,
    steps: int, p: float, s: Any,
) -> float:  # fmt: skip
    """Improve the thicknesses `d` `[>= layers]` in place; return their objective.

    Args:
        low, high: bounds, `[>= layers]`, nm.
        total: bound of their sum, nm.
        steps: at most; 0 evaluates the stack as it is, -1 fills the gradients of the workspace too.
        p: see the module.
        s: `Workspace`; `s.best_u` holds the scaled distances of the result.
    """
    value = np.inf
    damping = FIRST_DAMPING
    stalls = 0
    for j in range(layers):
        s.trial[j] = min(max(d[j], low[j]), high[j])
    keep_total(s.trial, low, layers, total)
    for turn in range(max(steps, 0) + 1):
        if turn > 0:
            moved = _try_step(d, low, high, layers, total, damping, s)
            if moved < 0.0:
                damping *= 6.0
                continue
            if moved < MIN_STEP_NM:
                break
        spectra_and_gradients(tables, media, s.trial, layers, substrate, steps != 0, s.w, s.spectra, s.slopes)
        evaluate(merit, s.spectra, s.slopes, layers, steps != 0, s.r, s.jacobian, s.u)
        initial = 0.0
        for t in range(s.u.shape[0]):
            initial += s.u[t] ** p
        if not initial < value:
            damping *= 6.0
            if damping > MAX_DAMPING:
                break
            continue
        stalls = stalls + 1 if value - initial < STALL_GAIN * p * value else 0
        value = initial
        for j in range(layers):
            d[j] = s.trial[j]
        for t in range(s.u.shape[0]):  # for a slice numba would also compile the text of its shape error
            s.best_u[t] = s.u[t]
        if stalls >= 2 or layers == 0 or turn >= steps or objective(s.best_u) < STOP_OBJECTIVE:
            break
        _normal_equations(merit, layers, p, s)
        if turn > 0:
            damping = max(0.2 * damping, 1e-9)
    return objective(s.best_u)
