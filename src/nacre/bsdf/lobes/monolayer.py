"""What the lobes of monolayers have in common: a grid of polar angles on each side, and where light passes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.arrays import Array
from nacre.bsdf.contract import Lobe
from nacre.matter.jit import compiled


@dataclass(frozen=True)
class PolarGrid:
    """Polar angles of one side of a surface, uniform in a coordinate x = 0..count-1.

    Above, and below down to the critical angle, x is uniform in the angle of the rarer medium; beyond, the root
    of the distance to the critical angle takes over. Fields have a square-root kink there, which this resolves.

    Attributes:
        count: nodes below the critical angle (all of them above).
        beyond: nodes beyond the critical angle; 0 above.
        eta: index of this side over the other's; 1 above.
    """

    count: int
    beyond: int = 0
    eta: float = 1.0

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.count + self.beyond

    @property
    def critical_rad(self) -> float:
        """The critical angle; pi/2 where there is none."""
        return float(np.arcsin(min(1.0, 1.0 / self.eta)))

    def theta(self, x: ArrayLike) -> Array:
        """Return the angle against the normal, in this side's medium, rad, at coordinates x >= 0."""
        x = np.asarray(x, dtype=float)
        edge = self.count - 0.5
        outer = np.sin(np.clip(x / edge, 0.0, 1.0) * np.pi / 2)
        inner = np.arcsin(np.clip(outer / self.eta, 0.0, 1.0))
        if self.beyond == 0:
            return inner
        u = np.clip((x - edge) / self.beyond, 0.0, 1.0)
        return np.where(x <= edge, inner, self.critical_rad + u**2 * (np.pi / 2 - self.critical_rad))

    @property
    def nodes(self) -> Array:
        """Angles of the nodes, rad, `[node]`."""
        return self.theta(np.arange(self.size))

    @property
    def weights(self) -> Array:
        """Solid-angle weights dmu of the cells round the nodes, `[node]`; they sum to 1."""
        edges = np.cos(self.theta(np.concatenate([[0.0], np.arange(self.size - 1) + 0.5, [self.size - 0.5]])))
        edges[0], edges[-1] = 1.0, 0.0
        return edges[:-1] - edges[1:]


@compiled(nogil=True)
def coordinate(sine, cosine, count, beyond, eta):  # type: ignore[no-untyped-def]  # numba
    edge = count - 0.5
    outer = eta * sine
    if outer < 1.0 or beyond == 0:
        x = np.arctan2(sine, cosine) if eta == 1.0 else np.arcsin(min(outer, 1.0))
        x = x * (2.0 / np.pi) * edge
    else:
        critical = np.arcsin(1.0 / eta)
        x = edge + beyond * np.sqrt(max(np.arctan2(sine, cosine) - critical, 0.0) / (0.5 * np.pi - critical))
    return min(max(x, 0.0), count + beyond - 1.0)


class MonolayerLobe(Lobe):
    """Diffuse light of a monolayer, tabulated over the polar angles of both directions.

    Attributes:
        count_above, count_below, count_beyond: nodes of `PolarGrid` above, and below; 0 below what is opaque.
        eta: index of the substrate over the ambient's, one number, as for the specular lobe.
        wavenumbers: `[wavelength]`, k of the ambient, 1/nm.
        index_below: `[wavelength]`, index of the substrate over the ambient's; ones where nothing is transmitted.
        q_step: step of `structure` in 1/nm, from 0.
        structure: `[q]`, the structure factor; 1 beyond the table.
    """

    count_above: int
    count_below: int
    count_beyond: int
    eta: float
    wavenumbers: Array
    index_below: Array
    q_step: float
    structure: Array

    @property
    def transmits(self) -> bool:
        """Whether light is transmitted to the other side."""
        return self.count_below > 0

    @property
    def grid_below(self) -> PolarGrid:
        """Polar angles below."""
        return PolarGrid(self.count_below, self.count_beyond, self.eta)

    @property
    def grids(self) -> NDArray[np.int64]:
        """Nodes up to the critical angle and beyond, `[side, 2]`, as the kernels read them."""
        return np.array([[self.count_above, 0], [self.count_below, self.count_beyond]])

    @property
    def last_cosines(self) -> Array:
        """Cosines of the last nodes above and below, from where f falls to zero as the cosine does, `[2]`."""
        sides = (PolarGrid(self.count_above), self.grid_below)
        return np.array([np.cos(side.nodes[-1]) if side.size else 1.0 for side in sides])

    def check_grids(self, wavelengths: int) -> None:
        """Check what both kinds of tables stand on.

        Args:
            wavelengths: of the tables.

        Raises:
            ValueError: saying what does not fit.
        """
        below = self.count_below + self.count_beyond
        if self.count_above < 2 or (below and self.count_below < 2) or self.count_beyond < 0 or not self.eta >= 1.0:
            raise ValueError(f"the {self.kind} lobe needs two angles a side and eta >= 1")
        if wavelengths != len(self.wavelengths_nm) or not self.q_step > 0 or len(self.structure) < 2:
            raise ValueError("wavelengths or structure do not fit")
        if self.wavenumbers.shape != self.wavelengths_nm.shape or self.index_below.shape != self.wavelengths_nm.shape:
            raise ValueError("wavenumbers or index_below do not fit")
