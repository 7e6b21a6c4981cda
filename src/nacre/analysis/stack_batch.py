"""Specular spectra of many films that differ in thicknesses only, solved at once.

A diagnosis evaluates a film thousands of times. If its numbers move the thicknesses of one coherent stack linearly,
all points are one call of the batched solver (`nacre.matter.stack.solve.powers`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.families.contract import SpecularStack
from nacre.material.material import Material
from nacre.matter.stack.solve import powers
from nacre.matter.stack.stack import Stack
from nacre.optimise.tolerances import Component, values_at

PARTS = {"specular_reflectance": "both", "specular_reflectance_s": "s", "specular_reflectance_p": "p"}
PARTS |= {"total_reflectance": "both", "total_reflectance_s": "s", "total_reflectance_p": "p"}
EXACT = 1e-9  # absolute difference between the two computations
PROBE = 1.5  # standard deviations at which they are compared


@dataclass(frozen=True, eq=False)
class _Row:
    """A spectrum at one angle and polarisation, with the indices `[medium, wavelength]` of the stack."""

    wavelengths_nm: Array
    theta_rad: float
    polarisation: str
    indices: ComplexArray


@dataclass(frozen=True, eq=False)
class StackBatch:
    """Values of observations as functions of the thicknesses.

    Attributes:
        thicknesses_nm: `[layer]`, of the recipe.
        slopes: path -> derivative of the thicknesses `[layer]` with respect to a number of the recipe.
        nominal: path -> the recipe's number.
        rows: spectra in the values' order.
    """

    thicknesses_nm: Array
    slopes: Mapping[str, Array]
    nominal: Mapping[str, float]
    rows: tuple[_Row, ...]

    def values(self, numbers: Mapping[str, Array]) -> Array:
        """Return the reflectances `[point, value]` for path -> numbers `[point]`."""
        moved = sum(np.outer(column - self.nominal[path], self.slopes[path]) for path, column in numbers.items())
        thicknesses = np.maximum(self.thicknesses_nm + moved, 0.0)
        found: dict[tuple[int, float], Any] = {}
        spectra = []
        for row in self.rows:
            key = (id(row.indices), row.theta_rad)
            if key not in found:
                media = np.broadcast_to(row.indices, (len(thicknesses), *row.indices.shape))
                found[key] = powers(media, thicknesses, row.wavelengths_nm, [row.theta_rad])
            both = found[key]
            seen = {"s": both.R_s, "p": both.R_p, "both": 0.5 * (both.R_s + both.R_p)}[row.polarisation]
            spectra.append(seen[:, 0])
        return np.concatenate(spectra, axis=1)


def stack_batch(
    make: Callable[[Mapping[str, Any]], Material],
    causes: Sequence[Component],
    observations: Sequence[Any],
    simulated: Callable[[Material, Sequence[Any]], Array],
) -> StackBatch | None:
    """Return the batch, or None if it does not give the same values as the material itself.

    Args:
        make: from path -> number to the material.
        causes: of variation.
        observations: measured spectra.
        simulated: values `[value]` of observations of one material.
    """
    points = np.concatenate([np.zeros((1, len(causes))), PROBE * np.eye(len(causes)), -PROBE * np.eye(len(causes))])
    numbers = values_at(causes, points)
    nominal = {path: float(column[0]) for path, column in numbers.items()}
    first = make(nominal)
    stack = _coherent_stack(first)
    if stack is None:
        return None
    rows = _rows(observations, stack)
    if rows is None:
        return None
    slopes = {}
    for path, column in numbers.items():
        moved = float(column[np.argmax(np.abs(column - nominal[path]))])
        other = _coherent_stack(make(nominal | {path: moved}))
        if other is None or len(other.layers) != len(stack.layers) or moved == nominal[path]:
            return None
        slopes[path] = (other.thicknesses_nm - stack.thicknesses_nm) / (moved - nominal[path])
    batch = StackBatch(stack.thicknesses_nm, slopes, nominal, rows)
    fast = batch.values(numbers)
    for number, values in enumerate(fast):
        made = make({path: float(column[number]) for path, column in numbers.items()})
        exact = simulated(made, observations)
        if exact.shape != values.shape or not np.allclose(values, exact, rtol=0.0, atol=EXACT):
            return None
    return batch


def _coherent_stack(made: Material) -> Stack | None:
    if not isinstance(made.model, SpecularStack):
        return None
    try:
        stack = made.model.specular_stack
    except UnsupportedError:
        return None
    return stack if stack.layers and stack.is_isotropic and stack.is_coherent else None


def _rows(observations: Sequence[Any], stack: Stack) -> tuple[_Row, ...] | None:
    """Return the spectra of the observations, or None if one is no reflectance of a smooth surface."""
    rows = []
    known: dict[bytes, ComplexArray] = {}
    for each in observations:
        grid = np.asarray(getattr(each, "wavelengths_nm", np.zeros(0)), dtype=float)
        asked = _asked(each)
        if asked is None or not grid.size:
            return None
        indices = known.setdefault(grid.tobytes(), stack.indices(grid))
        rows += [_Row(grid, float(np.radians(angle)), polarisation, indices) for angle, polarisation in asked]
    return tuple(rows)


def _asked(observation: Any) -> list[tuple[float, str]] | None:
    """Return angle in degrees and polarisation for each spectrum in an observation."""
    angle = getattr(observation, "angle_deg", None)
    if angle is not None:
        is_known = not observation.is_transmitted and observation.polarisation in PARTS.values()
        return [(float(angle), observation.polarisation)] if is_known else None
    parts = getattr(observation, "parts", ())
    if getattr(observation, "kind", "") != "spectrum" or not parts or any(part not in PARTS for part in parts):
        return None
    return [(float(each), PARTS[part]) for part in parts for each in observation.angles_deg]
