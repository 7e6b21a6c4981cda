"""The response of each spot of a tile, as a microscope with a small aperture sees it.

The window at c gives A_c; over all c that is the reflection, shifted to the wanted direction and smoothed by the
window, so one inverse FFT gives every spot at once. Its mean square is the spectrum of `nacre.families.relief.slice`.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nacre.families.relief.coherence import Coherence
from nacre.families.relief.geometry import Prefactor, brdf_factor
from nacre.families.relief.surface import Array, Tile


def local_response(
    tile: Tile,
    coherence: Coherence,
    wi: Array,
    wo: Array,
    wavelengths_nm: Array,
    samples_per_feature: int,
    prefactor: Prefactor = "kirchhoff",
) -> Array:
    """Return the BRDF of every window position, averaged over exits, `[x, y, wavelength]`, 1/sr, before Fresnel.

    Args:
        wi: `[3]`, to the light.
        wo: `[exit, 3]`, to the viewer.
        wavelengths_nm: `[wavelength]`.
        samples_per_feature: sampling; windows are centred on the samples.
    """
    surface = tile.surface_nm(samples_per_feature)
    samples = surface.shape[0]
    lines = np.fft.fftfreq(samples, 1.0 / samples) / tile.period_nm
    result = np.zeros((samples, samples, len(wavelengths_nm)))
    for k, wavelength in enumerate(wavelengths_nm):
        width = coherence.width_in_wavelengths * wavelength
        for w in wo:
            u, v = float(wi[0] + w[0]), float(wi[1] + w[1])
            xi = float(wi[2] + w[2])
            spectrum: NDArray[np.complex128] = scipy.fft.fft2(np.exp(-2j * np.pi * xi / wavelength * surface))
            # the window's own transform, 2 sqrt(pi) s exp(-2 pi^2 s^2 f^2), separable
            gain_x, gain_y = (
                np.exp(-2.0 * (np.pi * width * (lines - direction / wavelength)) ** 2) for direction in (u, v)
            )
            amplitude = scipy.fft.ifft2(spectrum * gain_x[:, None] * gain_y[None, :])
            factor = brdf_factor(np.array(u), np.array(v), np.array(wi[2]), np.array(w[2]), prefactor)
            result[:, :, k] += 4.0 * np.pi * coherence.width_in_wavelengths**2 * factor * np.abs(amplitude) ** 2
    return result / len(wo)
