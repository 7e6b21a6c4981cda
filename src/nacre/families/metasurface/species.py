"""Particle species in a monolayer, their placement on the stack, and multipole convergence.

A size distribution and a mixture are the same for the optics: particles with number fractions at random places in one
arrangement. All take the highest multipole order that any needs.
"""

from __future__ import annotations

import contextlib
import fnmatch
import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from pydantic import Field

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import MaterialRangeError, UnsupportedError
from nacre.families.metasurface.monolayer.monolayer import Particle
from nacre.families.metasurface.tmatrix import particle_on_stack
from nacre.families.metasurface.tmatrix.axisymmetric import (
    SAME_SIZE,
    SPHERE,
    AxialTMatrices,
    Body,
    TabulatedBody,
    TabulatedSphere,
    as_blocks,
    is_spherical,
    multipole_order,
    truncated,
)
from nacre.families.metasurface.tmatrix.particle_shapes import Shell, Sizes, SolvedBody, sphere_t_matrix
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.families.metasurface.tmatrix.tmatrix_file import TMatrixFileError, read_several
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import NotNegative, RecipeContext, RecipeModel

GAP_STEPS = 16
TOUCHES = 1e-9


@dataclass(frozen=True)
class PlacedParticle:
    """A particle above a stack at one wavelength, and the remaining far-field change.

    Attributes:
        particle: for `Monolayer`.
        change: relative L2 far-field change by the highest multipoles, or between two cutoffs near the stack.
        is_near: whether its circumscribing sphere cuts the stack.
    """

    particle: Particle
    change: float
    is_near: bool


def place(body: Body, surface: Substrate, gap_nm: float, order: int | None = None) -> PlacedParticle:
    """Return the particle with multipoles up to `order`, default all.

    Raises:
        UnsupportedError: the order is not known.
        MaterialRangeError: the wavelength is outside the tabulated range.
    """
    if order is not None:
        body.check_order(order)
    t = body.t_matrix(surface.wavelength_nm)
    t = t if order is None else truncated(t, order)
    particle = Particle(1.0, body.height_nm / 2 + gap_nm, t)
    if surface.is_absent or particle.centre_nm >= body.circumscribing_nm * (1 - TOUCHES):
        return PlacedParticle(particle, _truncation(surface, particle), False)
    near = replace(
        particle, cut=particle_on_stack.wavenumber_cutoff(particle.lmax, surface.wavenumber, body.circumscribing_nm)
    )
    less = replace(
        particle,
        cut=particle_on_stack.wavenumber_cutoff(
            particle.lmax, surface.wavenumber, body.circumscribing_nm, particle_on_stack.LOWER_CUT
        ),
    )
    return PlacedParticle(
        near, particle_on_stack.pattern_change(_pattern(surface, less), _pattern(surface, near)), True
    )


def smallest_converged_gap(
    body: Body, surface: Substrate, gap_nm: float, tolerance: float, order: int | None = None
) -> float | None:
    """Return the smallest converged gap, in steps up to a clear circumscribing sphere, or None."""
    clear = body.circumscribing_nm - body.height_nm / 2
    for gap in np.linspace(gap_nm, max(clear, gap_nm), GAP_STEPS + 1)[1:]:
        rounded = float(np.ceil(10 * gap) / 10)
        if place(body, surface, rounded, order).change <= tolerance:
            return rounded
    return None


def convergence_error(
    body: Body,
    surface: Substrate,
    gap_nm: float,
    placed: PlacedParticle,
    tolerance: float,
    order: int | None,
    key: str = "particle",
) -> UnsupportedError:
    """Return the error for a particle whose far field is not converged, with remedies.

    Args:
        key: recipe table for these particles.
    """
    if not placed.is_near:
        further = f"a larger {key}.gap_nm" if surface.inner_nm == 0.0 else "more room to the faces of the layer"
        return UnsupportedError(
            f"{body.source}: at {surface.wavelength_nm:g} nm its multipoles up to l = {placed.particle.lmax} do not "
            f"settle over this stack (the far field still changes by {placed.change:.2g}, {tolerance:g} is allowed); "
            f"a T-matrix of higher order or {further} is needed"
        )
    gap = smallest_converged_gap(body, surface, gap_nm, tolerance, order)
    advice = f"the least {key}.gap_nm that works is {gap:g}" if gap is not None else "no gap_nm mends it"
    return UnsupportedError(
        f"{body.source}: at {surface.wavelength_nm:g} nm it lies too close to the stack for multipoles up to l = "
        f"{placed.particle.lmax}: two cuts of the coupling differ by {placed.change:.2g}, {tolerance:g} is allowed; "
        f"{advice}"
    )


def _truncation(surface: Substrate, particle: Particle) -> float:
    """Estimate the change by the omitted multipoles: the last step, extrapolated geometrically."""
    top = particle.lmax
    if top == 1:
        return 0.0  # a pure dipole is intended and allows no estimate
    patterns = [
        _pattern(surface, replace(particle, t_matrix=truncated(particle.t_matrix, l)))
        for l in range(max(1, top - 2), top + 1)
    ]
    last = particle_on_stack.pattern_change(patterns[-2], patterns[-1])
    if len(patterns) < 3:
        return last
    before = particle_on_stack.pattern_change(patterns[-3], patterns[-2])
    return last * min(1.0, last / before) if before > 0 else last


def _pattern(surface: Substrate, particle: Particle) -> Array:
    mmax = min(particle_on_stack.AZIMUTHAL_ORDERS, particle.lmax)
    single = particle_on_stack.ParticleOnStack(surface, particle.centre_nm, particle.t_matrix, mmax, particle.cut)
    return particle_on_stack.probe_pattern(
        single.dressed, *particle_on_stack.probes(surface, particle.centre_nm, particle.lmax, mmax)
    )


logger = logging.getLogger("nacre")

MAX_TOLERANCE = 0.02  # largest accepted change when the order is doubled
# accepted with a warning without model.tolerance: silver on glass reaches 0.9 % at 360 nm
DEFAULT_MAX_TOLERANCE = 0.01
UNKNOWN_INDEX = 4.0
GAPS_NM = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # gaps tried for a remedy
USUAL_GAP_NM = 2.0
NEAR = 0.1  # logarithmic length step within which spheres share one multipole order


@dataclass(frozen=True, eq=False)
class Species:
    """One particle species.

    Attributes:
        core: its material; None if only the T-matrix is known.
        sizes: core radii for spheres; for other bodies the largest distances from the axis, with the shell.
        shell: a coating (optional).
        gap_nm: distance to the stack, or to the lower host layer face.
        body: a non-spherical particle with mean size; None for spheres.
        share: number fraction.
        key: recipe table.
        depth_nm: depth to the particle top, at mean size, below the layer stack top; None above it.
    """

    core: OpticalConstant | None
    sizes: Sizes
    shell: Shell | None = None
    gap_nm: float = 0.0
    body: Body | None = None
    share: float = 1.0
    key: str = "particle"
    depth_nm: float | None = None

    @property
    def mean_radius_nm(self) -> float:
        """Mean core radius for spheres, or full radius for other bodies."""
        return float(np.dot(self.sizes.radii_nm, self.sizes.shares))

    @property
    def outer_radius_nm(self) -> float:
        """Mean radius with the shell; for a body the largest distance from its axis."""
        return self.mean_radius_nm + (self.shell.thickness_nm if self.shell and self.body is None else 0.0)

    @property
    def core_radius_nm(self) -> float:
        """Mean radius without the shell."""
        return self.outer_radius_nm - (self.shell.thickness_nm if self.shell else 0.0)

    @property
    def height_nm(self) -> float:
        """Full height at mean size."""
        return 2 * self.outer_radius_nm if self.body is None else self.body.height_nm

    @property
    def reach_nm(self) -> float:
        """Circumscribing sphere radius."""
        return self.outer_radius_nm if self.body is None else self.body.circumscribing_nm

    @property
    def is_sphere(self) -> bool:
        """Whether it is a sphere, by its keys or by a file."""
        return self.body is None or isinstance(self.body, TabulatedSphere)

    @property
    def noun(self) -> str:
        """Noun for drawings."""
        if self.body is None:
            return "spheres"
        return f"{self.body.shape}s" if self.body.shape else "particles"

    def index(self, wavelength_nm: float) -> complex:
        """Return the particle index; for a T-matrix without one, a high value, the class with the strictest limit."""
        if self.core is not None:
            return complex(self.core.n_complex(np.array([wavelength_nm]))[0])
        stated = None if self.body is None else self.body.index(wavelength_nm)
        return complex(UNKNOWN_INDEX) if stated is None else stated

    def t_matrix(self, lmax: int, surface: Substrate, radius_nm: float) -> ComplexArray:
        """Return the diagonal T for one sphere, `[n]`."""
        if isinstance(self.body, TabulatedSphere):
            return self.body.coefficients(lmax, surface)
        assert self.core is not None  # known for spheres
        return sphere_t_matrix(self.core, self.shell, radius_nm, lmax, surface)


@dataclass(frozen=True)
class MultipoleConvergence:
    """Multipole order selection, with a record for incomplete convergence.

    Attributes:
        order: for all particles; None to choose it at each wavelength.
        tolerance: largest far-field change when the order is doubled; by default, see `Metasurface`.
        memory: order cache for similar candidates (optional).
        source: recipe name, for messages.
        first_film_nm: first layer thickness (optional).
        unconverged: remaining change above the tolerance, by wavelength.
        missing: by file with too few sphere multipoles: available and required order, and far-field change.
    """

    order: int | None
    tolerance: float | None
    memory: dict[Any, Any] | None
    source: str
    first_film_nm: float | None
    unconverged: dict[float, float] = field(default_factory=dict)
    missing: dict[str, tuple[int, int, float]] = field(default_factory=dict)

    def particles(self, all_species: tuple[Species, ...], surface: Substrate) -> tuple[Particle, ...]:
        """Return the particles above a stack, all with one multipole order.

        Raises:
            MultipoleConvergenceError, UnsupportedError: their multipoles do not converge.
            MaterialRangeError: an index is not known.
        """
        bodies = [
            [] if species.is_sphere else [self._body(species, r, surface) for r in species.sizes.radii_nm]
            for species in all_species
        ]
        orders = [self.sphere_order(species, surface) for species in all_species if species.is_sphere]
        top = max([p.lmax for row in bodies for p in row] + orders)
        out = []
        for number, (species, row) in enumerate(zip(all_species, bodies)):
            above = species.outer_radius_nm - species.mean_radius_nm + species.gap_nm
            available = top if species.body is None else min(top, species.body.lmax)
            singles = row or [
                Particle(1.0, radius + above, species.t_matrix(available, surface, radius))
                for radius in species.sizes.radii_nm
            ]
            out += [
                replace(p, share=species.share * share, t_matrix=widened(p.t_matrix, top), species=number)
                for p, share in zip(singles, species.sizes.shares)
            ]
        return tuple(out)

    def report(self, is_body: bool) -> None:
        """Log incomplete convergence and files with missing multipoles, once for all wavelengths."""
        if self.unconverged:
            logger.warning(
                "%s: at %s nm the far field is converged to %.2g only (%s); model.tolerance sets what is accepted",
                self.source,
                " and ".join(f"{w:g}" for w in sorted(self.unconverged)),
                max(self.unconverged.values()),
                "the particle lies close to the solid"
                if is_body
                else "a metal sphere touches the solid; with a gap_nm of 2 it converges",
            )
        for source, (available, required, change) in self.missing.items():
            logger.warning(
                "%s: holds multipoles up to l = %d, and this sphere takes up to %d over this stack: without them the "
                "far field changes by up to %.2g",
                source,
                available,
                required,
                change,
            )

    @property
    def notes(self) -> dict[str, Any]:
        """Notes for a Bsdf."""
        notes: dict[str, Any] = {}
        if self.order is None:
            notes["multipole_tolerance"] = max(
                [self.tolerance or particle_on_stack.ORDER_TOLERANCE, *self.unconverged.values()]
            )
        if self.missing:
            notes["multipoles"] = [{"held": h, "taken": t, "change": c} for h, t, c in self.missing.values()]
        return notes

    def _body(self, species: Species, radius_nm: float, surface: Substrate) -> Particle:
        assert species.body is not None
        body = species.body if len(species.sizes.radii_nm) == 1 else species.body.with_radius(radius_nm)
        placed = place(body, surface, species.gap_nm, self.order)
        tolerance = self.tolerance or MAX_TOLERANCE
        if placed.change > tolerance and (placed.is_near or self.order is None):
            raise convergence_error(body, surface, species.gap_nm, placed, tolerance, self.order, species.key)
        self._note(surface, placed.change)
        return placed.particle

    def _note(self, surface: Substrate, change: float) -> None:
        if change > DEFAULT_MAX_TOLERANCE:
            at = surface.wavelength_nm
            self.unconverged[at] = max(change, self.unconverged.get(at, 0.0))

    def sphere_order(self, species: Species, surface: Substrate) -> int:
        """Return the multipole order for spheres at the `surface` wavelength.

        Raises:
            MultipoleConvergenceError: no order is within the tolerance; the message names remedies.
        """
        if self.order is not None:
            if species.body is not None:
                species.body.check_order(self.order)
            return self.order
        if isinstance(species.body, TabulatedSphere):
            return self._known_order(species, species.body, surface)
        if self.memory is not None:
            near = self._neighbourhood(species, surface)
            if near not in self.memory:
                self.memory[near] = self._chosen_order(species, surface)
            return int(self.memory[near])
        return self._chosen_order(species, surface)

    def _known_order(self, species: Species, sphere: TabulatedSphere, surface: Substrate) -> int:
        """Return the order for a sphere from a file, limited by the file, and record missing multipoles.

        Raises:
            MultipoleConvergenceError, UnsupportedError: the file has too few, or no order converges.
        """
        required, available = self._chosen_order(species, surface), sphere.lmax
        tolerance = self.tolerance or MAX_TOLERANCE
        if not sphere.is_extended_by_mie:  # the order was chosen from the file's multipoles
            placed = place(sphere, surface, species.gap_nm)
            if 2 * required > available and placed.change > tolerance:
                raise convergence_error(sphere, surface, species.gap_nm, placed, tolerance, None, species.key)
        elif required > available:
            centre = species.outer_radius_nm + species.gap_nm
            change = particle_on_stack.order_change(
                surface, centre, lambda l: sphere.coefficients(l, surface), available, 2 * required
            )
            if change > tolerance:
                raise UnsupportedError(
                    f"{sphere.source}: holds multipoles up to l = {available}, and at {surface.wavelength_nm:g} nm "
                    f"this sphere needs {required} over this stack: the far field changes by {change:.2g}, "
                    f"{tolerance:g} is allowed; a file of higher order or a larger gap_nm is needed"
                )
            _, most, worst = self.missing.get(sphere.source, (available, 0, 0.0))
            self.missing[sphere.source] = available, max(required, most), max(change, worst)
        return min(required, available)

    def _neighbourhood(self, species: Species, surface: Substrate) -> tuple[Any, ...]:
        """Return the order's cache key: particle, media and first film thickness, to within a tenth."""
        assert species.core is not None  # known for spheres
        lam = np.array([surface.wavelength_nm])
        inside = [species.core, *([] if species.shell is None else [species.shell.material])]
        near = 0.0 if self.first_film_nm is None else min(self.first_film_nm, species.outer_radius_nm)
        over = max(surface.inner_nm - species.gap_nm - species.height_nm, 0.0)  # to the host's upper face
        lengths = (*species.sizes.radii_nm, species.outer_radius_nm, 1.0 + species.gap_nm + near, 1.0 + over)
        steps = tuple(int(np.floor(np.log(length) / NEAR)) for length in lengths)
        return (
            surface.wavelength_nm,
            tuple(complex(m.n_complex(lam)[0]) for m in inside),
            tuple(surface.indices.tolist()),
            steps,
        )

    def _chosen_order(self, species: Species, surface: Substrate) -> int:
        centre = species.outer_radius_nm + species.gap_nm
        tolerance = particle_on_stack.ORDER_TOLERANCE if self.tolerance is None else self.tolerance
        try:
            return particle_on_stack.choose_order(
                surface, centre, lambda lmax: species.t_matrix(lmax, surface, species.mean_radius_nm), tolerance
            )
        except particle_on_stack.MultipoleConvergenceError as refusal:
            if self.tolerance is None and refusal.change < DEFAULT_MAX_TOLERANCE:
                self.unconverged[surface.wavelength_nm] = refusal.change
                return refusal.order
            accept = ""
            mend = (
                'put 2 nm of native oxide (layers = [{material = "SiO2", thickness_nm = 2}]) and a gap_nm = 1 '
                f"under it, or {self._remedy(species, surface, tolerance)}"
            )
            where = f"gap_nm = {species.gap_nm:g}"
            if species.depth_nm is not None:
                where, mend = f"depth_nm = {species.depth_nm:g}", "leave some nm between it and the faces of its layer"
            if refusal.change < MAX_TOLERANCE:
                accept = f", or accept model.tolerance = {particle_on_stack.rounded_up(refusal.change):g}"
            raise particle_on_stack.MultipoleConvergenceError(
                f"{self.source}: {species.key}.{where}: at {surface.wavelength_nm:g} nm {refusal}; {mend}{accept}",
                refusal.change,
                refusal.order,
            ) from None

    def _remedy(self, species: Species, surface: Substrate, tolerance: float) -> str:
        """Return the smallest tested gap that converges, in words; a typical one for many candidates."""
        if self.memory is not None:
            return f"a gap_nm of {USUAL_GAP_NM:g}"
        for gap in (g for g in GAPS_NM if g > species.gap_nm):
            with contextlib.suppress(particle_on_stack.MultipoleConvergenceError):
                particle_on_stack.choose_order(
                    surface,
                    species.outer_radius_nm + gap,
                    lambda lmax: species.t_matrix(lmax, surface, species.mean_radius_nm),
                    tolerance,
                )
                return f"a gap_nm of {gap:g}"
        return f"a gap_nm of more than {GAPS_NM[-1]:g}"


def widened(t_matrix: ComplexArray, lmax: int) -> ComplexArray:
    """Return a T-matrix, `[n]` or `[m, n, n']`, padded with zeros to multipoles up to `lmax`."""
    top = multipole_order(t_matrix)
    if lmax == top:
        return t_matrix
    blocks = as_blocks(t_matrix, particle_on_stack.AZIMUTHAL_ORDERS)
    places = np.concatenate([np.arange(top), lmax + np.arange(top)])
    out = np.zeros((min(particle_on_stack.AZIMUTHAL_ORDERS, lmax) + 1, 2 * lmax, 2 * lmax), dtype=complex)
    out[: len(blocks), places[:, None], places] = blocks[: len(out)]
    return out


def non_sphere_notes(all_species: tuple[Species, ...]) -> dict[str, Any]:
    """Return Bsdf notes on non-spherical particles."""
    bodies = [species.body for species in all_species if species.body is not None]
    stated = [body.estimated_error for body in bodies if body.estimated_error is not None]
    notes: dict[str, Any] = {"t_matrix_error": float(f"{max(stated):.2g}")} if stated else {}
    turned = max((body.turn_loss for body in bodies), default=0.0)
    if turned:
        notes["left_out_by_turns"] = float(f"{turned:.2g}")
    return notes


def mean_square_radius(all_species: tuple[Species, ...]) -> float:
    """Return the rms radius over all species in nm, which defines the coverage."""
    squares: Array = np.array([species.share * species.outer_radius_nm**2 for species in all_species])
    return float(np.sqrt(squares.sum()))


# Particle recipe: spheres, cylinders, spheroids, T-matrix files, or a mixture.

CORE_LIMIT_NM = 1000.0
SMALLEST_CORE_NM = 0.1  # less than an atom; far smaller values underflow when squared
WIDEST_RELATIVE_SIZE = 0.3
SAME_MEDIUM = 1e-3  # relative tolerance for the T-matrix index
MAX_FILES = 1000  # T-matrix files of one particle
SAME_LENGTH = 1e-2  # relative tolerance for a length in both recipe and file
ALIGNED = 'write orientation = "aligned", and turn_deg for the angle by which all are turned about the normal'
OTHER_WORDS = dict.fromkeys(  # plausible unknown keys, and their replacements
    ("orientation_deg", "turn", "rotation", "rotation_deg", "azimuth_deg", "aligned"), ALIGNED
)
Extent = Annotated[float, Field(ge=2 * SMALLEST_CORE_NM, le=2 * CORE_LIMIT_NM)]


class ShellSpec(RecipeModel):
    """A coating around the core; it adds to the outer particle dimensions."""

    forms: ClassVar[tuple[str, ...]] = ('{material = "SiO2", thickness_nm = 10}',)

    material: IndexSpec = Field(description="material of the shell")
    thickness_nm: Annotated[float, Field(gt=0.0, le=CORE_LIMIT_NM)] = Field(
        description="uniform thickness of the shell, from the core outward: twice as much is added to "
        "diameter_nm and height_nm, once to radius_nm",
        examples=[10],
    )


class SpeciesSpec(RecipeModel):
    """One particle species: keys, validation, and construction."""

    table: ClassVar[str] = "particle"  # recipe table
    one_of: ClassVar[tuple[str, ...]] = ("material", "tmatrix")

    material: IndexSpec | None = Field(
        default=None, description="material of the particle or its core", examples=["Ag"]
    )
    radius_nm: Annotated[float, Field(ge=SMALLEST_CORE_NM, le=CORE_LIMIT_NM)] | None = Field(
        default=None, description="mean radius of the core of a sphere", examples=[90]
    )
    shape: Literal["sphere", "cylinder", "spheroid"] = Field(
        default="sphere", description="form; the axis of a cylinder (disc or rod) or a spheroid is the normal"
    )
    deviation_nm: NotNegative = Field(
        default=0.0,
        description="standard deviation of the radius, of a cylinder or spheroid of half its width (the height stays); "
        "at most 0.3 of it",
        examples=[5],
    )
    distribution: Literal["gaussian", "lognormal"] = Field(default="gaussian", description="shape of that spread")
    gap_nm: NotNegative = Field(
        default=0.0, description="distance between the particles and the stack below them", examples=[2]
    )
    depth_nm: NotNegative | None = Field(
        default=None,
        description="in place of gap_nm, for particles entirely inside one clear layer: depth of their "
        "tops (at mean size) below the top of the layers",
        examples=[100],
    )
    shell: ShellSpec | None = Field(
        default=None,
        description="a coat round the core, rounded at a cylinder's edges; gap_nm and depth_nm refer to its outside",
    )
    tmatrix: str | None = Field(
        default=None,
        description="in place of material and radius_nm: a file of T-matrices of a particle, axis z, "
        "as programs exchange them (arXiv:2408.10727); or a folder or pattern of files at several wavelengths",
        examples=["disc.tmat.h5"],
    )
    diameter_nm: Extent | None = Field(
        default=None,
        description="width of a cylinder or spheroid (of its core), or of a particle in tmatrix if missing in its file",
        examples=[120],
    )
    height_nm: Extent | None = Field(
        default=None,
        description="height of a cylinder or spheroid (its core), or of a particle in tmatrix if missing in its file",
        examples=[80],
    )

    edge_radius_nm: NotNegative = Field(
        default=0.0,
        description="radius of the edges of a cylinder (of its core), which are sharp at 0; at most half of the "
        "cylinder's radius and a quarter of its height",
        examples=[2],
    )

    orientation: Literal["averaged", "aligned"] = Field(
        default="averaged",
        description="for a particle of tmatrix that is not axisymmetric: the mean over rotations about the normal, or "
        "aligned, with the file's x along the surface's u",
    )
    turn_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = Field(
        default=0.0,
        description="rotation of aligned particles about the normal, from u towards v",
        examples=[30],
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _in_our_words(cls, data: Any) -> Any:
        for key in OTHER_WORDS if isinstance(data, Mapping) else ():
            if key in data:
                raise ValueError(f"gives {key}: {OTHER_WORDS[key]}")
        return data

    def model_post_init(self, _: Any) -> None:
        if self.tmatrix is None and self.orientation == "aligned":
            raise ValueError(
                f'gives orientation = "aligned" of a {self.shape}, which is symmetric about the normal; '
                "it applies to a particle of tmatrix"
            )
        if "turn_deg" in self.model_fields_set and self.orientation != "aligned":
            raise ValueError('gives turn_deg, which needs orientation = "aligned"; add it')
        if self.depth_nm is not None and "gap_nm" in self.model_fields_set:
            raise ValueError("gives gap_nm and depth_nm; particles lie above the layers or inside one")
        self._one_kind()
        self._moderate_spread()

    def _one_kind(self) -> None:
        if self.tmatrix is not None:
            of_others = ("material", "radius_nm", "shape", "deviation_nm", "shell", "edge_radius_nm")
            extra = [name for name in of_others if name in self.model_fields_set]
            if extra:
                raise ValueError(f"gives tmatrix and {extra[0]}; a file of T-matrices says what the particle is")
            return
        required: tuple[str, ...] = ("material", "radius_nm")
        foreign: tuple[str, ...] = ("diameter_nm", "height_nm")
        if self.shape != "sphere":
            required, foreign = ("material", *foreign), ("radius_nm",)
        if self.shape != "cylinder":
            foreign = (*foreign, "edge_radius_nm")
        extra = [name for name in foreign if name in self.model_fields_set]
        if extra:
            raise ValueError(f"gives {extra[0]}, which a {self.shape} does not have; it has {', '.join(required)}")
        missing = [name for name in required if getattr(self, name) is None]
        if missing:
            raise ValueError(
                f"needs {' and '.join(missing)} of a {self.shape}, or tmatrix, a file of T-matrices, in place of all"
            )

    def _moderate_spread(self) -> None:
        key, radius = "radius_nm", self.radius_nm
        if radius is None and self.diameter_nm is not None:
            key, radius = "half of diameter_nm", self.diameter_nm / 2
        if radius is not None and self.deviation_nm > WIDEST_RELATIVE_SIZE * radius:
            raise ValueError(
                f"deviation_nm = {self.deviation_nm:g} is not allowed; it should be at most "
                f"{WIDEST_RELATIVE_SIZE:g} of {key} = {radius:g}"
            )

    def species(self, context: RecipeContext, around: OpticalConstant, hold_ends: bool, share: float = 1.0) -> Species:
        """Return the species with number fraction `share`; see `body`."""

        def built(spec: IndexSpec) -> OpticalConstant:
            made = spec.build()
            return made.with_extrapolation("edge") if hold_ends else made

        shell = Shell(built(self.shell.material), self.shell.thickness_nm) if self.shell else None
        body = self.body(context, around, hold_ends, shell)
        coat = shell.thickness_nm if shell is not None and body is not None else 0.0
        mean = body.radius_nm - coat if body is not None else self.radius_nm
        assert mean is not None  # given for spheres, see _one_kind
        sizes = Sizes.of(mean, self.deviation_nm, self.distribution).larger_by(coat)
        thinnest = min(sizes.radii_nm) - coat
        if self.edge_radius_nm > min(thinnest, (self.height_nm or 0.0) / 2) / 2:
            raise context.fail(
                f"{self.table}.edge_radius_nm",
                self.edge_radius_nm,
                f"is too large for a cylinder {2 * thinnest:.4g} nm wide, the narrowest of the spread, and "
                f"{self.height_nm:.4g} nm high; it should be at most half of its radius and a quarter of its height",
            )
        core = None if self.material is None else built(self.material)
        return Species(core, sizes, shell, self.gap_nm, body, share, self.table, self.depth_nm)

    def body(
        self, context: RecipeContext, around: OpticalConstant, hold_ends: bool, shell: Shell | None = None
    ) -> Body | None:
        """Return a non-spherical particle, or None.

        Args:
            around: the surrounding medium.
            hold_ends: whether T-matrices hold beyond their wavelengths.
            shell: its coating.

        Raises:
            RecipeError: the file is unusable, for another medium, or without dimensions.
        """
        if self.tmatrix is None:
            return None if self.shape == "sphere" else self._solid(context, around, hold_ends, shell)
        try:
            known = read_several(self._tmatrix_paths(context), self.orientation == "aligned")
        except TMatrixFileError as error:
            raise context.fail(f"{self.table}.tmatrix", self.tmatrix, str(error)) from None
        self._check_medium(context, known, around)
        radius = self._extent(context, "diameter_nm", None if known.radius_nm is None else 2 * known.radius_nm) / 2
        height = self._extent(context, "height_nm", known.height_nm)
        # without a shape the particle may fill the cylinder with both lengths
        reach = float(np.hypot(radius, height / 2)) if known.circumscribing_nm is None else known.circumscribing_nm
        source = f'{context.source}: {self.table}.tmatrix = "{self.tmatrix}"'
        shape = known.shape
        if shape in ("", SPHERE) and abs(2 * radius - height) <= SAME_SIZE * height and is_spherical(known):
            return TabulatedSphere(known, radius, height, radius, source, hold_ends, shape)
        return TabulatedBody(known, radius, height, reach, source, hold_ends, shape, float(np.radians(self.turn_deg)))

    def _tmatrix_paths(self, context: RecipeContext) -> list[Path]:
        """Return the files: one, those of a folder, or those of a pattern such as `w*.tmat.h5`.

        Raises:
            RecipeError: a folder or a pattern matches too few or too many files.
        """
        assert self.tmatrix is not None
        plain = Path(self.tmatrix)
        place = plain if plain.is_absolute() else context.folder / plain
        is_pattern = any(c in plain.name for c in "*?[") and not place.exists()
        if not is_pattern and not place.is_dir():
            return [context.path(self.tmatrix)]
        folder, pattern = (place.parent, plain.name) if is_pattern else (place, "*.h5")
        names = fnmatch.filter(sorted(os.listdir(folder)) if folder.is_dir() else [], pattern)
        if not 0 < len(names) <= MAX_FILES:
            what = "a pattern for" if is_pattern else "a folder with"
            reason = f"is {what} {len(names)} files; 1 to {MAX_FILES} are read"
            raise context.fail(f"{self.table}.tmatrix", self.tmatrix, reason)
        above = plain.parent if is_pattern else plain
        return [context.path(str(above / name)) for name in names]

    def _solid(
        self, context: RecipeContext, around: OpticalConstant, hold_ends: bool, shell: Shell | None
    ) -> SolvedBody:
        assert self.material is not None and self.diameter_nm is not None and self.height_nm is not None  # _one_kind
        core = self.material.build()
        core = core.with_extrapolation("edge") if hold_ends else core
        source = f'{context.source}: {self.table}.shape = "{self.shape}"'
        coat = 0.0 if shell is None else shell.thickness_nm
        return SolvedBody(
            self.shape,
            self.diameter_nm / 2 + coat,
            self.height_nm + 2 * coat,
            core,
            around,
            source,
            shell=shell,
            edge_nm=self.edge_radius_nm,
        )

    def _check_medium(self, context: RecipeContext, known: AxialTMatrices, medium: OpticalConstant) -> None:
        for wavelength, index in zip(known.wavelengths_nm, known.ambient_index):
            try:
                around = float(medium.n_complex(np.array([wavelength]))[0].real)
            except MaterialRangeError:
                continue  # not computed at unknown wavelengths
            if abs(around / index - 1) > SAME_MEDIUM:
                place = "the ambient" if self.depth_nm is None else "the layer"
                raise context.fail(
                    f"{self.table}.tmatrix",
                    self.tmatrix,
                    f"is for particles in a medium of n = {index:.5g}, and {place} has {around:.5g}",
                )

    def _extent(self, context: RecipeContext, key: str, stated: float | None) -> float:
        own: float | None = getattr(self, key)
        if own is None and stated is None:
            raise context.fail(
                f"{self.table}.tmatrix",
                self.tmatrix,
                f"does not say how large the particle is; give {self.table}.{key}",
            )
        if own is not None and stated is not None and abs(own / stated - 1) > SAME_LENGTH:
            raise context.fail(
                f"{self.table}.{key}", own, f"is not what {self.tmatrix} says: {stated:.5g} nm; leave it out"
            )
        extent = stated if stated is not None else own
        assert extent is not None
        return extent


class SecondSpeciesSpec(SpeciesSpec):
    """The second species in a mixture, with its number fraction; both lie at random on one arrangement."""

    table: ClassVar[str] = "particle.second"
    forms: ClassVar[tuple[str, ...]] = ('{material = "Ag", radius_nm = 50, share = 0.3}',)

    share: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        description="number fraction of these particles", examples=[0.3]
    )


class ParticleSpec(SpeciesSpec):
    """The particles: spheres, upright cylinders or spheroids, or particles from a file."""

    forms: ClassVar[tuple[str, ...]] = (
        *SpeciesSpec.forms,
        '{material = "Si", radius_nm = 75, second = {material = "Ag", radius_nm = 50, share = 0.3}}',
    )

    second: SecondSpeciesSpec | None = Field(default=None, description="second species of particles in a mixture")

    def model_post_init(self, _: Any) -> None:
        super().model_post_init(_)
        if self.second is not None and (self.depth_nm is None) != (self.second.depth_nm is None):
            raise ValueError("and second: one gives depth_nm; both species lie inside one layer, or both above all")

    def all_species(self, context: RecipeContext, around: OpticalConstant, hold_ends: bool) -> tuple[Species, ...]:
        """Return the one or two species, in the medium `around` them.

        Raises:
            RecipeError: see `body`.
        """
        if self.second is None:
            return (self.species(context, around, hold_ends),)
        share = self.second.share
        second = self.second.species(context, around, hold_ends, share)
        return self.species(context, around, hold_ends, 1.0 - share), second
