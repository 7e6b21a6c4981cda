"""The data for fabricating a material: layers, particles in the plane, heights.

A family says which of these it can give; `nacre.formats.fabrication` writes them in the usual file formats and knows
no family.

Seen from the light's side: x to the right, y up, heights towards the light.
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
        size_mm: area (x, y) to cover, or None: one period.
        seed: of what is drawn at random, or None: the recipe's.
    """

    size_mm: tuple[float, float] | None = None
    seed: int | None = None


@dataclass(frozen=True)
class LayerSheet:
    """A table from the light's side inward.

    Attributes:
        columns: their names.
        rows: values by column; a missing one stays empty.
        remarks: lines above the table, after that of the sheet's origin.
        title: what the table is, in that first line.
        stem: of the file, where none is named.
    """

    columns: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    remarks: tuple[str, ...] = ()
    title: str = "layer sheet"
    stem: str = "sheet"


@dataclass(frozen=True)
class Layout:
    """One period of round outlines in the plane, repeated.

    Attributes:
        xy_um: `[particle, 2]` of one period.
        radius_um: of the outline.
        period_um: side of the square period.
        periods: how many along x and y.
        facts: what else is known of it, for the file beside it.
        stem: of the file, where none is named.
        radii_um: of the outlines of each kind, where there are several.
        kinds: `[particle]`, which of these it is; None: all are of `radius_um`.
    """

    xy_um: Array
    radius_um: float
    period_um: float
    periods: tuple[int, int] = (1, 1)
    facts: Mapping[str, Any] = field(default_factory=dict)
    stem: str = "pattern"
    radii_um: tuple[float, ...] = ()
    kinds: NDArray[np.intp] | None = None

    @property
    def is_mixed(self) -> bool:
        """Whether there are several kinds."""
        return len(self.radii_um) > 1 and self.kinds is not None


@dataclass(frozen=True)
class HeightMap:
    """One period of square features of constant height.

    Attributes:
        heights_um: `[x, y]` above the lowest feature.
        feature_um: a feature's side.
        stem: of the file, where none is named.
    """

    heights_um: Array
    feature_um: float
    stem: str = "relief"


Drawing = LayerSheet | Layout | HeightMap
Drawer = Callable[[DrawingRequest], Drawing]
