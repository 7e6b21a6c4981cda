"""Azimuths at which the orders of lines are solved for a table, and the interpolation between them.

Near a Rayleigh anomaly, at which an order begins to propagate, efficiencies change as the square root of the distance.
Between anomalies at azimuths a and b they are smooth in s, with azimuth = (a + b) / 2 + (b - a) / 2 sin(pi s / 2),
which makes the square root linear at both ends. Chebyshev polynomials in s then need few nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from nacre.matter.periodic.structure import PeriodicStack
from nacre.matter.periodic.types import Array

LEAST_NODES = 4  # between two anomalies
NODES_PER_RAD = 6.4  # further nodes: one per 9 degrees
CLOSEST_RAD = float(np.radians(1.0))  # an anomaly nearer than this to the last one is smoothed


@dataclass(frozen=True, eq=False)
class AzimuthNodes:
    """Nodes from azimuth 0 to an end.

    Attributes:
        edges: `[segment + 1]`, the anomalies and both ends, rad.
        counts: `[segment]`, nodes in each.
    """

    edges: Array
    counts: tuple[int, ...]

    @property
    def azimuths(self) -> Array:
        """`[node]`, rad."""
        middles, halves = 0.5 * (self.edges[1:] + self.edges[:-1]), 0.5 * np.diff(self.edges)
        return np.concatenate(
            [m + h * np.sin(0.5 * np.pi * _nodes(n)) for m, h, n in zip(middles, halves, self.counts, strict=True)]
        )

    def interpolate(self, values: Array, azimuths: Array) -> Array:
        """Return `[azimuth, ...]` from values at the nodes `[node, ...]`; every azimuth lies between 0 and the end."""
        found = np.empty((len(azimuths), *values.shape[1:]))
        segment = np.clip(np.searchsorted(self.edges, azimuths, side="right") - 1, 0, len(self.counts) - 1)
        first = 0
        for k, count in enumerate(self.counts):
            a, b = self.edges[k : k + 2]
            at = segment == k
            s = np.arcsin(np.clip((2.0 * azimuths[at] - a - b) / (b - a), -1.0, 1.0)) * (2.0 / np.pi)
            inverse = np.linalg.inv(chebyshev.chebvander(_nodes(count), count - 1))
            matrix = chebyshev.chebvander(s, count - 1) @ inverse
            found[at] = np.tensordot(matrix, values[first : first + count], axes=1)
            first += count
        return found


def azimuth_nodes(stack: PeriodicStack, wavelength_nm: float, theta_rad: float, end_rad: float) -> AzimuthNodes:
    """Return the nodes for one incidence angle and wavelength; the light comes from azimuths 0 to `end_rad`."""
    step, sine = wavelength_nm / stack.cell.period_x, stack.cover * np.sin(theta_rad)
    indices = [stack.cover, *([stack.substrate.real] if stack.is_clear else [])]
    found = [0.0]
    if sine > 0.0:
        highest = int(np.ceil((max(indices) + sine) / step))
        shift = step * np.concatenate([np.arange(-highest, 0), np.arange(1, highest + 1)])
        # |k_t + order|^2 = n^2 of the light's medium or of the substrate
        cosines = np.concatenate([(n**2 - sine**2 - shift**2) / (2.0 * sine * shift) for n in indices])
        for azimuth in np.sort(np.arccos(cosines[np.abs(cosines) < 1.0])).tolist():
            if found[-1] + CLOSEST_RAD < azimuth < end_rad - CLOSEST_RAD:
                found.append(azimuth)
    edges = np.array([*found, end_rad])
    counts = np.ceil(LEAST_NODES + NODES_PER_RAD * np.diff(edges)).astype(int)
    return AzimuthNodes(edges, tuple(counts.tolist()))


def _nodes(count: int) -> Array:
    return np.cos((np.arange(count) + 0.5) * (np.pi / count))
