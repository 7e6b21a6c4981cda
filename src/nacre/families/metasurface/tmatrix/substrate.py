"""Planar stack below or around the particles at one wavelength, and its reflection for multipole plane waves.

`nacre.matter.stack` solves the stratified media at w = kz/k in the particle medium, which may be complex.

Above a stack, a downward wave returns upward. Inside a layer both faces reflect: with R_b and R_a the reflections
below and above, phase at the centre, waves return reversed with R_b (R_a) over 1 - R_a R_b and in their own direction
with R_a R_b over the same. For centres at different heights, the first two phases refer to the mean height;
waves in their own direction gain the height difference phase.
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
class StackReflection:
    """Round-trip amplitudes for plane waves at a particle centre, `[pol, angle]` each.

    Attributes:
        up: downward wave that returns upward.
        down: upward wave that returns downward; None without a mirror above, as for the next two.
        risen: upward wave that returns upward.
        fallen: downward wave that returns downward.
    """

    up: ComplexArray
    down: ComplexArray | None = None
    risen: ComplexArray | None = None
    fallen: ComplexArray | None = None

    @classmethod
    def between(
        cls,
        below: ComplexArray,
        above: ComplexArray,
        risen: ComplexArray | None = None,
        fallen: ComplexArray | None = None,
    ) -> StackReflection:
        """Combine two mirrors R_b and R_a with multiple reflections.

        Args:
            risen, fallen: R_a R_b with the phases for a wave to another height; default R_a R_b.
        """
        both = below * above
        rest = 1.0 - both
        return cls(
            below / rest,
            above / rest,
            (both if risen is None else risen) / rest,
            (both if fallen is None else fallen) / rest,
        )

    def pairs(self, b: ComplexArray) -> list[tuple[ComplexArray, ComplexArray]]:
        """Return left and right factors, `[m, pol, n, angle]`, whose summed products carry multipole n' to n.

        sum_pairs left_n right_n' = Bdag_n(+) (up B_n'(-) + risen B_n'(+)) + Bdag_n(-) (down B_n'(+) + fallen B_n'(-)).

        Args:
            b: B(+) at the angles, `[m, pol, n, angle]`.
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
        """Return the Bdag_n(+) B_n'(+) factor, `[angle, n or 1, n']`, from the n and n' mirror signs.

        Args:
            pol: polarisation.
            target, source: mirror signs, `[n]` and `[n']`.
        """
        out: ComplexArray = self.up[pol][:, None, None] * source
        if self.down is not None and self.risen is not None and self.fallen is not None:
            out = out + self.down[pol][:, None, None] * target[:, None] + self.risen[pol][:, None, None]
            out = out + self.fallen[pol][:, None, None] * (target[:, None] * source)
        return out


def _wide(values: ComplexArray) -> ComplexArray:
    return values[None, :, None, :]


LOSSLESS_K = 1e-4  # a substrate with smaller k counts as transparent


@dataclass(frozen=True)
class IncidentWaves:
    """Plane waves from one side at a particle, `[pol, angle]`, phase at its centre.

    Attributes:
        ahead: the part along the incident direction.
        back: the part reversed by the mirror beyond the particle, if present.
        reflection: bare stack amplitude.
        transmission_up: bare stack amplitude for light from the substrate; None for light from above.
    """

    ahead: ComplexArray
    back: ComplexArray | None
    reflection: ComplexArray
    transmission_up: ComplexArray | None


@dataclass(frozen=True)
class Substrate:
    """A stack at one wavelength, with the particles above it.

    Attributes:
        wavelength_nm: in vacuum.
        indices: `[medium]`, complex, from the lossless ambient through the layers to the substrate.
        thicknesses_nm: `[layer]`.
    """

    wavelength_nm: float
    indices: ComplexArray
    thicknesses_nm: Array

    @property
    def ambient_index(self) -> float:
        """Real ambient index."""
        return float(self.indices[0].real)

    @property
    def wavenumber(self) -> float:
        """Ambient wavenumber k, 1/nm."""
        return 2 * np.pi * self.ambient_index / self.wavelength_nm

    @property
    def inner_index(self) -> float:
        """Index around the particles."""
        return self.ambient_index

    @property
    def inner_wavenumber(self) -> float:
        """Wavenumber in the medium around the particles, 1/nm."""
        return 2 * np.pi * self.inner_index / self.wavelength_nm

    @property
    def inner_nm(self) -> float:
        """Host layer thickness; 0 above the stack."""
        return 0.0

    def mirror_distance_nm(self, centre_nm: float) -> float:
        """Return the distance from a centre to the nearest mirror."""
        return centre_nm

    @cached_property
    def operators(self) -> dict[float, ComplexArray]:
        """Reflection operators W_m `[m, n, n']` by centre height, filled by `reflection_operator`."""
        return {}

    @property
    def is_transparent(self) -> bool:
        """Whether light propagates in the substrate without loss."""
        return abs(self.indices[-1].imag) < LOSSLESS_K

    @property
    def index_below(self) -> float:
        """Real substrate index over the ambient index."""
        return float(self.indices[-1].real) / self.ambient_index

    @property
    def is_absent(self) -> bool:
        """Whether every medium is the ambient."""
        return bool(np.all(np.abs(self.indices - self.indices[0]) < 1e-12))

    def reflection(self, w: NDArray) -> ComplexArray:
        """Return r_s, r_p, `[pol, angle]`, for light from the ambient at w = kz/k; phase at the stack top."""
        return self._amplitudes(self.indices, self.thicknesses_nm, self.ambient_index * np.asarray(w))[0]

    def _amplitudes(
        self, indices: ComplexArray, thicknesses_nm: Array, kz: NDArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return reflection and transmission amplitudes, `[pol, angle]`, for light from the first medium."""
        waves = solver.amplitudes(indices[:, None], thicknesses_nm, [self.wavelength_nm], kz=kz, jobs=1)
        return np.stack([waves.r_s[:, 0], waves.r_p[:, 0]]), np.stack([waves.t_s[:, 0], waves.t_p[:, 0]])

    def reflection_at(self, centre_nm: float, w: NDArray, lift_nm: float = 0.0) -> StackReflection:
        """Return the round-trip amplitudes at a centre for plane waves at w = kz/k.

        Args:
            centre_nm: centre height, or the mean source and target height.
            lift_nm: target height above the source; above a stack only the mean height counts.
        """
        return StackReflection(np.exp(2j * self.inner_wavenumber * centre_nm * w) * self.reflection(w))

    def incident_waves(self, centre_nm: float, cosines: Array, w: ComplexArray, below: bool) -> IncidentWaves:
        """Return light from one side at a particle centre.

        Args:
            cosines: on the incident side.
            w: kz/k in the medium around the particles.
        """
        # b = e^{ikd cos} moves the phase reference from the stack to the centre
        b = np.exp(1j * self.inner_wavenumber * centre_nm * w)
        if below:
            reflection, transmission = self.from_below(cosines)
            # reciprocity, t_down kz_below/kz = t_up: one amplitude serves both directions
            return IncidentWaves(transmission * b, None, reflection, transmission)
        reflection = self.reflection(w)
        return IncidentWaves(np.broadcast_to(1 / b, reflection.shape), reflection * b, reflection, None)

    def from_below(self, cos_below: NDArray) -> tuple[ComplexArray, ComplexArray]:
        """Return reflection and transmission amplitudes, `[pol, angle]`, for light from a lossless substrate.

        Args:
            cos_below: cosines in the substrate.
        """
        turned = self.indices[::-1].copy()
        turned[0] = turned[0].real
        kz = turned[0].real * np.asarray(cos_below, dtype=complex)
        return self._amplitudes(turned, self.thicknesses_nm[::-1], kz)


@dataclass(frozen=True)
class Embedded(Substrate):
    """A stack with the particles inside a layer; centre heights are above its lower face.

    Attributes:
        host: number for the lossless host medium.
    """

    host: int

    @property
    def inner_index(self) -> float:
        """Host layer index."""
        return float(self.indices[self.host].real)

    @property
    def inner_nm(self) -> float:
        """Host layer thickness."""
        return float(self.thicknesses_nm[self.host - 1])

    def mirror_distance_nm(self, centre_nm: float) -> float:
        """Return the distance from a centre to the nearer face."""
        return min(centre_nm, self.inner_nm - centre_nm)

    @cached_property
    def _below(self) -> Substrate:
        return Substrate(self.wavelength_nm, self.indices[self.host :], self.thicknesses_nm[self.host :])

    @cached_property
    def _above(self) -> Substrate:
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

    def reflection_at(self, centre_nm: float, w: NDArray, lift_nm: float = 0.0) -> StackReflection:
        """Return the round-trip amplitudes between both faces; see `Substrate.reflection_at`."""
        if lift_nm == 0.0:
            return StackReflection.between(*self._mirrors(centre_nm, w))
        k, (under, over) = self.inner_wavenumber, (self._below.reflection(w), self._above.reflection(w))
        # combined phases: e^{-ikw lift} may overflow
        risen, fallen = (under * over * np.exp(1j * k * (2 * self.inner_nm + way) * w) for way in (lift_nm, -lift_nm))
        return StackReflection.between(
            under * np.exp(2j * k * centre_nm * w),
            over * np.exp(2j * k * (self.inner_nm - centre_nm) * w),
            risen,
            fallen,
        )

    def incident_waves(self, centre_nm: float, cosines: Array, w: ComplexArray, below: bool) -> IncidentWaves:
        """Return light from one side at a centre between both faces; see `Substrate.incident_waves`."""
        under, over = self._mirrors(centre_nm, w)
        # the transmission into the layer is the near mirror's `from_below`
        near, way_nm = (self._below, centre_nm) if below else (self._above, self.inner_nm - centre_nm)
        _, into = near.from_below(cosines)
        ahead = into * np.exp(1j * self.inner_wavenumber * way_nm * w) / (1.0 - under * over)
        if below:
            reflection, transmission = self.from_below(cosines)
            return IncidentWaves(ahead, ahead * over, reflection, transmission)
        return IncidentWaves(ahead, ahead * under, self.reflection(cosines), None)
