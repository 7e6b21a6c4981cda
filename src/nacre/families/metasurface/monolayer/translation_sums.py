"""Translation sums Q in the quasi-crystalline approximation: excitation by neighbours.

Q_nn'(kappa) = 2 pi rho (-i)^mu int_a^inf g(R) J_mu(kappa R) W_nn'(R) R dR, mu = |m' - m|, with W(R) the translation
from multipole n' at distance R to multipole n, directly and by the stack. The plane-wave parts have a closed form and
are subtracted; the remainder is smooth in the angle and is interpolated.

A multipole is n = (m, tau, l) with m from -L to L, flat; lengths in units 1/k.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv

from nacre.core.arrays import Array, ComplexArray, gauss_legendre
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.tmatrix import special_functions
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_index, with_negative_orders
from nacre.families.metasurface.tmatrix.substrate import Substrate

IntArray = NDArray[np.intp]

CONTOUR_DEPTH = 0.3  # contour depth below guided modes, in k; the growth e^{0.3 k R} costs digits
SILENT, NEAR_START = 46.0, 1e-19  # exponent and ray distance below which terms are lost to rounding
ALONG_THE_NORMAL = 1e-9  # in-plane wavevectors below this, over k, count as 0
EXCESS_FLOOR = 2e-3  # |g - 1| below which distances count as uncorrelated


@dataclass(frozen=True)
class NeighbourGeometry:
    """Neighbours of a particle in a monolayer, and their interaction.

    Attributes:
        surface, centre_nm: the stack and the particle height.
        structure: density and g(r).
        order: highest multipole in the interaction.
        lift_nm: target height above the source (`centre_nm` is their mean), for the reflection by the stack.
    """

    surface: Substrate
    centre_nm: float
    structure: Structure
    order: int
    lift_nm: float = 0.0


@dataclass(frozen=True)
class HalfIndex:
    """The multipoles with m >= 0 excited by one polarisation, as places in `MultipoleIndex`: arrays `[h]`.

    The monolayer is symmetric about the incidence plane, so s and p excite multipoles with opposite mirror symmetry:
    those with -m follow from m by `sign`, and m = 0 with tau != pol is not excited.
    """

    place: IntArray
    partner: IntArray
    sign: Array
    m: IntArray
    block: IntArray

    @property
    def multiplicity(self) -> Array:
        """Multiplicity in the full index: 1 for m = 0, else 2."""
        return np.where(self.m > 0, 2.0, 1.0)


@lru_cache(maxsize=16)
def half_index(order: int, pol: int) -> HalfIndex:
    """Return the half index excited by polarisation `pol` (0 = s, 1 = p)."""
    index = multipole_index(order)
    rows = {key: i for i, key in enumerate(zip(index.m.tolist(), index.tau.tolist(), index.l.tolist(), strict=True))}
    selected = np.array([i for (m, tau, _), i in rows.items() if m > 0 or (m == 0 and tau == pol)], dtype=np.intp)
    partner = np.array([rows[(-int(index.m[i]), int(index.tau[i]), int(index.l[i]))] for i in selected], dtype=np.intp)
    sign = np.where(index.tau[selected] == pol, 1.0, -1.0)
    return HalfIndex(selected, partner, sign, index.m[selected], index.block[selected])


def folded(q: ComplexArray, order: int, pol: int) -> ComplexArray:
    """Fold `[n, n', ...]` onto the multipoles excited by a polarisation, `[h, h', ...]`."""
    half = half_index(order, pol)
    rows = q[half.place]
    shape = (1, -1, *([1] * (q.ndim - 2)))
    doubled = np.where(half.m > 0, half.sign, 0.0).reshape(shape)
    return rows[:, half.place] + doubled * rows[:, half.partner]


def unfolded(q: ComplexArray, order: int) -> ComplexArray:
    """Return the full matrices folded for both polarisations, `[angle, n, n']`.

    A folded column m > 0 is the sum with -m, with opposite signs in the two polarisations; a row m = 0 vanishes in one
    of them, so the other has twice its share.
    """
    size = len(multipole_index(order).m)
    out = np.zeros((q.shape[1], size, size), dtype=complex)
    for pol in range(2):
        half = half_index(order, pol)
        paired = half.m > 0
        value = q[pol] / np.where(paired, 2.0, 1.0)
        rows, turned, sign = half.place[:, None], half.partner[paired], half.sign[paired]
        out[:, rows, half.place] += value
        out[:, rows, turned] += value[:, :, paired] * sign
        # -m and -m' couple like m and m', up to signs
        out[:, turned[:, None], half.place] += value[:, paired] * sign[:, None]
        out[:, turned[:, None], turned] += value[:, paired][:, :, paired] * sign[:, None] * sign
    return out


@lru_cache(maxsize=8)
def translation_coefficients(order: int) -> ComplexArray:
    """c_p for the direct translation, `[n, n', p]`: W = sum_p c_p h_p(kr) P_p^mu(cos), mu from the pair."""
    index = multipole_index(order)
    w, weight = gauss_legendre(4 * order + 6)
    b = special_functions.plane_wave_vectors(w, order, order)
    right = with_negative_orders(b, index)
    left = with_negative_orders(special_functions.adjoint(b), index)
    top = 2 * order
    values = special_functions.legendre(w, top, top)
    product = np.einsum("qnw,qcw->ncw", left, right)
    projected = np.einsum("ncpw,ncw->ncp", values[pair_orders(order)], weight * product)
    return np.asarray(4 * (1j) ** np.arange(top + 1) * projected)


@lru_cache(maxsize=8)
def direct_coefficients(order: int) -> ComplexArray:
    """c_p P_p^mu(0) for the direct translation in the plane, `[n, n', p, mu]`, zero except at the pair's mu."""
    top = 2 * order
    mu = pair_orders(order)
    coefficients = translation_coefficients(order) * special_functions.legendre(np.array(0.0), top, top)[mu]
    return np.asarray(coefficients[..., None] * (mu[..., None, None] == np.arange(top + 1)))


@lru_cache(maxsize=8)
def pair_orders(order: int) -> IntArray:
    """mu = |m' - m|, `[n, n']`."""
    m = multipole_index(order).m
    return np.abs(m[None, :] - m[:, None])


def panels(edges: Array, count: int) -> tuple[Array, Array]:
    x, weight = gauss_legendre(count)
    half = np.diff(edges) / 2
    middle = (edges[1:] + edges[:-1]) / 2
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * weight).ravel()


def _correlation_range(structure: Structure) -> float:
    """Distance in nm beyond which |g - 1| stays below the floor; at least two diameters."""
    loud = np.nonzero(np.abs(structure.h) > EXCESS_FLOOR)[0]
    last = structure.r_nm[loud[-1]] if loud.size else structure.diameter_nm
    return float(max(2 * structure.diameter_nm, last))


def _direct_sums(structure: Structure, wavenumber: float, order: int, kappa: Array) -> ComplexArray:
    """int_a^inf g h_p J_mu R dR, `[p, mu, angle]`, in units 1/k^2."""
    top = 2 * order
    a = structure.diameter_nm * wavenumber
    reach = _correlation_range(structure) * wavenumber
    pieces = int(np.ceil((reach - a) / (a / 2)))
    r, weight = panels(np.linspace(a, reach, pieces + 1), int(8 + 0.6 * a))
    g = 1.0 + structure.pair_excess(r / wavenumber)
    hankel = special_functions.spherical_hankel_scaled(r, top) * (np.exp(1j * r) * weight * g * r)
    bessel = jv(np.arange(top + 1)[:, None, None], r[:, None] * kappa)  # mu, R, angle
    near = np.einsum("pr,mra->pma", hankel, bessel, optimize=True)
    return near + _rotated_tail(reach, top, kappa)


def _rotated_tail(reach: float, top: int, kappa: Array) -> ComplexArray:
    """int_reach^inf h_p J_mu R dR with J = (H1 + H2)/2, each along the ray on which it decays."""
    y = np.linspace(-4.2, 3.6, 121)
    s = np.exp(np.pi / 2 * np.sinh(y))
    weight = s * np.pi / 2 * np.cosh(y) * (y[1] - y[0])
    out = np.zeros((top + 1, top + 1, kappa.size), dtype=complex)
    orders = np.arange(top + 1)
    for sign in (1, -1):
        for turn in (1, -1):
            # e^{i (1 + sign kappa) R}: the incoming half decays on the lower ray beyond the light line
            chosen = (1 + sign * kappa > 0) if turn > 0 else (1 + sign * kappa <= 0)
            if not np.any(chosen):
                continue
            k = kappa[chosen]
            r = reach + 1j * turn * s
            h = special_functions.spherical_hankel_scaled(r, top) * (weight * 1j * turn * r)
            safe = np.maximum(k, ALONG_THE_NORMAL)
            arg = r[:, None] * safe
            phase = np.exp(1j * (1 + sign * k) * r[:, None])
            cylinder = np.zeros((top + 1, *arg.shape), dtype=complex)
            steep_reach = (
                (k >= ALONG_THE_NORMAL) & (turn * (1 + sign * k) * s[:, None] < SILENT) & (s[:, None] > NEAR_START)
            )
            cylinder[:2, steep_reach] = special_functions.hankel_scaled(arg[steep_reach], sign)
            for mu in range(1, top):
                cylinder[mu + 1] = 2 * mu / arg * cylinder[mu] - cylinder[mu - 1]
            zero = (k < ALONG_THE_NORMAL)[None, None, :]
            # at kappa = 0 the singular Hankel halves add up to J = delta_{mu 0}
            cylinder = np.where(zero, (orders == 0)[:, None, None], cylinder)
            out[:, :, chosen] += 0.5 * np.einsum("pr,mra->pma", h, cylinder * phase, optimize=True)
    return out


def stack_contour(
    surface: Substrate,
    centre_nm: float,
    order: int,
    reach: float,
    depth: float = CONTOUR_DEPTH,
    steep_reach: float = 10.0,
    quick: bool = False,
) -> tuple[ComplexArray, ComplexArray]:
    """Nodes and weights in kappa/k on a contour below the guided modes, then along the real axis.

    Args:
        reach: the largest distance, times k.
        depth: contour depth, in k.
        steep_reach: distance, times k, up to which the strongly evanescent waves at its end contribute.
        quick: two thirds of the nodes; error 2e-5 (largest sum) rather than 1e-6, the maximum over 60 random
            stacks.
    """
    far = (2 * order + 46) / (2 * surface.inner_wavenumber * surface.mirror_distance_nm(centre_nm))
    relative = np.abs(surface.indices.real).max() / surface.inner_index
    # a host layer adds interference fringes over the angle
    reach = reach + 2 * surface.inner_wavenumber * surface.inner_nm
    bend = max(6.0, relative + 1.0)
    # relative error 1e-8; a pattern needs a narrow last panel for the Bessel functions
    edges = [0.0, 1.0, 2.0, bend] if depth == CONTOUR_DEPTH else [0.0, 1.0, *np.linspace(2.0, bend, 5)]
    fringes = float(surface.indices[1:-1].real @ surface.thicknesses_nm) * surface.wavenumber / surface.ambient_index
    x, weight = panels(np.array(edges), int(24 + 0.5 * (reach + fringes)) if quick else int(40 + 0.8 * reach))
    kappa = x - 1j * depth * np.sin(np.pi * x / bend)
    slope = 1 - 1j * depth * np.pi / bend * np.cos(np.pi * x / bend)
    if far <= bend:
        return kappa, weight * slope
    y, rest = panels(
        np.array([bend, far]), int((48 if quick else 60) + 0.5 * (far - bend) * min(reach, steep_reach) / 3)
    )
    return np.concatenate([kappa, y]), np.concatenate([weight * slope, rest.astype(complex)])


def reflected_sums(
    surface: Substrate,
    centre_nm: float,
    lift_nm: float,
    order: int,
    contour: tuple[ComplexArray, ComplexArray],
    moments: ComplexArray,
    row_numbers: NDArray[np.bool_] | bool = True,
) -> ComplexArray:
    """Integrate multipole pairs reflected by the stack over a contour, `[n, n', column]`.

    4 int kap dkap/(k kz) i^mu moments e^(2ikzd) sum_pol Bdag_n(kz/k) R B_n'(-kz/k), mu = |m' - m|; inside a layer with
    all waves in `StackReflection`.

    Args:
        contour: from `stack_contour`.
        moments: `[mu, kappa, column]`.
        row_numbers: the n computed, `[n, 1]`.
    """
    (kappa, weight), index, mu = contour, multipole_index(order), pair_orders(order)
    w = np.sqrt((1 - kappa) * (1 + kappa))
    w = np.where(w.imag < 0, -w, w)
    factors = [
        (with_negative_orders(left, index) * (4 * weight * kappa / w), with_negative_orders(right, index))
        for left, right in surface.reflection_at(centre_nm, w, lift_nm).pairs(
            special_functions.plane_wave_vectors(w, order, order, kappa)
        )
    ]
    out = np.zeros((*mu.shape, moments.shape[-1]), dtype=complex)
    for m, moment in enumerate(moments):
        rows, columns = np.nonzero((mu == m) & row_numbers)
        products = sum(left[pol, rows] * right[pol, columns] for left, right in factors for pol in range(2))
        out[rows, columns] = (1j) ** m * (products @ moment)
    return out


def _stack_sums(
    geometry: NeighbourGeometry, kappa_i: Array, every_row: bool = False, quick: bool = False
) -> ComplexArray:
    """The part reflected by the stack for g - 1, `[n, n', angle]` (g = 1 has a closed form).

    Rows with m < 0 are zero, since `folded` ignores them, unless `every_row`.

    int (g-1) W^R(R) J_mu(kappa_i R) R dR with the Sommerfeld integral W^R outside: the radial integral over two Bessel
    functions comes first.
    """
    surface, structure, order = geometry.surface, geometry.structure, geometry.order
    k = surface.inner_wavenumber
    a, reach = structure.diameter_nm * k, _correlation_range(structure) * k
    # W^R is smooth also inside the core, with g - 1 = -1
    r_in, w_in = panels(np.array([0.0, a]), int(14 + 0.8 * a))
    r_out, w_out = panels(np.linspace(a, reach, int(np.ceil(reach / a - 1 + 1e-9)) + 1), int(10 + 0.8 * a))
    r = np.concatenate([r_in, r_out])
    measure = np.concatenate([w_in, w_out]) * r * structure.pair_excess(r / k)
    contour = stack_contour(surface, geometry.centre_nm, order, reach, quick=quick)
    top = 2 * order if np.any(kappa_i >= ALONG_THE_NORMAL) else 0  # J_mu(0) = delta_{mu 0}
    radial = special_functions.bessel_j(np.outer(contour[0], r), top)  # mu, kappa, R
    bessel = jv(np.arange(top + 1)[:, None, None], r[:, None] * kappa_i)
    moments = np.matmul(radial, measure[:, None] * bessel)  # mu, kappa, angle
    rows = every_row | (multipole_index(order).m[:, None] >= 0)
    return reflected_sums(surface, geometry.centre_nm, geometry.lift_nm, order, contour, moments, rows)


def neighbour_sums(geometry: NeighbourGeometry, kappa: Array, quick: bool = False) -> ComplexArray:
    """Return Q minus its plane-wave terms, folded, `[pol, angle, h, h']`, at in-plane wavevectors `kappa` over k.

    Args:
        kappa: `[angle]`, real, >= 0 and not 1.
        quick: relative error 1e-4 to 1e-5.
    """
    surface, structure, order = geometry.surface, geometry.structure, geometry.order
    mu = pair_orders(order)
    direct = _direct_sums(structure, surface.inner_wavenumber, order, kappa)
    table = direct_coefficients(order).reshape(mu.size, -1)
    total = (table @ direct.reshape(table.shape[1], -1)).reshape(*mu.shape, -1)
    if not surface.is_absent:
        total = total + _stack_sums(geometry, kappa, quick=quick)
    total = total * (2 * np.pi * structure.density_per_nm2 / surface.inner_wavenumber**2) * ((-1j) ** mu)[:, :, None]
    waves = plane_wave_sums(geometry, np.sqrt((1 - kappa**2).astype(complex)), kappa, False)
    return np.stack([np.moveaxis(folded(total, order, pol), -1, 0) - waves[pol] for pol in range(2)])


def plane_wave_sums(
    geometry: NeighbourGeometry, w: ComplexArray, kappa: Array, is_reflected: bool = True
) -> ComplexArray:
    """The plane-wave terms in Q, folded: half the monolayer waves in both directions, and their reflection.

    They grow as 1/cos and are therefore not interpolated. Folded, each is one product: a plane wave with one
    polarisation excites only its own multipoles.

    Args:
        is_reflected: whether the reflection by the stack is included.

    Returns: `[pol, angle, h, h']`.
    """
    surface, order = geometry.surface, geometry.order
    b = special_functions.plane_wave_vectors(w, order, order, kappa.astype(complex))
    factor = 4 * np.pi * geometry.structure.density_per_nm2 / (surface.inner_wavenumber**2 * w)
    turned = special_functions.mirrored(np.ones((*b.shape[:3], 1), dtype=complex)).real[..., 0]
    left_all = special_functions.adjoint(b)
    reflection = None
    if is_reflected and not surface.is_absent:
        reflection = surface.reflection_at(geometry.centre_nm, w, geometry.lift_nm)
    out = []
    for pol in range(2):
        half = half_index(order, pol)
        left, right = left_all[half.m, pol, half.block].T, b[half.m, pol, half.block].T
        sign = turned[half.m, pol, half.block]
        waves: ComplexArray = factor[:, None, None] * (1.0 + sign[:, None] * sign)
        if reflection is not None:
            waves = waves + (2.0 * factor)[:, None, None] * reflection.signed(pol, sign, sign)
        out.append(left[:, :, None] * (right * half.multiplicity)[:, None, :] * waves)
    return np.stack(out)
