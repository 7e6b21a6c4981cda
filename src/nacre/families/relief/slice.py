"""The BRDF on a grid of half-vector sums, for all wavelengths at once, and its gradient.

<|A|^2>(u, v) is the line powers smoothed by a Gaussian (physics/relief.md, section 3), a product of two small
matrices with the array of lines. One set of kappa nodes serves every wavelength, direction and incidence.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.families.relief.coherence import Coherence
from nacre.families.relief.geometry import LEAST_COSINE, Prefactor, brdf_factor, difference_cosine, outgoing
from nacre.families.relief.kappa_nodes import chebyshev_nodes, interpolation_weights, node_count
from nacre.families.relief.lines import (
    Coefficients,
    LineBasis,
    RealArray,
    coefficients,
    height_gradient,
    line_basis,
    reflection,
)

Reflectance = Callable[[Array], Array]
"""Power reflectance `[..., wavelength]` at cosines `[...]`."""

# where the smoothing Gaussian is cut, in standard deviations: below rounding in double, 3e-7 in single precision
REACH = {np.dtype(np.float64): 8.6, np.dtype(np.float32): 5.5}
# reflections are kept between the forward and the backward pass up to this size, recomputed beyond
KEPT_FIELD_BYTES = 96 << 20


@dataclass(frozen=True)
class SliceGeometry:
    """Which part of the BRDF is wanted.

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
class SlicePlan:
    """All that a slice needs beside the surface: bases, smoothing matrices, node weights.

    Attributes:
        kappas: `[node]`, 1/nm.
        basis: rows of the pruned transform.
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
        """Shape of the slice, `[incidence, wavelength, x, y]`."""
        return tuple(self.blend.shape[1:])

    def _share(self, work: Callable[[Sequence[int]], Any]) -> list[Any]:
        """Run `work` on the nodes, split over the workers."""
        count = min(self.workers, len(self.kappas))
        parts = [range(k, len(self.kappas), count) for k in range(count)]
        if count == 1:
            return [work(parts[0])]
        return list(_pool(count).map(work, parts))

    def forward(self, surface: RealArray, keep: bool = False) -> tuple[RealArray, list[Any]]:
        """Return the BRDF `[incidence, wavelength, x, y]` in 1/sr, and what `pullback` needs.

        Args:
            surface: `[sample, sample]` heights in nm, in the plan's precision.
            keep: hold the reflections for the gradient, if they fit.
        """
        count, directions, lines = self.smooth_x.shape
        flat_x = self.smooth_x.reshape(count * directions, lines)
        smooth_yt = self.smooth_y.transpose(0, 2, 1)
        keep = keep and surface.nbytes * 2 * len(self.kappas) <= KEPT_FIELD_BYTES
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


def plan_slice(
    geometry: SliceGeometry,
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
) -> SlicePlan:
    """Prepare the evaluation of a slice.

    Args:
        geometry: the directions and wavelengths.
        samples: samples of the surface along one side of the tile.
        period_nm: side of the tile.
        height_range_nm: largest height difference that will be asked for; sets the number of nodes.
        coherence: the coherence window.
        prefactor: see `brdf_factor`.
        reflectance: Fresnel power reflectance of the coating; None for a perfect reflector.
        node_error: error of the interpolation over kappa, relative to the sum of all line powers.
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
        # invisible directions lie outside the nodes' range; their factor is zero, their weight must stay finite
        points = np.clip(geometry.xi / wavelength, low, high)
        blend[:, :, k] = interpolation_weights(kappas, points) * factor[:, k]
    return SlicePlan(kappas, basis, smooth_x, smooth_y, blend, workers)
