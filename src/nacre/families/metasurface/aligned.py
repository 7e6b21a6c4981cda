"""A monolayer of particles that all point one way: its coherent light, and how each answers among its neighbours.

The arrangement is the same in all directions, so what neighbours send depends on the light's own azimuth phi alone by
phases: Q(phi) = e^(i (m' - m) phi) Q(0). In a frame that turns with the light, Q is that of any monolayer and the
particle is turned by -phi: M -> e^(i m phi) M e^(-i m' phi). There b = (M^-1 - Q)^-1 v is solved at each azimuth, all
orders m coupled. Azimuths here are those of in-plane wavevectors; the light of a direction at azimuth a runs at a + pi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.monolayer import Monolayer
from nacre.families.metasurface.neighbours import MultipoleIndex, multipole_index, unfolded, with_negative_orders
from nacre.families.metasurface.qca import sums_at
from nacre.families.metasurface.sphere import Directions, dressed_matrix
from nacre.families.metasurface.whole import kept_index, spread, truncated_whole


@dataclass(frozen=True)
class AlignedLit:
    """Directions of one side with the response of a particle among its neighbours to light from there.

    Attributes:
        directions: excitation and emission vectors.
        emission: u, `[pol, n, angle]`, at the azimuth 0.
        response: b in the frame that turns with the light, `[azimuth, pol, n, angle]`.
    """

    directions: Directions
    emission: ComplexArray
    response: ComplexArray


@dataclass(frozen=True)
class AlignedLayer:
    """Aligned particles on a stack at one wavelength.

    Attributes:
        mean: the monolayer of the particle's mean over its turn: the stack, the arrangement, the neighbours' sums.
        whole: T over all m of one particle as it stands, `[n, n']`, at least of the multipoles of `mean`.
    """

    mean: Monolayer
    whole: ComplexArray

    @cached_property
    def index(self) -> MultipoleIndex:
        """The multipoles, flat."""
        return self._kept[0]

    @cached_property
    def _kept(self) -> tuple[MultipoleIndex, NDArray[np.intp]]:
        alone = self.mean.spheres[0]
        return kept_index(alone.lmax, alone.mmax)

    @cached_property
    def dressed(self) -> ComplexArray:
        """M = (T^-1 - W)^-1 of the particle over its stack, `[n, n']`."""
        index, kept = self._kept
        t = truncated_whole(self.whole, index.order)[kept[:, None], kept]
        return np.asarray(dressed_matrix(t[None], spread(self.mean.spheres[0].coupling, index)[None])[0])

    @cached_property
    def _exchanged(self) -> tuple[int, NDArray[np.intp]]:
        """The order up to which neighbours exchange multipoles, and the places of these in `index`."""
        order = min(self.mean.interaction_order, self.index.order, self.mean.spheres[0].mmax)
        places = {k: i for i, k in enumerate(zip(self.index.m, self.index.tau, self.index.l, strict=True))}
        few = multipole_index(order)
        return order, np.array([places[key] for key in zip(few.m, few.tau, few.l, strict=True)])

    def light(
        self, cosines: Array, azimuths: Array, below: bool = False, sines: Array | None = None, at_once: bool = False
    ) -> AlignedLit:
        """Return the directions at `cosines` of one side, and the response to light whose wavevector has `azimuths`.

        With `at_once` the neighbours' sums are made at these few angles and not tabulated.
        """
        directions = self.mean.spheres[0].directions(cosines, below, sines)
        order, few = self._exchanged
        if at_once:
            mean = self.mean
            folded = sums_at(mean.surface, mean.mean_centre_nm, mean.structure, order, directions, mean.sees_neighbours)
        else:
            folded = self.mean.neighbours.at(directions)
        sums = unfolded(folded, order)  # angle, n, n'
        v = with_negative_orders(directions.excitation, self.index)
        phase = np.exp(1j * np.multiply.outer(azimuths, self.index.m))  # azimuth, n
        turn = phase[:, None, :, None]
        own = turn * (self.dressed @ (turn.conj() * v))  # azimuth, pol, n, angle
        here = phase[:, few]
        among = here[:, :, None] * self.dressed[few[:, None], few] * here.conj()[:, None, :]
        system = np.eye(len(few)) - among[:, None] @ sums  # azimuth, angle, n, n'
        met = np.linalg.solve(system, own[:, :, few].transpose(0, 3, 2, 1))
        added = (sums @ met).transpose(0, 3, 2, 1)  # azimuth, pol, n, angle
        passed = self.dressed[:, few] @ (here.conj()[:, None, :, None] * added)
        return AlignedLit(directions, with_negative_orders(directions.emission, self.index), own + turn * passed)

    def leaving(self, cosines: Array, below: bool) -> Directions:
        """Return directions of one side as light leaves to them."""
        return self.mean.spheres[0].directions(cosines, below)

    def coherent_sum(self, emission: ComplexArray, lit: AlignedLit) -> ComplexArray:
        """Return F towards the reflected or the refracted direction of each of `lit`, nm, `[azimuth, q, p, angle]`."""
        return np.asarray(np.einsum("qna,fpna->fqpa", emission, lit.response) / self.mean.surface.inner_wavenumber)

    def specular_above(self, cosines: Array, azimuths: Array, at_once: bool = False) -> tuple[Array, Array]:
        """Power reflectance and transmittance of the coherent light from above, `[azimuth, pol, angle]`.

        Both polarisations that a wave turns into count.
        """
        layer = self.mean
        k, rho = layer.surface.wavenumber, layer.structure.density_per_nm2
        lit = self.light(cosines, azimuths, at_once=at_once)
        r = 2 * np.pi * rho / (k * cosines) * self.coherent_sum(lit.emission, lit) + _both(lit.directions.reflection)
        reflected = np.sum(np.abs(r) ** 2, axis=1)
        if not layer.has_below:
            return reflected, np.zeros(reflected.shape)
        out, cos_below, bare = layer.refracted(cosines)
        sent = self.coherent_sum(with_negative_orders(out[0].emission, self.index), lit)
        t = 2 * np.pi * rho / (k * cos_below) * sent + _both(bare)
        return reflected, cos_below / cosines * np.sum(np.abs(t) ** 2, axis=1)

    def specular_below(self, cosines: Array, azimuths: Array) -> Array:
        """Power reflectance of the coherent light from below, `[azimuth, pol, angle]`."""
        layer = self.mean
        k, rho = layer.surface.wavenumber, layer.structure.density_per_nm2
        lit = self.light(cosines, azimuths, below=True)
        first = lit.directions
        summed = self.coherent_sum(lit.emission, lit)
        r = 2 * np.pi * rho / (k * cosines * first.index) * summed + _both(first.reflection)
        return np.asarray(np.sum(np.abs(r) ** 2, axis=1))


def _both(amplitudes: ComplexArray) -> ComplexArray:
    """Return the amplitudes of s and p, `[pol, angle]`, as those of a stack that turns neither, `[q, p, angle]`."""
    return np.asarray(np.eye(2)[:, :, None] * amplitudes[None])
