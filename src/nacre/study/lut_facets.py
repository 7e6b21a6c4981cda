"""A film's interface as pictures of colour: by the angle at a facet, and averaged over the facets by the angle of view.

Colours are linear in spectra, and so are all averages here: a film's tables become three channels first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.directions import direction, hemisphere_nodes
from nacre.bsdf.facet_distributions import exits, masking, normal_quadrature
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.uniform import take_uniform
from nacre.errors import UnsupportedError
from nacre.exchange.lut.table import column_angles

COLUMNS = 256
ROUGH_COLUMNS = 91  # of colours that are averaged over facets: they are smooth
FINE = 2049  # cosines between which what a facet reflects is taken as linear
NODES = 64  # of the quadrature over facets, along each of two coordinates
AZIMUTH_ROWS = 9
AZIMUTHS = 6  # over a quarter of a turn, where the facets are not the same all round
STEEPEST = np.radians(89.5)  # no light arrives at 90 degrees
LEAST_SEEN = 1e-4  # share of a closure's facets below which a colour is kept from the angle before
ToRgb = Callable[[Array], Array]


def coloured(response: InterfaceResponse, to_rgb: ToRgb) -> InterfaceResponse:
    """Return an interface whose wavelengths are three channels."""
    return dataclasses.replace(
        response,
        wavelengths_nm=np.array([1.0, 2.0, 3.0]),
        reflectance=to_rgb(response.reflectance),
        transmittance=to_rgb(response.transmittance),
        reflectance_inside=to_rgb(response.reflectance_inside),
        total=to_rgb(response.total),
    )


def at_node(response: InterfaceResponse, node: tuple[int, ...]) -> InterfaceResponse:
    """Return an interface that varies as it is at one node of what varies."""
    return dataclasses.replace(
        response,
        parameters=(),
        reflectance=response.reflectance[node],
        transmittance=response.transmittance[node],
        reflectance_inside=response.reflectance_inside[node],
        total=response.total[node],
    )


def facet_bands(response: InterfaceResponse) -> Array:
    """Return the bands of a facet picture `[band, row, column, 3]` of a coloured interface: one if it is opaque."""
    cos = np.cos(column_angles(COLUMNS))
    bands = [take_uniform(response.reflectance, cos, -2)]
    if response.transmits:
        bands += [take_uniform(getattr(response, name), cos, -2) for name in ("transmittance", "reflectance_inside")]
        beyond = np.linspace(0.0, 1.0, COLUMNS)
        bands.append(take_uniform(response.total, beyond, -2) if response.eta > 1.0 else bands[2])
    return np.stack([band.reshape(-1, COLUMNS, 3) for band in bands])


def sides(response: InterfaceResponse, cos: Array, is_behind: bool) -> tuple[Array, Array]:
    """Return what a coloured interface reflects and passes, each `[row, cos, 3]`, for light on one side of the surface.

    Args:
        cos: `[cos]`, in the light's own medium.
    """
    inside = np.full(cos.shape, is_behind != response.flipped)
    count = len(response.parameters)
    nodes = np.ndindex(response.reflectance.shape[:count])
    found = [at_node(response, node).lookup(cos, inside) for node in nodes]
    return np.stack([reflected for reflected, _ in found]), np.stack([passed for _, passed in found])


@dataclasses.dataclass(frozen=True)
class ViewColours:
    """Colours of closures over the angle of view, `[row, column, 3]` each."""

    reflected: Array
    passed: Array


def smooth_view(response: InterfaceResponse, is_behind: bool) -> ViewColours:
    """Return the colours of a smooth surface, seen from one side.

    Each channel is kept within [0, 1]: engines take no negative ones, and light that is thrown to and fro inside a body
    would grow by what is above 1. What is reflected and passed still adds up where nothing is absorbed.
    """
    return ViewColours(
        *(np.clip(part, 0.0, 1.0) for part in sides(response, np.cos(column_angles(COLUMNS)), is_behind))
    )


def closure_distribution(distribution: str) -> str:
    """Return the distribution that engines have for one of ours."""
    return "beckmann" if distribution == "blinn" else distribution


def rough_view(lobe: Microfacet, is_behind: bool) -> ViewColours:
    """Return the colours by which an engine's rough closure reflects and passes as much light as a rough film.

    Args:
        lobe: the film in three channels.

    At each angle of view: what the film sends out under even light, over what the closure would if it lost nothing but
    what its facets hide (Smith's masking of both directions together, as engines have it). Brushed films have a row for
    each of some azimuths (`over_azimuth`); where a number varies too, the mean over azimuth.
    """
    response = lobe.response
    tables = sides(response, np.linspace(0.0, 1.0, FINE), is_behind)
    facets = normal_quadrature(lobe.distribution, lobe.alpha_x, lobe.alpha_y, NODES)
    eta = inner_index(response, is_behind)
    closure = ClosureLoss(closure_distribution(lobe.distribution), (lobe.alpha_x, lobe.alpha_y), eta)
    between = between_facets(lobe, is_behind)

    def column(turns: Array) -> tuple[Array, Array]:
        found: tuple[list[Array], list[Array]] = ([], [])
        for theta in np.minimum(column_angles(ROUGH_COLUMNS), STEEPEST):
            weights, white = np.zeros((2, FINE)), np.zeros(2)
            extra = np.zeros((2, 1, 3))
            for w in direction(theta, turns):
                weights += _shares(w, lobe, facets, eta)
                white += closure.kept(w)
                extra = extra + between(w)
            for side, table in enumerate(tables):
                total = np.einsum("f,rfc->rc", weights[side], table) + extra[side]
                is_seen = white[side] > LEAST_SEEN * len(turns) or not found[side]
                found[side].append(total / max(white[side], 1e-9) if is_seen else found[side][-1])
        return np.stack(found[0], axis=1), np.stack(found[1], axis=1)

    if not over_azimuth(lobe):
        found = column(azimuths((lobe.alpha_x, lobe.alpha_y)))
        return ViewColours(*(np.maximum(part, 0.0) for part in found))
    rows = [column(np.array([turn])) for turn in np.arccos(np.sqrt(np.linspace(0.0, 1.0, AZIMUTH_ROWS)))]
    return ViewColours(*(np.maximum(np.concatenate([row[side] for row in rows]), 0.0) for side in (0, 1)))


def over_azimuth(lobe: Microfacet) -> bool:
    """Whether the rows of a view picture run over the squared cosine of the azimuth of view against u, from 0 to 1."""
    return lobe.alpha_x != lobe.alpha_y and not lobe.parameters


def inner_index(response: InterfaceResponse, is_behind: bool) -> float:
    """Return the index of the other side over that of the side which light comes from."""
    return response.eta if is_behind == response.flipped else 1.0 / response.eta


def azimuths(alpha: tuple[float, float]) -> Array:
    """Return azimuths whose mean stands for all, in rad: one where the facets are the same all round."""
    if alpha[0] == alpha[1]:
        return np.array([0.0])
    return np.asarray((np.arange(AZIMUTHS) + 0.5) * (0.5 * np.pi / AZIMUTHS))


def _shares(w: Array, lobe: Microfacet, facets: tuple[Array, Array], eta: float) -> Array:
    """Return by which weights facets at each of the fine cosines reflect and pass light, `[2, cos]`."""
    m, measure = facets
    w_m = m @ w
    m, measure, w_m = m[w_m > 0], measure[w_m > 0], w_m[w_m > 0]
    ways: Array = np.broadcast_to(w, m.shape)
    found = np.zeros((2, FINE))
    low = np.minimum((w_m * (FINE - 1)).astype(int), FINE - 2)
    part = w_m * (FINE - 1) - low
    for side, wo in enumerate(exits(w, m, eta)):
        weight = measure * w_m / w[2] * masking(lobe.distribution, ways, wo, m, lobe.alpha_x, lobe.alpha_y)
        found[side] += np.bincount(low, weight * (1 - part), FINE) + np.bincount(low + 1, weight * part, FINE)
    return found


class ClosureLoss:
    """How much light an engine's white rough closure keeps: what its facets do not hide from each other.

    Engines (Cycles, OSL's testrender) take Smith's masking of both directions together, 1 / (1 + Lambda_i + Lambda_o)
    (Heitz 2014, eq. 99); Ashikhmin and Shirley's lobe is that of its source.
    """

    def __init__(self, distribution: str, alpha: tuple[float, float], eta: float = 1.0) -> None:
        self.distribution, self.alpha, self.eta = distribution, alpha, eta
        self.facets = normal_quadrature(distribution, *alpha, NODES)

    def kept(self, w: Array) -> Array:
        """Return the shares that are reflected, and refracted, of light along `w[3]`, z > 0."""
        m, measure = self.facets
        w_m = m @ w
        m, measure, w_m = m[w_m > 0], measure[w_m > 0], w_m[w_m > 0]
        ways = np.broadcast_to(w, m.shape)
        found = []
        for wo in exits(w, m, self.eta):
            if self.distribution == "ashikhmin-shirley":
                seen = masking(self.distribution, ways, wo, m, *self.alpha)
            else:
                is_seen = (np.sum(wo * m, axis=-1) * wo[:, 2] > 0) & (np.abs(wo[:, 2]) > 1e-9)
                seen = np.where(is_seen, 1.0 / (1.0 + self._smith(ways) + self._smith(wo)), 0.0)
            found.append(float(np.sum(measure * w_m / w[2] * seen)))
        return np.array(found)

    def _smith(self, w: Array) -> Array:
        """Return Lambda; Beckmann's by the rational fit of Walter et al. 2007."""
        flat2 = np.square(self.alpha[0] * w[:, 0]) + np.square(self.alpha[1] * w[:, 1])
        tan2 = flat2 / np.maximum(w[:, 2] ** 2, 1e-12)
        if self.distribution == "ggx":
            return np.asarray(0.5 * (np.sqrt(1.0 + tan2) - 1.0))
        a = 1.0 / np.sqrt(np.maximum(tan2, 1e-12))
        return np.where(a < 1.6, (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 * a + 2.181 * a * a), 0.0)


def between_facets(lobe: Microfacet, is_behind: bool) -> Callable[[Array], Array]:
    """Return what leaves after several facets under even light, `[reflected or passed, row, 3]`, as a function of w.

    Raises:
        UnsupportedError: what facets lose is not the same for all wavelengths.
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
