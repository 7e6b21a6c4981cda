"""Power of the diffraction lines (orders) of a periodic surface, its adjoint, and the sampling that it needs.

A periodic relief reflects into lines m/P; line (m, n) carries |c[m, n]|^2 with c the Fourier coefficient of
exp(-2 pi i kappa H). For few lines the transform is pruned: a real product with a cosine/sine basis along each axis
(half the work of a complex one, any sampling). For many lines it is an FFT, with the same numbers to rounding.

A wall with a phase step above about 5 rad between neighbouring samples causes aliasing. `STEP_FOR_ERROR` gives a first
sampling, and the comparison of two samplings decides.

The BRDF also has factors that do not depend on the heights: directions, obliquity, coating reflectance.
psi = w_i + w_o has the lateral part (u, v) and the normal part xi. The relief's power spectrum depends on
(u, v, xi, lambda). The coating reflectance is taken at the angle of the facet, cos(theta_d) = w_i . h with the half
vector h. It is equal for both directions, so the BRDF is reciprocal (physics/relief.md, "Prefactor").

The coherence window, given by sigma or the angular size of the light source, is a Gaussian of standard deviation
s = `width_in_wavelengths` x lambda. Its spectrum smooths the lines by the same angle at every wavelength
(physics/relief.md, "From heights to light").
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from pydantic import Field

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.machine import check_memory
from nacre.families.relief.surface import Tile, largest_step_nm
from nacre.recipe.model import RecipeModel

PUBLISHED_REFERENCE_UM = 0.5  # the source quotes sigma, in um, at this wavelength


@dataclass(frozen=True)
class Coherence:
    """The coherence window: s / lambda, dimensionless."""

    width_in_wavelengths: float

    @classmethod
    def from_sigma(cls, sigma_um: float) -> Coherence:
        """Build from the published parameter: s = (sigma / 0.5) lambda, lambda in um."""
        return cls(sigma_um / PUBLISHED_REFERENCE_UM)

    @classmethod
    def from_source_angle(cls, full_angle_rad: float) -> Coherence:
        """Build from the full angle of a uniform disc: its rms angle is a quarter of the diameter."""
        return cls(1.0 / (2.0 * math.sqrt(2.0) * math.pi * (full_angle_rad / 4.0)))

    @property
    def blur(self) -> float:
        """Standard deviation of the smoothing in direction cosines; 0.0216 for sigma 2.6."""
        return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * self.width_in_wavelengths)

    @property
    def source_angle_rad(self) -> float:
        """Full angle of the uniform disc with the same rms size; 5.0 degrees for sigma 2.6."""
        return 4.0 * self.blur

    @property
    def sigma_um(self) -> float:
        """The published sigma, in um."""
        return self.width_in_wavelengths * PUBLISHED_REFERENCE_UM


LARGEST_SOURCE_ANGLE_DEG = 90.0


class CoherenceSpec(RecipeModel):
    """Either `sigma` (um at 0.5 um, as published) or `source_angle_deg`, the full angle of a uniform source."""

    one_of: ClassVar[tuple[str, ...]] = ("sigma", "source_angle_deg")
    forms: ClassVar[tuple[str, ...]] = ("{sigma = 5}", "{source_angle_deg = 0.53}")

    sigma: Annotated[float, Field(gt=0.0, le=1e4)] | None = Field(
        default=None, description="width of the coherence window in um, at a wavelength of 0.5 um", examples=[5]
    )
    source_angle_deg: Annotated[float, Field(gt=0.0, le=LARGEST_SOURCE_ANGLE_DEG)] | None = Field(
        default=None, description="instead of sigma: full angle of a uniform light source", examples=[0.53]
    )

    def model_post_init(self, _: Any) -> None:
        if (self.sigma is None) == (self.source_angle_deg is None):
            raise ValueError("coherence: give exactly one of sigma and source_angle_deg")

    def build(self) -> Coherence:
        """Return the coherence window."""
        if self.sigma is not None:
            return Coherence.from_sigma(self.sigma)
        assert self.source_angle_deg is not None
        return Coherence.from_source_angle(math.radians(self.source_angle_deg))


def fresnel_reflectance(cos_d: Array, n: NDArray[np.complex128], n_ambient: float = 1.0) -> Array:
    """Return the unpolarised power reflectance `[..., wavelength]` of an opaque medium.

    Args:
        cos_d: incidence cosines, `[...]`.
        n: complex index n + ik `[wavelength]`, k >= 0.
        n_ambient: index outside.

    Example:
        >>> round(float(fresnel_reflectance(np.array(1.0), np.array([0.96 + 6.69j]))[0]), 2)
        0.92
    """
    cosine = np.asarray(cos_d, dtype=float)[..., None]
    ratio = np.asarray(n) / n_ambient
    root = np.sqrt(ratio**2 - (1.0 - cosine**2) + 0j)
    s, p = _ratio(cosine, root), _ratio(ratio**2 * cosine, root)
    return np.asarray(0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2))


def _ratio(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return (a - b)/(a + b); 0 for an index-matched coating, where both vanish."""
    total = a + b
    return np.asarray((a - b) / np.where(total == 0, 1.0, total))


def coating_reflectance(n: NDArray[np.complex128], n_ambient: float = 1.0) -> Callable[[Array], Array]:
    """Return the reflectance as a function of the cosine, for `plan_cut`."""
    return partial(fresnel_reflectance, n=n, n_ambient=n_ambient)


Prefactor = Literal["kirchhoff", "published"]
# lower bound of cosines, for a finite 1/cos at grazing
LEAST_COSINE = 1e-6


def outgoing(wi: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Return cos(theta_o) for lateral sums `u`, `v` (broadcast), and whether that direction is above the surface."""
    lateral = (u - wi[0]) ** 2 + (v - wi[1]) ** 2
    return np.sqrt(np.maximum(1.0 - lateral, 0.0)), lateral < 1.0 - LEAST_COSINE**2


def brdf_factor(u: Array, v: Array, cos_i: Array, cos_o: Array, prefactor: Prefactor) -> Array:
    """Return the factor from <|A|^2> / lambda^2 to the BRDF in 1/sr.

    "published" is C1 = xi^2 / (4 cos_i cos_o); "kirchhoff" restores the obliquity 1/cos^4 of the half-vector's angle,
    with which smooth reliefs conserve energy (physics/relief.md, "Prefactor"). Both are reciprocal.
    """
    cos_i, cos_o = np.maximum(cos_i, LEAST_COSINE), np.maximum(cos_o, LEAST_COSINE)
    xi = cos_i + cos_o
    if prefactor == "published":
        return np.asarray(xi**2 / (4.0 * cos_i * cos_o))
    return np.asarray((u**2 + v**2 + xi**2) ** 2 / (4.0 * xi**2 * cos_i * cos_o))


def difference_cosine(u: Array, v: Array, xi: Array) -> Array:
    """Return cos(theta_d) = |w_i + w_o| / 2, the incidence cosine for Fresnel reflection."""
    return np.minimum(0.5 * np.sqrt(u**2 + v**2 + xi**2), 1.0)


RealArray = NDArray[Any]
# products cost lines x samples^2, the FFT samples^2 log(samples): the FFT is cheaper above this number of lines per
# log2(samples) (measured: 90 lines of 256 samples, 140 of 1024, 150 of 1728; one core, either precision)
FFT_LINES = 12.0


@dataclass(frozen=True)
class LineBasis:
    """Cosine and sine rows for the lines 0..highest of one axis of `samples` samples.

    Attributes:
        rows: `[2 (highest + 1), samples]`, cosines first.
        highest: highest line number, below samples / 2.
    """

    rows: RealArray
    highest: int

    @property
    def samples(self) -> int:
        """Samples along the axis."""
        return int(self.rows.shape[1])


def line_basis(samples: int, highest: int, dtype: Any = np.float64) -> LineBasis:
    """Build the basis; orders above the Nyquist limit, (samples - 1) // 2, are dropped."""
    highest = min(highest, max((samples - 1) // 2, 0))
    # integer phases make the argument of the cosine exact for any line
    turns = (np.arange(highest + 1)[:, None] * np.arange(samples)[None, :]) % samples
    angle = turns * (2.0 * np.pi / samples)
    return LineBasis(np.concatenate([np.cos(angle), np.sin(angle)]).astype(dtype), highest)


def reflection(surface: RealArray, kappa: float) -> RealArray:
    """Return the real and imaginary part of exp(-2 pi i kappa H), `[2, x, y]`."""
    phase = surface * surface.dtype.type(2.0 * np.pi * kappa)
    result = np.empty((2, *surface.shape), dtype=surface.dtype)
    np.cos(phase, out=result[0])
    np.sin(phase, out=result[1])
    np.negative(result[1], out=result[1])
    return result


@dataclass(frozen=True)
class Coefficients:
    """Fourier coefficients of one reflection as products with the basis: `[2, row, row]`, divided by samples^2."""

    products: RealArray

    def _parts(self) -> tuple[RealArray, RealArray, RealArray, RealArray]:
        a = self.products.shape[1] // 2
        cc, cs = self.products[:, :a, :a], self.products[:, :a, a:]
        sc, ss = self.products[:, a:, :a], self.products[:, a:, a:]
        return cc - ss, sc + cs, cc + ss, sc - cs

    def power(self) -> RealArray:
        """Return |c|^2 for lines -highest..highest on both axes, `[2 highest + 1, 2 highest + 1]`."""
        d1, e1, d2, e2 = self._parts()
        h = d1.shape[1] - 1
        result = np.empty((2 * h + 1, 2 * h + 1), dtype=self.products.dtype)
        mean = (d1 * d1).sum(axis=0) + (e1 * e1).sum(axis=0)
        cross = 2.0 * (d1[0] * e1[1] - d1[1] * e1[0])
        result[h::-1, h::-1] = mean - cross
        result[h:, h:] = mean + cross
        mean = (d2 * d2).sum(axis=0) + (e2 * e2).sum(axis=0)
        cross = 2.0 * (d2[0] * e2[1] - d2[1] * e2[0])
        # column 0 and row 0 get the same values again
        result[h:, h::-1] = mean + cross
        result[h::-1, h:] = mean - cross
        return result

    def pullback(self, cotangent: RealArray) -> RealArray:
        """Return the gradient with respect to `products`, given that with respect to `power()`."""
        d1, e1, d2, e2 = self._parts()
        h = d1.shape[1] - 1
        pp = cotangent[h:, h:]
        mm = cotangent[h::-1, h::-1].copy()
        pm = cotangent[h:, h::-1].copy()
        mp = cotangent[h::-1, h:].copy()
        # each line exists once: rows and columns 0 belong to `pp` (and to `mm` only off both axes)
        mm[0], mm[:, 0] = 0.0, 0.0
        pm[:, 0] = 0.0
        mp[0] = 0.0
        gd1, ge1 = _pull(d1, e1, pp, mm)
        gd2, ge2 = _pull(d2, e2, pm, mp)
        top = np.concatenate([gd1 + gd2, ge1 - ge2], axis=2)
        bottom = np.concatenate([ge1 + ge2, gd2 - gd1], axis=2)
        return np.concatenate([top, bottom], axis=1)


def _pull(d: RealArray, e: RealArray, plus: RealArray, minus: RealArray) -> tuple[RealArray, RealArray]:
    mean = 2.0 * (plus + minus)
    cross = 2.0 * (plus - minus)
    gd = mean * d
    gd[0] += cross * e[1]
    gd[1] -= cross * e[0]
    ge = mean * e
    ge[0] -= cross * d[1]
    ge[1] += cross * d[0]
    return gd, ge


def coefficients(field: RealArray, basis: LineBasis) -> Coefficients:
    """Transform a reflection `[2, x, y]` by products with the basis along both axes."""
    scale = field.dtype.type(1.0 / field.shape[1] ** 2)
    products = (basis.rows @ field) @ basis.rows.T
    products *= scale
    return Coefficients(products)


def height_gradient(field: RealArray, cotangent: RealArray, basis: LineBasis, kappa: float) -> RealArray:
    """Return dL/dH `[x, y]` from dL/d(products), through the transform and the phase."""
    scale = 2.0 * np.pi * kappa / field.shape[1] ** 2
    back = (basis.rows.T @ cotangent) @ basis.rows
    gradient: RealArray = field[1] * back[0] - field[0] * back[1]
    gradient *= field.dtype.type(scale)
    return gradient


def line_power(surface: RealArray, kappa: float, highest: int, basis: LineBasis | None = None) -> RealArray:
    """Return |c|^2 of exp(-2 pi i kappa H) for lines -highest..highest, `[2 highest + 1, 2 highest + 1]`.

    The sum over all lines is 1. `highest` is limited by the sampling.

    Args:
        surface: `[x, y]`, one period of H in the unit of 1/kappa; its dtype is the precision.
        basis: shared by several kappa; default: the cheaper of FFT and products is chosen.
    """
    samples = surface.shape[0]
    highest = min(highest, max((samples - 1) // 2, 0))
    if basis is None and not is_fft_cheaper(samples, highest):
        basis = line_basis(samples, highest, surface.dtype)
    field = reflection(surface, kappa)
    if basis is not None:
        return coefficients(field, basis).power()
    waves = np.empty(surface.shape, dtype=np.result_type(surface.dtype, np.complex64))
    waves.real, waves.imag = field
    keep = np.arange(-highest, highest + 1) % samples
    # along y first, where samples are contiguous; then along x for the selected columns
    spectrum = scipy.fft.fft(waves, axis=1, overwrite_x=True)[:, keep]
    spectrum = scipy.fft.fft(spectrum, axis=0, overwrite_x=True)[keep]
    power: RealArray = (spectrum.real**2 + spectrum.imag**2) * field.dtype.type(1.0 / samples**4)
    return power


def is_fft_cheaper(samples: int, highest: int) -> bool:
    """Whether the FFT is cheaper than products for the lines up to `highest`."""
    return 2 * highest + 1 > FFT_LINES * np.log2(max(samples, 2))


# phase steps, rad, and their measured errors, interpolated in log error
STEP_FOR_ERROR = ((1e-6, 1.6), (1e-4, 3.0), (1e-3, 4.4), (1e-2, 6.0))
GROWTH = 1.5  # factor by which the sampling is refined for a check
MAX_SAMPLES = 16384  # along one side; 2 GiB of complex field in single precision
# factor on the difference between two samplings, which estimates the coarser one's error
MARGIN = 2.0
BYTES_PER_SAMPLE = 24  # surface in double precision, field and transform in single


@dataclass(frozen=True)
class Sampling:
    """A chosen sampling.

    Attributes:
        samples_per_feature: U.
        phase_step_rad: largest phase difference between neighbouring samples at the largest kappa.
        estimated_error: relative L2 difference of the line powers from a finer sampling.
        highest_line: lines on each side.
    """

    samples_per_feature: int
    phase_step_rad: float
    estimated_error: float
    highest_line: int


def _step_limit(error: float) -> float:
    errors, steps = zip(*STEP_FOR_ERROR)
    return float(np.interp(np.log(error), np.log(errors), steps))


def choose_sampling(tile: Tile, kappa_max: float, highest_line: int, error: float) -> Sampling:
    """Return the smallest sampling with converged line powers within `error`, relative L2.

    Args:
        tile: relief.
        kappa_max: largest xi / lambda, 1/nm, with the steepest phase.
        highest_line: highest diffraction line, at most a quarter of the samples.
        error: allowed error, such as 1e-3.

    Raises:
        UnsupportedError: more than 16384 samples along a side, or more memory than allowed, would be needed.
    """
    n = tile.features
    least = max(2, -(-(2 * highest_line + 4) // n))
    check_memory(
        BYTES_PER_SAMPLE * float(n * least) ** 2,
        f"feature_um = {tile.feature_nm / 1e3:.4g} of {n} x {n} features, which sends light into {highest_line} orders "
        "on each side of the mirror's,",
        "take smaller or fewer features, or light of higher coherence",
    )
    # the steepest wall of a blurred relief; without blur a wall is one step at any sampling
    probe = max(least, 4)
    step_nm = largest_step_nm(tile.surface_nm(probe)) * probe
    needed = int(np.ceil(2.0 * np.pi * kappa_max * step_nm / _step_limit(error) * 0.8)) if tile.blur_nm > 0 else least
    upsampling = max(least, min(needed, MAX_SAMPLES // n))
    coarse = _powers(tile, upsampling, kappa_max, highest_line)
    while True:
        finer = max(upsampling + 1, int(np.ceil(GROWTH * upsampling)))
        if upsampling * n > MAX_SAMPLES:
            raise UnsupportedError(
                f"the relief needs more than {MAX_SAMPLES} samples along a side for an error of {error:g}; "
                "allow a larger error, blur the walls, or use fewer features"
            )
        fine = _powers(tile, finer, kappa_max, highest_line)
        estimate = float(np.linalg.norm(coarse - fine) / max(float(np.linalg.norm(fine)), 1e-300))
        if MARGIN * estimate <= error:
            break
        upsampling, coarse = finer, fine
    phase = 2.0 * np.pi * kappa_max * largest_step_nm(tile.surface_nm(upsampling))
    return Sampling(upsampling, float(phase), MARGIN * estimate, highest_line)


def _powers(tile: Tile, upsampling: int, kappa: float, highest: int) -> Array:
    # large tiles in single precision: half the memory, with a rounding error of 1e-6
    dtype = np.float64 if tile.features * upsampling <= 1024 else np.float32
    surface = tile.surface_nm(upsampling).astype(dtype)
    return np.asarray(line_power(surface, kappa, highest), dtype=float)
