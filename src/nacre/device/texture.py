"""Textures on the device: formula trees and images from `nacre.bsdf.texture`, and the object's own space."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.texture import Formula, ParameterAxis, Texture, smooth_noise
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import UniformNodes, device_array, opaque, opaque_int, read


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
        whole = int(abs(exponent))
        result = mi.Float(1.0)
        for _ in range(whole):
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
        found = []
        for choice in itertools.product(*axes):
            index, weight = choice[0]
            for i, (node, part) in enumerate(choice[1:], start=1):
                index, weight = index * self.sizes_o[i] + node, weight * part
            found.append((index, weight))
        return found
