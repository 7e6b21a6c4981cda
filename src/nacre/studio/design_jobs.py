"""Jobs for the page's design tab: inverse design, gamut, and colour scatter under manufacturing tolerances.

They correspond to `nacre design`, `nacre gamut` and `nacre tolerance` without folders and reports.
"""

from __future__ import annotations

import contextlib
import copy
import math
import os
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nacre import light
from nacre.analysis.tolerance import recipe_tolerances
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.families.contract import is_direct
from nacre.material.material import Material
from nacre.measure.evaluate import bsdf_spectrum
from nacre.optimise.evaluation import TargetResult, evaluate, geometries_of, lab_hex, nearest_in_ranges, results_of
from nacre.optimise.gamut import find_gamut, optimal_limits, srgb_limits
from nacre.optimise.measurement import search_wavelengths, simulate_measurement
from nacre.optimise.parameters import point_of, values_at
from nacre.optimise.problem import Budget
from nacre.optimise.run import choose_search, outcome
from nacre.optimise.solutions import Solution
from nacre.optimise.targets import Target
from nacre.optimise.task import DesignTask, read_task
from nacre.optimise.thin_film.adapter import ThinFilmSearch
from nacre.optimise.tolerances import allows, draw
from nacre.recipe.paths import find_by_path
from nacre.recipe.toml import dump_toml, parse_toml
from nacre.studio.edit import edited
from nacre.studio.folder import Incidence, OpenedFolder, built, read_lamp, read_number, read_recipe, spectrum_from
from nacre.studio.subprocess_jobs import Emit

WARM_UP_S = 0.05
PROGRESS_S, SOLUTION_S = 0.25, 0.6  # shortest time between two progress events; between two solutions
IMPROVEMENT = 0.99  # a better solution reduces the objective at least by this factor
MAX_EVALUATION_S = 0.5  # slower models are not evaluated during the search
FINAL_SHARE = 0.3  # share added to the search time for the final evaluation

GAMUT_POINTS, GAMUT_S = 400, 24.0  # totals for all angles
LOCAL_SHARE = 0.5  # time share for local search towards the targets
STEPS = (0.15, 0.08, 0.04, 0.02, 0.01, 0.005)  # standard deviations in local search, relative to the bounds
TRIES = 16  # trials with each step size
OUTLINE_POINTS = 72

FINE_DEG = np.array([*np.arange(0.0, 90.0, 5.0), 88.0])
QUICK_S = 0.05  # materials slower than this are sampled at few angles
COARSE_DEG, COARSE_NM = np.array([0.0, 20.0, 40.0, 60.0, 75.0, 88.0]), np.arange(400.0, 701.0, 25.0)
SCATTER_S, UPDATE_S = 20.0, 1.5  # time limit for all draws; interval between two events
MIN_DRAWS = 4


def design(request: Mapping[str, Any], emit: Emit) -> None:
    """Optimise; emit "begun", "progress", "solution" (the current best), then "final" for each solution and "ended".

    Raises:
        NacreError: the recipe, a bound or a target is invalid, or the geometry is not applicable.
    """
    task = task_of(request)
    search_spec = task.spec.search
    search = choose_search(task, search_spec.seed)
    if isinstance(search, ThinFilmSearch):
        search.run(Budget(seconds=WARM_UP_S))  # compiles before the time starts
    emit({"kind": "begun", "seconds": search_spec.seconds})
    budget = Budget(search_spec.evaluations or search.default_evaluations, search_spec.seconds)
    result = search.run(budget, _Progress(task, request, emit).update)
    best = result.solutions[: search_spec.solutions]
    solutions = []
    for _, changes in best:
        values = {path: rounded(value) for path, value in changes.items()}
        try:
            material = task.material.vary(values)
            seconds = FINAL_SHARE * search_spec.seconds / len(best)
            results, _ = evaluate(material, task.targets, task.spec.light, seed=search_spec.seed, seconds=seconds)
        except NacreError:
            continue
        solutions.append(Solution(None, material, values, results))
    if not solutions:
        raise NacreError("the recipe cannot be computed anywhere within its bounds")
    solutions.sort(key=lambda one: one.worst.scaled)
    for solution in solutions:
        emit({"kind": "final", **_document(solution.changes, solution.targets, task, request)})
    status = "interrupted" if result.status == "interrupted" else "met" if solutions[0].is_met else "out of reach"
    emit({"kind": "ended", "status": status, "message": outcome(solutions, status)})


class _Progress:
    """Emits search progress and the current best solution."""

    def __init__(self, task: DesignTask, request: Mapping[str, Any], emit: Emit) -> None:
        self._task, self._request, self._emit = task, request, emit
        self._rows = geometries_of(task.targets)
        self._start = time.monotonic()
        self._last_event = self._last_solution = -np.inf
        self._best = np.inf
        self._evaluation_s = 0.0
        self._cache: dict[Any, Any] = {}

    def update(self, worst: float, values: Mapping[str, Any]) -> None:
        """Handle a search callback."""
        now = time.monotonic() - self._start
        is_better = bool(values) and worst < IMPROVEMENT * self._best
        if is_better and now - self._last_solution > max(SOLUTION_S, 4.0 * self._evaluation_s):
            self._best, self._last_solution, self._last_event = worst, now, now
            values = {path: rounded(value) for path, value in values.items()}
            results = self._evaluate(values) if self._evaluation_s < MAX_EVALUATION_S else []
            document = _document(values, results, self._task, self._request)
            self._emit({"kind": "solution", "seconds": now, **document})
        elif now - self._last_event > PROGRESS_S:
            self._last_event = now
            self._emit({"kind": "progress", "seconds": now, "worst": worst if np.isfinite(worst) else None})

    def _evaluate(self, values: Mapping[str, Any]) -> list[TargetResult]:
        start = time.monotonic()
        spec = self._task.spec
        try:
            material = self._task.material.vary(values)
            grid = search_wavelengths(material, spec.light.illuminants)
            measurement = simulate_measurement(material, self._rows, grid, seed=spec.search.seed, memory=self._cache)
            return results_of(measurement, self._task.targets, spec.light)
        except NacreError:
            return []
        finally:
            self._evaluation_s = time.monotonic() - start


def _document(
    changes: Mapping[str, Any], results: list[TargetResult], task: DesignTask, request: Mapping[str, Any]
) -> dict[str, Any]:
    documents = [one.document(task.spec.light.observer) for one in results]
    targets = [
        {
            "geometry": each["geometry"],
            "target": each["asked_colour"],
            "reached": each["reached"]["colour"],
            "de00": round(each["de00"], 2),
            "met": each["met"],
        }
        for each in documents
    ]
    return {
        "changes": dict(changes),
        "targets": targets,
        "worst": max((each["de00"] for each in targets), default=None),
        "text": text_with(request["recipe"]["text"], task.material, changes),
    }


def text_with(text: str, material: Material, changes: Mapping[str, Any]) -> str:
    """Return the recipe's text with a solution; its comments remain, unless a change lies in a nested recipe.

    Raises:
        NacreError: a change cannot be written.
    """
    data = parse_toml(text, "recipe")
    try:
        for path in changes:
            holder, last = find_by_path(data, path, "recipe")
            holder[last]
    except (NacreError, KeyError, IndexError, TypeError):
        return dump_toml(dict(material.vary(changes).data))
    return edited(text, [{"path": path, "value": value} for path, value in changes.items()], "recipe")


def gamut(request: Mapping[str, Any], emit: Emit) -> None:
    """Emit "limits" (a*b* outlines of sRGB and optimal colours), then "gamut" for each angle.

    Raises:
        NacreError: the recipe, a bound or a target is invalid, or the material cannot be computed.
    """
    task, lamp = task_of(request), request["lamp"]
    white = light.white_xyz(lamp, OBSERVER)
    optimal = np.asarray(light.xyz_to_lab(optimal_limits(lamp, OBSERVER), white))
    emit({"kind": "limits", "srgb": _outline(srgb_limits(lamp, OBSERVER)), "optimal": _outline(optimal)})
    rows = geometries_of(task.targets)
    seconds = min(GAMUT_S, request["seconds"]) / len(rows)
    for row in rows:
        targets = [target for target in task.targets if target.geometry == row]
        start = time.monotonic()
        sampled = find_gamut(
            task.material, request["parameters"], str(row), points=GAMUT_POINTS,
            seconds=(1.0 - LOCAL_SHARE) * seconds, illuminant=lamp, observer=OBSERVER,
        )  # fmt: skip
        colour = _colour_function(task, row, lamp, white)
        labs = list(sampled.lab)
        results: list[dict[str, Any]] = []
        for target in targets:
            until = start + seconds * (1.0 - LOCAL_SHARE + LOCAL_SHARE * (len(results) + 1) / len(targets))
            new, distance = _local_search(task, target, sampled.lab, sampled.structures, colour, until)
            labs += new
            results.append({
                "lab": None if target.lab is None else np.round(target.lab, 2).tolist(), "target": target.asked,
                "distance": round(distance, 2), "inside": distance <= target.tolerance, "tolerance": target.tolerance,
            })  # fmt: skip
        points = [[*np.round(lab, 1).tolist(), lab_hex(lab, white)] for lab in labs]
        emit({
            "kind": "gamut", "geometry": str(row), "points": points, "targets": results,
            "share_of_srgb": sampled.share_of_srgb, "failed": sampled.failed,
        })  # fmt: skip


def _outline(solid: Array) -> list[list[float]]:
    turn = np.linspace(0.0, 2.0 * np.pi, OUTLINE_POINTS, endpoint=False)
    outermost = np.argmax(solid[:, 1:] @ np.stack([np.cos(turn), np.sin(turn)]), axis=0)
    return [[round(float(a), 1), round(float(b), 1)] for a, b in solid[outermost, 1:]]


def _colour_function(task: DesignTask, row: Any, lamp: str, white: Array) -> Callable[[Array], Array | None]:
    """Return a function from normalised parameters to Lab, or to None if they cannot be computed."""
    grid = search_wavelengths(task.material, [lamp])
    cache: dict[Any, Any] = {}

    def colour(place: Array) -> Array | None:
        try:
            material = task.material.vary(values_at(task.parameters, place))
            measurement = simulate_measurement(material, [row], grid, memory=cache)
        except NacreError:
            return None
        return np.asarray(
            light.xyz_to_lab(
                light.spectrum_to_xyz(measurement.factors[0], measurement.wavelengths_nm, lamp, OBSERVER), white
            )
        )

    return colour


def distance_to(target: Target, labs: Array) -> Array:
    """Return CIEDE2000 between colours `[n, 3]` and a target, for ranges the nearest colour within them."""
    if target.lab is not None:
        return np.asarray(light.delta_e_2000(labs, target.lab))
    ranges = target.ranges or {}
    return np.asarray(light.delta_e_2000(labs, np.array([nearest_in_ranges(lab, ranges) for lab in labs])))


def _local_search(
    task: DesignTask, target: Target, labs: Array, structures: list[dict[str, Any]],
    colour: Callable[[Array], Array | None], until: float,
) -> tuple[list[Array], float]:  # fmt: skip
    """Random local search from the nearest sample with decreasing steps; return the new colours and the distance."""
    distances = distance_to(target, labs)
    nearest = int(np.argmin(distances))
    best = float(distances[nearest])
    colours: list[Array] = []
    place = point_of(task.parameters, structures[nearest])
    generator = np.random.default_rng(0)
    for step in STEPS:
        for _ in range(TRIES):
            if place is None or best <= 0.5 * target.tolerance or time.monotonic() > until:
                return colours, best
            tried = np.clip(place + step * generator.standard_normal(len(place)), 0.0, 1.0)
            lab = colour(tried)
            if lab is None:
                continue
            distance = float(distance_to(target, lab[None])[0])
            if distance < best:
                best, place = distance, tried
                colours.append(lab)
    return colours, best


def tolerance(request: Mapping[str, Any], emit: Emit) -> None:
    """Emit "tolerance" as the sample grows: linear sRGB `rgb` `[draw, angle, 3]`, and dE00 to the nominal colour.

    The tolerances are the recipe's `[tolerance]`, and a percentage for every other layer thickness; colours are
    those under total reflection.

    Raises:
        NacreError: the recipe is invalid, lacks toleranced values, or cannot be computed.
    """
    material = inlined(built(request["recipe"])).at_low_fidelity()
    tolerances = recipe_tolerances(material, tolerance_options(material, request["percent"]))
    start = time.monotonic()
    lamp, draws, incidence = request["lamp"], request["draws"], Incidence(request["azimuth_deg"])
    angles, grid = _sampling(material, lamp, incidence)
    nominal = _reflected_xyz(material, angles, grid, lamp, incidence)
    generator = np.random.default_rng(0)
    values = draw(tolerances, generator, draws).values
    colours: list[Array] = []
    failed, last_event = 0, time.monotonic()

    def event() -> dict[str, Any]:
        return {
            "asked": draws,
            "failed": failed,
            "tolerances": len(tolerances),
            **_scatter(nominal, colours, angles, lamp),
        }

    for i in range(draws):
        try:
            varied = material.vary({path: float(drawn[i]) for path, drawn in values.items()})
            colours.append(_reflected_xyz(varied, angles, grid, lamp, incidence))
        except NacreError:
            failed += 1
        if time.monotonic() - start > SCATTER_S and len(colours) >= MIN_DRAWS:
            break
        if time.monotonic() - last_event > UPDATE_S and len(colours) >= MIN_DRAWS:
            last_event = time.monotonic()
            emit(event())
    if not colours:
        raise NacreError("no material within these tolerances can be computed")
    emit(event())


def tolerance_options(material: Material, percent: float) -> tuple[str, ...]:
    """Return `PATH=PERCENT%` for every layer thickness, else for every length, that `[tolerance]` does not name.

    Raises:
        NacreError: the recipe lacks lengths.
    """
    own = material.data.get("tolerance", {})
    numbers = [path for path, value in material.parameters.items() if value != 0.0]
    paths = [path for path in numbers if THICKNESS.search(path)] or [path for path in numbers if LENGTH.search(path)]
    if not paths and not own:
        raise NacreError(
            f"this {material.model.traits.noun} has no thickness or length; name other numbers under [tolerance]"
        )
    return tuple(f"{path}={percent:g}%" for path in paths if path not in own)


def _sampling(material: Material, lamp: str, incidence: Incidence) -> tuple[Array, Array | None]:
    """Return angles and wavelengths: few for slow families; the computer's speed affects only the angles."""
    if not material.model.traits.is_quick:
        return COARSE_DEG, COARSE_NM
    for _ in range(2):  # the first trial may compile
        start = time.monotonic()
        _reflected_xyz(material, FINE_DEG, None, lamp, incidence)
        duration = time.monotonic() - start
    return FINE_DEG if duration <= QUICK_S else COARSE_DEG, None


def _reflected_xyz(material: Material, angles_deg: Array, grid: Array | None, lamp: str, incidence: Incidence) -> Array:
    """Return XYZ of the total reflected light under the lamp, `[angle, 3]`."""
    theta = np.radians(angles_deg)
    spectrum = spectrum_from(material, theta, grid, incidence)
    if spectrum is None:
        spectrum = bsdf_spectrum(material.bsdf(grid), theta)
    parts = spectrum.parts()
    total = sum(np.nan_to_num(parts[name]) for name in ("specular_reflectance", "diffuse_reflectance") if name in parts)
    return np.asarray(light.spectrum_to_xyz(total, spectrum.wavelengths_nm, lamp))


def _scatter(nominal: Array, colours: list[Array], angles: Array, lamp: str) -> dict[str, Any]:
    white = light.white_xyz(lamp)
    xyz = np.stack(colours)
    rgb = light.xyz_to_srgb_linear(light.adapt_xyz(xyz, white, light.SRGB_WHITE_XYZ))
    distance = np.asarray(light.delta_e_2000(light.xyz_to_lab(nominal, white), light.xyz_to_lab(xyz, white)))
    return {
        "kind": "tolerance",
        "angles": angles.tolist(),
        "rgb": np.round(rgb, 5).tolist(),
        "median": np.round(np.median(distance, axis=0), 2).tolist(),
        "percentile_95": np.round(np.percentile(distance, 95, axis=0), 2).tolist(),
    }


# Design requests: target colours, and the parameters with their bounds.

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
    """Return a material with its nested recipes inlined as tables, so that their numbers have paths."""
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
    full = inlined(material)
    numbers = list(full.parameters.items())[:MAX_LISTED]
    selected = [path for path, _ in numbers if THICKNESS.search(path) and "[" in path]  # layers
    selected = selected or [path for path, _ in numbers if LENGTH.search(path)]
    listed = []
    for path, value in numbers:
        if path.rpartition(".")[2] in OPTICAL_CONSTANTS or not math.isfinite(value) or value == 0.0:
            continue
        bounds = _bounds(full, path, value)
        if bounds is None:
            continue
        holder, _ = find_by_path(full.data, path, full.context.source)
        about = holder.get("material") if isinstance(holder, Mapping) else None
        listed.append({
            "path": path, "value": value, "low": bounds[0], "high": bounds[1],
            "about": about if isinstance(about, str) else "", "selected": path in selected,
        })  # fmt: skip
    document: dict[str, Any] = {"geometry": _default_geometry(material), "parameters": listed}
    if not listed:
        document["refused"] = (
            f"this {material.model.traits.noun} has no variable number; [parameters] of the command also takes text"
        )
    return document


def _default_geometry(material: Material) -> str:
    """Return the family's default geometry, or "aspecular" without specular reflection.

    Raises:
        NacreError: the material cannot be computed.
    """
    model = material.model
    geometry = model.traits.default_geometry.split()[0]
    if geometry not in GEOMETRIES or model.traits.is_quick or is_direct(model):
        return geometry if geometry in GEOMETRIES else "aspecular"
    spectrum = model.spectrum(np.array([0.0]), PROBE_NM, "both", 0)  # None: it scatters and would have to be solved
    return geometry if spectrum is not None and spectrum.specular_reflectance is not None else "aspecular"


def _bounds(material: Material, path: str, value: float) -> tuple[float, float] | None:
    """Return allowed bounds, half to twice the value and for a layer from 5 nm, if there are any."""
    unit = THICKNESS.search(path)
    lows = [share * value for share in LOWER_FACTORS]
    if unit and MIN_LAYER_NM < value * IN_NM[unit[1]] <= MAX_FILM_NM:
        lows.insert(0, MIN_LAYER_NM / IN_NM[unit[1]])
    low = next((end for end in lows if allows(material, path, end)), value)
    high = next((share * value for share in UPPER_FACTORS if allows(material, path, share * value)), value)
    low, high = sorted((low, high))
    return (rounded(low), rounded(high)) if low < high else None


def rounded(value: Any) -> Any:
    """Round a float to six digits, as it is written into the recipe; return other values unchanged."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def task_of(request: Mapping[str, Any]) -> DesignTask:
    """Return the validated design task; changes the current folder to the recipe's.

    Raises:
        NacreError: the recipe is invalid or reads a file outside its fence, or cannot be designed for these targets.
    """
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
