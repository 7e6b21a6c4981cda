"""Files of a fit: several measurements of one sample, of ellipsometers, spectrometers and goniometers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.contract import Model
from nacre.material.material import Material


class Data(Protocol):
    """One measurement that a material can simulate."""

    @property
    def kind(self) -> str:
        """`spectrum`, `gonio`, `ellipsometry` or `joint`."""
        ...

    @property
    def values(self) -> Array:
        """Measured values."""
        ...

    @property
    def wavelengths_nm(self) -> Array:
        """Wavelengths."""
        ...

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return simulated values, shaped as `values`."""
        ...

    def surrogate(self, model: Model) -> Array | None:
        """Return values of a random walk's noise-free surrogate; None without one."""
        ...

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values, with their rms as its rms."""
        ...


@dataclass(frozen=True, eq=False)
class Joint:
    """Several measurements of one sample; its values are the flat values of the parts, one after another."""

    parts: tuple[Data, ...]
    kind: str = "joint"

    @property
    def values(self) -> Array:
        """`[value]`."""
        return np.concatenate([part.values.ravel() for part in self.parts])

    @property
    def wavelengths_nm(self) -> Array:
        """Wavelengths of all parts."""
        return np.unique(np.concatenate([part.wavelengths_nm for part in self.parts]))

    @property
    def places(self) -> list[slice]:
        """Where each part stands in the values."""
        ends = np.cumsum([0, *(part.values.size for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:])]

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return simulated values `[value]`."""
        return np.concatenate([part.model(material, samples, seed).ravel() for part in self.parts])

    def surrogate(self, model: Model) -> Array | None:
        """Return values of a random walk's noise-free surrogate; None without one."""
        found = [part.surrogate(model) for part in self.parts]
        return (
            None
            if any(each is None for each in found)
            else np.concatenate([np.ravel(each) for each in found if each is not None])
        )

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values: each part relative to its own rms."""
        return np.concatenate([part.noise_scale(weights).ravel() for part in self.parts])


def parts_of(data: Data) -> tuple[Data, ...]:
    """Return the measurements of one or several files."""
    return data.parts if isinstance(data, Joint) else (data,)


def joined(parts: Sequence[Data]) -> Data:
    """Return one measurement as it is, several as a `Joint`.

    Raises:
        NacreError: no measurement.
    """
    if not parts:
        raise NacreError("give at least one measurement")
    return parts[0] if len(parts) == 1 else Joint(tuple(parts))


def checked_range(text: str | None) -> tuple[float, float] | None:
    """Return the wavelengths LOW:HIGH in nm.

    Raises:
        NacreError: it is not two ascending numbers.
    """
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = 1.0, 0.0
    if not 0 < low < high:
        raise NacreError(f'--range-nm "{text}" cannot be read; write it like 400:800')
    return low, high


def name_of(data: Data, path: str | Path) -> str:
    """Return a measurement's file name for tables."""
    return Path(getattr(data, "name", "") or path).name
