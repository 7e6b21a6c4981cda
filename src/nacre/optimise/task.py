"""Read and check target files."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from nacre.bsdf.texture import refuse_place
from nacre.core.errors import NacreError, RecipeError, did_you_mean
from nacre.core.files import named, read_text, real
from nacre.families.contract import Diffracting, Pixels, method_overrides
from nacre.material.examples import resolve_recipe_path
from nacre.material.material import Material, load, material
from nacre.matter.indices.spec import IndexSpec
from nacre.measure.geometry import Geometry, named_geometries
from nacre.optimise.evaluation import TargetResult, geometries_of
from nacre.optimise.image.files import map_stem
from nacre.optimise.measurement import check_answers
from nacre.optimise.parameters import Parameter, read_parameters, refuse_ties, trial_materials
from nacre.optimise.solutions import Solution, write_recipe
from nacre.optimise.spec import DesignSpec, LayersSpec, LightSpec
from nacre.optimise.targets import Target, read_targets
from nacre.optimise.tolerances import read_tolerances
from nacre.recipe.fingerprint import fingerprint
from nacre.recipe.model import LENGTH_UNITS_NM, RecipeContext, RecipeModel, show_value, validate
from nacre.recipe.path_tables import by_path
from nacre.recipe.toml import parse_toml


def total_thickness_nm(material: Material) -> float:
    """Return the total thickness of the layers of a recipe; 0 without layers."""
    return _thickness_of(material.data.get("layers", ()))


def _thickness_of(layers: Any) -> float:
    total = 0.0
    for layer in layers:
        for key, value in layer.items():
            word, _, unit = key.rpartition("_")
            if word == "thickness" and isinstance(value, int | float):
                total += value * LENGTH_UNITS_NM[unit]
        total += layer.get("repeat", 0) * _thickness_of(layer.get("layers", ()))
    return total


def check_limits(spec: DesignSpec, base: Material, free: Sequence[Parameter], source: str) -> None:
    """Refuse limits that do not apply to the recipe, or that cannot be met.

    Raises:
        RecipeError: naming the key.
    """
    if spec.limits.height_levels is not None:
        raise RecipeError(
            f"{source}: limits.height_levels = {spec.limits.height_levels}: only for pictures; no target is an image"
        )
    if not spec.limits.dither:
        raise RecipeError(f"{source}: limits.dither = false: only for pictures; no target is an image")
    if spec.layers is not None:
        return
    if spec.limits.max_layers is not None:
        raise RecipeError(f'{source}: limits.max_layers = "fewest" applies to stacks; add [layers]')
    most = spec.limits.max_total_nm
    if most is None:
        return
    if not base.data.get("layers"):
        raise RecipeError(f"{source}: limits.max_total_nm = {most:g}: the recipe has no layers; bound the parameters")
    least = 0.0
    with contextlib.suppress(NacreError):  # other parameters may make the lowest values possible
        least = total_thickness_nm(base.vary({number.path: number.low for number in free if not number.choices}))
    if least > most:
        raise RecipeError(
            f"{source}: limits.max_total_nm = {most:g}: the least that [parameters] allows is {least:g} nm"
        )


OTHER = "other"  # key in bounds by material for all other materials


@dataclass(frozen=True)
class Task:
    """Common content of all target files.

    Attributes:
        spec: content of the file.
        context: location of the file.
    """

    spec: Any
    context: RecipeContext

    @property
    def name(self) -> str:
        """A short name."""
        return Path(self.context.source).stem

    def within_seconds(self, seconds: float) -> Self:
        """Return the task with another time limit."""
        search = self.spec.search.model_copy(update={"seconds": seconds})
        return replace(self, spec=self.spec.model_copy(update={"search": search}))


@dataclass(frozen=True)
class DesignTask(Task):
    """A checked target file.

    Attributes:
        material: the start recipe; without its layers if [layers] searches the stack.
        targets: the targets.
        parameters: empty if [layers] searches the stack.
    """

    spec: DesignSpec
    material: Material
    targets: tuple[Target, ...]
    parameters: tuple[Parameter, ...]

    @property
    def light(self) -> LightSpec:
        """Lamps and observer."""
        return self.spec.light

    @property
    def image_kind(self) -> str:
        """Design of images: "picture", "hologram", or "" if no target is an image."""
        if self.targets[0].image is None:
            return ""
        return "hologram" if is_hologram(self.material, self.parameters) else "picture"

    def with_targets(self, targets: tuple[Target, ...]) -> DesignTask:
        """Return the task with other targets at the same geometries."""
        return replace(self, targets=targets)

    def read(self, folder: Path, changes: Mapping[str, Any]) -> Material:
        """Return the material of a solution: its changes suffice."""
        return self.material.vary(changes)

    def solution(
        self, changes: dict[str, Any], results: list[TargetResult], facts: dict[str, Any], folder: Path | None
    ) -> Solution:
        """Return a solution, written if there is a folder.

        Raises:
            NacreError: the folder cannot be written.
        """
        solution = Solution(None, self.material.vary(changes), changes, results, facts)
        return solution if folder is None else self.write(folder, solution)

    def write(self, folder: Path, solution: Solution) -> Solution:
        """Write the recipe of a solution with its tolerances and files; return the solution with its recipe.

        Raises:
            NacreError: the folder cannot be written.
        """
        changes = with_method_overrides(self.material, solution.changes)
        path, files = write_recipe(folder, self.material, changes, self._tolerance(solution), solution.material)
        return replace(solution, recipe=path, facts={**solution.facts, "files": files})

    def _tolerance(self, solution: Solution) -> dict[str, Any]:
        """Return the tolerances as the recipe's [tolerance] table, for `nacre tolerance`."""
        if not self.spec.tolerance:
            return {}
        tolerances = read_tolerances(self.spec.tolerance, solution.material, self.context.source)
        own = dict(solution.material.data.get("tolerance", {}))
        table: dict[str, Any] = {}
        for t in tolerances:
            entry = {"deviation": t.deviation, "distribution": t.distribution} | ({"group": t.group} if t.group else {})
            table[t.path] = [*table[t.path], entry] if t.path in table else [entry]
        return own | {path: entries[0] if len(entries) == 1 else entries for path, entries in table.items()}

    def check_overwriting(self, folder: Path, names: Sequence[str]) -> None:
        """Refuse to overwrite the pictures of the target by its maps and other files of a folder.

        Raises:
            RecipeError: a picture would be overwritten.
        """
        maps = [f"{map_stem(p.path)}.png" for p in self.parameters]
        outputs = {(folder / name).resolve() for name in (*names, *maps)}
        for image in (entry.image for entry in self.spec.target):
            if image is not None and real(self.context.path(image)) in outputs:
                raise RecipeError(f"{folder}: contains {image}, which would be overwritten; choose another with -o")

    @property
    def fingerprint(self) -> str:
        """Hash of everything that defines the task, without the time limit."""
        files = {**self.context.files, **self.material.context.files, **self._choices_files}
        search = {"search": {"seconds"}}
        return fingerprint(self.spec.model_dump(exclude=search), files, material=self.material.fingerprint)

    @property
    def _choices_files(self) -> dict[str, str]:
        """Digests of the files named by choices, such as optical constants of a palette, by name."""
        tried: list[dict[str, Any]] = [{n.path: choice} for n in self.parameters for choice in n.choices]
        if self.spec.layers is not None:
            tried += [{"layers": [{"material": e, "thickness_nm": 1.0}]} for e in self.spec.layers.palette]
            tried += [{"substrate": entry} for entry in substrates(self.spec.layers)]
        files: dict[str, str] = {}
        for changes in tried:
            files |= self.material.vary(changes).context.files
        return files


def with_method_overrides(start: Material, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return recipe changes that also name the quick method by which the solution was evaluated.

    Args:
        start: the recipe to be changed, as a search candidate.
    """
    return {**changes, **method_overrides(start.vary(changes).model)}


def is_relief_task(data: Mapping[str, Any]) -> bool:
    """Whether a target has one `[target]` table, varies the heights of a relief, or has a picture over directions."""
    free, targets = data.get("parameters"), data.get("target")
    if isinstance(targets, Mapping):
        return "recipe" not in data
    pictures = isinstance(targets, list) and any(isinstance(one, Mapping) and "directions" in one for one in targets)
    return pictures or (isinstance(free, Mapping) and "heights" in free)


def read_data(target: str | Path | Mapping[str, Any]) -> tuple[dict[str, Any], RecipeContext]:
    """Return a copy of the tables of a target file, which may be named as an example, and its location.

    Raises:
        NacreError: the file cannot be read, or is not TOML.
    """
    if isinstance(target, Mapping):
        return copy.deepcopy(dict(target)), RecipeContext("target", Path().resolve(), "")
    path = resolve_recipe_path(named(target))
    text = read_text(path, "target")
    return parse_toml(text, str(path)), RecipeContext(str(path), path.parent.resolve(), text)


def read_task(target: str | Path | Mapping[str, Any]) -> DesignTask:
    """Read and check a target file.

    Args:
        target: a TOML file, or a dictionary with its keys and paths relative to the current folder.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
        NacreError: the recipe cannot be computed.
    """
    return check_task(*read_data(target))


def check_task(data: dict[str, Any], context: RecipeContext) -> DesignTask:
    """Check the tables of a target file; see `read_task`."""
    if isinstance(data.get("target"), Mapping):
        raise RecipeError(f"{context.source}: [target] is of a relief; write [[target]]")
    spec: DesignSpec = validate(DesignSpec, data, context)
    source = context.source
    base = _recipe(spec, context).with_parts_loaded([*spec.parameters, *spec.tolerance])
    refuse_place(base.model, f"{context.source}: recipe")
    named = task_geometries(spec, base.data, context)
    targets = read_targets(spec.target, spec.light, context, named, spec.instrument)
    if spec.layers is not None:
        check_layers(spec.layers, base, source)
        _check_total(spec, source)
    for free_path in by_path(spec.parameters, {"min", "max", "choices"}, source, "parameters"):
        word = free_path.partition("[")[0].partition(".")[0]
        if spec.layers is not None and word == "layers":
            raise RecipeError(
                f'{source}: parameters."{free_path}" names a layer, but [layers] searches the whole stack; remove one'
            )
    parameters = read_parameters(spec.parameters, base, source)
    varied = [p.path for p in parameters]
    if spec.layers is not None:
        varied += ["layers"] if spec.layers.substrate is None else ["layers", "substrate"]
    refuse_ties(base, varied, source)
    if not parameters and spec.layers is None:
        raise RecipeError(f"{source}: nothing varies; add a [parameters] table, or [layers] for the stack of a film")
    if spec.layers is not None and parameters:
        raise RecipeError(
            f'{source}: parameters."{parameters[0].path}" beside [layers]: only the stack varies; fix it in the recipe'
        )
    if spec.tolerance and spec.layers is None:
        read_tolerances(spec.tolerance, base, source)
    if spec.limits.within_validity:
        raise RecipeError(f"{source}: limits.within_validity = true applies to heights of reliefs")
    task = DesignTask(spec, context, base, targets, parameters)
    if task.image_kind == "hologram":
        check_hologram(spec, targets, source)
        return task
    turned = next((k for k, entry in enumerate(spec.target) if entry.light_azimuth_deg), None)
    if turned is not None:
        raise RecipeError(
            f"{targets[turned].key}.light_azimuth_deg = {spec.target[turned].light_azimuth_deg:g} applies to holograms "
            f"of a grating: {HOLOGRAM}"
        )
    if targets[0].image is not None:
        if len(targets) > 1:
            raise RecipeError(
                f"{targets[1].key}.image: a picture is the only target; remove the other {len(targets) - 1}, or vary "
                f"{HOLOGRAM}"
            )
        check_picture_target(spec, base, parameters, source)
    else:
        check_limits(spec, base, parameters, source)
    _check_geometries(task)
    return task


def task_geometries(spec: DesignSpec, recipe: Mapping[str, Any], context: RecipeContext) -> dict[str, Geometry]:
    """Return the named geometries of a target file and its recipe.

    Raises:
        RecipeError: an entry is not a geometry, or a name occurs twice.
    """
    own = named_geometries([entry.model_dump() for entry in spec.geometry], f"{context.source}: geometry")
    return named_geometries(recipe.get("geometry", ()), f"{context.source}: recipe.geometry") | own


def _recipe(spec: DesignSpec, context: RecipeContext) -> Material:
    """Load the recipe, without layers if the stack is searched."""
    try:
        if isinstance(spec.recipe, str):
            loaded = load(context.path(spec.recipe))
            if spec.layers is None:
                return loaded.at_low_fidelity(is_corrected=True)
            data, folder = dict(loaded.data), loaded.context.folder
        else:
            data, folder = dict(spec.recipe), context.folder
        if spec.layers is not None:
            _check_film(data, context.source)
            data["layers"] = []
            if spec.layers.substrate is not None:
                data["substrate"] = substrates(spec.layers)[0]
        return material(data, folder).at_low_fidelity(is_corrected=True)
    except NacreError as error:
        message = str(error).removeprefix("recipe: ").removeprefix(f"{context.source}: ")
        raise RecipeError(
            f"{context.source}: " + (message if message.startswith("layers: ") else f"recipe: {message}")
        ) from None


def _check_film(data: Mapping[str, Any], source: str) -> None:
    family = data.get("family")
    if family is not None and family != "film":
        raise RecipeError(f"{source}: layers: only the stack of a film can be sought; the recipe is of a {family}")


def substrates(layers: LayersSpec) -> list[Any]:
    """Return the substrates of a table of layers."""
    if layers.substrate is None:
        return []
    return list(layers.substrate) if isinstance(layers.substrate, list) else [layers.substrate]


def check_layers(layers: LayersSpec, base: Material, source: str) -> None:
    """Refuse invalid palettes, substrates and bounds.

    Raises:
        RecipeError: naming the key, with a suggestion.
    """
    for name, values in (("palette", layers.palette), ("substrate", substrates(layers))):
        for value in values:
            check_index(value, f"{source}: layers.{name}", base.context)
        if not values and name == "substrate" and layers.substrate is not None:
            raise RecipeError(f"{source}: layers.substrate = [] names no substrate")
    limits = layers.thickness_nm
    names = [palette_name(entry) for entry in layers.palette]
    bounds = limits if isinstance(limits, dict) else {OTHER: limits}
    for word, (low, high) in bounds.items():
        where = f"{source}: layers.thickness_nm" + (f".{word}" if isinstance(limits, dict) else "")
        if word != OTHER and word not in names:
            hint = did_you_mean(word, [*names, OTHER])
            raise RecipeError(f"{where}: the palette has no such name.{hint} Palette: {', '.join(names)}")
        if not 0.0 <= low < high:
            raise RecipeError(f"{where} = {show_value([low, high])}: the bounds cross, or lie below 0")
    if isinstance(limits, dict) and OTHER not in limits:
        missing = [name for name in names if name not in limits]
        if missing:
            raise RecipeError(
                f'{source}: layers.thickness_nm has no bounds for "{missing[0]}"; add it, or other = [5, 250]'
            )


def _check_total(spec: DesignSpec, source: str) -> None:
    """Refuse a total thickness below the thinnest layer."""
    assert spec.layers is not None
    least = min(bounds_of(spec.layers, entry)[0] for entry in spec.layers.palette)
    if spec.limits.max_total_nm is not None and spec.limits.max_total_nm < least:
        total = f"{source}: limits.max_total_nm = {spec.limits.max_total_nm:g}"
        raise RecipeError(f"{total}: no layer is so thin; layers.thickness_nm begins at {least:g}")


def palette_name(entry: Any) -> str:
    """Return the name of a palette material."""
    if isinstance(entry, Mapping) and set(entry) <= {"name", "extrapolate"} and "name" in entry:
        return str(entry["name"])
    return entry if isinstance(entry, str) else show_value(entry)


def bounds_of(layers: LayersSpec, entry: Any) -> tuple[float, float]:
    """Return the bounds of a layer of one palette material."""
    if not isinstance(layers.thickness_nm, dict):
        return layers.thickness_nm
    return layers.thickness_nm.get(palette_name(entry), layers.thickness_nm.get(OTHER, (0.0, 0.0)))


class _Holder(RecipeModel):
    """Validates one optical constant as in recipes."""

    value: IndexSpec


def check_index(value: Any, where: str, context: RecipeContext) -> IndexSpec:
    """Return a validated optical constant.

    Raises:
        RecipeError: it is not known; with a suggestion.
    """
    try:
        index: IndexSpec = validate(_Holder, {"value": value}, RecipeContext("", context.folder)).value
    except RecipeError as error:
        raise RecipeError(f"{where}: {str(error).removeprefix(': ').removeprefix('value').strip(' =.:')}") from None
    return index


def _check_geometries(target: DesignTask) -> None:
    """Refuse a geometry without signal for all parameter values."""
    tried = [target.material, *(trial_materials(target.parameters, target.material) if target.parameters else ())]
    for other in substrates(target.spec.layers)[1:] if target.spec.layers else ():
        tried.append(target.material.vary({"substrate": other}))
    rows = geometries_of(target.targets)
    firsts = [next(one for one in target.targets if one.geometry == at) for at in rows]
    keys = [f"{one.key}.{'geometry' if one.texture is None else 'quantity'}" for one in firsts]
    check_answers(tried, rows, keys)


MAX_PARAMETERS = 2
PERIOD, TURN = "lattice.period_nm", "orientation.turn_deg"
HOLOGRAM = f"{PERIOD} and {TURN} together"
MAX_CHANNELS = 2  # pictures in a hologram


def is_hologram(base: Material, parameters: Sequence[Parameter]) -> bool:
    """Whether a picture is to be made of the turn and the grating period."""
    return isinstance(base.model, Diffracting) and {p.path for p in parameters} == {PERIOD, TURN}


def check_hologram(spec: DesignSpec, targets: Sequence[Target], source: str) -> None:
    """Refuse a target file that no hologram can meet.

    Raises:
        RecipeError: with the key.
    """
    for name in ("layers", "tolerance"):
        if getattr(spec, name):
            raise RecipeError(f"{source}: {name} does not apply to a hologram; remove it")
    if spec.limits.height_levels is not None or not spec.limits.dither:
        raise RecipeError(f"{source}: limits.height_levels and limits.dither do not apply to a hologram; remove them")
    if len(targets) > MAX_CHANNELS:
        raise RecipeError(f"{source}: a hologram of {len(targets)} pictures is not made; allowed: one or two")
    first = targets[0].image
    for target in targets[1:]:
        if target.image is None or first is None or target.image.shape != first.shape:
            raise RecipeError(f"{target.key}.image is not of the size of the first picture; allowed: equal sizes")


def check_picture_target(spec: DesignSpec, base: Material, parameters: Sequence[Parameter], source: str) -> None:
    """Refuse targets that a picture design cannot meet.

    Raises:
        RecipeError: with the key.
    """
    for name, reason in (("layers", "the stack is fixed"), ("tolerance", "tolerances are not evaluated")):
        if getattr(spec, name):
            raise RecipeError(f"{source}: {name}: in a picture design {reason}; free one or two numbers that vary")
    for name, value in (("max_total_nm", spec.limits.max_total_nm), ("max_layers", spec.limits.max_layers)):
        if value is not None:
            raise RecipeError(f"{source}: limits.{name} does not apply to a picture; use the bounds of the parameters")
    if not spec.limits.dither and spec.limits.height_levels is None:
        raise RecipeError(f"{source}: limits.dither = false: only with limits.height_levels; add it")
    if len(parameters) > MAX_PARAMETERS:
        paths = ", ".join(parameter.path for parameter in parameters)
        raise RecipeError(f"{source}: parameters: {len(parameters)} numbers ({paths}); a picture takes one or two")
    if isinstance(base.model, Diffracting) and any(p.path == TURN for p in parameters):
        raise RecipeError(f'{source}: parameters."{TURN}" alone makes no picture; allowed: {HOLOGRAM}, for a hologram')
    textures: dict[str, dict[str, Any]] = {}
    for p in parameters:
        where = f'{source}: parameters."{p.path}"'
        if p.choices:
            raise RecipeError(f"{where}: a picture takes numbers that vary over the surface, not choices")
        if p.is_whole:
            raise RecipeError(f"{where}: only whole numbers are allowed there; a picture takes a continuous one")
        if isinstance(base.model, Pixels):
            _try(base, {p.path: p.low}, where)
            _try(base, {p.path: p.high}, where)
            continue
        textures[p.path] = {"formula": f"{p.low!r} + {p.high - p.low!r}*u", "min": p.low, "max": p.high}
        _try(base, {p.path: textures[p.path]}, where)
    if textures:
        _try(base, textures, f"{source}: parameters")


def _try(base: Material, textures: dict[str, Any], where: str) -> None:
    try:
        base.vary(textures)
    except NacreError as error:
        message = str(error).removeprefix(f"{base.context.source}: ").removeprefix("recipe: ")
        raise RecipeError(f"{where}: {message}") from None
