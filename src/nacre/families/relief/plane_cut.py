"""BRDF on a grid of half-vector sums for all wavelengths, its gradient, and the local response of a tile.

<|A|^2>(u, v) is the power of the diffraction lines smoothed by a Gaussian (physics/relief.md, "From heights to light"):
a product of two small matrices with the array of lines. Height and direction enter the phase only by
kappa = xi / lambda. The power of a line is an entire function of kappa with bandwidth 2 pi h, h the height range:
a few Chebyshev nodes serve all wavelengths and directions.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nacre.core.arrays import Array, barycentric_matrix
from nacre.families.relief.diffraction_orders import (
    LEAST_COSINE,
    Coefficients,
    Coherence,
    LineBasis,
    Prefactor,
    RealArray,
    brdf_factor,
    coefficients,
    difference_cosine,
    height_gradient,
    line_basis,
    outgoing,
    reflection,
)
from nacre.families.relief.surface import Tile


def chebyshev_nodes(low: float, high: float, count: int) -> Array:
    """Return `count` Chebyshev nodes of the first kind on [low, high], descending from high."""
    angles = (2.0 * np.arange(count) + 1.0) * np.pi / (2.0 * count)
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.cos(angles))


def node_count(height_range_nm: float, low: float, high: float, error: float) -> int:
    """Return the node count that interpolates |c|^2 on [low, high] within `error`.

    A line's power is a positive mixture of exp(2 pi i kappa (h - h')), so the fastest one bounds the error: twice the
    tail of its Chebyshev series, with Bessel functions J_k(a) as coefficients, a = pi h (high - low).
    """
    from scipy.special import jv

    argument = math.pi * height_range_nm * (high - low)
    orders = np.arange(1, int(argument) + 60)
    # |T_n - interpolant| <= 2 per order, and each coefficient is 2 |J_k|; the bound applies to the sum of powers
    tail = np.cumsum((4.0 * np.abs(jv(orders, argument)))[::-1])[::-1]
    enough = np.nonzero(tail < error)[0]
    return max(1, int(orders[enough[0]]))


def interpolation_weights(nodes: Array, points: Array) -> Array:
    """Return weights `[node, ...]` that interpolate values at Chebyshev `nodes` to `points` `[...]`."""
    index = np.arange(len(nodes))
    weights = np.where(index % 2 == 0, 1.0, -1.0) * np.sin((2.0 * index + 1.0) * np.pi / (2.0 * len(nodes)))
    matrix = barycentric_matrix(nodes, weights, points.ravel())
    return matrix.T.reshape(-1, *points.shape)


Reflectance = Callable[[Array], Array]
"""Power reflectance `[..., wavelength]` at cosines `[...]`."""

# truncation of the smoothing Gaussian in standard deviations: an error below rounding, or 3e-7 in single precision
REACH = {np.dtype(np.float64): 8.6, np.dtype(np.float32): 5.5}
# reflections up to this size are stored between forward and backward pass, larger ones recomputed
STORED_FIELD_BYTES = 96 << 20


@dataclass(frozen=True)
class CutGeometry:
    """Directions and wavelengths of a plane cut through the BRDF.

    Attributes:
        psi_x, psi_y: lateral components of w_i + w_o; the grid is their product.
        wi: `[incidence, 3]`, unit vectors to the light.
        wavelengths_nm: `[wavelength]`.
    """

    psi_x: Array
    psi_y: Array
    wi: Array
    wavelengths_nm: Array

    @functools.cached_property
    def cos_o(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return cos(theta_o) `[incidence, x, y]` and whether the direction is above the surface."""
        pairs = [outgoing(w, self.psi_x[:, None], self.psi_y[None, :]) for w in self.wi]
        return np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs])

    @functools.cached_property
    def xi(self) -> Array:
        """Normal component of w_i + w_o, `[incidence, x, y]`."""
        return np.asarray(self.wi[:, 2, None, None] + self.cos_o[0])

    @property
    def lateral_max(self) -> float:
        """Largest |psi_x| or |psi_y|."""
        return float(max(np.abs(self.psi_x).max(), np.abs(self.psi_y).max()))

    @functools.cached_property
    def kappa_range(self) -> tuple[float, float]:
        """Smallest and largest xi / lambda among visible directions, 1/nm."""
        xi = self.xi[self.cos_o[1]]
        low, high = (float(xi.min()), float(xi.max())) if xi.size else (1.0, 2.0)
        return low / float(self.wavelengths_nm.max()), high / float(self.wavelengths_nm.min())

    def highest_line(self, period_nm: float, coherence: Coherence, dtype: Any = np.float64) -> int:
        """Return the highest diffraction line that reaches the grid."""
        reach = REACH[np.dtype(dtype)] * coherence.blur
        return int(np.ceil(period_nm * (self.lateral_max + reach) / float(self.wavelengths_nm.min())))


def smoothing_matrix(psi: Array, highest: int, period_nm: float, wavelength_nm: float, blur: float) -> Array:
    """Return K `[direction, line]`, the Gaussian exp(-(psi - m lambda/P)^2 / (2 blur^2))."""
    lines = np.arange(-highest, highest + 1) * (wavelength_nm / period_nm)
    return np.asarray(np.exp(-0.5 * ((psi[:, None] - lines[None, :]) / blur) ** 2))


def window_norm(coherence: Coherence) -> float:
    """Return 4 pi s^2 / lambda^2, the peak of <|A|^2> / lambda^2 for a mirror."""
    return 4.0 * np.pi * coherence.width_in_wavelengths**2


@dataclass(frozen=True)
class CutPlan:
    """Precomputed matrices of a plane cut, independent of the surface.

    Attributes:
        kappas: `[node]`, 1/nm.
        basis: pruned transform.
        smooth_x, smooth_y: `[wavelength, direction, line]`.
        blend: `[node, incidence, wavelength, x, y]`: interpolation weight x BRDF factor x Fresnel.
        workers: threads over the nodes.
    """

    kappas: Array
    basis: LineBasis
    smooth_x: RealArray
    smooth_y: RealArray
    blend: RealArray
    workers: int = 1

    @property
    def dtype(self) -> Any:
        """Working precision."""
        return self.blend.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the result, `[incidence, wavelength, x, y]`."""
        return tuple(self.blend.shape[1:])

    def _share(self, work: Callable[[Sequence[int]], Any]) -> list[Any]:
        """Distribute `work` on the nodes over the workers."""
        count = min(self.workers, len(self.kappas))
        parts = [range(k, len(self.kappas), count) for k in range(count)]
        if count == 1:
            return [work(parts[0])]
        return list(_pool(count).map(work, parts))

    def forward(self, surface: RealArray, keep: bool = False) -> tuple[RealArray, list[Any]]:
        """Return the BRDF `[incidence, wavelength, x, y]` in 1/sr, and the tape for `pullback`.

        Args:
            surface: `[sample, sample]` heights in nm, in the plan's precision.
            keep: store the reflections for the gradient if they fit.
        """
        count, directions, lines = self.smooth_x.shape
        flat_x = self.smooth_x.reshape(count * directions, lines)
        smooth_yt = self.smooth_y.transpose(0, 2, 1)
        keep = keep and surface.nbytes * 2 * len(self.kappas) <= STORED_FIELD_BYTES
        tape: list[Any] = [None] * len(self.kappas)

        def work(nodes: Sequence[int]) -> RealArray:
            total = np.zeros(self.shape, dtype=self.dtype)
            for q in nodes:
                field = reflection(surface, self.kappas[q])
                transform = coefficients(field, self.basis)
                smooth = (flat_x @ transform.power()).reshape(count, directions, lines) @ smooth_yt
                total += self.blend[q] * smooth
                tape[q] = (field if keep else None, transform)
            return total

        return _sum(self._share(work)), tape

    def pullback(self, surface: RealArray, tape: list[Any], cotangent: RealArray) -> RealArray:
        """Return dL/dH `[sample, sample]` for dL/d(slice) = `cotangent`, `[incidence, wavelength, x, y]`."""
        count, directions, lines = self.smooth_x.shape
        flat_xt = self.smooth_x.reshape(count * directions, lines).T

        def work(nodes: Sequence[int]) -> RealArray:
            total = np.zeros_like(surface)
            for q in nodes:
                field, transform = tape[q]
                smooth = (self.blend[q] * cotangent).sum(axis=0)
                power = flat_xt @ (smooth @ self.smooth_y).reshape(count * directions, lines)
                if field is None:
                    field = reflection(surface, self.kappas[q])
                total += height_gradient(field, Coefficients.pullback(transform, power), self.basis, self.kappas[q])
            return total

        return _sum(self._share(work))


@functools.lru_cache(maxsize=4)
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="relief")


def _sum(parts: list[RealArray]) -> RealArray:
    total = parts[0]
    for part in parts[1:]:
        total += part
    return total


def plan_cut(
    geometry: CutGeometry,
    *,
    samples: int,
    period_nm: float,
    height_range_nm: float,
    coherence: Coherence,
    prefactor: Prefactor = "kirchhoff",
    reflectance: Reflectance | None = None,
    node_error: float = 1e-3,
    dtype: Any = np.float64,
    workers: int = 1,
) -> CutPlan:
    """Prepare the evaluation of a plane cut.

    Args:
        geometry: directions and wavelengths.
        samples: surface samples along one tile side.
        period_nm: tile side.
        height_range_nm: largest height difference, which sets the node count.
        coherence: coherence window.
        prefactor: see `brdf_factor`.
        reflectance: Fresnel reflectance of the coating; default: a perfect reflector.
        node_error: interpolation error over kappa, relative to the sum of all line powers.
        dtype: float64 or float32.
        workers: threads.
    """
    low, high = geometry.kappa_range
    kappas = chebyshev_nodes(low, high, node_count(height_range_nm, low, high, node_error))
    wavelengths = geometry.wavelengths_nm
    basis = line_basis(samples, geometry.highest_line(period_nm, coherence, dtype), dtype)
    blur = coherence.blur
    smooth_x, smooth_y = (
        np.stack([smoothing_matrix(psi, basis.highest, period_nm, w, blur) for w in wavelengths]).astype(dtype)
        for psi in (geometry.psi_x, geometry.psi_y)
    )
    cos_o, visible = geometry.cos_o
    u, v = geometry.psi_x[:, None], geometry.psi_y[None, :]
    cos_i = np.maximum(geometry.wi[:, 2], LEAST_COSINE)[:, None, None]
    factor = np.where(visible, brdf_factor(u, v, cos_i, cos_o, prefactor), 0.0) * window_norm(coherence)
    factor = np.repeat(factor[:, None], len(wavelengths), axis=1)
    if reflectance is not None:
        factor *= np.moveaxis(reflectance(difference_cosine(u, v, geometry.xi)), -1, 1)
    blend = np.empty((len(kappas), *factor.shape), dtype=dtype)
    for k, wavelength in enumerate(wavelengths):
        # invisible directions lie outside the nodes' range: their factor is zero and their weight must be finite
        points = np.clip(geometry.xi / wavelength, low, high)
        blend[:, :, k] = interpolation_weights(kappas, points) * factor[:, k]
    return CutPlan(kappas, basis, smooth_x, smooth_y, blend, workers)


def local_response(
    tile: Tile,
    coherence: Coherence,
    wi: Array,
    wo: Array,
    wavelengths_nm: Array,
    samples_per_feature: int,
    prefactor: Prefactor = "kirchhoff",
) -> Array:
    """Return the BRDF at every window position, averaged over exits, `[x, y, wavelength]`, 1/sr, without Fresnel.

    This is the image in a microscope with a small aperture. A_c of the window at c is the reflection, shifted to the
    direction and smoothed; one inverse FFT therefore gives all positions.

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
            # transform of the window, 2 sqrt(pi) s exp(-2 pi^2 s^2 f^2), separable
            gain_x, gain_y = (
                np.exp(-2.0 * (np.pi * width * (lines - direction / wavelength)) ** 2) for direction in (u, v)
            )
            amplitude = scipy.fft.ifft2(spectrum * gain_x[:, None] * gain_y[None, :])
            factor = brdf_factor(np.array(u), np.array(v), np.array(wi[2]), np.array(w[2]), prefactor)
            result[:, :, k] += 4.0 * np.pi * coherence.width_in_wavelengths**2 * factor * np.abs(amplitude) ** 2
    return result / len(wo)
