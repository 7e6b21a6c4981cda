"""`nacre.design(target, out)`: dispatch of target files to the design of reliefs or of other materials."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nacre.core.errors import RecipeError
from nacre.core.files import check_room, named, read_text
from nacre.material.examples import resolve_recipe_path
from nacre.optimise.solutions import NEED_BYTES
from nacre.optimise.task import is_design_task, is_relief_task
from nacre.recipe.toml import parse_toml

DICTIONARY = "target"  # folder name for a dictionary


def run(
    target: str | Path | Mapping[str, Any],
    out: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Any], None] | None = None,
    jobs: int | None = None,
) -> Any:
    """Design a material for a target; the best solution so far is always on disk.

    Args:
        target: a TOML file with `[[target]]` (any family) or with `[target]` (a relief), the name of an example, or a
            dictionary of the former.
        out: folder, created if it does not exist; default: the target name.
        resume: continue a stopped run of the same target.
        progress: called during the search, one call at a time, possibly from worker threads.
        jobs: threads of a relief search; default: all cores.

    Returns:
        a `Design`, or the `DesignResult` of a relief; both have `folder` and `summary`.

    Raises:
        RecipeError: the target is invalid.
        NacreError: the folder cannot be written, or holds another target's search.

    Example: `nacre.design("violet.toml", "violet").best.targets[0].distance`.
    """
    if not isinstance(target, Mapping):
        target = resolve_recipe_path(named(target))
    check_room(out if out is not None else DICTIONARY if isinstance(target, Mapping) else target.stem, NEED_BYTES)
    data = target if isinstance(target, Mapping) else parse_toml(read_text(target, "target"), str(target))
    if is_design_task(data) and is_relief_task(data):
        from nacre.optimise.relief.adapter import run_relief as run_relief_task

        return run_relief_task(target, out, resume=resume, progress=progress, jobs=jobs)
    if isinstance(target, Mapping) or is_design_task(data):
        from nacre.optimise.run import run as run_design

        return run_design(target, out, resume=resume, progress=progress)
    if "target" not in data and "family" in data:
        raise RecipeError(
            f'{target}: is a recipe; write a target with recipe = "{Path(target).name}", [parameters] and [[target]] '
            "(nacre keys design)"
        )
    if "target" not in data:
        raise RecipeError(
            f"{target}: has no targets; add [[target]] tables (nacre keys design), or [target] of a relief"
        )
    from nacre.optimise.relief.run import run as run_relief

    return run_relief(target, Path(target).stem if out is None else out, resume, progress, jobs)
