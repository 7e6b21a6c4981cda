"""Read a sweep's Zarr store and draw figures of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.analysis.sweep_plan import AT_GEOMETRIES
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean

if TYPE_CHECKING:
    from nacre.plot import Figure


DONE = 1  # see nacre.analysis.sweep
MAX_POINTS_READ = 2_000_000


@dataclass(frozen=True)
class SweepAxis:
    """One varied number of a stored sweep.

    Attributes:
        path: the recipe path.
        values: grid: `[value]`; random and Sobol: `[point]`. Words have the values 0, 1, 2.
        words: the words in this order, empty for numbers.
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
        part: the part of the spectrum of these colours.
        parts: all parts in the store.
        angles_deg: `[angle]`, incidence.
        xyz, lab: `[axis 0, axis 1, ..., angle, 3]` of a grid, `[point, angle, 3]` otherwise; NaN for missing points.
        illuminant, observer: of the colours.
        recipe: the recipe's text; source: the sweep's file name.
        labels: geometry names rather than angles, which then are their numbers.
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
    labels: tuple[str, ...] = ()

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
        part: such as "diffuse_reflectance"; default: the brightest stored part.

    Raises:
        NacreError: the store or part does not exist, it is not a sweep, or it lacks a finished point.
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
        if part is not None and part not in parts:
            hint = did_you_mean(part, parts)
            raise NacreError(f'{path}: holds no part "{part}".{hint} It holds {", ".join(parts)}')
        colours = {name: np.asarray(group[f"xyz_{name}"][...]) for name in ([part] if part else parts)}
        is_done = status == DONE
        if not is_done.any():
            raise NacreError(f"{path}: has no finished point to draw; run nacre sweep first")
        measured = [name for name in colours if name != AT_GEOMETRIES] or list(colours)
        chosen = part or max(measured, key=lambda name: float(np.nanmax(colours[name][is_done][..., 1])))
        lab = np.asarray(group[f"lab_{chosen}"][...])
        labels = tuple(_axis(group, "geometry", "").words) if chosen == AT_GEOMETRIES else ()
        angles = np.arange(float(len(labels))) if labels else np.asarray(group["angle_deg"][...], dtype=float)
        is_grid = attributes["mode"] == "grid"
        shape = tuple(len(axis.values) for axis in axes) if is_grid else (len(axes[0].values),)
        if lab.shape != (*shape, len(angles), 3) or colours[chosen].shape != lab.shape or status.shape != shape:
            raise ValueError("shapes disagree")
        return SweepColours(
            axes, is_grid, chosen, parts, angles, np.where(is_done[..., None, None], colours[chosen], np.nan),
            np.where(is_done[..., None, None], lab, np.nan), str(attributes["illuminant"]),
            str(attributes["observer"]), str(attributes["recipe"]), str(attributes["sweep"]), labels,
        )  # fmt: skip
    except NacreError:
        raise
    except Exception as error:  # a damaged store can raise any error inside zarr
        raise NacreError(f"{path}: cannot be read as a sweep ({type(error).__name__}: {str(error)[:80]!r})") from None


def _axis(group: Any, name: str, recipe_path: str) -> SweepAxis:
    array = group[name]
    words = tuple(str(word) for word in array.attrs.get("labels", ()))
    return SweepAxis(recipe_path, np.asarray(array[...], dtype=float), words)


SWEEP_KINDS = ("gamut", "colour-map", "parallel")
MAX_MAPS = 4


def save_sweep_figure(
    store: str | Path, kind: str, path: str | Path, angles_deg: Array | None = None, part: str | None = None
) -> None:
    """Draw a stored sweep and write the figure.

    Args:
        store: the Zarr folder of `nacre sweep`, finished or not.
        kind: one of `SWEEP_KINDS`.
        path: a PNG, PDF or SVG.
        angles_deg: stored angles; default: the first, or up to four of them.
        part: of the spectrum; default: the brightest stored.

    Raises:
        NacreError: not a sweep, an angle that is not stored, or an unsuitable kind.
    """
    from nacre.plot import save_figure

    colours = read_sweep(store, part)
    provenance = {"sweep": colours.source, "recipe": colours.recipe, "illuminant": colours.illuminant}
    save_figure(sweep_figure(colours, kind, angles_deg), path, provenance)


def sweep_figure(colours: SweepColours, kind: str, angles_deg: Array | None = None) -> Figure:
    """Draw one kind of figure; see `save_sweep_figure`."""
    from nacre.plot import sweeps

    chosen = _angles(colours, kind, angles_deg)
    labels = [colours.labels[i] if colours.labels else f"{colours.angles_deg[i]:g}\u00b0" for i in chosen]
    light = (colours.illuminant, colours.observer)
    title = colours.part.replace("_", " ").capitalize()
    flat = colours.xyz.reshape(-1, len(colours.angles_deg), 3)
    if kind == "gamut":
        return sweeps.gamut_figure(np.moveaxis(flat[:, chosen], 1, 0), *light, title=title, labels=labels)
    if kind == "parallel":
        parameters = colours.parameters()
        axes = [sweeps.AxisValues(_short(a.path), parameters[:, i], a.words) for i, a in enumerate(colours.axes)]
        return sweeps.parallel_figure(axes, flat[:, chosen[0]], *light, title=f"{title}, {labels[0]}")
    if kind == "colour-map":
        return _map(colours, chosen, labels, title, sweeps)
    raise NacreError(f'a sweep has no figure of kind "{kind}"; kinds: {", ".join(SWEEP_KINDS)}')


def _angles(colours: SweepColours, kind: str, angles_deg: Array | None) -> list[int]:
    stored = colours.angles_deg
    if angles_deg is not None and colours.labels:
        raise NacreError(f"--angles-deg: these colours are at named geometries: {', '.join(colours.labels)}")
    if angles_deg is not None:
        places = []
        for angle in np.atleast_1d(angles_deg):
            place = int(np.argmin(np.abs(stored - angle)))
            if abs(float(stored[place] - angle)) > 1e-6:
                held = ", ".join(f"{a:g}" for a in stored)
                raise NacreError(f"--angles-deg: the sweep does not hold {angle:g} degrees; it holds {held}")
            places.append(place)
        if kind == "colour-map" and len(places) > MAX_MAPS:
            raise NacreError(f"--angles-deg: a colour map shows {MAX_MAPS} angles at most, not {len(places)}")
        return places
    if kind == "parallel":
        return [0]
    return sorted({int(i) for i in np.linspace(0, len(stored) - 1, min(MAX_MAPS, len(stored))).round()})


def _map(colours: SweepColours, chosen: list[int], labels: list[str], title: str, sweeps: Any) -> Figure:
    """Map the two longest axes, or one axis over the angle; further axes have their first value."""
    if not colours.is_grid:
        raise NacreError("a colour map needs a grid sweep; draw random points with --kind gamut or parallel")
    light = (colours.illuminant, colours.observer)
    axes = [sweeps.AxisValues(_short(a.path), a.values, a.words) for a in colours.axes]
    lengths = [len(a.values) for a in colours.axes]
    if sum(length > 1 for length in lengths) < 2:
        long = int(np.argmax(lengths))
        values = np.moveaxis(colours.xyz, long, 0).reshape(lengths[long], len(colours.angles_deg), 3)
        over = sweeps.AxisValues("Angle of incidence (degrees)", colours.angles_deg)
        values = np.swapaxes(values, 0, 1)[None]
        figure: Figure = sweeps.sweep_map_figure(axes[long], over, values, *light, titles=[title])
        return figure
    first, second = sorted(np.argsort([-length for length in lengths], kind="stable")[:2])
    # words have more room along y
    x, y = (second, first) if axes[first].words and not axes[second].words else (first, second)
    place: list[Any] = [0] * len(axes)
    place[x] = place[y] = slice(None)
    values = colours.xyz[tuple(place)]  # [first, second, angle, 3]
    values = np.moveaxis(values[:, :, chosen], 2, 0)
    if x == first:
        values = np.swapaxes(values, 1, 2)
    fixed = [
        f"{axes[i].label} = {axes[i].words[0] if axes[i].words else f'{axes[i].values[0]:g}'}"
        for i in range(len(axes)) if i not in (x, y) and lengths[i] > 1
    ]  # fmt: skip
    titles = [f"{title}, {label}" if number == 0 else label for number, label in enumerate(labels)]
    figure = sweeps.sweep_map_figure(axes[x], axes[y], values, *light, titles=titles, note=", ".join(fixed))
    return figure


def _short(path: str) -> str:
    """Return a label of a recipe path: its last name, unit and index."""
    head, _, last = path.rpartition(".")
    stem, _, unit = last.rpartition("_")
    name = f"{stem.replace('_', ' ')} ({unit})" if unit in ("nm", "um", "mm", "deg") else last.replace("_", " ")
    number = head[head.rfind("[") :] if head.endswith("]") else ""
    return f"{name} {number}".strip()
