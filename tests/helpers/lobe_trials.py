"""Trials of a lobe on the device: the same questions for every kind, so that a new lobe joins with one line.

Each function takes a Bsdf, asks the `nacre` plugin of the current variant, and returns numbers; bars stand in
the tests. In all of them the eye is `si.wi` unless said otherwise, as in a radiance-tracing integrator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.bsdf import Bsdf
from nacre.core.arrays import Array
from nacre.device.bsdf import make_bsdf

HERO_WAVELENGTHS_NM = (452.0, 513.0, 587.0, 644.0)


@dataclass(frozen=True)
class ChiSquare:
    """Outcome of a chi-square test: p-value, whether it could be run, and Mitsuba's own words."""

    p_value: float
    failed: bool
    messages: str

    def passes(self, level: float, tests: int) -> bool:
        """Whether the hypothesis stands at `level`, shared among `tests` trials (Sidak)."""
        return not self.failed and self.p_value >= 1.0 - (1.0 - level) ** (1.0 / tests)


@dataclass(frozen=True)
class Draws:
    """What `sample()` returned for one direction of view, `n` draws.

    Attributes:
        wo: `[n, 3]`; pdf: `[n]`; weight: `[n, 4]` value |cos| / pdf; is_delta: `[n]`; eta: `[n]`.
        value, density: `[n, 4]`, `[n]`: what `eval_pdf()` says of the same directions.
    """

    wo: Array
    pdf: Array
    weight: Array
    is_delta: NDArray[np.bool_]
    eta: Array
    value: Array
    density: Array


def direction(theta_deg: float, phi_deg: float) -> Array:
    """Return the unit vector at these angles; theta > 90 lies below the surface."""
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def directions(n: int, seed: int, both_sides: bool) -> Array:
    """Draw unit vectors `[n, 3]`, uniform over the upper half of the sphere or over all of it."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(-1.0 if both_sides else 0.0, 1.0, n)
    z = np.where(np.abs(z) < 0.02, 0.02, z)  # edge-on values are huge and single precision there is coarse
    phi = rng.uniform(0.0, 2.0 * np.pi, n)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


def near_mirror(eye: Array, seed: int, width: float, eta: float = 1.0) -> Array:
    """Draw light directions near the mirror (or, for half of them if eta > 1, the refracted) image of `eye`."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(0.0, width, (len(eye), 3))
    normal[:, 2] = 1.0
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sign = np.sign(eye[:, 2:])
    upright = eye * sign
    cos = np.sum(upright * normal, axis=1, keepdims=True)
    mirror = 2.0 * cos * normal - upright
    if eta > 1.0:
        ratio = np.where(sign > 0, 1.0 / eta, eta)
        inner = 1.0 - (1.0 - cos**2) * ratio**2
        bent = normal * (cos * ratio - np.sqrt(np.maximum(inner, 0.0))) - upright * ratio
        bends = (np.arange(len(eye)) % 2 == 1)[:, None] & (inner > 0)
        mirror = np.where(bends, bent, mirror)
    light = mirror * sign
    light[:, 2] = np.where(np.abs(light[:, 2]) < 0.02, 0.02, light[:, 2])
    return np.asarray(light / np.linalg.norm(light, axis=1, keepdims=True))


def interaction(
    wi: Array, wavelengths_nm: Array | tuple[float, ...] = HERO_WAVELENGTHS_NM, uv: Array | None = None
) -> Any:
    """Return a surface interaction with local directions `wi[n, 3]`, wavelengths and uv."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = mi.Vector3f(np.ascontiguousarray(wi.T, dtype=np.float32))
    si.wavelengths = mi.UnpolarizedSpectrum([dr.opaque(mi.Float, float(w), len(wi)) for w in wavelengths_nm])
    where = np.full((len(wi), 2), 0.5) if uv is None else np.broadcast_to(uv, (len(wi), 2))
    si.uv = mi.Point2f(np.ascontiguousarray(where.T, dtype=np.float32))
    si.t = mi.Float(0.0)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.n = mi.Normal3f(0, 0, 1)
    return si


def context(radiance: bool = True) -> Any:
    """Return a BSDF context that traces radiance or importance."""
    mode = mi.TransportMode.Radiance if radiance else mi.TransportMode.Importance
    return mi.BSDFContext(mode)


def plugin_values(
    bsdf: Bsdf | Any,
    light: Array,
    eye: Array,
    wavelengths_nm: Array,
    uv: Array | None = None,
    radiance: bool = True,
) -> Array:
    """Evaluate the plugin in the array convention: `[n, wavelength]`, 1/sr, without the cosine.

    Args:
        bsdf: a Bsdf, or any Mitsuba BSDF to compare with.
        light, eye: `[n, 3]` unit vectors.
        wavelengths_nm: nodes to evaluate at; four go at a time.
        uv: `[n, 2]` or None.
        radiance: trace from the eye (True) or from the light; the value must be the same physics.
    """
    plugin = make_bsdf(bsdf) if isinstance(bsdf, Bsdf) else bsdf
    here, there = (eye, light) if radiance else (light, eye)
    wo = mi.Vector3f(np.ascontiguousarray(there.T, dtype=np.float32))
    found = []
    for start in range(0, len(wavelengths_nm), 4):
        block = np.resize(wavelengths_nm[start : start + 4], 4)
        value = plugin.eval(context(radiance), interaction(here, block, uv), wo, mi.Bool(True))
        found.append(np.array(value).T[:, : min(4, len(wavelengths_nm) - start)])
    return np.concatenate(found, axis=1).astype(float) / np.abs(there[:, 2:])


def array_mismatch(bsdf: Bsdf, light: Array, eye: Array, uv: Array | None = None, every: int = 1) -> float:
    """Return the largest difference between array and plugin, as a fraction of the largest value.

    Both sides see the directions as single precision keeps them, so that it is the evaluation that is compared.
    """
    light, eye = light.astype(np.float32).astype(float), eye.astype(np.float32).astype(float)
    if uv is not None:
        uv = uv.astype(np.float32).astype(float)
    expected = bsdf.evaluate(light, eye, uv)[..., ::every]
    got = plugin_values(bsdf, light, eye, bsdf.wavelengths_nm[::every], uv)
    return float(np.max(np.abs(got - expected)) / np.max(np.abs(expected)))


def chi_square(
    bsdf: Bsdf | Any,
    theta_deg: float,
    phi_deg: float,
    samples: int = 1_000_000,
    resolution: int = 101,
    seed: int = 1,
    uv: tuple[float, float] = (0.5, 0.5),
    steps: int = 4,
) -> ChiSquare:
    """Compare the histogram of `sample()` with `pdf()` for one direction of view (theta > 90: from below).

    Delta draws are left out on both sides: the density speaks of the continuous part alone.
    """
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    plugin = make_bsdf(bsdf) if isinstance(bsdf, Bsdf) else bsdf
    ctx = context()
    wi = direction(theta_deg, phi_deg)

    def interactions(n: int) -> Any:
        si = interaction(wi[None, :], uv=np.array(uv))
        si.wi = mi.Vector3f(*(dr.opaque(mi.Float, float(c), n) for c in wi))
        return si

    def sample(u: Any) -> Any:
        bs, weight = plugin.sample(ctx, interactions(dr.width(u)), u[0], mi.Point2f(u[1], u[2]), mi.Bool(True))
        is_delta = (bs.sampled_type & int(mi.BSDFFlags.Delta)) != 0
        weight = weight[0, 0] if mi.is_polarized else weight
        drawn = (bs.pdf > 0.0) & ~is_delta & (dr.max(weight) >= 0.0)
        # a draw that failed points nowhere; weight 0 keeps it out of the histogram
        return dr.select(drawn, bs.wo, mi.Vector3f(0, 0, 1)), dr.select(drawn, mi.Float(1.0), 0.0)

    def density(wo: Any) -> Any:
        return plugin.pdf(ctx, interactions(dr.width(wo)), wo, mi.Bool(True))

    test = ChiSquareTest(
        SphericalDomain(), sample, density, sample_dim=3, sample_count=samples, res=resolution, ires=steps, seed=seed
    )
    test.run(significance_level=1e-12, quiet=True)  # the caller evaluates the p-value
    if test.pdf_sum[0] == 0.0 and test.histogram_sum[0] == 0.0:  # which Mitsuba accepts
        return ChiSquare(0.0, True, "neither draws nor density: the lobe sends no light from here")
    return ChiSquare(float(test.p_value), bool(test.fail), test.messages)


def draw(bsdf: Bsdf | Any, wi: Array, n: int, seed: int = 0, uv: Array | None = None, radiance: bool = True) -> Draws:
    """Draw `n` samples for one direction `wi[3]`, and evaluate the directions drawn."""
    plugin = make_bsdf(bsdf) if isinstance(bsdf, Bsdf) else bsdf
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, n)
    ctx = context(radiance)
    si = interaction(np.broadcast_to(wi, (n, 3)), uv=uv)
    bs, weight = plugin.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), mi.Bool(True))
    value, density = plugin.eval_pdf(ctx, si, bs.wo, mi.Bool(True))
    dr.eval(bs, weight, value, density)

    def rows(v: Any, width: int) -> Array:
        return np.broadcast_to(np.array(v, dtype=float).T, (n, width))

    def line(v: Any) -> Array:
        return np.broadcast_to(np.array(v, dtype=float), (n,))

    is_delta = (np.broadcast_to(np.array(bs.sampled_type), (n,)) & int(mi.BSDFFlags.Delta)) != 0
    return Draws(rows(bs.wo, 3), line(bs.pdf), rows(weight, 4), is_delta, line(bs.eta), rows(value, 4), line(density))


def weight_mismatch(draws: Draws) -> float:
    """Return the largest relative difference of weight * pdf from value over the broad draws (99.9 % quantile).

    The far tails of narrow lobes round differently along the two ways, hence the quantile.
    """
    broad = (~draws.is_delta) & (draws.pdf > 0)
    assert broad.any(), "all draws are deltas or failed: there are no weights to compare"
    product = draws.weight[broad] * draws.pdf[broad, None]
    scale = np.maximum(np.abs(draws.value[broad]), 1e-6 * np.abs(draws.value[broad]).max(initial=1e-30))
    return float(np.quantile(np.abs(product - draws.value[broad]) / scale, 0.999, axis=0).max())


def furnace(
    bsdf: Bsdf | Any, theta_deg: float, n: int = 200_000, seed: int = 0, phi_deg: float = 30.0
) -> tuple[Array, Array]:
    """Return mean and standard error of the light sent back to an eye within uniform light, `[4]` each.

    Importance is traced, so that refraction's change of radiance with the index drops out and 1 is lossless.
    """
    draws = draw(bsdf, direction(theta_deg, phi_deg), n, seed, radiance=False)
    weight = np.where((draws.pdf > 0)[:, None], draws.weight, 0.0)
    return weight.mean(axis=0), weight.std(axis=0) / np.sqrt(n)


def reciprocity_mismatch(bsdf: Bsdf | Any, a: Array, b: Array, eta: float = 1.0, uv: Array | None = None) -> float:
    """Return the largest difference of f(a, b)/n_b^2 from f(b, a)/n_a^2, as a fraction of the largest value.

    Args:
        a, b: `[n, 3]` unit vectors.
        eta: index below the surface over that above.
        uv: `[n, 2]` or None.
    """
    wavelengths = np.array(HERO_WAVELENGTHS_NM)
    n_a, n_b = (np.where(w[:, 2] < 0, eta, 1.0)[:, None] for w in (a, b))
    there = plugin_values(bsdf, a, b, wavelengths, uv) / n_b**2
    back = plugin_values(bsdf, b, a, wavelengths, uv) / n_a**2
    return float(np.max(np.abs(there - back)) / np.max(np.abs(there)))
