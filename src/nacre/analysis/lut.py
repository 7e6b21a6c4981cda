"""Look-up tables of colour for engines: facets of films, scattered light, and the comparison with nacre.

Colours are linear in spectra, as are all averages here; therefore a film's tables are first reduced to three
channels.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.bsdf import Bsdf
from nacre.bsdf.facet_distributions import exits, masking, normal_quadrature
from nacre.bsdf.lobe import hemisphere_nodes
from nacre.bsdf.lobes.interface import AlignedMicrofacet, AlignedSpecular, Microfacet, Specular
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.texture import ParameterAxis, Texture, refuse_place
from nacre.core.arrays import Array, direction, take_at
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.contract import Diffracting
from nacre.formats import lut
from nacre.formats.bsdf_tables import is_isotropic
from nacre.formats.lut import Closure, LightTable, Picture, column_angles
from nacre.light import delta_e_2000, spectrum_to_rgb_matrix, srgb_linear_to_xyz, xyz_to_lab
from nacre.light.tristimulus import Illuminant, illuminant, weighted_sum
from nacre.material.material import Material, StoredBsdf
from nacre.measure.colours import Gloss, colour_bsdf, find_gloss, fit_lobes
from nacre.measure.evaluate import evaluate_with_error, hemispherical

COLUMNS = 256
ROUGH_COLUMNS = 91  # columns of the smooth colours averaged over facets
FINE = 2049  # cosines, with linear interpolation of facet colours
NODES = 64  # quadrature nodes over facets, per coordinate
AZIMUTH_ROWS = 9
AZIMUTHS = 6  # azimuth count over a quarter turn, for anisotropic facets
STEEPEST = np.radians(89.5)  # largest angle, just below grazing incidence
LEAST_PASSED = 1e-3  # mean transmittance below which the light inside a body is taken as white
LEAST_SEEN = 1e-4  # visible share of facets below which the colour of the previous angle is used
BY_AZIMUTH = (
    "scatters light by the direction about the normal, as gratings and reliefs do; a table of half and difference "
    "angle cannot hold that (--to rgl or exr can)"
)
ToRgb = Callable[[Array], Array]


def coloured(response: InterfaceResponse, to_rgb: ToRgb) -> InterfaceResponse:
    """Return an interface with three channels in place of wavelengths."""
    return dataclasses.replace(
        response,
        wavelengths_nm=np.array([1.0, 2.0, 3.0]),
        reflectance=to_rgb(response.reflectance),
        transmittance=to_rgb(response.transmittance),
        reflectance_inside=to_rgb(response.reflectance_inside),
        total=to_rgb(response.total),
        relative_index=None,
    )


def entered(response: InterfaceResponse, to_rgb: ToRgb) -> InterfaceResponse:
    """Return an interface in three channels for the light inside a body that came through the same interface.

    This light has the spectrum of the transmittance T: its reflectance R has the colour <T R> / <T>, and T has
    <T T> / <T>. Products of the channel means <T> underestimate the light that crosses a body and overestimate the
    light that stays inside. Under uniform light both are exact.
    """
    plain, passed = coloured(response, to_rgb), response.transmittance
    is_seen = plain.transmittance > LEAST_PASSED
    share = np.where(is_seen, plain.transmittance, 1.0)

    def weighted(table: Array, otherwise: Array) -> Array:
        return np.where(is_seen, np.clip(to_rgb(passed * table) / share, 0.0, 1.0), otherwise)

    return dataclasses.replace(
        plain,
        transmittance=weighted(passed, plain.transmittance),
        reflectance_inside=weighted(response.reflectance_inside, plain.reflectance_inside),
    )


def at_node(response: InterfaceResponse, node: tuple[int, ...]) -> InterfaceResponse:
    """Return a varying interface at one node."""
    return dataclasses.replace(
        response,
        parameters=(),
        reflectance=response.reflectance[node],
        transmittance=response.transmittance[node],
        reflectance_inside=response.reflectance_inside[node],
        total=response.total[node],
    )


def facet_bands(response: InterfaceResponse) -> Array:
    """Return the bands `[band, row, column, 3]` of a facet picture; an opaque interface has one."""
    cos = np.cos(column_angles(COLUMNS))
    bands = [response.over_cosine(response.reflectance, cos)]
    if response.transmits:
        names = ("transmittance", "reflectance_inside")
        bands += [response.over_cosine(getattr(response, name), cos) for name in names]
        beyond = np.linspace(0.0, 1.0, COLUMNS)
        bands.append(take_at(response.total, response.nodes_beyond, beyond, -2) if response.eta > 1.0 else bands[2])
    return np.stack([band.reshape(-1, COLUMNS, 3) for band in bands])


def sides(response: InterfaceResponse, cos: Array, is_behind: bool) -> tuple[Array, Array]:
    """Return reflectance and transmittance `[row, cos, 3]` of a coloured interface for light on one side.

    Args:
        cos: `[cos]`, in the light's medium.
    """
    inside = np.full(cos.shape, is_behind != response.flipped)
    count = len(response.parameters)
    nodes = np.ndindex(response.reflectance.shape[:count])
    looked_up = [at_node(response, node).lookup(cos, inside) for node in nodes]
    return np.stack([reflected for reflected, _ in looked_up]), np.stack([passed for _, passed in looked_up])


@dataclasses.dataclass(frozen=True)
class ViewColours:
    """Colours of closures over the view angle, `[row, column, 3]` each."""

    reflected: Array
    passed: Array


def smooth_view(response: InterfaceResponse, is_behind: bool) -> ViewColours:
    """Return the colours of a smooth surface, seen from one side.

    Channels are clipped to [0, 1]: engines accept no negative values, and values above 1 would amplify light inside a
    body. Without absorption, reflectance and transmittance still sum to 1.
    """
    return ViewColours(
        *(np.clip(part, 0.0, 1.0) for part in sides(response, np.cos(column_angles(COLUMNS)), is_behind))
    )


def closure_distribution(distribution: str) -> str:
    """Return the microfacet distribution of engines for one of nacre."""
    return "beckmann" if distribution == "blinn" else distribution


def rough_view(lobe: Microfacet, is_behind: bool) -> ViewColours:
    """Return the colours that make an engine's rough closure transmit and reflect like a rough film.

    At each view angle: radiance of the film under uniform light, divided by that of the closure with masking losses
    only (height-correlated Smith masking, as in engines). Brushed films have a row per azimuth (`over_azimuth`), or the
    mean over azimuth if a number varies too.

    Args:
        lobe: the film in three channels.
    """
    response = lobe.response
    tables = sides(response, np.linspace(0.0, 1.0, FINE), is_behind)
    facets = normal_quadrature(lobe.distribution, lobe.alpha_x, lobe.alpha_y, NODES)
    eta = inner_index(response, is_behind)
    closure = ClosureLoss(closure_distribution(lobe.distribution), (lobe.alpha_x, lobe.alpha_y), eta)
    between = between_facets(lobe, is_behind)

    def column(turns: Array) -> tuple[Array, Array]:
        fitted: tuple[list[Array], list[Array]] = ([], [])
        for theta in np.minimum(column_angles(ROUGH_COLUMNS), STEEPEST):
            weights, white = np.zeros((2, FINE)), np.zeros(2)
            extra = np.zeros((2, 1, 3))
            for w in direction(theta, turns):
                weights += _shares(w, lobe, facets, eta)
                white += closure.kept(w)
                extra = extra + between(w)
            for side, table in enumerate(tables):
                total = np.einsum("f,rfc->rc", weights[side], table) + extra[side]
                is_seen = white[side] > LEAST_SEEN * len(turns) or not fitted[side]
                fitted[side].append(total / max(white[side], 1e-9) if is_seen else fitted[side][-1])
        return np.stack(fitted[0], axis=1), np.stack(fitted[1], axis=1)

    if not over_azimuth(lobe):
        fitted = column(azimuths((lobe.alpha_x, lobe.alpha_y)))
        return ViewColours(*(np.maximum(part, 0.0) for part in fitted))
    rows = [column(np.array([turn])) for turn in np.arccos(np.sqrt(np.linspace(0.0, 1.0, AZIMUTH_ROWS)))]
    return ViewColours(*(np.maximum(np.concatenate([row[side] for row in rows]), 0.0) for side in (0, 1)))


def over_azimuth(lobe: Microfacet) -> bool:
    """Whether the rows of a view picture are the squared cosine of the azimuth relative to u, from 0 to 1."""
    return lobe.alpha_x != lobe.alpha_y and not lobe.parameters


def inner_index(response: InterfaceResponse, is_behind: bool) -> float:
    """Return the index of the exit side relative to that of the incident side."""
    return response.eta if is_behind == response.flipped else 1.0 / response.eta


def azimuths(alpha: tuple[float, float]) -> Array:
    """Return azimuths in rad whose mean represents all; one for isotropic facets."""
    if alpha[0] == alpha[1]:
        return np.array([0.0])
    return np.asarray((np.arange(AZIMUTHS) + 0.5) * (0.5 * np.pi / AZIMUTHS))


def _shares(w: Array, lobe: Microfacet, facets: tuple[Array, Array], eta: float) -> Array:
    """Return the weights `[2, cos]` of facets in reflection and transmission at the fine cosines."""
    m, measure = facets
    w_m = m @ w
    m, measure, w_m = m[w_m > 0], measure[w_m > 0], w_m[w_m > 0]
    ways: Array = np.broadcast_to(w, m.shape)
    weights = np.zeros((2, FINE))
    low = np.minimum((w_m * (FINE - 1)).astype(int), FINE - 2)
    part = w_m * (FINE - 1) - low
    for side, wo in enumerate(exits(w, m, eta)):
        weight = measure * w_m / w[2] * masking(lobe.distribution, ways, wo, m, lobe.alpha_x, lobe.alpha_y)
        weights[side] += np.bincount(low, weight * (1 - part), FINE) + np.bincount(low + 1, weight * part, FINE)
    return weights


class ClosureLoss:
    """Energy of the white rough closure of an engine after masking losses.

    Engines (Cycles, OSL's testrender) use height-correlated Smith masking, 1 / (1 + Lambda_i + Lambda_o) (Heitz 2014,
    eq. 99); the lobe of Ashikhmin and Shirley is that of their paper.
    """

    def __init__(self, distribution: str, alpha: tuple[float, float], eta: float = 1.0) -> None:
        self.distribution, self.alpha, self.eta = distribution, alpha, eta
        self.facets = normal_quadrature(distribution, *alpha, NODES)

    def kept(self, w: Array) -> Array:
        """Return the reflected and refracted shares of light along `w[3]`, z > 0."""
        m, measure = self.facets
        w_m = m @ w
        m, measure, w_m = m[w_m > 0], measure[w_m > 0], w_m[w_m > 0]
        ways = np.broadcast_to(w, m.shape)
        shares = []
        for wo in exits(w, m, self.eta):
            if self.distribution == "ashikhmin-shirley":
                visible = masking(self.distribution, ways, wo, m, *self.alpha)
            else:
                is_seen = (np.sum(wo * m, axis=-1) * wo[:, 2] > 0) & (np.abs(wo[:, 2]) > 1e-9)
                visible = np.where(is_seen, 1.0 / (1.0 + self._smith(ways) + self._smith(wo)), 0.0)
            shares.append(float(np.sum(measure * w_m / w[2] * visible)))
        return np.array(shares)

    def _smith(self, w: Array) -> Array:
        """Return Lambda; Beckmann's by the rational fit of Walter et al. 2007."""
        flat2 = np.square(self.alpha[0] * w[:, 0]) + np.square(self.alpha[1] * w[:, 1])
        tan2 = flat2 / np.maximum(w[:, 2] ** 2, 1e-12)
        if self.distribution == "ggx":
            return np.asarray(0.5 * (np.sqrt(1.0 + tan2) - 1.0))
        a = 1.0 / np.sqrt(np.maximum(tan2, 1e-12))
        return np.where(a < 1.6, (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 * a + 2.181 * a * a), 0.0)


def between_facets(lobe: Microfacet, is_behind: bool) -> Callable[[Array], Array]:
    """Return a function of w for multiple scattering among facets under uniform light, `[side, row, 3]`.

    Raises:
        UnsupportedError: the loss depends on the wavelength.
    """
    if lobe.loss is None or lobe.exchange is None:
        return lambda w: np.zeros((2, 1, 3))
    if lobe.loss.shape[3] != 1:
        raise UnsupportedError("a table cannot hold light between facets whose loss depends on the wavelength")
    here = int(is_behind != lobe.response.flipped)
    count = lobe.loss.shape[0]
    exchange = lobe.exchange.reshape(-1, count, count, 3)
    wo, weight = hemisphere_nodes()
    zero = np.zeros((exchange.shape[0], 3))
    sums = [
        exchange[:, here, side] * float(weight @ lobe.lost_towards(wo, side)[:, 0])
        if max(here, side) < count and (side == here or lobe.transmits) else zero
        for side in (here, 1 - here)
    ]  # fmt: skip

    def sent(w: Array) -> Array:
        lost = float(lobe.lost_towards(w, here)[0]) if here < count else 0.0
        return np.stack(sums) * lost

    return sent


# Scattered light over the view angle, and over half and difference angles

VIEW_DEG = np.array([0.0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 64, 68, 72, 75, 78, 81, 83.5, 86, 88])
PATHS = 128  # square root of the paths of a random walk per view angle
LOBE_SHAPE = (17, 48, 128)  # slices, rows and columns of a lobe picture
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Scatter:
    """Views of scattered light `[column, 3]` by the closure's name, and the lobe; `gloss` has one view per width."""

    gloss: tuple[tuple[float, Array], ...]
    spread: Array
    through: Array | None
    behind: Array | None
    lobe: Picture | None
    lost: tuple[str, ...]


def _mirrors(bsdf: Bsdf, steady: Bsdf | None, powers: Array, to_rgb: ToRgb) -> list[Gloss]:
    """Return the glossy part of scattered light in three channels, over `VIEW_DEG`, relative to white mirrors.

    Args:
        steady: the same material without noise, if it has such a form.
        powers: scattered reflectance `[angle, wavelength]`.
    """
    theta = np.radians(VIEW_DEG)
    if steady is not None:
        return fit_lobes(
            lambda wi, wo: np.maximum(to_rgb(steady.evaluate(wi, wo)), 0.0), theta, np.maximum(to_rgb(powers), 0.0)
        )
    glossy = find_gloss(bsdf, theta, powers)
    if glossy is None:
        return []
    return [Gloss(glossy.alpha, to_rgb(glossy.reflectance) / np.maximum(_returned(glossy.alpha, theta), 0.05)[:, None])]


def _returned(alpha: float, theta_rad: Array) -> Array:
    """Return the shares `[angle]` of light that a white rough mirror of engines reflects."""
    closure = ClosureLoss("ggx", (alpha, alpha))
    return np.array([closure.kept(w)[0] for w in direction(theta_rad, 0.0)])


def _powers(bsdf: Bsdf, directions: Array) -> Array:
    """Return the power `[side, angle, wavelength]` on the light's side and on the other side."""
    powers = [[hemispherical(lobe, w, nodes=PATHS if lobe.is_stochastic else NODES) for lobe in bsdf.lobes]
             for w in directions]  # fmt: skip
    return np.array([[sum(part[side] for part in parts) for parts in powers] for side in (0, 1)])


def make_scatter(material: Any, bsdf: Bsdf, to_rgb: ToRgb, progress: Progress) -> Scatter:
    """Bake the scattering lobes of a material.

    Args:
        bsdf: isotropic scattering lobes only.
        to_rgb: converts spectra on its wavelengths.
    """
    progress("scattered light over the angle of view")
    powers = _powers(bsdf, direction(np.radians(VIEW_DEG), 0.0))
    steady = _noiseless(material, bsdf) if any(lobe.is_stochastic for lobe in bsdf.lobes) else bsdf
    spread, glossy = to_rgb(powers[0]), []
    for gloss in _mirrors(bsdf, steady, powers[0], to_rgb):
        spread = spread - gloss.reflectance * _returned(gloss.alpha, np.radians(VIEW_DEG))[:, None]
        glossy.append((gloss.alpha, _smooth(gloss.reflectance)))
    sides: tuple[Array | None, Array | None] = (None, None)
    if bsdf.transmits:
        below = to_rgb(_powers(bsdf, direction(np.pi - np.radians(VIEW_DEG), 0.0)))
        sides = _smooth(to_rgb(powers[1])), np.stack([_smooth(side) for side in below])
    progress("scattered light over half and difference angles")
    return Scatter(tuple(glossy), _smooth(spread), *sides, *_lobe(steady, bsdf.transmits, to_rgb))


def _smooth(values: Array) -> Array:
    """Return colours at a picture's columns from those at `VIEW_DEG`, without overshoot."""
    from scipy.interpolate import PchipInterpolator

    angles = np.minimum(column_angles(COLUMNS), STEEPEST)
    return np.asarray(PchipInterpolator(np.radians(VIEW_DEG), values, axis=0)(np.minimum(angles, np.radians(88.0))))


def _lobe(steady: Bsdf | None, transmits: bool, to_rgb: ToRgb) -> tuple[Picture | None, tuple[str, ...]]:
    """Return the noise-free scattered texture, if any, and descriptions of lost properties."""
    lost = ("GLSL: light that is scattered to the other side",) if transmits else ()
    about = "scattered light, pi f 2 cos_i cos_o / (cos_i + cos_o), over half angle, difference angle and its azimuth"
    if steady is None:
        return None, (*lost, "GLSL: scattered light, a random walk without a noise-free form")
    wi, wo = lut.lobe_directions(*LOBE_SHAPE)
    weight = np.pi * lut.lobe_weight(wi, wo)[..., None]
    return Picture(_evaluated(steady, wi, wo, to_rgb) * weight, about), lost


def _noiseless(material: Any, bsdf: Bsdf) -> Bsdf | None:
    """Return the noise-free form of a random walk, if its recipe has an isotropic one."""
    try:
        fast: Bsdf = material.vary({"quality": "fast"}).bsdf(bsdf.wavelengths_nm)
    except NacreError:
        return None
    lobes = tuple(lobe for lobe in fast.lobes if not lobe.is_delta)
    if not lobes or any(lobe.is_stochastic for lobe in lobes):
        return None
    remaining = Bsdf(lobes, fast.provenance)
    return remaining if is_isotropic(remaining) else None


def _evaluated(bsdf: Bsdf, wi: Array, wo: Array, to_rgb: ToRgb) -> Array:
    """Return colours of values at pairs, computed in slices to save memory."""
    return np.stack([to_rgb(np.nan_to_num(bsdf.evaluate(i, o))) for i, o in zip(wi, wo, strict=True)])


def lobe_pairs(count: int, seed: int, lowest: float = 0.1) -> tuple[Array, Array]:
    """Return direction pairs `[count, 3]` above the surface, distributed over the picture's coordinates.

    Args:
        lowest: smallest cosine of both directions.
    """
    from scipy.stats import qmc

    unit = qmc.Sobol(3, seed=seed).random_base2(int(np.ceil(np.log2(8 * count))))
    theta_h, phi = unit[:, 0] ** 2 * np.pi / 2, unit[:, 2] * np.pi / 2
    theta_d = unit[:, 1] * np.arctan2(np.cos(theta_h), np.sin(theta_h) * np.cos(phi))
    half = direction(theta_h, 0.0)
    turn = np.cos(phi)[:, None] * direction(theta_h - np.pi / 2, 0.0) + np.sin(phi)[:, None] * np.array([0.0, 1.0, 0.0])
    out, across = np.cos(theta_d)[:, None] * half, np.sin(theta_d)[:, None] * turn
    wi, wo = out + across, out - across
    is_above = (wi[:, 2] > lowest) & (wo[:, 2] > lowest)
    return wi[is_above][:count], wo[is_above][:count]


# The complete table of a material, and its comparison with nacre

MAP_SIZE = 512  # pixels per side of a formula's map
LARGEST_MAP = 4096
CHECKED = 64  # number of compared places
CHECKED_PAIRS, CHECKED_WALKS = 64, 16384
STEEPEST_CHECKED_DEG = 80.0
CHECKED_DEG = np.array([2.5, 17.5, 32.5, 47.5, 62.0, 73.5])
MIN_REFLECTANCE = 1e-6  # smaller parts are ignored


def make_table(material: Material, lamp: str = "D65", progress: Progress = lambda what: None) -> LightTable:
    """Bake a material.

    Args:
        lamp: illuminant name.
        progress: called with a description of each step.

    Raises:
        UnsupportedError: a table cannot represent the material.
    """
    source = material.context.source
    refuse_place(material.model, f"{source}: export")
    light = illuminant(lamp)
    refuse_orders(material)
    progress("solving the material")
    try:
        _refuse_early(material)
        bsdf = colour_bsdf(material, light.name)
        return _baked(material, bsdf, light, progress)
    except UnsupportedError as error:
        text = str(error)
        raise UnsupportedError(text if text.startswith(str(source)) else f"{source}: {text}") from None


def _baked(material: Material, bsdf: Bsdf, light: Illuminant, progress: Progress) -> LightTable:
    matrix = np.asarray(spectrum_to_rgb_matrix(bsdf.wavelengths_nm, light))

    def to_rgb(values: Array) -> Array:
        return np.asarray(weighted_sum(values, matrix))

    lost: list[str] = []
    if any(isinstance(lobe, AlignedMicrofacet | AlignedSpecular) for lobe in bsdf.lobes):
        bsdf = _without_azimuth(bsdf)
        lost.append("the azimuth of the light: reflection and transmission are means over it")
    _refuse(bsdf)
    pictures: dict[str, Picture] = {}
    closures: list[Closure] = []
    errors: dict[str, dict[str, float]] = {}
    facets, parameter = None, None
    interfaces = [lobe for lobe in bsdf.lobes if isinstance(lobe, Specular | Microfacet)]
    mirror = _walk_mirror(bsdf) if not interfaces else None
    axes = {axis.name: axis for lobe in interfaces for axis in lobe.parameters}
    if axes:
        (axis,) = axes.values()
        parameter = lut.Parameter(axis.name, float(axis.values[0]), float(axis.values[-1]))
        pictures["map"] = Picture(
            np.repeat(map_over_uv(axis)[None, ..., None], 3, axis=-1), f"{axis.name} over uv, from 0 to 1", is_data=True
        )
    if interfaces or mirror is not None:
        progress("the film's interface")
        facets = _bake_interface(interfaces, mirror, to_rgb, pictures, closures, errors)
    scattering = tuple(lobe for lobe in bsdf.lobes if not lobe.is_delta and not isinstance(lobe, Microfacet))
    if scattering:
        scattered = Bsdf(scattering, bsdf.provenance)
        scatter = make_scatter(material, scattered, to_rgb, progress)
        _add_scatter(scatter, pictures, closures)
        progress("comparing with nacre")
        errors |= _scatter_errors(scattered, scatter, to_rgb)
        lost += scatter.lost
    provenance = {"nacre": __version__, "recipe": material.text, "illuminant": light.name, "observer": "2deg"}
    return LightTable(
        material.name, light.name, pictures, tuple(closures), facets, parameter, errors, tuple(lost), provenance
    )


def _without_azimuth(bsdf: Bsdf) -> Bsdf:
    """Return a Bsdf with the means over the azimuth of its aligned lobes."""
    means = (e.mean() if isinstance(e, AlignedMicrofacet | AlignedSpecular) else e for e in bsdf.lobes)
    return dataclasses.replace(bsdf, lobes=tuple(means))


def refuse_orders(material: Material) -> None:
    """Check that a grating sends light to the mirror direction alone.

    Raises:
        UnsupportedError: orders propagate in other directions.
    """
    model = material.model
    if isinstance(model, Diffracting) and model.scatters_orders(model.wavelengths_nm):
        raise UnsupportedError(f"{material.context.source}: {BY_AZIMUTH}")


def _refuse_early(material: Material) -> None:
    """Check the lobes at one wavelength, before the material is solved at all of them.

    Raises:
        UnsupportedError: tables cannot represent them.
    """
    if isinstance(material.model, StoredBsdf):  # solved already, on its own wavelengths
        return
    grid = material.model.wavelengths_nm
    middle = grid[len(grid) // 2 : len(grid) // 2 + 1]
    _refuse(_without_azimuth(material.at_low_fidelity(is_reported=True).bsdf(middle)))


def _refuse(bsdf: Bsdf) -> None:
    """Check that tables can represent the lobes.

    Raises:
        UnsupportedError: with the reason.
    """
    facets = [lobe for lobe in bsdf.lobes if isinstance(lobe, Microfacet)]
    scattering = [lobe for lobe in bsdf.lobes if not isinstance(lobe, Microfacet | Specular)]
    names = dict.fromkeys(name for lobe in bsdf.lobes for name in lobe.varying)
    if any(isinstance(lobe, MaskedLobe) for lobe in bsdf.lobes):
        raise UnsupportedError(
            f"{', '.join(names)} blends materials over the surface; export each by itself, or use --to three or gltf"
        )
    if len(names) > 1:
        raise UnsupportedError(f"{', '.join(names)} vary over the surface, and a table holds one; --set the others")
    if names and scattering:
        raise UnsupportedError(f"{', '.join(names)} varies and light is scattered below; a table holds one of both")
    if len(facets) > 1:
        raise UnsupportedError("has several rough interfaces, and a table holds one")
    for lobe in facets:
        if lobe.alpha_texture is not None or lobe.rotation is not None:
            what = "roughness" if lobe.alpha_texture is not None else "rotation"
            raise UnsupportedError(f"surface.{what} varies over the surface, which a table does not hold; --set it")
    steady = tuple(lobe for lobe in scattering if not lobe.is_stochastic and not lobe.is_delta)
    if steady and not is_isotropic(Bsdf(steady)):
        raise UnsupportedError(BY_AZIMUTH)


def _walk_mirror(bsdf: Bsdf) -> Array | None:
    """Return the specular reflectance `[column, wavelength]` of a random walk or table, or None."""
    reflectance = bsdf.specular(np.minimum(column_angles(COLUMNS), np.radians(89.99)))
    return reflectance.reflectance if reflectance.reflectance.max() > MIN_REFLECTANCE else None


def map_over_uv(axis: ParameterAxis) -> Array:
    """Return a number's map over uv `[row, column]`, from 0 to 1; the first row is v = 0."""
    return axis.coordinate(over_uv(axis.texture)) / max(len(axis.values) - 1, 1)


def over_uv(texture: Texture) -> Array:
    """Return a texture's values over uv `[row, column]`; the first row is v = 0."""
    image = texture.image
    rows, columns = (MAP_SIZE, MAP_SIZE) if image is None else np.minimum(image.shape, LARGEST_MAP)
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    return np.asarray(texture(np.stack([u, v], axis=-1)), dtype=float)


def _bake_interface(
    lobes: list[Specular | Microfacet], mirror: Array | None, to_rgb: Callable[[Array], Array],
    pictures: dict[str, Picture], closures: list[Closure], errors: dict[str, dict[str, float]],
) -> lut.Facets:  # fmt: skip
    """Add the pictures and closures of specular and microfacet lobes."""
    if mirror is not None:
        values = to_rgb(mirror)[None]
        pictures["facet"] = Picture(values[None], "reflectance over the angle of incidence")
        pictures["mirror"] = Picture(values[None], "colour of the mirror over the angle of view")
        closures.append(Closure("glossy", "mirror"))
        return lut.Facets("ggx", (0.0, 0.0), 1.0, False, False, False)
    rough = next((lobe for lobe in lobes if isinstance(lobe, Microfacet)), None)
    lobe = rough or lobes[0]
    response = _joined([coloured(each.response, to_rgb) for each in lobes])
    alpha = (rough.alpha_x, rough.alpha_y) if rough else (0.0, 0.0)
    distribution = rough.distribution if rough else "ggx"
    bends = rough is not None and rough.transmits
    facets = lut.Facets(distribution, alpha, response.eta, response.flipped, response.transmits, not bends)
    pictures["facet"] = Picture(facet_bands(response), "what a facet reflects and passes, over the angle to the light")
    is_body = response.transmits and response.eta > 1.0 and not response.flipped
    within = entered(lobe.response, to_rgb) if is_body else response
    if rough is not None:
        exchange = None if rough.exchange is None else to_rgb(rough.exchange)
        rough = dataclasses.replace(rough, response=coloured(rough.response, to_rgb), exchange=exchange)
        _add_loss(rough, pictures)
    names: dict[str, list[str | None]] = {"mirror": [], "through": []}
    for is_behind in (False, True) if response.transmits else (False,):
        interface = within if is_behind else response
        facet = rough and (dataclasses.replace(rough, response=interface) if is_behind and is_body else rough)
        views = rough_view(facet, is_behind) if facet else smooth_view(interface, is_behind)
        passed = views.passed if bends or rough is None else smooth_view(interface, is_behind).passed
        for name, values, what in (("mirror", views.reflected, "reflects"), ("through", passed, "passes")):
            title = name + ("-behind" if is_behind else "")
            if values.max() <= MIN_REFLECTANCE:
                names[name].append(None)
                continue
            side = ", seen from behind" if is_behind else ""
            about = f"colour of the closure that {what}, over the angle of view{side}"
            rows = "parameter" if response.parameters else "azimuth" if len(values) > 1 else ""
            pictures[title] = Picture(values[None], about, rows=rows)
            names[name].append(title)
    own = closure_distribution(distribution)
    closures.append(Closure("glossy", *_pair(names["mirror"]), distribution=own, alpha=alpha))
    if names["through"] and any(names["through"]):
        ior = 1.0 / response.eta if response.flipped else response.eta
        kind = "straight" if response.eta == 1.0 else "refract"
        closures.append(Closure(kind, *_pair(names["through"]), distribution=own, alpha=alpha, ior=ior))
    errors |= _interface_errors(lobe, rough, response, pictures)
    return facets


def _pair(names: list[str | None]) -> tuple[str | None, str | None]:
    return names[0], names[1] if len(names) > 1 else None


def _joined(responses: list[InterfaceResponse]) -> InterfaceResponse:
    """Merge a rough free-standing film's responses, reflection by facets and direct transmission, into one.

    Raises:
        UnsupportedError: the lobes do not match.
    """
    first, *others = responses
    for other in others:
        if not np.array_equal(other.cos_outside, first.cos_outside) or (other.eta, first.eta) != (1.0, 1.0):
            raise UnsupportedError("has several interfaces of its own, and a table holds one")
        first = dataclasses.replace(
            first, transmittance=first.transmittance + other.transmittance, reflectance=first.reflectance
            + other.reflectance, reflectance_inside=first.reflectance_inside + other.reflectance_inside,
            transmits=first.transmits or other.transmits,
        )  # fmt: skip
    return first


def _add_loss(lobe: Microfacet, pictures: dict[str, Picture]) -> None:
    """Add the compensation of light lost among facets, for shaders with access to the light."""
    if lobe.loss is None or lobe.exchange is None:
        return
    count = lobe.loss.shape[0]
    loss = np.swapaxes(lobe.loss[..., :1], 1, 2)  # rows over t, columns over s
    pictures["loss"] = Picture(np.repeat(loss, 3, axis=-1), "light lost between facets along a direction", is_data=True)
    exchange = lobe.exchange.reshape(-1, count * count, 3)
    bands = np.moveaxis(exchange, 1, 0)[:, :, None, :]
    pictures["exchange"] = Picture(bands, "colour of the light between facets, 1/sr")


def _interface_errors(
    lobe: Specular | Microfacet, rough: Microfacet | None, response: InterfaceResponse, pictures: dict[str, Picture]
) -> dict[str, dict[str, float]]:
    """Compare the pictures between their nodes: facet colour, and colour under uniform light by view angle."""
    generator = np.random.default_rng(0)
    theta = np.radians(generator.uniform(0.0, STEEPEST_CHECKED_DEG, CHECKED))
    rows = generator.integers(0, max(pictures["facet"].values.shape[1], 1), CHECKED)
    last = max(pictures["facet"].values.shape[1] - 1, 1)
    errors = {}
    reflected, _ = sides(response, np.cos(theta), response.flipped)
    wanted = reflected[rows, np.arange(CHECKED)]
    at = (lut.angle_coordinate(np.cos(theta)), rows / last)
    errors["reflectance of a facet"] = compared(pictures["facet"], lambda p: p.at(*at), wanted)
    if rough is None:
        return errors
    alpha = (rough.alpha_x, rough.alpha_y)
    closure = ClosureLoss(closure_distribution(rough.distribution), alpha, inner_index(response, False))
    turns = generator.uniform(0.0, np.pi / 2, CHECKED)
    sent, returned = np.zeros((CHECKED, 3)), np.zeros(CHECKED)
    for i, (t, turn) in enumerate(zip(theta, turns, strict=True)):
        w = direction(t, turn if len(azimuths(alpha)) > 1 else 0.0)
        sent[i] = _node(rough, int(rows[i])).hemispherical(w)[0]
        returned[i] = closure.kept(w)[0]
    height = np.cos(turns) ** 2 if over_azimuth(rough) else at[1]
    errors["under even light, by angle of view"] = compared(
        pictures["mirror"], lambda p: p.at(at[0], height) * returned[:, None], sent
    )
    return errors


def _node(lobe: Microfacet, row: int) -> Microfacet:
    """Return a varying film at one node of the number."""
    if not lobe.parameters:
        return lobe
    exchange = None if lobe.exchange is None else lobe.exchange[row]
    return dataclasses.replace(lobe, response=at_node(lobe.response, (row,)), exchange=exchange)


def _add_scatter(scatter: Scatter, pictures: dict[str, Picture], closures: list[Closure]) -> None:
    """Add the pictures and closures of scattered light."""
    views = "colour over the angle of view of "
    behind = (None, None) if scatter.behind is None else ("spread-behind", "translucent-behind")
    for count, (alpha, colours) in enumerate(scatter.gloss, 1):
        name = "gloss" if count == 1 else f"gloss-{count}"
        pictures[name] = view_picture(colours, f"{views}the lobe of roughness {alpha:.2g} about the mirror direction")
        closures.append(Closure("glossy", name, alpha=(alpha, alpha)))
    pictures["spread"] = view_picture(scatter.spread, views + "light that leaves on all sides")
    closures.append(Closure("diffuse", "spread", behind[0]))
    if scatter.through is not None and scatter.behind is not None:
        pictures["translucent"] = view_picture(scatter.through, views + "light scattered through")
        pictures["spread-behind"] = view_picture(scatter.behind[0], views + "light that leaves below, from below")
        pictures["translucent-behind"] = view_picture(scatter.behind[1], views + "light through, from below")
        closures.append(Closure("translucent", "translucent", behind[1]))
    if scatter.lobe is not None:
        pictures["lobe"] = scatter.lobe


def view_picture(values: Array, about: str = "") -> Picture:
    """Return the picture of colours `[column, 3]` over the view angle."""
    return Picture(values[None, None], about)


def _scatter_errors(bsdf: Bsdf, scatter: Scatter, to_rgb: Callable[[Array], Array]) -> dict[str, dict[str, float]]:
    """Compare scattered light with nacre under one lamp at direction pairs."""
    theta = np.radians(CHECKED_DEG)
    back = [sum(hemispherical(lobe, w, nodes=PATHS, seed=1)[0] for lobe in bsdf.lobes) for w in direction(theta, 0.0)]
    x = lut.angle_coordinate(np.cos(theta))

    def glossy(alpha: float, colours: Array) -> Array:
        return np.asarray(view_picture(colours).at(x, 0.0 * x) * _returned(alpha, theta)[:, None])

    def even(picture: Picture) -> Array:
        return np.asarray(sum((glossy(*part) for part in scatter.gloss), picture.at(x, 0.0 * x)))

    title = "scattered light under even light, by angle of view"
    errors = {title: compared(view_picture(scatter.spread), even, to_rgb(np.array(back)))}
    if scatter.lobe is not None:
        lowest = float(np.cos(np.radians(STEEPEST_CHECKED_DEG)))
        wi, wo = lobe_pairs(CHECKED_PAIRS, 1, lowest)
        values, _ = evaluate_with_error(bsdf, wi, wo, samples=CHECKED_WALKS, seed=1)
        wanted = np.pi * wi[:, 2:] * to_rgb(np.nan_to_num(values))
        errors["scattered light, lit from one direction"] = compared(
            scatter.lobe, lambda p: np.pi * wi[:, 2:] * lut.lobe_value(p, wi, wo), wanted
        )
    return errors


def compared(picture: Picture, look_up: Callable[[Picture], Array], wanted: Array) -> dict[str, float]:
    """Return mean and largest dE00 of the colours in the EXR and in the PNG."""
    lab = _lab(wanted)
    errors: dict[str, float] = {}
    for ending, stored in (("", picture), ("_png", lut.as_png(picture))):
        difference = np.asarray(delta_e_2000(_lab(look_up(stored)), lab))
        errors |= {f"mean{ending}": float(difference.mean()), f"max{ending}": float(difference.max())}
    return errors


def _lab(rgb: Array) -> Array:
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(rgb)))
