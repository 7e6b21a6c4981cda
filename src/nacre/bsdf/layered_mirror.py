"""What a layered lobe reflects and passes as mirrors do: light that meets nothing but smooth interfaces.

Powers add: a stratum is too thick to interfere. A rough interface or a base that scatters ends the chain; light
that scatters on the way is lost to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from nacre.bsdf.layered import Layered

Array = NDArray[np.float64]
MATCHED = 1e-4  # resins closer in index than this have no interface between them, for mirrors and for walks


def mirror_powers(lobe: Layered, cos_i: Array, uv: Array | None) -> tuple[Array, Array]:
    """Return reflectance and transmittance of mirrors, `[n, wavelength]`, for light in the plane y = 0.

    Args:
        lobe: the strata.
        cos_i: `[n]`, below 0 for light from behind (none is sent back then, if there is a base).
        uv: `[n, 2]` or None, of a base that varies.
    """
    count, bands = lobe.strata, len(lobe.wavelengths_nm)
    cos = np.clip(np.abs(cos_i), 1e-9, 1.0)
    n = np.concatenate([[1.0], lobe.index, [1.0]])
    inside = np.sqrt(np.maximum(0.0, 1.0 - (1.0 - cos[:, None] ** 2) / n**2))  # [n, medium]
    below = cos_i < 0
    total_r, total_t = np.zeros((2, len(cos), bands))
    for from_below in (False, True):
        lanes = below == from_below
        if not lanes.any() or (from_below and not lobe.transmits):
            continue
        order = list(range(count))[:: -1 if from_below else 1]
        # from the far end: reflectance and transmittance of all that lies beyond
        far = count + 1 if not from_below else 0
        beyond_r, beyond_t = _last(lobe, inside[lanes], n, order[-1], far, None if uv is None else uv[lanes])
        for s in reversed(order):
            medium, near = s + 1, (s + 2 if from_below else s)
            fall = np.exp(-_depth(lobe, s, inside[lanes, medium], from_below))
            rise = np.exp(-_depth(lobe, s, inside[lanes, medium], not from_below))
            r, t = _interface(lobe, inside[lanes], n, near, medium)
            r, t = r[:, None], t[:, None]
            echo = 1.0 / (1.0 - r * fall * rise * beyond_r)
            # power transmittance of a bare interface is the same both ways
            beyond_r, beyond_t = r + t * t * fall * rise * beyond_r * echo, t * fall * beyond_t * echo
        total_r[lanes], total_t[lanes] = beyond_r, beyond_t
    return total_r, total_t


def _last(lobe: Layered, inside: Array, n: Array, stratum: int, far: int, uv: Array | None) -> tuple[Array, Array]:
    """Return what the far end of the last stratum reflects and passes, `[n, wavelength]`."""
    lanes, bands = len(inside), len(lobe.wavelengths_nm)
    cos = inside[:, stratum + 1]
    if lobe.transmits:
        r, t = _interface(lobe, inside, n, stratum + 1, far)
        return np.repeat(r[:, None], bands, axis=1), np.repeat(t[:, None], bands, axis=1)
    reflect = np.zeros((lanes, bands))
    if lobe.base == "specular" and np.all(lobe.alpha[-1] == 0):
        table = lobe.base_reflectance
        nodes = np.linspace(0.0, 1.0, len(table))
        reflect = np.stack([np.interp(cos, nodes, table[:, k]) for k in range(bands)], axis=1)
    for inner in lobe.base_lobes:
        found = inner.specular(cos, uv).reflectance
        reflect += np.stack([np.interp(lobe.wavelengths_nm, inner.wavelengths_nm, row) for row in found])
    return reflect, np.zeros((lanes, bands))


def _interface(lobe: Layered, inside: Array, n: Array, first: int, second: int) -> tuple[Array, Array]:
    """Return the mirror reflectance and transmittance, `[n]`, between two neighbouring media; a rough one has none."""
    from nacre.bsdf.layered import fresnel

    contrast = abs(n[first] - n[second]) > MATCHED
    if contrast and np.any(lobe.alpha[min(first, second)] > 0):
        return np.zeros(len(inside)), np.zeros(len(inside))
    r = fresnel(inside[:, first], n[second] / n[first]) if contrast else np.zeros(len(inside))
    return r, 1.0 - r


def _depth(lobe: Layered, stratum: int, cos: Array, upward: bool) -> Array:
    """Return the optical thickness of a stratum along its ray, `[n, wavelength]`."""
    bands = len(lobe.wavelengths_nm)
    depth = np.zeros((len(cos), bands))
    ray = np.stack([np.sqrt(1.0 - cos**2), np.zeros(len(cos)), cos if upward else -cos], axis=-1)
    for k in np.flatnonzero(lobe.flake_stratum == stratum):
        local = ray @ lobe.flake_frame[k]
        area = lobe.flake_number[k] * np.linalg.norm(local * lobe.flake_axes[k], axis=-1)
        azimuths, elevations, _ = lobe.flake_extinction[k].shape
        turn = np.arctan2(np.abs(local[:, 1]), np.maximum(np.abs(local[:, 0]), 1e-12)) * (2 / np.pi * (azimuths - 1))
        place = np.sqrt(np.clip(np.abs(local[:, 2]), 0.0, 1.0)) * (elevations - 1)
        a, e = np.minimum(turn.astype(int), max(azimuths - 2, 0)), np.minimum(place.astype(int), elevations - 2)
        table, b = lobe.flake_extinction[k], np.minimum(a + 1, azimuths - 1)
        fa, fe = (turn - a)[:, None], (place - e)[:, None]
        low = table[a, e] * (1 - fa) + table[b, e] * fa
        high = table[a, e + 1] * (1 - fa) + table[b, e + 1] * fa
        depth += area[:, None] * (low * (1 - fe) + high * fe)
    if lobe.dye is not None:
        depth += lobe.dye[stratum, :, 0]
    return depth / np.maximum(cos, 1e-9)[:, None]
