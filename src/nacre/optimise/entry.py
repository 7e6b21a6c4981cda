"""`nacre.design(target, out)`: a relief for a target of directions, or anything else for a target of wants."""

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

DICTIONARY = "target"  # the folder's name where the target has none


def run(
    target: str | Path | Mapping[str, Any],
    out: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Any], None] | None = None,
    jobs: int | None = None,
) -> Any:
    """Design what a target asks for; the best so far is always on disk.

    Args:
        target: a TOML file with `[[target]]` (any family) or with `[target]` (a relief), the name of an example, or a
            dictionary of the former.
        out: the folder, made if it does not exist; default: the target's name.
        resume: go on where a stopped run of the same target ended.
        progress: called while the search runs, from worker threads where it has some, one at a time.
        jobs: threads of a relief's search; default: all cores.

    Returns:
        a `Design` with its solutions, or a relief's `DesignResult`; both have `folder` and `summary`.

    Raises:
        RecipeError: the target is not usable.
        NacreError: the folder cannot be written, or holds the search of another target.

    Example: `nacre.design("violet.toml", "violet").best.targets[0].distance`.
    """
    if not isinstance(target, Mapping):
        target = resolve_recipe_path(named(target))
    check_room(out if out is not None else DICTIONARY if isinstance(target, Mapping) else target.stem, NEED_BYTES)
    data = target if isinstance(target, Mapping) else parse_toml(read_text(target, "target"), str(target))
    if is_design_task(data) and is_relief_task(data):
        from nacre.optimise.relief.adapter import run_relief as run_heights

        return run_heights(target, out, resume=resume, progress=progress, jobs=jobs)
    if isinstance(target, Mapping) or is_design_task(data):
        from nacre.optimise.run import run as run_wants

        return run_wants(target, out, resume=resume, progress=progress)
    if "target" not in data and "family" in data:
        raise RecipeError(
            f'{target}: is a recipe; write a target with recipe = "{Path(target).name}", [parameters] and [[target]] '
            "(nacre keys design)"
        )
    if "target" not in data:
        raise RecipeError(f"{target}: says no look; add [[target]] tables (nacre keys design), or [target] of a relief")
    from nacre.optimise.relief.run import run as run_relief

    return run_relief(target, Path(target).stem if out is None else out, resume, progress, jobs)


__all__ = ["run"]
