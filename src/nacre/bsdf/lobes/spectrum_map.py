"""The relief's lobe: a power spectrum over psi = w_i + w_o, and its compiled look-up.

With (u, v) the lateral and xi the normal component of psi,

    f = S(u, v, xi, lambda) C(psi, w_i, w_o) F(|psi|/2, lambda) g(w_i, lambda) g(w_o, lambda)

with a smoothed power spectrum S, the Kirchhoff or the published factor C, the coating's reflectance F at the
half vector's angle, and the guard g <= 1, which limits the albedo to F. All factors are symmetric: f is reciprocal.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe
from nacre.core.arrays import Array, take_uniform
from nacre.core.jit import compiled
from nacre.core.machine import parallel_for

LEAST_COSINE = 1e-6  # lower limit of the cosines, to avoid division by zero
CHUNK = 1 << 16  # directions per chunk


@dataclass(frozen=True)
class SpectrumMap(Lobe):
    """A reflecting surface described by its power spectrum.

    S is a tensor product of quadratic B-splines in psi_x, psi_y and xi, and linear in wavelength; negative values
    (interpolation ripple in xi) count as zero.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        power: `[psi_x, psi_y, xi, wavelength]`, float32 B-spline coefficients of S, 1/sr.
        psi_first, psi_step: psi_x and psi_y at the first node, and the node spacing.
        xi_first, xi_step: the same for xi.
        reflectance: `[cosine, wavelength]`, F over uniform nodes in |psi|/2 on [0, 1], linear between.
        guard: `[t, azimuth, wavelength]`, g over uniform nodes in t = sqrt(cos theta) on [0, 1] and azimuths
            2 pi k / n, linear between and periodic.
        prefactor: "kirchhoff" or "published".
    """

    kind: ClassVar[str] = "spectrum-map"
    wavelengths_nm: Array
    power: NDArray[np.float32]
    psi_first: float
    psi_step: float
    xi_first: float
    xi_step: float
    reflectance: Array
    guard: Array
    prefactor: str = "kirchhoff"

    def check(self) -> None:
        """Check shapes and ranges.

        Raises:
            ValueError: names the inconsistent array.
        """
        super().check()
        count = len(self.wavelengths_nm)
        if self.power.ndim != 4 or self.power.shape[3] != count or min(self.power.shape[:3]) < 3:
            raise ValueError("power must be [psi_x, psi_y, xi, wavelength] with at least 3 nodes on each axis")
        if self.reflectance.ndim != 2 or self.reflectance.shape[1] != count or len(self.reflectance) < 2:
            raise ValueError("reflectance must be [cosine, wavelength]")
        if self.guard.ndim != 3 or self.guard.shape[2] != count or len(self.guard) < 2:
            raise ValueError("guard must be [t, azimuth, wavelength]")
        if not (self.psi_step > 0 and self.xi_step > 0):
            raise ValueError("psi_step and xi_step must be positive")
        if self.prefactor not in ("kirchhoff", "published"):
            raise ValueError('prefactor must be "kirchhoff" or "published"')

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f in 1/sr, `[..., wavelength]`; zero below the surface."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        shape = wi.shape[:-1]
        flat_i, flat_o = wi.reshape(-1, 3), wo.reshape(-1, 3)
        result = np.zeros((len(flat_i), len(self.wavelengths_nm)))
        for start in range(0, len(flat_i), CHUNK):
            part = slice(start, start + CHUNK)
            values = self.bare(flat_i[part], flat_o[part])
            result[part] = values * self.guard_at(flat_i[part]) * self.guard_at(flat_o[part])
        return result.reshape(*shape, -1)

    def bare(self, wi: Array, wo: Array, place: Array | None = None) -> Array:
        """Return f without the guard, `[n, wavelength]`, for `[n, 3]` directions.

        Args:
            place: node coordinates `[n, 2]` for psi_x and psi_y, for a table with only some of the nodes.
        """
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        cos_i, cos_o = np.maximum(wi[:, 2], LEAST_COSINE), np.maximum(wo[:, 2], LEAST_COSINE)
        u, v, xi = wi[:, 0] + wo[:, 0], wi[:, 1] + wo[:, 1], cos_i + cos_o
        lateral = u**2 + v**2
        if self.prefactor == "published":
            factor = xi**2 / (4.0 * cos_i * cos_o)
        else:
            factor = (lateral + xi**2) ** 2 / (4.0 * xi**2 * cos_i * cos_o)
        fresnel = take_uniform(self.reflectance, 0.5 * np.sqrt(lateral + xi**2), 0)
        return self.spectrum_at(u, v, xi, place) * fresnel * np.where(above, factor, 0.0)[:, None]

    def spectrum_at(self, u: Array, v: Array, xi: Array, place: Array | None = None) -> Array:
        """Return S, `[n, wavelength]`, at `[n]` psi points; `place` as in `bare`."""
        position = np.stack(
            [
                (np.asarray(u, dtype=float) - self.psi_first) / self.psi_step,
                (np.asarray(v, dtype=float) - self.psi_first) / self.psi_step,
                (np.asarray(xi, dtype=float) - self.xi_first) / self.xi_step,
            ],
            axis=-1,
        )
        if place is not None:
            position[:, :2] = place
        return np.asarray(interpolate(self.power, position))

    def guard_at(self, w: Array) -> Array:
        """Return g, `[n, wavelength]`, at directions `[n, 3]`."""
        nodes, azimuths, _ = self.guard.shape
        t = np.sqrt(np.clip(w[:, 2], 0.0, 1.0)) * (nodes - 1)
        phi = np.arctan2(w[:, 1], w[:, 0]) / (2.0 * np.pi) * azimuths
        t0 = np.clip(np.floor(t).astype(int), 0, nodes - 2)
        p0 = np.floor(phi).astype(int)
        ft, fp = (t - t0)[:, None], (phi - p0)[:, None]
        p0, p1 = p0 % azimuths, (p0 + 1) % azimuths
        low = self.guard[t0, p0] * (1 - fp) + self.guard[t0, p1] * fp
        high = self.guard[t0 + 1, p0] * (1 - fp) + self.guard[t0 + 1, p1] * fp
        return np.asarray(low * (1 - ft) + high * ft)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate over all exits in cos(theta_o), in which 1/cos_o cancels, and azimuth, finer than the peaks."""
        wo, weight = exits(self.psi_step)
        wi = np.asarray(wi, dtype=float)
        is_bounded = bool(np.any(self.guard != 1.0))  # skip the look-up of a unit guard
        total = np.zeros(len(self.wavelengths_nm))
        for start in range(0, len(wo), CHUNK):
            part = wo[start : start + CHUNK]
            values = self.bare(np.broadcast_to(wi, part.shape), part)
            total += weight[start : start + CHUNK] @ (values * self.guard_at(part) if is_bounded else values)
        return total * self.guard_at(wi[None])[0], np.zeros_like(total)


@functools.lru_cache(maxsize=2)
def exits(peak_width: float) -> tuple[Array, Array]:
    """Return directions `[n, 3]` and weights cos(theta) d(omega) that resolve peaks with `peak_width` in psi.

    Gauss-Legendre in cos(theta): its nodes are dense towards the normal as sin(theta) requires, and the weight
    cos(theta) cancels the BRDF's 1/cos(theta) at the horizon.
    """
    count = int(np.ceil(2.0 / peak_width))
    x, w = np.polynomial.legendre.leggauss(count)
    cosine, weight = 0.5 * (x + 1.0), 0.5 * w
    azimuths = int(np.ceil(2.0 * np.pi / peak_width))
    phi = (np.arange(azimuths) + 0.5) * (2.0 * np.pi / azimuths)
    sine = np.sqrt(1.0 - cosine**2)
    wo = np.empty((count, azimuths, 3))
    wo[..., 0], wo[..., 1] = sine[:, None] * np.cos(phi), sine[:, None] * np.sin(phi)
    wo[..., 2] = cosine[:, None]
    weights = np.repeat(weight * cosine * (2.0 * np.pi / azimuths), azimuths)
    return wo.reshape(-1, 3), weights


WORK_OF_A_VALUE = 4  # cost of 27 nodes or 4 quarter turns, in units of `parallel_for`
SERIES_UP_TO = 0.75  # sine up to which three series terms are precise to 1e-8 for nodes 0.06 apart


def interpolate(power: Any, position: Any) -> Any:
    """Return the quadratic spline `[n, wavelength]` at node coordinates `position[n, 3]`; negative values become 0.

    The outermost coefficients continue outside the nodes, where the map is zero. Plain threads share the loop:
    numba's own parallel loops take three times as long to compile.

    Args:
        power: `[x, y, xi, wavelength]`, float32 coefficients.
        position: node coordinates, float64.
    """
    points, count = len(position), power.shape[-1]
    result = np.zeros((points, count))
    parallel_for(
        lambda first, last, *_: _interpolate(power, position, first, last, result), points, 1,
        work=points * count * WORK_OF_A_VALUE, jobs=None,
    )  # fmt: skip
    return result


@compiled(nogil=True)
def _interpolate(power, position, first, last, result):
    """Fill the rows from `first` to `last`."""
    nx, ny, nz, count = power.shape
    weight = np.empty((3, 3))
    index = np.empty((3, 3), dtype=np.int64)
    total = np.empty(count)
    for k in range(first, last):
        for axis in range(3):
            size = nx if axis == 0 else (ny if axis == 1 else nz)
            x = min(max(position[k, axis], -1.0), float(size))
            centre = int(np.floor(x + 0.5))
            f = x - centre
            weight[axis, 0] = 0.5 * (0.5 - f) ** 2
            weight[axis, 1] = 0.75 - f * f
            weight[axis, 2] = 0.5 * (0.5 + f) ** 2
            for j in range(3):
                index[axis, j] = min(max(centre + j - 1, 0), size - 1)
        total[:] = 0.0
        for a in range(3):
            for b in range(3):
                w_ab = weight[0, a] * weight[1, b]
                for c in range(3):
                    w = w_ab * weight[2, c]
                    row = power[index[0, a], index[1, b], index[2, c]]
                    for m in range(count):
                        total[m] += w * row[m]
        for m in range(count):
            result[k, m] = 0.0 if total[m] < 0.0 else total[m]


def albedo_shares(power: Any, psi_step: float, xi_first: float, xi_step: float, reflectance: Any, ring_cosines: Any,
                  cosines: int, azimuths: int, is_kirchhoff: bool) -> Any:  # fmt: skip
    """Return the light from each incidence to each cell of exits, `[incidence, cell, wavelength]`, float32.

    Incidences are on rings with `azimuths` equal steps from the x axis. The sum f cos_o d(omega) = f du dv runs over
    the map's own nodes in psi, whose coefficients contain the integral, so only xi is interpolated. 1/cos_o, steep at
    the horizon, is averaged over a node's radial width. Exits contribute to the guard's cells t = sqrt(cos_o) x
    azimuth: to the nearest azimuth and linearly in t.

    The nodes form a centred square: an incidence in the first eighth of a turn shares its geometry with its seven
    images under quarter turns and reflection; only the map differs.

    Args:
        power: `[psi, psi, xi, wavelength]`, psi centred on 0.
        psi_step, xi_first, xi_step: node positions.
        reflectance: `[cosine, wavelength]`.
        ring_cosines: incidence cosine for each ring.
        cosines, azimuths: guard nodes; azimuths is a multiple of 8.
    """
    rings = len(ring_cosines)
    shares = np.zeros((rings * azimuths, cosines * azimuths, power.shape[-1]), dtype=np.float32)
    tasks = rings * (azimuths // 8 + 1)
    one = (power, psi_step, xi_first, xi_step, reflectance, ring_cosines, cosines, azimuths, is_kirchhoff)
    parallel_for(
        lambda begin, end, *_: _shares(*one, begin, end, shares), tasks, 1,
        work=tasks * power.size // power.shape[2] * WORK_OF_A_VALUE, jobs=None,
    )  # fmt: skip
    return shares


@compiled(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _shares(
    power, width, xi_first, xi_step, reflectance, ring_cosines, cosines, azimuths, is_kirchhoff, begin, end, out
):
    """Process tasks: each is a ring and an azimuth with its own output rows."""
    n, _, nz, count = power.shape
    last = reflectance.shape[0] - 1
    eighth, quarter = azimuths // 8, azimuths // 4
    each = eighth + 1
    factor = np.empty(count, dtype=np.float32)
    for task in range(begin, end):
        ring, own = task // each, task % each
        cos_i = ring_cosines[ring]
        sin_i = np.sqrt(1.0 - cos_i * cos_i)
        wi_x, wi_y = sin_i * np.cos(2.0 * np.pi * own / azimuths), sin_i * np.sin(2.0 * np.pi * own / azimuths)
        mirrors = 1 if own == 0 or own == eighth else 2  # on a symmetry axis the mirror image is identical
        for a in range(n):
            u = (a - 0.5 * (n - 1)) * width
            x = u - wi_x
            if abs(x) >= 1.0:
                continue
            for b in range(n):
                v = (b - 0.5 * (n - 1)) * width
                y = v - wi_y
                radius = np.sqrt(x * x + y * y)
                if radius - 0.5 * width >= 1.0:
                    continue
                inner = max(radius - 0.5 * width, -1.0)
                outer = min(radius + 0.5 * width, 1.0)
                if outer < SERIES_UP_TO:
                    # series in the width, with the next term below single precision
                    square = radius * radius
                    room = 1.0 / (1.0 - square)
                    inverse_cosine = np.sqrt(room) * (1.0 + width * width * room * room * (
                        (1.0 + 2.0 * square) / 24.0
                        + width * width * room * room * (9.0 + 72.0 * square + 24.0 * square * square) / 1920.0
                    ))  # fmt: skip
                else:
                    inverse_cosine = (np.arcsin(outer) - np.arcsin(inner)) / width
                middle = min(0.5 * (inner + outer), 1.0) if outer == 1.0 else radius
                cos_o = np.sqrt(max(1.0 - middle * middle, 1e-12))
                xi = cos_i + cos_o
                z = (xi - xi_first) / xi_step
                centre = int(np.floor(z + 0.5))
                f = z - centre
                w0, w1 = np.float32(0.5 * (0.5 - f) ** 2), np.float32(0.75 - f * f)
                w2 = np.float32(0.5 * (0.5 + f) ** 2)
                z0, z1 = min(max(centre - 1, 0), nz - 1), min(max(centre, 0), nz - 1)
                z2 = min(max(centre + 1, 0), nz - 1)
                length = u * u + v * v + xi * xi
                geometry = length * length / (xi * xi) if is_kirchhoff else xi * xi
                geometry *= width * width * inverse_cosine / (4.0 * cos_i)
                g = min(0.5 * np.sqrt(length), 1.0) * last
                low = min(int(g), last - 1)
                f = g - low
                for m in range(count):
                    factor[m] = geometry * (reflectance[low, m] * (1.0 - f) + reflectance[low + 1, m] * f)
                t = np.sqrt(cos_o) * (cosines - 1)
                t0 = min(int(t), cosines - 2)
                upper = np.float32(t - t0)
                lower = np.float32(1.0) - upper
                azimuth = int(np.floor(np.arctan2(y, x) / (2.0 * np.pi) * azimuths + 0.5))
                for mirror in range(mirrors):
                    p, q = a, (n - 1 - b if mirror else b)
                    sign = -1 if mirror else 1
                    for turn in range(4):
                        row = ring * azimuths + (sign * own + turn * quarter) % azimuths
                        cell = t0 * azimuths + (sign * azimuth + turn * quarter) % azimuths
                        for m in range(count):
                            value = w0 * power[p, q, z0, m] + w1 * power[p, q, z1, m] + w2 * power[p, q, z2, m]
                            amount = max(value, np.float32(0.0)) * factor[m]
                            out[row, cell, m] += amount * lower
                            out[row, cell + azimuths, m] += amount * upper
                        p, q = n - 1 - q, p  # a quarter turn: (u, v) -> (-v, u)
