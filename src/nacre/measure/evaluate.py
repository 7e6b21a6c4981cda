"""Values of a Bsdf for direction pairs, from tables or random walks."""

from __future__ import annotations

import functools
import logging
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from nacre.bsdf import Bsdf, Lobe
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.bsdf.texture import refuse_place
from nacre.core.arrays import Array, floats
from nacre.core.errors import UnsupportedError
from nacre.core.memory import check_memory

logger = logging.getLogger("nacre")

BYTES_PER_VALUE = 40  # per pair and wavelength: the sum, the values of one lobe, and intermediate results
UNIT_TOLERANCE = 1e-3  # of a vector's length
DEFAULT_SAMPLES = 4096  # paths per direction pair: about 2 % noise for a broad lobe


class HasBsdf(Protocol):
    """Anything that has a Bsdf: a material, or a family's own object."""

    def bsdf(self) -> Bsdf:
        """Return the arrays."""
        ...


def evaluate_with_error(
    bsdf: Bsdf,
    wi: ArrayLike,
    wo: ArrayLike,
    *,
    uv: ArrayLike | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> tuple[Array, Array | None]:
    """Return the values of `nacre.evaluate` and, if a lobe is stochastic, their standard error (else None).

    Raises:
        UnsupportedError: a stochastic lobe without LLVM on this machine; directions of wrong shape or length; uv that
            is not finite; a formula of x, y or z.
    """
    refuse_place(bsdf, "evaluate")
    wi_array, wo_array = _directions(wi, wo)
    uv_array = None if uv is None else _places(uv, wi_array.shape[:-1])
    pairs, count = wi_array.size // 3, len(bsdf.wavelengths_nm)
    check_memory(float(BYTES_PER_VALUE) * pairs * count, f"{pairs} pairs of directions x {count} wavelengths")
    total = np.zeros((*wi_array.shape[:-1], len(bsdf.wavelengths_nm)))
    variance: Array | None = None
    if any(isinstance(lobe, Microfacet) for lobe in bsdf.lobes):
        warn_of_table(bsdf, _facet_angles(wi_array, wo_array))
    for lobe in bsdf.lobes:
        if lobe.is_stochastic:
            unmasked_lobe, share = unmasked(lobe, uv_array, wi_array.shape[:-1])
            values, error = _walks().evaluate_layered(
                unmasked_lobe, wi_array, wo_array, samples=samples or DEFAULT_SAMPLES, seed=seed, uv=uv_array
            )
            error = error * share[..., None]
            variance = error**2 if variance is None else variance + error**2
            total = total + values * share[..., None]
        else:
            total = total + lobe.evaluate(wi_array, wo_array, uv_array)
    return total, None if variance is None else np.sqrt(variance)


def warn_of_table(bsdf: Bsdf, theta_rad: Array) -> None:
    """Warn of incidences `theta_rad` (> pi/2: from behind) at which the tables over angle are inexact."""
    if found := bsdf.error_ranges(theta_rad):
        _warn_once(str(bsdf.provenance.get("source", "material")), found)


@functools.lru_cache(maxsize=256)  # each message once per process
def _warn_once(source: str, ranges: str) -> None:
    logger.warning("%s: %s; the spectrum of a film's recipe is exact", source, ranges)


def _facet_angles(wi: Array, wo: Array) -> Array:
    """Return the incidence on facets that mirror `wi` to `wo` on the same side, > pi/2 from behind."""
    is_mirrored = wi[..., 2] * wo[..., 2] > 0.0
    wi, wo = wi[is_mirrored], wo[is_mirrored]
    cos = np.sqrt(np.clip(0.5 * (1.0 + np.sum(wi * wo, axis=-1)), 0.0, 1.0))
    return np.asarray(np.arccos(np.where(wi[..., 2] < 0.0, -cos, cos)))


def _directions(wi: ArrayLike, wo: ArrayLike) -> tuple[Array, Array]:
    """Return unit vector pairs of equal shape `[..., 3]`."""
    given = {"wi": floats(wi, "wi"), "wo": floats(wo, "wo")}
    try:
        wi_array, wo_array = np.broadcast_arrays(*given.values())
    except ValueError:
        raise UnsupportedError(f"wi and wo have shapes {[list(a.shape) for a in given.values()]}, no pairs") from None
    if wi_array.shape[-1:] != (3,):
        raise UnsupportedError(f"wi and wo have shape {list(wi_array.shape)}; the last axis must be 3")
    for name, array in given.items():
        if not np.all(np.abs(np.linalg.norm(array, axis=-1) - 1) <= UNIT_TOLERANCE):
            raise UnsupportedError(f"{name} must hold unit vectors; one has another length, or is not finite")
    return wi_array, wo_array


def _places(uv: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return surface coordinates `[..., 2]` for directions of a shape."""
    places = floats(uv, "uv")
    if places.shape[-1:] != (2,) or not np.all(np.isfinite(places)):
        raise UnsupportedError(f"uv must hold pairs of finite numbers, [..., 2]; its shape is {list(places.shape)}")
    try:
        return np.broadcast_to(places, (*shape, 2))
    except ValueError:
        raise UnsupportedError(f"uv has shape {list(places.shape)}, which does not go with {[*shape, 2]}") from None


def hemispherical(
    lobe: Lobe, wi: Array, uv: Array | None = None, nodes: int = 64, seed: int = 0
) -> tuple[Array, Array]:
    """Integrate the non-delta part of a lobe over all exit directions, for light along one `wi[3]`.

    Args:
        nodes: per coordinate; random walks use `nodes`^2 paths.
        seed: of random walks; another seed gives independent noise.

    Returns:
        power `(to the side of wi, to the other side)`, each `[wavelength]`.
    """
    if not lobe.is_stochastic:
        return lobe.hemispherical(wi, uv, nodes)
    unmasked_lobe, share = unmasked(lobe, uv, ())
    reflected, transmitted = _walks().hemispherical_layered(unmasked_lobe, wi, samples=nodes * nodes, seed=seed, uv=uv)
    return reflected * share, transmitted * share


def unmasked(lobe: Lobe, uv: Array | None, shape: tuple[int, ...]) -> tuple[Lobe, Array]:
    """Return the lobe under all masks, and the product of the masks at uv, `shape`.

    A masked random walk runs without its mask and is multiplied by it afterwards.
    """
    share = np.ones(shape)
    while isinstance(lobe, MaskedLobe):
        share = share * lobe.share(uv, shape)
        lobe = lobe.inner
    return lobe, share


def _walks() -> Any:
    """Return the random walk on arrays, which imports Mitsuba.

    Raises:
        UnsupportedError: Mitsuba is missing.
    """
    try:
        from nacre.device.walk import arrays
    except ImportError as error:
        raise UnsupportedError(f"a pearl is evaluated by a random walk that needs mitsuba ({error})") from None
    return arrays
