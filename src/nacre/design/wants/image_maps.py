"""The maps of a picture's numbers as files: 16-bit grey PNG and TIFF, and the numbers themselves as NPY."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.exchange.calibration import LARGEST_GREY
from nacre.exchange.height_image import write_png16, write_tiff16
from nacre.exchange.number_maps import DEFAULT_PIXEL_UM
from nacre.files import atomic_path


@dataclass(frozen=True, eq=False)
class FoundMap:
    """One number over the picture.

    Attributes:
        path: of the number in the recipe.
        values: `[row, column]`, the first row on top, in the recipe's own unit.
        low, high: its bounds, which are the map's black and white.
        levels: of the process; None where any value can be made.
    """

    path: str
    values: Array
    low: float
    high: float
    levels: int | None

    @property
    def stem(self) -> str:
        """The files' name. Example: "layers[0].thickness_nm" is kept in "layers-0-thickness_nm.png"."""
        return re.sub(r"[^A-Za-z0-9_]+", "-", self.path).strip("-")

    @property
    def texture(self) -> dict[str, Any]:
        """What a recipe writes where the number stood."""
        return {"texture": f"{self.stem}.png", "min": self.low, "max": self.high, "interpolation": "nearest"}


def map_files(maps: Sequence[FoundMap]) -> list[str]:
    """Return the names of the files that `write_maps` writes."""
    return [f"{found.stem}{suffix}" for found in maps for suffix in (".png", ".tif", ".npy")]


def write_maps(folder: Path, maps: Sequence[FoundMap], provenance: dict[str, Any]) -> list[str]:
    """Write the maps; return the files' names.

    Raises:
        NacreError: one cannot be written.
    """
    for found in maps:
        unit = (found.values - found.low) / (found.high - found.low)
        grey = np.round(LARGEST_GREY * unit).astype(np.uint16)
        facts = {
            "path": found.path, "black": found.low, "white": found.high, "levels": found.levels, **provenance,
            "value": "black + (white - black) * grey / 65535; seen from the light's side, first row on top",
        }  # fmt: skip
        write_png16(folder / f"{found.stem}.png", grey, facts, DEFAULT_PIXEL_UM)
        write_tiff16(folder / f"{found.stem}.tif", grey, facts, DEFAULT_PIXEL_UM)
        with atomic_path(folder / f"{found.stem}.npy") as temporary, temporary.open("wb") as stream:
            np.save(stream, found.values, allow_pickle=False)
    return map_files(maps)


__all__ = ["FoundMap", "map_files", "write_maps"]
