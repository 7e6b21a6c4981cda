"""The interface tables of `nacre.bsdf.response` on the device, with R and T in one look-up."""

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.response import InterfaceResponse, dyadic_levels, is_uniform
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import UniformNodes, larger, opaque, opaque_int, smaller
from nacre.device.tables import DeviceParameters, DeviceTable, Located, WavelengthAxis

MIN_SHARE = 0.1  # limits the weight of wavelengths far from the mean
# relative power, comparable to the device's precision: a soap film, which absorbs up to 0.7e-4, then needs a quarter
# of the reads
LOSSLESS = 1e-4
DIM, DIM_SHARE = 1e-3, 0.1


class DeviceResponse:
    """R and T of an interface from both sides.

    All angles share one table with consecutive row regions: light from outside (R, T), from inside below the critical
    angle (R_inside, T), from inside beyond it (total, 0). The region is chosen first, and a single look-up returns both
    numbers. Opaque interfaces store only R in the first region. So do lossless ones, with T = 1 - R, equal R from
    both sides, and total reflection beyond the critical angle.

    Attributes:
        is_lossless: whether R + T = 1 to `LOSSLESS`, from both sides.
        eta: n_inside/n_outside, opaque; `bends` is whether it differs from 1 (refraction).
        transmits: whether the interface transmits.
        flipped: whether outside is at -z.

    Args:
        response: the tables.
        nodes: locates the nodes of a leading axis; default: `DeviceParameters` of the texture-driven axes.
    """

    def __init__(self, response: InterfaceResponse, nodes: Any = None) -> None:
        self.transmits = bool(response.transmits)
        self.flipped = bool(response.flipped)
        self.bends = response.eta > 1.0
        self.is_lossless = _is_lossless(response)
        self.axis = WavelengthAxis(response.wavelengths_nm)
        self.is_uniform = _is_uniform(response)
        self.has_own_nodes = nodes is not None
        self.parameters = nodes if self.has_own_nodes else DeviceParameters(response.parameters)
        stacked = _stacked(response, self.is_lossless)
        self.table = DeviceTable(stacked, may_halve=_is_bright(stacked))
        self.shares = DeviceTable(_shares(response)) if self.transmits and not self.is_lossless else None
        self._set_numbers(response)

    def _set_numbers(self, response: InterfaceResponse) -> None:
        self.nodes = len(response.cos_outside)
        beyond = response.total.shape[-2]
        self.eta = opaque(response.eta)
        self.inv_eta = opaque(1.0 / response.eta)
        # opaque: tables of other sizes reuse the kernel
        self.top = opaque(self.nodes - 1)
        self.max_low = opaque(max(self.nodes - 2, 0))
        self.inside_row = opaque(self.nodes)
        self.beyond_row = opaque(2 * self.nodes)
        self.beyond_scale = opaque((beyond - 1) * 2.0 / math.pi)
        self.beyond_max_low = opaque(max(beyond - 2, 0))
        self.inv_beyond_cells = opaque(1.0 / max(beyond - 1, 1))
        self.critical = opaque(response.cos_critical)
        self.inv_critical = opaque(1.0 / max(response.cos_critical, 1e-6))
        self.intervals = None if self.is_uniform else DyadicIntervals(response.cos_outside, response.nodes_beyond)

    def update(self, response: InterfaceResponse) -> None:
        """Replace the tables by others with the same structure.

        Raises:
            UnsupportedError: the structure (sides, parameters, sizes) differs.
        """
        structure = (bool(response.transmits), bool(response.flipped), response.eta > 1.0, _is_lossless(response))
        if structure != (self.transmits, self.flipped, self.bends, self.is_lossless):
            raise UnsupportedError("absorption, transmission or the denser side changed; build the scene again")
        if self.is_uniform != _is_uniform(response):
            raise UnsupportedError("the nodes over angle became irregular or uniform; build the scene again")
        if not self.has_own_nodes:
            self.parameters.update(response.parameters)
        self.table.update(_stacked(response, self.is_lossless))
        if self.shares is not None:
            self.shares.update(_shares(response))
        self.axis.update(response.wavelengths_nm)
        self._set_numbers(response)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the stacked tables `[*params, row, wavelength, channel]` for R, or for R and T."""
        if dr.is_jit_v(mi.Float):
            callback.put(f"{prefix}response", self.table.values, mi.ParamFlags.Differentiable)

    def look_up(self, cos: Any, inside: Any, si: Any, active: Any) -> tuple[Any, Any]:
        """Return `(R, T)` at the four wavelengths; T is None for an opaque interface.

        Args:
            cos: cosine (>= 0) between light and (micro-)normal in the light's own medium.
            inside: mask of light from inside; ignored by an opaque interface.
            si: contains wavelengths and uv.
            active: mask of the reads.
        """
        where = self.axis.locate(si.wavelengths, active)
        corners = self.parameters.corners(si, active)
        cos = smaller(cos, 1.0)
        if not self.transmits:
            row, fraction = self._cosine_row(cos, active)
            (reflected,) = self.table.look_up(row, fraction, where, corners, active)
            return reflected, None
        if self.is_lossless:
            return self._look_up_lossless(cos, inside, where, corners, active)
        row, fraction = self._row(cos, inside, active)
        reflected, transmitted = self.table.look_up(row, fraction, where, corners, active)
        return reflected, transmitted

    def split(self, cos: Any, inside: Any, si: Any, active: Any) -> tuple[Any, Callable[[Any], Any]]:
        """Return the reflection probability, and a function from a reflection mask to R or T.

        Without absorption both numbers follow from R, and the probability uses the ray's own wavelengths. With
        absorption a second spectrum would double the cost: the probability then uses the mean over all wavelengths.
        """
        if self.shares is None:
            reflected, transmitted = self.look_up(cos, inside, si, active)
            share = share_reflected(reflected, transmitted)
            return share, lambda reflects: dr.select(reflects, reflected, transmitted)
        where = self.axis.locate(si.wavelengths, active)
        corners = self.parameters.corners(si, active)
        row, fraction = self._row(smaller(cos, 1.0), inside, active)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        grey = Located([mi.UInt32(0)] * lines, [mi.Float(0.0)] * lines)
        share = self.shares.look_up(row, fraction, grey, corners, active)[0][0]

        def value(reflects: Any) -> Any:
            channel = dr.select(reflects, mi.UInt32(0), mi.UInt32(1))
            return self.table.look_up_channel(row, fraction, where, corners, channel, active)

        return share, value

    def _look_up_lossless(
        self, cos: Any, inside: Any, where: Located, corners: list[tuple[Any, Any]] | None, active: Any
    ) -> tuple[Any, Any]:
        if self.bends:
            outside2 = 1.0 - self.eta * self.eta * (1.0 - cos * cos)
            outer = dr.select(inside, dr.sqrt(larger(outside2, 0.0)), cos)
        else:
            outer = cos
        row, fraction = self._cosine_row(outer, active)
        (reflected,) = self.table.look_up(row, fraction, where, corners, active)
        if self.bends:
            reflected = dr.select(inside & (cos < self.critical), mi.UnpolarizedSpectrum(1.0), reflected)
        return reflected, 1.0 - reflected

    def _cosine_row(self, cos: Any, active: Any) -> tuple[Any, Any]:
        """Return the row and fraction of a cosine outside, in the first region."""
        if self.intervals is not None:
            return self.intervals.locate(cos, None, active)
        position = cos * self.top
        low = smaller(dr.floor(position), self.max_low)
        return mi.UInt32(low), position - low

    def _row(self, cos: Any, inside: Any, active: Any) -> tuple[Any, Any]:
        """Return a transmitting interface's row."""
        if not self.bends:
            row, fraction = self._cosine_row(cos, active)
            return row + mi.UInt32(dr.select(inside, self.inside_row, 0.0)), fraction
        sin2_outside = self.eta * self.eta * (1.0 - cos * cos)
        outer = dr.select(inside, dr.sqrt(larger(1.0 - sin2_outside, 0.0)), cos)
        is_beyond = inside & (cos < self.critical)
        beyond = dr.acos(larger(smaller(cos * self.inv_critical, 1.0), 0.0)) * self.beyond_scale
        if self.intervals is not None:
            unit = dr.select(is_beyond, beyond * self.inv_beyond_cells, outer)
            row, fraction = self.intervals.locate(unit, is_beyond, active)
            start = dr.select(is_beyond, self.beyond_row, dr.select(inside, self.inside_row, 0.0))
            return row + mi.UInt32(start), fraction
        position = dr.select(is_beyond, beyond, outer * self.top)
        low = smaller(dr.floor(position), dr.select(is_beyond, self.beyond_max_low, self.max_low))
        start = dr.select(is_beyond, self.beyond_row, dr.select(inside, self.inside_row, 0.0))
        return mi.UInt32(low + start), position - low


class Azimuths:
    """Azimuth nodes, in place of texture-driven parameters.

    Args:
        count: node count from 0 to 2 pi, both included.
        rotation_rad: rotation of the tables about the normal.
    """

    def __init__(self, count: int, rotation_rad: float = 0.0) -> None:
        self.update(count, rotation_rad)

    def update(self, count: int, rotation_rad: float = 0.0) -> None:
        """Replace the data."""
        self.nodes = UniformNodes(count)
        self.rotation = opaque(rotation_rad / (2.0 * math.pi))

    def corners(self, si: Any, active: Any = True) -> list[tuple[Any, Any]]:
        """Return `(node, weight)` for the two nodes around the azimuth of `si.wi`, or of the exit if from inside."""
        turns = dr.atan2(si.wi.y, si.wi.x) * (0.5 * dr.inv_pi) - self.rotation
        turns = turns + dr.select(si.wi.z < 0.0, 0.5, 0.0)
        last = self.nodes.last
        low, part = self.nodes.cell(smaller((turns - dr.floor(turns)) * last, last))
        return [(low, 1.0 - part), (low + 1, part)]


class DyadicIntervals:
    """Locates values in [0, 1] in irregular dyadic intervals with one read.

    A uniform grid as fine as the smallest interval holds each cell's interval number and level.

    Args:
        inner: `[node]`, the nodes of the cosine outside.
        beyond: `[node]`, those beyond the critical angle, or empty.
    """

    LEVEL_BITS = 5

    def __init__(self, inner: NDArray[np.float64], beyond: NDArray[np.float64]) -> None:
        levels = [dyadic_levels(nodes) for nodes in (inner, beyond if len(beyond) else np.array([0.0, 1.0]))]
        finest = max(int(level.max()) for level in levels)
        words = [
            np.repeat((np.arange(len(level)) << self.LEVEL_BITS) | level, 2 ** (finest - level)) for level in levels
        ]
        self.cells = opaque(2**finest)
        self.last_cell = opaque_int(2**finest - 1)
        self.finest = opaque_int(finest)
        joined = np.concatenate(words).astype(np.uint32)
        self.words = mi.UInt32(joined) if dr.is_jit_v(mi.Float) else joined

    def locate(self, value: Any, is_beyond: Any, active: Any) -> tuple[Any, Any]:
        """Return the interval and the fraction of its width.

        Args:
            is_beyond: mask of values beyond the critical angle; None: none is.
        """
        at = value * self.cells
        cell = dr.minimum(mi.UInt32(at), self.last_cell)
        index = cell if is_beyond is None else cell + dr.select(is_beyond, self.last_cell + 1, mi.UInt32(0))
        word = dr.gather(mi.UInt32, self.words, index, active) if dr.is_jit_v(mi.Float) else int(self.words[int(index)])
        level = word & mi.UInt32(2**self.LEVEL_BITS - 1)
        shift = self.finest - level
        start = (cell >> shift) << shift
        fraction = (at - mi.Float(start)) / mi.Float(mi.UInt32(1) << shift)
        return mi.UInt32(word >> mi.UInt32(self.LEVEL_BITS)), fraction


def _is_uniform(response: InterfaceResponse) -> bool:
    return is_uniform(response.cos_outside) and is_uniform(response.nodes_beyond)


def _is_lossless(response: InterfaceResponse) -> bool:
    """Whether a transmitting interface's tables follow from its reflectance."""
    if not response.transmits:
        return False
    missing = max(
        float(np.max(np.abs(response.reflectance + response.transmittance - 1.0))),
        float(np.max(np.abs(response.reflectance_inside - response.reflectance))),
        float(np.max(np.abs(response.total - 1.0), initial=0.0)),
    )
    return missing <= LOSSLESS


def _is_bright(stacked: NDArray[np.float64]) -> bool:
    """Whether few entries are so dim that 16-bit rounding exceeds 1 %."""
    lit = stacked[stacked > 0.0]
    return bool(lit.size and np.mean(lit < DIM) < DIM_SHARE)


def _stacked(response: InterfaceResponse, is_lossless: bool) -> NDArray[np.float64]:
    """Return the concatenated regions: `[*params, row, wavelength, channel]`."""
    if not response.transmits or is_lossless:
        return np.asarray(response.reflectance[..., None], dtype=float)
    regions = [(response.reflectance, response.transmittance), (response.reflectance_inside, response.transmittance)]
    if response.eta > 1.0:
        regions.append((response.total, np.zeros_like(response.total)))
    return np.concatenate([np.stack(pair, axis=-1) for pair in regions], axis=-3)


def _shares(response: InterfaceResponse) -> NDArray[np.float64]:
    """Return the reflection probability `[*params, row, 1, 1]`, at least `MIN_SHARE` from 0 and 1 if both occur."""
    stacked = _stacked(response, False).mean(axis=-2, keepdims=True)
    reflected, transmitted = stacked[..., :1], stacked[..., 1:]
    total = reflected + transmitted
    share = np.where(total > 0.0, reflected / np.where(total > 0.0, total, 1.0), 1.0)
    low, high = np.where(reflected > 0.0, MIN_SHARE, 0.0), np.where(transmitted > 0.0, 1.0 - MIN_SHARE, 1.0)
    return np.asarray(np.clip(share, low, high))


def share_reflected(reflected: Any, transmitted: Any) -> Any:
    """Return the reflection probability R/(R + T), each averaged over the ray's wavelengths; 1 if opaque."""
    if transmitted is None:
        return mi.Float(1.0)
    r, t = dr.sum(reflected), dr.sum(transmitted)
    return dr.select(r + t > 0.0, r / larger(r + t, 1e-20), 1.0)
