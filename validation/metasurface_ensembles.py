"""The ensemble inside a metasurface against multi-sphere solutions of another code, and against itself doubled.

The solutions (shared reference, systems B-F: silver and silicon, on glass and on oxide, coverage 0.1 and 0.2, packing
0.1 to 0.5) have multipoles to order 2 and 30 patterns. The error is a relative L2 error over the viewing angle.

The reference solves finite circular clusters of 130 to 151 spheres. Their edges radiate more near grazing than an
infinite layer does, by about 3.3 / sqrt(spheres) in C at 75 degrees, which is an error in neither code. Therefore they
are compared in two ways: with the infinite layer, and with clusters of the same number of spheres.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.special import j0
from scipy.stats import norm

from nacre.core.arrays import Array, ComplexArray
from nacre.core.machine import in_threads
from nacre.families.metasurface.ensemble import ANGLES, WIDEST, Ensemble, Side, middle_sizes, same_order
from nacre.families.metasurface.monolayer.arrangement import Arrangement, Pattern
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.qca import NAME as LADDER
from nacre.families.metasurface.monolayer.structure import Block, Pairs, Ratio, Sums, block_sums, hard_disk_structure
from nacre.families.metasurface.supercells import (
    Coupling,
    Period,
    PlaneWaves,
    Supercell,
    draw_species,
    supercells,
    with_species,
)
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions, hemisphere_rule
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter.mie import mie_coefficients
from validation._metasurface_helpers import plane_waves
from validation._rows import finish, row

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference" / "metasurface"
NAMES = "BCDEF"
BAR, MEAN_BAR, WITHIN_BAR, SIZE_BAR = 0.08, 0.06, 0.9, 0.03
PATTERNS = 48
SPECKLE, THEIR_DISCS = 0.04, 30  # what the bar allows for the solutions' own speckle, and how many discs they are of
SPHERES = 130.0  # of a disc, and of a cell of the endless pattern
DENSE, SIZES = (
    "C",
    (65, 130, 260),
)  # the system with the strongest edges, and discs of how many spheres give their strength
UP_TO = np.radians(60.0)  # beyond, a disc's edge sends out more than an endless layer has


def layer_of(data: Any) -> Monolayer:
    """Return the mean-field model of a reference system, spheres of order 2."""
    indices = np.array([1.0, *data["film_n"], complex(data["n_substrate"])], dtype=complex)
    surface = Substrate(float(data["wavelength_nm"]), indices, np.array(data["film_h_nm"], dtype=float))
    radius = float(data["radius_nm"])
    a, b = mie_coefficients(2, np.array([surface.wavenumber * radius]), np.array([complex(data["n_sphere"])]))
    structure = hard_disk_structure(
        float(data["density_per_nm2"]), float(data["packing_p"]), 4.5 * surface.wavenumber * max(1, surface.index_below)
    )
    return Monolayer(surface, (Particle(1.0, radius, np.concatenate([-b, -a])),), structure)


def pattern_correction(layer: Monolayer, spheres: int, realisations: int, seed: int = 0) -> tuple[Ratio, Array, Array]:
    """Return the ratio, its standard errors `[s, i]` and their angles."""
    density, packing = layer.structure.density_per_nm2, layer.structure.packing

    def pattern(count: int, seed: int) -> Pattern:
        return Arrangement("hard-disk", density, packing, seed).pattern(count)

    made = supercells(pattern, density, layer.structure.diameter_nm, spheres, realisations, seed)
    one = Ensemble(same_order(layer, 2, *middle_sizes(layer)), with_species(made, layer.shares, seed))
    one.prepare()
    ratio, errors = one.ratio(in_threads(one.solve, range(realisations)))
    return ratio, errors, one.angles_rad


def disc_radius(layer: Monolayer, spheres: float) -> float:
    """Return the radius of a disc of so many spheres on the mean, nm."""
    return float(np.sqrt(spheres / np.pi / layer.structure.density_per_nm2))


def disc_places(layer: Monolayer, discs: int, spheres: float = SPHERES) -> tuple[list[Array], list[Any]]:
    """Return discs cut out of hard-disc patterns, so many spheres each on the mean: places in nm and kinds of them."""
    density, packing = layer.structure.density_per_nm2, layer.structure.packing
    radius, rng = disc_radius(layer, spheres), np.random.default_rng(7)
    whole = round(1.85 * spheres)  # of a square that holds the disc, with a fifth to spare
    places = []
    for seed in range(discs):
        made = Arrangement("hard-disk", density, packing, 1000 + seed).pattern(whole)
        xy = (made.xy_nm + rng.uniform(0, made.box_nm, 2)) % made.box_nm - made.box_nm / 2
        places.append(xy[np.hypot(*xy.T) < radius])
    edges = np.cumsum([len(xy) for xy in places])
    return places, np.split(draw_species(int(edges[-1]), layer.shares, rng), edges[:-1])


def with_disc_structure(layer: Monolayer, spheres: float) -> Monolayer:
    """Return the model with the structure factor of discs of so many spheres in place of the endless pattern's.

    Of pairs a distance r apart a disc of diameter d holds the share (2/pi)(arccos(x) - x sqrt(1 - x^2)), x = r/d, the
    rest have one sphere outside: S(q) = 1 + rho int h(r) share(r) J0(qr) 2 pi r dr. Light of a dense order, which the
    pattern keeps near the normal, leaks there at a disc's edge.
    """
    structure = layer.structure
    diameter = 2 * disc_radius(layer, spheres)
    r = np.linspace(0.0, diameter, 4001)
    x = r / diameter
    outside = 1.0 - 2 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2))
    lost = 2 * np.pi * structure.density_per_nm2 * structure.pair_excess(r) * outside * r * r[1]
    s = structure.s - np.array([np.sum(lost * j0(q * r)) for q in structure.q_per_nm])
    return dataclasses.replace(layer, structure=dataclasses.replace(structure, s=s))


def correction_by_discs(
    layer: Monolayer, discs: int, in_each: float, views: int = 240, lights: int = 24
) -> tuple[Ratio, Array, Array]:
    """Return `pattern_correction`, fitted to discs of so many spheres in free surroundings, of light above alone.

    All discs are lit and seen from the same directions, so that their mean field is the coherent part, as the other
    code took it off.
    """
    layer = same_order(layer, 2, *middle_sizes(layer))
    places, kinds = disc_places(layer, discs, in_each)
    supercells = [Supercell(xy, Period(0.0, np.zeros(2)), n, which) for n, (xy, which) in enumerate(zip(places, kinds))]
    one = Ensemble(layer, supercells)
    first, *others = layer.particles
    reach = 2 * max(float(np.hypot(*xy.T).max()) for xy in places)
    coupling = Coupling.build(layer.surface, first, layer.structure.diameter_nm, reach, *others)
    rng, k = np.random.default_rng(3), layer.surface.wavenumber

    def side(theta: Array) -> Side:
        azimuth = rng.uniform(0, 2 * np.pi, theta.size)
        return one.side(k * np.sin(theta)[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1), False)

    view = side(np.arccos(np.sort(rng.uniform(np.cos(WIDEST), 1.0, views))[::-1]))
    light = side((np.arange(lights) + rng.random(lights)) * WIDEST / lights)

    def fields(n: int) -> tuple[ComplexArray, ComplexArray]:
        solved = coupling.solve(places[n], one.waves(light, False), kinds[n])
        f = coupling.far_field(places[n], solved, one.waves(view, True), kinds[n])
        leaving = np.exp(-1j * places[n] @ view.wavevectors.T)
        return f.reshape(2, views, 2, lights), leaving.T @ np.exp(1j * places[n] @ light.wavevectors.T)

    far, amounts = (np.stack(part) for part in zip(*in_threads(fields, range(discs))))
    spheres = float(np.mean([len(xy) for xy in places])) * (discs - 1) / discs
    powers = np.abs(far - far.mean(axis=0)) ** 2 / spheres
    own = np.abs(amounts - amounts.mean(axis=0)) ** 2 / spheres
    to, by = view.wavevectors, light.wavevectors
    s = layer.structure.structure_factor(np.hypot(*np.moveaxis(to[:, None] - by, -1, 0)))
    phi = np.arctan2(to[:, 1], to[:, 0])[:, None] - np.arctan2(by[:, 1], by[:, 0])
    angles = [np.arccos(each.directions.cosines) for each in (view, light)]
    bins = [np.minimum(angle / WIDEST * ANGLES, ANGLES - 1).astype(np.intp) for angle in angles]
    models = {(q, p): one.model.series(view, light, phi, q, p) for q, p in np.ndindex(2, 2)}
    found = []
    for power, structure in zip(powers, own):
        sums: dict[Block, Sums] = {}
        for (q, p), x in models.items():
            level = one.model.level(view, light, q, p)
            pairs = Pairs(
                view.ratio_directions,
                light.ratio_directions,
                phi,
                power[q, :, p],
                x * s,
                x * (structure - s),
                level,
                *bins,
            )
            block = (0, 0, min(q, p), max(q, p))
            part = block_sums(block, pairs if q <= p else pairs.exchanged(), ANGLES)
            sums[block] = sums[block] + part if block in sums else part
        found.append(sums)
    return (*one.ratio(found), one.angles_rad)


def of_discs(layer: Monolayer, theta_s: Array, theta_i: Array, discs: int = 24, spheres: float = SPHERES) -> Array:
    """Return what `light` does for discs of so many spheres in free surroundings, as the other code solved them."""
    return disc_light(layer, theta_s, theta_i, discs, spheres)[0]


def disc_light(layer: Monolayer, theta_s: Array, theta_i: Array, discs: int, spheres: float) -> tuple[Array, Array]:
    """Return what `of_discs` does, and the relative standard deviation of one disc lit from one azimuth."""
    each = disc_by_disc(layer, theta_s, theta_i, discs, spheres).reshape(-1, len(theta_s), len(theta_i), 2)
    return np.asarray(each.mean(axis=0)), np.asarray(each.std(axis=0) / each.mean(axis=0))


def disc_by_disc(layer: Monolayer, theta_s: Array, theta_i: Array, discs: int, spheres: float) -> Array:
    """Return what each disc sends out, lit from six azimuths, `[disc, azimuth, s, i, pol_i]`."""
    layer = same_order(layer, 2, *middle_sizes(layer))
    k = layer.surface.wavenumber
    places, kinds = disc_places(layer, discs, spheres)
    first, *others = layer.particles
    reach = 2 * max(float(np.hypot(*xy.T).max()) for xy in places)
    coupling = Coupling.build(layer.surface, first, layer.structure.diameter_nm, reach, *others)
    azimuths, few = 2 * np.pi * np.arange(24) / 24, 2 * np.pi * np.arange(6) / 6

    def waves(theta: Array, around: Array) -> PlaneWaves:
        seen, *more = (Directions.build(layer.surface, p.centre_nm, 2, 2, np.cos(theta)) for p in layer.particles)
        return plane_waves(seen, around, 2, k, *more)

    arriving, leaving = waves(theta_i, few), waves(theta_s, azimuths)

    def far_field(number: int) -> ComplexArray:
        xy, which = places[number], kinds[number]
        f = coupling.far_field(xy, coupling.solve(xy, arriving, which), leaving, which)
        f = f.reshape(2, len(theta_s), 24, 2, len(theta_i), 6)
        # the azimuth counts from the light's own
        return np.stack([np.roll(f[..., a], -4 * a, axis=2) for a in range(6)])

    fields = np.stack(in_threads(far_field, range(discs)))  # disc, azimuth, pol_s, s, phi, pol_i, i
    scatter = np.abs(fields - fields.mean(axis=(0, 1))) ** 2 * 6 * discs / (6 * discs - 1)
    scatter /= np.mean([len(xy) for xy in places])
    return np.moveaxis(scatter.mean(axis=4).sum(axis=2), 3, 4)


def light(layer: Monolayer, theta_s: Array, theta_i: Array, ratio: Ratio | None) -> Array:
    """Return the phi-mean diffuse light a particle, nm^2/sr, `[s, i, pol_i]`."""
    layer = dataclasses.replace(layer, ratio=ratio)
    mu, w = hemisphere_rule(24)
    cos = np.concatenate([mu, np.cos(theta_i), np.cos(theta_s)])
    sides = [(layer.illuminate(cos), np.concatenate([w, np.zeros(len(cos) - 24)]))]
    if layer.transmits_below:
        mu_b, w_b = hemisphere_rule(20, layer.surface.index_below)
        sides.append((layer.illuminate(mu_b, True), w_b))
    term = diffuse_term(layer, sides, 14)
    kappa, phi = np.sqrt(1 - cos**2), 2 * np.pi * np.arange(72) / 72
    s, i = 24 + len(theta_i) + np.arange(len(theta_s)), 24 + np.arange(len(theta_i))
    both = 2 * np.outer(kappa[s], kappa[i])[..., None] * np.cos(phi)
    q = np.sqrt(np.maximum(kappa[s][:, None, None] ** 2 + kappa[i][:, None] ** 2 - both, 0))
    shape = layer.structure.structure_factor(layer.surface.wavenumber * q)
    waves = np.cos(np.arange(14)[:, None] * phi) / layer.structure.density_per_nm2
    sent = np.einsum("siqpf,sif->sip", term.coherent[s][:, i] @ waves, shape) / 72
    if term.varying.size:
        sent = sent + (term.varying[s][:, i] @ waves).mean(axis=-1).sum(axis=2)
    return np.asarray(sent)


def distance(ours: Array, truth: Array, theta_s: Array) -> float:
    """The mean over incidences and polarisations of the relative L2 over scattering angles."""
    sine = np.sin(theta_s)[:, None, None]
    return float(np.mean(np.sqrt(np.sum(sine * (ours - truth) ** 2, 0) / np.sum(sine * truth**2, 0))))


def is_within(distances: list[float]) -> bool:
    """Whether each and their mean are within the bars."""
    return bool(max(distances) <= BAR and np.mean(distances) <= MEAN_BAR)


@dataclasses.dataclass(frozen=True)
class System:
    """One of the other code's systems: what it sends out a sphere, nm^2/sr, `[s, i, pol_i]`, and its layer."""

    layer: Monolayer
    theta_s: Array
    theta_i: Array
    truth: Array
    spheres: float  # of a disc, on the mean

    @classmethod
    def read(cls, name: str) -> System:
        """Read one."""
        data = np.load(REFERENCE / f"ensemble_{name}.npz")
        truth = data["incoherent_nm2_per_sr"].mean(axis=2).sum(axis=0)
        return cls(layer_of(data), data["theta_s_rad"], data["theta_i_rad"], truth, float(data["n_spheres_mean"]))

    def near(self, ours: Array, errors: Array, angles: Array) -> NDArray[np.bool_]:
        """Return where we are within two standard errors plus 4 %, `[s, i, pol_i]`.

        Args:
            ours: as `truth`.
            errors: relative standard errors at `angles` of view and light.
        """
        error = self.at_angles(errors, angles)
        return np.asarray(np.abs(ours - self.truth) <= 2 * error * ours + SPECKLE * self.truth)

    def at_angles(self, errors: Array, angles: Array) -> Array:
        """Return errors at the angles of the system, `[s, i, 1]`."""
        each = (np.clip(t, angles[0], angles[-1]) for t in (self.theta_s, self.theta_i))
        held = tuple(np.meshgrid(*each, indexing="ij"))
        return np.asarray(RegularGridInterpolator((angles, angles), errors)(held)[..., None])

    def like_for_like(self, patterns: int) -> tuple[float, float]:
        """Return the distance of the ensemble's way, for discs of as many spheres, and the share of angles near it.

        Its ratio is fitted to such discs and multiplies the mean field with a disc's structure factor.
        """
        patch = with_disc_structure(self.layer, self.spheres)
        ratio, errors, angles = correction_by_discs(patch, patterns, self.spheres)
        ours = light(patch, self.theta_s, self.theta_i, ratio)
        return distance(ours, self.truth, self.theta_s), float(np.mean(self.near(ours, errors, angles)))


def endless_limit(theirs: System, ratio: Ratio, error: float) -> tuple[list[float], float, float]:
    """Follow discs at grazing light to the endless layer: what a disc's edge adds goes as 1/sqrt(spheres).

    Args:
        theirs: the system; of its light the most grazing is taken, polarised s.
        ratio: of the endless layer.
        error: relative standard error of what that sends up.

    Returns:
        what discs of `SIZES` send up over what the endless layer does, less 1; where a straight line through them over
        1/sqrt(spheres) meets an endless one; its standard error.
    """
    graze, sine = theirs.theta_i[-1:], np.sin(theirs.theta_s)
    endless = float(sine @ light(theirs.layer, theirs.theta_s, graze, ratio)[:, 0, 0])
    means, errors = [], []
    for spheres in SIZES:
        sent = disc_by_disc(theirs.layer, theirs.theta_s, graze, THEIR_DISCS, spheres)[:, :, :, 0, 0] @ sine / endless
        means.append(float(sent.mean()))
        errors.append(float(sent.mean(axis=1).std(ddof=1) / np.sqrt(THEIR_DISCS)))
    line = np.stack([np.ones(len(SIZES)), 1 / np.sqrt(SIZES)], axis=1) / np.array(errors)[:, None]
    spread = np.linalg.inv(line.T @ line)
    start = spread @ line.T @ (np.array(means) / errors)
    return [mean - 1 for mean in means], float(start[0] - 1), float(np.hypot(np.sqrt(spread[0, 0]), error))


def main(out_dir: str | Path = ".") -> list[dict[str, Any]]:
    """Print the table, write the figure, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    if not REFERENCE.is_dir():
        return [row("the ensemble against truth", "each <= 8 %", "the reference is not here", False, "")]
    figure, axes = plt.subplots(1, len(NAMES), figsize=(16, 3.4), sharey=False)
    found, plain, discs, alike, ladder, counts = {}, {}, {}, {}, {}, {}
    shares: list[tuple[float, float, float]] = []  # of angles within the errors: endless, by discs, of an exact answer
    sizes: dict[str, tuple[float, float, Array]] = {}
    limit: tuple[list[float], float, float] = ([], 0.0, 0.0)
    for axis, name in zip(axes, NAMES, strict=True):
        theirs = System.read(name)
        layer, theta_s, theta_i, truth = theirs.layer, theirs.theta_s, theirs.theta_i, theirs.truth
        counts[name] = theirs.spheres
        ratio, errors, angles = pattern_correction(layer, round(SPHERES), PATTERNS)
        ours, mean_field = light(layer, theta_s, theta_i, ratio), light(layer, theta_s, theta_i, None)
        few = theta_i < UP_TO
        found[name] = [distance(ours[:, which], truth[:, which], theta_s) for which in (few, few | True)]
        ladder_power = light(dataclasses.replace(layer, correction=LADDER), theta_s, theta_i, None)
        ladder[name] = distance(ladder_power, truth, theta_s)
        plain[name] = [distance(mean_field[:, which], truth[:, which], theta_s) for which in (few, few | True)]
        raw, spread = disc_light(layer, theta_s, theta_i, 24, theirs.spheres)
        discs[name] = distance(raw, truth, theta_s)
        alike[name], disc_near = theirs.like_for_like(PATTERNS)
        near = theirs.near(ours, errors, angles)[theta_s < UP_TO][:, few]
        allowed = SPECKLE + 2 * theirs.at_angles(errors, angles)
        chance = 2 * norm.cdf(allowed / (spread / np.sqrt(THEIR_DISCS))) - 1
        shares.append((np.mean(near), disc_near, np.mean(chance[theta_s < UP_TO][:, few])))
        if name == DENSE:
            limit = endless_limit(theirs, ratio, float(np.mean(theirs.at_angles(errors, angles)[:, -1])))
        if name in "BF":
            # as many spheres in all
            large, _, _ = pattern_correction(layer, 260, PATTERNS // 2)
            change = light(layer, theta_s, theta_i, large) / ours - 1
            sine = np.sin(theta_s)[:, None, None]
            large_sum, ours_sum = np.sum(sine * (1 + change) * ours, 0), np.sum(sine * ours, 0)
            sizes[name] = float(np.abs(change).max()), float(np.sqrt(np.mean(change**2))), large_sum / ours_sum - 1
        for i, colour in enumerate(("C0", "C1", "C2", "C3")):
            axis.plot(np.degrees(theta_s), truth[:, i].mean(-1), ".", color=colour)
            axis.plot(np.degrees(theta_s), ours[:, i].mean(-1), "-", color=colour)
            axis.plot(np.degrees(theta_s), mean_field[:, i].mean(-1), ":", color=colour)
        axis.set(title=f"{name}: {100 * found[name][0]:.1f} %", xlabel="view / degrees")
    axes[0].set_ylabel("diffuse / nm$^2$/sr")
    figure.tight_layout()
    path = finish(figure, out_dir, "metasurface_ensembles.png", dpi=110)
    per, whole = (", ".join(f"{n} {100 * v[k]:.1f}" for n, v in found.items()) for k in (0, 1))
    by_mean, mean_whole = (", ".join(f"{n} {100 * v[k]:.1f}" for n, v in plain.items()) for k in (0, 1))
    by_ladder = ", ".join(f"{n} {100 * v:.1f}" for n, v in ladder.items())
    raw_discs, fitted = (", ".join(f"{n} {100 * v:.1f}" for n, v in each.items()) for each in (discs, alike))
    in_each = ", ".join(f"{n} {v:.0f}" for n, v in counts.items())
    discs_of, more = ", ".join(map(str, SIZES)), ", ".join(f"{100 * part:+.0f}" for part in limit[0])
    endless_share, disc_share, exact_share = (100 * float(np.mean(part)) for part in zip(*shares))
    grown = ", ".join(
        f"{n} {100 * most:.1f} %, rms {100 * rms:.1f} %, hemispherical totals at most {100 * np.abs(t).max():.1f} %"
        for n, (most, rms, t) in sizes.items()
    )
    return [
        row("ensemble, order 2, against multi-sphere solutions, light to 55 degrees", "each <= 8 %, mean <= 6 %",
            f"{per} %; the mean field {by_mean} %",
            is_within([v[0] for v in found.values()]), path)
        | {"code": "a multi-sphere solver"},
        row("the same with light at 75 degrees, where those discs' edges send out up to a fifth more",
            "each <= 8 %, mean <= 6 %", f"{whole} %; the mean field {mean_whole} %",
            is_within([v[1] for v in found.values()]), path),
        row(f"what discs of {discs_of} spheres send up at 75 degrees, s, over the endless layer ({DENSE}); "
            "a straight line over 1/sqrt(spheres), on to one without an edge", "within two standard errors of none",
            f"{more} %; on to {100 * limit[1]:+.1f} +- {100 * limit[2]:.1f} %",
            bool(abs(limit[1]) <= 2 * limit[2]), path),
        row("the mean field with the light that neighbours pass on, all angles", "each <= 8 %, mean <= 6 %",
            f"{by_ladder} %", is_within(list(ladder.values())), path) | {"code": "a multi-sphere solver"},
        row(f"discs of as many spheres as theirs ({in_each}), by the same equations, all angles",
            "each <= 8 %, mean <= 6 %", f"{raw_discs} %; mean {100 * np.mean(list(discs.values())):.1f} %",
            is_within(list(discs.values())), path)
        | {"code": "a multi-sphere solver"},
        row("like for like: the ratio fitted to such discs, times the mean field with a disc's S, all angles",
            "each <= 8 %, mean <= 6 %", f"{fitted} %; mean {100 * np.mean(list(alike.values())):.1f} %",
            is_within(list(alike.values())), path)
        | {"code": "a multi-sphere solver"},
        row("like for like: within two own standard errors plus 4 %, all angles", ">= 90 % of angles",
            f"{disc_share:.1f} %", bool(disc_share >= 100 * WITHIN_BAR), path),
        row("within two own standard errors plus 4 %, light and view to 55 degrees", ">= 90 % of angles",
            f"{endless_share:.1f} %; an exact answer of such errors would be in {exact_share:.1f} %, for at many "
            "angles the speckle of 30 discs is more than 4 %", bool(endless_share >= 100 * WITHIN_BAR), path),
        row("130 to 260 spheres moves no angle's value", "by more than 3 %", f"largest change: {grown}",
            max(most for most, _, _ in sizes.values()) <= SIZE_BAR, path),
    ]  # fmt: skip


if __name__ == "__main__":
    main()
