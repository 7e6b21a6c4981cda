"""Aligned particles without rotational symmetry in a monolayer: coherent light, diffuse light, and lobes.

The arrangement is isotropic, so the neighbour sums depend on the light azimuth phi only by phases:
Q(phi) = e^(i (m' - m) phi) Q(0). In a frame rotated with the light, Q equals any monolayer's and the particle is
rotated by -phi: M -> e^(i m phi) M e^(-i m' phi). There b = (M^-1 - Q)^-1 v is solved at each azimuth, with all orders
m coupled. Azimuths refer to in-plane wavevectors; light from azimuth a propagates at a + pi.

As in `diffuse`, f = rho |X||Y| S C / (cos_i cos_o) with the far field X and its reverse Y, and C = g_i g_o balanced to
the power that the mean field radiates, but here directions and g depend on the azimuth. Without S and C, f is smooth: a
short Fourier series in both azimuths. S has rings sharper than the azimuth step; sums over azimuths use its first
harmonics over the difference, which is exact for particle patterns with few harmonics.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.interface import AlignedSpecular
from nacre.bsdf.lobes.monolayer import Aligned, PolarGrid, pack_triangle
from nacre.core.arrays import Array, ComplexArray
from nacre.core.machine import in_threads
from nacre.families.metasurface.monolayer import evaluation
from nacre.families.metasurface.monolayer.diffuse import (
    S_HARMONICS,
    DirectionSet,
    balanced_factors,
    structure_harmonics,
)
from nacre.families.metasurface.monolayer.monolayer import Monolayer
from nacre.families.metasurface.monolayer.qca import neighbour_sums_at
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.monolayer.translation_sums import unfolded
from nacre.families.metasurface.tmatrix.axisymmetric import (
    MultipoleIndex,
    multipole_index,
    spread_blocks,
    truncated_full,
    truncated_index,
    with_negative_orders,
)
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions, dressed_matrix, hemisphere_rule
from nacre.families.metasurface.tmatrix.substrate import Substrate


@dataclass(frozen=True)
class AlignedIllumination:
    """Directions on one side with the response to light from there, neighbours included.

    Attributes:
        directions: excitation and emission vectors.
        emission: u, `[pol, n, angle]`, at azimuth 0.
        response: b in the frame rotated with the light, `[azimuth, pol, n, angle]`.
    """

    directions: Directions
    emission: ComplexArray
    response: ComplexArray


@dataclass(frozen=True)
class AlignedLayer:
    """Aligned particles on a stack at one wavelength.

    Attributes:
        mean: the monolayer with rotationally averaged particles: stack, arrangement, neighbour sums.
        full: full T for one particle, `[n, n']`, with at least the `mean` multipoles.
    """

    mean: Monolayer
    full: ComplexArray

    @cached_property
    def index(self) -> MultipoleIndex:
        """The flat multipole index."""
        return self._multipoles[0]

    @cached_property
    def _multipoles(self) -> tuple[MultipoleIndex, NDArray[np.intp]]:
        sphere = self.mean.spheres[0]
        return truncated_index(sphere.lmax, sphere.mmax)

    @cached_property
    def dressed(self) -> ComplexArray:
        """M = (T^-1 - W)^-1 for the particle above its stack, `[n, n']`."""
        index, selected = self._multipoles
        t = truncated_full(self.full, index.order)[selected[:, None], selected]
        return np.asarray(dressed_matrix(t[None], spread_blocks(self.mean.spheres[0].coupling, index)[None])[0])

    @cached_property
    def _exchanged(self) -> tuple[int, NDArray[np.intp]]:
        """The neighbour interaction order, and its multipole places in `index`."""
        order = min(self.mean.interaction_order, self.index.order, self.mean.spheres[0].mmax)
        places = {k: i for i, k in enumerate(zip(self.index.m, self.index.tau, self.index.l, strict=True))}
        few = multipole_index(order)
        return order, np.array([places[key] for key in zip(few.m, few.tau, few.l, strict=True)])

    def illuminate(
        self,
        cosines: Array,
        azimuths: Array,
        below: bool = False,
        sines: Array | None = None,
        untabulated: bool = False,
    ) -> AlignedIllumination:
        """Return the directions at `cosines` on one side, and the response to light with wavevectors at `azimuths`.

        Args:
            untabulated: compute the neighbour sums at these few angles without a table.
        """
        directions = self.mean.spheres[0].directions(cosines, below, sines)
        order, few = self._exchanged
        if untabulated:
            geometry = self.mean.neighbour_geometry(order)
            folded = neighbour_sums_at(geometry, directions, self.mean.includes_near_fields)
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
        local = np.linalg.solve(system, own[:, :, few].transpose(0, 3, 2, 1))
        added = (sums @ local).transpose(0, 3, 2, 1)  # azimuth, pol, n, angle
        passed = self.dressed[:, few] @ (here.conj()[:, None, :, None] * added)
        return AlignedIllumination(
            directions, with_negative_orders(directions.emission, self.index), own + turn * passed
        )

    def leaving(self, cosines: Array, below: bool) -> Directions:
        """Return emission directions to one side."""
        return self.mean.spheres[0].directions(cosines, below)

    def coherent_sum(self, emission: ComplexArray, lit: AlignedIllumination) -> ComplexArray:
        """Return F towards the reflected or refracted direction for each in `lit`, nm, `[azimuth, q, p, angle]`."""
        return np.asarray(np.einsum("qna,fpna->fqpa", emission, lit.response) / self.mean.surface.inner_wavenumber)

    def specular_above(self, cosines: Array, azimuths: Array, untabulated: bool = False) -> tuple[Array, Array]:
        """Power reflectance and transmittance for coherent light from above, `[azimuth, pol, angle]`."""
        layer = self.mean
        k, rho = layer.surface.wavenumber, layer.structure.density_per_nm2
        lit = self.illuminate(cosines, azimuths, untabulated=untabulated)
        r = 2 * np.pi * rho / (k * cosines) * self.coherent_sum(lit.emission, lit) + _both(lit.directions.reflection)
        reflected = np.sum(np.abs(r) ** 2, axis=1)
        if not layer.transmits_below:
            return reflected, np.zeros(reflected.shape)
        out, cos_below, uncovered = layer.refracted(cosines)
        sent = self.coherent_sum(with_negative_orders(out[0].emission, self.index), lit)
        t = 2 * np.pi * rho / (k * cos_below) * sent + _both(uncovered)
        return reflected, cos_below / cosines * np.sum(np.abs(t) ** 2, axis=1)

    def specular_below(self, cosines: Array, azimuths: Array) -> Array:
        """Power reflectance for coherent light from below, `[azimuth, pol, angle]`."""
        layer = self.mean
        k, rho = layer.surface.wavenumber, layer.structure.density_per_nm2
        lit = self.illuminate(cosines, azimuths, below=True)
        first = lit.directions
        summed = self.coherent_sum(lit.emission, lit)
        r = 2 * np.pi * rho / (k * cosines * first.index) * summed + _both(first.reflection)
        return np.asarray(np.sum(np.abs(r) ** 2, axis=1))


def _both(amplitudes: ComplexArray) -> ComplexArray:
    """Return the s and p amplitudes, `[pol, angle]`, as a diagonal Jones matrix, `[q, p, angle]`."""
    return np.asarray(np.eye(2)[:, :, None] * amplitudes[None])


AZIMUTHS = 24  # multiples by four make 90 degree rotations exact


@dataclass(frozen=True)
class AlignedTerm:
    """The diffuse power between all direction pairs; angle s (i) with azimuth b (a), above first.

    Attributes:
        power: `[s, b, i, a]`, rho |X||Y| C / (n_s n_i), unpolarised, without S.
        flow: the same times the low S harmonics.
    """

    power: Array
    flow: Array


def azimuth_nodes(count: int) -> Array:
    """Return the direction azimuths, `[azimuth]`."""
    return np.asarray(np.arange(count) * (2 * np.pi / count), dtype=np.float64)


def light_of(layer: AlignedLayer, cosines: Array, below: bool, count: int) -> AlignedIllumination:
    """Return the response to light from directions at `count` azimuths, whose wavevectors are opposite."""
    return layer.illuminate(cosines, azimuth_nodes(count) + np.pi, below)


def aligned_term(layer: AlignedLayer, sides: list[tuple[AlignedIllumination, Array]]) -> AlignedTerm:
    """Return the diffuse term between all `sides` directions (above first), each with its weights dmu.

    Args:
        layer: the monolayer.
        sides: from `light_of`, with polar angle weights.
    """
    count = len(sides[0][0].response)
    joined = DirectionSet.join([(lit.directions, w) for lit, w in sides])
    is_below = np.concatenate([np.full(w.size, lit.directions.below) for lit, w in sides])
    layer_mean = layer.mean
    k, rho = layer_mean.surface.wavenumber, layer_mean.structure.density_per_nm2
    leaving, arriving = _turned(layer, sides, count)
    smooth_s = smooth_structure(joined, layer, k, count)
    size = joined.cosines.size
    power = np.empty((size, 2, count, size, 2, count))
    totals = np.zeros((2, size, 2, count))  # view side
    step = 2 * np.pi / count
    weights = joined.weights * joined.index**2
    scale = rho / (joined.index[:, None] * joined.index)
    for s in range(size):
        part = slice(0, s + 1)
        forth = _squared(leaving[s], arriving[part])  # q b, i p a
        back = _squared(leaving[part], arriving[s], True)
        weighted = (scale[s, part] * step)[:, None, None] * smooth_s[s, part]  # i b a
        to_s = np.einsum("qbipa,iba->ipa", forth, weighted)
        totals[int(is_below[s]), part] += weights[s] * to_s
        to_i = np.einsum("qbipa,iba->iqb", back, weighted)
        for side in range(2):
            lit = (is_below[part] == side) & (np.arange(s + 1) < s)
            totals[side, s] += np.einsum("i,iqb->qb", weights[part] * lit, to_i)
        both = np.sqrt(forth * back)
        power[s, :, :, part] = both
        power[part, :, :, s] = both.transpose(2, 3, 4, 0, 1)
    flow = power * (scale[:, None, None, :, None, None] * smooth_s.transpose(0, 2, 1, 3)[:, None, :, :, None])
    factors = _factors(flow, totals, weights * step, is_below)
    pair = factors[..., is_below.astype(int)]  # [s, q, b, i]: g(s) for the side of i
    # one direction at a time limits the memory
    for s in range(size):
        c = pair[s][..., None, None] * pair[..., s].transpose(0, 1, 2)[None, None]
        power[s] *= scale[s, :, None, None] * c
        flow[s] *= c
    return AlignedTerm(0.5 * power.sum(axis=(1, 4)), 0.5 * flow.sum(axis=(1, 4)))


def _turned(
    layer: AlignedLayer, sides: list[tuple[AlignedIllumination, Array]], count: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return emission towards and response to light from each direction, `[angle, pol, azimuth, n]`.

    Both are in the surface frame, over the root of the inner k.
    """
    m, alpha = layer.index.m, azimuth_nodes(count)
    root = np.sqrt(layer.mean.surface.inner_wavenumber)
    emission = np.concatenate([lit.emission for lit, _ in sides], axis=-1).transpose(2, 0, 1)
    response = np.concatenate([lit.response for lit, _ in sides], axis=-1).transpose(3, 1, 0, 2)
    wave = np.exp(1j * np.multiply.outer(alpha, m))
    leaving = emission[:, :, None] * wave / root
    arriving = response * (wave * np.where(m % 2 == 0, 1.0, -1.0)).conj() / root
    return np.ascontiguousarray(leaving), np.ascontiguousarray(arriving)


def _squared(leaving: ComplexArray, arriving: ComplexArray, is_reverse: bool = False) -> Array:
    """Return |F|^2 for one angle s and several i, `[q, b, i, p, a]`; reversed: light from s to i."""
    n = leaving.shape[-1]
    of_leaving, of_arriving = leaving.reshape(-1, n), arriving.reshape(-1, n)
    amplitude = of_arriving @ of_leaving.T if is_reverse else of_leaving @ of_arriving.T
    one, many = (arriving, leaving) if is_reverse else (leaving, arriving)
    return np.asarray((amplitude.real**2 + amplitude.imag**2).reshape(*one.shape[:2], *many.shape[:3]))


def far_powers(layer: AlignedLayer, leaving: Directions, lit: AlignedIllumination, count: int) -> Array:
    """Return |F|^2 at `count` azimuths relative to the light, `[q, azimuth, s, p, i]`, nm^2."""
    emission = with_negative_orders(leaving.emission, layer.index)  # q, n, s
    wave = np.exp(1j * np.multiply.outer(azimuth_nodes(count), layer.index.m))
    amplitude = np.einsum("qns,bn,pni->qbspi", emission, wave, lit.response[0], optimize=True)
    return np.asarray((amplitude.real**2 + amplitude.imag**2) / layer.mean.surface.inner_wavenumber**2)


def smooth_structure(
    joined: DirectionSet, layer: AlignedLayer, wavenumber: float, count: int, against_wave: bool = False
) -> Array:
    """Return the low S harmonics between direction pairs, `[s, i, b, a]`.

    Args:
        against_wave: measure the light azimuth by its wavevector.
    """
    few = min(S_HARMONICS, count // 2)
    harmonics = structure_harmonics(joined, layer.mean.structure, wavenumber, few) / (2 * np.pi)
    k = np.arange(few)
    # the light wavevector is opposite to its direction
    difference = azimuth_nodes(count) - (0.0 if against_wave else np.pi)
    waves = np.where(k == 0, 1.0, 2.0)[:, None] * np.cos(np.multiply.outer(k, difference))
    by_difference = harmonics @ waves
    nodes = np.arange(count)
    return by_difference[:, :, (nodes[:, None] - nodes) % count]


def _factors(flow: Array, totals: Array, weights: Array, is_below: NDArray[np.bool_]) -> Array:
    """Return g, `[angle, pol, azimuth, other side]`."""
    size, _, count = flow.shape[:3]

    def rows(chosen: NDArray[np.intp]) -> NDArray[np.intp]:
        return np.asarray((chosen[:, None] * 2 * count + np.arange(2 * count)).ravel())

    flat = flow.reshape(size * 2 * count, -1)
    sums = totals.reshape(2, -1)
    out = np.ones((size * 2 * count, 2))
    above, below = rows(np.nonzero(~is_below)[0]), rows(np.nonzero(is_below)[0])

    def block(viewed: NDArray[np.intp], lit: NDArray[np.intp]) -> Array:
        return flat[viewed[:, None], lit] if below.size else flat

    def total(viewed: NDArray[np.intp], lit: NDArray[np.intp]) -> Array:
        return np.asarray(sums[int(viewed is below), lit])

    balanced_factors(out, block, total, np.repeat(weights, 2 * count), above, below)
    return out.reshape(size, 2, count, 2)


NO_ENSEMBLE = "aligned particles have no ensemble, so the error of their mean field is not measured"
NODES = np.linspace(0.0, 1.0, 129), np.linspace(0.0, 1.0, 33)  # specular tables, below and beyond the critical angle
SPECULAR_STEPS = 72  # specular table azimuths; the interpolation error is 0.4 % of the variation
LEFT_OUT = 5e-4  # relative rms for all omitted Fourier terms in f
MOST_TERMS = 48
VALUE_NODES = 12  # balance nodes over the cosine, for direct values to 1e-4
# angles above an opaque substrate; on a clear one above, below and beyond the critical angle
MOST_ANGLES = 64, (40, 20, 14)


def aligned_grids(grids: evaluation.Grids) -> evaluation.Grids:
    """Limit the angle count by time and memory for azimuth pairs."""
    opaque, (above, below, beyond) = MOST_ANGLES
    if grids.below is None:
        return evaluation.Grids(PolarGrid(min(grids.above.count, opaque)), None)
    side = grids.below
    return evaluation.Grids(
        PolarGrid(min(grids.above.count, above)),
        PolarGrid(min(side.count, below if side.beyond else above), min(side.beyond, beyond), side.eta),
    )


@dataclass(frozen=True)
class AlignedResult:
    """Table columns for one wavelength: specular `[azimuth, node]`, `series` `[pair, term]` of `series_orders`."""

    reflectance: Array
    transmittance: Array
    reflectance_inside: Array
    total: Array
    series: NDArray[np.float32]
    excess: float


def series_orders() -> NDArray[np.int64]:
    """Return all terms, `[term, 3]`: orders of both azimuths, and cosine or sine."""
    top = evaluation.HARMONICS - 1
    pairs = [(a, b) for a in range(top + 1) for b in range(-top, top + 1) if a > 0 or b >= 0]
    return np.array([(a, b, sine) for sine in (0, 1) for a, b in pairs])


def _series(values: Array, grids: evaluation.Grids) -> NDArray[np.float32]:
    """Return the Fourier series of f, `[s, b, i, a]`, fitted to linear interpolation, `[pair, term]`."""
    count = values.shape[1]
    series: ComplexArray = np.fft.fft2(values.transpose(0, 2, 1, 3)) / count**2
    orders = series_orders()
    half = orders[orders[:, 2] == 0, :2]
    series = series[:, :, half[:, 0] % count, half[:, 1] % count]
    starts = [0] if grids.below is None else [0, grids.above.size]
    for start in starts:  # no azimuth at the normal
        series[start, :, half[:, 0] != 0] = 0.0
        series[:, start, half[:, 1] != 0] = 0.0
    series = series - _curvature(series, grids, half) / 12.0
    real = np.where(np.any(half != 0, axis=1), 2.0, 1.0) * series.real
    return pack_triangle(np.concatenate([real, -2.0 * series.imag], axis=-1))


def _curvature(table: ComplexArray, grids: evaluation.Grids, half: NDArray[np.int64]) -> ComplexArray:
    """Return the second differences of `fit_linear`; here both angles have an azimuthal order."""
    groups = evaluation.grid_groups(grids)

    def along(which: ComplexArray, order: int, even: NDArray[np.bool_] | None = None) -> ComplexArray:
        out: ComplexArray = evaluation.differences(which.real, groups, order) + 1j * evaluation.differences(
            which.imag, groups, order
        )
        if even is not None:
            for start, _ in groups[:2]:
                out[start] = np.where(even, 2.0 * (which[start + 1] - which[start]), 0.0)
        return out

    rows = np.swapaxes(table, 0, 1)
    second = along(table, 2, half[:, 0] == 0) + np.swapaxes(along(rows, 2, half[:, 1] == 0), 0, 1)
    return second + np.swapaxes(along(np.swapaxes(along(table, 1), 0, 1), 1), 0, 1)


def _specular_tables(
    above: Callable[[Array], tuple[Array, Array]],
    below: Callable[[Array], Array],
    grids: evaluation.Grids,
    eta: float,
    index: float,
) -> tuple[Array, Array, Array, Array]:
    """Return unpolarised R, T, R from inside and R beyond the critical angle, `[..., node]`.

    Args:
        above, below: functions of cosines that return R and T, or R, `[..., pol, angle]`.
        index: relative substrate index.
    """
    safe = np.maximum(NODES[0], evaluation.GRAZING_COS)
    reflected, passed = (0.5 * p.sum(axis=-2) for p in above(safe))
    inside, total = np.zeros_like(reflected), np.zeros((*reflected.shape[:-1], 0))
    if grids.below is not None:
        inside = 0.5 * below(np.sqrt(1 - (1 - safe**2) / index**2)).sum(axis=-2)
        if eta > 1.0:
            # cos_inside/cos_critical = cos(pi x/2), without the two singular ends
            x = np.clip(NODES[1], 1e-3, 1 - 1e-3)
            total = 0.5 * below(np.cos(np.pi / 2 * x) * np.sqrt(1 - 1 / index**2)).sum(axis=-2)
    r, t, inside, total = (np.clip(t, 0.0, 1.0) for t in (reflected, passed, inside, total))
    return r, t, inside, total


def solve_aligned(layer: AlignedLayer, grids: evaluation.Grids, eta: float, count: int = AZIMUTHS) -> AlignedResult:
    """Solve one wavelength on all angles and azimuths, scaled to energy <= 1."""
    waves = azimuth_nodes(count) + np.pi
    index = layer.mean.surface.index_below
    # tables are by exit direction, opposite to the incidence from inside
    tables = _specular_tables(
        lambda cosines: layer.specular_above(cosines, waves),
        lambda cosines: layer.specular_below(cosines, waves + np.pi),
        grids,
        eta,
        index,
    )
    sides = [(light_of(layer, np.cos(grids.above.nodes), False, count), grids.above.weights)]
    if grids.below is not None:
        sides.append((light_of(layer, np.cos(grids.below.nodes), True, count), grids.below.weights))
    term = aligned_term(layer, sides)
    delta = np.stack(
        [evaluation.specular_at_nodes(grids, eta, NODES, *(t[row] for t in tables)) for row in range(count)], axis=1
    )
    n_above = grids.above.size
    if grids.below is not None:
        delta[n_above:] = np.roll(delta[n_above:], count // 2, axis=1)
    joined = DirectionSet.join([(lit.directions, w) for lit, w in sides])
    size = joined.cosines.size
    weights = np.repeat(joined.weights * joined.index**2, count) * (2 * np.pi / count)
    spread = np.repeat(joined.cosines, count)
    scale, excess = evaluation.energy_factors(term.flow.reshape(size * count, -1), weights, spread, delta.ravel())
    dispersion = index / eta if grids.below is not None else 1.0
    factor = scale / spread * np.where(np.arange(size) < n_above, 1.0, dispersion).repeat(count)
    values = (term.power.reshape(size * count, -1) * factor[:, None] * factor).reshape(size, count, size, count)
    r, t, inside, total = (_refine_azimuth(t) for t in tables)
    return AlignedResult(r, t, inside, total, _series(values, grids), excess)


def _refine_azimuth(table: Array) -> Array:
    """Interpolate a table over the azimuth, `[azimuth, ...]`, to `SPECULAR_STEPS` nodes, the first one repeated."""
    waves = np.fft.rfft(table, axis=0)
    count = len(table)
    waves[count // 2] *= 0.5  # the last harmonic is split between both signs
    fine = np.fft.irfft(waves, SPECULAR_STEPS, axis=0) * (SPECULAR_STEPS / count)
    return np.clip(np.concatenate([fine, fine[:1]]), 0.0, 1.0)


def tabulate_aligned(
    wavelengths_nm: Array,
    layer_at: Callable[[float], AlignedLayer],
    structure: Structure,
    grids: evaluation.Grids,
    eta: float,
    turn_rad: float,
) -> tuple[tuple[Lobe, ...], float]:
    """Solve all wavelengths in parallel; return the two lobes and the largest raw energy excess over 1."""

    def work(wavelength: float) -> tuple[AlignedResult, Substrate]:
        layer = layer_at(float(wavelength))
        return solve_aligned(layer, grids, eta), layer.mean.surface

    results, surfaces = zip(*in_threads(work, wavelengths_nm))
    series = evaluation.column(results, "series")
    chosen = _select_terms(series)
    values, orders = np.ascontiguousarray(series[:, chosen]), series_orders()[chosen].astype(float)
    k, index, step, s = evaluation.lobe_axes(surfaces, structure, grids)
    lobe = Aligned(wavelengths_nm, *grids.counts, eta, k, index, step, s, values, orders, turn_rad)
    response = evaluation.interface_response(
        results, wavelengths_nm, grids, eta, (NODES[0], NODES[1][: results[0].total.shape[-1]])
    )
    return (AlignedSpecular(response, turn_rad), lobe), max(r.excess for r in results)


def _select_terms(series: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the selected terms, largest first.

    A term and the one with exchanged directions are selected together, for reciprocity.
    """
    orders = series_orders()
    power = np.array([np.sum(np.square(series[:, t], dtype=float)) for t in range(len(orders))])
    power *= np.where(np.any(orders[:, :2] != 0, axis=1), 0.5, 1.0)
    places = {tuple(row): t for t, row in enumerate(orders.tolist())}
    partner = [places.get((b, a, sine), places.get((-b, -a, sine), 0)) for a, b, sine in orders.tolist()]
    both = power + power[partner]
    order = np.argsort(-both, kind="stable")
    omitted = 1.0 - np.cumsum(power[order]) / max(float(power.sum()), 1e-300)
    count = min(int(np.searchsorted(-omitted, -(LEFT_OUT**2))) + 1, MOST_TERMS, len(order))
    chosen = np.nonzero(both >= both[order[count - 1]])[0]
    return np.asarray(chosen[np.argsort(-both[chosen], kind="stable")])


def aligned_powers(layer: AlignedLayer, cosines: Array, azimuth_rad: float) -> tuple[Array, Array, Array, Array]:
    """Return specular R and T, diffuse R and T for light from above and one azimuth, each `[pol, angle]`, raw.

    Args:
        layer: the monolayer.
        cosines: `[angle]`, incident, > 0.
        azimuth_rad: incident, relative to the particle x axis.
    """
    wave = np.array([azimuth_rad + np.pi])
    reflected, passed = (p[0] for p in layer.specular_above(cosines, wave, untabulated=True))
    lit = layer.illuminate(cosines, wave, untabulated=True)
    up = _diffuse_power(layer, lit, wave[0], *hemisphere_rule(evaluation.ABOVE_NODES), False)
    if not layer.mean.transmits_below:
        return reflected, passed, up, np.zeros_like(up)
    rule = hemisphere_rule(evaluation.BELOW_NODES, layer.mean.surface.index_below)
    return reflected, passed, up, _diffuse_power(layer, lit, wave[0], *rule, True)


def aligned_values(layer: AlignedLayer, wi: Array, wo: Array, turn_rad: float) -> Array:
    """Return the diffuse BRDF for direction pairs above the surface, `[pair]`, 1/sr, unpolarised.

    Args:
        layer: the monolayer.
        wi, wo: `[pair, 3]`, unit vectors, z > 0.
        turn_rad: particle rotation.
    """
    mu, weights = hemisphere_rule(VALUE_NODES)
    cosines, place = np.unique(np.concatenate([wi[:, 2], wo[:, 2]]), return_inverse=True)
    lit = light_of(layer, np.concatenate([mu, cosines]), False, AZIMUTHS)
    term = aligned_term(layer, [(lit, np.concatenate([weights, np.zeros(cosines.size)]))])
    i, o = mu.size + place[: len(wi)], mu.size + place[len(wi) :]
    series: ComplexArray = np.fft.fft2(term.power[o[:, None], :, i[:, None]][:, 0]) / AZIMUTHS**2  # pair, of wo, of wi
    order = np.fft.fftfreq(AZIMUTHS, 1.0 / AZIMUTHS)
    order[AZIMUTHS // 2] = 0.0  # ambiguous sign, negligible
    series[:, AZIMUTHS // 2] = series[:, :, AZIMUTHS // 2] = 0.0
    of_o, of_i = (np.exp(1j * np.outer(np.arctan2(w[:, 1], w[:, 0]) - turn_rad, order)) for w in (wo, wi))
    smooth = np.einsum("nb,nba,na->n", of_o, series, of_i).real
    q = np.hypot(*(wi + wo)[:, :2].T)  # between the in-plane wavevectors, -wi and wo
    s = layer.mean.structure.structure_factor(layer.mean.surface.wavenumber * q)
    return np.asarray(np.maximum(smooth, 0.0) * s / (wi[:, 2] * wo[:, 2]))


def _diffuse_power(
    layer: AlignedLayer, lit: AlignedIllumination, wave: float, mu: Array, weights: Array, below: bool
) -> Array:
    """Return the diffuse power emitted to one side per incident irradiance, `[pol, angle]`."""
    leaving = layer.leaving(mu, below)
    power = far_powers(layer, leaving, lit, AZIMUTHS)  # q, b, s, p, i
    away = DirectionSet.join([(leaving, weights), (lit.directions, np.zeros(lit.directions.cosines.size))])
    views = slice(0, mu.size), slice(mu.size, None)
    s = smooth_structure(away, layer, layer.mean.surface.wavenumber, AZIMUTHS, against_wave=True)[views][..., 0]
    step = 2 * np.pi / AZIMUTHS
    density = layer.mean.structure.density_per_nm2
    return np.asarray(
        density * leaving.index * step * np.einsum("s,qbspi,sib->pi", weights, power, s) / lit.directions.cosines
    )
