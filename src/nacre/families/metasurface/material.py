"""The metasurface: a disordered monolayer of resonant particles on a layered substrate.

The mean field is chosen within its measured validity range, else an ensemble; `mean_field_errors.toml` holds the
mean-field error for every system compared with multi-sphere solutions.
"""

from __future__ import annotations

import dataclasses
import logging
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.bsdf.angle_nodes import response_errors
from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.response import ResponseLobe
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.core.machine import in_threads
from nacre.families.contract import DirectEvaluation, ExcessEnergy, ExpensiveMethod, Model, SearchFidelity, Traits
from nacre.families.metasurface.ensemble import EnsembleInterpolation, EnsembleSettings, interpolate_ensemble
from nacre.families.metasurface.monolayer.aligned import (
    NO_ENSEMBLE,
    AlignedLayer,
    aligned_grids,
    aligned_powers,
    aligned_values,
    tabulate_aligned,
)
from nacre.families.metasurface.monolayer.arrangement import Arrangement, Pattern
from nacre.families.metasurface.monolayer.diffuse import diffuse_term, limit_to_incident_power
from nacre.families.metasurface.monolayer.evaluation import choose_grids, direct_powers, direct_values, tabulate
from nacre.families.metasurface.monolayer.monolayer import Monolayer
from nacre.families.metasurface.monolayer.qca import INTERACTION_ORDER
from nacre.families.metasurface.monolayer.qca import check as check_ladder
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.species import (
    MultipoleConvergence,
    Species,
    mean_square_radius,
    non_sphere_notes,
)
from nacre.families.metasurface.tmatrix.axisymmetric import Body, TabulatedBody
from nacre.families.metasurface.tmatrix.particle_on_stack import hemisphere_rule
from nacre.families.metasurface.tmatrix.particle_shapes import Shell, Sizes
from nacre.families.metasurface.tmatrix.substrate import LOSSLESS_K, Embedded, Substrate
from nacre.light import default_wavelengths
from nacre.matter.indices.constant import OpticalConstant

MAX_ERROR = 0.12  # relative L2 error up to which the mean field is accepted
METAL, RESONANT, FAINT = "metal", "high-index", "low-index"
SPHERE, SPHEROID, DISC, OTHER = "sphere", "spheroid", "disc", "particle"
HIGH_INDEX = 2.5  # core index over the ambient index with sharp resonances in the visible
NEGLECTED_CONTRAST = 0.2  # relative index contrast below which a substrate is neglected
SHAPES = {"": OTHER, "sphere": SPHERE, "cylinder": DISC, "spheroid": SPHEROID}


@dataclass(frozen=True)
class SystemClass:
    """Particle species class: shape and core type."""

    shape: str
    core: str

    def __str__(self) -> str:
        return f"{self.core} {self.shape}s"


@dataclass(frozen=True)
class MeasuredSystem:
    """A system with a measured mean-field error.

    Attributes:
        name: description.
        species: one or two classes.
        error: relative L2 error, the maximum over wavelengths.
    """

    name: str
    species: tuple[SystemClass, ...]
    on_substrate: bool
    coverage: float
    packing: float
    error: float


def _load_systems() -> tuple[MeasuredSystem, ...]:
    text = files(__package__).joinpath("mean_field_errors.toml").read_text("utf-8")
    return tuple(
        MeasuredSystem(**{**entry, "species": tuple(SystemClass(*pair) for pair in entry["species"])})
        for entry in tomllib.loads(text)["system"]
    )


MEASURED = _load_systems()

# Errors inside a layer at coverage 0.1, by the ensemble: silver r 60 nm in resin on glass 38 to 58 %, on silicon 28 %,
# in n = 1.7 54 to 74 %; silicon r 75 nm 44 to 78 %; titania r 75 nm 10 to 75 %. The upward share is small there and
# includes light reflected by the faces. At 550 nm: silver 17 % at coverage 0.02 and 4.6 % at 0.003, titania 8 and 1.8 %
MAX_EMBEDDED_COVERAGE = 0.003
EMBEDDED_ERROR = "10 to 78 % off at a coverage of 0.1"


def core_class(relative_index: complex) -> str:
    """Return the core class from its index over the ambient index."""
    if relative_index.imag > relative_index.real:
        return METAL
    return RESONANT if relative_index.real > HIGH_INDEX else FAINT


def conservative_class(species: Sequence[SystemClass]) -> list[tuple[str, str]]:
    """Return sorted classes with weakly scattering low-index cores replaced by metal, the class with data."""
    return sorted((one.shape, METAL if one.core == FAINT else one.core) for one in species)


def highest_coverage(species: Sequence[SystemClass], on_substrate: bool) -> tuple[float, MeasuredSystem | None]:
    """Return the coverage up to which the mean field is valid, and the decisive system; (0, None) without data.

    This is the densest matching system within `MAX_ERROR`, or else an extrapolation with an error proportional
    to the coverage.
    """
    classes = sorted((one.shape, one.core) for one in species)
    candidates = [m for m in MEASURED if m.on_substrate == on_substrate]
    matching = [m for m in candidates if sorted((one.shape, one.core) for one in m.species) == classes]
    matching = matching or [m for m in candidates if conservative_class(m.species) == conservative_class(species)]
    if not matching:
        return 0.0, None
    failed = min((m.coverage for m in matching if m.error > MAX_ERROR), default=float("inf"))
    valid = [m for m in matching if m.error <= MAX_ERROR and m.coverage < failed]
    if valid:
        best = max(valid, key=lambda m: m.coverage)
        return best.coverage, best
    nearest = min(matching, key=lambda m: MAX_ERROR * m.coverage / m.error)
    return nearest.coverage * MAX_ERROR / nearest.error, nearest


def mean_field_holds(species: Sequence[SystemClass], on_substrate: bool, coverage: float) -> tuple[bool, str]:
    """Return whether the mean field is selected, and the reason.

    Args:
        species: classes; both in a mixture are evaluated together.
        on_substrate: whether there is a relevant substrate.
        coverage: area coverage by all particles.
    """
    limit, system = highest_coverage(species, on_substrate)
    name = _describe(species, on_substrate)
    if system is None:
        return False, f"{name}: no such layer was measured"
    return coverage <= limit * (1 + 1e-6), (
        f"{name} at coverage {coverage:.3g}; measured: {system.name}, coverage {system.coverage:g}, "
        f"{100 * system.error:.0f} % off, so the mean field is taken up to {limit:.2g}"
    )


def mean_field_holds_inside(coverage: float) -> tuple[bool, str]:
    """Return whether the mean field is selected for particles inside a layer, and the reason."""
    return coverage <= MAX_EMBEDDED_COVERAGE, (
        f"particles inside a layer at coverage {coverage:.3g}; measured: the mean field is {EMBEDDED_ERROR}, so it is "
        f"taken up to {MAX_EMBEDDED_COVERAGE:g}"
    )


def warning(species: Sequence[SystemClass], on_substrate: bool) -> str:
    """Return the mean-field validity warning, the same for each coverage."""
    limit, system = highest_coverage(species, on_substrate)
    name = _describe(species, on_substrate)
    if system is None:
        return f"the mean field is taken of {name}, of which no layer was measured"
    return (
        f"the mean field is taken of {name} beyond a coverage of {limit:.2g}, up to which it is known to hold to "
        f"{100 * MAX_ERROR:.0f} %"
    )


def _describe(species: Sequence[SystemClass], on_substrate: bool) -> str:
    name = " and ".join(map(str, species))
    name = f"a mixture of {name}" if len(species) > 1 else name
    return f"{name} {'on a substrate' if on_substrate else 'with nothing below'}"


logger = logging.getLogger("nacre")

AUTO, ENSEMBLE = "auto", "ensemble"
EXPENSIVE_METHOD = 'an ensemble (model.correction = "ensemble")'
VALIDATED_COVERAGE = 0.13  # coverage above which a doubtful mean field causes a warning
CLASSIFICATION_NM = 550.0  # wavelength for the core classification
# thicker films need 180 angles; up to here 120 have an L2 error 0.4 % (0.3 % without film)
THICK_FILM_NM = 1000.0
LOW_WAVELENGTHS = 1.65  # total height over wavelength that 64 angles resolve: 600 nm at 360 nm
REPORTED_EXCESS = 0.01  # energy excess above which a warning is logged
SAME_INDEX = 1e-3
MAX_CACHED_GRIDS = 4  # wavelength grids with a cached ensemble
CHECKED_DEG, CHECKED_BANDS = (20.0, 52.0, 74.0, 84.0, 88.5), 2
CHECK_NODES = 32
PER_WAVELENGTH = {"wavelengths_nm", "wavenumbers", "index_below", "table"} | {
    side + kind for side in ("above", "below", "across") for kind in ("", "_free")
}
FEW_ANGLES, LEAST_COS = 48, 0.05  # direct evaluation: angle count and smallest cosine
FEW_ALIGNED_ANGLES = 24  # the same for aligned particles, at all azimuths
INSIDE = f"the mean field is used for particles inside a layer; compared with the ensemble it is {EMBEDDED_ERROR}"


class MetasurfaceWarning(UserWarning):
    """The model is used beyond its tested range; the message describes it."""


@dataclass(frozen=True, eq=False)
class Metasurface(Model, DirectEvaluation, SearchFidelity, ExpensiveMethod, ExcessEnergy):
    """Particles on a stack.

    Attributes:
        ambient: around the particles; lossless.
        layers: materials and thicknesses in nm, from the light's side inward.
        substrate: below; it transmits if it is clear.
        core: particle material; None if only their T-matrix is known.
        sizes: their radii.
        shell: a coating (optional); the outer radius is the core radius plus its thickness.
        gap_nm: between the particles and the stack.
        structure: density, S(q), g(r).
        correction: one of `monolayer.CORRECTIONS`, "ensemble" or "auto", see `model_selection`.
        ensemble: ensemble size.
        multipole_order: for spheres; None to choose it at each wavelength by `multipole_tolerance`.
        multipole_tolerance: largest far-field change when the order is doubled; None: 0.001, and up to 0.01 with
            a warning.
        interaction_order: highest multipole exchanged by neighbours.
        source: recipe name, for messages.
        arrangement: point generator, or the points; None if only S(q) is known.
        memory: multipole order cache for similar candidates (optional).
        includes_near_fields: False ignores near fields from neighbours.
        body: non-spherical particles; `sizes` then holds their largest distances from the axis.
        is_replaced: whether the mean field replaces an ensemble in a search.
        host: layer number that holds the particles, from 1; 0 above all layers.
        depth_nm: depth to their tops below the layer stack top, if embedded.
        second: second species in a mixture; the first has the remaining share.
    """

    traits = Traits(noun="metasurface", bytes_per_wavelength=200_000)

    ambient: OpticalConstant
    layers: tuple[tuple[OpticalConstant, float], ...]
    substrate: OpticalConstant
    core: OpticalConstant | None
    sizes: Sizes
    structure: Structure
    shell: Shell | None = None
    gap_nm: float = 0.0
    correction: str = "qca-balanced"
    multipole_order: int | None = None
    multipole_tolerance: float | None = None
    interaction_order: int = INTERACTION_ORDER
    source: str = "recipe"
    range_nm: tuple[float, float] = (360.0, 830.0)
    arrangement: Arrangement | Pattern | None = None
    memory: dict[Any, Any] | None = None
    includes_near_fields: bool = True
    ensemble: EnsembleSettings = EnsembleSettings()
    body: Body | None = None
    second: Species | None = None
    is_replaced: bool = False
    host: int = 0
    depth_nm: float | None = None

    @cached_property
    def all_species(self) -> tuple[Species, ...]:
        """The one or two particle species."""
        rest = () if self.second is None else (self.second,)
        share = 1.0 - sum(species.share for species in rest)
        first = Species(self.core, self.sizes, self.shell, self.gap_nm, self.body, share, depth_nm=self.depth_nm)
        return (first, *rest)

    def pattern(self, count: int, seed: int | None = None) -> Pattern:
        """Return about `count` particles on a periodic square, or the given point list.

        Args:
            count: particles.
            seed: random seed; default: the recipe's.

        Raises:
            UnsupportedError: only S(q) is known.
            NacreError: the packing cannot be reached.
        """
        if isinstance(self.arrangement, Pattern):
            return self.arrangement
        if self.arrangement is None:
            raise self._no_positions()
        made = self.arrangement if seed is None else dataclasses.replace(self.arrangement, seed=seed)
        return made.pattern(count)

    @property
    def outer_radius_nm(self) -> float:
        """Mean outer radius for the first species."""
        return self.all_species[0].outer_radius_nm

    @property
    def is_aligned(self) -> bool:
        """Whether the particles are not axisymmetric and have one orientation."""
        return self.body is not None and self.body.is_aligned

    @property
    def _turn_rad(self) -> float:
        return self.body.turn_rad if isinstance(self.body, TabulatedBody) else 0.0

    def _aligned(self, layer: Monolayer) -> AlignedLayer:
        """Return the aligned particles whose rotational average `layer` holds."""
        assert isinstance(self.body, TabulatedBody)  # only tabulated bodies are aligned
        return AlignedLayer(layer, self.body.known.at(layer.surface.wavelength_nm, self.body.hold_ends, is_full=True))

    @property
    def varies(self) -> bool:
        """Whether the particles have several sizes or species."""
        return len(self.all_species) > 1 or len(self.sizes.shares) > 1

    @property
    def coverage(self) -> float:
        """f = density pi r^2, in a mixture with the mean r^2."""
        return float(self.structure.density_per_nm2 * np.pi * mean_square_radius(self.all_species) ** 2)

    @property
    def wavelengths_nm(self) -> Array:
        """Default grid with 10 nm steps, which resolves sphere resonances in the visible."""
        grid = default_wavelengths()
        return grid[(grid >= self.range_nm[0]) & (grid <= self.range_nm[1])]

    def surface(self, wavelength_nm: float) -> Substrate:
        """Return the stack at one wavelength; a clear substrate becomes lossless."""
        media = [self.ambient, *(m for m, _ in self.layers), self.substrate]
        n = np.array([complex(m.n_complex(np.array([wavelength_nm]))[0]) for m in media])
        n[0] = n[0].real
        if abs(n[-1].imag) < LOSSLESS_K:
            n[-1] = n[-1].real
        thicknesses = np.array([d for _, d in self.layers], dtype=float)
        if not self.host:
            return Substrate(float(wavelength_nm), n, thicknesses)
        n[self.host] = n[self.host].real
        return Embedded(float(wavelength_nm), n, thicknesses, self.host)

    def t_matrix(self, lmax: int, surface: Substrate, radius_nm: float) -> ComplexArray:
        """Return the diagonal T for one sphere, `[n]`."""
        return self.all_species[0].t_matrix(lmax, surface, radius_nm)

    @cached_property
    def chosen_correction(self) -> tuple[str, str]:
        """The correction, and the reason for an automatic choice or ""."""
        return self._choice if self.correction == AUTO else (self.correction, "")

    @cached_property
    def _choice(self) -> tuple[str, str]:
        """The correction from the table of measured systems, and the reason."""
        if self.is_aligned:
            return "qca-balanced", NO_ENSEMBLE
        if self.arrangement is None:
            return "qca-balanced", "only S(q) is known, so there are no positions for an ensemble"
        is_valid, reason = self._mean_field_validity
        return ("qca-balanced" if is_valid else ENSEMBLE), reason

    @property
    def _mean_field_validity(self) -> tuple[bool, str]:
        """Whether the mean field is valid, and the reason."""
        if self.host:
            return mean_field_holds_inside(self.coverage)
        return mean_field_holds(*self._system_classes, self.coverage)

    @cached_property
    def _system_classes(self) -> tuple[list[SystemClass], bool]:
        """The species classes, and whether there is a substrate."""
        surface = self.surface(float(np.clip(CLASSIFICATION_NM, *self.range_nm)))
        below = np.max(np.abs(surface.indices[1:] / surface.ambient_index - 1.0)) > NEGLECTED_CONTRAST
        return [
            SystemClass(
                SHAPES.get("sphere" if species.body is None else species.body.shape, OTHER),
                core_class(species.index(surface.wavelength_nm) / surface.inner_index),
            )
            for species in self.all_species
        ], bool(below)

    @property
    def expensive_method(self) -> str:
        """The ensemble, if selected automatically."""
        return EXPENSIVE_METHOD if self.correction == AUTO and self._choice[0] == ENSEMBLE else ""

    @property
    def is_distributed(self) -> bool:
        """Whether an ensemble is used."""
        return self.chosen_correction[0] == ENSEMBLE

    @property
    def replaced_method(self) -> str:
        """The ensemble, if the mean field replaces it in a search."""
        return EXPENSIVE_METHOD if self.is_replaced and self._choice[0] == ENSEMBLE else ""

    @property
    def method_overrides(self) -> Mapping[str, Any]:
        """The explicit mean field, if it replaces an ensemble."""
        return {"model.correction": "qca-balanced"} if self.replaced_method else {}

    def layers_at(self, wavelengths_nm: ArrayLike) -> tuple[Callable[[float], Monolayer], EnsembleInterpolation | None]:
        """Return a function wavelength -> monolayer, with the ensemble ratio if one is used.

        Raises:
            UnsupportedError: an ensemble without positions, or a too large one.
        """
        if self.chosen_correction[0] != ENSEMBLE:
            return self.monolayer, None
        grid = np.sort(np.atleast_1d(np.asarray(wavelengths_nm, dtype=float)))
        refinement = self._refinements(tuple(grid.tolist()))

        def layer(wavelength_nm: float) -> Monolayer:
            return dataclasses.replace(self.monolayer(wavelength_nm), ratio=refinement.at(wavelength_nm))

        return layer, refinement

    @cached_property
    def _refinements(self) -> Callable[[tuple[float, ...]], EnsembleInterpolation]:
        """The ensembles by wavelength grid, for the grids used last."""
        return lru_cache(maxsize=MAX_CACHED_GRIDS)(lambda grid: self._refinement(np.array(grid)))

    def _refinement(self, wavelengths_nm: Array) -> EnsembleInterpolation:
        if self.arrangement is None:
            raise self._no_positions()
        seed = self.arrangement.seed if isinstance(self.arrangement, Arrangement) else 0
        is_list = isinstance(self.arrangement, Pattern)
        reason = self.chosen_correction[1]
        because = f'model.correction = "auto" takes an ensemble: {reason}; "qca-balanced" takes seconds; '
        refinement = interpolate_ensemble(
            wavelengths_nm,
            self.monolayer,
            self.pattern,
            self.ensemble,
            seed,
            self.source,
            is_list,
            because if reason else "",
        )
        logger.warning(
            "%s: ensemble of %d patterns of %d particles: standard error %.2g %%, rms over pairs of angles",
            self.source,
            self.ensemble.realisations,
            self.ensemble.spheres,
            100 * refinement.standard_error,
        )
        return refinement

    def _no_positions(self) -> UnsupportedError:
        return UnsupportedError(
            f"{self.source}: monolayer.structure.sq says how particles scatter, not where they lie; "
            "name an arrangement (hard-disk, rsa, poisson-disk, lattice) or give points"
        )

    def monolayer(self, wavelength_nm: float) -> Monolayer:
        """Return the mean-field monolayer at one wavelength.

        Raises:
            MultipoleConvergenceError: the multipole series does not converge; the message names remedies.
            MaterialRangeError, UnsupportedError: an index is not known; the ladder is not applicable.
        """
        wavelength_nm = float(wavelength_nm)
        if wavelength_nm not in self._solved:
            surface = self.surface(wavelength_nm)
            check_ladder(self.correction, surface, self.structure, self.source)
            particles = self._convergence.particles(self.all_species, surface)
            mean_field = "qca-balanced" if self.correction in (AUTO, ENSEMBLE) else self.correction
            self._solved[wavelength_nm] = Monolayer(
                surface,
                particles,
                self.structure,
                mean_field,
                self.interaction_order,
                includes_near_fields=self.includes_near_fields,
            )
        return self._solved[wavelength_nm]

    @cached_property
    def _convergence(self) -> MultipoleConvergence:
        first = self.layers[0][1] if self.layers else None
        return MultipoleConvergence(self.multipole_order, self.multipole_tolerance, self.memory, self.source, first)

    @cached_property
    def _solved(self) -> dict[float, Monolayer]:
        return {}

    def order(self, surface: Substrate) -> int:
        """Return the multipole order for the first species, if spheres, at the `surface` wavelength.

        Raises:
            MultipoleConvergenceError: no order is within the tolerance; the message names remedies.
        """
        return self._convergence.sphere_order(self.all_species[0], surface)

    def search_model(self, memory: dict[Any, Any], is_rough: bool = False) -> Metasurface:
        """Return a variant for optimisation that reuses multipole orders from similar spheres on the same media.

        A rough variant ignores near fields from neighbours. The mean field replaces an automatic ensemble, but not an
        explicit one.
        """
        spared = self.correction == AUTO
        return dataclasses.replace(
            self,
            memory=memory,
            includes_near_fields=not is_rough,
            is_replaced=spared or self.is_replaced,
            correction="qca-balanced" if spared else self.correction,
        )

    @property
    def eta(self) -> float:
        """Relative index for a transparent substrate, for refraction in renderers; 1 for an opaque one."""
        if not self.transmits:
            return 1.0
        surface = self.surface(float(np.clip(570.0, *self.range_nm)))
        return surface.index_below if surface.index_below > 1.0 + SAME_INDEX else 1.0

    @cached_property
    def transmits(self) -> bool:
        """Whether the substrate transmits at all wavelengths."""
        return all(self.surface(w).is_transparent for w in self.wavelengths_nm)

    def bsdf(self, wavelengths_nm: ArrayLike | None = None) -> Bsdf:
        """Solve the optics: a specular and a harmonic lobe, or their aligned counterparts.

        Args:
            wavelengths_nm: `[wavelength]`, ascending; default: `self.wavelengths_nm`.

        Raises:
            MultipoleConvergenceError, MaterialRangeError: see `monolayer`.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        self._warn()
        eta = self.eta
        thickness = sum(d for _, d in self.layers)
        layer, refinement = self.layers_at(lam)
        # the path difference between particle and image is twice the centre height
        height = thickness + max(2.0 * species.gap_nm + species.height_nm for species in self.all_species)
        # a film on a clear substrate may guide light, with sharp features over the angle
        low = height <= LOW_WAVELENGTHS * lam[0] and not (self.transmits and self.layers)
        grids = choose_grids(eta if self.transmits else None, self.varies, thickness > THICK_FILM_NM, low)
        if self.is_aligned:
            lobes, excess = tabulate_aligned(
                lam, lambda w: self._aligned(layer(w)), self.structure, aligned_grids(grids), eta, self._turn_rad
            )
            errors = None  # estimated from the finished table
        else:
            lobes, excess, errors = tabulate(lam, layer, self.structure, grids, eta)
        notes: dict[str, Any] = {
            "energy_excess": round(excess, 6),
            "coverage": self.coverage,
            "packing": self.structure.packing,
            "correction": self.chosen_correction[0],
            "structure": self.structure.name,
        }
        if self.chosen_correction[1]:
            notes["correction_because"] = self.chosen_correction[1]
        if self._doubt:
            notes["correction_doubt"] = self._doubt
        if refinement is not None:
            notes["ensemble"] = refinement.notes
        notes |= non_sphere_notes(self.all_species) | self._convergence.notes
        self._convergence.report(self.body is not None)
        specular = lobes[0]
        assert isinstance(specular, ResponseLobe)
        errors = response_errors(specular.response) if errors is None else errors
        stated = errors.stated(more=self._diffuse_error(lobes[1], layer))
        notes["angle_table"] = {"cosines": len(specular.response.cos_outside), **stated}
        return Bsdf(lobes, notes)

    def _diffuse_error(self, lobe: Lobe, layer: Callable[[float], Monolayer]) -> float:
        """Return the largest error of diffuse R or T of a table, at a few incidences and wavelengths."""
        bands = np.unique(np.linspace(0, len(lobe.wavelengths_nm) - 1, CHECKED_BANDS).astype(int))
        few = _at_bands(lobe, bands)
        theta = np.radians(CHECKED_DEG)
        cos = np.cos(theta)
        exact = []
        for wavelength in few.wavelengths_nm:
            parts = (0.5 * part.sum(axis=0) for part in self.powers(cos, float(wavelength), layer(float(wavelength))))
            r, t, up, down = parts
            if self.correction != "none":
                up, down, _ = limit_to_incident_power(r + t, up, down)
            exact.append(np.stack([up, down if self.transmits else np.zeros_like(down)]))
        tabulated = [few.hemispherical(np.array([np.sin(a), 0.0, np.cos(a)]), nodes=CHECK_NODES) for a in theta]
        return float(np.max(np.abs(np.transpose(np.array(tabulated), (1, 0, 2)) - np.stack(exact, axis=-1))))

    def _warn(self) -> None:
        for species in self.all_species:
            if species.body is not None and species.body.turn_loss:
                warnings.warn(
                    f"{species.body.source}: is not axisymmetric: the mean over its turn about the normal is taken, "
                    f"and {100 * species.body.turn_loss:.2g} % of what it scatters, which depends on the turn, is left "
                    'out; orientation = "aligned" takes all of it, of particles that point one way',
                    MetasurfaceWarning,
                    stacklevel=3,
                )
        doubt = self._doubt
        if doubt and self.coverage > VALIDATED_COVERAGE and not self.is_replaced:  # searches report replaced ensembles
            instead = "" if self.is_aligned else '; model.correction = "ensemble" solves the particles together'
            warnings.warn(f"{self.source}: {doubt}{instead}", MetasurfaceWarning, stacklevel=3)

    @property
    def _doubt(self) -> str:
        """Known doubt about the mean field; "" if valid."""
        if self.is_aligned:
            return NO_ENSEMBLE
        if self.chosen_correction[0] == ENSEMBLE or self._mean_field_validity[0]:
            return ""
        return INSIDE if self.host else warning(*self._system_classes)

    def spectrum(
        self, theta_rad: ArrayLike, wavelengths_nm: ArrayLike | None = None, polarisation: str = "both", seed: int = 0
    ) -> Spectrum:
        """Return specular and hemispherical diffuse power, each `[angle, wavelength]`, together at most one.

        The correction "none" is not limited.

        Args:
            theta_rad: incidence in the ambient; 90 degrees counts as 89.9.
            wavelengths_nm: vacuum wavelengths.
            polarisation: "s", "p" or "both".

        Raises:
            MultipoleConvergenceError, MaterialRangeError: see `monolayer`.
        """
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        lam = self.wavelengths_nm if wavelengths_nm is None else np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
        self._warn()
        pick = {"s": np.array([1.0, 0.0]), "p": np.array([0.0, 1.0]), "both": np.array([0.5, 0.5])}
        if polarisation not in pick:
            raise UnsupportedError(f'polarisation = "{polarisation}" is not known; use s, p or both')
        share = pick[polarisation]
        layer, _ = self.layers_at(lam)

        def powers(wavelength: float) -> list[Array]:
            return [share @ part for part in self.powers(np.cos(theta), float(wavelength), layer(float(wavelength)))]

        columns = in_threads(powers, lam)
        if self.memory is None:
            self._convergence.report(self.body is not None)
        r, t, up, down = (np.stack([c[i] for c in columns], axis=-1) for i in range(4))
        if self.correction != "none":
            up, down, excess = limit_to_incident_power(r + t, up, down)
            if excess > REPORTED_EXCESS:
                logger.warning(
                    "%s: correction %s sends out %.3g more than arrives; the diffuse part is scaled down to it",
                    self.source,
                    self.chosen_correction[0],
                    excess,
                )
        degrees = np.degrees(theta)
        if not self.transmits:
            return Spectrum(lam, degrees, specular_reflectance=r, diffuse_reflectance=up)
        return Spectrum(lam, degrees, r, t, up, down)

    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
        """Return the diffuse BRDF at a few pairs, `[pair, wavelength]`, without tables.

        Equal to `bsdf` to 0.5 % (relative to the maximum), except for the energy scaling near grazing. None for pairs
        on the other side, at grazing, or too many angles.
        """
        arriving, leaving = (np.asarray(v, dtype=float).reshape(-1, 3) for v in (wi, wo))
        angles = np.unique(np.round(np.concatenate([arriving[:, 2], leaving[:, 2]]), 12))
        most = FEW_ALIGNED_ANGLES if self.is_aligned else FEW_ANGLES
        if angles.size > most or np.any(angles < LEAST_COS):
            return None
        self._warn()
        layer, _ = self.layers_at(wavelengths_nm)

        def column(wavelength_nm: float) -> Array:
            if self.is_aligned:
                return aligned_values(self._aligned(layer(wavelength_nm)), arriving, leaving, self._turn_rad)
            return direct_values(layer(wavelength_nm), arriving, leaving)

        return np.stack(in_threads(column, [float(w) for w in wavelengths_nm]), axis=-1)

    @property
    def excess_reason(self) -> str:
        """The correction "none" counts light twice."""
        return 'model.correction = "none" does not keep energy' if self.correction == "none" else ""

    def powers(
        self, cosines: ArrayLike, wavelength_nm: float, layer: Monolayer | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Specular R and T, diffuse R and T for light from above, each `[pol, angle]`, not rescaled to energy 1.

        Args:
            cosines: `[angle]`, cosines of the angles of incidence.
            wavelength_nm: in vacuum.
            layer: the solved monolayer at this wavelength; by default it is solved in the mean field.
        """
        cos = np.maximum(np.atleast_1d(np.asarray(cosines, dtype=float)), np.cos(np.radians(89.9)))
        layer = self.monolayer(wavelength_nm) if layer is None else layer
        if self.is_aligned:
            return aligned_powers(self._aligned(layer), cos, -self._turn_rad)
        if layer.correction == "qca-balanced" and layer.ratio is None:
            return direct_powers(layer, cos)
        reflected, passed = layer.specular_above(cos)
        mu, weights = hemisphere_rule(24)
        zero = np.zeros(cos.size)
        sides = [(layer.illuminate(np.concatenate([mu, cos])), np.concatenate([weights, zero]))]
        if self.transmits:
            mu_b, weights_b = hemisphere_rule(20, layer.surface.index_below)
            sides.append((layer.illuminate(mu_b, True), weights_b))
        term = diffuse_term(layer, sides, 1)
        at = slice(mu.size, mu.size + cos.size)
        return reflected, passed, term.above[:, at] / cos, term.below[:, at] / cos


def _at_bands(lobe: Lobe, bands: Array) -> Any:
    """Return a diffuse lobe at some of its wavelengths."""
    names = {field.name for field in dataclasses.fields(lobe)} & PER_WAVELENGTH  # type: ignore[arg-type]
    tables = {name: np.ascontiguousarray(getattr(lobe, name)[..., bands]) for name in names}
    return dataclasses.replace(lobe, **tables)  # type: ignore[type-var]
