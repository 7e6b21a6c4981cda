"""Picture design: parameter gamut, colour assignment by pixel, parameter maps, recipe, report."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.files import atomic_path, write_text
from nacre.core.html import png_uri, render_page
from nacre.core.jit import clock
from nacre.families.contract import Pixels
from nacre.light import delta_e_2000, lab_to_xyz, xyz_to_lab
from nacre.material.material import load
from nacre.optimise.checkpoint import Checkpointer, unreadable
from nacre.optimise.evaluation import SEED_OFFSET, TargetResult, as_written
from nacre.optimise.gamut import colour_chart
from nacre.optimise.html_report import PICTURE, REPORT
from nacre.optimise.image.colour_grid import ColourGrid, ColourSampler, Palette, fine_grid, level_grid
from nacre.optimise.image.files import ParameterMap, screen_rgb, srgb_lab, write_maps, write_pixels
from nacre.optimise.image.matching import blurred, dither, has_same_hue, map_into_solid, match_colours, nearest_colours
from nacre.optimise.solutions import Design, DesignProgress, Solution, claim, clear_solutions, conclude, write_recipe
from nacre.optimise.task import DesignTask
from nacre.optimise.thin_film.adapter import interrupt_flag
from nacre.plot.style import DPI, data_uri

if TYPE_CHECKING:
    from nacre.plot import Figure

REACHED = "reached.png"
GRID_SHARE = 0.6  # share of a given time limit, after which the palette is not refined further
CHECKED_PIXELS, CHECKED_SLOW = 256, 4  # pixels in the final evaluation: batched materials, others
SPLINE_STATED, CHECK_STATED = 1.0, 0.5  # dE00 of the interpolation and of checked pixels that the outcome names
MAX_UNREACHABLE = 0.01  # largest unreachable pixel share for a met picture
CHART_POINTS, CHART_MARKS = 4000, 400  # grid and picture colours in the gamut chart


@dataclass(frozen=True, eq=False)
class PictureDesign:
    """The target picture and its reproduction.

    Attributes:
        asked: `[row, column, 3]`, encoded target sRGB.
        reached: the reproduction, clipped to sRGB.
        distance: `[row, column]`, dE00 between both; if levels are dithered, between blurred pictures.
        is_mapped: `[row, column]`, whether the colour is unreachable.
        keeps_hue: `[row, column]`, whether the hue is preserved.
        maps: parameter maps.
        grid, white: the reachable colours, and the white's XYZ.
    """

    asked: Array
    reached: Array
    distance: Array
    is_mapped: NDArray[np.bool_]
    keeps_hue: NDArray[np.bool_]
    maps: list[ParameterMap]
    grid: ColourGrid
    white: Array


def make_picture(task: DesignTask, palette: Palette) -> PictureDesign:
    """Assign a reachable colour to each pixel.

    Raises:
        NacreError: a material cannot be computed, or the budget is too small.
    """
    sampler = palette.sampler
    target, levels, white = task.targets[0], task.spec.limits.height_levels, sampler.white
    assert target.image is not None
    pixels = np.round(target.image.reshape(-1, 3) * 65535.0).astype(np.int64)
    # equal colours are matched once
    _, first, inverse = np.unique((pixels << np.array([32, 16, 0])).sum(axis=1), return_index=True, return_inverse=True)
    inverse = inverse.reshape(target.image.shape[:2])
    target_lab = srgb_lab(target.image.reshape(-1, 3)[first])
    if levels is None:
        grid = fine_grid(palette)
        match = match_colours(target_lab, np.asarray(xyz_to_lab(grid.xyz, white)), target.tolerance)
        points, distance = match.points[inverse], match.distance[inverse]
        is_mapped, keeps_hue = match.is_mapped[inverse], match.keeps_hue[inverse]
    elif not task.spec.limits.dither:
        grid = level_grid(palette, levels)
        lab = np.asarray(xyz_to_lab(grid.flat_xyz, white))
        nearest, off = nearest_colours(target_lab, lab)
        points, distance, is_mapped = nearest[inverse], off[inverse], (off > target.tolerance)[inverse]
        keeps_hue = has_same_hue(target_lab, lab[nearest])[inverse]
    else:
        grid = level_grid(palette, levels)
        mapped, moved = map_into_solid(target_lab, grid.flat_xyz, white, target.tolerance)
        points = dither(np.asarray(lab_to_xyz(mapped, white))[inverse], grid.flat_xyz, white)
        both = np.asarray(lab_to_xyz(target_lab, white))[inverse], np.asarray(grid.flat_xyz[points])
        distance = np.asarray(delta_e_2000(*(xyz_to_lab(blurred(xyz), white) for xyz in both)))
        is_mapped, keeps_hue = moved[inverse], has_same_hue(target_lab, mapped)[inverse]
    maps = [
        ParameterMap(p.path, values, p.low, p.high, levels)
        for p, values in zip(task.parameters, grid.values(points), strict=True)
    ]
    reached = screen_rgb(grid.flat_xyz[points], white)
    return PictureDesign(target.image, reached, distance, is_mapped, keeps_hue, maps, grid, white)


def design_picture(
    task: DesignTask, checkpointer: Checkpointer, begun: float, progress: Callable[[DesignProgress], None] | None
) -> Design:
    """Design a picture.

    Args:
        task: its only target is a picture.
        checkpointer: palette checkpointer, in the existing design folder.
        begun: `core.jit.clock()` at the start.
        progress: called before, during and after the computation.

    Raises:
        RecipeError: a map would overwrite the picture, or the budget is too small.
        NacreError: the material cannot be computed, or the folder cannot be written.
    """
    target, search = task.targets[0], task.spec.search
    total = search.seconds if "seconds" in search.model_fields_set else np.inf
    folder = checkpointer.folder
    task.check_overwriting(folder, [REACHED, PICTURE])

    def report(worst: float, description: str, count: int = 0) -> None:
        if progress is not None:
            spent = clock() - begun
            progress(DesignProgress(worst, spent, max(total - spent, 0.0), count, description))

    def solved(count: int) -> None:
        if checkpointer.is_due:
            save()
            report(np.inf, f"{count} of at most {palette.limit} materials of the palette", count)

    def save() -> None:
        if palette.solved:
            claim(folder)
            checkpointer.update([], palette=palette.solved)

    report(np.inf, "palette")
    sampler = _sampler(task)
    with interrupt_flag() as is_interrupted:
        stored = _stored_palette(folder, checkpointer)
        limit = None if search.evaluations is None else int(search.evaluations)
        palette = Palette(sampler, limit, stored, solved, is_interrupted, begun + GRID_SHARE * total)
        try:
            picture = make_picture(task, palette)
        finally:
            save()
    worst = float(picture.distance.mean()) / target.tolerance
    report(worst, f"mean distance at {worst:.3g} of its tolerance", palette.used)
    facts = _figures(task, picture)
    claim(folder)
    solution = _write(task, folder, picture, facts)
    status = "met" if facts["share_out_of_reach"] <= MAX_UNREACHABLE else "out of reach"
    status = "interrupted" if palette.is_stopped and is_interrupted() else status
    message = in_words(facts, target.tolerance, palette.is_stopped)
    summary: dict[str, Any] = {
        "status": status,
        "message": message,
        "seconds": round(clock() - begun, 3),
        "solutions": [_document(solution, task)],
        "light": task.spec.light.model_dump(),
        "seed": task.spec.search.seed,
        "target": task.fingerprint,
        "nacre": __version__,
    }
    return conclude(folder, summary, [solution], lambda design: _write_report(folder, task, design, picture, begun))


def _stored_palette(folder: Path, checkpointer: Checkpointer) -> list[list[float]]:
    """Return the colours of an interrupted run.

    Raises:
        NacreError: the checkpoint cannot be read.
    """
    try:
        palette = np.array(checkpointer.progress.get("palette", []), dtype=float)
    except (TypeError, ValueError):
        raise unreadable(folder) from None
    if palette.size and (palette.ndim != 2 or palette.shape[1] != 3 or not np.isfinite(palette).all()):
        raise unreadable(folder)
    return [[float(v) for v in row] for row in palette]


def _sampler(task: DesignTask, is_final: bool = False) -> ColourSampler:
    light = task.spec.light
    seed = task.spec.search.seed + (SEED_OFFSET if is_final else 0)
    pair = (light.illuminants[0], light.observer)
    is_few = len(task.parameters) == 1 and isinstance(task.material.model, Pixels)
    material = as_written(task.material) if is_final or is_few else task.material
    return ColourSampler(material, task.parameters, task.targets[0].geometry, pair, seed, is_final)


def _figures(task: DesignTask, picture: PictureDesign) -> dict[str, Any]:
    distance, mapped, levels = picture.distance, picture.is_mapped, task.spec.limits.height_levels
    count = int(mapped.sum())
    return {
        "pixels": list(distance.shape),
        "de00_mean": float(distance.mean()),
        "de00_median": float(np.median(distance)),
        "de00_99_percent": float(np.percentile(distance, 99.0)),
        "de00_largest": float(distance.max()),
        "share_out_of_reach": count / mapped.size,
        "share_hue_kept": float(picture.keeps_hue[mapped].mean()) if count else 1.0,
        "levels": levels,
        "seen_from_afar": levels is not None and task.spec.limits.dither,
        "nodes": picture.grid.nodes,
        "de00_of_spline": picture.grid.error,
        "maps": [
            {"path": m.path, "file": f"{m.stem}.png", "min": m.low, "max": m.high, "levels": m.levels}
            for m in picture.maps
        ],
        "checked": _evaluate_pixels(task, picture),
    }


def _evaluate_pixels(task: DesignTask, picture: PictureDesign) -> dict[str, Any]:
    """Compute some pixels with final evaluation accuracy and another seed; return their differences."""
    sampler = _sampler(task, is_final=True)
    count = CHECKED_PIXELS if sampler.is_batched else CHECKED_SLOW
    values = np.stack([m.values.ravel() for m in picture.maps], axis=-1)
    chosen = values[np.random.default_rng(task.spec.search.seed).integers(len(values), size=count)]
    low, high = (np.array([getattr(p, end) for p in task.parameters]) for end in ("low", "high"))
    points, inverse = np.unique((chosen - low) / (high - low), axis=0, return_inverse=True)
    accurate = np.asarray(xyz_to_lab(sampler.xyz(points), sampler.white))[inverse.reshape(-1)]
    indices = tuple(np.searchsorted(axis, column) for axis, column in zip(picture.grid.axes, chosen.T, strict=True))
    interpolated = np.asarray(xyz_to_lab(picture.grid.xyz[indices], picture.white))
    off = np.asarray(delta_e_2000(accurate, interpolated))
    return {"pixels": count, "de00_mean": float(off.mean()), "de00_largest": float(off.max())}


def _write(task: DesignTask, folder: Path, picture: PictureDesign, facts: dict[str, Any]) -> Solution:
    """Write recipe, maps and the reproduced picture; load the recipe as a user would."""
    from PIL import Image

    clear_solutions(folder, 0)  # earlier maps under other names
    folder.mkdir(parents=True, exist_ok=True)
    map_files = write_maps(folder, picture.maps, {"nacre": __version__, "target": task.fingerprint})
    changes: dict[str, Any] = {m.path: m.texture for m in picture.maps}
    if isinstance(task.material.model, Pixels):
        # each pixel is its own structure: the recipe is the middle one, the field is a drawing
        changes = {m.path: float(np.median(m.values)) for m in picture.maps}
        map_files = [*map_files, *write_pixels(folder, task.material, picture.maps)]
    path, files = write_recipe(folder, task.material, changes, {})
    with atomic_path(folder / REACHED) as temporary:
        Image.fromarray(np.round(255.0 * picture.reached).astype(np.uint8)).save(temporary)
    target, lamp = task.targets[0], task.spec.light.illuminants[0]
    target_lab, lab = (srgb_lab(rgb).mean(axis=(0, 1)) for rgb in (picture.asked, picture.reached))
    facts["files"] = [*files, *map_files, REACHED]
    return Solution(path, load(path), changes, [TargetResult(target, lamp, lab, target_lab, facts["de00_mean"])], facts)


def _document(solution: Solution, task: DesignTask) -> dict[str, Any]:
    target, worst = task.targets[0], solution.worst
    keys = ("de00_mean", "de00_median", "de00_99_percent", "de00_largest", "share_out_of_reach", "share_hue_kept")
    entry = {
        "geometry": str(target.geometry),
        "lamp": worst.lamp,
        "asked": target.asked,
        "tolerance": target.tolerance,
        "met": worst.is_met,
    }
    entry |= {"de00": worst.distance, **{key: solution.facts[key] for key in keys}}
    rest = {key: value for key, value in solution.facts.items() if key not in keys}
    document = {"recipe": str(solution.recipe), "worst": worst.scaled, "targets": [entry], "changes": solution.changes}
    return document | rest


def in_words(facts: dict[str, Any], tolerance: float, stopped: bool = False) -> str:
    """Return the outcome as a sentence."""
    share, preserved = facts["share_out_of_reach"], facts["share_hue_kept"]
    afar = ", seen from afar" if facts["seen_from_afar"] else ""
    head = "stopped; " if stopped else ""
    head = f"{head}median dE00 {facts['de00_median']:.2f}, 99 % below {facts['de00_99_percent']:.1f}{afar}"
    if facts["de00_of_spline"] > SPLINE_STATED:
        head += f"; interpolation between {facts['nodes']} values of a size: dE00 {facts['de00_of_spline']:.1f}"
    if facts["checked"]["de00_mean"] > CHECK_STATED:
        head += "; {pixels} pixels, solved finely, differ from the palette by dE00 {de00_mean:.1f} on average".format(
            **facts["checked"]
        )
    if share <= 0.0:
        return f"{head}; every pixel is within {tolerance:g} of a reachable colour"
    return (
        f"{head}; {100 * share:.1f} % of the pixels are out of reach (farther than {tolerance:g} from all reachable "
        f"colours) and were mapped, {100 * preserved:.0f} % of them at constant hue"
    )


def _write_report(folder: Path, task: DesignTask, design: Design, picture: PictureDesign, begun: float) -> None:
    """Write report.html and report.png; the summary gets the total time.

    Raises:
        NacreError: the folder cannot be written.
    """
    from nacre.plot import save_figure
    from nacre.plot.sheets import PictureSheet, picture_figure

    light = (task.spec.light.illuminants[0], task.spec.light.observer)
    geometry = task.targets[0].geometry
    note = f"{light[0]}, {light[1]} observer, {geometry}; the first row on top, seen from the light's side"
    maps = [(m.path, m.values) for m in picture.maps]
    title = "\n".join(textwrap.wrap(f"{task.name}: {design.message}", 118))
    sheet = PictureSheet(title, picture.asked, picture.reached, picture.distance, picture.is_mapped, maps, note)
    save_figure(picture_figure(sheet), folder / PICTURE, {"target": task.fingerprint})
    spec = task.spec.model_dump(exclude_none=True)
    design.summary["seconds"] = round(clock() - begun, 3)
    page = render_page(
        "image_report.html",
        title=task.name,
        design=design,
        note=note,
        checked=design.best.facts["checked"],
        sheet=png_uri((folder / PICTURE).read_bytes()),
        chart=data_uri(_chart(picture, light), DPI),
        target=task.context.text or json.dumps(spec, indent=2, default=str),
        document=json.dumps(design.summary, indent=2, default=str),
    )
    write_text(folder / REPORT, page)


def _chart(picture: PictureDesign, light: tuple[str, str]) -> Figure:
    xyz = picture.grid.flat_xyz
    pixels = picture.asked.reshape(-1, 3)
    marks = srgb_lab(pixels[:: max(1, len(pixels) // CHART_MARKS)])
    note = f"{light[0]}, {light[1]} observer"
    return colour_chart(xyz[:: max(1, len(xyz) // CHART_POINTS)], light, "Gamut", note, marks)
