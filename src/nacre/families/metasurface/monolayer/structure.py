"""Structure factor S(q) and pair correlation g(r) for particles in a monolayer.

Hard disks in equilibrium have a closed form, Baus & Colot, Phys. Rev. A 36, 3912 (1987). Every arrangement, also a
measured one, becomes one `Structure`: two tables.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import j0, j1

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.quadrature import gauss_legendre

_VIRIAL = (0.1280, 0.0018, -0.0507, -0.0533, -0.0410)
SCALE_STEPS = 1 << 50  # steps in A between 1 and 2
PACKING_LIMIT = 0.7  # hard disks freeze at 0.70; the closed form is for the fluid
SMALLEST_MENDED = 0.02  # packing below which the closed-form core is empty to 1e-5
RANGE_IN_DIAMETERS = 9.0  # g - 1 beyond this many diameters changes results by less than 1e-3
S_STEP = 0.01  # S table step, in units 1 / diameter
S_BLOCK = 1000  # S samples that share one quadrature rule
MOST_KEPT = 512  # largest grid with cached Bessel functions; the same few grids recur at every packing


def _compressibility(eta: float) -> float:
    """D = d(eta Z)/d eta from the hard-disk equation of state, the inverse S(0)."""
    z_top, z_slope = 1.0, 0.0
    for power, c in enumerate(_VIRIAL, start=2):
        z_top += c * eta**power
        z_slope += c * power * eta ** (power - 1)
    z = z_top / (1 - eta) ** 2
    return float(z + eta * (z_slope / (1 - eta) ** 2 + 2 * z / (1 - eta)))


@lru_cache(maxsize=64)
def baus_colot_scale(eta: float) -> float:
    """The length scale A in (1, 2) in the direct correlation function; 1.566 at packing 0.3."""
    target = (1 - 4 * eta - 1 / _compressibility(eta)) / eta**2

    def falling(step: int) -> float:
        a = 1.0 + step / SCALE_STEPS
        bracket = a**2 * (a**2 - 4) * math.asin(1 / a) - (a**2 + 2) * math.sqrt(a**2 - 1)
        return -2.0 / math.pi * bracket

    if not falling(0) < -target < falling(SCALE_STEPS):
        raise NacreError(f"no Baus-Colot solution at packing {eta:g}: packing outside 0..0.7")
    # bisection; scipy's solvers take 0.2 s to import
    return 1.0 + bisect_left(range(SCALE_STEPS), -target, key=falling) / SCALE_STEPS


def _overlap(y: Array) -> Array:
    return 2 / np.pi * (np.arccos(y) - y * np.sqrt(1 - y * y))


@lru_cache(maxsize=24)
def _overlap_rule(q_reduced: bytes) -> tuple[Array, Array, Array]:
    """Nodes and weights for int_0^1 dx, and J0(Q x) there, `[q, node]`, for any packing."""
    q = np.frombuffer(q_reduced)
    # the integrand oscillates Q/2pi times: about pi nodes per period are exact to rounding
    x, weight = gauss_legendre(int(24 + 0.55 * q.max()))
    x, weight = (x + 1) / 2, weight / 2
    return x, weight, j0(np.outer(q, x))


def baus_colot_direct(q_reduced: ArrayLike, eta: float) -> Array:
    """rho times the Fourier-transformed Baus-Colot direct correlation function at Q = q a."""
    q = np.asarray(q_reduced, dtype=float)
    flat = np.maximum(np.abs(q.ravel()), 1e-9)
    d, a = _compressibility(eta), baus_colot_scale(eta)
    out = np.empty_like(flat)
    order = np.argsort(flat)
    for part in np.array_split(order, max(1, flat.size // 1000)):
        if part.size == 0:
            continue
        x, weight, waves = _overlap_rule(flat[part].tobytes())
        inner = waves @ (weight * x * _overlap(x / a))
        out[part] = -8 * eta * d * ((1 - a * a * eta) * j1(flat[part]) / flat[part] + a * a * eta * inner)
    return out.reshape(q.shape)


def baus_colot(q_reduced: ArrayLike, packing: float) -> Array:
    """Structure factor S(Q) for hard disks in equilibrium, Q = q a with a the disk diameter.

    Args:
        q_reduced: any shape, dimensionless.
        packing: disk area fraction, 0 (S = 1) to 0.7.

    Raises:
        NacreError: packing outside that range.

    Example:
        >>> [round(float(baus_colot(0.0, packing)), 4) for packing in (0.1, 0.3, 0.5)]
        [0.6605, 0.2581, 0.0801]
    """
    q = np.asarray(q_reduced, dtype=float)
    if packing < 0 or packing > PACKING_LIMIT:
        raise NacreError(f"packing = {packing:g} is outside 0..{PACKING_LIMIT:g}, the range of fluid hard disks")
    if packing < 1e-6:
        return np.ones_like(q)
    return 1.0 / (1.0 - baus_colot_direct(q, packing))


@lru_cache(maxsize=1)
def _indirect_rule() -> tuple[Array, Array]:
    # Gauss panels: a sum with step h leaves an offset h^2/12 times the slope at Q = 0 in g
    x, weight = gauss_legendre(16)
    edges = np.concatenate([np.arange(0.0, 100.0, 1.0), np.arange(100.0, 601.0, 2.0)])
    half = np.diff(edges)[:, None] / 2
    return ((edges[:-1] + edges[1:])[:, None] / 2 + half * x).ravel(), (half * weight).ravel()


@lru_cache(maxsize=8)
def _indirect_spectrum(packing: float) -> tuple[Array, Array]:
    q, weight = _indirect_rule()
    rc = baus_colot_direct(q, packing)
    return q, rc**2 / (1 - rc) / (4 * packing / np.pi) * q * weight / (2 * np.pi)


@lru_cache(maxsize=4)
def _indirect_waves(x: bytes) -> Array:
    """J0(Q x) at the `_indirect_rule` nodes, `[x, q]`, for any packing."""
    return np.asarray(j0(np.outer(np.frombuffer(x), _indirect_rule()[0])))


def baus_colot_pair_correlation(r_reduced: ArrayLike, packing: float) -> Array:
    """g(r/a) for the same fluid: zero inside the core, 1 + gamma outside.

    gamma transforms the indirect part of S: subtracting the direct correlation function removes the jump at
    contact and its ringing.
    """
    x = np.asarray(r_reduced, dtype=float)
    if packing < 1e-6:
        return (x >= 1.0).astype(float)
    return np.where(x >= 1.0, 1.0 + _indirect_correlation(x, packing), 0.0)


def _indirect_correlation(x: Array, packing: float) -> Array:
    """Return the indirect correlation gamma(r/a), smooth through contact."""
    q, weight = _indirect_spectrum(float(packing))
    if x.size <= MOST_KEPT:
        return np.reshape(_indirect_waves(np.ascontiguousarray(x, dtype=float).tobytes()) @ weight, x.shape)
    return np.array([j0(q * value) @ weight for value in x.ravel()]).reshape(x.shape)


@dataclass(frozen=True)
class CoreCorrection:
    """Correction that makes the Baus-Colot g(r) and S(q) consistent with an empty core; lengths in diameters.

    The closed form leaves a small g inside the core (0.001 at packing 0.1, up to 0.12 at 0.5). Setting it to zero
    without changing S breaks S = 1 + rho FT(g - 1), and the mean field and the diffuse light then disagree, by 0.7 % of
    the energy at packing 0.5. The area removed from the core moves to a layer `amplitude e^(-decay (r - 1))` outside,
    which preserves S(0) = 1/D; its height is the step from the closed-form contact value to the equation
    of state, Z = 1 + 2 eta g(1), as in Verlet and Weis for three dimensions.

    Attributes:
        amplitude, decay: layer parameters; amplitude 0 without correction.
        inside: nodes, and weights for the removed area, `[node]`.
        layer: nodes and weights in the layer.
    """

    amplitude: float
    decay: float
    inside: tuple[Array, Array]
    layer: tuple[Array, Array]

    def excess(self, x: Array) -> Array:
        """Added g at x >= 1."""
        return np.asarray(self.amplitude * np.exp(-self.decay * (np.maximum(x, 1.0) - 1.0)))

    def spectrum(self, q_reduced: Array, packing: float) -> Array:
        """Added S at Q."""
        nodes = np.concatenate([self.inside[0], self.layer[0]])
        weights = np.concatenate([-self.inside[1], self.layer[1]])
        parts = [j0(np.outer(q, nodes)) @ weights for q in np.array_split(q_reduced, 1 + q_reduced.size // 2000)]
        return np.asarray(8 * packing * np.concatenate(parts))


@lru_cache(maxsize=1)
def _core_rule() -> tuple[Array, Array]:
    """Nodes and weights for int_0^1 dx."""
    x, weight = gauss_legendre(60)
    return (x + 1) / 2, weight / 2


@lru_cache(maxsize=64)
def core_correction(packing: float) -> CoreCorrection:
    """Return the correction at a packing; zero if the closed form has an empty core."""
    x, weight = _core_rule()
    d, a = _compressibility(packing), baus_colot_scale(packing)
    direct = -d * (1 - a * a * packing + a * a * packing * _overlap(x / a))
    inside = weight * x * (1.0 + _indirect_correlation(x, packing) + direct)
    moved = float(inside.sum())
    z = (1.0 + sum(c * packing**k for k, c in enumerate(_VIRIAL, start=2))) / (1 - packing) ** 2
    step = (z - 1) / (2 * packing) - float(baus_colot_pair_correlation(1.0, packing))
    if moved < 1e-6 or step < 1e-6:
        return CoreCorrection(0.0, 1.0, (x, 0.0 * x), (x, 0.0 * x))
    # int_1^inf step e^{-decay (r-1)} r dr = moved
    decay = (step + np.sqrt(step**2 + 4 * step * moved)) / (2 * moved)
    t, w = np.polynomial.laguerre.laggauss(40)
    nodes, layer = 1.0 + t / decay, w * step / decay * (1.0 + t / decay)
    return CoreCorrection(step, float(decay), (x, inside), (nodes, layer * moved / layer.sum()))


@dataclass(frozen=True, eq=False)
class Structure:
    """Structure factor and pair correlation for an arrangement.

    Attributes:
        name: "hard-disk", "rsa", "points", ... for labels and provenance.
        density_per_nm2: particles per area.
        diameter_nm: smallest distance a between centres.
        q_per_nm, s: `[q]`, uniform from 0, the structure factor; 1 beyond the table.
        r_nm, h: `[r]`, ascending from `diameter_nm`, g(r) - 1; -1 inside, 0 beyond the table.
    """

    name: str
    density_per_nm2: float
    diameter_nm: float
    q_per_nm: Array
    s: Array
    r_nm: Array
    h: Array

    @property
    def packing(self) -> float:
        """p = density pi a^2 / 4."""
        return float(self.density_per_nm2 * np.pi * self.diameter_nm**2 / 4)

    def structure_factor(self, q_per_nm: ArrayLike) -> Array:
        """S at wavevector transfers in 1/nm, any shape; linear between table steps."""
        return np.interp(np.asarray(q_per_nm, dtype=float), self.q_per_nm, self.s, right=1.0)

    def pair_excess(self, r_nm: ArrayLike) -> Array:
        """g(r) - 1 at distances in nm."""
        r = np.asarray(r_nm, dtype=float)
        return np.where(r < self.diameter_nm, -1.0, np.interp(r, self.r_nm, self.h, right=0.0))


@lru_cache(maxsize=64)
def _hard_disk_excess(packing: float) -> tuple[Array, Array]:
    """Distances in diameters and g - 1 there, for one packing."""
    # finer steps near contact, where the layer of `CoreCorrection` decays within 1/20 diameter
    x = np.concatenate([np.linspace(1.0, 1.25, 126)[:-1], np.linspace(1.25, RANGE_IN_DIAMETERS, 373)])
    h = baus_colot_pair_correlation(x, packing) - 1.0
    if packing > SMALLEST_MENDED:
        h = h + core_correction(packing).excess(x)
    return x, h


def hard_disk_structure(density_per_nm2: float, packing: float, q_max_per_nm: float) -> Structure:
    """Tabulate hard disks in equilibrium; `q_max_per_nm` is the largest |q| used.

    S follows Baus and Colot with `CoreCorrection`, which changes it by less than 1e-4 at packing 0.1 and 0.023 at
    0.5, closer to Monte Carlo disks.

    Raises:
        NacreError: packing outside 0..0.7.
    """
    if packing <= 0 or packing > PACKING_LIMIT:
        raise NacreError(f"packing = {packing:g} is not allowed; it should be over 0 and at most {PACKING_LIMIT:g}")
    a = float(np.sqrt(4 * packing / (np.pi * density_per_nm2)))
    count = int(q_max_per_nm * a / S_STEP) + 202
    # whole blocks share cached Bessel functions for all diameters
    q = np.asarray(np.arange(0, -(-count // S_BLOCK) * S_BLOCK) * S_STEP, dtype=np.float64)
    s = np.concatenate([baus_colot(block, packing) for block in np.split(q, q.size // S_BLOCK)])[:count]
    q = q[:count]
    mend = core_correction(packing) if packing > SMALLEST_MENDED else None
    x, h = _hard_disk_excess(float(packing))
    if mend is not None and mend.amplitude > 0.0:
        s = s + mend.spectrum(q, packing)
    # near freezing the sum reaches -0.014
    return Structure("hard-disk", density_per_nm2, a, q / a, np.maximum(s, 0.0), x * a, h)
