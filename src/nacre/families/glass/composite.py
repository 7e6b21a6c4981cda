# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
"""Spheres in a matrix: materials, structure and effective index (Bruggeman, Maxwell Garnett).

One index n_e represents the whole composite in three places: as the medium around each sphere (Mie), in the scattering
vector, and at the layer's faces (Fresnel, refraction).

Photonic balls are micrometre-sized spheres of photonic glass in a binder, as in paints. A ball is far larger than the
wavelength: rays enter its face (Fresnel, refraction by the relative index of glass and binder) and walk inside through
the glass. The angular distribution of the exits is the phase function of a ball, the rest is absorbed, and the
cross-section is the geometric one. The paint is a medium of such scatterers in the binder.

A walk in a homogeneous medium has no extended scatterers, so the path inside a ball is added to the flight before it:
at volume fraction phi, the mean chord between balls is 4 R (1 - phi)/(3 phi) (Dirac 1943; see Coleman, J. Appl.
Probab. 6, 430 (1969)), and a ball displaces light by d along its direction on average; flights of the summed length
have the correct transport length. For straight transmission d is 4 R/3 and the sum 4 R/(3 phi).

Approximations: diffraction around balls is neglected, as usual for neighbours closer than the far field; flights are
exponentially distributed; light deflected by less than a few degrees counts as unscattered.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nacre.bsdf.lobes.platelet_layer import reflected
from nacre.bsdf.random_walk import roulette, sample_quantile
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.core.jit import compiled
from nacre.core.machine import in_threads
from nacre.families.glass.medium import GAUSS_NODES, PHASE_NODES, Medium, Spheres, gauss_rule, solve_medium
from nacre.matter.indices.constant import OpticalConstant

INDEX_NM = 550.0  # random walks refract all wavelengths with the index at this one
MAX_EXTINCTION = 0.1  # Im(n_e), above which light is absorbed within a few wavelengths


class Filling(Protocol):
    """Filling of a stratum: a composite, or balls."""

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelength range of all materials."""

    def effective_index(self, wavelengths_nm: Array) -> ComplexArray:
        """Index n + ik for refraction into the layer, `[wavelength]`."""

    @property
    def walk_index(self) -> float:
        """Index for the refraction of all wavelengths in random walks."""
        return max(float(np.abs(self.effective_index(np.array([INDEX_NM])))[0]), 1.0)


@dataclass(frozen=True)
class Composite(Filling):
    """Spheres in a matrix, independent of the wavelength.

    Attributes:
        materials: `[layer]`, core and optional shell.
        radii_nm: `[layer]`.
        deviation_nm: standard deviation of the outer radius.
        volume_fraction: filled by whole spheres.
        matrix: material between the spheres.
        matrix_k: added to the matrix's k by an absorber.
        absorber: an absorbing material and its share of the matrix, or None.
        mixing: "bruggeman" or "maxwell-garnett".
        structure: S over q d rather than hard spheres, or None.
    """

    materials: tuple[OpticalConstant, ...]
    radii_nm: tuple[float, ...]
    volume_fraction: float
    matrix: OpticalConstant
    deviation_nm: float = 0.0
    matrix_k: float = 0.0
    absorber: tuple[OpticalConstant, float] | None = None
    mixing: str = "bruggeman"
    structure: Callable[[Array], Array] | None = None

    @property
    def diameter_nm(self) -> float:
        """Mean diameter of whole spheres."""
        return 2.0 * self.radii_nm[-1]

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelength range of all materials."""
        ranges = [m.range_nm for m in (*self.materials, self.matrix)]
        return max(low for low, _ in ranges), min(high for _, high in ranges)

    def matrix_index(self, wavelengths_nm: Array) -> ComplexArray:
        """Index n + ik of matrix and absorber, `[wavelength]`."""
        n = self.matrix.n_complex(wavelengths_nm) + 1j * self.matrix_k
        if self.absorber is not None:
            material, share = self.absorber
            n = n + 1j * share * material.n_complex(wavelengths_nm).imag
        return np.asarray(n)

    def effective_index(self, wavelengths_nm: Array) -> ComplexArray:
        """Effective index n + ik, `[wavelength]`.

        Raises:
            NacreError: it cannot be solved, or absorbs too much for scattering by spheres.
        """
        matrix = self.matrix_index(wavelengths_nm)
        layers = np.stack([m.n_complex(wavelengths_nm) for m in self.materials])
        if self.mixing == "maxwell-garnett":
            n = maxwell_garnett(layers[0], matrix, self.volume_fraction)
        else:
            inner = self.volume_fraction * (self.radii_nm[0] / self.radii_nm[-1]) ** 3
            shares = [self.volume_fraction] if len(layers) == 1 else [inner, self.volume_fraction - inner]
            n = bruggeman(np.vstack([layers, matrix[None]]), np.array([*shares, 1.0 - self.volume_fraction]))
        if np.any(n.imag > MAX_EXTINCTION):
            at = int(np.argmax(n.imag))
            raise NacreError(
                f"the effective index {n[at].real:.3g} + {n[at].imag:.2g}i at {wavelengths_nm[at]:g} nm absorbs too "
                f"much for a photonic glass; its imaginary part should be at most {MAX_EXTINCTION:g}"
            )
        return n

    def medium(self, wavelengths_nm: Array) -> Medium:
        """Return the turbid medium."""
        return solve_medium(self.spheres(wavelengths_nm))

    def spheres(self, wavelengths_nm: Array) -> Spheres:
        """Return the spheres at given wavelengths."""
        layers = np.stack([m.n_complex(wavelengths_nm) for m in self.materials])
        return Spheres(
            wavelengths_nm, np.array(self.radii_nm), layers, self.effective_index(wavelengths_nm),
            self.volume_fraction, self.deviation_nm, self.structure,
        )  # fmt: skip


@dataclass(frozen=True)
class EffectiveDispersion:
    """Optical constant of a lossless medium with the modulus of the effective index, as the ambient of a base."""

    composite: Filling

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelength range of all materials."""
        return self.composite.range_nm

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return |n + ik| + 0i."""
        flat = np.ravel(wavelengths_nm)
        index = np.abs(self.composite.effective_index(flat)) + 0j
        return np.asarray(index.reshape(np.shape(wavelengths_nm)))


ROOT_TOL = 1e-9  # tolerance of a root against its bounds
NEWTON_STEPS = 3


def bruggeman(indices: ComplexArray, fractions: Array) -> ComplexArray:
    """Return the index n of sum_i f_i (e_i - e)/(e_i + 2 e) = 0, with e = n^2 (Bruggeman 1935).

    All phases are treated alike. The physical root has a real part between those of the phases, and no gain.

    Args:
        indices: `[phase, wavelength]`, n + ik.
        fractions: `[phase]`, volume fractions, which sum to one.

    Returns:
        `[wavelength]`.

    Raises:
        NacreError: no physical root, as with metals.

    Example:
        >>> half = np.array([0.5, 0.5])
        >>> round(float(bruggeman(np.array([[1.59 + 0j], [1.0]]), half)[0].real), 5)
        1.28402
    """
    present = fractions > 0
    eps, share = indices[present] ** 2, fractions[present]
    low, high = indices[present].real.min(axis=0), indices[present].real.max(axis=0)
    permittivity = np.empty(indices.shape[1], dtype=complex)
    for i in range(indices.shape[1]):
        roots = np.sqrt(np.roots(_polynomial(eps[:, i], share)).astype(complex))
        roots = np.where(roots.real < 0, -roots, roots)
        fits = (roots.real >= low[i] - ROOT_TOL) & (roots.real <= high[i] + ROOT_TOL) & (roots.imag >= -ROOT_TOL)
        if not np.any(fits):
            raise NacreError(
                "the effective index cannot be solved: no Bruggeman root lies between the indices "
                f"{low[i]:.4g} and {high[i]:.4g} of the phases"
            )
        mean = np.sum(share * np.sqrt(eps[:, i]))
        near = roots[fits][np.argmin(np.abs(roots[fits] - mean))]
        permittivity[i] = _polished(near**2, eps[:, i], share)
    n = np.sqrt(permittivity)
    return np.asarray(n.real + 1j * np.maximum(n.imag, 0.0))


def _polynomial(eps: ComplexArray, share: Array) -> ComplexArray:
    """Return the coefficients in e, highest first, of the sum without denominators."""
    total = np.zeros(len(eps) + 1, dtype=complex)
    for i, f in enumerate(share):
        part = f * np.array([-1.0, eps[i]], dtype=complex)
        for j in range(len(eps)):
            if j != i:
                part = np.polymul(part, np.array([2.0, eps[j]], dtype=complex))
        total += part
    return total


def _polished(e: complex, eps: ComplexArray, share: Array) -> complex:
    """Refine a root by Newton's method on the sum, as polynomial roots lose digits."""
    for _ in range(NEWTON_STEPS):
        value = np.sum(share * (eps - e) / (eps + 2 * e))
        slope = np.sum(-3 * share * eps / (eps + 2 * e) ** 2)
        e = e - value / slope
    return complex(e)


def maxwell_garnett(inclusion: ComplexArray, matrix: ComplexArray, fraction: float) -> ComplexArray:
    """Return the index of inclusions in a host matrix (Maxwell Garnett 1904).

    Args:
        inclusion, matrix: `[wavelength]`, n + ik.
        fraction: volume fraction of the inclusions.

    Example:
        >>> round(float(maxwell_garnett(np.array([1.59 + 0j]), np.array([1.0 + 0j]), 0.5)[0].real), 5)
        1.26845
    """
    p, m = inclusion**2, matrix**2
    e = m * (p + 2 * m + 2 * fraction * (p - m)) / (p + 2 * m - fraction * (p - m))
    return np.asarray(np.sqrt(e))


TURN_NODES = 61  # uniform in sin(theta/2)
WALKERS = 40_000  # per wavelength, with the same random numbers: noise without colour
SEED = 20


@dataclass(frozen=True)
class BallLight:
    """Light scattered by one ball, relative to the light on its cross-section.

    Attributes:
        density: `[wavelength, turn]`, 1/sr, scattered light, piecewise linear over uniform nodes of sin(theta/2).
        passed: `[wavelength]`, share deflected by less than arccos `PASSED_COS`.
        absorbed: `[wavelength]`, share.
        carried: `[wavelength]`, mean displacement along the old direction, in radii.
    """

    density: Array
    passed: Array
    absorbed: Array
    carried: Array


PASSED_COS = 1.0 - 1.0 / (PHASE_NODES - 1)  # half a cell of the tabulated phase function


def ball_light(medium: Medium, ratio: Array, radius_nm: float, walkers: int = WALKERS, seed: int = SEED) -> BallLight:
    """Walk through one ball.

    Args:
        medium: glass inside.
        ratio: `[wavelength]`, index of the glass over the binder's.
        radius_nm: ball radius.
        walkers: for each wavelength.
        seed: another seed gives independent noise.
    """
    quantiles = medium.quantiles()
    turns = np.linspace(0.0, 1.0, TURN_NODES)
    # quadrature weights of the nodes: 2 pi dcos = 8 pi s ds
    step = turns[1]
    share = 8 * np.pi * step * turns
    share[0], share[-1] = 8 * np.pi * step**2 / 6, 8 * np.pi * step * (0.5 - step / 6)

    def solve(band: int) -> tuple[Array, float, float, float]:
        tally = np.zeros(TURN_NODES)
        depths = float(medium.scattering[band]) * radius_nm, float(medium.absorption[band]) * radius_nm
        passed, absorbed, carried = _walk_ball(
            seed, walkers, float(ratio[band]), depths, quantiles[band], PASSED_COS, tally
        )
        leaves = passed + float(tally.sum())
        return tally / (walkers * share), passed / walkers, absorbed / walkers, carried / max(leaves, 1e-9)

    results = in_threads(solve, range(len(ratio)))
    passed, absorbed, carried = (np.array([f[i] for f in results]) for i in (1, 2, 3))
    return BallLight(np.stack([f[0] for f in results]), passed, absorbed, carried)


@compiled(nogil=True, fastmath=True)
def _add(out, cos, carried):
    """Add light deflected to a cosine to the two nodes of sin(theta/2) around it."""
    at = math.sqrt(0.5 * (1.0 - cos)) * (out.size - 1)
    low = min(int(at), out.size - 2)
    out[low] += carried * (1.0 - at + low)
    out[low + 1] += carried * (at - low)


@compiled(nogil=True, fastmath=True)
def _deflect(dx, dy, dz, quantile):
    """Draw the direction after a scattering event from the quantiles of the phase function's cosine."""
    mu = sample_quantile(quantile)
    side = math.sqrt(max(1.0 - mu * mu, 0.0))
    phi = 2.0 * math.pi * np.random.random()
    u, v = side * math.cos(phi), side * math.sin(phi)
    # a frame of the old direction (Duff et al., JCGT 6, 1 (2017))
    sign = 1.0 if dz >= 0.0 else -1.0
    p = -1.0 / (sign + dz)
    q = dx * dy * p
    ex = u * (1.0 + sign * dx * dx * p) + v * q + mu * dx
    ey = u * sign * q + v * (sign + dy * dy * p) + mu * dy
    ez = -u * sign * dx - v * dy + mu * dz
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    return ex / length, ey / length, ez / length


@compiled(nogil=True, fastmath=True)
def _follow(b, c, ratio, depths, quantile):
    """Follow light from its entry at impact `b` until it leaves: weight, cosine, exit height, absorbed share."""
    scatter, absorb = depths
    share, cos_t = reflected(c, ratio)
    carried, absorbed = 1.0 - share, 0.0
    x, y, z = b, 0.0, -c
    a = c / ratio - cos_t
    dx, dy, dz = a * b, 0.0, 1.0 / ratio - a * c  # refracted: d/ratio + (c/ratio - cos_t) n
    while carried > 0.0:
        path = -math.log(1.0 - np.random.random()) / scatter if scatter > 0.0 else 1e300
        along = x * dx + y * dy + z * dz
        reach = -along + math.sqrt(max(along * along + 1.0 - x * x - y * y - z * z, 0.0))
        step = min(path, reach)
        passed = math.exp(-absorb * step)
        absorbed += carried * (1.0 - passed)
        x, y, z = x + step * dx, y + step * dy, z + step * dz
        carried = roulette(carried * passed)
        if carried == 0.0:
            break
        if path < reach:
            dx, dy, dz = _deflect(dx, dy, dz, quantile)
            continue
        length = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        cos = min(max(x * dx + y * dy + z * dz, 0.0), 1.0)
        share, cos_t = reflected(cos, 1.0 / ratio)
        if np.random.random() >= share:
            return carried, max(-1.0, min(1.0, dz * ratio + (cos_t - cos * ratio) * z)), z, absorbed
        dx, dy, dz = dx - 2.0 * cos * x, dy - 2.0 * cos * y, dz - 2.0 * cos * z
    return 0.0, 1.0, 0.0, absorbed


@compiled(nogil=True, fastmath=True)
def _walk_ball(seed, count, ratio, depths, quantile, forward, out):
    """Walk through a ball of radius 1; tally light in `out[turn]`; return the passed, absorbed and carried sums.

    Light is incident along +z, stratified over the ball's cross-section: at impact b the normal is (b, 0, -c). The
    face's reflection is exact and excluded from the carried sum.
    """
    np.random.seed(seed)
    passed, absorbed, carried_on = 0.0, 0.0, 0.0
    for walker in range(count):
        b2 = (walker + np.random.random()) / count
        b, c = math.sqrt(b2), math.sqrt(1.0 - b2)
        share, _ = reflected(c, ratio)
        mirrored = 1.0 - 2.0 * c * c
        if mirrored > forward:
            passed += share
        else:
            _add(out, mirrored, share)
        carried, cos, height, loss = _follow(b, c, ratio, depths, quantile)
        absorbed += loss
        carried_on += carried * (height + c)
        if cos > forward:
            passed += carried
        else:
            _add(out, cos, carried)
    return passed, absorbed, carried_on


@dataclass(frozen=True)
class Balls(Filling):
    """Photonic balls in a binder.

    Attributes:
        glass: inside the balls.
        radius_nm: ball radius.
        volume_fraction: filled by balls.
        binder: between the balls, possibly absorbing.
        walkers: per wavelength, through one ball.
    """

    glass: Composite
    radius_nm: float
    volume_fraction: float
    binder: OpticalConstant
    walkers: int = WALKERS

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelength range of all materials."""
        low, high = self.glass.range_nm
        return max(low, self.binder.range_nm[0]), min(high, self.binder.range_nm[1])

    def effective_index(self, wavelengths_nm: Array) -> ComplexArray:
        """Index n + ik of the binder, `[wavelength]`."""
        return self.binder.n_complex(wavelengths_nm)

    def medium(self, wavelengths_nm: Array, moments: int = 48, seed: int = SEED) -> Medium:
        """Return the balls in their binder as a medium."""
        inside = self.glass.medium(wavelengths_nm)
        binder = self.effective_index(wavelengths_nm)
        light = ball_light(inside, inside.index / binder.real, self.radius_nm, self.walkers, seed)
        flight = 4 / 3 * (1 - self.volume_fraction) / self.volume_fraction
        collisions = 1 / (self.radius_nm * (flight + np.clip(light.carried, 0.0, 4 / 3)))
        nodes = np.linspace(-1.0, 1.0, PHASE_NODES)
        table = _at_cosines(light.density, nodes)
        step = nodes[1] - nodes[0]
        total = 2 * np.pi * step * (table.sum(axis=1) - 0.5 * (table[:, 0] + table[:, -1]))
        cosines, weights = gauss_rule(GAUSS_NODES)
        # any phase function for balls without scattering
        scatters = (total > 0)[:, None]
        phase = np.where(scatters, table / np.where(scatters, total[:, None], 1.0), 0.25 / np.pi)
        shares = 2 * np.pi * weights * np.stack([np.interp(cosines, nodes, row) for row in phase])
        shares = shares / shares.sum(axis=1, keepdims=True)
        between = (1 - self.volume_fraction) * 4 * np.pi * binder.imag / wavelengths_nm
        return Medium(
            wavelengths_nm=wavelengths_nm,
            index=np.abs(binder),
            # scattering of the table as interpolated, without the forward light that it misses
            scattering=collisions * total,
            absorption=collisions * light.absorbed + between,
            asymmetry=shares @ cosines,
            phase=phase,
            moments=shares @ np.polynomial.legendre.legvander(cosines, moments - 1),
        )


def _at_cosines(density: Array, cosines: Array) -> Array:
    """Interpolate `[wavelength, turn]` to cosines."""
    turns = np.linspace(0.0, 1.0, density.shape[1])
    at = np.sqrt(np.maximum(0.5 * (1 - cosines), 0.0))
    return np.stack([np.interp(at, turns, row) for row in density])
