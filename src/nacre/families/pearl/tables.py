"""Noise-free tables of a pearl (`quality = "fast"`): a layered lobe, solved by random walks, as a `PlateletLayer`.

Diffuse light from the base is solved exactly: with A(cos) the light share at the base and r the
diffuse share returned to it by platelets and interface, the base adds
A(cos_i) A(cos_o) albedo / (pi n^2 (1 - albedo r)), n the index. The platelets' own light over their analytic lobe is a
smooth function; its table is a least-squares fit to random-walk tallies, which spreads noise over whole cells.

The stated error comes from independent walks at three incidences, in bins independent from the table's nodes; the
product between two independent differences has a noise-free mean.
"""

import dataclasses
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from nacre.bsdf.facet_distributions import exits as facet_exits
from nacre.bsdf.facet_distributions import fresnel, smith_masking, visible_normals
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.lobes.platelet_layer import PlateletLayer, surface_values
from nacre.core.arrays import Array, cell, interpolate, take_uniform
from nacre.core.machine import in_threads
from nacre.families.pearl import random_walk
from nacre.families.pearl.flake_texture import interface_bend

SHAPE = (32, 20, 6)  # nodes of q, c, phi
ENTRY_NODES = 129
BASE_NODES = 25
WALKS, BASE_WALKS, SINGLES, PRODUCTS = 1_000_000, 400_000, 4_000_000, 4_000_000  # walks and lattice points
SHARE_NODES = 17
FULL_EFFORT_NUMBER = 24.0  # platelets met along the normal up to which the full numbers of walks are made
NOISE_SHARE = 0.6  # added to the stated error from the check's noise: two standard errors of its square
NO_ALBEDO = np.zeros(0)
CHECK_BINS = np.array([20, 6])  # size and azimuth of q
MIDPOINTS = np.array([12, 6])  # within a bin
CHECK_DEG = (10.0, 40.0, 65.0)
CHECK_WALKS, CHECK_SINGLES = 300_000, 1_000_000
POWER_DEG, POWER_WALKS = (0.0, 30.0, 55.0, 75.0, 85.0), 120_000  # incidences of the reflectance's check
ERROR_MARGIN = 2.0  # factor on the reflectance error
TABLE_ROUGHNESS = 0.1  # expected relative second difference between nodes


def bake(lobe: Layered, effort: float = 1.0, seed: int = 1) -> PlateletLayer:
    """Return a layered lobe's noise-free form with its stated error.

    Args:
        lobe: isotropic platelets in one stratum over a diffuse base; see `Pearl.inapplicable_reason`.
        effort: factor on all walk numbers.
        seed: for the walks.
    """
    effort = _limited(lobe, effort)
    table = tables(lobe, effort, seed)
    error, noise = check(lobe, table, effort, seed + 77)
    return dataclasses.replace(table, error=np.sqrt(error**2 + (NOISE_SHARE * noise) ** 2))


def largest_power_error(lobe: Layered, table: PlateletLayer, effort: float = 1.0, seed: int = 177) -> float:
    """Return the largest reflectance error found at a few incidences, absolute, with a margin."""
    differences, noise = power_difference(lobe, table, np.radians(POWER_DEG), _limited(lobe, effort), seed)
    return min(ERROR_MARGIN * float(np.max(np.maximum(np.abs(differences), noise))), 1.0)


def _limited(lobe: Layered, effort: float) -> float:
    """Return `effort`, reduced for many flakes: their walks cost more, and their table is smoother."""
    return effort * min(1.0, FULL_EFFORT_NUMBER / max(float(np.sum(lobe.flake_number)), 1e-9))


def power_difference(
    lobe: Layered, table: PlateletLayer, theta_rad: Array, effort: float = 1.0, seed: int = 177
) -> tuple[Array, Array]:
    """Return the reflectance of independent walks less that of a table, and its noise, each `[angle, wavelength]`.

    Args:
        lobe, table: the same pearl.
        theta_rad: `[angle]`, incidences.
        effort: factor on the walks.
        seed: random-walk seed.
    """
    spread = _spread(random_walk.Medium.of(lobe))
    parts = _independent_walks(lobe, theta_rad, (POWER_WALKS, POWER_WALKS), effort, seed).sum(axis=2)
    tabulated = np.stack([_bins(table, float(theta), spread)[0].sum(axis=0) for theta in theta_rad])
    return parts.mean(axis=1) - tabulated, parts.std(axis=1, ddof=1) / np.sqrt(random_walk.CHUNKS)


def tables(lobe: Layered, effort: float = 1.0, seed: int = 1) -> PlateletLayer:
    """Make the tables without a check; their error is 0."""
    medium = random_walk.Medium.of(lobe)
    entry, surface = _interface(medium)
    spread = _spread(medium)
    arrived, returned, flakes, single = _solve(medium, entry, spread, effort, seed)
    albedo = lobe.base_reflectance[0]
    base = arrived / medium.n * np.sqrt(albedo / (np.pi * (1.0 - albedo * returned)))
    made = PlateletLayer(
        lobe.wavelengths_nm, medium.n, medium.alpha, medium.number, medium.sigma, spread, entry,
        flakes.astype(np.float32), base, np.zeros((2, 3)), np.zeros(len(lobe.wavelengths_nm)),
    )  # fmt: skip
    if lobe.glint_numbers is not None:
        made = dataclasses.replace(
            made, single=np.minimum(single, flakes).astype(np.float32), glint_numbers=lobe.glint_numbers,
            glint_radii=lobe.glint_radii, glint_ratio=lobe.glint_ratio,
        )  # fmt: skip
    return dataclasses.replace(made, albedo=_powers(made, surface))


def _powers(table: PlateletLayer, surface: Array) -> Array:
    """Return interface, flake and base powers, averaged over wavelengths, `[cos, 3]` on sqrt(cos) nodes."""
    root = np.linspace(0.0, 1.0, SHARE_NODES)
    cos = np.maximum(root**2, 1e-3)
    fine = (np.arange(400) + 0.5) / 400
    leaves = _entering(table, fine)[:, None] * take_uniform(table.base, fine, 0)
    arrives = _entering(table, cos)[:, None] * take_uniform(table.base, cos, 0)
    base = arrives * (2.0 * np.pi * np.mean(leaves * fine[:, None], axis=0))
    rest = np.stack([_bins(table, float(np.arccos(c)), table.spread)[0].sum(axis=0) for c in cos])
    facets = np.interp(root, np.linspace(0.0, 1.0, ENTRY_NODES), surface)
    return np.stack([facets, np.maximum(rest - base, 0.0).mean(axis=1), base.mean(axis=1)], axis=1)


def _entering(table: PlateletLayer, cos: Array) -> Array:
    return np.interp(np.sqrt(cos), np.linspace(0.0, 1.0, len(table.entry)), table.entry)


def _spread(medium: random_walk.Medium) -> float:
    if not len(medium.number):
        return 1.0
    return float(2.0 * medium.n * np.hypot(medium.sigma.min(), interface_bend(medium.alpha, medium.n)))


def _interface(medium: random_walk.Medium) -> tuple[Array, Array]:
    """Return the interface transmittance and reflectance on uniform sqrt(cos) nodes."""
    cos = np.maximum(np.linspace(0.0, 1.0, ENTRY_NODES) ** 2, 1e-7)
    if medium.alpha == 0:
        smooth = fresnel(cos, medium.n)
        return 1.0 - smooth, smooth
    entry, surface = np.zeros(ENTRY_NODES), np.zeros(ENTRY_NODES)
    for i, c in enumerate(cos):
        w = np.array([np.sqrt(1.0 - c * c), 0.0, c])
        m, weight = visible_normals("ggx", w, medium.alpha, medium.alpha, 64)
        weight = weight / weight.sum()
        smooth = fresnel(np.clip(m @ w, 1e-9, 1.0), medium.n)
        back, through = facet_exits(w, m, medium.n)
        up = np.where(back[:, 2] > 0, smith_masking("ggx", back, medium.alpha, medium.alpha), 0.0)
        down = np.where(through[:, 2] < 0, smith_masking("ggx", through, medium.alpha, medium.alpha), 0.0)
        entry[i], surface[i] = np.sum(weight * (1 - smooth) * down), np.sum(weight * smooth * up)
    return entry, surface


def _solve(
    medium: random_walk.Medium, entry: Array, spread: float, effort: float, seed: int
) -> tuple[Array, Array, Array, Array]:
    """Run the walks and fit: A/t `[cos, wavelength]`, r `[wavelength]`, M, and its single-scattering part."""
    bands = medium.reflect.shape[2]
    shape = np.array(SHAPE)
    cells = int(np.prod(SHAPE))
    has_platelets = bool(len(medium.number))
    shift = np.random.default_rng(seed).random(7)
    walks, base_walks = (max(1, int(effort * n / random_walk.CHUNKS)) for n in (WALKS, BASE_WALKS))
    singles, products = (max(1, int(effort * n / random_walk.CHUNKS)) for n in (SINGLES, PRODUCTS))
    unseen = np.zeros((0, bands))

    def chunk(i: int) -> tuple[Any, ...]:
        tally = random_walk.Tally(spread, shape, np.zeros((cells, bands)), np.zeros((BASE_NODES, bands)))
        back = random_walk.no_tally(bands)
        one, hats = np.zeros((cells, bands)), np.zeros((cells, 27))
        number = random_walk.walk(
            seed * 1000 + i, walks, random_walk.ANY_ANGLE, medium, NO_ALBEDO, tally, random_walk.NO_VIEWERS, unseen
        )
        random_walk.walk(
            seed * 1000 + 500 + i,
            base_walks,
            random_walk.FROM_BASE,
            medium,
            NO_ALBEDO,
            back,
            random_walk.NO_VIEWERS,
            unseen,
        )
        if has_platelets:
            if medium.alpha > 0:
                random_walk.tally_single_scattering(
                    i * singles, singles, shift, random_walk.ANY_ANGLE, medium, spread, shape, one
                )
            random_walk.hat_products(i * products, products, shift, medium, spread, entry, shape, hats)
        return (
            tally.table / walks,
            tally.base / walks,
            back.base[0] / base_walks,
            one / singles,
            hats / products,
            number,
        )

    parts = in_threads(chunk, range(random_walk.CHUNKS))
    many, base, back, one, hats, number = (sum(part[i] for part in parts) / random_walk.CHUNKS for i in range(6))
    arrived = _fit_base(base, entry)
    table, single = np.zeros((2, *SHAPE, bands))
    if has_platelets:
        stiffness = float(hats.sum()) / (random_walk.CHUNKS * TABLE_ROUGHNESS**2)
        table = _fit(hats, many, stiffness / max(number, 1.0))
        if medium.alpha == 0:
            single = _single(medium, spread)
        else:
            single = np.maximum(_fit(hats, one, stiffness / singles), 0.0)
    return arrived, back, np.maximum(table + single, 0.0), single


def check(lobe: Layered, table: PlateletLayer, effort: float = 1.0, seed: int = 77) -> tuple[Array, Array]:
    """Compare with independent random walks.

    Returns:
        `(error, noise)`, each `[wavelength]`: relative L2 difference in f cos over all exits at three incidences,
        averaged over bins, without the walks' noise; and that noise.
    """
    spread, count, theta_rad = _spread(random_walk.Medium.of(lobe)), len(lobe.wavelengths_nm), np.radians(CHECK_DEG)
    walked = _independent_walks(lobe, theta_rad, (CHECK_WALKS, CHECK_SINGLES), effort, seed)
    error, noise, size = np.zeros(count), np.zeros(count), np.zeros(count)
    for theta, reference in zip(theta_rad, walked, strict=True):
        tabulated, surface, solid = _bins(table, float(theta), spread)
        weight = np.where(solid > 0, 1.0 / np.maximum(solid, 1e-12), 0.0)[:, None]
        difference = reference - tabulated
        total = difference.sum(axis=0)
        squares = np.sum(difference**2, axis=0)
        # mean product between differences from two chunks
        error += np.sum(weight * (total**2 - squares), axis=0) / (random_walk.CHUNKS * (random_walk.CHUNKS - 1))
        noise += np.sum(weight * reference.var(axis=0, ddof=1), axis=0) / random_walk.CHUNKS
        size += np.sum(weight * (tabulated + surface[:, None]) ** 2, axis=0)
    size = np.maximum(size, 1e-30)
    return np.sqrt(np.maximum(error, 0.0) / size), np.sqrt(noise / size)


def _independent_walks(lobe: Layered, theta_rad: Array, numbers: tuple[int, int], effort: float, seed: int) -> Array:
    """Return f cos from random walks, integrated over exit bins, `[angle, chunk, bin, wavelength]`.

    Args:
        numbers: walks, and samples of single scattering, in all chunks of an incidence.
        effort: factor on both numbers.
    """
    medium = random_walk.Medium.of(lobe)
    spread, count = _spread(medium), len(lobe.wavelengths_nm)
    shifts = np.random.default_rng(seed).random((len(theta_rad), random_walk.CHUNKS, 7))
    albedo = np.ascontiguousarray(lobe.base_reflectance[0])
    walks, singles = (max(1, int(n * effort / random_walk.CHUNKS)) for n in numbers)

    def chunk(job: tuple[int, int]) -> Array:
        turn, i = job
        theta = float(theta_rad[turn])
        light = np.array([np.sin(theta), 0.0, np.cos(theta)])
        many, one = np.zeros((2, int(np.prod(CHECK_BINS)), count))
        tally = random_walk.Tally(spread, CHECK_BINS, many, np.zeros((1, count)))
        random_walk.walk(
            seed * 1000 + 8 * turn + i,
            walks,
            light,
            medium,
            albedo,
            tally,
            random_walk.NO_VIEWERS,
            np.zeros((0, count)),
        )
        if len(medium.number):
            random_walk.tally_single_scattering(0, singles, shifts[turn, i], light, medium, spread, CHECK_BINS, one)
        return np.asarray(many / walks + one / singles)

    jobs = [(turn, i) for turn in range(len(theta_rad)) for i in range(random_walk.CHUNKS)]
    return np.array(in_threads(chunk, jobs)).reshape(len(theta_rad), random_walk.CHUNKS, -1, count)


def _bins(table: PlateletLayer, theta: float, spread: float) -> tuple[Array, Array, Array]:
    """Integrate the table over the check's bins with the midpoint rule.

    Returns the power from flakes and base, the power reflected at the surface, and the solid angle, for each bin. An
    area in the plane of q is a solid angle times its cosine.
    """
    rings, turns = CHECK_BINS * MIDPOINTS
    scale = np.arcsinh(2.0 / spread)
    edges = spread * np.sinh(np.linspace(0.0, 1.0, rings + 1) * scale)
    middle = spread * np.sinh((np.arange(rings) + 0.5) / rings * scale)
    psi = (np.arange(turns) + 0.5) * (np.pi / turns)
    x, y = middle[:, None] * np.cos(psi) - np.sin(theta), middle[:, None] * np.sin(psi)
    area = np.broadcast_to((np.diff(edges**2) * (np.pi / turns))[:, None], x.shape)
    cos = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
    keep = cos > 1e-3
    wo = np.stack([x, y, cos], axis=-1)[keep]
    wi = np.broadcast_to([np.sin(theta), 0.0, np.cos(theta)], wo.shape)
    surface = surface_values(wi, wo, table.index, table.alpha)
    value = table.evaluate(wi, wo) - surface[:, None]
    ring, turn = np.nonzero(keep)
    bins = ring // MIDPOINTS[0] * CHECK_BINS[1] + turn // MIDPOINTS[1]
    total = int(np.prod(CHECK_BINS))
    gather = sparse.csr_matrix((area[keep], (bins, np.arange(len(bins)))), shape=(total, len(bins)))
    return gather @ value, gather @ surface, gather @ (1.0 / cos[keep])


def _single(medium: random_walk.Medium, spread: float) -> Array:
    """Return single scattering under a smooth interface, over K, in closed form at the nodes."""
    u, v, w = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in SHAPE), indexing="ij")
    q = spread * np.sinh(u * np.arcsinh(2.0 / spread))
    sine, cosine = np.sin(0.5 * np.pi * w), np.cos(0.5 * np.pi * w)
    c = np.sin(0.5 * np.pi * v) * (np.sqrt(np.maximum(1.0 - (0.5 * q * sine) ** 2, 0.0)) - 0.5 * q * cosine)
    n = medium.n
    # sines of both directions from q along x and c at phi
    sin2 = [(0.5 * q + sign * c * cosine) ** 2 + (c * sine) ** 2 for sign in (1, -1)]
    inner = [np.sqrt(1.0 - np.minimum(s, 1.0) / n**2) for s in sin2]
    tall = n * (inner[0] + inner[1])
    slope2 = (q / tall) ** 2
    # the platelet is met along the half vector: cos = (1 + wi.wo) / |wi + wo|
    facing = np.sqrt(np.clip(0.5 * (1.0 + (0.25 * q**2 - c**2) / n**2 + inner[0] * inner[1]), 0.0, 1.0))
    bands = medium.reflect.shape[2]
    depth: Array = np.zeros((*SHAPE, bands))
    for cos in inner:
        if len(medium.absorb):
            depth += medium.absorb / cos[..., None]
        for k, sigma in enumerate(medium.sigma):
            area = medium.number[k] * np.sqrt(sigma**2 * (1.0 - cos**2) + cos**2)
            depth += (area / cos)[..., None] * interpolate(
                medium.extinct[k], (np.sqrt(cos) * (len(medium.extinct[k]) - 1),)
            )
    hit = np.where(depth > 1e-6, -np.expm1(-depth) / np.maximum(depth, 1e-6), 1.0)
    total, light = np.zeros(SHAPE), np.zeros((*SHAPE, bands))
    for k, sigma in enumerate(medium.sigma):
        density = medium.number[k] * ((1.0 + slope2) / (sigma**2 + slope2)) ** 2 * sigma**2
        total += density
        light += density[..., None] * interpolate(medium.reflect[k], (np.sqrt(facing) * (len(medium.reflect[k]) - 1),))
    return np.asarray(hit * light * (float(np.sum(medium.number)) / total)[..., None])


def _fit_base(tally: Array, entry: Array) -> Array:
    """Fit A = t B at the nodes by least squares, weighted by t, over uniform polar angles."""
    cos = np.cos(0.5 * np.pi * (np.arange(20_000) + 0.5) / 20_000)
    t = np.interp(np.sqrt(cos), np.linspace(0, 1, len(entry)), entry)
    low, share = cell(cos * (BASE_NODES - 1), BASE_NODES)
    hats = sparse.coo_matrix(
        (np.concatenate([1 - share, share]), (np.tile(np.arange(len(cos)), 2), np.concatenate([low, low + 1]))),
        shape=(len(cos), BASE_NODES),
    ).tocsr()
    mass = (hats.T @ sparse.diags(t / len(cos)) @ hats).toarray()
    bend = np.diff(np.eye(BASE_NODES), 2, axis=0)
    return np.maximum(np.linalg.solve(mass + 1e-5 * bend.T @ bend, tally), 0.0)


def _fit(hats: Array, tally: Array, penalty: float) -> Array:
    """Fit the table by least squares, with a penalty on second differences."""
    cells = len(hats)
    index = np.arange(cells).reshape(SHAPE)
    rows, columns, values = [], [], []
    for step in range(27):
        shift = np.array([step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1])
        here = tuple(slice(max(0, -s), n - max(0, s)) for s, n in zip(shift, SHAPE, strict=True))
        there = tuple(slice(max(0, s), n - max(0, -s)) for s, n in zip(shift, SHAPE, strict=True))
        rows.append(index[here].ravel())
        columns.append(index[there].ravel())
        values.append(hats[rows[-1], step])
    matrix = sparse.coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(cells, cells)
    ).tocsc()
    for axis, n in enumerate(SHAPE):
        bend = sparse.csr_matrix(np.diff(np.eye(n), 2, axis=0))
        factors = [bend if a == axis else sparse.identity(m) for a, m in enumerate(SHAPE)]
        spread = sparse.kron(sparse.kron(factors[0], factors[1]), factors[2])
        matrix = matrix + penalty * (spread.T @ spread)
    matrix = matrix + 1e-12 * float(matrix.diagonal().max()) * sparse.identity(cells)
    return np.asarray(splu(matrix.tocsc()).solve(tally)).reshape(*SHAPE, -1)
