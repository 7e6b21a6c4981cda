"""The question that the search of films answers: what is seen, of what it may be made, what is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.matter.stack.thickness_gradient import StackTables, stack_tables
from nacre.optimise.merit import MeritFunction
from nacre.optimise.thin_film.genetic import Space

YIELD_DRAWS = 64  # in the search; common to all stacks, so that they differ by what they are
YIELD_SEED = 20
METAL_K = 0.7  # at the middle wavelength: such a layer is opaque after some 100 nm and is drawn thin
SEEN_NM = (384.0, 731.0)  # of the coarse grid: what lies beyond moves no colour by 0.05 dE00
COARSE_STEPS_NM = (15.0, 10.0, 5.0)
COARSE_LIMITS_NM = (1500.0, 4000.0)  # of the optical thickness to be expected, for the first two steps


@dataclass(frozen=True, eq=False)
class Medium:
    """A material: its name and its index `[wavelength]`, n + ik, on the wavelengths of the goals."""

    name: str
    n: ComplexArray


@dataclass(frozen=True)
class Slot:
    """A layer of a stack whose layers are given: the names that may stand there, and bounds of its thickness in nm.

    One name and equal bounds make it a layer that is not free.
    """

    materials: tuple[str, ...]
    low_nm: float
    high_nm: float


@dataclass(frozen=True, eq=False)
class StackProblem:
    """A film to be found.

    Attributes:
        merit: merit function; its rows are those of `angles_rad`.
        palette: materials of the layers.
        substrates: one or more media to choose from below the layers.
        angles_rad: `[row]`, in the ambient.
        sides: `[row]`, "reflected" or "transmitted" (into the substrate), unpolarised.
        ambient: index of the medium above, clear, a number or `[wavelength]`.
        max_layers: how many layers there may be (open stack).
        bounds_nm: name -> (low, high), of the palette (open stack).
        slots: the layers from the top, where they are given; then `most` and `bounds_nm` are not asked.
        max_total_nm: bound of the sum of thicknesses.
        prefer_few_layers: whether fewer layers win at equal merit.
        relative_tolerance, absolute_tolerance_nm: standard deviations of the thicknesses, as a share and in nm:
            one number or one per slot.

    Raises:
        NacreError: where these do not fit together.
    """

    merit: MeritFunction
    palette: tuple[Medium, ...]
    substrates: tuple[Medium, ...]
    angles_rad: tuple[float, ...] = (0.0,)
    sides: tuple[str, ...] = ("reflected",)
    ambient: complex | Array = 1.0
    max_layers: int = 6
    bounds_nm: dict[str, tuple[float, float]] | None = None
    slots: tuple[Slot, ...] | None = None
    max_total_nm: float = float("inf")
    prefer_few_layers: bool = False
    relative_tolerance: float | tuple[float, ...] = 0.0
    absolute_tolerance_nm: float | tuple[float, ...] = 0.0

    def __post_init__(self) -> None:
        if not self.substrates:
            raise NacreError("a film needs at least one substrate")
        if self.merit.rows > len(self.angles_rad):
            raise NacreError(f"a want looks at row {self.merit.rows - 1}; there are {len(self.angles_rad)} directions")
        names = [m.name for m in self.palette]
        samples = len(self.merit.wavelengths_nm)
        for medium in (*self.palette, *self.substrates):
            if np.shape(medium.n) != (samples,):
                raise NacreError(f'the index of "{medium.name}" needs {samples} values, one a wavelength')
        for name in names if self.slots is None else [n for s in self.slots for n in s.materials]:
            if name not in names:
                raise NacreError(f'"{name}" is not in the palette: {", ".join(names)}')
            low, high = self.bounds_of(name)
            if not 0.0 <= low <= high:
                raise NacreError(f'the bounds of "{name}" cross: {low:g} and {high:g} nm')
        if self.slots is None and (self.max_layers < 1 or not names):
            raise NacreError("an open stack needs a palette and most >= 1")
        for slot in self.slots or ():
            if not slot.materials or not 0.0 <= slot.low_nm <= slot.high_nm:
                raise NacreError(f"a layer needs a material and bounds that do not cross: {slot}")
        if sum(s.low_nm for s in self.slots or ()) > self.max_total_nm:
            raise NacreError(f"the least thicknesses sum to more than max_total_nm = {self.max_total_nm:g}")

    def bounds_of(self, name: str) -> tuple[float, float]:
        """Return the bounds of a material's layers in nm (of an open stack)."""
        if self.slots is not None:
            return 0.0, float("inf")
        if self.bounds_nm is None or name not in self.bounds_nm:
            raise NacreError(f'no bounds for the thickness of "{name}"')
        low, high = self.bounds_nm[name]
        return float(low), float(high)

    @property
    def layers(self) -> int:
        """How many layers there are at most."""
        return self.max_layers if self.slots is None else len(self.slots)

    @property
    def has_tolerance(self) -> bool:
        """Whether thicknesses vary in manufacture."""
        return bool(
            np.any(np.asarray(self.relative_tolerance) > 0.0) or np.any(np.asarray(self.absolute_tolerance_nm) > 0.0)
        )

    def media(self) -> tuple[Medium, ...]:
        """Return palette and substrates, in the order of the tables after the ambient."""
        return (*self.palette, *self.substrates)

    def tables(self, samples: Any = slice(None)) -> StackTables:
        """Return the tables of all media on some of the wavelengths."""
        n = np.empty((1 + len(self.media()), len(self.merit.wavelengths_nm)), dtype=complex)
        n[0] = self.ambient
        for row, medium in zip(n[1:], self.media()):
            row[:] = medium.n
        return stack_tables(
            n[:, samples], self.merit.wavelengths_nm[samples], np.asarray(self.angles_rad, dtype=float), self.sides
        )

    def space(self) -> Space:
        """Return what stacks may be made of, as arrays."""
        count, media = self.layers, 1 + len(self.media())
        number = {m.name: i + 1 for i, m in enumerate(self.palette)}
        wide = max([1, *(len(s.materials) for s in self.slots or ())], default=1) if self.slots else len(self.palette)
        choices = np.zeros((count, max(wide, 1)), dtype=np.int64)
        choice_count = np.zeros(count, dtype=np.int64)
        low, high = np.zeros((count, media)), np.zeros((count, media))
        for j in range(count):
            names = tuple(m.name for m in self.palette) if self.slots is None else self.slots[j].materials
            choices[j, : len(names)] = [number[name] for name in names]
            choice_count[j] = len(names)
            for name in names:
                ends = self.bounds_of(name) if self.slots is None else (self.slots[j].low_nm, self.slots[j].high_nm)
                low[j, number[name]], high[j, number[name]] = ends
        middle = len(self.merit.wavelengths_nm) // 2
        return Space(
            choices,
            choice_count,
            low,
            high,
            np.array([False, *(m.n[middle].imag > METAL_K for m in self.media())]),
            np.arange(1 + len(self.palette), media),
            np.array([self.slots is None]),
            np.array([min(self.max_total_nm, 1e9)]),
            np.array(np.broadcast_to(np.asarray(self.relative_tolerance, dtype=float), (count,))),
            np.array(np.broadcast_to(np.asarray(self.absolute_tolerance_nm, dtype=float), (count,))),
            np.random.default_rng(YIELD_SEED).normal(size=(YIELD_DRAWS if self.has_tolerance else 0, count)),
        )

    def sigma_nm(self, thicknesses_nm: Array) -> Array:
        """Return the standard deviations of layers `[layer]`, nm."""
        d = np.asarray(thicknesses_nm, dtype=float)
        relative, absolute = (
            np.asarray(self.relative_tolerance, dtype=float),
            np.asarray(self.absolute_tolerance_nm, dtype=float),
        )
        return np.asarray(np.hypot(np.broadcast_to(relative, d.shape) * d, np.broadcast_to(absolute, d.shape)))

    def coarse_samples(self) -> Any:
        """Return the numbers of the wavelengths on which the search begins: few, by the thickness to be expected."""
        grid = self.merit.wavelengths_nm
        space = self.space()
        dense = np.array([1.0, *(float(np.mean(m.n.real)) for m in self.media())])
        expected = 0.0
        for j in range(self.layers):
            names = space.choices[j, : space.choice_count[j]]
            expected += float(np.mean([0.4 * min(space.high[j, m], 1e5) * dense[m] for m in names if m]))
        step = next((s for s, limit in zip(COARSE_STEPS_NM, COARSE_LIMITS_NM) if expected < limit), COARSE_STEPS_NM[-1])
        has_colour = any(goal.kind != "spectrum" for goal in self.merit.operands)
        inside = (grid >= SEEN_NM[0]) & (grid <= SEEN_NM[1]) if has_colour else np.ones(len(grid), dtype=bool)
        numbers = np.flatnonzero(inside)
        stride = max(1, int(round(step / float(np.median(np.diff(grid))))))
        chosen = numbers[::stride]
        return chosen if len(chosen) >= 16 else np.arange(len(grid))
