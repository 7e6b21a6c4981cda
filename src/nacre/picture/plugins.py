"""Mitsuba and Dr.Jit, imported on first use; Mitsuba plugins in Python; the sampler for pictures.

The sampler has a low-discrepancy sequence per pixel that continues from pass to pass. Mitsuba's samplers are stratified
only within one `mi.render` call, and for a large picture a call takes one to four samples per pixel. Here each pixel
and dimension has Sobol's first two dimensions, shuffled and Owen-scrambled by
hashing (B. Burley, "Practical hash-based Owen scrambling", JCGT 9(4), 2020, and the permutation by S. Laine and T.
Karras, "Stratified sampling for stochastic transparency", 2011). The index counts on, therefore the picture does not
depend on the division into passes.
"""

import functools
import importlib
import types
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.device.variant import use_variant


class _LazyModule:
    def __init__(self, load: Callable[[], Any]) -> None:
        self._load = load

    def __getattr__(self, name: str) -> Any:
        return getattr(self._load(), name)


mi: Any = _LazyModule(use_variant)  # Mitsuba in the current variant
dr: Any = _LazyModule(lambda: importlib.import_module("drjit"))


class Plugin:
    """Methods for a Mitsuba plugin; `set_up` takes its arguments.

    Base classes differ between variants and accept no second base, therefore `make_plugin` copies the methods into a
    class for the variant.
    """

    BASE: ClassVar[str] = "SamplingIntegrator"
    is_scalar: bool

    def set_up(self, *arguments: Any, **options: Any) -> None:
        """Initialise the plugin."""


class WrappedIntegrator(Plugin):
    """An integrator that modifies an inner integrator's rays or result."""

    inner: Any

    def aov_names(self) -> list[str]:
        return list(self.inner.aov_names())


def make_plugin(methods: type[Plugin], *arguments: Any) -> Any:
    """Return an instance in the current variant."""
    made = _plugin_class(methods, mi.variant())  # type: ignore[arg-type]  # mypy takes classes for unhashable
    return made(mi.Properties(), *arguments)


@functools.cache
def _plugin_class(methods: type[Plugin], variant: str) -> type:
    base = getattr(mi, methods.BASE)

    def initialise(self: Any, properties: Any, *arguments: Any) -> None:
        base.__init__(self, properties)
        self.set_up(*arguments)

    names: dict[str, Any] = {}
    for each in reversed(methods.__mro__[:-1]):
        names |= {name: value for name, value in vars(each).items() if name not in ("__dict__", "__weakref__")}
    names |= {"is_scalar": variant.startswith("scalar"), "__init__": initialise}
    return types.new_class(methods.__name__, (base,), exec_body=lambda body: body.update(names))


LAINE_KARRAS = (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)
GOLDEN, OFFSET = 0x9E3779B1, 0x7F4A7C15
AVALANCHE = ((16, 0x85EBCA6B), (13, 0xC2B2AE35), (16, 1))  # shifts and factors in MurmurHash3's finaliser
PARTS = (0x55555555, 0x33333333, 0x0F0F0F0F, 0x00FF00FF, 0x0000FFFF)  # positions whose bit 0, 1, ... is 0
TILE = 16  # side in pixels of tiles that share a sequence


def continued_sampler() -> Any:
    """Return a sampler for picture sensors; `begin` prepares the next `mi.render` call."""
    if mi.variant().startswith("scalar"):  # a sampler in Python would be too slow there
        return mi.load_dict({"type": "multijitter"})
    return make_plugin(ContinuedSampler)


def begin(sampler: Any, seed: int, first: int, spp: int, total: int = 0, width: int = 0, alike: bool = False) -> int:
    """Begin a pass with a `continued_sampler`; return the seed for `mi.render`.

    Args:
        seed: sequence seed, 32 bits.
        first: samples per pixel taken before.
        spp: samples per pixel in this pass.
        total: samples per pixel in all, if known; neighbouring pixels then share a sequence.
        width: picture width, with `total`.
        alike: use equal numbers in all pixels, which turns grain into one small common error.
    """
    if not hasattr(sampler, "start"):
        return (seed + first * GOLDEN) & 0xFFFFFFFF
    sampler.start, sampler.key_seed, sampler.spp = first, seed & 0xFFFFFFFF, spp
    sampler.block, sampler.width = total, max(width, 1)  # a tile's samples are one Sobol run
    sampler.alike = alike
    return 0


class ContinuedSampler(Plugin):
    """A sampler whose sequences continue in the next `mi.render` call."""

    BASE = "Sampler"
    STATE = ("start", "key_seed", "spp", "block", "width", "first_pixel", "alike")

    def set_up(self) -> None:
        UInt32 = mi.UInt32
        self.start, self.key_seed, self.spp = 0, 0, 1
        self.block, self.width, self.first_pixel, self.alike = 0, 1, 0, False
        self.index, self.key, self.dimension = UInt32(0), UInt32(0), UInt32(0)
        self.own_key = UInt32(0)  # pixel key, also if `alike`

    def fork(self) -> Any:
        other = make_plugin(ContinuedSampler)
        for name in self.STATE:
            setattr(other, name, getattr(self, name))
        return other

    clone = fork

    def seed(self, seed: Any, wavefront_size: int = 0xFFFFFFFF) -> None:
        UInt32 = mi.UInt32
        mi.Sampler.seed(self, seed, wavefront_size)
        lane = dr.arange(UInt32, wavefront_size)
        pixel = lane // dr.opaque(UInt32, self.spp)
        self.index = dr.opaque(UInt32, self.start) + (lane - pixel * dr.opaque(UInt32, self.spp))
        pixel += dr.opaque(UInt32, self.first_pixel)  # tile position in the picture
        if self.alike:
            pixel = dr.zeros(UInt32, wavefront_size)
        elif self.block:
            # each pixel in a sampling tile, in Z order, has its share in the sequence
            row = pixel // dr.opaque(UInt32, self.width)
            column = pixel - row * dr.opaque(UInt32, self.width)
            self.index += dr.opaque(UInt32, self.block) * _z_order(column, row)
            tiles = dr.opaque(UInt32, (self.width + TILE - 1) // TILE)
            pixel = (row // TILE) * tiles + column // TILE
        self.key = _hashed(pixel, dr.opaque(UInt32, self.key_seed))
        self.own_key = _hashed(dr.opaque(UInt32, self.first_pixel) + lane // dr.opaque(UInt32, self.spp), self.key)
        self.dimension = dr.zeros(UInt32, wavefront_size)

    def schedule_state(self) -> None:
        dr.schedule(self.index, self.key, self.dimension, self.own_key)

    def advance(self) -> None:
        raise NotImplementedError("begin() and another call of mi.render take its place")

    def _next(self, of_pixel: bool = False) -> tuple[Any, Any]:
        """Return key and shuffled index for the next dimension."""
        key = _hashed(self.own_key if of_pixel else self.key, self.dimension)
        self.dimension = self.dimension + 1
        return key, _scrambled(dr.brev(self.index), key)

    def next_1d(self, active: Any = True, of_pixel: bool = False) -> Any:
        """Return a number in [0, 1); `of_pixel` makes it independent for each pixel even if `alike`."""
        key, index = self._next(of_pixel)
        return _unit(_scrambled(index, _hashed(key, mi.UInt32(1))))

    def next_2d(self, active: Any = True, of_pixel: bool = False) -> Any:
        """Return a point in the unit square; see `next_1d`."""
        return _point(*self._next(of_pixel))

    def several_2d(self, many: Any) -> Callable[[Any], Any]:
        """Return a function that maps an index below `many` to a point in the unit square.

        It takes one dimension, as `next_2d` does. The points for all samples in a pixel are consecutive in one Sobol
        sequence.
        """
        key = _hashed(_hashed(self.key, self.dimension), many)
        self.dimension = self.dimension + 1
        first = self.index * many
        return lambda number: _point(key, _scrambled(dr.brev(first + number), key))


def _hashed(a: Any, b: Any) -> Any:
    UInt32 = mi.UInt32
    h = a ^ (b * UInt32(GOLDEN) + UInt32(OFFSET))
    for shift, factor in AVALANCHE:
        h = (h ^ (h >> shift)) * UInt32(factor)
    return h


def _scrambled(digits: Any, seed: Any) -> Any:
    """Owen scrambling: a hash of the preceding digits flips each binary digit; digits come in reversed order."""
    x = digits + seed
    for factor in LAINE_KARRAS:
        x = x ^ (x * mi.UInt32(factor))
    return dr.brev(x)


def _second(index: Any) -> Any:
    """Sobol's second dimension, digits in reversed order: Pascal's triangle modulo 2.

    Its entry for bits b and j is odd if j is a subset of b; five sums over supersets give it.
    """
    for bit, mask in enumerate(PARTS):
        index = index ^ ((index >> (1 << bit)) & mi.UInt32(mask))
    return index


def _z_order(column: Any, row: Any) -> Any:
    """A pixel's place in its sampling tile along a Z curve."""
    place = mi.UInt32(0)
    for bit in range(TILE.bit_length() - 1):
        place |= (((column >> bit) & 1) << (2 * bit)) | (((row >> bit) & 1) << (2 * bit + 1))
    return place


def _unit(x: Any) -> Any:
    return mi.Float(x >> 8) * (1.0 / (1 << 24))


def _point(key: Any, index: Any) -> Any:
    x, y = (_scrambled(digits, _hashed(key, mi.UInt32(n))) for n, digits in ((1, index), (2, _second(index))))
    return mi.Point2f(_unit(x), _unit(y))


# Gaussian filters, and seamless noise for grounds, paper and sky.

Real = TypeVar("Real", np.float32, np.float64)

REACH = 3.0  # standard deviations
BLOCK = 32  # rows or columns per matrix product; larger blocks contain mostly zeros


def smooth(picture: NDArray[Real], sigma: float) -> NDArray[Real]:
    """Filter a picture by a Gaussian, `[row, column]` or `[row, column, colour]` in its own precision, edges extended.

    Small matrix products. scipy's filter gives the same numbers but takes 0.1 s to import, the total time for a
    small picture, and then up to twice as long.
    """
    if picture.ndim == 3:
        return np.stack([smooth(colour, sigma) for colour in np.moveaxis(picture, -1, 0)], axis=-1)
    weights = _weights(sigma).astype(picture.dtype, copy=False)
    reach = (weights.shape[1] - BLOCK) // 2
    padded = np.pad(picture, ((reach, reach), (0, 0)), mode="edge")
    along = np.empty_like(picture)
    for start in range(0, len(picture), BLOCK):
        rows = slice(start, min(start + BLOCK, len(picture)))
        strip = padded[start : rows.stop + 2 * reach]
        np.matmul(weights[: rows.stop - start, : len(strip)], strip, out=along[rows])
    padded = np.pad(along, ((0, 0), (reach, reach)), mode="edge")
    for start in range(0, picture.shape[1], BLOCK):
        columns = slice(start, min(start + BLOCK, picture.shape[1]))
        strip = padded[:, start : columns.stop + 2 * reach]
        np.matmul(strip, weights[: columns.stop - start, : strip.shape[1]].T, out=along[:, columns])
    return along


@functools.lru_cache(maxsize=32)
def _weights(sigma: float) -> NDArray[np.float64]:
    """Weights `[block, block + twice the reach]` for one block."""
    reach = int(REACH * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    spread = np.zeros((BLOCK, BLOCK + 2 * reach))
    for row in range(BLOCK):
        spread[row, row : row + len(weights)] = weights / weights.sum()
    return spread


def noise(shape: tuple[int, int], grain: Sequence[float], seed: int) -> Array:
    """Smooth periodic noise `[row, column]` with mean 0 and variance 1.

    Args:
        shape: rows and columns.
        grain: standard deviation in pixels, along rows and columns.
        seed: random seed.
    """
    white = np.random.default_rng(seed).standard_normal(shape)
    frequency = [np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]]
    response = np.exp(-2 * np.pi**2 * sum((f * g) ** 2 for f, g in zip(frequency, grain, strict=True)))
    filtered = np.fft.irfft2(np.fft.rfft2(white) * response, s=shape)
    filtered -= filtered.mean()
    return np.asarray(filtered / filtered.std())
