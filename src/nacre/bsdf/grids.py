"""Hemispherical quadrature, and linear interpolation on uniform or irregular nodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nacre.core.arrays import Array
from nacre.core.directions import direction as direction
from nacre.core.interpolation import cell as cell
from nacre.core.interpolation import interpolate as interpolate
from nacre.core.interpolation import node_coordinate as node_coordinate
from nacre.core.interpolation import take_at as take_at
from nacre.core.interpolation import take_uniform as take_uniform
from nacre.core.quadrature import gauss_legendre


def hemisphere_nodes(nodes: int = 64) -> tuple[Array, Array]:
    """Return upper-hemisphere directions and weights cos(theta) d(omega): `[nodes*nodes, 3]`, `[nodes*nodes]`.

    Gauss-Legendre in sin^2(theta), where the cosine-weighted measure is uniform; the weights sum to pi.
    """
    x, weight = gauss_legendre(nodes)
    sin2 = 0.5 * (x + 1.0)
    phi = (np.arange(nodes) + 0.5) * (2.0 * np.pi / nodes)
    sin2, phi = np.meshgrid(sin2, phi, indexing="ij")
    wo = np.stack([np.sqrt(sin2) * np.cos(phi), np.sqrt(sin2) * np.sin(phi), np.sqrt(1.0 - sin2)], axis=-1)
    return wo.reshape(-1, 3), np.repeat(0.5 * weight * np.pi / nodes, nodes)


def product_rule(value: Callable[[Array], Array], wi: Array, nodes: int, transmits: bool) -> tuple[Array, Array]:
    """Integrate `value(wo)` `[exit, wavelength]` times the cosine over both hemispheres.

    Returns:
        `(same side as wi, other side)`, each `[wavelength]`.
    """
    wo, weight = hemisphere_nodes(nodes)
    side = np.array([1.0, 1.0, 1.0 if wi[2] >= 0 else -1.0])
    same = weight @ value(wo * side)
    other = weight @ value(wo * side * np.array([1.0, 1.0, -1.0])) if transmits else np.zeros_like(same)
    return same, other
