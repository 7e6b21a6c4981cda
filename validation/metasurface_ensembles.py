"""The ensemble inside a metasurface against multi-sphere solutions of another code, and against itself doubled.

The solutions (shared reference, systems B-F: silver and silicon, on glass and on oxide, coverage .1 and .2, packing .1
to .5) have spheres of order 2, about 130 of them, 30 patterns. The distance is that of the physics note, section 10.9.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import j0
from scipy.stats import norm

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.arrangement import Arrangement
from nacre.families.metasurface.cells import Cell, cells, dealt, with_kinds
from nacre.families.metasurface.cluster import Coupling, Period, PlaneWaves
from nacre.families.metasurface.corrections import diffuse_term
from nacre.families.metasurface.ensemble import ANGLES, WIDEST, Ensemble, Side, middle_sizes, same_order
from nacre.families.metasurface.ladder import NAME as LADDER
from nacre.families.metasurface.monolayer import Monolayer, Particle
from nacre.families.metasurface.patterns import Pattern
from nacre.families.metasurface.ratio import Block, Ratio
from nacre.families.metasurface.ratio_fit import Pairs, Sums, block_sums
from nacre.families.metasurface.sphere import Directions, hemisphere_rule
from nacre.families.metasurface.structure import hard_disk_structure
from nacre.families.metasurface.substrate import Substrate
from nacre.matter.jobs import in_threads
from nacre.matter.mie import mie_coefficients
from validation._rows import finish, row

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "reference" / "metasurface"
NAMES = "BCDEF"
BAR, MEAN_BAR, WITHIN_BAR, SIZE_BAR = 0.08, 0.06, 0.9, 0.03
PATTERNS = 48
SPECKLE, THEIR_DISCS = 0.04, 30  # what the bar allows for the solutions' own speckle, and how many discs they are of
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


def judged(layer: Monolayer, spheres: int, realisations: int, seed: int = 0) -> tuple[Ratio, Array, Array]:
    """Return the ratio, its standard errors `[s, i]` and their angles."""
    density, packing = layer.structure.density_per_nm2, layer.structure.packing

    def pattern(count: int, seed: int) -> Pattern:
        return Arrangement("hard-disk", density, packing, seed).pattern(count)

    made = cells(pattern, density, layer.structure.diameter_nm, spheres, realisations, seed)
    one = Ensemble(same_order(layer, 2, *middle_sizes(layer)), with_kinds(made, layer.shares, seed))
    one.prepare()
    ratio, errors = one.ratio(in_threads(one.solve, range(realisations)))
    return ratio, errors, one.angles_rad


def disc_places(layer: Monolayer, discs: int) -> tuple[list[Array], list[Any]]:
    """Return discs cut out of hard-disc patterns, some 130 spheres each: places in nm and kinds of spheres."""
    density, packing = layer.structure.density_per_nm2, layer.structure.packing
    radius, rng = float(np.sqrt(130 / np.pi / density)), np.random.default_rng(7)
    places = []
    for seed in range(discs):
        made = Arrangement("hard-disk", density, packing, 1000 + seed).pattern(240)
        xy = (made.xy_nm + rng.uniform(0, made.box_nm, 2)) % made.box_nm - made.box_nm / 2
        places.append(xy[np.hypot(*xy.T) < radius])
    edges = np.cumsum([len(xy) for xy in places])
    return places, np.split(dealt(int(edges[-1]), layer.shares, rng), edges[:-1])


def with_disc_structure(layer: Monolayer) -> Monolayer:
    """Return the model with the structure factor of discs of 130 spheres in place of the endless pattern's.

    Of pairs a distance r apart a disc of diameter d holds the share (2/pi)(arccos(x) - x sqrt(1 - x^2)), x = r/d, the
    rest have one sphere outside: S(q) = 1 + rho int h(r) share(r) J0(qr) 2 pi r dr. Light of a dense order, which the
    pattern keeps near the normal, leaks there at a disc's edge.
    """
    structure = layer.structure
    diameter = 2 * float(np.sqrt(130 / np.pi / structure.density_per_nm2))
    r = np.linspace(0.0, diameter, 4001)
    x = r / diameter
    outside = 1.0 - 2 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2))
    lost = 2 * np.pi * structure.density_per_nm2 * structure.pair_excess(r) * outside * r * r[1]
    s = structure.s - np.array([np.sum(lost * j0(q * r)) for q in structure.q_per_nm])
    return dataclasses.replace(layer, structure=dataclasses.replace(structure, s=s))


def judged_by_discs(layer: Monolayer, discs: int, views: int = 240, lights: int = 24) -> tuple[Ratio, Array, Array]:
    """Return what `judged` does, fitted to discs of 130 spheres in free surroundings, of light above alone.

    All discs are lit and seen from the same directions, so that their mean field is the coherent part, as the other
    code took it off.
    """
    layer = same_order(layer, 2, *middle_sizes(layer))
    places, kinds = disc_places(layer, discs)
    cells = [Cell(xy, Period(0.0, np.zeros(2)), n, which) for n, (xy, which) in enumerate(zip(places, kinds))]
    one = Ensemble(layer, cells)
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
            pairs = Pairs(view.ways, light.ways, phi, power[q, :, p], x * s, x * (structure - s), level, *bins)
            block = (0, 0, min(q, p), max(q, p))
            part = block_sums(block, pairs if q <= p else pairs.exchanged(), ANGLES)
            sums[block] = sums[block] + part if block in sums else part
        found.append(sums)
    return (*one.ratio(found), one.angles_rad)


def of_discs(layer: Monolayer, theta_s: Array, theta_i: Array, discs: int = 24) -> Array:
    """Return what `light` does for discs of 130 spheres in free surroundings, as the other code solved them."""
    return disc_light(layer, theta_s, theta_i, discs)[0]


def disc_light(layer: Monolayer, theta_s: Array, theta_i: Array, discs: int) -> tuple[Array, Array]:
    """Return what `of_discs` does, and the relative standard deviation of one disc lit from one azimuth."""
    layer = same_order(layer, 2, *middle_sizes(layer))
    k = layer.surface.wavenumber
    places, kinds = disc_places(layer, discs)
    first, *others = layer.particles
    reach = 2 * max(float(np.hypot(*xy.T).max()) for xy in places)
    coupling = Coupling.build(layer.surface, first, layer.structure.diameter_nm, reach, *others)
    azimuths, few = 2 * np.pi * np.arange(24) / 24, 2 * np.pi * np.arange(6) / 6

    def waves(theta: Array, around: Array) -> PlaneWaves:
        seen, *more = (Directions.build(layer.surface, p.centre_nm, 2, 2, np.cos(theta)) for p in layer.particles)
        return PlaneWaves.build(seen, around, 2, k, *more)

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
    each = np.moveaxis(scatter.mean(axis=4).sum(axis=2), 3, 4).reshape(6 * discs, len(theta_s), len(theta_i), 2)
    return np.asarray(each.mean(axis=0)), np.asarray(each.std(axis=0) / each.mean(axis=0))


def light(layer: Monolayer, theta_s: Array, theta_i: Array, ratio: Ratio | None) -> Array:
    """Return the phi-mean diffuse light a particle, nm^2/sr, `[s, i, pol_i]`."""
    layer = dataclasses.replace(layer, ratio=ratio)
    mu, w = hemisphere_rule(24)
    cos = np.concatenate([mu, np.cos(theta_i), np.cos(theta_s)])
    sides = [(layer.light(cos), np.concatenate([w, np.zeros(len(cos) - 24)]))]
    if layer.has_below:
        mu_b, w_b = hemisphere_rule(20, layer.surface.index_below)
        sides.append((layer.light(mu_b, True), w_b))
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


def main(out_dir: str | Path = ".") -> list[dict[str, Any]]:
    """Print the table, write the figure, return the rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from scipy.interpolate import RegularGridInterpolator

    if not REFERENCE.is_dir():
        return [row("the ensemble against truth", "each <= 8 %", "the reference is not here", False, "")]
    figure, axes = plt.subplots(1, len(NAMES), figsize=(16, 3.4), sharey=False)
    found, plain, discs, alike, ladder = {}, {}, {}, {}, {}
    shares: list[tuple[float, float, float]] = []  # of angles within the errors: endless, by discs, of an exact answer
    sizes: dict[str, tuple[float, float, Array]] = {}
    for axis, name in zip(axes, NAMES, strict=True):
        data = np.load(REFERENCE / f"ensemble_{name}.npz")
        layer, theta_s, theta_i = layer_of(data), data["theta_s_rad"], data["theta_i_rad"]
        truth = data["incoherent_nm2_per_sr"].mean(axis=2).sum(axis=0)
        ratio, errors, angles = judged(layer, 130, PATTERNS)
        ours, mean_field = light(layer, theta_s, theta_i, ratio), light(layer, theta_s, theta_i, None)
        few = theta_i < UP_TO
        found[name] = [distance(ours[:, which], truth[:, which], theta_s) for which in (few, few | True)]
        passed_on = light(dataclasses.replace(layer, correction=LADDER), theta_s, theta_i, None)
        ladder[name] = distance(passed_on, truth, theta_s)
        plain[name] = [distance(mean_field[:, which], truth[:, which], theta_s) for which in (few, few | True)]
        raw, spread = disc_light(layer, theta_s, theta_i, 24)
        discs[name] = distance(raw, truth, theta_s)
        patch = with_disc_structure(layer)
        by_discs, disc_errors, _ = judged_by_discs(patch, PATTERNS)
        like = light(patch, theta_s, theta_i, by_discs)
        alike[name] = distance(like, truth, theta_s)
        held = tuple(np.meshgrid(*(np.clip(t, angles[0], angles[-1]) for t in (theta_s, theta_i)), indexing="ij"))
        error, disc_error = (
            RegularGridInterpolator((angles, angles), each)(held)[..., None] for each in (errors, disc_errors)
        )
        near = (np.abs(ours - truth) <= 2 * error * ours + SPECKLE * truth)[theta_s < UP_TO][:, few]
        disc_near = np.abs(like - truth) <= 2 * disc_error * like + SPECKLE * truth
        chance = 2 * norm.cdf((SPECKLE + 2 * error) / (spread / np.sqrt(THEIR_DISCS))) - 1
        shares.append((np.mean(near), np.mean(disc_near), np.mean(chance[theta_s < UP_TO][:, few])))
        if name in "BF":
            # as many spheres in all
            large, _, _ = judged(layer, 260, PATTERNS // 2)
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
        row("the mean field with the light that neighbours pass on, all angles", "each <= 8 %, mean <= 6 %",
            f"{by_ladder} %", is_within(list(ladder.values())), path) | {"code": "a multi-sphere solver"},
        row("discs of 130 spheres like theirs, by the same equations, all angles", "each <= 8 %, mean <= 6 %",
            f"{raw_discs} %; mean {100 * np.mean(list(discs.values())):.1f} %", is_within(list(discs.values())), path)
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
