"""A picture made of structure, from target to folder: what can be reached, which of it for each pixel, maps, recipe."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.arrays import Array
from nacre.design.wants.answers import (
    SUMMARY,
    Design,
    Solution,
    WantsProgress,
    clear_answers,
    write_recipe,
)
from nacre.design.wants.films import interrupt_flag
from nacre.design.wants.image_maps import FoundMap, map_files, write_maps
from nacre.design.wants.image_page import write_page
from nacre.design.wants.image_picture import Picture, make_picture, srgb_lab
from nacre.design.wants.image_reach import Eye
from nacre.design.wants.judge import JUDGE_SEED, Reached
from nacre.design.wants.target import Target
from nacre.errors import RecipeError
from nacre.files import real, write_text
from nacre.light import (
    delta_e_2000,
    xyz_to_lab,
)
from nacre.materials.material import load

REACHED = "reached.png"
SHEET_SHARE = 0.6  # of the time, for what can be reached
CHECKED_PIXELS, CHECKED_SLOW = 256, 4
OUT_OF_REACH = 0.01  # share of pixels up to which a picture is met


def design_picture(
    target: Target, folder: Path, begun: float, progress: Callable[[WantsProgress], None] | None
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
    want, total = target.wants[0], target.spec.search.seconds
    assert want.image is not None
    _check_places(target, folder)

    def tell(worst: float) -> None:
        if progress is not None:
            spent = time.monotonic() - begun
            progress(WantsProgress(worst, spent, max(total - spent, 0.0)))

    tell(float("inf"))
    eye = eye_of(target)
    with interrupt_flag() as is_interrupted:
        left = SHEET_SHARE * total - (time.monotonic() - begun)
        picture = make_picture(target, eye, left, is_interrupted)
        stopped = is_interrupted()
    mean = float(picture.distance.mean())
    tell(mean / want.within)
    facts = _facts(target, picture)
    facts["checked"] = _checked(target, picture)
    solution = _write(target, folder, picture, facts, mean)
    status = "met" if facts["share_out_of_reach"] <= OUT_OF_REACH else "out of reach"
    status = "interrupted" if stopped else status
    message = in_words(facts, want.within, stopped)
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


def eye_of(target: Target, is_judge: bool = False) -> Eye:
    light = target.spec.light
    seed = target.spec.search.seed + (JUDGE_SEED if is_judge else 0)
    at = target.wants[0].at
    return Eye(target.material, target.free, at, light.illuminants[0], light.observer, seed, is_judge)


def _check_places(target: Target, folder: Path) -> None:
    """Refuse a folder in which the picture itself would be overwritten."""
    name = target.spec.want[0].image
    assert name is not None
    path = real(target.context.path(name))
    written = [f"{FoundMap(n.path, np.zeros((1, 1)), 0.0, 1.0, None).stem}.png" for n in target.free]
    if path in [(folder / other).resolve() for other in (*written, REACHED, "report.png")]:
        raise RecipeError(
            f"{folder}: holds the picture {path.name}, which would be overwritten; choose another with -o"
        )


def _facts(target: Target, picture: Picture) -> dict[str, Any]:
    off, mapped = picture.distance, picture.is_mapped
    count = int(mapped.sum())
    return {
        "pixels": [int(n) for n in off.shape],
        "de00_mean": float(off.mean()), "de00_median": float(np.median(off)),
        "de00_99_percent": float(np.percentile(off, 99.0)), "de00_largest": float(off.max()),
        "share_out_of_reach": count / mapped.size,
        "share_hue_kept": float(picture.keeps_hue[mapped].mean()) if count else 1.0,
        "levels": target.spec.limits.levels, "seen_from_afar": target.spec.limits.levels is not None,
        "nodes": picture.sheet.nodes, "de00_of_spline": picture.sheet.error,
        "maps": [
            {"path": m.path, "file": f"{m.stem}.png", "min": m.low, "max": m.high, "levels": m.levels}
            for m in picture.maps
        ],
    }  # fmt: skip


def _checked(target: Target, picture: Picture) -> dict[str, Any]:
    """Solve some of the pixels anew, as closely as answers are judged, with another seed."""
    judge = eye_of(target, is_judge=True)
    count = CHECKED_PIXELS if judge.is_batched else CHECKED_SLOW
    values = np.stack([m.values.ravel() for m in picture.maps], axis=-1)
    chosen = np.random.default_rng(target.spec.search.seed).integers(len(values), size=count)
    low, high = (np.array([getattr(n, end) for n in target.free]) for end in ("low", "high"))
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


def _write(target: Target, folder: Path, picture: Picture, facts: dict[str, Any], mean: float) -> Solution:
    """Write recipe, maps and the picture as it will look; read the recipe again, as every command will."""
    from PIL import Image

    from nacre.files import atomic_path

    clear_answers(folder, 0)  # maps of an earlier run under other names
    folder.mkdir(parents=True, exist_ok=True)
    write_maps(folder, picture.maps, {"nacre": __version__, "target": target.fingerprint})
    changes = {m.path: m.texture for m in picture.maps}
    path, files = write_recipe(folder, target.material, changes, {})
    with atomic_path(folder / REACHED) as temporary:
        Image.fromarray(np.round(255.0 * picture.reached).astype(np.uint8)).save(temporary)
    want, lamp = target.wants[0], target.spec.light.illuminants[0]
    asked, reached = (srgb_lab(rgb).mean(axis=(0, 1)) for rgb in (picture.asked, picture.reached))
    facts["files"] = [*files, *map_files(picture.maps), REACHED]
    return Solution(path, load(path), changes, [Reached(want, lamp, reached, asked, mean)], facts)


def _document(solution: Solution, target: Target) -> dict[str, Any]:
    want, worst = target.wants[0], solution.worst
    keys = ("de00_mean", "de00_median", "de00_99_percent", "de00_largest", "share_out_of_reach", "share_hue_kept")
    entry = {"at": str(want.at), "lamp": worst.lamp, "asked": want.asked, "within": want.within, "met": worst.is_met}
    entry |= {"de00": worst.distance, **{key: solution.facts[key] for key in keys}}
    rest = {key: value for key, value in solution.facts.items() if key not in keys}
    return {
        "recipe": str(solution.recipe),
        "worst": worst.scaled,
        "wants": [entry],
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
