"""Reciprocal multiple-scattering compensation of a rough interface, and the loss of single scattering.

Single scattering on the facets loses the light that the masking blocks. Kulla and Conty (2017) restore it as a
product of the losses in the two directions. This module extends their form to transmitting interfaces: light lost
on side a returns to side b in proportion `exchange[a, b]`. Energy is exact without absorption and f(wi, wo)/n_o^2 is
symmetric; absorption follows the mean reflectance spectrum of the facets.

`reciprocal_scaling` scales any reciprocal BSDF to given albedos by one factor for each direction: a symmetric Sinkhorn
iteration (Sinkhorn, Ann. Math. Statist. 35, 876 (1964)), which preserves reciprocity.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.facet_distributions import (
    Roughness,
    exits,
    fresnel,
    masking,
    normal_quadrature,
    smith_masking,
    visible_normals,
)
from nacre.bsdf.lobes.interface import Microfacet, local_azimuth
from nacre.bsdf.response import InterfaceResponse
from nacre.core.arrays import Array, cell, direction, gauss_legendre, node_coordinate, take_uniform
from nacre.core.errors import UnsupportedError

LOSS_NODES = 41  # nodes over sqrt(cos); energy error 3e-4 at alpha 0.1 ... 1
MOST_AZIMUTH_NODES = 49  # nodes over cos^2 azimuth: 4 alpha_x/alpha_y + 1, as the loss varies faster for larger ratios
FACET_NODES = 64  # facet quadrature: energy error 6e-4
FACET_NODES_ANISOTROPIC = 50  # energy error 1e-3; anisotropic roughness needs many more directions
SMALLEST_COSINE = 1e-4


def compensate(lobe: Microfacet) -> Microfacet:
    """Return the rough lobe plus the light scattered between its facets.

    Raises:
        UnsupportedError: the roughness varies over the surface, or the thickness of a transmitting film.
    """
    if lobe.alpha_texture is not None:
        raise UnsupportedError(
            "compensate = true needs one roughness; a roughness texture, a thickness texture on an opaque substrate "
            "or a rotation texture may vary"
        )
    if lobe.transmits and lobe.parameters:
        raise UnsupportedError("compensate = true on a transmitting film needs one thickness; rotation may vary")
    return _two_sides(lobe) if lobe.transmits else _reflecting(lobe)


def _reflecting(lobe: Microfacet) -> Microfacet:
    """Compensate an opaque or undeviating interface: the loss comes from masking, the colour from further bounces."""
    response = lobe.response
    is_lit_inside = bool(np.any(response.reflectance_inside > 0))
    directions, shape = _loss_directions(lobe)
    albedo = _albedo(lobe, directions, None, inside=False)
    loss = np.maximum(0.0, 1.0 - albedo).reshape(1, *shape, 1)
    mean = _mean(loss)[0, 0]
    escaping = 1.0 - mean
    sides = 2 if is_lit_inside else 1
    outside, _, inside, _ = response.hemispherical
    exchange = np.zeros((*outside.shape[:-1], sides, sides, outside.shape[-1]))
    for side, colour in enumerate((outside, inside)[:sides]):
        bounces = np.square(colour) * escaping / (1.0 - colour * (1.0 - escaping))
        exchange[..., side, side, :] = bounces / (np.pi * max(mean, 1e-12))
    return dataclasses.replace(lobe, loss=np.repeat(loss, sides, axis=0), exchange=exchange)


def _two_sides(lobe: Microfacet) -> Microfacet:
    response, eta = lobe.response, lobe.response.eta
    directions, shape = _loss_directions(lobe)
    count = len(response.wavelengths_nm)
    loss = np.stack(
        [
            np.maximum(0.0, 1.0 - _albedo(lobe, directions, _lossless(response), inside)).reshape(*shape, count)
            for inside in (False, True)
        ]
    )
    mean_outside, mean_inside = np.maximum(_mean(loss), 1e-12)
    r_out, t_out, r_in, t_in = response.hemispherical
    sum_out, sum_in = r_out + t_out, r_in + t_in
    # crossing rate between the sides: 1 - ratio is 0 for perfect mirrors, 1 without reflection
    ratio = np.sqrt(r_out * r_in / np.maximum(sum_out * sum_in, 1e-12))
    crossing = (1.0 - ratio) / (np.pi * (mean_outside + eta**2 * mean_inside))
    # lost light returns completely: the sum over sides b of exchange[a, b] pi mean[b] is 1
    exchange = np.empty((2, 2, count))
    exchange[0, 1] = eta**2 * crossing
    exchange[1, 0] = crossing
    exchange[0, 0] = (1.0 - np.pi * mean_inside * exchange[0, 1]) / (np.pi * mean_outside)
    exchange[1, 1] = (1.0 - np.pi * mean_outside * exchange[1, 0]) / (np.pi * mean_inside)
    power_sum = np.sqrt(sum_out * sum_in)
    mean = 0.5 * (mean_outside + mean_inside)
    colour = np.square(power_sum) * (1.0 - mean) / (1.0 - power_sum * mean)
    return dataclasses.replace(lobe, loss=loss, exchange=exchange * colour)


def facet_transmittance(
    response: InterfaceResponse, distribution: str, alpha_x: float, alpha_y: float, nodes: int = 33
) -> Array:
    """Return the transmittance averaged over a direction's visible facets, `[*params, cos, wavelength]`.

    Nodes are uniform in the outside cosine, 0 to 1. For anisotropic roughness the azimuth with the smallest
    transmittance is used, which keeps the sum with the reflection below one.
    """
    azimuths = [0.0] if alpha_x == alpha_y else list(np.linspace(0.0, np.pi / 2, 7))
    cosines = np.maximum(np.linspace(0.0, 1.0, nodes), SMALLEST_COSINE)
    own = response.cos_outside
    spread = np.empty((len(azimuths), nodes, len(own)))
    for i, phi in enumerate(azimuths):
        for j, cos in enumerate(cosines):
            sin = np.sqrt(1.0 - cos * cos)
            w = np.array([sin * np.cos(phi), sin * np.sin(phi), cos])
            m, weight = visible_normals(distribution, w, alpha_x, alpha_y, FACET_NODES)
            # Beckmann's masking fit deviates by up to 0.3 % from one
            weight = weight / max(weight.sum(), 1.0)
            spread[i, j] = _histogram(np.clip(m @ w, 0.0, 1.0), weight, own)
    values = np.einsum("ajk,...kl->a...jl", spread, response.transmittance)
    return np.asarray(values.min(axis=0))


def aligned_transmittance(
    response: InterfaceResponse, distribution: str, alpha_x: float, alpha_y: float, nodes: int = 33
) -> Array:
    """Return `facet_transmittance` of an anisotropic film, `[azimuth, cos, wavelength]`, for light from each azimuth.

    Args:
        response: tables over the azimuth, as of `AlignedSpecular`.
    """
    own, turns = response.cos_outside, len(response.transmittance) - 1
    passed = response.transmittance[:-1].reshape(turns * len(own), -1)
    cosines = np.maximum(np.linspace(0.0, 1.0, nodes), SMALLEST_COSINE)
    spread = np.empty((turns + 1, nodes, turns * len(own)))
    for i, j in np.ndindex(turns, nodes):
        w = direction(np.arccos(cosines[j]), 2.0 * np.pi * i / turns)
        m, weight = visible_normals(distribution, w, alpha_x, alpha_y, FACET_NODES // 2)
        weight = weight / max(weight.sum(), 1.0)
        place = np.mod(local_azimuth(w, m) / (2.0 * np.pi), 1.0) * turns
        low, share = np.floor(place).astype(np.intp), place - np.floor(place)
        cos = np.clip(m @ w, 0.0, 1.0)
        spread[i, j] = sum(
            _histogram(cos, part, own, (low + step) % turns, turns)
            for step, part in ((0, weight * (1.0 - share)), (1, weight * share))
        )
    spread[turns] = spread[0]
    return np.asarray(spread @ passed)


def _loss_directions(lobe: Microfacet) -> tuple[Array, tuple[int, int]]:
    ratio = max(lobe.alpha_x, lobe.alpha_y) / min(lobe.alpha_x, lobe.alpha_y)
    azimuths = 1 if ratio == 1.0 else int(min(4 * np.ceil(ratio) + 1, MOST_AZIMUTH_NODES))
    cos = np.maximum(np.square(np.linspace(0.0, 1.0, LOSS_NODES)), SMALLEST_COSINE)
    t = np.linspace(0.0, 1.0, azimuths) if azimuths > 1 else np.array([0.5])
    cos, t = np.meshgrid(cos, t, indexing="ij")
    sin = np.sqrt(1.0 - cos * cos)
    w = np.stack([sin * np.sqrt(t), sin * np.sqrt(1.0 - t), cos], axis=-1)
    return w.reshape(-1, 3), (LOSS_NODES, azimuths)


def _lossless(response: InterfaceResponse) -> tuple[Array, Array, Array, Array]:
    """Return the four tables scaled to R + T = 1: the remaining loss is geometric."""
    from_outside = np.maximum(response.reflectance + response.transmittance, 1e-12)
    from_inside = np.maximum(response.reflectance_inside + response.transmittance, 1e-12)
    return (
        response.reflectance / from_outside,
        response.transmittance / from_outside,
        response.reflectance_inside / from_inside,
        response.transmittance / from_inside,
    )


def _albedo(
    lobe: Microfacet, directions: Array, tables: tuple[Array, Array, Array, Array] | None, inside: bool
) -> Array:
    """Return the single-bounce directional albedo `[direction, 1 or wavelength]` from one side.

    Args:
        directions: `[direction, 3]`, unit vectors to the light.
        tables: facet R, T from outside and R, T from inside, `[cos, wavelength]`; default: perfectly reflecting facets.
        inside: whether the light comes from inside the medium.
    """
    response = lobe.response
    nodes = FACET_NODES if lobe.alpha_x == lobe.alpha_y else FACET_NODES_ANISOTROPIC
    m, measure = normal_quadrature(lobe.distribution, lobe.alpha_x, lobe.alpha_y, nodes)
    own = response.cos_outside
    rows = []
    for w in directions:
        is_visible = m @ w > 0
        facets, weight = m[is_visible], measure[is_visible]
        w_m = np.clip(facets @ w, 0.0, 1.0)
        weight = weight * w_m / w[2]
        eta = 1.0 if tables is None else (1.0 / response.eta if inside else response.eta)
        back, through = exits(w, facets, eta)
        ways = np.broadcast_to(w, facets.shape)
        returned = weight * masking(lobe.distribution, ways, back, facets, lobe.alpha_x, lobe.alpha_y)
        if tables is None:
            rows.append(np.array([returned.sum()]))
            continue
        passed = weight * masking(lobe.distribution, ways, through, facets, lobe.alpha_x, lobe.alpha_y)
        outer = response.outside_cosine(w_m) if inside else w_m
        # total reflection beyond the critical angle, independent of the table's first node
        beyond = (w_m <= response.cos_critical) if inside else np.zeros(w_m.shape, dtype=bool)
        row = _histogram(outer, np.where(beyond, 0.0, returned), own) @ tables[2 if inside else 0]
        row = row + _histogram(outer, np.where(beyond, 0.0, passed), own) @ tables[3 if inside else 1]
        rows.append(row + returned[beyond].sum())
    return np.array(rows)


def _histogram(cos: Array, weight: Array, nodes: Array, row: NDArray[np.intp] | int = 0, rows: int = 1) -> Array:
    """Return the weights at cosines distributed over nodes by linear interpolation, `[row * node]`."""
    size = len(nodes)
    low, fraction = cell(node_coordinate(nodes, cos), size)
    low, size = low + row * size, rows * size
    counts = np.bincount(low, weight * (1 - fraction), size) + np.bincount(low + 1, weight * fraction, size)
    return np.asarray(counts)


def _mean(loss: Array) -> Array:
    """Return the cosine-weighted hemispherical mean `[side, wavelength]` of tables `[side, s, t, wavelength]`.

    Integrates the linear interpolant itself: the lobe's loss and return then cancel to rounding.
    """
    x, weight = gauss_legendre(256)
    s, weight = 0.5 * (x + 1.0), 0.5 * weight
    at = take_uniform(loss, s, 1)
    # 2 mu dmu = 4 s^3 ds
    along = np.einsum("q,aqtl->atl", 4.0 * weight * s**3, at)
    if loss.shape[2] == 1:
        return np.asarray(along[:, 0])
    phi = (np.arange(256) + 0.5) * (np.pi / 2 / 256)
    return np.asarray(np.mean(take_uniform(along, np.square(np.cos(phi)), 1), axis=1))


NODES = 65  # uniform in sqrt(cos)
FACETS = 48
REFINED, QUANTILES = 16, 257  # integration steps per node, and quantiles of the returning light's direction


def interface_losses(faces: list[Roughness], index: Array, is_open: bool) -> Array | None:
    """Return the interface losses of strata in air, `[interface, side, cos]`, or None without compensation.

    Args:
        faces: the strata's upper interfaces, and the lowest interface.
        index: `[stratum]`.
        is_open: whether the lowest interface borders the ambient, not a base.
    """
    compensated = [face.compensate and face.alpha_x > 0 and (i < len(index) or is_open) for i, face in enumerate(faces)]
    if not any(compensated):
        return None
    n = np.concatenate([[1.0], index, [1.0]])
    tables = [
        interface_loss(face, float(n[i]), float(n[i + 1])) if is_compensated else np.zeros((2, NODES))
        for i, (face, is_compensated) in enumerate(zip(faces, compensated, strict=True))
    ]
    return np.stack(tables)


def returns(loss: Array) -> tuple[Array, Array]:
    """Return the cosine-weighted mean loss `[..., side]` and quantiles of the returning light `[..., side, node]`.

    The quantiles refer to sqrt(cos) with density loss(cos) cos, which makes the return reciprocal.

    Args:
        loss: `[..., side, cos]`, from `interface_losses`.
    """
    nodes = loss.shape[-1]
    fine = np.linspace(0.0, 1.0, REFINED * (nodes - 1) + 1)  # s = sqrt(cos); dcos = 2 s ds
    rows = loss.reshape(-1, nodes)
    density = np.stack([np.interp(fine, np.linspace(0, 1, nodes), row) for row in rows]) * 4 * fine**3
    cumulative = np.concatenate(
        [np.zeros((len(rows), 1)), np.cumsum((density[:, 1:] + density[:, :-1]) / 2, axis=1)], axis=1
    ) * (fine[1] - fine[0])
    mean, u = cumulative[:, -1], np.linspace(0.0, 1.0, QUANTILES)
    quantile = np.zeros((len(rows), QUANTILES))
    for i in np.flatnonzero(mean > 0):
        quantile[i] = np.interp(u, cumulative[i] / mean[i], fine)
    return mean.reshape(loss.shape[:-1]), quantile.reshape(*loss.shape[:-1], QUANTILES)


def interface_loss(face: Roughness, n_above: float, n_below: float) -> Array:
    """Return the light fraction that single scattering loses, `[side, cos]`.

    Side 0 is above. Anisotropic roughness is averaged over the azimuth.
    """
    sides = (n_below / n_above, n_above / n_below)
    return np.stack([np.maximum(1.0 - sum(once(face, eta)), 0.0) for eta in sides])


def once(face: Roughness, eta: float) -> tuple[Array, Array]:
    """Return the fractions that an interface's facets reflect and refract at the first encounter, each `[cos]`.

    Args:
        face: the rough interface.
        eta: index beyond it over the index on the light's side.

    Returns:
        both at cosines uniform in their square root; anisotropic roughness is averaged over the azimuth.
    """
    cosines = np.maximum(np.linspace(0.0, 1.0, NODES) ** 2, SMALLEST_COSINE)
    azimuths = [0.0] if face.alpha_x == face.alpha_y else list(np.linspace(0, np.pi / 2, 5))
    up, down = np.zeros((2, NODES))
    for i, cos in enumerate(cosines):
        sine = np.sqrt(1 - cos**2)
        for azimuth in azimuths:
            v = np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), cos])
            m, weight = visible_normals(face.distribution, v, face.alpha_x, face.alpha_y, FACETS)
            weight = weight / weight.sum()
            for part, light in zip((up, down), _parts(face, v, m, eta), strict=True):
                part[i] += float(np.sum(weight * light)) / len(azimuths)
    return up, down


def _parts(face: Roughness, v: Array, m: Array, eta: float) -> tuple[Array, Array]:
    cos = np.clip(m @ v, 1e-9, 1.0)
    reflectance = fresnel(cos, eta)
    reflected, refracted = exits(v, m, eta)
    up = np.where(reflected[:, 2] > 0, _masking(face, reflected), 0.0)
    down = np.where((refracted[:, 2] < 0) & (reflectance < 1), _masking(face, refracted), 0.0)
    return np.asarray(reflectance * up), np.asarray((1 - reflectance) * down)


def _masking(face: Roughness, w: Array) -> Array:
    length = np.linalg.norm(w, axis=-1, keepdims=True)
    unit = w / np.maximum(length, 1e-12)
    unit = unit * np.where(unit[:, 2:] < 0, -1.0, 1.0)
    return np.asarray(smith_masking(face.distribution, unit, face.alpha_x, face.alpha_y))


BALANCE_TOLERANCE = 1e-13
BALANCE_STEPS = 500


def reciprocal_scaling(kernel: Array, target: Array, weights: Array) -> Array:
    """Find g > 0 with g_i sum_s w_s K[s, i] g_s = t_i: a symmetric Sinkhorn iteration.

    Args:
        kernel: `[direction, direction]`, symmetric, >= 0.
        target: `[direction]`, >= 0; a zero target gives g = 0.
        weights: `[direction]`; directions of weight 0 follow from the others.

    Returns: g, `[direction]`.
    """
    weighted = kernel * weights
    g = np.ones(len(target))
    for _ in range(BALANCE_STEPS):
        updated = np.sqrt(g * target / np.maximum(weighted @ g, 1e-300))
        change = np.max(np.abs(updated - g) / np.maximum(updated, 1e-300))
        g = updated
        if change < BALANCE_TOLERANCE:
            break
    return np.asarray(target / np.maximum(weighted @ g, 1e-300))


def reciprocal_scaling_across(kernel: Array, up: Array, down: Array, w_up: Array, w_down: Array) -> tuple[Array, Array]:
    """Find g_u, g_d between two sides with g_u sum_d w K g_d = t_u for each direction above.

    Args:
        kernel: `[below, above]`.
        up, down: targets t_u, t_d, with equal sums of w t.
        w_up, w_down: weights.
    """
    g_up, g_down = np.ones(len(up)), np.ones(len(down))
    for _ in range(BALANCE_STEPS):
        g_down = down / np.maximum(kernel @ (w_up * g_up), 1e-300)
        updated = up / np.maximum((w_down * g_down) @ kernel, 1e-300)
        change = np.max(np.abs(updated - g_up) / np.maximum(updated, 1e-300))
        g_up = updated
        if change < BALANCE_TOLERANCE:
            break
    return g_up, g_down
