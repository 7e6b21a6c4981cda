"""The interface of every lobe's Mitsuba plugin, and small tools that all of them use.

A `LobePlugin` is plain Python without ties to a Mitsuba variant: it is built after the variant is set, and one
Mitsuba BSDF (`bsdf.py`) holds one or several of them. So a sum of lobes costs no nested virtual call, and
two-sidedness, component masks and mixing are written once.

Roles. Mitsuba's `si.wi` points to the camera when radiance is traced and to the light when importance is traced. A
lobe returns the value for light along one and camera along the other; where that is not symmetric (the factor
(n_o/n_i)^2 of a refraction), `is_radiance(ctx)` tells which is which.
"""

from __future__ import annotations

import abc
import logging
from collections.abc import Callable
from typing import Any, ClassVar, Generic, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobe import Lobe

LobeT = TypeVar("LobeT", bound=Lobe)
MakePlugin = Callable[[Lobe], "LobePlugin[Any]"]

PACKET_BYTES = 64  # a place in memory from which Dr.Jit gathers packets
logger = logging.getLogger("nacre")

# A cosine below this is seen edge-on and gives nothing; it also keeps 1/cos finite in single precision.
MIN_COS = 1e-6


class LobePlugin(abc.ABC, Generic[LobeT]):
    """One lobe as a plugin of the current Mitsuba variant.

    Subclasses set `components` in `__init__` and implement `sample` and `eval_pdf`. All device numbers are
    opaque, so that another material of the same kind runs in the kernel that is compiled already.

    Attributes:
        components: one Mitsuba flag word for each part, such as a reflection and a transmission.
        pdf_is_exact: whether the density is that of `sample`; else it may weigh strategies, but not divide values.
        holds_lobes: whether the lobe holds others; `__init__` then takes `make_plugin` too, which puts them there.
    """

    kind: ClassVar[str]
    components: tuple[int, ...]
    pdf_is_exact: bool = True
    holds_lobes: ClassVar[bool] = False

    @abc.abstractmethod
    def __init__(self, lobe: LobeT) -> None:
        """Move the arrays of a lobe to the device."""

    @abc.abstractmethod
    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(mi.BSDFSample3f, weight)`, weight = value * |cos| / pdf; zero where nothing is scattered.

        Args:
            ctx: the transport mode.
            si: the interaction; `si.wi` local, on either side.
            sample1: uniform number for the choice among components.
            sample2: uniform point for the direction.
            active: mask of the lanes.
            enabled: for each of `components`, whether it may be sampled.
        """

    @abc.abstractmethod
    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * |cos wo|, pdf)` of the non-delta part, both zero where nothing is scattered."""

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `value * |cos wo|` alone."""
        return self.eval_pdf(ctx, si, wo, active, enabled)[0]

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return the density alone."""
        return self.eval_pdf(ctx, si, wo, active, enabled)[1]

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return how much light this lobe scatters, roughly: the share of samples it gets within a sum."""
        return mi.Float(1.0)

    @abc.abstractmethod
    def update(self, lobe: LobeT) -> None:
        """Take over the numbers of another lobe of the same kind and shape, without a new kernel.

        Raises:
            UnsupportedError: shape or structure differ.
        """

    def traverse(self, callback: Any, prefix: str) -> None:  # a lobe may have nothing to expose
        """Expose differentiable or editable numbers under `prefix`; they are edited in place."""

    def parameters_changed(self) -> None:
        """Derive again what depends on the exposed numbers."""


def is_radiance(ctx: Any) -> bool:
    """Whether `si.wi` points to the camera."""
    return bool(ctx.mode == mi.TransportMode.Radiance)


def flag(*names: str) -> int:
    """Join names of `mi.BSDFFlags` into one word, e.g. `flag("GlossyReflection", "FrontSide")`."""
    word = 0
    for name in names:
        word |= int(getattr(mi.BSDFFlags, name))
    return word


def negated(mask: Any) -> Any:
    """Return the opposite of a mask; `~` would make a number of a plain bool in scalar variants."""
    return mask ^ True


def larger(a: Any, b: Any) -> Any:
    """Return the larger number, the second where the first is NaN: one instruction, where `dr.maximum` takes four."""
    return dr.select(a > b, a, b)


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller number, the second where the first is NaN: one instruction, where `dr.minimum` takes four."""
    return dr.select(a < b, a, b)


def opaque(value: float) -> Any:
    """Return a Float that is data, not a literal: another value needs no new kernel."""
    number = mi.Float(float(value))
    return dr.opaque(mi.Float, float(value)) if dr.is_jit_v(mi.Float) else number


def opaque_int(value: int) -> Any:
    """Return a UInt32 that is data, not a literal."""
    return dr.opaque(mi.UInt32, int(value)) if dr.is_jit_v(mi.Float) else int(value)


def replaced(old: Any, new: Any) -> Any:
    """Put `new` into the object `old`, which `mi.traverse` may have handed out, and return it; None: just `new`."""
    if old is None or not dr.is_jit_v(mi.Float):
        return new
    mi.set_property(old, new)
    return old


def aligned(values: NDArray[Any], dtype: Any = np.float32) -> NDArray[Any]:
    """Return a flat copy that begins at a multiple of `PACKET_BYTES`.

    On the CPU Dr.Jit reads numpy's own memory, and gathers packets only from where that begins so; else it compiles
    another kernel, which gathers one by one. Numpy begins where it happens to: kernels would differ by chance.
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
    """Gather the two neighbours `source[2 index]`, `source[2 index + 1]` in one packet."""
    if dr.is_jit_v(mi.Float):
        return dr.gather(mi.Vector2f, source, index, active)
    return source[2 * int(index) : 2 * int(index) + 2].tolist() if active else [0.0] * 2


def read4(source: Any, index: Any, active: Any = True) -> Any:
    """Gather the four numbers from `source[4 index]` on in one packet."""
    if dr.is_jit_v(mi.Float):
        return dr.gather(mi.Vector4f, source, index, active)
    return source[4 * int(index) : 4 * int(index) + 4].tolist() if active else [0.0] * 4


def flip_z(v: Any) -> Any:
    """Mirror a direction at the surface."""
    return mi.Vector3f(v.x, v.y, -v.z)


def with_wi(si: Any, wi: Any) -> Any:
    """Return a copy of an interaction with another local direction."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wi
    return other
