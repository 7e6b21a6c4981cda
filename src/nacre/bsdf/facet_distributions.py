"""Microfacet normal distributions with masking (GGX, Beckmann, Blinn, Ashikhmin-Shirley), and interface roughness.

All four have widths alpha_x, alpha_y; the exponents of Blinn and Ashikhmin-Shirley are e = 2/alpha^2 - 2. Directions
are in a frame with alpha_x along x. Sources: Walter et al. 2007 (GGX, Beckmann, refraction), Blinn 1977 with
Torrance-Sparrow V-cavities, Ashikhmin & Shirley 2000, Heitz 2014.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.bsdf.texture import Texture
from nacre.core.arrays import Array

DISTRIBUTIONS = ("ggx", "beckmann", "blinn", "ashikhmin-shirley")
TINY = 1e-30


def exponent_from_alpha(alpha: Array | float) -> Array | float:
    """Return the exponent e = 2/alpha^2 - 2 of a cosine lobe as wide as a Beckmann lobe with `alpha`."""
    return 2.0 / np.square(alpha) - 2.0


def alpha_from_exponent(exponent: float) -> float:
    """Return alpha = sqrt(2/(e + 2))."""
    return float(np.sqrt(2.0 / (exponent + 2.0)))


def normal_density(distribution: str, m: Array, alpha_x: Array | float, alpha_y: Array | float) -> Array:
    """Return D(m), `[...]`, for unit normals `m` with shape `[..., 3]`; zero for m_z <= 0.

    For GGX, Beckmann and Blinn the integral of D m_z is 1. For Ashikhmin-Shirley, as in its source, the integral of
    D is 1: constant sqrt((ex+1)(ey+1))/2pi rather than sqrt((ex+2)(ey+2))/2pi.
    """
    z = np.maximum(m[..., 2], 1e-12)
    slope2 = np.square(m[..., 0] / alpha_x) + np.square(m[..., 1] / alpha_y)
    with np.errstate(under="ignore", over="ignore"):
        if distribution == "ggx":
            value = 1.0 / (np.pi * alpha_x * alpha_y * np.square(slope2 + np.square(z)))
        elif distribution == "beckmann":
            value = np.exp(-slope2 / np.square(z)) / (np.pi * alpha_x * alpha_y * z**4)
        else:
            ex, ey = exponent_from_alpha(alpha_x), exponent_from_alpha(alpha_y)
            flat = np.maximum(np.square(m[..., 0]) + np.square(m[..., 1]), TINY)
            power = (ex * np.square(m[..., 0]) + ey * np.square(m[..., 1])) / flat
            add = 2.0 if distribution == "blinn" else 1.0
            value = np.sqrt((ex + add) * (ey + add)) / (2.0 * np.pi) * np.power(z, power)
    return np.where(m[..., 2] > 0, value, 0.0)


def smith_masking(distribution: str, w: Array, alpha_x: Array | float, alpha_y: Array | float) -> Array:
    """Return Smith's G1 for GGX (exact) or Beckmann (rational fit of Walter et al., error below 0.35 %), `[...]`."""
    flat2 = np.square(alpha_x * w[..., 0]) + np.square(alpha_y * w[..., 1])
    tan2 = flat2 / np.maximum(np.square(w[..., 2]), TINY)
    if distribution == "ggx":
        return np.asarray(2.0 / (1.0 + np.sqrt(1.0 + tan2)))
    a = 1.0 / np.sqrt(np.maximum(tan2, TINY))
    fit = (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a)
    return np.where(a >= 1.6, 1.0, np.minimum(fit, 1.0))


def masking(distribution: str, wi: Array, wo: Array, m: Array, alpha_x: Array | float, alpha_y: Array | float) -> Array:
    """Return G(wi, wo, m), `[...]`, symmetric in `wi` and `wo`; zero if a direction is on the back of `m`.

    GGX, Beckmann: Smith, separable, G1(wi) G1(wo). Blinn: V-cavities, min(1, 2 m_z |cos_i|/|wi.m|,
    2 m_z |cos_o|/|wo.m|). Ashikhmin-Shirley: min(|cos_i|/|wi.m|, |cos_o|/|wo.m|), which for reflection is the source's
    1/max(cos_i, cos_o) and conserves energy in refraction.
    """
    i_m, o_m = np.sum(wi * m, axis=-1), np.sum(wo * m, axis=-1)
    cos_i, cos_o = wi[..., 2], wo[..., 2]
    if distribution in ("ggx", "beckmann"):
        value = smith_masking(distribution, wi, alpha_x, alpha_y) * smith_masking(distribution, wo, alpha_x, alpha_y)
    else:
        ratio_i = np.abs(cos_i) / np.maximum(np.abs(i_m), TINY)
        ratio_o = np.abs(cos_o) / np.maximum(np.abs(o_m), TINY)
        value = np.minimum(ratio_i, ratio_o)
        if distribution == "blinn":
            value = np.minimum(1.0, 2.0 * m[..., 2] * value)
    return np.where((i_m * cos_i > 0) & (o_m * cos_o > 0), value, 0.0)


def exits(w: Array, m: Array, eta: float) -> tuple[Array, Array]:
    """Return the reflected and the refracted direction for light along `w` at each facet `m`.

    Args:
        w: `[3]`, z > 0.
        m: `[facet, 3]` with w.m > 0.
        eta: index on the other side over the index on this side.

    Returns:
        `(back, through)`, `[facet, 3]` each, pointing away; beyond the critical angle `through` is (1, 0, 0), for
        which the masking is zero.
    """
    w_m = np.sum(w * m, axis=-1, keepdims=True)
    back = 2.0 * w_m * m - w
    sin2 = (1.0 - np.square(w_m)) / eta**2
    cos_t = np.sqrt(np.maximum(0.0, 1.0 - sin2))
    through = (w_m / eta - cos_t) * m - w / eta
    return back, np.where(sin2 < 1.0, through, np.array([1.0, 0.0, 0.0]))


def normal_quadrature(distribution: str, alpha_x: float, alpha_y: float, nodes: int = 64) -> tuple[Array, Array]:
    """Return normals and weights D(m) dm, `[count, 3]` and `[count]`, dense at large D; count ~ nodes^2.

    A Fibonacci lattice over the quantiles of D m_z and the azimuth: at normal incidence all points have different
    polar angles, which resolves the kink at total reflection (a product rule with as many points errs by 1 %).
    """
    before, count = 1, 1
    while count < nodes * nodes:
        before, count = count, before + count
    lattice = np.arange(count, dtype=np.float64)
    unit = (lattice + 0.5) / count
    # clustered at both ends with vanishing weights, since the lattice requires a periodic integrand
    xi, dxi = unit * unit * (3 - 2 * unit), 6 * unit * (1 - unit) / count
    # stretch the azimuth by the anisotropy: uniform points in phi' are exact for an elliptic distribution
    turned: Array = 2.0 * np.pi * np.mod(lattice * before / count, 1.0)
    x, y = alpha_x * np.cos(turned), alpha_y * np.sin(turned)
    phi = np.arctan2(y, x)
    stretch = alpha_x * alpha_y / (x * x + y * y)  # d phi / d phi'
    alpha2 = 1.0 / (np.square(np.cos(phi) / alpha_x) + np.square(np.sin(phi) / alpha_y))
    if distribution == "ggx":
        cos = 1.0 / np.sqrt(1.0 + alpha2 * xi / np.maximum(1.0 - xi, TINY))
    elif distribution == "beckmann":
        cos = 1.0 / np.sqrt(1.0 - alpha2 * np.log(np.maximum(1.0 - xi, TINY)))
    else:
        exponent = exponent_from_alpha(alpha_x) * np.cos(phi) ** 2 + exponent_from_alpha(alpha_y) * np.sin(phi) ** 2
        cos = np.power(np.maximum(1.0 - xi, TINY), 1.0 / (exponent + 2.0))
    sin = np.sqrt(np.maximum(0.0, 1.0 - cos * cos))
    m = np.stack([np.cos(phi) * sin, np.sin(phi) * sin, cos], axis=-1)
    # at one azimuth xi is the cumulative distribution of D m_z, up to the azimuth's density
    share = _azimuth_share(distribution, phi, alpha_x, alpha_y) * stretch
    measure = share * dxi * 2.0 * np.pi
    if distribution == "ashikhmin-shirley":
        ex, ey = float(exponent_from_alpha(alpha_x)), float(exponent_from_alpha(alpha_y))
        measure = measure * np.sqrt((ex + 1) * (ey + 1) / ((ex + 2) * (ey + 2)))
    return m, measure / np.maximum(m[:, 2], 1e-12)


def visible_normals(
    distribution: str, w: Array, alpha_x: float, alpha_y: float, nodes: int = 64
) -> tuple[Array, Array]:
    """Return a quadrature over the facets visible from one direction.

    A facet visible from `w` has weight D(m) g(w, m) |w.m| / |w_z| with the one-sided masking g. The weights sum to 1
    (Smith, V-cavities), or to the visible part of 1 (Ashikhmin-Shirley, whose facets are drawn from D).

    Args:
        w: unit direction `[3]`, z > 0.
        nodes: points along each coordinate.

    Returns:
        `(m, weight)`: `[count, 3]`, `[count]`; see `normal_quadrature`.
    """
    m, measure = normal_quadrature(distribution, alpha_x, alpha_y, nodes)
    w_m = m @ w
    visible = np.maximum(w_m, 0.0)
    if distribution in ("ggx", "beckmann"):
        weight = measure * smith_masking(distribution, w, alpha_x, alpha_y) * visible / w[2]
    elif distribution == "blinn":
        weight = measure * np.minimum(visible / w[2], 2.0 * m[:, 2])
    else:
        weight = measure * (w_m > 0)
    return m, weight


def _azimuth_share(distribution: str, phi: Array, alpha_x: float, alpha_y: float) -> Array:
    """Return the azimuthal density of normals weighted by D m_z."""
    if distribution in ("ggx", "beckmann"):
        alpha2 = 1.0 / (np.square(np.cos(phi) / alpha_x) + np.square(np.sin(phi) / alpha_y))
        return np.asarray(alpha2 / (2.0 * np.pi * alpha_x * alpha_y))
    ex, ey = float(exponent_from_alpha(alpha_x)), float(exponent_from_alpha(alpha_y))
    exponent = ex * np.cos(phi) ** 2 + ey * np.sin(phi) ** 2
    return np.asarray(np.sqrt((ex + 2) * (ey + 2)) / (2.0 * np.pi * (exponent + 2.0)))


def fresnel(cos_i: Array, eta: float) -> Array:
    """Return the unpolarised reflectance of a bare interface with relative index `eta` at `cos_i` in (0, 1]."""
    cos_i = np.asarray(cos_i, dtype=float)
    cos_t = np.sqrt(np.maximum(0.0, 1 - (1 - cos_i**2) / eta**2))
    with np.errstate(divide="ignore", invalid="ignore"):
        r_s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
        r_p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    value = np.where(1 - cos_i**2 >= eta**2, 1.0, (r_s**2 + r_p**2) / 2)
    return np.asarray(np.nan_to_num(value, nan=1.0))


SMOOTH_BELOW = 1e-3  # alpha; spreads light by less than 0.1 degree


@dataclass(frozen=True)
class Roughness:
    """Interface roughness; all layers of a film follow it.

    Attributes:
        distribution: "ggx", "beckmann", "blinn" or "ashikhmin-shirley".
        alpha_x, alpha_y: widths; smooth if both are below 0.001.
        alpha_texture: optional factor on both.
        rotation: optional angle of the roughness x axis, rad.
        compensate: restore the light lost between facets.
    """

    distribution: str = "ggx"
    alpha_x: float = 0.0
    alpha_y: float = 0.0
    alpha_texture: Texture | None = None
    rotation: Texture | None = None
    compensate: bool = False

    @property
    def is_smooth(self) -> bool:
        """Whether the interface is specular."""
        return max(self.alpha_x, self.alpha_y) < SMOOTH_BELOW


def check_widths(value: object, forms: str, text: str) -> None:
    """Check one or two widths from a recipe.

    Args:
        value: the recipe's value.
        forms: valid forms, for the message.
        text: the value as text, for the message.

    Raises:
        ValueError: not one or two numbers, or a number outside [0, 1]; the message continues the key.
    """
    numbers: Any = value if isinstance(value, list | tuple) else [value]
    if len(numbers) not in (1, 2) or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
        raise ValueError(f"= {text} is not a roughness; write {forms}")
    if not all(0.0 <= v <= 1.0 for v in numbers):
        raise ValueError(f"= {text} is not allowed; it should be in [0, 1]")
