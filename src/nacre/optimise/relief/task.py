"""Read and check targets of a relief: pictures over directions and colours, for the gradient search over all heights.

A target picture over directions is a view of that search; a target colour at one pair of directions is a small uniform
view. The search works with display values under D65; the solution's colours are then evaluated as for any family.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nacre.core.arrays import Array, direction
from nacre.core.errors import RecipeError
from nacre.core.files import atomic_path, output_folder, read_text, write_text
from nacre.families.relief.diffraction_orders import coating_reflectance
from nacre.families.relief.plane_cut import CutGeometry
from nacre.families.relief.surface import largest_depth_nm
from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, lab_to_xyz, white_xyz, xyz_to_srgb_linear
from nacre.material.material import Material, load
from nacre.optimise.evaluation import TargetResult
from nacre.optimise.relief.merit import GAMMA, Problem, View, default_weights
from nacre.optimise.relief.target import LARGEST_TILE_FEATURES, TargetSpec
from nacre.optimise.solutions import RECIPE, Solution
from nacre.optimise.spec import DesignSpec, LightSpec
from nacre.optimise.targets import Target, read_targets
from nacre.optimise.task import Task, task_geometries
from nacre.recipe.fingerprint import fingerprint
from nacre.recipe.model import RecipeContext, show_value, validate
from nacre.recipe.toml import dump_toml, parse_toml

HEIGHTS, FEATURES = "heights", "features"
HEIGHT_FILE = "height.npy"
KNOWN_IN = {"tolerance": {HEIGHTS}, "limits": {"within_validity"}}  # keys of these tables that apply to relief heights
PATCH_SINE, PATCH_COUNT = 0.01, 8  # half side and samples per side for the uniform view around a colour
PICTURE_SHARE = 4  # ratio between picture and colour samples per side
RECIPE_KEYS = ("feature_um", "blur_um", "coating", "prefactor", "coherence")
FAMILY = "relief"


@dataclass(frozen=True)
class ReliefTask(Task):
    """Checked relief target.

    Attributes:
        spec: gradient search target.
        problem: design problem.
        asked: the whole target of a file with `[[target]]`.
        targets: target colours at directions.
    """

    spec: TargetSpec
    problem: Problem
    asked: DesignSpec | None = None
    targets: tuple[Target, ...] = ()

    image_kind: ClassVar[str] = ""

    @property
    def seconds(self) -> float:
        """Time limit."""
        return np.inf if self.spec.search.seconds is None else self.spec.search.seconds

    @property
    def evaluations(self) -> float:
        """Limit of evaluations."""
        return np.inf if self.asked is None else self.asked.search.evaluations or np.inf

    @property
    def light(self) -> LightSpec:
        """Lamps and observer of the colours."""
        return LightSpec() if self.asked is None else self.asked.light

    def with_targets(self, targets: tuple[Target, ...]) -> ReliefTask:
        """Return the task with other colours at the same directions."""
        pictures = self.problem.views[: len(self.problem.views) - len(self.targets)]
        problem = _with_colours(replace(self.problem, views=pictures), self.spec, targets, self.light)
        return replace(self, targets=targets, problem=problem)

    def read(self, folder: Path, changes: Mapping[str, Any]) -> Material:
        """Return the material of a solution in a folder."""
        return load(folder / RECIPE)

    def solution(
        self, changes: dict[str, Any], results: list[TargetResult], facts: dict[str, Any], folder: Path | None
    ) -> Solution:
        """Return a solution, with its heights and recipe written to the folder, which a relief needs.

        Raises:
            NacreError: the folder cannot be written.
        """
        assert folder is not None  # checked before the search
        with output_folder(folder):
            self.write_heights(folder, changes[HEIGHTS])
        recipe, facts = folder / RECIPE, {**facts, "files": [RECIPE, HEIGHT_FILE]}
        return Solution(recipe, load(recipe), {}, results, facts)

    def write_heights(self, folder: Path, heights_um: Array) -> None:
        """Write height.npy and recipe.toml atomically."""
        spec = self.spec
        with atomic_path(folder / HEIGHT_FILE) as temporary, temporary.open("wb") as stream:
            np.save(stream, heights_um)
        coating = spec.coating.model_dump(exclude_none=True, exclude_defaults=True)
        data: dict[str, Any] = {
            "family": FAMILY,
            "heights": HEIGHT_FILE,
            "periodic": True,
            "feature_um": spec.feature_um,
            "blur_um": spec.blur_um,
            "coating": coating["name"] if set(coating) == {"name"} else coating,
            "prefactor": spec.chosen_prefactor,
            "coherence": spec.coherence.model_dump(exclude_none=True),
        }
        if spec.search.refine is not None:
            del data["prefactor"]  # a key of scalar theory only
            data["model"] = {"optics": spec.search.refine}
        write_text(folder / RECIPE, dump_toml(data))

    @property
    def fingerprint(self) -> str:
        """Hash of everything that defines the task, without the time limit."""
        views = [self.problem.target]  # with the views' directions, which colour targets define
        for view in self.problem.views:
            views += [view.geometry.psi_x, view.geometry.psi_y, view.geometry.wi]
        target = hashlib.sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in views)).hexdigest()
        return fingerprint(self.spec.model_dump(exclude={"search": {"seconds"}}), self.context.files, target=target)

    @property
    def pictures(self) -> list[dict[str, Any]]:
        """The pictures over directions, as in the file."""
        tables = [self.spec.target, *self.spec.targets]
        if self.asked is not None:
            tables = [target.directions for target in self.asked.target if target.directions is not None]
        return [table.model_dump(exclude_none=True, exclude_defaults=True) for table in tables]


def read_relief(data: Mapping[str, Any], context: RecipeContext) -> ReliefTask:
    """Check a target with one `[target]`, or with free heights.

    Raises:
        RecipeError: with file, key, value and allowed values.
    """
    if isinstance(data.get("target"), Mapping):
        if data.get("family", FAMILY) != FAMILY:
            allowed = 'cannot be designed by gradient; targets are for family = "relief"'
            raise context.fail("family", data["family"], allowed)
        only: TargetSpec = validate(TargetSpec, dict(data), context)
        return ReliefTask(only, context, only.build(context))
    spec: DesignSpec = validate(DesignSpec, copy.deepcopy(dict(data)), context)
    source = context.source
    recipe = _recipe(spec, context)
    height_um, features = _bounds(spec, source)
    for name in ("layers", "tolerance", "limits"):
        value = data.get(name)
        if value and not (name in KNOWN_IN and set(value) <= KNOWN_IN[name]):
            raise RecipeError(f"{source}: [{name}] has keys that do not apply to a relief whose heights are optimised")
    places = [f"target[{i}].directions" for i, target in enumerate(spec.target) if target.directions]
    pictures = [target.directions for target in spec.target if target.directions]
    named = task_geometries(spec, recipe, context)
    colours = tuple(
        replace(read_targets([target], spec.light, context, named)[0], key=f"{source}: target[{i}]")
        for i, target in enumerate(spec.target)
        if target.directions is None
    )
    for target in colours:
        _check_colour(target)
    if colours and pictures and pictures[0].intensity_scale == "free":
        raise RecipeError(
            f'{source}: {places[0]}.intensity_scale = "free" with a colour at "{colours[0].geometry}"; '
            f"give the brightness as a number, with {np.pi:.4g} for that of a white of pi f = 1"
        )
    data = {
        "family": FAMILY,
        "features": features,
        "height_max_um": height_um,
        **{key: recipe[key] for key in RECIPE_KEYS if key in recipe},
        # the table is required; without a picture its view is not used
        "target": pictures[0] if pictures else {"kind": "uniform", "range": PATCH_SINE},
        "targets": tuple(pictures[1:]),
        "search": {"seconds": spec.search.seconds, "seed": spec.search.seed, "noise": _noise(spec, source)},
    }
    relief: TargetSpec = validate(TargetSpec, data, context)
    if spec.limits.within_validity:
        highest_um = largest_depth_nm(1e3 * relief.feature_um) / 1e3
        relief = relief.model_copy(update={"height_max_um": min(relief.height_max_um, highest_um)})
    try:
        problem = relief.build(context)
    except RecipeError as error:
        place = places[0] if len(places) == 1 else "target[...].directions"
        raise RecipeError(str(error).replace(f"{source}: target.", f"{source}: {place}.")) from None
    if colours:
        without = problem if pictures else replace(problem, views=(), intensity_scale=np.pi)
        problem = _with_colours(without, relief, colours, spec.light)
    return ReliefTask(relief, context, problem, spec, colours)


def _recipe(spec: DesignSpec, context: RecipeContext) -> dict[str, Any]:
    """Return the recipe's table: feature_um, blur_um, coherence and the other relief keys except heights."""
    if isinstance(spec.recipe, str):
        path = context.path(spec.recipe)
        recipe = parse_toml(read_text(path, "recipe"), str(path))
    else:
        recipe = dict(spec.recipe)
    if recipe.get("family") != FAMILY:
        raise RecipeError(
            f"{context.source}: heights, and pictures over directions, are sought of a relief; "
            f"recipe.family = {show_value(recipe.get('family'))}"
        )
    for key in recipe:
        if key not in (*RECIPE_KEYS, "family", HEIGHTS, "height_scale_um", "accuracy", "bounded"):
            raise RecipeError(
                f"{context.source}: recipe.{key} is not known for a relief; keys: {', '.join(RECIPE_KEYS)}"
            )
    return recipe


def _bounds(spec: DesignSpec, source: str) -> tuple[float, int]:
    """Return the largest height in um and the features per side."""
    free = dict(spec.parameters)
    if HEIGHTS not in free:
        raise RecipeError(
            f"{source}: a picture over directions needs free heights: write heights = [0, 0.8] in [parameters]"
        )
    limits, features = free.pop(HEIGHTS), free.pop(FEATURES, 32)
    if free:
        raise RecipeError(
            f'{source}: parameters."{next(iter(free))}" beside heights: only the heights vary; fix it in the recipe'
        )
    ends = [limits.get("min"), limits.get("max")] if isinstance(limits, Mapping) else limits
    low, high = ends if isinstance(ends, list | tuple) and len(ends) == 2 else (None, None)
    if low != 0 or isinstance(high, bool) or not isinstance(high, int | float) or not high > 0:
        raise RecipeError(
            f"{source}: parameters.heights = {show_value(limits)} should be [0, h], h um above the lowest point"
        )
    is_count = isinstance(features, int) and not isinstance(features, bool)
    if not is_count or not 2 <= features <= LARGEST_TILE_FEATURES:
        raise RecipeError(
            f"{source}: parameters.features = {show_value(features)} should be a whole number from 2 to "
            f"{LARGEST_TILE_FEATURES}, the features along a side of the tile"
        )
    return float(high), features


def _noise(spec: DesignSpec, source: str) -> float:
    """Return the relative height noise from `[tolerance] heights = "2%"`."""
    tolerance = spec.tolerance.get(HEIGHTS)
    if tolerance is None:
        return 0.0
    text = f"{tolerance.get('percent')}%" if isinstance(tolerance, Mapping) else str(tolerance)
    try:
        value = float(text.removesuffix("%")) / 100.0 if text.endswith("%") else np.nan
    except ValueError:
        value = np.nan
    if not 0.0 <= value <= 1.0:
        raise RecipeError(f'{source}: tolerance.heights = {show_value(tolerance)} should be a percentage, such as "2%"')
    return value


def _check_colour(target: Target) -> None:
    if target.geometry.kind != "aspecular":
        raise RecipeError(
            f'{target.key}.geometry = "{target.geometry}" cannot be met by heights; write directions such as "45as15"'
        )
    if target.lab is None and target.xyz is None:
        raise RecipeError(f"{target.key}: heights need a target colour; give colour, lab, lch, xyz or xyy")


def _with_colours(problem: Problem, relief: TargetSpec, colours: Sequence[Target], light: LightSpec) -> Problem:
    """Return a problem of pictures, or none, with a uniform view about each colour's directions."""
    scale = problem.intensity_scale  # display = (scale f)^(1/2.2); pi f = 1 is white
    assert scale is not None
    count = max((view.target.shape[1] for view in problem.views), default=0)
    count = max(count // PICTURE_SHARE, 4) if problem.views else PATCH_COUNT
    weights = default_weights()
    reflectance = coating_reflectance(relief.coating.build().n_complex(weights.wavelengths_nm))
    offsets = np.linspace(-PATCH_SINE, PATCH_SINE, count)
    white = white_xyz(light.illuminants[0], light.observer)
    views = list(problem.views)
    for target in colours:
        wi = direction(np.radians(target.geometry.theta_deg))
        wo = target.geometry.wo
        geometry = CutGeometry(wi[0] + wo[0] + offsets, wi[1] + wo[1] + offsets, wi[None], weights.wavelengths_nm)
        lab = target.target_lab(white)
        assert lab is not None  # by `_check_colour`
        encoded = (scale / np.pi * _linear_rgb(lab, white)) ** (1.0 / GAMMA)
        picture = np.broadcast_to(encoded, (1, count, count, 3)).copy()
        views.append(View(geometry, picture, weights.rgb_weights, reflectance))
    return replace(problem, views=tuple(views), intensity_scale=float(scale), brightness_floor=0.0)


def _linear_rgb(lab: Array, white: Array) -> Array:
    xyz = adapt_xyz(np.clip(lab_to_xyz(lab, white), 0.0, None), white, SRGB_WHITE_XYZ)
    return np.clip(np.asarray(xyz_to_srgb_linear(xyz)), 0.0, None)
