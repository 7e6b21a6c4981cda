"""Fabrication data of a material: layer tables, particle layouts, height maps.

Families provide these objects; `nacre.formats.fabrication` writes them to the usual file formats.

View from the light's side: x to the right, y up, heights towards the light.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array


@dataclass(frozen=True)
class DrawingRequest:
    """Options of a drawing.

    Attributes:
        size_mm: area (x, y) to cover; default: one period.
        seed: random seed; default: the recipe's.
    """

    size_mm: tuple[float, float] | None = None
    seed: int | None = None


@dataclass(frozen=True)
class LayerSheet:
    """A table from the light's side inward.

    Attributes:
        columns: column names.
        rows: values by column; missing values stay empty.
        remarks: lines above the table, below the line with the sheet's origin.
        title: title in that first line.
        stem: default file stem.
    """

    columns: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    remarks: tuple[str, ...] = ()
    title: str = "layer sheet"
    stem: str = "sheet"


@dataclass(frozen=True)
class Layout:
    """One period of a periodic layout of circles.

    Attributes:
        xy_um: `[particle, 2]`, centres in one period.
        radius_um: circle radius.
        period_um: side length of the square period.
        periods: period count along x and y.
        facts: further data for the file beside it.
        stem: default file stem.
        radii_um: circle radius for each species of a mixture.
        species: `[particle]`, index into `radii_um`; default: `radius_um` for all.
    """

    xy_um: Array
    radius_um: float
    period_um: float
    periods: tuple[int, int] = (1, 1)
    facts: Mapping[str, Any] = field(default_factory=dict)
    stem: str = "pattern"
    radii_um: tuple[float, ...] = ()
    species: NDArray[np.intp] | None = None

    @property
    def is_mixed(self) -> bool:
        """Whether there are several species."""
        return len(self.radii_um) > 1 and self.species is not None


@dataclass(frozen=True)
class HeightMap:
    """One period of square features of constant height.

    Attributes:
        heights_um: `[x, y]` above the lowest feature.
        feature_um: side length of a feature.
        stem: default file stem.
    """

    heights_um: Array
    feature_um: float
    stem: str = "relief"


@dataclass(frozen=True)
class CellField:
    """A rectangular cell of polygons that fills a field.

    Attributes:
        polygons: layer, and corners `[corner, 2]` in nm about the cell's centre.
        pitch_nm: sides of the cell along x and y.
        facts: further data for the file beside it.
        stem: default file stem.
    """

    polygons: tuple[tuple[int, Array], ...]
    pitch_nm: tuple[float, float]
    facts: Mapping[str, Any] = field(default_factory=dict)
    stem: str = "grating"


Drawing = LayerSheet | Layout | HeightMap | CellField
Drawer = Callable[[DrawingRequest], Drawing]
