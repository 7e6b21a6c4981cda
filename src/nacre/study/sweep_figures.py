"""From a sweep's store to a figure: which two numbers to map, which angles to show, what stays fixed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.study.sweep_reader import SweepColours, read_sweep

if TYPE_CHECKING:
    from nacre.plot import Figure

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
        angles_deg: which of the stored angles; default: the first, or up to four of them spread evenly.
        part: of the spectrum; default: the brightest stored.

    Raises:
        NacreError: not a sweep, an angle that it does not hold, or a kind that it cannot feed.
    """
    from nacre.plot import save_figure

    colours = read_sweep(store, part)
    provenance = {"sweep": colours.source, "recipe": colours.recipe, "illuminant": colours.illuminant}
    save_figure(sweep_figure(colours, kind, angles_deg), path, provenance)


def sweep_figure(colours: SweepColours, kind: str, angles_deg: Array | None = None) -> Figure:
    """Return the figure of a kind; see `save_sweep_figure`."""
    from nacre.plot import sweeps

    chosen = _angles(colours, kind, angles_deg)
    labels = [f"{colours.angles_deg[i]:g}\u00b0" for i in chosen]
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
    """Map the two longest axes; a single axis is mapped over the angle; further axes stay at their first value."""
    if not colours.is_grid:
        raise NacreError("a colour map needs a grid sweep; draw random points with --kind gamut or parallel")
    light = (colours.illuminant, colours.observer)
    axes = [sweeps.AxisValues(_short(a.path), a.values, a.words) for a in colours.axes]
    lengths = [len(a.values) for a in colours.axes]
    if sum(length > 1 for length in lengths) < 2:
        long = int(np.argmax(lengths))
        values = np.moveaxis(colours.xyz, long, 0).reshape(lengths[long], len(colours.angles_deg), 3)
        over = sweeps.AxisValues("Angle of incidence (degrees)", colours.angles_deg)
        return sweeps.sweep_map_figure(axes[long], over, np.swapaxes(values, 0, 1)[None], *light, titles=[title])
    first, second = sorted(np.argsort([-length for length in lengths], kind="stable")[:2])
    # words read better along y, where they have room
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
    return sweeps.sweep_map_figure(axes[x], axes[y], values, *light, titles=titles, note=", ".join(fixed))


def _short(path: str) -> str:
    """Return a label of a recipe path: its last name and unit, and which of several it is."""
    head, _, last = path.rpartition(".")
    stem, _, unit = last.rpartition("_")
    name = f"{stem.replace('_', ' ')} ({unit})" if unit in ("nm", "um", "mm", "deg") else last.replace("_", " ")
    number = head[head.rfind("[") :] if head.endswith("]") else ""
    return f"{name} {number}".strip()
