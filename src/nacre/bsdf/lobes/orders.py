"""Diffraction orders of a periodic structure, reflected or transmitted, each with a narrow angular width."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.response import check_parameters
from nacre.bsdf.texture import ParameterAxis, Texture, places
from nacre.core.arrays import Array, interpolate

MAX_OVERLAP = 0.12  # largest angular width over the distance of neighbouring orders
MIN_WAVELENGTH_NM = 200.0


@dataclass(frozen=True)
class OrdersLobe(Lobe):
    """Orders (m, n) of one side, with a Gaussian width in direction cosines.

    f = (E_mn(wi) + E_mn(wo)) / 2 G(q - lambda g_mn),  q = wi_t + wo_t,
    G(d) = exp(-|d|^2 / (2 w^2)) / (2 pi w^2),

    with the order (m, n) whose wave vector lambda g_mn lies nearest to q, and E its efficiency for unpolarised light.
    Since cos_o d omega_o = d wo_t, each order carries E of the light; since E is equal for exchanged directions, f is
    reciprocal. Directions are first rotated by -rotation about z.

    Transmitted orders have, with the direction a above the surface, b below it and the relative index eta,

    f = E_mn(a) G(q - lambda g_mn) (eta^2 if the viewer is below),  q = a_t + eta b_t,

    which makes transmission reciprocal.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        power: `[*params, theta, azimuth, order, wavelength]`, float32, E: uniform nodes in theta from 0 to pi/2 and in
            the light's azimuth from 0 to 2 pi, both ends included; linear between. Without the zero order.
        lattice: `[2, 2]` rows g_10 and g_01 over the index above, in 1/nm (for lines g_01 is zero); at the first period
            of `parameters`.
        orders: `[order, 2]`, (m, n).
        width: w.
        rotation: angle of the lattice about the normal, rad, from +x to +y.
        eta: index below over index above for transmitted orders; 0 for reflected orders.
        parameters: the period over the surface, if it varies; wave vectors follow it exactly, E between its nodes.
    """

    kind: ClassVar[str] = "orders"
    wavelengths_nm: Array
    power: NDArray[np.float32]
    lattice: Array
    orders: NDArray[np.int64]
    width: float
    rotation: Texture | None = None
    eta: float = 0.0
    parameters: tuple[ParameterAxis, ...] = ()

    @property
    def transmits(self) -> bool:
        """Whether the orders leave to the other side."""
        return self.eta > 0.0

    def check(self) -> None:
        """Check shapes and ranges.

        Raises:
            ValueError: names the inconsistent array.
        """
        super().check()
        leading = check_parameters(self.parameters)
        if len(leading) > 1:
            raise ValueError("parameters of orders is the period alone")
        if self.power.ndim != 4 + len(leading) or self.power.shape[: len(leading)] != leading:
            raise ValueError("power must be [*params, theta, azimuth, order, wavelength]")
        if self.power.shape[-2:] != (len(self.orders), len(self.wavelengths_nm)):
            raise ValueError("power must be [*params, theta, azimuth, order, wavelength]")
        if min(self.power.shape[-4:-2]) < 2 or np.any(self.power < 0.0):
            raise ValueError("power needs two angles and two azimuths or more, and no value below 0")
        if leading and not self.parameters[0].values[0] > 0.0:
            raise ValueError("periods must be positive")
        if not (self.eta == 0.0 or 0.01 <= self.eta < 100.0):
            raise ValueError("eta must be 0, or the relative index of the medium below")
        if self.orders.ndim != 2 or self.orders.shape[1] != 2 or np.any(np.abs(self.orders) > 10_000):
            raise ValueError("orders must be [order, 2]")
        if self.lattice.shape != (2, 2) or not np.hypot(*self.lattice[0]) > 0.0:
            raise ValueError("lattice must be two vectors, the first not zero")
        if not self.width > 0.0:
            raise ValueError("width must be positive")

    @cached_property
    def inverse(self) -> Array:
        """Matrix `[2, 2]` from a wave vector (row) to fractional orders; for lines the second order is 0."""
        if not np.any(self.lattice[1]):
            g = self.lattice[0]
            return np.array([[g[0], 0.0], [g[1], 0.0]]) / float(g @ g)
        return np.asarray(np.linalg.inv(self.lattice))

    @cached_property
    def places(self) -> tuple[NDArray[np.int64], int, int]:
        """Index of each order in a dense table `[m + first, n + second]`, -1 if absent, and both offsets."""
        reach = np.abs(self.orders).max(axis=0, initial=0)
        table = np.full(2 * reach + 1, -1, dtype=np.int64)
        table[self.orders[:, 0] + reach[0], self.orders[:, 1] + reach[1]] = np.arange(len(self.orders))
        return table, int(reach[0]), int(reach[1])

    def _rotated(self, w: Array, uv: Array | None) -> Array:
        if self.rotation is None:
            return w
        angle = self.rotation(places(uv, w.shape[:-1]))
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * w[..., 0] + s * w[..., 1], c * w[..., 1] - s * w[..., 0], w[..., 2]], axis=-1)

    def _period(self, uv: Array | None, shape: tuple[int, ...]) -> tuple[Array, tuple[Array, ...]]:
        """Return the period relative to the first one, and its node coordinates, each with `shape`."""
        if not self.parameters:
            return np.ones(shape), ()
        axis = self.parameters[0]
        period = axis.texture(places(uv, shape))
        return period / float(axis.values[0]), (axis.coordinate(period),)

    def efficiencies(self, w: Array, coordinates: tuple[Array, ...] = ()) -> Array:
        """Return E `[..., order, wavelength]` at directions in the lattice's frame.

        Args:
            coordinates: node coordinate of the period, if it varies.
        """
        thetas, azimuths = self.power.shape[-4:-2]
        theta = np.arccos(np.clip(w[..., 2], 0.0, 1.0)) / (0.5 * np.pi) * (thetas - 1)
        phi = np.mod(np.arctan2(w[..., 1], w[..., 0]) / (2.0 * np.pi), 1.0) * (azimuths - 1)
        return interpolate(self.power, (*coordinates, theta, phi))

    @property
    def line_nm(self) -> float:
        """Standard deviation in wavelength of the narrowest order at fixed directions."""
        steepest = float(np.hypot(*(self.orders @ self.lattice).T).max(initial=1e-12))
        return self.width / steepest

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f in 1/sr, `[..., wavelength]`; zero for exits on the side that the orders do not leave to."""
        return self.evaluate_on(self.wavelengths_nm, wi, wo, uv)

    def evaluate_on(self, wavelengths_nm: Array, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return `evaluate` at wavelengths within those of the lobe, between which efficiencies are interpolated."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        wi, wo = self._rotated(wi, uv), self._rotated(wo, uv)
        shape = wi.shape[:-1]
        scale, coordinates = self._period(uv, shape)
        scale, coordinates = scale.reshape(-1, 1, 1), tuple(c.reshape(-1) for c in coordinates)
        above, other, factor = self._sides(wi.reshape(-1, 3), wo.reshape(-1, 3))
        place, bell = self._bells(wavelengths_nm, above, other, scale)
        result = np.zeros((len(above), len(wavelengths_nm)))
        lit = np.flatnonzero(np.any(bell, axis=1))
        if lit.size:
            at_lit = tuple(c[lit] for c in coordinates)
            both = self.efficiencies(above[lit], at_lit)
            if not self.transmits:
                both = 0.5 * (both + self.efficiencies(other[lit], at_lit))
            node = np.interp(wavelengths_nm, self.wavelengths_nm, np.arange(len(self.wavelengths_nm)))
            low = node.astype(int)
            high, share = np.minimum(low + 1, len(self.wavelengths_nm) - 1), node - low
            pair, at = np.arange(lit.size)[:, None], np.clip(place[lit], 0, None)
            value = (1.0 - share) * both[pair, at, low] + share * both[pair, at, high]
            result[lit] = value * bell[lit] * factor[lit, None]
        return result.reshape(*shape, -1)

    def lines(self, wi: Array, wo: Array) -> tuple[NDArray[np.int64], Array, tuple[Array, Array]]:
        """Return the nearest order and G, `[pair, wavelength]`, and both directions in the lattice's frame."""
        wi, wo = self._rotated(wi, None), self._rotated(wo, None)
        return *self._bells(self.wavelengths_nm, wi, wo, np.ones((len(wi), 1, 1))), (wi, wo)

    def _sides(self, wi: Array, wo: Array) -> tuple[Array, Array, Array]:
        """Return the direction above, that of q beside it, and the factor of f, `[pair, 3]` and `[pair]`."""
        if not self.transmits:
            return wi, wo, np.ones(len(wi))
        is_up = wi[:, 2:] > 0.0
        above, other = np.where(is_up, wi, wo), np.where(is_up, wo, wi) * [self.eta, self.eta, -1.0]
        return above, other, np.where(is_up[:, 0], self.eta**2, 1.0)

    def _bells(
        self, wavelengths_nm: Array, above: Array, other: Array, scale: Array
    ) -> tuple[NDArray[np.int64], Array]:
        """Return the nearest order (-1: unknown) and G, 0 beyond some eight widths, `[pair, wavelength]`."""
        q = (above + other)[:, None, :2] / wavelengths_nm[:, None] * scale  # [pair, wavelength, 2], in 1/nm
        fraction = q @ self.inverse
        number = np.rint(fraction).astype(np.int64)
        off = (q - number @ self.lattice) / scale * wavelengths_nm[:, None]
        shifted = np.sum(off**2, axis=-1) / self.width**2
        table, first, second = self.places
        known = (np.abs(number[..., 0]) <= first) & (np.abs(number[..., 1]) <= second)
        place = table[np.clip(number[..., 0] + first, 0, 2 * first), np.clip(number[..., 1] + second, 0, 2 * second)]
        known &= (place >= 0) & (shifted < 60.0) & ((above[:, 2] > 0) & (other[:, 2] > 0))[:, None]
        bell = np.exp(-0.5 * np.minimum(shifted, 60.0)) / (2.0 * np.pi * self.width**2)
        return place, np.where(known, bell, 0.0)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Return the light in all orders, for light along one `wi[3]`."""
        nothing = np.zeros(len(self.wavelengths_nm))
        wi = np.asarray(wi, dtype=float)
        if wi[2] == 0.0 or (wi[2] < 0.0 and not self.transmits):
            return nothing, nothing
        turned = self._rotated(wi, None if uv is None else np.asarray(uv, dtype=float))
        scale, coordinates = self._period(uv, ())
        shifts = ((self.orders @ self.lattice) / scale)[:, None, :] * self.wavelengths_nm[:, None]
        if wi[2] > 0.0:
            leaves = np.sum((shifts - turned[:2]) ** 2, axis=-1) < (self.eta if self.transmits else 1.0) ** 2
            total = np.sum(np.where(leaves, self.efficiencies(turned, coordinates), 0.0), axis=0)
            return (nothing, total) if self.transmits else (total, nothing)
        exits = shifts - self.eta * turned[:2]  # [order, wavelength, 2], above
        cos2 = 1.0 - np.sum(exits**2, axis=-1)
        way = np.concatenate([exits, np.sqrt(np.maximum(cos2, 0.0))[..., None]], axis=-1)
        efficiencies = self.efficiencies(way, tuple(np.full(cos2.shape, c) for c in coordinates))
        own = np.einsum("owow->ow", efficiencies)
        return nothing, np.sum(np.where(cos2 > 0.0, own, 0.0), axis=0)


def limited_width(width: float, lattice: Array, shortest_nm: float) -> float:
    """Return a width at which neighbouring orders do not overlap."""
    vectors = (
        [lattice[0]]
        if not np.any(lattice[1])
        else [lattice[0], lattice[1], lattice[0] - lattice[1], lattice[0] + lattice[1]]
    )
    return min(width, MAX_OVERLAP * shortest_nm * min(float(np.hypot(*v)) for v in vectors))


def order_lobes(lobes: Iterable[Lobe]) -> list[OrdersLobe]:
    """Return the lobes with diffraction orders, also those under masks."""
    lobes_of = []
    for lobe in lobes:
        while isinstance(lobe, MaskedLobe):
            lobe = lobe.inner
        if isinstance(lobe, OrdersLobe):
            lobes_of.append(lobe)
    return lobes_of


def narrowest_nm(lobes: Iterable[Lobe]) -> float:
    """Return the narrowest `line_nm`, infinity without orders."""
    return min((lobe.line_nm for lobe in order_lobes(lobes)), default=np.inf)
