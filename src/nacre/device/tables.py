"""Tables, textures and wavelength axes on the device.

Values and multilinear interpolation are those of the arrays. Small tables are stored as *cells*: the four corners of
each (row, wavelength) cell are adjacent, and one packet load fetches a bilinear look-up. This quadruples the memory;
large tables (many texture-driven nodes) stay plain.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.texture import Formula, ParameterAxis, Texture, smooth_noise
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import (
    UniformNodes,
    aligned,
    device_array,
    larger,
    opaque,
    opaque_int,
    read,
    read2,
    read4,
    replaced,
    smaller,
)

MAX_CELL_BYTES = 48 * 2**20
HALF = 0xFFFF  # the largest 16-bit number


@dataclass
class Located:
    """The rays' wavelengths in a grid: lower node and fraction above it, for each wavelength.

    `site` is the surface interaction, for a base with its own wavelength grid. `nodes` are the wavelengths'
    nodes after `on_nodes`.
    """

    low: list[Any]
    fraction: list[Any]
    site: Any = None
    nodes: list[Any] | None = None

    def on_nodes(self, u: Any) -> Located:
        """Move each wavelength to one of its two nodes at random, by a number in [0, 1) and its fraction.

        The mean equals linear interpolation between the nodes, with half the reads.
        """
        upper = [u < part for part in self.fraction]
        fraction = [dr.select(up, mi.Float(1.0), 0.0) for up in upper]
        nodes = [low + dr.select(up, mi.UInt32(1), 0) for low, up in zip(self.low, upper, strict=True)]
        return Located(self.low, fraction, self.site, nodes)


class WavelengthAxis:
    """Locates wavelengths in a uniform or irregular grid; the ends continue outside."""

    def __init__(self, wavelengths_nm: Array) -> None:
        self.update(wavelengths_nm)

    def update(self, wavelengths_nm: Array) -> None:
        """Replace the grid; uniform and irregular grids need different kernels."""
        grid = np.asarray(wavelengths_nm, dtype=float)
        if len(grid) == 1:
            grid = np.array([grid[0], grid[0] + 1.0])
        self.size = len(grid)
        step = np.diff(grid)
        self.is_uniform = bool(np.allclose(step, step[0], rtol=1e-6))
        self.first = opaque(grid[0])
        self.last_cell = opaque(self.size - 1)
        self.max_low = opaque_int(self.size - 2)
        if self.is_uniform:
            self.per_nm = opaque((self.size - 1) / (grid[-1] - grid[0]))
            return
        # bins are not wider than the finest step: the node below a wavelength is the bin's or the next one
        bins = int(np.ceil((grid[-1] - grid[0]) / step.min())) + 1
        if bins > 10**6:
            raise UnsupportedError(f"wavelength steps of {step.min():.3g} nm in a wide grid are too fine for rendering")
        width = (grid[-1] - grid[0]) / bins
        starts = grid[0] + width * np.arange(bins)
        below = np.clip(np.searchsorted(grid, starts, side="right") - 1, 0, self.size - 2)
        self.per_nm = opaque(1.0 / width)
        self.last_bin = opaque(bins - 1)
        self.bin_node = device_array(below)
        self.nodes = device_array(grid)

    def locate(self, wavelengths: Any, active: Any = True) -> Located:
        """Locate `si.wavelengths`; wavelengths outside (such as the 0 of test harnesses) are clamped."""
        if mi.is_rgb:  # the three nodes are the channels
            nodes = ((0, 0.0), (1, 0.0), (1, 1.0))
            return Located([mi.UInt32(node) for node, _ in nodes], [mi.Float(part) for _, part in nodes])
        low, fraction = [], []
        for k in range(dr.size_v(mi.UnpolarizedSpectrum)):
            a, b = self._locate_one(wavelengths[k], active)
            low.append(a)
            fraction.append(b)
        return Located(low, fraction)

    def _locate_one(self, wavelength: Any, active: Any) -> tuple[Any, Any]:
        if self.is_uniform:
            position = larger(smaller((wavelength - self.first) * self.per_nm, self.last_cell), 0.0)
            low = dr.minimum(mi.UInt32(position), self.max_low)
            return low, position - mi.Float(low)
        position = dr.clip((wavelength - self.first) * self.per_nm, 0.0, self.last_bin)
        node = mi.UInt32(read(self.bin_node, mi.UInt32(position), active) + 0.5)
        above = read(self.nodes, node + 1, active)
        low = dr.minimum(dr.select(wavelength >= above, node + 1, node), self.max_low)
        start, end = read(self.nodes, low, active), read(self.nodes, low + 1, active)
        width = dr.select(active, end - start, 1.0)  # inactive lanes read zeros
        return low, dr.clip((wavelength - start) / width, 0.0, 1.0)


class DeviceTable:
    """`[*params, row, wavelength, channel]` on the device.

    Args:
        values: the array.
        as_cells: False for a table that is read at its nodes (`at_nodes`).
        may_halve: whether 16-bit numbers (8e-6 of the largest) are precise enough, without gradients.

    Attributes:
        shape: the values' shape; channels: 1 or 2.
        values: the tensor, for `traverse`; call `repack()` after a change.
    """

    def __init__(self, values: Array, as_cells: bool = True, may_halve: bool = False) -> None:
        values = _padded(np.asarray(values, dtype=float))
        self.channels = values.shape[-1]
        self.may_halve = may_halve and as_cells and self.channels == 2 and _fits_as_cells(values.shape)
        self.as_cells = as_cells
        self.is_packed = as_cells and _fits_as_cells(values.shape)
        self.values: Any = None
        self._set(values)

    def update(self, values: Array) -> None:
        """Replace all values; their number may change, since sizes are data.

        Raises:
            UnsupportedError: the number of axes or channels, or the memory layout, differs.
        """
        values = _padded(np.asarray(values, dtype=float))
        same = len(values.shape) == len(self.shape) and values.shape[-1] == self.channels
        if not same or (self.as_cells and _fits_as_cells(values.shape)) != self.is_packed:
            raise UnsupportedError(f"a table of shape {self.shape} cannot become one of {values.shape}")
        self._set(values)

    def _set(self, values: Array) -> None:
        self.shape = values.shape
        self.row_stride = opaque_int(values.shape[-2] - 1 if self.is_packed else values.shape[-2])
        self.rows_opaque = opaque_int(values.shape[-3])
        if dr.is_jit_v(mi.Float):
            self.values = replaced(self.values, mi.TensorXf(device_array(values), values.shape))
        else:
            self.values = np.ascontiguousarray(values, dtype=np.float32)
        self.repack()

    def repack(self) -> None:
        """Update the look-up layout from `values`."""
        flat = self.values.array if dr.is_jit_v(mi.Float) else self.values.ravel()
        self.halves: Any = None
        if self.may_halve and dr.is_jit_v(mi.Float) and not dr.grad_enabled(self.values):
            self._halve(np.array(flat))
        if not self.is_packed:
            self.packed = flat
            return
        order = _cell_order(self.shape)
        if dr.is_jit_v(mi.Float):
            self.packed = dr.gather(mi.Float, flat, mi.UInt32(order))
            dr.eval(self.packed)
        else:
            self.packed = flat[order]

    def _halve(self, flat: NDArray[np.float32]) -> None:
        """Store cells as four words of two 16-bit numbers: one load for both channels and half the memory."""
        top = max(float(flat.max()), 1e-30)
        steps = np.rint(flat * (HALF / top)).astype(np.uint32)[_cell_order(self.shape)].reshape(-1, 2)
        words = aligned(steps[:, 0] | steps[:, 1] << np.uint32(16), np.uint32)
        self.halves, self.half_unit = mi.UInt32(words), opaque(top / HALF)

    def look_up(
        self, row: Any, fraction: Any, where: Located, corners: list[tuple[Any, Any]] | None = None, active: Any = True
    ) -> list[Any]:
        """Interpolate at `row + fraction`, `row <= rows - 2`: one `mi.UnpolarizedSpectrum` for each channel.

        Args:
            row: lower row.
            fraction: in [0, 1].
            where: the wavelengths.
            corners: `(flat index, weight)` of the surrounding parameter nodes, if any.
            active: mask of the reads.
        """
        totals = None
        for index, weight in corners or [(None, None)]:
            at = row if index is None else index * self.rows_opaque + row
            values = self._bilinear(at, fraction, where, active)
            if weight is not None:
                values = [value * weight for value in values]
            totals = values if totals is None else [a + b for a, b in zip(totals, values, strict=True)]
        assert totals is not None
        return totals

    def at_nodes(self, row: Any, where: Located, active: Any = True) -> list[Any]:
        """Read a row at the wavelength nodes: one `mi.UnpolarizedSpectrum` for each channel."""
        assert where.nodes is not None
        assert not self.is_packed
        results = [mi.UnpolarizedSpectrum(0.0) for _ in range(self.channels)]
        start = row * self.row_stride
        for k, node in enumerate(where.nodes):
            for channel, value in enumerate(self._corner(start + node, active)):
                results[channel][k] = value
        return results

    def look_up_channel(
        self,
        row: Any,
        fraction: Any,
        where: Located,
        corners: list[tuple[Any, Any]] | None,
        channel: Any,
        active: Any = True,
    ) -> Any:
        """Interpolate one channel, chosen per lane: one `mi.UnpolarizedSpectrum` at the cost of a one-channel table."""
        total = mi.UnpolarizedSpectrum(0.0)
        for index, weight in corners or [(None, None)]:
            start = (row if index is None else index * self.rows_opaque + row) * self.row_stride
            values = mi.UnpolarizedSpectrum(0.0)
            for k, (low, part) in enumerate(zip(where.low, where.fraction, strict=True)):
                cell = start + low
                if self.halves is not None:
                    words = dr.gather(mi.Vector2u, self.halves, cell * 2 + channel, active)
                    ends = [_between_halves(word, part) for word in words]
                    values[k] = dr.lerp(ends[0], ends[1], fraction) * self.half_unit
                    continue
                if self.is_packed:
                    c = read4(self.packed, cell * self.channels + channel, active)
                else:
                    cells = (cell, cell + 1, cell + self.row_stride, cell + self.row_stride + 1)
                    c = [read(self.packed, at * self.channels + channel, active) for at in cells]
                values[k] = dr.lerp(dr.lerp(c[0], c[1], part), dr.lerp(c[2], c[3], part), fraction)
            total = total + (values if weight is None else values * weight)
        return total

    def _bilinear(self, row: Any, fraction: Any, where: Located, active: Any) -> list[Any]:
        results = [mi.UnpolarizedSpectrum(0.0) for _ in range(self.channels)]
        start = row * self.row_stride
        for k, (low, part) in enumerate(zip(where.low, where.fraction, strict=True)):
            cell = start + low
            if self.halves is not None:
                words = dr.gather(mi.ArrayXu, self.halves, cell, active, shape=(4, dr.width(cell)))
                ends = [_between_halves(word, part) for word in words]
                for channel in range(2):
                    result = dr.lerp(ends[2 * channel], ends[2 * channel + 1], fraction)
                    results[channel][k] = result * self.half_unit
                continue
            if self.is_packed:
                for channel in range(self.channels):
                    c = read4(self.packed, cell * self.channels + channel, active)
                    near, far = dr.lerp(c[0], c[1], part), dr.lerp(c[2], c[3], part)
                    results[channel][k] = dr.lerp(near, far, fraction)
                continue
            for channel, value in enumerate(self._plain(cell, part, fraction, active)):
                results[channel][k] = value
        return results

    def _plain(self, cell: Any, part: Any, fraction: Any, active: Any) -> list[Any]:
        cells = (cell, cell + 1, cell + self.row_stride, cell + self.row_stride + 1)
        c = [self._corner(at, active) for at in cells]
        return [
            dr.lerp(dr.lerp(c[0][i], c[1][i], part), dr.lerp(c[2][i], c[3][i], part), fraction)
            for i in range(self.channels)
        ]

    def _corner(self, at: Any, active: Any) -> Any:
        """Read all channels of one entry in the plain layout."""
        return [read(self.packed, at, active)] if self.channels == 1 else read2(self.packed, at, active)


def _between_halves(word: Any, part: Any) -> Any:
    """Interpolate between a word's two numbers."""
    return dr.lerp(mi.Float(word & HALF), mi.Float(word >> 16), part)


def _fits_as_cells(shape: tuple[int, ...]) -> bool:
    """Whether four single-precision corners per value fit in `MAX_CELL_BYTES`."""
    return int(np.prod(shape)) * 16 <= MAX_CELL_BYTES


def _padded(values: Array) -> Array:
    """Repeat a single row or column, for at least two of each."""
    for axis in (-3, -2):
        if values.shape[axis] == 1:
            values = np.repeat(values, 2, axis=axis)
    return values


def _cell_order(shape: tuple[int, ...]) -> NDArray[np.uint32]:
    """Return the flat positions of each cell's corners: near/far row, low/high wavelength."""
    *params, rows, columns, channels = shape
    index = np.arange(int(np.prod(shape)), dtype=np.uint32).reshape(-1, rows, columns, channels)
    near, far = index, np.concatenate([index[:, 1:], index[:, -1:]], axis=1)
    corners = np.stack([near[:, :, :-1], near[:, :, 1:], far[:, :, :-1], far[:, :, 1:]], axis=-1)
    return np.ascontiguousarray(corners.reshape(-1))  # [param, row, cell, channel, corner]


# Textures on the device: formula trees and images from `nacre.bsdf.texture`, and the object's own space.


@dataclass(frozen=True)
class ObjectFrame:
    """An object's own space: from its bounding sphere's centre, in sphere radii, z up.

    Attributes:
        centre, radius: the sphere before the object's rotation, in scene units.
        turn_deg: the object's rotation about the scene's z axis.
    """

    centre: Sequence[float]
    radius: float
    turn_deg: float = 0.0


class ObjectSpace:
    """Converts scene interactions to the textures' coordinates.

    Args:
        frame: the object's position, for formulas in x, y and z; optional.
        v_up: whether v runs upward on the shapes, as on nacre's own shapes and Mitsuba's rectangle; it runs downward on
            Mitsuba's sphere and in its OBJ reader, which inverts a file's v.
    """

    def __init__(self, frame: ObjectFrame | None, v_up: bool = True) -> None:
        self.has_place, self.v_up = frame is not None, v_up
        if frame is None:
            return
        turn = np.radians(frame.turn_deg)
        self._cos, self._sin = opaque(np.cos(turn)), opaque(np.sin(turn))
        self._centre = [opaque(value) for value in frame.centre]
        self._per_radius = opaque(1.0 / frame.radius)

    def __call__(self, si: Any) -> Any:
        """Return a copy of an interaction with v upward and p in the object's own space."""
        own = mi.SurfaceInteraction3f(si)
        if not self.v_up:
            own.uv = mi.Point2f(si.uv.x, 1.0 - si.uv.y)
        if self.has_place:
            x, y = si.p.x * self._cos + si.p.y * self._sin, si.p.y * self._cos - si.p.x * self._sin
            placed = [
                (value - middle) * self._per_radius for value, middle in zip((x, y, si.p.z), self._centre, strict=True)
            ]
            own.p = mi.Point3f(*placed)
        return own


def _unary(name: str) -> Callable[[Any], Any]:
    return lambda a: getattr(dr, name)(mi.Float(a))


DRJIT_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: mi.Float(a) / mi.Float(b),
    "pow": lambda a, b: _power(mi.Float(a), b),
    "neg": lambda a: -a,
    **{name: _unary(name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "floor")},
    "min": lambda a, b: dr.minimum(mi.Float(a), b),
    "max": lambda a, b: dr.maximum(mi.Float(a), b),
    "atan2": lambda a, b: dr.atan2(mi.Float(a), mi.Float(b)),
    "mod": lambda a, b: mi.Float(a) - mi.Float(b) * dr.floor(mi.Float(a) / mi.Float(b)),
    "step": lambda edge, x: dr.select(mi.Float(x) < edge, mi.Float(0.0), mi.Float(1.0)),
    "clip": lambda x, low, high: dr.minimum(dr.maximum(mi.Float(x), low), high),
    "mix": lambda a, b, t: a + (b - a) * t,
    "noise": lambda u, v: smooth_noise(u, v, lambda x: dr.sin(mi.Float(x))),
}


def _power(base: Any, exponent: Any) -> Any:
    """Return a power as numpy does: small integer exponents accept negative bases."""
    if isinstance(exponent, float) and exponent.is_integer() and abs(exponent) <= 64:
        count = int(abs(exponent))
        result = mi.Float(1.0)
        for _ in range(count):
            result = result * base
        return result if exponent >= 0 else 1.0 / result
    return dr.exp(mi.Float(exponent) * dr.log(base))


class DeviceTexture:
    """A scalar over a surface: `texture(si)` within [low, high], equal to `nacre.bsdf.texture.Texture`."""

    def __init__(self, texture: Texture) -> None:
        self.formula: Formula | None = None
        numbers: dict[str, float] = {}
        if texture.formula is not None:
            self.formula, numbers = texture.formula.with_holes()
        self.constants = {name: opaque(value) for name, value in numbers.items()}
        self.is_stepped = texture.is_stepped
        self.low, self.high = opaque(texture.low), opaque(texture.high)
        if texture.formula is None:
            assert texture.image is not None
            self.rows, self.columns = texture.image.shape
            self.rows_o, self.columns_o = opaque_int(self.rows), opaque_int(self.columns)
            self.size = (opaque(self.columns), opaque(self.rows))
            self.image = device_array(texture.image)

    def fits(self, texture: Texture) -> bool:
        """Whether another texture differs only in numbers or pixels and can reuse the kernel."""
        formula = texture.formula.with_holes()[0] if texture.formula else None
        return bool(self.formula == formula and self.is_stepped == texture.is_stepped)

    def update(self, texture: Texture) -> None:
        """Replace the range and image by another texture's.

        Raises:
            UnsupportedError: another formula, or an image rather than a formula, which needs a new kernel.
        """
        if not self.fits(texture):
            raise UnsupportedError("another texture formula cannot be swapped in; build the scene again")
        self.__init__(texture)  # type: ignore[misc]  # the object starts anew with the same structure

    def __call__(self, si: Any, active: Any = True) -> Any:
        """Evaluate at an interaction: its uv, and its p in the object's own space."""
        u, v = mi.Float(si.uv[0]), mi.Float(si.uv[1])
        if self.formula is not None:
            place = [mi.Float(si.p[axis]) for axis in range(3)] if self.formula.uses_place else ()
            value = mi.Float(self.formula(u, v, DRJIT_OPERATIONS, self.constants, place))
            value = dr.select(dr.isnan(value), self.low, value)
            return dr.minimum(dr.maximum(value, self.low), self.high)
        return dr.lerp(self.low, self.high, self._bilinear(u, v, active))

    def _bilinear(self, u: Any, v: Any, active: Any) -> Any:
        """Interpolate texel centres periodically, or return the nearest texel."""
        if self.is_stepped:
            column = _wrap(dr.floor(u * self.size[0]), self.size[0])
            row = _wrap(dr.floor((1.0 - v) * self.size[1]), self.size[1])
            return read(self.image, row * self.columns_o + column, active)
        x, y = u * self.size[0] - 0.5, (1.0 - v) * self.size[1] - 0.5
        x0, y0 = dr.floor(x), dr.floor(y)
        left, top = _wrap(x0, self.size[0]), _wrap(y0, self.size[1])
        right = dr.select(left + 1 == self.columns_o, mi.UInt32(0), left + 1)
        bottom = dr.select(top + 1 == self.rows_o, mi.UInt32(0), top + 1)
        at = lambda r, c: read(self.image, r * self.columns_o + c, active)
        upper = dr.lerp(at(top, left), at(top, right), x - x0)
        lower = dr.lerp(at(bottom, left), at(bottom, right), x - x0)
        return dr.lerp(upper, lower, y - y0)


def _wrap(index: Any, size: Any) -> Any:
    """Return an integer modulo `size` as UInt32; exact below 2^24, enough for every image."""
    rest = index - dr.floor(index / size) * size
    return mi.UInt32(dr.minimum(dr.maximum(rest, 0.0), size - 1.0))


class DeviceParameters:
    """The parameter axes of a table: nodes and weights at a surface point."""

    def __init__(self, parameters: tuple[ParameterAxis, ...]) -> None:
        self.names = tuple(axis.name for axis in parameters)
        self.sizes = tuple(len(axis.values) for axis in parameters)
        self.textures = [DeviceTexture(axis.texture) for axis in parameters]
        self._set_ranges(parameters)

    def _set_ranges(self, parameters: tuple[ParameterAxis, ...]) -> None:
        self.first = [opaque(float(axis.values[0])) for axis in parameters]
        spans = [float(axis.values[-1] - axis.values[0]) for axis in parameters]
        self.per_unit = [opaque((n - 1) / s if s > 0 else 0.0) for n, s in zip(self.sizes, spans, strict=True)]
        self.nodes = [UniformNodes(n) for n in self.sizes]
        self.sizes_o = [opaque_int(n) for n in self.sizes]

    def update(self, parameters: tuple[ParameterAxis, ...]) -> None:
        """Replace ranges and textures by others with the same structure.

        Raises:
            UnsupportedError: the number of axes differs, or an axis changed between single and multiple nodes.
        """
        sizes = tuple(len(axis.values) for axis in parameters)
        if [n > 1 for n in sizes] != [n > 1 for n in self.sizes]:
            raise UnsupportedError("the number of texture-driven parameters changed; build the scene again")
        self.sizes = sizes
        for device, axis in zip(self.textures, parameters, strict=True):
            device.update(axis.texture)
        self._set_ranges(parameters)

    def corners(self, si: Any, active: Any = True) -> list[tuple[Any, Any]] | None:
        """Return `(flat node index, weight)` for the 2^n nodes around a point, or None without parameters."""
        if not self.sizes:
            return None
        axes = []
        for i, texture in enumerate(self.textures):
            position = dr.clip((texture(si, active) - self.first[i]) * self.per_unit[i], 0.0, self.nodes[i].last)
            low, fraction = self.nodes[i].cell(position)
            high = low + (1 if self.sizes[i] > 1 else 0)
            axes.append(((low, 1.0 - fraction), (high, fraction)))
        corners = []
        for choice in itertools.product(*axes):
            index, weight = choice[0]
            for i, (node, part) in enumerate(choice[1:], start=1):
                index, weight = index * self.sizes_o[i] + node, weight * part
            corners.append((index, weight))
        return corners
