"""Ridges solved rigorously: the light that leaves across them, tabulated over light and view directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.ridge import gaussian
from nacre.bsdf.texture import Texture, places
from nacre.core.arrays import Array, interpolate

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
    fill: float = 1.0
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
        if not (self.spread_along > 0 and 0 <= self.fill <= 1):
            raise ValueError("spread_along must be positive and fill in [0, 1]")

    @property
    def transmits(self) -> bool:
        """Always False: ridges only reflect."""
        return False

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value `[..., wavelength]` in 1/sr."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        angle = self._angle(uv, wi.shape[:-1])
        (x_i, y_i), (x_o, y_o) = _rotated(wi, angle), _rotated(wo, angle)
        c = np.minimum(0.5 * np.abs(y_i - y_o), 1.0)
        chord = np.sqrt(np.maximum(1.0 - c * c, LEAST_CHORD**2))
        a, b = x_i / chord, x_o / chord
        seen = (wi[..., 2] > 0) & (wo[..., 2] > 0) & (np.abs(a) <= 1.0) & (np.abs(b) <= 1.0)
        last = 0.5 * (self.power.shape[1] - 1)
        at = c * (self.power.shape[0] - 1), (np.clip(a, -1, 1) + 1.0) * last, (np.clip(b, -1, 1) + 1.0) * last
        spread = gaussian(y_i + y_o, self.spread_along) * self.fill / chord
        return np.asarray(np.where(seen[..., None], interpolate(self.power, at) * spread[..., None], 0.0))

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


def _rotated(w: Array, angle: Array) -> tuple[Array, Array]:
    """Return the components across and along the ridges."""
    cos, sin = np.cos(angle), np.sin(angle)
    return cos * w[..., 0] + sin * w[..., 1], cos * w[..., 1] - sin * w[..., 0]
