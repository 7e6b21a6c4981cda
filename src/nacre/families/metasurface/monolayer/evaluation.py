"""Monolayer evaluation: Bsdf lobe tables with an energy check, and direct values at a few directions.

The balance in `diffuse` gives every direction the diffuse power that its mean field radiates. That total needs only the
response at the requested directions and the emission at quadrature nodes; the neighbour sums are computed at the
requested angles. The result equals the full term to rounding with the same quadrature, except for interpolation in
the neighbour table.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.angle_nodes import AngleErrors
from nacre.bsdf.angle_nodes import tabulate as tabulate_nodes
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.interface import Specular
from nacre.bsdf.lobes.monolayer import Harmonic, PolarGrid, pack_triangle
from nacre.bsdf.response import InterfaceResponse, is_uniform
from nacre.core.arrays import Array
from nacre.core.machine import in_threads
from nacre.families.metasurface.monolayer.diffuse import HARMONICS as HARMONICS_few
from nacre.families.metasurface.monolayer.diffuse import DiffuseTerm, diffuse_term
from nacre.families.metasurface.monolayer.monolayer import Illumination, Monolayer
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions, amplitude, hemisphere_rule
from nacre.families.metasurface.tmatrix.substrate import Substrate

HARMONICS = 8  # harmonics in the tables; higher ones are below 0.3 % of the largest value
LOW_OPAQUE = 48  # angles above a thin opaque structure
LOW_CLEAR = (32, 24, 16)  # thin and on a clear substrate: above, below within and beyond the critical angle
MOST_NODES = 257  # nodes of the specular tables
ACCEPTED = (2e-3, 2e-3)  # error of R and T, below which 65 nodes suffice or intervals are not halved
CHECKED_ANGLES = 30
GRAZING_COS = 1e-3  # replaces 0, at which the monolayer wave diverges
SCALING_STEPS = 200


@dataclass(frozen=True)
class Grids:
    """Angular grids for the diffuse tables; `below` is None without transmission."""

    above: PolarGrid
    below: PolarGrid | None

    @property
    def counts(self) -> tuple[int, int, int]:
        """Angle counts above, below within and beyond the critical angle."""
        below = self.below or PolarGrid(0)
        return self.above.count, below.count, below.beyond


def choose_grids(eta: float | None, polydisperse: bool, thick: bool, low: bool = False) -> Grids:
    """Return angular grids fine enough for the stack, with tables below 100 MB for 48 wavelengths.

    Linear interpolation has a relative L2 error 0.5 % (0.8 % for a film that guides light; 4 % for suspended silicon
    near its resonance, nearly all in the last two degrees); for thin structures 0.35 %, with a size distribution 0.45
    %. Fewer nodes also speed up renders, whose random access then stays in the processor cache.

    Args:
        eta: relative index for a transparent substrate; None for an opaque one.
        polydisperse: whether the tables without S are needed.
        thick: whether films above a micrometre cause fringes over the angle (0.5 degree steps).
        low: whether films and particles together are too thin for fringes.
    """
    if eta is None:
        count = (170 if polydisperse else 180) if thick else LOW_OPAQUE if low else 120
        return Grids(PolarGrid(count), None)
    if eta == 1.0:  # suspended particles are steep near grazing
        count = 72 if polydisperse else 100
        return Grids(PolarGrid(count), PolarGrid(count))
    if low:
        above, below, beyond = LOW_CLEAR
        return Grids(PolarGrid(above), PolarGrid(below, beyond, eta))
    above = int((130 if thick else 100) * (0.7 if polydisperse else 1.0))
    return Grids(PolarGrid(above), PolarGrid(int(0.62 * above), int(0.26 * above), eta))


def fit_linear(table: Array, grids: Grids) -> Array:
    """Return nodes whose linear interpolation fits a smooth table in the mean square.

    Interpolation between exact nodes overestimates convex functions. The optimal nodes are shifted by 1/12 times
    the second differences, which removes the mean error and leaves 0.4 of the rms error. On triangles the mixed
    difference of both angles counts like those of each.

    Args:
        table: `[s, i, harmonic]`, nodes above, then below, symmetric.
        grids: for the nodes; no difference crosses the critical angle.
    """
    starts = grid_groups(grids)
    rows = np.swapaxes(table, 0, 1)
    second = differences(table, starts, 2) + np.swapaxes(differences(rows, starts, 2), 0, 1)
    mixed = np.swapaxes(differences(np.swapaxes(differences(table, starts, 1), 0, 1), starts, 1), 0, 1)
    return table - (second + mixed) / 12.0


def grid_groups(grids: Grids) -> list[tuple[int, int]]:
    """Return the node range for each smooth grid part."""
    starts = [(0, grids.above.count)]
    if grids.below is not None:
        n, below = grids.above.size, grids.below
        starts += [(n, n + below.count), (n + below.count, n + below.size)]
    return starts


def differences(table: Array, groups: list[tuple[int, int]], order: int) -> Array:
    """Return first or second central differences along the first axis within groups; zero at their ends."""
    out = np.zeros_like(table)
    for start, stop in groups:
        if stop - start < 3:
            continue
        before, here, after = table[start : stop - 2], table[start + 1 : stop - 1], table[start + 2 : stop]
        out[start + 1 : stop - 1] = after - 2.0 * here + before if order == 2 else 0.5 * (after - before)
    if order == 2:
        for start, _ in groups[:2]:  # at the normal the azimuthal mean is even
            out[start, :, 0] = 2.0 * (table[start + 1, :, 0] - table[start, :, 0])
    return out


@dataclass(frozen=True)
class WavelengthResult:
    """Table columns for one wavelength; directions as in `Grids`, see `tabulate`."""

    reflectance: Array
    transmittance: Array
    reflectance_inside: Array
    total: Array
    above: NDArray[np.float32]
    below: NDArray[np.float32]
    across: NDArray[np.float32]
    free: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
    excess: float


@dataclass(frozen=True)
class SpecularTables:
    """Coherent powers of all wavelengths on nodes over angle that follow the optics; see `nacre.bsdf.angle_nodes`.

    Attributes:
        cosines: `[node]`, outside.
        beyond: `[x]`, nodes beyond the critical angle.
        sides: `[node, 3, wavelength]`, R, T and R from inside.
        total: `[x, wavelength]`, R from inside beyond the critical angle.
        errors: the interpolation errors found.
    """

    cosines: Array
    beyond: Array
    sides: Array
    total: Array
    errors: AngleErrors

    def at(self, band: int) -> tuple[Array, Array, Array, Array]:
        """Return R, T, R from inside and R beyond the critical angle at one wavelength, each `[node]`."""
        sides = np.clip(self.sides[:, :, band], 0.0, 1.0)
        return sides[:, 0], sides[:, 1], sides[:, 2], np.clip(self.total[:, band], 0.0, 1.0)

    @classmethod
    def solve(cls, layers: Sequence[Monolayer], grids: Grids, eta: float) -> SpecularTables:
        """Tabulate on uniform nodes where these are exact enough, and otherwise on dyadic ones."""
        transmits = grids.below is not None

        def outside(cos: Array) -> Array:
            safe = np.maximum(cos, GRAZING_COS)

            def column(layer: Monolayer) -> Array:
                r, t = (0.5 * p.sum(axis=-2) for p in layer.specular_above(safe))
                inside = np.zeros_like(r)
                if transmits:
                    inner = np.sqrt(1 - (1 - safe**2) / layer.surface.index_below**2)
                    inside = 0.5 * layer.specular_below(inner).sum(axis=-2)
                return np.stack([r, t, inside], axis=-1)

            return np.stack(in_threads(column, layers), axis=-1)

        def beyond(x: Array) -> Array:
            # cos_inside/cos_critical = cos(pi x/2), without the two singular ends
            part = np.cos(np.pi / 2 * np.clip(x, 1e-3, 1 - 1e-3))

            def column(layer: Monolayer) -> Array:
                inner = part * np.sqrt(1 - 1 / layer.surface.index_below**2)
                return np.asarray(0.5 * layer.specular_below(inner).sum(axis=-2))

            return np.stack(in_threads(column, layers), axis=-1)

        angles = (np.arange(CHECKED_ANGLES) + 0.5) / CHECKED_ANGLES
        above = tabulate_nodes(outside, MOST_NODES, np.cos(np.pi / 2 * angles), angles[:0], (6, 7), *ACCEPTED)
        outside_errors = np.arccos(above.checked)[:, None], above.errors
        if not (transmits and eta > 1.0):
            errors = AngleErrors(outside_errors, outside_errors) if transmits else AngleErrors(outside_errors)
            return cls(above.nodes, np.zeros(0), above.values, np.zeros((0, len(layers))), errors)
        below = tabulate_nodes(beyond, MOST_NODES, angles[::2], angles[:0], (4, 5), *ACCEPTED)
        index = np.array([layer.surface.index_below for layer in layers])
        conjugate = np.arcsin(np.minimum(np.sin(outside_errors[0]) / index, 1.0))
        critical = np.sqrt(np.maximum(1 - 1 / index**2, 0.0))
        angles = np.concatenate([conjugate, np.arccos(critical * np.cos(np.pi / 2 * below.checked)[:, None])])
        errors = AngleErrors(outside_errors, (angles, np.concatenate([above.errors, below.errors])))
        return cls(above.nodes, below.nodes, above.values, below.values, errors)


def solve_wavelength(layer: Monolayer, grids: Grids, eta: float, solved: SpecularTables, band: int) -> WavelengthResult:
    """Solve one wavelength on all angles: diffuse tables scaled to energy <= 1 with the specular ones."""
    index = layer.surface.index_below
    specular = solved.at(band)
    nodes = solved.cosines, solved.beyond
    sides = [(layer.illuminate(np.cos(grids.above.nodes)), grids.above.weights)]
    if grids.below is not None:
        sides.append((layer.illuminate(np.cos(grids.below.nodes), True), grids.below.weights))
    term = diffuse_term(layer, sides, HARMONICS)
    scale, excess = _energy_scale(term, sides, specular_at_nodes(grids, eta, nodes, *specular), index)
    n_above = grids.above.size
    dispersion = index / eta if grids.below is not None else 1.0
    all_cos = np.concatenate([lit.cosines for lit, _ in sides])
    factor = scale[:, None] * scale / (all_cos[:, None] * all_cos)
    tables = []
    for source in (term.coherent, term.varying):
        if source.size == 0:
            empty = np.zeros((0, HARMONICS), np.float32)
            tables.append((empty, empty, empty))
            continue
        full = fit_linear(0.5 * source.sum(axis=(2, 3)) * factor[..., None], grids)
        across = np.ascontiguousarray((full[n_above:, :n_above] * dispersion).reshape(-1, HARMONICS), dtype=np.float32)
        below = pack_triangle(full[n_above:, n_above:] * dispersion**2)
        tables.append((pack_triangle(full[:n_above, :n_above]), below, across))
    return WavelengthResult(*specular, *tables[0], tables[1], excess)


def specular_at_nodes(
    grids: Grids,
    eta: float,
    nodes: tuple[Array, Array],
    reflected: Array,
    passed: Array,
    inside: Array,
    total: Array,
) -> Array:
    """R + T from the stored specular tables at the diffuse grid angles, `[angle]`.

    Args:
        nodes: table nodes: cosines outside, and coordinates beyond the critical angle.
    """
    cosines, beyond_critical = nodes
    out = np.interp(np.cos(grids.above.nodes), cosines, reflected + passed)
    if grids.below is None:
        return out
    theta = grids.below.nodes
    outer = 1 - (eta * np.sin(theta)) ** 2
    below = np.interp(np.sqrt(np.maximum(outer, 0.0)), cosines, inside + passed)
    if eta > 1.0:
        ratio = np.clip(np.cos(theta) / np.sqrt(1 - 1 / eta**2), 0.0, 1.0)
        beyond = np.interp(2 / np.pi * np.arccos(ratio), beyond_critical, total)
        below = np.where(outer < 0, beyond, below)
    return np.concatenate([out, below])


def _energy_scale(
    term: DiffuseTerm, sides: list[tuple[Illumination, Array]], specular: Array, index: float
) -> tuple[Array, float]:
    """Factors c, `[angle]`, that limit diffuse powers c_s c_i to energy conservation, and the raw excess."""
    cosines = np.concatenate([lit.cosines for lit, _ in sides])
    n2 = np.concatenate([np.full(w.size, index**2 if i else 1.0) for i, (_, w) in enumerate(sides)])
    weights = np.concatenate([w for _, w in sides]) * n2
    return energy_factors(0.5 * (term.unpolarised + term.unpolarised.T), weights, cosines, specular)


def energy_factors(pairs: Array, weights: Array, cosines: Array, specular: Array) -> tuple[Array, float]:
    """Return factors and excess as `_energy_scale` for powers between any directions.

    Args:
        pairs: `[direction, direction]`, symmetric.
        weights: solid angle times squared index.
        cosines: per direction.
        specular: R + T there.
    """
    room = np.maximum(1.0 - specular, 0.0)
    diffuse = weights @ pairs / cosines
    excess = float(np.max(diffuse - room, initial=0.0))
    c = np.ones_like(cosines)
    for _ in range(SCALING_STEPS):
        sent = c * ((weights * c) @ pairs) / cosines
        over = sent > room * (1 + 1e-9)
        if not np.any(over):
            break
        c = np.where(over, c * room / np.maximum(sent, 1e-300), c)
    return c, excess


def tabulate(
    wavelengths_nm: Array, monolayer: Callable[[float], Monolayer], structure: Structure, grids: Grids, eta: float
) -> tuple[tuple[Lobe, ...], float, AngleErrors]:
    """Solve all wavelengths in parallel.

    Returns:
        the two lobes, the largest raw energy excess over 1, and the interpolation errors of the specular one.
    """
    layers = in_threads(lambda wavelength: monolayer(float(wavelength)), wavelengths_nm)
    tables = SpecularTables.solve(layers, grids, eta)
    results = in_threads(lambda band: solve_wavelength(layers[band], grids, eta, tables, band), range(len(layers)))
    surfaces = [layer.surface for layer in layers]

    def free(i: int) -> NDArray:
        parts = np.stack([r.free[i] for r in results], axis=-1)
        return parts if parts.shape[0] else np.zeros((0, HARMONICS, len(results)), np.float32)

    above, below, across = (column(results, name) for name in ("above", "below", "across"))
    k, index, step, s = lobe_axes(surfaces, structure, grids)
    harmonic = Harmonic(
        wavelengths_nm, *grids.counts, eta, k, index, step, s, above, below, across, free(0), free(1), free(2)
    )
    response = interface_response(results, wavelengths_nm, grids, eta, (tables.cosines, tables.beyond))
    specular = Specular(dataclasses.replace(response, relative_index=index) if eta > 1.0 else response)
    return (specular, harmonic), max(r.excess for r in results), tables.errors


def column(results: Sequence[Any], name: str) -> NDArray:
    """Stack one table of all wavelengths along the last axis."""
    return np.stack([getattr(r, name) for r in results], axis=-1)


def interface_response(
    results: Sequence[Any], wavelengths_nm: Array, grids: Grids, eta: float, nodes: tuple[Array, Array]
) -> InterfaceResponse:
    """Return the specular tables from all wavelengths, on nodes as for `specular_at_nodes`."""
    names = ("reflectance", "transmittance", "reflectance_inside", "total")
    r, t, inside, total = (column(results, name) for name in names)
    cosines, beyond = nodes
    total_nodes = None if not len(beyond) or is_uniform(beyond) else beyond
    transmits = grids.below is not None
    return InterfaceResponse(wavelengths_nm, cosines, r, t, inside, total, eta, transmits, total_nodes=total_nodes)


def lobe_axes(surfaces: Sequence[Substrate], structure: Structure, grids: Grids) -> tuple[Array, Array, float, Array]:
    """Return ambient wavenumbers, indices below, and the step and values of S for a diffuse lobe."""
    wavenumbers = np.array([s.wavenumber for s in surfaces])
    indices = np.array([s.index_below if grids.below is not None else 1.0 for s in surfaces])
    return wavenumbers, indices, float(structure.q_per_nm[1] - structure.q_per_nm[0]), structure.s


ABOVE_NODES, BELOW_NODES = 24, 20  # nodes over the cosine, for totals to 1e-4


def direct_powers(layer: Monolayer, cosines: Array) -> tuple[Array, Array, Array, Array]:
    """Return specular R and T, diffuse R and T for light from above, each `[pol, angle]`, raw (not scaled to 1).

    Args:
        layer: with the correction "qca-balanced".
        cosines: `[angle]`, incident, > 0.
    """
    lit = layer.illuminate(cosines, untabulated=True)
    reflected, passed = layer.specular_above(cosines, lit)
    mu, weights = hemisphere_rule(ABOVE_NODES)
    up = _diffuse_power(layer, lit, mu, weights, False)
    if not layer.transmits_below:
        return reflected, passed, up, np.zeros_like(up)
    mu, weights = hemisphere_rule(BELOW_NODES, layer.surface.index_below)
    return reflected, passed, up, _diffuse_power(layer, lit, mu, weights, True)


def _diffuse_power(layer: Monolayer, lit: Illumination, mu: Array, weights: Array, below: bool) -> Array:
    """Return the diffuse power emitted to one side per incident irradiance, `[pol, angle]`.

    rho / cos_i times the integral |F|^2 S / n over the directions, for each incident polarisation.
    """
    leaving = [s.directions(mu, below) for s in layer.spheres]
    fields = layer.fields([d.emission for d in leaving], lit.response)  # size, m, q, s, p, i
    phi, step = _azimuths(fields.shape[1])
    s_weights = _structure_weights(layer, leaving[0], lit.directions[0], phi, step)
    far = np.stack([amplitude(one, phi) for one in fields])  # size, q, s, p, i, phi
    shares = layer.shares.reshape(-1, *([1] * 5))
    mean = np.abs((shares * far).sum(axis=0)) ** 2
    power = np.einsum("qspij,sij->spi", mean, s_weights)
    if len(fields) > 1:  # size fluctuations scatter without order
        varying = np.maximum((shares * np.abs(far) ** 2).sum(axis=0) - mean, 0.0)
        power = power + np.einsum("qspij,j->spi", varying, step)
    index = leaving[0].index
    density = layer.structure.density_per_nm2
    return np.asarray(density * index * np.einsum("s,spi->pi", weights, power) / lit.cosines)


def _azimuths(orders: int) -> tuple[Array, Array]:
    """Azimuths in [0, pi] and full-circle weights, exact for a product between two patterns with `orders` harmonics."""
    count = 2 * orders
    phi = np.linspace(0.0, np.pi, count + 1)
    weights = np.full(count + 1, 2.0 * np.pi / count)
    weights[[0, -1]] *= 0.5
    return phi, weights


def _structure_weights(layer: Monolayer, out: Directions, into: Directions, phi: Array, step: Array) -> Array:
    """Return weights `[s, i, phi]` that integrate a pattern with few harmonics times the sharp S over the azimuth."""
    k, structure = layer.surface.wavenumber, layer.structure
    kappa_s, kappa_i = out.transverse[:, None], into.transverse
    reach = 2.0 * float(max(kappa_s.max(), kappa_i.max())) * k * structure.diameter_nm
    samples = int(32 + 1.2 * reach)
    fine = np.linspace(0.0, np.pi, samples + 1)
    s = _structure_at(structure, k, kappa_s, kappa_i, np.cos(fine))
    count = 2 * (phi.size // 4) + 1  # harmonics in |F|^2
    orders = np.arange(count)
    ends = np.full(samples + 1, 2.0 * np.pi / samples)
    ends[[0, -1]] *= 0.5
    harmonics = s @ (ends[:, None] * np.cos(np.outer(fine, orders)))  # int S cos(k phi) dphi
    share = np.where(orders == 0, 1.0, 2.0)[:, None] * np.cos(np.outer(orders, phi)) * step / (2.0 * np.pi)
    return np.asarray(harmonics @ share)


def _structure_at(structure: Structure, k: float, kappa_s: Array, kappa_i: Array, cos_phi: Array) -> Array:
    squares = kappa_s**2 + kappa_i**2
    q = np.sqrt(np.maximum(squares[..., None] - 2.0 * (kappa_s * kappa_i)[..., None] * cos_phi, 0.0))
    return structure.structure_factor(k * q)


def direct_values(layer: Monolayer, wi: Array, wo: Array) -> Array:
    """Return the diffuse BRDF for direction pairs above the surface, `[pair]`, 1/sr, unpolarised.

    The balance uses quadrature nodes rather than the table nodes; values near grazing are not scaled to the incident
    power.

    Args:
        wi, wo: `[pair, 3]`, unit vectors, z > 0.
    """
    mu, weights = hemisphere_rule(ABOVE_NODES)
    cosines, place = np.unique(np.concatenate([wi[:, 2], wo[:, 2]]), return_inverse=True)
    lit = layer.illuminate(np.concatenate([mu, cosines]), untabulated=True)
    term = diffuse_term(layer, [(lit, np.concatenate([weights, np.zeros(cosines.size)]))], HARMONICS_few)
    i, o = mu.size + place[: len(wi)], mu.size + place[len(wi) :]
    sines = np.sqrt(np.maximum(1.0 - np.stack([wi[:, 2], wo[:, 2]]) ** 2, 0.0))
    size = sines[0] * sines[1]
    dot = wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
    # dphi is the angle between the in-plane wavevectors, -wi and wo
    cos_phi = np.where(size > 1e-14, np.clip(-dot / np.maximum(size, 1e-14), -1.0, 1.0), 1.0)
    waves = np.cos(np.arange(HARMONICS_few) * np.arccos(cos_phi)[:, None])
    q = np.sqrt(np.maximum((sines**2).sum(axis=0) + 2.0 * dot, 0.0))
    s = layer.structure.structure_factor(layer.surface.wavenumber * q)
    total = np.maximum(_at(term.coherent, o, i, waves), 0.0) * s
    if term.varying.size:
        total = total + np.maximum(_at(term.varying, o, i, waves), 0.0)
    return np.asarray(total / (wi[:, 2] * wo[:, 2]))


def _at(source: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], waves: Array) -> Array:
    """Return the unpolarised series at pairs."""
    return np.einsum("nk,nk->n", 0.5 * source[rows, columns].sum(axis=(1, 2)), waves)
