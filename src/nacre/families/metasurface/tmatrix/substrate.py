"""How a stack sends plane waves of multipoles back to where they came from: what all integrals over it are made of.

Over a stack a wave that goes down comes back up, and that is all. In a layer both faces reflect: with R_b and R_a the
reflections below and above, phase at the centre, waves sent down (up) come back up (down) with R_b (R_a) over
1 - R_a R_b, and either in its own direction with R_a R_b over the same. Between centres at unlike heights the phases of
the first two count from the mean height; in its own direction a wave that rises gathers more on its way to the higher.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, ComplexArray
from nacre.families.metasurface.tmatrix.special_functions import adjoint, mirrored
from nacre.matter.stack import solve as solver


@dataclass(frozen=True)
class Echo:
    """What comes back of plane waves, `[pol, angle]` each, phase at the centre of the particle.

    Attributes:
        up: of a wave sent down, which comes back up.
        down: of one sent up, which comes back down; None: nothing reflects above.
        risen: of one sent up, in its own direction; None: nothing reflects above.
        fallen: of one sent down, in its own direction; None: nothing reflects above.
    """

    up: ComplexArray
    down: ComplexArray | None = None
    risen: ComplexArray | None = None
    fallen: ComplexArray | None = None

    @classmethod
    def between(
        cls, below: ComplexArray, above: ComplexArray, risen: ComplexArray | None = None,
        fallen: ComplexArray | None = None,
    ) -> Echo:  # fmt: skip
        """Return it for two mirrors that see one another, R_b and R_a.

        Args:
            risen, fallen: R_a R_b with the phases of a wave on its way to another height; R_a R_b of one height.
        """
        both = below * above
        left = 1.0 - both
        return cls(
            below / left, above / left, (both if risen is None else risen) / left,
            (both if fallen is None else fallen) / left,
        )  # fmt: skip

    def pairs(self, b: ComplexArray) -> list[tuple[ComplexArray, ComplexArray]]:
        """Return what comes to multipole n and what n' sent, `[m, pol, n, angle]` each: sums of products over both.

        sum_pairs left_n right_n' = Bdag_n(+) (up B_n'(-) + risen B_n'(+)) + Bdag_n(-) (down B_n'(+) + fallen B_n'(-)).

        Args:
            b: B(+) of the angles, `[m, pol, n, angle]`.
        """
        rising = adjoint(b)
        if self.down is None or self.risen is None or self.fallen is None:
            return [(rising * _wide(self.up), mirrored(b))]
        falling = mirrored(rising)
        return [
            (rising * _wide(self.up) + falling * _wide(self.fallen), mirrored(b)),
            (falling * _wide(self.down) + rising * _wide(self.risen), b),
        ]

    def signed(self, pol: int, target: Array, source: Array) -> ComplexArray:
        """Return the factor of Bdag_n(+) B_n'(+), `[angle, n or 1, n']`, by the signs that a mirror gives to n and n'.

        Args:
            pol: of the waves.
            target, source: signs, `[n]` and `[n']`.
        """
        out: ComplexArray = self.up[pol][:, None, None] * source
        if self.down is not None and self.risen is not None and self.fallen is not None:
            out = out + self.down[pol][:, None, None] * target[:, None] + self.risen[pol][:, None, None]
            out = out + self.fallen[pol][:, None, None] * (target[:, None] * source)
        return out


def _wide(values: ComplexArray) -> ComplexArray:
    return values[None, :, None, :]


# The planar stack under the particles, or around them, at one wavelength, as they see it.

LOSSLESS_K = 1e-4  # a substrate with k below this is transparent, as for films


@dataclass(frozen=True)
class Arriving:
    """Plane waves of one side as a particle meets them, `[pol, angle]`, phase at its centre.

    Attributes:
        ahead: the part that still travels as the light came.
        back: the part that a mirror beyond the particle has turned round; None: there is none.
        reflection: of the bare stack, back to where the light came from.
        transmission_up: of the bare stack, for light from the substrate; None for light from above.
    """

    ahead: ComplexArray
    back: ComplexArray | None
    reflection: ComplexArray
    transmission_up: ComplexArray | None


@dataclass(frozen=True)
class Substrate:
    """A stack at one wavelength.

    Attributes:
        wavelength_nm: in vacuum.
        indices: `[medium]`, complex, from the ambient (lossless) through the layers to the substrate.
        thicknesses_nm: `[layer]`.
    """

    wavelength_nm: float
    indices: ComplexArray
    thicknesses_nm: Array

    @property
    def ambient_index(self) -> float:
        """Index of the medium around the particles."""
        return float(self.indices[0].real)

    @property
    def wavenumber(self) -> float:
        """k of the ambient medium, 1/nm."""
        return 2 * np.pi * self.ambient_index / self.wavelength_nm

    @property
    def inner_index(self) -> float:
        """Index of the medium that the particles lie in: the ambient."""
        return self.ambient_index

    @property
    def inner_wavenumber(self) -> float:
        """k of the medium that the particles lie in, 1/nm."""
        return 2 * np.pi * self.inner_index / self.wavelength_nm

    @property
    def inner_nm(self) -> float:
        """Thickness of the layer that the particles lie in; 0 where they lie over the stack."""
        return 0.0

    def clear_nm(self, centre_nm: float) -> float:
        """Return how far the nearest mirror is from a centre, of the height `centre_nm` over what lies below."""
        return centre_nm

    @cached_property
    def operators(self) -> dict[float, ComplexArray]:
        """The last reflection operator W_m `[m, n, n']` of each height of a centre, kept by who computes them."""
        return {}

    @property
    def is_transparent(self) -> bool:
        """Whether light propagates in the substrate without loss."""
        return abs(self.indices[-1].imag) < LOSSLESS_K

    @property
    def index_below(self) -> float:
        """Index of the substrate over the ambient's, its real part."""
        return float(self.indices[-1].real) / self.ambient_index

    @property
    def is_absent(self) -> bool:
        """Whether there is nothing below: every medium is the ambient."""
        return bool(np.all(np.abs(self.indices - self.indices[0]) < 1e-12))

    def reflection(self, w: NDArray) -> ComplexArray:
        """Return r_s, r_p, `[pol, angle]`, for light from the ambient at w = kz/k; phase at the stack's top."""
        found = solver.amplitudes(
            self.indices[:, None],
            self.thicknesses_nm,
            [self.wavelength_nm],
            kz=self.ambient_index * np.asarray(w),
            jobs=1,
        )
        return np.stack([found.r_s[:, 0], found.r_p[:, 0]])

    def echo(self, centre_nm: float, w: NDArray, lift_nm: float = 0.0) -> Echo:
        """Return what comes back to a centre of plane waves at w = kz/k in the medium of the particles.

        Args:
            centre_nm: height of the centre, or the mean of the one that sends and the one that is met.
            lift_nm: by how much the one that is met lies higher; over a stack the mean alone counts.
        """
        return Echo(np.exp(2j * self.inner_wavenumber * centre_nm * w) * self.reflection(w))

    def arriving(self, centre_nm: float, cosines: Array, w: ComplexArray, below: bool) -> Arriving:
        """Return what light of one side is at a centre.

        Args:
            cosines: of the light on its side.
            w: kz/k in the medium of the particles.
        """
        # b = e^{ikd cos} moves the phase reference from the stack's top to the centre
        b = np.exp(1j * self.inner_wavenumber * centre_nm * w)
        if below:
            reflection, transmission = self.from_below(cosines)
            # by reciprocity t_down kz_below/kz = t_up: one amplitude serves both the way in and the way out
            return Arriving(transmission * b, None, reflection, transmission)
        reflection = self.reflection(w)
        return Arriving(np.broadcast_to(1 / b, reflection.shape), reflection * b, reflection, None)

    def from_below(self, cos_below: NDArray) -> tuple[ComplexArray, ComplexArray]:
        """Return reflection and transmission amplitudes, `[pol, angle]`, for light from a lossless substrate.

        Args:
            cos_below: cosines in the substrate.
        """
        turned = self.indices[::-1].copy()
        turned[0] = turned[0].real
        found = solver.amplitudes(
            turned[:, None],
            self.thicknesses_nm[::-1],
            [self.wavelength_nm],
            kz=turned[0].real * np.asarray(cos_below, dtype=complex),
            jobs=1,
        )
        return np.stack([found.r_s[:, 0], found.r_p[:, 0]]), np.stack([found.t_s[:, 0], found.t_p[:, 0]])


@dataclass(frozen=True)
class Embedded(Substrate):
    """A stack with the particles inside one of its layers; heights of centres count from that layer's lower face.

    Attributes:
        host: which of the media; it is lossless.
    """

    host: int

    @property
    def inner_index(self) -> float:
        """Index of the layer that the particles lie in."""
        return float(self.indices[self.host].real)

    @property
    def inner_nm(self) -> float:
        """Thickness of that layer."""
        return float(self.thicknesses_nm[self.host - 1])

    def clear_nm(self, centre_nm: float) -> float:
        """Return how far the nearer face is from a centre."""
        return min(centre_nm, self.inner_nm - centre_nm)

    @cached_property
    def _below(self) -> Substrate:
        """What lies under the layer, seen from inside."""
        return Substrate(self.wavelength_nm, self.indices[self.host :], self.thicknesses_nm[self.host :])

    @cached_property
    def _above(self) -> Substrate:
        """What lies over it, seen from inside."""
        return Substrate(
            self.wavelength_nm, self.indices[: self.host + 1][::-1], self.thicknesses_nm[: self.host - 1][::-1]
        )

    def _mirrors(self, centre_nm: float, w: NDArray) -> tuple[ComplexArray, ComplexArray]:
        """Return R_b and R_a, `[pol, angle]`."""
        k = self.inner_wavenumber
        return (
            np.exp(2j * k * centre_nm * w) * self._below.reflection(w),
            np.exp(2j * k * (self.inner_nm - centre_nm) * w) * self._above.reflection(w),
        )

    def echo(self, centre_nm: float, w: NDArray, lift_nm: float = 0.0) -> Echo:
        """Return what both faces send back; see `Substrate.echo`."""
        if lift_nm == 0.0:
            return Echo.between(*self._mirrors(centre_nm, w))
        k, (under, over) = self.inner_wavenumber, (self._below.reflection(w), self._above.reflection(w))
        # the phases in one go: e^{-ikw lift} alone may be too large for a number
        risen, fallen = (under * over * np.exp(1j * k * (2 * self.inner_nm + way) * w) for way in (lift_nm, -lift_nm))
        return Echo.between(
            under * np.exp(2j * k * centre_nm * w), over * np.exp(2j * k * (self.inner_nm - centre_nm) * w), risen,
            fallen,
        )  # fmt: skip

    def arriving(self, centre_nm: float, cosines: Array, w: ComplexArray, below: bool) -> Arriving:
        """Return what light of one side is at a centre between both faces; see `Substrate.arriving`."""
        under, over = self._mirrors(centre_nm, w)
        # the way in from one side is `from_below` of what lies there, seen from inside; the way out is the same
        near, way_nm = (self._below, centre_nm) if below else (self._above, self.inner_nm - centre_nm)
        _, into = near.from_below(cosines)
        ahead = into * np.exp(1j * self.inner_wavenumber * way_nm * w) / (1.0 - under * over)
        if below:
            reflection, transmission = self.from_below(cosines)
            return Arriving(ahead, ahead * over, reflection, transmission)
        return Arriving(ahead, ahead * under, self.reflection(cosines), None)
