"""One particle above a planar stack at one wavelength: dressed T-matrix, far fields and cross-sections.

The stack reflects the particle's radiation back to it: one block W_m per azimuthal order. For a sphere, whose
T-matrix is diagonal (Mie), the dressed response is M_m = q (1 - q W_m q)^-1 q with q = sqrt(T), which stays balanced
at high multipole orders. Lengths in nm, z = 0 at the stack top, centre at z = d.

Outgoing multipoles diverge inside the circumscribing sphere. If that sphere cuts the stack, the complete Sommerfeld
integral diverges with the multipole order. Multipoles up to L resolve in-plane wavenumbers up to about L / (k r), r the
sphere radius, so the integral is truncated in proportion (Egel et al.), and two cutoffs must agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray, gauss_legendre
from nacre.core.errors import UnsupportedError
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_order
from nacre.families.metasurface.tmatrix.special_functions import adjoint, mirrored, plane_wave_vectors
from nacre.families.metasurface.tmatrix.substrate import Substrate

# cutoffs over L / (k r): 0.1 % to 1 % off finite elements at L = 10, for discs and flat spheroids
CUT, LOWER_CUT = 0.6, 0.5
DETOUR = 0.3  # contour depth below the guided modes, in k
NODES = 240


def wavenumber_cutoff(lmax: int, wavenumber: float, circumscribing_nm: float, share: float = CUT) -> float:
    """Return the in-plane wavenumber over k at which the integral is truncated."""
    return max(share * lmax / (wavenumber * circumscribing_nm), 1.2)


def truncated_reflection_operator(
    surface: Substrate, centre_nm: float, lmax: int, mmax: int, cut: float, nodes: int = NODES
) -> ComplexArray:
    """Return W_m, `[m, n, n']`, as `reflection_operator` but from in-plane wavenumbers up to `cut` k.

    4 int_0^cut kap dkap/(k kz) e^(2ikzd) sum_pol Bdag(kz) R B(-kz), on a contour below the guided modes.
    """
    x, weight = gauss_legendre(nodes)
    angle = np.pi * (x + 1) / 2  # nodes are dense at both contour ends
    kappa = cut * (1 - np.cos(angle)) / 2 - 1j * DETOUR * np.sin(angle)
    slope = (cut * np.sin(angle) / 2 - 1j * DETOUR * np.cos(angle)) * np.pi / 2
    w = np.sqrt((1 - kappa) * (1 + kappa))
    w = np.where(w.imag < 0, -w, w)
    b = plane_wave_vectors(w, lmax, mmax, kappa)
    measure = 4 * weight * slope * kappa / w
    shape = (mmax + 1, 2 * lmax, -1)
    out = np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    for left, right in surface.reflection_at(centre_nm, w).pairs(b):
        rows = (left * measure).transpose(0, 2, 1, 3).reshape(shape)
        out += rows @ right.transpose(0, 2, 1, 3).reshape(shape).transpose(0, 2, 1)
    return out


AZIMUTHAL_ORDERS = 4  # |m| <= 4 is converged below 2e-5 for radii up to 95 nm in the visible
ORDER_LADDER = (4, 6, 8, 10, 12, 15, 18, 22, 27, 32, 40)
ORDER_TOLERANCE = 1e-3
LARGEST_LOG = 660.0  # exponents overflow double at 709
Coefficients = Callable[[int], ComplexArray]


class MultipoleConvergenceError(UnsupportedError):
    """The multipole series for a particle on a stack does not converge.

    Attributes:
        change: remaining far-field change at the last `order`.
    """

    def __init__(self, message: str, change: float, order: int) -> None:
        super().__init__(message)
        self.change, self.order = change, order


@lru_cache(maxsize=64)
def _path_rule(count: int) -> tuple[Array, Array]:
    """Nodes and weights for int_0^1 du for the path w = 1 + i tmax u^2."""
    x, weights = gauss_legendre(count)
    return (x + 1) / 2, weights / 2


def reflection_operator(
    surface: Substrate, centre_nm: float, lmax: int, mmax: int, nodes: int | None = None
) -> ComplexArray:
    """Return W_m, `[m, n, n']`: reflection by the stack for radiated multipoles, a Sommerfeld integral.

    The path w = kz/k = 1 + i t stays at least 1 away from every pole and branch point for a passive stack, so
    one Gauss rule serves glass, films and metals. High-order W_m contains all lower ones and is cached per height.

    Args:
        surface: the stack.
        centre_nm: particle centre height.
        lmax, mmax: highest multipole and azimuthal orders.
        nodes: quadrature nodes; 48 + 2 lmax by default (error below 1e-8).
    """
    if surface.is_absent:
        return np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    cached = surface.operators.get(centre_nm)
    if nodes is None and cached is not None and len(cached) > mmax and cached.shape[1] >= 2 * lmax:
        orders = np.arange(lmax)
        rows = np.concatenate([orders, cached.shape[1] // 2 + orders])
        return np.asarray(cached[: mmax + 1, rows[:, None], rows])
    # two mirrors give two distances
    u, weight = _path_rule(nodes or (48 if surface.inner_nm == 0.0 else 96) + 2 * lmax)
    kd = surface.inner_wavenumber * surface.mirror_distance_nm(centre_nm)
    t_max = (2 * lmax + 46) / (2 * kd)
    t = t_max * u**2
    w = 1.0 + 1j * t
    # sin from t, since 1 - w^2 loses digits near the axis
    sine = np.sqrt(t * (t - 2j))
    b = plane_wave_vectors(w, lmax, mmax, sine)
    measure = -4j * weight * 2 * t_max * u
    shape = (mmax + 1, 2 * lmax, -1)
    operator = np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    for left, right in surface.reflection_at(centre_nm, w).pairs(b):
        rows = (left * measure).transpose(0, 2, 1, 3).reshape(shape)
        operator += rows @ right.transpose(0, 2, 1, 3).reshape(shape).transpose(0, 2, 1)
    if nodes is None:
        surface.operators[centre_nm] = operator
    return np.asarray(operator)


def dressed_matrix(t_matrix: ComplexArray, w_blocks: ComplexArray) -> ComplexArray:
    """Return M_m = (T^-1 - W_m)^-1, `[m, n, n']`.

    Args:
        t_matrix: diagonal, `[n]`, or blocks, `[m, n, n']`. The diagonal form is q (1 - q W_m q)^-1 q with q = sqrt(T);
            a full T is balanced by its diagonal roots: T = q t q, M = q (1 - t q W_m q)^-1 t q.
    """
    if t_matrix.ndim == 3:
        t = t_matrix[: len(w_blocks)]
        q = np.sqrt(np.abs(np.diagonal(t, axis1=1, axis2=2)))
        q = np.where(q > 0, q, 1.0)[:, :, None]
        back = np.swapaxes(q, 1, 2)
        t = t / q / back
        return np.asarray(q * np.linalg.solve(np.eye(t.shape[-1]) - t @ (q * w_blocks * back), t) * back)
    q = np.sqrt(t_matrix)
    system = np.eye(len(q)) - q[:, None] * w_blocks * q
    return q[:, None] * np.linalg.solve(system, np.broadcast_to(np.diag(q), w_blocks.shape))


@dataclass(frozen=True)
class ParticleOnStack:
    """An axisymmetric particle above a stack at one wavelength.

    Attributes:
        surface: the stack.
        centre_nm: centre height.
        t_matrix: `[n]`, n = (tau, l): -b_l, then -a_l from `mie_coefficients`; or blocks `[m, n, n']`.
        mmax: highest azimuthal order.
        cut: in-plane wavenumber over k that truncates the coupling with the stack (optional).
        neighbours: additional reflection by neighbours, `[m, n, n']`, see `ladder` (optional).
    """

    surface: Substrate
    centre_nm: float
    t_matrix: ComplexArray
    mmax: int = AZIMUTHAL_ORDERS
    cut: float | None = None
    neighbours: ComplexArray | None = None

    @property
    def lmax(self) -> int:
        """Highest multipole order."""
        return multipole_order(self.t_matrix)

    @cached_property
    def coupling(self) -> ComplexArray:
        """The reflection operator W_m, `[m, n, n']`."""
        if self.cut is not None and not self.surface.is_absent:
            return truncated_reflection_operator(self.surface, self.centre_nm, self.lmax, self.mmax, self.cut)
        return reflection_operator(self.surface, self.centre_nm, self.lmax, self.mmax)

    @cached_property
    def dressed(self) -> ComplexArray:
        """The dressed response M_m, `[m, n, n']`."""
        if self.neighbours is None:
            return dressed_matrix(self.t_matrix, self.coupling)
        return dressed_matrix(self.t_matrix, self.coupling + self.neighbours)

    def directions(self, cosines: ArrayLike, below: bool = False, sines: ArrayLike | None = None) -> Directions:
        """Return excitation and emission vectors at `cosines` > 0 in the ambient, or in the substrate if `below`."""
        return Directions.build(self.surface, self.centre_nm, self.lmax, self.mmax, cosines, below, sines)

    def harmonics(self, scattered: Directions, incident: Directions) -> ComplexArray:
        """Return the far-field harmonics G_m in nm, `[m, pol_s, scattered, pol_i, incident]`.

        F_qp = sum_m G_m (cos m dphi if q == p else i sin m dphi), see `amplitude`.
        """
        return emission_harmonics(
            scattered.emission, apply_response(self.dressed, incident.excitation), self.surface.inner_wavenumber
        )


@dataclass(frozen=True)
class Directions:
    """Excitation vectors v and emission vectors u at directions on one side.

    Attributes:
        cosines: `[angle]`, against the normal, positive, in the medium on that side.
        transverse: `[angle]`, in-plane wavevector over the ambient k.
        inner: `[angle]`, in-plane wavevector over k around the particles (the ambient k unless embedded).
        inner_cosines: `[angle]`, kz/k there; imaginary beyond the critical angle.
        index: relative index on that side.
        below: whether it is the substrate side.
        excitation: v, `[m, pol, n, angle]`.
        emission: u, `[m, pol, n, angle]`.
        reflection: bare stack amplitude for light from that side, `[pol, angle]`.
        transmission_up: bare stack amplitude for light from the substrate; None above.
    """

    cosines: Array
    transverse: Array
    inner: Array
    inner_cosines: ComplexArray
    index: float
    below: bool
    excitation: ComplexArray
    emission: ComplexArray
    reflection: ComplexArray
    transmission_up: ComplexArray | None

    @classmethod
    def build(
        cls,
        surface: Substrate,
        centre_nm: float,
        lmax: int,
        mmax: int,
        cosines: ArrayLike,
        below: bool = False,
        sines: ArrayLike | None = None,
    ) -> Directions:
        """Compute the vectors for plane waves incident from, or emitted to, one side.

        Raises:
            UnsupportedError: `below` with an absorbing substrate.
        """
        cosines = np.asarray(cosines, dtype=float)
        sines_real = np.sqrt((1 - cosines) * (1 + cosines)) if sines is None else np.asarray(sines, dtype=float)
        index = 1.0
        if below:
            if not surface.is_transparent:
                raise UnsupportedError("light cannot arrive through, or leave to, an absorbing substrate")
            index = surface.index_below
        transverse = index * sines_real
        inside = surface.ambient_index / surface.inner_index
        inner = transverse * inside
        if below or inside != 1.0:
            w: ComplexArray = np.sqrt((1.0 - inner**2).astype(complex))
            w = np.where(w.imag < 0, -w, w)
        else:
            w = cosines.astype(complex)
        up = plane_wave_vectors(w, lmax, mmax, inner.astype(complex))
        down = mirrored(up)
        ahead, back = (up, down) if below else (down, up)
        light = surface.incident_waves(centre_nm, cosines, w, below)
        first = light.ahead[None, :, None, :]
        excitation = adjoint(ahead) * first
        emission = back * first  # emission is the reversed excitation
        if light.back is not None:
            second = light.back[None, :, None, :]
            excitation = excitation + adjoint(back) * second
            emission = emission + ahead * second
        excitation *= 4.0
        return cls(
            cosines, transverse, inner, w, index, below, excitation, emission, light.reflection, light.transmission_up
        )


def apply_response(dressed: ComplexArray, excitation: ComplexArray) -> ComplexArray:
    """Return M_m v, `[m, pol, n, angle]`."""
    return np.matmul(dressed[:, None], excitation)


def emission_harmonics(emission: ComplexArray, response: ComplexArray, wavenumber: float) -> ComplexArray:
    """Return eps_m u_m . x_m / k in nm, `[m, pol_s, s, pol_i, i]`, for u `[m, pol, n, s]` and x `[m, pol, n, i]`.

    k is the wavenumber around the particles.
    """
    mcount, _, n, incident = response.shape
    left = emission.transpose(0, 1, 3, 2).reshape(mcount, -1, n)
    right = response.transpose(0, 2, 1, 3).reshape(mcount, n, -1)
    weight = np.full((mcount, 1, 1), 2.0 / wavenumber)
    weight[0] = 1.0 / wavenumber
    return ((left @ right) * weight).reshape(mcount, 2, emission.shape[3], 2, incident)


def amplitude(harmonics: ComplexArray, dphi_rad: ArrayLike) -> ComplexArray:
    """Return F in nm, `[pol_s, scattered, pol_i, incident, dphi]`, from its harmonics."""
    phi = np.asarray(dphi_rad, dtype=float)
    m = np.arange(harmonics.shape[0])[:, None]
    co, cross = np.cos(m * phi), 1j * np.sin(m * phi)
    moved = np.moveaxis(harmonics, 0, -1)
    out = np.empty((*moved.shape[:-1], phi.size), dtype=complex)
    for q in range(2):
        for p in range(2):
            out[q, :, p] = moved[q, :, p] @ (co if q == p else cross)
    return out


def beam_extinction(
    harmonics: ComplexArray, beam: ComplexArray, wavenumber: float, incident_index: float = 1.0
) -> Array:
    """Power removed from one coherent beam per incident irradiance, nm^2, `[pol, angle]` (optical theorem).

    Args:
        harmonics: for equal incident and scattered directions, `[m, pol, angle, pol, angle]`.
        beam: beam amplitude without the particle, `[pol, angle]`.
        wavenumber: ambient k.
        incident_index: relative index on the incident side.
    """
    summed = harmonics.sum(axis=0)
    forward = np.stack([np.diagonal(summed[pol, :, pol]) for pol in range(2)])
    return -4 * np.pi / (wavenumber * incident_index) * (beam.conj() * forward).real


def beam_extinctions(sphere: ParticleOnStack, incident: Directions) -> tuple[Array, Array]:
    """Extinction from the reflected and the transmitted beam, `[pol, angle]`."""
    k, inner, index = sphere.surface.wavenumber, sphere.surface.inner_wavenumber, incident.index
    solved = apply_response(sphere.dressed, incident.excitation)
    reflected = beam_extinction(emission_harmonics(incident.emission, solved, inner), incident.reflection, k, index)
    if not sphere.surface.is_transparent:
        return reflected, np.zeros_like(reflected)
    passes = incident.transverse < min(1.0, sphere.surface.index_below)
    transmitted = np.zeros_like(reflected)
    if incident.below:
        sines = incident.transverse[passes]
        out = sphere.directions(np.sqrt((1 - sines) * (1 + sines)), sines=sines)
        assert incident.transmission_up is not None  # set for all directions below
        beam = incident.transmission_up[:, passes]
    else:
        sines = incident.transverse[passes] / sphere.surface.index_below
        out = sphere.directions(np.sqrt((1 - sines) * (1 + sines)), True, sines)
        assert out.transmission_up is not None
        beam = out.transmission_up * incident.cosines[passes] / (out.index * out.cosines)
    sent = emission_harmonics(out.emission, solved[..., passes], inner)
    transmitted[:, passes] = beam_extinction(sent, beam, k, index)
    return reflected, transmitted


def extinction(sphere: ParticleOnStack, incident: Directions) -> Array:
    """Power removed from both coherent beams per incident irradiance, nm^2, `[pol, angle]`."""
    reflected, transmitted = beam_extinctions(sphere, incident)
    return reflected + transmitted


def hemisphere_rule(count: int, index: float = 1.0) -> tuple[Array, Array]:
    """Gauss nodes and weights of int_0^1 dmu on a side with the given relative index, ascending.

    The rule is split at a denser substrate's critical angle, a square-root kink in the far field.
    """
    x, weight = _path_rule(count)
    if index <= 1.0 + 1e-9:
        return x, weight
    critical = np.sqrt(1 - 1 / index**2)
    # u^2 clusters nodes beside the kink and removes the root
    low_mu, low_weight = critical * (1 - x**2), weight * 2 * x * critical
    high_mu, high_weight = critical + (1 - critical) * x**2, weight * 2 * x * (1 - critical)
    order = np.argsort(np.concatenate([low_mu, high_mu]))
    return np.concatenate([low_mu, high_mu])[order], np.concatenate([low_weight, high_weight])[order]


def choose_order(
    surface: Substrate,
    centre_nm: float,
    coefficients: Coefficients,
    tolerance: float = ORDER_TOLERANCE,
    mmax: int = AZIMUTHAL_ORDERS,
) -> int:
    """Return the lowest multipole order whose doubling changes the far field by at most `tolerance`.

    The change is the relative L2 norm for d sigma/d Omega over scattering angles, the maximum over four incidences and
    two polarisations.

    Args:
        coefficients: function (lmax) that returns the diagonal T, `[n]`.

    Raises:
        MultipoleConvergenceError: no order up to 40, as for a metal sphere touching a high-index solid.
    """
    largest = _representable(surface.inner_wavenumber * surface.mirror_distance_nm(centre_nm), 2 * ORDER_LADDER[-1])
    begin = 0  # first untested ladder rung
    for top in (12, 24, largest):
        t_top = coefficients(top)
        blocks = reflection_operator(surface, centre_nm, top, mmax)
        directions = probes(surface, centre_nm, top, mmax)
        solved: dict[int, Array] = {}
        worst = np.inf
        rungs = [o for o in ORDER_LADDER if 2 * o <= top]
        # the last rung is repeated for the change in the error message
        for order in rungs[min(begin, len(rungs) - 1) :]:
            for l in (order, 2 * order):
                if l not in solved:
                    solved[l] = _truncated_pattern(t_top, blocks, directions, l)
            worst = pattern_change(solved[order], solved[2 * order])
            if worst <= tolerance:
                return order
        begin = len(rungs)
    raise MultipoleConvergenceError(
        f"the multipole series does not converge to {tolerance:g} (order {order} still changes by {worst:.2g} when "
        "doubled): a metal sphere that touches a solid squeezes the field into the contact point",
        worst,
        order,
    )


def order_change(surface: Substrate, centre_nm: float, coefficients: Coefficients, low: int, high: int) -> float:
    """Return the far-field change for a sphere between two multipole orders; see `choose_order`."""
    high = _representable(surface.inner_wavenumber * surface.mirror_distance_nm(centre_nm), high)
    t_top, blocks = coefficients(high), reflection_operator(surface, centre_nm, high, AZIMUTHAL_ORDERS)
    directions = probes(surface, centre_nm, high, AZIMUTHAL_ORDERS)
    return pattern_change(*(_truncated_pattern(t_top, blocks, directions, l) for l in (low, high)))


def probes(surface: Substrate, centre_nm: float, lmax: int, mmax: int) -> tuple[Directions, Directions]:
    """Return incident and scattered directions for comparing orders."""
    angles = np.array([0.0, 30.0, 60.0, 80.0]), np.arange(5.0, 90.0, 12.0)
    light, views = (Directions.build(surface, centre_nm, lmax, mmax, np.cos(np.radians(each))) for each in angles)
    return light, views


def pattern_change(of: Array, to: Array) -> float:
    """Return the largest relative L2 difference between two `probe_pattern` over incidences and polarisations."""
    axes = (0, 1, 4)
    return float(np.max(np.sqrt(np.sum((of - to) ** 2, axis=axes) / np.maximum(np.sum(to**2, axis=axes), 1e-300))))


def _representable(kd: float, top: int) -> int:
    """Return the highest even order <= `top` at which W_m ~ (2l)! 4^l / (2kd)^(2l+1) fits double."""
    while math.lgamma(2 * top + 1) + 2 * top * math.log(2) - (2 * top + 1) * math.log(2 * kd) > LARGEST_LOG:
        top -= 2
    return top


def probe_pattern(dressed: ComplexArray, incident: Directions, scattered: Directions) -> Array:
    """Return k^2 d sigma/d Omega at the `probes` directions, `[pol_s, s, pol_i, i, phi]`, from M_m.

    `incident` and `scattered` may have more multipoles than `dressed`.
    """
    l, top = dressed.shape[-1] // 2, incident.excitation.shape[2] // 2
    rows = np.concatenate([np.arange(l), top + np.arange(l)])
    response = apply_response(dressed, incident.excitation[: len(dressed), :, rows])
    fields = emission_harmonics(scattered.emission[: len(dressed), :, rows], response, 1.0)
    return np.asarray(np.abs(amplitude(fields, np.linspace(0.0, np.pi, 9))) ** 2)


def _truncated_pattern(
    t_top: ComplexArray, blocks: ComplexArray, directions: tuple[Directions, Directions], l: int
) -> Array:
    rows = np.concatenate([np.arange(l), len(t_top) // 2 + np.arange(l)])
    return probe_pattern(dressed_matrix(t_top[rows], blocks[:, rows][:, :, rows]), *directions)


def rounded_up(value: float) -> float:
    """Round up to one significant digit."""
    unit = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / unit) * unit)
