"""What the ladder adds to the diffuse light of a monolayer, between all pairs of directions.

It is smooth in the angles, so it is solved for a few directions of each side and interpolated.
"""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.angle_nodes import node_sines, node_weights
from nacre.families.metasurface.angular import adjoint, mirrored
from nacre.families.metasurface.ladder import order_of
from nacre.families.metasurface.monolayer import Lit, Monolayer
from nacre.families.metasurface.neighbours import multipole_index, with_negative_orders

NODES = (10, 6, 7)  # above, below inside and beyond the critical angle


def emission_added(added: ComplexArray) -> ComplexArray:
    """Return what neighbours add to the emission of a particle, `[m, pol, n, angle]`, of what they add to its light.

    What leaves takes the way in backwards: waves up for waves down, B for its adjoint, and no factor 4.
    """
    ones = np.ones((*added.shape[:3], 1), dtype=complex)
    return np.asarray(added * mirrored(adjoint(ones)) / 4.0)


def passed_on(layer: Monolayer, sides: list[tuple[Lit, Array]], count: int) -> Array:
    """Return the power that neighbours pass on, a particle, `[s, i, pol_s, pol_i, k]`, nm^2/sr, symmetric.

    Args:
        sides: the directions, above first.
        count: harmonics over dphi, k < count.
    """
    index, modes = layer.surface.index_below, layer.modes
    order = order_of(modes.step)
    lit, kappa, spread = [], [], []
    for side, _ in sides:
        first = side.directions[0]
        sines = np.concatenate(node_sines(index, first.below, NODES))
        lit.append(layer.light(np.sqrt((1.0 - sines) * (1.0 + sines)), first.below, sines, at_once=True))
        kappa.append(lit[-1].directions[0].inner)
        # towards grazing it falls as the cosine, which is taken out so that a few nodes do
        spread.append(first.cosines[:, None] * node_weights(first, index, NODES) / lit[-1].cosines)
    met = np.concatenate([_lights([_low(b, order) for b in one.response]) for one in lit], axis=2)
    leaving = np.concatenate([_low(_leaving(layer, one), order) for one in lit], axis=-1)
    views = np.concatenate(kappa)
    found = modes.passed_on(met, np.concatenate([np.tile(part, 2) for part in kappa]), leaving, views, count)
    # [view, pol, light, k] -> [pol, view, pol, light's view, k]
    start, columns = 0, []
    for part in kappa:
        columns.append(found[:, :, start : start + 2 * part.size].reshape(views.size, 2, 2, part.size, count))
        start += 2 * part.size
    power = np.concatenate(columns, axis=3).transpose(0, 3, 1, 2, 4)  # s, i, pol_s, pol_i, k
    power = 0.5 * (power + power.transpose(1, 0, 3, 2, 4))  # the modes' nodes and single precision leave a little
    whole = np.zeros((sum(part.shape[0] for part in spread), views.size))
    row = column = 0
    for each in spread:
        whole[row : row + each.shape[0], column : column + each.shape[1]] = each
        row, column = row + each.shape[0], column + each.shape[1]
    half = np.tensordot(whole, power, 1)
    return np.asarray(np.moveaxis(np.tensordot(whole, half, (1, 1)), 0, 1))


def _leaving(layer: Monolayer, lit: Lit) -> ComplexArray:
    """Return u D, averaged over the kinds, `[m, pol, n, angle]`."""
    assert lit.added is not None  # of a mean field
    emission = sum(share * d.emission for share, d in zip(layer.shares, lit.directions))
    return np.asarray(emission + emission_added(lit.added))


def _low(vectors: ComplexArray, order: int) -> ComplexArray:
    """Return `[m >= 0, pol, (tau, l), angle]` over all m up to an order, `[pol, n, angle]`."""
    lmax = vectors.shape[2] // 2
    rows = (np.arange(2)[:, None] * lmax + np.arange(order)).ravel()
    return with_negative_orders(vectors[: order + 1, :, rows], multipole_index(order))


def _lights(parts: list[ComplexArray]) -> ComplexArray:
    """Return `[pol, n, angle]` of each kind as `[kind, n, light]`, polarisation before angle."""
    both = np.stack(parts).swapaxes(1, 2)
    return np.asarray(both.reshape(*both.shape[:2], -1))
