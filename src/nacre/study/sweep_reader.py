"""Read a sweep's Zarr store back: its axes, its colours, and which points are there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.errors import NacreError, did_you_mean

DONE = 1  # as nacre.study.sweep writes it
MAX_POINTS_READ = 2_000_000


@dataclass(frozen=True)
class SweepAxis:
    """One varied number of a stored sweep.

    Attributes:
        path: the recipe path.
        values: grid: `[value]`; random and Sobol: `[point]`. Words are counted 0, 1, 2.
        words: the words that the counts stand for, empty for numbers.
    """

    path: str
    values: Array
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class SweepColours:
    """The colours of a stored sweep.

    Attributes:
        axes: the varied numbers.
        is_grid: whether the points form a grid of the axes' values.
        part: which part of the spectrum the colours are of.
        parts: all parts that the store holds.
        angles_deg: `[angle]`, incidence.
        xyz, lab: `[axis 0, axis 1, ..., angle, 3]` of a grid, `[point, angle, 3]` otherwise; NaN where missing.
        illuminant, observer: of the colours.
        recipe: the recipe's text; source: the sweep's file name.
    """

    axes: tuple[SweepAxis, ...]
    is_grid: bool
    part: str
    parts: tuple[str, ...]
    angles_deg: Array
    xyz: Array
    lab: Array
    illuminant: str
    observer: str
    recipe: str
    source: str

    def parameters(self) -> Array:
        """Return the varied numbers of every point, `[point, axis]`, in the order of the flattened colours."""
        if not self.is_grid:
            return np.stack([axis.values for axis in self.axes], axis=-1)
        mesh = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        return np.stack([m.ravel() for m in mesh], axis=-1)


def read_sweep(path: str | Path, part: str | None = None) -> SweepColours:
    """Read the colours of a sweep's store, finished or not.

    Args:
        path: the Zarr folder that `nacre sweep` wrote.
        part: such as "diffuse_reflectance"; default: the brightest of those stored.

    Raises:
        NacreError: no such store, not a sweep's, no such part, or no finished point.
    """
    path = Path(path)
    if not (path / "zarr.json").is_file():
        raise NacreError(f"{path}: is not a sweep's store; nacre sweep SWEEP.toml writes one")
    try:
        import zarr
    except ImportError:
        raise NacreError("reading a sweep needs zarr: pip install 'nacre[study]'") from None
    try:
        group: Any = zarr.open_group(str(path), mode="r")
        attributes = dict(group.attrs)
        paths: dict[str, str] = dict(attributes["axes"])
        parts = tuple(name.removeprefix("lab_") for name in sorted(group.array_keys()) if name.startswith("lab_"))
        if math.prod(group["status"].shape) > MAX_POINTS_READ:
            raise NacreError(f"{path}: has more than {MAX_POINTS_READ} points; draw a smaller sweep")
        status = np.asarray(group["status"][...])
        axes = tuple(_axis(group, name, recipe_path) for name, recipe_path in paths.items())
        angles = np.asarray(group["angle_deg"][...], dtype=float)
        if part is not None and part not in parts:
            hint = did_you_mean(part, parts)
            raise NacreError(f'{path}: holds no part "{part}".{hint} It holds {", ".join(parts)}')
        colours = {name: np.asarray(group[f"xyz_{name}"][...]) for name in ([part] if part else parts)}
        is_done = status == DONE
        if not is_done.any():
            raise NacreError(f"{path}: has no finished point to draw; run nacre sweep first")
        chosen = part or max(colours, key=lambda name: float(np.nanmax(colours[name][is_done][..., 1])))
        lab = np.asarray(group[f"lab_{chosen}"][...])
        is_grid = attributes["mode"] == "grid"
        shape = tuple(len(axis.values) for axis in axes) if is_grid else (len(axes[0].values),)
        if lab.shape != (*shape, len(angles), 3) or colours[chosen].shape != lab.shape or status.shape != shape:
            raise ValueError("shapes disagree")
        return SweepColours(
            axes, is_grid, chosen, parts, angles, np.where(is_done[..., None, None], colours[chosen], np.nan),
            np.where(is_done[..., None, None], lab, np.nan), str(attributes["illuminant"]),
            str(attributes["observer"]), str(attributes["recipe"]), str(attributes["sweep"]),
        )  # fmt: skip
    except NacreError:
        raise
    except Exception as error:  # a store that was edited or cut can fail anywhere inside zarr
        raise NacreError(f"{path}: cannot be read as a sweep ({type(error).__name__}: {str(error)[:80]!r})") from None


def _axis(group: Any, name: str, recipe_path: str) -> SweepAxis:
    array = group[name]
    words = tuple(str(word) for word in array.attrs.get("labels", ()))
    return SweepAxis(recipe_path, np.asarray(array[...], dtype=float), words)
