"""A monolayer at one wavelength: coherent reflection and transmission, and diffuse fields.

Simple corrections use a coherent field in closed form: the monolayer as a thin sheet with independent scatterers
(Garcia-Valenzuela's model with a substrate). Each particle is excited by the incident wave, half the waves radiated
by the sheet and their reflections. With the free T-matrix the 2 x 2 matrix form equals the closed form; with the
dressed one it includes the near field between particle and stack. It ignores g(r) and is valid for p = f.
"""

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.families.metasurface.monolayer.qca import (
    INTERACTION_ORDER,
    Modes,
    NeighbourTable,
    mean_excitation,
    neighbour_sums_at,
)
from nacre.families.metasurface.monolayer.qca import NAME as LADDER
from nacre.families.metasurface.monolayer.qca import ORDER as LADDER_ORDER
from nacre.families.metasurface.monolayer.structure import Ratio, Structure
from nacre.families.metasurface.monolayer.translation_sums import NeighbourGeometry
from nacre.families.metasurface.tmatrix.axisymmetric import (
    azimuthal_blocks,
    multipole_index,
    multipole_order,
    spread_blocks,
)
from nacre.families.metasurface.tmatrix.particle_on_stack import (
    Directions,
    ParticleOnStack,
    apply_response,
    emission_harmonics,
)
from nacre.families.metasurface.tmatrix.special_functions import adjoint, mirrored, plane_wave_vectors
from nacre.families.metasurface.tmatrix.substrate import Substrate


@dataclass(frozen=True)
class SheetField:
    """Waves at the sheet, `[pol, angle]`: E at the sphere centres, A radiated; `_d` downward, `_u` upward."""

    e_d: ComplexArray
    e_u: ComplexArray
    a_d: ComplexArray
    a_u: ComplexArray
    phase: ComplexArray

    def reflection(self, uncovered: ComplexArray) -> ComplexArray:
        """Return the specular amplitude for light from above, `[pol, angle]`, from the bare stack's."""
        return uncovered * (1 + self.phase * self.a_d) + self.a_u / self.phase


def sheet_field(
    surface: Substrate, centre_nm: float, response: ComplexArray, density_per_nm2: float, directions: Directions
) -> SheetField:
    """Solve the sheet's 2 x 2 system for plane waves from the `directions` side.

    Args:
        response: `[m, n, n']`, the free T (diagonal blocks) or the dressed M.
    """
    k, w = surface.wavenumber, directions.inner_cosines
    lmax, mmax = response.shape[1] // 2, response.shape[0] - 1
    up = plane_wave_vectors(w, lmax, mmax, directions.transverse.astype(complex))
    down = mirrored(up)
    weight = np.where(np.arange(mmax + 1) == 0, 1.0, 2.0)
    scale = 2 * np.pi * density_per_nm2 / (k**2 * w)
    a = np.empty((2, 2, 2, w.size), dtype=complex)  # s, s', pol, angle with 0 = down
    for j, right in enumerate((down, up)):
        answered = np.matmul(response[:, None], 4 * adjoint(right))
        for i, left in enumerate((down, up)):
            a[i, j] = scale * np.einsum("m,mpna,mpna->pa", weight, left, answered)
    b = np.exp(1j * k * centre_nm * w)
    r = surface.reflection(w) * b**2
    if directions.below:
        assert directions.transmission_up is not None  # set for all directions below
        start = np.stack([np.zeros_like(r), directions.transmission_up * b])
    else:
        start = np.stack([np.broadcast_to(1 / b, r.shape), r / b])
    # E_d = start_d + A_d/2, E_u = start_u + r A_d + A_u/2
    feed = np.zeros((2, 2, *r.shape), dtype=complex)
    feed[0, 0] = feed[1, 1] = 0.5
    feed[1, 0] = r
    system = np.eye(2)[:, :, None, None] - np.einsum("ijpa,jkpa->ikpa", feed, a)
    fields = np.linalg.solve(np.moveaxis(system, (0, 1), (2, 3)), np.moveaxis(start, 0, 2)[..., None])[..., 0]
    e = np.moveaxis(fields, 2, 0)
    radiated = np.einsum("ijpa,jpa->ipa", a, e)
    return SheetField(e[0], e[1], radiated[0], radiated[1], np.broadcast_to(b, r.shape))


def sheet_vectors(field: SheetField, directions: Directions, lmax: int, mmax: int) -> tuple[ComplexArray, ComplexArray]:
    """Excitation and emission vectors in the sheet's mean field, `[m, pol, n, angle]`."""
    up = plane_wave_vectors(directions.inner_cosines, lmax, mmax, directions.transverse.astype(complex))
    down = mirrored(up)
    excitation = 4 * (adjoint(down) * field.e_d[None, :, None] + adjoint(up) * field.e_u[None, :, None])
    emission = up * field.e_d[None, :, None] + down * field.e_u[None, :, None]
    return excitation, emission


CORRECTIONS = ("qca-balanced", LADDER, "gv-balanced", "optical-depth", "in-only", "in-out", "none")
MEAN_FIELDS = ("qca-balanced", LADDER)


@dataclass(frozen=True)
class Particle:
    """One particle size and species.

    Attributes:
        share: number fraction.
        centre_nm: centre height above the stack.
        t_matrix: diagonal, `[n]`, or axisymmetric blocks, `[m, n, n']`.
        cut: in-plane wavenumber over k that truncates the coupling with the stack (optional).
        species: species number in a mixture.
    """

    share: float
    centre_nm: float
    t_matrix: ComplexArray
    cut: float | None = None
    species: int = 0

    @property
    def lmax(self) -> int:
        """Highest multipole order."""
        return multipole_order(self.t_matrix)


@dataclass(frozen=True)
class Illumination:
    """Directions on one side with the response to light from there, per particle size.

    Attributes:
        directions: excitation and emission vectors per size (with its own height).
        response: b, `[m, pol, n, angle]`, per size: multipoles with neighbours included.
        added: excitation by the neighbours, `[m, pol, n, angle]`; None without a mean field.
    """

    directions: list[Directions]
    response: list[ComplexArray]
    added: ComplexArray | None = None

    @property
    def cosines(self) -> Array:
        """Cosines on that side, `[angle]`."""
        return self.directions[0].cosines


@dataclass(frozen=True)
class Monolayer:
    """Particles on a stack at one wavelength.

    Attributes:
        surface: the stack.
        particles: one per size and species.
        structure: density, S(q), g(r).
        correction: from `CORRECTIONS`.
        interaction_order: highest multipole exchanged by neighbours.
        mmax: highest azimuthal order.
        ratio: ensemble over this model for the diffuse light (optional).
        includes_near_fields: False ignores near fields from neighbours for a few directions.
    """

    surface: Substrate
    particles: tuple[Particle, ...]
    structure: Structure
    correction: str = "qca-balanced"
    interaction_order: int = INTERACTION_ORDER
    mmax: int = 4
    includes_near_fields: bool = True
    ratio: Ratio | None = None

    @property
    def shares(self) -> Array:
        """Number fractions per size."""
        return np.array([p.share for p in self.particles])

    @property
    def transmits_below(self) -> bool:
        """Whether the substrate transmits."""
        return self.surface.is_transparent

    @property
    def has_mean_field(self) -> bool:
        """Whether the quasi-crystalline mean field excites the particles."""
        return self.correction in MEAN_FIELDS

    @cached_property
    def _single_particles(self) -> tuple[ParticleOnStack, ...]:
        """The particles, each alone on the stack."""
        return tuple(
            ParticleOnStack(self.surface, p.centre_nm, p.t_matrix, min(self.mmax, p.lmax), p.cut)
            for p in self.particles
        )

    @cached_property
    def spheres(self) -> tuple[ParticleOnStack, ...]:
        """The particles on the stack; with the ladder including the reflection by neighbours."""
        if self.correction != LADDER:
            return self._single_particles
        back = self.modes.back
        return tuple(
            dataclasses.replace(s, neighbours=azimuthal_blocks(back, s.lmax, s.mmax)) for s in self._single_particles
        )

    @cached_property
    def modes(self) -> Modes:
        """The ladder modes."""
        order = min(LADDER_ORDER, *(s.lmax for s in self._single_particles))
        dressed = np.stack([spread_blocks(s.dressed, multipole_index(order)) for s in self._single_particles])
        return Modes.build(self.surface, self.mean_centre_nm, self.structure, dressed, self.shares)

    @cached_property
    def mean_dressed(self) -> ComplexArray:
        """M_m averaged over the sizes, `[m, n, n']`."""
        return sum_over(self.shares, [s.dressed for s in self.spheres])

    @cached_property
    def mean_centre_nm(self) -> float:
        """Mean centre height."""
        return float(self.shares @ [p.centre_nm for p in self.particles])

    @cached_property
    def neighbours(self) -> NeighbourTable:
        """The neighbour sum table."""
        return NeighbourTable.build(self.neighbour_geometry(), self.transmits_below)

    def neighbour_geometry(self, order: int | None = None) -> NeighbourGeometry:
        """Return the neighbour interaction up to `order`, by default the monolayer's."""
        order = min(self.interaction_order, self.spheres[0].lmax) if order is None else order
        return NeighbourGeometry(self.surface, self.mean_centre_nm, self.structure, order)

    def illuminate(
        self, cosines: Array, below: bool = False, sines: Array | None = None, untabulated: bool = False
    ) -> Illumination:
        """Return the directions at `cosines` on one side with the particle response.

        `MEAN_FIELDS` use the quasi-crystalline mean field, other corrections the response without neighbours.

        Args:
            untabulated: compute the neighbour sums at these few angles without a table.
        """
        directions = [s.directions(cosines, below, sines) for s in self.spheres]
        own = [apply_response(s.dressed, d.excitation) for s, d in zip(self.spheres, directions)]
        if not self.has_mean_field:
            return Illumination(directions, own)
        geometry = self.neighbour_geometry()
        if untabulated:
            sums = neighbour_sums_at(geometry, directions[0], self.includes_near_fields)
        else:
            sums = self.neighbours.at(directions[0])
        added = mean_excitation(sums, geometry.order, self.mean_dressed, sum_over(self.shares, own))
        response = [o + apply_response(s.dressed, added) for o, s in zip(own, self.spheres)]
        return Illumination(directions, response, added)

    def coherent_sum(self, leaving: list[Directions], lit: Illumination) -> ComplexArray:
        """Return the mean F towards `leaving`, paired with `lit`, nm, `[pol, angle]`."""
        total = 0
        for share, out, response in zip(self.shares, leaving, lit.response):
            weight = np.full(len(response), 2.0)
            weight[0] = 1.0
            total = total + share * np.einsum("m,mpna,mpna->pa", weight, out.emission, response)
        return np.asarray(total / self.surface.inner_wavenumber)

    def specular_above(self, cosines: Array, lit: Illumination | None = None) -> tuple[Array, Array]:
        """Power reflectance and transmittance for coherent light from above, `[pol, angle]`.

        Args:
            cosines: incident.
            lit: `illuminate` at these, if known.
        """
        k, rho = self.surface.wavenumber, self.structure.density_per_nm2
        if not self.has_mean_field:
            return self._closed_form(cosines)
        lit = self.illuminate(cosines) if lit is None else lit
        uncovered = lit.directions[0].reflection
        r = uncovered + 2 * np.pi * rho / (k * cosines) * self.coherent_sum(lit.directions, lit)
        if not self.transmits_below:
            return np.abs(r) ** 2, np.zeros(r.shape)
        out, cos_below, t = self.refracted(cosines)
        t = t + 2 * np.pi * rho / (k * cos_below) * self.coherent_sum(out, lit)
        return np.abs(r) ** 2, cos_below / cosines * np.abs(t) ** 2

    def specular_below(self, cosines: Array) -> Array:
        """Power reflectance for coherent light from below, `[pol, angle]`; zero for an opaque substrate."""
        if not self.transmits_below:
            return np.zeros((2, cosines.size))
        k, rho = self.surface.wavenumber, self.structure.density_per_nm2
        lit = self.illuminate(cosines, below=True)
        first = lit.directions[0]
        if self.has_mean_field:
            summed = self.coherent_sum(lit.directions, lit)
        else:
            field = sheet_field(self.surface, self.mean_centre_nm, self.mean_dressed, rho, first)
            excitation, _ = sheet_vectors(field, first, self.spheres[0].lmax, len(self.mean_dressed) - 1)
            summed = self.coherent_sum([first], Illumination([first], [apply_response(self.mean_dressed, excitation)]))
        r = first.reflection + 2 * np.pi * rho / (k * cosines * first.index) * summed
        return np.abs(r) ** 2

    def refracted(self, cosines: Array) -> tuple[list[Directions], Array, ComplexArray]:
        """Directions below refracted from `cosines` above, n cos there, and the bare stack's t, `[pol, angle]`."""
        index = self.surface.index_below
        sines = np.sqrt((1 - cosines) * (1 + cosines)) / index
        inner = np.sqrt((1 - sines) * (1 + sines))
        out = [s.directions(inner, True, sines) for s in self.spheres]
        t_up = out[0].transmission_up
        assert t_up is not None  # set for all directions below
        return out, index * inner, t_up * cosines / (index * inner)

    def _closed_form(self, cosines: Array) -> tuple[Array, Array]:
        rho = self.structure.density_per_nm2
        directions = self.spheres[0].directions(cosines)
        field = sheet_field(self.surface, self.mean_centre_nm, self.mean_dressed, rho, directions)
        reflected = np.abs(field.reflection(directions.reflection)) ** 2
        if not self.transmits_below:
            return reflected, np.zeros(reflected.shape)
        _, cos_below, t = self.refracted(cosines)
        passed = t * (1 + field.phase * field.a_d)
        return reflected, cos_below / cosines * np.abs(passed) ** 2

    def fields(self, emissions: list[ComplexArray], responses: list[ComplexArray]) -> ComplexArray:
        """Return X_m for every pair, `[size, m, pol_s, s, pol_i, i]`, nm."""
        return np.stack([emission_harmonics(u, x, self.surface.inner_wavenumber) for u, x in zip(emissions, responses)])

    def mean_field_vectors(self, lit: Illumination) -> tuple[ComplexArray, ComplexArray]:
        """Excitation and emission vectors in the closed-form mean field, `[m, pol, n, angle]`."""
        first = lit.directions[0]
        rho = self.structure.density_per_nm2
        field = sheet_field(self.surface, self.mean_centre_nm, self.mean_dressed, rho, first)
        return sheet_vectors(field, first, self.spheres[0].lmax, len(self.mean_dressed) - 1)


def sum_over(shares: Array, parts: list[ComplexArray]) -> ComplexArray:
    """Return the array mean by number fraction."""
    total = shares[0] * parts[0]
    for share, part in zip(shares[1:], parts[1:]):
        total = total + share * part
    return total
