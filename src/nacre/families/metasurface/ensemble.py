"""What multi-sphere patterns of the real arrangement say of the diffuse light: the judge inside.

Patches of some 130 spheres are cut from the recipe's own pattern, each is solved with all its light at once, and the
diffuse part, the variance of the far field about its mean, is set against the mean-field model of the same multipole
order. What comes out is their smooth ratio, see `ratio`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.axial import truncated
from nacre.families.metasurface.cluster import Coupling, PlaneWaves
from nacre.families.metasurface.corrections import diffuse_term
from nacre.families.metasurface.monolayer import Lit, Monolayer, Particle
from nacre.families.metasurface.patterns import Pattern
from nacre.families.metasurface.ratio import Ratio, Ways, fit_ratio
from nacre.families.metasurface.sphere import Directions, hemisphere_rule

ABOVE_ANGLES, BELOW_ANGLES = 8, 7  # of light and view, both in the angle
WIDEST = np.radians(84.0)  # beyond, a patch is too short for the waves along it; the ratio goes on smoothly
LIGHT_AZIMUTHS, AZIMUTHS = 6, 24
HARMONICS = 14  # of the model, before it is sampled
ABOVE_NODES, BELOW_NODES = 24, 20  # of its balance over the cosine


@dataclass(frozen=True)
class EnsembleSettings:
    """How large an ensemble is: spheres a patch, patches, and the highest multipole order of a sphere."""

    spheres: int = 130
    realisations: int = 24
    multipole_order: int = 2


def patches(
    pattern: Callable[[int, int], Pattern],
    density_per_nm2: float,
    least_nm: float,
    settings: EnsembleSettings,
    seed: int,
    is_list: bool = False,
) -> list[Array]:
    """Return discs cut from patterns, `[sphere, 2]` each, about the origin, turned at random; nm.

    All discs have one size, so the number of particles varies as it does in the arrangement.

    Args:
        pattern: function of count and seed that returns a pattern.
        least_nm: the least distance; of a rare pair that is closer (a lattice with much jitter) one is left out.
        is_list: whether the pattern is always the same list of points, whose repetition is a guess: the discs are cut
            from within it.
    """
    wanted = patch_radius(density_per_nm2, settings)
    out = []
    for number in range(settings.realisations):
        rng = np.random.default_rng((seed, number))
        made = pattern(int(np.ceil(settings.spheres * 4 / np.pi * 1.2)) + 24, int(rng.integers(2**31)))
        box = made.box_nm
        radius = min(wanted, box / 2)
        if is_list:
            shifted = made.xy_nm - rng.uniform(radius, box - radius, 2)
        else:
            shifted = (made.xy_nm + rng.uniform(0.0, box, 2)) % box - box / 2
        inside = shifted[np.hypot(shifted[:, 0], shifted[:, 1]) < radius]
        close = np.asarray(cKDTree(inside).query_pairs(least_nm * (1 - 1e-6), output_type="ndarray"))
        inside = np.delete(inside, close[:, 0], axis=0)
        turn = rng.uniform(0.0, 2 * np.pi)
        c, s = np.cos(turn), np.sin(turn)
        out.append(inside @ np.array([[c, s], [-s, c]]))
    return out


def patch_radius(density_per_nm2: float, settings: EnsembleSettings) -> float:
    """Return the radius of the discs, nm."""
    return float(np.sqrt(settings.spheres / (np.pi * density_per_nm2)))


@dataclass(frozen=True)
class Ensemble:
    """The patches of a monolayer at one wavelength, of equal spheres or of a mixture.

    Attributes:
        layer: the mean-field model of the same multipole order, of one particle size a kind.
        patches: positions, nm.
        kinds: which particle of the layer each is; None: all are the first.
    """

    layer: Monolayer
    patches: list[Array]
    kinds: list[NDArray[np.intp]] | None = None

    @cached_property
    def coupling(self) -> Coupling:
        """The tables of the couplings."""
        first, *others = self.layer.particles
        return Coupling.build(self.layer.surface, first, *distances(self.patches), *others)

    @cached_property
    def sides(self) -> list[tuple[Directions, Array]]:
        """Directions of light and view of each side for the first particle, with solid-angle weights."""
        layer, order = self.layer, self.layer.particles[0].lmax
        centre = layer.particles[0].centre_nm
        x, w = np.polynomial.legendre.leggauss(ABOVE_ANGLES)
        theta = WIDEST * (x + 1) / 2
        above = Directions.build(layer.surface, centre, order, order, np.cos(theta))
        out = [(above, w * WIDEST / 2 * np.sin(theta))]
        if layer.has_below:
            mu, weights = hemisphere_rule(BELOW_ANGLES, layer.surface.index_below)
            out.append((Directions.build(layer.surface, centre, order, order, mu, True), weights))
        return out

    @cached_property
    def _waves(self) -> tuple[list[PlaneWaves], list[PlaneWaves]]:
        surface, order = self.layer.surface, self.layer.particles[0].lmax
        few = 2 * np.pi * np.arange(LIGHT_AZIMUTHS) / LIGHT_AZIMUTHS
        many = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
        sides = [
            [Directions.build(surface, p.centre_nm, order, order, d.cosines, d.below) for p in self.layer.particles]
            for d, _ in self.sides
        ]
        k = surface.wavenumber
        return (
            [PlaneWaves.build(first, few, order, k, *others) for first, *others in sides],
            [PlaneWaves.build(first, many, order, k, *others) for first, *others in sides],
        )

    @cached_property
    def ways(self) -> Ways:
        """The directions of both sides, as the ratio sees them."""
        parts = [d for d, _ in self.sides]
        return Ways.of(
            np.concatenate([d.transverse for d in parts]),
            np.concatenate([np.full(d.cosines.size, d.index) for d in parts]),
            np.concatenate([np.full(d.cosines.size, d.below) for d in parts]),
        )

    @property
    def weights(self) -> Array:
        """Solid-angle weights of `ways`."""
        return np.concatenate([w for _, w in self.sides])

    def far_fields(self, number: int) -> ComplexArray:
        """Solve one patch: F over the directions, `[pol_s, s, pol_i, i, dphi, azimuth of the light]`, nm."""
        xy = self.patches[number]
        arriving, leaving = self._waves
        light = PlaneWaves(
            np.concatenate([w.excitation for w in arriving], axis=2),
            np.concatenate([w.emission for w in arriving], axis=2),
            np.concatenate([w.wavevectors for w in arriving]),
        )
        kinds = None if self.kinds is None else self.kinds[number]
        solved = self.coupling.solve(xy, light, kinds)
        counts = [d.cosines.size for d, _ in self.sides]
        edges = np.cumsum([0, *(2 * c * LIGHT_AZIMUTHS for c in counts)])
        rows = []
        for waves, count in zip(leaving, counts):
            f = self.coupling.far_field(xy, solved, waves, kinds)
            parts = [
                f[:, a:b].reshape(2, count, AZIMUTHS, 2, c, LIGHT_AZIMUTHS) for a, b, c in zip(edges, edges[1:], counts)
            ]
            rows.append(np.concatenate(parts, axis=4))
        whole = np.moveaxis(np.concatenate(rows, axis=1), 2, 4)
        step = AZIMUTHS // LIGHT_AZIMUTHS
        # dphi counts from the light's own azimuth
        return np.stack([np.roll(whole[..., a], -a * step, axis=4) for a in range(LIGHT_AZIMUTHS)], axis=-1)

    def model(self) -> Array:
        """The mean-field model's |F|^2 S C / (n_s n_i) a particle, `[pol_s, s, pol_i, i, dphi]`, nm^2/sr."""
        layer = self.layer
        sides, at = self._balanced_sides()
        term = diffuse_term(layer, sides, HARMONICS)
        kappa = np.concatenate([d.transverse for d, _ in self.sides])
        q2 = kappa[:, None] ** 2 + kappa**2
        q = np.sqrt(np.maximum(q2[..., None] - 2 * (kappa[:, None] * kappa)[..., None] * np.cos(self._phi), 0.0))
        s = layer.structure.structure_factor(layer.surface.wavenumber * q)
        waves = np.cos(np.arange(HARMONICS)[:, None] * self._phi) / layer.structure.density_per_nm2
        values = (term.coherent[at][:, at] @ waves) * s[:, :, None, None]  # s, i, q, p, phi
        if term.varying.size:  # what differs between the kinds scatters as if nothing were ordered
            values = values + term.varying[at][:, at] @ waves
        return np.moveaxis(values, (2, 3), (0, 2))

    def _balanced_sides(self) -> tuple[list[tuple[Lit, Array]], NDArray[np.intp]]:
        """The directions with the nodes of the model's balance before them, and the places of the directions."""
        layer = self.layer
        rules = [hemisphere_rule(ABOVE_NODES)]
        if layer.has_below:
            rules.append(hemisphere_rule(BELOW_NODES, layer.surface.index_below))
        sides: list[tuple[Lit, Array]] = []
        place, start = [], 0
        for (d, _), (mu, w) in zip(self.sides, rules):
            cosines = np.concatenate([mu, d.cosines])
            sides.append((layer.light(cosines, d.below), np.concatenate([w, np.zeros(d.cosines.size)])))
            place.append(start + mu.size + np.arange(d.cosines.size))
            start += cosines.size
        return sides, np.concatenate(place)

    def ratio(self, fields: list[ComplexArray]) -> tuple[Ratio, Array]:
        """Fit the ratio from the far fields of all patches; return it and its relative standard errors, `[s, i]`."""
        model = self.model()
        truth = self.diffuse(fields)
        reach = max(float(np.hypot(*xy.T).max()) for xy in self.patches) * self.layer.surface.wavenumber
        found = fit_ratio(truth, model, self.ways, self.weights, self._phi, reach)
        errors = found.standard_errors(truth, model, self.ways, self._phi)
        edge = self._edge_error(found)
        return found, np.sqrt(errors**2 + edge[:, None] ** 2 + edge**2)

    def _edge_error(self, ratio: Ratio) -> Array:
        """Half of what is taken off at each angle above because a patch is finite, relative, `[angle]`."""
        sides, at = self._balanced_sides()
        count = self.sides[0][0].cosines.size
        sent = []
        for one in (ratio, dataclasses.replace(ratio, reach=0.0)):
            term = diffuse_term(dataclasses.replace(self.layer, ratio=one), sides, HARMONICS)
            sent.append((term.above + term.below)[:, at[:count]].sum(axis=0))
        return np.asarray(0.5 * np.abs(sent[0] / sent[1] - 1.0))

    def prepare(self) -> None:
        """Make the tables that all patches share."""
        _ = self.coupling, self._waves

    def forget(self) -> None:
        """Let the tables go, which are large and used no more."""
        self.__dict__.pop("coupling", None)
        self.__dict__.pop("_waves", None)

    @property
    def _phi(self) -> Array:
        return np.asarray(2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS)

    def diffuse(self, fields: list[ComplexArray]) -> Array:
        """The variance of the far fields about their mean, a particle, over n_s n_i; one sample a patch.

        `[patch, pol_s, s, pol_i, i, dphi]`, nm^2/sr. The mean is the coherent light of a patch, over all patches and
        azimuths of the light.
        """
        mean = sum(f.mean(axis=-1, keepdims=True) for f in fields) / len(fields)
        count = np.mean([len(xy) for xy in self.patches])
        samples = len(fields) * LIGHT_AZIMUTHS
        index = np.concatenate([np.full(d.cosines.size, d.index) for d, _ in self.sides])
        scale = samples / (samples - 1) / count / (index[:, None] * index)
        powers = np.stack([(np.abs(f - mean) ** 2).mean(axis=-1) for f in fields])
        return np.asarray(powers * scale[None, None, :, None, :, None], dtype=np.float64)


def distances(many: list[Array]) -> tuple[float, float]:
    """Return the least and the largest distance of two particles of one patch, nm."""
    found = [pdist(xy) for xy in many if len(xy) > 1]
    return float(min(d.min() for d in found)), float(max(d.max() for d in found))


def same_order(layer: Monolayer, order: int, *particles: Particle) -> Monolayer:
    """Return the mean-field model with multipoles up to `order` of one particle size, or of one a kind."""
    # few multipoles feel little of what a cut takes away, and both sides of a ratio feel the same
    kept = tuple(
        Particle(p.share, p.centre_nm, truncated(p.t_matrix, min(order, p.lmax)), p.cut, p.kind) for p in particles
    )
    return Monolayer(layer.surface, kept, layer.structure, "qca-balanced", min(layer.interaction_order, kept[0].lmax))


def middle_sizes(layer: Monolayer) -> tuple[Particle, ...]:
    """Return the middle particle size of each kind, with the share of the kind."""
    kinds = [[p for p in layer.particles if p.kind == kind] for kind in sorted({p.kind for p in layer.particles})]
    return tuple(
        dataclasses.replace(sizes[len(sizes) // 2], share=float(sum(p.share for p in sizes))) for sizes in kinds
    )


def mixed(patches: list[Array], shares: Array, seed: int) -> list[NDArray[np.intp]]:
    """Return which kind each particle of each patch is: at random, of all patches together just the shares.

    What the patches together had too much of a bright kind would be an error of the mean that no fit takes out.
    """
    counts = [len(xy) for xy in patches]
    drawn = dealt(sum(counts), shares, np.random.default_rng((seed, len(counts), 1)))
    return np.split(drawn, np.cumsum(counts)[:-1])


def dealt(count: int, shares: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return kinds in whole numbers nearest to the shares, in random order, `[particle]`."""
    edges = np.round(count * np.cumsum(shares) / np.sum(shares)).astype(np.intp)
    which = np.searchsorted(edges, np.arange(count), side="right")
    return np.asarray(rng.permutation(which) if len(edges) > 1 else which, dtype=np.intp)
