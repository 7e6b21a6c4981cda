"""A picture and what stands for it, pixel by pixel: colours matched or dithered, and the numbers that make them."""

from __future__ import annotations

import contextlib
import html
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.core.files import real, write_text
from nacre.light import (
    SRGB_WHITE_XYZ,
    clip_to_srgb,
    delta_e_2000,
    lab_to_xyz,
    srgb_decode,
    srgb_encode,
    srgb_linear_to_xyz,
    white_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
)
from nacre.material.material import load
from nacre.optimise.evaluation import JUDGE_SEED, TargetResult
from nacre.optimise.html_report import PICTURE, REPORT
from nacre.optimise.image.colour_grid import Eye, Sheet, fine_sheet, level_sheet
from nacre.optimise.image.files import FoundMap, map_files, write_maps
from nacre.optimise.image.matching import dither, has_same_hue, into_solid, match, seen_from_afar
from nacre.optimise.solutions import SUMMARY, Design, DesignProgress, Solution, clear_answers, write_recipe
from nacre.optimise.task import DesignTask
from nacre.optimise.thin_film.adapter import interrupt_flag
from nacre.plot.html import DPI, data_uri, framed, png_uri

if TYPE_CHECKING:
    from nacre.plot import Figure


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture and what stands for it.

    Attributes:
        asked: `[row, column, 3]`, encoded sRGB.
        reached: the same of what is shown, clipped into sRGB.
        distance: `[row, column]`, dE00 between them; where levels are dithered, as seen from afar.
        is_mapped: `[row, column]`, whether a pixel's colour is out of reach.
        keeps_hue: `[row, column]`, whether its hue is kept.
        maps: of the numbers.
        sheet: of what can be reached, and `white` its XYZ of white.
    """

    asked: Array
    reached: Array
    distance: Array
    is_mapped: NDArray[np.bool_]
    keeps_hue: NDArray[np.bool_]
    maps: list[FoundMap]
    sheet: Sheet
    white: Array


def make_picture(
    target: DesignTask, eye: Eye, seconds: float = np.inf, is_interrupted: Callable[[], bool] = lambda: False
) -> Picture:
    """Choose what stands for each pixel; nothing is written.

    Args:
        seconds: for what can be reached.
        is_interrupted: asked while that is solved.

    Raises:
        NacreError: a material cannot be computed in that time, or at all.
    """
    want, levels = target.targets[0], target.spec.limits.height_levels
    assert want.image is not None
    shape = want.image.shape[:2]
    pixels = np.round(want.image.reshape(-1, 3) * 65535.0).astype(np.int64)
    # equal colours are matched once
    _, first, inverse = np.unique((pixels << np.array([32, 16, 0])).sum(axis=1), return_index=True, return_inverse=True)
    inverse = inverse.reshape(shape)
    asked = srgb_lab(want.image.reshape(-1, 3)[first])
    if levels is None:
        sheet = fine_sheet(eye, seconds, is_interrupted)
        lab = np.asarray(xyz_to_lab(sheet.xyz, eye.white))
        found = match(asked, lab, want.tolerance)
        points = found.points[inverse]
        distance, is_mapped, keeps_hue = found.distance[inverse], found.is_mapped[inverse], found.keeps_hue[inverse]
    else:
        sheet = level_sheet(eye, levels)
        mapped, moved = into_solid(asked, sheet.flat_xyz, eye.white, want.tolerance)
        aim = np.asarray(lab_to_xyz(mapped, eye.white))[inverse]
        points = dither(aim, sheet.flat_xyz, eye.white)
        wanted = np.asarray(lab_to_xyz(asked, eye.white))[inverse]
        near, far = (xyz_to_lab(seen_from_afar(xyz), eye.white) for xyz in (np.asarray(sheet.flat_xyz[points]), wanted))
        distance = np.asarray(delta_e_2000(far, near))
        is_mapped, keeps_hue = moved[inverse], has_same_hue(asked, mapped)[inverse]
    maps = [
        FoundMap(number.path, values, number.low, number.high, levels)
        for number, values in zip(target.parameters, sheet.values(points), strict=True)
    ]
    shown = screen(sheet.flat_xyz[points], eye.white)
    return Picture(want.image, shown, distance, is_mapped, keeps_hue, maps, sheet, eye.white)


def srgb_lab(rgb: Array) -> Array:
    """Return CIELAB of encoded sRGB `[..., 3]`, by D65 and the 2 degree observer, which sRGB is made for."""
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(srgb_decode(rgb)), SRGB_WHITE_XYZ))


def screen(xyz: Array, white: Array) -> Array:
    """Return the encoded sRGB of XYZ `[..., 3]` whose Lab against `white` a screen shows, clipped into sRGB.

    The inverse of what an image's colours are wanted by: the same numbers L*, a*, b* against the screen's white.
    """
    shown = np.clip(lab_to_xyz(xyz_to_lab(xyz, white), SRGB_WHITE_XYZ), 0.0, None)
    return np.asarray(srgb_encode(clip_to_srgb(xyz_to_srgb_linear(shown)).rgb))


__all__ = ["Picture", "make_picture", "screen", "srgb_lab"]


# The report of a picture made of structure: one HTML file that needs nothing else, and its sheet as PNG.

POINTS = 4000  # of what can be reached, in the chart
MARKS = 400  # of the picture's colours


def write_page(folder: Path, target: DesignTask, design: Design, picture: Picture, begun: float) -> None:
    """Write report.html and report.png.

    Args:
        begun: when the whole design did, by the monotonic clock; its summary gets the seconds that the page tells.

    Raises:
        NacreError: the folder cannot be written.
    """
    from nacre.plot import save_figure
    from nacre.plot.sheets import PictureSheet, picture_figure

    lamp, observer = target.spec.light.illuminants[0], target.spec.light.observer
    note = (
        f"{lamp}, {observer} observer, {target.targets[0].geometry}; the first row on top, seen from the light's side"
    )
    maps = [(m.path, m.values) for m in picture.maps]
    title = _wrapped(f"{target.name}: {design.message}")
    sheet = PictureSheet(title, picture.asked, picture.reached, picture.distance, picture.is_mapped, maps, note)

    save_figure(picture_figure(sheet), folder / PICTURE, {"target": target.fingerprint})
    shown = (folder / PICTURE).read_bytes()  # drawn once: pixels of a picture take a second
    chart = data_uri(_chart(picture, lamp, observer), DPI)
    checked = design.best.facts["checked"]
    facts = (
        f"{checked['pixels']} pixels, solved anew, differ from what is told here by dE00 {checked['de00_mean']:.3f} in "
        f"the mean and {checked['de00_largest']:.3f} at most."
    )
    text = html.escape(
        target.context.text or json.dumps(target.spec.model_dump(exclude_none=True), indent=2, default=str)
    )
    took = design.summary["seconds"] = round(time.monotonic() - begun, 3)
    body = [
        f"<h1>{html.escape(target.name)}</h1>",
        f'<p class="{"good" if design.status == "met" else "far"}">{html.escape(design.message)}.</p>',
        f"<p>{took:.1f} s. {html.escape(note)}. {facts}</p>",
        f'<img alt="asked, reached, how far off, and the maps" src="{png_uri(shown)}">',
        "<h2>What can be reached</h2><p>Every colour that the free numbers make (with levels: before they are "
        "dithered); crosses are colours of the picture.</p>",
        f'<img alt="what can be reached" src="{chart}">',
        f"<details><summary>the target</summary><pre>{text}</pre></details>",
        f"<details><summary>design.json</summary><pre>{html.escape(json.dumps(design.summary, indent=2, default=str))}"
        "</pre></details>",
    ]
    write_text(folder / REPORT, framed(target.name, body))


def _wrapped(text: str, width: int = 118) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, width))


def _chart(picture: Picture, lamp: str, observer: str) -> Figure:
    """Draw what can be reached, and colours of the picture in it."""
    from nacre.light import xyz_to_xyy
    from nacre.optimise.gamut import optimal_limits, srgb_limits
    from nacre.plot import reach_figure

    xyz = picture.sheet.flat_xyz
    xyz = xyz[:: max(1, len(xyz) // POINTS)]
    white = white_xyz(lamp, observer)
    pixels = picture.asked.reshape(-1, 3)
    marks = srgb_lab(pixels[:: max(1, len(pixels) // MARKS)])
    limits = np.asarray(xyz_to_lab(optimal_limits(lamp, observer), white))
    lab = np.asarray(xyz_to_lab(xyz, white))
    note = f"{lamp}, {observer} observer"
    srgb = srgb_limits(lamp, observer)
    return reach_figure(lab, np.asarray(xyz_to_xyy(xyz)), srgb, limits, white, "What can be reached", note, marks)


__all__ = ["write_page"]


# A picture made of structure, from target to folder: what can be reached, which of it for each pixel, maps, recipe.

REACHED = "reached.png"
SHEET_SHARE = 0.6  # of the time, for what can be reached
CHECKED_PIXELS, CHECKED_SLOW = 256, 4
OUT_OF_REACH = 0.01  # share of pixels up to which a picture is met


def design_picture(
    target: DesignTask, folder: Path, begun: float, progress: Callable[[DesignProgress], None] | None
) -> Design:
    """Design what a target with a picture asks for.

    Args:
        target: of which the only want is a picture.
        folder: which exists.
        begun: `time.monotonic()` of the start.
        progress: called before and after the matching.

    Raises:
        RecipeError: the picture lies where a map would be written, or the time is too short for what varies.
        NacreError: the material cannot be computed, or the folder not be written.
    """
    want, total = target.targets[0], target.spec.search.seconds
    assert want.image is not None
    _check_places(target, folder)

    def tell(worst: float) -> None:
        if progress is not None:
            spent = time.monotonic() - begun
            progress(DesignProgress(worst, spent, max(total - spent, 0.0)))

    tell(float("inf"))
    eye = eye_of(target)
    with interrupt_flag() as is_interrupted:
        left = SHEET_SHARE * total - (time.monotonic() - begun)
        picture = make_picture(target, eye, left, is_interrupted)
        stopped = is_interrupted()
    mean = float(picture.distance.mean())
    tell(mean / want.tolerance)
    facts = _facts(target, picture)
    facts["checked"] = _checked(target, picture)
    solution = _write(target, folder, picture, facts, mean)
    status = "met" if facts["share_out_of_reach"] <= OUT_OF_REACH else "out of reach"
    status = "interrupted" if stopped else status
    message = in_words(facts, want.tolerance, stopped)
    summary: dict[str, Any] = {
        "status": status, "message": message, "seconds": round(time.monotonic() - begun, 3),
        "solutions": [_document(solution, target)], "light": target.spec.light.model_dump(),
        "seed": target.spec.search.seed, "target": target.fingerprint, "nacre": __version__,
    }  # fmt: skip
    design = Design(folder, status, message, summary["seconds"], [solution], summary)
    _summarise(folder, summary)
    with contextlib.suppress(KeyboardInterrupt):
        write_page(folder, target, design, picture, begun)
    _summarise(folder, summary)
    return replace(design, seconds=summary["seconds"])


def _summarise(folder: Path, summary: dict[str, Any]) -> None:
    write_text(folder / SUMMARY, json.dumps(summary, indent=2, default=str) + "\n")


def eye_of(target: DesignTask, is_judge: bool = False) -> Eye:
    light = target.spec.light
    seed = target.spec.search.seed + (JUDGE_SEED if is_judge else 0)
    at = target.targets[0].geometry
    return Eye(target.material, target.parameters, at, light.illuminants[0], light.observer, seed, is_judge)


def _check_places(target: DesignTask, folder: Path) -> None:
    """Refuse a folder in which the picture itself would be overwritten."""
    name = target.spec.target[0].image
    assert name is not None
    path = real(target.context.path(name))
    written = [f"{FoundMap(n.path, np.zeros((1, 1)), 0.0, 1.0, None).stem}.png" for n in target.parameters]
    if path in [(folder / other).resolve() for other in (*written, REACHED, "report.png")]:
        raise RecipeError(
            f"{folder}: holds the picture {path.name}, which would be overwritten; choose another with -o"
        )


def _facts(target: DesignTask, picture: Picture) -> dict[str, Any]:
    off, mapped = picture.distance, picture.is_mapped
    count = int(mapped.sum())
    return {
        "pixels": [int(n) for n in off.shape],
        "de00_mean": float(off.mean()), "de00_median": float(np.median(off)),
        "de00_99_percent": float(np.percentile(off, 99.0)), "de00_largest": float(off.max()),
        "share_out_of_reach": count / mapped.size,
        "share_hue_kept": float(picture.keeps_hue[mapped].mean()) if count else 1.0,
        "levels": target.spec.limits.height_levels, "seen_from_afar": target.spec.limits.height_levels is not None,
        "nodes": picture.sheet.nodes, "de00_of_spline": picture.sheet.error,
        "maps": [
            {"path": m.path, "file": f"{m.stem}.png", "min": m.low, "max": m.high, "levels": m.levels}
            for m in picture.maps
        ],
    }  # fmt: skip


def _checked(target: DesignTask, picture: Picture) -> dict[str, Any]:
    """Solve some of the pixels anew, as closely as answers are judged, with another seed."""
    judge = eye_of(target, is_judge=True)
    count = CHECKED_PIXELS if judge.is_batched else CHECKED_SLOW
    values = np.stack([m.values.ravel() for m in picture.maps], axis=-1)
    chosen = np.random.default_rng(target.spec.search.seed).integers(len(values), size=count)
    low, high = (np.array([getattr(n, end) for n in target.parameters]) for end in ("low", "high"))
    places, where = np.unique((values[chosen] - low) / (high - low), axis=0, return_inverse=True)
    xyz = judge.xyz(places)
    assert xyz is not None
    own = np.asarray(xyz_to_lab(xyz, judge.white))[where.reshape(-1)]
    told = np.asarray(xyz_to_lab(_xyz_of(picture, chosen), picture.white))
    off = np.asarray(delta_e_2000(own, told))
    return {"pixels": count, "de00_mean": float(off.mean()), "de00_largest": float(off.max())}


def _xyz_of(picture: Picture, pixels: NDArray[np.int64]) -> Array:
    places = tuple(
        np.searchsorted(axis, m.values.ravel()[pixels])
        for axis, m in zip(picture.sheet.axes, picture.maps, strict=True)
    )
    return np.asarray(picture.sheet.xyz[places])


def _write(target: DesignTask, folder: Path, picture: Picture, facts: dict[str, Any], mean: float) -> Solution:
    """Write recipe, maps and the picture as it will look; read the recipe again, as every command will."""
    from PIL import Image

    from nacre.core.files import atomic_path

    clear_answers(folder, 0)  # maps of an earlier run under other names
    folder.mkdir(parents=True, exist_ok=True)
    write_maps(folder, picture.maps, {"nacre": __version__, "target": target.fingerprint})
    changes = {m.path: m.texture for m in picture.maps}
    path, files = write_recipe(folder, target.material, changes, {})
    with atomic_path(folder / REACHED) as temporary:
        Image.fromarray(np.round(255.0 * picture.reached).astype(np.uint8)).save(temporary)
    want, lamp = target.targets[0], target.spec.light.illuminants[0]
    asked, reached = (srgb_lab(rgb).mean(axis=(0, 1)) for rgb in (picture.asked, picture.reached))
    facts["files"] = [*files, *map_files(picture.maps), REACHED]
    return Solution(path, load(path), changes, [TargetResult(want, lamp, reached, asked, mean)], facts)


def _document(solution: Solution, target: DesignTask) -> dict[str, Any]:
    want, worst = target.targets[0], solution.worst
    keys = ("de00_mean", "de00_median", "de00_99_percent", "de00_largest", "share_out_of_reach", "share_hue_kept")
    entry = {
        "geometry": str(want.geometry),
        "lamp": worst.lamp,
        "asked": want.asked,
        "tolerance": want.tolerance,
        "met": worst.is_met,
    }
    entry |= {"de00": worst.distance, **{key: solution.facts[key] for key in keys}}
    rest = {key: value for key, value in solution.facts.items() if key not in keys}
    return {
        "recipe": str(solution.recipe),
        "worst": worst.scaled,
        "targets": [entry],
        "changes": solution.changes,
        **rest,
    }


def in_words(facts: dict[str, Any], within: float, stopped: bool = False) -> str:
    """Return the outcome as a sentence."""
    share, kept = facts["share_out_of_reach"], facts["share_hue_kept"]
    afar = ", seen from afar" if facts["seen_from_afar"] else ""
    head = "stopped; " if stopped else ""
    said = f"{head}median dE00 {facts['de00_median']:.2f}, 99 % below {facts['de00_99_percent']:.1f}{afar}"
    if share <= 0.0:
        return f"{said}; every pixel's colour is within {within:g} of one that can be made"
    return (
        f"{said}; {100 * share:.1f} % of the pixels are out of reach (farther than {within:g} from all that can be "
        f"made) and were mapped, {100 * kept:.0f} % of them at their hue"
    )


__all__ = ["design_picture", "in_words"]
