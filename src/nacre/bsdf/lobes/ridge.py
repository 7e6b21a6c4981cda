"""Parallel lamellar ridges (the Morpho scale): coherent within a ridge, with irregular heights, or tabulated."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.response import InterfaceResponse, ResponseLobe
from nacre.bsdf.texture import Texture, places
from nacre.core.arrays import Array, interpolate


@dataclass(frozen=True)
class Ridge(ResponseLobe):
    """Light reflected by ridges along y and diffracted across them (after Kinoshita et al. 2002).

    f = fill R(|wi.h|) K(u, v) D_y(wi_y + wo_y) / norm, for both directions at z > 0, with h = normalize(wi + wo),
    k = 2 pi/lambda,
    u = k (wi_x + wo_x), v = k (cos_i + cos_o), a = pitch, b = width, N = count, s = height deviation,

    K = sinc^2(u b/2) [1 - chi^2 + chi^2 (sin(N u a/2)/sin(u a/2))^2 / N],  chi = exp(-v^2 s^2/2), sinc x = sin x/x,
    D_y(q) = exp(-q^2/(2 w^2)) / (w sqrt(2 pi)),  w = spread_along.

    (sin/sin)^2 is N^2 for sin(u a/2) = 0. Energy <= 1 and reciprocal: norm is the largest integral of K D_y
    over the disc of exits. Directions are first rotated by -rotation about z, so y runs along the ridges.

    Attributes:
        response: lamellar stack tables; only `reflectance` is used.
        pitch_nm, width_nm, height_deviation_nm: a, b, s.
        count: N, ridges lit coherently together.
        spread_along: w, dimensionless (sine units).
        fill: fraction of the surface covered by ridges, in [0, 1].
        norm: `[wavelength]`, C(lambda).
        rotation: optional angle of the direction across the ridges about the normal, rad, from +x to +y.
    """

    kind: ClassVar[str] = "ridge"
    response: InterfaceResponse
    pitch_nm: float
    width_nm: float
    height_deviation_nm: float
    count: int
    spread_along: float
    fill: float
    norm: Array
    rotation: Texture | None = None

    AXES: ClassVar[dict[str, str]] = {"norm": "wavelength"}

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
        """
        self.response.check()
        if self.norm.shape != self.wavelengths_nm.shape or np.any(self.norm <= 0):
            raise ValueError("norm must be positive, one number for each wavelength")
        if not (self.pitch_nm > 0 and self.width_nm > 0 and self.height_deviation_nm >= 0 and self.count >= 1):
            raise ValueError("pitch_nm, width_nm and count must be positive")
        _check_spread(self.spread_along, self.fill)

    @property
    def transmits(self) -> bool:
        """Always False: ridges only reflect."""
        return False

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value `[..., wavelength]` in 1/sr."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        psi = wi + wo
        length = np.linalg.norm(psi, axis=-1)
        cos_h = 0.5 * length  # wi.h = |wi + wo|/2 for unit vectors
        across, along = psi[..., 0], psi[..., 1]
        if self.rotation is not None:
            angle = self.rotation(places(uv, across.shape))
            cos, sin = np.cos(angle), np.sin(angle)
            across, along = cos * across + sin * along, cos * along - sin * across
        reflected, _ = self.response.lookup(cos_h, np.zeros(cos_h.shape, dtype=bool), uv)
        spread = ridge_interference(
            across, psi[..., 2], self.wavelengths_nm, self.pitch_nm, self.width_nm, self.height_deviation_nm, self.count
        )
        spread = spread * gaussian(along, self.spread_along)[..., None]
        is_visible = ((wi[..., 2] > 0) & (wo[..., 2] > 0))[..., None]
        return np.where(is_visible, self.fill * reflected * spread / self.norm, 0.0)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate over all exits, for light along one `wi[3]`; see `Lobe.hemispherical`.

        Uses a grid in sines, since cos_o d(omega_o) = ds_x ds_y; it resolves the grating comb.
        """
        wi = np.asarray(wi, dtype=float)
        nothing = np.zeros(len(self.wavelengths_nm))
        if wi[2] <= 0:
            return nothing, nothing
        angle = 0.0 if self.rotation is None else float(self.rotation(np.array([0.5, 0.5]) if uv is None else uv))
        cos, sin = np.cos(angle), np.sin(angle)
        along_i = cos * wi[1] - sin * wi[0]
        count = int(np.clip(24 * self.count * self.pitch_nm / self.wavelengths_nm[0], 4 * nodes, 8000))
        spread = np.linspace(-4.5, 4.5, 28) * self.spread_along
        total = nothing
        for along in spread - along_i:
            if abs(along) >= 1.0:
                continue
            across, weight = chord(float(along), count)
            z = np.sqrt(np.maximum(0.0, 1.0 - across**2 - along**2))
            wo = np.stack([cos * across - sin * along, sin * across + cos * along, z], axis=-1)
            total = total + weight @ self.evaluate(np.broadcast_to(wi, wo.shape), wo, uv)
        return total * (spread[1] - spread[0]), nothing

    def thinned(self, step: int) -> Ridge:
        """Return the lobe at every `step`-th wavelength."""
        tables = {
            name: getattr(self.response, name)[..., ::step]
            for name in ("reflectance", "transmittance", "reflectance_inside", "total")
        }
        response = dataclasses.replace(self.response, wavelengths_nm=self.wavelengths_nm[::step], **tables)
        return dataclasses.replace(self, norm=self.norm[::step], response=response)


def chord(along: float, count: int) -> tuple[Array, Array]:
    """Return `count` points and weights over the exits s_x at one s_y, denser towards the unit disc's rim.

    The rim, at which grating orders appear, is integrated exactly; a uniform grid errs there by 0.5 %.
    """
    edge = np.sqrt(1.0 - along * along)
    turn = np.pi * ((np.arange(count, dtype=np.float64) + 0.5) / count - 0.5)
    return edge * np.sin(turn), edge * np.cos(turn) * (np.pi / count)


def gaussian(q: Array, width: float) -> Array:
    """Return the unit-area Gaussian D_y(q) with standard deviation `width`."""
    return np.asarray(np.exp(-0.5 * np.square(q / width)) / (width * np.sqrt(2.0 * np.pi)))


def ridge_interference(
    across: Array,
    normal: Array,
    wavelengths_nm: Array,
    pitch_nm: float,
    width_nm: float,
    height_deviation_nm: float,
    count: int,
) -> Array:
    """Return K(u, v), `[..., wavelength]`, for psi components `across` (x) and `normal` (z), each `[...]`."""
    k = 2.0 * np.pi / np.asarray(wavelengths_nm)
    u, v = across[..., None] * k, normal[..., None] * k
    envelope = np.square(np.sinc(u * width_nm / (2.0 * np.pi)))
    chi2 = np.exp(-np.square(v * height_deviation_nm))
    # reduced to the nearest order: the quotient is then precise at every order, not only at u = 0
    turns = u * pitch_nm / (2.0 * np.pi)
    rest = np.pi * (turns - np.round(turns))
    comb = np.square(count * np.sinc(count * rest / np.pi) / np.sinc(rest / np.pi))
    return np.asarray(envelope * (1.0 - chi2 + chi2 * comb / count))


LEAST_CHORD = 1e-3  # lower limit of sqrt(1 - c^2)


@dataclass(frozen=True)
class RidgeTable(Lobe):
    """Light reflected by ridges along y, with a Gaussian spread along them.

    f = fill D(a, b, c) / sqrt(1 - c^2) D_y(wi_y + wo_y), for both directions at z > 0, with c = |wi_y - wo_y| / 2,
    a = wi_x / sqrt(1 - c^2), b = wo_x / sqrt(1 - c^2) in [-1, 1], and D_y as in `Ridge`.

    D db is the share of light from a that leaves into db. It is symmetric in a and b, so f is reciprocal. Directions
    are first rotated by -rotation about z.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        power: `[c, a, b, wavelength]`, float32, D over uniform nodes in c on [0, 1] and in a and b on [-1, 1], linear
            between.
        spread_along: standard deviation of D_y, dimensionless (sine units).
        fill: fraction of the surface covered by ridges, in [0, 1].
        rotation: optional angle of the direction across the ridges about the normal, rad, from +x to +y.
    """

    kind: ClassVar[str] = "ridge-table"
    wavelengths_nm: Array
    power: NDArray[np.float32]
    spread_along: float
    fill: float
    rotation: Texture | None = None

    def check(self) -> None:
        """Check that the table is consistent.

        Raises:
            ValueError: names the inconsistent array.
        """
        super().check()
        if self.power.ndim != 4 or self.power.shape[3] != len(self.wavelengths_nm):
            raise ValueError("power must be [c, a, b, wavelength]")
        if self.power.shape[1] != self.power.shape[2] or min(self.power.shape[:3]) < 2:
            raise ValueError("power needs as many nodes in a as in b, and two or more in each coordinate")
        if np.any(self.power < 0.0) or not np.array_equal(self.power, np.swapaxes(self.power, 1, 2)):
            raise ValueError("power must not be negative and must be symmetric in a and b")
        _check_spread(self.spread_along, self.fill)

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value `[..., wavelength]` in 1/sr."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        angle = self._angle(uv, wi.shape[:-1])
        (x_i, y_i), (x_o, y_o) = _rotated(wi, angle), _rotated(wo, angle)
        c = np.minimum(0.5 * np.abs(y_i - y_o), 1.0)
        chord = np.sqrt(np.maximum(1.0 - c * c, LEAST_CHORD**2))
        a, b = x_i / chord, x_o / chord
        is_visible = (wi[..., 2] > 0) & (wo[..., 2] > 0) & (np.abs(a) <= 1.0) & (np.abs(b) <= 1.0)
        last = 0.5 * (self.power.shape[1] - 1)
        at = c * (self.power.shape[0] - 1), (np.clip(a, -1, 1) + 1.0) * last, (np.clip(b, -1, 1) + 1.0) * last
        spread = gaussian(y_i + y_o, self.spread_along) * self.fill / chord
        return np.asarray(np.where(is_visible[..., None], interpolate(self.power, at) * spread[..., None], 0.0))

    def _angle(self, uv: Array | None, shape: tuple[int, ...]) -> Array:
        if self.rotation is None:
            return np.zeros(shape)
        return np.asarray(self.rotation(places(uv, shape)), dtype=float)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate over all exits, for light along one `wi[3]`, in sines: cos_o d(omega_o) = ds_x ds_y."""
        wi = np.asarray(wi, dtype=float)
        nothing = np.zeros(len(self.wavelengths_nm))
        if wi[2] <= 0:
            return nothing, nothing
        angle = self._angle(uv, ())
        along_i = float(_rotated(wi, angle)[1])
        offsets = np.linspace(-4.5, 4.5, 28) * self.spread_along
        along = (offsets - along_i)[np.abs(offsets - along_i) < 1.0, None]
        count = 4 * (self.power.shape[2] - 1)
        b = (np.arange(count) + 0.5) * (2.0 / count) - 1.0
        chord = np.sqrt(np.maximum(1.0 - np.square(0.5 * (along_i - along)), LEAST_CHORD**2))
        across = b * chord
        z_squared = 1.0 - across**2 - along**2
        cos, sin = np.cos(angle), np.sin(angle)
        wo = np.stack(
            [cos * across - sin * along, sin * across + cos * along, np.sqrt(np.maximum(z_squared, 0.0))], axis=-1
        )
        values = self.evaluate(np.broadcast_to(wi, wo.shape), wo, uv)
        total = np.einsum("yxl,yx->l", values, np.broadcast_to(chord, across.shape))
        return total * (2.0 / count) * (offsets[1] - offsets[0]), nothing

    def thinned(self, step: int) -> RidgeTable:
        """Return the lobe at every `step`-th wavelength."""
        return RidgeTable(
            self.wavelengths_nm[::step], self.power[..., ::step], self.spread_along, self.fill, self.rotation
        )


def _check_spread(spread_along: float, fill: float) -> None:
    if not (spread_along > 0 and 0 <= fill <= 1):
        raise ValueError("spread_along must be positive and fill in [0, 1]")


def _rotated(w: Array, angle: Array) -> tuple[Array, Array]:
    """Return the components across and along the ridges."""
    cos, sin = np.cos(angle), np.sin(angle)
    return cos * w[..., 0] + sin * w[..., 1], cos * w[..., 1] - sin * w[..., 0]
