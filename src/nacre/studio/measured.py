"""The report of the trade for the page: the numbers of `nacre report`, of one recipe or of two side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError
from nacre.light import ILLUMINANTS
from nacre.studio.folder import MAX_TEXT, Opened, build

MOST_RECIPES = 2


def read_recipes(body: Mapping[str, Any], opened: Opened) -> dict[str, Any]:
    """Return the question of a report: `recipes` with `text`, `path` and `fence`, and `lamp`.

    Raises:
        NacreError: not one recipe or two, or one outside the folder.
    """
    recipes = body.get("recipes")
    if not isinstance(recipes, list) or not 1 <= len(recipes) <= MOST_RECIPES:
        raise NacreError("a report takes one recipe or two")
    return {"lamp": read_lamp(body), "recipes": [placed(recipe, opened) for recipe in recipes]}


def read_lamp(body: Mapping[str, Any]) -> str:
    """Return the lamp that a question names, D65 where it names none.

    Raises:
        NacreError: it is not known.
    """
    lamp = body.get("lamp", "D65")
    if not isinstance(lamp, str) or lamp not in ILLUMINANTS:
        raise NacreError(f'lamp "{str(lamp)[:40]}" is not known')
    return lamp


def placed(recipe: Any, opened: Opened) -> dict[str, str]:
    """Return a recipe of the page with its file and the fence that holds for it.

    Raises:
        NacreError: it has no text or name, is too long, or leads outside the folder.
    """
    if not isinstance(recipe, dict) or not all(isinstance(recipe.get(key), str) for key in ("text", "name")):
        raise NacreError("a recipe needs text and name")
    if len(recipe["text"]) > MAX_TEXT:
        raise NacreError(f"{recipe['name'][:80]}: a recipe of {len(recipe['text'])} characters; at most {MAX_TEXT}")
    path, fence = opened.place(recipe["name"])
    return {"text": recipe["text"], "path": str(path), "fence": str(fence)}


def built(recipe: Mapping[str, str]) -> Any:
    """Return the material of a placed recipe.

    Raises:
        NacreError: the recipe is wrong, or reaches outside its fence.
    """
    path = Path(recipe["path"])
    return build(recipe["text"], path.name, path.parent, Path(recipe["fence"]))


def measured(question: Mapping[str, Any]) -> bytes:
    """Return the reports as JSON: `reports` with `colours` and `numbers`, and `differences` where there are two.

    Raises:
        NacreError: a material cannot be computed.
    """
    from nacre.analysis.html_report import report_json, report_numbers
    from nacre.analysis.report import make_report

    reports = [make_report(built(recipe), question["lamp"]) for recipe in question["recipes"]]
    told = report_json(reports)
    found: dict[str, Any] = {
        "reports": [
            {
                "colours": [{"kind": kind, **document[kind]} for kind in ("aspecular", "specular") if document[kind]],
                "numbers": report_numbers(report),
            }
            for report, document in zip(reports, told["reports"], strict=True)
        ]
    }
    if len(reports) > 1:
        found["differences"] = told["delta_e_2000_to_first"][0]
    return json.dumps(found).encode()
