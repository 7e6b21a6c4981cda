"""Design requests: target colours, and the parameters with their bounds."""

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
from nacre.studio.folder import OpenedFolder, built, read_lamp, read_number, read_recipe

if TYPE_CHECKING:
    from nacre.optimise.task import DesignTask

GEOMETRIES = ("specular", "transmitted", "diffuse", "hemispherical", "aspecular")
OBSERVER = "2deg"
MAX_TARGETS, MAX_PARAMETERS, MAX_LISTED = 24, 80, 200
SECONDS, SOLUTIONS = (2.0, 600.0), (1, 6)
MIN_LAYER_NM = 5.0
MAX_FILM_NM = 5000.0  # thicker layers are coats, which are never a few nanometres thick
THICKNESS = re.compile(r"thickness_(nm|um|mm)$")
LENGTH = re.compile(r"_(nm|um)$")
IN_NM = {"nm": 1.0, "um": 1e3, "mm": 1e6}
OPTICAL_CONSTANTS = ("n", "k")
PROBE_NM = np.array([450.0, 550.0, 650.0])
UPPER_FACTORS, LOWER_FACTORS = (2.0, 1.5, 1.2, 1.05), (0.5, 0.7, 0.9, 0.97)  # the first allowed one gives the bound
RELIEF_REFUSED = (
    "the heights of a relief are designed by the command: nacre design TARGET with heights under [parameters], "
    "or the target picture under [target]"
)


def read_design(body: Mapping[str, Any], opened: OpenedFolder) -> dict[str, Any]:
    """Return a validated design request: `recipe`, `lamp`, `targets`, `parameters`, `seconds`, `solutions`.

    Raises:
        NacreError: a value is not allowed.
    """
    lamp, geometry = read_lamp(body), body.get("geometry", "specular")
    if geometry not in GEOMETRIES:
        raise NacreError(f'geometry "{str(geometry)[:40]}" is not known; choose from {", ".join(GEOMETRIES)}')
    targets, parameters = body.get("targets"), body.get("parameters")
    if not isinstance(targets, list) or not 1 <= len(targets) <= MAX_TARGETS:
        raise NacreError(f"a design takes 1 to {MAX_TARGETS} target colours")
    if not isinstance(parameters, list) or not 1 <= len(parameters) <= MAX_PARAMETERS:
        raise NacreError(f"a design takes 1 to {MAX_PARAMETERS} parameters; tick the ones that may change")
    return {
        "recipe": read_recipe(body, opened),
        "lamp": lamp,
        "targets": [_target(target, geometry, f"colour {i + 1}") for i, target in enumerate(targets)],
        "parameters": dict(_parameter(entry) for entry in parameters),
        "seconds": read_number(body.get("seconds", 20), "seconds", *SECONDS),
        "solutions": int(read_number(body.get("solutions", 4), "solutions", *SOLUTIONS)),
    }


def _target(target: Any, geometry: str, name: str) -> dict[str, Any]:
    if not isinstance(target, dict):
        raise NacreError(f"{name} is not a table")
    limits = (-40.0, 110.0) if geometry == "aspecular" else (0.0, 89.0)
    angle = read_number(target.get("angle"), f"{name}: angle", *limits)
    made: dict[str, Any] = {"geometry": f"45as{angle:g}" if geometry == "aspecular" else f"{geometry} {angle:g}"}
    made["tolerance"] = read_number(target.get("tolerance", 2.0), f"{name}: tolerance", 0.1, 50.0)
    if "hue" not in target:
        colour = target.get("colour")
        if not isinstance(colour, str) or not re.fullmatch(r"#[0-9a-fA-F]{6}", colour):
            raise NacreError(f'{name}: "{str(colour)[:20]}" should be written "#rrggbb"')
        return {**made, "colour": colour}
    hue = read_number(target["hue"], f"{name}: hue", 0.0, 360.0)
    span = read_number(target.get("span", 12), f"{name}: span", 1.0, 90.0)
    chroma = read_number(target.get("chroma", 20), f"{name}: chroma", 0.0, 150.0)
    return {**made, "hue_deg": [(hue - span) % 360.0, (hue + span) % 360.0], "chroma": f">={chroma:g}"}


def _parameter(entry: Any) -> tuple[str, list[float]]:
    if not isinstance(entry, dict) or not isinstance(entry.get("path"), str):
        raise NacreError("a parameter has path, low and high")
    ends: list[Any] = [entry.get("low"), entry.get("high")]
    if not all(type(end) in (int, float) and math.isfinite(end) for end in ends):
        raise NacreError(f"{entry['path'][:80]}: both bounds should be numbers")
    return entry["path"], [float(end) for end in ends]


def inlined(material: Material) -> Material:
    """Return a material whose nested recipes stand in it as tables, so that their numbers have paths."""
    for key, value in material.data.items():
        if isinstance(value, Mapping) and "recipe" in value:
            with contextlib.suppress(RecipeError):  # some parts can only be given by name
                material = material.with_parts_loaded([f"{key}.family"])
    return material


def list_parameters(material: Material) -> dict[str, Any]:
    """Return the possible `parameters`, each with `path`, `value`, `low`, `high`, `about` and whether it is `selected`
    by default, the default `geometry`, and `refused`, a message, if the page cannot design this material.

    Raises:
        NacreError: the material cannot be computed.
    """
    if "heights" in material.data:
        return {"geometry": GEOMETRIES[0], "parameters": [], "refused": RELIEF_REFUSED}
    whole = inlined(material)
    numbers = list(whole.parameters.items())[:MAX_LISTED]
    selected = [path for path, _ in numbers if THICKNESS.search(path) and "[" in path]  # layers
    selected = selected or [path for path, _ in numbers if LENGTH.search(path)]
    listed = []
    for path, value in numbers:
        if path.rpartition(".")[2] in OPTICAL_CONSTANTS or not math.isfinite(value) or value == 0.0:
            continue
        bounds = _bounds(whole, path, value)
        if bounds is None:
            continue
        holder, _ = find_by_path(whole.data, path, whole.context.source)
        about = holder.get("material") if isinstance(holder, Mapping) else None
        listed.append({
            "path": path, "value": value, "low": bounds[0], "high": bounds[1],
            "about": about if isinstance(about, str) else "", "selected": path in selected,
        })  # fmt: skip
    found: dict[str, Any] = {"geometry": _default_geometry(material), "parameters": listed}
    if not listed:
        found["refused"] = (
            f"this {material.model.traits.noun} has no variable number; [parameters] of the command also takes text"
        )
    return found


def _default_geometry(material: Material) -> str:
    """Return the family's default geometry, or "aspecular" without specular reflection.

    Raises:
        NacreError: the material cannot be computed.
    """
    model = material.model
    geometry = model.traits.default_geometry.split()[0]
    if geometry not in GEOMETRIES or model.traits.is_quick or is_direct(model):
        return geometry if geometry in GEOMETRIES else "aspecular"
    found = model.spectrum(np.array([0.0]), PROBE_NM, "both", 0)  # None: it scatters and would have to be solved
    return geometry if found is not None and found.specular_reflectance is not None else "aspecular"


def _bounds(material: Material, path: str, value: float) -> tuple[float, float] | None:
    """Return allowed bounds, half to twice the value and for a layer from 5 nm, if there are any."""
    unit = THICKNESS.search(path)
    lows = [share * value for share in LOWER_FACTORS]
    if unit and MIN_LAYER_NM < value * IN_NM[unit[1]] <= MAX_FILM_NM:
        lows.insert(0, MIN_LAYER_NM / IN_NM[unit[1]])
    low = next((end for end in lows if _is_allowed(material, path, end)), value)
    high = next((share * value for share in UPPER_FACTORS if _is_allowed(material, path, share * value)), value)
    low, high = sorted((low, high))
    return (rounded(low), rounded(high)) if low < high else None


def rounded(value: Any) -> Any:
    """Round a float to six digits, as it is written into the recipe; return other values unchanged."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _is_allowed(material: Material, path: str, value: float) -> bool:
    try:
        material.vary({path: value})
    except NacreError:
        return False
    return True


def task_of(request: Mapping[str, Any]) -> DesignTask:
    """Return the validated design task; changes the current folder to the recipe's.

    Raises:
        NacreError: the recipe is invalid or reads a file outside its fence, or cannot be designed for these targets.
    """
    from nacre.optimise.task import read_task

    material = built(request["recipe"])  # applies the fence before any file is read
    if "heights" in material.data:
        raise UnsupportedError(RELIEF_REFUSED)
    os.chdir(Path(request["recipe"]["path"]).parent)
    data = {
        "recipe": copy.deepcopy(dict(inlined(material).data)),
        "parameters": request["parameters"],
        "target": request["targets"],
        "light": {"illuminants": [request["lamp"]], "observer": OBSERVER},
        "search": {"seconds": request["seconds"], "solutions": request["solutions"]},
    }
    try:
        return read_task(data)
    except NacreError as error:
        raise NacreError(str(error).removeprefix("target: ")) from None
