"""The diffuse BRDF on a dense grid, polarisations kept, one wavelength at a time.

47 wavelengths x 180 x 180 x 361 x 4 are 2.2e9 numbers, 9 GB in single precision: they are handed out a wavelength at a
time in one buffer of 190 MB. Renders need no such table; it is for figures and for other programs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import SingleArray
from nacre.core.jit import compiled
from nacre.families.metasurface.monolayer.diffuse import diffuse_term
from nacre.families.metasurface.monolayer.evaluation import HARMONICS

if TYPE_CHECKING:
    from nacre.families.metasurface.material import Metasurface


@compiled(nogil=True, fastmath=True)
def _fill(coherent, varying, cosines, scale, sines, s, per_step, out):  # type: ignore[no-untyped-def]  # numba
    count, samples, kept = sines.size, cosines.shape[1], cosines.shape[0]
    last = s.size - 1
    factor, row = np.empty(samples, np.float32), np.empty(samples, np.float32)
    for a in range(count):
        for b in range(count):
            square, twice = sines[a] ** 2 + sines[b] ** 2, 2.0 * sines[a] * sines[b]
            for j in range(samples):
                x = per_step * np.sqrt(max(square - twice * cosines[1, j], 0.0))
                n = min(int(x), last - 1)
                factor[j] = 1.0 if x >= last else s[n] + (x - n) * (s[n + 1] - s[n])
            for q in range(2):
                for p in range(2):
                    row[:] = 0.0
                    for k in range(kept):
                        h = np.float32(coherent[a, b, q, p, k] * scale[a, b])
                        for j in range(samples):
                            row[j] += h * cosines[k, j]
                    for j in range(samples):
                        out[q, p, a, b, j] = row[j] * factor[j]
                    if varying.shape[0]:
                        for k in range(kept):
                            h = np.float32(varying[a, b, q, p, k] * scale[a, b])
                            for j in range(samples):
                                out[q, p, a, b, j] += h * cosines[k, j]


def stream_dense(
    material: Metasurface, wavelengths_nm: ArrayLike, theta_rad: ArrayLike, dphi_rad: ArrayLike
) -> Iterator[tuple[float, SingleArray]]:
    """Yield `(wavelength_nm, f[pol_o, pol_i, o, i, dphi])`, f in 1/sr, s before p; light from above, reflected.

    The buffer is filled anew at each step: copy what is to be kept. Values are the model's own, before the table of a
    Bsdf scales what would exceed energy; dphi lies between the in-plane wavevectors, 0 is forward.

    Args:
        material: the metasurface.
        wavelengths_nm: `[wavelength]`.
        theta_rad: `[angle]`, ascending from 0, of light and view alike; below 90 degrees.
        dphi_rad: `[dphi]`.

    Raises:
        MultipoleConvergenceError, MaterialRangeError: see `Metasurface.monolayer`.
    """
    theta = np.asarray(theta_rad, dtype=float)
    phi = np.asarray(dphi_rad, dtype=float)
    edges = np.cos(np.concatenate([[0.0], 0.5 * (theta[1:] + theta[:-1]), [np.pi / 2]]))
    weights = edges[:-1] - edges[1:]
    cos = np.cos(theta)
    cosines = np.cos(np.arange(HARMONICS)[:, None] * phi).astype(np.float32)
    out = np.empty((2, 2, theta.size, theta.size, phi.size), dtype=np.float32)
    s = material.structure.s
    step = float(material.structure.q_per_nm[1] - material.structure.q_per_nm[0])
    wavelengths = np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
    layers, _ = material.layers_at(wavelengths)
    for wavelength in wavelengths:
        layer = layers(float(wavelength))
        term = diffuse_term(layer, [(layer.illuminate(cos), weights)], HARMONICS)
        scale = 1.0 / (cos[:, None] * cos)
        _fill(term.coherent, term.varying, cosines, scale, np.sin(theta), s, layer.surface.wavenumber / step, out)
        yield float(wavelength), out
