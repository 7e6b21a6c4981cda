"""What a stack sends back to a flat particle whose circumscribing sphere cuts it.

Outgoing multipoles diverge inside that sphere, so the whole Sommerfeld integral of them does too: with the order, not
with the nodes. A field of multipoles up to L says nothing of waves faster than some L / (k r) in the plane, r the
radius of the sphere. The integral is cut in proportion (the rule of Egel et al. for particles that are no spheres), and
where two cuts disagree there is no answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_order
from nacre.families.metasurface.tmatrix.special_functions import adjoint, mirrored, plane_wave_vectors
from nacre.families.metasurface.tmatrix.substrate import Substrate

CUT, LOWER_CUT = 0.6, 0.5  # of L / (k r): at L = 10, .1 % to 1 % of finite elements for discs and flat spheroids
DETOUR = 0.3  # below guided modes, in k
NODES = 240


def cut_of(lmax: int, wavenumber: float, circumscribing_nm: float, share: float = CUT) -> float:
    """Return the in-plane wavenumber over k that ends the integral."""
    return max(share * lmax / (wavenumber * circumscribing_nm), 1.2)


def cut_reflection_operator(
    surface: Substrate, centre_nm: float, lmax: int, mmax: int, cut: float, nodes: int = NODES
) -> ComplexArray:
    """Return W_m, `[m, n, n']`, as `sphere.reflection_operator` but of the in-plane wavenumbers up to `cut` k alone.

    4 int_0^cut kap dkap/(k kz) e^(2ikzd) sum_pol Bdag(kz) R B(-kz), on a path below the guided modes.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    angle = np.pi * (x + 1) / 2  # nodes crowd where the path begins and ends, and kz has its root on the way
    kappa = cut * (1 - np.cos(angle)) / 2 - 1j * DETOUR * np.sin(angle)
    slope = (cut * np.sin(angle) / 2 - 1j * DETOUR * np.cos(angle)) * np.pi / 2
    w = np.sqrt((1 - kappa) * (1 + kappa))
    w = np.where(w.imag < 0, -w, w)
    b = plane_wave_vectors(w, lmax, mmax, kappa)
    measure = 4 * weight * slope * kappa / w
    shape = (mmax + 1, 2 * lmax, -1)
    out = np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    for left, right in surface.echo(centre_nm, w).pairs(b):
        rows = (left * measure).transpose(0, 2, 1, 3).reshape(shape)
        out += rows @ right.transpose(0, 2, 1, 3).reshape(shape).transpose(0, 2, 1)
    return out


# One sphere above or on a planar stack: its dressed T-matrix, far fields and cross-sections at one wavelength.

AZIMUTHAL_ORDERS = 4  # |m| <= 4 is converged below 2e-5 for radii up to 95 nm in the visible
ORDER_LADDER = (4, 6, 8, 10, 12, 15, 18, 22, 27, 32, 40)
ORDER_TOLERANCE = 1e-3
LARGEST_LOG = 660.0  # of 709, where double ends
Coefficients = Callable[[int], ComplexArray]


class ConvergenceRefusal(UnsupportedError):
    """The multipole series of this particle on this stack does not converge; `change` is what the last `order` left."""

    def __init__(self, message: str, change: float, order: int) -> None:
        super().__init__(message)
        self.change, self.order = change, order


@lru_cache(maxsize=64)
def _path_rule(count: int) -> tuple[Array, Array]:
    """Nodes and weights of int_0^1 du for the path w = 1 + i tmax u^2."""
    x, weights = np.polynomial.legendre.leggauss(count)
    return (x + 1) / 2, weights / 2


def reflection_operator(
    surface: Substrate, centre_nm: float, lmax: int, mmax: int, nodes: int | None = None
) -> ComplexArray:
    """Return W_m, `[m, n, n']`: how the stack sends a sphere's radiation back to it.

    W_m of a high order contains those of all lower ones: what was computed at this height serves again.

    The Sommerfeld integral runs along w = kz/k = 1 + i t, at least a distance of 1 from every pole and branch
    point of a passive stack, so one Gauss rule serves glass, films and metals alike.

    Args:
        surface: the stack.
        centre_nm: height of the sphere's centre over what lies below.
        lmax, mmax: highest multipole and azimuthal orders.
        nodes: quadrature nodes; 48 + 2 lmax by default (error below 1e-8).
    """
    if surface.is_absent:
        return np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    kept = surface.operators.get(centre_nm)
    if nodes is None and kept is not None and len(kept) > mmax and kept.shape[1] >= 2 * lmax:
        orders = np.arange(lmax)
        rows = np.concatenate([orders, kept.shape[1] // 2 + orders])
        return np.asarray(kept[: mmax + 1, rows[:, None], rows])
    # between two mirrors waves run to and fro, at two distances
    u, weight = _path_rule(nodes or (48 if surface.inner_nm == 0.0 else 96) + 2 * lmax)
    kd = surface.inner_wavenumber * surface.clear_nm(centre_nm)
    t_max = (2 * lmax + 46) / (2 * kd)
    t = t_max * u**2
    w = 1.0 + 1j * t
    # sin from t itself: 1 - w^2 = t (t - 2i) loses digits near the axis otherwise
    sine = np.sqrt(t * (t - 2j))
    b = plane_wave_vectors(w, lmax, mmax, sine)
    measure = -4j * weight * 2 * t_max * u
    shape = (mmax + 1, 2 * lmax, -1)
    found = np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    for left, right in surface.echo(centre_nm, w).pairs(b):
        rows = (left * measure).transpose(0, 2, 1, 3).reshape(shape)
        found += rows @ right.transpose(0, 2, 1, 3).reshape(shape).transpose(0, 2, 1)
    if nodes is None:
        surface.operators[centre_nm] = found
    return np.asarray(found)


def dressed_matrix(t_matrix: ComplexArray, w_blocks: ComplexArray) -> ComplexArray:
    """Return M_m = (T^-1 - W_m)^-1, `[m, n, n']`.

    Args:
        t_matrix: diagonal, `[n]`, or blocks, `[m, n, n']`. Of a diagonal one it is q (1 - q W_m q)^-1 q with
            q = sqrt(T); a full one is balanced by the roots of its diagonal: T = q t q, M = q (1 - t q W_m q)^-1 t q.
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
class CrossSections:
    """Cross-sections in nm^2 for one incidence; polarisations on the leading axis, `[pol, ...]`.

    `extinction_reflected` and `extinction_transmitted` are the powers taken from the reflected and the transmitted
    beam per incident irradiance; their sum is what the particle scatters and absorbs.
    """

    extinction_reflected: Array
    extinction_transmitted: Array
    scattered_up: Array
    scattered_down: Array

    @property
    def extinction(self) -> Array:
        """Power taken from both beams."""
        return self.extinction_reflected + self.extinction_transmitted

    @property
    def absorption(self) -> Array:
        """Extinction less scattering; for an absorbing or guiding stack it includes what enters the stack."""
        return self.extinction - self.scattered_up - self.scattered_down


@dataclass(frozen=True)
class SphereOnStack:
    """A sphere's response at one wavelength.

    Attributes:
        surface: the stack below.
        centre_nm: height of the centre over it.
        t_matrix: `[n]`, n = (tau, l): -b_l, then -a_l of `mie_coefficients`; or blocks `[m, n, n']` of `axial`.
        mmax: highest azimuthal order.
        cut: in-plane wavenumber over k at which the coupling with the stack ends, see `near_stack`; None: nowhere.
        neighbours: what neighbours send back to it beside the stack, `[m, n, n']`, see `ladder`; None: nothing.
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
            return cut_reflection_operator(self.surface, self.centre_nm, self.lmax, self.mmax, self.cut)
        return reflection_operator(self.surface, self.centre_nm, self.lmax, self.mmax)

    @cached_property
    def dressed(self) -> ComplexArray:
        """The dressed response M_m, `[m, n, n']`."""
        if self.neighbours is None:
            return dressed_matrix(self.t_matrix, self.coupling)
        return dressed_matrix(self.t_matrix, self.coupling + self.neighbours)

    def directions(self, cosines: ArrayLike, below: bool = False, sines: ArrayLike | None = None) -> Directions:
        """Excitation and emission vectors at `cosines` > 0 in the ambient, or in the substrate if `below`."""
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
    """Excitation vectors v and emission vectors u at a set of directions on one side of the stack.

    Attributes:
        cosines: `[angle]`, against the normal, positive, in the medium of that side.
        transverse: `[angle]`, in-plane wavevector over the ambient k.
        inner: `[angle]`, in-plane wavevector over k of the particles' medium, which is the ambient but inside a layer.
        inner_cosines: `[angle]`, kz/k there; imaginary beyond the critical angle.
        index: index of that side over the ambient's.
        below: whether the side is the substrate's.
        excitation: v, `[m, pol, n, angle]`.
        emission: u, `[m, pol, n, angle]`.
        reflection: of the bare stack for light of that side, `[pol, angle]`.
        transmission_up: of the bare stack for light from the substrate; None above.
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
        """Compute the vectors for plane waves arriving from, or leaving to, one side.

        Raises:
            UnsupportedError: the substrate absorbs, and `below` was asked for.
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
        light = surface.arriving(centre_nm, cosines, w, below)
        first = light.ahead[None, :, None, :]
        excitation = adjoint(ahead) * first
        emission = back * first  # what leaves takes the way in backwards
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

    k is that of the particles' medium.
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


def _azimuth_integral(harmonics: ComplexArray) -> Array:
    """int_0^2pi |F|^2 dphi from harmonics, `[pol_s, scattered, pol_i, incident]`."""
    power = np.abs(harmonics) ** 2
    same = np.eye(2)[:, None, :, None]
    return 2 * np.pi * power[0] * same + np.pi * np.sum(power[1:], axis=0)


def beam_extinction(
    harmonics: ComplexArray, beam: ComplexArray, wavenumber: float, incident_index: float = 1.0
) -> Array:
    """Power taken from one coherent beam per incident irradiance, nm^2, `[pol, angle]` (optical theorem).

    Args:
        harmonics: of the same directions on both sides of the scattering, `[m, pol, angle, pol, angle]`.
        beam: the amplitude of that beam without the particle, `[pol, angle]`.
        wavenumber: ambient k.
        incident_index: index of the incident side over the ambient's.
    """
    summed = harmonics.sum(axis=0)
    forward = np.stack([np.diagonal(summed[pol, :, pol]) for pol in range(2)])
    return -4 * np.pi / (wavenumber * incident_index) * (beam.conj() * forward).real


def _beam_parts(sphere: SphereOnStack, incident: Directions) -> tuple[Array, Array]:
    """Extinction of the reflected and of the transmitted beam, `[pol, angle]`; see `CrossSections`."""
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
        assert incident.transmission_up is not None  # set for every direction below
        beam = incident.transmission_up[:, passes]
    else:
        sines = incident.transverse[passes] / sphere.surface.index_below
        out = sphere.directions(np.sqrt((1 - sines) * (1 + sines)), True, sines)
        assert out.transmission_up is not None
        beam = out.transmission_up * incident.cosines[passes] / (out.index * out.cosines)
    sent = emission_harmonics(out.emission, solved[..., passes], inner)
    transmitted[:, passes] = beam_extinction(sent, beam, k, index)
    return reflected, transmitted


def extinction(sphere: SphereOnStack, incident: Directions) -> Array:
    """Power that a sphere takes from both coherent beams per incident irradiance, nm^2, `[pol, angle]`."""
    reflected, transmitted = _beam_parts(sphere, incident)
    return reflected + transmitted


def cross_sections(sphere: SphereOnStack, cosines: ArrayLike, below: bool = False, nodes: int = 48) -> CrossSections:
    """Return extinction and scattering of a sphere lit at `cosines`, each `[pol, angle]`.

    The downward parts are zero where the substrate absorbs. Scattering is integrated by `nodes` Gauss points on
    each side (and on each side of the critical angle).
    """
    incident = sphere.directions(cosines, below)
    k = sphere.surface.inner_wavenumber
    solved = apply_response(sphere.dressed, incident.excitation)
    reflected, transmitted = _beam_parts(sphere, incident)
    mu, weight = _path_rule(nodes)
    up = _azimuth_integral(emission_harmonics(sphere.directions(mu).emission, solved, k))
    scattered_up = np.einsum("s,qspi->pi", weight, up) / incident.index
    if not sphere.surface.is_transparent:
        return CrossSections(reflected, transmitted, scattered_up, np.zeros_like(scattered_up))
    index = sphere.surface.index_below
    mu, weight = hemisphere_rule(nodes, index)
    down = _azimuth_integral(emission_harmonics(sphere.directions(mu, below=True).emission, solved, k))
    scattered_down = np.einsum("s,qspi->pi", weight, down) * index / incident.index
    return CrossSections(reflected, transmitted, scattered_up, scattered_down)


def hemisphere_rule(count: int, index: float = 1.0) -> tuple[Array, Array]:
    """Gauss nodes and weights of int_0^1 dmu on a side of the given relative index, ascending.

    Below a denser substrate the far field has a square-root kink at the critical angle: the rule is split there.
    """
    x, weight = _path_rule(count)
    if index <= 1.0 + 1e-9:
        return x, weight
    critical = np.sqrt(1 - 1 / index**2)
    # u^2 clusters nodes at the kink on both of its sides and takes the root out of the integrand
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
    """Return the lowest multipole order whose far field changes by at most `tolerance` when it is doubled.

    The change is the relative L2 of d sigma/d Omega over scattering angles, the worst of four incidences and two
    polarisations. W_m of a high order contains those of all lower ones, so one integral serves several rungs.

    Args:
        coefficients: function of lmax giving the diagonal T, `[n]`.

    Raises:
        ConvergenceRefusal: no order up to 40 does, as for a metal sphere touching a high-index solid.
    """
    largest = _representable(surface.inner_wavenumber * surface.clear_nm(centre_nm), 2 * ORDER_LADDER[-1])
    begin = 0  # of the ladder: what a smaller operator left open is not asked again
    for top in (12, 24, largest):
        t_top = coefficients(top)
        blocks = reflection_operator(surface, centre_nm, top, mmax)
        incident, scattered = _probes(surface, centre_nm, top, mmax)
        solved: dict[int, Array] = {}
        worst = np.inf
        rungs = [o for o in ORDER_LADDER if 2 * o <= top]
        # the last rung that the largest operator has is asked again, for the refusal tells its change
        for order in rungs[min(begin, len(rungs) - 1) :]:
            for l in (order, 2 * order):
                if l not in solved:
                    solved[l] = _probe_pattern(t_top, blocks, incident, scattered, l)
            worst = _worst(solved[order], solved[2 * order])
            if worst <= tolerance:
                return order
        begin = len(rungs)
    raise ConvergenceRefusal(
        f"the multipole series does not converge to {tolerance:g} (order {order} still changes by {worst:.2g} when "
        "doubled): a metal sphere that touches a solid squeezes the field into the contact point",
        worst,
        order,
    )


def order_change(surface: Substrate, centre_nm: float, coefficients: Coefficients, low: int, high: int) -> float:
    """Return by how much the far field of a sphere changes from one multipole order to a higher; see `choose_order`."""
    high = _representable(surface.inner_wavenumber * surface.clear_nm(centre_nm), high)
    t_top, blocks = coefficients(high), reflection_operator(surface, centre_nm, high, AZIMUTHAL_ORDERS)
    probes = _probes(surface, centre_nm, high, AZIMUTHAL_ORDERS)
    return _worst(*(_probe_pattern(t_top, blocks, *probes, l) for l in (low, high)))


def _probes(surface: Substrate, centre_nm: float, lmax: int, mmax: int) -> tuple[Directions, Directions]:
    """Return the light and the views at which orders are compared."""
    angles = np.array([0.0, 30.0, 60.0, 80.0]), np.arange(5.0, 90.0, 12.0)
    light, views = (Directions.build(surface, centre_nm, lmax, mmax, np.cos(np.radians(each))) for each in angles)
    return light, views


def _worst(of: Array, to: Array) -> float:
    """Return the largest relative L2 difference of two probe patterns over incidences and polarisations."""
    change = np.sqrt(np.sum((of - to) ** 2, axis=(0, 1, 2)))
    return float(np.max(change / np.sqrt(np.sum(to**2, axis=(0, 1, 2)))))


def _representable(kd: float, top: int) -> int:
    """Return the highest even order, at most `top`, whose W_m ~ (2l)! 4^l / (2kd)^(2l+1) is no overflow in double."""
    while math.lgamma(2 * top + 1) + 2 * top * math.log(2) - (2 * top + 1) * math.log(2 * kd) > LARGEST_LOG:
        top -= 2
    return top


def _probe_pattern(
    t_top: ComplexArray, blocks: ComplexArray, incident: Directions, scattered: Directions, l: int
) -> Array:
    top = len(t_top) // 2
    keep = np.concatenate([np.arange(l), top + np.arange(l)])
    dressed = dressed_matrix(t_top[keep], blocks[:, keep][:, :, keep])
    response = np.matmul(dressed[:, None], incident.excitation[:, :, keep])
    left = scattered.emission[:, :, keep].transpose(0, 1, 3, 2)
    fields = np.matmul(left[:, :, None], response[:, None])  # m, q, p, s, i
    fields[1:] *= 2.0
    co, cross = np.cos, np.sin
    phi = np.linspace(0.0, np.pi, 9)
    orders = np.arange(len(blocks))[:, None] * phi
    pattern = [
        np.abs(np.tensordot(fields[:, q, p], (co if q == p else cross)(orders), (0, 0))) ** 2
        for q in range(2)
        for p in range(2)
    ]
    return np.stack(pattern).reshape(2, 2, *pattern[0].shape).transpose(0, 2, 4, 1, 3)


def rounded_up(value: float) -> float:
    """Return the next number of one digit."""
    unit = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / unit) * unit)
