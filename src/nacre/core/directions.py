"""Unit vectors from polar, half and difference angles."""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import Array


def direction(theta_rad: Array | float, phi_rad: Array | float = 0.0) -> Array:
    """Return unit vectors `[..., 3]` at polar angle `theta_rad` from +z and azimuth `phi_rad` from +x."""
    theta, phi = np.broadcast_arrays(np.asarray(theta_rad, dtype=float), np.asarray(phi_rad, dtype=float))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def from_half_difference(theta_half: Array, theta_diff: Array, phi_diff: Array) -> tuple[Array, Array]:
    """Return (wi, wo) from half and difference angles, with the half vector in the plane phi = 0."""
    sin_d, cos_d = np.sin(theta_diff), np.cos(theta_diff)
    d = np.stack([sin_d * np.cos(phi_diff), sin_d * np.sin(phi_diff), cos_d], axis=-1)
    sin_h, cos_h = np.sin(theta_half), np.cos(theta_half)
    wi = np.stack([cos_h * d[..., 0] + sin_h * d[..., 2], d[..., 1], -sin_h * d[..., 0] + cos_h * d[..., 2]], axis=-1)
    h = np.stack([sin_h, np.zeros_like(sin_h), cos_h], axis=-1)
    return wi, 2 * np.sum(wi * h, axis=-1, keepdims=True) * h - wi


def angles_deg(vectors: Array) -> Array:
    """Return polar angle and azimuth (0 to 360) in degrees, `[..., 2]`, of unit vectors `[..., 3]`."""
    theta = np.degrees(np.arctan2(np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2]))
    return np.stack([theta, np.degrees(np.arctan2(vectors[..., 1], vectors[..., 0])) % 360.0], axis=-1)
