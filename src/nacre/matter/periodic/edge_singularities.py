"""Singular fields at the edges of metal, which set how fast errors fall as elements shrink.

Near an edge the potential goes as r^lambda. Elements of size h leave an amplitude error of order h^(2 lambda). With
metal, lambda can be small and complex, so that errors fall slowly and oscillate (Meixner, IEEE Trans. Antennas
Propag. 20, 442 (1972); Li and Granet, J. Opt. Soc. Am. A 28, 738 (2011)).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from nacre.matter.periodic.element_solver import ovals, region_values
from nacre.matter.periodic.lamellar_solver import is_patterned, values_at
from nacre.matter.periodic.line_basis import regions
from nacre.matter.periodic.line_elements import wall_lines
from nacre.matter.periodic.structure import PeriodicStack, Rectangle, WallsMeetError
from nacre.matter.periodic.types import Array

Sectors = tuple[tuple[complex, float], ...]  # permittivity and angle of each sector around an edge
Layer = tuple[Array, Array, Array]  # permittivity left and right of each wall, and the wall's angle to x
ITERATIONS = 25  # Newton iterations
LEAST = 0.02  # real part: it vanishes at some edges of metal without loss


def singular_exponent(stack: PeriodicStack) -> float | None:
    """Return the least real part of lambda at edges of metal; None without such edges."""
    metal = {edge for edge in _edges(stack) if min(epsilon.real for epsilon, _ in edge) < 0.0}
    return max(min(edge_exponent(edge).real for edge in metal), LEAST) if metal else None


@lru_cache(maxsize=256)
def edge_exponent(sectors: Sectors) -> complex:
    """Return lambda with the least real part, at most 1, of sectors around an edge."""
    real, imaginary = np.meshgrid(np.linspace(0.03, 1.0, 14), np.linspace(-1.2, 1.2, 13))
    root = (real + 1j * imaginary).ravel()

    def remainder(at: Array) -> Array:
        """Return (trace - 2) / lambda^2 of the matrix that carries the potential and the flux once around."""
        total = np.broadcast_to(np.eye(2, dtype=complex), (*at.shape, 2, 2))
        for epsilon, angle in sectors:
            c, s = np.cos(at * angle), np.sin(at * angle)
            total = np.stack([np.stack([c, s / epsilon], -1), np.stack([-epsilon * s, c], -1)], -2) @ total
        return np.asarray((total[:, 0, 0] + total[:, 1, 1] - 2.0) / at**2)

    for _ in range(ITERATIONS):
        value = remainder(root)
        slope = (remainder(root + 1e-6) - value) / 1e-6
        step = value / np.where(slope == 0.0, 1.0, slope)
        root = root - step / np.maximum(1.0, np.abs(step) / 0.2)
    root = np.where(root.real < 0.0, -root, root)
    roots = root[(np.abs(remainder(root)) < 1e-6) & (np.abs(root) > 1e-2) & (root.real < 1.0)]
    return complex(roots[np.argmin(roots.real)]) if len(roots) else 1.0 + 0j


def _edges(stack: PeriodicStack) -> list[Sectors]:
    """Return the sectors around each edge."""
    outside = complex(stack.cover) ** 2, complex(stack.substrate) ** 2
    if stack.profile is not None:
        media = (outside[0], *(complex(layer.epsilon) for layer in stack.layers), outside[1])
        corners, steepness = np.array(stack.profile.corners), stack.profile.depth_nm / stack.cell.period_x
        left, right = (np.arctan(steepness * stack.profile.slope((corners + d) % 1.0)) for d in (-1e-6, 1e-6))
        edges = [
            ((one, float(angle)), (other, 2.0 * np.pi - float(angle)))
            for angle in np.pi + left - right
            for one, other in zip(media, media[1:], strict=False)
        ]
        return [joined for edge in edges if (joined := _joined(edge))]
    layers = _layers(stack)
    if not layers:
        return []
    flat = np.full(len(layers[0][0]), 0.5 * np.pi)
    cover, substrate = ((np.full(len(flat), value), np.full(len(flat), value), flat) for value in outside)
    every, merged = [cover, *layers, substrate], []
    for above, below in zip(every, every[1:], strict=False):
        for (a, b, up), (c, d, down) in zip(zip(*above, strict=True), zip(*below, strict=True), strict=True):
            edge = ((complex(b), up), (complex(a), np.pi - up), (complex(c), down), (complex(d), np.pi - down))
            merged.append(_joined(edge))
    return [edge for edge in merged if edge]


def _layers(stack: PeriodicStack) -> list[Layer]:
    """Return the layers from the top down, with all walls in each; empty without walls."""
    if stack.cell.period_y is not None:
        walls = ovals(stack)
        each = [np.array(region_values(layer, walls)) for layer in stack.layers] if walls else []
        return [(value[:-1], value[1:], np.full(len(walls), 0.5 * np.pi)) for value in each]
    period = stack.cell.period_x
    tilted = [each for each in stack.tilted or () if each[0].thickness_nm > 0.0]
    layers = [layer for layer, _ in tilted] or list(stack.layers)
    at = [k for k, layer in enumerate(layers) if is_patterned(layer)]
    if not at:
        return []
    x = np.array([x for layer in layers for s, _ in layer.shapes if isinstance(s, Rectangle) for x in (s.x_0, s.x_1)])
    starts, middles = regions(period, x)
    places = np.tile(starts, (at[-1] - at[0] + 2, 1))
    if tilted:
        try:
            places = wall_lines(tilted[at[0] : at[-1] + 1], period)
        except WallsMeetError:
            return []
    filled = []
    for k, layer in enumerate(layers):
        top, bottom = (places[np.clip(k + j - at[0], 0, len(places) - 1)] for j in (0, 1))
        middle = 0.5 * (top + bottom)
        middles = 0.5 * (middle + np.append(middle[1:], middle[:1] + period))
        right = values_at(layer, middles, period)
        filled.append((np.roll(right, 1), right, np.arctan2(layer.thickness_nm, top - bottom)))
    return filled


def _joined(edge: Sectors) -> Sectors:
    """Return an edge with neighbouring sectors of one medium as one; empty if a flat face is left."""
    merged: list[tuple[complex, float]] = []
    for epsilon, angle in edge:
        if merged and merged[-1][0] == epsilon:
            angle += merged.pop()[1]
        merged.append((epsilon, angle))
    if len(merged) > 1 and merged[0][0] == merged[-1][0]:
        merged[0] = merged[0][0], merged[0][1] + merged.pop()[1]
    is_flat = len(merged) == 2 and abs(merged[0][1] - np.pi) < 1e-9
    return tuple((epsilon, round(angle, 9)) for epsilon, angle in merged) if len(merged) > 1 and not is_flat else ()
