"""Thin-film design problem: merit function, materials and bounds of a stack."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.matter.stack.thickness_gradient import StackTables, stack_tables
from nacre.optimise.merit import MeritFunction
from nacre.optimise.thin_film.genetic import Space

YIELD_DRAWS = 64  # of the search; common random numbers for all stacks
YIELD_SEED = 20
METAL_K = 0.7  # at the middle wavelength; opaque after about 100 nm, hence drawn thin
COARSE_NM = (384.0, 731.0)  # wavelengths beyond change colours by less than dE00 0.05
COARSE_STEPS_NM = (15.0, 10.0, 5.0)
COARSE_LIMITS_NM = (1500.0, 4000.0)  # expected optical thickness up to which the first two steps suffice


@dataclass(frozen=True, eq=False)
class Medium:
    """A material: name, and index n + ik `[wavelength]` on the grid of the merit function."""

    name: str
    n: ComplexArray


@dataclass(frozen=True)
class Slot:
    """A layer of a given stack: alternative materials and thickness bounds in nm.

    A single material and equal bounds fix the layer.
    """

    materials: tuple[str, ...]
    low_nm: float
    high_nm: float


@dataclass(frozen=True, eq=False)
class StackProblem:
    """A stack to be designed.

    Attributes:
        merit: merit function; its rows are `angles_rad`.
        palette: layer materials.
        substrates: alternatives below the layers.
        angles_rad: `[row]`, in the ambient.
        sides: `[row]`, "reflected" or "transmitted" (into the substrate), unpolarised.
        ambient: real index above, a number or `[wavelength]`.
        max_layers: largest layer count (open stack).
        bounds_nm: name -> (low, high), of the palette (open stack).
        slots: a given stack's layers from the top, which replace `max_layers` and `bounds_nm`.
        max_total_nm: largest total thickness.
        prefer_few_layers: whether fewer layers win at equal merit.
        relative_tolerance, absolute_tolerance_nm: thickness standard deviations, as a share and in nm:
            one number or one per slot.

    Raises:
        NacreError: contradictory values.
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
            raise NacreError(f"a target needs row {self.merit.rows - 1}; there are {len(self.angles_rad)} directions")
        names = [m.name for m in self.palette]
        samples = len(self.merit.wavelengths_nm)
        for medium in (*self.palette, *self.substrates):
            if np.shape(medium.n) != (samples,):
                raise NacreError(f'the index of "{medium.name}" needs {samples} values, one per wavelength')
        for name in names if self.slots is None else [n for s in self.slots for n in s.materials]:
            if name not in names:
                raise NacreError(f'"{name}" is not in the palette: {", ".join(names)}')
            low, high = self.bounds_of(name)
            if not 0.0 <= low <= high:
                raise NacreError(f'the bounds of "{name}" cross: {low:g} and {high:g} nm')
        if self.slots is None and (self.max_layers < 1 or not names):
            raise NacreError("an open stack needs a palette and max_layers >= 1")
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
        """Largest layer count."""
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
        """Return the tables of all media on selected wavelengths."""
        n = np.empty((1 + len(self.media()), len(self.merit.wavelengths_nm)), dtype=complex)
        n[0] = self.ambient
        for row, medium in zip(n[1:], self.media()):
            row[:] = medium.n
        return stack_tables(
            n[:, samples], self.merit.wavelengths_nm[samples], np.asarray(self.angles_rad, dtype=float), self.sides
        )

    def space(self) -> Space:
        """Return the allowed stacks as arrays."""
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

    def coarse_samples(self) -> Any:
        """Return indices of the coarse wavelengths, as few as the expected thickness allows."""
        grid = self.merit.wavelengths_nm
        space = self.space()
        dense = np.array([1.0, *(float(np.mean(m.n.real)) for m in self.media())])
        expected = 0.0
        for j in range(self.layers):
            names = space.choices[j, : space.choice_count[j]]
            expected += float(np.mean([0.4 * min(space.high[j, m], 1e5) * dense[m] for m in names if m]))
        step = next((s for s, limit in zip(COARSE_STEPS_NM, COARSE_LIMITS_NM) if expected < limit), COARSE_STEPS_NM[-1])
        has_colour = any(goal.kind != "spectrum" for goal in self.merit.operands)
        inside = (grid >= COARSE_NM[0]) & (grid <= COARSE_NM[1]) if has_colour else np.ones(len(grid), dtype=bool)
        numbers = np.flatnonzero(inside)
        stride = max(1, int(round(step / float(np.median(np.diff(grid))))))
        chosen = numbers[::stride]
        return chosen if len(chosen) >= 16 else np.arange(len(grid))
