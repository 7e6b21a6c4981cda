"""Supercells of Morpho ridges: where their lamellae stand, and Maxwell's equations in them.

A cell holds `RIDGES` neighbouring ridges along y, each a stack of lamellae of one width on a pedestal of cuticle over a
flat membrane; the pedestals' heights are drawn. The plane of incidence lies across the ridges. Solved by rigorous
coupled waves with the inverse rule (Li, J. Opt. Soc. Am. A 13, 1870 (1996)): between two neighbouring faces the
permittivity depends on x alone, and the ratio of the two tangential fields, a matrix over the orders, is carried upward
through thin steps. No eigenvalues are sought: faces of 8 ridges lie some 14 nm apart, where a power series is cheaper.
Time goes as exp(-i omega t), an index is n + ik, lengths are in nanometres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation._gratings import efficiencies, normal_parts

Array = NDArray[Any]
RIDGES = 8
FARTHEST = 3.0  # draws further out, in standard deviations, are drawn again: pedestals cannot be lower than nothing
STEP = 2.0  # longest step, over the decay length of the fastest order
LEFT_OUT = 1e-9  # what the series of a step may lack


@dataclass(frozen=True)
class Ridge:
    """One ridge of a recipe: `lamellae` of `lamella_nm` with `gap_nm` of air between, `width_nm` wide."""

    lamella_nm: float
    gap_nm: float
    lamellae: int
    width_nm: float
    pitch_nm: float
    height_deviation_nm: float
    n: complex

    @property
    def period_nm(self) -> float:
        """Of a supercell."""
        return RIDGES * self.pitch_nm


def drawn_heights(ridge: Ridge, draw: int) -> Array:
    """Heights `[RIDGES]` in nm of one supercell's pedestals over the membrane, by a seed."""
    random = np.random.default_rng([draw, RIDGES])
    found: list[float] = []
    while len(found) < RIDGES:
        value = float(random.normal())
        if abs(value) < FARTHEST:
            found.append(value)
    return ridge.height_deviation_nm * (FARTHEST + np.array(found)).round(3)


def faces(ridge: Ridge, heights: Array) -> tuple[Array, Array]:
    """Thicknesses `[layer]` in nm from the membrane upward, and which ridges hold cuticle there, `[layer, ridge]`."""
    bottoms = heights[:, None] + np.arange(ridge.lamellae) * (ridge.lamella_nm + ridge.gap_nm)
    levels = np.unique(np.concatenate([[0.0], heights, bottoms.ravel(), (bottoms + ridge.lamella_nm).ravel()]).round(6))
    middle = 0.5 * (levels[1:] + levels[:-1])[:, None, None]
    inside = np.any((middle > bottoms) & (middle < bottoms + ridge.lamella_nm), axis=2) | (middle[:, 0] < heights)
    return np.diff(levels), inside


def boxes(inside: Array, value: complex, outside: complex, ridge: Ridge, numbers: Array) -> Array:
    """Matrix that multiplies by `value` in the ridges that hold cuticle and by `outside` elsewhere, by exact series."""
    span = np.arange(numbers[0] - numbers[-1], numbers[-1] - numbers[0] + 1)
    share = ridge.width_nm / ridge.period_nm
    centres = (np.arange(RIDGES) + 0.5) / RIDGES
    phases = np.exp(-2j * np.pi * span[:, None] * centres) @ inside.astype(float)
    series = (value - outside) * share * np.sinc(span * share) * phases
    series[len(numbers) - 1] += outside
    return np.asarray(series[numbers[:, None] - numbers[None, :] + len(numbers) - 1])


def reflected(
    ridge: Ridge, heights: Array, wavelength_nm: float, angle_deg: float, is_p: bool, truncation: int
) -> tuple[Array, Array]:
    """Return the reflected orders that propagate and their efficiencies.

    Args:
        heights: `[RIDGES]` in nm, of the pedestals over the membrane.
        truncation: orders to each side of 0.
    """
    numbers = np.arange(-truncation, truncation + 1)
    alpha = np.sin(np.radians(angle_deg)) + numbers * wavelength_nm / ridge.period_nm
    one, kx = np.eye(len(numbers)), np.diag(alpha)
    wave = 2 * np.pi / wavelength_nm
    # F' = i k0 X P and P' = i k0 Z F with F = E_y, X = 1 in s and F = H_y, P = -E_x in p; ratio: P = ratio F
    ratio = np.diag(-normal_parts(ridge.n, alpha) / (ridge.n**2 if is_p else 1.0))
    thicknesses, inside = faces(ridge, heights)
    fastest = float(abs(ridge.n) * np.sqrt(1 + alpha.max() ** 2))
    for thickness, filled in zip(thicknesses, inside):
        epsilon = boxes(filled, ridge.n**2, 1.0, ridge, numbers)
        if is_p:
            x = np.linalg.inv(boxes(filled, ridge.n**-2, 1.0, ridge, numbers))
            z = one - alpha[:, None] * np.linalg.solve(epsilon, kx)
        else:
            x, z = None, epsilon - kx @ kx
        whole = wave * thickness * fastest
        steps = int(np.ceil(whole / STEP))
        ratio = _carried(ratio, x, z, wave * thickness / steps, steps, whole / steps)
    above = normal_parts(1.0, alpha)
    incident = (numbers == 0).astype(complex)
    field = np.linalg.solve(np.diag(above) - ratio, (np.diag(above) + ratio) @ incident)
    return efficiencies(numbers, alpha, field)


def _carried(ratio: Array, x: Array | None, z: Array, phase: float, steps: int, reach: float) -> Array:
    """The ratio of fields `steps` steps higher, each of `phase` = k0 d; x None: 1; `reach`: of its root, about."""
    one = np.eye(len(z))
    terms = 2
    while reach ** (2 * terms) / math.factorial(2 * terms) > LEFT_OUT:
        terms += 1
    squared = phase**2 * (z if x is None else x @ z)
    # cos and sin(q)/q of the root q of `squared`, as two polynomials in it (Horner)
    sine, rest = one.astype(complex), one.astype(complex)
    for k in range(terms, 1, -1):
        sine = one - squared @ sine / ((2 * k - 2) * (2 * k - 1))
        rest = one - squared @ rest / ((2 * k - 1) * 2 * k)
    # cos = 1 - squared/2 rest; on the side of P, where z x stands for x z: 1 - phase^2/2 z rest x
    cosine = one - 0.5 * squared @ rest
    other = cosine if x is None else one - 0.5 * phase**2 * (z @ rest @ x)
    up = 1j * phase * (sine if x is None else sine @ x)
    down = 1j * phase * (z @ sine)
    for _ in range(steps):
        ratio = np.linalg.solve((cosine + up @ ratio).T, (down + other @ ratio).T).T
    return ratio
