"""Multi-sphere pattern ensemble, the reference for the diffuse light in the mean-field model.

Periodic squares with about 130 particles each, in the recipe's pattern, are solved for many incident waves. Their
diffuse light, all orders except the zeroth, is compared with a mean-field model at the same multipole order. The result
is the smooth ratio, see `ensemble_ratio`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nacre.core.arrays import Array, ComplexArray
from nacre.core.disk_cache import cache_arrays, cached_arrays, drop_arrays
from nacre.core.jobs import in_workers, is_on_cluster
from nacre.core.machine import available_jobs, check_memory
from nacre.core.progress import announce, duration
from nacre.families.metasurface.monolayer import structure as ensemble_ratio
from nacre.families.metasurface.monolayer.arrangement import Pattern
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.monolayer import Illumination, Monolayer, Particle
from nacre.families.metasurface.monolayer.qca import node_sines, node_weights
from nacre.families.metasurface.monolayer.structure import Block, Ratio, Sums, as_arrays, from_arrays
from nacre.families.metasurface.supercells import (
    Coupling,
    PeriodicCoupling,
    PlaneWaves,
    Supercell,
    max_far_wavenumber,
    orders,
    species_numbers,
    supercells,
    translation_order,
    with_species,
)
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_index, truncated, with_negative_orders
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions, hemisphere_rule
from nacre.families.metasurface.tmatrix.substrate import Embedded
from nacre.recipe.fingerprint import fingerprint

WIDEST = np.radians(84.0)  # largest incidence and view angle; the ratio extrapolates smoothly
REACH = 0.8  # window reach over the square side
ANGLES = 8  # angle bins for the errors
LIGHTS = (48, 30)  # incident directions per pattern, above and below
VIEWS = (3.2, 1.25)  # views per particle above and below; more particles have more orders
ON_THE_LINE = 1e-3  # directions below this close to the light line, over k, are skipped: the reflection has a kink
HARMONICS = 14  # model harmonics
MODEL_NODES = (24, 14, 18)  # model nodes over the angle: above, below within and beyond the critical angle
BALANCE_NODES = (24, 20)  # balance nodes over the cosine


@dataclass(frozen=True)
class EnsembleSettings:
    """Ensemble size: particles per pattern, patterns, and the highest multipole order."""

    spheres: int = 130
    realisations: int = 48
    multipole_order: int = 2


@dataclass(frozen=True)
class Side:
    """Directions on one pattern side.

    Attributes:
        wavevectors: in-plane wavevectors, `[direction, 2]`, 1/nm.
        directions: vectors for the first species.
        others: vectors for the other species in a mixture.
    """

    wavevectors: Array
    directions: Directions
    others: tuple[Directions, ...] = ()

    @cached_property
    def ratio_directions(self) -> ensemble_ratio.RatioDirections:
        """The directions as ratio variables."""
        d = self.directions
        return ensemble_ratio.RatioDirections.of(
            d.transverse, np.full(d.cosines.size, d.index), np.full(d.cosines.size, d.below)
        )


@dataclass(frozen=True)
class Ensemble:
    """Patterns for one monolayer and wavelength, with equal particles or a mixture.

    Attributes:
        layer: mean-field model with the same multipole order and one particle size per species.
        supercells: the patterns; for a mixture with species numbers.
    """

    layer: Monolayer
    supercells: list[Supercell]

    @property
    def reach_nm(self) -> float:
        """Real-space range for the coupling sum."""
        return REACH * min(cell.period.side_nm for cell in self.supercells)

    @cached_property
    def coupling(self) -> Coupling:
        """The pair coupling tables."""
        nearest = min(nearest_distance(cell) for cell in self.supercells)
        first, *others = self.layer.particles
        return Coupling.build(self.layer.surface, first, nearest, self.reach_nm, *others, fades=True)

    @cached_property
    def lattice(self) -> PeriodicCoupling:
        """The coupling with all images."""
        return PeriodicCoupling.build(self.layer, self.coupling, self.reach_nm)

    @cached_property
    def angles_rad(self) -> Array:
        """Angle bin centres."""
        return np.asarray((np.arange(ANGLES) + 0.5) * WIDEST / ANGLES)

    @cached_property
    def model(self) -> ModelTable:
        """The mean-field model."""
        return ModelTable.build(self.layer)

    def prepare(self) -> None:
        """Compute the tables shared by all patterns."""
        _ = self.lattice, self.model

    def __getstate__(self) -> dict[str, Any]:
        """Leave the tables out; a worker process computes its own."""
        return {name: value for name, value in self.__dict__.items() if name not in ("coupling", "lattice", "model")}

    def _sides(self, cell: Supercell) -> list[tuple[Side, Side]]:
        """View and incident directions, above and then below."""
        layer, rng = self.layer, np.random.default_rng(cell.seed)
        k = layer.surface.wavenumber
        out = []
        for below in (False, True) if layer.transmits_below else (False,):
            index = layer.surface.index_below if below else 1.0
            every = orders(cell.period, k * index * np.sin(WIDEST))
            sines = np.hypot(*every.T) / (k * index)
            if below:
                every = every[np.abs(sines * index - 1.0) > ON_THE_LINE]
                sines = np.hypot(*every.T) / (k * index)
            views = rng.permutation(len(every))[: int(np.ceil(VIEWS[below] * len(cell.xy_nm)))]
            # uniform in the angle: by solid angle hardly any would be near the normal
            angle = np.arcsin(sines)
            step = np.floor(angle / WIDEST * LIGHTS[below]) + rng.random(len(every))
            _, lights = np.unique(np.floor(step[np.argsort(step)]), return_index=True)
            viewed, lit = views[np.argsort(angle[views])], np.argsort(step)[lights]
            out.append((self.side(every[viewed], below), self.side(every[lit], below)))
        return out

    def side(self, wavevectors: Array, below: bool) -> Side:
        """Return directions on one side, `wavevectors` `[direction, 2]` in 1/nm."""
        surface, order = self.layer.surface, self.layer.particles[0].lmax
        sine = np.hypot(*wavevectors.T) / (surface.wavenumber * (surface.index_below if below else 1.0))
        cosines = np.sqrt((1 - sine) * (1 + sine))
        first, *others = (
            Directions.build(surface, p.centre_nm, order, order, cosines, below, sine) for p in self.layer.particles
        )
        return Side(wavevectors, first, tuple(others))

    def solve(self, number: int) -> dict[ensemble_ratio.Block, ensemble_ratio.Sums]:
        """Solve one pattern; return the fit sums for its diffuse light."""
        cell, layer = self.supercells[number], self.layer
        sides = self._sides(cell)
        arriving = PlaneWaves.of([self.waves(light, False) for _, light in sides])
        solved = self.lattice.solve(cell, arriving)
        sums: dict[ensemble_ratio.Block, ensemble_ratio.Sums] = {}
        counts = [len(light.wavevectors) for _, light in sides]
        edges = np.cumsum([0, *(2 * c for c in counts)])
        required = ensemble_ratio.blocks(layer.transmits_below)
        for view, _ in sides:
            f = self.coupling.far_field(cell.xy_nm, solved, self.waves(view, True), cell.species)
            for at, (_, light) in enumerate(sides):
                part = f[:, edges[at] : edges[at + 1]].reshape(2, -1, 2, counts[at])
                powers = np.abs(part).astype(float) ** 2
                powers /= len(cell.xy_nm) * view.directions.index * light.directions.index
                for block, pairs in self._pairs(cell, view, light, powers):
                    if block[0] < block[1] or (block[0] == block[1] and block not in required):
                        a, b, q, p = block
                        block, pairs = (b, a, p, q), pairs.exchanged()
                    one = ensemble_ratio.block_sums(block, pairs, ANGLES)
                    sums[block] = sums[block] + one if block in sums else one
        return sums

    def waves(self, side: Side, is_leaving: bool) -> PlaneWaves:
        """Return the waves for all directions on one side."""
        index = multipole_index(self.layer.particles[0].lmax)
        azimuth = np.arctan2(side.wavevectors[:, 1], side.wavevectors[:, 0])
        turn = np.exp((1j if is_leaving else -1j) * index.m[:, None] * azimuth)
        parts = []
        for d in (side.directions, *side.others):
            vectors = d.emission if is_leaving else d.excitation
            signed = with_negative_orders(vectors, index) * turn
            parts.append(np.moveaxis(signed, 1, 0).reshape(len(index.m), -1))
        spread = np.stack(parts)
        return PlaneWaves(spread, spread, np.concatenate([side.wavevectors, side.wavevectors]))

    def _pairs(
        self, cell: Supercell, view: Side, light: Side, powers: Array
    ) -> list[tuple[ensemble_ratio.Block, ensemble_ratio.Pairs]]:
        """Return solved and model light for all direction pairs, by polarisations.

        In the control, the pattern's S replaces the mean one; in a mixture, its species order also replaces pure
        chance. Their product, zero on average, remains in the noise.
        """
        to, by = view.wavevectors, light.wavevectors
        q = np.hypot(*np.moveaxis(to[:, None] - by, -1, 0))
        phi = np.arctan2(to[:, 1], to[:, 0])[:, None] - np.arctan2(by[:, 1], by[:, 0])
        diffuse = q > 1e-6 * self.layer.surface.wavenumber  # all but the zeroth order
        leaving, arriving = np.exp(-1j * cell.xy_nm @ to.T), np.exp(1j * cell.xy_nm @ by.T)
        s = self.layer.structure.structure_factor(q)
        excess = np.abs(leaving.T @ arriving) ** 2 / len(cell.xy_nm) - s
        is_mixture = self.layer.shares.size > 1
        odd = _kind_factor(cell, self.layer.shares, leaving, arriving) - 1.0 if is_mixture else excess
        out = []
        for pol, p in np.ndindex(2, 2):
            x = self.model.series(view, light, phi, pol, p) * diffuse
            model, control = x * s, x * excess
            if is_mixture:
                varying = self.model.series(view, light, phi, pol, p, True) * diffuse
                model, control = model + varying, control + varying * odd
            block = (int(view.directions.below), int(light.directions.below), pol, p)
            pairs = ensemble_ratio.Pairs(
                view.ratio_directions,
                light.ratio_directions,
                phi,
                powers[pol, :, p] * diffuse,
                model,
                control,
                self.model.level(view, light, pol, p),
                self._bin(view),
                self._bin(light),
            )
            out.append((block, pairs))
        return out

    def _bin(self, side: Side) -> NDArray[np.intp]:
        angle = np.arccos(side.directions.cosines)
        return np.minimum(angle / WIDEST * ANGLES, ANGLES - 1).astype(np.intp)

    def ratio(
        self, solved: list[dict[ensemble_ratio.Block, ensemble_ratio.Sums]]
    ) -> tuple[ensemble_ratio.Ratio, Array]:
        """Fit the ratio to all patterns; return it and its relative standard errors, `[s, i]` over `angles_rad`."""
        fitted, errors = ensemble_ratio.fit_ratio(solved)
        return fitted, errors.reshape(ANGLES, ANGLES)


@dataclass(frozen=True)
class ModelTable:
    """The mean-field model at angular interpolation nodes.

    Attributes:
        layer: the model.
        harmonics: from |F|^2 C / (n_s n_i) per particle without S, `[s, i, pol_s, pol_i, k]` over all nodes.
        varying: the same for the difference between both species, without S; empty without a mixture.
        levels: mean square (with S) over azimuth and solid angle on one side, `[node, side, pol_s, pol_i]`.
    """

    layer: Monolayer
    harmonics: Array
    varying: Array
    levels: Array

    @classmethod
    def build(cls, layer: Monolayer) -> ModelTable:
        """Evaluate the balanced model."""
        sides: list[tuple[Illumination, Array]] = []
        place, start = [], 0
        for below in (False, True) if layer.transmits_below else (False,):
            index = layer.surface.index_below if below else 1.0
            mu, w = hemisphere_rule(BALANCE_NODES[below], index) if below else hemisphere_rule(BALANCE_NODES[below])
            sines = np.concatenate([np.sqrt((1 - mu) * (1 + mu)), *(s for s in _nodes(layer, below))])
            cosines = np.sqrt((1 - sines) * (1 + sines))
            sides.append((layer.illuminate(cosines, below, sines), np.concatenate([w, np.zeros(sines.size - mu.size)])))
            place.append(start + np.arange(mu.size, sines.size))
            start += sines.size
        at = np.concatenate(place)
        term = diffuse_term(layer, sides, HARMONICS)
        harmonics = term.coherent[at][:, at] / layer.structure.density_per_nm2
        varying = term.varying
        if varying.size:
            varying = varying[at][:, at] / layer.structure.density_per_nm2
        kappa = np.concatenate([lit.directions[0].transverse for lit, _ in sides])[at]
        solid = np.concatenate([_solid(layer, side > 0) for side in range(len(sides))])
        phi = 2 * np.pi * np.arange(24) / 24
        q2 = (kappa[:, None] ** 2 + kappa**2)[..., None] - 2 * np.outer(kappa, kappa)[..., None] * np.cos(phi)
        s = layer.structure.structure_factor(layer.surface.wavenumber * np.sqrt(np.maximum(q2, 0.0)))
        waves = np.cos(np.arange(HARMONICS)[:, None] * phi)
        values = np.einsum("siqpk,kf->qpsif", harmonics, waves, optimize=True) * s
        if varying.size:
            values = values + np.einsum("siqpk,kf->qpsif", varying, waves, optimize=True)
        square = (values**2).mean(axis=-1)  # pol_s, pol_i, s, i
        is_below = np.concatenate([np.full(len(rows), n) for n, rows in enumerate(place)])
        levels = []
        for side in range(len(sides)):
            w = np.where(is_below == side, solid, 0.0)
            levels.append((square * w).sum(axis=-1) / w.sum())
        return cls(layer, harmonics, varying, np.moveaxis(np.stack(levels), (0, 3), (1, 0)))

    def _weights(self, side: Side) -> tuple[slice, Array]:
        """Return the nodes on one side, and the interpolation from them, `[direction, node]`."""
        start = MODEL_NODES[0] if side.directions.below else 0
        out = node_weights(side.directions, self.layer.surface.index_below, MODEL_NODES, WIDEST)
        return slice(start, start + out.shape[1]), out

    def series(self, view: Side, light: Side, phi: Array, pol: int, p: int, is_varying: bool = False) -> Array:
        """Return the model without S at all pairs, `[view, light]`: the part multiplied by S, or the other."""
        rows, left = self._weights(view)
        columns, right = self._weights(light)
        table = (self.varying if is_varying else self.harmonics)[rows, columns, pol, p]
        at = np.einsum("va,abk,lb->vlk", left, table, right, optimize=True)
        series = np.polynomial.chebyshev.chebval(np.cos(phi), np.moveaxis(at, -1, 0), tensor=False)
        return np.asarray(np.maximum(series, 0.0))

    def level(self, view: Side, light: Side, pol: int, p: int) -> Array:
        """Return the mean square over the pairs with either direction, `[view, light]`."""
        rows, left = self._weights(view)
        columns, right = self._weights(light)
        by_view = left @ self.levels[rows, int(light.directions.below), pol, p]
        by_light = right @ self.levels[columns, int(view.directions.below), p, pol]
        return np.asarray(0.5 * (np.maximum(by_view, 0.0)[:, None] + np.maximum(by_light, 0.0)))


def _nodes(layer: Monolayer, below: bool) -> list[Array]:
    """Sines for the model nodes on one side."""
    return node_sines(layer.surface.index_below, below, MODEL_NODES, WIDEST)


def _solid(layer: Monolayer, below: bool) -> Array:
    """Solid angles for the nodes on one side, to some per cent."""
    return np.concatenate([-np.gradient(np.sqrt((1 - s) * (1 + s))) for s in _nodes(layer, below)])


def nearest_distance(cell: Supercell) -> float:
    """Return the smallest particle distance in a pattern, nm."""
    xy = cell.xy_nm
    if len(xy) < 2:
        return cell.period.side_nm
    distances, _ = cKDTree(xy, boxsize=cell.period.side_nm).query(xy, k=2)
    return float(distances[:, 1].min())


def same_order(layer: Monolayer, order: int, *particles: Particle) -> Monolayer:
    """Return the mean-field model with multipoles up to `order` and one particle size per species."""
    # the cutoff has little effect on few multipoles, equal in numerator and denominator
    selected = tuple(dataclasses.replace(p, t_matrix=truncated(p.t_matrix, min(order, p.lmax))) for p in particles)
    return Monolayer(layer.surface, selected, layer.structure, "qca-balanced", selected[0].lmax)


def middle_sizes(layer: Monolayer) -> tuple[Particle, ...]:
    """Return the middle particle size for each species, with the species share."""
    by_species = [
        [p for p in layer.particles if p.species == number] for number in sorted({p.species for p in layer.particles})
    ]
    return tuple(
        dataclasses.replace(sizes[len(sizes) // 2], share=float(sum(p.share for p in sizes))) for sizes in by_species
    )


def _kind_factor(cell: Supercell, shares: Array, leaving: ComplexArray, arriving: ComplexArray) -> Array:
    """Return the interference factor from the species order, `[view, light]`; 1 on average over random orders.

    sum_k |sum_j (delta_kj - x_k) e^{-i q r_j}|^2 / (N sum_k x_k (1 - x_k)), x the shares: for two species this factor
    multiplies their mean squared difference.
    """
    total = np.zeros((leaving.shape[1], arriving.shape[1]))
    for number, share in enumerate(shares):
        amount = (species_numbers(cell.xy_nm, cell.species) == number) - share
        total += np.abs((leaving * amount[:, None]).T @ arriving) ** 2
    return np.asarray(total / (len(cell.xy_nm) * np.sum(shares * (1.0 - shares))))


# Ensemble ratios over wavelength: solved at nodes, interpolated between them, cached on disk.

MOST_WAVELENGTHS = 16  # solved wavelengths; sufficient for resonances wider than 30 nm
SOLVE_S = 0.9  # seconds per pattern with `UNKNOWNS` on one core
UNKNOWNS = 2080
ONE_SIDE, OF_MIXTURES = 0.5, 1.15  # relative work without the factorisation: opaque substrate, and mixtures
TABLES_S = 1.0  # seconds per wavelength
# species at different heights need vertical translations: seconds per pattern, wave and
# pair of multipoles, and per wavelength
CARRYING_S, CARRIED_TABLES_S = 6.6e-9, 6e-5


@dataclass(frozen=True)
class EnsembleInterpolation:
    """Ratios at some wavelengths, and their standard errors.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        ratios: ratios at each of them.
        errors: relative standard error for the diffuse light above, `[wavelength, s, i]`, over azimuth and
            polarisation.
        angles_rad: `[s]`, for s and i.
        settings: ensemble size.
    """

    wavelengths_nm: Array
    ratios: tuple[Ratio, ...]
    errors: Array
    angles_rad: Array
    settings: EnsembleSettings

    def at(self, wavelength_nm: float) -> Ratio:
        """Return the ratio at a wavelength, interpolated linearly."""
        x = float(np.interp(wavelength_nm, self.wavelengths_nm, np.arange(len(self.ratios))))
        low = min(int(x), len(self.ratios) - 1)
        high = min(low + 1, len(self.ratios) - 1)
        return self.ratios[low] if x == low else self.ratios[low].mixed(self.ratios[high], x - low)

    @property
    def standard_error(self) -> float:
        """Root mean square over all wavelengths and pairs of angles, by projected solid angle."""
        projected = np.sin(2 * self.angles_rad)
        weights = projected[:, None] * projected
        return float(np.sqrt(np.mean(np.sum(weights * self.errors**2, axis=(1, 2)) / weights.sum())))

    @property
    def notes(self) -> dict[str, Any]:
        """Notes for a Bsdf."""
        return {
            "spheres": self.settings.spheres,
            "realisations": self.settings.realisations,
            "multipole_order": self.settings.multipole_order,
            "standard_error": round(self.standard_error, 4),
            "wavelengths_nm": self.wavelengths_nm.tolist(),
            "angles_deg": np.degrees(self.angles_rad).round(2).tolist(),
            "standard_errors": self.errors.round(4).tolist(),
        }


def node_wavelengths(wavelengths_nm: Array) -> Array:
    """Return the wavelengths solved for a grid: all, or at most `MOST_WAVELENGTHS` evenly spaced ones."""
    if len(wavelengths_nm) <= MOST_WAVELENGTHS:
        return wavelengths_nm
    return wavelengths_nm[np.linspace(0, len(wavelengths_nm) - 1, MOST_WAVELENGTHS).round().astype(int)]


def expected_seconds(wavelengths: int, settings: EnsembleSettings, layer: Monolayer) -> float:
    """Return the expected wall clock time for an ensemble on this machine.

    Args:
        layer: the model at any one wavelength.
    """
    n = 2 * settings.multipole_order * (settings.multipole_order + 2)
    share = settings.spheres * n / UNKNOWNS
    effort = (1.0 if layer.transmits_below else ONE_SIDE) * (1.0 if layer.shares.size == 1 else OF_MIXTURES)
    one = SOLVE_S * (0.3 * share**3 + effort * (0.4 * share**2 + 0.3 * share))  # factorisation, matrix, directions, fit
    tables = TABLES_S
    heights = np.unique([p.centre_nm for p in layer.particles])
    if len(heights) > 1:
        surface, side = layer.surface, float(np.sqrt(settings.spheres / layer.structure.density_per_nm2))
        top = translation_order(settings.multipole_order, surface.inner_wavenumber * float(np.ptp(heights)))
        carried = (2 * top * (top + 2)) ** 2
        largest = max_far_wavenumber(surface, REACH * side) * surface.inner_wavenumber
        waves = np.pi * (largest * side / (2 * np.pi)) ** 2
        one += CARRYING_S * waves * n * carried
        tables += CARRIED_TABLES_S * carried
    return wavelengths * (tables + settings.realisations * one / min(available_jobs(), settings.realisations))


def interpolate_ensemble(
    wavelengths_nm: Array,
    layer: Callable[[float], Monolayer],
    pattern: Callable[[int, int], Pattern],
    settings: EnsembleSettings,
    seed: int,
    source: str,
    is_list: bool = False,
    because: str = "",
) -> EnsembleInterpolation:
    """Return the ratios for a wavelength grid, reusing cached results, also from an interrupted run.

    Args:
        wavelengths_nm: ascending.
        layer: the mean-field model at a wavelength, used with the middle particle size per species.
        pattern: function (count, seed) that returns the arrangement.
        source: recipe name, for messages.
        is_list: whether the arrangement is a point list.
        because: reason for an ensemble, for the progress message.

    Raises:
        UnsupportedError: the ensemble is too large for the memory.
    """
    size = settings.spheres * 2 * settings.multipole_order * (settings.multipole_order + 2)
    if not is_on_cluster():
        check_memory(
            3.0 * 8.0 * size**2 * available_jobs(),
            f"{source}: model.ensemble.spheres = {settings.spheres} of order {settings.multipole_order}",
            "take fewer spheres, or fewer --jobs",
        )
    solved_at = node_wavelengths(np.atleast_1d(np.asarray(wavelengths_nm, dtype=float)))
    first = layer(float(solved_at[0]))
    structure = first.structure
    made = supercells(
        pattern,
        structure.density_per_nm2,
        structure.diameter_nm,
        settings.spheres,
        settings.realisations,
        seed,
        is_list,
    )
    ensembles = []
    for wavelength in solved_at:
        full = layer(float(wavelength))
        model = same_order(full, settings.multipole_order, *middle_sizes(full))
        ensembles.append(Ensemble(model, with_species(made, model.shares, seed) if len(model.particles) > 1 else made))
    keys = [_key(one, settings) for one in ensembles]
    stored = [_read(key) for key in keys]
    missing = [n for n, one in enumerate(stored) if one is None]
    if missing:
        cached = [_read_patterns(keys[n], len(made)) for n in missing]
        done_before = sum(len(patterns) for patterns in cached)
        share = 1.0 - done_before / (len(missing) * len(made))
        seconds = share * expected_seconds(len(missing), settings, ensembles[0].layer)
        parts = []
        if len(missing) < len(stored):
            parts.append(f"{len(stored) - len(missing)} more are cached")
        if done_before:
            noun = "pattern" if done_before == 1 else "patterns"
            parts.append(f"{done_before} {noun} of these {'is' if done_before == 1 else 'are'} cached")
        reused = f" ({', '.join(parts)})" if parts else ""
        noun = "wavelength" if len(missing) == 1 else "wavelengths"
        time = "on a cluster" if is_on_cluster() else f"about {duration(seconds)}"
        announce(
            f"{source}: {because}{settings.realisations} patterns of {settings.spheres} particles at {len(missing)} "
            f"{noun}{reused}: {time}",
            seconds,
        )
        for n, solved in _solve([ensembles[n] for n in missing], [keys[n] for n in missing], missing, cached):
            stored[n] = solved
    done = [one for one in stored if one is not None]
    angles = ensembles[0].angles_rad
    return EnsembleInterpolation(solved_at, tuple(r for r, _ in done), np.stack([e for _, e in done]), angles, settings)


def _solve(
    ensembles: list[Ensemble], keys: list[str], names: list[int], cached: list[dict[int, dict[Block, Sums]]]
) -> list[tuple[int, tuple[Ratio, Array]]]:
    """Solve all patterns for all wavelengths, in threads or on a cluster; fit each wavelength after its last pattern.

    Each pattern is cached until the fit, for a resumed run.

    Args:
        keys, names: identify each ensemble in the disk cache and the result.
        cached: patterns already solved for each.
    """
    solved = [dict(patterns) for patterns in cached]
    out: list[tuple[int, tuple[Ratio, Array]]] = []

    def fit(n: int) -> None:
        ratio, errors = ensembles[n].ratio([solved[n][k] for k in range(len(solved[n]))])
        for one in solved[n].values():
            one.clear()  # the list of results still holds it
        _tables.pop(keys[n], None)
        _store(keys[n], ratio, errors)
        drop_arrays(_pattern_key(keys[n], k) for k in range(len(ensembles[n].supercells)))
        out.append((names[n], (ratio, errors)))

    def keep(item: tuple[int, str, Ensemble, int], one: dict[Block, Sums]) -> None:
        n, key, ensemble, number = item
        solved[n][number] = one
        if len(solved[n]) == len(ensemble.supercells):
            fit(n)
        else:
            cache_arrays(_pattern_key(key, number), as_arrays(one))

    for n, one in enumerate(ensembles):
        if len(cached[n]) == len(one.supercells):
            fit(n)
    items = [
        (n, keys[n], one, k)
        for n, one in enumerate(ensembles)
        for k in range(len(one.supercells))
        if k not in cached[n]
    ]
    try:
        in_workers(_solve_pattern, items, keep)
    finally:
        for key in keys:
            _tables.pop(key, None)
    return out


# ensembles with their tables, by key, each with a lock: in a worker process each item arrives as a new object
_tables: OrderedDict[str, tuple[Ensemble, threading.Lock]] = OrderedDict()
_tables_lock = threading.Lock()


def _solve_pattern(item: tuple[int, str, Ensemble, int]) -> dict[Block, Sums]:
    _, key, ensemble, number = item
    with _tables_lock:
        one, lock = _tables.setdefault(key, (ensemble, threading.Lock()))
        _tables.move_to_end(key)
        while len(_tables) > max(2, available_jobs()):
            _tables.popitem(last=False)
    with lock:  # the first thread computes the tables
        one.prepare()
    return one.solve(number)


def _pattern_key(key: str, number: int) -> str:
    return f"{key}-{number}"


def _read_patterns(key: str, patterns: int) -> dict[int, dict[Block, Sums]]:
    """Return the cached patterns for one wavelength, by pattern number."""
    out = {}
    for number in range(patterns):
        stored = cached_arrays(_pattern_key(key, number))
        with contextlib.suppress(KeyError, ValueError):  # damaged entries are solved again
            if stored:
                out[number] = from_arrays(stored)
    return out


def _key(one: Ensemble, settings: EnsembleSettings) -> str:
    """Return a fingerprint for optics, positions and code."""
    surface, particles, structure = one.layer.surface, one.layer.particles, one.layer.structure
    digest = hashlib.sha256()
    arrays: list[NDArray[Any]] = [surface.indices, surface.thicknesses_nm, *(p.t_matrix for p in particles)]
    arrays += [structure.q_per_nm, structure.s, structure.r_nm, structure.h]
    arrays += [cell.xy_nm for cell in one.supercells] + [cell.period.bloch for cell in one.supercells]
    arrays += [cell.species for cell in one.supercells if cell.species is not None]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    numbers = [
        surface.wavelength_nm,
        structure.density_per_nm2,
        structure.diameter_nm,
        *(n for p in particles for n in (p.share, p.centre_nm, p.cut or 0.0)),
        *(n for cell in one.supercells for n in (cell.period.side_nm, float(cell.seed))),
        *([float(surface.host)] if isinstance(surface, Embedded) else ()),
    ]
    return "ensemble-" + fingerprint(
        {"arrays": digest.hexdigest(), "numbers": [float(n).hex() for n in numbers]}, {}, settings=str(settings)
    )


def _store(key: str, ratio: Ratio, errors: Array) -> None:
    names = {"-".join(map(str, block)): values for block, values in ratio.coefficients.items()}
    cache_arrays(key, {**names, "errors": errors})


def _read(key: str) -> tuple[Ratio, Array] | None:
    stored = cached_arrays(key)
    if not stored or "errors" not in stored:
        return None
    errors = stored.pop("errors")
    blocks = {}
    try:
        for name, values in stored.items():
            a, b, c, d = (int(part) for part in name.split("-"))
            blocks[(a, b, c, d)] = values
    except ValueError:  # a damaged entry is solved again
        return None
    return Ratio(blocks), errors
