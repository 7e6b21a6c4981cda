"""Values of a Bsdf for direction pairs, from tables or random walks."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from nacre.bsdf import Bsdf, Lobe
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.lobes.interface import Diffuse, Microfacet
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.lobes.orders import OrdersLobe, narrowest_nm
from nacre.bsdf.texture import refuse_place
from nacre.core.arrays import Array, direction, floats
from nacre.core.errors import UnsupportedError, warn_once
from nacre.core.machine import check_memory
from nacre.light.tristimulus import spectrum_to_xyz, spline_matrix

BYTES_PER_VALUE = 40  # per pair and wavelength: the sum, the values of one lobe, and intermediate results
UNIT_TOLERANCE = 1e-3  # deviation of a vector's length from 1
LEAST_STEP_NM = 0.25  # smallest wavelength step for colours
PAIRS_AT_ONCE = 2048
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
    _warn_of_lines(bsdf)
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


def evaluate_for_colours(
    bsdf: Bsdf, wi: Array, wo: Array, *, samples: int | None = None, seed: int = 0
) -> tuple[Array, Array | None, Array]:
    """Return `evaluate_with_error`, and its wavelengths `[wavelength]`, close enough for the lines of orders.

    At fixed directions each order of a grating is a line of a few nanometres, narrower than the steps of most grids.
    Other lobes are interpolated by splines.

    Args:
        wi, wo: `[pair, 3]`.
    """
    own = np.asarray(bsdf.wavelengths_nm)
    lobes = [(each, *unmasked(each, None, (1,))) for each in bsdf.lobes]
    orders = [(lobe, share) for _, lobe, share in lobes if isinstance(lobe, OrdersLobe)]
    grid = line_wavelengths(own, narrowest_nm(bsdf.lobes))
    if len(grid) == len(own):
        return *evaluate_with_error(bsdf, wi, wo, samples=samples, seed=seed), own
    rest = tuple(each for each, lobe, _ in lobes if not isinstance(lobe, OrdersLobe))
    total = np.zeros((len(wi), len(grid)))
    error: Array | None = None
    if rest:
        values, error = evaluate_with_error(dataclasses.replace(bsdf, lobes=rest), wi, wo, samples=samples, seed=seed)
        total = values @ spline_matrix(own, grid).T
    for lobe, share in orders:
        total = total + lobe.evaluate_on(grid, wi, wo) * share[..., None]
    return total, error, grid


def tristimulus_of_pairs(bsdf: Bsdf, wi: Array, wo: Array, illuminant: str) -> Array:
    """Return XYZ `[pair, 3]` of values under a lamp (2 degree observer), integrated as in `evaluate_for_colours`.

    Args:
        bsdf: without random walks.
        wi, wo: `[pair, 3]`.
    """
    if narrowest_nm(bsdf.lobes) == np.inf:
        return spectrum_to_xyz(np.maximum(bsdf.evaluate(wi, wo), 0.0), bsdf.wavelengths_nm, illuminant)
    columns = []
    for start in range(0, len(wi), PAIRS_AT_ONCE):
        some = slice(start, start + PAIRS_AT_ONCE)
        values, _, grid = evaluate_for_colours(bsdf, wi[some], wo[some])
        columns.append(spectrum_to_xyz(np.maximum(values, 0.0), grid, illuminant))
    return np.concatenate(columns)


def evaluate_at_own(bsdf: Bsdf, wi: Array, wo: Array, *, samples: int | None = None, seed: int = 0) -> Array:
    """Return values `[..., wavelength]` at the wavelengths of a Bsdf, see `evaluate_for_colours`, `on_wavelengths`."""
    pairs = wi.reshape(-1, 3), wo.reshape(-1, 3)
    values, _, grid = evaluate_for_colours(bsdf, *pairs, samples=samples, seed=seed)
    return on_wavelengths(values, grid, np.asarray(bsdf.wavelengths_nm)).reshape(*wi.shape[:-1], -1)


def line_wavelengths(wavelengths_nm: Array, line_nm: float) -> Array:
    """Return wavelengths with further ones between them, half a standard deviation `line_nm` apart or closer."""
    counts = np.ceil(np.diff(wavelengths_nm) / max(0.5 * line_nm, LEAST_STEP_NM)).astype(int)
    if counts.max(initial=1) == 1:
        return wavelengths_nm
    return np.interp(np.arange(counts.sum() + 1), np.concatenate([[0], np.cumsum(counts)]), wavelengths_nm)


def on_wavelengths(values: Array, own_nm: Array, wavelengths_nm: Array) -> Array:
    """Return spectra `[..., wavelength]` at `own_nm` on fewer wavelengths, by a least-squares fit with splines.

    Colours agree, because weights over wavelength vary little within a step.
    """
    if len(own_nm) == len(wavelengths_nm):
        return values
    weights = np.sqrt(np.gradient(own_nm))
    matrix = spline_matrix(wavelengths_nm, own_nm) * weights[:, None]
    sampled: Array = values * weights @ np.linalg.pinv(matrix).T
    return sampled


def _warn_of_lines(bsdf: Bsdf) -> None:
    """Warn that lines lie between the wavelengths."""
    line, steps = narrowest_nm(bsdf.lobes), np.diff(bsdf.wavelengths_nm)
    if steps.max(initial=0.0) > max(line, LEAST_STEP_NM):
        message = (
            f"at fixed directions its orders are lines {line:.2g} nm wide, between wavelengths {steps.max():g} nm apart"
        )
        warn_once(str(bsdf.provenance.get("source", "material")), f"{message}: these values are samples, not means")


def warn_of_table(bsdf: Bsdf, theta_rad: Array) -> None:
    """Warn of incidences `theta_rad` (> pi/2: from behind) at which the tables over angle are inexact."""
    if ranges := bsdf.error_ranges(theta_rad):
        source = str(bsdf.provenance.get("source", "material"))
        warn_once(source, f"{ranges}; the spectrum of a film's recipe is exact")


def _facet_angles(wi: Array, wo: Array) -> Array:
    """Return the incidence on facets that mirror `wi` to `wo` on the same side, > pi/2 from behind."""
    is_mirrored = wi[..., 2] * wo[..., 2] > 0.0
    wi, wo = wi[is_mirrored], wo[is_mirrored]
    cos = np.sqrt(np.clip(0.5 * (1.0 + np.sum(wi * wo, axis=-1)), 0.0, 1.0))
    return np.asarray(np.arccos(np.where(wi[..., 2] < 0.0, -cos, cos)))


def _directions(wi: ArrayLike, wo: ArrayLike) -> tuple[Array, Array]:
    """Return unit vector pairs of equal shape `[..., 3]`."""
    pairs = {"wi": floats(wi, "wi"), "wo": floats(wo, "wo")}
    try:
        wi_array, wo_array = np.broadcast_arrays(*pairs.values())
    except ValueError:
        raise UnsupportedError(f"wi and wo have shapes {[list(a.shape) for a in pairs.values()]}, no pairs") from None
    if wi_array.shape[-1:] != (3,):
        raise UnsupportedError(f"wi and wo have shape {list(wi_array.shape)}; the last axis must be 3")
    for name, array in pairs.items():
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
        seed: random-walk seed; another seed gives independent noise.

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


# Total reflectance and transmittance of a Bsdf.


def directional_hemispherical(bsdf: Bsdf, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
    """Return the power that leaves on the side of `wi` and on the other side, delta parts included.

    By reciprocity their sum is the surface's brightness in a white furnace, seen from `wi`.

    Args:
        wi: `[..., 3]`, unit vectors towards the light.
        nodes: quadrature nodes per coordinate.

    Returns:
        `(reflected, transmitted)`, each `[..., wavelength]`.
    """
    wi = np.asarray(wi, dtype=float)
    flat = wi.reshape(-1, 3)
    back, through = [], []
    for w in flat:
        delta = bsdf.specular(float(np.arccos(np.clip(w[2], -1.0, 1.0))), uv, float(np.arctan2(w[1], w[0])))
        sums = [hemispherical(lobe, w, uv, nodes) for lobe in bsdf.lobes if not lobe.is_delta]
        back.append(delta.reflectance + sum(s[0] for s in sums))
        through.append(delta.transmittance + sum(s[1] for s in sums))
    shape = (*wi.shape[:-1], len(bsdf.wavelengths_nm))
    return np.reshape(back, shape), np.reshape(through, shape)


def bsdf_spectrum(
    bsdf: Bsdf, theta_rad: Array, uv: Array | None = None, seed: int = 0, *, diffuse: bool = True, nodes: int = 64
) -> Spectrum:
    """Return the spectra of a Bsdf: delta parts (rough films: as smooth) and integrated diffuse parts.

    A base under a rough film has its values under the smooth film, for consistency. Light is incident in the plane
    y = 0.

    Args:
        theta_rad: `[angle]`, in the ambient.
        seed: random-walk seed; another seed gives independent noise.
        diffuse: whether diffuse parts are computed, by integration over all exit directions.
        nodes: quadrature nodes per coordinate; a random walk uses `nodes`^2 paths.
    """
    theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
    warn_of_table(bsdf, theta)
    delta = bsdf.specular(theta, uv)
    reflected, transmitted = delta.reflectance, delta.transmittance
    rest: list[Lobe] = []
    bases: list[Diffuse] = []
    for lobe in bsdf.lobes:
        if isinstance(lobe, Microfacet):
            w = lobe.local_frame(direction(theta), uv)
            more = lobe.smooth_powers(w, uv)
            reflected, transmitted = reflected + more[0], transmitted + more[1]
        elif isinstance(lobe, Diffuse) and lobe.under_smooth is not None:
            bases.append(lobe)
        elif not lobe.is_delta:
            rest.append(lobe)
    spread = None
    if rest and diffuse:
        # at exactly 90 degrees no light reaches the surface; slightly below, the integrals have their limit
        directions = direction(np.minimum(theta, np.radians(89.99)))
        sums = [[hemispherical(lobe, w, uv, nodes, seed) for lobe in rest] for w in directions]
        spread = np.array([[sum(part[side] for part in parts) for parts in sums] for side in (0, 1)])
    for base in bases if diffuse else ():
        spread = np.zeros((2, *reflected.shape)) if spread is None else spread
        spread[0] += base.smooth_albedo(np.cos(theta), uv)
    # a random walk is not a delta lobe, but has mirror reflection at smooth interfaces
    has_delta = len(rest) < len(bsdf.lobes) or bool(np.any(reflected > 0))
    return Spectrum(
        bsdf.wavelengths_nm,
        np.degrees(theta),
        reflected if has_delta else None,
        transmitted if has_delta and bool(np.any(transmitted > 0)) else None,
        None if spread is None else spread[0],
        spread[1] if spread is not None and any(lobe.transmits for lobe in rest) else None,
    )


# Quantities of Mueller matrices: ellipsometric angles, circular dichroism and selective reflection.

LEAST_POWER = 1e-12
CROSSED_POSITIONS = 180
MOST_RETARDANCE_NM, RETARDER_ERROR = 20_000.0, 0.1  # the error: rms in cos(2 pi retardance / wavelength)
LEAST_DISSYMMETRY = 0.05  # minimum at the peak of a selective reflection


@dataclass(frozen=True)
class CircularReflection:
    """Reflection of circular light, each `[..., wavelength]`.

    Attributes:
        right, left: reflectance of right and left circular light.
        dissymmetry: g = 2 (right - left) / (right + left), from -2 to 2; 0 where nothing is reflected.
        preserved: share of the stronger hand's reflected light that preserves its hand, as in a cholesteric; a mirror
            reverses it.
    """

    right: Array
    left: Array
    dissymmetry: Array
    preserved: Array


@dataclass(frozen=True)
class SelectiveBand:
    """Band in which one handedness is reflected.

    Attributes:
        hand: "right" or "left".
        peak_nm: wavelength of the largest difference.
        low_nm, high_nm: where the difference is half of the largest.
        reflectance: reflectance for that hand at the peak.
        other_reflectance: reflectance for the other hand at the peak.
        dissymmetry: |g| at the peak.
    """

    hand: str
    peak_nm: float
    low_nm: float
    high_nm: float
    reflectance: float
    other_reflectance: float
    dissymmetry: float


def ellipsometric_angles(mueller: Array) -> tuple[Array, Array]:
    """Return Psi in [0, 90] and Delta in [0, 360) degrees of Mueller matrices `[..., 4, 4]`, as instruments print them.

    Delta counts for fields exp(+i w t). For a matrix that mixes s and p they follow from its N, C and S.
    """
    n, c, s = -mueller[..., 0, 1], mueller[..., 2, 2], mueller[..., 2, 3]
    psi = 0.5 * np.degrees(np.arctan2(np.hypot(c, s), n))
    return psi, np.mod(np.degrees(np.arctan2(s, c)), 360.0)


def circular_reflection(mueller: Array) -> CircularReflection:
    """Return the reflection of circular light by matrices `[..., wavelength, 4, 4]`."""
    right = mueller[..., 0, 0] + mueller[..., 0, 3]
    left = mueller[..., 0, 0] - mueller[..., 0, 3]
    total = right + left
    is_lit = total > LEAST_POWER
    dissymmetry = np.where(is_lit, 2.0 * (right - left) / np.where(is_lit, total, 1.0), 0.0)
    sign = np.where(right >= left, 1.0, -1.0)
    stronger = np.maximum(right, left)
    same = 0.5 * (stronger + sign * (mueller[..., 3, 0] + sign * mueller[..., 3, 3]))
    preserved = np.where(stronger > LEAST_POWER, same / np.where(stronger > LEAST_POWER, stronger, 1.0), 0.0)
    return CircularReflection(right, left, dissymmetry, preserved)


def selective_band(reflection: CircularReflection, wavelengths_nm: Array) -> SelectiveBand | None:
    """Return the band of the largest difference between the hands `[wavelength]`; None if |g| stays small."""
    difference = reflection.right - reflection.left
    at = int(np.argmax(np.abs(difference)))
    if abs(reflection.dissymmetry[at]) < LEAST_DISSYMMETRY:
        return None
    hand = "right" if difference[at] > 0 else "left"
    size = np.abs(difference) * (np.sign(difference) == np.sign(difference[at]))
    half = size >= 0.5 * size[at]
    first = at - int(np.argmin(np.append(half[at::-1], False))) + 1
    last = at + int(np.argmin(np.append(half[at:], False))) - 1
    own, other = (reflection.right, reflection.left) if hand == "right" else (reflection.left, reflection.right)
    return SelectiveBand(
        hand, float(wavelengths_nm[at]), float(wavelengths_nm[first]), float(wavelengths_nm[last]), float(own[at]),
        float(other[at]), float(abs(reflection.dissymmetry[at])),
    )  # fmt: skip


def crossed_polarisers(matrices: Array) -> Array:
    """Return the transmittance `[wavelength]` between crossed polarisers, turned to the brightest position.

    The first polariser has passed its light already: a half-wave plate transmits 1.

    Args:
        matrices: `[wavelength, 4, 4]`.
    """
    azimuths = np.linspace(0.0, np.pi, CROSSED_POSITIONS, endpoint=False)
    axes = np.stack([np.ones_like(azimuths), np.cos(azimuths), np.sin(azimuths), 0.0 * azimuths], axis=-1)
    crossed = axes * np.array([1.0, -1.0, -1.0, 1.0])
    passed = 0.5 * np.einsum("ai,lij,aj->al", crossed, matrices, axes)
    brightest: Array = np.clip(passed[np.argmax(passed.mean(axis=1))], 0.0, None)
    return brightest


def retardance_nm(matrices: Array, wavelengths_nm: Array) -> float | None:
    """Return the path difference of a linear retarder that explains its matrices best; None for other elements.

    cos(2 pi retardance / wavelength) follows from the trace of a retarder's matrix at each wavelength; together the
    wavelengths decide the order of interference.

    Args:
        matrices: `[wavelength, 4, 4]`, on ten or more wavelengths.
        wavelengths_nm: `[wavelength]`.
    """
    power = matrices[:, 0, 0]
    if len(power) < 10 or np.any(power <= LEAST_POWER):
        return None
    relative = matrices / power[:, None, None]
    cos = 0.5 * (np.trace(relative, axis1=1, axis2=2) - 2.0)
    trial = np.arange(0.0, MOST_RETARDANCE_NM, 1.0)
    errors = np.mean((np.cos(2.0 * np.pi * trial[:, None] / wavelengths_nm) - cos) ** 2, axis=1)
    best = int(np.argmin(errors))
    return float(trial[best]) if errors[best] < RETARDER_ERROR**2 else None
