"""The interface of the lobes' Mitsuba plugins, and their common tools.

A `LobePlugin` is plain Python, built after the Mitsuba variant is set. One Mitsuba BSDF (`lobe_sum.py`) holds one or
several plugins: a lobe sum then needs only one virtual call, and two-sidedness, component masks and mixing are
implemented once.

Roles: Mitsuba's `si.wi` points to the camera in radiance transport and to the light in importance transport. A
lobe returns the value for light along one and camera along the other direction; for asymmetric values (the factor
(n_o/n_i)^2 of refraction), `is_radiance(ctx)` distinguishes the roles.
"""

import abc
import logging
import math
from collections.abc import Callable
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe

LobeT = TypeVar("LobeT", bound=Lobe)
MakePlugin = Callable[[Lobe], "LobePlugin[Any]"]

PACKET_BYTES = 64  # alignment for Dr.Jit's packet gathers
logger = logging.getLogger("nacre")

# Directions with a smaller cosine count as edge-on and give zero; 1/cos stays finite in single precision.
MIN_COS = 1e-6


class Facet(NamedTuple):
    """A smooth piece of the surface that connects two directions.

    Attributes:
        normal: local unit normal.
        cos: cosine (>= 0) between `si.wi` and the normal.
        inside: whether `si.wi` is on the side of the denser medium.
        reflects: whether both directions are on one side.
    """

    normal: Any
    cos: Any
    inside: Any
    reflects: Any


class LobePlugin(abc.ABC, Generic[LobeT]):
    """One lobe as a plugin of the current Mitsuba variant.

    Subclasses set `components` in `__init__` and implement `sample` and `eval_pdf`. All device numbers are
    opaque: other materials with the same structure reuse the compiled kernel.

    Attributes:
        components: one Mitsuba flag word for each part, such as reflection and transmission.
        pdf_is_exact: whether the density is that of `sample`; an approximate one may weight strategies, but not divide
            values.
        holds_lobes: whether the lobe contains others; `__init__` then has the further argument `make_plugin`.
    """

    kind: ClassVar[str]
    components: tuple[int, ...]
    pdf_is_exact: bool = True
    holds_lobes: ClassVar[bool] = False

    @abc.abstractmethod
    def __init__(self, lobe: LobeT) -> None:
        """Copy a lobe's arrays to the device."""

    @abc.abstractmethod
    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(mi.BSDFSample3f, weight)` with weight = value * |cos| / pdf, or zero.

        Args:
            ctx: the transport mode.
            si: the interaction; `si.wi` local, on either side.
            sample1: uniform number to choose a component.
            sample2: uniform point to draw the direction.
            active: lane mask.
            enabled: whether each of `components` may be sampled.
        """

    @abc.abstractmethod
    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * |cos wo|, pdf)` of the non-delta part."""

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `value * |cos wo|`."""
        return self.eval_pdf(ctx, si, wo, active, enabled)[0]

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return the density."""
        return self.eval_pdf(ctx, si, wo, active, enabled)[1]

    def facet(self, si: Any, wo: Any, active: Any) -> Facet | None:
        """Return the smooth piece of surface whose Mueller matrix the value has; None: the lobe depolarises."""
        return None

    def eval_depolarised(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return the part of `eval` that is depolarised although the lobe has facets; None: nothing."""
        return None

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the approximate albedo, by which lobes in a sum share the samples."""
        return mi.Float(1.0)

    @abc.abstractmethod
    def update(self, lobe: LobeT) -> None:
        """Replace the data by another lobe's with the same kind and shape, without a new kernel.

        Raises:
            UnsupportedError: shape or structure differ.
        """

    def traverse(self, callback: Any, prefix: str) -> None:  # optional
        """Expose differentiable or editable numbers under `prefix`; they are edited in place."""

    def parameters_changed(self) -> None:
        """Update the data derived from the exposed numbers."""


def is_radiance(ctx: Any) -> bool:
    """Whether `si.wi` points to the camera."""
    return bool(ctx.mode == mi.TransportMode.Radiance)


def flag(*names: str) -> int:
    """Return the word of several `mi.BSDFFlags`, e.g. `flag("GlossyReflection", "FrontSide")`."""
    word = 0
    for name in names:
        word |= int(getattr(mi.BSDFFlags, name))
    return word


def negated(mask: Any) -> Any:
    """Return the negated mask; `~` would turn the bools of scalar variants into integers."""
    return mask ^ True


def larger(a: Any, b: Any) -> Any:
    """Return the larger number, `b` if `a` is NaN: one instruction, four for `dr.maximum`."""
    return dr.select(a > b, a, b)


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller number, `b` if `a` is NaN: one instruction, four for `dr.minimum`."""
    return dr.select(a < b, a, b)


def opaque(value: float) -> Any:
    """Return a Float as data rather than a literal: other values reuse the kernel."""
    number = mi.Float(float(value))
    return dr.opaque(mi.Float, float(value)) if dr.is_jit_v(mi.Float) else number


def opaque_int(value: int) -> Any:
    """Return a UInt32 as data rather than a literal."""
    return dr.opaque(mi.UInt32, int(value)) if dr.is_jit_v(mi.Float) else int(value)


class UniformNodes:
    """The nodes of a uniformly sampled axis; their number is data, so other numbers reuse the kernel.

    Attributes:
        last: coordinate of the last node.
    """

    def __init__(self, count: int) -> None:
        self.last, self.max_low = opaque(count - 1), opaque_int(max(count - 2, 0))

    def cell(self, coordinate: Any) -> tuple[Any, Any]:
        """Return the node below a coordinate in [0, last], and the fraction above it."""
        return cell_at(coordinate, self.max_low)


def cell_at(coordinate: Any, max_low: Any) -> tuple[Any, Any]:
    """Return the node below a coordinate, at most `max_low`, and the fraction above it."""
    low = dr.minimum(mi.UInt32(coordinate), max_low)
    return low, coordinate - mi.Float(low)


def replaced(old: Any, new: Any) -> Any:
    """Assign `new` to the object `old`, which `mi.traverse` may have exposed, and return it; without `old`, `new`."""
    if old is None or not dr.is_jit_v(mi.Float):
        return new
    mi.set_property(old, new)
    return old


def aligned(values: NDArray[Any], dtype: Any = np.float32) -> NDArray[Any]:
    """Return a flat copy aligned to `PACKET_BYTES`.

    On the CPU Dr.Jit reads numpy's memory directly and gathers packets only from aligned memory; for unaligned arrays
    it compiles another kernel with single gathers. Numpy's alignment is random, and so would be the kernels.
    """
    room = np.empty(values.size * np.dtype(dtype).itemsize + PACKET_BYTES, dtype=np.uint8)
    start = -room.ctypes.data % PACKET_BYTES
    copy = room[start : start + values.size * np.dtype(dtype).itemsize].view(dtype)
    copy[:] = np.asarray(values).ravel()
    return copy


def device_array(values: NDArray[Any]) -> Any:
    """Copy to a flat float32 array on the device (a numpy array in scalar variants)."""
    flat = aligned(values)
    return mi.Float(flat) if dr.is_jit_v(mi.Float) else flat


def read(source: Any, index: Any, active: Any = True) -> Any:
    """Gather one number."""
    if dr.is_jit_v(mi.Float):
        return dr.gather(mi.Float, source, index, active)
    return float(source[int(index)]) if active else 0.0


def read2(source: Any, index: Any, active: Any = True) -> Any:
    """Gather `source[2 index]` and `source[2 index + 1]` in one packet."""
    if dr.is_jit_v(mi.Float):
        return dr.gather(mi.Vector2f, source, index, active)
    return source[2 * int(index) : 2 * int(index) + 2].tolist() if active else [0.0] * 2


def read4(source: Any, index: Any, active: Any = True) -> Any:
    """Gather four numbers, starting at `source[4 index]`, in one packet."""
    if dr.is_jit_v(mi.Float):
        return dr.gather(mi.Vector4f, source, index, active)
    return source[4 * int(index) : 4 * int(index) + 4].tolist() if active else [0.0] * 4


def flip_z(v: Any) -> Any:
    """Return a direction's mirror image at the surface."""
    return mi.Vector3f(v.x, v.y, -v.z)


def with_wi(si: Any, wi: Any) -> Any:
    """Return a copy of an interaction with another local direction."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wi
    return other


def unit_azimuth(w: Any) -> tuple[Any, Any]:
    """Return cosine and sine of a direction's azimuth, arbitrary at the pole."""
    flat = w.x * w.x + w.y * w.y
    inverse = dr.rsqrt(larger(flat, 1e-20))
    return dr.select(flat > 1e-14, w.x * inverse, 1.0), dr.select(flat > 1e-14, w.y * inverse, 0.0)


def normal_number(uniform: Any) -> Any:
    """Return a standard normal number by inversion, cut at 4.9 standard deviations."""
    return math.sqrt(2.0) * dr.erfinv(dr.clip(2.0 * uniform - 1.0, -0.999999, 0.999999))


def glossy_sample(wo: Any, value: Any, pdf: Any, active: Any) -> tuple[Any, Any]:
    """Return `(mi.BSDFSample3f, weight)` for a glossy reflection with `value * |cos wo|` and a density."""
    bs = dr.zeros(mi.BSDFSample3f)
    bs.wo, bs.pdf, bs.eta = wo, pdf, mi.Float(1.0)
    bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
    return bs, (value / dr.maximum(pdf, 1e-20)) & (active & (pdf > 0.0))


def pick_line(number: Any) -> tuple[Any, Any]:
    """Choose one of the ray's wavelengths by a uniform number; return its position and a new uniform number."""
    lines = dr.size_v(mi.UnpolarizedSpectrum)
    line = dr.minimum(dr.floor(number * lines), lines - 1.0)
    return line, number * lines - line


def of_line(values: Any, line: Any) -> Any:
    """Return the value of a chosen wavelength."""
    value = values[0]
    for i in range(1, dr.size_v(mi.UnpolarizedSpectrum)):
        value = dr.select(line == i, values[i], value)
    return value


def set_transmission(bs: Any, reflects: Any, eta: Any) -> None:
    """Complete a sample that is a glossy reflection or a glossy transmission with relative index `eta`."""
    transmission = mi.UInt32(int(mi.BSDFFlags.GlossyTransmission))
    bs.eta = dr.select(reflects, mi.Float(1.0), eta)
    bs.sampled_component = dr.select(reflects, mi.UInt32(0), mi.UInt32(1))
    bs.sampled_type = dr.select(reflects, mi.UInt32(int(mi.BSDFFlags.GlossyReflection)), transmission)


def rotated_frame(rotation: Any, si: Any, active: Any, flipped: bool = False) -> Callable[[Any, bool], Any]:
    """Return the transformation to a rotated (and flipped) frame, or back: a function of direction and `forward`.

    Args:
        rotation: texture of the angle about the normal, or None.
        si, active: the interaction.
        flipped: negate z.
    """
    if rotation is None and not flipped:
        return lambda w, forward: w
    sin, cos = (mi.Float(0.0), mi.Float(1.0)) if rotation is None else dr.sincos(rotation(si, active))

    def turn(w: Any, forward: bool) -> Any:
        s = sin if forward else -sin
        return mi.Vector3f(cos * w.x + s * w.y, cos * w.y - s * w.x, -w.z if flipped else w.z)

    return turn
