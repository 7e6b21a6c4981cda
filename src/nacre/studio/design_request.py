"""What the page asks of a design: the looks that are wanted, the numbers that may change and their bounds."""

from __future__ import annotations

import contextlib
import copy
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.families.contract import is_direct
from nacre.material.material import Material
from nacre.recipe.paths import find_by_path
from nacre.studio.folder import Opened
from nacre.studio.measured import built, placed, read_lamp

if TYPE_CHECKING:
    from nacre.optimise.task import DesignTask

LOOKS = ("specular", "transmitted", "diffuse", "hemispherical", "aspecular")
OBSERVER = "2deg"  # as all colours of the page
MOST_WANTS, MOST_FREE, MOST_LISTED = 24, 80, 200
SECONDS, SOLUTIONS = (2.0, 600.0), (1, 6)
LEAST_NM = 5.0  # of a layer that is free, as of layers that are sought
THICKEST_NM = 5000.0  # of a layer that interferes; thicker ones are coats, which no one makes of some nanometres
THICKNESS = re.compile(r"thickness_(nm|um|mm)$")
LENGTH = re.compile(r"_(nm|um)$")
IN_NM = {"nm": 1.0, "um": 1e3, "mm": 1e6}
OF_OPTICS = ("n", "k")
PROBE_NM = np.array([450.0, 550.0, 650.0])
UPWARD, DOWNWARD = (2.0, 1.5, 1.2, 1.05), (0.5, 0.7, 0.9, 0.97)  # times a number: bounds, the first that are allowed
OF_HEIGHTS = (
    "a relief's heights are sought by the command: nacre design TARGET with heights under [parameters], "
    "or the picture that is wanted under [target]"
)


def read_design(body: Mapping[str, Any], opened: Opened) -> dict[str, Any]:
    """Return the bounded question of a design: `recipe`, `lamp`, `wants`, `free`, `seconds`, `solutions`.

    Raises:
        NacreError: a value that is not allowed, in one line.
    """
    lamp, look = read_lamp(body), body.get("look", "specular")
    if look not in LOOKS:
        raise NacreError(f'"{str(look)[:40]}" is no way to see it; choose from {", ".join(LOOKS)}')
    wants, free = body.get("wants"), body.get("free")
    if not isinstance(wants, list) or not 1 <= len(wants) <= MOST_WANTS:
        raise NacreError(f"a design takes 1 to {MOST_WANTS} wanted colours")
    if not isinstance(free, list) or not 1 <= len(free) <= MOST_FREE:
        raise NacreError(f"a design takes 1 to {MOST_FREE} free numbers; tick what may change")
    return {
        "recipe": placed(body, opened),
        "lamp": lamp,
        "wants": [_want(want, look, f"colour {i + 1}") for i, want in enumerate(wants)],
        "free": dict(_free(entry) for entry in free),
        "seconds": number(body.get("seconds", 20), "seconds", *SECONDS),
        "solutions": int(number(body.get("solutions", 4), "solutions", *SOLUTIONS)),
    }


def number(value: Any, name: str, low: float, high: float) -> float:
    """Return a number within its bounds.

    Raises:
        NacreError: it is none, or beyond them.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise NacreError(f"{name} = {str(value)[:20]} is not allowed; it should be from {low:g} to {high:g}")
    return float(value)


def _want(want: Any, look: str, name: str) -> dict[str, Any]:
    if not isinstance(want, dict):
        raise NacreError(f"{name} is not a table")
    angle = number(want.get("at"), f"{name}: angle", *((-40.0, 110.0) if look == "aspecular" else (0.0, 89.0)))
    made: dict[str, Any] = {"geometry": f"45as{angle:g}" if look == "aspecular" else f"{look} {angle:g}"}
    made["tolerance"] = number(want.get("within", 2.0), f"{name}: within", 0.1, 50.0)
    if "hue" not in want:
        colour = want.get("colour")
        if not isinstance(colour, str) or not re.fullmatch(r"#[0-9a-fA-F]{6}", colour):
            raise NacreError(f'{name}: "{str(colour)[:20]}" should be written "#rrggbb"')
        return {**made, "colour": colour}
    hue, span = (
        number(want["hue"], f"{name}: hue", 0.0, 360.0),
        number(want.get("span", 12), f"{name}: span", 1.0, 90.0),
    )
    chroma = number(want.get("chroma", 20), f"{name}: chroma", 0.0, 150.0)
    return {**made, "hue_deg": [(hue - span) % 360.0, (hue + span) % 360.0], "chroma": f">={chroma:g}"}


def _free(entry: Any) -> tuple[str, list[float]]:
    if not isinstance(entry, dict) or not isinstance(entry.get("path"), str):
        raise NacreError("a free number has path, low and high")
    ends: list[Any] = [entry.get("low"), entry.get("high")]
    if not all(type(end) in (int, float) and math.isfinite(end) for end in ends):
        raise NacreError(f"{entry['path'][:80]}: both bounds should be numbers")
    return entry["path"], [float(end) for end in ends]


def opened_parts(material: Material) -> Material:
    """Return a material whose recipes inside the recipe stand in it as tables, so that their numbers can be named."""
    for key, value in material.data.items():
        if isinstance(value, Mapping) and "recipe" in value:
            with contextlib.suppress(RecipeError):  # a part that may only be named keeps its name
                material = material.with_parts_loaded([f"{key}.family"])
    return material


def free_numbers(material: Material) -> dict[str, Any]:
    """Return what may be free: `numbers`, each with `path`, `value`, `low`, `high`, `about` and whether it is `free`
    unless told, and the `look` that the family is asked in; `refused`, in one line, where nothing can be designed here.

    Raises:
        NacreError: the material cannot be computed.
    """
    if "heights" in material.data:
        return {"look": LOOKS[0], "numbers": [], "refused": OF_HEIGHTS}
    found: dict[str, Any] = {"look": _usual_look(material), "numbers": []}
    whole = opened_parts(material)
    numbers = list(whole.parameters.items())[:MOST_LISTED]
    by_default = [path for path, _ in numbers if THICKNESS.search(path) and "[" in path]  # of layers
    by_default = by_default or [path for path, _ in numbers if LENGTH.search(path)]
    for path, value in numbers:
        if path.rpartition(".")[2] in OF_OPTICS or not math.isfinite(value) or value == 0.0:
            continue
        bounds = _bounds(whole, path, value)
        if bounds is None:
            continue
        holder, _ = find_by_path(whole.data, path, whole.context.source)
        about = holder.get("material") if isinstance(holder, Mapping) else None
        found["numbers"].append({
            "path": path, "value": value, "low": bounds[0], "high": bounds[1],
            "about": about if isinstance(about, str) else "", "free": path in by_default,
        })  # fmt: skip
    if not found["numbers"]:
        found["refused"] = (
            f"this {material.model.traits.noun} has no number that can vary; the command also varies words"
        )
    return found


def _usual_look(material: Material) -> str:
    """Return the way of seeing that shows a material's colour: its family's, unless it has no mirror of its own.

    Raises:
        NacreError: the material cannot be computed.
    """
    model = material.model
    word = model.traits.default_geometry.split()[0]
    if word not in LOOKS or model.traits.is_quick or is_direct(model):
        return word if word in LOOKS else "aspecular"
    found = model.spectrum(np.array([0.0]), PROBE_NM, "both", 0)  # None: all of it would have to be solved; it scatters
    return word if found is not None and found.specular_reflectance is not None else "aspecular"


def _bounds(material: Material, path: str, value: float) -> tuple[float, float] | None:
    """Return bounds that the recipe allows: half to twice a number, of a layer from 5 nm; None where there are none."""
    unit = THICKNESS.search(path)
    lows = [share * value for share in DOWNWARD]
    if unit and LEAST_NM < value * IN_NM[unit[1]] <= THICKEST_NM:
        lows.insert(0, LEAST_NM / IN_NM[unit[1]])
    low = next((end for end in lows if _is_allowed(material, path, end)), value)
    high = next((share * value for share in UPWARD if _is_allowed(material, path, share * value)), value)
    low, high = sorted((low, high))
    return (short(low), short(high)) if low < high else None


def short(value: float) -> float:
    """Return a number as one writes it: what an answer is told with, loaded with and measured with."""
    return float(f"{value:.6g}")


def _is_allowed(material: Material, path: str, value: float) -> bool:
    try:
        material.vary({path: value})
    except NacreError:
        return False
    return True


def target_of(question: Mapping[str, Any]) -> DesignTask:
    """Return the checked target of a question; the current folder becomes the recipe's.

    Raises:
        NacreError: the recipe is wrong or reaches outside its fence, or the material cannot answer.
    """
    from nacre.optimise.task import read_task

    material = built(question["recipe"])  # with its fence, before anything is read without one
    if "heights" in material.data:
        raise UnsupportedError(OF_HEIGHTS)
    os.chdir(Path(question["recipe"]["path"]).parent)
    data = {
        "recipe": copy.deepcopy(dict(opened_parts(material).data)),
        "parameters": question["free"],
        "target": question["wants"],
        "light": {"illuminants": [question["lamp"]], "observer": OBSERVER},
        "search": {"seconds": question["seconds"], "solutions": question["solutions"]},
    }
    try:
        return read_task(data)
    except NacreError as error:
        raise NacreError(str(error).removeprefix("target: ")) from None
