"""CIELAB colours of a material at named geometries with their wavelength grids, and gloss."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.bsdf.lobes.interface import Microfacet
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.families.contract import narrowest_line_nm
from nacre.light import lamp_lines_nm, spectrum_to_xyz, white_xyz, with_lamp_lines, xyz_to_lab
from nacre.measure.evaluate import evaluate_for_colours, evaluate_with_error, line_wavelengths
from nacre.measure.geometry import Geometry, aspecular_pairs, named_geometries, spectrum_at

WALK_NM = np.linspace(380.0, 780.0, 26)  # 16 nm; 20 nm causes errors up to 0.9 dE00


def solve_coarse_walk(material: Any, wavelengths_nm: Any = None, walk_nm: Any = WALK_NM) -> Bsdf:
    """Return the Bsdf of a material; random walks use a coarse grid unless a grid is given.

    Args:
        material: anything with `bsdf(wavelengths_nm)`.
        wavelengths_nm: ascending, or None for the material's own choice.
        walk_nm: the coarse grid.
    """
    bsdf: Bsdf = material.bsdf(wavelengths_nm)
    if wavelengths_nm is None and any(lobe.is_stochastic for lobe in bsdf.lobes):
        if "quality" in getattr(material, "data", {}):  # a recipe that already chose a method is not tried again
            material = material.vary({"quality": "reference"})
        bsdf = material.bsdf(walk_nm)
    return bsdf


def colour_grid(material: Any, illuminant: str) -> Array | None:
    """Return wavelengths for a colour under a narrow-band lamp, or None if the material's grid suffices.

    Args:
        material: material whose `model` has a wavelength grid.
        illuminant: lamp name.
    """
    if not len(lamp_lines_nm(illuminant)):
        return None
    return with_lamp_lines(material.model.wavelengths_nm, illuminant)


def colour_spectrum(
    material: Any, theta_rad: Array, illuminant: str, seed: int = 0, wavelengths_nm: Array | None = None
) -> Spectrum:
    """Return spectra of a material on wavelengths that give colours under a lamp within 0.5 dE00.

    A material with fixed wavelengths (a measurement, a compiled file) uses those.

    Args:
        material: anything with `spectrum` and `bsdf`.
        theta_rad: `[angle]`.
        illuminant: lamp name.
        seed: random-walk seed.
        wavelengths_nm: grid chosen by the user, which is used unchanged.
    """
    grid = colour_grid(material, illuminant) if wavelengths_nm is None else wavelengths_nm
    if wavelengths_nm is None and grid is not None:
        try:
            spectrum: Spectrum = material.spectrum(theta_rad, grid, seed=seed)
            return spectrum
        except UnsupportedError:
            grid = None
    own: Spectrum = material.spectrum(theta_rad, grid, seed=seed)
    return own


def colour_bsdf(material: Any, illuminant: str, wavelengths_nm: Array | None = None, coarse: bool = True) -> Bsdf:
    """Return the Bsdf of a material on such wavelengths, for random walks on a coarse grid; see `solve_coarse_walk`.

    Args:
        wavelengths_nm: grid chosen by the user, which is used unchanged.
        coarse: False uses the material's grid also for random walks.
    """
    if wavelengths_nm is not None:
        requested: Bsdf = material.bsdf(wavelengths_nm)
        return requested
    grid = colour_grid(material, illuminant)
    if grid is not None:
        try:
            bsdf: Bsdf = material.bsdf(grid)
            if not (coarse and any(lobe.is_stochastic for lobe in bsdf.lobes)):
                return bsdf
            return solve_coarse_walk(material, walk_nm=with_lamp_lines(WALK_NM, illuminant))
        except UnsupportedError:
            pass
    return solve_coarse_walk(material) if coarse else material.bsdf()


def colour_values(
    material: Any, wi: Array, wo: Array, illuminant: str, samples: int | None = None, seed: int = 0
) -> tuple[Array, Array]:
    """Return values of a material at a few direction pairs `[pair, wavelength]`, and such wavelengths.

    A family with direct evaluation does not solve the whole Bsdf.
    """
    grid = colour_grid(material, illuminant)
    model = material.model
    line_nm = narrowest_line_nm(model)
    if np.isfinite(line_nm):
        grid = line_wavelengths(model.wavelengths_nm if grid is None else grid, line_nm)
    few: tuple[Array, Array] | None = material.values_at(wi, wo, grid)
    if few is not None:
        return few
    bsdf = colour_bsdf(material, illuminant, coarse=False)
    values, _, wavelengths_nm = evaluate_for_colours(bsdf, wi, wo, samples=samples, seed=seed)
    return values, wavelengths_nm


def recipe_geometries(material: Any) -> dict[str, Geometry]:
    """Return the geometries of a recipe's `[[geometry]]` list by name.

    Args:
        material: anything with `data` and `context`.

    Raises:
        RecipeError: an entry is not a geometry.
    """
    return named_geometries(material.data.get("geometry", ()), f"{material.context.source}: geometry")


def geometry_colours(
    material: Any,
    geometries: Sequence[Geometry],
    illuminant: str = "D65",
    observer: str = "10deg",
    samples: int | None = None,
    seed: int = 0,
) -> Array:
    """Return CIELAB `[geometry, 3]` at specular, transmitted, diffuse, hemispherical and aspecular geometries.

    Aspecular values are relative to a perfect diffuser, as in `nacre report`. A material without light at a geometry
    is black there.

    Args:
        material: anything with `spectrum`, `bsdf` and `values_at`.
        samples, seed: random-walk settings.

    Raises:
        NacreError: the material cannot be computed.
    """
    xyz = np.zeros((len(geometries), 3))
    rows = [row for row, geometry in enumerate(geometries) if geometry.kind == "aspecular"]
    if rows:
        wi, wo = aspecular_pairs([geometries[row] for row in rows])
        values, grid = colour_values(material, wi, wo, illuminant, samples, seed)
        xyz[rows] = spectrum_to_xyz(np.pi * values, grid, illuminant, observer)
    others = [row for row in range(len(geometries)) if row not in rows]
    if others:
        angles = np.unique([geometries[row].theta_deg for row in others])
        spectrum = colour_spectrum(material, np.radians(angles), illuminant, seed)
        for row in others:
            factors = spectrum_at(spectrum, geometries[row])
            if factors is not None:
                xyz[row] = spectrum_to_xyz(factors, spectrum.wavelengths_nm, illuminant, observer)
    return np.asarray(xyz_to_lab(xyz, white_xyz(illuminant, observer)))


# Approximate the glossy part of scattered light by a rough mirror (GGX microfacets, Trowbridge and Reitz).
#
# Nearly flat flakes and measured coatings scatter most light into a lobe about the mirror direction. The width of the
# lobe and its strength over the angle are determined from about eleven direction pairs. The rest remains diffuse.
#
# `fit_lobes` needs values without noise, and sums up to three such mirrors: one width does not describe a lobe that
# widens towards grazing angles, as below an interface.

TILTS_DEG = np.array([1.5, 3.0, 6.0, 12.0, 24.0, 50.0])  # tilts of the half vector; the last one: background
AT_DEG = 20.0  # difference angle at which the width is determined
FALL = 0.4  # fraction of the peak at which the width is measured
LEAST_PEAK = 2.0  # relative to the background; lower lobes count as diffuse
NARROWEST, WIDEST = 0.02, 0.7
RINGS_DEG = np.array([0.0, 1, 2, 3, 4.5, 6, 8, 11, 15, 20, 27, 36, 50, 90])  # borders of rings of half-vector tilt
RING_NODES, AZIMUTHS = 3, 8  # quadrature points across a ring and along half of it
ALPHAS = np.geomspace(0.03, 0.6, 9)
MOST_LOBES, LEAST_SHARE = 3, 0.02  # number of lobes, and minimum share of the scattered light at any angle
WHOLE = 10.0  # weight of the whole power relative to that within a ring


@dataclass(frozen=True)
class Gloss:
    """A lobe about the mirror direction.

    Attributes:
        alpha: roughness of the mirror.
        reflectance: `[angle, wavelength]`, at most the scattered light of the material.
    """

    alpha: float
    reflectance: Array


def find_gloss(bsdf: Bsdf, theta_rad: Array, spread: Array, samples: int | None = None) -> Gloss | None:
    """Return the glossy part of the scattered light of a Bsdf, or None.

    Args:
        bsdf: specular and microfacet lobes are ignored.
        theta_rad: `[angle]`, below pi/2.
        spread: scattered reflectance `[angle, wavelength]`.
        samples: random walks per direction pair; None: default of `nacre.evaluate`.
    """
    lobes = tuple(lobe for lobe in bsdf.lobes if not lobe.is_delta and not isinstance(lobe, Microfacet))
    if not lobes:
        return None
    rest = dataclasses.replace(bsdf, lobes=lobes)
    return fit_gloss(
        lambda wi, wo: np.asarray(evaluate_with_error(rest, wi, wo, samples=samples)[0]), theta_rad, spread
    )


def fit_gloss(values_at: Callable[[Array, Array], Array], theta_rad: Array, spread: Array) -> Gloss | None:
    """Return the rough mirror that fits a BSDF about the mirror direction, or None if it lacks a lobe there.

    Without shadowing a microfacet lobe is f = R D(h) / (4 cos_i cos_o), and GGX falls with the tilt t of the half
    vector as D(t) / D(0) = (a^2 / (sin^2 t + a^2 cos^2 t))^2, D(0) = 1 / (pi a^2) (Walter et al. 2007, eq. 33).

    Args:
        values_at: returns f `[pair, wavelength]`, 1/sr, at unit vectors to light and viewer `[pair, 3]`.
        theta_rad, spread: see `find_gloss`.
    """
    tilts = np.radians(TILTS_DEG)
    wi, wo = (np.concatenate(parts) for parts in zip(_pairs(theta_rad, 0.0 * theta_rad), _pairs(_same(tilts), tilts)))
    values = np.nan_to_num(values_at(wi, wo))
    ground = values[-1]  # f far from the lobe
    above = np.maximum(values - ground, 0.0) * (wi[:, 2] * wo[:, 2])[:, None]
    straight, tilted = above[: len(theta_rad)], above[len(theta_rad) : -1]
    peak = sum(float(np.interp(np.radians(AT_DEG), theta_rad, band)) for band in straight.T)
    if peak <= (LEAST_PEAK - 1.0) * float(ground.sum()) * np.cos(np.radians(AT_DEG)) ** 2:
        return None
    fall = tilted.sum(axis=1) / peak
    best = int(np.argmin(np.abs(fall - FALL)))
    root = np.sqrt(np.clip(fall[best], 1e-4, 0.999))
    square = root * np.sin(tilts[best]) ** 2 / (1.0 - root * np.cos(tilts[best]) ** 2)
    alpha = float(np.clip(np.sqrt(square), NARROWEST, WIDEST))
    return Gloss(alpha, np.minimum(4.0 * np.pi * alpha**2 * straight, spread))


def fit_lobes(values_at: Callable[[Array, Array], Array], theta_rad: Array, spread: Array) -> list[Gloss]:
    """Return rough mirrors that approximate noise-free scattered light at each viewing angle; the rest is diffuse.

    The power within each tilt of the half vector is fitted by non-negative least squares, relative to the whole power;
    up to three widths are chosen for all angles together.

    Args:
        values_at: as of `fit_gloss`.
        theta_rad, spread: see `find_gloss`.

    Returns:
        mirrors by rising width; `reflectance` is that of the mirror without shadowing losses.
    """
    from scipy.optimize import nnls

    powers, shapes = zip(*(_ring_powers(values_at, float(theta)) for theta in theta_rad), strict=True)
    weights = np.ones(len(RINGS_DEG) - 1)
    weights[-1] = WHOLE
    held = [np.cumsum(power, axis=0) for power in powers]
    bases = [weights[:, None] * np.cumsum(shape, axis=0) for shape in shapes]
    mean = [weights * one.sum(axis=1) / max(float(one[-1].sum()), 1e-12) for one in held]
    diffuse = len(ALPHAS)
    best = min(
        itertools.combinations(range(diffuse), MOST_LOBES),
        key=lambda chosen: sum(nnls(b[:, [*chosen, diffuse]], m)[1] ** 2 for b, m in zip(bases, mean, strict=True)),
    )
    found = np.zeros((MOST_LOBES, *spread.shape))
    share = np.zeros(found.shape)
    for i, (basis, power) in enumerate(zip(bases, held, strict=True)):
        used = basis[:, [*best, diffuse]]
        for band in range(spread.shape[1]):
            whole = max(float(power[-1, band]), 1e-12)
            factors, _ = nnls(used, weights * power[:, band] / whole)
            part = factors * used[-1] / WHOLE
            scale = spread[i, band] / max(float(part.sum()), 1e-12)
            found[:, i, band], share[:, i, band] = factors[:-1] * scale, (part / max(part.sum(), 1e-12))[:-1]
    numbers = [k for k in range(MOST_LOBES) if share[k].max() > LEAST_SHARE]
    return [Gloss(float(ALPHAS[best[k]]), found[k]) for k in numbers]


def _ring_powers(values_at: Callable[[Array, Array], Array], theta: float) -> tuple[Array, Array]:
    """Return the power within rings of half-vector tilt, seen at an angle.

    Returns:
        `[ring, wavelength]` of the material, and `[ring, alpha]` of white mirrors, the last of a white diffuser.
    """
    node, weight = np.polynomial.legendre.leggauss(RING_NODES)
    low, high = np.radians(RINGS_DEG[:-1, None]), np.radians(RINGS_DEG[1:, None])
    tilt = np.broadcast_to((low + 0.5 * (high - low) * (1 + node))[..., None], (len(low), RING_NODES, AZIMUTHS))
    phi = (np.arange(AZIMUTHS) + 0.5) * np.pi / AZIMUTHS
    half = np.stack([np.sin(tilt) * np.cos(phi), np.sin(tilt) * np.sin(phi), np.cos(tilt)], axis=-1)
    wo = np.array([np.sin(theta), 0.0, np.cos(theta)])
    towards = half @ wo
    wi = 2 * towards[..., None] * half - wo
    measure = np.sin(tilt) * 4 * towards * (0.5 * (high - low) * weight)[..., None] * (2 * np.pi / AZIMUTHS)
    is_valid = (towards > 0) & (wi[..., 2] > 1e-4)
    measure = np.where(is_valid, measure * wi[..., 2], 0.0)
    ring = np.broadcast_to(np.arange(len(low))[:, None, None], is_valid.shape)[is_valid]
    incident, area = wi[is_valid], measure[is_valid]
    values = np.nan_to_num(values_at(incident, np.broadcast_to(wo, incident.shape)))
    white = np.stack(
        [*(_mirror(alpha, incident, wo, half[is_valid]) for alpha in ALPHAS), np.full(len(incident), 1 / np.pi)], -1
    )
    sums: list[Array] = []
    for one in (values, white):
        total = np.zeros((len(low), one.shape[-1]))
        np.add.at(total, ring, one * area[:, None])
        sums.append(total)
    return sums[0], sums[1]


def _mirror(alpha: float, wi: Array, wo: Array, half: Array) -> Array:
    """Return a white rough mirror's f: GGX with height-correlated masking (Heitz 2014, eq. 99)."""
    z2 = half[:, 2] ** 2
    density = alpha**2 / (np.pi * (1 - z2 + alpha**2 * z2) ** 2)
    masks = [0.5 * (np.sqrt(1 + alpha**2 * (1 - w[..., 2] ** 2) / w[..., 2] ** 2) - 1) for w in (wi, wo)]
    return np.asarray(density / ((1 + masks[0] + masks[1]) * 4 * wi[:, 2] * wo[2]))


def _same(tilts: Array) -> Array:
    return np.full(tilts.shape, np.radians(AT_DEG))


def _pairs(difference: Array, tilt: Array) -> tuple[Array, Array]:
    """Return directions to light and viewer for half vectors that are tilted out of their plane."""
    half = np.stack([0.0 * tilt, np.sin(tilt), np.cos(tilt)], axis=-1) * np.cos(difference)[:, None]
    side = np.array([1.0, 0.0, 0.0]) * np.sin(difference)[:, None]
    return half + side, half - side
