"""The bilinear sampling warp of RGL's tensor files: from the unit square to a tabulated density and back.

Densities live on the corners of a grid and are interpolated bilinearly; the warp takes the row by the marginal
and the column by the conditional distribution, both inverted exactly (Dupuy & Jakob 2018, supplement).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.arrays import Array

FLAT = 1e-4  # below this relative slope a segment is treated as constant, as the readers of the format do


@dataclass(frozen=True)
class Warp:
    """A normalised density on `[rows, columns]` corners of the unit square.

    Attributes:
        density: `[rows, columns]`, mean 1 over the square.
        conditional: `[rows, columns]`, running integral along a row.
        marginal: `[rows]`, running integral over the rows.
    """

    density: Array
    conditional: Array
    marginal: Array

    @classmethod
    def of(cls, density: Array) -> Warp:
        """Normalise a non-negative density that is positive somewhere."""
        density = np.asarray(density, dtype=float)
        rows, columns = density.shape
        conditional = np.zeros_like(density)
        conditional[:, 1:] = np.cumsum((density[:, 1:] + density[:, :-1]) / 2, axis=1)
        totals = conditional[:, -1]
        marginal = np.concatenate([[0.0], np.cumsum((totals[1:] + totals[:-1]) / 2)])
        whole = marginal[-1]
        scale = (rows - 1) * (columns - 1) / whole
        return cls(density * scale, conditional / whole, marginal / whole)

    def sample(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Map uniform (x, y) in [0, 1]^2 to a position; x runs along columns, y along rows."""
        rows, columns = self.density.shape
        x, y = np.clip(x, 0.0, 1 - 1e-12), np.clip(y, 0.0, 1 - 1e-12)
        row = np.clip(np.searchsorted(self.marginal, y, side="right") - 1, 0, rows - 2)
        totals = self.conditional[:, -1]
        v = _solve(totals[row], totals[row + 1], y - self.marginal[row])
        blended = (1 - v)[:, None] * self.conditional[row] + v[:, None] * self.conditional[row + 1]
        target = x * blended[:, -1]
        column = np.clip((blended <= target[:, None]).sum(axis=1) - 1, 0, columns - 2)
        everyone = np.arange(len(x))
        left = ((1 - v) * self.density[row, column] + v * self.density[row + 1, column]) * self._unit
        right = ((1 - v) * self.density[row, column + 1] + v * self.density[row + 1, column + 1]) * self._unit
        u = _solve(left, right, target - blended[everyone, column])
        return (column + u) / (columns - 1), (row + v) / (rows - 1)

    def invert(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Map a position back to the uniform (x, y) that `sample` takes there."""
        rows, columns = self.density.shape
        cu, cv = np.clip(u, 0.0, 1.0) * (columns - 1), np.clip(v, 0.0, 1.0) * (rows - 1)
        column, row = np.minimum(cu.astype(int), columns - 2), np.minimum(cv.astype(int), rows - 2)
        fu, fv = cu - column, cv - row
        totals = self.conditional[:, -1]
        y = self.marginal[row] + fv * (totals[row] + 0.5 * fv * (totals[row + 1] - totals[row]))
        left = ((1 - fv) * self.density[row, column] + fv * self.density[row + 1, column]) * self._unit
        right = ((1 - fv) * self.density[row, column + 1] + fv * self.density[row + 1, column + 1]) * self._unit
        below = (1 - fv) * self.conditional[row, column] + fv * self.conditional[row + 1, column]
        whole = (1 - fv) * totals[row] + fv * totals[row + 1]
        x = (below + fu * (left + 0.5 * fu * (right - left))) / np.maximum(whole, 1e-300)
        return np.clip(x, 0.0, 1.0), np.clip(y, 0.0, 1.0)

    @property
    def _unit(self) -> float:
        """Turn the density into the units of the running integrals."""
        rows, columns = self.density.shape
        return 1.0 / ((rows - 1) * (columns - 1))


def _solve(start: Array, end: Array, area: Array) -> Array:
    """Return t in [0, 1] with the integral of the ramp from start to end over [0, t] equal to `area`."""
    flat = np.abs(start - end) < FLAT * (start + end)
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = 2 * area / (start + end)
        ramp = (start - np.sqrt(np.maximum(start**2 - 2 * area * (start - end), 0.0))) / (start - end)
    return np.clip(np.nan_to_num(np.where(flat, straight, ramp)), 0.0, 1.0)
